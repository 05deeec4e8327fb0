//! The scheduler's state of each lane: its slots, its shards, and the arrived inputs. The stages of the three are
//! written in `moves.rs` alone; `docs/ARCHITECTURE.md` draws them.

use crate::engine::{
    event::Ended,
    ids::{InputId, LaneId, PortId, Row, SlotId},
    output::Output,
    records::{Made, Payload},
    request::{Keep, Merge, Request, ShardOf, ShardRead, Todo},
    sharded::{SHARDS, Shard, Sharded},
};
use std::{
    collections::{BTreeMap, HashMap, VecDeque},
    path::PathBuf,
    sync::Arc,
};
use tauflow_cache::{Digest, Key};
use tauflow_contract::{ItemKey, SourceItem};

/// Where a lane stands.
pub(super) enum LaneStage {
    /// More slots may come.
    Filling,
    /// All slots are there.
    Full,
    /// All slots have ended.
    Done,
    /// As an earlier run left it, which its roll-up says: it has no slots.
    Rolled(Payload),
}

/// Where a shard of a lane stands.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum ShardStage {
    /// Nothing is done until all is known that it reads, or some item of that must run.
    Pending,
    /// It is being looked up as a whole.
    Sought,
    /// Item by item.
    Open,
    /// All its slots have ended, and no more will come.
    Closed,
    /// As an earlier run left it.
    Rolled,
}

/// Where a slot stands.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum SlotStage {
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

impl ShardStage {
    /// True if what it holds was, or is, handed on item by item.
    pub fn by_item(self) -> bool {
        matches!(self, Self::Open | Self::Closed)
    }

    /// True if nothing more happens to it.
    pub fn is_closed(self) -> bool {
        matches!(self, Self::Closed | Self::Rolled)
    }
}

/// How sound a lane's outputs are: it only ever gets worse.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) enum Health {
    /// Nothing is amiss so far.
    Sound,
    /// Some slot did not come to outputs.
    Failed,
    /// The items are not all known, because what names them failed.
    Unknown,
}

pub(super) struct Slot {
    pub key: Option<ItemKey>,
    pub shard: u8,
    pub stage: SlotStage,
    pub made: Made,
    /// Rarely used data of a slot.
    pub extra: Option<Box<Extra>>,
}

#[derive(Default)]
pub(super) struct Extra {
    pub files: Vec<(String, PathBuf)>,
    /// Content digest of the files outside that it read.
    pub file: Option<Digest>,
    pub todo: Option<Box<Todo>>,
}

/// The arrived inputs under an item's key.
#[derive(Clone)]
pub(super) enum Arrival {
    Item(Arc<Output>),
    /// It failed, or is not known.
    Broken,
}

#[derive(Default)]
pub(super) struct Input {
    /// Feeds that are not done.
    pub open: usize,
    /// The number of unfinished item-by-item feeds, per shard.
    pub open_shards: Row<u8, u16>,
    /// Shards whose items are being read, and how many feeds of each.
    pub reading: BTreeMap<u8, u16>,
    pub broken: bool,
    pub arrived: HashMap<ItemKey, Arrival>,
    pub whole: Option<Arc<Sharded>>,
    pub error: Option<String>,
}

impl Input {
    /// Whether more items of a shard may come.
    pub fn is_open(&self, shard: u8) -> bool {
        self.open_shards[shard] > 0 || self.reading.contains_key(&shard)
    }
}

/// The slots of a lane whose items are of one shard.
pub(super) struct ShardState {
    pub stage: ShardStage,
    pub slots: Vec<SlotId>,
    /// Slots that have not ended.
    pub open: u32,
    /// Some slot did not come to outputs.
    pub failed: bool,
    /// The items on each port, once it is closed, unless some failed.
    pub outputs: Vec<(PortId, Arc<Shard>)>,
    /// The key of its roll-up, if it was asked for.
    pub key: Option<Key>,
    /// Number, wall time and bytes of its actions, if it was rolled.
    pub totals: (u64, u64, u64),
    /// Who made what it holds, if it was rolled, came from an upstream, and has measurements beside other outputs.
    pub fetched: Option<String>,
}

/// State of a lane whose shards are looked up as a whole first.
#[derive(Default)]
pub(super) struct ByShard {
    /// Digest of all that decides a shard beside its items, once it is asked for.
    pub prefix: Option<Digest>,
    /// Digest of a source's items.
    pub listing: Option<Digest>,
}

/// Duration and output size of the lane's actions in this pass.
#[derive(Default)]
pub(super) struct Pace {
    /// Mean time, in microseconds.
    pub mean_us: Option<f64>,
    /// Mean bytes of the blobs that they put.
    pub mean_bytes: u64,
}

impl Pace {
    /// Takes one more into the means.
    pub fn note(&mut self, spent_us: u64, bytes: u64) {
        let spent = spent_us as f64;
        self.mean_us = Some(self.mean_us.map_or(spent, |mean| mean + (spent - mean) / 8.0));
        self.mean_bytes = if self.mean_bytes == 0 { bytes } else { (self.mean_bytes * 7 + bytes) / 8 };
    }
}

pub(super) struct LaneState {
    pub stage: LaneStage,
    pub health: Health,
    pub slots: Row<SlotId, Slot>,
    /// Slots by item, where an input other than the driving one gives items.
    pub index: HashMap<ItemKey, SlotId>,
    /// Slots that have not ended.
    pub open: usize,
    pub inputs: Row<InputId, Input>,
    pub shards: Row<u8, ShardState>,
    /// Shards that are not closed.
    pub open_shards: usize,
    /// Present if shards are looked up as a whole first.
    pub by_shard: Option<ByShard>,
    /// The collections of its ports, once it is done or where a reader needs one of a rolled lane.
    pub results: BTreeMap<PortId, Arc<Sharded>>,
    pub pace: Pace,
}

impl LaneState {
    /// State of a lane whose inputs have the given numbers of feeds.
    pub fn new(feeds: impl Iterator<Item = usize>) -> Self {
        let input = |feeds: usize| Input {
            open: feeds,
            open_shards: (0..SHARDS).map(|_| feeds as u16).collect(),
            ..Input::default()
        };
        let shard = |_| ShardState {
            stage: ShardStage::Open,
            slots: Vec::new(),
            open: 0,
            failed: false,
            outputs: Vec::new(),
            key: None,
            totals: (0, 0, 0),
            fetched: None,
        };
        Self {
            stage: LaneStage::Filling,
            health: Health::Sound,
            slots: Row::new(),
            index: HashMap::new(),
            open: 0,
            inputs: feeds.map(input).collect(),
            shards: (0..SHARDS).map(shard).collect(),
            open_shards: SHARDS,
            by_shard: None,
            results: BTreeMap::new(),
            pace: Pace::default(),
        }
    }

    /// Its roll-up, if it is unchanged since an earlier run.
    pub fn rolled(&self) -> Option<&Payload> {
        match &self.stage {
            LaneStage::Rolled(payload) => Some(payload),
            _ => None,
        }
    }

    /// True if nothing more happens to it.
    pub fn is_done(&self) -> bool {
        matches!(self.stage, LaneStage::Done | LaneStage::Rolled(_))
    }
}

/// The work queue, in order.
pub(super) enum Op {
    /// A feed of an input is done.
    FeedDone { lane: LaneId, input: InputId, broken: bool },
    /// A shard of a feed of an input is done.
    ShardFed { lane: LaneId, input: InputId, shard: u8 },
    /// A slot may be ready.
    Try { lane: LaneId, slot: SlotId },
    /// It may be known whether a shard as a whole was done before.
    Decide { lane: LaneId, shard: u8 },
    /// A shard may be done.
    CheckShard { lane: LaneId, shard: u8 },
    /// A lane may be done.
    Check { lane: LaneId },
}

pub(super) type Ops = VecDeque<Op>;

/// Requests that will be sent to the look-up threads.
#[derive(Default)]
pub(super) struct Asked {
    /// Whole lanes to be looked up, or listings of theirs to be read.
    pub rolled: Option<Request>,
    /// Sources to be listed.
    pub lists: VecDeque<LaneId>,
    /// Shards to be looked up.
    pub shards: BTreeMap<LaneId, Vec<(u8, ShardOf)>>,
    /// Shards to be read.
    pub reads: VecDeque<ShardRead>,
    /// Collections to be merged.
    pub merges: VecDeque<Merge>,
    /// Lanes that ended with all their outputs and are not kept yet: a lane may end before what it reads does.
    pub ended: Vec<LaneId>,
    /// Ended lanes and shards that will be stored as roll-ups.
    pub keeps: Vec<Keep>,
}

/// Work that waits until all sources are listed.
#[derive(Default)]
pub(super) struct Starting {
    /// The items of each lane that is listed.
    pub listed: BTreeMap<LaneId, Result<Vec<SourceItem>, String>>,
    /// Wall time in microseconds, and bytes, of each rolled lane.
    pub totals: Row<LaneId, (u64, u64)>,
    /// Sources that are still to be listed.
    pub open: usize,
}
