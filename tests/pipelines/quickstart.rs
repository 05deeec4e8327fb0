//! What the quickstart's results must show, with all of its scenes and solvers. Ladders end at 64 samples per pixel
//! here, trainings take a third of the steps, and solvers are called once: what is asked of them is learnt by then, in
//! four minutes on two cores instead of ten. It needs `TAUFLOW_SLOW=1`.

use crate::support::{Done, root};
use std::collections::BTreeMap;
use tauflow_data::{
    Stratum,
    records::{BridgeFiles, Evaluation, MethodTable, TrainingLog, Verdict},
};
use tauflow_testing::{Need, skip, slow};

/// The quickstart, and a solver that learns targets that belong to other states.
const CONTROL: &str = r#"
pipeline: quickstart_results
seed: 7
include: [QUICKSTART]
targets: [evaluation, solvers.log, gate.verdicts, sampling.train, sampling.test, bridge, shuffled_scores, statistics]
nodes:
  shuffled:
    kind: training
    matrix: { parameterization: [mc_noise] }
    inputs: { train: train_set, test: test_set }
    params:
      conditioning: rgb
      shuffle_targets: true
      preset: tiny
      steps: 192
      batch: 8
      space: log1p
      learning_rate: 1.0e-3
      decay: cosine
      exposure_jitter: 0.5
      permute_colours: true
  shuffled_refined:
    kind: refinement
    matrix: { parameterization: [mc_noise] }
    inputs: { endpoints: test_set, model: shuffled.model }
    params: { nfe: [1] }
  shuffled_metrics:
    kind: image_metrics
    matrix: { parameterization: [mc_noise] }
    inputs: { images: shuffled_refined, references: test_set }
  shuffled_scores:
    kind: evaluation
    inputs: { scores: shuffled_metrics, hold: hold }
"#;

/// What the test leaves out of the quickstart.
const LESS: [&str; 3] = ["values.last_rung=64", "solvers.steps=192", "refined.nfe=[1]"];

fn method<'a>(evaluation: &'a Evaluation, method: &str, conditioning: &str) -> &'a MethodTable {
    let is_it = |m: &&MethodTable| m.method == method && m.conditioning == conditioning;
    evaluation.methods.iter().find(is_it).expect("the cell is there")
}

#[test]
fn the_quickstart_learns_what_it_should() {
    if !slow() {
        skip(Need::Slow, "TAUFLOW_SLOW=1 runs the quickstart (four minutes)");
        return;
    }
    let quickstart = root().join("pipelines/quickstart.yaml");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("results.yaml");
    let text = CONTROL.replace("QUICKSTART", &serde_json::to_string(&quickstart).expect("a path in UTF-8"));
    std::fs::write(&file, text).expect("written");
    let done = Done::run(&file, LESS.map(str::to_owned).to_vec(), &root().join("cache/store"));

    // As many scenes as the protocol says, equally many of each stratum on the test side.
    let (train, test) = (done.keys("sampling.train"), done.keys("sampling.test"));
    assert_eq!((train.len(), test.len()), (144, 48));
    for stratum in Stratum::all() {
        let of =
            |keys: &[String]| keys.iter().filter(|k| Stratum::of_key(k).is_some_and(|(s, _)| s == stratum)).count();
        assert_eq!((of(&train), of(&test)), (12, 4), "{stratum}");
    }

    // The gate rejects something, and says why.
    let verdicts: BTreeMap<String, Verdict> = done.read("gate.verdicts");
    let rejected: Vec<_> = verdicts.iter().filter(|(_, v)| !v.reasons.is_empty()).collect();
    assert!(verdicts.len() == 528 && !rejected.is_empty() && rejected.len() < verdicts.len() / 4);
    for (scene, verdict) in rejected {
        // Each reason stands on what was measured, against the default thresholds.
        for reason in &verdict.reasons {
            let m = |name: &str| verdict.measures[name];
            assert!(
                match reason.as_str() {
                    "inside" => m("inside") > 0.6,
                    "too_near" => m("near_share") > 0.95,
                    "mostly_sky" => m("sky_share") > 0.85,
                    "one_surface" => m("surface_share") > 0.98,
                    "black" => m("mean_luminance") <= 1e-6,
                    "dark" => m("dark_share") > 0.6,
                    "near_constant" => m("contrast") < 0.015,
                    "featureless" => m("edges") < 1.1,
                    "over_exposed" => m("bright_share") > 0.25,
                    "degenerate" => m("concentration") > 0.97,
                    "noisy" => m("noisy_share") > 0.4,
                    "little_to_see" => m("to_see") < 0.17,
                    _ => false,
                },
                "{scene}: {reason}: {:?}",
                verdict.measures
            );
        }
        println!("rejected: {scene}: {}", verdict.reasons.join(", "));
    }

    // Its strata are what they say.
    crate::strata::check(done.read("statistics.statistics"), 1);

    // The MC noise solver beats its input by 3 dB in one step, surely.
    let evaluation: Evaluation = done.only("evaluation");
    assert_eq!((evaluation.scenes, evaluation.nfe.as_slice()), (48, &[1u64][..]));
    assert_eq!(evaluation.methods.len(), 8);
    let gain = |table: &MethodTable| table.at.iter().find(|a| a.nfe == 1).expect("NFE 1").gain["hdr_psnr"];
    let noise = gain(method(&evaluation, "mc_noise", "rgb"));
    println!("RGB mc_noise at NFE 1: {:+.2} dB over hold, 95% [{:+.2}, {:+.2}]", noise.mean, noise.low, noise.high);
    assert!(noise.mean >= 3.0 && noise.low > 0.0, "{noise:?}");

    // Every cell learns: the loss on scenes that it never saw falls.
    let logs: BTreeMap<String, TrainingLog> = done.read("solvers.log");
    assert_eq!(logs.len(), 8);
    for (cell, log) in &logs {
        let losses: Vec<f64> = log.points.iter().filter_map(|p| p.test).collect();
        println!("{cell}: test loss {:.4} -> {:.4}", losses[0], losses[losses.len() - 1]);
        assert!(losses[losses.len() - 1] < losses[0], "{cell}: {losses:?}");
    }

    // Targets of other states teach nothing: what is left is what any weighted mean does to noise.
    let control: Evaluation = done.only("shuffled_scores");
    let shuffled = gain(&control.methods[0]);
    println!("shuffled targets: {:+.2} dB", shuffled.mean);
    assert!(shuffled.mean < noise.mean - 3.0 && shuffled.mean < 1.0, "{shuffled:?}");

    // Ten scenes make 90 adjacent and 80 direct cases for each method.
    let bridge = done.only::<BridgeFiles>("bridge").bridge;
    for summary in &bridge.summary {
        assert_eq!(summary.cases, if summary.stop == "adjacent" { 90 } else { 80 }, "{summary:?}");
    }
    assert!(bridge.rows.iter().all(|row| row.fraction > 0.0 && row.fraction < 1.0));
}
