//! The state of a render: for each pixel the sum of its samples and of their squared deviations, in f64.
//!
//! Samples are taken in order of their index, so that a render that is continued has the bits of one from scratch. The
//! deviations follow Welford 1962.

use tauflow_contract::KindError;
use tauflow_data::Image;

/// A pixel's state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pixel {
    /// Sum of the samples.
    pub sum: [f64; 3],
    /// Sum of squared deviations from their mean.
    pub m2: [f64; 3],
}

impl Pixel {
    /// Adds the sample of index `count`: so many have been added before.
    #[inline]
    pub fn add(&mut self, count: u64, sample: [f32; 3]) {
        let before = count as f64;
        let inverse = 1.0 / (before + 1.0);
        for (c, value) in sample.into_iter().enumerate() {
            let x = f64::from(value);
            if count > 0 {
                // (x - old mean)(x - new mean) = (x - old mean)^2 n / (n + 1).
                let deviation = x - self.sum[c] / before;
                self.m2[c] += deviation * deviation * (before * inverse);
            }
            self.sum[c] += x;
        }
    }
}

/// The samples 0..count of every pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Accumulator {
    width: usize,
    height: usize,
    /// Samples per pixel.
    pub count: u64,
    /// Contributions that were not finite and therefore left out.
    pub rejected: u64,
    /// Path segments traced.
    pub segments: u64,
    /// The pixels, rows from the top.
    pub pixels: Vec<Pixel>,
}

const MAGIC: &[u8; 16] = b"tauflow-accum-01";

impl Accumulator {
    /// No samples yet.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, count: 0, rejected: 0, segments: 0, pixels: vec![Pixel::default(); width * height] }
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Mean of the samples; black if there is none.
    pub fn mean(&self) -> Image {
        let n = self.count.max(1) as f64;
        self.image(|pixel| pixel.sum.map(|s| (s / n) as f32))
    }

    /// Unbiased variance of single samples; 0 for fewer than two.
    pub fn variance(&self) -> Image {
        let n = self.count.saturating_sub(1).max(1) as f64;
        self.image(|pixel| pixel.m2.map(|m| (m / n) as f32))
    }

    /// Mean number of segments in a path.
    pub fn mean_path_length(&self) -> f64 {
        self.segments as f64 / (self.count.max(1) as f64 * self.pixels.len().max(1) as f64)
    }

    fn image(&self, value: impl Fn(&Pixel) -> [f32; 3]) -> Image {
        let data = self.pixels.iter().flat_map(value).collect();
        Image::from_data(self.width, self.height, 3, data).expect("three values for each pixel")
    }

    /// Its blob: magic, five u64, then six f64 for each pixel, all little-endian.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(56 + self.pixels.len() * 48);
        out.extend(MAGIC);
        for word in [self.width as u64, self.height as u64, self.count, self.rejected, self.segments] {
            out.extend(word.to_le_bytes());
        }
        for pixel in &self.pixels {
            for value in pixel.sum.iter().chain(&pixel.m2) {
                out.extend(value.to_le_bytes());
            }
        }
        out
    }

    /// Reads its blob.
    ///
    /// # Errors
    /// If it is damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, KindError> {
        let damaged = || KindError::Input(format!("an accumulator of {} bytes is damaged; remove it", bytes.len()));
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(damaged)?;
        let (header, body) = rest.split_at_checked(40).ok_or_else(damaged)?;
        let word = |i: usize| u64::from_le_bytes(header[8 * i..8 * i + 8].try_into().expect("eight bytes"));
        let (width, height) = (word(0) as usize, word(1) as usize);
        let size = width.checked_mul(height).and_then(|n| n.checked_mul(48)).ok_or_else(damaged)?;
        if body.len() != size {
            return Err(damaged());
        }
        let number = |b: &[u8]| f64::from_le_bytes(b.try_into().expect("eight bytes"));
        let pixels = body.chunks_exact(48).map(|pixel| {
            let at = |i: usize| number(&pixel[8 * i..8 * i + 8]);
            Pixel { sum: [at(0), at(1), at(2)], m2: [at(3), at(4), at(5)] }
        });
        Ok(Self { width, height, count: word(2), rejected: word(3), segments: word(4), pixels: pixels.collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::rng::Stream;

    #[test]
    fn mean_and_variance_are_those_of_the_samples() {
        let mut stream = Stream::new(3, &[]);
        let samples: Vec<[f32; 3]> =
            (0..1000).map(|_| [stream.uniform() as f32, 1e4 + stream.uniform() as f32, 0.5]).collect();
        let mut accumulator = Accumulator::new(1, 1);
        for sample in &samples {
            accumulator.pixels[0].add(accumulator.count, *sample);
            accumulator.count += 1;
        }
        for c in 0..3 {
            let values: Vec<f64> = samples.iter().map(|s| f64::from(s[c])).collect();
            let mean = values.iter().sum::<f64>() / 1000.0;
            let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / 999.0;
            assert_eq!(accumulator.mean().data()[c], mean as f32);
            let found = f64::from(accumulator.variance().data()[c]);
            assert!((found - variance).abs() <= 1e-7 * variance, "{found} {variance}");
        }
    }

    #[test]
    fn blobs_round_trip_and_damage_is_found() {
        let mut accumulator = Accumulator::new(3, 2);
        accumulator.pixels[4].add(0, [1.0, 2.0, 3.0]);
        (accumulator.count, accumulator.rejected, accumulator.segments) = (1, 2, 3);
        let bytes = accumulator.to_bytes();
        assert_eq!(Accumulator::from_bytes(&bytes).expect("own bytes"), accumulator);
        for bad in [&bytes[..bytes.len() - 1], &bytes[..30], &bytes[1..], &[]] {
            assert!(Accumulator::from_bytes(bad).is_err());
        }
    }
}
