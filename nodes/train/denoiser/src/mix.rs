//! The mix of a noisy image and its denoised version, by estimated errors: at high sample counts the noisy image may be
//! the better one.
//!
//! Let y be a noisy value with variance v, x its expectation, D the denoised value, and w the share of y in the mix.
//! The squared error of w y + (1 - w) D is least at w = (E[(D - y)^2] - v (1 - d))/E[(D - y)^2], where d is the slope
//! dD/dy: Stein's lemma gives the covariance of y and D as v d. This is Stein's unbiased risk estimate (SURE); Firmino
//! et al. (2022) use it for progressive renders. Expectations are means over a window. A second call with a slightly
//! changed image measures the slope (Ramani et al. 2008). Means of few pixels are uncertain, so the excess of (D - y)^2
//! is lowered by its standard error: without evidence against it, the denoised value stays.

use rayon::prelude::*;
use tauflow_data::{Image, rng::Stream};

/// Half sides of the windows, less a half. The larger one finds what is small and everywhere.
const WINDOWS: [usize; 2] = [4, 16];

/// Standard errors that the excess is lowered by.
const CAUTION: f64 = 1.0;

/// Relative size of the change that slopes are measured with.
const CHANGE: f32 = 0.01;

/// A slightly changed image, and by how much each value is changed.
pub(crate) fn changed(noisy: &Image) -> (Image, Vec<f32>) {
    let count = noisy.data().len().max(1);
    let mean = noisy.data().iter().map(|value| f64::from(value.abs())).sum::<f64>() / count as f64;
    // Something must change where nothing is.
    let floor = (0.1 * mean).max(1e-6) as f32;
    let rows = 3 * noisy.width();
    let mut changes = vec![0.0; noisy.data().len()];
    changes.par_chunks_mut(rows).zip(noisy.data().par_chunks(rows)).enumerate().for_each(|(row, (changes, values))| {
        let mut stream = Stream::new(row as u64, &[]).part("probe");
        // The noise of a path moves all colours of a pixel together.
        for (changes, values) in changes.chunks_exact_mut(3).zip(values.chunks_exact(3)) {
            let sign = if stream.chance(0.5) { 1.0 } else { -1.0 };
            for (change, value) in changes.iter_mut().zip(values) {
                *change = sign * CHANGE * (value.abs() + floor);
            }
        }
    });
    let mut moved = noisy.clone();
    moved.data_mut().iter_mut().zip(&changes).for_each(|(value, change)| *value += change);
    (moved, changes)
}

/// What a mix is estimated from; all are [H, W, 3].
pub(crate) struct Evidence<'a> {
    pub(crate) noisy: &'a Image,
    /// The variance of each value of `noisy`.
    pub(crate) variance: &'a Image,
    pub(crate) denoised: &'a Image,
    /// The image denoised with the changes of [`changed`].
    pub(crate) denoised_changed: &'a Image,
    pub(crate) changes: &'a [f32],
}

impl Evidence<'_> {
    /// The share of the noisy image in each pixel of the mix, from 0 to 1.
    pub(crate) fn shares(&self) -> Vec<f32> {
        let (width, height) = (self.noisy.width(), self.noisy.height());
        let level = |image: &Image| -> Vec<f64> {
            let square = |pixel: &[f32]| pixel.iter().map(|value| f64::from(*value).powi(2)).sum::<f64>() / 3.0;
            image.data().par_chunks_exact(3).map(square).collect()
        };
        let levels = level(self.denoised);
        // Errors count in relation to how bright a pixel is, or lamps would decide for all that is around them.
        let floor = 1e-2 * levels.iter().sum::<f64>() / levels.len().max(1) as f64 + 1e-12;
        let around = Blur::new(width, height, WINDOWS[0]).of(&levels);
        let terms: Vec<[f64; 2]> = (0..width * height)
            .into_par_iter()
            .map(|pixel| {
                let weight = 1.0 / (around[pixel] + floor);
                let mut sums = [0.0; 2];
                for at in 3 * pixel..3 * pixel + 3 {
                    let value = |image: &Image| f64::from(image.data()[at]);
                    let apart = value(self.denoised) - value(self.noisy);
                    let slope = (value(self.denoised_changed) - value(self.denoised)) / f64::from(self.changes[at]);
                    let square = apart * apart;
                    sums[0] += weight * square;
                    sums[1] += weight * (square - value(self.variance) * (1.0 - slope));
                }
                sums
            })
            .collect();
        let column = |i: usize| terms.iter().map(|term| term[i]).collect::<Vec<f64>>();
        let (squares, excesses) = (column(0), column(1));
        let powers: Vec<f64> = excesses.iter().map(|excess| excess * excess).collect();
        let mut shares = vec![0.0f32; width * height];
        for window in WINDOWS {
            let blur = Blur::new(width, height, window);
            let [square, excess, power] = [&squares, &excesses, &powers].map(|values| blur.of(values));
            let count = blur.count();
            for (pixel, share) in shares.iter_mut().enumerate() {
                let error = ((power[pixel] - excess[pixel].powi(2)).max(0.0) / count).sqrt();
                let sure = excess[pixel] - CAUTION * error;
                if sure > 0.0 && square[pixel] > 0.0 {
                    *share = share.max((sure / square[pixel]).min(1.0) as f32);
                }
            }
        }
        shares
    }
}

/// Means over windows, twice in a row: nearer pixels weigh more.
struct Blur {
    width: usize,
    height: usize,
    reach: usize,
}

impl Blur {
    fn new(width: usize, height: usize, reach: usize) -> Self {
        Self { width, height, reach }
    }

    /// How many independent values a mean is as certain as.
    fn count(&self) -> f64 {
        let side = |length: usize| 1.5 * (2 * self.reach + 1).min(length) as f64;
        side(self.width) * side(self.height)
    }

    fn of(&self, values: &[f64]) -> Vec<f64> {
        let once = |values: &[f64]| {
            let rows = self.lines(values, self.width);
            let turned = transposed(&rows, self.width);
            transposed(&self.lines(&turned, self.height), self.height)
        };
        once(&once(values))
    }

    /// Means along lines of a length.
    fn lines(&self, values: &[f64], length: usize) -> Vec<f64> {
        let mut out = vec![0.0; values.len()];
        out.par_chunks_exact_mut(length).zip(values.par_chunks_exact(length)).for_each(|(out, line)| {
            let mut sums = Vec::with_capacity(length + 1);
            sums.push(0.0);
            line.iter().for_each(|value| sums.push(sums[sums.len() - 1] + value));
            for (at, out) in out.iter_mut().enumerate() {
                let (first, last) = (at.saturating_sub(self.reach), (at + self.reach + 1).min(length));
                *out = (sums[last] - sums[first]) / (last - first) as f64;
            }
        });
        out
    }
}

fn transposed(values: &[f64], width: usize) -> Vec<f64> {
    let height = values.len() / width.max(1);
    (0..values.len()).into_par_iter().map(|i| values[i % height * width + i / height]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 48;

    fn image(f: impl Fn(usize, usize) -> f64) -> Image {
        let data = (0..SIDE * SIDE * 3).map(|i| f(i / 3 % SIDE, i / 3 / SIDE) as f32).collect();
        Image::from_data(SIDE, SIDE, 3, data).expect("fits")
    }

    fn noise(deviation: f64, seed: u64) -> Vec<f64> {
        let mut stream = Stream::new(seed, &[]);
        // The sum of twelve uniform numbers has a variance of 1.
        let one = |stream: &mut Stream| (0..12).map(|_| stream.uniform()).sum::<f64>() - 6.0;
        (0..SIDE * SIDE * 3).map(|_| deviation * one(&mut stream)).collect()
    }

    fn error(a: &Image, b: &Image) -> f64 {
        a.data().iter().zip(b.data()).map(|(a, b)| f64::from(a - b).powi(2)).sum()
    }

    /// Mean share, and the error of the mix over the smaller one of both images: of a denoiser that keeps `slope` of
    /// the noise and is wrong by `bias`.
    fn mix(deviation: f64, bias: f64, slope: f64, seed: u64) -> (f64, f64) {
        let clean = image(|x, y| 1.0 + 0.5 * ((x / 8 + y / 8) % 2) as f64);
        let noise = noise(deviation, seed);
        let mut noisy = clean.clone();
        noisy.data_mut().iter_mut().zip(&noise).for_each(|(value, noise)| *value += *noise as f32);
        let denoiser = |image: &Image| {
            let mut out = clean.clone();
            let pairs = out.data_mut().iter_mut().zip(image.data()).zip(clean.data());
            pairs.for_each(|((out, seen), clean)| *out = clean + bias as f32 + slope as f32 * (seen - clean));
            out
        };
        let (moved, changes) = changed(&noisy);
        let (denoised, denoised_changed) = (denoiser(&noisy), denoiser(&moved));
        // The estimate from two halves: one degree of freedom.
        let halves = self::noise(deviation, seed + 1000);
        let mut variance = clean.clone();
        variance.data_mut().iter_mut().zip(&halves).for_each(|(value, half)| *value = (half * half) as f32);
        let shares = Evidence {
            noisy: &noisy,
            variance: &variance,
            denoised: &denoised,
            denoised_changed: &denoised_changed,
            changes: &changes,
        }
        .shares();
        let mut mixed = denoised.clone();
        for (i, value) in mixed.data_mut().iter_mut().enumerate() {
            *value += shares[i / 3] * (noisy.data()[i] - *value);
        }
        let share = shares.iter().map(|share| f64::from(*share)).sum::<f64>() / shares.len() as f64;
        (share, error(&mixed, &clean) / error(&noisy, &clean).min(error(&denoised, &clean)))
    }

    #[test]
    fn the_better_image_wins_and_the_mix_is_hardly_worse_than_it() {
        for seed in 0..3 {
            // Much better than the noise, as good, and much worse.
            let (share, ratio) = mix(0.3, 0.05, 0.1, seed);
            assert!(share < 0.05 && ratio < 1.05, "{share} {ratio}");
            let (share, ratio) = mix(0.1, 0.1, 0.0, seed);
            assert!((0.3..0.6).contains(&share) && ratio < 0.75, "the errors are independent: {share} {ratio}");
            let (share, ratio) = mix(0.01, 0.1, 0.0, seed);
            assert!(share > 0.9 && ratio < 1.1, "{share} {ratio}");
        }
    }

    #[test]
    fn noise_that_is_kept_is_no_error_of_the_denoiser() {
        // D = x + (y - x)/2 leaves half of the noise. Without the slope, (D - y)^2 would look too small to be noise.
        let (share, ratio) = mix(0.2, 0.0, 0.5, 7);
        assert!(share < 0.05 && ratio < 1.02, "{share} {ratio}");
    }

    #[test]
    fn means_are_those_of_windows() {
        let (width, height) = (7, 5);
        let values: Vec<f64> = (0..35).map(|i| f64::from(i * i % 11)).collect();
        let blur = Blur::new(width, height, 1);
        let slow = |values: &[f64]| -> Vec<f64> {
            (0..35usize)
                .map(|i| {
                    let near = |at: usize, length: usize| at.saturating_sub(1)..(at + 2).min(length);
                    let all: Vec<f64> = near(i / width, height)
                        .flat_map(|y| near(i % width, width).map(move |x| (x, y)))
                        .map(|(x, y)| values[y * width + x])
                        .collect();
                    all.iter().sum::<f64>() / all.len() as f64
                })
                .collect()
        };
        let expected = slow(&slow(&values));
        assert!(blur.of(&values).iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-9));
    }
}
