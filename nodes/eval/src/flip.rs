//! FLIP and HDR-FLIP: the difference that a viewer sees when two images alternate at one place.
//!
//! Each error is 0 for equal pixels and at most 1. Knows pixels alone. The viewer has the same definition for its error
//! map, in `nodes/report/viewer/src/web/flip.js`; both are held against the same numbers of the reference
//! implementation.
//!
//! # Source
//! Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", HPG 2020; Andersson, Nilsson, Shirley,
//! Akenine-Möller, "Visualizing Errors in Rendered High Dynamic Range Images", Eurographics 2021 short papers. The
//! constants are those of the reference implementation, `flip_evaluator` 1.7: a display of 3840 pixels and 0.7 m, seen
//! from 0.7 m, and the ACES curve for HDR-FLIP. All arithmetic is f64.

use tauflow_data::{
    Image,
    image::LUMINANCE,
    maths::{cbrt, exp, exp2, log2, pow},
};

/// Pixels per degree of visual angle.
const PPD: f64 = 3840.0 * core::f64::consts::PI / 180.0;
/// From linear RGB to XYZ.
const XYZ: [[f64; 3]; 3] = [
    [10_135_552.0 / 24_577_794.0, 8_788_810.0 / 24_577_794.0, 4_435_075.0 / 24_577_794.0],
    [2_613_072.0 / 12_288_897.0, 8_788_810.0 / 12_288_897.0, 887_015.0 / 12_288_897.0],
    [1_425_312.0 / 73_733_382.0, 8_788_810.0 / 73_733_382.0, 70_074_185.0 / 73_733_382.0],
];
/// From XYZ to linear RGB.
const RGB: [[f64; 3]; 3] = [
    [3.241_003_275, -1.537_398_934, -0.498_615_861],
    [-0.969_224_334, 1.875_930_071, 0.041_554_224],
    [0.055_639_423, -0.204_011_202, 1.057_148_933],
];
/// Contrast sensitivity of the channels Y, Cx and Cz: weights and widths of the Gaussians in the frequency domain.
const SENSITIVITY: [&[(f64, f64)]; 3] = [&[(1.0, 0.0047)], &[(1.0, 0.0053)], &[(34.1, 0.04), (13.5, 0.025)]];
/// The largest width of these Gaussians: it sets the radius of all filters.
const WIDEST: f64 = 0.04;
/// Width of the features in degrees.
const FEATURE: f64 = 0.082;
/// Exponent of a colour's difference.
const COLOUR_POWER: f64 = 0.7;
/// The share of the largest difference that is mapped to [`KNEE_ERROR`].
const KNEE: f64 = 0.4;
const KNEE_ERROR: f64 = 0.95;
/// Coefficients of the ACES curve (a x^2 + b x + c)/(d x^2 + e x + f), with its pre-exposure of 0.6.
const ACES: [f64; 6] = [0.36 * 2.51, 0.6 * 0.03, 0.0, 0.36 * 2.43, 0.6 * 0.59, 0.14];
/// Display luminance that the exposures of HDR-FLIP aim at.
const DISPLAYED: f64 = 0.85;
/// Least luminance, so that a black image has an exposure.
const DARKEST: f64 = f32::EPSILON as f64;

type Pixel = [f64; 3];

fn product(matrix: &[[f64; 3]; 3], of: Pixel) -> Pixel {
    matrix.map(|row| row[0] * of[0] + row[1] * of[1] + row[2] * of[2])
}

/// XYZ of white.
fn white() -> Pixel {
    product(&XYZ, [1.0; 3])
}

fn norm(a: f64, b: f64) -> f64 {
    (a * a + b * b).sqrt()
}

/// A plane of numbers, row by row.
#[derive(Clone, Copy)]
struct Plane<'a> {
    values: &'a [f64],
    width: usize,
}

impl Plane<'_> {
    /// Convolved with one kernel along rows and one along columns, both of odd length. Pixels beyond the border are
    /// those at the border.
    fn convolved(self, across: &[f64], down: &[f64]) -> Vec<f64> {
        let Self { values, width } = self;
        let radius = across.len() / 2;
        let mut padded = vec![0.0; width + 2 * radius];
        let mut rows = vec![0.0; values.len()];
        for (row, out) in values.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
            padded[..radius].fill(row[0]);
            padded[radius..radius + width].copy_from_slice(row);
            padded[radius + width..].fill(row[width - 1]);
            for (i, tap) in across.iter().enumerate() {
                out.iter_mut().zip(&padded[i..]).for_each(|(o, v)| *o += tap * v);
            }
        }
        let (height, radius) = (values.len() / width, down.len() / 2);
        let mut out = vec![0.0; values.len()];
        for (y, out) in out.chunks_exact_mut(width).enumerate() {
            for (i, tap) in down.iter().enumerate() {
                let from = (y + i).saturating_sub(radius).min(height - 1);
                out.iter_mut().zip(&rows[from * width..]).for_each(|(o, v)| *o += tap * v);
            }
        }
        out
    }
}

/// The taps from `-radius` to `radius`.
fn kernel(radius: usize, of: impl Fn(f64) -> f64) -> Vec<f64> {
    (0..=2 * radius).map(|i| of(i as f64 - radius as f64)).collect()
}

/// The channel as an observer resolves it: filtered with the contrast sensitivity, normalised to 1.
fn resolved(plane: Plane<'_>, terms: &[(f64, f64)]) -> Vec<f64> {
    use core::f64::consts::PI;
    let radius = (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * PPD).ceil() as usize;
    let (mut sum, mut total) = (vec![0.0; plane.values.len()], 0.0);
    for (a, b) in terms {
        let taps = kernel(radius, |x| exp(-PI * PI * (x / PPD) * (x / PPD) / b));
        let weight = a * (PI / b).sqrt();
        let across: f64 = taps.iter().sum();
        total += weight * across * across;
        sum.iter_mut().zip(plane.convolved(&taps, &taps)).for_each(|(s, v)| *s += weight * v);
    }
    sum.into_iter().map(|v| v / total).collect()
}

/// CIELab of linear RGB, with chroma scaled by lightness (Hunt).
fn hunt_lab(rgb: Pixel) -> Pixel {
    const EDGE: f64 = 6.0 / 29.0;
    let (xyz, white) = (product(&XYZ, rgb), white());
    let f = [0, 1, 2].map(|k| {
        let t = xyz[k] / white[k];
        if t > EDGE * EDGE * EDGE { cbrt(t) } else { t / (3.0 * EDGE * EDGE) + 4.0 / 29.0 }
    });
    let light = 116.0 * f[1] - 16.0;
    [light, 0.01 * light * 500.0 * (f[0] - f[1]), 0.01 * light * 200.0 * (f[1] - f[2])]
}

/// The HyAB distance, compressed.
fn distance(a: Pixel, b: Pixel) -> f64 {
    pow((a[0] - b[0]).abs() + norm(a[1] - b[1], a[2] - b[2]), COLOUR_POWER)
}

/// The largest compressed distance: green to blue.
fn largest() -> f64 {
    distance(hunt_lab([0.0, 1.0, 0.0]), hunt_lab([0.0, 0.0, 1.0]))
}

/// An image as FLIP compares it.
#[derive(Clone, Debug)]
pub(crate) struct Seen {
    colours: Vec<Pixel>,
    /// Strength of edges and of points.
    features: [Vec<f64>; 2],
}

impl Seen {
    /// Filters an image of linear RGB within [0, 1], as displayed.
    fn of(pixels: &[Pixel], width: usize) -> Self {
        let mut planes = [(); 3].map(|()| Vec::with_capacity(pixels.len()));
        let white = white();
        for rgb in pixels {
            let xyz = product(&XYZ, *rgb);
            let [x, y, z] = [0, 1, 2].map(|k| xyz[k] / white[k]);
            planes[0].push(116.0 * y - 16.0);
            planes[1].push(500.0 * (x - y));
            planes[2].push(200.0 * (y - z));
        }
        let [y, cx, cz] = [0, 1, 2].map(|k| resolved(Plane { values: &planes[k], width }, SENSITIVITY[k]));
        let colour = |i: usize| {
            let light = (y[i] + 16.0) / 116.0;
            let xyz = [(light + cx[i] / 500.0) * white[0], light * white[1], (light - cz[i] / 200.0) * white[2]];
            hunt_lab(product(&RGB, xyz).map(|v| v.clamp(0.0, 1.0)))
        };
        let colours = (0..pixels.len()).map(colour).collect();
        let grey: Vec<f64> = planes[0].iter().map(|v| (v + 16.0) / 116.0).collect();
        Self { colours, features: features(Plane { values: &grey, width }) }
    }
}

/// Norms of the first and second derivatives of a Gaussian, with the positive and the negative taps summing to 1.
fn features(grey: Plane<'_>) -> [Vec<f64>; 2] {
    let deviation = 0.5 * FEATURE * PPD;
    let radius = (3.0 * deviation).ceil() as usize;
    let gauss = |x: f64| exp(-x * x / (2.0 * deviation * deviation));
    let bell = kernel(radius, gauss);
    let across: f64 = bell.iter().sum();
    let derivative = |of: &dyn Fn(f64) -> f64| {
        let taps = kernel(radius, |x| of(x) * gauss(x));
        let (mut positive, mut negative) = (0.0, 0.0);
        for tap in &taps {
            if *tap > 0.0 { positive += tap } else { negative -= tap }
        }
        let taps: Vec<f64> =
            taps.iter().map(|tap| tap / (across * if *tap > 0.0 { positive } else { negative })).collect();
        let (x, y) = (grey.convolved(&taps, &bell), grey.convolved(&bell, &taps));
        x.into_iter().zip(y).map(|(x, y)| norm(x, y)).collect()
    };
    [derivative(&|x| -x), derivative(&|x| x * x / (deviation * deviation) - 1.0)]
}

/// The error of every pixel.
fn errors(test: &Seen, reference: &Seen) -> Vec<f64> {
    let most = largest();
    let knee = KNEE * most;
    let error = |i: usize| {
        let colour = distance(test.colours[i], reference.colours[i]);
        let colour = if colour < knee {
            KNEE_ERROR * colour / knee
        } else {
            KNEE_ERROR + (1.0 - KNEE_ERROR) * (colour - knee) / (most - knee)
        };
        let [edge, point] = [0, 1].map(|k| (test.features[k][i] - reference.features[k][i]).abs());
        pow(colour, 1.0 - (edge.max(point) / core::f64::consts::SQRT_2).sqrt())
    };
    (0..test.colours.len()).map(error).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// The pixels of an RGB image, with `f` applied to each value.
fn pixels(image: &Image, f: impl Fn(f64) -> f64) -> Vec<Pixel> {
    image.data().chunks_exact(3).map(|rgb| [0, 1, 2].map(|k| f(f64::from(rgb[k])))).collect()
}

/// Linear light of an sRGB value.
fn linear(shown: f64) -> f64 {
    if shown <= 0.040_45 { shown / 12.92 } else { pow((shown + 0.055) / 1.055, 2.4) }
}

/// A preview, an sRGB image within [0, 1] of three channels, as FLIP compares it.
pub(crate) fn seen(preview: &Image) -> Seen {
    Seen::of(&pixels(preview, linear), preview.width())
}

/// Mean FLIP of two previews of the same size.
pub(crate) fn flip(test: &Seen, reference: &Seen) -> f64 {
    mean(&errors(test, reference))
}

/// The exposures of HDR-FLIP in stops, by the luminance of a linear reference: from the one that displays its maximum
/// as [`DISPLAYED`] to the one that displays its median so, about one stop apart.
pub(crate) fn exposures(reference: &Image) -> Vec<f64> {
    let [a, b, c] = [0, 1, 2].map(|k| ACES[k] - DISPLAYED * ACES[k + 3]);
    let middle = -0.5 * b / a;
    let shown = middle + (middle * middle - c / a).sqrt();
    let of = |rgb: &[f32]| (0..3).map(|k| f64::from(LUMINANCE[k]) * f64::from(rgb[k].max(0.0))).sum::<f64>();
    let mut luminances: Vec<f64> = reference.data().chunks_exact(3).map(of).collect();
    luminances.sort_by(f64::total_cmp);
    let at = |place: usize| luminances.get(place).map_or(DARKEST, |own| own.max(DARKEST));
    let start = log2(shown / at(luminances.len().saturating_sub(1)));
    let stop = log2(shown / at(luminances.len() / 2));
    let count = ((stop - start).ceil() as usize).max(2);
    let step = (stop - start) / (count - 1) as f64;
    (0..count).map(|i| start + i as f64 * step).collect()
}

/// Mean HDR-FLIP of linear RGB images of the same size: each pixel has its largest error over the exposures. Negative
/// values count as black.
pub(crate) fn hdr_flip(test: &Image, reference: &Image, exposures: &[f64]) -> f64 {
    let mut most = vec![0.0f64; test.width() * test.height()];
    for exposure in exposures {
        let gain = exp2(*exposure);
        let shown = |value: f64| {
            let x = gain * value.max(0.0);
            let [a, b, c, d, e, f] = ACES;
            (((a * x + b) * x + c) / ((d * x + e) * x + f)).clamp(0.0, 1.0)
        };
        let side = |image: &Image| Seen::of(&pixels(image, shown), image.width());
        let errors = errors(&side(test), &side(reference));
        most.iter_mut().zip(errors).for_each(|(most, error)| *most = most.max(error));
    }
    mean(&most)
}

#[cfg(test)]
mod tests;
