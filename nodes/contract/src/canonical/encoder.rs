//! Streaming encoder: one value at a time, without building a JSON value.

use super::{
    NotPlain,
    compound::{List, Object},
};
use serde::{Serialize, Serializer, ser::Error};
use std::fmt;

/// Writes one value at the end of `out`.
pub(super) struct Encoder<'a> {
    pub out: &'a mut Vec<u8>,
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
        List::new(self.out)
    }

    fn object(self) -> Object<'a> {
        self.out.push(b'o');
        Object::new(self.out)
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
