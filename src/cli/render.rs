//! `tauflow render`: an image of one scene, outside any pipeline.

use super::{
    CacheAt, CliError, Exit,
    scene::{FilmArgs, Opened, SceneArgs, check_picture, is_stream, told, write_layers, write_picture},
    seconds_text, terminal,
    tev::Tev,
};
use crate::{
    kinds::Registry,
    registry::{
        BundledDenoiser, BundledWeights, Choices, DenoiseSettings, Frame, Goal, RenderStats, Rendered, Setup, Stage,
        Until, render_image,
    },
};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use std::{
    path::PathBuf,
    time::{Duration, Instant},
};
use tauflow_contract::KindError;
use tauflow_data::{Image, IntegratorKind, SamplerKind, image_io::ExrLayer, records::GBuffer};

/// How often a viewer gets the image.
const SHOWN_EVERY: Duration = Duration::from_millis(500);

/// Fewest samples that have a variance.
const LEAST_OF_VARIANCE: u64 = 2;

/// Why a single sample is refused.
const ALONE: &str = "one sample per pixel has no variance, which --variance asks for";

/// Arguments of `render`.
#[derive(Args)]
pub(crate) struct RenderArgs {
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    film: FilmArgs,
    /// Image to write: .exr (linear radiance) or .png (preview). A pipe or device, such as /dev/stdout, gets an EXR
    /// unless its name ends in .png.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Multiply the radiance by this factor, from 1e-6 to 5e5.
    #[arg(long, default_value_t = 1.0, value_parser = factor)]
    exposure: f32,
    /// Double the samples until the estimated relative error is at most this value: 0.01 is 1%.
    #[arg(long, value_name = "ERROR", value_parser = above_zero, conflicts_with_all = ["spp", "seconds"])]
    error: Option<f64>,
    /// Maximum number of samples per pixel with --error. Default: 65536.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1 << 30))]
    at_most: Option<u64>,
    /// Sample for this many seconds, not counting the time to read the scene.
    #[arg(long, value_name = "S", value_parser = above_zero, conflicts_with = "spp")]
    seconds: Option<f64>,
    /// How samples are drawn: independently, or from Owen-scrambled Sobol' points (less error at equal samples).
    #[arg(long, value_name = "NAME", default_value = "independent", value_parser = ["independent", "sobol"])]
    sampler: String,
    /// How radiance is estimated: by paths from the camera, or also by paths from the lights, which find caustics.
    #[arg(long, value_name = "NAME", default_value = "path", value_parser = ["path", "bidirectional"])]
    integrator: String,
    /// Add the layers `albedo` (R, G, B) and `normal` (X, Y, Z), which `refine` reads.
    #[arg(long)]
    gbuffer: bool,
    /// Samples per pixel of these layers, and of those for --denoise. Default: 32.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=65536))]
    gbuffer_samples: Option<u64>,
    /// Add the layer `variance`: the variance of single samples. It needs at least 2 samples per pixel.
    #[arg(long)]
    variance: bool,
    /// Denoise the image with the bundled model, as `tauflow denoise` does. An .exr keeps the noisy image as the layer
    /// `noisy`.
    #[arg(long)]
    denoise: bool,
    /// Show the image in the viewer tev while it is rendered.
    #[arg(long, value_name = "HOST:PORT")]
    tev: Option<String>,
}

/// Most samples per pixel with --error.
const AT_MOST: u64 = 65536;

/// Samples per pixel of a G-buffer.
const GBUFFER_SAMPLES: u64 = 32;

fn above_zero(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is not a number"))?;
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err("it must be above 0".to_owned()) }
}

fn factor(text: &str) -> Result<f32, String> {
    let value = above_zero(text)? as f32;
    // Half a million is 19 stops: more would leave no finite numbers of bright pixels and their variances.
    if (1e-6..=5e5).contains(&value) { Ok(value) } else { Err("it must be between 1e-6 and 5e5".to_owned()) }
}

impl RenderArgs {
    fn sampler(&self) -> SamplerKind {
        if self.sampler == "sobol" { SamplerKind::Sobol } else { SamplerKind::Independent }
    }

    fn integrator(&self) -> IntegratorKind {
        if self.integrator == "bidirectional" { IntegratorKind::Bidirectional } else { IntegratorKind::Path }
    }

    /// Checks for conflicting options before anything is rendered.
    fn check(&self) -> Result<(), CliError> {
        check_picture(&self.out)?;
        let bad = |what: String| Err(CliError::Bad(what));
        let png = self.out.extension().is_some_and(|e| e == "png");
        if png && (self.gbuffer || self.variance) {
            let file = self.out.display();
            return bad(format!("{file} has no room for layers; write an .exr, or leave --gbuffer and --variance out"));
        }
        if self.at_most.is_some() && self.error.is_none() {
            return bad("--at-most needs --error, whose samples it limits; --spp sets their number".to_owned());
        }
        if self.gbuffer_samples.is_some() && !(self.gbuffer || self.denoise) {
            return bad("--gbuffer-samples needs --gbuffer or --denoise, which render a G-buffer".to_owned());
        }
        if self.sampler() == SamplerKind::Sobol && (self.error.is_some() || self.variance) {
            return bad("samples of --sampler sobol depend on each other, so that their variance says nothing of the \
                 error; leave --error and --variance out, or use --sampler independent"
                .to_owned());
        }
        let (most, option) = match (self.error, self.seconds) {
            (Some(_), _) => (self.at_most.unwrap_or(AT_MOST), "--at-most"),
            (None, Some(_)) => (u64::MAX, "--seconds"),
            (None, None) => (self.film.spp, "--spp"),
        };
        if self.variance && most < LEAST_OF_VARIANCE {
            return bad(format!("{option} {most}: {ALONE}; raise {option} to 2 or more, or leave --variance out"));
        }
        Ok(())
    }
}

/// The display of a render in progress.
struct Shown<'a> {
    args: &'a RenderArgs,
    bar: ProgressBar,
    viewer: Option<Tev>,
    last: Instant,
}

impl Shown<'_> {
    fn see(&mut self, stage: Stage<'_>) -> Result<(), CliError> {
        match stage {
            Stage::Ready => self.bar.set_message("deciding how many samples it takes"),
            Stage::Deciding => self.bar.tick(),
            Stage::Samples(film, of) => {
                if let Some(of) = of.filter(|of| self.bar.length() != Some(*of)) {
                    self.count_to(of);
                }
                self.bar.set_position(film.count);
                if self.bar.length().is_none() {
                    self.bar.set_message(format!("{} samples per pixel{}", film.count, self.time_left()));
                }
                if self.viewer.is_some() && self.last.elapsed() >= SHOWN_EVERY {
                    self.show(&film.mean())?;
                }
            }
            Stage::Features(done, of) => {
                if done == 0 {
                    self.count_to(of);
                    self.bar.set_message("samples of albedo and normals");
                }
                self.bar.set_position(done);
            }
        }
        Ok(())
    }

    /// From here on it is known how many steps there are, and so the time that is left.
    fn count_to(&mut self, steps: u64) {
        let style = ProgressStyle::with_template("{bar:32} {pos}/{len} {msg}, {eta} left");
        if let Ok(style) = style {
            self.bar.set_style(style);
        }
        self.bar.reset();
        self.bar.set_length(steps);
        self.bar.set_message("samples per pixel");
    }

    fn time_left(&self) -> String {
        let left = |seconds: f64| seconds_text((seconds - self.bar.elapsed().as_secs_f64()).max(0.0));
        self.args.seconds.map_or_else(String::new, |seconds| format!(", {} left", left(seconds)))
    }

    fn show(&mut self, image: &Image) -> Result<(), CliError> {
        if let Some(viewer) = &mut self.viewer {
            viewer.show(&image.map(|v| v * self.args.exposure))?;
        }
        self.last = Instant::now();
        Ok(())
    }
}

pub(crate) fn render(args: &RenderArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    args.check()?;
    let Opened { scene, source, film, inputs } = args.scene.open(&args.film, registry, cache)?;
    inputs.spare(&args.out)?;
    let resolution = args.film.resolution(film)?;
    let name = args.out.display().to_string();
    let size = (resolution.width(), resolution.height());
    let viewer = args.tev.as_ref().map(|address| Tev::connect(address, &name, size)).transpose()?;
    let bar = if terminal::redraws() { ProgressBar::new_spinner() } else { ProgressBar::hidden() };
    bar.set_message("reading meshes and textures");
    bar.tick();
    let mut shown = Shown { args, bar, viewer, last: Instant::now() };
    let begun = Instant::now();
    // Set when the scene is ready: reading it is no part of the time that paths take.
    let ready = std::cell::Cell::new(begun);
    let mut last = Duration::ZERO;
    let least = if args.variance { LEAST_OF_VARIANCE } else { 1 };
    let mut fits = |done: u64| {
        // As many more samples as were taken last must fit, too.
        let (now, limit) = (ready.get().elapsed(), args.seconds.unwrap_or_default());
        let next = now + now.saturating_sub(last);
        last = now;
        done < least || next.as_secs_f64() <= limit
    };
    let goal = match (args.error, args.seconds) {
        (Some(relative_error), _) => Goal::Error(Until::new(relative_error, args.at_most.unwrap_or(AT_MOST)), least),
        (None, Some(_)) => Goal::While(&mut fits),
        (None, None) => Goal::Samples(args.film.spp),
    };
    let setup = Setup {
        film: resolution,
        sampler: args.sampler(),
        integrator: args.integrator(),
        choices: Choices::default(),
        gbuffer_samples: (args.gbuffer || args.denoise).then_some(args.gbuffer_samples.unwrap_or(GBUFFER_SAMPLES)),
    };
    // An error of the viewer is not one of the scene.
    let mut failed = None;
    let mut paths_end = begun;
    let rendered = render_image(&scene, &mut |digest| source.blob(digest), setup, goal, &mut |stage| {
        match stage {
            Stage::Ready => {
                ready.set(Instant::now());
                paths_end = ready.get();
                shown.bar.reset_elapsed();
            }
            Stage::Samples(..) => paths_end = Instant::now(),
            _ => {}
        }
        shown.see(stage).map_err(|error| {
            failed = Some(error);
            KindError::Cancelled
        })
    })
    .map_err(|error| failed.take().unwrap_or_else(|| told(error)))?;
    shown.bar.finish_and_clear();
    shown.show(&rendered.image)?;
    let denoised = if args.denoise { Some(denoised(args, &rendered)?) } else { None };
    write(args, &rendered, denoised)?;
    let (read, paths) = (ready.get() - begun, paths_end - ready.get());
    report(args, &rendered.stats, read.as_secs_f64(), paths.as_secs_f64());
    // A pipe or a device may be stdout itself, and gets the image alone.
    if !is_stream(&args.out) {
        outln!("{}", args.out.display());
    }
    Ok(Exit::Done)
}

/// The image denoised. Independent samples also tell their variance, from two on.
fn denoised(args: &RenderArgs, rendered: &Rendered) -> Result<Image, CliError> {
    let mut frame = Frame::new(rendered.image.clone()).map_err(told)?;
    if let Some(GBuffer { albedo, normal }) = &rendered.gbuffer {
        frame = frame.with_features(albedo.clone(), normal.clone()).map_err(told)?;
    }
    let samples = rendered.stats.samples;
    if samples > 1 && args.sampler() == SamplerKind::Independent {
        frame = frame.with_variance(rendered.variance.map(|v| v / samples as f32), Some(samples)).map_err(told)?;
    }
    for note in frame.notes() {
        terminal::note(note);
    }
    let denoiser = BundledDenoiser::built_in(BundledWeights::Best).map_err(told)?;
    let settings = DenoiseSettings { spp: Some(samples), ..DenoiseSettings::default() };
    let begun = Instant::now();
    let denoised = denoiser.denoise(&frame, &settings, &mut |_, _| Ok(())).map_err(told)?;
    let kept = denoised.kept.map(|share| format!(", {:.1}% of the noisy image kept", 100.0 * share));
    errln!("denoised in {}{}", seconds_text(begun.elapsed().as_secs_f64()), kept.unwrap_or_default());
    Ok(denoised.image)
}

fn write(args: &RenderArgs, rendered: &Rendered, denoised: Option<Image>) -> Result<(), CliError> {
    let noisy = rendered.image.map(|v| v * args.exposure);
    let image = denoised.map(|image| image.map(|v| v * args.exposure));
    let png = args.out.extension().is_some_and(|e| e == "png");
    if png || !(args.gbuffer || args.variance || args.denoise) {
        return write_picture(&args.out, image.as_ref().unwrap_or(&noisy));
    }
    let variance = rendered.variance.map(|v| v * args.exposure * args.exposure);
    let mut layers = vec![ExrLayer::colors("", image.as_ref().unwrap_or(&noisy))];
    if image.is_some() {
        layers.push(ExrLayer::colors("noisy", &noisy));
    }
    if let Some(GBuffer { albedo, normal }) = rendered.gbuffer.as_ref().filter(|_| args.gbuffer) {
        layers.push(ExrLayer::colors(GBuffer::LAYERS[0], albedo));
        layers.push(ExrLayer { letters: &["X", "Y", "Z"], ..ExrLayer::colors(GBuffer::LAYERS[1], normal) });
    }
    if args.variance {
        layers.push(ExrLayer::colors("variance", &variance));
    }
    write_layers(&args.out, &layers)
}

fn report(args: &RenderArgs, stats: &RenderStats, read: f64, seconds: f64) {
    errln!(
        "{} samples per pixel, {} paths in {} ({:.2} million per second), {:.2} segments per path, {} rejected; scene \
         ready after {}",
        stats.samples,
        stats.paths,
        seconds_text(seconds),
        stats.paths as f64 / seconds.max(1e-9) / 1e6,
        stats.mean_path_length,
        stats.rejected,
        seconds_text(read)
    );
    match stats.error {
        Some(error) => errln!("{}", sureness(args.error, error, stats.samples)),
        None if args.error.is_some() => {
            errln!("expected error unknown: no sample found light; check the lights, or render with --spp");
        }
        None => {}
    }
}

/// How far the image is to be expected to be off.
fn sureness(asked: Option<f64>, error: f64, samples: u64) -> String {
    let percent = 100.0 * error;
    match asked {
        Some(asked) if error <= asked => format!("expected error {percent:.2}%, from separate samples"),
        Some(asked) => format!(
            "expected error {percent:.2}%, above the requested {:.2}%: --at-most limits the image to {samples} samples",
            100.0 * asked
        ),
        None => {
            format!("expected error {percent:.2}%, from the image's own samples: higher if rare light was missed")
        }
    }
}
