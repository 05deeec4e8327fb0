//! Node kinds: their ports, params and work.

use crate::{Artifact, Collection, Context, ItemKey};
use schemars::JsonSchema;
use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;
use std::{collections::BTreeMap, marker::PhantomData, path::PathBuf};
use tauflow_cache::Digest;

/// How a kind works through items.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Mode {
    /// Names its own items from params (and files outside); one action for each item.
    Source,
    /// One action for each item of its `Each` inputs.
    Map,
    /// One action over whole collections.
    Gather,
}

/// How an input port feeds actions.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Feed {
    /// The item of the same key. The first `Each` port that is connected decides which items there are.
    Each,
    /// The whole collection.
    Whole,
}

/// What a rerun of the same action gives.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Determinism {
    /// The same bits.
    Bitwise,
    /// The same bits on this machine; [`Kind::environment`] says what of it decides them. Taints what is made from it.
    Local,
    /// A measurement, such as a time; taints what is made from it.
    Measured,
}

/// An input of a kind.
#[derive(Clone, Copy, Debug)]
pub struct InputPort {
    /// Name in the pipeline file.
    pub name: &'static str,
    /// Media type of its items; `*` takes any.
    pub media: &'static str,
    /// How it feeds actions.
    pub feed: Feed,
    /// True if it may be left unconnected.
    pub optional: bool,
    /// A line for people.
    pub doc: &'static str,
}

/// An output of a kind. The first port is the node's default output.
#[derive(Clone, Copy, Debug)]
pub struct OutputPort {
    /// Name in the pipeline file.
    pub name: &'static str,
    /// Media type of its items.
    pub media: &'static str,
    /// Ports of one group are made by one action; a group that nobody reads does not run.
    pub group: &'static str,
    /// True if an action may leave its item out of this port (a filter).
    pub filter: bool,
    /// Whether its bits are reproducible. An action that makes nothing but measurements has the machine to itself.
    pub determinism: Determinism,
    /// True if the parts are also written as files below `OUT/<pipeline>/` when the node is a target.
    pub publish: bool,
    /// A line for people.
    pub doc: &'static str,
}

impl OutputPort {
    /// A bitwise, unfiltered port of group `main`.
    pub const fn new(name: &'static str, media: &'static str, doc: &'static str) -> Self {
        Self { name, media, group: "main", filter: false, determinism: Determinism::Bitwise, publish: false, doc }
    }

    /// The same port in another group.
    pub const fn in_group(mut self, group: &'static str) -> Self {
        self.group = group;
        self
    }

    /// The same port, as a filter.
    pub const fn filtering(mut self) -> Self {
        self.filter = true;
        self
    }

    /// The same port, as a measurement.
    pub const fn measured(mut self) -> Self {
        self.determinism = Determinism::Measured;
        self
    }

    /// The same port, decided by the machine, too.
    pub const fn local(mut self) -> Self {
        self.determinism = Determinism::Local;
        self
    }

    /// The same port, published as files.
    pub const fn published(mut self) -> Self {
        self.publish = true;
        self
    }
}

impl InputPort {
    /// A required port that feeds item by item.
    pub const fn each(name: &'static str, media: &'static str, doc: &'static str) -> Self {
        Self { name, media, feed: Feed::Each, optional: false, doc }
    }

    /// A required port that feeds whole collections.
    pub const fn whole(name: &'static str, media: &'static str, doc: &'static str) -> Self {
        Self { name, media, feed: Feed::Whole, optional: false, doc }
    }

    /// The same port, optional.
    pub const fn or_none(mut self) -> Self {
        self.optional = true;
        self
    }
}

/// What a kind states about itself.
#[derive(Clone, Debug)]
pub struct KindSpec {
    /// Name in the pipeline file.
    pub name: &'static str,
    /// Goes up when the outputs of the same action change.
    pub version: u32,
    /// One line.
    pub summary: &'static str,
    /// The manual, in Markdown, with a YAML snippet.
    pub manual: &'static str,
    /// How it works through items.
    pub mode: Mode,
    /// Its inputs.
    pub inputs: &'static [InputPort],
    /// Its outputs, the default first.
    pub outputs: &'static [OutputPort],
    /// True if its actions get a seed derived from the pipeline's.
    pub seeded: bool,
}

impl KindSpec {
    /// Whether a group of outputs is nothing but measurements.
    pub fn measures(&self, group: &str) -> bool {
        let mut ports = self.outputs.iter().filter(|port| port.group == group).peekable();
        ports.peek().is_some() && ports.all(|port| port.determinism == Determinism::Measured)
    }
}

/// An item that a source names.
#[derive(Clone, Debug)]
pub struct SourceItem {
    /// Its key.
    pub key: ItemKey,
    /// Files outside that it reads, by part name; the engine digests and imports them, and hands them to the action
    /// as one artifact on the port `file`.
    pub files: Vec<(String, PathBuf)>,
}

/// One thing that is wrong with a node's params.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParamProblem {
    /// JSON pointer into the params, e.g. `/rungs/dyadic`.
    pub pointer: String,
    /// What is so.
    pub message: String,
    /// What to do.
    pub hint: String,
}

impl ParamProblem {
    /// A problem at `pointer`.
    pub fn new(pointer: impl Into<String>, message: impl Into<String>, hint: impl Into<String>) -> Self {
        Self { pointer: pointer.into(), message: message.into(), hint: hint.into() }
    }
}

/// Why an action failed. Errors are never cached.
#[derive(Debug, thiserror::Error)]
pub enum KindError {
    /// The input data are wrong; says which, where, and what to do.
    #[error("{0}")]
    Input(String),
    /// A blob of an input is not in the store; the engine makes it again.
    #[error("blob {0} is missing from the store")]
    MissingBlob(Digest),
    /// Disk, permissions, a missing library.
    #[error("{0}")]
    Environment(String),
    /// The run is being stopped.
    #[error("stopped before it was done")]
    Cancelled,
    /// A fault of ours.
    #[error("internal error: {0}; please report it")]
    Internal(String),
}

/// One unit of work.
#[derive(Debug)]
pub struct Action<'a, P> {
    /// The params this action reads: the projection, nothing more.
    pub params: P,
    /// The item, for sources and maps.
    pub item: Option<&'a ItemKey>,
    /// The group of output ports to make.
    pub group: &'a str,
    /// The derived seed; 0 for kinds that are not seeded.
    pub seed: u64,
    /// The item's artifact by `Each` port (and `file` for sources with files).
    pub each: BTreeMap<&'a str, &'a Artifact>,
    /// Whole collections by `Whole` port.
    pub whole: BTreeMap<&'a str, &'a Collection>,
}

impl<'a, P> Action<'a, P> {
    /// The artifact on an `Each` port.
    ///
    /// # Errors
    /// [`KindError::Input`] if the port is not connected.
    pub fn each(&self, port: &str) -> Result<&'a Artifact, KindError> {
        self.each.get(port).copied().ok_or_else(|| KindError::Input(format!("input `{port}` is not connected")))
    }

    /// The collection on a `Whole` port.
    ///
    /// # Errors
    /// [`KindError::Input`] if the port is not connected.
    pub fn whole(&self, port: &str) -> Result<&'a Collection, KindError> {
        self.whole.get(port).copied().ok_or_else(|| KindError::Input(format!("input `{port}` is not connected")))
    }

    /// The item's key.
    ///
    /// # Errors
    /// [`KindError::Internal`] for gathers, which have none.
    pub fn item(&self) -> Result<&'a ItemKey, KindError> {
        self.item.ok_or_else(|| KindError::Internal("an action without an item was asked for its key".into()))
    }
}

/// What an action made, by output port of its group.
///
/// Sources and maps make at most one artifact on each port; gathers make collections.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Outputs {
    /// Artifacts of a source or map; a filter port may be absent.
    pub items: BTreeMap<String, Artifact>,
    /// Collections of a gather.
    pub collections: BTreeMap<String, Collection>,
}

impl Outputs {
    /// Adds an artifact on a port (sources and maps).
    pub fn item(mut self, port: &str, artifact: Artifact) -> Self {
        self.items.insert(port.to_owned(), artifact);
        self
    }

    /// Adds a collection on a port (gathers).
    pub fn collection(mut self, port: &str, collection: Collection) -> Self {
        self.collections.insert(port.to_owned(), collection);
        self
    }
}

/// A kind with typed params: what authors of kinds implement. The engine sees it through [`KindRow`].
pub trait Kind: Send + Sync + 'static {
    /// The params: documented, with defaults, unknown fields denied.
    type Params: Serialize + DeserializeOwned + JsonSchema + Send + Sync;

    /// What the kind states about itself.
    fn spec() -> KindSpec;

    /// Problems that the schema cannot express, such as a minimum above a maximum.
    fn check(_params: &Self::Params) -> Vec<ParamProblem> {
        Vec::new()
    }

    /// The items of a source, in any order; other modes never get here.
    ///
    /// # Errors
    /// If the files outside cannot be listed.
    fn items(_params: &Self::Params) -> Result<Vec<SourceItem>, KindError> {
        Ok(Vec::new())
    }

    /// The params that the action of this item and group reads, as JSON. Only these enter its key, and `run` gets them
    /// alone, other fields at the defaults of `Params`. The default is all of them.
    fn project(params: &Self::Params, _item: Option<&ItemKey>, _group: &str) -> Value {
        serde_json::to_value(params).expect("params serialise")
    }

    /// What of this machine decides the outputs of a group, beside all that an action is handed: a library that is found
    /// at run time, the processor that is timed. It enters the keys. The default is nothing, null.
    fn environment(_params: &Self::Params, _group: &str) -> Value {
        Value::Null
    }

    /// Does the work.
    ///
    /// # Errors
    /// See [`KindError`].
    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError>;
}

/// The params that the action of an item (if it has one) and an output group reads.
pub type Projection = Box<dyn Fn(Option<&ItemKey>, &str) -> Value + Send + Sync>;

/// A kind as the engine sees it: object-safe, with JSON params.
pub trait NodeKind: Send + Sync {
    /// What the kind states about itself.
    fn spec(&self) -> KindSpec;
    /// JSON Schema of the params.
    fn params_schema(&self) -> Value;
    /// Fills defaults in, and checks.
    ///
    /// # Errors
    /// Every problem found.
    fn resolve(&self, params: &Value) -> Result<Value, Vec<ParamProblem>>;
    /// See [`Kind::items`]; `params` are resolved.
    ///
    /// # Errors
    /// As [`Kind::items`].
    fn items(&self, params: &Value) -> Result<Vec<SourceItem>, KindError>;
    /// See [`Kind::project`]; `params` are resolved, and are read once for all the items that the projection is asked about.
    fn projection(&self, params: &Value) -> Projection;
    /// See [`Kind::environment`]; `params` are resolved.
    fn environment(&self, params: &Value, group: &str) -> Value;
    /// See [`Kind::run`]; the params are a projection.
    ///
    /// # Errors
    /// As [`Kind::run`].
    fn run(&self, ctx: &Context<'_>, action: &Action<'_, Value>) -> Result<Outputs, KindError>;
}

/// Row of the registry: wraps a [`Kind`] as a [`NodeKind`].
pub struct KindRow<K>(PhantomData<fn() -> K>);

impl<K> KindRow<K> {
    /// The row.
    pub const fn new() -> Self {
        Self(PhantomData)
    }
}

impl<K> Default for KindRow<K> {
    fn default() -> Self {
        Self::new()
    }
}

fn parse<P: DeserializeOwned>(params: &Value) -> Result<P, KindError> {
    serde_json::from_value(params.clone())
        .map_err(|e| KindError::Internal(format!("resolved params do not parse: {e}")))
}

impl<K: Kind> NodeKind for KindRow<K> {
    fn spec(&self) -> KindSpec {
        K::spec()
    }

    fn params_schema(&self) -> Value {
        schemars::schema_for!(K::Params).to_value()
    }

    fn resolve(&self, params: &Value) -> Result<Value, Vec<ParamProblem>> {
        let typed: K::Params = serde_json::from_value(params.clone())
            .map_err(|e| vec![ParamProblem::new("", e.to_string(), "see `tauflow kinds` for this kind's params")])?;
        let problems = K::check(&typed);
        if !problems.is_empty() {
            return Err(problems);
        }
        serde_json::to_value(&typed).map_err(|e| vec![ParamProblem::new("", e.to_string(), "use finite numbers")])
    }

    fn items(&self, params: &Value) -> Result<Vec<SourceItem>, KindError> {
        K::items(&parse(params)?)
    }

    fn projection(&self, params: &Value) -> Projection {
        match parse::<K::Params>(params) {
            Ok(typed) => Box::new(move |item, group| K::project(&typed, item, group)),
            // Cannot be for resolved params; the whole params are a sound, if broad, key.
            Err(_) => {
                let params = params.clone();
                Box::new(move |_, _| params.clone())
            }
        }
    }

    fn environment(&self, params: &Value, group: &str) -> Value {
        // Params that do not parse cannot be, once they are resolved.
        parse(params).map_or(Value::Null, |params| K::environment(&params, group))
    }

    fn run(&self, ctx: &Context<'_>, action: &Action<'_, Value>) -> Result<Outputs, KindError> {
        let typed = Action {
            params: parse::<K::Params>(&action.params)?,
            item: action.item,
            group: action.group,
            seed: action.seed,
            each: action.each.clone(),
            whole: action.whole.clone(),
        };
        K::run(ctx, &typed)
    }
}
