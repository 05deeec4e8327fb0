//! Artifacts, and collections of them.

use crate::canonical_bytes;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::{borrow::Borrow, collections::BTreeMap, fmt, sync::Arc};
use tauflow_cache::Digest;

/// Stable key of an item in a collection, such as `L1-open-000123`.
///
/// Keys are ASCII letters, digits, `.`, `_`, `-`, `=`, `+` and `/` (the slash parts a matrix cell from the item), so
/// that they serve as file names. No part is empty or begins with `.`: such names lead elsewhere, or are settings of
/// programs that trust whoever wrote them. Cheap to clone.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct ItemKey(Arc<str>);

/// A text that cannot be an item key.
#[derive(Debug, thiserror::Error)]
#[error(
    "`{0}` cannot be an item key: use 1 to 200 ASCII letters, digits, `.`, `_`, `-`, `=`, `+` or `/`, \
     with no part that is empty or begins with `.`"
)]
pub struct ItemKeyError(String);

impl ItemKey {
    /// Checks `text` and makes a key of it.
    ///
    /// # Errors
    /// If the text is empty, too long, holds a character outside the set above, or has a part that begins with `.`.
    pub fn new(text: impl Into<String>) -> Result<Self, ItemKeyError> {
        let text = text.into();
        Self::check(&text)?;
        Ok(Self(text.into()))
    }

    /// Whether a text can be a key.
    ///
    /// # Errors
    /// As [`ItemKey::new`].
    pub fn check(text: &str) -> Result<(), ItemKeyError> {
        let fine = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'_' | b'-' | b'=' | b'+' | b'/');
        let parts_fine = text.split('/').all(|part| !part.is_empty() && !part.starts_with('.'));
        if text.is_empty() || text.len() > 200 || !text.bytes().all(fine) || !parts_fine {
            return Err(ItemKeyError(text.chars().take(200).collect()));
        }
        Ok(())
    }

    /// The key's text, shared.
    pub fn text(&self) -> Arc<str> {
        self.0.clone()
    }

    /// The key's text.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The key below a matrix cell: `cell/key`.
    ///
    /// # Errors
    /// As [`ItemKey::new`].
    pub fn in_cell(&self, cell: &str) -> Result<Self, ItemKeyError> {
        Self::new(format!("{cell}/{}", self.0))
    }

    /// The shard that the item belongs to: see [`Collection::digest`]. A function of the item's own text, so that an
    /// item stays in its shard below any matrix cell.
    pub fn shard(&self) -> u8 {
        let own = self.split_cell().map_or(self.as_str(), |(_, own)| own);
        blake3::hash(own.as_bytes()).as_bytes()[0]
    }

    /// The cell's text and the item's own text, for a key made by [`ItemKey::in_cell`].
    pub fn split_cell(&self) -> Option<(&str, &str)> {
        self.0.rsplit_once('/')
    }
}

impl fmt::Display for ItemKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl TryFrom<String> for ItemKey {
    type Error = ItemKeyError;
    fn try_from(text: String) -> Result<Self, Self::Error> {
        Self::new(text)
    }
}

impl From<ItemKey> for String {
    fn from(key: ItemKey) -> Self {
        key.0.as_ref().to_owned()
    }
}

impl Borrow<str> for ItemKey {
    fn borrow(&self) -> &str {
        &self.0
    }
}

/// One content-addressed blob, or a small tree of named blobs, with a media type.
///
/// A single blob is a tree whose only part has the empty name. Values from a store or a file are validated: names of
/// parts stay below the target folder.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(try_from = "RawArtifact")]
pub struct Artifact {
    /// The media type, e.g. `tauflow/ladder`.
    pub media: String,
    /// Parts by name; names follow the rules of [`ItemKey`] or are empty.
    pub parts: Parts,
}

/// An artifact whose names nobody has looked at.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawArtifact {
    media: String,
    parts: Parts,
}

/// Names that an artifact cannot have.
#[derive(Debug, thiserror::Error)]
pub enum ArtifactError {
    /// Its media type.
    #[error("`{0}` cannot be a media type: use 1 to 100 ASCII letters, digits, `.`, `_`, `-`, `+` or `/`")]
    Media(String),
    /// A part.
    #[error("an artifact's part has a name that cannot be a file's: {0}")]
    Part(#[from] ItemKeyError),
}

impl TryFrom<RawArtifact> for Artifact {
    type Error = ArtifactError;
    fn try_from(raw: RawArtifact) -> Result<Self, ArtifactError> {
        let artifact = Self { media: raw.media, parts: raw.parts };
        artifact.check_names()?;
        Ok(artifact)
    }
}

/// Named digests, ordered by name: a map that takes no more room than its few entries.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Parts(Box<[(String, Digest)]>);

impl Parts {
    /// The digest of a name.
    pub fn get(&self, name: &str) -> Option<&Digest> {
        self.0.binary_search_by(|(there, _)| there.as_str().cmp(name)).ok().map(|at| &self.0[at].1)
    }

    /// Whether the name is there.
    pub fn contains_key(&self, name: &str) -> bool {
        self.get(name).is_some()
    }

    /// Names, in order.
    pub fn keys(&self) -> impl Iterator<Item = &String> {
        self.0.iter().map(|(name, _)| name)
    }

    /// Digests, in the order of their names.
    pub fn values(&self) -> impl Iterator<Item = &Digest> {
        self.0.iter().map(|(_, digest)| digest)
    }

    /// Names and digests, in order.
    pub fn iter(&self) -> impl Iterator<Item = (&String, &Digest)> {
        self.0.iter().map(|(name, digest)| (name, digest))
    }

    /// How many.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl FromIterator<(String, Digest)> for Parts {
    /// If two entries have the same name, the later one is kept.
    fn from_iter<I: IntoIterator<Item = (String, Digest)>>(iter: I) -> Self {
        let mut parts: Vec<(String, Digest)> = iter.into_iter().collect();
        parts.reverse();
        parts.sort_by(|a, b| a.0.cmp(&b.0));
        parts.dedup_by(|later, first| later.0 == first.0);
        Self(parts.into())
    }
}

impl Serialize for Parts {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.iter())
    }
}

impl<'de> Deserialize<'de> for Parts {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries;
        impl<'de> serde::de::Visitor<'de> for Entries {
            type Value = Parts;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("digests by name")
            }
            fn visit_map<A: serde::de::MapAccess<'de>>(self, mut map: A) -> Result<Parts, A::Error> {
                let mut parts = Vec::with_capacity(map.size_hint().unwrap_or(1));
                while let Some(entry) = map.next_entry()? {
                    parts.push(entry);
                }
                Ok(parts.into_iter().collect())
            }
        }
        deserializer.deserialize_map(Entries)
    }
}

impl Artifact {
    /// An artifact of a single blob.
    pub fn blob(media: impl Into<String>, digest: Digest) -> Self {
        Self { media: media.into(), parts: Parts(Box::new([(String::new(), digest)])) }
    }

    /// An artifact of named parts.
    pub fn tree(media: impl Into<String>, parts: impl IntoIterator<Item = (String, Digest)>) -> Self {
        Self { media: media.into(), parts: parts.into_iter().collect() }
    }

    /// The digest of a part, if it is there; the empty name is the single blob.
    pub fn part(&self, name: &str) -> Option<Digest> {
        self.parts.get(name).copied()
    }

    /// Whether its names are what they may be; what is read must be held to it before it is used.
    ///
    /// # Errors
    /// The first name that cannot be.
    pub fn check_names(&self) -> Result<(), ArtifactError> {
        let fine = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'_' | b'-' | b'+' | b'/');
        if self.media.is_empty() || self.media.len() > 100 || !self.media.bytes().all(fine) {
            return Err(ArtifactError::Media(self.media.chars().take(100).collect()));
        }
        let named = self.parts.keys().filter(|name| !name.is_empty());
        named.into_iter().try_for_each(|name| ItemKey::check(name).map_err(ArtifactError::from))
    }

    /// Content digest of the whole artifact: of its canonical encoding, which names every part's digest.
    pub fn digest(&self) -> Digest {
        Digest::of(&canonical_bytes(self))
    }

    /// Sum of the parts' sizes in bytes.
    pub fn size(&self) -> u64 {
        self.parts.values().fold(0, |sum, digest| sum.saturating_add(digest.size))
    }
}

/// An ordered map from item key to artifact.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct Collection {
    /// The items, in key order.
    pub items: BTreeMap<ItemKey, Artifact>,
}

/// Content digest of the items of one shard: over every key, in order, and its artifact's digest.
pub fn shard_digest<'a>(items: impl Iterator<Item = (&'a ItemKey, Digest)>) -> Digest {
    let mut bytes = b"tauflow-shard-1".to_vec();
    for (key, digest) in items {
        bytes.extend((key.as_str().len() as u64).to_le_bytes());
        bytes.extend(key.as_str().as_bytes());
        bytes.extend(digest.hash);
        bytes.extend(digest.size.to_le_bytes());
    }
    Digest::of(&bytes)
}

/// Content digest of a collection, from the shards that hold items: number, items, and [`shard_digest`], in the order
/// of their numbers.
pub fn collection_digest(shards: impl Iterator<Item = (u8, u64, Digest)>) -> Digest {
    let mut bytes = b"tauflow-collection-2".to_vec();
    for (shard, len, digest) in shards {
        bytes.push(shard);
        bytes.extend(len.to_le_bytes());
        bytes.extend(digest.hash);
        bytes.extend(digest.size.to_le_bytes());
    }
    Digest::of(&bytes)
}

impl Collection {
    /// Content digest of the collection: a tree of two levels, over every item's key and artifact digest. Items are
    /// dealt to 256 shards by [`ItemKey::shard`], so that a change of one item changes one shard, and the others'
    /// digests can be kept.
    pub fn digest(&self) -> Digest {
        let mut shards: BTreeMap<u8, Vec<(&ItemKey, Digest)>> = BTreeMap::new();
        for (key, artifact) in &self.items {
            shards.entry(key.shard()).or_default().push((key, artifact.digest()));
        }
        let digests =
            shards.into_iter().map(|(shard, items)| (shard, items.len() as u64, shard_digest(items.into_iter())));
        collection_digest(digests)
    }

    /// Number of items.
    pub fn len(&self) -> usize {
        self.items.len()
    }

    /// True if there is no item.
    pub fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    /// The artifact of an item.
    pub fn get(&self, key: &str) -> Option<&Artifact> {
        self.items.get(key)
    }

    /// Items in key order.
    pub fn iter(&self) -> impl Iterator<Item = (&ItemKey, &Artifact)> {
        self.items.iter()
    }
}

impl FromIterator<(ItemKey, Artifact)> for Collection {
    fn from_iter<I: IntoIterator<Item = (ItemKey, Artifact)>>(iter: I) -> Self {
        Self { items: iter.into_iter().collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn item_keys_are_file_names() {
        assert!(ItemKey::new("L1-open-000123").is_ok());
        assert!(ItemKey::new("a.b/c..d./-.x").is_ok());
        for bad in ["", "a b", "../x", "a//b", "ä", ".git", "a/.git/config", ".bashrc", ".", "a/..", "..."] {
            assert!(ItemKey::new(bad).is_err(), "{bad}");
            assert!(serde_json::from_value::<ItemKey>(bad.into()).is_err(), "{bad}, as it is read");
        }
        let said = ItemKey::new("a/.git").expect_err("hidden").to_string();
        assert!(said.contains("`a/.git`") && said.contains("begins with `.`"), "{said}");
        let key = ItemKey::new("x").expect("plain").in_cell("mc_noise+rgb").expect("plain");
        assert_eq!(key.split_cell(), Some(("mc_noise+rgb", "x")));
    }

    #[test]
    fn an_artifact_digest_is_that_of_its_canonical_encoding() {
        let artifact = Artifact::tree("m", [("b".to_owned(), Digest::of(b"b")), ("a".to_owned(), Digest::of(b"a"))]);
        let value = serde_json::to_value(&artifact).expect("plain");
        assert_eq!(artifact.digest(), Digest::of(&canonical_bytes(&value)));
        assert_eq!(serde_json::from_value::<Artifact>(value).expect("own value"), artifact);
        assert_eq!(artifact.part("b"), Some(Digest::of(b"b")));
        assert!(!artifact.parts.contains_key("c"));
    }

    #[test]
    fn names_are_checked_when_they_are_read() {
        let digest = Digest::of(b"a").to_string();
        let read = |media: &str, part: &str| {
            serde_json::from_value::<Artifact>(serde_json::json!({ "media": media, "parts": { part: digest } }))
        };
        assert!(read("tauflow/files", "").is_ok() && read("tauflow/files", "maps/a.png").is_ok());
        for (media, part) in
            [("m", "../x"), ("m", ".ssh/config"), ("m", "/etc/x"), ("m", "a//b"), ("m", "a/./b"), ("", ""), ("a b", "")]
        {
            let error = read(media, part).expect_err("a name that cannot be").to_string();
            assert!(error.contains(if part.is_empty() { media } else { part }), "{error}");
        }
    }

    #[test]
    fn an_item_stays_in_its_shard_below_a_cell() {
        let key = ItemKey::new("L1-open-000123").expect("plain");
        assert_eq!(key.in_cell("mc_noise+rgb").expect("plain").shard(), key.shard());
        let shards: std::collections::BTreeSet<u8> =
            (0..4096).map(|n| ItemKey::new(format!("{n}")).expect("plain").shard()).collect();
        assert_eq!(shards.len(), 256);
    }

    #[test]
    fn digests_see_every_part() {
        let a = Artifact::blob("m", Digest::of(b"a"));
        let b = Artifact::tree("m", [("x".to_owned(), Digest::of(b"a"))]);
        assert_ne!(a.digest(), b.digest());
        let key = |k: &str| ItemKey::new(k).expect("plain");
        let one: Collection = [(key("k"), a.clone())].into_iter().collect();
        let two: Collection = [(key("l"), a)].into_iter().collect();
        assert_ne!(one.digest(), two.digest());
    }
}
