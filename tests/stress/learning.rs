//! Trainings on small bad data, trainings that diverge, and such as are stopped.

use super::{Hazard, held};
use crate::interrupted::{Interrupted, Interruption};
use std::collections::BTreeMap;
use tauflow_contract::{Action, Collection, Context, ItemKey, Kind, Media, Outputs, Silent};
use tauflow_data::{
    Image,
    records::{PackedScene, TrainingLog, TrainingTiming},
    rng::Stream,
};
use tauflow_train::{Conditioning, Decay, Loss, Model, Parameterization, Space, Training, TrainingParams};

const TRAINING: &str = "Training";
pub(super) const SIDE: usize = 16;
const COUNTS: [u64; 4] = [1, 2, 4, 8];

/// A scene of noise about a ramp; `bright` is put into one pixel of the first rung.
pub(super) fn scene(seed: u64, bright: f32) -> PackedScene {
    let mut stream = Stream::new(seed, &[]);
    let mut states = vec![Image::new(SIDE, SIDE, 3); COUNTS.len()];
    for at in 0..SIDE * SIDE * 3 {
        let ramp = (at / 3 % SIDE) as f64 / SIDE as f64;
        let mut sum = 0.0;
        for n in 1..=COUNTS[3] {
            sum += ramp * 2.0 * stream.uniform();
            if let Some(k) = COUNTS.iter().position(|count| *count == n) {
                states[k].data_mut()[at] = (sum / n as f64) as f32;
            }
        }
    }
    states[0].data_mut()[99] += bright;
    PackedScene {
        counts: COUNTS.to_vec(),
        states,
        gbuffer: Some(Image::new(SIDE, SIDE, 6)),
        sampler: Default::default(),
    }
}

/// A store, and trainings over it.
pub(super) struct Lab {
    blobs: Interrupted,
}

impl Lab {
    pub(super) fn new() -> Self {
        Self { blobs: Interrupted::default() }
    }

    pub(super) fn scenes(&self, scenes: impl IntoIterator<Item = PackedScene>) -> Collection {
        let store = |(i, scene): (usize, PackedScene)| {
            let stored = scene.store(&Context::new(&self.blobs, &Silent, self.blobs.stop())).expect("memory");
            (ItemKey::new(format!("L0-open-{i:06}")).expect("plain"), stored.into_artifact())
        };
        scenes.into_iter().enumerate().map(store).collect()
    }

    pub(super) fn train(&self, train: &Collection, params: TrainingParams) -> Result<Outputs, String> {
        self.train_and_test(train, None, params)
    }

    pub(super) fn train_and_test(
        &self,
        train: &Collection,
        test: Option<&Collection>,
        params: TrainingParams,
    ) -> Result<Outputs, String> {
        let ctx = Context::new(&self.blobs, &Silent, self.blobs.stop());
        let mut all = BTreeMap::from([("train", train)]);
        all.extend(test.map(|test| ("test", test)));
        let action = Action { params, item: None, group: "main", seed: 3, each: BTreeMap::new(), all };
        Training::run(&ctx, &action).map_err(|e| e.to_string())
    }

    pub(super) fn part(&self, outputs: &Outputs, port: &str) -> Vec<u8> {
        let ctx = Context::new(&self.blobs, &Silent, self.blobs.stop());
        ctx.part(outputs.collections[port].get("model").expect("one item"), "").expect("stored")
    }
}

/// Params of a short training with G-buffers.
pub(super) fn guided(parameterization: Parameterization, space: Space, loss: Loss) -> TrainingParams {
    let conditioning = Conditioning::Gbuffer;
    TrainingParams { parameterization, space, loss, conditioning, steps: 20, learning_rate: 1e-3, ..short() }
}

pub(super) fn short() -> TrainingParams {
    TrainingParams {
        steps: 6,
        batch: 2,
        crop: SIDE,
        warmup: 0,
        test_every: 2,
        checkpoint_every: 100,
        ..TrainingParams::default()
    }
}

/// Scenes in which nothing varies.
fn flat(value: f32) -> PackedScene {
    let mut flat = scene(0, 0.0);
    flat.states.iter_mut().for_each(|state| state.data_mut().fill(value));
    flat
}

type Add<'a> = &'a mut dyn FnMut(String, &str, Result<String, String>);

pub fn hazards() -> Vec<Hazard> {
    let mut out = Vec::new();
    let mut add =
        |fed: String, must: &str, came: Result<String, String>| out.push(Hazard::new(TRAINING, fed, must, came));
    data(&mut add);
    divergence(&mut add);
    resumption(&mut add);
    out
}

/// A training's losses, all of them, and its model, which is read.
pub(super) fn sound(lab: &Lab, outputs: &Outputs) -> Result<Vec<f64>, String> {
    let log: TrainingLog = serde_json::from_slice(&lab.part(outputs, "log")).map_err(|e| e.to_string())?;
    let losses: Vec<f64> = log.points.iter().filter_map(|p| p.train).collect();
    // The curve has a point without a loss, before the first step.
    if losses.len() + 1 != log.points.len() || !losses.iter().all(|loss| loss.is_finite()) {
        return Err(format!("losses {losses:?} at {} points", log.points.len()));
    }
    // JSON has no NaN: what is none would be missing.
    if log.points[1..].iter().any(|p| p.gradient_norm.is_none() || p.test.is_some() != p.gain.is_some()) {
        return Err(format!("no norm or no gain among {:?}", log.points));
    }
    Model::load(&lab.part(outputs, "model")).map(|_| losses).map_err(|e| e.to_string())
}

fn data(add: Add<'_>) {
    for (space, loss) in [(Space::Linear, Loss::Squared), (Space::Log1p, Loss::Absolute)] {
        for parameterization in Parameterization::ALL {
            let lab = Lab::new();
            let bright = lab.scenes((0..3).map(|i| scene(i, 1e6)));
            let params =
                TrainingParams { parameterization, space, loss, conditioning: Conditioning::Gbuffer, ..short() };
            let came = lab.train(&bright, params);
            let came = came.and_then(|out| sound(&lab, &out)).map(|_| "finite losses and weights".into());
            add(
                format!("a firefly of 1e6 in every scene, {} in {} space", parameterization.name(), space.name()),
                "finite losses and weights",
                came,
            );
        }
    }
    for (name, value) in [("black", 0.0f32), ("constant", 0.7)] {
        let came = Parameterization::ALL.into_iter().try_fold(0.0f64, |most, parameterization| {
            let lab = Lab::new();
            let params = TrainingParams { parameterization, conditioning: Conditioning::Gbuffer, ..short() };
            let outputs = lab.train(&lab.scenes([flat(value), flat(value)]), params)?;
            Ok::<_, String>(sound(&lab, &outputs)?.into_iter().fold(most, f64::max))
        });
        // Nothing is to be learned: the loss is rounding.
        let came = came.and_then(|most| held(most < 1e-10, "only rounding errors".into()));
        add(
            format!("scenes that are {name}, without noise, in all four parameterizations"),
            "a loss of 0, and a model",
            came,
        );
    }
    let lab = Lab::new();
    let one = lab.scenes([scene(1, 0.0)]);
    let came = Parameterization::ALL.into_iter().try_for_each(|parameterization| {
        let outputs = lab.train(&one, TrainingParams { parameterization, ..short() })?;
        sound(&lab, &outputs).map(|_| ())
    });
    add("a training set of one scene, in all four parameterizations".into(), "models", came.map(|()| "models".into()));
    let came = match lab.train(&one, TrainingParams { shuffle_targets: true, ..short() }) {
        Err(told) => held(told.contains("two training scenes"), "refused with a specific error".into()),
        Ok(_) => Err("accepted".into()),
    };
    add("one scene, with targets from a different scene".into(), "refused with a specific error", came);
    let came = match lab.train(&Collection::default(), short()) {
        Err(told) => held(told.contains("train"), "refused with a specific error".into()),
        Ok(_) => Err("accepted".into()),
    };
    add("an empty training set".into(), "refused with a specific error", came);
    let mut broken = scene(1, 0.0);
    broken.states[1].data_mut()[7] = f32::NAN;
    let came = match lab.train(&lab.scenes([scene(0, 0.0), broken]), short()) {
        Err(told) => {
            held(told.contains("finite") && told.contains("L0-open-000001"), "refused, with the scene's name".into())
        }
        Ok(_) => Err("accepted".into()),
    };
    add("a scene with a value that is not finite".into(), "refused with a specific error", came);
    let broken = PackedScene { gbuffer: scene(1, 0.0).gbuffer.map(|g| g.map(|_| f32::INFINITY)), ..scene(1, 0.0) };
    let came = match lab.train(&lab.scenes([scene(0, 0.0), broken]), short()) {
        Err(told) => {
            held(told.contains("G-buffer") && told.contains("L0-open-000001"), "refused, with the scene's name".into())
        }
        Ok(_) => Err("accepted".into()),
    };
    add("a scene with a G-buffer of infinities".into(), "refused with a specific error", came);
    let blinding = lab.scenes([scene(1, 1e25)]);
    let came = match lab.train_and_test(&one, Some(&blinding), short()) {
        Err(told) => held(told.contains("test scenes") && told.contains("step 0"), "refused, with the step".into()),
        Ok(_) => Err("accepted, with a curve that looks as if there were no test scenes".into()),
    };
    add(
        "a test scene of radiance 1e25, whose square exceeds single precision".into(),
        "refused with a specific error",
        came,
    );
}

fn divergence(add: Add<'_>) {
    let told_all = |told: &str| {
        ["step", "with a learning rate of ", "`learning_rate`", "`clip`"].iter().all(|word| told.contains(word))
    };
    // The rate rises by a quarter at every step: some go well, and each is kept.
    let lab = Lab::new();
    let scenes = lab.scenes((0..3).map(|i| scene(i, 0.0)));
    let rising = TrainingParams { learning_rate: 1e3, warmup: 4000, steps: 400, checkpoint_every: 1, ..short() };
    let diverged = lab.train(&scenes, rising.clone());
    let kept = match diverged {
        Err(told) if told_all(&told) && told.contains("diverges") => told
            .rsplit_once("`steps: ")
            .and_then(|(_, rest)| rest.split('`').next()?.parse::<u64>().ok())
            .ok_or_else(|| format!("no step to go back to in: {told}")),
        Err(told) => Err(told),
        Ok(_) => Err("accepted for a training".into()),
    };
    add(
        "a learning rate that grows by a quarter per step, up to 1,000".into(),
        "an error that names the step, the learning rate and the last checkpoint",
        kept.clone().and_then(|step| {
            held(step > 1, "an error with the step, `learning_rate`, `clip`, and the last good step".into())
        }),
    );
    let came = kept.and_then(|step| {
        let outputs = lab.train(&scenes, TrainingParams { steps: step, ..rising.clone() })?;
        sound(&lab, &outputs)?;
        let timing: TrainingTiming =
            serde_json::from_slice(&lab.part(&outputs, "timing")).map_err(|e| e.to_string())?;
        // The same without a store of before, from its first step on.
        let fresh = Lab::new();
        let scenes = fresh.scenes((0..3).map(|i| scene(i, 0.0)));
        let again = fresh.train(&scenes, TrainingParams { steps: step, ..rising.clone() })?;
        let same = fresh.part(&again, "model") == lab.part(&outputs, "model");
        held(timing.steps == 0 && same, "no step is repeated; the bits of a training that ends at this step".into())
    });
    add(
        "the same training with the number of steps that the error names".into(),
        "the model of the last checkpoint",
        came,
    );
    let came = lab.train(&scenes, TrainingParams { learning_rate: 2e-4, steps: 30, ..short() });
    let came = came
        .and_then(|outputs| sound(&lab, &outputs))
        .and_then(|losses| held(losses.iter().all(|loss| *loss < 1.0), "finite losses and weights".into()));
    add("the same scenes and store, with a learning rate of 2e-4".into(), "a training", came);
    let gone = |bright: f32, params: TrainingParams, word: &str| {
        let lab = Lab::new();
        let scenes = lab.scenes((0..3).map(|i| scene(i, bright)));
        match lab.train(&scenes, params) {
            Err(told) => held(told_all(&told) && told.contains(word), told)
                .map(|_| "an error with the step and the parameter to lower".into()),
            Ok(_) => Err("accepted for a training".into()),
        }
    };
    let at_once = TrainingParams { learning_rate: 1e3, clip: 1e9, steps: 60, ..short() };
    add(
        "a learning rate of 1,000 at once, without clipping: losses stay finite, as predictions are means".into(),
        "an error that names the step and the learning rate",
        gone(0.0, at_once, "after step 1,").map(|_| "an error at the first step, from the size of the weights".into()),
    );
    let linear = TrainingParams { space: Space::Linear, loss: Loss::Squared, ..short() };
    add(
        "a radiance of 1e25 in every scene, in linear space, squared".into(),
        "an error that names the step",
        gone(1e25, linear.clone(), "the loss is inf"),
    );
    add(
        "a radiance of 1e15, without clipping: the squared gradient exceeds single precision, the loss does not".into(),
        "an error that names the step, before the weights stop changing",
        gone(1e15, TrainingParams { clip: 1e30, steps: 60, ..linear.clone() }, "the norm of the gradient"),
    );
    let lab = Lab::new();
    let scenes = lab.scenes((0..3).map(|i| scene(i, 1e15)));
    let came = lab.train(&scenes, linear).and_then(|outputs| sound(&lab, &outputs));
    add(
        "the same with `clip: 1`".into(),
        "finite losses and weights",
        came.map(|_| "finite losses and weights".into()),
    );
}

/// Steps that the last run of a training took itself.
fn steps_done(lab: &Lab, outputs: &Outputs) -> Result<u64, String> {
    let timing: TrainingTiming = serde_json::from_slice(&lab.part(outputs, "timing")).map_err(|e| e.to_string())?;
    Ok(timing.steps)
}

fn resumption(add: Add<'_>) {
    let params = |every| TrainingParams { checkpoint_every: every, decay: Decay::Cosine, ..short() };
    let lab = || {
        let lab = Lab::new();
        let scenes = lab.scenes((0..3).map(|i| scene(i, 0.0)));
        (lab, scenes)
    };
    let whole = || {
        let (lab, scenes) = lab();
        lab.train(&scenes, params(100)).map(|outputs| lab.part(&outputs, "model"))
    };
    // A run that must not come to its end.
    let interrupted = |lab: &Lab, scenes: &Collection, every, how| {
        lab.blobs.arm(how);
        let came = lab.train(scenes, params(every));
        lab.blobs.disarm();
        match came {
            Ok(_) => Err(format!("{how:?} did not stop it")),
            Err(told) => Ok(told),
        }
    };
    // Another run, to the end: its steps, and whether its model has the bits.
    let finished = |lab: &Lab, scenes: &Collection, every, steps: u64| {
        let outputs = lab.train(scenes, params(every))?;
        let done = steps_done(lab, &outputs)?;
        if done != steps || lab.part(&outputs, "model") != whole()? {
            return Err(format!("other bits, or {done} steps and not {steps}"));
        }
        Ok(())
    };
    let came = (1..6u64).try_for_each(|stop| {
        let (lab, scenes) = lab();
        interrupted(&lab, &scenes, 1, Interruption::StopAfter(stop))?;
        finished(&lab, &scenes, 1, 6 - stop)
    });
    add(
        "five trainings of six steps with a checkpoint after each step, interrupted as by Ctrl-C after step 1, 2 ... \
         5, then continued"
            .into(),
        "the bits of an uninterrupted training; no step is repeated",
        came.map(|()| "the same bits, five times; only the remaining steps ran".into()),
    );
    let (one, scenes) = lab();
    let came = (1..6u64)
        .try_for_each(|_| interrupted(&one, &scenes, 1, Interruption::StopAfter(1)).map(|_| ()))
        .and_then(|()| finished(&one, &scenes, 1, 1));
    add(
        "one training of six steps, interrupted after each of its first five steps".into(),
        "the bits of an uninterrupted training; its last run takes one step",
        came.map(|()| "the same bits; one step".into()),
    );
    let came = [1u64, 2].into_iter().try_for_each(|nth| {
        let (lab, scenes) = lab();
        let told = interrupted(&lab, &scenes, 2, Interruption::FailAt(nth))?;
        held(told.contains("no space"), told)?;
        finished(&lab, &scenes, 2, 6 - 2 * (nth - 1))
    });
    add(
        "the same with a checkpoint every two steps, which cannot be written after step 2, or after step 4, as on a \
         full disk"
            .into(),
        "an error that names the cause; then the bits of an uninterrupted training, continued from the previous \
         checkpoint",
        came.map(|()| "an error; the same bits, after six and after four steps".into()),
    );
}
