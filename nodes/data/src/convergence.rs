//! How real ladders keep to the 1/sqrt(n) law, as `ladder_convergence` hands it on.

use serde::{Deserialize, Serialize};

/// What `ladder_convergence` says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Convergence {
    /// Sample count of the last rung, which errors are measured against; it shares its samples with the others.
    pub reference_spp: u64,
    /// Sample counts of the rungs below it.
    pub counts: Vec<u64>,
    /// All scenes.
    pub overall: ConvergenceRow,
    /// By stratum.
    pub strata: Vec<ConvergenceRow>,
}

/// The scenes of a stratum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConvergenceRow {
    /// The stratum, e.g. `L1-open`; `all` for all.
    pub stratum: String,
    /// Number of scenes.
    pub scenes: u64,
    /// Geometric mean over scenes of the RMSE of each rung, exposed linear radiance.
    pub rmse: Vec<f64>,
    /// The same as the law has it from the samples' own variance: sqrt(var (1/n - 1/n_max)).
    pub law: Vec<f64>,
    /// Slope of log RMSE, corrected for the shared samples, on log n; the law says -1/2.
    pub slope: f64,
    /// Mean over scenes of the share of variance in the 1% of pixels that vary most.
    pub tail_share: f64,
    /// True if variance sits in so few pixels that the law holds late: `tail_share` above 1/2.
    pub heavy_tail: bool,
    /// Mean number of path segments.
    pub mean_path_length: f64,
    /// Contributions that were rejected as non-finite.
    pub rejected: u64,
}
