//! A record of the action log, and its encoding.
//!
//! The store interprets the namespace, the key, the label, the costs and the referenced blobs; preimage and payload are
//! opaque texts.

use crate::{
    Digest, Key,
    codec::{Fields, Put},
};

/// The record of one finished action.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// The type of the key: `action`, `rollup`, `memo`. Keys of different namespaces never meet.
    pub namespace: String,
    /// Key within the namespace.
    pub key: Key,
    /// The label by which `explain` finds similar records, such as the kind's name.
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
    /// Its outputs were handed on in memory: blobs that it names need not be there, and are not lost if they are not.
    pub transient: bool,
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
    /// The machine and program that made it, in words; empty if unknown. No part of what makes two records equal.
    pub maker: String,
    /// It came from [beyond](crate::Store::look_beyond): its outputs were claimed elsewhere.
    pub fetched: bool,
}

/// The result of [`Store::record`](crate::Store::record).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Recorded {
    /// The record is new.
    New,
    /// A record with this key and the same payload was there already.
    Same,
    /// A record with this key and *another* payload is there. It stays; the new one was not written.
    Conflict {
        /// The record that stays.
        existing: Box<Record>,
    },
}

/// The highest generation there is. No record comes by it honestly; one that says more is damaged.
pub(crate) const MOST_GENERATION: u32 = 1 << 31;

/// The generation of a record that takes the place of one of this generation.
pub(crate) fn after(generation: u32) -> u32 {
    generation.saturating_add(1).min(MOST_GENERATION)
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
            generation: fields.u32().filter(|generation| *generation <= MOST_GENERATION)?,
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
    let flags = [record.derived, record.transient, record.fetched, !record.maker.is_empty()];
    out.u8(flags.iter().rev().fold(0, |bits, flag| bits << 1 | u8::from(*flag)));
    out.text(&record.preimage);
    out.text(&record.payload);
    out.text(&record.recipe);
    if !record.maker.is_empty() {
        out.text(&record.maker);
    }
    out
}

/// The part of a record that collections and verification look at.
pub(crate) struct Reach<'a> {
    pub head: Head<'a>,
    pub refs: Vec<Digest>,
    pub trees: Vec<Digest>,
    pub derived: bool,
    pub transient: bool,
}

/// Whether a record is derived, is transient, was fetched, and names its maker.
fn flags(fields: &mut Fields<'_>) -> Option<[bool; 4]> {
    let flags = fields.u8().filter(|flags| *flags < 16)?;
    Some([1, 2, 4, 8].map(|bit| flags & bit != 0))
}

/// The digests of an encoded record; cheaper than decoding all of it.
pub(crate) fn decode_reach(bytes: &[u8]) -> Option<Reach<'_>> {
    let mut fields = Fields(bytes);
    let head = Head::decode(&mut fields)?;
    let (refs, trees) = (fields.digests()?, fields.digests()?);
    let [derived, transient, ..] = flags(&mut fields)?;
    Some(Reach { head, refs, trees, derived, transient })
}

pub(crate) fn decode(bytes: &[u8]) -> Option<Record> {
    let mut fields = Fields(bytes);
    let head = Head::decode(&mut fields)?;
    let (refs, trees) = (fields.digests()?, fields.digests()?);
    let [derived, transient, fetched, names_maker] = flags(&mut fields)?;
    Some(Record {
        namespace: head.namespace.to_owned(),
        key: head.key,
        label: head.label.to_owned(),
        preimage: fields.text()?.to_owned(),
        payload: fields.text()?.to_owned(),
        recipe: fields.text()?.to_owned(),
        maker: if names_maker { fields.text()?.to_owned() } else { String::new() },
        fetched,
        refs,
        trees,
        derived,
        transient,
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
            transient: false,
            refs: vec![Digest::of(b"x"), Digest::of(b"yy")],
            trees: vec![Digest::of(b"zzz")],
            wall_us: 3,
            bytes: 4,
            when: 5,
            maker: "host".into(),
            fetched: false,
        };
        let head = Head::of(&record, 7, 9);
        let bytes = encode(&head, &record);
        assert_eq!(decode(&bytes).as_ref(), Some(&record));
        let Reach { head, refs, trees, derived, .. } = decode_reach(&bytes).expect("own bytes");
        assert_eq!((head.generation, head.origin, refs, trees, derived), (7, 9, record.refs, record.trees, true));
        assert!((0..bytes.len()).all(|n| decode(&bytes[..n]).is_none()));
    }

    #[test]
    fn flags_are_told_apart() {
        let record = crate::Record {
            namespace: "action".into(),
            key: Key::of(b"k"),
            label: "l".into(),
            preimage: String::new(),
            payload: String::new(),
            recipe: String::new(),
            derived: false,
            transient: false,
            refs: Vec::new(),
            trees: Vec::new(),
            wall_us: 0,
            bytes: 0,
            when: 0,
            maker: String::new(),
            fetched: false,
        };
        for bits in 0..16_u8 {
            let [derived, transient, fetched, named] = [1, 2, 4, 8].map(|bit| bits & bit != 0);
            let maker = if named { "host".into() } else { String::new() };
            let record = Record { derived, transient, fetched, maker, ..record.clone() };
            let bytes = encode(&Head::of(&record, 0, 0), &record);
            assert_eq!(decode(&bytes), Some(record));
            let reach = decode_reach(&bytes).expect("own bytes");
            assert_eq!((reach.derived, reach.transient), (derived, transient));
        }
    }

    #[test]
    fn a_generation_that_nothing_could_supersede_is_damage() {
        assert_eq!(
            (after(0), after(MOST_GENERATION - 1), after(MOST_GENERATION)),
            (1, MOST_GENERATION, MOST_GENERATION)
        );
        let head = |generation| Head {
            namespace: "action",
            label: "l",
            key: Key::of(b"k"),
            generation,
            origin: 0,
            sum: 0,
            wall_us: 0,
            bytes: 0,
            when: 0,
        };
        let read = |generation: u32| {
            let mut bytes = Vec::new();
            head(generation).encode(&mut bytes);
            Head::decode(&mut Fields(&bytes)).map(|head| head.generation)
        };
        assert_eq!(read(MOST_GENERATION), Some(MOST_GENERATION));
        assert_eq!((read(MOST_GENERATION + 1), read(u32::MAX)), (None, None));
    }
}
