//! What carries batches to jobs, and what jobs tell back, between machines that share no files.
//!
//! The engine knows no upstream; whoever starts a run or a job brings one as a [`Courier`].

use std::fmt::Debug;
use tauflow_cache::{Key, Store};
use tauflow_contract::Digest;

/// See the module. Errors are in words.
pub trait Courier: Debug + Send + Sync {
    /// Writes a note, or replaces it.
    ///
    /// # Errors
    /// If it cannot be written.
    fn put(&self, name: &str, content: Vec<u8>) -> Result<(), String>;

    /// Reads a note, if it is there.
    ///
    /// # Errors
    /// If it cannot be read.
    fn get(&self, name: &str) -> Result<Option<Vec<u8>>, String>;

    /// Deletes notes, as far as that succeeds.
    fn delete(&self, names: &[String]);

    /// Publishes these blobs of a store, and these records with all that they reach, as far as others lack them.
    ///
    /// # Errors
    /// If they cannot be published.
    fn publish(&self, store: &Store, blobs: &[Digest], records: &[(&str, Key)]) -> Result<(), String>;

    /// Sees what others have published since.
    ///
    /// # Errors
    /// If that cannot be read.
    fn refresh(&self) -> Result<(), String>;
}
