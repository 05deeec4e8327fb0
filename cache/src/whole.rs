//! Finds records whose blobs are lost.
//!
//! A missing blob is not necessarily lost: a transient action passes its outputs on in memory, and its record refers to
//! blobs that were never stored. The same holds for records that pass such a blob on, or summarise it. A missing blob
//! is therefore excused if the record of a transient action names it. Any other missing blob of a committed record is
//! lost. The blobs of an uncommitted record may have been removed by a power cut; the record is verified before it is
//! used.

use crate::{
    CacheError, Digest, Store,
    index::Slot,
    record::{Reach, decode_reach},
    segment::read_record,
    tree,
};
use std::collections::{HashMap, HashSet};

/// How much of what a record names is there; the worst of it counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum State {
    /// All.
    Whole,
    /// All but what a transient action never stored.
    Excused,
    /// Not all.
    Lost,
}

/// One record, as far as it can be read.
pub(crate) struct Checked {
    pub slot: Slot,
    /// None if its frame is damaged.
    pub state: Option<State>,
    /// A commit mark covers it, or somebody has proved it.
    pub committed: bool,
}

impl Checked {
    /// Whether something of it was there and is not any more.
    pub fn has_lost(&self) -> bool {
        self.committed && self.state == Some(State::Lost)
    }
}

/// A tree that was read: what is there of the blobs that it lists itself, and the trees that it lists.
type Read = (State, Vec<Digest>);

/// Knowledge about blobs and trees. Each tree is read once, however many records and trees name it, and nothing
/// recurses along what trees say.
struct Survey<'a> {
    store: &'a Store,
    here: &'a HashSet<Digest>,
    excused: HashSet<Digest>,
    trees: HashMap<Digest, State>,
}

impl Survey<'_> {
    fn blob(&self, digest: &Digest) -> State {
        match (self.here.contains(digest), self.excused.contains(digest)) {
            (true, _) => State::Whole,
            (false, true) => State::Excused,
            (false, false) => State::Lost,
        }
    }

    fn blobs(&self, digests: &[Digest]) -> State {
        digests.iter().map(|digest| self.blob(digest)).max().unwrap_or(State::Whole)
    }

    fn below(&self, trees: &[Digest]) -> State {
        trees.iter().filter_map(|tree| self.trees.get(tree)).copied().max().unwrap_or(State::Whole)
    }

    /// Looks through trees, and those below them first.
    fn walk(&mut self, trees: &[Digest]) -> Result<State, CacheError> {
        let mut open: Vec<(Digest, Option<Read>)> = trees.iter().map(|tree| (*tree, None)).collect();
        while let Some((tree, read)) = open.pop() {
            if let Some((own, below)) = read {
                let state = own.max(self.below(&below));
                self.trees.insert(tree, state);
                continue;
            }
            if self.trees.contains_key(&tree) {
                continue;
            }
            let mut own = self.blob(&tree);
            // Until those below are known, and in a circle, which a digest cannot close.
            self.trees.insert(tree, own);
            let Some(bytes) = self.store.get_now(&tree)? else { continue };
            if let Some(listed) = tree::decode(&bytes) {
                own = own.max(self.blobs(&listed.refs));
                open.push((tree, Some((own, listed.trees.clone()))));
                open.extend(listed.trees.into_iter().map(|tree| (tree, None)));
            }
        }
        Ok(self.below(trees))
    }
}

impl Store {
    /// Looks at every record, in the order of their places; `here` are the blobs that are there.
    pub(crate) fn check_records(&self, here: &HashSet<Digest>) -> Result<Vec<Checked>, CacheError> {
        let mut records: Vec<_> = self.index().records.iter().map(|(slot, at)| (*slot, *at)).collect();
        records.sort_unstable_by_key(|(slot, at)| (at.segment, at.offset, *slot));
        let mut survey = Survey { store: self, here, excused: self.excused(here)?, trees: HashMap::new() };
        let mut checked = Vec::with_capacity(records.len());
        for (slot, at) in records {
            let frame = self.segment_file(at.segment).and_then(|file| read_record(&file, at.offset, at.len));
            let frame = frame.ok().flatten();
            let state = match frame.as_ref().and_then(|frame| decode_reach(frame.bytes())) {
                Some(Reach { refs, trees, .. }) => Some(survey.blobs(&refs).max(survey.walk(&trees)?)),
                None => None,
            };
            checked.push(Checked { slot, state, committed: !self.index().is_provisional(&slot, &at) });
        }
        Ok(checked)
    }

    /// The missing blobs that records of transient actions name.
    fn excused(&self, here: &HashSet<Digest>) -> Result<HashSet<Digest>, CacheError> {
        let mut places: Vec<_> = {
            let index = self.index();
            index.records.values().map(|at| (at.segment, at.offset, at.len)).collect()
        };
        places.sort_unstable();
        let (mut excused, mut seen) = (HashSet::new(), HashSet::new());
        for (segment, offset, len) in places {
            let frame = self.segment_file(segment).and_then(|file| read_record(&file, offset, len)).ok().flatten();
            let reach = frame.as_ref().and_then(|frame| decode_reach(frame.bytes()));
            let Some(Reach { refs, trees, transient: true, .. }) = reach else { continue };
            let mut found = |digest: &Digest| {
                if !here.contains(digest) {
                    excused.insert(*digest);
                }
            };
            refs.iter().for_each(&mut found);
            tree::walk(&trees, &mut seen, &mut |tree| self.get_now(tree), &mut found, &mut Vec::new())?;
        }
        Ok(excused)
    }
}
