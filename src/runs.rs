//! Run records: what each `run` did, kept below `<cache>/runs`, one file per run, so that runs can be listed and
//! compared.
//!
//! A record is written when its run begins, under a name that no other record has, and once more when the run ends.
//! Meanwhile the file of its [`LiveState`] stands beside it. No run changes the record of another one. The garbage
//! collector does not touch records. No key depends on one. Knows no terminal.

mod compare;
mod date;
mod live;
mod metrics;
mod observer;
mod origin;
mod prune;
mod timeline;

pub use compare::{Comparison, MetricChange, OutputChange, ParamChange, RowCounts, TimeChange, compare};
pub use date::date_text;
pub use live::{LiveAction, LiveNode, LiveState, Process, Standing};
pub use observer::{Observer, PageFile, Shown};
pub use origin::Machine;
pub use prune::{prune, superfluous};
pub use timeline::{Bar, Timeline};

use crate::{
    diagnostics::did_you_mean,
    engine::{
        self, Listed, Summary,
        event::{Failure, NodeStat, Slow},
    },
    pipeline::Pipeline,
};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    io::{self, Write},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};
use tauflow_cache::rename;
use tauflow_contract::{Determinism, Digest, read_regular};

/// Directory of the records below the cache directory.
const FOLDER: &str = "runs";
/// Version of the record format.
const FORMAT: u32 = 1;
/// Most bytes of a record.
const MOST_BYTES: u64 = 1 << 26;
/// Failures that a record holds in full.
const MOST_FAILURES: usize = 100;
/// Runs that may begin in the same second.
const MOST_A_SECOND: u32 = 10_000;

/// The result of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// Version of this format.
    pub format: u32,
    /// The run's id: the time of its start in UTC, and a number if several runs started in that second.
    pub id: String,
    /// When it started, in seconds since 1970.
    pub started: u64,
    /// Wall time, in seconds.
    pub elapsed_s: f64,
    /// The pipeline's name.
    pub pipeline: String,
    /// The pipeline file.
    pub file: PathBuf,
    /// Version of tauflow.
    pub version: String,
    /// Commit of the git checkout that holds the pipeline file, if there is one.
    pub commit: Option<String>,
    /// The command line.
    pub command: Vec<String>,
    /// Overrides of the file: the profile, and what `--set` and `--target` said.
    pub overrides: Vec<String>,
    /// The machine.
    pub machine: Machine,
    /// How it ended.
    pub outcome: Outcome,
    /// Why it could not go on, if it ended by an error.
    pub error: Option<String>,
    /// Numbers by node, in the pipeline's order.
    pub nodes: Vec<NodeStat>,
    /// The actions that took longest.
    pub slowest: Vec<Slow>,
    /// Resolved params by node and cell.
    pub params: BTreeMap<String, Value>,
    /// The outputs that were needed, by name.
    pub outputs: BTreeMap<String, RunOutput>,
    /// The first failures.
    pub failures: Vec<Failure>,
    /// Number of failures in all.
    pub failed: u64,
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// All is up to date.
    Done,
    /// Some actions failed.
    Failed,
    /// It was stopped, or a shard that ended before the others had done their share.
    Interrupted,
    /// It could not go on.
    Error,
    /// It goes on, as far as can be told.
    Running,
    /// It was killed, and came to no result.
    Killed,
}

impl Outcome {
    /// The word for people.
    pub fn text(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Interrupted => "interrupted",
            Self::Error => "error",
            Self::Running => "running",
            Self::Killed => "killed",
        }
    }
}

/// An output of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunOutput {
    /// Media type of its items.
    pub media: String,
    /// Whether its bits are the same on every machine.
    pub bitwise: bool,
    /// Content digest; none if something failed.
    pub digest: Option<Digest>,
    /// How the cache lists its items.
    pub listed: Option<Listed>,
}

/// A problem with run records.
#[derive(Debug, thiserror::Error)]
pub enum RunsError {
    /// The directory cannot be read or written.
    #[error("cannot {what} {path}: {source}; check its permissions and the free space", path = path.display())]
    Io {
        /// `read`, `write` or `delete`.
        what: &'static str,
        /// The file or directory.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A request that names no run.
    #[error("{0}")]
    Unknown(String),
}

/// A file among the records that is none.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the run record {path} is damaged and skipped: {why}; delete the file to silence this", path = path.display())]
pub struct Damaged {
    /// The file.
    pub path: PathBuf,
    /// Why.
    pub why: String,
}

impl RunRecord {
    /// The record of a run that begins now.
    pub fn begin(pipeline: &Pipeline, file: &Path, overrides: Vec<String>) -> Self {
        let params = (0..pipeline.cells.len()).map(|c| (pipeline.cell_name(c), pipeline.cells[c].params.clone()));
        let file = fs::canonicalize(file).unwrap_or_else(|_| file.to_owned()); // a pipe has no place
        Self {
            format: FORMAT,
            id: String::new(),
            started: engine::now(),
            elapsed_s: 0.0,
            pipeline: pipeline.name.clone(),
            commit: origin::commit(&file),
            file,
            version: env!("CARGO_PKG_VERSION").into(),
            command: std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect(),
            overrides,
            machine: Machine::here(),
            outcome: Outcome::Running,
            error: None,
            nodes: Vec::new(),
            slowest: Vec::new(),
            params: params.collect(),
            outputs: BTreeMap::new(),
            failures: Vec::new(),
            failed: 0,
        }
    }

    /// Takes what the run came to.
    pub fn end(&mut self, summary: &Summary) {
        self.elapsed_s = summary.elapsed.as_secs_f64();
        self.outcome = match summary {
            _ if summary.interrupted => Outcome::Interrupted,
            _ if !summary.failures.is_empty() => Outcome::Failed,
            _ if !summary.elsewhere.is_empty() => Outcome::Interrupted,
            _ => Outcome::Done,
        };
        self.nodes = summary.nodes.iter().filter(|node| node.lanes > 0).cloned().collect();
        self.slowest = summary.slowest.clone();
        self.outputs = summary
            .outputs
            .iter()
            .map(|output| {
                let of = RunOutput {
                    media: output.media.into(),
                    bitwise: output.determinism == Determinism::Bitwise,
                    digest: output.digest,
                    listed: output.listed.clone(),
                };
                (output.name.clone(), of)
            })
            .collect();
        self.failures = summary.failures.iter().take(MOST_FAILURES).cloned().collect();
        self.failed = summary.failures.len() as u64;
    }

    /// Takes how the results differ from what they should be.
    pub fn refute(&mut self, error: String) {
        self.outcome = Outcome::Failed;
        self.error = Some(error);
    }

    /// Takes why the run could not go on.
    pub fn fail(&mut self, error: String) {
        self.elapsed_s = engine::now().saturating_sub(self.started) as f64;
        self.outcome = Outcome::Error;
        self.error = Some(error);
    }

    /// Sum over nodes.
    pub fn total(&self, of: impl Fn(&NodeStat) -> u64) -> u64 {
        self.nodes.iter().map(of).fold(0, u64::saturating_add)
    }

    /// Writes the record under a new id, at once; no other record is ever overwritten.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&mut self, cache: &Path) -> Result<PathBuf, RunsError> {
        let folder = cache.join(FOLDER);
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |source| RunsError::Io { what: "write", path, source }
        };
        fs::create_dir_all(&folder).and_then(|()| own(&folder)).map_err(failed(&folder))?;
        let base = date::id(self.started);
        for number in 1..=MOST_A_SECOND {
            self.id = if number == 1 { base.clone() } else { format!("{base}-{number}") };
            let path = path_of(&folder, &self.id);
            if path.symlink_metadata().is_ok() {
                continue;
            }
            match self.temporary(&folder).map_err(failed(&path))?.persist_noclobber(&path) {
                Ok(_) => return Ok(path),
                Err(e) if e.error.kind() == io::ErrorKind::AlreadyExists => {} // another run was quicker
                Err(e) => return Err(failed(&path)(e.error)),
            }
        }
        Err(failed(&folder)(io::Error::other(format!("{MOST_A_SECOND} runs began in the same second"))))
    }

    /// Puts how the run ended in place of what [`RunRecord::write`] wrote, and removes its state.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn conclude(&self, cache: &Path) -> Result<(), RunsError> {
        let folder = cache.join(FOLDER);
        let path = path_of(&folder, &self.id);
        let failed = |source| RunsError::Io { what: "write", path: path.clone(), source };
        own(&folder)
            .and_then(|()| self.temporary(&folder))
            .and_then(|file| rename(&file.into_temp_path(), &path))
            .map_err(failed)?;
        live::remove(cache, &self.id);
        Ok(())
    }

    /// A file with the record that has no name yet.
    fn temporary(&self, folder: &Path) -> io::Result<tempfile::NamedTempFile> {
        let mut text = serde_json::to_vec(self)?;
        text.push(b'\n');
        // As readable as all other files of the cache, which a group may share.
        let mode = fs::Permissions::from_mode(0o666);
        let mut temporary = tempfile::Builder::new().permissions(mode).tempfile_in(folder)?;
        temporary.write_all(&text)?;
        Ok(temporary)
    }

    /// Takes what is known of a run whose process is gone.
    fn killed(&mut self, state: Option<&LiveState>) {
        self.outcome = Outcome::Killed;
        if let Some(state) = state {
            self.elapsed_s = state.elapsed_s;
            self.nodes = state.stats();
            self.failures.clone_from(&state.failures);
            self.failed = state.failed;
        }
    }
}

/// Refuses a link in place of the directory: no link inside a cache is followed.
fn own(folder: &Path) -> io::Result<()> {
    if folder.symlink_metadata()?.is_dir() {
        return Ok(());
    }
    Err(io::Error::new(io::ErrorKind::NotADirectory, "it is a link or a file, not a directory"))
}

fn path_of(folder: &Path, id: &str) -> PathBuf {
    folder.join(format!("{id}.json"))
}

/// The records of a cache, oldest first, and the files among them that cannot be read.
///
/// # Errors
/// If the directory cannot be read. A cache without runs has none.
pub fn read_all(cache: &Path) -> Result<(Vec<RunRecord>, Vec<Damaged>), RunsError> {
    let folder = cache.join(FOLDER);
    let failed = |source| RunsError::Io { what: "read", path: folder.clone(), source };
    let entries = match own(&folder).and_then(|()| fs::read_dir(&folder)) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(Default::default()),
        entries => entries.map_err(failed)?,
    };
    let (mut records, mut damaged) = (Vec::new(), Vec::new());
    for entry in entries {
        let path = entry.map_err(failed)?.path();
        let Some(id) = path.file_name().and_then(|n| n.to_str()?.strip_suffix(".json")) else { continue };
        match read(&path, id).and_then(|record| looked_after(cache, record, &path)) {
            Ok(record) => records.push(record),
            Err(why) => damaged.push(Damaged { path: path.clone(), why }),
        }
    }
    records.sort_by_cached_key(|record: &RunRecord| (record.started, date::number(&record.id)));
    damaged.sort_by(|a, b| a.path.cmp(&b.path));
    Ok((records, damaged))
}

fn read(path: &Path, id: &str) -> Result<RunRecord, String> {
    let bytes = read_regular(path, MOST_BYTES).map_err(|e| e.to_string())?;
    let value: Value = serde_json::from_slice(&bytes).map_err(|e| format!("it is not JSON: {e}"))?;
    match value["format"].as_u64() {
        Some(format) if format == u64::from(FORMAT) => {}
        Some(format) => return Err(format!("it has format {format}, and this version reads format {FORMAT}")),
        None => return Err("it has no `format`".into()),
    }
    let record: RunRecord = serde_json::from_value(value).map_err(|e| e.to_string())?;
    if record.id == id { Ok(record) } else { Err(format!("it is the record of run `{}`", record.id)) }
}

/// A record with what its state tells, if its run has not ended by itself.
fn looked_after(cache: &Path, record: RunRecord, path: &Path) -> Result<RunRecord, String> {
    if record.outcome != Outcome::Running {
        return Ok(record);
    }
    let state = live::read(cache, &record.id);
    let mut record = match &state {
        Some(state) if state.standing() != Standing::Gone => record,
        // Its process may have ended just now, and written how.
        _ => read(path, &record.id)?,
    };
    match &state {
        Some(state) if state.standing() != Standing::Gone => record.elapsed_s = state.going_s(),
        // A run that began just now may not have written its state.
        None if engine::now().saturating_sub(record.started) < live::SILENT => {}
        _ if record.outcome == Outcome::Running => record.killed(state.as_ref()),
        _ => {}
    }
    Ok(record)
}

/// How far a run is, or was as it was killed; none if it has ended by itself or told nothing.
pub fn state(cache: &Path, record: &RunRecord) -> Option<LiveState> {
    matches!(record.outcome, Outcome::Running | Outcome::Killed).then(|| live::read(cache, &record.id)).flatten()
}

/// The runs of a pipeline, given by its name or its file.
///
/// # Errors
/// If there is none.
pub fn of_pipeline(records: Vec<RunRecord>, wanted: &str) -> Result<Vec<RunRecord>, RunsError> {
    let file = fs::canonicalize(wanted).ok();
    let names: BTreeSet<String> = records.iter().map(|record| record.pipeline.clone()).collect();
    let is = |record: &RunRecord| record.pipeline == wanted || file.as_ref() == Some(&record.file);
    let found: Vec<RunRecord> = records.into_iter().filter(is).collect();
    if found.is_empty() {
        let hint = did_you_mean(wanted, "pipelines with runs", names.iter().map(String::as_str));
        return Err(RunsError::Unknown(format!("no recorded run of `{wanted}`; {hint}")));
    }
    Ok(found)
}

/// The run with this id, or with the only id that begins so.
///
/// # Errors
/// If there is none, or there are several.
pub fn find<'r>(records: &'r [RunRecord], wanted: &str) -> Result<&'r RunRecord, RunsError> {
    if let Some(exact) = records.iter().find(|record| record.id == wanted) {
        return Ok(exact);
    }
    let begins: Vec<&RunRecord> =
        records.iter().filter(|record| !wanted.is_empty() && record.id.starts_with(wanted)).collect();
    match begins[..] {
        [one] => Ok(one),
        [] => {
            let hint = did_you_mean(wanted, "runs", records.iter().map(|record| record.id.as_str()));
            Err(RunsError::Unknown(format!("no run `{wanted}`; {hint}")))
        }
        [first, second, ..] => Err(RunsError::Unknown(format!(
            "{} runs begin with `{wanted}`, such as `{}` and `{}`; give more of the id",
            begins.len(),
            first.id,
            second.id
        ))),
    }
}

#[cfg(test)]
mod tests;
