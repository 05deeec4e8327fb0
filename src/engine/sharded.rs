//! Collections in the engine: in shards, each with its digest, and loaded on demand.
//!
//! A collection of few items is listed by one blob. A larger one is listed by a blob for each shard, and by one that
//! lists these: a change of one item writes two of them anew, and a reader of one item reads two. All are trees (see
//! [`tauflow_cache::tree`]), so that a record which names the top one keeps every item's blobs.

use super::{
    listing::{self, Listing},
    output::{Items, Output},
};
use serde::{Deserialize, Serialize};
use std::{
    collections::BTreeMap,
    sync::{Arc, OnceLock},
};
use tauflow_cache::{CacheError, Digest, Store, tree};
use tauflow_contract::{Any, Collection, ItemKey, collection_digest, shard_digest};

/// Shards of a collection.
pub const SHARDS: usize = 256;
/// Items from which a collection is listed shard by shard, and a lane is looked up so.
pub const MANY: u64 = 2048;
/// Listings of shards that are read together.
const AT_ONCE: usize = 64;

/// The value, or its missing blob.
pub type Here<T> = Result<T, Digest>;

/// A collection kept as a blob.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Listed {
    /// Content digest of the collection, or of the shard.
    pub digest: Digest,
    /// The tree that lists it.
    pub blob: Digest,
    /// How many items it has.
    pub len: u64,
}

/// The items of one shard.
#[derive(Debug)]
pub struct Shard {
    /// How many.
    pub len: u64,
    /// Content digest.
    pub digest: Digest,
    tree: OnceLock<Digest>,
    items: OnceLock<Items>,
    /// Which shard it is, and the media type of its items, `*` for any: what its listing must agree with.
    says: Option<(u8, &'static str)>,
}

impl Shard {
    /// A shard of the given items, in the order of their keys.
    pub fn new(items: Items) -> Self {
        let digest = shard_digest(items.iter().map(|(key, output)| (key, output.digest)));
        Self { len: items.len() as u64, digest, tree: OnceLock::new(), items: items.into(), says: None }
    }

    /// A stored shard with this number and media type.
    pub fn listed(listed: &Listed, number: u8, media: &'static str) -> Self {
        let (tree, says) = (listed.blob.into(), Some((number, media)));
        Self { len: listed.len, digest: listed.digest, tree, items: OnceLock::new(), says }
    }

    /// The items, if they were read or made.
    pub fn at_hand(&self) -> Option<&Items> {
        self.items.get()
    }

    /// The items; or the blob that lists them and is missing.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn items(&self, store: &Store) -> Result<Here<&Items>, CacheError> {
        match self.items.get() {
            Some(items) => Ok(Ok(items)),
            None => Ok(self.parse(store.get(&self.listing())?)),
        }
    }

    /// Reads the items of shards that do not have them yet, many at a time; or the missing blob of each.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn read(store: &Store, shards: &[&Self]) -> Result<Vec<Here<()>>, CacheError> {
        let mut read: Vec<Here<()>> = vec![Ok(()); shards.len()];
        let open: Vec<usize> = (0..shards.len()).filter(|at| shards[*at].items.get().is_none()).collect();
        for open in open.chunks(AT_ONCE) {
            let blobs: Vec<Digest> = open.iter().map(|at| shards[*at].listing()).collect();
            for (at, bytes) in open.iter().zip(store.get_many(&blobs)?) {
                read[*at] = shards[*at].parse(bytes).map(drop);
            }
        }
        Ok(read)
    }

    /// The blob that lists the items.
    fn listing(&self) -> Digest {
        self.tree.get().copied().unwrap_or(self.digest) // a shard without items has a listing
    }

    /// The items that a listing names; or its blob if that is missing or unusable.
    fn parse(&self, bytes: Option<Vec<u8>>) -> Here<&Items> {
        let Some(bytes) = bytes else { return Err(self.listing()) };
        // One that says something else than its collection does is as good as none.
        let content = |items: &Items| shard_digest(items.iter().map(|(key, output)| (key, output.digest)));
        let own =
            |items: &Items| self.says.is_none_or(|(number, _)| items.iter().all(|(key, _)| key.shard() == number));
        match listing::read(&bytes, self.len, self.says.map_or(Any::NAME, |(_, media)| media)) {
            Some(Listing::Items(items)) if own(&items) && content(&items) == self.digest => {
                Ok(self.items.get_or_init(|| items))
            }
            _ => Err(self.listing()),
        }
    }

    /// Stores the shard's listing, unless that was done.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn put(&self, store: &Store) -> Result<Listed, CacheError> {
        let blob = match (self.tree.get(), self.items.get()) {
            (Some(tree), _) => *tree,
            (None, items) => {
                let blob = store.put(&listing::of_items(items.into_iter().flatten()))?;
                *self.tree.get_or_init(|| blob)
            }
        };
        Ok(Listed { digest: self.digest, blob, len: self.len })
    }
}

/// A collection in its shards, with its content digest.
#[derive(Clone, Debug)]
pub struct Sharded {
    /// The digest.
    pub digest: Digest,
    /// The shards that hold items, by number.
    pub shards: BTreeMap<u8, Arc<Shard>>,
    /// As kinds see it, once one has.
    seen: OnceLock<Collection>,
    /// Its listing, once it is stored.
    stored: OnceLock<Listed>,
}

impl Sharded {
    /// A collection of shards.
    pub fn new(shards: BTreeMap<u8, Arc<Shard>>) -> Self {
        let digest = collection_digest(shards.iter().map(|(number, shard)| (*number, shard.len, shard.digest)));
        Self { digest, shards, seen: OnceLock::new(), stored: OnceLock::new() }
    }

    /// A collection of the given items.
    pub fn of(items: impl IntoIterator<Item = (ItemKey, Arc<Output>)>) -> Self {
        let mut shards: BTreeMap<u8, Items> = BTreeMap::new();
        for (key, output) in items {
            shards.entry(key.shard()).or_default().push((key, output));
        }
        let shard = |mut items: Items| {
            items.sort_by(|a, b| a.0.cmp(&b.0));
            Arc::new(Shard::new(items))
        };
        Self::new(shards.into_iter().map(|(number, items)| (number, shard(items))).collect())
    }

    /// How many items.
    pub fn len(&self) -> u64 {
        self.shards.values().fold(0, |sum: u64, shard| sum.saturating_add(shard.len))
    }

    /// Every item, in no order; or a blob that lists some of them and is missing.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn items(&self, store: &Store) -> Result<Here<Items>, CacheError> {
        let shards: Vec<&Shard> = self.shards.values().map(|shard| &**shard).collect();
        if let Some(missing) = Shard::read(store, &shards)?.into_iter().find_map(Result::err) {
            return Ok(Err(missing));
        }
        Ok(Ok(shards.into_iter().filter_map(Shard::at_hand).flatten().cloned().collect()))
    }

    /// The blobs of every item, as far as they are known; and the blobs that list the others, which are missing.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn blobs(&self, store: &Store) -> Result<(Vec<Digest>, Vec<Digest>), CacheError> {
        let (mut all, mut missing, mut unread) = (Vec::new(), Vec::new(), Vec::new());
        for shard in self.shards.values() {
            match shard.at_hand() {
                Some(items) => all.extend(items.iter().flat_map(|(_, output)| output.artifact.parts.values())),
                None => unread.push(shard.listing()),
            }
        }
        for unread in unread.chunks(AT_ONCE) {
            for (blob, bytes) in unread.iter().zip(store.get_many(unread)?) {
                // Only the blobs are decoded, not the names of the items.
                match bytes.as_deref().and_then(tree::decode) {
                    Some(listing) => all.extend(listing.refs),
                    None => missing.push(*blob),
                }
            }
        }
        Ok((all, missing))
    }

    /// The blob of its listing, once it is stored.
    pub fn blob(&self) -> Option<Digest> {
        self.stored.get().map(|listed| listed.blob)
    }

    /// As a kind sees it.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn collection(&self, store: &Store) -> Result<Here<&Collection>, CacheError> {
        if let Some(collection) = self.seen.get() {
            return Ok(Ok(collection));
        }
        let items = self.items(store)?;
        let artifacts = |items: Items| items.into_iter().map(|(key, output)| (key, output.artifact.clone())).collect();
        Ok(items.map(|items| self.seen.get_or_init(|| artifacts(items))))
    }

    /// Stores its listing, unless that was done.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn put(&self, store: &Store) -> Result<Listed, CacheError> {
        if let Some(listed) = self.stored.get() {
            return Ok(listed.clone());
        }
        let len = self.len();
        let at_hand: Vec<&Items> = self.shards.values().filter_map(|shard| shard.items.get()).collect();
        let listed = self.shards.values().any(|shard| shard.tree.get().is_some());
        let bytes = if len < MANY && at_hand.len() == self.shards.len() && !listed {
            listing::of_items(at_hand.into_iter().flatten())
        } else {
            let mut trees = Vec::with_capacity(self.shards.len());
            for shard in self.shards.values() {
                trees.push(shard.put(store)?.blob);
            }
            let row = |(number, shard): (&u8, &Arc<Shard>)| (*number, shard.len, shard.digest);
            listing::of_shards(&self.shards.iter().map(row).collect::<Vec<_>>(), &trees)
        };
        let listed = Listed { digest: self.digest, blob: store.put(&bytes)?, len };
        Ok(self.stored.get_or_init(|| listed).clone())
    }

    /// Reads a listing of items of a media type, `*` for any; `None` if its blob is missing, or is no such listing.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn get(store: &Store, listed: &Listed, media: &'static str) -> Result<Option<Self>, CacheError> {
        Ok(store.get(&listed.blob)?.and_then(|bytes| Self::parse(&bytes, listed, media)))
    }

    /// Reads several listings together, each as [`get`](Self::get) does.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn get_many(store: &Store, asked: &[(&Listed, &'static str)]) -> Result<Vec<Option<Self>>, CacheError> {
        let blobs: Vec<Digest> = asked.iter().map(|(listed, _)| listed.blob).collect();
        let read = store.get_many(&blobs)?.into_iter().zip(asked);
        Ok(read.map(|(bytes, (listed, media))| Self::parse(&bytes?, listed, media)).collect())
    }

    fn parse(bytes: &[u8], listed: &Listed, media: &'static str) -> Option<Self> {
        let sharded = match listing::read(bytes, listed.len, media) {
            Some(Listing::Shards(shards)) => {
                let shard = |((number, len, digest), blob): (listing::Row, Digest)| {
                    (number, Arc::new(Shard::listed(&Listed { digest, blob, len }, number, media)))
                };
                Self::new(shards.into_iter().map(shard).collect())
            }
            Some(Listing::Items(items)) => Self::of(items),
            None => return None,
        };
        let _ = sharded.stored.set(listed.clone()); // new, so empty
        (sharded.digest == listed.digest).then_some(sharded)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_contract::Artifact;

    fn items(count: u64, changed: Option<u64>) -> Items {
        let item = |n: u64| {
            let key = ItemKey::new(format!("{n:06}")).expect("a key");
            let blob = |what: &str| Digest::of(format!("{what}{n}{}", changed == Some(n)).as_bytes());
            let parts = [("a".to_owned(), blob("a")), ("b".to_owned(), blob("b"))];
            (key, Output::new(Artifact::tree("m", parts)))
        };
        (0..count).map(item).collect()
    }

    #[test]
    fn listings_round_trip_and_have_the_collection_s_digest() {
        let dir = tempfile::tempdir().expect("a folder");
        let store = Store::open(dir.path()).expect("a store");
        for count in [0, 1, 300, MANY + 1] {
            let sharded = Sharded::of(items(count, None));
            let collection = sharded.collection(&store).expect("no disk").expect("at hand");
            assert_eq!(sharded.digest, collection.digest());
            let listed = sharded.put(&store).expect("room");
            let back = Sharded::get(&store, &listed, "m").expect("readable").expect("there");
            assert_eq!((back.digest, back.len()), (sharded.digest, count));
            assert_eq!(back.collection(&store).expect("readable").expect("there"), collection);
            // Everything is kept by the listing alone.
            let reached = store.reach(&[], &[listed.blob]).expect("readable");
            assert!(collection.items.values().flat_map(|a| a.parts.values()).all(|d| reached.contains(d)));
        }
    }

    #[test]
    fn a_change_of_one_item_changes_one_shard() {
        let (before, after) = (Sharded::of(items(5000, None)), Sharded::of(items(5000, Some(77))));
        let differ = before.shards.iter().filter(|(number, shard)| after.shards[*number].digest != shard.digest);
        assert_eq!(differ.count(), 1);
        assert_ne!(before.digest, after.digest);
    }

    #[test]
    fn a_listing_that_is_gone_is_told() {
        let dir = tempfile::tempdir().expect("a folder");
        let store = Store::open(dir.path()).expect("a store");
        let listed = Listed { digest: Digest::of(b"d"), blob: Digest::of(b"b"), len: 1 };
        assert!(Sharded::get(&store, &listed, "m").expect("readable").is_none());
        assert_eq!(Shard::listed(&listed, 0, "m").items(&store).expect("readable").err(), Some(listed.blob));
        let other = Listed { blob: store.put(b"{}").expect("room"), ..listed };
        assert!(Sharded::get(&store, &other, "m").expect("readable").is_none(), "other bytes are no listing");
    }

    #[test]
    fn a_listing_of_other_items_than_its_port_holds_is_none() {
        let dir = tempfile::tempdir().expect("a folder");
        let store = Store::open(dir.path()).expect("a store");
        for count in [3, MANY + 1] {
            let listed = Sharded::of(items(count, None)).put(&store).expect("room");
            let read = |media: &'static str| {
                let found = Sharded::get(&store, &listed, media).expect("readable");
                found.is_some_and(|found| found.items(&store).expect("readable").is_ok())
            };
            assert_eq!((read("m"), read(Any::NAME), read("n")), (true, true, false), "{count}");
            let more = Listed { len: count + 1, ..listed.clone() };
            assert!(Sharded::get(&store, &more, "m").expect("readable").is_none(), "it has another number of items");
        }
    }

    #[test]
    fn an_item_in_a_shard_that_is_not_its_own_is_refused() {
        let dir = tempfile::tempdir().expect("a folder");
        let store = Store::open(dir.path()).expect("a store");
        let of = items(1, None);
        let (own, shard) = (of[0].0.shard(), Shard::new(of));
        let listed = shard.put(&store).expect("room");
        assert!(Shard::listed(&listed, own, "m").items(&store).expect("readable").is_ok());
        let other = Shard::listed(&listed, own.wrapping_add(1), "m");
        assert_eq!(other.items(&store).expect("readable").err(), Some(listed.blob));
    }
}
