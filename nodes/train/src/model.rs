//! A trained solver: its weights, what it was trained for, and its predictions. The file is one safetensors blob, the
//! averaged weights under their names, with [`ModelInfo`] as the note `model`.

use crate::{
    device::Place,
    law::{Factors, Law},
    model_rounding::Precision,
    network::{
        Features, Output, Preset,
        features::{Encoding, Sample},
        unet::Unet,
    },
    rollout::Denoiser,
    space::Space,
};
use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use tauflow_contract::{Context, Handle, KindError};
use tauflow_data::{
    Image, SamplerKind, TensorFile,
    methods::{Conditioning, Parameterization},
    records::ModelFile,
    time::{VarianceTime, is_unsaid_exponent, unsaid_exponent},
};
use tauflow_ops::Convolutions;
use tauflow_tensors::Weights;

/// The metadata of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelInfo {
    /// Its parameterization.
    pub parameterization: Parameterization,
    /// Additional input of the network: none (RGB), or G-buffers.
    pub conditioning: Conditioning,
    /// Size of its network.
    pub preset: Preset,
    /// The space that states and predictions are in.
    pub space: Space,
    /// Sample counts of the ladder that it was trained on, increasing.
    pub counts: Vec<u64>,
    /// Training steps.
    pub steps: u64,
    /// The type of its network's output.
    #[serde(default = "Output::unsaid", skip_serializing_if = "Output::is_unsaid")]
    pub output: Output,
    /// Whether it also learned to denoise without being told the sample count.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub unknown_counts: bool,
    /// Its input channels.
    #[serde(default = "Features::unsaid", skip_serializing_if = "Features::is_unsaid")]
    pub features: Features,
    /// The known factor of its targets.
    #[serde(default = "Law::unsaid", skip_serializing_if = "Law::is_unsaid")]
    pub law: Law,
    /// The exponent alpha of the error in its training ladders, which falls with n^-alpha.
    #[serde(default = "unsaid_exponent", skip_serializing_if = "is_unsaid_exponent")]
    pub exponent: f64,
    /// How the samples of its training ladders were drawn.
    #[serde(default = "SamplerKind::unsaid", skip_serializing_if = "SamplerKind::is_independent")]
    pub sampler: SamplerKind,
}

impl ModelInfo {
    /// First sample count of the training ladder.
    pub fn n_min(&self) -> u64 {
        self.counts.first().copied().unwrap_or(0)
    }

    /// Last sample count of the training ladder.
    pub fn n_max(&self) -> u64 {
        self.counts.last().copied().unwrap_or(0)
    }

    /// The factors of the law for its targets, whatever its head has.
    pub(crate) fn exact_factors(&self) -> Result<Factors, KindError> {
        self.factors(Law::Covariances)
    }

    fn factors(&self, law: Law) -> Result<Factors, KindError> {
        Ok(Factors::new(self.parameterization, &self.counts, law)?.with_exponent(self.exponent)?)
    }

    pub(crate) fn encoding(&self) -> Result<Encoding, KindError> {
        if self.output.is_guided() && self.conditioning != Conditioning::Gbuffer {
            let output = self.output.name();
            return Err(KindError::Input(format!(
                "the model has `output: {output}` without G-buffers, which no training makes; it is damaged"
            )));
        }
        Ok(Encoding {
            factors: self.factors(self.law)?,
            space: self.space,
            gbuffer: self.conditioning == Conditioning::Gbuffer,
            features: self.features,
            output: self.output,
            preset: self.preset,
        })
    }
}

/// A trained solver.
pub struct Model {
    info: ModelInfo,
    encoding: Encoding,
    network: Unet,
    weights: Weights,
    tensors: Vec<Tensor<2>>,
    place: Place,
    convolutions: Convolutions,
}

impl Model {
    pub(crate) fn new(info: ModelInfo, weights: Weights, place: &Place) -> Result<Self, KindError> {
        // A prediction frees large tensors all along. The kernel took a fifth of its time to clear them again.
        tauflow_ops::keep_memory();
        let encoding = info.encoding()?;
        let network = encoding.network();
        let tensors = network.slots().tensors(&weights, place.device());
        Ok(Self {
            info,
            encoding,
            network,
            weights,
            tensors,
            place: place.clone(),
            convolutions: Convolutions::Minimal,
        })
    }

    /// The same model with another computation of convolutions.
    pub(crate) fn with_convolutions(self, convolutions: Convolutions) -> Self {
        Self { convolutions, ..self }
    }

    /// Reads a model, to predict on the CPU.
    ///
    /// # Errors
    /// As [`Model::load_to`].
    pub fn load(bytes: &[u8]) -> Result<Self, KindError> {
        Self::load_to(bytes, &Place::cpu())
    }

    /// Loads a model that is in the store, to predict at a place.
    ///
    /// # Errors
    /// As [`Model::load`], and if its blob is missing.
    pub(crate) fn read(ctx: &Context<'_>, file: Handle<'_, ModelFile>, place: &Place) -> Result<Self, KindError> {
        Self::load_to(&file.load(ctx)?.0, place)
    }

    /// Reads a model, to predict at a place.
    ///
    /// # Errors
    /// If the bytes are damaged or of another version.
    pub fn load_to(bytes: &[u8], place: &Place) -> Result<Self, KindError> {
        let damaged = |why: String| {
            KindError::Input(format!("not a model file: {why}; connect the output `model` of a `training` node"))
        };
        let file = TensorFile::from_bytes(bytes).map_err(|e| damaged(e.to_string()))?;
        let note = file.metadata.get("model").ok_or_else(|| damaged("the note `model` is missing".into()))?;
        let info: ModelInfo = serde_json::from_str(note).map_err(|e| damaged(format!("its note `model`: {e}")))?;
        let weights = info.encoding()?.network().slots().read(&file, "")?;
        Self::new(info, weights, place)
    }

    /// The model as bytes; the same model gives the same bytes.
    ///
    /// # Errors
    /// If it cannot be written as safetensors.
    pub fn to_bytes(&self) -> Result<Vec<u8>, KindError> {
        Ok(self.file().to_bytes()?)
    }

    /// The model as bytes, its weights rounded.
    ///
    /// # Errors
    /// If a weight exceeds half precision and does not become an integer.
    pub fn to_rounded_bytes(&self, coarse: Precision) -> Result<Vec<u8>, KindError> {
        Ok(self.file().to_rounded_bytes(|name| coarse == Precision::Integers && Unet::is_coarse(name))?)
    }

    fn file(&self) -> TensorFile {
        let note = serde_json::to_string(&self.info).expect("plain data");
        self.network.slots().write(TensorFile::default().note("model", note), "", &self.weights)
    }

    /// The weights, as the first ones of a training of a model `like` this one. Channels that this one lacks are drawn
    /// from the seed.
    ///
    /// # Errors
    /// If the trained model would differ in what its weights mean.
    pub(crate) fn into_weights_for(self, like: &ModelInfo, seed: u64) -> Result<Weights, KindError> {
        // Weights for `contrast` mean nearly the same for `covered`: only pixels without a surface differ.
        let covers = like.features == Features::Covered;
        let features = |of: Features| if covers && of == Features::Contrast { Features::Covered } else { of };
        // Guided means are shaded means until the guide is learned, which starts as zeros. Smoothed means are nearly
        // guided means until their weights of albedo are learned, and fitted means nearly smoothed means until those of
        // local models are.
        let more = match like.output {
            Output::GuidedMeans => self.info.output == Output::ShadedMeans,
            Output::SmoothedMeans => matches!(self.info.output, Output::ShadedMeans | Output::GuidedMeans),
            Output::FittedMeans => {
                matches!(self.info.output, Output::ShadedMeans | Output::GuidedMeans | Output::SmoothedMeans)
            }
            _ => false,
        };
        let output = |of: Output| if more { like.output } else { of };
        let wider = like.preset.widens(self.info.preset);
        let preset = |of: Preset| if wider { like.preset } else { of };
        let own = |info: &ModelInfo| {
            [
                ("preset", preset(info.preset).name().to_owned()),
                ("conditioning", info.conditioning.name().into()),
                ("parameterization", info.parameterization.name().into()),
                ("space", info.space.name().into()),
                ("output", output(info.output).name().into()),
                ("features", features(info.features).name().into()),
                ("law", info.law.name().into()),
            ]
        };
        match own(&self.info).into_iter().zip(own(like)).find(|(start, wanted)| start != wanted) {
            None => Ok(like.encoding()?.network().slots().adopt(self.network.slots(), &self.weights, seed)),
            Some(((param, start), (_, wanted))) => Err(KindError::Input(format!(
                "the model on input `start` has `{param}: {start}`, but this training has `{param}: {wanted}`; give \
                both the same `{param}`"
            ))),
        }
    }

    /// Its metadata.
    pub fn info(&self) -> &ModelInfo {
        &self.info
    }

    /// How far, in pixels, a prediction looks at most; none if it looks at the whole image.
    pub fn reach(&self) -> Option<usize> {
        self.encoding.reach(&self.network)
    }

    /// The predictions of two images agree where they show the same if their corners are this many pixels apart, or a
    /// multiple of it.
    pub fn multiple(&self) -> usize {
        self.network.multiple()
    }

    /// Number of weights.
    pub fn weights(&self) -> usize {
        self.network.slots().count()
    }

    /// Predictions for a batch of states [H, W, 3] of one shape, each with its G-buffer and its time, or none if the
    /// sample count is unknown.
    ///
    /// # Errors
    /// If shapes differ, G-buffers are missing where the model needs them, or it must be told the sample count.
    pub fn predict_batch(
        &self,
        states: &[&Image],
        gbuffers: &[Option<&Image>],
        tau: &[Option<f64>],
    ) -> Result<Vec<Image>, KindError> {
        let Some(first) = states.first() else { return Ok(Vec::new()) };
        if states.len() != gbuffers.len() || states.len() != tau.len() {
            return Err(KindError::Internal("a batch of states needs as many G-buffers and times".into()));
        }
        if tau.contains(&None) && !self.info.unknown_counts {
            return Err(KindError::Input(
                "the model must be told the sample count of its input, within its ladder; give the count, or train \
                with `unknown_counts` above 0"
                    .into(),
            ));
        }
        let (width, height) = (first.width(), first.height());
        let multiple = self.network.multiple();
        let padded = (width.next_multiple_of(multiple), height.next_multiple_of(multiple));
        let mut planes = Vec::with_capacity(states.len());
        for (state, gbuffer) in states.iter().zip(gbuffers) {
            if !state.same_shape(first) || state.channels() != 3 {
                return Err(shape_error("a state", state, first));
            }
            let gbuffer = if self.encoding.gbuffer { Some(self.checked(*gbuffer, state)?) } else { None };
            planes.push((pad(state, padded), gbuffer.map(|g| pad(g, padded))));
        }
        let samples: Vec<Sample<'_>> = planes
            .iter()
            .zip(tau)
            .map(|((state, gbuffer), tau)| Sample { state, gbuffer: gbuffer.as_deref(), tau: *tau })
            .collect();
        let inputs = self.encoding.inputs(self.place.device(), &samples, padded.1, padded.0);
        let output = self.network.forward(&self.tensors, inputs, self.convolutions).into_data();
        let values = output.as_slice::<f32>().map_err(|e| KindError::Internal(format!("network output: {e:?}")))?;
        let crop = |values: &[f32]| {
            let rows: Vec<&[f32]> =
                values.chunks_exact(3 * padded.0).take(height).map(|row| &row[..3 * width]).collect();
            Ok(Image::from_data(width, height, 3, rows.concat())?)
        };
        values.chunks_exact(3 * padded.0 * padded.1).map(crop).collect()
    }

    fn checked<'a>(&self, gbuffer: Option<&'a Image>, state: &Image) -> Result<&'a Image, KindError> {
        let gbuffer = gbuffer.ok_or_else(|| {
            KindError::Input("the model needs G-buffers, but the state has none; connect them".into())
        })?;
        if (gbuffer.width(), gbuffer.height(), gbuffer.channels()) != (state.width(), state.height(), 6) {
            return Err(shape_error("a G-buffer", gbuffer, state));
        }
        Ok(gbuffer)
    }
}

impl Denoiser for Model {
    fn parameterization(&self) -> Parameterization {
        self.info.parameterization
    }

    fn space(&self) -> Space {
        self.info.space
    }

    fn clock(&self) -> VarianceTime {
        self.encoding.factors.clock()
    }

    fn next(&self, count: f64) -> f64 {
        self.encoding.factors.next(count)
    }

    fn predict(&self, state: &Image, gbuffer: Option<&Image>, tau: Option<f64>) -> Result<Image, KindError> {
        let mut images = self.predict_batch(&[state], &[gbuffer], &[tau])?;
        images.pop().ok_or_else(|| KindError::Internal("the network gave no image".into()))
    }
}

fn shape_error(what: &str, image: &Image, expected: &Image) -> KindError {
    KindError::Input(format!(
        "{what} has {} x {} pixels of {} values, expected {} x {}; render both with the same `resolution`",
        image.width(),
        image.height(),
        image.channels(),
        expected.width(),
        expected.height()
    ))
}

/// The image's values with its last column and row repeated up to a size.
fn pad(image: &Image, (width, height): (usize, usize)) -> Cow<'_, [f32]> {
    if (width, height) == (image.width(), image.height()) {
        return Cow::Borrowed(image.data());
    }
    let mut data = Vec::with_capacity(width * height * image.channels());
    for y in 0..height {
        for x in 0..width {
            data.extend_from_slice(image.pixel(x.min(image.width() - 1), y.min(image.height() - 1)));
        }
    }
    Cow::Owned(data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::{rng::Stream, time::INDEPENDENT_EXPONENT};

    fn info(output: Output) -> ModelInfo {
        ModelInfo {
            parameterization: Parameterization::McNoise,
            conditioning: Conditioning::Gbuffer,
            preset: Preset::Tiny,
            space: Space::Log1p,
            counts: vec![1, 4, 16],
            steps: 1,
            output,
            unknown_counts: false,
            features: Features::Contrast,
            law: Law::Limits,
            exponent: INDEPENDENT_EXPONENT,
            sampler: SamplerKind::Independent,
        }
    }

    #[test]
    fn files_say_what_the_networks_numbers_are_where_they_are_not_as_ever() {
        for output in Output::ALL {
            let weights = info(output).encoding().expect("a ladder").network().slots().draw(3);
            let model = Model::new(info(output), weights, &Place::cpu()).expect("fits");
            let bytes = model.to_bytes().expect("plain numbers");
            let text = String::from_utf8_lossy(&bytes[..2048]).into_owned();
            assert_eq!(text.contains("output"), output != Output::Means, "{output:?}");
            for (precision, most) in [(Precision::Half, 0.55), (Precision::Integers, 0.45)] {
                let halves = model.to_rounded_bytes(precision).expect("small weights");
                let rounded = Model::load(&halves).expect("sound");
                assert!((halves.len() as f64) < bytes.len() as f64 * most, "{} of {}", halves.len(), bytes.len());
                assert!(rounded.to_rounded_bytes(precision).expect("small weights") == halves);
            }
            let read = Model::load_to(&bytes, &Place::cpu()).expect("sound");
            assert_eq!(read.info(), model.info());
            // Weights that are zero at first: means of pixels for two of them, no noise at all for the third.
            let state = Image::from_data(8, 8, 3, (0..192).map(|i| (i % 7) as f32 / 7.0).collect()).expect("fits");
            let predicted = read.predict(&state, Some(&Image::new(8, 8, 6)), Some(0.0)).expect("fits");
            assert_eq!(predicted.data().iter().all(|v| *v == 0.0), output == Output::Values, "{output:?}");
            let untold = read.predict(&state, Some(&Image::new(8, 8, 6)), None).expect_err("it did not learn that");
            assert!(untold.to_string().contains("unknown_counts"), "{untold}");
        }
        for output in [Output::GuidedMeans, Output::SmoothedMeans, Output::FittedMeans] {
            let blind = ModelInfo { conditioning: Conditioning::Rgb, ..info(output) };
            let told = blind.encoding().expect_err("no G-buffers to guide").to_string();
            assert!(told.contains(output.name()), "{told}");
        }
    }

    #[test]
    fn a_wider_network_starts_as_the_one_that_it_starts_from() {
        let best = ModelInfo { preset: Preset::Best, unknown_counts: true, ..info(Output::SmoothedMeans) };
        let wide = ModelInfo { preset: Preset::Wide, ..best.clone() };
        // No weight is zero, or what it leads to would not be compared.
        let mut weights = best.encoding().expect("a ladder").network().slots().draw(3);
        for (slot, values) in weights.0.iter_mut().enumerate() {
            let mut stream = Stream::new(5, &[slot as u64]);
            values.iter_mut().filter(|value| **value == 0.0).for_each(|v| *v = stream.range(-0.05, 0.05) as f32);
        }
        let narrow = Model::new(best.clone(), weights, &Place::cpu()).expect("fits");
        let state = Image::from_data(32, 16, 3, (0..1536).map(|i| (i % 37) as f32 / 37.0).collect()).expect("fits");
        let gbuffer = Image::from_data(32, 16, 6, (0..3072).map(|i| (i % 53) as f32 / 53.0).collect()).expect("fits");
        let of = |model: &Model| model.predict(&state, Some(&gbuffer), Some(0.25)).expect("fits");
        let expected = of(&narrow);
        assert!(expected.data().iter().any(|value| value.abs() > 0.1));
        let copy = |model: &Model| Model::load(&model.to_bytes().expect("plain numbers")).expect("sound");
        let [first, second] = [1, 2].map(|seed| copy(&narrow).into_weights_for(&wide, seed).expect("wider"));
        assert!(first != second, "new channels are drawn");
        let widened = Model::new(wide.clone(), first, &Place::cpu()).expect("fits");
        assert!(widened.weights() > narrow.weights());
        for (found, expected) in of(&widened).data().iter().zip(expected.data()) {
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
        let told = widened.into_weights_for(&best, 1).expect_err("narrower").to_string();
        assert!(told.contains("`preset: wide`") && told.contains("`preset: best`"), "{told}");
        let tiny = ModelInfo { preset: Preset::Tiny, ..best.clone() };
        assert!(narrow.into_weights_for(&tiny, 1).is_err());
    }
}
