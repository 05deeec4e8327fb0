//! The contract between the engine and node kinds.
//!
//! A *kind* is the type of a pipeline step. It declares its ports and params, and turns one [`Action`] into
//! [`Outputs`]. It receives everything that it may read: the projected params, the artifacts of its inputs, a derived
//! seed. It cannot depend on anything else, which makes the [`ActionKey`] sound.
//!
//! This crate knows no kind and no scheduler.

mod action;
mod artifact;
mod canonical;
mod context;
mod facts;
mod files;
mod key;
mod kind;
mod later;
mod media;
mod names;
mod port;
mod probe;
mod regular;
mod resources;
mod row;
mod seen;

pub use action::{Action, FILE_PORT, Outputs};
pub use artifact::{
    Artifact, ArtifactError, Collection, ItemKey, ItemKeyError, Parts, collection_digest, shard_digest,
};
pub use canonical::canonical_bytes;
pub use context::{Blobs, Context, MemoryBlobs, Progress, Silent};
pub use facts::{At, Fact, Facts, Foreseen, Known, MOST_ITEMS, Named, Outlook, Source};
pub use files::{FileTree, Files, Radiance, ReadFiles, WriteFiles};
pub use key::{ActionKey, Basis, FORMAT_VERSION, MemoKey, derive_seed};
pub use kind::{Kind, KindError, KindSpec, Mode, ParamProblem, SourceItem};
pub use later::{Before, Later, fill_in, leave_out};
pub use media::{Any, Handle, Items, Media, MediaRow, RECORD_FILE, Stored, parse_json, pretty_json};
pub use names::interned;
pub use port::{All, Determinism, Each, Group, InputPort, Out, OutputPort, Takes};
pub use probe::{Act, Look, Probe};
pub use regular::{file_digest, open_regular, read_regular};
pub use resources::Resources;
pub use row::{KindRow, NodeKind, Projection};
pub use seen::{
    Asked, CHANGED, MISSING, PROGRAM_VARIABLES, Seen, Sight, Stamp, leave_out_of_sights, left_out_of_sights,
};
pub use tauflow_cache::{Digest, ParseDigestError};
