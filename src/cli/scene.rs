//! `tauflow render` and `tauflow scene`: one scene, outside any pipeline.
//!
//! A scene is a folder as `tauflow export PIPELINE scenes` writes it: `scene.json`, and what it names in `blob/`.

use super::{CliError, Exit, seconds_text};
use crate::registry;
use clap::{Args, Subcommand};
use std::{
    fs,
    io::IsTerminal,
    path::{Path, PathBuf},
    time::Instant,
};
use tauflow_contract::{Digest, KindError};
use tauflow_data::{
    image_io::{preview_png, write_exr},
    mitsuba::{self, Film},
    scene::Scene,
};

/// What `render` takes.
#[derive(Args)]
pub(crate) struct RenderArgs {
    /// A folder with `scene.json` and `blob/`, as `tauflow export PIPELINE scenes` writes it; or the `scene.json`.
    scene: PathBuf,
    #[command(flatten)]
    film: FilmArgs,
    /// The image: .exr (linear radiance), or .png (a preview).
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Factor on the radiance.
    #[arg(long, default_value_t = 1.0)]
    exposure: f32,
}

/// Film and samples.
#[derive(Args)]
pub(crate) struct FilmArgs {
    /// Samples a pixel.
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u64).range(1..))]
    spp: u64,
    /// Pixels in a row.
    #[arg(long, default_value_t = 256)]
    width: usize,
    /// Rows.
    #[arg(long, default_value_t = 256)]
    height: usize,
}

/// What can be done with one scene.
#[derive(Subcommand)]
pub(crate) enum SceneCommand {
    /// Write it as Mitsuba 3 reads it: scene.xml, meshes, textures.
    Mitsuba {
        /// A folder with `scene.json` and `blob/`; or the `scene.json`.
        scene: PathBuf,
        #[command(flatten)]
        film: FilmArgs,
        /// The folder to write.
        #[arg(short, long, value_name = "DIR")]
        out: PathBuf,
    },
}

fn open(path: &Path) -> Result<(Scene, PathBuf), CliError> {
    let file = if path.is_dir() { path.join("scene.json") } else { path.to_path_buf() };
    let bytes = fs::read(&file).map_err(|e| CliError::Bad(format!("cannot read {}: {e}", file.display())))?;
    let scene = serde_json::from_slice(&bytes).map_err(|e| {
        CliError::Bad(format!("{} is no scene: {e}; export one by `tauflow export PIPELINE scenes`", file.display()))
    })?;
    let folder = file.parent().unwrap_or(Path::new(".")).join("blob");
    Ok((scene, folder))
}

fn blob(folder: &Path, digest: &Digest) -> Result<Vec<u8>, KindError> {
    let path = folder.join(digest.to_string());
    let bytes = fs::read(&path).map_err(|e| KindError::Input(format!("cannot read {}: {e}", path.display())))?;
    if Digest::of(&bytes) == *digest {
        Ok(bytes)
    } else {
        Err(KindError::Input(format!("{} does not hold what its name says; export the scene again", path.display())))
    }
}

fn told(error: KindError) -> CliError {
    match error {
        KindError::Environment(message) => CliError::Environment(message),
        other => CliError::Bad(other.to_string()),
    }
}

pub(crate) fn render(args: &RenderArgs) -> Result<Exit, CliError> {
    let extension = args.out.extension().and_then(|e| e.to_str()).unwrap_or_default();
    if !["exr", "png"].contains(&extension) {
        return Err(CliError::Bad(format!("{} ends neither in .exr nor in .png", args.out.display())));
    }
    let (scene, folder) = open(&args.scene)?;
    let start = Instant::now();
    let bar = if std::io::stderr().is_terminal() {
        indicatif::ProgressBar::new(args.film.spp)
    } else {
        indicatif::ProgressBar::hidden()
    };
    let (image, stats) = registry::render_image(
        &scene,
        &mut |digest| blob(&folder, digest),
        (args.film.width, args.film.height),
        args.film.spp,
        &mut |done| {
            bar.set_position(done);
            Ok(())
        },
    )
    .map_err(told)?;
    bar.finish_and_clear();
    let seconds = start.elapsed().as_secs_f64();
    let image = image.map(|v| v * args.exposure);
    if extension == "exr" {
        write_exr(&args.out, &[("", &image)]).map_err(|e| told(e.into()))?;
    } else {
        let bytes = preview_png(&image).map_err(|e| told(e.into()))?;
        fs::write(&args.out, bytes)
            .map_err(|e| CliError::Environment(format!("cannot write {}: {e}", args.out.display())))?;
    }
    eprintln!(
        "{} paths in {} ({:.2} million a second), {:.2} segments a path, {} rejected",
        stats.paths,
        seconds_text(seconds),
        stats.paths as f64 / seconds / 1e6,
        stats.mean_path_length,
        stats.rejected
    );
    outln!("{}", args.out.display());
    Ok(Exit::Done)
}

pub(crate) fn scene(command: &SceneCommand) -> Result<Exit, CliError> {
    let SceneCommand::Mitsuba { scene, film, out } = command;
    let (scene, folder) = open(scene)?;
    let film = Film { width: film.width, height: film.height, spp: film.spp };
    mitsuba::export(&scene, &mut |digest| blob(&folder, digest), out, film).map_err(told)?;
    outln!("{}", out.join("scene.xml").display());
    Ok(Exit::Done)
}
