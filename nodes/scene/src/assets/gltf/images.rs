//! Images of a glTF file as bitmaps: decoded, made linear, reduced. Knows nothing of materials.
//!
//! PNG, JPEG and WebP through the crate `image`. Base colour and emission are sRGB by the specification, everything
//! else is linear. Reduction is an average over whole blocks of linear values.

use super::container::Document;
use crate::assets::{
    asset::Report,
    blobs::BlobSet,
    refusal::{Refusal, damaged},
};
use image::{DynamicImage, ImageReader, Limits};
use std::{
    collections::{BTreeMap, btree_map::Entry},
    io::Cursor,
};
use tauflow_contract::Digest;
use tauflow_data::{Image, maths};

/// What an image is read for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Use {
    /// RGB, from sRGB.
    Color,
    /// RGB as stored.
    Linear,
    /// Alpha alone.
    Alpha,
    /// 1 where alpha reaches this (the bits of an f32), else 0.
    Mask(u32),
}

/// The images of one file.
pub struct Images {
    most: usize,
    decoded: BTreeMap<usize, DynamicImage>,
    made: BTreeMap<(usize, Use), Digest>,
}

/// Largest side of an image that is decoded.
const LARGEST: u32 = 1 << 14;

fn linear(encoded: f64) -> f64 {
    if encoded <= 0.04045 { encoded / 12.92 } else { maths::pow((encoded + 0.055) / 1.055, 2.4) }
}

impl Images {
    /// No image yet; larger ones will be reduced to `most` texels a side.
    pub fn new(most: usize) -> Self {
        Self { most: most.max(1), decoded: BTreeMap::new(), made: BTreeMap::new() }
    }

    /// The bitmap of image `number` for a use.
    ///
    /// # Errors
    /// If the image is missing, damaged or of a format that is not read.
    pub fn get(
        &mut self,
        document: &Document<'_>,
        number: usize,
        purpose: Use,
        blobs: &mut BlobSet,
        report: &mut Report,
    ) -> Result<Digest, Refusal> {
        if let Some(made) = self.made.get(&(number, purpose)) {
            return Ok(*made);
        }
        let count = self.decoded.len() as f64;
        let decoded = match self.decoded.entry(number) {
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => {
                report.measure("images", count + 1.0);
                entry.insert(decode(document, number)?)
            }
        };
        let (width, height) = (decoded.width() as usize, decoded.height() as usize);
        let factor = width.max(height).div_ceil(self.most);
        if factor > 1 {
            report.note(format!("image {number} of {width} x {height} reduced by {factor}"));
        }
        let image = bitmap(decoded, purpose, factor);
        let digest = blobs.add(image.to_bytes());
        self.made.insert((number, purpose), digest);
        Ok(digest)
    }
}

fn decode(document: &Document<'_>, number: usize) -> Result<DynamicImage, Refusal> {
    let place = format!("image {number}");
    let image = document.root.images.get(number).ok_or_else(|| damaged(&place, "there is no such image"))?;
    let bytes = match (&image.uri, image.buffer_view) {
        (Some(uri), _) => document.fetch(uri, &place)?,
        (None, Some(view)) => document.view(view.value())?.0.into(),
        (None, None) => return Err(damaged(place, "it has neither a URI nor a bufferView")),
    };
    if bytes.starts_with(b"\xabKTX") {
        return Err(Refusal::new(place, "KTX2 textures are not read", "convert them to PNG, JPEG or WebP"));
    }
    let mut reader = ImageReader::new(Cursor::new(bytes.as_ref()))
        .with_guessed_format()
        .map_err(|e| damaged(&place, e.to_string()))?;
    if reader.format().is_none() {
        return Err(Refusal::new(place, "neither PNG, JPEG nor WebP", "convert it to one of them"));
    }
    let mut limits = Limits::default();
    limits.max_image_width = Some(LARGEST);
    limits.max_image_height = Some(LARGEST);
    limits.max_alloc = Some(1 << 30);
    reader.limits(limits);
    let decoded = reader.decode().map_err(|e| damaged(&place, e.to_string()))?;
    if decoded.width() == 0 || decoded.height() == 0 {
        return Err(damaged(place, "it has no texels"));
    }
    Ok(decoded)
}

/// Red, green, blue and alpha in [0, 1] of texels, row by row.
fn texels(image: &DynamicImage) -> Box<dyn Iterator<Item = [f32; 4]> + '_> {
    match image {
        DynamicImage::ImageRgb8(rgb) => Box::new(rgb.pixels().map(|p| {
            let [r, g, b] = p.0.map(|v| f32::from(v) / 255.0);
            [r, g, b, 1.0]
        })),
        DynamicImage::ImageRgba8(rgba) => Box::new(rgba.pixels().map(|p| p.0.map(|v| f32::from(v) / 255.0))),
        other => {
            let wide = other.to_rgba16();
            let values: Vec<[f32; 4]> = wide.pixels().map(|p| p.0.map(|v| f32::from(v) / 65535.0)).collect();
            Box::new(values.into_iter())
        }
    }
}

fn bitmap(decoded: &DynamicImage, purpose: Use, factor: usize) -> Image {
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let channels = if matches!(purpose, Use::Color | Use::Linear) { 3 } else { 1 };
    let (small_width, small_height) = (width.div_ceil(factor), height.div_ceil(factor));
    let mut sums = vec![0.0f64; small_width * small_height * channels];
    // 8-bit values are few: their linear values are looked up.
    let table: Vec<f64> = (0..256).map(|v| linear(f64::from(v) / 255.0)).collect();
    let eight = matches!(decoded, DynamicImage::ImageRgb8(_) | DynamicImage::ImageRgba8(_));
    let decode = |v: f32| if eight { table[(v * 255.0 + 0.5) as usize & 255] } else { linear(f64::from(v)) };
    for (i, texel) in texels(decoded).enumerate() {
        let at = (i / width / factor * small_width + i % width / factor) * channels;
        match purpose {
            Use::Color => (0..3).for_each(|c| sums[at + c] += decode(texel[c])),
            Use::Linear => (0..3).for_each(|c| sums[at + c] += f64::from(texel[c])),
            Use::Alpha => sums[at] += f64::from(texel[3]),
            Use::Mask(cutoff) => sums[at] += if texel[3] >= f32::from_bits(cutoff) { 1.0 } else { 0.0 },
        }
    }
    let mut image = Image::new(small_width, small_height, channels);
    for y in 0..small_height {
        let rows = factor.min(height - y * factor);
        for x in 0..small_width {
            let count = (rows * factor.min(width - x * factor)) as f64;
            let at = (y * small_width + x) * channels;
            for (c, value) in image.pixel_mut(x, y).iter_mut().enumerate() {
                *value = (sums[at + c] / count) as f32;
            }
        }
    }
    image
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgba, RgbaImage};

    #[test]
    fn bitmaps_are_linear_averaged_and_cut() {
        let source = RgbaImage::from_fn(3, 1, |x, _| Rgba([255, 0, 128, [255, 0, 100][x as usize]]));
        let source = DynamicImage::ImageRgba8(source);
        let color = bitmap(&source, Use::Color, 1);
        assert!((color.pixel(1, 0)[2] - 0.215_860_5).abs() < 1e-6 && color.pixel(0, 0)[0] == 1.0, "{color:?}");
        assert!((bitmap(&source, Use::Linear, 1).pixel(0, 0)[2] - 128.0 / 255.0).abs() < 1e-7);
        let half = bitmap(&source, Use::Alpha, 2);
        assert_eq!((half.width(), half.height(), half.data()[0]), (2, 1, 0.5));
        assert!((half.data()[1] - 100.0 / 255.0).abs() < 1e-7);
        assert_eq!(bitmap(&source, Use::Mask(0.5f32.to_bits()), 1).data(), &[1.0, 0.0, 0.0]);
    }
}
