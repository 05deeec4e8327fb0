//! One action runs in one place at a time.

use crate::{fresh, open, record};
use std::{
    sync::atomic::{AtomicU32, Ordering::SeqCst},
    thread,
    time::Duration,
};
use tauflow_cache::{CacheError, Key};

#[test]
fn a_claim_excludes_threads_and_instances_until_it_is_dropped() {
    let (dir, store) = fresh();
    let other = open(dir.path());
    let key = Key::of(b"k");
    let claim = store.claim(&key).expect("claim");
    assert!(!claim.waited());
    assert!(other.try_claim(&key).expect("try").is_none());
    assert!(matches!(store.claim(&key), Err(CacheError::ClaimedTwice { .. })));
    thread::scope(|scope| {
        assert!(scope.spawn(|| store.try_claim(&key).expect("try").is_none()).join().expect("no panic"));
        let waiting = scope.spawn(|| other.claim(&key).expect("claim").waited());
        thread::sleep(Duration::from_millis(50));
        drop(claim);
        assert!(waiting.join().expect("no panic"));
    });
    assert!(other.try_claim(&key).expect("try").is_some());
}

#[test]
fn one_thread_holds_many_keys() {
    let (_dir, store) = fresh();
    let claims: Vec<_> = (0..500u64).map(|n| store.claim(&Key::of(&n.to_le_bytes())).expect("claim")).collect();
    assert_eq!(claims.len(), 500);
}

#[test]
fn many_instances_run_each_action_once() {
    let (dir, _store) = fresh();
    let runs = AtomicU32::new(0);
    let running: Vec<AtomicU32> = (0..20).map(|_| AtomicU32::new(0)).collect();
    thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let store = open(dir.path());
                for (n, running) in running.iter().enumerate() {
                    let action = record(n as u64, "p", vec![]);
                    let _claim = store.claim(&action.key).expect("claim");
                    if store.lookup("action", &action.key).is_some() {
                        continue;
                    }
                    assert_eq!(running.fetch_add(1, SeqCst), 0);
                    runs.fetch_add(1, SeqCst);
                    thread::yield_now();
                    store.record(&action).expect("record");
                    running.fetch_sub(1, SeqCst);
                }
            });
        }
    });
    assert_eq!(runs.into_inner(), 20);
}
