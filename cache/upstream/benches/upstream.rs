//! Push and pull of many small actions through a folder: `cargo bench -p tauflow-upstream -- 300000`.

use std::{
    env, fs,
    time::{Duration, Instant},
};
use tauflow_cache::{Key, Record, Store};
use tauflow_upstream::{Upstream, Wanted, all, pull, push};
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
        };
        a.record(&record).expect("writable");
    }
    let upstream = Upstream::create(&folder.path().join("shared")).expect("writable");
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
    let files: Vec<u64> = fs::read_dir(upstream.dir().join("packs"))
        .expect("readable")
        .map(|entry| entry.and_then(|entry| entry.metadata()).expect("readable").len())
        .collect();
    println!("{} files, {:.1} MB", files.len(), files.iter().sum::<u64>() as f64 / 1e6);
}
