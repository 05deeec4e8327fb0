//! A network's layers on tensors of images [N, H, W, C], and its weights.

use super::parameters::{LinearMap, Norm};
use burn::tensor::{Tensor, TensorData};
use tauflow_data::maths;
use tauflow_ops::{Attention, Beside, Convolutions, Fir, GroupNorm, Instructions, Nearest, Patches};
use tauflow_tensors::{apply_on_cpu, layers};

pub(crate) use tauflow_tensors::layers::silu;

/// A network at work: its weights by place.
pub(crate) struct Run<'a>(pub(crate) &'a [Tensor<2>]);

impl Run<'_> {
    /// A 3x3 convolution with zeros around the image.
    pub(crate) fn conv3(&self, map: LinearMap, x: Tensor<4>) -> Tensor<4> {
        layers::conv3(x, self.0[map.kernel].clone(), self.0[map.bias].clone(), Convolutions::Minimal)
    }

    /// A linear map of the last axis.
    pub(crate) fn linear<const D: usize>(&self, map: LinearMap, x: Tensor<D>) -> Tensor<D> {
        layers::linear(x, self.0[map.kernel].clone(), self.0[map.bias].clone())
    }

    /// A 3x3 convolution of every second pixel, to the right and downwards.
    pub(crate) fn strided(&self, map: LinearMap, x: Tensor<4>) -> Tensor<4> {
        let [images, height, width, channels] = x.dims();
        let shape = [images, height / 2, width / 2, 9 * channels];
        self.linear(map, apply_on_cpu(Patches { height, width, channels }, [x.into()], shape))
    }

    /// Group normalisation of `x` plus a shift [N, C] for each image, and SiLU if asked for.
    pub(crate) fn norm(&self, norm: Norm, x: Tensor<4>, shift: Option<Tensor<2>>, silu: bool) -> Tensor<4> {
        let shape = x.dims();
        let [images, height, width, channels] = shape;
        let shift = shift.unwrap_or_else(|| Tensor::zeros([images, channels], &x.device()));
        let Norm { weight, bias, groups, epsilon } = norm;
        let operator = GroupNorm { pixels: height * width, channels, groups, epsilon, silu };
        let (weight, bias) = (self.0[weight].clone(), self.0[bias].clone());
        apply_on_cpu(operator, [x.into(), shift.into(), weight.into(), bias.into()], shape)
    }
}

/// Attention among the pixels of an image.
pub(crate) fn attention(q: Tensor<4>, k: Tensor<4>, v: Tensor<4>, heads: usize) -> Tensor<4> {
    let shape = q.dims();
    let [_, height, width, channels] = shape;
    let operator = Attention { tokens: height * width, channels, heads, instructions: Instructions::best() };
    apply_on_cpu(operator, [q.into(), k.into(), v.into()], shape)
}

/// Every pixel twice in each direction.
pub(crate) fn nearest(x: Tensor<4>) -> Tensor<4> {
    let [images, height, width, channels] = x.dims();
    apply_on_cpu(Nearest { height, width, channels }, [x.into()], [images, 2 * height, 2 * width, channels])
}

/// The filter 1 3 3 1, to twice or to half the size.
pub(crate) fn fir(x: Tensor<4>, up: bool) -> Tensor<4> {
    let [images, height, width, channels] = x.dims();
    let shape = if up { [images, 2 * height, 2 * width, channels] } else { [images, height / 2, width / 2, channels] };
    apply_on_cpu(Fir { height, width, channels, up }, [x.into()], shape)
}

/// The channels of one image after those of another.
pub(crate) fn beside(a: Tensor<4>, b: Tensor<4>) -> Tensor<4> {
    let ([images, height, width, first], second) = (a.dims(), b.dims()[3]);
    let shape = [images, height, width, first + second];
    apply_on_cpu(Beside { channels: [first, second] }, [a.into(), b.into()], shape)
}

/// Sines, then cosines, of each image's phases: [N, 2 phases]; cosines first if `flipped`. Phases are rounded to f32,
/// as the networks were trained with.
pub(crate) fn waves(phases: &[Vec<f32>], flipped: bool, like: &Tensor<2>) -> Tensor<2> {
    let of = |f: fn(f64) -> f64| move |phase: &f32| f(f64::from(*phase)) as f32;
    let rows = phases.iter().flat_map(|phases| {
        let (sines, cosines) = (phases.iter().map(of(maths::sin)), phases.iter().map(of(maths::cos)));
        let both: Vec<f32> = if flipped { cosines.chain(sines).collect() } else { sines.chain(cosines).collect() };
        both
    });
    let size = 2 * phases.first().map_or(0, Vec::len);
    Tensor::from_data(TensorData::new(rows.collect(), [phases.len(), size]), &like.device())
}
