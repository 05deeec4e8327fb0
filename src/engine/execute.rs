//! One action, from its inputs to its record: claim, run, check, store, record.
//!
//! Everything that runs actions calls [`execute`]: the threads of a run, its child processes, and `tauflow exec`.
//! It knows no pipeline, lane or slot.

use super::{
    EngineError,
    action::{check_outputs, panicked},
    holdings::Holdings,
    ids::{Id, InputId, PortId},
    measured::Fetched,
    output::Output,
    records::{self, ACTION, Made, Payload, QUARANTINE, StoreBlobs, port_of},
    sharded::{Listed, Sharded},
    sighted,
};
use serde::{Deserialize, Serialize};
use std::{
    collections::{BTreeMap, BTreeSet},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};
use tauflow_cache::{CacheError, Claim, Digest, Key, Record, Recorded, Store};
use tauflow_contract::{
    Action, ActionKey, Artifact, Collection, Context, FILE_PORT, ItemKey, KindError, KindSpec, NodeKind, Progress, Seen,
};

/// Longest time between two checks whether another process has finished an action.
const LONG_WAIT: Duration = Duration::from_millis(100);

/// The kind and output group of an action. All actions of a lane share it.
pub struct Producer {
    /// The kind.
    pub kind: Arc<dyn NodeKind>,
    /// The spec of the kind.
    pub spec: KindSpec,
    /// The group of outputs.
    pub group: &'static str,
    /// Its outputs are handed on in memory.
    pub transient: bool,
    /// Output ports that somebody reads.
    pub read: Vec<PortId>,
    /// Which records of an upstream count.
    pub fetched: Fetched,
    /// Other machines have other keys: they name a machine, a library or a device, or what is read may differ there.
    pub bound: bool,
}

impl Producer {
    fn input(&self, input: InputId) -> &str {
        self.spec.inputs[input.place()].name
    }
}

/// Collections by input port.
pub type Whole = Vec<(InputId, Arc<Sharded>)>;

/// An action that must run, with everything that it takes.
pub struct PreparedAction {
    /// The kind and output group that make its outputs.
    pub producer: Arc<Producer>,
    /// Its key.
    pub key: ActionKey,
    /// The key's hash.
    pub hash: Key,
    /// The item.
    pub item: Option<ItemKey>,
    /// Artifacts by input port.
    pub each: Vec<(InputId, Arc<Output>)>,
    /// Collections by input port.
    pub whole: Arc<Whole>,
    /// The files outside that it reads.
    pub file: Option<Artifact>,
    /// Its earlier outputs, if it runs only to be compared.
    pub before: Option<Made>,
}

/// The inputs of an action. The key contains only their digests.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActionInputs {
    /// The item.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub item: Option<ItemKey>,
    /// Artifacts by input port; the files outside of a source's item are on the port `file`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub each: BTreeMap<String, Artifact>,
    /// Collections by input port.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub whole: BTreeMap<String, Listed>,
}

/// The outcome of an action.
pub enum Outcome {
    /// Somebody else did it meanwhile.
    Hit(Made),
    /// It ran.
    Ran(Made),
    /// It failed.
    Failed(String),
    /// These blobs of its inputs are missing; the first is the one that it was looking for.
    Missing(Vec<Digest>),
    /// It belongs to another shard of the run, by its number, which has not done it.
    Elsewhere(u32),
    /// It was stopped.
    Cancelled,
    /// The store failed, or what executes: the run must stop.
    Fatal(EngineError),
}

/// The result of [`execute`].
pub struct Execution {
    /// The outcome of the action.
    pub outcome: Outcome,
    /// The key of its record, if it has one now: files that programs opened are part of it.
    pub recorded: Option<Key>,
    /// A remark, such as two outputs for one key.
    pub warning: Option<String>,
    /// Wall time in microseconds.
    pub spent_us: u64,
}

impl Execution {
    /// An outcome without more.
    pub fn of(outcome: Outcome) -> Self {
        Self { outcome, recorded: None, warning: None, spent_us: 0 }
    }
}

/// Runs an action and records its outputs, unless somebody else does so meanwhile. Holds its claim until then.
pub fn execute(
    action: &PreparedAction,
    holdings: Holdings<'_>,
    stop: &AtomicBool,
    progress: &dyn Progress,
) -> Execution {
    let start = Instant::now();
    let of = Executing { action, producer: &action.producer, holdings, stop, progress };
    let mut told = Told::default();
    let result = catch_unwind(AssertUnwindSafe(|| of.claimed(&mut told)));
    let outcome = match result {
        Ok(Ok(Outcome::Missing(first))) => of.missing(first).unwrap_or_else(|e| Outcome::Fatal(e.into())),
        Ok(Ok(outcome)) => outcome,
        Ok(Err(error)) => Outcome::Fatal(error.into()),
        Err(panic) => Outcome::Failed(panicked(&panic)),
    };
    let Told { recorded, warning } = told;
    Execution { outcome, recorded, warning, spent_us: start.elapsed().as_micros() as u64 }
}

/// Sets a record from an upstream aside that differs from what its action gives here, and tells who made it.
fn quarantine(store: &Store, record: &Record, differing: &[String]) -> Result<String, CacheError> {
    // It keeps its text, and none of its blobs.
    let aside = Record {
        namespace: QUARANTINE.into(),
        transient: true,
        refs: Vec::new(),
        trees: Vec::new(),
        // Roll-ups of before may contain it.
        when: records::now(),
        ..record.clone()
    };
    if store.record(&aside)? != Recorded::New {
        store.replace(&aside)?;
    }
    let maker = if record.maker.is_empty() { "an unknown machine" } else { record.maker.as_str() };
    Ok(format!(
        "a result of `{}` from the upstream is not what this machine computes: {}, key {}. It was made by {maker}. It \
         is quarantined, and this machine's result is used; roll-ups from upstreams, and those \
         of before, are no longer trusted",
        record.label,
        differing.join(", "),
        record.key
    ))
}

/// The outputs of an action that ran, before they are recorded.
struct Produced {
    payload: Payload,
    collections: Vec<(PortId, Arc<Sharded>)>,
    /// Bytes of the blobs that it put.
    put: u64,
    /// The files that programs opened.
    seen: Option<Seen>,
}

/// The fields of [`Execution`] beside the outcome.
#[derive(Default)]
struct Told {
    recorded: Option<Key>,
    warning: Option<String>,
}

/// An action that is being executed.
struct Executing<'a> {
    action: &'a PreparedAction,
    producer: &'a Producer,
    holdings: Holdings<'a>,
    stop: &'a AtomicBool,
    progress: &'a dyn Progress,
}

impl Executing<'_> {
    fn claimed(&self, told: &mut Told) -> Result<Outcome, CacheError> {
        let Some(claim) = self.claim()? else { return Ok(Outcome::Cancelled) };
        let (store, producer) = (self.holdings.store, self.producer);
        if self.action.before.is_none() {
            // Whoever held it, in this process or another, may have done it meanwhile.
            let record = self.action.recorded(store)?;
            if let Some(made) = self.holdings.made(record.as_deref(), producer)? {
                told.recorded = record.map(|record| record.key);
                return Ok(Outcome::Hit(made));
            }
        }
        let start = Instant::now();
        let produced = match self.produce()? {
            Ok(produced) => produced,
            Err(outcome) => return Ok(outcome),
        };
        let wall_us = start.elapsed().as_micros() as u64;
        let outcome = match &self.action.before {
            Some(made) => self.compare(produced, made, wall_us, told)?,
            None => self.keep(produced, wall_us, told)?,
        };
        drop(claim);
        Ok(outcome)
    }

    /// Waits until nobody else is at this action; none if the run is being stopped first.
    fn claim(&self) -> Result<Option<Claim>, CacheError> {
        let mut wait = Duration::from_millis(1);
        // Another process may know of other files.
        let action = self.action;
        let claimed = if action.runs_programs() { sighted::first(&action.key).hash() } else { action.hash };
        loop {
            if let Some(claim) = self.holdings.store.try_claim(&claimed)? {
                return Ok(Some(claim));
            }
            if self.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            if wait >= LONG_WAIT {
                self.progress.report(0, 1, "waiting for another process that executes this action");
            }
            thread::sleep(wait);
            wait = (wait * 2).min(LONG_WAIT);
        }
    }

    /// Runs the kind, checks what it gave, and stores collections. An action that is only compared with what it gave
    /// before gets nothing memoised.
    fn produce(&self) -> Result<Result<Produced, Outcome>, CacheError> {
        let Self { action, producer, .. } = *self;
        let Holdings { store, pool, .. } = self.holdings;
        let mut each: BTreeMap<&str, &Artifact> =
            action.each.iter().map(|(input, output)| (producer.input(*input), &output.artifact)).collect();
        if let Some(file) = &action.file {
            each.insert(FILE_PORT, file);
        }
        let mut all: BTreeMap<&str, &Collection> = BTreeMap::new();
        for (input, sharded) in action.whole.iter() {
            match sharded.collection(store)? {
                Ok(collection) => all.insert(producer.input(*input), collection),
                Err(missing) => return Ok(Err(Outcome::Missing(vec![missing]))),
            };
        }
        let basis = &action.key.basis;
        let (params, seed) = (basis.params.clone(), basis.seed.unwrap_or(0));
        let given = Action { params, item: action.item.as_ref(), group: producer.group, seed, each, all };
        let blobs = StoreBlobs::new(store, pool, producer.transient, action.before.is_some());
        let result = producer.kind.run(&Context::new(&blobs, self.progress, self.stop), &given);
        if let Some(error) = blobs.fatal() {
            return Err(error);
        }
        let outputs = match result {
            Ok(outputs) => outputs,
            Err(KindError::Cancelled) => return Ok(Err(Outcome::Cancelled)),
            Err(KindError::MissingBlob(digest)) => return Ok(Err(Outcome::Missing(vec![digest]))),
            Err(error) => return Ok(Err(Outcome::Failed(error.to_string()))),
        };
        if let Err(message) = check_outputs(&producer.spec, producer.group, &outputs) {
            return Ok(Err(Outcome::Failed(format!("internal error: {message}; please report it"))));
        }
        // Outputs of a transient node that no node reads are not even kept in memory.
        let is_read = |name: &&String| port_of(&producer.spec, name).is_some_and(|port| producer.read.contains(&port));
        let items = outputs.items.iter().filter(|(name, _)| is_read(name)).map(|(_, artifact)| artifact);
        let gathered = outputs.collections.iter().filter(|(name, _)| is_read(name));
        blobs.hand_over(items.chain(gathered.flat_map(|(_, collection)| collection.items.values())))?;
        let seen = outputs.seen;
        let mut payload = Payload { items: outputs.items, ..Payload::default() };
        let mut collections = Vec::new();
        for (name, collection) in outputs.collections {
            let Some(port) = port_of(&producer.spec, &name) else { continue }; // checked above
            let sharded = Sharded::of(collection.items.into_iter().map(|(key, artifact)| (key, Output::new(artifact))));
            payload.collections.insert(name, sharded.put(store)?);
            collections.push((port, Arc::new(sharded)));
        }
        Ok(Ok(Produced { payload, collections, put: blobs.made(), seen }))
    }

    /// Records what an action gave.
    fn keep(&self, produced: Produced, wall_us: u64, told: &mut Told) -> Result<Outcome, CacheError> {
        let Produced { payload, collections, put, seen } = produced;
        let (action, store) = (self.action, self.holdings.store);
        let Producer { spec, group, transient, .. } = self.producer;
        // Blobs that come from the inputs, such as those of the scenes of a split, are not of this action.
        let mut known: BTreeSet<Digest> =
            action.each.iter().flat_map(|(_, of)| of.artifact.parts.values()).copied().collect();
        // Only of the action of a whole node: with one for each item, this would take the square of the items.
        for (_, sharded) in action.whole.iter().filter(|_| action.item.is_none()) {
            known.extend(sharded.blobs(store)?.0);
        }
        let mut new = |artifact: &Artifact| {
            let of = artifact.parts.values().filter(|digest| known.insert(**digest));
            of.fold(0, |sum: u64, digest| sum.saturating_add(digest.size))
        };
        let mut bytes = payload.items.values().map(&mut new).sum::<u64>();
        for (_, sharded) in &collections {
            let items = sharded.items(store)?.unwrap_or_default(); // just made, so at hand
            bytes += items.iter().map(|(_, output)| new(&output.artifact)).sum::<u64>();
        }
        let recipe = serde_json::to_string(&action.given(store)?).expect("keys and digests always serialise");
        // The files that a program opened are part of the key, and known only now.
        let full = seen.as_ref().map(|seen| sighted::full(&action.key, seen));
        let (key, hash) = full.as_ref().map_or((&action.key, action.hash), |key| (key, key.hash()));
        told.recorded = Some(hash);
        if let Some(seen) = &seen {
            sighted::keep(store, key, seen)?;
            told.warning = sighted::warning(spec.name, seen);
        }
        let record = records::record(ACTION, hash, spec.name, key.preimage(), &payload);
        let record = Record { wall_us, bytes, recipe, transient: *transient, ..record };
        let recorded = store.record(&record)?;
        if let Recorded::Same = recorded
            && store.read(ACTION, &hash).is_some_and(|known| !self.producer.fetched.counts(&known))
        {
            store.replace(&record)?;
        }
        if let Recorded::Conflict { existing } = recorded {
            let other = Payload::of(&existing).unwrap_or_default();
            let differing = other.differs(&payload, spec);
            if !differing.is_empty() {
                told.warning = Some(format!(
                    "`{}` gave two different outputs for key {}: {}; it is not reproducible, and the first stays \
                     unless its blobs are gone",
                    spec.name,
                    hash,
                    differing.join(", ")
                ));
            }
            // The earlier outputs stay, measured ones too, as long as they are whole and were not quarantined.
            if action.before.is_none()
                && self.producer.fetched.counts(&existing)
                && existing.refs.iter().chain(&existing.trees).all(|d| self.holdings.is_here(d))
                && let Some(made) = records::load(store, &existing, spec, group)?
            {
                return Ok(Outcome::Ran(made));
            }
            store.replace(&record)?;
        }
        let port = |(name, artifact): (String, Artifact)| Some((port_of(spec, &name)?, Output::new(artifact)));
        let items = payload.items.into_iter().filter_map(port).collect();
        Ok(Outcome::Ran(Made { items, collections, wall_us, bytes, put, fetched: None }))
    }

    /// The outcome of a recheck or an audit.
    fn compare(&self, produced: Produced, made: &Made, wall_us: u64, told: &mut Told) -> Result<Outcome, CacheError> {
        let (spec, store) = (&self.producer.spec, self.holdings.store);
        let record = store.lookup(ACTION, &self.action.hash);
        let before = record.as_deref().and_then(Payload::of).unwrap_or_default();
        let differing = before.differs(&produced.payload, spec);
        if differing.is_empty() {
            return Ok(Outcome::Ran(made.clone()));
        }
        if let Some(record) = record.as_deref().filter(|record| record.fetched && before.is_portable(spec)) {
            let warning = quarantine(store, record, &differing)?;
            let outcome = self.keep(produced, wall_us, told)?;
            told.warning = Some(warning);
            return Ok(outcome);
        }
        let why = match self.action.runs_programs() {
            true => {
                "its program probably depends on something that is not in the key, such as the network, the time, a \
                 random seed, or a file that is not traced; name files in `depends` and environment variables in \
                 `variables`"
            }
            false => "it is not reproducible, or its version should have gone up",
        };
        Ok(Outcome::Failed(format!(
            "the recheck gave other content on {} of `{}`: {why}; the recorded output stays",
            differing.join(", "),
            spec.name
        )))
    }

    /// All blobs of an action's inputs that are missing or damaged, after the `first`. They are asked for at once: one
    /// at a time, each would take a pass over the graph. Looked for only where one was missed, as all are read.
    fn missing(&self, mut missing: Vec<Digest>) -> Result<Outcome, CacheError> {
        let mut asked: BTreeSet<Digest> = BTreeSet::new();
        for (_, sharded) in self.action.whole.iter() {
            let (blobs, listings) = sharded.blobs(self.holdings.store)?;
            asked.extend(blobs);
            missing.extend(listings);
        }
        asked.extend(self.action.each.iter().flat_map(|(_, output)| output.artifact.parts.values().copied()));
        for digest in asked {
            if self.stop.load(Ordering::Relaxed) {
                break;
            }
            if !self.holdings.is_sound(&digest)? {
                missing.push(digest);
            }
        }
        Ok(Outcome::Missing(missing))
    }
}

impl PreparedAction {
    /// True if it runs programs outside.
    pub fn runs_programs(&self) -> bool {
        self.producer.kind.runs_programs(&self.key.basis.params)
    }

    /// Its record as the files outside are now.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn recorded(&self, store: &Store) -> Result<Option<Arc<Record>>, CacheError> {
        match self.runs_programs() {
            true => Ok(sighted::find_many(store, &[&self.key])?.remove(0).record), // one for each key
            false => Ok(store.lookup(ACTION, &self.hash)),
        }
    }

    /// The inputs of the action, for running it again.
    ///
    /// # Errors
    /// If the store cannot be written: it keeps the listings of collections.
    pub fn given(&self, store: &Store) -> Result<ActionInputs, CacheError> {
        let name = |input: InputId| self.producer.input(input).to_owned();
        let mut each: BTreeMap<String, Artifact> =
            self.each.iter().map(|(input, output)| (name(*input), output.artifact.clone())).collect();
        each.extend(self.file.iter().map(|file| (FILE_PORT.to_owned(), file.clone())));
        let mut whole: BTreeMap<String, Listed> = BTreeMap::new();
        for (input, sharded) in self.whole.iter() {
            whole.insert(name(*input), sharded.put(store)?);
        }
        Ok(ActionInputs { item: self.item.clone(), each, whole })
    }
}
