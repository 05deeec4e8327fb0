//! The environment's failures have messages, and lose nothing.

use crate::{blob, fresh, open, record};
use std::{fs, path::Path, process::Command};
use tauflow_cache::{CacheError, Store};

#[test]
fn a_folder_that_cannot_be_written_is_named() {
    // Nobody, not even root, can make folders there.
    let error = Store::open(Path::new("/proc/tauflow-cache")).expect_err("no store in /proc");
    assert!(error.is_environment());
    assert!(error.to_string().contains("/proc/tauflow-cache") && error.to_string().contains("--cache"), "{error}");
}

#[test]
fn a_file_in_the_way_and_a_foreign_format_are_told() {
    let (dir, store) = fresh();
    drop(store);
    let file = dir.path().join("FORMAT");
    assert!(Store::open(&file).expect_err("a file is no folder").is_environment());
    fs::write(&file, "tauflow-cache 99\n").expect("write");
    assert!(matches!(Store::open(dir.path()), Err(CacheError::Format { .. })));
}

#[test]
fn pins_are_named_like_files() {
    let (_dir, store) = fresh();
    let digest = store.put(b"x").expect("put");
    for name in ["", "..", ".x", "a/b", "a b"] {
        assert!(matches!(store.pin(name, &digest), Err(CacheError::PinName { .. })), "{name}");
    }
    store.pin("paper-v1", &digest).expect("pin");
    assert_eq!(store.pins().expect("pins").into_iter().collect::<Vec<_>>(), [("paper-v1".to_owned(), digest)]);
    assert!(store.unpin("paper-v1").expect("unpin"));
    assert!(!store.unpin("paper-v1").expect("unpin"));
}

/// Runs in a child whose files may have one MiB: a stand-in for a disk that fills up.
#[test]
fn child_with_full_disk() {
    let Ok(dir) = std::env::var("TAUFLOW_CACHE_FULL") else { return };
    let store = open(Path::new(&dir));
    assert!(store.put(&blob(0, 2 << 20)).expect_err("too large").is_full());
    let mut kept = 0;
    let error = loop {
        match store.put(&blob(1 + kept, 50_000)) {
            Ok(digest) => store.record(&record(1 + kept, "p", vec![digest])).map(|_| ()).expect("record"),
            Err(error) => break error,
        }
        kept += 1;
    };
    assert!(error.is_full(), "{error}");
    assert!(error.to_string().contains("The disk is full"), "{error}");
    // Something smaller still fits, behind what did not.
    let digest = store.put(b"small").expect("put");
    store.record(&record(1000, "p", vec![digest])).expect("record");
    println!("kept={kept}");
}

#[test]
fn a_full_disk_is_told_and_loses_nothing() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let test = std::env::current_exe().expect("this program");
    let output = Command::new("sh")
        .args(["-c", "trap '' XFSZ; ulimit -f 2048; exec \"$0\" --exact errors::child_with_full_disk --nocapture"])
        .arg(test)
        .env("TAUFLOW_CACHE_FULL", dir.path())
        .output()
        .expect("sh runs");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    let kept: u64 = text.split("kept=").nth(1).and_then(|rest| rest.lines().next()?.parse().ok()).expect("its count");
    assert!(kept > 10);
    let store = open(dir.path());
    for n in (1..=kept).chain([1000]) {
        let found = store.lookup_full("action", &record(n, "", vec![]).key).expect("recorded");
        assert!(store.get(&found.refs[0]).expect("get").is_some());
    }
    assert!(store.verify(None, 0, &mut |_, _| ()).expect("verify").damaged.is_empty());
}
