//! Thumbnails of scenes, for the list.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde::Serialize;
use tauflow_data::{
    Image,
    image::{luminance, preview},
};

/// The longer side of a thumbnail.
const SIDE: usize = 48;

/// A thumbnail: RGB bytes, in base64.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Thumb {
    w: usize,
    h: usize,
    d: String,
}

/// The mean of an image in the rectangle of a thumbnail's pixel.
fn mean(image: &Image, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>, channel: usize) -> f32 {
    let count = columns.len() * rows.len();
    let pixels = rows.flat_map(|y| columns.clone().map(move |x| image.pixel(x, y)[channel]));
    let sum: f64 = pixels.filter(|v| v.is_finite()).map(f64::from).sum();
    (sum / count as f64) as f32
}

impl Thumb {
    /// A thumbnail of radiance. Raw radiance is scaled so that its mean luminance is 1/2.
    pub fn of(image: &Image, raw: bool) -> Self {
        let last = image.channels() - 1;
        let gain = if raw {
            let light = |pixel: &[f32]| f64::from(luminance(&[pixel[0], pixel[1.min(last)], pixel[2.min(last)]]));
            let lights = image.data().chunks_exact(image.channels()).map(light).filter(|v| v.is_finite());
            let mean = lights.sum::<f64>() / (image.width() * image.height()) as f64;
            if mean > 0.0 { (0.5 / mean) as f32 } else { 1.0 }
        } else {
            1.0
        };
        Self::shown(image, |value| preview(value * gain))
    }

    /// A thumbnail of display values.
    pub fn of_display(image: &Image) -> Self {
        Self::shown(image, |value| value.clamp(0.0, 1.0))
    }

    fn shown(image: &Image, tone: impl Fn(f32) -> f32) -> Self {
        let (width, height) = (image.width(), image.height());
        let longer = width.max(height).max(1);
        let side = |of: usize| if longer <= SIDE { of } else { (of * SIDE / longer).max(1) };
        let (w, h) = (side(width), side(height));
        let last = image.channels() - 1;
        let mut bytes = Vec::with_capacity(w * h * 3);
        let span = |at: usize, of: usize, full: usize| at * full / of..((at + 1) * full / of).max(at * full / of + 1);
        for y in 0..h {
            for x in 0..w {
                for channel in 0..3 {
                    let value = mean(image, span(x, w, width), span(y, h, height), channel.min(last));
                    bytes.push((tone(value) * 255.0 + 0.5) as u8);
                }
            }
        }
        Self { w, h, d: STANDARD.encode(bytes) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thumbnails_keep_proportions() {
        let thumb = Thumb::of(&Image::new(200, 100, 3), true);
        assert_eq!((thumb.w, thumb.h), (48, 24));
        let image = Image::from_data(2, 1, 3, vec![1.0; 6]).expect("fits");
        let thumb = Thumb::of(&image, false);
        let bytes = STANDARD.decode(&thumb.d).expect("base64");
        // Reinhard maps 1 to 1/2, and the gamma to 0.7297.
        assert_eq!((thumb.w, thumb.h, bytes), (2, 1, vec![186; 6]));
        let thumb = Thumb::of_display(&image.map(|_| 0.2));
        assert_eq!(STANDARD.decode(&thumb.d).expect("base64"), [51; 6]);
    }
}
