//! Caches that somebody made up who wants much done for little, or wants what he wrote taken for something else.

use super::{TEXT, harmless, kinds, run, within};
use serde_json::{Value, json};
use std::{fs, path::Path, sync::atomic::AtomicBool, time::Instant};
use tauflow::{
    engine::{
        self,
        exec::{ActionFile, ExecError},
        explain::History,
    },
    ids::PortId,
    pipeline::{self, Options, Pipeline},
};
use tauflow_cache::{Digest, Key, Record, Store, tree};
use tauflow_contract::{Artifact, Collection};

/// What a reader of fifty megabytes may hold.
const SOME: isize = 600 << 20;

/// A pipeline that was run, and the folder of its cache.
fn sound(place: &Path) -> (Pipeline, Store) {
    let pipeline = pipeline::resolve_text("crafted.yaml", TEXT, &kinds::registry(), &Options::default());
    let pipeline = pipeline.unwrap_or_else(|problems| panic!("{problems}"));
    let store = Store::open(&place.join("cache")).expect("a store");
    assert!(run(&pipeline, &store, &place.join("out")));
    (pipeline, store)
}

/// The only record of a namespace and a label.
fn only(store: &Store, namespace: &str, label: &str) -> Record {
    let mut found = store.by_label(namespace, label);
    assert_eq!(found.len(), 1, "{namespace} {label}");
    found.remove(0)
}

/// Puts another listing in the place of the one that the roll-up of `long` has.
fn relist(store: &Store, items: &Collection, text: &str, len: u64) {
    let rolled = only(store, "rollup", "affine");
    let refs: Vec<Digest> = items.iter().flat_map(|(_, artifact)| artifact.parts.values().copied()).collect();
    let blob = store.put(&tree::encode(&refs, &[], text.as_bytes())).expect("room");
    let mut payload: Value = serde_json::from_str(&rolled.payload).expect("JSON");
    for (_, listed) in payload["collections"].as_object_mut().expect("collections") {
        *listed = json!({ "digest": items.digest(), "blob": blob, "len": len });
    }
    store.replace(&Record { payload: payload.to_string(), trees: vec![blob], ..rolled }).expect("room");
}

fn long(pipeline: &Pipeline, store: &Store) -> Result<Collection, String> {
    let node = pipeline.node("long").expect("it is there");
    engine::outputs(pipeline, store, node, PortId::DEFAULT).map_err(|error| error.to_string())
}

/// Makes what `long` gave whole again, as `export` does.
fn restore(pipeline: &Pipeline, store: &Store) -> bool {
    let node = pipeline.node("long").expect("it is there");
    let restored = engine::restore(pipeline, store, (node, PortId::DEFAULT), &AtomicBool::new(false), &|_| {});
    restored.is_ok_and(|summary| summary.failures.is_empty())
}

/// Six megabytes of frames whose hashes begin alike.
pub fn a_pack_of_alike_hashes_opens_at_once() {
    let place = tempfile::tempdir().expect("a temporary folder");
    drop(Store::open(place.path()).expect("a store"));
    let mut bytes = Vec::new();
    for n in 0..115_000_u64 {
        let mut frame = b"TFB1".to_vec();
        frame.extend(0_u64.to_le_bytes());
        frame.extend([7; 24]);
        frame.extend(n.to_le_bytes());
        let check = Digest::of(&frame).hash;
        frame.extend(&check[..8]);
        bytes.extend(frame);
    }
    fs::write(place.path().join("packs/0000000009-17-0123456789abcdef.pack"), bytes).expect("writable");
    let begun = Instant::now();
    let stat = harmless("alike hashes", || Store::open(place.path()).expect("a store").stat().expect("readable"));
    assert_eq!(stat.blobs, 115_000);
    // It takes a tenth of a second, and took a minute and a half.
    assert!(begun.elapsed().as_secs() < 20, "{:?}", begun.elapsed());
}

/// Fifty megabytes of rows: all alike, and each of its own.
pub fn rows_without_end_take_little() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let (pipeline, store) = sound(place.path());
    let before = long(&pipeline, &store).expect("it has run");
    let alike = format!("{{\"Items\":[{}[\"a\",\"toy/number\",[]]]}}", "[\"a\",\"toy/number\",[]],".repeat(2_300_000));
    let ascending: Vec<String> = (0..2_000_000).map(|n| format!("[\"{n:07}\",\"toy/number\",[]]")).collect();
    let ascending = format!("{{\"Items\":[{}]}}", ascending.join(","));
    for (text, len) in [(&alike, 12), (&alike, 2_300_001), (&alike, u64::MAX), (&ascending, 2_000_000)] {
        relist(&store, &Collection::default(), text, len);
        let store = Store::open(store.dir()).expect("a store");
        let found = within(SOME, "rows without end", || long(&pipeline, &store));
        // Refused, or found by its actions.
        assert!(found.is_err() || found.as_ref() == Ok(&before), "{:?}", found.map(|found| found.len()));
    }
    // Whoever makes it whole finds its actions, and keeps what they say.
    assert!(restore(&pipeline, &store));
    assert_eq!(long(&pipeline, &store).expect("it is there"), before);
}

/// Sixty megabytes of key, and many keys of a megabyte.
pub fn long_keys_take_little() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let (_, store) = sound(place.path());
    let action = store.by_label("action", "affine").remove(0);
    let crafted = |n: u64, preimage: String| {
        let key = Key::of(&n.to_le_bytes());
        store.record(&Record { key, preimage, when: u64::MAX - n, ..action.clone() }).expect("room");
    };
    crafted(0, format!("[{}[]]", "[],".repeat(20_000_000)));
    for n in 1..=12 {
        crafted(n, format!("[{}0]", "{\"a\":0},".repeat(130_000)));
    }
    let key = serde_json::from_str(&action.preimage).expect("a key");
    let store = Store::open(store.dir()).expect("a store");
    let nearest = within(700 << 20, "long keys", || History::of(&store, "affine").nearest(&key));
    drop(nearest);
}

/// A record that holds the key and the recipe of another action is not run for its own.
pub fn an_action_is_the_one_that_was_asked_for() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let (_, store) = sound(place.path());
    let mut actions = store.by_label("action", "affine");
    let (first, other) = (actions.remove(0), actions.remove(0));
    assert!(ActionFile::recorded(&store, &first.key).is_ok());
    let (preimage, recipe) = (other.preimage.clone(), other.recipe.clone());
    store.replace(&Record { preimage, recipe, ..first.clone() }).expect("room");
    let Err(ExecError::Action(said)) = ActionFile::recorded(&store, &first.key) else { panic!("it is another's") };
    assert!(said.contains(&first.key.hex()) && said.contains(&other.key.hex()), "{said}");
    assert!(ActionFile::recorded(&store, &other.key).is_ok());
}

/// Outputs of another media type than their port's are none, in roll-ups and in records of actions.
pub fn outputs_are_what_their_ports_hold() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let (pipeline, store) = sound(place.path());
    let before = long(&pipeline, &store).expect("it has run");
    let other = |artifact: &Artifact| {
        let parts = artifact.parts.values().map(|digest| ("b/x".to_owned(), *digest));
        Artifact::tree("tauflow/files", parts)
    };
    let items: Collection = before.iter().map(|(key, artifact)| (key.clone(), other(artifact))).collect();
    let rows: Vec<Value> = items.iter().map(|(key, _)| json!([key, "tauflow/files", ["b/x"]])).collect();
    relist(&store, &items, &json!({ "Items": rows }).to_string(), 12);
    let found = long(&pipeline, &store);
    assert!(found.is_err() || found == Ok(before.clone()), "they are no numbers: {found:?}");
    assert!(restore(&pipeline, &store));
    assert_eq!(long(&pipeline, &store).expect("it is there"), before);
    // A roll-up and a record that leave their port out, and a record that fills it with something else.
    let rolled = only(&store, "rollup", "affine");
    store.replace(&Record { payload: "{\"collections\":{},\"actions\":12}".into(), ..rolled }).expect("room");
    let actions = store.by_label("action", "affine");
    let with = |record: &Record, payload: Value| {
        store.replace(&Record { payload: payload.to_string(), ..record.clone() }).expect("room");
    };
    with(&actions[0], json!({}));
    let mut payload: Value = serde_json::from_str(&actions[1].payload).expect("JSON");
    for (_, artifact) in payload["items"].as_object_mut().expect("items") {
        artifact["media"] = "tauflow/files".into();
    }
    with(&actions[1], payload);
    assert!(restore(&pipeline, &store));
    assert_eq!(long(&pipeline, &store).expect("it is there"), before);
}
