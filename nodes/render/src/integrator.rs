//! Unidirectional path tracing with next-event estimation and multiple importance sampling.
//!
//! The estimator of Mitsuba 3's `path`: power heuristic (Veach 1997), Russian roulette from the fifth vertex on by the
//! path's throughput times the squared relative index of refraction. Nothing is clamped; contributions that are not
//! finite are left out and counted. Surfaces with an opacity below 1 let rays pass at random, shadow rays by weight, and
//! a passage does not count as a segment.

use crate::{
    accel::Hit,
    geometry::{Ray, offset_origin},
    lights::{Arrival, Target},
    rng::Sampler,
    surface::Interaction,
    world::World,
};
use glam::Vec3;

/// Vertices before Russian roulette begins, as Mitsuba's `rr_depth`.
const ROULETTE_FROM: u32 = 5;
/// Shadow rays end this short of a surface: the rounding of a distance near 1, with room to spare.
const SHADOW_END: f32 = 1.0 - 1e-5;
/// Passages through transparent surfaces in one ray; only geometry that repeats without end has more.
const PASSAGES: u64 = 4096;

/// Dimensions of a vertex.
const PICK_LIGHT: u64 = 0;
const LIGHT_POINT: u64 = 1;
const LOBE_AND_ROULETTE: u64 = 2;
const SCATTER: u64 = 3;
const PASSAGE: u64 = 4;

/// Which ways of finding light count: all in a render, one of two in tests of the estimator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strategy {
    /// Both, weighted against each other.
    Mis,
    /// Light sampling alone, wherever it can find the light.
    LightsOnly,
    /// Scattering alone, but for lights that it cannot find.
    ScatteringOnly,
}

/// What one path found.
#[derive(Clone, Copy, Debug, Default)]
pub struct Path {
    /// Radiance.
    pub radiance: Vec3,
    /// Segments traced.
    pub segments: u32,
    /// Contributions that were not finite.
    pub rejected: u32,
}

impl Path {
    #[inline]
    fn add(&mut self, contribution: Vec3) {
        if contribution.is_finite() {
            self.radiance += contribution;
        } else {
            self.rejected += 1;
        }
    }
}

impl Strategy {
    /// Weight of a sample of density `own` that another technique finds with density `other`.
    #[inline]
    fn weight(self, by_light: bool, own: f32, other: f32) -> f32 {
        match self {
            Self::Mis => {
                let ratio = other / own;
                1.0 / (1.0 + ratio * ratio)
            }
            Self::LightsOnly => f32::from(by_light || other <= 0.0),
            Self::ScatteringOnly => f32::from(!by_light || other <= 0.0),
        }
    }
}

/// Traces the path of one sample along a camera ray, with what the scene has.
#[inline]
pub fn trace(world: &World, sampler: &Sampler, ray: Ray, strategy: Strategy) -> Path {
    match (world.features.opacity, world.features.normal_maps) {
        (false, false) => trace_with::<false, false>(world, sampler, ray, strategy),
        (false, true) => trace_with::<false, true>(world, sampler, ray, strategy),
        (true, false) => trace_with::<true, false>(world, sampler, ray, strategy),
        (true, true) => trace_with::<true, true>(world, sampler, ray, strategy),
    }
}

/// [`trace`] with given features; those that the scene lacks may be on, and change no bit.
pub(crate) fn trace_with<const OPACITY: bool, const NORMAL_MAPS: bool>(
    world: &World,
    sampler: &Sampler,
    mut ray: Ray,
    strategy: Strategy,
) -> Path {
    let mut path = Path::default();
    let mut throughput = Vec3::ONE;
    let mut eta = 1.0f32;
    // Density of the last scattering; 0 where nothing but it can find the light.
    let mut pdf = 0.0f32;
    let mut from = ray.origin;
    for depth in 0..world.max_depth {
        let dimension = Sampler::vertex(depth);
        path.segments += 1;
        let Some((hit, at)) = first_solid::<OPACITY>(world, sampler, dimension + PASSAGE, ray) else {
            if let Some(environment) = world.lights.environment() {
                let weight = if pdf > 0.0 {
                    strategy.weight(false, pdf, world.lights.environment_pdf(ray.direction))
                } else {
                    1.0
                };
                path.add(throughput * environment.eval(ray.direction) * weight);
            }
            break;
        };
        if let Some(light) = world.shapes[at.shape as usize].light {
            let radiance = world
                .lights
                .shape(light)
                .map_or(Vec3::ZERO, |shape| shape.radiance(&at.surface, at.geometric, -ray.direction));
            if radiance != Vec3::ZERO {
                let weight = if pdf > 0.0 {
                    strategy.weight(false, pdf, world.lights.shape_pdf(light, from, at.p, at.geometric))
                } else {
                    1.0
                };
                path.add(throughput * radiance * weight);
            }
        }
        if depth + 1 >= world.max_depth {
            break;
        }
        let material = world.material(&at);
        let bsdf = material.at(&at.surface);
        let frame = world.shading_frame::<NORMAL_MAPS>(&hit, &at);
        let wo = frame.to_local(-ray.direction);
        // A normal map must not carry light through the surface.
        let same_side = |wi: Vec3, local: Vec3| !NORMAL_MAPS || wi.dot(at.shading) * local.z > 0.0;
        if bsdf.has_smooth() && !world.lights.is_empty() {
            let (pick, point) = (sampler.two(dimension + PICK_LIGHT), sampler.two(dimension + LIGHT_POINT));
            if let Some(arrival) = world.lights.sample(world, at.p, pick, point) {
                let wi = frame.to_local(arrival.direction);
                let value = bsdf.eval(wo, wi);
                if value != Vec3::ZERO && same_side(arrival.direction, wi) {
                    let other = bsdf.pdf(wo, wi);
                    let weight = if arrival.pdf > 0.0 { strategy.weight(true, arrival.pdf, other) } else { 1.0 };
                    let reach = if weight > 0.0 { transmittance::<OPACITY>(world, &at, &arrival) } else { 0.0 };
                    if reach > 0.0 {
                        path.add(throughput * value * arrival.weight * (weight * reach));
                    }
                }
            }
        }
        let choice = sampler.two(dimension + LOBE_AND_ROULETTE);
        let Some(sample) = bsdf.sample(wo, choice.x, sampler.two(dimension + SCATTER)) else { break };
        throughput *= sample.weight;
        if !throughput.is_finite() {
            path.rejected += 1;
            break;
        }
        let direction = frame.to_world(sample.wi).normalize();
        if throughput == Vec3::ZERO || !same_side(direction, sample.wi) {
            break;
        }
        eta *= sample.eta;
        pdf = if sample.delta { 0.0 } else { sample.pdf };
        if depth + 1 >= ROULETTE_FROM {
            let survival = (throughput.max_element() * eta * eta).min(0.95);
            if choice.y >= survival {
                break;
            }
            throughput /= survival;
        }
        from = at.p;
        ray = Ray::new(offset_origin(at.p, at.error, at.geometric, direction), direction);
    }
    path
}

/// The first hit that does not let the ray pass.
#[inline]
pub(crate) fn first_solid<const OPACITY: bool>(
    world: &World,
    sampler: &Sampler,
    dimension: u64,
    mut ray: Ray,
) -> Option<(Hit, Interaction)> {
    if !OPACITY {
        return world.meet(&ray);
    }
    for passage in 0..PASSAGES {
        let (hit, at) = world.meet(&ray)?;
        let opacity = world.opacity_of(at.shape, &at.surface);
        if opacity >= 1.0 || sampler.one(dimension + (passage << 32)) < opacity {
            return Some((hit, at));
        }
        ray.origin = offset_origin(at.p, at.error, at.geometric, ray.direction);
    }
    None
}

/// Share of the light that arrives.
#[inline]
fn transmittance<const OPACITY: bool>(world: &World, at: &Interaction, arrival: &Arrival) -> f32 {
    let origin = offset_origin(at.p, at.error, at.geometric, arrival.direction);
    let mut ray = match arrival.target {
        Target::Infinity => Ray::new(origin, arrival.direction),
        Target::Point(end) => Ray { origin, direction: end - origin, t_max: 1.0 },
        Target::Surface { p, error, normal } => {
            let end = offset_origin(p, error, normal, -arrival.direction);
            Ray { origin, direction: end - origin, t_max: SHADOW_END }
        }
    };
    if !OPACITY {
        return f32::from(!world.accel.occluded(&ray));
    }
    let mut share = 1.0;
    for _ in 0..PASSAGES {
        let Some((hit, at)) = world.meet(&ray) else { return share };
        share *= 1.0 - world.opacity_of(at.shape, &at.surface);
        if share <= 0.0 {
            return 0.0;
        }
        let origin = offset_origin(at.p, at.error, at.geometric, ray.direction);
        if arrival.is_finite() {
            // The same end, measured from the new origin.
            let end = ray.at(1.0);
            ray = Ray { origin, direction: end - origin, t_max: ray.t_max };
            if hit.t >= ray.t_max {
                return share;
            }
        } else {
            ray.origin = origin;
        }
    }
    0.0
}

impl Arrival {
    fn is_finite(&self) -> bool {
        !matches!(self.target, Target::Infinity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        rng::render_state,
        scenes::{Built, ball, balls_under_sky, columns, level, room},
    };
    use glam::Vec2;
    use tauflow_data::scene::{Bsdf, Emitter, Geometry, Texture};

    #[test]
    fn features_that_a_scene_lacks_change_no_bit() {
        for built in [balls_under_sky(), room()] {
            let world = World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene");
            let camera = crate::camera::Camera::new(&world.camera, 32, 32).expect("a sound camera");
            for index in 0..32 * 32 {
                let pixel = (index % 32, index / 32);
                let sampler = Sampler::new(render_state(1, 2), pixel, 3);
                let ray = camera.ray(pixel.0, pixel.1, Vec2::splat(0.5));
                let plain = trace_with::<false, false>(&world, &sampler, ray, Strategy::Mis);
                let full = trace_with::<true, true>(&world, &sampler, ray, Strategy::Mis);
                assert_eq!((plain.radiance, plain.segments), (full.radiance, full.segments));
            }
        }
    }

    #[test]
    fn convex_bodies_do_not_shade_themselves() {
        let mut facets = ball(20);
        facets.normals = None;
        for (radius, shift) in [(1.0, 0.0), (1e-2, 1.0), (1e3, -400.0), (1.0, 300.0)] {
            let at = [shift, 0.5 * shift, -shift];
            for curved in [false, true] {
                let eye = [at[0], at[1], at[2] + 4.0 * radius];
                let mut built = Built::new(eye, at, 40.0, 2);
                let white = built.diffuse([1.0; 3]);
                if curved {
                    built.sphere(at, radius, white);
                } else {
                    let (x, y, z) = ([radius, 0.0, 0.0], [0.0, radius, 0.0], [0.0, 0.0, radius]);
                    built.mesh(&facets, columns(x, y, z, at), white);
                }
                let direction = [-1.0, -0.2, 0.1];
                built.scene.emitters.push(Emitter::Directional { direction, irradiance: [1.0; 3] });
                let world = World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene");
                let camera = crate::camera::Camera::new(&world.camera, 64, 64).expect("a sound camera");
                let to_light = -glam::DVec3::from_array(direction).normalize().as_vec3();
                let mut lit = 0;
                for index in 0..64 * 64 {
                    let sampler = Sampler::new(0, (index, 0), 0);
                    let ray = camera.ray(index % 64, index / 64, sampler.two(0));
                    let Some((_, hit)) = world.meet(&ray) else { continue };
                    if hit.geometric.dot(to_light) > 1e-3 {
                        lit += 1;
                        let path = trace(&world, &sampler, ray, Strategy::Mis);
                        assert!(path.radiance.x > 0.0, "shaded at {hit:?}, radius {radius}");
                    }
                }
                assert!(lit > 500, "{lit}");
            }
        }
    }

    #[test]
    fn features_are_those_of_shapes_that_are_there() {
        let mut built = room();
        let inner = Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.5) });
        let mask = built.material(Bsdf::Mask { opacity: Texture::scalar(0.5), inner });
        let features = |built: &Built| World::new(&built.scene, &mut |d| built.load(d)).expect("sound").features;
        let room = features(&built);
        assert!(room.area_lights && !room.opacity && !room.environment && !room.delta_lights && !room.normal_maps);
        built.shape(Geometry::Rectangle, level(0.1, [0.0, 1.0, 0.0], true), mask);
        built.sky([1.0; 3]);
        assert!(features(&built).opacity && features(&built).environment);
    }

    #[test]
    fn contributions_that_are_not_finite_are_counted_and_left_out() {
        let mut path = Path::default();
        path.add(Vec3::ONE);
        path.add(Vec3::new(f32::NAN, 0.0, 0.0));
        path.add(Vec3::splat(f32::INFINITY));
        assert_eq!((path.radiance, path.rejected), (Vec3::ONE, 2));
        // A density that overflows gives a weight of 0, not of NaN.
        assert_eq!(Strategy::Mis.weight(true, 1.0, f32::INFINITY), 0.0);
    }
}
