//! What an edit reruns: what it changes, and nothing else.

use crate::support::Workshop;
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
};
use tauflow::engine::{
    RunOptions,
    event::{Ended, Event},
};

const CHAIN: &str = "
pipeline: chain
nodes:
  numbers: {kind: numbers, params: {count: 4}}
  scaled: {kind: affine, inputs: {in: numbers}, params: {mul: 3}}
  rounded: {kind: round, inputs: {in: scaled}}
  total: {kind: total, inputs: {in: rounded}}
";

#[test]
fn the_first_run_does_everything_and_the_second_nothing() {
    let shop = Workshop::new();
    let first = shop.run(CHAIN);
    let expected = BTreeMap::from([("numbers", 4), ("scaled", 4), ("rounded", 4), ("total", 2)]);
    assert_eq!(first.ran(), expected);
    assert_eq!(shop.numbers(CHAIN, "total")["all"], 180);
    let second = shop.run(CHAIN);
    assert_eq!(second.ran(), BTreeMap::new());
    assert_eq!(second.count(|n| n.hit), expected);
    for event in &second.events {
        assert!(matches!(event, Event::Started { .. } | Event::Unchanged { .. } | Event::Finished { .. }), "{event:?}");
    }
    let unchanged = second.events.iter().filter(|e| matches!(e, Event::Unchanged { .. })).count();
    assert_eq!(unchanged, 5, "one for each lane: the total has two groups");
}

#[test]
fn without_roll_ups_every_item_is_looked_up_and_nothing_runs() {
    let shop = Workshop::new();
    let done = shop.run(CHAIN).ran().into_iter().map(|(node, n)| (node.to_owned(), n)).collect::<BTreeMap<_, _>>();
    let options = RunOptions { no_rollup: true, ..RunOptions::default() };
    let again = shop.run_with(CHAIN, &options, |_, _| {});
    assert_eq!(again.ran(), BTreeMap::new());
    assert_eq!(again.count(|n| n.hit).into_iter().map(|(k, n)| (k.to_owned(), n)).collect::<BTreeMap<_, _>>(), done);
    assert!(again.events.iter().all(|e| !matches!(e, Event::Unchanged { .. })), "each item by itself");
    assert_eq!(again.ended(Ended::Hit).len(), 14);
}

#[test]
fn one_item_more_is_one_action_more_at_each_map() {
    let shop = Workshop::new();
    shop.run(CHAIN);
    let more = shop.run(&CHAIN.replace("count: 4", "count: 5"));
    assert_eq!(more.ran(), BTreeMap::from([("numbers", 1), ("scaled", 1), ("rounded", 1), ("total", 2)]));
    assert_eq!(more.count(|n| n.hit), BTreeMap::from([("numbers", 4), ("scaled", 4), ("rounded", 4)]));
    // And back again: all of it is known.
    assert_eq!(shop.run(CHAIN).ran(), BTreeMap::new());
}

#[test]
fn an_unchanged_output_stops_the_change() {
    let shop = Workshop::new();
    shop.run(CHAIN);
    // 3 (10 i + 1) rounds to the same tens as 3 (10 i).
    let edited = shop.run(&CHAIN.replace("count: 4", "count: 4, offset: 1"));
    assert_eq!(edited.ran(), BTreeMap::from([("numbers", 4), ("scaled", 4), ("rounded", 4)]));
    assert_eq!(edited.count(|n| n.hit)["total"], 2);
}

#[test]
fn a_param_that_a_group_does_not_read_does_not_rerun_it() {
    let shop = Workshop::new();
    shop.run(CHAIN);
    let titled = shop.run(&CHAIN.replace("{in: rounded}}", "{in: rounded}, params: {title: Sum}}"));
    assert_eq!(titled.ran(), BTreeMap::from([("total", 1)]));
}

#[test]
fn names_and_order_of_nodes_are_no_part_of_a_key() {
    let shop = Workshop::new();
    shop.run(CHAIN);
    let renamed = "
nodes:
  last: {kind: total, inputs: {in: c}}
  c: {kind: round, inputs: {in: b}}
  b: {kind: affine, inputs: {in: a}, params: {mul: 3, add: 0}}
  a: {kind: numbers}
";
    assert_eq!(shop.run(renamed).ran(), BTreeMap::new());
}

#[test]
fn the_number_of_jobs_does_not_show_in_the_results() {
    let text = CHAIN.replace("count: 4", "count: 60");
    let digests: Vec<_> = [1, 2, 4]
        .map(|jobs| {
            let shop = Workshop::new();
            shop.run_with(&text, &RunOptions { jobs, ..RunOptions::default() }, |_, _| {});
            ["scaled", "rounded", "total"].map(|n| shop.outputs(&text, n, 0).expect("it has run").digest())
        })
        .into();
    assert_eq!(digests[0], digests[1]);
    assert_eq!(digests[0], digests[2]);
}

#[test]
fn a_seed_belongs_to_an_item_and_to_the_pipeline() {
    let text = "
seed: 1
nodes:
  numbers: {kind: numbers}
  drawn: {kind: drawn, inputs: {in: numbers}}
  again: {kind: drawn, inputs: {in: numbers}}
";
    let shop = Workshop::new();
    // The two nodes are one and the same work.
    assert_eq!(shop.run(text).ran().values().sum::<u64>(), 8);
    let first = shop.numbers(text, "drawn");
    assert_eq!(first, shop.numbers(text, "again"));
    assert_eq!(first.values().collect::<BTreeSet<_>>().len(), 4);
    let other = text.replace("seed: 1", "seed: 2");
    assert_eq!(shop.run(&other).ran().values().sum::<u64>(), 4);
    assert_ne!(first, shop.numbers(&other, "drawn"));
}

#[test]
fn files_outside_are_read_by_content() {
    let shop = Workshop::new();
    let folder = shop.path("files");
    fs::create_dir(&folder).expect("writable");
    let put = |name: &str, text: &str| fs::write(folder.join(name), text).expect("writable");
    put("a", "1");
    put("b", "2");
    let text = format!(
        "
nodes:
  files: {{kind: files, params: {{folder: {folder:?}}}}}
  scaled: {{kind: affine, inputs: {{in: files}}, params: {{mul: 2}}}}
  total: {{kind: total, inputs: {{in: scaled}}}}
"
    );
    assert_eq!(shop.run(&text).ran(), BTreeMap::from([("files", 2), ("scaled", 2), ("total", 2)]));
    let again = shop.run(&text);
    assert_eq!(again.ran(), BTreeMap::new());
    assert_eq!(again.count(|n| n.unchanged), BTreeMap::from([("files", 1), ("scaled", 1), ("total", 2)]));
    put("c", "3");
    put("a", "5");
    assert_eq!(shop.run(&text).ran(), BTreeMap::from([("files", 2), ("scaled", 2), ("total", 2)]));
    assert_eq!(shop.numbers(&text, "total")["all"], 20);
    fs::remove_file(folder.join("c")).expect("it is there");
    assert_eq!(shop.run(&text).ran(), BTreeMap::from([("total", 2)]));
    // A moved folder holds the same content.
    let moved = shop.path("moved");
    fs::rename(&folder, &moved).expect("writable");
    let text = text.replace(&format!("{folder:?}"), &format!("{moved:?}"));
    assert_eq!(shop.run(&text).ran(), BTreeMap::new());
}

#[test]
fn a_recheck_finds_what_is_not_reproducible() {
    let text = "
nodes:
  numbers: {kind: numbers, params: {count: 3}}
  scaled: {kind: affine, inputs: {in: numbers}}
  unsteady: {kind: unsteady, inputs: {in: scaled}}
targets: [unsteady, unsteady.time]
";
    let shop = Workshop::new();
    shop.run(text);
    let before = shop.numbers(text, "unsteady");
    assert_eq!(shop.run(text).ran(), BTreeMap::new());
    let recheck = RunOptions { jobs: 1, recheck: 1.0, ..RunOptions::default() };
    let checked = shop.run_with(text, &recheck, |_, _| {});
    assert_eq!(checked.summary.failures.len(), 3, "{:#?}", checked.summary.failures);
    for failure in &checked.summary.failures {
        assert_eq!(failure.node, "unsteady");
        assert!(failure.message.contains("not reproducible") && failure.message.contains("out"), "{}", failure.message);
    }
    // Measurements may differ; what was recorded stays.
    assert_eq!(checked.ran(), BTreeMap::from([("numbers", 3), ("scaled", 3), ("unsteady", 3)]));
    assert_eq!(shop.numbers(text, "unsteady"), before);
    let sampled = shop.run_with(text, &RunOptions { recheck: 0.0, ..recheck.clone() }, |_, _| {});
    assert!(sampled.summary.failures.is_empty());
    // What is memoised cannot vouch for itself.
    let text = "
nodes:
  numbers: {kind: numbers, params: {count: 3}}
  unsteady: {kind: unsteady, inputs: {in: numbers}, params: {remembers: true}}
";
    let shop = Workshop::new();
    shop.run(text);
    let checked = shop.run_with(text, &recheck, |_, _| {});
    assert_eq!(checked.summary.failures.len(), 3, "{:#?}", checked.summary.failures);
    assert!(
        checked
            .summary
            .failures
            .iter()
            .all(|failure| failure.message.contains("`unsteady/out` produced two different"))
    );
}
