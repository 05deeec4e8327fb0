#![doc = include_str!("transport_adapter.md")]

use crate::{
    adapter::{Adapter, AdapterInfo, AdapterNetwork, Residuals},
    backbone::{Backbone, encoded},
    course::{base, unit_time},
    learning::{self, Learning, Numbers},
    loss::{Rho, mean_loss},
    pictures::{self, Rungs},
    schedule::{FIRST, Sampler},
    trainer::Trainer,
};
use burn::tensor::{Tensor, TensorData};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::{ops::Range, sync::Arc};
use tauflow_contract::{
    Action, All, Artifact, Basis, Context, Digest, Each, Group, Kind, KindError, KindSpec, Media, MemoKey, Mode, Out,
    Outputs,
};
use tauflow_data::{
    Image, TensorFile, VarianceTime,
    records::{AdapterFile, BackboneFiles, Family, PackedScene, TrainingLog, TrainingTiming},
    rng::Stream,
};
use tauflow_tensors::{Checkpoints, Decay, Rates, Share};

/// Raised with every change of what a training computes: neither results nor checkpoints of before count then.
const VERSION: u32 = 3;

/// The kind `transport_adapter`.
pub struct TransportAdapter;

/// Params of `transport_adapter`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TransportAdapterParams {
    /// Residuals to learn: of rendering, or of a control.
    pub residuals: Residuals,
    /// Clamp the clean images of a DDPM to their range.
    pub clamp_clean: bool,
    /// Training steps.
    #[schemars(range(min = 1))]
    pub steps: u64,
    /// Number of training images per step.
    #[schemars(range(min = 1, max = 4096))]
    pub batch: usize,
    /// Maximum side of the training windows in pixels.
    #[schemars(range(min = 2))]
    pub crop: usize,
    /// Learning rate after the warm-up.
    #[schemars(range(min = 1e-9, max = 1.0))]
    pub learning_rate: f64,
    /// Decay of the learning rate after the warm-up.
    pub decay: Decay,
    /// Steps over which the learning rate rises from 0.
    pub warmup: u64,
    /// Weight decay of AdamW: each step subtracts this share of the weights, times the learning rate.
    #[schemars(range(min = 0.0, max = 10.0))]
    pub weight_decay: f64,
    /// Maximum norm of the gradient.
    #[schemars(range(min = 1e-6, max = 1e9))]
    pub clip: f64,
    /// Share that the average of the weights keeps in each step.
    #[schemars(range(min = 0.0, max = 0.999_999))]
    pub ema: f64,
    /// The constant c of the loss: it is quadratic for smaller errors and linear for larger ones.
    #[schemars(range(min = 1e-6, max = 1e3))]
    pub huber: f64,
    /// Weight of the squared correction in the loss.
    #[schemars(range(min = 0.0, max = 1e3))]
    pub lambda: f64,
    /// Steps between points of the loss curve.
    #[schemars(range(min = 1))]
    pub log_every: u64,
    /// Steps between checkpoints.
    #[schemars(range(min = 1))]
    pub checkpoint_every: u64,
}

impl Default for TransportAdapterParams {
    fn default() -> Self {
        Self {
            residuals: Residuals::Rendered,
            clamp_clean: true,
            steps: 4000,
            batch: 8,
            crop: 64,
            learning_rate: 1e-4,
            decay: Decay::None,
            warmup: 100,
            weight_decay: 0.01,
            clip: 1.0,
            ema: 0.999,
            huber: 0.03,
            lambda: 0.01,
            log_every: 100,
            checkpoint_every: 500,
        }
    }
}

const BACKBONES: Each<BackboneFiles> = Each::new("backbone", "The backbones whose predictions are corrected.");
const TRAIN: All<PackedScene> = All::new("train", "Scenes whose rungs are the rendering endpoints.");
const MAIN: Group = Group::main(VERSION);
const ADAPTER: Out<AdapterFile> = Out::new(MAIN, "adapter", "The averaged weights.");
const LOG: Out<TrainingLog> = Out::new(MAIN, "log", "The loss curve.");
const TIMING: Out<TrainingTiming> = Out::new(MAIN, "timing", "Wall time per step.").measured();

impl Kind for TransportAdapter {
    type Params = TransportAdapterParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "transport_adapter",
            summary: "Trains an adapter that corrects a frozen generative backbone with residuals of renders.",
            manual: include_str!("transport_adapter.md"),
            mode: Mode::Map,
            inputs: vec![BACKBONES.port(), TRAIN.port()],
            outputs: vec![ADAPTER.port(), LOG.port(), TIMING.port()],
            seeded: true,
        }
    }

    fn work(params: &Self::Params, _group: &str) -> f64 {
        let crop = params.crop as f64;
        params.steps as f64 * params.batch as f64 * crop * crop
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        let handle = action.handle(BACKBONES)?;
        let digest = handle.artifact().digest();
        let backbone = Backbone::load(&handle.load(ctx)?)?;
        let scenes = action.all(TRAIN)?;
        let mut share = Share::new();
        let set = Set::load(ctx, &backbone, digest, action, &mut share)?;
        let info = AdapterInfo {
            backbone: digest,
            family: backbone.family(),
            residuals: params.residuals,
            clamp_clean: params.clamp_clean,
            counts: set.counts.clone(),
            steps: params.steps,
        };
        let network = AdapterNetwork::new();
        let start = network.slots().draw(action.seed);
        let mut trainer = Trainer::new(network.slots().clone(), start, params.rates());
        // How many steps follow matters only to a rate that falls towards the last.
        let steps = if params.decay == Decay::None { 0 } else { params.steps };
        let telling = TransportAdapterParams { steps, ..params.clone() };
        let basis = Basis::new("transport_adapter", VERSION, "checkpoint");
        let basis = basis.with(serde_json::to_value(telling).expect("plain data"), Some(action.seed));
        let inputs = vec![digest, scenes.digest()];
        let checkpoints = Checkpoints { basis, inputs, every: params.checkpoint_every };
        let numbers = Numbers {
            steps: params.steps,
            log_every: params.log_every,
            keep_last: params.decay == Decay::None,
            note: serde_json::to_string(&info).expect("plain data"),
        };
        let (rho, lambda) = (Rho::PseudoHuber(params.huber as f32), params.lambda as f32);
        let learning = Learning { ctx, checkpoints: &checkpoints, numbers };
        let (points, timing) = learning.run(&mut trainer, &mut share, |trainer, step| {
            let parts: Vec<Part> =
                learning::parts(params.batch).map(|part| set.part(params, action.seed, step, part)).collect();
            let count = parts.iter().map(|part| part.target.len()).sum();
            trainer.step(&parts, |part, weights| {
                let shape = [part.times.len(), part.side, part.side, 3];
                let x = Tensor::from_data(TensorData::new(part.bases.clone(), shape), &weights[0].device());
                let prediction = network.forward(weights, x, &part.times);
                Ok(mean_loss(prediction, part.target.clone(), count, rho, lambda))
            })
        })?;
        let weights = trainer.slots.count();
        let sort = format!("adapter-{}-{}", backbone.family().name(), params.residuals.name());
        let log = learning::log(&sort, "adapter", (weights, params.steps), params, points);
        let adapter = Adapter::new(info, trainer.state.average);
        Ok(Outputs::default()
            .put(ADAPTER, AdapterFile(adapter.to_bytes()?).store(ctx)?)
            .put(LOG, log.store(ctx)?)
            .put(TIMING, timing.store(ctx)?))
    }
}

impl TransportAdapterParams {
    fn rates(&self) -> Rates {
        Rates {
            learning_rate: self.learning_rate,
            betas: [0.9, 0.999],
            warmup: self.warmup,
            clip: self.clip,
            ema: self.ema,
            decay: self.decay,
            steps: self.steps,
            weight_decay: self.weight_decay,
        }
    }
}

/// The time of a sampler that a variance time is mapped to.
fn mapped(sampler: &Sampler, tau: f64) -> f64 {
    match sampler {
        Sampler::Ddpm { schedule, .. } => ((schedule.times() - 1) as f64 * (1.0 - tau)).round(),
        Sampler::Euler { .. } => FIRST + (1.0 - FIRST) * tau,
    }
}

/// The target of rendering in a family's coordinate.
fn target(family: Family, state: f32, last: f32, tau: f64) -> f32 {
    match family {
        Family::Ddpm => state - last,
        Family::RectifiedFlow => (last - state) / (1.0 - tau) as f32,
    }
}

/// All frozen predictions, and what rendering would add to them.
struct Set {
    counts: Vec<u64>,
    /// Of each rung below the last, from 0 to 1.
    times: Vec<f64>,
    /// By scene and rung.
    bases: Vec<Vec<Image>>,
    /// By scene and rung.
    residuals: Vec<Vec<Image>>,
    /// Deviation of the residuals of each rung.
    deviations: Vec<f64>,
}

/// Part of a batch.
struct Part {
    bases: Vec<f32>,
    times: Vec<f64>,
    side: usize,
    target: Arc<[f32]>,
}

impl Set {
    fn load(
        ctx: &Context<'_>,
        backbone: &Backbone,
        digest: Digest,
        action: &Action<'_, TransportAdapterParams>,
        share: &mut Share,
    ) -> Result<Self, KindError> {
        let scenes = action.all(TRAIN)?;
        let params = &action.params;
        let family = backbone.family();
        let rungs = pictures::load(ctx, scenes, TRAIN, usize::MAX)?;
        let counts = rungs[0].counts.clone();
        let (Some(first), Some(last)) = (counts.first(), counts.last()) else {
            return Err(KindError::Input("the scenes have no rungs".into()));
        };
        let clock = VarianceTime::new(*first, *last)?;
        if params.residuals == Residuals::Shuffled && rungs.len() < 2 {
            return Err(KindError::Input("shuffled residuals need at least two scenes; connect more".into()));
        }
        // How many steps a sampler takes does not matter here: only its times do.
        let sampler = backbone.sampler(1);
        let taus: Vec<f64> = counts[..counts.len() - 1].iter().map(|count| clock.tau(*count as f64)).collect();
        let (mut bases, mut residuals) = (Vec::new(), Vec::new());
        let total = rungs.len() as u64;
        for ((_, handle), Rungs { pictures, .. }) in scenes.iter().zip(rungs) {
            ctx.check_cancelled()?;
            let states: Vec<Image> = pictures.iter().map(|p| p.map(|v| encoded(family, v))).collect();
            let scene = handle.artifact().digest();
            let own =
                share.run(|| predictions(ctx, backbone, digest, (scene, params.clamp_clean), &states, &taus))??;
            let last = &states[states.len() - 1];
            let of_rung = |((state, base), tau): ((&Image, &Image), &f64)| {
                let numbers = state.data().iter().zip(last.data()).zip(base.data());
                let data = numbers.map(|((state, last), base)| target(family, *state, *last, *tau) - base).collect();
                Image::from_data(base.width(), base.height(), 3, data)
            };
            residuals.push(states.iter().zip(&own).zip(&taus).map(of_rung).collect::<Result<Vec<_>, _>>()?);
            bases.push(own);
            ctx.progress(bases.len() as u64, total, "frozen predictions");
        }
        let deviation = |rung: usize| {
            let values = residuals.iter().flat_map(|scene: &Vec<Image>| scene[rung].data());
            let (sum, square, count) = values.fold((0.0, 0.0, 0u64), |(sum, square, count), value| {
                let value = f64::from(*value);
                (sum + value, square + value * value, count + 1)
            });
            let mean = sum / count as f64;
            (square / count as f64 - mean * mean).max(0.0).sqrt()
        };
        let deviations = (0..taus.len()).map(deviation).collect();
        let times = taus.iter().map(|tau| unit_time(&sampler, mapped(&sampler, *tau))).collect();
        Ok(Self { counts, times, bases, residuals, deviations })
    }

    fn part(&self, params: &TransportAdapterParams, seed: u64, step: u64, indices: Range<usize>) -> Part {
        let first = &self.bases[0][0];
        let side = params.crop.min(first.width()).min(first.height()) / 2 * 2;
        let (mut bases, mut target) = (Vec::new(), Vec::new());
        let mut times = Vec::new();
        for index in indices {
            let mut stream = Stream::new(seed, &[step, index as u64]).part("example");
            let (scene, rung) = (stream.below(self.bases.len()), stream.below(self.times.len()));
            let (x, y) = (stream.below(first.width() - side + 1), stream.below(first.height() - side + 1));
            let cut = |image: &Image, to: &mut Vec<f32>| {
                let row = |line: usize| {
                    let from = ((y + line) * image.width() + x) * 3;
                    &image.data()[from..from + 3 * side]
                };
                (0..side).for_each(|line| to.extend_from_slice(row(line)));
            };
            cut(&self.bases[scene][rung], &mut bases);
            times.push(self.times[rung]);
            match params.residuals {
                Residuals::Rendered => cut(&self.residuals[scene][rung], &mut target),
                Residuals::Shuffled => {
                    let other = (scene + 1 + stream.below(self.bases.len() - 1)) % self.bases.len();
                    cut(&self.residuals[other][rung], &mut target);
                }
                Residuals::Gaussian => {
                    let deviation = self.deviations[rung];
                    target.extend((0..side * side * 3).map(|_| (deviation * stream.normal()) as f32));
                }
            }
        }
        Part { bases, times, side, target: target.into() }
    }
}

/// The frozen predictions for a scene's rungs below the last, in the adapter's coordinate: made once for a backbone and
/// a scene, whatever is trained on them.
fn predictions(
    ctx: &Context<'_>,
    backbone: &Backbone,
    digest: Digest,
    (scene, clamp_clean): (Digest, bool),
    states: &[Image],
    taus: &[f64],
) -> Result<Vec<Image>, KindError> {
    let basis = Basis::new("transport_adapter", VERSION, "base").with(json!({ "clamp_clean": clamp_clean }), None);
    let key = MemoKey { basis, inputs: vec![digest, scene] };
    let name = |rung: usize| format!("rung-{rung:03}");
    let kept = ctx.memo_get(&key).and_then(|artifact| {
        // Predictions that cannot be read are made again.
        let file = TensorFile::from_bytes(&ctx.part(&artifact, "").ok()?).ok()?;
        (0..taus.len()).map(|rung| file.image(&name(rung)).ok()).collect::<Option<Vec<_>>>()
    });
    if let Some(kept) = kept.filter(|kept| kept.iter().zip(states).all(|(a, b)| a.same_shape(b))) {
        return Ok(kept);
    }
    let sampler = backbone.sampler(1);
    let mut made = Vec::with_capacity(taus.len());
    for (state, tau) in states.iter().zip(taus) {
        ctx.check_cancelled()?;
        let time = mapped(&sampler, *tau);
        let prediction = backbone.predict(&[state], &[time])?.remove(0);
        let data = base(&sampler, state.data(), prediction.data(), time, clamp_clean);
        made.push(Image::from_data(state.width(), state.height(), 3, data)?);
    }
    let file = made.iter().enumerate().fold(TensorFile::default(), |file, (i, image)| file.with_image(&name(i), image));
    let blob = ctx.put(&file.to_bytes()?)?;
    ctx.memo_put(&key, &Artifact::blob("tauflow/frozen-predictions", blob))?;
    Ok(made)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schedule::{Ddpm, DdpmConfig};

    /// Three scenes with two rungs, whose residuals tell where they come from.
    fn set() -> Set {
        let image = |value: f32| Image::new(4, 4, 3).map(|_| value);
        let images =
            |first: f32| (0..3).map(|s| (0..2).map(|r| image(first + (10 * s + r) as f32)).collect()).collect();
        Set {
            counts: vec![1, 2, 4],
            times: vec![0.75, 0.5],
            bases: images(100.0),
            residuals: images(0.0),
            deviations: vec![0.5, 2.0],
        }
    }

    #[test]
    fn examples_pair_a_prediction_with_the_residual_that_is_asked_for() {
        let set = set();
        let of = |residuals, index| {
            let params = TransportAdapterParams { residuals, crop: 4, ..TransportAdapterParams::default() };
            let Part { bases, times, side, target } = set.part(&params, 3, 7, index..index + 1);
            assert_eq!((side, bases.len(), target.len(), times.len()), (4, 48, 48, 1));
            let (scene, rung) = ((bases[0] - 100.0) as usize / 10, (bases[0] - 100.0) as usize % 10);
            assert_eq!(times[0], set.times[rung], "the time of its rung");
            (scene, rung, target)
        };
        let mut squares = [(0.0, 0); 2];
        for index in 0..400 {
            let (scene, rung, target) = of(Residuals::Rendered, index);
            assert!(target.iter().all(|value| *value == (10 * scene + rung) as f32), "its own residual");
            let (scene, rung, target) = of(Residuals::Shuffled, index);
            let other = target[0] as usize / 10;
            assert!(other != scene && target.iter().all(|value| *value == (10 * other + rung) as f32), "same rung");
            let (_, rung, target) = of(Residuals::Gaussian, index);
            squares[rung].0 += target.iter().map(|value| f64::from(*value).powi(2)).sum::<f64>();
            squares[rung].1 += target.len();
        }
        for ((sum, count), deviation) in squares.into_iter().zip(&set.deviations) {
            // About 9,600 numbers: the standard error of the deviation is 0.7%.
            let found = (sum / count as f64).sqrt();
            assert!((found / deviation - 1.0).abs() < 0.05, "{found} {deviation}");
        }
    }

    #[test]
    fn rungs_fall_on_the_times_that_they_should() {
        let ddpm = Sampler::Ddpm { schedule: Ddpm::new(&DdpmConfig::default()), steps: 1 };
        let clock = VarianceTime::new(1, 512).expect("a ladder");
        let times: Vec<f64> = (0..9).map(|i| mapped(&ddpm, clock.tau(f64::from(1 << i)))).collect();
        assert_eq!(times, [999.0, 693.0, 476.0, 323.0, 215.0, 139.0, 84.0, 46.0, 19.0]);
        let euler = Sampler::Euler { steps: 1 };
        assert_eq!(mapped(&euler, 0.0), 1e-3);
        assert!((mapped(&euler, 1.0) - 1.0).abs() < 1e-12);
        assert_eq!(target(Family::Ddpm, 0.5, 0.2, 0.3), 0.3);
        assert!((target(Family::RectifiedFlow, 0.5, 0.2, 0.7) + 1.0).abs() < 1e-6);
    }
}
