#![doc = include_str!("generative_training.md")]

use crate::{
    backbone::{Config, encoded},
    learning::{self, Learning, Numbers},
    loss::{Rho, mean_loss},
    network::{NcsnppConfig, Network, Unet2dConfig, slots},
    pictures,
    schedule::{Ddpm, DdpmConfig, FIRST, SCALE},
    trainer::Trainer,
};
use burn::tensor::{Tensor, TensorData};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::{
    Action, All, Basis, Context, Facts, Group, Kind, KindError, KindSpec, Known, MOST_ITEMS, Media, Mode, Out, Outlook,
    Outputs, ParamProblem, Resources,
};
use tauflow_data::{
    Image,
    records::{BackboneFiles, Family, PackedScene, TrainingLog, TrainingTiming},
    rng::Stream,
};
use tauflow_tensors::{Checkpoints, Decay, Rates, Share};

/// Raised with every change of what a training computes: neither results nor checkpoints of before count then.
const VERSION: u32 = 4;

/// The kind `generative_training`.
pub struct GenerativeTraining;

/// Params of `generative_training`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GenerativeTrainingParams {
    /// Type of the backbone.
    pub family: Family,
    /// Channels of the first resolution.
    #[schemars(range(min = 16, max = 512))]
    pub width: usize,
    /// Training steps; 0 trains no backbone.
    pub steps: u64,
    /// Number of training images per step.
    #[schemars(range(min = 1, max = 4096))]
    pub batch: usize,
    /// Learning rate after the warm-up.
    #[schemars(range(min = 1e-9, max = 1.0))]
    pub learning_rate: f64,
    /// Decay of the learning rate after the warm-up.
    pub decay: Decay,
    /// Steps over which the learning rate rises from 0.
    pub warmup: u64,
    /// Maximum norm of the gradient.
    #[schemars(range(min = 1e-6, max = 1e9))]
    pub clip: f64,
    /// Share that the average of the weights keeps in each step.
    #[schemars(range(min = 0.0, max = 0.999_999))]
    pub ema: f64,
    /// Also train on horizontally mirrored images.
    pub mirror: bool,
    /// Steps between points of the loss curve.
    #[schemars(range(min = 1))]
    pub log_every: u64,
    /// Steps between checkpoints.
    #[schemars(range(min = 1))]
    pub checkpoint_every: u64,
}

impl Default for GenerativeTrainingParams {
    fn default() -> Self {
        Self {
            family: Family::Ddpm,
            width: 32,
            steps: 10_000,
            batch: 16,
            learning_rate: 3e-4,
            decay: Decay::Cosine,
            warmup: 200,
            clip: 1.0,
            ema: 0.999,
            mirror: true,
            log_every: 100,
            checkpoint_every: 500,
        }
    }
}

const TRAIN: All<PackedScene> = All::new("train", "Scenes whose last rungs are the training images.");
const MAIN: Group = Group::main(VERSION);
const BACKBONE: Out<BackboneFiles> = Out::new(MAIN, "backbone", "The averaged weights, as a checkpoint.");
const LOG: Out<TrainingLog> = Out::new(MAIN, "log", "The loss curve.");
const TIMING: Out<TrainingTiming> = Out::new(MAIN, "timing", "Wall time per step.").measured();

/// Largest width of networks here is a multiple of this, so that groups are whole.
const GROUPS: usize = 16;

impl Kind for GenerativeTraining {
    type Params = GenerativeTrainingParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "generative_training",
            summary: "Trains a small generative backbone, DDPM or Rectified Flow, on renders.",
            manual: include_str!("generative_training.md"),
            mode: Mode::Gather,
            inputs: vec![TRAIN.port()],
            outputs: vec![BACKBONE.port(), LOG.port(), TIMING.port()],
            seeded: true,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        if params.width.is_multiple_of(GROUPS) {
            return Vec::new();
        }
        let hint = format!("use {}", params.width.next_multiple_of(GROUPS));
        vec![ParamProblem::new("/width", format!("{} is no multiple of {GROUPS}", params.width), hint)]
    }

    fn foresee(params: &Self::Params, _known: &Known) -> Outlook {
        let items = Facts::default().with(MOST_ITEMS, u64::from(params.steps > 0));
        Outlook::default().with(BACKBONE, items.clone()).with(LOG, items.clone()).with(TIMING, items)
    }

    fn work(params: &Self::Params, _group: &str) -> f64 {
        params.steps as f64 * params.batch as f64
    }

    fn resources(_params: &Self::Params, _group: &str) -> Resources {
        Resources::default().cores(2).memory(4 << 30)
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        let scenes = action.all(TRAIN)?;
        if params.steps == 0 {
            return Ok(Outputs::default().put_all(BACKBONE, []).put_all(LOG, []).put_all(TIMING, []));
        }
        let family = params.family;
        let rungs = pictures::load(ctx, scenes, TRAIN, 1)?;
        let pictures: Vec<Image> =
            rungs.into_iter().flat_map(|scene| scene.pictures).map(|p| p.map(|v| encoded(family, v))).collect();
        let first = &pictures[0];
        let side = first.width();
        if first.height() != side {
            return Err(KindError::Input(format!(
                "pictures of {side} x {} pixels; render squares, for example `resolution: [32, 32]`",
                first.height()
            )));
        }
        let config = match family {
            Family::Ddpm => Config::Ddpm(Box::new(Unet2dConfig::small(side, params.width)), Box::default()),
            Family::RectifiedFlow => Config::RectifiedFlow(Box::new(NcsnppConfig::small(side, params.width))),
        };
        if side < 8 || !side.is_multiple_of(config.multiple()) {
            return Err(KindError::Input(format!(
                "pictures of {side} pixels a side; use at least 8, and a multiple of {}",
                config.multiple()
            )));
        }
        let network = config.network();
        let slots = slots(network.parameters());
        let start = slots.draw(action.seed);
        let mut trainer = Trainer::new(slots, start, params.rates());
        let basis = Basis::new("generative_training", VERSION, "checkpoint");
        // How many steps follow matters only to a rate that falls towards the last.
        let steps = if params.decay == Decay::None { 0 } else { params.steps };
        let telling = GenerativeTrainingParams { steps, ..params.clone() };
        let basis = basis.with(serde_json::to_value(telling).expect("plain data"), Some(action.seed));
        let checkpoints = Checkpoints { basis, inputs: vec![scenes.digest()], every: params.checkpoint_every };
        let examples = Examples { pictures, params, seed: action.seed, schedule: Ddpm::new(&DdpmConfig::default()) };
        let numbers = Numbers {
            steps: params.steps,
            log_every: params.log_every,
            keep_last: params.decay == Decay::None,
            note: String::new(),
        };
        let learning = Learning { ctx, checkpoints: &checkpoints, numbers };
        let (points, timing) = learning.run(&mut trainer, &mut Share::new(), |trainer, step| {
            let parts = examples.draw(step);
            let count = parts.iter().map(|part| part.target.len()).sum();
            trainer.step(&parts, |part, weights| Ok(part.loss(&network, weights, count)))
        })?;
        let log = learning::log(
            family.name(),
            &format!("width-{}", params.width),
            (trainer.slots.count(), params.steps),
            params,
            points,
        );
        let files = config.files(&trainer.state.average)?;
        Outputs::default()
            .put_one(BACKBONE, family.name(), files.store(ctx)?)?
            .put_one(LOG, family.name(), log.store(ctx)?)?
            .put_one(TIMING, family.name(), timing.store(ctx)?)
    }
}

impl GenerativeTrainingParams {
    fn rates(&self) -> Rates {
        Rates {
            learning_rate: self.learning_rate,
            betas: [0.9, 0.999],
            warmup: self.warmup,
            clip: self.clip,
            ema: self.ema,
            decay: self.decay,
            steps: self.steps,
            weight_decay: 0.0,
        }
    }
}

struct Examples<'a> {
    pictures: Vec<Image>,
    params: &'a GenerativeTrainingParams,
    seed: u64,
    schedule: Ddpm,
}

/// Part of a batch.
struct Part {
    states: Vec<f32>,
    side: usize,
    /// As networks are told them.
    times: Vec<f64>,
    target: std::sync::Arc<[f32]>,
}

impl Part {
    fn loss(&self, network: &Network, weights: &[Tensor<2>], count: usize) -> Tensor<1> {
        let shape = [self.times.len(), self.side, self.side, 3];
        let x = Tensor::from_data(TensorData::new(self.states.clone(), shape), &weights[0].device());
        mean_loss(network.forward(weights, x, &self.times), self.target.clone(), count, Rho::Squared, 0.0)
    }
}

impl Examples<'_> {
    /// The parts of a step's batch.
    fn draw(&self, step: u64) -> Vec<Part> {
        learning::parts(self.params.batch).map(|part| self.part(step, part)).collect()
    }

    fn part(&self, step: u64, indices: std::ops::Range<usize>) -> Part {
        let side = self.pictures[0].width();
        let (mut states, mut times, mut target) = (Vec::new(), Vec::new(), Vec::new());
        for index in indices {
            let mut stream = Stream::new(self.seed, &[step, index as u64]).part("example");
            let picture = &self.pictures[stream.below(self.pictures.len())];
            let turned = self.params.mirror && stream.uniform() < 0.5;
            let mirrored = turned.then(|| pictures::mirrored(picture));
            let picture = mirrored.as_ref().unwrap_or(picture);
            match self.params.family {
                Family::Ddpm => {
                    let time = stream.below(self.schedule.times());
                    let alpha = self.schedule.alpha(time);
                    let (kept, noisy) = (alpha.sqrt() as f32, (1.0 - alpha).sqrt() as f32);
                    for value in picture.data() {
                        let noise = stream.normal() as f32;
                        states.push(kept * value + noisy * noise);
                        target.push(noise);
                    }
                    times.push(time as f64);
                }
                Family::RectifiedFlow => {
                    let time = FIRST + (1.0 - FIRST) * stream.uniform();
                    for value in picture.data() {
                        let noise = stream.normal() as f32;
                        states.push(time as f32 * value + (1.0 - time) as f32 * noise);
                        target.push(value - noise);
                    }
                    times.push(SCALE * time);
                }
            }
        }
        Part { states, side, times, target: target.into() }
    }
}
