//! What failed in other shards of a run, as notes in the cache: without them, who waits for a result would wait for
//! ever. A shard that begins removes its own notes of earlier runs. So a note that was there before is heeded once
//! shards that begin at the same time had time to do so.

use serde::{Deserialize, Serialize};
use std::{
    collections::HashMap,
    fs, io,
    path::{Path, PathBuf},
    time::{Duration, Instant, SystemTime},
};
use tauflow_cache::{Key, Store};

/// The directory of the notes in a cache.
const FOLDER: &str = "shards";
/// Until then, a note that was there before is of an earlier run.
const GRACE: Duration = Duration::from_secs(30);

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
    /// The notes that were there at first.
    before: HashMap<String, State>,
    begun: Instant,
}

impl Failures {
    /// The notes in a cache, for a shard such as `2/4`.
    pub fn from_now(store: &Store, shard: &str) -> Self {
        let folder = store.dir().join(FOLDER);
        let mut before = listed(&folder);
        before.retain(|name, _| {
            let path = folder.join(name);
            let own = read(&path).is_some_and(|failed| failed.shard == shard);
            !(own && fs::remove_file(path).is_ok())
        });
        Self { folder, before, begun: Instant::now() }
    }

    /// An action is tried again: what was noted about it is no longer so.
    pub fn forget(&self, key: &Key) {
        let name = key.hex();
        if self.before.contains_key(&name) {
            // One that cannot be removed is heeded; then the other shard runs again.
            let _ = fs::remove_file(self.folder.join(name));
        }
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
        let draft = self.folder.join(format!("{name}.{}", std::process::id()));
        fs::write(&draft, serde_json::to_vec(failed)?)?;
        fs::rename(&draft, self.folder.join(name))
    }

    /// What is noted now, by the text of the key, without what is of earlier runs.
    pub fn now(&self) -> HashMap<String, State> {
        let mut now = listed(&self.folder);
        if self.begun.elapsed() < GRACE {
            now.retain(|name, state| self.before.get(name) != Some(state));
        }
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
        assert_eq!(early.now().len(), 1);
        let late = Failures::from_now(&store, "1/2");
        assert!(late.now().is_empty());
        late.note(&two, &failed("second")).expect("room");
        late.note(&one, &failed("once more, at length")).expect("room");
        assert_eq!(late.now().len(), 2);
        assert_eq!(late.read(&one).expect("a note").message, "once more, at length");
        // Whoever begins later heeds them after some time.
        let mut later = Failures::from_now(&store, "1/2");
        assert!(later.now().is_empty());
        later.begun -= GRACE;
        assert_eq!(later.now().len(), 2);
        // An action is tried again, by this shard or by one of another number.
        later.forget(&one);
        assert!(later.read(&one).is_none() && later.read(&two).is_some());
        assert!(Failures::from_now(&store, "2/2").read(&two).is_none());
    }
}
