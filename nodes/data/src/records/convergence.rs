//! How real ladders keep to the law of variance time, as `convergence` hands it on.

use super::Estimate;
use crate::SamplerKind;
use serde::{Deserialize, Serialize};
use tauflow_contract::json_media;

/// A scene whose tail index is below this is flagged: with an index below 2 a distribution has no variance.
pub const HEAVY_INDEX: f64 = 2.0;
/// A scene whose excess kurtosis is above this is flagged: only means of more samples than this have one of at most 1.
pub const HEAVY_KURTOSIS: f64 = 100.0;
/// A scene with more than this share of its variance in 1% of its pixels is flagged.
pub const HEAVY_SHARE: f64 = 0.5;
/// Up to this Kolmogorov distance from the normal distribution, errors of pixels count as what variance time has them.
pub const OFF_NORMAL: f64 = 0.1;
/// A deviation of at most this value, including two standard errors, agrees.
pub const TOLERANCE: f64 = 0.2;
/// A deviation of more standard errors than this differs: one in 16,000 by chance.
pub const DIFFERS: f64 = 4.0;

/// The results of `convergence`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Convergence {
    /// Samples per pixel of the references, which share no sample with the ladders.
    pub reference_spp: u64,
    /// Sample counts of the rungs.
    pub counts: Vec<u64>,
    /// How the samples of the ladders were drawn. Only independent ones have moments, and the SDE beside them.
    #[serde(default, skip_serializing_if = "SamplerKind::is_independent")]
    pub sampler: SamplerKind,
    /// All scenes.
    pub overall: ConvergenceRow,
    /// By stratum.
    pub strata: Vec<ConvergenceRow>,
    /// By scene.
    pub scenes: Vec<SceneConvergence>,
    /// The Monte Carlo SDE beside the ladders of all scenes; none if no scene has noise.
    pub sde: Vec<SdeRow>,
}

/// Whether two figures are the same, as far as can be told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Agreement {
    /// They are within [`TOLERANCE`] of each other, two standard errors included.
    Agrees,
    /// They are more than [`DIFFERS`] standard errors apart.
    Differs,
    /// Neither: the standard error is too large.
    Undecided,
}

impl Agreement {
    /// The verdict on two figures with this difference and standard error.
    pub fn of(difference: f64, error: f64) -> Self {
        let size = difference.abs();
        if size > DIFFERS * error {
            Self::Differs
        } else if size + 2.0 * error <= TOLERANCE {
            Self::Agrees
        } else {
            Self::Undecided
        }
    }

    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Agrees => "agrees",
            Self::Differs => "differs",
            Self::Undecided => "undecided",
        }
    }
}

/// Deviations below this share of a pixel's value are rounding, not noise: images are kept in single precision.
const ROUNDING: f64 = 1e-4;

/// The standard deviation of the samples of two sets as one: of each its count and variance; `apart` is the difference
/// of their means. None where it is no more than rounding of `value`.
pub fn deviation_of_both([(n, own), (m, other)]: [(u64, f64); 2], apart: f64, value: f64) -> Option<f64> {
    let (n, m) = (n as f64, m as f64);
    let squares = (n - 1.0) * own + (m - 1.0) * other + apart * apart * n * m / (n + m);
    let deviation = (squares / (n + m - 1.0)).sqrt();
    (deviation > ROUNDING * value.abs()).then_some(deviation)
}

/// Whether images of `spp` samples per pixel share them with their reference of `reference` samples.
///
/// Judged by `value`, the mean of ((I_n - R)^2/S^2 - 1/N) n, and its standard error `error`. The mean is 1 if they are
/// independent, and 1 - 2 min(n/N, 1) if the fewer are among the more; the middle of these is the line.
pub fn shares_samples(value: f64, error: f64, spp: u64, reference: u64) -> bool {
    value + 4.0 * error < 1.0 - (spp as f64 / reference as f64).min(1.0)
}

/// A figure of real ladders against the law's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AgainstLaw {
    /// The figure.
    pub value: f64,
    /// Its standard error.
    pub error: f64,
    /// How many standard errors it is above the law's.
    pub z: f64,
    /// The verdict.
    pub verdict: Agreement,
}

impl AgainstLaw {
    /// A figure that the law has as `law`; its standard error is positive.
    pub fn new(value: f64, error: f64, law: f64) -> Self {
        Self { value, error, z: (value - law) / error, verdict: Agreement::of(value - law, error) }
    }
}

/// The scenes of a stratum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConvergenceRow {
    /// The stratum, e.g. `L1-open`; `all` for all.
    pub stratum: String,
    /// Number of scenes.
    pub scenes: u64,
    /// How many of the scenes have no noise: no error to speak of and no slope, so that `rmse`, `law` and `slope` are
    /// of the others.
    pub noiseless: u64,
    /// Rungs of all scenes with noise that are unresolved ([`SceneConvergence::unresolved`]): `rmse`, `law` and `slope`
    /// are without them.
    pub unresolved: u64,
    /// Geometric mean of the RMSE of each rung, exposed linear radiance, the reference's own noise taken off, over the
    /// scenes with noise for which the rung is not unresolved; 0 if it is for all. Empty if no scene has noise.
    pub rmse: Vec<f64>,
    /// The same, over the same scenes, as the law has it from the samples' own variance: sqrt(sigma^2/n). It is the
    /// error of as many independent samples, however those of the ladders were drawn.
    pub law: Vec<f64>,
    /// Mean over scenes of the slope of log RMSE on log n, with its interval; the law says -1/2. Both scenes and their
    /// blocks of pixels are resampled, so that the interval of a single scene is that over its pixels. None if no scene
    /// has a slope.
    pub slope: Option<Estimate>,
    /// For each rung the mean error of a pixel in units of its own sigma/sqrt(n), 0 by the law; empty if no scene has
    /// noise.
    pub mean: Vec<AgainstLaw>,
    /// For each rung m and those up to it, n: Cov(I_n, I_m) over sigma^2/m, each pixel in units of its own deviation, 1
    /// by the law; variances last in each row. Empty if no scene has noise.
    pub covariance: Vec<Vec<AgainstLaw>>,
    /// Median over scenes of the mean over pixels of the excess kurtosis of single samples; none without noise.
    pub excess_kurtosis: Option<f64>,
    /// Median over scenes of the tail index of single samples (Hill's estimate over the largest hundredth); none
    /// without them.
    pub tail_index: Option<f64>,
    /// For each rung the mean over scenes of [`SceneConvergence::off_normal`]; empty if no scene has noise.
    pub off_normal: Vec<f64>,
    /// The first rung from which on `off_normal` is at most [`OFF_NORMAL`]; none if no rung is.
    pub trusted_from: Option<u64>,
    /// Mean over scenes of the share of variance in the 1% of pixels that vary most.
    pub tail_share: f64,
    /// How many of the scenes are flagged.
    pub heavy_scenes: u64,
    /// True if half of the scenes or more are flagged.
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
    /// Slope of log RMSE on log n, with a bootstrap 95% interval over blocks of pixels; none without noise, or if all
    /// rungs but one are unresolved.
    pub slope: Option<Estimate>,
    /// Rungs whose mean square error is not positive once the reference's own noise is taken off: they have no
    /// logarithm, and the slope is without them. 0 without noise.
    pub unresolved: u64,
    /// For each rung Var(I_n) over sigma^2/n, each pixel in units of its own deviation, 1 by the law; empty without
    /// noise.
    pub variance: Vec<AgainstLaw>,
    /// Mean over pixels of the excess kurtosis of single samples; none without noise.
    pub excess_kurtosis: Option<f64>,
    /// Tail index of single samples, each in units of its pixel's deviation; none if the ladder has no two rungs that
    /// are one sample apart, or there are too few.
    pub tail_index: Option<f64>,
    /// Share of variance in the 1% of pixels that vary most.
    pub tail_share: f64,
    /// For each rung how far the errors of pixels, in units of their own sigma/sqrt(n), are from a normal distribution:
    /// the largest difference between cumulative distributions (Kolmogorov's). Empty without noise.
    pub off_normal: Vec<f64>,
    /// The first rung from which on `off_normal` is at most [`OFF_NORMAL`]; none if no rung is.
    pub trusted_from: Option<u64>,
    /// For each rung the mean square error of the image over the law's, sigma^2/n summed over pixels as they are: where
    /// a few pixels hold most of the variance, they decide it. Empty without noise.
    pub image: Vec<f64>,
    /// The first rung from which on `image` is within [`TOLERANCE`] of 1; none if no rung is.
    pub image_from: Option<u64>,
    /// True if there is a reason to call its samples heavy-tailed.
    pub heavy_tail: bool,
    /// The reasons.
    pub reasons: Vec<String>,
    /// How far variance time can be trusted here, in words.
    pub trust: String,
}

/// A moment of the SDE and of the ladders, in the units of the law.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Beside {
    /// The value of the simulated SDE.
    pub sde: f64,
    /// Its standard error.
    pub sde_error: f64,
    /// The value of the ladders.
    pub ladders: f64,
    /// Its standard error.
    pub ladders_error: f64,
    /// How many standard errors of the difference the ladders' is above.
    pub z: f64,
    /// The verdict.
    pub verdict: Agreement,
}

impl Beside {
    /// A moment of both: the figure and its standard error, which is positive.
    pub fn new([sde, sde_error]: [f64; 2], ladders: &AgainstLaw) -> Self {
        let error = (sde_error * sde_error + ladders.error * ladders.error).sqrt();
        let difference = ladders.value - sde;
        Self {
            sde,
            sde_error,
            ladders: ladders.value,
            ladders_error: ladders.error,
            z: difference / error,
            verdict: Agreement::of(difference, error),
        }
    }
}

/// The SDE and the ladders at a rung.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SdeRow {
    /// Sample count.
    pub n: u64,
    /// The mean error in units of sigma/sqrt(n); the law says 0.
    pub mean: Beside,
    /// The variance over sigma^2/n; the law says 1.
    pub variance: Beside,
    /// The covariance with each rung before, over sigma^2/n; the law says 1.
    pub covariance: Vec<Beside>,
}

json_media! { Convergence, "tauflow/convergence", "How far ladders keep to the law of variance time."; }

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn verdicts_are_what_the_errors_allow() {
        let of = |value: f64, error: f64| AgainstLaw::new(value, error, 1.0).verdict;
        assert_eq!(of(1.05, 0.05), Agreement::Agrees);
        // Close by chance only.
        assert_eq!(of(1.0, 0.3), Agreement::Undecided);
        assert_eq!(of(1.18, 0.06), Agreement::Undecided);
        assert_eq!(of(1.05, 0.01), Agreement::Differs);
        assert_eq!(of(-1.0, 0.3), Agreement::Differs);
        let law = AgainstLaw::new(1.3, 0.03, 1.0);
        assert_eq!(law.verdict, Agreement::Differs);
        let beside = Beside::new([1.0, 0.04], &law);
        assert!((beside.z - 6.0).abs() < 1e-9 && beside.verdict == Agreement::Differs, "{beside:?}");
    }
}
