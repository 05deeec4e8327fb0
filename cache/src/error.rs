//! Every error of the store, as message, place and advice.
//!
//! A damaged or missing blob is not an error: it is a miss.  What is left are
//! the environment (disk, permissions) and misuse.

use crate::Key;
use std::{
    io,
    path::{Path, PathBuf},
};

/// Why the store could not do what was asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CacheError {
    /// The operating system refused: a full disk, missing permissions, a broken device.
    #[error("cannot {action} `{path}`: {source}. {}", advice(.source))]
    Io {
        /// What was being done, as a verb phrase: `write the blob`.
        action: &'static str,
        /// The file or folder it was done to.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// The folder is a store of another format, or not a store.
    #[error(
        "`{dir}` holds a cache of format `{found}`, and this program reads `{expected}`. \
         Choose another folder with --cache, or remove this one"
    )]
    Format {
        /// The store's folder.
        dir: PathBuf,
        /// What its FORMAT file says.
        found: String,
        /// What this version writes.
        expected: &'static str,
    },
    /// A thread claims a key that it holds already; waiting would never end.
    #[error("action {key} is claimed twice by one thread. Drop the first claim before the second")]
    ClaimedTwice {
        /// The key.
        key: Key,
    },
    /// A pin's name cannot be a file name.
    #[error("`{name}` cannot name a pin. Use 1 to 100 letters, digits, `-`, `_` or `.`, not starting with a `.`")]
    PinName {
        /// The name.
        name: String,
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
        matches!(self, Self::Io { .. } | Self::Format { .. })
    }

    /// Whether the disk, the quota or the file size limit is exhausted.
    pub fn is_full(&self) -> bool {
        matches!(self, Self::Io { source, .. } if full(source))
    }
}

fn full(source: &io::Error) -> bool {
    use io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
    matches!(source.kind(), StorageFull | QuotaExceeded | FileTooLarge)
}

fn advice(source: &io::Error) -> &'static str {
    use io::ErrorKind::{AlreadyExists, NotADirectory, PermissionDenied, ReadOnlyFilesystem};
    match source.kind() {
        _ if full(source) => {
            "The disk is full: free some space (`tauflow cache gc --max-bytes N`) or choose another disk with \
             --cache, then run again; everything recorded so far is kept"
        }
        PermissionDenied | ReadOnlyFilesystem => {
            "The cache must be writable: choose another folder with --cache, or mend its permissions"
        }
        NotADirectory | AlreadyExists => "A file is in the way: choose another folder with --cache",
        _ => "Check the disk and the folder's permissions, or choose another folder with --cache",
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
