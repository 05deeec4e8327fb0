//! Photometric measurements of a preview: dark and bright shares, detail, noise.
//!
//! Works on bins, blocks of pixels, so that the noise of few samples does not decide. Display values are those without
//! the scene's own offset.

use tauflow_data::{
    Image,
    bins::{BIN, Bins, edges, errors, mean_luminance},
    statistics::quantile,
};

/// Standard error of a bin, over what it shows, from which it is noisy.
const ROUGH: f64 = 0.25;
/// The minimum value of a bin in shadow, relative to the geometric mean: invisible noise does not count.
const DEEP: f64 = 0.2;

/// The input of the check.
pub struct Preview<'a> {
    /// Linear radiance.
    pub image: &'a Image,
    /// Variance of single samples.
    pub variance: &'a Image,
    /// Samples per pixel.
    pub spp: u64,
    /// Contributions that were rejected as not finite.
    pub rejected: u64,
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Measurements of a preview with finite values.
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
    /// Standard error of a bin over what it shows, the median over bins.
    pub noise: f64,
    /// Share of bins whose standard error is above a quarter of what they show.
    pub noisy_share: f64,
}

impl Picture {
    /// Measures a preview that is exposed to `key`.
    pub fn of(preview_of: &Preview<'_>, key: f64, dark: f64, white: f64) -> Self {
        let Preview { image, variance, spp, .. } = *preview_of;
        let bins = Bins::of(image, BIN);
        let mean_luminance = mean_luminance(image);
        let geometric_mean = bins.geometric_mean(mean_luminance);
        let exposure = key / geometric_mean;
        let shown = bins.shown(exposure);
        let shown_mean = mean(&shown);
        let squares: Vec<f64> = shown.iter().map(|s| (s - shown_mean) * (s - shown_mean)).collect();
        let errors = errors(variance, spp, BIN);
        let unsure = bins.unsure(exposure, &errors);
        let least = DEEP * geometric_mean;
        let sides = |found: usize| 2.0 * found as f64 / (bins.width + bins.height()) as f64;
        let steps = sides(edges(bins.pairs(), &shown, &vec![0.0; shown.len()]));
        let edges = sides(edges(bins.pairs(), &shown, &unsure));
        let share =
            |of: &dyn Fn(usize) -> bool| (0..shown.len()).filter(|bin| of(*bin)).count() as f64 / shown.len() as f64;
        let mut sorted = bins.means.clone();
        sorted.sort_by(|a, b| b.total_cmp(a));
        let top: f64 = sorted.iter().take(sorted.len().div_ceil(100)).sum();
        let total: f64 = sorted.iter().sum();
        let mut noise: Vec<f64> = errors.iter().zip(&bins.means).map(|(e, shows)| e / shows.max(least)).collect();
        noise.sort_by(f64::total_cmp);
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
            noise: quantile(&noise, 0.5),
            noisy_share: share(&|bin| errors[bin] > ROUGH * bins.means[bin].max(least)),
        }
    }

    /// Length of the edges, of which noise may hide some: so many of those that may be noise count as a surface's
    /// `outlines` allow.
    pub fn edges_of(&self, outlines: f64) -> f64 {
        self.edges.max(self.steps.min(outlines))
    }

    /// By name, in a frame of these outlines.
    pub fn measures(&self, outlines: f64) -> [(&'static str, f64); 9] {
        [
            ("mean_luminance", self.mean),
            ("geometric_mean_luminance", self.geometric_mean),
            ("dark_share", self.dark_share),
            ("bright_share", self.bright_share),
            ("contrast", self.contrast),
            ("edges", self.edges_of(outlines)),
            ("concentration", self.concentration),
            ("noise", self.noise),
            ("noisy_share", self.noisy_share),
        ]
    }
}
