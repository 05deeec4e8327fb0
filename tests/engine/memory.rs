//! Transient outputs cost no disk, and what is in flight keeps to a number of bytes.

use crate::support::{Workshop, resolve};
use std::{
    collections::BTreeMap,
    sync::atomic::{AtomicI64, Ordering::SeqCst},
};
use tauflow::engine::{RunOptions, event::Event};

/// Three outputs of 70 kB, read by one node.
const TRANSIENT: &str = "
nodes:
  numbers: {kind: numbers, params: {count: 3}}
  long: {kind: affine, inputs: {in: numbers}, params: {mul: 2, pad: 70000}, transient: true}
  rounded: {kind: round, inputs: {in: long}}
  total: {kind: total, inputs: {in: rounded}}
";

fn stored(shop: &Workshop) -> u64 {
    shop.store().stat().expect("readable").bytes
}

#[test]
fn transient_outputs_are_not_stored_and_are_made_again_when_they_are_needed() {
    let (shop, kept) = (Workshop::new(), Workshop::new());
    shop.run(TRANSIENT);
    kept.run(&TRANSIENT.replace(", transient: true", ""));
    assert!(stored(&shop) < 20_000 && stored(&kept) > 3 * 70_000, "{} {}", stored(&shop), stored(&kept));
    assert_eq!(shop.numbers(TRANSIENT, "total"), kept.numbers(TRANSIENT, "total"));
    assert_eq!(shop.run(TRANSIENT).ran(), BTreeMap::new(), "nobody asks for them");
    // Another reader needs them: they are made once more, and nothing else is.
    let edited = TRANSIENT.replace("kind: round,", "kind: round, params: {to: 7},");
    let again = shop.run(&edited);
    assert!(again.summary.failures.is_empty(), "{:#?}", again.summary.failures);
    assert_eq!(again.ran()["long"], 3);
    assert!(!again.ran().contains_key("numbers"));
    assert!(stored(&shop) < 25_000);
    // What is asked for is stored.
    let asked = format!("{TRANSIENT}targets: [long]\n");
    shop.run(&asked);
    assert_eq!(shop.numbers(&asked, "long")["n0002"], 40);
    assert!(stored(&shop) > 3 * 70_000);
}

#[test]
fn transient_outputs_without_room_are_stored_like_others() {
    let shop = Workshop::new();
    let options = RunOptions { memory: Some(200_000), ..RunOptions::default() };
    let ran = shop.run_with(&TRANSIENT.replace("count: 3", "count: 3, nap_ms: 1"), &options, |_, _| {});
    assert!(ran.summary.failures.is_empty());
    let whole =
        TRANSIENT.replace("rounded: {kind: round, inputs: {in: long}}", "rounded: {kind: total, inputs: {in: long}}");
    let shop = Workshop::new();
    let ran = shop.run_with(&whole, &options, |_, _| {});
    assert!(ran.summary.failures.is_empty(), "{:#?}", ran.summary.failures);
    // A gather needs all three, and one has room.
    assert!((140_000..150_000).contains(&stored(&shop)), "{}", stored(&shop));
}

#[test]
fn actions_in_flight_keep_to_the_budget_whatever_the_number_of_items() {
    // Each reads 100 kB and makes 100 kB: of eight workers, two may be at it.
    let text = "
nodes:
  numbers: {kind: numbers, params: {count: 40}}
  long: {kind: affine, inputs: {in: numbers}, params: {pad: 100000}}
  longer: {kind: affine, inputs: {in: long}, params: {mul: 3, pad: 100000}}
targets: [longer]
";
    let most = |memory: u64| {
        let (now, most) = (AtomicI64::new(0), AtomicI64::new(0));
        let shop = Workshop::new();
        let options = RunOptions { memory: Some(memory), jobs: 8, ..RunOptions::default() };
        let count = |event: &Event| match event {
            Event::Begin { node, .. } if **node == *"longer" => {
                most.fetch_max(now.fetch_add(1, SeqCst) + 1, SeqCst);
                std::thread::sleep(std::time::Duration::from_millis(3));
            }
            Event::End { node, .. } if **node == *"longer" => drop(now.fetch_sub(1, SeqCst)),
            _ => {}
        };
        let ran = shop.try_run(&resolve(text), &options, |event, _| count(event)).expect("the store works");
        assert_eq!(ran.ran()["longer"], 40);
        most.into_inner()
    };
    assert!(most(1 << 30) > 4, "with room, all workers have work");
    // The first action of a node is unknown to make 100 kB.
    assert!((1..=4).contains(&most(410_000)), "in flight");
    assert_eq!(most(1), 1, "one runs whatever it takes");
}

#[test]
fn equal_contents_and_several_readers_and_ports_of_transient_nodes_come_through() {
    // Rounding makes many numbers alike; the gate has two ports, one of them read twice, and stands behind another
    // transient node.
    let text = "
nodes:
  numbers: {kind: numbers, params: {count: 200}}
  alike: {kind: round, inputs: {in: numbers}, params: {to: 500}, transient: true}
  padded: {kind: affine, inputs: {in: alike}, params: {pad: 5000, add: ADD}, transient: true}
  gate: {kind: below, inputs: {in: padded}, params: {limit: 1000}, transient: true}
  one: {kind: round, inputs: {in: gate}, params: {to: TO}}
  two: {kind: affine, inputs: {in: gate}, params: {add: TO}}
  total: {kind: total, inputs: {in: [one]}}
  others: {kind: total, inputs: {in: [two]}}
";
    let edit = |add: u32, to: u32| text.replace("ADD", &add.to_string()).replace("TO", &to.to_string());
    let shop = Workshop::new();
    for (add, to) in [(0, 10), (0, 30), (1, 30), (0, 30), (0, 7)] {
        let edited = edit(add, to);
        let plan = tauflow::engine::plan(&resolve(&edited), &shop.store(), None).expect("readable");
        let ran = shop.run(&edited);
        assert!(ran.summary.failures.is_empty(), "{:#?}", ran.summary.failures);
        let fresh = Workshop::new();
        let kept = edited.replace(", transient: true", "");
        fresh.run(&kept);
        for node in ["total", "others"] {
            assert_eq!(shop.numbers(&edited, node), fresh.numbers(&kept, node), "{node} of {add} {to}");
        }
        assert!(shop.run(&edited).ran().is_empty());
        // What a plan does not see, because something before it would run, it says to be waiting.
        let planned: u64 = plan.summary.nodes.iter().map(|n| n.ran + n.blocked).sum();
        assert!(ran.ran().is_empty() || planned > 0);
    }
}

#[test]
fn a_plan_counts_what_must_be_made_again_for_a_reader() {
    let shop = Workshop::new();
    shop.run(TRANSIENT);
    let edited = TRANSIENT.replace("kind: round,", "kind: round, params: {to: 7},");
    let plan = tauflow::engine::plan(&resolve(&edited), &shop.store(), None).expect("readable");
    let long = plan.summary.nodes.iter().find(|n| n.node == "long").expect("it is there");
    assert_eq!((long.ran, long.hit), (3, 0));
}
