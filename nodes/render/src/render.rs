//! Rendering samples of a whole film, on as many threads as there are; the result does not depend on how many.

use crate::{
    accumulator::Accumulator,
    camera::Camera,
    integrator::{Strategy, trace},
    rng::{Sampler, render_state},
    world::{Dropped, LoadBlob, World},
};
use rayon::prelude::*;
use tauflow_contract::KindError;
use tauflow_data::{Image, scene::Scene};

/// Dimension of a sample's place in its pixel.
const FILM: u64 = 0;
/// Pixels that one task renders.
const TASK: usize = 64;
/// Samples between looks at whether to stop.
const CHUNK: u64 = 1 << 18;
/// Longest side of a film.
pub const MAX_SIDE: usize = 16_384;

/// A world, and the film to render it on.
pub struct Renderer<'a> {
    world: &'a World,
    camera: Camera,
    width: usize,
    height: usize,
    stream: u64,
    strategy: Strategy,
}

impl<'a> Renderer<'a> {
    /// A renderer of the samples of `stream`.
    ///
    /// # Errors
    /// If the film is empty or too large, or the camera looks nowhere.
    pub fn new(world: &'a World, width: usize, height: usize, stream: u64) -> Result<Self, KindError> {
        if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
            return Err(KindError::Input(format!(
                "a film of {width} x {height} pixels; use sides from 1 to {MAX_SIDE}"
            )));
        }
        let camera = Camera::new(&world.camera, width, height)?;
        Ok(Self { world, camera, width, height, stream, strategy: Strategy::Mis })
    }

    /// The same, with another way of finding light.
    pub fn with_strategy(mut self, strategy: Strategy) -> Self {
        self.strategy = strategy;
        self
    }

    /// The world.
    pub fn world(&self) -> &World {
        self.world
    }

    pub(crate) fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    pub(crate) fn camera_ray(&self, sampler: &Sampler, pixel: (u32, u32)) -> crate::geometry::Ray {
        self.camera.ray(pixel.0, pixel.1, sampler.two(FILM))
    }

    pub(crate) fn seen(&self, direction: glam::Vec3) -> glam::Vec3 {
        self.camera.seen(direction)
    }

    pub(crate) fn pixel(&self, index: usize) -> (u32, u32) {
        ((index % self.width) as u32, (index / self.width) as u32)
    }

    /// An accumulator without samples.
    pub fn begin(&self) -> Accumulator {
        Accumulator::new(self.width, self.height)
    }

    /// Renders samples until each pixel has `count`; `pause` is called between chunks with the samples there are.
    ///
    /// # Errors
    /// What `pause` returns; the accumulator then holds fewer samples, and can be continued.
    pub fn advance(
        &self,
        accumulator: &mut Accumulator,
        count: u64,
        pause: &mut dyn FnMut(u64) -> Result<(), KindError>,
    ) -> Result<(), KindError> {
        let step = (CHUNK / (self.width * self.height) as u64).max(1);
        while accumulator.count < count {
            pause(accumulator.count)?;
            let until = (accumulator.count + step).min(count);
            self.render(accumulator, until);
        }
        Ok(())
    }

    fn render(&self, accumulator: &mut Accumulator, until: u64) {
        let state = render_state(self.world.seed, self.stream);
        let from = accumulator.count;
        let (segments, rejected) = accumulator
            .pixels
            .par_chunks_mut(TASK)
            .enumerate()
            .map(|(task, pixels)| {
                let (mut segments, mut rejected) = (0u64, 0u64);
                for (offset, target) in pixels.iter_mut().enumerate() {
                    let pixel = self.pixel(task * TASK + offset);
                    for index in from..until {
                        let sampler = Sampler::new(state, pixel, index);
                        let path = trace(self.world, &sampler, self.camera_ray(&sampler, pixel), self.strategy);
                        segments += u64::from(path.segments);
                        rejected += u64::from(path.rejected);
                        target.add(index, path.radiance.to_array());
                    }
                }
                (segments, rejected)
            })
            .reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        accumulator.segments += segments;
        accumulator.rejected += rejected;
        accumulator.count = until;
    }
}

/// What [`render_image`] says of its work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderStats {
    /// Paths traced.
    pub paths: u64,
    /// Mean segments of a path.
    pub mean_path_length: f64,
    /// Contributions that were not finite.
    pub rejected: u64,
    /// Primitives in the scene.
    pub primitives: usize,
    /// What was left out at loading.
    pub dropped: Dropped,
}

/// Renders a scene outside a pipeline: the mean of samples 0..`spp` of stream 0. `progress` is called now and then with
/// the samples done, and may stop the render with an error.
///
/// # Errors
/// If the scene cannot be compiled, or `progress` says to stop.
pub fn render_image(
    scene: &Scene,
    load: LoadBlob<'_>,
    size: (usize, usize),
    spp: u64,
    progress: &mut dyn FnMut(u64) -> Result<(), KindError>,
) -> Result<(Image, RenderStats), KindError> {
    let world = World::new(scene, load)?;
    let renderer = Renderer::new(&world, size.0, size.1, 0)?;
    let mut accumulator = renderer.begin();
    renderer.advance(&mut accumulator, spp, progress)?;
    let stats = RenderStats {
        paths: accumulator.count * (size.0 * size.1) as u64,
        mean_path_length: accumulator.mean_path_length(),
        rejected: accumulator.rejected,
        primitives: world.primitive_count(),
        dropped: world.dropped,
    };
    Ok((accumulator.mean(), stats))
}
