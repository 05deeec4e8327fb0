//! Blobs of transient nodes, kept in memory during the run.

use std::{
    collections::HashMap,
    fs,
    sync::{Arc, Mutex, PoisonError},
};
use tauflow_cache::Digest;

/// Blobs in memory, up to a number of bytes. None goes before the run ends: whoever saw one there can count on it.
pub struct Pool {
    limit: u64,
    held: Mutex<Held>,
}

#[derive(Default)]
struct Held {
    blobs: HashMap<Digest, Arc<Vec<u8>>>,
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
        if held.blobs.contains_key(&digest) {
            return true;
        }
        if held.bytes + digest.size > self.limit || self.limit == 0 {
            return false;
        }
        held.bytes += digest.size;
        held.blobs.insert(digest, bytes.clone());
        true
    }

    /// The bytes of a blob that is held.
    pub fn get(&self, digest: &Digest) -> Option<Arc<Vec<u8>>> {
        self.held().blobs.get(digest).cloned()
    }

    /// Whether a blob is held.
    pub fn contains(&self, digest: &Digest) -> bool {
        self.held().blobs.contains_key(digest)
    }

    /// Bytes that are held.
    pub fn bytes(&self) -> u64 {
        self.held().bytes
    }
}

/// Half of the memory that this process may use, in bytes: what a run plans with unless it is told.
pub fn default_memory() -> u64 {
    let machine = fs::read_to_string("/proc/meminfo").ok().and_then(|text| {
        let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
        line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
    });
    // The limit of a container, in either version of control groups; `max` means no limit.
    let group = ["/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"];
    let group = group.iter().filter_map(|path| fs::read_to_string(path).ok()?.trim().parse::<u64>().ok()).min();
    machine.into_iter().chain(group).min().map_or(4 << 30, |bytes| bytes / 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_room_is_refused() {
        let pool = Pool::new(10);
        let blob = |text: &str| (Digest::of(text.as_bytes()), Arc::new(text.as_bytes().to_vec()));
        let ((a, a_bytes), (b, b_bytes)) = (blob("123456"), blob("12345"));
        assert!(pool.put(a, &a_bytes) && pool.put(a, &a_bytes) && !pool.put(b, &b_bytes));
        assert!(pool.contains(&a) && pool.get(&a).is_some() && !pool.contains(&b));
        assert_eq!(pool.bytes(), 6);
        assert!(default_memory() > 1 << 26);
    }
}
