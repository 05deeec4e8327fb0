//! The kind `bridge_validation` over synthetic ladders.
//!
//! The ladders are running means of normal samples about a known image, and the solvers know the clean image. So what
//! the bridge should find is known in closed form.

use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{
    Action, Collection, Context, Handle, ItemKey, Kind, KindError, Media, MemoryBlobs, Outputs, Silent,
};
use tauflow_data::{
    Image, IntegratorKind, SamplerKind, Stratum, VarianceTime,
    maths::log10,
    methods::{HOLD, LOCAL_DELTA, LOCAL_STEP, Parameterization, STOCHASTIC},
    records::{
        Bridge, BridgeClock, BridgeFiles, BridgeSteps, BridgeSummary, Claim, ClaimVerdict, Exposure, Ladder,
        LadderMeta, PackedScene, RefinedImage, RefinedImages, Rung,
    },
    rng::Stream,
};
use tauflow_eval::{BridgeValidation, BridgeValidationParams, fraction};

const MC_NOISE: &str = Parameterization::McNoise.name();

const SIDE: usize = 16;
const SIGMA: f64 = 0.2;
const SCENES: usize = 10;

/// Rungs 1..=10 of normal samples of deviation [`SIGMA`] about 0.5 to 1.5.
fn ladder(seed: u64) -> (Image, PackedScene) {
    let mut stream = Stream::new(seed, &[]);
    let mut truth = Image::new(SIDE, SIDE, 3);
    let mut states: Vec<Image> = (0..10).map(|_| truth.clone()).collect();
    for at in 0..truth.data().len() {
        let mean = stream.range(1.0, 1.5);
        truth.data_mut()[at] = mean as f32;
        let mut sum = 0.0;
        for (n, state) in states.iter_mut().enumerate() {
            sum += mean + SIGMA * stream.normal();
            state.data_mut()[at] = (sum / (n + 1) as f64) as f32;
        }
    }
    (truth, PackedScene { counts: (1..=10).collect(), states, gbuffer: None, sampler: Default::default() })
}

/// `start` moved a share of the way to `goal`.
fn moved(start: &Image, goal: &Image, share: f64) -> Image {
    let step = |(a, b): (&f32, &f32)| (f64::from(*a) + share * (f64::from(*b) - f64::from(*a))) as f32;
    let data = start.data().iter().zip(goal.data()).map(step).collect();
    Image::from_data(SIDE, SIDE, 3, data).expect("fits")
}

fn stops() -> impl Iterator<Item = (u64, u64)> {
    (1..10).map(|k| (k, k + 1)).chain((1..9).map(|k| (k, 10)))
}

struct Bench {
    blobs: MemoryBlobs,
    stop: AtomicBool,
    endpoints: Collection,
    steps: Collection,
    references: Option<[Collection; 2]>,
}

impl Bench {
    /// Scenes whose `mc_noise` knows the clean image, and whose `local_step` overshoots twice as far.
    fn new(clock: BridgeClock) -> Self {
        let stop = AtomicBool::new(false);
        let mut bench = Self {
            blobs: MemoryBlobs::default(),
            stop,
            endpoints: Collection::default(),
            steps: Collection::default(),
            references: None,
        };
        let time = VarianceTime::new(1, 512).expect("a ladder");
        for (index, stratum) in Stratum::all().take(SCENES).enumerate() {
            let (truth, scene) = ladder(index as u64);
            let mut images = Vec::new();
            for (from, to) in stops() {
                let start = &scene.states[from as usize - 1];
                let share = fraction(time, from, to).expect("inside");
                let said = |method: &str, nfe| RefinedImage { method: method.into(), from_spp: from, to_spp: to, nfe };
                images.push((said(HOLD, 0), start.clone()));
                images.push((said(LOCAL_STEP, to - from), moved(start, &truth, 2.0 * share)));
                images.push((said(LOCAL_DELTA, to - from), moved(start, &truth, 3.0)));
                images.push((said(MC_NOISE, 1), moved(start, &truth, share)));
            }
            bench.put(stratum.item_key(index as u64), &scene, images, clock);
        }
        bench
    }

    fn put(&mut self, key: ItemKey, scene: &PackedScene, images: RefinedImages, clock: BridgeClock) {
        let ctx = Context::new(&self.blobs, &Silent, &self.stop);
        let packed = scene.store(&ctx).expect("consistent");
        let setting = BTreeMap::from([("space".to_owned(), "linear".to_owned())]);
        let steps = BridgeSteps { clock, setting, images }.store(&ctx).expect("stored");
        self.endpoints.items.insert(key.clone(), packed.into_artifact());
        self.steps.items.insert(key, steps.into_artifact());
    }

    fn run(&self) -> Result<Outputs, KindError> {
        let ctx = Context::new(&self.blobs, &Silent, &self.stop);
        let action = Action {
            params: BridgeValidationParams { resamples: 300, map_scenes: 2 },
            item: None,
            group: "main",
            seed: 3,
            each: BTreeMap::new(),
            all: self.inputs(),
        };
        BridgeValidation::run(&ctx, &action)
    }

    fn inputs(&self) -> BTreeMap<&'static str, &Collection> {
        let mut all = BTreeMap::from([("endpoints", &self.endpoints), ("steps", &self.steps)]);
        if let Some([references, exposure]) = &self.references {
            all.extend([("references", references), ("exposure", exposure)]);
        }
        all
    }

    /// Connects noise-free references, of which the scenes are twice as bright.
    fn refer(&mut self, sampler: SamplerKind, side: usize) {
        let ctx = Context::new(&self.blobs, &Silent, &self.stop);
        let (mut references, mut exposures) = (Collection::default(), Collection::default());
        for key in self.endpoints.items.keys() {
            let (_, index) = Stratum::of_key(key.as_str()).expect("a stratum's key");
            let (truth, _) = ladder(index);
            let spp = 4096;
            let meta = LadderMeta {
                counts: vec![spp],
                width: side,
                height: side,
                rejected: 0,
                mean_path_length: 1.0,
                sampler,
                integrator: IntegratorKind::Path,
                estimated_error: None,
            };
            let image = if side == SIDE { truth.map(|v| 0.5 * v) } else { Image::new(side, side, 3) };
            let variance = image.map(|_| (0.25 * SIGMA * SIGMA) as f32);
            let ladder = Ladder { meta, rungs: vec![Rung { spp, image }], variance };
            let exposure = Exposure { factor: 2.0, ev: 0.0, mean_luminance: 0.09 };
            references.items.insert(key.clone(), ladder.store(&ctx).expect("stored").into_artifact());
            exposures.items.insert(key.clone(), exposure.store(&ctx).expect("stored").into_artifact());
        }
        self.references = Some([references, exposures]);
    }

    fn bridge(&self) -> Bridge {
        let out = self.run().expect("sound steps");
        let artifact = out.collections["bridge"].get("bridge").expect("the item");
        let ctx = Context::new(&self.blobs, &Silent, &self.stop);
        Handle::<BridgeFiles>::new(artifact).expect("the port's type").load(&ctx).expect("stored").bridge
    }

    fn refusal(&self) -> String {
        self.run().expect_err("refused").to_string()
    }
}

const CLOCK: BridgeClock = BridgeClock::new(1, 512);

fn of<'a>(bridge: &'a Bridge, stop: &str, method: &str) -> &'a BridgeSummary {
    bridge.summary.iter().find(|s| s.stop == stop && s.method == method).expect("summed up")
}

#[test]
fn ten_scenes_make_ninety_adjacent_and_eighty_direct_cases() {
    let bench = Bench::new(CLOCK);
    let out = bench.run().expect("sound steps");
    let artifact = out.collections["bridge"].get("bridge").expect("the item");
    let ctx = Context::new(&bench.blobs, &Silent, &bench.stop);
    let files = Handle::<BridgeFiles>::new(artifact).expect("the port's type").load(&ctx).expect("stored");
    let bridge = &files.bridge;
    assert_eq!((bridge.n_max, bridge.scenes, bridge.rows.len(), bridge.cases.len()), (512, 10, 4 * 17, 4 * 170));
    for method in [HOLD, LOCAL_STEP, MC_NOISE] {
        assert_eq!((of(bridge, "adjacent", method).cases, of(bridge, "direct", method).cases), (90, 80));
    }
    assert!(!bridge.cases.iter().any(|c| c.stop == "direct" && c.from_spp == 9));
    assert!(bridge.rows.iter().all(|r| r.fraction > 0.0 && r.fraction < 1.0));

    // Hold: Var(I_k - I_m) = sigma^2 (1/k - 1/m), from 768 x 10 values: a standard error of .07 dB, and
    // 68 correlated rows to look at, so that .25 dB is far enough.
    for row in bridge.rows.iter().filter(|r| r.method == HOLD) {
        let mse = SIGMA * SIGMA * (1.0 / row.from_spp as f64 - 1.0 / row.to_spp as f64);
        assert!((row.psnr.mean + 10.0 * log10(mse)).abs() < 0.25, "{row:?}");
        assert_eq!((row.gain.mean, row.gain.low, row.gain.high), (0.0, 0.0, 0.0));
    }
    // A move a to the truth leaves I_k - I_m - a (I_k - mu), of variance
    // sigma^2 ((1-a)^2/k + 1/m - 2 (1-a)/m): Cov(I_k, I_m) = sigma^2/m.
    for row in bridge.rows.iter().filter(|r| r.method != HOLD && r.method != LOCAL_DELTA) {
        let (k, m) = (row.from_spp as f64, row.to_spp as f64);
        let rest = 1.0 - if row.method == MC_NOISE { row.fraction } else { 2.0 * row.fraction };
        let mse = SIGMA * SIGMA * (rest * rest / k + 1.0 / m - 2.0 * rest / m);
        assert!((row.psnr.mean + 10.0 * log10(mse)).abs() < 0.25, "{row:?}");
    }
    let noise = of(bridge, "adjacent", MC_NOISE);
    assert!(noise.gain.low > 0.0 && noise.better > 0.9, "{noise:?}");
    assert_eq!(of(bridge, "adjacent", HOLD).better, 0.0);
    // The real update has the share sqrt(1 - k/m) of its direction towards the truth, since I_m itself is noisy.
    for case in bridge.cases.iter().filter(|c| c.method != HOLD && c.method != LOCAL_DELTA) {
        let expected = (1.0 - case.from_spp as f64 / case.to_spp as f64).sqrt();
        assert!((case.direction.expect("an update") - expected).abs() < 0.13, "{case:?}");
    }
    assert!(bridge.cases.iter().all(|c| (c.method == HOLD) == c.direction.is_none()));

    let csv = String::from_utf8(files.cases_csv.clone()).expect("text");
    assert_eq!(csv.lines().count(), 1 + bridge.cases.len());
    assert_eq!(files.maps.len(), 2 * 2 * 17);
    assert!(files.maps.contains_key("L0-enclosed-000002/adjacent-09.png"));
    assert!(files.maps.contains_key("L0-enclosed-000002/direct-08.png"));
    // What is published keeps its names.
    for part in ["bridge.json", "cases.csv", "maps/L0-enclosed-000002/strip-direct-08.png"] {
        assert!(artifact.parts.contains_key(part), "{part}");
    }
    assert_eq!(artifact.parts.len(), 2 + 2 * 2 * 17);
    assert_eq!(bench.run().expect("again"), out, "the same bits again");
}

#[test]
fn claims_are_judged_against_the_local_delta_and_against_euler_steps() {
    let bench = Bench::new(CLOCK);
    let found = bench.bridge();
    assert_eq!(found.setting["space"], "linear");
    let of = |statement: &str| -> Vec<&Claim> {
        found.claims.iter().filter(|claim| claim.statement.contains(statement)).collect()
    };
    let (paper, euler) = (of("the local delta"), of("Euler steps"));
    // Adjacent and direct; nothing was moved in logarithms.
    assert_eq!((paper.len(), euler.len(), found.claims.len()), (2, 2, 4));
    for claim in paper {
        assert_eq!(claim.group["moved_in"], "linear");
        assert_eq!(claim.group["space"], "linear");
        assert_eq!(claim.evidence.len(), 2);
        // Three times the way to the truth is beyond it.
        assert_eq!(claim.verdict, ClaimVerdict::Held, "{claim:?}");
    }
    // A single scene decides nothing, whatever its differences are.
    let mut single = Bench::new(CLOCK);
    let (first, _) = single.steps.iter().next().expect("scenes");
    let first = first.clone();
    for of in [&mut single.endpoints, &mut single.steps] {
        of.items.retain(|key, _| *key == first);
    }
    let found = single.bridge();
    assert!((found.scenes, found.has_intervals()) == (1, false) && found.claims.len() == 4);
    assert!(found.claims.iter().all(|claim| claim.verdict == ClaimVerdict::Undecided));
}

#[test]
fn with_references_stops_have_variances_and_covariances() {
    let mut bench = Bench::new(CLOCK);
    bench.refer(SamplerKind::Independent, SIDE);
    // A stop whose images are the real rungs: of their moments, by another name.
    let ctx = Context::new(&bench.blobs, &Silent, &bench.stop);
    let mut steps = Collection::default();
    for (key, artifact) in &bench.steps.items {
        let mut own = BridgeSteps::load(&ctx, artifact).expect("stored");
        let packed = PackedScene::load(&ctx, &bench.endpoints.items[key]).expect("stored");
        for (from, to) in stops() {
            let said = RefinedImage { method: STOCHASTIC.into(), from_spp: from, to_spp: to, nfe: 1 };
            own.images.push((said, packed.states[to as usize - 1].clone()));
        }
        steps.items.insert(key.clone(), own.store(&ctx).expect("stored").into_artifact());
    }
    bench.steps = steps;
    let bridge = bench.bridge();
    for row in &bridge.rows {
        let moments = row.moments.as_ref().expect("references");
        let (k, m) = (row.from_spp as f64, row.to_spp as f64);
        assert!((moments.real_variance.mean - 1.0).abs() < 0.05, "{row:?}");
        // From 1 to 10, a tenth of the variance is shared: a standard error of 4%.
        assert!((moments.real_covariance.mean - 1.0).abs() < 0.15, "{row:?}");
        // (1 - share) of the noise of I_k is left.
        let left = match row.method.as_str() {
            HOLD => 1.0,
            LOCAL_STEP => 1.0 - 2.0 * row.fraction,
            LOCAL_DELTA => -2.0,
            MC_NOISE => 1.0 - row.fraction,
            _ => {
                assert_eq!((moments.excess.mean, moments.covariance_excess.high), (0.0, 0.0));
                continue;
            }
        };
        let (variance, covariance) = (left * left * m / k, left * m / k);
        assert!((moments.variance.mean / variance - 1.0).abs() < 0.06 || variance < 0.01, "{row:?} {variance}");
        assert!((moments.covariance.mean - covariance).abs() < 0.06 * covariance.abs(), "{row:?} {covariance}");
        let excess = moments.variance.mean / moments.real_variance.mean - 1.0;
        assert!((moments.excess.mean - excess).abs() < 1e-9);
    }
    let first = bridge.cases.first().expect("cases").moments.expect("references");
    assert!(first.real_variance > 0.5);
    bench.refer(SamplerKind::Sobol, SIDE);
    assert!(bench.refusal().contains("sampler: independent"));
    bench.refer(SamplerKind::Independent, 8);
    assert!(bench.refusal().contains("has 8 x 8 pixels"));
    bench.references.as_mut().expect("connected")[0].items.pop_first();
    assert!(bench.refusal().contains("`references` lacks the item"));
}

#[test]
fn a_fraction_of_one_is_refused() {
    // The last rung of the bridge is that of the training ladder: direct stops would be the clean estimate itself.
    let refusal = Bench::new(BridgeClock::new(1, 10)).refusal();
    assert!(refusal.contains("9 -> 10") || refusal.contains("1 -> 10"), "{refusal}");
    assert!(refusal.contains("would be 1 or more"), "{refusal}");
    assert!(Bench::new(BridgeClock::new(1, 11)).run().is_ok());
}

#[test]
fn what_does_not_fit_is_refused() {
    let key = |index: usize| Stratum::all().nth(index).expect("one of twelve").item_key(index as u64);
    let said = |method: &str, from_spp, to_spp| RefinedImage { method: method.into(), from_spp, to_spp, nfe: 1 };
    let (truth, scene) = ladder(0);
    let first = scene.states[0].clone();
    let with = |images: Vec<(RefinedImage, Image)>, clock| {
        let mut bench = Bench::new(CLOCK);
        bench.put(key(0), &scene, images, clock);
        bench.refusal()
    };
    let hold = || (said(HOLD, 1, 2), first.clone());

    assert!(with(vec![hold()], CLOCK).contains("not every scene"));
    assert!(with(vec![hold()], BridgeClock::new(1, 256)).contains("another training ladder"));
    let again = RefinedImage { nfe: 2, ..hold().0 };
    assert!(with(vec![hold(), (again, first.clone())], CLOCK).contains("two images of `hold` at 1 -> 2"));
    assert!(with(vec![(said(MC_NOISE, 1, 5), truth.clone())], CLOCK).contains("neither to the next"));
    assert!(with(vec![(said(MC_NOISE, 10, 11), truth.clone())], CLOCK).contains("no rung of 11 samples"));
    assert!(with(vec![(said(HOLD, 1, 2), truth.clone())], CLOCK).contains("not that of `endpoints`"));
    let blown = truth.map(|_| f32::NAN);
    assert!(with(vec![(said(MC_NOISE, 1, 2), blown)], CLOCK).contains("768 of the 768 values are not finite"));

    let mut bench = Bench::new(CLOCK);
    bench.steps.items.remove(key(4).as_str());
    assert!(bench.refusal().contains("`steps` lacks the item"));
    let mut bench = Bench::new(CLOCK);
    bench.endpoints.items.remove(key(4).as_str());
    assert!(bench.refusal().contains("`endpoints` lacks the item"));
    let mut bench = Bench::new(CLOCK);
    (bench.steps, bench.endpoints) = (Collection::default(), Collection::default());
    assert!(bench.refusal().contains("no scenes"));

    // One scene whose only image is no hold.
    let mut bench = Bench::new(CLOCK);
    (bench.steps, bench.endpoints) = (Collection::default(), Collection::default());
    bench.put(key(0), &scene, vec![(said(MC_NOISE, 1, 2), truth.clone())], CLOCK);
    assert!(bench.refusal().contains("no image of `hold`"));
}
