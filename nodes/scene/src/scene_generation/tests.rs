//! Tests of `scene_generation` as the engine calls it.

use super::*;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::atomic::AtomicBool,
};
use tauflow_contract::{Artifact, Blobs, Collection, KindRow, MemoryBlobs, NodeKind, Silent};
use tauflow_data::{
    ContextClass, Image, Regime, Scene,
    mesh::Mesh,
    scene::{Bsdf, Emitter, Geometry, Recipe},
};

/// A scene made the way the engine does: by projection, resolved again, with the item's own seed.
fn make(blobs: &MemoryBlobs, params: &Value, key: &str, assets: Option<&Collection>) -> Artifact {
    let row = KindRow::<SceneGeneration>::new();
    let key = ItemKey::new(key).expect("plain");
    let params = row.resolve(params).expect("fine params");
    let params = row.projection(&params)(Some(&key), "main");
    let cancel = AtomicBool::new(false);
    let ctx = Context::new(blobs, &Silent, &cancel);
    let action = Action {
        params,
        item: Some(&key),
        group: "main",
        seed: row.seed(7, key.as_str()),
        each: BTreeMap::new(),
        all: assets.map(|a| (ASSETS.name(), a)).into_iter().collect(),
    };
    row.run(&ctx, &action).expect("a scene").items.remove(SCENES.name()).expect("the port")
}

fn read(blobs: &MemoryBlobs, artifact: &Artifact) -> (Scene, Recipe) {
    let cancel = AtomicBool::new(false);
    let SceneRecord { scene, recipe } =
        SceneRecord::load(&Context::new(blobs, &Silent, &cancel), artifact).expect("a scene and its recipe");
    (scene, recipe)
}

fn params() -> Value {
    serde_json::json!({ "pool": 60 })
}

fn keys(params: &Value) -> Vec<String> {
    let row = KindRow::<SceneGeneration>::new();
    let params = row.resolve(params).expect("fine params");
    row.items(&params).expect("no files").into_iter().map(|i| i.key.to_string()).collect()
}

#[test]
fn the_pool_spreads_evenly_and_grows_by_appending() {
    for pool in [1, 11, 12, 13, 120, 250] {
        let small = keys(&serde_json::json!({ "pool": pool }));
        assert_eq!(small.len(), pool);
        let large = keys(&serde_json::json!({ "pool": pool + 5 }));
        assert!(small.iter().all(|k| large.contains(k)));
        let counts: Vec<usize> =
            Stratum::all().map(|s| small.iter().filter(|k| k.starts_with(&format!("{s}-"))).count()).collect();
        assert!(counts.iter().max().expect("12") - counts.iter().min().expect("12") <= 1);
    }
    assert_eq!(keys(&serde_json::json!({ "pool": 4, "regimes": ["L1"], "contexts": ["open"] })).len(), 4);
}

#[test]
fn scenes_are_whole_round_trip_and_belong_to_their_stratum() {
    let blobs = MemoryBlobs::default();
    for key in keys(&params()) {
        let artifact = make(&blobs, &params(), &key, None);
        let (scene, recipe) = read(&blobs, &artifact);
        let (stratum, index) = Stratum::of_key(&key).expect("a scene's key");
        assert_eq!((recipe.stratum.as_str(), recipe.index), (stratum.to_string().as_str(), index));
        assert!(!recipe.objects.is_empty() && recipe.objects.is_sorted(), "{key}");
        assert_eq!(serde_json::from_str::<Scene>(&serde_json::to_string(&scene).expect("JSON")).expect("back"), scene);
        for digest in scene.blobs() {
            assert!(artifact.parts.iter().any(|(_, part)| *part == digest), "{key}: {digest}");
            let bytes = blobs.get(&digest).expect("in memory").expect("stored");
            assert!(Mesh::from_bytes(&bytes).is_ok() || Image::from_bytes(&bytes).is_ok(), "{key}: {digest}");
        }
        assert!(scene.shapes.iter().all(|s| s.material < scene.materials.len()), "{key}");
        let numbers = scene.shapes.iter().flat_map(|s| s.to_world.iter().flatten());
        assert!(numbers.copied().chain(scene.camera.origin).chain(scene.camera.target).all(f64::is_finite), "{key}");
        let envmaps = scene.emitters.iter().filter(|e| matches!(e, Emitter::Envmap { .. })).count();
        assert_eq!(envmaps, usize::from(stratum.context != ContextClass::Enclosed), "{key}");
        assert_eq!(recipe.environment == "none", stratum.context == ContextClass::Enclosed, "{key}");
        let lit = scene.shapes.iter().filter(|s| s.emission.is_some()).count();
        assert!(stratum.context != ContextClass::Enclosed || lit > 0, "{key}");
        let text = serde_json::to_string(&scene.materials).expect("JSON");
        let has = |name: &str| text.contains(&format!("\"type\":\"{name}\""));
        match stratum.regime {
            Regime::L0 => assert!(
                !["conductor", "dielectric", "plastic", "principled", "thin_dielectric"].iter().any(|n| has(n)),
                "{key}"
            ),
            Regime::L1 => assert!(has("conductor") || has("plastic") || has("principled"), "{key}"),
            Regime::L2 => {
                assert!(has("dielectric"), "{key}");
                let mut smooth = Vec::new();
                scene.materials.iter().for_each(|m| specular(m, &mut smooth));
                assert!(smooth.is_empty(), "{key}: {smooth:?}");
            }
            Regime::L3 => {
                let mut smooth = Vec::new();
                scene.materials.iter().for_each(|m| specular(m, &mut smooth));
                assert!(!smooth.is_empty(), "{key}");
                assert!(!scene.emitters.iter().any(|e| matches!(e, Emitter::Spot { .. } | Emitter::Point { .. })));
            }
        }
        // Glass only on closed bodies.
        for shape in &scene.shapes {
            let material = serde_json::to_string(&scene.materials[shape.material]).expect("JSON");
            if let (true, Geometry::Mesh { mesh }) = (material.contains("\"type\":\"dielectric\""), &shape.geometry) {
                let mesh = Mesh::from_bytes(&blobs.get(mesh).expect("in memory").expect("stored")).expect("a mesh");
                assert!(tauflow_data::mesh_check::is_closed(&mesh), "{key}");
            }
        }
    }
}

/// Lobes of a material that make caustics: smooth glass and smooth metal. Coats of plastic do not count.
fn specular<'a>(material: &'a Bsdf, found: &mut Vec<&'a Bsdf>) {
    let smooth = tauflow_data::scene::DELTA_ALPHA;
    match material {
        Bsdf::Conductor { alpha, .. } | Bsdf::Dielectric { alpha, .. } if *alpha < smooth => found.push(material),
        Bsdf::Mask { inner, .. }
        | Bsdf::NormalMap { inner, .. }
        | Bsdf::Relief { inner, .. }
        | Bsdf::TwoSided { inner } => specular(inner, found),
        Bsdf::Blend { a, b, .. } => {
            specular(a, found);
            specular(b, found);
        }
        _ => {}
    }
}

#[test]
fn the_same_seed_and_index_give_the_same_bytes() {
    for key in ["L0-environment-000000", "L1-open-000003", "L2-enclosed-000001", "L3-environment-000004"] {
        let a = make(&MemoryBlobs::default(), &params(), key, None);
        let b = make(&MemoryBlobs::default(), &serde_json::json!({ "pool": 3000 }), key, None);
        assert_eq!(a.digest(), b.digest(), "{key}");
    }
    let blobs = MemoryBlobs::default();
    let a = make(&blobs, &params(), "L0-environment-000000", None);
    let b = make(&blobs, &params(), "L0-environment-000001", None);
    assert_ne!(read(&blobs, &a).0, read(&blobs, &b).0);
}

#[test]
fn a_range_is_read_by_its_regime_alone() {
    let row = KindRow::<SceneGeneration>::new();
    let before = row.resolve(&params()).expect("fine");
    for (edit, regime) in [
        (serde_json::json!({ "glossy": { "roughness": [0.2, 0.3] } }), Some(Regime::L1)),
        (serde_json::json!({ "refractive": { "ior": [1.4, 1.5] } }), Some(Regime::L2)),
        (serde_json::json!({ "caustic": { "mirror": 0.9 } }), Some(Regime::L3)),
        (serde_json::json!({ "pool": 61 }), None),
    ] {
        let after = row.resolve(&edit).expect("fine");
        for stratum in Stratum::all() {
            let key = stratum.item_key(0);
            let same = row.projection(&before)(Some(&key), "main") == row.projection(&after)(Some(&key), "main");
            assert_eq!(same, regime != Some(stratum.regime), "{edit} {stratum}");
        }
    }
    let after = row.resolve(&serde_json::json!({ "max_depth": { "enclosed": 20 } })).expect("fine");
    for stratum in Stratum::all() {
        let key = stratum.item_key(0);
        let same = row.projection(&before)(Some(&key), "main") == row.projection(&after)(Some(&key), "main");
        assert_eq!(same, stratum.context != ContextClass::Enclosed, "{stratum}");
    }
}

#[test]
fn the_other_parts_of_a_scene_stay_when_one_range_changes() {
    let blobs = MemoryBlobs::default();
    let key = "L1-open-000002";
    let (before, recipe) = read(&blobs, &make(&blobs, &params(), key, None));
    let edit = serde_json::json!({ "glossy": { "roughness": [0.2, 0.3] }, "exposure": [0.0, 0.5] });
    let (after, edited) = read(&blobs, &make(&blobs, &edit, key, None));
    assert_eq!(before.camera, after.camera);
    assert_eq!(recipe.layout_params, edited.layout_params);
    assert_eq!(recipe.objects, edited.objects);
    assert_ne!(before.materials, after.materials);
}

#[test]
fn hold_out_parts_objects_and_environments() {
    let blobs = MemoryBlobs::default();
    let params = serde_json::json!({ "pool": 240, "views": [1, 1], "hold_out": ["objects", "environments"],
        "test_share": 0.3 });
    let recipes: Vec<Recipe> = keys(&params).iter().map(|k| read(&blobs, &make(&blobs, &params, k, None)).1).collect();
    let of = |side| recipes.iter().filter(move |r| r.side == Some(side));
    use tauflow_data::scene::Side::{Test, Train};
    assert_eq!(of(Test).count() + of(Train).count(), 240);
    assert_eq!(of(Test).count(), 72, "30 in a hundred of 20 for each stratum");
    let shared = crate::signature::shared_assets(of(Train), of(Test), false, true);
    assert!(shared.is_empty(), "{shared:?}");
    let objects = crate::signature::shared_assets(of(Train), of(Test), true, false);
    assert!(objects.is_empty(), "{objects:?}");
    // What scenes show is parted by form, what they are furnished with by variants.
    let forms = |r: &Recipe| -> Vec<&'static tauflow_scene_library::forms::Form> {
        let name = |o: &String| {
            let (name, _) = o.strip_prefix("procedural/").and_then(|o| o.rsplit_once('-')).expect("a variant");
            tauflow_scene_library::forms::forms().iter().find(|f| f.name == name).expect("a form")
        };
        r.objects.iter().map(name).collect()
    };
    let names = |side, shows| -> BTreeSet<&'static str> {
        of(side).flat_map(forms).filter(|f| cast::shown(f.family) == shows).map(|f| f.name).collect()
    };
    assert!(names(Train, true).is_disjoint(&names(Test, true)));
    assert!(names(Test, true).len() > 3 && names(Train, true).len() > 10);
    assert!(names(Train, false).intersection(&names(Test, false)).count() > 20, "chairs stand on both sides");
}

#[test]
fn views_of_a_content_share_what_is_there_and_differ_in_how_it_is_seen() {
    let blobs = MemoryBlobs::default();
    let params = serde_json::json!({ "pool": 144, "views": [2, 4] });
    let mut contents: BTreeMap<(String, u64), Vec<(Scene, Recipe)>> = BTreeMap::new();
    for key in keys(&params) {
        let (scene, recipe) = read(&blobs, &make(&blobs, &params, &key, None));
        contents.entry((recipe.stratum.clone(), recipe.content())).or_default().push((scene, recipe));
    }
    let (mut scenes, mut turned, mut dimmed) = (0, 0, 0);
    for ((stratum, content), views) in &contents {
        assert!(views.len() <= 4, "{stratum} {content}");
        let signature = |recipe: &Recipe| crate::signature::signature(recipe, crate::signature::QUANTUM);
        let forms = |scene: &Scene| scene.shapes.iter().map(|s| (s.geometry.clone(), s.material)).collect::<Vec<_>>();
        let [(first, plain), rest @ ..] = &views[..] else { panic!("a content without views") };
        for (number, (_, recipe)) in views.iter().enumerate() {
            assert_eq!((recipe.view as usize, recipe.index), (number, plain.index + number as u64), "{stratum}");
        }
        for (scene, recipe) in rest {
            assert_eq!(signature(recipe), signature(plain), "{stratum} {content}");
            assert_eq!((&recipe.objects, &recipe.environment), (&plain.objects, &plain.environment));
            assert_eq!((forms(scene), &scene.materials), (forms(first), &first.materials), "{stratum} {content}");
            assert_ne!(scene.camera, first.camera, "{stratum} {content}");
            assert_ne!((scene.seed, recipe.exposure_ev), (first.seed, plain.exposure_ev), "{stratum} {content}");
            let emissions = |scene: &Scene| scene.shapes.iter().map(|s| s.emission.clone()).collect::<Vec<_>>();
            turned += usize::from(scene.emitters != first.emitters);
            dimmed += usize::from(emissions(scene) != emissions(first));
            scenes += 1;
        }
    }
    assert!(scenes > 80 && turned > scenes / 2 && dimmed > scenes / 2, "{scenes}: {turned} {dimmed}");
    // Contents differ in what is there.
    let mut signatures: Vec<_> =
        contents.values().map(|views| crate::signature::signature(&views[0].1, 0.05)).collect();
    signatures.sort();
    signatures.dedup();
    assert_eq!(signatures.len(), contents.len());
}

#[test]
fn libraries_share_no_object_sky_or_pattern() {
    let blobs = MemoryBlobs::default();
    let of = |library: u64| {
        let params = serde_json::json!({ "pool": 240, "views": [1, 1], "library": library });
        let (mut names, mut contents) = (BTreeSet::new(), BTreeMap::<_, BTreeSet<String>>::new());
        for key in keys(&params) {
            let artifact = make(&blobs, &params, &key, None);
            let (scene, recipe) = read(&blobs, &artifact);
            let all = recipe.objects.iter().chain([&recipe.environment]);
            names.extend(all.filter(|name| name.starts_with("procedural/")).cloned());
            for digest in scene.blobs() {
                contents.entry(digest).or_default().insert(recipe.layout.clone());
            }
        }
        (names, contents)
    };
    let (first, second) = (of(0), of(1));
    let shared: Vec<&String> = first.0.intersection(&second.0).collect();
    assert!(shared.is_empty(), "{shared:?}");
    assert!(first.1.len() > 300 && second.1.len() > 300, "{} {}", first.1.len(), second.1.len());
    // What else they share are parts of buildings, a few parts of things, and maps of one value.
    let shared: Vec<_> = first.1.iter().filter(|(digest, _)| second.1.contains_key(digest)).collect();
    assert!(shared.len() <= 80, "{shared:?}");
    let mut fixed = 0;
    for (digest, layouts) in shared {
        let bytes = blobs.get(digest).expect("in memory").expect("stored");
        match Image::from_bytes(&bytes) {
            Ok(image) => {
                let span = image.data().iter().fold([1.0f32, 0.0], |s, v| [s[0].min(*v), s[1].max(*v)]);
                assert!(span[1] - span[0] < 0.02, "{digest}: a map that is not even, in {layouts:?}");
            }
            // A castor is a castor: some parts of things do not vary.
            Err(_) => fixed += usize::from(Mesh::from_bytes(&bytes).is_ok_and(|mesh| mesh.normals.is_some())),
        }
    }
    assert!(fixed <= 6, "{fixed} parts of things");
}

#[test]
fn ranges_out_of_order_are_named_and_the_schema_knows_the_bounds() {
    let row = KindRow::<SceneGeneration>::new();
    let schema = row.params_schema();
    for (place, bound) in [
        ("/properties/pool/minimum", 1.0),
        ("/properties/regimes/minItems", 1.0),
        ("/properties/fov/items/minimum", 5.0),
        ("/properties/fov/items/maximum", 120.0),
        ("/properties/objects/items/maximum", 200.0),
        ("/properties/views/items/minimum", 1.0),
        ("/properties/views/items/maximum", 64.0),
        ("/$defs/GlossyRanges/properties/roughness/items/maximum", 1.0),
    ] {
        assert_eq!(schema.pointer(place).and_then(Value::as_f64), Some(bound), "{place}: {schema:#}");
    }
    let bad = serde_json::json!({ "objects": [4, 3], "views": [2, 1], "glossy": { "roughness": [0.5, 0.1] },
        "fov": [60.0, 50.0], "hold_out": ["objects"], "test_share": 1.0 });
    let problems = row.resolve(&bad).expect_err("bad");
    let pointers: Vec<&str> = problems.iter().map(|p| p.pointer.as_str()).collect();
    for pointer in ["/objects", "/views", "/glossy/roughness", "/fov", "/test_share"] {
        assert!(pointers.contains(&pointer), "{pointers:?}");
    }
}

#[test]
fn transmission_is_never_two_sided() {
    let blobs = MemoryBlobs::default();
    for stratum in Stratum::all() {
        let (scene, _) = read(&blobs, &make(&blobs, &params(), stratum.item_key(1).as_str(), None));
        for material in &scene.materials {
            if let Bsdf::TwoSided { inner } = material {
                assert!(!matches!(**inner, Bsdf::Dielectric { .. } | Bsdf::ThinDielectric { .. }));
            }
        }
    }
}

#[test]
fn files_of_scenes_are_small() {
    let blobs = MemoryBlobs::default();
    let params = serde_json::json!({ "pool": 96, "views": [1, 1] });
    let mut sizes = Vec::new();
    for key in keys(&params) {
        let artifact = make(&blobs, &params, &key, None);
        let (scene, recipe) = read(&blobs, &artifact);
        let bytes = |v: &str| v.len();
        sizes.push(
            bytes(&serde_json::to_string(&scene).expect("JSON"))
                + bytes(&serde_json::to_string(&recipe).expect("JSON")),
        );
    }
    // Thirty thousand scenes in 1 GB: 33 KB each.
    let mean = sizes.iter().sum::<usize>() / sizes.len();
    assert!(mean < 33_000, "{mean} bytes per scene");
    assert!(sizes.iter().all(|s| *s < 120_000), "{:?}", sizes.iter().max());
}
