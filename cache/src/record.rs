//! A record of the action log, and its bytes.
//!
//! The store reads the namespace, the key, the label, the costs and the blobs
//! reached; preimage and payload are texts that it hands back untouched.

use crate::{
    Digest, Key,
    codec::{Fields, Put},
};

/// What one finished action left behind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// What sort of key this is: `action`, `rollup`, `memo`.  Keys of different namespaces never meet.
    pub namespace: String,
    /// Key within the namespace.
    pub key: Key,
    /// What `explain` searches near runs by, such as the kind's name.
    pub label: String,
    /// JSON text of what was hashed into the key.
    pub preimage: String,
    /// JSON text of the outputs; opaque to the store.
    pub payload: String,
    /// JSON text of what it takes to do the action again; opaque to the store, and no part of what makes two records
    /// equal.
    pub recipe: String,
    /// It only sums other records up: it costs nothing to make again, whatever its wall time says.
    pub derived: bool,
    /// Blobs that the payload reaches: what garbage collection keeps alive for it.
    pub refs: Vec<Digest>,
    /// Blobs made by [`tree::encode`](crate::tree::encode) that it reaches, with all that they list.
    pub trees: Vec<Digest>,
    /// Wall time of the action, in microseconds.
    pub wall_us: u64,
    /// Bytes that the action made.
    pub bytes: u64,
    /// When it finished, in unix seconds, by the caller's clock.
    pub when: u64,
}

/// What [`Store::record`](crate::Store::record) did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Recorded {
    /// The record is new.
    New,
    /// A record with this key and the same payload was there already.
    Same,
    /// A record with this key and *another* payload is there.  It stays; the new one was not written.
    Conflict {
        /// The record that stays.
        existing: Box<Record>,
    },
}

/// The part of a record that the index holds in memory.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Head<'a> {
    pub namespace: &'a str,
    pub label: &'a str,
    pub key: Key,
    /// How often the key was explicitly superseded; the highest wins.
    pub generation: u32,
    /// Sequence number of the log segment that the record was first written to; the lowest wins.
    pub origin: u64,
    /// First eight bytes of the payload's blake3.
    pub sum: u64,
    pub wall_us: u64,
    pub bytes: u64,
    pub when: u64,
}

/// First eight bytes of the blake3 of `bytes`, as a number.
pub(crate) fn sum(bytes: &[u8]) -> u64 {
    let hash = blake3::hash(bytes);
    Fields(hash.as_bytes()).u64().unwrap_or_default() // a hash has 32 bytes
}

impl<'a> Head<'a> {
    pub fn of(record: &'a Record, generation: u32, origin: u64) -> Self {
        Self {
            namespace: &record.namespace,
            label: &record.label,
            key: record.key,
            generation,
            origin,
            sum: sum(record.payload.as_bytes()),
            wall_us: record.wall_us,
            bytes: record.bytes,
            when: record.when,
        }
    }

    pub fn encode(&self, out: &mut Vec<u8>) {
        out.text(self.namespace);
        out.text(self.label);
        out.extend_from_slice(&self.key.0);
        out.u32(self.generation);
        for value in [self.origin, self.sum, self.wall_us, self.bytes, self.when] {
            out.u64(value);
        }
    }

    pub fn decode(fields: &mut Fields<'a>) -> Option<Self> {
        Some(Self {
            namespace: fields.text()?,
            label: fields.text()?,
            key: Key(fields.array()?),
            generation: fields.u32()?,
            origin: fields.u64()?,
            sum: fields.u64()?,
            wall_us: fields.u64()?,
            bytes: fields.u64()?,
            when: fields.u64()?,
        })
    }
}

/// The bytes of a record: head, blobs reached, trees, preimage, payload.
pub(crate) fn encode(head: &Head<'_>, record: &Record) -> Vec<u8> {
    let digests = record.refs.len() + record.trees.len();
    let mut out = Vec::with_capacity(160 + digests * 40 + record.preimage.len() + record.payload.len());
    head.encode(&mut out);
    out.digests(&record.refs);
    out.digests(&record.trees);
    out.u8(u8::from(record.derived));
    out.text(&record.preimage);
    out.text(&record.payload);
    out.text(&record.recipe);
    out
}

/// The part of a record that collections and verification look at.
pub(crate) struct Reach<'a> {
    pub head: Head<'a>,
    pub refs: Vec<Digest>,
    pub trees: Vec<Digest>,
    pub derived: bool,
}

/// What an encoded record reaches; cheaper than all of it.
pub(crate) fn decode_reach(bytes: &[u8]) -> Option<Reach<'_>> {
    let mut fields = Fields(bytes);
    let head = Head::decode(&mut fields)?;
    Some(Reach { head, refs: fields.digests()?, trees: fields.digests()?, derived: fields.u8()? != 0 })
}

pub(crate) fn decode(bytes: &[u8]) -> Option<Record> {
    let mut fields = Fields(bytes);
    let head = Head::decode(&mut fields)?;
    let (refs, trees, derived) = (fields.digests()?, fields.digests()?, fields.u8()? != 0);
    Some(Record {
        namespace: head.namespace.to_owned(),
        key: head.key,
        label: head.label.to_owned(),
        preimage: fields.text()?.to_owned(),
        payload: fields.text()?.to_owned(),
        recipe: fields.text()?.to_owned(),
        refs,
        trees,
        derived,
        wall_us: head.wall_us,
        bytes: head.bytes,
        when: head.when,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_round_trip_and_every_prefix_is_refused() {
        let record = Record {
            namespace: "action".into(),
            key: Key::of(b"k"),
            label: "ladder".into(),
            preimage: "{\"a\":1}".into(),
            payload: "[]".into(),
            recipe: "{}".into(),
            derived: true,
            refs: vec![Digest::of(b"x"), Digest::of(b"yy")],
            trees: vec![Digest::of(b"zzz")],
            wall_us: 3,
            bytes: 4,
            when: 5,
        };
        let head = Head::of(&record, 7, 9);
        let bytes = encode(&head, &record);
        assert_eq!(decode(&bytes).as_ref(), Some(&record));
        let Reach { head, refs, trees, derived } = decode_reach(&bytes).expect("own bytes");
        assert_eq!((head.generation, head.origin, refs, trees, derived), (7, 9, record.refs, record.trees, true));
        assert!((0..bytes.len()).all(|n| decode(&bytes[..n]).is_none()));
    }
}
