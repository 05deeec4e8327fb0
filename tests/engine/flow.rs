//! How items flow: filters, several inputs, no barriers, the latest stage first.

use crate::support::Workshop;
use std::collections::BTreeMap;
use tauflow::engine::{
    RunOptions,
    event::{Ended, Event},
};

#[test]
fn an_item_goes_on_before_its_siblings_are_done() {
    let text = "
nodes:
  numbers: {kind: numbers, params: {count: COUNT, nap_ms: NAP}}
  scaled: {kind: affine, inputs: {in: numbers}, params: {mul: 2}}
  rounded: {kind: round, inputs: {in: scaled}}
";
    let ended = |count: usize, nap: usize| {
        let shop = Workshop::new();
        let text = text.replace("COUNT", &count.to_string()).replace("NAP", &nap.to_string());
        shop.run_with(&text, &RunOptions { jobs: 1, ..RunOptions::default() }, |_, _| {}).ended(Ended::Ran)
    };
    // What takes its time goes one by one, the latest stage first.
    let expected: Vec<String> = ["n0000", "n0001", "n0002"]
        .iter()
        .flat_map(|i| ["numbers", "scaled", "rounded"].map(|n| format!("{n}/{i}")))
        .collect();
    assert_eq!(ended(3, 3), expected);
    // What is short goes by the batch, and still an item is through before the first node has done its last.
    let short = ended(3000, 0);
    let last = short.iter().rposition(|e| e.starts_with("numbers/")).expect("it ran");
    let first = short.iter().position(|e| e.starts_with("rounded/")).expect("it ran");
    assert_eq!(short.len(), 9000);
    assert!(first < last / 4, "the first was through after {first} ends, the last began after {last}");
}

#[test]
fn filters_leave_items_out() {
    let text = "
nodes:
  numbers: {kind: numbers, params: {count: 5}}
  gate: {kind: below, inputs: {in: numbers}, params: {limit: 25}}
  kept: {kind: affine, inputs: {in: gate}}
  others: {kind: affine, inputs: {in: gate.others}, params: {add: 1}}
  total: {kind: total, inputs: {in: [kept, others]}}
";
    let shop = Workshop::new();
    let ran = shop.run(text);
    assert_eq!(ran.ran(), BTreeMap::from([("numbers", 5), ("gate", 5), ("kept", 3), ("others", 2), ("total", 2)]));
    assert_eq!(shop.numbers(text, "total")["all"], 102);
    // An item that moves over the limit: the two sides change by it.
    let moved = shop.run(&text.replace("limit: 25", "limit: 35"));
    assert_eq!(moved.ran(), BTreeMap::from([("gate", 5), ("kept", 1), ("total", 2)]));
    // Nothing left at all.
    let none = text.replace("limit: 25", "limit: -1");
    assert_eq!(shop.run(&none).ran()["others"], 3);
    assert_eq!(shop.numbers(&none, "kept"), BTreeMap::new());
}

#[test]
fn inputs_of_a_map_meet_by_item() {
    let text = "
nodes:
  numbers: {kind: numbers, params: {count: 3}}
  scaled: {kind: affine, inputs: {in: numbers}, params: {mul: 2}}
  sums: {kind: pair, inputs: {left: numbers, right: scaled}}
  shares: {kind: shares, inputs: {in: sums, of: scaled}}
";
    let shop = Workshop::new();
    shop.run(text);
    assert_eq!(shop.numbers(text, "sums").into_values().collect::<Vec<_>>(), [0, 30, 60]);
    assert_eq!(shop.numbers(text, "shares").into_values().collect::<Vec<_>>(), [0, 50, 100]);
    // The first input says which items there are; each needs its fellow on the other.
    let fewer = text.replace(
        "  sums: {kind: pair, inputs: {left: numbers, right: scaled}}",
        "  gate: {kind: below, inputs: {in: scaled}, params: {limit: 30}}\n  \
         sums: {kind: pair, inputs: {left: gate, right: numbers}}",
    );
    assert!(shop.run(&fewer).summary.failures.is_empty());
    assert_eq!(shop.numbers(&fewer, "sums").len(), 2);
    let lacking = fewer.replace("{left: gate, right: numbers}", "{left: numbers, right: gate}");
    let failures = shop.run(&lacking).summary.failures;
    assert_eq!(failures.len(), 1);
    assert_eq!(
        failures[0].message,
        "the input `right` has no item `n0002`; connect a node that has all items of input `left`"
    );
}

#[test]
fn the_account_adds_up() {
    let text = "
nodes:
  numbers: {kind: numbers, params: {count: 7}}
  scaled: {kind: affine, inputs: {in: numbers}, params: {fail_from: 50}}
  rounded: {kind: round, inputs: {in: scaled}}
  total: {kind: total, inputs: {in: rounded}}
";
    let shop = Workshop::new();
    let ran = shop.run(text);
    let mut expected: BTreeMap<&str, u64> = BTreeMap::new();
    let mut ended: BTreeMap<&str, u64> = BTreeMap::new();
    for event in &ran.events {
        match event {
            Event::Expect { node, actions } => *expected.entry(node).or_default() += actions,
            Event::End { node, .. } => *ended.entry(node).or_default() += 1,
            _ => {}
        }
    }
    assert_eq!(expected, ended);
    assert_eq!(ran.count(|n| n.ran + n.hit + n.failed + n.blocked), ended);
    assert!(matches!(ran.events.last(), Some(Event::Finished { ran: 17, hit: 0, failed: 2, blocked: 4, .. })));
}
