//! Images of a glTF file as bitmaps: decoded, made linear, reduced. Knows nothing of materials.
//!
//! PNG, JPEG and WebP through the crate `image`. Base colour and emission are sRGB by the specification, everything
//! else is linear. Reduction is an average over whole blocks of linear values, made row by row.

use super::container::Document;
use crate::assets::{
    blobs::BlobSet,
    bounds::{Allowance, MOST_TEXELS},
    refusal::{Refusal, damaged},
};
use image::{DynamicImage, ImageDecoder, ImageReader, Limits};
use std::{
    collections::{BTreeMap, BTreeSet},
    io::Cursor,
};
use tauflow_contract::Digest;
use tauflow_data::{Image, maths, records::AssetReport};

/// The use of an image.
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
    left: Allowance,
    /// Those of latest use, the last one at the end.
    held: Vec<(usize, DynamicImage)>,
    /// All that were ever decoded.
    seen: BTreeSet<usize>,
    made: BTreeMap<(usize, Use), Digest>,
    averages: BTreeMap<(usize, Use), [f32; 3]>,
}

/// Largest side of an image that is decoded.
const LARGEST: u32 = 1 << 14;

/// Bytes of decoded images that are held for further uses; one image is, however large.
const MOST_HELD: usize = 1 << 27;

/// Bytes that a decoder may take beside the image.
const SPARE: u64 = 1 << 27;

fn linear(encoded: f64) -> f64 {
    if encoded <= 0.04045 { encoded / 12.92 } else { maths::pow((encoded + 0.055) / 1.055, 2.4) }
}

impl Images {
    /// No image yet; larger ones will be reduced to `most` texels a side. The file has `bytes`.
    pub fn new(most: usize, bytes: usize) -> Self {
        Self {
            most: most.max(1),
            left: Allowance::of(bytes),
            held: Vec::new(),
            seen: BTreeSet::new(),
            made: BTreeMap::new(),
            averages: BTreeMap::new(),
        }
    }

    /// The bitmap of image `number` for a use.
    ///
    /// # Errors
    /// If the image is missing, damaged, too large or of a format that is not read.
    pub fn get(
        &mut self,
        document: &Document<'_>,
        number: usize,
        purpose: Use,
        blobs: &mut BlobSet,
        report: &mut AssetReport,
    ) -> Result<Digest, Refusal> {
        if let Some(made) = self.made.get(&(number, purpose)) {
            return Ok(*made);
        }
        let place = format!("image {number}");
        let decoded = self.decoded(document, number, &place, report)?;
        let (width, height) = (decoded.width() as usize, decoded.height() as usize);
        let factor = width.max(height).div_ceil(self.most);
        if factor > 1 {
            report.note(format!("image {number} of {width} x {height} reduced by {factor}"));
        }
        let texels = width.div_ceil(factor) * height.div_ceil(factor);
        self.left.make(&place, texels * channels(purpose) * size_of::<f32>())?;
        let digest = blobs.add(bitmap(&decoded, purpose, factor).to_bytes());
        self.made.insert((number, purpose), digest);
        self.hold(number, decoded);
        Ok(digest)
    }

    /// The average of image `number` for a use; a single channel three times.
    ///
    /// # Errors
    /// As for [`Images::get`].
    pub fn average(
        &mut self,
        document: &Document<'_>,
        number: usize,
        purpose: Use,
        report: &mut AssetReport,
    ) -> Result<[f32; 3], Refusal> {
        if let Some(average) = self.averages.get(&(number, purpose)) {
            return Ok(*average);
        }
        let decoded = self.decoded(document, number, &format!("image {number}"), report)?;
        let whole = bitmap(&decoded, purpose, decoded.width().max(decoded.height()) as usize);
        let average = [0, 1, 2].map(|c| whole.data()[c % channels(purpose)]);
        self.averages.insert((number, purpose), average);
        self.hold(number, decoded);
        Ok(average)
    }

    /// An image, which its reader gives back by [`Images::hold`].
    fn decoded(
        &mut self,
        document: &Document<'_>,
        number: usize,
        place: &str,
        report: &mut AssetReport,
    ) -> Result<DynamicImage, Refusal> {
        self.seen.insert(number);
        report.measure("images", self.seen.len() as f64);
        match self.held.iter().position(|(held, _)| *held == number) {
            Some(at) => {
                let (_, decoded) = self.held.remove(at);
                self.left.read(place, decoded.width() as usize * decoded.height() as usize)?;
                Ok(decoded)
            }
            None => decode(document, number, place, &mut self.left),
        }
    }

    /// Holds an image for further uses, and lets go of those of longest ago.
    fn hold(&mut self, number: usize, decoded: DynamicImage) {
        self.held.push((number, decoded));
        let bytes = |(_, image): &(usize, DynamicImage)| image.as_bytes().len();
        while self.held.len() > 1 && self.held.iter().map(bytes).sum::<usize>() > MOST_HELD {
            self.held.remove(0);
        }
    }
}

fn decode(document: &Document<'_>, number: usize, place: &str, left: &mut Allowance) -> Result<DynamicImage, Refusal> {
    let image = document.root.images.get(number).ok_or_else(|| damaged(place, "there is no such image"))?;
    let bytes = match (&image.uri, image.buffer_view) {
        (Some(uri), _) => document.fetch(uri, place)?,
        (None, Some(view)) => document.view(view.value())?.0.into(),
        (None, None) => return Err(damaged(place, "it has neither a URI nor a bufferView")),
    };
    decoded(&bytes, place, left)
}

/// A picture of a PNG, JPEG or WebP file in linear RGB; values as they are stored if `raw`, from sRGB if not.
///
/// # Errors
/// If it is damaged, too large or of another format.
pub fn picture(bytes: &[u8], place: &str, raw: bool, left: &mut Allowance) -> Result<Image, Refusal> {
    let decoded = decoded(bytes, place, left)?;
    let purpose = if raw { Use::Linear } else { Use::Color };
    left.make(place, decoded.width() as usize * decoded.height() as usize * channels(purpose) * size_of::<f32>())?;
    Ok(bitmap(&decoded, purpose, 1))
}

/// The alpha of a picture beside red, green and blue, in the encoding of its colours as pbrt reads it; none if there is
/// no such channel, or it is 1 everywhere.
///
/// # Errors
/// As for [`picture`].
pub fn alpha(bytes: &[u8], place: &str, raw: bool, left: &mut Allowance) -> Result<Option<Image>, Refusal> {
    // The colour type in the header of a PNG: palettes and greys have no alpha for pbrt, nor has any other format that
    // it reads.
    if !bytes.starts_with(b"\x89PNG") || bytes.get(25) != Some(&6) {
        return Ok(None);
    }
    let before = left.clone();
    let decoded = decoded(bytes, place, left)?;
    left.make(place, decoded.width() as usize * decoded.height() as usize * size_of::<f32>())?;
    let mut image = bitmap(&decoded, Use::Alpha, 1);
    if decoded.color().channel_count() != 4 || image.data().iter().all(|v| *v == 1.0) {
        // Its colours are read in a moment, at their cost.
        *left = before;
        return Ok(None);
    }
    if !raw {
        image.data_mut().iter_mut().for_each(|v| *v = linear(f64::from(*v)) as f32);
    }
    Ok(Some(image))
}

fn decoded(bytes: &[u8], place: &str, left: &mut Allowance) -> Result<DynamicImage, Refusal> {
    if bytes.starts_with(b"\xabKTX") {
        return Err(Refusal::new(place, "KTX2 textures are not read", "convert them to PNG, JPEG or WebP"));
    }
    let broken = |e: image::ImageError| damaged(place, e.to_string());
    let mut reader =
        ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| damaged(place, e.to_string()))?;
    if reader.format().is_none() {
        return Err(Refusal::new(place, "neither PNG, JPEG nor WebP", "convert it to one of them"));
    }
    let mut limits = Limits::default();
    limits.max_image_width = None;
    limits.max_image_height = None;
    limits.max_alloc = Some(SPARE);
    reader.limits(limits.clone());
    // Only the header is read here.
    let mut decoder = reader.into_decoder().map_err(broken)?;
    let (width, height) = decoder.dimensions();
    if width == 0 || height == 0 {
        return Err(damaged(place, "it has no texels"));
    }
    let texels = width as usize * height as usize;
    if width.max(height) > LARGEST || texels > MOST_TEXELS {
        return Err(Refusal::new(
            place,
            format!("{width} x {height} texels, {LARGEST} along a side and {MOST_TEXELS} in all are the most"),
            "make it smaller",
        ));
    }
    left.read(place, texels)?;
    limits.max_alloc = Some(decoder.total_bytes().saturating_add(SPARE));
    decoder.set_limits(limits).map_err(broken)?;
    DynamicImage::from_decoder(decoder).map_err(broken)
}

/// Puts red, green, blue and alpha in [0, 1] of the texels of row `y` into `row`.
fn texels(image: &DynamicImage, y: usize, row: &mut Vec<[f32; 4]>) {
    let width = image.width() as usize;
    row.clear();
    match image {
        DynamicImage::ImageRgb8(rgb) => {
            row.extend(rgb.as_raw()[3 * y * width..][..3 * width].chunks_exact(3).map(|p| {
                let [r, g, b] = [p[0], p[1], p[2]].map(|v| f32::from(v) / 255.0);
                [r, g, b, 1.0]
            }));
        }
        DynamicImage::ImageRgba8(rgba) => row.extend(
            rgba.as_raw()[4 * y * width..][..4 * width]
                .chunks_exact(4)
                .map(|p| [p[0], p[1], p[2], p[3]].map(|v| f32::from(v) / 255.0)),
        ),
        other => {
            let wide = other.crop_imm(0, y as u32, other.width(), 1).to_rgba16();
            row.extend(wide.pixels().map(|p| p.0.map(|v| f32::from(v) / 65535.0)));
        }
    }
}

/// Channels of the bitmap for a use.
fn channels(purpose: Use) -> usize {
    if matches!(purpose, Use::Color | Use::Linear) { 3 } else { 1 }
}

fn bitmap(decoded: &DynamicImage, purpose: Use, factor: usize) -> Image {
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let channels = channels(purpose);
    let mut image = Image::new(width.div_ceil(factor), height.div_ceil(factor), channels);
    // 8-bit values are few: their linear values are looked up.
    let table: Vec<f64> = (0..256).map(|v| linear(f64::from(v) / 255.0)).collect();
    let eight = matches!(decoded, DynamicImage::ImageRgb8(_) | DynamicImage::ImageRgba8(_));
    let decode = |v: f32| if eight { table[(v * 255.0 + 0.5) as usize & 255] } else { linear(f64::from(v)) };
    let mut row = Vec::with_capacity(width);
    let mut sums = vec![0.0f64; image.width() * channels];
    for y in 0..height {
        texels(decoded, y, &mut row);
        for (x, texel) in row.iter().enumerate() {
            let at = x / factor * channels;
            match purpose {
                Use::Color => (0..3).for_each(|c| sums[at + c] += decode(texel[c])),
                Use::Linear => (0..3).for_each(|c| sums[at + c] += f64::from(texel[c])),
                Use::Alpha => sums[at] += f64::from(texel[3]),
                Use::Mask(cutoff) => sums[at] += if texel[3] >= f32::from_bits(cutoff) { 1.0 } else { 0.0 },
            }
        }
        let rows = y % factor + 1;
        if rows < factor && y + 1 < height {
            continue;
        }
        for x in 0..image.width() {
            let count = (rows * factor.min(width - x * factor)) as f64;
            for (c, value) in image.pixel_mut(x, y / factor).iter_mut().enumerate() {
                *value = (sums[x * channels + c] / count) as f32;
            }
        }
        sums.fill(0.0);
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
        // As one texel: the average, on which `Images::average` builds.
        assert!((bitmap(&source, Use::Alpha, 3).data()[0] - 355.0 / 765.0).abs() < 1e-6);
    }

    #[test]
    fn bitmaps_made_row_by_row_are_averages_of_blocks() {
        let rgba = RgbaImage::from_fn(7, 5, |x, y| Rgba([31 * x + y, 17 * y, 3 * x * y, 40 * x + y].map(|v| v as u8)));
        let rgba = DynamicImage::ImageRgba8(rgba);
        let sorts: [DynamicImage; 6] = [
            rgba.to_rgb8().into(),
            rgba.to_luma8().into(),
            rgba.to_luma_alpha8().into(),
            rgba.to_rgb16().into(),
            rgba.to_rgba16().into(),
            rgba,
        ];
        for (image, factor) in sorts.iter().flat_map(|image| (1..=8).map(move |factor| (image, factor))) {
            let eight = matches!(image, DynamicImage::ImageRgb8(_) | DynamicImage::ImageRgba8(_));
            let (small, wide) = (image.to_rgba8(), image.to_rgba16());
            let texel = |x: usize, y: usize| match eight {
                true => small.get_pixel(x as u32, y as u32).0.map(|v| f32::from(v) / 255.0),
                false => wide.get_pixel(x as u32, y as u32).0.map(|v| f32::from(v) / 65535.0),
            };
            let made = bitmap(image, Use::Linear, factor);
            let alpha = bitmap(image, Use::Alpha, factor);
            let color = bitmap(image, Use::Color, factor);
            assert_eq!((made.width(), made.height()), (7usize.div_ceil(factor), 5usize.div_ceil(factor)));
            for (x, y) in (0..made.height()).flat_map(|y| (0..made.width()).map(move |x| (x, y))) {
                let rows = y * factor..((y + 1) * factor).min(5);
                let block = rows.flat_map(|y| (x * factor..((x + 1) * factor).min(7)).map(move |x| (x, y)));
                let block: Vec<[f32; 4]> = block.map(|(x, y)| texel(x, y)).collect();
                let mean = |of: &dyn Fn(&[f32; 4]) -> f64| {
                    (block.iter().fold(0.0, |sum, texel| sum + of(texel)) / block.len() as f64) as f32
                };
                for c in 0..3 {
                    assert_eq!(made.pixel(x, y)[c].to_bits(), mean(&|t| f64::from(t[c])).to_bits());
                    assert_eq!(color.pixel(x, y)[c].to_bits(), mean(&|t| linear_of(t[c], eight)).to_bits());
                }
                assert_eq!(alpha.pixel(x, y)[0].to_bits(), mean(&|t| f64::from(t[3])).to_bits());
            }
        }
    }

    fn linear_of(value: f32, eight: bool) -> f64 {
        if eight { linear(f64::from((value * 255.0 + 0.5) as u8) / 255.0) } else { linear(f64::from(value)) }
    }
}
