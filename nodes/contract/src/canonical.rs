//! The canonical encoding, from which keys and content digests are hashed.
//!
//! It is typed and length-prefixed: equal values give equal bytes, different values different bytes. A null is `n`. A
//! truth value is `b` and a byte. A number is `i`, `u` or `f` and eight little-endian bytes, where `-0.0` is `0.0`. A
//! text is `s`, a length of eight bytes and the text. A list is `a`, a count and the values. An object is `o`, a count
//! and its fields, sorted by name: `k`, a length and the name, then the value. `docs/action_record.md` documents it.
//!
//! A struct is written as it goes by, without making a JSON value of it first: actions have a key each.

mod compound;
mod encoder;

use encoder::Encoder;
use serde::{Serialize, ser::Error};
use std::fmt;

/// The canonical encoding of what `value` is as JSON.
///
/// # Panics
/// If `value` has no JSON: a map whose keys are no texts, or an object that has a field twice. Keys hold plain values.
pub fn canonical_bytes<T: Serialize + ?Sized>(value: &T) -> Vec<u8> {
    let mut out = Vec::with_capacity(512);
    value.serialize(Encoder { out: &mut out }).expect("keys hold only plain values");
    out
}

/// The value that cannot be encoded, in words.
#[derive(Debug)]
struct NotPlain(String);

impl fmt::Display for NotPlain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for NotPlain {}

impl Error for NotPlain {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self(message.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};
    use std::collections::BTreeMap;

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

    /// Every byte of a small object, by hand: `{"a": [true, -2], "b": "x"}`.
    #[test]
    fn bytes_are_pinned() {
        let mut expected = b"o\x02\0\0\0\0\0\0\0".to_vec();
        expected.extend(b"k\x01\0\0\0\0\0\0\0a");
        expected.extend(b"a\x02\0\0\0\0\0\0\0");
        expected.extend(b"b\x01");
        expected.extend(b"i\xfe\xff\xff\xff\xff\xff\xff\xff");
        expected.extend(b"k\x01\0\0\0\0\0\0\0b");
        expected.extend(b"s\x01\0\0\0\0\0\0\0x");
        assert_eq!(canonical_bytes(&json!({"b": "x", "a": [true, -2]})), expected);
    }

    #[derive(Serialize)]
    enum Shape {
        Unit,
        Of(u8),
        Pair(u8, i16),
        Named { z: f32, a: char },
    }

    #[derive(Serialize)]
    struct Inner {
        zebra: u64,
        #[serde(skip_serializing_if = "Option::is_none")]
        ant: Option<i8>,
    }

    #[derive(Serialize)]
    struct All<'a> {
        zz: Shape,
        of: Shape,
        pair: Shape,
        named: Shape,
        #[serde(flatten)]
        inner: Inner,
        big: u64,
        no_number: f64,
        none: Option<u8>,
        tuple: (bool, &'a str),
        map: BTreeMap<&'a str, Vec<Value>>,
        aa: (),
    }

    #[test]
    fn a_struct_is_encoded_as_its_json_value_is() {
        for ant in [None, Some(-3)] {
            let all = All {
                zz: Shape::Unit,
                of: Shape::Of(7),
                pair: Shape::Pair(1, -2),
                named: Shape::Named { z: 0.1, a: 'ü' },
                inner: Inner { zebra: 3, ant },
                big: u64::MAX,
                no_number: f64::NAN,
                none: None,
                tuple: (true, "text"),
                map: BTreeMap::from([("", vec![json!({"b": 1, "a": [-0.0]})]), ("é", vec![])]),
                aa: (),
            };
            let value = serde_json::to_value(&all).expect("plain");
            assert_eq!(canonical_bytes(&all), canonical_bytes(&value));
        }
    }

    #[test]
    fn what_has_no_json_is_refused() {
        #[derive(Serialize)]
        struct Twice {
            b: u8,
            a: u8,
            #[serde(rename = "b")]
            again: u8,
        }
        let refused = |value: &dyn Fn(Encoder<'_>) -> Result<(), NotPlain>| {
            value(Encoder { out: &mut Vec::new() }).expect_err("refused").to_string()
        };
        let twice = Twice { b: 1, a: 2, again: 3 };
        assert_eq!(refused(&|encoder| twice.serialize(encoder)), "an object has a field twice");
        let numbers = BTreeMap::from([(1, 2)]);
        assert_eq!(refused(&|encoder| numbers.serialize(encoder)), "the name of a field is no text");
    }
}
