//! Queries: answers as types, which the command line prints and other front ends read.

use crate::support::{Workshop, resolve};
use tauflow::{
    engine::{Only, explain::Reason},
    query::{self, Explanation, NodePlan, PlanCosts, Why},
};

fn text(mul: i64) -> String {
    format!(
        "nodes:\n  numbers: {{kind: numbers, params: {{count: 3}}}}\n  \
         scaled: {{kind: affine, inputs: {{in: numbers}}, params: {{mul: {mul}}}}}\n  \
         sum: {{kind: total, inputs: {{in: scaled}}}}\n"
    )
}

fn node<'a>(plan: &'a PlanCosts, name: &str) -> &'a NodePlan {
    plan.nodes.iter().find(|node| node.node == name).expect("it is needed")
}

#[test]
fn a_plan_says_of_each_node_what_would_run_why_and_what_that_costs() {
    let shop = Workshop::new();
    let plan = |mul| query::plan(&resolve(&text(mul)), &shop.store()).expect("readable");
    let new = plan(2);
    assert_eq!(node(&new, "numbers").reasons, [(Reason::Never, 3)]);
    assert!(new.is_partial() && !new.is_empty() && node(&new, "numbers").cost.is_none());
    shop.run(&text(2));
    assert!(plan(2).is_empty());
    let edited = plan(3);
    let scaled = node(&edited, "scaled");
    assert_eq!((scaled.as_before, scaled.to_run), (0, 3));
    assert_eq!(scaled.reasons, [(Reason::Changed(vec!["param mul".into()]), 3)]);
    assert!(scaled.cost.is_some_and(|cost| cost.bytes > 0.0 && cost.bytes <= edited.total.bytes));
    // The sum and its page are groups of their own.
    assert_eq!((node(&edited, "numbers").as_before, node(&edited, "sum").waiting), (3, 2));
    let json = serde_json::to_value(&edited).expect("plain data");
    assert_eq!(json["nodes"][1]["reasons"][0][0]["changed"][0], "param mul");
}

#[test]
fn a_plan_counts_what_may_follow() {
    let shop = Workshop::new();
    let chain = |count: u64, mul: i64| {
        format!(
            "nodes:
  numbers: {{kind: numbers, params: {{count: {count}, nap_ms: 20}}}}
  scaled: {{kind: affine, inputs: {{in: numbers}}, params: {{mul: {mul}}}}}
  small: {{kind: below, inputs: {{in: scaled}}, params: {{limit: 25}}}}
  rounded: {{kind: round, matrix: {{to: [5, 10]}}, inputs: {{in: small.kept}}}}
  sum: {{kind: total, inputs: {{in: rounded}}}}
"
        )
    };
    let plan = |count, mul| query::plan(&resolve(&chain(count, mul)), &shop.store()).expect("readable");
    let may_run = |plan: &PlanCosts| plan.nodes.iter().map(|n| (n.to_run, n.may_run)).collect::<Vec<_>>();
    // Nothing has run: all may, and nothing is known of the time.
    let new = plan(4, 1);
    assert_eq!(may_run(&new), [(4, 0), (0, 4), (0, 4), (0, 8), (0, 2)]);
    assert_eq!((new.never.len(), new.most.seconds), (5, 0.0));
    shop.run(&chain(4, 1));
    assert!(plan(4, 1).is_empty());
    // Two numbers more: what is certain is their own cost, and all that reads them may follow.
    let more = plan(6, 1);
    assert_eq!(may_run(&more), [(2, 0), (0, 2), (0, 2), (0, 4), (0, 2)]);
    assert!(more.never.is_empty());
    assert!((0.04..0.4).contains(&more.total.seconds), "two naps of 20 ms: {}", more.total.seconds);
    assert!(more.most.seconds > more.total.seconds && more.most.bytes > more.total.bytes);
    // The bound holds: no node runs more than it says.
    let ran = shop.run(&chain(6, 1));
    for (name, count) in ran.ran() {
        let planned = node(&more, name);
        assert!(count <= planned.to_run + planned.may_run, "{name}: {count}");
    }
    // An edit in the middle leaves what stands before it.
    assert_eq!(may_run(&plan(6, 2)), [(0, 0), (6, 0), (0, 6), (0, 12), (0, 2)]);
}

#[test]
fn an_explanation_is_of_one_action_or_of_groups() {
    let shop = Workshop::new();
    shop.run(&text(2));
    let explain = |mul, of: &str| {
        let pipeline = resolve(&text(mul));
        let only = Only::parse(of, &pipeline).expect("it is there");
        query::explain(&pipeline, &shop.store(), &only)
    };
    let changed = Why::Runs(Reason::Changed(vec!["param mul".into()]));
    let Ok(Explanation::Several(groups)) = explain(3, "scaled") else { panic!("there are three items") };
    assert_eq!((groups.len(), &groups[0].why, groups[0].names.len()), (1, &changed, 3));
    let Ok(Explanation::One(one)) = explain(3, "scaled/n0001") else { panic!("it is one item") };
    assert_eq!((&one.why, one.nearest.is_some(), one.name.as_str()), (&changed, true, "n0001"));
    let Ok(Explanation::One(one)) = explain(2, "scaled/n0001") else { panic!("it is one item") };
    assert_eq!((&one.why, one.nearest.is_none()), (&Why::Done, true));
    let Ok(Explanation::Waits(nodes)) = explain(3, "sum") else { panic!("its input is not there") };
    assert_eq!(nodes, ["scaled"]);
    let error = explain(2, "scaled/n0009").expect_err("there is no such item");
    assert!(error.to_string().contains("`scaled` has no item `n0009`"), "{error}");
}
