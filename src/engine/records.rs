//! What the engine keeps in the store: records of actions, of memoised sub-actions and of whole lanes, and the blobs
//! that running actions see.

use serde::{Deserialize, Serialize};
use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::{SystemTime, UNIX_EPOCH},
};
use tauflow_cache::{CacheError, Digest, Key, Record, Recorded, Store};
use tauflow_contract::{Artifact, Blobs, Collection, Determinism, KindError, KindSpec, MemoKey};

/// Namespace of action records.
pub const ACTION: &str = "action";
/// Namespace of lane roll-ups.
pub const ROLLUP: &str = "rollup";
/// Namespace of memoised sub-actions.
pub const MEMO: &str = "memo";

/// Blobs beyond this many are not listed in a roll-up; the records of its actions list them too.
pub const MAX_REFS: usize = 200_000;

/// Seconds since 1970, for records; no key depends on it.
pub fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs())
}

/// A collection kept as a blob.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Listed {
    /// Content digest of the collection.
    pub digest: Digest,
    /// The blob that lists it: JSON of the collection.
    pub blob: Digest,
    /// How many items it has.
    pub len: u64,
}

/// What a record holds: the outputs of an action or a lane, by port name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Payload {
    /// Artifacts of a source's or map's action.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub items: BTreeMap<String, Artifact>,
    /// Collections of a gather, or of a lane.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub collections: BTreeMap<String, Listed>,
    /// Number of actions, for lanes.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub actions: u64,
}

fn is_zero(n: &u64) -> bool {
    *n == 0
}

/// A collection together with its content digest.
#[derive(Clone, Debug)]
pub struct Whole {
    /// The items.
    pub collection: Collection,
    /// Their digest.
    pub digest: Digest,
}

impl Whole {
    /// Computes the digest.
    pub fn new(collection: Collection) -> Self {
        Self { digest: collection.digest(), collection }
    }
}

impl Payload {
    /// Reads a record's payload; a payload of another version is none.
    pub fn of(record: &Record) -> Option<Self> {
        serde_json::from_str(&record.payload).ok()
    }

    /// Every blob that the payload names itself.
    pub fn blobs(&self) -> impl Iterator<Item = Digest> + '_ {
        let items = self.items.values().flat_map(|a| a.parts.values().copied());
        items.chain(self.collections.values().map(|l| l.blob))
    }

    /// The ports on which two payloads of one action differ though their kind says that they are reproducible.
    pub fn differs(&self, other: &Self, spec: &KindSpec) -> Vec<&'static str> {
        let digest = |l: Option<&Listed>| l.map(|l| l.digest);
        let bitwise = spec.outputs.iter().filter(|p| p.determinism == Determinism::Bitwise);
        bitwise
            .filter(|p| {
                self.items.get(p.name) != other.items.get(p.name)
                    || digest(self.collections.get(p.name)) != digest(other.collections.get(p.name))
            })
            .map(|p| p.name)
            .collect()
    }
}

/// Stores a collection as a blob.
///
/// # Errors
/// If the store cannot be written.
pub fn put_collection(store: &Store, whole: &Whole) -> Result<Listed, CacheError> {
    let bytes = serde_json::to_vec(&whole.collection).expect("keys and digests always serialise");
    Ok(Listed { digest: whole.digest, blob: store.put(&bytes)?, len: whole.collection.len() as u64 })
}

/// Loads a collection; `None` if its blob is missing.
///
/// # Errors
/// If the store cannot be read.
pub fn get_collection(store: &Store, listed: &Listed) -> Result<Option<Whole>, CacheError> {
    let Some(bytes) = store.get(&listed.blob)? else { return Ok(None) };
    Ok(serde_json::from_slice(&bytes).ok().map(|collection| Whole { collection, digest: listed.digest }))
}

/// The blobs that a record of these outputs keeps alive.
pub fn refs<'a>(payload: &Payload, collections: impl IntoIterator<Item = &'a Collection>) -> Vec<Digest> {
    let mut refs: Vec<Digest> = payload.blobs().collect();
    let inside = collections.into_iter().flat_map(|c| c.items.values()).flat_map(|a| a.parts.values().copied());
    refs.extend(inside.take(MAX_REFS));
    refs.sort_unstable();
    refs.dedup();
    refs
}

/// The store as running actions see it.
pub struct StoreBlobs<'a> {
    store: &'a Store,
    /// The first error of the store itself: it stops the run.
    fatal: Mutex<Option<CacheError>>,
    written: AtomicU64,
}

impl<'a> StoreBlobs<'a> {
    /// Wraps a store for one action.
    pub fn new(store: &'a Store) -> Self {
        Self { store, fatal: Mutex::default(), written: AtomicU64::new(0) }
    }

    /// The error of the store that spoiled the action, if there was one.
    pub fn fatal(&self) -> Option<CacheError> {
        self.fatal.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn fail(&self, error: CacheError) -> KindError {
        let told = KindError::Environment(error.to_string());
        self.fatal.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        told
    }
}

impl Blobs for StoreBlobs<'_> {
    fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, KindError> {
        self.store.get(digest).map_err(|e| self.fail(e))
    }

    fn put(&self, bytes: &[u8]) -> Result<Digest, KindError> {
        self.written.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        self.store.put(bytes).map_err(|e| self.fail(e))
    }

    fn memo_get(&self, key: &MemoKey) -> Option<Artifact> {
        let record = self.store.lookup_full(MEMO, &key.hash())?;
        serde_json::from_str(&record.payload).ok()
    }

    fn memo_put(&self, key: &MemoKey, artifact: &Artifact) -> Result<(), KindError> {
        let record = Record {
            namespace: MEMO.into(),
            key: key.hash(),
            label: key.name.clone(),
            preimage: serde_json::to_string(key).expect("a key holds only plain values"),
            payload: serde_json::to_string(artifact).expect("strings and digests always serialise"),
            refs: artifact.parts.values().copied().collect(),
            wall_us: 0,
            bytes: artifact.size(),
            when: now(),
        };
        match self.store.record(&record).map_err(|e| self.fail(e))? {
            Recorded::New | Recorded::Same => Ok(()),
            Recorded::Conflict { existing } if existing.refs.iter().all(|d| self.store.contains(d)) => {
                let message = format!("`{}` gave two different results for one key; it is not reproducible", key.name);
                Err(KindError::Internal(message))
            }
            // The other's blobs are gone: what was made now takes its place.
            Recorded::Conflict { .. } => self.store.replace(&record).map_err(|e| self.fail(e)),
        }
    }
}

/// What an action gave, loaded.
#[derive(Clone, Debug, Default)]
pub struct Made {
    /// Artifacts by port name (sources and maps).
    pub items: BTreeMap<String, Arc<Artifact>>,
    /// Collections by port name (gathers).
    pub collections: BTreeMap<String, Arc<Whole>>,
    /// Wall time in microseconds, of the run that made it.
    pub wall_us: u64,
    /// Bytes of the outputs.
    pub bytes: u64,
}

/// Loads an action's outputs from its record; `None` if a listing is missing.
///
/// # Errors
/// If the store cannot be read.
pub fn load(store: &Store, record: &Record) -> Result<Option<Made>, CacheError> {
    let Some(payload) = Payload::of(record) else { return Ok(None) };
    let mut made = Made { wall_us: record.wall_us, bytes: record.bytes, ..Made::default() };
    for (port, listed) in &payload.collections {
        let Some(whole) = get_collection(store, listed)? else { return Ok(None) };
        made.collections.insert(port.clone(), Arc::new(whole));
    }
    made.items = payload.items.into_iter().map(|(port, artifact)| (port, Arc::new(artifact))).collect();
    Ok(Some(made))
}

/// A record of an action or lane.
pub fn record(
    namespace: &str,
    key: Key,
    label: &str,
    preimage: String,
    payload: &Payload,
    refs: Vec<Digest>,
) -> Record {
    Record {
        namespace: namespace.into(),
        key,
        label: label.into(),
        preimage,
        payload: serde_json::to_string(payload).expect("strings and digests always serialise"),
        refs,
        wall_us: 0,
        bytes: 0,
        when: now(),
    }
}
