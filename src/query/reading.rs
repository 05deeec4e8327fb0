//! A store for reading only: kinds' code can show and export results, and cannot store any.

use tauflow_cache::{Digest, Store};
use tauflow_contract::{Artifact, Blobs, KindError, MemoKey};

/// The blobs of a store, for code of kinds that only reads.
pub struct Reading<'a>(pub &'a Store);

impl Blobs for Reading<'_> {
    fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, KindError> {
        self.0.get(digest).map_err(|e| KindError::Environment(e.to_string()))
    }

    fn put(&self, _: &[u8]) -> Result<Digest, KindError> {
        Err(KindError::Internal("results are read only, but a blob was to be stored".into()))
    }

    fn memo_get(&self, _: &MemoKey) -> Option<Artifact> {
        None
    }

    fn memo_put(&self, _: &MemoKey, _: &Artifact) -> Result<(), KindError> {
        Err(KindError::Internal("results are read only, but a sub-action was to be kept".into()))
    }
}
