//! Caches that are not there, are no caches, are damaged, or belong to somebody else.

use crate::{Place, Said};
use std::{
    fs,
    os::unix::{fs::PermissionsExt, process::CommandExt},
    path::{Path, PathBuf},
};
use tauflow_testing::{Need, skip};

/// Somebody else, where this test may become somebody else.
const NOBODY: u32 = 65_534;
/// One more, and the group of both.
const ONE: u32 = 65_533;
const GROUP: u32 = 65_532;

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
        assert!(said.err.contains("no cache in") && said.err.contains("/store"), "{}", said.err);
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
        assert!(said.err.contains("is not a cache") && said.err.contains("--cache"), "{}", said.err);
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
        assert!(said.err.contains("are rebuilt by the next run"), "{}", said.err);
        place.tauflow(&["run", "small.yaml"]).ends(0);
        place.tauflow(&["cache", "gc", "--lost"]).ends(0);
        place.tauflow(&["cache", "verify"]).ends(0);
    }
}

/// The only file of a kind in a folder of the cache.
fn only(place: &Place, folder: &str, extension: &str) -> PathBuf {
    let mut found: Vec<PathBuf> = tree(&place.path("store").join(folder)).into_iter().map(|(path, _)| path).collect();
    found.retain(|path| path.extension().is_some_and(|e| e == extension));
    assert_eq!(found.len(), 1, "{found:?}");
    found.remove(0)
}

#[test]
fn a_pack_that_was_deleted_is_told_and_what_is_asked_for_of_it_comes_back() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml"]).ends(0);
    fs::remove_file(only(&place, "packs", "pack")).expect("it is ours");
    let said = place.tauflow(&["cache", "verify"]).ends(1);
    assert!(said.out.contains(" 0 damaged; 22 records") && !said.out.contains(" 0 of these lost"), "{}", said.out);
    assert!(said.err.contains("gc --lost"), "{}", said.err);
    // A collection keeps what is known of it: nothing has to run again only because its blobs are lost.
    let said = place.tauflow(&["cache", "gc", "--keep-within", "1d"]).ends(0);
    assert!(said.out.contains(" 0 records;") && said.out.contains("have lost blobs"), "{}", said.out);
    let plan = place.tauflow(&["plan", "small.yaml"]).ends(0).out;
    assert!(plan.ends_with("nothing to do\n"), "{plan}");
    for node in ["scenes", "split.train", "sampling.report"] {
        place.tauflow(&["export", "small.yaml", node, "-o", "out"]).ends(0);
        assert!(place.path("out/manifest.json").is_file(), "{node}");
        fs::remove_dir_all(place.path("out")).expect("it is ours");
    }
    place.tauflow(&["run", "small.yaml"]).ends(0);
    // What nobody needed is cleared away where that is asked for, and all is as it was after a run.
    place.tauflow(&["cache", "gc", "--lost"]).ends(0);
    place.tauflow(&["cache", "verify"]).ends(0);
    place.tauflow(&["run", "small.yaml"]).ends(0);
    assert_eq!(place.tauflow(&["plan", "small.yaml"]).ends(0).out, plan);
}

#[test]
fn what_was_cut_off_a_file_is_told() {
    let cut = |path: &Path, bytes: u64| {
        let file = fs::File::options().write(true).open(path).expect("it is ours");
        let len = file.metadata().expect("it is there").len();
        file.set_len(len - bytes).expect("writable");
    };
    // A mark at the end of a log, as a kill cuts it off: nothing is damaged, and nothing is lost.
    let place = Place::new();
    place.tauflow(&["run", "small.yaml"]).ends(0);
    cut(&only(&place, "log", "log"), 10);
    let said = place.tauflow(&["cache", "verify"]).ends(0);
    assert!(said.out.contains("\n23 bytes after the last complete entry of a file"), "{}", said.out);
    assert!(said.err.is_empty(), "{}", said.err);
    // A blob at the end of a pack was stored, and is not any more.
    let place = Place::new();
    place.tauflow(&["run", "small.yaml"]).ends(0);
    cut(&only(&place, "packs", "pack"), 1);
    let said = place.tauflow(&["cache", "verify"]).ends(1);
    assert!(said.out.contains(" bytes after the last complete entry of a file"), "{}", said.out);
    assert!(!said.out.contains(" 0 of these lost"), "{}", said.out);
    place.tauflow(&["run", "small.yaml"]).ends(0);
}

#[test]
fn an_export_heals_a_damaged_log() {
    for spared in [0, 9] {
        let place = Place::new();
        place.tauflow(&["run", "small.yaml"]).ends(0);
        let log = only(&place, "log", "log");
        let mut bytes = fs::read(&log).expect("readable");
        let places = |bytes: &[u8], namespace: &str| -> Vec<usize> {
            let name = [&(namespace.len() as u32).to_le_bytes()[..], namespace.as_bytes()].concat();
            bytes.windows(name.len()).enumerate().filter(|(_, window)| *window == name).map(|(at, _)| at).collect()
        };
        // The roll-ups of nodes, and one action or all of them.
        let actions = places(&bytes, "action");
        assert_eq!(actions.len(), 10);
        for at in places(&bytes, "rollup").into_iter().chain(actions.into_iter().skip(spared)) {
            bytes[at + 5] ^= 1;
        }
        fs::write(&log, bytes).expect("writable");
        for node in ["sampling.report", "scenes"] {
            place.tauflow(&["export", "small.yaml", node, "-o", "files"]).ends(0);
            assert!(place.path("files/manifest.json").is_file());
            fs::remove_dir_all(place.path("files")).expect("it is ours");
        }
        // A pipeline that never ran is not run by an export, whatever the log may have lost.
        place.write("other.yaml", &crate::PIPELINE.replace("small", "other").replace("seed: 3", "seed: 4"));
        let said = place.tauflow(&["export", "other.yaml", "scenes", "-o", "files"]).ends(2);
        assert!(said.err.contains("must run first"), "{}", said.err);
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
        assert!(said.err.contains("read-only") && said.err.contains("Permission denied"), "{}", said.err);
        assert!(said.err.contains("must be writable"), "{}", said.err);
    }
    assert_eq!(tree(&store), before, "nothing was written");
    set_modes(&store, 0o755, 0o644);
}

/// Several users of a group, each with a mask of his own.
#[test]
fn users_of_one_group_run_on_one_cache_or_are_told_what_to_set() {
    let place = Place::new();
    if std::os::unix::fs::chown(place.folder.path(), Some(ONE), Some(GROUP)).is_err() {
        skip(Need::Root, "only root becomes other users");
        return;
    }
    fs::set_permissions(place.folder.path(), fs::Permissions::from_mode(0o2775)).expect("root may");
    let run = |user: u32, umask: &str, words: &[&str]| {
        let mut command = std::process::Command::new("sh");
        command.args(["-c", &format!("umask {umask}; exec \"$0\" \"$@\""), env!("CARGO_BIN_EXE_tauflow")]);
        let cache = place.path("store").display().to_string();
        command.args(words).args(["--cache", &cache]).current_dir(place.folder.path()).uid(user).gid(GROUP);
        Said::of(&command.output().expect("sh starts"))
    };
    // With the mask that lets the group write, each goes on where the other was, and may collect.
    run(ONE, "002", &["run", "small.yaml"]).ends(0);
    let said = run(NOBODY, "002", &["run", "small.yaml", "--out", "second"]).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
    run(NOBODY, "002", &["run", "small.yaml", "--set", "scenes.pool=9", "--out", "second"]).ends(0);
    run(NOBODY, "002", &["cache", "gc", "--max-size", "0"]).ends(0);
    run(ONE, "002", &["run", "small.yaml"]).ends(0);
    run(ONE, "002", &["cache", "verify"]).ends(0);
    // With another, a new cache is its maker's: others of the group read it, or not even that, and are told.
    for (umask, reads) in [("022", true), ("077", false)] {
        fs::remove_dir_all(place.path("store")).expect("root may");
        run(ONE, umask, &["run", "small.yaml"]).ends(0);
        let plan = run(NOBODY, umask, &["plan", "small.yaml"]);
        assert_eq!(plan.code, if reads { 0 } else { 3 }, "{plan:?}");
        let said = run(NOBODY, umask, &["run", "small.yaml", "--set", "scenes.pool=9", "--out", "second"]).ends(3);
        for word in ["Permission denied", "umask 002", "chmod -R g+rwX"] {
            assert!(said.err.contains(word), "{umask}: {}", said.err);
        }
        run(ONE, umask, &["cache", "verify"]).ends(0);
    }
    // One who forgets it on a cache of all is told of by the others' programs: which file it is, and what to set.
    fs::remove_dir_all(place.path("store")).expect("root may");
    run(ONE, "002", &["run", "small.yaml"]).ends(0);
    run(NOBODY, "077", &["run", "small.yaml", "--set", "scenes.pool=9", "--out", "second"]).ends(0);
    let said = run(ONE, "002", &["plan", "small.yaml"]).ends(3);
    for word in ["/store/log/", "Permission denied", "umask 002", "chmod -R g+rwX"] {
        assert!(said.err.contains(word), "{word}: {}", said.err);
    }
}

#[test]
fn an_empty_upstream_is_none() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml"]).ends(0);
    let said = place.tauflow(&["cache", "stat", "--upstream", ""]).ends(0);
    assert!(said.out.contains(" blobs, "), "{}", said.out);
}

#[test]
fn a_plan_counts_what_a_node_adds_and_not_what_it_passes_on() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml"]).ends(0);
    let plan = place.tauflow(&["plan", "small.yaml", "--set", "split.test_share=0.25"]).ends(0).out;
    // The scenes that a split passes on have megabytes; its own results are lists of them.
    assert!(plan.contains("of results, from earlier runs") && !plan.contains("MiB"), "{plan}");
}
