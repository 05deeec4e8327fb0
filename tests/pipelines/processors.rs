//! The same bits on other processors: rendering, training, refinement and evaluation on this one with all that it has,
//! with AVX2 and with SSE2, and on an emulated one that has no more than SSE2. That needs `qemu-x86_64` (Debian:
//! qemu-user), and says when it is not there. (One with AVX2 is not emulated: qemu 7.2 computes some of its
//! instructions wrongly, and fails tests of the renderer that processors with AVX2 pass.)

use crate::edits::PIPELINE;
use std::{fs, path::Path, process::Command};
use tauflow_testing::{Need, skip};

/// Nodes with what the defaults of trainings leave out: G-buffers, logarithms, a loss of images, local models, low
/// rungs, all eight views; and 32 x 32 pixels, from which on convolutions have minimal filtering.
const MORE: &str = r"
  gbuffer_set:
    kind: dataset_packing
    inputs: { ladders: train_ladders, gbuffers: train_ladders.gbuffer, exposure: gate.exposure }
  gbuffer_test:
    kind: dataset_packing
    inputs: { ladders: test_ladders, gbuffers: test_ladders.gbuffer, exposure: gate.exposure }
  strong:
    kind: training
    inputs: { train: gbuffer_set, test: gbuffer_test }
    params:
      parameterization: mc_noise
      conditioning: gbuffer
      preset: tiny
      steps: 3
      batch: 2
      crop: 16
      space: log1p
      loss: unbiased_preview
      output: fitted_means
      rung_exponent: 0.5
  viewed:
    kind: refinement
    inputs: { endpoints: gbuffer_test, model: strong.model }
    params: { nfe: [1, 3], mirrors: 8 }
  wide_ladders:
    kind: ladder_rendering
    inputs: { scenes: sampling.test }
    params: { rungs: [1, 2], resolution: [32, 32] }
  wide_set:
    kind: dataset_packing
    inputs: { ladders: wide_ladders, exposure: gate.exposure }
  wide:
    kind: training
    inputs: { train: wide_set }
    params: { parameterization: mc_noise, preset: tiny, steps: 1, batch: 1, crop: 32 }
  wide_refined:
    kind: refinement
    inputs: { endpoints: wide_set, model: wide.model }
    params: { nfe: [1] }
  own_values:
    kind: training
    inputs: { train: gbuffer_set }
    params:
      parameterization: vanilla_rf
      conditioning: gbuffer
      preset: tiny
      steps: 2
      batch: 2
      crop: 16
      output: values
";
/// Runs the pipeline in a cache of its own, with some of this processor's instructions or on an emulated one.
fn run(folder: &Path, instructions: &str, processor: Option<&str>, arguments: &[&str]) -> String {
    let program = env!("CARGO_BIN_EXE_tauflow");
    let mut command = match processor {
        Some(processor) => {
            let mut command = Command::new("qemu-x86_64");
            command.args(["-cpu", processor, program]);
            command
        }
        None => Command::new(program),
    };
    let cache = folder.join(processor.unwrap_or(instructions));
    command.env("TAUFLOW_INSTRUCTIONS", instructions);
    let output =
        command.args(["run", "bits.yaml"]).args(arguments).arg("--cache").arg(cache).current_dir(folder).output();
    let output = output.expect("it starts");
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{processor:?}: {text}");
    text
}

#[test]
fn everything_is_the_same_on_sse2_avx2_and_this_processor() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    // An emulated processor takes fifty times as long: as few scenes as are to be learned from.
    let few = PIPELINE.replace("pool: 16, views: [1, 1], objects: [5, 12]", "pool: 8, views: [1, 1], objects: [5, 8]");
    assert_ne!(few, PIPELINE);
    fs::write(folder.path().join("bits.yaml"), format!("{few}{MORE}")).expect("writable");
    if !std::is_x86_feature_detected!("avx512f") {
        skip(Need::Avx512, "this processor has no AVX-512: the first run has the best instructions there are");
    }
    run(folder.path(), "avx512", None, &["--update-lock"]);
    for instructions in ["avx2", "sse2"] {
        let told = run(folder.path(), instructions, None, &["--locked"]);
        assert!(told.contains("bits.lock agrees"), "{instructions}: {told}");
    }
    if Command::new("qemu-x86_64").arg("--version").output().is_err() {
        skip(Need::Qemu, "qemu-x86_64 (Debian: qemu-user) is not there");
        return;
    }
    let told = run(folder.path(), "avx512", Some("qemu64"), &["--locked"]);
    assert!(told.contains("bits.lock agrees"), "{told}");
}
