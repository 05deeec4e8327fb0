//! The command line: arguments in, one command each, exit codes out. Results go to stdout, all else to stderr.

#[macro_use]
mod output;

mod alone;
mod cache;
mod descendants;
mod exec;
mod explain;
mod export;
mod inspect;
mod plan;
mod progress;
mod refine;
mod results;
mod run;
mod scene;
mod setup;
mod terminal;

pub(crate) use output::{bytes_text, counted, seconds_text, table};

use crate::{diagnostics::Problems, engine::EngineError, kinds::Registry, pipeline, pipeline::Pipeline, registry};
use clap::{Args, CommandFactory, Parser, Subcommand};
use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};
use tauflow_cache::{CacheError, Store};

/// How a command ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// All is done.
    Done,
    /// Some items failed, or the cache was found damaged.
    Failed,
    /// The pipeline or the arguments are wrong.
    Bad,
    /// Disk, permissions.
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

/// Why a command did not come to its end.
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
        Self::Environment(error.to_string())
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

/// Data-flow pipelines that build Monte Carlo rendering benchmarks and train transport solvers on them.
#[derive(Parser)]
#[command(name = "tauflow", version, max_term_width = 110)]
struct Cli {
    /// Folder of the cache; else $TAUFLOW_CACHE, `cache/store` of this checkout, or `.tauflow` here.
    #[arg(long, global = true, value_name = "DIR")]
    cache: Option<PathBuf>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Bring a pipeline's targets up to date.
    Run(run::RunArgs),
    /// Show what a run would do, and why.
    Plan(PipelineArgs),
    /// Show what a node's or item's result depends on, and what changed since it last ran.
    Explain(explain::ExplainArgs),
    /// Check a pipeline file; every problem at once.
    Check(PipelineArgs),
    /// Draw a pipeline.
    Graph(inspect::GraphArgs),
    /// List the node kinds, or show the manual of one.
    Kinds(inspect::KindsArgs),
    /// Print the JSON Schema of pipeline files.
    Schema,
    /// Write a first pipeline, and settings that let editors complete it.
    Init(setup::InitArgs),
    /// Copy a node's results out, as files that other programs read.
    Export(export::ExportArgs),
    /// Render a scene.
    Render(scene::RenderArgs),
    /// Refine a rendered image with a trained solver.
    Refine(refine::RefineArgs),
    /// Work with one scene.
    #[command(subcommand)]
    Scene(scene::SceneCommand),
    /// Print a script that completes commands and options: `source <(tauflow completions bash)`.
    Completions(setup::CompletionsArgs),
    /// Write manual pages, one for each command: `man ./tauflow-run.1`.
    Man(setup::ManArgs),
    /// Run one action alone, from the cache and nothing else, and compare what it gives with the record.
    Exec(exec::ExecArgs),
    /// Look after the cache.
    #[command(subcommand)]
    Cache(cache::CacheCommand),
}

/// A pipeline, and what the command line changes of it.
#[derive(Args)]
pub(crate) struct PipelineArgs {
    /// The pipeline file.
    pipeline: PathBuf,
    /// A profile of the file.
    #[arg(long, value_name = "NAME")]
    profile: Option<String>,
    /// Override a param or a named value: `node.param=value` or `values.NAME=value`, the value as YAML. May be given
    /// several times.
    #[arg(long = "set", value_name = "NODE.PARAM=VALUE")]
    sets: Vec<String>,
    /// Bring only this node, or `node.port`, up to date. May be given several times.
    #[arg(long = "target", value_name = "NODE")]
    targets: Vec<String>,
}

impl PipelineArgs {
    fn resolve(&self, registry: &Registry) -> Result<Pipeline, CliError> {
        let options =
            pipeline::Options { profile: self.profile.clone(), sets: self.sets.clone(), targets: self.targets.clone() };
        Ok(pipeline::resolve(&self.pipeline, registry, &options)?)
    }

    /// The pipeline's file, and the profile.
    pub(crate) fn file(&self) -> (&Path, Option<&str>) {
        (&self.pipeline, self.profile.as_deref())
    }

    /// Whether the command line changes what the file and profile say.
    pub(crate) fn is_changed(&self) -> bool {
        !(self.sets.is_empty() && self.targets.is_empty())
    }

    /// The options as they stood on the command line, to be shown again.
    fn again(&self) -> String {
        let mut words = vec![quoted(&self.pipeline.display().to_string())];
        words.extend(self.profile.iter().map(|p| format!("--profile {}", quoted(p))));
        words.extend(self.sets.iter().map(|s| format!("--set {}", quoted(s))));
        words.extend(self.targets.iter().map(|t| format!("--target {}", quoted(t))));
        words.join(" ")
    }
}

/// Runs the program with the process's arguments.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let registry = registry::registry();
    let cache = CacheAt(cli.cache);
    let result = match cli.command {
        Command::Run(args) => run::run(&args, &registry, &cache),
        Command::Plan(args) => plan::plan(&args, &registry, &cache),
        Command::Explain(args) => explain::explain(&args, &registry, &cache),
        Command::Check(args) => inspect::check(&args, &registry),
        Command::Graph(args) => inspect::graph(&args, &registry),
        Command::Kinds(args) => inspect::kinds(&args, &registry),
        Command::Schema => inspect::schema(&registry),
        Command::Init(args) => setup::init(&args, &registry),
        Command::Completions(args) => setup::completions(&args, &mut Cli::command()),
        Command::Man(args) => setup::man(&args, Cli::command()),
        Command::Export(args) => export::export(&args, &registry, &cache),
        Command::Refine(args) => refine::refine(&args),
        Command::Render(args) => scene::render(&args, &registry, &cache),
        Command::Scene(command) => scene::scene(&command, &registry, &cache),
        Command::Exec(args) => exec::exec(&args, &registry, &cache),
        Command::Cache(command) => cache::cache(&command, &cache),
    };
    match result {
        Ok(exit) => exit.into(),
        Err(error) => {
            let exit = match &error {
                CliError::Problems(problems) => {
                    eprint!("{}", problems.render(terminal::colours()));
                    return Exit::Bad.into();
                }
                CliError::Bad(_) => Exit::Bad,
                CliError::Environment(_) => Exit::Environment,
            };
            eprintln!("error: {error}");
            exit.into()
        }
    }
}

/// Where the cache lies, as asked for on the command line.
pub(crate) struct CacheAt(Option<PathBuf>);

impl CacheAt {
    /// Opens it, when a command needs it.
    pub(crate) fn open(&self) -> Result<Store, CliError> {
        Ok(Store::open(&self.folder())?)
    }

    /// Opens it to look at it, and makes none where there is none.
    pub(crate) fn look(&self) -> Result<Store, CliError> {
        Ok(Store::open_existing(&self.folder())?)
    }

    /// The option as it stood on the command line, to be shown again; with a blank before it.
    pub(crate) fn again(&self) -> String {
        self.0.as_ref().map_or_else(String::new, |folder| format!(" --cache {}", quoted(&folder.display().to_string())))
    }

    /// Its folder.
    pub(crate) fn folder(&self) -> PathBuf {
        if let Some(asked) = &self.0 {
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

/// A word as a shell takes it.
fn quoted(text: &str) -> String {
    let plain = text.chars().all(|c| c.is_ascii_alphanumeric() || "._-/=+:,".contains(c));
    if plain { text.to_owned() } else { format!("'{}'", text.replace('\'', "'\\''")) }
}
