//! Pictures of a bridge stop: where each method pushes the image, and how far it stays off.
//!
//! A picture has two rows of panels. The upper row shows update directions: the real one, I_m - I_k, on the left, and
//! then each method's. The lower row shows absolute differences to the real I_m: those of hold, I_k itself, on the
//! left, and then each method's. Colour code:
//!
//! - *Update d of a pixel* (three channels): 0.5 + 0.5 (d/|d|) w with w = |d|/(|d| + s). The scale s is the root mean
//!   square of the real update over pixels. Mid grey is no change, brighter is more light, darker is less, and a tint
//!   is a change of colour. Strong updates show in full.
//! - *Absolute difference e of a pixel* (mean of three channels): t = e/(e + s), from black over red and yellow to
//!   white. The scale s is the mean difference of hold, which so lies at t = 1/2.
//!
//! Both scales are shared by all panels of a picture. Knows nothing of the method that made an image.
//!
//! A strip shows one stop of one method in five panels: I_k, the stop, the real I_m, the update of the method, and the
//! absolute difference of the stop to the real I_m; the last two in the colours above.

use tauflow_data::{DataError, Image, image::preview, image_io::encode_png};

/// White lines between panels, in pixels.
const GAP: usize = 2;

/// Values of a pixel's three channels from those of two images.
fn subtract(a: &Image, b: &Image, at: usize) -> [f64; 3] {
    let (a, b) = (&a.data()[3 * at..3 * at + 3], &b.data()[3 * at..3 * at + 3]);
    [0, 1, 2].map(|c| f64::from(a[c]) - f64::from(b[c]))
}

fn length(v: [f64; 3]) -> f64 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

/// v/(v + scale), 0 where both are 0.
fn soft(v: f64, scale: f64) -> f64 {
    if v > 0.0 { v / (v + scale) } else { 0.0 }
}

/// The colour of an update of a pixel.
fn direction_colour(update: [f64; 3], scale: f64) -> [f32; 3] {
    let size = length(update);
    if size == 0.0 {
        return [0.5; 3];
    }
    let weight = soft(size, scale);
    update.map(|u| (0.5 + 0.5 * u / size * weight) as f32)
}

/// The colour of an absolute difference of a pixel.
fn difference_colour(difference: f64, scale: f64) -> [f32; 3] {
    let t = soft(difference, scale);
    [0.0, 1.0, 2.0].map(|step| (3.0 * t - step).clamp(0.0, 1.0) as f32)
}

fn mean_difference(v: [f64; 3]) -> f64 {
    (v[0].abs() + v[1].abs() + v[2].abs()) / 3.0
}

/// Scales of the colours of a stop.
struct Scales {
    /// Root mean square of the real update.
    rms: f64,
    /// Mean difference of hold.
    mean: f64,
}

impl Scales {
    fn of(start: &Image, real: &Image, others: &[&Image]) -> Result<Self, DataError> {
        if real.channels() != 3 || !real.same_shape(start) || others.iter().any(|i| !i.same_shape(real)) {
            return Err(DataError::Format("the images of a bridge stop differ in size, or have not 3 channels".into()));
        }
        let pixels = real.width() * real.height();
        let count = pixels.max(1) as f64;
        let updates = (0..pixels).map(|p| subtract(real, start, p));
        let rms = (updates.clone().map(|d| length(d) * length(d)).sum::<f64>() / count).sqrt();
        let mean = updates.map(mean_difference).sum::<f64>() / count;
        Ok(Self { rms, mean })
    }
}

/// The strip of a stop as PNG bytes: from `start`, I_k, to `stopped`, where `real` is I_m.
///
/// # Errors
/// If the images differ in size or have not three channels.
pub fn strip(start: &Image, stopped: &Image, real: &Image) -> Result<Vec<u8>, DataError> {
    let Scales { rms, mean } = Scales::of(start, real, &[stopped])?;
    let (width, height) = (real.width(), real.height());
    let mut sheet = Image::new(5 * (width + GAP) - GAP, height, 3);
    sheet.data_mut().fill(1.0);
    for p in 0..width * height {
        let shown = |image: &Image| -> [f32; 3] { [0, 1, 2].map(|c| preview(image.data()[3 * p + c])) };
        let panels = [
            shown(start),
            shown(stopped),
            shown(real),
            direction_colour(subtract(stopped, start, p), rms),
            difference_colour(mean_difference(subtract(stopped, real, p)), mean),
        ];
        for (column, colour) in panels.into_iter().enumerate() {
            sheet.pixel_mut(column * (width + GAP) + p % width, p / width).copy_from_slice(&colour);
        }
    }
    encode_png(&sheet)
}

/// The picture of a stop as PNG bytes: from `start`, I_k, to `real`, I_m; `stepped` are the methods' images.
///
/// # Errors
/// If the images differ in size or have not three channels.
pub fn stop_map(start: &Image, real: &Image, stepped: &[&Image]) -> Result<Vec<u8>, DataError> {
    let Scales { rms, mean } = Scales::of(start, real, stepped)?;
    let pixels = real.width() * real.height();
    let (width, height) = (real.width(), real.height());
    let columns = 1 + stepped.len();
    let mut sheet = Image::new(columns * (width + GAP) - GAP, 2 * height + GAP, 3);
    sheet.data_mut().fill(1.0);
    for column in 0..columns {
        let left = column * (width + GAP);
        let method = column.checked_sub(1).map(|i| stepped[i]);
        let (moved, result) = (method.unwrap_or(real), method.unwrap_or(start));
        for p in 0..pixels {
            let (x, y) = (left + p % width, p / width);
            let above = direction_colour(subtract(moved, start, p), rms);
            let below = difference_colour(mean_difference(subtract(result, real, p)), mean);
            sheet.pixel_mut(x, y).copy_from_slice(&above);
            sheet.pixel_mut(x, y + height + GAP).copy_from_slice(&below);
        }
    }
    encode_png(&sheet)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_follow_the_code() {
        assert_eq!(direction_colour([0.0; 3], 1.0), [0.5; 3]);
        // An update as long as the scale shows at half strength.
        let [r, g, b] = direction_colour([-2.0, 0.0, 0.0], 2.0);
        assert_eq!((r, g, b), (0.25, 0.5, 0.5));
        assert_eq!(difference_colour(0.0, 0.0), [0.0; 3]);
        // The mean error of hold: t = 1/2, red and half yellow.
        assert_eq!(difference_colour(3.0, 3.0), [1.0, 0.5, 0.0]);
        assert_eq!(difference_colour(3.0, 0.0), [1.0; 3]);
    }

    #[test]
    fn sheets_are_pngs_of_the_panels() {
        let image = |v: f32| Image::from_data(8, 4, 3, vec![v; 96]).expect("fits");
        let (start, real, stepped) = (image(0.0), image(1.0), image(0.5));
        let png = stop_map(&start, &real, &[&stepped, &stepped]).expect("three channels");
        assert!(png.starts_with(b"\x89PNG"));
        // Width 3 x 8 + 2 gaps, height 2 x 4 + 1 gap, in the header's big-endian words.
        assert_eq!((png[19], png[23]), (28, 10));
        assert!(stop_map(&start, &real, &[&Image::new(4, 4, 3)]).is_err());
        let strips = strip(&start, &stepped, &real).expect("three channels");
        assert_eq!((strips[19], strips[23]), (5 * 8 + 4 * 2, 4));
        assert!(strip(&start, &Image::new(4, 4, 3), &real).is_err());
        let grey = Image::new(8, 4, 1);
        assert!(stop_map(&grey, &grey, &[]).is_err());
    }
}
