//! `pipelines/time_error.yaml` with its profile `tiny`: every method is timed on every scene, in its own right, and the
//! page has them all. `pipelines/sobol.yaml` goes on from its results.

use crate::support::{Done, root};
use std::{collections::BTreeMap, path::Path};
use tauflow::engine::RunOptions;
use tauflow_data::{
    SamplerKind, Stratum,
    records::{Convergence, ModelFile, TimeError, Timing},
};
use tauflow_train::{Denoiser, Model};

#[test]
fn every_method_is_timed_on_every_scene() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    // A renderer that is not there, whatever this machine has.
    let sets = [
        r#"all_mitsuba.command=[no-such-renderer, "{scene}", "{counts}", "{folder}"]"#,
        "all_solvers.repeats=1",
        "values.film=[32, 32]",
    ];
    let sets = sets.map(str::to_owned).to_vec();
    let file = root().join("pipelines/time_error.yaml");
    let done = Done::run_profile(&file, "tiny", sets.clone(), folder.path(), &RunOptions::default());
    let tables: TimeError = done.only("all_times");

    let points: BTreeMap<(&str, &str), Vec<(u64, u64)>> = tables
        .methods
        .iter()
        .map(|m| {
            let points = m.points.iter().map(|p| (p.from_spp, p.nfe)).collect();
            ((m.method.as_str(), m.conditioning.as_str()), points)
        })
        .collect();
    let rungs: Vec<(u64, u64)> = (0..8).map(|k| (1 << k, 0)).collect();
    let each = |from: &[u64], nfe: &[u64]| -> Vec<(u64, u64)> {
        from.iter().flat_map(|from| nfe.iter().map(|nfe| (*from, *nfe))).collect()
    };
    let mut expected = BTreeMap::from([
        (("path_tracer", "rgb"), rungs.clone()),
        (("path_tracer_sobol", ""), rungs),
        (("joint_bilateral", "gbuffer"), each(&[1, 4, 16, 64], &[1])),
    ]);
    for conditioning in ["rgb", "gbuffer"] {
        for solver in ["vanilla_rf", "local_velocity", "mc_velocity", "mc_noise"] {
            expected.insert((solver, conditioning), each(&[1, 2, 4, 16, 64], &[1, 2]));
        }
    }
    // What is not there is left out, and said.
    let said = |name: &str| tables.notes.iter().any(|note| note.starts_with(&format!("{name}: there is no")));
    assert!(said("mitsuba"), "{:?}", tables.notes);
    if !said("oidn") {
        expected.insert(("oidn", "gbuffer"), each(&[1, 2, 4, 16, 64], &[1]));
    }
    assert_eq!(points, expected);

    let mut scenes = done.keys("sampling.test");
    scenes.sort_unstable();
    assert_eq!(scenes.len(), 12);
    for method in &tables.methods {
        for point in &method.points {
            let listed: Vec<&str> = point.scenes.iter().map(|s| s.scene.as_str()).collect();
            assert_eq!(listed, scenes, "{}", method.method);
            assert_eq!(point.strata.len(), Stratum::all().count());
            for scene in &point.scenes {
                assert!(
                    scene.wall_s[0] > 0.0 && scene.wall_s.is_sorted() && scene.mse > 0.0 && scene.ssim.is_finite(),
                    "{scene:?}"
                );
                assert_eq!(scene.speed_up.is_some(), method.method != "path_tracer");
                assert!(scene.speed_up.is_none_or(|v| v.is_finite() && v > 0.0), "{scene:?}");
            }
        }
    }
    // More samples take longer and leave less error: a 128th of it by the law.
    let own = &tables.methods[0].points;
    assert!(own[7].all.wall_s[1] > own[0].all.wall_s[1], "{own:?}");
    assert!(own[7].all.mse < 0.05 * own[0].all.mse, "{} {}", own[7].all.mse, own[0].all.mse);
    // A solver's time is that of its endpoint, of the G-buffer, and its own.
    let render: BTreeMap<String, Timing> = done.read("all_ladders.timing");
    let solver: BTreeMap<String, Timing> = done.read("all_solvers.timing");
    let timed = tables.methods.iter().find(|m| (m.method.as_str(), m.conditioning.as_str()) == ("mc_noise", "gbuffer"));
    let point = timed.expect("it is listed").points.iter().find(|p| (p.from_spp, p.nfe) == (4, 2)).expect("timed");
    for scene in &point.scenes {
        let cell = format!("parameterization=mc_noise+conditioning=gbuffer+from=4/{}", scene.scene);
        let render = &render[&scene.scene];
        let parts = [
            middle(render, "path_tracer", 4, 0),
            middle(render, "gbuffer", 0, 0),
            middle(&solver[&cell], "mc_noise", 4, 2),
        ];
        let sum: f64 = parts.iter().sum();
        assert!((scene.wall_s[1] / sum - 1.0).abs() < 1e-9, "{scene:?} {parts:?}");
    }
    // The page shows each of them, and the files hold every scene.
    let report = done.collection("time_report");
    let (_, report) = report.iter().next().expect("one page");
    let text = |part: &str| String::from_utf8(done.part(report, part)).expect("text");
    let rows = tables.methods.iter().map(|m| m.points.len() * 12).sum::<usize>();
    assert_eq!(text("time_error_scenes.csv").lines().count(), rows + 1);
    let page = text("report.html");
    for name in ["Vanilla RF, RGB", "Local velocity, G-buffer", "MC noise, RGB", "MC velocity, G-buffer"] {
        assert!(page.contains(name), "{name}");
    }
    solvers_follow_the_error_of_sobol_ladders(sets, folder.path());
}

/// The median wall time of an image.
fn middle(timing: &Timing, method: &str, spp: u64, nfe: u64) -> f64 {
    let mut of = timing.entries.iter().filter(|e| (e.method.as_str(), e.nfe) == (method, nfe));
    let entry = of.find(|e| method == "gbuffer" || e.from_spp == spp).expect("timed");
    let mut wall = entry.took.wall_s.clone();
    wall.sort_by(f64::total_cmp);
    wall[wall.len() / 2]
}

/// The exponent that `convergence` finds is that of the solver's clock, and its images take the time of their ladders.
fn solvers_follow_the_error_of_sobol_ladders(sets: Vec<String>, folder: &Path) {
    let file = root().join("pipelines/sobol.yaml");
    let done = Done::run_profile(&file, "tiny", sets, folder, &RunOptions::default());
    let fit: Convergence = done.only("fit");
    let mut slopes: Vec<f64> = fit.scenes.iter().filter_map(|scene| Some(scene.slope?.mean)).collect();
    slopes.sort_by(f64::total_cmp);
    let alpha = -tauflow_data::statistics::quantile(&slopes, 0.5);
    assert!(fit.sampler == SamplerKind::Sobol && (0.4..1.0).contains(&alpha), "{alpha}");
    let models: BTreeMap<String, ModelFile> = done.read("sobol_solvers.model");
    for (cell, file) in &models {
        let model = Model::load(&file.0).expect("own bytes");
        let expected = if cell.contains("clock=fitted") { alpha } else { 0.5 };
        assert_eq!(model.clock().exponent(), expected, "{cell}");
    }
    let tables: TimeError = done.only("sobol_times");
    let cells: Vec<_> = tables.methods.iter().filter(|m| m.method == "mc_noise").map(|m| m.cell.clone()).collect();
    let named = |cell: &[(&str, &str)]| cell.iter().map(|(a, v)| ((*a).to_owned(), (*v).to_owned())).collect();
    let expected: [BTreeMap<String, String>; 3] = [
        named(&[]),
        named(&[("clock", "fitted"), ("sampler", "sobol")]),
        named(&[("clock", "independent"), ("sampler", "sobol")]),
    ];
    assert_eq!(cells, expected);
    // The time of the Sobol' ladder, of the G-buffer, and of the solver.
    let [independent, ladders, solver] =
        ["all_ladders.timing", "all_sobol.timing", "sobol_refined.timing"].map(|port| done.read::<Timing>(port));
    let fitted = tables.methods.iter().find(|m| m.cell.get("clock").is_some_and(|clock| clock == "fitted"));
    let point = fitted.expect("it is listed").points.iter().find(|p| (p.from_spp, p.nfe) == (16, 1)).expect("timed");
    for scene in &point.scenes {
        let cell = "sampler=sobol+clock=fitted+parameterization=mc_noise+conditioning=gbuffer+from=16";
        let parts = [
            middle(&ladders[&format!("sampler=sobol/{}", scene.scene)], "path_tracer", 16, 0),
            middle(&independent[&scene.scene], "gbuffer", 0, 0),
            middle(&solver[&format!("{cell}/{}", scene.scene)], "mc_noise", 16, 1),
        ];
        let sum: f64 = parts.iter().sum();
        assert!((scene.wall_s[1] / sum - 1.0).abs() < 1e-9, "{scene:?} {parts:?}");
    }
}
