//! `pipelines/stress.yaml`: hazards through every kind of the main job but those that call other programs. Nothing
//! fails, nothing comes out that is no number, and another number of threads, from an empty store, makes the same of
//! it. The rollouts of a thousand calls are of a hundred unless `TAUFLOW_SLOW=1`.

use crate::support::{Done, root};
use std::collections::BTreeMap;
use tauflow::engine::RunOptions;
use tauflow_contract::{Artifact, Context, Media};
use tauflow_data::{
    Image,
    records::{
        BridgeFiles, Convergence, Evaluation, Exposure, GBuffer, Ladder, LadderMeta, MethodTable, ModelFile,
        PackedScene, Refined, SceneStatistics, TimeError, TimedSummary, TrainingLog, Verdict,
    },
};
use tauflow_train::Model;

/// What is the same wherever it is made.
const SAME: [&str; 11] = [
    "gate.exposure",
    "columns",
    "points",
    "train_ladders",
    "test_set",
    "solvers.model",
    "close",
    "refined",
    "bridge_steps",
    "bridge",
    "evaluation",
];

fn run(store: &std::path::Path, jobs: usize, sets: Vec<String>) -> Done {
    let options = RunOptions { jobs, ..RunOptions::default() };
    Done::run_with(&root().join("pipelines/stress.yaml"), sets, store, &options)
}

/// Reads every item of a port, and wants something of each image of it.
fn images(
    done: &Done,
    port: &str,
    read: impl Fn(&Context<'_>, &Artifact) -> Vec<Image>,
    fine: impl Fn(&str, &Image),
) -> usize {
    let collection = done.collection(port);
    let mut count = 0;
    done.with(|ctx| {
        for (key, artifact) in collection.iter() {
            for image in read(ctx, artifact) {
                assert!(image.data().iter().all(|v| v.is_finite()), "{port} {key}");
                fine(key.as_str(), &image);
                count += 1;
            }
        }
    });
    count
}

#[test]
fn hazards_go_through_every_kind() {
    let folders = [1, 2].map(|_| tempfile::tempdir().expect("a temporary folder"));
    let slow = tauflow_testing::slow();
    let calls = |most: u64| vec![format!("endless.nfe=[1, {most}]")];
    let done = run(folders[0].path(), 2, if slow { Vec::new() } else { calls(100) });

    // Renders: as many images as rungs, none of them with a value that was rejected.
    let ladder = |ctx: &Context<'_>, artifact: &Artifact| {
        let Ladder { meta, rungs, variance } = Ladder::load(ctx, artifact).expect("a ladder");
        let LadderMeta { rejected, .. } = meta;
        assert_eq!(rejected, 0);
        assert!(variance.data().iter().all(|v| *v >= 0.0));
        rungs.into_iter().map(|rung| rung.image).chain([variance]).collect()
    };
    let size = |width: usize, height: usize| {
        move |key: &str, image: &Image| assert_eq!((image.width(), image.height()), (width, height), "{key}")
    };
    assert_eq!(images(&done, "previews", ladder, size(33, 17)), 2 * 36);
    assert_eq!(images(&done, "columns", ladder, size(1, 17)), 5 * 36);
    assert_eq!(images(&done, "points", ladder, size(1, 1)), 3 * 36);
    for (port, rungs) in [("train_ladders", 4), ("test_ladders", 4), ("close_ladders", 2), ("held_out", 1)] {
        let scenes = done.keys(port).len();
        assert!(scenes >= 4, "{port}");
        assert_eq!(images(&done, port, ladder, size(33, 17)), (rungs + 1) * scenes, "{port}");
    }
    let gbuffer = |ctx: &Context<'_>, artifact: &Artifact| {
        let GBuffer { albedo, normal } = GBuffer::load(ctx, artifact).expect("a G-buffer");
        assert!(albedo.data().iter().all(|v| (0.0..=1.0).contains(v)) && normal.data().iter().all(|v| v.abs() <= 1.0));
        vec![albedo, normal]
    };
    assert!(images(&done, "train_ladders.gbuffer", gbuffer, size(33, 17)) >= 8);

    // The gate rejects what is black and nothing else, and exposures span more than twenty stops.
    let verdicts: BTreeMap<String, Verdict> = done.read("gate.verdicts");
    let rejected: Vec<&Verdict> = verdicts.values().filter(|v| !v.reasons.is_empty()).collect();
    assert!(verdicts.len() == 36 && !rejected.is_empty(), "{rejected:?}");
    assert!(rejected.iter().all(|v| v.reasons == ["black"]), "{rejected:?}");
    let factors: Vec<f64> = done.read::<Exposure>("gate.exposure").into_values().map(|e| e.factor).collect();
    let (least, most) = factors.iter().fold((f64::MAX, 0.0f64), |(a, b), v| (a.min(*v), b.max(*v)));
    assert!(least > 0.0 && (most / least).log2() > 20.0 && most.is_finite(), "{least:e} {most:e}");

    let packed = |ctx: &Context<'_>, artifact: &Artifact| PackedScene::load(ctx, artifact).expect("packed").states;
    for (port, rungs) in [("train_set", 4), ("test_set", 4), ("close_set", 2), ("one_set", 4)] {
        assert_eq!(images(&done, port, packed, size(33, 17)), rungs * done.keys(port).len(), "{port}");
    }

    // Trainings: every loss, and every weight, which a model is read by.
    for (port, cells) in [("solvers", 8), ("close_solvers", 8)] {
        let logs: BTreeMap<String, TrainingLog> = done.read(&format!("{port}.log"));
        assert_eq!(logs.len(), cells);
        for (cell, log) in &logs {
            let losses: Vec<Option<f64>> = log.points[1..].iter().map(|p| p.train).collect();
            assert!(!losses.is_empty() && losses.iter().all(|l| l.is_some_and(f64::is_finite)), "{cell}: {losses:?}");
            let tests: Vec<Option<f64>> = log.points.iter().map(|p| p.test).collect();
            assert!(tests.iter().all(|l| l.is_some_and(f64::is_finite) == (port == "solvers")), "{cell}: {tests:?}");
        }
        let models = done.collection(&format!("{port}.model"));
        done.with(|ctx| {
            for (_, artifact) in models.iter() {
                Model::load(&ModelFile::load(ctx, artifact).expect("stored").0).expect("finite weights");
            }
        });
    }

    // Refinements in 1 to 1,000 calls.
    let refined = |ctx: &Context<'_>, artifact: &Artifact| {
        Refined::load(ctx, artifact).expect("refined").images.into_iter().map(|(_, image)| image).collect()
    };
    let tested = done.keys("test_set").len();
    for (port, count) in [
        ("refined", 8 * 4 * tested),
        ("late", 8 * 2 * tested),
        ("close", 8 * 2 * tested),
        ("endless", 4 * 2),
        ("filtered", tested),
        ("timed", 4 * 2 * tested),
    ] {
        assert_eq!(images(&done, port, refined, size(33, 17)), count, "{port}");
    }

    // Tables: JSON has no NaN, so that a number that is none would not be read.
    let evaluation: Evaluation = done.only("evaluation");
    assert_eq!((evaluation.methods.len(), evaluation.nfe.as_slice()), (8, &[1u64, 2, 3, 9][..]));
    for MethodTable { at, auc, tv, .. } in &evaluation.methods {
        let of =
            at.iter().flat_map(|at| at.metrics.values().chain(at.gain.values())).chain(auc.values()).chain(tv.values());
        assert!(of.flat_map(|e| [e.mean, e.low, e.high]).all(f64::is_finite));
    }
    let convergence: Convergence = done.only("convergence");
    assert!(convergence.overall.rmse.iter().chain(&convergence.overall.law).all(|v| v.is_finite() && *v > 0.0));
    assert_eq!(done.read::<SceneStatistics>("statistics").len(), tested);
    let bridge = done.only::<BridgeFiles>("bridge").bridge;
    // Eight methods at 1 -> 2, 2 -> 3 and 1 -> 3.
    assert_eq!((bridge.rows.len(), bridge.cases.len()), (24, 24 * tested));
    let timed: TimeError = done.only("time_error");
    assert_eq!(timed.methods.len(), 3);
    for point in timed.methods.iter().flat_map(|of| &of.points) {
        let TimedSummary { wall_s, mse, rel_mse, .. } = point.all;
        assert!(wall_s.into_iter().chain([mse, rel_mse]).all(|v| v.is_finite() && v > 0.0), "{point:?}");
        assert_eq!(point.scenes.len(), tested);
    }
    let report = done.collection("report");
    let (_, report) = report.iter().next().expect("one report");
    let page = String::from_utf8(done.part(report, "report.html")).expect("text");
    assert!(page.contains("Stress"), "a report with its title");
    // Images and data of the viewer are base64, in which any letters stand side by side.
    let is_code = |c: Option<char>| c.is_some_and(|c| c.is_ascii_alphanumeric() || "+/=".contains(c));
    for word in ["NaN", ">inf"] {
        let is_said = |at: &usize| {
            let (before, after) = (page[..*at].chars().next_back(), page[at + word.len()..].chars().next());
            !is_code(before) && !is_code(after)
        };
        let said = page.match_indices(word).map(|(at, _)| at).find(is_said);
        let around = said.map(|at| page[..at + word.len()].lines().next_back().unwrap_or_default());
        assert_eq!(around, None, "a report with numbers");
    }

    let again = run(folders[1].path(), 1, calls(2));
    for port in SAME {
        assert_eq!(done.collection(port).digest(), again.collection(port).digest(), "{port}");
    }
}
