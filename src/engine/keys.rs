//! Keys of roll-ups: what decides the outputs of a whole lane, of a shard of it, and of a pipeline.
//!
//! Pure: it reads nothing.

use super::{
    ids::{Id, LaneId, PortId},
    lanes::{Lane, LaneBasis},
};
use crate::pipeline::{Pipeline, Target};
use serde::Serialize;
use std::{borrow::Cow, collections::BTreeMap};
use tauflow_cache::{Digest, Key};
use tauflow_contract::{FORMAT_VERSION, ItemKey, Mode, canonical_bytes};

/// Everything that determines a lane's outputs. Item keys are part of the inputs' content digests.
#[derive(Serialize)]
struct LaneKey<'a> {
    #[serde(flatten)]
    basis: &'a LaneBasis,
    /// The items of a source, with the content digests of the files that they read.
    listing: Option<Digest>,
    /// For each input port, what is put before the keys, and the content digest, of each of its feeds.
    inputs: BTreeMap<&'a str, Vec<(Option<&'a str>, Digest)>>,
}

/// Everything that determines the shards of a lane, except their items.
#[derive(Serialize)]
struct ShardsKey<'a> {
    #[serde(flatten)]
    basis: Cow<'a, LaneBasis>,
    /// The content digests of what it reads as a whole, by input port.
    whole: BTreeMap<&'a str, Digest>,
}

/// Everything that determines a shard's outputs.
#[derive(Serialize)]
struct ShardKey<T> {
    /// Digest of what decides all shards of its lane.
    shards: Digest,
    /// Of a source its items and the params that each reads. Of a map, for each input port, what is put before the keys
    /// of each of its feeds, and the content digest of the feed's shard.
    holds: T,
}

/// What a run of a pipeline is kept under: runs of a part of it, by `--target`, do not take its place.
#[derive(Serialize)]
struct PipelineKey<'a> {
    format: u32,
    pipeline: &'a str,
    /// Nodes that are asked for, and their ports by name.
    targets: Vec<(&'a str, Option<&'a str>)>,
}

/// Digest of a source's items, in order, with the content digests of the files that they read.
pub fn listing<'a>(items: impl Iterator<Item = (&'a ItemKey, Option<Digest>)>) -> Digest {
    Digest::of(&canonical_bytes(&items.collect::<Vec<_>>()))
}

/// Digest of what decides a lane's shards beside the items: of the params, a source's items name their own.
pub fn shards(pipeline: &Pipeline, lane: &Lane, whole: BTreeMap<&str, Digest>) -> Digest {
    let basis = match pipeline.nodes[lane.node].mode() {
        Mode::Source => Cow::Owned(lane.basis.without_params()),
        Mode::Map | Mode::Gather => Cow::Borrowed(&lane.basis),
    };
    Digest::of(&canonical_bytes(&ShardsKey { basis, whole }))
}

/// Key of a shard, by what decides all shards of its lane, and by what it holds (see `ShardKey`).
pub fn shard(shards: Digest, holds: impl Serialize) -> Key {
    Key::of(&canonical_bytes(&ShardKey { shards, holds }))
}

/// The key of a lane, and its preimage; none if its items, or an input's content, are not known.
pub fn lane(
    pipeline: &Pipeline,
    lane: &Lane,
    content: impl Fn(LaneId, PortId) -> Option<Digest>,
    listing: impl Fn() -> Option<Digest>,
) -> Option<(Key, String)> {
    let node = &pipeline.nodes[lane.node];
    if !lane.is_rolled_up() {
        return None;
    }
    if node.mode() == Mode::Source {
        return Some(source(&lane.basis, listing()?));
    }
    let mut inputs = BTreeMap::new();
    for (port, feeds) in node.spec.inputs.iter().zip(&lane.inputs) {
        let feeds = feeds
            .iter()
            .map(|feed| Some((feed.prefix.as_deref(), content(feed.lane, feed.port)?)))
            .collect::<Option<Vec<_>>>()?;
        inputs.insert(port.name, feeds);
    }
    Some(hashed(&LaneKey { basis: &lane.basis, listing: None, inputs }))
}

/// The key of a source's lane, by the digest of its items, and its preimage.
pub fn source(basis: &LaneBasis, listing: Digest) -> (Key, String) {
    hashed(&LaneKey { basis, listing: Some(listing), inputs: BTreeMap::new() })
}

fn hashed(key: &LaneKey<'_>) -> (Key, String) {
    let preimage = serde_json::to_string(key).expect("a key holds only plain values");
    (Key::of(&canonical_bytes(key)), preimage)
}

/// The key of a whole run of a pipeline.
pub fn pipeline(pipeline: &Pipeline) -> Key {
    let target = |target: &Target| {
        let node = &pipeline.nodes[target.node];
        (node.name.as_str(), target.port.map(|port| node.spec.outputs[port.place()].name))
    };
    let targets = pipeline.targets.iter().map(target).collect();
    Key::of(&canonical_bytes(&PipelineKey { format: FORMAT_VERSION, pipeline: &pipeline.name, targets }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};
    use tauflow_contract::Basis;

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
            let shared = Basis { environment, ..Basis::new("k", 1, "main") };
            let basis = LaneBasis::new(&shared, params, seed);
            let inputs = BTreeMap::from([("in", vec![(None, digest), (Some("cell"), digest)]), ("gone", Vec::new())]);
            is_of_its_json(&LaneKey { basis: &basis, listing: Some(digest), inputs });
            is_of_its_json(&ShardsKey { basis: Cow::Borrowed(&basis), whole: BTreeMap::from([("in", digest)]) });
        }
        let targets = vec![("node", Some("port")), ("other", None)];
        is_of_its_json(&PipelineKey { format: FORMAT_VERSION, pipeline: "p", targets });
    }
}
