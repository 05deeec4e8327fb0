//! The canonical encoding: what keys and content digests are hashes of.
//!
//! It is typed and length-prefixed: equal values give equal bytes, different values different bytes. A null is `n`. A
//! truth value is `b` and a byte. A number is `i`, `u` or `f` and eight little-endian bytes, where `-0.0` is `0.0`. A
//! text is `s`, a length of eight bytes and the text. A list is `a`, a count and the values. An object is `o`, a count
//! and its fields, sorted by name: `k`, a length and the name, then the value. `docs/action_record.md` says the same to
//! others.
//!
//! A struct is written as it goes by, without making a JSON value of it first: actions have a key each.

use serde::{
    Serialize, Serializer,
    ser::{
        Error, SerializeMap, SerializeSeq, SerializeStruct, SerializeStructVariant, SerializeTuple,
        SerializeTupleStruct, SerializeTupleVariant,
    },
};
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

/// What cannot be encoded, in words.
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

/// Writes one value at the end of `out`.
struct Encoder<'a> {
    out: &'a mut Vec<u8>,
}

impl<'a> Encoder<'a> {
    fn tagged(self, tag: u8, bytes: [u8; 8]) -> Result<(), NotPlain> {
        self.out.push(tag);
        self.out.extend(bytes);
        Ok(())
    }

    fn text(&mut self, tag: u8, text: &str) {
        self.out.push(tag);
        self.out.extend((text.len() as u64).to_le_bytes());
        self.out.extend(text.as_bytes());
    }

    /// An object of one field, whose value is still to be written.
    fn variant(mut self, name: &str) -> Self {
        self.out.push(b'o');
        self.out.extend(1u64.to_le_bytes());
        self.text(b'k', name);
        self
    }

    fn list(self) -> List<'a> {
        self.out.push(b'a');
        let at = self.out.len();
        self.out.extend([0; 8]);
        List { out: self.out, at, count: 0 }
    }

    fn object(self) -> Object<'a> {
        self.out.push(b'o');
        let at = self.out.len();
        self.out.extend([0; 8]);
        Object { out: self.out, at, fields: Vec::new(), sorted: true }
    }
}

impl<'a> Serializer for Encoder<'a> {
    type Ok = ();
    type Error = NotPlain;
    type SerializeSeq = List<'a>;
    type SerializeTuple = List<'a>;
    type SerializeTupleStruct = List<'a>;
    type SerializeTupleVariant = List<'a>;
    type SerializeMap = Object<'a>;
    type SerializeStruct = Object<'a>;
    type SerializeStructVariant = Object<'a>;

    fn serialize_bool(self, v: bool) -> Result<(), NotPlain> {
        self.out.extend([b'b', u8::from(v)]);
        Ok(())
    }

    fn serialize_i8(self, v: i8) -> Result<(), NotPlain> {
        self.serialize_i64(v.into())
    }

    fn serialize_i16(self, v: i16) -> Result<(), NotPlain> {
        self.serialize_i64(v.into())
    }

    fn serialize_i32(self, v: i32) -> Result<(), NotPlain> {
        self.serialize_i64(v.into())
    }

    fn serialize_i64(self, v: i64) -> Result<(), NotPlain> {
        self.tagged(b'i', v.to_le_bytes())
    }

    fn serialize_u8(self, v: u8) -> Result<(), NotPlain> {
        self.serialize_u64(v.into())
    }

    fn serialize_u16(self, v: u16) -> Result<(), NotPlain> {
        self.serialize_u64(v.into())
    }

    fn serialize_u32(self, v: u32) -> Result<(), NotPlain> {
        self.serialize_u64(v.into())
    }

    fn serialize_u64(self, v: u64) -> Result<(), NotPlain> {
        match i64::try_from(v) {
            Ok(v) => self.serialize_i64(v),
            Err(_) => self.tagged(b'u', v.to_le_bytes()),
        }
    }

    fn serialize_f32(self, v: f32) -> Result<(), NotPlain> {
        self.serialize_f64(v.into())
    }

    fn serialize_f64(self, v: f64) -> Result<(), NotPlain> {
        // JSON has no other numbers. `+ 0.0` turns -0.0 into 0.0.
        if v.is_finite() { self.tagged(b'f', (v + 0.0).to_bits().to_le_bytes()) } else { self.serialize_unit() }
    }

    fn serialize_char(self, v: char) -> Result<(), NotPlain> {
        self.serialize_str(v.encode_utf8(&mut [0; 4]))
    }

    fn serialize_str(mut self, v: &str) -> Result<(), NotPlain> {
        self.text(b's', v);
        Ok(())
    }

    fn collect_str<T: fmt::Display + ?Sized>(self, value: &T) -> Result<(), NotPlain> {
        use std::io::Write;
        self.out.push(b's');
        let at = self.out.len();
        self.out.extend([0; 8]);
        write!(self.out, "{value}").map_err(NotPlain::custom)?;
        let len = (self.out.len() - at - 8) as u64;
        self.out[at..at + 8].copy_from_slice(&len.to_le_bytes());
        Ok(())
    }

    fn serialize_bytes(self, v: &[u8]) -> Result<(), NotPlain> {
        v.serialize(self)
    }

    fn serialize_none(self) -> Result<(), NotPlain> {
        self.serialize_unit()
    }

    fn serialize_some<T: Serialize + ?Sized>(self, value: &T) -> Result<(), NotPlain> {
        value.serialize(self)
    }

    fn serialize_unit(self) -> Result<(), NotPlain> {
        self.out.push(b'n');
        Ok(())
    }

    fn serialize_unit_struct(self, _: &'static str) -> Result<(), NotPlain> {
        self.serialize_unit()
    }

    fn serialize_unit_variant(self, _: &'static str, _: u32, variant: &'static str) -> Result<(), NotPlain> {
        self.serialize_str(variant)
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(self, _: &'static str, value: &T) -> Result<(), NotPlain> {
        value.serialize(self)
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
        value: &T,
    ) -> Result<(), NotPlain> {
        value.serialize(self.variant(variant))
    }

    fn serialize_seq(self, _: Option<usize>) -> Result<List<'a>, NotPlain> {
        Ok(self.list())
    }

    fn serialize_tuple(self, _: usize) -> Result<List<'a>, NotPlain> {
        Ok(self.list())
    }

    fn serialize_tuple_struct(self, _: &'static str, _: usize) -> Result<List<'a>, NotPlain> {
        Ok(self.list())
    }

    fn serialize_tuple_variant(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
        _: usize,
    ) -> Result<List<'a>, NotPlain> {
        Ok(self.variant(variant).list())
    }

    fn serialize_map(self, _: Option<usize>) -> Result<Object<'a>, NotPlain> {
        Ok(self.object())
    }

    fn serialize_struct(self, _: &'static str, _: usize) -> Result<Object<'a>, NotPlain> {
        Ok(self.object())
    }

    fn serialize_struct_variant(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
        _: usize,
    ) -> Result<Object<'a>, NotPlain> {
        Ok(self.variant(variant).object())
    }
}

/// A list on its way; its count is written last.
struct List<'a> {
    out: &'a mut Vec<u8>,
    at: usize,
    count: u64,
}

impl List<'_> {
    fn add<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), NotPlain> {
        self.count += 1;
        value.serialize(Encoder { out: &mut *self.out })
    }

    fn done(self) {
        self.out[self.at..self.at + 8].copy_from_slice(&self.count.to_le_bytes());
    }
}

/// An object on its way: its fields are put in order when all are there.
struct Object<'a> {
    out: &'a mut Vec<u8>,
    at: usize,
    /// Where each field begins, and where its name ends.
    fields: Vec<(usize, usize)>,
    sorted: bool,
}

/// Bytes before a text itself.
const HEAD: usize = 9;

impl Object<'_> {
    fn name(&self, (start, end): (usize, usize)) -> &[u8] {
        &self.out[start + HEAD..end]
    }

    fn add_name<T: Serialize + ?Sized>(&mut self, name: &T) -> Result<(), NotPlain> {
        let start = self.out.len();
        name.serialize(Encoder { out: &mut *self.out })?;
        if self.out[start] != b's' {
            return Err(NotPlain("the name of a field is no text".into()));
        }
        self.out[start] = b'k';
        let field = (start, self.out.len());
        self.sorted &= self.fields.last().is_none_or(|last| self.name(*last) < self.name(field));
        self.fields.push(field);
        Ok(())
    }

    fn add<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), NotPlain> {
        value.serialize(Encoder { out: &mut *self.out })
    }

    fn done(self) -> Result<(), NotPlain> {
        let count = (self.fields.len() as u64).to_le_bytes();
        self.out[self.at..self.at + 8].copy_from_slice(&count);
        if self.sorted {
            return Ok(());
        }
        let ends = self.fields.iter().skip(1).map(|(start, _)| *start).chain([self.out.len()]);
        let mut fields: Vec<_> = self.fields.iter().copied().zip(ends).collect();
        fields.sort_by(|(a, _), (b, _)| self.name(*a).cmp(self.name(*b)));
        if fields.windows(2).any(|pair| self.name(pair[0].0) == self.name(pair[1].0)) {
            return Err(NotPlain("an object has a field twice".into()));
        }
        let mut ordered = Vec::with_capacity(self.out.len() - self.at);
        for ((start, _), end) in fields {
            ordered.extend_from_slice(&self.out[start..end]);
        }
        self.out[self.at + 8..].copy_from_slice(&ordered);
        Ok(())
    }
}

impl SerializeSeq for List<'_> {
    type Ok = ();
    type Error = NotPlain;

    fn serialize_element<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), NotPlain> {
        self.add(value)
    }

    fn end(self) -> Result<(), NotPlain> {
        self.done();
        Ok(())
    }
}

impl SerializeTuple for List<'_> {
    type Ok = ();
    type Error = NotPlain;

    fn serialize_element<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), NotPlain> {
        self.add(value)
    }

    fn end(self) -> Result<(), NotPlain> {
        self.done();
        Ok(())
    }
}

impl SerializeTupleStruct for List<'_> {
    type Ok = ();
    type Error = NotPlain;

    fn serialize_field<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), NotPlain> {
        self.add(value)
    }

    fn end(self) -> Result<(), NotPlain> {
        self.done();
        Ok(())
    }
}

impl SerializeTupleVariant for List<'_> {
    type Ok = ();
    type Error = NotPlain;

    fn serialize_field<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), NotPlain> {
        self.add(value)
    }

    fn end(self) -> Result<(), NotPlain> {
        self.done();
        Ok(())
    }
}

impl SerializeMap for Object<'_> {
    type Ok = ();
    type Error = NotPlain;

    fn serialize_key<T: Serialize + ?Sized>(&mut self, key: &T) -> Result<(), NotPlain> {
        self.add_name(key)
    }

    fn serialize_value<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), NotPlain> {
        self.add(value)
    }

    fn end(self) -> Result<(), NotPlain> {
        self.done()
    }
}

impl SerializeStruct for Object<'_> {
    type Ok = ();
    type Error = NotPlain;

    fn serialize_field<T: Serialize + ?Sized>(&mut self, name: &'static str, value: &T) -> Result<(), NotPlain> {
        self.add_name(name)?;
        self.add(value)
    }

    fn end(self) -> Result<(), NotPlain> {
        self.done()
    }
}

impl SerializeStructVariant for Object<'_> {
    type Ok = ();
    type Error = NotPlain;

    fn serialize_field<T: Serialize + ?Sized>(&mut self, name: &'static str, value: &T) -> Result<(), NotPlain> {
        self.add_name(name)?;
        self.add(value)
    }

    fn end(self) -> Result<(), NotPlain> {
        self.done()
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
