//! The mix of a noisy image and its denoised version, by estimated errors: at high sample counts the noisy image may be
//! the better one.
//!
//! Let y be a noisy value with variance v, x its expectation, D the denoised value, and w the share of y in the mix.
//! The squared error of w y + (1 - w) D is least at w = (E[(D - y)^2] - v (1 - d))/E[(D - y)^2], where d is the slope
//! dD/dy: Stein's lemma gives the covariance of y and D as v d. This is Stein's unbiased risk estimate (SURE); Firmino
//! et al. (2022) use it for progressive renders. Expectations are means over a window. A second call with a slightly
//! changed image measures the slope (Ramani et al. 2008).
//!
//! **Variances are estimates** from n samples, and too small where rare bright paths are missing. So a variance counts
//! as no less than a weighted mean of itself and of those around it, in relation to brightness. The excess of (D - y)^2
//! over the variance is lowered by its standard error, many times for few samples: without evidence against it, the
//! denoised value stays.
//!
//! **Single pixels** hold most of the error where a denoiser removes lamps and highlights that are as small as a pixel.
//! If k of the samples of a dark pixel are bright, (y - D)^2/v is about k. One bright sample is a firefly, which the
//! denoiser removes rightly; many are light that is there. This evidence counts only where y is brighter than D: a
//! pixel that is too dark may have missed its bright samples.

use rayon::prelude::*;
use tauflow_data::{Image, rng::Stream};

/// Half side of the windows that errors are averaged over, less a half.
const WINDOW: usize = 8;

/// The same of the windows for brightness and for variances around a pixel.
const AROUND: usize = 4;

/// As many samples as the variances around a pixel count for, beside those of its own.
const PRIOR: f64 = 4.0;

/// Samples that variances are assumed to come from if it is not known.
const UNKNOWN: u64 = 32;

/// Standard errors that the excess is lowered by, divided by the degrees of freedom of a variance.
const CAUTION: f64 = 4.0;

/// Bright samples from which on a single pixel counts, and at twice as many of which it is noisy alone.
const BRIGHT: f64 = 4.0;

/// With fewer samples than this, single pixels need more bright ones in proportion.
const MANY: f64 = 32.0;

/// With fewer samples than this, single pixels do not count.
const FEWEST: u64 = 16;

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
    /// Samples from which the variances were estimated; none if it is not known.
    pub(crate) samples: Option<u64>,
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
        let around = Blur::new(width, height, AROUND).of(&levels);
        // Squares of the distance, variances, and the share of a variance that is no error of the denoised value.
        let terms: Vec<[f64; 3]> = (0..width * height)
            .into_par_iter()
            .map(|pixel| {
                let weight = 1.0 / (around[pixel] + floor);
                let [mut square, mut variance, mut kept] = [0.0f64; 3];
                for at in 3 * pixel..3 * pixel + 3 {
                    let value = |image: &Image| f64::from(image.data()[at]);
                    let slope = (value(self.denoised_changed) - value(self.denoised)) / f64::from(self.changes[at]);
                    square += weight * (value(self.denoised) - value(self.noisy)).powi(2);
                    variance += weight * value(self.variance);
                    kept += weight * value(self.variance) * slope.clamp(0.0, 1.0);
                }
                [square, variance, if variance > 0.0 { 1.0 - kept / variance } else { 1.0 }]
            })
            .collect();
        let column = |i: usize| terms.iter().map(|term| term[i]).collect::<Vec<f64>>();
        let (squares, own) = (column(0), column(1));
        let near = Blur::new(width, height, AROUND).of(&own);
        let samples = self.samples.unwrap_or(UNKNOWN).max(2);
        let freedom = (samples - 1) as f64;
        let bright = BRIGHT * (MANY / samples as f64).max(1.0);
        let sum = |image: &Image, pixel: usize| image.data()[3 * pixel..3 * pixel + 3].iter().sum::<f32>();
        let (mut excesses, mut spreads) = (squares.clone(), own.clone());
        let mut shares = vec![0.0f32; width * height];
        for (pixel, share) in shares.iter_mut().enumerate() {
            let variance = own[pixel].max((freedom * own[pixel] + PRIOR * near[pixel]) / (freedom + PRIOR));
            let excess = squares[pixel] - variance * terms[pixel][2];
            excesses[pixel] = excess;
            // The variance of the excess for normal noise: that of (b + e)^2 for a bias b, and that of the variance.
            spreads[pixel] = 4.0 * excess.max(0.0) * variance + 2.0 * variance * variance * (1.0 + 1.0 / freedom);
            if samples >= FEWEST && sum(self.noisy, pixel) > sum(self.denoised, pixel) {
                let hits = if variance > 0.0 { squares[pixel] / variance } else { f64::INFINITY };
                *share = ((hits - bright) / bright).clamp(0.0, 1.0) as f32;
            }
        }
        let blur = Blur::new(width, height, WINDOW);
        let [square, excess, spread] = [&squares, &excesses, &spreads].map(|values| blur.of(values));
        for (pixel, share) in shares.iter_mut().enumerate() {
            let sure = excess[pixel] - CAUTION / freedom * (spread[pixel] / blur.count()).sqrt();
            if sure > 0.0 && square[pixel] > 0.0 {
                *share = share.max((sure / square[pixel]).min(1.0) as f32);
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
            for (at, out) in out.iter_mut().enumerate() {
                let near = &line[at.saturating_sub(self.reach)..(at + self.reach + 1).min(length)];
                // No differences of sums over the line: one huge value would take the digits of all that follow it.
                *out = near.iter().sum::<f64>() / near.len() as f64;
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

    /// Mean share, and the error of the mix over the smaller one of both images: of a denoiser that makes `made` of a
    /// pixel of the clean image and of its noise, and variances from so many samples.
    fn mix(
        clean: &Image,
        (deviation, samples): (f64, u64),
        made: impl Fn(f32, f32) -> f32,
        seed: u64,
    ) -> (f64, f64, f64) {
        let noise = noise(deviation, seed);
        let mut noisy = clean.clone();
        noisy.data_mut().iter_mut().zip(&noise).for_each(|(value, noise)| *value += *noise as f32);
        let denoiser = |image: &Image| {
            let mut out = clean.clone();
            let pairs = out.data_mut().iter_mut().zip(image.data()).zip(clean.data());
            pairs.for_each(|((out, seen), clean)| *out = made(*clean, seen - clean));
            out
        };
        let (moved, changes) = changed(&noisy);
        let (denoised, denoised_changed) = (denoiser(&noisy), denoiser(&moved));
        let freedom = samples - 1;
        let mut variance = Image::new(SIDE, SIDE, 3);
        for part in 0..freedom {
            let part = self::noise(deviation, seed + 1000 + part);
            let pairs = variance.data_mut().iter_mut().zip(&part);
            pairs.for_each(|(value, noise)| *value += (noise * noise / freedom as f64) as f32);
        }
        let shares = Evidence {
            noisy: &noisy,
            variance: &variance,
            samples: Some(samples),
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
        let [mixed, noisy, denoised] = [&mixed, &noisy, &denoised].map(|image| error(image, clean));
        (share, mixed / noisy.min(denoised), denoised / noisy)
    }

    fn board() -> Image {
        image(|x, y| 1.0 + 0.5 * ((x / 8 + y / 8) % 2) as f64)
    }

    #[test]
    fn the_better_image_wins_and_the_mix_is_hardly_worse_than_it() {
        for seed in 0..3 {
            // Much better than the noise, as good, and much worse.
            let (share, ratio, _) = mix(&board(), (0.3, 16), |clean, noise| clean + 0.05 + 0.1 * noise, seed);
            assert!(share < 0.1 && ratio < 1.05, "{share} {ratio}");
            let (share, ratio, _) = mix(&board(), (0.1, 64), |clean, _| clean + 0.1, seed);
            assert!((0.3..0.75).contains(&share) && ratio < 0.8, "the errors are independent: {share} {ratio}");
            let (share, ratio, _) = mix(&board(), (0.01, 16), |clean, _| clean + 0.1, seed);
            assert!(share > 0.9 && ratio < 1.1, "{share} {ratio}");
            // Two samples say little of a variance.
            let (share, ratio, _) = mix(&board(), (0.3, 2), |clean, _| clean + 0.02, seed);
            assert!(share < 1e-3 && ratio < 1.05, "{share} {ratio}");
        }
    }

    #[test]
    fn a_denoiser_that_removes_a_few_lamps_does_no_harm() {
        let lamps = image(|x, y| if x % 23 == 11 && y % 17 == 5 { 40.0 } else { 0.5 });
        for seed in 0..3 {
            // It takes off a third of the lamps, and the noise: 2,304 pixels, 6 of which have all of its error.
            let made = |clean: f32, _: f32| if clean > 1.0 { 0.67 * clean } else { clean };
            let (share, ratio, harm) = mix(&lamps, (0.1, 256), made, seed);
            assert!(harm > 30.0 && ratio < 0.8 && share < 0.9, "{harm}: {share} {ratio}");
        }
    }

    #[test]
    fn noise_that_is_kept_is_no_error_of_the_denoiser() {
        // D = x + (y - x)/2 leaves half of the noise. Without the slope, (D - y)^2 would look too small to be noise.
        let (share, ratio, _) = mix(&board(), (0.2, 16), |clean, noise| clean + 0.5 * noise, 7);
        assert!(share < 0.15 && ratio < 1.1, "{share} {ratio}");
    }

    #[test]
    fn a_huge_variance_changes_the_shares_around_it_alone() {
        let noisy = board();
        let denoised = noisy.map(|value| 0.98 * value);
        let (moved, changes) = changed(&noisy);
        let denoised_changed = moved.map(|value| 0.98 * value);
        let shares = |huge: f32| {
            let mut variance = noisy.map(|_| 1e-4);
            variance.data_mut()[3 * (4 * SIDE + 4)..][..3].fill(huge);
            let (samples, noisy, variance) = (Some(256), &noisy, &variance);
            Evidence {
                noisy,
                variance,
                samples,
                denoised: &denoised,
                denoised_changed: &denoised_changed,
                changes: &changes,
            }
            .shares()
        };
        let far = |shares: Vec<f32>| {
            let reach = 2 * (WINDOW + AROUND) + 5;
            let away = |i: &usize| i % SIDE > reach || i / SIDE > reach;
            (0..SIDE * SIDE).filter(away).map(|i| shares[i]).collect::<Vec<_>>()
        };
        let plain = far(shares(1e-4));
        assert!(plain.len() > 500 && plain.iter().any(|share| *share > 0.0));
        for huge in [1.0, 1e20, f32::MAX] {
            assert_eq!(far(shares(huge)), plain, "{huge}");
        }
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
