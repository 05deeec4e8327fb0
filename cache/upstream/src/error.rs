//! All errors of an upstream, each with message, place and remedy. Damage is no error: it is a miss with a note.

use std::{
    io,
    path::{Path, PathBuf},
};
use tauflow_cache::CacheError;

/// Why nothing could be copied.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UpstreamError {
    /// The operating system refused.
    #[error("cannot {action} `{path}`: {source}. Check that the upstream is mounted and that you have permission")]
    Io {
        /// The attempted action, as a verb phrase.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// An object store or web server refused, or cannot be reached.
    #[error("cannot {action} `{place}`: {why}")]
    Remote {
        /// The attempted action, as a verb phrase.
        action: &'static str,
        /// The URL of the upstream.
        place: String,
        /// The cause, with a remedy where there is one.
        why: String,
    },
    /// The upstream that was named is no directory and no usable URL.
    #[error("the upstream is not usable: {why}")]
    Address {
        /// The cause.
        why: String,
    },
    /// The folder is no upstream.
    #[error(
        "`{place}` is not an upstream: it has no file `UPSTREAM`. `tauflow cache push --upstream PLACE` creates one in \
        a new or empty directory, or under a new prefix"
    )]
    NotUpstream {
        /// The folder, or the URL.
        place: String,
    },
    /// The upstream has a different format.
    #[error(
        "the upstream `{place}` has format `{found}`, but this program requires `{expected}`. Choose a different \
        place with --upstream"
    )]
    Format {
        /// The folder, or the URL.
        place: String,
        /// The content of its file `UPSTREAM`.
        found: String,
        /// The format that this version writes.
        expected: &'static str,
    },
    /// A key cannot be used.
    #[error("the {what} is not usable: {why}")]
    Key {
        /// Which sort of key.
        what: &'static str,
        /// The cause.
        why: String,
    },
    /// The local store failed.
    #[error(transparent)]
    Cache(#[from] CacheError),
}

/// Why a file of an upstream cannot be had.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Failure {
    /// This file alone is missing or damaged: a sentence.
    File(String),
    /// This index is sound, and not signed by the key to which the upstream is pinned: a sentence.
    Unsigned(String),
    /// The upstream cannot be reached: a sentence.
    #[cfg_attr(not(feature = "objects"), expect(dead_code, reason = "only object stores and web servers give it"))]
    Place(String),
}

impl Failure {
    /// The sentence.
    pub fn note(self) -> String {
        match self {
            Self::File(note) | Self::Unsigned(note) | Self::Place(note) => note,
        }
    }
}

/// Adds what was attempted, and where.
pub(crate) trait At<T> {
    fn at(self, action: &'static str, path: &Path) -> Result<T, UpstreamError>;
}

impl<T> At<T> for io::Result<T> {
    fn at(self, action: &'static str, path: &Path) -> Result<T, UpstreamError> {
        self.map_err(|source| UpstreamError::Io { action, path: path.to_owned(), source })
    }
}
