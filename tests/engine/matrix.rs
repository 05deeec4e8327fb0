//! Matrices: cells bind to cells, gather, or are picked.

use crate::support::Workshop;
use std::collections::BTreeMap;
use tauflow::engine::event::Event;

const GRID: &str = "
nodes:
  numbers: {kind: numbers, params: {count: 2, offset: 1}}
  scaled:
    kind: affine
    matrix: {mul: [2, 3], add: [0, 5]}
    inputs: {in: numbers}
  rounded:
    kind: affine
    matrix: {mul: [2, 3], add: [0, 5]}
    inputs: {in: scaled}
  half:
    kind: affine
    matrix: {mul: [2, 3]}
    inputs: {in: scaled}
    params: {add: 1}
  total: {kind: total, inputs: {in: scaled}}
  picked: {kind: total, inputs: {in: \"scaled[mul=3, add=5]\"}}
  row: {kind: total, inputs: {in: \"scaled[add=0]\"}}
";

fn run() -> (Workshop, BTreeMap<String, u64>) {
    let shop = Workshop::new();
    let ran = shop.run(GRID);
    assert!(ran.summary.failures.is_empty(), "{:#?}", ran.summary.failures);
    let counts = ran.ran().into_iter().map(|(node, count)| (node.to_owned(), count)).collect();
    (shop, counts)
}

#[test]
fn a_matrix_has_a_cell_for_each_combination() {
    let (shop, counts) = run();
    assert_eq!((counts["numbers"], counts["scaled"]), (2, 8));
    let cells = shop.numbers(GRID, "scaled");
    let expected = [
        ("mul=2+add=0/n0000", 2),
        ("mul=2+add=0/n0001", 22),
        ("mul=2+add=5/n0000", 7),
        ("mul=2+add=5/n0001", 27),
        ("mul=3+add=0/n0000", 3),
        ("mul=3+add=0/n0001", 33),
        ("mul=3+add=5/n0000", 8),
        ("mul=3+add=5/n0001", 38),
    ];
    assert_eq!(cells, expected.into_iter().map(|(k, v)| (k.to_owned(), v)).collect());
}

#[test]
fn the_same_axes_bind_cell_to_cell() {
    let (shop, counts) = run();
    assert_eq!(counts["rounded"], 8);
    assert_eq!(shop.numbers(GRID, "rounded")["mul=3+add=5/n0001"], 3 * 38 + 5);
}

#[test]
fn an_axis_that_the_reader_has_not_is_gathered() {
    let (shop, counts) = run();
    assert_eq!(counts["half"], 8);
    // The reader's own axis binds; the other one stands before the items' keys.
    assert_eq!(shop.numbers(GRID, "half")["mul=3/add=5/n0001"], 3 * 38 + 1);
    assert_eq!(shop.numbers(GRID, "total")["all"], 24 + 34 + 36 + 46);
}

#[test]
fn cells_can_be_picked() {
    let (shop, _) = run();
    assert_eq!(shop.numbers(GRID, "picked")["all"], 46);
    assert_eq!(shop.numbers(GRID, "row")["all"], 24 + 36);
}

#[test]
fn a_cell_more_runs_that_cell_and_what_gathers_it() {
    let (shop, _) = run();
    let more = GRID.replace("mul: [2, 3], add: [0, 5]", "mul: [2, 3], add: [0, 5, 6]");
    let ran = shop.run(&more);
    // `row` and `picked` do not read the new cells.
    assert_eq!(ran.ran(), BTreeMap::from([("scaled", 4), ("rounded", 4), ("half", 4), ("total", 2)]));
    let cells = ran.events.iter().filter_map(|e| match e {
        Event::Begin { node, cell, .. } if node == "scaled" => Some(&**cell),
        _ => None,
    });
    assert!(cells.into_iter().all(|cell| cell.ends_with("add=6")));
}

#[test]
fn a_failing_cell_does_not_stop_the_others() {
    let shop = Workshop::new();
    let text = "
nodes:
  numbers: {kind: numbers, params: {count: 3}}
  scaled: {kind: affine, matrix: {fail_from: [10, 100]}, inputs: {in: numbers}}
  each: {kind: total, matrix: {fail_from: [10, 100]}, inputs: {in: scaled}}
  all: {kind: total, inputs: {in: scaled}}
";
    let ran = shop.run(text);
    assert_eq!(ran.ran(), BTreeMap::from([("numbers", 3), ("scaled", 4), ("each", 2)]));
    assert_eq!(ran.count(|n| n.failed), BTreeMap::from([("scaled", 2)]));
    assert_eq!(ran.count(|n| n.blocked), BTreeMap::from([("each", 2), ("all", 2)]));
    let only: Vec<String> = ran.summary.failures.iter().map(tauflow::engine::event::Failure::only).collect();
    assert!(only.contains(&"scaled/fail_from=10/n0002".to_owned()), "{only:?}");
}
