//! Blobs of transient nodes: handed on in memory, and gone when their readers are through.

use std::{
    collections::HashMap,
    fs,
    sync::{Arc, Mutex, PoisonError},
};
use tauflow_cache::Digest;

/// Blobs in memory, up to a number of bytes.
pub struct Pool {
    limit: u64,
    held: Mutex<Held>,
}

#[derive(Default)]
struct Held {
    /// Bytes, and how many outputs hold them.
    blobs: HashMap<Digest, (Arc<Vec<u8>>, u64)>,
    bytes: u64,
}

impl Pool {
    /// An empty one.
    pub fn new(limit: u64) -> Self {
        Self { limit, held: Mutex::default() }
    }

    fn held(&self) -> std::sync::MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a blob in; false if there is no room.
    pub fn put(&self, digest: Digest, bytes: &Arc<Vec<u8>>) -> bool {
        let mut held = self.held();
        if let Some((_, holders)) = held.blobs.get_mut(&digest) {
            *holders += 1;
            return true;
        }
        if held.bytes + digest.size > self.limit {
            return false;
        }
        held.bytes += digest.size;
        held.blobs.insert(digest, (bytes.clone(), 1));
        true
    }

    /// The bytes of a blob that is held.
    pub fn get(&self, digest: &Digest) -> Option<Arc<Vec<u8>>> {
        self.held().blobs.get(digest).map(|(bytes, _)| bytes.clone())
    }

    /// Whether a blob is held.
    pub fn contains(&self, digest: &Digest) -> bool {
        self.held().blobs.contains_key(digest)
    }

    /// Lets a blob go, unless another output holds it.
    pub fn release(&self, digest: &Digest) {
        let mut held = self.held();
        let Some((_, holders)) = held.blobs.get_mut(digest) else { return };
        *holders -= 1;
        if *holders == 0 {
            held.blobs.remove(digest);
            held.bytes -= digest.size;
        }
    }

    /// Bytes that are held.
    pub fn bytes(&self) -> u64 {
        self.held().bytes
    }
}

/// Half of the machine's memory, in bytes: what a run plans with unless it is told.
pub fn default_memory() -> u64 {
    let total = fs::read_to_string("/proc/meminfo").ok().and_then(|text| {
        let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
        line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok()
    });
    total.map_or(4 << 30, |kib| kib * 1024 / 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blob_stays_while_somebody_holds_it_and_what_has_no_room_is_refused() {
        let pool = Pool::new(10);
        let blob = |text: &str| (Digest::of(text.as_bytes()), Arc::new(text.as_bytes().to_vec()));
        let ((a, a_bytes), (b, b_bytes)) = (blob("123456"), blob("12345"));
        assert!(pool.put(a, &a_bytes) && pool.put(a, &a_bytes) && !pool.put(b, &b_bytes));
        pool.release(&a);
        assert!(pool.contains(&a) && pool.get(&a).is_some());
        pool.release(&a);
        assert!(!pool.contains(&a) && pool.put(b, &b_bytes));
        assert_eq!(pool.bytes(), 5);
        pool.release(&a);
        assert!(default_memory() > 1 << 28);
    }
}
