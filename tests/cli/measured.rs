//! Measurements of other machines: accepted from an upstream, or made by jobs on a class of nodes.
//!
//! A limit of threads is part of what a machine is to a measurement. Here it stands for another machine.

use crate::{
    Place, Said,
    jobs::{SHELL, Scheduler, with_hyperqueue, with_slurm},
};
use std::{collections::BTreeSet, fs, path::PathBuf, process::Command};
use tauflow_cache::Store;

const TIMED: &str = "\
pipeline: small
seed: 3
profiles: { more: { scenes.pool: 10 } }
targets: [ladders, ladders.timing]
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 8, views: [1, 1], regimes: [L0], contexts: [open, enclosed], diffuse: { textured: 0.0 } }
  ladders:
    kind: ladder_rendering
    inputs: { scenes: scenes }
    params: { rungs: [1, 2], resolution: [8, 8] }
";

/// The program on a machine with this limit of threads.
fn with_threads(mut command: Command, threads: &str) -> Said {
    Said::of(&command.env("RAYON_NUM_THREADS", threads).output().expect("the program starts"))
}

/// Timings in a cache: the limits of threads of the machines that measured them, and how many there are.
fn measured(cache: PathBuf) -> (BTreeSet<String>, usize) {
    let store = Store::open_existing(&cache).expect("a store");
    let mut machines = BTreeSet::new();
    let mut count = 0;
    for record in store.by_label("action", "ladder_rendering") {
        let key: serde_json::Value = serde_json::from_str(&record.preimage).expect("JSON");
        if key["group"] == "timing" {
            machines.insert(key["environment"]["threads"].as_str().expect("a machine").to_owned());
            count += 1;
        }
    }
    (machines, count)
}

/// The times that a machine shows, as text.
fn shown(place: &Place, machine: &str, threads: &str) -> String {
    let out = format!("shown-{machine}");
    let _ = fs::remove_dir_all(place.path(&out)); // of an earlier look
    let export = place.machine(machine, &["export", "small.yaml", "ladders.timing", "--out", &out]);
    with_threads(export, threads).ends(0);
    let mut files: Vec<PathBuf> = Vec::new();
    let mut open = vec![place.path(&out)];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).expect("readable").flatten() {
            if entry.path().is_dir() { open.push(entry.path()) } else { files.push(entry.path()) }
        }
    }
    files.sort();
    assert!(!files.is_empty());
    files.iter().map(|path| fs::read_to_string(path).expect("a text")).collect()
}

#[test]
fn measurements_of_another_machine_are_accepted_only_on_request_and_stay_its_own() {
    let place = Place::with(TIMED);
    let on = |machine: &str, threads: &str, words: &[&str]| with_threads(place.machine(machine, words), threads);
    let run =
        |machine: &str, threads: &str, more: &[&str]| on(machine, threads, &[&["run", "small.yaml"], more].concat());
    let said = run("b", "2", &["--accept-measured"]).ends(2);
    assert!(said.err.contains("no measurements of another machine"), "{}", said.err);
    run("a", "1", &[]).ends(0);
    on("a", "1", &["cache", "push", "small.yaml", "--all"]).ends(0);
    let theirs = shown(&place, "a", "1");
    // Without the option only times are measured again.
    let said = run("b", "2", &[]).ends(0);
    assert!(said.err.contains("8 actions ran, 16 as before"), "{}", said.err);
    assert_eq!(measured(place.path("b")), (BTreeSet::from(["2".to_owned()]), 8));
    // With it nothing runs, and the machine is named. Commands that run nothing show its times.
    let said = run("c", "2", &["--accept-measured"]).ends(0);
    let host = fs::read_to_string("/proc/sys/kernel/hostname").expect("Linux has it");
    assert!(said.err.contains("nothing to do"), "{}", said.err);
    assert!(said.err.contains(&format!("measurements: accepted from {} (", host.trim())), "{}", said.err);
    assert_eq!(shown(&place, "c", "2"), theirs);
    let plan = on("c", "2", &["plan", "small.yaml"]).ends(0);
    assert!(plan.out.contains("nothing to do") || plan.err.contains("nothing to do"), "{plan:?}");
    // After an edit, images are rendered; times that the other machine did not measure fail.
    let said = run("c", "2", &["--accept-measured", "--profile", "more"]).ends(1);
    assert!(said.err.contains("did not measure this") && said.err.contains("2 failed"), "{}", said.err);
    // Later, they are not taken for measurements of this machine.
    let said = run("c", "2", &[]).ends(0);
    assert!(said.err.contains("8 actions ran"), "{}", said.err);
    assert!(!said.err.contains("measurements: "), "{}", said.err);
    assert_ne!(shown(&place, "c", "2"), theirs);
    // A lost one is not measured here for the other machine.
    run("d", "2", &["--accept-measured"]).ends(0);
    fs::remove_dir_all(place.path("shared")).expect("our own");
    let said = on("d", "2", &["export", "small.yaml", "ladders.timing", "--out", "lost", "--upstream", ""]);
    assert!(said.err.contains("stale") || said.err.contains("did not measure this"), "{}", said.err);
    assert!(measured(place.path("d")).0.iter().all(|threads| threads == "1"));
}

#[test]
fn of_several_machines_one_is_named() {
    let place = Place::with(TIMED);
    for (machine, threads) in [("a", "1"), ("b", "2")] {
        with_threads(place.machine(machine, &["run", "small.yaml"]), threads).ends(0);
        with_threads(place.machine(machine, &["cache", "push", "small.yaml", "--all"]), threads).ends(0);
    }
    let run = |more: &str| with_threads(place.machine("c", &["run", "small.yaml", more]), "3");
    let said = run("--accept-measured").ends(2);
    assert!(said.err.contains("several machines measured") && said.err.contains("name one"), "{}", said.err);
    // One host that measured with other settings has a name for each.
    let host = fs::read_to_string("/proc/sys/kernel/hostname").expect("Linux has it");
    let said = run(&format!("--accept-measured={}", host.trim())).ends(2);
    let (_, named) = said.err.split_once("name one, as in ").expect("a name");
    let named = run(named.trim()).ends(0);
    assert!(named.err.contains("nothing to do"), "{}", named.err);
    let said = run("--accept-measured=nobody").ends(2);
    assert!(said.err.contains("no measurements of `nobody`"), "{}", said.err);
}

/// Options under which jobs run with one thread.
fn shell() -> Scheduler {
    let mut scheduler = Scheduler { options: SHELL.to_vec(), variables: Vec::new() };
    let at = scheduler.options.iter().position(|option| *option == "--submit").expect("it is there") + 1;
    scheduler.options[at] =
        "echo class={class} >> asked; RAYON_NUM_THREADS=1 setsid sh {script} > {log} 2>&1 < /dev/null & echo $!";
    scheduler
}

fn times_are_measured_on_the_class(scheduler: &Scheduler, more: &[&str]) -> Place {
    let place = Place::with(TIMED);
    let run = |more: &[&str]| with_threads(scheduler.command(&place, more), "2");
    let there = [&["--timing", "bench"], more].concat();
    let said = run(&there).ends(0);
    assert!(said.err.contains("measurements: made on ") && !said.err.contains("warning"), "{}", said.err);
    assert_eq!(measured(place.path("store")), (BTreeSet::from(["1".to_owned()]), 8), "{}", said.err);
    // Nothing is left to do, so no job is needed to know it.
    let said = run(&there).ends(0);
    assert!(said.err.contains("nothing to do") && !said.err.contains("jobs: "), "{}", said.err);
    // Measured here, they are other ones.
    let said = run(more).ends(0);
    assert!(said.err.contains("8 actions ran") && !said.err.contains("measurements: "), "{}", said.err);
    assert_eq!(measured(place.path("store")).1, 16);
    place
}

#[test]
fn jobs_of_a_shell_measure_on_a_class_of_nodes() {
    let place = times_are_measured_on_the_class(&shell(), &[]);
    let asked = fs::read_to_string(place.path("asked")).expect("jobs were submitted");
    assert!(asked.lines().any(|line| line == "class=bench"), "{asked}");
    assert!(asked.lines().any(|line| line == "class="), "others run anywhere: {asked}");
}

#[test]
fn jobs_with_a_cache_of_their_own_measure_on_a_class_of_nodes() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name).display().to_string();
    let (upstream, workers) = (at("upstream"), at("workers"));
    times_are_measured_on_the_class(&shell(), &["--upstream", &upstream, "--worker-cache", &workers]);
}

#[test]
fn jobs_of_slurm_measure_alone_on_nodes_with_a_feature() {
    with_slurm(|slurm| {
        // Jobs get this option as well as the one that asks for their machine.
        let threads = "--job-option=--export=ALL,RAYON_NUM_THREADS=1";
        times_are_measured_on_the_class(slurm, &[threads]);
        let mut show = Command::new("scontrol");
        let jobs = show.args(["-o", "show", "jobs"]).envs(slurm.variables.clone()).output().expect("scontrol starts");
        let jobs = String::from_utf8_lossy(&jobs.stdout).into_owned();
        let timed: Vec<&str> = jobs.lines().filter(|line| line.contains("Features=bench")).collect();
        assert!(timed.len() >= 2 && timed.iter().all(|line| line.contains("OverSubscribe=NO")), "{jobs}");
        assert!(timed.iter().any(|line| !line.contains("ReqNodeList=(null)")), "the node is the same: {timed:?}");
        let place = Place::with(TIMED);
        let said = slurm.run(&place, &["--timing", "nothing"]).ends(3);
        assert!(said.err.contains("`--timing nothing`") && said.err.contains("feature"), "{}", said.err);
    });
}

#[test]
fn jobs_of_hyperqueue_measure_alone_on_workers_with_a_resource() {
    with_hyperqueue(|hyperqueue| {
        let place = Place::with(TIMED);
        hyperqueue.run(&place, &["--timing", "bench"]).ends(0);
        let (_, server) = hyperqueue.variables.iter().find(|(name, _)| *name == "HQ_SERVER_DIR").expect("it is set");
        let jobs = fs::read_dir(format!("{server}/jobs")).expect("there were jobs").flatten();
        let told: Vec<String> = jobs.filter_map(|job| fs::read_to_string(job.path().join("options")).ok()).collect();
        assert!(told.iter().any(|options| options.contains("--cpus=all --resource=bench=1")), "{told:?}");
    });
}

#[test]
fn a_class_of_nodes_needs_a_scheduler() {
    let place = Place::with(TIMED);
    let said = place.tauflow(&["run", "small.yaml", "--timing", "bench"]).ends(2);
    assert!(said.err.contains("--timing bench needs --executor slurm"), "{}", said.err);
    place.tauflow(&["run", "small.yaml", "--timing", "local"]).ends(0);
    let said = place.tauflow(&["run", "small.yaml", "--executor", "slurm", "--timing", "a b"]).ends(2);
    assert!(said.err.contains("is no class of nodes"), "{}", said.err);
    // The configuration names it for all runs on a scheduler, and for no others.
    fs::create_dir_all(place.path("config/tauflow")).expect("writable");
    place.write("config/tauflow/config.yaml", "timing: bench\n");
    let configured = |words: &[&str]| {
        let mut command = place.command(words);
        Said::of(&command.env("XDG_CONFIG_HOME", place.path("config")).output().expect("the program starts"))
    };
    configured(&["run", "small.yaml"]).ends(0);
    let mut options = shell().options;
    options.splice(0..0, ["run", "small.yaml"]);
    let said = configured(&options).ends(0);
    assert!(said.err.contains("measurements: made on "), "{}", said.err);
}
