//! What is denoised: checked, with damaged pixels mended.

use crate::tiles::part;
use std::borrow::Cow;
use tauflow_contract::KindError;
use tauflow_data::Image;

/// The G-buffer as it was given: a large image is not copied.
#[derive(Clone, Debug)]
pub(crate) enum Features {
    /// [H, W, 6].
    Together(Image),
    /// Albedo and normal, [H, W, 3] each.
    Apart(Image, Image),
}

impl Features {
    /// A part of them, [H, W, 6].
    pub(crate) fn part(&self, rectangle: [usize; 4]) -> Image {
        match self {
            Self::Together(gbuffer) => part(gbuffer, rectangle),
            Self::Apart(albedo, normal) => beside(&part(albedo, rectangle), &part(normal, rectangle)),
        }
    }

    /// All of them, [H, W, 6].
    pub(crate) fn whole(&self) -> Cow<'_, Image> {
        match self {
            Self::Together(gbuffer) => Cow::Borrowed(gbuffer),
            Self::Apart(albedo, normal) => Cow::Owned(beside(albedo, normal)),
        }
    }
}

fn beside(albedo: &Image, normal: &Image) -> Image {
    albedo.beside(normal).expect("images of one size")
}

/// Images of one frame, all of one size.
#[derive(Clone, Debug)]
pub struct Frame {
    radiance: Image,
    features: Option<Features>,
    variance: Option<(Image, Option<u64>)>,
    notes: Vec<String>,
}

impl Frame {
    /// A frame of linear radiance [H, W, 3] at any exposure. Pixels that are not finite are replaced by the mean of
    /// those around them, which the notes say. They also count negative values, and those that half precision cut.
    ///
    /// # Errors
    /// If the image has not three channels, or no pixel is finite.
    pub fn new(radiance: Image) -> Result<Self, KindError> {
        shape(&radiance, "radiance", 3, None)?;
        if radiance.data().is_empty() {
            return Err(KindError::Input("the image has no pixels; render it again".into()));
        }
        let mut notes = Vec::new();
        let radiance = mended(radiance, "radiance", &mut notes)?;
        let mut count = |what: &str, odd: &dyn Fn(f32) -> bool| {
            let count = radiance.data().iter().filter(|value| odd(**value)).count();
            notes.extend((count > 0).then(|| format!("{count} values {what}")));
        };
        count("are 65504, the most that half precision holds: they may be cut", &|value| value == HALF);
        count("are negative; they are denoised as they are", &|value| value < 0.0);
        Ok(Self { radiance, features: None, variance: None, notes })
    }

    /// With albedo and normal [H, W, 6]: normals are in camera space (right, up, towards the camera) and have length 1,
    /// or 0 where nothing was hit. The notes say whether values are out of range.
    ///
    /// # Errors
    /// If it has another size or number of channels, or no pixel is finite.
    pub fn with_gbuffer(mut self, gbuffer: Image) -> Result<Self, KindError> {
        shape(&gbuffer, "the G-buffer", 6, Some(&self.radiance))?;
        let mut gbuffer = gbuffer;
        if gbuffer.data().iter().any(|value| !value.is_finite()) {
            let [albedo, normal] = [0, 3].map(|first| {
                let values = gbuffer.data().chunks_exact(6).flat_map(|pixel| &pixel[first..first + 3]);
                Image::from_data(gbuffer.width(), gbuffer.height(), 3, values.copied().collect()).expect("half of them")
            });
            gbuffer = beside(&mended_albedo(albedo, &mut self.notes)?, &mended_normals(normal, &mut self.notes));
        }
        let pixels = || gbuffer.data().chunks_exact(6);
        odd_features(pixels().map(|pixel| &pixel[..3]), pixels().map(|pixel| &pixel[3..]), &mut self.notes);
        close_black_background(&self.radiance, gbuffer.data_mut(), 6);
        self.features = Some(Features::Together(gbuffer));
        Ok(self)
    }

    /// With albedo and normal apart, [H, W, 3] each; otherwise as [`Frame::with_gbuffer`], but without a copy of them.
    ///
    /// # Errors
    /// As [`Frame::with_gbuffer`].
    pub fn with_features(mut self, albedo: Image, mut normal: Image) -> Result<Self, KindError> {
        shape(&albedo, "the albedo", 3, Some(&self.radiance))?;
        shape(&normal, "the normal", 3, Some(&self.radiance))?;
        let albedo = mended_albedo(albedo, &mut self.notes)?;
        normal = mended_normals(normal, &mut self.notes);
        odd_features(albedo.data().chunks_exact(3), normal.data().chunks_exact(3), &mut self.notes);
        close_black_background(&self.radiance, normal.data_mut(), 3);
        self.features = Some(Features::Apart(albedo, normal));
        Ok(self)
    }

    /// With the variance of each pixel's value [H, W, 3], in squares of the radiance's unit: that of one sample divided
    /// by the number of samples. `samples` says from how many it was estimated, if that is known: the fewer, the more
    /// evidence a mix needs.
    ///
    /// # Errors
    /// If it has another size or number of channels, a value is negative, or no pixel is finite.
    pub fn with_variance(mut self, variance: Image, samples: Option<u64>) -> Result<Self, KindError> {
        shape(&variance, "the variance", 3, Some(&self.radiance))?;
        if let Some(value) = variance.data().iter().find(|value| **value < 0.0) {
            return Err(KindError::Input(format!("the variance has a value of {value}; variances are at least 0")));
        }
        self.variance = Some((mended(variance, "the variance", &mut self.notes)?, samples));
        Ok(self)
    }

    /// Linear radiance [H, W, 3], finite.
    pub fn radiance(&self) -> &Image {
        &self.radiance
    }

    /// Albedo and normal, finite.
    pub(crate) fn features(&self) -> Option<&Features> {
        self.features.as_ref()
    }

    /// Variance of each value of the radiance [H, W, 3], finite and not negative, and from how many samples it is.
    pub(crate) fn variance(&self) -> Option<(&Image, Option<u64>)> {
        self.variance.as_ref().map(|(variance, samples)| (variance, *samples))
    }

    /// The radiance, and albedo and normal.
    pub(crate) fn into_parts(self) -> (Image, Option<Features>) {
        (self.radiance, self.features)
    }

    /// Notes for people on pixels that were replaced and on odd values.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }
}

/// Turns a background without any light into a black surface that faces the camera.
///
/// The models count pixels without a surface as white, for the sky. In front of a black background, edges of objects
/// would be too bright. The last three values of each pixel of `features`, of `channels` values, are the normal.
fn close_black_background(radiance: &Image, features: &mut [f32], channels: usize) {
    let open = |pixel: &[f32]| pixel[channels - 3..].iter().all(|value| *value == 0.0);
    let dark = |pixel: &[f32]| pixel.iter().all(|value| *value == 0.0);
    let lit = radiance.data().chunks_exact(3).zip(features.chunks_exact(channels));
    let mut background = lit.filter(|(_, features)| open(features)).map(|(radiance, _)| dark(radiance)).peekable();
    if background.peek().is_none() || !background.all(|dark| dark) {
        return;
    }
    for pixel in features.chunks_exact_mut(channels) {
        let length = pixel[channels - 3..].iter().map(|n| n * n).sum::<f32>().min(1.0).sqrt();
        pixel[channels - 1] += 1.0 - length;
    }
}

fn shape(image: &Image, what: &str, channels: usize, of: Option<&Image>) -> Result<(), KindError> {
    if image.channels() != channels {
        let found = image.channels();
        return Err(KindError::Input(format!("{what} has {found} values per pixel; it needs {channels}")));
    }
    match of {
        Some(of) if (of.width(), of.height()) != (image.width(), image.height()) => Err(KindError::Input(format!(
            "{what} has {} x {} pixels, but the radiance has {} x {}; render both at the same size",
            image.width(),
            image.height(),
            of.width(),
            of.height()
        ))),
        _ => Ok(()),
    }
}

/// The largest value of half precision: renderers write it for all that is brighter.
const HALF: f32 = 65504.0;

/// How far beyond its range an albedo or the length of a normal may be: filters and compression do so much.
const SLACK: f32 = 0.01;

/// Tells of an albedo beyond 0 to 1, and of normals longer than 1.
fn odd_features<'a>(
    albedo: impl Iterator<Item = &'a [f32]>,
    normals: impl Iterator<Item = &'a [f32]>,
    notes: &mut Vec<String>,
) {
    let (mut of, mut outside, mut long) = (0, 0, 0);
    for value in albedo.flatten() {
        of += 1;
        outside += usize::from(!(-SLACK..=1.0 + SLACK).contains(value));
    }
    if outside > 0 {
        notes.push(format!("{outside} of {of} values of the albedo are not from 0 to 1; check the albedo"));
    }
    let longest = (1.0 + SLACK) * (1.0 + SLACK);
    normals.for_each(|normal| long += usize::from(normal.iter().map(|v| v * v).sum::<f32>() > longest));
    if long > 0 {
        notes.push(format!("{long} of {} normals are longer than 1; they must be unit vectors", of / 3));
    }
}

/// How far the finite pixels are looked for that replace another, before the mean of all takes its place.
const FARTHEST: usize = 8;

fn mended_albedo(albedo: Image, notes: &mut Vec<String>) -> Result<Image, KindError> {
    mended(albedo, "the albedo", notes)
}

/// Normals of which those that are not finite are replaced, which `notes` say: as in a [`Frame`], for those who convert
/// normals before. Single ones become the mean of those around them. Where most around them are not finite, either,
/// nothing was hit: some renderers normalise normals of length 0.
pub fn mended_normals(mut normal: Image, notes: &mut Vec<String>) -> Image {
    let (width, height) = (normal.width(), normal.height());
    let finite: Vec<bool> = normal.data().chunks_exact(3).map(|pixel| pixel.iter().all(|v| v.is_finite())).collect();
    let mut replaced = Vec::new();
    for at in (0..finite.len()).filter(|at| !finite[*at]) {
        let (x, y) = (at % width, at / width);
        let rows = y.saturating_sub(1)..=(y + 1).min(height - 1);
        let columns = x.saturating_sub(1)..=(x + 1).min(width - 1);
        let around: Vec<usize> =
            rows.flat_map(|y| columns.clone().map(move |x| y * width + x)).filter(|other| *other != at).collect();
        let whole: Vec<usize> = around.iter().copied().filter(|other| finite[*other]).collect();
        let mean = |c: usize| whole.iter().map(|other| normal.data()[3 * other + c]).sum::<f32>() / whole.len() as f32;
        replaced.push((at, if 2 * whole.len() > around.len() { [0, 1, 2].map(mean) } else { [0.0; 3] }));
    }
    if !replaced.is_empty() {
        notes.push(format!(
            "{} of {} pixels of the normals are not finite; single ones are replaced by the mean of those around them, \
             and others count as no surface",
            replaced.len(),
            finite.len()
        ));
    }
    for (at, value) in replaced {
        normal.data_mut()[3 * at..3 * at + 3].copy_from_slice(&value);
    }
    normal
}

/// The image with pixels that are not finite replaced by the mean of the nearest finite ones.
fn mended(image: Image, what: &str, notes: &mut Vec<String>) -> Result<Image, KindError> {
    let (width, height, channels) = (image.width(), image.height(), image.channels());
    let finite: Vec<bool> =
        image.data().chunks_exact(channels).map(|pixel| pixel.iter().all(|v| v.is_finite())).collect();
    let damaged = finite.iter().filter(|finite| !**finite).count();
    if damaged == 0 {
        return Ok(image);
    }
    if damaged == finite.len() {
        return Err(KindError::Input(format!("{what} has no finite pixel; look at what made the image")));
    }
    let mean_of = |pixels: &mut dyn Iterator<Item = usize>| -> Option<Vec<f32>> {
        let (mut sum, mut count) = (vec![0.0f64; channels], 0usize);
        for at in pixels.filter(|at| finite[*at]) {
            let pixel = &image.data()[at * channels..(at + 1) * channels];
            sum.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += f64::from(*value));
            count += 1;
        }
        (count > 0).then(|| sum.into_iter().map(|sum| (sum / count as f64) as f32).collect())
    };
    let whole = mean_of(&mut (0..finite.len())).unwrap_or_else(|| vec![0.0; channels]);
    let mut out = image.clone();
    for at in (0..finite.len()).filter(|at| !finite[*at]) {
        let (x, y) = (at % width, at / width);
        let ring = |reach: usize| {
            let rows = y.saturating_sub(reach)..=(y + reach).min(height - 1);
            let columns = x.saturating_sub(reach)..=(x + reach).min(width - 1);
            mean_of(&mut rows.flat_map(|y| columns.clone().map(move |x| y * width + x)))
        };
        let value = (1..=FARTHEST).find_map(ring).unwrap_or_else(|| whole.clone());
        out.data_mut()[at * channels..(at + 1) * channels].copy_from_slice(&value);
    }
    notes.push(format!(
        "{damaged} of {} pixels of {what} are not finite; they are replaced by the mean of those around them",
        finite.len()
    ));
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(channels: usize, value: f32) -> Image {
        Image::from_data(4, 3, channels, vec![value; 12 * channels]).expect("fits")
    }

    #[test]
    fn values_out_of_range_are_told() {
        let notes = |albedo: f32, normal: f32| {
            let (albedo, mut normals) = (image(3, albedo), image(3, 0.0));
            normals.data_mut().iter_mut().step_by(3).for_each(|value| *value = normal);
            let frame = || Frame::new(image(3, 1.0)).expect("finite");
            let together = frame().with_gbuffer(beside(&albedo, &normals)).expect("fits").notes().to_vec();
            assert_eq!(frame().with_features(albedo, normals).expect("fits").notes(), together);
            together.join("; ")
        };
        for (albedo, normal) in [(0.0, 1.0), (1.005, -1.005), (-0.005, 0.0)] {
            assert_eq!(notes(albedo, normal), "");
        }
        for albedo in [1.02, -0.02] {
            assert_eq!(notes(albedo, 1.0), "36 of 36 values of the albedo are not from 0 to 1; check the albedo");
        }
        assert_eq!(notes(0.5, -1.02), "12 of 12 normals are longer than 1; they must be unit vectors");
        // A pixel that is replaced counts once.
        let mut radiance = image(3, 1.0);
        radiance.pixel_mut(3, 2)[1] = f32::NEG_INFINITY;
        assert_eq!(Frame::new(radiance.clone()).expect("others are finite").notes().len(), 1);
        radiance.pixel_mut(0, 0).copy_from_slice(&[-1.0, HALF, 0.0]);
        let frame = Frame::new(radiance).expect("others are finite");
        assert!(frame.notes()[1].starts_with("1 values are 65504"), "{:?}", frame.notes());
        assert!(frame.notes()[2].starts_with("1 values are negative"), "{:?}", frame.notes());
    }

    #[test]
    fn damaged_pixels_are_replaced_by_their_neighbours_and_told() {
        let mut damaged = image(3, 1.0);
        damaged.pixel_mut(3, 2)[1] = f32::NAN;
        damaged.pixel_mut(2, 2).copy_from_slice(&[3.0, 4.0, 5.0]);
        damaged.pixel_mut(0, 0)[0] = f32::INFINITY;
        let frame = Frame::new(damaged.clone()).expect("others are finite");
        assert_eq!(frame.radiance().pixel(0, 0), [1.0, 1.0, 1.0]);
        let around = [3.0, 4.0, 5.0].map(|value: f32| (1.0 + 1.0 + value) / 3.0);
        assert!(frame.radiance().pixel(3, 2).iter().zip(around).all(|(found, value)| (found - value).abs() < 1e-6));
        assert_eq!(frame.radiance().pixel(1, 1), damaged.pixel(1, 1));
        assert!(frame.notes()[0].starts_with("2 of 12 pixels of radiance"), "{:?}", frame.notes());
        assert!(Frame::new(image(3, f32::NAN)).expect_err("none is").to_string().contains("no finite pixel"));
    }

    #[test]
    fn damage_of_an_albedo_leaves_the_normal_and_the_reverse() {
        let (mut albedo, mut normal) = (image(3, 0.5), image(3, 0.0));
        normal.data_mut().iter_mut().skip(2).step_by(3).for_each(|value| *value = 1.0);
        normal.pixel_mut(0, 0).copy_from_slice(&[1.0, 0.0, 0.0]);
        albedo.pixel_mut(0, 0)[0] = f32::NAN;
        normal.pixel_mut(3, 2)[1] = f32::INFINITY;
        albedo.pixel_mut(3, 2)[1] = 0.25;
        let frame = || Frame::new(image(3, 1.0)).expect("finite");
        let apart = frame().with_features(albedo.clone(), normal.clone()).expect("others are finite");
        let together = frame().with_gbuffer(beside(&albedo, &normal)).expect("others are finite");
        assert_eq!(apart.notes(), together.notes());
        assert!(apart.notes()[0].starts_with("1 of 12 pixels of the albedo"), "{:?}", apart.notes());
        assert!(apart.notes()[1].starts_with("1 of 12 pixels of the normals"), "{:?}", apart.notes());
        let [apart, together] = [apart, together].map(|frame| frame.features().expect("given").whole().into_owned());
        assert_eq!(apart, together);
        assert_eq!(apart.pixel(0, 0), [0.5, 0.5, 0.5, 1.0, 0.0, 0.0]);
        assert_eq!(apart.pixel(3, 2), [0.5, 0.25, 0.5, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn regions_without_finite_normals_are_no_surface() {
        // Two rows of three have none; a single pixel of the others has none.
        let mut normal = image(3, 0.0);
        normal.data_mut().iter_mut().skip(2).step_by(3).for_each(|value| *value = 1.0);
        (0..8).for_each(|at| normal.pixel_mut(at % 4, at / 4)[0] = f32::NAN);
        let mut notes = Vec::new();
        let mended = mended_normals(normal.clone(), &mut notes);
        assert!((0..4).all(|x| mended.pixel(x, 0) == [0.0; 3] && mended.pixel(x, 2) == [0.0, 0.0, 1.0]));
        assert!(notes[0].starts_with("8 of 12 pixels of the normals"), "{notes:?}");
        let none = Frame::new(image(3, 1.0)).expect("finite");
        let none = none.with_features(image(3, 0.5), image(3, f32::NAN)).expect("no surface anywhere");
        assert!(none.features().expect("given").whole().data().chunks_exact(6).all(|pixel| pixel[3..] == [0.0; 3]));
    }

    #[test]
    fn a_black_background_is_a_surface_and_a_sky_is_none() {
        // A background, a pixel that is half of it, and a surface.
        let mut normal = image(3, 0.0);
        normal.pixel_mut(1, 0)[0] = 0.5;
        normal.pixel_mut(2, 0)[1] = 1.0;
        let mut radiance = image(3, 0.0);
        radiance.pixel_mut(2, 0).fill(1.0);
        let normals = |radiance: &Image| {
            let frame = Frame::new(radiance.clone()).expect("finite");
            let apart = frame.clone().with_features(image(3, 0.0), normal.clone()).expect("fits");
            let together = frame.with_gbuffer(image(3, 0.0).beside(&normal).expect("fits")).expect("fits");
            let [apart, together] =
                [apart, together].map(|frame| frame.features().expect("given").whole().into_owned());
            assert_eq!(apart, together);
            [0, 1, 2].map(|x| apart.pixel(x, 0)[3..].to_vec())
        };
        assert_eq!(normals(&radiance), [[0.0, 0.0, 1.0], [0.5, 0.0, 0.5], [0.0, 1.0, 0.0]]);
        radiance.pixel_mut(3, 2)[0] = 0.1;
        assert_eq!(normals(&radiance), [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let frame = || Frame::new(image(3, 1.0)).expect("fine");
        assert!(frame().with_gbuffer(image(6, 0.5)).expect("fits").notes().is_empty());
        let wrong = |result: Result<Frame, KindError>, part: &str| {
            let error = result.expect_err("does not fit").to_string();
            assert!(error.contains(part), "{error}");
        };
        wrong(Frame::new(image(4, 1.0)), "4 values per pixel; it needs 3");
        wrong(Frame::new(Image::new(0, 0, 3)), "no pixels");
        wrong(frame().with_gbuffer(image(3, 1.0)), "3 values per pixel; it needs 6");
        wrong(frame().with_gbuffer(Image::new(3, 3, 6)), "3 x 3 pixels, but the radiance has 4 x 3");
        wrong(frame().with_features(Image::new(3, 3, 3), image(3, 1.0)), "the albedo has 3 x 3 pixels");
        wrong(frame().with_features(image(3, 1.0), image(1, 1.0)), "the normal has 1 values");
        wrong(frame().with_variance(image(3, -1.0), None), "at least 0");
        wrong(frame().with_variance(Image::new(4, 4, 3), None), "4 x 4 pixels");
    }
}
