//! Caches on a file system with the habits of NFS, which two machines mount.

#[path = "../support/nfs.rs"]
mod nfs;

use crate::{Place, Said, jobs::SHELL};
use fuser::BackgroundSession;
use nfs::{Habits, STALE, mount};
use std::{
    fs, thread,
    time::{Duration, Instant},
};
use tauflow_cache::{Digest, FileSystem, GcOptions, Store};
use tauflow_testing::{Need, skip};
use tempfile::TempDir;

/// A folder of a server, and the views that two machines have of it.
struct Lab {
    folder: TempDir,
    /// Unmounted before the folder goes.
    views: Vec<BackgroundSession>,
}

impl Lab {
    fn new(lockless: bool) -> Option<Self> {
        let folder = TempDir::new().expect("a temporary folder");
        for name in ["server", "a", "b"] {
            fs::create_dir(folder.path().join(name)).expect("writable");
        }
        let mut views = Vec::new();
        for name in ["a", "b"] {
            match mount(&folder.path().join("server"), &folder.path().join(name), Habits { lockless }) {
                Ok(view) => views.push(view),
                Err(error) => {
                    skip(Need::Fuse, format!("FUSE file systems cannot be mounted: {error}"));
                    return None;
                }
            }
        }
        Some(Self { folder, views })
    }

    fn store(&self, machine: &str) -> Store {
        Store::open(&self.path(machine)).expect("it is a store, or becomes one")
    }

    fn path(&self, machine: &str) -> std::path::PathBuf {
        self.folder.path().join(machine).join("cache")
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        self.views.clear();
    }
}

/// A blob in a pack, and one with a file of its own, which is renamed.
fn blobs(n: u8) -> [Vec<u8>; 2] {
    [vec![n; 1000], vec![n; 100_000]]
}

fn soon<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(begun.elapsed() < Duration::from_secs(30), "waited in vain for {what}");
        thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn two_machines_share_a_cache_whose_file_system_lists_late_loses_answers_and_has_no_locks() {
    let Some(lab) = Lab::new(true) else { return };
    let (a, b) = (lab.store("a"), lab.store("b"));
    for store in [&a, &b] {
        assert_eq!(store.file_system(), FileSystem { network: Some("FUSE"), lockless: true });
    }
    for n in 0..12 {
        let (from, to) = if n % 2 == 0 { (&a, &b) } else { (&b, &a) };
        for bytes in blobs(n) {
            let digest = from.put(&bytes).expect("every third rename is done, and reported as failed");
            from.flush().expect("files are synced");
            let seen = soon("a blob", || {
                to.refresh().expect("it can be listed");
                to.get(&digest).expect("it can be read")
            });
            assert_eq!(seen, bytes);
        }
    }
    let refused = a.gc(&GcOptions { max_bytes: Some(0), ..GcOptions::default() }).expect_err("nobody knows who lives");
    assert!(refused.to_string().contains("refuses locks"), "{refused}");
    let report = b.verify(None, 0, &mut |_, _| {}).expect("it can be read");
    assert!(report.damaged.is_empty(), "{report:?}");
}

#[test]
fn what_another_machine_deletes_is_a_miss_and_no_error() {
    let Some(lab) = Lab::new(false) else { return };
    let a = lab.store("a");
    let [small, large] = blobs(7).map(|bytes| a.put(&bytes).expect("writable"));
    a.flush().expect("files are synced");
    assert!(a.get(&small).expect("readable").is_some() && a.get(&large).expect("readable").is_some());
    // On the server; locks of this mount do not reach it, and the pack is open here.
    for entry in fs::read_dir(lab.folder.path().join("server/cache/packs")).expect("readable").flatten() {
        fs::remove_file(entry.path()).expect("our own");
    }
    let loose = lab.folder.path().join("server/cache/blobs");
    fs::remove_dir_all(&loose).expect("our own");
    fs::create_dir(&loose).expect("our own");
    thread::sleep(STALE + Duration::from_millis(200));
    let b = lab.store("b");
    for store in [&a, &b] {
        for digest in [small, large] {
            assert_eq!(store.get(&digest).expect("a miss is no error"), None);
        }
    }
    let again = a.put(&blobs(7)[0]).expect("it is made again");
    assert_eq!((again, a.get(&again).expect("readable")), (small, Some(blobs(7)[0].clone())));
    assert_eq!(again, Digest::of(&blobs(7)[0]));
}

#[test]
fn runs_on_a_file_system_without_locks_say_so_and_share_results() {
    let Some(lab) = Lab::new(true) else { return };
    let place = Place::new();
    place.tauflow(&["run", "small.yaml", "--update-lock"]).ends(0);
    let on = |machine: &str, arguments: &[&str]| {
        let mut command = place.command(arguments);
        Said::of(&command.env("TAUFLOW_CACHE", lab.path(machine)).output().expect("the program starts"))
    };
    let first = on("a", &["run", "small.yaml", "--locked"]).ends(0);
    assert!(first.err.contains("refuses locks") && first.err.contains("small.lock agrees"), "{}", first.err);
    thread::sleep(STALE);
    let second = on("b", &["run", "small.yaml", "--locked"]).ends(0);
    assert!(second.err.contains("nothing to do"), "{}", second.err);
    let stat = on("b", &["cache", "stat"]).ends(0);
    assert!(stat.out.contains("on FUSE, with"), "{}", stat.out);
    let refused = on("b", &["cache", "gc", "--max-size", "1KB"]);
    assert!(refused.code != 0 && refused.err.contains("on the machine that has the disk"), "{refused:?}");
}

#[test]
fn jobs_and_upstreams_work_on_a_file_system_that_lists_late_and_loses_answers() {
    let Some(lab) = Lab::new(false) else { return };
    let place = Place::new();
    place.tauflow(&["run", "small.yaml", "--update-lock"]).ends(0);
    let on = |machine: &str, arguments: &[&str]| {
        let upstream = lab.path(machine).with_file_name("upstream").display().to_string();
        let mut command = place.command(&[arguments, &["--upstream", &upstream]].concat());
        Said::of(&command.output().expect("the program starts"))
    };
    // Jobs in a cache on this file system, which then publish to an upstream on it.
    let shared = lab.path("a").display().to_string();
    let run = ["run", "small.yaml", "--locked", "--push", "--cache", &shared];
    let first = on("a", &[&run[..], &SHELL].concat()).ends(0);
    assert!(first.err.contains("small.lock agrees") && first.err.contains("pushed "), "{}", first.err);
    // This file system has no links, so that the run's own record is all that cannot be written.
    let warnings = |err: &str| err.lines().filter(|line| line.contains("warning")).count();
    let unrecorded = first.err.contains("warning: this run is not recorded");
    assert_eq!(warnings(&first.err), usize::from(unrecorded), "{}", first.err);
    // Jobs that share nothing but the upstream.
    let (own, workers) = (place.path("own").display().to_string(), place.path("workers").display().to_string());
    let apart = ["run", "small.yaml", "--cache", &own, "--worker-cache", &workers, "--set", "scenes.pool=9"];
    let second = on("b", &[&apart[..], &SHELL].concat()).ends(0);
    assert!(second.err.contains("jobs: ") && !second.err.contains("warning"), "{}", second.err);
    thread::sleep(STALE);
    let third = place.path("third").display().to_string();
    let third = on("b", &["run", "small.yaml", "--locked", "--cache", &third]).ends(0);
    assert!(third.err.contains("nothing to do"), "{}", third.err);
}
