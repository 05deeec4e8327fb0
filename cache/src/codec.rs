//! Little-endian, length-prefixed fields: the bytes of frames, trees and index files.
//!
//! Knows no record and no file. Every read is checked: bytes come from disk.

use crate::Digest;

/// Appends fields to a buffer.
pub(crate) trait Put {
    fn u8(&mut self, value: u8);
    fn u32(&mut self, value: u32);
    fn u64(&mut self, value: u64);
    fn text(&mut self, value: &str);
    fn digests(&mut self, value: &[Digest]);
}

impl Put for Vec<u8> {
    fn u8(&mut self, value: u8) {
        self.push(value);
    }

    fn u32(&mut self, value: u32) {
        self.extend_from_slice(&value.to_le_bytes());
    }

    fn u64(&mut self, value: u64) {
        self.extend_from_slice(&value.to_le_bytes());
    }

    /// Texts longer than `u32::MAX` are refused earlier, by the limit on a record's size.
    fn text(&mut self, value: &str) {
        self.u32(value.len() as u32);
        self.extend_from_slice(value.as_bytes());
    }

    fn digests(&mut self, value: &[Digest]) {
        self.u32(value.len() as u32);
        for digest in value {
            self.extend_from_slice(&digest.hash);
            self.u64(digest.size);
        }
    }
}

/// Reads fields off the front of a slice; `None` when they do not fit.
pub(crate) struct Fields<'a>(pub &'a [u8]);

impl<'a> Fields<'a> {
    pub fn take(&mut self, n: usize) -> Option<&'a [u8]> {
        let (head, rest) = self.0.split_at_checked(n)?;
        self.0 = rest;
        Some(head)
    }

    pub fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    pub fn u8(&mut self) -> Option<u8> {
        self.array::<1>().map(|[byte]| byte)
    }

    pub fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    pub fn text(&mut self) -> Option<&'a str> {
        let len = self.u32()? as usize;
        std::str::from_utf8(self.take(len)?).ok()
    }

    pub fn digests(&mut self) -> Option<Vec<Digest>> {
        let count = self.u32()? as usize;
        let mut bytes = Fields(self.take(count.checked_mul(40)?)?);
        (0..count).map(|_| Some(Digest { hash: bytes.array()?, size: bytes.u64()? })).collect()
    }
}
