//! Upstreams: directories and object stores through which several machines share results.
//!
//! [`push`] copies records and their blobs from a store to an upstream, and [`pull`] copies them back. A [`Reader`]
//! answers a store that lacks something, without copying the rest.
//!
//! An upstream holds immutable files whose names are the digests of their contents. So machines may write at the same
//! time without locks, and a stale directory listing only hides new files:
//!
//! ```text
//! UPSTREAM                   format version
//! LIST                       names of the indices, for web servers, which cannot list
//! packs/<hash>-<size>.pack   blobs, one after the other
//! packs/<hash>-<size>.index  lines of JSON: the pack, places of its blobs, and records
//! jobs/                      notes between a run and its jobs, if they share nothing else
//! tmp/                       files that are being written (in directories only)
//! ```
//! A pack is complete before its index is visible, and records come after the packs that hold their blobs.
//!
//! Everything that comes down is hashed again. A damaged index, pack or blob is a miss with a note. Whoever may write
//! to an upstream may claim any outputs for a key: contents are verified, claims are not. An upstream that is pinned to
//! a public key serves only indices with a signature of that key, `packs/<hash>-<size>.index.minisig`.
//!
//! Knows records and blobs, but no pipeline.

#[cfg(feature = "objects")]
mod http;
#[cfg(not(feature = "objects"))]
#[path = "absent.rs"]
mod objects;
#[cfg(feature = "objects")]
mod objects;
#[cfg(feature = "objects")]
mod parts;

mod address;
mod copy;
mod error;
mod folder;
mod index;
mod places;
mod reader;
mod sender;
mod sign;
mod traffic;
mod upstream;

pub use address::{Address, ObjectsAt};
pub use copy::{Pulled, Pushed, Wanted, all, pull, push};
pub use error::UpstreamError;
pub use index::Contents;
pub use reader::{Listener, Opening, Reader};
pub use sender::Sender;
pub use sign::{PublicKey, SecretKey};
pub use traffic::{Traffic, reads};
pub use upstream::Upstream;
