//! Trainings on small bad data, and networks on extreme images.

use super::{Hazard, about, held};
use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{Action, Artifact, Blobs, Collection, Context, ItemKey, Kind, MemoryBlobs, Outputs, Silent};
use tauflow_data::{
    Image,
    formats::{PACKED, PackedScene},
    results::TrainingLog,
    rng::Stream,
    time::TimeGrid,
};
use tauflow_train::{Conditioning, Course, Loss, Model, Parameterization, Space, Training, TrainingParams, rollout};

const TRAINING: &str = "Training";
const NETWORKS: &str = "Networks";
const SIDE: usize = 16;
const COUNTS: [u64; 4] = [1, 2, 4, 8];

/// A scene of noise about a ramp; `bright` is put into one pixel of the first rung.
fn scene(seed: u64, bright: f32) -> PackedScene {
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
    PackedScene { counts: COUNTS.to_vec(), states, gbuffer: Some(Image::new(SIDE, SIDE, 6)) }
}

struct Lab {
    blobs: MemoryBlobs,
    stop: AtomicBool,
}

impl Lab {
    fn new() -> Self {
        Self { blobs: MemoryBlobs::default(), stop: AtomicBool::new(false) }
    }

    fn scenes(&self, scenes: impl IntoIterator<Item = PackedScene>) -> Collection {
        let store = |(i, scene): (usize, PackedScene)| {
            let digest = self.blobs.put(&scene.to_bytes().expect("consistent")).expect("memory");
            (ItemKey::new(format!("L0-open-{i:06}")).expect("plain"), Artifact::blob(PACKED, digest))
        };
        scenes.into_iter().enumerate().map(store).collect()
    }

    fn train(&self, train: &Collection, params: TrainingParams) -> Result<Outputs, String> {
        let ctx = Context::new(&self.blobs, &Silent, &self.stop);
        let whole = BTreeMap::from([("train", train)]);
        let action = Action { params, item: None, group: "main", seed: 3, each: BTreeMap::new(), whole };
        Training::run(&ctx, &action).map_err(|e| e.to_string())
    }

    fn part(&self, outputs: &Outputs, port: &str) -> Vec<u8> {
        let ctx = Context::new(&self.blobs, &Silent, &self.stop);
        ctx.part(outputs.collections[port].get("model").expect("one item"), "").expect("stored")
    }
}

fn short() -> TrainingParams {
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

pub fn hazards() -> Vec<Hazard> {
    let mut out = trainings();
    out.extend(networks());
    out
}

fn trainings() -> Vec<Hazard> {
    let mut out = Vec::new();
    let mut add =
        |fed: String, must: &str, came: Result<String, String>| out.push(Hazard::new(TRAINING, fed, must, came));
    for (space, loss) in [(Space::Linear, Loss::Squared), (Space::Log1p, Loss::Absolute)] {
        for parameterization in Parameterization::ALL {
            let lab = Lab::new();
            let bright = lab.scenes((0..3).map(|i| scene(i, 1e6)));
            let params =
                TrainingParams { parameterization, space, loss, conditioning: Conditioning::Gbuffer, ..short() };
            let came = lab.train(&bright, params).and_then(|outputs| {
                let log: TrainingLog = serde_json::from_slice(&lab.part(&outputs, "log")).map_err(|e| e.to_string())?;
                let fine = log.points.iter().filter_map(|p| p.train).all(f64::is_finite);
                held(fine && Model::load(&lab.part(&outputs, "model")).is_ok(), "finite losses and weights".into())
            });
            add(
                format!("a firefly of 1e6 in every scene, {} in {} space", parameterization.name(), space.name()),
                "finite losses and weights",
                came,
            );
        }
    }
    let lab = Lab::new();
    let scenes = lab.scenes((0..3).map(|i| scene(i, 0.0)));
    let params = TrainingParams { learning_rate: 1e3, clip: 1e9, steps: 200, ..short() };
    let came = match lab.train(&scenes, params) {
        Err(told) => held(told.contains("learning_rate"), "told by name, with the step and the remedy".into()),
        // Weighted means cannot leave the window: a rate that makes no sense need not end in infinities.
        Ok(_) => Ok("weights stayed finite".into()),
    };
    add("a learning rate of 1,000 without clipping".into(), "an error that names it, or finite weights", came);
    let one = lab.scenes([scene(1, 0.0)]);
    add("a data set of one scene".into(), "a model", lab.train(&one, short()).map(|_| "a model".into()));
    let came = match lab.train(&Collection::default(), short()) {
        Err(told) => held(told.contains("train"), "refused by name".into()),
        Ok(_) => Err("taken".into()),
    };
    add("a data set of none".into(), "refused by name", came);
    let mut broken = scene(1, 0.0);
    broken.states[1].data_mut()[7] = f32::NAN;
    let came = match lab.train(&lab.scenes([scene(0, 0.0), broken]), short()) {
        Err(told) => {
            held(told.contains("finite") && told.contains("L0-open-000001"), "refused, with the scene's name".into())
        }
        Ok(_) => Err("taken".into()),
    };
    add("a scene with a value that is no number".into(), "refused by name", came);
    // Stopped after each step and gone on with: what one run has done, another finds.
    let whole = lab.train(&scenes, TrainingParams { checkpoint_every: 100, ..short() }).map(|o| lab.part(&o, "model"));
    let came = whole.and_then(|whole| {
        for stop in 1..6u64 {
            let other = Lab::new();
            let scenes = other.scenes((0..3).map(|i| scene(i, 0.0)));
            let params = |steps| TrainingParams { checkpoint_every: 1, steps, ..short() };
            other.train(&scenes, params(stop))?;
            let resumed = other.train(&scenes, params(6))?;
            if other.part(&resumed, "model") != whole {
                return Err(format!("other bits after a stop at step {stop}"));
            }
        }
        Ok("the same bits".into())
    });
    add(
        "a training that is stopped after any of its six steps and gone on with".into(),
        "the bits of one that is not",
        came,
    );
    out
}

fn networks() -> Vec<Hazard> {
    let mut out = Vec::new();
    let mut add =
        |fed: String, must: &str, came: Result<String, String>| out.push(Hazard::new(NETWORKS, fed, must, came));
    let lab = Lab::new();
    let scenes = lab.scenes((0..3).map(|i| scene(i, 0.0)));
    for parameterization in [Parameterization::McNoise, Parameterization::McVelocity] {
        let params =
            TrainingParams { parameterization, conditioning: Conditioning::Gbuffer, space: Space::Log1p, ..short() };
        let model =
            lab.train(&scenes, params).and_then(|o| Model::load(&lab.part(&o, "model")).map_err(|e| e.to_string()));
        let refine = |factor: f32, steps: usize, flat: Option<f32>| -> Result<(f64, f64, f64), String> {
            let model = model.as_ref().map_err(Clone::clone)?;
            let scene = scene(9, 0.0);
            let image = scene.states[0].map(|v| flat.unwrap_or(v) * factor);
            let course = Course { from: 1, steps, grid: TimeGrid::Ladder };
            let end = rollout(model, &image, scene.gbuffer.as_ref(), course).map_err(|e| e.to_string())?;
            let range = |image: &Image| {
                image.data().iter().fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(f64::from(*v)), b.max(f64::from(*v))))
            };
            let (_, before) = range(&image);
            let (low, high) = range(&end);
            Ok((low, high, before))
        };
        for exponent in [-6i32, 0, 6] {
            let came = refine(10f32.powi(exponent), 9, None).and_then(|(low, high, before)| {
                held(
                    low.is_finite() && high <= 1.001 * before && low >= -1e-3 * before,
                    "finite, and within the range of the input".into(),
                )
            });
            add(
                format!("{}, an exposure of 1e{exponent}", parameterization.name()),
                "an image within the range of its input",
                came,
            );
        }
        let came = refine(1.0, 9, Some(0.0)).and_then(|(low, high, _)| held(low == 0.0 && high == 0.0, "black".into()));
        add(format!("{}, a black image", parameterization.name()), "black", came);
        let came = refine(1.0, 9, Some(0.7)).and_then(|(low, high, _)| {
            let off = (low / 0.7 - 1.0).abs().max((high / 0.7 - 1.0).abs());
            held(off < 1e-4, format!("itself to {}", about(off)))
        });
        add(
            format!("{}, a constant image", parameterization.name()),
            "itself: nothing varies, so nothing is noise",
            came,
        );
        let came = refine(1.0, 200, None)
            .and_then(|(low, high, _)| held(low.is_finite() && high.is_finite(), "finite".into()));
        add(format!("{}, 200 calls", parameterization.name()), "a finite image", came);
    }
    out
}
