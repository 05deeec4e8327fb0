//! The two ends of the network that are not learned: what the last layer's numbers mean, and the loss.
//!
//! The numbers are weights: of what lies around each pixel of the state, divided by albedo where there is one, at
//! several scales. The weighted mean, times the albedo, is the network's estimate of what more samples would give; the
//! answer is that less the state, times what the law says of how far the target is from it. A firefly of a thousand
//! therefore needs no output of a thousand, texture is preserved, and the network does not learn known scales. Albedo
//! of few samples is noisy at edges, so that the mean can be multiplied by a weighted mean of albedo instead.

use burn::tensor::Tensor;
use rayon::prelude::*;
use std::sync::Arc;
use tauflow_ops::{GuidedMean, Guides, Operator, Pyramid, WeightedMean, exp, expm1, log1p, map2};
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
    /// Predictions, with nothing known put in: for studies of what the law is worth.
    Values,
}

impl Output {
    /// All of them.
    #[cfg(test)]
    pub(crate) const ALL: [Self; 5] =
        [Self::Means, Self::ShadedMeans, Self::GuidedMeans, Self::SmoothedMeans, Self::Values];

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
        matches!(self, Self::GuidedMeans | Self::SmoothedMeans)
    }

    /// Whether albedo is smoothed.
    pub(crate) fn is_smoothed(self) -> bool {
        matches!(self, Self::SmoothedMeans)
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
    /// Albedo at full resolution, if it is smoothed; the answer then has none.
    pub(crate) albedo: Option<Arc<Pyramid>>,
    /// The processing of the weighted mean.
    pub(crate) answer: Answer,
}

/// Side of the window in which albedo is smoothed.
pub(crate) const SMOOTHED: usize = 5;

/// Added to the number of the pixel itself where albedo is smoothed: at first it has nearly all of the weight.
const ITSELF: f32 = 6.0;

/// The outputs of the last layers, folded: [N, H/2, W/2, 4 C]; none for layers that the network lacks.
pub(crate) struct Heads {
    /// As many for a pixel as there are weights.
    pub(crate) numbers: Tensor<4>,
    /// Three for a pixel.
    pub(crate) shades: Option<Tensor<4>>,
    /// One for a pixel, level and guide.
    pub(crate) strengths: Option<Tensor<4>>,
    /// [`SMOOTHED`] squared for a pixel.
    pub(crate) smooths: Option<Tensor<4>>,
}

impl Head {
    /// The prediction [N, H, W, 3].
    pub(crate) fn expand(self, heads: Heads) -> Tensor<4> {
        let Heads { numbers, shades, strengths, smooths } = heads;
        let [images, rows, columns, channels] = numbers.dims();
        assert_eq!(channels, 4 * self.light.weights(), "a number for each place of the windows");
        let shape = [images, 2 * rows, 2 * columns, 3];
        let pyramid = self.light;
        let mut mean = match (self.guides, strengths) {
            (Some(guides), Some(strengths)) => {
                apply(GuidedMean { pyramid, guides }, [numbers.into(), strengths.into()], shape)
            }
            (None, None) => apply(WeightedMean { pyramid, own: 0.0 }, [numbers.into()], shape),
            _ => panic!("guides need strengths"),
        };
        if let Some(shades) = shades {
            mean = apply(Shade, [mean.into(), unfold(shades).into()], shape);
        }
        assert_eq!(self.albedo.is_some(), smooths.is_some(), "weights of albedo");
        if let Some((pyramid, smooths)) = self.albedo.zip(smooths) {
            mean = mean * apply(WeightedMean { pyramid, own: ITSELF }, [smooths.into()], shape);
        }
        apply(self.answer, [mean.into()], shape)
    }
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
}

impl Loss {
    /// Whether it judges images, not only predictions.
    pub(crate) fn of_images(self) -> bool {
        matches!(self, Self::Tonal | Self::Preview)
    }
}

/// The images that predictions of noise belong to: the noise is the state less the clean image.
#[derive(Clone, Debug)]
pub(crate) struct Shown {
    /// [N, H, W, 3], signed logarithms.
    pub(crate) state: Arc<Vec<f32>>,
    /// Height and width.
    pub(crate) side: usize,
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

/// Added to radiance in previews: the slope of a square root has no end.
pub(super) const DIM: f32 = 0.002;

/// The square root of y/(1 + y), where y is the radiance with this logarithm log(1 + x) plus [`DIM`]: nearly the
/// preview, whose exponent is 1/2.2. Negative radiance counts as 0.
fn preview(log: f32) -> f32 {
    let radiance = expm1(log.clamp(0.0, BRIGHT)) + DIM;
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
        let of = |(p, t): (&f32, &f32)| {
            let difference = f64::from(p - t);
            match self.loss {
                Loss::Squared => difference * difference,
                Loss::Absolute | Loss::Tonal | Loss::Preview => difference.abs(),
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
        let of = |(p, t): (&f32, &f32)| match self.loss {
            Loss::Squared => 2.0 * (p - t) * scale,
            Loss::Absolute | Loss::Tonal | Loss::Preview => scale * sign(p - t),
        };
        let mut out: Vec<f32> = prediction.iter().zip(self.target.iter()).map(of).collect();
        if let Some(shown) = self.shown.as_ref().filter(|_| self.loss == Loss::Preview) {
            let off = self.tones(shown, prediction, preview);
            let mut slopes: Vec<f32> = off.iter().map(|off| 2.0 * PREVIEWS * off).collect();
            Self::edges(shown, |a, b| {
                let slope = 2.0 * SLOPES * (off[a] - off[b]);
                slopes[a] += slope;
                slopes[b] -= slope;
            });
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
