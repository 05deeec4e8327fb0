//! Denoising a frame: exposure, tiles, one network call for each, and the mix.

use crate::{
    built_in::Weights,
    frame::{Features, Frame},
    mix::{Evidence, changed},
    tiles::{Tile, part, put, tiles},
};
use std::borrow::Cow;
use tauflow_contract::KindError;
use tauflow_data::{Image, bins::lit_geometric_mean_luminance, views::Views};
use tauflow_train::{Conditioning, Mirrored, Model, clean_estimate};

/// Geometric mean luminance that solvers saw scenes exposed to.
const KEY: f64 = 0.18;

/// How a frame is denoised.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Samples per pixel; none if unknown or uneven. Counts outside of the model's ladder count as unknown.
    pub spp: Option<u64>,
    /// The factor that brings the geometric mean luminance to mid-grey, 0.18; none to measure it. The result has the
    /// exposure of the frame.
    pub exposure: Option<f64>,
    /// Share of the denoised image in the result, from 0 to 1.
    pub strength: f64,
    /// Mirrored and rotated copies over which the call is averaged.
    pub views: Views,
    /// Side of tiles in pixels, up to 16384; none to use tiles only for images above 1.6 million pixels. Results
    /// differ only by rounding.
    pub tile: Option<usize>,
    /// Whether the G-buffer is used, if there is one.
    pub gbuffer: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self { spp: None, exposure: None, strength: 1.0, views: Views::ONE, tile: None, gbuffer: true }
    }
}

/// A denoised frame.
#[derive(Clone, Debug)]
pub struct Denoised {
    /// Linear radiance [H, W, 3] with the exposure of the frame.
    pub image: Image,
    /// The exposure factor that the network saw.
    pub exposure: f64,
    /// Whether the network was shown the G-buffer.
    pub with_gbuffer: bool,
    /// Mean share of the noisy image in the result, `strength` included; none without variance.
    pub kept: Option<f64>,
}

/// Loaded models: for radiance alone, for radiance with G-buffers, or both.
pub struct Denoiser {
    rgb: Option<Model>,
    gbuffer: Option<Model>,
}

impl Denoiser {
    /// The bundled models of a size.
    ///
    /// # Errors
    /// None with the files of this repository.
    pub fn built_in(weights: Weights) -> Result<Self, KindError> {
        let rgb = Some(weights.model(Conditioning::Rgb)?);
        Ok(Self { rgb, gbuffer: Some(weights.model(Conditioning::Gbuffer)?) })
    }

    /// Another model alone.
    pub fn of(model: Model) -> Self {
        match model.info().conditioning {
            Conditioning::Rgb => Self { rgb: Some(model), gbuffer: None },
            Conditioning::Gbuffer => Self { rgb: None, gbuffer: Some(model) },
        }
    }

    /// Denoises a frame. `progress` is called with the tiles that are done and how many there are; its error ends the
    /// work.
    ///
    /// # Errors
    /// If no model fits the frame, settings are out of their ranges, values exceed single precision, or the exposure of
    /// the settings leaves no light.
    pub fn denoise(
        &self,
        frame: &Frame,
        settings: &Settings,
        progress: &mut dyn FnMut(usize, usize) -> Result<(), KindError>,
    ) -> Result<Denoised, KindError> {
        let (plan, features) = self.plan(frame, settings)?;
        plan.denoise(frame, features, settings, progress)
    }

    /// As [`Denoiser::denoise`], with the same bits, in the memory of the frame: a large image needs no second one
    /// beside it. Mixes need the whole image, and so do mirrored copies of most sizes.
    ///
    /// # Errors
    /// As [`Denoiser::denoise`].
    pub fn denoise_in_place(
        &self,
        frame: Frame,
        settings: &Settings,
        progress: &mut dyn FnMut(usize, usize) -> Result<(), KindError>,
    ) -> Result<Denoised, KindError> {
        let (plan, features) = self.plan(&frame, settings)?;
        let (width, height) = (frame.radiance().width(), frame.radiance().height());
        if frame.variance().is_some() || plan.size != [width, height] || plan.tiles.len() == 1 {
            return plan.denoise(&frame, features, settings, progress);
        }
        let with_gbuffer = features.is_some();
        let (mut image, features) = frame.into_parts();
        let features = features.filter(|_| with_gbuffer);
        // Noisy rows above the tiles to come, whose place the denoised ones have taken.
        let mut above = Rows { first: 0, rows: Image::new(width, 0, 3) };
        let rows: Vec<&[Tile]> = plan.tiles.chunk_by(|a, b| a.core[1] == b.core[1]).collect();
        let mut done = 0;
        for (at, tiles) in rows.iter().enumerate() {
            let [_, top, _, bottom] = tiles[0].core;
            let mut band = Image::new(width, bottom - top, 3);
            for tile in *tiles {
                let seen = plan.exposed(&above.part_with(&image, tile.seen))?;
                let features = features.as_ref().map(|features| features.part(tile.seen));
                let made = estimate(plan.model, &seen, features.as_ref(), settings)?;
                let ([left, _, right, _], [x, y, ..]) = (tile.core, tile.seen);
                let inner = part(&made, [left - x, top - y, right - x, bottom - y]);
                let within = [left, 0, right, bottom - top];
                put(&mut band, &Tile { core: within, seen: within }, &inner);
                done += 1;
                progress(done, plan.tiles.len())?;
            }
            let own = 3 * width * top..3 * width * bottom;
            plan.finish(band.data_mut(), &image.data()[own.clone()], settings);
            if let Some(next) = rows.get(at + 1) {
                let first = next[0].seen[1].min(bottom);
                above = Rows { first, rows: above.part_with(&image, [0, first, width, bottom]) };
            }
            image.data_mut()[own].copy_from_slice(band.data());
        }
        plan.denoised(image, with_gbuffer, None)
    }

    /// The plan for a frame, and the G-buffer that it needs.
    fn plan<'a, 'f>(
        &'a self,
        frame: &'f Frame,
        settings: &Settings,
    ) -> Result<(Plan<'a>, Option<&'f Features>), KindError> {
        if settings.tile.is_some_and(|side| !(1..=MOST_TILE).contains(&side)) {
            return Err(KindError::Input(format!("a tile must have 1 to {MOST_TILE} pixels")));
        }
        if !(0.0..=1.0).contains(&settings.strength) {
            return Err(KindError::Input(format!("a strength of {}; it goes from 0 to 1", settings.strength)));
        }
        let (model, features) = self.model(frame, settings)?;
        let noisy = frame.radiance();
        // A value brighter than any light of a picture would spread over it.
        let bound = bound(noisy);
        let exposure = settings.exposure.unwrap_or_else(|| {
            let bright = noisy.data().iter().any(|value| value.abs() > bound);
            let bounded = bright.then(|| noisy.map(|value| value.clamp(-bound, bound)));
            let (mean, black) = lit_geometric_mean_luminance(bounded.as_ref().unwrap_or(noisy));
            if black > BLACK { KEY_BEFORE_BLACK / mean } else { KEY / mean }
        });
        if !(exposure.is_finite() && exposure > 0.0) {
            return Err(KindError::Input(format!("an exposure of {exposure}; it must be a factor above 0")));
        }
        let brightest = noisy.data().iter().fold(0.0f32, |most, value| most.max(*value));
        let keeps_light = settings.exposure.is_some() && brightest > 0.0;
        if keeps_light && (f64::from(brightest.min(bound)) * exposure) as f32 == 0.0 {
            let what = format!("an exposure of {exposure:e} makes the exposed image black; raise the exposure");
            return Err(KindError::Input(what));
        }
        // Mirrored copies look at the same blocks of pixels only if the image consists of whole ones.
        let multiple = if settings.views == Views::ONE { 1 } else { model.multiple() };
        let size = [noisy.width(), noisy.height()].map(|side| side.next_multiple_of(multiple));
        let tiles = tiles(size[0], size[1], settings.tile, model.reach(), model.multiple());
        Ok((Plan { model, bound, exposure, keeps_light, multiple, size, tiles }, features))
    }

    /// The model for a frame, and the G-buffer that it needs.
    fn model<'a, 'f>(
        &'a self,
        frame: &'f Frame,
        settings: &Settings,
    ) -> Result<(&'a Model, Option<&'f Features>), KindError> {
        match (&self.rgb, &self.gbuffer, frame.features().filter(|_| settings.gbuffer)) {
            (_, Some(model), Some(features)) => Ok((model, Some(features))),
            (Some(model), _, _) => Ok((model, None)),
            (None, _, _) => Err(KindError::Input(
                "the model needs albedo and normals, which the image lacks; give them, or use a model of \
                `conditioning: rgb`"
                    .into(),
            )),
        }
    }
}

/// How a frame is denoised, as far as it depends on the frame.
struct Plan<'a> {
    model: &'a Model,
    /// The largest value that the network is shown, before exposure.
    bound: f32,
    exposure: f64,
    /// Whether the result must have light: the frame has some, and its exposure was set.
    keeps_light: bool,
    /// Width and height are filled up to multiples of this.
    multiple: usize,
    size: [usize; 2],
    tiles: Vec<Tile>,
}

impl Plan<'_> {
    /// Denoises the frame beside itself, with the G-buffer that the model needs.
    fn denoise(
        &self,
        frame: &Frame,
        features: Option<&Features>,
        settings: &Settings,
        progress: &mut dyn FnMut(usize, usize) -> Result<(), KindError>,
    ) -> Result<Denoised, KindError> {
        let noisy = frame.radiance();
        let (width, height) = (noisy.width(), noisy.height());
        let padding = self.size != [width, height];
        // The whole image in memory once more only where it is needed: a large one is exposed tile by tile.
        let whole = (padding || frame.variance().is_some())
            .then(|| Ok::<_, KindError>(padded(self.exposed(noisy)?, self.multiple)))
            .transpose()?;
        let features = match features {
            Some(features) if padding => {
                Some(Cow::Owned(Features::Together(padded(features.whole().into_owned(), self.multiple))))
            }
            other => other.map(Cow::Borrowed),
        };
        let probe = match (&whole, frame.variance()) {
            (Some(whole), Some((variance, samples))) => Some((whole, variance, samples, changed(whole))),
            _ => None,
        };
        let calls = self.tiles.len() * if probe.is_some() { 2 } else { 1 };
        let mut done = 0;
        let mut all = |image: Option<&Image>| -> Result<Image, KindError> {
            let mut out = Image::new(self.size[0], self.size[1], 3);
            for tile in &self.tiles {
                let seen = match image {
                    Some(image) => part(image, tile.seen),
                    None => self.exposed(&part(noisy, tile.seen))?,
                };
                let features = features.as_ref().map(|features| features.part(tile.seen));
                put(&mut out, tile, &estimate(self.model, &seen, features.as_ref(), settings)?);
                done += 1;
                progress(done, calls)?;
            }
            Ok(out)
        };
        let mut image = all(whole.as_ref())?;
        let mut kept = None;
        if let Some((exposed, variance, samples, (moved, changes))) = &probe {
            let exposed_variance = |value: f32| (f64::from(value) * self.exposure * self.exposure) as f32;
            let variance = padded(variance.map(exposed_variance), self.multiple);
            let denoised_changed = all(Some(moved))?;
            let shares = Evidence {
                noisy: exposed,
                variance: &variance,
                samples: *samples,
                denoised: &image,
                denoised_changed: &denoised_changed,
                changes,
            }
            .shares();
            let share = shares.iter().map(|share| f64::from(*share)).sum::<f64>() / shares.len().max(1) as f64;
            kept = Some(1.0 - settings.strength * (1.0 - share));
            for (i, value) in image.data_mut().iter_mut().enumerate() {
                *value += shares[i / 3] * (exposed.data()[i] - *value);
            }
        }
        if padding {
            image = part(&image, [0, 0, width, height]);
        }
        self.finish(image.data_mut(), noisy.data(), settings);
        self.denoised(image, features.is_some(), kept)
    }

    /// A part of the image as the network is shown it.
    fn exposed(&self, image: &Image) -> Result<Image, KindError> {
        let bound = self.bound;
        let exposed = image.map(|value| (f64::from(value.clamp(-bound, bound)) * self.exposure) as f32);
        exposed.finite("exposed image", "lower the exposure")?;
        Ok(exposed)
    }

    /// Makes the result of what the network gave: with the exposure of the frame, and mixed with it by the strength.
    fn finish(&self, made: &mut [f32], noisy: &[f32], settings: &Settings) {
        let strength = settings.strength as f32;
        for (value, noisy) in made.iter_mut().zip(noisy) {
            let mut denoised = (f64::from(*value) / self.exposure) as f32;
            // A lamp that is as bright as all around it keeps its brightness.
            if noisy.abs() > self.bound && denoised > 0.25 * self.bound {
                denoised = *noisy;
            }
            *value = if strength < 1.0 { noisy + strength * (denoised - noisy) } else { denoised };
        }
    }

    fn denoised(&self, image: Image, with_gbuffer: bool, kept: Option<f64>) -> Result<Denoised, KindError> {
        image.finite("denoised image", "set another exposure")?;
        if self.keeps_light && image.data().iter().all(|value| *value == 0.0) {
            let exposure = self.exposure;
            let what = format!("an exposure of {exposure:e} makes the denoised image black; set another exposure");
            return Err(KindError::Input(what));
        }
        Ok(Denoised { image, exposure: self.exposure, with_gbuffer, kept })
    }
}

/// Rows of an image that were kept.
struct Rows {
    /// Where in the image the first of them was.
    first: usize,
    rows: Image,
}

impl Rows {
    /// A part of the image of which these rows were kept; all rows below them are still there.
    fn part_with(&self, image: &Image, [left, top, right, bottom]: [usize; 4]) -> Image {
        let end = self.first + self.rows.height();
        let split = end.clamp(top, bottom);
        let mut data = Vec::with_capacity(3 * (right - left) * (bottom - top));
        if split > top {
            data.extend_from_slice(part(&self.rows, [left, top - self.first, right, split - self.first]).data());
        }
        data.extend_from_slice(part(image, [left, split, right, bottom]).data());
        Image::from_data(right - left, bottom - top, 3, data).expect("rows of one width")
    }
}

/// An image has a black background if a larger share of its blocks of pixels is black.
const BLACK: f64 = 0.01;

/// The exposure of an image with a black background. Brighter than others, it spreads less of an object over the
/// background; more than this is no better.
const KEY_BEFORE_BLACK: f64 = 4.0 * KEY;

/// Largest side of tiles.
const MOST_TILE: usize = 16384;

/// How many times brighter than the median pixel a value that the network is shown may be.
const BRIGHTEST: f32 = 1e6;

/// How many times brighter than the brightest pixels but for a twentieth: if many are dark, the median is no measure.
const BRIGHTER: f32 = 1e3;

/// Pixels are nearly black below this share of the brightest but for a fiftieth.
const DARK: f32 = 1e-6;

/// Pixels that tell the brightness of all.
const TOLD: usize = 1 << 16;

/// The largest value that the network is shown, before exposure.
fn bound(image: &Image) -> f32 {
    let count = image.data().len() / 3;
    // Multiples of the golden ratio are spread over the image, whatever its width.
    let fraction = |i: usize| u128::from((i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let spread = |i: usize| ((fraction(i) * count as u128) >> 64) as usize;
    let pixels: &mut dyn Iterator<Item = usize> =
        if count <= TOLD { &mut (0..count) } else { &mut (0..TOLD).map(spread) };
    // The brightest colour: light may have one alone.
    let brightest = pixels.map(|at| image.data()[3 * at..3 * at + 3].iter().fold(0.0f32, |most, v| most.max(*v)));
    let mut values: Vec<f32> = brightest.filter(|value| *value > 0.0).collect();
    if values.is_empty() {
        return f32::MAX;
    }
    values.sort_unstable_by(f32::total_cmp);
    // Nearly black pixels do not count: half precision stores tiny numbers in place of 0.
    let dark = values[(values.len() - 1) * 49 / 50] * DARK;
    values.drain(..values.partition_point(|value| *value < dark));
    let (median, most) = (values[values.len() / 2], values[(values.len() - 1) * 19 / 20]);
    (median * BRIGHTEST).max(most * BRIGHTER).min(f32::MAX)
}

/// The image with its last row and column repeated up to a multiple of so many pixels.
fn padded(image: Image, multiple: usize) -> Image {
    let (width, height) = (image.width().next_multiple_of(multiple), image.height().next_multiple_of(multiple));
    if (width, height) == (image.width(), image.height()) {
        return image;
    }
    let mut data = Vec::with_capacity(width * height * image.channels());
    for y in 0..height {
        for x in 0..width {
            data.extend_from_slice(image.pixel(x.min(image.width() - 1), y.min(image.height() - 1)));
        }
    }
    Image::from_data(width, height, image.channels(), data).expect("as many values as pixels")
}

/// The clean estimate of a part of an exposed image.
fn estimate(model: &Model, image: &Image, gbuffer: Option<&Image>, settings: &Settings) -> Result<Image, KindError> {
    let info = model.info();
    let viewed = Mirrored::new(model, settings.views);
    let spp = settings.spp.filter(|spp| (info.n_min()..info.n_max()).contains(spp));
    clean_estimate(&viewed, image, gbuffer, spp)
}

#[cfg(test)]
mod tests;
