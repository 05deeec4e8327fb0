//! 3x3 convolution and the linear map of channels.
//!
//! Three neighbouring pixels of a row of an image lie side by side: [3 C] numbers. One row of an output is the sum,
//! over the three rows around it, of these patches times a third of the kernel, [3 C, O]. The gradient of the input is
//! the same convolution with the kernel turned round. The gradient of the kernel sums patch times gradient over all
//! pixels. Large images and wide layers need fewer multiplications by [`Convolutions::Minimal`].

#![expect(unsafe_code, reason = "results are written once, band by band; each block says why all of a band is written")]

mod winograd;

use crate::{
    fresh::{filled, maybe},
    instructions::Instructions,
    operator::Operator,
    products::{Left, Packed, Run, Start, add_outer_products, add_products},
    sums::columns,
};
use rayon::prelude::*;
use std::{cell::RefCell, mem::MaybeUninit};

/// Pixels that are worked on at once: with their surroundings and their results they stay in the second cache.
const BAND: usize = 256;
/// Pixels whose products with gradients are summed at once: with their gradients they stay in the first cache.
const SUMMED: usize = 128;
/// Rows of a kernel's gradient that are worked on at once.
const ROWS: usize = 96;

/// How 3x3 convolutions and their gradients are computed. The two differ by rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Convolutions {
    /// By minimal filtering where that is faster: with a quarter of the multiplications.
    Minimal,
    /// As the sum of the definition.
    Direct,
}

/// 3x3 convolution with zeros around the image: `x` [N, H, W, C], `kernel` [9 C, O] with rows by row of the patch,
/// pixel and channel, `bias` [1, O].
#[derive(Clone, Debug)]
pub struct Conv3 {
    /// H.
    pub height: usize,
    /// W.
    pub width: usize,
    /// C.
    pub inputs: usize,
    /// O.
    pub outputs: usize,
    /// How it is computed.
    pub convolutions: Convolutions,
    /// The instruction set to use; the bits are the same.
    pub instructions: Instructions,
}

/// The linear map of the last axis: `x` [.., C], `kernel` [C, O], `bias` [1, O].
#[derive(Clone, Debug)]
pub struct Linear {
    /// C.
    pub inputs: usize,
    /// O.
    pub outputs: usize,
    /// The instruction set to use; the bits are the same.
    pub instructions: Instructions,
}

/// Copies rows of an image from `first - 1` on to `to`, with zeros outside of the image: a row has a pixel to the left
/// of the image, and `beyond` to the right. Writes all rows of `to`.
fn surround(
    to: &mut [MaybeUninit<f32>],
    image: &[f32],
    (width, beyond): (usize, usize),
    channels: usize,
    first: usize,
) {
    let row = width * channels;
    for (i, to) in to.chunks_exact_mut(row + (1 + beyond) * channels).enumerate() {
        let line = (first + i).checked_sub(1).and_then(|y| image.get(y * row..(y + 1) * row));
        let (left, rest) = to.split_at_mut(channels);
        let (middle, right) = rest.split_at_mut(row);
        let zero = MaybeUninit::new(0.0);
        left.fill(zero);
        right.fill(zero);
        match line {
            Some(line) => _ = middle.write_copy_of_slice(line),
            None => middle.fill(zero),
        }
    }
}

thread_local! {
    static SCRATCH: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
}

/// Runs `f` with so many numbers of any value, of memory that the thread keeps.
fn with_scratch<T>(size: usize, f: impl FnOnce(&mut [f32]) -> T) -> T {
    SCRATCH.with_borrow_mut(|scratch| {
        if scratch.len() < size {
            scratch.resize(size, 0.0);
        }
        f(&mut scratch[..size])
    })
}

impl Conv3 {
    fn pixels(&self) -> usize {
        self.height * self.width
    }

    /// Panics unless there are whole images and a kernel of the right size; with an image, no product of sizes
    /// overflows then.
    fn check(&self, x: &[f32], kernel: &[f32], bias: &[f32]) {
        let size = self.height.checked_mul(self.width).and_then(|pixels| pixels.checked_mul(self.inputs));
        assert!(size.is_some_and(|size| size > 0 && x.len().is_multiple_of(size)), "whole images of {self:?}");
        assert!(bias.len() == self.outputs && self.outputs > 0, "a bias for each output of {self:?}");
        let rows = self.inputs.checked_mul(9);
        assert!(rows.and_then(|rows| rows.checked_mul(self.outputs)) == Some(kernel.len()), "the kernel of {self:?}");
    }

    /// The convolution of images of `channels` with a packed kernel, and a bias for each output.
    fn convolve(&self, x: &[f32], channels: usize, kernel: &Packed, bias: &[f32]) -> Vec<f32> {
        let size = (x.len() / channels).checked_mul(bias.len()).expect("a result that fits into memory");
        // SAFETY: there are whole images, see `check`; bands cover the result, and all of a band is written at the
        // first row of the kernel.
        unsafe { filled(size, |out| self.convolve_to(out, x, channels, kernel, bias)) }
    }

    fn convolve_to(&self, out: &mut [MaybeUninit<f32>], x: &[f32], channels: usize, kernel: &Packed, bias: &[f32]) {
        let outputs = bias.len();
        let (width, depth) = (self.width, 3 * channels);
        let rows = (BAND / width).clamp(1, self.height);
        let stride = (width + 2) * channels;
        let bands = out.par_chunks_exact_mut(self.pixels() * outputs).zip(x.par_chunks_exact(self.pixels() * channels));
        bands
            .flat_map(|(out, x)| {
                out.par_chunks_mut(rows * width * outputs).enumerate().map(move |(i, band)| (x, i * rows, band))
            })
            .for_each(|(x, first, band)| {
                let rows = band.len() / (width * outputs);
                with_scratch((rows + 2) * stride, |near| {
                    // SAFETY: `surround` writes numbers.
                    surround(unsafe { maybe(near) }, x, (width, 1), channels, first);
                    for ky in 0..3 {
                        let runs: Vec<Run> = (0..rows)
                            .map(|y| Run { left: (y + ky) * stride, other: y * width * outputs, rows: width })
                            .collect();
                        let left = Left { data: near, stride: channels };
                        let start = if ky == 0 { Start::Row(bias) } else { Start::There };
                        // SAFETY: the first row of the kernel writes all of the band.
                        unsafe {
                            add_products((band, start), left, kernel, (ky * depth, depth), &runs, self.instructions);
                        }
                    }
                });
            });
    }

    fn of_input(&self, kernel: &[f32], gradient: &[f32]) -> Vec<f32> {
        let (c, o) = (self.inputs, self.outputs);
        if winograd::pays(self) {
            return winograd::of_input(self, kernel, gradient);
        }
        // Turned round, inputs and outputs swapped: row (tap, output) takes every `o`-th number of the tap opposite.
        let turned = Packed::new((9 * o, c), kernel, |row| (8 - row / o) * c * o + row % o, o);
        self.convolve(gradient, o, &turned, &vec![0.0; c])
    }

    fn of_kernel(&self, x: &[f32], gradient: &[f32]) -> Vec<f32> {
        if winograd::pays(self) {
            return winograd::of_kernel(self, x, gradient);
        }
        let (width, height, c) = (self.width, self.height, self.inputs);
        let stride = (width + 2) * c;
        // SAFETY: there are whole images, see `check`; `surround` writes all of an image.
        let near = unsafe {
            filled(x.len() / (self.pixels() * c) * (height + 2) * stride, |near| {
                near.par_chunks_exact_mut((height + 2) * stride)
                    .zip(x.par_chunks_exact(self.pixels() * c))
                    .for_each(|(near, x)| surround(near, x, (width, 1), c, 0));
            })
        };
        let step = (SUMMED / width).clamp(1, height);
        let lines = x.len() / (width * c);
        sum_outer(9 * c, 3 * c, (gradient, self.outputs), |out, (ky, from), (right, columns)| {
            for first in (0..lines).step_by(step) {
                let run = |line: usize| Run {
                    left: (line + 2 * (line / height) + ky) * stride,
                    other: line * width * columns,
                    rows: width,
                };
                let runs: Vec<Run> = (first..(first + step).min(lines)).map(run).collect();
                let left = Left { data: &near, stride: c };
                add_outer_products(out, left, from, (right, columns), &runs, self.instructions);
            }
        })
    }
}

/// The gradient, [depth, O], of a matrix whose rows come in blocks: calls `sum` for parts of a block's rows, of which
/// it is told block and first row, with the gradient of the result widened to whole units.
fn sum_outer(
    depth: usize,
    block: usize,
    (gradient, outputs): (&[f32], usize),
    sum: impl Fn(&mut [f32], (usize, usize), (&[f32], usize)) + Sync,
) -> Vec<f32> {
    let columns = outputs.next_multiple_of(16);
    let wider;
    let right = if columns == outputs {
        gradient
    } else {
        let mut wide = vec![0.0; gradient.len() / outputs * columns];
        for (wide, row) in wide.chunks_exact_mut(columns).zip(gradient.chunks_exact(outputs)) {
            wide[..outputs].copy_from_slice(row);
        }
        wider = wide;
        &wider
    };
    let mut out = vec![0.0; depth * columns];
    out.par_chunks_exact_mut(block * columns).enumerate().for_each(|(index, out)| {
        out.par_chunks_mut(ROWS * columns)
            .enumerate()
            .for_each(|(part, out)| sum(out, (index, part * ROWS), (right, columns)));
    });
    if columns == outputs {
        return out;
    }
    out.chunks_exact(columns).flat_map(|row| &row[..outputs]).copied().collect()
}

impl Operator<3> for Conv3 {
    type Saved = ();

    fn forward(&self, [x, kernel, bias]: [&[f32]; 3]) -> (Vec<f32>, ()) {
        self.check(x, kernel, bias);
        let (c, o) = (self.inputs, self.outputs);
        if winograd::pays(self) {
            return (winograd::convolve(self, x, kernel, bias), ());
        }
        (self.convolve(x, c, &Packed::new((9 * c, o), kernel, |row| row * o, 1), bias), ())
    }

    fn backward(&self, [x, kernel, bias]: [&[f32]; 3], (): &(), gradient: &[f32], wanted: [bool; 3]) -> [Vec<f32>; 3] {
        self.check(x, kernel, bias);
        assert_eq!(
            Some(gradient.len()),
            (x.len() / self.inputs).checked_mul(self.outputs),
            "the gradient of the result"
        );
        let of_x = if wanted[0] { self.of_input(kernel, gradient) } else { Vec::new() };
        let of_kernel = if wanted[1] { self.of_kernel(x, gradient) } else { Vec::new() };
        [of_x, of_kernel, columns(gradient, self.outputs)]
    }
}

impl Linear {
    /// Panics unless there are whole rows and a matrix of the right size.
    fn check(&self, x: &[f32], kernel: &[f32], bias: &[f32]) {
        assert!(self.inputs > 0 && x.len().is_multiple_of(self.inputs), "whole rows of {self:?}");
        assert!(bias.len() == self.outputs && self.outputs > 0, "a bias for each output of {self:?}");
        assert_eq!(self.inputs.checked_mul(self.outputs), Some(kernel.len()), "the matrix of {self:?}");
    }

    /// Rows of `x`, [.., channels], times a packed matrix, and a bias for each output.
    fn map(&self, x: &[f32], channels: usize, matrix: &Packed, bias: &[f32]) -> Vec<f32> {
        let size = (x.len() / channels).checked_mul(bias.len()).expect("a result that fits into memory");
        let outputs = bias.len();
        let write = |out: &mut [MaybeUninit<f32>], x: &[f32]| {
            let run = Run { left: 0, other: 0, rows: x.len() / channels };
            let (left, start) = (Left { data: x, stride: channels }, Start::Row(bias));
            // SAFETY: sums start with the bias.
            unsafe { add_products((out, start), left, matrix, (0, channels), &[run], self.instructions) };
        };
        // SAFETY: there are whole rows, see `check`; parts cover the result, and all of a part is written.
        unsafe {
            filled(size, |out| {
                let parts = out.par_chunks_mut(BAND * outputs).zip(x.par_chunks(BAND * channels));
                parts.for_each(|(out, x)| write(out, x));
            })
        }
    }
}

impl Operator<3> for Linear {
    type Saved = ();

    fn forward(&self, [x, kernel, bias]: [&[f32]; 3]) -> (Vec<f32>, ()) {
        self.check(x, kernel, bias);
        let (c, o) = (self.inputs, self.outputs);
        (self.map(x, c, &Packed::new((c, o), kernel, |row| row * o, 1), bias), ())
    }

    fn backward(&self, [x, kernel, bias]: [&[f32]; 3], (): &(), gradient: &[f32], wanted: [bool; 3]) -> [Vec<f32>; 3] {
        self.check(x, kernel, bias);
        let (c, o) = (self.inputs, self.outputs);
        assert_eq!(Some(gradient.len()), (x.len() / c).checked_mul(o), "the gradient of the result");
        let mut of_x = Vec::new();
        if wanted[0] {
            of_x = self.map(gradient, o, &Packed::new((o, c), kernel, |row| row, o), &vec![0.0; c]);
        }
        let mut of_kernel = Vec::new();
        if wanted[1] {
            let pixels = x.len() / c;
            of_kernel = sum_outer(c, c, (gradient, o), |out, (_, from), (right, columns)| {
                for first in (0..pixels).step_by(SUMMED) {
                    let rows = SUMMED.min(pixels - first);
                    let run = Run { left: first * c, other: first * columns, rows };
                    let left = Left { data: x, stride: c };
                    add_outer_products(out, left, from, (right, columns), &[run], self.instructions);
                }
            });
        }
        [of_x, of_kernel, columns(gradient, o)]
    }
}

#[cfg(test)]
mod tests;
