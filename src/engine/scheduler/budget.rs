//! Limits of concurrent work: look-ups, actions, their memory, and exclusive use of the machine for measurements. Does
//! not know which work is ready.

use crate::engine::ids::{LaneId, SlotId};
use std::collections::HashMap;

/// See the module.
pub(super) struct Budget {
    /// Bytes that may be held.
    memory: u64,
    /// Bytes that actions in flight are expected to hold, and by which of them.
    in_flight: u64,
    weights: HashMap<(LaneId, SlotId), u64>,
    /// Bundles that are being run.
    running: usize,
    /// An action is running that must be alone.
    measuring: bool,
    /// Bundles that are being looked up, by node, and in all.
    sought: Vec<usize>,
    seeking: usize,
}

impl Budget {
    /// A budget of the given memory, with nothing running.
    pub fn new(memory: u64, nodes: usize) -> Self {
        Self {
            memory,
            in_flight: 0,
            weights: HashMap::new(),
            running: 0,
            measuring: false,
            sought: vec![0; nodes],
            seeking: 0,
        }
    }

    /// Bundles that are being looked up.
    pub fn seeking(&self) -> usize {
        self.seeking
    }

    /// Bundles that are being run.
    pub fn running(&self) -> usize {
        self.running
    }

    /// A bundle of a node goes to be looked up.
    pub fn begin_look_up(&mut self, node: usize) {
        self.sought[node] += 1;
        self.seeking += 1;
    }

    /// A bundle of a node was looked up.
    pub fn end_look_up(&mut self, node: usize) {
        self.sought[node] -= 1;
        self.seeking -= 1;
    }

    /// Whether a node after this one is being looked up.
    pub fn seeks_after(&self, node: usize) -> bool {
        self.sought[node + 1..].iter().any(|bundles| *bundles > 0)
    }

    /// Whether an action may begin now, where those that measure run `alone`: they wait for the others, and the others
    /// for them.
    pub fn admits(&self, alone: bool) -> bool {
        !(self.measuring || alone && self.running > 0)
    }

    /// Takes memory for an action, beside what is `pooled`; false if there is none left. One action runs whatever it
    /// takes.
    pub fn reserve(&mut self, slot: (LaneId, SlotId), bytes: u64, pooled: u64) -> bool {
        let all = self.in_flight.saturating_add(bytes).saturating_add(pooled);
        if self.in_flight > 0 && all > self.memory {
            return false;
        }
        self.in_flight += bytes.max(1);
        self.weights.insert(slot, bytes.max(1));
        true
    }

    /// A bundle begins to run.
    pub fn begin_run(&mut self, alone: bool) {
        self.running += 1;
        self.measuring = alone;
    }

    /// An action has run; `last` says whether it was the last of its bundle.
    pub fn end_run(&mut self, slot: (LaneId, SlotId), last: bool) {
        self.running -= usize::from(last);
        self.measuring &= !last;
        self.in_flight -= self.weights.remove(&slot).unwrap_or(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::ids::Id;

    fn slot(n: usize) -> (LaneId, SlotId) {
        (LaneId::at(0), SlotId::at(n))
    }

    #[test]
    fn memory_is_given_back_and_one_action_always_runs() {
        let mut budget = Budget::new(10, 1);
        assert!(budget.reserve(slot(0), 100, 0), "nothing else is in flight");
        assert!(!budget.reserve(slot(1), 1, 0));
        budget.begin_run(false);
        budget.end_run(slot(0), true);
        assert!(budget.reserve(slot(1), 4, 0) && budget.reserve(slot(2), 6, 0));
        assert!(!budget.reserve(slot(3), 0, 1), "what is pooled counts");
        assert!(!budget.reserve(slot(3), u64::MAX, 1), "records may say any size");
        assert_eq!(budget.in_flight, 10);
    }

    #[test]
    fn what_measures_runs_alone() {
        let mut budget = Budget::new(10, 1);
        budget.begin_run(false);
        assert!(budget.admits(false) && !budget.admits(true));
        budget.end_run(slot(0), true);
        assert!(budget.admits(true));
        budget.begin_run(true);
        assert!(!budget.admits(false) && !budget.admits(true));
        budget.end_run(slot(0), true);
        assert!(budget.admits(false) && budget.running() == 0);
    }

    #[test]
    fn later_nodes_are_told_from_earlier_ones() {
        let mut budget = Budget::new(10, 3);
        budget.begin_look_up(1);
        assert!(budget.seeks_after(0) && !budget.seeks_after(1) && !budget.seeks_after(2));
        budget.end_look_up(1);
        assert!(!budget.seeks_after(0) && budget.seeking() == 0);
    }
}
