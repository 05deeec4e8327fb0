//! The engine's services for a running action: blobs, memoised sub-actions, progress, cancellation.

use crate::{Artifact, KindError, MemoKey};
use serde::Serialize;
use std::{
    collections::HashMap,
    sync::{
        Mutex,
        atomic::{AtomicBool, Ordering},
    },
};
use tauflow_cache::{Digest, Key};

/// Where blobs and memoised sub-actions live. The engine implements it over the cache; [`MemoryBlobs`] over memory.
pub trait Blobs: Send + Sync {
    /// The bytes of a blob; `None` if it is missing.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, KindError>;

    /// Stores a blob.
    ///
    /// # Errors
    /// If the store cannot be written (full disk, permissions).
    fn put(&self, bytes: &[u8]) -> Result<Digest, KindError>;

    /// The artifact of an earlier sub-action, if all its blobs are there.
    fn memo_get(&self, key: &MemoKey) -> Option<Artifact>;

    /// Keeps a sub-action's artifact.
    ///
    /// # Errors
    /// If the store cannot be written, or another artifact is already kept under the same key.
    fn memo_put(&self, key: &MemoKey, artifact: &Artifact) -> Result<(), KindError>;
}

/// Receives progress of a long action. Never decides an output.
pub trait Progress: Send + Sync {
    /// `done` of `total` units of work, with a short line such as `loss 0.031  12.4 steps/s`.
    fn report(&self, done: u64, total: u64, message: &str);
}

/// Progress that nobody looks at.
pub struct Silent;

impl Progress for Silent {
    fn report(&self, _done: u64, _total: u64, _message: &str) {}
}

/// The surroundings of one running action.
pub struct Context<'a> {
    blobs: &'a dyn Blobs,
    progress: &'a dyn Progress,
    cancel: &'a AtomicBool,
}

impl<'a> Context<'a> {
    /// Bundles what an action may use.
    pub fn new(blobs: &'a dyn Blobs, progress: &'a dyn Progress, cancel: &'a AtomicBool) -> Self {
        Self { blobs, progress, cancel }
    }

    /// The bytes of a blob that an input names.
    ///
    /// # Errors
    /// [`KindError::MissingBlob`] if it is not there (the engine then makes it again), or a store error.
    pub fn get(&self, digest: &Digest) -> Result<Vec<u8>, KindError> {
        self.blobs.get(digest)?.ok_or(KindError::MissingBlob(*digest))
    }

    /// The bytes of a part of an artifact; the empty name is the single blob.
    ///
    /// # Errors
    /// As [`Context::get`]; [`KindError::Input`] if the artifact has no such part.
    pub fn part(&self, artifact: &Artifact, name: &str) -> Result<Vec<u8>, KindError> {
        let digest = artifact.part(name).ok_or_else(|| {
            KindError::Input(format!(
                "an artifact of type `{}` has no part `{name}`; was it made by another version?",
                artifact.media
            ))
        })?;
        self.get(&digest)
    }

    /// Parses a JSON part.
    ///
    /// # Errors
    /// As [`Context::part`]; [`KindError::Input`] if it is not the JSON that is expected.
    pub fn json<T: serde::de::DeserializeOwned>(&self, artifact: &Artifact, name: &str) -> Result<T, KindError> {
        serde_json::from_slice(&self.part(artifact, name)?)
            .map_err(|e| KindError::Input(format!("part `{name}` of a `{}`: {e}", artifact.media)))
    }

    /// Stores a blob.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn put(&self, bytes: &[u8]) -> Result<Digest, KindError> {
        self.blobs.put(bytes)
    }

    /// Stores a value as JSON.
    ///
    /// # Errors
    /// If the store cannot be written or the value cannot be JSON.
    pub fn put_json<T: Serialize>(&self, value: &T) -> Result<Digest, KindError> {
        let bytes = serde_json::to_vec(value).map_err(|e| KindError::Internal(format!("cannot write JSON: {e}")))?;
        self.put(&bytes)
    }

    /// The artifact of an earlier sub-action with this key, if it is still whole.
    pub fn memo_get(&self, key: &MemoKey) -> Option<Artifact> {
        self.blobs.memo_get(key)
    }

    /// Keeps a sub-action's artifact for later actions.
    ///
    /// # Errors
    /// As [`Blobs::memo_put`].
    pub fn memo_put(&self, key: &MemoKey, artifact: &Artifact) -> Result<(), KindError> {
        self.blobs.memo_put(key, artifact)
    }

    /// Reports progress.
    pub fn progress(&self, done: u64, total: u64, message: &str) {
        self.progress.report(done, total, message);
    }

    /// # Errors
    /// [`KindError::Cancelled`] once the run is being stopped; long actions call this between units of work.
    pub fn check_cancelled(&self) -> Result<(), KindError> {
        if self.cancel.load(Ordering::Relaxed) { Err(KindError::Cancelled) } else { Ok(()) }
    }
}

/// Blobs and memoised sub-actions in memory, for tests and for commands that run outside a pipeline.
#[derive(Default)]
pub struct MemoryBlobs {
    blobs: Mutex<HashMap<Digest, Vec<u8>>>,
    memos: Mutex<HashMap<Key, Artifact>>,
}

impl Blobs for MemoryBlobs {
    fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, KindError> {
        Ok(self.blobs.lock().expect("no holder panics").get(digest).cloned())
    }

    fn put(&self, bytes: &[u8]) -> Result<Digest, KindError> {
        let digest = Digest::of(bytes);
        self.blobs.lock().expect("no holder panics").insert(digest, bytes.to_vec());
        Ok(digest)
    }

    fn memo_get(&self, key: &MemoKey) -> Option<Artifact> {
        self.memos.lock().expect("no holder panics").get(&key.hash()).cloned()
    }

    fn memo_put(&self, key: &MemoKey, artifact: &Artifact) -> Result<(), KindError> {
        self.memos.lock().expect("no holder panics").insert(key.hash(), artifact.clone());
        Ok(())
    }
}
