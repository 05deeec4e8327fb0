//! The kinds, one after the other, on made-up scenes of a few pixels: trainings that go on where they were stopped,
//! adapters and their controls, samples in pairs, and a checkpoint that comes back from a folder.

use serde_json::json;
use std::{
    collections::BTreeMap,
    fs,
    sync::atomic::{AtomicBool, Ordering},
};
use tauflow_contract::{
    Action, Artifact, Collection, Context, Files, ItemKey, Kind, KindError, Media, MemoryBlobs, Outputs, Progress,
};
use tauflow_data::{
    Image,
    records::{BackboneFiles, Family, Generated, PackedScene, TrainingLog, Variant},
    rng::Stream,
};
use tauflow_generative::{
    Adapter, Generation, GenerationParams, GenerativeTraining, GenerativeTrainingParams, PretrainedBackbones,
    PretrainedBackbonesParams, Residuals, TransportAdapter, TransportAdapterParams,
};
use tauflow_tensors::Decay;

const SIDE: usize = 16;

/// Stops a run after so many reports of progress.
struct Stopping<'a> {
    flag: &'a AtomicBool,
    after: u64,
}

impl Progress for Stopping<'_> {
    fn report(&self, done: u64, _total: u64, _message: &str) {
        if done >= self.after {
            self.flag.store(true, Ordering::Relaxed);
        }
    }
}

fn key(text: &str) -> ItemKey {
    ItemKey::new(text).expect("plain")
}

fn with<T>(blobs: &MemoryBlobs, run: impl FnOnce(&Context<'_>) -> T) -> T {
    let flag = AtomicBool::new(false);
    run(&Context::new(blobs, &tauflow_contract::Silent, &flag))
}

/// Ramps in colour with noise that falls from rung to rung.
fn scenes(blobs: &MemoryBlobs) -> Collection {
    let scene = |index: u64| {
        let counts = vec![1, 4, 16];
        let states = counts.iter().enumerate().map(|(rung, count)| {
            let mut stream = Stream::new(index, &[rung as u64]);
            let value = |i: usize| {
                let ramp = 0.2 + (i / 3 % SIDE) as f64 / SIDE as f64 + 0.3 * (i % 3) as f64 * (index % 2) as f64;
                (ramp + stream.range(-0.5, 0.5) / (*count as f64).sqrt()).max(0.0) as f32
            };
            Image::from_data(SIDE, SIDE, 3, (0..SIDE * SIDE * 3).map(value).collect()).expect("fits")
        });
        PackedScene { states: states.collect(), counts: counts.clone(), gbuffer: None, sampler: Default::default() }
    };
    let item = |index| {
        let stored = with(blobs, |ctx| scene(index).store(ctx).expect("in memory"));
        (key(&format!("scene-{index}")), stored.into_artifact())
    };
    (0..4).map(item).collect()
}

/// With a rate that stays: trainings of more steps share checkpoints with those of fewer.
fn training(family: Family, steps: u64) -> GenerativeTrainingParams {
    GenerativeTrainingParams {
        family,
        width: 16,
        steps,
        batch: 4,
        warmup: 2,
        decay: Decay::None,
        log_every: 2,
        checkpoint_every: 2,
        ..GenerativeTrainingParams::default()
    }
}

fn gather<K: Kind>(
    ctx: &Context<'_>,
    params: K::Params,
    all: &[(&'static str, &Collection)],
) -> Result<Outputs, KindError> {
    let all = all.iter().copied().collect();
    K::run(ctx, &Action { params, item: None, group: "main", seed: 11, each: BTreeMap::new(), all })
}

fn trained(blobs: &MemoryBlobs, scenes: &Collection, family: Family) -> (Artifact, TrainingLog) {
    with(blobs, |ctx| {
        let made = gather::<GenerativeTraining>(ctx, training(family, 4), &[("train", scenes)]).expect("learns");
        let backbone = made.collections["backbone"].get(family.name()).expect("named like the family").clone();
        let log = made.collections["log"].get(family.name()).expect("named like the family");
        (backbone, TrainingLog::load(ctx, log).expect("whole"))
    })
}

fn adapter(
    ctx: &Context<'_>,
    backbone: &Artifact,
    scenes: &Collection,
    residuals: Residuals,
) -> Result<Artifact, KindError> {
    let params = TransportAdapterParams {
        residuals,
        steps: 6,
        batch: 3,
        crop: 8,
        warmup: 1,
        checkpoint_every: 2,
        ema: 0.5,
        ..TransportAdapterParams::default()
    };
    let (item, each) = (key("some"), BTreeMap::from([("backbone", backbone)]));
    let all = BTreeMap::from([("train", scenes)]);
    let action = Action { params, item: Some(&item), group: "main", seed: 5, each, all };
    Ok(TransportAdapter::run(ctx, &action)?.items["adapter"].clone())
}

/// Digests of what the kinds make of the made-up scenes. Whoever changes these bits raises the version of the kind.
const PINNED: &str = "\
ddpm cbf6fb8c643047f0e6ec38220bef0083b685f488900f54cefe9b0c32cb1820e5-399
ddpm rendered 3b2af6f8d02c79a8c7f6b68f454c0640a37dfa8bdf2ab066d9fd3ad408c21c68-159
ddpm shuffled 6b6b1623ceac08a9dcceb1c652906bcea16dadf1e2d8901a6237dd37a9bd204a-159
ddpm gaussian af8be0c86850d7e07485a24d71cdff368757e77329467805db496f8f55bc5cbd-159
rectified_flow 4bf976bd714b9027c708256dd680a8c114971d30787545fbf00568d010788184-292
rectified_flow rendered e195d520d8300de7951c70377a61044711ff9a03cea84fb336062940038c69fa-159
rectified_flow shuffled 4dfdab49fb3ae78d96705821f49acbc322ef5bdd4ac379b03e2a23eed3f7d819-159
rectified_flow gaussian 0030e89fbf9977115dcf6f27c2d2527a440a0e50758ed3c434127a330ab924b7-159
ddpm-0000 b383d98b462d837c1ac230180cf2c3f094e6782b0a8ac9e8ed9d5cc0cfde3b02-2731
ddpm-0001 c728ea8749a67043393663dea888e9e1437c18e82a0108f3bfe3bb1cdbb8cae6-2731
rectified_flow-0000 f3273b2c31c7aaecacfd49665ab460dad1239976d3d8d829b6803cdbbb0f0b25-2731
rectified_flow-0001 bef848eb160c1e1057f6aa9f93bd015003847cf142d3b584873678905c9097eb-2731
";

#[test]
fn outputs_change_with_versions_alone() {
    let blobs = MemoryBlobs::default();
    let scenes = scenes(&blobs);
    let backbones = [Family::Ddpm, Family::RectifiedFlow].map(|f| (f.name(), trained(&blobs, &scenes, f).0));
    let mut found = String::new();
    let mut adapters = Vec::new();
    for (name, backbone) in &backbones {
        found += &format!("{name} {}\n", backbone.digest());
        for residuals in [Residuals::Rendered, Residuals::Shuffled, Residuals::Gaussian] {
            let made = with(&blobs, |ctx| adapter(ctx, backbone, &scenes, residuals)).expect("learns");
            found += &format!("{name} {} {}\n", residuals.name(), made.digest());
            adapters.push(made);
        }
    }
    for (key, artifact) in samples(&blobs, &backbones, &adapters).iter() {
        found += &format!("{key} {}\n", artifact.digest());
    }
    assert!(found == PINNED, "outputs differ from what is pinned here:\n{found}");
}

/// A network whose outputs a small training can hardly move would pass every other test here.
#[test]
fn both_families_learn() {
    let blobs = MemoryBlobs::default();
    let scenes = scenes(&blobs);
    for family in [Family::Ddpm, Family::RectifiedFlow] {
        let params = GenerativeTrainingParams { log_every: 25, checkpoint_every: 200, ..training(family, 150) };
        let made =
            with(&blobs, |ctx| gather::<GenerativeTraining>(ctx, params, &[("train", &scenes)])).expect("learns");
        let log = made.collections["log"].get(family.name()).expect("named like the family");
        let log = with(&blobs, |ctx| TrainingLog::load(ctx, log)).expect("whole");
        let losses: Vec<f64> = log.points.iter().filter_map(|point| point.train).collect();
        println!("{family:?}: {losses:.3?}");
        assert!(losses.last() < losses.first().map(|first| 0.7 * first).as_ref(), "{family:?}: {losses:?}");
    }
}

#[test]
fn trainings_go_on_where_they_were_stopped_to_the_same_bits() {
    for family in [Family::Ddpm, Family::RectifiedFlow] {
        let (whole, parts) = (MemoryBlobs::default(), MemoryBlobs::default());
        let (expected, log) = trained(&whole, &scenes(&whole), family);
        assert_eq!(log.points.iter().map(|point| point.step).collect::<Vec<_>>(), [0, 2, 4]);
        assert!(log.points[2].train.expect("a mean").is_finite());
        let flag = AtomicBool::new(false);
        // Progress is told at the last step alone here: stop by a shorter training instead.
        with(&parts, |ctx| gather::<GenerativeTraining>(ctx, training(family, 2), &[("train", &scenes(&parts))]))
            .expect("learns");
        let stopping = Stopping { flag: &flag, after: 0 };
        let ctx = Context::new(&parts, &stopping, &flag);
        let made = gather::<GenerativeTraining>(&ctx, training(family, 4), &[("train", &scenes(&parts))]).expect("on");
        assert_eq!(made.collections["backbone"].get(family.name()), Some(&expected), "{family:?}");
        // A stopped run says so, and keeps what it has.
        let stopped = gather::<GenerativeTraining>(&ctx, training(family, 9), &[("train", &scenes(&parts))]);
        assert!(matches!(stopped, Err(KindError::Cancelled)));
    }
}

#[test]
fn a_training_is_the_same_after_shorter_and_longer_ones() {
    let training = |steps| GenerativeTrainingParams { log_every: 3, ..training(Family::RectifiedFlow, steps) };
    let made = |blobs: &MemoryBlobs, steps| {
        let scenes = scenes(blobs);
        let made =
            with(blobs, |ctx| gather::<GenerativeTraining>(ctx, training(steps), &[("train", &scenes)])).expect("on");
        let log = made.collections["log"].get("rectified_flow").expect("named like the family").clone();
        let log: TrainingLog = with(blobs, |ctx| TrainingLog::load(ctx, &log)).expect("whole");
        let points: Vec<(u64, Option<f64>)> = log.points.iter().map(|point| (point.step, point.train)).collect();
        (made.collections["backbone"].clone(), points)
    };
    let fresh: Vec<_> = [4, 6, 8].map(|steps| made(&MemoryBlobs::default(), steps)).into_iter().collect();
    assert_eq!(fresh[2].1.iter().map(|point| point.0).collect::<Vec<_>>(), [0, 3, 6, 8]);
    for order in [[0, 1, 2], [2, 1, 0]] {
        let blobs = MemoryBlobs::default();
        for place in order {
            assert_eq!(made(&blobs, 4 + 2 * place as u64), fresh[place], "{order:?}");
        }
    }
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let blobs = MemoryBlobs::default();
            let scenes = scenes(&blobs);
            let (backbone, _) = trained(&blobs, &scenes, Family::Ddpm);
            let adapter = with(&blobs, |ctx| adapter(ctx, &backbone, &scenes, Residuals::Rendered)).expect("learns");
            let samples = samples(&blobs, &[("ddpm", backbone)], &[adapter]);
            samples.iter().map(|(key, artifact)| (key.clone(), artifact.digest())).collect::<Vec<_>>()
        })
    };
    assert_eq!(run(1), run(3));
}

fn samples(blobs: &MemoryBlobs, backbones: &[(&str, Artifact)], adapters: &[Artifact]) -> Collection {
    let backbones: Collection = backbones.iter().map(|(name, artifact)| (key(name), artifact.clone())).collect();
    let adapters: Collection =
        adapters.iter().enumerate().map(|(i, artifact)| (key(&format!("cell={i}/x")), artifact.clone())).collect();
    let params = GenerationParams {
        samples: 2,
        eta: 1.0,
        ddpm_steps: 6,
        rectified_flow_steps: 4,
        frames: 3,
        ..GenerationParams::default()
    };
    with(blobs, |ctx| {
        let made = gather::<Generation>(ctx, params, &[("backbones", &backbones), ("adapters", &adapters)]);
        made.expect("samples").collections["samples"].clone()
    })
}

#[test]
fn samples_are_made_in_pairs_with_every_control() {
    let blobs = MemoryBlobs::default();
    let scenes = scenes(&blobs);
    let backbones = [Family::Ddpm, Family::RectifiedFlow].map(|f| (f.name(), trained(&blobs, &scenes, f).0));
    let mut adapters = Vec::new();
    for (_, backbone) in &backbones {
        for residuals in [Residuals::Rendered, Residuals::Shuffled, Residuals::Gaussian] {
            adapters.push(with(&blobs, |ctx| adapter(ctx, backbone, &scenes, residuals)).expect("learns"));
        }
    }
    let infos: Vec<_> = adapters
        .iter()
        .map(|artifact| with(&blobs, |ctx| Adapter::load(&ctx.part(artifact, "").expect("there")).expect("sound")))
        .collect();
    assert!(infos.iter().all(|adapter| adapter.info().counts == [1, 4, 16] && adapter.info().steps == 6));
    let made = samples(&blobs, &backbones, &adapters);
    let names: Vec<String> = made.iter().map(|(key, _)| key.to_string()).collect();
    assert_eq!(names, ["ddpm-0000", "ddpm-0001", "rectified_flow-0000", "rectified_flow-0001"]);
    for (_, artifact) in made.iter() {
        let sample = with(&blobs, |ctx| Generated::load(ctx, artifact)).expect("whole");
        assert_eq!(sample.variants.iter().map(|v| v.variant).collect::<Vec<_>>(), Variant::ALL);
        let image = |variant| &sample.variant(variant).expect("all are there").image;
        let apart = |variant| {
            let pairs = image(variant).data().iter().zip(image(Variant::Frozen).data());
            pairs.fold(0.0f32, |most, (a, b)| most.max((a - b).abs()))
        };
        assert!(apart(Variant::EtaZero) < 1e-5 && apart(Variant::UntrainedAdapter) < 1e-5);
        for variant in [Variant::Adapted, Variant::ShuffledResiduals, Variant::GaussianResiduals] {
            assert!(apart(variant) > 0.0, "{variant} of {:?}", sample.family);
        }
        assert_eq!(sample.variants[1].frames.len(), 3);
    }
    // Samples that were kept are the same artifacts.
    assert!(samples(&blobs, &backbones, &adapters) == made);
    // Without adapters, what needs none is left.
    let plain = samples(&blobs, &backbones[..1], &[]);
    let artifact = plain.get("ddpm-0000").expect("two are made").clone();
    let alone = with(&blobs, |ctx| Generated::load(ctx, &artifact)).expect("whole");
    let variants: Vec<Variant> = alone.variants.iter().map(|its| its.variant).collect();
    assert_eq!(variants, [Variant::Frozen, Variant::UntrainedAdapter]);
}

#[test]
fn a_checkpoint_comes_back_from_a_folder_and_its_content_is_its_key() {
    let blobs = MemoryBlobs::default();
    let (expected, _) = trained(&blobs, &scenes(&blobs), Family::Ddpm);
    let files = with(&blobs, |ctx| BackboneFiles::load(ctx, &expected)).expect("whole");
    let folder = std::env::temp_dir().join("tauflow-generative-checkpoint").join("own_ddpm");
    _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("writable");
    let read = |name: &str| {
        PretrainedBackbones::items(&PretrainedBackbonesParams {
            folders: vec![folder.join(name).display().to_string()],
            allow_none: true,
        })
    };
    let told = read("").expect_err("nothing there").to_string();
    assert!(told.contains("has no `config.json`"), "{told}");
    fs::write(folder.join("config.json"), &files.config).expect("writable");
    let told = read("").expect_err("no weights").to_string();
    assert!(told.contains("has no weights"), "{told}");
    assert!(read("missing").expect_err("not there").to_string().contains("cannot list"));
    fs::write(folder.join("scheduler_config.json"), files.scheduler.as_ref().expect("of a DDPM")).expect("writable");
    fs::write(folder.join("model.safetensors"), &files.weights).expect("writable");
    let item = read("").expect("whole").remove(0);
    assert_eq!(item.key.as_str(), "own_ddpm");
    let run = |change: &dyn Fn(&str, Vec<u8>) -> Vec<u8>| {
        let files = item.files.iter().map(|(part, path)| {
            let bytes = fs::read(path).expect("readable");
            (part.clone(), change(part, bytes))
        });
        let files = Files(files.collect());
        with(&blobs, |ctx| {
            let stored = files.store(ctx).expect("in memory");
            let each = BTreeMap::from([("file", stored.artifact())]);
            let params = serde_json::from_value(json!({})).expect("the projection");
            let action = Action { params, item: Some(&item.key), group: "main", seed: 0, each, all: BTreeMap::new() };
            Ok::<_, KindError>(PretrainedBackbones::run(ctx, &action)?.items["backbone"].clone())
        })
    };
    assert_eq!(run(&|_, bytes| bytes).expect("sound"), expected);
    let cut = |part: &str, mut bytes: Vec<u8>| {
        bytes.truncate(if part.starts_with("weights") { bytes.len() - 8 } else { bytes.len() });
        bytes
    };
    let told = run(&cut).expect_err("cut short").to_string();
    assert!(told.contains("`model.safetensors` cannot be used") && told.contains("copy it again"), "{told}");
    let odd = |part: &str, bytes: Vec<u8>| {
        let text = String::from_utf8_lossy(&bytes).replace("\"silu\"", "\"gelu\"").replace("\"linear\"", "\"cosine\"");
        if part.starts_with("weights") { bytes } else { text.into_bytes() }
    };
    let told = run(&odd).expect_err("unsupported").to_string();
    assert!(told.contains("`act_fn` is `gelu`") && told.contains("scheduler: `beta_schedule` is `cosine`"), "{told}");
    fs::remove_dir_all(folder.parent().expect("it has one")).expect("our own");
}

#[test]
fn what_does_not_fit_is_said() {
    let blobs = MemoryBlobs::default();
    let scenes = scenes(&blobs);
    let (backbone, _) = trained(&blobs, &scenes, Family::RectifiedFlow);
    let none = Collection::default();
    with(&blobs, |ctx| {
        let told = |made: Result<Outputs, KindError>| made.expect_err("refused").to_string();
        let params = || training(Family::Ddpm, 2);
        assert!(
            told(gather::<GenerativeTraining>(ctx, params(), &[("train", &none)])).contains("no scenes on `train`")
        );
        let wide = PackedScene {
            counts: vec![1, 2],
            states: vec![Image::new(16, 8, 3), Image::new(16, 8, 3)],
            gbuffer: None,
            sampler: Default::default(),
        };
        let wide = [(key("wide"), wide.store(ctx).expect("in memory").into_artifact())].into_iter().collect();
        assert!(told(gather::<GenerativeTraining>(ctx, params(), &[("train", &wide)])).contains("render squares"));
        let adapters = adapter(ctx, &backbone, &scenes, Residuals::Rendered).expect("learns");
        let backbones: Collection = [(key("x"), backbone.clone())].into_iter().collect();
        let twice: Collection = [(key("a"), adapters.clone()), (key("b"), adapters)].into_iter().collect();
        let all = [("backbones", &backbones), ("adapters", &twice)];
        let params = || GenerationParams { samples: 1, ..GenerationParams::default() };
        assert!(told(gather::<Generation>(ctx, params(), &all)).contains("two adapters of residuals `rendered`"));
        let all = [("backbones", &none)];
        assert!(told(gather::<Generation>(ctx, params(), &all)).contains("no backbones"));
        // Asked for no backbone, it makes none.
        let empty = gather::<GenerativeTraining>(ctx, training(Family::Ddpm, 0), &[("train", &none)]).expect("nothing");
        assert!(empty.collections["backbone"].is_empty());
        assert_eq!(PretrainedBackbones::check(&PretrainedBackbonesParams::default()).len(), 1);
        let odd = GenerativeTrainingParams { width: 20, ..GenerativeTrainingParams::default() };
        assert_eq!(GenerativeTraining::check(&odd)[0].pointer, "/width");
    });
}
