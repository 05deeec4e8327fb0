//! The two ends of the network that are not learned: what the last layer's numbers mean, and the loss.

use super::op::apply;
use burn::tensor::Tensor;
use rayon::prelude::*;
use std::sync::Arc;
use tauflow_ops::Operator;

/// Channels that the last layer has for the three of an image.
pub(crate) const RAW: usize = 6;

/// Pixels that a thread does at least.
const PIXELS: usize = 1024;

/// What the last layer's numbers are multiplied with: f = residual g + spread r, for raw values (g, r).
///
/// Targets are as heavy-tailed as the states themselves: a firefly of a thousand asks for an output of a thousand. Through
/// `g` the network takes off a share of what sets a pixel apart from its surroundings, and through `r` it works in units
/// of how much these vary. Where nothing varies, in a lamp of a thousand too, there is no noise and little to get wrong.
#[derive(Clone, Debug)]
pub(crate) struct Basis {
    /// [N, H, W, 3].
    pub(crate) residual: Arc<Vec<f32>>,
    /// [N, H, W, 3].
    pub(crate) spread: Arc<Vec<f32>>,
}

/// `raw` [N, H, W, 6] in a basis, [N, H, W, 3].
pub(crate) fn expand(raw: Tensor<4>, basis: Basis) -> Tensor<4> {
    let [images, height, width, channels] = raw.dims();
    assert_eq!(channels, RAW, "two numbers for each colour");
    apply(basis, [raw.into()], [images, height, width, 3])
}

impl Operator<1> for Basis {
    type Saved = ();

    fn forward(&self, [raw]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        let mut out = vec![0.0; raw.len() / 2];
        let factors = self.residual.par_chunks_exact(3).zip(self.spread.par_chunks_exact(3));
        let pixels = out.par_chunks_exact_mut(3).zip(raw.par_chunks_exact(RAW)).zip(factors);
        pixels.with_min_len(PIXELS).for_each(|((out, raw), (residual, spread))| {
            (0..3).for_each(|c| out[c] = residual[c] * raw[c] + spread[c] * raw[3 + c]);
        });
        (out, ())
    }

    fn backward(&self, _: [&[f32]; 1], _: &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        let mut out = vec![0.0; gradient.len() * 2];
        let factors = self.residual.par_chunks_exact(3).zip(self.spread.par_chunks_exact(3));
        let pixels = out.par_chunks_exact_mut(RAW).zip(gradient.par_chunks_exact(3)).zip(factors);
        pixels.with_min_len(PIXELS).for_each(|((out, gradient), (residual, spread))| {
            (0..3).for_each(|c| out[c] = residual[c] * gradient[c]);
            (0..3).for_each(|c| out[3 + c] = spread[c] * gradient[c]);
        });
        [out]
    }
}

/// The squared differences between a prediction and a target of its shape, added and divided by `count`: how many there are
/// in all parts of a batch together.
pub(crate) fn mean_square<const D: usize>(prediction: Tensor<D>, target: Arc<Vec<f32>>, count: usize) -> Tensor<1> {
    assert_eq!(prediction.shape().num_elements(), target.len(), "the target has the prediction's shape");
    apply(MeanSquare { target, count }, [prediction.into()], [1])
}

#[derive(Clone, Debug)]
struct MeanSquare {
    target: Arc<Vec<f32>>,
    count: usize,
}

impl Operator<1> for MeanSquare {
    type Saved = ();

    fn forward(&self, [prediction]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        let difference = |(p, t): (&f32, &f32)| f64::from(p - t) * f64::from(p - t);
        let total: f64 = prediction.iter().zip(self.target.iter()).map(difference).sum();
        (vec![(total / self.count as f64) as f32], ())
    }

    fn backward(&self, [prediction]: [&[f32]; 1], _: &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        let scale = gradient[0] * 2.0 / self.count as f32;
        [prediction.iter().zip(self.target.iter()).map(|(p, t)| (p - t) * scale).collect()]
    }
}
