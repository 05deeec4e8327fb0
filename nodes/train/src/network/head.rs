//! The end of the network that is not learned: what the last layer's numbers mean.
//!
//! The numbers are weights: of what lies around each pixel of the state, divided by albedo where there is one, at
//! several scales. The weighted mean, times the albedo, is the network's estimate of what more samples would give; the
//! answer is that less the state, times what the law says of how far the target is from it. A firefly of a thousand
//! therefore needs no output of a thousand, texture is preserved, and the network does not learn known scales. Albedo
//! of few samples is noisy at edges, so that the mean can be multiplied by a weighted mean of albedo instead.

use burn::tensor::Tensor;
use rayon::prelude::*;
use std::{ops::Range, sync::Arc};
use tauflow_ops::{GuidedMean, Guides, LOCAL_MODELS, Operator, Pyramid, WeightedMean, exp, map2};
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
