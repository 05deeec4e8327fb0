//! The store itself: what an open one owns, and how it keeps up with others.
//!
//! Locks are taken in this order: `commit`, `log`, `packs`, `index`, `files`.

use crate::{
    CacheError, Claim, Key,
    claim::Claims,
    error::At,
    index::Index,
    layout::{Layout, names, sync_dir},
    lease::{Lease, is_live, new_owner},
    segment::{Appender, Sort},
    sidecar,
};
use std::{
    collections::HashMap,
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard},
    time::{Duration, Instant, SystemTime},
};

/// How long a miss trusts the index before it looks for what other processes wrote.
const REFRESH_AFTER: Duration = Duration::from_millis(100);
/// How long this store trusts that it is alone: times of folders are cached by network file systems.
const TRUST: Duration = Duration::from_secs(1);
/// By how much the time of a folder may lag behind its changes, and more.
const COARSE: Duration = Duration::from_millis(100);
/// Bytes of an own segment from which an index file is worth its while.
const SIDECAR_BYTES: u64 = 128 << 10;
/// Open segment files kept for reading.
const OPEN_FILES: usize = 128;

/// A folder of blobs and records, shared by any number of threads and processes.
///
/// Share it within a process by `Arc`; several instances on one folder are fine too.
#[derive(Debug)]
pub struct Store {
    pub(crate) layout: Layout,
    pub(crate) lease: Lease,
    pub(crate) commit: Mutex<()>,
    pub(crate) log: Mutex<LogWriter>,
    pub(crate) packs: Mutex<PackWriter>,
    index: RwLock<Index>,
    files: Mutex<HashMap<u32, Arc<File>>>,
    refreshed: Mutex<Instant>,
    claims: Arc<Claims>,
    alone: Mutex<Alone>,
}

/// What this store knows of others on its folder.
#[derive(Debug, Default)]
struct Alone {
    /// The time of the folder of leases when no other store was seen to live, and when that was.
    seen: Option<(SystemTime, Instant)>,
    /// It was looked again when a change would have had to show in the folder's time.
    sure: bool,
}

/// The log segment being written, and what waits for the next commit.
#[derive(Debug, Default)]
pub(crate) struct LogWriter {
    pub appender: Option<Appender>,
    pub pending: usize,
    pub since: Option<Instant>,
}

/// The pack segment being written, and what waits for the next commit.
#[derive(Debug, Default)]
pub(crate) struct PackWriter {
    pub appender: Option<Appender>,
    pub dirty_packs: Vec<(PathBuf, Arc<File>)>,
    pub dirty_loose: Vec<PathBuf>,
}

/// Locks a mutex.  The values guarded here are valid after every statement, so a panic elsewhere does not spoil them.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Whether the last refresh is too long ago to count on.
fn is_old(refreshed: &Mutex<Instant>) -> bool {
    lock(refreshed).elapsed() >= TRUST
}

impl Store {
    /// Opens the store in `dir`, making it if it is missing.
    ///
    /// # Errors
    /// When the folder cannot be made or written, or holds a store of another format.
    pub fn open(dir: &Path) -> Result<Self, CacheError> {
        fs::create_dir_all(dir).at("create the cache folder", dir)?;
        let root = dir.canonicalize().at("find the cache folder", dir)?;
        let layout = Layout::open(&root, new_owner())?;
        let lease = Lease::open(&layout)?;
        layout.sign()?;
        let claims = Claims::open(&layout.folder("locks"))?;
        let mut index = Index::default();
        index.refresh(&layout).at("read the cache", &root)?;
        Ok(Self {
            layout,
            lease,
            commit: Mutex::default(),
            log: Mutex::default(),
            packs: Mutex::default(),
            index: RwLock::new(index),
            files: Mutex::default(),
            refreshed: Mutex::new(Instant::now()),
            claims: Arc::new(claims),
            alone: Mutex::default(),
        })
    }

    /// The store's folder, as an absolute path.
    pub fn dir(&self) -> &Path {
        &self.layout.root
    }

    /// Tells the store the time (unix seconds), by which a gc judges how recent the hits that follow are.
    /// Call it once a run.  Without it, what this instance hits is safe while it lives, but no younger afterwards.
    ///
    /// # Errors
    /// When the lease cannot be written.
    pub fn set_time(&self, now: u64) -> Result<(), CacheError> {
        self.lease.set_time(now)
    }

    /// Waits until this thread alone, among all threads and processes, holds `key`.  Look the key up again
    /// afterwards: whoever held it may have done the work.  The index is up to date when this returns.
    ///
    /// Keys do not wait for each other (unless 63 bits of their hashes are equal).  To avoid circles, claim while holding a claim only what
    /// the held action depends on, and use [`try_claim`](Self::try_claim) where a thread may pick up foreign work.
    ///
    /// # Errors
    /// When the lock file cannot be made, or this thread holds the key already.
    pub fn claim(&self, key: &Key) -> Result<Claim, CacheError> {
        loop {
            // Waiting ends with a claim, so this goes round once.
            if let Some(claim) = self.claims.take(key, true)? {
                self.refresh_unless_alone()?;
                return Ok(claim);
            }
        }
    }

    /// Like [`claim`](Self::claim), but `None` at once when the key is taken, by whomever.
    ///
    /// # Errors
    /// When the lock file cannot be made.
    pub fn try_claim(&self, key: &Key) -> Result<Option<Claim>, CacheError> {
        let claim = self.claims.take(key, false)?;
        if claim.is_some() {
            self.refresh_unless_alone()?;
        }
        Ok(claim)
    }

    /// Refreshes, unless no other store has been open since the last time. Whoever opens one adds a lease to the folder, whose
    /// time then changes; as that time is coarse, one look that finds nobody is only trusted after another, a moment later.
    fn refresh_unless_alone(&self) -> Result<(), CacheError> {
        let folder = self.layout.folder("leases");
        let changed = fs::metadata(&folder).and_then(|meta| meta.modified()).at("look at", &folder)?;
        let since = {
            let alone = lock(&self.alone);
            match alone.seen {
                Some((time, _)) if time == changed && alone.sure && !is_old(&self.refreshed) => return Ok(()),
                Some((time, since)) if time == changed => Some(since),
                _ => None,
            }
        };
        let mut others = names(&folder).at("list", &folder)?.into_iter().map(|name| folder.join(name));
        // A file system that counts whole seconds would hide changes.
        let coarse = changed.duration_since(SystemTime::UNIX_EPOCH).is_ok_and(|time| time.subsec_nanos() == 0);
        let now = if coarse || others.any(|path| path != self.lease.path() && is_live(&path)) {
            Alone::default()
        } else {
            let since = since.unwrap_or_else(Instant::now);
            Alone { seen: Some((changed, since)), sure: since.elapsed() >= COARSE }
        };
        *lock(&self.alone) = now;
        self.refresh()
    }

    /// Reads what other processes have appended.  Misses do this by themselves, a few times a second.
    ///
    /// # Errors
    /// When the store's folder cannot be read.
    pub fn refresh(&self) -> Result<(), CacheError> {
        *lock(&self.refreshed) = Instant::now();
        self.index_mut().refresh(&self.layout).at("read the cache", &self.layout.root)
    }

    /// Refreshes unless that was done a moment ago; whether it did.
    pub(crate) fn refresh_on_miss(&self) -> bool {
        {
            let mut last = lock(&self.refreshed);
            if last.elapsed() < REFRESH_AFTER {
                return false;
            }
            *last = Instant::now();
        }
        self.refresh().is_ok()
    }

    pub(crate) fn index(&self) -> RwLockReadGuard<'_, Index> {
        self.index.read().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn index_mut(&self) -> RwLockWriteGuard<'_, Index> {
        self.index.write().unwrap_or_else(PoisonError::into_inner)
    }

    /// A segment's file, for reading.
    pub(crate) fn segment_file(&self, number: u32) -> io::Result<Arc<File>> {
        if let Some(file) = lock(&self.files).get(&number) {
            return Ok(file.clone());
        }
        let path = self.index().segments[number as usize].path.clone();
        let file = Arc::new(File::open(path)?);
        let mut files = lock(&self.files);
        if files.len() >= OPEN_FILES {
            files.clear();
        }
        files.insert(number, file.clone());
        Ok(file)
    }

    /// Starts a segment that this instance writes.
    pub(crate) fn start_segment(&self, sort: Sort) -> Result<Appender, CacheError> {
        let folder = self.layout.folder(sort.folder());
        // Under the lock, so that no refresh takes the new file for a stranger's.
        let mut index = self.index_mut();
        let mut seq = index.last_seq(sort) + 1;
        let (name, path, file) = loop {
            let name = sort.name(seq, &self.layout.owner);
            let path = folder.join(&name);
            match File::options().read(true).write(true).create_new(true).open(&path) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => seq += 1,
                made => break (name, path.clone(), made.at("create the segment", &path)?),
            }
        };
        sync_dir(&folder).at("sync the folder of", &path)?;
        let segment = index.add_own(sort, name, path.clone());
        Ok(Appender { file: Arc::new(file), path, segment, end: 0 })
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        // Nobody is left to tell; what is not committed is proved by reading it next time.
        let _ = self.flush();
        let index = self.index.get_mut().unwrap_or_else(PoisonError::into_inner);
        for number in 0..index.segments.len() {
            let segment = &index.segments[number];
            if segment.own && !segment.gone && segment.scanned >= SIDECAR_BYTES {
                sidecar::save(index, number as u32, &self.layout);
            }
        }
    }
}
