//! What each edit of a pipeline reruns, on a small pipeline of the real kinds: nothing that the edit does not change.

use crate::support::Done;
use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    sync::{Mutex, OnceLock, atomic::AtomicBool},
};
use tauflow::{
    engine::{self, RunOptions, event::Event},
    pipeline::{self, Options},
    registry,
};
use tauflow_cache::Store;
use tauflow_data::records::Verdict;

/// Four strata, four scenes each; a few pixels, a few steps.
pub const PIPELINE: &str = r#"
pipeline: edits
seed: 5
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 16, views: [1, 1], objects: [5, 12], regimes: [L0, L1], contexts: [open, enclosed] }
  previews:
    kind: ladder_rendering
    inputs: { scenes: scenes }
    params: { rungs: [8], resolution: [16, 16] }
  gate:
    kind: quality_gate
    inputs: { scenes: scenes, previews: previews }
    params: { inside: 1.0, near_share: 1.0, sky_share: 1.0, surface_share: 1.0,
      dark_share: 1.0, bright_share: 1.0, contrast: 0.0, edges: 0.0, concentration: 1.0, noisy_share: 1.0, to_see: 0.0 }
  split:
    kind: content_signature_split
    inputs: { scenes: gate.accepted }
    params: { test_share: 0.5 }
  sampling:
    kind: stratified_sampling
    inputs: { train: split.train, test: split.test }
    params: { train: 8, test: 4, regimes: [L0, L1], contexts: [open, enclosed], allow_short: true }
  train_ladders:
    kind: ladder_rendering
    inputs: { scenes: sampling.train }
    params: { rungs: { dyadic: 16 }, resolution: [16, 16] }
  test_ladders:
    kind: ladder_rendering
    inputs: { scenes: sampling.test }
    params: { rungs: { dyadic: 16 }, resolution: [16, 16] }
  train_set:
    kind: dataset_packing
    inputs: { ladders: train_ladders, exposure: gate.exposure }
  test_set:
    kind: dataset_packing
    inputs: { ladders: test_ladders, exposure: gate.exposure }
  solvers:
    kind: training
    matrix: { steps: [2, 3] }
    inputs: { train: train_set, test: test_set }
    params: { parameterization: mc_noise, preset: tiny, batch: 2, crop: 16 }
  refined:
    kind: refinement
    matrix: { steps: [2, 3] }
    inputs: { endpoints: test_set, model: solvers.model }
    params: { nfe: [1, 2] }
  scores:
    kind: image_metrics
    matrix: { steps: [2, 3] }
    inputs: { images: refined, references: test_set }
  hold:
    kind: image_metrics
    inputs: { references: test_set }
  evaluation:
    kind: evaluation
    inputs: { scores: scores, hold: hold }
    params: { resamples: 200 }
  report:
    kind: report
    inputs: { evaluation: evaluation }
    params: { title: "Before" }
"#;

/// What a run did, by node: actions that ran, and actions that were done before.
struct Ran {
    nodes: BTreeMap<String, (u64, u64)>,
    /// The largest total that each node's actions announced in progress reports.
    units: BTreeMap<String, u64>,
}

impl Ran {
    /// Names of the nodes of which something ran.
    fn names(&self) -> Vec<&str> {
        self.nodes.iter().filter(|(_, (ran, _))| *ran > 0).map(|(name, _)| name.as_str()).collect()
    }

    fn ran(&self, node: &str) -> u64 {
        self.nodes[node].0
    }
}

fn run(store: &Path, text: &str) -> Ran {
    let registry = registry::registry();
    let pipeline = match pipeline::resolve_text("edits.yaml", text, &registry, &Options::default()) {
        Ok(pipeline) => pipeline,
        Err(problems) => panic!("{problems}"),
    };
    let store = Store::open(store).expect("a temporary folder can be written");
    let units = Mutex::new(BTreeMap::new());
    let look = |event: &Event| {
        if let Event::Progress { node, total, .. } = event {
            let mut units = units.lock().expect("no panic in here");
            let most = units.entry(node.clone()).or_insert(0);
            *most = (*most).max(*total);
        }
    };
    let summary = engine::run(&pipeline, &store, &RunOptions::default(), &AtomicBool::new(false), &look).expect("runs");
    assert!(summary.failures.is_empty(), "{:#?}", summary.failures);
    let nodes = summary.nodes.iter().map(|n| (n.node.clone(), (n.ran, n.hit))).collect();
    Ran {
        nodes,
        units: units.into_inner().expect("no panic in there").into_iter().map(|(n, u)| (n.to_string(), u)).collect(),
    }
}

/// A cache in which the pipeline was run once for all edits, and what that run did.
fn ran_once() -> &'static (tempfile::TempDir, Ran) {
    static ONCE: OnceLock<(tempfile::TempDir, Ran)> = OnceLock::new();
    ONCE.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let ran = run(folder.path(), PIPELINE);
        (folder, ran)
    })
}

/// Copies that cache to a folder: as if the pipeline had been run there.
pub fn run_before(folder: &Path) {
    fn copy(from: &Path, to: &Path) {
        fs::create_dir_all(to).expect("writable");
        for entry in fs::read_dir(from).expect("readable").map(|entry| entry.expect("readable")) {
            let (from, to) = (entry.path(), to.join(entry.file_name()));
            if from.is_dir() {
                copy(&from, &to);
            } else {
                fs::copy(from, to).expect("room");
            }
        }
    }
    copy(ran_once().0.path(), folder);
}

/// A copy of its own for an edit.
fn ran_before() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    run_before(folder.path());
    folder
}

fn edit(from: &str, to: &str) -> String {
    assert!(PIPELINE.contains(from), "`{from}` stands in the pipeline");
    PIPELINE.replace(from, to)
}

const LEARNING: [&str; 6] = ["evaluation", "refined", "report", "scores", "solvers", "hold"];

#[test]
fn an_edit_reruns_what_it_changes_and_nothing_else() {
    let (folder, first) = (ran_before(), &ran_once().1);
    assert_eq!(first.ran("scenes"), 16);
    assert_eq!(first.ran("train_ladders"), 8);
    assert_eq!(first.ran("solvers"), 2);

    // Nothing changed: nothing runs.
    assert_eq!(run(folder.path(), PIPELINE).names(), [""; 0]);

    // A title: the report alone.
    assert_eq!(run(folder.path(), &edit("Before", "After")).names(), ["report"]);

    // A threshold that rejects no other scene: the gate, and nothing whose content stays the same.
    let strict = run(folder.path(), &edit("params: { inside: 1.0,", "params: { black: 0.0000001, inside: 1.0,"));
    assert_eq!(strict.names(), ["gate"]);
    assert_eq!(strict.ran("gate"), 16);

    // A training step count: that cell's training onwards.
    let steps = run(folder.path(), &PIPELINE.replace("steps: [2, 3]", "steps: [2, 4]"));
    assert_eq!(steps.names(), ["evaluation", "refined", "report", "scores", "solvers"]);
    assert_eq!((steps.ran("solvers"), steps.ran("refined"), steps.ran("scores")), (1, 4, 4));

    // A range that only glossy scenes use: no diffuse scene.
    let glossy = run(folder.path(), &edit("pool: 16,", "pool: 16, glossy: { roughness: [0.2, 0.3] },"));
    assert_eq!((glossy.ran("scenes"), glossy.ran("previews"), glossy.ran("gate")), (8, 8, 8));
    assert!(glossy.ran("train_ladders") <= 4, "{:?}", glossy.nodes);
}

#[test]
fn a_verdict_moves_no_other_scene() {
    let (folder, cache) = (tempfile::tempdir().expect("a temporary folder"), ran_before());
    let (file, cache) = (folder.path().join("edits.yaml"), cache.path());
    fs::write(&file, PIPELINE).expect("written");
    let before = Done::run(&file, Vec::new(), cache);
    let verdicts: BTreeMap<String, Verdict> = before.read("gate.verdicts");
    let mut contrast: Vec<f64> = verdicts.values().map(|v| v.measures["contrast"]).collect();
    contrast.sort_by(f64::total_cmp);
    // Between the two least: one scene more is rejected.
    let threshold = f64::midpoint(contrast[0], contrast[1]);
    let text = edit("contrast: 0.0,", &format!("contrast: {threshold},"));
    let ran = run(cache, &text);
    fs::write(&file, &text).expect("written");
    let after = Done::run(&file, Vec::new(), cache);
    assert_eq!(after.keys("gate.accepted").len(), 15);
    for side in ["split.train", "split.test"] {
        let (before, after) = (before.keys(side), after.keys(side));
        assert!(after.iter().all(|key| before.contains(key)), "{side}: {before:?} {after:?}");
    }
    // At most one scene stands in for the rejected one; no other ladder is rendered.
    assert_eq!((ran.ran("gate"), ran.ran("split")), (16, 1));
    assert!(ran.ran("train_ladders") + ran.ran("test_ladders") <= 1, "{:?}", ran.nodes);
}

#[test]
fn one_more_scene_per_stratum_is_that_many_items_more() {
    let folder = ran_before();
    // Five scenes a stratum are two to train and three to test.
    let text = edit("pool: 16", "pool: 20").replace("train: 8, test: 4", "train: 8, test: 8");
    let more = run(folder.path(), &text);
    for node in ["scenes", "previews", "gate", "test_ladders", "test_set", "hold"] {
        assert_eq!(more.ran(node), 4, "{node}: {:?}", more.nodes);
    }
    // Every earlier choice is kept, so that the training side is as it was.
    for node in ["train_ladders", "train_set"] {
        assert_eq!(more.ran(node), 0, "{node}: {:?}", more.nodes);
    }
    // Two cells, two images each, for the new scenes alone; unless the solvers changed, but they only log other losses.
    assert_eq!((more.ran("solvers"), more.ran("refined")), (2, 8), "{:?}", more.nodes);
}

#[test]
fn a_longer_ladder_renders_the_new_samples_only() {
    let (folder, first) = (ran_before(), &ran_once().1);
    // The gate's 8 samples are the ladder's first 8.
    assert_eq!((first.units["previews"], first.units["train_ladders"]), (8, 8));
    let longer = run(folder.path(), &PIPELINE.replace("dyadic: 16", "dyadic: 64"));
    assert_eq!((longer.units["train_ladders"], longer.units["test_ladders"]), (48, 48));
    assert_eq!((longer.ran("train_ladders"), longer.ran("test_ladders")), (8, 4));
    for node in ["scenes", "previews", "gate", "split", "sampling"] {
        assert_eq!(longer.ran(node), 0, "{node}");
    }
    for node in LEARNING {
        assert!(longer.ran(node) > 0, "{node}");
    }
}
