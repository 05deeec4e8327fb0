//! Rendering samples of a whole film, on as many threads as there are; the result does not depend on how many.

use crate::{
    accumulator::Accumulator,
    camera::Camera,
    choices::Choices,
    dispatch::kernels,
    gbuffer::GBufferSurface,
    integrator::{Integrator, LightPaths, Plan, Which},
    rng::{FILM, Sampler, render_state},
    stream::{Batch, trace},
    until::{self, Until, relative_error},
    world::{Dropped, LoadBlob, World},
};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::sync::{Arc, OnceLock};
use tauflow_contract::KindError;
use tauflow_data::{Image, IntegratorKind, Resolution, SamplerKind, records::GBuffer, scene::Scene};
use tauflow_instructions::Instructions;

/// Paths in a batch: enough for many lanes of each material, few enough for the cache of a core.
const BATCH: usize = 4096;
/// Samples of a pixel in a batch: rays that go nearly the same way, next to each other.
const TOGETHER: u64 = 64;
/// Pixels in a tile at least, however many samples they get.
const TILE: usize = 16;
/// Paths between looks at whether to stop.
const CHUNK: u64 = 1 << 18;

/// How light paths are traced, for renderers of one world, film and integrator: worked out by the first that needs it.
#[derive(Clone, Default)]
pub struct SharedPlan(Arc<OnceLock<Option<Plan>>>);

/// A world, and the film to render it on.
pub struct Renderer<'a> {
    world: &'a World,
    camera: Camera,
    width: usize,
    height: usize,
    stream: u64,
    sampler: SamplerKind,
    integrator: Integrator,
    plan: SharedPlan,
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
            plan: SharedPlan::default(),
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
        self.plan = SharedPlan::default();
        self
    }

    /// The same, with the plan of other renderers of this world, film and integrator; without effect on the result.
    pub fn sharing(mut self, plan: &SharedPlan) -> Self {
        self.plan = plan.clone();
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
        self.camera.ray(pixel.0, pixel.1, Vec2::splat(0.5))
    }

    pub(crate) fn seen(&self, direction: Vec3) -> Vec3 {
        self.camera.seen(direction)
    }

    pub(crate) fn pixel(&self, index: usize) -> (u32, u32) {
        ((index % self.width) as u32, (index / self.width) as u32)
    }

    /// An accumulator without samples.
    pub fn begin(&self) -> Accumulator {
        Accumulator::new(self.width, self.height)
    }

    /// Samples per pixel between looks at whether to stop.
    fn step(&self) -> u64 {
        (CHUNK / (self.width * self.height) as u64).max(1)
    }

    /// Renders samples until each pixel has `count`; `pause` is called between chunks with the samples there are.
    ///
    /// # Errors
    /// Returns the error of `pause`; the accumulator then contains fewer samples, and can be continued.
    pub fn advance(
        &self,
        accumulator: &mut Accumulator,
        count: u64,
        pause: &mut dyn FnMut(u64) -> Result<(), KindError>,
    ) -> Result<(), KindError> {
        let step = self.step();
        let features = &self.world.features;
        let unsuited = features.hidden_emitters || features.view_dependent_normals;
        if unsuited && self.integrator.parts(self.world.max_depth).2.is_some() {
            let what = "paths from the lights support neither `hide_emitters` nor normal and bump maps with \
                        `flip_invalid_normals` or `use_shadowing_function`; use `integrator: path`";
            return Err(KindError::Input(what.into()));
        }
        while accumulator.count < count {
            pause(accumulator.count)?;
            let until = (accumulator.count + step).min(count);
            self.render(accumulator, until);
        }
        Ok(())
    }

    fn render(&self, accumulator: &mut Accumulator, until: u64) {
        let (path, depth, which) = self.integrator.parts(self.world.max_depth);
        let (state, sampler) = (render_state(self.world.seed, self.stream), self.sampler);
        let from = accumulator.count;
        let plan = which.and_then(|which| self.plan(which).map(|plan| (which, plan)));
        let splats = plan.map(|(which, plan)| self.light_paths(which, plan).trace(from..until));
        let light_paths = plan.filter(|(which, _)| *which == Which::Joined).map(|(_, plan)| plan);
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
                    let batch = Batch { world, camera, path, depth, light_paths, sampler, paths: &paths };
                    let found = trace(&batch, kernels(self.instructions));
                    segments += found.segments;
                    rejected += found.rejected;
                    let samples = found.radiance.chunks_exact((last - first) as usize);
                    for (offset, (target, samples)) in pixels.iter_mut().zip(samples).enumerate() {
                        let splats = splats.as_ref().map(|splats| splats.of(task * tile + offset));
                        for (index, sample) in (first..last).zip(samples) {
                            let more = splats.map_or(Vec3::ZERO, |splats| splats[(index - from) as usize]);
                            target.add(index, (*sample + more).to_array());
                        }
                    }
                    first = last;
                }
                (segments, rejected)
            })
            .reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        let (further, missed) = splats.map_or((0, 0), |splats| (splats.segments, splats.rejected));
        accumulator.segments += segments + further;
        accumulator.rejected += rejected + missed;
        accumulator.count = until;
    }

    /// How light paths are traced, worked out once.
    fn plan(&self, which: Which) -> Option<&Plan> {
        let SharedPlan(plan) = &self.plan;
        if plan.get().is_none() {
            // Not within the lock: the paths by which it is worked out run on other threads, too.
            let _ = plan.set(Plan::new(which, self.world, &self.camera, self.size())); // all are the same
        }
        plan.get()?.as_ref()
    }

    fn light_paths<'b>(&'b self, which: Which, plan: &'b Plan) -> LightPaths<'b> {
        let (size, stream, sampler) = ((self.width, self.height), self.stream, self.sampler);
        LightPaths { world: self.world, camera: &self.camera, size, stream, sampler, which, plan }
    }
}

/// When an image is done.
pub enum Goal<'a> {
    /// After so many samples per pixel.
    Samples(u64),
    /// When it is as accurate as is asked for, as samples of other streams say, and has so many samples at least.
    Error(Until, u64),
    /// When this says no more, asked with the samples that there are.
    While(&'a mut dyn FnMut(u64) -> bool),
}

/// How an image is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// Its pixels.
    pub film: Resolution,
    /// How samples are drawn.
    pub sampler: SamplerKind,
    /// What estimates radiance.
    pub integrator: IntegratorKind,
    /// How lobes of `principled` materials and lights are chosen.
    pub choices: Choices,
    /// Samples per pixel of its G-buffer, if it is to have one.
    pub gbuffer_samples: Option<u64>,
}

impl Setup {
    /// A film, and all else as by default.
    pub fn new(film: Resolution) -> Self {
        let (sampler, integrator) = (SamplerKind::default(), IntegratorKind::default());
        Self { film, sampler, integrator, choices: Choices::default(), gbuffer_samples: None }
    }
}

/// What there is of an image on its way.
#[derive(Clone, Copy, Debug)]
pub enum Stage<'a> {
    /// The scene is ready to be rendered: its meshes and pictures are read.
    Ready,
    /// Samples of other streams decide how many it takes.
    Deciding,
    /// Samples of the image, and how many there will be, if that is known.
    Samples(&'a Accumulator, Option<u64>),
    /// Samples of the G-buffer, and how many there will be.
    Features(u64, u64),
}

/// An image, and what is known of it.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// Linear radiance.
    pub image: Image,
    /// Variance of single samples.
    pub variance: Image,
    /// Its G-buffer, if it was asked for.
    pub gbuffer: Option<GBuffer>,
    /// What it took.
    pub stats: RenderStats,
}

/// What [`render_image`] says of its work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderStats {
    /// Samples per pixel.
    pub samples: u64,
    /// Paths traced, those that decided not counted.
    pub paths: u64,
    /// Mean segments of a path.
    pub mean_path_length: f64,
    /// Contributions that were not finite.
    pub rejected: u64,
    /// Primitives in the scene.
    pub primitives: usize,
    /// Parts that were discarded at loading.
    pub dropped: Dropped,
    /// Root mean square of the relative errors to be expected, as [`relative_error`] has it: by the samples that
    /// decided, or else by the image's own. None of one sample, of samples that depend on each other, and where no
    /// light was found.
    pub error: Option<f64>,
}

/// Renders a scene outside a pipeline: the mean of samples of stream 0. `watch` sees it now and then, and may stop the
/// render with an error.
///
/// # Errors
/// If the scene cannot be compiled, or `watch` says to stop.
pub fn render_image(
    scene: &Scene,
    load: LoadBlob<'_>,
    setup: Setup,
    goal: Goal<'_>,
    watch: &mut dyn FnMut(Stage<'_>) -> Result<(), KindError>,
) -> Result<Rendered, KindError> {
    let Setup { film, sampler, integrator, choices, gbuffer_samples } = setup;
    let world = World::new(scene, load)?.with_choices(choices);
    let plan = SharedPlan::default();
    let on = |stream| -> Result<Renderer<'_>, KindError> {
        let renderer = Renderer::new(&world, film, stream)?;
        Ok(renderer.with_sampler(sampler).with_integrator(integrator).sharing(&plan))
    };
    let renderer = on(0)?;
    watch(Stage::Ready)?;
    let mut accumulator = renderer.begin();
    let mut decided = None;
    let mut all = None;
    let mut goes_on: &mut dyn FnMut(u64) -> bool = &mut |_| true;
    match goal {
        Goal::Samples(samples) => all = Some(samples),
        Goal::Error(until, at_least) => {
            let begin = || renderer.begin();
            let (stop, expected) = until.decide(0, 1, begin, |state, stream, trial| {
                on(stream)?.advance(state, trial, &mut |_| watch(Stage::Deciding))
            })?;
            let (stop, expected) = until.least(stop, at_least, expected);
            (all, decided) = (Some(stop), Some(expected));
        }
        Goal::While(asked) => goes_on = asked,
    }
    while all.map_or_else(|| goes_on(accumulator.count), |all| accumulator.count < all) {
        let until = accumulator.count.saturating_add(renderer.step()).min(all.unwrap_or(u64::MAX));
        renderer.advance(&mut accumulator, until, &mut |_| Ok(()))?;
        watch(Stage::Samples(&accumulator, all))?;
    }
    let own = || relative_error([&accumulator; 2], accumulator.count);
    let says = accumulator.count > 1 && sampler.is_independent() && !until::is_black(&accumulator);
    let error = decided.or_else(|| says.then(own)).filter(|error| error.is_finite());
    let gbuffer = match gbuffer_samples {
        Some(samples) => Some(
            renderer.gbuffer((0, GBufferSurface::First), samples, &mut |done| watch(Stage::Features(done, samples)))?,
        ),
        None => None,
    };
    let stats = RenderStats {
        samples: accumulator.count,
        paths: accumulator.count * (film.width() * film.height()) as u64,
        mean_path_length: accumulator.mean_path_length(),
        rejected: accumulator.rejected,
        primitives: world.primitive_count(),
        dropped: world.dropped,
        error,
    };
    Ok(Rendered { image: accumulator.mean(), variance: accumulator.variance(), gbuffer, stats })
}
