//! Blobs of an asset in the making, by digest. Knows nothing of what they hold.

use std::collections::BTreeMap;
use tauflow_contract::{Context, Digest, KindError};

/// Blobs that are not in the store yet.
#[derive(Default)]
pub struct BlobSet {
    blobs: BTreeMap<Digest, Vec<u8>>,
}

impl BlobSet {
    /// Adds a blob; its digest.
    pub fn add(&mut self, bytes: Vec<u8>) -> Digest {
        let digest = Digest::of(&bytes);
        self.blobs.insert(digest, bytes);
        digest
    }

    /// A blob's bytes.
    pub fn get(&self, digest: &Digest) -> Option<&[u8]> {
        self.blobs.get(digest).map(Vec::as_slice)
    }

    /// All of them.
    pub fn into_map(self) -> BTreeMap<Digest, Vec<u8>> {
        self.blobs
    }

    /// Stores those that `wanted` names.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn store(&self, ctx: &Context<'_>, wanted: &[Digest]) -> Result<(), KindError> {
        for digest in wanted {
            if let Some(bytes) = self.blobs.get(digest) {
                ctx.put(bytes)?;
            }
        }
        Ok(())
    }
}
