//! Features of an image: means and standard deviations of random convolutions' outputs.
//!
//! The network is fixed: its weights are drawn once from a seed that is part of the definition, so that scores of
//! different runs compare. Every operation is in a fixed order, so its bits are the same on every machine.
//!
//! Source: random convolutional features tell texture statistics apart without any training (Ustyuzhaninov et al.,
//! "What does it take to generate natural textures?", ICLR 2017). Knows no distance.

use tauflow_data::{Image, rng::Stream};

/// Output channels of the levels.
const CHANNELS: [usize; 4] = [16, 32, 64, 128];
/// Numbers of a feature vector: mean and standard deviation of each channel.
pub(crate) const DIMENSIONS: usize = 2 * (CHANNELS[0] + CHANNELS[1] + CHANNELS[2] + CHANNELS[3]);
/// Seed of the weights.
const SEED: u64 = 0x6b69_645f_6c69_6b65;
/// Slope of the rectifier below 0.
const SLOPE: f32 = 0.2;
/// Least side of an image: each level halves it, and the last one needs 2 pixels.
pub(crate) const LEAST_SIDE: usize = 16;

/// The network.
pub(crate) struct RandomFeatures {
    levels: Vec<Level>,
}

/// A convolution of 3 x 3 pixels.
struct Level {
    inputs: usize,
    outputs: usize,
    /// By row and column of the window, input channel, output channel.
    weights: Vec<f32>,
}

/// Channels last, in rows.
struct FeatureMap {
    width: usize,
    height: usize,
    channels: usize,
    data: Vec<f32>,
}

impl RandomFeatures {
    /// The network of the definition.
    pub(crate) fn new() -> Self {
        let level = |(at, outputs): (usize, usize)| {
            let inputs = if at == 0 { 3 } else { CHANNELS[at - 1] };
            let mut stream = Stream::new(SEED, &[at as u64]);
            let spread = (2.0 / (9 * inputs) as f64).sqrt();
            let weights = (0..9 * inputs * outputs).map(|_| (spread * stream.normal()) as f32).collect();
            Level { inputs, outputs, weights }
        };
        Self { levels: CHANNELS.into_iter().enumerate().map(level).collect() }
    }

    /// The features of an image.
    ///
    /// # Shapes
    /// `image` is [H, W, 3] of display values, H and W at least [`LEAST_SIDE`]. The result has [`DIMENSIONS`] numbers.
    pub(crate) fn of(&self, image: &Image) -> Vec<f64> {
        let data = image.data().iter().map(|v| 2.0 * v - 1.0).collect();
        let mut map = FeatureMap { width: image.width(), height: image.height(), channels: image.channels(), data };
        let mut features = Vec::with_capacity(DIMENSIONS);
        for level in &self.levels {
            let out = level.of(&map);
            out.moments(&mut features);
            map = out.halved();
        }
        features
    }
}

impl Level {
    /// The rectified convolution. Beyond the border the image is mirrored about its outermost pixels.
    fn of(&self, map: &FeatureMap) -> FeatureMap {
        let (width, height) = (map.width, map.height);
        let mut data = vec![0.0; width * height * self.outputs];
        for y in 0..height {
            let rows = [mirrored(y, -1, height), y, mirrored(y, 1, height)];
            for x in 0..width {
                let columns = [mirrored(x, -1, width), x, mirrored(x, 1, width)];
                let at = (y * width + x) * self.outputs;
                let out = &mut data[at..at + self.outputs];
                for (window, (row, column)) in
                    rows.into_iter().flat_map(|row| columns.map(|column| (row, column))).enumerate()
                {
                    let pixel = &map.data[(row * width + column) * self.inputs..][..self.inputs];
                    let weights = &self.weights[window * self.inputs * self.outputs..];
                    for (value, weights) in pixel.iter().zip(weights.chunks_exact(self.outputs)) {
                        for (out, weight) in out.iter_mut().zip(weights) {
                            *out += value * weight;
                        }
                    }
                }
                for out in out {
                    *out = if *out < 0.0 { SLOPE * *out } else { *out };
                }
            }
        }
        FeatureMap { width, height, channels: self.outputs, data }
    }
}

/// The place one step aside, mirrored at the ends of 0..size.
fn mirrored(at: usize, step: isize, size: usize) -> usize {
    match at.checked_add_signed(step) {
        Some(to) if to < size => to,
        // One step beyond either end; a side has two pixels at least.
        Some(_) => size - 2,
        None => 1,
    }
}

impl FeatureMap {
    /// Appends the mean of each channel, then the standard deviation of each.
    fn moments(&self, to: &mut Vec<f64>) {
        let pixels = (self.width * self.height) as f64;
        let mut sums = vec![[0.0; 2]; self.channels];
        for pixel in self.data.chunks_exact(self.channels) {
            for (sum, value) in sums.iter_mut().zip(pixel) {
                let value = f64::from(*value);
                sum[0] += value;
                sum[1] += value * value;
            }
        }
        to.extend(sums.iter().map(|sum| sum[0] / pixels));
        to.extend(sums.iter().map(|sum| (sum[1] / pixels - (sum[0] / pixels).powi(2)).max(0.0).sqrt()));
    }

    /// Means over blocks of 2 x 2 pixels; an odd last row or column is left out.
    fn halved(&self) -> Self {
        let (width, height, channels) = (self.width / 2, self.height / 2, self.channels);
        let mut data = Vec::with_capacity(width * height * channels);
        for y in 0..height {
            for x in 0..width {
                let pixel = |dx: usize, dy: usize| &self.data[((2 * y + dy) * self.width + 2 * x + dx) * channels..];
                let (a, b, c, d) = (pixel(0, 0), pixel(1, 0), pixel(0, 1), pixel(1, 1));
                data.extend((0..channels).map(|i| 0.25 * (a[i] + b[i] + c[i] + d[i])));
            }
        }
        Self { width, height, channels, data }
    }
}

/// Feature vectors of a set of images, one row each.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FeatureSet(pub(crate) Vec<Vec<f64>>);

/// Centre and spread of each feature over the clean renders, so that none outweighs the others by its unit.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Standard {
    mean: Vec<f64>,
    spread: Vec<f64>,
}

impl Standard {
    /// Of the features of clean renders, of which there are two at least.
    pub(crate) fn of(clean: &[Vec<f64>]) -> Self {
        let number = clean.len() as f64;
        let mean: Vec<f64> = (0..DIMENSIONS).map(|j| clean.iter().map(|row| row[j]).sum::<f64>() / number).collect();
        let deviation = |j: usize| {
            let squares: f64 = clean.iter().map(|row| (row[j] - mean[j]).powi(2)).sum();
            (squares / (number - 1.0)).sqrt()
        };
        let deviations: Vec<f64> = (0..DIMENSIONS).map(deviation).collect();
        // Features that hardly vary must not blow noise up.
        let floor = 0.01 * deviations.iter().sum::<f64>() / DIMENSIONS as f64 + 1e-6;
        Self { mean, spread: deviations.into_iter().map(|deviation| deviation + floor).collect() }
    }

    /// Rows in units of the spread.
    pub(crate) fn apply(&self, rows: &[Vec<f64>]) -> FeatureSet {
        let scaled = |(value, (mean, spread)): (&f64, (&f64, &f64))| (value - mean) / spread;
        let row = |row: &Vec<f64>| row.iter().zip(self.mean.iter().zip(&self.spread)).map(scaled).collect();
        FeatureSet(rows.iter().map(row).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(seed: u64, width: usize, height: usize) -> Image {
        let mut stream = Stream::new(seed, &[]);
        let data = (0..width * height * 3).map(|_| stream.uniform() as f32).collect();
        Image::from_data(width, height, 3, data).expect("fits")
    }

    /// The first level by its definition, a pixel and a channel at a time.
    #[test]
    fn the_first_level_is_a_rectified_convolution() {
        let (features, image) = (RandomFeatures::new(), noise(1, 17, 16));
        let level = &features.levels[0];
        let out_at = |x: isize, y: isize, out: usize| {
            let mut sum = 0.0f64;
            for dy in -1..=1isize {
                for dx in -1..=1isize {
                    let inside = |at: isize, size: usize| {
                        let last = size as isize - 1;
                        (if at < 0 {
                            -at
                        } else if at > last {
                            2 * last - at
                        } else {
                            at
                        }) as usize
                    };
                    let pixel = image.pixel(inside(x + dx, 17), inside(y + dy, 16));
                    for (c, value) in pixel.iter().enumerate() {
                        let window = ((dy + 1) * 3 + dx + 1) as usize;
                        let weight = level.weights[(window * 3 + c) * CHANNELS[0] + out];
                        sum += (2.0 * f64::from(*value) - 1.0) * f64::from(weight);
                    }
                }
            }
            if sum < 0.0 { 0.2 * sum } else { sum }
        };
        let all = features.of(&image);
        assert_eq!(all.len(), DIMENSIONS);
        for out in [0, 7, 15] {
            let values: Vec<f64> =
                (0..16).flat_map(|y| (0..17).map(move |x| (x, y))).map(|(x, y)| out_at(x, y, out)).collect();
            let mean = values.iter().sum::<f64>() / 272.0;
            let deviation = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 272.0).sqrt();
            assert!((all[out] - mean).abs() < 1e-6, "{} {mean}", all[out]);
            assert!((all[CHANNELS[0] + out] - deviation).abs() < 1e-6, "{} {deviation}", all[CHANNELS[0] + out]);
        }
    }

    #[test]
    fn features_are_pinned() {
        // Whoever changes these bits changes the definition, and raises the version of `image_quality`.
        let features = RandomFeatures::new().of(&noise(2, 32, 16));
        let bits = features.iter().fold(0u64, |sum, value| tauflow_data::rng::mix(sum, value.to_bits()));
        assert_eq!(bits, PINNED, "{bits:#x}");
    }

    const PINNED: u64 = 0xdee2_e26c_14bd_e60f;

    #[test]
    fn standard_features_have_mean_0_and_spread_1() {
        let network = RandomFeatures::new();
        let rows: Vec<Vec<f64>> = (0..8).map(|seed| network.of(&noise(seed, 16, 16))).collect();
        let FeatureSet(scaled) = Standard::of(&rows).apply(&rows);
        for j in [0, 100, DIMENSIONS - 1] {
            let mean = scaled.iter().map(|row| row[j]).sum::<f64>() / 8.0;
            let variance = scaled.iter().map(|row| row[j] * row[j]).sum::<f64>() / 7.0;
            assert!(mean.abs() < 1e-9 && (0.5..=1.0).contains(&variance), "{mean} {variance}");
        }
        // A set without any spread is not divided by 0.
        let same = vec![rows[0].clone(), rows[0].clone()];
        assert!(Standard::of(&same).apply(&same).0.iter().flatten().all(|v| *v == 0.0));
    }
}
