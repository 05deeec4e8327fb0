//! What the scheduler keeps of each lane: its slots, and what has come in on its inputs.

use crate::engine::{
    event::{Ended, Failure, NodeStat},
    records::{Made, Payload, Whole},
};
use std::{
    collections::{BTreeMap, HashMap, HashSet, VecDeque},
    path::PathBuf,
    sync::Arc,
};
use tauflow_cache::Digest;
use tauflow_contract::{ActionKey, Artifact, Collection, ItemKey};

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Status {
    Waiting,
    Ready,
    Running,
    /// Blobs of its inputs are missing; the next pass makes them.
    Stalled,
    Ended(Ended),
}

pub(super) struct Slot {
    pub key: Option<ItemKey>,
    pub files: Vec<(String, PathBuf)>,
    pub status: Status,
    pub made: Made,
    /// Content digest of the files outside that it read.
    pub file: Option<Digest>,
}

/// An item on its way into an input.
#[derive(Clone)]
pub(super) enum Given {
    Item(Arc<Artifact>),
    /// It failed, or is not known.
    Broken,
}

#[derive(Default)]
pub(super) struct Input {
    pub open: usize,
    pub broken: bool,
    pub given: HashMap<ItemKey, Given>,
    pub whole: Option<Arc<Whole>>,
    pub error: Option<String>,
}

pub(super) struct LaneState {
    pub slots: Vec<Slot>,
    pub index: HashMap<ItemKey, usize>,
    pub inputs: Vec<Input>,
    /// No more slots will come.
    pub known: bool,
    pub open: usize,
    pub done: bool,
    /// The items are not all known, because what names them failed.
    pub unknown: bool,
    /// Some slot did not come to outputs.
    pub failed: bool,
    pub results: BTreeMap<usize, Arc<Whole>>,
    pub rolled: Option<Payload>,
}

pub(super) enum Op {
    Give { lane: usize, input: usize, key: ItemKey, given: Given },
    FeedDone { lane: usize, input: usize, broken: bool },
    Try { lane: usize, slot: usize },
    Check { lane: usize },
}

/// A lane that ended with all its outputs.
pub struct Complete {
    /// The lane.
    pub lane: usize,
    /// Its number of actions.
    pub actions: u64,
    /// Wall time of its actions.
    pub wall_us: u64,
    /// Bytes of its outputs.
    pub bytes: u64,
}

/// What a pass leaves.
pub struct Finished {
    /// Numbers by node.
    pub stats: Vec<NodeStat>,
    /// Failures.
    pub failures: Vec<Failure>,
    /// Blobs that readers missed.
    pub missing: HashSet<Digest>,
    /// Slots that ran.
    pub ran: HashSet<(usize, Option<ItemKey>)>,
    /// Keys of slots, if they were asked for.
    pub keys: Vec<(usize, Option<ItemKey>, Ended, Box<ActionKey>)>,
}

pub(super) fn given(collection: &Collection) -> Vec<(ItemKey, Given)> {
    collection.iter().map(|(k, a)| (k.clone(), Given::Item(Arc::new(a.clone())))).collect()
}

pub(super) fn give_all(
    ops: &mut VecDeque<Op>,
    lane: usize,
    input: usize,
    prefix: Option<&str>,
    items: Vec<(ItemKey, Given)>,
) {
    for (key, given) in items {
        // A key that is too long with its prefix stays as it is; it then stands out as not found.
        let key = prefix.and_then(|p| key.in_cell(p).ok()).unwrap_or(key);
        ops.push_back(Op::Give { lane, input, key, given });
    }
}
