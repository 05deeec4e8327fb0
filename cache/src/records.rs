//! Records: written once, found by key, never silently changed.

use crate::{
    CacheError, Digest, Key, Record, Recorded, Store,
    commit::due,
    error::At,
    index::{Index, RecordAt, Slot},
    lease::Use,
    network,
    record::{Head, decode, encode, sum},
    segment::{Appender, MAX_BODY, RECORD_HEADER, Sort, read_record, record_frame},
    store::lock,
    tree,
};
use std::{
    collections::{HashMap, HashSet},
    fs,
    sync::Arc,
    time::Instant,
};

impl Store {
    /// Writes a record, after the blobs it names were `put`. It is visible to everybody when this returns, survives the
    /// death of the process, and is durable (with its blobs) when the next commit returns: at most a second and a few
    /// hundred records later, or at once by [`flush`](Self::flush).
    ///
    /// # Errors
    /// When it cannot be written. The log is then as it was before.
    pub fn record(&self, record: &Record) -> Result<Recorded, CacheError> {
        let mut log = lock(&self.log);
        // It is read even if its sum is the same: it may have been damaged since its segment's index file was written.
        let known = self.read_record_of(&record.namespace, &record.key);
        if let Some((slot, at, _)) = known {
            let same = at.sum == sum(record.payload.as_bytes());
            if same && !self.index().is_provisional(&slot, &at) {
                return Ok(Recorded::Same);
            }
            if same {
                // Another's that died before its commit: one of this store's own is durable with its blobs.
                self.append(&mut log, record)?;
                drop(log);
                self.commit_if_due()?;
                return Ok(Recorded::Same);
            }
            if let Some(existing) = self.find(&record.namespace, &record.key, false) {
                return Ok(Recorded::Conflict { existing: Box::new((*existing).clone()) });
            }
            // Its blobs are damaged: it is no record any more.
        }
        self.append(&mut log, record)?;
        drop(log);
        self.commit_if_due()?;
        Ok(Recorded::New)
    }

    /// Writes a record in place of the one that has its key: for an action that had to run again because its blobs are
    /// gone, and gave something else.
    ///
    /// # Errors
    /// When it cannot be written. The earlier record then stays.
    pub fn replace(&self, record: &Record) -> Result<(), CacheError> {
        self.refresh()?;
        let mut log = lock(&self.log);
        self.append(&mut log, record)?;
        drop(log);
        self.commit_if_due()
    }

    /// The record of a key, whether or not its blobs are there. While this store lives, no gc takes the record or its
    /// blobs away. A record that is not here, but [beyond](Self::look_beyond), is copied.
    pub fn lookup(&self, namespace: &str, key: &Key) -> Option<Arc<Record>> {
        let mut found = [self.find(namespace, key, false)];
        self.records_beyond(namespace, &[*key], &mut found);
        let [found] = found;
        found
    }

    /// The record of a key, if this store itself has it and every blob it reaches (by presence and size; only reading
    /// proves content).
    pub fn lookup_full(&self, namespace: &str, key: &Key) -> Option<Arc<Record>> {
        self.find(namespace, key, true)
    }

    /// The keys of a namespace whose text begins like this, sorted.
    pub fn keys_like(&self, namespace: &str, start: &str) -> Vec<Key> {
        let index = self.index();
        let Some(namespace) = index.number_of(namespace) else { return Vec::new() };
        let of = index.records.keys().filter(|slot| slot.0 == namespace).map(|slot| slot.1);
        let mut found: Vec<Key> = of.filter(|key| start.is_empty() || key.hex().starts_with(start)).collect();
        found.sort_unstable();
        found
    }

    /// The keys of a label's records, oldest first.
    pub fn keys_by_label(&self, namespace: &str, label: &str) -> Vec<Key> {
        let index = self.index();
        let (Some(namespace), Some(label)) = (index.number_of(namespace), index.number_of(label)) else {
            return Vec::new();
        };
        let of_label =
            |(slot, at): (&Slot, &RecordAt)| (slot.0 == namespace && at.label == label).then_some((at.when, slot.1));
        let mut found: Vec<(u64, Key)> = index.records.iter().filter_map(of_label).collect();
        found.sort_unstable();
        found.into_iter().map(|(_, key)| key).collect()
    }

    /// The record of a key, as [`lookup`](Self::lookup) gives it. It leaves no trace of use, and nothing keeps the
    /// record.
    pub fn read(&self, namespace: &str, key: &Key) -> Option<Record> {
        self.read_record_of(namespace, key).map(|(_, _, record)| record)
    }

    /// All records of a label, oldest first. They are in memory at once; [`keys_by_label`](Self::keys_by_label) and
    /// [`read`](Self::read) take one at a time.
    pub fn by_label(&self, namespace: &str, label: &str) -> Vec<Record> {
        self.keys_by_label(namespace, label).iter().filter_map(|key| self.read(namespace, key)).collect()
    }

    /// Like [`lookup`](Self::lookup), of many keys at once, which costs less.
    pub fn lookup_many(&self, namespace: &str, keys: &[Key]) -> Vec<Option<Arc<Record>>> {
        let missed = {
            let index = self.index();
            keys.iter().any(|key| index.record(namespace, key).is_none())
        };
        if missed {
            self.refresh_on_miss();
        }
        let uses: Vec<Use> = {
            let index = self.index();
            keys.iter().filter_map(|key| foreign_use(&index, namespace, key)).collect()
        };
        // Noted first, looked at afterwards (see `lease`). Protection fails only with a full disk; the hits stand.
        let _ = self.note(uses);
        let mut found: Vec<Option<Arc<Record>>> =
            keys.iter().map(|key| self.read_noted(namespace, key, false)).collect();
        self.records_beyond(namespace, keys, &mut found);
        found
    }

    fn find(&self, namespace: &str, key: &Key, full: bool) -> Option<Arc<Record>> {
        let known = self.index().record(namespace, key).is_some();
        if !known && !self.refresh_on_miss() {
            return None;
        }
        let used = foreign_use(&self.index(), namespace, key);
        let _ = self.note(used); // as above
        self.read_noted(namespace, key, full)
    }

    /// The record of a key whose use has been noted.
    fn read_noted(&self, namespace: &str, key: &Key, full: bool) -> Option<Arc<Record>> {
        let (slot, at, record) = self.read_record_of(namespace, key)?;
        if full && !self.all_here(&record.refs) {
            return None;
        }
        let provisional = self.index().is_provisional(&slot, &at);
        if provisional {
            // Reading a damaged blob quarantines it, and then it is no longer here.
            let good = |digest: &Digest| !self.is_here(digest) || matches!(self.get(digest), Ok(Some(_)));
            // Summaries of other records are not worth the proof. The leaves of a tree are verified when they are read,
            // as always.
            if record.derived {
                return None;
            }
            let mut proven = true;
            let (mut trees, mut reached) = (Vec::new(), record.refs.clone());
            let (mut read, mut found) = (|tree: &Digest| self.get(tree), |digest: &Digest| reached.push(*digest));
            tree::walk(&record.trees, &mut HashSet::new(), &mut read, &mut found, &mut trees).ok()?;
            for digest in record.refs.iter().chain(&trees) {
                proven &= good(digest);
            }
            if !proven {
                return None;
            }
            // Its writer may have died before they were durable. Records that build on it must not be marked as whole
            // until they are.
            self.rely_on(reached);
            let end = at.offset + RECORD_HEADER + u64::from(at.len);
            lock(&self.relied).logs.entry(at.segment).and_modify(|to| *to = end.max(*to)).or_insert(end);
            self.index_mut().proven.insert(slot);
        }
        Some(Arc::new(record))
    }

    fn read_record_of(&self, namespace: &str, key: &Key) -> Option<(Slot, RecordAt, Record)> {
        for _ in 0..2 {
            let (slot, at) = self.index().record(namespace, key)?;
            match self.segment_file(at.segment).and_then(|file| read_record(&file, at.offset, at.len)) {
                Ok(Some(frame)) => {
                    let record = decode(frame.bytes())?;
                    return (record.key == *key && record.namespace == namespace).then_some((slot, at, record));
                }
                Err(error) if network::is_gone(&error) => {
                    self.forget_file(at.segment);
                    self.refresh().ok()?;
                }
                _ => {
                    // Damaged since it was indexed.
                    self.index_mut().mark_damaged(&slot);
                    return None;
                }
            }
        }
        None
    }

    /// Whether all blobs are there, looking at the disk and not only at the index.
    fn all_here(&self, refs: &[Digest]) -> bool {
        let mut packs: HashMap<u32, bool> = HashMap::new();
        refs.iter().all(|digest| match self.packed_at(digest) {
            Some(at) => {
                let on_disk = *packs.entry(at.segment).or_insert_with(|| {
                    let path = self.index().segments[at.segment as usize].path.clone();
                    fs::metadata(path).is_ok()
                });
                on_disk || (self.refresh().is_ok() && self.is_here(digest))
            }
            None => self.is_loose(digest) || self.is_here(digest),
        })
    }

    /// Appends a record that takes the place of all earlier ones of its key.
    fn append(&self, log: &mut crate::store::LogWriter, record: &Record) -> Result<(), CacheError> {
        self.writes()?;
        if log.appender.as_ref().is_some_and(|to| self.is_gone(to)) {
            log.appender = None; // somebody removed the file under us
        }
        if log.appender.is_none() {
            log.appender = Some(self.start_segment(Sort::Log)?);
        }
        let Some(to) = log.appender.as_mut() else { return Ok(()) }; // set right above
        let generation = self.index().next_generation(&record.namespace, &record.key);
        let head = Head::of(record, generation, to.seq);
        let bytes = encode(&head, record);
        if bytes.len() as u64 >= MAX_BODY {
            return Err(CacheError::RecordTooLarge { key: record.key, bytes: bytes.len() as u64, limit: MAX_BODY });
        }
        let len = bytes.len() as u32 + 1; // below MAX_BODY
        let offset = append_frame(log, &record_frame(&bytes))?;
        let Some(Appender { segment, end, .. }) = &log.appender else { return Ok(()) }; // a success keeps it
        let mut index = self.index_mut();
        index.segments[*segment as usize].scanned = *end;
        index.insert_record(&head, *segment, offset, len);
        drop(index);
        log.pending += 1;
        log.since.get_or_insert_with(Instant::now);
        Ok(())
    }

    fn commit_if_due(&self) -> Result<(), CacheError> {
        if due(&lock(&self.log)) { self.flush() } else { Ok(()) }
    }
}

/// The note of a record's use, if the record is in a segment of a different store instance.
fn foreign_use(index: &Index, namespace: &str, key: &Key) -> Option<Use> {
    let (slot, at) = index.record(namespace, key)?;
    let own = index.segments[at.segment as usize].is_own();
    (!own).then(|| Use::Record { namespace: index.name(slot.0).clone(), key: *key })
}

/// Appends to the log; after an error that spoiled the segment, the next append begins another.
pub(crate) fn append_frame(log: &mut crate::store::LogWriter, frame: &[u8]) -> Result<u64, CacheError> {
    let Some(to) = log.appender.as_mut() else { return Ok(0) }; // callers have one
    match to.append(frame) {
        Ok(offset) => Ok(offset),
        Err((error, spoiled)) => {
            let path = to.path.clone();
            if spoiled {
                log.appender = None;
            }
            Err(error).at("write a record to", &path)
        }
    }
}
