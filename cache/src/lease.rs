//! Leases: the live store instances, and the blobs and records that they rely on.
//!
//! Each open store owns `leases/<owner>.lease`, locked by the operating system until it drops or its process dies, and
//! notes there what it relies on *before* it checks that it is there. A gc first hides the blobs that it wants to
//! delete, then reads the notes, and restores the noted ones. A live run keeps its blobs in either order, without
//! waiting for a lock.
//!
//! The notes of a dead lease remain as the history of use, by which gc sorts.

use crate::{
    Key,
    codec::{Fields, Put},
    error::{At, CacheError},
    layout::{Layout, open_lock, open_plain},
    network,
};
use std::{
    collections::HashSet,
    fs::{self, File},
    hash::{BuildHasher, RandomState},
    io::{self, Read},
    os::unix::fs::FileExt,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

/// Bytes of a lease that are read at once; more than any note has.
const CHUNK: u64 = 1 << 20;
/// How often a lease is made anew after a gc swept it away, before gcs are kept waiting.
const SWEPT: u32 = 3;

/// One note of a lease.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Use {
    /// Uses noted from here on happened at this time (unix seconds).
    Time(u64),
    /// The blob of this hash.
    Blob([u8; 32]),
    /// A record, and the blobs it reaches.
    Record { namespace: Arc<str>, key: Key },
}

impl Use {
    pub fn encode(&self, out: &mut Vec<u8>) {
        match self {
            Self::Time(when) => {
                out.u8(b'T');
                out.u64(*when);
            }
            Self::Blob(hash) => {
                out.u8(b'B');
                out.extend_from_slice(hash);
            }
            Self::Record { namespace, key } => {
                out.u8(b'R');
                out.text(namespace);
                out.extend_from_slice(&key.0);
            }
        }
    }

    fn decode(fields: &mut Fields<'_>) -> Option<Self> {
        match fields.u8()? {
            b'T' => fields.u64().map(Self::Time),
            b'B' => fields.array().map(Self::Blob),
            b'R' => Some(Self::Record { namespace: fields.text()?.into(), key: Key(fields.array()?) }),
            _ => None,
        }
    }
}

/// Calls `each` with the notes in a lease file, up to a torn tail.
pub(crate) fn read_uses(path: &Path, each: &mut dyn FnMut(Use)) -> io::Result<()> {
    let mut file = match open_plain(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        other => other?,
    };
    let mut bytes = Vec::new();
    loop {
        let read = Read::by_ref(&mut file).take(CHUNK).read_to_end(&mut bytes)?;
        let mut done = 0;
        let mut fields = Fields(&bytes);
        while let Some(used) = Use::decode(&mut fields) {
            each(used);
            done = bytes.len() - fields.0.len();
        }
        bytes.drain(..done);
        // No note is as long as a chunk: what stays open then is none.
        if read == 0 || bytes.len() as u64 >= CHUNK {
            return Ok(());
        }
    }
}

/// Whether the owner of a lease file lives. A file that is gone has no owner.
pub(crate) fn is_live(path: &Path) -> bool {
    match open_plain(path) {
        // Shared, so that two processes that ask do not take each other for the owner. Where there are no locks, nobody
        // can tell: better to think that it lives.
        Ok(file) => file.try_lock_shared().is_err(),
        Err(error) => !network::is_gone(&error), // unreadable: as well
    }
}

/// The lease of this store instance.
#[derive(Debug)]
pub(crate) struct Lease {
    path: PathBuf,
    file: File,
    /// The file system refused to lock it.
    lockless: bool,
    notes: Mutex<Notes>,
}

#[derive(Debug, Default)]
struct Notes {
    end: u64,
    seen: HashSet<Use>,
    timed: bool,
    has_history: bool,
}

/// A name that no other store instance has.
pub(crate) fn new_owner() -> String {
    // RandomState is the standard library's source of entropy.
    format!("{}-{:016x}", std::process::id(), RandomState::new().hash_one(0u8))
}

impl Lease {
    /// Creates the lease file, locked from the moment it has its name.
    pub fn open(layout: &Layout) -> Result<Self, CacheError> {
        let path = layout.lease(&layout.owner);
        let mut tries = 0;
        loop {
            // A gc may sweep the temporary file away before it has its name. If that happens again and again, no gc
            // goes on during the next try.
            let pause = (tries > SWEPT).then(|| open_lock(&layout.gc_lock())).transpose()?;
            if let Some(lock) = &pause
                && let Err(error) = lock.lock()
                && !network::has_no_locks(&error)
            {
                return Err(error).at("wait for the lock", &layout.gc_lock());
            }
            let tmp = layout.tmp();
            let made = File::create_new(&tmp).and_then(|file| {
                let lockless = match file.lock() {
                    Err(error) if network::has_no_locks(&error) => true,
                    other => other.map(|()| false)?,
                };
                network::rename(&tmp, &path)?;
                Ok((file, lockless))
            });
            if made.is_err() {
                let _ = fs::remove_file(&tmp); // the first error is the one to report
            }
            match made {
                Ok((file, lockless)) => return Ok(Self { path, file, lockless, notes: Mutex::default() }),
                Err(error) if error.kind() == io::ErrorKind::NotFound && tries <= SWEPT => tries += 1,
                Err(error) => return Err(error).at("create the lease", &path),
            }
        }
    }

    /// Whether the file system refuses locks.
    pub fn is_lockless(&self) -> bool {
        self.lockless
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Notes uses that have not been noted yet. They are seen by every process when this returns.
    pub fn note(&self, uses: impl IntoIterator<Item = Use>) -> Result<(), CacheError> {
        let mut notes = self.notes.lock().unwrap_or_else(PoisonError::into_inner);
        let fresh: Vec<Use> = uses.into_iter().filter(|used| !notes.seen.contains(used)).collect();
        if fresh.is_empty() {
            return Ok(());
        }
        let mut bytes = Vec::new();
        fresh.iter().for_each(|used| used.encode(&mut bytes));
        if let Err(error) = self.file.write_all_at(&bytes, notes.end) {
            let _ = self.file.set_len(notes.end); // the next note starts there in any case
            return Err(error).at("write the lease", &self.path);
        }
        notes.end += bytes.len() as u64;
        notes.has_history |= notes.timed && fresh.iter().any(|used| matches!(used, Use::Record { .. }));
        notes.seen.extend(fresh);
        Ok(())
    }

    /// Tells the time for the uses that follow.
    pub fn set_time(&self, when: u64) -> Result<(), CacheError> {
        {
            let mut notes = self.notes.lock().unwrap_or_else(PoisonError::into_inner);
            notes.seen.clear();
            notes.timed = true;
        }
        self.note([Use::Time(when)])
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        let notes = self.notes.get_mut().unwrap_or_else(PoisonError::into_inner);
        if !notes.has_history {
            let _ = fs::remove_file(&self.path); // a dead lease left behind is harmless
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lease_that_cannot_be_made_leaves_nothing() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        // The folder for leases does not exist.
        fs::create_dir(dir.path().join("tmp")).expect("writable");
        let error = Lease::open(&Layout::new(dir.path(), new_owner())).expect_err("nowhere to put it");
        assert!(error.to_string().contains("create the lease"), "{error}");
        assert_eq!(fs::read_dir(dir.path().join("tmp")).expect("readable").count(), 0);
    }
}
