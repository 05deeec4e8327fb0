//! Error against time, as `time_error` hands it on.

use super::{Estimate, has_intervals};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use tauflow_contract::json_media;

/// The results of `time_error`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimeError {
    /// The machine of the timings.
    pub machine: Value,
    /// Samples per pixel of the held-out references.
    pub reference_spp: u64,
    /// Number of scenes.
    pub scenes: u64,
    /// Number of groups of them that intervals are over; none where each scene stands for itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub groups: Option<u64>,
    /// Number of bootstrap resamples.
    pub resamples: u64,
    /// The path tracer first, then the others by name.
    pub methods: Vec<TimedMethod>,
    /// Omitted methods, with the reasons.
    pub notes: Vec<String>,
}

/// A method, from every endpoint and at every NFE that was timed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimedMethod {
    /// Such as `mc_noise`, `oidn`, `path_tracer`.
    pub method: String,
    /// Its additional input: `rgb` or `gbuffer`; empty for a renderer.
    pub conditioning: String,
    /// Other coordinates of its cell.
    pub cell: BTreeMap<String, String>,
    /// By samples, then NFE.
    pub points: Vec<TimedPoint>,
    /// How long it takes to errors that are asked for.
    pub targets: Vec<TimeTo>,
    /// The same by stratum.
    pub strata_targets: BTreeMap<String, Vec<TimeTo>>,
}

/// A method at one point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimedPoint {
    /// Samples per pixel that were rendered.
    pub from_spp: u64,
    /// Network calls.
    pub nfe: u64,
    /// Each scene, in the order of their names.
    pub scenes: Vec<TimedScene>,
    /// All scenes.
    pub all: TimedSummary,
    /// By stratum.
    pub strata: BTreeMap<String, TimedSummary>,
    /// Against the path tracer; none for itself.
    pub versus: Option<VersusRendering>,
}

/// Scenes at one point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimedSummary {
    /// How many.
    pub scenes: u64,
    /// Number of groups of them that intervals are over; none where each scene stands for itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub groups: Option<u64>,
    /// Seconds of wall time from a scene's files to the image: quartiles over scenes.
    pub wall_s: [f64; 3],
    /// The same of processor time.
    pub cpu_s: [f64; 3],
    /// Geometric mean over scenes of the mean squared error, exposed linear radiance, less the reference's own.
    pub mse: f64,
    /// The same of errors relative to the reference, (x - r)^2/(r^2 + 0.01).
    pub rel_mse: f64,
    /// Mean PSNR of exposed linear radiance, peak 1, in dB.
    pub hdr_psnr: f64,
    /// Mean PSNR of previews, in dB.
    pub preview_psnr: f64,
    /// Mean structural similarity of previews.
    pub ssim: f64,
    /// Geometric mean of the samples per pixel after which the path tracer has the same error; none for itself. For a
    /// single scene or group, the interval is a point and has no meaning.
    pub crossover_spp: Option<Estimate>,
    /// Share of scenes whose crossover lies beyond the last rung that was timed, where the law of 1/n stands in for a
    /// measurement; 0 for the path tracer itself.
    pub extrapolated: f64,
    /// Geometric mean of the path tracer's time to the same error over this time; none for itself. For a single scene
    /// or group, the interval is a point and has no meaning.
    pub speed_up: Option<Estimate>,
}

impl TimedSummary {
    /// Whether its ratios have intervals.
    pub fn has_intervals(&self) -> bool {
        has_intervals(self.scenes, self.groups)
    }
}

/// One scene at one point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimedScene {
    /// Its key.
    pub scene: String,
    /// Seconds of wall time from its files to the image: quartiles of the times that it was made; of parts that were
    /// timed apart, their sums.
    pub wall_s: [f64; 3],
    /// The same of processor time.
    pub cpu_s: [f64; 3],
    /// Mean squared error, exposed linear radiance, less the reference's own.
    pub mse: f64,
    /// The same of errors relative to the reference.
    pub rel_mse: f64,
    /// PSNR of exposed linear radiance, dB; at most what is counted in means.
    pub hdr_psnr: f64,
    /// PSNR of the preview, dB; at most what is counted in means.
    pub preview_psnr: f64,
    /// Structural similarity of the preview.
    pub ssim: f64,
    /// Whether the reference's own noise hides the error, so that a thousandth of what was measured stands for it.
    pub unresolved: bool,
    /// Samples per pixel after which the path tracer has the same error; none for itself.
    pub crossover_spp: Option<f64>,
    /// The path tracer's time to the same error over this time; none for itself.
    pub speed_up: Option<f64>,
}

/// A method against the path tracer that is given the same wall time, paired by scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VersusRendering {
    /// Median samples per pixel that the path tracer gets to in that time.
    pub spp: f64,
    /// Gain in PSNR of linear radiance, dB.
    pub hdr_psnr: Estimate,
    /// Gain in PSNR of previews, dB.
    pub preview_psnr: Estimate,
    /// Gain in structural similarity.
    pub ssim: Estimate,
    /// Share of scenes with a gain in PSNR of linear radiance.
    pub better: f64,
}

/// How long a method takes to an error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimeTo {
    /// `hdr_psnr` or `rel_mse`.
    pub metric: String,
    /// The value.
    pub target: f64,
    /// Share of scenes that get there, at any point that was measured; rendering alone anywhere up to its last.
    pub reached: f64,
    /// Median over all scenes of the least wall time; none where fewer than half of them get there.
    pub wall_s: Option<f64>,
}

/// Indices of the points (time, error) that no other is both faster and better than, the fastest first.
pub fn front(points: &[(f64, f64)]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|a, b| points[*a].0.total_cmp(&points[*b].0).then(points[*a].1.total_cmp(&points[*b].1)));
    let mut least = f64::INFINITY;
    order.retain(|at| {
        let on = points[*at].1 < least;
        least = least.min(points[*at].1);
        on
    });
    order
}

json_media! { TimeError, "tauflow/time-error", "Errors, times and derived figures per method."; }

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_has_what_nothing_else_is_both_faster_and_better_than() {
        // A path tracer at 8 counts of samples, and a solver that is as good as 100 after the time of 21.
        let mut points: Vec<(f64, f64)> =
            (0..8).map(|k| f64::from(1 << k)).map(|n| (0.1 + 0.01 * n, 1.0 / n)).collect();
        points.push((0.31, 0.01));
        assert_eq!(front(&points), [0, 1, 2, 3, 4, 8, 7]);
        // At equal time the better one is used, and at equal error the faster one.
        assert_eq!(front(&[(1.0, 2.0), (1.0, 1.0), (2.0, 1.0)]), [1]);
        assert!(front(&[]).is_empty());
    }
}
