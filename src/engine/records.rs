//! The engine's records in the store: of actions, memoised sub-actions, whole lanes and their shards, and the blobs
//! that running actions see.

use super::{
    ids::{Id, PortId},
    measured::is_mixed,
    output::Output,
    sharded::{Listed, Sharded},
    transient::Pool,
};
use serde::{Deserialize, Serialize};
use std::{
    collections::{BTreeMap, HashMap},
    fs,
    sync::{
        Arc, Mutex, OnceLock, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::{Instant, SystemTime, UNIX_EPOCH},
};
use tauflow_cache::{CacheError, Digest, Key, Record, Recorded, Store};
use tauflow_contract::{Any, Artifact, Blobs, Determinism, KindError, KindSpec, MemoKey, Mode, OutputPort};

/// Namespace of action records.
pub const ACTION: &str = "action";
/// Namespace of lane roll-ups.
pub const ROLLUP: &str = "rollup";
/// Namespace of roll-ups of one shard of a lane.
pub const SHARD: &str = "shard";
/// Namespace of what a whole run of a pipeline reaches.
pub const PIPELINE: &str = "pipeline";
/// Namespace of memoised sub-actions.
pub const MEMO: &str = "memo";
/// Namespace of action records that came from an upstream and differ from what their actions give here.
pub const QUARANTINE: &str = "quarantine";
/// Namespace of the lists of files that programs looked at.
pub const SEEN: &str = "seen";
/// Namespace of machines that measured something.
pub const MACHINE: &str = "machine";

/// Seconds since 1970, for records; no key depends on it.
pub fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs())
}

/// The machine and the program that make records now.
pub fn maker() -> String {
    static MAKER: OnceLock<String> = OnceLock::new();
    let named = || {
        let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        let host = if host.trim().is_empty() { "a machine without a name" } else { host.trim() };
        format!("{host}, tauflow {}", env!("CARGO_PKG_VERSION"))
    };
    MAKER.get_or_init(named).clone()
}

/// The payload of a record: the outputs of an action or a lane, by port name.
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

impl Payload {
    /// Reads a record's payload; a payload of another version is none.
    pub fn of(record: &Record) -> Option<Self> {
        serde_json::from_str(&record.payload).ok()
    }

    /// The blobs that the payload reaches beside its listings.
    pub fn refs(&self) -> Vec<Digest> {
        let mut refs: Vec<Digest> = self.items.values().flat_map(|a| a.parts.values().copied()).collect();
        refs.sort_unstable();
        refs.dedup();
        refs
    }

    /// Whether an output has the same bits on any machine, and the others are measurements.
    pub fn is_portable(&self, spec: &KindSpec) -> bool {
        let of = |name: &String| {
            spec.outputs.iter().find(|port| port.name == *name).map_or(Determinism::Local, |port| port.determinism)
        };
        let found: Vec<Determinism> = self.items.keys().chain(self.collections.keys()).map(of).collect();
        found.contains(&Determinism::Bitwise) && !found.contains(&Determinism::Local)
    }

    /// Its listings.
    pub fn trees(&self) -> Vec<Digest> {
        self.collections.values().map(|listed| listed.blob).collect()
    }

    /// Where two payloads of one action differ though their kind says that they are reproducible: each port with the
    /// digests of its content here and in the other.
    pub fn differs(&self, other: &Self, spec: &KindSpec) -> Vec<String> {
        let digest = |payload: &Self, port: &str| {
            let item = payload.items.get(port).map(Artifact::digest);
            let found = item.or_else(|| payload.collections.get(port).map(|listed| listed.digest));
            found.map_or_else(|| "nothing".to_owned(), |digest| digest.to_string())
        };
        let bitwise = spec.outputs.iter().filter(|p| p.determinism != Determinism::Measured);
        bitwise
            .map(|p| (p.name, digest(self, p.name), digest(other, p.name)))
            .filter(|(_, before, now)| before != now)
            .map(|(port, before, now)| format!("`{port}` (was {before}, now {now})"))
            .collect()
    }
}

/// The store as running actions see it.
pub struct StoreBlobs<'a> {
    store: &'a Store,
    /// Where a transient action's blobs go; none in a process that passes nothing on in memory.
    pool: Option<&'a Pool>,
    /// The outputs of a transient action, until their holder is known.
    staged: Option<Mutex<HashMap<Digest, Arc<Vec<u8>>>>>,
    /// The first error of the store itself: it stops the run.
    fatal: Mutex<Option<CacheError>>,
    start: Instant,
    /// Nothing that was memoised is given: an action that is compared with what it gave before does all of its work.
    anew: bool,
    /// Bytes of what the action put.
    made: AtomicU64,
}

impl<'a> StoreBlobs<'a> {
    /// Wraps a store for one action; a transient one's blobs go to the pool, and one that runs `anew` is given nothing
    /// memoised.
    pub fn new(store: &'a Store, pool: Option<&'a Pool>, transient: bool, anew: bool) -> Self {
        let staged = transient.then(Mutex::default);
        Self { store, pool, staged, fatal: Mutex::default(), start: Instant::now(), anew, made: AtomicU64::new(0) }
    }

    /// The error of the store that spoiled the action, if there was one.
    pub fn fatal(&self) -> Option<CacheError> {
        self.fatal.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Bytes of the blobs that the action has made and that were not there before.
    pub fn made(&self) -> u64 {
        self.made.load(Ordering::Relaxed)
    }

    fn fail(&self, error: CacheError) -> KindError {
        let told = KindError::Environment(error.to_string());
        self.fatal.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        told
    }

    fn take_staged(&self, digest: &Digest) -> Option<Arc<Vec<u8>>> {
        self.staged.as_ref()?.lock().unwrap_or_else(PoisonError::into_inner).remove(digest)
    }

    /// Hands what an artifact of a transient action holds to the pool; what has no room there is stored.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn hand_over<'b>(&self, artifacts: impl Iterator<Item = &'b Artifact>) -> Result<(), CacheError> {
        for digest in artifacts.flat_map(|artifact| artifact.parts.values()) {
            // An output may also name a blob that was there before, or one that was handed over just now.
            let Some(bytes) = self.take_staged(digest) else { continue };
            if !self.pool.is_some_and(|pool| pool.put(*digest, &bytes)) {
                self.store.put(&bytes)?;
            }
        }
        Ok(())
    }
}

impl Blobs for StoreBlobs<'_> {
    fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, KindError> {
        if let Some(staged) = &self.staged
            && let Some(bytes) = staged.lock().unwrap_or_else(PoisonError::into_inner).get(digest)
        {
            return Ok(Some(bytes.to_vec()));
        }
        if let Some(bytes) = self.pool.and_then(|pool| pool.get(digest)) {
            return Ok(Some(bytes.to_vec()));
        }
        self.store.get(digest).map_err(|e| self.fail(e))
    }

    fn put(&self, bytes: &[u8]) -> Result<Digest, KindError> {
        let made = || self.made.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        let Some(staged) = &self.staged else {
            let (digest, is_new) = self.store.put_unless_here(bytes).map_err(|e| self.fail(e))?;
            if is_new {
                made();
            }
            return Ok(digest);
        };
        let digest = Digest::of(bytes);
        made();
        let mut staged = staged.lock().unwrap_or_else(PoisonError::into_inner);
        staged.entry(digest).or_insert_with(|| Arc::new(bytes.to_vec()));
        Ok(digest)
    }

    fn memo_get(&self, key: &MemoKey) -> Option<Artifact> {
        let record = if self.anew { None } else { self.store.lookup_full(MEMO, &key.hash()) }?;
        serde_json::from_str(&record.payload).ok()
    }

    fn memo_put(&self, key: &MemoKey, artifact: &Artifact) -> Result<(), KindError> {
        let record = Record {
            namespace: MEMO.into(),
            key: key.hash(),
            label: key.name(),
            preimage: serde_json::to_string(key).expect("a key holds only plain values"),
            payload: serde_json::to_string(artifact).expect("strings and digests always serialise"),
            recipe: String::new(),
            derived: false,
            transient: false,
            refs: artifact.parts.values().copied().collect(),
            trees: Vec::new(),
            // It belongs to the action that made it; a gc should know that it was not free.
            wall_us: self.start.elapsed().as_micros() as u64,
            bytes: artifact.size(),
            when: now(),
            maker: maker(),
            fetched: false,
        };
        // Memoised results are stored.
        for digest in &record.refs {
            let staged = self.staged.as_ref().map(|all| all.lock().unwrap_or_else(PoisonError::into_inner));
            if let Some(bytes) = staged.and_then(|all| all.get(digest).cloned()) {
                self.store.put(&bytes).map_err(|e| self.fail(e))?;
            }
        }
        match self.store.record(&record).map_err(|e| self.fail(e))? {
            Recorded::New | Recorded::Same => Ok(()),
            Recorded::Conflict { existing } if existing.refs.iter().all(|d| self.store.contains(d)) => {
                let message =
                    format!("`{}` produced two different results for one key; it is not reproducible", key.name());
                Err(KindError::Internal(message))
            }
            // The other's blobs are gone: what was made now takes its place.
            Recorded::Conflict { .. } => self.store.replace(&record).map_err(|e| self.fail(e)),
        }
    }
}

/// The outputs of an action.
#[derive(Clone, Debug, Default)]
pub struct Made {
    /// Artifacts by output port (sources and maps).
    pub items: Vec<(PortId, Arc<Output>)>,
    /// Collections by output port (gathers).
    pub collections: Vec<(PortId, Arc<Sharded>)>,
    /// Wall time in microseconds, of the run that made it.
    pub wall_us: u64,
    /// Bytes of the outputs.
    pub bytes: u64,
    /// Bytes of the blobs that it put when it ran: outputs may name blobs of others.
    pub put: u64,
    /// Who made it, if it came from an upstream and has measurements beside other outputs.
    pub fetched: Option<Arc<str>>,
}

impl Made {
    /// The artifact on a port.
    pub fn item(&self, port: PortId) -> Option<&Arc<Output>> {
        self.items.iter().find(|(at, _)| *at == port).map(|(_, output)| output)
    }

    /// The collection on a port.
    pub fn collection(&self, port: PortId) -> Option<&Arc<Sharded>> {
        self.collections.iter().find(|(at, _)| *at == port).map(|(_, sharded)| sharded)
    }
}

/// The number of an output port.
pub fn port_of(spec: &KindSpec, name: &str) -> Option<PortId> {
    spec.outputs.iter().position(|port| port.name == name).map(PortId::at)
}

/// Whether a payload fills the ports of a group, with what they say they hold; listings say it when they are read.
fn fills(payload: &Payload, spec: &KindSpec, group: &str) -> bool {
    let ports = || spec.outputs.iter().filter(|port| port.group.name == group);
    let known = |name: &String| ports().any(|port| port.name == name);
    let filled = |port: &OutputPort| match spec.mode {
        Mode::Gather => payload.collections.contains_key(port.name),
        Mode::Source | Mode::Map => payload
            .items
            .get(port.name)
            .map_or(port.filter, |artifact| port.media == Any::NAME || artifact.media == port.media),
    };
    let others = if spec.mode == Mode::Gather { payload.items.len() } else { payload.collections.len() };
    others == 0 && payload.items.keys().chain(payload.collections.keys()).all(known) && ports().all(filled)
}

/// Loads an action's outputs from its record; `None` if a listing is missing, or the record is not one of this group of
/// outputs.
///
/// # Errors
/// If the store cannot be read.
pub fn load(store: &Store, record: &Record, spec: &KindSpec, group: &str) -> Result<Option<Made>, CacheError> {
    Ok(load_many(store, &[Some(record)], spec, group)?.remove(0)) // one for each record
}

/// As [`load`], of several records of one group; their listings are read together.
///
/// # Errors
/// If the store cannot be read.
pub fn load_many(
    store: &Store,
    records: &[Option<&Record>],
    spec: &KindSpec,
    group: &str,
) -> Result<Vec<Option<Made>>, CacheError> {
    let payload = |record: &Option<&Record>| Payload::of((*record)?).filter(|payload| fills(payload, spec, group));
    let payloads: Vec<Option<Payload>> = records.iter().map(payload).collect();
    // A payload that fills a group names only ports of it.
    let media = |name: &str| port_of(spec, name).map_or(Any::NAME, |port| spec.outputs[port.place()].media);
    let collections = payloads.iter().flatten().flat_map(|payload| &payload.collections);
    let asked: Vec<_> = collections.map(|(name, listed)| (listed, media(name))).collect();
    let mut read = Sharded::get_many(store, &asked)?.into_iter();
    let mixed = is_mixed(spec, group);
    let made = |(payload, record): (Option<Payload>, &Option<&Record>)| {
        let (payload, record) = (payload?, (*record)?);
        let listed: Vec<_> = payload.collections.keys().zip(read.by_ref()).collect();
        let collection = |(name, found): (&String, Option<Sharded>)| Some((port_of(spec, name)?, Arc::new(found?)));
        let item = |(name, artifact): (String, Artifact)| Some((port_of(spec, &name)?, Output::new(artifact)));
        Some(Made {
            collections: listed.into_iter().map(collection).collect::<Option<_>>()?,
            items: payload.items.into_iter().map(item).collect::<Option<_>>()?,
            wall_us: record.wall_us,
            bytes: record.bytes,
            put: 0,
            fetched: (mixed && record.fetched).then(|| record.maker.as_str().into()),
        })
    };
    Ok(payloads.into_iter().zip(records).map(made).collect())
}

/// A record of an action, a lane or a part of one.
pub fn record(namespace: &str, key: Key, label: &str, preimage: String, payload: &Payload) -> Record {
    Record {
        namespace: namespace.into(),
        key,
        label: label.into(),
        preimage,
        payload: serde_json::to_string(payload).expect("strings and digests always serialise"),
        recipe: String::new(),
        derived: namespace != ACTION,
        transient: false,
        refs: payload.refs(),
        trees: payload.trees(),
        wall_us: 0,
        bytes: 0,
        when: now(),
        maker: maker(),
        fetched: false,
    }
}

/// A record of a text that is no output.
pub fn note(namespace: &str, key: Key, label: &str, preimage: String, payload: String) -> Record {
    let record = record(namespace, key, label, preimage, &Payload::default());
    Record { payload, derived: false, ..record }
}

/// Records a text; the last one counts.
///
/// # Errors
/// If the store cannot be written.
pub fn keep_last(store: &Store, record: &Record) -> Result<(), CacheError> {
    match store.record(record)? {
        Recorded::New | Recorded::Same => Ok(()),
        Recorded::Conflict { .. } => store.replace(record),
    }
}
