//! What is measured, as the kinds hand it on: scores, tables, losses, bridge cases. Knows nothing of how it is computed
//! or shown.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A mean over scenes with its bootstrap 95% interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

/// The metrics of one image against its reference. An infinite value is written as `null`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// PSNR of exposed linear radiance, peak 1, in dB.
    #[serde(with = "infinite")]
    pub hdr_psnr: f64,
    /// The same with the reference's maximum as the peak.
    #[serde(with = "infinite")]
    pub hdr_psnr_max: f64,
    /// Mean absolute error of exposed linear radiance.
    pub hdr_mae: f64,
    /// PSNR of previews, in dB.
    #[serde(with = "infinite")]
    pub preview_psnr: f64,
    /// Mean absolute error of previews.
    pub preview_mae: f64,
    /// Structural similarity of previews.
    pub ssim: f64,
}

/// Names of the metrics, in the order of tables.
pub const METRICS: [&str; 6] = ["hdr_psnr", "hdr_psnr_max", "hdr_mae", "preview_psnr", "preview_mae", "ssim"];

/// Whether more is better, for a name of [`METRICS`].
pub fn higher_is_better(metric: &str) -> bool {
    !metric.ends_with("_mae")
}

impl Metrics {
    /// A value by its name in [`METRICS`].
    pub fn get(&self, name: &str) -> Option<f64> {
        Some(match name {
            "hdr_psnr" => self.hdr_psnr,
            "hdr_psnr_max" => self.hdr_psnr_max,
            "hdr_mae" => self.hdr_mae,
            "preview_psnr" => self.preview_psnr,
            "preview_mae" => self.preview_mae,
            "ssim" => self.ssim,
            _ => return None,
        })
    }
}

/// One refined image's score.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// The method, e.g. `mc_noise` or `hold`.
    pub method: String,
    /// Sample count of the endpoint it starts from.
    pub from_spp: u64,
    /// Sample count that it aims at.
    pub to_spp: u64,
    /// Model calls; 0 for the input itself.
    pub nfe: u64,
    /// Its metrics.
    pub metrics: Metrics,
}

/// What `image_metrics` says of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneScores {
    /// Sample count of the reference, the last rung.
    pub reference_spp: u64,
    /// One for each image.
    pub scores: Vec<Score>,
    /// Why there are none, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

/// What `evaluation` says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Sample count of the references.
    pub reference_spp: u64,
    /// Sample count of the endpoint that all start from.
    pub from_spp: u64,
    /// Number of test scenes.
    pub scenes: u64,
    /// Resamples of the bootstrap.
    pub resamples: u64,
    /// The model calls that were measured, increasing.
    pub nfe: Vec<u64>,
    /// The input itself.
    pub hold: BTreeMap<String, Estimate>,
    /// One for each cell: space, method, conditioning.
    pub methods: Vec<MethodTable>,
    /// Other methods that were scored on the same scenes, such as denoisers; one for each cell.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub baselines: Vec<MethodTable>,
    /// Every solver against every baseline, at each of the solver's NFE.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub versus: Vec<Versus>,
    /// What the solvers are said to do, held against these figures.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub claims: Vec<Claim>,
    /// What was left out, and why.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Every score, for further work.
    pub per_scene: Vec<SceneRow>,
}

/// A claim, in one group of cells.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Claim {
    /// What is claimed.
    pub statement: String,
    /// Coordinates that the cells share.
    pub group: BTreeMap<String, String>,
    /// Differences that are all above 0 if it is so.
    pub evidence: Vec<Evidence>,
    /// What they say.
    pub verdict: Verdict,
}

/// A difference that a claim says is above 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// Of what.
    pub what: String,
    /// In which metric.
    pub metric: String,
    /// The difference, paired by scene.
    pub difference: Estimate,
}

/// What became of a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// All intervals are above 0.
    Held,
    /// An interval is below 0.
    NotHeld,
    /// Neither.
    Undecided,
}

/// A solver against a baseline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Versus {
    /// The solver's cell.
    pub cell: BTreeMap<String, String>,
    /// Its model calls.
    pub nfe: u64,
    /// The baseline's cell.
    pub baseline: BTreeMap<String, String>,
    /// The baseline's method.
    pub method: String,
    /// Paired difference, the solver's value less the baseline's, by metric.
    pub gain: BTreeMap<String, Estimate>,
    /// Share of scenes on which the solver is better, by metric.
    pub better: BTreeMap<String, f64>,
}

/// The row of a method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MethodTable {
    /// The cell's coordinates, e.g. `parameterization` -> `mc_noise`.
    pub cell: BTreeMap<String, String>,
    /// The method: the coordinate `parameterization`.
    pub method: String,
    /// The conditioning: the coordinate `conditioning`, `rgb` if there is none.
    pub conditioning: String,
    /// The training space: the coordinate `space`, empty if there is none.
    pub space: String,
    /// One for each NFE.
    pub at: Vec<NfeTable>,
    /// Area under the curve over log NFE, by metric.
    pub auc: BTreeMap<String, Estimate>,
    /// Total variation over log NFE, by metric.
    pub tv: BTreeMap<String, Estimate>,
}

/// A method at one NFE.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NfeTable {
    /// Model calls.
    pub nfe: u64,
    /// Means over scenes, by metric.
    pub metrics: BTreeMap<String, Estimate>,
    /// Paired difference to the input itself, by metric.
    pub gain: BTreeMap<String, Estimate>,
    /// Mean over the scenes of each stratum, by stratum and metric.
    pub strata: BTreeMap<String, BTreeMap<String, f64>>,
}

/// One score in one row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneRow {
    /// The scene's item key.
    pub scene: String,
    /// Its stratum, e.g. `L1-open`.
    pub stratum: String,
    /// The cell's coordinates; empty for hold.
    pub cell: BTreeMap<String, String>,
    /// The score.
    pub score: Score,
}

/// What `training` writes down as it goes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingLog {
    /// The parameterization.
    pub parameterization: String,
    /// The conditioning.
    pub conditioning: String,
    /// The training space.
    pub space: String,
    /// The preset of the network.
    pub preset: String,
    /// Its number of weights.
    pub weights: u64,
    /// Steps in all.
    pub steps: u64,
    /// Every param of the training, as it was resolved.
    pub params: serde_json::Map<String, serde_json::Value>,
    /// Points of the curve; the first is before the first step.
    pub points: Vec<TrainingPoint>,
}

/// A point of a loss curve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingPoint {
    /// Steps done.
    pub step: u64,
    /// Mean loss over the batches since the last point; none before the first step.
    pub train: Option<f64>,
    /// Loss of the averaged weights on the test scenes; none without any.
    pub test: Option<f64>,
    /// Mean gain of one call of the averaged weights over the first rung, on the first test scenes: dB of PSNR.
    pub gain: Option<f64>,
    /// Learning rate.
    pub learning_rate: f64,
    /// Mean norm of the gradient before clipping, since the last point.
    pub gradient_norm: Option<f64>,
}

/// How long a training took: a measurement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingTiming {
    /// Steps that were timed: those of the last run, if it was resumed.
    pub steps: u64,
    /// Their time, in seconds.
    pub seconds: f64,
    /// Median time of a step, in milliseconds.
    pub median_step_ms: f64,
    /// Threads that it had at most.
    pub threads: u64,
}

/// What `bridge_validation` says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bridge {
    /// Last sample count of the training ladder.
    pub n_max: u64,
    /// Number of scenes.
    pub scenes: u64,
    /// One for each kind of stop (adjacent, direct), method and k.
    pub rows: Vec<BridgeRow>,
    /// Mean over all cases of a kind of stop, by method.
    pub summary: Vec<BridgeSummary>,
    /// What the solvers are said to do between rungs, held against these figures.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub claims: Vec<Claim>,
    /// Every case.
    pub cases: Vec<BridgeCase>,
}

/// Mean over scenes at one stop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BridgeRow {
    /// `adjacent` (k -> k + 1) or `direct` (k -> the last).
    pub stop: String,
    /// `hold`, `local_step` or `mc_noise`.
    pub method: String,
    /// Sample count before.
    pub from_spp: u64,
    /// Sample count after.
    pub to_spp: u64,
    /// The fraction (tau_m - tau_k)/(1 - tau_k) of the way.
    pub fraction: f64,
    /// PSNR against the real I_m, linear.
    pub psnr: Estimate,
    /// Paired difference to hold.
    pub gain: Estimate,
}

/// Mean over all cases of a kind of stop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BridgeSummary {
    /// `adjacent` or `direct`.
    pub stop: String,
    /// The method.
    pub method: String,
    /// Number of cases.
    pub cases: u64,
    /// PSNR against the real I_m, linear.
    pub psnr: Estimate,
    /// Paired difference to hold.
    pub gain: Estimate,
    /// Share of cases that are better than hold.
    pub better: f64,
}

/// One scene at one stop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BridgeCase {
    /// The scene's item key.
    pub scene: String,
    /// `adjacent` or `direct`.
    pub stop: String,
    /// The method.
    pub method: String,
    /// Sample count before.
    pub from_spp: u64,
    /// Sample count after.
    pub to_spp: u64,
    /// PSNR against the real I_m, linear.
    #[serde(with = "infinite")]
    pub psnr: f64,
    /// Cosine between the update that was made and the real one, I_m - I_k; none for hold, which makes none.
    pub direction: Option<f64>,
}

/// JSON has no infinity: `null` stands for it.
mod infinite {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(value: &f64, to: S) -> Result<S::Ok, S::Error> {
        if value.is_finite() { Some(*value) } else { None }.serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
        Ok(Option::<f64>::deserialize(from)?.unwrap_or(f64::INFINITY))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn infinite_values_survive_json() {
        let metrics = Metrics {
            hdr_psnr: f64::INFINITY,
            hdr_psnr_max: 30.5,
            hdr_mae: 0.0,
            preview_psnr: f64::INFINITY,
            preview_mae: 0.0,
            ssim: 1.0,
        };
        let text = serde_json::to_string(&metrics).expect("plain data");
        assert_eq!(serde_json::from_str::<Metrics>(&text).expect("own text"), metrics);
        for name in METRICS {
            assert!(metrics.get(name).is_some());
        }
        assert!(metrics.get("lpips").is_none() && higher_is_better("ssim") && !higher_is_better("hdr_mae"));
    }
}
