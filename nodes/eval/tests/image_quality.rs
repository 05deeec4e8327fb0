//! The kind `image_quality` over made-up renders and samples, of which is known what is nearer to what.

use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{
    Action, Collection, Context, Handle, ItemKey, Kind, KindError, Media, MemoryBlobs, Outputs, Silent,
};
use tauflow_data::{
    Image,
    methods::MethodName,
    records::{
        BackboneQuality, Better, ClaimVerdict, Estimate, Family, Generated, GeneratedVariant, ImageQuality,
        PackedScene, SampleRow, SampleScores, ScoreColumn, Variant,
    },
    rng::Stream,
};
use tauflow_eval::{ImageQualityKind, ImageQualityParams};

const SAMPLES: u64 = 24;
const STEPS: u64 = 4;

/// A disk over a slope, in display values: what a render is here.
fn picture(seed: u64, side: usize) -> Image {
    let mut stream = Stream::new(seed, &[]);
    let [x, y] = [0.25, 0.75].map(|low| stream.range(0.25, low + 0.25) * side as f64);
    let (radius, disk) = (stream.range(0.15, 0.3) * side as f64, [0, 1, 2].map(|_| stream.range(0.5, 0.95)));
    let (low, slope) = (stream.range(0.1, 0.4), stream.range(0.1, 0.4));
    let mut image = Image::new(side, side, 3);
    for (column, row) in (0..side).flat_map(|row| (0..side).map(move |column| (column, row))) {
        let inside = (column as f64 - x).powi(2) + (row as f64 - y).powi(2) < radius * radius;
        for (c, value) in image.pixel_mut(column, row).iter_mut().enumerate() {
            let under = low + slope * row as f64 / side as f64;
            *value = (if inside { disk[c] } else { under } + 0.02 * stream.normal()).clamp(0.0, 1.0) as f32;
        }
    }
    image
}

/// A scene whose last rung shows a picture.
fn scene(shown: &Image) -> PackedScene {
    // The inverse of the display transform x/(1+x), ^(1/2.2).
    let radiance = |v: f32| {
        let mapped = f64::from(v.min(0.995)).powf(2.2);
        (mapped / (1.0 - mapped)) as f32
    };
    PackedScene { counts: vec![64], states: vec![shown.map(radiance)], gbuffer: None, sampler: Default::default() }
}

fn noisy(image: &Image, seed: u64, strength: f64) -> Image {
    let mut stream = Stream::new(seed, &[]);
    let mut out = image.clone();
    for value in out.data_mut() {
        *value = (f64::from(*value) + strength * stream.normal()).clamp(0.0, 1.0) as f32;
    }
    out
}

/// How noisy each variant is.
type Noise = fn(Variant) -> f64;

/// The adapted samples are the least noisy ones, the two trained controls are as noisy as frozen ones.
fn helped(variant: Variant) -> f64 {
    match variant {
        Variant::Adapted => 0.03,
        Variant::ShuffledResiduals | Variant::GaussianResiduals => 0.125,
        _ => 0.12,
    }
}

/// A control is as good as the adapted variant.
fn by_chance(variant: Variant) -> f64 {
    if variant == Variant::GaussianResiduals { 0.02 } else { helped(variant) }
}

struct Bench {
    blobs: MemoryBlobs,
    stop: AtomicBool,
    inputs: BTreeMap<&'static str, Collection>,
}

impl Bench {
    fn new() -> Self {
        Self { blobs: MemoryBlobs::default(), stop: AtomicBool::new(false), inputs: BTreeMap::new() }
    }

    fn with(noise: Noise, variants: &[Variant]) -> Self {
        let mut bench = Self::new();
        bench.scenes("references", 100, 30, 32);
        bench.scenes("training", 1000, 40, 32);
        bench.samples("rf_own", 32, noise, variants);
        bench
    }

    fn put<M: Media>(&mut self, port: &'static str, key: &str, value: &M) {
        let ctx = Context::new(&self.blobs, &Silent, &self.stop);
        let artifact = value.store(&ctx).expect("in memory").into_artifact();
        let old = self.inputs.remove(port).unwrap_or_default();
        let all = old.iter().map(|(key, artifact)| (key.clone(), artifact.clone()));
        let all = all.chain([(ItemKey::new(key).expect("a key"), artifact)]).collect();
        self.inputs.insert(port, all);
    }

    fn scenes(&mut self, port: &'static str, seed: u64, number: u64, side: usize) {
        for at in 0..number {
            self.put(port, &format!("L0-open-{at:06}"), &scene(&picture(seed + at, side)));
        }
    }

    fn samples(&mut self, backbone: &str, side: usize, noise: Noise, variants: &[Variant]) {
        self.samples_at("generated", SAMPLES, backbone, side, noise, variants);
    }

    fn samples_at(
        &mut self,
        port: &'static str,
        number: u64,
        backbone: &str,
        side: usize,
        noise: Noise,
        variants: &[Variant],
    ) {
        // Other frozen samples may have other steps.
        let steps = if port == "frozen" { 2 * STEPS } else { STEPS };
        for sample in 0..number {
            let clean = picture(5000 + sample, side);
            let variant = |variant: &Variant| GeneratedVariant {
                variant: *variant,
                // One noise for all variants of a sample.
                image: noisy(&clean, sample, noise(*variant)),
                energy: [vec![0.0; steps as usize - 2], vec![0.5 * sample as f64, noise(*variant)]].concat(),
                frames: Vec::new(),
            };
            let generated = Generated {
                backbone: MethodName::new(backbone).expect("a name"),
                family: Family::RectifiedFlow,
                sample,
                steps,
                variants: variants.iter().map(variant).collect(),
            };
            self.put(port, &format!("{backbone}-{sample:04}"), &generated);
        }
    }

    fn scores(&mut self, key: &str, metric: &str, rows: impl Iterator<Item = (u64, Variant, f64)>) {
        let row = |(sample, variant, value): (u64, Variant, f64)| SampleRow {
            backbone: "rf_own".into(),
            sample,
            variant,
            scores: BTreeMap::from([(metric.to_owned(), value)]),
        };
        let columns = vec![ScoreColumn { name: metric.into(), better: Better::Higher }];
        let scores = SampleScores { columns, rows: rows.map(row).collect(), notes: vec!["musiq: no file".into()] };
        self.put("scores", key, &scores);
    }

    fn outputs(&self, judged_by: &str) -> Result<Outputs, KindError> {
        let ctx = Context::new(&self.blobs, &Silent, &self.stop);
        let params = ImageQualityParams { judged_by: judged_by.into(), resamples: 200 };
        let all = self.inputs.iter().map(|(port, items)| (*port, items)).collect();
        let action = Action { params, item: None, group: "main", seed: 5, each: BTreeMap::new(), all };
        ImageQualityKind::run(&ctx, &action)
    }

    fn quality(&self, judged_by: &str) -> ImageQuality {
        let outputs = self.outputs(judged_by).expect("sound inputs");
        let ctx = Context::new(&self.blobs, &Silent, &self.stop);
        let artifact = outputs.collections["quality"].iter().next().expect("one").1.clone();
        Handle::<ImageQuality>::new(&artifact).expect("its own type").load(&ctx).expect("whole")
    }

    fn refused(&self, judged_by: &str) -> String {
        self.outputs(judged_by).map(drop).expect_err("unsound").to_string()
    }
}

fn mean(of: &BackboneQuality, variant: Variant, score: &str) -> f64 {
    of.variants.iter().find(|its| its.variant == variant).expect("there").scores[score].mean
}

#[test]
fn less_noise_is_a_gain_over_every_control() {
    let quality = Bench::with(helped, &Variant::ALL).quality("mmd");
    assert_eq!((quality.references, quality.training, quality.backbones.len()), (30, Some(40), 1));
    let names: Vec<&str> = quality.columns.iter().map(|column| column.name.as_str()).collect();
    assert_eq!(names, ["mmd", "swd", "niqe"]);
    let own = &quality.backbones[0];
    assert_eq!((own.samples, own.size, own.variants.len(), own.gains.len()), (SAMPLES, [32, 32], 6, 5));
    for score in names {
        let of = |variant| mean(own, variant, score);
        assert!(of(Variant::Adapted) < of(Variant::Frozen), "{score}");
        // Controls that change nothing have the frozen figures, to the bit.
        for same in [Variant::EtaZero, Variant::UntrainedAdapter] {
            assert_eq!(of(same), of(Variant::Frozen), "{score}");
        }
        // A gain is what the adapted variant is lower by, and its interval holds it.
        let gain = own.gains[0].scores[score];
        assert!((gain.mean - (of(Variant::Frozen) - of(Variant::Adapted))).abs() < 1e-12);
        assert!(gain.low <= gain.mean && gain.mean <= gain.high && gain.low > 0.0, "{score} {gain:?}");
    }
    let changes: Vec<f64> = own.variants.iter().map(|its| its.change).collect();
    assert!(changes[0] == 0.0 && changes[2] == 0.0 && changes[3] == 0.0 && changes[1] > 0.1, "{changes:?}");
    // Energies are means over the samples 0 to 23.
    let energy = &own.variants[1].energy;
    assert!((energy[2] - 5.75).abs() < 1e-12 && (energy[3] - 0.03).abs() < 1e-12, "{energy:?}");
    let claim = own.claim.as_ref().expect("an adapted variant");
    assert_eq!((claim.verdict, claim.evidence.len()), (ClaimVerdict::Held, 5), "{claim:?}");
    assert_eq!(claim.evidence[1].what, "over eta = 0");
    let gaussian = own.gaussian.as_ref().expect("a training set");
    assert_eq!(gaussian.images, 1000);
    assert!((gaussian.nearer.mean - (gaussian.gaussian.mean - gaussian.frozen.mean)).abs() < 1e-12);
    assert!(quality.notes.iter().any(|note| note.contains("pools the patches")), "{:?}", quality.notes);
}

#[test]
fn samples_that_are_nearly_renders_are_nearer_to_them_than_gaussian_images() {
    let nearer = |noise: Noise| {
        let quality = Bench::with(noise, &[Variant::Frozen]).quality("mmd");
        quality.backbones[0].gaussian.as_ref().expect("a training set").nearer.mean
    };
    assert!(nearer(|_| 0.005) > 0.0 && nearer(|_| 0.12) < 0.0);
}

#[test]
fn more_frozen_samples_make_the_comparison_with_gaussian_images_more_certain() {
    let mut bench = Bench::with(|_| 0.005, &Variant::ALL);
    let few = bench.quality("mmd").backbones[0].clone();
    bench.samples_at("frozen", 200, "rf_own", 32, |_| 0.005, &[Variant::Frozen]);
    let many = bench.quality("mmd").backbones[0].clone();
    // Nothing else changes but what the draws of the bootstrap are.
    assert_eq!((few.samples, few.variants.len()), (many.samples, many.variants.len()));
    for (few, many) in few.variants.iter().zip(&many.variants) {
        assert_eq!(few.scores["mmd"].mean, many.scores["mmd"].mean);
    }
    let [few, many] = [few, many].map(|of| of.gaussian.expect("a training set"));
    assert_eq!((few.samples, many.samples, many.images), (SAMPLES, 200, 1000));
    assert_eq!((few.steps, many.steps), (STEPS, 2 * STEPS));
    let width = |of: &Estimate| of.high - of.low;
    assert!(width(&many.nearer) < 0.8 * width(&few.nearer), "{many:?} {few:?}");
    // Those samples are nearly renders, and of as many there is no doubt.
    assert!(many.nearer.low > 0.0, "{many:?}");
    bench.samples_at("frozen", 2, "rf_other", 32, |_| 0.005, &[Variant::Frozen]);
    let told = bench.refused("mmd");
    assert!(told.contains("backbone `rf_other`, which `generated` does not have"), "{told}");
    bench.inputs.remove("training");
    assert!(bench.refused("mmd").contains("connect `training`"));
}

#[test]
fn a_gain_that_a_control_has_too_is_not_physical() {
    let own = &Bench::with(by_chance, &Variant::ALL).quality("mmd").backbones[0];
    let claim = own.claim.as_ref().expect("an adapted variant");
    assert!(own.gains[0].scores["mmd"].low > 0.0);
    assert_ne!(claim.verdict, ClaimVerdict::Held, "{claim:?}");
    // Without all controls nothing can hold.
    let few = [Variant::Frozen, Variant::Adapted, Variant::EtaZero];
    let own = &Bench::with(helped, &few).quality("mmd").backbones[0];
    let claim = own.claim.as_ref().expect("an adapted variant");
    assert!(claim.evidence.iter().all(|e| e.difference.low > 0.0));
    assert_eq!(claim.verdict, ClaimVerdict::Undecided);
    // Frozen samples alone are scored, and nothing is claimed.
    let own = &Bench::with(helped, &[Variant::Frozen]).quality("mmd").backbones[0];
    assert!(own.claim.is_none() && own.gains.is_empty() && own.variants.len() == 1);
}

#[test]
fn scores_of_single_images_are_paired_by_sample() {
    let mut bench = Bench::with(helped, &Variant::ALL);
    let rows = || (0..SAMPLES).flat_map(|sample| Variant::ALL.map(|variant| (sample, variant)));
    // Each sample has a level of its own, far wider than the gain: only paired intervals see it.
    let value = |(sample, variant): (u64, Variant)| {
        let gain = if variant == Variant::Adapted { 0.02 } else { 0.0 };
        (sample, variant, 0.1 * sample as f64 + gain + 0.001 * (sample % 3) as f64 * gain)
    };
    bench.scores("a", "clipiqa", rows().map(value));
    let quality = bench.quality("clipiqa");
    let own = &quality.backbones[0];
    let gain = own.gains[0].scores["clipiqa"];
    assert!((gain.mean - 0.02).abs() < 1e-4 && gain.high - gain.low < 1e-4, "{gain:?}");
    assert!(own.variants[0].scores["clipiqa"].high - own.variants[0].scores["clipiqa"].low > 0.3);
    assert_eq!(own.claim.as_ref().expect("there").verdict, ClaimVerdict::Held);
    assert_eq!(quality.per_sample.len(), 6 * SAMPLES as usize);
    assert_eq!(quality.columns.last().map(|c| (c.name.as_str(), c.better)), Some(("clipiqa", Better::Higher)));
    assert!(quality.notes.contains(&"musiq: no file".to_owned()));
    bench.scores("b", "clipiqa", rows().map(value));
    assert!(bench.refused("mmd").contains("`clipiqa`, which is there already"));
    let mut bench = Bench::with(helped, &Variant::ALL);
    bench.scores("a", "clipiqa", rows().skip(1).map(value));
    let told = bench.refused("mmd");
    assert!(told.contains("no `clipiqa` of sample 0 of `rf_own`, variant `frozen`"), "{told}");
}

#[test]
fn sizes_may_differ_by_a_whole_factor_and_large_images_have_a_niqe_each() {
    let mut bench = Bench::new();
    bench.scenes("references", 100, 3, 384);
    bench.samples("ddpm_own", 192, helped, &[Variant::Frozen, Variant::Adapted]);
    let quality = bench.quality("niqe");
    let own = &quality.backbones[0];
    assert_eq!((own.size, quality.training, own.gaussian.is_none()), ([192, 192], None, true));
    assert!(quality.notes.iter().any(|note| note.contains("no training set")), "{:?}", quality.notes);
    let niqe = |row: &&SampleRow| row.variant == Variant::Frozen && row.scores.contains_key("niqe");
    let each: Vec<f64> = quality.per_sample.iter().filter(niqe).map(|row| row.scores["niqe"]).collect();
    assert_eq!(each.len(), SAMPLES as usize);
    assert!((each.iter().sum::<f64>() / SAMPLES as f64 - mean(own, Variant::Frozen, "niqe")).abs() < 1e-9);
    bench.samples("rf_odd", 100, helped, &[Variant::Frozen]);
    let told = bench.refused("mmd");
    assert!(told.contains("`rf_odd` have 100 x 100") && told.contains("384 x 384"), "{told}");
}

#[test]
fn what_cannot_be_scored_is_refused_with_a_remedy() {
    let mut bench = Bench::new();
    bench.scenes("references", 100, 1, 32);
    bench.samples("rf_own", 32, helped, &[Variant::Frozen, Variant::Adapted]);
    assert!(bench.refused("mmd").contains("`references` has 1 scenes; connect at least 2"));
    bench.scenes("references", 200, 3, 32);
    let told = bench.refused("musiq");
    assert!(told.contains("`judged_by: musiq`") && told.contains("mmd, swd, niqe"), "{told}");
    bench.scenes("training", 300, 1, 32);
    assert!(bench.refused("mmd").contains("`training` has 1 scenes"));
    // Flat samples have no NIQE, and no other score is touched by that.
    let mut bench = Bench::with(helped, &[Variant::Frozen]);
    let frozen = GeneratedVariant {
        variant: Variant::Frozen,
        image: Image::new(32, 32, 3),
        energy: vec![0.0; STEPS as usize],
        frames: Vec::new(),
    };
    let backbone = MethodName::new("rf_own").expect("a name");
    let family = Family::RectifiedFlow;
    let black = Generated { backbone, family, sample: 99, steps: STEPS, variants: vec![frozen] };
    bench.put("generated", "black", &black);
    let quality = bench.quality("mmd");
    assert!(!quality.columns.iter().any(|column| column.name == "niqe"));
    assert!(quality.notes.iter().any(|note| note.contains("4 of the 4 patches of sample 99")), "{:?}", quality.notes);
    bench.put("generated", "twice", &Generated { steps: STEPS, ..black.clone() });
    let told = bench.refused("mmd");
    assert!(told.contains("`twice` is sample 99 of backbone `rf_own`"), "{told}");
    bench.put("generated", "twice", &Generated { sample: 100, family: Family::Ddpm, ..black });
    assert!(bench.refused("mmd").contains("another family"));
}

#[test]
fn the_figures_are_the_same_for_any_number_of_threads() {
    let mut bench = Bench::new();
    bench.scenes("references", 100, 5, 16);
    bench.scenes("training", 200, 6, 16);
    bench.samples("rf_own", 16, helped, &Variant::ALL);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| bench.quality("mmd"))
    };
    let (one, three) = (with(1), with(3));
    assert_eq!(one, three);
    // Who changes these bits raises the version of the group.
    let ctx = Context::new(&bench.blobs, &Silent, &bench.stop);
    assert_eq!(one.store(&ctx).expect("in memory").artifact().digest().to_string(), PINNED);
}

const PINNED: &str = "b69cef3306c0fb17431cece940c003fbd2162f6df869049d1243d7592a4027b1-163";
