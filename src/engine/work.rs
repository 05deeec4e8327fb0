//! Executes one action on a worker thread: key, look-up, claim, run, record.
//!
//! Does not know lanes, nodes or later work. Actions are looked up by the bundle, because most are there already and a
//! look-up costs less than passing a message; those that are not are run by the bundle, too, when they are known to be
//! short.

use super::{
    action::{action_key, check_outputs, files_artifact, panicked},
    ids::{Id, InputId, SlotId},
    job::{ActionInputs, Bundle, Job, Outcome, Produced, Reply, Task, Todo},
    records::{self, ACTION, Made, Payload, StoreBlobs, port_of},
    sharded::{Listed, Output, Sharded},
    transient::Pool,
};
use std::{
    collections::{BTreeMap, BTreeSet, HashSet},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};
use tauflow_cache::{CacheError, Claim, Digest, Key, Record, Recorded, Store};
use tauflow_contract::{Action, ActionKey, Artifact, Collection, Context, FILE_PORT, KindError, Progress};

/// The data that all actions of a run share.
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

impl Bench<'_> {
    /// Looks actions up.
    pub fn look_up(&self, bundle: Bundle) -> Vec<Reply> {
        let task = &bundle.task;
        let jobs: Vec<_> = bundle.jobs.iter().map(|job| (job.slot, self.key_of(task, &bundle.whole, job))).collect();
        let hashes: Vec<Key> = jobs.iter().filter_map(|(_, key)| key.as_ref().ok().map(|(_, hash, _)| *hash)).collect();
        let mut records = self.store.lookup_many(ACTION, &hashes).into_iter();
        let reply = |(slot, key): (SlotId, Result<Keyed, Outcome>)| {
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
            Reply { key: kept, file: digest, lost: record.is_some(), ..Reply::of(slot, outcome) }
        };
        jobs.into_iter().map(reply).collect()
    }

    /// The key of an action, its hash, and the artifact of the files that it reads.
    fn key_of(&self, task: &Task, whole: &[(InputId, Arc<Sharded>)], job: &Job) -> Result<Keyed, Outcome> {
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
    pub fn perform(&self, bundle: &Bundle, mut job: Job, progress: &dyn Progress) -> Reply {
        let start = Instant::now();
        let slot = (bundle.task.lane, job.slot);
        let file = job.todo.as_ref().and_then(|todo| todo.file.as_ref().map(Artifact::digest));
        let mut reply = Reply { file, ..Reply::of(slot, Outcome::Cancelled) };
        let result = catch_unwind(AssertUnwindSafe(|| self.attempt(bundle, &mut job, progress, &mut reply.warning)));
        reply.outcome = match result {
            Ok(Ok((outcome, key))) => {
                reply.key = self.keep_keys.then(|| Box::new(key));
                outcome
            }
            Ok(Err(error)) => Outcome::Fatal(error),
            Err(panic) => Outcome::Failed(panicked(&panic)),
        };
        if matches!(reply.outcome, Outcome::Missing(_)) {
            match self.missing(bundle, &job) {
                Ok(missing) => reply.missing = missing,
                Err(error) => reply.outcome = Outcome::Fatal(error),
            }
        }
        reply.spent_us = start.elapsed().as_micros() as u64;
        reply
    }

    fn attempt(
        &self,
        bundle: &Bundle,
        job: &mut Job,
        progress: &dyn Progress,
        warning: &mut Option<String>,
    ) -> Result<(Outcome, ActionKey), CacheError> {
        let task = &*bundle.task;
        let Some(todo) = job.todo.take() else {
            let lost = KindError::Internal("an action was to run that had not been looked up".into());
            return Ok((Outcome::Failed(lost.to_string()), action_key(task, &bundle.whole, job, None)));
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
        let produced = match self.run(bundle, job, (&key, before.is_some()), file.as_ref(), progress)? {
            Ok(produced) => produced,
            Err(outcome) => return Ok((outcome, key)),
        };
        let wall_us = start.elapsed().as_micros() as u64;
        let outcome = match before {
            Some(made) => self.compare(task, &hash, &produced.payload, made),
            None => {
                let recipe = self.recipe(bundle, job, file.as_ref())?;
                self.keep(task, (&key, hash), produced, (wall_us, recipe), warning)?
            }
        };
        drop(claim);
        Ok((outcome, key))
    }

    /// All blobs of an action's inputs that are missing or damaged. They are asked for at once: one at a time, each
    /// would take a pass over the graph. Looked for only where one was missed, as all are read.
    fn missing(&self, bundle: &Bundle, job: &Job) -> Result<Vec<Digest>, CacheError> {
        let mut asked: BTreeSet<Digest> = BTreeSet::new();
        let mut missing = Vec::new();
        for (_, sharded) in &bundle.whole {
            let (blobs, listings) = sharded.blobs(self.store)?;
            asked.extend(blobs);
            missing.extend(listings);
        }
        asked.extend(job.each.iter().flat_map(|(_, output)| output.artifact.parts.values().copied()));
        for digest in asked {
            if self.stop.load(Ordering::Relaxed) {
                break;
            }
            if !self.pool.contains(&digest) && self.store.get(&digest)?.is_none() {
                missing.push(digest);
            }
        }
        Ok(missing)
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
                progress.report(0, 1, "waiting for another process that runs this action");
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
            Some(record) if self.intact(record)? => records::load(self.store, record, &task.spec, task.group),
            _ => Ok(None),
        }
    }

    /// Whether none of the blobs that a reader missed is still missing here.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn intact(&self, record: &Record) -> Result<bool, CacheError> {
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

    /// Runs the kind, checks what it gave, and stores collections. An action that only `checks` what it gave before
    /// gets nothing memoised.
    fn run(
        &self,
        bundle: &Bundle,
        job: &Job,
        (key, checks): (&ActionKey, bool),
        file: Option<&Artifact>,
        progress: &dyn Progress,
    ) -> Result<Result<Produced, Outcome>, CacheError> {
        let task = &*bundle.task;
        let name = |input: InputId| task.spec.inputs[input.place()].name;
        let mut each: BTreeMap<&str, &Artifact> =
            job.each.iter().map(|(input, output)| (name(*input), &output.artifact)).collect();
        if let Some(file) = file {
            each.insert(FILE_PORT, file);
        }
        let mut read: Vec<(&str, &Collection)> = Vec::new();
        for (input, sharded) in &bundle.whole {
            match sharded.collection(self.store)? {
                Ok(collection) => read.push((name(*input), collection)),
                Err(missing) => return Ok(Err(Outcome::Missing(missing))),
            }
        }
        let action = Action {
            params: key.basis.params.clone(),
            item: job.item.as_ref(),
            group: task.group,
            seed: key.basis.seed.unwrap_or(0),
            each,
            all: read.into_iter().collect(),
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
        // Unread outputs of a transient node are not even kept in memory.
        let is_read = |name: &&String| port_of(&task.spec, name).is_some_and(|port| task.read.contains(&port));
        let items = outputs.items.iter().filter(|(name, _)| is_read(name)).map(|(_, artifact)| artifact);
        let gathered = outputs.collections.iter().filter(|(name, _)| is_read(name));
        blobs.hand_over(items.chain(gathered.flat_map(|(_, collection)| collection.items.values())))?;
        let mut payload = Payload { items: outputs.items, ..Payload::default() };
        let mut collections = Vec::new();
        for (name, collection) in outputs.collections {
            let Some(port) = port_of(&task.spec, &name) else { continue }; // checked above
            let sharded = Sharded::of(collection.items.into_iter().map(|(key, artifact)| (key, Output::new(artifact))));
            payload.collections.insert(name, sharded.put(self.store)?);
            collections.push((port, Arc::new(sharded)));
        }
        Ok(Ok(Produced { payload, collections, put: blobs.made() }))
    }

    /// Records what an action gave.
    fn keep(
        &self,
        task: &Task,
        (key, hash): (&ActionKey, Key),
        Produced { payload, collections, put }: Produced,
        (wall_us, recipe): (u64, String),
        warning: &mut Option<String>,
    ) -> Result<Outcome, CacheError> {
        let mut bytes = payload.items.values().map(Artifact::size).sum::<u64>();
        for (_, sharded) in &collections {
            let items = sharded.items(self.store)?.unwrap_or_default(); // just made, so at hand
            bytes += items.iter().map(|(_, output)| output.artifact.size()).sum::<u64>();
        }
        let record = records::record(ACTION, hash, task.spec.name, key.preimage(), &payload);
        let record = Record { wall_us, bytes, recipe, transient: task.transient, ..record };
        if let Recorded::Conflict { existing } = self.store.record(&record)? {
            let other = Payload::of(&existing).unwrap_or_default();
            let differing = other.differs(&payload, &task.spec);
            if !differing.is_empty() {
                *warning = Some(format!(
                    "`{}` produced two different outputs for key {hash}: {}; it is not reproducible. The first is \
                    kept unless its blobs are missing",
                    task.spec.name,
                    differing.join(", ")
                ));
            }
            // The earlier outputs stay, measured ones too, as long as they are whole.
            if existing.refs.iter().chain(&existing.trees).all(|d| self.is_here(d))
                && let Some(made) = records::load(self.store, &existing, &task.spec, task.group)?
            {
                return Ok(Outcome::Ran(made));
            }
            self.store.replace(&record)?;
        }
        let port = |(name, artifact): (String, Artifact)| Some((port_of(&task.spec, &name)?, Output::new(artifact)));
        let items = payload.items.into_iter().filter_map(port).collect();
        Ok(Outcome::Ran(Made { items, collections, wall_us, bytes, put }))
    }

    /// The given inputs of an action, as text.
    fn recipe(&self, bundle: &Bundle, job: &Job, file: Option<&Artifact>) -> Result<String, CacheError> {
        let name = |input: InputId| bundle.task.spec.inputs[input.place()].name.to_owned();
        let mut each: BTreeMap<String, Artifact> =
            job.each.iter().map(|(input, output)| (name(*input), output.artifact.clone())).collect();
        each.extend(file.map(|file| (FILE_PORT.to_owned(), file.clone())));
        let mut whole: BTreeMap<String, Listed> = BTreeMap::new();
        for (input, sharded) in &bundle.whole {
            whole.insert(name(*input), sharded.put(self.store)?);
        }
        let recipe = ActionInputs { item: job.item.clone(), each, whole };
        Ok(serde_json::to_string(&recipe).expect("keys and digests always serialise"))
    }

    /// The result of a recheck.
    fn compare(&self, task: &Task, hash: &Key, payload: &Payload, made: Made) -> Outcome {
        let before = self.store.lookup(ACTION, hash).and_then(|r| Payload::of(&r)).unwrap_or_default();
        let differing = before.differs(payload, &task.spec);
        if differing.is_empty() {
            return Outcome::Ran(made);
        }
        Outcome::Failed(format!(
            "the recheck produced different content on {}: `{}` is not reproducible, or its version was not \
            increased; the recorded output is kept",
            differing.join(", "),
            task.spec.name
        ))
    }
}
