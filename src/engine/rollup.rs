//! Roll-ups in the store: what a whole lane gave, by what its node is and what its inputs hold, and what a shard of it
//! gave. A rerun with nothing changed is then a handful of look-ups, whatever the number of items, and one after a
//! small change is a few for every shard.

use super::{
    action::files_artifact,
    holdings::Holdings,
    ids::{Id, PortId},
    keys,
    lanes::Lanes,
    measured::{Measured, is_mixed},
    records::{self, PIPELINE, Payload, QUARANTINE, ROLLUP, SHARD},
    request::{
        self, Keep, LaneFound, LaneLookUp, LaneOf, Request, RolledShard, Rolling, ShardFound, ShardLookUps, ShardOf,
        Task,
    },
    rolled::RolledLanes,
    sharded::Shard,
};
use crate::pipeline::Pipeline;
use serde_json::Value;
use std::{
    collections::HashSet,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
};
use tauflow_cache::{CacheError, Digest, Key, Record, Recorded, Store};
use tauflow_contract::NodeKind;

/// Lists a source's items now; none if that fails, which the run will tell.
fn list(kind: &dyn NodeKind, params: &Value) -> Option<Digest> {
    let mut items = catch_unwind(AssertUnwindSafe(|| kind.items(params))).ok()?.ok()?;
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

/// When a result from an upstream was last quarantined, if any was. Roll-ups from there may contain it, and so may this
/// machine's own of before.
fn last_quarantine(store: &Store) -> Option<u64> {
    let of = |key: &Key| store.read(QUARANTINE, key).map(|record| record.when);
    store.keys_like(QUARANTINE, "").iter().filter_map(of).max()
}

/// Whether a roll-up may contain a result that was quarantined at this time, in whole seconds.
fn is_doubtful(record: &Record, quarantined: u64) -> bool {
    record.fetched || record.when <= quarantined
}

/// Looks roll-ups up. Doubtful ones do not count.
fn trusted(store: &Store, namespace: &str, keys: &[Key]) -> Vec<Option<Arc<Record>>> {
    let mut found = store.lookup_many(namespace, keys);
    if found.iter().any(Option::is_some)
        && let Some(last) = last_quarantine(store)
    {
        found.iter_mut().for_each(|record| *record = record.take().filter(|record| !is_doubtful(record, last)));
    }
    found
}

/// Looks lanes up as wholes, and gives those that an earlier run left.
///
/// # Errors
/// If the store cannot be read.
pub fn find_lanes(asked: &[LaneLookUp], holdings: Holdings<'_>) -> Result<Vec<LaneFound>, CacheError> {
    let key = |asked: &'_ LaneLookUp| match &asked.of {
        LaneOf::Key(key) => Some(*key),
        LaneOf::Source(params, basis) => Some(keys::source(basis, list(&*asked.task.producer.kind, params)?).0),
    };
    let (asked, hashes): (Vec<&LaneLookUp>, Vec<Key>) =
        asked.iter().filter_map(|asked| Some((asked, key(asked)?))).unzip();
    let mut found = Vec::new();
    let records = trusted(holdings.store, ROLLUP, &hashes);
    for ((asked, key), record) in asked.into_iter().zip(hashes).zip(records) {
        let Some(record) = record.filter(|record| asked.task.producer.fetched.counts(record)) else { continue };
        if !holdings.intact(&record)? {
            continue;
        }
        // One that leaves a port out is none: what it leaves out would never be made.
        let outputs = &asked.task.producer.spec.outputs;
        let mut ports = asked.ports.iter().map(|port| &outputs[port.place()].name);
        if let Some(payload) = Payload::of(&record)
            && ports.all(|name| payload.collections.contains_key(*name))
        {
            let totals = (record.wall_us, record.bytes);
            found.push(LaneFound { lane: asked.task.lane, key, payload, totals });
        }
    }
    Ok(found)
}

/// The keys of the lanes that earlier runs left whole, for commands; a run asks for them by requests.
///
/// # Errors
/// If the store cannot be read.
pub fn rolled_keys(
    pipeline: &Pipeline,
    lanes: &Lanes,
    store: &Store,
    measured: &Measured,
) -> Result<Vec<Key>, CacheError> {
    let wanted = HashSet::new();
    let (tasks, mut rolled) = (request::tasks(pipeline, lanes, measured), RolledLanes::unknown(lanes));
    let mut keys = Vec::new();
    while let Some(Request::Lanes(asked)) = rolled.next(pipeline, lanes, &tasks) {
        let found = find_lanes(&asked, Holdings::stored(store, &wanted))?;
        keys.extend(found.iter().map(|lane| lane.key));
        rolled.note_lanes(found);
    }
    Ok(keys)
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
    for (of, record) in found.iter_mut().zip(trusted(holdings.store, SHARD, &hashes)) {
        let Some(record) = record.filter(|record| task.producer.fetched.counts(record)) else { continue };
        if holdings.intact(&record)? {
            of.rolled = rolled(task, of.shard, &record);
        }
    }
    Ok(found)
}

/// The outputs of a shard on each port of its lane, from its roll-up.
fn rolled(task: &Task, shard: u8, record: &Record) -> Option<RolledShard> {
    let payload = Payload::of(record)?;
    let outputs = task.producer.spec.outputs.iter().enumerate();
    let of_group = outputs.filter(|(_, port)| port.group.name == task.producer.group);
    let listed = |(place, of): (usize, &tauflow_contract::OutputPort)| {
        let listed = payload.collections.get(of.name)?;
        Some((PortId::at(place), Arc::new(Shard::listed(listed, shard, of.media))))
    };
    let outputs = of_group.map(listed).collect::<Option<Vec<_>>>()?;
    let mixed = is_mixed(&task.producer.spec, task.producer.group);
    let fetched = (mixed && record.fetched).then(|| record.maker.clone());
    Some(RolledShard { outputs, totals: (payload.actions, record.wall_us, record.bytes), fetched })
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
    let (maker, fetched) = match &of.fetched {
        Some(maker) => (maker.clone(), true),
        None => (record.maker.clone(), false),
    };
    write(store, &Record { wall_us, bytes, transient: of.transient, maker, fetched, ..record })
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
        Recorded::New => Ok(()),
        Recorded::Same => {
            // What this machine finds itself, after the last quarantine, is in no doubt any more.
            let Some(last) = last_quarantine(store) else { return Ok(()) };
            let known = store.read(&record.namespace, &record.key);
            if known.is_some_and(|known| is_doubtful(&known, last)) { store.replace(record) } else { Ok(()) }
        }
        // Measured outputs differ from run to run: the latest stands for the whole, as its actions' records say. So do
        // outputs from an upstream that were quarantined.
        Recorded::Conflict { .. } => store.replace(record),
    }
}
