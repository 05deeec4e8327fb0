//! Tests of `stratified_sampling`.

use super::*;
use std::sync::atomic::AtomicBool;
use tauflow_contract::{Collection, Digest, MemoryBlobs, Silent};
use tauflow_data::scene::{Camera, Recipe, Scene};

fn side(per_stratum: u64, without: &str) -> Collection {
    Stratum::all()
        .filter(|s| s.to_string() != without)
        .flat_map(|s| (0..per_stratum).map(move |i| s.item_key(i)))
        .map(|key| {
            let digest = Digest::of(key.as_str().as_bytes());
            (key, Stored::<SceneRecord>::blob(digest).into_artifact())
        })
        .collect()
}

fn run(
    train: &Collection,
    test: Option<&Collection>,
    params: StratifiedSamplingParams,
) -> Result<(Outputs, serde_json::Value), KindError> {
    run_beside(train, test, None, params)
}

fn run_beside(
    train: &Collection,
    test: Option<&Collection>,
    taken: Option<&Collection>,
    params: StratifiedSamplingParams,
) -> Result<(Outputs, serde_json::Value), KindError> {
    let (blobs, cancel) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &cancel);
    let mut all = BTreeMap::from([(TRAIN_SIDE.name(), train)]);
    all.extend(test.map(|t| (TEST_SIDE.name(), t)));
    all.extend(taken.map(|t| (TAKEN.name(), t)));
    let action = Action { params, item: None, group: "main", seed: 0, each: BTreeMap::new(), all };
    let outputs = StratifiedSampling::run(&ctx, &action)?;
    let report = ctx.json(outputs.collections[REPORT.name()].get("report").expect("one item"), "")?;
    Ok((outputs, report))
}

#[test]
fn five_thousand_is_eight_of_417_and_four_of_416() {
    let strata: Vec<StratumName> = Stratum::all().map(StratumName::from).collect();
    let counts: Vec<u64> = quotas(&strata, 5000, 0).iter().map(|q| q.1).collect();
    assert_eq!(counts.iter().filter(|c| **c == 417).count(), 8);
    assert_eq!(counts.iter().filter(|c| **c == 416).count(), 4);
    assert!(quotas(&strata, 1200, 0).iter().all(|q| q.1 == 100));
    assert_ne!(quotas(&strata, 5000, 0), quotas(&strata, 5000, 1), "the remainder's order is seeded");
}

#[test]
fn quotas_are_filled_in_order_of_index() {
    let params = StratifiedSamplingParams { train: 50, test: 24, ..Default::default() };
    let (train, test) = (side(9, ""), side(5, ""));
    let (outputs, report) = run(&train, Some(&test), params).expect("enough");
    assert_eq!((outputs.collections["train"].len(), outputs.collections["test"].len()), (50, 24));
    for key in outputs.collections["test"].items.keys() {
        assert!(Stratum::of_key(key.as_str()).expect("a scene").1 < 2);
    }
    assert_eq!(report["test"]["equal"], true);
    assert_eq!(report["short"].as_array().map(Vec::len), Some(0));
}

#[test]
fn what_is_taken_is_passed_over() {
    let (train, test) = (side(3, ""), side(5, ""));
    let params = |test| StratifiedSamplingParams { test, ..Default::default() };
    let (first, _) = run(&train, Some(&test), params(24)).expect("enough");
    let taken = &first.collections["test"];
    let (second, report) = run_beside(&train, Some(&test), Some(taken), params(36)).expect("three are left of five");
    let second = &second.collections["test"];
    assert_eq!((second.len(), second.items.keys().filter(|key| taken.items.contains_key(*key)).count()), (36, 0));
    assert_eq!(report["test"]["strata"]["L1-open"]["available"], 3);
    let error = run_beside(&train, Some(&test), Some(taken), params(48)).expect_err("short").to_string();
    assert!(error.contains("L1-open on the test side: 3 of 4"), "{error}");
}

#[test]
fn strata_that_fall_short_are_named() {
    let train = side(3, "L2-open");
    let params = StratifiedSamplingParams { train: 24, ..Default::default() };
    let error = run(&train, None, params.clone()).expect_err("short").to_string();
    assert!(error.contains("L2-open on the train side: 0 of 2") && !error.contains("L1-open"), "{error}");
    let (outputs, report) =
        run(&train, None, StratifiedSamplingParams { allow_short: true, ..params }).expect("allowed");
    assert_eq!(outputs.collections["train"].len(), 22);
    assert_eq!(report["short"].as_array().map(Vec::len), Some(1));
    let unconnected = StratifiedSamplingParams { test: 12, ..Default::default() };
    assert!(run(&train, None, unconnected).expect_err("no input").to_string().contains("not connected"));
}

proptest::proptest! {
    #[test]
    fn larger_quotas_keep_every_choice(total in 0u64..200, more in 0u64..60, seed in 0u64..8) {
        let strata: Vec<StratumName> = Stratum::all().map(StratumName::from).collect();
        let (small, large) = (quotas(&strata, total, seed), quotas(&strata, total + more, seed));
        proptest::prop_assert_eq!(small.iter().map(|q| q.1).sum::<u64>(), total);
        let (low, high) = (small.iter().map(|q| q.1).min(), small.iter().map(|q| q.1).max());
        proptest::prop_assert!(high.unwrap_or(0) - low.unwrap_or(0) <= 1);
        for (a, b) in small.iter().zip(&large) {
            proptest::prop_assert!(a.1 <= b.1);
        }
        let train = side(24, "");
        let params = |train| StratifiedSamplingParams { train, order_seed: seed, ..Default::default() };
        let (a, _) = run(&train, None, params(total)).expect("enough");
        let (b, _) = run(&train, None, params(total + more)).expect("enough");
        let b = &b.collections["train"];
        proptest::prop_assert!(a.collections["train"].items.keys().all(|k| b.items.contains_key(k)));
    }
}

#[test]
fn own_strata_are_chosen_from_by_name() {
    let strata: Vec<StratumName> = ["kitchens", "L1-open"].map(|name| name.parse().expect("a name")).to_vec();
    let mut train = side(9, "");
    for index in 0..7 {
        let key = strata[0].item_key(index);
        let digest = Digest::of(key.as_str().as_bytes());
        train.items.insert(key, Stored::<SceneRecord>::blob(digest).into_artifact());
    }
    let params = StratifiedSamplingParams { train: 10, strata: strata.clone(), ..Default::default() };
    let (outputs, report) = run(&train, None, params.clone()).expect("enough");
    let chosen: Vec<String> =
        outputs.collections["train"].items.keys().map(|key| StratumName::group_of(key.as_str())).collect();
    for name in &strata {
        assert_eq!(chosen.iter().filter(|of| *of == name.as_str()).count(), 5);
        assert_eq!(report["train"]["strata"][name.as_str()]["wanted"], 5);
    }
    // Without their names, only generated ones are.
    let (outputs, _) = run(&train, None, StratifiedSamplingParams { train: 24, ..Default::default() }).expect("enough");
    assert!(outputs.collections["train"].items.keys().all(|key| Stratum::of_key(key.as_str()).is_some()));
    assert!(StratifiedSampling::check(&params).is_empty());
    let both = StratifiedSamplingParams { regimes: vec![Regime::L0], ..params.clone() };
    let twice = StratifiedSamplingParams { strata: [strata.clone(), strata].concat(), ..params };
    for wrong in [both, twice] {
        assert_eq!(StratifiedSampling::check(&wrong)[0].pointer, "/strata");
    }
}

#[test]
fn views_are_counted_by_content_in_generated_scenes_and_in_files() {
    let (blobs, cancel) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &cancel);
    let camera = Camera { origin: [0.0; 3], target: [0.0, 0.0, 1.0], up: [0.0, 1.0, 0.0], fov_x: 40.0, near: 0.0 };
    let stratum: StratumName = "kitchens".parse().expect("a name");
    // Contents by number, all of one signature; cameras of files by what they show.
    let numbered = |number| (Some(number), "box_room");
    let file = |name| (None, name);
    let pool = [
        numbered(0),
        numbered(0),
        numbered(0),
        numbered(1),
        numbered(1),
        file("file/a.glb"),
        file("file/a.glb"),
        file("file/b.glb"),
        file("file/a.glb"),
        numbered(2),
    ];
    let mut side = Collection::default();
    for (index, (content, layout)) in pool.into_iter().enumerate() {
        let recipe = Recipe {
            stratum: stratum.to_string(),
            index: index as u64,
            layout: layout.to_owned(),
            layout_params: BTreeMap::new(),
            objects: vec![format!("file/{layout}")],
            environment: "none".to_owned(),
            content,
            view: 0,
            side: None,
            exposure_ev: 0.0,
        };
        let scene = Scene {
            version: 1,
            seed: 0,
            camera: camera.clone(),
            max_depth: 1,
            shapes: Vec::new(),
            materials: Vec::new(),
            emitters: Vec::new(),
            hide_emitters: false,
        };
        let stored = SceneRecord { scene, recipe }.store(&ctx).expect("in memory");
        side.items.insert(stratum.item_key(index as u64), stored.into_artifact());
    }
    for (views, expected) in [(Some(1), &[0, 3, 5, 7, 9][..]), (Some(2), &[0, 1, 3, 4, 5, 6, 7, 9]), (None, &[0; 0])] {
        let expected: Vec<u64> = if views.is_none() { (0..10).collect() } else { expected.to_vec() };
        let params = StratifiedSamplingParams {
            test: expected.len() as u64,
            test_views: views,
            strata: vec![stratum.clone()],
            ..Default::default()
        };
        let all = BTreeMap::from([(TEST_SIDE.name(), &side)]);
        let action = Action { params, item: None, group: "main", seed: 0, each: BTreeMap::new(), all };
        let outputs = StratifiedSampling::run(&ctx, &action).expect("enough");
        let index = |key: &ItemKey| StratumName::of_key(key.as_str()).expect("a scene").1;
        let chosen: Vec<u64> = outputs.collections["test"].items.keys().map(index).collect();
        assert_eq!(chosen, expected, "{views:?}");
    }
}
