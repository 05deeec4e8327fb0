//! The store: the state of an open store, and synchronisation with other stores.
//!
//! Locks are taken in this order: `commit`, `log`, `packs`, `index`, `files`.

use crate::{
    Beyond, CacheError, Claim, Digest, Key,
    claim::Claims,
    error::At,
    index::Index,
    layout::{Layout, lease_owner, names, open_plain, sync_dir},
    lease::{Lease, Use, is_live, new_owner},
    network::{self, FileSystem},
    segment::{Appender, Sort},
    sidecar,
};
use std::{
    collections::{BTreeMap, BTreeSet, HashMap, HashSet},
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
    /// Or why this store is open for reading only.
    writing: Result<Writing, Arc<CacheError>>,
    pub(crate) commit: Mutex<Synced>,
    pub(crate) log: Mutex<LogWriter>,
    /// A leaf: no other lock is taken while it is held.
    pub(crate) relied: Mutex<Relied>,
    pub(crate) packs: Mutex<PackWriter>,
    index: RwLock<Index>,
    files: Mutex<HashMap<u32, Arc<File>>>,
    refreshed: Mutex<Instant>,
    alone: Mutex<Alone>,
    /// A second place to ask for missing records and blobs.
    pub(crate) beyond: Option<Arc<dyn Beyond>>,
    /// The name of the file system, if several machines can share it.
    network: Option<&'static str>,
}

/// The part of a store that exists only if it may write.
#[derive(Debug)]
struct Writing {
    lease: Lease,
    claims: Arc<Claims>,
}

/// Knowledge about other stores on the same folder.
#[derive(Debug, Default)]
struct Alone {
    /// The time of the folder of leases when no other store was seen to live, and when that was.
    seen: Option<(SystemTime, Instant)>,
    /// It was looked again when a change would have had to show in the folder's time.
    sure: bool,
}

/// Blobs of other stores on which records of this store rely, although they may not be durable.
#[derive(Debug, Default)]
pub(crate) struct Relied {
    pub blobs: BTreeSet<Digest>,
    /// Log segments by number, and up to which place.
    pub logs: BTreeMap<u32, u64>,
}

/// Segments and blobs of other stores that this store has made durable.
#[derive(Debug, Default)]
pub(crate) struct Synced {
    /// The store's folder, with the names of those in it.
    pub root: bool,
    /// Segments by number, and their length then.
    pub segments: HashMap<u32, u64>,
    pub loose: HashSet<Digest>,
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

/// Locks a mutex. The values guarded here are valid after every statement, so a panic elsewhere does not spoil them.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Whether the last refresh is too long ago to count on.
fn is_old(refreshed: &Mutex<Instant>) -> bool {
    lock(refreshed).elapsed() >= TRUST
}

impl Store {
    /// Opens the store in `dir`, making it if it is missing. One that is there, but cannot be written to, is opened for
    /// reading only: what needs to write fails then, and says why.
    ///
    /// # Errors
    /// When the folder cannot be made or written, holds a store of another format, or holds something else.
    pub fn open(dir: &Path) -> Result<Self, CacheError> {
        fs::create_dir_all(dir).at("create the cache folder", dir)?;
        let root = dir.canonicalize().at("find the cache folder", dir)?;
        let layout = Layout::new(&root, new_owner());
        let made = layout.is_made()?;
        match Writing::begin(&layout) {
            Ok(writing) => Self::with(layout, Ok(writing)),
            // A full disk has no room for a lease, but all that is there can be read.
            Err(why) if made && (why.is_refused() || why.is_full()) => Self::with(layout, Err(why)),
            Err(error) => Err(error),
        }
    }

    /// Opens the store in `dir` to look at it, and makes none. Where there is none yet, it is as an empty one that
    /// cannot be written to.
    ///
    /// # Errors
    /// When the folder cannot be read, holds a store of another format, or holds something else.
    pub fn open_existing(dir: &Path) -> Result<Self, CacheError> {
        let (root, made) = match dir.canonicalize() {
            Ok(root) => {
                let made = Layout::new(&root, new_owner()).is_made()?;
                (root, made)
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                (std::path::absolute(dir).at("find the cache folder", dir)?, false)
            }
            Err(error) => return Err(error).at("find the cache folder", dir),
        };
        if made {
            return Self::open(&root);
        }
        let why = CacheError::NotMade { dir: root.clone() };
        Self::with(Layout::new(&root, new_owner()), Err(why))
    }

    fn with(mut layout: Layout, writing: Result<Writing, CacheError>) -> Result<Self, CacheError> {
        layout.writes = writing.is_ok();
        let network = network::network(&layout.root);
        let mut index = Index::default();
        index.refresh(&layout)?;
        Ok(Self {
            layout,
            writing: writing.map_err(Arc::new),
            commit: Mutex::default(),
            log: Mutex::default(),
            relied: Mutex::default(),
            packs: Mutex::default(),
            index: RwLock::new(index),
            files: Mutex::default(),
            refreshed: Mutex::new(Instant::now()),
            alone: Mutex::default(),
            beyond: None,
            network,
        })
    }

    /// The file system on which it lies.
    pub fn file_system(&self) -> FileSystem {
        let lockless = self.writing.as_ref().is_ok_and(|writing| writing.lease.is_lockless());
        FileSystem { network: self.network, lockless }
    }

    /// Whether the folder holds a store: not so if it was only opened to be looked at, and is empty.
    pub fn is_made(&self) -> bool {
        !matches!(&self.writing, Err(why) if matches!(**why, CacheError::NotMade { .. }))
    }

    /// An error if this store is open for reading only.
    pub(crate) fn writes(&self) -> Result<(), CacheError> {
        self.to_write().map(drop)
    }

    fn to_write(&self) -> Result<&Writing, CacheError> {
        self.writing.as_ref().map_err(|why| match &**why {
            CacheError::NotMade { dir } => CacheError::NotMade { dir: dir.clone() },
            _ => CacheError::ReadOnly { dir: self.layout.root.clone(), why: why.clone() },
        })
    }

    /// Notes uses, where others can see them. A store that only reads has nothing to note them in: no gc minds it.
    pub(crate) fn note(&self, uses: impl IntoIterator<Item = Use>) -> Result<(), CacheError> {
        self.writing.as_ref().map_or(Ok(()), |writing| writing.lease.note(uses))
    }

    /// Whether this is the store's own lease.
    pub(crate) fn is_own_lease(&self, path: &Path) -> bool {
        self.writing.as_ref().is_ok_and(|writing| writing.lease.path() == path)
    }

    /// The store's folder, as an absolute path.
    pub fn dir(&self) -> &Path {
        &self.layout.root
    }

    /// Tells the store the time (unix seconds), by which a gc judges how recent the hits that follow are. Call it once
    /// a run. Without it, what this instance hits is safe while it lives, but no younger afterwards. A store that is
    /// open for reading only leaves no trace of use.
    ///
    /// # Errors
    /// When the lease cannot be written.
    pub fn set_time(&self, now: u64) -> Result<(), CacheError> {
        self.writing.as_ref().map_or(Ok(()), |writing| writing.lease.set_time(now))
    }

    /// Waits until this thread alone, among all threads and processes, holds `key`. Look the key up again afterwards:
    /// whoever held it may have done the work. The index is up to date when this returns.
    ///
    /// Keys do not wait for each other (unless 63 bits of their hashes are equal). To avoid circles, claim while
    /// holding a claim only what the held action depends on, and use [`try_claim`](Self::try_claim) where a thread may
    /// pick up foreign work.
    ///
    /// # Errors
    /// When this thread holds the key already, or the store is open for reading only.
    pub fn claim(&self, key: &Key) -> Result<Claim, CacheError> {
        loop {
            // Waiting ends with a claim, so this goes round once.
            if let Some(claim) = self.to_write()?.claims.take(key, true)? {
                self.refresh_unless_alone()?;
                return Ok(claim);
            }
        }
    }

    /// Like [`claim`](Self::claim), but `None` at once when the key is taken, by whomever.
    ///
    /// # Errors
    /// When the lock file cannot be locked, or the store is open for reading only.
    pub fn try_claim(&self, key: &Key) -> Result<Option<Claim>, CacheError> {
        let claim = self.to_write()?.claims.take(key, false)?;
        if claim.is_some() {
            self.refresh_unless_alone()?;
        }
        Ok(claim)
    }

    /// Refreshes, unless no other store has been open since the last time. Whoever opens one adds a lease to the
    /// folder, whose time then changes; as that time is coarse, one look that finds nobody is only trusted after
    /// another, a moment later.
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
        let listed = names(&folder).at("list", &folder)?;
        let mut others = listed.iter().filter(|name| lease_owner(name).is_some()).map(|name| folder.join(name));
        // A file system that counts whole seconds would hide changes.
        let coarse = changed.duration_since(SystemTime::UNIX_EPOCH).is_ok_and(|time| time.subsec_nanos() == 0);
        // Another machine's lease may be hidden for a while.
        let hidden = self.network.is_some();
        let now = if coarse || hidden || others.any(|path| !self.is_own_lease(&path) && is_live(&path)) {
            Alone::default()
        } else {
            let since = since.unwrap_or_else(Instant::now);
            Alone { seen: Some((changed, since)), sure: since.elapsed() >= COARSE }
        };
        *lock(&self.alone) = now;
        self.refresh()
    }

    /// Reads what other processes have appended. Misses do this by themselves, a few times a second.
    ///
    /// # Errors
    /// When the store's folder cannot be read.
    pub fn refresh(&self) -> Result<(), CacheError> {
        *lock(&self.refreshed) = Instant::now();
        self.index_mut().refresh(&self.layout)
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
        let file = Arc::new(open_plain(&path)?);
        let mut files = lock(&self.files);
        if files.len() >= OPEN_FILES {
            files.clear();
        }
        files.insert(number, file.clone());
        Ok(file)
    }

    /// Opens a segment's file again the next time.
    pub(crate) fn forget_file(&self, number: u32) {
        lock(&self.files).remove(&number);
    }

    /// Starts a segment that this instance writes.
    pub(crate) fn start_segment(&self, sort: Sort) -> Result<Appender, CacheError> {
        let folder = self.layout.folder(sort.folder());
        // Under the lock, so that no refresh takes the new file for a stranger's.
        let mut index = self.index_mut();
        let mut seq = index.last_seq(sort).saturating_add(1);
        let (name, path, file) = loop {
            let name = sort.name(seq, &self.layout.owner);
            let path = folder.join(&name);
            match File::options().read(true).write(true).create_new(true).open(&path) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists && seq < u64::MAX => seq += 1,
                made => break (name, path.clone(), made.at("create the segment", &path)?),
            }
        };
        sync_dir(&folder).at("sync the folder of", &path)?;
        let segment = index.add_own(sort, name, path.clone());
        Ok(Appender { file: Arc::new(file), path, segment, seq, end: 0 })
    }
}

impl Writing {
    /// Takes part in the store: from here on others know of this one.
    fn begin(layout: &Layout) -> Result<Self, CacheError> {
        layout.make_folders()?;
        let lease = Lease::open(layout)?;
        layout.sign()?;
        let claims = Arc::new(Claims::open(&layout.folder("locks"))?);
        Ok(Self { lease, claims })
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
