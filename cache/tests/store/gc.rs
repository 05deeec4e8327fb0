//! A collection keeps what it must and removes the rest.

use crate::{blob, files, fresh, open, record};
use std::{path::Path, sync::atomic::AtomicBool, sync::atomic::Ordering::SeqCst, thread};
use tauflow_cache::{Digest, GcOptions, Store, tree};

const SIZES: [usize; 2] = [10_000, 100_000];

/// Records 1..=count, used at those times, with a small and a large blob each.
fn fill(dir: &Path, count: u64) -> Vec<[Digest; 2]> {
    let store = open(dir);
    let mut digests = Vec::new();
    for n in 1..=count {
        let both = SIZES.map(|size| store.put(&blob(n, size)).expect("put"));
        store.record(&record(n, "p", both.to_vec())).expect("record");
        digests.push(both);
    }
    digests
}

fn left(store: &Store, count: u64) -> Vec<u64> {
    (1..=count).filter(|n| store.lookup_full("action", &record(*n, "", vec![]).key).is_some()).collect()
}

fn readable(store: &Store, digests: &[Digest]) -> bool {
    digests.iter().all(|digest| store.get(digest).expect("get").is_some_and(|bytes| Digest::of(&bytes) == *digest))
}

#[test]
fn age_goes_but_pins_stay() {
    let (dir, store) = fresh();
    let digests = fill(dir.path(), 10);
    store.pin("paper", &digests[1][0]).expect("pin");
    let options = GcOptions { keep_within_secs: Some(3), now: 10, ..GcOptions::default() };
    let dry = store.gc(&GcOptions { dry_run: true, ..options.clone() }).expect("dry run");
    assert_eq!(left(&open(dir.path()), 10).len(), 10);
    let report = store.gc(&options).expect("gc");
    assert_eq!((report.removed_blobs, report.removed_records, report.kept_records), (10, 5, 5));
    assert_eq!((dry.removed_bytes, dry.kept_bytes), (report.removed_bytes, report.kept_bytes));
    for store in [&store, &open(dir.path())] {
        assert_eq!(left(store, 10), [2, 7, 8, 9, 10]);
        assert!(readable(store, &digests[1]) && readable(store, &digests[9]));
        assert!(!store.contains(&digests[0][0]) && !store.contains(&digests[0][1]));
    }
    let on_disk: u64 = files(&dir.path().join("packs")).iter().map(|path| path.metadata().expect("there").len()).sum();
    assert_eq!(on_disk, 5 * (10_000 + 52));
    assert!(files(&dir.path().join("trash")).is_empty());
    assert!(open(dir.path()).verify(None, 0, &mut |_, _| ()).expect("verify").damaged.is_empty());
}

#[test]
fn size_removes_the_least_recently_used_and_hits_count_as_use() {
    let (dir, store) = fresh();
    fill(dir.path(), 10);
    drop(store);
    let user = open(dir.path());
    user.set_time(50).expect("time");
    assert!(user.lookup_full("action", &record(1, "", vec![]).key).is_some());
    drop(user);
    let store = open(dir.path());
    let options = GcOptions { max_bytes: Some(3 * 110_000), now: 60, ..GcOptions::default() };
    let report = store.gc(&options).expect("gc");
    assert_eq!((report.kept_bytes, report.over_budget), (330_000, 0));
    drop(store);
    // The history of use outlives the collection.
    let store = open(dir.path());
    assert_eq!(store.gc(&GcOptions { max_bytes: Some(110_000), ..options }).expect("gc").kept_records, 1);
    assert_eq!(left(&store, 10), [1]);
}

#[test]
fn unreachable_blobs_go_and_nothing_else_by_default() {
    let (dir, store) = fresh();
    fill(dir.path(), 3);
    for size in SIZES {
        open(dir.path()).put(&blob(99, size)).expect("put");
    }
    let report = store.gc(&GcOptions::default()).expect("gc");
    assert_eq!((report.removed_blobs, report.kept_blobs, report.removed_records), (2, 6, 0));
    assert_eq!(left(&store, 3), [1, 2, 3]);
}

#[test]
fn live_stores_keep_what_they_wrote_and_looked_up() {
    let (dir, collector) = fresh();
    let digests = fill(dir.path(), 10);
    let live = open(dir.path());
    assert!(live.lookup("action", &record(4, "", vec![]).key).is_some());
    live.put(&blob(5, SIZES[0])).expect("put again");
    live.put(&blob(5, SIZES[1])).expect("put again");
    let mine = SIZES.map(|size| live.put(&blob(77, size)).expect("put"));
    let everything = GcOptions { keep_within_secs: Some(0), now: 1000, ..GcOptions::default() };
    let report = collector.gc(&everything).expect("gc");
    assert_eq!((report.live_stores, report.kept_records), (1, 2), "record 5 has all its blobs still");
    for store in [&live, &collector, &open(dir.path())] {
        assert!(readable(store, &digests[3]) && readable(store, &digests[4]) && readable(store, &mine));
    }
    // A deleted blob is a miss for the live store, and can be rebuilt.
    assert!(
        live.get(&digests[0][0]).expect("get").is_none() || live.lookup("action", &record(1, "", vec![]).key).is_none()
    );
    live.record(&record(77, "p", mine.to_vec())).expect("record");
    drop(live);
    assert_eq!(left(&open(dir.path()), 100), [4, 5, 77]);
    collector.gc(&everything).expect("gc");
    assert_eq!(collector.stat().expect("stat").blobs, 0);
}

#[test]
fn a_run_beside_collections_never_loses_what_it_holds() {
    let (dir, collector) = fresh();
    fill(dir.path(), 40);
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        let runs: Vec<_> = (0..3u64)
            .map(|seed| {
                let (dir, stop) = (dir.path(), &stop);
                scope.spawn(move || {
                    let mut rounds = 0;
                    while !stop.load(SeqCst) || rounds < 3 {
                        let store = open(dir);
                        let mut held = Vec::new();
                        for step in 0..40 {
                            let n = (step * 7 + seed * 13 + rounds) % 40 + 1;
                            let key = record(n, "", vec![]).key;
                            let refs = match store.lookup_full("action", &key) {
                                Some(found) => found.refs.clone(),
                                None => {
                                    let refs = SIZES.map(|size| store.put(&blob(n, size)).expect("put")).to_vec();
                                    store.record(&record(n, "p", refs.clone())).expect("record");
                                    refs
                                }
                            };
                            held.push((n, refs));
                            for (n, refs) in &held {
                                assert!(readable(&store, refs), "item {n}");
                            }
                        }
                        rounds += 1;
                    }
                })
            })
            .collect();
        for round in 0..25 {
            let keep = [Some(0), None][round % 2];
            let max = [None, Some(500_000)][round % 2];
            let options = GcOptions { keep_within_secs: keep, max_bytes: max, now: 1000, ..GcOptions::default() };
            collector.gc(&options).expect("gc");
        }
        stop.store(true, SeqCst);
        runs.into_iter().for_each(|run| run.join().expect("no panic"));
    });
    let report = open(dir.path()).verify(None, 0, &mut |_, _| ()).expect("verify");
    assert!(report.damaged.is_empty() && report.conflicts.is_empty() && report.incomplete_records == 0, "{report:?}");
}

#[test]
fn many_small_segments_become_one() {
    let (dir, store) = fresh();
    for n in 1..=20 {
        let other = open(dir.path());
        let digest = other.put(&blob(n, 100)).expect("put");
        other.record(&record(n, "p", vec![digest])).expect("record");
    }
    let count = || (files(&dir.path().join("packs")).len(), files(&dir.path().join("log")).len());
    assert_eq!(count(), (20, 20));
    let report = store.gc(&GcOptions::default()).expect("gc");
    assert_eq!((report.removed_blobs, report.removed_records), (0, 0));
    assert_eq!(count(), (1, 1));
    assert_eq!(left(&store, 20).len(), 20);
    assert_eq!(left(&open(dir.path()), 20).len(), 20);
}

#[test]
fn a_collection_that_died_is_undone_by_the_next() {
    let (dir, store) = fresh();
    let digests = fill(dir.path(), 2);
    // As a collection killed after step 2.
    let large = digests[0][1];
    let loose = dir.path().join("blobs").join(&large.hex()[..2]).join(large.to_string());
    for path in [loose, files(&dir.path().join("packs"))[0].clone(), files(&dir.path().join("log"))[0].clone()] {
        let name = path.file_name().expect("a name");
        std::fs::rename(&path, dir.path().join("trash").join(name)).expect("rename");
    }
    assert!(left(&open(dir.path()), 2).is_empty());
    store.gc(&GcOptions::default()).expect("gc");
    assert_eq!(left(&open(dir.path()), 2), [1, 2]);
}

#[test]
fn what_is_quickest_to_make_again_goes_first_and_summaries_before_it() {
    let (dir, store) = fresh();
    // Record n took n seconds for a blob of the same size; the last but one was used last.
    let mut digests = Vec::new();
    for n in 1..=6 {
        let digest = store.put(&blob(n, 10_000)).expect("put");
        let made = tauflow_cache::Record { wall_us: n * 1_000_000, ..record(100 - n, "p", vec![digest]) };
        store.record(&tauflow_cache::Record { when: n, ..made }).expect("record");
        digests.push(digest);
    }
    let tree = store.put(&tree::encode(&digests, &[], b"")).expect("put");
    let all =
        tauflow_cache::Record { trees: vec![tree], derived: true, wall_us: u64::MAX, ..record(1000, "all", vec![]) };
    store.record(&all).expect("record");
    drop(store);
    let store = open(dir.path());
    store.gc(&GcOptions { max_bytes: Some(30_500), now: 10, ..GcOptions::default() }).expect("gc");
    let left: Vec<u64> = (1..=6).filter(|n| store.contains(&digests[*n as usize - 1])).collect();
    assert_eq!(left, [4, 5, 6]);
    assert!(store.lookup("action", &all.key).is_none() && !store.contains(&tree), "what it sums up is not there");
}

#[test]
fn a_tree_keeps_what_it_lists_and_goes_with_its_record() {
    let (dir, store) = fresh();
    let leaves: Vec<Digest> = (0..4).map(|n| store.put(&blob(n, SIZES[n as usize % 2])).expect("put")).collect();
    let low = store.put(&tree::encode(&leaves[..2], &[], b"low")).expect("put");
    let top = store.put(&tree::encode(&leaves[2..3], &[low], b"top")).expect("put");
    let made = tauflow_cache::Record { trees: vec![top], ..record(5, "p", vec![]) };
    store.record(&made).expect("record");
    assert_eq!(store.reach(&[], &[top]).expect("readable").len(), 5);
    drop(store);
    let store = open(dir.path());
    let report = store.gc(&GcOptions::default()).expect("gc");
    assert_eq!((report.removed_blobs, report.kept_blobs), (1, 5), "the fourth leaf is nobody's");
    assert!(readable(&store, &leaves[..3]) && readable(&store, &[low, top]));
    // A live store that looked the record up keeps all of it.
    let user = open(dir.path());
    assert!(user.lookup("action", &made.key).is_some());
    let options = GcOptions { max_bytes: Some(0), now: 100, ..GcOptions::default() };
    assert_eq!(store.gc(&options).expect("gc").removed_blobs, 0);
    drop(user);
    let old = GcOptions { keep_within_secs: Some(1), ..options };
    assert_eq!(open(dir.path()).gc(&old).expect("gc").kept_blobs, 0);
    // A tree that is gone is a miss: the record is incomplete, and verification says so.
    let store = open(dir.path());
    let blob = store.put(b"leaf").expect("put");
    let tree = tree::encode(&[blob], &[], b"");
    let gone = tauflow_cache::Record { trees: vec![Digest::of(&tree)], ..record(6, "p", vec![]) };
    store.record(&gone).expect("record");
    assert_eq!(store.verify(None, 0, &mut |_, _| ()).expect("verify").incomplete_records, 1);
}

#[test]
fn a_store_that_is_being_made_is_not_swept() {
    let (dir, store) = fresh();
    let done = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            while !done.load(SeqCst) {
                store.gc(&GcOptions::default()).expect("gc");
            }
        });
        let opened: Vec<_> = (0..300)
            .map(|_| {
                // As if it and the collection's store had both found an empty folder.
                let _ = std::fs::remove_file(dir.path().join("FORMAT")); // gone if it could not be made before
                Store::open(dir.path()).map(drop)
            })
            .collect();
        done.store(true, SeqCst);
        assert_eq!(opened.into_iter().filter_map(Result::err).map(|e| e.to_string()).collect::<Vec<_>>(), [""; 0]);
    });
}
