//! Params, and what profiles and the command line make of them.

use super::{NUMBERS, told, told_of, told_of_set, told_with};
use insta::assert_snapshot;
use tauflow::pipeline::Options;

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
      help: remove the quotes

    1 problem found
    "#);
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
fn a_profile_with_an_unknown_node() {
    assert_snapshot!(told("profiles: {tiny: {number.count: 2}}\nnodes:\n  numbers: {kind: numbers}\n"), @r"
      × unknown node `number`
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
      × unknown profile `tiny`
      help: there are no profiles

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
      × unknown node `nmbers`
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
      × `numbers.count` is not an assignment
       ╭─[--set:1:1]
     1 │ numbers.count
       · ─────────────
       ╰────
      help: write `--set node.param=value`

    1 problem found
    ");
}
