//! Records are found by key, and never silently changed.

use crate::{blob, files, flip, fresh, open, record};
use std::{fs, path::PathBuf};
use tauflow_cache::{Digest, GcOptions, Record, Recorded, Store, tree};

fn payload(store: &Store, n: u64) -> Option<String> {
    store.lookup("action", &record(n, "", vec![]).key).map(|record| record.payload.clone())
}

#[test]
fn records_round_trip_and_survive_reopening() {
    let (dir, store) = fresh();
    let written = record(1, "{\"out\":2}", vec![Digest::of(b"nowhere")]);
    assert_eq!(store.record(&written).expect("record"), Recorded::New);
    assert_eq!(store.record(&written).expect("record"), Recorded::Same);
    for _ in 0..2 {
        assert_eq!(store.lookup("action", &written.key).as_deref(), Some(&written));
        assert_eq!(open(dir.path()).lookup("action", &written.key).as_deref(), Some(&written));
        assert!(store.lookup("memo", &written.key).is_none());
        store.flush().expect("flush");
    }
    assert!(store.lookup_full("action", &written.key).is_none(), "its blob is not there");
    store.put(b"nowhere").expect("put");
    assert!(store.lookup_full("action", &written.key).is_some());
}

#[test]
fn another_payload_is_a_conflict_and_does_not_overwrite() {
    let (dir, store) = fresh();
    store.record(&record(1, "a", vec![])).expect("record");
    let conflict = store.record(&record(1, "b", vec![])).expect("record");
    assert_eq!(conflict, Recorded::Conflict { existing: Box::new(record(1, "a", vec![])) });
    assert_eq!(payload(&store, 1).as_deref(), Some("a"));
    store.replace(&record(1, "c", vec![])).expect("replace");
    assert_eq!(payload(&store, 1).as_deref(), Some("c"));
    drop(store);
    assert_eq!(payload(&open(dir.path()), 1).as_deref(), Some("c"));
    let store = open(dir.path());
    store.replace(&record(1, "d", vec![])).expect("replace");
    assert_eq!(payload(&open(dir.path()), 1).as_deref(), Some("d"));
}

#[test]
fn a_conflict_of_two_processes_has_one_winner_everywhere_and_is_reported() {
    let (dir, first) = fresh();
    let second = open(dir.path());
    // Neither looks before it writes.
    first.record(&record(1, "a", vec![])).expect("record");
    second.record(&record(1, "b", vec![])).expect("record");
    let third = open(dir.path());
    for store in [&first, &second, &third] {
        store.refresh().expect("refresh");
    }
    let winners = [&first, &second, &third].map(|store| payload(store, 1));
    assert!(winners.iter().all(|winner| *winner == winners[0]), "{winners:?}");
    assert_eq!(third.stat().expect("stat").conflicts, 1);
    assert_eq!(third.verify(None, 0, &mut |_, _| ()).expect("verify").conflicts.len(), 1);
}

#[test]
fn other_instances_see_records_at_once_after_a_claim_and_soon_otherwise() {
    let (dir, writer) = fresh();
    let reader = open(dir.path());
    assert_eq!(payload(&reader, 1), None);
    writer.record(&record(1, "a", vec![])).expect("record");
    let _claim = reader.claim(&record(1, "", vec![]).key).expect("claim");
    assert_eq!(payload(&reader, 1).as_deref(), Some("a"));
    writer.record(&record(2, "b", vec![])).expect("record");
    std::thread::sleep(std::time::Duration::from_millis(150));
    assert_eq!(payload(&reader, 2).as_deref(), Some("b"));
}

#[test]
fn by_label_finds_near_runs_oldest_first() {
    let (_dir, store) = fresh();
    for n in [3, 1, 2] {
        store.record(&record(n, "p", vec![])).expect("record");
    }
    let mut other = record(9, "p", vec![]);
    other.label = "training".into();
    store.record(&other).expect("record");
    let whens: Vec<u64> = store.by_label("action", "ladder").iter().map(|record| record.when).collect();
    assert_eq!(whens, [1, 2, 3]);
    assert!(store.by_label("memo", "ladder").is_empty());
    let stat = store.stat().expect("stat");
    assert_eq!((stat.records["action"]["ladder"].count, stat.records["action"]["ladder"].wall_us), (3, 30));
}

#[test]
fn a_torn_tail_loses_only_what_was_torn() {
    // Cut at every byte of the first record, of one between others, and of the last: more are like the one between.
    const RECORDS: u64 = 3;
    let (dir, store) = fresh();
    for n in 0..RECORDS {
        store.record(&record(n, "p", vec![])).expect("record");
    }
    let log = files(&dir.path().join("log"))[0].clone();
    std::mem::forget(store); // as a killed process: no flush, no mark
    let whole = fs::read(&log).expect("read");
    for cut in 0..whole.len() {
        fs::write(&log, &whole[..cut]).expect("write");
        let store = open(dir.path());
        let found = (0..RECORDS).take_while(|n| payload(&store, *n).is_some()).count();
        assert_eq!(found, cut * RECORDS as usize / whole.len(), "cut at {cut} of {}", whole.len());
        assert!((found as u64..RECORDS).all(|n| payload(&store, n).is_none()));
        // Later writes go to a different segment.
        if cut % 29 == 0 {
            store.record(&record(100 + cut as u64, "p", vec![])).expect("record");
            assert!(payload(&open(dir.path()), 100 + cut as u64).is_some());
        }
    }
}

#[test]
fn a_damaged_record_is_a_miss_and_its_neighbours_are_not() {
    let (dir, store) = fresh();
    for n in 0..10 {
        store.record(&record(n, "p", vec![])).expect("record");
    }
    drop(store);
    let log = files(&dir.path().join("log"))[0].clone();
    let frame = (fs::metadata(&log).expect("metadata").len() as usize - 33) / 10;
    flip(&log, 33 + frame * 5 + 10); // in the fifth
    let store = open(dir.path());
    let found: Vec<u64> = (0..10).filter(|n| payload(&store, *n).is_some()).collect();
    assert_eq!(found, [0, 1, 2, 3, 5, 6, 7, 8, 9]);
    assert_eq!(store.record(&record(4, "p", vec![])).expect("record"), Recorded::New);
    assert_eq!(store.verify(None, 0, &mut |_, _| ()).expect("verify").damaged_records, 1);
}

#[test]
fn thousands_of_records_reopen_from_the_index_file_and_without_it() {
    let (dir, store) = fresh();
    let digest = store.put(&blob(1, 100)).expect("put");
    for n in 0..5000u64 {
        store.put(&n.to_le_bytes()).expect("put");
        store.record(&record(n, "p", vec![digest])).expect("record");
    }
    drop(store);
    let is_index = |path: &std::path::PathBuf| path.extension().is_some_and(|extension| extension == "idx");
    let indices: Vec<_> = files(dir.path()).into_iter().filter(is_index).collect();
    assert_eq!(indices.len(), 2);
    let check = || {
        let store = open(dir.path());
        for n in (0..5000u64).step_by(7) {
            assert!(store.lookup_full("action", &record(n, "", vec![]).key).is_some());
            assert!(store.get(&Digest::of(&n.to_le_bytes())).expect("get").is_some());
        }
        assert_eq!(store.stat().expect("stat").records["action"]["ladder"].count, 5000);
    };
    check();
    flip(&indices[0], 50);
    fs::remove_file(&indices[1]).expect("remove");
    check();
    assert!(indices[1].exists(), "it was made again");
    check();
}

#[test]
fn what_is_lost_is_told_from_what_was_never_stored() {
    let (dir, store) = fresh();
    let kept = store.put(&blob(1, 3000)).expect("put");
    let in_memory = Digest::of(b"handed on in memory");
    let of = |n: u64, refs: Vec<Digest>| store.record(&record(n, "p", refs)).expect("record");
    of(1, vec![kept]);
    store.record(&Record { transient: true, ..record(2, "p", vec![in_memory]) }).expect("record");
    // Another passes it on, and a third sums that up.
    of(3, vec![kept, in_memory]);
    let low = store.put(&tree::encode(&[in_memory], &[], b"low")).expect("put");
    let top = store.put(&tree::encode(&[kept], &[low], b"top")).expect("put");
    store.record(&Record { trees: vec![top], derived: true, ..record(4, "p", vec![]) }).expect("record");
    drop(store);
    let verify = || {
        let report = open(dir.path()).verify(None, 0, &mut |_, _| ()).expect("verify");
        (report.incomplete_records, report.lost_records, report.is_damaged())
    };
    assert_eq!(verify(), (3, 0, false));
    // The pack is gone, and with it the first blob and the listings.
    fs::remove_file(&files(&dir.path().join("packs"))[0]).expect("it is there");
    assert_eq!(verify(), (4, 3, true));
    // A collection keeps what it would keep otherwise: what is lost comes back when it is needed.
    let recent = GcOptions { keep_within_secs: Some(1000), now: 10, ..GcOptions::default() };
    let report = open(dir.path()).gc(&recent).expect("gc");
    assert_eq!((report.removed_records, report.kept_records, report.lost_records), (0, 4, 3));
    assert_eq!(verify(), (4, 3, true));
    let known = |n: u64| open(dir.path()).lookup("action", &record(n, "", vec![]).key).is_some();
    assert!((1..=4).all(known));
    // Where it is asked to, it clears away what has lost something, however recent, and leaves what has not.
    let cleared = GcOptions { lost: true, ..recent };
    let dry = open(dir.path()).gc(&GcOptions { dry_run: true, ..cleared.clone() }).expect("a dry run");
    let report = open(dir.path()).gc(&cleared).expect("gc");
    assert_eq!((report.removed_records, report.kept_records, report.lost_records), (3, 1, 0));
    assert_eq!((dry.removed_records, dry.lost_records), (3, 0));
    assert_eq!(verify(), (1, 0, false));
    assert!(open(dir.path()).lookup("action", &record(2, "", vec![]).key).is_some_and(|found| found.transient));
}

#[test]
fn a_record_that_lost_its_blobs_goes_with_age_and_stays_for_those_who_hold_it() {
    let (dir, store) = fresh();
    for n in [1, 50, 60] {
        let digest = store.put(&blob(n, 3000)).expect("put");
        store.record(&record(n, "p", vec![digest])).expect("record");
    }
    drop(store);
    fs::remove_file(&files(&dir.path().join("packs"))[0]).expect("it is there");
    let left = |store: &Store| [1, 50, 60].map(|n| store.read("action", &record(n, "", vec![]).key).is_some());
    let recent = GcOptions { keep_within_secs: Some(20), now: 61, ..GcOptions::default() };
    open(dir.path()).gc(&recent).expect("gc");
    assert_eq!(left(&open(dir.path())), [false, true, true], "the old one went");
    // Whoever lives and has looked one up keeps it even from a collection that takes what is lost.
    let live = open(dir.path());
    assert!(live.lookup("action", &record(50, "", vec![]).key).is_some());
    let report = open(dir.path()).gc(&GcOptions { lost: true, ..recent }).expect("gc");
    assert_eq!((left(&open(dir.path())), report.lost_records), ([false, true, false], 1));
    // The action that ran again makes it whole.
    live.put(&blob(50, 3000)).expect("put");
    drop(live);
    assert!(!open(dir.path()).verify(None, 0, &mut |_, _| ()).expect("verify").is_damaged());
}

#[test]
fn damage_is_told_each_time_the_store_is_opened() {
    let (dir, store) = fresh();
    for n in 0..5000 {
        store.record(&record(n, "p", vec![])).expect("record");
    }
    std::mem::forget(store); // as a killed process: no index file
    let log = files(&dir.path().join("log"))[0].clone();
    let middle = fs::metadata(&log).expect("metadata").len() as usize / 2;
    flip(&log, middle);
    // The lease of the killed one is this process's: without it, its owner is dead.
    fs::remove_dir_all(dir.path().join("leases")).expect("it is ours");
    for _ in 0..2 {
        let store = open(dir.path());
        assert!(store.damaged_log_places() > 0);
        assert!(store.verify(None, 0, &mut |_, _| ()).expect("verify").damaged_records > 0);
    }
    // Records that an index file lacks are found by look-up.
    open(dir.path()).gc(&GcOptions::default()).expect("gc");
    let store = open(dir.path());
    assert_eq!(store.damaged_log_places(), 0, "it was cleared away");
    let kept = store.keys_like("action", "");
    let log = files(&dir.path().join("log")).into_iter().find(|path| path.extension().is_some_and(|e| e == "log"));
    drop(store);
    let store = open(dir.path());
    flip(&log.expect("a log"), 40_000);
    assert_eq!(kept.iter().filter(|key| store.lookup("action", key).is_none()).count(), 1);
    assert_eq!(store.damaged_log_places(), 1);
}

/// A store whose log has an index file, which lists a record that has been damaged since.
fn with_a_damaged_record(generations: u32) -> (tempfile::TempDir, Record) {
    let (dir, store) = fresh();
    for n in 0..1000 {
        store.record(&record(n, "p", vec![])).expect("record");
    }
    let last = record(1000, "p", vec![]);
    (0..generations).for_each(|_| store.replace(&last).expect("replace"));
    drop(store);
    let all = files(&dir.path().join("log"));
    let [log, index]: &[PathBuf; 2] = all.as_slice().try_into().expect("a log and its index file");
    assert_eq!(index, &log.with_added_extension("idx"));
    let mut bytes = fs::read(log).expect("readable");
    let end = bytes.len() - 33; // the commit mark
    bytes[end - 50..end].fill(0);
    fs::write(log, bytes).expect("writable");
    (dir, last)
}

#[test]
fn a_damaged_record_that_an_index_file_lists_is_replaced_for_good() {
    let verify = |store: &Store| store.verify(None, 0, &mut |_, _| ()).expect("verify");
    // Found by a look-up, by a verification, or not before it is recorded; and the new one may say something else.
    for (way, payload, generations) in [(0, "p", 1), (0, "q", 1), (0, "q", 3), (1, "q", 1), (2, "p", 1), (2, "q", 2)] {
        let (dir, damaged) = with_a_damaged_record(generations);
        let again = Record { payload: payload.into(), ..damaged };
        let found = |store: &Store| store.lookup("action", &again.key).map(|found| (*found).clone());
        let beside = open(dir.path());
        let store = open(dir.path());
        match way {
            0 => assert_eq!(found(&store), None),
            1 => assert_eq!(verify(&store).damaged_records, 1),
            _ => {}
        }
        assert_eq!(store.record(&again).expect("record"), Recorded::New, "{way} {payload}");
        assert_eq!(store.record(&again).expect("record"), Recorded::Same);
        beside.refresh().expect("refresh");
        for store in [store, beside, open(dir.path()), open(dir.path())] {
            assert_eq!(found(&store).as_ref(), Some(&again), "{way} {payload} {generations}");
        }
        let report = verify(&open(dir.path()));
        assert!(!report.is_damaged() && report.conflicts.is_empty() && report.records == 1001, "{report:?}");
    }
}

#[test]
fn a_collection_clears_away_a_damaged_record_that_an_index_file_lists() {
    let (dir, damaged) = with_a_damaged_record(1);
    let verify = || open(dir.path()).verify(None, 0, &mut |_, _| ()).expect("verify");
    assert_eq!((verify().damaged_records, verify().damaged_records), (1, 1), "no run has made it again");
    open(dir.path()).gc(&GcOptions::default()).expect("gc");
    assert_eq!((verify().damaged_records, verify().records), (0, 1000));
    assert_eq!(open(dir.path()).lookup("action", &damaged.key), None);
}

#[test]
fn a_record_without_a_commit_mark_has_lost_nothing() {
    let (dir, store) = fresh();
    store.record(&record(1, "p", vec![Digest::of(b"cut off by the power")])).expect("record");
    let copy = tempfile::tempdir().expect("a temporary folder");
    for name in ["FORMAT", "CACHEDIR.TAG"] {
        fs::copy(dir.path().join(name), copy.path().join(name)).expect("writable");
    }
    fs::create_dir(copy.path().join("log")).expect("writable");
    let log = files(&dir.path().join("log")).remove(0);
    fs::copy(&log, copy.path().join("log").join(log.file_name().expect("a name"))).expect("writable");
    let report = open(copy.path()).verify(None, 0, &mut |_, _| ()).expect("verify");
    assert_eq!((report.incomplete_records, report.lost_records), (1, 0));
    // With the mark it has.
    drop(store);
    fs::copy(&log, copy.path().join("log").join(log.file_name().expect("a name"))).expect("writable");
    let report = open(copy.path()).verify(None, 0, &mut |_, _| ()).expect("verify");
    assert_eq!((report.incomplete_records, report.lost_records), (1, 1));
}
