//! Views: the scenes of a stratum by content and view, and the seeds that let views share what their content draws.
//!
//! **Numbering.** Items of a stratum go content by content, and within one view by view, so that a larger pool appends.
//! Contents come in blocks in which every number of views stands once, in an order drawn for the block. Each number is
//! therefore equally frequent, and an item finds its content without a walk over all earlier ones.
//!
//! **Seeds.** The engine gives an item a seed and nothing else of the pipeline's. The upper bits of it are those of the
//! stratum, the lower ones the item's index: all seeds differ, and the views of a content find what they share.

use super::{assemble::Which, params::SceneGenerationParams};
use tauflow_contract::{KindError, derive_seed};
use tauflow_data::{Stratum, rng::Stream};

/// Bits of a seed that hold the item's index; the largest pool has fewer items.
const INDEX: u64 = (1 << 20) - 1;

/// The seed of an item: bits of its stratum above, its index below. An item that names no such place, which no pool
/// has, gets a seed of its own.
pub fn item_seed(pipeline_seed: u64, kind: &str, item: &str) -> u64 {
    match Stratum::of_key(item) {
        Some((stratum, index)) if index <= INDEX => {
            derive_seed(pipeline_seed, kind, &stratum.to_string()) & !INDEX | index
        }
        _ => derive_seed(pipeline_seed, kind, item),
    }
}

/// The common part of the seeds of a stratum's items.
///
/// # Errors
/// If the seed is not that of the `index`-th item of a stratum.
pub fn stratum_seed(seed: u64, index: u64) -> Result<u64, KindError> {
    if seed & INDEX != index {
        return Err(KindError::Internal(format!(
            "the seed {seed} is not of the item of index {index}; seeds of scenes come from `Kind::seed`"
        )));
    }
    Ok(seed & !INDEX)
}

/// How many views each content of a block has.
fn block(params: &SceneGenerationParams, seed: u64, stratum: Stratum, number: u64) -> Vec<u32> {
    let [low, high] = params.views;
    let mut counts: Vec<u32> = (low..=high).collect();
    let mut draw = Stream::new(seed, &[]).part(&format!("views.{stratum}.{number}"));
    for last in (1..counts.len()).rev() {
        counts.swap(last, draw.below(last + 1));
    }
    counts
}

impl Which {
    /// The content and view of the `index`-th item of a stratum; `seed` is what its items share.
    pub fn of(params: &SceneGenerationParams, seed: u64, stratum: Stratum, index: u64) -> Self {
        let [low, high] = params.views.map(u64::from);
        let contents = high - low + 1;
        let items = contents * (low + high) / 2;
        let number = index / items;
        let mut rest = index % items;
        let mut content = number * contents;
        for count in block(params, seed, stratum, number).into_iter().map(u64::from) {
            if rest < count {
                break;
            }
            rest -= count;
            content += 1;
        }
        Self { content, view: rest as u32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn params(views: [u32; 2]) -> SceneGenerationParams {
        SceneGenerationParams { views, ..SceneGenerationParams::default() }
    }

    fn strata() -> [Stratum; 2] {
        let mut all = Stratum::all();
        [all.next().expect("twelve"), all.nth(4).expect("twelve")]
    }

    #[test]
    fn items_go_content_by_content_and_view_by_view() {
        let [stratum, _] = strata();
        for views in [[1, 6], [1, 1], [3, 3], [2, 5], [64, 64]] {
            let params = params(views);
            let mut before = Which::of(&params, 7, stratum, 0);
            assert_eq!(before, Which { content: 0, view: 0 });
            let mut counts: BTreeMap<u64, u32> = BTreeMap::from([(0, 1)]);
            for index in 1..2100 {
                let Which { content, view } = Which::of(&params, 7, stratum, index);
                let next = (content, view) == (before.content, before.view + 1);
                assert!(next || (content, view) == (before.content + 1, 0), "{views:?} {index}: {content} {view}");
                *counts.entry(content).or_default() += 1;
                before = Which { content, view };
            }
            counts.pop_last();
            assert!(counts.values().all(|count| (views[0]..=views[1]).contains(count)), "{views:?}");
            let of = |n: u32| counts.values().filter(|count| **count == n).count();
            let most = (views[0]..=views[1]).map(of).max().expect("some");
            let least = (views[0]..=views[1]).map(of).min().expect("some");
            assert!(most - least <= 1, "{views:?}: each number of views as often as the others");
        }
    }

    #[test]
    fn numbers_of_views_are_drawn_from_the_seed_and_the_stratum() {
        let params = params([1, 6]);
        let [one, other] = strata();
        let drawn = |seed, stratum| (0..200).map(|i| Which::of(&params, seed, stratum, i)).collect::<Vec<_>>();
        assert_eq!(drawn(7, one), drawn(7, one));
        assert_ne!(drawn(7, one), drawn(8, one));
        assert_ne!(drawn(7, one), drawn(7, other));
    }

    #[test]
    fn seeds_of_a_stratum_share_all_but_the_index() {
        let seed = |pipeline, item: &str| item_seed(pipeline, "scene_generation", item);
        let all = ["L0-open-000000", "L0-open-000001", "L0-open-999999", "L1-open-000000", "other", ""];
        let mut found: Vec<u64> = all.iter().flat_map(|item| [seed(1, item), seed(2, item)]).collect();
        found.sort_unstable();
        found.dedup();
        assert_eq!(found.len(), 2 * all.len());
        let shared = stratum_seed(seed(1, "L0-open-000000"), 0).expect("its own");
        assert_eq!(stratum_seed(seed(1, "L0-open-999999"), 999_999).expect("its own"), shared);
        assert_ne!(stratum_seed(seed(1, "L1-open-000000"), 0).expect("its own"), shared);
        assert!(stratum_seed(seed(1, "L0-open-000001"), 2).is_err());
    }
}
