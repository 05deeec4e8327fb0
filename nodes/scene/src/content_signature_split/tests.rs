//! Tests of `content_signature_split`, with planted leaks and near-duplicates.

use super::*;
use crate::signature::tests::recipe;
use std::sync::atomic::AtomicBool;
use tauflow_contract::{Collection, MemoryBlobs, Silent};
use tauflow_data::Stratum;
use tauflow_data::scene::{Camera, Scene};

fn scenes(ctx: &Context<'_>, recipes: &[(String, Recipe)]) -> Collection {
    let [origin, target, up] = [[0.0; 3], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]];
    let camera = Camera { origin, target, up, fov_x: 40.0, near: 0.01 };
    let (shapes, materials, emitters) = (Vec::new(), Vec::new(), Vec::new());
    let scene = Scene { version: 1, seed: 0, camera, max_depth: 1, shapes, materials, emitters, hide_emitters: false };
    recipes
        .iter()
        .map(|(key, recipe)| {
            let record = SceneRecord { scene: scene.clone(), recipe: recipe.clone() };
            let stored = record.store(ctx).expect("in memory");
            (ItemKey::new(key.clone()).expect("plain"), stored.into_artifact())
        })
        .collect()
}

fn run(
    recipes: &[(String, Recipe)],
    params: ContentSignatureSplitParams,
) -> Result<(Outputs, serde_json::Value), KindError> {
    let (blobs, cancel) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &cancel);
    let input = scenes(&ctx, recipes);
    let action = Action {
        params,
        item: None,
        group: "main",
        seed: 0,
        each: BTreeMap::new(),
        all: BTreeMap::from([(SCENES.name(), &input)]),
    };
    let outputs = ContentSignatureSplit::run(&ctx, &action)?;
    let report = ctx.json(outputs.collections[REPORT.name()].get("report").expect("one item"), "")?;
    Ok((outputs, report))
}

fn pool(per_stratum: u64) -> Vec<(String, Recipe)> {
    Stratum::all()
        .flat_map(|s| (0..per_stratum).map(move |i| (s, i)))
        .enumerate()
        .map(|(n, (s, i))| {
            let mut recipe = recipe(&s.to_string(), i, 2.0);
            // A parameter of its own makes every signature its own.
            recipe.objects.push(format!("object-{n}"));
            (s.item_key(i).to_string(), recipe)
        })
        .collect()
}

fn keys(outputs: &Outputs, port: &str) -> Vec<String> {
    outputs.collections[port].iter().map(|(k, _)| k.to_string()).collect()
}

#[test]
fn shares_hold_in_every_stratum_and_growth_moves_nothing() {
    let params = ContentSignatureSplitParams { test_share: 0.34, ..Default::default() };
    let (small, report) = run(&pool(10), params.clone()).expect("splits");
    assert_eq!(report["groups"].as_array().map(Vec::len), Some(120));
    for (stratum, counts) in report["strata"].as_object().expect("a map") {
        assert_eq!((counts["train"].as_u64(), counts["test"].as_u64()), (Some(7), Some(3)), "{stratum}");
    }
    // A larger pool has other numbers in its recipes' objects, so append by hand.
    let mut more = pool(10);
    for s in Stratum::all() {
        let mut extra = recipe(&s.to_string(), 10, 2.0);
        extra.objects.push(format!("extra-{s}"));
        more.push((s.item_key(10).to_string(), extra));
    }
    let (large, _) = run(&more, params).expect("splits");
    for port in ["train", "test"] {
        let large = keys(&large, port);
        assert!(keys(&small, port).iter().all(|k| large.contains(k)), "{port}");
    }
}

#[test]
fn near_duplicates_stay_together_and_are_named() {
    let mut all = pool(6);
    // Copies that differ in camera (not in the recipe at all) and exposure only.
    for copy in 0..3u64 {
        let mut recipe = all[4].1.clone();
        recipe.index = 6 + copy;
        recipe.exposure_ev = -0.7 + 0.5 * copy as f64;
        all.push((format!("L0-environment-{:06}", 6 + copy), recipe));
    }
    let (outputs, report) =
        run(&all, ContentSignatureSplitParams { test_share: 0.5, ..Default::default() }).expect("splits");
    let groups = report["groups"].as_array().expect("a list");
    let duplicates: Vec<_> = groups.iter().filter(|g| g["items"].as_array().is_some_and(|i| i.len() > 1)).collect();
    assert_eq!(duplicates.len(), 1);
    assert_eq!(duplicates[0]["items"].as_array().map(Vec::len), Some(4));
    assert_eq!(report["leaks"].as_array().map(Vec::len), Some(0));
    let (train, test) = (keys(&outputs, "train"), keys(&outputs, "test"));
    let on_train = |n: u64| train.contains(&format!("L0-environment-{n:06}"));
    assert!((6..9).all(|n| on_train(n) == on_train(4)));
    assert_eq!(train.len() + test.len(), 72 + 3);
}

#[test]
fn planted_leaks_are_found() {
    let all = pool(4);
    let (mut train, test): (Vec<_>, Vec<_>) = all.into_iter().enumerate().partition(|(n, _)| n % 3 != 0);
    let side = |side: &[(usize, (String, Recipe))]| side.iter().map(|(_, e)| e.clone()).collect::<Vec<_>>();
    let count = |train: &[(String, Recipe)], test: &[(String, Recipe)]| {
        check_leaks(train.iter().map(|(k, r)| (k.as_str(), r)), test.iter().map(|(k, r)| (k.as_str(), r)), QUANTUM)
            .len()
    };
    assert_eq!(count(&side(&train), &side(&test)), 0);
    // The same scene on both sides, and a near-duplicate under another exposure and index.
    train.push(test[0].clone());
    let mut near = test[3].1.1.clone();
    near.exposure_ev += 1.0;
    near.index = 999;
    near.layout_params.iter_mut().for_each(|(_, v)| *v *= 1.0001);
    train.push((0, ("near".into(), near)));
    let leaks = check_leaks(
        side(&train).iter().map(|(k, r)| (k.as_str(), r)),
        side(&test).iter().map(|(k, r)| (k.as_str(), r)),
        QUANTUM,
    );
    assert_eq!(leaks.len(), 2);
    assert!(leaks.iter().any(|l| l.train == ["near"] && l.test == [test[3].1.0.clone()]));
}

#[test]
fn sides_of_recipes_are_respected_and_hold_out_is_verified() {
    let hold_out = vec![HoldOut::Objects];
    let params = ContentSignatureSplitParams { hold_out, ..Default::default() };
    let missing = run(&pool(2), params.clone()).expect_err("no sides");
    assert!(missing.to_string().contains("scene_generation"), "{missing}");
    let mut all = pool(2);
    for (n, (_, recipe)) in all.iter_mut().enumerate() {
        let side = if n % 2 == 0 { Side::Train } else { Side::Test };
        recipe.side = Some(side);
        recipe.objects = vec![format!("{side:?}-{n}")];
    }
    let (outputs, _) = run(&all, params.clone()).expect("splits");
    assert_eq!(keys(&outputs, "train").len(), 12);
    all[1].1.objects.push("Train-0".into());
    let shared = run(&all, params).expect_err("an object on both sides");
    assert!(shared.to_string().contains("Train-0"), "{shared}");
    // The same content drawn for both sides: the later scene is left out.
    all[1].1 = Recipe { side: Some(Side::Test), index: 1, ..all[0].1.clone() };
    let (_, report) = run(&all, ContentSignatureSplitParams::default()).expect("splits");
    assert_eq!(report["dropped"].as_array().map(Vec::len), Some(1));
}

proptest::proptest! {
    #[test]
    fn every_prefix_has_its_share(share in 0.0f64..=1.0, n in 1u64..400) {
        let tests = (0..n).filter(|i| is_test(*i, share)).count() as f64;
        proptest::prop_assert!((tests - n as f64 * share).abs() <= 0.5 + 1e-9);
    }
}
