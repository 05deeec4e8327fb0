//! The index in memory: the position of each packed blob and each record.
//!
//! Rebuilt from the segments when a store opens, and brought up to date with what other processes append. Holds no
//! content.
//!
//! The order in which segments are read does not matter. If two records have the same key, the higher generation is
//! used, then the older one; at the highest generation, the later one. If a blob has two copies, the one in the later
//! segment is used, because it was written after the earlier one was found damaged.

use crate::{
    CacheError, Key,
    codec::Fields,
    error::At,
    hashed::HashedMap,
    layout::{Layout, names},
    lease, network, quarantine,
    record::{Head, MOST_GENERATION, after},
    segment::{LogEntry, PackedBlob, Sort, scan_log, scan_pack},
    sidecar,
};
use std::{
    cmp::Reverse,
    collections::{BTreeSet, HashMap, HashSet, hash_map::Entry},
    fs, io,
    path::{Path, PathBuf},
    sync::Arc,
};

/// Frames in a sealed segment from which an index file is worth its while.
const SIDECAR_FROM: u64 = 2048;

/// A segment that the index knows.
#[derive(Debug)]
pub(crate) struct Segment {
    pub sort: Sort,
    pub name: String,
    pub path: PathBuf,
    pub seq: u64,
    pub owner: String,
    /// Offset up to which the index has read.
    pub scanned: u64,
    /// Offset before which the records' blobs were durable when written.
    pub committed: u64,
    /// This store instance writes it.
    pub own: bool,
    /// Its owner is dead and all of it is read.
    pub sealed: bool,
    /// The file is gone: a gc moved what is left elsewhere.
    pub gone: bool,
    /// Damaged frames passed over.
    pub damaged: u64,
}

/// Where a packed blob lies.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlobAt {
    pub segment: u32,
    pub offset: u64,
    pub size: u64,
}

/// Where a record lies, and what statistics need of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RecordAt {
    pub segment: u32,
    pub offset: u64,
    /// Length of the body of its frame.
    pub len: u32,
    pub generation: u32,
    pub origin: u64,
    pub sum: u64,
    pub label: u32,
    pub wall_us: u64,
    pub bytes: u64,
    pub when: u64,
}

/// Namespace (by its number among the names) and key.
pub(crate) type Slot = (u32, Key);

impl Segment {
    /// Whether this store instance writes it; no gc touches those.
    pub fn is_own(&self) -> bool {
        self.own && !self.gone
    }
}

#[derive(Debug, Default)]
pub(crate) struct Index {
    pub segments: Vec<Segment>,
    by_name: HashMap<String, u32>,
    pub blobs: HashedMap<[u8; 32], BlobAt>,
    pub records: HashedMap<Slot, RecordAt>,
    names: Vec<Arc<str>>,
    name_numbers: HashMap<Arc<str>, u32>,
    /// Uncommitted records of other store instances whose blobs were rehashed.
    pub proven: HashSet<Slot>,
    /// Places in packs whose blob is damaged.
    bad: HashSet<(String, u64)>,
    /// Generations of records that were found damaged.
    damaged: HashMap<Slot, u32>,
    /// Keys for which records of one generation with different payloads were found.
    pub conflicts: BTreeSet<(Arc<str>, Key)>,
}

impl Index {
    pub fn name(&self, number: u32) -> &Arc<str> {
        &self.names[number as usize]
    }

    pub fn number_of(&self, name: &str) -> Option<u32> {
        self.name_numbers.get(name).copied()
    }

    pub fn intern(&mut self, name: &str) -> u32 {
        if let Some(number) = self.number_of(name) {
            return number;
        }
        let (name, number): (Arc<str>, _) = (name.into(), self.names.len() as u32);
        self.names.push(name.clone());
        self.name_numbers.insert(name, number);
        number
    }

    pub fn record(&self, namespace: &str, key: &Key) -> Option<(Slot, RecordAt)> {
        let slot = (self.number_of(namespace)?, *key);
        self.records.get(&slot).map(|at| (slot, *at))
    }

    /// Whether a record may be there without its blobs: no commit mark covers it, and nobody has looked.
    pub fn is_provisional(&self, slot: &Slot, at: &RecordAt) -> bool {
        let segment = &self.segments[at.segment as usize];
        !segment.own && at.offset >= segment.committed && !self.proven.contains(slot)
    }

    /// The generation of a record that takes the place of all that this index has, and of those that it had before it
    /// found them damaged.
    pub fn next_generation(&self, namespace: &str, key: &Key) -> u32 {
        let Some(namespace) = self.number_of(namespace) else { return 0 };
        let slot = (namespace, *key);
        let known = self.records.get(&slot).map(|at| at.generation);
        known.max(self.damaged.get(&slot).copied()).map_or(0, after)
    }

    /// Highest sequence number of the segments of a sort.
    pub fn last_seq(&self, sort: Sort) -> u64 {
        self.segments.iter().filter(|segment| segment.sort == sort).map(|segment| segment.seq).max().unwrap_or(0)
    }

    /// Adds a segment that this store instance is about to write.
    pub fn add_own(&mut self, sort: Sort, name: String, path: PathBuf) -> u32 {
        let number = self.add(sort, name, path);
        let segment = &mut self.segments[number as usize];
        (segment.own, segment.committed) = (true, 0);
        number
    }

    fn add(&mut self, sort: Sort, name: String, path: PathBuf) -> u32 {
        let number = self.segments.len() as u32;
        let (seq, owner) = sort.parse(&name).unwrap_or_default(); // callers give names of this sort
        let owner = owner.to_owned();
        self.by_name.insert(name.clone(), number);
        self.segments.push(Segment {
            sort,
            name,
            path,
            seq,
            owner,
            scanned: 0,
            committed: 0,
            own: false,
            sealed: false,
            gone: false,
            damaged: 0,
        });
        number
    }

    pub fn insert_blob(&mut self, hash: [u8; 32], at: BlobAt) {
        let place = |at: &BlobAt| {
            let segment = &self.segments[at.segment as usize];
            (!segment.gone, segment.seq, segment.name.clone(), at.offset)
        };
        if !self.bad.is_empty() && self.bad.contains(&(self.segments[at.segment as usize].name.clone(), at.offset)) {
            return;
        }
        match self.blobs.entry(hash) {
            Entry::Vacant(free) => {
                free.insert(at);
            }
            Entry::Occupied(mut known) => {
                if place(known.get()) < place(&at) {
                    known.insert(at);
                }
            }
        }
    }

    pub fn insert_record(&mut self, head: &Head<'_>, segment: u32, offset: u64, len: u32) {
        let slot = (self.intern(head.namespace), head.key);
        let at = RecordAt {
            segment,
            offset,
            len,
            generation: head.generation,
            origin: head.origin,
            sum: head.sum,
            label: self.intern(head.label),
            wall_us: head.wall_us,
            bytes: head.bytes,
            when: head.when,
        };
        self.insert_record_at(slot, at);
    }

    pub fn insert_record_at(&mut self, slot: Slot, at: RecordAt) {
        // One look-up: opening a store of many records is little else.
        match self.records.entry(slot) {
            Entry::Vacant(free) => {
                free.insert(at);
            }
            Entry::Occupied(mut entry) => {
                let known = entry.get();
                if known.generation == at.generation && known.sum != at.sum {
                    self.conflicts.insert((self.names[slot.0 as usize].clone(), slot.1));
                }
                let rank = |at: &RecordAt| {
                    let segment = &self.segments[at.segment as usize];
                    // Nothing supersedes the highest generation, which no record comes by honestly: the later one wins.
                    let last = (at.generation == MOST_GENERATION).then_some((segment.seq, at.offset));
                    (!segment.gone, at.generation, last, Reverse(at.origin), at.sum)
                };
                if rank(known) >= rank(&at) {
                    return;
                }
                entry.insert(at);
            }
        }
        if !self.proven.is_empty() {
            self.proven.remove(&slot);
        }
    }

    /// Forgets a place in a pack whose blob is damaged.
    pub fn mark_bad(&mut self, hash: &[u8; 32], at: BlobAt) {
        let name = self.segments[at.segment as usize].name.clone();
        self.bad.insert((name, at.offset));
        if self.blobs.get(hash).is_some_and(|known| (known.segment, known.offset) == (at.segment, at.offset)) {
            self.blobs.remove(hash);
        }
    }

    /// Forgets a record whose frame is damaged, but not its generation: its segment's index file may list it the next
    /// time, and it must not win against the record that took its place.
    pub fn mark_damaged(&mut self, slot: &Slot) {
        let Some(at) = self.records.remove(slot) else { return };
        self.segments[at.segment as usize].damaged += 1;
        let highest = self.damaged.entry(*slot).or_default();
        *highest = at.generation.max(*highest);
    }

    /// Reads what is new on disk. Logs first: a record's blobs were written before it.
    pub fn refresh(&mut self, layout: &Layout) -> Result<(), CacheError> {
        let bad = quarantine::places(layout).at("list", &layout.folder("quarantine"))?;
        if bad.iter().any(|place| !self.bad.contains(place)) {
            self.bad.extend(bad);
            let (segments, bad) = (&self.segments, &self.bad);
            self.blobs.retain(|_, at| !bad.contains(&(segments[at.segment as usize].name.clone(), at.offset)));
        }
        self.refresh_sort(layout, Sort::Log)?;
        self.refresh_sort(layout, Sort::Pack)
    }

    fn refresh_sort(&mut self, layout: &Layout, sort: Sort) -> Result<(), CacheError> {
        let folder = layout.folder(sort.folder());
        let mut listed = names(&folder).at("list", &folder)?;
        if self.mark_gone(sort, &listed) {
            // The list may be older than the segment that replaced those; this one is not.
            listed = names(&folder).at("list", &folder)?;
            self.forget_gone();
        }
        for name in listed {
            if sort.parse(&name).is_none() {
                continue;
            }
            let number = match self.by_name.get(&name) {
                Some(&number) => number,
                None => {
                    let path = folder.join(&name);
                    let number = self.add(sort, name, path);
                    sidecar::load(self, number);
                    number
                }
            };
            let segment = &self.segments[number as usize];
            if !(segment.own || segment.sealed) {
                self.read_on(layout, number)?;
            }
        }
        Ok(())
    }

    fn mark_gone(&mut self, sort: Sort, listed: &[String]) -> bool {
        let mut any = false;
        for segment in self.segments.iter_mut().filter(|segment| segment.sort == sort && !segment.gone) {
            if listed.binary_search(&segment.name).is_err() {
                segment.gone = true;
                any = true;
                self.by_name.remove(&segment.name);
            }
        }
        any
    }

    fn forget_gone(&mut self) {
        let segments = &self.segments;
        self.blobs.retain(|_, at| !segments[at.segment as usize].gone);
        self.records.retain(|_, at| !segments[at.segment as usize].gone);
    }

    fn read_on(&mut self, layout: &Layout, number: u32) -> Result<(), CacheError> {
        let segment = &self.segments[number as usize];
        let (path, from, sort) = (segment.path.clone(), segment.scanned, segment.sort);
        // Asked before the length is read: a dead owner appends no more.
        let dead = !lease::is_live(&layout.lease(&segment.owner));
        let gone = network::is_gone; // the next refresh sees it gone
        let len = match fs::symlink_metadata(&path) {
            Ok(meta) => meta.len(),
            Err(error) if gone(&error) => return Ok(()),
            Err(error) => return Err(error).at("look at the segment", &path),
        };
        let mut frames = 0;
        if len > from {
            let scanned = match sort {
                Sort::Pack => self.read_pack(number, &path, from, dead, &mut frames),
                Sort::Log => self.read_log(number, &path, from, dead, &mut frames),
            };
            match scanned {
                Err(error) if gone(&error) => return Ok(()),
                other => other.at("read the segment", &path)?,
            }
        }
        self.segments[number as usize].sealed = dead;
        if dead && frames >= SIDECAR_FROM {
            sidecar::save(self, number, layout);
        }
        Ok(())
    }

    fn read_pack(&mut self, number: u32, path: &Path, from: u64, dead: bool, frames: &mut u64) -> io::Result<()> {
        let scan = scan_pack(path, from, dead, |PackedBlob { hash, size, offset }| {
            *frames += 1;
            self.insert_blob(hash, BlobAt { segment: number, offset, size });
        })?;
        let segment = &mut self.segments[number as usize];
        segment.scanned = scan.end;
        segment.damaged += scan.damaged;
        Ok(())
    }

    fn read_log(&mut self, number: u32, path: &Path, from: u64, dead: bool, frames: &mut u64) -> io::Result<()> {
        let mut malformed = 0;
        let scan = scan_log(path, from, dead, |offset, entry| match entry {
            LogEntry::Record(bytes) => match Head::decode(&mut Fields(bytes)) {
                Some(head) => {
                    *frames += 1;
                    // The body is the record and a byte before it that says so; its length was read from 32 bits.
                    self.insert_record(&head, number, offset, bytes.len() as u32 + 1);
                }
                None => malformed += 1,
            },
            LogEntry::Commit(covered) => {
                let segment = &mut self.segments[number as usize];
                segment.committed = segment.committed.max(covered.min(offset));
            }
        })?;
        let segment = &mut self.segments[number as usize];
        segment.scanned = scan.end;
        segment.damaged += scan.damaged + malformed;
        Ok(())
    }
}
