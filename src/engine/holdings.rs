//! What this process can read: the store, the blobs that it holds in memory beside it, and which blobs are known to be
//! missing from both.

use super::{
    records::{self, Made},
    transient::Pool,
};
use std::collections::HashSet;
use tauflow_cache::{CacheError, Digest, Record, Store};
use tauflow_contract::KindSpec;

/// See the module.
#[derive(Clone, Copy)]
pub struct Holdings<'a> {
    /// The store.
    pub store: &'a Store,
    /// Blobs that are in memory only.
    pub pool: &'a Pool,
    /// Blobs that were found missing: a record that names one counts only when it is there again.
    pub wanted: &'a HashSet<Digest>,
}

impl Holdings<'_> {
    /// Whether a blob is there, stored or in memory.
    pub fn is_here(&self, digest: &Digest) -> bool {
        self.pool.contains(digest) || self.store.contains(digest)
    }

    /// Whether a blob is there and sound.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn is_sound(&self, digest: &Digest) -> Result<bool, CacheError> {
        Ok(self.pool.contains(digest) || self.store.get(digest)?.is_some())
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

    /// What an action gave by its record; none if there is no record, or it is of no use.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn made(&self, record: Option<&Record>, spec: &KindSpec, group: &str) -> Result<Option<Made>, CacheError> {
        match record {
            Some(record) if self.intact(record)? => records::load(self.store, record, spec, group),
            _ => Ok(None),
        }
    }
}
