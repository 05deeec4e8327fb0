//! Node kinds: their description, and the trait that authors implement.

use crate::{
    Action, Context, Determinism, Group, InputPort, ItemKey, Known, Later, Outlook, OutputPort, Outputs, Probe,
    Resources, derive_seed,
};
use schemars::JsonSchema;
use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;
use std::path::PathBuf;
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
#[derive(Clone, Debug, PartialEq, Eq)]
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
    pub inputs: Vec<InputPort>,
    /// Its outputs, the default first.
    pub outputs: Vec<OutputPort>,
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
        for port in &self.outputs {
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
    /// The problem.
    pub message: String,
    /// The remedy.
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
    #[error("interrupted")]
    Cancelled,
    /// A fault of ours.
    #[error("internal error: {0}; please report it")]
    Internal(String),
}

/// A kind with typed params: what authors of kinds implement. The engine sees it through
/// [`KindRow`](crate::KindRow).
pub trait Kind: Send + Sync + 'static {
    /// The params: documented, with defaults, unknown fields denied.
    type Params: Serialize + DeserializeOwned + JsonSchema + Send + Sync;

    /// What the kind states about itself, whatever its params. Where these decide ports, the ports of most params.
    fn spec() -> KindSpec;

    /// What the kind states about a node of these params. Only the params that [`Kind::port_params`] names may make it
    /// another than [`Kind::spec`]; of projected params it states the same. The default is the same for all.
    fn spec_for(_params: &Self::Params) -> KindSpec {
        Self::spec()
    }

    /// Names of the params that decide ports, or how a node works through items. A node has one set of ports, so these
    /// cannot be axes of a matrix, and [`Kind::project`] keeps them. The default is none.
    fn port_params() -> &'static [&'static str] {
        &[]
    }

    /// Problems that the schema cannot express, such as a minimum above a maximum.
    fn check(_params: &Self::Params) -> Vec<ParamProblem> {
        Vec::new()
    }

    /// Facts of the outputs before a run, and reasons why all actions are sure to fail.
    ///
    /// Both follow from the params and from the facts of the inputs: of one item for a map, of all collections for
    /// others. An unknown fact is no reason. The default gives no facts.
    fn foresee(_params: &Self::Params, _known: &Known) -> Outlook {
        Outlook::default()
    }

    /// The work of an action of a group, in any unit: times of earlier actions are scaled by it to estimate others. As
    /// with [`Kind::environment`], only projected params may decide. The default is the same for all.
    fn work(_params: &Self::Params, _group: &str) -> f64 {
        1.0
    }

    /// A name for the task of an action, such as the program that it runs, for kinds whose actions have nothing in
    /// common. Times are estimated from earlier actions with the same name. As with [`Kind::work`], only projected
    /// params may decide.
    fn sort(_params: &Self::Params) -> String {
        String::new()
    }

    /// The resources that an action of a group asks a scheduler for, where actions run as jobs. A pipeline can give
    /// others for a node. As with [`Kind::work`], only projected params may decide. The default leaves all to the
    /// scheduler.
    fn resources(_params: &Self::Params, _group: &str) -> Resources {
        Resources::default()
    }

    /// Programs and files that the params name and that this machine lacks. `check` asks for them, and also lists the
    /// items of sources. Starts no program. A file without which the node only does less is no problem.
    fn missing(_params: &Self::Params) -> Vec<ParamProblem> {
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

    /// Params that came later than the kind. Values that reproduce the behaviour before these params existed are
    /// omitted from keys. An action receives them if the params are missing, independent of current defaults.
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

    /// The properties of this machine that determine the outputs of a group, in addition to an action's inputs: a
    /// library found at run time, or the processor that is timed. It enters the keys. The default is nothing, null.
    ///
    /// It may read files, and starts no program and loads no library of a pipeline: what only those tell it asks
    /// `probe` for, and gives none where that has no answer. It reads only params that [`Kind::project`] keeps for the
    /// group, because an isolated action has no others.
    fn environment(_params: &Self::Params, _group: &str, _probe: &dyn Probe) -> Option<Value> {
        Some(Value::Null)
    }

    /// True if actions of these params run programs outside, and hand over what those looked at among files
    /// ([`Outputs::seen`]). The engine then looks at the same files before it takes such outputs again. As with
    /// [`Kind::environment`], only projected params may decide.
    fn runs_programs(_params: &Self::Params) -> bool {
        false
    }

    /// Does the work.
    ///
    /// # Errors
    /// See [`KindError`].
    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError>;
}
