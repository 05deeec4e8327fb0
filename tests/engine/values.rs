//! Named values and matrices like another node's: what they stand for, and what people are told of wrong ones.

use crate::{
    diagnostics::{told, told_with},
    support::{Workshop, registry, resolve},
};
use insta::assert_snapshot;
use serde_json::{Value, json};
use std::fs;
use tauflow::{
    engine::RunOptions,
    pipeline::{self, Options, Pipeline},
};

fn with(text: &str, profile: Option<&str>, sets: &[&str]) -> Pipeline {
    let sets = sets.iter().map(|set| (*set).to_owned()).collect();
    let options = Options { profile: profile.map(str::to_owned), sets, ..Options::default() };
    pipeline::resolve_text("toy.yaml", text, &registry(), &options).unwrap_or_else(|e| panic!("{e}"))
}

/// The params of a node's first cell.
fn params<'a>(pipeline: &'a Pipeline, node: &str) -> &'a Value {
    &pipeline.cells[pipeline.nodes[pipeline.node(node).expect("it is there")].cells.start].params
}

const LITERAL: &str = "
seed: 5
nodes:
  numbers: {kind: numbers, params: {count: 3, offset: 1}}
  scaled: {kind: affine, matrix: {mul: [2, 3]}, inputs: {in: numbers}, params: {add: 4}}
  total: {kind: total, inputs: {in: [scaled, numbers]}, params: {title: $5 is no name}}
";

/// The same with values wherever they may stand.
const NAMED: &str = "
seed: $seed
values:
  seed: 5
  three: 3
  factors: [2, $three]
  numbers: {count: $three, offset: 1}
  four: 4
  read: [scaled, numbers]
  title: $5 is no name
  stored: false
nodes:
  numbers: {kind: numbers, params: $numbers}
  scaled: {kind: affine, matrix: {mul: $factors}, inputs: {in: numbers}, params: {add: $four}, transient: $stored}
  total: {kind: total, inputs: {in: $read}, params: {title: $title}}
";

#[test]
fn a_value_in_place_of_a_literal_runs_nothing_again() {
    let shop = Workshop::new();
    let ran = shop.run(LITERAL);
    assert!(ran.summary.failures.is_empty() && !ran.ran().is_empty(), "{:#?}", ran.summary.failures);
    assert_eq!(shop.run(NAMED).ran(), [].into());
    let (literal, named) = (resolve(LITERAL), resolve(NAMED));
    for (a, b) in literal.cells.iter().zip(&named.cells) {
        assert_eq!((&a.text, &a.params, &a.inputs), (&b.text, &b.params, &b.inputs));
    }
    assert_eq!((literal.seed, literal.cells.len()), (named.seed, named.cells.len()));
    // And another value is another literal.
    let more = with(NAMED, None, &["values.three=4"]);
    assert_eq!((params(&more, "numbers")["count"].clone(), more.nodes[1].axes[0].1[1].as_str()), (json!(4), "4"));
}

#[test]
fn a_doubled_dollar_is_a_dollar() {
    let text = "
values: {a: x}
nodes:
  numbers: {kind: numbers}
  t: {kind: total, inputs: {in: numbers}, params: {title: TITLE}}
";
    for (written, meant) in [("$a", "x"), ("$$a", "$a"), ("$$$a", "$$a"), ("'${a}'", "${a}"), ("x$a", "x$a")] {
        // A value must be used.
        let text = text.replace("TITLE", written).replace("numbers}\n", "numbers, params: {count: $n}}\n");
        let text = text.replace("{a: x}", if written == "$a" { "{a: x, n: 1}" } else { "{n: 1}" });
        assert_eq!(params(&resolve(&text), "t")["title"], meant, "{written}");
    }
}

#[test]
fn overrides_win_in_order() {
    let text = "
values: {count: 3, add: {x: 1}}
profiles:
  tiny: {values.count: 2, scaled.add: $count}
  odd: {values.add.x: 7}
nodes:
  numbers: {kind: numbers, params: {count: $count}}
  scaled: {kind: affine, inputs: {in: numbers}, params: {add: 1}}
  total: {kind: total, inputs: {in: numbers}, params: {title: $title}}
";
    let text = text.replace("add: {x: 1}", "title: plain").replace("values.add.x: 7", "values.title: $$odd");
    let of = |profile, sets: &[&str]| {
        let pipeline = with(&text, profile, sets);
        let [count, add] = [("numbers", "count"), ("scaled", "add")]
            .map(|(node, param)| params(&pipeline, node)[param].as_i64().expect("a number"));
        (count, add, params(&pipeline, "total")["title"].as_str().expect("a text").to_owned())
    };
    assert_eq!(of(None, &[]), (3, 1, "plain".into()));
    assert_eq!(of(Some("tiny"), &[]), (2, 2, "plain".into()));
    assert_eq!(of(Some("odd"), &[]), (3, 1, "$odd".into()));
    assert_eq!(of(Some("tiny"), &["values.count=4"]), (4, 4, "plain".into()));
    assert_eq!(of(Some("tiny"), &["values.count=4", "numbers.count=5", "scaled.add=$count"]), (5, 4, "plain".into()));
    // A part of a value that is a map.
    let map = "values: {p: {count: 3, offset: 1}}\nnodes:\n  numbers: {kind: numbers, params: $p}\n";
    let pipeline = with(map, None, &["values.p.count=9"]);
    assert_eq!(
        (&params(&pipeline, "numbers")["count"], &params(&pipeline, "numbers")["offset"]),
        (&json!(9), &json!(1))
    );
}

#[test]
fn the_including_file_wins() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("writable");
    let resolve = |name: &str| pipeline::resolve(&folder.path().join(name), &registry(), &Options::default());
    write("inner.yaml", "values: {count: 3}\nnodes:\n  numbers: {kind: numbers, params: {count: $count}}\n");
    write(
        "outer.yaml",
        "include: [inner.yaml]\nvalues: {count: 4}\nnodes:\n  more: {kind: numbers, params: {count: $count}}\n",
    );
    write("outermost.yaml", "nodes: {}\nvalues: {count: 6}\ninclude: [inner.yaml, outer.yaml]\n");
    for (file, count) in [("inner.yaml", 3), ("outer.yaml", 4), ("outermost.yaml", 6)] {
        let pipeline = resolve(file).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(params(&pipeline, "numbers")["count"], count, "{file}");
    }
    // Of two files side by side neither wins.
    write("aside.yaml", "values: {count: 5}\nnodes:\n  aside: {kind: numbers, params: {count: $count}}\n");
    write("both.yaml", "include: [inner.yaml, aside.yaml]\nnodes: {}\n");
    let told = resolve("both.yaml").expect_err("both have it").render(false);
    assert_snapshot!(told.replace(&folder.path().display().to_string(), "FOLDER"));
}

#[test]
fn an_unknown_value() {
    assert_snapshot!(told("values: {last_rung: 3}\nnodes:\n  a: {kind: numbers, params: {count: $last_rang}}\n"));
    assert_snapshot!(told("nodes:\n  a: {kind: numbers, params: {count: $HOME}}\n"));
}

#[test]
fn a_value_of_the_wrong_type() {
    assert_snapshot!(told("values: {count: many}\nnodes:\n  a: {kind: numbers, params: {count: $count}}\n"));
    let axis = "\
values:
  factors: [2, 0]
nodes:
  a: {kind: numbers}
  b: {kind: affine, inputs: {in: a}, matrix: {mul: $factors}}
";
    assert_snapshot!(told(axis));
    let set = Options { sets: vec!["values.count=x".into()], ..Options::default() };
    assert_snapshot!(told_with("values: {count: 3}\nnodes:\n  a: {kind: numbers, params: {count: $count}}\n", &set));
}

#[test]
fn values_in_a_circle() {
    assert_snapshot!(told("values:\n  a: [$b]\n  b: {c: $a}\nnodes:\n  n: {kind: numbers, params: {count: $a}}\n"));
}

#[test]
fn a_value_that_nothing_uses() {
    assert_snapshot!(told("values: {count: 3, cuont: 4}\nnodes:\n  a: {kind: numbers, params: {count: $count}}\n"));
}

#[test]
fn where_no_value_may_stand() {
    assert_snapshot!(told("values: {kind: numbers}\nnodes:\n  values: {kind: $kind}\n"));
}

#[test]
fn an_override_of_an_unknown_value() {
    let text =
        "values: {count: 3}\nprofiles: {x: {values.cuont: 4}}\nnodes:\n  a: {kind: numbers, params: {count: $count}}\n";
    assert_snapshot!(told(text));
}

#[test]
fn values_cannot_blow_up() {
    let layers: String =
        (1..16).map(|n| format!("  v{n}: [{}]\n", vec![format!("$v{}", n - 1); 30].join(", "))).collect();
    let text = format!("values:\n  v0: 1\n{layers}nodes:\n  a: {{kind: numbers, params: {{count: $v15}}}}\n");
    assert!(told(&text).contains("more than 200000 values are substituted for names"));
    let chain: String = (1..9000).map(|n| format!("  v{n}: $v{}\n", n - 1)).collect();
    for order in [chain.clone(), chain.lines().rev().map(|line| format!("{line}\n")).collect()] {
        let text = format!("values:\n  v0: 1\n{order}nodes:\n  a: {{kind: numbers, params: {{count: $v8999}}}}\n");
        assert!(told(&text).contains("values refer to each other more than 16 levels deep"));
    }
    let deep = format!("{}$x{}", "[".repeat(40), "]".repeat(40));
    let text = format!(
        "values:\n  x: {}1{}\n  y: {deep}\nnodes:\n  a: {{kind: numbers, params: {{count: $y}}}}\n",
        "[".repeat(40),
        "]".repeat(40)
    );
    assert!(told(&text).contains("nested more than 48 levels deep"));
}

#[test]
fn long_texts_are_neither_put_in_nor_copied_to_cells_without_end() {
    let long = "x".repeat(60_000);
    let uses = vec!["$v"; 10_000].join(", ");
    let text =
        format!("values:\n  v: {long}\n  many: [{uses}]\nnodes:\n  a: {{kind: numbers, params: {{count: $many}}}}\n");
    assert!(told(&text).contains("more than 16 MiB of text are substituted for names"));
    let numbers = (1..5000).map(|n| n.to_string()).collect::<Vec<_>>().join(", ");
    let text = format!("nodes:\n  a: {{kind: numbers, matrix: {{count: [{numbers}]}}, params: {{other: {long}}}}}\n");
    assert!(told(&text).contains("4999 cells with params of 58 KiB of text each are too many"), "{}", told(&text));
}

#[test]
fn names_that_no_folder_can_have_are_told() {
    let name = "x".repeat(101);
    let text = format!("nodes:\n  {name}: {{kind: numbers, params: {{count: 1}}}}\n");
    assert!(
        told(&text).contains("cannot name a node") && told(&text).contains("at most 100 letters"),
        "{}",
        told(&text)
    );
    let text = |letters: usize| {
        let title = "t".repeat(letters);
        let axes = "mul: [1000000000000000001], fail_from: [9000000000000000001], panic_on: [9000000000000000002]";
        format!(
            "nodes:\n  numbers: {{kind: numbers, params: {{count: 1}}}}\n  scaled: {{kind: affine, inputs: {{in: \
             numbers}}, matrix: {{{axes}}}}}\n  total: {{kind: total, inputs: {{in: scaled}}, matrix: {{{axes}, \
             title: [{title}, b]}}}}\n"
        )
    };
    let long = told(&text(167));
    assert!(long.contains("a folder of results in 256 bytes; at most 255 fit"), "{long}");
    let shop = Workshop::new();
    let options = RunOptions { jobs: 2, out: Some(shop.out()), ..RunOptions::default() };
    assert_eq!(shop.run_with(&text(166), &options, |_, _| {}).summary.failures.len(), 0);
}

const LIKE: &str = "
nodes:
  numbers: {kind: numbers, params: {count: 2, offset: 1}}
  scaled: {kind: affine, matrix: {mul: [2, 3], add: [0, 5]}, inputs: {in: numbers}}
  rounded: {kind: affine, matrix: MATRIX, inputs: {in: scaled}}
  more: {kind: affine, matrix: {like: rounded, pad: [1, 2]}, inputs: {in: rounded}}
";

#[test]
fn a_matrix_like_another_is_that_matrix() {
    let shop = Workshop::new();
    let (written, like) =
        (LIKE.replace("MATRIX", "{mul: [2, 3], add: [0, 5]}"), LIKE.replace("MATRIX", "{like: scaled}"));
    let ran = shop.run(&written);
    assert_eq!((ran.ran()["rounded"], ran.ran()["more"]), (8, 16), "{:#?}", ran.summary.failures);
    assert_eq!(shop.run(&like).ran(), [].into());
    assert_eq!(shop.numbers(&written, "rounded"), shop.numbers(&like, "rounded"));
    let pipeline = resolve(&like);
    let cells: Vec<&str> = pipeline.cells.iter().rev().take(2).map(|cell| cell.text.as_str()).collect();
    assert_eq!(cells, ["mul=3+add=5+pad=2", "mul=3+add=5+pad=1"]);
    // A node may stand before the one that it is like, and an axis that another gave cannot be set.
    let set = Options { sets: vec!["rounded.mul=4".into()], ..Options::default() };
    assert!(told_with(&like, &set).contains("`mul` is an axis of the matrix of `rounded`"));
}

#[test]
fn a_matrix_like_nothing() {
    assert_snapshot!(told(&LIKE.replace("MATRIX", "{like: scald}")));
    assert_snapshot!(told(&LIKE.replace("MATRIX", "{like: numbers}")));
    assert_snapshot!(told(&LIKE.replace("MATRIX", "{like: scaled, mul: [4]}")));
}

#[test]
fn matrices_like_each_other() {
    assert_snapshot!(told(&LIKE.replace("MATRIX", "{like: more}")));
    assert!(told(&LIKE.replace("MATRIX", "{like: rounded}")).contains("rounded -> rounded"));
}

#[test]
fn too_many_cells() {
    let axis = format!("[{}]", (0..1000).map(|n| n.to_string()).collect::<Vec<_>>().join(", "));
    let text = format!(
        "nodes:\n  n: {{kind: numbers}}\n  a:\n    kind: affine\n    inputs: {{in: n}}\n    matrix:\n      \
         mul: {axis}\n      add: {axis}\n      pad: {axis}\n      fail_from: {axis}\n"
    );
    assert!(told(&text).contains("the matrix of `a` has 1000000000000 cells, at most 10000 are allowed"));
    let nodes: String = (0..13)
        .map(|n| {
            format!(
                "  b{n}: {{kind: affine, inputs: {{in: n}}, matrix: {{mul: {axis}, pad: [0, 1, 2, 3, 4, 5, 6, 7]}}}}\n"
            )
        })
        .collect();
    assert!(
        told(&format!("nodes:\n  n: {{kind: numbers}}\n{nodes}"))
            .contains("the nodes have 104001 cells, at most 100000")
    );
    // Each cell would gather all of another node.
    let text = format!(
        "nodes:\n  n: {{kind: numbers}}\n  a: {{kind: affine, inputs: {{in: n}}, matrix: {{add: {axis}, \
         pad: [1, 2]}}}}\n\
         \x20 b: {{kind: affine, inputs: {{in: a}}, matrix: {{mul: {axis}}}}}\n"
    );
    assert!(told(&text).contains("cells have more than 1000000 connections"));
}

#[test]
fn very_many_mistakes_are_told_of_quickly() {
    let keys: String = (0..20_000).map(|n| format!("      cuont{n}: 1\n")).collect();
    let text =
        format!("nodes:\n  n:\n    kind: numbers\n    params:\n{keys}  b: {{kind: affine, inputs: {{in: n}}}}\n");
    let said = told(&text);
    assert!(said.ends_with("\n20000 problems found; the first 50 are shown\n"), "{}", &said[said.len() - 200..]);
    assert!(said.contains("unknown param `cuont49`") && !said.contains("cuont50`"));
    let nodes: String = (0..20_000).map(|n| format!("  a{n}: {{kind: affine, inputs: {{in: a{n}x}}}}\n")).collect();
    let said = told(&format!("nodes:\n{nodes}"));
    assert!(said.contains("did you mean `a0`?") && said.contains("20000 problems found"));
}
