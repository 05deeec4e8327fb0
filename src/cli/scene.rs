//! `tauflow render` and `tauflow scene`: one scene, outside any pipeline.
//!
//! A scene is an item of a pipeline's node, a folder as `tauflow export PIPELINE scenes` writes it (`scene.json`, and
//! what it names in `blob/`), or a file of another program: Mitsuba 3, pbrt-v4, glTF.

use super::{
    CacheAt, CliError, Exit, PipelineArgs,
    results::{Asked, Reading, unread},
    seconds_text, terminal,
};
use crate::{
    diagnostics::did_you_mean,
    kinds::Registry,
    registry::{Goal, LightUnit, Options, Until, load_scene},
};
use clap::{Args, Subcommand};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
    time::{Duration, Instant},
};
use tauflow_cache::Store;
use tauflow_contract::{Blobs, Context, Digest, Handle, ItemKey, KindError, Silent, read_regular};
use tauflow_data::{
    Image, Resolution,
    image_io::{preview_png, write_exr},
    mitsuba::{self, Film},
    records::SceneRecord,
    scene::Scene,
};

/// Most bytes of a file of an exported scene.
const LARGEST: u64 = 1 << 32;

/// Arguments of `render`.
#[derive(Args)]
pub(crate) struct RenderArgs {
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    film: FilmArgs,
    /// Image to write: .exr (linear radiance) or .png (preview).
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Multiply the radiance by this factor.
    #[arg(long, default_value_t = 1.0)]
    exposure: f32,
    /// Double the samples until the estimated relative error is at most this value: 0.01 is 1%.
    #[arg(long, value_name = "ERROR", value_parser = above_zero, conflicts_with_all = ["spp", "seconds"])]
    error: Option<f64>,
    /// Maximum number of samples per pixel with --error.
    #[arg(long, value_name = "N", default_value_t = 65536, value_parser = clap::value_parser!(u64).range(1..=1 << 30))]
    at_most: u64,
    /// Sample for this many seconds, not counting the time to read the scene.
    #[arg(long, value_name = "S", value_parser = above_zero, conflicts_with = "spp")]
    seconds: Option<f64>,
}

fn above_zero(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err("it must be above 0".to_owned()) }
}

/// Which scene.
#[derive(Args)]
pub(crate) struct SceneArgs {
    /// Scene: a file of another program (.xml of Mitsuba 3, .pbrt of pbrt-v4, .glb or .gltf), a directory with
    /// `scene.json` and `blob/` as `tauflow export` writes it, or a pipeline file with --item.
    scene: PathBuf,
    /// Scene of a pipeline: `node/item` or `node.port/item`.
    #[arg(long, value_name = "NODE/ITEM")]
    item: Option<String>,
    /// Camera of the file, counted from 0.
    #[arg(long, value_name = "N", default_value_t = 0)]
    view: usize,
    /// Directory that contains all files of the scene. Default: the directory of the file.
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// Accept features that can only be approximated, and list them.
    #[arg(long)]
    approximate: bool,
    /// Divide the lights of glTF files by 683 lumen per watt.
    #[arg(long)]
    light_watts: bool,
}

/// Film and samples.
#[derive(Args)]
pub(crate) struct FilmArgs {
    /// Samples per pixel.
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u64).range(1..))]
    spp: u64,
    /// Image width in pixels. Default: the width of the scene's film, or 256.
    #[arg(long)]
    width: Option<u32>,
    /// Image height in pixels. Default: the height of the scene's film, or 256.
    #[arg(long)]
    height: Option<u32>,
}

impl FilmArgs {
    /// The pixels that were asked for. Where one side was, the other keeps the shape of the scene's own film.
    fn resolution(&self, own: Option<[u32; 2]>) -> Result<Resolution, CliError> {
        let [width, height] = own.unwrap_or([256, 256]);
        let along = |asked: u32, this: u32, other: u32| {
            let side = (u64::from(asked) * u64::from(this) + u64::from(other) / 2) / u64::from(other.max(1));
            u32::try_from(side.max(1)).unwrap_or(u32::MAX)
        };
        let (width, height) = match (self.width, self.height) {
            (Some(asked), None) if own.is_some() => (asked, along(asked, height, width)),
            (None, Some(asked)) if own.is_some() => (along(asked, width, height), asked),
            (asked, rows) => (asked.unwrap_or(width), rows.unwrap_or(height)),
        };
        Resolution::new(width, height).map_err(|e| CliError::Bad(format!("--width, --height: {e}")))
    }
}

/// What can be done with one scene.
#[derive(Subcommand)]
pub(crate) enum SceneCommand {
    /// Export a scene to Mitsuba 3: scene.xml, meshes, textures.
    Mitsuba {
        #[command(flatten)]
        scene: SceneArgs,
        #[command(flatten)]
        film: FilmArgs,
        /// Directory to write to.
        #[arg(short, long, value_name = "DIR")]
        out: PathBuf,
    },
}

/// Where a scene's meshes and textures are read.
enum Source {
    Folder(PathBuf),
    Store(Box<Store>),
    /// In memory, as another program's file was read.
    File(BTreeMap<Digest, Vec<u8>>),
}

/// A scene, its meshes and textures, and the pixels of its own film.
type Opened = (Scene, Source, Option<[u32; 2]>);

impl Source {
    fn blob(&self, digest: &Digest) -> Result<Vec<u8>, KindError> {
        match self {
            Self::Store(store) => Reading(store).get(digest)?.ok_or(KindError::MissingBlob(*digest)),
            Self::File(blobs) => blobs.get(digest).cloned().ok_or(KindError::MissingBlob(*digest)),
            Self::Folder(folder) => {
                let path = folder.join(digest.to_string());
                let failed = |e| KindError::Input(format!("cannot read {}: {e}", path.display()));
                let bytes = read_regular(&path, LARGEST).map_err(failed)?;
                if Digest::of(&bytes) == *digest {
                    return Ok(bytes);
                }
                let path = path.display();
                Err(KindError::Input(format!("{path} does not hold what its name says; export the scene again")))
            }
        }
    }
}

impl SceneArgs {
    fn open(&self, registry: &Registry, cache: &CacheAt) -> Result<Opened, CliError> {
        let ending = self.scene.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        let (scene, source) = match &self.item {
            Some(item) => self.of_pipeline(item, registry, cache)?,
            None if matches!(ending.as_deref(), Some("xml" | "pbrt" | "glb" | "gltf")) => return self.of_file(),
            None => self.of_folder()?,
        };
        Ok((scene, source, None))
    }

    fn of_file(&self) -> Result<Opened, CliError> {
        let light_unit = if self.light_watts { LightUnit::Watt } else { LightUnit::Candela };
        let options = Options { approximate: self.approximate, light_unit };
        let loaded = load_scene(&self.scene, self.root.as_deref(), self.view, options).map_err(told)?;
        loaded.notes.iter().for_each(|note| eprintln!("note: {note}"));
        Ok((loaded.scene, Source::File(loaded.blobs), loaded.film))
    }

    fn of_folder(&self) -> Result<(Scene, Source), CliError> {
        let file = if self.scene.is_dir() { self.scene.join(SceneRecord::FILE) } else { self.scene.clone() };
        let bytes =
            read_regular(&file, LARGEST).map_err(|e| CliError::Bad(format!("cannot read {}: {e}", file.display())))?;
        let scene = serde_json::from_slice(&bytes).map_err(|e| {
            let hint =
                "name a scene of a pipeline by `PIPELINE --item NODE/ITEM`, or a folder that `tauflow export` wrote";
            CliError::Bad(format!("{} is no scene: {e}; {hint}", file.display()))
        })?;
        Ok((scene, Source::Folder(file.parent().unwrap_or(Path::new(".")).join(SceneRecord::BLOB_FOLDER))))
    }

    fn of_pipeline(&self, item: &str, registry: &Registry, cache: &CacheAt) -> Result<(Scene, Source), CliError> {
        let Some((node, key)) = item.split_once('/') else {
            return Err(CliError::Bad(format!("--item {item} names no item; it reads NODE/ITEM")));
        };
        let (profile, sets, targets) = (None, Vec::new(), Vec::new());
        let pipeline = PipelineArgs { pipeline: self.scene.clone(), profile, sets, targets }.resolve(registry)?;
        let store = cache.look()?;
        let collection = Asked::parse(node, &pipeline)?.collection(&store)?;
        let artifact = collection.get(key).ok_or_else(|| {
            let hint = did_you_mean(key, "items", collection.items.keys().take(8).map(ItemKey::as_str));
            CliError::Bad(format!("`{node}` has no item `{key}`; {hint}"))
        })?;
        let handle = Handle::<SceneRecord>::new(artifact)
            .map_err(|e| CliError::Bad(format!("`{item}`: {e}; name an item of a node that makes scenes")))?;
        let stop = AtomicBool::new(false);
        let reading = Reading(&store);
        let ctx = Context::new(&reading, &Silent, &stop);
        let scene = SceneRecord::scene(&ctx, handle).map_err(|error| unread(item, error))?;
        Ok((scene, Source::Store(Box::new(store))))
    }
}

/// Images are written as .exr or .png.
pub(crate) fn check_picture(path: &Path) -> Result<(), CliError> {
    match path.extension().and_then(|e| e.to_str()) {
        Some("exr" | "png") => Ok(()),
        _ => Err(CliError::Bad(format!("{} ends neither in .exr nor in .png", path.display()))),
    }
}

/// Linear radiance as .exr, or a preview as .png.
pub(crate) fn write_picture(path: &Path, image: &Image) -> Result<(), CliError> {
    if path.extension().is_some_and(|e| e == "exr") {
        return write_exr(path, &[("", image)]).map_err(|e| told(e.into()));
    }
    let bytes = preview_png(image).map_err(|e| told(e.into()))?;
    fs::write(path, bytes).map_err(|e| CliError::Environment(format!("cannot write {}: {e}", path.display())))
}

pub(crate) fn told(error: KindError) -> CliError {
    match error {
        KindError::Environment(message) => CliError::Environment(message),
        other => CliError::Bad(other.to_string()),
    }
}

pub(crate) fn render(args: &RenderArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    check_picture(&args.out)?;
    let (scene, source, film) = args.scene.open(registry, cache)?;
    let resolution = args.film.resolution(film)?;
    let start = Instant::now();
    let bar = match (args.error, args.seconds) {
        _ if !terminal::redraws() => indicatif::ProgressBar::hidden(),
        (None, None) => indicatif::ProgressBar::new(args.film.spp),
        _ => indicatif::ProgressBar::new_spinner().with_message("samples a pixel"),
    };
    let mut last = Duration::ZERO;
    let mut fits = |done: u64| {
        // As many more samples as were taken last must fit, too.
        let (now, limit) = (start.elapsed(), args.seconds.unwrap_or_default());
        let next = now + now.saturating_sub(last);
        last = now;
        done == 0 || next.as_secs_f64() <= limit
    };
    let goal = match (args.error, args.seconds) {
        (Some(relative_error), _) => Goal::Error(Until { relative_error, at_most: args.at_most }),
        (None, Some(_)) => Goal::While(&mut fits),
        (None, None) => Goal::Samples(args.film.spp),
    };
    let (image, stats) =
        crate::registry::render_image(&scene, &mut |digest| source.blob(digest), resolution, goal, &mut |done| {
            bar.set_position(done);
            Ok(())
        })
        .map_err(told)?;
    bar.finish_and_clear();
    let seconds = start.elapsed().as_secs_f64();
    write_picture(&args.out, &image.map(|v| v * args.exposure))?;
    eprintln!(
        "{} samples a pixel, {} paths in {} ({:.2} million a second), {:.2} segments a path, {} rejected",
        stats.samples,
        stats.paths,
        seconds_text(seconds),
        stats.paths as f64 / seconds / 1e6,
        stats.mean_path_length,
        stats.rejected
    );
    if let Some(error) = stats.error {
        eprintln!("{}", sureness(args.error, error, stats.samples));
    }
    outln!("{}", args.out.display());
    Ok(Exit::Done)
}

/// How far the image is to be expected to be off.
fn sureness(asked: Option<f64>, error: f64, samples: u64) -> String {
    let percent = 100.0 * error;
    match asked {
        Some(asked) if error <= asked => format!("error {percent:.2}%, by other samples than the image's"),
        Some(asked) => format!(
            "error {percent:.2}%, and not the {:.2}% that were asked for: --at-most allows {samples} samples",
            100.0 * asked
        ),
        None => format!("error {percent:.2}%, by the image's own samples: more where rare light was missed"),
    }
}

pub(crate) fn scene(command: &SceneCommand, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    let SceneCommand::Mitsuba { scene, film, out } = command;
    let (scene, source, own) = scene.open(registry, cache)?;
    let resolution = film.resolution(own)?;
    let film = Film { width: resolution.width(), height: resolution.height(), spp: film.spp };
    mitsuba::export(&scene, &mut |digest| source.blob(digest), out, film).map_err(told)?;
    outln!("{}", out.join("scene.xml").display());
    Ok(Exit::Done)
}
