//! `real_assets.yaml` over the shared HDRIs and objects: every file is in a rendered scene, or is refused by name for a
//! reason. A pipeline may have no assets at all, where it says so.

use crate::support::{Done, root};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};
use tauflow_data::{
    records::{AssetReport, SceneRecord},
    scene::Recipe,
};
use tauflow_testing::{Need, skip};

fn files(folder: &Path, found: &mut BTreeSet<String>) {
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("can be read").path();
        if path.is_dir() {
            files(&path, found);
        } else if path.extension().is_some_and(|e| ["hdr", "exr", "glb", "gltf"].iter().any(|known| e == *known)) {
            found.insert(path.file_name().expect("a file").to_string_lossy().into_owned());
        }
    }
}

#[test]
fn every_file_appears_in_a_rendered_scene() {
    let shared = root().join("../shared/assets");
    if !shared.is_dir() {
        skip(Need::Shared, "the shared HDRIs and objects are not here");
        return;
    }
    let (maps, objects) = (shared.join("hdri"), shared.join("gltf"));
    let mut names = BTreeSet::new();
    files(&maps, &mut names);
    files(&objects, &mut names);
    assert_eq!(names.len(), 31, "{names:?}");

    let folder = tempfile::tempdir().expect("a temporary folder");
    let sets = vec![
        format!("assets.folders={}", serde_json::to_string(&[maps, objects]).expect("paths in UTF-8")),
        "assets.max_texture=64".into(),
        "previews.rungs=[4]".into(),
        "previews.resolution=[32, 32]".into(),
    ];
    let done = Done::run(&root().join("pipelines/real_assets.yaml"), sets, folder.path());

    let reports: BTreeMap<String, AssetReport> = done.read("assets.reports");
    let refused: BTreeMap<&str, &str> =
        reports.values().filter_map(|r| Some((r.name.as_str(), r.reason.as_deref()?))).collect();
    println!("refused: {refused:?}");
    assert!(refused.keys().eq(["BoxMeshopt.glb"].iter()), "{refused:?}");

    let rendered: BTreeSet<String> = done.keys("previews").into_iter().collect();
    let scenes: BTreeMap<String, SceneRecord> = done.read("scenes.scenes");
    let recipes: BTreeMap<String, Recipe> = scenes.into_iter().map(|(key, record)| (key, record.recipe)).collect();
    let mut shown = BTreeSet::new();
    for (key, recipe) in recipes {
        assert!(rendered.contains(&key), "{key}");
        shown.extend(recipe.objects);
        shown.insert(recipe.environment);
    }
    for (asset, report) in reports {
        assert!(names.remove(&report.name), "{}", report.name);
        assert!(!report.accepted || shown.contains(&asset), "{} is in no rendered scene: {shown:?}", report.name);
    }
    assert!(names.is_empty(), "neither decoded nor refused: {names:?}");
}

#[test]
fn without_assets_scenes_are_as_if_none_were_connected() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("none.yaml");
    let text = "
pipeline: none
seed: 7
nodes:
  assets: { kind: assets, params: { folders: [], allow_none: true } }
  connected: { kind: scene_generation, inputs: { assets: assets }, params: { pool: 12, views: [1, 1] } }
  alone: { kind: scene_generation, params: { pool: 12, views: [1, 1] } }
";
    std::fs::write(&file, text).expect("written");
    let done = Done::run(&file, Vec::new(), &folder.path().join("cache"));
    let scenes = |node: &str| -> BTreeMap<String, SceneRecord> { done.read(node) };
    assert_eq!(scenes("connected").len(), 12);
    assert_eq!(scenes("connected"), scenes("alone"));
}
