//! Samples until an image is as accurate as is asked for.
//!
//! A render that stops when its own samples agree keeps images that missed rare light: those agree soonest. Samples of
//! two other streams therefore decide, and the image does not depend on them. Its expectation is that of a fixed number
//! of samples.

use crate::accumulator::Accumulator;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::ParamProblem;
use tauflow_data::{
    Image, SamplerKind,
    bins::{KEY, geometric_mean_luminance},
    rng::mix,
};

/// Label of the first stream that decides; that of the second comes next.
const DECIDES: u64 = 0x6465_6369_6465;
/// Samples of the image for each of a stream that decides.
const SHARE: u64 = 8;
/// Samples of a pixel that decide at least by default: fewer have no variance.
const LEAST: u64 = 2;
/// Paths of a stream that decide by default: fewer miss rare light.
const LEAST_PATHS: u64 = 1 << 18;
/// Samples that a mean needs before a variance of other samples is divided by its square. A pixel of fewer, which has
/// missed its light, would make a single bright sample count up to a hundred times as much.
const FIRM: u64 = 64;
/// Samples of an image after which darkness is believed.
const DARK: u64 = 4096;
/// Exposed radiance above which a mean is not averaged with those around it.
const BRIGHT: f64 = 1.0;
/// The constant added to the square of an exposed mean: errors in shadow count less, because they are less visible.
const FLOOR: f64 = 0.01;

/// How accurate an image has to be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Until {
    /// Root mean square of the standard errors of exposed pixels, over sqrt(mean^2 + 0.01).
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub relative_error: f64,
    /// Samples per pixel at most.
    #[schemars(range(min = 1, max = 1_073_741_824))]
    pub at_most: u64,
    /// Paths over the film of each of the two streams that decide, at least. Where all of them are black, the error is
    /// unknown, and the render goes on to 4096 samples. 0 takes a black image for accurate.
    #[serde(default = "Until::least_paths")]
    #[schemars(range(min = 0, max = 1_073_741_824))]
    pub paths: u64,
    /// Samples per pixel of each of the two streams that decide, at least.
    #[serde(default = "Until::least_samples")]
    #[schemars(range(min = 2, max = 1_073_741_824))]
    pub samples: u64,
}

impl Until {
    /// To this error, by so many samples at most.
    pub fn new(relative_error: f64, at_most: u64) -> Self {
        Self { relative_error, at_most, paths: LEAST_PATHS, samples: LEAST }
    }

    fn least_paths() -> u64 {
        LEAST_PATHS
    }

    fn least_samples() -> u64 {
        LEAST
    }

    /// How many samples of each of the two streams decide whether so many are enough.
    pub fn trial(&self, samples: u64, pixels: u64) -> u64 {
        (samples / SHARE).max(self.samples.max(LEAST)).max(self.paths.div_ceil(pixels.max(1)))
    }

    /// Its error, in a ladder with the given last rung.
    pub fn check(&self, last: u64, sampler: SamplerKind) -> Vec<ParamProblem> {
        let mut problems = Vec::new();
        if !(self.relative_error.is_finite() && self.relative_error > 0.0) {
            let remedy = "use for example 0.01, which is 1%";
            problems.push(ParamProblem::new("/until/relative_error", "the error must be above 0".to_owned(), remedy));
        }
        if self.at_most < last {
            let what = format!("`at_most: {}` is less than the last rung, {last}", self.at_most);
            problems.push(ParamProblem::new("/until/at_most", what, "raise it, or end `rungs` earlier"));
        }
        if sampler != SamplerKind::Independent {
            let what = "`until` needs independent samples, whose variance predicts the error of the mean".to_owned();
            problems.push(ParamProblem::new(
                "/until",
                what,
                "use `sampler: independent`, or a fixed number of samples",
            ));
        }
        problems
    }

    /// The number of samples at which the error is there, doubled from `first` on, or the most there may be, and the
    /// error that is to be expected there. `error` says it of a number of samples: infinity where it is unknown.
    ///
    /// # Errors
    /// Those of `error`.
    pub fn stop<E>(&self, first: u64, mut error: impl FnMut(u64) -> Result<f64, E>) -> Result<(u64, f64), E> {
        let mut stop = first;
        loop {
            let expected = error(stop)?;
            let dark = expected.is_infinite() && stop >= DARK;
            if expected <= self.relative_error || stop >= self.at_most || dark {
                return Ok((stop, expected));
            }
            stop = stop.saturating_mul(2).min(self.at_most);
        }
    }

    /// As many samples as this error takes by what is known now, out of `samples` that have the error `expected`:
    /// doubling goes beyond it, and goes far beyond it if the first samples that decided missed rare light. It is never
    /// below `at_least`. The error falls with the root of the number.
    pub fn least(&self, samples: u64, at_least: u64, expected: f64) -> (u64, f64) {
        let share = if expected > 0.0 { (expected / self.relative_error).powi(2) } else { 1.0 };
        let enough = if share < 1.0 { ((samples as f64 * share).ceil() as u64).min(samples) } else { samples };
        let least = enough.max(at_least).max(1);
        (least, expected * (samples as f64 / least as f64).sqrt())
    }

    /// Where a render of a stream ends that has `first` samples at least, and the error that is to be expected there.
    /// The samples of two other streams decide, which begin with `begin`. `advance` brings the state of a stream to so
    /// many samples.
    ///
    /// # Errors
    /// Those of `advance`.
    pub fn decide<E>(
        &self,
        stream: u64,
        first: u64,
        begin: impl Fn() -> Accumulator,
        mut advance: impl FnMut(&mut Accumulator, u64, u64) -> Result<(), E>,
    ) -> Result<(u64, f64), E> {
        let mut states = [begin(), begin()];
        let pixels = states[0].pixels.len() as u64;
        // The estimate by the states is kept until they get more samples.
        let mut known: Option<(u64, (f64, u64))> = None;
        self.stop(first, |samples| {
            let trial = self.trial(samples, pixels);
            for (state, stream) in states.iter_mut().zip(deciding(stream)) {
                if state.count < trial {
                    advance(state, stream, trial)?;
                }
            }
            if self.paths > 0 && states.iter().all(is_black) {
                return Ok(f64::INFINITY);
            }
            let found = match known {
                Some((count, found)) if count == states[0].count => found,
                _ => squares([&states[0], &states[1]]),
            };
            known = Some((states[0].count, found));
            Ok(expected(found, samples))
        })
    }
}

/// The streams that decide for another.
fn deciding(stream: u64) -> [u64; 2] {
    [mix(stream, DECIDES), mix(stream, DECIDES + 1)]
}

/// Whether no sample has found light.
pub(crate) fn is_black(state: &Accumulator) -> bool {
    state.pixels.iter().all(|pixel| pixel.sum == [0.0; 3])
}

/// The error that the mean of so many samples is to be expected to have, by what others say. It is the root mean over
/// pixels and channels of variance / (n (mean^2 + 0.01)). The exposure brings the geometric mean luminance to 0.18. A
/// black image has no error.
///
/// Variances are of one of the two, and means of the other, each way round. A rare bright sample raises the variance
/// and the mean of the pixel that it hits. By one render alone, an image of such pixels would seem accurate, though
/// most pixels have yet to be hit. Means of fewer than 64 samples are averaged over a square of pixels that has as
/// many, as far as it is in the image. A pixel brighter than 1 counts as 1 for its neighbours, and keeps its own mean.
pub fn relative_error(by: [&Accumulator; 2], samples: u64) -> f64 {
    expected(squares(by), samples)
}

/// The error of so many samples, by a mean of squares for one.
fn expected((sum, count): (f64, u64), samples: u64) -> f64 {
    (sum / (count.max(1) as f64 * samples.max(1) as f64)).sqrt()
}

/// The sum of the squares of relative errors of single samples, and of how many values.
fn squares(by: [&Accumulator; 2]) -> (f64, u64) {
    let brightness: f64 = by.iter().map(|film| 0.5 * geometric_mean_luminance(&film.mean())).sum();
    squares_exposed(by, KEY / brightness)
}

/// The same, by this exposure.
fn squares_exposed(by: [&Accumulator; 2], exposure: f64) -> (f64, u64) {
    let (means, variances) = (by.map(Accumulator::mean), by.map(Accumulator::variance));
    let (mut sum, mut count) = (0.0, 0u64);
    for (variance, mean, reach) in
        [(&variances[0], &means[1], reach(by[1].count)), (&variances[1], &means[0], reach(by[0].count))]
    {
        let smooth = (reach > 0).then(|| smooth(&dimmed(mean, exposure), reach));
        for (at, (v, m)) in variance.data().iter().zip(mean.data()).enumerate() {
            let own = f64::from(*m) * exposure;
            let m = smooth.as_ref().filter(|_| own <= BRIGHT).map_or(own, |smooth| f64::from(smooth.data()[at]));
            sum += f64::from(*v) * exposure * exposure / (m * m + FLOOR);
            count += 1;
        }
    }
    (sum, count)
}

/// Pixels on each side of one that are averaged with it, so that the square has [`FIRM`] samples of each.
fn reach(samples: u64) -> usize {
    let side = (FIRM as f64 / samples.max(1) as f64).sqrt();
    (0.5 * (side - 1.0)).ceil().max(0.0) as usize
}

/// The exposed image without what is bright: lamps and skies are no measure of the pixels beside them.
fn dimmed(image: &Image, exposure: f64) -> Image {
    let mut out = image.clone();
    out.data_mut().iter_mut().for_each(|value| *value = (f64::from(*value) * exposure).min(BRIGHT) as f32);
    out
}

/// The mean over the square around each pixel, as far as the square is in the image.
fn smooth(image: &Image, reach: usize) -> Image {
    along(&along(image, reach, true), reach, false)
}

/// The mean over the neighbours of each pixel in its row, or else in its column.
fn along(image: &Image, reach: usize, rows: bool) -> Image {
    let mut out = image.clone();
    let (width, height, channels) = (image.width(), image.height(), image.channels());
    out.data_mut().par_chunks_mut((width * channels).max(1)).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.chunks_mut(channels).enumerate() {
            let (at, size) = if rows { (x, width) } else { (y, height) };
            let near = at.saturating_sub(reach)..(at + reach + 1).min(size);
            for (channel, mean) in pixel.iter_mut().enumerate() {
                let value = |k: usize| f64::from(if rows { image.pixel(k, y) } else { image.pixel(x, k) }[channel]);
                let sum: f64 = near.clone().map(value).sum();
                *mean = (sum / near.len() as f64) as f32;
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_of_squares_with_enough_samples() {
        for samples in [1u64, 2, 4, 7, 16, 63] {
            let side = 2 * reach(samples) as u64 + 1;
            assert!(side * side * samples >= FIRM && (side - 2).pow(2) * samples < FIRM, "{samples}: {side}");
        }
        assert_eq!((reach(64), reach(4096)), (0, 0));
        let image = Image::from_data(3, 2, 1, vec![1.0, 2.0, 6.0, 3.0, 4.0, 8.0]).expect("six values");
        // Squares end at the border.
        assert_eq!(smooth(&image, 1).data(), [2.5, 4.0, 5.0, 2.5, 4.0, 5.0]);
        assert_eq!(smooth(&image, 9).data(), [4.0; 6]);
        assert_eq!(dimmed(&image, 0.5).data(), [0.5, 1.0, 1.0, 1.0, 1.0, 1.0]);
    }

    #[test]
    fn a_missed_light_does_not_make_a_bright_sample_count_more() {
        // Four samples of each pixel. In one of 64 pixels, one stream has a bright sample where the other has none.
        let film = |bright: f32| {
            let mut film = Accumulator::new(8, 8);
            for index in 0..4 {
                film.pixels.iter_mut().for_each(|pixel| pixel.add(index, [0.2 * (index % 2) as f32; 3]));
            }
            film.pixels[27] = crate::accumulator::Pixel::default();
            (0..4).for_each(|index| film.pixels[27].add(index, [if index == 0 { bright } else { 0.0 }; 3]));
            film.count = 4;
            film
        };
        let (with, without) = (film(4.0), film(0.0));
        let error = relative_error([&with, &without], 4);
        let known = 0.1 * KEY / 0.1;
        let of = |variance: f64| variance * (KEY / 0.1).powi(2) / (known * known + FLOOR);
        // Variances of a sample: 1/75 in 63 pixels of both, and 4 in one pixel of one of them, whose mean is about 0.1.
        let by_hand = ((126.0 * of(0.04 / 3.0) + of(4.0)) / 128.0 / 4.0).sqrt();
        assert!((error / by_hand - 1.0).abs() < 0.15, "{error} {by_hand}");
        // Nor does a lamp make the pixels beside it seem accurate. The exposure is that without it: on a larger film
        // a lamp changes it little.
        let lit = |bright: bool| {
            let mut film = film(0.0);
            film.pixels[36] = crate::accumulator::Pixel::default();
            (0..4).for_each(|index| film.pixels[36].add(index, [if bright { 1e4 } else { 0.1 }; 3]));
            film
        };
        let [dark, beside] = [false, true].map(|bright| {
            let film = lit(bright);
            expected(squares_exposed([&film; 2], KEY / 0.1), 4)
        });
        assert!((beside / dark - 1.0).abs() < 0.1, "{dark} {beside}");
    }
}
