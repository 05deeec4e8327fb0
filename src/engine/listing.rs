//! The text of a listing: the items or shards of a collection.
//!
//! Listings can come from other people and are untrusted. It is read row by row, and nothing is taken for rows that are
//! out of order, more than were named, or not what the port holds.

use super::output::{Items, Output};
use serde::{
    Deserialize, Serialize,
    de::{DeserializeSeed, Deserializer, EnumAccess, Error, SeqAccess, VariantAccess, Visitor},
};
use std::{fmt, sync::Arc, vec::IntoIter};
use tauflow_cache::{Digest, tree};
use tauflow_contract::{Any, Artifact, ItemKey, Parts};

/// Most rows of one listing. A collection has 256 of them, each with about as many.
pub const MOST_ROWS: u64 = 1 << 20;
/// Most items of a collection: a run holds them all in memory.
pub const MOST_ITEMS: u64 = 1 << 25;

/// The body of a listing, besides its blobs.
#[derive(Serialize)]
enum Body<'a> {
    /// Key, media type and names of parts of each item; the tree's blobs are those of the parts, in this order.
    Items(Vec<(&'a ItemKey, &'a str, Vec<&'a str>)>),
    /// Number, items and content digest of each shard; the tree's trees list them, in this order.
    Shards(&'a [Row]),
}

/// Number, items and content digest of a shard.
pub type Row = (u8, u64, Digest);

/// The content of a listing.
pub enum Listing {
    /// Items, in the order of their keys.
    Items(Items),
    /// Shards, in the order of their numbers, each with the blob that lists it.
    Shards(Vec<(Row, Digest)>),
}

/// The listing of items.
pub fn of_items<'a>(items: impl IntoIterator<Item = &'a (ItemKey, Arc<Output>)>) -> Vec<u8> {
    let mut items: Vec<_> = items.into_iter().collect();
    items.sort_by(|a, b| a.0.cmp(&b.0));
    let (mut refs, mut rows) = (Vec::new(), Vec::with_capacity(items.len()));
    for (key, output) in items {
        let parts = &output.artifact.parts;
        refs.extend(parts.values().copied());
        rows.push((key, output.artifact.media.as_str(), parts.keys().map(String::as_str).collect()));
    }
    tree::encode(&refs, &[], &bytes(&Body::Items(rows)))
}

/// The listing of shards, and the blobs that list each.
pub fn of_shards(rows: &[Row], trees: &[Digest]) -> Vec<u8> {
    tree::encode(&[], trees, &bytes(&Body::Shards(rows)))
}

fn bytes(body: &Body<'_>) -> Vec<u8> {
    serde_json::to_vec(body).expect("keys and digests always serialise")
}

/// Reads a listing of `len` items of a media type, `*` for any; none if it is no such listing.
pub fn read(bytes: &[u8], len: u64, media: &str) -> Option<Listing> {
    let tree = tree::decode(bytes)?;
    let mut text = serde_json::Deserializer::from_slice(tree.body);
    let most = len.min(MOST_ROWS);
    let seed = BodySeed { rows: Rows { refs: tree.refs.into_iter(), most, media }, trees: tree.trees };
    let listing = seed.deserialize(&mut text).ok()?;
    text.end().ok()?;
    let listed = match &listing {
        Listing::Items(items) => items.len() as u64,
        Listing::Shards(shards) => shards.iter().try_fold(0_u64, |sum, ((_, len, _), _)| sum.checked_add(*len))?,
    };
    (listed == len && len <= MOST_ITEMS).then_some(listing)
}

/// Reads a `Body`.
struct BodySeed<'m> {
    rows: Rows<'m>,
    trees: Vec<Digest>,
}

#[derive(Deserialize)]
enum Variant {
    Items,
    Shards,
}

impl<'de> DeserializeSeed<'de> for BodySeed<'_> {
    type Value = Listing;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Listing, D::Error> {
        deserializer.deserialize_enum("Body", &["Items", "Shards"], self)
    }
}

impl<'de> Visitor<'de> for BodySeed<'_> {
    type Value = Listing;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("items or shards")
    }

    fn visit_enum<A: EnumAccess<'de>>(self, body: A) -> Result<Listing, A::Error> {
        match body.variant()? {
            (Variant::Items, rows) if self.trees.is_empty() => rows.newtype_variant_seed(self.rows).map(Listing::Items),
            (Variant::Shards, rows) if self.rows.refs.as_slice().is_empty() => {
                rows.newtype_variant_seed(Shards(self.trees.into_iter())).map(Listing::Shards)
            }
            _ => Err(A::Error::custom("it lists what its rows do not name")),
        }
    }
}

/// Reads rows of items, of which there are `most`; their parts are the `refs`.
struct Rows<'m> {
    refs: IntoIter<Digest>,
    most: u64,
    media: &'m str,
}

impl<'de> DeserializeSeed<'de> for Rows<'_> {
    type Value = Items;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Items, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Rows<'_> {
    type Value = Items;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("rows of items")
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut rows: A) -> Result<Items, A::Error> {
        let mut items = Items::new();
        while let Some((key, artifact)) = rows.next_element_seed(ItemRow { refs: &mut self.refs, media: self.media })? {
            if items.len() as u64 >= self.most {
                return Err(A::Error::custom("there are more rows than were named"));
            }
            if items.last().is_some_and(|(last, _)| *last >= key) {
                return Err(A::Error::custom("the keys are out of order"));
            }
            items.push((key, Output::new(artifact)));
        }
        if !self.refs.as_slice().is_empty() {
            return Err(A::Error::custom("it lists what its rows do not name"));
        }
        Ok(items)
    }
}

/// Reads one row of an item.
struct ItemRow<'a> {
    refs: &'a mut IntoIter<Digest>,
    media: &'a str,
}

impl<'de> DeserializeSeed<'de> for ItemRow<'_> {
    type Value = (ItemKey, Artifact);

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_tuple(3, self)
    }
}

impl<'de> Visitor<'de> for ItemRow<'_> {
    type Value = (ItemKey, Artifact);

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("key, media type and names of parts")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut row: A) -> Result<Self::Value, A::Error> {
        let short = || A::Error::custom("a row is cut off");
        let key: ItemKey = row.next_element()?.ok_or_else(short)?;
        let media: String = row.next_element()?.ok_or_else(short)?;
        if self.media != Any::NAME && media != self.media {
            return Err(A::Error::custom("an item is of another media type than its port"));
        }
        let parts = row.next_element_seed(PartNames(self.refs))?.ok_or_else(short)?;
        // Names are put together here, and so are checked here.
        let artifact = Artifact { media, parts };
        artifact.check_names().map_err(A::Error::custom)?;
        Ok((key, artifact))
    }
}

/// Reads names of parts, each of which takes the next blob.
struct PartNames<'a>(&'a mut IntoIter<Digest>);

impl<'de> DeserializeSeed<'de> for PartNames<'_> {
    type Value = Parts;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Parts, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for PartNames<'_> {
    type Value = Parts;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("names of parts")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut names: A) -> Result<Parts, A::Error> {
        let mut parts: Vec<(String, Digest)> = Vec::with_capacity(1);
        while let Some(name) = names.next_element::<String>()? {
            if parts.last().is_some_and(|(last, _)| *last >= name) {
                return Err(A::Error::custom("the parts are out of order"));
            }
            let digest = self.0.next().ok_or_else(|| A::Error::custom("there are more parts than blobs"))?;
            parts.push((name, digest));
        }
        Ok(parts.into_iter().collect())
    }
}

/// Reads rows of shards, each of which takes the next tree.
struct Shards(IntoIter<Digest>);

impl<'de> DeserializeSeed<'de> for Shards {
    type Value = Vec<(Row, Digest)>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Shards {
    type Value = Vec<(Row, Digest)>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("rows of shards")
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut rows: A) -> Result<Self::Value, A::Error> {
        let mut shards: Self::Value = Vec::new();
        while let Some(row) = rows.next_element::<Row>()? {
            if shards.last().is_some_and(|((last, ..), _)| *last >= row.0) {
                return Err(A::Error::custom("the shards are out of order"));
            }
            let tree = self.0.next().ok_or_else(|| A::Error::custom("there are more shards than listings"))?;
            shards.push((row, tree));
        }
        if !self.0.as_slice().is_empty() {
            return Err(A::Error::custom("it lists what its rows do not name"));
        }
        Ok(shards)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn blob(n: u8) -> Digest {
        Digest::of(&[n])
    }

    /// The content read from rows with the given number of blobs and trees.
    fn rows_read(body: &serde_json::Value, blobs: u8, trees: u8, len: u64) -> Option<Listing> {
        let (refs, trees): (Vec<_>, Vec<_>) = ((0..blobs).map(blob).collect(), (0..trees).map(blob).collect());
        read(&tree::encode(&refs, &trees, body.to_string().as_bytes()), len, "m")
    }

    #[test]
    fn items_are_read_as_they_stand_and_no_others() {
        let good = json!({"Items": [["a", "m", [""]], ["b", "m", ["x", "y"]]]});
        let Some(Listing::Items(items)) = rows_read(&good, 3, 0, 2) else { panic!("it is a listing") };
        let parts = |n: usize| items[n].1.artifact.parts.values().copied().collect::<Vec<_>>();
        assert_eq!((items[0].0.as_str(), parts(0)), ("a", vec![blob(0)]));
        assert_eq!((items[1].0.as_str(), parts(1)), ("b", vec![blob(1), blob(2)]));
        assert!(rows_read(&good, 3, 0, 1).is_none(), "more than were named");
        assert!(rows_read(&good, 3, 0, 3).is_none(), "fewer than were named");
        assert!(rows_read(&good, 2, 0, 2).is_none(), "more parts than blobs");
        assert!(rows_read(&good, 4, 0, 2).is_none(), "more blobs than parts");
        assert!(rows_read(&good, 3, 1, 2).is_none(), "a tree that no row names");
        for (what, rows) in [
            ("out of order", json!([["b", "m", ["x"]], ["a", "m", ["", "y"]]])),
            ("double", json!([["a", "m", ["x"]], ["a", "m", ["", "y"]]])),
            ("parts out of order", json!([["a", "m", ["x"]], ["b", "m", ["y", "x"]]])),
            ("a part twice", json!([["a", "m", ["x"]], ["b", "m", ["y", "y"]]])),
            ("another media type", json!([["a", "m", ["x"]], ["b", "n", ["", "y"]]])),
            ("a key that leads away", json!([["../a", "m", ["x"]], ["b", "m", ["", "y"]]])),
            ("a hidden key", json!([[".git/a", "m", ["x"]], ["b", "m", ["", "y"]]])),
            ("a part that leads away", json!([["a", "m", ["../x"]], ["b", "m", ["", "y"]]])),
            ("cut off", json!([["a", "m", ["x"]], ["b", "m"]])),
            ("no row", json!([["a", "m", ["x"]], 7])),
            ("no rows", json!(7)),
        ] {
            assert!(rows_read(&json!({ "Items": rows }), 3, 0, 2).is_none(), "{what}");
        }
        assert!(rows_read(&json!({"Items": [], "Shards": []}), 0, 0, 0).is_none());
        assert!(rows_read(&json!({"Things": []}), 0, 0, 0).is_none());
        assert!(read(b"no tree", 0, "m").is_none());
    }

    #[test]
    fn shards_add_up_and_come_once() {
        let row = |number: u64, len: u64| json!([number, len, blob(9).to_string()]);
        let shards = |rows: &[serde_json::Value], len: u64| rows_read(&json!({ "Shards": rows }), 0, 2, len);
        let Some(Listing::Shards(read)) = shards(&[row(0, 3), row(255, 4)], 7) else { panic!("it is a listing") };
        assert_eq!(read, [((0, 3, blob(9)), blob(0)), ((255, 4, blob(9)), blob(1))]);
        assert!(shards(&[row(0, 3), row(255, 4)], 8).is_none(), "they do not add up");
        assert!(shards(&[row(0, u64::MAX), row(1, 8)], 7).is_none(), "they add up beyond all numbers");
        assert!(shards(&[row(0, MOST_ITEMS), row(1, 1)], MOST_ITEMS + 1).is_none(), "more than a run holds");
        assert!(shards(&[row(1, 3), row(0, 4)], 7).is_none(), "out of order");
        assert!(shards(&[row(1, 3), row(1, 4)], 7).is_none(), "double");
        assert!(shards(&[row(1, 3), row(256, 4)], 7).is_none(), "there are 256");
        assert!(shards(&[row(1, 7)], 7).is_none(), "a listing of no shard");
        assert!(shards(&[row(1, 3), row(2, 3), row(3, 1)], 7).is_none(), "a shard without a listing");
    }
}
