//! What a scheduler asks of the look-up threads, and what they answer. Everything that reads or writes the store, lists
//! files or runs a kind's code for it is asked for here.
//!
//! Knows nothing of how an answer is found.

use super::{
    EngineError,
    event::Name,
    execute::{Producer, Whole},
    ids::{Id, InputId, LaneId, PortId, Row, SlotId},
    lanes::{Lane, LaneBasis, LaneFeed, Lanes, ReadingPort, target_ports},
    measured::{Fetched, Measured, is_mixed},
    output::Output,
    records::{Made, Payload},
    sharded::{Here, Listed, Shard, Sharded},
};
use crate::pipeline::Pipeline;
use serde_json::Value;
use std::{path::PathBuf, sync::Arc};
use tauflow_cache::{Digest, Key};
use tauflow_contract::{ActionKey, Artifact, Determinism, ItemKey, NodeKind, Projection, SourceItem};

/// A request of the scheduler.
pub enum Request {
    /// List the items of a source, in order.
    List {
        /// Its lane.
        lane: LaneId,
        /// Its kind.
        kind: Arc<dyn NodeKind>,
        /// Its params.
        params: Value,
    },
    /// Look up whole lanes.
    Lanes(Vec<LaneLookUp>),
    /// Read the listings of lanes that were found.
    Listings(Vec<LaneListing>),
    /// Look up actions.
    Actions(LookUps),
    /// Look up shards of a lane as wholes.
    Shards(ShardLookUps),
    /// Read the listings of shards.
    Read(Vec<ShardRead>),
    /// Merge the collections on an input.
    Merge(Merge),
    /// Keep roll-ups.
    Keep(Vec<Keep>),
}

/// The answer to a [`Request`].
pub enum Response {
    /// The items of a source.
    Listed {
        /// Its lane.
        lane: LaneId,
        /// The items, or why there are none.
        items: Result<Vec<SourceItem>, String>,
    },
    /// The lanes that an earlier run left whole, of those that were asked for.
    Lanes(Vec<LaneFound>),
    /// Collections by lane and port; none where the listing is missing.
    Listings(Vec<ListingRead>),
    /// The results of looking up actions.
    Actions(Vec<LookedUp>),
    /// The results of looking up shards of a lane.
    Shards {
        /// The lane.
        lane: LaneId,
        /// The shards that were asked for.
        found: Vec<ShardFound>,
    },
    /// Shards that have their items now, or the blobs that list them and are missing.
    Read(Vec<(ShardRead, Here<()>)>),
    /// The collection on an input.
    Merged {
        /// The lane.
        lane: LaneId,
        /// Its input.
        input: InputId,
        /// The collection, or why there is none.
        merged: Merged,
    },
    /// Roll-ups are kept.
    Kept,
    /// The store failed: the run must stop.
    Fatal(EngineError),
}

/// A lane that is looked up as a whole.
pub struct LaneLookUp {
    /// The lane's.
    pub task: Arc<Task>,
    /// The key, or the data from which it is computed.
    pub of: LaneOf,
    /// The ports that an answer must fill.
    pub ports: Vec<PortId>,
}

/// The key of a lane, or the data from which it is computed.
pub enum LaneOf {
    /// Its key.
    Key(Key),
    /// The params of a source, whose items are listed now, and what else decides its outputs.
    Source(Value, LaneBasis),
}

/// A lane as an earlier run left it.
pub struct LaneFound {
    /// The lane.
    pub lane: LaneId,
    /// Its key.
    pub key: Key,
    /// Its outputs.
    pub payload: Payload,
    /// Wall time in microseconds, and bytes.
    pub totals: (u64, u64),
}

/// The listing of a port of a lane that was found.
pub struct LaneListing {
    /// The lane.
    pub lane: LaneId,
    /// The port.
    pub port: PortId,
    /// Its listing.
    pub listed: Listed,
    /// The media type of its items.
    pub media: &'static str,
}

/// The collection of a lane's port; none if its listing is missing.
pub type ListingRead = (LaneId, PortId, Option<Arc<Sharded>>);

/// Shards of one lane that are looked up together.
pub struct ShardLookUps {
    /// The lane's.
    pub task: Arc<Task>,
    /// The shards by number.
    pub shards: Vec<(u8, ShardOf)>,
}

/// The key of a shard, or the data from which it is computed.
pub enum ShardOf {
    /// Its key.
    Key(Key),
    /// The items of a source, and the digest of what decides all shards of its lane.
    Items(Digest, Vec<ItemKey>),
}

/// The result of looking up a shard.
pub struct ShardFound {
    /// Its number.
    pub shard: u8,
    /// Its key.
    pub key: Key,
    /// The items that it was asked by.
    pub items: Vec<ItemKey>,
    /// The outputs of an earlier run, if there are any.
    pub rolled: Option<RolledShard>,
}

/// A shard as an earlier run left it.
pub struct RolledShard {
    /// Its items by output port.
    pub outputs: Vec<(PortId, Arc<Shard>)>,
    /// Number, wall time and bytes of its actions.
    pub totals: (u64, u64, u64),
    /// As in [`Keep`].
    pub fetched: Option<String>,
}

/// A shard whose items somebody needs one by one.
pub struct ShardRead {
    /// Who.
    pub reader: ReadingPort,
    /// Its number.
    pub number: u8,
    /// The shard.
    pub shard: Arc<Shard>,
}

/// Collections that meet on an input.
pub struct Merge {
    /// The lane.
    pub lane: LaneId,
    /// Its input.
    pub input: InputId,
    /// The name of the port.
    pub port: String,
    /// Each with what is put before its keys.
    pub feeds: Vec<(Option<String>, Arc<Sharded>)>,
}

/// The result of a [`Merge`].
pub enum Merged {
    /// All of them.
    Whole(Arc<Sharded>),
    /// They do not go together.
    Failed(String),
    /// These blobs, which list items, are missing.
    Missing(Vec<Digest>),
}

/// A lane or shard that ended with all its outputs, and is stored as a roll-up.
pub struct Keep {
    /// The namespace of its record.
    pub namespace: &'static str,
    /// Its key.
    pub key: Key,
    /// The key as text, for people; may be empty.
    pub preimage: String,
    /// The kind.
    pub kind: String,
    /// Its outputs by port.
    pub outputs: Vec<(String, Rolling)>,
    /// Number, wall time and bytes of its actions.
    pub totals: (u64, u64, u64),
    /// Its outputs need not be stored.
    pub transient: bool,
    /// Who made what it holds, if measurements of another machine are among it: it counts as those do.
    pub fetched: Option<String>,
}

/// An output of a roll-up.
pub enum Rolling {
    /// The collection of a lane.
    Lane(Arc<Sharded>),
    /// The items of a shard.
    Shard(Arc<Shard>),
}

/// A lane as events name it.
#[derive(Clone)]
pub struct LaneName {
    /// The node.
    pub node: Name,
    /// The cell, or empty.
    pub cell: Name,
}

/// Data that all actions of a lane share.
pub struct Task {
    /// The lane.
    pub lane: LaneId,
    /// Its name.
    pub label: LaneName,
    /// The kind and output group that make the outputs.
    pub producer: Arc<Producer>,
    /// The params that each action reads.
    pub projection: Projection,
    /// Everything that determines its outputs, except inputs and params; each action has its own params.
    pub basis: LaneBasis,
    /// It makes measurements, and must have the machine to itself.
    pub alone: bool,
    /// The machine that measured, if its measurements are only taken: what it has not measured fails.
    pub only_there: Option<Arc<str>>,
    /// Its actions run programs outside.
    pub programs: bool,
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
    /// Its earlier outputs, if it runs only to be compared.
    pub before: Option<Made>,
}

/// The result of looking up an action.
pub enum Finding {
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
}

/// The result of looking up an action, with its key.
pub struct LookedUp {
    /// Its lane and slot.
    pub slot: (LaneId, SlotId),
    /// The result.
    pub standing: Finding,
    /// Its key, if keys are kept and it came that far.
    pub key: Option<Box<ActionKey>>,
    /// Content digest of the files outside that it reads.
    pub file: Option<Digest>,
}

impl LookedUp {
    /// A result without a key.
    pub fn of(slot: (LaneId, SlotId), standing: Finding) -> Self {
        Self { slot, standing, key: None, file: None }
    }
}

/// The data that the actions of each lane share.
pub fn tasks(pipeline: &Pipeline, lanes: &Lanes, measured: &Measured) -> Row<LaneId, Arc<Task>> {
    // Whether what a lane reads may be other content on another machine.
    let mut unlike: Row<LaneId, bool> = Row::new();
    for lane in lanes {
        // A lane stands after all that it reads.
        let is_unlike = |feed: &LaneFeed| {
            let spec = &pipeline.nodes[lanes[feed.lane].node].spec;
            unlike[feed.lane] || spec.outputs[feed.port.place()].determinism != Determinism::Bitwise
        };
        let reads_unlike = lane.inputs.iter().flatten().any(is_unlike);
        unlike.push(reads_unlike);
    }
    let bound = |id: LaneId, lane: &Lane| unlike[id] || lane.basis.names_environment();
    lanes.pairs().map(|(id, lane)| Arc::new(task(pipeline, lanes, measured, (id, lane, bound(id, lane))))).collect()
}

/// Which records of an upstream count for the actions of a lane, of which these ports are read.
fn fetched(pipeline: &Pipeline, lane: &Lane, read: &[PortId], measured: &Measured) -> Fetched {
    let (spec, asked) = (&pipeline.nodes[lane.node].spec, pipeline.targets.iter().filter(|of| of.node == lane.node));
    let asked: Vec<PortId> = asked.flat_map(|target| target_ports(pipeline, *target)).collect();
    let is_measured = |port: &&PortId| spec.outputs[port.place()].determinism == Determinism::Measured;
    let in_group = |port: &&PortId| lane.ports.contains(port);
    if !is_mixed(spec, lane.group.name) || !read.iter().chain(&asked).filter(in_group).any(|port| is_measured(&port)) {
        return Fetched::All;
    }
    match measured {
        Measured { accepted: true, host, .. } => Fetched::Of(host.as_str().into()),
        Measured { apart: true, .. } => Fetched::All,
        _ => Fetched::None,
    }
}

fn task(pipeline: &Pipeline, lanes: &Lanes, measured: &Measured, (id, lane, bound): (LaneId, &Lane, bool)) -> Task {
    let node = &pipeline.nodes[lane.node];
    let is_read = |port: &PortId| lane.readers.iter().any(|reader| reader.feed(lanes).port == *port);
    let read: Vec<PortId> = lane.ports.iter().copied().filter(is_read).collect();
    let producer = Producer {
        kind: node.kind.clone(),
        spec: node.spec.clone(),
        group: lane.group.name,
        transient: lane.is_transient(pipeline),
        fetched: fetched(pipeline, lane, &read, measured),
        bound,
        read,
    };
    let alone = node.spec.measures(lane.group.name);
    let label = LaneName { node: node.name.as_str().into(), cell: pipeline.cells[lane.cell].text.as_str().into() };
    Task {
        lane: id,
        label,
        producer: Arc::new(producer),
        projection: node.kind.projection(&pipeline.cells[lane.cell].params),
        basis: lane.basis.without_params(),
        alone,
        only_there: measured.only_there().filter(|_| alone),
        programs: lane.programs,
    }
}

/// An item's key below the prefix of a feed.
///
/// # Errors
/// In words, if it is too long with it.
pub fn prefixed(prefix: Option<&str>, key: &ItemKey) -> Result<ItemKey, String> {
    match prefix {
        Some(prefix) => key.in_cell(prefix).map_err(|e| e.to_string()),
        None => Ok(key.clone()),
    }
}
