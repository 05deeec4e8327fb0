//! A full disk can be collected: what frees room comes first, and what needs room and finds none is left as it is.

use crate::{blob, fresh, open, record};
use std::{
    fs::{self, File},
    path::Path,
    process::{Command, Output},
};
use tauflow_cache::{Digest, GcOptions, GcReport, Store};
use tauflow_testing::{Need, skip};

const OLD: GcOptions =
    GcOptions { max_bytes: None, keep_within_secs: Some(50), now: 100, dry_run: false, pins: Vec::new(), lost: false };

/// Records 1 to 20 are old and 80 to 99 are recent; small blobs of both lie in one pack, records of both in one log.
/// Another pack and another log hold old ones alone.
fn fill(dir: &Path) {
    let store = open(dir);
    for n in (1..=20).chain(80..100) {
        let refs = [2000, 70_000].map(|size| store.put(&blob(n, size)).expect("put")).to_vec();
        store.record(&record(n, "p", refs)).expect("record");
    }
    drop(store);
    let store = open(dir);
    for n in 21..=30 {
        let digest = store.put(&blob(n, 2000)).expect("put");
        store.record(&record(n, "p", vec![digest])).expect("record");
    }
}

fn holds(store: &Store, n: u64) -> bool {
    let found = store.lookup_full("action", &record(n, "", vec![]).key);
    found.is_some_and(|found| found.refs.iter().all(|digest| store.get(digest).expect("get").is_some()))
}

fn check(store: &Store) {
    assert_eq!((1..=30).filter(|n| holds(store, *n)).count(), 0, "what is old went");
    assert!((80..100).all(|n| holds(store, n)), "what is recent is there");
}

fn run(command: &mut Command, test: &str, dir: &Path) -> Output {
    command.arg(std::env::current_exe().expect("this program"));
    let output = command.args(["--exact", test, "--nocapture"]).env("TAUFLOW_CACHE_ROOM", dir).output();
    let output = output.expect("the shell starts");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    assert!(text.contains("1 passed"), "{text}");
    output
}

/// Runs in a child that cannot write a byte to any file.
#[test]
fn child_without_room() {
    let Ok(dir) = std::env::var("TAUFLOW_CACHE_ROOM") else { return };
    let store = open(Path::new(&dir));
    assert!(store.put(b"new").expect_err("there is no room").is_full());
    let report = store.gc(&OLD).expect("a collection needs none");
    assert_eq!(report.removed_bytes, 20 * 70_000 + 10 * 2000, "{report:?}");
    assert_eq!((report.no_room_bytes, report.removed_records), (20 * 2000, 10), "{report:?}");
    check(&store);
    // Once more, with nothing left that takes no room.
    let report = store.gc(&OLD).expect("a collection needs none");
    assert_eq!((report.removed_bytes, report.no_room_bytes), (0, 20 * 2000), "{report:?}");
    check(&store);
}

#[test]
fn a_collection_frees_what_it_can_where_nothing_can_be_written() {
    let (dir, store) = fresh();
    drop(store);
    fill(dir.path());
    let mut shell = Command::new("sh");
    run(shell.args(["-c", "trap '' XFSZ; ulimit -f 0; exec \"$0\" \"$@\""]), "full::child_without_room", dir.path());
    check(&open(dir.path()));
    let store = open(dir.path());
    let report: GcReport = store.gc(&OLD).expect("gc");
    assert_eq!((report.removed_bytes, report.no_room_bytes), (20 * 2000, 0), "{report:?}");
    check(&store);
    assert!(!store.verify(None, 0, &mut |_, _| ()).expect("verify").is_damaged());
    assert!(crate::files(&dir.path().join("tmp")).is_empty() && crate::files(&dir.path().join("trash")).is_empty());
}

/// Runs in a child on a disk of its own that has neither room nor names left.
#[test]
fn child_on_a_full_disk() {
    let Ok(dir) = std::env::var("TAUFLOW_CACHE_ROOM") else { return };
    let (disk, cache) = (Path::new(&dir), Path::new(&dir).join("cache"));
    fill(&cache);
    let mut ballast = Vec::new();
    let full = loop {
        let path = disk.join(ballast.len().to_string());
        match File::create_new(&path).and_then(|file| file.set_len(0).and_then(|()| fs::write(&path, [1; 65_536]))) {
            Ok(()) => ballast.push(path),
            Err(error) => break error,
        }
    };
    assert_eq!(full.kind(), std::io::ErrorKind::StorageFull);
    let used = |n: usize| disk.join(format!("name{n}"));
    let names = (0..).take_while(|n| File::create_new(used(*n)).is_ok()).count();
    println!("{} files and {names} names of ballast", ballast.len());
    let store = open(&cache);
    let error = store.put(&blob(1000, 70_000)).expect_err("there is no room");
    assert!(error.is_full() && error.to_string().contains("gc --max-size"), "{error}");
    assert!(holds(&store, 1) && holds(&store, 90), "all that is there can be read");
    let report = store.gc(&OLD).expect("a collection needs no room");
    assert!(report.removed_bytes >= 20 * 70_000, "{report:?}");
    check(&store);
    drop(store);
    let store = open(&cache);
    store.put(&blob(1000, 70_000)).expect("there is room now");
    store.gc(&OLD).expect("gc");
    drop(store);
    check(&open(&cache));
}

#[test]
fn a_disk_without_room_or_names_is_read_and_collected() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let mount = "mount -t tmpfs -o size=6m,nr_inodes=150 tmpfs \"$TAUFLOW_CACHE_ROOM\"";
    let mut probe = Command::new("unshare");
    probe.args(["-m", "sh", "-c", mount]).env("TAUFLOW_CACHE_ROOM", dir.path());
    if !probe.output().is_ok_and(|output| output.status.success()) {
        skip(Need::Mount, "no disk can be mounted here");
        return;
    }
    let mut shell = Command::new("unshare");
    shell.args(["-m", "sh", "-c", &format!("{mount} && exec \"$0\" \"$@\"")]);
    run(&mut shell, "full::child_on_a_full_disk", dir.path());
}

#[test]
fn a_live_store_keeps_what_it_holds_where_there_is_no_room_for_a_copy() {
    let (dir, store) = fresh();
    drop(store);
    fill(dir.path());
    let user = open(dir.path());
    let held: Vec<Digest> = user.lookup("action", &record(25, "", vec![]).key).expect("recorded").refs.clone();
    let mut shell = Command::new("sh");
    run(shell.args(["-c", "trap '' XFSZ; ulimit -f 0; exec \"$0\" \"$@\""]), "full::child_beside_a_user", dir.path());
    assert!(held.iter().all(|digest| user.get(digest).expect("get").is_some()));
}

/// Runs in a child that cannot write, beside a store that looked record 25 up.
#[test]
fn child_beside_a_user() {
    let Ok(dir) = std::env::var("TAUFLOW_CACHE_ROOM") else { return };
    let store = open(Path::new(&dir));
    let report = store.gc(&OLD).expect("gc");
    assert!(report.live_stores == 1 && report.removed_bytes > 0, "{report:?}");
    assert!(holds(&store, 25));
}
