//! Group normalisation, modulation by the time embedding, and SiLU, in one operator.
//!
//! y = silu(u), u = (x - mean)/sqrt(variance + eps) (1 + scale) + shift, with silu(u) = u/(1 + exp(-u)). Mean and
//! variance go over the pixels and channels of a group of an image (Wu and He 2018); scale and shift are for each image
//! and channel (Perez et al. 2018).

#![expect(unsafe_code, reason = "results are written once, band by band")]

use crate::{
    elementary::{exp, map, map2},
    fresh::filled,
    instructions::wide,
    operator::Operator,
    sums::{BAND, added, all},
};
use rayon::prelude::*;
use std::mem::MaybeUninit;

/// Channels of a group.
pub const GROUP: usize = 8;
const EPSILON: f64 = 1e-5;

#[inline(always)]
pub(crate) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// The derivative of SiLU.
#[inline(always)]
pub(crate) fn slope(x: f32) -> f32 {
    let s = sigmoid(x);
    s * (1.0 + x * (1.0 - s))
}

/// Normalises `x` [N, pixels, C] in groups of [`GROUP`] channels, modulates it by `modulation` [N, 2 C] (scales, then
/// shifts), and applies SiLU.
#[derive(Clone, Debug)]
pub struct NormSilu {
    /// Pixels of an image.
    pub pixels: usize,
    /// C, a multiple of [`GROUP`].
    pub channels: usize,
    /// Whether values are normalised; otherwise they are only modulated, and a pixel depends on no other pixel.
    pub normalise: bool,
}

/// Pixels whose values are summed in f32.
const RUN: usize = 64;

/// Of an image, for each channel.
#[derive(Clone, Debug)]
pub struct Moments {
    mean: Vec<f32>,
    /// Of the deviation.
    inverse: Vec<f32>,
}

/// u = x scale + shift, for each channel.
struct Affine {
    scale: Vec<f32>,
    shift: Vec<f32>,
}

impl NormSilu {
    /// Panics unless there are whole images of whole groups, and a modulation for each.
    fn check(&self, x: &[f32], modulation: &[f32]) {
        let size = self.pixels.checked_mul(self.channels).unwrap_or(0);
        assert!(size > 0, "images of {} pixels and {} channels", self.pixels, self.channels);
        let images = x.len() / size;
        assert_eq!(x.len(), images * size, "whole images");
        assert_eq!(modulation.len(), images * 2 * self.channels, "scales and shifts for each image");
        assert!(self.channels.is_multiple_of(GROUP), "whole groups");
    }

    /// Means of `f(channel, value)` over the pixels and channels of each group.
    fn means(&self, x: &[f32], f: impl Fn(usize, f32) -> f32 + Sync) -> impl Iterator<Item = f64> {
        let sums = all(x, self.channels, f);
        let count = (self.pixels * GROUP) as f64;
        (0..self.channels / GROUP)
            .flat_map(move |g| [sums[g * GROUP..(g + 1) * GROUP].iter().sum::<f64>() / count; GROUP])
    }

    fn moments(&self, x: &[f32]) -> Moments {
        if !self.normalise {
            return Moments { mean: vec![0.0; self.channels], inverse: vec![1.0; self.channels] };
        }
        let mean: Vec<f32> = self.means(x, |_, v| v).map(|v| v as f32).collect();
        let variances = self.means(x, |c, v| (v - mean[c]) * (v - mean[c]));
        let inverse = variances.map(|v| (1.0 / (v + EPSILON).sqrt()) as f32).collect();
        Moments { mean, inverse }
    }

    fn affine(&self, moments: &Moments, modulation: &[f32]) -> Affine {
        let c = self.channels;
        let scale: Vec<f32> = (0..c).map(|i| moments.inverse[i] * (1.0 + modulation[i])).collect();
        let shift = (0..c).map(|i| modulation[c + i] - moments.mean[i] * scale[i]).collect();
        Affine { scale, shift }
    }
}

/// silu(x scale + shift), channel by channel.
#[inline(always)]
fn activate(out: &mut [MaybeUninit<f32>], x: &[f32], affine: &Affine) {
    let c = affine.scale.len();
    for (out, x) in out.chunks_exact_mut(c).zip(x.chunks_exact(c)) {
        for (((out, x), scale), shift) in out.iter_mut().zip(x).zip(&affine.scale).zip(&affine.shift) {
            let u = x * scale + shift;
            out.write(u * sigmoid(u));
        }
    }
}

impl Operator<2> for NormSilu {
    type Saved = Vec<Moments>;

    fn forward(&self, [x, modulation]: [&[f32]; 2]) -> (Vec<f32>, Vec<Moments>) {
        let (c, size) = (self.channels, self.pixels * self.channels);
        self.check(x, modulation);
        let mut moments = Vec::new();
        let image = |out: &mut [MaybeUninit<f32>], x: &[f32], modulation: &[f32]| {
            let moments = self.moments(x);
            let affine = self.affine(&moments, modulation);
            out.par_chunks_mut(BAND * c).zip(x.par_chunks(BAND * c)).for_each(|(out, x)| {
                wide(
                    #[inline(always)]
                    || activate(out, x, &affine),
                );
            });
            moments
        };
        // SAFETY: bands cover an image, images the result, and `activate` writes all that it is given.
        let out = unsafe {
            filled(x.len(), |out| {
                let inputs = x.par_chunks_exact(size).zip(modulation.par_chunks_exact(2 * c));
                out.par_chunks_exact_mut(size)
                    .zip(inputs)
                    .map(|(out, (x, modulation))| image(out, x, modulation))
                    .collect_into_vec(&mut moments);
            })
        };
        (out, moments)
    }

    fn backward(
        &self,
        [x, modulation]: [&[f32]; 2],
        saved: &Vec<Moments>,
        gradient: &[f32],
        _: [bool; 2],
    ) -> [Vec<f32>; 2] {
        let (c, size) = (self.channels, self.pixels * self.channels);
        self.check(x, modulation);
        assert!(saved.len() * size == x.len() && gradient.len() == x.len(), "as many images as went forward");
        let mut of_modulation = vec![0.0; modulation.len()];
        // SAFETY: `image_backward` writes all of an image.
        let of_x = unsafe {
            filled(x.len(), |of_x| {
                let images = of_x.par_chunks_exact_mut(size).zip(of_modulation.par_chunks_exact_mut(2 * c)).zip(saved);
                images.enumerate().for_each(|(image, ((of_x, of_modulation), moments))| {
                    let (at, modulated) = (image * size..(image + 1) * size, image * 2 * c..(image + 1) * 2 * c);
                    let image = Image {
                        x: &x[at.clone()],
                        gradient: &gradient[at],
                        modulation: &modulation[modulated],
                        moments,
                    };
                    self.image_backward(&image, of_x, of_modulation);
                });
            })
        };
        [of_x, of_modulation]
    }
}

struct Image<'a> {
    x: &'a [f32],
    gradient: &'a [f32],
    modulation: &'a [f32],
    moments: &'a Moments,
}

impl NormSilu {
    fn image_backward(&self, image: &Image<'_>, of_x: &mut [MaybeUninit<f32>], of_modulation: &mut [f32]) {
        let c = self.channels;
        let Moments { mean, inverse } = image.moments;
        let affine = self.affine(image.moments, image.modulation);
        // The gradient of u, and its sums with (x - mean) and alone over the pixels.
        let bands =
            of_x.par_chunks_mut(BAND * c).zip(image.x.par_chunks(BAND * c)).zip(image.gradient.par_chunks(BAND * c));
        let sums = bands
            .map(|((of_u, x), gradient)| {
                let mut sums = vec![0.0; 2 * c];
                wide(
                    #[inline(always)]
                    || of_inner(of_u, [x, gradient], &affine, mean, &mut sums),
                );
                sums
            })
            .collect();
        let sums = added(sums, 2 * c);
        let (with, alone) = sums.split_at(c);
        for i in 0..c {
            of_modulation[i] = (with[i] * f64::from(inverse[i])) as f32;
            of_modulation[c + i] = alone[i] as f32;
        }
        // The means over a group of the gradient of the normalised value, with that value and alone: as a line of x,
        // of x = scale d - slope (x - mean) - offset.
        let count = (self.pixels * GROUP) as f64;
        let (mut slope, mut offset) = (vec![0.0f32; c], vec![0.0f32; c]);
        for group in (0..c).step_by(GROUP).take_while(|_| self.normalise) {
            let channels = group..group + GROUP;
            let w = channels.clone().map(|i| with[i] * f64::from(affine.scale[i])).sum::<f64>() / count;
            let m = channels.clone().map(|i| alone[i] * f64::from(1.0 + image.modulation[i])).sum::<f64>() / count;
            for i in channels {
                slope[i] = (w * f64::from(inverse[i]) * f64::from(inverse[i])) as f32;
                offset[i] = (m * f64::from(inverse[i])) as f32;
            }
        }
        of_x.par_chunks_mut(BAND * c).zip(image.x.par_chunks(BAND * c)).for_each(|(of_x, x)| {
            // SAFETY: `of_inner` wrote all of a band.
            let of_x = unsafe { of_x.assume_init_mut() };
            wide(
                #[inline(always)]
                || of_outer(of_x, x, [&affine.scale, &slope, &offset, mean]),
            );
        });
    }
}

/// The gradient d of u = x scale + shift, and, added to `sums`, its sums over the pixels with x - mean and alone.
#[inline(always)]
fn of_inner(
    of_u: &mut [MaybeUninit<f32>],
    [x, gradient]: [&[f32]; 2],
    affine: &Affine,
    mean: &[f32],
    sums: &mut [f64],
) {
    let c = mean.len();
    let mut first = 0;
    while first < c {
        // Two groups at once fill sixteen lanes.
        if first + 2 * GROUP <= c {
            of_inner_channels::<{ 2 * GROUP }>(of_u, [x, gradient], affine, mean, sums, first);
            first += 2 * GROUP;
        } else {
            of_inner_channels::<GROUP>(of_u, [x, gradient], affine, mean, sums, first);
            first += GROUP;
        }
    }
}

#[inline(always)]
fn of_inner_channels<const N: usize>(
    of_u: &mut [MaybeUninit<f32>],
    [x, gradient]: [&[f32]; 2],
    affine: &Affine,
    mean: &[f32],
    sums: &mut [f64],
    first: usize,
) {
    let c = mean.len();
    let (scale, shift, mean) =
        (lanes::<N>(&affine.scale, first), lanes::<N>(&affine.shift, first), lanes::<N>(mean, first));
    let pixels = x.len() / c;
    for block in (0..pixels).step_by(RUN) {
        let (mut with, mut alone) = ([0.0f32; N], [0.0f32; N]);
        for pixel in block..(block + RUN).min(pixels) {
            let at = pixel * c + first;
            let (x, g) = (lanes::<N>(x, at), lanes::<N>(gradient, at));
            let mut d = [0.0f32; N];
            for i in 0..N {
                d[i] = g[i] * slope(x[i] * scale[i] + shift[i]);
                with[i] += d[i] * (x[i] - mean[i]);
                alone[i] += d[i];
            }
            of_u[at..at + N].write_copy_of_slice(&d);
        }
        for i in 0..N {
            sums[first + i] += f64::from(with[i]);
            sums[c + first + i] += f64::from(alone[i]);
        }
    }
}

/// `of_x = scale of_x - offset - slope (x - mean)`, channel by channel.
#[inline(always)]
fn of_outer(of_x: &mut [f32], x: &[f32], [scale, slope, offset, mean]: [&[f32]; 4]) {
    let c = mean.len();
    for (of_x, x) in of_x.chunks_exact_mut(c).zip(x.chunks_exact(c)) {
        let factors = scale.iter().zip(slope).zip(offset).zip(mean);
        for ((d, x), (((scale, slope), offset), mean)) in of_x.iter_mut().zip(x).zip(factors) {
            *d = scale * *d - offset - slope * (x - mean);
        }
    }
}

/// The values of some channels.
#[inline(always)]
fn lanes<const N: usize>(values: &[f32], at: usize) -> [f32; N] {
    values[at..at + N].try_into().expect("as many as asked for")
}

/// SiLU of every value.
#[derive(Clone, Debug)]
pub struct Silu;

impl Operator<1> for Silu {
    type Saved = ();

    fn forward(&self, [x]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        let silu = map(
            x,
            #[inline(always)]
            |x| x * sigmoid(x),
        );
        (silu, ())
    }

    fn backward(&self, [x]: [&[f32]; 1], (): &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        [map2(
            x,
            gradient,
            #[inline(always)]
            |x, g| g * slope(x),
        )]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made_up::numbers;

    /// Output in f64 from the definition.
    fn defined(norm: &NormSilu, x: &[f64], modulation: &[f64]) -> Vec<f64> {
        let (c, size) = (norm.channels, norm.pixels * norm.channels);
        let mut out = vec![0.0; x.len()];
        for (image, x) in x.chunks_exact(size).enumerate() {
            for group in 0..c / GROUP {
                let inside = |i: &usize| i % c / GROUP == group;
                let count = (norm.pixels * GROUP) as f64;
                let mut mean = (0..size).filter(inside).map(|i| x[i]).sum::<f64>() / count;
                let mut variance = (0..size).filter(inside).map(|i| (x[i] - mean).powi(2)).sum::<f64>() / count;
                if !norm.normalise {
                    (mean, variance) = (0.0, 1.0 - EPSILON);
                }
                for i in (0..size).filter(inside) {
                    let modulation = &modulation[image * 2 * c..(image + 1) * 2 * c];
                    let u =
                        (x[i] - mean) / (variance + EPSILON).sqrt() * (1.0 + modulation[i % c]) + modulation[c + i % c];
                    out[image * size + i] = u / (1.0 + (-u).exp());
                }
            }
        }
        out
    }

    #[test]
    fn normalisation_and_its_gradients_are_what_they_say_over_runs_and_bands() {
        for (images, pixels, channels, normalise) in
            [(1, 700, 24, true), (2, 1100, 16, true), (1, 513, 40, true), (2, 65, 8, true), (2, 700, 24, false)]
        {
            let norm = NormSilu { pixels, channels, normalise };
            let (x, modulation) = (numbers(1, images * pixels * channels), numbers(2, images * 2 * channels));
            let gradient = numbers(3, x.len());
            let (out, moments) = norm.forward([&x, &modulation]);
            let wide = |values: &[f32]| values.iter().map(|v| f64::from(*v)).collect::<Vec<f64>>();
            let inputs = [wide(&x), wide(&modulation)];
            let expected = defined(&norm, &inputs[0], &inputs[1]);
            assert!(out.iter().zip(&expected).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-5));
            let found = norm.backward([&x, &modulation], &moments, &gradient, [true; 2]);
            for (which, found) in found.iter().enumerate() {
                for at in [0, 1, found.len() / 2 + 3, found.len() - 1] {
                    let value = |by: f64| {
                        let mut moved = inputs.clone();
                        moved[which][at] += by;
                        let out = defined(&norm, &moved[0], &moved[1]);
                        out.iter().zip(&gradient).map(|(v, g)| v * f64::from(*g)).sum::<f64>()
                    };
                    let expected = (value(1e-4) - value(-1e-4)) / 2e-4;
                    let error = (f64::from(found[at]) - expected).abs();
                    assert!(error < 1e-4 * expected.abs().max(1.0), "{norm:?} {which} {at}: {} {expected}", found[at]);
                }
            }
        }
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused() {
        let refused = |pixels, channels, x: usize, modulation: usize| {
            let norm = NormSilu { pixels, channels, normalise: true };
            let (x, modulation) = (vec![1.0; x], vec![1.0; modulation]);
            std::panic::catch_unwind(move || _ = norm.forward([&x, &modulation])).is_err()
        };
        assert!(!refused(2, 8, 32, 32));
        assert!(refused(2, 8, 31, 32) && refused(2, 8, 32, 31) && refused(2, 12, 48, 48) && refused(0, 8, 0, 0));
        // More than a number of 64 bits holds, and 8 in what it does hold.
        let (pixels, channels) = (768_614_336_404_564_651_usize, 24);
        assert_eq!(pixels.wrapping_mul(channels), 8);
        assert!(refused(pixels, channels, 8, 48));
    }

    #[test]
    fn bits_do_not_depend_on_the_number_of_threads() {
        let norm = NormSilu { pixels: 1300, channels: 48, normalise: true };
        let (x, modulation) = (numbers(1, 3 * 1300 * 48), numbers(2, 3 * 96));
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| {
                let (out, moments) = norm.forward([&x, &modulation]);
                (norm.backward([&x, &modulation], &moments, &out, [true; 2]), out)
            })
        };
        let one = run(1);
        assert!(one == run(2) && one == run(5));
    }
}
