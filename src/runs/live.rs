//! The state of a run that goes on: a file beside its record, which only the running process writes, and which every
//! other process can read.
//!
//! The file is replaced at once, at most once a second, and removed at the end of the run. A file whose process is gone
//! is that of a run that was killed. Processes of other machines and of other containers cannot be asked; how long ago
//! they wrote is all that is known of them.

use super::{FOLDER, RunsError, own};
use crate::{
    engine::{
        self,
        event::{Failure, Name, NodeStat},
    },
    query::Counts,
};
use serde::{Deserialize, Serialize};
use std::{
    fs,
    io::{self, Write},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};
use tauflow_cache::rename;
use tauflow_contract::read_regular;

/// Version of this format.
const FORMAT: u32 = 1;
/// Most bytes of a state.
const MOST_BYTES: u64 = 1 << 24;
/// Seconds after which a process counts as silent if it cannot be asked.
pub(super) const SILENT: u64 = 60;

/// How far a run is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LiveState {
    /// Version of this format.
    pub format: u32,
    /// The run's id.
    pub id: String,
    /// The pipeline's name.
    pub pipeline: String,
    /// The pipeline file.
    pub file: PathBuf,
    /// The process.
    pub process: Process,
    /// When the run started, in seconds since 1970.
    pub started: u64,
    /// When this was written, in seconds since 1970.
    pub written: u64,
    /// Seconds from the start until this was written.
    pub elapsed_s: f64,
    /// The nodes that are needed, in the pipeline's order.
    pub nodes: Vec<LiveNode>,
    /// Actions in flight, the longest first.
    pub running: Vec<LiveAction>,
    /// Number of actions in flight, of which `running` may show a part.
    pub in_flight: u64,
    /// The first failures.
    pub failures: Vec<Failure>,
    /// Number of failures in all.
    pub failed: u64,
}

/// How far a node is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LiveNode {
    /// The node.
    pub node: String,
    /// Its kind.
    pub kind: String,
    /// Numbers of its actions.
    #[serde(flatten)]
    pub counts: Counts,
    /// Whether all of its actions are known.
    pub known: bool,
    /// Wall time that its actions took in this run, in seconds.
    pub spent_s: f64,
}

/// An action in flight.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LiveAction {
    /// The node.
    pub node: Name,
    /// The cell, or empty.
    pub cell: Name,
    /// The item, or empty.
    pub item: Name,
    /// Seconds since it began.
    pub for_s: f64,
    /// Units done, if it tells.
    pub done: u64,
    /// Units in all; 0 if it does not tell.
    pub total: u64,
    /// Its news.
    pub message: String,
}

/// A process, so that it can be told from a later one of the same number.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Process {
    /// Its number.
    pub pid: u32,
    /// When it began, in ticks of the machine's clock.
    pub began: u64,
    /// The boot of the machine.
    pub boot: String,
    /// The namespace of process numbers.
    pub namespace: String,
    /// The host name.
    pub host: String,
}

/// The state of the process behind a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// It goes on.
    Going,
    /// It runs on another machine or in another container, and has not written for a while.
    Silent,
    /// It is gone.
    Gone,
}

/// The time at which a process began, in ticks; none if there is no such process, or only what is left of one.
fn began(pid: u32) -> Option<u64> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The name, in parentheses, may hold anything; the state is the first field after it, and the time the twentieth.
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace();
    let state = fields.next()?;
    (!matches!(state, "Z" | "X" | "x")).then(|| fields.nth(18)?.parse().ok()).flatten()
}

impl Process {
    /// This process.
    pub fn here() -> Self {
        let text = |path: &str| fs::read_to_string(path).unwrap_or_default().trim().to_owned();
        let namespace = fs::read_link("/proc/self/ns/pid").unwrap_or_default();
        let pid = std::process::id();
        Self {
            pid,
            began: began(pid).unwrap_or(0),
            boot: text("/proc/sys/kernel/random/boot_id"),
            namespace: namespace.to_string_lossy().into_owned(),
            host: text("/proc/sys/kernel/hostname"),
        }
    }

    /// Whether it lives; none if it cannot be asked from here.
    fn lives(&self) -> Option<bool> {
        let here = Self::here();
        match (&self.boot, &self.namespace) {
            same if same == (&here.boot, &here.namespace) => Some(began(self.pid) == Some(self.began)),
            // The same machine after a restart.
            _ if self.host == here.host && self.boot != here.boot && !self.boot.is_empty() => Some(false),
            _ => None,
        }
    }
}

impl LiveAction {
    /// `node/cell/item`.
    pub fn name(&self) -> String {
        let parts = [&self.node, &self.cell, &self.item];
        parts.iter().filter(|part| !part.is_empty()).map(|part| &***part).collect::<Vec<_>>().join("/")
    }
}

impl LiveState {
    /// The present state of its process.
    pub fn standing(&self) -> Standing {
        match self.process.lives() {
            Some(true) => Standing::Going,
            Some(false) => Standing::Gone,
            None if engine::now().saturating_sub(self.written) < SILENT => Standing::Going,
            None => Standing::Silent,
        }
    }

    /// Seconds since it began: until now, or until it was last heard of.
    pub fn going_s(&self) -> f64 {
        match self.standing() {
            Standing::Going => self.elapsed_s.max(engine::now().saturating_sub(self.started) as f64),
            Standing::Silent | Standing::Gone => self.elapsed_s,
        }
    }

    /// Replaces the file of this state at once.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(super) fn write(&mut self, cache: &Path) -> Result<(), RunsError> {
        (self.format, self.written) = (FORMAT, engine::now());
        let folder = cache.join(FOLDER);
        let path = path_of(cache, &self.id);
        let failed = |source| RunsError::Io { what: "write", path: path.clone(), source };
        own(&folder).map_err(failed)?;
        let text = serde_json::to_vec(self).map_err(|e| failed(io::Error::other(e)))?;
        let mode = fs::Permissions::from_mode(0o666);
        let mut temporary = tempfile::Builder::new().permissions(mode).tempfile_in(&folder).map_err(failed)?;
        temporary.write_all(&text).map_err(failed)?;
        rename(&temporary.into_temp_path(), &path).map_err(failed)
    }

    /// The numbers of its nodes, as a record has them.
    pub(super) fn stats(&self) -> Vec<NodeStat> {
        let stat = |of: &LiveNode| NodeStat {
            node: of.node.clone(),
            kind: of.kind.clone(),
            hit: of.counts.hit,
            ran: of.counts.ran,
            failed: of.counts.failed,
            blocked: of.counts.blocked,
            unknown: !of.known,
            spent_s: of.spent_s,
            ..NodeStat::default()
        };
        self.nodes.iter().map(stat).collect()
    }
}

/// The file of a run's state.
fn path_of(cache: &Path, id: &str) -> PathBuf {
    cache.join(FOLDER).join(format!("{id}.live"))
}

/// Removes the state of a run that has ended.
pub(super) fn remove(cache: &Path, id: &str) {
    // Without it, or with it, the record of the run says how it ended.
    let _ = fs::remove_file(path_of(cache, id));
}

/// The state of a run; none if there is none that can be read.
pub(super) fn read(cache: &Path, id: &str) -> Option<LiveState> {
    let bytes = read_regular(&path_of(cache, id), MOST_BYTES).ok()?;
    let state: LiveState = serde_json::from_slice(&bytes).ok()?;
    (state.format == FORMAT && state.id == id).then_some(state)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_is_told_from_a_later_one_of_its_number() {
        let here = Process::here();
        assert_eq!((here.lives(), here.began > 0), (Some(true), true));
        assert_eq!(Process { began: here.began + 1, ..here.clone() }.lives(), Some(false));
        assert_eq!(Process { boot: "another".into(), ..here.clone() }.lives(), Some(false), "before a restart");
        let away = Process { host: "another".into(), boot: "another".into(), ..here.clone() };
        assert_eq!(away.lives(), None);
        let state = |process: Process, written| LiveState { process, written, ..LiveState::default() }.standing();
        assert_eq!(state(here, 0), Standing::Going);
        assert_eq!(state(away.clone(), engine::now()), Standing::Going);
        assert_eq!(state(away, 0), Standing::Silent);
    }
}
