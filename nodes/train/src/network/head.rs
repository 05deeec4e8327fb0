//! The two ends of the network that are not learned: what the last layer's numbers mean, and the loss.

use super::op::apply;
use burn::tensor::Tensor;
use std::sync::Arc;
use tauflow_ops::Operator;

/// Channels that the last layer has for the three of an image.
pub(crate) const RAW: usize = 6;

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
        let mut out = Vec::with_capacity(raw.len() / 2);
        let pixels = raw.chunks_exact(RAW).zip(self.residual.chunks_exact(3)).zip(self.spread.chunks_exact(3));
        for ((raw, residual), spread) in pixels {
            out.extend((0..3).map(|c| residual[c] * raw[c] + spread[c] * raw[3 + c]));
        }
        (out, ())
    }

    fn backward(&self, _: [&[f32]; 1], _: &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        let mut out = Vec::with_capacity(gradient.len() * 2);
        let pixels = gradient.chunks_exact(3).zip(self.residual.chunks_exact(3)).zip(self.spread.chunks_exact(3));
        for ((gradient, residual), spread) in pixels {
            out.extend((0..3).map(|c| residual[c] * gradient[c]));
            out.extend((0..3).map(|c| spread[c] * gradient[c]));
        }
        [out]
    }
}

/// The mean squared difference between a prediction and a target of its shape.
pub(crate) fn mean_square<const D: usize>(prediction: Tensor<D>, target: Arc<Vec<f32>>) -> Tensor<1> {
    assert_eq!(prediction.shape().num_elements(), target.len(), "the target has the prediction's shape");
    apply(MeanSquare(target), [prediction.into()], [1])
}

#[derive(Clone, Debug)]
struct MeanSquare(Arc<Vec<f32>>);

impl Operator<1> for MeanSquare {
    type Saved = ();

    fn forward(&self, [prediction]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        let difference = |(p, t): (&f32, &f32)| f64::from(p - t) * f64::from(p - t);
        let total: f64 = prediction.iter().zip(self.0.iter()).map(difference).sum();
        (vec![(total / self.0.len() as f64) as f32], ())
    }

    fn backward(&self, [prediction]: [&[f32]; 1], _: &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        let scale = gradient[0] * 2.0 / self.0.len() as f32;
        [prediction.iter().zip(self.0.iter()).map(|(p, t)| (p - t) * scale).collect()]
    }
}
