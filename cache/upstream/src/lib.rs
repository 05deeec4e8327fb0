//! Upstreams: folders through which several machines share results.
//!
//! [`push`] copies records and their blobs from a store to an upstream, and [`pull`] copies them back. A [`Reader`]
//! answers a store that lacks something, without copying the rest.
//!
//! An upstream holds immutable files whose names are the digests of their contents. So machines may write at the same
//! time without locks, and a stale directory listing only hides new files:
//!
//! ```text
//! UPSTREAM                   format version
//! packs/<hash>-<size>.pack   blobs, one after the other
//! packs/<hash>-<size>.index  lines of JSON: the pack, places of its blobs, and records
//! tmp/                       files that are being written
//! ```
//! A pack is complete before its index is visible, and records come after the packs that hold their blobs.
//!
//! Everything that comes down is hashed again. A damaged index, pack or blob is a miss with a note. Whoever may write
//! to an upstream may claim any outputs for a key: contents are verified, claims are not.
//!
//! Knows records and blobs, but no pipeline.

mod copy;
mod error;
mod folder;
mod index;
mod reader;

pub use copy::{Pulled, Pushed, Wanted, all, pull, push};
pub use error::UpstreamError;
pub use folder::Upstream;
pub use index::Contents;
pub use reader::{Listener, Opening, Reader};
