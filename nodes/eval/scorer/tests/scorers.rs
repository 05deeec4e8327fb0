//! The kind `no_reference_scores`, with a small program and a tiny ONNX model.
//!
//! The model itself runs where TAUFLOW_ONNXRUNTIME names ONNX Runtime's library.

use std::{
    collections::BTreeMap,
    fs,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};
use tauflow_contract::{
    Act, Action, Collection, Context, Digest, Handle, ItemKey, Kind, KindError, Media, MemoryBlobs, Silent,
};
use tauflow_data::{
    Image,
    image_io::encode_png,
    methods::MethodName,
    records::{Better, Family, Generated, GeneratedVariant, SampleScores, Variant},
};
use tauflow_scorer::{NoReferenceScores, NoReferenceScoresParams};
use tauflow_testing::{Need, skip};
use tempfile::TempDir;

const RUNTIME: &str = "TAUFLOW_ONNXRUNTIME";

fn grey(value: f32) -> Image {
    Image::new(8, 4, 3).map(|_| value)
}

/// A sample whose third variant equals the first.
fn sample(number: u64) -> Generated {
    let variant =
        |variant, value| GeneratedVariant { variant, image: grey(value), energy: vec![0.0], frames: Vec::new() };
    Generated {
        backbone: MethodName::new("rf_own").expect("a name"),
        family: Family::RectifiedFlow,
        sample: number,
        steps: 1,
        variants: vec![
            variant(Variant::Frozen, 0.25),
            variant(Variant::Adapted, 0.75),
            variant(Variant::EtaZero, 0.25),
        ],
    }
}

fn scored(params: NoReferenceScoresParams) -> Result<SampleScores, KindError> {
    let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &stop);
    let item = |number: u64| {
        let key = ItemKey::new(format!("rf_own-{number}")).expect("a key");
        (key, sample(number).store(&ctx).expect("in memory").into_artifact())
    };
    let generated: Collection = (0..2).map(item).collect();
    let all = BTreeMap::from([("generated", &generated)]);
    let action = Action { params, item: None, group: "main", seed: 0, each: BTreeMap::new(), all };
    let outputs = NoReferenceScores::run(&ctx, &action)?;
    let artifact = outputs.collections["scores"].iter().next().expect("one").1;
    Handle::<SampleScores>::new(artifact)?.load(&ctx)
}

fn refused(params: NoReferenceScoresParams) -> String {
    scored(params).expect_err("unsound").to_string()
}

/// A script in a folder, that may be run.
fn script(folder: &TempDir, text: &str) -> Vec<String> {
    let file = folder.path().join("scorer.sh");
    fs::write(&file, format!("#!/bin/sh\n{text}\n")).expect("writable");
    fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).expect("our own");
    vec!["/bin/sh".into(), file.to_string_lossy().into_owned()]
}

fn with(command: Vec<String>) -> NoReferenceScoresParams {
    NoReferenceScoresParams { command, ..NoReferenceScoresParams::default() }
}

const HELLO: &str = r#"echo '{"metrics": [{"name": "bytes", "better": "lower"}]}'"#;
/// Answers with the size of each picture, and writes down how many there were.
const ANSWERS: &str = r#"while read -r line; do
  file=$(printf '%s' "$line" | cut -d'"' -f4)
  echo "$file" >> "$(dirname "$0")/asked"
  echo "{\"scores\": {\"bytes\": $(wc -c < "$file")}}"
done"#;

#[test]
fn a_program_scores_each_picture_that_differs() {
    let folder = tempfile::tempdir().expect("a folder");
    let found = scored(with(script(&folder, &format!("{HELLO}\n{ANSWERS}")))).expect("sound");
    assert_eq!((found.columns.len(), found.columns[0].better), (1, Better::Lower));
    assert!(found.notes.is_empty() && found.rows.len() == 6);
    for row in &found.rows {
        let value = if row.variant == Variant::Adapted { 0.75 } else { 0.25 };
        let bytes = encode_png(&grey(value)).expect("RGB").len();
        assert_eq!(row.scores, BTreeMap::from([("bytes".to_owned(), bytes as f64)]), "{row:?}");
    }
    // What equals the frozen variant is not asked about.
    let asked = fs::read_to_string(folder.path().join("asked")).expect("written");
    assert_eq!(asked.lines().count(), 4);
    // Nothing of the pictures stays.
    assert!(asked.lines().all(|file| !Path::new(file).exists()));
}

#[test]
fn a_program_that_fails_is_told_of() {
    for (text, part) in [
        ("echo nonsense", "wrote `nonsense`, which is no answer"),
        ("exit 3", "ended before it answered (exit status: 3)"),
        (r#"echo '{"metrics": []}'"#, "names no metric"),
        (&format!("{HELLO}\nread -r line\necho '{{\"error\": \"no weights\"}}'"), "failed: no weights"),
        (&format!("{HELLO}\nread -r line\necho '{{\"scores\": {{\"other\": 1}}}}'"), "without a number for `bytes`"),
        (&format!("{HELLO}\nread -r line"), "ended before it answered"),
    ] {
        let folder = tempfile::tempdir().expect("a folder");
        let told = refused(with(script(&folder, text)));
        assert!(told.contains("scorer.sh") && told.contains(part), "{told}");
    }
}

#[test]
fn a_program_that_does_not_answer_is_not_waited_for() {
    let folder = tempfile::tempdir().expect("a folder");
    let command = script(&folder, &format!("{HELLO}\nread -r line\nexec sleep 86400"));
    let told = refused(NoReferenceScoresParams { time: 0.5, ..with(command) });
    assert!(told.contains("did not answer within 0.5 s") && told.contains("`time`"), "{told}");
}

#[test]
fn a_program_that_does_not_end_is_ended() {
    let folder = tempfile::tempdir().expect("a folder");
    // It would sleep for a day after its answers.
    let text = format!("echo $$ > \"$(dirname \"$0\")/pid\"\n{HELLO}\n{ANSWERS}\nexec sleep 86400");
    scored(with(script(&folder, &text))).expect("sound");
    let pid = fs::read_to_string(folder.path().join("pid")).expect("written");
    assert!(!Path::new("/proc").join(pid.trim()).exists(), "{pid}");
}

/// A field of a protocol buffer with a length.
fn field(number: u8, content: &[u8]) -> Vec<u8> {
    let length = u8::try_from(content.len()).expect("short");
    assert!(length < 128, "one byte of length");
    [&[number << 3 | 2, length], content].concat()
}

/// A field of a protocol buffer with a whole number; numbers above 15 take two bytes.
fn whole(number: u8, value: u8) -> Vec<u8> {
    let key = if number < 16 { vec![number << 3] } else { vec![number << 3 | 0x80, number >> 4] };
    [key, vec![value]].concat()
}

/// A named tensor of f32 whose axes have these names or sizes.
fn value(name: &str, axes: &[&str]) -> Vec<u8> {
    let axis = |axis: &&str| {
        let of = axis.parse::<u8>().map_or_else(|_| field(2, axis.as_bytes()), |size| whole(1, size));
        field(1, &of)
    };
    let shape: Vec<u8> = axes.iter().flat_map(axis).collect();
    let tensor = [whole(1, 1), field(2, &shape)].concat();
    [field(1, name.as_bytes()), field(2, &field(1, &tensor))].concat()
}

/// An ONNX model whose score is the mean of its input; with `axes` kept, one number for each pixel.
fn model() -> Vec<u8> {
    let keep = [field(1, b"keepdims"), whole(3, 0), whole(20, 2)].concat();
    let node = [field(1, b"image"), field(2, b"score"), field(4, b"ReduceMean"), field(5, &keep)].concat();
    let graph = [
        field(1, &node),
        field(2, b"mean"),
        field(11, &value("image", &["1", "3", "h", "w"])),
        field(12, &value("score", &[])),
    ]
    .concat();
    [whole(1, 8), field(7, &graph), field(8, &whole(2, 13))].concat()
}

/// A folder with a model, a parity image and a manifest that `change` may spoil.
fn manifest(change: impl FnOnce(&mut serde_json::Value)) -> (TempDir, String) {
    let folder = tempfile::tempdir().expect("a folder");
    let bytes = model();
    fs::write(folder.path().join("mean.onnx"), &bytes).expect("writable");
    let parity = Image::from_data(2, 1, 3, vec![0.0, 0.2, 0.4, 0.6, 0.8, 1.0]).expect("fits");
    fs::write(folder.path().join("parity.png"), encode_png(&parity).expect("RGB")).expect("writable");
    let mut said = serde_json::json!({
        "metric": "brightness", "better": "higher", "model": "mean.onnx", "digest": Digest::of(&bytes).to_string(),
        "mean": [0.5, 0.5, 0.5], "deviation": [0.5, 0.5, 0.5],
        "parity": { "image": "parity.png", "score": 0.0, "tolerance": 1e-6 },
    });
    change(&mut said);
    let path = folder.path().join("brightness.json");
    fs::write(&path, said.to_string()).expect("writable");
    let path = path.to_string_lossy().into_owned();
    (folder, path)
}

fn of_model(path: &str) -> NoReferenceScoresParams {
    NoReferenceScoresParams { models: vec![path.into()], ..NoReferenceScoresParams::default() }
}

/// ONNX Runtime, where it is named.
fn runtime() -> Option<PathBuf> {
    let named = std::env::var_os(RUNTIME).map(PathBuf::from);
    if named.is_none() {
        skip(Need::Onnx, format_args!("{RUNTIME} names no library of ONNX Runtime"));
    }
    named
}

#[test]
fn a_model_scores_pictures_after_its_check() {
    if runtime().is_none() {
        return;
    }
    let (_folder, path) = manifest(|_| ());
    let found = scored(of_model(&path)).expect("sound");
    assert!(found.notes.is_empty() && found.rows.len() == 6, "{found:?}");
    for row in &found.rows {
        let expected = if row.variant == Variant::Adapted { 0.5 } else { -0.5 };
        assert!((row.scores["brightness"] - expected).abs() < 1e-6, "{row:?}");
    }
    // At a size of its own, the same; beside a program, both.
    let (_folder, path) = manifest(|said| said["size"] = serde_json::json!([16, 16]));
    let folder = tempfile::tempdir().expect("a folder");
    let command = script(&folder, &format!("{HELLO}\n{ANSWERS}"));
    let found = scored(NoReferenceScoresParams { command, ..of_model(&path) }).expect("sound");
    assert_eq!(found.columns.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["brightness", "bytes"]);
    assert!((found.rows[0].scores["brightness"] + 0.5).abs() < 1e-6);
    let (_folder, path) = manifest(|said| said["parity"]["score"] = 0.25.into());
    let told = refused(of_model(&path));
    assert!(told.contains("expects 0.25 to within 0.000001"), "{told}");
    let params = NoReferenceScoresParams { models: vec![path.clone(), path.clone()], ..of_model(&path) };
    assert!(refused(params).contains("expects 0.25"));
    let (_folder, path) = manifest(|said| said["mean"] = serde_json::json!([0.25, 0.25, 0.25]));
    assert!(refused(of_model(&path)).contains("gives its parity image"));
}

#[test]
fn unsound_manifests_and_other_files_are_refused() {
    // None of this comes so far that the runtime is loaded; but it has to be there.
    let runtime = tempfile::NamedTempFile::new().expect("a file");
    let with = |path: &str| NoReferenceScoresParams {
        runtime: Some(runtime.path().to_string_lossy().into_owned()),
        ..of_model(path)
    };
    let (folder, path) = manifest(|_| ());
    fs::write(folder.path().join("mean.onnx"), b"another").expect("writable");
    let told = refused(with(&path));
    assert!(told.contains(&Digest::of(b"another").to_string()) && told.contains("brightness.json"), "{told}");
    for (name, value, part) in [
        ("metric", serde_json::json!("a b"), "`metric`"),
        ("deviation", serde_json::json!([1.0, 0.0, 1.0]), "`deviation`"),
        ("size", serde_json::json!([0, 4]), "`size`"),
        ("colour", serde_json::json!("rgb"), "unknown field `colour`"),
        ("better", serde_json::json!("nicer"), "unknown variant `nicer`"),
        ("parity", serde_json::json!({ "image": "p", "score": 0.0, "tolerance": -1.0 }), "`parity`"),
    ] {
        let (_folder, path) = manifest(|said| said[name] = value);
        let told = refused(with(&path));
        assert!(told.contains("brightness.json") && told.contains(part), "{told}");
    }
    let (_folder, path) = manifest(|_| ());
    let told = refused(with(&path));
    // A process has one runtime: another test may have loaded it.
    assert!(
        told.contains("cannot load ONNX Runtime from") || told.contains("name one library for all nodes"),
        "{told}"
    );
}

#[test]
fn what_is_missing_is_left_out_with_a_note_or_refused() {
    let (folder, path) = manifest(|_| ());
    let no_runtime = NoReferenceScoresParams { runtime: Some("/no/such/runtime.so".into()), ..of_model(&path) };
    let none = NoReferenceScoresParams::default();
    for (params, part) in [
        (no_runtime, "no ONNX Runtime at `/no/such/runtime.so`"),
        (of_model("/no/such.json"), "no manifest `/no/such.json`"),
        (
            NoReferenceScoresParams { command: vec!["/no/such/program".into()], ..none.clone() },
            "no program `/no/such/program`",
        ),
        (with(vec!["sh".into(), "no_such_scorer.py".into()]), "no file `no_such_scorer.py`"),
    ] {
        let found = scored(params.clone()).expect("left out");
        assert!(found.rows.is_empty() && found.columns.is_empty());
        assert!(found.notes.len() == 1 && found.notes[0].contains(part), "{:?}", found.notes);
        let told = refused(NoReferenceScoresParams { required: true, ..params });
        assert!(told.contains(part) && told.contains("`required: false`"), "{told}");
    }
    // Nothing at all has to be allowed, and gives no column and no note.
    assert_eq!(NoReferenceScores::check(&none).len(), 1);
    let nothing = NoReferenceScoresParams { allow_none: true, ..none };
    assert!(NoReferenceScores::check(&nothing).is_empty());
    assert_eq!(scored(nothing).expect("no scores"), SampleScores::default());
    for file in ["parity.png", "mean.onnx"] {
        fs::remove_file(folder.path().join(file)).expect("there");
        let found = scored(of_model(&path)).expect("left out");
        assert!(found.notes[0].contains(file), "{:?}", found.notes);
    }
}

#[test]
fn every_file_enters_the_key() {
    let (folder, path) = manifest(|_| ());
    let scripts = tempfile::tempdir().expect("a folder");
    let command = script(&scripts, HELLO);
    let runtime = folder.path().join("runtime.so");
    let params =
        NoReferenceScoresParams { runtime: Some(runtime.to_string_lossy().into_owned()), command, ..of_model(&path) };
    let key = || NoReferenceScores::environment(&params, "main", &Act).expect("known");
    let mut before = key();
    for file in ["runtime.so", "mean.onnx", "parity.png"].map(|name| folder.path().join(name)) {
        fs::write(&file, format!("another {}", file.display())).expect("writable");
        let now = key();
        assert_ne!(now, before, "{}", file.display());
        before = now;
    }
    fs::write(scripts.path().join("scorer.sh"), "another").expect("writable");
    assert_ne!(key(), before);
    let before = key();
    fs::write(&path, fs::read_to_string(&path).expect("there") + "\n").expect("writable");
    assert_ne!(key(), before);
    assert_eq!(NoReferenceScores::check(&NoReferenceScoresParams::default()).len(), 1);
    assert!(NoReferenceScores::check(&params).is_empty());
}
