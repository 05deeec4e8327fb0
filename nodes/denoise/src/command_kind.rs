#![doc = include_str!("command_kind.md")]

mod invocation;

use crate::{command, process::keyed_variables};
use invocation::Invocation;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use tauflow_contract::{
    Action, Before, Context, Determinism, FILE_PORT, Group, InputPort, Kind, KindError, KindSpec, Later, Mode,
    OutputPort, Outputs, ParamProblem, Probe, Resources, Seen, Takes, interned,
};
use tauflow_data::{
    records::{MEDIA, media},
    timing::machine,
};

/// The kind `command`.
pub struct CommandKind;

/// How a program works through items.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CommandMode {
    /// Once for each item.
    #[default]
    Map,
    /// Once for all items.
    Gather,
}

/// Whether another run of a program gives the same bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Reproducible {
    /// The same bits on this machine.
    #[default]
    Machine,
    /// The same bits on every machine: it is run twice, and the outputs are compared.
    Everywhere,
    /// Other bits each time.
    No,
}

/// The format of images in the directories of inputs and outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ImageFiles {
    /// OpenEXR, as `tauflow export` writes it.
    #[default]
    Exr,
    /// Portable float maps, which need no library to be read.
    Pfm,
}

/// Params of `command`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CommandParams {
    /// The program and its arguments, as a list of words. Required. The path of a file is passed as an absolute path.
    pub run: Vec<String>,
    /// Whether the program runs once per item or once for all items.
    pub mode: CommandMode,
    /// The inputs with their media types. The program of a map gets one item of each. The first in alphabetical order
    /// determines the items.
    pub inputs: BTreeMap<String, String>,
    /// Inputs of a map that pass all items to the program, with their media types.
    pub collections: BTreeMap<String, String>,
    /// The outputs with their media types. Required.
    pub outputs: BTreeMap<String, String>,
    /// Params of the program, as `values` in `params.json`.
    pub values: Map<String, Value>,
    /// The format of images in the directories of inputs and outputs.
    pub images: ImageFiles,
    /// Files, directories and patterns such as `models/*.pt` that the program depends on, in addition to traced files.
    /// Their contents are part of the keys.
    pub depends: Vec<String>,
    /// Command that prints the version of the program, as a list of words. Its output is part of the keys.
    pub version: Vec<String>,
    /// Additional environment variables that the program inherits. Their values are part of the keys.
    pub variables: Vec<String>,
    /// Whether two runs of the program give the same bits.
    pub reproducible: Reproducible,
    /// Maximum wall time in seconds.
    #[schemars(range(min = 0.1, max = 1_000_000.0))]
    pub time: f64,
    /// Maximum address space of each process in MiB; null for no limit.
    #[schemars(range(min = 16, max = 1_000_000_000))]
    pub memory: Option<u64>,
}

impl Default for CommandParams {
    fn default() -> Self {
        Self {
            run: Vec::new(),
            mode: CommandMode::Map,
            inputs: BTreeMap::new(),
            collections: BTreeMap::new(),
            outputs: BTreeMap::new(),
            values: Map::new(),
            images: ImageFiles::Exr,
            depends: Vec::new(),
            version: Vec::new(),
            variables: Vec::new(),
            reproducible: Reproducible::Machine,
            time: 3600.0,
            memory: None,
        }
    }
}

const MAIN: Group = Group::main(1);

impl CommandParams {
    /// Names and media types of inputs, with whether the program gets all items.
    fn sources(&self) -> impl Iterator<Item = (&String, &String, bool)> {
        let gather = self.mode == CommandMode::Gather;
        let inputs = self.inputs.iter().map(move |(name, media)| (name, media, gather));
        inputs.chain(self.collections.iter().map(|(name, media)| (name, media, true)))
    }

    fn determinism(&self) -> Determinism {
        match self.reproducible {
            Reproducible::Machine => Determinism::Local,
            Reproducible::Everywhere => Determinism::Bitwise,
            Reproducible::No => Determinism::Measured,
        }
    }
}

/// What is wrong with a name and a media type of a port.
fn port_problem(of: &str, name: &str, of_media: &str) -> Option<ParamProblem> {
    let pointer = format!("/{of}/{}", name.replace('~', "~0").replace('/', "~1"));
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if name.is_empty() || !name.chars().all(plain) || name == FILE_PORT {
        let hint = "use letters, digits, `_` and `-`, and another word than `file`";
        return Some(ParamProblem::new(pointer, format!("`{name}` cannot name a port"), hint));
    }
    if media(of_media).is_none() {
        let names: Vec<&str> = MEDIA.iter().map(|row| row.name).collect();
        let message = format!("there is no media type `{of_media}`");
        return Some(ParamProblem::new(pointer, message, format!("use one of {}", names.join(", "))));
    }
    None
}

impl Kind for CommandKind {
    type Params = CommandParams;

    fn spec() -> KindSpec {
        Self::spec_for(&CommandParams::default())
    }

    fn spec_for(params: &Self::Params) -> KindSpec {
        let known = |name: &String| media(name).map(|row| row.name);
        let inputs = params.sources().filter_map(|(name, of, whole)| {
            let takes = if whole { Takes::Collection } else { Takes::Item };
            let (media, doc) = (known(of)?, "As declared.");
            Some(InputPort { name: interned(name), media, takes, optional: false, single: false, doc })
        });
        let outputs = params.outputs.iter().filter_map(|(name, of)| {
            Some(OutputPort {
                name: interned(name),
                media: known(of)?,
                group: MAIN,
                filter: false,
                single: false,
                determinism: params.determinism(),
                publish: false,
                doc: "As declared.",
            })
        });
        KindSpec {
            name: "command",
            summary: "Runs any program, with declared inputs and outputs.",
            manual: include_str!("command_kind.md"),
            mode: match params.mode {
                CommandMode::Map => Mode::Map,
                CommandMode::Gather => Mode::Gather,
            },
            inputs: inputs.collect(),
            outputs: outputs.collect(),
            seeded: false,
        }
    }

    fn port_params() -> &'static [&'static str] {
        &["mode", "inputs", "collections", "outputs", "reproducible"]
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut found = Vec::new();
        let mut problem = |pointer: &str, message: &str, hint: &str| {
            found.push(ParamProblem::new(pointer, message, hint));
        };
        if params.run.is_empty() {
            problem("/run", "there is no command", "write for example `run: [python3, denoise.py]`");
        }
        if params.outputs.is_empty() {
            problem("/outputs", "there are no outputs", "write for example `outputs: { refined: tauflow/refined }`");
        }
        if params.mode == CommandMode::Map && params.inputs.is_empty() {
            let hint = "declare an input whose items it runs for, or write `mode: gather`";
            problem("/inputs", "a map without inputs has no items", hint);
        }
        if let Some(double) = params.inputs.keys().find(|name| params.collections.contains_key(*name)) {
            let message = format!("`{double}` stands in `inputs` and in `collections`");
            problem("/collections", &message, "keep one of the two");
        }
        for (of, ports) in
            [("inputs", &params.inputs), ("collections", &params.collections), ("outputs", &params.outputs)]
        {
            found.extend(ports.iter().filter_map(|(name, media)| port_problem(of, name, media)));
        }
        found
    }

    fn missing(params: &Self::Params) -> Vec<ParamProblem> {
        command::missing(&params.run, "/run", &params.depends)
    }

    fn environment(params: &Self::Params, _group: &str, probe: &dyn Probe) -> Option<Value> {
        let mut found = json!({
            "program": command::identity(&params.run),
            "depends": command::depended(&params.depends),
            "version": command::probed_version(&params.version, probe)?,
            "variables": keyed_variables(&params.variables),
        });
        if params.reproducible != Reproducible::Everywhere {
            found["machine"] = json!(machine());
        }
        Some(found)
    }

    fn sort(params: &Self::Params) -> String {
        params.run.join(" ")
    }

    fn resources(params: &Self::Params, _group: &str) -> Resources {
        let runs = if params.reproducible == Reproducible::Everywhere { 2.0 } else { 1.0 };
        let limited = Resources::default().time(params.time * runs);
        params.memory.map_or(limited, |mib| limited.memory(mib.saturating_mul(1 << 20)))
    }

    fn later() -> &'static [Later] {
        // An empty list of words.
        &[Later { pointer: "/variables", before: Before::Integers(&[]) }]
    }

    fn runs_programs(_params: &Self::Params) -> bool {
        true
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        command::check_depends(&params.depends)?;
        command::version(&params.version).map_err(KindError::Environment)?;
        let work = Invocation { ctx, params, action };
        let mut made = work.once()?;
        if params.reproducible == Reproducible::Everywhere {
            let mut again = work.once()?;
            if let (Some(first), Some(second)) = (&mut made.seen, again.seen.take()) {
                first.join(second);
            }
            made.seen = made.seen.map(Seen::portable);
            let item = |name: &&String| made.items.get(*name) == again.items.get(*name);
            let all = |name: &&String| made.collections.get(*name) == again.collections.get(*name);
            let differ: Vec<&str> =
                params.outputs.keys().filter(|name| !(item(name) && all(name))).map(String::as_str).collect();
            if !differ.is_empty() {
                return Err(work.failed(&format!(
                    "is declared `reproducible: everywhere`, but two runs gave different outputs on `{}`; seed its \
                     random numbers, or write `reproducible: no`",
                    differ.join("`, `")
                )));
            }
        }
        Ok(made)
    }
}
