//! Artifacts, and collections of them.

use crate::key::canonical_bytes;
use serde::{Deserialize, Serialize};
use std::{borrow::Borrow, collections::BTreeMap, fmt, sync::Arc};
use tauflow_cache::Digest;

/// Stable key of an item in a collection, such as `L1-open-000123`.
///
/// Keys are ASCII letters, digits, `.`, `_`, `-`, `=`, `+` and `/` (the slash parts a matrix cell from the item),
/// so that they serve as file names; cheap to clone.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct ItemKey(Arc<str>);

/// A text that cannot be an item key.
#[derive(Debug, thiserror::Error)]
#[error(
    "`{0}` cannot be an item key: use 1 to 200 ASCII letters, digits, `.`, `_`, `-`, `=`, `+` or `/`, with no empty or dotted part"
)]
pub struct ItemKeyError(String);

impl ItemKey {
    /// Checks `text` and makes a key of it.
    ///
    /// # Errors
    /// If the text is empty, too long, or holds a character outside the set above.
    pub fn new(text: impl Into<String>) -> Result<Self, ItemKeyError> {
        let text = text.into();
        let fine = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'_' | b'-' | b'=' | b'+' | b'/');
        let parts_fine = text.split('/').all(|p| !p.is_empty() && p != "." && p != "..");
        if text.is_empty() || text.len() > 200 || !text.bytes().all(fine) || !parts_fine {
            return Err(ItemKeyError(text));
        }
        Ok(Self(text.into()))
    }

    /// The key's text.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The key below a matrix cell: `cell/key`.
    pub fn in_cell(&self, cell: &str) -> Result<Self, ItemKeyError> {
        Self::new(format!("{cell}/{}", self.0))
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
/// A single blob is a tree whose only part has the empty name.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Artifact {
    /// What the bytes are, e.g. `tauflow/ladder`.
    pub media: String,
    /// Parts by name; names follow the rules of [`ItemKey`] or are empty.
    pub parts: BTreeMap<String, Digest>,
}

impl Artifact {
    /// An artifact of a single blob.
    pub fn blob(media: impl Into<String>, digest: Digest) -> Self {
        Self { media: media.into(), parts: BTreeMap::from([(String::new(), digest)]) }
    }

    /// An artifact of named parts.
    pub fn tree(media: impl Into<String>, parts: impl IntoIterator<Item = (String, Digest)>) -> Self {
        Self { media: media.into(), parts: parts.into_iter().collect() }
    }

    /// The digest of a part, if it is there; the empty name is the single blob.
    pub fn part(&self, name: &str) -> Option<Digest> {
        self.parts.get(name).copied()
    }

    /// Content digest of the whole artifact: of its canonical encoding, which names every part's digest.
    pub fn digest(&self) -> Digest {
        let value = serde_json::to_value(self).expect("strings and digests always serialise");
        Digest::of(&canonical_bytes(&value))
    }

    /// Sum of the parts' sizes in bytes.
    pub fn size(&self) -> u64 {
        self.parts.values().map(|d| d.size).sum()
    }
}

/// An ordered map from item key to artifact.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct Collection {
    /// The items, in key order.
    pub items: BTreeMap<ItemKey, Artifact>,
}

impl Collection {
    /// Content digest of the collection: over every item's key and artifact digest.
    pub fn digest(&self) -> Digest {
        let mut bytes = b"tauflow-collection-1".to_vec();
        for (key, artifact) in &self.items {
            let digest = artifact.digest();
            bytes.extend((key.as_str().len() as u64).to_le_bytes());
            bytes.extend(key.as_str().as_bytes());
            bytes.extend(digest.hash);
            bytes.extend(digest.size.to_le_bytes());
        }
        Digest::of(&bytes)
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
        for bad in ["", "a b", "../x", "a//b", "ä"] {
            assert!(ItemKey::new(bad).is_err(), "{bad}");
        }
        let key = ItemKey::new("x").expect("plain").in_cell("mc_noise+rgb").expect("plain");
        assert_eq!(key.split_cell(), Some(("mc_noise+rgb", "x")));
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
