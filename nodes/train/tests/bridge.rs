//! `bridge_refinement` on a synthetic ladder whose law is exact: with the held-out reference as the clean estimate, the
//! stochastic bridge has the variances and covariances of the real rungs at all stops.

#[expect(dead_code, reason = "other tests use the rest")]
mod toy;

use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{Action, Artifact, Context, Kind, KindError, Media, MemoryBlobs, Outputs, Silent};
use tauflow_data::{
    Image, IntegratorKind, SamplerKind,
    methods::{
        BridgeMethod, EXPECTATION, GAUSSIAN, GAUSSIAN_TAU, HOLD, LOCAL_DELTA, LOCAL_STEP, Parameterization, STOCHASTIC,
    },
    records::{BridgeSteps, Exposure, Ladder, LadderMeta, PackedScene, RefinedImages, Rung},
    rng::Stream,
    time::VarianceTime,
};
use tauflow_train::{BridgeRefinement, BridgeRefinementParams, Conditioning, Space, Training, TrainingParams};

const SIDE: usize = 192;
const MEAN: f64 = 2.0;
const EXPOSURE: f64 = 0.5;
const HELD: u64 = 4096;

/// Deviation of the single samples of a value, of the raw scene.
fn deviation(at: usize) -> f64 {
    0.5 + 1.5 * ((at * 37) % 101) as f64 / 100.0
}

/// Exposed rungs 1..=10 of independent samples of mean [`MEAN`], and a raw held-out reference of the same scene.
fn scene(sampler: SamplerKind, spp: u64) -> (PackedScene, Ladder) {
    let mut stream = Stream::new(9, &[]);
    let mut states = vec![Image::new(SIDE, SIDE, 3); 10];
    let (mut mean, mut variance) = (Image::new(SIDE, SIDE, 3), Image::new(SIDE, SIDE, 3));
    for at in 0..mean.data().len() {
        let mut sum = 0.0;
        for (n, state) in (1..).zip(&mut states) {
            sum += MEAN + deviation(at) * stream.normal();
            state.data_mut()[at] = (EXPOSURE * sum / f64::from(n)) as f32;
        }
        mean.data_mut()[at] = (MEAN + deviation(at) / (spp as f64).sqrt() * stream.normal()) as f32;
        variance.data_mut()[at] = deviation(at).powi(2) as f32;
    }
    let meta = LadderMeta {
        counts: vec![spp],
        width: SIDE,
        height: SIDE,
        rejected: 0,
        mean_path_length: 1.0,
        sampler,
        integrator: IntegratorKind::Path,
        estimated_error: None,
    };
    let held = Ladder { meta, rungs: vec![Rung { spp, image: mean }], variance };
    (PackedScene { counts: (1..=10).collect(), states, gbuffer: None, sampler: Default::default() }, held)
}

struct Lab {
    blobs: MemoryBlobs,
    cancel: AtomicBool,
}

impl Lab {
    fn new() -> Self {
        Self { blobs: MemoryBlobs::default(), cancel: AtomicBool::new(false) }
    }

    fn store(&self, media: &impl Media) -> Artifact {
        media.store(&Context::new(&self.blobs, &Silent, &self.cancel)).expect("stored").into_artifact()
    }

    /// A network with its first weights.
    fn model(&self, parameterization: Parameterization, space: Space) -> Outputs {
        let train = toy::collection(&self.blobs, 0..2, 16, &[1, 2, 4, 8, 16, 32]);
        let ctx = Context::new(&self.blobs, &Silent, &self.cancel);
        let params =
            TrainingParams { parameterization, conditioning: Conditioning::Rgb, steps: 0, space, ..Default::default() };
        let all = BTreeMap::from([("train", &train)]);
        Training::run(&ctx, &Action { params, item: None, group: "main", seed: 11, each: BTreeMap::new(), all })
            .expect("nothing to train")
    }

    fn bridge(
        &self,
        spaces: [Space; 2],
        packed: &PackedScene,
        held: Option<&Ladder>,
    ) -> Result<BridgeSteps, KindError> {
        let noise = self.model(Parameterization::McNoise, spaces[0]);
        let local = self.model(Parameterization::LocalVelocity, spaces[1]);
        let packed = self.store(packed);
        let exposure = self.store(&Exposure { factor: EXPOSURE, ev: 0.0, mean_luminance: 0.18 / EXPOSURE });
        let gaussian = held.is_some().then_some(0.7);
        let held = held.map(|held| self.store(held));
        let mut each = BTreeMap::from([("endpoints", &packed)]);
        if let Some(held) = &held {
            each.extend([("references", held), ("exposure", &exposure)]);
        }
        let all = BTreeMap::from([
            ("mc_noise", &noise.collections["model"]),
            ("local_velocity", &local.collections["model"]),
        ]);
        let ctx = Context::new(&self.blobs, &Silent, &self.cancel);
        let params = BridgeRefinementParams { gaussian, ..Default::default() };
        let outputs = BridgeRefinement::run(&ctx, &Action { params, item: None, group: "main", seed: 5, each, all })?;
        BridgeSteps::load(&ctx, &outputs.items["steps"])
    }
}

fn image<'a>(images: &'a RefinedImages, method: &str, (from, to): (u64, u64)) -> &'a Image {
    let is = |said: &&(tauflow_data::records::RefinedImage, Image)| {
        (said.0.method.as_str(), said.0.from_spp, said.0.to_spp) == (method, from, to)
    };
    images.iter().find(is).map_or_else(|| panic!("{method} {from} -> {to}"), |(_, image)| image)
}

fn stops() -> impl Iterator<Item = (u64, u64)> {
    (1..10).map(|k| (k, k + 1)).chain((1..9).map(|k| (k, 10)))
}

/// Variance around the mean, and covariance with the start, each value in units of its deviation.
fn moments(image: &Image, start: &Image) -> [f64; 2] {
    let off = |image: &Image, at: usize| (f64::from(image.data()[at]) / EXPOSURE - MEAN) / deviation(at);
    let count = image.data().len();
    let sum = |other: &Image| (0..count).map(|at| off(image, at) * off(other, at)).sum::<f64>() / count as f64;
    [sum(image), sum(start)]
}

#[test]
fn with_the_reference_the_stochastic_bridge_has_the_moments_of_real_rungs() {
    let (packed, held) = scene(SamplerKind::Independent, HELD);
    let steps = Lab::new().bridge([Space::Linear; 2], &packed, Some(&held)).expect("consistent");
    let state = |count: u64| &packed.states[count as usize - 1];
    let by_reference = |rule: &str| BridgeMethod { reference: true, log: false, rule }.name();
    for stop @ (from, to) in stops() {
        let [variance, covariance] = moments(image(&steps.images, &by_reference(STOCHASTIC), stop), state(from));
        let [real_variance, real_covariance] = moments(state(to), state(from));
        let (of_variance, of_covariance) = (variance / real_variance - 1.0, covariance / real_covariance - 1.0);
        println!("{from} -> {to}: variance {:+.2}%, covariance {:+.2}%", 100.0 * of_variance, 100.0 * of_covariance);
        assert!(of_variance.abs() < 0.05 && of_covariance.abs() < 0.05, "{stop:?}: {of_variance} {of_covariance}");
        // Both filters go towards the same image, by the fractions of the expectation and of variance time.
        let moved = |rule: &str| -> f64 {
            let pairs = image(&steps.images, rule, stop).data().iter().zip(state(from).data());
            pairs.map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs()).sum()
        };
        let clock = VarianceTime::new(1, 32).expect("a ladder");
        let time = (clock.tau(to as f64) - clock.tau(from as f64)) / (1.0 - clock.tau(from as f64));
        let ratio = moved(GAUSSIAN_TAU) / moved(GAUSSIAN) / (time / (1.0 - from as f64 / to as f64));
        assert!((ratio - 1.0).abs() < 1e-4, "{stop:?}: {ratio}");
        // The expectation alone has k/m of the variance.
        let [expected, _] = moments(image(&steps.images, &by_reference(EXPECTATION), stop), state(from));
        assert!((expected / real_variance / (from as f64 / to as f64) - 1.0).abs() < 0.05, "{stop:?}: {expected}");
        // Euler steps end near the expectation, and whole deltas go too far. From 1 to 2, the step is the whole delta.
        let left = |rule: &str| moments(image(&steps.images, &by_reference(rule), stop), state(from))[0];
        let (delta, step) = (left(LOCAL_DELTA), left(LOCAL_STEP));
        let same = (delta / step - 1.0).abs() < 1e-3;
        assert!(if stop == (1, 2) { same } else { delta < step && !same }, "{stop:?}: {delta} {step}");
    }
}

#[test]
fn methods_of_all_rules_spaces_and_estimates_are_there() {
    let (packed, held) = scene(SamplerKind::Independent, HELD);
    let small = |image: &Image| {
        let data = (0..16 * 16).flat_map(|p| image.pixel(p % 16, p / 16).to_vec()).collect();
        Image::from_data(16, 16, 3, data).expect("fits")
    };
    let packed = PackedScene { states: packed.states.iter().map(small).collect(), ..packed };
    let held = Ladder {
        rungs: held.rungs.iter().map(|rung| Rung { spp: rung.spp, image: small(&rung.image) }).collect(),
        variance: small(&held.variance),
        ..held
    };
    let lab = Lab::new();
    let count = |held: Option<&Ladder>| {
        let steps = lab.bridge([Space::Log1p; 2], &packed, held).expect("consistent");
        assert_eq!(steps.setting.get("space").map(String::as_str), Some("log1p"));
        assert_eq!(steps.setting.get("features").map(String::as_str), Some("contrast"));
        let mut of: BTreeMap<String, usize> = BTreeMap::new();
        steps.images.iter().for_each(|(said, _)| *of.entry(said.method.clone()).or_default() += 1);
        assert!(of.values().all(|images| *images == 17), "{of:?}");
        of.into_keys().collect::<Vec<_>>()
    };
    let alone = count(None);
    assert_eq!(alone.len(), 1 + 3 * 2 + 1);
    assert!([HOLD, "local_delta+log1p", "mc_noise", EXPECTATION].iter().all(|name| alone.contains(&(*name).into())));
    let with = count(Some(&held));
    assert_eq!(with.len(), 1 + 3 * 2 * 2 + 4 + 2);
    assert!(["mc_noise+log1p+reference", STOCHASTIC].iter().all(|name| with.contains(&(*name).into())));
}

#[test]
fn references_that_do_not_fit_are_refused() {
    let lab = Lab::new();
    let (packed, held) = scene(SamplerKind::Sobol, HELD);
    let correlated = PackedScene { sampler: SamplerKind::Sobol, ..packed.clone() };
    let refused = lab.bridge([Space::Linear; 2], &correlated, None).expect_err("refused").to_string();
    assert!(refused.contains("those of the endpoints are correlated"), "{refused}");
    let refusal = |spaces, held: &Ladder| lab.bridge(spaces, &packed, Some(held)).expect_err("refused").to_string();
    assert!(refusal([Space::Linear; 2], &held).contains("sampler: independent"));
    assert!(refusal([Space::Linear, Space::Log1p], &held).contains("trained in different settings"));
    let (_, held) = scene(SamplerKind::Independent, 10);
    assert!(refusal([Space::Linear; 2], &held).contains("has 10 samples"));
    let (_, held) = scene(SamplerKind::Independent, HELD);
    let small =
        Ladder { rungs: vec![Rung { spp: HELD, image: Image::new(8, 8, 3) }], variance: Image::new(8, 8, 3), ..held };
    assert!(refusal([Space::Linear; 2], &small).contains("8 x 8 pixels"));
}
