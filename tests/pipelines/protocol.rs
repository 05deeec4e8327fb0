//! What the pipelines of this project ask for.

use crate::support::root;
use serde_json::{Value, json};
use std::{fs, path::Path};
use tauflow::{
    pipeline::{self, Options, Pipeline},
    registry,
};

fn resolve(file: &Path, profile: Option<&str>) -> Pipeline {
    let options = Options { profile: profile.map(str::to_owned), ..Options::default() };
    match pipeline::resolve(file, &registry::registry(), &options) {
        Ok(pipeline) => pipeline,
        Err(problems) => panic!("{} with profile {profile:?}: {problems}", file.display()),
    }
}

fn named(name: &str) -> Pipeline {
    resolve(&root().join("pipelines").join(name), None)
}

/// The params of a node's cells.
fn params<'a>(pipeline: &'a Pipeline, node: &str) -> Vec<&'a Value> {
    let node = pipeline.node(node).expect("the node is there");
    pipeline.nodes[node].cells.clone().map(|cell| &pipeline.cells[cell].params).collect()
}

#[test]
fn every_pipeline_resolves_with_every_profile() {
    let mut resolved = 0;
    for entry in fs::read_dir(root().join("pipelines")).expect("the folder is there") {
        let path = entry.expect("can be read").path();
        if path.extension().is_none_or(|extension| extension != "yaml") {
            continue; // a lock file
        }
        let text = fs::read_to_string(&path).expect("a pipeline");
        let file: Value = serde_saphyr::from_str(&text).expect("YAML");
        resolve(&path, None);
        resolved += 1;
        for (name, _) in file["profiles"].as_object().into_iter().flatten() {
            resolve(&path, Some(name));
            resolved += 1;
        }
    }
    assert!(resolved >= 10, "{resolved}");
}

#[test]
fn the_benchmark_is_the_papers_protocol() {
    let pipeline = named("benchmark.yaml");
    let is = |node: &str, pointer: &str, wanted: Value| {
        for params in params(&pipeline, node) {
            assert_eq!(params.pointer(pointer), Some(&wanted), "{node}{pointer}");
        }
    };
    is("scenes", "/pool", json!(30_000));
    is("scenes", "/regimes", json!(["L0", "L1", "L2", "L3"]));
    is("previews", "/rungs", json!([32]));
    is("sampling", "/train", json!(5000));
    is("sampling", "/test", json!(1200));
    for ladders in ["train_ladders", "test_ladders"] {
        is(ladders, "/rungs", json!([1, 2, 4, 8, 16, 32, 64, 128, 256, 512]));
        is(ladders, "/resolution", json!([256, 256]));
    }
    is("solvers", "/steps", json!(60_000));
    for (param, value) in [("space", "linear"), ("output", "values"), ("loss", "squared"), ("features", "plain")] {
        is("solvers", &format!("/{param}"), json!(value));
    }
    is("solvers", "/rung_exponent", json!(0.0));
    is("solvers", "/unknown_counts", json!(0.0));
    is("bridge_ladders", "/rungs", json!([1, 2, 3, 4, 5, 6, 7, 8, 9, 10]));
    is("bridge_scenes", "/test", json!(10));
    // All eight cells in the paper's setting and in ours, which differ in nothing else.
    assert_eq!(params(&pipeline, "solvers").len(), 8);
    let shared = |params: &Value| {
        let mut params = params.as_object().expect("fields").clone();
        params.retain(|name, _| !["space", "output", "features"].contains(&name.as_str()));
        params
    };
    let cells = |node: &str| params(&pipeline, node).into_iter().map(shared).collect::<Vec<_>>();
    assert_eq!(cells("solvers"), cells("own_solvers"));
    is("own_solvers", "/output", json!("means"));
    for cell in params(&pipeline, "refined") {
        assert_eq!((&cell["nfe"], &cell["from"]), (&json!([1, 2, 9, 20, 50]), &json!(1)));
    }
}

#[test]
fn the_bridge_retrains_nothing() {
    let (quickstart, bridge) = (named("quickstart.yaml"), named("bridge.yaml"));
    assert_eq!(quickstart.seed, bridge.seed);
    // Same seed, same nodes, same params: the very same actions, found in the cache.
    for node in quickstart.nodes.iter().filter(|n| n.name != "report") {
        assert_eq!(params(&quickstart, &node.name), params(&bridge, &node.name), "{}", node.name);
    }
}
