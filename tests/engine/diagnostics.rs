//! What people are told of a pipeline that is wrong: what is so, where, and what to do.

use crate::support::registry;
use insta::assert_snapshot;
use tauflow::pipeline::{self, Options};

/// A pipeline that is fine; tests add to it.
const NUMBERS: &str = "nodes:\n  numbers: {kind: numbers}\n";

fn told_with(text: &str, options: &Options) -> String {
    pipeline::resolve_text("toy.yaml", text, &registry(), options).expect_err("it has problems").render(false)
}

fn told(text: &str) -> String {
    told_with(text, &Options::default())
}

/// What is told when these lines are added to the pipeline that is fine.
fn told_of(lines: &str) -> String {
    told(&format!("{NUMBERS}{lines}\n"))
}

fn told_of_set(set: &str) -> String {
    told_with(NUMBERS, &Options { sets: vec![set.into()], ..Options::default() })
}

#[test]
fn an_unknown_key() {
    assert_snapshot!(told("pipelin: x\nnodes:\n  a: {kind: numbers}\n"), @r"
      × unknown key `pipelin`
       ╭─[toy.yaml:1:1]
     1 │ pipelin: x
       · ───────
       ╰────
      help: did you mean `pipeline`?

    1 problem found
    ");
}

#[test]
fn an_unknown_key_of_a_node() {
    assert_snapshot!(told("nodes:\n  a: {kind: numbers, parms: {count: 3}}\n"), @r"
      × unknown key `parms` of a node
       ╭─[toy.yaml:2:22]
     2 │   a: {kind: numbers, parms: {count: 3}}
       ·                      ─────
       ╰────
      help: did you mean `params`?

    1 problem found
    ");
}

#[test]
fn an_unknown_param() {
    assert_snapshot!(told("\
nodes:
  a:
    kind: numbers
    params: {cuont: 3}
"), @r"
      × unknown param `cuont`
       ╭─[toy.yaml:4:14]
     4 │     params: {cuont: 3}
       ·              ─────
       ╰────
      help: did you mean `count`?

    1 problem found
    ");
}

#[test]
fn a_wrong_type() {
    assert_snapshot!(told("nodes:\n  a: {kind: numbers, params: {count: many}}\n"), @r"
      × expected a whole number from 0 to 100000, found a text
       ╭─[toy.yaml:2:38]
     2 │   a: {kind: numbers, params: {count: many}}
       ·                                      ────
       ╰────
      help: write a number

    1 problem found
    ");
}

#[test]
fn a_number_in_quotes() {
    assert_snapshot!(told(r#"nodes:
  a: {kind: numbers, params: {count: "7"}}
"#), @r#"
      × expected a whole number from 0 to 100000, found a text
       ╭─[toy.yaml:2:38]
     2 │   a: {kind: numbers, params: {count: "7"}}
       ·                                      ───
       ╰────
      help: take the quotes away

    1 problem found
    "#);
}

#[test]
fn a_missing_input() {
    assert_snapshot!(told_of("  b: {kind: affine}"), @r"
      × the input `in` of `b` is missing
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
      × nodes read each other in a circle: b -> c -> b
       ╭─[toy.yaml:3:34]
     3 │   b: {kind: affine, inputs: {in: c}}
       ·                                  ─
       ╰────
      help: take one of these inputs away; a pipeline goes one way

    1 problem found
    ");
}

#[test]
fn a_circle_of_one() {
    assert_snapshot!(told_of("  b: {kind: affine, inputs: {in: b}}"), @r"
      × nodes read each other in a circle: b -> b
       ╭─[toy.yaml:3:34]
     3 │   b: {kind: affine, inputs: {in: b}}
       ·                                  ─
       ╰────
      help: take one of these inputs away; a pipeline goes one way

    1 problem found
    ");
}

#[test]
fn a_number_out_of_range() {
    assert_snapshot!(told_of("  b:
    kind: affine
    inputs: {in: numbers}
    params: {add: 2000}"), @r"
      × 2000 is out of range
       ╭─[toy.yaml:6:19]
     6 │     params: {add: 2000}
       ·                   ────
       ╰────
      help: give a number from -1000 to 1000

    1 problem found
    ");
}

#[test]
fn an_unknown_kind() {
    assert_snapshot!(told_of("  b: {kind: affin, inputs: {in: numbers}}"), @r"
      × there is no kind `affin`
       ╭─[toy.yaml:3:13]
     3 │   b: {kind: affin, inputs: {in: numbers}}
       ·             ─────
       ╰────
      help: did you mean `affine`?

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
      × the input `in` of `b` is missing
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
      × there is no node `number`
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
      × the input `in` takes `toy/number`, and `t.page` gives `toy/text`
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
    assert!(told.contains("help: no other node gives `toy/number`; `tauflow kinds` lists the kinds\n"), "{told}");
}

#[test]
fn a_key_that_stands_twice() {
    assert_snapshot!(told_of("  numbers: {kind: numbers}"), @r"
      × the key `numbers` stands twice in one map
       ╭─[toy.yaml:3:3]
     3 │   numbers: {kind: numbers}
       ·   ───────
       ╰────
      help: keep one of the two

    1 problem found
    ");
}

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
      × the axis `mull` is neither a param of `affine` nor an axis of an input, so that all cells would be the
      │ same
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
      × the value `3` stands twice in the axis `mul`
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

#[test]
fn an_alias_without_an_anchor() {
    assert_snapshot!(told("nodes:\n  a: *nowhere\n"), @r"
      × this alias has no anchor before it
       ╭─[toy.yaml:2:6]
     2 │   a: *nowhere
       ·      ─
       ╰────
      help: write `&name` before what it should repeat

    1 problem found
    ");
}

#[test]
fn a_bracket_that_is_not_closed() {
    assert_snapshot!(told("nodes:\n  a: {kind: numbers\n  b: 1\n"), @r"
      × this is not YAML that can be read: while parsing a flow mapping, did not find expected ',' or '}'
       ╭─[toy.yaml:3:4]
     3 │   b: 1
       ·    ─
       ╰────
      help: check the indentation, quotes and brackets on this line and the one above

    1 problem found
    ");
}

#[test]
fn a_profile_with_an_unknown_node() {
    assert_snapshot!(told("profiles: {tiny: {number.count: 2}}\nnodes:\n  numbers: {kind: numbers}\n"), @r"
      × there is no node `number`
       ╭─[toy.yaml:1:19]
     1 │ profiles: {tiny: {number.count: 2}}
       ·                   ────────────
       ╰────
      help: did you mean `numbers`?

    1 problem found
    ");
}

#[test]
fn a_profile_without_a_param() {
    assert_snapshot!(told("profiles: {tiny: {numbers: 2}}\nnodes:\n  numbers: {kind: numbers}\n"), @r"
      × `numbers` is not `node.param`
       ╭─[toy.yaml:1:19]
     1 │ profiles: {tiny: {numbers: 2}}
       ·                   ───────
       ╰────
      help: write for example `scenes.pool`

    1 problem found
    ");
}

#[test]
fn an_unknown_profile() {
    assert_snapshot!(told_with(NUMBERS, &Options { profile: Some("tiny".into()), ..Options::default() }), @r"
      × there is no profile `tiny`
      help: there are no profiles here

    1 problem found
    ");
}

#[test]
fn a_set_of_the_wrong_type() {
    assert_snapshot!(told_of_set("numbers.count=x"), @r"
      × expected a whole number from 0 to 100000, found a text
       ╭─[--set:1:15]
     1 │ numbers.count=x
       ·               ─
       ╰────
      help: write a number

    1 problem found
    ");
}

#[test]
fn a_set_of_an_unknown_param() {
    assert_snapshot!(told_of_set("numbers.cont=3"), @r"
      × unknown param `cont`
       ╭─[--set:1:1]
     1 │ numbers.cont=3
       · ────────────
       ╰────
      help: did you mean `count`?

    1 problem found
    ");
}

#[test]
fn a_set_of_an_unknown_node() {
    assert_snapshot!(told_of_set("nmbers.count=3"), @r"
      × there is no node `nmbers`
       ╭─[--set:1:1]
     1 │ nmbers.count=3
       · ────────────
       ╰────
      help: did you mean `numbers`?

    1 problem found
    ");
}

#[test]
fn a_set_without_a_value() {
    assert_snapshot!(told_of_set("numbers.count"), @r"
      × `numbers.count` sets nothing
       ╭─[--set:1:1]
     1 │ numbers.count
       · ─────────────
       ╰────
      help: write `--set node.param=value`

    1 problem found
    ");
}

#[test]
fn a_choice_that_is_none() {
    assert_snapshot!(told_of("  b: {kind: affine, inputs: {in: numbers}, params: {rounding: ten}}"), @r"
      × `ten` is not one of the choices
       ╭─[toy.yaml:3:63]
     3 │   b: {kind: affine, inputs: {in: numbers}, params: {rounding: ten}}
       ·                                                               ───
       ╰────
      help: did you mean `tens`?

    1 problem found
    ");
}

#[test]
fn what_only_the_kind_can_check() {
    assert_snapshot!(told_of("  b: {kind: affine, inputs: {in: numbers}, params: {list: [3, 1]}}"), @r"
      × the list ends before it begins
       ╭─[toy.yaml:3:63]
     3 │   b: {kind: affine, inputs: {in: numbers}, params: {list: [3, 1]}}
       ·                                                               ─
       ╰────
      help: swap the two

    1 problem found
    ");
}

#[test]
fn a_list_that_is_too_short() {
    assert_snapshot!(told_of("  b: {kind: affine, inputs: {in: numbers}, params: {list: [3]}}"), @r"
      × a list of 1 items
       ╭─[toy.yaml:3:59]
     3 │   b: {kind: affine, inputs: {in: numbers}, params: {list: [3]}}
       ·                                                           ─
       ╰────
      help: give exactly 2

    1 problem found
    ");
}

#[test]
fn an_unknown_target() {
    assert_snapshot!(told_of("targets: [total]"), @r"
      × there is no node `total`
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

#[test]
fn every_problem_at_once() {
    assert_snapshot!(told("\
pipeline: demo
seed: one
nodes:
  numbers: {kind: numbrs, params: {count: 3}}
  scaled:
    kind: affine
    inputs: {in: numbers.out, of: numbers}
    params: {mul: two, add: 5000, pda: 1}
  total: {kind: total, inputs: {in: scald}}
"), @r"
      × the seed must be a whole number from 0, this is a text
       ╭─[toy.yaml:2:7]
     2 │ seed: one
       ·       ───
       ╰────
      help: write `seed: 7`

      × there is no kind `numbrs`
       ╭─[toy.yaml:4:19]
     4 │   numbers: {kind: numbrs, params: {count: 3}}
       ·                   ──────
       ╰────
      help: did you mean `numbers`?

      × `affine` has no input `of`
       ╭─[toy.yaml:7:31]
     7 │     inputs: {in: numbers.out, of: numbers}
       ·                               ──
       ╰────
      help: inputs: `in`

      × expected a whole number, found a text
       ╭─[toy.yaml:8:19]
     8 │     params: {mul: two, add: 5000, pda: 1}
       ·                   ───
       ╰────
      help: write a number

      × 5000 is out of range
       ╭─[toy.yaml:8:29]
     8 │     params: {mul: two, add: 5000, pda: 1}
       ·                             ────
       ╰────
      help: give a number from -1000 to 1000

      × unknown param `pda`
       ╭─[toy.yaml:8:35]
     8 │     params: {mul: two, add: 5000, pda: 1}
       ·                                   ───
       ╰────
      help: did you mean `pad`?

      × there is no node `scald`
       ╭─[toy.yaml:9:37]
     9 │   total: {kind: total, inputs: {in: scald}}
       ·                                     ─────
       ╰────
      help: did you mean `scaled`?

    7 problems found
    ");
}
