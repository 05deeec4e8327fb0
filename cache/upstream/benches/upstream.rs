//! Push, pull and look-ups of many small actions through a folder: `cargo bench -p tauflow-upstream -- 300000`.
//!
//! A URL measures an object store: `cargo bench -p tauflow-upstream --features objects -- 300000 s3://bucket/new`.

use std::{
    env, fs,
    time::{Duration, Instant},
};
use tauflow_cache::{Beyond, Digest, Key, Record, Store};
use tauflow_upstream::{Address, Reader, Traffic, Upstream, Wanted, all, pull, push};
use tempfile::TempDir;

const ACTIONS: u64 = 10_000;
/// Bytes of an action's only output, and of its key's text.
const BLOB: usize = 1000;
const PREIMAGE: usize = 600;

fn timed<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let start = Instant::now();
    let result = work();
    (result, start.elapsed())
}

fn main() {
    let actions = env::args().skip(1).find_map(|word| word.parse().ok()).unwrap_or(ACTIONS);
    let folder = TempDir::new().expect("a temporary folder");
    let open = |name: &str| Store::open(&folder.path().join(name)).expect("writable");
    let (a, b) = (open("a"), open("b"));
    for n in 0..actions {
        let bytes: Vec<u8> = n.to_string().bytes().cycle().take(BLOB).collect();
        let blob = a.put(&bytes).expect("writable");
        let record = Record {
            namespace: "action".into(),
            key: Key::of(&n.to_le_bytes()),
            label: "kind".into(),
            preimage: "k".repeat(PREIMAGE),
            payload: blob.to_string(),
            recipe: String::new(),
            derived: false,
            transient: false,
            refs: vec![blob],
            trees: Vec::new(),
            wall_us: 1,
            bytes: BLOB as u64,
            when: 1,
            maker: String::new(),
            fetched: false,
        };
        a.record(&record).expect("writable");
    }
    let url = env::args().skip(1).find(|word| word.contains("://"));
    let address: Address = url.map_or_else(
        || Address::Folder(folder.path().join("shared")),
        |url| url.parse().expect("a URL of an object store"),
    );
    let kept = folder.path().join("kept");
    let upstream = Upstream::create(&address).expect("writable").keeping(&kept);
    let wanted = Wanted { namespaces: &["action"], sound: &|_| true };
    let send = || push(&a, &upstream, &all(&a, &["action"]), &|_| true, false, &mut |_, _| {}).expect("writable");
    let fetch = || pull(&b, &upstream, wanted, &mut |_, _| {}).expect("writable");
    let (pushed, first) = timed(send);
    let (again, second) = timed(send);
    assert_eq!((pushed.records, again.same), (actions, actions));
    println!("{actions} actions: push {:.2} s, again {:.2} s", first.as_secs_f64(), second.as_secs_f64());
    let (pulled, first) = timed(fetch);
    let (again, second) = timed(fetch);
    assert_eq!((pulled.records, again.same), (actions, actions));
    println!("pull {:.2} s, again {:.2} s", first.as_secs_f64(), second.as_secs_f64());
    if let Some(Traffic { requests, sent, received }) = upstream.traffic() {
        println!("{requests} requests, {:.1} MB sent, {:.1} MB received", sent as f64 / 1e6, received as f64 / 1e6);
    } else {
        let files: Vec<u64> = fs::read_dir(folder.path().join("shared/packs"))
            .expect("readable")
            .map(|entry| entry.and_then(|entry| entry.metadata()).expect("readable").len())
            .collect();
        println!("{} files, {:.1} MB", files.len(), files.iter().sum::<u64>() as f64 / 1e6);
    }
    // A machine with an empty store that looks everything up, and reads every hundredth blob.
    let opening = move || Ok(Upstream::open(&address)?.keeping(&folder.path().join("kept c")));
    let reader = Reader::new(Box::new(opening), &["action"], |_| true, Box::new(|note| println!("{note}")));
    let keys: Vec<Key> = (0..actions).map(|n| Key::of(&n.to_le_bytes())).collect();
    let (found, first) = timed(|| reader.records("action", &keys));
    let looked_up = reader.traffic();
    let some: Vec<Digest> = found.iter().flatten().step_by(100).map(|record| record.refs[0]).collect();
    let (read, second) = timed(|| some.iter().filter(|blob| reader.blob(blob).is_some()).count());
    assert_eq!((found.iter().flatten().count() as u64, read), (actions, some.len()));
    println!("look up all {:.2} s, read {read} blobs {:.2} s", first.as_secs_f64(), second.as_secs_f64());
    for (what, traffic) in [("look-ups", looked_up), ("with blobs", reader.traffic())] {
        let Some(Traffic { requests, received, .. }) = traffic else { continue };
        println!("{what}: {requests} requests, {:.1} MB received", received as f64 / 1e6);
    }
}
