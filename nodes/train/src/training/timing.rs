//! Times of the network by itself, for benches: no kind reads a clock through these.

#![expect(clippy::disallowed_methods, reason = "it measures, for benches alone")]

use super::{Convolving, DataSet, Decay, Draw, Rates, Trainer};
use crate::{
    device::Place,
    law::Law,
    model::{Model, ModelInfo},
    network::{Features, Loss, Output, Preset},
    rollout::Denoiser,
    space::Space,
};
use std::time::Instant;
use tauflow_contract::KindError;
use tauflow_data::{
    Image, SamplerKind,
    methods::{Conditioning, Parameterization},
    records::PackedScene,
    time::INDEPENDENT_EXPONENT,
};

fn info(preset: Preset) -> ModelInfo {
    ModelInfo {
        parameterization: Parameterization::McNoise,
        conditioning: Conditioning::Gbuffer,
        preset,
        space: Space::Linear,
        counts: vec![1, 4, 16],
        steps: 1,
        output: Output::Means,
        unknown_counts: false,
        features: Features::Contrast,
        law: Law::Limits,
        exponent: INDEPENDENT_EXPONENT,
        sampler: SamplerKind::Independent,
    }
}

/// Number of weights of the network that is timed.
///
/// # Errors
/// None: the made-up ladder is one.
pub fn weights(preset: Preset) -> Result<usize, KindError> {
    Ok(info(preset).encoding()?.network().slots().count())
}

fn image(side: usize, period: usize) -> Result<Image, KindError> {
    Ok(Image::from_data(side, side, 3, (0..side * side * 3).map(|i| (i % period) as f32 / 40.0).collect())?)
}

fn scene(side: usize) -> Result<PackedScene, KindError> {
    let states = [97, 89, 83].into_iter().map(|period| image(side, period)).collect::<Result<_, _>>()?;
    Ok(PackedScene {
        counts: vec![1, 4, 16],
        states,
        gbuffer: Some(Image::new(side, side, 6)),
        sampler: Default::default(),
    })
}

/// Milliseconds of each of some training steps with G-buffers on a made-up batch of `side` x `side` pixels, drawn anew
/// for each, and of drawing it; on the threads of the rayon pool that this is called in.
///
/// # Errors
/// If the loss is no longer finite.
pub fn training_steps(
    place: &Place,
    preset: Preset,
    batch: usize,
    side: usize,
    steps: usize,
    convolving: Convolving,
) -> Result<Vec<[f64; 2]>, KindError> {
    let rates = Rates {
        learning_rate: 1e-4,
        betas: [0.9, 0.999],
        warmup: 5,
        clip: 1.0,
        ema: 0.999,
        decay: Decay::None,
        steps: steps as u64,
        weight_decay: 0.0,
    };
    let mut trainer =
        Trainer::new(info(preset).encoding()?, rates, (Loss::Squared, convolving.convolutions()), (1, None), place);
    let set = DataSet::new(vec![("made-up", scene(2 * side)?)], "train", Conditioning::Gbuffer)?;
    let draw = Draw { seed: 1, batch, side, exposure_jitter: 1.0, permute_colours: true, ..Draw::PLAIN };
    let milliseconds = |from: Instant| 1000.0 * from.elapsed().as_secs_f64();
    (0..steps as u64)
        .map(|step| {
            let start = Instant::now();
            let batch = set.draw(&trainer.encoding, &draw, step);
            let drawn = milliseconds(start);
            trainer.step(&batch)?;
            Ok([milliseconds(start), drawn])
        })
        .collect()
}

/// Milliseconds of each of some predictions with G-buffers of an image of `side` x `side` pixels.
///
/// # Errors
/// If the network cannot be made.
pub fn predictions(place: &Place, preset: Preset, side: usize, times: usize) -> Result<Vec<f64>, KindError> {
    let info = info(preset);
    let weights = info.encoding()?.network().slots().draw(1);
    let model = Model::new(info, weights, place)?;
    let (state, gbuffer) = (image(side, 97)?, Image::new(side, side, 6));
    (0..times)
        .map(|_| {
            let start = Instant::now();
            model.predict(&state, Some(&gbuffer), Some(0.0))?;
            Ok(1000.0 * start.elapsed().as_secs_f64())
        })
        .collect()
}
