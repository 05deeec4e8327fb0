//! Speed of the store: `cargo bench -p tauflow-cache [-- RECORDS]`.
//!
//! Prints microseconds for each operation; the default is 300,000 records, each
//! with a preimage and a payload of usual size and a small blob of its own.

use std::{path::Path, time::Instant};
use tauflow_cache::{GcOptions, Key, Record, Store};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

fn timed<T>(what: &str, count: u64, work: impl FnOnce() -> Outcome<T>) -> Outcome<T> {
    let start = Instant::now();
    let value = work()?;
    let seconds = start.elapsed().as_secs_f64();
    println!("{what:<40} {:>9.1} ms {:>9.2} us each", seconds * 1e3, seconds * 1e6 / count as f64);
    Ok(value)
}

fn record(n: u64) -> Record {
    Record {
        namespace: "action".into(),
        key: Key::of(&n.to_le_bytes()),
        label: "ladder_rendering".into(),
        preimage: "p".repeat(800),
        payload: "o".repeat(200),
        refs: Vec::new(),
        trees: Vec::new(),
        recipe: String::new(),
        derived: false,
        transient: false,
        wall_us: 1000,
        bytes: 500,
        when: n,
        maker: String::new(),
        fetched: false,
    }
}

fn main() -> Outcome<()> {
    let count = std::env::args().find_map(|arg| arg.parse().ok()).unwrap_or(300_000);
    let dir = tempfile::tempdir()?;
    write(dir.path(), count)?;
    let store = timed("open with index files", count, || Ok(Store::open(dir.path())?))?;
    read(&store, count)?;
    drop(store);
    for folder in ["log", "packs"] {
        for entry in std::fs::read_dir(dir.path().join(folder))? {
            let path = entry?.path();
            if path.extension().is_some_and(|extension| extension == "idx") {
                std::fs::remove_file(path)?;
            }
        }
    }
    let store = timed("open without index files", count, || Ok(Store::open(dir.path())?))?;
    timed("claim and drop", 50_000, || {
        (0..50_000u64).try_for_each(|n| Ok(store.claim(&Key::of(&n.to_le_bytes())).map(drop)?))
    })?;
    timed("verify", count, || Ok(store.verify(None, 0, &mut |_, _| ())?))?;
    let options = GcOptions { keep_within_secs: Some(count / 2), now: count, ..GcOptions::default() };
    let report = timed("gc of half", count, || Ok(store.gc(&options)?))?;
    println!("{report:?}");
    Ok(())
}

fn write(dir: &Path, count: u64) -> Outcome<()> {
    let store = Store::open(dir)?;
    timed("put 500 bytes and record", count, || {
        for n in 0..count {
            let digest = store.put(&n.to_le_bytes().repeat(63))?;
            store.record(&Record { refs: vec![digest], ..record(n) })?;
        }
        Ok(store.flush()?)
    })?;
    timed("put 1 MB", 200, || {
        for n in 0..200u64 {
            store.put(&n.to_le_bytes().repeat(125_000))?;
        }
        Ok(store.flush()?)
    })?;
    timed("drop", count, || {
        drop(store);
        Ok(())
    })
}

fn read(store: &Store, count: u64) -> Outcome<()> {
    timed("lookup_full, first time", count, || {
        for n in 0..count {
            store.lookup_full("action", &record_key(n)).ok_or("a record is missing")?;
        }
        Ok(())
    })?;
    timed("lookup_full, again, and get", count, || {
        for n in 0..count {
            let found = store.lookup_full("action", &record_key(n)).ok_or("a record is missing")?;
            store.get(&found.refs[0])?.ok_or("a blob is missing")?;
        }
        Ok(())
    })?;
    timed("lookup that misses", count, || {
        (count..2 * count).for_each(|n| drop(store.lookup("action", &record_key(n))));
        Ok(())
    })
}

fn record_key(n: u64) -> Key {
    Key::of(&n.to_le_bytes())
}
