//! Which run records can go, and their removal.
//!
//! Of each pipeline, the latest ones stay, and the latest one that came to its end after it did some work. Runs that go
//! on stay, too.

use super::{FOLDER, Outcome, RunRecord, RunsError, live, own, path_of};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::Path,
    time::{Duration, SystemTime},
};

/// A temporary file of this age belongs to no process that still writes it.
const ABANDONED: Duration = Duration::from_secs(3600);

/// The ids of the records that can go, if the latest `keep` of each pipeline stay. The records stand in their order.
pub fn superfluous(records: &[RunRecord], keep: usize) -> Vec<String> {
    let mut newer: BTreeMap<&str, usize> = BTreeMap::new();
    let mut worked: BTreeSet<&str> = BTreeSet::new();
    let mut found = Vec::new();
    for record in records.iter().rev() {
        let number = newer.entry(&record.pipeline).or_default();
        *number += 1;
        let did_work = record.outcome == Outcome::Done && record.total(|node| node.ran) > 0;
        let latest_work = did_work && worked.insert(&record.pipeline);
        if *number > keep && !latest_work && record.outcome != Outcome::Running {
            found.push(record.id.clone());
        }
    }
    found.reverse();
    found
}

/// Removes records, and temporary files that a killed process left beside them.
///
/// # Errors
/// If a file cannot be removed.
pub fn prune(cache: &Path, ids: &[String]) -> Result<(), RunsError> {
    let folder = cache.join(FOLDER);
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |source| RunsError::Io { what: "delete", path, source }
    };
    match own(&folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        found => found.map_err(failed(&folder))?,
    }
    for id in ids {
        let path = path_of(&folder, id);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(failed(&path)(error)),
            _ => live::remove(cache, id),
        }
    }
    for entry in fs::read_dir(&folder).map_err(failed(&folder))? {
        let entry = entry.map_err(failed(&folder))?;
        let is_ours = entry.file_name().to_string_lossy().starts_with(".tmp");
        let time = entry.metadata().ok().filter(fs::Metadata::is_file).and_then(|data| data.modified().ok());
        let age = time.and_then(|time| SystemTime::now().duration_since(time).ok());
        if is_ours && age.is_some_and(|age| age > ABANDONED) {
            // Another process may have removed it first.
            let _ = fs::remove_file(entry.path());
        }
    }
    Ok(())
}
