//! Content-addressed blob store, action log, verification and garbage collection.

mod digest;
mod key;

pub use digest::{Digest, ParseDigestError};
pub use key::{Key, ParseKeyError};
