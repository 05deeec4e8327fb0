//! Collections as the engine holds them: in shards, each with its digest and, until somebody reads it, perhaps no more.
//!
//! A collection of few items is listed by one blob. A larger one is listed by a blob for each shard, and by one that
//! lists these: a change of one item writes two of them anew, and a reader of one item reads two. All are trees (see
//! [`tauflow_cache::tree`]), so that a record which names the top one keeps every item's blobs.

use serde::{Deserialize, Serialize};
use std::{
    collections::BTreeMap,
    sync::{Arc, OnceLock},
};
use tauflow_cache::{CacheError, Digest, Store, tree};
use tauflow_contract::{Artifact, Collection, ItemKey, Parts, collection_digest, shard_digest};

/// Shards of a collection.
pub const SHARDS: usize = 256;
/// Items from which a collection is listed shard by shard, and a lane is looked up so.
pub const MANY: u64 = 2048;

/// An artifact with its content digest.
#[derive(Debug)]
pub struct Output {
    /// The artifact.
    pub artifact: Artifact,
    /// Its digest.
    pub digest: Digest,
}

impl Output {
    /// Computes the digest.
    pub fn new(artifact: Artifact) -> Arc<Self> {
        Arc::new(Self { digest: artifact.digest(), artifact })
    }
}

/// Items in the order of their keys.
pub type Items = Vec<(ItemKey, Arc<Output>)>;

/// What is there, or the blob that should be and is not.
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

/// What a listing says beside the blobs that it lists.
#[derive(Serialize, Deserialize)]
enum Body {
    /// Key, media type and names of parts of each item; the tree's blobs are those of the parts, in this order.
    Items(Vec<(ItemKey, String, Vec<String>)>),
    /// Number, items and content digest of each shard; the tree's trees list them, in this order.
    Shards(Vec<(u8, u64, Digest)>),
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
}

impl Shard {
    /// Of items at hand, in the order of their keys.
    pub fn new(items: Items) -> Self {
        let digest = shard_digest(items.iter().map(|(key, output)| (key, output.digest)));
        Self { len: items.len() as u64, digest, tree: OnceLock::new(), items: items.into() }
    }

    /// Of a shard that is listed in the store.
    pub fn listed(listed: &Listed) -> Self {
        Self { len: listed.len, digest: listed.digest, tree: listed.blob.into(), items: OnceLock::new() }
    }

    /// The items; or the blob that lists them and is missing.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn items(&self, store: &Store) -> Result<Here<&Items>, CacheError> {
        if let Some(items) = self.items.get() {
            return Ok(Ok(items));
        }
        let tree = self.tree.get().copied().unwrap_or(self.digest); // one of the two is always there
        let Some(bytes) = store.get(&tree)? else { return Ok(Err(tree)) };
        // One that says something else than its collection does is as good as none.
        let content = |items: &Items| shard_digest(items.iter().map(|(key, output)| (key, output.digest)));
        match read_items(&bytes) {
            Some(items) if items.len() as u64 == self.len && content(&items) == self.digest => {
                Ok(Ok(self.items.get_or_init(|| items)))
            }
            _ => Ok(Err(tree)),
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
                let blob = store.put(&items_bytes(items.into_iter().flatten()))?;
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
    /// Of its shards.
    pub fn new(shards: BTreeMap<u8, Arc<Shard>>) -> Self {
        let digest = collection_digest(shards.iter().map(|(number, shard)| (*number, shard.len, shard.digest)));
        Self { digest, shards, seen: OnceLock::new(), stored: OnceLock::new() }
    }

    /// Of items at hand.
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
        // A listing may say any number of items.
        let mut all = Items::new();
        for shard in self.shards.values() {
            match shard.items(store)? {
                Ok(items) => all.extend_from_slice(items),
                Err(missing) => return Ok(Err(missing)),
            }
        }
        Ok(Ok(all))
    }

    /// The blobs of every item, as far as they are known; and the blobs that list the others, which are missing.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn blobs(&self, store: &Store) -> Result<(Vec<Digest>, Vec<Digest>), CacheError> {
        let (mut all, mut missing) = (Vec::new(), Vec::new());
        for shard in self.shards.values() {
            match (shard.items.get(), shard.tree.get()) {
                // Without reading what the items are called.
                (None, Some(blob)) => match store.get(blob)?.as_deref().and_then(tree::decode) {
                    Some(listing) => all.extend(listing.refs),
                    None => missing.push(*blob),
                },
                (items, _) => {
                    let outputs = items.into_iter().flatten().map(|(_, output)| output);
                    all.extend(outputs.flat_map(|output| output.artifact.parts.values()));
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
            items_bytes(at_hand.into_iter().flatten())
        } else {
            let mut trees = Vec::with_capacity(self.shards.len());
            for shard in self.shards.values() {
                trees.push(shard.put(store)?.blob);
            }
            let shards = self.shards.iter().map(|(number, shard)| (*number, shard.len, shard.digest)).collect();
            tree::encode(&[], &trees, &body_bytes(&Body::Shards(shards)))
        };
        let listed = Listed { digest: self.digest, blob: store.put(&bytes)?, len };
        Ok(self.stored.get_or_init(|| listed).clone())
    }

    /// Reads a listing; `None` if its blob is missing.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn get(store: &Store, listed: &Listed) -> Result<Option<Self>, CacheError> {
        let Some(bytes) = store.get(&listed.blob)? else { return Ok(None) };
        let Some(tree) = tree::decode(&bytes) else { return Ok(None) };
        let sharded = match serde_json::from_slice(tree.body) {
            Ok(Body::Shards(shards)) if shards.len() == tree.trees.len() => {
                let shard = |((number, len, digest), blob): ((u8, u64, Digest), Digest)| {
                    (number, Arc::new(Shard::listed(&Listed { digest, blob, len })))
                };
                Self::new(shards.into_iter().zip(tree.trees).map(shard).collect())
            }
            Ok(Body::Items(_)) => match read_items(&bytes) {
                Some(items) => Self::of(items),
                None => return Ok(None),
            },
            _ => return Ok(None),
        };
        let _ = sharded.stored.set(listed.clone()); // new, so empty
        Ok((sharded.digest == listed.digest).then_some(sharded))
    }
}

fn body_bytes(body: &Body) -> Vec<u8> {
    serde_json::to_vec(body).expect("keys and digests always serialise")
}

fn items_bytes<'a>(items: impl IntoIterator<Item = &'a (ItemKey, Arc<Output>)>) -> Vec<u8> {
    let mut items: Vec<_> = items.into_iter().collect();
    items.sort_by(|a, b| a.0.cmp(&b.0));
    let (mut refs, mut rows) = (Vec::new(), Vec::with_capacity(items.len()));
    for (key, output) in items {
        let parts = &output.artifact.parts;
        refs.extend(parts.values().copied());
        rows.push((key.clone(), output.artifact.media.clone(), parts.keys().cloned().collect()));
    }
    tree::encode(&refs, &[], &body_bytes(&Body::Items(rows)))
}

fn read_items(bytes: &[u8]) -> Option<Items> {
    let tree = tree::decode(bytes)?;
    let Ok(Body::Items(rows)) = serde_json::from_slice(tree.body) else { return None };
    let mut refs = tree.refs.into_iter();
    let mut items = Items::with_capacity(rows.len());
    for (key, media, names) in rows {
        let parts: Option<Parts> = names.into_iter().map(|name| Some((name, refs.next()?))).collect();
        let artifact = Artifact { media, parts: parts? };
        // Names are put together here, and so are checked here.
        artifact.check_names().ok()?;
        items.push((key, Output::new(artifact)));
    }
    Some(items)
}

#[cfg(test)]
mod tests {
    use super::*;

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
            let back = Sharded::get(&store, &listed).expect("readable").expect("there");
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
        assert!(Sharded::get(&store, &listed).expect("readable").is_none());
        assert_eq!(Shard::listed(&listed).items(&store).expect("readable").err(), Some(listed.blob));
        let other = Listed { blob: store.put(b"{}").expect("room"), ..listed };
        assert!(Sharded::get(&store, &other).expect("readable").is_none(), "other bytes are no listing");
    }
}
