//! Lock files: the digests of all reproducible outputs of a pipeline, for comparison with later runs and other
//! machines.
//!
//! `<pipeline>.lock` is next to the pipeline file; `<pipeline>.<profile>.lock` for a profile. Measured outputs, and
//! outputs derived from them, are listed as excluded.

use crate::engine::event::OutputOf;
use serde::{Deserialize, Serialize};
use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
    fs, io,
    path::{Path, PathBuf},
};
use tauflow_contract::{Determinism, Digest, read_regular};

/// Most bytes of a lock file: a line for each output of the largest pipeline.
const MOST_BYTES: u64 = 1 << 26;

/// The content of a lock file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lock {
    /// The pipeline.
    pub pipeline: String,
    /// Contents that are the same everywhere, by output.
    #[serde(default)]
    pub bitwise: BTreeMap<String, Digest>,
    /// Outputs that are measured or of this machine alone, or made from what is.
    #[serde(default)]
    pub left_out: BTreeSet<String>,
}

/// How a run's outputs differ from a lock.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Differences {
    /// An output, its content in the lock and now; none where it is not there.
    pub outputs: Vec<(String, Option<Digest>, Option<Digest>)>,
    /// Outputs of the lock that are measured or of this machine alone now.
    pub unreproducible: Vec<String>,
    /// Outputs that were compared and are equal.
    pub equal: usize,
    /// Outputs of the lock that were not compared: no target needs them.
    pub skipped: usize,
}

impl Differences {
    /// How many outputs differ.
    pub fn len(&self) -> usize {
        self.outputs.len() + self.unreproducible.len()
    }

    /// Whether none differs.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A lock file that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// It cannot be read or written.
    #[error("cannot {what} {path}: {source}; {hint}", path = path.display())]
    Io {
        /// `read` or `write`.
        what: &'static str,
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
        /// The remedy.
        hint: &'static str,
    },
    /// It is no lock file.
    #[error(
        "{path} is not a lock file: {message}; rewrite it with `--update-lock`, without `--target`",
        path = path.display()
    )]
    Parse {
        /// The file.
        path: PathBuf,
        /// Where and why.
        message: String,
    },
    /// It is that of another pipeline.
    #[error(
        "{path} is the lock file of the pipeline `{other}`, not of `{pipeline}`; give one of the two files another \
         name, or delete the lock file if the pipeline has a new name",
        path = path.display()
    )]
    Other {
        /// The file.
        path: PathBuf,
        /// The pipeline in it.
        other: String,
        /// The pipeline that was run.
        pipeline: String,
    },
}

/// Where the lock of a pipeline's file and profile lies.
pub fn path_of(pipeline: &Path, profile: Option<&str>) -> PathBuf {
    match profile {
        Some(profile) => pipeline.with_extension(format!("{profile}.lock")),
        None => pipeline.with_extension("lock"),
    }
}

impl Lock {
    /// The lock file of a run's outputs.
    pub fn of(pipeline: &str, outputs: &[OutputOf]) -> Self {
        let mut lock = Self { pipeline: pipeline.into(), ..Self::default() };
        for output in outputs {
            match (output.determinism, output.digest) {
                (Determinism::Bitwise, Some(digest)) => {
                    lock.bitwise.insert(output.name.clone(), digest);
                }
                (Determinism::Local | Determinism::Measured, _) => {
                    lock.left_out.insert(output.name.clone());
                }
                (_, None) => {} // not known, because something failed
            }
        }
        lock
    }

    /// Reads the lock file of a pipeline of this name.
    ///
    /// # Errors
    /// If it is missing, unreadable or damaged, or that of another pipeline.
    pub fn read(path: &Path, pipeline: &str) -> Result<Self, LockError> {
        let bytes = read_regular(path, MOST_BYTES).map_err(|source| LockError::Io {
            what: "read",
            path: path.to_owned(),
            source,
            hint: "`--update-lock` writes it",
        })?;
        let broken = |message: String| LockError::Parse { path: path.to_owned(), message };
        let text = str::from_utf8(&bytes).map_err(|error| broken(error.to_string()))?;
        let lock: Self = serde_saphyr::from_str(text).map_err(|error| broken(error.to_string()))?;
        if lock.pipeline != pipeline {
            return Err(LockError::Other {
                path: path.to_owned(),
                other: lock.pipeline,
                pipeline: pipeline.to_owned(),
            });
        }
        Ok(lock)
    }

    /// Writes it at once.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), LockError> {
        let failed = |source| LockError::Io {
            what: "write",
            path: path.to_owned(),
            source,
            hint: "free some space, or check its directory",
        };
        let temporary = path.with_added_extension(format!("{}.tmp", std::process::id()));
        fs::write(&temporary, self.text()).and_then(|()| fs::rename(&temporary, path)).map_err(|source| {
            let _ = fs::remove_file(&temporary); // of no use to anybody
            failed(source)
        })
    }

    /// The file's text: YAML, an output a line, so that a diff shows what changed.
    pub fn text(&self) -> String {
        let mut text = String::from(
            "# The content of every reproducible output of a pipeline, written by `tauflow run PIPELINE \
             --update-lock`;\n\
             # `tauflow run PIPELINE --locked` compares.\n",
        );
        let quoted = |name: &str| serde_json::to_string(name).expect("a text serialises");
        let _ = writeln!(text, "pipeline: {}", quoted(&self.pipeline));
        if !self.bitwise.is_empty() {
            text.push_str("bitwise: # the same everywhere\n");
            self.bitwise.iter().for_each(|(output, digest)| {
                let _ = writeln!(text, "  {}: {digest}", quoted(output));
            });
        }
        if !self.left_out.is_empty() {
            text.push_str("left_out: # measured or of one machine, or made from what is\n");
            self.left_out.iter().for_each(|output| {
                let _ = writeln!(text, "  - {}", quoted(output));
            });
        }
        text
    }

    /// This lock with the outputs of a run of a part of the pipeline. Entries of outputs that the pipeline does not
    /// have are dropped.
    pub fn with_part(&self, now: &Self, pipeline: &BTreeSet<String>) -> Self {
        let kept = |name: &str| pipeline.contains(name) && !now.has(name);
        let mut all = now.clone();
        all.bitwise.extend(self.bitwise.iter().filter(|(name, _)| kept(name)).map(|(name, of)| (name.clone(), *of)));
        all.left_out.extend(self.left_out.iter().filter(|name| kept(name)).cloned());
        all
    }

    /// Whether it has an output.
    fn has(&self, name: &str) -> bool {
        self.bitwise.contains_key(name) || self.left_out.contains(name)
    }

    /// Compares what a run gave now. The names of all outputs of the pipeline tell those that no target needs from
    /// those that are gone. With `part`, nodes that took no part in the run are left out.
    pub fn compare(&self, now: &Self, pipeline: &BTreeSet<String>, part: bool) -> Differences {
        let mut found = Differences::default();
        let took_part: BTreeSet<&str> = now.bitwise.keys().chain(&now.left_out).map(|name| node_of(name)).collect();
        let names: BTreeSet<&String> = self.bitwise.keys().chain(now.bitwise.keys()).collect();
        for name in names {
            let (was, is) = (self.bitwise.get(name).copied(), now.bitwise.get(name).copied());
            if was == is {
                found.equal += 1;
            } else if now.left_out.contains(name) {
                found.unreproducible.push(name.clone());
            } else if is.is_none() && (pipeline.contains(name) || part && !took_part.contains(node_of(name))) {
                found.skipped += 1;
            } else {
                found.outputs.push((name.clone(), was, is));
            }
        }
        found
    }
}

/// The node of an output `node.port` or `node[axis=value].port`.
fn node_of(output: &str) -> &str {
    output.find(['[', '.']).map_or(output, |end| &output[..end])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lock() -> Lock {
        let output = |name: &str, determinism, text: &str| OutputOf {
            name: name.into(),
            determinism,
            digest: Some(Digest::of(text.as_bytes())),
            media: "tauflow/files",
            listed: None,
        };
        let outputs = [
            output("scenes.scenes", Determinism::Bitwise, "a"),
            output("solvers[loss=l1, x=\"2\"].model", Determinism::Bitwise, "b"),
            output("solvers.timing", Determinism::Measured, "c"),
        ];
        Lock::of("p", &outputs)
    }

    /// All outputs of the pipeline.
    fn all() -> BTreeSet<String> {
        ["scenes.scenes", "solvers[loss=l1, x=\"2\"].model", "solvers.timing"].map(str::to_owned).into()
    }

    #[test]
    fn a_lock_reads_as_it_was_written() {
        let dir = tempfile::tempdir().expect("a folder");
        let path = path_of(&dir.path().join("p.yaml"), Some("tiny"));
        assert!(path.ends_with("p.tiny.lock"));
        assert!(matches!(Lock::read(&path, "p"), Err(LockError::Io { .. })));
        lock().write(&path).expect("room");
        assert_eq!(Lock::read(&path, "p").expect("own text"), lock());
        let told = Lock::read(&path, "q").expect_err("that of p").to_string();
        assert!(told.contains("of the pipeline `p`, not of `q`"), "{told}");
        fs::write(&path, "pipeline: [").expect("room");
        assert!(matches!(Lock::read(&path, "p"), Err(LockError::Parse { .. })));
    }

    #[test]
    fn a_part_is_compared_and_written_without_the_rest() {
        let (whole, mut part) = (lock(), lock());
        part.bitwise.retain(|name, _| name.starts_with("solvers"));
        let found = whole.compare(&part, &all(), true);
        assert_eq!((found.equal, found.skipped, found.is_empty()), (1, 1, true));
        assert_eq!(whole.with_part(&part, &all()), whole);
        // An output of a node that took part, but that no target needs.
        let mut other = all();
        other.insert("solvers[loss=l2].model".to_owned());
        let mut more = whole.clone();
        more.bitwise.insert("solvers[loss=l2].model".to_owned(), Digest::of(b"c"));
        assert!(more.compare(&part, &other, true).is_empty() && more.compare(&whole, &other, false).is_empty());
        assert_eq!(more.with_part(&part, &other), more);
        // A cell that the node no longer has is a difference, and is dropped.
        assert_eq!(more.compare(&part, &all(), true).outputs.len(), 1);
        assert_eq!(more.with_part(&part, &all()), whole);
        // A node that is gone is a difference of the whole alone.
        let mut gone = whole.clone();
        gone.bitwise.insert("gone.out".to_owned(), Digest::of(b"c"));
        assert!(gone.compare(&part, &all(), true).is_empty() && gone.compare(&whole, &all(), false).len() == 1);
        assert_eq!(gone.with_part(&part, &all()), whole);
    }

    #[test]
    fn an_output_that_is_no_longer_reproducible_differs() {
        let (whole, mut now) = (lock(), lock());
        now.bitwise.remove("scenes.scenes");
        now.left_out.insert("scenes.scenes".to_owned());
        for part in [false, true] {
            let found = whole.compare(&now, &all(), part);
            assert_eq!((found.unreproducible, found.outputs), (vec!["scenes.scenes".to_owned()], vec![]));
        }
        assert_eq!(whole.with_part(&now, &all()), now);
        assert_eq!(now.with_part(&whole, &all()), whole);
    }

    #[test]
    fn what_differs_or_is_gone_is_found_and_measurements_are_not_compared() {
        let (before, mut now) = (lock(), lock());
        assert!(before.left_out.contains("solvers.timing"));
        *now.bitwise.get_mut("scenes.scenes").expect("it is there") = Digest::of(b"other");
        let found = before.compare(&now, &all(), false);
        assert_eq!((found.outputs.len(), found.equal, found.outputs[0].0.as_str()), (1, 1, "scenes.scenes"));
        now.bitwise.clear();
        assert_eq!(before.compare(&now, &BTreeSet::new(), false).outputs[0].2, None);
    }
}
