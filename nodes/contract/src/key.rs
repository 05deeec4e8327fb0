//! The key of an action: everything an action reads, and its hash.
//!
//! All keys consist of one struct, [`Basis`], and inputs: keys of actions, whole lanes, their shards, and memoised
//! sub-actions. The key that is hashed and the preimage that `explain` prints are the same struct, so they cannot
//! drift.

use crate::canonical_bytes;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::{borrow::Cow, collections::BTreeMap};
use tauflow_cache::{Digest, Key};

/// Version of the keys' encoding; part of every key, so that caches of before miss.
pub const FORMAT_VERSION: u32 = 2;

/// Everything except inputs that determines an outcome: part of every key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Basis {
    /// [`FORMAT_VERSION`], of keys that this program makes.
    pub format: u32,
    /// The kind's name.
    pub kind: Cow<'static, str>,
    /// The version of what is made.
    pub version: u32,
    /// The output: a group of the kind's output ports, or the name of a memoised sub-action.
    pub group: Cow<'static, str>,
    /// The params that are read.
    pub params: Value,
    /// The seed, for kinds that draw random numbers from one.
    pub seed: Option<u64>,
    /// The properties of the machine that determine the outcome, such as a library; null for most kinds.
    #[serde(default, skip_serializing_if = "Value::is_null")]
    pub environment: Value,
}

impl Basis {
    /// A basis of params alone, without seed and environment.
    pub fn new(kind: impl Into<Cow<'static, str>>, version: u32, group: impl Into<Cow<'static, str>>) -> Self {
        Self {
            format: FORMAT_VERSION,
            kind: kind.into(),
            version,
            group: group.into(),
            params: Value::Null,
            seed: None,
            environment: Value::Null,
        }
    }

    /// The same of other params and another seed.
    pub fn with(&self, params: Value, seed: Option<u64>) -> Self {
        let Self { format, version, .. } = *self;
        let (kind, group, environment) = (self.kind.clone(), self.group.clone(), self.environment.clone());
        Self { format, kind, version, group, params, seed, environment }
    }
}

/// Everything that decides an action's outputs, and nothing else: no node name, item index, path, time, thread count.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ActionKey {
    /// The basis: everything except inputs, such as projected params and the derived seed.
    #[serde(flatten)]
    pub basis: Basis,
    /// Content digests by input port.
    pub inputs: BTreeMap<String, Digest>,
}

impl ActionKey {
    /// The hash of the key's canonical encoding.
    pub fn hash(&self) -> Key {
        Key::of(&canonical_bytes(self))
    }

    /// The key as JSON text, for storing beside its outputs.
    pub fn preimage(&self) -> String {
        serde_json::to_string(self).expect("a key holds only plain values")
    }
}

/// Key of a memoised sub-action: a pure computation inside an action, kept for other actions to find.
///
/// Example: the accumulator of a ladder's samples 0..32, which the gate's preview and the full ladder share.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MemoKey {
    /// The basis: everything except inputs.
    #[serde(flatten)]
    pub basis: Basis,
    /// Content digests it reads.
    pub inputs: Vec<Digest>,
}

impl MemoKey {
    /// The hash of the key's canonical encoding.
    pub fn hash(&self) -> Key {
        Key::of(&canonical_bytes(self))
    }

    /// The name of the sub-action for messages: `kind/group`.
    pub fn name(&self) -> String {
        format!("{}/{}", self.basis.kind, self.basis.group)
    }
}

/// Seed of one item: a function of the pipeline's seed, the kind and the item's key alone.
pub fn derive_seed(pipeline_seed: u64, kind: &str, item: &str) -> u64 {
    let hash = blake3::hash(&canonical_bytes(&(pipeline_seed, kind, item)));
    u64::from_le_bytes(hash.as_bytes()[..8].try_into().expect("a hash has 32 bytes"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn basis(seed: Option<u64>, environment: Value) -> Basis {
        Basis { environment, ..Basis::new("k", 1, "main").with(json!({"b": 1, "a": [0.5, "x"]}), seed) }
    }

    fn action(seed: Option<u64>, environment: Value) -> ActionKey {
        let inputs = BTreeMap::from([("in".into(), Digest::of(b"x"))]);
        ActionKey { basis: basis(seed, environment), inputs }
    }

    #[test]
    fn key_format_is_pinned() {
        // A change here changes every key in every cache: raise FORMAT_VERSION with it.
        let key = action(Some(7), Value::Null);
        assert_eq!(key.hash().to_string(), "3911356a1be3c7b362d075c97bc7fa5e32262b2361cdd6529f8c678b158659f5");
        let memo = MemoKey { basis: basis(None, json!({"library": "a"})), inputs: vec![Digest::of(b"x")] };
        assert_eq!(memo.hash().to_string(), "c023680ca4e931a788d51c452eddacc3dc90e32ae74385543e14b8b38c5e9133");
        assert_eq!(derive_seed(1, "k", "item"), 3_115_506_361_027_966_924);
        // The encoding is that of format 1.
        let before = ActionKey { basis: Basis { format: 1, ..key.basis.clone() }, ..key };
        assert_eq!(before.hash().to_string(), "e6dd5c9a3f849b901f23b0fd71a3376f2553bf60c2b8ab0a557bc463bf6dd703");
    }

    #[test]
    fn every_key_is_hashed_as_its_preimage_says() {
        for seed in [None, Some(0), Some(u64::MAX)] {
            for environment in [Value::Null, json!({"library": "a"})] {
                let key = action(seed, environment.clone());
                let value: Value = serde_json::from_str(&key.preimage()).expect("JSON");
                assert_eq!(key.hash(), Key::of(&canonical_bytes(&value)), "{value}");
                assert_eq!(value["format"], FORMAT_VERSION);
                let back: ActionKey = serde_json::from_str(&key.preimage()).expect("own preimage parses");
                assert_eq!(back, key);
                let memo = MemoKey { basis: key.basis, inputs: vec![Digest::of(b"x"), Digest::of(b"y")] };
                let value = serde_json::to_value(&memo).expect("plain");
                assert_eq!(memo.hash(), Key::of(&canonical_bytes(&value)), "{value}");
                assert_eq!(value["format"], FORMAT_VERSION);
            }
        }
    }

    #[test]
    fn all_of_a_basis_decides_the_key() {
        let key = action(Some(7), Value::Null);
        let others = [
            Basis { format: 1, ..key.basis.clone() },
            Basis { kind: "l".into(), ..key.basis.clone() },
            Basis { version: 2, ..key.basis.clone() },
            Basis { group: "other".into(), ..key.basis.clone() },
            Basis { params: Value::Null, ..key.basis.clone() },
            Basis { seed: None, ..key.basis.clone() },
            Basis { environment: json!("a card"), ..key.basis.clone() },
        ];
        for basis in others {
            let other = ActionKey { basis, ..key.clone() };
            assert_ne!(other.hash(), key.hash(), "{other:?}");
        }
    }
}
