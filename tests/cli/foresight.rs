//! `check` finds before a run what is sure to fail in it, and files and programs that are not there.

use crate::{Place, root};
use std::fs;
use tauflow::{
    pipeline::{Options, resolve, resolve_text},
    registry::registry,
};

/// Ladders of a training set and a test set, with references, solvers and scores: nothing is wrong.
const STUDY: &str = "\
pipeline: study
nodes:
  scenes: { kind: scene_generation, params: { pool: 8, regimes: [L0], contexts: [open] } }
  previews: { kind: ladder_rendering, inputs: { scenes: scenes }, params: { rungs: [4], resolution: [32, 32] } }
  gate: { kind: quality_gate, inputs: { scenes: scenes, previews: previews } }
  train_ladders:
    kind: ladder_rendering
    inputs: { scenes: gate.accepted }
    params: { rungs: { dyadic: 8 }, resolution: [32, 32] }
  train_set:
    kind: dataset_packing
    inputs: { ladders: train_ladders, exposure: gate.exposure }
  test_ladders:
    kind: ladder_rendering
    inputs: { scenes: gate.accepted }
    params: { rungs: { dyadic: 8 }, resolution: [32, 32], stream: 1 }
  test_set:
    kind: dataset_packing
    inputs: { ladders: test_ladders, gbuffers: test_ladders.gbuffer, exposure: gate.exposure }
  solvers:
    kind: training
    matrix: { parameterization: [mc_noise, mc_velocity] }
    inputs: { train: train_set, test: test_set }
    params: { preset: tiny, steps: 2, conditioning: rgb }
  refined:
    kind: refinement
    matrix: { like: solvers }
    inputs: { endpoints: test_set, model: solvers }
    params: { from: 2, nfe: [1] }
  scores:
    kind: image_metrics
    matrix: { like: refined }
    inputs: { images: refined, references: test_set }
  hold: { kind: image_metrics, inputs: { references: test_set }, params: { from: 2 } }
  evaluation: { kind: evaluation, inputs: { scores: scores, hold: hold } }
  table: { kind: table, inputs: { scores: scores }, params: { rows: [parameterization] } }
";

/// What is wrong with the study after edits: `(before, after)`.
fn told(edits: &[(&str, &str)]) -> String {
    let mut text = STUDY.to_owned();
    for (before, after) in edits {
        assert_eq!(text.matches(before).count(), 1, "`{before}` stands in the study once");
        text = text.replace(before, after);
    }
    match resolve_text("study.yaml", &text, &registry(), &Options::default()) {
        Ok(_) => String::new(),
        // Without the breaks of lines.
        Err(problems) => problems.render(false).replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" "),
    }
}

/// One problem with all these parts.
#[track_caller]
fn one(edits: &[(&str, &str)], parts: &[&str]) {
    let said = told(edits);
    for part in parts.iter().chain(&["1 problem found"]) {
        assert!(said.contains(part), "`{part}` is not in\n{said}");
    }
}

#[test]
fn a_study_that_fits_together_has_no_problems() {
    assert_eq!(told(&[]), "");
}

#[test]
fn rungs_that_do_not_exist_are_named_with_the_nearest() {
    let hint = "use 2 or 4, or add 3 to `rungs` of the ladders";
    let refined = [("params: { from: 2, nfe: [1] }", "params: { from: 3, nfe: [1] }")];
    let said = told(&refined);
    for part in ["study.yaml:29:21", "`test_set` has no rung of 3 samples, only 1, 2, 4, 8", hint] {
        assert!(said.contains(part), "`{part}` is not in\n{said}");
    }
    // A filter that nobody reads is told of, too; its default is named at the node.
    let filter = "  filtered: { kind: guided_filter, inputs: { endpoints: test_set }, params: { from: 16 } }\n  hold:";
    one(&[("  hold:", filter)], &["`test_set` has no rung of 16 samples", "use 8, or add 16"]);
    let ladder = "  measured:
    kind: ladder_metrics
    inputs: { ladders: train_ladders, references: test_ladders }
    params: { rungs: [1, 5] }
  hold:";
    one(&[("  hold:", ladder)], &["`train_ladders` has no rung of 5 samples", "use 4 or 8"]);
    let rungs = [(
        "rungs: { dyadic: 8 }, resolution: [32, 32], stream: 1",
        "rungs: [1, 4, 8], resolution: [32, 32], stream: 1",
    )];
    let said = told(&rungs);
    assert!(said.contains("`test_set` has no rung of 2 samples, only 1, 4, 8"), "{said}");
    // A ladder that goes on until it is accurate may have any rung.
    let open = "rungs: { dyadic: 8 }, resolution: [32, 32], stream: 1, until: { relative_error: 0.1, at_most: 64 }";
    let said =
        told(&[("rungs: { dyadic: 8 }, resolution: [32, 32], stream: 1", open), ("from: 2, nfe", "from: 3, nfe")]);
    assert!(!said.contains("no rung"), "{said}");
}

#[test]
fn an_optional_input_of_which_nothing_is_read_is_a_mistake() {
    let gathered = "  other:
    kind: ladder_rendering
    matrix: { stream: [2, 3] }
    inputs: { scenes: gate.accepted }
    params: { rungs: [1], resolution: [32, 32] }
  packed:
    kind: dataset_packing
    inputs: { ladders: train_ladders, gbuffers: other.gbuffer, exposure: gate.exposure }\n  hold:";
    one(
        &[("  hold:", gathered)],
        &["no item of the input `gbuffers` meets one of `ladders`", "the cell `stream=2`", "`packed`"],
    );
}

#[test]
fn some_ladders_of_a_training_may_end_earlier_if_examples_have_no_count() {
    let with = |rungs: &str, params: &str, test: &str| {
        let short = format!(
            "  short:
    kind: ladder_rendering
    matrix: {{ stream: [5] }}
    inputs: {{ scenes: gate.accepted }}
    params: {{ {rungs} }}
  short_set:
    kind: dataset_packing
    matrix: {{ like: short }}
    inputs: {{ ladders: short, exposure: gate.exposure }}\n  hold:"
        );
        told(&[
            ("[mc_noise, mc_velocity]", "[mc_noise]"),
            ("train: train_set, test: test_set", &format!("train: [short_set, train_set], test: {test}")),
            ("steps: 2, conditioning: rgb", &format!("steps: 2, conditioning: rgb{params}")),
            ("  hold:", &short),
        ])
    };
    let apart = ", unknown_counts: 0.5, independent_targets: true";
    let rungs = "rungs: [1, 2, 4], resolution: [32, 32]";
    assert_eq!(with(rungs, apart, "test_set"), "");
    let said = with(rungs, "", "test_set");
    assert!(said.contains("has the rungs 1, 2, 4, but `train_set` has 1, 2, 4, 8"), "{said}");
    let said = with(rungs, apart, "short_set");
    assert!(said.contains("has the rungs 1, 2, 4, but `train_set` has 1, 2, 4, 8"), "{said}");
    let said = with("rungs: [1, 3], resolution: [32, 32]", apart, "test_set");
    assert!(said.contains("1, 3, but") && said.contains("the first of the other's"), "{said}");
    let said = with("rungs: [1], resolution: [32, 32]", apart, "test_set");
    assert!(said.contains("have one rung, but training needs two"), "{said}");
    // Rungs that are known only after a run may be any.
    let open = "rungs: [1, 2], resolution: [32, 32], until: { relative_error: 0.1, at_most: 64 }";
    assert_eq!(with(open, apart, "test_set"), "");
}

#[test]
fn rungs_and_sizes_that_must_be_equal_are_compared() {
    let rungs = [(
        "rungs: { dyadic: 8 }, resolution: [32, 32], stream: 1",
        "rungs: [1, 2, 8], resolution: [32, 32], stream: 1",
    )];
    one(&rungs, &["study.yaml:23:39", "`test_set` has the rungs 1, 2, 8, but `train_set` has 1, 2, 4, 8"]);
    let references =
        "  more: { kind: ladder_rendering, inputs: { scenes: gate.accepted }, params: { resolution: [64, 32] } }
  measured: { kind: ladder_metrics, inputs: { ladders: train_ladders, references: more } }\n  hold:";
    one(
        &[("  hold:", references)],
        &["the images of `more` have 64 x 32 pixels, but those of `train_ladders` have 32 x 32", "`resolution`"],
    );
    let small = [(
        "rungs: { dyadic: 8 }, resolution: [32, 32], stream: 1",
        "rungs: { dyadic: 8 }, resolution: [8, 8], stream: 1",
    )];
    let said = told(&small);
    assert!(said.contains("SSIM needs at least 11 x 11"), "{said}");
    one(&[("steps: 2, conditioning: rgb", "steps: 2, conditioning: gbuffer")], &["`train_set` has no G-buffers"]);
    let sampler = [("resolution: [32, 32], stream: 1", "resolution: [32, 32], stream: 1, sampler: sobol")];
    one(&sampler, &["the samples of `test_set` are correlated, but those of `train_set` are independent"]);
    one(
        &[("references: test_set }, params: { from: 2 }", "references: test_set }, params: { from: 4 }")],
        &["the start of `scores[parameterization=mc_noise]` has 2 samples, but that of `hold` in `hold` has 4"],
    );
}

#[test]
fn axes_that_do_not_meet_and_several_items_for_one_are_found() {
    one(
        &[("    matrix: { like: refined }\n", "")],
        &[
            "study.yaml:32:44",
            "no item of the input `references` meets one of `images`",
            "the keys of `references` name no cell, those of `images` the cell `parameterization=mc_noise`",
            "add `matrix: { like: refined }` to `scores`",
            "`refined[parameterization=mc_noise]`",
        ],
    );
    let one_node = [
        ("    matrix: { like: solvers }\n", ""),
        ("    matrix: { like: refined }\n", ""),
        ("params: { rows: [parameterization] }", "params: { rows: [method] }"),
    ];
    one(
        &one_node,
        &[
            "the input `model` takes one item, but gets 2, from `solvers[parameterization=mc_noise]`",
            "add `matrix: { like: solvers }` to `refined`",
        ],
    );
    one(&[("hold: hold }", "hold: scores }")], &["the input `hold` takes the scores of one cell, but gets those of 2"]);
    one(
        &[("rows: [parameterization]", "rows: [parametrization]")],
        &["`rows` names the axis `parametrization`, which the scores do not have", "`parameterization`, `spp`"],
    );
    one(
        &[("rows: [parameterization]", "rows: [method]")],
        &["the axis `parameterization` has the values `mc_noise`, `mc_velocity` and is neither in `rows`"],
    );
    let against = "rows: [parameterization], against: { axis: parameterization, value: rf }";
    one(&[("rows: [parameterization]", against)], &["the axis `parameterization` has no value `rf`"]);
    let no_axis = ["which is no axis of the table", "add it to `rows` or `columns`"];
    for (rows, axis, value) in
        [("rows: [parameterization], ", "spp", "2"), ("", "stratum", "L0-open"), ("columns: [spp], ", "nfe", "1")]
    {
        let params = format!("{rows}against: {{ axis: {axis}, value: {value} }}");
        one(&[("rows: [parameterization]", &params)], &no_axis);
    }
    let against = "columns: [spp], against: { axis: spp, value: 4 }";
    one(&[("rows: [parameterization]", against)], &["the axis `spp` has no value `4`", "it has `2`"]);
}

#[test]
fn items_that_a_node_gathers_from_cells_may_meet_items_of_these_cells() {
    let libraries = "kind: scene_generation, matrix: { library: [0, 1] }, params: { pool: 8,";
    let split = "  split: { kind: content_signature_split, inputs: { scenes: gate.accepted } }
  train_ladders:
    kind: ladder_rendering
    inputs: { scenes: split.train }";
    let tables = STUDY.find("  evaluation: ").map(|at| &STUDY[at..]).expect("tables at the end");
    let edits = [
        (tables, ""),
        ("kind: scene_generation, params: { pool: 8,", libraries),
        ("  train_ladders:\n    kind: ladder_rendering\n    inputs: { scenes: gate.accepted }", split),
    ];
    assert_eq!(told(&edits), "");
    // Facts of the items that may meet are known: G-buffers of the cells.
    let gbuffers = [
        ("{ ladders: train_ladders, exposure", "{ ladders: train_ladders, gbuffers: test_ladders.gbuffer, exposure"),
        ("steps: 2, conditioning: rgb", "steps: 2, conditioning: gbuffer"),
    ];
    assert_eq!(told(&[&edits[..], &gbuffers].concat()), "");
    // Joins that are sure to fail are still found: of cells of another axis, and of one more axis before the gathered.
    let other = "  other:
    kind: ladder_rendering
    matrix: { stream: [2, 3] }
    inputs: { scenes: split.train }
    params: { rungs: [1], resolution: [32, 32] }
  solvers:";
    let gathered = [
        ("  solvers:", other),
        ("{ ladders: train_ladders, exposure", "{ ladders: train_ladders, gbuffers: other.gbuffer, exposure"),
    ];
    let said = told(&[&edits[..], &gathered].concat());
    assert!(said.contains("no item of the input `gbuffers` meets one of `ladders`"), "{said}");
    assert!(said.contains("`gbuffers` name the cell `stream=2`, those of `ladders` the cell `library=0`"), "{said}");
    let test = (
        "    inputs: { scenes: gate.accepted }\n    params: { rungs: { dyadic: 8 }, resolution: [32, 32], stream: 1 }",
        "    inputs: { scenes: split.test }\n    params: { rungs: { dyadic: 8 }, resolution: [32, 32], stream: 1 }",
    );
    let axis = [test, ("    matrix: { like: refined }\n", "")];
    let said = told(&[&edits[..], &axis].concat());
    assert!(said.contains("no item of the input `references` meets one of `images`"), "{said}");
}

#[test]
fn the_noise_of_a_reference_needs_its_ladder_and_its_exposure() {
    let scores = "inputs: { images: refined, references: test_set }";
    let ladder = scores.replace("test_set", "test_set, held_out: test_ladders");
    one(&[(scores, &ladder)], &["this needs `exposure`, too, which is not connected", "connect both"]);
    let exposure = scores.replace("test_set", "test_set, exposure: gate.exposure");
    one(&[(scores, &exposure)], &["this needs `held_out`, too, which is not connected", "connect both"]);
    let both = scores.replace("test_set", "test_set, held_out: test_ladders, exposure: gate.exposure");
    assert_eq!(told(&[(scores, &both)]), "");
    // Another ladder than that of the references.
    let other = both.replace("test_ladders", "previews");
    one(&[(scores, &other)], &["the last rung of `previews` has 4 samples, but that of `test_set` has 8"]);
}

#[test]
fn crops_models_and_stops_that_cannot_be_are_found() {
    let small = [("preset: tiny, steps: 2", "preset: best, crop: 8, steps: 2")];
    one(&small, &["a crop of 8 pixels is below the minimum of `best`, 16"]);
    let films = [
        ("preset: tiny, steps: 2", "preset: best, steps: 2"),
        ("resolution: [32, 32] }\n  train_set:", "resolution: [8, 32] }\n  train_set:"),
    ];
    let said = told(&films);
    assert!(said.contains("8 x 32 pixels, but the preset `best` needs at least 16 x 16"), "{said}");
    let clean = |inputs: &str, params: &str| {
        let node = format!(
            "  clean: {{ kind: denoising, inputs: {{ endpoints: test_set{inputs} }}, params: {{ {params} }} }}\n  hold:"
        );
        told(&[("  hold:", &node)])
    };
    let model = |cell: &str| format!(", model: \"solvers[parameterization={cell}]\"");
    assert_eq!(clean("", "weights: fast"), "");
    assert_eq!(clean(&model("mc_noise"), "weights: connected, conditioning: rgb"), "");
    let said = clean(&model("mc_noise"), "weights: fast");
    assert!(said.contains("a model is connected, but `weights` names a bundled one"), "{said}");
    let said = clean("", "weights: connected");
    assert!(said.contains("`weights: connected` needs a model on the input `model`"), "{said}");
    let said = clean(&model("mc_velocity"), "weights: connected, conditioning: rgb");
    assert!(
        said.contains("has the parameterization `mc_velocity`") && said.contains("a model of `mc_noise`"),
        "{said}"
    );
    let bridge = |rungs: &str| {
        let nodes = format!(
            "  steps: {{ kind: ladder_rendering, inputs: {{ scenes: gate.accepted }}, params: {{ rungs: {rungs}, \
             resolution: [32, 32] }} }}
  steps_set: {{ kind: dataset_packing, inputs: {{ ladders: steps, exposure: gate.exposure }} }}
  bridge:
    kind: bridge_refinement
    inputs:
      endpoints: steps_set
      mc_noise: \"solvers[parameterization=mc_noise]\"
      local_velocity: \"solvers[parameterization=local_velocity]\"\n  hold:"
        );
        told(&[("[mc_noise, mc_velocity]", "[mc_noise, local_velocity]"), ("  hold:", &nodes)])
    };
    assert_eq!(bridge("[5, 6, 7]"), "");
    let said = bridge("[6, 7, 8]");
    assert!(said.contains("the stops 6 to 8 of `steps_set` are outside the ladder of"), "{said}");
}

#[test]
fn nodes_whose_items_have_the_same_keys_cannot_share_an_input() {
    let other = "  filtered: { kind: guided_filter, inputs: { endpoints: test_set }, params: { from: 2 } }
  filter_scores: { kind: image_metrics, inputs: { images: filtered, references: test_set } }
  both: { kind: table, inputs: { scores: [hold, filter_scores] } }\n  hold:";
    one(
        &[("  hold:", other)],
        &[
            "`hold` and `filter_scores` have items of the same keys, and cannot both be on the input `scores`",
            "give each of these nodes a matrix axis",
        ],
    );
    // Axes tell them apart, and so do other items.
    let apart = other
        .replace("filtered: { kind: guided_filter,", "filtered: { kind: guided_filter, matrix: { spatial: [3.0] },");
    let apart = apart.replace("image_metrics, inputs", "image_metrics, matrix: { like: filtered }, inputs");
    assert_eq!(told(&[("  hold:", &apart)]), "");
}

#[test]
fn a_run_of_what_is_sure_to_fail_does_not_begin() {
    let place = Place::with(&STUDY.replace("params: { from: 2, nfe", "params: { from: 3, nfe"));
    let said = place.tauflow(&["run", "small.yaml"]).ends(2);
    assert!(said.err.contains("`test_set` has no rung of 3 samples"), "{}", said.err);
    assert!(!place.path("store").exists(), "nothing was begun");
}

/// Scenes of two files, and assets that no target needs.
const SOURCES: &str = "\
pipeline: small
targets: [own]
values: { room: rooms/room.xml }
nodes:
  own:
    kind: scene_files
    params:
      scenes:
        - { path: $room, stratum: L1-enclosed }
        - { path: rooms/hall.xml, stratum: L1-enclosed }
  assets:
    kind: assets
    params: { folders: [none/] }
";

#[test]
fn missing_files_of_the_sources_that_are_needed_are_named() {
    let place = Place::with(SOURCES);
    let said = place.tauflow(&["check", "small.yaml"]).ends(2);
    for part in ["nothing fits `rooms/room.xml`", "small.yaml:9:19", "`$room`", "mend the path"] {
        assert!(said.err.contains(part), "`{part}` is not in\n{}", said.err);
    }
    fs::create_dir(place.path("rooms")).expect("writable");
    place.write("rooms/room.xml", "<scene version=\"3.0.0\"/>");
    let said = place.tauflow(&["check", "small.yaml"]).ends(2);
    for part in ["nothing fits `rooms/hall.xml`", "small.yaml:10:19"] {
        assert!(said.err.contains(part), "`{part}` is not in\n{}", said.err);
    }
    place.write("rooms/hall.xml", "<scene version=\"3.0.0\"/>");
    place.tauflow(&["check", "small.yaml"]).ends(0);
    let said = place.tauflow(&["check", "small.yaml", "--target", "assets"]).ends(2);
    for part in ["`none/` is no folder here", "small.yaml:13:25", "--set 'assets.folders="] {
        assert!(said.err.contains(part), "`{part}` is not in\n{}", said.err);
    }
    // A graph reads no file.
    place.tauflow(&["graph", "small.yaml", "--target", "assets"]).ends(0);
}

#[test]
fn missing_blobs_of_a_described_scene_are_named() {
    let own = "    kind: scene_files\n    params: { scenes: [{ path: room, stratum: kitchens }] }\n";
    let place = Place::with(&format!("pipeline: small\nnodes:\n  own:\n{own}"));
    let blob = "1".repeat(64) + "-100";
    let scene = serde_json::json!({
        "version": 1, "seed": 1, "max_depth": 4,
        "camera": { "origin": [0, 0, 4], "target": [0, 0, 0], "up": [0, 1, 0], "fov_x": 40, "near": 0 },
        "shapes": [{ "geometry": { "type": "mesh", "mesh": blob }, "material": 0,
            "to_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]] }],
        "materials": [{ "type": "diffuse", "reflectance": { "type": "constant", "value": [0.5, 0.5, 0.5] } }],
        "emitters": [{ "type": "constant", "radiance": [1, 1, 1] }],
    });
    fs::create_dir(place.path("room")).expect("writable");
    place.write("room/scene.json", &scene.to_string());
    let said = place.tauflow(&["check", "small.yaml"]).ends(2);
    for part in [&format!("needs `blob/{blob}`"), "small.yaml:5:", "export the scene again"] {
        assert!(said.err.contains(part), "`{part}` is not in\n{}", said.err);
    }
    place.tauflow(&["check", "small.yaml", "--set", "own.leave_out=true"]).ends(0);
}

/// Programs of three kinds.
const PROGRAMS: &str = "\
pipeline: small
nodes:
  scenes: { kind: scene_generation, params: { pool: 1, regimes: [L0], contexts: [open] } }
  step:
    kind: command
    inputs: { scenes: scenes }
    params:
      run: [sh, steps/step.sh]
      inputs: { scenes: tauflow/scene }
      outputs: { files: tauflow/files }
      depends: [models/*.pt]
  rendered:
    kind: external_renderer
    inputs: { scenes: scenes }
    params: { command: [no-such-renderer, '{scene}', '{counts}', '{folder}'], required: true }
  maybe:
    kind: external_renderer
    inputs: { scenes: scenes }
    params: { command: [no-such-renderer-either, '{scene}', '{counts}', '{folder}'] }
";

#[test]
fn missing_programs_scripts_and_dependencies_are_named() {
    let place = Place::with(PROGRAMS);
    let said = place.tauflow(&["check", "small.yaml"]).ends(2);
    for part in [
        "there is no file `steps/step.sh` here",
        "small.yaml:8:17",
        "`models/*.pt`, which matches no file",
        "small.yaml:11:17",
        "there is no program `no-such-renderer` here",
        "small.yaml:15:25",
        "3 problems found",
    ] {
        assert!(said.err.contains(part), "`{part}` is not in\n{}", said.err);
    }
    assert!(!said.err.contains("either"), "a program that may be missing is no problem: {}", said.err);
}

#[test]
fn the_shipped_pipelines_check_but_for_assets_of_ones_own() {
    for file in crate::files("pipelines", "yaml") {
        let path = file.to_string_lossy().into_owned();
        resolve(&file, &registry(), &Options::default()).unwrap_or_else(|e| panic!("{path}: {e}"));
        let place = Place::new();
        // Relative paths start at the root of a checkout.
        let mut command = place.command(&["check", &path]);
        let said = crate::Said::of(&command.current_dir(root()).output().expect("the program starts"));
        let text = fs::read_to_string(&file).expect("a pipeline");
        let own = ["folders: [assets/]", "assets: [assets/]"].iter().any(|folder| text.contains(folder));
        if text.contains("required: true") && std::env::var_os("TAUFLOW_OIDN").is_none() {
            let said = said.ends(2);
            assert!(said.err.contains("there is no Open Image Denoise library here"), "{}", said.err);
        } else if own && !root().join("assets").is_dir() {
            let said = said.ends(2);
            for part in ["`assets/` is no folder here", "--set 'assets.folders=[path/to/assets]'", "1 problem found"] {
                assert!(said.err.contains(part), "`{part}` is not in\n{}", said.err);
            }
        } else {
            said.ends(0);
        }
    }
}
