//! `run --update-lock` and `run --locked`.

use crate::{PIPELINE, Place};
use std::fs;

#[test]
fn a_lock_holds_until_something_changes_and_is_never_written_by_itself() {
    let place = Place::new();
    let none = place.tauflow(&["run", "small.yaml", "--locked"]).ends(2);
    assert!(none.err.contains("small.lock") && none.err.contains("--update-lock"), "{}", none.err);
    place.tauflow(&["run", "small.yaml", "--update-lock"]).ends(0);
    let lock = fs::read_to_string(place.path("small.lock")).expect("it was written");
    assert!(lock.contains("\"scenes.scenes\": ") && lock.contains("\"sampling.report\": "), "{lock}");
    let held = place.tauflow(&["run", "small.yaml", "--locked"]).ends(0);
    assert!(held.err.contains("small.lock agrees"), "{}", held.err);
    // From an empty cache, with other numbers of threads.
    for jobs in ["1", "2", "4"] {
        let cache = place.path(jobs).display().to_string();
        let other = place.tauflow(&["run", "small.yaml", "--locked", "--jobs", jobs, "--cache", &cache]).ends(0);
        assert!(other.err.contains("agrees"), "{}", other.err);
    }
    place.write("small.yaml", &PIPELINE.replace("test_share: 0.5", "test_share: 0.25"));
    let differs = place.tauflow(&["run", "small.yaml", "--locked"]).ends(1);
    assert!(differs.err.contains("`split.train` is ") && differs.err.contains("the lock file has"), "{}", differs.err);
    assert!(!differs.err.contains("`scenes.scenes`"), "{}", differs.err);
    assert_eq!(fs::read_to_string(place.path("small.lock")).expect("it is there"), lock);
    // A node that goes is missed, one that comes is told.
    place.write("small.yaml", &PIPELINE[..PIPELINE.find("  sampling:").expect("it has one")]);
    let less = place.tauflow(&["run", "small.yaml", "--locked"]).ends(1);
    assert!(
        less.err.contains("`sampling.train` is ") && less.err.contains("the pipeline has no such output"),
        "{}",
        less.err
    );
}

#[test]
fn a_profile_has_a_lock_of_its_own_and_overrides_have_none() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml", "--profile", "more", "--update-lock"]).ends(0);
    assert!(place.path("small.more.lock").is_file() && !place.path("small.lock").exists());
    let set = place.tauflow(&["run", "small.yaml", "--set", "scenes.pool=9", "--locked"]).ends(2);
    assert!(set.err.contains("do not accept --set"), "{}", set.err);
    place.write("small.more.lock", "pipeline: small\nbitwise: [1]\n");
    let damaged = place.tauflow(&["run", "small.yaml", "--profile", "more", "--locked"]).ends(2);
    assert!(damaged.err.contains("small.more.lock is not a lock file"), "{}", damaged.err);
}

#[test]
fn a_lock_is_compared_and_written_in_parts() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml", "--target", "scenes", "--update-lock"]).ends(0);
    let part = fs::read_to_string(place.path("small.lock")).expect("it was written");
    assert!(part.contains("\"scenes.scenes\": ") && !part.contains("sampling"), "{part}");
    let held = place.tauflow(&["run", "small.yaml", "--target", "scenes", "--locked"]).ends(0);
    assert!(held.err.contains("small.lock agrees: 1 output"), "{}", held.err);
    let whole = place.tauflow(&["run", "small.yaml", "--locked"]).ends(1);
    assert!(whole.err.contains("`sampling.train` is ") && whole.err.contains("does not contain it"), "{}", whole.err);
    // The parts make the whole.
    place.tauflow(&["run", "small.yaml", "--target", "sampling", "--update-lock"]).ends(0);
    let parts = fs::read_to_string(place.path("small.lock")).expect("it is there");
    place.tauflow(&["run", "small.yaml", "--locked"]).ends(0);
    place.tauflow(&["run", "small.yaml", "--update-lock"]).ends(0);
    assert_eq!(fs::read_to_string(place.path("small.lock")).expect("it is there"), parts);
    // Outputs that the part does not need are no differences, and are kept.
    for target in ["split.test", "scenes"] {
        let said = place.tauflow(&["run", "small.yaml", "--target", target, "--locked"]).ends(0);
        assert!(said.err.contains("not compared: no target needs them"), "{target}: {}", said.err);
        place.tauflow(&["run", "small.yaml", "--target", target, "--update-lock"]).ends(0);
        assert_eq!(fs::read_to_string(place.path("small.lock")).expect("it is there"), parts, "{target}");
    }
    // A change after the part is no difference in the part, and is one in the whole.
    place.write("small.yaml", &PIPELINE.replace("test_share: 0.5", "test_share: 0.25"));
    place.tauflow(&["run", "small.yaml", "--target", "scenes", "--locked"]).ends(0);
    let differs = place.tauflow(&["run", "small.yaml", "--target", "split", "--locked"]).ends(1);
    assert!(differs.err.contains("`split.train` is ") && !differs.err.contains("`sampling."), "{}", differs.err);
    // One that is damaged is told before anything runs.
    place.write("small.lock", "pipeline: [\n");
    let damaged = place.tauflow(&["run", "small.yaml", "--target", "split", "--update-lock"]).ends(2);
    assert!(damaged.err.contains("without `--target`") && !damaged.err.contains("as before"), "{}", damaged.err);
    place.tauflow(&["run", "small.yaml", "--update-lock"]).ends(0);
}

#[test]
fn a_lock_of_another_pipeline_is_neither_compared_nor_overwritten() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml", "--profile", "more", "--update-lock"]).ends(0);
    place.write("small.more.yaml", &PIPELINE.replace("pipeline: small", "pipeline: other"));
    for option in ["--locked", "--update-lock"] {
        let said = place.tauflow(&["run", "small.more.yaml", option]).ends(2);
        assert!(said.err.contains("of the pipeline `small`, not of `other`"), "{}", said.err);
    }
    // Names of profiles are parts of names of files.
    place.write("bad.yaml", &PIPELINE.replace("{ more:", "{ more/than:"));
    let said = place.tauflow(&["run", "bad.yaml", "--profile", "more/than", "--update-lock"]).ends(2);
    assert!(said.err.contains("`more/than` cannot name a profile"), "{}", said.err);
}

#[test]
fn what_a_lock_refutes_is_a_failed_run_and_is_not_pushed() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml", "--update-lock"]).ends(0);
    place.write("small.yaml", &PIPELINE.replace("test_share: 0.5", "test_share: 0.25"));
    let said = place.tauflow(&["run", "small.yaml", "--locked", "--push", "--upstream", "up"]).ends(1);
    assert!(said.err.contains("nothing was pushed") && !said.err.contains("pushed 1"), "{}", said.err);
    let runs = place.tauflow(&["runs"]).ends(0);
    assert!(runs.out.lines().any(|line| line.contains("failed")), "{}", runs.out);
}

#[test]
fn child_processes_give_the_digests_of_threads() {
    let kind = "    kind: content_signature_split\n";
    let place = Place::with(&PIPELINE.replace(kind, &format!("{kind}    transient: true\n")));
    place.tauflow(&["run", "small.yaml", "--update-lock"]).ends(0);
    let cache = place.path("other").display().to_string();
    let process = ["run", "small.yaml", "--locked", "--executor", "process"];
    let other = place.tauflow(&[&process[..], &["--cache", &cache]].concat()).ends(0);
    assert!(other.err.contains("10 actions ran, 0 as before") && other.err.contains("agrees"), "{}", other.err);
    // What threads handed on in memory is not stored, and children need it.
    let again = place.tauflow(&[&process[..], &["--recheck", "1"]].concat()).ends(0);
    assert!(again.err.contains("agrees") && !again.err.contains("warning"), "{}", again.err);
    let wrong = place.tauflow(&["exec", "--batch", "small.yaml"]).ends(2);
    assert!(wrong.err.contains("small.yaml is no batch of actions"), "{}", wrong.err);
}

#[test]
fn a_target_stores_what_it_passes_on_of_a_transient_node() {
    let kind = "    kind: scene_generation\n";
    let place = Place::with(&PIPELINE.replace(kind, &format!("{kind}    transient: true\n")));
    let said = place.tauflow(&["run", "small.yaml"]).ends(0);
    assert!(!said.err.contains("rebuilding") && said.err.contains("10 actions ran"), "{}", said.err);
    place.tauflow(&["export", "small.yaml", "sampling.train", "-o", "scenes"]).ends(0);
    let said = place.tauflow(&["run", "small.yaml"]).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
}
