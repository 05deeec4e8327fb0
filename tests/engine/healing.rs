//! A missing blob is a miss, never an error: what made it runs again.

use crate::support::Workshop;
use std::{collections::BTreeMap, fs, path::Path};
use tauflow::engine::{RunOptions, event::Event};

/// Blobs of 70 kB have files of their own.
const PADDED: &str = "
pipeline: padded
nodes:
  numbers: {kind: numbers, params: {count: 3}}
  long: {kind: affine, inputs: {in: numbers}, params: {mul: 2, pad: 70000}}
  longer: {kind: affine, inputs: {in: long}, params: {mul: 3, pad: 80000}}
  rounded: {kind: round, inputs: {in: longer}}
  total: {kind: total, inputs: {in: rounded}}
";

/// Removes the files in `folder`, at any depth, whose length fits; says how many there were.
fn remove(folder: &Path, fits: impl Fn(u64) -> bool + Copy) -> usize {
    let mut count = 0;
    for entry in fs::read_dir(folder).expect("readable") {
        let entry = entry.expect("readable");
        let meta = entry.metadata().expect("readable");
        if meta.is_dir() {
            count += remove(&entry.path(), fits);
        } else if fits(meta.len()) {
            fs::remove_file(entry.path()).expect("writable");
            count += 1;
        }
    }
    count
}

#[test]
fn what_made_a_missing_blob_runs_again() {
    let shop = Workshop::new();
    shop.run(PADDED);
    let before = shop.numbers(PADDED, "total");
    assert_eq!(remove(&shop.cache(), |len| len > 70_000), 6);
    // Nobody reads them: nothing to do.
    assert_eq!(shop.run(PADDED).ran(), BTreeMap::new());
    // Rounding anew reads the longer ones, which read the long ones, which read small ones.
    let edited = PADDED.replace("{in: longer}}", "{in: longer}, params: {to: 100}}");
    let healed = shop.run(&edited);
    assert!(healed.summary.failures.is_empty(), "{:#?}", healed.summary.failures);
    assert_eq!(healed.ran(), BTreeMap::from([("long", 3), ("longer", 3), ("rounded", 3), ("total", 2)]));
    assert_eq!(healed.events.iter().filter(|e| matches!(e, Event::Healing { .. })).count(), 2);
    assert_eq!(shop.run(&edited).ran(), BTreeMap::new());
    assert_eq!(shop.run(PADDED).ran(), BTreeMap::new());
    assert_eq!(shop.numbers(PADDED, "total"), before);
}

#[test]
fn what_is_asked_for_must_be_there() {
    let shop = Workshop::new();
    let text = format!("{PADDED}targets: [longer]\n");
    shop.run(&text);
    assert_eq!(remove(&shop.cache(), |len| len > 80_000), 3);
    let healed = shop.run(&text);
    assert_eq!(healed.ran(), BTreeMap::from([("longer", 3)]));
    assert_eq!(shop.numbers(&text, "longer")["n0002"], 120);
    assert_eq!(shop.run(&text).ran(), BTreeMap::new());
}

#[test]
fn one_missing_blob_runs_one_action() {
    let shop = Workshop::new();
    shop.run(PADDED);
    let blob = shop.outputs(PADDED, "long", 0).expect("it has run").get("n0001").and_then(|a| a.part(""));
    let name = blob.expect("one blob").hex();
    let found = remove_named(&shop.cache(), &name[2..]);
    assert_eq!(found, 1);
    let edited = PADDED.replace("mul: 3", "mul: 3, add: 10");
    let healed = shop.run(&edited);
    assert_eq!(healed.ran(), BTreeMap::from([("long", 1), ("longer", 3), ("rounded", 3), ("total", 2)]));
}

fn remove_named(folder: &Path, ending: &str) -> usize {
    let mut count = 0;
    for entry in fs::read_dir(folder).expect("readable") {
        let path = entry.expect("readable").path();
        if path.is_dir() {
            count += remove_named(&path, ending);
        } else if path.to_string_lossy().contains(ending) {
            fs::remove_file(&path).expect("writable");
            count += 1;
        }
    }
    count
}

#[test]
fn a_lost_cache_is_an_empty_one() {
    let shop = Workshop::new();
    let first = shop.run(PADDED);
    let before = shop.outputs(PADDED, "total", 0).expect("it has run").digest();
    fs::remove_dir_all(shop.cache()).expect("writable");
    assert_eq!(shop.run(PADDED).ran(), first.ran());
    assert_eq!(shop.outputs(PADDED, "total", 0).expect("it has run").digest(), before);
}

#[test]
fn lost_blobs_of_what_cannot_be_reproduced_are_replaced() {
    let text = "
nodes:
  numbers: {kind: numbers, params: {count: 2}}
  unsteady: {kind: unsteady, inputs: {in: numbers}}
  padded: {kind: affine, inputs: {in: unsteady}, params: {pad: 70000}}
";
    let shop = Workshop::new();
    shop.run(text);
    assert_eq!(remove(&shop.cache().join("packs"), |_| true), 1, "small blobs share a pack");
    assert_eq!(remove(&shop.cache(), |len| len > 70_000), 2);
    let healed = shop.run_with(text, &RunOptions::default(), |_, _| {});
    assert!(healed.summary.failures.is_empty(), "{:#?}", healed.summary.failures);
    assert_eq!(healed.ran(), BTreeMap::from([("unsteady", 2), ("padded", 2)]));
    assert_eq!(shop.run(text).ran(), BTreeMap::new());
}
