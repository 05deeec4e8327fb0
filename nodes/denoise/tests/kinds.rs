//! The kinds as the engine calls them: what is absent is told, programs are run, times are taken. Open Image Denoise
//! itself runs where TAUFLOW_OIDN names its library.

use serde_json::{Value, json};
use std::{cell::RefCell, collections::BTreeMap, fs, path::Path, sync::atomic::AtomicBool};
use tauflow_contract::{
    Act, Action, Artifact, Context, Handle, Kind, KindError, Look, Media, MemoryBlobs, Outputs, Probe, Silent, Stored,
};
use tauflow_data::{
    Image, Resolution, Rungs, TensorFile,
    image_io::write_exr,
    methods::{Conditioning, MethodName},
    records::{PackedScene, Refined, RefinedImages, SceneRecord, Timing},
    rng::Stream,
    scene::{Recipe, Scene},
    views::Views,
};
use tauflow_denoise::{
    ExternalDenoiser, ExternalDenoiserParams, ExternalRenderer, ExternalRendererParams, Features, GuidedFilter,
    GuidedFilterParams, Quality, kinds,
};
use tauflow_testing::{Need, set, skip};

const SIDE: usize = 48;

/// Two surfaces of other albedo and normal, lit evenly, under noise; and without it.
fn scene() -> (PackedScene, Image) {
    let (mut clean, mut noisy) = (Image::new(SIDE, SIDE, 3), Image::new(SIDE, SIDE, 3));
    let mut gbuffer = Image::new(SIDE, SIDE, 6);
    for y in 0..SIDE {
        for x in 0..SIDE {
            let mut stream = Stream::new(8, &[x as u64, y as u64]);
            let left = x < SIDE / 2;
            let albedo = if left { [0.7, 0.2, 0.2] } else { [0.2, 0.3, 0.8] };
            let normal = if left { [0.0, 0.0, 1.0] } else { [1.0, 0.0, 0.0] };
            let noise = 2.0 * stream.uniform() as f32;
            for c in 0..3 {
                clean.pixel_mut(x, y)[c] = albedo[c];
                noisy.pixel_mut(x, y)[c] = albedo[c] * noise;
                gbuffer.pixel_mut(x, y)[c] = albedo[c];
                gbuffer.pixel_mut(x, y)[3 + c] = normal[c];
            }
        }
    }
    (
        PackedScene {
            counts: vec![1, 64],
            states: vec![noisy, clean.clone()],
            gbuffer: Some(gbuffer),
            sampler: Default::default(),
        },
        clean,
    )
}

fn error(a: &Image, b: &Image) -> f64 {
    a.data().iter().zip(b.data()).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / a.data().len() as f64
}

struct Bench {
    blobs: MemoryBlobs,
    stop: AtomicBool,
    endpoints: Stored<PackedScene>,
}

impl Bench {
    fn new(scene: &PackedScene) -> Self {
        let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
        let endpoints = scene.store(&Context::new(&blobs, &Silent, &stop)).expect("consistent");
        Self { blobs, stop, endpoints }
    }

    fn ctx(&self) -> Context<'_> {
        Context::new(&self.blobs, &Silent, &self.stop)
    }

    fn run<K: Kind>(&self, params: K::Params, group: &str) -> Result<Outputs, KindError> {
        let each = BTreeMap::from([("endpoints", self.endpoints.artifact())]);
        K::run(&self.ctx(), &Action { params, item: None, group, seed: 0, each, all: BTreeMap::new() })
    }

    fn images(&self, outputs: &Outputs) -> (RefinedImages, Option<String>) {
        let Refined { images, note, .. } = load(&self.ctx(), &outputs.items["refined"]);
        (images, note)
    }

    fn timing(&self, outputs: &Outputs) -> Timing {
        load(&self.ctx(), &outputs.items["timing"])
    }
}

fn load<M: Media>(ctx: &Context<'_>, artifact: &Artifact) -> M {
    Handle::new(artifact).expect("the port's type").load(ctx).expect("stored")
}

fn named(method: &str) -> MethodName {
    MethodName::new(method).expect("plain")
}

/// A program that copies its input, as a shell script with a name.
fn program(folder: &Path, text: &str) -> Vec<String> {
    let script = folder.join("denoise.sh");
    fs::write(&script, text).expect("writable");
    ["sh", &script.to_string_lossy(), "{color}", "{albedo}", "{normal}", "{output}"].map(str::to_owned).to_vec()
}

#[test]
fn a_program_denoises_and_is_timed() {
    let (scene, _) = scene();
    let bench = Bench::new(&scene);
    let folder = tempfile::tempdir().expect("a folder");
    let copy = ExternalDenoiserParams {
        method: named("copy"),
        command: program(folder.path(), "test -s \"$2\" && test -s \"$3\" && cp \"$1\" \"$4\"\n"),
        repeats: 2,
        ..ExternalDenoiserParams::default()
    };
    assert!(ExternalDenoiser::check(&copy).is_empty());
    let (images, note) = bench.images(&bench.run::<ExternalDenoiser>(copy.clone(), "main").expect("it copies"));
    let [(said, image)] = &images[..] else { panic!("one image") };
    assert_eq!((said.method.as_str(), said.from_spp, said.to_spp, said.nfe, note), ("copy", 1, 64, 1, None));
    assert_eq!(image, &scene.states[0]);
    let timing = bench.timing(&bench.run::<ExternalDenoiser>(copy, "timing").expect("it copies"));
    assert_eq!((timing.entries.len(), timing.entries[0].took.wall_s.len()), (1, 2));
    assert!(timing.entries[0].took.wall_s.iter().all(|s| *s > 0.0));
}

#[test]
fn programs_that_fail_are_told() {
    let (scene, _) = scene();
    let bench = Bench::new(&scene);
    let folder = tempfile::tempdir().expect("a folder");
    for (text, expected) in [
        ("echo out of luck >&2; exit 3\n", "failed with exit status: 3; its standard error ends with:\nout of luck"),
        ("kill -9 $$\n", "SIGKILL); it wrote nothing to standard error"),
        ("echo no licence >&2\n", "no image that can be read: {output}: "),
        ("echo no licence >&2\n", "; its standard error ends with:\nno licence"),
        ("echo nonsense > \"$4\"\n", "no image that can be read"),
    ] {
        let command = program(folder.path(), text);
        let params = ExternalDenoiserParams { command, ..ExternalDenoiserParams::default() };
        let error = bench.run::<ExternalDenoiser>(params, "main").expect_err("it fails").to_string();
        assert!(error.contains(expected) && error.contains("denoise.sh"), "{error}");
    }
    let nowhere = ["/no/such/program", "{color}", "{output}"].map(str::to_owned).to_vec();
    let params = ExternalDenoiserParams { command: nowhere, ..ExternalDenoiserParams::default() };
    let error = bench.run::<ExternalDenoiser>(params, "main").expect_err("no program").to_string();
    assert!(error.contains("/no/such/program") && error.contains("cannot be started"), "{error}");
}

#[test]
fn templates_and_inputs_are_checked() {
    let with = |command: &[&str]| {
        let command = command.iter().map(|word| (*word).to_owned()).collect();
        let params = ExternalDenoiserParams { command, ..ExternalDenoiserParams::default() };
        ExternalDenoiser::check(&params).into_iter().map(|p| p.message).collect::<Vec<_>>().join(" ")
    };
    assert!(with(&["denoise", "{color}"]).contains("lacks the placeholder {output}"));
    assert!(with(&["denoise", "{colour}", "{color}", "{output}"]).contains("`{colour}`"));
    let command = ["denoise", "{color}", "{albedo}", "{output}"].map(str::to_owned).to_vec();
    let rgb = ExternalDenoiserParams { command, conditioning: Conditioning::Rgb, ..ExternalDenoiserParams::default() };
    assert!(ExternalDenoiser::check(&rgb)[0].message.contains("no file `{albedo}`"));
    let (mut scene, _) = scene();
    scene.gbuffer = None;
    let bench = Bench::new(&scene);
    let error = bench.run::<GuidedFilter>(GuidedFilterParams::default(), "main").expect_err("no G-buffer").to_string();
    assert!(error.contains("no G-buffer"), "{error}");
    let params = GuidedFilterParams { from: 2, ..GuidedFilterParams::default() };
    assert!(bench.run::<GuidedFilter>(params, "main").expect_err("no such rung").to_string().contains("[1, 64]"));
}

#[test]
fn params_that_cannot_be_are_refused_once_and_for_all() {
    for kind in kinds().into_iter().filter(|kind| kind.spec().name != "command") {
        let bad = |params| kind.resolve(&params).expect_err("wrong").swap_remove(0);
        for method in ["", " ", "a/b"] {
            let problem = bad(json!({ "method": method }));
            assert!(problem.pointer == "/method" && problem.message.contains(method), "{problem:?}");
        }
    }
    let renderer = kinds().into_iter().find(|kind| kind.spec().name == "external_renderer").expect("a kind");
    for (params, pointer) in [
        (json!({ "counts": [4, 1] }), "/counts"),
        (json!({ "counts": { "dyadic": 3 } }), "/counts"),
        (json!({ "resolution": [0, 4] }), "/resolution"),
    ] {
        let problem = renderer.resolve(&params).expect_err("wrong").swap_remove(0);
        assert_eq!(problem.pointer, pointer, "{problem:?}");
    }
}

#[test]
fn a_g_buffer_of_another_size_is_refused_before_anything_reads_it() {
    let (scene, _) = scene();
    let mut bench = Bench::new(&scene);
    let blob = bench.ctx().get(&bench.endpoints.artifact().part("").expect("one blob")).expect("stored");
    let mut file = TensorFile::from_bytes(&blob).expect("tensors");
    file = file.with_image("gbuffer", &Image::new(1, 1, 6));
    let digest = bench.ctx().put(&file.to_bytes().expect("plain tensors")).expect("memory");
    bench.endpoints = Stored::blob(digest);
    for command in [Vec::new(), ["true", "{color}", "{output}"].map(str::to_owned).to_vec()] {
        let params = ExternalDenoiserParams { command, ..ExternalDenoiserParams::default() };
        let error = bench.run::<ExternalDenoiser>(params, "main").expect_err("another size").to_string();
        assert!(error.contains("1 x 1") && error.contains("48 x 48"), "{error}");
    }
}

#[test]
fn a_library_that_is_not_there_is_told() {
    let (scene, _) = scene();
    let bench = Bench::new(&scene);
    let library = Some("/no/such/libOpenImageDenoise.so".to_owned());
    let named = ExternalDenoiserParams { library, ..ExternalDenoiserParams::default() };
    let error = bench.run::<ExternalDenoiser>(named, "main").expect_err("no library").to_string();
    assert!(error.contains("/no/such/libOpenImageDenoise.so") && error.contains("TAUFLOW_OIDN"), "{error}");
    if set("TAUFLOW_OIDN").is_some() {
        // The rest is seen by a process to which no library is named.
        let mut child = std::process::Command::new(std::env::current_exe().expect("this program"));
        child.args(["--exact", "a_library_that_is_not_there_is_told"]).env_remove("TAUFLOW_OIDN");
        let child = child.output().expect("it starts");
        let told = String::from_utf8_lossy(&child.stdout);
        assert!(child.status.success() && told.contains("1 passed"), "{told}");
        return;
    }
    let outputs = bench.run::<ExternalDenoiser>(ExternalDenoiserParams::default(), "main").expect("left out");
    let (images, note) = bench.images(&outputs);
    if images.is_empty() {
        assert!(note.is_some_and(|note| note.contains("no Open Image Denoise library")));
        let needed = ExternalDenoiserParams { required: true, ..ExternalDenoiserParams::default() };
        assert!(bench.run::<ExternalDenoiser>(needed, "main").is_err());
        let outputs = bench.run::<ExternalDenoiser>(ExternalDenoiserParams::default(), "timing").expect("left out");
        assert!(bench.timing(&outputs).entries.is_empty());
    }
}

#[test]
fn open_image_denoise_denoises_and_sees_g_buffers() {
    if set("TAUFLOW_OIDN").is_none() {
        skip(Need::Oidn, "TAUFLOW_OIDN names no library of Open Image Denoise");
        return;
    }
    let (scene, clean) = scene();
    let bench = Bench::new(&scene);
    let params = ExternalDenoiserParams { required: true, repeats: 3, ..ExternalDenoiserParams::default() };
    let run = |params: &ExternalDenoiserParams| {
        let (mut images, _) = bench.images(&bench.run::<ExternalDenoiser>(params.clone(), "main").expect("it runs"));
        images.pop().expect("one image").1
    };
    let with = run(&params);
    let blind = ExternalDenoiserParams { conditioning: Conditioning::Rgb, ..params.clone() };
    let without = run(&blind);
    let before = error(&scene.states[0], &clean);
    assert!(error(&with, &clean) < 0.1 * before, "{} {before}", error(&with, &clean));
    assert!(error(&with, &clean) < error(&without, &clean));
    assert_eq!(with, run(&params), "the same bits again");
    // Each setting reaches the library, and none breaks it.
    let of = |features, quality, mirrors: u64| {
        let mirrors = Views::try_from(mirrors).expect("a number of views");
        run(&ExternalDenoiserParams { features, quality, mirrors, ..params.clone() })
    };
    let others = [
        of(Features::Raw, Quality::High, 1),
        of(Features::Prefiltered, Quality::High, 1),
        of(Features::Clean, Quality::Balanced, 1),
        of(Features::Clean, Quality::Fast, 1),
        of(Features::Clean, Quality::High, 8),
    ];
    for (at, other) in others.iter().enumerate() {
        assert!(*other != with && others[..at].iter().all(|before| before != other), "setting {at} changes nothing");
        assert!(error(other, &clean) < 0.1 * before, "setting {at}: {} {before}", error(other, &clean));
    }
    // The mean over all copies is nearer than one alone: errors of copies differ.
    assert!(error(&others[4], &clean) < error(&with, &clean));
    let timing = bench.timing(&bench.run::<ExternalDenoiser>(params, "timing").expect("it runs"));
    assert_eq!(timing.entries[0].took.wall_s.len(), 3);
}

#[test]
fn the_filter_denoises_and_is_timed() {
    let (scene, clean) = scene();
    let bench = Bench::new(&scene);
    for colour in [None, Some(0.5)] {
        let params = GuidedFilterParams { colour, repeats: 2, ..GuidedFilterParams::default() };
        let (images, _) = bench.images(&bench.run::<GuidedFilter>(params.clone(), "main").expect("it runs"));
        assert!(error(&images[0].1, &clean) < 0.1 * error(&scene.states[0], &clean), "{colour:?}");
        let timing = bench.timing(&bench.run::<GuidedFilter>(params, "timing").expect("it runs"));
        assert_eq!(timing.entries[0].took.cpu_s.len(), 2);
    }
}

/// A scene of one lamp, stored.
fn a_scene(ctx: &Context<'_>) -> Stored<SceneRecord> {
    let scene: Scene = serde_json::from_value(json!({ "version": 1,
        "camera": { "origin": [0, 0, 4], "target": [0, 0, 0], "up": [0, 1, 0], "fov_x": 40.0, "near": 0.1 },
        "shapes": [], "materials": [], "emitters": [], "max_depth": 3, "seed": 1,
    }))
    .expect("a scene");
    let recipe: Recipe = serde_json::from_value(json!({ "stratum": "L0-open", "index": 0, "layout": "none",
        "layout_params": {}, "objects": [], "environment": "none", "side": null, "exposure_ev": 0.0,
        "content": 0, "view": 0,
    }))
    .expect("a recipe");
    SceneRecord { scene, recipe }.store(ctx).expect("memory")
}

/// A renderer that is a script: it copies an EXR of the right size for each count, and tells the times that it is asked
/// for.
fn renderer(folder: &Path, text: &str) -> ExternalRendererParams {
    let image = Image::from_data(4, 2, 3, (0..24).map(|i| i as f32).collect()).expect("fits");
    write_exr(&folder.join("image.exr"), &[("", &image)]).expect("writable");
    let script = folder.join("render.sh");
    fs::write(&script, text.replace("IMAGE", &folder.join("image.exr").to_string_lossy())).expect("writable");
    let places = ["{scene}", "{counts}", "{repeats}", "{seed}", "{folder}"];
    let command = ["sh", &script.to_string_lossy()].into_iter().chain(places).map(str::to_owned).collect();
    ExternalRendererParams {
        method: named("script"),
        command,
        version: Vec::new(),
        depends: Vec::new(),
        variables: Vec::new(),
        counts: Rungs::list(vec![1, 8]).expect("increasing"),
        resolution: Resolution::new(4, 2).expect("small"),
        repeats: 2,
        required: true,
    }
}

const SOUND: &str = r#"
grep -q "<scene version=" "$1" || exit 3
for n in $(echo "$2" | tr , " "); do cp IMAGE "$5/$n.exr"; done
if test "$3" -gt 0; then
    test "$3" = 2 || exit 4
    echo '{"1": {"wall_s": [0.5, 0.25], "cpu_s": [1, 1]}, "8": {"wall_s": [4, 2], "cpu_s": [8, 8]}}' > "$5/times.json"
fi
"#;

fn rendered(params: ExternalRendererParams, group: &str) -> Result<(RefinedImages, Option<String>, Timing), KindError> {
    let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &stop);
    let scene = a_scene(&ctx);
    let each = BTreeMap::from([("scenes", scene.artifact())]);
    let action = Action { params, item: None, group, seed: 1 << 40 | 5, each, all: BTreeMap::new() };
    let outputs = ExternalRenderer::run(&ctx, &action)?;
    let (images, note) = match outputs.items.get("rendered") {
        Some(images) => {
            let Refined { images, note, .. } = load(&ctx, images);
            (images, note)
        }
        None => (Vec::new(), None),
    };
    let timing = outputs.items.get("timing").map(|timing| load(&ctx, timing));
    Ok((images, note, timing.unwrap_or(Timing { machine: serde_json::Value::Null, entries: Vec::new() })))
}

#[test]
fn another_renderer_renders_and_tells_its_times() {
    let folder = tempfile::tempdir().expect("a folder");
    let params = renderer(folder.path(), SOUND);
    assert!(ExternalRenderer::check(&params).is_empty());
    let (images, note, _) = rendered(params.clone(), "main").expect("it renders");
    let said: Vec<(&str, u64, u64)> = images.iter().map(|(s, _)| (s.method.as_str(), s.from_spp, s.nfe)).collect();
    assert_eq!((said, note), (vec![("script", 1, 0), ("script", 8, 0)], None));
    assert_eq!(images[1].1.data()[23], 23.0);
    let (_, _, timing) = rendered(params.clone(), "timing").expect("it renders");
    assert_eq!(timing.entries.iter().map(|e| e.took.wall_s.clone()).collect::<Vec<_>>(), [[0.5, 0.25], [4.0, 2.0]]);
    // Another script is another renderer.
    let environment = |params: &_| ExternalRenderer::environment(params, "main", &Act).expect("it may ask");
    let before = environment(&params);
    assert!(before["program"].as_object().is_some_and(|of| of.len() == 2), "{before}");
    fs::write(folder.path().join("render.sh"), "exit 1 # not the same\n").expect("writable");
    assert_ne!(environment(&params), before);
    let version = ["echo", "3.9.1"].map(str::to_owned).to_vec();
    let told = environment(&ExternalRendererParams { version, ..params });
    assert_eq!(told["version"], "3.9.1");
}

/// Notes what it is asked, and runs nothing.
struct Noted(RefCell<Vec<Value>>);

impl Probe for Noted {
    fn answer(&self, question: &Value, _ask: &dyn Fn() -> Value) -> Option<Value> {
        self.0.borrow_mut().push(question.clone());
        Some("as before".into())
    }
}

#[test]
fn looking_asks_no_program_for_its_version() {
    let folder = tempfile::tempdir().expect("a folder");
    let (script, trace) = (folder.path().join("version.sh"), folder.path().join("trace"));
    let script_text = script.to_string_lossy().into_owned();
    fs::write(&script, format!("echo here >> {}\necho 3\n", trace.display())).expect("writable");
    let version = vec!["sh".to_owned(), script_text.clone()];
    let params = ExternalRendererParams { version, ..renderer(folder.path(), SOUND) };
    assert_eq!(ExternalRenderer::environment(&params, "main", &Look), None);
    let noted = Noted(RefCell::default());
    let known = ExternalRenderer::environment(&params, "main", &noted).expect("there is an answer");
    assert_eq!(known["version"], "as before");
    assert!(!trace.exists(), "nothing ran");
    // What was asked holds the program and its script by their contents, and the machine.
    fs::write(&script, format!("echo here >> {}\necho 4\n", trace.display())).expect("writable");
    ExternalRenderer::environment(&params, "main", &noted).expect("there is an answer");
    let questions = noted.0.into_inner();
    assert_ne!(questions[0], questions[1], "another script is another question");
    assert!(questions[0]["files"]["sh"].is_string() && questions[0]["files"][&script_text].is_string());
    assert!(questions[0]["machine"]["cores"].is_u64(), "{}", questions[0]);
    let acted = ExternalRenderer::environment(&params, "main", &Act).expect("it may ask");
    assert!(acted["version"] == "4" && trace.exists());
}

#[test]
fn dependencies_enter_keys_and_empty_lists_do_not() {
    let folder = tempfile::tempdir().expect("a folder");
    let weights = folder.path().join("weights");
    let command = program(folder.path(), "true\n");
    let bare = ExternalDenoiserParams { command: command.clone(), ..ExternalDenoiserParams::default() };
    let row = kinds().into_iter().find(|kind| kind.spec().name == "external_denoiser").expect("a kind");
    let keyed = row.keyed(&serde_json::to_value(&bare).expect("plain"));
    assert!(keyed.get("depends").is_none() && keyed.get("version").is_none() && keyed.get("command").is_some());
    let environment = |params: &_| ExternalDenoiser::environment(params, "main", &Act).expect("it may ask");
    let fields: Vec<String> = environment(&bare).as_object().expect("an object").keys().cloned().collect();
    assert_eq!(fields, ["machine", "oidn", "program", "variables"]);
    let depends = vec![weights.to_string_lossy().into_owned()];
    let version = ["echo", "7"].map(str::to_owned).to_vec();
    let full = ExternalDenoiserParams { depends: depends.clone(), version, ..bare };
    let missing = environment(&full);
    assert_eq!(missing["version"], "7");
    let bench = Bench::new(&scene().0);
    let error = bench.run::<ExternalDenoiser>(full.clone(), "main").expect_err("no file").to_string();
    assert!(error.contains("weights`, which does not exist"), "{error}");
    fs::write(&weights, "1").expect("writable");
    assert_ne!(environment(&full), missing);
    let alone = ExternalDenoiserParams { command: Vec::new(), ..full };
    let pointers: Vec<String> = ExternalDenoiser::check(&alone).into_iter().map(|problem| problem.pointer).collect();
    assert_eq!(pointers, ["/depends", "/version"]);
    let renderer = ExternalRendererParams { depends, ..renderer(folder.path(), SOUND) };
    let before = ExternalRenderer::environment(&renderer, "main", &Act).expect("it may ask");
    fs::write(&weights, "22").expect("writable");
    assert_ne!(ExternalRenderer::environment(&renderer, "main", &Act).expect("it may ask"), before);
}

#[test]
fn a_library_that_is_missing_and_one_that_cannot_be_loaded_differ() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("libOpenImageDenoise.so");
    let library = Some(file.to_string_lossy().into_owned());
    let params = ExternalDenoiserParams { library, ..ExternalDenoiserParams::default() };
    let key = || ExternalDenoiser::environment(&params, "main", &Look).expect("nothing is asked")["oidn"].clone();
    let (scene, _) = scene();
    let bench = Bench::new(&scene);
    let message = || bench.run::<ExternalDenoiser>(params.clone(), "main").expect_err("no library").to_string();
    let (no_key, no_message) = (key(), message());
    fs::write(&file, "this is no library").expect("writable");
    let (bad_key, bad_message) = (key(), message());
    assert_eq!(no_key["not there"], file.to_string_lossy().as_ref(), "{no_key}");
    assert_ne!(no_key, bad_key);
    assert!(no_message.contains("does not exist") && bad_message.contains("cannot load"), "{bad_message}");
}

#[test]
fn renderers_that_fail_are_told() {
    let folder = tempfile::tempdir().expect("a folder");
    for (text, group, expected) in [
        ("echo no licence >&2; exit 3\n", "main", "no licence"),
        ("cp IMAGE \"$5/1.exr\"\n", "main", "`8.exr`"),
        ("true\n", "timing", "times.json"),
        (
            "echo '{\"1\": {\"wall_s\": [1, 2], \"cpu_s\": [1, 2]}}' > \"$5/times.json\"\n",
            "timing",
            "none of 8 samples",
        ),
        ("echo '{\"1\": {\"wall_s\": [1], \"cpu_s\": [1]}}' > \"$5/times.json\"\n", "timing", "2 of each kind"),
    ] {
        let error = rendered(renderer(folder.path(), text), group).expect_err("it fails").to_string();
        assert!(error.contains(expected) && error.contains("render.sh"), "{error}");
    }
    let large =
        ExternalRendererParams { resolution: Resolution::new(5, 2).expect("small"), ..renderer(folder.path(), SOUND) };
    assert!(rendered(large, "main").expect_err("another size").to_string().contains("expected 5 x 2"));
    let missing = ExternalRendererParams {
        command: ["/no/such/program", "{scene}", "{counts}", "{folder}"].map(str::to_owned).to_vec(),
        ..renderer(folder.path(), SOUND)
    };
    assert!(rendered(missing.clone(), "main").expect_err("required").to_string().contains("/no/such/program"));
    let version = ["sh", "-c", "echo no module named mitsuba >&2; exit 1"].map(str::to_owned).to_vec();
    let unfit = ExternalRendererParams { version, ..renderer(folder.path(), SOUND) };
    for (params, expected) in [(missing, "/no/such/program"), (unfit, "no module named mitsuba")] {
        let (images, note, _) =
            rendered(ExternalRendererParams { required: false, ..params }, "main").expect("left out");
        assert!(images.is_empty() && note.is_some_and(|note| note.contains(expected)));
    }
    let bad = ExternalRendererParams {
        command: vec!["render".into(), "{scenes}".into()],
        ..ExternalRendererParams::default()
    };
    assert!(!ExternalRenderer::check(&bad).is_empty());
    let forgotten = ExternalRenderer::check(&ExternalRendererParams::default());
    assert!(forgotten.iter().any(|problem| problem.pointer == "/command"), "{forgotten:?}");
}
