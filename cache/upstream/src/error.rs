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
    /// The folder is no upstream.
    #[error(
        "`{dir}` is not an upstream: it has no file `UPSTREAM`. `tauflow cache push --upstream DIR` creates one in a \
        new or empty directory"
    )]
    NotUpstream {
        /// The folder.
        dir: PathBuf,
    },
    /// The upstream has a different format.
    #[error(
        "the upstream `{dir}` has format `{found}`, but this program requires `{expected}`. Choose a different \
        directory with --upstream"
    )]
    Format {
        /// The folder.
        dir: PathBuf,
        /// The content of its file `UPSTREAM`.
        found: String,
        /// The format that this version writes.
        expected: &'static str,
    },
    /// The local store failed.
    #[error(transparent)]
    Cache(#[from] CacheError),
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
