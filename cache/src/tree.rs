//! Trees: blobs that list other blobs, and trees.
//!
//! A record that refers to a tree keeps everything in the tree alive, without a list of its own; two records with
//! common outputs share a tree. The body of a tree is defined by its writer.

use crate::{
    CacheError, Digest, Store,
    codec::{Fields, Put},
};
use std::collections::HashSet;

const MAGIC: &[u8; 8] = b"tautree1";

/// A tree's blob, read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tree<'a> {
    /// Blobs that it lists.
    pub refs: Vec<Digest>,
    /// Trees that it lists.
    pub trees: Vec<Digest>,
    /// The body of the tree.
    pub body: &'a [u8],
}

/// The bytes of a tree.
pub fn encode(refs: &[Digest], trees: &[Digest], body: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(16 + (refs.len() + trees.len()) * 40 + body.len());
    out.extend_from_slice(MAGIC);
    out.digests(refs);
    out.digests(trees);
    out.extend_from_slice(body);
    out
}

/// Reads a tree; `None` if these are not the bytes of one.
pub fn decode(bytes: &[u8]) -> Option<Tree<'_>> {
    let mut fields = Fields(bytes);
    (fields.take(8)? == MAGIC).then_some(())?;
    Some(Tree { refs: fields.digests()?, trees: fields.digests()?, body: fields.0 })
}

/// Gives a blob's bytes.
pub(crate) type Reader<'a> = &'a mut dyn FnMut(&Digest) -> Result<Option<Vec<u8>>, CacheError>;

/// Calls `found` with every blob that these trees list, and with the trees themselves, each tree once, and adds the
/// trees to `walked`; `read` gives a tree's bytes. A tree that is missing, or is none, lists nothing.
pub(crate) fn walk(
    trees: &[Digest],
    seen: &mut HashSet<Digest>,
    read: Reader<'_>,
    found: &mut dyn FnMut(&Digest),
    walked: &mut Vec<Digest>,
) -> Result<(), CacheError> {
    let mut open = trees.to_vec();
    while let Some(digest) = open.pop() {
        if !seen.insert(digest) {
            continue;
        }
        found(&digest);
        walked.push(digest);
        let Some(bytes) = read(&digest)? else { continue };
        if let Some(tree) = decode(&bytes) {
            tree.refs.iter().for_each(&mut *found);
            open.extend(tree.trees);
        }
    }
    Ok(())
}

impl Store {
    /// Every blob that a record with these refs and trees reaches, the trees themselves included, sorted.
    ///
    /// # Errors
    /// When a tree that is there cannot be read.
    pub fn reach(&self, refs: &[Digest], trees: &[Digest]) -> Result<Vec<Digest>, CacheError> {
        let mut all = refs.to_vec();
        let mut found = |digest: &Digest| all.push(*digest);
        walk(trees, &mut HashSet::new(), &mut |digest| self.get(digest), &mut found, &mut Vec::new())?;
        all.sort_unstable();
        all.dedup();
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_round_trip_and_other_bytes_are_no_tree() {
        let (refs, trees) = (vec![Digest::of(b"a"), Digest::of(b"b")], vec![Digest::of(b"c")]);
        let bytes = encode(&refs, &trees, b"body");
        assert_eq!(decode(&bytes), Some(Tree { refs, trees, body: b"body" }));
        assert!((0..bytes.len() - 4).all(|n| decode(&bytes[..n]).is_none()));
        assert!(decode(b"{}").is_none());
    }

    #[test]
    fn a_walk_sees_each_tree_once_and_ends() {
        // Content addresses cannot make a circle; a lying reader can.
        let top = Digest::of(b"top");
        let bytes = encode(&[Digest::of(b"x")], &[top], b"");
        let mut count = 0;
        let mut read = |_: &Digest| Ok(Some(bytes.clone()));
        walk(&[top, top], &mut HashSet::new(), &mut read, &mut |_| count += 1, &mut Vec::new()).expect("no disk");
        assert_eq!(count, 2);
    }
}
