//! Files of models and checkpoints are what the manual of `training` says, by its own tables. Where TAUFLOW_PYTHON
//! names a Python with torch and safetensors, its lines of PyTorch read them, and `benches/pytorch/model.py` predicts
//! what we do.

#[expect(dead_code, reason = "other tests use the rest")]
mod toy;

use serde_json::{Value, json};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    process::Command,
    sync::{Mutex, atomic::AtomicBool},
};
use tauflow_contract::{Action, Artifact, Blobs, Context, Digest, Kind, KindError, MemoKey, MemoryBlobs, Silent};
use tauflow_data::{Image, TensorFile};
use tauflow_testing::{Need, set, skip};
use tauflow_train::{Denoiser, Model, Place, Training, TrainingParams};

/// The pages that describe the files of a training.
const PAGES: [&str; 2] =
    [include_str!("../../../docs/formats/model.md"), include_str!("../../../docs/formats/checkpoint.md")];
const COUNTS: [u64; 5] = [1, 2, 4, 8, 16];
/// Of the made-up image, as in the script. They are no multiples of 8, so that edges are continued.
const HEIGHT: usize = 12;
const WIDTH: usize = 20;
const TIMES: [f64; 2] = [0.0, 0.4];

/// The cells of the pages' table that begins with this column, without backquotes.
fn table(column: &str) -> Vec<Vec<String>> {
    let heading = format!("| {column} |");
    let cells = |line: &str| line.trim_matches('|').split('|').map(|cell| cell.trim().replace('`', "")).collect();
    let rows: Vec<Vec<String>> = PAGES
        .iter()
        .flat_map(|page| page.lines())
        .skip_while(|line| !line.starts_with(&heading))
        .take_while(|line| line.starts_with('|'))
        .skip(2)
        .map(cells)
        .collect();
    assert!(!rows.is_empty(), "the pages have a table of {column}s");
    rows
}

/// The matrices of a model with this note, according to the pages' tables.
fn matrices(info: &Value) -> BTreeMap<String, Vec<usize>> {
    let text = |name: &str| info[name].as_str().unwrap_or("means");
    let presets = table("preset");
    let preset = presets.iter().find(|row| row[0] == text("preset")).expect("a preset of the page");
    let numbers = |cell: &String| cell.split(", ").map(|n| n.parse().expect("a number")).collect::<Vec<usize>>();
    let (widths, plan) = (numbers(&preset[1]), preset[2..5].iter().flat_map(numbers).collect::<Vec<_>>());
    let [blocks, convolutions, embedding] = plan[..] else { panic!("{preset:?}") };
    let weights: usize = numbers(&preset[5]).into_iter().map(|side| side * side).sum();
    let value = |symbol: &str, level: usize| match symbol {
        "C" => {
            let row = if text("conditioning") == "gbuffer" { 1 } else { 2 };
            let plain = info["features"] == "plain";
            let channels = table("input channels");
            let features = channels.iter().find(|row| (row[0] == "plain") == plain).expect("features of the page");
            features[row].parse().expect("a number")
        }
        "N" => {
            if text("output") == "values" {
                3
            } else {
                weights
            }
        }
        "S" => 2 * numbers(&preset[5]).len(),
        "E" => embedding,
        "Wi" => widths[level],
        "Wj" => widths[level + 1],
        "Wm" => widths[widths.len() - 1],
        _ => match symbol.strip_prefix('W') {
            Some(level) => widths[level.parse::<usize>().expect("a resolution")],
            None => symbol.parse().expect("a number"),
        },
    };
    let mut found = BTreeMap::new();
    let has = |layer: &str| match layer {
        "shade" => ["shaded_means", "guided_means", "smoothed_means", "fitted_means"].contains(&text("output")),
        "fits" | "blend" => text("output") == "fitted_means",
        "guide" => ["guided_means", "smoothed_means", "fitted_means"].contains(&text("output")),
        "smooth" => ["smoothed_means", "fitted_means"].contains(&text("output")),
        _ => true,
    };
    for row in table("layer").iter().filter(|row| has(&row[0])) {
        let places: BTreeSet<(usize, usize, usize)> = (0..(widths.len() - 1) * blocks * convolutions)
            .map(|n| (n / (blocks * convolutions), n / convolutions % blocks, n % convolutions))
            .collect();
        for (level, block, step) in places {
            let part = |part: &str| match part {
                "i" => level.to_string(),
                "b" => block.to_string(),
                "s" => step.to_string(),
                part => part.to_owned(),
            };
            let name = row[0].split('.').map(part).collect::<Vec<_>>().join(".");
            let size = |product: &str| product.split_whitespace().map(|symbol| value(symbol, level)).product();
            let shape: Vec<usize> = row[1].trim_matches(['[', ']']).split(',').map(size).collect();
            found.insert(format!("{name}.bias"), vec![1, shape[1]]);
            found.insert(format!("{name}.kernel"), shape);
        }
    }
    found
}

fn shapes(file: &TensorFile) -> BTreeMap<String, Vec<usize>> {
    file.tensors.iter().map(|(name, tensor)| (name.clone(), tensor.shape.clone())).collect()
}

/// The note of a model, after comparing its file with the page.
fn checked(bytes: &[u8]) -> (TensorFile, Value) {
    let file = TensorFile::from_bytes(bytes).expect("safetensors of f32");
    assert_eq!(file.metadata.keys().collect::<Vec<_>>(), ["model"]);
    let info: Value = serde_json::from_str(&file.metadata["model"]).expect("JSON");
    let fields = table("field").into_iter().flat_map(|row| row[0].split(", ").map(str::to_owned).collect::<Vec<_>>());
    let optional = |name: &String| {
        ["output", "unknown_counts", "features", "law", "exponent", "sampler"].contains(&name.as_str())
            && info.get(name).is_none()
    };
    let found: BTreeSet<String> = info.as_object().expect("fields").keys().cloned().collect();
    assert_eq!(found, fields.filter(|name| !optional(name)).collect());
    for (field, value) in [("output", "means"), ("features", "contrast"), ("law", "limits")] {
        assert_ne!(info.get(field), Some(&json!(value)), "it is absent then");
    }
    let means = info.get("output") != Some(&json!("values"));
    let velocity = ["local_velocity", "vanilla_rf"].map(Value::from).contains(&info["parameterization"]);
    if !(means && velocity) {
        assert_eq!(info.get("law"), None, "it changes nothing then");
    }
    assert_eq!(shapes(&file), matrices(&info));
    // The one key of the header that is no tensor, as other programs see it.
    let length = u64::from_le_bytes(bytes[..8].try_into().expect("eight bytes")) as usize;
    let header: Value = serde_json::from_slice(&bytes[8..8 + length]).expect("a header");
    let notes = header["__metadata__"].as_object().expect("notes");
    let inner: Value = serde_json::from_str(notes["tauflow"].as_str().expect("text")).expect("JSON");
    assert_eq!((notes.len(), inner), (1, json!({ "model": file.metadata["model"] })));
    (file, info)
}

/// Blobs in memory, and which of them are checkpoints.
#[derive(Default)]
struct Kept(MemoryBlobs, Mutex<Vec<Artifact>>);

impl Blobs for Kept {
    fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, KindError> {
        self.0.get(digest)
    }

    fn put(&self, bytes: &[u8]) -> Result<Digest, KindError> {
        self.0.put(bytes)
    }

    fn memo_get(&self, key: &MemoKey) -> Option<Artifact> {
        self.0.memo_get(key)
    }

    fn memo_put(&self, key: &MemoKey, artifact: &Artifact) -> Result<(), KindError> {
        assert_eq!(key.name(), "training/checkpoint");
        self.1.lock().expect("no holder panics").push(artifact.clone());
        self.0.memo_put(key, artifact)
    }
}

/// The model of a short training, and its last checkpoint.
fn trained(params: Value) -> (Vec<u8>, Vec<u8>) {
    let mut all = json!({ "steps": 6, "batch": 2, "warmup": 1, "learning_rate": 5e-3, "checkpoint_every": 3 });
    all.as_object_mut().expect("fields").extend(params.as_object().expect("fields").clone());
    let params: TrainingParams = serde_json::from_value(all).expect("params");
    let (blobs, cancel) = (Kept::default(), AtomicBool::new(false));
    let scenes = toy::collection(&blobs.0, 0..2, 16, &COUNTS);
    let ctx = Context::new(&blobs, &Silent, &cancel);
    let all = BTreeMap::from([("train", &scenes)]);
    let outputs =
        Training::run(&ctx, &Action { params, item: None, group: "main", seed: 11, each: BTreeMap::new(), all })
            .expect("trains");
    let model = ctx.part(outputs.collections["model"].get("model").expect("one item"), "").expect("stored");
    let checkpoint = blobs.1.lock().expect("no holder panics").last().cloned().expect("one every three steps");
    (model, ctx.part(&checkpoint, "").expect("stored"))
}

/// The same as `numbers` of the script.
fn made_up(size: usize, salt: usize) -> Vec<f64> {
    (0..size).map(|i| ((i * 7919 + salt * 104_729) % 2003) as f64 / 1001.5 - 1.0).collect()
}

/// The same file with numbers none of which is near zero for want of training.
fn filled(mut file: TensorFile) -> Vec<u8> {
    for (salt, (name, tensor)) in file.tensors.iter_mut().enumerate() {
        let scale = if name.ends_with("bias") { 0.1 } else { 1.5 / (tensor.shape[0] as f64).sqrt() };
        // Strengths of guides act sixteenfold.
        let scale = if name.starts_with("guide") { scale / 16.0 } else { scale };
        tensor.data = made_up(tensor.data.len(), salt).into_iter().map(|v| (v * scale) as f32).collect();
    }
    file.to_bytes().expect("consistent")
}

/// A model file of the manual's matrices, nothing of which any training has made.
fn constructed(info: &Value) -> Vec<u8> {
    let file = matrices(info)
        .iter()
        .fold(TensorFile::default(), |file, (name, shape)| file.with(name, shape, vec![0.0; shape.iter().product()]));
    filled(file.note("model", info.to_string()))
}

/// What we predict of the made-up image at both times.
fn predictions(bytes: &[u8]) -> Vec<Vec<f32>> {
    let model = Model::load_to(bytes, &Place::cpu()).expect("as the manual says");
    assert!(model.to_bytes().expect("writes") == bytes);
    let image = |channels, data: Vec<f64>| {
        Image::from_data(WIDTH, HEIGHT, channels, data.into_iter().map(|v| v as f32).collect()).expect("fits")
    };
    let light = made_up(3 * WIDTH * HEIGHT, 2001).into_iter().map(|v| (1.0 + v) * (1.0 + v) - 0.1);
    let state = image(3, light.collect());
    let gbuffer = image(6, made_up(6 * WIDTH * HEIGHT, 2002));
    let predict = |tau| model.predict(&state, Some(&gbuffer), tau).expect("fits").data().to_vec();
    times(model.info().unknown_counts).map(predict).collect()
}

/// The times that are predicted at; none for an unknown count.
fn times(unknown_counts: bool) -> impl Iterator<Item = Option<f64>> {
    TIMES.map(Some).into_iter().chain(unknown_counts.then_some(None))
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("pytorch").join(name);
    fs::create_dir_all(&folder).expect("a folder for files");
    folder
}

/// What a Python that was asked for prints; none where none was.
fn python(folder: &Path, args: &[&str]) -> Option<Value> {
    let Some(python) = set("TAUFLOW_PYTHON") else {
        skip(Need::Torch, "TAUFLOW_PYTHON names no Python with torch and safetensors");
        return None;
    };
    let done = Command::new(&python).args(args).current_dir(folder).output().expect("TAUFLOW_PYTHON starts");
    assert!(done.status.success(), "{python:?}: {}", String::from_utf8_lossy(&done.stderr));
    Some(serde_json::from_slice(&done.stdout).expect("JSON"))
}

/// Holds our predictions against the script's, by the largest.
fn compare(name: &str, bytes: &[u8]) {
    compare_with(name, bytes, bytes);
}

/// The same, where the script reads another file of the model.
fn compare_with(name: &str, bytes: &[u8], file: &[u8]) {
    let ours = predictions(bytes);
    let folder = folder(name);
    fs::write(folder.join("model.safetensors"), file).expect("writes");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../benches/pytorch/model.py");
    let Some(theirs) = python(&folder, &[script.to_str().expect("plain"), "model.safetensors"]) else { return };
    assert_eq!(theirs["model"], checked(bytes).1);
    let theirs: Vec<Vec<f64>> = serde_json::from_value(theirs["predictions"].clone()).expect("numbers");
    assert_eq!(theirs.len(), ours.len());
    for ((ours, theirs), tau) in ours.iter().zip(&theirs).zip(times(true)) {
        assert_eq!(ours.len(), theirs.len());
        let largest = theirs.iter().fold(0.0f64, |most, v| most.max(v.abs()));
        let apart = ours.iter().zip(theirs).fold(0.0f64, |most, (a, b)| most.max((f64::from(*a) - b).abs()));
        println!("{name}, tau {tau:?}: {apart:.1e} apart, the largest prediction {largest:.3}");
        assert!(largest > 0.01 && apart < 1e-5 * largest, "{name}, tau {tau:?}: {apart} of {largest}");
    }
}

#[test]
fn model_files_are_what_the_manual_says_and_pytorch_predicts_the_same() {
    let cases = [
        ("rgb", json!({})),
        ("gbuffer", json!({ "conditioning": "gbuffer", "parameterization": "mc_velocity", "space": "log1p" })),
        (
            "shaded",
            json!({ "conditioning": "gbuffer", "output": "shaded_means", "parameterization": "local_velocity" }),
        ),
        (
            "local",
            json!({ "conditioning": "gbuffer", "output": "shaded_means", "space": "log1p", "preset": "fast",
                "parameterization": "mc_noise", "unknown_counts": 0.5 }),
        ),
        (
            "covered",
            json!({ "conditioning": "gbuffer", "output": "shaded_means", "space": "log1p", "preset": "fast",
                "parameterization": "mc_noise", "features": "covered", "loss": "tonal" }),
        ),
        (
            "guided",
            json!({ "conditioning": "gbuffer", "output": "guided_means", "space": "log1p", "preset": "fast",
                "parameterization": "mc_noise", "features": "covered", "loss": "preview" }),
        ),
        (
            "smoothed",
            json!({ "conditioning": "gbuffer", "output": "smoothed_means", "space": "log1p", "preset": "fast",
                "parameterization": "mc_noise", "features": "covered", "loss": "preview" }),
        ),
        (
            "fitted",
            json!({ "conditioning": "gbuffer", "output": "fitted_means", "space": "log1p", "preset": "fast",
                "parameterization": "mc_noise", "features": "covered", "loss": "unbiased_preview" }),
        ),
        ("values", json!({ "output": "values", "parameterization": "vanilla_rf" })),
        ("plain", json!({ "output": "values", "features": "plain", "conditioning": "gbuffer" })),
        (
            "plain-log",
            json!({ "features": "plain", "space": "log1p", "preset": "fast", "parameterization": "vanilla_rf",
            "law": "covariances" }),
        ),
        ("local-law", json!({ "parameterization": "local_velocity", "law": "covariances" })),
        ("vanilla-limits", json!({ "parameterization": "vanilla_rf" })),
    ];
    for (name, params) in cases {
        let (bytes, checkpoint) = trained(params.clone());
        let (file, info) = checked(&bytes);
        for (param, value) in params.as_object().expect("fields") {
            if param != "loss" {
                assert_eq!(info[param], if param == "unknown_counts" { json!(true) } else { value.clone() });
            }
        }
        assert_eq!((&info["counts"], &info["steps"]), (&json!(COUNTS), &json!(6)));
        if name == "vanilla-limits" {
            assert_eq!(info["law"], json!("covariances"), "the default");
            let mut old: Value = info.clone();
            old.as_object_mut().expect("fields").remove("law");
            let old = TensorFile { metadata: [("model".to_owned(), old.to_string())].into(), ..file.clone() };
            // Files of earlier versions lack the field, and keep their factor.
            let old = Model::load_to(&filled(old), &Place::cpu()).expect("as the manual says");
            let old = old.to_bytes().expect("writes");
            assert_eq!(checked(&old).1.get("law"), None);
            compare("vanilla-old", &old);
        }
        compare(&format!("{name}-trained"), &bytes);
        compare_with(&format!("{name}-checkpoint"), &bytes, &checkpoint);
        compare(&format!("{name}-filled"), &filled(file));
    }
}

#[test]
fn files_made_by_the_manual_alone_are_read() {
    let names = |kind: &str| table(kind).into_iter().map(|row| row[0].clone()).collect::<Vec<_>>();
    for (preset, conditioning) in names("preset").iter().zip(["rgb", "gbuffer", "gbuffer"].iter().cycle()) {
        let info = json!({ "parameterization": "vanilla_rf", "conditioning": conditioning, "preset": preset,
            "space": "linear", "counts": [2, 32], "steps": 1 });
        // Fields are written in an order of their own.
        let model = Model::load_to(&constructed(&info), &Place::cpu()).expect("as the manual says");
        let bytes = model.to_bytes().expect("writes");
        checked(&bytes);
        compare(preset, &bytes);
    }
}

#[test]
fn pytorch_follows_a_fitted_clock() {
    for parameterization in ["mc_noise", "mc_velocity", "local_velocity", "vanilla_rf"] {
        let mut info = json!({ "parameterization": parameterization, "conditioning": "rgb", "preset": "tiny",
            "space": "linear", "counts": [2, 4, 32], "steps": 1, "law": "covariances", "exponent": 0.7,
            "sampler": "sobol" });
        if parameterization.starts_with("mc_") {
            info.as_object_mut().expect("fields").remove("law");
        }
        let model = Model::load_to(&constructed(&info), &Place::cpu()).expect("as the manual says");
        let bytes = model.to_bytes().expect("writes");
        assert_eq!((&checked(&bytes).1["exponent"], &checked(&bytes).1["sampler"]), (&json!(0.7), &json!("sobol")));
        compare(&format!("fitted-{parameterization}"), &bytes);
    }
}

#[test]
fn checkpoints_are_what_the_manual_says() {
    let (model, checkpoint) = trained(json!({ "conditioning": "gbuffer" }));
    let (model, info) = checked(&model);
    let file = TensorFile::from_bytes(&checkpoint).expect("safetensors of f32");
    let prefixes: Vec<String> = table("prefix").into_iter().map(|row| row[0].clone()).collect();
    let expected = prefixes
        .iter()
        .flat_map(|prefix| matrices(&info).into_iter().map(move |(name, shape)| (format!("{prefix}{name}"), shape)));
    assert_eq!(shapes(&file), expected.collect());
    assert_eq!(file.metadata.keys().collect::<Vec<_>>(), ["model", "record", "step"]);
    assert_eq!(serde_json::from_str::<Value>(&file.metadata["model"]).expect("JSON"), info, "after as many steps");
    assert_eq!(file.metadata["step"], "6");
    let record: Value = serde_json::from_str(&file.metadata["record"]).expect("JSON");
    let fields: BTreeSet<&str> = record.as_object().expect("fields").keys().map(String::as_str).collect();
    assert_eq!(fields, ["count", "loss", "norm", "points"].into());
    assert_eq!((record["count"].as_u64(), record["points"].as_array().map(Vec::len)), (Some(6), Some(1)));
    for (name, tensor) in &model.tensors {
        assert_eq!(tensor, &file.tensors[&format!("average.{name}")], "the model is of averages");
    }
    assert_ne!(model.tensors["head.kernel"], file.tensors["weights.head.kernel"]);
    assert!(file.tensors["second.head.kernel"].data.iter().any(|v| *v > 0.0));
}

#[test]
fn the_lines_of_pytorch_on_the_page_load_a_model() {
    let (_, code) = PAGES[0].split_once("```python\n").expect("the page has lines of PyTorch");
    let (code, _) = code.split_once("```").expect("they end");
    assert_eq!(code.lines().count(), 3);
    let (bytes, _) = trained(json!({ "conditioning": "gbuffer" }));
    let (file, _) = checked(&bytes);
    let folder = folder("manual");
    fs::write(folder.join("model.safetensors"), &bytes).expect("writes");
    // [O, C, row, column] of the kernel's [row, column, C, O].
    let told = "import json; found = {name: list(w.shape) for name, w in weights.items()}\n\
                print(json.dumps([found, list(stem.shape), stem[1, 2, 0, 1].item()]))";
    let Some(found) = python(&folder, &["-c", &format!("{code}{told}")]) else { return };
    assert_eq!(found[0], json!(shapes(&file)));
    assert_eq!(found[1], json!([32, 60, 3, 3]));
    let expected = file.tensors["stem.kernel"].data[(60 + 2) * 32 + 1];
    assert_eq!(found[2].as_f64().map(|v| v as f32), Some(expected));
}
