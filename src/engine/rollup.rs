//! Roll-ups: what a whole lane gave, by what its node is and what its inputs hold, and what a shard of it gave. A rerun with
//! nothing changed is then a handful of look-ups, whatever the number of items, and one after a small change is a few for
//! every shard.

use super::{
    action::files_artifact,
    event::OutputOf,
    lanes::Lane,
    records::{self, PIPELINE, Payload, ROLLUP, SHARD},
    scheduler::{Complete, CompleteShard, Scheduler},
    whole::Whole,
    work::Bench,
};
use crate::pipeline::{Node, Pipeline};
use serde::Serialize;
use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
};
use tauflow_cache::{CacheError, Digest, Key, Record, Recorded, Store};
use tauflow_contract::{Determinism, FORMAT_VERSION, ItemKey, Mode, canonical_bytes};

/// What decides a lane's outputs. Item keys are part of the inputs' content digests.
#[derive(Serialize)]
struct LaneKey<'a> {
    format: u32,
    kind: &'a str,
    version: u32,
    group: &'a str,
    params: &'a Value,
    seed: Option<u64>,
    #[serde(skip_serializing_if = "Value::is_null")]
    environment: &'a Value,
    /// Of a source: its items, with the content digests of the files that they read.
    listing: Option<Digest>,
    /// For each input port, what is put before the keys, and the content digest, of each of its feeds.
    inputs: BTreeMap<&'a str, Vec<(Option<&'a str>, Digest)>>,
}

/// Digest of a source's items, in order, with the content digests of the files that they read.
pub fn listing_digest<'a>(items: impl Iterator<Item = (&'a ItemKey, Option<Digest>)>) -> Digest {
    let mut bytes = b"tauflow-listing-1".to_vec();
    for (key, file) in items {
        bytes.extend((key.as_str().len() as u64).to_le_bytes());
        bytes.extend(key.as_str().as_bytes());
        bytes.push(u8::from(file.is_some()));
        if let Some(file) = file {
            bytes.extend(file.hash);
            bytes.extend(file.size.to_le_bytes());
        }
    }
    Digest::of(&bytes)
}

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
    Some(listing_digest(items.iter().map(|item| &item.key).zip(files)))
}

/// Digest of what decides a lane's shards beside the items: of the params, a source's items name their own.
pub fn shard_prefix(pipeline: &Pipeline, lane: &Lane, whole: BTreeMap<&str, Digest>) -> Digest {
    let node = &pipeline.nodes[lane.node];
    let params = (node.mode() != Mode::Source).then_some(&pipeline.cells[lane.cell].params);
    let seed = node.spec.seeded.then_some(pipeline.seed);
    let mut value = json!([FORMAT_VERSION, node.spec.name, node.spec.version, lane.group, params, seed, whole]);
    if let Value::Array(values) = &mut value
        && !lane.environment.is_null()
    {
        values.push(lane.environment.clone());
    }
    Digest::of(&canonical_bytes(&value))
}

/// The key of a lane, and its preimage; none if its items, or an input's content, are not known.
fn lane_key(
    pipeline: &Pipeline,
    lane: &Lane,
    content: impl Fn(usize, usize) -> Option<Digest>,
    listing: impl Fn() -> Option<Digest>,
) -> Option<(Key, String)> {
    let node = &pipeline.nodes[lane.node];
    let cell = &pipeline.cells[lane.cell];
    if lane.only.is_some() {
        return None;
    }
    let listing = match node.mode() {
        Mode::Source => Some(listing()?),
        Mode::Map | Mode::Gather => None,
    };
    let mut inputs = BTreeMap::new();
    for (port, feeds) in node.spec.inputs.iter().zip(&lane.inputs) {
        let feeds = feeds
            .iter()
            .map(|feed| Some((feed.prefix.as_deref(), content(feed.lane, feed.port)?)))
            .collect::<Option<Vec<_>>>()?;
        inputs.insert(port.name, feeds);
    }
    let key = LaneKey {
        format: FORMAT_VERSION,
        kind: node.spec.name,
        version: node.spec.version,
        group: lane.group,
        params: &cell.params,
        seed: node.spec.seeded.then_some(pipeline.seed),
        environment: &lane.environment,
        listing,
        inputs,
    };
    let value = serde_json::to_value(&key).expect("a key holds only plain values");
    let hash = Key::of(&canonical_bytes(&value));
    Some((hash, value.to_string()))
}

/// The lanes whose outputs are known, and the collections of theirs that other lanes need.
#[derive(Default)]
pub struct Known {
    /// One for each lane.
    pub rolled: Vec<Option<Payload>>,
    /// Wall time in microseconds, and bytes, of each lane.
    pub totals: Vec<(u64, u64)>,
    /// Collections by lane and port.
    pub loaded: BTreeMap<(usize, usize), Arc<Whole>>,
}

impl Known {
    /// Nothing, of so many lanes.
    pub fn none(lanes: usize) -> Self {
        Self { rolled: vec![None; lanes], totals: vec![(0, 0); lanes], loaded: BTreeMap::new() }
    }
}

/// Looks up what the lanes gave in earlier runs.
///
/// # Errors
/// If the store cannot be read.
pub fn find(pipeline: &Pipeline, lanes: &[Lane], bench: &Bench<'_>) -> Result<Known, CacheError> {
    let store = bench.store;
    let mut known = Known::default();
    for lane in lanes {
        let outputs = |at: usize, port: usize| {
            let payload: &Payload = known.rolled.get(at)?.as_ref()?;
            let source = &pipeline.nodes[lanes[at].node].spec;
            payload.collections.get(source.outputs[port].name).map(|listed| listed.digest)
        };
        let node = &pipeline.nodes[lane.node];
        let key = lane_key(pipeline, lane, outputs, || list(node, &pipeline.cells[lane.cell].params));
        let mut record = key.and_then(|(key, _)| store.lookup(ROLLUP, &key));
        if let Some(found) = &record
            && !bench.whole(found)?
        {
            record = None;
        }
        known.totals.push(record.as_ref().map_or((0, 0), |r| (r.wall_us, r.bytes)));
        known.rolled.push(record.and_then(|r| Payload::of(&r)));
    }
    // Backwards, because a lane whose listing is gone must work, and needs what it reads.
    for (at, lane) in lanes.iter().enumerate().rev() {
        if known.rolled[at].is_some() {
            continue;
        }
        for feed in lane.inputs.iter().flatten() {
            let name = pipeline.nodes[lanes[feed.lane].node].spec.outputs[feed.port].name;
            let Some(payload) = &known.rolled[feed.lane] else { continue };
            if known.loaded.contains_key(&(feed.lane, feed.port)) {
                continue;
            }
            let listed = payload.collections.get(name);
            match listed.map(|listed| Whole::get(store, listed)).transpose()?.flatten() {
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
    Ok(known)
}

/// Keeps what a lane gave.
///
/// # Errors
/// If the store cannot be written.
pub fn keep(
    pipeline: &Pipeline,
    lanes: &[Lane],
    store: &Store,
    scheduler: &Scheduler<'_>,
    complete: &Complete,
) -> Result<(), CacheError> {
    let lane = &lanes[complete.lane];
    let outputs = &pipeline.nodes[lane.node].spec.outputs;
    let content = |at: usize, port: usize| {
        if let Some(whole) = scheduler.result(at, port) {
            return Some(whole.digest);
        }
        let name = pipeline.nodes[lanes[at].node].spec.outputs[port].name;
        scheduler.rolled(at)?.collections.get(name).map(|listed| listed.digest)
    };
    let Some((key, preimage)) = lane_key(pipeline, lane, content, || Some(scheduler.listing(complete.lane))) else {
        return Ok(());
    };
    let mut payload = Payload { actions: complete.actions, ..Payload::default() };
    for port in &lane.ports {
        let Some(whole) = scheduler.result(complete.lane, *port) else { return Ok(()) };
        payload.collections.insert(outputs[*port].name.to_owned(), whole.put(store)?);
    }
    let label = pipeline.nodes[lane.node].spec.name;
    let record = records::record(ROLLUP, key, label, preimage, &payload);
    write(store, &Record { wall_us: complete.wall_us, bytes: complete.bytes, ..record })
}

/// Keeps what a shard of a lane gave.
///
/// # Errors
/// If the store cannot be written.
pub fn keep_shard(
    pipeline: &Pipeline,
    lanes: &[Lane],
    store: &Store,
    complete: &CompleteShard,
) -> Result<(), CacheError> {
    let spec = &pipeline.nodes[lanes[complete.lane].node].spec;
    let mut payload = Payload { actions: complete.actions, ..Payload::default() };
    for (port, part) in &complete.parts {
        payload.collections.insert(spec.outputs[*port].name.to_owned(), part.put(store)?);
    }
    let record = records::record(SHARD, complete.key, spec.name, String::new(), &payload);
    write(store, &Record { wall_us: complete.wall_us, bytes: complete.bytes, ..record })
}

/// Every output of the lanes, and the blobs that list them.
pub fn outputs(pipeline: &Pipeline, lanes: &[Lane], scheduler: &Scheduler<'_>) -> (Vec<OutputOf>, Vec<Digest>) {
    let (mut found, mut trees): (Vec<OutputOf>, Vec<Digest>) = Default::default();
    // What a lane reads decides, too, how far its outputs are reproducible.
    let mut read = vec![Determinism::Bitwise; lanes.len()];
    let weaker = |a: Determinism, b: Determinism| match (a, b) {
        (Determinism::Measured, _) | (_, Determinism::Measured) => Determinism::Measured,
        (Determinism::Local, _) | (_, Determinism::Local) => Determinism::Local,
        _ => Determinism::Bitwise,
    };
    for (at, lane) in lanes.iter().enumerate() {
        let outputs = |lane: usize| &pipeline.nodes[lanes[lane].node].spec.outputs;
        for feed in lane.inputs.iter().flatten() {
            read[at] = weaker(read[at], weaker(read[feed.lane], outputs(feed.lane)[feed.port].determinism));
        }
        for port in &lane.ports {
            let of = &outputs(at)[*port];
            let rolled = scheduler.rolled(at).and_then(|payload| payload.collections.get(of.name));
            let whole = scheduler.result(at, *port);
            trees.extend(rolled.map(|listed| listed.blob).or_else(|| whole?.blob()));
            found.push(OutputOf {
                name: format!("{}.{}", pipeline.cell_name(lane.cell), of.name),
                determinism: weaker(read[at], of.determinism),
                digest: rolled.map(|listed| listed.digest).or_else(|| Some(whole?.digest)),
            });
        }
    }
    (found, trees)
}

/// Keeps what a whole run of a pipeline reaches: `trees` are the listings of all its outputs.
///
/// # Errors
/// If the store cannot be written.
pub fn keep_pipeline(pipeline: &Pipeline, store: &Store, mut trees: Vec<Digest>) -> Result<(), CacheError> {
    trees.sort_unstable();
    trees.dedup();
    // Runs of a part of it, by `--target`, do not take its place.
    let target = |t: &crate::pipeline::Target| format!(" {}.{:?}", pipeline.nodes[t.node].name, t.port);
    let targets: String = pipeline.targets.iter().map(target).collect();
    let key = Key::of(format!("tauflow-pipeline-1 {}{targets}", pipeline.name).as_bytes());
    // The payload is what tells one run's reach from another's.
    let payload = Digest::of(&tauflow_cache::tree::encode(&[], &trees, b"")).to_string();
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
