//! Restores blobs that live stores have requested, or that new records refer to.

use super::sweep::{Sweep, Trashed};
use crate::{
    CacheError, Digest,
    blobs::read_blob,
    error::At,
    index::Slot,
    layout::{is_own_folder, lease_owner, names, open_plain},
    lease::{Use, is_live, read_uses},
    network,
    record::{Reach, decode_reach},
    segment::read_record,
    tree,
};
use std::{collections::HashSet, path::Path};

impl Sweep<'_> {
    /// Gives back what live stores have noted meanwhile.
    pub(super) fn rescue(&mut self) -> Result<(), CacheError> {
        let folder = self.store.layout.folder("leases");
        let (mut hashes, mut keys) = (Vec::new(), Vec::new());
        for name in names(&folder).at("list", &folder)?.iter().filter(|name| lease_owner(name).is_some()) {
            let path = folder.join(name);
            if !is_live(&path) {
                continue;
            }
            let mut note = |used: Use| match used {
                Use::Blob(hash) => hashes.push(hash),
                Use::Record { namespace, key } => keys.push((namespace, key)),
                Use::Time(_) => {}
            };
            read_uses(&path, &mut note).at("read the lease", &path)?;
        }
        // After the leases: who is not live any more has written its records by now. The refresh also forgets what
        // went, so that it does not pass for stored or recorded below.
        self.store.refresh()?;
        hashes.extend(self.refs_of_new_records()?);
        for key in keys {
            if let Some(number) = self.going.remove(&key) {
                let row = &mut self.plan.rows[number as usize];
                row.goes = false;
                let blobs = row.refs.iter().map(|&blob| self.plan.blobs[blob as usize].digest.hash);
                hashes.extend(blobs);
            } else if let Some((record, reach)) = self.records.remove(&key) {
                hashes.extend(reach);
                self.store.record(&record)?;
            } else {
                continue;
            }
            let report = &mut self.plan.report;
            report.rescued += 1;
            report.removed_records = report.removed_records.saturating_sub(1);
            report.kept_records += 1;
        }
        let mut packs = HashSet::new();
        for hash in hashes {
            let Some((digest, place)) = self.blobs.remove(&hash) else {
                if let Some(&number) = self.plan.by_hash.get(&hash) {
                    self.plan.keep(number);
                }
                continue;
            };
            match place {
                Trashed::Loose { trash, home } => {
                    if !home.parent().is_some_and(is_own_folder) || network::rename(&trash, &home).is_err() {
                        continue; // it had been damaged, or its owner wrote it again
                    }
                }
                Trashed::Packed { trash, .. } if packs.contains(&trash) => {}
                Trashed::Packed { trash, offset } => {
                    let Some(bytes) = read_packed(&trash, offset, &digest) else { continue }; // damaged: a miss
                    match self.store.put(&bytes) {
                        // No room for a copy: all of the pack comes back.
                        Err(error) if error.is_full() => {
                            let home = self.store.layout.folder("packs").join(trash.file_name().unwrap_or_default());
                            network::rename(&trash, &home).at("restore", &home)?;
                            packs.insert(trash);
                        }
                        other => drop(other?),
                    }
                }
            }
            self.plan.is_back(&digest.hash);
        }
        if self.store.writes().is_ok() { self.store.flush() } else { Ok(()) }
    }

    /// Hashes that records reach which the plan did not know.
    fn refs_of_new_records(&self) -> Result<Vec<[u8; 32]>, CacheError> {
        let known: HashSet<(Slot, u32)> = self.plan.rows.iter().map(|row| (row.slot, row.generation)).collect();
        let new = {
            let index = self.store.index();
            let new = index.records.iter().filter(|(slot, at)| !known.contains(&(**slot, at.generation)));
            let mut new: Vec<_> = new.map(|(_, at)| (at.segment, at.offset, at.len)).collect();
            new.sort_unstable();
            new
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
            Some((_, Trashed::Loose { trash, .. })) => {
                Ok(open_plain(trash).and_then(|file| read_blob(&file, 0, digest, true)).ok().flatten())
            }
            Some((_, Trashed::Packed { trash, offset })) => Ok(read_packed(trash, *offset, digest)),
            None => self.store.get_now(digest),
        }
    }
}

/// A packed blob; none if it is damaged.
fn read_packed(pack: &Path, offset: u64, digest: &Digest) -> Option<Vec<u8>> {
    read_blob(&open_plain(pack).ok()?, offset, digest, false).ok()?
}
