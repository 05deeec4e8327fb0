//! Artifacts with their content digests.

use std::sync::Arc;
use tauflow_cache::Digest;
use tauflow_contract::{Artifact, ItemKey};

/// An artifact with its content digest.
#[derive(Debug)]
pub struct Output {
    /// The artifact.
    pub artifact: Artifact,
    /// Its digest.
    pub digest: Digest,
}

impl Output {
    /// Computes the digest.
    pub fn new(artifact: Artifact) -> Arc<Self> {
        Arc::new(Self { digest: artifact.digest(), artifact })
    }
}

/// Items in the order of their keys.
pub type Items = Vec<(ItemKey, Arc<Output>)>;
