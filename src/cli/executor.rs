//! Options of `run` that say where actions run.

use super::{CacheAt, CliError, config::Config, upstream};
use crate::{
    engine::{Apart, ChildCommand, ExecutorKind, JobOption, JobOptions, Scheduling},
    pipeline::Pipeline,
    units::seconds,
};
use clap::{Args, ValueEnum};
use std::{
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

/// Jobs at a time, unless `--jobs` says.
const MOST_JOBS: usize = 100;

/// Where actions run.
#[derive(Args)]
#[command(next_help_heading = "Executor")]
pub(crate) struct ExecutorArgs {
    /// Where actions run: on threads of this process, in child processes, or as jobs of a scheduler. A process or job
    /// that crashes or is killed costs its action another attempt, never the run.
    #[arg(long, value_enum, value_name = "WHERE", default_value_t = Where::Threads)]
    executor: Where,
    /// Gather ready actions into jobs that take about this time.
    #[arg(long, value_name = "TIME", default_value = "120s", value_parser = seconds)]
    batch: f64,
    /// Run an action again so often if its job ends before it is done.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(..=100))]
    retries: u32,
    /// Pass this option to `sbatch`, `hq submit` or the submit command, such as --job-option=--mem=8G. An option after
    /// a node, such as --job-option=training:--gres=gpu:1, is for jobs of this node. Can be repeated.
    #[arg(long = "job-option", value_name = "[NODE:]OPTION", allow_hyphen_values = true)]
    options: Vec<String>,
    /// Give the jobs of each machine a cache of their own in this directory, for machines without a shared file system.
    /// Batches and results go through the upstream, which must be set and writable.
    #[arg(long, value_name = "DIR")]
    worker_cache: Option<PathBuf>,
    /// With a scheduler: where actions run that only measure. `local` is the machine of this run, the default. CLASS is
    /// a feature of Slurm nodes, or a resource of HyperQueue workers: they run on one machine of this class, one at a
    /// time, with the machine to themselves. The configuration can set it, too (`timing: CLASS`).
    #[arg(long, value_name = "local|CLASS")]
    timing: Option<String>,
    /// Ask the scheduler for the state of jobs every so often.
    #[arg(long, value_name = "TIME", default_value = "3s", value_parser = seconds)]
    poll_every: f64,
    /// For --executor command: submits the script `{script}` and prints the job's id. `{name}` and `{log}` are replaced
    /// too.
    #[arg(long, value_name = "COMMAND")]
    submit: Option<String>,
    /// For --executor command: prints a line for each job that has not ended, with its id and its state. `{ids}` is
    /// replaced by the ids.
    #[arg(long, value_name = "COMMAND")]
    poll: Option<String>,
    /// For --executor command: cancels the jobs `{ids}`.
    #[arg(long, value_name = "COMMAND")]
    cancel: Option<String>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Where {
    /// Threads of this process.
    Threads,
    /// Child processes.
    Process,
    /// Jobs of Slurm.
    Slurm,
    /// Jobs of HyperQueue.
    Hyperqueue,
    /// Jobs of any scheduler, by the commands --submit, --poll and --cancel.
    Command,
}

impl ExecutorArgs {
    /// Whether jobs have a cache of their own.
    pub(crate) fn has_worker_cache(&self) -> bool {
        self.worker_cache.is_some()
    }

    /// The executor, for so many actions or jobs at a time; 0 leaves it to the executor.
    pub(crate) fn executor(&self, cache: &CacheAt, pipeline: &Pipeline, jobs: usize) -> Result<ExecutorKind, CliError> {
        if self.executor != Where::Command && (self.submit.is_some() || self.poll.is_some() || self.cancel.is_some()) {
            let message = "--submit, --poll and --cancel need --executor command";
            return Err(CliError::Bad(message.into()));
        }
        if self.worker_cache.is_some() && matches!(self.executor, Where::Threads | Where::Process) {
            return Err(CliError::Bad("--worker-cache needs --executor slurm, hyperqueue or command".into()));
        }
        let timing = self.timing()?;
        let scheduling = match self.executor {
            Where::Threads => return Ok(ExecutorKind::Threads),
            Where::Process => return Ok(ExecutorKind::Processes(worker(cache, false)?)),
            Where::Slurm => Scheduling::Slurm,
            Where::Hyperqueue => Scheduling::HyperQueue,
            Where::Command => self.commands()?,
        };
        for (option, value) in [("--batch", self.batch), ("--poll-every", self.poll_every)] {
            if !(value > 0.0 && value <= 1e6) {
                return Err(CliError::Bad(format!("{option} must be above 0 s, and at most 10 days")));
            }
        }
        Ok(ExecutorKind::Jobs(Box::new(JobOptions {
            scheduling,
            worker: worker(cache, self.worker_cache.is_some())?,
            apart: self.worker_cache.as_deref().map(|store| apart(store, cache)).transpose()?,
            resources: pipeline.nodes.iter().map(|node| (node.name.clone(), node.resources)).collect(),
            options: self.options.iter().map(|text| option(text, pipeline)).collect::<Result<_, _>>()?,
            duration: Duration::from_secs_f64(self.batch),
            retries: self.retries,
            most: if jobs == 0 { MOST_JOBS } else { jobs },
            poll: Duration::from_secs_f64(self.poll_every),
            timing,
        })))
    }

    /// The class of nodes that measure, if it is not this machine.
    fn timing(&self) -> Result<Option<String>, CliError> {
        let threads = matches!(self.executor, Where::Threads | Where::Process);
        let given = match &self.timing {
            Some(class) if threads && class != "local" => {
                let message = format!("--timing {class} needs --executor slurm, hyperqueue or command");
                return Err(CliError::Bad(message));
            }
            Some(class) => Some(class.clone()),
            None if threads => None,
            None => Config::read()?.timing,
        };
        let plain =
            |class: &str| !class.is_empty() && class.chars().all(|c| c.is_ascii_alphanumeric() || "_-./".contains(c));
        match given.filter(|class| class != "local") {
            Some(class) if class.starts_with('-') || !plain(&class) => Err(CliError::Bad(format!(
                "--timing `{class}` is no class of nodes; give `local`, or a name of letters, digits, `_`, `-`, `.` \
                 and `/`"
            ))),
            class => Ok(class),
        }
    }

    fn commands(&self) -> Result<Scheduling, CliError> {
        let known = Config::read()?.command.unwrap_or_default();
        let of = |given: &Option<String>, known: Option<String>, name: &str, must: &str| {
            let line = given.clone().or(known).ok_or_else(|| {
                CliError::Bad(format!(
                    "--executor command needs --{name}, or `{name}` below `command` in the configuration; see \
                     docs/many_machines.md"
                ))
            })?;
            if line.contains(must) {
                return Ok(line);
            }
            Err(CliError::Bad(format!("the {name} command `{line}` must contain {must}")))
        };
        Ok(Scheduling::Commands {
            submit: of(&self.submit, known.submit, "submit", "{script}")?,
            poll: of(&self.poll, known.poll, "poll", "")?,
            cancel: of(&self.cancel, known.cancel, "cancel", "{ids}")?,
        })
    }
}

/// Reads `OPTION`, or `NODE:OPTION`.
fn option(text: &str, pipeline: &Pipeline) -> Result<JobOption, CliError> {
    let Some((node, option)) = text.split_once(':').filter(|_| !text.starts_with('-')) else {
        return Ok(JobOption { node: None, text: text.to_owned() });
    };
    if !pipeline.nodes.iter().any(|known| known.name == node) {
        let known: Vec<&str> = pipeline.nodes.iter().map(|node| node.name.as_str()).collect();
        let known = known.join(", ");
        return Err(CliError::Bad(format!("--job-option {text}: unknown node `{node}`; the pipeline has {known}")));
    }
    Ok(JobOption { node: Some(node.to_owned()), text: option.to_owned() })
}

/// How jobs with a store of their own share results.
fn apart(store: &Path, cache: &CacheAt) -> Result<Apart, CliError> {
    if !store.is_absolute() {
        let message = format!("--worker-cache {} must be an absolute path", store.display());
        return Err(CliError::Bad(message));
    }
    Ok(Apart { courier: upstream::courier(cache)?, store: store.to_owned() })
}

/// The command that runs a batch in another process; `push` says that it is a note in the upstream.
fn worker(cache: &CacheAt, push: bool) -> Result<ChildCommand, CliError> {
    let program =
        std::env::current_exe().map_err(|e| CliError::Environment(format!("cannot find this program: {e}")))?;
    let upstream = cache.upstream()?.map(|address| address.to_string()).unwrap_or_default();
    let key = cache.upstream_key()?.map(|key| key.to_string()).unwrap_or_default();
    let reader = cache.reader()?;
    Ok(ChildCommand::new(move |batch, store| {
        let mut command = Command::new(&program);
        command.args(["exec", "--batch"]).arg(batch).arg("--cache").arg(store);
        command.args(push.then_some("--push"));
        // One that cannot be used was told, and children are not to tell it again.
        // A job that pushes cannot do without.
        let usable = push || reader.as_ref().is_some_and(|reader| !reader.is_lost());
        command.arg("--upstream").arg(if usable { upstream.as_str() } else { "" });
        command.arg("--upstream-key").arg(&key);
        command
    }))
}
