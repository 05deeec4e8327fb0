//! One scene, outside any pipeline: where it comes from, and `tauflow scene`.
//!
//! A scene is an item of a pipeline's node, a folder as `tauflow export PIPELINE scenes` writes it (`scene.json`, and
//! what it names in `blob/`), or a file of another program: Mitsuba 3, pbrt-v4, glTF.

use super::{
    CacheAt, CliError, Exit, PipelineArgs,
    inputs::Inputs,
    results::{collection, unread},
};
use crate::{
    diagnostics::did_you_mean,
    engine::publish,
    kinds::Registry,
    query::{Reading, Selection},
    registry::{LightUnit, Options, Setting, View, check_scene, environment_map, load_scene_in, sky},
};
use clap::{Args, Subcommand};
use std::{
    collections::BTreeMap,
    io::Write as _,
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};
use tauflow_cache::Store;
use tauflow_contract::{Blobs, Context, Digest, Handle, ItemKey, KindError, Silent, read_regular};
use tauflow_data::{
    Image, Resolution,
    image_io::{ExrLayer, exr_file, preview_png},
    mitsuba::{self, Film},
    records::SceneRecord,
    scene::Scene,
};

/// Most bytes of a file of an exported scene.
const LARGEST: u64 = 1 << 32;

fn view(text: &str) -> Result<View, String> {
    match text {
        "fit" => Ok(View::Fit),
        number => number.parse().map(View::Camera).map_err(|_| "write `fit`, or a camera's number from 0".to_owned()),
    }
}

/// The environment that `sky` stands for: broad light from a hazy sky, of mean radiance 1.
fn hazy() -> Image {
    sky("hazy", 0)
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
    /// Camera of the file, counted from 0, or `fit` to show the whole scene. A glTF file without a camera uses `fit`.
    #[arg(long, value_name = "N|fit", value_parser = view)]
    view: Option<View>,
    /// Environment that replaces the one of the file: `sky`, or a latitude-longitude map (.exr or .hdr). A glTF file
    /// without lights uses `sky`.
    #[arg(long, value_name = "FILE|sky")]
    env: Option<PathBuf>,
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
    pub(crate) spp: u64,
    /// Image width in pixels. Default: the width of the scene's film, or 256.
    #[arg(long)]
    width: Option<u32>,
    /// Image height in pixels. Default: the height of the scene's film, or 256.
    #[arg(long)]
    height: Option<u32>,
}

impl FilmArgs {
    /// Width over height, if both were asked for.
    fn aspect(&self) -> Option<f64> {
        self.width.zip(self.height).map(|(width, height)| f64::from(width) / f64::from(height.max(1)))
    }

    /// The pixels that were asked for. Where one side was, the other keeps the shape of the scene's own film.
    pub(crate) fn resolution(&self, own: Option<[u32; 2]>) -> Result<Resolution, CliError> {
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

/// Commands for a scene.
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
pub(crate) enum Source {
    Folder(PathBuf),
    Store(Box<Store>),
    /// In memory, as another program's file was read.
    File(BTreeMap<Digest, Vec<u8>>),
}

/// A scene that was read.
pub(crate) struct Opened {
    pub(crate) scene: Scene,
    /// Its meshes and textures.
    pub(crate) source: Source,
    /// Pixels of its own film.
    pub(crate) film: Option<[u32; 2]>,
    /// The files that it was read from.
    pub(crate) inputs: Inputs,
}

impl Source {
    pub(crate) fn blob(&self, digest: &Digest) -> Result<Vec<u8>, KindError> {
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
                Err(KindError::Input(format!("the content of {path} does not match its name; export the scene again")))
            }
        }
    }
}

impl SceneArgs {
    pub(crate) fn open(&self, film: &FilmArgs, registry: &Registry, cache: &CacheAt) -> Result<Opened, CliError> {
        let ending = self.scene.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        let foreign = self.item.is_none() && matches!(ending.as_deref(), Some("xml" | "pbrt" | "glb" | "gltf"));
        if !foreign && (self.view.is_some() || self.env.is_some()) {
            let what = "--view and --env are for scenes of other programs: .xml, .pbrt, .glb and .gltf files";
            return Err(CliError::Bad(what.into()));
        }
        let (scene, source) = match &self.item {
            Some(item) => self.of_pipeline(item, registry, cache)?,
            None if foreign => {
                return self.of_file(film.aspect(), matches!(ending.as_deref(), Some("glb" | "gltf")));
            }
            None => self.of_folder()?,
        };
        Ok(Opened { scene, source, film: None, inputs: Inputs::of([self.own_file()]) })
    }

    /// Opens a file of another program. An `object` may lack a camera and lights.
    fn of_file(&self, aspect: Option<f64>, object: bool) -> Result<Opened, CliError> {
        let light_unit = if self.light_watts { LightUnit::Watt } else { LightUnit::Candela };
        let options = Options { approximate: self.approximate, light_unit };
        let environment = match &self.env {
            Some(path) if path.as_os_str() == "sky" => Some(hazy()),
            Some(path) => Some(environment_map(path).map_err(told)?),
            None => None,
        };
        let setting = Setting {
            view: self.view.unwrap_or(View::Camera(0)),
            frame: object && self.view.is_none(),
            aspect,
            environment,
            fallback: object.then(hazy),
        };
        let loaded = load_scene_in(&self.scene, self.root.as_deref(), &setting, options).map_err(told)?;
        loaded.notes.iter().for_each(|note| errln!("note: {note}"));
        let framed = loaded.framed && self.view.is_none();
        match (framed, loaded.lit) {
            (true, true) => errln!("note: no camera and no light: as with --view fit --env sky"),
            (true, false) => errln!("note: no camera: as with --view fit"),
            (false, true) => errln!("note: no light: as with --env sky"),
            (false, false) => {}
        }
        let inputs = Inputs::of(loaded.files.into_iter().chain(self.env.clone()));
        Ok(Opened { scene: loaded.scene, source: Source::File(loaded.blobs), film: loaded.film, inputs })
    }

    /// The file that says what the scene is: in a folder, its `scene.json`.
    fn own_file(&self) -> PathBuf {
        if self.scene.is_dir() { self.scene.join(SceneRecord::FILE) } else { self.scene.clone() }
    }

    fn of_folder(&self) -> Result<(Scene, Source), CliError> {
        let file = self.own_file();
        let bytes =
            read_regular(&file, LARGEST).map_err(|e| CliError::Bad(format!("cannot read {}: {e}", file.display())))?;
        let scene: Scene = serde_json::from_slice(&bytes).map_err(|e| {
            let hint =
                "name a scene of a pipeline as `PIPELINE --item NODE/ITEM`, or a directory written by `tauflow export`";
            CliError::Bad(format!("{} is not a scene: {e}; {hint}", file.display()))
        })?;
        check_scene(&file.display().to_string(), &scene).map_err(told)?;
        Ok((scene, Source::Folder(file.parent().unwrap_or(Path::new(".")).join(SceneRecord::BLOB_FOLDER))))
    }

    fn of_pipeline(&self, item: &str, registry: &Registry, cache: &CacheAt) -> Result<(Scene, Source), CliError> {
        let Some((node, key)) = item.split_once('/') else {
            return Err(CliError::Bad(format!("--item {item} is not an item; the format is NODE/ITEM")));
        };
        let (profile, sets, targets) = (None, Vec::new(), Vec::new());
        let pipeline = PipelineArgs { pipeline: self.scene.clone(), profile, sets, targets }.resolve(registry)?;
        let store = cache.look()?;
        let collection = collection(&Selection::parse(node, &pipeline)?, &store)?;
        let artifact = collection.get(key).ok_or_else(|| {
            let hint = did_you_mean(key, "items", collection.items.keys().take(8).map(ItemKey::as_str));
            CliError::Bad(format!("`{node}` has no item `{key}`; {hint}"))
        })?;
        let handle = Handle::<SceneRecord>::new(artifact)
            .map_err(|e| CliError::Bad(format!("`{item}`: {e}; name an item of a node that produces scenes")))?;
        let stop = AtomicBool::new(false);
        let reading = Reading(&store);
        let ctx = Context::new(&reading, &Silent, &stop);
        let scene = SceneRecord::scene(&ctx, handle).map_err(|error| unread(item, error))?;
        Ok((scene, Source::Store(Box::new(store))))
    }
}

/// Whether a path leads to a pipe, a device or a socket, or to a file that this process has open: these take bytes and
/// are not replaced.
pub(crate) fn is_stream(path: &Path) -> bool {
    let open = ["/dev/stdout", "/dev/stderr", "/dev/fd"].iter().any(|of| path.starts_with(of));
    open || std::fs::metadata(path).is_ok_and(|about| !about.is_file() && !about.is_dir())
}

/// The file that a path leads to through links, be it there or not: a file is replaced, a link to it is not.
pub(crate) fn target(path: &Path) -> PathBuf {
    // As many links as Linux follows.
    const MOST: usize = 40;
    let mut path = path.to_owned();
    for _ in 0..MOST {
        match std::fs::read_link(&path) {
            Ok(next) => path = path.parent().unwrap_or(Path::new("")).join(next),
            Err(_) => break,
        }
    }
    path
}

/// Writes a file at once, and through links; a pipe or a device gets the bytes.
pub(crate) fn deliver(path: &Path, bytes: &[u8]) -> Result<(), CliError> {
    if is_stream(path) {
        return std::fs::OpenOptions::new()
            .write(true)
            .open(path)
            .and_then(|mut stream| stream.write_all(bytes))
            .map_err(|e| CliError::Environment(format!("cannot write to {}: {e}", path.display())));
    }
    Ok(publish::write(&target(path), bytes)?)
}

/// Images are written as .exr or .png, and to pipes and devices. A place where there can be no file is told before the
/// work, not after it.
pub(crate) fn check_picture(path: &Path) -> Result<(), CliError> {
    let name = path.display();
    if is_stream(path) {
        return Ok(());
    }
    if !matches!(path.extension().and_then(|e| e.to_str()), Some("exr" | "png")) {
        return Err(CliError::Bad(format!("{name} must end in .exr or .png")));
    }
    let place = target(path);
    if place.is_dir() {
        return Err(CliError::Bad(format!("{name} is a folder; name a file in it")));
    }
    let above = place.ancestors().skip(1).find(|above| above.symlink_metadata().is_ok());
    match above.filter(|above| !above.is_dir()) {
        Some(above) => Err(CliError::Bad(format!("{name} cannot be a file, because {} is no folder", above.display()))),
        None => Ok(()),
    }
}

/// Linear radiance as .exr, or a preview as .png. A file that is there stays until the new one is whole.
pub(crate) fn write_picture(path: &Path, image: &Image) -> Result<(), CliError> {
    if path.extension().is_none_or(|e| e != "png") {
        return write_layers(path, &[ExrLayer::colors("", image)]);
    }
    let bytes = preview_png(image).map_err(|e| told(e.into()))?;
    deliver(path, &bytes)
}

/// Layers as .exr; a file that is there stays until the new one is whole.
pub(crate) fn write_layers(path: &Path, layers: &[ExrLayer<'_>]) -> Result<(), CliError> {
    let bytes = exr_file(layers).map_err(|e| told(e.into()))?;
    deliver(path, &bytes)
}

pub(crate) fn told(error: KindError) -> CliError {
    match error {
        KindError::Environment(message) => CliError::Environment(message),
        other => CliError::Bad(other.to_string()),
    }
}

/// Refuses to export to Mitsuba over the files of the scene.
fn spare(inputs: &Inputs, out: &Path) -> Result<(), CliError> {
    for entry in std::fs::read_dir(out).into_iter().flatten().flatten() {
        if mitsuba::writes(&entry.file_name().to_string_lossy())
            && let Some(name) = inputs.at(&entry.path())
        {
            let (name, out) = (name.display(), out.display());
            let what = format!("{name} is read, and would be overwritten by the export to {out}");
            return Err(CliError::Bad(format!("{what}; name another directory with -o")));
        }
    }
    Ok(())
}

pub(crate) fn scene(command: &SceneCommand, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    let SceneCommand::Mitsuba { scene, film, out } = command;
    let Opened { scene, source, film: own, inputs } = scene.open(film, registry, cache)?;
    let resolution = film.resolution(own)?;
    spare(&inputs, out)?;
    let film = Film { width: resolution.width(), height: resolution.height(), spp: film.spp };
    mitsuba::export(&scene, &mut |digest| source.blob(digest), out, film).map_err(told)?;
    outln!("{}", out.join("scene.xml").display());
    Ok(Exit::Done)
}
