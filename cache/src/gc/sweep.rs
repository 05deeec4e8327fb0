//! Deletion in steps, so that a kill or a power cut at any step, or a concurrent run, loses nothing that must be kept.
//!
//! 1. The entries to keep are copied to a new segment, synced, and published.
//! 2. The others move to `trash/`, where no store finds them.
//! 3. The leases are read again. Who noted a use before step 2 may have found the thing in place and count on it: it is
//!    given back. Who notes one after does not find it, and makes it again. So is what records need that were written
//!    meanwhile, by stores that may be closed by now.
//! 4. The trash is emptied.
//!
//! All this is done for files that go as a whole first, which takes no room and makes some, then for segments of which
//! something stays.

use super::{
    GcReport,
    new_segment::NewSegment,
    plan::{PackPlan, Place, Plan, Row},
    trash::home,
};
use crate::{
    CacheError, Digest, Key, Record, Store,
    blobs::PACK_LIMIT,
    error::At,
    layout::{names, tmp_owner},
    lease::{Use, is_live, new_owner},
    network, quarantine,
    record::decode,
    segment::{Sort, blob_frame, commit_frame, read_record, record_frame},
};
use std::{
    collections::{BTreeMap, HashMap, HashSet},
    fs, io,
    path::{Path, PathBuf},
    sync::Arc,
};

pub(super) struct Sweep<'a> {
    pub(super) store: &'a Store,
    pub(super) plan: Plan,
    /// Records that go and are in the log still, as numbers in the plan ...
    pub(super) going: HashMap<Slotted, u32>,
    /// ... and those that are not, with the hashes of what they reach.
    pub(super) records: HashMap<Slotted, Removed>,
    /// Where blobs are that went, by hash, until the trash is emptied.
    pub(super) blobs: HashMap<[u8; 32], (Digest, Trashed)>,
}

/// A record's namespace and key.
pub(super) type Slotted = (Arc<str>, Key);
pub(super) type Removed = (Record, Vec<[u8; 32]>);

pub(super) enum Trashed {
    Loose { trash: PathBuf, home: PathBuf },
    Packed { trash: PathBuf, offset: u64 },
}

impl<'a> Sweep<'a> {
    pub fn run(store: &'a Store, plan: Plan) -> Result<GcReport, CacheError> {
        let rows = plan.rows.iter().enumerate().filter(|(_, row)| row.goes);
        let going = rows.map(|(number, row)| ((row.namespace.clone(), row.slot.1), number as u32)).collect();
        let mut sweep = Self { store, plan, going, records: HashMap::new(), blobs: HashMap::new() };
        sweep.remove_loose()?;
        sweep.remove_packs()?;
        sweep.settle()?;
        sweep.rewrite_packs()?;
        sweep.rewrite_logs()?;
        sweep.settle()?;
        match sweep.merge_leases() {
            Err(error) if error.is_full() => {} // the next collection has the same leases to merge
            other => other?,
        }
        sweep.tidy()?;
        store.refresh()?;
        Ok(sweep.plan.report)
    }

    fn trash(&self, path: &Path) -> PathBuf {
        self.store.layout.folder("trash").join(path.file_name().unwrap_or_default()) // segments and blobs have names
    }

    /// Gives back what is needed, and empties the trash.
    fn settle(&mut self) -> Result<(), CacheError> {
        self.rescue()?;
        let trash = self.store.layout.folder("trash");
        for name in names(&trash).at("list", &trash)?.iter().filter(|name| home(&self.store.layout, name).is_some()) {
            let path = trash.join(name);
            fs::remove_file(&path).at("remove", &path)?;
        }
        self.blobs.clear();
        self.records.clear();
        Ok(())
    }

    fn remove_loose(&mut self) -> Result<(), CacheError> {
        for number in 0..self.plan.blobs.len() {
            let blob = &self.plan.blobs[number];
            let Place::Loose(home) = &blob.place else { continue };
            if blob.stays() {
                continue;
            }
            let (digest, home) = (blob.digest, home.clone());
            let trash = self.trash(&home);
            match network::rename(&home, &trash) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => {} // quarantined meanwhile
                other => other.at("remove the blob", &home)?,
            }
            self.blobs.insert(digest.hash, (digest, Trashed::Loose { trash, home }));
            self.plan.blobs[number].gone = true;
        }
        Ok(())
    }

    /// Removes the packs of which nothing stays.
    fn remove_packs(&mut self) -> Result<(), CacheError> {
        let packs = std::mem::take(&mut self.plan.packs);
        let stays = |pack: &PackPlan| pack.here.iter().any(|&blob| self.plan.blobs[blob as usize].stays());
        let (rest, whole): (Vec<_>, Vec<_>) = packs.into_iter().partition(stays);
        self.plan.packs = rest;
        self.discard_packs(whole)
    }

    /// Copies what stays of packs, and removes them.
    fn rewrite_packs(&mut self) -> Result<(), CacheError> {
        let packs = std::mem::take(&mut self.plan.packs);
        let mut out = NewSegment::new(&self.store.layout, Sort::Pack);
        let (mut done, mut scarce) = (Vec::new(), Vec::new());
        for pack in packs {
            match self.copy_pack(&pack, &mut out) {
                Ok(()) => done.push(pack),
                Err(error) if error.is_full() => {
                    out.give_up();
                    scarce.append(&mut done);
                    scarce.push(pack);
                    continue;
                }
                Err(error) => return Err(error),
            }
            if out.len > PACK_LIMIT {
                self.publish_packs(&mut out, &mut done, &mut scarce)?;
            }
        }
        self.publish_packs(&mut out, &mut done, &mut scarce)?;
        // One by one, those first of which the least stays, and with the room that each makes.
        scarce.sort_by_cached_key(|pack| (self.kept_bytes(pack), pack.segment));
        for pack in scarce {
            let copied = self.copy_pack(&pack, &mut out).and_then(|()| out.publish());
            match copied {
                Ok(()) => {
                    self.discard_packs(vec![pack])?;
                    self.settle()?;
                }
                Err(error) if error.is_full() => {
                    out.give_up();
                    self.plan.leave(&pack);
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn kept_bytes(&self, pack: &PackPlan) -> u64 {
        let blobs = pack.here.iter().map(|&number| &self.plan.blobs[number as usize]);
        blobs.filter(|blob| blob.stays()).fold(0, |sum, blob| sum.saturating_add(blob.digest.size))
    }

    fn copy_pack(&self, pack: &PackPlan, out: &mut NewSegment<'_>) -> Result<(), CacheError> {
        for &number in &pack.here {
            let blob = &self.plan.blobs[number as usize];
            // Damaged ones go to quarantine here, and are not copied.
            if blob.stays()
                && let Some(bytes) = self.store.get_now(&blob.digest)?
            {
                out.write(&blob_frame(&blob.digest.hash, &bytes))?;
            }
        }
        Ok(())
    }

    fn publish_packs(
        &mut self,
        out: &mut NewSegment<'_>,
        done: &mut Vec<PackPlan>,
        scarce: &mut Vec<PackPlan>,
    ) -> Result<(), CacheError> {
        match out.publish() {
            Ok(()) => self.discard_packs(std::mem::take(done)),
            Err(error) if error.is_full() => {
                out.give_up();
                scarce.append(done);
                Ok(())
            }
            Err(error) => Err(error),
        }
    }

    fn discard_packs(&mut self, packs: Vec<PackPlan>) -> Result<(), CacheError> {
        for pack in packs {
            let path = self.path_of(pack.segment);
            let trash = self.trash(&path);
            for &number in &pack.here {
                let blob = &mut self.plan.blobs[number as usize];
                let Place::Packed { offset, .. } = blob.place else { continue };
                if !blob.stays() {
                    blob.gone = true;
                    let place = Trashed::Packed { trash: trash.clone(), offset };
                    self.blobs.insert(blob.digest.hash, (blob.digest, place));
                }
            }
            self.discard(&path)?;
        }
        Ok(())
    }

    fn rewrite_logs(&mut self) -> Result<(), CacheError> {
        let logs = std::mem::take(&mut self.plan.logs);
        let keeps: HashSet<u32> = self.plan.rows.iter().filter(|row| !row.goes).map(|row| row.segment).collect();
        let (some, none): (Vec<u32>, Vec<u32>) = logs.into_iter().partition(|log| keeps.contains(log));
        self.rewrite_these(&none)?;
        match self.rewrite_these(&some) {
            // The deleted record then has no blobs, and is useless.
            Err(error) if error.is_full() => {
                let left = |row: &&Row| row.goes && some.contains(&row.segment);
                let left = self.plan.rows.iter().filter(left).count() as u64;
                let report = &mut self.plan.report;
                report.removed_records = report.removed_records.saturating_sub(left);
                report.kept_records += left;
                Ok(())
            }
            other => other,
        }
    }

    fn rewrite_these(&mut self, logs: &[u32]) -> Result<(), CacheError> {
        let logs: HashSet<u32> = logs.iter().copied().collect();
        let mut out = NewSegment::new(&self.store.layout, Sort::Log);
        let copied = self.copy_logs(&logs, &mut out).and_then(|removed| out.publish().map(|()| removed));
        let removed = copied.inspect_err(|_| out.give_up())?;
        for key in removed.iter().map(|(key, _)| key) {
            self.going.remove(key);
        }
        self.records.extend(removed);
        let mut paths: Vec<PathBuf> = logs.iter().map(|&number| self.path_of(number)).collect();
        paths.sort_unstable();
        paths.iter().try_for_each(|path| self.discard(path))
    }

    /// Copies what stays of logs; returns what does not.
    fn copy_logs(&self, logs: &HashSet<u32>, out: &mut NewSegment<'_>) -> Result<Vec<(Slotted, Removed)>, CacheError> {
        let (mut removed, mut proven) = (Vec::new(), HashSet::new());
        for row in self.plan.rows.iter().filter(|row| logs.contains(&row.segment)) {
            let path = self.path_of(row.segment);
            let frame = self.store.segment_file(row.segment).and_then(|file| read_record(&file, row.offset, row.len));
            let Some(frame) = frame.at("read the log", &path)? else { continue };
            if row.goes {
                if let Some(record) = decode(frame.bytes()) {
                    let reach = row.refs.iter().map(|&blob| self.plan.blobs[blob as usize].digest.hash).collect();
                    removed.push(((row.namespace.clone(), row.slot.1), (record, reach)));
                }
                continue;
            }
            // The new segment's commit mark vouches for the blobs, so they are proved first.
            let at = self.store.index().records.get(&row.slot).copied();
            let provisional = at.is_none_or(|at| self.store.index().is_provisional(&row.slot, &at));
            if provisional && (row.derived || !self.proves(&row.refs, &mut proven)?) {
                continue;
            }
            out.write(&record_frame(frame.bytes()))?;
        }
        if out.len > 0 {
            let end = out.len;
            out.write(&commit_frame(end))?;
        }
        Ok(removed)
    }

    /// Whether all these are good, or go; `proven` are those that are known to be.
    fn proves(&self, refs: &[u32], proven: &mut HashSet<u32>) -> Result<bool, CacheError> {
        for &number in refs {
            if !proven.insert(number) {
                continue;
            }
            let blob = &self.plan.blobs[number as usize];
            if blob.stays() && self.store.get_now(&blob.digest)?.is_none() {
                proven.remove(&number);
                return Ok(false);
            }
        }
        Ok(true)
    }

    pub(super) fn path_of(&self, segment: u32) -> PathBuf {
        self.store.index().segments[segment as usize].path.clone()
    }

    fn discard(&self, path: &Path) -> Result<(), CacheError> {
        let _ = fs::remove_file(path.with_added_extension("idx")); // there may be none
        match network::rename(path, &self.trash(path)) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()), // taken by hand
            other => other.at("remove the segment", path),
        }
    }

    /// One history of use instead of many.
    fn merge_leases(&self) -> Result<(), CacheError> {
        if self.plan.dead_leases.is_empty() {
            return Ok(());
        }
        let mut by_time: BTreeMap<u64, Vec<Use>> = BTreeMap::new();
        for row in self.plan.rows.iter().filter(|row| !row.goes && row.last_used > row.when) {
            let used = Use::Record { namespace: row.namespace.clone(), key: row.slot.1 };
            by_time.entry(row.last_used).or_default().push(used);
        }
        let mut bytes = Vec::new();
        for (when, uses) in by_time {
            Use::Time(when).encode(&mut bytes);
            uses.iter().for_each(|used| used.encode(&mut bytes));
        }
        let layout = &self.store.layout;
        if !bytes.is_empty() {
            layout.write_file(&layout.lease(&new_owner()), &bytes)?;
        }
        for path in &self.plan.dead_leases {
            let _ = fs::remove_file(path); // merged; once more does no harm
        }
        Ok(())
    }

    /// Removes what dead processes left lying about.
    fn tidy(&self) -> Result<(), CacheError> {
        let layout = &self.store.layout;
        let tmp = layout.folder("tmp");
        for name in names(&tmp).at("list", &tmp)? {
            if tmp_owner(&name).is_some_and(|owner| !is_live(&layout.lease(owner))) {
                let _ = fs::remove_file(tmp.join(&name)); // its owner is dead or about to try again
            }
        }
        let packs: HashSet<String> =
            names(&layout.folder("packs")).at("list", &layout.folder("packs"))?.into_iter().collect();
        let quarantine = layout.folder("quarantine");
        for name in names(&quarantine).at("list", &quarantine)? {
            // Marks of packs that are still there keep others from reading the bad place.
            let idle = |pack: Option<&str>| pack.is_none_or(|segment| !packs.contains(segment));
            if quarantine::subject(&name).is_some_and(idle) {
                let _ = fs::remove_file(quarantine.join(&name)); // next time
            }
        }
        Ok(())
    }
}
