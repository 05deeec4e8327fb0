//! What a scheduler is asked for: to run jobs, which of them have not ended, why one ended, and to cancel some.

mod commands;
mod hyperqueue;
mod slurm;

use super::{
    JobOptions, Scheduling,
    folder::{Folder, NUMBER},
};
use std::{
    collections::HashMap,
    io::{self, Read},
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};
use tauflow_contract::Resources;

/// Longest time that a scheduler may take to answer.
const PATIENCE: Duration = Duration::from_secs(120);

/// Where a job stands that has not ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// It waits.
    Queued,
    /// It runs.
    Running,
}

/// A class of nodes.
#[derive(Clone, Copy)]
pub struct Class<'a> {
    /// Its name.
    pub name: &'a str,
    /// The only node of it that counts.
    pub node: Option<&'a str>,
}

/// Jobs that are submitted together.
pub struct Submission<'a> {
    /// Their name.
    pub name: &'a str,
    /// The folder that has `N.sh` for the job of number N, and says where its log is written.
    pub folder: &'a Folder,
    /// How many there are.
    pub jobs: usize,
    /// What each of them asks for.
    pub resources: Resources,
    /// The nodes that they need to themselves, one job at a time, if they measure.
    pub class: Option<Class<'a>>,
    /// More options of the command that submits them. They override the resources.
    pub options: Vec<&'a str>,
}

impl Submission<'_> {
    /// The words of a shell that run the job whose number is in this variable.
    fn words(&self, variable: &str) -> String {
        match &self.folder.inline {
            // The number stands in a quoted word.
            Some(inline) => inline.replace(NUMBER, &format!("'\"${variable}\"'")),
            None => format!("exec sh {}/\"${variable}.sh\"", quoted(&self.folder.path().display().to_string())),
        }
    }
}

/// A scheduler. Errors are in words: the command, and what it said.
pub trait Queue {
    /// Submits jobs; their ids, by number.
    fn submit(&self, of: &Submission<'_>) -> Result<Vec<String>, String>;

    /// Which of these jobs have not ended.
    fn poll(&self, ids: &[&str]) -> Result<HashMap<String, Stage>, String>;

    /// Why a job has ended, as far as the scheduler tells.
    fn reason(&self, id: &str) -> Option<String>;

    /// Cancels jobs.
    fn cancel(&self, ids: &[&str]) -> Result<(), String>;
}

/// The scheduler that the options name.
pub fn queue(options: &JobOptions) -> Box<dyn Queue> {
    match &options.scheduling {
        Scheduling::Slurm => Box::new(slurm::Slurm),
        Scheduling::HyperQueue => Box::new(hyperqueue::HyperQueue),
        Scheduling::Commands { submit, poll, cancel } => {
            let (submit, poll, cancel) = (submit.clone(), poll.clone(), cancel.clone());
            Box::new(commands::Commands { submit, poll, cancel })
        }
    }
}

/// A word for a shell.
pub fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', "'\\''"))
}

/// Runs a command to its end; what it printed, if it succeeded.
fn ask(command: &mut Command) -> Result<String, String> {
    let program = command.get_program().display().to_string();
    let wrong = |why: String| format!("`{program}` {why}");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().map_err(|error| wrong(format!("cannot be started: {error}")))?;
    let (out, err) = (child.stdout.take(), child.stderr.take());
    let begun = Instant::now();
    let (status, out, err) = thread::scope(|scope| {
        let (out, err) = (scope.spawn(|| text(out)), scope.spawn(|| text(err)));
        let mut pause = Duration::from_millis(2);
        let status = loop {
            match child.try_wait() {
                Ok(Some(status)) => break Ok(status),
                Ok(None) if begun.elapsed() > PATIENCE => {
                    let _ = child.kill(); // it may have ended
                    let _ = child.wait();
                    break Err(format!("did not answer for {} s", PATIENCE.as_secs()));
                }
                Ok(None) => thread::sleep(pause),
                Err(error) => break Err(error.to_string()),
            }
            pause = (pause * 2).min(Duration::from_millis(50));
        };
        (status, out.join().unwrap_or_default(), err.join().unwrap_or_default())
    });
    let status = status.map_err(wrong)?;
    if status.success() {
        return Ok(out);
    }
    let said = if err.trim().is_empty() { out } else { err };
    Err(wrong(format!("failed with {status}: {}", said.trim())))
}

fn text(pipe: Option<impl Read>) -> String {
    let mut bytes = Vec::new();
    let read = pipe.map_or(Ok(0), |pipe| -> io::Result<usize> { pipe.take(1 << 24).read_to_end(&mut bytes) });
    read.map_or_else(|_| String::new(), |_| String::from_utf8_lossy(&bytes).into_owned())
}
