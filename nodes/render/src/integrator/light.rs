//! Light tracing: paths begin at the lights, and every surface that they meet sends light to the pinhole.
//!
//! It finds what a path from the camera hardly ever finds: light that glass and mirrors gather on a surface that
//! scatters it. It does not find what the camera sees in glass and mirrors. So it is used in two ways:
//!
//! - [`Which::All`]: everything, for scenes that nothing specular is in.
//! - [`Which::Caustics`]: only light whose every vertex between the lamp and the surface that the camera sees is
//!   specular, with one such vertex at least. A path tracer finds the same light by scattering alone, and the two are
//!   weighed by the power heuristic (Veach 1997). Lights without extent are left out: no path from the camera finds
//!   what glass and mirrors make of them, and all integrators have one expectation.
//!
//! As many light paths are traced for each sample index as the film has pixels. The contribution of a vertex is that
//! of Veach's strategy t = 1 (*Robust Monte Carlo Methods*, section 10.3). Scattering is evaluated with the directions
//! that a path from the camera would have, so that radiance at interfaces and shading normals agree with the path
//! tracer (section 5.3).

use super::{Dimmed, PASSAGES, dimension, first_solid};
use crate::{
    bsdf::Material,
    camera::Camera,
    geometry::{Frame, Ray, offset_origin},
    rng::{Sampler, render_state},
    splats::{Finds, Splat, Splats},
    surface::Interaction,
    world::World,
};
use glam::Vec3;
use tauflow_data::{SamplerKind, rng::mix};

/// Label that parts the numbers of light paths from those of paths from the camera.
const LIGHT_PATHS: u64 = 0x6C69_6768_7470;
/// Light paths of a task.
const TASK: u64 = 2048;
/// Shadow rays towards the camera end this short of where the view begins.
const VIEW_END: f32 = 1.0 - 1e-5;

/// Which light paths count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Which {
    /// All.
    All,
    /// Those that are specular until they meet what the camera sees, weighed against a path tracer.
    Caustics,
}

/// A light tracer at work on a film.
pub(crate) struct LightPaths<'a> {
    pub(crate) world: &'a World,
    pub(crate) camera: &'a Camera,
    pub(crate) size: (usize, usize),
    pub(crate) stream: u64,
    pub(crate) sampler: SamplerKind,
    pub(crate) which: Which,
}

/// Where a light path meets a surface.
struct Vertex<'a> {
    at: Interaction,
    frame: Frame,
    material: &'a Material,
    /// Towards the light.
    back: Vec3,
    mapped: bool,
}

/// What of a light path is known at a vertex.
struct Carried {
    power: Vec3,
    /// See [`crate::lights::Lights::emits`].
    density: f32,
    /// Whether all vertices were specular, and how many there were.
    specular: bool,
    vertices: u32,
}

impl LightPaths<'_> {
    /// What the samples of these indices find.
    pub(crate) fn trace(&self, samples: std::ops::Range<u64>) -> Splats {
        let count = (self.size.0 * self.size.1) as u64;
        let many = samples.end - samples.start;
        let mut splats = Splats::new(count as usize, many as usize);
        let state = mix(render_state(self.world.seed, self.stream), LIGHT_PATHS);
        let tasks = count.div_ceil(TASK);
        splats.gather(many * tasks, |task| {
            let (sample, part) = (task / tasks, task % tasks);
            let mut finds = Finds::default();
            for path in part * TASK..((part + 1) * TASK).min(count) {
                let name = ((path % self.size.0 as u64) as u32, (path / self.size.0 as u64) as u32);
                let numbers = Sampler::new(self.sampler, state, name, samples.start + sample);
                self.path(&numbers, sample as u32, &mut finds);
            }
            finds
        });
        splats
    }

    /// One light path.
    fn path(&self, numbers: &Sampler, sample: u32, finds: &mut Finds) {
        let world = self.world;
        let Some(emitted) = world.lights.emit(world, numbers) else { return };
        if self.which == Which::Caustics && emitted.density == 0.0 {
            return;
        }
        let mut ray = emitted.ray;
        let mut carried = Carried { power: emitted.power, density: emitted.density, specular: true, vertices: 0 };
        // The last segment is that to the camera.
        for depth in 1..world.max_depth {
            finds.segments += 1;
            let Some((hit, at)) = first_solid(world, numbers, depth, ray) else { return };
            let material = world.material(&at);
            let frame = world.shading_frame(&hit, world.place(hit.primitive).1, &at, -ray.direction);
            let back = -ray.direction;
            let vertex = Vertex { at, frame, material, back, mapped: material.has_normal_map() };
            let counts = self.which == Which::All || (carried.specular && carried.vertices > 0);
            if counts && material.has_smooth() {
                self.connect(&vertex, &carried, sample, finds);
            }
            if depth + 1 >= world.max_depth || !self.go_on(&vertex, numbers, depth, &mut carried, &mut ray, finds) {
                return;
            }
        }
    }

    /// Sends light from a vertex to the camera.
    fn connect(&self, vertex: &Vertex<'_>, carried: &Carried, sample: u32, finds: &mut Finds) {
        let at = &vertex.at;
        let away = at.p.as_dvec3() - self.camera.origin.as_dvec3();
        let square = away.length_squared();
        let distance = square.sqrt();
        if !(distance > 0.0 && distance.is_finite()) {
            return;
        }
        let direction = away / distance;
        let Some(image) = self.camera.image(direction) else { return };
        let (width, height) = self.size;
        let inside = image.x >= 0.0 && image.y >= 0.0 && image.x < width as f64 && image.y < height as f64;
        if !inside || distance <= image.begin {
            return;
        }
        let out = -direction.as_vec3();
        let Some((value, pdf)) = vertex.scatters(out, vertex.back) else { return };
        // Light that arrives spreads over the surface as its geometric normal has it.
        let (arrives, leaves) = (at.geometric.dot(vertex.back).abs(), at.geometric.dot(out).abs());
        let pixels = (image.pixels / square) as f32 * leaves;
        let mut light = carried.power * value * (pixels / arrives / (width * height) as f32);
        if self.which == Which::Caustics {
            let camera = pdf * pixels / arrives;
            let ratio = camera / (carried.density * (width * height) as f32);
            light *= 1.0 / (1.0 + ratio * ratio);
        }
        if !light.is_finite() {
            finds.rejected += 1;
            return;
        }
        if light == Vec3::ZERO {
            return;
        }
        finds.segments += 1;
        let origin = offset_origin(at.p, at.error, at.geometric, out);
        let end = (self.camera.origin.as_dvec3() + direction * image.begin).as_vec3();
        let light = light * reaches(self.world, Ray { origin, direction: end - origin, t_max: VIEW_END });
        if light != Vec3::ZERO {
            let pixel = image.y as usize * width + image.x as usize;
            finds.splats.push(Splat { pixel: pixel as u32, sample, light });
        }
    }

    /// Scatters a light path at a vertex; false if it ends there.
    fn go_on(
        &self,
        vertex: &Vertex<'_>,
        numbers: &Sampler,
        depth: u32,
        carried: &mut Carried,
        ray: &mut Ray,
        finds: &mut Finds,
    ) -> bool {
        let first = Sampler::vertex(depth);
        let choice = numbers.two(first + dimension::LOBE_AND_ROULETTE);
        let local = vertex.frame.to_local(vertex.back);
        let bsdf = vertex.material.at(&vertex.at.surface);
        let Some(drawn) = bsdf.sample(local, choice.x, numbers.two(first + dimension::SCATTER)) else { return false };
        if self.which == Which::Caustics && !drawn.delta {
            return false;
        }
        let out = vertex.frame.to_world(drawn.wi).normalize();
        let (arrives, leaves) = (vertex.at.geometric.dot(vertex.back).abs(), vertex.at.geometric.dot(out).abs());
        let weight = if drawn.delta {
            // Light is scattered as radiance is, but for the squared index, and spreads by geometric normals.
            let (along, onwards) = (local.z.abs(), drawn.wi.z.abs());
            let fits = !vertex.mapped || vertex.keeps_side(vertex.back);
            if !fits {
                return false;
            }
            drawn.weight * (drawn.eta * drawn.eta) * (along * leaves / (arrives * onwards))
        } else {
            let Some((value, _)) = vertex.scatters(out, vertex.back) else { return false };
            value * (leaves / (arrives * drawn.pdf))
        };
        let before = carried.power.max_element();
        let mut power = carried.power * weight;
        if !power.is_finite() {
            finds.rejected += 1;
            return false;
        }
        carried.specular &= drawn.delta;
        carried.vertices += 1;
        if self.which == Which::All && carried.vertices > 2 {
            let survival = (power.max_element() / before).clamp(1.0 / (1u32 << 24) as f32, 0.95);
            if choice.y >= survival {
                return false;
            }
            power /= survival;
        }
        if power.max_element() <= 0.0 {
            return false;
        }
        carried.power = power;
        *ray = Ray::new(offset_origin(vertex.at.p, vertex.at.error, vertex.at.geometric, out), out);
        true
    }
}

impl Vertex<'_> {
    /// What is scattered from the direction `to_light` towards `out`, times the cosine at `to_light`, and the density
    /// with which a path that comes from `out` finds it; none if nothing is.
    fn scatters(&self, out: Vec3, to_light: Vec3) -> Option<(Vec3, f32)> {
        let bsdf = self.material.at(&self.at.surface);
        let (wo, wi) = (self.frame.to_local(out), self.frame.to_local(to_light));
        let value = bsdf.eval(wo, wi);
        if value.max_element() <= 0.0 || (self.mapped && !self.keeps_side(to_light)) {
            return None;
        }
        Some((value, bsdf.pdf(wo, wi)))
    }

    /// Whether a normal map carries no light from `to_light` through the surface.
    fn keeps_side(&self, to_light: Vec3) -> bool {
        to_light.dot(self.at.shading) * self.frame.n.dot(to_light) > 0.0
    }
}

/// The share of light that reaches the end of a ray.
fn reaches(world: &World, ray: Ray) -> f32 {
    if !world.features.opacity {
        return if world.accel.occluded(&ray) { 0.0 } else { 1.0 };
    }
    let mut rest = Dimmed { ray, share: 1.0 };
    for _ in 0..=PASSAGES {
        let Some(hit) = world.accel.closest(&rest.ray) else { return rest.share };
        if !rest.pass(world, &hit) {
            return rest.share;
        }
    }
    0.0
}
