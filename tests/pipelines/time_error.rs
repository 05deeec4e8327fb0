//! `pipelines/time_error.yaml` with its profile `tiny`: every method is timed on every scene, in its own right, and the page has them all.

use crate::support::{Done, root};
use std::collections::BTreeMap;
use tauflow::engine::RunOptions;
use tauflow_data::{Stratum, time_error::TimeError};

#[test]
fn every_method_is_timed_on_every_scene() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    // A renderer that is not there, whatever this machine has.
    let sets = [
        r#"all_mitsuba.command=[no-such-renderer, "{scene}", "{counts}", "{folder}"]"#,
        "all_solvers.repeats=1",
        "other_solvers.repeats=1",
    ];
    let sets = sets.map(str::to_owned).to_vec();
    let file = root().join("pipelines/time_error.yaml");
    let done = Done::run_profile(&file, "tiny", sets, folder.path(), &RunOptions::default());
    let tables: TimeError = done.json("all_times", "").into_values().next().expect("one item");

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
        for solver in ["mc_velocity", "mc_noise"] {
            expected.insert((solver, conditioning), each(&[1, 2, 4, 16, 64], &[1, 2]));
        }
        for solver in ["vanilla_rf", "local_velocity"] {
            expected.insert((solver, conditioning), each(&[1, 4, 16], &[1, 2]));
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
                    scene.wall_s > 0.0 && scene.cpu_s > 0.0 && scene.mse > 0.0 && scene.ssim.is_finite(),
                    "{scene:?}"
                );
                assert_eq!(scene.speed_up.is_some(), method.method != "path_tracer");
                assert!(scene.speed_up.is_none_or(|v| v.is_finite() && v > 0.0), "{scene:?}");
            }
        }
    }
    // More samples take longer and leave less error, over all scenes; a solver takes longer than its endpoint.
    let own = &tables.methods[0].points;
    assert!(own.windows(2).all(|w| w[0].all.wall_s[1] < w[1].all.wall_s[1]), "{own:?}");
    assert!(own[7].all.mse < 0.2 * own[0].all.mse, "{} {}", own[7].all.mse, own[0].all.mse);
    for solver in tables.methods.iter().filter(|m| m.method == "mc_noise") {
        for (solver, own) in solver.points[0].scenes.iter().zip(&own[0].scenes) {
            assert!(solver.wall_s > own.wall_s, "{solver:?} {own:?}");
        }
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
}
