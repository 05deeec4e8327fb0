//! `tauflow denoise`: cleans rendered images of any renderer with the bundled models.

mod layers;

use super::{
    CliError, Exit, counted,
    inputs::Inputs,
    scene::{check_picture, is_stream, told, write_layers, write_picture},
    seconds_text, terminal,
};
use crate::registry::{BundledDenoiser, BundledWeights, DenoiseSettings, Denoised, Frame, Model};
use clap::Args;
use layers::{Layers, Space, camera_normals};
use std::{
    path::{Path, PathBuf},
    time::Instant,
};
use tauflow_contract::read_regular;
use tauflow_data::{Image, image_io::ExrLayer, views::Views};

/// Most bytes of a model.
const LARGEST: u64 = 1 << 32;

/// Arguments of `denoise`.
#[derive(Args)]
pub(crate) struct DenoiseArgs {
    /// Images to denoise: EXR files of linear radiance, or folders of them. Albedo and normals are used if the file has
    /// them, by the names that Blender, Mitsuba, pbrt, OIDN's examples and tauflow give them.
    #[arg(required = true, value_name = "FILE|FOLDER")]
    images: Vec<PathBuf>,
    /// Image to write: .exr (linear radiance) or .png (exposed preview). A folder for several images.
    #[arg(short, long, value_name = "FILE|FOLDER")]
    out: PathBuf,
    /// Bundled model: `best`, or `fast`, which takes about 0.6 to 0.7 times the time.
    #[arg(long, value_name = "NAME", default_value = "best", value_parser = ["best", "fast"])]
    weights: String,
    /// Model file to use in place of the bundled ones; it must have been trained with `unknown_counts`, or --spp given.
    #[arg(long, value_name = "FILE", conflicts_with = "weights")]
    model: Option<PathBuf>,
    /// Layer of the radiance, if it is not recognised.
    #[arg(long, value_name = "NAME")]
    layer: Option<String>,
    /// EXR file of the albedo.
    #[arg(long, value_name = "FILE", requires = "normal")]
    albedo: Option<PathBuf>,
    /// EXR file of the normals.
    #[arg(long, value_name = "FILE", requires = "albedo")]
    normal: Option<PathBuf>,
    /// Do not use albedo and normals.
    #[arg(long, conflicts_with_all = ["albedo", "normal"])]
    rgb: bool,
    /// Space of the normals.
    #[arg(long, value_name = "SPACE", default_value = "auto")]
    normals: Space,
    /// Layer with the variance of each pixel. The noisy image is mixed in where its estimated error is smaller, in
    /// twice the time. --spp tells how certain the variance is; without it, 32 samples are assumed.
    #[arg(long, value_name = "LAYER")]
    variance: Option<String>,
    /// The layer of --variance holds the variance of single samples, as `tauflow render --variance` and pbrt write it.
    /// It needs an --spp of at least 2.
    #[arg(long, requires_all = ["variance", "spp"])]
    per_sample: bool,
    /// Samples per pixel, if they are known and the same in all pixels. Larger counts than 511 count as unknown.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    spp: Option<u64>,
    /// Share of the denoised image in the result, from 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 1.0, value_parser = share)]
    strength: f64,
    /// Average over 1, 2, 4 or 8 mirrored and rotated copies, in as many times the time.
    #[arg(long, value_name = "N", default_value_t = 1)]
    mirrors: u64,
    /// Exposure factor for the network; the result has the original exposure. Default: 0.18 divided by the geometric
    /// mean luminance of what is not black, or 0.72 if 1% or more is black.
    #[arg(long, value_name = "FACTOR")]
    exposure: Option<f64>,
    /// Side of tiles in pixels. Default: tiles for images above 1.6 million pixels. Results differ only by rounding.
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u64).range(16..=16384))]
    tile: Option<u64>,
}

fn share(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is not a number"))?;
    if (0.0..=1.0).contains(&value) { Ok(value) } else { Err("it goes from 0 to 1".to_owned()) }
}

/// A file to denoise, and where the result goes.
struct Job {
    image: PathBuf,
    out: PathBuf,
}

pub(crate) fn denoise(args: &DenoiseArgs) -> Result<Exit, CliError> {
    if args.per_sample && args.spp == Some(1) {
        let what = "--per-sample --spp 1: one sample per pixel has no variance; leave --variance and --per-sample out";
        return Err(CliError::Bad(what.into()));
    }
    let jobs = jobs(args)?;
    let denoiser = match &args.model {
        None => {
            let weights = BundledWeights::ALL.into_iter().find(|weights| weights.name() == args.weights);
            BundledDenoiser::built_in(weights.expect("one of the names")).map_err(told)?
        }
        Some(path) => {
            let name = path.display();
            let bytes = read_regular(path, LARGEST).map_err(|e| CliError::Bad(format!("cannot read {name}: {e}")))?;
            BundledDenoiser::of(Model::load(&bytes).map_err(|e| CliError::Bad(format!("{name}: {e}")))?)
        }
    };
    let settings = DenoiseSettings {
        spp: args.spp,
        exposure: args.exposure,
        strength: args.strength,
        views: Views::try_from(args.mirrors).map_err(|e| CliError::Bad(format!("--mirrors {}: {e}", args.mirrors)))?,
        tile: args.tile.map(|side| side as usize),
        gbuffer: !args.rgb,
    };
    let mut failed = 0;
    for job in &jobs {
        match one(args, &denoiser, &settings, job) {
            Ok(()) => {}
            // One image that cannot be denoised does not stop the others.
            Err(CliError::Bad(message)) if jobs.len() > 1 => {
                terminal::note(&format!("error: {message}"));
                failed += 1;
            }
            Err(error) => return Err(error),
        }
    }
    if failed == 0 {
        return Ok(Exit::Done);
    }
    errln!("{} of {} failed", failed, counted(jobs.len() as u64, "image"));
    Ok(Exit::Failed)
}

/// The images and where they go.
fn jobs(args: &DenoiseArgs) -> Result<Vec<Job>, CliError> {
    let mut images = Vec::new();
    let mut folders = false;
    for path in &args.images {
        if path.is_dir() {
            folders = true;
            images.extend(images_of(path)?);
        } else {
            images.push(path.clone());
        }
    }
    // Albedo and normals may lie in files beside an image.
    let parts = images.iter().filter_map(|image| beside(image)).flatten();
    let given = [&args.albedo, &args.normal, &args.model].into_iter().flatten().cloned();
    let inputs = Inputs::of(images.iter().cloned().chain(parts).chain(given));
    if let ([image], false, false) = (&images[..], folders, args.out.is_dir()) {
        check_picture(&args.out)?;
        inputs.spare(&args.out)?;
        return Ok(vec![Job { image: image.clone(), out: args.out.clone() }]);
    }
    if args.albedo.is_some() {
        return Err(CliError::Bad("--albedo and --normal are for one image".into()));
    }
    if args.out.exists() && !args.out.is_dir() {
        let out = args.out.display();
        return Err(CliError::Bad(format!("{out} is a file, but there are several images; name a folder with -o")));
    }
    if args.out.extension().is_some_and(|extension| extension == "exr" || extension == "png") {
        return Err(CliError::Bad(format!("{} names one image, but there are several", args.out.display())));
    }
    std::fs::create_dir_all(&args.out)
        .map_err(|e| CliError::Environment(format!("cannot make the folder {}: {e}", args.out.display())))?;
    let mut jobs: Vec<Job> = Vec::new();
    for image in images {
        let out = args.out.join(image.file_name().unwrap_or_default());
        inputs.spare(&out)?;
        if let Some(other) = jobs.iter().find(|job| job.out == out) {
            return Err(CliError::Bad(format!(
                "{} and {} have the same name, so their results would be one file; denoise them one after the other",
                other.image.display(),
                image.display()
            )));
        }
        jobs.push(Job { image, out });
    }
    Ok(jobs)
}

/// Suffixes of the files of OIDN's examples.
const PARTS: [&str; 2] = [".alb.exr", ".nrm.exr"];

/// The images of a folder, by name, without files of albedo and normals.
fn images_of(folder: &Path) -> Result<Vec<PathBuf>, CliError> {
    let failed = |e: std::io::Error| CliError::Bad(format!("cannot list {}: {e}", folder.display()));
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        if path.is_file() && name.ends_with(".exr") && !PARTS.iter().any(|part| name.ends_with(part)) {
            found.push(path);
        }
    }
    if found.is_empty() {
        return Err(CliError::Bad(format!("{} has no .exr files", folder.display())));
    }
    found.sort();
    Ok(found)
}

/// The files of albedo and normals beside an image of OIDN's examples: NAME.hdr.exr, NAME.alb.exr, NAME.nrm.exr.
fn beside(image: &Path) -> Option<[PathBuf; 2]> {
    let name = image.to_str()?;
    let stem = name.len().checked_sub(".hdr.exr".len()).filter(|at| name.is_char_boundary(*at))?;
    let (stem, end) = name.split_at(stem);
    // Files of one image have their ends in the same case.
    let capitals = end == ".HDR.EXR";
    let part =
        |part: &str| PathBuf::from(format!("{stem}{}", if capitals { part.to_uppercase() } else { part.into() }));
    let parts = PARTS.map(part);
    (end.eq_ignore_ascii_case(".hdr.exr") && parts.iter().all(|part| part.is_file())).then_some(parts)
}

fn one(args: &DenoiseArgs, denoiser: &BundledDenoiser, settings: &DenoiseSettings, job: &Job) -> Result<(), CliError> {
    let name = job.image.display().to_string();
    let named = |error: CliError| match error {
        CliError::Bad(message) if !message.starts_with(&name) => CliError::Bad(format!("{name}: {message}")),
        other => other,
    };
    let (frame, alpha, mut notes) = frame(args, &job.image).map_err(named)?;
    notes.extend(frame.notes().iter().cloned());
    for note in notes {
        terminal::note(&format!("{name}: {note}"));
    }
    let bar = terminal::bar(0);
    let start = Instant::now();
    let mut progress = |done: usize, of: usize| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
        Ok(())
    };
    // A large image needs its memory for the result, and then for writing.
    let denoised = denoiser.denoise_in_place(frame, settings, &mut progress).map_err(|error| named(told(error)))?;
    bar.finish_and_clear();
    let seconds = start.elapsed().as_secs_f64();
    write(&job.out, &denoised, alpha.as_ref())?;
    let Denoised { image, exposure, with_gbuffer, kept } = &denoised;
    let features = if *with_gbuffer { "albedo and normals" } else { "RGB alone" };
    let kept = kept.map(|share| format!(", {:.1}% of the noisy image kept", 100.0 * share)).unwrap_or_default();
    errln!(
        "{name}: {} x {}, {features}, exposure {exposure:.4}, {}{kept}",
        image.width(),
        image.height(),
        seconds_text(seconds)
    );
    if !is_stream(&job.out) {
        outln!("{}", job.out.display());
    }
    Ok(())
}

/// Writes the result: radiance and the alpha of the input, or a preview.
fn write(path: &Path, denoised: &Denoised, alpha: Option<&Image>) -> Result<(), CliError> {
    if path.extension().is_some_and(|e| e == "png") {
        return write_picture(path, &denoised.image.map(|v| (f64::from(v) * denoised.exposure) as f32));
    }
    match alpha {
        None => write_layers(path, &[ExrLayer::colors("", &denoised.image)]),
        Some(alpha) => {
            let image = denoised.image.beside(alpha).map_err(|e| CliError::Bad(e.to_string()))?;
            write_layers(path, &[ExrLayer::colors("", &image)])
        }
    }
}

/// The frame of a file, its alpha, and what is worth telling of it. Of a large image, no more than this is in memory.
fn frame(args: &DenoiseArgs, path: &Path) -> Result<(Frame, Option<Image>, Vec<String>), CliError> {
    let mut notes = Vec::new();
    let layers = Layers::read(path)?;
    let name = layers.radiance(args.layer.as_deref(), args.variance.as_deref())?;
    let variance = args.variance.as_deref().map(|layer| layers.named(layer)).transpose()?;
    let radiance = layers.image(&name)?;
    if !name.is_empty() {
        notes.push(format!("radiance is the layer `{name}`"));
    }
    let mut frame = Frame::new(radiance).map_err(told)?;
    if !args.rgb
        && let Some((albedo, normal)) = features(args, path, &layers, &name, &mut notes)?
    {
        frame = frame.with_features(albedo, normal).map_err(told)?;
    }
    if let Some(layer) = &variance {
        let samples = args.spp.filter(|_| args.per_sample).unwrap_or(1) as f32;
        let mut variance = layers.image(layer)?;
        variance.data_mut().iter_mut().for_each(|value| *value /= samples);
        frame = frame.with_variance(variance, args.spp).map_err(told)?;
    }
    Ok((frame, layers.alpha(&name)?, notes))
}

/// Albedo, and normals in camera space, if the image has both.
fn features(
    args: &DenoiseArgs,
    path: &Path,
    layers: &Layers,
    radiance: &str,
    notes: &mut Vec<String>,
) -> Result<Option<(Image, Image)>, CliError> {
    let files = match (&args.albedo, &args.normal) {
        (Some(albedo), Some(normal)) => Some([albedo.clone(), normal.clone()]),
        _ => beside(path),
    };
    let (albedo, normal, camera) = match files {
        Some([albedo, normal]) => {
            let normal = Layers::read(&normal)?;
            let camera = normal.camera.or(layers.camera);
            (Layers::read(&albedo)?.only_albedo()?, normal.only_normal()?, camera)
        }
        None => match (layers.albedo(radiance), layers.normal(radiance)) {
            (Some(albedo), Some(normal)) => (layers.image(&albedo)?, layers.image(&normal)?, layers.camera),
            (None, None) => return Ok(None),
            (albedo, _) => {
                let (has, lacks) = if albedo.is_some() { ("albedo", "normals") } else { ("normals", "albedo") };
                notes.push(format!("it has {has}, but no {lacks}; neither is used"));
                return Ok(None);
            }
        },
    };
    let (normal, told) = camera_normals(normal, args.normals, camera)?;
    notes.extend(told);
    Ok(Some((albedo, normal)))
}
