#![doc = include_str!("scene_files.md")]

mod build;
mod described;
mod files;
mod given;
mod gltf;
mod meshes;
mod mitsuba;
mod obj;
mod pbrt;
mod ply;
mod problems;
mod setting;
mod spectra;
#[cfg(test)]
mod tests;

pub use described::check_scene;
pub use gltf::LightUnit;
pub use setting::{Setting, View, environment_map};

use crate::assets::{BlobSet, ending, refusal};
use build::Builder;
use given::Given;
use problems::{Place, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};
use tauflow_contract::{
    Action, Context, Digest, FILE_PORT, Files, Group, ItemKey, Kind, KindError, KindSpec, Media, Mode, Out, Outputs,
    ParamProblem, SourceItem,
};
use tauflow_data::{
    StratumName,
    records::{AssetReport, SceneRecord},
    scene::{Emitter, Recipe, Scene},
};

const MAIN: Group = Group::main(5);
const SCENES: Out<SceneRecord> =
    Out::new(MAIN, "scenes", "The scenes; unreadable ones fail, or are omitted.").filtering();
const REPORTS: Out<AssetReport> = Out::new(MAIN, "reports", "Notes on each file.");

/// The kind `scene_files`.
pub struct SceneFiles;

/// A file or a folder of scenes, and what they are like.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScenePath {
    /// A file, a pattern with `*` and `?`, or a folder, which is searched with those below.
    pub path: String,
    /// The stratum: regime and context, such as `L1-open`, or any name of yours, such as `kitchens`.
    pub stratum: StratumName,
}

/// Params of `scene_files`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SceneFilesParams {
    /// The files of the scenes, in the order of their numbers.
    pub scenes: Vec<ScenePath>,
    /// Accept approximated features, with a note; otherwise they are errors.
    pub approximate: bool,
    /// Omit unreadable scenes, with the reasons in `reports`; otherwise they fail.
    pub leave_out: bool,
    /// Unit of the lights in glTF files.
    pub light_unit: LightUnit,
}

/// How a scene's files are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// True lets what is only nearly expressed pass as a note.
    pub approximate: bool,
    /// Unit of the lights in glTF files.
    pub light_unit: LightUnit,
}

/// A scene that was read from files.
#[derive(Clone, Debug, PartialEq)]
pub struct Loaded {
    /// The scene.
    pub scene: Scene,
    /// Its meshes and images.
    pub blobs: BTreeMap<Digest, Vec<u8>>,
    /// Notes, one line each.
    pub notes: Vec<String>,
    /// Pixels of its film, if it has one.
    pub film: Option<[u32; 2]>,
    /// True if its camera is not its own, but one that sees all.
    pub framed: bool,
    /// True if it gives no light of its own, and so has the setting's environment.
    pub lit: bool,
    /// The files on disk that it was read from; none if they were handed over.
    pub files: Vec<PathBuf>,
    /// The recipe beside a `scene.json`.
    recipe: Option<Recipe>,
}

/// Reads the scene of a file, as its camera `view` (from 0) sees it. Files that it names must lie below `root`, or
/// below its own folder.
///
/// # Errors
/// All that is wrong with it, a line each.
pub fn load_scene(path: &Path, root: Option<&Path>, view: usize, options: Options) -> Result<Loaded, KindError> {
    load_scene_in(path, root, &Setting::camera(view), options)
}

/// As [`load_scene`], in a setting.
///
/// # Errors
/// All that is wrong with it, a line each.
pub fn load_scene_in(
    path: &Path,
    root: Option<&Path>,
    setting: &Setting,
    options: Options,
) -> Result<Loaded, KindError> {
    let (name, parts, files) = files::on_disk(path, root)?;
    Ok(Loaded { files, ..read(&name, setting, &parts, options)? })
}

/// Most cameras of a scene's file: each is an item, and reads the files again.
const MOST_VIEWS: usize = 1 << 10;

/// Reads a scene of files by part name.
fn read(
    name: &str,
    setting: &Setting,
    parts: &BTreeMap<String, Vec<u8>>,
    options: Options,
) -> Result<Loaded, KindError> {
    let bytes = parts.get(given::MAIN).ok_or_else(|| KindError::Internal("an item without its own file".into()))?;
    let given = Given::Parts(parts);
    let mut problems = Problems::new(options.approximate);
    if ending(name) == "json" {
        return described::read(name, bytes, &given, problems);
    }
    let mut build = Builder::new(&given, std::mem::take(&mut problems));
    let view = match setting.view {
        View::Camera(view) => view,
        View::Fit => 0,
    };
    let mut said = match ending(name).as_str() {
        "xml" => mitsuba::read(name, bytes, view, &given, &mut build),
        "pbrt" => pbrt::read(name, bytes, &given, &mut build),
        _ => gltf::read(name, bytes, setting, &given, &mut build, options.light_unit),
    };
    if let Some(map) = &setting.environment {
        setting::surround(&mut build, map);
    }
    let dark = !setting::shines(&build);
    let lit = dark && setting.fallback.is_some();
    if let Some(map) = setting.fallback.as_ref().filter(|_| dark) {
        setting::surround(&mut build, map);
    }
    let framed = setting.view == View::Fit || (setting.frame && said.views == 0);
    if framed && build.problems.is_fine() {
        let [width, height] = said.film.map(f64::from);
        let aspect = setting.aspect.unwrap_or(width / height);
        let camera = setting::fit(&build, said.camera.as_ref(), aspect);
        if camera.is_none() {
            build.problems.error(&Place::file(name), "it has no size, and cannot be framed", "show something in it");
        }
        said.camera = camera;
        said.film[0] = (height * aspect).round().clamp(1.0, 65536.0) as u32;
    }
    if view > 0 && view >= said.views {
        let cameras = if said.views == 1 { "one camera".to_owned() } else { format!("{} cameras", said.views) };
        let what = format!("there is no camera {view}: it has {cameras}, counted from 0");
        build.problems.error(&Place::file(name), what, "name another");
    }
    if said.views > MOST_VIEWS {
        let what = format!("{} cameras; more than {MOST_VIEWS} are not supported", said.views);
        build.problems.error(&Place::file(name), what, "split the file");
    }
    let (scene, blobs, problems) = build.finish(said.camera, said.max_depth, seed(bytes), name);
    let notes = problems.finish()?;
    let wanted = scene.blobs();
    let mut blobs: BTreeMap<Digest, Vec<u8>> = BlobSet::into_map(blobs);
    blobs.retain(|digest, _| wanted.binary_search(digest).is_ok());
    Ok(Loaded { scene, blobs, notes, film: Some(said.film), framed, lit, files: Vec::new(), recipe: None })
}

/// A seed that is the file's own.
fn seed(bytes: &[u8]) -> u64 {
    let text = Digest::of(bytes).to_string();
    u64::from_str_radix(text.get(..16).unwrap_or("0"), 16).unwrap_or(0)
}

/// The recipe of a scene: views of one file are one content.
fn recipe(name: &str, main: &[u8], stratum: &StratumName, index: u64, loaded: &Loaded) -> Recipe {
    let stratum = stratum.to_string();
    if let Some(own) = &loaded.recipe {
        return Recipe { stratum, index, side: None, ..own.clone() };
    }
    let map = loaded.scene.emitters.iter().find_map(|emitter| match emitter {
        Emitter::Envmap { image, .. } => Some(format!("file/{}", image.short())),
        _ => None,
    });
    Recipe {
        stratum,
        index,
        layout: format!("file/{name}"),
        layout_params: BTreeMap::new(),
        objects: vec![format!("file/{}", Digest::of(main).short())],
        environment: map.unwrap_or_else(|| "none".to_owned()),
        content: None,
        view: 0,
        side: None,
        exposure_ev: 0.0,
    }
}

impl Kind for SceneFiles {
    type Params = SceneFilesParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "scene_files",
            summary: "Reads complete scenes from files: scene.json, glTF, Mitsuba 3 XML and pbrt-v4.",
            manual: include_str!("scene_files.md"),
            mode: Mode::Source,
            inputs: vec![],
            outputs: vec![SCENES.port(), REPORTS.port()],
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut problems = Vec::new();
        if params.scenes.is_empty() {
            let hint = "write for example `scenes: [{ path: my/room.xml, stratum: L1-enclosed }]`";
            problems.push(ParamProblem::new("/scenes", "no scenes are given", hint));
        }
        problems
    }

    fn items(params: &Self::Params) -> Result<Vec<SourceItem>, KindError> {
        files::items(&params.scenes, params.leave_out)
    }

    fn missing(params: &Self::Params) -> Vec<ParamProblem> {
        if params.leave_out { Vec::new() } else { files::missing(&params.scenes) }
    }

    /// How files are read: where they lie does not matter. The item's key has the stratum.
    fn project(params: &Self::Params, item: Option<&ItemKey>, _group: &str) -> Value {
        match item {
            None => serde_json::to_value(params).expect("params serialise"),
            Some(_) => json!({
                "approximate": params.approximate, "leave_out": params.leave_out, "light_unit": params.light_unit
            }),
        }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let key = action.item()?;
        let (stratum, index) = StratumName::of_key(key.as_str())
            .ok_or_else(|| KindError::Internal(format!("`{key}` is no key of this kind")))?;
        if !action.each.contains_key(FILE_PORT) {
            let name = key.to_string();
            let report = AssetReport { reason: Some(refusal().line(&name)), name, ..AssetReport::default() };
            return Ok(Outputs::default().put(REPORTS, report.store(ctx)?));
        }
        let Files(mut parts) = action.files()?.load(ctx)?;
        let main = parts.keys().find_map(|part| files::parse_main(part));
        let (part, view, name) = main.ok_or_else(|| KindError::Internal("the item has no file of its own".into()))?;
        let bytes = parts.remove(&part).unwrap_or_default();
        parts.insert(given::MAIN.to_owned(), bytes);
        let options = Options { approximate: action.params.approximate, light_unit: action.params.light_unit };
        let mut report = AssetReport { name: name.clone(), sort: Some("scene".to_owned()), ..AssetReport::default() };
        let mut outputs = Outputs::default();
        match read(&name, &Setting::camera(view), &parts, options) {
            Ok(loaded) => {
                for bytes in loaded.blobs.values() {
                    ctx.put(bytes)?;
                }
                let recipe = recipe(&name, &parts[given::MAIN], &stratum, index, &loaded);
                report.accepted = true;
                report.notes.clone_from(&loaded.notes);
                report.measure("shapes", loaded.scene.shapes.len() as f64);
                report.measure("materials", loaded.scene.materials.len() as f64);
                report.measure("emitters", loaded.scene.emitters.len() as f64);
                report.measure("view", view as f64);
                outputs = outputs.put(SCENES, SceneRecord { scene: loaded.scene, recipe }.store(ctx)?);
            }
            Err(KindError::Input(reasons)) if action.params.leave_out => report.reason = Some(reasons),
            Err(error) => return Err(error),
        }
        Ok(outputs.put(REPORTS, report.store(ctx)?))
    }
}

/// The files that a scene's own file names, and the number of its cameras.
fn named(name: &str, bytes: &[u8], given: &Given<'_>) -> (BTreeSet<String>, usize) {
    // Errors are reported when it is read.
    let mut ignored = Problems::new(true);
    match ending(name).as_str() {
        "xml" => mitsuba::names(name, bytes, given, &mut ignored),
        "pbrt" => (pbrt::names(name, bytes, given, &mut ignored), 1),
        "json" => (files::described(bytes), 1),
        _ => (gltf::names(bytes), gltf::cameras(bytes)),
    }
}
