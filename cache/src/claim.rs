//! Claims: one action runs in one place at a time, across threads and processes.
//!
//! A claim is an operating system lock on one byte of `locks/claims`, at the offset given by 63 bits of the key. It
//! ends with its process and costs a system call. Two keys never wait for each other (unless 63 bits of their hashes
//! are equal), and one thread may hold many. Claims deadlock only if their holders wait in a cycle; an action that
//! claims its sub-actions waits along the edges of an acyclic graph. Two rules follow for callers. Claim only what the
//! held action depends on. Do not run foreign work while holding a claim (a work-stealing wait may pick an action that
//! needs what this thread holds): use `try_claim` there.
//!
//! The lock belongs to the open file, so threads of one store exclude each other by a table beside it.

use crate::{CacheError, Key, error::At, layout::open_lock, network};
use nix::{
    errno::Errno,
    fcntl::{FcntlArg, fcntl},
    libc,
};
use std::{
    collections::HashMap,
    fs::File,
    io,
    path::{Path, PathBuf},
    sync::{Arc, Condvar, Mutex, PoisonError},
    thread::{self, ThreadId},
};

/// The claims of a store instance.
#[derive(Debug)]
pub(crate) struct Claims {
    file: File,
    path: PathBuf,
    held: Mutex<HashMap<Key, ThreadId>>,
    freed: Condvar,
}

/// The right to run one action; given back on drop, or by the death of the process.
#[derive(Debug)]
pub struct Claim {
    key: Key,
    claims: Arc<Claims>,
    waited: bool,
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
}

impl Claims {
    pub fn open(folder: &Path) -> Result<Self, CacheError> {
        let path = folder.join("claims");
        Ok(Self { file: open_lock(&path)?, path, held: Mutex::default(), freed: Condvar::new() })
    }

    /// Claims `key`; `Ok(None)` when it is taken and `wait` is false.
    pub fn take(self: &Arc<Self>, key: &Key, wait: bool) -> Result<Option<Claim>, CacheError> {
        let me = thread::current().id();
        let mut waited = false;
        {
            let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
            while let Some(holder) = held.get(key) {
                match (wait, *holder == me) {
                    (false, _) => return Ok(None),
                    (true, true) => return Err(CacheError::ClaimedTwice { key: *key }),
                    (true, false) => waited = true,
                }
                held = self.freed.wait(held).unwrap_or_else(PoisonError::into_inner);
            }
            held.insert(*key, me);
        }
        // From here on its drop gives the place in the table back.
        let mut claim = Claim { key: *key, claims: self.clone(), waited };
        let mut taken = self.lock(key, libc::F_WRLCK, false);
        if wait && is_taken(&taken) {
            claim.waited = true;
            taken = self.lock(key, libc::F_WRLCK, true);
        }
        match taken {
            Ok(()) => Ok(Some(claim)),
            Err(_) if is_taken(&taken) => Ok(None),
            // Two machines may then do the same, which costs time and changes no result.
            Err(error) if network::has_no_locks(&error.into()) => Ok(Some(claim)),
            Err(error) => Err(io::Error::from(error)).at("lock", &self.path),
        }
    }

    fn lock(&self, key: &Key, kind: libc::c_int, wait: bool) -> Result<(), Errno> {
        let head = key.0.first_chunk().map_or(0, |head| u64::from_le_bytes(*head));
        let range = libc::flock {
            l_type: kind as libc::c_short,
            l_whence: libc::SEEK_SET as libc::c_short,
            l_start: (head >> 1).min(i64::MAX as u64 - 1) as libc::off_t,
            l_len: 1,
            l_pid: 0,
        };
        loop {
            let how = if wait { FcntlArg::F_OFD_SETLKW(&range) } else { FcntlArg::F_OFD_SETLK(&range) };
            match fcntl(&self.file, how) {
                Err(Errno::EINTR) => {}
                other => return other.map(drop),
            }
        }
    }
}

fn is_taken(result: &Result<(), Errno>) -> bool {
    matches!(result, Err(Errno::EAGAIN | Errno::EACCES))
}

impl Drop for Claim {
    fn drop(&mut self) {
        // Unlocking a byte that is not locked does nothing; the death of the process unlocks it in any case.
        let _ = self.claims.lock(&self.key, libc::F_UNLCK, false);
        self.claims.held.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.key);
        self.claims.freed.notify_all();
    }
}
