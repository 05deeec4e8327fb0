//! Keys, kinds and the text itself.

use super::{told, told_of};
use insta::assert_snapshot;

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
fn a_key_that_stands_twice() {
    assert_snapshot!(told_of("  numbers: {kind: numbers}"), @r"
      × the key `numbers` occurs twice in one map
       ╭─[toy.yaml:3:3]
     3 │   numbers: {kind: numbers}
       ·   ───────
       ╰────
      help: keep one of the two

    1 problem found
    ");
}

#[test]
fn an_unknown_kind() {
    assert_snapshot!(told_of("  b: {kind: affin, inputs: {in: numbers}}"), @r"
      × unknown kind `affin`
       ╭─[toy.yaml:3:13]
     3 │   b: {kind: affin, inputs: {in: numbers}}
       ·             ─────
       ╰────
      help: did you mean `affine`?

    1 problem found
    ");
}

#[test]
fn an_alias_without_an_anchor() {
    assert_snapshot!(told("nodes:\n  a: *nowhere\n"), @r"
      × unknown alias
       ╭─[toy.yaml:2:6]
     2 │   a: *nowhere
       ·      ─
       ╰────
      help: mark the value to repeat with `&name`

    1 problem found
    ");
}

#[test]
fn a_bracket_that_is_not_closed() {
    assert_snapshot!(told("nodes:\n  a: {kind: numbers\n  b: 1\n"), @r"
      × invalid YAML: while parsing a flow mapping, did not find expected ',' or '}'
       ╭─[toy.yaml:3:4]
     3 │   b: 1
       ·    ─
       ╰────
      help: check the indentation, quotes and brackets on this line and the one above

    1 problem found
    ");
}
