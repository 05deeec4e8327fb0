//! Hash maps for an index whose hashes can be chosen by an attacker.
//!
//! Keys are already hashes, so mixing their words is cheaper than hashing them again. But a pack can contain arbitrary
//! hashes: without mixing, chosen hashes would collide. All words are therefore mixed with random numbers of this
//! process. The order of such a map has no meaning: sort before displaying.

use std::{
    collections::HashMap,
    hash::{BuildHasher, Hasher, RandomState},
};

/// A map from something with a hash in it.
pub(crate) type HashedMap<K, V> = HashMap<K, V, Keyed>;

/// Makes [`Mixer`]s, from numbers that nobody outside this process knows.
#[derive(Clone, Debug)]
pub(crate) struct Keyed {
    start: u64,
    factor: u64,
}

impl Default for Keyed {
    fn default() -> Self {
        // RandomState is the standard library's source of entropy.
        let state = RandomState::new();
        Self { start: state.hash_one(0u8), factor: state.hash_one(1u8) | 1 }
    }
}

impl BuildHasher for Keyed {
    type Hasher = Mixer;

    fn build_hasher(&self) -> Mixer {
        Mixer { state: self.start, factor: self.factor }
    }
}

/// Mixes words by a multiplication of which both halves count.
pub(crate) struct Mixer {
    state: u64,
    factor: u64,
}

impl Mixer {
    #[inline]
    fn mix(&mut self, word: u64) {
        let product = u128::from(self.state ^ word) * u128::from(self.factor);
        self.state = (product as u64) ^ (product >> 64) as u64;
    }
}

impl Hasher for Mixer {
    #[inline]
    fn write(&mut self, bytes: &[u8]) {
        let (words, rest) = bytes.as_chunks::<8>();
        words.iter().for_each(|word| self.mix(u64::from_le_bytes(*word)));
        rest.iter().for_each(|byte| self.mix(u64::from(*byte)));
    }

    #[inline]
    fn write_u32(&mut self, namespace: u32) {
        self.mix(u64::from(namespace));
    }

    /// The length of the hash is the same for all.
    #[inline]
    fn write_usize(&mut self, _: usize) {}

    #[inline]
    fn finish(&self) -> u64 {
        // Multiplied once more, so that the last word counts in every bit.
        let product = u128::from(self.state) * u128::from(self.factor);
        (product as u64) ^ (product >> 64) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Key, index::Slot};
    use std::collections::HashSet;

    /// How many of 4096 places are taken by as many hashes, of those in the upper bits and of those in the lower.
    fn places(hashes: impl Iterator<Item = u64>) -> (usize, usize) {
        let (mut upper, mut lower) = (HashSet::new(), HashSet::new());
        for hash in hashes {
            upper.insert(hash >> 52);
            lower.insert(hash & 4095);
        }
        (upper.len(), lower.len())
    }

    #[test]
    fn hashes_that_agree_in_any_of_their_words_fall_on_many_places() {
        // 4096 draws with replacement from 4096 places hit 63 per cent of the places.
        let enough = |(upper, lower): (usize, usize)| upper > 2400 && lower > 2400;
        let keyed = Keyed::default();
        for word in 0..4 {
            let hash = |n: u64| {
                let mut hash = [7; 32];
                hash[word * 8..word * 8 + 8].copy_from_slice(&n.to_le_bytes());
                hash
            };
            assert!(enough(places((0..4096).map(|n| keyed.hash_one(hash(n))))), "word {word}");
            assert!(enough(places((0..4096).map(|n| keyed.hash_one(hash(n << 52))))), "word {word}");
            let slot = |n: u64| -> Slot { (9, Key(hash(n))) };
            assert!(enough(places((0..4096).map(|n| keyed.hash_one(slot(n))))), "word {word}");
        }
        assert!(enough(places((0..4096).map(|n: u32| keyed.hash_one((n, Key([7; 32])))))));
        assert_ne!(keyed.hash_one([7; 32]), Keyed::default().hash_one([7; 32]), "each map has numbers of its own");
    }
}
