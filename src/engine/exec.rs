//! Runs one action from a store alone: the key describes the action, and the recipe its inputs.

use super::{
    EngineError,
    execute::{ActionInputs, Execution, Outcome, PreparedAction, Producer, execute},
    explain,
    holdings::Holdings,
    ids::{Id, InputId, PortId},
    measured::Fetched,
    output::Output,
    probe::Asking,
    records::{ACTION, port_of},
    sharded::Sharded,
    sighted,
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
    /// The basis of its key, which determines its outputs.
    pub key: ActionKey,
    /// Its inputs.
    pub recipe: ActionInputs,
}

/// The outcome of an action that was run in isolation.
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
    /// A blob of its inputs is not there.
    #[error(
        "the store lacks the input blob {0}; copy it there, or run its producer, without `transient` if that is set"
    )]
    Missing(Digest),
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
                "the store has no action {key}; `tauflow explain PIPELINE NODE ITEM` prints the key of an action"
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
                "the record of action {key} contains the key of action {hash}: it was forged, or written by a program \
                with a different key format; run its pipeline again"
            )));
        }
        let recipe = serde_json::from_str(&record.recipe).map_err(|e| unread("recipe", e))?;
        Ok(Self { key: found, recipe })
    }

    /// Runs it. If the store has a record of it, the outputs are compared with that; else they are recorded.
    ///
    /// # Errors
    /// As [`ActionFile::prepare`]; if the action fails, or gives other content than before.
    pub fn run(
        self,
        store: &Store,
        registry: &Registry,
        stop: &AtomicBool,
        progress: &dyn Progress,
    ) -> Result<Executed, ExecError> {
        let wanted = HashSet::new();
        let site = ExecSite { holdings: Holdings::stored(store, &wanted), registry, stop };
        let (action, execution) = self.execute(&site, Handling::default(), true, progress)?;
        if let Some(warning) = execution.warning {
            return Err(ExecError::Failed(warning));
        }
        let made = match execution.outcome {
            Outcome::Ran(made) | Outcome::Hit(made) => made,
            Outcome::Missing(blobs) => return Err(ExecError::Missing(blobs[0])), // never empty
            Outcome::Failed(message) => return Err(ExecError::Failed(message)),
            Outcome::Fatal(error) => return Err(error.into()),
            Outcome::Cancelled | Outcome::Elsewhere(_) => {
                return Err(ExecError::Failed("the action was stopped".into()));
            }
        };
        store.flush()?;
        let name = |port: PortId| action.producer.spec.outputs[port.place()].name.to_owned();
        let mut outputs: BTreeMap<String, Digest> =
            made.items.iter().map(|(port, output)| (name(*port), output.digest)).collect();
        outputs.extend(made.collections.iter().map(|(port, sharded)| (name(*port), sharded.digest)));
        let (kind, new) = (action.key.basis.kind.to_string(), action.before.is_none());
        Ok(Executed { key: action.hash, kind, new, outputs, wall_us: execution.spent_us })
    }

    /// Prepares and executes it. If it is to be compared and the store has a record of it, it runs only to be compared
    /// with that.
    ///
    /// # Errors
    /// As [`ActionFile::prepare`].
    pub(super) fn execute(
        self,
        site: &ExecSite<'_>,
        handling: Handling,
        compare: bool,
        progress: &dyn Progress,
    ) -> Result<(PreparedAction, Execution), ExecError> {
        let store = site.holdings.store;
        let mut action = self.prepare(store, site.registry, handling)?;
        if compare {
            let record = store.lookup(ACTION, &action.hash);
            action.before = site.holdings.made(record.as_deref(), &action.producer)?;
        }
        let execution = execute(&action, site.holdings, site.stop, progress);
        Ok((action, execution))
    }

    /// The action, ready to be executed on this machine.
    ///
    /// # Errors
    /// If inputs are missing or are not what the key says, or if the kind is not here or of another version. If what of
    /// the machine enters the key is another here.
    pub fn prepare(self, store: &Store, registry: &Registry, handling: Handling) -> Result<PreparedAction, ExecError> {
        let Self { key, recipe } = self;
        let hash = key.hash();
        let basis = key.basis.clone();
        if basis.format != FORMAT_VERSION {
            return Err(ExecError::Action(format!(
                "the key of the action has format {}, but this program uses format {FORMAT_VERSION}; run it with the \
                program that recorded it",
                basis.format
            )));
        }
        let Some(kind) = registry.get(&basis.kind) else {
            return Err(ExecError::Action(format!("unknown kind `{}`; {}", basis.kind, registry.hint(&basis.kind))));
        };
        let spec = kind.spec_for(&basis.params);
        let Some(group) = spec.group(&basis.group) else {
            return Err(ExecError::Action(format!("`{}` has no outputs of a group `{}`", basis.kind, basis.group)));
        };
        if group.version != basis.version {
            return Err(ExecError::Action(format!(
                "the action needs version {} of `{}`, but this is version {}; run it with the program that recorded it",
                basis.version, basis.kind, group.version
            )));
        }
        // Params of a file are from anywhere; those of a pipeline were held to the same schema.
        if let Some(wrong) = schema_check::check(&kind.params_schema(), &basis.params).into_iter().next() {
            return Err(ExecError::Action(format!(
                "the params of the action are invalid for `{}`: `{}`: {}; write it again with `tauflow exec KEY \
                --print`",
                basis.kind, wrong.pointer, wrong.message
            )));
        }
        // Its outputs would otherwise be recorded for the wrong environment.
        let here = Asking::new(store, true).environment(&**kind, &basis.params, group)?.unwrap_or_default();
        let there = sighted::first(&key).basis.environment;
        if here != there {
            return Err(foreign(&there, &here));
        }
        let port = |name: &str| {
            let found = spec.inputs.iter().position(|port| port.name == name);
            let found = found.map(InputId::at);
            found.ok_or_else(|| ExecError::Action(format!("`{}` has no input `{name}`", basis.kind)))
        };
        let same = |name: &str, digest: Digest| match key.inputs.get(name) {
            Some(asked) if *asked == digest => Ok(()),
            asked => Err(ExecError::Action(format!(
                "the input `{name}` of the recipe is {digest}, but the key requires {}",
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
                return Err(ExecError::Missing(listed.blob));
            };
            whole.push((input, Arc::new(found)));
        }
        if each.len() + whole.len() + usize::from(file.is_some()) != key.inputs.len() {
            return Err(ExecError::Action("the recipe lacks inputs of the key".into()));
        }
        let read = handling.read.iter().filter_map(|name| port_of(&spec, name)).collect();
        let producer = Producer {
            kind: kind.clone(),
            group: group.name,
            spec,
            transient: handling.transient,
            read,
            fetched: if handling.own { Fetched::None } else { Fetched::All },
            bound: !key.basis.environment.is_null(),
        };
        let (producer, whole) = (Arc::new(producer), Arc::new(whole));
        Ok(PreparedAction { producer, key, hash, item: recipe.item, each, whole, file, before: None })
    }
}

/// Where actions of files are executed.
pub(super) struct ExecSite<'a> {
    /// The store and what is beside it.
    pub holdings: Holdings<'a>,
    /// The kinds.
    pub registry: &'a Registry,
    /// Set when they are to stop.
    pub stop: &'a AtomicBool,
}

/// How a pipeline handles an action, in addition to its key.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Handling {
    /// Its outputs need not be stored unless they are read.
    #[serde(default)]
    pub transient: bool,
    /// Output ports that somebody reads.
    #[serde(default)]
    pub read: Vec<String>,
    /// What it measures must not come from an upstream.
    #[serde(default)]
    pub own: bool,
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
            "the store in {} has no action `{start}`; `tauflow explain PIPELINE NODE ITEM` prints the key of an action",
            store.dir().display()
        ))),
        several => Err(ExecError::Action(format!(
            "{} actions begin with `{start}`; use a longer prefix, such as {}",
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
        format!("`{field}` is {} in the key, but {} on this machine", show(&difference.before), show(&difference.now))
    };
    let told = found.iter().map(differ).collect::<Vec<_>>().join("; ");
    ExecError::Foreign(format!(
        "the key was made with a different machine, library or device: {told}; run it where they are the same (`exec` \
         passes on TAUFLOW_OIDN, TAUFLOW_ONNXRUNTIME and the usual variables of programs such as PATH, and works in an \
         empty folder, so that programs are named by PATH or from `/` on), or run its pipeline here, which gives it a \
         key of its own"
    ))
}
