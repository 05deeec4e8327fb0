//! One action alone, from nothing but a store: its key says what it is, its recipe where its inputs are.

use super::{
    EngineError, explain,
    ids::{Id, InputId, LaneId, PortId, SlotId},
    job::{ActionInputs, Bundle, Job, Outcome, Task, Todo},
    probe::Asking,
    records::{self, ACTION},
    sharded::{Output, Sharded},
    transient::Pool,
    work::Bench,
};
use crate::{kinds::Registry, pipeline::schema_check};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::{
    collections::{BTreeMap, HashSet},
    sync::{Arc, atomic::AtomicBool},
};
use tauflow_cache::{CacheError, Key, Store};
use tauflow_contract::{ActionKey, Digest, FILE_PORT, FORMAT_VERSION, Progress};

/// An action as a file: all that it takes, beside the blobs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActionFile {
    /// What decides its outputs.
    pub key: ActionKey,
    /// Its inputs.
    pub recipe: ActionInputs,
}

/// What became of an action that was run alone.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Executed {
    /// The hash of its key.
    pub key: Key,
    /// Its kind.
    pub kind: String,
    /// True if the store had no record of it: it has one now.
    pub new: bool,
    /// Content digests of its outputs, by port.
    pub outputs: BTreeMap<String, Digest>,
    /// Wall time, in microseconds.
    pub wall_us: u64,
}

/// Why an action could not be run alone.
#[derive(Debug, thiserror::Error)]
pub enum ExecError {
    /// The store.
    #[error(transparent)]
    Cache(#[from] CacheError),
    /// The action, or what it asks for.
    #[error("{0}")]
    Action(String),
    /// Its key is of another machine, library or device than there is here.
    #[error("{0}")]
    Foreign(String),
    /// It ran and failed, or gave other content than before.
    #[error("{0}")]
    Failed(String),
}

impl From<EngineError> for ExecError {
    fn from(error: EngineError) -> Self {
        match error {
            EngineError::Cache(error) => Self::Cache(error),
            other => Self::Action(other.to_string()),
        }
    }
}

impl ActionFile {
    /// The action that a record was made by.
    ///
    /// # Errors
    /// If there is no such record, or it does not say enough.
    pub fn recorded(store: &Store, key: &Key) -> Result<Self, ExecError> {
        let Some(record) = store.lookup(ACTION, key) else {
            return Err(ExecError::Action(format!(
                "the store has no action {key}; `tauflow explain PIPELINE NODE ITEM` tells an action's key"
            )));
        };
        let unread = |what: &str, e: serde_json::Error| {
            ExecError::Action(format!("the {what} of action {key} does not parse: {e}; run its pipeline again"))
        };
        let found: ActionKey = serde_json::from_str(&record.preimage).map_err(|e| unread("key", e))?;
        // A record may say anything; what is run must be what was asked for.
        let hash = found.hash();
        if hash != *key {
            return Err(ExecError::Action(format!(
                "the record of action {key} holds the key of action {hash}: it is not the one that was asked for, and \
                 whoever wrote it made it up, or it is of a program with other keys; run its pipeline again"
            )));
        }
        let recipe = serde_json::from_str(&record.recipe).map_err(|e| unread("recipe", e))?;
        Ok(Self { key: found, recipe })
    }

    /// Runs it. If the store has a record of it, the outputs are compared with that; else they are recorded.
    ///
    /// # Errors
    /// If inputs are missing or are not what the key says, or if the kind is not here or of another version. If what of
    /// the machine enters the key is another here. If the action fails, or gives other content than before.
    pub fn run(
        self,
        store: &Store,
        registry: &Registry,
        stop: &AtomicBool,
        progress: &dyn Progress,
    ) -> Result<Executed, ExecError> {
        let Self { key, recipe } = self;
        let hash = key.hash();
        let basis = key.basis.clone();
        if basis.format != FORMAT_VERSION {
            return Err(ExecError::Action(format!(
                "the action's key is of format {}, and this program's are of format {FORMAT_VERSION}; run it with the \
                 program that made it",
                basis.format
            )));
        }
        let Some(kind) = registry.get(&basis.kind) else {
            return Err(ExecError::Action(format!(
                "there is no kind `{}`; {}",
                basis.kind,
                registry.hint(&basis.kind)
            )));
        };
        let spec = kind.spec_for(&basis.params);
        let Some(group) = spec.group(&basis.group) else {
            return Err(ExecError::Action(format!("`{}` has no outputs of a group `{}`", basis.kind, basis.group)));
        };
        if group.version != basis.version {
            return Err(ExecError::Action(format!(
                "the action asks for version {} of `{}`, and this is {}; run it with the program that made it",
                basis.version, basis.kind, group.version
            )));
        }
        // Params of a file are from anywhere; those of a pipeline were held to the same schema.
        if let Some(wrong) = schema_check::check(&kind.params_schema(), &basis.params).into_iter().next() {
            return Err(ExecError::Action(format!(
                "the action's params are none of `{}`: `{}`: {}; write it anew with `tauflow exec KEY --print`",
                basis.kind, wrong.pointer, wrong.message
            )));
        }
        // What it made here would else be filed as made there.
        let here = Asking::new(store, true).environment(&**kind, &basis.params, group)?.unwrap_or_default();
        if here != basis.environment {
            return Err(foreign(&basis.environment, &here));
        }
        let port = |name: &str| {
            let found = spec.inputs.iter().position(|port| port.name == name);
            let found = found.map(InputId::at);
            found.ok_or_else(|| ExecError::Action(format!("`{}` has no input `{name}`", basis.kind)))
        };
        let same = |name: &str, digest: Digest| match key.inputs.get(name) {
            Some(asked) if *asked == digest => Ok(()),
            asked => Err(ExecError::Action(format!(
                "the recipe's input `{name}` is {digest}, and the key asks for {}",
                asked.map_or_else(|| "none".to_owned(), ToString::to_string)
            ))),
        };
        let (mut each, mut whole, mut file) = (Vec::new(), Vec::new(), None);
        for (name, artifact) in recipe.each {
            same(&name, artifact.digest())?;
            if name == FILE_PORT && spec.inputs.iter().all(|port| port.name != FILE_PORT) {
                file = Some(artifact);
            } else {
                each.push((port(&name)?, Output::new(artifact)));
            }
        }
        for (name, listed) in recipe.whole {
            same(&name, listed.digest)?;
            let input = port(&name)?;
            let Some(found) = Sharded::get(store, &listed, spec.inputs[input.place()].media)? else {
                return Err(missing(&listed.blob));
            };
            whole.push((input, Arc::new(found)));
        }
        if each.len() + whole.len() + usize::from(file.is_some()) != key.inputs.len() {
            return Err(ExecError::Action("the recipe leaves inputs of the key out".into()));
        }
        let record = store.lookup(ACTION, &hash);
        let before =
            record.as_ref().map(|record| records::load(store, record, &spec, group.name)).transpose()?.flatten();
        let new = before.is_none();
        let params = basis.params.clone();
        let task = Task {
            lane: LaneId::at(0),
            kind: kind.clone(),
            spec,
            group: group.name,
            projection: Box::new(move |_, _| params.clone()),
            basis: basis.clone(),
            alone: false,
            transient: false,
            read: Vec::new(),
        };
        let (kind, todo) = (basis.kind.into_owned(), Some(Box::new(Todo::new(key, file, before))));
        let bundle = Bundle { task: Arc::new(task), whole, jobs: Vec::new() };
        let job = Job { slot: SlotId::at(0), item: recipe.item, each, files: Vec::new(), todo };
        let wanted = HashSet::new();
        let pool = Pool::new(0);
        let bench = Bench { store, pool: &pool, stop, dry: false, keep_keys: false, recheck: 1.0, wanted: &wanted };
        let reply = bench.perform(&bundle, job, progress);
        if let Some(warning) = reply.warning {
            return Err(ExecError::Failed(warning));
        }
        let made = match reply.outcome {
            Outcome::Ran(made) | Outcome::Hit(made) => made,
            Outcome::Missing(digest) => return Err(missing(&digest)),
            Outcome::Failed(message) => return Err(ExecError::Failed(message)),
            Outcome::Fatal(error) => return Err(error.into()),
            Outcome::Cancelled | Outcome::Todo(_) | Outcome::WouldRun => {
                return Err(ExecError::Failed("the action was stopped".into()));
            }
        };
        store.flush()?;
        let name = |port: PortId| bundle.task.spec.outputs[port.place()].name.to_owned();
        let mut outputs: BTreeMap<String, Digest> =
            made.items.iter().map(|(port, output)| (name(*port), output.digest)).collect();
        outputs.extend(made.collections.iter().map(|(port, sharded)| (name(*port), sharded.digest)));
        Ok(Executed { key: hash, kind, new, outputs, wall_us: reply.spent_us })
    }
}

/// The actions of the store whose key begins like this.
///
/// # Errors
/// If there is none, or more than one.
pub fn find(store: &Store, start: &str) -> Result<Key, ExecError> {
    let found = store.keys_like(ACTION, start);
    match &found[..] {
        [key] => Ok(*key),
        [] => Err(ExecError::Action(format!(
            "the store in {} has no action `{start}`; `tauflow explain PIPELINE NODE ITEM` tells an action's key",
            store.dir().display()
        ))),
        several => Err(ExecError::Action(format!(
            "{} actions begin with `{start}`; give more of the key, such as {}",
            several.len(),
            several[0]
        ))),
    }
}

/// Keys of the store's actions, sorted.
pub fn recorded(store: &Store) -> Vec<Key> {
    store.keys_like(ACTION, "")
}

/// Where an action's environment is another than that of this machine.
fn foreign(there: &Value, here: &Value) -> ExecError {
    let mut found = Vec::new();
    explain::differences("", there, here, &mut found);
    let show = |value: &Option<Value>| value.as_ref().map_or_else(|| "absent".to_owned(), Value::to_string);
    let differ = |difference: &explain::Difference| {
        let field = difference.field.trim_start_matches('/').replace('/', ".");
        let field = if field.is_empty() { "environment" } else { &field };
        format!("`{field}` is {} in its key and {} here", show(&difference.before), show(&difference.now))
    };
    let told = found.iter().map(differ).collect::<Vec<_>>().join("; ");
    ExecError::Foreign(format!(
        "the action is of another machine, library or device: {told}; run it where they are the same (`exec` passes on \
         PATH, RAYON_NUM_THREADS, TAUFLOW_OIDN and TAUFLOW_INSTRUCTIONS, and works in an empty \
         folder, so that programs are named by PATH or from `/` on), or run its pipeline here, which gives it a key of \
         its own"
    ))
}

fn missing(digest: &Digest) -> ExecError {
    ExecError::Action(format!(
        "the store does not hold the input blob {digest}; copy it there, or run what makes it, \
         without `transient` if that is set"
    ))
}
