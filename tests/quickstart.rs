//! What the quickstart's results must show. Runs the pipeline itself, which takes a quarter of an hour on two cores when
//! the cache of this checkout does not hold it yet, so it needs `TAUFLOW_SLOW=1`.

use std::{collections::BTreeMap, path::Path, sync::atomic::AtomicBool};
use tauflow::{
    engine::{self, RunOptions},
    pipeline::{self, Options, Pipeline},
    registry,
};
use tauflow_cache::Store;
use tauflow_data::{
    Stratum,
    formats::Verdict,
    results::{Bridge, Evaluation, MethodTable, TrainingLog},
};

/// The quickstart, and a solver that learns targets that belong to other states.
const CONTROL: &str = r#"
pipeline: quickstart_results
seed: 7
include: [QUICKSTART]
targets: [evaluation, solvers.log, gate.verdicts, sampling.train, sampling.test, bridge, shuffled_scores]
nodes:
  shuffled:
    kind: training
    inputs: { train: train_set, test: test_set }
    params: { parameterization: mc_noise, conditioning: rgb, shuffle_targets: true, preset: tiny, steps: 400, batch: 8 }
  shuffled_refined:
    kind: refinement
    inputs: { endpoints: test_set, model: shuffled.model }
    params: { nfe: [1] }
  shuffled_metrics:
    kind: image_metrics
    matrix: { parameterization: [shuffled] }
    inputs: { images: shuffled_refined, references: test_set }
  shuffled_scores:
    kind: evaluation
    inputs: { scores: shuffled_metrics, hold: hold }
"#;

/// Every item of a node's port, as JSON.
fn json<T: serde::de::DeserializeOwned>(
    pipeline: &Pipeline,
    store: &Store,
    node: &str,
    part: &str,
) -> BTreeMap<String, T> {
    let (name, port) = node.split_once('.').unwrap_or((node, ""));
    let node = pipeline.node(name).expect("the node is there");
    let port = if port.is_empty() { 0 } else { pipeline.nodes[node].output(port).expect("the port is there") };
    let collection = engine::outputs(pipeline, store, node, port).expect("up to date");
    let read = |digest| store.get(&digest).expect("the store can be read").expect("the blob is there");
    collection
        .iter()
        .map(|(key, artifact)| {
            let bytes = read(artifact.part(part).expect("the part is there"));
            (key.to_string(), serde_json::from_slice(&bytes).expect("what the kind wrote"))
        })
        .collect()
}

fn keys(pipeline: &Pipeline, store: &Store, name: &str, port: &str) -> Vec<String> {
    let node = pipeline.node(name).expect("the node is there");
    let port = pipeline.nodes[node].output(port).expect("the port is there");
    let collection = engine::outputs(pipeline, store, node, port).expect("up to date");
    collection.iter().map(|(key, _)| key.to_string()).collect()
}

fn method<'a>(evaluation: &'a Evaluation, method: &str, conditioning: &str) -> &'a MethodTable {
    let is_it = |m: &&MethodTable| m.method == method && m.conditioning == conditioning;
    evaluation.methods.iter().find(is_it).expect("the cell is there")
}

#[test]
fn the_quickstart_learns_what_it_should() {
    if std::env::var_os("TAUFLOW_SLOW").is_none() {
        println!("skipped: set TAUFLOW_SLOW=1 to run the quickstart (a quarter of an hour)");
        return;
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let quickstart = root.join("pipelines/quickstart.yaml");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("results.yaml");
    let text = CONTROL.replace("QUICKSTART", &serde_json::to_string(&quickstart).expect("a path in UTF-8"));
    std::fs::write(&file, text).expect("written");
    let pipeline = match pipeline::resolve(&file, &registry::registry(), &Options::default()) {
        Ok(pipeline) => pipeline,
        Err(problems) => panic!("{problems}"),
    };
    let store = Store::open(&root.join("cache/store")).expect("the checkout can be written");
    let summary =
        engine::run(&pipeline, &store, &RunOptions::default(), &AtomicBool::new(false), &|_| {}).expect("runs");
    assert!(summary.failures.is_empty(), "{:#?}", summary.failures);

    // As many scenes as the protocol says, equally many of each stratum on the test side.
    let (train, test) = (keys(&pipeline, &store, "sampling", "train"), keys(&pipeline, &store, "sampling", "test"));
    assert!(train.len() >= 48 && test.len() >= 24);
    for stratum in Stratum::all() {
        let of =
            |keys: &[String]| keys.iter().filter(|k| Stratum::of_key(k).is_some_and(|(s, _)| s == stratum)).count();
        assert_eq!((of(&train), of(&test)), (4, 2), "{stratum}");
    }

    // The gate rejects something, and says why.
    let verdicts: BTreeMap<String, Verdict> = json(&pipeline, &store, "gate.verdicts", "");
    let rejected: Vec<_> = verdicts.iter().filter(|(_, v)| !v.reasons.is_empty()).collect();
    assert!(verdicts.len() >= 96 && !rejected.is_empty() && rejected.len() < verdicts.len() / 4);
    for (scene, verdict) in rejected {
        println!("rejected: {scene}: {}", verdict.reasons.join(", "));
    }

    // The MC noise solver beats its input by 3 dB in one step, surely.
    let evaluation: Evaluation = json(&pipeline, &store, "evaluation", "").into_values().next().expect("one table");
    assert_eq!((evaluation.scenes, evaluation.nfe.as_slice()), (24, &[1u64, 2, 9, 20, 50][..]));
    assert_eq!(evaluation.methods.len(), 8);
    let gain = |table: &MethodTable| table.at.iter().find(|a| a.nfe == 1).expect("NFE 1").gain["hdr_psnr"];
    let noise = gain(method(&evaluation, "mc_noise", "rgb"));
    println!("RGB mc_noise at NFE 1: {:+.2} dB over hold, 95% [{:+.2}, {:+.2}]", noise.mean, noise.low, noise.high);
    assert!(noise.mean >= 3.0 && noise.low > 0.0, "{noise:?}");

    // Every cell learns: the loss on scenes that it never saw falls.
    let logs: BTreeMap<String, TrainingLog> = json(&pipeline, &store, "solvers.log", "");
    assert_eq!(logs.len(), 8);
    for (cell, log) in &logs {
        let losses: Vec<f64> = log.points.iter().filter_map(|p| p.test).collect();
        println!("{cell}: test loss {:.4} -> {:.4}", losses[0], losses[losses.len() - 1]);
        assert!(losses[losses.len() - 1] < losses[0], "{cell}: {losses:?}");
    }

    // Targets of other states teach nothing.
    let control: Evaluation = json(&pipeline, &store, "shuffled_scores", "").into_values().next().expect("one table");
    let shuffled = gain(&control.methods[0]);
    println!("shuffled targets: {:+.2} dB", shuffled.mean);
    assert!(shuffled.mean < noise.mean - 3.0 && shuffled.mean < 1.0, "{shuffled:?}");

    // Ten scenes make 90 adjacent and 80 direct cases for each method.
    let bridge: Bridge = json(&pipeline, &store, "bridge", "bridge.json").into_values().next().expect("one result");
    for summary in &bridge.summary {
        assert_eq!(summary.cases, if summary.stop == "adjacent" { 90 } else { 80 }, "{summary:?}");
    }
    assert!(bridge.rows.iter().all(|row| row.fraction > 0.0 && row.fraction < 1.0));
}
