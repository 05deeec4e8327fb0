//! What a run would do, and why.

use crate::support::{Workshop, resolve};
use serde_json::json;
use std::collections::BTreeMap;
use tauflow::engine::{
    self, Only, RunOptions,
    event::Ended,
    explain::{History, Reason},
};

const CHAIN: &str = "
nodes:
  numbers: {kind: numbers, params: {count: 3}}
  scaled: {kind: affine, inputs: {in: numbers}, params: {mul: 3}}
  rounded: {kind: round, inputs: {in: scaled}}
  total: {kind: total, inputs: {in: rounded}}
";

/// Numbers of a plan: hits, runs, blocked, and whether the items are known, by node.
fn plan(shop: &Workshop, text: &str) -> BTreeMap<String, (u64, u64, u64, bool)> {
    let plan = engine::plan(&resolve(text), &shop.store(), None).expect("readable");
    plan.summary.nodes.into_iter().map(|n| (n.node, (n.hit, n.ran, n.blocked, n.unknown))).collect()
}

#[test]
fn a_plan_knows_hits_runs_and_what_is_not_known_yet() {
    let shop = Workshop::new();
    let empty = plan(&shop, CHAIN);
    assert_eq!(empty["numbers"], (0, 3, 0, false));
    assert_eq!(empty["scaled"], (0, 0, 3, false));
    assert_eq!(empty["total"], (0, 0, 2, false));
    shop.run(CHAIN);
    let all = plan(&shop, CHAIN);
    assert_eq!(
        all.values().map(|(hit, ran, blocked, _)| (*hit, ran + blocked)).collect::<Vec<_>>(),
        [(3, 0), (3, 0), (3, 0), (2, 0)]
    );
    let edited = plan(&shop, &CHAIN.replace("mul: 3", "mul: 4"));
    assert_eq!((edited["numbers"], edited["scaled"]), ((3, 0, 0, false), (0, 3, 0, false)));
    assert_eq!(edited["rounded"], (0, 0, 3, false));
    // A plan runs nothing and keeps nothing.
    assert_eq!(plan(&shop, &CHAIN.replace("mul: 3", "mul: 4")), edited);
    assert_eq!(shop.run(&CHAIN.replace("mul: 3", "mul: 4")).ran()["scaled"], 3);
}

#[test]
fn a_dry_run_is_a_plan() {
    let shop = Workshop::new();
    let ran = shop.run_with(CHAIN, &RunOptions { dry: true, ..RunOptions::default() }, |_, _| {});
    assert_eq!(ran.ended(Ended::WouldRun).len(), 3);
    assert_eq!(shop.run(CHAIN).ran()["numbers"], 3);
}

#[test]
fn the_nearest_earlier_key_says_what_changed() {
    let shop = Workshop::new();
    shop.run(CHAIN);
    let edited = resolve(&CHAIN.replace("mul: 3", "mul: 4"));
    let store = shop.store();
    let only = Only::parse("scaled/n0001", &edited).expect("it is there");
    let plan = engine::plan(&edited, &store, Some(only)).expect("readable");
    let action = plan.would_run.iter().find(|a| a.ended == Ended::WouldRun).expect("it would run");
    assert_eq!(action.item.as_ref().map(tauflow_contract::ItemKey::as_str), Some("n0001"));
    let history = History::of(&store, "affine");
    let nearest = history.nearest(&action.key).expect("it was run with other params");
    assert_eq!(nearest.differences.len(), 1);
    assert_eq!(nearest.differences[0].field, "/params/mul");
    assert_eq!((&nearest.differences[0].before, &nearest.differences[0].now), (&Some(json!(3)), &Some(json!(4))));
    assert_eq!(Reason::of(Some(&nearest)).to_string(), "changed: param mul");
    assert_eq!(Reason::of(History::of(&store, "drawn").nearest(&action.key).as_ref()).to_string(), "has never run");
    assert!(shop.store().record_stats()["action"]["affine"].count > 0);
    // An action that was done before is looked at too.
    let done = resolve(CHAIN);
    let only = Only::parse("scaled/n0001", &done).expect("it is there");
    let plan = engine::plan(&done, &store, Some(only)).expect("readable");
    let action = plan.would_run.iter().find(|a| done.nodes[a.node].name == "scaled").expect("it was looked at");
    assert_eq!(action.ended, Ended::Hit);
    assert_eq!(action.key.basis.params["mul"], 3);
}

#[test]
fn outputs_say_what_must_run_first() {
    let shop = Workshop::new();
    let error = shop.outputs(CHAIN, "rounded", 0).expect_err("nothing has run");
    assert_eq!(
        error.to_string(),
        "`rounded` is stale: `numbers`, `scaled`, `rounded` must run first; run the pipeline with \
         `--target rounded`, then repeat this command"
    );
    shop.run(CHAIN);
    assert_eq!(shop.outputs(CHAIN, "rounded", 0).expect("it has run").len(), 3);
    let error = shop.outputs(CHAIN, "scaled", 1).expect_err("nobody asked for it");
    assert!(error.to_string().contains("`scaled` must run first"), "{error}");
}
