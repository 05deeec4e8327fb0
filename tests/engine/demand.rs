//! Only what is asked for runs, down to ports and items.

use crate::support::{Workshop, resolve};
use std::collections::BTreeMap;
use tauflow::{
    engine::{Only, event::Event},
    pipeline::{self, Options},
};

const FORK: &str = "
nodes:
  numbers: {kind: numbers, params: {count: 4}}
  scaled: {kind: affine, inputs: {in: numbers}, params: {mul: 2}}
  plain: {kind: total, inputs: {in: scaled}}
  other: {kind: round, inputs: {in: numbers}}
targets: [plain]
";

/// The groups of a node of which something ran.
fn groups(events: &[Event], of: &str) -> Vec<String> {
    let mut found: Vec<String> = events
        .iter()
        .filter_map(|e| match e {
            Event::End { node, group, .. } if node == of => Some(group.to_string()),
            _ => None,
        })
        .collect();
    found.sort();
    found.dedup();
    found
}

#[test]
fn a_group_that_nobody_reads_does_not_run() {
    let shop = Workshop::new();
    let ran = shop.run(FORK);
    assert_eq!(groups(&ran.events, "scaled"), ["main"]);
    let read = FORK.replace("{in: scaled}", "{in: [scaled.negative, numbers]}");
    let error = pipeline::resolve_text("toy.yaml", &read, &crate::support::registry(), &Options::default());
    let error = error.expect_err("they meet").render(false);
    assert!(error.contains("`scaled.negative` and `numbers` have items of the same keys"), "{error}");
    let read = FORK.replace("{in: scaled}", "{in: scaled.negative}");
    let ran = shop.run(&read);
    assert_eq!(groups(&ran.events, "scaled"), ["negative"]);
    assert_eq!(shop.numbers(&read, "plain")["all"], -120);
}

#[test]
fn a_node_that_no_target_needs_does_not_run() {
    let shop = Workshop::new();
    assert_eq!(shop.run(FORK).ran(), BTreeMap::from([("numbers", 4), ("scaled", 4), ("plain", 2)]));
    let options = Options { targets: vec!["other".into()], ..Options::default() };
    let asked = pipeline::resolve_text("toy.yaml", FORK, &crate::support::registry(), &options).expect("valid");
    let ran = shop.try_run(&asked, &tauflow::engine::RunOptions::default(), |_, _| {}).expect("runs");
    assert_eq!(ran.ran(), BTreeMap::from([("other", 4)]));
}

#[test]
fn only_one_item_runs_only_what_it_needs() {
    let shop = Workshop::new();
    let ran = shop.run_only(FORK, "scaled/n0002");
    assert_eq!(ran.ran(), BTreeMap::from([("numbers", 1), ("scaled", 1)]));
    // A gather needs them all, its readers' items or not.
    let ran = shop.run_only(FORK, "plain");
    assert_eq!(ran.ran(), BTreeMap::from([("numbers", 3), ("scaled", 3), ("plain", 2)]));
    let pipeline = resolve(FORK);
    let error = Only::parse("scald/n0002", &pipeline).expect_err("no such node");
    assert_eq!(error, "unknown node `scald`; did you mean `scaled`?");
}

#[test]
fn only_one_cell_runs_only_its_own() {
    let text = "
nodes:
  numbers: {kind: numbers, params: {count: 2}}
  scaled: {kind: affine, matrix: {mul: [2, 3]}, inputs: {in: numbers}}
  rounded: {kind: round, inputs: {in: scaled}}
";
    let shop = Workshop::new();
    assert_eq!(shop.run_only(text, "scaled/mul=3").ran(), BTreeMap::from([("numbers", 2), ("scaled", 2)]));
    assert_eq!(shop.run_only(text, "scaled/mul=2/n0001").ran(), BTreeMap::from([("scaled", 1)]));
    assert_eq!(shop.run_only(text, "rounded/mul=2/n0000").ran(), BTreeMap::from([("rounded", 1), ("scaled", 1)]));
}
