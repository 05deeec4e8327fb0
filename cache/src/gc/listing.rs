//! The content of trees, for a plan: each tree is read once, and none is assumed to be small.

use super::plan::Plan;
use crate::{CacheError, Digest, Store, tree};
use std::collections::{HashMap, HashSet, hash_map::Entry};

/// The blobs of one tree, as indices into `Plan::blobs`.
#[derive(Default)]
pub(super) struct Listing {
    pub present: Vec<u32>,
    /// Everything that it lists itself is there.
    pub complete: bool,
    pub trees: Vec<Digest>,
}

impl Listing {
    pub fn add(&mut self, by_hash: &HashMap<[u8; 32], u32>, digest: &Digest) {
        match by_hash.get(&digest.hash) {
            Some(&blob) => self.present.push(blob),
            None => self.complete = false,
        }
    }
}

impl Plan {
    /// Adds what the trees of a record list, and the trees below them, each once.
    pub(super) fn add_trees(
        &mut self,
        store: &Store,
        reach: &mut Listing,
        listings: &mut HashMap<Digest, Listing>,
    ) -> Result<(), CacheError> {
        let mut seen: HashSet<Digest> = HashSet::new();
        let mut open = std::mem::take(&mut reach.trees);
        while let Some(tree) = open.pop() {
            if !seen.insert(tree) {
                continue;
            }
            let listing = match listings.entry(tree) {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(new) => new.insert(self.listing(store, &tree)?),
            };
            reach.present.extend(&listing.present);
            reach.complete &= listing.complete;
            open.extend(listing.trees.iter().filter(|tree| !seen.contains(*tree)));
        }
        Ok(())
    }

    /// Reads what a tree lists.
    fn listing(&mut self, store: &Store, tree: &Digest) -> Result<Listing, CacheError> {
        let mut listing = Listing { complete: true, ..Listing::default() };
        listing.add(&self.by_hash, tree);
        listing.present.iter().for_each(|&blob| self.blobs[blob as usize].tree = true);
        if let Some(bytes) = store.get_now(tree)?
            && let Some(read) = tree::decode(&bytes)
        {
            read.refs.iter().for_each(|digest| listing.add(&self.by_hash, digest));
            listing.present.sort_unstable();
            listing.present.dedup();
            listing.trees = read.trees;
        }
        Ok(listing)
    }
}
