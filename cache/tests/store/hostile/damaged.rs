//! Files of a store, damaged at random.

use super::{blake3, sum, use_all, with_a_gigabyte};
use crate::{blob, files, flip, open, record};
use std::{
    fs::{self, File},
    path::{Path, PathBuf},
    time::{Duration, Instant},
};
use tauflow_cache::{Digest, Record, tree};

/// A store with files of all sorts: packs and logs with index files and without, leases, pins, trees, marks of damage.
fn sample(dir: &Path) -> Vec<Digest> {
    let mut digests = Vec::new();
    let store = open(dir);
    store.set_time(5).expect("writable");
    for n in 0..300 {
        let digest = store.put(&blob(n, 500)).expect("put");
        store.record(&Record { preimage: "x".repeat(400), ..record(n, "p", vec![digest]) }).expect("record");
        digests.push(digest);
    }
    digests.push(store.put(&blob(1, 70_000)).expect("put"));
    let low = store.put(&tree::encode(&digests[..20], &[], b"low")).expect("put");
    let top = store.put(&tree::encode(&digests[20..30], &[low], b"top")).expect("put");
    let made = Record { namespace: "rollup".into(), trees: vec![top], derived: true, ..record(900, "p", vec![]) };
    store.record(&made).expect("record");
    store.pin("kept", &top).expect("pin");
    digests.extend([low, top]);
    drop(store);
    let store = open(dir);
    store.set_time(9).expect("writable");
    for n in 290..320 {
        store.lookup("action", &record(n, "", vec![]).key);
        let digest = store.put(&blob(n, 600)).expect("put");
        store.record(&record(n, "p", vec![digest])).expect("record");
        digests.push(digest);
    }
    drop(store);
    flip(files(&dir.join("packs")).last().expect("a pack"), 30);
    open(dir).verify(None, 0, &mut |_, _| ()).expect("verify");
    digests
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("writable");
    for entry in fs::read_dir(from).expect("readable") {
        let path = entry.expect("readable").path();
        let target = to.join(path.file_name().expect("a name"));
        if path.is_dir() { copy(&path, &target) } else { assert!(fs::copy(&path, target).is_ok()) }
    }
}

struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }
}

/// Makes the checksums of a file right again, so that what was changed is not just refused.
fn mend(path: &Path, bytes: &mut [u8]) {
    let ends = |extension: &str| path.extension().is_some_and(|e| e == extension);
    if ends("idx") && bytes.len() >= 32 {
        let body = bytes.len() - 32;
        let check = blake3(&bytes[..body]);
        bytes[body..].copy_from_slice(&check);
        return;
    }
    let mut at = 0;
    while at + 52 <= bytes.len() {
        let size = if ends("pack") {
            let check = sum(&bytes[at..at + 44]);
            bytes[at + 44..at + 52].copy_from_slice(&check);
            let size = u64::from_le_bytes(*bytes[at + 4..].first_chunk().expect("8 bytes"));
            size.saturating_add(52)
        } else if ends("log") {
            let size = u64::from(u32::from_le_bytes(*bytes[at + 4..].first_chunk().expect("4 bytes")));
            let body = bytes.get(at + 24..at.saturating_add(24).saturating_add(size as usize)).map(blake3);
            if let Some(check) = body {
                bytes[at + 8..at + 24].copy_from_slice(&check[..16]);
            }
            size + 24
        } else {
            return;
        };
        at = usize::try_from(size).ok().and_then(|size| at.checked_add(size)).unwrap_or(usize::MAX / 2);
    }
}

fn damage(random: &mut Random, path: &Path) {
    if fs::metadata(path).expect("it is there").len() > 1 << 20 {
        return; // it is a hole by now
    }
    let mut bytes = fs::read(path).expect("readable");
    let at = random.below(bytes.len());
    match random.below(7) {
        0 => bytes.truncate(at),
        1 if !bytes.is_empty() => bytes[at] ^= 1 << random.below(8),
        2 => bytes.iter_mut().skip(at).take(40).for_each(|byte| *byte = 0),
        3 => {
            // A number that may be a size, a count or a place.
            let near = bytes.len() as u64;
            let numbers = [0, 1, u64::MAX, u64::MAX / 2, 1 << 31, (1 << 32) - 1, near, near + 1, 1 << 45, near / 3];
            let number = numbers[random.below(numbers.len())].to_le_bytes();
            let width = [4, 8][random.below(2)];
            bytes.iter_mut().skip(at).zip(&number[..width]).for_each(|(byte, new)| *byte = *new);
        }
        4 => {
            let piece = bytes[at..].iter().copied().take(1 + random.below(300)).collect::<Vec<_>>();
            let to = random.below(bytes.len());
            bytes.splice(to..to, piece);
        }
        5 => {
            fs::write(path, &bytes).expect("writable");
            File::options()
                .write(true)
                .open(path)
                .and_then(|f| f.set_len(1 << [20, 24, 33, 41][random.below(4)]))
                .expect("sparse");
            return;
        }
        _ => bytes.iter_mut().skip(at).take(16).for_each(|byte| *byte = random.next() as u8),
    }
    if random.below(3) > 0 {
        mend(path, &mut bytes);
    }
    fs::write(path, bytes).expect("writable");
}

/// Runs in a child with little memory.
#[test]
fn child_with_damaged_files() {
    let Ok(seconds) = std::env::var("TAUFLOW_CACHE_FUZZ") else { return };
    let time = Duration::from_secs_f64(seconds.parse().expect("a number of seconds"));
    let place = tempfile::tempdir().expect("a temporary folder");
    let (base, dir) = (place.path().join("base"), place.path().join("dir"));
    let digests = sample(&base);
    assert!(files(&base).iter().any(|path| path.extension().is_some_and(|e| e == "idx")));
    let start = Instant::now();
    let (mut rounds, mut random) = (0_u64, Random(0x5eed));
    while rounds < 10 || start.elapsed() < time {
        copy(&base, &dir);
        let all: Vec<PathBuf> = files(&dir).into_iter().filter(|path| !path.ends_with("FORMAT")).collect();
        for _ in 0..1 + random.below(4) {
            let path = &all[random.below(all.len())];
            damage(&mut random, path);
        }
        use_all(&dir, &digests);
        fs::remove_dir_all(&dir).expect("it is ours");
        rounds += 1;
    }
    println!("{rounds} stores with damaged files");
}

#[test]
fn damaged_files_neither_panic_nor_lie_nor_take_memory() {
    let slow = tauflow_testing::slow();
    let seconds = std::env::var("TAUFLOW_FUZZ_SECONDS").unwrap_or_else(|_| if slow { "30" } else { "3" }.into());
    with_a_gigabyte("hostile::damaged::child_with_damaged_files", "TAUFLOW_CACHE_FUZZ", &seconds);
}
