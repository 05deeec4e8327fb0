//! The executor of a job scheduler: actions run as jobs on other machines, or on this one, and record their outputs in
//! the store that all of them share.
//!
//! Ready actions are gathered into jobs of similar duration ([`bundle`]). A job is a folder's batch file, which
//! `tauflow exec --batch FILE --lines FILE` runs, and a file of lines that tell what became of each action
//! ([`folder`]). One thread, the [`steward`], submits jobs, reads these lines, and asks the scheduler ([`queue`]) which
//! jobs have ended. It knows nothing of a scheduler beyond the commands of [`queue`].
//!
//! Actions that measure run in this process, one at a time, while no job is open; or in jobs of a class of nodes, one
//! job at a time and alone on the machine that [`machine`] found.

mod bundle;
mod folder;
mod job;
mod machine;
mod pace;
mod queue;
mod steward;

use super::{
    Batch, Capacity, ChildCommand, Executor, Reply,
    threads::{self, Crew, Site},
};
use crate::{
    engine::{EngineError, courier::Courier},
    pipeline::AskedResources,
};
pub use machine::{Place, find as measuring_place};
use serde_json::Value;
use std::{
    collections::HashMap,
    path::PathBuf,
    sync::{Arc, mpsc},
    thread::Scope,
    time::Duration,
};
use steward::Steward;
use tauflow_contract::{Group, NodeKind};

/// Orders that are taken on before any is done.
const MOST_ORDERS: usize = 16_384;

/// Which scheduler runs the jobs.
#[derive(Clone, Debug)]
pub enum Scheduling {
    /// Slurm, by `sbatch`, `squeue`, `sacct` and `scancel`.
    Slurm,
    /// HyperQueue, by `hq`.
    HyperQueue,
    /// Any other, by command lines for a shell.
    Commands {
        /// Submits `{script}`, and prints the job's id.
        submit: String,
        /// Prints a line for each job that has not ended: its id and its state.
        poll: String,
        /// Cancels the jobs `{ids}`.
        cancel: String,
    },
}

impl Scheduling {
    /// Its name, as on the command line.
    pub fn name(&self) -> String {
        let name = match self {
            Self::Slurm => "slurm",
            Self::HyperQueue => "hyperqueue",
            Self::Commands { .. } => "command",
        };
        name.to_owned()
    }
}

/// Jobs that share no files with the run.
#[derive(Clone, Debug)]
pub struct Apart {
    /// What carries batches, lines and results.
    pub courier: Arc<dyn Courier>,
    /// The folder of the store on the machines of jobs.
    pub store: PathBuf,
}

/// An option of the command that submits jobs.
#[derive(Clone, Debug)]
pub struct JobOption {
    /// The node whose jobs it is for; all of them unless named.
    pub node: Option<String>,
    /// The option.
    pub text: String,
}

/// How jobs are made.
#[derive(Clone, Debug)]
pub struct JobOptions {
    /// Who runs them.
    pub scheduling: Scheduling,
    /// The command that executes a batch.
    pub worker: ChildCommand,
    /// How jobs share results with the run, if each machine has a store of its own; they share the run's store
    /// otherwise.
    pub apart: Option<Apart>,
    /// Resources of actions as the pipeline gives them, by node.
    pub resources: HashMap<String, AskedResources>,
    /// More options of the command that submits.
    pub options: Vec<JobOption>,
    /// The duration of a job that actions are gathered for.
    pub duration: Duration,
    /// How often an action runs again whose job ended before it was done.
    pub retries: u32,
    /// Jobs that are submitted and have not ended, at most.
    pub most: usize,
    /// Time between two questions to the scheduler.
    pub poll: Duration,
    /// The class of nodes that measure; the machine of the run measures unless told.
    pub timing: Option<String>,
}

/// See the module.
pub struct Jobs<'a> {
    crew: Arc<Crew<'a>>,
    jobs: mpsc::Sender<Batch>,
    here: mpsc::Sender<Batch>,
    /// Jobs measure.
    there: bool,
}

impl<'a> Jobs<'a> {
    /// Starts the threads, which end when this is dropped. Jobs that measure run on this node, if it has a name.
    pub fn start<'scope>(
        scope: &'scope Scope<'scope, '_>,
        of: Site<'a>,
        options: &'scope JobOptions,
        node: Option<String>,
    ) -> Self
    where
        'a: 'scope,
    {
        // Neither the processors nor the memory of this machine bound what other machines do.
        let there = options.timing.is_some();
        let crew = Crew::new(Site { workers: MOST_ORDERS, memory: u64::MAX, ..of });
        let crew = Arc::new(if there { crew.measuring_elsewhere() } else { crew });
        let (jobs, ordered) = mpsc::channel();
        let steering = crew.clone();
        scope.spawn(move || Steward::new(&steering, options, node).run(&ordered));
        let (here, measured) = mpsc::channel();
        let measuring = crew.clone();
        scope.spawn(move || measured.iter().for_each(|batch| threads::run(&measuring, batch)));
        Self { crew, jobs, here, there }
    }
}

impl Executor for Jobs<'_> {
    fn environment(&self, kind: &dyn NodeKind, params: &Value, group: Group) -> Result<Option<Value>, EngineError> {
        // A job refuses an action whose key names another environment than its machine has.
        self.crew.environment(kind, params, group)
    }

    fn capacity(&self) -> Capacity {
        self.crew.capacity()
    }

    fn submit(&self, batch: Batch) {
        self.crew.begin(&batch);
        let queue = if batch.alone && !self.there { &self.here } else { &self.jobs };
        // The threads live as long as this does.
        let _ = queue.send(batch);
    }

    fn settle(&self, reply: &Reply) {
        self.crew.settle(reply);
    }

    fn cancel(&self) {
        self.crew.cancel();
    }
}
