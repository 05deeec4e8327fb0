//! NIQE: how far the statistics of local contrast are from those of clean renders.
//!
//! Source: Mittal, Soundararajan and Bovik, "Making a completely blind image quality analyzer", IEEE Signal Processing
//! Letters 2013, and its published code. `benches/niqe.py` makes the numbers that the test holds it against. Knows
//! luminance alone, and fits its own model.

use super::symmetric::{Symmetric, form};
use tauflow_data::{
    Image,
    maths::{exp, tgamma},
};

/// Numbers of a patch: 18 at each of two scales.
pub(crate) const FEATURES: usize = 36;
/// Side of patches where an image is large enough for four of them.
const SIDE: usize = 96;
/// Share of the sharpest patch's sharpness that a patch of a clean render needs to be part of the model.
const SHARP: f64 = 0.75;
/// Shapes of the generalised Gaussian that are tried: 0.2 to 10 in steps of 0.001.
const SHAPES: usize = 9801;

/// The features of a patch.
pub(crate) type Features = [f64; FEATURES];

/// A picture of one channel.
#[derive(Clone, Debug)]
struct Plane {
    width: usize,
    height: usize,
    data: Vec<f64>,
}

/// Side of the patches of images of this least side: that of the method from 192 pixels on, below it half the image,
/// rounded down to an even number.
pub(crate) fn patch_side(least: usize) -> usize {
    if least >= 2 * SIDE { SIDE } else { least / 4 * 2 }
}

/// Whether one image has enough patches for a covariance of its own.
pub(crate) fn stands_alone(least: usize) -> bool {
    least >= 2 * SIDE
}

/// Computes features; holds the table of shapes.
pub(crate) struct Niqe {
    /// For each shape: the ratio that it is found by, and the factor from deviations to its scale.
    shapes: Vec<[f64; 2]>,
    window: [f64; 7],
}

/// The patches of an image.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Patches {
    /// Their features.
    pub(crate) features: Vec<Features>,
    /// Their sharpness: the mean deviation of luminance about its surroundings.
    sharpness: Vec<f64>,
    /// Patches that are left out, because some distribution in them has only one sign.
    pub(crate) flat: usize,
}

impl Patches {
    /// The sharp ones: those that the model of clean renders is fitted to.
    pub(crate) fn sharp(&self) -> impl Iterator<Item = &Features> {
        let most = self.sharpness.iter().fold(0.0, |most: f64, value| most.max(*value));
        let sharp = self.features.iter().zip(&self.sharpness);
        sharp.filter(move |(_, sharpness)| **sharpness > SHARP * most).map(|(features, _)| features)
    }
}

/// Means and covariances of features.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Moments {
    patches: f64,
    sums: Features,
    products: Symmetric<FEATURES>,
}

impl Moments {
    /// Of no patch.
    pub(crate) fn none() -> Self {
        Self { patches: 0.0, sums: [0.0; FEATURES], products: Symmetric::zero() }
    }

    /// Of patches.
    pub(crate) fn of<'a>(patches: impl IntoIterator<Item = &'a Features>) -> Self {
        let mut moments = Self::none();
        for features in patches {
            moments.patches += 1.0;
            for (sum, value) in moments.sums.iter_mut().zip(features) {
                *sum += value;
            }
            moments.products.add_square(features);
        }
        moments
    }

    /// Adds those of other patches, each so many times.
    pub(crate) fn add(&mut self, other: &Self, times: f64) {
        self.patches += times * other.patches;
        for (sum, value) in self.sums.iter_mut().zip(&other.sums) {
            *sum += times * value;
        }
        self.products.add(&other.products, times);
    }

    /// Number of patches.
    pub(crate) fn patches(&self) -> f64 {
        self.patches
    }

    /// The Gaussian law of the patches; none of fewer than two.
    pub(crate) fn law(&self) -> Option<Law> {
        if self.patches < 2.0 {
            return None;
        }
        let mean = self.sums.map(|sum| sum / self.patches);
        let mut covariance = self.products.clone();
        covariance.add(&Symmetric::of_square(&mean), -self.patches);
        covariance.scale(1.0 / (self.patches - 1.0));
        Some(Law { mean, covariance })
    }
}

/// A Gaussian law of features.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Law {
    mean: Features,
    covariance: Symmetric<FEATURES>,
}

impl Law {
    /// NIQE: the distance between two laws in units of their mean covariance.
    pub(crate) fn distance(&self, other: &Self) -> f64 {
        let mut covariance = self.covariance.clone();
        covariance.add(&other.covariance, 1.0);
        covariance.scale(0.5);
        let difference: Features = std::array::from_fn(|i| self.mean[i] - other.mean[i]);
        form(&covariance, &difference).max(0.0).sqrt()
    }
}

impl Niqe {
    /// The method of the paper.
    pub(crate) fn new() -> Self {
        let shape = |at: usize| {
            let shape = 0.2 + 0.001 * at as f64;
            let [one, two, three] = [1.0, 2.0, 3.0].map(|n| tgamma(n / shape));
            [two * two / (one * three), (one / three).sqrt()]
        };
        let weight = |at: usize| exp(-((at as f64 - 3.0) / (7.0 / 6.0)).powi(2) / 2.0);
        let weights: [f64; 7] = std::array::from_fn(weight);
        let sum: f64 = weights.iter().sum();
        Self { shapes: (0..SHAPES).map(shape).collect(), window: weights.map(|w| w / sum) }
    }

    /// The patches of an image of display values [H, W, 3]. Rows and columns that fill no patch are left out.
    pub(crate) fn patches(&self, image: &Image, side: usize) -> Patches {
        let (columns, rows) = (image.width() / side, image.height() / side);
        let luminance = Plane::luminance(image, columns * side, rows * side);
        let (fine, deviation) = self.normalised(&luminance);
        let (coarse, _) = self.normalised(&luminance.halved());
        let mut found = Patches::default();
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
            let scales = [(&fine, side), (&coarse, side / 2)];
            let halves = scales.map(|(plane, side)| self.features(&plane.block(column * side, row * side, side), side));
            let [Some(fine), Some(coarse)] = halves else {
                found.flat += 1;
                continue;
            };
            let both = fine.into_iter().chain(coarse);
            let mut features = [0.0; FEATURES];
            features.iter_mut().zip(both).for_each(|(to, value)| *to = value);
            found.features.push(features);
            let block = deviation.block(column * side, row * side, side);
            found.sharpness.push(block.iter().sum::<f64>() / block.len() as f64);
        }
        found
    }

    /// Luminance less its local mean, over its local deviation plus 1; and that deviation.
    fn normalised(&self, plane: &Plane) -> (Plane, Plane) {
        let mean = self.smoothed(plane);
        let squares = self.smoothed(&plane.map(|v| v * v));
        let deviation = squares.with(&mean, |square, mean| (square - mean * mean).abs().sqrt());
        let centred = plane.with(&mean, |value, mean| value - mean);
        (centred.with(&deviation, |value, deviation| value / (deviation + 1.0)), deviation)
    }

    /// Through the Gaussian window; the outermost pixels go on beyond the border.
    fn smoothed(&self, plane: &Plane) -> Plane {
        let (width, height) = (plane.width, plane.height);
        let near = |at: usize, tap: usize, size: usize| (at + tap).saturating_sub(3).min(size - 1);
        let taps = |value: &dyn Fn(usize) -> f64| -> f64 {
            self.window.iter().enumerate().map(|(tap, weight)| weight * value(tap)).sum()
        };
        let across = plane.each(|x, y| taps(&|tap| plane.data[y * width + near(x, tap, width)]));
        across.each(|x, y| taps(&|tap| across.data[near(y, tap, height) * width + x]))
    }

    /// The 18 numbers of a block at one scale; none where a distribution in it has only one sign.
    fn features(&self, block: &[f64], side: usize) -> Option<[f64; 18]> {
        let mut out = [0.0; 18];
        let [shape, left, right] = self.fitted(block)?;
        (out[0], out[1]) = (shape, (left + right) / 2.0);
        // Products of neighbours: across, down, and along both diagonals; the block goes on at its other side.
        for (at, (down, across)) in [(0, 1), (1, 0), (1, 1), (1, side - 1)].into_iter().enumerate() {
            let neighbour = |i: usize| {
                let (y, x) = ((i / side + side - down) % side, (i % side + side - across) % side);
                block[i] * block[y * side + x]
            };
            let products: Vec<f64> = (0..block.len()).map(neighbour).collect();
            let [shape, left, right] = self.fitted(&products)?;
            let mean = (right - left) * tgamma(2.0 / shape) / tgamma(1.0 / shape);
            out[2 + 4 * at..6 + 4 * at].copy_from_slice(&[shape, mean, left, right]);
        }
        Some(out)
    }

    /// Shape, left scale and right scale of the asymmetric generalised Gaussian that fits; none where all values have
    /// one sign.
    fn fitted(&self, values: &[f64]) -> Option<[f64; 3]> {
        let deviation = |of: &dyn Fn(f64) -> bool| {
            let (mut sum, mut number) = (0.0, 0.0);
            for value in values.iter().filter(|value| of(**value)) {
                (sum, number) = (sum + value * value, number + 1.0);
            }
            (number > 0.0).then(|| (sum / number).sqrt()).filter(|deviation| *deviation > 0.0)
        };
        let (left, right) = (deviation(&|v| v < 0.0)?, deviation(&|v| v > 0.0)?);
        let number = values.len() as f64;
        let absolute = values.iter().map(|v| v.abs()).sum::<f64>() / number;
        let square = values.iter().map(|v| v * v).sum::<f64>() / number;
        let skew = left / right;
        let ratio = absolute * absolute / square * (skew.powi(3) + 1.0) * (skew + 1.0) / (skew * skew + 1.0).powi(2);
        let scale = self.shapes[self.nearest(ratio)][1];
        Some([0.2 + 0.001 * self.nearest(ratio) as f64, left * scale, right * scale])
    }

    /// The shape whose ratio is nearest; ratios grow with the shape.
    fn nearest(&self, ratio: f64) -> usize {
        let above = self.shapes.partition_point(|shape| shape[0] < ratio).min(SHAPES - 1);
        let below = above.saturating_sub(1);
        let off = |at: usize| (self.shapes[at][0] - ratio).abs();
        if off(below) <= off(above) { below } else { above }
    }
}

impl Plane {
    /// Luminance from 0 to 255 of the upper left part of an image.
    fn luminance(image: &Image, width: usize, height: usize) -> Self {
        let value = |x: usize, y: usize| {
            let [r, g, b] = [0, 1, 2].map(|c| f64::from(image.pixel(x, y)[c]));
            255.0 * (0.299 * r + 0.587 * g + 0.114 * b)
        };
        let data = (0..height).flat_map(|y| (0..width).map(move |x| value(x, y))).collect();
        Self { width, height, data }
    }

    fn each(&self, value: impl Fn(usize, usize) -> f64) -> Self {
        let (width, height) = (self.width, self.height);
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            data.extend((0..width).map(|x| value(x, y)));
        }
        Self { width, height, data }
    }

    fn map(&self, value: impl Fn(f64) -> f64) -> Self {
        Self { data: self.data.iter().map(|v| value(*v)).collect(), ..*self }
    }

    fn with(&self, other: &Self, value: impl Fn(f64, f64) -> f64) -> Self {
        let data = self.data.iter().zip(&other.data).map(|(a, b)| value(*a, *b)).collect();
        Self { data, ..*self }
    }

    /// The pixels of a square.
    fn block(&self, left: usize, top: usize, side: usize) -> Vec<f64> {
        (top..top + side).flat_map(|y| &self.data[y * self.width + left..][..side]).copied().collect()
    }

    /// Half as wide and high, by MATLAB's bicubic kernel stretched to 8 taps; mirrored at the border.
    fn halved(&self) -> Self {
        let cubic = |x: f64| {
            let x = x.abs();
            if x <= 1.0 { 1.5 * x.powi(3) - 2.5 * x * x + 1.0 } else { -0.5 * x.powi(3) + 2.5 * x * x - 4.0 * x + 2.0 }
        };
        let weights: [f64; 8] = std::array::from_fn(|tap| cubic((tap as f64 - 3.5) / 2.0) / 2.0);
        let mirror = |at: isize, size: usize| {
            let size = size as isize;
            let at = at.rem_euclid(2 * size);
            (if at < size { at } else { 2 * size - 1 - at }) as usize
        };
        let taps = |at: usize, value: &dyn Fn(isize) -> f64| -> f64 {
            weights.iter().enumerate().map(|(tap, weight)| weight * value(2 * at as isize + tap as isize - 3)).sum()
        };
        let rows = Self { width: self.width, height: self.height / 2, data: Vec::new() };
        let rows = rows.each(|x, y| taps(y, &|y| self.data[mirror(y, self.height) * self.width + x]));
        let half = Self { width: self.width / 2, height: rows.height, data: Vec::new() };
        half.each(|x, y| taps(x, &|x| rows.data[y * self.width + mirror(x, self.width)]))
    }
}

#[cfg(test)]
mod tests;
