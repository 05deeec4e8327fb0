//! `exec`: one action alone, on a copy of the cache, in an empty folder, without an environment. `programs.rs` has
//! actions that need one.

use crate::{Place, json};
use std::{fs, path::Path, process::Command};
use tauflow::engine::exec;
use tauflow_cache::Store;

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("writable");
    for entry in fs::read_dir(from).expect("readable") {
        let entry = entry.expect("readable");
        let target = to.join(entry.file_name());
        if entry.path().is_dir() { copy(&entry.path(), &target) } else { drop(fs::copy(entry.path(), target)) }
    }
}

/// Runs the program with no environment, in an empty folder.
fn bare(place: &Place, arguments: &[&str]) -> (i32, String, String) {
    let empty = place.path("empty");
    fs::create_dir_all(&empty).expect("writable");
    let mut command = Command::new(env!("CARGO_BIN_EXE_tauflow"));
    let output = command.args(arguments).env_clear().current_dir(&empty).output().expect("the program starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(fs::read_dir(&empty).expect("readable").next().is_none(), "an action leaves nothing behind");
    (output.status.code().unwrap_or(-1), text(&output.stdout), text(&output.stderr))
}

#[test]
fn every_action_runs_alone_on_a_copy_of_the_cache_with_the_same_digests() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml"]).ends(0);
    let expected = fs::read_to_string(place.path("out/small/run.json")).expect("a run leaves its numbers");
    copy(&place.path("store"), &place.path("copy"));
    fs::remove_dir_all(place.path("store")).expect("writable");
    fs::remove_dir_all(place.path("out")).expect("writable");
    let keys = exec::recorded(&Store::open(&place.path("copy")).expect("a copy is a store"));
    assert_eq!(keys.len(), 10, "{expected}");
    let at = place.path("copy").display().to_string();
    for key in keys {
        let start = &key.hex()[..16];
        let (code, out, err) = bare(&place, &["exec", start, "--cache", &at]);
        assert_eq!(code, 0, "{err}");
        let done = json(&out);
        assert_eq!((&done["key"], &done["new"]), (&key.hex().into(), &false.into()));
        assert!(done["outputs"].as_object().is_some_and(|outputs| !outputs.is_empty()), "{out}");
    }
}

#[test]
fn an_action_written_to_a_file_runs_where_its_inputs_are() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml"]).ends(0);
    let explained = place.tauflow(&["explain", "small.yaml", "split"]).ends(0).out;
    let key = explained.lines().find_map(|line| line.strip_prefix("key ")).expect("a key").trim().to_owned();
    let action = place.tauflow(&["exec", &key, "--print"]).ends(0).out;
    place.write("split.json", &action);
    // Elsewhere the blobs are not there, and that is told.
    let file = place.path("split.json").display().to_string();
    let other = place.path("other").display().to_string();
    let (code, _, err) = bare(&place, &["exec", &file, "--cache", &other]);
    assert_eq!(code, 2);
    assert!(err.contains("lacks the input blob"), "{err}");
    // With the scenes made there, it runs, and is recorded.
    place.tauflow(&["run", "small.yaml", "--target", "scenes", "--cache", &other]).ends(0);
    let (code, out, err) = bare(&place, &["exec", &file, "--cache", &other, "--limit", "5m"]);
    assert_eq!(code, 0, "{err}");
    let done = json(&out);
    assert_eq!((&done["kind"], &done["new"]), (&"content_signature_split".into(), &true.into()));
    let plan = place.tauflow(&["plan", "small.yaml", "--cache", &other]).ends(0);
    assert!(plan.lines().iter().any(|line| line.starts_with("split") && line.contains(" 1 ")), "{}", plan.out);
    // Tampered with, it is refused.
    place.write(
        "split.json",
        &action.replacen("\"item\"", "\"itme\"", 1).replacen("\"version\": ", "\"version\": 9", 1),
    );
    let (code, _, err) = bare(&place, &["exec", &file, "--cache", &other]);
    assert_eq!(code, 2);
    assert!(err.contains("version 9"), "{err}");
}

#[test]
fn what_is_no_action_is_told() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml"]).ends(0);
    let none = place.tauflow(&["exec", "zz"]).ends(2);
    assert!(none.err.contains("no action `zz`"), "{}", none.err);
    let many = place.tauflow(&["exec", ""]).ends(2);
    assert!(many.err.contains("10 actions begin with"), "{}", many.err);
    place.write("x.json", "{}");
    let bad = place.tauflow(&["exec", "x.json"]).ends(2);
    assert!(bad.err.contains("is not an action"), "{}", bad.err);
    assert!(place.tauflow(&["exec", "00", "--limit", "soon"]).ends(2).err.contains("give a number"));
}
