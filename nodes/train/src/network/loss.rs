//! The losses: how predictions are judged by their targets.

use super::structure::{self, Windows};
use burn::tensor::Tensor;
use std::sync::Arc;
use tauflow_data::maths;
use tauflow_ops::{Operator, expm1, log1p};
use tauflow_tensors::apply;

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
    /// The same, and what previews lack of a structural similarity of 1 (SSIM), from which the noise of the targets is
    /// taken off, too. Only for predictions of noise in logarithms.
    Structural,
}

impl Loss {
    /// Whether it judges images, not only predictions.
    pub(crate) fn of_images(self) -> bool {
        matches!(self, Self::Tonal | Self::Preview) || self.is_unbiased()
    }

    /// Whether targets are corrected for the bias that their own noise has after a curve.
    pub(crate) fn is_unbiased(self) -> bool {
        matches!(self, Self::UnbiasedPreview | Self::Structural)
    }

    /// Whether the noise of targets must be known.
    pub(crate) fn is_structural(self) -> bool {
        self == Self::Structural
    }

    /// The smallest side of images that it judges.
    pub(crate) fn least_side(self) -> usize {
        if self.is_structural() { structure::WINDOW } else { 1 }
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
    /// The variance that noise has in these previews, for [`Loss::Structural`].
    pub(crate) noise: Option<Arc<Vec<f32>>>,
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

/// Weight of what is lacking of a similarity of 1 in [`Loss::Structural`]. An error that is smaller by 1 dB changes the
/// rest of the loss by 0.23.
pub(super) const STRUCTURE: f32 = 4.0;

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
        let shown = self.shown.as_ref().filter(|_| self.loss.is_unbiased())?;
        Some((shown, shown.previews.as_ref().expect("batches for this loss have previews")))
    }

    /// Calls `f` for each example with its number, and with the windows of its previews, in [`Loss::Structural`].
    fn structures(&self, shown: &Shown, prediction: &[f32], previews: &[f32], mut f: impl FnMut(usize, &Windows<'_>)) {
        let Some(noise) = shown.noise.as_ref().filter(|_| self.loss.is_structural()) else { return };
        let size = self.example(shown);
        let images: Vec<f32> = shown.state.iter().zip(prediction).map(|(state, p)| preview(state - p)).collect();
        let examples = images.chunks_exact(size).zip(previews.chunks_exact(size)).zip(noise.chunks_exact(size));
        for (example, ((image, target), noise)) in examples.enumerate() {
            f(example, &Windows::new(image, target, noise, shown.side));
        }
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

    /// The gradient of [`Loss::UnbiasedPreview`] or [`Loss::Structural`], times `scale` for each value.
    fn unbiased_gradient(&self, shown: &Shown, prediction: &[f32], previews: &[f32], scale: f32) -> Vec<f32> {
        let (size, off) = (self.example(shown), self.off(shown, prediction, previews));
        let errors = self.errors(shown, prediction, &off);
        let slopes = Self::slopes_of_previews(shown, &off);
        let mut of_structure = vec![0.0; if self.loss.is_structural() { prediction.len() } else { 0 }];
        self.structures(shown, prediction, previews, |example, windows| {
            let slopes = windows.gradient(-STRUCTURE * scale * size as f32);
            of_structure[example * size..][..size].copy_from_slice(&slopes);
        });
        let each = prediction.iter().zip(self.target.iter()).zip(shown.state.iter()).zip(slopes).enumerate();
        each.map(|(at, (((p, t), state), slope))| {
            let [logs, previews] = errors[at / size].map(|error| 0.5 * scale / (error as f32 + NEGLIGIBLE));
            let of_log = 2.0 * (p - t).clamp(-SQUARED_TO, SQUARED_TO);
            let slope = previews * slope + of_structure.get(at).unwrap_or(&0.0);
            logs * of_log - slope * preview_slope(state - p)
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
            let mut total: f64 =
                errors.iter().map(|[logs, previews]| 0.5 * (logarithm(*logs) + logarithm(*previews))).sum();
            self.structures(shown, prediction, previews, |_, windows| {
                total += f64::from(STRUCTURE) * (1.0 - windows.similarity());
            });
            return (vec![(total * size as f64 / self.count as f64) as f32], ());
        }
        let of = |(p, t): (&f32, &f32)| {
            let difference = f64::from(p - t);
            match self.loss {
                Loss::Squared => difference * difference,
                Loss::Absolute | Loss::Tonal | Loss::Preview => difference.abs(),
                Loss::UnbiasedPreview | Loss::Structural => unreachable!("its squares are those of examples"),
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
            Loss::UnbiasedPreview | Loss::Structural => unreachable!("its squares are those of examples"),
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
