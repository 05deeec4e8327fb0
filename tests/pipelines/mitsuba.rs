//! Scenes of all strata have the means that Mitsuba 3 gives them: `mitsuba.json` holds its means and standard errors of
//! 8 x 8 bins, which `benches/mitsuba/agree.py FOLDER --scenes 1 --most 256 --reference` writes.
//!
//! It is one scene of each stratum; `TAUFLOW_SLOW=1` takes more samples.

use crate::support::{Done, root};
use serde::Deserialize;
use std::collections::BTreeMap;
use tauflow_contract::Media;
use tauflow_data::{
    Image, Stratum,
    records::{Ladder, Rung},
};

const PIPELINE: &str = "
pipeline: beside_mitsuba_means
seed: 11
include: [SCENES]
nodes:
  ladders:
    kind: ladder_rendering
    inputs: { scenes: gate.accepted }
    params: { rungs: RUNGS, resolution: [64, 64], stream: 4711, integrator: INTEGRATOR }
";

#[derive(Deserialize)]
pub(crate) struct References {
    pub(crate) mitsuba: String,
    pub(crate) batches: usize,
    pub(crate) side: usize,
    pub(crate) scenes: Vec<Reference>,
}

#[derive(Deserialize)]
pub(crate) struct Reference {
    pub(crate) scene: String,
    /// Of the scene's artifact: other scenes need other references. None of scene files.
    #[serde(default)]
    digest: String,
    pub(crate) means: Vec<f64>,
    pub(crate) errors: Vec<f64>,
}

/// What rounding may leave over, of the value: both renderers work in single precision.
const ROUNDING: f64 = 2e-5;
pub(crate) const BINS: usize = 8;
const BATCHES: u64 = 16;

/// Means of bins over pixels and channels.
pub(crate) fn bins(image: &Image) -> Vec<f64> {
    let cell = image.width() / BINS;
    let mut out = vec![0.0; BINS * BINS];
    for y in 0..image.height() {
        for x in 0..image.width() {
            let sum: f64 = image.pixel(x, y).iter().map(|v| f64::from(*v)).sum();
            out[y / cell * BINS + x / cell] += sum / (3 * cell * cell) as f64;
        }
    }
    out
}

/// Mean and squared standard error of independent values.
pub(crate) fn moments(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / (n - 1.0) / n)
}

/// Welch's statistic as the deviation of a normal distribution (after Cornish and Fisher), and the standard error.
pub(crate) fn deviation(ours: (f64, f64), theirs: (f64, f64), batches: f64) -> (f64, f64) {
    let rounding = (0.5 * ROUNDING * (ours.0.abs() + theirs.0.abs())).powi(2);
    let error = (ours.1 + theirs.1 + rounding).sqrt();
    let difference = ours.0 - theirs.0;
    if error == 0.0 {
        return (if difference == 0.0 { 0.0 } else { f64::INFINITY }, error);
    }
    let (sum, squares) = (ours.1 + theirs.1, ours.1 * ours.1 + theirs.1 * theirs.1);
    let freedom = if sum > 0.0 { sum * sum / squares * (batches - 1.0) } else { 1e9 };
    let t = difference / error;
    let z = (freedom * (t * t / freedom).ln_1p()).sqrt() * (1.0 - 3.0 / (4.0 * freedom));
    (z.copysign(t), error)
}

#[test]
fn scenes_have_mitsubas_means() {
    compare("path", if tauflow_testing::slow() { 64 } else { 16 });
}

#[test]
fn light_paths_have_mitsubas_means() {
    compare("bidirectional", 16);
}

/// Asserts that a scene of each stratum has Mitsuba's means. A batch has `batch` samples per pixel.
fn compare(integrator: &str, batch: u64) {
    let references: References = serde_json::from_str(include_str!("mitsuba.json")).expect("a sound file");
    assert!(references.mitsuba.starts_with("3.9") && references.side == 64 && references.batches == 16);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("means.yaml");
    let scenes = root().join("benches/mitsuba/scenes.yaml");
    let rungs: Vec<u64> = (1..=BATCHES).map(|k| k * batch).collect();
    let chosen: BTreeMap<String, &Reference> = references.scenes.iter().map(|of| (of.scene.clone(), of)).collect();
    assert_eq!(chosen.len(), Stratum::all().count());
    let text = PIPELINE
        .replace("SCENES", &serde_json::to_string(&scenes).expect("a path in UTF-8"))
        .replace("RUNGS", &format!("{rungs:?}"))
        .replace("INTEGRATOR", integrator);
    std::fs::write(&file, text).expect("written");
    // The first scene of each stratum.
    let done = Done::run(&file, vec!["scenes.pool=12".into()], &folder.path().join("cache"));
    let (artifacts, ladders) = (done.collection("gate.accepted"), done.collection("ladders.ladder"));
    let (mut worst, mut squares) = (0.0f64, 0.0);
    for (key, reference) in &chosen {
        let scene = artifacts.get(key).expect("the gate passes it");
        assert_eq!(
            scene.digest().to_string(),
            reference.digest,
            "{key} is another scene than the reference is of; make references anew, as benches/mitsuba/README.md says"
        );
        let ladder = ladders.get(key).expect("it is rendered");
        let Ladder { meta, rungs: images, .. } = done.with(|ctx| Ladder::load(ctx, ladder)).expect("a ladder");
        assert_eq!((meta.rejected, &meta.counts), (0, &rungs));
        // Disjoint blocks of samples are independent batches.
        let share = |rung: &Rung| rung.spp as f64 / batch as f64;
        let sums: Vec<Vec<f64>> =
            images.iter().map(|rung| bins(&rung.image).into_iter().map(|v| v * share(rung)).collect()).collect();
        let blocks: Vec<Vec<f64>> = (0..sums.len())
            .map(|k| (0..BINS * BINS).map(|b| sums[k][b] - if k > 0 { sums[k - 1][b] } else { 0.0 }).collect())
            .collect();
        for bin in 0..BINS * BINS {
            let ours = moments(&blocks.iter().map(|block| block[bin]).collect::<Vec<_>>());
            let theirs = (reference.means[bin], reference.errors[bin].powi(2));
            let (z, _) = deviation(ours, theirs, references.batches as f64);
            worst = worst.max(z.abs());
            assert!(z.abs() < 5.5, "{key}, bin {bin}: {ours:?} here, {theirs:?} there, {z:.1} deviations");
        }
        let whole: Vec<f64> = blocks.iter().map(|b| b.iter().sum::<f64>() / b.len() as f64).collect();
        let mean = reference.means.iter().sum::<f64>() / reference.means.len() as f64;
        // Errors of bins are hardly correlated.
        let count = reference.errors.len() as f64;
        let error = reference.errors.iter().map(|e| e * e).sum::<f64>() / (count * count);
        let (z, error) = deviation(moments(&whole), (mean, error), references.batches as f64);
        println!("{key}: {z:+.2} deviations; a bias of {:.2}% would be found", 100.0 * 4.84 * error / mean);
        assert!(z.abs() < 4.0, "{key}: the image's mean is {z:.1} deviations off");
        squares += z * z / chosen.len() as f64;
    }
    println!("worst bin {worst:.2}; mean square of the images' deviations {squares:.2}, 1 expected");
    assert!(squares < 2.5, "deviations are larger than chance makes them: {squares}");
}
