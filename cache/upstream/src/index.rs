//! Indices: what a pack holds and where, and the records that came with it.
//!
//! An index is a text of lines, each a JSON object with one field. Its name is its digest, so a damaged or truncated
//! index is never used in part.

use crate::{Upstream, UpstreamError, upstream::Draft};
use serde::{Deserialize, Serialize};
use std::collections::{HashMap, HashSet};
use tauflow_cache::{Digest, Key, Record};

/// Most bytes of an index; longer ones are refused. One record may have as many as a log frame.
pub(crate) const MOST_INDEX: u64 = 1 << 30;
/// Bytes at which an index is sealed and another begun.
const FULL_INDEX: usize = 16 << 20;

/// A line of an index.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(crate) enum Line {
    /// The pack that the blobs below are in.
    Pack(Digest),
    /// A blob and its offset in the pack.
    Blob(Digest, u64),
    /// A record.
    Record(Box<SharedRecord>),
}

/// A [`Record`] as an index holds it.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SharedRecord {
    namespace: String,
    key: Key,
    label: String,
    preimage: String,
    payload: String,
    recipe: String,
    derived: bool,
    transient: bool,
    refs: Vec<Digest>,
    trees: Vec<Digest>,
    wall_us: u64,
    bytes: u64,
    when: u64,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    maker: String,
}

impl From<Record> for SharedRecord {
    fn from(of: Record) -> Self {
        let Record { namespace, key, label, preimage, payload, recipe, derived, transient, .. } = of;
        let Record { refs, trees, wall_us, bytes, when, maker, .. } = of;
        Self {
            namespace,
            key,
            label,
            preimage,
            payload,
            recipe,
            derived,
            transient,
            refs,
            trees,
            wall_us,
            bytes,
            when,
            maker,
        }
    }
}

impl From<SharedRecord> for Record {
    fn from(of: SharedRecord) -> Self {
        let SharedRecord { namespace, key, label, preimage, payload, recipe, derived, transient, .. } = of;
        let SharedRecord { refs, trees, wall_us, bytes, when, maker, .. } = of;
        Self {
            namespace,
            key,
            label,
            preimage,
            payload,
            recipe,
            derived,
            transient,
            refs,
            trees,
            wall_us,
            bytes,
            when,
            maker,
            fetched: true,
        }
    }
}

/// The identity of a record: equal records have equal ones.
pub(crate) fn identity(record: &Record) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    for part in [record.namespace.as_bytes(), &record.key.0, record.payload.as_bytes()] {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    *hasher.finalize().as_bytes()
}

/// The content of an upstream, as its indices list it.
#[derive(Debug, Default)]
pub struct Contents {
    /// Where blobs are: pack and offset.
    pub(crate) blobs: HashMap<Digest, (Digest, u64)>,
    /// The identities of records.
    pub(crate) records: HashSet<[u8; 32]>,
    /// The indices that are sound.
    pub(crate) indices: Vec<Digest>,
    /// The packs.
    pub(crate) packs: HashSet<Digest>,
    /// The packs that are whole, if the upstream was asked.
    standing: Option<HashSet<Digest>>,
    /// Blobs that were in packs which are missing or truncated now, and in no other one: by pack.
    pub(crate) lost: HashMap<Digest, HashSet<Digest>>,
    /// Damage that was found, a sentence each.
    pub notes: Vec<String>,
}

impl Contents {
    /// Reads all indices, and looks whether their packs are there.
    pub(crate) fn read(upstream: &Upstream) -> Result<Self, UpstreamError> {
        let mut contents = Self::default();
        let indices = upstream.indices()?;
        // A pack is there before its index is listed.
        contents.standing = upstream.packs()?;
        contents.take(upstream, &indices)?;
        let Self { blobs, lost, notes, .. } = &mut contents;
        lost.retain(|pack, of_pack| {
            of_pack.retain(|blob| !blobs.contains_key(blob));
            if !of_pack.is_empty() {
                notes.push(format!(
                    "pack `{}` is missing or truncated, and {} of its blobs are in no other pack; `cache push` on a \
                     machine that has them adds them again",
                    upstream.file(pack, "pack"),
                    of_pack.len()
                ));
            }
            !of_pack.is_empty()
        });
        notes.sort();
        // Whoever reads indices that come later meets packs that are later, too.
        contents.standing = None;
        Ok(contents)
    }

    /// Reads indices that are new since the last time.
    pub(crate) fn refresh(&mut self, upstream: &Upstream) -> Result<(), UpstreamError> {
        let mut new = upstream.indices()?;
        let known: HashSet<Digest> = self.indices.iter().copied().collect();
        new.retain(|digest| !known.contains(digest));
        self.take(upstream, &new)
    }

    fn take(&mut self, upstream: &Upstream, indices: &[Digest]) -> Result<(), UpstreamError> {
        upstream.each_index(indices, &mut |digest, read| match read.and_then(|bytes| lines(upstream, digest, &bytes)) {
            Ok(lines) => {
                self.indices.push(*digest);
                self.add(lines);
            }
            Err(note) => self.notes.push(note),
        })
    }

    fn add(&mut self, lines: Vec<Line>) {
        let mut pack = None;
        for line in lines {
            match line {
                Line::Pack(digest) => {
                    let stands = self.standing.as_ref().is_none_or(|standing| standing.contains(&digest));
                    pack = Some((digest, stands));
                    if stands {
                        self.packs.insert(digest);
                    }
                }
                Line::Blob(digest, offset) => match pack {
                    Some((pack, true)) => drop(self.blobs.entry(digest).or_insert((pack, offset))),
                    Some((pack, false)) => drop(self.lost.entry(pack).or_default().insert(digest)),
                    None => {}
                },
                Line::Record(record) => drop(self.records.insert(identity(&Record::from(*record)))),
            }
        }
    }

    /// Number of distinct blobs.
    pub fn blobs(&self) -> usize {
        self.blobs.len()
    }

    /// Number of distinct records.
    pub fn records(&self) -> usize {
        self.records.len()
    }

    /// Number of indices and of packs.
    pub fn files(&self) -> (usize, usize) {
        (self.indices.len(), self.packs.len())
    }

    /// Bytes of the packs.
    pub fn bytes(&self) -> u64 {
        self.packs.iter().fold(0, |sum, pack| sum.saturating_add(pack.size))
    }
}

/// The lines of an index, or why it is not used.
pub(crate) fn lines(upstream: &Upstream, digest: &Digest, bytes: &[u8]) -> Result<Vec<Line>, String> {
    let parse = |line: &[u8]| serde_json::from_slice(line);
    let all: Result<Vec<Line>, _> =
        bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()).map(parse).collect();
    all.map_err(|error| {
        let path = upstream.file(digest, "index");
        format!("index `{path}` has a line that this version cannot read ({error}); it is ignored")
    })
}

/// Writes packs and their indices.
pub(crate) struct Writer<'a> {
    upstream: &'a Upstream,
    pack: Option<(Draft, blake3::Hasher)>,
    /// Bytes in the pack.
    end: u64,
    blobs: Vec<Line>,
    /// Lines of records.
    records: Vec<u8>,
    /// The indices that were written.
    written: Vec<Digest>,
}

impl<'a> Writer<'a> {
    pub fn new(upstream: &'a Upstream) -> Self {
        Self { upstream, pack: None, end: 0, blobs: Vec::new(), records: Vec::new(), written: Vec::new() }
    }

    pub fn blob(&mut self, digest: Digest, bytes: Vec<u8>) -> Result<(), UpstreamError> {
        if self.pack.is_none() {
            self.pack = Some((self.upstream.draft()?, blake3::Hasher::new()));
        }
        let Some((draft, hasher)) = &mut self.pack else { return Ok(()) }; // set right above
        hasher.update(&bytes);
        self.blobs.push(Line::Blob(digest, self.end));
        self.end += bytes.len() as u64;
        draft.add(bytes)?;
        if self.end >= self.upstream.full_pack() { self.seal() } else { Ok(()) }
    }

    /// Adds a record, after its blobs.
    pub fn record(&mut self, record: Record) -> Result<(), UpstreamError> {
        put(&mut self.records, &Line::Record(Box::new(record.into())));
        if self.records.len() >= FULL_INDEX { self.seal() } else { Ok(()) }
    }

    /// Seals the rest, and adds what was written to the list of indices.
    pub fn end(mut self) -> Result<(), UpstreamError> {
        self.seal()?;
        if self.written.is_empty() { Ok(()) } else { self.upstream.list(&self.written) }
    }

    /// Makes what was written visible: the pack first, then the index that names it.
    fn seal(&mut self) -> Result<(), UpstreamError> {
        let mut index = Vec::new();
        if let Some((draft, hasher)) = self.pack.take() {
            let digest = Digest { hash: *hasher.finalize().as_bytes(), size: self.end };
            self.upstream.seal(draft, &digest, "pack")?;
            put(&mut index, &Line::Pack(digest));
        }
        self.end = 0;
        self.blobs.drain(..).for_each(|line| put(&mut index, &line));
        index.append(&mut self.records);
        if index.is_empty() {
            return Ok(());
        }
        self.written.push(self.upstream.seal_index(index)?);
        Ok(())
    }
}

fn put(index: &mut Vec<u8>, line: &Line) {
    serde_json::to_writer(&mut *index, line).expect("texts and numbers always serialise to memory");
    index.push(b'\n');
}
