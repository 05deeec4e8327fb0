//! Batches of actions in a process of their own, as `tauflow exec --batch FILE` runs them: the file that says what to
//! run, and the lines that tell what became of it.
//!
//! The two processes share the store and nothing else.

mod remote;

use super::{
    EngineError,
    courier::Courier,
    exec::{ActionFile, ExecError, ExecSite, Handling},
    execute::{ActionInputs, Execution, Outcome, PreparedAction},
    holdings::Holdings,
    ids::Id,
    measured::{Fetched, Machine},
};
use crate::kinds::Registry;
use nix::{
    sys::{prctl, signal::Signal},
    unistd::dup2_stdout,
};
use serde::{Deserialize, Serialize};
use std::{
    collections::HashSet,
    fs::File,
    io::{self, Write},
    os::fd::AsFd,
    path::Path,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};
use tauflow_cache::{CacheError, Key, Store};
use tauflow_contract::{Digest, Progress, read_regular};

/// Most bytes of a batch's file: far more than any has.
const MOST_BYTES: u64 = 1 << 30;

/// How late a network file system lists the files of other machines: NFS does so for up to a minute by default.
const LISTED_LATE: Duration = Duration::from_secs(60);
/// Time between two looks for what is listed late.
const LOOK_AGAIN: Duration = Duration::from_millis(500);

/// The actions that a process runs, in this order.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BatchFile {
    /// The actions.
    pub actions: Vec<BatchedAction>,
    /// Blobs that were found missing: a record that names one counts only when it is there again.
    #[serde(default)]
    pub wanted: Vec<Digest>,
    /// Tell the machine first.
    #[serde(default)]
    pub machine: bool,
}

/// An action of a batch.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BatchedAction {
    /// The action.
    pub action: ActionFile,
    /// How its pipeline handles it.
    #[serde(default)]
    pub handling: Handling,
    /// It was done before, and runs only to be compared.
    #[serde(default)]
    pub compare: bool,
}

/// Messages of a process, one line of JSON each. Actions are named by their place in the batch.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "batch", rename_all = "snake_case")]
pub enum Line {
    /// The machine that runs the batch.
    Machine {
        /// It.
        of: Machine,
        /// Its name for the scheduler.
        node: Option<String>,
    },
    /// An action begins.
    Begun {
        /// Which.
        action: usize,
    },
    /// A long action goes on.
    Progress {
        /// Which.
        action: usize,
        /// Units done.
        done: u64,
        /// The total number of units.
        total: u64,
        /// A line.
        message: String,
    },
    /// An action has ended.
    Ended {
        /// Which.
        action: usize,
        /// How.
        end: End,
        /// A remark, such as two outputs for one key.
        warning: Option<String>,
        /// Wall time in microseconds.
        spent_us: u64,
        /// The key of its record. Whoever looked for it again could find a file changed that its program opened.
        #[serde(default)]
        recorded: Option<Key>,
    },
}

/// How an action ended. Its outputs are in the store, under its key.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// Somebody else did it meanwhile.
    Hit,
    /// It ran.
    Ran {
        /// Bytes of the blobs that it put.
        put: u64,
        /// It was compared, and its outputs took the place of those that an upstream had.
        #[serde(default)]
        replaced: bool,
    },
    /// It failed.
    Failed(String),
    /// These blobs of its inputs are missing.
    Missing(Vec<Digest>),
    /// It was stopped.
    Cancelled,
    /// The store failed: no action can run.
    Fatal(String),
}

impl BatchedAction {
    /// The blobs that it reads.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub(super) fn reads(&self, store: &Store) -> Result<Vec<Digest>, CacheError> {
        let ActionInputs { each, whole, .. } = &self.action.recipe;
        let parts: Vec<Digest> = each.values().flat_map(|artifact| artifact.parts.values().copied()).collect();
        let listings: Vec<Digest> = whole.values().map(|listed| listed.blob).collect();
        store.reach(&parts, &listings)
    }

    /// An action that leaves this process. What only this process holds of its inputs is stored first.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub(super) fn leave(action: &PreparedAction, holdings: Holdings<'_>) -> Result<Self, CacheError> {
        let Holdings { store, pool, .. } = holdings;
        let keep = |digest: &Digest| match pool.and_then(|pool| pool.get(digest)) {
            Some(bytes) => store.put(&bytes).map(drop),
            None => Ok(()),
        };
        action.each.iter().flat_map(|(_, output)| output.artifact.parts.values()).try_for_each(keep)?;
        if pool.is_some_and(|pool| pool.bytes() > 0) {
            for (_, sharded) in action.whole.iter() {
                sharded.blobs(store)?.0.iter().try_for_each(keep)?;
            }
        }
        let producer = &action.producer;
        let name = |port: &super::ids::PortId| producer.spec.outputs[port.place()].name.to_owned();
        let handling = Handling {
            transient: producer.transient,
            read: producer.read.iter().map(name).collect(),
            own: producer.fetched != Fetched::All,
        };
        let file = ActionFile { key: action.key.clone(), recipe: action.given(store)? };
        Ok(Self { action: file, handling, compare: action.before.is_some() })
    }

    /// Executes it. A network file system may list inputs late, in the cache or in the upstream: while some are missing
    /// there, it is tried again, for a minute in a batch.
    fn run_with_inputs(
        self,
        site: &ExecSite<'_>,
        progress: &dyn Progress,
        patience: &mut Duration,
    ) -> Result<(Execution, Option<PreparedAction>), CacheError> {
        let store = site.holdings.store;
        loop {
            let done = self.clone().run(site, progress);
            let missing = matches!(done.0.outcome, Outcome::Missing(_));
            let late = missing && (store.file_system().network.is_some() || store.beyond_lists_late());
            if !late || patience.is_zero() || site.stop.load(Ordering::Relaxed) {
                return Ok(done);
            }
            thread::sleep(LOOK_AGAIN);
            *patience = patience.saturating_sub(LOOK_AGAIN);
            store.refresh()?;
            store.refresh_beyond();
        }
    }

    /// Executes it; the action itself, if it could be executed.
    fn run(self, site: &ExecSite<'_>, progress: &dyn Progress) -> (Execution, Option<PreparedAction>) {
        let failed = match self.action.execute(site, self.handling, self.compare, progress) {
            Ok((action, execution)) => return (execution, Some(action)),
            Err(ExecError::Missing(blob)) => Outcome::Missing(vec![blob]),
            Err(ExecError::Cache(error)) => Outcome::Fatal(error.into()),
            Err(other) => Outcome::Failed(other.to_string()),
        };
        (Execution::of(failed), None)
    }
}

struct Reporter<'a> {
    action: usize,
    tell: &'a (dyn Fn(&Line) + Sync),
}

impl Progress for Reporter<'_> {
    fn report(&self, done: u64, total: u64, message: &str) {
        (self.tell)(&Line::Progress { action: self.action, done, total, message: message.to_owned() });
    }
}

impl BatchFile {
    /// Reads a batch.
    ///
    /// # Errors
    /// In words if the file cannot be read, or is no batch.
    pub fn read(path: &Path) -> Result<Self, String> {
        let refused = |why: String| format!("{} is no batch of actions: {why}; `run` writes them", path.display());
        let bytes = read_regular(path, MOST_BYTES).map_err(|e| refused(e.to_string()))?;
        Self::parse(&bytes).map_err(refused)
    }

    /// Reads the text of a batch.
    ///
    /// # Errors
    /// In words if it is none.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        serde_json::from_slice(bytes).map_err(|error| error.to_string())
    }

    /// Executes the actions one after the other; each line is told as it happens. Before an action has ended,
    /// `recorded` is told the key of its record, which is not the action's own if it ran a program.
    ///
    /// # Errors
    /// If the store fails.
    pub fn run(
        self,
        store: &Store,
        registry: &Registry,
        stop: &AtomicBool,
        tell: &(dyn Fn(&Line) + Sync),
        recorded: Option<&dyn Fn(Key)>,
    ) -> Result<(), EngineError> {
        if self.machine {
            tell(&Line::Machine { of: Machine::here(), node: std::env::var("SLURMD_NODENAME").ok() });
        }
        let wanted = self.wanted.into_iter().collect::<HashSet<_>>();
        // Nothing is passed on in memory here: all inputs are stored.
        let site = ExecSite { holdings: Holdings::stored(store, &wanted), registry, stop };
        let mut patience = LISTED_LATE;
        for (action, of) in self.actions.into_iter().enumerate() {
            let compare = of.compare;
            let (execution, executed) = if stop.load(Ordering::Relaxed) {
                (Execution::of(Outcome::Cancelled), None)
            } else {
                tell(&Line::Begun { action });
                of.run_with_inputs(&site, &Reporter { action, tell }, &mut patience)?
            };
            if let (Some(note), Some(executed)) = (recorded, executed)
                && let Outcome::Hit(_) | Outcome::Ran(_) = execution.outcome
            {
                // An action that was compared, and found equal, recorded nothing.
                let key = match execution.recorded {
                    Some(key) => Some(key),
                    None => executed.recorded(store)?.map(|record| record.key),
                };
                key.into_iter().for_each(note);
            }
            let Execution { recorded: key, warning, spent_us, .. } = execution;
            let (end, fatal) = match execution.outcome {
                Outcome::Hit(_) => (End::Hit, None),
                // An action that is compared has a remark only if its record was quarantined.
                Outcome::Ran(made) => (End::Ran { put: made.put, replaced: compare && warning.is_some() }, None),
                // A signal to all processes of a job ends programs of the action, too.
                Outcome::Failed(_) if signalled(stop) => (End::Cancelled, None),
                Outcome::Failed(message) => (End::Failed(message), None),
                Outcome::Missing(blobs) => (End::Missing(blobs), None),
                Outcome::Cancelled | Outcome::Elsewhere(_) => (End::Cancelled, None),
                Outcome::Fatal(error) => (End::Fatal(error.to_string()), Some(error)),
            };
            tell(&Line::Ended { action, end, warning, spent_us, recorded: key });
            if let Some(error) = fatal {
                return Err(error);
            }
        }
        Ok(store.flush()?)
    }
}

/// Whether this process is told to stop. The signal is taken on another thread, and may be on its way.
fn signalled(stop: &AtomicBool) -> bool {
    if !stop.load(Ordering::Relaxed) {
        thread::sleep(Duration::from_millis(20));
    }
    stop.load(Ordering::Relaxed)
}

/// Where a batch's process tells its lines.
#[derive(Clone, Copy)]
pub enum Telling<'a> {
    /// On stdout, to the process that started it; it stops when that is gone.
    Parent,
    /// In this file.
    File(&'a Path),
    /// In a note, after the records of the actions that it tells of were published.
    Note(&'a dyn Courier, &'a str),
}

/// Executes a batch in this process, which was started for it, and stops on SIGTERM and SIGINT. What the actions
/// themselves print goes to stderr.
///
/// # Errors
/// If this process cannot be made ready, the store fails, or results cannot be published.
pub fn serve(batch: BatchFile, store: &Store, registry: &Registry, to: Telling<'_>) -> Result<(), EngineError> {
    let failed = |what: &str, error: io::Error| EngineError::Executor(format!("cannot {what}: {error}"));
    let stop = Arc::new(AtomicBool::new(false));
    let seen = stop.clone();
    ctrlc::set_handler(move || seen.store(true, Ordering::Relaxed))
        .map_err(|e| EngineError::Executor(format!("cannot listen for signals: {e}")))?;
    let told = match to {
        Telling::Note(courier, name) => {
            dup2_stdout(io::stderr()).map_err(|e| failed("turn its output", e.into()))?;
            return remote::serve(batch, store, registry, &stop, (courier, name));
        }
        Telling::File(path) => {
            let file = File::options().append(true).create(true).open(path);
            file.map_err(|e| failed(&format!("write {}", path.display()), e))?
        }
        Telling::Parent => {
            prctl::set_pdeathsig(Signal::SIGTERM).map_err(|e| failed("listen for the end of its parent", e.into()))?;
            File::from(io::stdout().as_fd().try_clone_to_owned().map_err(|e| failed("keep its output", e))?)
        }
    };
    dup2_stdout(io::stderr()).map_err(|e| failed("turn its output", e.into()))?;
    let told = Mutex::new(told);
    let tell = |line: &Line| {
        let mut text = serde_json::to_string(line).expect("lines are plain data");
        text.push('\n');
        // Whoever started this process may have gone; what is done is recorded all the same.
        let _ = told.lock().unwrap_or_else(PoisonError::into_inner).write_all(text.as_bytes());
    };
    batch.run(store, registry, &stop, &tell, None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        engine::{
            execute::Producer, ids::InputId, measured::Fetched, output::Output, sharded::Sharded, transient::Pool,
        },
        registry::registry,
    };
    use std::collections::BTreeMap;
    use tauflow_contract::{ActionKey, Artifact, Basis, ItemKey};

    #[test]
    fn inputs_that_only_memory_holds_are_stored_before_an_action_leaves() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let store = Store::open(folder.path()).expect("a store");
        let (pool, wanted) = (Pool::new(1 << 20), HashSet::new());
        let pooled = |text: &str| {
            let bytes = Arc::new(text.as_bytes().to_vec());
            let digest = Digest::of(&bytes);
            assert!(pool.put(digest, &bytes) && !store.contains(&digest));
            (digest, Output::new(Artifact::tree("m", [(String::new(), digest)])))
        };
        let ((one, each), (other, item)) = (pooled("by item"), pooled("as a whole"));
        let whole = Sharded::of([(ItemKey::new("a").expect("a key"), item)]);
        let registry = registry();
        let kind = registry.get("image_metrics").expect("a kind of two inputs").clone();
        let (spec, group, read) = (kind.spec(), "main", Vec::new());
        let key = ActionKey { basis: Basis::new("image_metrics", 1, group), inputs: BTreeMap::new() };
        let action = PreparedAction {
            producer: Arc::new(Producer {
                kind,
                spec,
                group,
                transient: true,
                read,
                fetched: Fetched::All,
                bound: false,
            }),
            hash: key.hash(),
            key,
            item: None,
            each: vec![(InputId::at(0), each)],
            whole: Arc::new(vec![(InputId::at(1), Arc::new(whole))]),
            file: None,
            before: None,
        };
        let holdings = Holdings { store: &store, pool: Some(&pool), wanted: &wanted };
        let left = BatchedAction::leave(&action, holdings).expect("the store has room");
        assert!(store.contains(&one) && store.contains(&other), "a child has no other place to read them");
        assert!(left.handling.transient && !left.compare);
        let batch = BatchFile { actions: vec![left], ..BatchFile::default() };
        let text = serde_json::to_string(&batch).expect("plain data");
        let back: BatchFile = serde_json::from_str(&text).expect("own text parses");
        assert_eq!(back.actions[0].action, batch.actions[0].action);
    }
}
