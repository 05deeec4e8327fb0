//! The built program, from outside: exit codes, what goes to which stream, what the files hold.

mod adding_a_kind;
mod alone;
mod caches;
mod denoising;
mod errors;
mod exports;
mod foresight;
mod inspect;
mod job_faults;
mod job_resources;
mod jobs;
mod jobs_apart;
mod locks;
mod looking;
mod manuals;
mod measured;
mod network_fs;
#[cfg(feature = "objects")]
mod objects;
mod own_programs;
mod own_scenes;
mod places_of_kinds;
mod programs;
mod records;
mod refining;
mod rendering;
mod runs;
mod schema;
mod shards;
mod stale;
mod status;
mod trust;
mod upstreams;
mod validator;
mod viewing;
mod words;

use serde_json::Value;
use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};
use tempfile::TempDir;

/// Two strata, eight scenes of plain colours; nothing is rendered, so a run takes a moment.
const PIPELINE: &str = "\
pipeline: small
seed: 3
profiles: { more: { scenes.pool: 10 } }
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 8, views: [1, 1], regimes: [L0], contexts: [open, enclosed], diffuse: { textured: 0.0 } }
  split:
    kind: content_signature_split
    inputs: { scenes: scenes }
    params: { test_share: 0.5 }
  sampling:
    kind: stratified_sampling
    inputs: { train: split.train, test: split.test }
    params: { train: 2, test: 2, regimes: [L0], contexts: [open, enclosed] }
";

/// A folder with a pipeline and a cache of its own, in which the program runs.
struct Place {
    folder: TempDir,
}

impl Place {
    fn new() -> Self {
        Self::with(PIPELINE)
    }

    fn with(pipeline: &str) -> Self {
        Self::within(&std::env::temp_dir(), pipeline)
    }

    fn within(folder: &Path, pipeline: &str) -> Self {
        let place = Self { folder: TempDir::new_in(folder).expect("a temporary folder") };
        place.write("small.yaml", pipeline);
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).expect("a temporary folder can be written");
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tauflow"));
        command.args(arguments).current_dir(self.folder.path()).env("TAUFLOW_CACHE", self.path("store"));
        command
    }

    fn tauflow(&self, arguments: &[&str]) -> Said {
        Said::of(&self.command(arguments).output().expect("the program starts"))
    }
}

/// What the program said, and how it ended.
#[derive(Debug)]
struct Said {
    code: i32,
    out: String,
    err: String,
}

impl Said {
    fn of(output: &Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Self { code: output.status.code().unwrap_or(-1), out: text(&output.stdout), err: text(&output.stderr) }
    }

    /// Itself, if it ended like this.
    #[track_caller]
    fn ends(self, code: i32) -> Self {
        assert_eq!(self.code, code, "{self:#?}");
        self
    }

    fn lines(&self) -> Vec<&str> {
        self.out.lines().collect()
    }
}

/// A text as JSON.
#[track_caller]
fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

/// The root of the checkout.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The files of a folder with an extension, by name.
fn files(folder: &str, extension: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(root().join(folder)).unwrap_or_else(|e| panic!("cannot read {folder}: {e}"));
    let mut found: Vec<PathBuf> = entries.map(|e| e.expect("the folder can be read").path()).collect();
    found.retain(|path| path.extension().is_some_and(|e| e == extension));
    found.sort();
    found
}
