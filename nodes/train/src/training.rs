#![doc = include_str!("training.md")]

mod batches;
mod checkpoint;
mod divergence;
mod params;
mod patches;
pub mod timing;
mod trainer;

pub use params::{Clock, Convolving, TrainingParams};
pub use tauflow_tensors::Decay;

use crate::{
    device::{self, CORES, Place},
    model::{Model, ModelInfo},
};
use batches::{DataSet, Draw};
use checkpoint::Checkpoints;
use params::LATER;
use serde_json::{Value, json};
use std::time::Instant;
use tauflow_contract::{
    Action, All, Basis, Context, Digest, Facts, Foreseen, Group, Handle, ItemKey, Items, Kind, KindError, KindSpec,
    Known, Later, Media, Mode, Out, Outlook, Outputs, ParamProblem, Probe, Resources, Source, derive_seed, leave_out,
};
use tauflow_data::{
    SamplerKind,
    facts::{self, CONDITIONING, INDEPENDENT, PARAMETERIZATION, RUNGS},
    records::{Convergence, ModelFile, PackedScene, TrainingLog, TrainingTiming},
    statistics::quantile,
    time::{EXPONENTS, INDEPENDENT_EXPONENT},
    timing::machine,
};
use tauflow_tensors::{Checkpoints as Kept, Curve, Rates, Score, Share, Weights};
use trainer::Trainer;

/// Raised with every change of what a training computes: neither results nor checkpoints of before count then.
const VERSION: u32 = 4;

/// The kind `training`.
pub struct Training;

const TRAIN: All<PackedScene> = All::new("train", "The training set.");
const TEST: All<PackedScene> = All::new("test", "The test set; only its loss is recorded.").or_none();

const START: All<ModelFile> =
    All::new("start", "A model whose weights the training begins with, in place of random ones.").or_none().single();

const CONVERGENCE: All<Convergence> =
    All::new("convergence", "How fast the error of such ladders falls, for `clock: fitted`.").or_none().single();

/// Told where the fitted clock lacks what it is fitted by.
const UNFITTED: &str = "`clock: fitted` needs the input `convergence`, but nothing is connected to it";

/// Told where ladders are shorter than others and must not be.
const WHY_WHOLE: &str = "render all with the same `rungs`, or set `unknown_counts` and `independent_targets`, without \
    which shorter ladders cannot be used";

const MAIN: Group = Group::main(VERSION);
const MODEL: Out<ModelFile> = Out::new(MAIN, "model", "The averaged weights.").single();
const LOG: Out<TrainingLog> = Out::new(MAIN, "log", "The loss curve.").single();
const TIMING: Out<TrainingTiming> = Out::new(MAIN, "timing", "Wall time per step.").measured().single();

/// The key of the one item on each output.
const ITEM: &str = "model";

impl Kind for Training {
    type Params = TrainingParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "training",
            summary: "Trains a solver (a neural denoiser).",
            manual: include_str!("training.md"),
            mode: Mode::Gather,
            inputs: vec![TRAIN.port(), TEST.port(), START.port(), CONVERGENCE.port()],
            outputs: vec![MODEL.port(), LOG.port(), TIMING.port()],
            seeded: true,
        }
    }

    fn project(params: &Self::Params, _item: Option<&ItemKey>, _group: &str) -> Value {
        serde_json::to_value(params.acting()).expect("plain data")
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        params.problems().into_iter().chain(params.device.problems()).collect()
    }

    fn foresee(params: &Self::Params, known: &Known) -> Outlook {
        let (train, test) = (known.all(TRAIN), known.all(TEST));
        let mut problems: Vec<Foreseen> = Vec::new();
        if let Some(first) = train.first() {
            let whole = facts::longest(train).unwrap_or(first);
            problems.extend(train.iter().find_map(|other| match params.allows_shorter() {
                true => facts::first_rungs(TRAIN, other, whole),
                false => facts::same_rungs(TRAIN, other, whole),
            }));
            // One that is not known may be the longest.
            if !params.allows_shorter() || train.iter().all(|set| set.facts.get(RUNGS).is_some()) {
                problems.extend(test.iter().find_map(|other| facts::same_rungs(TEST, other, whole)));
            }
            problems.extend(train.iter().find_map(|other| facts::same_sampling(TRAIN, other, first)));
            problems.extend(test.iter().find_map(|other| facts::same_sampling(TEST, other, first)));
            if params.independent_targets {
                problems.extend(facts::independent(TRAIN, first));
            }
            let short = |set: &&Source| set.facts.get(RUNGS).is_some_and(|rungs| rungs.len() < 2);
            if let Some(set) = train.iter().find(short) {
                let message = format!("the ladders of `{}` have one rung, but training needs two", set.name);
                problems.push(Foreseen::input(TRAIN, message, "add a count to their `rungs`"));
            }
        }
        let preset = format!("the preset `{}`", params.preset.name());
        let small = |set: &Source| facts::least_film(TRAIN, set, params.preset.multiple(), &preset);
        problems.extend(train.iter().find_map(small));
        if params.clock == Clock::Fitted && !known.has(CONVERGENCE.name()) {
            problems.push(Foreseen::param("/clock", UNFITTED, "connect one of such ladders, or use `independent`"));
        }
        problems.extend(train.iter().find_map(|set| facts::gbuffer(TRAIN, set, params.conditioning)));
        problems.extend(test.iter().find_map(|set| facts::gbuffer(TEST, set, params.conditioning)));
        let model = Facts::default()
            .with_some(RUNGS, rungs(params, train))
            .with_some(INDEPENDENT, facts::shared(train, INDEPENDENT))
            .with(CONDITIONING, params.conditioning)
            .with(PARAMETERIZATION, params.parameterization);
        Outlook::default().with(MODEL, model).but(problems)
    }

    fn work(params: &Self::Params, _group: &str) -> f64 {
        let crop = params.crop as f64;
        params.steps as f64 * params.batch as f64 * crop * crop
    }

    fn resources(params: &Self::Params, _group: &str) -> Resources {
        let pixels = (params.batch * params.crop * params.crop) as u64;
        params.device.resources(CORES).memory((1 << 30) + pixels * params.preset.bytes_per_pixel())
    }

    fn later() -> &'static [Later] {
        LATER
    }

    fn spec_for(params: &Self::Params) -> KindSpec {
        params.device.stated(Self::spec())
    }

    fn port_params() -> &'static [&'static str] {
        device::PORT_PARAMS
    }

    fn environment(params: &Self::Params, _group: &str, _probe: &dyn Probe) -> Option<Value> {
        Some(params.device.environment(Value::Null))
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params.acting();
        let (train, test) = (action.all(TRAIN)?, action.all_if(TEST)?);
        let seed =
            if params.draw == 0 { action.seed } else { derive_seed(action.seed, "draw", &params.draw.to_string()) };
        let digest = action.all_if(START)?.map(Items::digest);
        let start = action.only_if(START)?.zip(digest);
        let fitted = fitted(ctx, action)?;
        let work = OneTraining { ctx, params, seed, train, test, start, fitted, place: Place::of(params.device)? };
        work.run(&mut Share::new())
    }
}

/// The rungs of the model, if they are known: the longest of all ladders.
fn rungs(params: &TrainingParams, train: &[Source]) -> Option<Vec<u64>> {
    let known = train.iter().all(|set| set.facts.get(RUNGS).is_some());
    match params.allows_shorter() {
        true => facts::longest(train).filter(|_| known).and_then(|longest| longest.facts.get(RUNGS)),
        false => facts::shared(train, RUNGS),
    }
}

/// The measurement that the clock is fitted to; none for `clock: independent`.
fn fitted(ctx: &Context<'_>, action: &Action<'_, TrainingParams>) -> Result<Option<Fitted>, KindError> {
    if action.params.clock == Clock::Independent {
        return Ok(None);
    }
    let measured = action.only_if(CONVERGENCE)?.ok_or_else(|| KindError::Input(UNFITTED.to_owned()))?;
    let (measured, port) = (measured.load(ctx)?, CONVERGENCE.name());
    // The median: the slope of a scene with rare fireflies can have any sign.
    let mut slopes: Vec<f64> = measured.scenes.iter().filter_map(|scene| Some(scene.slope?.mean)).collect();
    slopes.sort_by(f64::total_cmp);
    if slopes.is_empty() {
        return Err(KindError::Input(format!(
            "`{port}` has no slope, because no scene has noise above that of its reference; connect noisy scenes with \
            references of more samples"
        )));
    }
    let exponent = -quantile(&slopes, 0.5);
    if !EXPONENTS.contains(&exponent) {
        return Err(KindError::Input(format!(
            "the scenes of `{port}` have the median slope {:.3}, but a clock needs one from -{} to -{}; measure more \
            scenes, with references of more samples",
            -exponent,
            EXPONENTS.end(),
            EXPONENTS.start()
        )));
    }
    Ok(Some(Fitted { exponent, sampler: measured.sampler }))
}

/// The exponent that `convergence` measured, and the sampler of its ladders.
struct Fitted {
    exponent: f64,
    sampler: SamplerKind,
}

impl Fitted {
    /// Refuses scenes of another sampler, and rungs that are not powers of two.
    fn fits(&self, set: &DataSet) -> Result<(), KindError> {
        if self.sampler != set.sampler {
            return Err(KindError::Input(format!(
                "the ladders of `{}` have samples by `{}`, but the training scenes by `{}`; connect one of such \
                ladders",
                CONVERGENCE.name(),
                self.sampler.name(),
                set.sampler.name()
            )));
        }
        if let Some(count) = set.counts.iter().find(|count| !count.is_power_of_two()) {
            return Err(KindError::Input(format!(
                "`clock: fitted` needs rungs of powers of two, between which Sobol' points do not follow the law, \
                but the training scenes have one of {count} samples; use `rungs: {{ dyadic: N }}`"
            )));
        }
        Ok(())
    }
}

/// All params, less those that came later where they say what was done before: in keys, checkpoints and logs.
fn telling(params: &TrainingParams) -> Value {
    let mut told = serde_json::to_value(params).expect("plain data");
    leave_out(&mut told, LATER);
    told
}

/// A training with its inputs and the place where it runs.
struct OneTraining<'a> {
    ctx: &'a Context<'a>,
    params: &'a TrainingParams,
    seed: u64,
    train: Items<'a, PackedScene>,
    test: Option<Items<'a, PackedScene>>,
    start: Option<(Handle<'a, ModelFile>, Digest)>,
    fitted: Option<Fitted>,
    place: Place,
}

impl OneTraining<'_> {
    fn run(&self, share: &mut Share) -> Result<Outputs, KindError> {
        let (ctx, params) = (self.ctx, self.params);
        let train = DataSet::load(ctx, self.train, TRAIN, params.conditioning)?.for_loss(params.loss)?;
        if !train.is_whole() && !params.allows_shorter() {
            return Err(KindError::Input(format!(
                "some training scenes lack the last of the rungs {:?}; {WHY_WHOLE}",
                train.counts
            )));
        }
        let test = match self.test {
            Some(test) if !test.is_empty() => {
                Some(DataSet::load(ctx, test, TEST, params.conditioning)?.for_loss(params.loss)?)
            }
            _ => None,
        };
        if let Some(test) = test.as_ref().filter(|t| t.counts != train.counts || !t.is_whole()) {
            return Err(KindError::Input(format!(
                "the test scenes have rungs {:?}, but the training scenes have {:?}; give all test scenes the same \
                `rungs`",
                test.counts, train.counts
            )));
        }
        if let Some(test) = test.as_ref().filter(|t| t.sampler != train.sampler) {
            return Err(KindError::Input(format!(
                "the test scenes have samples by `{}`, but the training scenes by `{}`; give both ladders the same \
                `sampler`",
                test.sampler.name(),
                train.sampler.name()
            )));
        }
        self.fitted.as_ref().map_or(Ok(()), |fitted| fitted.fits(&train))?;
        if params.independent_targets && !train.sampler.is_independent() {
            return Err(KindError::Input(
                "`independent_targets` needs independent samples, but those of the training scenes are correlated; \
                render them with `sampler: independent`, or remove the param"
                    .into(),
            ));
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
            unknown_counts: params.unknown_counts != 0.0,
            features: params.features,
            law: params.law,
            exponent: self.exponent(),
            sampler: train.sampler,
        };
        let (encoding, rates) = (info.encoding()?, self.rates());
        let start = self.first_weights(&info)?;
        let mut trainer = Trainer::new(
            encoding,
            rates,
            (params.loss, params.convolutions.convolutions()),
            (self.seed, start),
            &self.place,
        );
        let checkpoints = self.checkpoints(&info);
        let mut curve = checkpoints.latest(ctx, &mut trainer, params.steps).unwrap_or_default();
        let seconds = self.steps(&info, &mut trainer, &mut curve, &checkpoints, (&train, test.as_ref()), share)?;
        let log = TrainingLog {
            parameterization: params.parameterization.name().into(),
            conditioning: params.conditioning.name().into(),
            space: params.space.name().into(),
            preset: params.preset.name().into(),
            weights: trainer.network.slots().count() as u64,
            steps: params.steps,
            params: telling(params).as_object().cloned().unwrap_or_default(),
            points: curve.points,
        };
        if !trainer.state.is_finite() {
            return Err(KindError::Input("weights are no longer finite; lower `learning_rate` or `clip`".into()));
        }
        let model = Model::new(info, trainer.state.average, &self.place)?;
        Outputs::default()
            .put_one(MODEL, ITEM, ModelFile(model.to_bytes()?).store(ctx)?)?
            .put_one(LOG, ITEM, log.store(ctx)?)?
            .put_one(TIMING, ITEM, timing(seconds, share.most()).store(ctx)?)
    }

    /// The weights of the model that the training begins with.
    fn first_weights(&self, info: &ModelInfo) -> Result<Option<Weights>, KindError> {
        let Some((file, _)) = &self.start else { return Ok(None) };
        let bytes = file.load(self.ctx)?;
        Model::load(&bytes.0)?.into_weights_for(info, self.seed).map(Some)
    }

    fn exponent(&self) -> f64 {
        self.fitted.as_ref().map_or(INDEPENDENT_EXPONENT, |fitted| fitted.exponent)
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
            weight_decay: 0.0,
        }
    }

    fn checkpoints(&self, info: &ModelInfo) -> Checkpoints {
        // How many steps follow matters only to a rate that falls towards the last.
        let steps = if self.params.decay == Decay::None { 0 } else { self.params.steps };
        let mut params = telling(&TrainingParams { steps, ..self.params.clone() });
        if let Some(fitted) = &self.fitted {
            params["exponent"] = json!(fitted.exponent);
        }
        let basis = Basis::new("training", VERSION, "checkpoint");
        let mut inputs = vec![self.train.digest()];
        inputs.extend(self.test.map(Items::digest));
        inputs.extend(self.start.as_ref().map(|(_, digest)| *digest));
        let basis = Basis { environment: self.place.beside(Value::Null), ..basis.with(params, Some(self.seed)) };
        Checkpoints { kept: Kept { basis, inputs, every: self.params.checkpoint_every }, info: info.clone() }
    }

    /// The error after `done` steps, and the last checkpoint.
    fn with_checkpoint(&self, error: KindError, checkpoints: &Checkpoints, done: u64) -> KindError {
        let last = checkpoints.kept.last_due(done);
        match error {
            KindError::Input(told) if last > 0 && self.params.decay == Decay::None => KindError::Input(format!(
                "{told}; the last checkpoint is step {last}: `steps: {last}` turns it into a model"
            )),
            // A rate that falls towards the last step has other checkpoints for fewer steps.
            KindError::Input(told) if last > 0 => {
                KindError::Input(format!("{told}; the last checkpoint is step {last}"))
            }
            error => error,
        }
    }

    /// Takes the steps that are left; returns how long each took.
    fn steps(
        &self,
        info: &ModelInfo,
        trainer: &mut Trainer,
        curve: &mut Curve,
        checkpoints: &Checkpoints,
        (train, test): (&DataSet, Option<&DataSet>),
        share: &mut Share,
    ) -> Result<Vec<f64>, KindError> {
        let p = self.params;
        let multiple = trainer.network.multiple();
        let side = train.side(p.crop, multiple, p.loss)?;
        let test_side = test.map(|t| t.side(p.crop, multiple, p.loss)).transpose()?.unwrap_or(side);
        let draw = Draw {
            seed: self.seed,
            batch: p.batch,
            side,
            shuffle_targets: p.shuffle_targets,
            exposure_jitter: p.exposure_jitter,
            permute_colours: p.permute_colours,
            rung_exponent: p.rung_exponent,
            unknown_counts: p.unknown_counts,
            independent_targets: p.independent_targets,
            uneven_counts: p.uneven_counts,
            patches: p.patches,
        };
        let score = |trainer: &Trainer| -> Result<Option<Score>, KindError> {
            let Some(set) = test else { return Ok(None) };
            let model = Model::new(info.clone(), trainer.state.average.clone(), &self.place)?
                .with_convolutions(trainer.convolutions);
            let test = trainer.test(set, test_side, p.batch);
            // JSON has no infinity: the curve would look as if there were no test scenes.
            if !test.is_finite() {
                return Err(KindError::Input(format!(
                    "the test loss is {test} after step {}: a value of the test scenes is too large for `loss`; \
                    render them again, or use `space: log1p`",
                    trainer.state.step
                )));
            }
            Ok(Some(Score { test, gain: set.gain(&model)? }))
        };
        if curve.points.is_empty() {
            let trainer: &Trainer = trainer;
            curve.point(0, share.run(|| score(trainer))??, trainer.learning_rate());
        }
        let mut seconds = Vec::new();
        while trainer.state.step < p.steps {
            self.ctx.check_cancelled()?;
            #[expect(clippy::disallowed_methods, reason = "`timing` is a measurement")]
            let start = Instant::now();
            let (rate, before) = (trainer.learning_rate(), trainer.state.step);
            let stepped = share.run(|| {
                let batch = train.draw(&trainer.encoding, &draw, before);
                trainer.step(&batch)
            })?;
            let (loss, norm) = stepped.map_err(|error| self.with_checkpoint(error, checkpoints, before))?;
            seconds.push(start.elapsed().as_secs_f64());
            curve.add(loss, norm);
            let step = trainer.state.step;
            if step.is_multiple_of(p.test_every) {
                let trainer: &Trainer = trainer;
                curve.point(step, share.run(|| score(trainer))??, rate);
            }
            // The last state serves a longer training, but not where the rate has already fallen for the end.
            if checkpoints.kept.due(step) && (step < p.steps || p.decay == Decay::None) {
                checkpoints.keep(self.ctx, trainer, curve)?;
            }
            if step.is_multiple_of(10) || step == p.steps {
                let recent = &seconds[seconds.len().saturating_sub(20)..];
                let rate = recent.len() as f64 / recent.iter().sum::<f64>().max(1e-9);
                let gain = curve.gain().map(|gain| format!("{gain:+.2} dB  ")).unwrap_or_default();
                let standing = curve.standing();
                self.ctx.progress(step, p.steps, &format!("loss {loss:.4}{standing}  {gain}{rate:.1} steps/s"));
            }
        }
        if curve.points.last().is_some_and(|last| last.step < p.steps) {
            let trainer: &Trainer = trainer;
            curve.point(p.steps, share.run(|| score(trainer))??, self.rates().at(p.steps - 1));
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
        machine: machine(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::Output;
    use tauflow_data::methods::Parameterization;

    #[test]
    fn params_that_came_later_are_in_keys_only_where_they_change_something() {
        let plain = TrainingParams::default();
        let names = ["rung_exponent", "output"];
        assert!(names.iter().all(|name| telling(&plain).get(*name).is_none()));
        let changed = TrainingParams { rung_exponent: 0.5, output: Output::ShadedMeans, ..plain.clone() };
        assert!(names.iter().all(|name| telling(&changed).get(*name).is_some()));
        assert_ne!(Training::project(&plain, None, "main"), Training::project(&changed, None, "main"));
        // Trainings of before were direct, which is not the default.
        let direct = TrainingParams { convolutions: Convolving::Direct, ..plain.clone() };
        let told = |params: &TrainingParams| telling(&params.acting()).get("convolutions").cloned();
        assert_eq!((told(&plain), told(&direct)), (Some("minimal".into()), None));
        // A device has convolutions of its own.
        assert_eq!(told(&TrainingParams { device: crate::NetworkDevice::Vulkan, ..plain }), None);
    }

    #[test]
    fn the_law_is_in_keys_only_where_it_changes_something() {
        let law = |parameterization, output| {
            let params = TrainingParams { parameterization, output, ..TrainingParams::default() };
            telling(&params.acting()).get("law").cloned()
        };
        for parameterization in Parameterization::ALL {
            let matters = [Parameterization::VanillaRf, Parameterization::LocalVelocity].contains(&parameterization);
            for output in [Output::Means, Output::ShadedMeans] {
                assert_eq!(law(parameterization, output).is_some(), matters, "{parameterization:?} {output:?}");
            }
            assert_eq!(law(parameterization, Output::Values), None);
        }
    }
}
