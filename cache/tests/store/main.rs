//! Tests of the store through its public interface, one subject a module.

mod blobs;
mod claims;
mod crash;
mod errors;
mod foreign;
mod full;
mod gc;
mod hostile;
mod records;
mod shared;

use std::{fs, path::Path, path::PathBuf};
use tauflow_cache::{Digest, Key, Record, Store};

/// A store in a folder of its own, which goes with the first value.
fn fresh() -> (tempfile::TempDir, Store) {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let store = open(dir.path());
    (dir, store)
}

fn open(dir: &Path) -> Store {
    Store::open(dir).expect("the store opens")
}

/// A blob of `size` bytes that differs by `n`.
fn blob(n: u64, size: usize) -> Vec<u8> {
    let mut state = n.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let step = |_| {
        state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(0x1405_7b7e_f767_814f);
        (state >> 56) as u8
    };
    (0..size).map(step).collect()
}

fn record(n: u64, payload: &str, refs: Vec<Digest>) -> Record {
    Record {
        namespace: "action".into(),
        key: Key::of(&n.to_le_bytes()),
        label: "ladder".into(),
        preimage: format!("{{\"n\":{n}}}"),
        payload: payload.into(),
        bytes: refs.iter().map(|digest| digest.size).sum(),
        refs,
        trees: Vec::new(),
        recipe: String::new(),
        derived: false,
        transient: false,
        wall_us: 10,
        when: n,
        maker: String::new(),
        fetched: false,
    }
}

/// All files under a folder of the store.
fn files(dir: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(dir).expect("the folder is there") {
        let path = entry.expect("an entry").path();
        if path.is_dir() { found.extend(files(&path)) } else { found.push(path) }
    }
    found.sort();
    found
}

/// Flips a bit of a file, `from_end` bytes before its end.
fn flip(path: &Path, from_end: usize) {
    let mut bytes = fs::read(path).expect("the file is there");
    let at = bytes.len() - from_end;
    bytes[at] ^= 4;
    fs::write(path, bytes).expect("the file is writable");
}

#[test]
fn a_store_can_be_shared() {
    fn shareable<T: Send + Sync + 'static>() {}
    shareable::<Store>();
    shareable::<tauflow_cache::Claim>();
}
