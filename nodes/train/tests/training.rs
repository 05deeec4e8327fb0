//! The kind `training` as the engine runs it, on toy scenes.

mod toy;

use std::{
    collections::BTreeMap,
    sync::atomic::{AtomicBool, Ordering},
};
use tauflow_contract::{
    Action, Collection, Context, ItemKey, Kind, KindError, Media, MemoryBlobs, Outputs, Progress, Silent,
};
use tauflow_data::{
    SamplerKind, TensorFile,
    records::{Convergence, ConvergenceRow, Estimate, PackedScene, SceneConvergence, TrainingLog, TrainingTiming},
    time::TimeGrid,
};
use tauflow_train::{
    Clock, Conditioning, Course, Decay, Denoiser, Features, Model, ModelInfo, Output, Parameterization, Training,
    TrainingParams, rollout,
};

const COUNTS: [u64; 5] = [1, 2, 4, 8, 16];

struct Lab {
    blobs: MemoryBlobs,
    train: Collection,
    test: Collection,
}

impl Lab {
    fn new(train: u64, test: u64, side: usize) -> Self {
        let blobs = MemoryBlobs::default();
        let train = toy::collection(&blobs, 0..train, side, &COUNTS);
        let test = toy::collection(&blobs, 1000..1000 + test, side, &COUNTS);
        Self { blobs, train, test }
    }

    fn run(&self, params: &TrainingParams, progress: &dyn Progress, cancel: &AtomicBool) -> Result<Outputs, KindError> {
        self.run_with(params, &[], progress, cancel)
    }

    /// Runs a training with additional inputs.
    fn run_with(
        &self,
        params: &TrainingParams,
        more: &[(&'static str, &Collection)],
        progress: &dyn Progress,
        cancel: &AtomicBool,
    ) -> Result<Outputs, KindError> {
        let ctx = Context::new(&self.blobs, progress, cancel);
        let mut all = BTreeMap::from([("train", &self.train), ("test", &self.test)]);
        all.extend(more.iter().copied());
        let params = params.clone();
        Training::run(&ctx, &Action { params, item: None, group: "main", seed: 11, each: BTreeMap::new(), all })
    }

    fn train(&self, params: &TrainingParams) -> Outputs {
        self.run(params, &Silent, &AtomicBool::new(false)).expect("trains")
    }

    fn bytes(&self, outputs: &Outputs, port: &str) -> Vec<u8> {
        let cancel = AtomicBool::new(false);
        let ctx = Context::new(&self.blobs, &Silent, &cancel);
        ctx.part(outputs.collections[port].get("model").expect("one item"), "").expect("stored")
    }

    fn log(&self, outputs: &Outputs) -> TrainingLog {
        serde_json::from_slice(&self.bytes(outputs, "log")).expect("a log")
    }

    /// Mean gain in dB of one network call over the input, on the test scenes.
    fn gain(&self, outputs: &Outputs) -> f64 {
        let model = Model::load(&self.bytes(outputs, "model")).expect("own bytes");
        let cancel = AtomicBool::new(false);
        let ctx = Context::new(&self.blobs, &Silent, &cancel);
        let gains = self.test.iter().map(|(_, artifact)| {
            let scene = PackedScene::from_bytes(&ctx.part(artifact, "").expect("stored")).expect("own bytes");
            let course = Course { from: 1, steps: 1, grid: TimeGrid::Ladder };
            let refined = rollout(&model, &scene.states[0], scene.gbuffer.as_ref(), course).expect("fits");
            let clean = &scene.states[COUNTS.len() - 1];
            toy::psnr(&refined, clean) - toy::psnr(&scene.states[0], clean)
        });
        gains.sum::<f64>() / self.test.len() as f64
    }
}

fn short() -> TrainingParams {
    TrainingParams { steps: 12, batch: 3, warmup: 2, test_every: 5, checkpoint_every: 4, ..Default::default() }
}

/// Stops the run at the first report after so many steps.
struct Stopper<'a>(u64, &'a AtomicBool);

impl Progress for Stopper<'_> {
    fn report(&self, done: u64, _: u64, _: &str) {
        if done >= self.0 {
            self.1.store(true, Ordering::Relaxed);
        }
    }
}

#[test]
fn a_stopped_training_goes_on_to_the_same_bits() {
    let params = TrainingParams { steps: 16, decay: Decay::Cosine, ..short() };
    let straight = Lab::new(3, 1, 24);
    let whole = straight.train(&params);
    let halved = Lab::new(3, 1, 24);
    let cancel = AtomicBool::new(false);
    let stopped = halved.run(&params, &Stopper(10, &cancel), &cancel);
    assert!(matches!(stopped, Err(KindError::Cancelled)));
    let resumed = halved.train(&params);
    let timing: TrainingTiming = serde_json::from_slice(&halved.bytes(&resumed, "timing")).expect("a timing");
    assert_eq!(timing.steps, 8, "the checkpoint of step 8 was taken up");
    for port in ["model", "log"] {
        assert!(straight.bytes(&whole, port) == halved.bytes(&resumed, port), "{port} differs");
    }
    // Without a decay that looks ahead, more steps go on from fewer.
    let params = TrainingParams { decay: Decay::None, ..params };
    halved.train(&TrainingParams { steps: 8, ..params.clone() });
    let longer = halved.train(&params);
    let timing: TrainingTiming = serde_json::from_slice(&halved.bytes(&longer, "timing")).expect("a timing");
    assert_eq!(timing.steps, 8);
    assert!(straight.bytes(&straight.train(&params), "model") == halved.bytes(&longer, "model"));
}

#[test]
fn a_training_can_begin_with_the_weights_of_a_model() {
    let lab = Lab::new(3, 1, 24);
    let first = lab.train(&short());
    let cancel = AtomicBool::new(false);
    let again =
        |params: &TrainingParams| lab.run_with(params, &[("start", &first.collections["model"])], &Silent, &cancel);
    let same = again(&TrainingParams { steps: 0, ..short() }).expect("no steps");
    let weights = |outputs: &Outputs| lab.bytes(outputs, "model");
    // Behind the header, which notes another number of steps.
    let numbers = |bytes: &[u8]| {
        let header = u64::from_le_bytes(bytes[..8].try_into().expect("eight bytes")) as usize;
        bytes[8 + header..].to_vec()
    };
    assert!(numbers(&weights(&same)) == numbers(&weights(&first)));
    // It goes on from there, and its checkpoints are its own.
    let loss = |outputs: &Outputs, at: usize| lab.log(outputs).points[at].test.expect("test scenes");
    let more = again(&short()).expect("trains");
    assert_eq!(loss(&more, 0), loss(&first, lab.log(&first).points.len() - 1));
    assert!(weights(&more) != weights(&first));
    // Weights for `contrast` can start `covered`, and not the other way.
    let covered = again(&TrainingParams { features: Features::Covered, steps: 0, ..short() }).expect("no steps");
    let back = lab.run_with(&short(), &[("start", &covered.collections["model"])], &Silent, &cancel);
    assert!(back.expect_err("another input").to_string().contains("`features: covered`"));
    let other = again(&TrainingParams { conditioning: Conditioning::Gbuffer, ..short() }).expect_err("another network");
    assert!(other.to_string().contains("`conditioning: rgb`") && other.to_string().contains("`start`"), "{other}");
}

#[test]
fn guided_means_begin_as_the_shaded_means_that_they_start_from() {
    let lab = Lab::new(3, 1, 24);
    let of = |output, steps| TrainingParams { conditioning: Conditioning::Gbuffer, output, steps, ..short() };
    let shaded = lab.train(&of(Output::ShadedMeans, short().steps));
    let cancel = AtomicBool::new(false);
    let from = |start: &Outputs, params: &TrainingParams| {
        lab.run_with(params, &[("start", &start.collections["model"])], &Silent, &cancel)
    };
    let last = |outputs: &Outputs| lab.log(outputs).points.last().and_then(|point| point.test).expect("test scenes");
    let guided = from(&shaded, &of(Output::GuidedMeans, 0)).expect("no steps");
    assert_eq!(last(&guided), last(&shaded), "the guide starts at nothing");
    let trained = from(&shaded, &of(Output::GuidedMeans, 8)).expect("trains");
    let model = Model::load(&lab.bytes(&trained, "model")).expect("a model");
    let file = TensorFile::from_bytes(&model.to_bytes().expect("writes")).expect("safetensors");
    assert!(file.get("guide.kernel").expect("a layer").data.iter().any(|weight| *weight != 0.0), "the guide learns");
    let back = from(&trained, &of(Output::ShadedMeans, 0)).expect_err("a guide has no place there");
    assert!(back.to_string().contains("`output: guided_means`"), "{back}");
    // Albedo is that of the pixel but for a few hundredths until its weights are learned.
    for start in [&shaded, &guided] {
        let smoothed = from(start, &of(Output::SmoothedMeans, 0)).expect("no steps");
        let [found, before] = [&smoothed, &shaded].map(last);
        assert!(found != before && (found - before).abs() < 0.1 * before, "{found} {before}");
    }
    let trained = from(&trained, &of(Output::SmoothedMeans, 8)).expect("trains");
    let file = TensorFile::from_bytes(&lab.bytes(&trained, "model")).expect("safetensors");
    assert!(file.get("smooth.kernel").expect("a layer").data.iter().any(|weight| *weight != 0.0), "albedo is learned");
    let back = from(&trained, &of(Output::GuidedMeans, 0)).expect_err("weights of albedo have no place there");
    assert!(back.to_string().contains("`output: smoothed_means`"), "{back}");
    // Local models have a few hundredths of the weight until they are learned.
    let smoothed = from(&shaded, &of(Output::SmoothedMeans, 0)).expect("no steps");
    for start in [&shaded, &guided, &smoothed] {
        let fitted = from(start, &of(Output::FittedMeans, 0)).expect("no steps");
        let [found, before] = [&fitted, &shaded].map(last);
        assert!(found != before && (found - before).abs() < 0.2 * before, "{found} {before}");
    }
    let trained = from(&trained, &of(Output::FittedMeans, 8)).expect("trains");
    let file = TensorFile::from_bytes(&lab.bytes(&trained, "model")).expect("safetensors");
    for layer in ["fits.kernel", "blend.kernel"] {
        assert!(file.get(layer).expect("a layer").data.iter().any(|weight| *weight != 0.0), "{layer} is learned");
    }
    let back = from(&trained, &of(Output::SmoothedMeans, 0)).expect_err("local models have no place there");
    assert!(back.to_string().contains("`output: fitted_means`"), "{back}");
}

#[test]
fn trainings_side_by_side_have_the_bits_of_one_alone() {
    let lab = Lab::new(3, 1, 24);
    // Fresh stores, so that no checkpoint is found.
    let model = |params: &TrainingParams| {
        let lab = Lab::new(3, 1, 24);
        lab.bytes(&lab.train(params), "model")
    };
    let first = short();
    let second = TrainingParams {
        parameterization: Parameterization::McVelocity,
        conditioning: Conditioning::Gbuffer,
        ..short()
    };
    let alone = [lab.bytes(&lab.train(&first), "model"), lab.bytes(&lab.train(&second), "model")];
    let together = std::thread::scope(|scope| {
        let jobs = [scope.spawn(|| model(&first)), scope.spawn(|| model(&second)), scope.spawn(|| model(&first))];
        jobs.map(|job| job.join().expect("trains"))
    });
    assert!(alone[0] == together[0] && alone[1] == together[1] && alone[0] == together[2]);
    assert!(alone[0] != alone[1]);
}

#[test]
fn every_cell_learns_and_its_curve_says_so() {
    let mut lab = Lab::new(5, 0, 24);
    // What so few steps on so few scenes teach is judged on those scenes.
    lab.test = lab.train.clone();
    for parameterization in Parameterization::ALL {
        for conditioning in [Conditioning::Rgb, Conditioning::Gbuffer] {
            let params = TrainingParams {
                parameterization,
                conditioning,
                steps: 80,
                batch: 4,
                learning_rate: 7e-4,
                warmup: 20,
                test_every: 40,
                checkpoint_every: 1000,
                ..Default::default()
            };
            let log = lab.log(&lab.train(&params));
            assert_eq!(log.points.iter().map(|p| p.step).collect::<Vec<_>>(), [0, 40, 80]);
            // A fresh network averages, which takes most of the noise off before it has learned anything.
            let test: Vec<f64> = log.points.iter().filter_map(|p| p.test).collect();
            assert!(test[2] < 0.97 * test[0], "{parameterization:?} {conditioning:?}: {test:?}");
            assert!(log.points[0].train.is_none() && log.points[1].train.is_some() && log.weights > 100_000);
        }
    }
}

#[test]
fn shuffled_targets_destroy_the_gain() {
    let lab = Lab::new(16, 6, 24);
    let params = TrainingParams {
        steps: 150,
        batch: 4,
        learning_rate: 2e-3,
        warmup: 10,
        test_every: 1000,
        checkpoint_every: 1000,
        decay: Decay::Cosine,
        ..Default::default()
    };
    let (real, shuffled) = (lab.train(&params), lab.train(&TrainingParams { shuffle_targets: true, ..params.clone() }));
    let (real, shuffled) = (lab.gain(&real), lab.gain(&shuffled));
    println!("gain {real:.2} dB, with shuffled targets {shuffled:.2} dB");
    assert!(real > 3.0, "{real}");
    assert!(shuffled < real - 3.0, "{shuffled} {real}");
}

#[test]
fn model_files_round_trip_and_damage_is_named() {
    let lab = Lab::new(2, 1, 16);
    let outputs = lab.train(&TrainingParams { steps: 2, ..short() });
    let bytes = lab.bytes(&outputs, "model");
    let model = Model::load(&bytes).expect("own bytes");
    assert!(model.to_bytes().expect("writes") == bytes);
    assert_eq!((model.info().n_min(), model.info().n_max(), model.info().steps), (1, 16, 2));
    let cut = Model::load(&bytes[..bytes.len() / 2]).err().expect("cut in half").to_string();
    assert!(cut.contains("not a model file") && cut.contains("training"), "{cut}");
    let other = Model::load(&toy::scene(1, 16, &COUNTS).to_bytes().expect("consistent")).err().expect("a scene");
    assert!(other.to_string().contains("not a model file"), "{other}");
    let mut poisoned = bytes.clone();
    let end = poisoned.len();
    poisoned[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    let error = Model::load(&poisoned).err().expect("a NaN").to_string();
    assert!(error.contains("not finite"), "{error}");
}

#[test]
fn images_of_any_size_are_predicted_alone_as_in_a_batch() {
    let lab = Lab::new(2, 1, 16);
    let params = TrainingParams { steps: 3, conditioning: Conditioning::Gbuffer, ..short() };
    let model = Model::load(&lab.bytes(&lab.train(&params), "model")).expect("own bytes");
    let scenes = [toy::scene(5, 21, &COUNTS), toy::scene(6, 21, &COUNTS)];
    let states: Vec<_> = scenes.iter().map(|s| &s.states[0]).collect();
    let gbuffers: Vec<_> = scenes.iter().map(|s| s.gbuffer.as_ref()).collect();
    let both = model.predict_batch(&states, &gbuffers, &[Some(0.0), Some(0.5)]).expect("fits");
    let alone = model.predict_batch(&states[1..], &gbuffers[1..], &[Some(0.5)]).expect("fits");
    assert_eq!((both[1].width(), both[1].height()), (21, 21));
    assert_eq!(both[1], alone[0], "bit by bit");
    let missing =
        model.predict_batch(&states, &[None, None], &[Some(0.0), Some(0.5)]).expect_err("no G-buffers").to_string();
    assert!(missing.contains("G-buffers"), "{missing}");
    assert!(model.predict_batch(&states, &gbuffers[..1], &[Some(0.0), Some(0.5)]).is_err());
}

#[test]
fn unfit_data_are_refused_with_a_reason() {
    let mut lab = Lab::new(2, 1, 16);
    let refused = |lab: &Lab, params: &TrainingParams| {
        lab.run(params, &Silent, &AtomicBool::new(false)).expect_err("unfit").to_string()
    };
    let other = toy::collection(&lab.blobs, 50..51, 16, &[1, 2, 4]);
    lab.test = other;
    assert!(refused(&lab, &short()).contains("same `rungs`"));
    lab.train = toy::collection(&lab.blobs, 0..1, 16, &COUNTS);
    lab.test = Collection::default();
    assert!(refused(&lab, &TrainingParams { shuffle_targets: true, ..short() }).contains("two training scenes"));
    lab.train.items.extend(toy::collection(&lab.blobs, 60..61, 16, &COUNTS[..3]).items);
    let told = refused(&lab, &short());
    assert!(told.contains("[1, 2, 4, 8, 16]") && told.contains("`independent_targets`"), "{told}");
    let apart = TrainingParams {
        unknown_counts: 0.5,
        independent_targets: true,
        parameterization: Parameterization::McNoise,
        ..short()
    };
    let model = Model::load(&lab.bytes(&lab.train(&apart), "model")).expect("own bytes");
    assert_eq!(model.info().counts, COUNTS);
    lab.test = toy::collection(&lab.blobs, 50..52, 16, &COUNTS[..3]);
    assert!(refused(&lab, &apart).contains("same `rungs`"));
    lab.test = Collection::default();
    lab.train = Collection::default();
    assert!(refused(&lab, &short()).contains("no scenes"));
    lab.train = toy::collection(&lab.blobs, 0..1, 6, &COUNTS);
    assert!(refused(&lab, &short()).contains("`crop`"));
    lab.train = toy::collection(&lab.blobs, 0..2, 16, &COUNTS);
    let wild = TrainingParams { learning_rate: 1e30, ..short() };
    assert!(refused(&lab, &wild).contains("`learning_rate`"));
    assert!(Training::check(&TrainingParams::default()).is_empty());
}

/// What `convergence` says of ladders of scenes with this median slope.
fn convergence(blobs: &MemoryBlobs, slope: Option<f64>) -> Collection {
    let estimate = |mean| Estimate { mean, low: mean - 0.1, high: mean + 0.1 };
    let scene = |(name, off): (&str, f64)| SceneConvergence {
        scene: name.into(),
        slope: slope.map(|slope| estimate(slope + off)),
        unresolved: 0,
        variance: Vec::new(),
        excess_kurtosis: None,
        tail_index: None,
        tail_share: 0.0,
        off_normal: Vec::new(),
        trusted_from: None,
        image: Vec::new(),
        image_from: None,
        heavy_tail: false,
        reasons: Vec::new(),
        trust: String::new(),
    };
    let overall = ConvergenceRow {
        stratum: "all".into(),
        scenes: 3,
        noiseless: 0,
        unresolved: 0,
        rmse: Vec::new(),
        law: Vec::new(),
        slope: slope.map(|slope| estimate(slope + 0.3)),
        mean: Vec::new(),
        covariance: Vec::new(),
        excess_kurtosis: None,
        tail_index: None,
        off_normal: Vec::new(),
        trusted_from: None,
        tail_share: 0.0,
        heavy_scenes: 0,
        heavy_tail: false,
        mean_path_length: 2.0,
        rejected: 0,
    };
    let record = Convergence {
        reference_spp: 1024,
        counts: COUNTS.to_vec(),
        sampler: SamplerKind::Sobol,
        overall,
        strata: Vec::new(),
        scenes: [("one", 1.0), ("two", -0.1), ("three", 0.0)].map(scene).to_vec(),
        sde: Vec::new(),
    };
    let cancel = AtomicBool::new(false);
    let stored = record.store(&Context::new(blobs, &Silent, &cancel)).expect("memory");
    [(ItemKey::new("convergence").expect("a key"), stored.into_artifact())].into_iter().collect()
}

/// The scenes of a collection as if they were of another sampler.
fn resampled(blobs: &MemoryBlobs, scenes: &Collection, sampler: SamplerKind) -> Collection {
    let cancel = AtomicBool::new(false);
    let ctx = Context::new(blobs, &Silent, &cancel);
    let of = |(key, artifact): (&ItemKey, &tauflow_contract::Artifact)| {
        let scene = PackedScene::from_bytes(&ctx.part(artifact, "").expect("stored")).expect("own bytes");
        let stored = PackedScene { sampler, ..scene }.store(&ctx).expect("memory");
        (key.clone(), stored.into_artifact())
    };
    scenes.iter().map(of).collect()
}

#[test]
fn a_clock_can_follow_the_error_of_the_ladders() {
    let mut lab = Lab::new(3, 1, 24);
    let cancel = AtomicBool::new(false);
    let plain = lab.train(&short());
    (lab.train, lab.test) = [&lab.train, &lab.test].map(|of| resampled(&lab.blobs, of, SamplerKind::Sobol)).into();
    let measured = convergence(&lab.blobs, Some(-0.75));
    let run = |lab: &Lab, params: &TrainingParams, measured: Option<&Collection>| {
        let more: Vec<_> = measured.map(|of| ("convergence", of)).into_iter().collect();
        lab.run_with(params, &more, &Silent, &cancel)
    };
    let fitted = TrainingParams { clock: Clock::Fitted, ..short() };
    let outputs = run(&lab, &fitted, Some(&measured)).expect("trains");
    let bytes = lab.bytes(&outputs, "model");
    let model = Model::load(&bytes).expect("own bytes");
    assert_eq!((model.clock().exponent(), model.info().exponent), (0.75, 0.75));
    assert_eq!(model.info().sampler, SamplerKind::Sobol);
    let eighth = 8f64.powf(-0.75);
    assert!((model.clock().tau(8.0) - (1.0 - eighth) / (1.0 - 16f64.powf(-0.75))).abs() < 1e-12);
    // The clock of independent samples is that of before, and files say nothing of it.
    let same = run(&lab, &short(), Some(&measured)).expect("trains");
    let same = Model::load(&lab.bytes(&same, "model")).expect("own bytes");
    let before = Model::load(&lab.bytes(&plain, "model")).expect("own bytes");
    assert_eq!(same.info(), &ModelInfo { sampler: SamplerKind::Sobol, ..before.info().clone() });
    let state = toy::scene(5, 24, &COUNTS).states[0].clone();
    let predicted = |model: &Model| model.predict_batch(&[&state], &[None], &[Some(0.3)]).expect("fits");
    assert!(predicted(&same) == predicted(&before) && predicted(&model) != predicted(&before));
    assert!(!String::from_utf8_lossy(&lab.bytes(&plain, "model")[..2048]).contains("exponent"));
    // Checkpoints of one clock are not those of another.
    let other = convergence(&lab.blobs, Some(-0.6));
    let steeper = run(&lab, &fitted, Some(&other)).expect("trains");
    let timing: TrainingTiming = serde_json::from_slice(&lab.bytes(&steeper, "timing")).expect("a timing");
    assert_eq!(timing.steps, short().steps);

    let refused = |params: &TrainingParams, measured: Option<f64>, lab: &Lab| {
        let measured = measured.map(|slope| convergence(&lab.blobs, Some(slope).filter(|slope| slope.is_finite())));
        run(lab, params, measured.as_ref()).expect_err("refused").to_string()
    };
    assert!(refused(&fitted, None, &lab).contains("`clock: fitted` needs the input `convergence`"));
    assert!(refused(&fitted, Some(f64::NAN), &lab).contains("has no slope"));
    assert!(refused(&fitted, Some(0.01), &lab).contains("have the median slope 0.010"));
    let independent = [&lab.train, &lab.test].map(|of| resampled(&lab.blobs, of, SamplerKind::Independent));
    let correlated = std::mem::replace(&mut lab.train, independent[0].clone());
    assert!(refused(&fitted, Some(-0.6), &lab).contains("by `sobol`, but the training scenes by `independent`"));
    lab.train = correlated;
    let targets = TrainingParams { unknown_counts: 0.5, independent_targets: true, ..short() };
    assert!(refused(&targets, None, &lab).contains("`independent_targets` needs independent samples"));
    lab.test = resampled(&lab.blobs, &lab.test, SamplerKind::Independent);
    assert!(refused(&short(), None, &lab).contains("by `independent`, but the training scenes by `sobol`"));
}
