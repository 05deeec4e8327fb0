//! Roll-ups in the store: what a whole lane gave, by what its node is and what its inputs hold, and what a shard of it
//! gave. A rerun with nothing changed is then a handful of look-ups, whatever the number of items, and one after a
//! small change is a few for every shard.

use super::{
    action::files_artifact,
    holdings::Holdings,
    ids::{Id, LaneId, PortId, Row},
    keys,
    lanes::Lanes,
    records::{self, PIPELINE, Payload, ROLLUP, SHARD},
    request::{Keep, RolledShard, Rolling, ShardFound, ShardLookUps, ShardOf, Task},
    sharded::{Shard, Sharded},
};
use crate::pipeline::{Node, Pipeline};
use serde_json::Value;
use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
};
use tauflow_cache::{CacheError, Digest, Key, Record, Recorded, Store};

/// Lists a source's items now; none if that fails, which the run will tell.
fn list(node: &Node, params: &Value) -> Option<Digest> {
    let mut items = catch_unwind(AssertUnwindSafe(|| node.kind.items(params))).ok()?.ok()?;
    items.sort_by(|a, b| a.key.cmp(&b.key));
    let mut files = Vec::with_capacity(items.len());
    for item in &items {
        files.push(if item.files.is_empty() {
            None
        } else {
            Some(files_artifact(&item.files, |bytes| Ok(Digest::of(bytes))).ok()?.ok()?.digest())
        });
    }
    Some(keys::listing(items.iter().map(|item| &item.key).zip(files)))
}

/// The lanes whose outputs are known, and the collections of theirs that other lanes need.
#[derive(Default)]
pub struct Known {
    /// One for each lane.
    pub rolled: Row<LaneId, Option<Payload>>,
    /// Wall time in microseconds, and bytes, of each lane.
    pub totals: Row<LaneId, (u64, u64)>,
    /// Collections by lane and port.
    pub loaded: BTreeMap<(LaneId, PortId), Arc<Sharded>>,
    /// The keys of what was found.
    pub keys: Vec<Key>,
}

impl Known {
    /// Nothing, of all lanes.
    pub fn none(lanes: &Lanes) -> Self {
        let (rolled, totals) = (lanes.iter().map(|_| None).collect(), lanes.iter().map(|_| (0, 0)).collect());
        Self { rolled, totals, loaded: BTreeMap::new(), keys: Vec::new() }
    }

    /// Content digest of a lane's port.
    fn content(&self, pipeline: &Pipeline, lanes: &Lanes, lane: LaneId, port: PortId) -> Option<Digest> {
        let outputs = &pipeline.nodes[lanes[lane].node].spec.outputs;
        Some(self.rolled[lane].as_ref()?.collections.get(outputs[port.place()].name)?.digest)
    }
}

/// The lanes in waves: each lane after all that it reads, and as early as that allows.
fn waves(lanes: &Lanes) -> Vec<Vec<LaneId>> {
    let mut depth: Row<LaneId, usize> = Row::new();
    let mut waves: Vec<Vec<LaneId>> = Vec::new();
    for (id, lane) in lanes.pairs() {
        let after = lane.inputs.iter().flatten().map(|feed| depth[feed.lane] + 1).max().unwrap_or(0);
        depth.push(after);
        if waves.len() <= after {
            waves.push(Vec::new());
        }
        waves[after].push(id);
    }
    waves
}

/// Looks up what the lanes gave in earlier runs: those of a wave together.
///
/// # Errors
/// If the store cannot be read.
pub fn find(pipeline: &Pipeline, lanes: &Lanes, holdings: Holdings<'_>) -> Result<Known, CacheError> {
    let mut known = Known::none(lanes);
    for wave in waves(lanes) {
        let key = |id: &LaneId| {
            let lane = &lanes[*id];
            let listing = || list(&pipeline.nodes[lane.node], &pipeline.cells[lane.cell].params);
            let key = keys::lane(pipeline, lane, |from, port| known.content(pipeline, lanes, from, port), listing);
            Some((*id, key?.0))
        };
        let (asked, hashes): (Vec<LaneId>, Vec<Key>) = wave.iter().filter_map(key).unzip();
        for ((id, key), record) in asked.into_iter().zip(&hashes).zip(holdings.store.lookup_many(ROLLUP, &hashes)) {
            let Some(record) = record else { continue };
            if !holdings.intact(&record)? {
                continue;
            }
            // One that leaves a port out is none: what it leaves out would never be made.
            let ports = &pipeline.nodes[lanes[id].node].spec.outputs;
            let mut asked = lanes[id].ports.iter().map(|port| ports[port.place()].name);
            if let Some(payload) = Payload::of(&record)
                && asked.all(|name| payload.collections.contains_key(name))
            {
                known.keys.push(*key);
                known.totals[id] = (record.wall_us, record.bytes);
                known.rolled[id] = Some(payload);
            }
        }
    }
    load(pipeline, lanes, holdings.store, &mut known)?;
    Ok(known)
}

/// Loads what lanes that must work read. Backwards, because a lane whose listing is gone must work, and needs what it
/// reads.
fn load(pipeline: &Pipeline, lanes: &Lanes, store: &Store, known: &mut Known) -> Result<(), CacheError> {
    for (id, lane) in lanes.pairs().rev() {
        if known.rolled[id].is_some() {
            continue;
        }
        for feed in lane.inputs.iter().flatten() {
            let of = &pipeline.nodes[lanes[feed.lane].node].spec.outputs[feed.port.place()];
            let Some(payload) = &known.rolled[feed.lane] else { continue };
            if known.loaded.contains_key(&(feed.lane, feed.port)) {
                continue;
            }
            let listed = payload.collections.get(of.name);
            match listed.map(|listed| Sharded::get(store, listed, of.media)).transpose()?.flatten() {
                Some(collection) => {
                    known.loaded.insert((feed.lane, feed.port), Arc::new(collection));
                }
                None => {
                    known.rolled[feed.lane] = None;
                    known.loaded.retain(|(lane, _), _| *lane != feed.lane);
                }
            }
        }
    }
    Ok(())
}

/// Looks shards of a lane up as wholes.
///
/// # Errors
/// If the store cannot be read.
pub fn find_shards(asked: ShardLookUps, holdings: Holdings<'_>) -> Result<Vec<ShardFound>, CacheError> {
    let task = &asked.task;
    let key = |(shard, of): (u8, ShardOf)| {
        let (key, items) = match of {
            ShardOf::Key(key) => (key, Vec::new()),
            ShardOf::Items(shards, items) => {
                let projected = |key| (key, (task.projection)(Some(key), task.producer.group));
                (keys::shard(shards, items.iter().map(projected).collect::<Vec<_>>()), items)
            }
        };
        ShardFound { shard, key, items, rolled: None }
    };
    let mut found: Vec<ShardFound> = asked.shards.into_iter().map(key).collect();
    let hashes: Vec<Key> = found.iter().map(|shard| shard.key).collect();
    for (of, record) in found.iter_mut().zip(holdings.store.lookup_many(SHARD, &hashes)) {
        let Some(record) = record else { continue };
        if holdings.intact(&record)? {
            of.rolled = rolled(task, of.shard, &record);
        }
    }
    Ok(found)
}

/// What a shard's roll-up says of each port of its lane.
fn rolled(task: &Task, shard: u8, record: &Record) -> Option<RolledShard> {
    let payload = Payload::of(record)?;
    let outputs = task.producer.spec.outputs.iter().enumerate();
    let of_group = outputs.filter(|(_, port)| port.group.name == task.producer.group);
    let listed = |(place, of): (usize, &tauflow_contract::OutputPort)| {
        let listed = payload.collections.get(of.name)?;
        Some((PortId::at(place), Arc::new(Shard::listed(listed, shard, of.media))))
    };
    let outputs = of_group.map(listed).collect::<Option<Vec<_>>>()?;
    Some(RolledShard { outputs, totals: (payload.actions, record.wall_us, record.bytes) })
}

/// Keeps a roll-up.
///
/// # Errors
/// If the store cannot be written.
pub fn keep(store: &Store, of: &Keep) -> Result<(), CacheError> {
    let (actions, wall_us, bytes) = of.totals;
    let mut payload = Payload { actions, ..Payload::default() };
    for (port, output) in &of.outputs {
        let listed = match output {
            Rolling::Lane(collection) => collection.put(store)?,
            Rolling::Shard(shard) => shard.put(store)?,
        };
        payload.collections.insert(port.clone(), listed);
    }
    let record = records::record(of.namespace, of.key, &of.kind, of.preimage.clone(), &payload);
    write(store, &Record { wall_us, bytes, transient: of.transient, ..record })
}

/// Keeps what a whole run of a pipeline reaches: `trees` are the listings of all its outputs.
///
/// # Errors
/// If the store cannot be written.
pub fn keep_pipeline(pipeline: &Pipeline, store: &Store, mut trees: Vec<Digest>) -> Result<(), CacheError> {
    trees.sort_unstable();
    trees.dedup();
    // The payload is what tells one run's reach from another's.
    let payload = Digest::of(&tauflow_cache::tree::encode(&[], &trees, b"")).to_string();
    let key = keys::pipeline(pipeline);
    let record = records::record(PIPELINE, key, &pipeline.name, String::new(), &Payload::default());
    write(store, &Record { payload, trees, ..record })
}

fn write(store: &Store, record: &Record) -> Result<(), CacheError> {
    match store.record(record)? {
        Recorded::New | Recorded::Same => Ok(()),
        // Measured outputs differ from run to run: the latest stands for the whole, as its actions' records say.
        Recorded::Conflict { .. } => store.replace(record),
    }
}
