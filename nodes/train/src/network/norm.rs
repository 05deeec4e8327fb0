//! Group normalisation, modulation by the time embedding, and SiLU, in one operator.
//!
//! y = silu(u), u = (x - mean)/sqrt(variance + eps) (1 + scale) + shift, with mean and variance over the pixels and
//! channels of a group of an image (Wu and He 2018), scale and shift for each image and channel (Perez et al. 2018), and
//! silu(u) = u/(1 + exp(-u)).

use super::{
    op::{Operator, apply},
    sums::by_column,
};
use burn::tensor::Tensor;
use rayon::prelude::*;

/// Channels of a group.
const GROUP: usize = 8;
const EPSILON: f64 = 1e-5;

/// Normalises `x` [N, H, W, C] in groups of 8 channels, modulates it by `modulation` [N, 2 C] (scales, then shifts), and
/// applies SiLU.
pub(crate) fn norm_silu(x: Tensor<4>, modulation: Tensor<2>) -> Tensor<4> {
    let shape = x.dims();
    let [_, height, width, channels] = shape;
    assert_eq!(channels % GROUP, 0, "channels come in groups of {GROUP}");
    apply(NormSilu { pixels: height * width, channels }, [x.into(), modulation.into()], shape)
}

/// SiLU of every value.
pub(crate) fn silu<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    let shape = x.dims();
    apply(Silu, [x.into()], shape)
}

/// exp by range reduction and a polynomial (Cephes' coefficients): plain arithmetic, so the same bits everywhere, and
/// the compiler can do several at once. Relative error below 2e-7; arguments are clamped to [-87, 87].
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    const ROUND: f32 = 12_582_912.0;
    let x = x.clamp(-87.0, 87.0);
    // The sum's last bits are the nearest whole number.
    let rounded = x * core::f32::consts::LOG2_E + ROUND;
    let n = rounded - ROUND;
    let r = x - n * 0.693_359_4 + n * 2.121_944_4e-4;
    let mut p = 1.987_569_1e-4;
    p = p * r + 1.398_199_9e-3;
    p = p * r + 8.333_452e-3;
    p = p * r + 4.166_579_6e-2;
    p = p * r + 1.666_666_5e-1;
    p = p * r + 0.5;
    let value = p * r * r + r + 1.0;
    value * f32::from_bits(rounded.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127) << 23)
}

#[inline(always)]
fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// The derivative of SiLU.
#[inline(always)]
fn slope(x: f32) -> f32 {
    let s = sigmoid(x);
    s * (1.0 + x * (1.0 - s))
}

#[derive(Clone, Debug)]
struct NormSilu {
    pixels: usize,
    channels: usize,
}

/// Mean and inverse deviation by image and channel.
type Moments = Vec<(Vec<f32>, Vec<f32>)>;

impl NormSilu {
    #[inline(always)]
    fn moments(&self, x: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let count = (self.pixels * GROUP) as f64;
        let per_group = |sums: Vec<f64>| -> Vec<f64> {
            sums.chunks_exact(GROUP).flat_map(|g| [g.iter().sum::<f64>() / count; GROUP]).collect()
        };
        let means: Vec<f32> = per_group(by_column(x, self.channels, |_, v| v)).into_iter().map(|v| v as f32).collect();
        let variances = per_group(by_column(x, self.channels, |c, v| (v - means[c]) * (v - means[c])));
        let inverse = variances.into_iter().map(|v| (1.0 / (v + EPSILON).sqrt()) as f32).collect();
        (means, inverse)
    }
}

/// silu(x a + b), channel by channel.
#[inline(always)]
fn activate(out: &mut [f32], x: &[f32], a: &[f32], b: &[f32]) {
    for (out, x) in out.chunks_exact_mut(a.len()).zip(x.chunks_exact(a.len())) {
        for (((out, x), a), b) in out.iter_mut().zip(x).zip(a).zip(b) {
            let u = x * a + b;
            *out = u * sigmoid(u);
        }
    }
}

/// Runs `f`, compiled for eight lanes where the machine has them. Lanes change no bits: each holds another value, and
/// Rust never fuses a product and a sum by itself.
#[inline(always)]
fn wide<T>(f: impl FnOnce() -> T) -> T {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn eight<T>(f: impl FnOnce() -> T) -> T {
            f()
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the machine has AVX2.
            return unsafe { eight(f) };
        }
    }
    f()
}

impl Operator<2> for NormSilu {
    type Saved = Moments;

    fn forward(&self, [x, modulation]: [&[f32]; 2]) -> (Vec<f32>, Moments) {
        let (c, size) = (self.channels, self.pixels * self.channels);
        let mut out = vec![0.0; x.len()];
        let moments = out
            .par_chunks_exact_mut(size)
            .zip(x.par_chunks_exact(size))
            .zip(modulation.par_chunks_exact(2 * c))
            .map(|((out, x), modulation)| {
                let (mean, inverse) = wide(
                    #[inline(always)]
                    || self.moments(x),
                );
                // u = x a + b
                let a: Vec<f32> = (0..c).map(|i| inverse[i] * (1.0 + modulation[i])).collect();
                let b: Vec<f32> = (0..c).map(|i| modulation[c + i] - mean[i] * a[i]).collect();
                wide(
                    #[inline(always)]
                    || activate(out, x, &a, &b),
                );
                (mean, inverse)
            })
            .collect();
        (out, moments)
    }

    fn backward(&self, [x, modulation]: [&[f32]; 2], saved: &Moments, gradient: &[f32], _: [bool; 2]) -> [Vec<f32>; 2] {
        let (c, size) = (self.channels, self.pixels * self.channels);
        let mut of_x = vec![0.0; x.len()];
        let mut of_modulation = vec![0.0; modulation.len()];
        of_x.par_chunks_exact_mut(size).zip(of_modulation.par_chunks_exact_mut(2 * c)).enumerate().for_each(
            |(image, (of_x, of_modulation))| {
                let at = image * size;
                let part = Image {
                    x: &x[at..at + size],
                    gradient: &gradient[at..at + size],
                    modulation: &modulation[image * 2 * c..(image + 1) * 2 * c],
                    moments: &saved[image],
                };
                wide(
                    #[inline(always)]
                    || self.image_backward(&part, of_x, of_modulation),
                );
            },
        );
        [of_x, of_modulation]
    }
}

struct Image<'a> {
    x: &'a [f32],
    gradient: &'a [f32],
    modulation: &'a [f32],
    moments: &'a (Vec<f32>, Vec<f32>),
}

impl NormSilu {
    #[inline(always)]
    fn image_backward(&self, image: &Image<'_>, of_x: &mut [f32], of_modulation: &mut [f32]) {
        let c = self.channels;
        let (mean, inverse) = image.moments;
        let a: Vec<f32> = (0..c).map(|i| inverse[i] * (1.0 + image.modulation[i])).collect();
        let b: Vec<f32> = (0..c).map(|i| image.modulation[c + i] - mean[i] * a[i]).collect();
        // The gradient of u, and its sums with (x - mean) and alone over the pixels.
        let mut sums = (vec![0.0f64; c], vec![0.0f64; c]);
        for first in (0..c).step_by(GROUP) {
            let (a, b, mean) = (lanes(&a, first), lanes(&b, first), lanes(mean, first));
            for block in (0..self.pixels).step_by(64) {
                let (mut with, mut alone) = ([0.0f32; GROUP], [0.0f32; GROUP]);
                for pixel in block..(block + 64).min(self.pixels) {
                    let at = pixel * c + first;
                    let (x, g) = (lanes(image.x, at), lanes(image.gradient, at));
                    let mut d = [0.0f32; GROUP];
                    for i in 0..GROUP {
                        d[i] = g[i] * slope(x[i] * a[i] + b[i]);
                        with[i] += d[i] * (x[i] - mean[i]);
                        alone[i] += d[i];
                    }
                    of_x[at..at + GROUP].copy_from_slice(&d);
                }
                for i in 0..GROUP {
                    sums.0[first + i] += f64::from(with[i]);
                    sums.1[first + i] += f64::from(alone[i]);
                }
            }
        }
        for i in 0..c {
            of_modulation[i] = (sums.0[i] * f64::from(inverse[i])) as f32;
            of_modulation[c + i] = sums.1[i] as f32;
        }
        // The means over a group of the gradient of the normalised value, with that value and alone.
        let count = (self.pixels * GROUP) as f64;
        let (mut with, mut alone) = (vec![0.0f32; c], vec![0.0f32; c]);
        let gain: Vec<f32> = image.modulation[..c].iter().map(|scale| 1.0 + scale).collect();
        for group in (0..c).step_by(GROUP) {
            let scaled = |sums: &[f64], extra: &[f32]| -> f64 {
                (group..group + GROUP).map(|i| sums[i] * f64::from(extra[i])).sum::<f64>() / count
            };
            // a = inverse gain, so this is the sum of gain d xhat.
            let (w, m) = (scaled(&sums.0, &a), scaled(&sums.1, &gain));
            for i in group..group + GROUP {
                // of x: a d - inverse (mean + xhat w), xhat = (x - mean) inverse
                with[i] = (w * f64::from(inverse[i]) * f64::from(inverse[i])) as f32;
                alone[i] = (m * f64::from(inverse[i])) as f32;
            }
        }
        for first in (0..c).step_by(GROUP) {
            let (a, mean) = (lanes(&a, first), lanes(mean, first));
            let (with, alone) = (lanes(&with, first), lanes(&alone, first));
            for at in (first..of_x.len()).step_by(c) {
                let (x, mut d) = (lanes(image.x, at), lanes(of_x, at));
                for i in 0..GROUP {
                    d[i] = a[i] * d[i] - alone[i] - with[i] * (x[i] - mean[i]);
                }
                of_x[at..at + GROUP].copy_from_slice(&d);
            }
        }
    }
}

/// The values of a group's channels.
#[inline(always)]
fn lanes(values: &[f32], at: usize) -> [f32; GROUP] {
    values[at..at + GROUP].try_into().expect("channels come in groups")
}

#[derive(Clone, Debug)]
struct Silu;

impl Operator<1> for Silu {
    type Saved = ();

    fn forward(&self, [x]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        (x.iter().map(|x| x * sigmoid(*x)).collect(), ())
    }

    fn backward(&self, [x]: [&[f32]; 1], _: &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        [x.iter().zip(gradient).map(|(x, g)| g * slope(*x)).collect()]
    }
}
