//! What the network sees of a state, and the units in which it answers.

use super::{
    head::Basis,
    unet::{Inputs, Unet},
};
use crate::parameterization::{Parameterization, Space, signed_log1p};
use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use std::{ops::RangeInclusive, sync::Arc};
use tauflow_data::{maths, time::VarianceTime};
use tauflow_ops::{expm1, map, map2};

/// Numbers that tell the time.
pub(crate) const CLOCK: usize = 14;

/// Added to the deviation around a pixel: where all samples missed the light, it must still be possible to add some.
const FLOOR: f32 = 0.05;

/// Half the side, less a half, of the window that is averaged over.
const REACH: usize = 2;

/// Samples that a solver's own estimate of the clean image is worth, roughly.
const WORTH: f64 = 8.0;

/// Largest deviation of a velocity, in units of that at the start.
const STEEPEST: f64 = 16.0;

/// One state with what belongs to it.
pub(crate) struct Sample<'a> {
    /// [H, W, 3], in the training space.
    pub(crate) state: &'a [f32],
    /// [H, W, 6], for solvers that see G-buffers.
    pub(crate) gbuffer: Option<&'a [f32]>,
    /// Variance time.
    pub(crate) tau: f64,
}

/// How states become inputs: fixed by how a solver was trained.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Encoding {
    pub(crate) parameterization: Parameterization,
    pub(crate) space: Space,
    pub(crate) clock: VarianceTime,
    pub(crate) gbuffer: bool,
}

impl Encoding {
    /// Channels of the features.
    pub(crate) fn channels(&self) -> usize {
        if self.gbuffer { 12 } else { 6 }
    }

    /// Inputs of a batch of samples of `height` x `width` pixels.
    pub(crate) fn inputs(&self, device: &Device, samples: &[Sample<'_>], height: usize, width: usize) -> Inputs {
        let (pixels, channels) = (height * width, self.channels());
        let mut features = vec![0.0; samples.len() * pixels * channels];
        let mut clock = Vec::with_capacity(samples.len() * CLOCK);
        let (mut residual, mut spread) = (Vec::new(), Vec::new());
        for (sample, features) in samples.iter().zip(features.chunks_exact_mut(pixels * channels)) {
            let seen = match self.space {
                Space::Linear => map(sample.state, signed_log1p),
                Space::Log1p => sample.state.to_vec(),
            };
            let around = self.surroundings(&seen, height, width);
            let off = map2(sample.state, &around.mean, |value, mean| value - mean);
            let contrast = map2(&off, &around.spread, contrast);
            let gbuffer = sample.gbuffer.filter(|_| self.gbuffer);
            assert_eq!(gbuffer.is_some(), self.gbuffer, "the caller checks that there is a G-buffer");
            features.par_chunks_exact_mut(channels).with_min_len(1024).enumerate().for_each(|(pixel, features)| {
                let at = 3 * pixel..3 * pixel + 3;
                features[..3].copy_from_slice(&seen[at.clone()]);
                features[3..6].copy_from_slice(&contrast[at]);
                if let Some(gbuffer) = gbuffer {
                    features[6..].copy_from_slice(&gbuffer[6 * pixel..6 * pixel + 6]);
                }
            });
            clock.extend(self.time(sample.tau));
            let gain = self.gain(sample.tau) as f32;
            residual.push(map(&off, |off| off * gain));
            spread.push(map(&around.spread, |deviation| (FLOOR + deviation) * gain));
        }
        let shape = [samples.len(), height, width, channels];
        Inputs {
            features: Tensor::from_data(TensorData::new(features, shape), device),
            clock: Tensor::from_data(TensorData::new(clock, [samples.len(), CLOCK]), device),
            basis: Basis { residual: Arc::new(residual.concat()), spread: Arc::new(spread.concat()) },
        }
    }

    /// The network for such inputs.
    pub(crate) fn network(&self, preset: super::unet::Preset) -> Unet {
        Unet::new(preset, self.channels(), CLOCK)
    }

    /// How large an answer to expect at `tau`, in units of that at the start; no network should have to learn it.
    ///
    /// The target's deviation is that of the central limit theorem: the noise of mc_noise falls from 1 to nearly 0 over
    /// a ladder. What can be known of it is less, and less the cleaner the state: a Wiener filter whose own estimate is
    /// worth `WORTH` samples keeps the share 1/(1 + n/WORTH) of it.
    fn gain(&self, tau: f64) -> f64 {
        let error = |n: f64| (1.0 / n - 1.0 / self.clock.n_max()).max(0.0).sqrt();
        let count = self.clock.count(tau);
        let relative = error(count) / error(self.clock.n_min());
        let deviation = match self.parameterization {
            Parameterization::McNoise => relative,
            // Tends to infinity towards tau = 1; at 229 of 256 samples, the last call of 50, it is 5.6.
            Parameterization::McVelocity => (relative / (1.0 - tau).max(1e-9)).min(STEEPEST),
            Parameterization::LocalVelocity | Parameterization::VanillaRf => 1.0,
        };
        deviation / (1.0 + count / WORTH)
    }

    /// Smooth functions of tau. Training sees few times, rollouts many: high frequencies would not carry over.
    fn time(&self, tau: f64) -> [f32; CLOCK] {
        let mut out = [0.0; CLOCK];
        out[0] = tau as f32;
        out[1] = (maths::log(self.clock.count(tau.clamp(0.0, 1.0))) / maths::log(self.clock.n_max())) as f32;
        for i in 0..(CLOCK - 2) / 2 {
            let angle = core::f64::consts::PI * maths::exp2(i as f64 * 0.5 - 1.0) * tau;
            out[2 + 2 * i] = maths::sin(angle) as f32;
            out[3 + 2 * i] = maths::cos(angle) as f32;
        }
        out
    }

    /// What is around each pixel: mean and deviation of the logarithms over a window, as values in the training space.
    fn surroundings(&self, seen: &[f32], height: usize, width: usize) -> Surroundings {
        let averaged = |values: &[f32]| means_of_columns(&means_of_rows(values, width), height, width);
        let mean = averaged(seen);
        let spread = averaged(&map2(seen, &mean, |v, m| (v - m).abs()));
        match self.space {
            // d expm1(x) = exp(x) dx, taken over the whole deviation so that it stays positive and grows with it.
            Space::Linear => Surroundings {
                spread: map2(&mean, &spread, |mean, spread| expm1(mean.abs() + spread) - expm1(mean.abs())),
                mean: map(&mean, |mean| expm1(mean.abs()).copysign(mean)),
            },
            Space::Log1p => Surroundings { mean, spread },
        }
    }
}

/// Mean and deviation around each pixel, in the training space.
struct Surroundings {
    mean: Vec<f32>,
    spread: Vec<f32>,
}

/// How far a value is off its surroundings in units of their deviation, compressed: the same at any brightness.
#[inline(always)]
fn contrast(off: f32, spread: f32) -> f32 {
    signed_log1p(off / (FLOOR + spread))
}

/// The window around `at` on an axis of some length, and the share of each of its places.
fn window(at: usize, length: usize) -> (RangeInclusive<usize>, f32) {
    let (first, last) = (at.saturating_sub(REACH), (at + REACH).min(length - 1));
    (first..=last, 1.0 / (last - first + 1) as f32)
}

/// Means over windows along rows of pixels of three values.
fn means_of_rows(data: &[f32], width: usize) -> Vec<f32> {
    let mut out = vec![0.0; data.len()];
    out.par_chunks_exact_mut(3 * width).zip(data.par_chunks_exact(3 * width)).for_each(|(out, data)| {
        let middle = REACH.min(width)..width.saturating_sub(REACH).max(REACH.min(width));
        for at in (0..middle.start).chain(middle.end..width) {
            let (places, share) = window(at, width);
            for from in places {
                (0..3).for_each(|c| out[3 * at + c] += data[3 * from + c] * share);
            }
        }
        // Where windows are whole, a row is a row of numbers.
        let share = 1.0 / (2 * REACH + 1) as f32;
        let whole = &mut out[3 * middle.start..3 * middle.end];
        for step in (0..=2 * REACH).take_while(|_| !middle.is_empty()) {
            whole.iter_mut().zip(&data[3 * step..]).for_each(|(out, value)| *out += value * share);
        }
    });
    out
}

/// Means over windows along columns of pixels of three values.
fn means_of_columns(data: &[f32], height: usize, width: usize) -> Vec<f32> {
    let mut out = vec![0.0; data.len()];
    out.par_chunks_exact_mut(3 * width).enumerate().for_each(|(at, out)| {
        let (places, share) = window(at, height);
        for from in places {
            let row = &data[from * 3 * width..(from + 1) * 3 * width];
            out.iter_mut().zip(row).for_each(|(out, value)| *out += value * share);
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expected_answers_follow_the_central_limit_theorem() {
        let clock = VarianceTime::new(1, 256).expect("a ladder");
        let encoding = |parameterization| Encoding { parameterization, space: Space::Linear, clock, gbuffer: false };
        let deviation = |parameterization, n: f64| encoding(parameterization).gain(clock.tau(n)) * (1.0 + n / WORTH);
        let near = |a: f64, b: f64| (a - b).abs() < 1e-6 * b.max(1.0);
        for n in [1.0f64, 4.0, 64.0, 128.0] {
            let noise = ((1.0 / n - 1.0 / 256.0) / (1.0 - 1.0 / 256.0)).sqrt();
            assert!(near(deviation(Parameterization::McNoise, n), noise), "{n}");
            let velocity = noise * (1.0 - 1.0 / 16.0) / (1.0 / n.sqrt() - 1.0 / 16.0);
            assert!(near(deviation(Parameterization::McVelocity, n), velocity), "{n}");
        }
        let velocities: Vec<f64> =
            (1..2560).map(|i| deviation(Parameterization::McVelocity, f64::from(i) / 10.0)).skip(10).collect();
        assert!(velocities.windows(2).all(|w| w[1] >= w[0] - 1e-6), "never falls towards the end");
        assert!(near(velocities[velocities.len() - 1], STEEPEST));
    }

    #[test]
    fn means_are_those_of_the_window_at_any_width() {
        for (height, width) in [(1, 1), (2, 3), (4, 4), (5, 8), (9, 6)] {
            let data: Vec<f32> = (0..height * width * 3).map(|i| (i * i % 23) as f32).collect();
            let found = means_of_columns(&means_of_rows(&data, width), height, width);
            for (i, found) in found.iter().enumerate() {
                let (c, x, y) = (i % 3, i / 3 % width, i / (3 * width));
                let (rows, columns) = (window(y, height).0, window(x, width).0);
                let pixels: Vec<f32> =
                    rows.flat_map(|y| columns.clone().map(move |x| (y * width + x) * 3 + c)).map(|i| data[i]).collect();
                let expected = pixels.iter().sum::<f32>() / pixels.len() as f32;
                assert!((found - expected).abs() < 1e-4, "{height} x {width} at {i}: {found} {expected}");
            }
        }
    }

    #[test]
    fn surroundings_are_those_of_the_window() {
        let clock = VarianceTime::new(1, 256).expect("a ladder");
        let encoding =
            Encoding { parameterization: Parameterization::McNoise, space: Space::Linear, clock, gbuffer: false };
        // A lamp of 50: nothing varies, so that there is nothing to take off.
        let lamp = vec![signed_log1p(50.0); 8 * 8 * 3];
        let around = encoding.surroundings(&lamp, 8, 8);
        assert!(around.mean.iter().all(|m| (m - 50.0).abs() < 1e-3) && around.spread.iter().all(|s| s.abs() < 1e-3));
        assert!(contrast(50.0 - around.mean[0], around.spread[0]).abs() < 1e-2);
        // One firefly in the dark sets itself apart, and moves its surroundings little.
        let mut dark = vec![signed_log1p(0.1); 8 * 8 * 3];
        dark[3 * 27] = signed_log1p(1000.0);
        let around = encoding.surroundings(&dark, 8, 8);
        assert!(
            around.mean[3 * 27] < 1.0 && contrast(1000.0 - around.mean[3 * 27], around.spread[3 * 27]) > 5.0,
            "{}",
            around.mean[3 * 27]
        );
        assert_eq!(around.mean[3 * 27 + 1], around.mean[1], "other colours see nothing of it");
    }
}
