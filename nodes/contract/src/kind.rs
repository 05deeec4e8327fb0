//! Node kinds: their ports, params and work.

use crate::{
    All, Artifact, Collection, Context, Determinism, Each, Files, Group, Handle, InputPort, ItemKey, Items, Later,
    Media, Out, OutputPort, Probe, Stored, derive_seed, fill_in, leave_out,
};
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
    /// One action for each item of its [`Each`] inputs.
    Map,
    /// One action over whole collections.
    Gather,
}

/// What a kind states about itself.
#[derive(Clone, Debug)]
pub struct KindSpec {
    /// Name in the pipeline file.
    pub name: &'static str,
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
        let mut ports = self.outputs.iter().filter(|port| port.group.name == group).peekable();
        ports.peek().is_some() && ports.all(|port| port.determinism == Determinism::Measured)
    }

    /// The group of this name.
    pub fn group(&self, name: &str) -> Option<Group> {
        self.outputs.iter().map(|port| port.group).find(|group| group.name == name)
    }

    /// The groups, in the order of their first ports.
    pub fn groups(&self) -> Vec<Group> {
        let mut groups: Vec<Group> = Vec::new();
        for port in self.outputs {
            if !groups.contains(&port.group) {
                groups.push(port.group);
            }
        }
        groups
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
    /// The item's artifact by port (and [`FILE_PORT`] for sources with files).
    pub each: BTreeMap<&'a str, &'a Artifact>,
    /// Whole collections by port.
    pub all: BTreeMap<&'a str, &'a Collection>,
}

/// Port on which a source's action finds the files outside that it reads.
pub const FILE_PORT: &str = "file";

fn unconnected(port: &str) -> KindError {
    KindError::Input(format!("input `{port}` is not connected"))
}

impl<'a, P> Action<'a, P> {
    /// The item on a port.
    ///
    /// # Errors
    /// [`KindError::Input`] if the port is not connected.
    pub fn handle<M: Media>(&self, port: Each<M>) -> Result<Handle<'a, M>, KindError> {
        self.handle_if(port)?.ok_or_else(|| unconnected(port.name()))
    }

    /// The item on a port that may be left unconnected.
    ///
    /// # Errors
    /// [`KindError::Input`] if the item is of another media type, which the engine keeps from happening.
    pub fn handle_if<M: Media>(&self, port: Each<M>) -> Result<Option<Handle<'a, M>>, KindError> {
        self.each.get(port.name()).map(|artifact| Handle::new(artifact)).transpose()
    }

    /// The item on a port, loaded.
    ///
    /// # Errors
    /// As [`Action::handle`] and [`Media::load`].
    pub fn read<M: Media>(&self, ctx: &Context<'_>, port: Each<M>) -> Result<M, KindError> {
        self.handle(port)?.load(ctx)
    }

    /// The item on a port that may be left unconnected, loaded.
    ///
    /// # Errors
    /// As [`Action::handle_if`] and [`Media::load`].
    pub fn read_if<M: Media>(&self, ctx: &Context<'_>, port: Each<M>) -> Result<Option<M>, KindError> {
        self.handle_if(port)?.map(|handle| handle.load(ctx)).transpose()
    }

    /// The collection on a port.
    ///
    /// # Errors
    /// [`KindError::Input`] if the port is not connected.
    pub fn all<M: Media>(&self, port: All<M>) -> Result<Items<'a, M>, KindError> {
        self.all_if(port)?.ok_or_else(|| unconnected(port.name()))
    }

    /// The collection on a port that may be left unconnected.
    ///
    /// # Errors
    /// [`KindError::Input`] if an item is of another media type, which the engine keeps from happening.
    pub fn all_if<M: Media>(&self, port: All<M>) -> Result<Option<Items<'a, M>>, KindError> {
        self.all.get(port.name()).map(|collection| Items::new(collection)).transpose()
    }

    /// The only item of the collection on a port.
    ///
    /// # Errors
    /// [`KindError::Input`] if the port is not connected, or its collection has not exactly one item.
    pub fn only<M: Media>(&self, port: All<M>) -> Result<Handle<'a, M>, KindError> {
        let empty = || {
            KindError::Input(format!(
                "input `{}` takes one item and got none; connect a node that makes it",
                port.name()
            ))
        };
        self.only_if(port)?.ok_or_else(empty)
    }

    /// The only item of the collection on a port that may be left unconnected, or have no item.
    ///
    /// # Errors
    /// [`KindError::Input`] if its collection has several items.
    pub fn only_if<M: Media>(&self, port: All<M>) -> Result<Option<Handle<'a, M>>, KindError> {
        let Some(items) = self.all_if(port)? else { return Ok(None) };
        if items.len() > 1 {
            return Err(KindError::Input(format!(
                "input `{}` takes one item and got {}; name one cell of its node, as in `node[axis=value]`",
                port.name(),
                items.len()
            )));
        }
        Ok(items.iter().next().map(|(_, handle)| handle))
    }

    /// The files outside that a source's item reads.
    ///
    /// # Errors
    /// [`KindError::Input`] if the item names none.
    pub fn files(&self) -> Result<Handle<'a, Files>, KindError> {
        Handle::new(self.each.get(FILE_PORT).copied().ok_or_else(|| unconnected(FILE_PORT))?)
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
    /// Puts an artifact on a port (sources and maps).
    pub fn put<M: Media>(mut self, port: Out<M>, artifact: Stored<M>) -> Self {
        self.items.insert(port.name().to_owned(), artifact.into_artifact());
        self
    }

    /// Puts a collection on a port (gathers).
    pub fn put_all<M: Media>(mut self, port: Out<M>, items: impl IntoIterator<Item = (ItemKey, Stored<M>)>) -> Self {
        let items = items.into_iter().map(|(key, artifact)| (key, artifact.into_artifact())).collect();
        self.collections.insert(port.name().to_owned(), items);
        self
    }

    /// Puts a collection of one item on a port (gathers).
    ///
    /// # Errors
    /// [`KindError::Internal`] if `key` cannot be an item key.
    pub fn put_one<M: Media>(self, port: Out<M>, key: &str, artifact: Stored<M>) -> Result<Self, KindError> {
        let key = ItemKey::new(key).map_err(|e| KindError::Internal(e.to_string()))?;
        Ok(self.put_all(port, [(key, artifact)]))
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

    /// Params that came later than the kind. What acted before they existed is left out of keys, and is what an action
    /// gets where they are left out, whatever their defaults have become.
    fn later() -> &'static [Later] {
        &[]
    }

    /// The seed of an item's action, made of the pipeline's; the item of a gather is the empty text. No two items of a
    /// node may have the same: it is what tells their actions apart where they read the same params and inputs. Items
    /// that share what they draw have seeds from which the kind can tell what they share. The default is a seed of its
    /// own for every item.
    fn seed(pipeline_seed: u64, item: &str) -> u64 {
        derive_seed(pipeline_seed, Self::spec().name, item)
    }

    /// What of this machine decides the outputs of a group, beside all that an action is handed: a library that is
    /// found at run time, the processor that is timed. It enters the keys. The default is nothing, null.
    ///
    /// It may read files, and starts no program and loads no library of a pipeline: what only those tell it asks
    /// `probe` for, and gives none where that has no answer. Of the params it reads those alone that [`Kind::project`]
    /// leaves to the group, because an action that is run by itself has no others.
    fn environment(_params: &Self::Params, _group: &str, _probe: &dyn Probe) -> Option<Value> {
        Some(Value::Null)
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
    /// See [`Kind::project`]; `params` are resolved, and are read once for all the items that the projection is asked
    /// about.
    fn projection(&self, params: &Value) -> Projection;
    /// Resolved params without those that came later and have the value of before ([`Kind::later`]): what decides the
    /// outcomes of all items together.
    fn keyed(&self, params: &Value) -> Value;
    /// See [`Kind::seed`].
    fn seed(&self, pipeline_seed: u64, item: &str) -> u64;
    /// See [`Kind::environment`]; `params` are resolved, or a projection.
    fn environment(&self, params: &Value, group: &str, probe: &dyn Probe) -> Option<Value>;
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

/// A place in params as a JSON pointer.
fn pointer(path: &serde_path_to_error::Path) -> String {
    use serde_path_to_error::Segment;
    let step = |segment: &Segment| match segment {
        Segment::Seq { index } => Some(format!("/{index}")),
        Segment::Map { key } => Some(format!("/{}", key.replace('~', "~0").replace('/', "~1"))),
        Segment::Enum { .. } | Segment::Unknown => None,
    };
    path.iter().filter_map(step).collect()
}

impl<K: Kind> NodeKind for KindRow<K> {
    fn spec(&self) -> KindSpec {
        K::spec()
    }

    fn params_schema(&self) -> Value {
        schemars::schema_for!(K::Params).to_value()
    }

    fn resolve(&self, params: &Value) -> Result<Value, Vec<ParamProblem>> {
        let typed: K::Params = serde_path_to_error::deserialize(params).map_err(|error| {
            let hint = format!("see `tauflow kinds {}` for its params", K::spec().name);
            vec![ParamProblem::new(pointer(error.path()), error.inner().to_string(), hint)]
        })?;
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
            Ok(typed) => Box::new(move |item, group| {
                let mut read = K::project(&typed, item, group);
                leave_out(&mut read, K::later());
                read
            }),
            // Cannot be for resolved params; the whole params are a sound, if broad, key.
            Err(_) => {
                let params = params.clone();
                Box::new(move |_, _| params.clone())
            }
        }
    }

    fn keyed(&self, params: &Value) -> Value {
        let mut keyed = params.clone();
        leave_out(&mut keyed, K::later());
        keyed
    }

    fn seed(&self, pipeline_seed: u64, item: &str) -> u64 {
        K::seed(pipeline_seed, item)
    }

    fn environment(&self, params: &Value, group: &str, probe: &dyn Probe) -> Option<Value> {
        let mut read = params.clone();
        fill_in(&mut read, K::later());
        // Params that do not parse cannot be, once they are resolved; those of a crafted action are refused by `run`.
        parse(&read).map_or(Some(Value::Null), |params| K::environment(&params, group, probe))
    }

    fn run(&self, ctx: &Context<'_>, action: &Action<'_, Value>) -> Result<Outputs, KindError> {
        let mut read = action.params.clone();
        fill_in(&mut read, K::later());
        let typed = Action {
            params: parse::<K::Params>(&read)?,
            item: action.item,
            group: action.group,
            seed: action.seed,
            each: action.each.clone(),
            all: action.all.clone(),
        };
        K::run(ctx, &typed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Before;
    use serde::Deserialize;
    use serde_json::json;

    #[derive(Serialize, Deserialize, JsonSchema)]
    #[serde(deny_unknown_fields)]
    struct Params {
        #[serde(default)]
        list: Vec<Even>,
        /// Was 1 before it existed; the default of today is another.
        #[serde(default = "five")]
        factor: u32,
    }

    fn five() -> u32 {
        5
    }

    #[derive(Serialize, Deserialize, JsonSchema)]
    #[serde(try_from = "u32")]
    struct Even(u32);

    impl TryFrom<u32> for Even {
        type Error = String;
        fn try_from(value: u32) -> Result<Self, String> {
            if value.is_multiple_of(2) { Ok(Self(value)) } else { Err(format!("{value} is odd; write an even number")) }
        }
    }

    struct Halves;

    impl Kind for Halves {
        type Params = Params;

        fn spec() -> KindSpec {
            KindSpec {
                name: "halves",
                summary: "A toy.",
                manual: "",
                mode: Mode::Source,
                inputs: &[],
                outputs: const { &[Out::<Files>::new(Group::main(3), "out", "Nothing.").port()] },
                seeded: false,
            }
        }

        fn later() -> &'static [Later] {
            &[Later { pointer: "/factor", before: Before::Integer(1) }]
        }

        fn run(_: &Context<'_>, action: &Action<'_, Params>) -> Result<Outputs, KindError> {
            // What it was given, told by its outcome.
            Err(KindError::Input(action.params.factor.to_string()))
        }
    }

    #[test]
    fn a_param_that_came_later_is_left_out_of_keys_and_acts_as_before() {
        let row = KindRow::<Halves>::new();
        for (given, key) in [(json!(1), json!({ "list": [] })), (json!(5), json!({ "list": [], "factor": 5 }))] {
            let resolved = row.resolve(&json!({ "factor": given })).expect("fine");
            let read = row.projection(&resolved)(None, "main");
            assert_eq!(read, key);
            assert_eq!(row.keyed(&resolved), key, "for lanes and shards, too");
            let (blobs, stop) = (crate::MemoryBlobs::default(), std::sync::atomic::AtomicBool::new(false));
            let ctx = Context::new(&blobs, &crate::Silent, &stop);
            let action = Action {
                params: read,
                item: None,
                group: "main",
                seed: 0,
                each: BTreeMap::new(),
                all: BTreeMap::new(),
            };
            assert_eq!(row.run(&ctx, &action).expect_err("always").to_string(), given.to_string());
        }
    }

    #[test]
    fn a_value_that_its_type_refuses_is_a_problem_at_its_place() {
        let row = KindRow::<Halves>::new();
        let problems = row.resolve(&json!({ "list": [2, 3] })).expect_err("an odd number");
        assert_eq!((problems[0].pointer.as_str(), problems.len()), ("/list/1", 1));
        assert!(problems[0].message.contains("3 is odd"), "{problems:?}");
        assert_eq!(row.resolve(&json!({ "list": [2] })).expect("even"), json!({ "list": [2], "factor": 5 }));
        assert_eq!(row.spec().groups(), [Group::main(3)]);
    }

    #[test]
    fn ports_hand_out_what_they_are_of() {
        const IN: All<Files> = All::new("in", "Files.");
        const MORE: All<Files> = All::new("more", "Files.").or_none();
        let file = |name: &str| Artifact::tree(Files::NAME, [(name.to_owned(), Digest::of(name.as_bytes()))]);
        let key = |text: &str| ItemKey::new(text).expect("plain");
        let two: Collection = [(key("a"), file("a")), (key("b"), file("b"))].into_iter().collect();
        let all = BTreeMap::from([("in", &two)]);
        let action = Action { params: (), item: None, group: "main", seed: 0, each: BTreeMap::new(), all };
        assert_eq!(action.all(IN).expect("connected").len(), 2);
        assert!(action.all_if(MORE).expect("optional").is_none());
        assert!(action.only(IN).expect_err("two items").to_string().contains("got 2"));
        assert!(action.all(MORE).expect_err("unconnected").to_string().contains("`more`"));
    }
}
