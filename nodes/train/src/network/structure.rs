//! Structural similarity to a noisy target, as a part of a loss.
//!
//! Source: Wang, Bovik, Sheikh, Simoncelli, "Image Quality Assessment: From Error Visibility to Structural Similarity",
//! 2004, with their window (11 x 11, sigma 1.5), K1 and K2, for values from 0 to 1. The variance of a noisy target is
//! that of what it shows plus that of its noise, which is taken off: otherwise images would learn too much contrast.

use tauflow_data::maths;

/// The side of the window.
pub(crate) const WINDOW: usize = 11;
const SIGMA: f64 = 1.5;
pub(super) const C1: f32 = 0.01 * 0.01;
pub(super) const C2: f32 = 0.03 * 0.03;

/// The taps of the window in one axis, which sum to 1.
pub(super) fn taps() -> [f32; WINDOW] {
    let tap = |i: usize| maths::exp(-0.5 * ((i as f64 - (WINDOW / 2) as f64) / SIGMA).powi(2));
    let sum: f64 = (0..WINDOW).map(tap).sum();
    std::array::from_fn(|i| (tap(i) / sum) as f32)
}

/// Means of an image [side, side, 3] over the windows that lie inside: [side - 10, side - 10, 3].
fn windowed(values: &[f32], side: usize) -> Vec<f32> {
    let (taps, inner) = (taps(), side + 1 - WINDOW);
    let mut rows = vec![0.0; 3 * inner * side];
    for (row, out) in values.chunks_exact(3 * side).zip(rows.chunks_exact_mut(3 * inner)) {
        for (i, tap) in taps.iter().enumerate() {
            out.iter_mut().zip(&row[3 * i..]).for_each(|(out, value)| *out += tap * value);
        }
    }
    let mut out = vec![0.0; 3 * inner * inner];
    for (y, out) in out.chunks_exact_mut(3 * inner).enumerate() {
        for (i, tap) in taps.iter().enumerate() {
            out.iter_mut().zip(&rows[(y + i) * 3 * inner..]).for_each(|(out, value)| *out += tap * value);
        }
    }
    out
}

/// The transpose of [`windowed`]: what each window has, spread over its pixels.
fn spread(windows: &[f32], side: usize) -> Vec<f32> {
    let (taps, inner) = (taps(), side + 1 - WINDOW);
    let mut rows = vec![0.0; 3 * inner * side];
    for (y, window) in windows.chunks_exact(3 * inner).enumerate() {
        for (i, tap) in taps.iter().enumerate() {
            let row = &mut rows[(y + i) * 3 * inner..(y + i + 1) * 3 * inner];
            row.iter_mut().zip(window).for_each(|(out, value)| *out += tap * value);
        }
    }
    let mut out = vec![0.0; 3 * side * side];
    for (row, out) in rows.chunks_exact(3 * inner).zip(out.chunks_exact_mut(3 * side)) {
        for (i, tap) in taps.iter().enumerate() {
            out[3 * i..].iter_mut().zip(row).for_each(|(out, value)| *out += tap * value);
        }
    }
    out
}

/// An image and its target, and their moments in each window.
pub(super) struct Windows<'a> {
    image: &'a [f32],
    target: &'a [f32],
    side: usize,
    /// Means of the image, the target, their squares and their product.
    moments: [Vec<f32>; 5],
    /// The variance of the target's noise.
    noise: Vec<f32>,
}

/// The terms of one window.
struct Terms {
    means: [f32; 2],
    /// Numerators and denominators of luminance, and of contrast and structure.
    luminance: [f32; 2],
    structure: [f32; 2],
}

impl Terms {
    fn similarity(&self) -> f32 {
        self.luminance[0] * self.structure[0] / (self.luminance[1] * self.structure[1])
    }
}

impl<'a> Windows<'a> {
    /// Images [side, side, 3] of at least [`WINDOW`] pixels; `noise` is the variance of each value of the target.
    pub(super) fn new(image: &'a [f32], target: &'a [f32], noise: &[f32], side: usize) -> Self {
        let product = |a: &[f32], b: &[f32]| windowed(&a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<_>>(), side);
        let moments = [
            windowed(image, side),
            windowed(target, side),
            product(image, image),
            product(target, target),
            product(image, target),
        ];
        Self { image, target, side, moments, noise: windowed(noise, side) }
    }

    fn terms(&self) -> impl Iterator<Item = Terms> {
        (0..self.noise.len()).map(|at| {
            let [x, y, xx, yy, xy] = [0, 1, 2, 3, 4].map(|moment| self.moments[moment][at]);
            let of_target = (yy - y * y - self.noise[at]).max(0.0);
            Terms {
                means: [x, y],
                luminance: [2.0 * x * y + C1, x * x + y * y + C1],
                structure: [2.0 * (xy - x * y) + C2, (xx - x * x).max(0.0) + of_target + C2],
            }
        })
    }

    /// The mean similarity of the windows, at most about 1.
    pub(super) fn similarity(&self) -> f64 {
        self.terms().map(|terms| f64::from(terms.similarity())).sum::<f64>() / self.noise.len() as f64
    }

    /// Its gradient for each value of the image, times `scale`.
    pub(super) fn gradient(&self, scale: f32) -> Vec<f32> {
        let scale = scale / self.noise.len() as f32;
        let mut slopes = [const { Vec::new() }; 3];
        for terms in self.terms() {
            let ([x, y], similarity) = (terms.means, scale * terms.similarity());
            let [above, below] = terms.structure;
            let luminance = terms.luminance[0] / terms.luminance[1];
            let of_product = 2.0 * scale * luminance / below;
            let of_square = -similarity / below;
            let of_mean = 2.0 * scale * y * above / (terms.luminance[1] * below)
                - 2.0 * x * similarity / terms.luminance[1]
                - y * of_product
                - 2.0 * x * of_square;
            slopes.iter_mut().zip([of_mean, of_square, of_product]).for_each(|(all, slope)| all.push(slope));
        }
        let [means, squares, products] = slopes.map(|slopes| spread(&slopes, self.side));
        let each = means.iter().zip(&squares).zip(&products).zip(self.image).zip(self.target);
        each.map(|((((mean, square), product), x), y)| mean + 2.0 * x * square + y * product).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::rng::Stream;

    const SIDE: usize = 16;

    fn numbers(seed: u64) -> Vec<f32> {
        let mut stream = Stream::new(seed, &[]);
        (0..3 * SIDE * SIDE).map(|_| stream.range(0.2, 0.8) as f32).collect()
    }

    #[test]
    fn the_similarity_is_that_of_the_definition() {
        let (image, target) = (numbers(1), numbers(2));
        let none = vec![0.0; image.len()];
        let (taps, mut sum, mut windows) = (taps().map(f64::from), 0.0, 0.0);
        for (top, left, c) in (0..6).flat_map(|y| (0..6).flat_map(move |x| (0..3).map(move |c| (y, x, c)))) {
            let mut m = [0.0; 5];
            for (i, j) in (0..WINDOW).flat_map(|i| (0..WINDOW).map(move |j| (i, j))) {
                let at = 3 * ((top + i) * SIDE + left + j) + c;
                let (x, y) = (f64::from(image[at]), f64::from(target[at]));
                let parts = [x, y, x * x, y * y, x * y];
                m.iter_mut().zip(parts).for_each(|(m, part)| *m += taps[i] * taps[j] * part);
            }
            let [x, y, xx, yy, xy] = m;
            let luminance = (2.0 * x * y + 1e-4) / (x * x + y * y + 1e-4);
            sum += luminance * (2.0 * (xy - x * y) + 9e-4) / (xx - x * x + yy - y * y + 9e-4);
            windows += 1.0;
        }
        let found = Windows::new(&image, &target, &none, SIDE).similarity();
        assert!((found - sum / windows).abs() < 1e-5, "{found} {}", sum / windows);
        let same = Windows::new(&image, &image, &none, SIDE).similarity();
        assert!((same - 1.0).abs() < 1e-5, "{same}");
    }

    #[test]
    fn the_gradient_is_that_of_the_similarity() {
        let (image, target) = (numbers(1), numbers(2));
        let noise: Vec<f32> = numbers(3).iter().map(|v| 0.02 * v).collect();
        let gradient = Windows::new(&image, &target, &noise, SIDE).gradient(3.0);
        let at = |image: &[f32]| 3.0 * Windows::new(image, &target, &noise, SIDE).similarity();
        let largest = gradient.iter().fold(0.0f32, |most, g| most.max(g.abs()));
        for i in (0..image.len()).step_by(37) {
            let moved = |by: f32| {
                let mut moved = image.clone();
                moved[i] += by;
                at(&moved)
            };
            let slope = (moved(0.02) - moved(-0.02)) / 0.04;
            assert!((slope - f64::from(gradient[i])).abs() < 0.02 * f64::from(largest), "{i}: {slope} {}", gradient[i]);
        }
    }

    #[test]
    fn noise_of_a_target_asks_for_no_contrast() {
        // A texture, and targets of it with noise of its variance: with the noise taken off, no contrast of an
        // image is better than its own; without, more contrast seems better.
        let mut stream = Stream::new(5, &[]);
        let texture: Vec<f32> = numbers(1).iter().map(|v| 0.5 + 0.3 * (v - 0.5)).collect();
        let deviation = 0.052f32;
        let best = |taken_off: f32, stream: &mut Stream| {
            let mut found = [0.0; 17];
            for _ in 0..60 {
                let mut noisy = |v: &f32| v + deviation * (12.0f32).sqrt() * (stream.uniform() as f32 - 0.5);
                let target: Vec<f32> = texture.iter().map(&mut noisy).collect();
                let noise = vec![taken_off * deviation * deviation; target.len()];
                for (i, found) in found.iter_mut().enumerate() {
                    let contrast = 0.4 + 0.1 * i as f32;
                    let image: Vec<f32> = texture.iter().map(|v| 0.5 + contrast * (v - 0.5)).collect();
                    *found += Windows::new(&image, &target, &noise, SIDE).similarity();
                }
            }
            let best = (0..found.len()).max_by(|a, b| found[*a].total_cmp(&found[*b])).expect("some");
            0.4 + 0.1 * best as f64
        };
        let (with, without) = (best(1.0, &mut stream), best(0.0, &mut stream));
        assert!((with - 1.0).abs() < 0.15 && without > 1.25, "{with} {without}");
    }
}
