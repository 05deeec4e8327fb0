//! Files that somebody made up, or that something damaged, are data: no panic, no wrong bytes, and no more memory than
//! there are bytes.
//!
//! `TAUFLOW_FUZZ_SECONDS` says how long files are damaged at random; a few seconds otherwise, 30 with `TAUFLOW_SLOW=1`.

mod crafted;
mod damaged;

use crate::blob;
use std::{path::Path, process::Command};
use tauflow_cache::{Digest, GcOptions, Store, tree};

/// Runs a test of this program with 1 GiB of memory, and some for the program itself.
fn with_a_gigabyte(test: &str, variable: &str, value: &str) {
    let output = Command::new("sh")
        .args(["-c", "ulimit -v 1310720; exec \"$0\" \"$@\""])
        .arg(std::env::current_exe().expect("this program"))
        .args(["--exact", test, "--nocapture", "--test-threads", "1"])
        .env(variable, value)
        .output()
        .expect("sh runs");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{}\n{text}{}", output.status, String::from_utf8_lossy(&output.stderr));
    assert!(text.contains("1 passed"), "{text}");
    print!("{text}");
}

/// All that can be asked of a store. Errors are fine; what is given must be what it says.
fn use_all(dir: &Path, digests: &[Digest]) {
    let Ok(store) = Store::open(dir) else { return };
    let _ = store.stat();
    let mut refs: Vec<Digest> = digests.to_vec();
    for namespace in ["action", "rollup"] {
        for key in store.keys_like(namespace, "") {
            for found in [store.lookup(namespace, &key), store.lookup_full(namespace, &key)].into_iter().flatten() {
                refs.extend(found.refs.iter().chain(&found.trees).take(50));
                if let Ok(reached) = store.reach(&found.refs, &found.trees) {
                    refs.extend(reached.into_iter().take(50));
                }
            }
        }
        let _ = store.by_label(namespace, "ladder");
    }
    for digest in &refs {
        store.contains(digest);
        if let Ok(Some(bytes)) = store.get(digest) {
            assert_eq!(Digest::of(&bytes), *digest);
            let _ = tree::decode(&bytes);
        }
    }
    let _ = (store.pins(), store.verify(None, 0, &mut |_, _| ()));
    let _ = store.gc(&GcOptions { max_bytes: Some(10_000), dry_run: true, ..GcOptions::default() });
    drop(store);
    let Ok(store) = Store::open(dir) else { return };
    let _ = store.gc(&GcOptions { keep_within_secs: Some(15), now: 20, ..GcOptions::default() });
    let _ = store.gc(&GcOptions { max_bytes: Some(0), now: 1 << 40, ..GcOptions::default() });
    // Whatever was there, something new is kept.
    if let Ok(digest) = store.put(&blob(1 << 40, 100)) {
        assert!(store.get(&digest).is_ok_and(|found| found.is_some()));
    }
}

fn sum(bytes: &[u8]) -> [u8; 8] {
    *blake3(bytes).first_chunk().expect("a hash has 32 bytes")
}

fn blake3(bytes: &[u8]) -> [u8; 32] {
    Digest::of(bytes).hash
}

fn pack_header(hash: &[u8; 32], size: u64) -> Vec<u8> {
    let mut frame = b"TFB1".to_vec();
    frame.extend_from_slice(&size.to_le_bytes());
    frame.extend_from_slice(hash);
    frame.extend_from_slice(&sum(&frame));
    frame
}

fn log_frame(body: &[u8]) -> Vec<u8> {
    let mut frame = b"TFR1".to_vec();
    frame.extend_from_slice(&(body.len() as u32).to_le_bytes());
    frame.extend_from_slice(&blake3(body)[..16]);
    frame.extend_from_slice(body);
    frame
}
