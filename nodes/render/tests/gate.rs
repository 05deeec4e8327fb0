//! `quality_gate` and `convergence` as the engine calls them, on ladders that were really rendered.

mod scenes;

use scenes::{Built, balls_under_sky, film, recipe, room};
use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{
    Action, Artifact, Collection, Context, ItemKey, Kind, KindError, Media, MemoryBlobs, Outputs, Silent,
};
use tauflow_data::{
    Rungs,
    records::{Agreement, Convergence, Exposure, Ladder, SceneRecord, Verdict},
};
use tauflow_render::{
    convergence::{ConvergenceKind, ConvergenceParams},
    ladder_rendering::{LadderRendering, LadderRenderingParams},
    quality_gate::{QualityGate, QualityGateParams},
};

fn list(counts: Vec<u64>) -> Rungs {
    Rungs::list(counts).expect("increasing")
}

struct Bench {
    blobs: MemoryBlobs,
    cancel: AtomicBool,
}

fn bench() -> Bench {
    Bench { blobs: MemoryBlobs::default(), cancel: AtomicBool::new(false) }
}

impl Bench {
    fn ctx(&self) -> Context<'_> {
        Context::new(&self.blobs, &Silent, &self.cancel)
    }

    fn store(&self, built: &Built, exposure_ev: f64) -> Artifact {
        let ctx = self.ctx();
        for bytes in built.blobs.values() {
            ctx.put(bytes).expect("memory");
        }
        let record = SceneRecord { scene: built.scene.clone(), recipe: recipe(exposure_ev) };
        record.store(&ctx).expect("memory").into_artifact()
    }

    fn ladder(&self, scene: &Artifact, rungs: Rungs) -> Artifact {
        self.rendered(scene, rungs, 0)
    }

    fn rendered(&self, scene: &Artifact, rungs: Rungs, stream: u64) -> Artifact {
        let params =
            LadderRenderingParams { rungs, resolution: film(24, 24), stream, ..LadderRenderingParams::default() };
        let each = BTreeMap::from([("scenes", scene)]);
        let action = Action { params, item: None, group: "ladder", seed: 0, each, all: BTreeMap::new() };
        let mut outputs = LadderRendering::run(&self.ctx(), &action).expect("a sound scene");
        outputs.items.remove("ladder").expect("the port")
    }

    fn gate(&self, scene: &Artifact, preview: &Artifact, params: QualityGateParams) -> Outputs {
        let each = BTreeMap::from([("scenes", scene), ("previews", preview)]);
        let action = Action { params, item: None, group: "main", seed: 0, each, all: BTreeMap::new() };
        QualityGate::run(&self.ctx(), &action).expect("a sound preview")
    }

    fn load<M: Media>(&self, artifact: &Artifact) -> M {
        M::load(&self.ctx(), artifact).expect("an artifact of its type")
    }
}

#[test]
fn the_gate_passes_scenes_on_unchanged_and_no_threshold_changes_what_it_says_of_them() {
    let bench = bench();
    let scene = bench.store(&room(), 0.5);
    let preview = bench.ladder(&scene, list(vec![1, 32]));
    let usual = bench.gate(&scene, &preview, QualityGateParams::default());
    assert_eq!(usual.items["accepted"], scene);
    let exposure: Exposure = bench.load(&usual.items["exposure"]);
    assert!((exposure.factor * exposure.mean_luminance / (0.18 * 2f64.sqrt()) - 1.0).abs() < 1e-9, "{exposure:?}");
    let lax = QualityGateParams { contrast: 0.001, to_see: 0.01, ..QualityGateParams::default() };
    assert_eq!(bench.gate(&scene, &preview, lax).items, usual.items);
    let strict = QualityGateParams { contrast: 0.9, ..QualityGateParams::default() };
    let rejected = bench.gate(&scene, &preview, strict).items;
    assert_eq!(rejected.keys().collect::<Vec<_>>(), ["verdicts"]);
    let [before, after] =
        [&usual.items["verdicts"], &rejected["verdicts"]].map(|verdict| bench.load::<Verdict>(verdict));
    assert_eq!((before.reasons.len(), after.reasons.as_slice()), (0, &["near_constant".to_owned()][..]));
    assert_eq!(before.measures, after.measures);
    // Only the offset of exposure differs.
    let brighter = bench.store(&room(), 1.5);
    let twice: Exposure = bench.load(&bench.gate(&brighter, &preview, QualityGateParams::default()).items["exposure"]);
    assert!((twice.factor / exposure.factor - 2.0).abs() < 1e-12);
}

#[test]
fn rendered_ladders_keep_the_law() {
    let bench = bench();
    let (mut ladders, mut references, mut exposure) = (Vec::new(), Vec::new(), Vec::new());
    for (name, built) in [("L0-open-000000", balls_under_sky()), ("L0-enclosed-000000", room())] {
        let key = ItemKey::new(name).expect("plain");
        let scene = bench.store(&built, 0.0);
        let ladder = bench.ladder(&scene, Rungs::dyadic(128).expect("a power of two"));
        exposure
            .push((key.clone(), bench.gate(&scene, &ladder, QualityGateParams::default()).items["exposure"].clone()));
        references.push((key.clone(), bench.rendered(&scene, list(vec![2048]), 1)));
        ladders.push((key, ladder));
    }
    let run = |references: &Collection, ladders: &Collection, exposure: &Collection| {
        let all = BTreeMap::from([("references", references), ("ladders", ladders), ("exposure", exposure)]);
        let params = ConvergenceParams::default();
        let action = Action { params, item: None, group: "main", seed: 0, each: BTreeMap::new(), all };
        ConvergenceKind::run(&bench.ctx(), &action)
    };
    let all = |items: &[(ItemKey, Artifact)]| items.iter().cloned().collect::<Collection>();
    let outputs = run(&all(&references), &all(&ladders), &all(&exposure)).expect("sound ladders");
    let found: Convergence = bench.load(outputs.collections["convergence"].get("convergence").expect("one item"));
    assert_eq!((found.reference_spp, found.counts.as_slice()), (2048, &[1, 2, 4, 8, 16, 32, 64, 128][..]));
    assert_eq!(found.strata.iter().map(|s| s.stratum.as_str()).collect::<Vec<_>>(), ["L0-enclosed", "L0-open"]);
    assert_eq!((found.overall.scenes, found.overall.rejected, found.scenes.len()), (2, 0, 2));
    let [enclosed, open] = [&found.strata[0], &found.strata[1]];
    let slope = open.slope.expect("noise");
    assert!((slope.mean + 0.5).abs() < 0.05 && !open.heavy_tail, "{open:?}");
    assert_eq!((found.overall.noiseless, found.overall.unresolved), (0, 0), "{:?}", found.overall);
    for (rmse, law) in open.rmse.iter().zip(&open.law) {
        assert!((rmse / law - 1.0).abs() < 0.2, "{open:?}");
    }
    for (m, row) in open.covariance.iter().enumerate() {
        assert!(row.iter().all(|of| of.verdict != Agreement::Differs), "{m}: {row:?}");
        assert!((row[m].value - 1.0).abs() < 0.3 && row[m].error < 0.12, "{m}: {row:?}");
        // A rung and the next share half of the samples: without them the covariance would be 0.
        assert!(m == 0 || row[m - 1].value > 4.0 * row[m - 1].error, "{m}: {row:?}");
    }
    // Most of the room's variance sits in the few pixels that the lamp's edge crosses, and it says so.
    let near = enclosed.slope.is_some_and(|slope| (slope.mean + 0.5).abs() < 0.2);
    assert!(enclosed.heavy_tail && near, "{enclosed:?}");
    assert!(
        enclosed.excess_kurtosis > open.excess_kurtosis && enclosed.trusted_from.is_none_or(|n| n > 1),
        "{enclosed:?}"
    );
    // One scene has the interval of its pixels.
    assert!(slope.high - slope.low > 0.01 && slope.low < slope.mean, "{open:?}");
    // The SDE's moments are those of the ladders, the room's included, whose few bright pixels count as all others.
    for row in &found.sde {
        let of = [&row.mean, &row.variance].into_iter().chain(&row.covariance);
        assert!(of.clone().all(|of| of.verdict != Agreement::Differs), "{row:?}");
    }
    let [of_enclosed, of_open] = [&found.scenes[0], &found.scenes[1]];
    assert!(of_enclosed.heavy_tail && !of_enclosed.reasons.is_empty() && !of_open.heavy_tail, "{:?}", found.scenes);
    assert!(of_open.trusted_from.is_some_and(|n| n <= 32), "{of_open:?}");
    let Err(KindError::Input(message)) = run(&all(&references), &all(&ladders), &all(&exposure[..1])) else {
        panic!("an exposure is missing")
    };
    assert!(message.contains("L0-enclosed-000000"), "{message}");
    let Err(KindError::Input(message)) = run(&all(&ladders), &all(&ladders), &all(&exposure)) else {
        panic!("ladders judged by themselves")
    };
    assert!(message.contains("`stream`"), "{message}");
}

#[test]
fn references_of_another_stream_are_uncorrelated_with_the_ladder() {
    let bench = bench();
    let scene = bench.store(&balls_under_sky(), 0.0);
    let image = |rungs: u64, stream: u64| {
        let ladder = Ladder::load(&bench.ctx(), &bench.rendered(&scene, list(vec![rungs]), stream));
        ladder.expect("a ladder").rungs.pop().expect("a rung").image
    };
    let truth = image(4096, 2);
    let noise = |rungs: u64, stream: u64| -> Vec<f64> {
        let found = image(rungs, stream);
        found.data().iter().zip(truth.data()).map(|(a, b)| f64::from(a - b)).collect()
    };
    let correlation = |a: &[f64], b: &[f64]| {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
    };
    let (four, eight, held_out) = (noise(4, 0), noise(8, 0), noise(8, 1));
    // 1,728 values, of which the colours of a pixel go together: a deviation of 1/sqrt(576).
    assert!(correlation(&four, &held_out).abs() < 4.0 / 24.0, "{}", correlation(&four, &held_out));
    // sqrt(4/8) for rungs that share half of their samples.
    assert!((correlation(&four, &eight) - 0.707).abs() < 0.12, "{}", correlation(&four, &eight));
}
