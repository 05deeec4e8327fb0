//! The contract between the engine and node kinds.
//!
//! A *kind* is a sort of pipeline step. It states its ports and params, and turns one [`Action`] into
//! [`Outputs`]. It is handed everything it may read: the params projected onto this action, the artifacts of its
//! inputs, a derived seed. What it is not handed it cannot depend on, which is what makes the [`ActionKey`] sound.
//!
//! This crate knows no kind and no scheduler.

mod artifact;
mod context;
mod key;
mod kind;

pub use artifact::{Artifact, Collection, ItemKey, ItemKeyError, Parts, collection_digest, shard_digest};
pub use context::{Blobs, Context, MemoKey, MemoryBlobs, Progress, Silent};
pub use key::{ActionKey, FORMAT_VERSION, canonical_bytes, derive_seed};
pub use kind::{
    Action, Determinism, Feed, InputPort, Kind, KindError, KindRow, KindSpec, Mode, NodeKind, OutputPort, Outputs,
    ParamProblem, Projection, SourceItem,
};
pub use tauflow_cache::{Digest, ParseDigestError};
