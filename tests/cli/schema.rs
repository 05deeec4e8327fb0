//! `tauflow schema`: a JSON Schema that every pipeline of the repository fits, and that finds what is wrong.

use crate::{Place, files, json, validator::problems};
use serde_json::Value;
use std::fs;

fn schema() -> Value {
    let said = Place::new().tauflow(&["schema"]).ends(0);
    json(&said.out)
}

fn yaml(text: &str) -> Value {
    serde_saphyr::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

#[test]
fn every_pipeline_fits() {
    let schema = schema();
    let mut paths = files("pipelines", "yaml");
    paths.extend(files("src/cli", "yaml"));
    assert!(paths.len() >= 2, "{paths:?}");
    for path in paths {
        let text = fs::read_to_string(&path).expect("the pipeline can be read");
        assert_eq!(problems(&schema, &yaml(&text)), [""; 0], "{}", path.display());
    }
}

#[test]
fn what_is_wrong_does_not_fit() {
    let schema = schema();
    for (text, part) in [
        ("nodse: {}", "/nodse: unknown"),
        ("seed: -1", "/seed: -1 is below 0"),
        ("nodes: { a: { params: {} } }", "/nodes/a: \"kind\" is missing"),
        ("nodes: { a: { kind: no_such } }", "/nodes/a/kind"),
        ("nodes: { a: { kind: scene_generation, params: { poll: 1 } } }", "/nodes/a/params/poll: unknown"),
        ("nodes: { a: { kind: scene_generation, params: { pool: many } } }", "/nodes/a/params/pool: expected"),
        ("nodes: { a: { kind: scene_generation, params: { regimes: [L7] } } }", "/nodes/a/params/regimes/0"),
        ("nodes: { a: { kind: content_signature_split, inputs: { scene: b } } }", "/nodes/a/inputs/scene: unknown"),
    ] {
        let found = problems(&schema, &yaml(text));
        assert!(found.iter().any(|line| line.starts_with(part)), "{text}: {found:#?}");
    }
}

#[test]
fn a_named_value_may_stand_for_every_part_of_a_value() {
    let schema = schema();
    let fits = |text: &str| problems(&schema, &yaml(text));
    for text in [
        "{ seed: $seed, nodes: { a: { kind: scene_generation, params: $params } } }",
        "nodes: { a: { kind: scene_generation, params: { pool: $pool, regimes: [$first, L1], fov: [$least, 60] } } }",
        "nodes: { a: { kind: ladder_rendering, inputs: $inputs, \
         params: { rungs: { dyadic: $last }, resolution: $film } } }",
        "nodes: { a: { kind: ladder_rendering, inputs: { scenes: $scenes }, matrix: { like: b, stream: $streams } } }",
        "nodes: { a: { kind: scene_generation, transient: $kept, matrix: { pool: [1, $pool] } } }",
    ] {
        assert_eq!(fits(text), [""; 0], "{text}");
    }
    for text in ["$$pool", "$", "a$pool", "$1"] {
        let text = format!("nodes: {{ a: {{ kind: scene_generation, params: {{ pool: {text} }} }} }}");
        assert!(!fits(&text).is_empty(), "{text}");
    }
    assert!(!fits("nodes: { a: { kind: $kind } }").is_empty(), "a kind is written out");
}

#[test]
fn hover_docs_are_there() {
    let schema = schema();
    let mut bare = Vec::new();
    for (name, definition) in schema["$defs"].as_object().expect("definitions") {
        for (param, rule) in definition["properties"].as_object().into_iter().flatten() {
            if name.starts_with("params_") && rule["description"].as_str().is_none_or(str::is_empty) {
                bare.push(format!("{name}.{param}"));
            }
        }
    }
    assert_eq!(bare, [""; 0], "params without a description");
}
