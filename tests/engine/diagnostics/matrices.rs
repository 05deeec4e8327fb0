//! Axes and cells.

use super::told_of;
use insta::assert_snapshot;

#[test]
fn an_axis_without_a_list() {
    assert_snapshot!(told_of("  b: {kind: affine, matrix: {mul: 3}, inputs: {in: numbers}}"), @r"
      × the axis `mul` is a number, expected a list of values
       ╭─[toy.yaml:3:35]
     3 │   b: {kind: affine, matrix: {mul: 3}, inputs: {in: numbers}}
       ·                                   ─
       ╰────
      help: write `[a, b]`

    1 problem found
    ");
}

#[test]
fn an_axis_that_sets_nothing() {
    assert_snapshot!(told_of("  b: {kind: affine, matrix: {mull: [3]}, inputs: {in: numbers}}"), @r"
      × the axis `mull` is neither a param of `affine` nor an axis of an input, so all cells would be equal
       ╭─[toy.yaml:3:30]
     3 │   b: {kind: affine, matrix: {mull: [3]}, inputs: {in: numbers}}
       ·                              ────
       ╰────
      help: did you mean `mul`?

    1 problem found
    ");
}

#[test]
fn an_axis_value_that_stands_twice() {
    assert_snapshot!(told_of("  b: {kind: affine, matrix: {mul: [3, 3]}, inputs: {in: numbers}}"), @r"
      × the value `3` occurs twice in the axis `mul`
       ╭─[toy.yaml:3:39]
     3 │   b: {kind: affine, matrix: {mul: [3, 3]}, inputs: {in: numbers}}
       ·                                       ─
       ╰────
      help: take one away

    1 problem found
    ");
}

#[test]
fn a_cell_that_the_kind_refuses() {
    assert_snapshot!(told_of("  b: {kind: affine, matrix: {mul: [3, 0]}, inputs: {in: numbers}}"), @r"
      × a factor of 0 makes all items alike
       ╭─[toy.yaml:3:39]
     3 │   b: {kind: affine, matrix: {mul: [3, 0]}, inputs: {in: numbers}}
       ·                                       ─
       ╰────
      help: give another factor

    1 problem found
    ");
}

#[test]
fn a_cell_that_is_not_there() {
    assert_snapshot!(told_of(r#"  b: {kind: affine, matrix: {mul: [2, 3]}, inputs: {in: numbers}}
  c: {kind: total, inputs: {in: "b[mul=4]"}}"#), @r#"
      × the axis `mul` of `b` has no value `4`
       ╭─[toy.yaml:4:33]
     4 │   c: {kind: total, inputs: {in: "b[mul=4]"}}
       ·                                 ──────────
       ╰────
      help: values: `2`, `3`

    1 problem found
    "#);
}
