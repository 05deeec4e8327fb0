//! Stores as somebody would make them who wants the reader to fall.

use super::{blake3, log_frame, pack_header, use_all, with_a_gigabyte};
use crate::{blob, open, record};
use std::{
    fs::{self, File},
    os::unix::fs::FileExt,
    path::Path,
    time::Instant,
};
use tauflow_cache::{Digest, GcOptions, Key, Record, Store, tree};

const OWNER: &str = "17-0123456789abcdef";

fn with_check(mut body: Vec<u8>) -> Vec<u8> {
    let check = blake3(&body);
    body.extend_from_slice(&check);
    body
}

/// An index file of a pack that says that a blob lies at a place.
fn pack_index(entries: &[([u8; 32], u64, u64)], scanned: u64) -> Vec<u8> {
    let mut body = b"tauidx 2".to_vec();
    for value in [scanned, 0, entries.len() as u64] {
        body.extend_from_slice(&value.to_le_bytes());
    }
    body.extend_from_slice(&0_u32.to_le_bytes());
    for (hash, offset, size) in entries {
        body.extend_from_slice(hash);
        body.extend_from_slice(&offset.to_le_bytes());
        body.extend_from_slice(&size.to_le_bytes());
    }
    with_check(body)
}

/// An index file of a log that says that records lie at places, with bodies of some length.
fn log_index(entries: &[(Key, u64, u32)], scanned: u64) -> Vec<u8> {
    let mut body = b"tauidx 2".to_vec();
    for value in [scanned, u64::MAX, entries.len() as u64] {
        body.extend_from_slice(&value.to_le_bytes());
    }
    body.extend_from_slice(&1_u32.to_le_bytes());
    body.extend_from_slice(&6_u32.to_le_bytes());
    body.extend_from_slice(b"action");
    for (key, offset, len) in entries {
        body.extend_from_slice(&key.0);
        for value in [0, 0, u32::MAX, *len] {
            body.extend_from_slice(&value.to_le_bytes());
        }
        for value in [*offset, 0, 0, u64::MAX, u64::MAX, u64::MAX] {
            body.extend_from_slice(&value.to_le_bytes());
        }
    }
    with_check(body)
}

/// A file with bytes at its beginning, as long as asked for and mostly a hole.
fn sparse(path: &Path, bytes: &[u8], len: u64) {
    let file = File::create(path).expect("writable");
    file.write_all_at(bytes, 0).and_then(|()| file.set_len(len)).expect("writable");
}

/// A record of another writer that names these trees.
fn of_trees(store: &Store, n: u64, trees: Vec<Digest>) {
    store.record(&Record { trees, ..record(n, "p", vec![]) }).expect("record");
}

/// Runs in a child with little memory: each store is as somebody would make it who wants the reader to fall.
#[test]
fn child_with_crafted_files() {
    let Ok(case) = std::env::var("TAUFLOW_CACHE_CRAFTED") else { return };
    let place = tempfile::tempdir().expect("a temporary folder");
    let dir = place.path();
    let store = open(dir);
    let small = store.put(&blob(1, 500)).expect("put");
    store.record(&record(1, "p", vec![small])).expect("record");
    let at = |name: &str| dir.join(name);
    let (pack, log) = (at(&format!("packs/0000000009-{OWNER}.pack")), at(&format!("log/0000000009-{OWNER}.log")));
    let mut digests = vec![small];
    let huge = |size: u64| Digest { hash: [7; 32], size };
    match case.as_str() {
        "a blob of an index file is larger than its pack" => {
            let sizes = [1 << 45, u64::MAX, 1 << 62, 4096, (1 << 63) - 1];
            let entry = |(n, size): (usize, &u64)| ([n as u8; 32], [52, u64::MAX - 4, 60][n % 3], *size);
            let entries: Vec<_> = sizes.iter().enumerate().map(entry).collect();
            digests.extend(entries.iter().map(|(hash, _, size)| Digest { hash: *hash, size: *size }));
            fs::write(&pack, vec![0; 4096]).expect("writable");
            for (n, entry) in entries.iter().enumerate() {
                let pack = at(&format!("packs/{:010}-{OWNER}.pack", 20 + n));
                fs::write(&pack, vec![0; 4096]).expect("writable");
                fs::write(pack.with_added_extension("idx"), pack_index(&[*entry], 4096)).expect("writable");
            }
        }
        "a record of an index file is larger than its log" => {
            let keys: Vec<Key> = (0..3_u64).map(|n| Key::of(&n.to_le_bytes())).collect();
            for (n, (offset, len)) in [(0, u32::MAX), (u64::MAX - 9, 9), (0, u32::MAX - 25)].into_iter().enumerate() {
                let log = at(&format!("log/{:010}-{OWNER}.log", 20 + n));
                sparse(&log, &log_frame(b"\x01nothing"), 1 << 20);
                fs::write(log.with_added_extension("idx"), log_index(&[(keys[n], offset, len)], 1 << 20)).expect("ok");
            }
        }
        "files are long holes" => {
            digests.push(huge(1 << 41));
            digests.push(huge(3 << 30));
            sparse(&pack, &pack_header(&[7; 32], 1 << 41), 1 << 42);
            sparse(&at(&format!("packs/0000000010-{OWNER}.pack")), &pack_header(&[7; 32], 3 << 30), 1 << 42);
            let mut head = b"TFR1".to_vec();
            head.extend_from_slice(&(1_u32 << 30).to_le_bytes());
            sparse(&log, &head, 1 << 42);
            sparse(&pack.with_added_extension("idx"), b"tauidx 2", 1 << 42);
            sparse(&log.with_added_extension("idx"), b"tauidx 2", 1 << 42);
            sparse(&at(&format!("leases/{OWNER}.lease")), b"T", 1 << 42);
            sparse(&at("pins/long"), b"", 1 << 42);
            sparse(&at("CACHEDIR.TAG"), b"", 1 << 42);
            let loose = huge(3 << 29);
            digests.push(loose);
            let folder = at("blobs").join(&loose.hex()[..2]);
            fs::create_dir_all(&folder).expect("writable");
            sparse(&folder.join(loose.to_string()), b"", loose.size);
        }
        "names say the largest numbers" => {
            let folder = at("blobs/07");
            fs::create_dir_all(&folder).expect("writable");
            for n in 0..3 {
                let digest = huge(u64::MAX - n);
                fs::write(folder.join(digest.to_string()), "x").expect("writable");
                digests.push(digest);
                store.record(&record(50 + n, "p", vec![digest])).expect("record");
            }
            for seq in [u64::MAX, u64::MAX - 1] {
                fs::write(at(&format!("packs/{seq}-{OWNER}.pack")), pack_header(&[7; 32], 0)).expect("writable");
                fs::write(at(&format!("log/{seq}-{OWNER}.log")), log_frame(b"\x01nothing")).expect("writable");
            }
            fs::write(at(&format!("quarantine/0000000009-{OWNER}.pack@{}", u64::MAX)), "").expect("writable");
        }
        "trees hang on a long chain" => {
            let mut top = store.put(&tree::encode(&[small], &[], b"")).expect("put");
            for _ in 0..50_000 {
                top = store.put(&tree::encode(&[], &[top], b"")).expect("put");
            }
            of_trees(&store, 60, vec![top]);
        }
        "each tree lists the one below it twice" => {
            let mut top = store.put(&tree::encode(&[small], &[], b"")).expect("put");
            for _ in 0..64 {
                top = store.put(&tree::encode(&[small, small], &[top, top], b"")).expect("put");
            }
            of_trees(&store, 60, vec![top, top]);
        }
        "many records each reach all there is" => {
            let blobs: Vec<Digest> = (0..60_000_u64).map(|n| store.put(&n.to_le_bytes()).expect("put")).collect();
            let all = store.put(&tree::encode(&blobs, &[], b"")).expect("put");
            for n in 0..2400_u64 {
                let top = store.put(&tree::encode(&[], &[all], &n.to_le_bytes())).expect("put");
                of_trees(&store, 100 + n, vec![top]);
            }
            drop(store);
            let error = open(dir).gc(&GcOptions { now: 1, ..GcOptions::default() }).expect_err("too much");
            assert!(error.is_environment() && error.to_string().contains("refer to more than"), "{error}");
            return;
        }
        "lists say that they are longer than they are" => {
            let mut head = Vec::new();
            for _ in 0..2 {
                head.extend_from_slice(&6_u32.to_le_bytes());
                head.extend_from_slice(b"action");
            }
            head.extend_from_slice(&Key::of(b"crafted").0);
            head.extend_from_slice(&[0; 44]);
            let mut bytes = Vec::new();
            for count in [u32::MAX, 1 << 31, 100_000_000, 2] {
                bytes.extend(log_frame(&[&[1], &head[..], &count.to_le_bytes(), &[0; 60]].concat()));
            }
            fs::write(&log, bytes).expect("writable");
            let mut tree = b"tautree1".to_vec();
            tree.extend_from_slice(&u32::MAX.to_le_bytes());
            let top = store.put(&tree).expect("put");
            of_trees(&store, 60, vec![top]);
        }
        "hashes begin alike" => {
            let hash = |n: u64| {
                let mut hash = [7; 32];
                hash[8..16].copy_from_slice(&n.to_le_bytes());
                hash
            };
            fs::write(&pack, (0..30_000).flat_map(|n| pack_header(&hash(n), 0)).collect::<Vec<u8>>()).expect("ok");
            let key = |n: u64| Key(hash(n));
            let bytes = (0..3_000).flat_map(|n| log_frame(&crafted_record(&key(n), 0, &format!("label {n}"))));
            fs::write(&log, bytes.collect::<Vec<u8>>()).expect("writable");
        }
        "a frame begins at every eighth byte" => {
            // Each says that it reaches to the middle of the log, and is damaged.
            let mut head = b"TFR1".to_vec();
            head.extend_from_slice(&3_000_000_u32.to_le_bytes());
            fs::write(&log, head.repeat(750_000)).expect("writable");
            fs::write(&pack, b"TFB1".repeat(1_500_000)).expect("writable");
        }
        "a byte lies between any two frames" => {
            let frame = [&b"T"[..], &pack_header(&[7; 32], 0)].concat();
            fs::write(&pack, frame.repeat(115_000)).expect("writable");
            let frame = [&b"T"[..], &log_frame(&crafted_record(&Key([7; 32]), 0, "ladder"))].concat();
            fs::write(&log, frame.repeat(40_000)).expect("writable");
        }
        "damaged frames reach over good ones" => {
            let mut bytes = Vec::new();
            let good = log_frame(&crafted_record(&Key([7; 32]), 0, "ladder"));
            for _ in 0..30_000 {
                bytes.extend_from_slice(b"TFR1");
                bytes.extend_from_slice(&2_000_000_u32.to_le_bytes());
                bytes.extend_from_slice(&[0; 16]);
                bytes.extend_from_slice(&good);
            }
            fs::write(&log, bytes).expect("writable");
        }
        other => panic!("no case of this name: {other}"),
    }
    drop(store);
    use_all(dir, &digests);
}

#[test]
fn crafted_files_neither_panic_nor_take_memory() {
    let cases = [
        "a blob of an index file is larger than its pack",
        "a record of an index file is larger than its log",
        "files are long holes",
        "names say the largest numbers",
        "trees hang on a long chain",
        "each tree lists the one below it twice",
        "many records each reach all there is",
        "lists say that they are longer than they are",
    ];
    let few = [
        "hashes begin alike",
        "a frame begins at every eighth byte",
        "a byte lies between any two frames",
        "damaged frames reach over good ones",
    ];
    for case in cases.into_iter().chain(few) {
        let start = Instant::now();
        with_a_gigabyte("hostile::crafted::child_with_crafted_files", "TAUFLOW_CACHE_CRAFTED", case);
        let took = start.elapsed().as_secs_f64();
        println!("{case}: {took:.1} s");
        // Six megabytes that were read in squares of their length took minutes; they take a second or two.
        assert!(took < 60.0 || !few.contains(&case), "{case}: {took:.1} s");
    }
}

/// The body of a record's frame.
fn crafted_record(key: &Key, generation: u32, label: &str) -> Vec<u8> {
    let mut body = vec![1];
    for text in ["action", label] {
        body.extend_from_slice(&(text.len() as u32).to_le_bytes());
        body.extend_from_slice(text.as_bytes());
    }
    body.extend_from_slice(&key.0);
    body.extend_from_slice(&generation.to_le_bytes());
    // Origin, sum, costs and time; then no blobs, no trees, no flags and no texts.
    body.extend_from_slice(&[0; 40 + 8 + 1 + 12]);
    body
}

#[test]
fn a_record_of_the_highest_generation_is_superseded() {
    for generation in [u32::MAX, (1 << 31) + 1, 1 << 31] {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let made = record(5, "made again", vec![]);
        drop(open(dir.path()));
        let body = crafted_record(&made.key, generation, "ladder");
        fs::write(dir.path().join(format!("log/0000000009-{OWNER}.log")), log_frame(&body)).expect("writable");
        let store = open(dir.path());
        assert_eq!(store.lookup("action", &made.key).is_some(), generation == 1 << 31, "{generation}");
        // As an action does whose blobs are gone.
        store.replace(&made).expect("replace");
        let payload = |store: &Store| store.lookup("action", &made.key).map(|found| found.payload.clone());
        assert_eq!(payload(&store).as_deref(), Some("made again"), "{generation}");
        drop(store);
        assert_eq!(payload(&open(dir.path())).as_deref(), Some("made again"), "{generation}");
        let other = Record { payload: "and again".into(), ..made.clone() };
        open(dir.path()).replace(&other).expect("replace");
        assert_eq!(payload(&open(dir.path())).as_deref(), Some("and again"), "{generation}");
    }
}
