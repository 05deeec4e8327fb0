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
    /// Outputs that were compared and are equal.
    pub equal: usize,
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
    #[error("{path} is not a lock file: {message}; rewrite it with `--update-lock`", path = path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Where and why.
        message: String,
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

    /// Reads a lock file.
    ///
    /// # Errors
    /// If it is missing, unreadable or damaged.
    pub fn read(path: &Path) -> Result<Self, LockError> {
        let bytes = read_regular(path, MOST_BYTES).map_err(|source| LockError::Io {
            what: "read",
            path: path.to_owned(),
            source,
            hint: "`--update-lock` writes it",
        })?;
        let broken = |message: String| LockError::Parse { path: path.to_owned(), message };
        let text = str::from_utf8(&bytes).map_err(|error| broken(error.to_string()))?;
        serde_saphyr::from_str(text).map_err(|error| broken(error.to_string()))
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

    /// What a run of a part of the pipeline is to be compared with: the entries of the nodes that took part.
    pub fn part_of(&self, now: &Self) -> Self {
        let nodes: BTreeSet<&str> = now.bitwise.keys().map(|name| node_of(name)).collect();
        let mut part = self.clone();
        part.bitwise.retain(|name, _| nodes.contains(node_of(name)));
        part
    }

    /// This lock with the entries of a run of a part of the pipeline, whose nodes have no others any more. Entries of
    /// nodes that the pipeline no longer has are dropped.
    pub fn with_part(&self, now: &Self, nodes: &BTreeSet<&str>) -> Self {
        let replaced: BTreeSet<&str> = now.bitwise.keys().map(|name| node_of(name)).collect();
        let mut all = self.clone();
        all.pipeline.clone_from(&now.pipeline);
        all.bitwise.retain(|name, _| nodes.contains(node_of(name)) && !replaced.contains(node_of(name)));
        all.bitwise.extend(now.bitwise.clone());
        all.left_out.retain(|name| nodes.contains(node_of(name)));
        all.left_out.extend(now.left_out.clone());
        all
    }

    /// Compares what a run gave now.
    pub fn compare(&self, now: &Self) -> Differences {
        let mut found = Differences::default();
        let names: BTreeSet<&String> = self.bitwise.keys().chain(now.bitwise.keys()).collect();
        for name in names {
            let (was, is) = (self.bitwise.get(name).copied(), now.bitwise.get(name).copied());
            if was == is {
                found.equal += 1;
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

    #[test]
    fn a_lock_reads_as_it_was_written() {
        let dir = tempfile::tempdir().expect("a folder");
        let path = path_of(&dir.path().join("p.yaml"), Some("tiny"));
        assert!(path.ends_with("p.tiny.lock"));
        assert!(matches!(Lock::read(&path), Err(LockError::Io { .. })));
        lock().write(&path).expect("room");
        assert_eq!(Lock::read(&path).expect("own text"), lock());
        fs::write(&path, "pipeline: [").expect("room");
        assert!(matches!(Lock::read(&path), Err(LockError::Parse { .. })));
    }

    #[test]
    fn a_part_is_compared_and_written_without_the_rest() {
        let whole = lock();
        let mut part = whole.clone();
        part.bitwise.retain(|name, _| name.starts_with("solvers"));
        assert_eq!(whole.part_of(&part).compare(&part), Differences { outputs: vec![], equal: 1 });
        // A cell that the node no longer has is missed, and goes with the next writing.
        let other = "solvers[loss=l2].model".to_owned();
        let more = Lock { bitwise: [(other.clone(), Digest::of(b"c"))].into(), ..part.clone() };
        let found = whole.part_of(&more).compare(&more);
        assert_eq!(
            found.outputs.iter().map(|(name, ..)| name).collect::<Vec<_>>(),
            ["solvers[loss=l1, x=\"2\"].model", &other]
        );
        let nodes = BTreeSet::from(["scenes", "solvers"]);
        let written = whole.with_part(&more, &nodes);
        assert_eq!(written.bitwise.keys().collect::<Vec<_>>(), ["scenes.scenes", &other]);
        assert_eq!(written.left_out, whole.left_out);
        let gone = whole.with_part(&more, &BTreeSet::from(["solvers"]));
        assert_eq!(gone.bitwise.keys().collect::<Vec<_>>(), [&other]);
    }

    #[test]
    fn what_differs_or_is_gone_is_found_and_measurements_are_not_compared() {
        let (before, mut now) = (lock(), lock());
        assert!(before.left_out.contains("solvers.timing"));
        *now.bitwise.get_mut("scenes.scenes").expect("it is there") = Digest::of(b"other");
        let found = before.compare(&now);
        assert_eq!((found.outputs.len(), found.equal, found.outputs[0].0.as_str()), (1, 1, "scenes.scenes"));
        now.bitwise.clear();
        assert_eq!(before.compare(&now).outputs[0].2, None);
    }
}
