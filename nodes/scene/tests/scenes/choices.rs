//! Pool, split and sampling together, at the size of the quickstart.

use crate::support::{act, kind, load, source};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{Collection, KindError, MemoryBlobs, Outputs};
use tauflow_data::{Stratum, records::SceneRecord, scene::Recipe};
use tauflow_scene::check_leaks;

/// Runs a gather.
fn gather(
    blobs: &MemoryBlobs,
    name: &str,
    params: serde_json::Value,
    inputs: BTreeMap<&str, &Collection>,
) -> Result<Outputs, KindError> {
    let kind = kind(name);
    let params = kind.resolve(&params).expect("fine params");
    act(blobs, kind.as_ref(), &params, None, inputs)
}

/// Scenes of a pool, less a few of each stratum, as a gate might reject them.
fn accepted(blobs: &MemoryBlobs, pool: u64) -> Collection {
    let scenes = source(blobs, "scene_generation", json!({ "pool": pool }), &BTreeMap::new()).remove("scenes");
    let lost = |key: &str| {
        let (stratum, index) = Stratum::of_key(key).expect("a scene's key");
        let ordinal = Stratum::all().position(|s| s == stratum).expect("one of twelve") as u64;
        (0..2).any(|k| index == (ordinal * 5 + k) % 10)
    };
    let kept = scenes.expect("the port").items.into_iter().filter(|(key, _)| !lost(key.as_str()));
    kept.collect()
}

fn keys(collection: &Collection) -> BTreeSet<String> {
    collection.iter().map(|(key, _)| key.to_string()).collect()
}

fn per_stratum(keys: &BTreeSet<String>) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for key in keys {
        *counts.entry(Stratum::of_key(key).expect("a scene's key").0.to_string()).or_default() += 1;
    }
    counts
}

#[test]
fn a_pool_of_240_gives_four_to_learn_from_and_two_to_judge_by_in_each_stratum() {
    let blobs = MemoryBlobs::default();
    let choose = |pool: u64, train: u64, test: u64| {
        let scenes = accepted(&blobs, pool);
        let inputs = BTreeMap::from([("scenes", &scenes)]);
        let split = gather(&blobs, "content_signature_split", json!({ "test_share": 0.34 }), inputs).expect("a split");
        let sides = &split.collections;
        let inputs = BTreeMap::from([("train", &sides["train"]), ("test", &sides["test"])]);
        let params = json!({ "train": train, "test": test });
        let chosen = gather(&blobs, "stratified_sampling", params, inputs).expect("enough of each stratum");
        (split.collections.clone(), chosen.collections)
    };
    let (split, chosen) = choose(240, 48, 24);
    let recipes = |side: &str| -> Vec<(String, Recipe)> {
        split[side].iter().map(|(key, scene)| (key.to_string(), load::<SceneRecord>(&blobs, scene).recipe)).collect()
    };
    let (train, test) = (recipes("train"), recipes("test"));
    let named = |side: &[(String, Recipe)]| side.to_vec();
    let (a, b) = (named(&train), named(&test));
    let leaks = check_leaks(a.iter().map(|(k, r)| (k.as_str(), r)), b.iter().map(|(k, r)| (k.as_str(), r)), 0.05);
    assert!(leaks.is_empty(), "{leaks:?}");
    let (train, test) = (keys(&chosen["train"]), keys(&chosen["test"]));
    assert!(per_stratum(&train).values().all(|n| *n == 4) && per_stratum(&test).values().all(|n| *n == 2));
    assert_eq!((train.len(), test.len()), (48, 24));
    assert!(train.is_disjoint(&test));

    // A larger pool and larger quotas: every earlier side and choice stays.
    let (grown, more) = choose(360, 60, 36);
    for side in ["train", "test"] {
        assert!(keys(&split[side]).is_subset(&keys(&grown[side])), "{side} of the split");
        assert!(keys(&chosen[side]).is_subset(&keys(&more[side])), "{side} of the choice");
    }
}

#[test]
fn a_leak_and_near_duplicates_are_found() {
    let blobs = MemoryBlobs::default();
    let scenes = accepted(&blobs, 60);
    let mut recipes: Vec<(String, Recipe)> =
        scenes.iter().map(|(key, scene)| (key.to_string(), load::<SceneRecord>(&blobs, scene).recipe)).collect();
    let half = recipes.len() / 2;
    let find = |recipes: &[(String, Recipe)]| {
        let (train, test) = recipes.split_at(half);
        check_leaks(train.iter().map(|(k, r)| (k.as_str(), r)), test.iter().map(|(k, r)| (k.as_str(), r)), 0.05)
    };
    assert!(find(&recipes).is_empty());
    // The same content under another exposure and index (its camera and seed are no part of a recipe at all). All its
    // views are named.
    let content = |(key, recipe): &(String, Recipe)| (Stratum::of_key(key).expect("a scene's key").0, recipe.content());
    let views = recipes[..half].iter().filter(|r| content(r) == content(&recipes[3])).map(|(key, _)| key.clone());
    let views: Vec<String> = views.collect();
    let mut copy = recipes[3].1.clone();
    copy.exposure_ev += 0.7;
    copy.index += 1000;
    recipes[half + 2].1 = copy;
    let leaks = find(&recipes);
    assert_eq!(leaks.len(), 1, "{leaks:?}");
    assert_eq!((&leaks[0].train, &leaks[0].test), (&views, &vec![recipes[half + 2].0.clone()]));
}
