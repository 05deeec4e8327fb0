//! Structural similarity with an 11x11 Gaussian window, on the windows that lie wholly inside.
//!
//! Source: Wang, Bovik, Sheikh, Simoncelli, "Image Quality Assessment: From Error Visibility to Structural Similarity",
//! 2004: sigma 1.5, K1 = .01, K2 = .03, population covariance. Values run from 0 to 1 (L = 1). The window is
//! separable, so each mean is two passes of 11 taps.

use tauflow_data::{Image, maths::exp};

/// Pixels that the window reaches to each side.
pub const RADIUS: usize = 5;
/// Least side of an image: that of the window.
pub const LEAST_SIDE: usize = 2 * RADIUS + 1;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

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
        let values = channel(image, of);
        let squares: Vec<f64> = values.iter().map(|v| v * v).collect();
        Self { mean: windowed(&values, image.width()), square: windowed(&squares, image.width()) }
    }
}

/// Mean SSIM of one channel of two images of the same size; `reference_moments` are those of the reference's channel.
pub fn ssim(image: &Image, reference: &Image, of: usize, reference_moments: &Moments) -> f64 {
    let x = Moments::of(image, of);
    let products: Vec<f64> = channel(image, of).iter().zip(channel(reference, of)).map(|(a, b)| a * b).collect();
    let product = windowed(&products, image.width());
    let y = reference_moments;
    let mut sum = 0.0;
    for (i, product) in product.iter().enumerate() {
        let (mx, my) = (x.mean[i], y.mean[i]);
        let (vx, vy, cov) = (x.square[i] - mx * mx, y.square[i] - my * my, product - mx * my);
        sum += (2.0 * mx * my + C1) * (2.0 * cov + C2) / ((mx * mx + my * my + C1) * (vx + vy + C2));
    }
    sum / product.len() as f64
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
}
