//! What the scheduler keeps of each lane: its slots, its shards, and what has come in on its inputs.

use crate::engine::{
    event::{Ended, Failure, Name, NodeStat, Slow},
    records::{Made, Payload},
    whole::{Output, Part, SHARDS, Whole},
    work::Todo,
};
use std::{
    collections::{BTreeMap, HashMap, HashSet, VecDeque},
    path::PathBuf,
    sync::Arc,
};
use tauflow_cache::{Digest, Key};
use tauflow_contract::{ActionKey, ItemKey};

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Status {
    Waiting,
    /// To be looked up.
    Ready,
    /// Being looked up.
    Sought,
    /// To be run.
    Todo,
    Running,
    /// Blobs of its inputs are missing; the next pass makes them.
    Stalled,
    Ended(Ended),
}

pub(super) struct Slot {
    pub key: Option<ItemKey>,
    pub shard: u8,
    pub status: Status,
    pub made: Made,
    /// What few slots have.
    pub extra: Option<Box<Extra>>,
}

#[derive(Default)]
pub(super) struct Extra {
    pub files: Vec<(String, PathBuf)>,
    /// Content digest of the files outside that it read.
    pub file: Option<Digest>,
    pub todo: Option<Box<Todo>>,
}

/// An item on its way into an input.
#[derive(Clone)]
pub(super) enum Given {
    Item(Arc<Output>),
    /// It failed, or is not known.
    Broken,
}

#[derive(Default)]
pub(super) struct Input {
    /// Feeds that are not done.
    pub open: usize,
    /// Of the feeds that give item by item, those that are not done, for each shard.
    pub open_shards: Vec<u16>,
    pub broken: bool,
    pub given: HashMap<ItemKey, Given>,
    pub whole: Option<Arc<Whole>>,
    pub error: Option<String>,
}

/// Where a shard of a lane stands.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Stage {
    /// Nothing is done until it is known whether the shard as a whole was done before.
    Pending,
    /// Item by item.
    Open,
    /// As an earlier run left it.
    Rolled,
}

/// The slots of a lane whose items are of one shard.
pub(super) struct Shard {
    pub stage: Stage,
    pub slots: Vec<u32>,
    /// Slots that have not ended.
    pub open: u32,
    /// All is done.
    pub closed: bool,
    /// Some slot did not come to outputs.
    pub failed: bool,
    /// The items on each port, once it is closed, unless some failed.
    pub parts: Vec<(usize, Arc<Part>)>,
    /// The key of its roll-up, if it was asked for.
    pub key: Option<Key>,
    /// Number, wall time and bytes of its actions, if it was rolled.
    pub totals: (u64, u64, u64),
}

pub(super) struct LaneState {
    pub slots: Vec<Slot>,
    /// Slots by item, where an input other than the driving one gives items.
    pub index: HashMap<ItemKey, u32>,
    pub inputs: Vec<Input>,
    pub shards: Vec<Shard>,
    /// Shards are looked up as wholes before their items are.
    pub by_shard: bool,
    /// Digest of all that decides a shard beside its items.
    pub prefix: Option<Digest>,
    /// Digest of a source's items, if they are many.
    pub listing: Option<Digest>,
    /// Shards that are not closed.
    pub open_shards: usize,
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
    /// Mean bytes of its actions' outputs, as far as they ran in this pass.
    pub mean_bytes: u64,
    /// Mean time of its actions, in microseconds, as far as they ran in this pass.
    pub mean_us: Option<f64>,
}

impl LaneState {
    pub fn new(feeds: impl Iterator<Item = usize>, rolled: Option<Payload>) -> Self {
        let input = |feeds: usize| Input { open: feeds, open_shards: vec![feeds as u16; SHARDS], ..Input::default() };
        let shard = |_| Shard {
            stage: Stage::Open,
            slots: Vec::new(),
            open: 0,
            closed: false,
            failed: false,
            parts: Vec::new(),
            key: None,
            totals: (0, 0, 0),
        };
        Self {
            slots: Vec::new(),
            index: HashMap::new(),
            inputs: feeds.map(input).collect(),
            shards: (0..SHARDS).map(shard).collect(),
            by_shard: false,
            prefix: None,
            listing: None,
            open_shards: SHARDS,
            known: false,
            open: 0,
            done: false,
            unknown: false,
            failed: false,
            results: BTreeMap::new(),
            rolled,
            mean_bytes: 0,
            mean_us: None,
        }
    }
}

/// What is to be seen to, in order.
pub(super) enum Op {
    /// A feed of an input is done.
    FeedDone { lane: usize, input: usize, broken: bool },
    /// A shard of a feed of an input is done.
    ShardFed { lane: usize, input: usize, shard: u8 },
    /// A slot may be ready.
    Try { lane: usize, slot: usize },
    /// It may be known whether a shard as a whole was done before.
    Decide { lane: usize, shard: u8 },
    /// A shard may be done.
    CheckShard { lane: usize, shard: u8 },
    /// A lane may be done.
    Check { lane: usize },
}

pub(super) type Ops = VecDeque<Op>;

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

/// A shard that ended with all its outputs.
pub struct CompleteShard {
    /// Its lane.
    pub lane: usize,
    /// Key of its roll-up.
    pub key: Key,
    /// Its items by output port.
    pub parts: Vec<(usize, Arc<Part>)>,
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
    /// The actions that took longest.
    pub slowest: Vec<Slow>,
}

/// The names of a lane, as events say them.
pub(super) struct Names {
    pub node: Name,
    pub cell: Name,
    pub group: Name,
}
