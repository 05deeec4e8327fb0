//! One action, from its inputs to its outputs: key, look-up, claim, run, record. Done on worker threads.
//!
//! Knows nothing of lanes, nodes and what comes next. Actions are looked up by the batch, because most are there already and a
//! look-up costs less than passing a message; those that are not are run by the batch, too, when they are known to be short.

use super::{
    action::{FILE_PORT, action_key, check_outputs, files_artifact, panicked},
    records::{self, ACTION, Made, Payload, StoreBlobs, port_of},
    transient::Pool,
    whole::{Listed, Output, Whole},
};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::{
    collections::{BTreeMap, HashSet},
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};
use tauflow_cache::{CacheError, Claim, Digest, Key, Record, Recorded, Store};
use tauflow_contract::{
    Action, ActionKey, Artifact, Collection, Context, ItemKey, KindError, KindSpec, NodeKind, Progress, Projection,
};

/// What all actions of a lane share.
pub struct Task {
    /// Number of the lane.
    pub lane: usize,
    /// The kind.
    pub kind: Arc<dyn NodeKind>,
    /// What the kind states.
    pub spec: KindSpec,
    /// The group of outputs.
    pub group: &'static str,
    /// The params that each action reads.
    pub projection: Projection,
    /// What of the machine decides its outputs.
    pub environment: Value,
    /// It makes measurements, and must have the machine to itself.
    pub alone: bool,
    /// The pipeline's seed.
    pub seed: u64,
    /// Its outputs are handed on in memory.
    pub transient: bool,
    /// Output ports that somebody reads.
    pub read: Vec<usize>,
}

/// An action to be done.
pub struct Job {
    /// Which of its lane's slots it is.
    pub slot: usize,
    /// The item.
    pub item: Option<ItemKey>,
    /// Artifacts by input port.
    pub each: Vec<(usize, Arc<Output>)>,
    /// Files outside, of a source's item.
    pub files: Vec<(String, PathBuf)>,
    /// What its look-up found.
    pub todo: Option<Box<Todo>>,
}

/// Actions of one lane that are done together.
pub struct Batch {
    /// The lane's.
    pub task: Arc<Task>,
    /// Collections by input port, the same for all.
    pub whole: Vec<(usize, Arc<Whole>)>,
    /// The actions.
    pub jobs: Vec<Job>,
}

/// An action that has been looked up and must run.
pub struct Todo {
    key: ActionKey,
    hash: Key,
    file: Option<Artifact>,
    /// What it gave before, if it runs only to be compared.
    before: Option<Made>,
}

impl Todo {
    /// An action that is known by its key; `before` is what it gave, if it runs only to be compared.
    pub fn new(key: ActionKey, file: Option<Artifact>, before: Option<Made>) -> Self {
        Self { hash: key.hash(), key, file, before }
    }
}

/// What it takes to do an action, beside its key: its inputs, where the key has their digests alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
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

/// What became of an action.
pub enum Outcome {
    /// It was done before.
    Hit(Made),
    /// It was done now.
    Ran(Made),
    /// It must run.
    Todo(Box<Todo>),
    /// It would be done, in a dry run.
    WouldRun,
    /// It failed.
    Failed(String),
    /// Blobs of its inputs are missing.
    Missing(Digest),
    /// The run is being stopped.
    Cancelled,
    /// The store failed: the run must stop.
    Fatal(CacheError),
}

/// What became of an action, and what should be told to people.
pub struct Reply {
    /// Its lane and slot.
    pub slot: (usize, usize),
    /// What became of it.
    pub outcome: Outcome,
    /// Its key, if keys are kept and it came that far.
    pub key: Option<Box<ActionKey>>,
    /// Content digest of the files outside that it read.
    pub file: Option<Digest>,
    /// A remark, such as two outputs for one key.
    pub warning: Option<String>,
    /// What it took now, in microseconds.
    pub spent_us: u64,
}

impl Reply {
    /// An outcome without more.
    pub fn of(slot: (usize, usize), outcome: Outcome) -> Self {
        Self { slot, outcome, key: None, file: None, warning: None, spent_us: 0 }
    }
}

/// What all actions of a run share.
pub struct Bench<'a> {
    /// The store.
    pub store: &'a Store,
    /// Blobs that are in memory only.
    pub pool: &'a Pool,
    /// Set when actions should stop.
    pub stop: &'a AtomicBool,
    /// Look up only, run nothing.
    pub dry: bool,
    /// Give the keys back.
    pub keep_keys: bool,
    /// The share of hits that run again and are compared.
    pub recheck: f64,
    /// Blobs that were found missing: a record that names one counts only when it is there again.
    pub wanted: &'a HashSet<Digest>,
}

/// The key of an action, its hash, and the artifact of the files outside that it reads.
type Keyed = (ActionKey, Key, Option<Artifact>);
/// Longest time between two looks whether another process is through with an action.
const LONG_WAIT: Duration = Duration::from_millis(100);

/// What an action gave: what is recorded of it, and its collections by port.
type Given = (Payload, Vec<(usize, Arc<Whole>)>, u64);

impl Bench<'_> {
    /// Looks actions up.
    pub fn look_up(&self, batch: Batch) -> Vec<Reply> {
        let task = &batch.task;
        let jobs: Vec<_> = batch.jobs.iter().map(|job| (job.slot, self.key_of(task, &batch.whole, job))).collect();
        let hashes: Vec<Key> = jobs.iter().filter_map(|(_, key)| key.as_ref().ok().map(|(_, hash, _)| *hash)).collect();
        let mut records = self.store.lookup_many(ACTION, &hashes).into_iter();
        let reply = |(slot, key): (usize, Result<Keyed, Outcome>)| {
            let slot = (task.lane, slot);
            let (key, hash, file) = match key {
                Ok(found) => found,
                Err(outcome) => return Reply::of(slot, outcome),
            };
            let record = records.next().flatten();
            let digest = file.as_ref().map(Artifact::digest);
            let kept = self.keep_keys.then(|| Box::new(key.clone()));
            let outcome = match self.found(task, record.as_deref()) {
                Err(error) => Outcome::Fatal(error),
                Ok(Some(made)) if self.dry || !self.sampled(&hash) => Outcome::Hit(made),
                Ok(None) if self.dry => Outcome::WouldRun,
                Ok(before) => Outcome::Todo(Box::new(Todo { key, hash, file, before })),
            };
            Reply { slot, outcome, key: kept, file: digest, warning: None, spent_us: 0 }
        };
        jobs.into_iter().map(reply).collect()
    }

    /// The key of an action, its hash, and the artifact of the files that it reads.
    fn key_of(&self, task: &Task, whole: &[(usize, Arc<Whole>)], job: &Job) -> Result<Keyed, Outcome> {
        let derive = || {
            let file = match self.import(job) {
                Ok(Ok(file)) => file,
                Ok(Err(message)) => return Err(Outcome::Failed(message)),
                Err(error) => return Err(Outcome::Fatal(error)),
            };
            let key = action_key(task, whole, job, file.as_ref());
            let hash = key.hash();
            Ok((key, hash, file))
        };
        catch_unwind(AssertUnwindSafe(derive)).unwrap_or_else(|panic| Err(Outcome::Failed(panicked(&panic))))
    }

    /// Does an action that has been looked up.
    pub fn perform(&self, batch: &Batch, job: Job, progress: &dyn Progress) -> Reply {
        let start = Instant::now();
        let slot = (batch.task.lane, job.slot);
        let file = job.todo.as_ref().and_then(|todo| todo.file.as_ref().map(Artifact::digest));
        let mut reply = Reply { file, ..Reply::of(slot, Outcome::Cancelled) };
        let result = catch_unwind(AssertUnwindSafe(|| self.attempt(batch, job, progress, &mut reply.warning)));
        reply.outcome = match result {
            Ok(Ok((outcome, key))) => {
                reply.key = self.keep_keys.then(|| Box::new(key));
                outcome
            }
            Ok(Err(error)) => Outcome::Fatal(error),
            Err(panic) => Outcome::Failed(panicked(&panic)),
        };
        reply.spent_us = start.elapsed().as_micros() as u64;
        reply
    }

    fn attempt(
        &self,
        batch: &Batch,
        mut job: Job,
        progress: &dyn Progress,
        warning: &mut Option<String>,
    ) -> Result<(Outcome, ActionKey), CacheError> {
        let task = &*batch.task;
        let Some(todo) = job.todo.take() else {
            let lost = KindError::Internal("an action was to run that had not been looked up".into());
            return Ok((Outcome::Failed(lost.to_string()), action_key(task, &batch.whole, &job, None)));
        };
        let Todo { key, hash, file, before } = *todo;
        let Some(claim) = self.claim(&hash, progress)? else { return Ok((Outcome::Cancelled, key)) };
        if before.is_none() {
            // Whoever held it, in this process or another, may have done it meanwhile.
            let record = self.store.lookup(ACTION, &hash);
            if let Some(made) = self.found(task, record.as_deref())? {
                return Ok((Outcome::Hit(made), key));
            }
        }
        let start = Instant::now();
        let (payload, collections, put) =
            match self.run(batch, &job, (&key, before.is_some()), file.as_ref(), progress)? {
                Ok(done) => done,
                Err(outcome) => return Ok((outcome, key)),
            };
        let wall_us = start.elapsed().as_micros() as u64;
        let outcome = match before {
            Some(made) => self.compare(task, &hash, &payload, made),
            None => {
                let recipe = self.recipe(batch, &job, file.as_ref())?;
                self.keep(task, &key, hash, (payload, collections, put), (wall_us, recipe), warning)?
            }
        };
        drop(claim);
        Ok((outcome, key))
    }

    /// Waits until nobody else is at this action; none if the run is being stopped first.
    fn claim(&self, hash: &Key, progress: &dyn Progress) -> Result<Option<Claim>, CacheError> {
        let mut wait = Duration::from_millis(1);
        loop {
            if let Some(claim) = self.store.try_claim(hash)? {
                return Ok(Some(claim));
            }
            if self.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            if wait >= LONG_WAIT {
                progress.report(0, 1, "another process is at it; waiting for that");
            }
            thread::sleep(wait);
            wait = (wait * 2).min(LONG_WAIT);
        }
    }

    /// Digests a source's files and imports them.
    fn import(&self, job: &Job) -> Result<Result<Option<Artifact>, String>, CacheError> {
        if job.files.is_empty() {
            return Ok(Ok(None));
        }
        let put = |bytes: &[u8]| if self.dry { Ok(Digest::of(bytes)) } else { self.store.put(bytes) };
        Ok(files_artifact(&job.files, put)?.map(Some))
    }

    fn found(&self, task: &Task, record: Option<&Record>) -> Result<Option<Made>, CacheError> {
        match record {
            Some(record) if self.whole(record)? => records::load(self.store, record, &task.spec),
            _ => Ok(None),
        }
    }

    /// Whether none of the blobs that a reader missed is still missing here.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn whole(&self, record: &Record) -> Result<bool, CacheError> {
        if self.wanted.is_empty() {
            return Ok(true);
        }
        let reached = self.store.reach(&record.refs, &record.trees)?;
        Ok(reached.iter().all(|digest| !self.wanted.contains(digest) || self.is_here(digest)))
    }

    /// Whether a blob is there, stored or in memory.
    pub fn is_here(&self, digest: &Digest) -> bool {
        self.pool.contains(digest) || self.store.contains(digest)
    }

    fn sampled(&self, hash: &Key) -> bool {
        let head = u32::from_le_bytes([hash.0[0], hash.0[1], hash.0[2], hash.0[3]]);
        f64::from(head) < self.recheck * f64::from(u32::MAX)
    }

    /// Runs the kind, checks what it gave, and stores collections. An action that only `checks` what it gave before gets nothing memoised.
    fn run(
        &self,
        batch: &Batch,
        job: &Job,
        (key, checks): (&ActionKey, bool),
        file: Option<&Artifact>,
        progress: &dyn Progress,
    ) -> Result<Result<Given, Outcome>, CacheError> {
        let task = &*batch.task;
        let name = |port: usize| task.spec.inputs[port].name;
        let mut each: BTreeMap<&str, &Artifact> =
            job.each.iter().map(|(port, output)| (name(*port), &output.artifact)).collect();
        if let Some(file) = file {
            each.insert(FILE_PORT, file);
        }
        let mut read: Vec<(&str, &Collection)> = Vec::new();
        for (port, whole) in &batch.whole {
            match whole.collection(self.store)? {
                Ok(collection) => read.push((name(*port), collection)),
                Err(missing) => return Ok(Err(Outcome::Missing(missing))),
            }
        }
        let action = Action {
            params: key.params.clone(),
            item: job.item.as_ref(),
            group: task.group,
            seed: key.seed.unwrap_or(0),
            each,
            whole: read.into_iter().collect(),
        };
        let blobs = StoreBlobs::new(self.store, self.pool, task.transient, checks);
        let context = Context::new(&blobs, progress, self.stop);
        let result = task.kind.run(&context, &action);
        if let Some(error) = blobs.fatal() {
            return Err(error);
        }
        let outputs = match result {
            Ok(outputs) => outputs,
            Err(KindError::Cancelled) => return Ok(Err(Outcome::Cancelled)),
            Err(KindError::MissingBlob(digest)) => return Ok(Err(Outcome::Missing(digest))),
            Err(error) => return Ok(Err(Outcome::Failed(error.to_string()))),
        };
        if let Err(message) = check_outputs(task, &outputs) {
            return Ok(Err(Outcome::Failed(format!("internal error: {message}; please report it"))));
        }
        // Of a transient node, what nobody reads is not even kept in memory.
        let is_read = |name: &&String| port_of(&task.spec, name).is_some_and(|port| task.read.contains(&port));
        let items = outputs.items.iter().filter(|(name, _)| is_read(name)).map(|(_, artifact)| artifact);
        let gathered = outputs.collections.iter().filter(|(name, _)| is_read(name));
        blobs.hand_over(items.chain(gathered.flat_map(|(_, collection)| collection.items.values())))?;
        let mut payload = Payload { items: outputs.items, ..Payload::default() };
        let mut collections = Vec::new();
        for (name, collection) in outputs.collections {
            let Some(port) = port_of(&task.spec, &name) else { continue }; // checked above
            let whole = Whole::of(collection.items.into_iter().map(|(key, artifact)| (key, Output::new(artifact))));
            payload.collections.insert(name, whole.put(self.store)?);
            collections.push((port, Arc::new(whole)));
        }
        Ok(Ok((payload, collections, blobs.made())))
    }

    /// Records what an action gave.
    fn keep(
        &self,
        task: &Task,
        key: &ActionKey,
        hash: Key,
        (payload, collections, put): Given,
        (wall_us, recipe): (u64, String),
        warning: &mut Option<String>,
    ) -> Result<Outcome, CacheError> {
        let mut bytes = payload.items.values().map(Artifact::size).sum::<u64>();
        for (_, whole) in &collections {
            let items = whole.items(self.store)?.unwrap_or_default(); // just made, so at hand
            bytes += items.iter().map(|(_, output)| output.artifact.size()).sum::<u64>();
        }
        let record = records::record(ACTION, hash, task.spec.name, key.preimage(), &payload);
        let record = Record { wall_us, bytes, recipe, ..record };
        if let Recorded::Conflict { existing } = self.store.record(&record)? {
            let other = Payload::of(&existing).unwrap_or_default();
            let differing = other.differs(&payload, &task.spec);
            if !differing.is_empty() {
                *warning = Some(format!(
                    "`{}` gave two different outputs for key {hash}: {}; it is not reproducible, and the first stays \
                     unless its blobs are gone",
                    task.spec.name,
                    differing.join(", ")
                ));
            }
            // The earlier outputs stay, measured ones too, as long as they are whole.
            if existing.refs.iter().chain(&existing.trees).all(|d| self.is_here(d))
                && let Some(made) = records::load(self.store, &existing, &task.spec)?
            {
                return Ok(Outcome::Ran(made));
            }
            self.store.replace(&record)?;
        }
        let port = |(name, artifact): (String, Artifact)| Some((port_of(&task.spec, &name)?, Output::new(artifact)));
        let items = payload.items.into_iter().filter_map(port).collect();
        Ok(Outcome::Ran(Made { items, collections, wall_us, bytes, put }))
    }

    /// What it takes to do an action again, as text.
    fn recipe(&self, batch: &Batch, job: &Job, file: Option<&Artifact>) -> Result<String, CacheError> {
        let name = |port: usize| batch.task.spec.inputs[port].name.to_owned();
        let mut each: BTreeMap<String, Artifact> =
            job.each.iter().map(|(port, output)| (name(*port), output.artifact.clone())).collect();
        each.extend(file.map(|file| (FILE_PORT.to_owned(), file.clone())));
        let mut whole = BTreeMap::new();
        for (port, collection) in &batch.whole {
            whole.insert(name(*port), collection.put(self.store)?);
        }
        let recipe = Recipe { item: job.item.clone(), each, whole };
        Ok(serde_json::to_string(&recipe).expect("keys and digests always serialise"))
    }

    /// What a recheck found.
    fn compare(&self, task: &Task, hash: &Key, payload: &Payload, made: Made) -> Outcome {
        let before = self.store.lookup(ACTION, hash).and_then(|r| Payload::of(&r)).unwrap_or_default();
        let differing = before.differs(payload, &task.spec);
        if differing.is_empty() {
            return Outcome::Ran(made);
        }
        Outcome::Failed(format!(
            "the recheck gave other content on {}: `{}` is not reproducible, or its version should have gone up; the \
             recorded output stays",
            differing.join(", "),
            task.spec.name
        ))
    }
}
