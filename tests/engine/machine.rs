//! What belongs to a machine: outputs that a library or processor decides, and measurements.

use crate::support::Workshop;
use std::{collections::BTreeMap, fs};
use tauflow::{engine::RunOptions, lock::Lock};
use tauflow_contract::Determinism;

fn pipeline(shop: &Workshop) -> String {
    format!(
        "
pipeline: site
nodes:
  numbers: {{kind: numbers, params: {{count: 12}}}}
  sited: {{kind: sited, inputs: {{in: numbers}}, params: {{site: {:?}}}}}
  total: {{kind: total, inputs: {{in: sited}}}}
  clocks: {{kind: total, inputs: {{in: sited.clocked}}}}
",
        shop.path("site")
    )
}

#[test]
fn another_machine_is_another_key_and_the_first_one_again_is_known() {
    let shop = Workshop::new();
    let text = pipeline(&shop);
    fs::write(shop.path("site"), "7").expect("writable");
    let first = shop.run(&text);
    assert_eq!(first.ran()["sited"], 24);
    assert_eq!(shop.numbers(&text, "total")["all"], 84);
    assert_eq!(shop.run(&text).ran(), BTreeMap::new());
    fs::write(shop.path("site"), "8").expect("writable");
    let second = shop.run(&text);
    assert_eq!(second.ran()["sited"], 24, "the library is another");
    assert!(!second.ran().contains_key("numbers"));
    assert_eq!(shop.numbers(&text, "total")["all"], 96);
    fs::write(shop.path("site"), "7").expect("writable");
    let back = shop.run(&text);
    assert_eq!(back.ran(), BTreeMap::new(), "nothing was lost");
    // By items, too.
    let options = RunOptions { no_rollup: true, many: 1, ..RunOptions::default() };
    assert_eq!(shop.run_with(&text, &options, |_, _| {}).ran(), BTreeMap::new());
}

#[test]
fn what_measures_runs_alone() {
    let shop = Workshop::new();
    let text = pipeline(&shop);
    fs::write(shop.path("site"), "7").expect("writable");
    let options = RunOptions { jobs: 4, ..RunOptions::default() };
    shop.run_with(&text, &options, |_, _| {});
    // Each of the twelve saw itself alone.
    assert_eq!(shop.numbers(&text, "clocks")["all"], 12);
}

#[test]
fn a_lock_leaves_out_what_belongs_to_a_machine() {
    let shop = Workshop::new();
    let text = pipeline(&shop);
    fs::write(shop.path("site"), "7").expect("writable");
    let ran = shop.run(&text);
    let found: BTreeMap<&str, Determinism> =
        ran.summary.outputs.iter().map(|output| (output.name.as_str(), output.determinism)).collect();
    assert_eq!(found["numbers.out"], Determinism::Bitwise);
    assert_eq!((found["sited.out"], found["total.out"]), (Determinism::Local, Determinism::Local));
    assert_eq!((found["sited.clocked"], found["clocks.out"]), (Determinism::Measured, Determinism::Measured));
    let lock = Lock::of("site", &ran.summary.outputs);
    assert!(lock.bitwise.contains_key("numbers.out") && !lock.bitwise.contains_key("total.out"));
    assert!(lock.left_out.contains("sited.out"));
}
