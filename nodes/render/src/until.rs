//! Samples until an image is as accurate as is asked for.
//!
//! A render that stops when its own samples agree keeps images that missed rare light: those agree soonest. So samples
//! of two other streams decide, and the image knows nothing of them. Its expectation is that of a fixed number of
//! samples.

use crate::{
    accumulator::Accumulator,
    bins::{KEY, geometric_mean_luminance},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::ParamProblem;
use tauflow_data::{SamplerKind, rng::mix};

/// Label of the first stream that decides; that of the second comes next.
const DECIDES: u64 = 0x6465_6369_6465;
/// Samples of the image for each of a stream that decides.
const SHARE: u64 = 8;
/// Samples that decide at least: fewer say little of a variance.
const LEAST: u64 = 64;
/// What is added to the square of an exposed mean: errors in shadow count less, as one sees them less.
const FLOOR: f64 = 0.01;

/// How accurate an image has to be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Until {
    /// Root mean square of the standard errors of exposed pixels, over sqrt(mean^2 + 0.01).
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub relative_error: f64,
    /// Samples a pixel at most.
    #[schemars(range(min = 1, max = 1_073_741_824))]
    pub at_most: u64,
}

impl Until {
    /// What is wrong with it, in a ladder that ends with so many samples otherwise.
    pub fn check(&self, last: u64, sampler: SamplerKind) -> Vec<ParamProblem> {
        let mut problems = Vec::new();
        if !(self.relative_error.is_finite() && self.relative_error > 0.0) {
            let remedy = "use for example 0.01, which is 1%";
            problems.push(ParamProblem::new("/until/relative_error", "an error must be above 0".to_owned(), remedy));
        }
        if self.at_most < last {
            let what = format!("`at_most: {}` is less than the last rung, {last}", self.at_most);
            problems.push(ParamProblem::new("/until/at_most", what, "raise it, or end `rungs` earlier"));
        }
        if sampler != SamplerKind::Independent {
            let what =
                "the variance of samples says how far a mean is off only where samples are independent".to_owned();
            problems.push(ParamProblem::new(
                "/until",
                what,
                "use `sampler: independent`, or a fixed number of samples",
            ));
        }
        problems
    }

    /// The number of samples at which the error is there, doubled from `first` on, or the most there may be, and the
    /// error that is to be expected there. `error` says it of a number of samples.
    ///
    /// # Errors
    /// Those of `error`.
    pub fn stop<E>(&self, first: u64, mut error: impl FnMut(u64) -> Result<f64, E>) -> Result<(u64, f64), E> {
        let mut stop = first;
        loop {
            let expected = error(stop)?;
            if expected <= self.relative_error || stop >= self.at_most {
                return Ok((stop, expected));
            }
            stop = stop.saturating_mul(2).min(self.at_most);
        }
    }

    /// Where a render of a stream ends that has `first` samples at least, and the error that is to be expected there.
    /// The samples of two other streams decide, which begin with `begin`. `advance` brings the state of a stream to so
    /// many samples.
    ///
    /// # Errors
    /// Those of `advance`.
    pub fn decide<E>(
        &self,
        stream: u64,
        first: u64,
        begin: impl Fn() -> Accumulator,
        mut advance: impl FnMut(&mut Accumulator, u64, u64) -> Result<(), E>,
    ) -> Result<(u64, f64), E> {
        let mut states = [begin(), begin()];
        self.stop(first, |samples| {
            let trial = trial(samples);
            for (state, stream) in states.iter_mut().zip(deciding(stream)) {
                if state.count < trial {
                    advance(state, stream, trial)?;
                }
            }
            Ok(relative_error([&states[0], &states[1]], samples))
        })
    }
}

/// The streams that decide for another.
pub fn deciding(stream: u64) -> [u64; 2] {
    [mix(stream, DECIDES), mix(stream, DECIDES + 1)]
}

/// How many samples of each of the two decide whether so many are enough.
pub fn trial(samples: u64) -> u64 {
    (samples / SHARE).max(LEAST)
}

/// The error that the mean of so many samples is to be expected to have, by what others say. It is the root mean over
/// pixels and channels of variance / (n (mean^2 + 0.01)). The exposure brings the geometric mean luminance to 0.18. A
/// black image has no error.
///
/// Variances are of one of the two, and means of the other, each way round. A rare bright sample raises the variance
/// and the mean of the pixel that it hits. By one render alone, an image of such pixels would seem accurate, though
/// most pixels have yet to be hit.
pub fn relative_error(by: [&Accumulator; 2], samples: u64) -> f64 {
    let (means, variances) = (by.map(Accumulator::mean), by.map(Accumulator::variance));
    let brightness: f64 = means.iter().map(|mean| 0.5 * geometric_mean_luminance(mean)).sum();
    let exposure = KEY / brightness;
    let (mut sum, mut count) = (0.0, 0u64);
    for (variance, mean) in [(&variances[0], &means[1]), (&variances[1], &means[0])] {
        for (v, m) in variance.data().iter().zip(mean.data()) {
            let m = f64::from(*m) * exposure;
            sum += f64::from(*v) * exposure * exposure / (m * m + FLOOR);
            count += 1;
        }
    }
    (sum / (count.max(1) as f64 * samples.max(1) as f64)).sqrt()
}
