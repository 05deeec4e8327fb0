//! The operators of `tauflow-ops` on tensors.

use crate::op::apply;
use burn::tensor::Tensor;
use tauflow_ops::{Conv3, Convolutions, Fold, GROUP, Instructions, Linear, NormSilu, Silu};

/// 3x3 convolution with zeros around the image: `x` [N, H, W, C], `kernel` [9 C, O], `bias` [1, O].
pub fn conv3(x: Tensor<4>, kernel: Tensor<2>, bias: Tensor<2>, convolutions: Convolutions) -> Tensor<4> {
    let [images, height, width, inputs] = x.dims();
    let [rows, outputs] = kernel.dims();
    assert_eq!(rows, 9 * inputs, "a convolution of {inputs} channels");
    let conv = Conv3 { height, width, inputs, outputs, convolutions, instructions: Instructions::best() };
    apply(conv, [x.into(), kernel.into(), bias.into()], [images, height, width, outputs])
}

/// The linear map of the last axis: `x` [.., C], `kernel` [C, O], `bias` [1, O].
pub fn linear<const D: usize>(x: Tensor<D>, kernel: Tensor<2>, bias: Tensor<2>) -> Tensor<D> {
    let mut shape = x.dims();
    let [inputs, outputs] = kernel.dims();
    assert_eq!(shape[D - 1], inputs, "a linear map of {inputs} channels");
    shape[D - 1] = outputs;
    let map = Linear { inputs, outputs, instructions: Instructions::best() };
    apply(map, [x.into(), kernel.into(), bias.into()], shape)
}

/// Normalises `x` [N, H, W, C] in groups of 8 channels, modulates it by `modulation` [N, 2 C] (scales, then shifts),
/// and applies SiLU.
pub fn norm_silu(x: Tensor<4>, modulation: Tensor<2>) -> Tensor<4> {
    modulated(x, modulation, true)
}

/// As [`norm_silu`] without the normalisation: each pixel by itself.
pub fn modulated_silu(x: Tensor<4>, modulation: Tensor<2>) -> Tensor<4> {
    modulated(x, modulation, false)
}

fn modulated(x: Tensor<4>, modulation: Tensor<2>, normalise: bool) -> Tensor<4> {
    let shape = x.dims();
    let [_, height, width, channels] = shape;
    assert_eq!(channels % GROUP, 0, "channels come in groups of {GROUP}");
    apply(NormSilu { pixels: height * width, channels, normalise }, [x.into(), modulation.into()], shape)
}

/// SiLU of every value.
pub fn silu<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    let shape = x.dims();
    apply(Silu, [x.into()], shape)
}

/// [N, H, W, C] to [N, H/2, W/2, 4 C].
pub fn fold(x: Tensor<4>) -> Tensor<4> {
    let [images, height, width, channels] = x.dims();
    let shape = [images, height / 2, width / 2, 4 * channels];
    apply(Fold { height, width, channels, back: false }, [x.into()], shape)
}

/// [N, H, W, 4 C] to [N, 2 H, 2 W, C]: the inverse of [`fold`].
pub fn unfold(x: Tensor<4>) -> Tensor<4> {
    let [images, height, width, channels] = x.dims();
    assert_eq!(channels % 4, 0, "channels of four pixels");
    let (height, width, channels) = (2 * height, 2 * width, channels / 4);
    apply(Fold { height, width, channels, back: true }, [x.into()], [images, height, width, channels])
}
