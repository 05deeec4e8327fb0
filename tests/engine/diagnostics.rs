//! What people are told of a pipeline that is wrong: what is so, where, and what to do.

mod matrices;
mod params;
mod text;
mod wiring;

use crate::support::registry;
use insta::assert_snapshot;
use tauflow::pipeline::{self, Options};

/// A pipeline that is fine; tests add to it.
const NUMBERS: &str = "nodes:\n  numbers: {kind: numbers}\n";

/// What is told of a pipeline with options.
pub fn told_with(text: &str, options: &Options) -> String {
    pipeline::resolve_text("toy.yaml", text, &registry(), options).expect_err("it has problems").render(false)
}

/// What is told of a pipeline.
pub fn told(text: &str) -> String {
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
      × the seed must be a whole number from 0, found a text
       ╭─[toy.yaml:2:7]
     2 │ seed: one
       ·       ───
       ╰────
      help: write `seed: 7`

      × unknown kind `numbrs`
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

      × unknown node `scald`
       ╭─[toy.yaml:9:37]
     9 │   total: {kind: total, inputs: {in: scald}}
       ·                                     ─────
       ╰────
      help: did you mean `scaled`?

    7 problems found
    ");
}
