//! What this process can read: the store, the blobs that it holds in memory beside it, and which blobs are known to be
//! missing from both.

use super::{
    execute::Producer,
    records::{self, Made},
    transient::Pool,
};
use std::collections::HashSet;
use tauflow_cache::{CacheError, Digest, Record, Store};

/// See the module.
#[derive(Clone, Copy)]
pub struct Holdings<'a> {
    /// The store.
    pub store: &'a Store,
    /// Blobs that are in memory only, in a process that passes any on.
    pub pool: Option<&'a Pool>,
    /// Blobs that were found missing: a record that names one counts only when it is there again.
    pub wanted: &'a HashSet<Digest>,
}

impl<'a> Holdings<'a> {
    /// A store, and nothing in memory.
    pub fn stored(store: &'a Store, wanted: &'a HashSet<Digest>) -> Self {
        Self { store, pool: None, wanted }
    }

    /// Whether a blob is there, stored or in memory.
    pub fn is_here(&self, digest: &Digest) -> bool {
        self.is_in_memory(digest) || self.store.contains(digest)
    }

    fn is_in_memory(&self, digest: &Digest) -> bool {
        self.pool.is_some_and(|pool| pool.contains(digest))
    }

    /// Whether a blob is there and sound.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn is_sound(&self, digest: &Digest) -> Result<bool, CacheError> {
        Ok(self.is_in_memory(digest) || self.store.get(digest)?.is_some())
    }

    /// Whether none of the blobs that a reader missed is still missing here.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn intact(&self, record: &Record) -> Result<bool, CacheError> {
        if self.wanted.is_empty() {
            return Ok(true);
        }
        let reached = self.store.reach(&record.refs, &record.trees)?;
        Ok(reached.iter().all(|digest| !self.wanted.contains(digest) || self.is_here(digest)))
    }

    /// The outputs of an action by its record; none if there is no record, or the record cannot be used.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn made(&self, record: Option<&Record>, producer: &Producer) -> Result<Option<Made>, CacheError> {
        Ok(self.made_many(&[record], producer)?.remove(0)) // one for each record
    }

    /// As [`made`](Self::made), of several actions of one group together.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn made_many(&self, records: &[Option<&Record>], producer: &Producer) -> Result<Vec<Option<Made>>, CacheError> {
        let mut whole = Vec::with_capacity(records.len());
        for record in records {
            whole.push(match record {
                Some(record) if producer.fetched.counts(record) && self.intact(record)? => Some(*record),
                _ => None,
            });
        }
        records::load_many(self.store, &whole, &producer.spec, producer.group)
    }
}
