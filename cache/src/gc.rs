//! Garbage collection: selection and deletion of blobs and records.
//!
//! It is safe during live runs and does not block them: see `lease` for the protocol, `plan` for the selection, and
//! `sweep` for the order of steps. Only collections exclude each other.

mod listing;
mod new_segment;
mod plan;
mod rescue;
mod segments;
mod sweep;
mod trash;

use crate::{
    CacheError, Digest, Store,
    error::At,
    layout::{Layout, names, open_lock, open_plain},
    network,
};
use std::{
    fs::TryLockError,
    thread::sleep,
    time::{Duration, Instant},
};

/// Longest wait for a collection that has things in its trash; one that hangs must not stop everybody.
const SWEEP_WAIT: Duration = Duration::from_secs(10);

/// The results that a collection keeps.
///
/// Always kept: what pins reach, what live stores have written or looked up, and what was recorded or hit within
/// `keep_within_secs` of `now`. The least recently used of the other records are deleted until at most `max_bytes` of
/// blobs are left. Without `max_bytes`, all of them are deleted if `keep_within_secs` is given, and none otherwise.
/// Blobs that no record and no pin reaches always go.
///
/// A record that has lost blobs is kept like any other. It still says what came of its action, so that what builds on
/// that need not run again; who needs the blobs has them made again. It is deleted if `lost` is set.
#[derive(Clone, Debug, Default)]
pub struct GcOptions {
    /// Bytes of blobs to come down to.
    pub max_bytes: Option<u64>,
    /// Keep what was used in the last so many seconds.
    pub keep_within_secs: Option<u64>,
    /// The present, in unix seconds.
    pub now: u64,
    /// Count only; change nothing.
    pub dry_run: bool,
    /// Digests to treat as pinned, this time.
    pub pins: Vec<Digest>,
    /// Let records go that have [lost](crate::VerifyReport::lost_records) blobs, however recent they are: all but those
    /// that pins and live stores hold. Their actions run again when somebody asks for what they gave.
    pub lost: bool,
}

/// The result of a collection, or of a dry run.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct GcReport {
    /// Nothing was changed.
    pub dry_run: bool,
    /// Blobs left.
    pub kept_blobs: u64,
    /// Their bytes.
    pub kept_bytes: u64,
    /// Bytes among them that pins, recent use and live stores keep.
    pub held_bytes: u64,
    /// Blobs removed.
    pub removed_blobs: u64,
    /// Their bytes.
    pub removed_bytes: u64,
    /// Records left.
    pub kept_records: u64,
    /// Records removed.
    pub removed_records: u64,
    /// Records among those left that have lost blobs.
    pub lost_records: u64,
    /// Blobs and records that a live store asked for during the collection, and that were given back.
    pub rescued: u64,
    /// Other stores on this folder that are open now.
    pub live_stores: u64,
    /// Bytes by which the rest exceeds `max_bytes`, because it is held.
    pub over_budget: u64,
    /// Bytes among those left that were to go, but lie in files with what stays, and there was no room to copy that.
    pub no_room_bytes: u64,
}

impl Store {
    /// Removes what is not worth keeping; see [`GcOptions`].
    ///
    /// A pack of small blobs of which less than an eighth would go stays as it is, until more goes. Nothing needs room
    /// before room has been made, and what there is no room for is left as it is: a full disk can be collected, too.
    ///
    /// # Errors
    /// When the disk refuses, or the store is open for reading only. Nothing that was to be kept is lost then; the next
    /// collection tidies up.
    pub fn gc(&self, options: &GcOptions) -> Result<GcReport, CacheError> {
        if options.dry_run {
            self.refresh()?;
            return Ok(plan::Plan::make(self, options)?.report);
        }
        // On a disk too full for a lease, a collection goes on without one: it relies on nothing.
        self.writes().or_else(|why| if why.is_full() { Ok(()) } else { Err(why) })?;
        // Nobody may have put a link in the place of a folder since the store was opened.
        self.layout.own_folders()?;
        let path = self.layout.gc_lock();
        let file = open_lock(&path)?;
        if let Err(error) = file.lock() {
            if network::has_no_locks(&error) {
                return Err(CacheError::NoLocks { dir: self.layout.root.clone() });
            }
            return Err(error).at("wait for the lock", &path);
        }
        self.flush()?;
        trash::restore_trash(&self.layout)?;
        self.refresh()?;
        let plan = plan::Plan::make(self, options)?;
        sweep::Sweep::run(self, plan)
    }
}

/// Waits while a collection has things in its trash that it may give back.
pub(crate) fn wait_for_sweep(layout: &Layout) {
    let start = Instant::now();
    while start.elapsed() < SWEEP_WAIT && is_sweeping(layout) {
        sleep(Duration::from_millis(2));
    }
}

fn is_sweeping(layout: &Layout) -> bool {
    // Most often nobody collects, and this is all.
    if !names(&layout.folder("trash")).is_ok_and(|names| !names.is_empty()) {
        return false;
    }
    let lock = open_plain(&layout.gc_lock());
    lock.is_ok_and(|lock| matches!(lock.try_lock_shared(), Err(TryLockError::WouldBlock)))
}
