//! One action, from its inputs to its outputs: key, look-up, claim, run, record. Runs on a worker thread.
//!
//! Knows nothing of lanes, nodes and what comes next.

use super::records::{self, ACTION, Made, Payload, StoreBlobs, Whole};
use std::{
    collections::{BTreeMap, HashSet},
    fs,
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};
use tauflow_cache::{CacheError, Digest, Record, Recorded, Store};
use tauflow_contract::{
    Action, ActionKey, Artifact, Collection, Context, FORMAT_VERSION, ItemKey, KindError, KindSpec, Mode, NodeKind,
    Outputs, Progress, derive_seed,
};

/// Media type of files outside that a source reads.
const FILES: &str = "tauflow/files";
/// The port on which a source's action finds them.
pub const FILE_PORT: &str = "file";

/// What an action gave: what is recorded of it, and its collections by port.
type Given = (Payload, BTreeMap<String, Arc<Whole>>);

/// The artifact of files outside; `put` digests or stores the bytes of each.
///
/// # Errors
/// In words if a file cannot be read; whatever `put` says.
pub fn files_artifact(
    files: &[(String, PathBuf)],
    put: impl Fn(&[u8]) -> Result<Digest, CacheError>,
) -> Result<Result<Artifact, String>, CacheError> {
    let mut parts = Vec::new();
    for (name, path) in files {
        match fs::read(path) {
            Ok(bytes) => parts.push((name.clone(), put(&bytes)?)),
            Err(error) => {
                return Ok(Err(format!("cannot read `{}`: {error}; mend it or take it away", path.display())));
            }
        }
    }
    Ok(Ok(Artifact::tree(FILES, parts)))
}

/// An action to be done.
#[derive(Clone)]
pub struct Job {
    /// Which lane it belongs to, and which of its slots it is.
    pub slot: (usize, usize),
    /// The kind.
    pub kind: Arc<dyn NodeKind>,
    /// What the kind states.
    pub spec: KindSpec,
    /// The group of outputs.
    pub group: &'static str,
    /// The item.
    pub item: Option<ItemKey>,
    /// The node's params, resolved.
    pub params: serde_json::Value,
    /// The pipeline's seed.
    pub seed: u64,
    /// Artifacts by port.
    pub each: Vec<(&'static str, Arc<Artifact>)>,
    /// Collections by port.
    pub whole: Vec<(&'static str, Arc<Whole>)>,
    /// Files outside, of a source's item.
    pub files: Vec<(String, PathBuf)>,
}

/// What became of it.
pub enum Outcome {
    /// It was done before.
    Hit(Made),
    /// It was done now.
    Ran(Made),
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

/// What became of an action, its key, and what should be told to people.
pub struct Reply {
    /// The action.
    pub slot: (usize, usize),
    /// What became of it.
    pub outcome: Outcome,
    /// Its key, if it came that far.
    pub key: Option<Box<ActionKey>>,
    /// A remark, such as two outputs for one key.
    pub warning: Option<String>,
}

/// What all actions of a run share.
pub struct Bench<'a> {
    /// The store.
    pub store: &'a Store,
    /// Set when actions should stop.
    pub stop: &'a AtomicBool,
    /// Look up only, run nothing.
    pub dry: bool,
    /// The share of hits that run again and are compared.
    pub recheck: f64,
    /// Blobs that were found missing: a record that names one counts only when it is there again.
    pub wanted: &'a HashSet<Digest>,
}

impl Bench<'_> {
    /// Does an action.
    pub fn perform(&self, job: &Job, progress: &dyn Progress) -> Reply {
        let mut reply = Reply { slot: job.slot, outcome: Outcome::Cancelled, key: None, warning: None };
        let result = catch_unwind(AssertUnwindSafe(|| self.attempt(job, progress, &mut reply)));
        reply.outcome = match result {
            Ok(Ok(outcome)) => outcome,
            Ok(Err(error)) => Outcome::Fatal(error),
            Err(panic) => Outcome::Failed(format!("internal error: it panicked: {}; please report it", told(&panic))),
        };
        reply
    }

    /// Whether an action has been done already, or would be in a dry run; none where a worker must see to it. Cheap enough for
    /// the thread that hands out work: passing a job to a worker and back costs several times as much.
    pub fn glance(&self, job: &Job) -> Option<Reply> {
        if !job.files.is_empty() {
            return None;
        }
        let seen = catch_unwind(AssertUnwindSafe(|| {
            let key = action_key(job, None);
            let hash = key.hash();
            let outcome = match self.look_up(&hash) {
                Ok(Some(made)) if self.dry || !self.sampled(&hash) => Outcome::Hit(made),
                Ok(None) if self.dry => Outcome::WouldRun,
                Ok(_) => return None,
                Err(error) => Outcome::Fatal(error),
            };
            Some(Reply { slot: job.slot, outcome, key: Some(Box::new(key)), warning: None })
        }));
        // A panic is told by the worker that meets it again.
        seen.ok().flatten()
    }

    fn attempt(&self, job: &Job, progress: &dyn Progress, reply: &mut Reply) -> Result<Outcome, CacheError> {
        let file = match self.import(job)? {
            Ok(file) => file,
            Err(message) => return Ok(Outcome::Failed(message)),
        };
        let key = action_key(job, file.as_ref());
        let hash = key.hash();
        reply.key = Some(Box::new(key.clone()));
        if let Some(made) = self.look_up(&hash)? {
            if self.dry || !self.sampled(&hash) {
                return Ok(Outcome::Hit(made));
            }
            let _claim = self.store.claim(&hash)?;
            return self.again(job, &key, file.as_ref(), progress, made);
        }
        if self.dry {
            return Ok(Outcome::WouldRun);
        }
        let claim = self.store.claim(&hash)?;
        // Whoever held it, in this process or another, may have done it meanwhile.
        if let Some(made) = self.look_up(&hash)? {
            return Ok(Outcome::Hit(made));
        }
        let start = Instant::now();
        let payload = match self.run(job, &key, file.as_ref(), progress)? {
            Ok(done) => done,
            Err(outcome) => return Ok(outcome),
        };
        let wall_us = start.elapsed().as_micros() as u64;
        let outcome = self.keep(job, &key, payload, wall_us, &mut reply.warning)?;
        drop(claim);
        Ok(outcome)
    }

    /// Digests a source's files and imports them.
    fn import(&self, job: &Job) -> Result<Result<Option<Artifact>, String>, CacheError> {
        if job.files.is_empty() {
            return Ok(Ok(None));
        }
        let put = |bytes: &[u8]| if self.dry { Ok(Digest::of(bytes)) } else { self.store.put(bytes) };
        Ok(files_artifact(&job.files, put)?.map(Some))
    }

    fn look_up(&self, hash: &tauflow_cache::Key) -> Result<Option<Made>, CacheError> {
        match self.store.lookup(ACTION, hash) {
            Some(record) if self.whole(&record.refs) => records::load(self.store, &record),
            _ => Ok(None),
        }
    }

    /// Whether none of the blobs that a reader missed is still missing here.
    pub fn whole(&self, refs: &[Digest]) -> bool {
        // A list that was cut short does not say what else it would name.
        let listed = refs.len() < records::MAX_REFS;
        self.wanted.is_empty() || (listed && refs.iter().all(|d| !self.wanted.contains(d) || self.store.contains(d)))
    }

    fn sampled(&self, hash: &tauflow_cache::Key) -> bool {
        let head = u32::from_le_bytes([hash.0[0], hash.0[1], hash.0[2], hash.0[3]]);
        f64::from(head) < self.recheck * f64::from(u32::MAX)
    }

    /// Runs the kind, checks what it gave, and stores collections.
    fn run(
        &self,
        job: &Job,
        key: &ActionKey,
        file: Option<&Artifact>,
        progress: &dyn Progress,
    ) -> Result<Result<Given, Outcome>, CacheError> {
        let mut each: BTreeMap<&str, &Artifact> = job.each.iter().map(|(port, a)| (*port, a.as_ref())).collect();
        if let Some(file) = file {
            each.insert(FILE_PORT, file);
        }
        let whole: BTreeMap<&str, &Collection> = job.whole.iter().map(|(port, w)| (*port, &w.collection)).collect();
        let action = Action {
            params: key.params.clone(),
            item: job.item.as_ref(),
            group: job.group,
            seed: key.seed.unwrap_or(0),
            each,
            whole,
        };
        let blobs = StoreBlobs::new(self.store);
        let context = Context::new(&blobs, progress, self.stop);
        let result = job.kind.run(&context, &action);
        if let Some(error) = blobs.fatal() {
            return Err(error);
        }
        let outputs = match result {
            Ok(outputs) => outputs,
            Err(KindError::Cancelled) => return Ok(Err(Outcome::Cancelled)),
            Err(KindError::MissingBlob(digest)) => return Ok(Err(Outcome::Missing(digest))),
            Err(error) => return Ok(Err(Outcome::Failed(error.to_string()))),
        };
        if let Err(message) = check_outputs(job, &outputs) {
            return Ok(Err(Outcome::Failed(format!("internal error: {message}; please report it"))));
        }
        let mut payload = Payload { items: outputs.items, ..Payload::default() };
        let mut collections = BTreeMap::new();
        for (port, collection) in outputs.collections {
            let whole = Whole::new(collection);
            payload.collections.insert(port.clone(), records::put_collection(self.store, &whole)?);
            collections.insert(port, Arc::new(whole));
        }
        Ok(Ok((payload, collections)))
    }

    /// Records what an action gave.
    fn keep(
        &self,
        job: &Job,
        key: &ActionKey,
        (payload, collections): Given,
        wall_us: u64,
        warning: &mut Option<String>,
    ) -> Result<Outcome, CacheError> {
        let refs = records::refs(&payload, collections.values().map(|w| &w.collection));
        let bytes = payload.items.values().map(Artifact::size).sum::<u64>()
            + collections.values().flat_map(|w| w.collection.items.values()).map(Artifact::size).sum::<u64>();
        let record = Record {
            wall_us,
            bytes,
            ..records::record(ACTION, key.hash(), job.spec.name, key.preimage(), &payload, refs)
        };
        if let Recorded::Conflict { existing } = self.store.record(&record)? {
            let other = Payload::of(&existing).unwrap_or_default();
            let differing = other.differs(&payload, &job.spec);
            if !differing.is_empty() {
                *warning = Some(format!(
                    "`{}` gave two different outputs for key {} (ports {}): it is not reproducible; the first stays \
                     unless its blobs are gone",
                    job.spec.name,
                    key.hash().short(),
                    differing.join(", ")
                ));
            }
            // The earlier outputs stay, measured ones too, as long as they are whole.
            if existing.refs.iter().all(|d| self.store.contains(d))
                && let Some(made) = records::load(self.store, &existing)?
            {
                return Ok(Outcome::Ran(made));
            }
            self.store.replace(&record)?;
        }
        let items = payload.items.into_iter().map(|(port, a)| (port, Arc::new(a))).collect();
        Ok(Outcome::Ran(Made { items, collections, wall_us, bytes }))
    }

    /// Runs a hit again and compares.
    fn again(
        &self,
        job: &Job,
        key: &ActionKey,
        file: Option<&Artifact>,
        progress: &dyn Progress,
        made: Made,
    ) -> Result<Outcome, CacheError> {
        let (payload, _) = match self.run(job, key, file, progress)? {
            Ok(done) => done,
            Err(outcome) => return Ok(outcome),
        };
        let before = self.store.lookup(ACTION, &key.hash()).and_then(|r| Payload::of(&r)).unwrap_or_default();
        let differing = before.differs(&payload, &job.spec);
        if differing.is_empty() {
            return Ok(Outcome::Ran(made));
        }
        Ok(Outcome::Failed(format!(
            "the recheck gave other content on {}: `{}` is not reproducible, or its version should have gone up; \
             the recorded output stays",
            differing.join(", "),
            job.spec.name
        )))
    }
}

/// The key of an action.
fn action_key(job: &Job, file: Option<&Artifact>) -> ActionKey {
    let mut inputs: BTreeMap<String, Digest> =
        job.each.iter().map(|(port, artifact)| ((*port).to_owned(), artifact.digest())).collect();
    inputs.extend(job.whole.iter().map(|(port, whole)| ((*port).to_owned(), whole.digest)));
    if let Some(file) = file {
        inputs.insert(FILE_PORT.into(), file.digest());
    }
    let item = job.item.as_ref().map_or("", |i| i.as_str());
    ActionKey {
        format: FORMAT_VERSION,
        kind: job.spec.name.to_owned(),
        version: job.spec.version,
        group: job.group.to_owned(),
        params: job.kind.project(&job.params, job.item.as_ref(), job.group),
        inputs,
        seed: job.spec.seeded.then(|| derive_seed(job.seed, job.spec.name, item)),
    }
}

/// A kind must fill exactly the ports of its group, with what they say they hold.
fn check_outputs(job: &Job, outputs: &Outputs) -> Result<(), String> {
    let name = job.spec.name;
    let ports: Vec<_> = job.spec.outputs.iter().filter(|p| p.group == job.group).collect();
    for port in outputs.items.keys().chain(outputs.collections.keys()) {
        if ports.iter().all(|p| p.name != port) {
            return Err(format!("`{name}` filled `{port}`, which is no port of its group `{}`", job.group));
        }
    }
    let artifacts = outputs.items.values().chain(outputs.collections.values().flat_map(|c| c.items.values()));
    for part in artifacts.flat_map(|a| a.parts.keys()) {
        if !part.is_empty() && ItemKey::new(part.as_str()).is_err() {
            return Err(format!("`{name}` named a part `{part}`, which cannot be a file name"));
        }
    }
    for port in ports {
        let wrong = |media: &str| port.media != "*" && media != port.media;
        if job.spec.mode == Mode::Gather {
            let collection = outputs.collections.get(port.name);
            let Some(collection) = collection else { return Err(format!("`{name}` left `{}` out", port.name)) };
            if let Some((key, artifact)) = collection.iter().find(|(_, a)| wrong(&a.media)) {
                return Err(format!("`{name}` put `{}` on `{}` for `{key}`", artifact.media, port.name));
            }
        } else {
            match outputs.items.get(port.name) {
                Some(artifact) if wrong(&artifact.media) => {
                    return Err(format!("`{name}` put `{}` on `{}`", artifact.media, port.name));
                }
                None if !port.filter => return Err(format!("`{name}` left `{}` out", port.name)),
                _ => {}
            }
        }
    }
    Ok(())
}

fn told(panic: &Box<dyn std::any::Any + Send>) -> String {
    panic
        .downcast_ref::<String>()
        .cloned()
        .or_else(|| panic.downcast_ref::<&str>().map(|s| (*s).to_owned()))
        .unwrap_or_else(|| "no message".into())
}
