//! Views of HDRIs: what a camera in the middle of one sees, rendered as generated scenes are.

use tauflow_contract::{Context, Digest, KindError};
use tauflow_data::{
    Image, Resolution,
    maths::{cos, sin},
    records::PictureStatistics,
    rng::Stream,
    scene::{Camera, Emitter, IDENTITY, Scene},
};
use tauflow_render::{
    picture_statistics::{Noise, measure},
    render::Renderer,
    world::World,
};

/// Views of each HDRI.
const VIEWS: usize = 24;
/// Pixels a side.
const SIDE: u32 = 64;
/// Samples per pixel, as many as references of generated scenes have.
const SPP: u64 = 512;
/// Degrees that a view looks up or down by at most.
const PITCH: f64 = 25.0;
/// Seed of where views look.
const SEED: u64 = 17;

/// An HDRI.
pub struct Panorama {
    /// Its file's name.
    pub name: String,
    /// Views of it.
    pub views: Vec<View>,
}

/// A view.
pub struct View {
    /// Linear radiance.
    pub image: Image,
    /// What was measured of it.
    pub statistics: PictureStatistics,
}

/// True if a map of so many texels around has one for each pixel, or more, of the narrowest view.
pub fn resolves(texels: usize, fov: [f64; 2]) -> bool {
    texels as f64 * fov[0] >= 360.0 * f64::from(SIDE)
}

/// The views of a map. Where they look is decided by its name.
///
/// # Errors
/// If the map is not in the store, or is no environment.
pub fn cut(name: &str, map: Digest, fov: [f64; 2], ctx: &Context<'_>) -> Result<Vec<View>, KindError> {
    let mut draw = Stream::new(SEED, &[]).part(name);
    let film = Resolution::new(SIDE, SIDE).map_err(|e| KindError::Internal(e.to_string()))?;
    (0..VIEWS)
        .map(|index| {
            let turn = draw.range(0.0, std::f64::consts::TAU);
            let pitch = draw.range(-PITCH, PITCH).to_radians();
            let target = [cos(turn) * cos(pitch), sin(pitch), sin(turn) * cos(pitch)];
            let fov_x = draw.range(fov[0], fov[1]);
            let scene = Scene {
                hide_emitters: false,
                version: 1,
                seed: index as u64,
                camera: Camera { origin: [0.0; 3], target, up: [0.0, 1.0, 0.0], fov_x, near: 0.0 },
                max_depth: 1,
                shapes: Vec::new(),
                materials: Vec::new(),
                emitters: vec![Emitter::Envmap { image: map, scale: 1.0, to_world: IDENTITY }],
            };
            let world = World::new(&scene, &mut |digest: &Digest| ctx.get(digest))?;
            let renderer = Renderer::new(&world, film, 0)?;
            let mut accumulator = renderer.begin();
            renderer.advance(&mut accumulator, SPP, &mut |_| Ok(()))?;
            let image = accumulator.mean();
            let statistics = measure(&image, Some(Noise { variance: &accumulator.variance(), spp: SPP }));
            Ok(View { image, statistics })
        })
        .collect()
}
