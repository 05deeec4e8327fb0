//! Where a camera stands and what fills its frame, found by tracing a few rays: without noise, and at any light.

use crate::{
    geometry::Ray,
    integrator::first_solid,
    outlines::off_planes,
    render::Renderer,
    rng::{Sampler, render_state},
    world::World,
};
use glam::Vec3;
use tauflow_contract::KindError;
use tauflow_data::{
    Resolution, SamplerKind, Scene,
    bins::pairs,
    maths,
    scene::{Bsdf, Shape, Texture},
    statistics::quantile,
};

/// Rays through the longer side of the frame.
pub const SIDE: usize = 48;
/// Rays from the camera to all sides.
const AROUND: usize = 256;
/// Label that parts these samples from those of the render.
const STREAM: u64 = 0x6672_616d;
/// Cosine of the angle that neighbouring normals of one smooth surface differ by at most: 8 degrees.
const SMOOTH: f32 = 0.99;
/// How far neighbouring points of one smooth surface lie off each other's planes at most, over their distance.
const FLAT: f32 = 0.02;

/// The results.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Framing {
    /// Share of all directions in which the camera first meets the back of something that has none: the inside of a
    /// body, or glass from within.
    pub inside: f64,
    /// Share of the frame that is nearer than `near` times the median distance of what is around.
    pub near_share: f64,
    /// Share of the frame that shows no surface.
    pub sky_share: f64,
    /// Share of the frame that one smooth surface fills; glass and mirrors show others, and do not count.
    pub surface_share: f64,
    /// Length of all outlines and creases in the frame, in sides of it.
    pub outlines: f64,
}

/// The hit of a ray through the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct RayHit {
    shape: u32,
    normal: Vec3,
    at: Vec3,
    distance: f32,
    /// One sees others in it, or through it.
    shows_others: bool,
}

/// The hit of a ray in any direction.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Around {
    distance: f32,
    /// The back of a surface that has none.
    inside: bool,
}

/// The rays of a frame, row by row.
struct RayGrid {
    width: usize,
    seen: Vec<Option<RayHit>>,
}

/// Whether one sees other things in a material or through it, more than the surface itself.
fn shows_others(bsdf: &Bsdf) -> bool {
    let constant = |texture: &Texture| match texture {
        Texture::Constant { value } => Some(value[0]),
        _ => None,
    };
    let above = |texture: &Texture, least: f32| constant(texture).is_some_and(|value| value >= least);
    match bsdf {
        Bsdf::Dielectric { .. } | Bsdf::ThinDielectric { .. } => true,
        Bsdf::Conductor { alpha, .. } => *alpha < 0.05,
        Bsdf::Principled { metallic, roughness, spec_trans, .. } => {
            above(spec_trans, 0.5) || above(metallic, 0.5) && constant(roughness).is_some_and(|value| value < 0.2)
        }
        Bsdf::Diffuse { .. } | Bsdf::Plastic { .. } => false,
        Bsdf::Blend { a, b, .. } => shows_others(a) || shows_others(b),
        Bsdf::Finish { alpha: Some(_), inner, .. } => matches!(**inner, Bsdf::Dielectric { .. }),
        Bsdf::Mask { inner, .. }
        | Bsdf::NormalMap { inner, .. }
        | Bsdf::Relief { inner, .. }
        | Bsdf::Finish { inner, .. }
        | Bsdf::TwoSided { inner } => shows_others(inner),
    }
}

/// Whether a material looks the same from behind: who sees its back is in nothing.
fn has_back(bsdf: &Bsdf) -> bool {
    match bsdf {
        Bsdf::TwoSided { .. } | Bsdf::ThinDielectric { .. } => true,
        Bsdf::Mask { inner, .. } | Bsdf::NormalMap { inner, .. } | Bsdf::Relief { inner, .. } => has_back(inner),
        Bsdf::Blend { a, b, .. } => has_back(a) && has_back(b),
        Bsdf::Diffuse { .. }
        | Bsdf::Conductor { .. }
        | Bsdf::Dielectric { .. }
        | Bsdf::Plastic { .. }
        | Bsdf::Finish { .. }
        | Bsdf::Principled { .. } => false,
    }
}

/// The properties of a material that matter for framing rays: its holes.
fn holes(bsdf: &Bsdf) -> Bsdf {
    let plain = || Bsdf::Diffuse { reflectance: Texture::Constant { value: [0.0; 3] } };
    match bsdf {
        Bsdf::Mask { opacity, inner } => Bsdf::Mask { opacity: opacity.clone(), inner: Box::new(holes(inner)) },
        Bsdf::NormalMap { inner, .. } | Bsdf::Relief { inner, .. } | Bsdf::TwoSided { inner } => holes(inner),
        // Holes stand around blends, never within.
        Bsdf::Blend { .. }
        | Bsdf::Diffuse { .. }
        | Bsdf::Conductor { .. }
        | Bsdf::Dielectric { .. }
        | Bsdf::ThinDielectric { .. }
        | Bsdf::Plastic { .. }
        | Bsdf::Finish { .. }
        | Bsdf::Principled { .. } => plain(),
    }
}

/// A scene's surfaces and camera alone, without light and colour: their maps and tables take longer to make than the
/// rays of framing to trace.
pub fn bare(scene: &Scene) -> Scene {
    Scene {
        materials: scene.materials.iter().map(holes).collect(),
        shapes: scene.shapes.iter().map(|shape| Shape { emission: None, ..shape.clone() }).collect(),
        emitters: Vec::new(),
        ..scene.clone()
    }
}

impl Framing {
    /// Traces the rays of a scene whose film has these sides.
    ///
    /// # Errors
    /// If the camera looks nowhere.
    pub fn of(world: &World, scene: &Scene, film: [usize; 2], near: f64) -> Result<Self, KindError> {
        let longest = film[0].max(film[1]).max(1);
        let [width, height] = film.map(|side| (side * SIDE).div_ceil(longest).max(1));
        // No side is longer than `SIDE`.
        let resolution =
            Resolution::new(width as u32, height as u32).map_err(|e| KindError::Internal(e.to_string()))?;
        let renderer = Renderer::new(world, resolution, 0)?;
        let state = tauflow_data::rng::mix(render_state(world.seed, 0), STREAM);
        let material = |shape: u32| &scene.materials[scene.shapes[shape as usize].material];
        let seen = |index: usize| {
            let pixel = renderer.pixel(index);
            let sampler = Sampler::new(SamplerKind::Independent, state, pixel, 0);
            let (hit, at) = first_solid(world, &sampler, 0, renderer.camera_ray(&sampler, pixel))?;
            let others = shows_others(material(at.shape));
            Some(RayHit { shape: at.shape, normal: at.geometric, at: at.p, distance: hit.t, shows_others: others })
        };
        let origin = Vec3::from_array(world.camera.origin.map(|v| v as f32));
        let around = |index: usize| {
            let direction = spiral(index);
            let sampler = Sampler::new(SamplerKind::Independent, state, (index as u32, 0), 1);
            let (hit, at) = first_solid(world, &sampler, 0, Ray::new(origin, direction))?;
            let behind = at.geometric.dot(direction) > 0.0;
            Some(Around { distance: hit.t, inside: behind && !has_back(material(at.shape)) })
        };
        let frame = RayGrid { width, seen: (0..width * height).map(seen).collect() };
        let around: Vec<Option<Around>> = (0..AROUND).map(around).collect();
        Ok(Self::summed(&frame, &around, near))
    }

    fn summed(frame: &RayGrid, around: &[Option<Around>], near: f64) -> Self {
        let share = |count: usize, of: usize| count as f64 / of.max(1) as f64;
        let rays = frame.seen.len();
        let mut distances: Vec<f64> = around.iter().flatten().map(|of| f64::from(of.distance)).collect();
        distances.sort_by(f64::total_cmp);
        let nearest = if distances.is_empty() { 0.0 } else { near * quantile(&distances, 0.5) };
        let is_near = |seen: &&RayHit| f64::from(seen.distance) < nearest;
        let sky = frame.seen.iter().filter(|seen| seen.is_none()).count();
        let largest = frame.surfaces().into_iter().max().unwrap_or(0);
        Self {
            inside: share(around.iter().flatten().filter(|of| of.inside).count(), around.len()),
            near_share: share(frame.seen.iter().flatten().filter(is_near).count(), rays),
            sky_share: share(sky, rays),
            surface_share: share(largest, rays),
            outlines: frame.outlines(),
        }
    }

    /// By name.
    pub fn measures(&self) -> [(&'static str, f64); 5] {
        [
            ("inside", self.inside),
            ("near_share", self.near_share),
            ("sky_share", self.sky_share),
            ("surface_share", self.surface_share),
            ("outlines", self.outlines),
        ]
    }
}

/// Directions spread evenly over the sphere, on a spiral by the golden angle.
fn spiral(index: usize) -> Vec3 {
    let height = 1.0 - (2 * index + 1) as f64 / AROUND as f64;
    let turn = index as f64 * core::f64::consts::PI * (3.0 - 5f64.sqrt());
    let radius = (1.0 - height * height).sqrt();
    Vec3::new((radius * maths::cos(turn)) as f32, height as f32, (radius * maths::sin(turn)) as f32)
}

/// Whether two neighbours are of one smooth surface.
fn joined(a: &RayHit, b: &RayHit) -> bool {
    let off = off_planes((a.at, a.normal), (b.at, b.normal));
    a.shape == b.shape && a.normal.dot(b.normal) > SMOOTH && off <= FLAT * a.distance.min(b.distance)
}

impl RayGrid {
    /// Length of what parts neighbouring rays, in sides of the frame.
    fn outlines(&self) -> f64 {
        let height = self.seen.len() / self.width;
        let parted = |a: usize, b: usize| match (&self.seen[a], &self.seen[b]) {
            (Some(a), Some(b)) => !joined(a, b),
            (a, b) => a.is_some() || b.is_some(),
        };
        let found = pairs(self.width, height).filter(|(a, b)| parted(*a, *b)).count();
        2.0 * found as f64 / (self.width + height) as f64
    }

    /// How many rays meet each smooth surface.
    fn surfaces(&self) -> Vec<usize> {
        let mut visited: Vec<bool> = self.seen.iter().map(|seen| seen.is_none_or(|seen| seen.shows_others)).collect();
        let mut surfaces = Vec::new();
        for start in 0..self.seen.len() {
            if std::mem::replace(&mut visited[start], true) {
                continue;
            }
            let (mut open, mut found) = (vec![start], 0);
            while let Some(at) = open.pop() {
                found += 1;
                let Some(own) = &self.seen[at] else { continue };
                let (x, below) = (at % self.width, at + self.width);
                let beside = [
                    (x > 0).then(|| at - 1),
                    (x + 1 < self.width).then_some(at + 1),
                    at.checked_sub(self.width),
                    (below < self.seen.len()).then_some(below),
                ];
                for next in beside.into_iter().flatten() {
                    if !visited[next] && self.seen[next].as_ref().is_some_and(|other| joined(own, other)) {
                        visited[next] = true;
                        open.push(next);
                    }
                }
            }
            surfaces.push(found);
        }
        surfaces
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{Built, balls_under_sky, room};
    use tauflow_data::scene::Geometry;

    /// A wall one metre ahead, shape 0, and beside it from column `from` on another, shape 1, of another direction.
    fn walls(width: usize, height: usize, from: usize) -> RayGrid {
        let wall = |index: usize| {
            let (x, y) = (index % width, index / width);
            let second = x >= from;
            let normal = if second { Vec3::new(-1.0, 0.0, 0.0) } else { Vec3::new(0.0, 0.0, 1.0) };
            let at = if second { Vec3::new(1.0, y as f32, x as f32) } else { Vec3::new(x as f32, y as f32, -1.0) };
            Some(RayHit { shape: u32::from(second), normal, at, distance: 1.0, shows_others: false })
        };
        RayGrid { width, seen: (0..width * height).map(wall).collect() }
    }

    #[test]
    fn smooth_surfaces_are_found() {
        assert_eq!(walls(10, 4, 10).surfaces(), [40]);
        assert_eq!(walls(10, 4, 7).surfaces(), [28, 12]);
        // A step in depth parts a surface, though both sides face the same way; so does an edge in one shape.
        let mut step = walls(10, 4, 10);
        step.seen.iter_mut().enumerate().filter(|(i, _)| i % 10 >= 6).for_each(|(_, seen)| {
            let seen = seen.as_mut().expect("a wall");
            seen.at.z -= 0.1;
        });
        assert_eq!(step.surfaces(), [24, 16]);
        let mut edge = walls(10, 4, 7);
        edge.seen.iter_mut().flatten().for_each(|seen| seen.shape = 0);
        assert_eq!(edge.surfaces(), [28, 12]);
        // One crease, four rays long, in a frame whose sides have seven on average.
        assert_eq!((edge.outlines(), walls(10, 4, 10).outlines()), (4.0 / 7.0, 0.0));
        // A mirror shows others.
        let mut mirror = walls(10, 4, 7);
        mirror.seen.iter_mut().flatten().for_each(|seen| seen.shows_others = seen.shape == 0);
        assert_eq!(mirror.surfaces(), [12]);
    }

    #[test]
    fn shares_are_of_the_frame_and_of_all_directions() {
        let mut frame = walls(10, 4, 7);
        frame.seen[..10].fill(None);
        frame.seen.iter_mut().flatten().filter(|seen| seen.shape == 1).for_each(|seen| seen.distance = 0.1);
        let around: Vec<Option<Around>> =
            (0..8).map(|i| (i < 6).then_some(Around { distance: 2.0, inside: i < 2 })).collect();
        let found = Framing::summed(&frame, &around, 0.1);
        assert_eq!((found.sky_share, found.inside, found.surface_share), (0.25, 0.25, 21.0 / 40.0));
        // Below 0.1 of 2: a distance of 0.1 is near, one of 1 is not.
        assert_eq!(found.near_share, 9.0 / 40.0);
        assert_eq!(Framing::summed(&frame, &[None, None], 0.1).near_share, 0.0);
    }

    fn framing(built: &Built) -> Framing {
        let of = |scene: &Scene| {
            let world = World::new(scene, &mut |digest| built.load(digest)).expect("a sound scene");
            Framing::of(&world, &built.scene, [64, 48], 0.1).expect("a camera that looks somewhere")
        };
        let found = of(&bare(&built.scene));
        assert_eq!(found, of(&built.scene), "neither light nor colour is looked at");
        found
    }

    #[test]
    fn holes_are_looked_through() {
        let card = |opacity: f32| {
            let mut built = Built::new([0.0; 3], [0.0, 0.0, -1.0], 50.0, 8);
            let inner = Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.5) });
            let mask = built.material(Bsdf::Mask { opacity: Texture::scalar(opacity), inner });
            let at = [[5.0, 0.0, 0.0, 0.0], [0.0, 5.0, 0.0, 0.0], [0.0, 0.0, 5.0, -2.0]];
            built.shape(Geometry::Rectangle, at, mask);
            framing(&built).sky_share
        };
        assert_eq!((card(1.0), card(0.0)), (0.0, 1.0));
    }

    #[test]
    fn cameras_of_good_scenes_stand_in_nothing() {
        for built in [room(), balls_under_sky()] {
            let found = framing(&built);
            assert!(found.inside < 0.3 && found.near_share < 0.1, "{found:?}");
            assert!(found.sky_share < 0.85 && found.surface_share < 0.8 && found.outlines > 1.5, "{found:?}");
        }
        assert!(framing(&room()).sky_share < 0.1 && framing(&balls_under_sky()).sky_share > 0.1);
    }

    #[test]
    fn a_camera_in_a_body_sees_its_inside_but_a_room_is_none() {
        let mut built = Built::new([0.0, 0.0, 0.0], [0.0, 0.0, -1.0], 50.0, 8);
        let white = built.diffuse([0.5; 3]);
        built.sphere([0.0, 0.1, 0.0], 0.5, white);
        assert_eq!((framing(&built).inside, framing(&built).outlines), (1.0, 0.0));
        // Its smooth inside fills the frame; glass would show others.
        assert!(framing(&built).surface_share > 0.95, "{:?}", framing(&built));
        // Painted on both sides it is a round room.
        let mut domed = Built::new([0.0, 0.0, 0.0], [0.0, 0.0, -1.0], 50.0, 8);
        let inner = Box::new(built.scene.materials[white].clone());
        let painted = domed.material(Bsdf::TwoSided { inner });
        domed.sphere([0.0, 0.1, 0.0], 0.5, painted);
        assert_eq!(framing(&domed).inside, 0.0);
        let mut glass = Built::new([0.0, 0.0, 0.0], [0.0, 0.0, -1.0], 50.0, 8);
        let clear = glass.material(Bsdf::Dielectric {
            int_ior: 1.5,
            ext_ior: 1.0,
            alpha: 0.0,
            specular_reflectance: Texture::scalar(1.0),
            specular_transmittance: Texture::scalar(1.0),
        });
        glass.shape(Geometry::Cube, [[0.5, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 0.5, 0.0]], clear);
        let found = framing(&glass);
        assert_eq!((found.inside, found.surface_share), (1.0, 0.0));
    }

    #[test]
    fn what_is_right_before_the_camera_is_near_and_what_looks_as_large_further_off_is_not() {
        // In the middle of a round room of radius 1, a card that fills the frame.
        let with_card = |away: f64| {
            let mut built = Built::new([0.0; 3], [0.0, 0.0, -1.0], 50.0, 8);
            let grey = Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.5) });
            let painted = built.material(Bsdf::TwoSided { inner: grey });
            built.sphere([0.0; 3], 1.0, painted);
            let half = 0.8 * away;
            let card = [[half, 0.0, 0.0, 0.0], [0.0, half, 0.0, 0.0], [0.0, 0.0, 1.0, -away]];
            built.shape(Geometry::Rectangle, card, painted);
            framing(&built)
        };
        let (near, far) = (with_card(0.05), with_card(0.5));
        assert_eq!((near.near_share, far.near_share), (1.0, 0.0), "{near:?} {far:?}");
        assert_eq!((near.surface_share, far.surface_share), (1.0, 1.0), "{near:?} {far:?}");
    }

    #[test]
    fn a_card_before_the_camera_is_one_surface_and_an_empty_sky_is_seen() {
        let mut built = room();
        let grey = built.diffuse([0.5; 3]);
        // A card before the camera that is all there is to be seen: one smooth surface.
        let [x, y, z] = built.scene.camera.origin;
        let card = [[0.2, 0.0, 0.0, x], [0.0, 0.2, 0.0, y], [0.0, 0.0, 1.0, z - 0.02]];
        built.shape(Geometry::Rectangle, card, grey);
        let found = framing(&built);
        assert!(found.surface_share > 0.95, "{found:?}");
        let mut sky = balls_under_sky();
        sky.scene.camera.target = [sky.scene.camera.origin[0] + 0.1, 50.0, sky.scene.camera.origin[2]];
        let found = framing(&sky);
        assert!(found.sky_share > 0.95, "{found:?}");
    }
}
