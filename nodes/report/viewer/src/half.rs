//! Images as half floats, in few bytes: what `web/data.js` reads.
//!
//! The values of each channel are a plane. Each value is stored as its difference to the value on its left, or to the
//! value above at the start of a row, modulo 2^16. All high bytes come first, then all low bytes, compressed by zlib.

use half::f16;
use tauflow_data::Image;

/// The largest finite half float.
pub const LARGEST: f32 = 65504.0;
/// Below this magnitude, half floats have fewer than 11 significant bits.
const SMALLEST_NORMAL: f32 = 6.103_515_6e-5;

/// An image in half floats, with the error of its values.
#[derive(Clone, Debug, PartialEq)]
pub struct Half {
    /// The bits, [height, width, channels].
    pub bits: Vec<u16>,
    /// The largest difference from a finite value up to [`LARGEST`].
    pub absolute: f64,
    /// The largest difference as a share of the value, over values that are normal half floats.
    pub relative: f64,
    /// Number of finite values beyond [`LARGEST`], which became it.
    pub clipped: u64,
}

impl Half {
    /// The nearest half floats of an image.
    pub fn of(image: &Image) -> Self {
        let mut own = Self { bits: Vec::with_capacity(image.data().len()), absolute: 0.0, relative: 0.0, clipped: 0 };
        for value in image.data() {
            let near = if value.is_finite() { value.clamp(-LARGEST, LARGEST) } else { *value };
            let half = f16::from_f32(near);
            own.bits.push(half.to_bits());
            if !value.is_finite() {
                continue;
            }
            if near != *value {
                own.clipped += 1;
                continue;
            }
            let error = (f64::from(half.to_f32()) - f64::from(*value)).abs();
            own.absolute = own.absolute.max(error);
            if value.abs() >= SMALLEST_NORMAL {
                own.relative = own.relative.max(error / f64::from(value.abs()));
            }
        }
        own
    }

    /// Planes of differences, compressed.
    pub fn packed(&self, width: usize, height: usize, channels: usize) -> Vec<u8> {
        let count = self.bits.len();
        let mut bytes = vec![0; 2 * count];
        let at = |x: usize, y: usize, plane: usize| self.bits[(y * width + x) * channels + plane];
        for plane in 0..channels {
            for y in 0..height {
                let mut last = if y == 0 { 0 } else { at(0, y - 1, plane) };
                for x in 0..width {
                    let value = at(x, y, plane);
                    let [high, low] = value.wrapping_sub(last).to_be_bytes();
                    let place = (plane * height + y) * width + x;
                    (bytes[place], bytes[count + place]) = (high, low);
                    last = value;
                }
            }
        }
        miniz_oxide::deflate::compress_to_vec_zlib(&bytes, 6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unpacked(bytes: &[u8], width: usize, height: usize, channels: usize) -> Vec<u16> {
        let bytes = miniz_oxide::inflate::decompress_to_vec_zlib(bytes).expect("own bytes");
        let count = width * height * channels;
        let mut out = vec![0u16; count];
        for plane in 0..channels {
            for y in 0..height {
                let mut last = if y == 0 { 0 } else { out[(y - 1) * width * channels + plane] };
                for x in 0..width {
                    let place = (plane * height + y) * width + x;
                    last = last.wrapping_add(u16::from_be_bytes([bytes[place], bytes[count + place]]));
                    out[(y * width + x) * channels + plane] = last;
                }
            }
        }
        out
    }

    #[test]
    fn packed_halves_come_back() {
        let data = (0..5 * 7 * 3).map(|i| (i as f32 * 1.7).sin() * 10.0).collect();
        let image = Image::from_data(5, 7, 3, data).expect("fits");
        let half = Half::of(&image);
        assert_eq!(unpacked(&half.packed(5, 7, 3), 5, 7, 3), half.bits);
    }

    #[test]
    fn the_error_is_measured() {
        let values = vec![1.0, 1.0 + 1.0 / 4096.0, 1e-8, 1e6, f32::NAN, f32::INFINITY];
        let half = Half::of(&Image::from_data(6, 1, 1, values).expect("fits"));
        assert_eq!(half.clipped, 1);
        assert_eq!(half.absolute, 1.0 / 4096.0);
        assert!((half.relative - 1.0 / 4097.0).abs() < 1e-12);
        assert_eq!(f16::from_bits(half.bits[3]).to_f32(), LARGEST);
        assert!(f16::from_bits(half.bits[4]).is_nan() && f16::from_bits(half.bits[5]).is_infinite());
    }
}
