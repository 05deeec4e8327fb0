//! All errors of the store, each with message, place and remedy.
//!
//! A damaged or missing blob is not an error: it is a miss. The remaining errors are of the environment (disk,
//! permissions), or misuse.

use crate::Key;
use std::{
    io,
    path::{Path, PathBuf},
    sync::Arc,
};

/// Why the store could not do what was asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CacheError {
    /// The operating system refused: a full disk, missing permissions, a broken device.
    #[error("cannot {action} `{path}`: {source}. {}", advice(.source))]
    Io {
        /// The attempted action, as a verb phrase: `write the blob`.
        action: &'static str,
        /// The file or folder it was done to.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The folder is a store of another format, or not a store.
    #[error(
        "the cache `{dir}` has format `{found}`, but this program requires `{expected}`. Choose a different directory \
        with --cache, or delete this one"
    )]
    Format {
        /// The store's folder.
        dir: PathBuf,
        /// The content of its FORMAT file.
        found: String,
        /// The format that this version writes.
        expected: &'static str,
    },
    /// The folder is no store, and holds something already: nothing of others is touched.
    #[error(
        "`{dir}` is not a cache: it has no file `FORMAT`, but contains `{found}`. Choose a cache or an empty \
        directory with --cache"
    )]
    Foreign {
        /// The folder.
        dir: PathBuf,
        /// A path within the folder that it contains.
        found: PathBuf,
    },
    /// A link or a file lies where the store has a folder; what is behind a link is of others.
    #[error(
        "`{path}` is a link or a file, but must be a directory; links inside a cache are not followed. Restore the \
        directory (the cache itself may be a link), or choose a different cache with --cache"
    )]
    InTheWay {
        /// Where the folder should be.
        path: PathBuf,
    },
    /// Something was to be written to a store that can only be read.
    #[error("the cache `{dir}` is read-only, but this command must write to it: {why}")]
    ReadOnly {
        /// The store's folder.
        dir: PathBuf,
        /// The error of opening it for writing.
        why: Arc<CacheError>,
    },
    /// Something was to be written to a folder that was opened to be looked at, and that is no store yet.
    #[error("no cache in `{dir}`; `tauflow run` creates one. --cache selects a different directory")]
    NotMade {
        /// The folder.
        dir: PathBuf,
    },
    /// The records of this store reach more than a collection can hold in memory.
    #[error(
        "the records of the cache `{dir}` refer to more than {limit} blobs, which no run produces. Choose a different \
        cache with --cache, and delete this one if you do not trust its origin"
    )]
    TooManyReached {
        /// The store's folder.
        dir: PathBuf,
        /// The largest number accepted.
        limit: u64,
    },
    /// A thread claims a key that it holds already; waiting would never end.
    #[error("action {key} is claimed twice by one thread. Drop the first claim before the second")]
    ClaimedTwice {
        /// The key.
        key: Key,
    },
    /// A pin's name cannot be a file name.
    #[error(
        "`{name}` is not a valid name of a pin. Use 1 to 100 letters, digits, `-`, `_` or `.`, not starting with a `.`"
    )]
    PinName {
        /// The name.
        name: String,
    },
    /// A collection cannot tell which processes use the store.
    #[error(
        "the file system of the cache `{dir}` refuses locks, so that `cache gc` cannot see which processes use it. \
        Mount it with locks (NFS: version 4, without `nolock`), or run `cache gc` on the machine that has the disk"
    )]
    NoLocks {
        /// The store's folder.
        dir: PathBuf,
    },
    /// A record does not fit the log's frame.
    #[error("the record of action {key} has {bytes} bytes, more than {limit}. Put large outputs into blobs")]
    RecordTooLarge {
        /// The record's key.
        key: Key,
        /// Its encoded size.
        bytes: u64,
        /// The largest size accepted.
        limit: u64,
    },
}

impl CacheError {
    /// Whether the cause is the environment (disk, permissions) and not a mistake of the program.
    pub fn is_environment(&self) -> bool {
        !matches!(self, Self::ClaimedTwice { .. } | Self::PinName { .. } | Self::RecordTooLarge { .. })
    }

    /// Whether the disk, the quota or the file size limit is exhausted.
    pub fn is_full(&self) -> bool {
        match self {
            Self::Io { source, .. } => full(source),
            Self::ReadOnly { why, .. } => why.is_full(),
            _ => false,
        }
    }

    /// Whether the operating system did not allow it: permissions, a disk mounted for reading.
    pub fn is_refused(&self) -> bool {
        match self {
            Self::Io { source, .. } => refused(source),
            Self::ReadOnly { why, .. } => why.is_refused(),
            _ => false,
        }
    }
}

fn full(source: &io::Error) -> bool {
    use io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
    matches!(source.kind(), StorageFull | QuotaExceeded | FileTooLarge)
}

fn refused(source: &io::Error) -> bool {
    use io::ErrorKind::{PermissionDenied, ReadOnlyFilesystem};
    matches!(source.kind(), PermissionDenied | ReadOnlyFilesystem)
}

fn advice(source: &io::Error) -> &'static str {
    use io::ErrorKind::{AlreadyExists, NotADirectory, PermissionDenied};
    match source.kind() {
        _ if full(source) => {
            "The disk is full: free some space (`tauflow cache gc --max-size 20GiB`) or choose a different disk with \
            --cache, then run again; recorded results are kept"
        }
        PermissionDenied => {
            "The cache must be writable: choose a different directory with --cache, or fix its permissions. Users who \
            share a cache need a common group: `chgrp -R GROUP DIR`, `chmod -R g+rwX DIR`, `find DIR -type d -exec \
             chmod g+s {} +`, and `umask 002` for each of them"
        }
        _ if refused(source) => {
            "The cache must be writable: choose a different directory with --cache, or mount it for writing"
        }
        NotADirectory | AlreadyExists => {
            "A file has the name of a required directory: choose a different directory with --cache"
        }
        _ => "Check the disk and the permissions of the directory, or choose a different one with --cache",
    }
}

/// Attaches the action and the path to an I/O error.
pub(crate) trait At<T> {
    fn at(self, action: &'static str, path: &Path) -> Result<T, CacheError>;
}

impl<T> At<T> for io::Result<T> {
    fn at(self, action: &'static str, path: &Path) -> Result<T, CacheError> {
        self.map_err(|source| CacheError::Io { action, path: path.to_owned(), source })
    }
}
