//! Content digests: the blake3 hash and the length of a byte string.
//!
//! The size is part of the digest, as in the Remote Execution API, so that a reader knows the size in advance and
//! detects truncation.

use crate::layout::is_number;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::{fmt, str::FromStr};

/// Digest of a blob: 32 bytes of blake3 and the blob's size in bytes.
///
/// Its text form is `<64 hex digits>-<size>`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Digest {
    /// blake3 of the content.
    pub hash: [u8; 32],
    /// Size of the content in bytes.
    pub size: u64,
}

impl Digest {
    /// Digest of `bytes`.
    pub fn of(bytes: &[u8]) -> Self {
        Self { hash: *blake3::hash(bytes).as_bytes(), size: bytes.len() as u64 }
    }

    /// The hash as 64 hexadecimal digits, without the size.
    pub fn hex(&self) -> String {
        blake3::Hash::from_bytes(self.hash).to_hex().to_string()
    }

    /// The first eight hexadecimal digits, for people.
    pub fn short(&self) -> String {
        self.hex()[..8].to_owned()
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}", self.hex(), self.size)
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}", self.short(), self.size)
    }
}

/// A text that is not a digest.
#[derive(Debug, thiserror::Error)]
#[error("`{0}` is not a digest: expected 64 hexadecimal digits, `-`, and the size in bytes")]
pub struct ParseDigestError(String);

impl FromStr for Digest {
    type Err = ParseDigestError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let bad = || ParseDigestError(text.to_owned());
        let (hex, size) = text.split_once('-').ok_or_else(bad)?;
        // One digest has one text: files are named by it.
        let upper = hex.bytes().any(|c| c.is_ascii_uppercase());
        let hash = blake3::Hash::from_hex(hex).ok().filter(|_| !upper).ok_or_else(bad)?;
        let size = size.parse().ok().filter(|_| is_number(size)).ok_or_else(bad)?;
        Ok(Self { hash: *hash.as_bytes(), size })
    }
}

impl Serialize for Digest {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Digest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::Digest;

    #[test]
    fn text_form_round_trips() {
        let digest = Digest::of(b"tau");
        assert_eq!(digest.to_string().parse::<Digest>().expect("own text parses"), digest);
        assert_eq!(digest.size, 3);
        assert!("abc-3".parse::<Digest>().is_err());
        let hex = digest.hex();
        for other in [format!("{hex}-+3"), format!("{hex}-03"), format!("{}-3", hex.to_uppercase()), format!("{hex}-")]
        {
            assert!(other.parse::<Digest>().is_err(), "{other}");
        }
    }
}
