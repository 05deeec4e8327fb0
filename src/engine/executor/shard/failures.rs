//! Notes in the cache about actions that failed in a shard. A shard that waits for such an action ends with the message
//! of the note; otherwise it would wait for ever. Notes from long before the run began are ignored, because their shard
//! may try the action again. A new attempt removes the note.

use serde::{Deserialize, Serialize};
use std::{
    collections::HashMap,
    fs, io,
    path::{Path, PathBuf},
    time::{Duration, SystemTime},
};
use tauflow_cache::{Key, Store};

/// The directory of the notes in a cache.
const FOLDER: &str = "shards";
/// Shards that run together begin within this time: a note that is younger when a run begins may be of this run.
const RECENT: Duration = Duration::from_secs(60);

/// Why an action failed.
#[derive(Serialize, Deserialize)]
pub struct Failed {
    /// The shard, such as `2/4`.
    pub shard: String,
    /// The message.
    pub message: String,
}

/// When a note was written, and its length: a note that was written again differs.
type State = (Option<SystemTime>, u64);

/// See the module.
pub struct Failures {
    folder: PathBuf,
    /// The notes of earlier runs.
    before: HashMap<String, State>,
    /// Tells drafts of notes apart.
    shard: String,
}

impl Failures {
    /// The notes in a cache, for a shard such as `2/4`.
    pub fn from_now(store: &Store, shard: &str) -> Self {
        let folder = store.dir().join(FOLDER);
        let mut before = listed(&folder);
        before.retain(|_, (written, _)| written.and_then(|at| at.elapsed().ok()).is_some_and(|ago| ago > RECENT));
        Self { folder, before, shard: shard.replace('/', "-") }
    }

    /// An action is tried again: what was noted about it is no longer so.
    pub fn forget(&self, key: &Key) {
        // One that cannot be removed is of an earlier run, or heeded; then the other shard runs again.
        let _ = fs::remove_file(self.folder.join(key.hex()));
    }

    /// Notes that an action failed here.
    ///
    /// # Errors
    /// If the note cannot be written. Others then wait in vain.
    pub fn note(&self, key: &Key, failed: &Failed) -> io::Result<()> {
        match fs::create_dir(&self.folder) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
            _ => {}
        }
        let name = key.hex();
        let draft = self.folder.join(format!("{name}.{}.{}", self.shard, std::process::id()));
        fs::write(&draft, serde_json::to_vec(failed)?)?;
        fs::rename(&draft, self.folder.join(name))
    }

    /// The current notes by the text of their key, without notes of earlier runs.
    pub fn now(&self) -> HashMap<String, State> {
        let mut now = listed(&self.folder);
        now.retain(|name, state| self.before.get(name) != Some(state));
        now
    }

    /// A note.
    pub fn read(&self, key: &Key) -> Option<Failed> {
        read(&self.folder.join(key.hex()))
    }
}

fn read(path: &Path) -> Option<Failed> {
    serde_json::from_slice(&fs::read(path).ok()?).ok()
}

fn listed(folder: &Path) -> HashMap<String, State> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let state = |entry: fs::DirEntry| {
        let meta = entry.metadata().ok()?;
        Some((entry.file_name().into_string().ok()?, (meta.modified().ok(), meta.len())))
    };
    entries.filter_map(state).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_of_earlier_runs_mean_nothing_until_they_are_written_again() {
        let folder = tempfile::tempdir().expect("a folder");
        let store = Store::open(&folder.path().join("cache")).expect("a store");
        let (one, two) = (Key::of(b"one"), Key::of(b"two"));
        let failed = |message: &str| Failed { shard: "2/2".into(), message: message.into() };
        let early = Failures::from_now(&store, "2/2");
        early.note(&one, &failed("first")).expect("room");
        // A note of a shard that began a little earlier counts, one of an earlier run does not.
        assert_eq!(Failures::from_now(&store, "1/2").now().len(), 1);
        let path = store.dir().join(FOLDER).join(one.hex());
        let old = SystemTime::now() - 2 * RECENT;
        fs::File::options().append(true).open(&path).and_then(|file| file.set_modified(old)).expect("it is ours");
        let late = Failures::from_now(&store, "1/2");
        assert!(late.now().is_empty());
        late.note(&two, &failed("second")).expect("room");
        late.note(&one, &failed("once more, at length")).expect("room");
        assert_eq!(late.now().len(), 2);
        assert_eq!(late.read(&one).expect("a note").message, "once more, at length");
        // An action is tried again.
        late.forget(&one);
        assert!(late.read(&one).is_none() && late.read(&two).is_some());
    }
}
