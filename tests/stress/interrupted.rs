//! A store in memory that stops trainings, or fails them, where they write their checkpoints.

use std::sync::{
    Mutex,
    atomic::{AtomicBool, Ordering},
};
use tauflow_contract::{Artifact, Blobs, Digest, KindError, MemoKey, MemoryBlobs};

/// What happens to a training. Checkpoints are counted from 1, in the run that writes them.
#[derive(Clone, Copy, Debug)]
pub(super) enum Interruption {
    /// It is asked to stop, as by Ctrl-C, once it has written so many.
    StopAfter(u64),
    /// This one cannot be written.
    FailAt(u64),
}

/// The store.
#[derive(Default)]
pub(super) struct Interrupted {
    blobs: MemoryBlobs,
    stop: AtomicBool,
    /// What is to happen, and the checkpoints that were written since that was said.
    armed: Mutex<Option<(Interruption, u64)>>,
}

impl Interrupted {
    /// Whether a training is asked to stop.
    pub(super) fn stop(&self) -> &AtomicBool {
        &self.stop
    }

    /// Lies in wait for the next run.
    pub(super) fn arm(&self, how: Interruption) {
        *self.armed.lock().expect("no holder panics") = Some((how, 0));
    }

    /// Lets runs come to their end.
    pub(super) fn disarm(&self) {
        *self.armed.lock().expect("no holder panics") = None;
        self.stop.store(false, Ordering::Relaxed);
    }
}

impl Blobs for Interrupted {
    fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, KindError> {
        self.blobs.get(digest)
    }

    fn put(&self, bytes: &[u8]) -> Result<Digest, KindError> {
        self.blobs.put(bytes)
    }

    fn memo_get(&self, key: &MemoKey) -> Option<Artifact> {
        self.blobs.memo_get(key)
    }

    fn memo_put(&self, key: &MemoKey, artifact: &Artifact) -> Result<(), KindError> {
        if let Some((how, written)) = self.armed.lock().expect("no holder panics").as_mut() {
            *written += 1;
            match how {
                Interruption::FailAt(nth) if *written == *nth => {
                    return Err(KindError::Environment("there is no space left for a checkpoint".into()));
                }
                Interruption::StopAfter(count) if *written == *count => self.stop.store(true, Ordering::Relaxed),
                _ => {}
            }
        }
        self.blobs.memo_put(key, artifact)
    }
}
