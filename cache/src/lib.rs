//! Content-addressed blob store, action log, verification and garbage collection.
//!
//! A [`Store`] keeps immutable blobs by [`Digest`] and [`Record`]s by namespace and [`Key`]. It does not know
//! pipelines, nodes or items: callers define the content of keys and the meaning of payloads.
//!
//! Guarantees:
//!
//! - A blob is returned complete or not at all. A missing or damaged blob is a miss, never an error.
//! - A record is never overwritten by another payload; that is reported.
//! - `kill -9` loses nothing that `put` and `record` returned from.
//! - After a power cut, a record is believed only if its blobs were synced before it (a commit mark says so), or prove
//!   good when read.
//! - Readers take no lock, and no process writes a file of another. (Only a `get` that misses while a gc sweeps waits
//!   until the sweep is over, at most ten seconds.)
//! - A gc never takes away what a live run relies on. (A store that is open for reading only tells nobody what it
//!   relies on: a gc beside it may turn what it reads into misses.)
//! - Nothing of others is touched. A folder is a store if it has `FORMAT`, and may become one if it is empty, or holds
//!   what an unfinished opening leaves; any other is refused. What is written, moved or deleted has a name of the
//!   store's own form and is a plain file in a folder of the store's; no link is followed, no pipe is opened.
//! - [`Store::open_existing`] makes nothing, and a store that cannot be written to is read, without a lock or a
//!   temporary file.
//! - A gc makes room before it takes any: it works on a full disk.
//! - What is read is data: sizes in records, trees, leases and index files are held against the bytes that are there
//!   before memory is taken, nothing recurses along what they say, and no such file makes this crate panic. Whoever may
//!   write to the folder may still record any outputs for a key: contents are proved, claims about them are not.
//! - A store may be told to ask [`Beyond`] for what it lacks.
//! - No clock is read: times are the callers'.
//!
//! Needs Linux: positioned reads, and locks of open file descriptions.

mod beyond;
mod blobs;
mod claim;
mod codec;
mod commit;
mod digest;
mod error;
mod gc;
mod hashed;
mod index;
mod key;
mod layout;
mod lease;
mod network;
mod pins;
mod quarantine;
mod record;
mod records;
mod segment;
mod sidecar;
mod stat;
mod store;
pub mod tree;
mod verify;
mod whole;

pub use beyond::Beyond;
pub use claim::Claim;
pub use digest::{Digest, ParseDigestError};
pub use error::CacheError;
pub use gc::{GcOptions, GcReport};
pub use key::{Key, ParseKeyError};
pub use network::{FileSystem, has_no_locks, network, rename};
pub use record::{Record, Recorded};
pub use stat::{LabelStat, Stat};
pub use store::Store;
pub use verify::VerifyReport;
