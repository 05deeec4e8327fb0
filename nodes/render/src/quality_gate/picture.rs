//! What a preview's pixels say: how much of it is dark or bright, how much there is to see in it, how noisy it is.
//!
//! Works on bins, blocks of pixels, so that the noise of few samples does not decide. Display values are those of the
//! preview that is exposed to mid grey, without the scene's own offset.

use tauflow_data::{
    Image,
    image::{LUMINANCE, luminance, preview},
    maths::{exp, log},
};

/// Side of a bin in pixels.
const BIN: usize = 4;
/// Display values that two bins side by side differ by at an edge, beside what their noise explains.
const STEP: f64 = 0.04;
/// Standard errors of each of two bins that their difference must exceed.
const SURE: f64 = 2.0;

/// What is judged.
pub struct Preview<'a> {
    /// Linear radiance.
    pub image: &'a Image,
    /// Variance of single samples.
    pub variance: &'a Image,
    /// Samples a pixel.
    pub spp: u64,
    /// Contributions that were rejected as not finite.
    pub rejected: u64,
}

/// Blocks of pixels; those at the border may be smaller.
struct Bins {
    /// In a row.
    width: usize,
    /// Mean luminance of each.
    means: Vec<f64>,
}

/// The mean over each block of what `value` makes of a pixel's place, with the block's number of pixels.
fn blocks(width: usize, height: usize, value: impl Fn(usize, usize) -> f64) -> Vec<(f64, f64)> {
    let mut out = Vec::new();
    for top in (0..height).step_by(BIN) {
        for left in (0..width).step_by(BIN) {
            let (mut sum, mut count) = (0.0, 0.0);
            for y in top..(top + BIN).min(height) {
                for x in left..(left + BIN).min(width) {
                    sum += value(x, y);
                    count += 1.0;
                }
            }
            out.push((sum / count, count));
        }
    }
    out
}

impl Bins {
    fn of(image: &Image) -> Self {
        let value = |x, y| f64::from(luminance(image.pixel(x, y)));
        let means = blocks(image.width(), image.height(), value).into_iter().map(|(mean, _)| mean).collect();
        Self { width: image.width().div_ceil(BIN), means }
    }

    fn height(&self) -> usize {
        self.means.len() / self.width
    }

    /// The geometric mean, in an image of this mean luminance.
    fn geometric_mean(&self, mean: f64) -> f64 {
        let floor = (mean * 1e-4).max(1e-30);
        exp(self.means.iter().map(|b| log(b.max(floor))).sum::<f64>() / self.means.len() as f64)
    }

    /// Length of the edges in sides of the picture, if `differ` tells the bins on both sides of one apart.
    fn edges(&self, differ: impl Fn(usize, usize) -> bool) -> f64 {
        let mut found = 0;
        for y in 0..self.height() {
            for x in 0..self.width {
                let at = y * self.width + x;
                found += usize::from(x + 1 < self.width && differ(at, at + 1));
                found += usize::from(y + 1 < self.height() && differ(at, at + self.width));
            }
        }
        2.0 * found as f64 / (self.width + self.height()) as f64
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The mean luminance of an image, negative values counted as 0.
fn mean_luminance(image: &Image) -> f64 {
    let pixels = image.data().chunks_exact(3).map(|rgb| f64::from(luminance(rgb)).max(0.0));
    pixels.sum::<f64>() / (image.width() * image.height()) as f64
}

/// The geometric mean over bins of an image's luminance, with bins below 1/10,000 of the mean counted as that much:
/// what the exposure's `key` is divided by.
pub fn geometric_mean_luminance(image: &Image) -> f64 {
    Bins::of(image).geometric_mean(mean_luminance(image))
}

/// What was measured on a preview whose values are finite.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Mean luminance.
    pub mean: f64,
    /// Its geometric mean over bins.
    pub geometric_mean: f64,
    /// Share of bins that are shown darker than `dark`.
    pub dark_share: f64,
    /// Share of bins that are exposed to more than `white`.
    pub bright_share: f64,
    /// Standard deviation of the display values of bins.
    pub contrast: f64,
    /// Length of all edges that are not noise, in sides of the picture.
    pub edges: f64,
    /// The same with those that may be noise.
    pub steps: f64,
    /// Share of all light in the brightest 1% of the bins.
    pub concentration: f64,
    /// Standard error of a bin, root mean square, over the mean luminance.
    pub noise: f64,
}

impl Picture {
    /// Measures a preview that is exposed to `key`.
    pub fn of(preview_of: &Preview<'_>, key: f64, dark: f64, white: f64) -> Self {
        let Preview { image, variance, spp, .. } = *preview_of;
        let bins = Bins::of(image);
        let mean_luminance = mean_luminance(image);
        let geometric_mean = bins.geometric_mean(mean_luminance);
        let exposure = key / geometric_mean;
        let show = |value: f64| f64::from(preview((value * exposure) as f32));
        let shown: Vec<f64> = bins.means.iter().map(|b| show(*b)).collect();
        let shown_mean = mean(&shown);
        let squares: Vec<f64> = shown.iter().map(|s| (s - shown_mean) * (s - shown_mean)).collect();
        // As if the errors of the three colours went together, as most do.
        let deviation = |x, y| {
            let rgb =
                variance.pixel(x, y).iter().zip(LUMINANCE).map(|(v, w)| f64::from(w) * f64::from(*v).max(0.0).sqrt());
            let luminance: f64 = rgb.sum();
            luminance * luminance
        };
        let errors: Vec<f64> = blocks(image.width(), image.height(), deviation)
            .into_iter()
            .map(|(variance, count)| (variance / (spp as f64 * count)).sqrt())
            .collect();
        let unsure: Vec<f64> =
            bins.means.iter().zip(&errors).zip(&shown).map(|((b, e), s)| show(b + SURE * e) - s).collect();
        let step = |a: usize, b: usize| (shown[a] - shown[b]).abs() - STEP;
        let edges = bins.edges(|a, b| step(a, b) > unsure[a].max(0.0) + unsure[b].max(0.0));
        let steps = bins.edges(|a, b| step(a, b) > 0.0);
        let share =
            |of: &dyn Fn(usize) -> bool| (0..shown.len()).filter(|bin| of(*bin)).count() as f64 / shown.len() as f64;
        let mut sorted = bins.means.clone();
        sorted.sort_by(|a, b| b.total_cmp(a));
        let top: f64 = sorted.iter().take(sorted.len().div_ceil(100)).sum();
        let total: f64 = sorted.iter().sum();
        let all: Vec<f64> = variance.data().iter().map(|v| f64::from(*v)).collect();
        let error = (mean(&all) / (spp as f64 * (BIN * BIN) as f64)).sqrt();
        let over = |value: f64, of: f64| if of > 0.0 { value / of } else { 0.0 };
        Self {
            mean: mean_luminance,
            geometric_mean,
            dark_share: share(&|bin| shown[bin] < dark),
            bright_share: share(&|bin| bins.means[bin] * exposure > white),
            contrast: mean(&squares).sqrt(),
            edges,
            steps,
            concentration: over(top, total),
            noise: over(error, mean_luminance),
        }
    }

    /// Length of the edges, of which noise may hide some: so many of those that may be noise count as a surface's
    /// `outlines` allow.
    pub fn edges_of(&self, outlines: f64) -> f64 {
        self.edges.max(self.steps.min(outlines))
    }

    /// By name, in a frame of these outlines.
    pub fn measures(&self, outlines: f64) -> [(&'static str, f64); 8] {
        [
            ("mean_luminance", self.mean),
            ("geometric_mean_luminance", self.geometric_mean),
            ("dark_share", self.dark_share),
            ("bright_share", self.bright_share),
            ("contrast", self.contrast),
            ("edges", self.edges_of(outlines)),
            ("concentration", self.concentration),
            ("noise", self.noise),
        ]
    }
}
