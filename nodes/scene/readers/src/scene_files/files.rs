//! Finds scenes on disk, with the files that they name. Knows nothing of what is in them.

use super::{
    MOST_VIEWS, ScenePath,
    given::{self, Given},
    named,
};
use crate::assets::{ascii, ending, expand, search};
use std::{
    cell::Cell,
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};
use tauflow_contract::{Digest, ItemKey, KindError, ParamProblem, SourceItem};
use tauflow_data::{StratumName, records::SceneRecord, scene::Scene};

/// Most bytes of the files that a scene names.
const MOST_BYTES: u64 = 1 << 33;

/// Path of a blob beside a `scene.json`.
pub fn blob(digest: &Digest) -> String {
    format!("{}/{digest}", SceneRecord::BLOB_FOLDER)
}

/// The files that a `scene.json` names.
pub fn described(bytes: &[u8]) -> BTreeSet<String> {
    let blobs = serde_json::from_slice::<Scene>(bytes).map_or(Vec::new(), |scene| scene.blobs());
    blobs.iter().map(blob).chain([SceneRecord::RECIPE_FILE.to_owned()]).collect()
}

/// Part name of a scene's own file: with its view and its name, which its action has no other way to learn.
fn main_part(view: usize, name: &str) -> String {
    format!("main/{view:04}/{name}")
}

/// The part, view and name that [`main_part`] says.
pub fn parse_main(part: &str) -> Option<(String, usize, String)> {
    let (view, name) = part.strip_prefix("main/")?.split_once('/')?;
    Some((part.to_owned(), view.parse().ok()?, name.to_owned()))
}

/// True for what a folder is searched for.
fn is_scene(path: &Path) -> bool {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    name == SceneRecord::FILE || matches!(ending(&name).as_str(), "xml" | "pbrt" | "glb" | "gltf")
}

fn name_of(path: &Path) -> String {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    if ending(&name) == "json" { SceneRecord::FILE.to_owned() } else { ascii(&name) }
}

/// A scene's own file, and all that it names.
struct FoundScene {
    path: PathBuf,
    files: Vec<(String, PathBuf)>,
    views: usize,
    /// True for what is no file that can be read: an item without files, which its action leaves out.
    lost: bool,
}

fn look(path: &Path, root: &Path) -> Result<FoundScene, KindError> {
    let none = |why: String| KindError::Input(format!("scene_files: `{}` {why}", path.display()));
    let metadata = fs::metadata(path).map_err(|e| none(format!("cannot be read: {e}; mend the path")))?;
    if !metadata.is_file() || metadata.len() > 1 << 31 {
        return Err(none("is no regular file of up to 2 GiB; put one in its place".into()));
    }
    let bytes = fs::read(path).map_err(|e| none(format!("cannot be read: {e}; mend its permissions")))?;
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    // A folder that a link leads to outside of the root has no folder of the root above it.
    let above = given::depth(&folder, root).unwrap_or(0);
    let given = Given::Disk { folder, above, read: Cell::new(0) };
    let (names, views) = named(&name_of(path), &bytes, &given);
    let files = given.parts(&names);
    let sum: u64 = files.iter().filter_map(|(_, file)| Some(fs::metadata(file).ok()?.len())).sum();
    if sum > MOST_BYTES {
        let what = format!("names files of {sum} bytes; use fewer or smaller ones, {MOST_BYTES} bytes at most");
        return Err(none(what));
    }
    Ok(FoundScene { path: path.to_owned(), files, views, lost: false })
}

/// [`look`], but what cannot be read is no error where it may be left out.
fn look_or_lose(path: &Path, root: &Path, leave_out: bool) -> Result<FoundScene, KindError> {
    let lost = || FoundScene { path: path.to_owned(), files: Vec::new(), views: 1, lost: true };
    look(path, root).or_else(|error| if leave_out { Ok(lost()) } else { Err(error) })
}

/// What [`on_disk`] gives.
type OnDisk = (String, BTreeMap<String, Vec<u8>>, Vec<PathBuf>);

/// The name of a scene's file, its parts in memory, and the files that they were read from.
///
/// # Errors
/// If the file cannot be read, or is no scene by its ending.
pub fn on_disk(path: &Path, root: Option<&Path>) -> Result<OnDisk, KindError> {
    let own = path.parent().unwrap_or(Path::new(""));
    let root = root.unwrap_or(own);
    if !given::real(root).is_ok_and(|real| real.is_dir()) {
        return Err(KindError::Input(format!("`{}` is no folder; name one that holds the scene", root.display())));
    }
    // A scene that is not there is told by the one who looks.
    if given::real(own).is_ok() && given::depth(own, root).is_none() {
        let (path, root) = (path.display(), root.display());
        return Err(KindError::Input(format!("`{path}` does not lie below `{root}`; name a folder above it")));
    }
    let found = look(path, root)?;
    let (mut parts, mut read) = (BTreeMap::new(), Vec::new());
    for (part, file) in found.files.into_iter().chain([(given::MAIN.to_owned(), found.path)]) {
        let failed = |e| KindError::Environment(format!("cannot read {}: {e}", file.display()));
        parts.insert(part, fs::read(&file).map_err(failed)?);
        read.push(file);
    }
    Ok((name_of(path), parts, read))
}

/// The scenes of an entry, with the folder that their files must not leave.
fn scenes(entry: &ScenePath, leave_out: bool) -> Result<Vec<FoundScene>, KindError> {
    if Path::new(&entry.path).is_dir() {
        let root = Path::new(&entry.path);
        let mut paths = search(std::slice::from_ref(&entry.path), &is_scene)?;
        paths.sort();
        let found: Vec<FoundScene> =
            paths.iter().map(|path| look_or_lose(path, root, leave_out)).collect::<Result<_, _>>()?;
        // A file that another one includes is a piece of that one.
        let same = |path: &Path| fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let pieces: BTreeSet<PathBuf> = found.iter().flat_map(|f| f.files.iter().map(|(_, p)| same(p))).collect();
        let found: Vec<FoundScene> = found.into_iter().filter(|f| !pieces.contains(&same(&f.path))).collect();
        if found.is_empty() {
            return Err(KindError::Input(format!(
                "scene_files: no scene.json, .xml, .pbrt, .glb or .gltf file in `{}`; name a folder that holds some",
                entry.path
            )));
        }
        return Ok(found);
    }
    let paths: Vec<PathBuf> = expand(&entry.path)?.into_iter().filter(|p| p.symlink_metadata().is_ok()).collect();
    if paths.is_empty() {
        return Err(KindError::Input(format!("scene_files: nothing fits `{}`; mend the path", entry.path)));
    }
    let one = |path: PathBuf| {
        if !is_scene(&path) && ending(&path.to_string_lossy()) != "json" {
            let path = path.display();
            let what =
                format!("scene_files: `{path}` is no scene by its ending; use .json, .xml, .pbrt, .glb or .gltf");
            return Err(KindError::Input(what));
        }
        look_or_lose(&path, path.parent().unwrap_or(Path::new("")), leave_out)
    };
    paths.into_iter().map(one).collect()
}

/// The blobs that a `scene.json` needs and that are not there. What other files name is known once they are read: they
/// may name more than their scene shows.
pub fn missing(entries: &[ScenePath]) -> Vec<ParamProblem> {
    let mut problems = Vec::new();
    for (number, entry) in entries.iter().enumerate() {
        // A path that cannot be searched is told by the list of items.
        let Ok(found) = scenes(entry, true) else { continue };
        for scene in found.iter().filter(|scene| name_of(&scene.path) == SceneRecord::FILE) {
            let there: BTreeSet<&str> = scene.files.iter().map(|(part, _)| part.as_str()).collect();
            let wanted = fs::read(&scene.path).map_or_else(|_| BTreeSet::new(), |bytes| described(&bytes));
            let lost: Vec<&String> = wanted
                .iter()
                .filter(|path| *path != SceneRecord::RECIPE_FILE && !there.contains(given::part(path).as_str()))
                .collect();
            if let Some(first) = lost.first() {
                let more = if lost.len() > 1 { format!(" and {} more", lost.len() - 1) } else { String::new() };
                let what = format!("`{}` needs `{first}`{more}, which is not there", scene.path.display());
                let pointer = format!("/scenes/{number}/path");
                problems.push(ParamProblem::new(pointer, what, "put it beside the scene, or export the scene again"));
            }
        }
    }
    problems
}

/// The items of all entries: each view of each scene, numbered by stratum in the order in which they are given.
///
/// # Errors
/// If a path leads nowhere, or a folder holds no scene.
pub fn items(entries: &[ScenePath], leave_out: bool) -> Result<Vec<SourceItem>, KindError> {
    let mut numbers: BTreeMap<&StratumName, u64> = BTreeMap::new();
    let mut items = Vec::new();
    for entry in entries {
        for found in scenes(entry, leave_out)? {
            for view in 0..found.views.clamp(1, MOST_VIEWS) {
                let number = numbers.entry(&entry.stratum).or_default();
                let mut files = found.files.clone();
                if !found.lost {
                    files.push((main_part(view, &name_of(&found.path)), found.path.clone()));
                }
                let key: ItemKey = entry.stratum.item_key(*number);
                *number += 1;
                items.push(SourceItem { key, files });
            }
        }
    }
    Ok(items)
}
