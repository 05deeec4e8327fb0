//! Means of what lies around each pixel of an image, weighted by a softmax, over windows at several scales.
//!
//! Kernel-predicting networks (Bako et al. 2017) end so: whatever their weights, what comes out lies within what went
//! in.

#![expect(unsafe_code, reason = "results are written once, row by row")]

mod guided;

pub use guided::{FARTHEST, Guided, SHARPNESS};

use crate::{elementary::exp, fresh::filled, instructions::wide, operator::Operator};
use rayon::prelude::*;
use std::{mem::MaybeUninit, sync::Arc};

/// Values of a stored pixel: three colours and a one, with which weights add up beside the colours.
const STRIDE: usize = 4;
/// Pixels that a thread does at least.
const PIXELS: usize = 256;

/// Images [N, H, W, 3] at halving resolutions, each with a window.
#[derive(Clone, Debug)]
pub struct Pyramid {
    images: usize,
    height: usize,
    width: usize,
    levels: Vec<Level>,
}

/// One level of a [`Pyramid`].
#[derive(Clone, Copy, Debug)]
pub struct Blocks<'a> {
    /// Blocks have 2^scale x 2^scale pixels.
    pub scale: u32,
    /// Side of the window, in blocks.
    pub side: usize,
    /// Means over the blocks, [N, H/2^scale + side - 1, W/2^scale + side - 1, 4]: with the edge repeated around them,
    /// three colours and a one.
    pub pixels: &'a [f32],
}

/// Means over blocks of 2^scale x 2^scale pixels, with the edge repeated around them as far as the window reaches.
#[derive(Clone, Debug)]
struct Level {
    scale: u32,
    /// Odd.
    side: usize,
    /// Of a row, with what is around it.
    stride: usize,
    /// Of an image, with what is around it.
    size: usize,
    data: Vec<f32>,
}

impl Pyramid {
    /// Of images of `height` x `width` pixels: level i has means over blocks of 2^i pixels, and a window of `sides[i]`
    /// x `sides[i]` of them. Height and width must be multiples of the largest blocks, and sides odd.
    pub fn new(pixels: &[f32], height: usize, width: usize, sides: &[usize]) -> Self {
        let images = pixels.len() / (3 * height * width).max(1);
        assert_eq!(pixels.len(), images * height * width * 3, "whole images of three colours");
        assert!(!sides.is_empty() && sides.iter().all(|side| side % 2 == 1), "odd sides: {sides:?}");
        let block = 1 << (sides.len() - 1);
        assert!(height.is_multiple_of(block) && width.is_multiple_of(block), "blocks of {block} in {height} x {width}");
        let mut levels = Vec::with_capacity(sides.len());
        let (mut current, mut h, mut w) = (pixels.to_vec(), height, width);
        for (scale, side) in (0..).zip(sides) {
            if scale > 0 {
                current = halved(&current, h, w);
                (h, w) = (h / 2, w / 2);
            }
            levels.push(Level::new(&current, images, (h, w), scale, *side));
        }
        Self { images, height, width, levels }
    }

    /// How many images, their height and their width.
    pub fn size(&self) -> (usize, usize, usize) {
        (self.images, self.height, self.width)
    }

    /// Its levels, from full resolution down.
    pub fn levels(&self) -> impl Iterator<Item = Blocks<'_>> {
        self.levels.iter().map(|level| Blocks { scale: level.scale, side: level.side, pixels: &level.data })
    }

    /// Weights of a pixel: those of all windows.
    pub fn weights(&self) -> usize {
        self.levels.iter().map(|level| level.side * level.side).sum()
    }
}

/// Means over blocks of two by two pixels.
fn halved(pixels: &[f32], height: usize, width: usize) -> Vec<f32> {
    let row = 3 * width;
    let mut out = Vec::with_capacity(pixels.len() / 4);
    for pair in pixels.chunks_exact(2 * row).take(pixels.len() / (3 * height * width) * height / 2) {
        let (upper, lower) = pair.split_at(row);
        for (a, b) in upper.chunks_exact(6).zip(lower.chunks_exact(6)) {
            out.extend((0..3).map(|c| 0.25 * ((a[c] + a[3 + c]) + (b[c] + b[3 + c]))));
        }
    }
    out
}

impl Level {
    fn new(pixels: &[f32], images: usize, (height, width): (usize, usize), scale: u32, side: usize) -> Self {
        let reach = side / 2;
        let (stride, rows) = ((width + 2 * reach) * STRIDE, height + 2 * reach);
        let mut data = vec![0.0; images * rows * stride];
        data.par_chunks_exact_mut(stride).enumerate().for_each(|(at, row)| {
            let (image, y) = (at / rows, (at % rows).saturating_sub(reach).min(height - 1));
            for (x, pixel) in row.chunks_exact_mut(STRIDE).enumerate() {
                let from = 3 * ((image * height + y) * width + x.saturating_sub(reach).min(width - 1));
                pixel[..3].copy_from_slice(&pixels[from..from + 3]);
                pixel[3] = 1.0;
            }
        });
        Self { scale, side, stride, size: rows * stride, data }
    }

    /// The rows of the window around a pixel of an image.
    #[inline(always)]
    fn window(&self, image: usize, y: usize, x: usize) -> impl Iterator<Item = &[f32]> {
        let start = image * self.size + (y >> self.scale) * self.stride + (x >> self.scale) * STRIDE;
        (0..self.side).map(move |row| &self.data[start + row * self.stride..][..self.side * STRIDE])
    }
}

/// The weighted means [N, H, W, 3] of a pyramid; the input, [N, H, W, [`Pyramid::weights`]], becomes weights by a
/// softmax over each pixel's numbers.
#[derive(Clone, Debug)]
pub struct WeightedMean(pub Arc<Pyramid>);

impl WeightedMean {
    fn check(&self, logits: &[f32]) {
        let Pyramid { images, height, width, .. } = *self.0;
        assert_eq!(logits.len(), images * height * width * self.0.weights(), "a number for each place of the windows");
    }

    /// Weights that do not add up to one yet, and the sums of the weighted colours and of the weights.
    #[inline(always)]
    fn sums(&self, place: (usize, usize, usize), logits: &[f32], weights: &mut [f32]) -> [f32; STRIDE] {
        let mut lanes = [f32::MIN; 8];
        for part in logits.chunks(8) {
            lanes.iter_mut().zip(part).for_each(|(lane, v)| *lane = if *v > *lane { *v } else { *lane });
        }
        let largest = lanes.iter().fold(f32::MIN, |a, b| if *b > a { *b } else { a });
        weights.iter_mut().zip(logits).for_each(|(weight, logit)| *weight = exp(*logit - largest));
        let (image, y, x) = place;
        let (mut even, mut odd) = ([0.0f32; STRIDE], [0.0f32; STRIDE]);
        let mut first = 0;
        for level in &self.0.levels {
            for row in level.window(image, y, x) {
                let weights = &weights[first..first + level.side];
                for (at, (pixel, weight)) in row.chunks_exact(STRIDE).zip(weights).enumerate() {
                    let sums = if at % 2 == 0 { &mut even } else { &mut odd };
                    (0..STRIDE).for_each(|c| sums[c] += weight * pixel[c]);
                }
                first += level.side;
            }
        }
        [0, 1, 2, 3].map(|c| even[c] + odd[c])
    }

    /// Calls `f` for each row of pixels with its place (image, y), the row's part of the output, and its logits.
    fn rows(
        &self,
        out: &mut [MaybeUninit<f32>],
        channels: usize,
        logits: &[f32],
        f: impl Fn((usize, usize), &mut [MaybeUninit<f32>], &[f32]) + Sync,
    ) {
        let Pyramid { height, width, .. } = *self.0;
        let rows = out.par_chunks_exact_mut(width * channels).zip(logits.par_chunks_exact(width * self.0.weights()));
        rows.enumerate().with_min_len(PIXELS.div_ceil(width)).for_each(|(row, (out, logits))| {
            wide(
                #[inline(always)]
                || f((row / height, row % height), out, logits),
            );
        });
    }
}

impl Operator<1> for WeightedMean {
    type Saved = ();

    fn forward(&self, [logits]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        self.check(logits);
        let count = self.0.weights();
        // SAFETY: the rows are all of the output, and each writes its own.
        let out = unsafe {
            filled(logits.len() / count * 3, |out| {
                self.rows(
                    out,
                    3,
                    logits,
                    #[inline(always)]
                    |(image, y), out, logits| {
                        let mut weights = vec![0.0; count];
                        for (x, (out, logits)) in out.chunks_exact_mut(3).zip(logits.chunks_exact(count)).enumerate() {
                            let sums = self.sums((image, y, x), logits, &mut weights);
                            (0..3).for_each(|c| out[c] = MaybeUninit::new(sums[c] / sums[3]));
                        }
                    },
                );
            })
        };
        (out, ())
    }

    fn backward(&self, [logits]: [&[f32]; 1], (): &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        self.check(logits);
        let (count, width) = (self.0.weights(), self.0.width);
        assert_eq!(gradient.len(), logits.len() / count * 3, "a gradient for each mean");
        // SAFETY: the rows are all of the output, and each writes its own.
        let out = unsafe {
            filled(logits.len(), |out| {
                self.rows(
                    out,
                    count,
                    logits,
                    #[inline(always)]
                    |(image, y), out, logits| {
                        let mut weights = vec![0.0; count];
                        let row = (image * self.0.height + y) * width;
                        let pixels = out.chunks_exact_mut(count).zip(logits.chunks_exact(count)).enumerate();
                        for (x, (out, logits)) in pixels {
                            let g = &gradient[3 * (row + x)..][..3];
                            let sums = self.sums((image, y, x), logits, &mut weights);
                            let share = 1.0 / sums[3];
                            let mean = (g[0] * sums[0] + g[1] * sums[1] + g[2] * sums[2]) * share;
                            // The one of each pixel takes the mean off.
                            let g = [g[0], g[1], g[2], -mean];
                            let mut first = 0;
                            for level in &self.0.levels {
                                for window in level.window(image, y, x) {
                                    for (at, pixel) in window.chunks_exact(STRIDE).enumerate() {
                                        let along =
                                            (g[0] * pixel[0] + g[1] * pixel[1]) + (g[2] * pixel[2] + g[3] * pixel[3]);
                                        out[first + at].write(weights[first + at] * share * along);
                                    }
                                    first += level.side;
                                }
                            }
                        }
                    },
                );
            })
        };
        [out]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made_up::numbers;

    const SIDES: [usize; 3] = [5, 3, 1];
    const SIZE: (usize, usize) = (8, 12);

    fn pyramid() -> (Vec<f32>, Pyramid) {
        let pixels = numbers(3, 2 * SIZE.0 * SIZE.1 * 3);
        let pyramid = Pyramid::new(&pixels, SIZE.0, SIZE.1, &SIDES);
        (pixels, pyramid)
    }

    /// The weighted mean from the definition, in f64.
    fn defined(pixels: &[f32], logits: &[f64], place: (usize, usize, usize), c: usize) -> f64 {
        let (image, y, x) = place;
        let ((height, width), mut at, mut sum, mut total) = (SIZE, 0, 0.0, 0.0);
        for (scale, side) in SIDES.iter().enumerate() {
            let (block, reach) = (1usize << scale, (side / 2) as i64);
            for dy in -reach..=reach {
                for dx in -reach..=reach {
                    let edge =
                        |v: usize, d: i64, size: usize| ((v / block) as i64 + d).clamp(0, (size / block) as i64 - 1);
                    let (v, u) = (edge(y, dy, height) as usize * block, edge(x, dx, width) as usize * block);
                    let mut mean = 0.0;
                    for (j, i) in (0..block).flat_map(|j| (0..block).map(move |i| (j, i))) {
                        mean += f64::from(pixels[3 * ((image * height + v + j) * width + u + i) + c]);
                    }
                    let weight = logits[at].exp();
                    sum += weight * mean / (block * block) as f64;
                    total += weight;
                    at += 1;
                }
            }
        }
        sum / total
    }

    #[test]
    fn means_and_gradients_are_those_of_the_definition() {
        let (pixels, pyramid) = pyramid();
        let count = pyramid.weights();
        assert_eq!(count, 35);
        let operator = WeightedMean(Arc::new(pyramid));
        let logits: Vec<f32> = numbers(5, 2 * SIZE.0 * SIZE.1 * count).iter().map(|v| 4.0 * v).collect();
        let (out, ()) = operator.forward([&logits]);
        let gradient = numbers(7, out.len());
        let [found] = operator.backward([&logits], &(), &gradient, [true]);
        for at in (0..2 * SIZE.0 * SIZE.1).step_by(5) {
            let place = (at / (SIZE.0 * SIZE.1), at / SIZE.1 % SIZE.0, at % SIZE.1);
            let own: Vec<f64> = logits[at * count..(at + 1) * count].iter().map(|v| f64::from(*v)).collect();
            let value = |logits: &[f64]| -> f64 {
                (0..3).map(|c| defined(&pixels, logits, place, c) * f64::from(gradient[3 * at + c])).sum()
            };
            for c in 0..3 {
                let expected = defined(&pixels, &own, place, c);
                assert!(
                    (f64::from(out[3 * at + c]) - expected).abs() < 1e-5,
                    "{at} {c}: {} {expected}",
                    out[3 * at + c]
                );
            }
            for b in (0..count).step_by(3) {
                let moved = |by: f64| {
                    let mut logits = own.clone();
                    logits[b] += by;
                    value(&logits)
                };
                let expected = (moved(1e-4) - moved(-1e-4)) / 2e-4;
                assert!((f64::from(found[at * count + b]) - expected).abs() < 1e-5, "{at} {b}: {expected}");
            }
        }
    }

    #[test]
    fn means_stay_within_the_window_whatever_the_weights() {
        let (_, pyramid) = pyramid();
        let count = pyramid.weights();
        let operator = WeightedMean(Arc::new(pyramid));
        // A weight far above the others takes it all, here the window's middle.
        let mut logits = vec![-300.0f32; 2 * SIZE.0 * SIZE.1 * count];
        logits.chunks_exact_mut(count).for_each(|of| of[12] = 300.0);
        let (out, ()) = operator.forward([&logits]);
        let (pixels, _) = self::pyramid();
        assert!(out.iter().zip(&pixels).all(|(a, b)| (a - b).abs() < 1e-6));
        let [gradient] = operator.backward([&logits], &(), &vec![1.0; out.len()], [true]);
        assert!(gradient.iter().all(|g| g.abs() < 1e-6));
    }

    #[test]
    fn images_that_do_not_divide_are_refused() {
        let refused = std::panic::catch_unwind(|| Pyramid::new(&[0.0; 6 * 4 * 3], 6, 4, &[3, 3, 3]));
        assert!(refused.is_err());
    }
}
