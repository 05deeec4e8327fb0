//! A killed process loses nothing that it was told is written.

use crate::{blob, files, flip, fresh, open, record};
use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::{Command, Stdio},
};
use tauflow_cache::Key;

/// Runs in a child: writes until it is killed, and says what is done.
#[test]
fn child_that_writes() {
    let Ok(dir) = std::env::var("TAUFLOW_CACHE_KILL") else { return };
    let store = open(Path::new(&dir));
    let _claim = store.claim(&Key::of(b"held by the child")).expect("claim");
    for n in 0.. {
        let digest = store.put(&blob(n, if n % 8 == 0 { 100_000 } else { 5000 })).expect("put");
        store.record(&record(n, "p", vec![digest])).expect("record");
        println!("done={n}");
    }
}

/// Kills a child with SIGKILL after it has written `count` records; returns how many it reported.
fn kill_after(dir: &Path, count: u64) -> u64 {
    let mut child = Command::new(std::env::current_exe().expect("this program"))
        .args(["--exact", "crash::child_that_writes", "--nocapture"])
        .env("TAUFLOW_CACHE_KILL", dir)
        .stdout(Stdio::piped())
        .spawn()
        .expect("the child starts");
    let lines = BufReader::new(child.stdout.take().expect("piped")).lines();
    let mut done = 0;
    for line in lines.map_while(Result::ok) {
        let Some(n) = line.split("done=").nth(1).and_then(|n| n.trim().parse::<u64>().ok()) else { continue };
        done = n + 1;
        if done == count {
            child.kill().expect("kill");
        }
    }
    child.wait().expect("the child ends");
    done
}

#[test]
fn kill_9_loses_nothing_that_was_reported() {
    let (dir, witness) = fresh();
    let mut total = 0;
    for count in [1, 40, 900] {
        let done = kill_after(dir.path(), count);
        assert!(done >= count, "the child ended by itself after {done} records");
        total = total.max(done);
        // The claim died with its holder.
        drop(witness.try_claim(&Key::of(b"held by the child")).expect("try").expect("free"));
        for store in [&witness, &open(dir.path())] {
            store.refresh().expect("refresh");
            for n in 0..total {
                let found = store.lookup_full("action", &record(n, "", vec![]).key).expect("recorded");
                assert!(store.get(&found.refs[0]).expect("get").is_some());
            }
        }
    }
    let report = witness.verify(None, 0, &mut |_, _| ()).expect("verify");
    assert!(report.damaged.is_empty() && report.incomplete_records == 0, "{report:?}");
}

#[test]
fn without_a_commit_mark_a_record_is_believed_only_with_good_blobs() {
    let (dir, store) = fresh();
    // A power cut: the log reached the disk, the blobs did not. Nothing was committed.
    let small = store.put(&blob(1, 5000)).expect("put");
    let large = store.put(&blob(1, 100_000)).expect("put");
    let fine = store.put(&blob(2, 100_000)).expect("put");
    for (n, digest) in [(1, small), (2, large), (3, fine)] {
        store.record(&record(n, "p", vec![digest])).expect("record");
    }
    std::mem::forget(store);
    flip(&files(&dir.path().join("packs"))[0], 100);
    flip(&dir.path().join("blobs").join(&large.hex()[..2]).join(large.to_string()), 100);
    let store = open(dir.path());
    let found = [1, 2, 3].map(|n| store.lookup_full("action", &record(n, "", vec![]).key).is_some());
    assert_eq!(found, [false, false, true]);
    assert!(!store.contains(&small) && !store.contains(&large));
    // Running again heals.
    store.put(&blob(1, 5000)).expect("put");
    store.record(&record(1, "p", vec![small])).expect("record");
    assert!(store.lookup_full("action", &record(1, "", vec![]).key).is_some());
}
