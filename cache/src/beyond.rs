//! A second place that a store asks for missing records and blobs, such as a cache that several machines share.
//!
//! The store records its records at once, and stores its blobs when they are read. It hashes all blobs again.

use crate::{CacheError, Digest, Key, Record, Recorded, Store};
use std::{fmt::Debug, sync::Arc};

/// A place beyond a store that may have what the store lacks. Its own failures are its own to tell: here they are
/// misses.
pub trait Beyond: Debug + Send + Sync {
    /// The records of these keys, each if it is there.
    fn records(&self, namespace: &str, keys: &[Key]) -> Vec<Option<Record>>;

    /// Whether a blob is said to be there, without reading it.
    fn contains(&self, digest: &Digest) -> bool;

    /// The keys of all records of a namespace.
    fn keys(&self, namespace: &str) -> Vec<Key> {
        let _ = namespace;
        Vec::new()
    }

    /// A blob, if it is there.
    fn blob(&self, digest: &Digest) -> Option<Vec<u8>>;

    /// Whether what others add there may be seen late.
    fn lists_late(&self) -> bool {
        false
    }

    /// Looks for what others have added since.
    fn look_again(&self) {}
}

impl Store {
    /// Has this store ask there for what it lacks: look-ups, reads of blobs, and questions whether a blob is there.
    pub fn look_beyond(&mut self, beyond: Arc<dyn Beyond>) {
        self.beyond = Some(beyond);
    }

    /// Whether what others add beyond may be seen late.
    pub fn beyond_lists_late(&self) -> bool {
        self.beyond.as_ref().is_some_and(|beyond| beyond.lists_late())
    }

    /// Sees what others have added beyond.
    pub fn refresh_beyond(&self) {
        if let Some(beyond) = &self.beyond {
            beyond.look_again();
        }
    }

    /// The keys of a namespace's records here and there, sorted.
    pub fn keys_with_beyond(&self, namespace: &str) -> Vec<Key> {
        let mut keys = self.keys_like(namespace, "");
        keys.extend(self.beyond.iter().flat_map(|beyond| beyond.keys(namespace)));
        keys.sort_unstable();
        keys.dedup();
        keys
    }

    /// Fills the gaps of a look-up of these keys.
    pub(crate) fn records_beyond(&self, namespace: &str, keys: &[Key], found: &mut [Option<Arc<Record>>]) {
        let Some(beyond) = &self.beyond else { return };
        let (places, lacking): (Vec<usize>, Vec<Key>) = keys
            .iter()
            .enumerate()
            .filter(|(place, _)| found[*place].is_none())
            .map(|(place, key)| (place, *key))
            .unzip();
        if lacking.is_empty() {
            return;
        }
        for ((place, key), record) in places.into_iter().zip(&lacking).zip(beyond.records(namespace, &lacking)) {
            found[place] =
                record.filter(|record| record.key == *key && record.namespace == namespace).map(|r| self.copied(r));
        }
    }

    /// Records what came from beyond. The blobs stay there until they are read, so they are not lost if they are not
    /// here. A store that cannot be written passes the record on.
    fn copied(&self, record: Record) -> Arc<Record> {
        let record = Record { transient: true, fetched: true, ..record };
        match self.record(&record) {
            Ok(Recorded::Conflict { existing }) => Arc::from(existing),
            // Whoever has to write next meets the same error.
            Ok(Recorded::New | Recorded::Same) | Err(_) => Arc::new(record),
        }
    }

    /// Whether a blob is said to be beyond.
    pub(crate) fn is_beyond(&self, digest: &Digest) -> bool {
        self.beyond.as_ref().is_some_and(|beyond| beyond.contains(digest))
    }

    /// Brings a blob here from beyond. A store that cannot be written passes it on.
    pub(crate) fn blob_beyond(&self, digest: &Digest) -> Result<Option<Vec<u8>>, CacheError> {
        let Some(beyond) = &self.beyond else { return Ok(None) };
        let Some(bytes) = beyond.blob(digest) else { return Ok(None) };
        if Digest::of(&bytes) != *digest {
            return Ok(None);
        }
        if self.writes().is_ok() {
            self.put(&bytes)?;
        }
        Ok(Some(bytes))
    }
}
