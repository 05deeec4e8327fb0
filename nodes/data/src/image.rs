//! Images: rows of pixels of f32 channels, top row first.

/// An image of `height` x `width` pixels of `channels` values, row-major, top-left first.
///
/// # Units
/// Whatever the holder says: linear radiance for renders, albedo and world-space normals for G-buffers.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    width: usize,
    height: usize,
    channels: usize,
    data: Vec<f32>,
}

impl Image {
    /// A black image.
    pub fn new(width: usize, height: usize, channels: usize) -> Self {
        Self { width, height, channels, data: vec![0.0; width * height * channels] }
    }

    /// An image of `data`, shape [height, width, channels].
    ///
    /// # Errors
    /// If the length does not fit the shape, whose product may be beyond all numbers.
    pub fn from_data(width: usize, height: usize, channels: usize, data: Vec<f32>) -> Result<Self, crate::DataError> {
        let values = width.checked_mul(height).and_then(|pixels| pixels.checked_mul(channels));
        if values != Some(data.len()) {
            return Err(crate::DataError::Format(format!(
                "{} values do not make an image of {width} x {height} x {channels}",
                data.len()
            )));
        }
        Ok(Self { width, height, channels, data })
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Values in a pixel.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// All values, shape [height, width, channels].
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// All values, to write.
    pub fn data_mut(&mut self) -> &mut [f32] {
        &mut self.data
    }

    /// The values, without the image.
    pub fn into_data(self) -> Vec<f32> {
        self.data
    }

    /// A pixel's values.
    pub fn pixel(&self, x: usize, y: usize) -> &[f32] {
        let at = (y * self.width + x) * self.channels;
        &self.data[at..at + self.channels]
    }

    /// A pixel's values, to write.
    pub fn pixel_mut(&mut self, x: usize, y: usize) -> &mut [f32] {
        let at = (y * self.width + x) * self.channels;
        &mut self.data[at..at + self.channels]
    }

    /// Every value through `f`.
    pub fn map(&self, f: impl Fn(f32) -> f32) -> Self {
        Self { data: self.data.iter().map(|v| f(*v)).collect(), ..*self }
    }

    /// Some of the channels, as an image.
    pub fn channels_of(&self, range: std::ops::Range<usize>) -> Self {
        let data = self.data.chunks_exact(self.channels).flat_map(|pixel| pixel[range.clone()].iter().copied());
        let (width, height, channels) = (self.width, self.height, range.len());
        Self { width, height, channels, data: data.collect() }
    }

    /// The channels of this image, then those of another of the same size.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn beside(&self, other: &Self) -> Result<Self, crate::DataError> {
        let size = |image: &Self| format!("{} x {}", image.width, image.height);
        if (self.width, self.height) != (other.width, other.height) {
            let (own, its) = (size(self), size(other));
            return Err(crate::DataError::Format(format!("images of {own} and {its} pixels cannot be combined")));
        }
        let rows = self.data.chunks_exact(self.channels).zip(other.data.chunks_exact(other.channels));
        let data = rows.flat_map(|(a, b)| a.iter().chain(b).copied()).collect();
        Self::from_data(self.width, self.height, self.channels + other.channels, data)
    }

    /// True if both have the same width, height and channels.
    pub fn same_shape(&self, other: &Self) -> bool {
        (self.width, self.height, self.channels) == (other.width, other.height, other.channels)
    }

    /// Wants every value to be a finite number; `what` names the image, `remedy` says what to do.
    ///
    /// # Errors
    /// How many are not, if any.
    pub fn finite(&self, what: &str, remedy: &str) -> Result<(), crate::DataError> {
        let bad = self.data.iter().filter(|v| !v.is_finite()).count();
        if bad == 0 {
            return Ok(());
        }
        Err(crate::DataError::Format(format!(
            "{bad} of the {} values of the {what} are not finite; {remedy}",
            self.data.len()
        )))
    }
}

/// The display transform: Reinhard x/(1+x), then ^(1/2.2), clipped to [0, 1]; f32, before any 8-bit rounding.
///
/// Negatives count as black. Input is exposure-normalised linear radiance.
pub fn preview(value: f32) -> f32 {
    let x = value.max(0.0);
    let mapped = if x.is_finite() { x / (1.0 + x) } else { 1.0 };
    libm::powf(mapped, 1.0 / 2.2).clamp(0.0, 1.0)
}

/// Weights of relative luminance (Rec. 709).
pub const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// Relative luminance of a linear RGB pixel.
pub fn luminance(rgb: &[f32]) -> f32 {
    LUMINANCE[0] * rgb[0] + LUMINANCE[1] * rgb[1] + LUMINANCE[2] * rgb[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn preview_is_bounded_and_monotone() {
        assert_eq!(preview(-1.0), 0.0);
        assert_eq!(preview(f32::INFINITY), 1.0);
        // x = 1 maps to 1/2, and (1/2)^(1/2.2) = 0.72974.
        assert!((preview(1.0) - 0.729_740).abs() < 1e-6);
        let values: Vec<f32> = (0..1000).map(|i| preview(i as f32 * 0.01)).collect();
        assert!(values.windows(2).all(|w| w[0] < w[1]));
    }

    #[test]
    fn shapes_are_checked() {
        assert!(Image::from_data(2, 2, 3, vec![0.0; 11]).is_err());
        // The product of these is 0 where it is cut to 64 bits.
        assert!(Image::from_data(1 << 32, 1 << 32, 3, Vec::new()).is_err());
        let mut image = Image::new(2, 1, 3);
        image.pixel_mut(1, 0)[2] = 4.0;
        assert_eq!(image.data()[5], 4.0);
        assert_eq!(luminance(&[1.0, 1.0, 1.0]), 1.0);
    }
}
