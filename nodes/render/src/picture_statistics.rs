//! Image statistics: numbers from an image of linear radiance. It does not matter whether it was rendered or
//! photographed.
//!
//! Pictures are exposed as the quality gate exposes previews, so that no number depends on the scale of their light.
//! Edges, the spectrum and colours are those of display values; the spread of light and contrasts are taken in stops.

mod spectrum;

pub use tauflow_data::bins::KEY;

use tauflow_data::{
    Image,
    bins::{BIN, Bins, edges, errors, geometric_mean_luminance},
    image::preview,
    maths::log2,
    records::PictureStatistics,
};

/// Classes of hue; the three colours and those between two of them lie in the middle of one each.
const HUES: usize = 12;
/// Luminance that less counts as, over the mean.
const FLOOR: f64 = 1e-4;

/// How noisy a picture is.
#[derive(Clone, Copy, Debug)]
pub struct Noise<'a> {
    /// Variance of single samples, of the picture's size.
    pub variance: &'a Image,
    /// Samples per pixel.
    pub spp: u64,
}

/// Measures a picture of three channels, whose values are finite. Noise is for renders; photographs have none here.
pub fn measure(image: &Image, noise: Option<Noise<'_>>) -> PictureStatistics {
    let exposure = KEY / geometric_mean_luminance(image);
    let pixels = Bins::of(image, 1);
    let shown = pixels.shown(exposure);
    let unsure = match noise {
        Some(Noise { variance, spp }) => pixels.unsure(exposure, &errors(variance, spp, 1)),
        None => vec![0.0; shown.len()],
    };
    let neighbours = pixels.pairs().count().max(1) as f64;
    let colours = Colours::of(image, exposure);
    let floor = (FLOOR * mean(pixels.means.iter().map(|value| value.max(0.0)))).max(f64::MIN_POSITIVE);
    let stops: Vec<f64> = pixels.means.iter().map(|value| log2(value.max(floor))).collect();
    let contrasts: f64 = pixels.pairs().map(|(a, b)| (stops[a] - stops[b]).abs()).sum();
    PictureStatistics {
        edge_density: edges(pixels.pairs(), &shown, &unsure) as f64 / neighbours,
        spectrum_slope: spectrum::slope(&shown, pixels.width),
        saturation: mean(colours.saturations.iter().copied()),
        saturation_spread: deviation(&colours.saturations),
        hue_entropy: entropy(&colours.hues),
        log_luminance_spread: deviation(&stops),
        log_contrast: contrasts / neighbours,
    }
}

/// A picture made small: display luminance of blocks of 4 x 4 pixels, row by row.
pub fn thumbnail(image: &Image) -> Vec<f64> {
    Bins::of(image, BIN).shown(KEY / geometric_mean_luminance(image))
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    values.sum::<f64>() / count
}

/// The standard deviation of values that are all there are.
fn deviation(values: &[f64]) -> f64 {
    let middle = mean(values.iter().copied());
    mean(values.iter().map(|value| (value - middle) * (value - middle))).sqrt()
}

/// In bits, of what weights make of their sum; 0 if that is 0.
fn entropy(weights: &[f64]) -> f64 {
    let sum: f64 = weights.iter().sum();
    let of = |weight: &f64| if *weight > 0.0 { -weight / sum * log2(weight / sum) } else { 0.0 };
    weights.iter().map(of).sum()
}

/// The display colours of a picture.
struct Colours {
    /// Values per pixel.
    saturations: Vec<f64>,
    /// Sums of saturation by class of hue.
    hues: [f64; HUES],
}

impl Colours {
    fn of(image: &Image, exposure: f64) -> Self {
        let mut found = Self { saturations: Vec::new(), hues: [0.0; HUES] };
        for pixel in image.data().chunks_exact(3) {
            let shown = [0, 1, 2].map(|c| f64::from(preview((f64::from(pixel[c]) * exposure) as f32)));
            let (saturation, hue) = saturation_and_hue(shown);
            found.saturations.push(saturation);
            found.hues[hue] += saturation;
        }
        found
    }
}

/// Saturation of a colour by the hexagonal cone (Smith 1978), and the class of its hue.
fn saturation_and_hue([r, g, b]: [f64; 3]) -> (f64, usize) {
    let largest = r.max(g).max(b);
    let chroma = largest - r.min(g).min(b);
    if chroma <= 0.0 {
        return (0.0, 0);
    }
    // In sixths of a turn, from red.
    let hue = if largest == r {
        (g - b) / chroma
    } else if largest == g {
        2.0 + (b - r) / chroma
    } else {
        4.0 + (r - g) / chroma
    };
    let class = (hue * (HUES / 6) as f64 + 0.5).floor() as i64;
    (chroma / largest, class.rem_euclid(HUES as i64) as usize)
}

#[cfg(test)]
mod tests;
