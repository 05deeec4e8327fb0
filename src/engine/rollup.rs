//! Roll-ups: the outputs of a whole lane or shard, by its node and the digests of its inputs. A rerun without changes
//! needs a handful of look-ups, independent of the number of items, and a rerun after a small change needs a few per
//! shard.

use super::{
    action::files_artifact,
    event::OutputOf,
    ids::{Id, LaneId, PortId, Row},
    lanes::{Lane, Lanes},
    records::{self, PIPELINE, Payload, ROLLUP, SHARD},
    scheduler::{Complete, CompleteShard, Scheduler},
    sharded::Sharded,
    work::Bench,
};
use crate::pipeline::{Node, Pipeline, Target};
use serde::Serialize;
use serde_json::Value;
use std::{
    borrow::Cow,
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
};
use tauflow_cache::{CacheError, Digest, Key, Record, Recorded, Store};
use tauflow_contract::{Basis, Determinism, FORMAT_VERSION, ItemKey, Mode, canonical_bytes};

/// The key of a lane's roll-up. Item keys are part of the inputs' content digests.
#[derive(Serialize)]
struct LaneKey<'a> {
    #[serde(flatten)]
    basis: &'a Basis,
    /// For a source: its items, with the content digests of the files that they read.
    listing: Option<Digest>,
    /// For each input port, what is put before the keys, and the content digest, of each of its feeds.
    inputs: BTreeMap<&'a str, Vec<(Option<&'a str>, Digest)>>,
}

/// The key of a lane's shards, without their items.
#[derive(Serialize)]
struct ShardsKey<'a> {
    #[serde(flatten)]
    basis: Cow<'a, Basis>,
    /// The content digests of what it reads as a whole, by input port.
    whole: BTreeMap<&'a str, Digest>,
}

/// The key under which a run of a pipeline is recorded: runs with `--target` have different keys.
#[derive(Serialize)]
struct PipelineKey<'a> {
    format: u32,
    pipeline: &'a str,
    /// Nodes that are asked for, and their ports by name.
    targets: Vec<(&'a str, Option<&'a str>)>,
}

/// Digest of a source's items, in order, with the content digests of the files that they read.
pub fn listing_digest<'a>(items: impl Iterator<Item = (&'a ItemKey, Option<Digest>)>) -> Digest {
    Digest::of(&canonical_bytes(&items.collect::<Vec<_>>()))
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
    let basis = match pipeline.nodes[lane.node].mode() {
        Mode::Source => Cow::Owned(lane.basis.with(Value::Null, lane.basis.seed)),
        Mode::Map | Mode::Gather => Cow::Borrowed(&lane.basis),
    };
    Digest::of(&canonical_bytes(&ShardsKey { basis, whole }))
}

/// The key of a lane, and its preimage; none if its items, or an input's content, are not known.
fn lane_key(
    pipeline: &Pipeline,
    lane: &Lane,
    content: impl Fn(LaneId, PortId) -> Option<Digest>,
    listing: impl Fn() -> Option<Digest>,
) -> Option<(Key, String)> {
    let node = &pipeline.nodes[lane.node];
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
    let key = LaneKey { basis: &lane.basis, listing, inputs };
    let preimage = serde_json::to_string(&key).expect("a key holds only plain values");
    Some((Key::of(&canonical_bytes(&key)), preimage))
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
}

impl Known {
    /// Nothing, of all lanes.
    pub fn none(lanes: &Lanes) -> Self {
        let (rolled, totals) = (lanes.iter().map(|_| None).collect(), lanes.iter().map(|_| (0, 0)).collect());
        Self { rolled, totals, loaded: BTreeMap::new() }
    }
}

/// Looks up what the lanes gave in earlier runs.
///
/// # Errors
/// If the store cannot be read.
pub fn find(pipeline: &Pipeline, lanes: &Lanes, bench: &Bench<'_>) -> Result<Known, CacheError> {
    let store = bench.store;
    let mut known = Known::default();
    for lane in lanes {
        let outputs = |from: LaneId, port: PortId| {
            let payload: &Payload = known.rolled.get(from)?.as_ref()?;
            let source = &pipeline.nodes[lanes[from].node].spec;
            payload.collections.get(source.outputs[port.place()].name).map(|listed| listed.digest)
        };
        let node = &pipeline.nodes[lane.node];
        let key = lane_key(pipeline, lane, outputs, || list(node, &pipeline.cells[lane.cell].params));
        let mut record = key.and_then(|(key, _)| store.lookup(ROLLUP, &key));
        if let Some(found) = &record
            && !bench.intact(found)?
        {
            record = None;
        }
        let ports = &node.spec.outputs;
        // One that leaves a port out is none: what it leaves out would never be made.
        let full =
            |payload: &Payload| lane.ports.iter().all(|p| payload.collections.contains_key(ports[p.place()].name));
        let payload = record.as_deref().and_then(Payload::of).filter(full);
        let totals = record.filter(|_| payload.is_some()).map_or((0, 0), |r| (r.wall_us, r.bytes));
        known.totals.push(totals);
        known.rolled.push(payload);
    }
    // Backwards, because a lane whose listing is gone must work, and needs what it reads.
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
    Ok(known)
}

/// Whether a lane's outputs are handed on in memory: what is asked for is stored.
pub fn is_transient(pipeline: &Pipeline, lane: &Lane) -> bool {
    pipeline.nodes[lane.node].transient && !lane.target
}

/// Keeps what a lane gave.
///
/// # Errors
/// If the store cannot be written.
pub fn keep(
    pipeline: &Pipeline,
    lanes: &Lanes,
    store: &Store,
    scheduler: &Scheduler<'_>,
    complete: &Complete,
) -> Result<(), CacheError> {
    let lane = &lanes[complete.lane];
    let outputs = &pipeline.nodes[lane.node].spec.outputs;
    let content = |from: LaneId, port: PortId| {
        if let Some(result) = scheduler.result(from, port) {
            return Some(result.digest);
        }
        let name = pipeline.nodes[lanes[from].node].spec.outputs[port.place()].name;
        scheduler.rolled(from)?.collections.get(name).map(|listed| listed.digest)
    };
    let Some((key, preimage)) = lane_key(pipeline, lane, content, || Some(scheduler.listing(complete.lane))) else {
        return Ok(());
    };
    let mut payload = Payload { actions: complete.actions, ..Payload::default() };
    for port in &lane.ports {
        let Some(result) = scheduler.result(complete.lane, *port) else { return Ok(()) };
        payload.collections.insert(outputs[port.place()].name.to_owned(), result.put(store)?);
    }
    let label = pipeline.nodes[lane.node].spec.name;
    let record = records::record(ROLLUP, key, label, preimage, &payload);
    let transient = is_transient(pipeline, lane);
    write(store, &Record { wall_us: complete.wall_us, bytes: complete.bytes, transient, ..record })
}

/// Keeps what a shard of a lane gave.
///
/// # Errors
/// If the store cannot be written.
pub fn keep_shard(
    pipeline: &Pipeline,
    lanes: &Lanes,
    store: &Store,
    complete: &CompleteShard,
) -> Result<(), CacheError> {
    let spec = &pipeline.nodes[lanes[complete.lane].node].spec;
    let mut payload = Payload { actions: complete.actions, ..Payload::default() };
    for (port, shard) in &complete.outputs {
        payload.collections.insert(spec.outputs[port.place()].name.to_owned(), shard.put(store)?);
    }
    let record = records::record(SHARD, complete.key, spec.name, String::new(), &payload);
    let transient = is_transient(pipeline, &lanes[complete.lane]);
    write(store, &Record { wall_us: complete.wall_us, bytes: complete.bytes, transient, ..record })
}

/// Every output of the lanes, and the blobs that list them.
pub fn outputs(pipeline: &Pipeline, lanes: &Lanes, scheduler: &Scheduler<'_>) -> (Vec<OutputOf>, Vec<Digest>) {
    let (mut found, mut trees): (Vec<OutputOf>, Vec<Digest>) = Default::default();
    // The inputs of a lane also determine how far its outputs are reproducible.
    let mut read: Row<LaneId, _> = lanes.iter().map(|_| Determinism::Bitwise).collect();
    let weaker = |a: Determinism, b: Determinism| match (a, b) {
        (Determinism::Measured, _) | (_, Determinism::Measured) => Determinism::Measured,
        (Determinism::Local, _) | (_, Determinism::Local) => Determinism::Local,
        _ => Determinism::Bitwise,
    };
    for (id, lane) in lanes.pairs() {
        let output = |lane: LaneId, port: PortId| &pipeline.nodes[lanes[lane].node].spec.outputs[port.place()];
        for feed in lane.inputs.iter().flatten() {
            read[id] = weaker(read[id], weaker(read[feed.lane], output(feed.lane, feed.port).determinism));
        }
        for port in &lane.ports {
            let of = output(id, *port);
            let rolled = scheduler.rolled(id).and_then(|payload| payload.collections.get(of.name));
            let result = scheduler.result(id, *port);
            trees.extend(rolled.map(|listed| listed.blob).or_else(|| result?.blob()));
            found.push(OutputOf {
                name: format!("{}.{}", pipeline.cell_name(lane.cell), of.name),
                determinism: weaker(read[id], of.determinism),
                digest: rolled.map(|listed| listed.digest).or_else(|| Some(result?.digest)),
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
    let target = |target: &Target| {
        let node = &pipeline.nodes[target.node];
        (node.name.as_str(), target.port.map(|port| node.spec.outputs[port.place()].name))
    };
    let targets = pipeline.targets.iter().map(target).collect();
    let key = PipelineKey { format: FORMAT_VERSION, pipeline: &pipeline.name, targets };
    let key = Key::of(&canonical_bytes(&key));
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

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// The bytes of a key are those of its preimage, and name the format.
    fn is_of_its_json(key: &impl Serialize) {
        let value = serde_json::to_value(key).expect("plain");
        assert_eq!(value["format"], FORMAT_VERSION, "{value}");
        assert_eq!(canonical_bytes(key), canonical_bytes(&value), "{value}");
    }

    #[test]
    fn every_key_is_hashed_as_its_json_says_and_names_the_format() {
        let digest = Digest::of(b"x");
        for (seed, environment) in [(None, Value::Null), (Some(u64::MAX), json!({"library": "a"}))] {
            let params = json!({"b": 1, "a": [0.5, "x"]});
            let basis = Basis { environment, ..Basis::new("k", 1, "main").with(params, seed) };
            let inputs = BTreeMap::from([("in", vec![(None, digest), (Some("cell"), digest)]), ("gone", Vec::new())]);
            is_of_its_json(&LaneKey { basis: &basis, listing: Some(digest), inputs });
            is_of_its_json(&ShardsKey { basis: Cow::Borrowed(&basis), whole: BTreeMap::from([("in", digest)]) });
        }
        let targets = vec![("node", Some("port")), ("other", None)];
        is_of_its_json(&PipelineKey { format: FORMAT_VERSION, pipeline: "p", targets });
    }
}
