//! Group normalisation (Wu and He 2018) with weights of its own, a shift for each image before it and SiLU after it, as
//! U-Nets of diffusion models have it.
//!
//! y = silu(u), u = (s - mean)/sqrt(variance + eps) weight + bias, s = x + shift, with silu(u) = u/(1 + exp(-u)). Mean
//! and variance go over the pixels and channels of a group of an image.

#![expect(unsafe_code, reason = "results are written once, band by band")]

use crate::{
    fresh::filled,
    instructions::wide,
    normalisation::{sigmoid, slope},
    operator::Operator,
    sums::{BAND, added, all, columns},
};
use rayon::prelude::*;
use std::mem::MaybeUninit;

/// Pixels whose values are summed in f32.
const RUN: usize = 64;

/// Normalises `x` [N, pixels, C] plus `shift` [N, C] in groups, with `weight` and `bias` [1, C].
#[derive(Clone, Debug)]
pub struct GroupNorm {
    /// Pixels of an image.
    pub pixels: usize,
    /// C, a multiple of `groups`.
    pub channels: usize,
    /// Groups of an image.
    pub groups: usize,
    /// Added to variances.
    pub epsilon: f64,
    /// Whether SiLU follows.
    pub silu: bool,
}

/// Of an image, for each channel: mean and inverse deviation of its group.
#[derive(Clone, Debug)]
pub struct GroupMoments {
    mean: Vec<f32>,
    inverse: Vec<f32>,
}

/// u = x scale + offset, for each channel, and what is taken from x for x - mean.
struct Line {
    scale: Vec<f32>,
    offset: Vec<f32>,
    centre: Vec<f32>,
}

impl GroupNorm {
    /// Panics unless there are whole images of whole groups, and numbers for each channel.
    fn check(&self, [x, shift, weight, bias]: [&[f32]; 4]) {
        let size = self.pixels.checked_mul(self.channels).unwrap_or(0);
        assert!(size > 0 && x.len().is_multiple_of(size), "whole images of {self:?}");
        assert!(self.groups > 0 && self.channels.is_multiple_of(self.groups), "whole groups of {self:?}");
        assert_eq!(shift.len(), x.len() / size * self.channels, "a shift for each image and channel of {self:?}");
        assert!(weight.len() == self.channels && bias.len() == self.channels, "weights for each channel of {self:?}");
    }

    /// The mean of each channel's group, of sums over its pixels.
    fn by_group(&self, sums: &[f64]) -> Vec<f64> {
        let size = self.channels / self.groups;
        let count = (self.pixels * size) as f64;
        sums.chunks_exact(size).flat_map(|group| std::iter::repeat_n(group.iter().sum::<f64>() / count, size)).collect()
    }

    fn moments(&self, x: &[f32], shift: &[f32]) -> GroupMoments {
        let mean = self.by_group(&all(x, self.channels, |c, v| v + shift[c]));
        let mean: Vec<f32> = mean.into_iter().map(|v| v as f32).collect();
        let square = |c: usize, v: f32| (v + shift[c] - mean[c]) * (v + shift[c] - mean[c]);
        let variances = self.by_group(&all(x, self.channels, square));
        let inverse = variances.into_iter().map(|v| (1.0 / (v + self.epsilon).sqrt()) as f32).collect();
        GroupMoments { mean, inverse }
    }

    fn line(&self, moments: &GroupMoments, [shift, weight, bias]: [&[f32]; 3]) -> Line {
        let channels = 0..self.channels;
        let scale: Vec<f32> = channels.clone().map(|i| moments.inverse[i] * weight[i]).collect();
        let centre: Vec<f32> = channels.clone().map(|i| moments.mean[i] - shift[i]).collect();
        let offset = channels.map(|i| bias[i] - centre[i] * scale[i]).collect();
        Line { scale, offset, centre }
    }
}

/// u, or silu(u), channel by channel.
#[inline(always)]
fn forward<const SILU: bool>(out: &mut [MaybeUninit<f32>], x: &[f32], line: &Line) {
    let c = line.scale.len();
    for (out, x) in out.chunks_exact_mut(c).zip(x.chunks_exact(c)) {
        for (((out, x), scale), offset) in out.iter_mut().zip(x).zip(&line.scale).zip(&line.offset) {
            let u = x * scale + offset;
            out.write(if SILU { u * sigmoid(u) } else { u });
        }
    }
}

/// The gradient d of u, and, added to `sums`, its sums over the pixels with s - mean and alone.
#[inline(always)]
fn inner<const SILU: bool>(
    of_u: &mut [MaybeUninit<f32>],
    [x, gradient]: [&[f32]; 2],
    line: &Line,
    sums: (&mut [f64], &mut [f64]),
) {
    let c = line.scale.len();
    let (scale, offset, centre) = (&line.scale[..c], &line.offset[..c], &line.centre[..c]);
    let (mut with, mut alone) = (vec![0.0f32; c], vec![0.0f32; c]);
    let blocks = of_u.chunks_mut(RUN * c).zip(x.chunks(RUN * c)).zip(gradient.chunks(RUN * c));
    for ((of_u, x), gradient) in blocks {
        with.fill(0.0);
        alone.fill(0.0);
        for ((of_u, x), gradient) in of_u.chunks_exact_mut(c).zip(x.chunks_exact(c)).zip(gradient.chunks_exact(c)) {
            let (with, alone) = (&mut with[..c], &mut alone[..c]);
            for i in 0..c {
                let d = if SILU { gradient[i] * slope(x[i] * scale[i] + offset[i]) } else { gradient[i] };
                with[i] += d * (x[i] - centre[i]);
                alone[i] += d;
                of_u[i].write(d);
            }
        }
        for i in 0..c {
            sums.0[i] += f64::from(with[i]);
            sums.1[i] += f64::from(alone[i]);
        }
    }
}

/// `of_x = scale of_x - level - tilt (x - centre)`, channel by channel.
#[inline(always)]
fn outer(of_x: &mut [f32], x: &[f32], [scale, tilt, level, centre]: [&[f32]; 4]) {
    let c = scale.len();
    for (of_x, x) in of_x.chunks_exact_mut(c).zip(x.chunks_exact(c)) {
        let factors = scale.iter().zip(tilt).zip(level).zip(centre);
        for ((d, x), (((scale, tilt), level), centre)) in of_x.iter_mut().zip(x).zip(factors) {
            *d = scale * *d - level - tilt * (x - centre);
        }
    }
}

impl Operator<4> for GroupNorm {
    type Saved = Vec<GroupMoments>;

    fn forward(&self, inputs: [&[f32]; 4]) -> (Vec<f32>, Vec<GroupMoments>) {
        self.check(inputs);
        let [x, shift, weight, bias] = inputs;
        let (c, size) = (self.channels, self.pixels * self.channels);
        let mut moments = Vec::new();
        let image = |out: &mut [MaybeUninit<f32>], x: &[f32], shift: &[f32]| {
            let moments = self.moments(x, shift);
            let line = self.line(&moments, [shift, weight, bias]);
            out.par_chunks_mut(BAND * c).zip(x.par_chunks(BAND * c)).for_each(|(out, x)| {
                wide(
                    #[inline(always)]
                    || if self.silu { forward::<true>(out, x, &line) } else { forward::<false>(out, x, &line) },
                );
            });
            moments
        };
        // SAFETY: bands cover an image, images the result, and `forward` writes all that it is given.
        let out = unsafe {
            filled(x.len(), |out| {
                let inputs = x.par_chunks_exact(size).zip(shift.par_chunks_exact(c));
                let images = out.par_chunks_exact_mut(size).zip(inputs);
                images.map(|(out, (x, shift))| image(out, x, shift)).collect_into_vec(&mut moments);
            })
        };
        (out, moments)
    }

    fn backward(
        &self,
        inputs: [&[f32]; 4],
        saved: &Vec<GroupMoments>,
        gradient: &[f32],
        wanted: [bool; 4],
    ) -> [Vec<f32>; 4] {
        self.check(inputs);
        let [x, shift, weight, bias] = inputs;
        let (c, size) = (self.channels, self.pixels * self.channels);
        assert!(saved.len() * size == x.len() && gradient.len() == x.len(), "as many images as went forward");
        let mut sums = Vec::new();
        // SAFETY: `image_backward` writes all of an image.
        let of_x = unsafe {
            filled(x.len(), |of_x| {
                let inputs = x.par_chunks_exact(size).zip(gradient.par_chunks_exact(size));
                let images = of_x.par_chunks_exact_mut(size).zip(inputs).zip(shift.par_chunks_exact(c)).zip(saved);
                images
                    .map(|(((of_x, (x, gradient)), shift), moments)| {
                        let line = self.line(moments, [shift, weight, bias]);
                        self.image_backward(of_x, [x, gradient], &line, moments, weight)
                    })
                    .collect_into_vec(&mut sums);
            })
        };
        let of_shift = if wanted[1] {
            of_x.par_chunks_exact(size).flat_map_iter(|image| columns(image, c)).collect()
        } else {
            Vec::new()
        };
        let (mut of_weight, mut of_bias) = (vec![0.0f64; c], vec![0.0f64; c]);
        for ((with, alone), moments) in sums.iter().zip(saved) {
            for i in 0..c {
                of_weight[i] += with[i] * f64::from(moments.inverse[i]);
                of_bias[i] += alone[i];
            }
        }
        let small = |sums: Vec<f64>| sums.into_iter().map(|v| v as f32).collect();
        [of_x, of_shift, small(of_weight), small(of_bias)]
    }
}

impl GroupNorm {
    /// Writes the gradient of an image; returns the sums, by channel, of the gradient of u with s - mean and alone.
    fn image_backward(
        &self,
        of_x: &mut [MaybeUninit<f32>],
        [x, gradient]: [&[f32]; 2],
        line: &Line,
        moments: &GroupMoments,
        weight: &[f32],
    ) -> (Vec<f64>, Vec<f64>) {
        let c = self.channels;
        let bands = of_x.par_chunks_mut(BAND * c).zip(x.par_chunks(BAND * c)).zip(gradient.par_chunks(BAND * c));
        let sums: Vec<(Vec<f64>, Vec<f64>)> = bands
            .map(|((of_u, x), gradient)| {
                let (mut with, mut alone) = (vec![0.0; c], vec![0.0; c]);
                wide(
                    #[inline(always)]
                    || {
                        let sums = (&mut with[..], &mut alone[..]);
                        if self.silu {
                            inner::<true>(of_u, [x, gradient], line, sums);
                        } else {
                            inner::<false>(of_u, [x, gradient], line, sums);
                        }
                    },
                );
                (with, alone)
            })
            .collect();
        let (with, alone): (Vec<_>, Vec<_>) = sums.into_iter().unzip();
        let (with, alone) = (added(with, c), added(alone, c));
        let products: Vec<f64> = (0..c).map(|i| with[i] * f64::from(line.scale[i])).collect();
        let parts: Vec<f64> = (0..c).map(|i| alone[i] * f64::from(weight[i])).collect();
        let (products, parts) = (self.by_group(&products), self.by_group(&parts));
        let inverse = |i: usize| f64::from(moments.inverse[i]);
        let tilt: Vec<f32> = (0..c).map(|i| (products[i] * inverse(i) * inverse(i)) as f32).collect();
        let level: Vec<f32> = (0..c).map(|i| (parts[i] * inverse(i)) as f32).collect();
        of_x.par_chunks_mut(BAND * c).zip(x.par_chunks(BAND * c)).for_each(|(of_x, x)| {
            // SAFETY: `inner` wrote all of a band.
            let of_x = unsafe { of_x.assume_init_mut() };
            wide(
                #[inline(always)]
                || outer(of_x, x, [&line.scale, &tilt, &level, &line.centre]),
            );
        });
        (with, alone)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made_up::numbers;

    /// Output in f64 from the definition.
    fn defined(norm: &GroupNorm, [x, shift, weight, bias]: [&[f64]; 4]) -> Vec<f64> {
        let (c, size) = (norm.channels, norm.pixels * norm.channels);
        let per = c / norm.groups;
        let mut out = vec![0.0; x.len()];
        for (image, x) in x.chunks_exact(size).enumerate() {
            let s: Vec<f64> = x.iter().enumerate().map(|(i, v)| v + shift[image * c + i % c]).collect();
            for group in 0..norm.groups {
                let inside = |i: &usize| i % c / per == group;
                let count = (norm.pixels * per) as f64;
                let mean = (0..size).filter(inside).map(|i| s[i]).sum::<f64>() / count;
                let variance = (0..size).filter(inside).map(|i| (s[i] - mean).powi(2)).sum::<f64>() / count;
                for i in (0..size).filter(inside) {
                    let u = (s[i] - mean) / (variance + norm.epsilon).sqrt() * weight[i % c] + bias[i % c];
                    out[image * size + i] = if norm.silu { u / (1.0 + (-u).exp()) } else { u };
                }
            }
        }
        out
    }

    #[test]
    fn outputs_and_gradients_are_those_of_the_definition() {
        for (images, pixels, channels, groups, silu) in
            [(1, 700, 24, 8, true), (2, 65, 12, 3, false), (2, 33, 5, 5, true), (1, 1100, 16, 1, true)]
        {
            let norm = GroupNorm { pixels, channels, groups, epsilon: 1e-6, silu };
            let inputs = [
                numbers(1, images * pixels * channels),
                numbers(2, images * channels),
                numbers(3, channels),
                numbers(4, channels),
            ];
            let gradient = numbers(5, inputs[0].len());
            let slices = inputs.each_ref().map(Vec::as_slice);
            let (out, saved) = norm.forward(slices);
            let exact = inputs.each_ref().map(|v| v.iter().map(|v| f64::from(*v)).collect::<Vec<_>>());
            let expected = defined(&norm, exact.each_ref().map(Vec::as_slice));
            assert!(out.iter().zip(&expected).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-5));
            let found = norm.backward(slices, &saved, &gradient, [true; 4]);
            for (which, found) in found.iter().enumerate() {
                assert_eq!(found.len(), inputs[which].len());
                for at in [0, 1, found.len() / 2, found.len() - 1] {
                    let value = |by: f64| {
                        let mut moved = exact.clone();
                        moved[which][at] += by;
                        let out = defined(&norm, moved.each_ref().map(Vec::as_slice));
                        out.iter().zip(&gradient).map(|(v, g)| v * f64::from(*g)).sum::<f64>()
                    };
                    let expected = (value(1e-4) - value(-1e-4)) / 2e-4;
                    let error = (f64::from(found[at]) - expected).abs();
                    assert!(error < 2e-4 * expected.abs().max(1.0), "{norm:?} {which} {at}: {} {expected}", found[at]);
                }
            }
        }
    }

    #[test]
    fn bits_do_not_depend_on_the_number_of_threads() {
        let norm = GroupNorm { pixels: 1300, channels: 48, groups: 6, epsilon: 1e-6, silu: true };
        let (x, shift) = (numbers(1, 3 * 1300 * 48), numbers(2, 3 * 48));
        let (weight, bias) = (numbers(3, 48), numbers(4, 48));
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| {
                let inputs = [&x[..], &shift, &weight, &bias];
                let (out, saved) = norm.forward(inputs);
                (norm.backward(inputs, &saved, &out, [true; 4]), out)
            })
        };
        let one = run(1);
        assert!(one == run(2) && one == run(5));
    }
}
