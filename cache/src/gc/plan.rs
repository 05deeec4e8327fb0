//! Decides which entries a collection keeps and deletes. Read-only.

use super::{GcOptions, GcReport, listing::Listing, segments::live_segments};
use crate::{
    CacheError, Digest, Key, Store,
    error::At,
    index::Slot,
    layout::{lease_owner, loose_blobs, names},
    lease::{Use, is_live, read_uses},
    record::{Reach, decode_reach},
    segment::read_record,
    whole::Checked,
};
use std::{
    collections::{HashMap, HashSet, hash_map::Entry},
    path::PathBuf,
    sync::Arc,
};

/// Blobs that all records may reach, each record counted for itself: half a gigabyte of numbers.
const MOST_REACHED: u64 = 1 << 27;

/// Where a blob lies.
#[derive(Clone, Debug)]
pub(super) enum Place {
    Loose(PathBuf),
    Packed { segment: u32, offset: u64 },
}

/// A blob, and why it stays.
#[derive(Clone, Debug)]
pub(super) struct Blob {
    pub digest: Digest,
    pub place: Place,
    /// Kept whatever the budget.
    held: bool,
    /// Records that are kept and reach it.
    references: u32,
    /// It lists others.
    pub tree: bool,
    /// Stays because its pack is not worth rewriting, or there is no room to.
    pub lingers: bool,
    /// It is in the trash, or was there.
    pub gone: bool,
}

impl Blob {
    pub fn stays(&self) -> bool {
        self.held || self.references > 0 || self.lingers
    }
}

/// A record, and whether it goes.
pub(super) struct Row {
    pub slot: Slot,
    pub namespace: Arc<str>,
    pub segment: u32,
    pub offset: u64,
    pub len: u32,
    pub generation: u32,
    /// Blobs it reaches, as numbers in `Plan::blobs`; those that are missing are left out.
    pub refs: Vec<u32>,
    has_refs: bool,
    /// It only sums other records up.
    pub derived: bool,
    /// Microseconds that it takes to make a byte of what it reaches again.
    cost: f64,
    complete: bool,
    /// Blobs that it names are lost.
    lost: bool,
    pub last_used: u64,
    pub when: u64,
    held: bool,
    pub goes: bool,
}

/// A pack to be rewritten, with the blobs that lie in it; those that stay are taken along.
pub(super) struct PackPlan {
    pub segment: u32,
    pub here: Vec<u32>,
}

/// The decision.
pub(super) struct Plan {
    pub blobs: Vec<Blob>,
    pub by_hash: HashMap<[u8; 32], u32>,
    pub rows: Vec<Row>,
    pub packs: Vec<PackPlan>,
    /// Log segments to be rewritten.
    pub logs: Vec<u32>,
    /// Leases of dead stores.
    pub dead_leases: Vec<PathBuf>,
    pub report: GcReport,
}

impl Plan {
    pub fn make(store: &Store, options: &GcOptions) -> Result<Self, CacheError> {
        let mut plan = Self {
            blobs: Vec::new(),
            by_hash: HashMap::new(),
            rows: Vec::new(),
            packs: Vec::new(),
            logs: Vec::new(),
            dead_leases: Vec::new(),
            report: GcReport { dry_run: options.dry_run, ..GcReport::default() },
        };
        let live = live_segments(store);
        plan.list_blobs(store, &live)?;
        plan.list_records(store, &live)?;
        plan.hold(store, options)?;
        plan.evict(options);
        plan.choose_packs(store, &live)?;
        plan.choose_logs(store, &live);
        plan.count(options);
        Ok(plan)
    }

    fn add(&mut self, digest: Digest, place: Place, held: bool) {
        let blob = Blob { digest, place, held, references: 0, tree: false, lingers: false, gone: false };
        // A blob that is both packed and loose (the limit between them changed) counts where reading finds it.
        if let Entry::Vacant(entry) = self.by_hash.entry(digest.hash) {
            entry.insert(self.blobs.len() as u32);
            self.blobs.push(blob);
        }
    }

    fn list_blobs(&mut self, store: &Store, live: &HashSet<u32>) -> Result<(), CacheError> {
        let mut packed: Vec<_> = store.index().blobs.iter().map(|(hash, at)| (*hash, *at)).collect();
        packed.sort_unstable_by_key(|(hash, at)| (at.segment, at.offset, *hash));
        for (hash, at) in packed {
            let place = Place::Packed { segment: at.segment, offset: at.offset };
            self.add(Digest { hash, size: at.size }, place, live.contains(&at.segment));
        }
        for (digest, path) in loose_blobs(&store.layout.root).at("list the blobs in", &store.layout.root)? {
            self.add(digest, Place::Loose(path), false);
        }
        Ok(())
    }

    fn list_records(&mut self, store: &Store, live: &HashSet<u32>) -> Result<(), CacheError> {
        let mut records: Vec<_> = store.index().records.iter().map(|(slot, at)| (*slot, *at)).collect();
        records.sort_unstable_by_key(|(slot, at)| (at.segment, at.offset, *slot));
        let here: HashSet<Digest> = self.blobs.iter().map(|blob| blob.digest).collect();
        let lost = store.check_records(&here)?.into_iter().filter(Checked::has_lost).map(|checked| checked.slot);
        let lost: HashSet<Slot> = lost.collect();
        let mut listings: HashMap<Digest, Listing> = HashMap::new();
        let mut reached = 0_u64;
        for (slot, at) in records {
            let path = store.index().segments[at.segment as usize].path.clone();
            let frame = store.segment_file(at.segment).and_then(|file| read_record(&file, at.offset, at.len));
            let frame = frame.at("read the log", &path)?;
            let found = frame.as_ref().and_then(|frame| decode_reach(frame.bytes()));
            let Some(Reach { head, refs, trees, derived, .. }) = found else {
                // It is a miss already. Its segment counts as damaged now, and is rewritten without it.
                store.index_mut().mark_damaged(&slot);
                continue;
            };
            let namespace = store.index().name(slot.0).clone();
            let mut reach = Listing { complete: true, trees, ..Listing::default() };
            refs.iter().for_each(|digest| reach.add(&self.by_hash, digest));
            let has_refs = !refs.is_empty() || !reach.trees.is_empty();
            self.add_trees(store, &mut reach, &mut listings)?;
            let (mut present, complete) = (reach.present, reach.complete);
            present.sort_unstable();
            present.dedup();
            reached = reached.saturating_add(present.len() as u64);
            if reached > MOST_REACHED {
                return Err(CacheError::TooManyReached { dir: store.layout.root.clone(), limit: MOST_REACHED });
            }
            present.shrink_to_fit();
            present.iter().for_each(|&blob| self.blobs[blob as usize].references += 1);
            let cost = if derived { 0.0 } else { head.wall_us as f64 / self.size(&present).max(1) as f64 };
            self.rows.push(Row {
                slot,
                namespace,
                segment: at.segment,
                offset: at.offset,
                len: at.len,
                generation: at.generation,
                has_refs,
                complete,
                lost: lost.contains(&slot),
                refs: present,
                cost,
                derived,
                last_used: head.when,
                when: head.when,
                held: live.contains(&at.segment),
                goes: false,
            });
        }
        Ok(())
    }

    /// Marks what is kept whatever the budget.
    fn hold(&mut self, store: &Store, options: &GcOptions) -> Result<(), CacheError> {
        let rows: HashMap<(Arc<str>, Key), u32> =
            self.rows.iter().enumerate().map(|(n, row)| ((row.namespace.clone(), row.slot.1), n as u32)).collect();
        let folder = store.layout.folder("leases");
        for name in names(&folder).at("list", &folder)? {
            if lease_owner(&name).is_none() {
                continue;
            }
            let path = folder.join(name);
            let live = is_live(&path);
            let mut time = None;
            let mut note = |used: Use| match used {
                Use::Time(when) => time = Some(when),
                Use::Blob(hash) if live => {
                    if let Some(&blob) = self.by_hash.get(&hash) {
                        self.blobs[blob as usize].held = true;
                    }
                }
                Use::Blob(_) => {}
                Use::Record { namespace, key } => {
                    if let Some(&row) = rows.get(&(namespace, key)) {
                        let row = &mut self.rows[row as usize];
                        row.held |= live;
                        row.last_used = row.last_used.max(time.unwrap_or(0));
                    }
                }
            };
            read_uses(&path, &mut note).at("read the lease", &path)?;
            if !live {
                self.dead_leases.push(path);
            } else if !store.is_own_lease(&path) {
                self.report.live_stores += 1;
            }
        }
        let mut pinned = HashSet::new();
        for digest in store.pins()?.values().chain(&options.pins) {
            if let Some(&blob) = self.by_hash.get(&digest.hash) {
                self.blobs[blob as usize].held = true;
                pinned.insert(blob);
            }
        }
        let recent = options.keep_within_secs.map(|span| options.now.saturating_sub(span));
        for row in &mut self.rows {
            row.held |= !(options.lost && row.lost) && recent.is_some_and(|since| row.last_used >= since);
            row.held |= row.refs.iter().any(|blob| pinned.contains(blob));
            if row.held {
                row.refs.iter().for_each(|&blob| self.blobs[blob as usize].held = true);
            }
        }
        Ok(())
    }

    pub fn size(&self, blobs: &[u32]) -> u64 {
        total(blobs.iter().map(|&blob| &self.blobs[blob as usize]))
    }

    /// Keeps a blob after all that has not gone yet.
    pub fn keep(&mut self, number: u32) {
        let blob = &mut self.blobs[number as usize];
        if !blob.stays() && !blob.gone {
            blob.held = true;
            self.report.stays_after_all(blob.digest.size);
            self.report.rescued += 1;
        }
    }

    /// Says that a blob which went is back.
    pub fn is_back(&mut self, hash: &[u8; 32]) {
        let Some(&number) = self.by_hash.get(hash) else { return };
        let blob = &mut self.blobs[number as usize];
        (blob.held, blob.gone) = (true, false);
        self.report.stays_after_all(blob.digest.size);
        self.report.rescued += 1;
    }

    /// Leaves a pack as it is, as there is no room to copy what stays.
    pub fn leave(&mut self, pack: &PackPlan) {
        for &number in &pack.here {
            let blob = &mut self.blobs[number as usize];
            if !blob.stays() {
                blob.lingers = true;
                self.report.stays_after_all(blob.digest.size);
                self.report.no_room_bytes = self.report.no_room_bytes.saturating_add(blob.digest.size);
            }
        }
    }

    /// Lets records go: under a budget those first that take the least time to make a byte of again, of these the least
    /// recently used.
    fn evict(&mut self, options: &GcOptions) {
        let mut order: Vec<u32> = (0..self.rows.len() as u32).filter(|&n| !self.rows[n as usize].held).collect();
        order.sort_unstable_by(|&a, &b| {
            let (a, b) = (&self.rows[a as usize], &self.rows[b as usize]);
            let rest = |row: &Row| (row.last_used, row.namespace.clone(), row.slot.1);
            b.derived.cmp(&a.derived).then(a.cost.total_cmp(&b.cost)).then_with(|| rest(a).cmp(&rest(b)))
        });
        let asked = |n: &u32| options.lost && self.rows[*n as usize].lost;
        let (lost, order): (Vec<u32>, Vec<u32>) = order.into_iter().partition(asked);
        for n in lost {
            let row = &mut self.rows[n as usize];
            row.goes = true;
            row.refs.iter().for_each(|&blob| self.blobs[blob as usize].references -= 1);
        }
        let mut left = total(self.blobs.iter().filter(|blob| blob.stays()));
        for n in order {
            let row = &mut self.rows[n as usize];
            match options.max_bytes {
                Some(limit) if left <= limit => break,
                // Under a budget, a record without blobs is not what takes the space.
                Some(_) if row.refs.is_empty() => continue,
                None if options.keep_within_secs.is_none() => break,
                _ => {}
            }
            row.goes = true;
            for &blob in &row.refs {
                let blob = &mut self.blobs[blob as usize];
                blob.references -= 1;
                if !blob.stays() {
                    left = left.saturating_sub(blob.digest.size);
                }
            }
        }
        // A record all of whose blobs stay for others' sake may stay, too. Nobody but such records may keep their
        // lists.
        for row in self.rows.iter_mut().filter(|row| row.goes && row.has_refs && row.complete) {
            let blobs = &mut self.blobs;
            row.goes =
                !row.refs.iter().map(|&blob| &blobs[blob as usize]).all(|b| b.stays() || (row.derived && b.tree));
            if !row.goes {
                row.refs.iter().for_each(|&blob| blobs[blob as usize].references += 1);
            }
        }
    }

    fn count(&mut self, options: &GcOptions) {
        let report = &mut self.report;
        for blob in &self.blobs {
            let size = blob.digest.size;
            if blob.stays() {
                report.kept_blobs += 1;
                report.kept_bytes = report.kept_bytes.saturating_add(size);
                report.held_bytes = report.held_bytes.saturating_add(if blob.held { size } else { 0 });
            } else {
                report.removed_blobs += 1;
                report.removed_bytes = report.removed_bytes.saturating_add(size);
            }
        }
        report.removed_records = self.rows.iter().filter(|row| row.goes).count() as u64;
        report.kept_records = self.rows.len() as u64 - report.removed_records;
        report.lost_records = self.rows.iter().filter(|row| row.lost && !row.goes).count() as u64;
        report.over_budget = options.max_bytes.map_or(0, |limit| report.kept_bytes.saturating_sub(limit));
    }
}

/// The size of blobs. The name of a file may say anything.
fn total<'a>(blobs: impl Iterator<Item = &'a Blob>) -> u64 {
    blobs.fold(0, |sum, blob| sum.saturating_add(blob.digest.size))
}

impl GcReport {
    fn stays_after_all(&mut self, size: u64) {
        (self.removed_blobs, self.kept_blobs) = (self.removed_blobs.saturating_sub(1), self.kept_blobs + 1);
        self.removed_bytes = self.removed_bytes.saturating_sub(size);
        self.kept_bytes = self.kept_bytes.saturating_add(size);
    }
}
