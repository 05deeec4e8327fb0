//! The two ends of the network that are not learned: what the last layer's numbers mean, and the loss.
//!
//! The numbers are weights: of what lies around each pixel of the state, divided by albedo where there is one, at
//! several scales. The weighted mean, times the albedo, is the network's estimate of what more samples would give; the
//! answer is that less the state, times what the law says of how far the target is from it. A firefly of a thousand
//! therefore needs no output of a thousand, texture is preserved, and the network does not learn known scales. Albedo
//! of few samples is noisy at edges, so that the mean can be multiplied by a weighted mean of albedo instead.

use burn::tensor::Tensor;
use rayon::prelude::*;
use std::{ops::Range, sync::Arc};
use tauflow_data::maths;
use tauflow_ops::{GuidedMean, Guides, LOCAL_MODELS, Operator, Pyramid, WeightedMean, exp, expm1, log1p, map2};
use tauflow_tensors::{apply, layers::unfold};

/// Output of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Output {
    /// Weights of what lies around a pixel; the law makes predictions of their mean.
    #[default]
    Means,
    /// The same, and a factor between 1/4 and 4 for each colour of the mean: light falls on a pixel otherwise than
    /// around it.
    ShadedMeans,
    /// The same, and weights that change with how much albedo and normals differ from the pixel's own, as fast as the
    /// network says. Needs G-buffers.
    GuidedMeans,
    /// The same, and weights of the albedo around a pixel: the mean is multiplied by the weighted mean of albedo, as
    /// that of the pixel itself is noisy. Needs G-buffers.
    SmoothedMeans,
    /// The same, and weights of local linear models of the light in normals and albedo: they have the light and shadow
    /// of joints and bumps, which averaging blurs. Needs G-buffers.
    FittedMeans,
    /// Predictions, with nothing known put in: for studies of what the law is worth.
    Values,
}

impl Output {
    /// All of them.
    #[cfg(test)]
    pub(crate) const ALL: [Self; 6] =
        [Self::Means, Self::ShadedMeans, Self::GuidedMeans, Self::SmoothedMeans, Self::FittedMeans, Self::Values];

    /// The value of older files, which lack this field, independent of the current default.
    pub(crate) fn unsaid() -> Self {
        Self::Means
    }

    /// Its name in pipelines.
    pub fn name(self) -> &'static str {
        match self {
            Self::Means => "means",
            Self::ShadedMeans => "shaded_means",
            Self::GuidedMeans => "guided_means",
            Self::SmoothedMeans => "smoothed_means",
            Self::FittedMeans => "fitted_means",
            Self::Values => "values",
        }
    }

    /// True of what files say nothing of.
    pub(crate) fn is_unsaid(&self) -> bool {
        *self == Self::unsaid()
    }

    /// Whether the mean is multiplied by shades.
    pub(crate) fn is_shaded(self) -> bool {
        matches!(self, Self::ShadedMeans) || self.is_guided()
    }

    /// Whether G-buffers guide the weights, so that there must be some.
    pub(crate) fn is_guided(self) -> bool {
        matches!(self, Self::GuidedMeans) || self.is_smoothed()
    }

    /// Whether albedo is smoothed.
    pub(crate) fn is_smoothed(self) -> bool {
        matches!(self, Self::SmoothedMeans) || self.is_fitted()
    }

    /// Whether local models of the light take part.
    pub(crate) fn is_fitted(self) -> bool {
        matches!(self, Self::FittedMeans)
    }

    /// Numbers of the last layer for a pixel, of windows of weights with these sides.
    pub(crate) fn numbers(self, sides: &[usize]) -> usize {
        match self {
            Self::Values => 3,
            _ => sides.iter().map(|side| side * side).sum(),
        }
    }
}

/// Pixels that a thread does at least.
const PIXELS: usize = 1024;

/// The data that turn weights into a prediction.
#[derive(Clone, Debug)]
pub(crate) struct Head {
    /// Of the state as linear radiance, divided by albedo where there is one.
    pub(crate) light: Arc<Pyramid>,
    /// Albedo and normals at the same scales, if weights are guided.
    pub(crate) guides: Option<Arc<Guides>>,
    /// Local models of the light, if they take part.
    pub(crate) fits: Option<Blend>,
    /// Whether the mean is multiplied by shades.
    pub(crate) shaded: bool,
    /// Albedo at full resolution, if it is smoothed; the answer then has none.
    pub(crate) albedo: Option<Arc<Pyramid>>,
    /// The processing of the weighted mean.
    pub(crate) answer: Answer,
}

/// Side of the window in which albedo is smoothed.
pub(crate) const SMOOTHED: usize = 5;

/// Added to the number of the pixel itself where albedo is smoothed: at first it has nearly all of the weight.
const ITSELF: f32 = 6.0;

/// A last layer. Its output is folded: [N, H/2, W/2, 4 C].
#[derive(Clone, Copy, Debug)]
pub(crate) enum LastLayer {
    /// As many for a pixel as there are weights.
    Numbers,
    /// One for a pixel, level and guide.
    Strengths,
    /// One for a pixel and local model.
    Blend,
    /// Three for a pixel.
    Shades,
    /// [`SMOOTHED`] squared for a pixel.
    Smooths,
}

impl Head {
    /// The prediction [N, H, W, 3] of small images of [N, H/2, W/2]. `layer` computes these rows of a last layer: one
    /// layer after the other, and large ones part by part, so that not all outputs need memory at once.
    pub(crate) fn expand(
        self,
        [images, rows, columns]: [usize; 3],
        parts: &[Range<usize>],
        layer: impl Fn(LastLayer, Range<usize>) -> Tensor<4>,
    ) -> Tensor<4> {
        let shape = [images, 2 * rows, 2 * columns, 3];
        let shape_of = |part: &Range<usize>| [images, 2 * part.len(), 2 * columns, 3];
        let pyramid = self.light;
        let mean_of = |part: &Range<usize>| {
            let (pyramid, first) = (pyramid.clone(), 2 * part.start);
            let numbers = layer(LastLayer::Numbers, part.clone());
            assert_eq!(numbers.dims()[3], 4 * pyramid.weights(), "a number for each place of the windows");
            match self.guides.clone() {
                Some(guides) => {
                    let strengths = layer(LastLayer::Strengths, part.clone());
                    let mean = GuidedMean { pyramid, guides, first };
                    apply(mean, [numbers.into(), strengths.into()], shape_of(part))
                }
                None => apply(WeightedMean { pyramid, own: 0.0, first }, [numbers.into()], shape_of(part)),
            }
        };
        let mut mean = joined(parts.iter().map(mean_of).collect());
        if let Some(blend) = self.fits {
            mean = apply(blend, [mean.into(), unfold(layer(LastLayer::Blend, 0..rows)).into()], shape);
        }
        if self.shaded {
            mean = apply(Shade, [mean.into(), unfold(layer(LastLayer::Shades, 0..rows)).into()], shape);
        }
        if let Some(pyramid) = self.albedo {
            let mean_of = |part: &Range<usize>| {
                let smooths = layer(LastLayer::Smooths, part.clone());
                let albedo = WeightedMean { pyramid: pyramid.clone(), own: ITSELF, first: 2 * part.start };
                apply(albedo, [smooths.into()], shape_of(part))
            };
            mean = mean * joined(parts.iter().map(mean_of).collect());
        }
        apply(self.answer, [mean.into()], shape)
    }
}

/// Parts of images, one below the other.
fn joined(mut parts: Vec<Tensor<4>>) -> Tensor<4> {
    if parts.len() == 1 { parts.swap_remove(0) } else { Tensor::cat(parts, 1) }
}

/// mean times a factor of the shade: 1 for 0, from 1/[`BRIGHTEST`] to [`BRIGHTEST`].
#[derive(Clone, Debug)]
pub(super) struct Shade;

/// The largest factor of a shade, so that no mistake makes a firefly.
pub(super) const BRIGHTEST: f32 = 4.0;

impl Shade {
    /// (1 + b e^s)/(b + e^s), which is 1 over itself for -s.
    #[inline(always)]
    fn factor(shade: f32) -> f32 {
        let power = exp(shade);
        (1.0 + BRIGHTEST * power) / (BRIGHTEST + power)
    }

    /// The slope of the factor. Nothing is squared that could be too large.
    #[inline(always)]
    fn slope(shade: f32) -> f32 {
        let power = exp(shade);
        (BRIGHTEST * BRIGHTEST - 1.0) * (power / (BRIGHTEST + power)) / (BRIGHTEST + power)
    }
}

impl Operator<2> for Shade {
    type Saved = ();

    fn forward(&self, [mean, shade]: [&[f32]; 2]) -> (Vec<f32>, ()) {
        (map2(mean, shade, |mean, shade| mean * Self::factor(shade)), ())
    }

    fn backward(&self, [mean, shade]: [&[f32]; 2], (): &(), gradient: &[f32], _: [bool; 2]) -> [Vec<f32>; 2] {
        let of_mean = map2(gradient, shade, |gradient, shade| gradient * Self::factor(shade));
        let slopes = map2(mean, shade, |mean, shade| mean * Self::slope(shade));
        [of_mean, map2(gradient, &slopes, |gradient, slope| gradient * slope)]
    }
}

/// The mean of a mean and of the local models of the light, with weights of a softmax: [`OWN`] for the mean, and one
/// number for each model.
#[derive(Clone, Debug)]
pub(crate) struct Blend {
    /// [N, H, W, models, 3].
    pub(crate) fits: Arc<Vec<f32>>,
}

/// The number of the mean: at first it has nearly all of the weight.
pub(super) const OWN: f32 = 4.0;

impl Blend {
    /// The weight of the mean, and those of the models.
    #[inline(always)]
    fn shares(numbers: &[f32; LOCAL_MODELS]) -> (f32, [f32; LOCAL_MODELS]) {
        let most = numbers.iter().fold(OWN, |most, number| most.max(*number));
        let (own, powers) = (exp(OWN - most), numbers.map(|number| exp(number - most)));
        let sum = powers.iter().fold(own, |sum, power| sum + power);
        (own / sum, powers.map(|power| power / sum))
    }
}

impl Operator<2> for Blend {
    type Saved = ();

    fn forward(&self, [mean, numbers]: [&[f32]; 2]) -> (Vec<f32>, ()) {
        let mut out = mean.to_vec();
        let fits = self.fits.as_chunks::<{ 3 * LOCAL_MODELS }>().0;
        let pixels = out.as_chunks_mut::<3>().0.par_iter_mut().zip(fits).zip(numbers.as_chunks::<LOCAL_MODELS>().0);
        pixels.with_min_len(PIXELS).for_each(|((out, fits), numbers)| {
            let (own, shares) = Self::shares(numbers);
            out.iter_mut().for_each(|out| *out *= own);
            for (share, fit) in shares.iter().zip(fits.as_chunks::<3>().0) {
                (0..3).for_each(|c| out[c] += share * fit[c]);
            }
        });
        (out, ())
    }

    fn backward(&self, [mean, numbers]: [&[f32]; 2], (): &(), gradient: &[f32], _: [bool; 2]) -> [Vec<f32>; 2] {
        let (mut of_mean, mut of_numbers) = (gradient.to_vec(), vec![0.0; numbers.len()]);
        let fits = self.fits.as_chunks::<{ 3 * LOCAL_MODELS }>().0;
        let told = mean.as_chunks::<3>().0.par_iter().zip(fits).zip(numbers.as_chunks::<LOCAL_MODELS>().0);
        let found = of_mean.as_chunks_mut::<3>().0.par_iter_mut().zip(of_numbers.as_chunks_mut::<LOCAL_MODELS>().0);
        found.zip(told).with_min_len(PIXELS).for_each(|((of_mean, of_numbers), ((mean, fits), numbers))| {
            let ((own, shares), gradient) = (Self::shares(numbers), *of_mean);
            // How far each model is off the mean along the gradient, and how far their blend is.
            let mut along = [0.0; LOCAL_MODELS];
            for (along, fit) in along.iter_mut().zip(fits.as_chunks::<3>().0) {
                *along = (0..3).map(|c| gradient[c] * (fit[c] - mean[c])).sum();
            }
            let whole = shares.iter().zip(&along).map(|(share, along)| share * along).sum::<f32>();
            for (of_number, (share, along)) in of_numbers.iter_mut().zip(shares.iter().zip(&along)) {
                *of_number = share * (along - whole);
            }
            of_mean.iter_mut().for_each(|of_mean| *of_mean *= own);
        });
        [of_mean, of_numbers]
    }
}

/// f = gain (encode(albedo mean) - state).
#[derive(Clone, Debug)]
pub(crate) struct Answer {
    /// [N, H, W, 3]; none for 1 everywhere.
    pub(crate) albedo: Option<Arc<Vec<f32>>>,
    /// [N, H, W, 3], in the training space.
    pub(crate) state: Arc<Vec<f32>>,
    /// One for each image.
    pub(crate) gain: Arc<Vec<f32>>,
    /// The training space is that of logarithms.
    pub(crate) log: bool,
}

impl Answer {
    /// Values of an image.
    fn size(&self) -> usize {
        self.state.len() / self.gain.len().max(1)
    }

    /// Fills `out` from what `f(index, gain, albedo)` gives.
    fn fill(&self, len: usize, f: impl Fn(usize, f32, f32) -> f32 + Sync) -> Vec<f32> {
        assert_eq!(len, self.state.len(), "a mean for each value of the state");
        let mut out = vec![0.0; len];
        let size = self.size();
        out.par_chunks_mut(3 * PIXELS).enumerate().for_each(|(part, out)| {
            for (i, out) in (part * 3 * PIXELS..).zip(out) {
                *out = f(i, self.gain[i / size], self.albedo.as_ref().map_or(1.0, |albedo| albedo[i]));
            }
        });
        out
    }
}

impl Operator<1> for Answer {
    type Saved = ();

    fn forward(&self, [mean]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        let encode = |value: f32| if self.log { crate::space::signed_log1p(value) } else { value };
        (self.fill(mean.len(), |i, gain, albedo| gain * (encode(albedo * mean[i]) - self.state[i])), ())
    }

    fn backward(&self, [mean]: [&[f32]; 1], (): &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        let slope = |value: f32| if self.log { 1.0 / (1.0 + value.abs()) } else { 1.0 };
        [self.fill(mean.len(), |i, gain, albedo| gradient[i] * gain * albedo * slope(albedo * mean[i]))]
    }
}

/// How a prediction is judged by its target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Loss {
    /// By the square of the difference: what is learned is the mean of the targets.
    #[default]
    Squared,
    /// By its size: the median, which a few fireflies do not move.
    Absolute,
    /// By the size of the differences of logarithms and of tones, and of the edges of tones: dark pixels count about as
    /// much as in a preview. Only for predictions of noise in logarithms.
    Tonal,
    /// By the size of the differences of logarithms, and by the squares of the differences of previews and of their
    /// edges: near the mean of the targets, and large errors count most, as in a PSNR. Only for predictions of noise in
    /// logarithms.
    Preview,
    /// By the logarithms of mean squared differences: of logarithms, and of previews with their edges. Each example
    /// then counts as much as any other, as in a mean PSNR. The targets are corrected for their own noise: previews and
    /// logarithms of noisy targets are darker than those of their mean. Only for predictions of noise in logarithms.
    UnbiasedPreview,
}

impl Loss {
    /// Whether it judges images, not only predictions.
    pub(crate) fn of_images(self) -> bool {
        matches!(self, Self::Tonal | Self::Preview | Self::UnbiasedPreview)
    }

    /// Whether targets are corrected for the bias that their own noise has after a curve.
    pub(crate) fn is_unbiased(self) -> bool {
        self == Self::UnbiasedPreview
    }
}

/// The images that predictions of noise belong to: the noise is the state less the clean image.
#[derive(Clone, Debug)]
pub(crate) struct Shown {
    /// [N, H, W, 3], signed logarithms.
    pub(crate) state: Arc<Vec<f32>>,
    /// Height and width.
    pub(crate) side: usize,
    /// The previews of the targets, if they are corrected for noise: their shape is that of the state.
    pub(crate) previews: Option<Arc<Vec<f32>>>,
}

/// Weight of differences of tones, and of differences of the slopes of tones, in [`Loss::Tonal`].
pub(super) const TONES: f32 = 0.3;
pub(super) const EDGES: f32 = 0.3;

/// The inverse of the radiance below which tones are linear.
pub(super) const DARK: f32 = 20.0;

/// Logarithms above this are their own tones, but for a constant: an exponential could be too large.
pub(super) const BRIGHT: f32 = 30.0;

/// log(1 + [`DARK`] x) of the radiance x with this logarithm log(1 + x), with its sign.
fn tone(log: f32) -> f32 {
    let size = log.abs();
    (log1p(DARK * expm1(size.min(BRIGHT))) + (size - BRIGHT).max(0.0)).copysign(log)
}

/// The slope of [`tone`].
fn tone_slope(log: f32) -> f32 {
    let radiance = expm1(log.abs().min(BRIGHT));
    DARK * (1.0 + radiance) / (1.0 + DARK * radiance)
}

/// Weight of squared differences of previews, and of their slopes, in [`Loss::Preview`].
pub(super) const PREVIEWS: f32 = 8.0;
pub(super) const SLOPES: f32 = 4.0;

/// Differences of logarithms count by their squares up to this in [`Loss::UnbiasedPreview`], and by their size beyond.
pub(super) const SQUARED_TO: f32 = 1.0;

/// Added to mean squared differences in [`Loss::UnbiasedPreview`], so that smaller ones hardly count.
pub(super) const NEGLIGIBLE: f32 = 1e-5;

/// Added to radiance in previews: the slope of a square root has no end.
pub(super) const DIM: f32 = 0.002;

/// The square root of y/(1 + y), where y is the radiance with this logarithm log(1 + x) plus [`DIM`]: nearly the
/// preview, whose exponent is 1/2.2. Negative radiance counts as 0.
fn preview(log: f32) -> f32 {
    preview_of(expm1(log.clamp(0.0, BRIGHT)))
}

/// The same of a radiance.
pub(crate) fn preview_of(radiance: f32) -> f32 {
    let radiance = radiance.max(0.0) + DIM;
    (radiance / (1.0 + radiance)).sqrt()
}

/// The slope of [`preview`].
fn preview_slope(log: f32) -> f32 {
    if !(0.0..BRIGHT).contains(&log) {
        return 0.0;
    }
    let radiance = expm1(log);
    let above = 1.0 + DIM + radiance;
    0.5 * (1.0 + radiance) / (above * above * ((DIM + radiance) / above).sqrt())
}

/// The losses of a prediction by a target of its shape, added and divided by `count`: how many there are in all parts
/// of a batch together. Losses of images need them.
pub(crate) fn mean_loss<const D: usize>(
    prediction: Tensor<D>,
    (target, shown): (Arc<Vec<f32>>, Option<Shown>),
    count: usize,
    loss: Loss,
) -> Tensor<1> {
    assert_eq!(prediction.shape().num_elements(), target.len(), "the target has the prediction's shape");
    assert_eq!(loss.of_images(), shown.is_some(), "tones are those of images");
    apply(MeanLoss { target, count, loss, shown }, [prediction.into()], [1])
}

/// See [`mean_loss`].
#[derive(Clone, Debug)]
pub(super) struct MeanLoss {
    pub(super) target: Arc<Vec<f32>>,
    pub(super) count: usize,
    pub(super) loss: Loss,
    pub(super) shown: Option<Shown>,
}

impl MeanLoss {
    /// Differences of tones of the images: the predicted one less the target.
    fn tones(&self, shown: &Shown, prediction: &[f32], tone: impl Fn(f32) -> f32) -> Vec<f32> {
        let each = shown.state.iter().zip(prediction).zip(self.target.iter());
        each.map(|((state, p), t)| tone(state - p) - tone(state - t)).collect()
    }

    /// The gradient of the weighted squares of differences of previews and of their edges.
    fn slopes_of_previews(shown: &Shown, off: &[f32]) -> Vec<f32> {
        let mut slopes: Vec<f32> = off.iter().map(|off| 2.0 * PREVIEWS * off).collect();
        Self::edges(shown, |a, b| {
            let slope = 2.0 * SLOPES * (off[a] - off[b]);
            slopes[a] += slope;
            slopes[b] -= slope;
        });
        slopes
    }

    /// What [`Loss::UnbiasedPreview`] judges by: the images, and the previews that they should have.
    fn unbiased(&self) -> Option<(&Shown, &[f32])> {
        let shown = self.shown.as_ref().filter(|_| self.loss == Loss::UnbiasedPreview)?;
        Some((shown, shown.previews.as_ref().expect("batches for this loss have previews")))
    }

    /// Values of an example.
    fn example(&self, shown: &Shown) -> usize {
        3 * shown.side * shown.side
    }

    /// Differences of previews of the images from those that they should have.
    fn off(&self, shown: &Shown, prediction: &[f32], previews: &[f32]) -> Vec<f32> {
        let each = shown.state.iter().zip(prediction).zip(previews);
        each.map(|((state, p), target)| preview(state - p) - target).collect()
    }

    /// Mean squared differences of the logarithms of each example, and of its previews with their edges.
    fn errors(&self, shown: &Shown, prediction: &[f32], off: &[f32]) -> Vec<[f64; 2]> {
        let size = self.example(shown);
        let mut errors = vec![[0.0; 2]; off.len() / size];
        for (at, ((p, t), off)) in prediction.iter().zip(self.target.iter()).zip(off).enumerate() {
            let (difference, bound) = (f64::from(p - t).abs(), f64::from(SQUARED_TO));
            let near = difference.min(bound);
            errors[at / size][0] += near * near + 2.0 * bound * (difference - near);
            errors[at / size][1] += f64::from(PREVIEWS) * f64::from(*off).powi(2);
        }
        Self::edges(shown, |a, b| errors[a / size][1] += f64::from(SLOPES) * f64::from(off[a] - off[b]).powi(2));
        errors.iter_mut().flatten().for_each(|error| *error /= size as f64);
        errors
    }

    /// The gradient of [`Loss::UnbiasedPreview`], times `scale` for each value.
    fn unbiased_gradient(&self, shown: &Shown, prediction: &[f32], previews: &[f32], scale: f32) -> Vec<f32> {
        let (size, off) = (self.example(shown), self.off(shown, prediction, previews));
        let errors = self.errors(shown, prediction, &off);
        let slopes = Self::slopes_of_previews(shown, &off);
        let each = prediction.iter().zip(self.target.iter()).zip(shown.state.iter()).zip(slopes).enumerate();
        each.map(|(at, (((p, t), state), slope))| {
            let [logs, previews] = errors[at / size].map(|error| 0.5 * scale / (error as f32 + NEGLIGIBLE));
            let of_log = 2.0 * (p - t).clamp(-SQUARED_TO, SQUARED_TO);
            logs * of_log - previews * slope * preview_slope(state - p)
        })
        .collect()
    }

    /// Calls `f` for each pair of neighbours in the images: the first, and the one to its right or below it.
    fn edges(shown: &Shown, mut f: impl FnMut(usize, usize)) {
        let (side, row) = (shown.side, 3 * shown.side);
        for at in 0..shown.state.len() {
            if at % row + 3 < row {
                f(at, at + 3);
            }
            if at / row % side + 1 < side {
                f(at, at + row);
            }
        }
    }
}

impl Operator<1> for MeanLoss {
    type Saved = ();

    fn forward(&self, [prediction]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        if let Some((shown, previews)) = self.unbiased() {
            let size = self.example(shown);
            let errors = self.errors(shown, prediction, &self.off(shown, prediction, previews));
            let logarithm = |error: f64| maths::log1p(error / f64::from(NEGLIGIBLE));
            let total: f64 =
                errors.iter().map(|[logs, previews]| 0.5 * (logarithm(*logs) + logarithm(*previews))).sum();
            return (vec![(total * size as f64 / self.count as f64) as f32], ());
        }
        let of = |(p, t): (&f32, &f32)| {
            let difference = f64::from(p - t);
            match self.loss {
                Loss::Squared => difference * difference,
                Loss::Absolute | Loss::Tonal | Loss::Preview => difference.abs(),
                Loss::UnbiasedPreview => unreachable!("its squares are those of examples"),
            }
        };
        let mut total: f64 = prediction.iter().zip(self.target.iter()).map(of).sum();
        if let Some(shown) = self.shown.as_ref().filter(|_| self.loss == Loss::Preview) {
            let off = self.tones(shown, prediction, preview);
            let mut edges = 0.0;
            Self::edges(shown, |a, b| edges += f64::from(off[a] - off[b]).powi(2));
            let squares = off.iter().map(|off| f64::from(*off).powi(2)).sum::<f64>();
            total += f64::from(PREVIEWS) * squares + f64::from(SLOPES) * edges;
        } else if let Some(shown) = &self.shown {
            let tones = self.tones(shown, prediction, tone);
            total += f64::from(TONES) * tones.iter().map(|tone| f64::from(tone.abs())).sum::<f64>();
            let mut edges = 0.0;
            Self::edges(shown, |a, b| edges += f64::from((tones[a] - tones[b]).abs()));
            total += f64::from(EDGES) * edges;
        }
        (vec![(total / self.count as f64) as f32], ())
    }

    fn backward(&self, [prediction]: [&[f32]; 1], (): &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        let scale = gradient[0] / self.count as f32;
        if let Some((shown, previews)) = self.unbiased() {
            return [self.unbiased_gradient(shown, prediction, previews, scale)];
        }
        let of = |(p, t): (&f32, &f32)| match self.loss {
            Loss::Squared => 2.0 * (p - t) * scale,
            Loss::Absolute | Loss::Tonal | Loss::Preview => scale * sign(p - t),
            Loss::UnbiasedPreview => unreachable!("its squares are those of examples"),
        };
        let mut out: Vec<f32> = prediction.iter().zip(self.target.iter()).map(of).collect();
        if let Some(shown) = self.shown.as_ref().filter(|_| self.loss == Loss::Preview) {
            let off = self.tones(shown, prediction, preview);
            let slopes = Self::slopes_of_previews(shown, &off);
            for (((out, slope), state), p) in out.iter_mut().zip(slopes).zip(shown.state.iter()).zip(prediction) {
                *out -= scale * slope * preview_slope(state - p);
            }
        } else if let Some(shown) = &self.shown {
            let tones = self.tones(shown, prediction, tone);
            let mut slopes: Vec<f32> = tones.iter().map(|tone| TONES * sign(*tone)).collect();
            Self::edges(shown, |a, b| {
                let slope = EDGES * sign(tones[a] - tones[b]);
                slopes[a] += slope;
                slopes[b] -= slope;
            });
            for (((out, slope), state), p) in out.iter_mut().zip(slopes).zip(shown.state.iter()).zip(prediction) {
                *out -= scale * slope * tone_slope(state - p);
            }
        }
        [out]
    }
}

/// 1, -1, or 0 for no difference.
fn sign(value: f32) -> f32 {
    if value == 0.0 { 0.0 } else { value.signum() }
}
