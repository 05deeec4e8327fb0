//! Blobs come back whole or not at all.

use crate::{blob, files, flip, fresh, open, record};
use std::{collections::BTreeSet, fs, thread};
use tauflow_cache::Digest;

const SMALL: usize = 5000;
const LARGE: usize = 200_000;

#[test]
fn small_large_and_empty_blobs_round_trip_and_survive_reopening() {
    let (dir, store) = fresh();
    let contents = [vec![], b"x".to_vec(), blob(1, SMALL), blob(2, 65_535), blob(3, 65_536), blob(4, LARGE)];
    let digests: Vec<Digest> = contents.iter().map(|bytes| store.put(bytes).expect("put")).collect();
    for reopened in [false, true] {
        let other;
        let store = if reopened {
            other = open(dir.path());
            &other
        } else {
            &store
        };
        for (digest, bytes) in digests.iter().zip(&contents) {
            assert!(store.contains(digest));
            assert_eq!(store.get(digest).expect("get").as_ref(), Some(bytes));
            assert_eq!(store.put(bytes).expect("put again"), *digest);
        }
    }
    assert_eq!(files(&dir.path().join("packs")).len(), 1, "the second instance found everything there");
    drop(store);
    let stat = open(dir.path()).stat().expect("stat");
    assert_eq!((stat.blobs, stat.loose), (6, 2));
    assert_eq!(stat.bytes, contents.iter().map(|bytes| bytes.len() as u64).sum::<u64>());
}

#[test]
fn a_size_that_does_not_fit_the_hash_is_a_miss() {
    let (_dir, store) = fresh();
    for size in [SMALL, LARGE] {
        let mut digest = store.put(&blob(1, size)).expect("put");
        digest.size += 1;
        assert!(!store.contains(&digest));
        assert_eq!(store.get(&digest).expect("get"), None);
    }
}

#[test]
fn a_damaged_blob_is_a_miss_goes_to_quarantine_and_heals() {
    for (size, folder) in [(SMALL, "packs"), (LARGE, "blobs")] {
        let (dir, store) = fresh();
        let digest = store.put(&blob(1, size)).expect("put");
        let other = store.put(&blob(2, 10)).expect("put");
        drop(store);
        // The small blob lies before the other one in the pack.
        flip(&files(&dir.path().join(folder))[0], if size == SMALL { 10 + 52 + 100 } else { 100 });
        let store = open(dir.path());
        assert!(store.contains(&digest), "presence and size are all that is looked at");
        assert_eq!(store.get(&digest).expect("get"), None);
        assert!(!store.contains(&digest));
        assert_eq!(files(&dir.path().join("quarantine")).len(), 1);
        // Others know without reading.
        assert!(!open(dir.path()).contains(&digest));
        assert_eq!(store.put(&blob(1, size)).expect("put heals"), digest);
        for store in [&store, &open(dir.path())] {
            assert_eq!(store.get(&digest).expect("get"), Some(blob(1, size)));
            assert!(store.get(&other).expect("get").is_some());
        }
    }
}

#[test]
fn a_deleted_blob_is_a_miss() {
    let (dir, store) = fresh();
    let large = store.put(&blob(1, LARGE)).expect("put");
    let small = store.put(&blob(1, SMALL)).expect("put");
    fs::remove_file(&files(&dir.path().join("blobs"))[0]).expect("remove");
    assert!(!store.contains(&large));
    assert_eq!(store.get(&large).expect("get"), None);
    drop(store);
    fs::remove_dir_all(dir.path().join("packs")).expect("remove");
    let store = open(dir.path());
    assert_eq!(store.get(&small).expect("get"), None);
    store.put(&blob(1, SMALL)).expect("put heals");
    assert!(store.get(&small).expect("get").is_some());
}

#[test]
fn a_writer_survives_the_removal_of_its_files() {
    let (dir, store) = fresh();
    store.put(&blob(1, SMALL)).expect("put");
    store.record(&record(1, "a", vec![])).expect("record");
    for folder in ["packs", "log"] {
        fs::remove_file(&files(&dir.path().join(folder))[0]).expect("remove");
    }
    store.refresh().expect("refresh");
    let digest = store.put(&blob(1, SMALL)).expect("put");
    store.record(&record(1, "a", vec![digest])).expect("record");
    drop(store);
    let store = open(dir.path());
    assert!(store.lookup_full("action", &record(1, "", vec![]).key).is_some());
}

#[test]
fn instances_and_threads_write_and_read_at_the_same_time() {
    let (dir, reader) = fresh();
    let digests: BTreeSet<Digest> = thread::scope(|scope| {
        let writers: Vec<_> = (0..4u64)
            .map(|writer| {
                let dir = dir.path();
                scope.spawn(move || {
                    let store = open(dir);
                    let mut digests = Vec::new();
                    for n in 0..100 {
                        // Half of the blobs are the same for all writers.
                        let n = if n % 2 == 0 { n } else { n + 1000 * (writer + 1) };
                        let digest = store.put(&blob(n, if n % 10 == 0 { 70_000 } else { 3000 })).expect("put");
                        store.record(&record(n, "same", vec![digest])).expect("record");
                        digests.push(digest);
                    }
                    digests
                })
            })
            .collect();
        writers.into_iter().flat_map(|writer| writer.join().expect("no panic")).collect()
    });
    reader.refresh().expect("refresh");
    assert_eq!(digests.len(), 50 + 4 * 50);
    for digest in &digests {
        let bytes = reader.get(digest).expect("get").expect("it is there");
        assert_eq!(Digest::of(&bytes), *digest);
    }
    let report = reader.verify(None, 0, &mut |_, _| ()).expect("verify");
    assert_eq!((report.blobs, report.checked, report.records), (250, 250, 250));
    assert_eq!((report.damaged.len(), report.incomplete_records, report.conflicts.len()), (0, 0, 0));
}

#[test]
fn verify_counts_quarantines_and_samples() {
    let (dir, store) = fresh();
    let digests: Vec<Digest> = (0..200).map(|n| store.put(&blob(n, 1000)).expect("put")).collect();
    store.put(&blob(0, LARGE)).expect("put");
    for (n, digest) in digests.iter().enumerate() {
        store.record(&record(n as u64, "p", vec![*digest])).expect("record");
    }
    drop(store);
    flip(&files(&dir.path().join("packs"))[0], 500);
    let store = open(dir.path());
    let some = store.verify(Some(0.25), 1, &mut |_, _| ()).expect("verify").checked;
    assert!((20..90).contains(&some), "{some} of 201");
    let mut steps = 0;
    let report = store.verify(None, 0, &mut |_, _| steps += 1).expect("verify");
    let before = usize::from(report.damaged.is_empty()); // the sample may have found it
    assert_eq!((report.damaged.len() + before, report.incomplete_records), (1, 1));
    assert_eq!(steps, report.blobs);
    let again = open(dir.path()).verify(None, 0, &mut |_, _| ()).expect("verify");
    assert_eq!((again.damaged.len(), again.incomplete_records, again.blobs), (0, 1, 200));
}
