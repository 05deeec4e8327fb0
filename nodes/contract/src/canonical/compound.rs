//! Encoding of lists and objects whose length and order are known only at the end.

use super::{NotPlain, encoder::Encoder};
use serde::{
    Serialize,
    ser::{
        SerializeMap, SerializeSeq, SerializeStruct, SerializeStructVariant, SerializeTuple, SerializeTupleStruct,
        SerializeTupleVariant,
    },
};

/// A list on its way; its count is written last.
pub(super) struct List<'a> {
    out: &'a mut Vec<u8>,
    at: usize,
    count: u64,
}

impl<'a> List<'a> {
    /// Begins at the end of `out`, where its tag stands.
    pub fn new(out: &'a mut Vec<u8>) -> Self {
        let at = out.len();
        out.extend([0; 8]);
        Self { out, at, count: 0 }
    }

    fn add<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), NotPlain> {
        self.count += 1;
        value.serialize(Encoder { out: &mut *self.out })
    }

    fn done(self) -> Result<(), NotPlain> {
        self.out[self.at..self.at + 8].copy_from_slice(&self.count.to_le_bytes());
        Ok(())
    }
}

/// An object on its way: its fields are put in order when all are there.
pub(super) struct Object<'a> {
    out: &'a mut Vec<u8>,
    at: usize,
    /// Where each field begins, and where its name ends.
    fields: Vec<(usize, usize)>,
    sorted: bool,
}

/// Bytes before a text itself.
const HEAD: usize = 9;

impl<'a> Object<'a> {
    /// Begins at the end of `out`, where its tag stands.
    pub fn new(out: &'a mut Vec<u8>) -> Self {
        let at = out.len();
        out.extend([0; 8]);
        Self { out, at, fields: Vec::new(), sorted: true }
    }

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

/// The traits of lists and objects: their methods say one thing each under several names.
macro_rules! compound {
    ($of:ident, $trait:ident, { $($method:ident => $own:ident),+ }) => {
        impl $trait for $of<'_> {
            type Ok = ();
            type Error = NotPlain;

            $(fn $method<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), NotPlain> {
                self.$own(value)
            })+

            fn end(self) -> Result<(), NotPlain> {
                self.done()
            }
        }
    };
    ($of:ident, $trait:ident) => {
        impl $trait for $of<'_> {
            type Ok = ();
            type Error = NotPlain;

            fn serialize_field<T: Serialize + ?Sized>(
                &mut self,
                name: &'static str,
                value: &T,
            ) -> Result<(), NotPlain> {
                self.add_name(name)?;
                self.add(value)
            }

            fn end(self) -> Result<(), NotPlain> {
                self.done()
            }
        }
    };
}

compound!(List, SerializeSeq, { serialize_element => add });
compound!(List, SerializeTuple, { serialize_element => add });
compound!(List, SerializeTupleStruct, { serialize_field => add });
compound!(List, SerializeTupleVariant, { serialize_field => add });
compound!(Object, SerializeMap, { serialize_key => add_name, serialize_value => add });
compound!(Object, SerializeStruct);
compound!(Object, SerializeStructVariant);
