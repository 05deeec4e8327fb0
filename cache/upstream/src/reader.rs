//! An upstream as a store asks it: for many keys at once, and for single blobs.
//!
//! The indices are read once, at the first question. Places of blobs and records stay in memory, and the text of the
//! records in an unnamed temporary file, so that a look-up of thousands of keys reads nothing of the upstream.

use crate::{
    Upstream, UpstreamError,
    folder::Pack,
    index::{Line, lines},
};
use std::{
    collections::{HashMap, HashSet},
    fmt,
    fs::File,
    io::{self, BufWriter, Write},
    os::unix::fs::FileExt,
    sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError},
};
use tauflow_cache::{Beyond, Digest, Key, Record};

/// Opens an upstream, when it is first asked.
pub type Opening = dyn Fn() -> Result<Upstream, UpstreamError> + Send + Sync;
/// Hears notes: what failed, a sentence each.
pub type Listener = dyn Fn(&str) + Send + Sync;

/// See the module. Whatever fails is a miss, with one note for an upstream, an index or a pack.
pub struct Reader {
    opening: Box<Opening>,
    namespaces: &'static [&'static str],
    sound: fn(&Record) -> bool,
    tell: Box<Listener>,
    places: OnceLock<Option<Places>>,
}

/// A place in a pack: the pack's number, and the offset.
type BlobAt = (u32, u64);

/// The places of an upstream's records and blobs.
struct Places {
    upstream: Upstream,
    /// The lines of records.
    spool: File,
    /// Offset and length of each record in the spool. If indices have several records for a key, the first one counts.
    records: HashMap<(u8, Key), (u64, u32)>,
    blobs: HashMap<Digest, BlobAt>,
    /// Further places of blobs that two machines pushed.
    more: HashMap<Digest, Vec<BlobAt>>,
    packs: Vec<Digest>,
    use_of: Mutex<Use>,
}

/// Open packs, and errors so far.
#[derive(Default)]
struct Use {
    /// Open packs; none for one that cannot be opened.
    open: HashMap<u32, Option<Arc<Pack>>>,
    /// Packs with damage that was told.
    told: HashSet<u32>,
    /// Blobs that cannot be had.
    bad: HashSet<Digest>,
}

impl Reader {
    /// A reader of records in these namespaces that are `sound`: their keys are what their texts say.
    pub fn new(
        opening: Box<Opening>,
        namespaces: &'static [&'static str],
        sound: fn(&Record) -> bool,
        tell: Box<Listener>,
    ) -> Self {
        Self { opening, namespaces, sound, tell, places: OnceLock::new() }
    }

    /// Whether the upstream could not be opened. One that nobody has asked yet is opened.
    pub fn is_lost(&self) -> bool {
        self.places().is_none()
    }

    fn places(&self) -> Option<&Places> {
        self.places.get_or_init(|| self.load()).as_ref()
    }

    fn load(&self) -> Option<Places> {
        let upstream = match (self.opening)() {
            Ok(upstream) => upstream,
            Err(error) => return self.lost(&error.to_string()),
        };
        let indices = match upstream.indices() {
            Ok(indices) => indices,
            Err(error) => return self.lost(&error.to_string()),
        };
        let places = Places::read(upstream, &indices, self.namespaces, &*self.tell);
        places.map_or_else(|error| self.lost(&format!("cannot write a temporary file: {error}")), Some)
    }

    fn lost(&self, why: &str) -> Option<Places> {
        (self.tell)(&format!("the upstream is not used: {}", why.trim_end_matches('.')));
        None
    }
}

impl Beyond for Reader {
    fn records(&self, namespace: &str, keys: &[Key]) -> Vec<Option<Record>> {
        let number = self.namespaces.iter().position(|known| *known == namespace);
        let (Some(number), Some(places)) = (number, self.places()) else { return vec![None; keys.len()] };
        keys.iter().map(|key| places.record(number as u8, key).filter(|record| (self.sound)(record))).collect()
    }

    fn contains(&self, digest: &Digest) -> bool {
        self.places().is_some_and(|places| places.blobs.contains_key(digest) && !places.used().bad.contains(digest))
    }

    fn blob(&self, digest: &Digest) -> Option<Vec<u8>> {
        let places = self.places()?;
        let first = places.blobs.get(digest)?;
        if places.used().bad.contains(digest) {
            return None;
        }
        let found = [*first].iter().chain(places.more.get(digest).into_iter().flatten()).find_map(|(pack, offset)| {
            let read = places.pack(*pack).and_then(|pack| pack.map_or(Ok(None), |p| p.blob(*offset, digest).map(Some)));
            read.unwrap_or_else(|note| {
                if places.used().told.insert(*pack) {
                    (self.tell)(&note);
                }
                None
            })
        });
        if found.is_none() {
            places.used().bad.insert(*digest);
        }
        found
    }
}

impl Places {
    fn read(upstream: Upstream, indices: &[Digest], namespaces: &[&str], tell: &Listener) -> io::Result<Self> {
        let mut spool = BufWriter::new(tempfile::tempfile()?);
        let (mut end, mut numbers) = (0, HashMap::new());
        let (mut records, mut blobs, mut packs) = (HashMap::new(), HashMap::new(), Vec::new());
        let mut more: HashMap<Digest, Vec<BlobAt>> = HashMap::new();
        for index in indices {
            let lines = match lines(&upstream, index) {
                Ok(lines) => lines,
                Err(note) => {
                    tell(&note);
                    continue;
                }
            };
            let mut pack = None;
            for line in lines {
                match line {
                    Line::Pack(digest) => {
                        let next = packs.len() as u32;
                        let number = *numbers.entry(digest).or_insert(next);
                        if number == next {
                            packs.push(digest);
                        }
                        pack = Some(number);
                    }
                    Line::Blob(digest, offset) => {
                        let Some(pack) = pack else { continue };
                        match blobs.get(&digest) {
                            None => drop(blobs.insert(digest, (pack, offset))),
                            Some(known) if *known != (pack, offset) => {
                                more.entry(digest).or_default().push((pack, offset));
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
                        if records.contains_key(&slot) {
                            continue;
                        }
                        let text = serde_json::to_vec(&Line::Record(Box::new(record.into())))?;
                        spool.write_all(&text)?;
                        records.insert(slot, (end, text.len() as u32)); // an index has less than 4 GiB
                        end += text.len() as u64;
                    }
                }
            }
        }
        let spool = spool.into_inner().map_err(io::IntoInnerError::into_error)?;
        Ok(Self { upstream, spool, records, blobs, more, packs, use_of: Mutex::default() })
    }

    fn used(&self) -> MutexGuard<'_, Use> {
        self.use_of.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn record(&self, namespace: u8, key: &Key) -> Option<Record> {
        let (offset, len) = self.records.get(&(namespace, *key))?;
        let mut text = vec![0; *len as usize];
        self.spool.read_exact_at(&mut text, *offset).ok()?;
        match serde_json::from_slice(&text).ok()? {
            Line::Record(record) => Some(Record::from(*record)),
            Line::Pack(_) | Line::Blob(..) => None,
        }
    }

    /// An open pack, or none if it could not be opened before; the note of the first time.
    fn pack(&self, number: u32) -> Result<Option<Arc<Pack>>, String> {
        if let Some(known) = self.used().open.get(&number) {
            return Ok(known.clone());
        }
        let opened = self.upstream.pack(&self.packs[number as usize]).map(Arc::new);
        let mut used = self.used();
        if used.open.len() >= MOST_OPEN {
            // Packs that cannot be opened are kept, so that nobody tries again.
            used.open.retain(|_, pack| pack.is_none());
        }
        used.open.insert(number, opened.as_ref().ok().cloned());
        opened.map(Some)
    }
}

/// Packs that are kept open.
const MOST_OPEN: usize = 64;

impl fmt::Debug for Reader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Reader").field("namespaces", &self.namespaces).finish_non_exhaustive()
    }
}
