//! What the last complete runs of pipelines refer to in a store.

use crate::engine::PIPELINE;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_cache::{CacheError, Digest, Store};

/// The blobs of a pipeline that a store holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reached {
    /// The pipeline.
    pub pipeline: String,
    /// How many blobs.
    pub blobs: usize,
    /// Their bytes.
    pub bytes: u64,
    /// The bytes of blobs that no other of these pipelines refers to.
    pub own_bytes: u64,
}

/// The blobs that the last complete run of each of these pipelines refers to.
///
/// # Errors
/// If the store cannot be read.
pub fn reached<'a>(store: &Store, names: impl Iterator<Item = &'a String>) -> Result<Vec<Reached>, CacheError> {
    let mut reached: Vec<(&String, Vec<Digest>)> = Vec::new();
    let mut users: BTreeMap<Digest, u64> = BTreeMap::new();
    for name in names {
        let trees: Vec<Digest> = store.by_label(PIPELINE, name).into_iter().flat_map(|r| r.trees).collect();
        let mut blobs = store.reach(&[], &trees)?;
        blobs.retain(|blob| store.contains(blob));
        blobs.iter().for_each(|blob| *users.entry(*blob).or_insert(0) += 1);
        reached.push((name, blobs));
    }
    let row = |(name, blobs): &(&String, Vec<Digest>)| Reached {
        pipeline: (*name).clone(),
        blobs: blobs.len(),
        bytes: blobs.iter().map(|blob| blob.size).sum(),
        own_bytes: blobs.iter().filter(|blob| users[*blob] == 1).map(|blob| blob.size).sum(),
    };
    Ok(reached.iter().map(row).collect())
}
