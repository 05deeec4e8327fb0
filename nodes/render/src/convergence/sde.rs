//! The Monte Carlo SDE, simulated, beside the real ladders.
//!
//! dY = 2 (mu - Y)/(1 - s) ds + sigma sqrt(2 (1 - s)) dW on the clock s = 1 - 1/sqrt n, from a normal start at the
//! first rung. Units are those of sigma, with mu at 0: every pixel has its own, and moments are taken in these units.
//! It is solved by Heun's method, which for additive noise is of weak order 2 (Kloeden and Platen 1992, section 15.1).

use tauflow_data::{
    SdeTime,
    maths::{log2, pow},
    records::{AgainstLaw, Beside, SdeRow},
    rng::Stream,
};

/// Steps while n doubles.
const STEPS: f64 = 16.0;
/// Paths.
const PATHS: usize = 65_536;

/// Moments of the simulated paths, each with its standard error.
pub(super) struct Simulated {
    /// For each rung, in units of sigma/sqrt(n).
    mean: Vec<[f64; 2]>,
    /// For each rung m and those up to it, in units of sigma^2/m.
    covariance: Vec<Vec<[f64; 2]>>,
}

/// Simulates the SDE over these rungs.
pub(super) fn simulate(counts: &[u64], stream: &mut Stream) -> Simulated {
    let legs: Vec<Leg> = counts.windows(2).map(|pair| Leg::new(pair[0], pair[1])).collect();
    let counts: Vec<f64> = counts.iter().map(|n| *n as f64).collect();
    let mut mean = vec![PathSums::default(); counts.len()];
    let mut covariance: Vec<Vec<PathSums>> = (0..counts.len()).map(|m| vec![PathSums::default(); m + 1]).collect();
    let mut path = vec![0.0; counts.len()];
    for _ in 0..PATHS {
        path[0] = stream.normal() / counts[0].sqrt();
        for (k, leg) in legs.iter().enumerate() {
            path[k + 1] = leg.go(path[k], stream);
        }
        for (m, count) in counts.iter().enumerate() {
            mean[m].add(path[m] * count.sqrt());
            for (sums, earlier) in covariance[m].iter_mut().zip(&path) {
                sums.add(path[m] * earlier * count);
            }
        }
    }
    Simulated {
        mean: mean.iter().map(PathSums::figure).collect(),
        covariance: covariance.iter().map(|row| row.iter().map(PathSums::figure).collect()).collect(),
    }
}

impl Simulated {
    /// Moments of the SDE at each rung.
    pub(super) fn rows(&self, counts: &[u64], mean: &[AgainstLaw], covariance: &[Vec<AgainstLaw>]) -> Vec<SdeRow> {
        let row = |(k, (mean, real)): (usize, (&AgainstLaw, &Vec<AgainstLaw>))| {
            let mut covariance: Vec<Beside> =
                self.covariance[k].iter().zip(real).map(|(sde, ladders)| Beside::new(*sde, ladders)).collect();
            let variance = covariance.pop()?;
            Some(SdeRow { n: counts[k], mean: Beside::new(self.mean[k], mean), variance, covariance })
        };
        mean.iter().zip(covariance).enumerate().filter_map(row).collect()
    }
}

/// From one rung to the next, in steps that shrink 1 - s by the same factor.
struct Leg {
    /// 1 - s at the start.
    start: f64,
    factor: f64,
    steps: usize,
}

impl Leg {
    fn new(from: u64, to: u64) -> Self {
        let left = |count: u64| 1.0 - SdeTime::of_count(count as f64).0;
        let steps = (STEPS * log2(to as f64 / from as f64)).ceil().max(1.0);
        Self { start: left(from), factor: pow(left(to) / left(from), 1.0 / steps), steps: steps as usize }
    }

    fn go(&self, mut value: f64, stream: &mut Stream) -> f64 {
        let mut left = self.start;
        for _ in 0..self.steps {
            let after = left * self.factor;
            let step = left - after;
            // The integral of 2 (1 - s) over the step.
            let noise = (left * left - after * after).sqrt() * stream.normal();
            let drift = -2.0 * value / left;
            let predicted = value + drift * step + noise;
            value += 0.5 * (drift - 2.0 * predicted / after) * step + noise;
            left = after;
        }
        value
    }
}

/// Sums over paths.
#[derive(Clone, Copy, Debug, Default)]
struct PathSums {
    sum: f64,
    squares: f64,
}

impl PathSums {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.squares += value * value;
    }

    fn figure(&self) -> [f64; 2] {
        let value = self.sum / PATHS as f64;
        [value, ((self.squares / PATHS as f64 - value * value).max(f64::MIN_POSITIVE) / PATHS as f64).sqrt()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sde_has_the_moments_of_the_law_at_every_rung() {
        for counts in [&[1, 2, 4, 8, 16, 32, 64, 128, 256, 512][..], &[1, 2, 3, 4, 5], &[4, 64, 512]] {
            let found = simulate(counts, &mut Stream::new(9, &[]));
            for (m, row) in found.covariance.iter().enumerate() {
                let [mean, error] = found.mean[m];
                assert!(mean.abs() < 4.0 * error && error < 0.005, "{counts:?} {m}: {mean} +- {error}");
                for (n, [value, error]) in row.iter().enumerate() {
                    assert!((value - 1.0).abs() < 4.0 * error, "{counts:?} {m} {n}: {value} +- {error}");
                    // Standard errors are those of products of normal variables.
                    let expected = ((counts[m] as f64 / counts[n] as f64 + 1.0) / PATHS as f64).sqrt();
                    assert!((error / expected - 1.0).abs() < 0.05, "{error} {expected}");
                }
            }
        }
    }
}
