//! The input features of the network, and the units of its output.

use super::{
    head::{Answer, Blend, Head, Output, SMOOTHED},
    unet::{FITTED, Inputs, Preset, Unet},
};
use crate::{
    law::Factors,
    space::{Space, signed_log1p},
};
use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::{borrow::Cow, ops::RangeInclusive, sync::Arc};
use tauflow_data::maths;
use tauflow_ops::{FARTHEST_FITTED, Guides, Pyramid, expm1, local_models, map, map2};

/// Numbers that tell the time.
pub(crate) const CLOCK: usize = 14;

/// Added to the deviation around a pixel: where all samples missed the light, it must still be possible to add some.
const FLOOR: f32 = 0.05;

/// Half the side, less a half, of the window that is averaged over.
const REACH: usize = 2;

/// Added to albedo before it divides: what is black has light on it, too.
const BLACK: f32 = 0.02;

/// The length of the mean normal from which on a pixel says nothing of uncovered pixels around it.
const BARE: f32 = 0.25;

/// Input channels of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Features {
    /// Logarithms of radiance and of radiance divided by albedo, the contrast of each pixel to its neighbourhood, and
    /// the G-buffer.
    #[default]
    Contrast,
    /// The same, but where a pixel shows no surface, such as sky, its albedo counts as white: edges of surfaces are
    /// smooth against a bright sky.
    Covered,
    /// The state in the training space and the G-buffer, unchanged.
    Plain,
}

impl Features {
    /// The value of older files, which lack this field, independent of the current default.
    pub(crate) fn unsaid() -> Self {
        Self::Contrast
    }

    /// True of files that do not mention it.
    pub(crate) fn is_unsaid(&self) -> bool {
        *self == Self::unsaid()
    }

    /// Its name in pipelines.
    pub fn name(self) -> &'static str {
        match self {
            Self::Contrast => "contrast",
            Self::Covered => "covered",
            Self::Plain => "plain",
        }
    }
}

/// One state with what belongs to it.
pub(crate) struct Sample<'a> {
    /// [H, W, 3], in the training space.
    pub(crate) state: &'a [f32],
    /// [H, W, 6], for solvers that see G-buffers.
    pub(crate) gbuffer: Option<&'a [f32]>,
    /// Variance time; none if the network is not told.
    pub(crate) tau: Option<f64>,
}

/// How states become inputs: fixed by how a solver was trained.
#[derive(Clone, Debug)]
pub(crate) struct Encoding {
    pub(crate) factors: Factors,
    pub(crate) space: Space,
    pub(crate) gbuffer: bool,
    pub(crate) features: Features,
    pub(crate) output: Output,
    pub(crate) preset: Preset,
}

impl Encoding {
    /// Channels of the features.
    pub(crate) fn channels(&self) -> usize {
        match (self.features, self.gbuffer) {
            (Features::Contrast | Features::Covered, true) => 15,
            (Features::Contrast | Features::Covered, false) => 6,
            (Features::Plain, true) => 9,
            (Features::Plain, false) => 3,
        }
    }

    /// Inputs of a batch of samples of `height` x `width` pixels.
    pub(crate) fn inputs(&self, device: &Device, samples: &[Sample<'_>], height: usize, width: usize) -> Inputs {
        let (pixels, channels) = (height * width, self.channels());
        let mut features = vec![0.0; samples.len() * pixels * channels];
        let mut clock = Vec::with_capacity(samples.len() * CLOCK);
        let (mut lights, mut albedos, mut gains, mut fitted) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (sample, features) in samples.iter().zip(features.chunks_exact_mut(pixels * channels)) {
            let gbuffer = sample.gbuffer.filter(|_| self.gbuffer);
            assert_eq!(gbuffer.is_some(), self.gbuffer, "the caller checks that there is a G-buffer");
            let radiance = self.space.decode_all(sample.state);
            let albedo = gbuffer.map(|gbuffer| -> Vec<f32> {
                let rest = match self.features {
                    Features::Covered => uncovered(gbuffer, height, width),
                    Features::Contrast | Features::Plain => vec![0.0; pixels],
                };
                let of = |(pixel, rest): (&[f32], f32)| [0, 1, 2].map(|c| pixel[c].max(0.0) + BLACK + rest);
                let mut albedo = vec![0.0; 3 * pixels];
                let pixels = albedo.par_chunks_exact_mut(3).zip(gbuffer.par_chunks_exact(6)).zip(rest);
                pixels.with_min_len(4096).for_each(|((out, pixel), rest)| out.copy_from_slice(&of((pixel, rest))));
                albedo
            });
            let light = match &albedo {
                Some(albedo) => map2(&radiance, albedo, |value, albedo| value / albedo),
                None => radiance.clone(),
            };
            match self.features {
                Features::Contrast | Features::Covered => {
                    let seen = map(&light, signed_log1p);
                    let around = surroundings(&seen, height, width);
                    let off = map2(&light, &around.mean, |value, mean| value - mean);
                    let contrast = map2(&off, &around.spread, contrast);
                    let whole = gbuffer.map(|_| map(&radiance, signed_log1p));
                    let fill = |(pixel, features): (usize, &mut [f32])| {
                        let at = 3 * pixel..3 * pixel + 3;
                        features[..3].copy_from_slice(&seen[at.clone()]);
                        features[3..6].copy_from_slice(&contrast[at.clone()]);
                        if let (Some(gbuffer), Some(whole)) = (gbuffer, &whole) {
                            features[6..12].copy_from_slice(&gbuffer[6 * pixel..6 * pixel + 6]);
                            features[12..].copy_from_slice(&whole[at]);
                        }
                    };
                    features.par_chunks_exact_mut(channels).with_min_len(1024).enumerate().for_each(fill);
                }
                Features::Plain => {
                    let fill = |(pixel, features): (usize, &mut [f32])| {
                        features[..3].copy_from_slice(&sample.state[3 * pixel..3 * pixel + 3]);
                        if let Some(gbuffer) = gbuffer {
                            features[3..].copy_from_slice(&gbuffer[6 * pixel..6 * pixel + 6]);
                        }
                    };
                    features.par_chunks_exact_mut(channels).with_min_len(1024).enumerate().for_each(fill);
                }
            }
            clock.extend(self.time(sample.tau));
            gains.push(self.factors.at(sample.tau) as f32);
            if let Some(gbuffer) = gbuffer.filter(|_| self.output.is_fitted()) {
                append(&mut fitted, local_models(&light, gbuffer, height, width));
            }
            append(&mut lights, light);
            append(&mut albedos, albedo.unwrap_or_default());
        }
        let shape = [samples.len(), height, width, channels];
        let guides = || {
            let buffers: Vec<&[f32]> = samples.iter().filter_map(|sample| sample.gbuffer).collect();
            // A single image need not be copied.
            let all = if let [one] = buffers[..] { Cow::Borrowed(one) } else { Cow::Owned(buffers.concat()) };
            Arc::new(Guides::new(&all, height, width, self.preset.sides()))
        };
        let seen = self.output.is_fitted().then(|| {
            let shape = [samples.len(), height, width, FITTED];
            Tensor::from_data(TensorData::new(map(&fitted, signed_log1p), shape), device)
        });
        let head = (self.output != Output::Values).then(|| Head {
            guides: self.output.is_guided().then(guides),
            shaded: self.output.is_shaded(),
            fits: self.output.is_fitted().then(|| Blend { fits: Arc::new(fitted) }),
            light: Arc::new(Pyramid::new(&lights, height, width, self.preset.sides())),
            albedo: self.output.is_smoothed().then(|| Arc::new(Pyramid::new(&albedos, height, width, &[SMOOTHED]))),
            answer: Answer {
                albedo: (self.gbuffer && !self.output.is_smoothed()).then(|| Arc::new(albedos)),
                state: Arc::new(samples.iter().flat_map(|sample| sample.state.iter().copied()).collect()),
                gain: Arc::new(gains),
                log: self.space == Space::Log1p,
            },
        });
        Inputs {
            features: Tensor::from_data(TensorData::new(features, shape), device),
            fits: seen,
            clock: Tensor::from_data(TensorData::new(clock, [samples.len(), CLOCK]), device),
            head,
        }
    }

    /// How far, in pixels, predictions of a network look at most; none if it looks at the whole image.
    pub(crate) fn reach(&self, network: &Unet) -> Option<usize> {
        // Contrasts look at means over windows of means over windows. Each scale of the head's windows looks at half a
        // side of blocks, and at the block that the pixel is in.
        let contrasts = if self.features == Features::Plain { 0 } else { 2 * REACH };
        let windows = (0..).zip(self.preset.sides()).map(|(scale, side)| (side / 2 + 1) << scale).max().unwrap_or(0);
        // The network looks at fits as at contrasts.
        let models = if self.output.is_fitted() { FARTHEST_FITTED } else { 0 };
        let contrasts = contrasts.max(models);
        // Coverage looks at the pixels beside each pixel that is looked at.
        let beside = usize::from(self.gbuffer && self.features == Features::Covered);
        Some((network.reach()? + contrasts).max(windows) + beside)
    }

    /// The network for such inputs.
    pub(crate) fn network(&self) -> Unet {
        Unet::new(self.preset, self.channels(), CLOCK, self.output)
    }

    /// Smooth functions of tau. Training sees few times, rollouts many: high frequencies would not carry over. All are
    /// 0, which no time is, if the network is not told.
    fn time(&self, tau: Option<f64>) -> [f32; CLOCK] {
        let mut out = [0.0; CLOCK];
        let Some(tau) = tau else { return out };
        out[0] = tau as f32;
        let clock = self.factors.clock();
        out[1] = (maths::log(clock.count(tau.clamp(0.0, 1.0))) / maths::log(clock.n_max())) as f32;
        for i in 0..(CLOCK - 2) / 2 {
            let angle = core::f64::consts::PI * maths::exp2(i as f64 * 0.5 - 1.0) * tau;
            out[2 + 2 * i] = maths::sin(angle) as f32;
            out[3 + 2 * i] = maths::cos(angle) as f32;
        }
        out
    }
}

/// Adds numbers to others; moves them if there are none.
fn append(all: &mut Vec<f32>, mut more: Vec<f32>) {
    if all.is_empty() { *all = more } else { all.append(&mut more) }
}

/// The share of each pixel of a G-buffer that shows no surface: 1 less the length of the mean normal.
///
/// The mean normal of rough and curved surfaces is shorter than 1, too. A pixel counts as partly uncovered only if it
/// or one beside it shows (nearly) no surface.
fn uncovered(gbuffer: &[f32], height: usize, width: usize) -> Vec<f32> {
    let length = |pixel: &[f32]| pixel[3..6].iter().map(|n| n * n).sum::<f32>().min(1.0).sqrt();
    assert_eq!(gbuffer.len(), 6 * height * width, "a G-buffer of the image");
    let mut lengths = vec![0.0; height * width];
    let mut least_of_rows = vec![0.0; height * width];
    let rows = lengths.par_chunks_exact_mut(width).zip(least_of_rows.par_chunks_exact_mut(width));
    rows.zip(gbuffer.par_chunks_exact(6 * width)).for_each(|((lengths, least), pixels)| {
        for (out, pixel) in lengths.iter_mut().zip(pixels.chunks_exact(6)) {
            *out = length(pixel);
        }
        for (x, least) in least.iter_mut().enumerate() {
            *least = lengths[x].min(lengths[x.saturating_sub(1)]).min(lengths[(x + 1).min(width - 1)]);
        }
    });
    let mut out = vec![0.0; height * width];
    out.par_chunks_exact_mut(width).enumerate().for_each(|(y, out)| {
        let row = |y: usize| &least_of_rows[y * width..(y + 1) * width];
        let (above, here, below) = (row(y.saturating_sub(1)), row(y), row((y + 1).min(height - 1)));
        for (x, (out, own)) in out.iter_mut().zip(&lengths[y * width..]).enumerate() {
            let least = here[x].min(above[x]).min(below[x]);
            *out = (1.0 - own) * (1.0 - least / BARE).max(0.0);
        }
    });
    out
}

/// The neighbourhood of each pixel: mean and deviation of the logarithms over a window, as linear values.
fn surroundings(seen: &[f32], height: usize, width: usize) -> Surroundings {
    let averaged = |values: &[f32]| means_of_columns(&means_of_rows(values, width), height, width);
    let mean = averaged(seen);
    let spread = averaged(&map2(seen, &mean, |v, m| (v - m).abs()));
    Surroundings {
        // d expm1(x) = exp(x) dx, taken over the whole deviation so that it stays positive and grows with it.
        spread: map2(&mean, &spread, |mean, spread| expm1(mean.abs() + spread) - expm1(mean.abs())),
        mean: map(&mean, |mean| expm1(mean.abs()).copysign(mean)),
    }
}

/// Mean and deviation around each pixel, linear.
struct Surroundings {
    mean: Vec<f32>,
    spread: Vec<f32>,
}

/// How far a value is off its surroundings in units of their deviation, compressed: the same at any brightness.
#[inline(always)]
fn contrast(off: f32, spread: f32) -> f32 {
    signed_log1p(off / (FLOOR + spread))
}

/// The window around `at` on an axis of some length, and the share of each of its places.
fn window(at: usize, length: usize) -> (RangeInclusive<usize>, f32) {
    let (first, last) = (at.saturating_sub(REACH), (at + REACH).min(length - 1));
    (first..=last, 1.0 / (last - first + 1) as f32)
}

/// Means over windows along rows of pixels of three values.
fn means_of_rows(data: &[f32], width: usize) -> Vec<f32> {
    let mut out = vec![0.0; data.len()];
    out.par_chunks_exact_mut(3 * width).zip(data.par_chunks_exact(3 * width)).for_each(|(out, data)| {
        let middle = REACH.min(width)..width.saturating_sub(REACH).max(REACH.min(width));
        for at in (0..middle.start).chain(middle.end..width) {
            let (places, share) = window(at, width);
            for from in places {
                (0..3).for_each(|c| out[3 * at + c] += data[3 * from + c] * share);
            }
        }
        // Where windows are whole, a row is a row of numbers.
        let share = 1.0 / (2 * REACH + 1) as f32;
        let whole = &mut out[3 * middle.start..3 * middle.end];
        for step in (0..=2 * REACH).take_while(|_| !middle.is_empty()) {
            whole.iter_mut().zip(&data[3 * step..]).for_each(|(out, value)| *out += value * share);
        }
    });
    out
}

/// Means over windows along columns of pixels of three values.
fn means_of_columns(data: &[f32], height: usize, width: usize) -> Vec<f32> {
    let mut out = vec![0.0; data.len()];
    out.par_chunks_exact_mut(3 * width).enumerate().for_each(|(at, out)| {
        let (places, share) = window(at, height);
        for from in places {
            let row = &data[from * 3 * width..(from + 1) * 3 * width];
            out.iter_mut().zip(row).for_each(|(out, value)| *out += value * share);
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::Law;
    use tauflow_data::{methods::Parameterization, rng::Stream};
    use tauflow_ops::Convolutions;

    fn encoding(space: Space, features: Features, output: Output, preset: Preset) -> Encoding {
        let factors = Factors::new(Parameterization::McNoise, &[1, 256], Law::Covariances).expect("a ladder");
        Encoding { factors, space, gbuffer: true, features, output, preset }
    }

    #[test]
    fn plain_features_are_the_state_and_the_gbuffer() {
        let (state, gbuffer): (Vec<f32>, Vec<f32>) =
            ((0..16 * 16 * 3).map(|i| i as f32 - 9.0).collect(), (0..16 * 16 * 6).map(|i| (i % 11) as f32).collect());
        for space in [Space::Linear, Space::Log1p] {
            for (gbuffer, channels) in [(Some(&gbuffer[..]), 9), (None, 3)] {
                let encoding = Encoding {
                    gbuffer: gbuffer.is_some(),
                    ..encoding(space, Features::Plain, Output::Values, Preset::Fast)
                };
                let sample = Sample { state: &state, gbuffer, tau: Some(0.5) };
                let inputs = encoding.inputs(&Device::flex(), &[sample], 16, 16);
                assert_eq!(inputs.features.dims(), [1, 16, 16, channels]);
                let found = inputs.features.into_data();
                for (pixel, found) in found.as_slice::<f32>().expect("f32").chunks_exact(channels).enumerate() {
                    assert_eq!(found[..3], state[3 * pixel..3 * pixel + 3]);
                    assert_eq!(&found[3..], gbuffer.map_or(&[][..], |gbuffer| &gbuffer[6 * pixel..6 * pixel + 6]));
                }
                let seen = Encoding { features: Features::Contrast, ..encoding.clone() };
                // No neighbours are averaged for the features, so that less is seen.
                let reach = |encoding: &Encoding| encoding.reach(&encoding.network()).expect("a local preset");
                assert_eq!(reach(&seen), reach(&encoding) + 2 * REACH);
            }
        }
    }

    #[test]
    fn pixels_without_a_surface_and_edges_beside_them_are_uncovered() {
        // A column of sky, one that is half sky, and rough surfaces, whose mean normals are short, too.
        let lengths = [0.0, 0.5, 0.6, 0.6, 1.0];
        let row: Vec<f32> = lengths.iter().flat_map(|length| [0.3, 0.3, 0.3, 0.0, 0.0, *length]).collect();
        let found = uncovered(&[row.clone(), row.clone(), row].concat(), 3, 5);
        for row in found.chunks_exact(5) {
            assert_eq!(row, [1.0, 0.5, 0.0, 0.0, 0.0]);
        }
        // Light over the edge of the sky: the sky's radiance is its light, and a mixed pixel lies between.
        let light = |features: Features| {
            let encoding = encoding(Space::Linear, features, Output::Means, Preset::Fast);
            let (state, gbuffer) = (vec![2.0; 16 * 16 * 3], [0.0f32; 6].repeat(16 * 16));
            let sample = Sample { state: &state, gbuffer: Some(&gbuffer), tau: None };
            let head = encoding.inputs(&Device::flex(), &[sample], 16, 16).head.expect("means");
            head.answer.albedo.expect("a G-buffer")[0]
        };
        assert!((light(Features::Covered) - 1.0 - BLACK).abs() < 1e-6);
        assert_eq!(light(Features::Contrast), BLACK);
        let reach = |features| {
            let encoding = encoding(Space::Linear, features, Output::Means, Preset::Fast);
            encoding.reach(&encoding.network()).expect("a local preset")
        };
        assert_eq!(reach(Features::Covered), reach(Features::Contrast) + 1);
    }

    #[test]
    fn equal_weights_give_the_mean_of_the_window_times_the_albedo() {
        let device = Device::flex();
        for (space, features, preset, tau) in [
            (Space::Linear, Features::Contrast, Preset::Tiny, Some(0.0)),
            (Space::Log1p, Features::Contrast, Preset::Tiny, Some(0.0)),
            (Space::Log1p, Features::Plain, Preset::Tiny, Some(0.0)),
            (Space::Log1p, Features::Contrast, Preset::Fast, None),
        ] {
            let encoding = encoding(space, features, Output::Means, preset);
            let network = encoding.network();
            // Light of 3 on albedos that change from pixel to pixel.
            let albedo = |i: usize| (i % 5) as f32 / 5.0;
            let state: Vec<f32> = (0..16 * 16 * 3).map(|i| space.encode(3.0 * (albedo(i / 3) + BLACK))).collect();
            let gbuffer: Vec<f32> =
                (0..16 * 16).flat_map(|i| [albedo(i), albedo(i), albedo(i), 0.0, 0.0, 1.0]).collect();
            let sample = Sample { state: &state, gbuffer: Some(&gbuffer), tau };
            let inputs = encoding.inputs(&device, &[sample], 16, 16);
            assert_eq!(inputs.features.dims(), [1, 16, 16, encoding.channels()]);
            let weights = network.slots().draw(1);
            let output =
                network.forward(&network.slots().tensors(&weights, &device), inputs, Convolutions::Direct).into_data();
            // A fresh network weighs alike, and light that is alike is its own mean: there is no noise.
            assert!(output.as_slice::<f32>().expect("f32").iter().all(|v| v.abs() < 1e-5), "{space:?}");
        }
    }

    #[test]
    fn a_tall_image_in_parts_has_the_bits_of_the_same_image_in_a_batch() {
        let (device, height, width) = (Device::flex(), 800, 16);
        let mut stream = Stream::new(3, &[]);
        let mut numbers = |count: usize| (0..count).map(|_| stream.range(0.0, 2.0) as f32).collect::<Vec<_>>();
        let (state, gbuffer) = (numbers(height * width * 3), numbers(height * width * 6));
        for (output, gbuffer) in [(Output::FittedMeans, Some(&gbuffer[..])), (Output::ShadedMeans, None)] {
            let encoding = Encoding {
                gbuffer: gbuffer.is_some(),
                ..encoding(Space::Log1p, Features::Covered, output, Preset::Fast)
            };
            let network = encoding.network();
            let mut weights = network.slots().draw(1);
            weights.0.iter_mut().flatten().for_each(|weight| *weight += stream.range(-0.02, 0.02) as f32);
            let tensors = network.slots().tensors(&weights, &device);
            for convolutions in [Convolutions::Minimal, Convolutions::Direct] {
                let found = |images: usize| {
                    let sample = || Sample { state: &state, gbuffer, tau: None };
                    let samples: Vec<_> = (0..images).map(|_| sample()).collect();
                    let inputs = encoding.inputs(&device, &samples, height, width);
                    let output = network.forward(&tensors, inputs, convolutions).into_data();
                    output.as_slice::<f32>().expect("f32")[..state.len()].to_vec()
                };
                let (one, of_two) = (found(1), found(2));
                assert!(
                    one.iter().zip(&of_two).all(|(a, b)| a.to_bits() == b.to_bits()),
                    "{output:?} {convolutions:?}"
                );
                assert!(one.iter().any(|value| value.abs() > 1e-3));
            }
        }
    }

    #[test]
    fn means_are_those_of_the_window_at_any_width() {
        for (height, width) in [(1, 1), (2, 3), (4, 4), (5, 8), (9, 6)] {
            let data: Vec<f32> = (0..height * width * 3).map(|i| (i * i % 23) as f32).collect();
            let found = means_of_columns(&means_of_rows(&data, width), height, width);
            for (i, found) in found.iter().enumerate() {
                let (c, x, y) = (i % 3, i / 3 % width, i / (3 * width));
                let (rows, columns) = (window(y, height).0, window(x, width).0);
                let pixels: Vec<f32> =
                    rows.flat_map(|y| columns.clone().map(move |x| (y * width + x) * 3 + c)).map(|i| data[i]).collect();
                let expected = pixels.iter().sum::<f32>() / pixels.len() as f32;
                assert!((found - expected).abs() < 1e-4, "{height} x {width} at {i}: {found} {expected}");
            }
        }
    }

    #[test]
    fn surroundings_are_those_of_the_window() {
        // A lamp of 50: nothing varies, so that there is nothing to take off.
        let lamp = vec![signed_log1p(50.0); 8 * 8 * 3];
        let around = surroundings(&lamp, 8, 8);
        assert!(around.mean.iter().all(|m| (m - 50.0).abs() < 1e-3) && around.spread.iter().all(|s| s.abs() < 1e-3));
        assert!(contrast(50.0 - around.mean[0], around.spread[0]).abs() < 1e-2);
        // One firefly in the dark sets itself apart, and moves its surroundings little.
        let mut dark = vec![signed_log1p(0.1); 8 * 8 * 3];
        dark[3 * 27] = signed_log1p(1000.0);
        let around = surroundings(&dark, 8, 8);
        assert!(
            around.mean[3 * 27] < 1.0 && contrast(1000.0 - around.mean[3 * 27], around.spread[3 * 27]) > 5.0,
            "{}",
            around.mean[3 * 27]
        );
        assert_eq!(around.mean[3 * 27 + 1], around.mean[1], "other colours see nothing of it");
    }
}
