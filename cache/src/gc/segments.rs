//! Selects the segments that a collection rewrites: segments of dead stores with enough deletions, with damage, or many
//! small ones.

use super::plan::{PackPlan, Place, Plan};
use crate::{
    CacheError, Store,
    error::At,
    lease::is_live,
    segment::{BLOB_HEADER, Sort},
};
use std::{
    collections::{HashMap, HashSet},
    path::PathBuf,
};

/// Dead segments below this size are merged once there are more than `MANY_SMALL`.
const SMALL: u64 = 1 << 20;
const MANY_SMALL: usize = 16;

impl Plan {
    pub(super) fn choose_packs(&mut self, store: &Store, live: &HashSet<u32>) -> Result<(), CacheError> {
        let mut here: HashMap<u32, Vec<u32>> = HashMap::new();
        for (number, blob) in self.blobs.iter().enumerate() {
            if let Place::Packed { segment, .. } = blob.place {
                here.entry(segment).or_default().push(number as u32);
            }
        }
        let (mut chosen, mut small) = (Vec::new(), Vec::new());
        for (segment, path) in dead_segments(store, Sort::Pack, live) {
            let len = std::fs::metadata(&path).at("read the pack", &path)?.len();
            let here = here.remove(&segment).unwrap_or_default();
            let keep: Vec<u32> = here.iter().copied().filter(|&blob| self.blobs[blob as usize].stays()).collect();
            let kept = self.size(&keep).saturating_add(BLOB_HEADER * keep.len() as u64);
            // Superseded copies and torn tails are wasted, too.
            let damaged = store.index().segments[segment as usize].damaged > 0;
            if keep.is_empty() || damaged || len.saturating_sub(kept).saturating_mul(8) >= len {
                chosen.push(PackPlan { segment, here });
                continue;
            }
            here.iter().for_each(|&blob| self.blobs[blob as usize].lingers = true);
            if len < SMALL {
                small.push(PackPlan { segment, here });
            }
        }
        if small.len() > MANY_SMALL {
            chosen.extend(small);
        }
        self.packs = chosen;
        Ok(())
    }

    pub(super) fn choose_logs(&mut self, store: &Store, live: &HashSet<u32>) {
        let with_loss: HashSet<u32> = self.rows.iter().filter(|row| row.goes).map(|row| row.segment).collect();
        let in_use: HashSet<u32> = self.rows.iter().map(|row| row.segment).collect();
        let dead: Vec<_> = dead_segments(store, Sort::Log, live);
        let is_small = |path: &PathBuf| std::fs::symlink_metadata(path).is_ok_and(|meta| meta.len() < SMALL);
        let small = dead.iter().filter(|(_, path)| is_small(path)).count();
        let merge = small > MANY_SMALL;
        let chosen = |(number, path): &(u32, PathBuf)| {
            let damaged = store.index().segments[*number as usize].damaged > 0;
            with_loss.contains(number) || !in_use.contains(number) || damaged || (merge && is_small(path))
        };
        self.logs = dead.into_iter().filter(chosen).map(|(number, _)| number).collect();
    }
}

/// Segments whose writer lives, this store's among them.
pub(super) fn live_segments(store: &Store) -> HashSet<u32> {
    let index = store.index();
    let lives = |owner: &str| is_live(&store.layout.lease(owner));
    let segments = index.segments.iter().enumerate().filter(|(_, segment)| !segment.gone);
    // One that was not read to its end had a live owner a moment ago.
    segments
        .filter(|(_, segment)| segment.own || !segment.sealed || lives(&segment.owner))
        .map(|(n, _)| n as u32)
        .collect()
}

fn dead_segments(store: &Store, sort: Sort, live: &HashSet<u32>) -> Vec<(u32, PathBuf)> {
    let index = store.index();
    let segments = index.segments.iter().enumerate().map(|(n, segment)| (n as u32, segment));
    let dead = segments.filter(|(n, segment)| segment.sort == sort && !segment.gone && !live.contains(n));
    dead.map(|(n, segment)| (n, segment.path.clone())).collect()
}
