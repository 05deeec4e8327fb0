//! Folders of jobs that were submitted together, in the store: what each job runs, and the lines in which it tells what
//! became of its actions. They outlive the run that made them, so that the next one finds its jobs.
//!
//! ```text
//! jobs/tauflow-XXXXXX/
//!   lock       held by the run that looks after the jobs
//!   jobs.json  their ids, once they are submitted
//!   N.batch    the actions of job N
//!   N.sh       the script that runs them
//!   N.lines    what became of them
//!   N.log      what the job printed
//! ```

use super::queue::quoted;
use crate::engine::{
    batch::{BatchFile, Line},
    executor::ChildCommand,
};
use serde::{Deserialize, Serialize};
use std::{
    fs::{self, File},
    io::{self, Read, Seek, SeekFrom},
    path::{Path, PathBuf},
    time::Duration,
};
use tauflow_cache::Key;
use tauflow_contract::read_regular;

/// Most bytes of `jobs.json`.
const MOST_BYTES: u64 = 1 << 26;
/// Bytes of a file of lines that are read at once.
const AT_ONCE: u64 = 1 << 20;
/// Time in which jobs of a new folder are submitted.
const YOUNG: Duration = Duration::from_secs(3600);
/// Bytes at the end of a log that are shown.
const SHOWN: u64 = 600;

/// See the module. The folder is removed on drop, unless jobs may go on.
pub struct Folder {
    path: PathBuf,
    /// Held as long as this lives.
    _lock: File,
    /// Jobs that may go on.
    pub open: usize,
}

/// The jobs of a folder.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Submitted {
    /// Who runs them.
    pub scheduler: String,
    /// Their ids, by number.
    pub ids: Vec<String>,
}

impl Folder {
    /// Makes a folder below `root` with these batches.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn new(root: &Path, batches: &[BatchFile], worker: &ChildCommand, store: &Path) -> io::Result<Self> {
        fs::create_dir_all(root)?;
        let path = tempfile::Builder::new().prefix("tauflow-").tempdir_in(root)?.keep();
        let lock = File::create_new(path.join("lock"))?;
        lock.try_lock()?;
        let folder = Self { path, _lock: lock, open: 0 };
        let here = std::env::current_dir()?;
        for (job, batch) in batches.iter().enumerate() {
            let file = folder.file(job, "batch");
            fs::write(&file, serde_json::to_vec(batch)?)?;
            let command = worker.command(&file, store);
            let words = [command.get_program()].into_iter().chain(command.get_args());
            let mut line: Vec<String> = words.map(|word| quoted(&word.display().to_string())).collect();
            line.extend(["--lines".into(), quoted(&folder.file(job, "lines").display().to_string())]);
            let here = quoted(&here.display().to_string());
            fs::write(folder.file(job, "sh"), format!("#!/bin/sh\ncd {here} || exit 1\nexec {}\n", line.join(" ")))?;
        }
        Ok(folder)
    }

    /// The folders below `root` that no living run looks after.
    pub fn left(root: &Path) -> Vec<Self> {
        let entries = fs::read_dir(root).into_iter().flatten().flatten();
        let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
        paths.sort();
        let left = |path: PathBuf| {
            let lock = File::open(path.join("lock")).ok()?;
            // A run may just be making it.
            let young =
                || lock.metadata().and_then(|of| of.modified()).is_ok_and(|at| at.elapsed().is_ok_and(|t| t < YOUNG));
            if !path.join("jobs.json").exists() && young() {
                return None;
            }
            lock.try_lock().ok()?;
            // It may have been removed meanwhile.
            path.join("lock").exists().then_some(Self { path, _lock: lock, open: 0 })
        };
        paths.into_iter().filter_map(left).collect()
    }

    /// The folder's path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The folder's name.
    pub fn name(&self) -> String {
        self.path.file_name().unwrap_or_default().display().to_string()
    }

    fn file(&self, job: usize, extension: &str) -> PathBuf {
        self.path.join(format!("{job}.{extension}"))
    }

    /// Notes that the jobs are submitted.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn submitted(&self, of: &Submitted) -> io::Result<()> {
        // Complete or not at all: the next run reads it.
        let mut file = tempfile::NamedTempFile::new_in(&self.path)?;
        serde_json::to_writer(&mut file, of)?;
        file.persist(self.path.join("jobs.json"))?;
        Ok(())
    }

    /// What was noted, if the jobs were submitted.
    pub fn jobs(&self) -> Option<Submitted> {
        serde_json::from_slice(&read_regular(&self.path.join("jobs.json"), MOST_BYTES).ok()?).ok()
    }

    /// The keys of a job's actions.
    pub fn keys(&self, job: usize) -> Vec<Key> {
        let batch = BatchFile::read(&self.file(job, "batch"));
        batch.map_or_else(|_| Vec::new(), |batch| batch.actions.iter().map(|of| of.action.key.hash()).collect())
    }

    /// What a job told.
    pub fn lines(&self, job: usize) -> Lines {
        Lines { path: self.file(job, "lines"), read: 0, rest: Vec::new() }
    }

    /// The end of what a job printed.
    pub fn log(&self, job: usize) -> String {
        let read = || -> io::Result<String> {
            let mut file = File::open(self.file(job, "log"))?;
            let end = file.metadata()?.len();
            file.seek(SeekFrom::Start(end.saturating_sub(SHOWN)))?;
            let mut bytes = Vec::new();
            file.take(SHOWN).read_to_end(&mut bytes)?;
            Ok(String::from_utf8_lossy(&bytes).trim().to_owned())
        };
        // A job that never began has none.
        read().unwrap_or_default()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        if self.open == 0 {
            let _ = fs::remove_dir_all(&self.path); // the next run tries again
        }
    }
}

/// A file of lines, as far as it is read.
pub struct Lines {
    path: PathBuf,
    read: u64,
    /// The beginning of a line whose end was not there yet.
    rest: Vec<u8>,
}

impl Lines {
    /// What was told since the last look. The file is opened each time: on NFS, that shows what others wrote.
    pub fn news(&mut self) -> Vec<Line> {
        let mut found = Vec::new();
        loop {
            let before = self.read;
            // A job that has not begun has no file.
            let Ok(mut file) = File::open(&self.path) else { break };
            let read =
                file.seek(SeekFrom::Start(self.read)).and_then(|_| file.take(AT_ONCE).read_to_end(&mut self.rest));
            self.read += read.unwrap_or(0) as u64;
            if let Some(end) = self.rest.iter().rposition(|byte| *byte == b'\n') {
                let rest = self.rest.split_off(end + 1);
                let whole = std::mem::replace(&mut self.rest, rest);
                found.extend(whole.split(|byte| *byte == b'\n').filter_map(|line| serde_json::from_slice(line).ok()));
            }
            if self.read == before {
                break;
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{io::Write, process::Command};

    #[test]
    fn lines_are_read_as_they_are_written_and_parts_of_lines_wait() {
        let root = tempfile::tempdir().expect("a temporary folder");
        let path = root.path().join("0.lines");
        let mut lines = Lines { path: path.clone(), read: 0, rest: Vec::new() };
        assert!(lines.news().is_empty(), "the job has not begun");
        let mut file = File::create(&path).expect("writable");
        let text = serde_json::to_string(&Line::Begun { action: 3 }).expect("plain data");
        write!(file, "{text}\nnoise\n{}", &text[..5]).expect("writable");
        assert!(matches!(lines.news()[..], [Line::Begun { action: 3 }]));
        assert!(lines.news().is_empty());
        writeln!(file, "{}", &text[5..]).expect("writable");
        assert!(matches!(lines.news()[..], [Line::Begun { action: 3 }]));
    }

    #[test]
    fn a_folder_is_found_again_if_its_run_is_gone_and_goes_when_its_jobs_have_ended() {
        let root = tempfile::tempdir().expect("a temporary folder");
        let worker = ChildCommand::new(|batch, store| {
            let mut command = Command::new("it's a program");
            command.arg(batch).arg(store);
            command
        });
        let batches = [BatchFile::default(), BatchFile::default()];
        let mut folder = Folder::new(root.path(), &batches, &worker, Path::new("/store")).expect("writable");
        let script = fs::read_to_string(folder.path().join("1.sh")).expect("it was written");
        assert!(script.contains("exec 'it'\\''s a program' ") && script.contains("1.lines'\n"), "{script}");
        folder.open = 2;
        let ids = vec!["7_0".to_owned(), "7_1".to_owned()];
        folder.submitted(&Submitted { scheduler: "slurm".into(), ids: ids.clone() }).expect("writable");
        assert!(Folder::left(root.path()).is_empty(), "a run looks after it");
        drop(folder);
        let left = Folder::left(root.path());
        assert_eq!(left.len(), 1);
        assert_eq!(left[0].jobs().expect("it was noted").ids, ids);
        assert!(left[0].keys(1).is_empty());
        let path = left[0].path().to_owned();
        drop(left);
        assert!(!path.exists());
    }
}
