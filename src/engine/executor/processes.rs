//! The executor of child processes: each worker starts one for a batch, which runs its actions and records them in the
//! store that both share.
//!
//! A child that is killed, runs out of memory or crashes takes nothing else with it. The action that it was at counts
//! an attempt, and the rest of the batch goes to another child.

use super::{
    Batch, Capacity, Executor, Order, Reply,
    threads::{Crew, Reporter, Site, spawn},
};
use crate::engine::{
    EngineError,
    batch::{BatchFile, BatchedAction, End, Line},
    event::Event,
    execute::{Execution, Outcome},
    holdings::Holdings,
    records::{ACTION, Made},
    request::LaneName,
};
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use serde_json::Value;
use std::{
    collections::{HashSet, VecDeque},
    fmt, fs,
    io::{self, BufRead, BufReader},
    os::unix::process::CommandExt,
    path::Path,
    process::{Child, ChildStdout, Command, ExitStatus, Stdio},
    sync::{
        Arc,
        atomic::Ordering,
        mpsc::{self, RecvTimeoutError},
    },
    thread::{self, Scope},
    time::Duration,
};
use tauflow_cache::Key;
use tauflow_contract::{Digest, Group, NodeKind, Progress};

/// Attempts of an action whose process does not survive it.
const MOST_ATTEMPTS: u32 = 4;
/// Time between two looks whether the run is being stopped.
const LOOK: Duration = Duration::from_millis(50);

/// Makes a command of the file of a batch and the store's folder.
type Making = dyn Fn(&Path, &Path) -> Command + Send + Sync;

/// How a child process is started, given the file of its batch and the store's folder.
#[derive(Clone)]
pub struct ChildCommand(Arc<Making>);

impl ChildCommand {
    /// The function that makes the command.
    pub fn new(command: impl Fn(&Path, &Path) -> Command + Send + Sync + 'static) -> Self {
        Self(Arc::new(command))
    }

    /// The command for a batch's file and the store's folder.
    pub fn command(&self, batch: &Path, store: &Path) -> Command {
        (self.0)(batch, store)
    }
}

impl fmt::Debug for ChildCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("ChildCommand").field(&self.command(Path::new("BATCH"), Path::new("STORE"))).finish()
    }
}

/// See the module.
pub struct Processes<'a> {
    crew: Arc<Crew<'a>>,
    queue: mpsc::Sender<Batch>,
}

impl<'a> Processes<'a> {
    /// Starts the workers, which end when this is dropped.
    pub fn start<'scope>(scope: &'scope Scope<'scope, '_>, of: Site<'a>, command: &'scope ChildCommand) -> Self
    where
        'a: 'scope,
    {
        let crew = Arc::new(Crew::new(of));
        let queue = spawn(scope, &crew, move |crew, batch| run(crew, command, batch));
        Self { crew, queue }
    }
}

impl Executor for Processes<'_> {
    fn environment(&self, kind: &dyn NodeKind, params: &Value, group: Group) -> Result<Option<Value>, EngineError> {
        // Children run on this machine, with this environment. Each checks what is in the key again.
        self.crew.environment(kind, params, group)
    }

    fn capacity(&self) -> Capacity {
        self.crew.capacity()
    }

    fn submit(&self, batch: Batch) {
        self.crew.begin(&batch);
        // The workers live as long as this does.
        let _ = self.queue.send(batch);
    }

    fn settle(&self, reply: &Reply) {
        self.crew.settle(reply);
    }

    fn cancel(&self) {
        self.crew.cancel();
    }
}

/// An action that has no reply yet.
struct OpenOrder<'a> {
    order: Order,
    /// How often a process did not survive it.
    attempts: u32,
    /// Tells how far it is, once it has begun.
    reporter: Option<Reporter<'a>>,
}

/// A batch, as far as it has no replies.
struct OpenBatch<'a, 'c> {
    crew: &'a Crew<'c>,
    label: &'a LaneName,
    holdings: Holdings<'a>,
    open: VecDeque<OpenOrder<'a>>,
}

/// Runs a batch, in as many children as it takes.
fn run(crew: &Crew<'_>, command: &ChildCommand, batch: Batch) {
    let Batch { label, wanted, orders, .. } = batch;
    let holdings = Holdings { store: crew.of.store, pool: Some(&crew.of.pool), wanted: &wanted };
    let open = orders.into_iter().map(|order| OpenOrder { order, attempts: 0, reporter: None }).collect();
    let mut rest = OpenBatch { crew, label: &label, holdings, open };
    while !rest.open.is_empty() {
        if crew.halts() {
            rest.reply(Execution::of(Outcome::Cancelled));
            continue;
        }
        match rest.child(command) {
            Ok(status) => rest.blame(status),
            Err(error) => rest.reply(Execution::of(Outcome::Fatal(error))),
        }
    }
}

impl OpenBatch<'_, '_> {
    /// Replies to the first action that is open.
    fn reply(&mut self, execution: Execution) {
        let last = self.open.len() == 1;
        if let Some(OpenOrder { order, .. }) = self.open.pop_front() {
            self.crew.reply(&order, execution, last);
        }
    }

    /// Has a child run what is open; gives how it ended.
    fn child(&mut self, command: &ChildCommand) -> Result<ExitStatus, EngineError> {
        let leave = |open: &OpenOrder<'_>| BatchedAction::leave(&open.order.action, self.holdings);
        let actions = self.open.iter().map(leave).collect::<Result<_, _>>()?;
        let batch = BatchFile { actions, wanted: sorted(self.holdings.wanted), machine: false };
        let failed = |what: &str| {
            let what = what.to_owned();
            move |error: io::Error| EngineError::Executor(format!("cannot {what}: {error}; use `--executor threads`"))
        };
        let file = tempfile::NamedTempFile::new().map_err(failed("make a file for a batch of actions"))?;
        let text = serde_json::to_vec(&batch).expect("keys and digests always serialise");
        fs::write(file.path(), text).map_err(failed("write a batch of actions"))?;
        let mut command = command.command(file.path(), self.holdings.store.dir());
        // A group of its own: Ctrl-C comes to it through the run, which lets actions in flight end.
        command.process_group(0).stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = start(&mut command).map_err(failed("start a process for a batch of actions"))?;
        let lines = child.stdout.take();
        thread::scope(|scope| {
            let (tell, told) = mpsc::channel();
            scope.spawn(move || read(lines, &tell));
            self.follow(&child, &told);
        });
        child.wait().map_err(failed("wait for a process"))
    }

    /// Replies to actions as the child tells of them, until it has ended.
    fn follow(&mut self, child: &Child, told: &mpsc::Receiver<Line>) {
        let (mut ended, mut asked) = (0, false);
        loop {
            let line = match told.recv_timeout(LOOK) {
                Ok(line) => line,
                Err(RecvTimeoutError::Timeout) => {
                    if !asked && self.crew.of.stop.load(Ordering::Relaxed) {
                        asked = true;
                        ask_to_stop(child);
                    }
                    continue;
                }
                Err(RecvTimeoutError::Disconnected) => return,
            };
            // Actions run in their order, so that the first open one is the one that it is at.
            let Some(open) = self.open.front_mut() else { continue };
            match line {
                Line::Begun { action } if action == ended => {
                    if open.reporter.is_none() {
                        open.reporter = Some(self.crew.announce(self.label, &open.order));
                    }
                }
                Line::Progress { action, done, total, message } if action == ended => {
                    if let Some(reporter) = &open.reporter {
                        reporter.report(done, total, &message);
                    }
                }
                // One that somebody else told to stop has not done it, as one that was killed.
                Line::Ended { end: End::Cancelled, .. } if !self.crew.halts() => {}
                Line::Ended { action, end, warning, spent_us, recorded } if action == ended => {
                    let nothing = "internal error: its process recorded nothing of it; please report it";
                    let outcome = outcome(&open.order, &end, recorded, self.holdings);
                    let outcome = outcome.map(|of| of.unwrap_or_else(|| Outcome::Failed(nothing.into())));
                    let outcome = outcome.unwrap_or_else(Outcome::Fatal);
                    self.reply(Execution { outcome, recorded, warning, spent_us });
                    ended += 1;
                }
                Line::Machine { .. } | Line::Begun { .. } | Line::Progress { .. } | Line::Ended { .. } => {}
            }
        }
    }

    /// A child has ended: the action that it was at, if there is one, counts an attempt.
    fn blame(&mut self, status: ExitStatus) {
        let Some(open) = self.open.front_mut() else { return };
        if self.crew.halts() {
            return;
        }
        open.attempts += 1;
        if open.attempts >= MOST_ATTEMPTS {
            let message = format!(
                "its process ended {MOST_ATTEMPTS} times before it was done, at last by {status}; if memory ran out, \
                 give fewer `--jobs`; if a library crashes, run it with `--executor threads` in a debugger"
            );
            return self.reply(Execution::of(Outcome::Failed(message)));
        }
        let item = open.order.action.item.as_ref().map_or_else(String::new, |item| format!("/{item}"));
        let message = format!("a process ended by {status} while it ran {}{item}; it runs again", self.label.node);
        (self.crew.of.sink)(&Event::Warning { message });
    }
}

/// Starts a process. Where the machine has no memory or no process to spare, it tries again a little later.
fn start(command: &mut Command) -> io::Result<Child> {
    for milliseconds in [50, 500, 2000] {
        match command.spawn() {
            Err(error) if matches!(error.kind(), io::ErrorKind::OutOfMemory | io::ErrorKind::WouldBlock) => {
                thread::sleep(Duration::from_millis(milliseconds));
            }
            started => return started,
        }
    }
    command.spawn()
}

/// The outcome of an action, from the messages of its process and from its record, whose key the process tells. None if
/// the record is not here yet.
pub(super) fn outcome(
    order: &Order,
    end: &End,
    key: Option<Key>,
    holdings: Holdings<'_>,
) -> Result<Option<Outcome>, EngineError> {
    let action = &order.action;
    let recorded = |replaced: bool| -> Result<Option<Made>, EngineError> {
        holdings.store.refresh()?;
        // A replaced record that this machine sees late is still the one of the upstream.
        let record = match key {
            Some(key) => holdings.store.lookup(ACTION, &key),
            None => action.recorded(holdings.store)?,
        };
        let record = record.filter(|record| !(replaced && record.fetched));
        Ok(holdings.made(record.as_deref(), &action.producer)?)
    };
    Ok(Some(match end {
        End::Hit => return Ok(recorded(false)?.map(Outcome::Hit)),
        End::Ran { put, replaced } => match &action.before {
            Some(made) if !replaced => Outcome::Ran(made.clone()),
            _ => return Ok(recorded(*replaced)?.map(|made| Outcome::Ran(Made { put: *put, ..made }))),
        },
        End::Failed(message) => Outcome::Failed(message.clone()),
        End::Missing(blobs) => Outcome::Missing(blobs.clone()),
        End::Cancelled => Outcome::Cancelled,
        End::Fatal(message) => Outcome::Fatal(EngineError::Executor(message.clone())),
    }))
}

/// Reads a child's lines until it closes its output. What else stands there, such as what a library printed before the
/// output was turned, is nobody's.
fn read(out: Option<ChildStdout>, tell: &mpsc::Sender<Line>) {
    let lines = out.map(BufReader::new).into_iter().flat_map(BufRead::lines);
    for line in lines.map_while(Result::ok).filter_map(|line| serde_json::from_str(&line).ok()) {
        if tell.send(line).is_err() {
            return;
        }
    }
}

fn ask_to_stop(child: &Child) {
    if let Ok(process) = i32::try_from(child.id()) {
        let _ = kill(Pid::from_raw(process), Signal::SIGTERM); // it may be gone
    }
}

fn sorted(wanted: &HashSet<Digest>) -> Vec<Digest> {
    let mut wanted: Vec<Digest> = wanted.iter().copied().collect();
    wanted.sort_unstable();
    wanted
}
