//! The command line: parses arguments, runs one command, and returns an exit code. Results go to stdout, messages to
//! stderr.

#![warn(clippy::print_stderr, clippy::print_stdout)]

#[macro_use]
mod output;

mod alone;
mod cache;
mod checkpoints;
mod config;
mod denoise;
mod descendants;
mod exec;
mod exec_args;
mod executor;
mod explain;
mod export;
mod inputs;
mod inspect;
mod notify;
mod page;
mod plan;
mod progress;
mod refine;
mod render;
mod results;
mod run;
mod runs;
mod scene;
mod setup;
mod show;
mod status;
mod terminal;
mod tev;
mod thumbnail;
mod upstream;
mod view;

pub(crate) use output::{bytes_text, counted, seconds_text, table};

use crate::{
    diagnostics::{self, Problems},
    engine::EngineError,
    kinds::Registry,
    pipeline,
    pipeline::Pipeline,
    registry,
};
use clap::{Args, CommandFactory, Parser, Subcommand};
use std::{
    cell::OnceCell,
    path::{Path, PathBuf},
    process::ExitCode,
    sync::Arc,
};
use tauflow_cache::{CacheError, Store};
use tauflow_upstream::{Address, PublicKey, Reader};

/// The result of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// Success.
    Done,
    /// Some items failed, or the cache is damaged.
    Failed,
    /// The pipeline or the arguments are invalid.
    Bad,
    /// A problem of the environment, such as disk or permissions.
    Environment,
    /// Stopped by the user.
    Interrupted,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(match exit {
            Exit::Done => 0,
            Exit::Failed => 1,
            Exit::Bad => 2,
            Exit::Environment => 3,
            Exit::Interrupted => 130,
        })
    }
}

/// The reason for which a command failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CliError {
    #[error("{0}")]
    Problems(Box<Problems>),
    #[error("{0}")]
    Bad(String),
    #[error("{0}")]
    Environment(String),
}

impl From<Problems> for CliError {
    fn from(problems: Problems) -> Self {
        Self::Problems(Box::new(problems))
    }
}

impl From<CacheError> for CliError {
    fn from(error: CacheError) -> Self {
        match error {
            CacheError::PinName { .. } => Self::Bad(error.to_string()),
            other => Self::Environment(other.to_string()),
        }
    }
}

impl From<EngineError> for CliError {
    fn from(error: EngineError) -> Self {
        match error {
            EngineError::Request(message) | EngineError::Lost(message) => Self::Bad(message),
            other => Self::Environment(other.to_string()),
        }
    }
}

/// Reproducible pipelines for Monte Carlo rendering: generate scenes, path-trace them, train denoisers, compare.
#[derive(Parser)]
#[command(name = "tauflow", version, max_term_width = 110)]
struct Cli {
    /// Cache directory. Default: $TAUFLOW_CACHE, else `cache/store` in this checkout, else `.tauflow` here.
    #[arg(long, global = true, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Upstream: a directory or object store (s3://BUCKET/PREFIX, gs://, az://, https://) that several machines share,
    /// where results are looked up that the cache lacks. Default: $TAUFLOW_UPSTREAM, else `upstream` in the user's
    /// configuration. An empty value uses none.
    #[arg(long, global = true, value_name = "DIR|URL")]
    upstream: Option<String>,
    /// Use only packs of the upstream that this public key has signed: the key, or its file. Default:
    /// $TAUFLOW_UPSTREAM_KEY, else `upstream_key` in the user's configuration. An empty value uses none.
    #[arg(long, global = true, value_name = "KEY")]
    upstream_key: Option<String>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Bring the targets of a pipeline up to date.
    Run(Box<run::RunArgs>),
    /// Show which runs are going, from another terminal: what is done, what runs, what failed.
    Status(status::StatusArgs),
    /// List the recorded runs of a cache.
    Runs(runs::RunsArgs),
    /// Compare two runs: params, outputs, metrics and times.
    Diff(runs::DiffArgs),
    /// Show which actions a run would execute, and why.
    Plan(PipelineArgs),
    /// Show the cache key of a node or item, and what changed since its last run.
    Explain(explain::ExplainArgs),
    /// Show what an item of a node is: its type, its files, and the verdict of the gate.
    Show(show::ShowArgs),
    /// Check a pipeline file and report all errors.
    Check(PipelineArgs),
    /// Draw the graph of a pipeline.
    Graph(inspect::GraphArgs),
    /// List the node kinds, or print the manual of one.
    Kinds(inspect::KindsArgs),
    /// Print the JSON Schema of pipeline files.
    Schema,
    /// Write a first pipeline and a schema for editors.
    Init(setup::InitArgs),
    /// Write the results of a node as EXR, PNG and JSON files.
    Export(export::ExportArgs),
    /// Write a viewer of a node's images: one HTML file that opens in a browser, without a server.
    View(view::ViewArgs),
    /// List the trained weights of a pipeline, or write them as safetensors files.
    Checkpoints(checkpoints::CheckpointsArgs),
    /// Render a scene.
    Render(Box<render::RenderArgs>),
    /// Denoise rendered images with the bundled models.
    Denoise(Box<denoise::DenoiseArgs>),
    /// Denoise a rendered image with a trained solver.
    Refine(refine::RefineArgs),
    /// Export a scene to other programs.
    #[command(subcommand)]
    Scene(scene::SceneCommand),
    /// Print a completion script for a shell: `source <(tauflow completions bash)`.
    Completions(setup::CompletionsArgs),
    /// Write manual pages, one per command: `man ./tauflow-run.1`.
    Man(setup::ManArgs),
    /// Rerun one cached action in isolation and compare the outputs with the recorded ones.
    Exec(exec_args::ExecArgs),
    /// Inspect and maintain the cache.
    #[command(subcommand)]
    Cache(cache::CacheCommand),
}

/// A pipeline, and overrides from the command line.
#[derive(Args)]
pub(crate) struct PipelineArgs {
    /// The pipeline file.
    pipeline: PathBuf,
    /// Apply this profile of the file.
    #[arg(long, value_name = "NAME")]
    profile: Option<String>,
    /// Override a param or named value: `node.param=VALUE` or `values.NAME=VALUE`, with VALUE in YAML. Can be
    /// repeated.
    #[arg(long = "set", value_name = "NODE.PARAM=VALUE")]
    sets: Vec<String>,
    /// Bring only this node or `node.port` up to date. Can be repeated.
    #[arg(long = "target", value_name = "NODE")]
    targets: Vec<String>,
}

impl PipelineArgs {
    fn options(&self) -> pipeline::Options {
        pipeline::Options { profile: self.profile.clone(), sets: self.sets.clone(), targets: self.targets.clone() }
    }

    fn resolve(&self, registry: &Registry) -> Result<Pipeline, CliError> {
        Ok(pipeline::resolve(&self.pipeline, registry, &self.options())?)
    }

    /// The same, with a look at the files, folders and programs that the targets need.
    fn check(&self, registry: &Registry) -> Result<Pipeline, CliError> {
        Ok(pipeline::check(&self.pipeline, registry, &self.options())?)
    }

    /// The pipeline file and the profile.
    pub(crate) fn file(&self) -> (&Path, Option<&str>) {
        (&self.pipeline, self.profile.as_deref())
    }

    /// Whether the command line overrides params or values.
    pub(crate) fn has_sets(&self) -> bool {
        !self.sets.is_empty()
    }

    /// Whether the command line names targets.
    pub(crate) fn has_targets(&self) -> bool {
        !self.targets.is_empty()
    }

    /// The profile, and what `--set` and `--target` say.
    pub(crate) fn overrides(&self) -> Vec<String> {
        let profile = self.profile.iter().map(|name| format!("--profile {name}"));
        let sets = self.sets.iter().map(|set| format!("--set {set}"));
        profile.chain(sets).chain(self.targets.iter().map(|target| format!("--target {target}"))).collect()
    }

    /// The options as given on the command line, for messages.
    fn again(&self) -> String {
        let mut words = vec![quoted(&self.pipeline.display().to_string())];
        words.extend(self.profile.iter().map(|p| format!("--profile {}", quoted(p))));
        words.extend(self.sets.iter().map(|s| format!("--set {}", quoted(s))));
        words.extend(self.targets.iter().map(|t| format!("--target {}", quoted(t))));
        words.join(" ")
    }
}

/// A mistyped command with the one command that is nearest, as everywhere else. Clap prefers long names.
fn suggested(mut error: clap::Error) -> clap::Error {
    use clap::error::{ContextKind, ContextValue};
    let Some(ContextValue::String(typed)) = error.get(ContextKind::InvalidSubcommand) else { return error };
    let command = Cli::command();
    if let Some(near) = diagnostics::nearest(typed, command.get_subcommands().map(clap::Command::get_name)) {
        error.insert(ContextKind::SuggestedSubcommand, ContextValue::Strings(vec![near.to_owned()]));
    }
    error
}

/// Runs the program with the process's arguments.
pub fn main() -> ExitCode {
    let cli = Cli::try_parse().unwrap_or_else(|error| suggested(error).exit());
    let registry = registry::registry();
    let (upstream, upstream_key) = (cli.upstream, cli.upstream_key);
    let cache = CacheAt { cache: cli.cache, upstream, upstream_key, reader: OnceCell::new() };
    let result = match cli.command {
        Command::Run(args) => run::run(&args, &registry, &cache),
        Command::Status(args) => status::status(&args, &cache),
        Command::Runs(args) => runs::runs(&args, &cache),
        Command::Diff(args) => runs::diff(&args, &cache),
        Command::Plan(args) => plan::plan(&args, &registry, &cache),
        Command::Explain(args) => explain::explain(&args, &registry, &cache),
        Command::Show(args) => show::show(&args, &registry, &cache),
        Command::Check(args) => inspect::check(&args, &registry),
        Command::Graph(args) => inspect::graph(&args, &registry, &cache),
        Command::Kinds(args) => inspect::kinds(&args, &registry),
        Command::Schema => inspect::schema(&registry),
        Command::Init(args) => setup::init(&args, &registry),
        Command::Completions(args) => setup::completions(&args, &mut Cli::command()),
        Command::Man(args) => setup::man(&args, Cli::command()),
        Command::Export(args) => export::export(&args, &registry, &cache),
        Command::View(args) => view::view(&args, &registry, &cache),
        Command::Checkpoints(args) => checkpoints::checkpoints(&args, &registry, &cache),
        Command::Denoise(args) => denoise::denoise(&args),
        Command::Refine(args) => refine::refine(&args),
        Command::Render(args) => render::render(&args, &registry, &cache),
        Command::Scene(command) => scene::scene(&command, &registry, &cache),
        Command::Exec(args) => exec::exec(&args, &registry, &cache),
        Command::Cache(command) => cache::cache(&command, &registry, &cache),
    };
    match result {
        Ok(exit) => exit.into(),
        Err(error) => {
            let exit = match &error {
                CliError::Problems(problems) => {
                    err!("{}", problems.render(terminal::colours()));
                    return Exit::Bad.into();
                }
                CliError::Bad(_) => Exit::Bad,
                CliError::Environment(_) => Exit::Environment,
            };
            errln!("error: {error}");
            exit.into()
        }
    }
}

/// The cache directory and the upstream, as given on the command line.
pub(crate) struct CacheAt {
    cache: Option<PathBuf>,
    upstream: Option<String>,
    upstream_key: Option<String>,
    /// What reads the upstream, once a command needs it.
    reader: OnceCell<Option<Arc<Reader>>>,
}

impl CacheAt {
    /// Opens the cache, and creates it if necessary. What it lacks is looked up in the upstream.
    pub(crate) fn open(&self) -> Result<Store, CliError> {
        let store = self.alone()?;
        self.looking_beyond(store)
    }

    /// Opens an existing cache for reading. What it lacks is looked up in the upstream.
    pub(crate) fn look(&self) -> Result<Store, CliError> {
        let store = self.look_alone()?;
        self.looking_beyond(store)
    }

    /// Opens the cache without an upstream, and creates it if necessary.
    pub(crate) fn alone(&self) -> Result<Store, CliError> {
        self.leave_out();
        let store = Store::open(&self.folder())?;
        if store.file_system().lockless {
            let folder = self.folder();
            terminal::note(&format!(
                "note: the file system of the cache `{}` refuses locks: two machines may execute the same action, and \
                 `cache gc` does not work; see docs/many_machines.md",
                folder.display()
            ));
        }
        Ok(store)
    }

    /// Opens an existing cache for reading, without an upstream.
    pub(crate) fn look_alone(&self) -> Result<Store, CliError> {
        self.leave_out();
        Ok(Store::open_existing(&self.folder())?)
    }

    fn looking_beyond(&self, mut store: Store) -> Result<Store, CliError> {
        if let Some(reader) = self.reader()? {
            store.look_beyond(reader);
        }
        Ok(store)
    }

    /// The upstream that the user chose.
    pub(crate) fn upstream(&self) -> Result<Option<Address>, CliError> {
        upstream::chosen(self.upstream.as_deref())
    }

    /// The key to which the upstream is pinned.
    pub(crate) fn upstream_key(&self) -> Result<Option<PublicKey>, CliError> {
        upstream::chosen_key(self.upstream_key.as_deref())
    }

    /// What reads the upstream, if there is one; all stores of this process share it.
    pub(crate) fn reader(&self) -> Result<Option<Arc<Reader>>, CliError> {
        if let Some(reader) = self.reader.get() {
            return Ok(reader.clone());
        }
        let reader = match self.upstream()? {
            Some(address) => Some(upstream::reader(address, self.upstream_key()?, self.folder())),
            None => None,
        };
        Ok(self.reader.get_or_init(|| reader).clone())
    }

    /// The cache and the default folder of results are no inputs of programs that list the folder around them.
    fn leave_out(&self) {
        [self.folder().as_path(), Path::new("out")].into_iter().for_each(tauflow_contract::leave_out_of_sights);
    }

    /// The option as given on the command line, for messages; begins with a space.
    pub(crate) fn again(&self) -> String {
        self.cache
            .as_ref()
            .map_or_else(String::new, |folder| format!(" --cache {}", quoted(&folder.display().to_string())))
    }

    /// The directory of the cache.
    pub(crate) fn folder(&self) -> PathBuf {
        if let Some(asked) = &self.cache {
            return asked.clone();
        }
        if let Some(folder) = std::env::var_os("TAUFLOW_CACHE").filter(|d| !d.is_empty()) {
            return folder.into();
        }
        let here = std::env::current_dir().unwrap_or_default();
        let is_checkout = |dir: &&Path| dir.join("Cargo.toml").is_file() && dir.join("cache/src/store.rs").is_file();
        match here.ancestors().find(is_checkout) {
            Some(checkout) => checkout.join("cache/store"),
            None => here.join(".tauflow"),
        }
    }
}

/// A word, quoted for a shell if necessary.
fn quoted(text: &str) -> String {
    let plain = text.chars().all(|c| c.is_ascii_alphanumeric() || "._-/=+:,".contains(c));
    if plain { text.to_owned() } else { format!("'{}'", text.replace('\'', "'\\''")) }
}
