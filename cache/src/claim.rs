//! Claims: one action runs in one place at a time, across threads and processes.
//!
//! A claim is an operating system lock on `locks/<key>`, so it dies with its
//! process.  Exclusion is exact: one file a key, no stripes, so two keys never
//! wait for each other and one thread may hold many.  Claims deadlock only when
//! their holders wait in a circle; an action that claims the sub-actions it
//! needs waits along the edges of an acyclic graph, which has no circles.  Two
//! rules follow for callers.  Claim only what the held action depends on.  Do
//! not run foreign work while holding a claim (a work-stealing wait may pick an
//! action that needs what this thread holds): use `try_claim` there.

use crate::{CacheError, Key, error::At};
use std::{
    collections::HashMap,
    fs::{self, File, TryLockError},
    io,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
    thread::{self, ThreadId},
};

/// Which thread of this store instance holds which key.
pub(crate) type Held = Mutex<HashMap<Key, ThreadId>>;

/// The right to run one action; given back on drop, or by the death of the process.
#[derive(Debug)]
pub struct Claim {
    key: Key,
    path: PathBuf,
    held: Arc<Held>,
    waited: bool,
    // Closing the file releases the lock, after `drop` removed its name.
    _file: File,
}

impl Claim {
    /// The key.
    pub fn key(&self) -> Key {
        self.key
    }

    /// Whether somebody else held it first: the action is then likely done.
    pub fn waited(&self) -> bool {
        self.waited
    }

    /// Claims `key`; `Ok(None)` when it is taken and `wait` is false.
    pub(crate) fn take(dir: &Path, key: &Key, held: &Arc<Held>, wait: bool) -> Result<Option<Self>, CacheError> {
        let me = thread::current().id();
        if held.lock().unwrap_or_else(PoisonError::into_inner).get(key) == Some(&me) {
            return if wait { Err(CacheError::ClaimedTwice { key: *key }) } else { Ok(None) };
        }
        let path = dir.join(key.hex());
        let mut waited = false;
        loop {
            let file = File::options().create(true).truncate(false).write(true).open(&path);
            let file = file.at("open the lock", &path)?;
            match file.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) if !wait => return Ok(None),
                Err(TryLockError::WouldBlock) => {
                    waited = true;
                    lock(&file).at("wait for the lock", &path)?;
                }
                Err(TryLockError::Error(error)) => return Err(error).at("lock", &path),
            }
            // Its last holder may have removed the name while we waited: then the lock guards nothing.
            if same_file(&file, &path) {
                held.lock().unwrap_or_else(PoisonError::into_inner).insert(*key, me);
                return Ok(Some(Self { key: *key, path, held: held.clone(), waited, _file: file }));
            }
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.held.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.key);
        let _ = fs::remove_file(&self.path); // a name left behind is harmless; gc removes it
    }
}

fn lock(file: &File) -> io::Result<()> {
    loop {
        match file.lock() {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            other => return other,
        }
    }
}

fn same_file(file: &File, path: &Path) -> bool {
    match (file.metadata(), fs::metadata(path)) {
        (Ok(ours), Ok(named)) => ours.ino() == named.ino() && ours.dev() == named.dev(),
        _ => false,
    }
}

/// Removes the lock files of processes that died.
pub(crate) fn sweep(dir: &Path) -> io::Result<()> {
    for name in crate::layout::names(dir)? {
        let path = dir.join(name);
        let Ok(file) = File::options().write(true).open(&path) else { continue };
        // Holding the lock on the named file is what entitles to remove the name.
        if file.try_lock().is_ok() && same_file(&file, &path) {
            let _ = fs::remove_file(&path);
        }
    }
    Ok(())
}
