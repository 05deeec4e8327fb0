//! `exec` of actions that run programs and libraries: what they are told of the environment, whose they are, when they
//! end, and what a sandbox keeps them from.

use crate::{Place, Said, json};
use std::{
    fs,
    os::unix::fs::PermissionsExt,
    path::Path,
    process::{Child, Command},
    thread,
    time::{Duration, Instant},
};
use tauflow::engine::exec;
use tauflow_cache::Store;
use tauflow_data::{Image, image_io::write_exr};
use tauflow_testing::{Need, set, skip};

/// A renderer that `bin/fake-renderer` is, and a version that is told by `version.sh`.
const PIPELINE: &str = "\
pipeline: small
seed: 3
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 2, regimes: [L0], contexts: [open] }
  rendered:
    kind: external_renderer
    inputs: { scenes: scenes }
    params:
      method: fake
      version: [sh, HERE/version.sh]
      command: [fake-renderer, \"{scene}\", \"{counts}\", \"{folder}\"]
      counts: [1]
      resolution: [4, 2]
      required: true
";

/// What the renderer does beside its work is decided by files that it finds.
const RENDERER: &str = "\
#!/bin/sh
test -z \"$SECRET\" || { echo it knows the secret >&2; exit 9; }
if test -e HERE/stay; then
    sleep 600 &
    echo $! > HERE/child.new
    setsid sleep 600 &
    echo $! > HERE/stray
    echo \"$TMPDIR\" > HERE/tmpdir
    mv HERE/child.new HERE/child
    wait
fi
if test -e HERE/escape; then
    echo out > HERE/escaped
fi
if test -e HERE/lonely; then
    test \"$(grep -c : /proc/net/dev)\" = 1 || { echo there is a network >&2; exit 8; }
fi
if test -e HERE/away; then
    test ! -e \"$(cat HERE/away)\" || { echo it sees what others left in /tmp >&2; exit 7; }
fi
cp HERE/image.exr \"$3/1.exr\"
";

/// A folder with a pipeline that renders with a program found by PATH.
pub fn with_renderer() -> Place {
    renderer_in(Place::new())
}

fn renderer_in(place: Place) -> Place {
    let here = place.path("").display().to_string();
    let here = here.trim_end_matches('/');
    place.write("small.yaml", &PIPELINE.replace("HERE", here));
    place.write("version.sh", &format!("touch {here}/asked\necho 1\n"));
    fs::create_dir(place.path("bin")).expect("writable");
    place.write("bin/fake-renderer", &RENDERER.replace("HERE", here));
    fs::set_permissions(place.path("bin/fake-renderer"), fs::Permissions::from_mode(0o755)).expect("our own");
    write_exr(&place.path("image.exr"), &[("", &Image::new(4, 2, 3))]).expect("writable");
    place
}

/// Runs the program with these variables and where programs are.
pub fn with(place: &Place, arguments: &[&str], variables: &[(&str, &str)]) -> Said {
    let path = format!("{}:{}", place.path("bin").display(), std::env::var("PATH").unwrap_or_default());
    let mut command = place.command(arguments);
    command.env("PATH", path).env_remove("RAYON_NUM_THREADS").env("SECRET", "").envs(variables.iter().copied());
    Said::of(&command.output().expect("the program starts"))
}

/// Keys of the recorded actions of a kind.
fn keys(place: &Place, kind: &str) -> Vec<String> {
    let store = Store::open(&place.path("store")).expect("a store");
    let of_kind = |key: &tauflow_cache::Key| store.lookup("action", key).is_some_and(|record| record.label == kind);
    exec::recorded(&store).iter().filter(|key| of_kind(key)).map(tauflow_cache::Key::hex).collect()
}

/// A renderer's action that has been run, and is known by its key.
fn rendered(place: &Place, variables: &[(&str, &str)]) -> String {
    with(place, &["run", "small.yaml"], variables).ends(0);
    keys(place, "external_renderer").swap_remove(0)
}

#[test]
fn a_program_is_found_by_path_and_knows_nothing_else_of_the_environment() {
    let place = with_renderer();
    let key = rendered(&place, &[]);
    let done = with(&place, &["exec", &key], &[("SECRET", "42")]).ends(0);
    let done = json(&done.out);
    assert_eq!((&done["kind"], &done["new"]), (&"external_renderer".into(), &false.into()));
    // Where there is no such program, it is told which and where.
    let mut bare = place.command(&["exec", &key]);
    let none = Said::of(&bare.env("PATH", "/usr/bin:/bin").output().expect("the program starts")).ends(3);
    assert!(none.err.contains("`program.fake-renderer` is \""), "{}", none.err);
    assert!(none.err.contains("in the key, but absent on this machine"), "{}", none.err);
}

#[test]
fn an_action_is_printed_without_making_a_cache_and_its_params_are_held_to_the_schema() {
    let place = with_renderer();
    let none = place.command(&["exec", "00", "--print"]).env("TAUFLOW_CACHE", place.path("nowhere")).output();
    assert_eq!(Said::of(&none.expect("the program starts")).code, 2);
    assert!(!place.path("nowhere").exists());
    let key = rendered(&place, &[]);
    let action = with(&place, &["exec", &key, "--print"], &[]).ends(0).out;
    let mut action = json(&action);
    assert_eq!(action["key"]["params"]["counts"], serde_json::json!([1]), "{action}");
    action["key"]["params"]["counts"] = serde_json::json!([0]);
    place.write("action.json", &action.to_string());
    let told = with(&place, &["exec", "action.json"], &[]).ends(2);
    assert!(told.err.contains("`/counts"), "{}", told.err);
    let strange = with(&place, &["exec", "/dev/zero"], &[]).ends(2);
    assert!(strange.err.contains("not a regular file"), "{}", strange.err);
}

#[test]
fn an_action_of_other_threads_is_refused_and_both_are_named() {
    let place = with_renderer();
    let key = rendered(&place, &[("RAYON_NUM_THREADS", "2")]);
    let recorded = keys(&place, "external_renderer");
    for (threads, here) in [("1", "1"), ("", "")] {
        let foreign = with(&place, &["exec", &key], &[("RAYON_NUM_THREADS", threads)]).ends(3);
        let told = format!("`machine.threads` is \"2\" in the key, but \"{here}\" on this machine");
        assert!(foreign.err.contains(&told), "{}", foreign.err);
    }
    // From a file, into another store, too: nothing is filed there.
    let action = with(&place, &["exec", &key, "--print"], &[]).ends(0).out;
    place.write("action.json", &action);
    with(&place, &["exec", "action.json"], &[("RAYON_NUM_THREADS", "1")]).ends(3);
    assert_eq!(keys(&place, "external_renderer"), recorded);
    with(&place, &["exec", &key], &[("RAYON_NUM_THREADS", "2")]).ends(0);
}

/// Whether a process is there and is not a dead one that nobody has waited for.
fn lives(process: &str) -> bool {
    let told = fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    told.rsplit(") ").next().is_some_and(|rest| !rest.is_empty() && !rest.starts_with('Z'))
}

/// What a file says, as soon as it is there.
fn told(file: &Path) -> String {
    let start = Instant::now();
    while !file.exists() && start.elapsed() < Duration::from_secs(120) {
        thread::sleep(Duration::from_millis(10));
    }
    fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", file.display())).trim().to_owned()
}

/// What the renderer left is gone: its child, one that has left its group, and its folder.
fn all_is_gone(place: &Place) {
    for name in ["child", "stray"] {
        assert!(!lives(&told(&place.path(name))), "the {name} of the program is gone");
    }
    let folder = told(&place.path("tmpdir"));
    assert!(!folder.is_empty() && !Path::new(&folder).parent().expect("it has one").exists(), "{folder}");
}

/// `exec` of an action whose program stays and has started others.
fn that_stays(place: &Place, key: &str) -> Child {
    place.write("stay", "");
    let path = format!("{}:{}", place.path("bin").display(), std::env::var("PATH").unwrap_or_default());
    let mut command = place.command(&["exec", key]);
    let running = command.env("PATH", path).env_remove("RAYON_NUM_THREADS").spawn().expect("it starts");
    told(&place.path("child"));
    running
}

#[test]
fn a_limit_ends_what_the_programs_of_an_action_started_and_clears_its_folder() {
    let place = with_renderer();
    let key = rendered(&place, &[]);
    place.write("stay", "");
    let late = with(&place, &["exec", &key, "--limit", "8s"], &[]).ends(1);
    assert!(late.err.contains("stopped at its time limit"), "{}", late.err);
    all_is_gone(&place);
    // Without what made it stay it is as before.
    fs::remove_file(place.path("stay")).expect("it was there");
    with(&place, &["exec", &key, "--limit", "5m"], &[]).ends(0);
}

#[test]
fn ctrl_c_ends_what_the_programs_of_an_action_started() {
    let place = with_renderer();
    let key = rendered(&place, &[]);
    let mut running = that_stays(&place, &key);
    let kill = Command::new("kill").args(["-INT", &running.id().to_string()]).status();
    assert!(kill.is_ok_and(|status| status.success()));
    assert_eq!(running.wait().expect("our own").code(), Some(130));
    all_is_gone(&place);
}

#[test]
fn a_kill_of_exec_ends_what_the_programs_of_an_action_started() {
    let place = with_renderer();
    let key = rendered(&place, &[]);
    let mut running = that_stays(&place, &key);
    running.kill().expect("our own");
    running.wait().expect("our own");
    // Nobody tells when: the action's process learns of it, and its folder goes last.
    let folder = told(&place.path("tmpdir"));
    let (start, whole) = (Instant::now(), Path::new(&folder).parent().expect("it has one"));
    while whole.exists() && start.elapsed() < Duration::from_secs(60) {
        thread::sleep(Duration::from_millis(10));
    }
    all_is_gone(&place);
}

#[test]
fn a_sandbox_keeps_an_action_from_writing_elsewhere_and_where_there_is_none_that_is_told() {
    // Folders for what is temporary are hidden, with the sockets in them: programs lie elsewhere.
    let place = renderer_in(Place::within(Path::new(env!("CARGO_TARGET_TMPDIR")), ""));
    let key = rendered(&place, &[]);
    let mut bare = place.command(&["exec", &key, "--sandbox"]);
    let none = Said::of(&bare.env("PATH", place.path("bin")).output().expect("the program starts")).ends(3);
    assert!(
        none.err.contains("the program `bwrap` is not installed") && none.err.contains("--sandbox"),
        "{}",
        none.err
    );
    let held = with(&place, &["exec", &key, "--sandbox"], &[]);
    if held.err.contains("cannot create a sandbox") {
        assert_eq!(held.code, 3);
        skip(Need::Bwrap, &held.err);
        return;
    }
    held.ends(0);
    // Without it, it gets out.
    place.write("escape", "");
    with(&place, &["exec", &key], &[]).ends(0);
    fs::remove_file(place.path("escaped")).expect("it was written");
    with(&place, &["exec", &key, "--sandbox"], &[]);
    assert!(!place.path("escaped").exists());
    // It sees no network but its own.
    fs::remove_file(place.path("escape")).expect("it was there");
    place.write("lonely", "");
    with(&place, &["exec", &key, "--sandbox"], &[]).ends(0);
    fs::remove_file(place.path("lonely")).expect("it was there");
    let others = tempfile::NamedTempFile::new().expect("a temporary file");
    place.write("away", &others.path().display().to_string());
    with(&place, &["exec", &key], &[]).ends(1);
    with(&place, &["exec", &key, "--sandbox"], &[]).ends(0);
    // Its time ends it, too.
    let late = with(&place, &["exec", &key, "--sandbox", "--limit", "0s"], &[]).ends(1);
    assert!(late.err.contains("stopped at its time limit"), "{}", late.err);
}

/// Endpoints of a scene, denoised.
const DENOISED: &str = "\
pipeline: small
seed: 3
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 2, regimes: [L0], contexts: [open] }
  previews:
    kind: ladder_rendering
    inputs: { scenes: scenes }
    params: { rungs: { dyadic: 16 }, resolution: [16, 16] }
  gate:
    kind: quality_gate
    inputs: { scenes: scenes, previews: previews }
  endpoints:
    kind: dataset_packing
    inputs: { ladders: previews, gbuffers: previews.gbuffer, exposure: gate.exposure }
  denoised:
    kind: external_denoiser
    inputs: { endpoints: endpoints }
    params: { from: 1, required: true }
";

#[test]
fn an_action_of_open_image_denoise_moves_to_where_the_same_library_is() {
    let Some(library) = set("TAUFLOW_OIDN") else {
        skip(Need::Oidn, "TAUFLOW_OIDN names no library of Open Image Denoise");
        return;
    };
    let place = Place::with(DENOISED);
    with(&place, &["run", "small.yaml"], &[]).ends(0);
    let keys = keys(&place, "external_denoiser");
    assert!(!keys.is_empty());
    with(&place, &["exec", &keys[0]], &[]).ends(0);
    // Elsewhere is the same library to the byte; a file more that it would load is another one.
    let (from, to) = (Path::new(&library).parent().expect("a file").to_owned(), place.path("lib"));
    fs::create_dir(&to).expect("writable");
    for entry in fs::read_dir(from).expect("readable").map(|entry| entry.expect("readable")) {
        if entry.path().is_file() {
            fs::copy(entry.path(), to.join(entry.file_name())).expect("room");
        }
    }
    let name = Path::new(&library).file_name().expect("a file").to_string_lossy().into_owned();
    let there = to.join(&name).display().to_string();
    with(&place, &["exec", &keys[0]], &[("TAUFLOW_OIDN", &there)]).ends(0);
    with(&place, &["exec", &keys[0]], &[("TAUFLOW_OIDN", &format!("lib/{name}"))]).ends(0);
    fs::write(to.join("libtbb.so.99"), "another").expect("writable");
    let other = with(&place, &["exec", &keys[0]], &[("TAUFLOW_OIDN", &there)]).ends(3);
    assert!(other.err.contains("`oidn.libtbb`"), "{}", other.err);
    let none = with(&place, &["exec", &keys[0]], &[("TAUFLOW_OIDN", "/no/such/library.so")]).ends(3);
    assert!(none.err.contains("/no/such/library.so"), "{}", none.err);
    let plan = with(&place, &["plan", "small.yaml"], &[]).ends(0);
    assert!(plan.out.contains("nothing to do"), "{}", plan.out);
}

/// A program that reads `state`, says so, and goes on when it may.
const READER: &str = "\
pipeline: small
nodes:
  step:
    kind: command
    params:
      mode: gather
      run: [sh, HERE/step.sh]
      reproducible: everywhere
      outputs: { files: tauflow/files }
";

#[test]
fn a_file_that_changes_while_a_program_runs_spoils_no_run() {
    for executor in ["threads", "process"] {
        let place = Place::new();
        let here = place.path("").display().to_string();
        place.write("small.yaml", &READER.replace("HERE/", &here));
        let step = "cat HERE/state; touch HERE/begun; until test -e HERE/go; do sleep 0.05; done\n\
                    mkdir out/files/one; echo 1 > out/files/one/a.txt";
        place.write("step.sh", &step.replace("HERE/", &here));
        place.write("state", "before");
        let mut run = place.command(&["run", "small.yaml", "--executor", executor]);
        let run = run.stderr(std::process::Stdio::piped()).stdout(std::process::Stdio::piped());
        let mut run = run.spawn().expect("the program starts");
        while !place.path("begun").exists() && run.try_wait().expect("a child of ours").is_none() {
            thread::sleep(Duration::from_millis(20));
        }
        place.write("state", "after, and longer");
        place.write("go", "");
        let said = Said::of(&run.wait_with_output().expect("it ends")).ends(0);
        assert!(said.err.contains("1 action ran"), "{executor}: {}", said.err);
        // What it read is not there any more.
        let said = place.tauflow(&["run", "small.yaml", "--executor", executor]).ends(0);
        assert!(said.err.contains("1 action ran"), "{executor}: {}", said.err);
    }
}
