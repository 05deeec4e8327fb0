//! `quality_gate` and `ladder_convergence` as the engine calls them, on ladders that were really rendered.

mod scenes;

use scenes::{Built, balls_under_sky, recipe, room};
use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{Action, Artifact, Collection, Context, ItemKey, Kind, KindError, MemoryBlobs, Outputs, Silent};
use tauflow_data::{
    RungCounts,
    convergence::Convergence,
    formats::{Exposure, Verdict, store_scene},
};
use tauflow_render::{
    ladder_convergence::{LadderConvergence, LadderConvergenceParams},
    ladder_rendering::{LadderRendering, LadderRenderingParams},
    quality_gate::{QualityGate, QualityGateParams},
};

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
        store_scene(&ctx, &built.scene, &recipe(exposure_ev)).expect("memory")
    }

    fn ladder(&self, scene: &Artifact, rungs: RungCounts) -> Artifact {
        let params = LadderRenderingParams { rungs, resolution: [24, 24], ..LadderRenderingParams::default() };
        let each = BTreeMap::from([("scenes", scene)]);
        let action = Action { params, item: None, group: "ladder", seed: 0, each, whole: BTreeMap::new() };
        let mut outputs = LadderRendering::run(&self.ctx(), &action).expect("a sound scene");
        outputs.items.remove("ladder").expect("the port")
    }

    fn gate(&self, scene: &Artifact, preview: &Artifact, params: QualityGateParams) -> Outputs {
        let each = BTreeMap::from([("scenes", scene), ("previews", preview)]);
        let action = Action { params, item: None, group: "main", seed: 0, each, whole: BTreeMap::new() };
        QualityGate::run(&self.ctx(), &action).expect("a sound preview")
    }

    fn json<T: serde::de::DeserializeOwned>(&self, artifact: &Artifact) -> T {
        self.ctx().json(artifact, "").expect("JSON")
    }
}

#[test]
fn the_gate_passes_scenes_on_unchanged_and_no_threshold_changes_what_it_says_of_them() {
    let bench = bench();
    let scene = bench.store(&room(), 0.5);
    let preview = bench.ladder(&scene, RungCounts::List(vec![1, 32]));
    let usual = bench.gate(&scene, &preview, QualityGateParams::default());
    assert_eq!(usual.items["accepted"], scene);
    let exposure: Exposure = bench.json(&usual.items["exposure"]);
    assert!((exposure.factor * exposure.mean_luminance / (0.18 * 2f64.sqrt()) - 1.0).abs() < 1e-9, "{exposure:?}");
    let lax = QualityGateParams { contrast: 0.001, noise: 5.0, ..QualityGateParams::default() };
    assert_eq!(bench.gate(&scene, &preview, lax).items, usual.items);
    let strict = QualityGateParams { contrast: 0.9, ..QualityGateParams::default() };
    let rejected = bench.gate(&scene, &preview, strict).items;
    assert_eq!(rejected.keys().collect::<Vec<_>>(), ["verdicts"]);
    let [before, after] =
        [&usual.items["verdicts"], &rejected["verdicts"]].map(|verdict| bench.json::<Verdict>(verdict));
    assert_eq!((before.reasons.len(), after.reasons.as_slice()), (0, &["near_constant".to_owned()][..]));
    assert_eq!(before.measures, after.measures);
    // Only the offset of exposure differs.
    let brighter = bench.store(&room(), 1.5);
    let twice: Exposure = bench.json(&bench.gate(&brighter, &preview, QualityGateParams::default()).items["exposure"]);
    assert!((twice.factor / exposure.factor - 2.0).abs() < 1e-12);
}

#[test]
fn rendered_ladders_keep_the_law() {
    let bench = bench();
    let (mut ladders, mut exposure) = (Vec::new(), Vec::new());
    for (name, built) in [("L0-open-000000", balls_under_sky()), ("L0-enclosed-000000", room())] {
        let key = ItemKey::new(name).expect("plain");
        let scene = bench.store(&built, 0.0);
        let ladder = bench.ladder(&scene, RungCounts::Dyadic { dyadic: 128 });
        exposure
            .push((key.clone(), bench.gate(&scene, &ladder, QualityGateParams::default()).items["exposure"].clone()));
        ladders.push((key, ladder));
    }
    let run = |ladders: &Collection, exposure: &Collection| {
        let whole = BTreeMap::from([("ladders", ladders), ("exposure", exposure)]);
        let params = LadderConvergenceParams::default();
        let action = Action { params, item: None, group: "main", seed: 0, each: BTreeMap::new(), whole };
        LadderConvergence::run(&bench.ctx(), &action)
    };
    let (ladders, all): (Collection, Collection) = (ladders.into_iter().collect(), exposure.iter().cloned().collect());
    let outputs = run(&ladders, &all).expect("sound ladders");
    let found: Convergence = bench.json(outputs.collections["convergence"].get("convergence").expect("one item"));
    assert_eq!((found.reference_spp, found.counts.as_slice()), (128, &[1, 2, 4, 8, 16, 32, 64][..]));
    assert_eq!(found.strata.iter().map(|s| s.stratum.as_str()).collect::<Vec<_>>(), ["L0-enclosed", "L0-open"]);
    assert_eq!((found.overall.scenes, found.overall.rejected), (2, 0));
    let [enclosed, open] = [&found.strata[0], &found.strata[1]];
    assert!((open.slope + 0.5).abs() < 0.05 && !open.heavy_tail, "{open:?}");
    for (rmse, law) in open.rmse.iter().zip(&open.law) {
        assert!((rmse / law - 1.0).abs() < 0.2, "{open:?}");
    }
    // Most of the room's variance sits in the few pixels that the lamp's edge crosses, and it says so.
    assert!(enclosed.heavy_tail && (enclosed.slope + 0.5).abs() < 0.2, "{enclosed:?}");
    let one: Collection = exposure.into_iter().take(1).collect();
    let Err(KindError::Input(message)) = run(&ladders, &one) else { panic!("an exposure is missing") };
    assert!(message.contains("L0-enclosed-000000"), "{message}");
}
