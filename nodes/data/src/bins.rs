//! Blocks of a picture's pixels: how bright each is, how a display shows it, and where neighbours differ.
//!
//! Display values are those of the preview that is exposed to mid grey. The mean of a block is less noisy than its
//! pixels are, so that few samples do. Who has many takes blocks of one pixel.

use crate::{
    Image,
    image::{LUMINANCE, luminance, preview},
    maths::{exp, log},
};

/// Side of a block in pixels, where samples are few.
pub const BIN: usize = 4;
/// Luminance that the geometric mean is exposed to.
pub const KEY: f64 = 0.18;
/// Display values that two blocks side by side differ by at an edge, beside what their noise explains.
const STEP: f64 = 0.04;
/// Standard errors of each of two blocks that their difference must exceed.
const SURE: f64 = 2.0;

/// Blocks of pixels; those at the border may be smaller.
pub struct Bins {
    /// In a row.
    pub width: usize,
    /// Mean luminance of each.
    pub means: Vec<f64>,
}

/// The mean over each block of what `value` makes of a pixel's place, with the block's number of pixels.
fn blocks(width: usize, height: usize, side: usize, value: impl Fn(usize, usize) -> f64) -> Vec<(f64, f64)> {
    let mut out = Vec::new();
    for top in (0..height).step_by(side) {
        for left in (0..width).step_by(side) {
            let (mut sum, mut count) = (0.0, 0.0);
            for y in top..(top + side).min(height) {
                for x in left..(left + side).min(width) {
                    sum += value(x, y);
                    count += 1.0;
                }
            }
            out.push((sum / count, count));
        }
    }
    out
}

/// The standard error of the mean luminance of each block of `side`, by the variance of single samples.
pub fn errors(variance: &Image, spp: u64, side: usize) -> Vec<f64> {
    // As if the errors of the three colours went together, as most do.
    let deviation = |x, y| {
        let rgb = variance.pixel(x, y).iter().zip(LUMINANCE).map(|(v, w)| f64::from(w) * f64::from(*v).max(0.0).sqrt());
        let luminance: f64 = rgb.sum();
        luminance * luminance
    };
    blocks(variance.width(), variance.height(), side, deviation)
        .into_iter()
        .map(|(variance, count)| (variance / (spp as f64 * count)).sqrt())
        .collect()
}

/// The display value of a luminance.
fn show(luminance: f64, exposure: f64) -> f64 {
    f64::from(preview((luminance * exposure) as f32))
}

impl Bins {
    /// Blocks of `side` x `side` pixels.
    pub fn of(image: &Image, side: usize) -> Self {
        let value = |x, y| f64::from(luminance(image.pixel(x, y)));
        let means = blocks(image.width(), image.height(), side, value).into_iter().map(|(mean, _)| mean).collect();
        Self { width: image.width().div_ceil(side), means }
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.means.len() / self.width
    }

    /// The geometric mean, in an image of this mean luminance.
    pub fn geometric_mean(&self, mean: f64) -> f64 {
        let floor = (mean * 1e-4).max(1e-30);
        exp(self.means.iter().map(|b| log(b.max(floor))).sum::<f64>() / self.means.len() as f64)
    }

    /// The same bins without those that are black: what is behind a scene does not make it brighter or darker.
    fn lit(&self, mean: f64) -> Self {
        Self { width: 1, means: self.means.iter().copied().filter(|bin| *bin > BLACK * mean).collect() }
    }

    /// The display value of each.
    pub fn shown(&self, exposure: f64) -> Vec<f64> {
        self.means.iter().map(|mean| show(*mean, exposure)).collect()
    }

    /// How far noise may have moved the display value of each, by its standard error.
    pub fn unsure(&self, exposure: f64, errors: &[f64]) -> Vec<f64> {
        let moved = |(mean, error): (&f64, &f64)| show(mean + SURE * error, exposure) - show(*mean, exposure);
        self.means.iter().zip(errors).map(moved).collect()
    }

    /// Neighbours, each with the one to its right or below.
    pub fn pairs(&self) -> impl Iterator<Item = (usize, usize)> {
        pairs(self.width, self.height())
    }
}

/// Neighbours in a grid, by index, each with the one to its right or below.
pub fn pairs(width: usize, height: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..width * height).flat_map(move |at| {
        let right = (at % width + 1 < width).then_some((at, at + 1));
        let below = (at + width < width * height).then_some((at, at + width));
        right.into_iter().chain(below)
    })
}

/// How many neighbours have an edge between them: display values that differ by more than noise may explain.
pub fn edges(pairs: impl Iterator<Item = (usize, usize)>, shown: &[f64], unsure: &[f64]) -> usize {
    let edge =
        |(a, b): &(usize, usize)| (shown[*a] - shown[*b]).abs() - STEP > unsure[*a].max(0.0) + unsure[*b].max(0.0);
    pairs.filter(edge).count()
}

/// The mean luminance of an image, negative values counted as 0.
pub fn mean_luminance(image: &Image) -> f64 {
    let pixels = image.data().chunks_exact(3).map(|rgb| f64::from(luminance(rgb)).max(0.0));
    pixels.sum::<f64>() / (image.width() * image.height()) as f64
}

/// The geometric mean over bins of an image's luminance, with bins below 1/10,000 of the mean counted as that much:
/// what the exposure's `key` is divided by.
pub fn geometric_mean_luminance(image: &Image) -> f64 {
    Bins::of(image, BIN).geometric_mean(mean_luminance(image))
}

/// A bin is black below this share of the mean. Half precision makes tiny numbers of what should be 0.
const BLACK: f64 = 1e-5;

/// The same mean without black bins, and the share of black bins. A black background then has no part in it. An image
/// without any light has the mean of all its bins.
pub fn lit_geometric_mean_luminance(image: &Image) -> (f64, f64) {
    let (all, mean) = (Bins::of(image, BIN), mean_luminance(image));
    let lit = all.lit(mean);
    let black = 1.0 - lit.means.len() as f64 / all.means.len() as f64;
    (if lit.means.is_empty() { &all } else { &lit }.geometric_mean(mean), black)
}
