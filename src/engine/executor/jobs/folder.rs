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
//!
//! Jobs that share no files with the run ([`Apart`]) read batches from notes `NAME/N.batch`, and tell lines in notes
//! `NAME/N.lines`. Their logs are temporary files of their machines.

use super::{Apart, queue::quoted};
use crate::engine::{
    batch::{BatchFile, Line},
    courier::Courier,
    executor::ChildCommand,
};
use serde::{Deserialize, Serialize};
use std::{
    fs::{self, File},
    io::{self, Read, Seek, SeekFrom},
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};
use tauflow_cache::{Key, rename};
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
    /// What carries notes, and how many jobs have them.
    courier: Option<(Arc<dyn Courier>, usize)>,
    /// The words of a shell that run the job of number [`NUMBER`], where jobs share no files with the run.
    pub inline: Option<String>,
}

/// The number of a job in the words that run it.
pub const NUMBER: &str = "{number}";

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
    pub fn new(
        root: &Path,
        batches: &[BatchFile],
        worker: &ChildCommand,
        store: &Path,
        apart: Option<&Apart>,
    ) -> io::Result<Self> {
        fs::create_dir_all(root)?;
        let path = tempfile::Builder::new().prefix("tauflow-").tempdir_in(root)?.keep();
        let lock = File::create_new(path.join("lock"))?;
        if let Err(error) = lock.try_lock() {
            // Without locks, the next run cannot tell whether this one lives, and does not look for its jobs.
            let error = io::Error::from(error);
            if !tauflow_cache::has_no_locks(&error) {
                return Err(error);
            }
        }
        let courier = apart.map(|apart| (apart.courier.clone(), batches.len()));
        let mut folder = Self { path, _lock: lock, open: 0, courier, inline: None };
        if let Some(apart) = apart {
            folder.send(batches, worker, apart)?;
            return Ok(folder);
        }
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

    /// Sends batches as notes, and keeps their files for the next run.
    fn send(&mut self, batches: &[BatchFile], worker: &ChildCommand, apart: &Apart) -> io::Result<()> {
        let name = self.name();
        let command = worker.command(Path::new(&format!("{name}/{NUMBER}")), &apart.store);
        let words = [command.get_program()].into_iter().chain(command.get_args());
        let words: Vec<String> = words.map(|word| quoted(&word.display().to_string())).collect();
        // Programs of a pipeline are found from here, if this folder is there, too.
        let here = quoted(&std::env::current_dir()?.display().to_string());
        let inline = format!("cd {here} 2>/dev/null || cd /; exec {}", words.join(" "));
        for (job, batch) in batches.iter().enumerate() {
            let text = serde_json::to_vec(batch)?;
            fs::write(self.file(job, "batch"), &text)?;
            apart.courier.put(&format!("{name}/{job}.batch"), text).map_err(io::Error::other)?;
            fs::write(self.file(job, "sh"), format!("#!/bin/sh\n{}\n", inline.replace(NUMBER, &job.to_string())))?;
        }
        self.inline = Some(inline);
        Ok(())
    }

    /// The folders below `root` that no living run looks after.
    pub fn left(root: &Path, apart: Option<&Apart>) -> Vec<Self> {
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
            let notes = fs::read_dir(&path).into_iter().flatten().flatten();
            let batches = notes.filter(|entry| entry.path().extension().is_some_and(|of| of == "batch")).count();
            let courier = apart.map(|apart| (apart.courier.clone(), batches));
            path.join("lock").exists().then_some(Self { path, _lock: lock, open: 0, courier, inline: None })
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
        rename(&file.into_temp_path(), &self.path.join("jobs.json"))
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
        let from = match &self.courier {
            Some((courier, _)) => From::Note(courier.clone(), format!("{}/{job}.lines", self.name())),
            None => From::File(self.file(job, "lines")),
        };
        Lines { from, read: 0, rest: Vec::new() }
    }

    /// Where jobs print, with the text that a scheduler replaces by their number.
    pub fn log_of(&self, number: &str) -> PathBuf {
        match self.courier {
            Some(_) => std::env::temp_dir().join(format!("{}-{number}.log", self.name())),
            None => self.path.join(format!("{number}.log")),
        }
    }

    /// The end of what a job printed.
    pub fn log(&self, job: usize) -> String {
        let read = || -> io::Result<String> {
            let mut file = File::open(self.log_of(&job.to_string()))?;
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
        if self.open > 0 {
            return;
        }
        if let Some((courier, jobs)) = &self.courier {
            let name = self.name();
            let notes = (0..*jobs).flat_map(|job| [format!("{name}/{job}.batch"), format!("{name}/{job}.lines")]);
            courier.delete(&notes.collect::<Vec<_>>());
            (0..*jobs).for_each(|job| drop(fs::remove_file(self.log_of(&job.to_string()))));
        }
        let _ = fs::remove_dir_all(&self.path); // the next run tries again
    }
}

/// Where a job tells its lines.
enum From {
    File(PathBuf),
    Note(Arc<dyn Courier>, String),
}

/// The lines of a job, as far as they are read.
pub struct Lines {
    from: From,
    read: u64,
    /// The beginning of a line whose end was not there yet.
    rest: Vec<u8>,
}

impl Lines {
    /// Whether a look at them is a request to a server.
    pub fn are_far(&self) -> bool {
        matches!(self.from, From::Note(..))
    }

    /// Reads on, as far as it goes at once.
    fn read_on(&mut self) {
        match &self.from {
            From::File(path) => {
                // A job that has not begun has no file.
                let Ok(mut file) = File::open(path) else { return };
                let read =
                    file.seek(SeekFrom::Start(self.read)).and_then(|_| file.take(AT_ONCE).read_to_end(&mut self.rest));
                self.read += read.unwrap_or(0) as u64;
            }
            From::Note(courier, name) => {
                // A note that cannot be read now is read the next time.
                let Ok(Some(text)) = courier.get(name) else { return };
                let new = text.get(self.read as usize..).unwrap_or_default();
                self.rest.extend_from_slice(new);
                self.read += new.len() as u64;
            }
        }
    }

    /// What was told since the last look. The file is opened each time: on NFS, that shows what others wrote.
    pub fn news(&mut self) -> Vec<Line> {
        let mut found = Vec::new();
        loop {
            let before = self.read;
            self.read_on();
            if let Some(end) = self.rest.iter().rposition(|byte| *byte == b'\n') {
                let rest = self.rest.split_off(end + 1);
                let whole = std::mem::replace(&mut self.rest, rest);
                found.extend(whole.split(|byte| *byte == b'\n').filter_map(|line| serde_json::from_slice(line).ok()));
            }
            if self.read == before || self.are_far() {
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
        let mut lines = Lines { from: From::File(path.clone()), read: 0, rest: Vec::new() };
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
        let mut folder = Folder::new(root.path(), &batches, &worker, Path::new("/store"), None).expect("writable");
        let script = fs::read_to_string(folder.path().join("1.sh")).expect("it was written");
        assert!(script.contains("exec 'it'\\''s a program' ") && script.contains("1.lines'\n"), "{script}");
        folder.open = 2;
        let ids = vec!["7_0".to_owned(), "7_1".to_owned()];
        folder.submitted(&Submitted { scheduler: "slurm".into(), ids: ids.clone() }).expect("writable");
        assert!(Folder::left(root.path(), None).is_empty(), "a run looks after it");
        drop(folder);
        let left = Folder::left(root.path(), None);
        assert_eq!(left.len(), 1);
        assert_eq!(left[0].jobs().expect("it was noted").ids, ids);
        assert!(left[0].keys(1).is_empty());
        let path = left[0].path().to_owned();
        drop(left);
        assert!(!path.exists());
    }
}
