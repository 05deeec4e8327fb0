//! Group commit: blobs are synced first, then a mark is written to the log.
//!
//! Records are written to the log at once, so that other processes see them and a killed process loses none; only a
//! power cut can separate a record from its blobs. The mark tells the records that a power cut cannot have separated;
//! the others are believed once their blobs have been read.
//!
//! The log is synced before the mark is written, not after: whoever sees a mark may rely on the records before it, even
//! if its writer died right then. The mark itself is durable with the next commit. A power cut that takes it only has
//! the last records proved by reading.
//!
//! Blobs of a record can come from other stores: a dead process may have written them without making them durable. A
//! commit therefore also syncs the files of other stores that this store relies on.

use crate::{
    CacheError, Digest, Store,
    error::At,
    layout::{is_own_folder, open_plain, sync_dir},
    records::append_frame,
    segment::commit_frame,
    store::{LogWriter, Relied, Synced, lock},
};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    time::Duration,
};

/// A commit is due after this many records ...
const MANY: usize = 512;
/// ... or when the oldest one has waited this long.
const LONG: Duration = Duration::from_secs(1);
/// Bytes from which a log segment is closed and another begun.
const LOG_LIMIT: u64 = 256 << 20;

/// Whether records have waited long enough.
pub(crate) fn due(log: &LogWriter) -> bool {
    log.pending >= MANY || log.since.is_some_and(|since| since.elapsed() >= LONG)
}

impl Store {
    /// Makes everything that was put and recorded so far durable.
    ///
    /// # Errors
    /// When the disk refuses. Everything is readable still, but nothing is promised about a power cut.
    pub fn flush(&self) -> Result<(), CacheError> {
        let mut of_others = lock(&self.commit);
        // The end of the log first, the blobs afterwards: what a record before that end names is among them.
        let (pending, covered) = {
            let mut log = lock(&self.log);
            log.since = None;
            let end = log.appender.as_ref().map(|to| (to.segment, to.end, to.file.clone(), to.path.clone()));
            (std::mem::take(&mut log.pending), end)
        };
        // Without records of its own, too: what a run found done must be durable when the run ends.
        let relied = std::mem::take(&mut *lock(&self.relied));
        let (packs, loose) = {
            let mut packs = lock(&self.packs);
            (std::mem::take(&mut packs.dirty_packs), std::mem::take(&mut packs.dirty_loose))
        };
        let synced = packs
            .iter()
            .try_for_each(|(path, file)| file.sync_data().at("sync the pack", path))
            .and_then(|()| sync_loose(&loose))
            .and_then(|()| {
                let idle = pending == 0 && relied.blobs.is_empty() && relied.logs.is_empty();
                if idle { Ok(()) } else { self.sync_others(&relied, &mut of_others) }
            })
            .and_then(|()| match &covered {
                Some((.., file, path)) if pending > 0 => file.sync_data().at("sync the log", path),
                _ => Ok(()),
            });
        if synced.is_err() {
            // After a failed sync, a later success proves nothing about these bytes. No mark will ever cover them.
            lock(&self.packs).appender = None;
            lock(&self.log).appender = None;
            return synced;
        }
        match covered {
            Some((segment, end, ..)) if pending > 0 => {
                self.mark(segment, end).inspect_err(|_| lock(&self.log).pending += pending)
            }
            _ => Ok(()),
        }
    }

    /// Notes blobs that records to come will name, and that nobody may have made durable.
    pub(crate) fn rely_on(&self, blobs: impl IntoIterator<Item = Digest>) {
        let others: Vec<Digest> = {
            let index = self.index();
            let own = |digest: &Digest| {
                index.blobs.get(&digest.hash).is_some_and(|at| index.segments[at.segment as usize].own)
            };
            blobs.into_iter().filter(|digest| !own(digest)).collect()
        };
        if !others.is_empty() {
            lock(&self.relied).blobs.extend(others);
        }
    }

    /// Syncs what is of others, each segment and each file once as long as it does not grow.
    fn sync_others(&self, relied: &Relied, synced: &mut Synced) -> Result<(), CacheError> {
        let (mut segments, mut loose): (BTreeMap<u32, PathBuf>, BTreeSet<Digest>) = Default::default();
        let mut ends = Vec::new();
        {
            let index = self.index();
            let mut rely = |number: u32, least: u64| {
                let segment = &index.segments[number as usize];
                if !segment.own && synced.segments.get(&number).is_none_or(|end| *end < least) {
                    segments.insert(number, segment.path.clone());
                    ends.push((number, segment.scanned));
                }
            };
            relied.logs.iter().for_each(|(number, end)| rely(*number, *end));
            for digest in &relied.blobs {
                match index.blobs.get(&digest.hash).filter(|at| at.size == digest.size) {
                    Some(at) => rely(at.segment, at.offset + at.size),
                    None if synced.loose.contains(digest) => {}
                    None => {
                        loose.insert(*digest);
                    }
                }
            }
        }
        for path in segments.values() {
            match open_plain(path) {
                Ok(file) => file.sync_data().at("sync the segment", path)?,
                // A gc moved what is left elsewhere, and synced what it wrote; the rest is a miss.
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                Err(error) => return Err(error).at("sync the segment", path),
            }
        }
        for folder in segments.values().filter_map(|path| path.parent()).collect::<BTreeSet<_>>() {
            sync_dir(folder).at("sync the folder", folder)?;
        }
        synced.segments.extend(ends);
        if !synced.root {
            // Whoever made the store may have died before its folders were durable.
            sync_dir(&self.layout.root).at("sync the folder", &self.layout.root)?;
            synced.root = true;
        }
        let paths: Vec<PathBuf> = loose.iter().map(|digest| self.layout.blob(digest)).collect();
        sync_loose(&paths)?;
        synced.loose.extend(loose);
        Ok(())
    }

    /// Writes the commit mark, and closes the segment if it has grown long.
    fn mark(&self, segment: u32, end: u64) -> Result<(), CacheError> {
        let mut log = lock(&self.log);
        if log.appender.as_ref().is_none_or(|to| to.segment != segment) {
            return Ok(()); // spoiled or removed meanwhile: its records are proved on reading
        }
        append_frame(&mut log, &commit_frame(end))?;
        let Some(to) = &log.appender else { return Ok(()) }; // a success keeps it
        {
            let segment = &mut self.index_mut().segments[segment as usize];
            (segment.scanned, segment.committed) = (to.end, end);
        }
        if to.end > LOG_LIMIT && log.pending == 0 {
            log.appender = None;
        }
        Ok(())
    }
}

fn sync_loose(paths: &[PathBuf]) -> Result<(), CacheError> {
    let mut folders: BTreeSet<&Path> = BTreeSet::new();
    let mut own: BTreeMap<&Path, bool> = BTreeMap::new();
    for path in paths {
        // Behind a link lies what is of somebody else.
        if !path.parent().is_some_and(|folder| *own.entry(folder).or_insert_with(|| is_own_folder(folder))) {
            continue;
        }
        match open_plain(path) {
            Ok(file) => file.sync_data().at("sync the blob", path)?,
            // Quarantined, or taken by hand: a miss later, nothing to sync now.
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
            Err(error) => return Err(error).at("sync the blob", path),
        }
        folders.extend(path.parent());
    }
    for folder in &folders {
        sync_dir(folder).at("sync the folder", folder)?;
    }
    if let Some(blobs) = folders.first().and_then(|folder| folder.parent()) {
        sync_dir(blobs).at("sync the folder", blobs)?; // folders that were made
    }
    Ok(())
}
