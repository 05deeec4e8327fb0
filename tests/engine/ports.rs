//! Kinds whose params decide their ports.

use crate::{diagnostics::told, support::Workshop};

/// The toy `fan` as a map, read on two of its ports, and as a gather.
fn pipeline(outputs: &str, add: i64) -> String {
    format!(
        "nodes:
  numbers: {{kind: numbers, params: {{count: 3}}}}
  fan:
    kind: fan
    inputs: {{ given: numbers }}
    params: {{ input: given, outputs: {{ {outputs} }}, add: {add} }}
  sums: {{kind: fan, inputs: {{ in: fan.tripled }}, params: {{ gather: true, outputs: {{ total: 1, half: 2 }} }}}}
  shown: {{kind: total, inputs: {{ in: [sums.total, sums.half] }}}}
  other: {{kind: affine, matrix: {{mul: [1, 2]}}, inputs: {{ in: fan.doubled }}}}
"
    )
}

#[test]
fn params_decide_ports_and_how_a_node_works_through_items() {
    let shop = Workshop::new();
    let ran = shop.run(&pipeline("doubled: 2, tripled: 3", 0));
    assert!(ran.summary.failures.is_empty(), "{:#?}", ran.summary.failures);
    assert_eq!(ran.ran(), [("numbers", 3), ("fan", 3), ("sums", 1), ("shown", 2), ("other", 6)].into());
    // The numbers are 0, 10 and 20: 3 * 30 = 90 and twice that.
    let shown = shop.numbers(&pipeline("doubled: 2, tripled: 3", 0), "shown");
    assert_eq!(shown.into_values().collect::<Vec<_>>(), [270]);
    assert_eq!(shop.run(&pipeline("doubled: 2, tripled: 3", 0)).ran(), [].into());
    // Another port is another action; readers of ports that stay the same have nothing to do.
    let more = shop.run(&pipeline("doubled: 2, halved: 1, tripled: 3", 0));
    assert_eq!(more.ran(), [("fan", 3)].into());
}

#[test]
fn params_that_decide_ports_are_told_of_at_their_place() {
    let wrong = told(
        "nodes:
  numbers: {kind: numbers}
  fan:
    kind: fan
    inputs: { in: numbers }
    matrix:
      add: [1, 2]
      input: [in, given]
  next: {kind: affine, inputs: { in: fan.twice }}
",
    );
    assert!(wrong.contains("toy.yaml:8:7"), "the place of the axis: {wrong}");
    assert!(wrong.contains("`input` decides what the ports of `fan` are"), "{wrong}");
    assert!(!wrong.contains("`add` decides"), "{wrong}");
    assert!(wrong.contains("`fan` has no output `twice`"), "{wrong}");
    // Ports that wrong params leave open are not told of a second time.
    let open = told(
        "nodes:
  numbers: {kind: numbers}
  fan: {kind: fan, inputs: { given: numbers }, params: { input: 7 }}
  none: {kind: fan, inputs: { in: numbers }, params: { outputs: {} }}
  next: {kind: affine, inputs: { in: fan.twice }}
",
    );
    assert!(open.contains("expected a text") && open.contains("there are no outputs"), "{open}");
    assert!(!open.contains("twice") && !open.contains("`given`"), "{open}");
}
