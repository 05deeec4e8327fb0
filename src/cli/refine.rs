//! `tauflow refine`: applies a trained solver to an image of any renderer, without a pipeline.

use super::{
    CliError, Exit,
    inputs::Inputs,
    scene::{check_picture, is_stream, told, write_picture},
    seconds_text,
};
use crate::registry::{
    Conditioning, Course, Denoiser, Mirrored, Model, NetworkCalls, NetworkDevice, Place, clean_estimate,
    geometric_mean_luminance, rollout_to,
};
use clap::Args;
use std::{collections::BTreeMap, path::PathBuf, time::Instant};
use tauflow_contract::read_regular;
use tauflow_data::{Image, image_io::read_exr, records::GBuffer, time::TimeGrid, views::Views};

/// Mid-grey that solvers saw scenes exposed to.
const KEY: f64 = 0.18;

/// Most bytes of a model.
const LARGEST: u64 = 1 << 32;

/// Arguments of `refine`.
#[derive(Args)]
pub(crate) struct RefineArgs {
    /// Model file of the solver, as `tauflow export PIPELINE solvers.model` writes it.
    model: PathBuf,
    /// Image to denoise: an EXR file of linear radiance. The layers `albedo` and `normal` are its G-buffer.
    image: PathBuf,
    /// Samples per pixel of the image. Without it, the count is unknown and may differ from pixel to pixel: a solver
    /// that was trained with `unknown_counts` denoises such images in one call.
    #[arg(long, value_name = "N")]
    from_spp: Option<u64>,
    /// Noise level of the result, in samples per pixel. Default: the last rung of the training ladders.
    #[arg(long, value_name = "N")]
    to_spp: Option<u64>,
    /// Number of network calls.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=NetworkCalls::MOST))]
    nfe: u64,
    /// Average each call over 1, 2, 4 or 8 mirrored and rotated copies, in as many times the time.
    #[arg(long, default_value_t = 1)]
    mirrors: u64,
    /// EXR file with the layers `albedo` and `normal` (right, up, towards the camera), if the image has none.
    #[arg(long, value_name = "FILE")]
    gbuffer: Option<PathBuf>,
    /// Exposure factor for the network; the result has the original exposure. Default: 0.18 divided by the geometric
    /// mean luminance.
    #[arg(long)]
    exposure: Option<f64>,
    /// Device of the network: `cpu`; with the feature `gpu` also `vulkan` and `software_vulkan`.
    #[arg(long, default_value = "cpu", value_parser = device)]
    device: NetworkDevice,
    /// Image to write: .exr (linear radiance) or .png (exposed preview).
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
}

fn device(text: &str) -> Result<NetworkDevice, String> {
    serde_json::from_value(text.into()).map_err(|_| "write `cpu`, `vulkan` or `software_vulkan`".into())
}

pub(crate) fn refine(args: &RefineArgs) -> Result<Exit, CliError> {
    check_picture(&args.out)?;
    Inputs::of([&args.model, &args.image].into_iter().chain(&args.gbuffer)).spare(&args.out)?;
    let views = Views::try_from(args.mirrors).map_err(|e| CliError::Bad(format!("--mirrors {}: {e}", args.mirrors)))?;
    let read = |path: &PathBuf| read_exr(path).map_err(|e| CliError::Bad(e.to_string()));
    let bytes = read_regular(&args.model, LARGEST)
        .map_err(|e| CliError::Bad(format!("cannot read {}: {e}", args.model.display())))?;
    let place = Place::of(args.device).map_err(|e| CliError::Environment(e.to_string()))?;
    let model = Model::load_to(&bytes, &place).map_err(|e| CliError::Bad(format!("{}: {e}", args.model.display())))?;
    let mut layers = read(&args.image)?;
    let gbuffer = match (model.info().conditioning, &args.gbuffer) {
        (Conditioning::Rgb, _) => None,
        (Conditioning::Gbuffer, Some(path)) => Some(gbuffer(&read(path)?, path)?),
        (Conditioning::Gbuffer, None) => Some(gbuffer(&layers, &args.image)?),
    };
    let Some(image) = layers.remove("") else {
        let names: Vec<&str> = layers.keys().map(String::as_str).collect();
        return Err(CliError::Bad(format!(
            "{} has no channels R, G and B in the unnamed layer, only `{}`",
            args.image.display(),
            names.join("`, `")
        )));
    };
    finite(&image, &format!("{}", args.image.display()), "mend the image first")?;
    if let Some(gbuffer) = &gbuffer {
        let path = args.gbuffer.as_ref().unwrap_or(&args.image).display();
        finite(gbuffer, &format!("the G-buffer of {path}"), "mend it first")?;
        if (gbuffer.width(), gbuffer.height()) != (image.width(), image.height()) {
            return Err(CliError::Bad(format!(
                "{} has {} x {} pixels, but the G-buffer of {path} has {} x {}; render both at the same size",
                args.image.display(),
                image.width(),
                image.height(),
                gbuffer.width(),
                gbuffer.height()
            )));
        }
    }
    let exposure = args.exposure.unwrap_or_else(|| KEY / geometric_mean_luminance(&image));
    if !(exposure.is_finite() && exposure > 0.0) {
        return Err(CliError::Bad(format!("invalid exposure {exposure}; set a positive factor with --exposure")));
    }
    let start = Instant::now();
    let exposed = image.map(|v| (f64::from(v) * exposure) as f32);
    finite(&exposed, "the exposed image", "lower --exposure")?;
    let lit = |image: &Image| image.data().iter().any(|value| *value > 0.0);
    if lit(&image) && !lit(&exposed) {
        let what = format!("an exposure of {exposure:e} makes the exposed image black; raise --exposure");
        return Err(CliError::Bad(what));
    }
    let to = args.to_spp.map_or(model.clock().n_max(), |n| n as f64);
    let model = Mirrored::new(&model, views);
    let refined = match args.from_spp {
        Some(from) => {
            let course = Course { from, steps: args.nfe as usize, grid: TimeGrid::Ladder };
            rollout_to(&model, &exposed, gbuffer.as_ref(), course, to)
        }
        None if args.nfe > 1 || args.to_spp.is_some() => {
            return Err(CliError::Bad(
                "--nfe above 1 and --to-spp need the sample count of the image; give it with --from-spp".into(),
            ));
        }
        None => clean_estimate(&model, &exposed, gbuffer.as_ref(), None),
    };
    let refined = refined.map_err(told)?;
    let seconds = start.elapsed().as_secs_f64();
    let png = args.out.extension().is_some_and(|e| e == "png");
    let refined = if png { refined } else { refined.map(|v| (f64::from(v) / exposure) as f32) };
    finite(&refined, "the refined image", "the solver cannot process this image; try a different --exposure or image")?;
    write_picture(&args.out, &refined)?;
    let from = args.from_spp.map_or_else(|| "unknown".into(), |from| from.to_string());
    errln!(
        "{from} spp -> {to} spp in {} and {}, exposure {exposure:.4}",
        super::counted(args.nfe, "network call"),
        seconds_text(seconds)
    );
    if !is_stream(&args.out) {
        outln!("{}", args.out.display());
    }
    Ok(Exit::Done)
}

/// Checks that all values of an image are finite.
fn finite(image: &Image, what: &str, remedy: &str) -> Result<(), CliError> {
    let Some(at) = image.data().iter().position(|v| !v.is_finite()) else { return Ok(()) };
    let pixel = at / image.channels();
    let (x, y) = (pixel % image.width(), pixel / image.width());
    Err(CliError::Bad(format!("{what}: pixel ({x}, {y}) is not finite; {remedy}")))
}

/// Albedo and normal as the network wants them, [H, W, 6].
fn gbuffer(layers: &BTreeMap<String, Image>, path: &std::path::Path) -> Result<Image, CliError> {
    let [Some(albedo), Some(normal)] = GBuffer::LAYERS.map(|layer| layers.get(layer)) else {
        return Err(CliError::Bad(format!(
            "the solver needs G-buffers, but {} has no layers `albedo` and `normal`; name a file that has them with \
            --gbuffer, or use a solver trained on RGB",
            path.display()
        )));
    };
    albedo.beside(normal).map_err(|e| CliError::Bad(format!("{}: {e}", path.display())))
}
