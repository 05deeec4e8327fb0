//! A store that somebody else wrote: records, listings and blobs that are sound as the store sees them, and say what
//! nobody would. They may be refused, or be misses; no run and no export on them may panic, write outside its folders,
//! or take much memory.
//!
//! A few seconds of it are a test, thirty with `TAUFLOW_SLOW=1`; `TAUFLOW_FUZZ_SECONDS=600 cargo test --release --test
//! hostile` goes on for longer, `TAUFLOW_FUZZ_SEED` begins elsewhere. What is mangled in the store's own files is
//! tested with the store.

mod crafted;
#[path = "../support/kinds.rs"]
mod kinds;
#[path = "../support/media.rs"]
mod media;

use std::{
    alloc::{GlobalAlloc, Layout, System},
    fs,
    path::Path,
    sync::{
        Mutex,
        atomic::{AtomicBool, AtomicIsize, Ordering::Relaxed},
    },
    time::{Duration, Instant},
};
use tauflow::{
    engine::{self, RunOptions},
    ids::PortId,
    pipeline::{self, Options, Pipeline},
};
use tauflow_cache::{Digest, Record, Store, tree};
use tauflow_contract::{Artifact, Blobs, Context, KindError, MemoKey, Silent};
use tauflow_data::{
    Image, TensorFile,
    folder::{self, DiskFolder},
    mesh::Mesh,
    records::PackedScene,
};

/// Counts what is allocated by all threads, and remembers the most there was.
struct Counting;

static NOW: AtomicIsize = AtomicIsize::new(0);
static MOST: AtomicIsize = AtomicIsize::new(0);

#[expect(unsafe_code, reason = "passes on to the system's allocator, and counts")]
// SAFETY: every call goes on to the system's allocator as it is.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let now = NOW.fetch_add(layout.size() as isize, Relaxed) + layout.size() as isize;
        MOST.fetch_max(now, Relaxed);
        // SAFETY: the caller keeps the same promises that the system's allocator asks for.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        NOW.fetch_sub(layout.size() as isize, Relaxed);
        // SAFETY: `at` came from the system's allocator with this layout.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Most that one of these stores may make a run hold.
const MOST_BYTES: isize = 1 << 30;

/// Panics, whichever thread they were on: the engine catches those of kinds.
static PANICS: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// Items, filters, memoised sub-actions, gathers, and a page that is published.
const TEXT: &str = "
pipeline: hostile
nodes:
  numbers: {kind: numbers, params: {count: 12}}
  long: {kind: affine, inputs: {in: numbers}, params: {mul: 2, pad: 400}}
  gate: {kind: below, inputs: {in: long}, params: {limit: 100}}
  rounded: {kind: round, inputs: {in: gate}}
  total: {kind: total, inputs: {in: [rounded, gate.others]}}
";
const NAMESPACES: [&str; 5] = ["action", "rollup", "shard", "pipeline", "memo"];
/// A file that nothing may write.
const OUTSIDE: &str = "tauflow-hostile-escape";

struct Random(u64);

impl Random {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 ^ (self.0 >> 33)) >> 8) as usize % limit.max(1)
    }

    fn pick<'a, T>(&mut self, of: &'a [T]) -> Option<&'a T> {
        of.get(self.below(of.len()))
    }
}

/// Values that mean something to JSON, to paths, or to whoever takes memory by a number.
const VALUES: [&str; 22] = [
    "0",
    "1",
    "-1",
    "255",
    "256",
    "4294967296",
    "9223372036854775807",
    "18446744073709551615",
    "1e999",
    "null",
    "true",
    "[]",
    "{}",
    "\"\"",
    "\"../../tauflow-hostile-escape\"",
    "\"/tmp/tauflow-hostile-escape\"",
    "\"a/../../../tauflow-hostile-escape\"",
    "\"a//b\"",
    "\"toy/number\"",
    "\"tauflow/scene\"",
    "[[[[[[[[[[",
    "\"\\u0000\"",
];

/// Some values of a text in JSON, or names in it, become others.
fn mangle(text: &str, random: &mut Random) -> String {
    let mut bytes = text.as_bytes().to_vec();
    for _ in 0..1 + random.below(3) {
        let starts: Vec<usize> =
            (1..bytes.len()).filter(|at| matches!(bytes[at - 1], b':' | b'[' | b',' | b'{')).collect();
        let Some(at) = random.pick(&starts).copied() else { break };
        let end = bytes[at..].iter().position(|b| matches!(b, b',' | b'}' | b']' | b':')).unwrap_or(0) + at;
        let value = match random.below(4) {
            0 => bytes[at..end].repeat(2),
            1 => Vec::new(),
            _ => random.pick(&VALUES).map_or(Vec::new(), |value| value.as_bytes().to_vec()),
        };
        bytes.splice(at..end, value);
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

fn digest(random: &mut Random) -> Digest {
    let sizes = [0, 1, 70_000, 1 << 32, 1 << 62, u64::MAX];
    Digest { hash: [random.below(256) as u8; 32], size: sizes[random.below(sizes.len())] }
}

/// A listing that says something else, in the store.
fn other_listing(store: &Store, listing: &Digest, random: &mut Random) -> Option<Digest> {
    let bytes = store.get(listing).expect("readable")?;
    let mut listed = tree::decode(&bytes)?;
    let body = String::from_utf8_lossy(listed.body).into_owned();
    let body = if random.below(3) > 0 { mangle(&body, random) } else { body };
    let lists = if random.below(2) == 0 { &mut listed.refs } else { &mut listed.trees };
    match random.below(5) {
        0 => lists.truncate(lists.len().saturating_sub(1)),
        1 => lists.push(digest(random)),
        2 => lists.reverse(),
        3 => lists.extend(lists.clone()),
        _ => {}
    }
    Some(store.put(&tree::encode(&listed.refs, &listed.trees, body.as_bytes())).expect("room"))
}

/// Puts a record in place of another one that says something else.
fn spoil(store: &Store, random: &mut Random) {
    let namespace = NAMESPACES[random.below(NAMESPACES.len())];
    let keys = store.keys_like(namespace, "");
    let Some(found) = random.pick(&keys).and_then(|key| store.lookup(namespace, key)) else { return };
    let mut record = Record::clone(&found);
    match random.below(6) {
        0 => (record.wall_us, record.bytes, record.when) = (u64::MAX, u64::MAX, u64::MAX),
        1 => record.refs.push(digest(random)),
        2 => record.trees.push(digest(random)),
        3 => record.payload = mangle(&record.payload, random),
        _ => match random.pick(&record.trees.clone()) {
            Some(listing) => {
                let Some(other) = other_listing(store, listing, random) else { return };
                record.payload = record.payload.replace(&listing.to_string(), &other.to_string());
                record.trees.iter_mut().filter(|tree| *tree == listing).for_each(|tree| *tree = other);
            }
            None => record.payload = mangle(&record.payload, random),
        },
    }
    store.replace(&record).expect("room");
}

/// The store, as an export reads it.
struct Reading<'a>(&'a Store);

impl Blobs for Reading<'_> {
    fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, KindError> {
        self.0.get(digest).map_err(|e| KindError::Environment(e.to_string()))
    }

    fn put(&self, _: &[u8]) -> Result<Digest, KindError> {
        Err(KindError::Internal("read only".into()))
    }

    fn memo_get(&self, _: &MemoKey) -> Option<Artifact> {
        None
    }

    fn memo_put(&self, _: &MemoKey, _: &Artifact) -> Result<(), KindError> {
        Err(KindError::Internal("read only".into()))
    }
}

/// Copies a folder of files.
fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("writable");
    for entry in fs::read_dir(from).expect("readable") {
        let entry = entry.expect("readable");
        let (path, to) = (entry.path(), to.join(entry.file_name()));
        if path.is_dir() {
            copy(&path, &to);
        } else {
            fs::copy(&path, &to).expect("writable");
        }
    }
}

fn run(pipeline: &Pipeline, store: &Store, out: &Path) -> bool {
    let options = RunOptions { jobs: 2, many: 4, out: Some(out.to_owned()), ..RunOptions::default() };
    let ran = engine::run(pipeline, store, &options, &AtomicBool::new(false), &|_| {});
    ran.is_ok_and(|summary| summary.failures.is_empty())
}

/// Exports what every node gave, as far as it can be had.
fn export(pipeline: &Pipeline, store: &Store, to: &Path) -> u64 {
    let (reading, stop) = (Reading(store), AtomicBool::new(false));
    let ctx = Context::new(&reading, &Silent, &stop);
    let out = DiskFolder::new(to);
    let mut count = 0;
    for node in 0..pipeline.nodes.len() {
        let Ok(found) = engine::outputs(pipeline, store, node, PortId::DEFAULT) else { continue };
        for (key, artifact) in found.iter() {
            count += 1;
            // Of the media that files can be made of; toys are none of them, unless a record says so.
            let _ = folder::export_item(&ctx, key, artifact, &out);
        }
    }
    count
}

/// How long to go on.
fn seconds() -> f64 {
    let set = std::env::var("TAUFLOW_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok());
    let slow = tauflow_testing::slow();
    set.unwrap_or(if slow { 30.0 } else { 3.0 })
}

fn seed() -> u64 {
    std::env::var("TAUFLOW_FUZZ_SEED").ok().and_then(|text| text.parse().ok()).unwrap_or(1)
}

/// Does something with what is mangled: no panic, no much memory.
fn harmless<T>(what: &str, work: impl FnOnce() -> T) -> T {
    within(MOST_BYTES, what, work)
}

/// The same, with a limit of its own.
fn within<T>(most: isize, what: &str, work: impl FnOnce() -> T) -> T {
    let before = NOW.load(Relaxed);
    MOST.store(before, Relaxed);
    let done = work();
    let held = MOST.load(Relaxed) - before;
    assert!(held < most, "{what}: it took {held} bytes");
    let panics = PANICS.lock().map(|panics| panics.clone()).unwrap_or_default();
    assert!(panics.is_empty(), "{what}: {panics:?}");
    done
}

/// One test, as memory and panics are counted for the whole process.
#[test]
fn stores_and_blobs_from_elsewhere_are_data() {
    let told = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        if let Ok(mut panics) = PANICS.lock() {
            panics.push(info.to_string());
        }
        told(info);
    }));
    crafted::a_pack_of_alike_hashes_opens_at_once();
    crafted::rows_without_end_take_little();
    crafted::long_keys_take_little();
    crafted::an_action_is_the_one_that_was_asked_for();
    crafted::outputs_are_what_their_ports_hold();
    stores(Duration::from_secs_f64(seconds() * 0.7));
    blobs(Duration::from_secs_f64(seconds() * 0.3));
}

fn stores(time: Duration) {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let pipeline = pipeline::resolve_text("hostile.yaml", TEXT, &kinds::registry(), &Options::default());
    let pipeline = pipeline.unwrap_or_else(|problems| panic!("{problems}"));
    let sound = dir.path().join("sound");
    assert!(run(&pipeline, &Store::open(&sound).expect("a store"), &dir.path().join("out")));
    let mut random = Random(seed());
    let (begun, mut rounds, mut failed, mut exported) = (Instant::now(), 0, 0, 0);
    while rounds < 4 || begun.elapsed() < time {
        let place = dir.path().join("place");
        let cache = place.join("deep/down/cache");
        copy(&sound, &cache);
        let store = Store::open(&cache).expect("a store");
        for _ in 0..1 + random.below(6) {
            spoil(&store, &mut random);
        }
        // Looked at as others would: in a process of its own.
        drop(store);
        let round = format!("round {rounds} of seed {}", seed());
        harmless(&round, || {
            let store = Store::open(&cache).expect("a store");
            exported += export(&pipeline, &store, &place.join("deep/down/export"));
            failed += u64::from(!run(&pipeline, &store, &place.join("deep/down/out")));
            exported += export(&pipeline, &store, &place.join("deep/down/export"));
        });
        for (folder, names) in
            [("", vec!["deep"]), ("deep", vec!["down"]), ("deep/down", vec!["cache", "export", "out"])]
        {
            for entry in fs::read_dir(place.join(folder)).expect("readable") {
                let name = entry.expect("readable").file_name().to_string_lossy().into_owned();
                assert!(names.contains(&name.as_str()), "{round}: it wrote `{folder}/{name}`");
            }
        }
        assert!(!Path::new("/tmp").join(OUTSIDE).exists(), "{round}");
        fs::remove_dir_all(&place).expect("writable");
        rounds += 1;
    }
    println!("{rounds} stores; {failed} runs failed, {exported} items were there to export");
    assert!(exported > 0 && failed < rounds, "most stores are sound but for a record or two");
}

/// Bytes that are nearly right.
fn mangled(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let header = bytes.first_chunk().map_or(0, |length| u64::from_le_bytes(*length) as usize);
    if random.below(2) == 0 && bytes.len() > 8 + header {
        // The header stays readable, and says something else.
        let text = mangle(&String::from_utf8_lossy(&bytes[8..8 + header]), random);
        let mut other = (text.len() as u64).to_le_bytes().to_vec();
        other.extend(text.as_bytes());
        other.extend(&bytes[8 + header..]);
        return other;
    }
    for _ in 0..1 + random.below(4) {
        // Half of the places are in the head, where lengths and names stand.
        let most = if random.below(2) == 0 { 300 } else { usize::MAX };
        let at = random.below(bytes.len().min(most));
        match random.below(4) {
            0 => bytes.truncate(at),
            1 if at + 8 <= bytes.len() => {
                let word = [0, 1, 1 << 24, 1 << 32, u64::MAX][random.below(5)];
                bytes[at..at + 8].copy_from_slice(&u64::to_le_bytes(word));
            }
            _ if at < bytes.len() => bytes[at] = random.below(256) as u8,
            _ => {}
        }
    }
    bytes
}

fn blobs(time: Duration) {
    let image = |channels: usize| Image::new(8, 4, channels);
    let packed = PackedScene {
        counts: vec![1, 2],
        states: vec![image(3), image(3)],
        gbuffer: Some(image(6)),
        sampler: Default::default(),
    };
    let note = r#"{"version":1,"preset":"tiny","parameterization":"direct"}"#;
    let model = TensorFile::default().with("a", &[2, 2], vec![0.0; 4]).note("model", note);
    let seeds = [packed.to_bytes(), Ok(image(3).to_bytes()), model.to_bytes()].map(|bytes| bytes.expect("consistent"));
    let mut random = Random(seed());
    let begun = Instant::now();
    let (mut rounds, mut read) = (0, 0);
    while rounds < 100 || begun.elapsed() < time {
        let bytes = mangled(&seeds[random.below(seeds.len())], &mut random);
        harmless(&format!("blob {rounds} of seed {}", seed()), || {
            if let Ok(packed) = PackedScene::from_bytes(&bytes) {
                read += 1;
                // What was read is consistent: it can be written.
                packed.to_bytes().expect("consistent");
            }
            if let Ok(image) = Image::from_bytes(&bytes) {
                read += 1;
                let last = image.pixel(image.width() - 1, image.height() - 1);
                assert_eq!(last.len(), image.channels());
            }
            let _ = (TensorFile::from_bytes(&bytes), Mesh::from_bytes(&bytes), tauflow_train::Model::load(&bytes));
        });
        rounds += 1;
    }
    println!("{rounds} blobs; {read} were read");
    assert!(read > 0, "some are near what is right");
}
