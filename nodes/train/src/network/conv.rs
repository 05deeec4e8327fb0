//! 3x3 convolution and the linear map of channels, images as [N, H, W, C].
//!
//! A band of rows is unfolded into a matrix of patches, [pixels, 9 C], and multiplied with the kernel, [9 C, O]. The
//! gradient of the input is the same convolution with the kernel turned round. Bands and images are summed in order.

use super::{
    matrix::{Matrix, multiply},
    op::{Operator, apply},
    sums::{columns, parts},
};
use burn::tensor::Tensor;
use rayon::prelude::*;

/// Pixels of a band: its patches should stay in the cache.
const BAND: usize = 512;

/// 3x3 convolution with zeros around the image: `x` [N, H, W, C], `kernel` [9 C, O], `bias` [1, O].
pub(crate) fn conv3(x: Tensor<4>, kernel: Tensor<2>, bias: Tensor<2>) -> Tensor<4> {
    let [images, height, width, inputs] = x.dims();
    let [_, outputs] = kernel.dims();
    let operator = Conv3 { height, width, inputs, outputs };
    apply(operator, [x.into(), kernel.into(), bias.into()], [images, height, width, outputs])
}

/// The linear map of the last axis: `x` [..., C], `kernel` [C, O], `bias` [1, O].
pub(crate) fn linear<const D: usize>(x: Tensor<D>, kernel: Tensor<2>, bias: Tensor<2>) -> Tensor<D> {
    let mut shape = x.dims();
    let [inputs, outputs] = kernel.dims();
    assert_eq!(shape[D - 1], inputs, "a linear map of {inputs} channels");
    shape[D - 1] = outputs;
    apply(Linear { inputs, outputs }, [x.into(), kernel.into(), bias.into()], shape)
}

#[derive(Clone, Debug)]
struct Conv3 {
    height: usize,
    width: usize,
    inputs: usize,
    outputs: usize,
}

#[derive(Clone, Debug)]
struct Linear {
    inputs: usize,
    outputs: usize,
}

impl Conv3 {
    fn band(&self) -> usize {
        (BAND / self.width).clamp(1, self.height)
    }

    /// Convolves one image into `out`, which holds the bias or what is to be added to.
    fn image(&self, out: &mut [f32], x: &[f32], kernel: &[f32], channels: (usize, usize), patches: &mut Vec<f32>) {
        let (inputs, outputs) = channels;
        for (index, out) in out.chunks_mut(self.band() * self.width * outputs).enumerate() {
            let rows = out.len() / (self.width * outputs);
            self.unfold(patches, x, inputs, index * self.band(), rows);
            multiply(out, Matrix::new(patches, 9 * inputs), Matrix::new(kernel, outputs), true);
        }
    }

    /// The patches around the pixels of `rows` rows from `first`.
    fn unfold(&self, patches: &mut Vec<f32>, x: &[f32], channels: usize, first: usize, rows: usize) {
        let (width, row) = (self.width, self.width * channels);
        patches.resize(rows * width * 9 * channels, 0.0);
        for (pixel, patch) in patches.chunks_exact_mut(9 * channels).enumerate() {
            let (at_x, at_y) = (pixel % width, first + pixel / width);
            for (ky, part) in patch.chunks_exact_mut(3 * channels).enumerate() {
                let y = at_y + ky;
                if y == 0 || y > self.height {
                    part.fill(0.0);
                    continue;
                }
                let line = &x[(y - 1) * row..y * row];
                let (left, right) = (usize::from(at_x == 0), usize::from(at_x + 1 == width));
                part[..left * channels].fill(0.0);
                let end = (3 - right) * channels;
                part[end..].fill(0.0);
                let from = (at_x + left) * channels - channels;
                part[left * channels..end].copy_from_slice(&line[from..from + end - left * channels]);
            }
        }
    }

    /// The kernel of the gradient: turned round, inputs and outputs swapped.
    fn turned(&self, kernel: &[f32]) -> Vec<f32> {
        let (c, o) = (self.inputs, self.outputs);
        let mut turned = vec![0.0; kernel.len()];
        for tap in 0..9 {
            for input in 0..c {
                for output in 0..o {
                    turned[(tap * o + output) * c + input] = kernel[((8 - tap) * c + input) * o + output];
                }
            }
        }
        turned
    }
}

impl Operator<3> for Conv3 {
    type Saved = ();

    fn forward(&self, [x, kernel, bias]: [&[f32]; 3]) -> (Vec<f32>, ()) {
        let pixels = self.height * self.width;
        let images = x.len() / (pixels * self.inputs);
        let mut out = bias.repeat(images * pixels);
        out.par_chunks_exact_mut(pixels * self.outputs)
            .zip(x.par_chunks_exact(pixels * self.inputs))
            .for_each_init(Vec::new, |patches, (out, x)| {
                self.image(out, x, kernel, (self.inputs, self.outputs), patches)
            });
        (out, ())
    }

    fn backward(&self, [x, kernel, _]: [&[f32]; 3], _: &(), gradient: &[f32], wanted: [bool; 3]) -> [Vec<f32>; 3] {
        let pixels = self.height * self.width;
        let (per_x, per_g) = (pixels * self.inputs, pixels * self.outputs);
        let mut of_x = Vec::new();
        if wanted[0] {
            let turned = self.turned(kernel);
            of_x = vec![0.0; x.len()];
            of_x.par_chunks_exact_mut(per_x)
                .zip(gradient.par_chunks_exact(per_g))
                .for_each_init(Vec::new, |patches, (out, g)| {
                    self.image(out, g, &turned, (self.outputs, self.inputs), patches)
                });
        }
        let mut of_kernel = Vec::new();
        if wanted[1] {
            let of_images = x
                .par_chunks_exact(per_x)
                .zip(gradient.par_chunks_exact(per_g))
                .map_init(Vec::new, |patches, (x, g)| {
                    let mut part = vec![0.0; kernel.len()];
                    for (index, g) in g.chunks(self.band() * self.width * self.outputs).enumerate() {
                        let rows = g.len() / (self.width * self.outputs);
                        self.unfold(patches, x, self.inputs, index * self.band(), rows);
                        let patches = Matrix::new(patches, 9 * self.inputs).transposed();
                        multiply(&mut part, patches, Matrix::new(g, self.outputs), true);
                    }
                    part
                })
                .collect();
            of_kernel = parts(of_images);
        }
        [of_x, of_kernel, columns(gradient, self.outputs)]
    }
}

impl Operator<3> for Linear {
    type Saved = ();

    fn forward(&self, [x, kernel, bias]: [&[f32]; 3]) -> (Vec<f32>, ()) {
        let mut out = bias.repeat(x.len() / self.inputs);
        out.par_chunks_mut(BAND * self.outputs).zip(x.par_chunks(BAND * self.inputs)).for_each(|(out, x)| {
            multiply(out, Matrix::new(x, self.inputs), Matrix::new(kernel, self.outputs), true);
        });
        (out, ())
    }

    fn backward(&self, [x, kernel, _]: [&[f32]; 3], _: &(), gradient: &[f32], wanted: [bool; 3]) -> [Vec<f32>; 3] {
        let mut of_x = Vec::new();
        if wanted[0] {
            of_x = vec![0.0; x.len()];
            of_x.par_chunks_mut(BAND * self.inputs).zip(gradient.par_chunks(BAND * self.outputs)).for_each(
                |(out, g)| {
                    let kernel = Matrix::new(kernel, self.outputs).transposed();
                    multiply(out, Matrix::new(g, self.outputs), kernel, false);
                },
            );
        }
        let of_bands = x
            .par_chunks(BAND * self.inputs)
            .zip(gradient.par_chunks(BAND * self.outputs))
            .map(|(x, g)| {
                let mut part = vec![0.0; kernel.len()];
                multiply(&mut part, Matrix::new(x, self.inputs).transposed(), Matrix::new(g, self.outputs), false);
                part
            })
            .collect();
        [of_x, parts(of_bands), columns(gradient, self.outputs)]
    }
}
