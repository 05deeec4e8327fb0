#![doc = include_str!("command_kind.md")]

use crate::{
    command,
    pfm::{as_pfm, from_pfm},
    process::{Ended, Launch, Ran, keyed_variables},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    time::Duration,
};
use tauflow_contract::{
    Action, Artifact, Before, Collection, Context, Determinism, FILE_PORT, FileTree, Group, InputPort, ItemKey, Kind,
    KindError, KindSpec, Later, MediaRow, Mode, OutputPort, Outputs, ParamProblem, Probe, ReadFiles, Seen, Takes,
    WriteFiles, interned, pretty_json,
};
use tauflow_data::{
    folder::DiskFolder,
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

/// A program at an item, or at all.
struct Invocation<'a> {
    ctx: &'a Context<'a>,
    params: &'a CommandParams,
    action: &'a Action<'a, CommandParams>,
}

impl Invocation<'_> {
    fn failed(&self, what: &str) -> KindError {
        KindError::Environment(format!("the command `{}` {what}", self.params.run.join(" ")))
    }

    fn no_folder(&self, error: &std::io::Error) -> KindError {
        self.failed(&format!("got no folder to work in: {error}"))
    }

    /// Runs it in a folder of its own, and reads its outputs.
    fn once(&self) -> Result<Outputs, KindError> {
        let own = tempfile::tempdir().map_err(|e| self.no_folder(&e))?;
        let (folder, temporary) = (own.path().join("work"), own.path().join("tmp"));
        for made in [&folder, &temporary] {
            fs::create_dir(made).map_err(|e| self.no_folder(&e))?;
        }
        self.lay_out(&folder)?;
        let words: Vec<String> = self.params.run.iter().enumerate().map(|(at, word)| whole(at, word)).collect();
        self.ctx.check_cancelled()?;
        let launch = Launch {
            words: &words,
            folder: Some(&folder),
            temporary: &temporary,
            own: own.path(),
            variables: &self.params.variables,
            trace: true,
            time: Some(Duration::from_secs_f64(self.params.time)),
            memory: self.params.memory.map(|mib| mib << 20),
        };
        let tail = |told: String| match told.is_empty() {
            true => "; it wrote nothing to standard error".to_owned(),
            false => format!("; its standard error ends with:\n{told}"),
        };
        let Ran { ended, seen, .. } = launch.run(self.ctx)?;
        match ended {
            Ended::Not(error) => Err(self.failed(&format!("cannot be started: {error}; install it, or correct `run`"))),
            Ended::Late(told) => {
                let time = self.params.time;
                Err(self.failed(&format!("took longer than {time} s (`time`) and was ended{}", tail(told))))
            }
            Ended::Itself(status, told) if !status.success() => {
                let limit = self.params.memory.map(|mib| format!(" (`memory` allows {mib} MiB)"));
                let limit = limit.unwrap_or_default();
                Err(self.failed(&format!("failed with {status}{limit}{}", tail(told))))
            }
            Ended::Itself(_, told) => match self.outputs(&folder.join("out")) {
                Ok(outputs) => Ok(Outputs { seen, ..outputs }),
                Err(KindError::Environment(what)) => Err(KindError::Environment(format!("{what}{}", tail(told)))),
                Err(other) => Err(other),
            },
        }
    }

    /// Writes `params.json` and the inputs, and makes the folders of outputs.
    fn lay_out(&self, folder: &Path) -> Result<(), KindError> {
        let Self { ctx, params, action } = self;
        let mut files = DiskFolder::new(folder);
        let keys = |all: &&Collection| all.iter().map(|(key, _)| key.as_str().to_owned()).collect::<Vec<_>>();
        let items: BTreeMap<_, _> = action.all.iter().map(|(port, all)| (*port, keys(all))).collect();
        let told = json!({
            "values": params.values, "mode": params.mode, "inputs": params.inputs, "collections": params.collections,
            "outputs": params.outputs, "items": items,
        });
        files.put("params.json", &pretty_json(&told)?)?;
        for (name, _, is_whole) in params.sources() {
            let within = folder.join("in").join(name);
            fs::create_dir_all(&within).map_err(|e| self.no_folder(&e))?;
            if is_whole {
                let all = action.all.get(name.as_str()).copied();
                for (key, artifact) in all.into_iter().flat_map(Collection::iter) {
                    check_apart(name, key, all)?;
                    self.hand_over(ctx, artifact, &within.join(key.as_str()))?;
                }
            } else if let Some(artifact) = action.each.get(name.as_str()) {
                self.hand_over(ctx, artifact, &within)?;
            }
        }
        for name in params.outputs.keys() {
            fs::create_dir_all(folder.join("out").join(name)).map_err(|e| self.no_folder(&e))?;
        }
        Ok(())
    }

    fn hand_over(&self, ctx: &Context<'_>, artifact: &Artifact, to: &Path) -> Result<(), KindError> {
        let mut files = FileTree::new();
        (row(&artifact.media)?.export)(ctx, artifact, &mut files)?;
        if self.params.images == ImageFiles::Pfm {
            files = as_pfm(&files)?;
        }
        let mut folder = DiskFolder::new(to);
        files.iter().try_for_each(|(name, bytes)| folder.put(name, bytes))
    }

    fn outputs(&self, out: &Path) -> Result<Outputs, KindError> {
        let declared: BTreeSet<&str> = self.params.outputs.keys().map(String::as_str).collect();
        let extra = entries(out)?.into_iter().find(|name| !declared.contains(name.as_str()));
        if let Some(extra) = extra {
            return Err(self.failed(&format!(
                "left `out/{extra}`, which is not declared; its outputs are `{}`",
                declared.into_iter().collect::<Vec<_>>().join("`, `")
            )));
        }
        let mut outputs = Outputs::default();
        for (name, of) in &self.params.outputs {
            let folder = out.join(name);
            if self.params.mode == CommandMode::Map {
                outputs.items.insert(name.clone(), self.read(&folder, &format!("out/{name}"), of)?);
                continue;
            }
            let mut keys = Vec::new();
            self.find_items(&folder, "", &mut keys)?;
            if keys.is_empty() {
                return Err(self.failed(&format!(
                    "left nothing in `out/{name}`; write each item into a directory `out/{name}/KEY`"
                )));
            }
            let item = |key: String| {
                let place = format!("out/{name}/{key}");
                let artifact = self.read(&folder.join(&key), &place, of)?;
                let key = ItemKey::new(key).map_err(|e| self.failed(&format!("left `{place}`: {e}")))?;
                Ok((key, artifact))
            };
            outputs.collections.insert(name.clone(), keys.into_iter().map(item).collect::<Result<_, KindError>>()?);
        }
        Ok(outputs)
    }

    /// The folders below that have files, by their paths; what is below such a folder belongs to it.
    fn find_items(&self, folder: &Path, prefix: &str, found: &mut Vec<String>) -> Result<(), KindError> {
        for name in entries(folder)? {
            let path = folder.join(&name);
            if !path.is_dir() {
                let what = format!("left the file `{prefix}{name}` outside of the directory of an item");
                return Err(self.failed(&what));
            }
            let key = format!("{prefix}{name}");
            let below = entries(&path)?;
            if below.is_empty() {
                return Err(self.failed(&format!("left the empty directory `{key}` for an item")));
            }
            if below.iter().any(|name| !path.join(name).is_dir()) {
                found.push(key);
            } else {
                self.find_items(&path, &format!("{key}/"), found)?;
            }
        }
        Ok(())
    }

    /// An output, as `import` reads what `export` wrote.
    fn read(&self, folder: &Path, place: &str, of: &str) -> Result<Artifact, KindError> {
        let row = row(of)?;
        let unreadable = |error: KindError| match error {
            KindError::Input(what) => self.failed(&format!("left no `{of}` in `{place}`: {what}")),
            other => other,
        };
        if !folder.is_dir() {
            return Err(self.failed(&format!("removed the directory `{place}`")));
        }
        let disk = DiskFolder::new(folder);
        let mut files = FileTree::new();
        for name in disk.names().map_err(unreadable)? {
            files.insert(name.clone(), disk.need(&name).map_err(unreadable)?);
        }
        if files.is_empty() {
            return Err(self.failed(&format!("left no files in `{place}`, expected a `{of}`: {}", row.doc)));
        }
        if self.params.images == ImageFiles::Pfm {
            files = from_pfm(files).map_err(unreadable)?;
        }
        let artifact = (row.import)(self.ctx, &files).map_err(unreadable)?;
        // What `export` does not write, `import` did not read.
        let mut known = FileTree::new();
        (row.export)(self.ctx, &artifact, &mut known)?;
        match files.keys().find(|name| !known.contains_key(*name)) {
            None => Ok(artifact),
            Some(extra) => Err(self.failed(&format!(
                "left `{place}/{extra}`, which is no file of this `{of}`; its files are `{}`",
                known.into_keys().collect::<Vec<_>>().join("`, `")
            ))),
        }
    }
}

/// The row of a media type, which `check` has found.
fn row(name: &str) -> Result<&'static MediaRow, KindError> {
    media(name).ok_or_else(|| KindError::Internal(format!("`{name}` is no media type")))
}

/// Refuses an item whose folder would lie in the folder of another.
fn check_apart(port: &str, key: &ItemKey, all: Option<&Collection>) -> Result<(), KindError> {
    let key = key.as_str();
    let mut above = key.match_indices('/').map(|(at, _)| &key[..at]);
    match above.find(|above| all.is_some_and(|all| all.get(above).is_some())) {
        None => Ok(()),
        Some(above) => Err(KindError::Input(format!(
            "input `{port}` has the items `{above}` and `{key}`, whose directories would lie in each other; rename one"
        ))),
    }
}

/// A word of a command line; the path of a file as a whole path, since the program works in another folder.
fn whole(at: usize, word: &str) -> String {
    let path = Path::new(word);
    let names = path.is_relative() && path.is_file() && (at > 0 || word.contains('/'));
    let absolute: Option<PathBuf> = names.then(|| std::path::absolute(path).ok()).flatten();
    absolute.map_or_else(|| word.to_owned(), |path| path.to_string_lossy().into_owned())
}

/// Names in a folder, sorted.
fn entries(folder: &Path) -> Result<Vec<String>, KindError> {
    let failed = |e: std::io::Error| KindError::Environment(format!("cannot list {}: {e}", folder.display()));
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        names.push(entry.map_err(failed)?.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    Ok(names)
}
