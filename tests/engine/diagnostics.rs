use crate::support::registry;
use tauflow::pipeline::{self, Options};
fn problems(text: &str, options: &Options) -> String {
    pipeline::resolve_text("toy.yaml", text, &registry(), options).expect_err("it has problems").render(false)
}
#[test]
fn show() {
    let d = Options::default;
    let n = "nodes:\n  numbers: {kind: numbers}\n";
    let sets = |s: &str| Options { sets: vec![s.into()], ..Options::default() };
    for (text, options) in [
        ("pipelin: x\nnodes:\n  a: {kind: numbers}\n".to_owned(), d()),
        ("nodes:\n  a: {kind: numbers, parms: {count: 3}}\n".to_owned(), d()),
        ("nodes:\n  a:\n    kind: numbers\n    params: {cuont: 3}\n".to_owned(), d()),
        ("nodes:\n  a: {kind: numbers, params: {count: many}}\n".to_owned(), d()),
        ("nodes:\n  a: {kind: numbers, params: {count: \"7\"}}\n".to_owned(), d()),
        (format!("{n}  b: {{kind: affine}}\n"), d()),
        (format!("{n}  b: {{kind: affine, inputs: {{in: c}}}}\n  c: {{kind: round, inputs: {{in: b}}}}\n"), d()),
        (format!("{n}  b: {{kind: affine, inputs: {{in: b}}}}\n"), d()),
        (format!("{n}  b:\n    kind: affine\n    inputs: {{in: numbers}}\n    params: {{add: 2000}}\n"), d()),
        (format!("{n}  b: {{kind: affin, inputs: {{in: numbers}}}}\n"), d()),
        (format!("{n}  b: {{kind: affine, inputs: {{in: numbers.ot}}}}\n"), d()),
        (format!("{n}  b: {{kind: affine, inputs: {{on: numbers}}}}\n"), d()),
        (format!("{n}  b: {{kind: affine, inputs: {{in: number}}}}\n"), d()),
        (format!("{n}  t: {{kind: total, inputs: {{in: numbers}}}}\n  b: {{kind: affine, inputs: {{in: t.page}}}}\n"), d()),
        (format!("{n}  numbers: {{kind: numbers}}\n"), d()),
        (format!("{n}  b: {{kind: affine, matrix: {{mul: 3}}, inputs: {{in: numbers}}}}\n"), d()),
        (format!("{n}  b: {{kind: affine, matrix: {{mull: [3]}}, inputs: {{in: numbers}}}}\n"), d()),
        (format!("{n}  b: {{kind: affine, matrix: {{mul: [3, 3]}}, inputs: {{in: numbers}}}}\n"), d()),
        (format!("{n}  b: {{kind: affine, matrix: {{mul: [3, 0]}}, inputs: {{in: numbers}}}}\n"), d()),
        (format!("{n}  b: {{kind: affine, matrix: {{mul: [2, 3]}}, inputs: {{in: numbers}}}}\n  c: {{kind: total, inputs: {{in: \"b[mul=4]\"}}}}\n"), d()),
        ("nodes:\n  a: *nowhere\n".to_owned(), d()),
        ("nodes:\n  a: {kind: numbers\n  b: 1\n".to_owned(), d()),
        (format!("profiles: {{tiny: {{number.count: 2}}}}\n{n}"), d()),
        (format!("profiles: {{tiny: {{numbers: 2}}}}\n{n}"), d()),
        (n.to_owned(), Options { profile: Some("tiny".into()), ..d() }),
        (n.to_owned(), sets("numbers.count=x")),
        (n.to_owned(), sets("numbers.cont=3")),
        (n.to_owned(), sets("nmbers.count=3")),
        (n.to_owned(), sets("numbers.count")),
        (format!("{n}  b: {{kind: affine, inputs: {{in: numbers}}, params: {{rounding: ten}}}}\n"), d()),
        (format!("{n}  b: {{kind: affine, inputs: {{in: numbers}}, params: {{list: [3, 1]}}}}\n"), d()),
        (format!("{n}  b: {{kind: affine, inputs: {{in: numbers}}, params: {{list: [3]}}}}\n"), d()),
        (format!("{n}targets: [total]\n"), d()),
        (n.to_owned(), Options { targets: vec!["numbers.x".into()], ..d() }),
        ("seed: x\nnodes: {}\n".to_owned(), d()),
        ("seed: -1\nnodes:\n  a: {kind: numbers}\n  b: {}\n".to_owned(), d()),
        ("pipeline: demo\nseed: one\nnodes:\n  numbers: {kind: numbrs, params: {count: 3}}\n  scaled:\n    kind: affine\n    inputs: {in: numbers.out, of: numbers}\n    params: {mul: two, add: 5000, pda: 1}\n  total: {kind: total, inputs: {in: scald}}\n".to_owned(), d()),
    ] {
        println!("=====\n{text}-----\n{}", problems(&text, &options));
    }
}
