//! Caches that are not there, are no caches, are damaged, or belong to somebody else.

use crate::{Place, Said};
use std::{
    fs,
    os::unix::{fs::PermissionsExt, process::CommandExt},
    path::{Path, PathBuf},
};

/// Somebody else, where this test may become somebody else.
const NOBODY: u32 = 65_534;

/// All files and folders below one, with their modes.
fn tree(folder: &Path) -> Vec<(PathBuf, u32)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("readable") {
        let path = entry.expect("readable").path();
        let meta = fs::symlink_metadata(&path).expect("it is there");
        if meta.is_dir() {
            found.extend(tree(&path));
        }
        found.push((path, meta.permissions().mode()));
    }
    found.sort();
    found
}

fn set_modes(folder: &Path, folders: u32, files: u32) {
    for (path, _) in tree(folder).into_iter().chain([(folder.to_owned(), 0)]) {
        let mode = if path.is_dir() { folders } else { files };
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).expect("it is ours");
    }
}

#[test]
fn who_only_looks_makes_no_cache() {
    let place = Place::new();
    let plan = place.tauflow(&["plan", "small.yaml"]).ends(0).out;
    assert!(plan.contains("scenes"), "{plan}");
    place.tauflow(&["explain", "small.yaml", "scenes"]);
    place.tauflow(&["export", "small.yaml", "scenes", "-o", "out"]);
    place.tauflow(&["cache", "pins"]).ends(0);
    for words in [&["stat"][..], &["verify"], &["gc", "--max-size", "0"]] {
        let said = place.tauflow(&[&["cache"], words].concat()).ends(2);
        assert!(said.err.contains("there is no cache in") && said.err.contains("/store"), "{}", said.err);
    }
    assert!(!place.path("store").exists());
    // An empty folder may become a cache, but not by looking.
    fs::create_dir(place.path("store")).expect("writable");
    place.tauflow(&["plan", "small.yaml"]).ends(0);
    place.tauflow(&["cache", "stat"]).ends(2);
    assert_eq!(tree(&place.path("store")), []);
}

#[test]
fn a_folder_of_others_is_no_cache_and_stays_as_it_is() {
    let place = Place::new();
    for folder in ["tmp", "trash", "quarantine", "log"] {
        fs::create_dir_all(place.path("home").join(folder)).expect("writable");
        fs::write(place.path("home").join(folder).join("letter"), "dear").expect("writable");
    }
    let before = tree(&place.path("home"));
    let commands: [&[&str]; 8] = [
        &["run", "small.yaml"],
        &["plan", "small.yaml"],
        &["export", "small.yaml", "scenes", "-o", "out"],
        &["explain", "small.yaml", "scenes"],
        &["cache", "stat"],
        &["cache", "verify"],
        &["cache", "gc", "--max-size", "0"],
        &["cache", "pins"],
    ];
    for command in commands {
        let said = place.tauflow(&[command, &["--cache", "home"]].concat()).ends(3);
        assert!(said.err.contains("is no cache") && said.err.contains("--cache"), "{}", said.err);
        assert_eq!(tree(&place.path("home")), before, "{command:?}");
    }
}

#[test]
fn verify_ends_with_1_where_it_finds_damage_and_a_run_heals() {
    for folder in ["packs", "log"] {
        let place = Place::new();
        place.tauflow(&["run", "small.yaml"]).ends(0);
        place.tauflow(&["cache", "verify"]).ends(0);
        let (path, _) = tree(&place.path("store").join(folder)).remove(0);
        let mut bytes = fs::read(&path).expect("readable");
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(&path, bytes).expect("writable");
        let said = place.tauflow(&["cache", "verify"]).ends(1);
        assert!(said.err.contains("makes it again"), "{}", said.err);
        place.tauflow(&["run", "small.yaml"]).ends(0);
        place.tauflow(&["cache", "gc", "--keep-within", "1d"]).ends(0);
        place.tauflow(&["cache", "verify"]).ends(0);
    }
}

#[test]
fn a_cache_that_can_only_be_read_is_read_planned_with_and_exported_from() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml"]).ends(0);
    let store = place.path("store");
    fs::set_permissions(place.folder.path(), fs::Permissions::from_mode(0o777)).expect("it is ours");
    // Whoever may write whatever the modes say becomes somebody who may not.
    set_modes(&store, 0o555, 0o444);
    let root = fs::write(store.join("tmp/probe"), "").is_ok();
    if root {
        fs::remove_file(store.join("tmp/probe")).expect("it is ours");
    }
    let before = tree(&store);
    let tauflow = |words: &[&str]| {
        let mut command = place.command(words);
        if root {
            command.uid(NOBODY).gid(NOBODY);
        }
        Said::of(&command.output().expect("the program starts"))
    };
    let plan = tauflow(&["plan", "small.yaml"]).ends(0).out;
    assert!(plan.ends_with("nothing to do\n"), "{plan}");
    tauflow(&["export", "small.yaml", "sampling.report", "-o", "report"]).ends(0);
    assert!(place.path("report/manifest.json").is_file());
    tauflow(&["cache", "stat"]).ends(0);
    tauflow(&["cache", "verify"]).ends(0);
    tauflow(&["cache", "gc", "--max-size", "0", "--dry-run"]).ends(0);
    tauflow(&["explain", "small.yaml", "scenes"]).ends(0);
    // All is there, so that a run has nothing to write either, but its own results.
    tauflow(&["run", "small.yaml", "--out", "again"]).ends(0);
    for words in [&["cache", "gc", "--max-size", "0"][..], &["run", "small.yaml", "--set", "scenes.pool=9"]] {
        let said = tauflow(words).ends(3);
        assert!(said.err.contains("reading only") && said.err.contains("Permission denied"), "{}", said.err);
        assert!(said.err.contains("must be writable"), "{}", said.err);
    }
    assert_eq!(tree(&store), before, "nothing was written");
    set_modes(&store, 0o755, 0o644);
}
