//! Many items: shards looked up as wholes give what items looked up one by one give, and cost what the change costs.

use crate::support::Workshop;
use std::{collections::BTreeMap, fs};
use tauflow::engine::{RunOptions, event::Event};

const COUNT: u64 = 3000;

/// A filter, two inputs that meet, a gather, a map that reads it as a whole, and a map over what a gather made.
const MANY: &str = "
pipeline: many
seed: 3
nodes:
  numbers: {kind: numbers, params: {count: COUNT, offset: OFFSET, raised: RAISED}}
  drawn: {kind: drawn, inputs: {in: numbers}}
  scaled: {kind: affine, inputs: {in: numbers}, params: {mul: 2, add: ADD}}
  gate: {kind: below, inputs: {in: scaled}, params: {limit: LIMIT}}
  pairs: {kind: pair, inputs: {left: gate, right: drawn}}
  total: {kind: total, inputs: {in: rounded}}
  rounded: {kind: round, inputs: {in: gate.others}}
  shares: {kind: shares, inputs: {in: pairs, of: total}}
  both: {kind: total, inputs: {in: [shares, rounded]}}
";

fn text(offset: i64, raised: &[u64], add: i64, limit: i64) -> String {
    let raised = format!("{raised:?}");
    let values = [
        ("COUNT", COUNT.to_string()),
        ("OFFSET", offset.to_string()),
        ("RAISED", raised),
        ("ADD", add.to_string()),
        ("LIMIT", limit.to_string()),
    ];
    values.iter().fold(MANY.to_owned(), |text, (name, value)| text.replace(name, value))
}

#[test]
fn one_changed_item_runs_its_own_actions_and_looks_at_one_shard() {
    let shop = Workshop::new();
    let first = shop.run(&text(0, &[], 0, 30_000));
    assert_eq!(first.ran()["scaled"], COUNT);
    let edited = text(0, &[7], 0, 30_000);
    let again = shop.run(&edited);
    let ran = again.ran();
    assert_eq!((ran["numbers"], ran["scaled"], ran["pairs"]), (1, 1, 1));
    assert_eq!(again.count(|n| n.hit)["scaled"], COUNT - 1);
    // Few of the 256 shards are opened: the others' items are never looked at.
    let looked_at = again.events.iter().filter(|e| matches!(e, Event::End { node, .. } if **node == *"scaled"));
    assert!(looked_at.count() < 60, "a shard has about 12 of {COUNT} items");
    // The drawn number of the item depends on its input only through the key, so its readers stop there or go on alike.
    let fresh = Workshop::new();
    fresh.run(&edited);
    for node in ["pairs", "rounded", "shares", "both"] {
        assert_eq!(shop.numbers(&edited, node), fresh.numbers(&edited, node), "{node}");
    }
    assert!(shop.run(&edited).ran().is_empty());
    let one_by_one = shop.run_with(&edited, &RunOptions { no_rollup: true, ..RunOptions::default() }, |_, _| {});
    assert!(one_by_one.ran().is_empty());
    assert_eq!(one_by_one.count(|n| n.hit), shop.run(&edited).count(|n| n.hit));
}

#[test]
fn any_row_of_edits_ends_where_a_fresh_run_does() {
    let shop = Workshop::new();
    // Edits of few items, of all, of a filter's limit, and back again.
    let edits = [
        text(0, &[], 0, 30_000),
        text(0, &[1, 500, 2999], 0, 30_000),
        text(0, &[1], 5, 30_000),
        text(0, &[1], 5, 31_000),
        text(3, &[], 5, 31_000),
        text(0, &[500], 0, 30_000),
        text(0, &[500], 0, 100_000),
        text(0, &[], 0, 0),
    ];
    for edited in &edits {
        let ran = shop.run(edited);
        assert!(ran.summary.failures.is_empty(), "{:#?}", ran.summary.failures);
        let fresh = Workshop::new();
        let alone =
            fresh.run_with(edited, &RunOptions { no_rollup: true, jobs: 2, ..RunOptions::default() }, |_, _| {});
        for (node, port) in [("drawn", 0), ("gate", 1), ("pairs", 0), ("shares", 0), ("both", 0), ("both", 1)] {
            let digest = |shop: &Workshop| shop.outputs(edited, node, port).expect("it has run").digest();
            assert_eq!(digest(&shop), digest(&fresh), "{node} of {edited}");
        }
        // Every action is accounted for, whoever stood for it.
        assert_eq!(ran.count(|n| n.hit + n.ran), alone.count(|n| n.hit + n.ran));
    }
}

#[test]
fn an_item_that_fails_in_a_big_node_blocks_only_its_own_readers() {
    let shop = Workshop::new();
    let good = text(0, &[], 0, 30_000);
    shop.run(&good);
    let bad = good.replace("mul: 2, add: 0", "mul: 2, add: 0, fail_from: 29990");
    let ran = shop.run(&bad);
    assert_eq!(ran.count(|n| n.failed), BTreeMap::from([("scaled", 1)]));
    assert_eq!(ran.count(|n| n.blocked)["gate"], 1);
    assert_eq!(ran.count(|n| n.hit + n.ran)["gate"], COUNT - 1);
    assert!(shop.run(&good).ran().is_empty());
}

#[test]
fn cells_of_a_big_node_meet_in_a_gather() {
    let shop = Workshop::new();
    let text = "
nodes:
  numbers: {kind: numbers, params: {count: 2500, raised: []}}
  scaled: {kind: affine, matrix: {mul: [2, 3]}, inputs: {in: numbers}}
  rounded: {kind: round, inputs: {in: scaled}}
  total: {kind: total, inputs: {in: rounded}}
";
    shop.run(text);
    let edited = text.replace("[]", "[9]");
    let ran = shop.run(&edited);
    assert_eq!(ran.ran()["scaled"], 2);
    let fresh = Workshop::new();
    fresh.run(&edited);
    assert_eq!(shop.numbers(&edited, "total"), fresh.numbers(&edited, "total"));
}

#[test]
fn damage_anywhere_in_a_big_cache_ends_where_a_fresh_run_does() {
    let shop = Workshop::new();
    let before = text(0, &[], 0, 30_000);
    shop.run(&before);
    let edited = text(0, &[7, 8], 0, 30_000);
    let expected = {
        let fresh = Workshop::new();
        fresh.run(&edited);
        fresh.numbers(&edited, "both")
    };
    let packs = shop.cache().join("packs");
    let pack = fs::read_dir(&packs).expect("readable").map(|e| e.expect("readable").path());
    let pack = pack.max_by_key(|p| fs::metadata(p).map_or(0, |m| m.len())).expect("a pack");
    let whole = fs::read(&pack).expect("readable");
    // Listings, numbers and pages lie next to each other: a byte here and there hits some of each.
    for (round, step) in [(0, 40_009), (1, 15_013), (2, 7_001)] {
        let mut bytes = whole.clone();
        (round..bytes.len()).step_by(step).for_each(|at| bytes[at] ^= 0x20);
        fs::write(&pack, &bytes).expect("writable");
        let ran = shop.run(&edited);
        assert!(ran.summary.failures.is_empty(), "{:#?}", ran.summary.failures);
        let again = shop.run_with(&edited, &RunOptions { no_rollup: true, ..RunOptions::default() }, |_, _| {});
        assert!(again.summary.failures.is_empty(), "{:#?}", again.summary.failures);
        assert_eq!(shop.numbers(&edited, "both"), expected);
    }
}

#[test]
fn a_source_whose_listing_is_gone_gives_each_item_once() {
    let shop = Workshop::new();
    let before = text(0, &[], 0, 30_000);
    shop.run(&before);
    let expected = {
        let fresh = Workshop::new();
        let edited = text(0, &[], 5, 30_000);
        fresh.run(&edited);
        fresh.numbers(&edited, "both")
    };
    // Of the listings that the packs hold, flip a byte in each that lists shards: those of whole nodes, and no item's.
    let packs = shop.cache().join("packs");
    for entry in fs::read_dir(&packs).expect("readable") {
        let path = entry.expect("readable").path();
        let mut bytes = fs::read(&path).expect("readable");
        let shards = b"{\"Shards\":";
        let places: Vec<usize> =
            (0..bytes.len().saturating_sub(shards.len())).filter(|at| bytes[*at..].starts_with(shards)).collect();
        places.into_iter().for_each(|at| bytes[at + 2] ^= 0x20);
        fs::write(&path, &bytes).expect("writable");
    }
    let edited = text(0, &[], 5, 30_000);
    let ran = shop.run(&edited);
    assert!(ran.summary.failures.is_empty(), "{:#?}", ran.summary.failures);
    assert!(!ran.ran().contains_key("numbers") && !ran.ran().contains_key("drawn"), "{:?}", ran.ran());
    assert_eq!(ran.count(|n| n.hit + n.ran)["drawn"], COUNT);
    assert_eq!(shop.numbers(&edited, "both"), expected);
}

#[test]
fn items_of_a_big_node_go_on_before_it_is_through() {
    let shop = Workshop::new();
    let text = "
nodes:
  numbers: {kind: numbers, params: {count: 3000}}
  scaled: {kind: affine, inputs: {in: numbers}, params: {mul: 2}}
  rounded: {kind: round, inputs: {in: scaled}}
";
    let ended = |ran: &[Event], of: &str| -> Vec<usize> {
        let is = |event: &Event| matches!(event, Event::End { node, .. } if **node == *of);
        ran.iter().enumerate().filter(|(_, event)| is(event)).map(|(at, _)| at).collect()
    };
    for edited in [text.to_owned(), text.replace("count: 3000", "count: 3000, offset: 7")] {
        let events = shop.run(&edited).events;
        let (first, last) = (ended(&events, "rounded")[0], *ended(&events, "numbers").last().expect("it ran"));
        assert!(first < last / 2, "the first item was through at {first}, the last began at {last}");
    }
}
