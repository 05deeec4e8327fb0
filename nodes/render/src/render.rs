//! Rendering samples of a whole film, on as many threads as there are; the result does not depend on how many.

use crate::{
    accumulator::Accumulator,
    camera::Camera,
    dispatch::kernels,
    integrator::Integrator,
    rng::{FILM, Sampler, render_state},
    stream::{Batch, trace},
    until::{Until, relative_error},
    world::{Dropped, LoadBlob, World},
};
use rayon::prelude::*;
use tauflow_contract::KindError;
use tauflow_data::{Image, Resolution, SamplerKind, scene::Scene};
use tauflow_instructions::Instructions;

/// Paths in a batch: enough for many lanes of each material, few enough for the cache of a core.
const BATCH: usize = 4096;
/// Samples of a pixel in a batch: rays that go nearly the same way, next to each other.
const TOGETHER: u64 = 64;
/// Pixels in a tile at least, however many samples they get.
const TILE: usize = 16;
/// Paths between looks at whether to stop.
const CHUNK: u64 = 1 << 18;

/// A world, and the film to render it on.
pub struct Renderer<'a> {
    world: &'a World,
    camera: Camera,
    width: usize,
    height: usize,
    stream: u64,
    sampler: SamplerKind,
    integrator: Integrator,
    instructions: Instructions,
}

impl<'a> Renderer<'a> {
    /// A renderer of the samples of `stream`.
    ///
    /// # Errors
    /// If the camera looks nowhere.
    pub fn new(world: &'a World, film: Resolution, stream: u64) -> Result<Self, KindError> {
        let (width, height) = (film.width(), film.height());
        let camera = Camera::new(&world.camera, width, height)?;
        Ok(Self {
            world,
            camera,
            width,
            height,
            stream,
            sampler: SamplerKind::Independent,
            integrator: Integrator::default(),
            instructions: Instructions::best(),
        })
    }

    /// The same, with samples drawn in another way.
    pub fn with_sampler(mut self, sampler: SamplerKind) -> Self {
        self.sampler = sampler;
        self
    }

    /// The same, with another integrator.
    pub fn with_integrator(mut self, integrator: impl Into<Integrator>) -> Self {
        self.integrator = integrator.into();
        self
    }

    /// The same by other instructions; without effect on the result.
    pub fn with_instructions(mut self, instructions: Instructions) -> Self {
        self.instructions = instructions;
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

    /// The ray through the middle of a pixel.
    pub(crate) fn middle_ray(&self, pixel: (u32, u32)) -> crate::geometry::Ray {
        self.camera.ray(pixel.0, pixel.1, glam::Vec2::splat(0.5))
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

    /// Samples a pixel between looks at whether to stop.
    fn step(&self) -> u64 {
        (CHUNK / (self.width * self.height) as u64).max(1)
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
        let step = self.step();
        while accumulator.count < count {
            pause(accumulator.count)?;
            let until = (accumulator.count + step).min(count);
            self.render(accumulator, until);
        }
        Ok(())
    }

    fn render(&self, accumulator: &mut Accumulator, until: u64) {
        let Integrator::Path(path) = self.integrator;
        let (state, sampler) = (render_state(self.world.seed, self.stream), self.sampler);
        let from = accumulator.count;
        let together = (until - from).min(TOGETHER);
        // Enough tiles for every thread, if the film is small and the samples are few.
        let spread = accumulator.pixels.len().div_ceil(4 * rayon::current_num_threads());
        let tile = (BATCH / together as usize).min(spread).max(TILE);
        let (segments, rejected) = accumulator
            .pixels
            .par_chunks_mut(tile)
            .enumerate()
            .map(|(task, pixels)| {
                let (mut segments, mut rejected) = (0u64, 0u64);
                let mut paths = Vec::with_capacity(pixels.len() * together as usize);
                let mut first = from;
                while first < until {
                    let last = (first + together).min(until);
                    paths.clear();
                    for offset in 0..pixels.len() {
                        let pixel = self.pixel(task * tile + offset);
                        paths.extend((first..last).map(|index| (pixel, Sampler::new(sampler, state, pixel, index))));
                    }
                    let (world, camera) = (self.world, &self.camera);
                    let batch = Batch { world, camera, path, sampler, paths: &paths };
                    let found = trace(&batch, kernels(self.instructions));
                    segments += found.segments;
                    rejected += found.rejected;
                    for (target, samples) in pixels.iter_mut().zip(found.radiance.chunks_exact((last - first) as usize))
                    {
                        for (index, sample) in (first..last).zip(samples) {
                            target.add(index, sample.to_array());
                        }
                    }
                    first = last;
                }
                (segments, rejected)
            })
            .reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        accumulator.segments += segments;
        accumulator.rejected += rejected;
        accumulator.count = until;
    }
}

/// When an image is done.
pub enum Goal<'a> {
    /// After so many samples a pixel.
    Samples(u64),
    /// When it is as accurate as is asked for, as samples of other streams say.
    Error(Until),
    /// When this says no more, asked with the samples that there are.
    While(&'a mut dyn FnMut(u64) -> bool),
}

/// What [`render_image`] says of its work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderStats {
    /// Samples a pixel.
    pub samples: u64,
    /// Paths traced, those that decided not counted.
    pub paths: u64,
    /// Mean segments of a path.
    pub mean_path_length: f64,
    /// Contributions that were not finite.
    pub rejected: u64,
    /// Primitives in the scene.
    pub primitives: usize,
    /// What was left out at loading.
    pub dropped: Dropped,
    /// Root mean square of the relative errors to be expected, as [`relative_error`] has it: by the samples that
    /// decided, or else by the image's own; none of one sample.
    pub error: Option<f64>,
}

/// Renders a scene outside a pipeline: the mean of samples of stream 0. `progress` is called now and then with the
/// samples done, and may stop the render with an error.
///
/// # Errors
/// If the scene cannot be compiled, or `progress` says to stop.
pub fn render_image(
    scene: &Scene,
    load: LoadBlob<'_>,
    film: Resolution,
    goal: Goal<'_>,
    progress: &mut dyn FnMut(u64) -> Result<(), KindError>,
) -> Result<(Image, RenderStats), KindError> {
    let world = World::new(scene, load)?;
    let renderer = Renderer::new(&world, film, 0)?;
    let mut accumulator = renderer.begin();
    let mut error = None;
    match goal {
        Goal::Samples(samples) => renderer.advance(&mut accumulator, samples, progress)?,
        Goal::Error(until) => {
            let begin = || renderer.begin();
            let (stop, expected) = until.decide(0, 1, begin, |state, stream, trial| {
                Renderer::new(&world, film, stream)?.advance(state, trial, &mut |_| progress(0))
            })?;
            error = Some(expected);
            renderer.advance(&mut accumulator, stop, progress)?;
        }
        Goal::While(goes_on) => {
            let step = renderer.step();
            while goes_on(accumulator.count) {
                let until = accumulator.count.saturating_add(step);
                renderer.advance(&mut accumulator, until, progress)?;
            }
        }
    }
    if error.is_none() && accumulator.count > 1 {
        error = Some(relative_error([&accumulator; 2], accumulator.count));
    }
    let stats = RenderStats {
        samples: accumulator.count,
        paths: accumulator.count * (film.width() * film.height()) as u64,
        mean_path_length: accumulator.mean_path_length(),
        rejected: accumulator.rejected,
        primitives: world.primitive_count(),
        dropped: world.dropped,
        error,
    };
    Ok((accumulator.mean(), stats))
}
