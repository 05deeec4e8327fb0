//! The operators of `tauflow-ops` by burn's own operations: for devices that are no CPU. burn finds their gradients
//! itself.
//!
//! Tensors are flat, as slices are there: an operator knows what shape its numbers have. Knows nothing of networks.

use burn::tensor::{
    Device, Tensor, TensorData,
    activation::{sigmoid, softmax},
    module::conv2d,
    ops::ConvOptions,
};
use std::sync::Arc;
use tauflow_ops::{
    Blocks, Conv3, FARTHEST, Fold, GROUP, Guided, Linear, NormSilu, Operator, Pyramid, SHARPNESS, Silu, WeightedMean,
};

/// Added to variances, as in `tauflow-ops`.
const EPSILON: f64 = 1e-5;

/// An operator that any device can do.
pub trait OnDevice<const N: usize>: Operator<N> {
    /// The output of these inputs, all flat and on one device.
    fn by_tensors(&self, inputs: [Tensor<1>; N]) -> Tensor<1>;
}

/// Numbers that no gradient goes to.
pub fn constant<const D: usize>(values: &[f32], shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape), device)
}

/// A tensor as one row.
pub fn flat<const D: usize>(tensor: Tensor<D>) -> Tensor<1> {
    tensor.reshape([-1])
}

impl OnDevice<3> for Conv3 {
    fn by_tensors(&self, [x, kernel, bias]: [Tensor<1>; 3]) -> Tensor<1> {
        let Self { height, width, inputs, outputs, .. } = *self;
        let images = x.dims()[0] / (height * width * inputs);
        // burn's images have their channels first.
        let x = x.reshape([images, height, width, inputs]).permute([0, 3, 1, 2]);
        let kernel = kernel.reshape([3, 3, inputs, outputs]).permute([3, 2, 0, 1]);
        let options = ConvOptions::new([1, 1], [1, 1], [1, 1], 1);
        flat(conv2d(x, kernel, Some(bias), options).permute([0, 2, 3, 1]))
    }
}

impl OnDevice<3> for Linear {
    fn by_tensors(&self, [x, kernel, bias]: [Tensor<1>; 3]) -> Tensor<1> {
        let rows = x.dims()[0] / self.inputs;
        let x = x.reshape([rows, self.inputs]);
        let kernel = kernel.reshape([self.inputs, self.outputs]);
        flat(x.matmul(kernel) + bias.reshape([1, self.outputs]))
    }
}

impl OnDevice<2> for NormSilu {
    fn by_tensors(&self, [x, modulation]: [Tensor<1>; 2]) -> Tensor<1> {
        let Self { pixels, channels, normalise } = *self;
        let images = x.dims()[0] / (pixels * channels);
        let normal = if normalise {
            let x = x.reshape([images, pixels, channels / GROUP, GROUP]);
            let mean = |values: Tensor<4>| values.mean_dim(1).mean_dim(3);
            let off = x.clone() - mean(x);
            let deviation = (mean(off.clone().square()) + EPSILON).sqrt();
            (off / deviation).reshape([images, pixels, channels])
        } else {
            x.reshape([images, pixels, channels])
        };
        let modulation = modulation.reshape([images, 2, channels]);
        let scale = modulation.clone().slice([0..images, 0..1, 0..channels]) + 1.0;
        let shift = modulation.slice([0..images, 1..2, 0..channels]);
        let u = normal * scale + shift;
        flat(u.clone() * sigmoid(u))
    }
}

impl OnDevice<1> for Silu {
    fn by_tensors(&self, [x]: [Tensor<1>; 1]) -> Tensor<1> {
        x.clone() * sigmoid(x)
    }
}

impl OnDevice<1> for Fold {
    fn by_tensors(&self, [x]: [Tensor<1>; 1]) -> Tensor<1> {
        let Self { height, width, channels, back } = *self;
        let images = x.dims()[0] / (height * width * channels);
        // Rows of the small image, of a block, and as many columns, which change places.
        let (rows, columns) = (height / 2, width / 2);
        let shape =
            if back { [images, rows, columns, 2, 2, channels] } else { [images, rows, 2, columns, 2, channels] };
        flat(x.reshape(shape).permute([0, 1, 3, 2, 4, 5]))
    }
}

/// The pixels or blocks of a level around each pixel, [N, H, W, 3, places].
fn around(pyramid: &Pyramid, level: &Blocks<'_>, device: &Device) -> Tensor<5> {
    let (images, height, width) = pyramid.size();
    let (block, side) = (1usize << level.scale, level.side);
    let (rows, columns, places) = (height / block, width / block, side * side);
    let pixels = constant(level.pixels, [images, rows + side - 1, columns + side - 1, 4], device);
    let moved = |at: usize| {
        let (y, x) = (at / side, at % side);
        pixels.clone().slice([0..images, y..y + rows, x..x + columns, 0..3])
    };
    let window: Tensor<5> = Tensor::stack((0..places).map(moved).collect(), 4);
    let small = window.reshape([images, rows, 1, columns, 1, 3 * places]);
    let large = small.expand([images, rows, block, columns, block, 3 * places]);
    large.reshape([images, height, width, 3, places])
}

impl OnDevice<2> for Guided {
    fn by_tensors(&self, [numbers, strengths]: [Tensor<1>; 2]) -> Tensor<1> {
        let device = numbers.device();
        let first = &self.0[0];
        let (images, height, width) = first.size();
        let strengths: Tensor<4> = strengths.reshape([images, height, width, self.strengths()]);
        let levels = (0..first.levels().count()).map(|at| {
            let of = |(guide, pyramid): (usize, &Arc<Pyramid>)| {
                let levels: Vec<Blocks<'_>> = pyramid.levels().collect();
                let side = levels[0].side;
                let padded = [images, height + side - 1, width + side - 1, 4];
                let own = constant(levels[0].pixels, padded, &device);
                let middle = |size: usize| side / 2..side / 2 + size;
                let own = own.slice([0..images, middle(height), middle(width), 0..3]);
                let distances = (around(pyramid, &levels[at], &device) - own.unsqueeze_dim::<5>(4))
                    .square()
                    .sum_dim(3)
                    .clamp_max(FARTHEST)
                    .squeeze_dim::<4>(3);
                let strength = at * self.0.len() + guide;
                distances * strengths.clone().slice_dim(3, strength..strength + 1)
            };
            let all = self.0.iter().enumerate().map(of).reduce(|sum, more| sum + more);
            all.expect("at least one guide")
        });
        let lowered = Tensor::cat(levels.collect(), 3) * SHARPNESS;
        numbers - flat(lowered)
    }
}

impl OnDevice<1> for WeightedMean {
    fn by_tensors(&self, [logits]: [Tensor<1>; 1]) -> Tensor<1> {
        let (images, height, width) = self.0.size();
        let device = logits.device();
        // [N, H, W, 3, weights]: what each weight is for.
        let around = Tensor::cat(self.0.levels().map(|level| around(&self.0, &level, &device)).collect(), 4);
        let weights = softmax(logits.reshape([images, height, width, 1, self.0.weights()]), 4);
        flat((around * weights).sum_dim(4))
    }
}
