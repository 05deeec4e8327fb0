//! What the results of a pipeline rest on in a store: the records of its actions, lanes and shards. And which records
//! hold on any machine.

use super::{
    EngineError, RunOptions,
    event::Ended,
    records::{ACTION, Payload, ROLLUP, SEEN, SHARD},
    run::Run,
    sighted,
};
use crate::{kinds::Registry, pipeline::Pipeline};
use serde_json::Value;
use std::{
    collections::{BTreeSet, HashSet},
    sync::atomic::AtomicBool,
};
use tauflow_cache::{Digest, Key, Record, Store};

/// The records of a pipeline's results in a store.
pub struct Reached {
    /// Each namespace, and the key.
    pub keys: Vec<(&'static str, Key)>,
    /// Number of actions whose results are not there, as far as it is known.
    pub missing: u64,
}

/// The records of a pipeline's results, as far as they are there.
///
/// # Errors
/// If the store cannot be read.
pub fn reached(pipeline: &Pipeline, store: &Store) -> Result<Reached, EngineError> {
    let stop = AtomicBool::new(false);
    // Item by item: a lane that is up to date would hide its actions.
    let options = RunOptions { dry: true, no_rollup: true, ..RunOptions::default() };
    let mut run = Run::looking(pipeline, store, &options, &stop, &|_| {})?;
    run.keep_keys = true;
    let summary = run.finish()?;
    let hits = run.planned.iter().filter(|planned| planned.ended == Ended::Hit);
    let actions: BTreeSet<Key> = hits.map(|planned| planned.key.hash()).collect();
    let lanes: BTreeSet<Key> = run.rolled_lanes()?.into_iter().collect();
    let shards = shards(pipeline, store, &lanes)?;
    let of = |namespace: &'static str, keys: BTreeSet<Key>| keys.into_iter().map(move |key| (namespace, key));
    Ok(Reached {
        keys: of(ACTION, actions).chain(of(SHARD, shards)).chain(of(ROLLUP, lanes)).collect(),
        missing: summary.total(|node| node.ran + node.blocked),
    })
}

/// The shards that these lanes consist of: a lane's listing names those of its shards.
fn shards(pipeline: &Pipeline, store: &Store, lanes: &BTreeSet<Key>) -> Result<BTreeSet<Key>, EngineError> {
    let mut listed: HashSet<Digest> = HashSet::new();
    for record in lanes.iter().filter_map(|key| store.read(ROLLUP, key)) {
        for listing in &record.trees {
            let bytes = store.get(listing)?;
            let tree = bytes.as_deref().and_then(tauflow_cache::tree::decode);
            listed.extend(tree.into_iter().flat_map(|tree| tree.trees));
        }
    }
    if listed.is_empty() {
        return Ok(BTreeSet::new());
    }
    let kinds: BTreeSet<&str> = pipeline.nodes.iter().map(|node| node.spec.name).collect();
    let keys = kinds.into_iter().flat_map(|kind| store.keys_by_label(SHARD, kind));
    let is_listed = |key: &Key| {
        let record = store.read(SHARD, key);
        record.is_some_and(|r| !r.trees.is_empty() && r.trees.iter().all(|tree| listed.contains(tree)))
    };
    Ok(keys.filter(is_listed).collect())
}

/// The lists of files that programs looked at, for those of these actions that ran a traced program. Without them no
/// other machine finds the actions.
pub fn seen_by(store: &Store, keys: &[(&str, Key)], free: &dyn Fn(&Record) -> bool) -> Vec<(&'static str, Key)> {
    let actions = keys.iter().filter(|(namespace, _)| *namespace == ACTION);
    let records = actions.filter_map(|(_, key)| store.read(ACTION, key)).filter(|record| free(record));
    let lists: BTreeSet<Key> = records.filter_map(|record| sighted::of_record(&record)).collect();
    lists.into_iter().map(|key| (SEEN, key)).collect()
}

/// Whether the outputs in a record are of use on any machine: they have the same bits everywhere, or are made together
/// with outputs that do. Neither mere measurements are, nor what depends on a library of a machine, nor what an unknown
/// kind made.
pub fn holds_anywhere(record: &Record, registry: &Registry) -> bool {
    let (Some(kind), Some(payload)) = (registry.get(&record.label), Payload::of(record)) else { return false };
    let spec = match serde_json::from_str::<Value>(&record.preimage) {
        Ok(key) if !key["params"].is_null() => kind.spec_for(&key["params"]),
        // Params are not known, and may decide it.
        _ if !kind.port_params().is_empty() => return false,
        _ => kind.spec(),
    };
    payload.is_portable(&spec)
}
