//! The kind `command` as the engine calls it: the examples of its manual, what programs do wrong, limits, and keys.

use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    process::Command,
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant},
};
use tauflow_contract::{
    Act, Action, Artifact, Collection, Context, Determinism, FileTree, Files, Handle, ItemKey, Kind, KindError, Look,
    Media, MemoryBlobs, Mode, Outputs, Silent,
};
use tauflow_data::{
    Image,
    records::{PackedScene, Refined, RefinedImage},
};
use tauflow_denoise::{CommandKind, CommandParams, kinds};
use tauflow_testing::{Need, skip};

const MANUAL: &str = include_str!("../src/command_kind.md");

/// The first block of a language in the manual.
fn example(language: &str) -> &'static str {
    let (_, rest) = MANUAL.split_once(&format!("```{language}\n")).expect("the manual has one");
    rest.split("```").next().expect("the text before the end")
}

#[derive(Default)]
struct Bench {
    blobs: MemoryBlobs,
    stop: AtomicBool,
}

impl Bench {
    fn ctx(&self) -> Context<'_> {
        Context::new(&self.blobs, &Silent, &self.stop)
    }

    fn files(&self, text: &str) -> Artifact {
        let tree = FileTree::from([("text.txt".to_owned(), text.as_bytes().to_vec())]);
        Files(tree).store(&self.ctx()).expect("memory").into_artifact()
    }

    fn map(&self, params: &Value, each: &[(&str, &Artifact)]) -> Result<Outputs, KindError> {
        let each = each.iter().copied().collect();
        self.run(params, each, BTreeMap::new())
    }

    fn gather(&self, params: &Value, all: &[(&str, &Collection)]) -> Result<Outputs, KindError> {
        self.run(params, BTreeMap::new(), all.iter().copied().collect())
    }

    fn run(
        &self,
        params: &Value,
        each: BTreeMap<&str, &Artifact>,
        all: BTreeMap<&str, &Collection>,
    ) -> Result<Outputs, KindError> {
        let action = Action { params: typed(params), item: None, group: "main", seed: 0, each, all };
        CommandKind::run(&self.ctx(), &action)
    }

    /// What a shell program with one input and one output, trees of files, does wrong.
    fn wrong(&self, script: &str, more: &Value) -> String {
        let input = self.files("content");
        self.map(&with(&shell(script), more), &[("given", &input)]).expect_err("it fails").to_string()
    }
}

fn typed(params: &Value) -> CommandParams {
    let kind = kinds().into_iter().find(|kind| kind.spec().name == "command").expect("a kind");
    serde_json::from_value(kind.resolve(params).expect("sound params")).expect("params")
}

/// Params of a shell program that makes a tree of files from a tree of files.
fn shell(script: &str) -> Value {
    json!({ "run": ["sh", "-c", script], "inputs": { "given": "tauflow/files" },
        "outputs": { "made": "tauflow/files" } })
}

fn with(params: &Value, more: &Value) -> Value {
    let mut params = params.clone();
    let fields = params.as_object_mut().expect("an object");
    fields.extend(more.as_object().expect("an object").clone());
    params
}

fn load<M: Media>(bench: &Bench, artifact: &Artifact) -> M {
    Handle::new(artifact).expect("the declared type").load(&bench.ctx()).expect("stored")
}

fn key(text: &str) -> ItemKey {
    ItemKey::new(text).expect("plain")
}

fn scene(value: f32) -> PackedScene {
    let mut state = Image::new(5, 4, 3);
    state.pixel_mut(2, 1).copy_from_slice(&[9.0 * value, 18.0, 27.0]);
    let gbuffer = Some(Image::new(5, 4, 6));
    PackedScene { counts: vec![1, 256], states: vec![state, Image::new(5, 4, 3)], gbuffer, sampler: Default::default() }
}

#[test]
fn links_and_hidden_files_are_no_output() {
    let bench = Bench::default();
    for (script, told) in [
        ("echo a > out/made/a; echo b > out/made/.env", "`out/made/.env`, whose name begins with a dot"),
        ("mkdir out/made/x; echo a > out/made/x/a; ln -s /etc/hostname out/made/x/b", "the link `out/made/x/b`"),
        ("ln -s .. out/made/x", "the link `out/made/x`"),
        ("rmdir out/made; ln -s /etc out/made", "the link `out/made`"),
    ] {
        let error = bench.wrong(script, &json!({}));
        assert!(error.contains(told), "{script}: {error}");
    }
    let gather = json!({ "mode": "gather", "inputs": {} });
    for (script, told) in [
        ("ln -s /etc out/made/one", "the link `out/made/one`"),
        ("mkdir out/made/a; ln -s /etc out/made/a/one", "the link `out/made/a/one`"),
        ("rmdir out/made; ln -s /etc out/made", "the link `out/made`"),
    ] {
        let error = bench.gather(&with(&shell(script), &gather), &[]).expect_err("a link").to_string();
        assert!(error.contains(told), "{script}: {error}");
    }
}

#[test]
fn the_denoiser_of_the_manual_denoises() {
    let lines = example("python").lines().count();
    assert_eq!(lines, 12);
    if !Command::new("python3").arg("-V").output().is_ok_and(|done| done.status.success()) {
        skip(Need::Python, "there is no python3");
        return;
    }
    let (bench, folder) = (Bench::default(), tempfile::tempdir().expect("a folder"));
    let script = folder.path().join("box.py");
    fs::write(&script, example("python")).expect("writable");
    let scene = scene(1.0).store(&bench.ctx()).expect("memory").into_artifact();
    let params = json!({ "run": ["python3", script.to_string_lossy()], "inputs": { "scenes": "tauflow/packed-scene" },
        "outputs": { "refined": "tauflow/refined" }, "values": { "radius": 1 }, "images": "pfm",
        "reproducible": "everywhere" });
    let outputs = bench.map(&params, &[("scenes", &scene)]).expect("it denoises");
    let Refined { images, .. } = load(&bench, &outputs.items["refined"]);
    let [(RefinedImage { method, to_spp, .. }, image)] = &images[..] else { panic!("one image") };
    assert_eq!((method.as_str(), *to_spp), ("box", 256));
    for y in 0..4 {
        for x in 0..5_usize {
            // One pixel is spread over its neighbours, which fewer share at the edge.
            let near = y < 3 && (1..4).contains(&x);
            let share = if !near {
                0.0
            } else if y == 0 {
                1.5
            } else {
                1.0
            };
            assert_eq!(image.pixel(x, y), [share, 2.0 * share, 3.0 * share], "{x} {y}");
        }
    }
}

#[test]
fn the_script_of_the_manual_lists_items() {
    let bench = Bench::default();
    let folder = tempfile::tempdir().expect("a folder");
    let script = folder.path().join("list.sh");
    fs::write(&script, example("sh")).expect("writable");
    let image = |method: &str| {
        let said = RefinedImage { method: method.into(), from_spp: 1, to_spp: 2, nfe: 0 };
        let refined = Refined { images: vec![(said, Image::new(1, 1, 3))], note: None, ..Default::default() };
        refined.store(&bench.ctx()).expect("memory").into_artifact()
    };
    let items: Collection = [(key("a"), image("x")), (key("b"), image("y"))].into_iter().collect();
    let params = json!({ "run": ["sh", script.to_string_lossy()], "mode": "gather",
        "inputs": { "images": "tauflow/refined" }, "outputs": { "pages": "tauflow/files" } });
    assert_eq!(CommandKind::spec_for(&typed(&params)).mode, Mode::Gather);
    let outputs = bench.gather(&params, &[("images", &items)]).expect("it lists");
    let pages = &outputs.collections["pages"];
    let Files(files) = load(&bench, pages.get("all").expect("one item"));
    assert_eq!(files["list.txt"], b"a: 3 files\nb: 3 files\n");
    assert_eq!(pages.len(), 1);
}

#[test]
fn a_program_gets_values_files_and_nothing_else() {
    let bench = Bench::default();
    let input = bench.files("content");
    let all: Collection = [(key("cell/a"), bench.files("1")), (key("cell/b"), bench.files("2"))].into_iter().collect();
    let script = "test -z \"$(ls -A out/made)\" && test \"$(ls -A | tr '\\n' ' ')\" = 'in out params.json ' || exit 4
        cp params.json in/given/text.txt out/made && cat in/rest/cell/*/text.txt > out/made/all";
    let more = json!({ "values": { "sigma": [0.5, "x"] }, "collections": { "rest": "tauflow/files" } });
    let params = with(&shell(script), &more);
    let spec = CommandKind::spec_for(&typed(&params));
    assert_eq!(spec.inputs.iter().map(|port| port.name).collect::<Vec<_>>(), ["given", "rest"]);
    let each = BTreeMap::from([("given", &input)]);
    let outputs = bench.run(&params, each, BTreeMap::from([("rest", &all)])).expect("it copies");
    let Files(files) = load(&bench, &outputs.items["made"]);
    assert_eq!((&files["text.txt"][..], &files["all"][..]), (&b"content"[..], &b"12"[..]));
    let told: Value = serde_json::from_slice(&files["params.json"]).expect("JSON");
    assert_eq!((&told["values"], &told["items"]), (&more["values"], &json!({ "rest": ["cell/a", "cell/b"] })));
    // Items of a gather come back under their keys.
    let copy = "cp -r in/given/* out/made";
    let outputs = bench.gather(&with(&shell(copy), &json!({ "mode": "gather" })), &[("given", &all)]);
    assert_eq!(outputs.expect("it copies").collections["made"], all);
    // A gather without inputs is a source.
    let source = json!({ "mode": "gather", "inputs": {} });
    let outputs = bench.gather(&with(&shell("mkdir out/made/a; echo > out/made/a/b"), &source), &[]);
    assert_eq!(outputs.expect("it makes one").collections["made"].len(), 1);
}

#[test]
fn images_are_exr_files_unless_asked_otherwise() {
    let bench = Bench::default();
    let packed = scene(1.0);
    let stored = packed.store(&bench.ctx()).expect("memory").into_artifact();
    let params = |script: &str| {
        json!({ "run": ["sh", "-c", script], "inputs": { "scenes": "tauflow/packed-scene" },
            "outputs": { "same": "tauflow/packed-scene" } })
    };
    let copied = bench.map(&params("cp in/scenes/*.exr out/same"), &[("scenes", &stored)]).expect("it copies");
    assert_eq!(copied.items["same"], stored);
    let more = json!({ "images": "pfm" });
    let script = "test -e in/scenes/gbuffer.albedo.pfm && cp in/scenes/spp* out/same";
    let copied = bench.map(&with(&params(script), &more), &[("scenes", &stored)]).expect("it copies");
    let back: PackedScene = load(&bench, &copied.items["same"]);
    assert_eq!((back.states, back.gbuffer), (packed.states, None));
}

#[test]
fn programs_that_fail_are_told_with_their_last_words() {
    let bench = Bench::default();
    let none = json!({});
    for (script, expected) in [
        ("echo out of luck >&2; exit 3", "out of luck"),
        ("exit 3", "wrote nothing to standard error"),
        ("kill -9 $$", "signal: 9"),
        ("echo almost >&2", "left no files in `out/made`, expected a `tauflow/files`"),
        ("echo almost >&2", "almost"),
        ("rm -r out/made", "removed the directory `out/made`"),
        ("mkdir out/other; echo > out/made/a", "left `out/other`, which is not declared"),
        ("echo > out/made/a; mkfifo out/made/b || ln -s /dev/null out/made/b", "`out/made`"),
        ("echo > 'out/made/a b'", "a b"),
    ] {
        let error = bench.wrong(script, &none);
        assert!(error.contains(expected) && error.contains("the command `sh -c"), "{script}: {error}");
    }
    for (script, expected) in [
        ("echo nonsense > out/made/meta.json", "left no `tauflow/refined` in `out/made`: `meta.json`"),
        ("echo '{\"images\": []}' > out/made/meta.json; echo > out/made/notes", "`out/made/notes`"),
    ] {
        let error = bench.wrong(script, &json!({ "outputs": { "made": "tauflow/refined" } }));
        assert!(error.contains(expected), "{error}");
    }
    let gather = json!({ "mode": "gather", "inputs": {} });
    for (script, expected) in [
        ("true", "write each item into a directory `out/made/KEY`"),
        ("echo > out/made/a", "left the file `a` outside"),
        ("mkdir out/made/a", "the empty directory `a`"),
        ("mkdir 'out/made/a b'; echo > 'out/made/a b/c'", "cannot be an item key"),
    ] {
        let error = bench.gather(&with(&shell(script), &gather), &[]).expect_err("it fails").to_string();
        assert!(error.contains(expected), "{error}");
    }
    let nested: Collection = [(key("a"), bench.files("1")), (key("a/b"), bench.files("2"))].into_iter().collect();
    let error = bench.gather(&with(&shell("true"), &json!({ "mode": "gather" })), &[("given", &nested)]);
    assert!(error.expect_err("they meet").to_string().contains("`a` and `a/b`"));
    let error = bench.wrong("true", &json!({ "run": ["/no/such/program"] }));
    assert!(error.contains("/no/such/program") && error.contains("cannot be started"), "{error}");
    let error = bench.wrong("true", &json!({ "depends": ["/no/such/file"] }));
    assert!(error.contains("`depends` names `/no/such/file`"), "{error}");
    let error = bench.wrong("true", &json!({ "version": ["sh", "-c", "echo none >&2; exit 1"] }));
    assert!(error.contains("failed (exit status: 1): none"), "{error}");
    let error = bench.wrong("date +%N > out/made/a; echo $$ >> out/made/a", &json!({ "reproducible": "everywhere" }));
    assert!(error.contains("two runs gave different outputs on `made`"), "{error}");
}

#[test]
#[expect(clippy::disallowed_methods, reason = "limits of time are tested")]
fn limits_end_a_program_and_what_it_started() {
    let (bench, folder) = (Bench::default(), tempfile::tempdir().expect("a folder"));
    let child = folder.path().join("child");
    let gone = || {
        let id = fs::read_to_string(&child).expect("it was started");
        assert!(id.ends_with('\n'), "no number of a process: {id:?}");
        for _ in 0..500 {
            // A process that ended may stay as a zombie, which nobody has waited for.
            let stat = fs::read_to_string(format!("/proc/{}/stat", id.trim()));
            if stat.map_or(true, |stat| stat.contains(") Z ")) {
                return true;
            }
            thread::sleep(Duration::from_millis(10));
        }
        false
    };
    let begun = Instant::now();
    let script = format!("sleep 600 & echo $! > {}; echo tired >&2; wait", child.display());
    let error = bench.wrong(&script, &json!({ "time": 0.5 }));
    assert!(error.contains("took longer than 0.5 s (`time`)") && error.contains("tired"), "{error}");
    assert!(begun.elapsed() < Duration::from_secs(60) && gone());
    // What is left running ends with the program.
    let script = format!("sleep 600 & echo $! > {}; echo > out/made/a", child.display());
    let input = bench.files("content");
    bench.map(&shell(&script), &[("given", &input)]).expect("it made its output");
    assert!(gone());
    // One that has left the program's group goes on, and nobody waits for it.
    let busy = "i=0; while [ $i -lt 3000 ]; do cat /etc/hostname; sleep 0.01; i=$((i + 1)); done";
    let script = format!("setsid sh -c '{busy}' >/dev/null 2>&1 & sleep 0.3; echo > out/made/a");
    let begun = Instant::now();
    bench.map(&shell(&script), &[("given", &input)]).expect("it made its output");
    assert!(begun.elapsed() < Duration::from_secs(15), "{:?}", begun.elapsed());
    // A shell that holds 512 MiB in a variable has more than 64.
    let script = "x=$(head -c 536870912 /dev/zero | tr '\\0' x); echo ${#x} > out/made/a";
    let error = bench.wrong(script, &json!({ "memory": 64 }));
    assert!(error.contains("`memory` allows 64 MiB"), "{error}");
    // A run that is being stopped does not wait.
    let script = format!("sleep 600 & echo $! > {}; wait", child.display());
    fs::remove_file(&child).expect("written before");
    thread::scope(|scope| {
        scope.spawn(|| {
            // The shell makes the file before it writes the number.
            while !fs::read_to_string(&child).is_ok_and(|id| id.ends_with('\n')) {
                thread::sleep(Duration::from_millis(5));
            }
            bench.stop.store(true, Ordering::Relaxed);
        });
        let stopped = bench.map(&shell(&script), &[("given", &input)]);
        assert!(matches!(stopped, Err(KindError::Cancelled)));
    });
    assert!(gone());
}

#[test]
fn keys_hold_program_dependencies_version_and_machine() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let write = |path: &Path, text: &str| fs::write(path, text).expect("writable");
    fs::create_dir_all(at("module/__pycache__")).expect("writable");
    write(&at("run.sh"), "true");
    write(&at("module/a.py"), "a");
    write(&at("weights"), "1");
    let text = |name: &str| at(name).to_string_lossy().into_owned();
    let params = with(
        &shell("true"),
        &json!({ "run": ["sh", text("run.sh")], "depends": [text("module"), text("weights")],
            "version": ["echo", "3"] }),
    );
    let key_of = |params: &Value| CommandKind::environment(&typed(params), "main", &Act).expect("it may ask");
    let mut last = key_of(&params);
    assert_eq!(last["version"], "3");
    assert!(last["machine"].is_object() && last["program"].as_object().is_some_and(|of| of.len() == 2), "{last}");
    write(&at("module/__pycache__/a.pyc"), "compiled");
    assert_eq!(key_of(&params), last, "what Python compiles is no dependency");
    for (name, content) in [("run.sh", "echo other"), ("module/a.py", "bb"), ("module/b.py", ""), ("weights", "22")] {
        write(&at(name), content);
        let next = key_of(&params);
        assert_ne!(next, last, "{name}");
        last = next;
    }
    fs::remove_file(at("weights")).expect("there");
    assert_ne!(key_of(&params), last, "a file that is gone");
    assert_eq!(CommandKind::environment(&typed(&params), "main", &Look), None, "looking runs nothing");
    let class = |reproducible: &str| {
        let params = with(&params, &json!({ "reproducible": reproducible }));
        (CommandKind::spec_for(&typed(&params)).outputs[0].determinism, key_of(&params)["machine"].is_object())
    };
    assert_eq!(class("machine"), (Determinism::Local, true));
    assert_eq!(class("everywhere"), (Determinism::Bitwise, false));
    assert_eq!(class("no"), (Determinism::Measured, true));
}

#[test]
fn params_that_cannot_be_are_told_at_their_place() {
    let kind = kinds().into_iter().find(|kind| kind.spec().name == "command").expect("a kind");
    for (more, pointer) in [
        (json!({ "run": [] }), "/run"),
        (json!({ "outputs": {} }), "/outputs"),
        (json!({ "inputs": {} }), "/inputs"),
        (json!({ "inputs": { "given": "tauflow/picture" } }), "/inputs/given"),
        (json!({ "outputs": { "a/b": "tauflow/files" } }), "/outputs/a~1b"),
        (json!({ "outputs": { "file": "tauflow/files" } }), "/outputs/file"),
        (json!({ "collections": { "given": "tauflow/files" } }), "/collections"),
        (json!({ "mode": "source" }), "/mode"),
    ] {
        let problem = kind.resolve(&with(&shell("true"), &more)).expect_err("wrong").swap_remove(0);
        assert_eq!(problem.pointer, pointer, "{problem:?}");
    }
}
