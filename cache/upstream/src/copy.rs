//! Copies between a store and an upstream.

use crate::{
    Upstream, UpstreamError,
    error::Failure,
    index::{Contents, Line, Writer, identity, lines},
    upstream::Pack,
};
use std::collections::HashSet;
use tauflow_cache::{Digest, Key, Record, Recorded, Store, tree};

/// The records that are taken.
#[derive(Clone, Copy)]
pub struct Wanted<'a> {
    /// Namespaces. Records of others stay where they are.
    pub namespaces: &'a [&'a str],
    /// Whether a record that comes down has the key that its text says.
    pub sound: &'a dyn Fn(&Record) -> bool,
}

/// The counts of a [`push`], or of its dry run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pushed {
    /// Records that were sent.
    pub records: u64,
    /// Blobs that were sent, and their bytes.
    pub blobs: u64,
    /// See `blobs`.
    pub bytes: u64,
    /// Records that the upstream had already.
    pub same: u64,
    /// Records that were left out, because blobs of theirs are missing or damaged here.
    pub incomplete: u64,
    /// Records that were left out, because they came from another upstream, and blobs of theirs never did.
    pub left: u64,
    /// Records that were left out, because they may not leave their machine.
    pub bound: u64,
    /// Damage that was found in the upstream, a sentence each.
    pub notes: Vec<String>,
}

/// The counts of a [`pull`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pulled {
    /// Records that are new here.
    pub records: u64,
    /// Blobs that came, and their bytes.
    pub blobs: u64,
    /// See `blobs`.
    pub bytes: u64,
    /// Records that were here already.
    pub same: u64,
    /// Records with other outputs than those here, which stay.
    pub conflicts: u64,
    /// Records that were left out, because blobs of theirs are in no sound pack.
    pub incomplete: u64,
    /// Damage that was found, a sentence each.
    pub notes: Vec<String>,
}

/// The keys of all records of a store in these namespaces.
pub fn all<'a>(store: &Store, namespaces: &[&'a str]) -> Vec<(&'a str, Key)> {
    let of = |namespace: &&'a str| {
        let namespace = *namespace;
        store.keys_like(namespace, "").into_iter().map(move |key| (namespace, key))
    };
    namespaces.iter().flat_map(of).collect()
}

/// Copies records of a store that the upstream lacks: blobs once, each record after all that it reaches. A dry run only
/// counts.
///
/// # Errors
/// When the store cannot be read, or the upstream cannot be written. Packs that were sealed before stay, and are used.
pub fn push(
    store: &Store,
    upstream: &Upstream,
    keys: &[(&str, Key)],
    free: &dyn Fn(&Record) -> bool,
    dry_run: bool,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Pushed, UpstreamError> {
    let Contents { blobs, records, lost, notes, .. } = upstream.contents()?;
    let lost: HashSet<Digest> = lost.into_values().flatten().collect();
    let mut there: HashSet<Digest> = blobs.into_keys().collect();
    let mut pushed = Pushed { notes, ..Pushed::default() };
    let mut writer = Writer::new(upstream);
    for (n, (namespace, key)) in keys.iter().enumerate() {
        progress(n as u64, keys.len() as u64);
        let Some(record) = store.read(namespace, key) else { continue };
        let same = records.contains(&identity(&record));
        if same {
            pushed.same += 1;
            if lost.is_empty() {
                continue;
            }
        } else if !free(&record) {
            pushed.bound += 1;
            continue;
        }
        let mut complete = true;
        for digest in store.reach(&record.refs, &record.trees)? {
            if there.contains(&digest) || same && !lost.contains(&digest) {
                continue;
            }
            let Some(bytes) = store.get(&digest)? else {
                complete = false;
                continue;
            };
            there.insert(digest);
            pushed.blobs += 1;
            pushed.bytes += digest.size;
            if !dry_run {
                writer.blob(digest, bytes)?;
            }
        }
        if same {
            continue;
        }
        // The blobs of a fetched record stay where they are until they are read.
        if !complete && record.fetched {
            pushed.left += 1;
            continue;
        }
        if !complete && !record.transient {
            pushed.incomplete += 1;
            continue;
        }
        pushed.records += 1;
        if !dry_run {
            writer.record(record)?;
        }
    }
    writer.end()?;
    Ok(pushed)
}

/// Copies all records of an upstream to a store, with the blobs that the store lacks. It replaces nothing in
/// the store.
///
/// # Errors
/// When the store cannot be written, or the upstream cannot be listed. Damage in the upstream is noted.
pub fn pull(
    store: &Store,
    upstream: &Upstream,
    wanted: Wanted<'_>,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Pulled, UpstreamError> {
    let contents = upstream.contents()?;
    let mut fetch = Fetch {
        store,
        upstream,
        contents: &contents,
        pack: None,
        closed: HashSet::new(),
        good: HashSet::new(),
        bad: HashSet::new(),
        pulled: Pulled::default(),
    };
    fetch.pulled.notes.clone_from(&contents.notes);
    let mut seen = 0;
    for index in &contents.indices {
        let read = upstream.index(index).map_err(Failure::note);
        let lines = match read.and_then(|bytes| lines(upstream, index, &bytes)) {
            Ok(lines) => lines,
            Err(note) => {
                fetch.pulled.notes.push(note);
                continue;
            }
        };
        for line in lines {
            let Line::Record(record) = line else { continue };
            progress(seen, contents.records.len() as u64);
            seen += 1;
            let record = Record::from(*record);
            if wanted.namespaces.contains(&record.namespace.as_str()) {
                fetch.record(record, wanted)?;
            }
        }
    }
    let pulled = fetch.pulled;
    store.flush()?;
    Ok(pulled)
}

/// A pull that goes on.
struct Fetch<'a> {
    store: &'a Store,
    upstream: &'a Upstream,
    contents: &'a Contents,
    /// The pack that was read last, and those that cannot be opened.
    pack: Option<Pack>,
    closed: HashSet<Digest>,
    /// Blobs that are known to be here.
    good: HashSet<Digest>,
    /// Blobs that cannot be had.
    bad: HashSet<Digest>,
    pulled: Pulled,
}

impl Fetch<'_> {
    fn record(&mut self, record: Record, wanted: Wanted<'_>) -> Result<(), UpstreamError> {
        if !(wanted.sound)(&record) {
            let key = record.key.short();
            self.pulled.notes.push(format!("record {key} has a key that is not the hash of its text; it is ignored"));
            return Ok(());
        }
        let other = self.store.read(&record.namespace, &record.key).is_some_and(|here| here.payload != record.payload);
        if other {
            self.pulled.conflicts += 1;
            return Ok(());
        }
        if !self.all(&record)? && !record.transient {
            self.pulled.incomplete += 1;
            return Ok(());
        }
        match self.store.record(&record)? {
            Recorded::New => self.pulled.records += 1,
            Recorded::Same => self.pulled.same += 1,
            Recorded::Conflict { .. } => self.pulled.conflicts += 1,
        }
        Ok(())
    }

    /// Brings all blobs here that a record reaches; whether that succeeded.
    fn all(&mut self, record: &Record) -> Result<bool, UpstreamError> {
        let mut complete = true;
        for digest in &record.refs {
            complete &= self.blob(digest)?;
        }
        let mut open = record.trees.clone();
        let mut seen = HashSet::new();
        while let Some(digest) = open.pop() {
            if !seen.insert(digest) {
                continue;
            }
            if !self.blob(&digest)? {
                complete = false;
                continue;
            }
            let bytes = self.store.get(&digest)?;
            let Some(tree) = bytes.as_deref().and_then(tree::decode) else {
                complete = false;
                continue;
            };
            for digest in &tree.refs {
                complete &= self.blob(digest)?;
            }
            open.extend(tree.trees);
        }
        Ok(complete)
    }

    /// Brings a blob here, if it is not; whether it is here then.
    fn blob(&mut self, digest: &Digest) -> Result<bool, UpstreamError> {
        if self.good.contains(digest) || self.store.contains(digest) {
            self.good.insert(*digest);
            return Ok(true);
        }
        if self.bad.contains(digest) {
            return Ok(false);
        }
        let Some((pack, offset)) = self.contents.blobs.get(digest) else {
            self.bad.insert(*digest);
            return Ok(false);
        };
        if self.pack.as_ref().is_none_or(|open| open.digest != *pack) {
            // A pack that cannot be opened is noted once.
            self.pack = match self.closed.contains(pack) {
                true => None,
                false => self.upstream.pack(pack).map_err(|failed| self.pulled.notes.push(failed.note())).ok(),
            };
        }
        let Some(open) = &self.pack else {
            self.closed.insert(*pack);
            self.bad.insert(*digest);
            return Ok(false);
        };
        match self.upstream.blob(open, *offset, digest) {
            Ok(bytes) => {
                self.store.put(&bytes)?;
                self.good.insert(*digest);
                self.pulled.blobs += 1;
                self.pulled.bytes += digest.size;
                Ok(true)
            }
            Err(Failure::File(note) | Failure::Unsigned(note)) => {
                self.pulled.notes.push(note);
                self.bad.insert(*digest);
                Ok(false)
            }
            Err(Failure::Place(why)) => Err(UpstreamError::Remote { action: "read", place: self.upstream.name(), why }),
        }
    }
}
