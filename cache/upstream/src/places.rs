//! The places of an upstream's records and blobs, from its indices. The text of the records is in a temporary file.

use crate::{
    Upstream, UpstreamError,
    error::{At, Failure},
    index::{Line, lines},
    upstream::Pack,
};
use std::{
    collections::{HashMap, HashSet},
    env,
    fs::File,
    os::unix::fs::FileExt,
    sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard},
};
use tauflow_cache::{Digest, Key, Record};

/// Packs that are kept open.
const MOST_OPEN: usize = 64;

/// An index is read so often, once for each listing, before it is given up.
const MOST_TRIES: u32 = 3;

/// A place in a pack: the pack's number, and the offset.
type BlobAt = (u32, u64);

/// The places of an upstream's records and blobs.
pub(crate) struct Places {
    pub upstream: Upstream,
    /// The lines of records.
    spool: File,
    listed: RwLock<Listed>,
    use_of: Mutex<Use>,
}

/// The contents that indices list.
#[derive(Default)]
struct Listed {
    /// Offset and length of each record in the spool, and when it was made. If indices have several records for a key,
    /// the latest one counts.
    records: HashMap<(u8, Key), (u64, u32, u64)>,
    blobs: HashMap<Digest, BlobAt>,
    /// Further places of blobs that two machines pushed.
    more: HashMap<Digest, Vec<BlobAt>>,
    packs: Vec<Digest>,
    /// The numbers of the packs.
    numbers: HashMap<Digest, u32>,
    /// Bytes in the spool.
    end: u64,
    /// The indices that were read, and those that could not be read several times.
    indices: HashSet<Digest>,
    /// How often each other index could not be read.
    failed: HashMap<Digest, u32>,
}

/// Open packs, and errors so far.
#[derive(Default)]
pub(crate) struct Use {
    /// Open packs; none for one that cannot be opened.
    open: HashMap<u32, Option<Arc<Pack>>>,
    /// Packs with damage that was told.
    pub told: HashSet<u32>,
    /// Blobs that cannot be had.
    pub bad: HashSet<Digest>,
}

impl Listed {
    /// Notes that an index could not be read, which a file system of a network may do once. The first time is told.
    fn could_not_read(&mut self, index: Digest, note: &str, tell: &dyn Fn(&str)) {
        let failed = self.failed.entry(index).or_default();
        *failed += 1;
        if *failed == 1 {
            tell(note);
        }
        if *failed == MOST_TRIES {
            self.indices.insert(index);
        }
    }

    /// Adds the lines of an index; the texts of its records are appended to `texts`, which stand at the end.
    fn add(&mut self, lines: Vec<Line>, namespaces: &[&str], texts: &mut Vec<u8>) {
        let mut pack = None;
        for line in lines {
            match line {
                Line::Pack(digest) => {
                    let next = self.packs.len() as u32;
                    let number = *self.numbers.entry(digest).or_insert(next);
                    if number == next {
                        self.packs.push(digest);
                    }
                    pack = Some(number);
                }
                Line::Blob(digest, offset) => {
                    let Some(pack) = pack else { continue };
                    match self.blobs.get(&digest) {
                        None => drop(self.blobs.insert(digest, (pack, offset))),
                        Some(known) if *known != (pack, offset) => {
                            self.more.entry(digest).or_default().push((pack, offset));
                        }
                        Some(_) => {}
                    }
                }
                Line::Record(record) => {
                    let record = Record::from(*record);
                    let Some(number) = namespaces.iter().position(|known| *known == record.namespace) else {
                        continue;
                    };
                    let slot = (number as u8, record.key);
                    let when = record.when;
                    if self.records.get(&slot).is_some_and(|(.., known)| *known >= when) {
                        continue;
                    }
                    let text = serde_json::to_vec(&Line::Record(Box::new(record.into())));
                    let text = text.expect("texts and numbers always serialise to memory");
                    texts.extend_from_slice(&text);
                    self.records.insert(slot, (self.end, text.len() as u32, when)); // an index has less than 4 GiB
                    self.end += text.len() as u64;
                }
            }
        }
    }
}

impl Places {
    /// Reads all indices.
    ///
    /// # Errors
    /// When the upstream fails, or no temporary file can be written. Damage is told.
    pub fn read(upstream: Upstream, namespaces: &[&str], tell: &dyn Fn(&str)) -> Result<Self, UpstreamError> {
        let spool = tempfile::tempfile().at("write to", &env::temp_dir())?;
        let places = Self { upstream, spool, listed: RwLock::default(), use_of: Mutex::default() };
        places.refresh(namespaces, tell)?;
        Ok(places)
    }

    /// Reads indices that are new since they were listed last.
    ///
    /// # Errors
    /// As [`Places::read`].
    pub fn refresh(&self, namespaces: &[&str], tell: &dyn Fn(&str)) -> Result<(), UpstreamError> {
        let folder = env::temp_dir();
        let mut new = self.upstream.indices()?;
        let mut listed = self.listed.write().unwrap_or_else(PoisonError::into_inner);
        new.retain(|index| !listed.indices.contains(index));
        let mut written = Ok(());
        self.upstream.each_index(&new, &mut |index, read| {
            let Ok(bytes) = read.inspect_err(|note| listed.could_not_read(*index, note, tell)) else { return };
            listed.indices.insert(*index);
            match lines(&self.upstream, index, &bytes) {
                Ok(lines) if written.is_ok() => {
                    let mut texts = Vec::new();
                    let start = listed.end;
                    listed.add(lines, namespaces, &mut texts);
                    written = self.spool.write_all_at(&texts, start);
                }
                Ok(_) => {}
                Err(note) => tell(&note),
            }
        })?;
        written.at("write to", &folder)?;
        drop(listed);
        // A blob that could not be had may be in a new pack.
        if !new.is_empty() {
            self.used().bad.clear();
        }
        Ok(())
    }

    /// Packs that could not be opened and blobs that could not be had may be there now.
    pub fn try_again(&self) {
        let mut used = self.used();
        used.bad.clear();
        used.open.retain(|_, pack| pack.is_some());
    }

    fn listed(&self) -> RwLockReadGuard<'_, Listed> {
        self.listed.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// The places of a blob: pack and offset.
    pub fn of_blob(&self, digest: &Digest) -> Vec<BlobAt> {
        let listed = self.listed();
        let more = listed.more.get(digest).into_iter().flatten();
        listed.blobs.get(digest).into_iter().chain(more).copied().collect()
    }

    /// Whether a blob has a place.
    pub fn knows(&self, digest: &Digest) -> bool {
        self.listed().blobs.contains_key(digest)
    }

    pub fn used(&self) -> MutexGuard<'_, Use> {
        self.use_of.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn record(&self, namespace: u8, key: &Key) -> Option<Record> {
        let (offset, len, _) = self.listed().records.get(&(namespace, *key)).copied()?;
        let mut text = vec![0; len as usize];
        self.spool.read_exact_at(&mut text, offset).ok()?;
        match serde_json::from_slice(&text).ok()? {
            Line::Record(record) => Some(Record::from(*record)),
            Line::Pack(_) | Line::Blob(..) => None,
        }
    }

    /// The keys of the records of a namespace, sorted.
    pub fn keys(&self, namespace: u8) -> Vec<Key> {
        let listed = self.listed();
        let mut keys: Vec<Key> = listed.records.keys().filter(|slot| slot.0 == namespace).map(|slot| slot.1).collect();
        keys.sort_unstable();
        keys
    }

    /// A blob of a pack; none if the pack could not be opened before.
    pub fn read_blob(&self, number: u32, offset: u64, digest: &Digest) -> Result<Option<Vec<u8>>, Failure> {
        let pack = self.pack(number)?;
        pack.map(|pack| self.upstream.blob(&pack, offset, digest)).transpose()
    }

    /// An open pack, or none if it could not be opened before; the note of the first time.
    fn pack(&self, number: u32) -> Result<Option<Arc<Pack>>, Failure> {
        if let Some(known) = self.used().open.get(&number) {
            return Ok(known.clone());
        }
        let opened = self.upstream.pack(&self.listed().packs[number as usize]).map(Arc::new);
        let mut used = self.used();
        if used.open.len() >= MOST_OPEN {
            // Packs that cannot be opened are kept, so that nobody tries again.
            used.open.retain(|_, pack| pack.is_none());
        }
        // Another thread may have opened it meanwhile, and counts its reads.
        let pack = used.open.entry(number).or_insert_with(|| opened.as_ref().ok().cloned()).clone();
        drop(used);
        opened.map(|_| pack)
    }
}
