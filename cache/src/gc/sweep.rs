//! How what goes is taken away, so that a kill or a power cut at any step, and a
//! run beside it at any time, loses nothing that is to be kept.
//!
//! 1. What a segment keeps is copied to a new segment, synced, and published.
//! 2. What goes moves to `trash/`: from here on nobody finds it.
//! 3. The leases are read again.  Who noted a use before step 2 may have found
//!    the thing in place and count on it: it is given back.  Who notes one after
//!    does not find it, and makes it again.
//!    So is what records need that were written meanwhile, by stores that may be
//!    closed by now.
//! 4. The trash is emptied.

use super::{
    GcReport,
    plan::{Place, Plan},
};
use crate::{
    CacheError, Digest, Key, Record, Store,
    blobs::PACK_LIMIT,
    error::At,
    index::Slot,
    layout::{Layout, names, sync_dir},
    lease::{Use, is_live, new_owner, read_uses},
    record::{Reach, decode, decode_reach},
    segment::{Sort, blob_frame, commit_frame, read_record, record_frame},
    tree,
};
use std::{
    collections::{BTreeMap, HashMap, HashSet},
    fs::{self, File},
    io::{self, Write},
    os::unix::fs::FileExt,
    path::{Path, PathBuf},
    sync::Arc,
};

pub(super) struct Sweep<'a> {
    store: &'a Store,
    plan: Plan,
    /// Where things are that went: blobs by hash ...
    blobs: HashMap<[u8; 32], (Digest, Trashed)>,
    /// ... and records, with the hashes of what they reach.
    records: HashMap<(Arc<str>, Key), Removed>,
}

type Removed = (Record, Vec<[u8; 32]>);

enum Trashed {
    Loose { trash: PathBuf, home: PathBuf },
    Packed { trash: PathBuf, offset: u64 },
}

impl<'a> Sweep<'a> {
    pub fn run(store: &'a Store, plan: Plan) -> Result<GcReport, CacheError> {
        let mut sweep = Self { store, plan, blobs: HashMap::new(), records: HashMap::new() };
        sweep.remove_loose()?;
        sweep.rewrite_packs()?;
        sweep.rewrite_logs()?;
        sweep.rescue()?;
        let trash = store.layout.folder("trash");
        for name in names(&trash).at("list", &trash)? {
            let path = trash.join(name);
            fs::remove_file(&path).at("remove", &path)?;
        }
        sweep.merge_leases()?;
        sweep.tidy()?;
        store.refresh()?;
        Ok(sweep.plan.report)
    }

    fn trash(&self, path: &Path) -> PathBuf {
        self.store.layout.folder("trash").join(path.file_name().unwrap_or_default()) // segments and blobs have names
    }

    fn remove_loose(&mut self) -> Result<(), CacheError> {
        for blob in self.plan.blobs.iter().filter(|blob| !blob.stays()) {
            let Place::Loose(home) = &blob.place else { continue };
            let trash = self.trash(home);
            match fs::rename(home, &trash) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => {} // quarantined meanwhile
                other => other.at("remove the blob", home)?,
            }
            self.blobs.insert(blob.digest.hash, (blob.digest, Trashed::Loose { trash, home: home.clone() }));
        }
        Ok(())
    }

    fn rewrite_packs(&mut self) -> Result<(), CacheError> {
        let mut packs = std::mem::take(&mut self.plan.packs);
        // Those that vanish as a whole first: the others need space.
        packs.sort_by_key(|pack| !pack.keep.is_empty());
        let chosen: HashSet<u32> = packs.iter().map(|pack| pack.segment).collect();
        for blob in self.plan.blobs.iter().filter(|blob| !blob.stays()) {
            let Place::Packed { segment, offset } = blob.place else { continue };
            if chosen.contains(&segment) {
                let trash = self.trash(&self.path_of(segment));
                self.blobs.insert(blob.digest.hash, (blob.digest, Trashed::Packed { trash, offset }));
            }
        }
        let mut out = NewSegment::new(&self.store.layout, Sort::Pack);
        let mut done = Vec::new();
        for pack in packs {
            for &number in &pack.keep {
                let digest = self.plan.blobs[number as usize].digest;
                // Damaged ones go to quarantine here, and are not copied.
                if let Some(bytes) = self.store.get_now(&digest)? {
                    out.write(&blob_frame(&digest.hash, &bytes))?;
                }
            }
            done.push(self.path_of(pack.segment));
            if pack.keep.is_empty() || out.len > PACK_LIMIT {
                out.publish()?;
                self.discard(&mut done)?;
            }
        }
        out.publish()?;
        self.discard(&mut done)
    }

    fn rewrite_logs(&mut self) -> Result<(), CacheError> {
        let logs: HashSet<u32> = self.plan.logs.iter().copied().collect();
        if logs.is_empty() {
            return Ok(());
        }
        let mut out = NewSegment::new(&self.store.layout, Sort::Log);
        let mut proven = HashSet::new();
        for row in self.plan.rows.iter().filter(|row| logs.contains(&row.segment)) {
            let path = self.path_of(row.segment);
            let frame = self.store.segment_file(row.segment).and_then(|file| read_record(&file, row.offset, row.len));
            let Some(frame) = frame.at("read the log", &path)? else { continue };
            if row.goes {
                if let Some(record) = decode(frame.bytes()) {
                    let reach = row.refs.iter().map(|&blob| self.plan.blobs[blob as usize].digest.hash).collect();
                    self.records.insert((row.namespace.clone(), row.slot.1), (record, reach));
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
        out.publish()?;
        let mut done = self.plan.logs.iter().map(|&number| self.path_of(number)).collect();
        self.discard(&mut done)
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

    fn path_of(&self, segment: u32) -> PathBuf {
        self.store.index().segments[segment as usize].path.clone()
    }

    fn discard(&self, paths: &mut Vec<PathBuf>) -> Result<(), CacheError> {
        for path in paths.drain(..) {
            let _ = fs::remove_file(path.with_added_extension("idx")); // there may be none
            fs::rename(&path, self.trash(&path)).at("remove the segment", &path)?;
        }
        Ok(())
    }

    /// Gives back what live stores have noted meanwhile.
    fn rescue(&mut self) -> Result<(), CacheError> {
        let folder = self.store.layout.folder("leases");
        let (mut hashes, mut keys) = (Vec::new(), Vec::new());
        for name in names(&folder).at("list", &folder)? {
            let path = folder.join(name);
            if !is_live(&path) {
                continue;
            }
            for used in read_uses(&path).at("read the lease", &path)? {
                match used {
                    Use::Blob(hash) => hashes.push(hash),
                    Use::Record { namespace, key } => keys.push((namespace, key)),
                    Use::Time(_) => {}
                }
            }
        }
        // After the leases: who is not live any more has written its records by now.  The refresh also forgets what
        // went, so that it does not pass for stored or recorded below.
        self.store.refresh()?;
        hashes.extend(self.refs_of_new_records()?);
        for key in keys {
            let Some((record, reach)) = self.records.remove(&key) else { continue };
            hashes.extend(reach);
            self.store.record(&record)?;
            self.plan.report.rescued += 1;
            self.plan.report.removed_records -= 1;
            self.plan.report.kept_records += 1;
        }
        for hash in hashes {
            let Some((digest, place)) = self.blobs.remove(&hash) else { continue };
            match place {
                Trashed::Loose { trash, home } => {
                    if fs::rename(&trash, &home).is_err() {
                        continue; // it had been damaged, or its owner wrote it again
                    }
                }
                Trashed::Packed { trash, offset } => {
                    let Some(bytes) = read_packed(&trash, offset, &digest) else { continue }; // damaged: a miss
                    self.store.put(&bytes)?;
                }
            }
            let report = &mut self.plan.report;
            report.rescued += 1;
            (report.removed_blobs, report.kept_blobs) = (report.removed_blobs - 1, report.kept_blobs + 1);
            report.removed_bytes -= digest.size;
            report.kept_bytes += digest.size;
        }
        self.store.flush()
    }

    /// Hashes that records reach which the plan did not know.
    fn refs_of_new_records(&self) -> Result<Vec<[u8; 32]>, CacheError> {
        let known: HashSet<(Slot, u32)> = self.plan.rows.iter().map(|row| (row.slot, row.generation)).collect();
        let new: Vec<_> = {
            let index = self.store.index();
            let new = index.records.iter().filter(|(slot, at)| !known.contains(&(**slot, at.generation)));
            new.map(|(_, at)| (at.segment, at.offset, at.len)).collect()
        };
        let (mut hashes, mut seen) = (Vec::new(), HashSet::new());
        for (segment, offset, len) in new {
            let frame = self.store.segment_file(segment).and_then(|file| read_record(&file, offset, len));
            let frame = frame.at("read the log", &self.path_of(segment))?;
            let reach = frame.as_ref().and_then(|frame| decode_reach(frame.bytes()));
            let Some(Reach { refs, trees, .. }) = reach else { continue };
            hashes.extend(refs.iter().map(|digest| digest.hash));
            let mut found = |digest: &Digest| hashes.push(digest.hash);
            tree::walk(&trees, &mut seen, &mut |digest| self.read_anywhere(digest), &mut found, &mut Vec::new())?;
        }
        Ok(hashes)
    }

    /// A blob from where it belongs, or from the trash.
    fn read_anywhere(&self, digest: &Digest) -> Result<Option<Vec<u8>>, CacheError> {
        match self.blobs.get(&digest.hash) {
            Some((_, Trashed::Loose { trash, .. })) => Ok(fs::read(trash).ok().filter(|b| Digest::of(b) == *digest)),
            Some((_, Trashed::Packed { trash, offset })) => Ok(read_packed(trash, *offset, digest)),
            None => self.store.get_now(digest),
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
            layout.write_file(&layout.folder("leases").join(format!("{}.lease", new_owner())), &bytes)?;
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
            let owner = name.rsplit_once('.').map_or(name.as_str(), |(owner, _)| owner);
            if !is_live(&layout.folder("leases").join(format!("{owner}.lease"))) {
                let _ = fs::remove_file(tmp.join(&name)); // its owner is dead or about to try again
            }
        }
        let packs: HashSet<String> =
            names(&layout.folder("packs")).at("list", &layout.folder("packs"))?.into_iter().collect();
        let quarantine = layout.folder("quarantine");
        for name in names(&quarantine).at("list", &quarantine)? {
            // Marks of packs that are still there keep others from reading the bad place.
            if name.split_once('@').is_none_or(|(segment, _)| !packs.contains(segment)) {
                let _ = fs::remove_file(quarantine.join(&name)); // next time
            }
        }
        Ok(())
    }
}

/// A packed blob; none if it is damaged.
fn read_packed(pack: &Path, offset: u64, digest: &Digest) -> Option<Vec<u8>> {
    let mut bytes = vec![0; digest.size as usize];
    File::open(pack).and_then(|file| file.read_exact_at(&mut bytes, offset)).ok()?;
    (Digest::of(&bytes) == *digest).then_some(bytes)
}

/// A segment written aside and published whole.  It has no live owner.
struct NewSegment<'a> {
    layout: &'a Layout,
    sort: Sort,
    file: Option<(File, PathBuf)>,
    len: u64,
}

impl<'a> NewSegment<'a> {
    fn new(layout: &'a Layout, sort: Sort) -> Self {
        Self { layout, sort, file: None, len: 0 }
    }

    fn write(&mut self, frame: &[u8]) -> Result<(), CacheError> {
        if self.file.is_none() {
            let path = self.layout.tmp();
            self.file = Some((File::create_new(&path).at("create", &path)?, path));
        }
        let Some((file, path)) = &mut self.file else { return Ok(()) }; // set right above
        let written = file.write_all(frame);
        if written.is_err() {
            let _ = fs::remove_file(&path); // gives the space back
        }
        written.at("write the segment", path)?;
        self.len += frame.len() as u64;
        Ok(())
    }

    fn publish(&mut self) -> Result<(), CacheError> {
        self.len = 0;
        let Some((file, tmp)) = self.file.take() else { return Ok(()) };
        file.sync_all().at("sync the segment", &tmp)?;
        let folder = self.layout.folder(self.sort.folder());
        let last = names(&folder).at("list", &folder)?;
        let last = last.iter().filter_map(|name| self.sort.parse(name)).map(|(seq, _)| seq).max();
        let path = folder.join(self.sort.name(last.unwrap_or(0) + 1, &new_owner()));
        fs::rename(&tmp, &path).at("publish the segment", &path)?;
        sync_dir(&folder).at("sync the folder", &folder)
    }
}

/// Puts back what a collection that died had moved to the trash.  What it had copied is there twice then.
pub(super) fn restore_trash(layout: &Layout) -> Result<(), CacheError> {
    let trash = layout.folder("trash");
    for name in names(&trash).at("list", &trash)? {
        let from = trash.join(&name);
        let home = match name.parse::<Digest>() {
            Ok(digest) => layout.blob(&digest),
            Err(_) if Sort::Pack.parse(&name).is_some() => layout.folder("packs").join(&name),
            Err(_) if Sort::Log.parse(&name).is_some() => layout.folder("log").join(&name),
            Err(_) => continue,
        };
        fs::rename(&from, &home).at("restore", &home)?;
    }
    Ok(())
}
