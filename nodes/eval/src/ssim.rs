//! Structural similarity with an 11x11 Gaussian window, on the windows that lie wholly inside.
//!
//! Source: Wang, Bovik, Sheikh, Simoncelli, "Image Quality Assessment: From Error Visibility to Structural Similarity",
//! 2004: sigma 1.5, K1 = .01, K2 = .03, population covariance. Values run from 0 to 1 (L = 1). The window is
//! separable, so each mean is two passes of 11 taps. MS-SSIM: Wang, Simoncelli, Bovik, "Multi-scale Structural
//! Similarity for Image Quality Assessment", 2003.

use tauflow_data::{
    Image,
    maths::{exp, pow},
};

/// Pixels that the window reaches to each side.
pub const RADIUS: usize = 5;
/// Least side of an image: that of the window.
pub const LEAST_SIDE: usize = 2 * RADIUS + 1;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Weights of the five scales of MS-SSIM, the finest first.
const WEIGHTS: [f64; MOST_SCALES] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];
/// Scales of MS-SSIM as published.
pub const MOST_SCALES: usize = 5;

/// The taps of the window in one axis, which sum to 1.
fn taps() -> [f64; 2 * RADIUS + 1] {
    let mut taps = [0.0; 2 * RADIUS + 1];
    for (i, tap) in taps.iter_mut().enumerate() {
        let x = i as f64 - RADIUS as f64;
        *tap = exp(-0.5 * x * x / (SIGMA * SIGMA));
    }
    let sum: f64 = taps.iter().sum();
    taps.map(|tap| tap / sum)
}

/// Windowed mean of `values` (`width` in a row) at every place where the window fits.
fn windowed(values: &[f64], width: usize) -> Vec<f64> {
    let taps = taps();
    let inner = width - 2 * RADIUS;
    let height = values.len() / width;
    let mut rows = vec![0.0; inner * height];
    for (row, out) in values.chunks_exact(width).zip(rows.chunks_exact_mut(inner)) {
        for (i, tap) in taps.iter().enumerate() {
            for (o, v) in out.iter_mut().zip(&row[i..]) {
                *o += tap * v;
            }
        }
    }
    let mut out = vec![0.0; inner * (height - 2 * RADIUS)];
    for (y, out) in out.chunks_exact_mut(inner).enumerate() {
        for (i, tap) in taps.iter().enumerate() {
            for (o, v) in out.iter_mut().zip(&rows[(y + i) * inner..]) {
                *o += tap * v;
            }
        }
    }
    out
}

fn channel(image: &Image, channel: usize) -> Vec<f64> {
    image.data().iter().skip(channel).step_by(image.channels()).map(|v| f64::from(*v)).collect()
}

/// Windowed mean and mean square of one channel.
#[derive(Clone, Debug)]
pub struct Moments {
    mean: Vec<f64>,
    square: Vec<f64>,
}

impl Moments {
    /// SSIM of a channel of an image that is larger than the window in both axes.
    pub fn of(image: &Image, of: usize) -> Self {
        Self::of_values(&channel(image, of), image.width())
    }

    fn of_values(values: &[f64], width: usize) -> Self {
        let squares: Vec<f64> = values.iter().map(|v| v * v).collect();
        Self { mean: windowed(values, width), square: windowed(&squares, width) }
    }
}

/// Mean SSIM of one channel of two images of the same size; `reference_moments` are those of the reference's channel.
pub fn ssim(image: &Image, reference: &Image, of: usize, reference_moments: &Moments) -> f64 {
    let values = channel(image, of);
    similarity(&values, &channel(reference, of), image.width(), reference_moments).0
}

/// Mean SSIM of two planes, and the mean of its contrast and structure term.
fn similarity(values: &[f64], reference: &[f64], width: usize, y: &Moments) -> (f64, f64) {
    let x = Moments::of_values(values, width);
    let products: Vec<f64> = values.iter().zip(reference).map(|(a, b)| a * b).collect();
    let product = windowed(&products, width);
    let (mut sum, mut structure) = (0.0, 0.0);
    for (i, product) in product.iter().enumerate() {
        let (mx, my) = (x.mean[i], y.mean[i]);
        let (vx, vy, cov) = (x.square[i] - mx * mx, y.square[i] - my * my, product - mx * my);
        sum += (2.0 * mx * my + C1) * (2.0 * cov + C2) / ((mx * mx + my * my + C1) * (vx + vy + C2));
        structure += (2.0 * cov + C2) / (vx + vy + C2);
    }
    (sum / product.len() as f64, structure / product.len() as f64)
}

/// How many scales of MS-SSIM the window fits in, up to all five.
pub fn scales_that_fit(width: usize, height: usize) -> usize {
    let mut side = width.min(height);
    let mut scales = 0;
    while side >= LEAST_SIDE && scales < MOST_SCALES {
        scales += 1;
        side = side.div_ceil(2);
    }
    scales
}

/// Least side of an image for so many scales, from 1 to 5.
pub fn least_side(scales: usize) -> usize {
    (LEAST_SIDE - 1) * (1 << (scales - 1)) + 1
}

/// Means of 2 x 2 pixels. A last row or column without a partner is its own.
fn halved(values: &[f64], width: usize) -> Vec<f64> {
    let height = values.len() / width;
    let at = |x: usize, y: usize| values[y.min(height - 1) * width + x.min(width - 1)];
    let of = |x: usize, y: usize| 0.25 * (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1));
    let columns = width.div_ceil(2);
    (0..columns * height.div_ceil(2)).map(|i| of(2 * (i % columns), 2 * (i / columns))).collect()
}

/// MS-SSIM of two images of the same size in which `scales` scales fit: the mean over channels of the weighted product
/// of contrast and structure at every scale and luminance at the coarsest. The weights of fewer than five scales are
/// divided by their sum. A term below 0 counts as 0.
pub fn ms_ssim(image: &Image, reference: &Image, scales: usize) -> f64 {
    let weights = &WEIGHTS[..scales];
    // The published weights sum to 1.0001 and are used as they are.
    let total = if scales == MOST_SCALES { 1.0 } else { weights.iter().sum() };
    let of_channel = |of: usize| {
        let (mut a, mut b, mut width) = (channel(image, of), channel(reference, of), image.width());
        let mut product = 1.0;
        for (scale, weight) in weights.iter().enumerate() {
            let (whole, structure) = similarity(&a, &b, width, &Moments::of_values(&b, width));
            let last = scale + 1 == scales;
            product *= pow(if last { whole } else { structure }.max(0.0), weight / total);
            if !last {
                (a, b) = (halved(&a, width), halved(&b, width));
                width = width.div_ceil(2);
            }
        }
        product
    };
    (0..image.channels()).map(of_channel).sum::<f64>() / image.channels().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::rng::Stream;

    #[test]
    fn two_passes_are_the_whole_window() {
        let (width, height) = (14, 13);
        let mut stream = Stream::new(5, &[]);
        let values: Vec<f64> = (0..width * height).map(|_| stream.uniform()).collect();
        let quick = windowed(&values, width);
        assert_eq!(quick.len(), 4 * 3);
        let taps = taps();
        for (i, found) in quick.iter().enumerate() {
            let (x, y) = (i % 4, i / 4);
            let mut sum = 0.0;
            for (dy, ty) in taps.iter().enumerate() {
                for (dx, tx) in taps.iter().enumerate() {
                    sum += ty * tx * values[(y + dy) * width + x + dx];
                }
            }
            assert!((sum - found).abs() < 1e-14);
        }
    }

    #[test]
    fn a_single_window_follows_the_definition() {
        // One window: the image is the window. Weighted means, population covariance, by their definitions.
        let mut stream = Stream::new(6, &[]);
        let mut draw = || (0..121).map(|_| stream.uniform() as f32).collect::<Vec<f32>>();
        let (a, b) = (draw(), draw());
        let taps = taps();
        let weight = |i: usize| taps[i / 11] * taps[i % 11];
        let mean = |v: &[f32]| v.iter().enumerate().map(|(i, v)| weight(i) * f64::from(*v)).sum::<f64>();
        let (ma, mb) = (mean(&a), mean(&b));
        let moment = |u: &[f32], mu: f64, v: &[f32], mv: f64| {
            (0..121).map(|i| weight(i) * (f64::from(u[i]) - mu) * (f64::from(v[i]) - mv)).sum::<f64>()
        };
        let expected = (2.0 * ma * mb + C1) * (2.0 * moment(&a, ma, &b, mb) + C2)
            / ((ma * ma + mb * mb + C1) * (moment(&a, ma, &a, ma) + moment(&b, mb, &b, mb) + C2));
        let image = |v: Vec<f32>| Image::from_data(11, 11, 1, v).expect("fits");
        let (a, b) = (image(a), image(b));
        let found = ssim(&a, &b, 0, &Moments::of(&b, 0));
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }

    #[test]
    fn halves_are_means_and_a_last_line_is_its_own() {
        assert_eq!(halved(&[1.0, 3.0, 5.0, 7.0], 2), [4.0]);
        // Rows 1 2 3, 4 5 6, 7 8 9: the last column and the last row have no partner.
        let odd: Vec<f64> = (1..10).map(f64::from).collect();
        assert_eq!(halved(&odd, 3), [3.0, 4.5, 7.5, 9.0]);
    }

    #[test]
    fn the_window_fits_in_as_many_scales_as_the_least_side_says() {
        assert_eq!([1, 2, 3, 4, 5].map(least_side), [11, 21, 41, 81, 161]);
        for scales in 1..=MOST_SCALES {
            let side = least_side(scales);
            assert_eq!((scales_that_fit(side, 500), scales_that_fit(500, side - 1)), (scales, scales - 1));
        }
    }

    fn noise(seed: u64, side: usize) -> Image {
        let mut stream = Stream::new(seed, &[]);
        Image::from_data(side, side, 1, (0..side * side).map(|_| stream.uniform() as f32).collect()).expect("fits")
    }

    #[test]
    fn one_scale_is_ssim_and_equal_images_have_1() {
        let (a, b) = (noise(1, 48), noise(2, 48));
        let of = |scales| ms_ssim(&a, &b, scales);
        // A single scale has the weight 1.
        assert!((of(1) - ssim(&a, &b, 0, &Moments::of(&b, 0)).max(0.0)).abs() < 1e-15);
        assert!((1..=3).all(|scales| (ms_ssim(&a, &a, scales) - 1.0).abs() < 1e-12));
        assert!(of(3) < 0.5 && of(3) >= 0.0);
        assert!((of(2) - ms_ssim(&b, &a, 2)).abs() < 1e-12);
    }

    #[test]
    fn constant_images_differ_at_the_coarsest_scale_alone() {
        // Without variance the contrast and structure term is 1, and luminance (2 a b + C1)/(a^2 + b^2 + C1).
        let constant = |v: f32| Image::from_data(161, 170, 1, vec![v; 161 * 170]).expect("fits");
        let (a, b) = (0.5f64, 0.75f64);
        let luminance = (2.0 * a * b + C1) / (a * a + b * b + C1);
        let found = ms_ssim(&constant(0.5), &constant(0.75), 5);
        assert!((found - luminance.powf(0.1333)).abs() < 1e-9, "{found}");
        // Two scales: weights .0448 and .2856, divided by their sum.
        let found = ms_ssim(&constant(0.5), &constant(0.75), 2);
        assert!((found - luminance.powf(0.2856 / 0.3304)).abs() < 1e-9, "{found}");
    }

    #[test]
    fn several_scales_are_those_of_the_reference_implementation() {
        let clean = |x: usize, y: usize, k: usize| (3 * x * x + 7 * y + 5 * x * y + 29 * k) % 64;
        let noisy = |x: usize, y: usize, k: usize| (clean(x, y, k) + (11 * x + 5 * y + 3 * k) % 9) % 64;
        let image = |of: &dyn Fn(usize, usize, usize) -> f64| {
            let at = |i: usize| (of(i / 3 % 176, i / 3 / 176, i % 3) / 63.0) as f32;
            Image::from_data(176, 192, 3, (0..3 * 176 * 192).map(at).collect()).expect("fits")
        };
        let reference = image(&|x, y, k| clean(x, y, k) as f64);
        let half = image(&|x, y, k| 0.5 * clean(x, y, k) as f64 + 0.5 * noisy(x, y, k) as f64);
        let whole = image(&|x, y, k| noisy(x, y, k) as f64);
        // pytorch-msssim 1.0.0 in double precision: five scales, and three with their weights divided by the sum.
        for (image, five, three) in [(half, 0.929_447_913, 0.916_596_521), (whole, 0.739_768_982, 0.697_941_759)] {
            for (scales, expected) in [(5, five), (3, three)] {
                let found = ms_ssim(&image, &reference, scales);
                assert!((found - expected).abs() < 1e-6, "{scales} scales: {found}, expected {expected}");
            }
        }
    }
}
