//! The Monte Carlo SDE, simulated pixel by pixel, beside the real ladders.
//!
//! dY = 2 (mu - Y)/(1 - s) ds + sigma sqrt(2 (1 - s)) dW on the clock s = 1 - 1/sqrt n, from a normal start at the first rung,
//! by the method of Euler and Maruyama. Pixels are pooled: sums of products are over the sum of the pixels' variances, so that a pixel
//! whose variance the reference has missed does not count for all.

use tauflow_data::{SdeTime, convergence::SdeRow, ladder::Ladder, rng::Stream};

/// Steps between two rungs.
const STEPS: usize = 32;
/// Values of a scene that are simulated, at most.
const PATHS: usize = 4096;

/// Sums over pixel values.
#[derive(Clone, Debug, Default)]
pub(super) struct Sde {
    count: f64,
    /// Of the pixels.
    variance: f64,
    /// For each rung: sums of the value, its square, and its product with that at the first rung; simulated, then real.
    simulated: Vec<[f64; 3]>,
    real: Vec<[f64; 3]>,
}

impl Sde {
    /// Takes in a scene of this exposure.
    pub(super) fn add(&mut self, ladder: &Ladder, reference: &Ladder, factor: f64, stream: &mut Stream) {
        let Some(truth) = reference.rungs.last() else { return };
        let counts = &ladder.meta.counts;
        self.simulated.resize(counts.len(), [0.0; 3]);
        self.real.resize(counts.len(), [0.0; 3]);
        let values = ladder.variance.data().len();
        for at in (0..values).step_by(values.div_ceil(PATHS)) {
            let deviation = f64::from(reference.variance.data()[at]).sqrt() * factor;
            if deviation.is_nan() || deviation <= 0.0 {
                continue;
            }
            self.count += 1.0;
            self.variance += deviation * deviation;
            let first = 1.0 / (counts[0] as f64).sqrt();
            let mut path = first * stream.normal();
            let start = path;
            let mut real_start = 0.0;
            for (k, n) in counts.iter().enumerate() {
                if k > 0 {
                    path = go(path, SdeTime::of_count(counts[k - 1] as f64), SdeTime::of_count(*n as f64), stream);
                }
                let difference = f64::from(ladder.rungs[k].image.data()[at]) - f64::from(truth.image.data()[at]);
                let (path, start) = (path * deviation, start * deviation);
                let real = difference * factor;
                if k == 0 {
                    real_start = real;
                }
                // The reference is off, too, by 1/reference of the variance, and is in both factors.
                let own = deviation * deviation / truth.spp as f64;
                for (sums, found) in [
                    (&mut self.simulated[k], [path, path * path, path * start]),
                    (&mut self.real[k], [real, real * real - own, real * real_start - own]),
                ] {
                    sums.iter_mut().zip(found).for_each(|(sum, v)| *sum += v);
                }
            }
        }
    }

    /// What there is at each rung.
    pub(super) fn rows(&self, counts: &[u64]) -> Vec<SdeRow> {
        let row = |(k, n): (usize, &u64)| {
            let scaled = |sums: &[f64; 3]| {
                let (n, variance) = (*n as f64, self.variance.max(f64::MIN_POSITIVE));
                let mean = sums[0] * n.sqrt() / (self.count.max(1.0) * variance).sqrt();
                [mean, sums[1] / variance * n, sums[2] / variance * n]
            };
            let (sde, real) = (scaled(&self.simulated[k]), scaled(&self.real[k]));
            SdeRow {
                n: *n,
                sde_mean: sde[0],
                sde_variance: sde[1],
                sde_covariance: sde[2],
                real_mean: real[0],
                real_variance: real[1],
                real_covariance: real[2],
            }
        };
        if self.simulated.is_empty() { Vec::new() } else { counts.iter().enumerate().map(row).collect() }
    }
}

/// From one time to another, in steps that shrink 1 - s by the same factor.
fn go(mut value: f64, from: SdeTime, to: SdeTime, stream: &mut Stream) -> f64 {
    let left = |time: SdeTime| 1.0 - time.0;
    let factor = tauflow_data::maths::pow(left(to) / left(from), 1.0 / STEPS as f64);
    let mut rest = left(from);
    for _ in 0..STEPS {
        let step = rest * (1.0 - factor);
        // The middle of the step's time: half a step's error less in the variance.
        let middle = rest - 0.5 * step;
        value += -2.0 * value / middle * step + (2.0 * middle * step).sqrt() * stream.normal();
        rest *= factor;
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convergence::measure::tests::{COUNTS, ladder};

    #[test]
    fn the_sde_has_the_moments_of_a_real_ladder_at_every_rung() {
        let (mut a, mut b) = (Stream::new(1, &[0]), Stream::new(1, &[1]));
        let mut sde = Sde::default();
        for scene in 0..8 {
            let own = ladder(&COUNTS, |_| 1.0 + 0.5 * a.normal());
            let reference = ladder(&[1024], |_| 1.0 + 0.5 * b.normal());
            sde.add(&own, &reference, 2.0, &mut Stream::new(9, &[scene]));
        }
        let rows = sde.rows(&COUNTS);
        // 13,824 paths: variances within 1.2%, covariances with the first rung within n/sqrt(paths).
        for row in rows {
            let noise = 4.0 * ((row.n as f64).max(2.0) / 13_824.0).sqrt();
            assert!((row.sde_variance - 1.0).abs() < 0.06 && (row.real_variance - 1.0).abs() < 0.06, "{row:?}");
            assert!(row.sde_mean.abs() < 0.04 && row.real_mean.abs() < 0.08, "{row:?}");
            assert!(
                (row.sde_covariance - 1.0).abs() < 0.02 + noise && (row.real_covariance - 1.0).abs() < 0.02 + noise,
                "{row:?}"
            );
        }
    }
}
