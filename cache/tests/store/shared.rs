//! Caches that may only be read, and caches of several users.

use crate::{blob, files, fresh, open, record};
use std::{
    fs,
    os::unix::{
        fs::{MetadataExt, PermissionsExt, chown},
        process::CommandExt,
    },
    path::{Path, PathBuf},
    process::Command,
};
use tauflow_cache::{CacheError, Digest, GcOptions, Store};
use tauflow_testing::{Need, skip};

const ONE: u32 = 65_533;
const OTHER: u32 = 65_534;
const GROUP: u32 = 65_532;

fn set_mode(path: &Path, mode: u32) {
    fs::set_permissions(path, fs::Permissions::from_mode(mode)).expect("it is ours");
}

/// A command that runs a test of this program, where users other than root can reach it.
fn child(place: &Path, umask: &str, test: &str) -> Command {
    let program = place.join("test");
    if !program.exists() {
        fs::copy(std::env::current_exe().expect("this program"), &program).expect("writable");
        set_mode(&program, 0o755);
    }
    let mut command = Command::new("sh");
    command.args(["-c", &format!("umask {umask}; exec \"$0\" \"$@\"")]).arg(program);
    command.args(["--exact", test, "--nocapture"]).current_dir(place);
    command
}

fn passes(command: &mut Command) {
    let output = command.output().expect("the child starts");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    assert!(text.contains("1 passed"), "{text}");
}

fn is_root() -> bool {
    fs::metadata("/proc/self").is_ok_and(|meta| meta.uid() == 0)
}

/// A folder that all users reach, with a store that holds records 1 to 9 with a small and a large blob each.
fn filled() -> (tempfile::TempDir, PathBuf) {
    let place = tempfile::tempdir().expect("a temporary folder");
    set_mode(place.path(), 0o755);
    let cache = place.path().join("cache");
    fill(&cache, 1..10);
    (place, cache)
}

fn fill(cache: &Path, numbers: impl Iterator<Item = u64>) {
    let store = open(cache);
    for n in numbers {
        let refs = [3000, 70_000].map(|size| store.put(&blob(n, size)).expect("put")).to_vec();
        store.record(&record(n, "p", refs)).expect("record");
    }
}

fn holds(store: &Store, n: u64) -> bool {
    let found = store.lookup_full("action", &record(n, "", vec![]).key);
    found.is_some_and(|found| found.refs.iter().all(|digest| store.get(digest).expect("get").is_some()))
}

/// Runs in a child: all that reads works, and what has to write says why it cannot.
#[test]
fn child_that_only_reads() {
    let Ok(dir) = std::env::var("TAUFLOW_CACHE_READ") else { return };
    let dir = Path::new(&dir);
    let before: Vec<_> = files(dir);
    for store in [open(dir), Store::open_existing(dir).expect("it is there")] {
        assert!(store.is_made());
        store.set_time(1).expect("nothing to note");
        assert!((1..10).all(|n| holds(&store, n)));
        assert_eq!(store.by_label("action", "ladder").len(), 9);
        assert_eq!(store.stat().expect("stat").blobs, 18);
        assert!(!store.verify(None, 0, &mut |_, _| ()).expect("verify").is_damaged());
        let dry = GcOptions { max_bytes: Some(0), dry_run: true, ..GcOptions::default() };
        assert_eq!(store.gc(&dry).expect("a dry run").removed_blobs, 18);
        // Existing blobs need not be written.
        store.put(&blob(1, 3000)).expect("it is there");
        store.record(&record(1, "p", vec![])).expect("it is there");
        let key = record(1, "", vec![]).key;
        let refused = [
            store.put(b"new").map(drop),
            store.put(&blob(77, 70_000)).map(drop),
            store.record(&record(77, "p", vec![])).map(drop),
            store.replace(&record(1, "q", vec![])),
            store.claim(&key).map(drop),
            store.try_claim(&key).map(drop),
            store.pin("a", &Digest::of(b"x")),
            store.gc(&GcOptions::default()).map(drop),
        ];
        for result in refused {
            let error = result.expect_err("it has to be written");
            assert!(matches!(error, CacheError::ReadOnly { .. }), "{error}");
            assert!(error.is_environment() && error.is_refused() && !error.is_full());
            let message = error.to_string();
            assert!(message.contains("read-only") && message.contains("must be writable"), "{message}");
        }
        store.flush().expect("nothing to write");
        store.refresh().expect("readable");
    }
    assert_eq!(files(dir), before, "nothing was written");
}

#[test]
fn a_store_that_may_not_be_written_can_be_read() {
    let (place, cache) = filled();
    let mut command = child(place.path(), "022", "shared::child_that_only_reads");
    command.env("TAUFLOW_CACHE_READ", &cache);
    if is_root() {
        passes(command.uid(OTHER).gid(OTHER));
        return;
    }
    let folders: Vec<PathBuf> = fs::read_dir(&cache).expect("readable").map(|e| e.expect("readable").path()).collect();
    let folders: Vec<&PathBuf> = folders.iter().filter(|path| path.is_dir()).collect();
    folders.iter().for_each(|folder| set_mode(folder, 0o555));
    passes(&mut command);
    folders.iter().for_each(|folder| set_mode(folder, 0o755));
}

#[test]
fn a_store_on_a_disk_mounted_for_reading_can_be_read() {
    let (place, cache) = filled();
    let mount = "mount --bind \"$TAUFLOW_CACHE_READ\" \"$TAUFLOW_CACHE_READ\" \
                 && mount -o remount,ro,bind \"$TAUFLOW_CACHE_READ\"";
    let mut probe = Command::new("unshare");
    probe.args(["-m", "sh", "-c", mount]).env("TAUFLOW_CACHE_READ", &cache);
    if !probe.output().is_ok_and(|output| output.status.success()) {
        skip(Need::Mount, "nothing can be mounted here");
        return;
    }
    let inner = child(place.path(), "022", "shared::child_that_only_reads");
    let mut command = Command::new("unshare");
    command.args(["-m", "sh", "-c", &format!("{mount} && exec \"$0\" \"$@\"")]);
    command.arg(inner.get_program()).args(inner.get_args()).env("TAUFLOW_CACHE_READ", &cache);
    passes(&mut command);
}

/// Runs in a child: a user who may not set damage aside.
#[test]
fn child_that_meets_damage() {
    let Ok(dir) = std::env::var("TAUFLOW_CACHE_DAMAGED") else { return };
    let damaged = || open(Path::new(&dir)).verify(None, 0, &mut |_, _| ()).expect("verify").damaged.len();
    assert_eq!((damaged(), damaged()), (1, 1));
}

#[test]
fn damage_is_told_where_it_cannot_be_set_aside() {
    let (place, cache) = filled();
    let pack = &files(&cache.join("packs"))[0];
    crate::flip(pack, 100);
    for folder in ["tmp", "leases", "quarantine"] {
        set_mode(&cache.join(folder), 0o555);
    }
    let mut command = child(place.path(), "022", "shared::child_that_meets_damage");
    command.env("TAUFLOW_CACHE_DAMAGED", &cache);
    // Root writes whatever the modes say.
    passes(if is_root() { command.uid(OTHER).gid(OTHER) } else { &mut command });
    for folder in ["tmp", "leases", "quarantine"] {
        set_mode(&cache.join(folder), 0o755);
    }
}

/// Runs in a child: one of several users who write to one cache.
#[test]
fn child_that_writes() {
    let Ok(dir) = std::env::var("TAUFLOW_CACHE_USER") else { return };
    let start: u64 = std::env::var("TAUFLOW_CACHE_FROM").expect("given").parse().expect("a number");
    fill(Path::new(&dir), start..start + 5);
    let store = open(Path::new(&dir));
    assert!((start..start + 5).all(|n| holds(&store, n)));
    if start > 100 {
        assert!((100..105).all(|n| holds(&store, n)), "what the other user wrote");
        drop(store);
        let store = open(Path::new(&dir));
        let _claim = store.claim(&record(1, "", vec![]).key).expect("claim");
        store.gc(&GcOptions { max_bytes: Some(0), now: 1000, ..GcOptions::default() }).expect("gc");
        assert!(!store.contains(&Digest::of(&blob(100, 70_000))), "one user removes what the other wrote");
    }
}

/// Runs in a child: a user whom another one's umask leaves less than it takes.
#[test]
fn child_that_is_told() {
    let Ok(dir) = std::env::var("TAUFLOW_CACHE_TOLD") else { return };
    let message = match Store::open(Path::new(&dir)) {
        Ok(store) => store.put(b"new").expect_err("not writable").to_string(),
        Err(error) => error.to_string(),
    };
    for word in [&dir, "Permission denied", "umask 002", "chmod -R g+rwX", "chgrp"] {
        assert!(message.contains(word), "{word}: {message}");
    }
}

#[test]
fn users_of_one_group_share_a_cache_or_are_told_what_to_set() {
    if !is_root() {
        skip(Need::Root, "only root becomes other users");
        return;
    }
    for umask in ["002", "022", "077"] {
        let place = tempfile::tempdir().expect("a temporary folder");
        set_mode(place.path(), 0o755);
        let cache = place.path().join("cache");
        fs::create_dir(&cache).expect("writable");
        chown(&cache, Some(ONE), Some(GROUP)).expect("root may");
        set_mode(&cache, 0o2775);
        let as_user = |user: u32, test: &str| {
            let mut command = child(place.path(), umask, test);
            command.uid(user).gid(GROUP);
            command
        };
        let mut first = as_user(ONE, "shared::child_that_writes");
        passes(first.env("TAUFLOW_CACHE_USER", &cache).env("TAUFLOW_CACHE_FROM", "100"));
        if umask == "002" {
            let mut second = as_user(OTHER, "shared::child_that_writes");
            passes(second.env("TAUFLOW_CACHE_USER", &cache).env("TAUFLOW_CACHE_FROM", "200"));
        } else {
            let mut second = as_user(OTHER, "shared::child_that_is_told");
            passes(second.env("TAUFLOW_CACHE_TOLD", &cache));
        }
    }
}

#[test]
fn a_store_that_is_open_for_reading_sees_what_others_write() {
    let (_dir, writer) = fresh();
    let digest = writer.put(b"x").expect("put");
    let reader = Store::open_existing(writer.dir()).expect("it is there");
    assert!(reader.get(&digest).expect("get").is_some());
}
