//! An upstream as a store asks it: for many keys at once, and for single blobs.
//!
//! The indices are read once, at the first question. Places of blobs and records stay in memory, and the text of the
//! records in an unnamed temporary file, so that a look-up of thousands of keys reads nothing of the upstream.

use crate::{Traffic, Upstream, UpstreamError, error::Failure, places::Places};
use std::{
    fmt,
    sync::{
        OnceLock,
        atomic::{AtomicBool, Ordering},
    },
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
    /// It failed while it was read. From then on all that it has is a miss, because each attempt would take long.
    lost: AtomicBool,
}

impl Reader {
    /// A reader of records in these namespaces that are `sound`: their keys are what their texts say.
    pub fn new(
        opening: Box<Opening>,
        namespaces: &'static [&'static str],
        sound: fn(&Record) -> bool,
        tell: Box<Listener>,
    ) -> Self {
        Self { opening, namespaces, sound, tell, places: OnceLock::new(), lost: AtomicBool::new(false) }
    }

    /// Whether the upstream could not be opened. One that nobody has asked yet is opened.
    pub fn is_lost(&self) -> bool {
        self.places().is_none()
    }

    /// Requests so far, if it is no directory and was asked.
    pub fn traffic(&self) -> Option<Traffic> {
        self.places.get()?.as_ref()?.upstream.traffic()
    }

    /// Sees what others have pushed since it was asked first.
    ///
    /// # Errors
    /// When the upstream cannot be listed or read.
    pub fn refresh(&self) -> Result<(), UpstreamError> {
        // One that could not even be opened was told.
        let Some(places) = self.places.get_or_init(|| self.load()).as_ref() else { return Ok(()) };
        places.refresh(self.namespaces, &*self.tell)?;
        if self.lost.swap(false, Ordering::Relaxed) {
            (self.tell)("the upstream answers again, and is used again");
        }
        Ok(())
    }

    fn places(&self) -> Option<&Places> {
        if self.lost.load(Ordering::Relaxed) {
            return None;
        }
        self.places.get_or_init(|| self.load()).as_ref()
    }

    fn load(&self) -> Option<Places> {
        let read = (self.opening)().and_then(|upstream| Places::read(upstream, self.namespaces, &*self.tell));
        read.map_or_else(|error| self.lost(&error.to_string()), Some)
    }

    fn lost(&self, why: &str) -> Option<Places> {
        (self.tell)(&format!("the upstream is not used: {}", why.trim_end_matches('.')));
        None
    }
}

impl Beyond for Reader {
    fn records(&self, namespace: &str, keys: &[Key]) -> Vec<Option<Record>> {
        let number = self.namespaces.iter().position(|known| *known == namespace);
        // Nothing is read for records that are not shared.
        let places = number.and_then(|number| Some((number, self.places()?)));
        let Some((number, places)) = places else { return vec![None; keys.len()] };
        keys.iter().map(|key| places.record(number as u8, key).filter(|record| (self.sound)(record))).collect()
    }

    fn keys(&self, namespace: &str) -> Vec<Key> {
        let number = self.namespaces.iter().position(|known| *known == namespace);
        number.and_then(|number| Some(self.places()?.keys(number as u8))).unwrap_or_default()
    }

    fn contains(&self, digest: &Digest) -> bool {
        let places = self.places();
        places.is_some_and(|places| places.knows(digest) && !places.used().bad.contains(digest))
    }

    fn blob(&self, digest: &Digest) -> Option<Vec<u8>> {
        let places = self.places()?;
        if places.used().bad.contains(digest) {
            return None;
        }
        let mut said_to_be_there = false;
        for (pack, offset) in places.of_blob(digest) {
            said_to_be_there = true;
            match places.read_blob(pack, offset, digest) {
                Ok(None) => {}
                Ok(Some(found)) => return Some(found),
                Err(Failure::File(note) | Failure::Unsigned(note)) => {
                    if places.used().told.insert(pack) {
                        (self.tell)(&note);
                    }
                }
                Err(Failure::Place(why)) => {
                    if !self.lost.swap(true, Ordering::Relaxed) {
                        (self.tell)(&format!("the upstream is not used any more: {}", why.trim_end_matches('.')));
                    }
                    return None;
                }
            }
        }
        if said_to_be_there {
            places.used().bad.insert(*digest);
        }
        None
    }

    fn lists_late(&self) -> bool {
        self.places().is_some_and(|places| places.upstream.lists_late())
    }

    fn look_again(&self) {
        // An error shows again at the next read.
        let _ = self.refresh();
        if let Some(places) = self.places() {
            places.try_again();
        }
    }
}

impl fmt::Debug for Reader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Reader").field("namespaces", &self.namespaces).finish_non_exhaustive()
    }
}
