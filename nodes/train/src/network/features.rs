//! What the network sees of a state, and the units in which it answers.

use super::{
    head::Basis,
    unet::{Inputs, Unet},
};
use crate::parameterization::{Parameterization, Space, signed_log1p};
use burn::tensor::{Device, Tensor, TensorData};
use std::sync::Arc;
use tauflow_data::{maths, time::VarianceTime};

/// Numbers that tell the time.
pub(crate) const CLOCK: usize = 14;

/// Added to the magnitude around a pixel: about the darkest value that counts at an exposure of key 0.18.
const FLOOR: f32 = 0.05;

/// Half the side, less a half, of the window that magnitudes are averaged over.
const REACH: usize = 2;

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
        if self.gbuffer { 9 } else { 3 }
    }

    /// Inputs of a batch of samples of `height` x `width` pixels.
    pub(crate) fn inputs(&self, device: &Device, samples: &[Sample<'_>], height: usize, width: usize) -> Inputs {
        let (pixels, channels) = (height * width, self.channels());
        let mut features = Vec::with_capacity(samples.len() * pixels * channels);
        let mut clock = Vec::with_capacity(samples.len() * CLOCK);
        let mut state = Vec::with_capacity(samples.len() * pixels * 3);
        let mut magnitude = Vec::with_capacity(samples.len() * pixels * 3);
        for sample in samples {
            let seen: Vec<f32> = match self.space {
                Space::Linear => sample.state.iter().map(|v| signed_log1p(*v)).collect(),
                Space::Log1p => sample.state.to_vec(),
            };
            for (pixel, rgb) in seen.chunks_exact(3).enumerate() {
                features.extend_from_slice(rgb);
                if self.gbuffer {
                    let gbuffer = sample.gbuffer.expect("the caller checks that there is a G-buffer");
                    features.extend_from_slice(&gbuffer[pixel * 6..pixel * 6 + 6]);
                }
            }
            clock.extend(self.time(sample.tau));
            let gain = self.gain(sample.tau) as f32;
            state.extend(sample.state.iter().map(|v| v * gain));
            magnitude.extend(self.magnitude(&seen, height, width).into_iter().map(|v| v * gain));
        }
        let shape = [samples.len(), height, width, channels];
        Inputs {
            features: Tensor::from_data(TensorData::new(features, shape), device),
            clock: Tensor::from_data(TensorData::new(clock, [samples.len(), CLOCK]), device),
            basis: Basis { state: Arc::new(state), magnitude: Arc::new(magnitude) },
        }
    }

    /// The network for such inputs.
    pub(crate) fn network(&self, preset: super::unet::Preset) -> Unet {
        Unet::new(preset, self.channels(), CLOCK)
    }

    /// The deviation that the central limit theorem expects of the target at `tau`, in units of that at the start: the
    /// noise of mc_noise falls from 1 to nearly 0 over a ladder, and no network should have to learn that.
    fn gain(&self, tau: f64) -> f64 {
        let error = |n: f64| (1.0 / n - 1.0 / self.clock.n_max()).max(0.0).sqrt();
        let relative = error(self.clock.count(tau)) / error(self.clock.n_min());
        match self.parameterization {
            Parameterization::McNoise => relative,
            // Towards tau = 1 this tends to infinity, slowly; it is 4.6 at half a sample before n_max = 256.
            Parameterization::McVelocity => relative / (1.0 - tau).max(1e-3),
            Parameterization::LocalVelocity | Parameterization::VanillaRf => 1.0,
        }
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

    /// How large values around each pixel are: the mean of their logarithm over a window, as a linear value.
    fn magnitude(&self, seen: &[f32], height: usize, width: usize) -> Vec<f32> {
        if self.space == Space::Log1p {
            return vec![1.0; seen.len()];
        }
        let sizes: Vec<f32> = seen.iter().map(|v| v.abs()).collect();
        let across = window_means(&sizes, 3, width);
        let both = window_means(&across, 3 * width, height);
        both.into_iter().map(|v| FLOOR + maths::expm1f(v)).collect()
    }
}

/// Means over windows along one axis: of `length` elements `stride` apart, whatever axes are outside.
fn window_means(data: &[f32], stride: usize, length: usize) -> Vec<f32> {
    let mut out = vec![0.0; data.len()];
    for (data, out) in data.chunks_exact(stride * length).zip(out.chunks_exact_mut(stride * length)) {
        for at in 0..length {
            let (first, last) = (at.saturating_sub(REACH), (at + REACH).min(length - 1));
            let share = 1.0 / (last - first + 1) as f32;
            let out = &mut out[at * stride..(at + 1) * stride];
            for from in first..=last {
                for (out, value) in out.iter_mut().zip(&data[from * stride..(from + 1) * stride]) {
                    *out += value * share;
                }
            }
        }
    }
    out
}
