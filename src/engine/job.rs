//! Messages to worker threads and back: the task of a lane, bundles of its jobs, and replies.
//!
//! Does not know how an action is executed.

use super::{
    ids::{InputId, LaneId, PortId, SlotId},
    records::{Made, Payload},
    sharded::{Listed, Output, Sharded},
};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, path::PathBuf, sync::Arc};
use tauflow_cache::{CacheError, Digest, Key};
use tauflow_contract::{ActionKey, Artifact, Basis, ItemKey, KindSpec, NodeKind, Projection};

/// The data that all actions of a lane share.
pub struct Task {
    /// The lane.
    pub lane: LaneId,
    /// The kind.
    pub kind: Arc<dyn NodeKind>,
    /// The spec of the kind.
    pub spec: KindSpec,
    /// The group of outputs.
    pub group: &'static str,
    /// The params that each action reads.
    pub projection: Projection,
    /// The basis of its keys: everything except inputs. Params and seed differ per action.
    pub basis: Basis,
    /// It makes measurements, and must have the machine to itself.
    pub alone: bool,
    /// Its outputs are handed on in memory.
    pub transient: bool,
    /// Output ports that somebody reads.
    pub read: Vec<PortId>,
}

/// An action to be done.
pub struct Job {
    /// Which of its lane's slots it is.
    pub slot: SlotId,
    /// The item.
    pub item: Option<ItemKey>,
    /// Artifacts by input port.
    pub each: Vec<(InputId, Arc<Output>)>,
    /// Files outside, of a source's item.
    pub files: Vec<(String, PathBuf)>,
    /// The result of its look-up.
    pub todo: Option<Box<Todo>>,
}

/// Actions of one lane that are done together.
pub struct Bundle {
    /// The lane's.
    pub task: Arc<Task>,
    /// Collections by input port, the same for all.
    pub whole: Vec<(InputId, Arc<Sharded>)>,
    /// The actions.
    pub jobs: Vec<Job>,
}

/// An action that has been looked up and must run.
pub struct Todo {
    /// Its key.
    pub key: ActionKey,
    /// The key's hash.
    pub hash: Key,
    /// The files outside that it reads.
    pub file: Option<Artifact>,
    /// Its recorded outputs, if it runs only for comparison.
    pub before: Option<Made>,
}

impl Todo {
    /// An action that is known by its key; `before` is what it gave, if it runs only to be compared.
    pub fn new(key: ActionKey, file: Option<Artifact>, before: Option<Made>) -> Self {
        Self { hash: key.hash(), key, file, before }
    }
}

/// The inputs of an action; its key contains only their digests.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActionInputs {
    /// The item.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub item: Option<ItemKey>,
    /// Artifacts by input port; the files outside of a source's item are on the port `file`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub each: BTreeMap<String, Artifact>,
    /// Collections by input port.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub whole: BTreeMap<String, Listed>,
}

/// The outcome of an action.
pub enum Outcome {
    /// It was done before.
    Hit(Made),
    /// It was done now.
    Ran(Made),
    /// It must run.
    Todo(Box<Todo>),
    /// It would be done, in a dry run.
    WouldRun,
    /// It failed.
    Failed(String),
    /// This blob of its inputs is missing; the reply names the others that are.
    Missing(Digest),
    /// The run is being stopped.
    Cancelled,
    /// The store failed: the run must stop.
    Fatal(CacheError),
}

/// The outcome of an action, and messages for the user.
pub struct Reply {
    /// Its lane and slot.
    pub slot: (LaneId, SlotId),
    /// Its outcome.
    pub outcome: Outcome,
    /// Its key, if keys are kept and it came that far.
    pub key: Option<Box<ActionKey>>,
    /// Content digest of the files outside that it read.
    pub file: Option<Digest>,
    /// Other missing inputs, if any.
    pub missing: Vec<Digest>,
    /// In a dry run: it has been done before, and what it gave is lost.
    pub lost: bool,
    /// A remark, such as two outputs for one key.
    pub warning: Option<String>,
    /// Its duration in this run, in microseconds.
    pub spent_us: u64,
}

impl Reply {
    /// An outcome without more.
    pub fn of(slot: (LaneId, SlotId), outcome: Outcome) -> Self {
        Self { slot, outcome, key: None, file: None, missing: Vec::new(), lost: false, warning: None, spent_us: 0 }
    }
}

/// The outputs of an action before they are recorded.
pub struct Produced {
    /// Its record.
    pub payload: Payload,
    /// Its collections by port.
    pub collections: Vec<(PortId, Arc<Sharded>)>,
    /// Bytes of the blobs that it put.
    pub put: u64,
}
