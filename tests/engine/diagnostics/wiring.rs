//! Inputs, outputs and targets.

use super::{NUMBERS, told, told_of, told_with};
use insta::assert_snapshot;
use tauflow::pipeline::Options;

#[test]
fn a_missing_input() {
    assert_snapshot!(told_of("  b: {kind: affine}"), @r"
      × missing input `in` of `b`
       ╭─[toy.yaml:3:3]
     3 │   b: {kind: affine}
       ·   ─
       ╰────
      help: add `inputs: { in: NODE }`, items of type `toy/number`: A number.

    1 problem found
    ");
}

#[test]
fn a_circle() {
    assert_snapshot!(told_of("  b: {kind: affine, inputs: {in: c}}
  c: {kind: round, inputs: {in: b}}"), @r"
      × cyclic inputs: b -> c -> b
       ╭─[toy.yaml:3:34]
     3 │   b: {kind: affine, inputs: {in: c}}
       ·                                  ─
       ╰────
      help: remove one of these inputs

    1 problem found
    ");
}

#[test]
fn a_circle_of_one() {
    assert_snapshot!(told_of("  b: {kind: affine, inputs: {in: b}}"), @r"
      × cyclic inputs: b -> b
       ╭─[toy.yaml:3:34]
     3 │   b: {kind: affine, inputs: {in: b}}
       ·                                  ─
       ╰────
      help: remove one of these inputs

    1 problem found
    ");
}

#[test]
fn an_unknown_output() {
    assert_snapshot!(told_of("  b: {kind: affine, inputs: {in: numbers.ot}}"), @r"
      × `numbers` has no output `ot`
       ╭─[toy.yaml:3:34]
     3 │   b: {kind: affine, inputs: {in: numbers.ot}}
       ·                                  ──────────
       ╰────
      help: outputs: `out`

    1 problem found
    ");
}

#[test]
fn an_unknown_input() {
    assert_snapshot!(told_of("  b: {kind: affine, inputs: {on: numbers}}"), @r"
      × missing input `in` of `b`
       ╭─[toy.yaml:3:3]
     3 │   b: {kind: affine, inputs: {on: numbers}}
       ·   ─
       ╰────
      help: add `inputs: { in: NODE }`, items of type `toy/number`: A number.

      × `affine` has no input `on`
       ╭─[toy.yaml:3:30]
     3 │   b: {kind: affine, inputs: {on: numbers}}
       ·                              ──
       ╰────
      help: inputs: `in`

    2 problems found
    ");
}

#[test]
fn an_unknown_node() {
    assert_snapshot!(told_of("  b: {kind: affine, inputs: {in: number}}"), @r"
      × unknown node `number`
       ╭─[toy.yaml:3:34]
     3 │   b: {kind: affine, inputs: {in: number}}
       ·                                  ──────
       ╰────
      help: did you mean `numbers`?

    1 problem found
    ");
}

#[test]
fn a_connection_of_unlike_types() {
    assert_snapshot!(told_of("  t: {kind: total, inputs: {in: numbers}}
  b: {kind: affine, inputs: {in: t.page}}"), @r"
      × the input `in` takes `toy/number`, but `t.page` produces `toy/text`
       ╭─[toy.yaml:4:34]
     4 │   b: {kind: affine, inputs: {in: t.page}}
       ·                                  ──────
       ╰────
      help: `t.out`, `numbers.out` would fit

    1 problem found
    ");
}

#[test]
fn what_would_fit_makes_no_circle() {
    let lines = "  t: {kind: total, inputs: {in: numbers}}
  b: {kind: affine, inputs: {in: t.page}}
  c: {kind: affine, inputs: {in: b}}
  d: {kind: affine, inputs: {in: numbers}}";
    // Not `b`, nor `c`, which reads it.
    assert!(
        told_of(lines).contains("help: `t.out`, `numbers.out`, `d.out`, `d.negative` would fit\n"),
        "{}",
        told_of(lines)
    );
}

#[test]
fn a_connection_that_nothing_fits() {
    let told = told("nodes:\n  t: {kind: total, inputs: {in: u.page}}\n  u: {kind: total, inputs: {in: t}}\n");
    assert!(told.contains("help: no node produces `toy/number`; `tauflow kinds` lists the kinds\n"), "{told}");
}

#[test]
fn an_unknown_target() {
    assert_snapshot!(told_of("targets: [total]"), @r"
      × unknown node `total`
       ╭─[toy.yaml:3:11]
     3 │ targets: [total]
       ·           ─────
       ╰────
      help: nodes: `numbers`

    1 problem found
    ");
}

#[test]
fn a_target_with_an_unknown_output() {
    assert_snapshot!(told_with(NUMBERS, &Options { targets: vec!["numbers.x".into()], ..Options::default() }), @r"
      × `numbers` has no output `x`
      help: outputs: `out`

    1 problem found
    ");
}
