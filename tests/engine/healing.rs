//! A missing blob is a miss, never an error: what made it runs again.

use crate::support::Workshop;
use std::sync::atomic::AtomicBool;
use std::{collections::BTreeMap, fs, path::Path};
use tauflow::{
    engine::{self, EngineError, RunOptions, event::Event},
    ids::PortId,
};

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
    // What counts up from nought meets none of the numbers, whose blobs would stand for its own.
    let text = "
nodes:
  numbers: {kind: numbers, params: {count: 2, offset: 1000001}}
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

/// A gather of 200 items that only memory held.
const MANY: &str = "
pipeline: many
nodes:
  numbers: {kind: numbers, params: {count: 200}}
  long: {kind: affine, inputs: {in: numbers}, params: {mul: 2, pad: 300}, transient: true}
  total: {kind: total, inputs: {in: long}}
";

fn healings(ran: &crate::support::Ran) -> usize {
    ran.events.iter().filter(|event| matches!(event, Event::Healing { .. })).count()
}

#[test]
fn a_gather_asks_for_all_that_is_missing_at_once() {
    let shop = Workshop::new();
    shop.run(MANY);
    let before = shop.numbers(MANY, "total");
    // Another gather: of its 200 inputs none was stored.
    let edited = MANY.replace("{in: long}}", "{in: long}, params: {title: other}}");
    let ran = shop.run(&edited);
    assert!(ran.summary.failures.is_empty(), "{:#?}", ran.summary.failures);
    assert_eq!((ran.ran()["long"], healings(&ran)), (200, 1));
    // All that was stored is gone, too; what is known of it is not. A stage for each pass.
    remove(&shop.cache().join("packs"), |_| true);
    let ran = shop.run(MANY);
    assert!(ran.summary.failures.is_empty(), "{:#?}", ran.summary.failures);
    assert_eq!((ran.ran()["numbers"], ran.ran()["long"]), (200, 200));
    assert!(healings(&ran) <= 3, "{}", healings(&ran));
    assert_eq!(shop.numbers(MANY, "total"), before);
    assert_eq!(shop.run(MANY).ran(), BTreeMap::new());
}

#[test]
fn a_chain_of_more_stages_than_any_number_of_passes_comes_back() {
    let mut text = "nodes:\n  n0: {kind: numbers, params: {count: 1}}\n".to_owned();
    for n in 1..=80 {
        let before = n - 1;
        text +=
            &format!("  n{n}: {{kind: affine, inputs: {{in: n{before}}}, params: {{add: 1000}}, transient: true}}\n");
    }
    let shop = Workshop::new();
    // What `end` keeps is none of the numbers of the chain, whose blobs it would stand for.
    shop.run(&format!("{text}  end: {{kind: round, inputs: {{in: n80}}, params: {{to: 9}}}}\n"));
    let ran = shop.run(&format!("{text}  end: {{kind: round, inputs: {{in: n80}}, params: {{to: 7}}}}\n"));
    assert!(ran.summary.failures.is_empty(), "{:#?}", ran.summary.failures);
    assert_eq!((ran.ran()["n1"], ran.ran()["end"]), (1, 1));
    assert!(healings(&ran) > 64, "{}", healings(&ran));
}

/// Changes the last byte of a blob where it lies in a pack or in a file of its own.
fn spoil(cache: &Path, needle: &[u8]) -> usize {
    let mut count = 0;
    for entry in fs::read_dir(cache).expect("readable") {
        let path = entry.expect("readable").path();
        if path.is_dir() {
            count += spoil(&path, needle);
            continue;
        }
        let mut bytes = fs::read(&path).expect("readable");
        while let Some(at) = bytes.windows(needle.len()).position(|window| window == needle) {
            bytes[at] ^= 1;
            count += 1;
        }
        fs::write(&path, bytes).expect("writable");
    }
    count
}

#[test]
fn a_damaged_page_is_not_nothing_to_do() {
    let shop = Workshop::new();
    let text = PADDED.replace("inputs: {in: rounded}}", "inputs: {in: rounded}, params: {title: The page}}");
    let options = RunOptions { jobs: 2, out: Some(shop.out()), ..RunOptions::default() };
    shop.run_with(&text, &options, |_, _| {});
    let page = fs::read_dir(shop.out().join("padded")).expect("written").count();
    assert!(page > 0);
    assert_eq!(spoil(&shop.cache().join("packs"), b"The page: "), 1);
    let ran = shop.run_with(&text, &options, |_, _| {});
    assert!(ran.summary.failures.is_empty(), "{:#?}", ran.summary.failures);
    assert_eq!(ran.ran(), BTreeMap::from([("total", 1)]));
    assert_eq!(shop.run_with(&text, &options, |_, _| {}).ran(), BTreeMap::new());
}

#[test]
fn what_is_asked_for_and_lost_is_restored() {
    let shop = Workshop::new();
    shop.run(PADDED);
    let pipeline = crate::support::resolve(PADDED);
    let node = pipeline.node("longer").expect("it is there");
    let before = shop.numbers(PADDED, "longer");
    // Listings and all: that is told apart from what never ran.
    remove(&shop.cache().join("packs"), |_| true);
    remove(&shop.cache(), |len| len > 80_000);
    let lost = shop.outputs(PADDED, "longer", 0).expect_err("lost");
    assert!(matches!(lost, EngineError::Lost(_)), "{lost}");
    let never = shop.outputs(&PADDED.replace("mul: 3", "mul: 4"), "longer", 0).expect_err("never run");
    assert!(matches!(never, EngineError::Request(_)), "{never}");
    let restore = |shop: &Workshop| {
        let stop = AtomicBool::new(false);
        engine::restore(&pipeline, &shop.store(), (node, PortId::DEFAULT), &stop, &|_| {}).expect("the store works")
    };
    assert!(restore(&shop).failures.is_empty());
    assert_eq!(shop.numbers(PADDED, "longer"), before);
    // Damage that keeps the length is found by reading.
    assert_eq!(spoil(&shop.cache().join("blobs"), b"120 "), 1);
    let again = restore(&shop);
    assert!(again.failures.is_empty());
    assert_eq!(again.total(|node| node.ran), 1);
    assert_eq!(shop.numbers(PADDED, "longer"), before);
}

/// What passes a gate is what the gate was given: a blob that only memory held.
const PASSED_ON: &str = "
pipeline: passed
nodes:
  numbers: {kind: numbers, params: {count: 20}}
  long: {kind: affine, inputs: {in: numbers}, params: {mul: 2, pad: 300}, transient: true}
  gate: {kind: below, inputs: {in: long}, params: {limit: 100}}
  total: {kind: total, inputs: {in: gate}}
";

#[test]
fn what_only_memory_held_is_not_lost_and_what_was_stored_is() {
    for text in [MANY, PASSED_ON] {
        let shop = Workshop::new();
        shop.run(text);
        let verify = || {
            let report = shop.store().verify(None, 0, &mut |_, _| ()).expect("readable");
            (report.incomplete_records > 0, report.lost_records > 0, report.is_damaged())
        };
        assert_eq!(verify(), (true, false, false));
        assert_eq!(shop.run(text).ran(), BTreeMap::new());
        assert_eq!(verify(), (true, false, false));
        remove(&shop.cache().join("packs"), |_| true);
        assert_eq!(verify(), (true, true, true));
        assert!(shop.run(text).summary.failures.is_empty());
        // What was not needed, and so was not made again, is known all the same, and a collection leaves it so: of what
        // did not pass the gate, nobody reads the numbers.
        let some = text == PASSED_ON;
        assert_eq!(verify(), (true, some, some));
        let all = tauflow_cache::GcOptions { keep_within_secs: Some(1 << 40), now: 1 << 40, ..Default::default() };
        shop.store().gc(&all).expect("room");
        assert_eq!(shop.run(text).ran(), BTreeMap::new());
        assert_eq!(verify(), (true, some, some));
        // One that clears it away has the next run make it, to know it.
        shop.store().gc(&tauflow_cache::GcOptions { lost: true, ..all }).expect("room");
        assert_eq!(verify(), (true, false, false));
        assert!(shop.run(text).summary.failures.is_empty());
        assert_eq!(shop.run(text).ran(), BTreeMap::new());
        assert_eq!(verify(), (true, false, false));
    }
}
