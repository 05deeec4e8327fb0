//! The bridge on rendered scenes: with the held-out reference as the clean estimate, stops drawn by the variance law
//! have the variances and covariances of the rendered rungs. The networks have their first weights.

use crate::support::Done;
use std::{collections::BTreeMap, fs};
use tauflow_data::{
    methods::{BridgeMethod, EXPECTATION, LOCAL_DELTA, LOCAL_STEP, Parameterization, STOCHASTIC},
    records::{BridgeFiles, BridgeRow},
};

const PIPELINE: &str = r#"
pipeline: rendered_bridge
seed: 3
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 8, regimes: [L0], contexts: [open, enclosed] }
  ladders:
    kind: ladder_rendering
    inputs: { scenes: scenes }
    params: { rungs: [1, 2, 4, 8, 16, 32], resolution: [64, 64] }
  gate:
    kind: quality_gate
    inputs: { scenes: scenes, previews: ladders }
  packed:
    kind: dataset_packing
    inputs: { ladders: ladders, exposure: gate.exposure }
  solvers:
    kind: training
    matrix: { parameterization: [mc_noise, local_velocity] }
    inputs: { train: packed }
    params: { conditioning: rgb, preset: tiny, steps: 0, output: values, features: plain }
  stops:
    kind: ladder_rendering
    inputs: { scenes: gate.accepted }
    params: { rungs: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10], resolution: [64, 64] }
  held_out:
    kind: ladder_rendering
    inputs: { scenes: gate.accepted }
    params: { rungs: [1024], resolution: [64, 64], stream: 1 }
  endpoints:
    kind: dataset_packing
    inputs: { ladders: stops, exposure: gate.exposure }
  steps:
    kind: bridge_refinement
    inputs:
      endpoints: endpoints
      mc_noise: "solvers[parameterization=mc_noise].model"
      local_velocity: "solvers[parameterization=local_velocity].model"
      references: held_out
      exposure: gate.exposure
  bridge:
    kind: bridge_validation
    inputs: { endpoints: endpoints, steps: steps, references: held_out, exposure: gate.exposure }
    params: { resamples: 200, map_scenes: 1 }
"#;

#[test]
fn by_the_reference_drawn_stops_have_the_moments_of_rendered_rungs() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("bridge.yaml");
    fs::write(&file, PIPELINE).expect("written");
    let done = Done::run(&file, vec![], &folder.path().join("store"));
    let bridge = done.only::<BridgeFiles>("bridge").bridge;
    assert!(bridge.scenes >= 4, "{}", bridge.scenes);
    assert_eq!((bridge.setting["features"].as_str(), bridge.setting["output"].as_str()), ("plain", "values"));
    let by_reference = |rule: &str, log| BridgeMethod { reference: true, log, rule }.name();
    let rows: BTreeMap<(&str, &str, u64), &BridgeRow> =
        bridge.rows.iter().map(|row| ((row.method.as_str(), row.stop.as_str(), row.from_spp), row)).collect();
    let drawn = by_reference(STOCHASTIC, false);
    let stops: Vec<&BridgeRow> = bridge.rows.iter().filter(|row| row.method == drawn).collect();
    assert_eq!(stops.len(), 17);
    for row in &stops {
        let moments = row.moments.as_ref().expect("references");
        let [variance, covariance] = [moments.excess.mean, moments.covariance_excess.mean];
        let stop = format!("{} -> {}", row.from_spp, row.to_spp);
        let at = |rule: &str, log| rows[&(by_reference(rule, log).as_str(), row.stop.as_str(), row.from_spp)].psnr.mean;
        let noise = Parameterization::McNoise.name();
        println!(
            "{stop}: excess of variance {:+.1}%, of covariance {:+.1}%; local step {:+.2} dB over MC noise, in log1p \
             {:+.2} dB",
            100.0 * variance,
            100.0 * covariance,
            at(LOCAL_STEP, false) - at(noise, false),
            at(LOCAL_STEP, true) - at(noise, true),
        );
        assert!(variance.abs() < 0.05 && covariance.abs() < 0.05, "{stop}: {variance} {covariance}");
        // Without an error of a network, Euler steps are above MC noise. At adjacent stops that is above whole deltas,
        // which move half of the way to the clean image: right from 1 to 2 samples alone.
        let [step, noise, delta] = [LOCAL_STEP, noise, LOCAL_DELTA].map(|rule| at(rule, false));
        assert!(step > noise, "{stop}: {step} {noise}");
        if row.to_spp == row.from_spp + 1 && row.from_spp < 9 {
            assert_eq!(noise > delta, row.from_spp > 1, "{stop}: {noise} {delta}");
        }
        // The expectation alone varies too little.
        let expected = rows[&(by_reference(EXPECTATION, false).as_str(), row.stop.as_str(), row.from_spp)];
        assert!(expected.moments.as_ref().expect("references").excess.high < 0.0, "{stop}");
    }
}
