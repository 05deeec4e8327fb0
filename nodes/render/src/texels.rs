//! The texels of an image in memory: a byte each, where a channel has no more than 256 values.
//!
//! Pictures of 8 bits per channel are such, however they were decoded. They take a quarter of the memory, and their
//! values are read from a table: the bits are those of the image.

use crate::lanes::{Integer, Real};
use tauflow_data::Image;

/// Values of a channel that a byte can tell apart.
const LEVELS: usize = 256;
/// Numbers from which on bytes are worth a table.
const FEW: usize = 4096;
/// Slots of the table that finds a value's byte; a power of two.
const SLOTS: usize = 1024;

/// An image's texels.
#[derive(Debug)]
pub struct Texels {
    width: usize,
    height: usize,
    channels: usize,
    values: Values,
}

#[derive(Debug)]
enum Values {
    Numbers(Vec<f32>),
    /// Bytes in place of the numbers, and what they stand for: [`LEVELS`] numbers for each channel.
    Bytes(Vec<u8>, Vec<f32>),
}

/// The values of a channel so far, found by their bits.
struct Known {
    slots: Vec<Option<(u32, u8)>>,
    values: Vec<f32>,
}

impl Known {
    fn new() -> Self {
        Self { slots: vec![None; SLOTS], values: Vec::new() }
    }

    /// The byte of a value; none if there are too many.
    #[inline]
    fn byte(&mut self, value: f32) -> Option<u8> {
        let bits = value.to_bits();
        let mut at = (bits.wrapping_mul(0x9E37_79B1) >> 22) as usize % SLOTS;
        loop {
            match self.slots[at] {
                Some((known, byte)) if known == bits => return Some(byte),
                Some(_) => at = (at + 1) % SLOTS,
                None => {
                    let byte = u8::try_from(self.values.len()).ok()?;
                    self.slots[at] = Some((bits, byte));
                    self.values.push(value);
                    return Some(byte);
                }
            }
        }
    }
}

/// Bytes and their table, if no channel has more values than bytes.
fn bytes(image: &Image) -> Option<(Vec<u8>, Vec<f32>)> {
    let (channels, data) = (image.channels(), image.data());
    if data.len() < FEW {
        return None;
    }
    let mut known: Vec<Known> = (0..channels).map(|_| Known::new()).collect();
    let mut bytes = Vec::with_capacity(data.len());
    for texel in data.chunks_exact(channels) {
        for (value, known) in texel.iter().zip(&mut known) {
            bytes.push(known.byte(*value)?);
        }
    }
    let mut table = Vec::with_capacity(LEVELS * channels);
    for channel in known {
        let some = channel.values.first().copied().unwrap_or(0.0);
        table.extend(channel.values);
        // What stands for nothing must not widen the bounds.
        table.resize(table.len().next_multiple_of(LEVELS), some);
    }
    Some((bytes, table))
}

impl From<Image> for Texels {
    fn from(image: Image) -> Self {
        let (width, height, channels) = (image.width(), image.height(), image.channels());
        let values = match bytes(&image) {
            Some((bytes, table)) => Values::Bytes(bytes, table),
            None => Values::Numbers(image.into_data()),
        };
        Self { width, height, channels, values }
    }
}

impl Texels {
    /// Texels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Numbers of a texel.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// All values of each channel, or their bounds at least: numbers, and how many of one channel lie side by side.
    pub(crate) fn values(&self) -> (&[f32], usize) {
        match &self.values {
            Values::Numbers(data) => (data, 1),
            Values::Bytes(_, table) => (table, LEVELS),
        }
    }

    /// As an image.
    ///
    /// # Errors
    /// If it has no texels.
    pub(crate) fn image(&self) -> Result<Image, tauflow_data::DataError> {
        let data = match &self.values {
            Values::Numbers(data) => data.clone(),
            Values::Bytes(bytes, table) => {
                let level = |(at, byte): (usize, &u8)| table[at % self.channels * LEVELS + usize::from(*byte)];
                bytes.iter().enumerate().map(level).collect()
            }
        };
        Image::from_data(self.width, self.height, self.channels, data)
    }

    /// Numbers of a channel, by the places of their texels' first numbers. A place beyond the image gives any number.
    #[inline(always)]
    pub(crate) fn read<R: Real>(&self, at: R::Integer, channel: usize) -> R {
        match &self.values {
            Values::Numbers(data) => R::gather(data, at + R::Integer::splat(channel as i32)),
            Values::Bytes(bytes, table) => {
                let (mut places, mut found) = ([0; 16], [0.0; 16]);
                at.store(&mut places);
                let table = &table[channel * LEVELS..][..LEVELS];
                for (value, place) in found[..R::N].iter_mut().zip(&places) {
                    let byte = bytes.get(*place as usize + channel).copied().unwrap_or(0);
                    *value = table[usize::from(byte)];
                }
                R::load(&found)
            }
        }
    }

    /// Memory of the texels.
    pub fn bytes(&self) -> usize {
        match &self.values {
            Values::Numbers(data) => size_of_val(&data[..]),
            Values::Bytes(bytes, table) => bytes.len() + size_of_val(&table[..]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(channels: usize, value: impl Fn(usize) -> f32) -> Image {
        let count = 64 * 32 * channels;
        Image::from_data(64, 32, channels, (0..count).map(value).collect()).expect("fits")
    }

    fn read_back(texels: &Texels, image: &Image) {
        assert_eq!(texels.image().expect("texels").data(), image.data());
        for at in [0, 5, 64 * 32 - 1] {
            for channel in 0..image.channels() {
                let first = at * image.channels();
                let found: f32 = texels.read(first as i32, channel);
                assert_eq!(found.to_bits(), image.data()[first + channel].to_bits());
            }
        }
    }

    #[test]
    fn pictures_of_eight_bits_keep_their_bits_in_a_quarter_of_the_memory() {
        for channels in [3, 4] {
            let picture = image(channels, |i| ((i * 7919 % 256) as f32 / 255.0).powf(2.2));
            let texels = Texels::from(picture.clone());
            assert!(texels.bytes() < 64 * 32 * channels + 4 * 256 * channels + 1, "{} bytes", texels.bytes());
            read_back(&texels, &picture);
        }
        // Of signs of zero, too, and what is no number.
        let odd = image(3, |i| [0.0, -0.0, f32::NAN, 1.0][i % 4]);
        let texels = Texels::from(odd.clone());
        for (at, value) in odd.data().iter().enumerate() {
            let found: f32 = texels.read((at / 3 * 3) as i32, at % 3);
            assert_eq!(found.to_bits(), value.to_bits());
        }
    }

    #[test]
    fn pictures_of_more_values_stay_numbers() {
        let wide = image(3, |i| i as f32 * 0.37);
        let texels = Texels::from(wide.clone());
        assert_eq!(texels.bytes(), 64 * 32 * 3 * 4);
        read_back(&texels, &wide);
        let small = Image::from_data(2, 1, 3, vec![0.5; 6]).expect("fits");
        assert_eq!(Texels::from(small).bytes(), 24, "a table would be larger");
    }

    #[test]
    fn places_beyond_the_image_are_no_panic() {
        let texels = Texels::from(image(3, |i| (i % 9) as f32));
        for at in [-1, i32::MAX, i32::MIN, 64 * 32 * 3] {
            assert!(texels.read::<f32>(at, 2) < 9.0);
        }
    }
}
