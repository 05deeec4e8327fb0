//! Action keys: what an action reads, and its hash.
//!
//! The key that is hashed and the preimage that `explain` prints are the same struct, so they cannot drift.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use tauflow_cache::{Digest, Key};

/// Version of the key's encoding; part of every key.
pub const FORMAT_VERSION: u32 = 1;

/// Everything that decides an action's outputs, and nothing else: no node name, item index, path, time, thread count.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ActionKey {
    /// What of the machine decides the outputs, such as a library that was found; null for most kinds.
    #[serde(default, skip_serializing_if = "Value::is_null")]
    pub environment: Value,
    /// [`FORMAT_VERSION`].
    pub format: u32,
    /// The kind's name.
    pub kind: String,
    /// The kind's version.
    pub version: u32,
    /// The group of output ports that this action makes.
    pub group: String,
    /// The params this action reads.
    pub params: Value,
    /// Content digests by input port.
    pub inputs: BTreeMap<String, Digest>,
    /// The derived seed, for kinds that draw random numbers from it.
    pub seed: Option<u64>,
}

impl ActionKey {
    /// The hash of the key's canonical encoding.
    pub fn hash(&self) -> Key {
        // What `canonical_bytes` makes of this struct as a value, without making the value; a test holds the two together.
        let mut out = Vec::with_capacity(512);
        let number = |n: i64, out: &mut Vec<u8>| {
            out.push(b'i');
            out.extend(n.to_le_bytes());
        };
        out.push(b'o');
        let there = !self.environment.is_null();
        out.extend((7 + u64::from(there)).to_le_bytes());
        if there {
            encode_text(b'k', "environment", &mut out);
            encode(&self.environment, &mut out);
        }
        encode_text(b'k', "format", &mut out);
        number(i64::from(self.format), &mut out);
        encode_text(b'k', "group", &mut out);
        encode_text(b's', &self.group, &mut out);
        encode_text(b'k', "inputs", &mut out);
        out.push(b'o');
        out.extend((self.inputs.len() as u64).to_le_bytes());
        for (port, digest) in &self.inputs {
            encode_text(b'k', port, &mut out);
            encode_text(b's', &digest.to_string(), &mut out);
        }
        encode_text(b'k', "kind", &mut out);
        encode_text(b's', &self.kind, &mut out);
        encode_text(b'k', "params", &mut out);
        encode(&self.params, &mut out);
        encode_text(b'k', "seed", &mut out);
        match self.seed.map(i64::try_from) {
            None => out.push(b'n'),
            Some(Ok(seed)) => number(seed, &mut out),
            Some(Err(_)) => {
                out.push(b'u');
                out.extend(self.seed.unwrap_or_default().to_le_bytes());
            }
        }
        encode_text(b'k', "version", &mut out);
        number(i64::from(self.version), &mut out);
        Key::of(&out)
    }

    /// The key as JSON text, for storing beside its outputs.
    pub fn preimage(&self) -> String {
        serde_json::to_string(self).expect("a key holds only plain values")
    }
}

/// Canonical, typed, length-prefixed encoding of a JSON value: equal values give equal bytes, different values
/// different bytes. Object keys are sorted; integers and floats are told apart by type, `-0.0` is `0.0`.
pub fn canonical_bytes(value: &Value) -> Vec<u8> {
    let mut out = Vec::new();
    encode(value, &mut out);
    out
}

/// A text, or the name of a field.
pub(crate) fn encode_text(tag: u8, text: &str, out: &mut Vec<u8>) {
    out.push(tag);
    out.extend((text.len() as u64).to_le_bytes());
    out.extend(text.as_bytes());
}

fn encode(value: &Value, out: &mut Vec<u8>) {
    match value {
        Value::Null => out.push(b'n'),
        Value::Bool(b) => out.extend([b'b', u8::from(*b)]),
        Value::Number(n) => {
            if let Some(i) = n.as_i64() {
                out.push(b'i');
                out.extend(i.to_le_bytes());
            } else if let Some(u) = n.as_u64() {
                out.push(b'u');
                out.extend(u.to_le_bytes());
            } else {
                // `+ 0.0` turns -0.0 into 0.0; serde_json holds no NaN.
                let f = n.as_f64().unwrap_or(0.0) + 0.0;
                out.push(b'f');
                out.extend(f.to_bits().to_le_bytes());
            }
        }
        Value::String(s) => encode_text(b's', s, out),
        Value::Array(items) => {
            out.push(b'a');
            out.extend((items.len() as u64).to_le_bytes());
            items.iter().for_each(|item| encode(item, out));
        }
        Value::Object(fields) => {
            let sorted: BTreeMap<_, _> = fields.iter().collect();
            out.push(b'o');
            out.extend((sorted.len() as u64).to_le_bytes());
            for (name, field) in sorted {
                encode_text(b'k', name, out);
                encode(field, out);
            }
        }
    }
}

/// Seed of one item: a function of the pipeline's seed, the kind and the item's key alone.
pub fn derive_seed(pipeline_seed: u64, kind: &str, item: &str) -> u64 {
    let value = serde_json::json!([pipeline_seed, kind, item]);
    let hash = blake3::hash(&canonical_bytes(&value));
    u64::from_le_bytes(hash.as_bytes()[..8].try_into().expect("a hash has 32 bytes"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn encoding_tells_types_and_lengths_apart() {
        let values = [
            json!(1),
            json!(1.0),
            json!("1"),
            json!(["1"]),
            json!([["1"]]),
            json!({"1": 1}),
            json!(["a", "b"]),
            json!(["ab"]),
            json!(null),
            json!(false),
            json!(0),
        ];
        for (i, a) in values.iter().enumerate() {
            for (j, b) in values.iter().enumerate() {
                assert_eq!(i == j, canonical_bytes(a) == canonical_bytes(b), "{a} {b}");
            }
        }
        assert_eq!(canonical_bytes(&json!(-0.0)), canonical_bytes(&json!(0.0)));
    }

    #[test]
    fn key_format_is_pinned() {
        let key = ActionKey {
            environment: Value::Null,
            format: FORMAT_VERSION,
            kind: "k".into(),
            version: 1,
            group: "main".into(),
            params: json!({"b": 1, "a": [0.5, "x"]}),
            inputs: BTreeMap::from([("in".into(), Digest::of(b"x"))]),
            seed: Some(7),
        };
        // A change here changes every key in every cache: raise FORMAT_VERSION with it.
        assert_eq!(key.hash().to_string(), "e6dd5c9a3f849b901f23b0fd71a3376f2553bf60c2b8ab0a557bc463bf6dd703");
        for (seed, environment) in
            [(None, json!(null)), (Some(0), json!({"library": "a"})), (Some(u64::MAX), json!(null))]
        {
            let key = ActionKey { seed, environment, ..key.clone() };
            let value = serde_json::to_value(&key).expect("plain");
            assert_eq!(key.hash(), Key::of(&canonical_bytes(&value)), "{seed:?}");
        }
        let mut other = key.clone();
        other.seed = None;
        assert_ne!(key.hash(), other.hash());
        let back: ActionKey = serde_json::from_str(&key.preimage()).expect("own preimage parses");
        assert_eq!(back.hash(), key.hash());
    }
}
