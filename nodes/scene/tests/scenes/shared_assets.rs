//! The shared HDRIs and objects get into scenes, each file into some. Where they are held out, a file gets into scenes
//! of one side alone.

use crate::support::{load, shared, source};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{Blobs, MemoryBlobs};
use tauflow_data::{
    records::SceneRecord,
    scene::{Emitter, Scene, Side},
};

#[test]
fn every_asset_gets_into_a_scene() {
    let (Some(maps), Some(objects)) = (shared("hdri"), shared("gltf")) else { return };
    let blobs = MemoryBlobs::default();
    let params = json!({ "folders": [maps, objects], "max_texture": 64 });
    let assets = source(&blobs, "assets", params, &BTreeMap::new()).remove("assets").expect("the port");
    assert_eq!(assets.len(), 30);
    let whole = BTreeMap::from([("assets", &assets)]);
    let scenes_of =
        |params: Value| source(&blobs, "scene_generation", params, &whole).remove("scenes").expect("the port");
    let names: BTreeSet<String> = assets.iter().map(|(key, _)| key.to_string()).collect();
    let mut shown = BTreeSet::new();
    for (key, artifact) in scenes_of(json!({ "pool": 60, "views": [1, 1] })).iter() {
        let SceneRecord { scene, recipe } = load(&blobs, artifact);
        for digest in scene.blobs() {
            assert!(blobs.get(&digest).expect("in memory").is_some(), "{key}: {digest}");
        }
        needs_what_it_holds(key.as_str(), &scene);
        shown.extend(recipe.objects);
        shown.insert(recipe.environment);
    }
    let missing: Vec<&String> = names.difference(&shown).collect();
    assert!(missing.is_empty(), "in no scene: {missing:?}");

    // Held out: every asset still gets into a scene, and none into scenes of both sides.
    let held = json!({ "pool": 120, "views": [1, 1], "hold_out": ["objects", "environments"], "test_share": 0.3 });
    let mut sides: BTreeMap<String, BTreeSet<Side>> = BTreeMap::new();
    for (key, artifact) in scenes_of(held).iter() {
        let SceneRecord { recipe, .. } = load(&blobs, artifact);
        let side = recipe.side.unwrap_or_else(|| panic!("{key} has no side"));
        for name in recipe.objects.into_iter().chain([recipe.environment]).filter(|name| name != "none") {
            sides.entry(name).or_default().insert(side);
        }
    }
    assert!(sides.values().all(|side| side.len() == 1), "{sides:?}");
    let missing: Vec<&String> = names.iter().filter(|name| !sides.contains_key(*name)).collect();
    assert!(missing.is_empty(), "held out and in no scene: {missing:?}");
}

/// A scene holds nothing that its stratum does not need: no gloss or glass where all is diffuse, no sky in a room,
/// no mesh, material or image that nothing shows.
fn needs_what_it_holds(key: &str, scene: &Scene) {
    let materials = serde_json::to_string(&scene.materials).expect("JSON");
    if key.starts_with("L0-") {
        for other in ["principled", "plastic", "conductor", "dielectric", "thin_dielectric"] {
            assert!(!materials.contains(&format!("\"type\":\"{other}\"")), "{key}: {other}");
        }
    }
    let maps = scene.emitters.iter().filter(|e| matches!(e, Emitter::Envmap { .. })).count();
    assert_eq!(maps, usize::from(!key.contains("-enclosed-")), "{key}");
    let used: BTreeSet<usize> = scene.shapes.iter().map(|s| s.material).collect();
    assert_eq!(used.len(), scene.materials.len(), "{key}: every material is on a shape");
}
