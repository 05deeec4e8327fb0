//! Errors of an image against its reference: PSNR and MAE of linear radiance and of previews, and SSIM; on request
//! MS-SSIM, FLIP and HDR-FLIP.
//!
//! Images are exposed linear radiance. Knows no scene, method or file. Sources: SSIM of Wang, Bovik, Sheikh and
//! Simoncelli 2004 with its Gaussian window. The display transform is [`tauflow_data::image::preview`]. Sums are
//! f64, in row order, so that results are the same bits everywhere.

use crate::{
    flip::{self, Seen},
    ssim::{Moments, RADIUS, least_side, ms_ssim, scales_that_fit, ssim},
};
use tauflow_data::{Image, image::preview, maths::log10, records::Metrics};

/// An image that cannot be compared with its reference.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MetricError {
    /// The two have different sizes.
    #[error(
        "the image has {image} values, but its reference has {reference} (width x height x channels); render both \
        with the same `resolution`"
    )]
    Shape {
        /// Size of the image.
        image: String,
        /// Size of the reference.
        reference: String,
    },
    /// The image is smaller than the window of SSIM.
    #[error("SSIM needs images of at least {side} x {side} pixels, but this one has {width} x {height}; increase the \
        resolution",
        side = 2 * RADIUS + 1)]
    Small {
        /// Pixels in a row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The image is too small for the scales of MS-SSIM, with the remedy.
    #[error("{0}")]
    FewPixels(String),
    /// FLIP compares colours.
    #[error("FLIP needs images of 3 channels, but this one has {channels}; remove `flip` and `hdr_flip` from `also`")]
    NoColours {
        /// Channels of the image.
        channels: usize,
    },
    /// Not every value is a number.
    #[error(
        "{count} of the {of} values are not finite, so no error can be computed; check the node that produced the image"
    )]
    NotFinite {
        /// How many are not.
        count: usize,
        /// The total number.
        of: usize,
    },
}

/// Why MS-SSIM of so many scales cannot be computed, and what to do.
pub(crate) fn too_small(width: usize, height: usize, scales: usize) -> String {
    let (side, fit) = (least_side(scales), scales_that_fit(width, height));
    let remedy = if fit == 0 { String::new() } else { format!("set `ms_ssim_scales: {fit}`, or ") };
    format!(
        "MS-SSIM of {scales} scales needs images of at least {side} x {side} pixels, but this one has {width} x \
         {height}; {remedy}increase the resolution"
    )
}

/// The share of a squared error that is left at least when the reference's own is taken off.
///
/// A reference knows its own error only roughly, and a single scene should not move the mean PSNR of many.
/// `time_error`, which has no such means, leaves less.
pub const LEAST_LEFT: f64 = 0.1;

/// The metrics beyond those that every score has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct More {
    /// MS-SSIM, with this number of scales from 1 to 5.
    pub ms_ssim: Option<usize>,
    /// FLIP.
    pub flip: bool,
    /// HDR-FLIP.
    pub hdr_flip: bool,
}

/// Peak signal-to-noise ratio in dB of a mean squared error; infinite if there is no error.
pub fn psnr(mse: f64, peak: f64) -> f64 {
    if mse == 0.0 { f64::INFINITY } else { 10.0 * log10(peak * peak / mse) }
}

/// Mean squared and mean absolute difference of values that `f` has been applied to.
fn differences(image: &[f32], reference: &[f32], f: impl Fn(f32) -> f32) -> (f64, f64) {
    let (mut squares, mut sizes) = (0.0, 0.0);
    for (a, b) in image.iter().zip(reference) {
        let d = f64::from(f(*a)) - f64::from(f(*b));
        squares += d * d;
        sizes += d.abs();
    }
    let count = image.len().max(1) as f64;
    (squares / count, sizes / count)
}

/// Radiance as it is compared: negatives count as black, and nothing is clipped above.
fn radiance(value: f32) -> f32 {
    value.max(0.0)
}

/// Mean squared difference of linear radiance, negatives set to 0 on both sides.
///
/// # Errors
/// If the sizes differ or a value is not finite.
pub fn linear_mse(image: &Image, reference: &Image) -> Result<f64, MetricError> {
    comparable(image, reference)?;
    Ok(differences(image.data(), reference.data(), radiance).0)
}

/// PSNR of linear radiance with peak 1, negatives set to 0 on both sides.
///
/// # Errors
/// As [`linear_mse`].
pub fn linear_psnr(image: &Image, reference: &Image) -> Result<f64, MetricError> {
    Ok(psnr(linear_mse(image, reference)?, 1.0))
}

fn finite(image: &Image) -> Result<(), MetricError> {
    match image.data().iter().filter(|v| !v.is_finite()).count() {
        0 => Ok(()),
        count => Err(MetricError::NotFinite { count, of: image.data().len() }),
    }
}

fn comparable(image: &Image, reference: &Image) -> Result<(), MetricError> {
    if !image.same_shape(reference) {
        let size = |i: &Image| format!("{} x {} x {}", i.width(), i.height(), i.channels());
        return Err(MetricError::Shape { image: size(image), reference: size(reference) });
    }
    finite(image)?;
    finite(reference)
}

/// A reference, with what every comparison needs of it.
#[derive(Clone, Debug)]
pub struct Reference<'a> {
    image: &'a Image,
    preview: Image,
    moments: Vec<Moments>,
    peak: f64,
    own_mse: f64,
    ms_ssim: Option<usize>,
    seen: Option<Seen>,
    exposures: Option<Vec<f64>>,
}

impl<'a> Reference<'a> {
    /// Prepares a reference for the metrics that every score has.
    ///
    /// # Errors
    /// If it is smaller than SSIM's window or holds a value that is not finite.
    pub fn new(image: &'a Image) -> Result<Self, MetricError> {
        Self::with(image, More::default())
    }

    /// Prepares a reference for these and more metrics.
    ///
    /// # Errors
    /// As [`Self::new`]; and if it is too small for the scales of MS-SSIM or has no colours for FLIP.
    pub fn with(image: &'a Image, more: More) -> Result<Self, MetricError> {
        let (width, height) = (image.width(), image.height());
        if image.width() <= 2 * RADIUS || image.height() <= 2 * RADIUS {
            return Err(MetricError::Small { width, height });
        }
        if let Some(scales) = more.ms_ssim.filter(|scales| scales_that_fit(width, height) < *scales) {
            return Err(MetricError::FewPixels(too_small(width, height, scales)));
        }
        if (more.flip || more.hdr_flip) && image.channels() != 3 {
            return Err(MetricError::NoColours { channels: image.channels() });
        }
        finite(image)?;
        let preview = image.map(preview);
        let moments = (0..preview.channels()).map(|c| Moments::of(&preview, c)).collect();
        let largest = image.data().iter().fold(0.0f32, |a, b| a.max(*b));
        // A black reference has no maximum to be a peak.
        let peak = if largest > 0.0 { f64::from(largest) } else { 1.0 };
        let seen = more.flip.then(|| flip::seen(&preview));
        let exposures = more.hdr_flip.then(|| flip::exposures(image));
        Ok(Self { image, preview, moments, peak, own_mse: 0.0, ms_ssim: more.ms_ssim, seen, exposures })
    }

    /// The same with this mean squared error of its own, which is taken off squared errors of linear radiance. At least
    /// [`LEAST_LEFT`] of what is measured is left.
    ///
    /// The samples of reference and images must be independent: otherwise too much is taken off.
    pub fn with_own_error(mut self, mse: f64) -> Self {
        self.own_mse = mse;
        self
    }

    /// The metrics of an image.
    ///
    /// # Errors
    /// If it has another size than the reference or holds a value that is not finite.
    pub fn metrics(&self, image: &Image) -> Result<Metrics, MetricError> {
        comparable(image, self.image)?;
        let (found, hdr_mae) = differences(image.data(), self.image.data(), radiance);
        let mse = (found - self.own_mse).max(LEAST_LEFT * found);
        let shown = image.map(preview);
        let (preview_mse, preview_mae) = differences(shown.data(), self.preview.data(), |v| v);
        Ok(Metrics {
            hdr_psnr: psnr(mse, 1.0),
            hdr_psnr_max: psnr(mse, self.peak),
            hdr_mae,
            preview_psnr: psnr(preview_mse, 1.0),
            preview_mae,
            ssim: self.ssim(&shown),
            ms_ssim: self.ms_ssim.map(|scales| ms_ssim(&shown, &self.preview, scales)),
            flip: self.seen.as_ref().map(|seen| flip::flip(&flip::seen(&shown), seen)),
            hdr_flip: self.exposures.as_ref().map(|stops| flip::hdr_flip(image, self.image, stops)),
            lpips: None,
        })
    }

    fn ssim(&self, shown: &Image) -> f64 {
        let channels = self.moments.len();
        let sum: f64 = self.moments.iter().enumerate().map(|(c, of)| ssim(shown, &self.preview, c, of)).sum();
        sum / channels.max(1) as f64
    }
}

/// The metrics that every score has, of an image against a reference; [`Reference`] is quicker for several images.
///
/// # Errors
/// As [`Reference::new`] and [`Reference::metrics`].
pub fn metrics(image: &Image, reference: &Image) -> Result<Metrics, MetricError> {
    Reference::new(reference)?.metrics(image)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::{
        records::{BASIC, METRICS, higher_is_better},
        rng::Stream,
    };

    const ALL: More = More { ms_ssim: Some(2), flip: true, hdr_flip: true };

    fn all(image: &Image, reference: &Image) -> Metrics {
        Reference::with(reference, ALL).and_then(|of| of.metrics(image)).expect("alike")
    }

    fn noise(seed: u64, width: usize, height: usize) -> Image {
        let mut stream = Stream::new(seed, &[]);
        let data = (0..width * height * 3).map(|_| stream.range(-0.1, 3.0) as f32).collect();
        Image::from_data(width, height, 3, data).expect("fits")
    }

    fn near(found: f64, expected: f64) {
        assert!((found - expected).abs() <= 1e-5 * expected.abs(), "{found}, expected {expected}");
    }

    #[test]
    fn constant_images_have_known_errors() {
        let constant = |v: f32| Image::from_data(16, 12, 3, vec![v; 16 * 12 * 3]).expect("fits");
        // A difference of 1 against a maximum of 2: MSE 1, so 0 dB at peak 1 and 20 log10 2 at peak 2.
        let m = metrics(&constant(1.0), &constant(2.0)).expect("alike");
        assert_eq!((m.hdr_psnr, m.hdr_mae), (0.0, 1.0));
        near(m.hdr_psnr_max, 6.020_599_913);
        // Previews (1/2)^(1/2.2) = .7297401 and (2/3)^(1/2.2) = .8316843, a difference of .1019443.
        near(m.preview_mae, 0.101_944_277);
        near(m.preview_psnr, 19.832_743);
        // Without variance only the luminance term stays: (2 a b + 1e-4)/(a^2 + b^2 + 1e-4).
        let (a, b) = (0.729_740_05, 0.831_684_33);
        near(m.ssim, (2.0 * a * b + 1e-4) / (a * a + b * b + 1e-4));
    }

    #[test]
    fn negatives_count_as_black() {
        let mut image = Image::new(11, 11, 3);
        let reference = image.clone();
        image.data_mut().fill(-5.0);
        let m = metrics(&image, &reference).expect("alike");
        assert_eq!((m.hdr_psnr, m.hdr_mae, m.preview_mae, m.ssim), (f64::INFINITY, 0.0, 0.0, 1.0));
        // One value of 363 is off by 11: MSE 1/3.
        image.data_mut()[7] = 11.0;
        let m = metrics(&image, &reference).expect("alike");
        near(m.hdr_psnr, 10.0 * 3.0f64.log10());
        near(m.hdr_mae, 11.0 / 363.0);
        assert_eq!(m.hdr_psnr_max, m.hdr_psnr, "a black reference gives no peak");
    }

    #[test]
    fn identity_is_perfect_and_errors_are_symmetric() {
        let (a, b) = (noise(1, 31, 17), noise(2, 31, 17));
        let m = metrics(&a, &a).expect("alike");
        assert!(m.hdr_psnr.is_infinite() && m.hdr_psnr_max.is_infinite() && m.preview_psnr.is_infinite());
        assert_eq!((m.hdr_mae, m.preview_mae), (0.0, 0.0));
        assert!((m.ssim - 1.0).abs() < 1e-12);
        let (ab, ba) = (metrics(&a, &b).expect("alike"), metrics(&b, &a).expect("alike"));
        for name in BASIC.iter().filter(|n| **n != "hdr_psnr_max") {
            let (x, y) = (ab.get(name).expect("known"), ba.get(name).expect("known"));
            assert!((x - y).abs() <= 1e-12 * x.abs(), "{name}: {x} {y}");
        }
        assert!(ab.ssim < 0.3 && ab.hdr_psnr < 5.0);
    }

    #[test]
    fn more_noise_is_worse_in_every_metric() {
        let reference = noise(3, 24, 24).map(|v| v.max(0.0));
        let off = noise(4, 24, 24);
        let mixed = |share: f32| {
            let data = reference.data().iter().zip(off.data()).map(|(r, o)| r + share * (o - 1.5)).collect();
            all(&Image::from_data(24, 24, 3, data).expect("fits"), &reference)
        };
        let (less, more) = (mixed(0.05), mixed(0.2));
        for name in METRICS.into_iter().filter(|name| *name != "lpips") {
            let (a, b) = (less.get(name).expect("known"), more.get(name).expect("known"));
            let better = if higher_is_better(name) { a > b } else { a < b };
            assert!(better, "{name}: {a} {b}");
        }
        // Four times the error: 20 log10 4 dB, up to the values that were clipped at 0.
        assert!((less.hdr_psnr - more.hdr_psnr - 12.04).abs() < 0.6);
    }

    #[test]
    fn more_metrics_are_computed_on_request_and_change_no_other() {
        let (a, b) = (noise(1, 31, 21), noise(2, 31, 21));
        let (plain, more) = (metrics(&a, &b).expect("alike"), all(&a, &b));
        assert_eq!(plain, Metrics { ms_ssim: None, flip: None, hdr_flip: None, ..more });
        assert!([more.ms_ssim, more.flip, more.hdr_flip].iter().all(|v| v.is_some_and(|v| (0.0..=1.0).contains(&v))));
        let same = all(&a, &a);
        assert!((same.ms_ssim.expect("computed") - 1.0).abs() < 1e-12);
        assert_eq!((same.flip, same.hdr_flip), (Some(0.0), Some(0.0)));
    }

    #[test]
    fn more_metrics_say_what_they_need() {
        let image = noise(1, 64, 50);
        let refused = |image: &Image, more| Reference::with(image, more).expect_err("refused").to_string();
        let told = refused(&image, More { ms_ssim: Some(5), ..More::default() });
        assert!(
            told.contains("161 x 161") && told.contains("64 x 50") && told.contains("`ms_ssim_scales: 3`"),
            "{told}"
        );
        let grey = Image::new(16, 16, 1);
        assert!(refused(&grey, More { flip: true, ..More::default() }).contains("3 channels"));
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let image = noise(5, 16, 16);
        let small = noise(5, 16, 10);
        assert!(matches!(metrics(&small, &small), Err(MetricError::Small { width: 16, height: 10 })));
        assert!(matches!(metrics(&small, &image), Err(MetricError::Shape { .. })));
        let mut broken = image.clone();
        broken.data_mut()[3] = f32::NAN;
        broken.data_mut()[4] = f32::INFINITY;
        let error = metrics(&broken, &image).expect_err("not finite");
        assert_eq!(error, MetricError::NotFinite { count: 2, of: 768 });
        assert!(error.to_string().starts_with("2 of the 768 values"));
        assert!(linear_psnr(&broken, &image).is_err() && metrics(&image, &broken).is_err());
    }
}
