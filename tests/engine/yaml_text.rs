//! What people are told of text that YAML allows but nobody should write, of text that is no YAML, and of files that
//! are none. Each message stands in `snapshots/`, and each must name a place and a remedy.

use crate::{diagnostics::told, support::registry, validator::problems};
use insta::assert_snapshot;
use std::{fs, time::Instant};
use tauflow::pipeline::{self, Options, schema};

/// Texts that are wrong in ways that only reading them shows.
fn bad_texts() -> Vec<(&'static str, String)> {
    let laughs: String =
        (1..12).map(|n| format!("l{n}: &l{n} [{}]\n", vec![format!("*l{}", n - 1); 10].join(", "))).collect();
    let own = |name, text: &str| (name, text.to_owned());
    vec![
        own("a_tab_as_indentation", "nodes:\n\ta: {kind: numbers}\n"),
        ("a_billion_laughs", format!("l0: &l0 ha\n{laughs}nodes: *l11\n")),
        ("a_thousand_brackets", format!("nodes: {}{}\n", "[".repeat(5000), "]".repeat(5000))),
        ("fifty_brackets", format!("nodes: {}{}\n", "[".repeat(50), "]".repeat(50))),
        own(
            "a_number_too_large_for_any_type",
            "nodes:\n  a: {kind: numbers, params: {count: 123456789012345678901234567890}}\n",
        ),
        own("a_number_that_is_none", "nodes:\n  a: {kind: numbers, params: {offset: .nan}}\n"),
        own("an_infinite_number", "nodes:\n  a: {kind: numbers, params: {offset: .inf}}\n"),
        own("a_fraction_where_a_count_goes", "nodes:\n  a: {kind: numbers, params: {count: 2.5}}\n"),
        own("a_negative_count", "nodes:\n  a: {kind: numbers, params: {count: -1}}\n"),
        own("an_empty_file", ""),
        own("a_file_of_comments", "# nothing yet\n"),
        own("a_list_at_the_top", "- nodes\n- more\n"),
        own("a_text_at_the_top", "nodes\n"),
        own("nodes_as_a_list", "nodes:\n  - {kind: numbers}\n"),
        own("no_nodes", "pipeline: x\n"),
        own("a_node_without_a_kind", "nodes:\n  a: {params: {count: 3}}\n"),
        own("a_node_that_is_a_text", "nodes:\n  a: numbers\n"),
        own("a_kind_that_is_a_number", "nodes:\n  a: {kind: 3}\n"),
        own("params_as_a_list", "nodes:\n  a: {kind: numbers, params: [3]}\n"),
        own("inputs_as_a_text", "nodes:\n  a: {kind: numbers}\n  b: {kind: affine, inputs: a}\n"),
        own("an_input_that_is_a_number", "nodes:\n  a: {kind: numbers}\n  b: {kind: affine, inputs: {in: 3}}\n"),
        own("a_key_that_is_a_list", "nodes:\n  ? [a, b]\n  : {kind: numbers}\n"),
        own("two_documents", "nodes:\n  a: {kind: numbers}\n---\nnodes:\n  b: {kind: numbers}\n"),
        own("a_text_without_an_end", "nodes:\n  a: {kind: \"numbers}\n"),
        own("indentation_that_steps_back_halfway", "nodes:\n    a:\n      kind: numbers\n   b: 1\n"),
        own("a_tag_that_asks_for_code", "nodes: !!python/object:os.system {a: b}\n"),
        own("a_control_character", "nodes:\n  a: {kind: num\u{1}bers}\n"),
        own("a_name_that_cannot_be_a_folder", "pipeline: ../../etc\nnodes:\n  a: {kind: numbers}\n"),
        own("a_node_name_with_a_dot", "nodes:\n  a.b: {kind: numbers}\n"),
        own("a_seed_below_0", "seed: -1\nnodes:\n  a: {kind: numbers}\n"),
        own("a_profile_that_is_a_list", "profiles: {x: [1]}\nnodes:\n  a: {kind: numbers}\n"),
        own("a_matrix_without_values", "nodes:\n  a: {kind: numbers, matrix: {count: []}}\n"),
        own("an_axis_value_of_the_wrong_type", "nodes:\n  a: {kind: numbers, matrix: {count: [many]}}\n"),
        own(
            "an_input_that_is_an_unclosed_selection",
            "nodes:\n  a: {kind: numbers}\n  b: {kind: affine, inputs: {in: 'a[x=1'}}\n",
        ),
    ]
}

#[test]
fn each_mistake_has_a_place_and_a_remedy() {
    for (name, text) in bad_texts() {
        let start = Instant::now();
        let told = told(&text);
        assert!(start.elapsed().as_secs_f64() < 2.0, "{name} takes long");
        assert!(told.contains("help: "), "{name} has no remedy: {told}");
        let at_place =
            told.contains("toy.yaml:") || ["an_empty_file", "a_file_of_comments", "no_nodes"].contains(&name);
        assert!(at_place, "{name} has no place: {told}");
        assert!(told.len() < 4000, "{name} says too much: {told}");
        assert_snapshot!(name, told);
    }
}

#[test]
fn a_file_that_is_no_text_or_is_not_there() {
    let folder = tempfile::tempdir().expect("a folder");
    let told = |bytes: Option<&[u8]>| {
        let path = folder.path().join("toy.yaml");
        let _ = fs::remove_file(&path);
        if let Some(bytes) = bytes {
            fs::write(&path, bytes).expect("writable");
        }
        let told =
            pipeline::resolve(&path, &registry(), &Options::default()).expect_err("it has problems").render(false);
        told.replace(&folder.path().display().to_string(), "FOLDER")
    };
    assert_snapshot!("a_file_that_is_not_utf_8", told(Some(b"nodes:\n  a: {kind: \xff\xfe}\n")));
    assert_snapshot!("a_file_of_utf_16", told(Some(b"\xff\xfen\0o\0d\0e\0s\0")));
    assert_snapshot!("a_file_that_is_not_there", told(None));
}

#[test]
fn what_yaml_offers_works() {
    let text = "\
# anchors, merges of none, quoted and folded texts, Windows line ends
pipeline: 'it''s-fine'
nodes:
  a: &a {kind: numbers, params: {count: 0x03}}
  b: *a
  c:\r
    kind: total\r
    inputs: {in: [a]}\r
    params:
      title: >-
        two
        lines
";
    let text = text.replace("it''s-fine", "fine");
    let pipeline = pipeline::resolve_text("toy.yaml", &text, &registry(), &Options::default());
    let pipeline = pipeline.unwrap_or_else(|problems| panic!("{}", problems.render(false)));
    assert_eq!(pipeline.nodes.len(), 3);
    let params =
        |node: &str| &pipeline.cells[pipeline.nodes[pipeline.node(node).expect("it is there")].cells.start].params;
    assert_eq!((&params("a")["count"], &params("b")["count"]), (&3.into(), &3.into()));
    assert_eq!(params("c")["title"], "two lines");
}

#[test]
fn an_editor_that_knows_the_schema_underlines_them_too() {
    let schema = schema::schema(&registry());
    // What only the connections, or the text, show is beyond a schema.
    let beyond = [
        "a_tab_as_indentation",
        "a_billion_laughs",
        "a_thousand_brackets",
        "fifty_brackets",
        "a_number_that_is_none",
        "an_infinite_number",
        "a_key_that_is_a_list",
        "an_axis_value_of_the_wrong_type",
        "an_input_that_is_an_unclosed_selection",
        "two_documents",
        "a_text_without_an_end",
        "indentation_that_steps_back_halfway",
        "a_tag_that_asks_for_code",
        "a_control_character",
    ];
    for (name, text) in bad_texts().into_iter().filter(|(name, _)| !beyond.contains(name)) {
        let Ok(value) = serde_saphyr::from_str::<serde_json::Value>(&text) else {
            panic!("{name} is no YAML, and belongs to what is beyond a schema");
        };
        assert!(!problems(&schema, &value).is_empty(), "the schema accepts {name}:\n{text}");
    }
    let good = "nodes:\n  a: {kind: numbers, params: {count: 3}}\n  \
                b: {kind: affine, inputs: {in: a}, matrix: {mul: [2, 3]}}\n";
    assert_eq!(problems(&schema, &serde_saphyr::from_str(good).expect("YAML")), [""; 0]);
}
