//! The guide to a new kind: its page holds the text of the example, and the example runs in a pipeline.

#[path = "../adding_a_kind/image_gamma.rs"]
mod image_gamma;

use crate::root;
use image_gamma::ImageGamma;
use std::{fs, sync::atomic::AtomicBool};
use tauflow::{
    engine::{self, RunOptions},
    ids::PortId,
    kinds::Registry,
    pipeline::{Options, Pipeline, resolve_text},
};
use tauflow_cache::Store;
use tauflow_contract::{Artifact, Blobs, Context, Digest, Handle, KindError, KindRow, MemoKey, NodeKind, Silent};
use tauflow_data::{
    maths::powf,
    records::{PackedScene, Refined},
};

const MANUAL: &str = include_str!("../adding_a_kind/image_gamma.md");
const KIND: &str = include_str!("../adding_a_kind/image_gamma.rs");

/// The row of the example, as a crate has it.
const ROW: &str = "Box::new(KindRow::<ImageGamma>::new())";

/// What comes before the node of the manual.
const BEFORE: &str = "\
pipeline: example
seed: 3
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 2, regimes: [L0], contexts: [open] }
  ladders:
    kind: ladder_rendering
    inputs: { scenes: scenes }
    params: { rungs: { dyadic: 4 }, resolution: [16, 16] }
  gate:
    kind: quality_gate
    inputs: { scenes: scenes, previews: ladders }
    params: { contrast: 0.0 }
  test_set:
    kind: dataset_packing
    inputs: { ladders: ladders, exposure: gate.exposure }
";

fn page() -> String {
    fs::read_to_string(root().join("docs/adding_a_kind.md")).expect("the guide is there")
}

/// The code blocks of a page that begin with this fence.
fn blocks<'a>(page: &'a str, fence: &str, end: &str) -> Vec<&'a str> {
    let open = format!("\n{fence}\n");
    page.split(&open).skip(1).map(|rest| rest.split_once(end).expect("every block ends").0).collect()
}

#[test]
fn the_page_on_adding_a_kind_holds_the_example() {
    let page = page();
    assert_eq!(blocks(&page, "````markdown", "````"), [MANUAL], "the manual differs from its file");
    assert_eq!(blocks(&page, "```rust", "```").join("\n"), KIND, "the Rust blocks in a row differ from the file");
    assert_eq!(blocks(&page, "```text", "```"), [format!("{ROW}\n")], "the row differs from what is run here");
    assert!(include_str!("adding_a_kind.rs").contains(&format!("[{ROW} as Box<dyn NodeKind>]")));
    for place in ["tests/cli/places_of_kinds.rs", "nodes/data/src/records", "docs/ARCHITECTURE.md", "docs/words.md"] {
        assert!(root().join(place).exists(), "{place}");
    }
}

fn resolved(text: &str) -> Result<Pipeline, String> {
    let example = [Box::new(KindRow::<ImageGamma>::new()) as Box<dyn NodeKind>];
    let others = [tauflow_scene::kinds(), tauflow_render::kinds(), tauflow_train::kinds(), tauflow_eval::kinds()];
    let registry = Registry::new(others.into_iter().flatten().chain(example));
    resolve_text("example.yaml", text, &registry, &Options::default()).map_err(|problems| problems.to_string())
}

/// A pipeline whose last nodes are that of the manual, and one that scores what it makes.
fn pipeline(params: &str) -> String {
    let (_, yaml) = MANUAL.split_once("```yaml\n").expect("the manual shows a node");
    let (yaml, _) = yaml.split_once("```").expect("the block ends");
    let node: String = yaml.lines().map(|line| format!("  {line}\n")).collect();
    assert!(node.contains("gamma: 0.5"), "{node}");
    let scores = "  scores: { kind: image_metrics, inputs: { images: brighter, references: test_set } }\n";
    format!("{BEFORE}{}{scores}targets: [scores]\n", node.replace("gamma: 0.5", params))
}

/// The store, for reading only.
struct Reading<'a>(&'a Store);

impl Blobs for Reading<'_> {
    fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, KindError> {
        self.0.get(digest).map_err(|error| KindError::Environment(error.to_string()))
    }

    fn put(&self, _: &[u8]) -> Result<Digest, KindError> {
        unreachable!("results are read")
    }

    fn memo_get(&self, _: &MemoKey) -> Option<Artifact> {
        None
    }

    fn memo_put(&self, _: &MemoKey, _: &Artifact) -> Result<(), KindError> {
        unreachable!("results are read")
    }
}

#[test]
fn the_example_of_adding_a_kind_runs_in_a_pipeline() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let store = Store::open(folder.path()).expect("the folder can be written");
    let run = || {
        let pipeline = resolved(&pipeline("gamma: 0.5")).unwrap_or_else(|problems| panic!("{problems}"));
        let stop = AtomicBool::new(false);
        let summary = engine::run(&pipeline, &store, &RunOptions::default(), &stop, &|_| {}).expect("runs");
        assert!(summary.failures.is_empty(), "{:#?}", summary.failures);
        (summary.nodes.iter().map(|node| node.ran).sum::<u64>(), pipeline)
    };
    let (ran, pipeline) = run();
    assert!(ran > 0);
    assert_eq!(run().0, 0, "a second run has nothing to do");
    let items = |name: &str| {
        let node = pipeline.node(name).expect("it is in the pipeline");
        engine::outputs(&pipeline, &store, node, PortId::DEFAULT).expect("up to date")
    };
    let (reading, stop) = (Reading(&store), AtomicBool::new(false));
    let ctx = Context::new(&reading, &Silent, &stop);
    let (made, scenes) = (items("brighter"), items("test_set"));
    assert_eq!((made.len(), items("scores").len()), (scenes.len(), scenes.len()));
    assert!(!scenes.is_empty());
    for (key, artifact) in made.iter() {
        let refined = Handle::<Refined>::new(artifact).and_then(|item| item.load(&ctx)).expect("whole");
        let scene = scenes.get(key.as_str()).expect("the scene that it was made of");
        let scene = Handle::<PackedScene>::new(scene).and_then(|item| item.load(&ctx)).expect("whole");
        let (said, image) = &refined.images[0];
        assert_eq!((said.method.as_str(), said.from_spp), ("image_gamma", 1));
        assert_eq!(*image, scene.states[0].map(|value| powf(value.max(0.0), 0.5)), "{key}");
    }
}

#[test]
fn a_param_of_the_example_of_adding_a_kind_decides_a_port() {
    let reading = |params: &str| pipeline(params).replace("images: brighter,", "images: brighter.original,");
    let found = resolved(&reading("gamma: 0.5, original: true")).unwrap_or_else(|problems| panic!("{problems}"));
    let node = &found.nodes[found.node("brighter").expect("it is in the pipeline")];
    assert_eq!(node.spec.outputs.iter().map(|port| port.name).collect::<Vec<_>>(), ["refined", "original"]);
    let problems = resolved(&reading("gamma: 0.5")).expect_err("no such port");
    assert!(problems.contains("`brighter` has no output `original`"), "{problems}");
    let matrix = reading("gamma: 0.5").replace("  brighter:\n", "  brighter:\n    matrix: { original: [true] }\n");
    let problems = resolved(&matrix).expect_err("an axis that decides a port");
    assert!(problems.contains("it cannot be an axis") && problems.contains("example.yaml:"), "{problems}");
}

#[test]
fn wrong_params_of_the_example_of_adding_a_kind_are_told_before_it_runs() {
    for (params, told) in [("gamma: 1.0", "changes nothing"), ("gamma: 20.0", "10"), ("gama: 0.5", "gamma")] {
        let problems = resolved(&pipeline(params)).expect_err(params);
        assert!(problems.contains(told), "{params}: {problems}");
    }
}
