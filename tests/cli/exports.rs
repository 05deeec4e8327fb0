//! `export` names the space and the exposure of images, and undoes the exposure on request. `show` tells what an item
//! is.

use crate::Place;
use serde_json::Value;
use std::{
    collections::BTreeMap,
    fs,
    process::{Command, Stdio},
};
use tauflow_data::image_io::read_exr;
use tauflow_testing::{Need, skip};

/// Ladders in raw radiance, and the same ladders exposed.
pub const PIPELINE: &str = "\
pipeline: small
seed: 3
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 4, views: [1, 1], regimes: [L0], contexts: [open] }
  ladders:
    kind: ladder_rendering
    inputs: { scenes: scenes }
    params: { rungs: { dyadic: 16 }, resolution: [16, 16] }
  gate:
    kind: quality_gate
    inputs: { scenes: scenes, previews: ladders }
  packed:
    kind: dataset_packing
    inputs: { ladders: ladders, exposure: gate.exposure }
  filtered:
    kind: guided_filter
    inputs: { endpoints: packed }
    params: { from: 4, conditioning: rgb, demodulate: false, radius: 0 }
";

/// Values and metadata of an image of each item of an export.
fn exported(place: &Place, folder: &str, file: &str) -> BTreeMap<String, (Vec<f32>, Value)> {
    let entries = fs::read_dir(place.path(folder)).expect("exported").filter_map(Result::ok);
    let items = entries.filter(|entry| entry.path().join(file).exists());
    let read = |entry: fs::DirEntry| {
        let image = read_exr(&entry.path().join(file)).expect("a picture").remove("").expect("unnamed");
        let meta = fs::read(entry.path().join("meta.json")).expect("metadata");
        let meta = serde_json::from_slice(&meta).expect("JSON");
        (entry.file_name().to_string_lossy().into_owned(), (image.data().to_vec(), meta))
    };
    items.map(read).collect()
}

#[test]
fn raw_undoes_the_exposure_and_metadata_names_space_and_factor() {
    let place = Place::with(PIPELINE);
    place.tauflow(&["run", "small.yaml", "--target", "filtered", "--target", "ladders"]).ends(0);
    let export = |node: &str, folder: &str, more: &[&str], file: &str| {
        place.tauflow(&[&["export", "small.yaml", node, "-o", folder], more].concat()).ends(0);
        exported(&place, folder, file)
    };
    let rung = "spp-000004.exr";
    let ladders = export("ladders", "ladders", &[], rung);
    for (node, file) in [("packed", rung), ("filtered", "guided_filter-4-to-16-nfe-1.exr")] {
        let exposed = export(node, &format!("{node}_exposed"), &[], file);
        let raw = export(node, &format!("{node}_raw"), &["--raw"], file);
        assert!(!exposed.is_empty() && exposed.keys().eq(raw.keys()), "{node}: the gate accepts a scene");
        for (item, (values, meta)) in &exposed {
            let factor = meta["exposure"].as_f64().expect("a factor");
            assert!(meta["space"] == "exposed_radiance" && (factor - 1.0).abs() > 1e-3, "{node}/{item}: {meta}");
            assert_eq!(meta["scene_exposure"], meta["exposure"], "{node}/{item}");
            let (undone, of_raw) = &raw[item];
            assert_eq!((&of_raw["space"], &of_raw["exposure"]), (&"raw_radiance".into(), &1.0.into()));
            assert_eq!(of_raw["scene_exposure"], meta["exposure"], "{node}/{item}");
            // The ladder's own radiance, but for rounding.
            let (own, of_ladder) = &ladders[item];
            assert_eq!((&of_ladder["space"], &of_ladder["exposure"]), (&"raw_radiance".into(), &1.0.into()));
            assert!(of_ladder.get("scene_exposure").is_none(), "nobody told the ladder of it: {of_ladder}");
            assert!(own.iter().any(|value| *value > 0.0) && own.len() == undone.len());
            for ((own, undone), exposed) in own.iter().zip(undone).zip(values) {
                assert!((own - undone).abs() <= 1e-5 * own.abs(), "{node}/{item}: {own} {undone}");
                let expected = (f64::from(*own) * factor) as f32;
                assert!((expected - exposed).abs() <= 1e-5 * expected.abs(), "{node}/{item}: {expected} {exposed}");
            }
        }
    }
}

#[test]
fn a_manifest_stays_unless_an_export_of_folders_replaces_it() {
    let place = Place::with(PIPELINE);
    place.tauflow(&["run", "small.yaml", "--target", "ladders"]).ends(0);
    fs::create_dir(place.path("exported")).expect("writable");
    place.write("exported/manifest.json", "theirs");
    let manifest = || fs::read_to_string(place.path("exported/manifest.json")).unwrap_or_default();
    let export =
        |node: &str, more: &[&str]| place.tauflow(&[&["export", "small.yaml", node, "-o", "exported"], more].concat());
    for format in ["npz", "safetensors", "webdataset", "oidn", "csv", "parquet", "noisebase"] {
        export("ladders", &["--format", format, "--samples", "1"]).ends(0);
        assert_eq!(manifest(), "theirs", "{format}");
    }
    // Scenes have no rungs, and no item has this key.
    export("scenes", &["--format", "oidn"]).ends(2);
    export("ladders", &["--item", "none"]).ends(2);
    assert_eq!(manifest(), "theirs");
    export("ladders", &[]).ends(0);
    assert!(manifest().contains("tauflow/ladder"), "{}", manifest());
}

/// A renderer that copies an image, once the scene's exposure is known.
const THEIRS: &str = "
  theirs:
    kind: external_renderer
    inputs: { scenes: scenes, after: gate.exposure }
    params:
      required: true
      counts: { dyadic: 1 }
      resolution: [16, 16]
      command: [sh, -c, 'cp HERE/one.exr \"$1/$3.exr\"', sh, \"{folder}\", \"{scene}\", \"{counts}\"]
";

#[test]
fn images_of_another_renderer_are_raw_radiance() {
    let place = Place::new();
    let here = place.path("").display().to_string();
    place.write("small.yaml", &format!("{PIPELINE}{}", THEIRS.replace("HERE", here.trim_end_matches('/'))));
    let image = tauflow_data::Image::new(16, 16, 3).map(|_| 0.625);
    tauflow_data::image_io::write_exr(&place.path("one.exr"), &[("", &image)]).expect("writable");
    place.tauflow(&["run", "small.yaml", "--target", "theirs"]).ends(0);
    for more in [&[][..], &["--raw"]] {
        place.tauflow(&[&["export", "small.yaml", "theirs", "-o", "out"], more].concat()).ends(0);
        let items = exported(&place, "out", "mitsuba-1-to-1-nfe-0.exr");
        assert!(!items.is_empty(), "the gate accepts a scene");
        for (values, meta) in items.values() {
            assert_eq!((&meta["space"], &meta["exposure"]), (&"raw_radiance".into(), &1.0.into()), "{meta}");
            assert!(values.iter().all(|value| *value == 0.625));
        }
        fs::remove_dir_all(place.path("out")).expect("exported");
    }
}

#[test]
fn an_item_is_shown_with_its_files_and_verdict() {
    let place = Place::with(PIPELINE);
    let none = place.tauflow(&["show", "small.yaml", "packed", "L0-open-000000"]).ends(2);
    assert!(none.err.contains("must run first"), "{}", none.err);
    place.tauflow(&["run", "small.yaml", "--target", "packed", "--target", "gate.verdicts"]).ends(0);
    let rungs = place.tauflow(&["show", "small.yaml", "ladders", "L0-open-000000"]).ends(0).out;
    for part in [
        "ladders.ladder L0-open-000000",
        "type   tauflow/ladder",
        "file   L0-open-000000/spp-000016.exr",
        "\"counts\"",
        "`gate` ",
        "  contrast ",
        "tauflow export small.yaml ladders -o DIR",
    ] {
        assert!(rungs.contains(part), "`{part}` is not in\n{rungs}");
    }
    assert!(!rungs.contains('\u{1b}'), "no terminal, no colours");
    let verdict = place.tauflow(&["show", "small.yaml", "gate", "L0-open-000000"]).ends(0).out;
    assert!(verdict.contains("gate.verdicts L0-open-000000") && verdict.contains("\"measures\""), "{verdict}");
    let far = place.tauflow(&["show", "small.yaml", "ladders", "nothing"]).ends(2);
    assert!(far.err.contains("it has") && far.err.contains("such as `L0-open-"), "{}", far.err);
    let unknown = place.tauflow(&["show", "small.yaml", "ladders", "L0-open-00000"]).ends(2);
    assert!(
        unknown.err.contains("`ladders` has no item `L0-open-00000`; did you mean `L0-open-00000"),
        "{}",
        unknown.err
    );
}

/// `script` gives the program a terminal.
#[test]
fn an_item_has_a_thumbnail_in_a_terminal_with_colours() {
    let place = Place::with(PIPELINE);
    place.tauflow(&["run", "small.yaml", "--target", "packed"]).ends(0);
    let shown = |variables: &[(&str, &str)]| {
        let program = format!("{} show small.yaml ladders L0-open-000000", env!("CARGO_BIN_EXE_tauflow"));
        let mut command = Command::new("script");
        command.args(["-qec", &program, "/dev/null"]).current_dir(place.path("")).stdin(Stdio::null());
        command.env_remove("NO_COLOR").env_remove("COLORTERM").env("TERM", "xterm-256color");
        let output = command.env("TAUFLOW_CACHE", place.path("store")).envs(variables.iter().copied()).output();
        output.map(|output| String::from_utf8_lossy(&output.stdout).into_owned())
    };
    match shown(&[]) {
        Err(error) => skip(Need::Script, format_args!("`script` does not start: {error}")),
        Ok(few) => {
            // The rung of most samples, of 16 x 16 pixels: eight lines of characters.
            let halves = |text: &str| (text.matches('▀').count(), text.lines().filter(|l| l.contains('▀')).count());
            assert!(few.contains("  L0-open-000000/spp-000016.png\r\n  \u{1b}[38;5;"), "{few}");
            assert_eq!(halves(&few), (16 * 8, 8));
            let all = shown(&[("COLORTERM", "truecolor")]).expect("it started before");
            assert!(all.contains("\u{1b}[38;2;") && halves(&all) == halves(&few), "{all}");
            for quiet in [("NO_COLOR", "1"), ("TERM", "dumb")] {
                let text = shown(&[quiet]).expect("it started before");
                assert!(text.contains("spp-000016.exr") && !text.contains('▀'), "{quiet:?}: {text}");
            }
        }
    }
}
