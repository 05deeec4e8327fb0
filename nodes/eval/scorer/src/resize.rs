//! Images at the size that a model takes: bilinear, with a kernel as wide as the step where images shrink.
//!
//! Source: the triangle filter of Pillow and of `torchvision` with antialiasing.

use tauflow_data::Image;

/// The image at another size.
pub(crate) fn resized(image: &Image, width: usize, height: usize) -> Image {
    if (image.width(), image.height()) == (width, height) {
        return image.clone();
    }
    let mut across = Image::new(width, image.height(), image.channels());
    for (x, taps) in taps(image.width(), width).into_iter().enumerate() {
        for y in 0..image.height() {
            for (from, weight) in &taps {
                for c in 0..image.channels() {
                    across.pixel_mut(x, y)[c] += weight * image.pixel(*from, y)[c];
                }
            }
        }
    }
    let mut out = Image::new(width, height, image.channels());
    for (y, taps) in taps(image.height(), height).into_iter().enumerate() {
        for x in 0..width {
            for (from, weight) in &taps {
                for c in 0..image.channels() {
                    out.pixel_mut(x, y)[c] += weight * across.pixel(x, *from)[c];
                }
            }
        }
    }
    out
}

/// For each of `to` places the ones of `from` that it is made of, with weights that add up to 1.
fn taps(from: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let scale = from as f64 / to as f64;
    let reach = scale.max(1.0);
    let place = |at: usize| {
        let centre = (at as f64 + 0.5) * scale;
        let first = (centre - reach + 0.5).max(0.0) as usize;
        let last = ((centre + reach + 0.5) as usize).min(from);
        let weight = |tap: usize| (1.0 - ((tap as f64 + 0.5 - centre) / reach).abs()).max(0.0);
        let sum: f64 = (first..last).map(weight).sum();
        (first..last).map(|tap| (tap, (weight(tap) / sum) as f32)).collect()
    };
    (0..to).map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_change_as_in_pillow() {
        let row = |values: &[f32]| Image::from_data(values.len(), 1, 1, values.to_vec()).expect("fits");
        // Image.fromarray(np.float32([[0, 1, 2, 7]])).resize((2, 1), Image.BILINEAR): weights 3, 3, 1 of 7 each.
        let half = resized(&row(&[0.0, 1.0, 2.0, 7.0]), 2, 1);
        assert!((half.data()[0] - 5.0 / 7.0).abs() < 1e-6 && (half.data()[1] - 28.0 / 7.0).abs() < 1e-6, "{half:?}");
        let double = resized(&row(&[0.0, 4.0]), 4, 1);
        assert_eq!(double.data(), [0.0, 1.0, 3.0, 4.0]);
        let down = resized(&Image::from_data(1, 2, 1, vec![1.0, 3.0]).expect("fits"), 1, 1);
        assert_eq!(down.data(), [2.0]);
        assert_eq!(resized(&row(&[0.5, 0.25]), 2, 1), row(&[0.5, 0.25]));
    }
}
