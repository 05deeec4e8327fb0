//! `view` writes a page with the images of a node and of its relatives.

use crate::{Place, exports::PIPELINE};
use serde_json::{Value, json};
use std::fs;
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
