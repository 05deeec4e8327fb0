//! The machine of a node class on which a run measures. A first job of the class tells which one it is, because the
//! machine enters the keys of measurements. The answer is kept, so that a later run knows the keys without a job, and
//! measures on the same machine. It is forgotten when a measurement fails there.

use super::{
    JobOptions,
    folder::Folder,
    queue::{self, Class, Stage},
};
use crate::engine::{
    EngineError, Sink,
    batch::{BatchFile, Line},
    event::Event,
    measured::Machine,
    records::{self, MEMO},
};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::{
    collections::BTreeMap,
    path::Path,
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant},
};
use tauflow_cache::{CacheError, Store};
use tauflow_contract::{Basis, MemoKey, Resources};

/// Time between two looks at what the job tells.
const LOOK: Duration = Duration::from_millis(100);
/// Questions to the scheduler in which the job must be missing before it has ended.
const MISSES: u32 = 2;

/// A machine that a job ran on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// The machine.
    pub of: Machine,
    /// Its name for the scheduler, if that gives one.
    pub node: Option<String>,
}

/// Where a run measures.
pub enum Place {
    /// On the machine of the run.
    Here,
    /// There.
    There(Found),
    /// The run was stopped before that was known.
    Stopped,
}

fn memo(options: &JobOptions, class: &str) -> MemoKey {
    let asked = json!({ "scheduler": options.scheduling.name(), "class": class });
    MemoKey { basis: Basis::new("measured", 1, "class").with(asked, None), inputs: Vec::new() }
}

fn keep(store: &Store, key: &MemoKey, found: Option<&Found>) -> Result<(), CacheError> {
    let preimage = serde_json::to_string(key).expect("a key holds only plain values");
    records::keep_last(store, &records::note(MEMO, key.hash(), &key.name(), preimage, json!(found).to_string()))
}

/// Forgets the machine of the class.
///
/// # Errors
/// If the store cannot be written.
pub fn forget(store: &Store, options: &JobOptions) -> Result<(), CacheError> {
    options.timing.as_ref().map_or(Ok(()), |class| keep(store, &memo(options, class), None))
}

/// The machine that measures.
///
/// # Errors
/// If the job of the class cannot be submitted, or ends without an answer; if the store fails.
pub fn find(options: &JobOptions, store: &Store, stop: &AtomicBool, sink: Sink<'_>) -> Result<Place, EngineError> {
    let Some(class) = &options.timing else { return Ok(Place::Here) };
    let key = memo(options, class);
    let known = store.read(MEMO, &key.hash());
    if let Some(found) = known.and_then(|of| serde_json::from_str::<Option<Found>>(&of.payload).ok()).flatten() {
        return Ok(Place::There(found));
    }
    let Some(found) = ask(options, class, store.dir(), stop, sink)? else { return Ok(Place::Stopped) };
    keep(store, &key, Some(&found))?;
    Ok(Place::There(found))
}

/// Has a job tell its machine; none if the run is stopped first.
fn ask(
    options: &JobOptions,
    class: &str,
    dir: &Path,
    stop: &AtomicBool,
    sink: Sink<'_>,
) -> Result<Option<Found>, EngineError> {
    let failed = |why: String| {
        EngineError::Executor(format!("cannot find out on which machine `--timing {class}` measures: {why}"))
    };
    let dir = std::path::absolute(dir).unwrap_or_else(|_| dir.to_owned());
    let batch = BatchFile { machine: true, ..BatchFile::default() };
    let folder = Folder::new(&dir.join("jobs"), &[batch], &options.worker, &dir, options.apart.as_ref());
    let folder = folder.map_err(|error| failed(error.to_string()))?;
    let queue = queue::queue(options);
    let name = folder.name();
    let given = options.options.iter().filter(|option| option.node.is_none()).map(|option| option.text.as_str());
    let class = Some(Class { name: class, node: None });
    let resources = Resources::default();
    let submission =
        queue::Submission { name: &name, folder: &folder, jobs: 1, resources, class, options: given.collect() };
    let ids = queue.submit(&submission).map_err(failed)?;
    let [id] = &ids[..] else { return Err(failed("the scheduler gave no id of its job".into())) };
    let id = id.as_str();
    let (mut lines, mut asked, mut missed) = (folder.lines(0), Instant::now(), 0);
    let tell = |queued, running| sink(&Event::Jobs { queued, running, waiting: BTreeMap::new() });
    tell(1, 0);
    let answer = loop {
        if stop.load(Ordering::Relaxed) {
            queue.cancel(&[id]).map_err(failed)?;
            break Ok(None);
        }
        let told = lines.news().into_iter().find_map(|line| match line {
            Line::Machine { of, node } => Some(Found { of, node }),
            _ => None,
        });
        if told.is_some() {
            break Ok(told);
        }
        if missed >= MISSES {
            let reason = queue.reason(id).unwrap_or_else(|| "for an unknown reason".into());
            break Err(failed(format!("job {id} ended without an answer ({reason}); it printed: {}", folder.log(0))));
        }
        thread::sleep(LOOK);
        if asked.elapsed() >= options.poll {
            // A scheduler that does not answer now may answer later.
            if let Ok(alive) = queue.poll(&[id]) {
                missed = if alive.contains_key(id) { 0 } else { missed + 1 };
                let running = u64::from(alive.get(id) == Some(&Stage::Running));
                tell(1 - running, running);
            }
            asked = Instant::now();
        }
    };
    tell(0, 0);
    answer
}
