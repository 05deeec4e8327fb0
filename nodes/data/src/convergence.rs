//! How real ladders keep to the law of variance time, as `convergence` hands it on.

use crate::results::Estimate;
use serde::{Deserialize, Serialize};

/// What `convergence` says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Convergence {
    /// Samples a pixel of the references, which share no sample with the ladders.
    pub reference_spp: u64,
    /// Sample counts of the rungs.
    pub counts: Vec<u64>,
    /// All scenes.
    pub overall: ConvergenceRow,
    /// By stratum.
    pub strata: Vec<ConvergenceRow>,
    /// By scene.
    pub scenes: Vec<SceneConvergence>,
    /// The Monte Carlo SDE beside the ladders.
    pub sde: Vec<SdeRow>,
}

/// The scenes of a stratum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConvergenceRow {
    /// The stratum, e.g. `L1-open`; `all` for all.
    pub stratum: String,
    /// Number of scenes.
    pub scenes: u64,
    /// Geometric mean over scenes of the RMSE of each rung, exposed linear radiance, the reference's own noise taken off.
    pub rmse: Vec<f64>,
    /// The same as the law has it from the samples' own variance: sqrt(sigma^2/n).
    pub law: Vec<f64>,
    /// Mean over scenes of the slope of log RMSE on log n, with its interval over scenes; the law says -1/2.
    pub slope: Estimate,
    /// For each rung m and those up to it, n: the mean over scenes of Cov(I_n, I_m) over sigma^2/m, which is 1 by the law.
    pub covariance: Vec<Vec<f64>>,
    /// Median over scenes of the excess kurtosis of single samples, each in units of its pixel's deviation; none without them.
    pub excess_kurtosis: Option<f64>,
    /// Median over scenes of the tail index of these samples (Hill's estimate over the largest hundredth).
    pub tail_index: Option<f64>,
    /// The first rung at which the excess kurtosis of a pixel's mean, that of samples over n, is at most 1; none if no rung is.
    pub trusted_from: Option<u64>,
    /// Mean over scenes of the share of variance in the 1% of pixels that vary most.
    pub tail_share: f64,
    /// True if variance sits in so few pixels that one ladder may be far off the law: `tail_share` above 1/2.
    pub heavy_tail: bool,
    /// Mean number of path segments.
    pub mean_path_length: f64,
    /// Contributions that were rejected as non-finite.
    pub rejected: u64,
}

/// One scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneConvergence {
    /// The scene's item key.
    pub scene: String,
    /// Slope of log RMSE on log n, with a bootstrap 95% interval over blocks of pixels.
    pub slope: Estimate,
    /// Excess kurtosis of single samples in units of their pixels' deviations; none if the ladder has none, or no noise.
    pub excess_kurtosis: Option<f64>,
    /// Their tail index.
    pub tail_index: Option<f64>,
    /// Share of variance in the 1% of pixels that vary most.
    pub tail_share: f64,
}

/// The SDE and the ladders at a rung: how far pixels are from the reference, over what their variances say.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SdeRow {
    /// Sample count.
    pub n: u64,
    /// Mean of the simulated ones, in units of the mean deviation, times sqrt n; the law says 0.
    pub sde_mean: f64,
    /// Their variance times n; the law says 1.
    pub sde_variance: f64,
    /// Their covariance with those at the first rung, times n; the law says 1.
    pub sde_covariance: f64,
    /// The same of the real rungs.
    pub real_mean: f64,
    /// The same of the real rungs.
    pub real_variance: f64,
    /// The same of the real rungs.
    pub real_covariance: f64,
}
