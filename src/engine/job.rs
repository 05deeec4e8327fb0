//! What is handed to the look-up threads and back.
//!
//! Knows nothing of how an action is looked up or executed.

use super::{
    event::Name,
    execute::{Producer, Whole},
    ids::{InputId, LaneId, SlotId},
    records::Made,
    sharded::Output,
};
use std::{path::PathBuf, sync::Arc};
use tauflow_cache::{CacheError, Digest, Key};
use tauflow_contract::{ActionKey, Artifact, Basis, ItemKey, Projection};

/// A lane as events name it.
#[derive(Clone)]
pub struct Label {
    /// The node.
    pub node: Name,
    /// The cell, or empty.
    pub cell: Name,
}

/// What all actions of a lane share.
pub struct Task {
    /// The lane.
    pub lane: LaneId,
    /// What it is called.
    pub label: Label,
    /// What makes the outputs.
    pub producer: Arc<Producer>,
    /// The params that each action reads.
    pub projection: Projection,
    /// What decides its outputs beside what they read; of params and seed, each action has its own.
    pub basis: Basis,
    /// It makes measurements, and must have the machine to itself.
    pub alone: bool,
}

/// An action to be looked up.
pub struct LookUp {
    /// Which of its lane's slots it is.
    pub slot: SlotId,
    /// The item.
    pub item: Option<ItemKey>,
    /// Artifacts by input port.
    pub each: Vec<(InputId, Arc<Output>)>,
    /// Files outside, of a source's item.
    pub files: Vec<(String, PathBuf)>,
}

/// Actions of one lane that are looked up together.
pub struct LookUps {
    /// The lane's.
    pub task: Arc<Task>,
    /// Collections by input port, the same for all.
    pub whole: Arc<Whole>,
    /// The actions.
    pub actions: Vec<LookUp>,
}

/// An action that has been looked up and must run.
pub struct Todo {
    /// Its key.
    pub key: ActionKey,
    /// The key's hash.
    pub hash: Key,
    /// The files outside that it reads.
    pub file: Option<Artifact>,
    /// What it gave before, if it runs only to be compared.
    pub before: Option<Made>,
}

/// What a look-up found.
pub enum Standing {
    /// The action was done before.
    Hit(Made),
    /// It must run.
    Todo(Box<Todo>),
    /// It would run, in a dry run.
    WouldRun {
        /// It has been done before, and its outputs are lost.
        lost: bool,
        /// Inputs of which blobs are not there.
        gone: Vec<InputId>,
    },
    /// It has no key: its files cannot be read, or its kind is at fault.
    Failed(String),
    /// The store failed: the run must stop.
    Fatal(CacheError),
}

/// What is known of an action after its look-up.
pub struct LookedUp {
    /// Its lane and slot.
    pub slot: (LaneId, SlotId),
    /// What was found.
    pub standing: Standing,
    /// Its key, if keys are kept and it came that far.
    pub key: Option<Box<ActionKey>>,
    /// Content digest of the files outside that it reads.
    pub file: Option<Digest>,
}

impl LookedUp {
    /// What was found, without more.
    pub fn of(slot: (LaneId, SlotId), standing: Standing) -> Self {
        Self { slot, standing, key: None, file: None }
    }
}
