//! How long actions take: as others of their node did in this run, or as recorded ones of their kind did.

use crate::engine::{event::Name, execute::PreparedAction, records::ACTION};
use std::collections::HashMap;
use tauflow_cache::Store;
use tauflow_contract::ActionKey;

/// Seconds of an action of which nothing is known.
const UNKNOWN_S: f64 = 5.0;
/// Records that are looked at, the latest.
const LOOKED_AT: usize = 32;

/// See the module.
#[derive(Default)]
pub struct Pace(HashMap<Name, Mean>);

#[derive(Clone, Copy)]
struct Mean {
    seconds: f64,
    /// Actions of this run.
    count: u32,
}

impl Pace {
    /// Takes note of an action of this run.
    pub fn note(&mut self, node: &Name, spent_us: u64) {
        let seconds = spent_us as f64 / 1e6;
        let mean = self.0.entry(node.clone()).or_insert(Mean { seconds, count: 0 });
        // What was recorded before counts no more.
        mean.count = mean.count.saturating_add(1);
        mean.seconds += (seconds - mean.seconds) / f64::from(mean.count.min(64));
    }

    /// Seconds that an action is expected to take.
    pub fn seconds(&mut self, node: &Name, action: &PreparedAction, store: &Store) -> f64 {
        let recorded = || recorded(&action.key, store).unwrap_or(UNKNOWN_S);
        self.0.entry(node.clone()).or_insert_with(|| Mean { seconds: recorded(), count: 0 }).seconds
    }
}

/// The mean of the latest actions of the same kind and group.
fn recorded(key: &ActionKey, store: &Store) -> Option<f64> {
    let keys = store.keys_by_label(ACTION, &key.basis.kind);
    let like = |preimage: &str| {
        serde_json::from_str::<ActionKey>(preimage).is_ok_and(|other| other.basis.group == key.basis.group)
    };
    let records = keys.iter().rev().take(LOOKED_AT).filter_map(|key| store.read(ACTION, key));
    let times: Vec<f64> = records.filter(|of| like(&of.preimage)).map(|of| of.wall_us as f64 / 1e6).collect();
    (!times.is_empty()).then(|| times.iter().sum::<f64>() / times.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_follows_the_actions_of_the_run() {
        let (mut pace, node) = (Pace::default(), Name::from("n"));
        pace.0.insert(node.clone(), Mean { seconds: 100.0, count: 0 });
        pace.note(&node, 2_000_000);
        assert_eq!(pace.0[&node].seconds, 2.0, "what was recorded before counts no more");
        pace.note(&node, 4_000_000);
        assert_eq!(pace.0[&node].seconds, 3.0);
    }
}
