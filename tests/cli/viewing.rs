//! `view` writes a page with the images of a node and of its relatives.

use crate::{Place, exports::PIPELINE, refining};
use serde_json::{Value, json};
use std::{fs, process::Command};
use tauflow_data::image_io::read_exr;
use tauflow_testing::Browser;

/// The index of a page.
fn index(place: &Place, page: &str) -> Value {
    let text = fs::read_to_string(place.path(page)).expect("a page");
    let (_, rest) = text.split_once("id=\"index\">").expect("an index");
    serde_json::from_str(rest.split_once("</script>").expect("its end").0).expect("JSON")
}

#[test]
fn a_page_has_the_relatives_of_a_node() {
    let place = Place::with(PIPELINE);
    let none = place.tauflow(&["view", "small.yaml", "filtered"]).ends(2);
    assert!(none.err.contains("must run first"), "{}", none.err);
    place.tauflow(&["run", "small.yaml", "--target", "filtered"]).ends(0);
    let written = place.tauflow(&["view", "small.yaml", "filtered", "-o", "pages/a b.html"]).ends(0);
    assert_eq!(written.lines(), ["pages/a b.html"]);
    let index = index(&place, "pages/a b.html");
    let ids: Vec<&str> = index["frames"].as_array().expect("frames").iter().filter_map(|f| f["id"].as_str()).collect();
    for id in ["packed: rungs/1 spp", "packed: rungs/16 spp", "ladders: variance/per sample"] {
        assert!(ids.contains(&id), "{ids:?}");
    }
    assert!(ids.iter().any(|id| id.starts_with("filtered: ")), "its own images: {ids:?}");
    // It opens with the input, beside the reference.
    let input = ids.iter().position(|id| *id == "packed: rungs/1 spp");
    assert_eq!((&index["first"], &index["folder"]), (&json!(input), &json!("")));
    let command = index["command"].as_str().expect("a command");
    assert!(command.starts_with("tauflow view small.yaml filtered -o 'pages/a b.html'"), "{command}");
    // All scenes of the gate, with its reasons; their ladders have no exposure but the gate's.
    place.tauflow(&["view", "small.yaml", "gate.verdicts", "--folder", "-o", "gate.html"]).ends(0);
    let judged = self::index(&place, "gate.html");
    let scenes = judged["scenes"].as_array().expect("scenes");
    assert_eq!((scenes.len(), &judged["folder"]), (4, &json!("gate_files")));
    assert!(scenes.iter().all(|scene| scene["reasons"].is_array()) && judged["measures"]["contrast"].is_array());
    assert!(place.path("gate_files/s000003.js").exists());
    // A page that fits into one file has no folder.
    place.tauflow(&["view", "small.yaml", "gate.verdicts", "-o", "gate.html"]).ends(0);
    assert!(!place.path("gate_files").exists());
    let other = place.tauflow(&["view", "small.yaml", "scenes"]).ends(2);
    assert!(other.err.contains("no images of scenes; name a node with images: `ladders`, `packed`"), "{}", other.err);
    let far = place.tauflow(&["view", "small.yaml", "packed", "nothing"]).ends(2);
    assert!(far.err.contains("`packed` has no item `nothing`; it has"), "{}", far.err);
    let unwritten = place.tauflow(&["view", "small.yaml", "packed", "-o", "small.yaml/x.html"]).ends(3);
    assert!(unwritten.err.contains("cannot write small.yaml"), "{}", unwritten.err);
}

#[test]
fn links_are_written_through_and_pipes_get_the_page() {
    let place = Place::with(PIPELINE);
    let program = env!("CARGO_BIN_EXE_tauflow");
    place.tauflow(&["run", "small.yaml", "--target", "packed"]).ends(0);
    fs::create_dir(place.path("far")).expect("writable");
    place.write("far/page.html", "old");
    std::os::unix::fs::symlink("far/page.html", place.path("link.html")).expect("writable");
    let said = place.tauflow(&["view", "small.yaml", "packed", "-o", "link.html"]).ends(0);
    assert_eq!((said.out.as_str(), place.path("link.html").is_symlink()), ("link.html\n", true));
    assert!(index(&place, "far/page.html")["scenes"].is_array());
    // Data of a page that a link leads to lie beside the page.
    place.tauflow(&["view", "small.yaml", "packed", "--folder", "-o", "link.html"]).ends(0);
    assert!(place.path("link.html").is_symlink() && place.path("far/page_files/s000000.js").exists());
    // A pipe gets the page and nothing else.
    let script =
        format!("mkfifo p.html; {program} view small.yaml packed -o p.html 2>err & timeout 60 cat p.html; wait");
    let mut command = Command::new("bash");
    command.args(["-c", &script]).current_dir(place.path("")).env("TAUFLOW_CACHE", place.path("store"));
    let page = String::from_utf8(command.output().expect("bash starts").stdout).expect("a text");
    let told = fs::read_to_string(place.path("err")).unwrap_or_default();
    assert!(page.starts_with("<!DOCTYPE") && page.ends_with("</html>\n"), "{} bytes, {told}", page.len());
    assert!(!place.path("p.html").is_file());
    let said = place.tauflow(&["view", "small.yaml", "packed", "--folder", "-o", "p.html"]).ends(2);
    assert!(said.err.contains("p.html is no file, and has no folder beside it"), "{}", said.err);
}

#[test]
fn pixels_of_a_page_are_those_of_the_export() {
    let Some(mut browser) = Browser::start("pixels of a page") else { return };
    let place = Place::with(PIPELINE);
    place.tauflow(&["run", "small.yaml", "--target", "filtered"]).ends(0);
    place.tauflow(&["export", "small.yaml", "packed", "-o", "packed"]).ends(0);
    place.tauflow(&["view", "small.yaml", "packed"]).ends(0);
    browser.size(1400, 800);
    browser.open(&place.path("packed.html"));
    browser.wait("now.a !== null");
    let scene = browser.eval("index.scenes[state.scene].key");
    let file = format!("packed/{}/spp-000001.exr", scene.as_str().expect("a key"));
    let image = read_exr(&place.path(&file)).expect("a picture").remove("").expect("unnamed");
    let read = browser.eval("Array.from(canvas.readBack(now.a)).filter((_, i) => i % 4 < 3)");
    let read: Vec<f64> = read.as_array().expect("a list").iter().filter_map(Value::as_f64).collect();
    let stated = browser.eval("now.a.error[0]").as_f64().expect("a number");
    assert_eq!(read.len(), image.data().len());
    assert!(image.data().iter().any(|value| *value > 0.0), "{file}");
    for (found, value) in read.iter().zip(image.data()) {
        assert!((found - f64::from(*value)).abs() <= stated, "{found}, not {value}, is off by more than {stated}");
    }
    assert!(browser.problems().is_empty(), "{:?}", browser.problems());
}

#[test]
fn states_of_a_solver_are_shown_once_they_are_there() {
    let refined = "  refined:\n    kind: refinement\n    matrix: { like: solvers }\n    inputs: { endpoints: \
                   set, model: solvers.model }\n    params: { nfe: [1, 3] }\ntargets: [refined]";
    let place = Place::with(&refining::PIPELINE.replace("targets: [solvers]", refined));
    place.tauflow(&["run", "small.yaml"]).ends(0);
    let without = place.tauflow(&["view", "small.yaml", "refined", "-o", "without.html"]).ends(0);
    assert!(without.err.contains("`refined.states` is not up to date; the viewer leaves it out"), "{}", without.err);
    // Asking for them leaves the results as they are.
    let run = place.tauflow(&["run", "small.yaml", "--target", "refined.states"]).ends(0);
    place.tauflow(&["view", "small.yaml", "refined", "-o", "with.html"]).ends(0);
    let index = index(&place, "with.html");
    let frames = index["frames"].as_array().expect("frames");
    let frame = |id: &str| {
        let place = frames.iter().position(|frame| frame["id"] == json!(id));
        (place, &frames[place.unwrap_or_else(|| panic!("no {id} in {frames:#?} of {run:?}"))])
    };
    let track = "refined: rgb, mc_noise, from 1 spp, states of NFE 3";
    let (first, state) = frame(&format!("{track}/call 1 of 3"));
    let own = &index["tracks"][state["track"].as_u64().expect("a number") as usize];
    assert_eq!((&own["between"], &own["name"]), (&json!(0), &json!(track)));
    // Dyadic rungs up to 8: the first of three calls ends at 2 spp.
    let (rung, two) = frame("set: rungs/2 spp");
    assert!((state["tau"].as_f64().expect("a time") - two["tau"].as_f64().expect("a time")).abs() < 1e-12);
    assert_eq!((&state["before"], &two["before"]), (&json!(frame("set: rungs/1 spp").0), &state["before"]));
    assert_eq!(frame(&format!("{track}/call 2 of 3")).1["before"], json!(first));
    assert!(rung.is_some() && frame(&format!("{track}/call 3 of 3")).1["tau"] == json!(1.0));
    // The last state is the result, to the bit.
    place.tauflow(&["export", "small.yaml", "refined", "-o", "refined"]).ends(0);
    place.tauflow(&["export", "small.yaml", "refined.states", "-o", "states"]).ends(0);
    let image = |name: &str| {
        let path = place.path(&format!("{name}.exr"));
        read_exr(&path).unwrap_or_else(|error| panic!("{error}")).remove("").expect("unnamed")
    };
    let scene = index["scenes"][0]["key"].as_str().expect("a key");
    let result = image(&format!("refined/conditioning=rgb/{scene}/mc_noise-1-to-8-nfe-3"));
    let state = |call: u64| image(&format!("states/conditioning=rgb/{scene}/mc_noise-1-nfe-3-call-{call:04}"));
    assert!(state(3) == result && state(2) != result);
}

/// A node that hands on one sample of a backbone, of one pixel: 0.5 frozen, 1 adapted, with a step of its trajectory.
const SAMPLES: &str = "\
pipeline: small
seed: 3
nodes:
  samples:
    kind: command
    params:
      run: [sh, samples.sh]
      mode: gather
      outputs: { samples: tauflow/generated }
      images: pfm
";
const SAMPLES_SH: &str = r#"own=out/samples/rf-0000
mkdir "$own"
pixel() { printf 'PF\n1 1\n-1.0\n'; for channel in 1 2 3; do printf "\000\000$1\077"; done; }
pixel '\000' > "$own/frozen.pfm"
pixel '\200' > "$own/adapted.pfm"
pixel '\000' > "$own/adapted-step-0000.pfm"
cat > "$own/meta.json" <<'END'
{"backbone": "rf", "family": "rectified_flow", "sample": 0, "steps": 1, "variants": [
  {"variant": "frozen", "energy": [0.0], "frames": []}, {"variant": "adapted", "energy": [0.1], "frames": [0]}]}
END
"#;

#[test]
fn samples_of_a_backbone_are_compared_with_the_frozen_one() {
    let place = Place::with(SAMPLES);
    fs::write(place.path("samples.sh"), SAMPLES_SH).expect("it can be written");
    place.tauflow(&["run", "small.yaml"]).ends(0);
    place.tauflow(&["view", "small.yaml", "samples", "-o", "samples.html"]).ends(0);
    let index = index(&place, "samples.html");
    let frames = index["frames"].as_array().expect("frames");
    let ids: Vec<&str> = frames.iter().filter_map(|frame| frame["id"].as_str()).collect();
    assert_eq!(ids, ["samples/frozen", "samples/adapted", "samples: trajectory, adapted/step 0"]);
    assert!(frames.iter().all(|frame| frame["content"] == json!("display")));
    // It opens with the adapted image, and the direction is that of the adapter.
    assert_eq!((&index["first"], &frames[1]["before"]), (&json!(1), &json!(0)));
    let scene = &index["scenes"][0];
    assert_eq!((&scene["key"], &scene["stratum"], &scene["reference"]), (&json!("rf-0000"), &json!("rf"), &json!(0)));
    let psnr = index["metrics"][0]["values"]["1"][0].as_f64().expect("a number");
    assert!((psnr - 6.021).abs() < 1e-3, "{psnr}");
}

const BRIDGE: &str = r#"  solvers:
    kind: training
    matrix: { parameterization: [mc_noise, local_velocity] }
    inputs: { train: packed }
    params: { conditioning: rgb, preset: tiny, steps: 0 }
  rungs:
    kind: ladder_rendering
    inputs: { scenes: gate.accepted }
    params: { rungs: [1, 2, 3, 4], resolution: [16, 16] }
  endpoints:
    kind: dataset_packing
    inputs: { ladders: rungs, exposure: gate.exposure }
  steps:
    kind: bridge_refinement
    inputs:
      endpoints: endpoints
      mc_noise: "solvers[parameterization=mc_noise].model"
      local_velocity: "solvers[parameterization=local_velocity].model"
    params: { gaussian: 0.7 }
  bridge:
    kind: bridge_validation
    inputs: { endpoints: endpoints, steps: steps }
    params: { resamples: 100, map_scenes: 0 }
"#;

#[test]
fn each_method_of_a_bridge_is_a_track_of_its_stops() {
    let place = Place::with(&format!("{PIPELINE}{BRIDGE}"));
    place.tauflow(&["run", "small.yaml", "--target", "bridge"]).ends(0);
    place.tauflow(&["view", "small.yaml", "steps"]).ends(0);
    let index = index(&place, "steps.html");
    let ids: Vec<&str> = index["frames"].as_array().expect("frames").iter().filter_map(|f| f["id"].as_str()).collect();
    for method in ["hold", "mc_noise", "mc_noise+log1p", "local_delta", "expectation", "gaussian", "gaussian_tau"] {
        let stops = ["1 \u{2192} 2", "2 \u{2192} 3", "3 \u{2192} 4", "1 \u{2192} 4", "2 \u{2192} 4"];
        for stop in stops.map(|stop| format!("steps: {method}/{stop} spp")) {
            assert!(ids.contains(&stop.as_str()), "{stop}: {ids:?}");
        }
    }
    // The real rungs stand beside them.
    assert!(ids.contains(&"endpoints: rungs/3 spp"), "{ids:?}");
    // The tables of a bridge have no images, but say where they are.
    let tables = place.tauflow(&["view", "small.yaml", "bridge"]).ends(2);
    assert!(tables.err.contains("name a node that it reads: `endpoints`, `steps`"), "{}", tables.err);
    let Some(mut browser) = Browser::start("a bridge in the viewer") else { return };
    browser.size(1400, 800);
    browser.open(&place.path("steps.html"));
    browser.wait("now.a !== null");
    assert!(browser.problems().is_empty(), "{:#?}", browser.problems());
}
