#![doc = include_str!("training.md")]

mod batches;
mod checkpoint;
mod divergence;
mod optimiser;
mod record;
mod threads;
pub mod timing;
mod trainer;

pub use optimiser::Decay;

use crate::{
    device::{self, Place},
    model::{Model, ModelInfo},
    network::{Loss, Output, Preset},
    parameterization::{Conditioning, Parameterization, Space},
};
use batches::{DataSet, Draw};
use checkpoint::Checkpoints;
use optimiser::Rates;
use record::{Record, Score};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::time::Instant;
use tauflow_contract::{
    Action, Artifact, Collection, Context, InputPort, ItemKey, Kind, KindError, KindSpec, Mode, OutputPort, Outputs,
    ParamProblem, derive_seed,
};
use tauflow_data::{
    formats::{JSON, MODEL, PACKED},
    results::{TrainingLog, TrainingTiming},
};
use threads::Share;
use trainer::Trainer;

/// Raised with every change of what a training computes: neither results nor checkpoints of before count then.
const VERSION: u32 = 4;

/// The kind `training`.
pub struct Training;

/// Params of `training`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TrainingParams {
    /// What the network predicts.
    pub parameterization: Parameterization,
    /// What it sees beside the state.
    pub conditioning: Conditioning,
    /// Size of the network.
    pub preset: Preset,
    /// The space that states and targets are in.
    pub space: Space,
    /// How predictions are judged.
    pub loss: Loss,
    /// Which draw of first weights and batches: trainings that differ in it alone show how far chance goes.
    pub draw: u64,
    /// Training steps.
    #[schemars(range(min = 1))]
    pub steps: u64,
    /// Examples in a step.
    #[schemars(range(min = 1, max = 4096))]
    pub batch: usize,
    /// Side of the windows that are trained on, in pixels; cut to the images' size and a multiple of 8.
    #[schemars(range(min = 8))]
    pub crop: usize,
    /// Learning rate of Adam.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub learning_rate: f64,
    /// Decay rates of Adam's moments.
    pub betas: [f64; 2],
    /// Steps over which the learning rate rises from 0.
    pub warmup: u64,
    /// How the learning rate falls afterwards.
    pub decay: Decay,
    /// Largest norm of the gradient.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub clip: f64,
    /// Share that the average of the weights keeps in each step; in short runs, less.
    #[schemars(range(min = 0.0), extend("exclusiveMaximum" = 1.0))]
    pub ema: f64,
    /// Takes targets from other scenes: a check that what is learned comes from the data.
    pub shuffle_targets: bool,
    /// Largest change of the exposure of an example, in EV: factors 2^U[-j, j] on all its rungs.
    #[schemars(range(min = 0.0, max = 8.0))]
    pub exposure_jitter: f64,
    /// Puts the colours of each example, albedo included, into an order drawn for it.
    pub permute_colours: bool,
    /// Rungs of n samples are drawn in proportion to n to minus this: 0 for all as often, 0.5 as their standard errors are.
    #[schemars(range(min = 0.0, max = 4.0))]
    pub rung_exponent: f64,
    /// What the network's numbers are.
    pub output: Output,
    /// Steps between points of the loss curve.
    #[schemars(range(min = 1))]
    pub test_every: u64,
    /// Steps between checkpoints.
    #[schemars(range(min = 1))]
    pub checkpoint_every: u64,
}

impl Default for TrainingParams {
    fn default() -> Self {
        Self {
            parameterization: Parameterization::default(),
            conditioning: Conditioning::default(),
            preset: Preset::default(),
            space: Space::default(),
            loss: Loss::default(),
            draw: 0,
            steps: 60_000,
            batch: 16,
            crop: 128,
            learning_rate: 2e-4,
            betas: [0.9, 0.999],
            warmup: 100,
            decay: Decay::None,
            clip: 1.0,
            ema: 0.999,
            shuffle_targets: false,
            exposure_jitter: 0.0,
            permute_colours: false,
            rung_exponent: 0.0,
            output: Output::default(),
            test_every: 250,
            checkpoint_every: 500,
        }
    }
}

const INPUTS: &[InputPort] = &[
    InputPort::whole("train", PACKED, "The scenes to learn from."),
    InputPort::whole("test", PACKED, "Scenes whose loss is written down, never learned from.").or_none(),
];
const OUTPUTS: &[OutputPort] = &[
    OutputPort::new("model", MODEL, "The averaged weights."),
    OutputPort::new("log", JSON, "The loss curve."),
    OutputPort::new("timing", JSON, "Time of a step.").measured(),
];

impl Kind for Training {
    type Params = TrainingParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "training",
            version: VERSION,
            summary: "Trains a transport solver.",
            manual: include_str!("training.md"),
            mode: Mode::Gather,
            inputs: INPUTS,
            outputs: device::ports!(OUTPUTS),
            seeded: true,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut problems = Vec::new();
        let mut expect = |fine: bool, pointer: &str, message: String, hint: &str| {
            if !fine {
                problems.push(ParamProblem::new(pointer, message, hint));
            }
        };
        let p = params;
        expect(p.steps >= 1, "/steps", "no steps to train".into(), "write at least 1");
        expect((1..=4096).contains(&p.batch), "/batch", format!("a batch of {}", p.batch), "write 1 to 4096");
        expect(p.crop >= 8, "/crop", format!("a crop of {} pixels", p.crop), "write at least 8");
        let positive = |v: f64| v.is_finite() && v > 0.0;
        expect(
            positive(p.learning_rate) && p.learning_rate <= 1e3,
            "/learning_rate",
            format!("a learning rate of {}", p.learning_rate),
            "write a positive number such as 2e-4, at most 1000",
        );
        expect(positive(p.clip), "/clip", format!("a clip of {}", p.clip), "write a positive number such as 1");
        expect(
            p.betas.iter().all(|b| (0.0..1.0).contains(b)),
            "/betas",
            format!("betas {:?} outside [0, 1)", p.betas),
            "write for example [0.9, 0.999]",
        );
        expect((0.0..1.0).contains(&p.ema), "/ema", format!("ema {} outside [0, 1)", p.ema), "write 0.999, say");
        expect(
            (0.0..=8.0).contains(&p.exposure_jitter),
            "/exposure_jitter",
            format!("a change of exposure of {} EV", p.exposure_jitter),
            "write 0 to 8",
        );
        expect(
            (0.0..=4.0).contains(&p.rung_exponent),
            "/rung_exponent",
            format!("an exponent of {}", p.rung_exponent),
            "write 0 to 4",
        );
        expect(
            p.rung_exponent == 0.0 || p.parameterization != Parameterization::VanillaRf,
            "/rung_exponent",
            "`vanilla_rf` learns between the first rung and the last: there are no others to draw".into(),
            "leave it at 0",
        );
        expect(p.test_every >= 1, "/test_every", "a point every 0 steps".into(), "write at least 1");
        expect(p.checkpoint_every >= 1, "/checkpoint_every", "one every 0 steps".into(), "write at least 1");
        problems
    }

    fn project(params: &Self::Params, _item: Option<&ItemKey>, _group: &str) -> Value {
        Value::Object(telling(params))
    }

    fn environment(_params: &Self::Params, _group: &str) -> Value {
        device::environment(Value::Null)
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        let train = action.whole("train")?;
        let test = action.whole.get("test").copied();
        let seed =
            if params.draw == 0 { action.seed } else { derive_seed(action.seed, "draw", &params.draw.to_string()) };
        let job = Job { ctx, params, seed, train, test, place: Place::chosen()? };
        job.run(&mut Share::new())
    }
}

/// All params, less those that came later where they change nothing: keys, checkpoints and logs of trainings of before stay what they
/// are.
fn telling(params: &TrainingParams) -> Map<String, Value> {
    let Value::Object(mut fields) = serde_json::to_value(params).expect("plain data") else { return Map::default() };
    let plain = [("rung_exponent", params.rung_exponent == 0.0), ("output", params.output == Output::default())];
    for (name, _) in plain.into_iter().filter(|(_, plain)| *plain) {
        fields.remove(name);
    }
    fields
}

/// One training.
struct Job<'a> {
    ctx: &'a Context<'a>,
    params: &'a TrainingParams,
    seed: u64,
    train: &'a Collection,
    test: Option<&'a Collection>,
    place: Place,
}

impl Job<'_> {
    fn run(&self, share: &mut Share) -> Result<Outputs, KindError> {
        let (ctx, params) = (self.ctx, self.params);
        let train = DataSet::load(ctx, self.train, "train", params.conditioning)?;
        let test = match self.test {
            Some(test) if !test.is_empty() => Some(DataSet::load(ctx, test, "test", params.conditioning)?),
            _ => None,
        };
        if let Some(test) = test.as_ref().filter(|t| t.counts != train.counts) {
            return Err(KindError::Input(format!(
                "the test scenes have rungs {:?} and the training scenes {:?}; give both ladders the same `rungs`",
                test.counts, train.counts
            )));
        }
        if params.shuffle_targets && train.len() < 2 {
            return Err(KindError::Input("`shuffle_targets` needs at least two training scenes".into()));
        }
        let info = ModelInfo {
            parameterization: params.parameterization,
            conditioning: params.conditioning,
            preset: params.preset,
            space: params.space,
            counts: train.counts.clone(),
            steps: params.steps,
            output: params.output,
        };
        let (encoding, rates) = (info.encoding()?, self.rates());
        let mut trainer = Trainer::new(encoding, params.preset, rates, params.loss, self.seed, &self.place);
        let checkpoints = self.checkpoints(&info);
        let mut record = checkpoints.latest(ctx, &mut trainer, params.steps).unwrap_or_default();
        let seconds = self.steps(&info, &mut trainer, &mut record, &checkpoints, (&train, test.as_ref()), share)?;
        let log = TrainingLog {
            parameterization: params.parameterization.name().into(),
            conditioning: params.conditioning.name().into(),
            space: params.space.name().into(),
            preset: params.preset.name().into(),
            weights: trainer.network.slots().count() as u64,
            steps: params.steps,
            params: telling(params),
            points: record.points,
        };
        if !trainer.state.is_finite() {
            return Err(KindError::Input("weights are no longer finite; lower `learning_rate` or `clip`".into()));
        }
        let model = Model::new(info, trainer.state.average, &self.place)?;
        let one = |port: &str, artifact: Artifact| -> Result<Collection, KindError> {
            let key = ItemKey::new(port).map_err(|e| KindError::Internal(e.to_string()))?;
            Ok([(key, artifact)].into_iter().collect())
        };
        let model = one("model", Artifact::blob(MODEL, ctx.put(&model.to_bytes()?)?))?;
        let log = one("model", Artifact::blob(JSON, ctx.put_json(&log)?))?;
        let timing = one("model", Artifact::blob(JSON, ctx.put_json(&timing(seconds, share.most()))?))?;
        Ok(Outputs::default().collection("model", model).collection("log", log).collection("timing", timing))
    }

    fn rates(&self) -> Rates {
        let p = self.params;
        Rates {
            learning_rate: p.learning_rate,
            betas: p.betas,
            warmup: p.warmup,
            clip: p.clip,
            ema: p.ema,
            decay: p.decay,
            steps: p.steps,
        }
    }

    fn checkpoints(&self, info: &ModelInfo) -> Checkpoints {
        // How many steps follow matters only to a rate that falls towards the last.
        let steps = if self.params.decay == Decay::None { 0 } else { self.params.steps };
        let params = telling(&TrainingParams { steps, ..self.params.clone() });
        let mut inputs = vec![self.train.digest()];
        inputs.extend(self.test.map(Collection::digest));
        Checkpoints {
            params: self.place.beside(json!({ "version": VERSION, "params": params, "seed": self.seed })),
            inputs,
            info: info.clone(),
            every: self.params.checkpoint_every,
        }
    }

    /// What went wrong after `done` steps, and what is there of them.
    fn with_checkpoint(&self, error: KindError, checkpoints: &Checkpoints, done: u64) -> KindError {
        let last = checkpoints.last_due(done);
        match error {
            KindError::Input(told) if last > 0 && self.params.decay == Decay::None => KindError::Input(format!(
                "{told}; the state after step {last} is kept: `steps: {last}` makes a model of it"
            )),
            // A rate that falls towards the last step has other checkpoints for fewer steps.
            KindError::Input(told) if last > 0 => {
                KindError::Input(format!("{told}; the last state that is kept is that after step {last}"))
            }
            error => error,
        }
    }

    /// Takes the steps that are left; returns how long each took.
    fn steps(
        &self,
        info: &ModelInfo,
        trainer: &mut Trainer,
        record: &mut Record,
        checkpoints: &Checkpoints,
        (train, test): (&DataSet, Option<&DataSet>),
        share: &mut Share,
    ) -> Result<Vec<f64>, KindError> {
        let p = self.params;
        let multiple = trainer.network.multiple();
        let side = train.side(p.crop, multiple)?;
        let test_side = test.map(|t| t.side(p.crop, multiple)).transpose()?.unwrap_or(side);
        let draw = Draw {
            seed: self.seed,
            batch: p.batch,
            side,
            shuffle_targets: p.shuffle_targets,
            exposure_jitter: p.exposure_jitter,
            permute_colours: p.permute_colours,
            rung_exponent: p.rung_exponent,
        };
        let score = |trainer: &Trainer| -> Result<Option<Score>, KindError> {
            let Some(set) = test else { return Ok(None) };
            let model = Model::new(info.clone(), trainer.state.average.clone(), &self.place)?;
            let test = trainer.test(set, test_side, p.batch);
            // JSON has no infinity: the curve would look as if there were no test scenes.
            if !test.is_finite() {
                return Err(KindError::Input(format!(
                    "the loss on the test scenes is {test} after step {}: a value of theirs is too large for `loss`; render \
                     them again, or take `space: log1p`",
                    trainer.state.step
                )));
            }
            Ok(Some(Score { test, gain: set.gain(&model)? }))
        };
        if record.points.is_empty() {
            let trainer: &Trainer = trainer;
            record.point(0, share.run(|| score(trainer))??, trainer.learning_rate());
        }
        let mut seconds = Vec::new();
        while trainer.state.step < p.steps {
            self.ctx.check_cancelled()?;
            let start = Instant::now();
            let (rate, before) = (trainer.learning_rate(), trainer.state.step);
            let stepped = share.run(|| {
                let batch = train.draw(&trainer.encoding, &draw, before);
                trainer.step(&batch)
            })?;
            let (loss, norm) = stepped.map_err(|error| self.with_checkpoint(error, checkpoints, before))?;
            seconds.push(start.elapsed().as_secs_f64());
            record.add(loss, norm);
            let step = trainer.state.step;
            if step.is_multiple_of(p.test_every) {
                let trainer: &Trainer = trainer;
                record.point(step, share.run(|| score(trainer))??, rate);
            }
            // The last state serves a longer training, but not where the rate has already fallen for the end.
            if checkpoints.due(step) && (step < p.steps || p.decay == Decay::None) {
                checkpoints.keep(self.ctx, trainer, record)?;
            }
            if step.is_multiple_of(10) || step == p.steps {
                let recent = &seconds[seconds.len().saturating_sub(20)..];
                let rate = recent.len() as f64 / recent.iter().sum::<f64>().max(1e-9);
                let gain = record.gain().map(|gain| format!("{gain:+.2} dB  ")).unwrap_or_default();
                let standing = record.standing();
                self.ctx.progress(step, p.steps, &format!("loss {loss:.4}{standing}  {gain}{rate:.1} steps/s"));
            }
        }
        if record.points.last().is_some_and(|last| last.step < p.steps) {
            let trainer: &Trainer = trainer;
            record.point(p.steps, share.run(|| score(trainer))??, self.rates().at(p.steps - 1));
        }
        Ok(seconds)
    }
}

fn timing(mut seconds: Vec<f64>, threads: usize) -> TrainingTiming {
    let total = seconds.iter().sum();
    seconds.sort_by(f64::total_cmp);
    let median = seconds.get(seconds.len() / 2).copied().unwrap_or(0.0);
    TrainingTiming {
        steps: seconds.len() as u64,
        seconds: total,
        median_step_ms: 1000.0 * median,
        threads: threads as u64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn params_that_came_later_are_in_keys_only_where_they_change_something() {
        let plain = TrainingParams::default();
        let names = ["rung_exponent", "output"];
        assert!(names.iter().all(|name| !telling(&plain).contains_key(*name)));
        let changed = TrainingParams { rung_exponent: 0.5, output: Output::ShadedMeans, ..plain.clone() };
        assert!(names.iter().all(|name| telling(&changed).contains_key(*name)));
        assert_ne!(Training::project(&plain, None, "main"), Training::project(&changed, None, "main"));
        assert!(Training::check(&plain).is_empty() && Training::check(&changed).is_empty());
        for rung_exponent in [-0.1, 4.1, f64::NAN] {
            assert_eq!(Training::check(&TrainingParams { rung_exponent, ..plain.clone() }).len(), 1, "{rung_exponent}");
        }
        let vanilla = TrainingParams { parameterization: Parameterization::VanillaRf, ..changed };
        assert_eq!(Training::check(&vanilla)[0].pointer, "/rung_exponent");
    }
}
