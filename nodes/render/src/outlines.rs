//! Where surfaces end in a picture: jumps of depth and creases of what the pixels' middles show.

use crate::{
    integrator::first_solid,
    render::Renderer,
    rng::{Sampler, render_state},
};
use glam::Vec3;
use tauflow_data::{SamplerKind, bins::pairs};

/// Label that parts these samples from those of the render.
const STREAM: u64 = 0x6f75_746c;
/// How far neighbouring points lie off each other's planes at a jump, over the distance of the nearer.
const JUMP: f32 = 0.1;
/// Cosine of the angle between normals at a crease: 30 degrees.
const CREASE: f32 = 0.866_025_4;

/// The surface at the centre of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PixelSurface {
    /// The point.
    pub at: Vec3,
    /// Unit geometric normal.
    pub geometric: Vec3,
    /// Unit shading normal.
    pub shading: Vec3,
    /// From the camera.
    pub distance: f32,
}

/// How far two points with normals lie off each other's planes: the farther of the two. However steeply one looks at
/// it, a plane has 0.
pub(crate) fn off_planes((a, of_a): (Vec3, Vec3), (b, of_b): (Vec3, Vec3)) -> f32 {
    of_a.dot(b - a).abs().max(of_b.dot(b - a).abs())
}

/// The surface at the centre of each pixel, row by row; none without a surface.
pub(crate) fn seen(renderer: &Renderer<'_>) -> Vec<Option<PixelSurface>> {
    let (width, height) = renderer.size();
    let world = renderer.world();
    let state = tauflow_data::rng::mix(render_state(world.seed, 0), STREAM);
    let of = |index: usize| {
        let pixel = renderer.pixel(index);
        // Samples decide alone whether what lets part of the light through is met.
        let sampler = Sampler::new(SamplerKind::Independent, state, pixel, 0);
        let ray = renderer.middle_ray(pixel);
        let (hit, at) = first_solid(world, &sampler, 0, ray)?;
        let shading = world.shading_frame(&hit, world.place(hit.primitive).1, &at, -ray.direction).n;
        Some(PixelSurface { at: at.p, geometric: at.geometric, shading, distance: hit.t })
    };
    (0..width * height).map(of).collect()
}

/// Share of neighbouring pixels that have a jump of depth between them, and of those that have a crease.
pub(crate) fn discontinuities(width: usize, seen: &[Option<PixelSurface>]) -> [f64; 2] {
    let (mut all, mut jumps, mut creases) = (0usize, 0usize, 0usize);
    for (a, b) in pairs(width, seen.len() / width) {
        all += 1;
        match (&seen[a], &seen[b]) {
            (Some(a), Some(b)) => {
                let off = off_planes((a.at, a.geometric), (b.at, b.geometric));
                jumps += usize::from(off > JUMP * a.distance.min(b.distance));
                creases += usize::from(a.shading.dot(b.shading) <= CREASE);
            }
            (None, None) => {}
            _ => jumps += 1,
        }
    }
    [jumps, creases].map(|count| count as f64 / all.max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        scenes::{Built, film, level},
        world::World,
    };
    use tauflow_data::scene::Geometry;

    /// Discontinuities in a picture of 16 x 16 pixels.
    fn measured(built: &Built) -> [f64; 2] {
        let world = World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene");
        let renderer = Renderer::new(&world, film(16, 16), 0).expect("a camera that looks somewhere");
        discontinuities(16, &seen(&renderer))
    }

    /// A white square of half side `half` in the plane z = `z`, facing the camera.
    fn wall(built: &mut Built, half: f64, z: f64) {
        let white = built.diffuse([0.5; 3]);
        built.shape(Geometry::Rectangle, [[half, 0.0, 0.0, 0.0], [0.0, half, 0.0, 0.0], [0.0, 0.0, 1.0, z]], white);
    }

    /// All neighbours of 16 x 16 pixels.
    const PAIRS: f64 = 480.0;

    #[test]
    fn a_plane_has_none_however_steeply_it_is_seen() {
        let mut floor = Built::new([0.0, 0.3, 0.0], [0.0, 0.1, -1.0], 60.0, 4);
        let white = floor.diffuse([0.5; 3]);
        floor.shape(Geometry::Rectangle, level(1e3, [0.0; 3], true), white);
        let [jumps, creases] = measured(&floor);
        // Where it ends before the sky, all across the picture, and nowhere else.
        assert_eq!((jumps, creases), (16.0 / PAIRS, 0.0));
    }

    #[test]
    fn jumps_are_counted_along_the_outline() {
        // Eight pixels across at half the distance of the wall behind, which fills the picture.
        let mut built = Built::new([0.0, 0.0, 4.0], [0.0; 3], 90.0, 4);
        wall(&mut built, 100.0, 0.0);
        assert_eq!(measured(&built), [0.0, 0.0]);
        wall(&mut built, 1.0, 2.0);
        assert_eq!(measured(&built), [32.0 / PAIRS, 0.0]);
        // What lies nearly on the wall has no depth.
        let mut near = Built::new([0.0, 0.0, 4.0], [0.0; 3], 90.0, 4);
        wall(&mut near, 100.0, 0.0);
        wall(&mut near, 2.0, 0.2);
        assert_eq!(measured(&near), [0.0, 0.0]);
    }

    #[test]
    fn a_corner_is_a_crease_and_no_jump() {
        // Two walls that meet at a right angle in the middle of the picture.
        let mut built = Built::new([0.0, 0.0, 3.0], [0.0; 3], 40.0, 4);
        let white = built.diffuse([0.5; 3]);
        for side in [-1.0, 1.0] {
            let half = std::f64::consts::FRAC_1_SQRT_2 * 5.0;
            // From the corner towards the camera, to one side; the other edge is upright.
            let along = [side * half, 0.0, half];
            let normal = [-side, 0.0, 1.0].map(|v: f64| v * std::f64::consts::FRAC_1_SQRT_2);
            let up = 5.0 * side;
            let place =
                [[along[0], 0.0, normal[0], along[0]], [0.0, up, normal[1], 0.0], [along[2], 0.0, normal[2], along[2]]];
            built.shape(Geometry::Rectangle, place, white);
        }
        assert_eq!(measured(&built), [0.0, 16.0 / PAIRS]);
    }
}
