//! Adam's update (Kingma and Ba 2015) with a running average of the weights, and the squares of a gradient.

use crate::instructions::wide;
use rayon::prelude::*;

/// Numbers that are updated at once.
const PART: usize = 16_384;
/// Squares that are summed side by side.
const LANES: usize = 16;

/// Factors of an update.
#[derive(Clone, Copy, Debug)]
pub struct Adam {
    /// The factor for gradients.
    pub clip: f32,
    /// Decay rates of the moments.
    pub betas: [f64; 2],
    /// The learning rate, with the corrections of both moments.
    pub rate: f32,
    /// Added to the root of the second moment.
    pub epsilon: f32,
    /// Share that the average keeps.
    pub keep: f64,
}

impl Adam {
    /// Updates moments, weights and their average.
    ///
    /// # Panics
    /// If they are not all as long as the gradient.
    pub fn update(self, weights: &mut [f32], average: &mut [f32], moments: [&mut [f32]; 2], gradient: &[f32]) {
        let [first, second] = moments;
        let lengths = [weights.len(), average.len(), first.len(), second.len()];
        assert!(lengths.iter().all(|len| *len == gradient.len()), "{lengths:?} are as long as {}", gradient.len());
        weights
            .par_chunks_mut(PART)
            .zip(average.par_chunks_mut(PART))
            .zip(first.par_chunks_mut(PART).zip(second.par_chunks_mut(PART)))
            .zip(gradient.par_chunks(PART))
            .for_each(|(((weights, average), (first, second)), gradient)| {
                wide(
                    #[inline(always)]
                    || self.part(weights, average, first, second, gradient),
                );
            });
    }

    #[inline(always)]
    fn part(self, weights: &mut [f32], average: &mut [f32], first: &mut [f32], second: &mut [f32], gradient: &[f32]) {
        // The rest of 1 would be lost in f32.
        let [(b1, c1), (b2, c2), (keep, leave)] =
            [self.betas[0], self.betas[1], self.keep].map(|share| (share as f32, (1.0 - share) as f32));
        let moments = first.iter_mut().zip(second);
        for (((weight, average), (first, second)), g) in weights.iter_mut().zip(average).zip(moments).zip(gradient) {
            let g = g * self.clip;
            *first = b1 * *first + c1 * g;
            *second = b2 * *second + c2 * g * g;
            *weight -= self.rate * *first / (second.sqrt() + self.epsilon);
            *average = keep * *average + leave * *weight;
        }
    }
}

/// The sum of squares, in f64; its order is fixed.
pub fn square_sum(values: &[f32]) -> f64 {
    let parts: Vec<f64> = values
        .par_chunks(PART)
        .map(|part| {
            wide(
                #[inline(always)]
                || squares(part),
            )
        })
        .collect();
    parts.iter().sum()
}

#[inline(always)]
fn squares(values: &[f32]) -> f64 {
    let mut sums = [0.0f64; LANES];
    let runs = values.chunks_exact(LANES);
    let rest: f64 = runs.remainder().iter().map(|v| f64::from(*v) * f64::from(*v)).sum();
    for run in runs {
        for (sum, value) in sums.iter_mut().zip(run) {
            *sum += f64::from(*value) * f64::from(*value);
        }
    }
    sums.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_are_summed() {
        let values: Vec<f32> = (0..50_001).map(|i| (i % 7) as f32 - 3.0).collect();
        let expected: f64 = values.iter().map(|v| f64::from(*v).powi(2)).sum();
        assert_eq!(square_sum(&values), expected);
    }

    #[test]
    fn long_and_short_slices_are_updated_alike() {
        let adam = Adam { clip: 0.5, betas: [0.9, 0.99], rate: 0.1, epsilon: 1e-8, keep: 0.75 };
        let size = 3 * PART + 5;
        let gradient: Vec<f32> = (0..size).map(|i| (i % 5) as f32 - 2.0).collect();
        let run = |pick: std::ops::Range<usize>| {
            let [mut w, mut a, mut m, mut v] = [1.0f32, 2.0, 0.5, 0.25].map(|start| vec![start; pick.len()]);
            adam.update(&mut w, &mut a, [&mut m, &mut v], &gradient[pick]);
            [w, a, m, v]
        };
        let whole = run(0..size);
        for at in [0, 1, 15, 17, PART, size - 1] {
            let one = run(at..at + 1);
            assert!((0..4).all(|i| one[i][0].to_bits() == whole[i][at].to_bits()), "{at}");
        }
        // By hand, for a gradient of -2 halved: m = .45 - .1, v = .2475 + .01, w = 1 - .1 m / sqrt v.
        let (m, v) = (0.35f64, 0.2575f64);
        let w = 1.0 - 0.1 * m / v.sqrt();
        let expected = [w, 1.5 + 0.25 * w, m, v];
        assert!((0..4).all(|i| (f64::from(whole[i][0]) - expected[i]).abs() < 1e-6), "{expected:?}");
    }
}
