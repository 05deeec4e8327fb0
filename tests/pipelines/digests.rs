//! Holds the bits of what kinds make of a tiny pipeline, beside the version of each port's group. Who changes outputs
//! raises the version, or results of before are taken for results of now. The bits hold on any x86-64 machine.

use crate::{
    edits::{PIPELINE, run_before},
    support::Done,
};
use std::fmt::Write as _;

const PINNED: &str = include_str!("digests.txt");

#[test]
fn outputs_change_with_versions_alone() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("tiny.yaml");
    let more = "  \
  features:
    kind: dataset_packing
    inputs: { ladders: train_ladders, gbuffers: train_ladders.gbuffer, exposure: gate.exposure }
  held_out:
    kind: ladder_rendering
    inputs: { scenes: sampling.test }
    params: { rungs: [32], resolution: [16, 16], stream: 1 }
  as_before:
    kind: ladder_rendering
    inputs: { scenes: sampling.test }
    params: { rungs: [32], resolution: [16, 16], stream: 1, choices: fixed }
  convergence:
    kind: convergence
    inputs: { references: held_out, ladders: test_ladders, exposure: gate.exposure }
  filtered:
    kind: guided_filter
    inputs: { endpoints: features }
    params: { colour: 0.5 }
  lit:
    kind: dataset_packing
    inputs: { ladders: test_ladders, gbuffers: test_ladders.gbuffer, exposure: gate.exposure }
  strong:
    kind: training
    inputs: { train: features, test: lit }
    params:
      parameterization: mc_noise
      conditioning: gbuffer
      preset: tiny
      steps: 3
      batch: 2
      crop: 16
      space: log1p
      loss: absolute
      output: shaded_means
      rung_exponent: 0.5
  viewed:
    kind: refinement
    inputs: { endpoints: lit, model: strong.model }
    params: { nfe: [1, 3], mirrors: 8 }
  local:
    kind: training
    inputs: { train: train_set }
    params: { parameterization: local_velocity, preset: tiny, steps: 2, batch: 2, crop: 16 }
  bridge_ladders:
    kind: ladder_rendering
    inputs: { scenes: sampling.test }
    params: { rungs: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10], resolution: [16, 16] }
  bridge_set:
    kind: dataset_packing
    inputs: { ladders: bridge_ladders, exposure: gate.exposure }
  bridged:
    kind: bridge_refinement
    inputs: { endpoints: bridge_set, mc_noise: \"solvers[steps=3].model\", local_velocity: local.model }
  # Large enough for convolutions by minimal filtering.
  wide_ladders:
    kind: ladder_rendering
    inputs: { scenes: sampling.test }
    params: { rungs: [1, 2, 4], resolution: [32, 32] }
  wide_set:
    kind: dataset_packing
    inputs: { ladders: wide_ladders, exposure: gate.exposure }
  minimal:
    kind: training
    inputs: { train: wide_set, test: wide_set }
    params: { parameterization: mc_noise, preset: tiny, steps: 2, batch: 2, crop: 32 }
  direct:
    kind: training
    inputs: { train: wide_set, test: wide_set }
    params: { parameterization: mc_noise, preset: tiny, steps: 2, batch: 2, crop: 32, convolutions: direct }
  wide_refined:
    kind: refinement
    inputs: { endpoints: wide_set, model: direct.model }
    params: { nfe: [1] }
  statistics:
    kind: scene_statistics
    inputs: { scenes: sampling.test }
    params: { resolution: [8, 8], spp: 8, reference: 4 }
  bridge:
    kind: bridge_validation
    inputs: { endpoints: bridge_set, steps: bridged }
    params: { resamples: 200, map_scenes: 1 }
  rung_scores:
    kind: ladder_metrics
    inputs: { ladders: test_ladders, references: held_out }
  seen_scores:
    kind: ladder_metrics
    inputs: { ladders: test_ladders, references: held_out }
    params: { also: [ms_ssim, flip, hdr_flip], ms_ssim_scales: 1 }
  table:
    kind: table
    inputs: { scores: rung_scores }
    params: { columns: [spp], latex: true }
  sheet:
    kind: contact_sheet
    inputs: { ladders: test_ladders, exposure: gate.exposure }
";
    std::fs::write(&file, format!("{PIPELINE}{more}")).expect("written");
    // What it shares with the edits was made by this program, too.
    let cache = folder.path().join("cache");
    run_before(&cache);
    let done = Done::run(&file, Vec::new(), &cache);
    let mut found = String::new();
    for port in [
        "scenes.scenes",
        "previews.ladder",
        "gate.accepted",
        "gate.exposure",
        "gate.verdicts",
        "split.train",
        "split.test",
        "split.report",
        "sampling.train",
        "sampling.test",
        "sampling.report",
        "train_ladders.ladder",
        "train_ladders.gbuffer",
        "train_set.packed",
        "features.packed",
        "held_out.ladder",
        "as_before.ladder",
        "convergence.convergence",
        "filtered.refined",
        "statistics.statistics",
        "solvers.model",
        "solvers.log",
        "refined.refined",
        "scores.metrics",
        "strong.model",
        "strong.log",
        "viewed.refined",
        "minimal.model",
        "minimal.log",
        "direct.model",
        "direct.log",
        "wide_refined.refined",
        "bridged.steps",
        "hold.metrics",
        "evaluation.tables",
        "bridge.bridge",
        "report.report",
        "sheet.sheet",
        "rung_scores.metrics",
        "seen_scores.metrics",
        "table.table",
    ] {
        let (kind, version) = done.kind(port);
        let _ = writeln!(found, "{kind} {version} {port} {}", done.collection(port).digest());
    }
    for port in ["model", "log"] {
        let digest = |node: &str| done.collection(&format!("{node}.{port}")).digest();
        assert_ne!(digest("minimal"), digest("direct"), "rounding, at least, differs in {port}");
    }
    assert!(
        found == PINNED,
        "outputs differ from tests/pipelines/digests.txt. If that is meant, raise the version of each group whose \
         lines differ (of those that only read other inputs, not), and put this there:\n{found}"
    );
}
