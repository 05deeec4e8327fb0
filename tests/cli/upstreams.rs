//! Machines that share results through a folder: here, two caches.

use crate::{Place, Said};
use std::{fs, os::unix::fs::PermissionsExt, process::Command};

impl Place {
    /// The program on a machine with a cache of its own, which knows of the upstream.
    pub fn machine(&self, machine: &str, arguments: &[&str]) -> Command {
        let mut command = self.command(arguments);
        command.env("TAUFLOW_CACHE", self.path(machine)).env("TAUFLOW_UPSTREAM", self.path("shared"));
        command
    }

    pub fn on(&self, machine: &str, arguments: &[&str]) -> Said {
        Said::of(&self.machine(machine, arguments).output().expect("the program starts"))
    }

    /// The same on a machine that knows of no upstream.
    pub fn off(&self, machine: &str, arguments: &[&str]) -> Said {
        self.on(machine, &[arguments, &["--upstream", ""]].concat())
    }
}

#[test]
fn what_one_machine_ran_is_up_to_date_on_another() {
    let place = Place::new();
    let run = ["run", "small.yaml"];
    place.off("a", &run).ends(0);
    let pushed = place.on("a", &["cache", "push"]).ends(0).out;
    assert!(pushed.starts_with("pushed ") && pushed.ends_with(" 0 there already\n"), "{pushed}");
    let pulled = place.on("b", &["cache", "pull"]).ends(0).out;
    assert!(pulled.starts_with("pulled ") && pulled.ends_with(" 0 here already\n"), "{pulled}");
    let said = place.off("b", &run).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
    // Item by item, too.
    let said = place.off("b", &[&run[..], &["--no-rollup"]].concat()).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
    place.on("b", &["cache", "verify"]).ends(0);
    // Now what only the other machine has goes back.
    place.on("b", &[&run[..], &["--profile", "more"]].concat()).ends(0);
    let dry = place.on("b", &["cache", "push", "--dry-run"]).ends(0).out;
    let pushed = place.on("b", &["cache", "push"]).ends(0).out;
    assert_eq!(dry.replacen("would push", "pushed", 1), pushed);
    place.on("a", &["cache", "pull"]).ends(0);
    let said = place.off("a", &[&run[..], &["--profile", "more"]].concat()).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
    let shared = place.path("shared").display().to_string();
    let stat = place.on("a", &["cache", "stat", "--upstream", &shared]).ends(0).out;
    assert!(stat.contains("2 packs with 2 indices"), "{stat}");
}

#[test]
fn damage_is_a_note_and_the_run_makes_the_rest() {
    let place = Place::new();
    place.on("a", &["run", "small.yaml"]).ends(0);
    place.on("a", &["cache", "push"]).ends(0);
    for entry in fs::read_dir(place.path("shared/packs")).expect("readable") {
        let path = entry.expect("readable").path();
        if path.extension().is_some_and(|extension| extension == "pack") {
            let bytes = fs::read(&path).expect("readable");
            fs::write(&path, &bytes[..bytes.len() / 2]).expect("writable");
        }
    }
    let said = place.on("b", &["cache", "pull"]).ends(1);
    assert!(said.err.contains("note: pack ") && said.err.contains("is missing or truncated"), "{}", said.err);
    assert!(said.out.contains("left out, because blobs are missing or damaged"), "{}", said.out);
    place.on("b", &["run", "small.yaml"]).ends(0);
    place.on("b", &["cache", "verify"]).ends(0);
}

#[test]
fn an_upstream_that_is_none_is_an_error_with_a_remedy() {
    let place = Place::new();
    for words in [&["pull"][..], &["push", "--dry-run"]] {
        let said = place.tauflow(&[&["cache"], words].concat()).ends(2);
        assert!(said.err.contains("give --upstream DIR") || said.err.contains("no cache in"), "{}", said.err);
    }
    for url in ["s3://me:secret@bucket/lab", "https://lab.example/x?sig=secret"] {
        let said = place.tauflow(&["cache", "pull", "--upstream", url]).ends(2);
        assert!(said.err.contains("from the environment only") && !said.err.contains("secret"), "{}", said.err);
    }
    let said = place.tauflow(&["cache", "pull", "--upstream", "ftp://lab.example"]).ends(2);
    assert!(said.err.contains("unknown scheme `ftp`"), "{}", said.err);
    let said = place.tauflow(&["cache", "pull", "--upstream", "nowhere"]).ends(3);
    assert!(said.err.contains("nowhere"), "{}", said.err);
    let said = place.tauflow(&["cache", "pull", "--upstream", "."]).ends(2);
    assert!(said.err.contains("is not an upstream"), "{}", said.err);
    assert!(!place.path("store").exists(), "looking for an upstream makes no cache");
}

#[test]
fn a_machine_with_an_empty_cache_runs_nothing_that_the_upstream_has() {
    let place = Place::new();
    let said = place.on("a", &["run", "small.yaml", "--push"]).ends(0);
    assert!(said.err.contains("pushed ") && !said.err.contains("note: "), "{}", said.err);
    for (machine, more) in [("b", &[][..]), ("c", &["--no-rollup"]), ("d", &["--executor", "process"])] {
        let plan = place.on(machine, &["plan", "small.yaml"]).ends(0);
        assert!(plan.out.contains("nothing to do") || plan.err.contains("nothing to do"), "{plan:?}");
        let said = place.on(machine, &[&["run", "small.yaml"], more].concat()).ends(0);
        assert!(said.err.contains("nothing to do"), "{}", said.err);
        assert!(!said.err.contains("note: "), "{}", said.err);
    }
    place.on("b", &["cache", "verify"]).ends(0);
    // An export reads blobs that only the upstream has.
    place.on("b", &["export", "small.yaml", "scenes", "--out", "exported"]).ends(0);
    // The same outputs, and an edit runs its own actions only.
    let digests = |machine: &str| {
        place.on(machine, &["run", "small.yaml", "--update-lock"]).ends(0);
        fs::read_to_string(place.path("small.lock")).expect("it was written")
    };
    assert_eq!(digests("a"), digests("b"));
    let edited = &["run", "small.yaml", "--profile", "more", "--events", "json"];
    let ran = |said: Said| said.lines().iter().filter(|line| line.contains("\"outcome\":\"ran\"")).count();
    let (alone, shared) = (ran(place.off("e", edited).ends(0)), ran(place.on("b", edited).ends(0)));
    assert!(shared > 0 && shared + 8 <= alone, "{shared} of {alone} ran");
}

#[test]
fn an_upstream_is_chosen_by_option_environment_or_configuration() {
    let place = Place::new();
    place.on("a", &["run", "small.yaml", "--push"]).ends(0);
    let shared = place.path("shared").display().to_string();
    fs::create_dir_all(place.path("config/tauflow")).expect("writable");
    place.write("config/tauflow/config.yaml", &format!("upstream: {shared}\n"));
    let run = |machine: &str, arguments: &[&str], variable: Option<&str>| {
        let mut command = place.machine(machine, &[&["run", "small.yaml"], arguments].concat());
        command.env("XDG_CONFIG_HOME", place.path("config")).env_remove("TAUFLOW_UPSTREAM");
        command.envs(variable.map(|value| ("TAUFLOW_UPSTREAM", value)));
        Said::of(&command.output().expect("the program starts")).ends(0).err
    };
    assert!(run("b", &[], None).contains("nothing to do"));
    assert!(!run("c", &[], Some("")).contains("nothing to do"), "an empty variable uses none");
    assert!(run("d", &["--upstream", &shared], Some("nowhere")).contains("nothing to do"));
    let err = run("e", &[], Some("nowhere"));
    assert!(err.contains("note: the upstream is not used: ") && err.contains("nowhere"), "{err}");
    assert_eq!(err.matches("note: ").count(), 1, "{err}");
    place.write("config/tauflow/config.yaml", "upstreem: x\n");
    let mut command = place.machine("f", &["run", "small.yaml"]);
    command.env("XDG_CONFIG_HOME", place.path("config")).env_remove("TAUFLOW_UPSTREAM");
    let said = Said::of(&command.output().expect("the program starts")).ends(2);
    assert!(said.err.contains("config.yaml") && said.err.contains("upstreem"), "{}", said.err);
    let said = place.tauflow(&["run", "small.yaml", "--push"]).ends(2);
    assert!(said.err.contains("no upstream: give --upstream DIR"), "{}", said.err);
}

#[test]
fn a_damaged_pack_is_named_once_and_its_results_are_made_again() {
    let place = Place::new();
    place.on("a", &["run", "small.yaml", "--push"]).ends(0);
    for entry in fs::read_dir(place.path("shared/packs")).expect("readable") {
        let path = entry.expect("readable").path();
        if path.extension().is_some_and(|extension| extension == "pack") {
            let bytes = fs::read(&path).expect("readable");
            fs::write(&path, bytes.iter().map(|byte| !byte).collect::<Vec<_>>()).expect("writable");
        }
    }
    let said = place.on("b", &["run", "small.yaml", "--profile", "more"]).ends(0);
    assert_eq!(said.err.matches("note: pack ").count(), 1, "{}", said.err);
    let said = place.off("b", &["run", "small.yaml", "--profile", "more"]).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
}

#[test]
fn a_read_only_upstream_serves_and_a_push_to_it_says_so() {
    let place = Place::new();
    place.on("a", &["run", "small.yaml", "--push"]).ends(0);
    let folders = ["shared", "shared/packs", "shared/tmp"];
    let mode = |mode: u32| {
        for folder in folders {
            fs::set_permissions(place.path(folder), fs::Permissions::from_mode(mode)).expect("own folders");
        }
    };
    mode(0o555);
    let said = place.on("b", &["run", "small.yaml"]).ends(0);
    assert!(said.err.contains("nothing to do") && !said.err.contains("note: "), "{}", said.err);
    // Root may write anywhere.
    let may_write = fs::write(place.path("shared/tmp/probe"), "").is_ok();
    let said = place.on("b", &["run", "small.yaml", "--profile", "more", "--push"]);
    mode(0o755);
    if !may_write {
        let said = said.ends(3);
        assert!(said.err.contains("the results are in the cache, but were not pushed"), "{}", said.err);
    }
    let said = place.on("b", &["run", "small.yaml", "--profile", "more"]).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
}

#[test]
fn machines_that_push_at_once_leave_all_of_it() {
    let place = Place::new();
    let run = |machine: &str, pool: &str| {
        place.machine(machine, &["run", "small.yaml", "--push", "--set", pool]).spawn().expect("the program starts")
    };
    let pools = ["scenes.pool=8", "scenes.pool=9", "scenes.pool=10"];
    let mut all: Vec<_> = ["a", "b", "c"].iter().zip(pools).map(|(machine, pool)| run(machine, pool)).collect();
    for child in &mut all {
        assert!(child.wait().expect("it ends").success());
    }
    for pool in pools {
        let said = place.on("d", &["run", "small.yaml", "--set", pool]).ends(0);
        assert!(said.err.contains("nothing to do") && !said.err.contains("note: "), "{}", said.err);
    }
}

#[test]
fn a_push_of_a_pipeline_takes_its_results_and_leaves_those_of_others() {
    let place = Place::new();
    place.off("a", &["run", "small.yaml"]).ends(0);
    place.off("a", &["run", "small.yaml", "--set", "scenes.pool=20"]).ends(0);
    let count = |text: &str| text.split(' ').nth(1).and_then(|n| n.parse::<u64>().ok()).expect("a number");
    let of_one = place.on("a", &["cache", "push", "small.yaml"]).ends(0).out;
    let rest = place.on("a", &["cache", "push"]).ends(0).out;
    assert!(count(&of_one) > 8 && count(&rest) > 12, "{of_one}{rest}");
    let said = place.on("b", &["run", "small.yaml"]).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
}

#[cfg(not(feature = "objects"))]
#[test]
fn a_program_without_object_stores_says_so_and_runs() {
    let place = Place::new();
    let said = place.off("a", &["run", "small.yaml"]).ends(0);
    assert!(!said.err.contains("note: "), "{}", said.err);
    let said = place.on("b", &["run", "small.yaml", "--upstream", "s3://lab/x"]).ends(0);
    assert_eq!(said.err.matches("note: the upstream is not used: ").count(), 1, "{}", said.err);
    assert!(said.err.contains("without the feature `objects`"), "{}", said.err);
    place.on("b", &["cache", "pull", "--upstream", "https://lab.example/x"]).ends(2);
}

/// Scenes, and renders of them whose size the command line may change.
const RENDERS: &str = "\
pipeline: small
seed: 3
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 4, views: [1, 1], regimes: [L0], contexts: [open] }
  ladders:
    kind: ladder_rendering
    inputs: { scenes: scenes }
    params: { rungs: [1, 2], resolution: [8, 8] }
";

#[test]
fn what_rests_on_results_of_others_is_published_item_by_item() {
    let place = Place::with(RENDERS);
    let larger = ["--set", "ladders.resolution=[16, 16]"];
    place.on("a", &["run", "small.yaml", "--push"]).ends(0);
    // B finds the scenes as a whole, and renders. Actions under what it found as a whole were never looked up.
    let said = place.on("b", &[&["run", "small.yaml", "--push"], &larger[..]].concat()).ends(0);
    assert!(said.err.contains("4 actions ran"), "{}", said.err);
    let said = place.on("c", &[&["run", "small.yaml", "--no-rollup"], &larger[..]].concat()).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
    // The same by `cache push`, of a machine that did not push its run.
    let wide = ["--set", "ladders.resolution=[16, 8]"];
    place.on("d", &[&["run", "small.yaml"], &wide[..]].concat()).ends(0);
    let pushed = place.on("d", &[&["cache", "push", "small.yaml"], &wide[..]].concat()).ends(0).out;
    assert!(pushed.starts_with("pushed ") && !pushed.contains("not there"), "{pushed}");
    let said = place.on("e", &[&["run", "small.yaml", "--no-rollup"], &wide[..]].concat()).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
}

#[test]
fn what_came_from_another_upstream_is_said_to_be_left_out() {
    let place = Place::with(RENDERS);
    place.on("a", &["run", "small.yaml", "--push"]).ends(0);
    place.on("b", &["run", "small.yaml", "--no-rollup"]).ends(0);
    let other = place.path("other").display().to_string();
    let pushed = place.on("b", &["cache", "push", "--upstream", &other]).ends(0).out;
    assert!(pushed.contains("8 records left out, because they came from another upstream"), "{pushed}");
    let pushed = place.on("b", &["cache", "push", "small.yaml", "--upstream", &other]).ends(0).out;
    assert!(pushed.contains("left out, because they came from another upstream"), "{pushed}");
    // A machine that found everything as a whole has none of the actions.
    place.on("c", &["run", "small.yaml"]).ends(0);
    let pushed = place.on("c", &["cache", "push", "small.yaml", "--upstream", &other]).ends(0).out;
    assert!(pushed.contains("8 results of the pipeline are not there"), "{pushed}");
    // With all blobs, they are published.
    place.on("b", &["cache", "pull"]).ends(0);
    let pushed = place.on("b", &["cache", "push", "--upstream", &other]).ends(0).out;
    assert!(!pushed.contains("left out"), "{pushed}");
    let said = place.on("d", &["run", "small.yaml", "--no-rollup", "--upstream", &other]).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
}

#[test]
fn a_push_adds_blobs_again_whose_pack_is_lost() {
    let place = Place::with(RENDERS);
    place.on("a", &["run", "small.yaml", "--push"]).ends(0);
    let packs = || {
        let entries = fs::read_dir(place.path("shared/packs")).expect("readable").filter_map(Result::ok);
        let paths = entries.map(|entry| entry.path());
        paths.filter(|path| path.extension().is_some_and(|extension| extension == "pack")).collect::<Vec<_>>()
    };
    let pack = packs().remove(0);
    fs::remove_file(&pack).expect("there");
    let shared = place.path("shared").display().to_string();
    let stat = place.on("b", &["cache", "stat", "--upstream", &shared]).ends(1);
    assert!(stat.err.contains("is missing or truncated") && stat.err.contains("`cache push`"), "{}", stat.err);
    let pushed = place.on("a", &["cache", "push"]);
    assert!(pushed.out.starts_with("pushed 0 records and "), "{}", pushed.out);
    assert!(!pushed.out.contains(" and 0 blobs"), "{}", pushed.out);
    assert_eq!(packs().len(), 1);
    let said = place.on("b", &["run", "small.yaml", "--no-rollup"]).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
    place.on("b", &["cache", "pull"]).ends(0);
    place.on("a", &["cache", "stat", "--upstream", &shared]).ends(0);
}
