//! What an executor has taken on: batches, the memory that their actions hold, and the machine itself where one
//! measures.

use super::Batch;
use crate::engine::ids::{LaneId, SlotId};
use std::collections::HashMap;

/// See the module.
pub struct Budget {
    /// Actions at a time.
    workers: usize,
    /// Bytes that may be held.
    memory: u64,
    /// Bytes that actions are expected to hold, and by which of them.
    in_flight: u64,
    weights: HashMap<(LaneId, SlotId), u64>,
    /// Batches that run or wait for a worker.
    batches: usize,
    /// An action is running that must be alone.
    measuring: bool,
    /// Actions that must be alone have another machine.
    elsewhere: bool,
}

/// The work that an executor accepts now. A scheduler fills a batch against it.
#[derive(Clone, Copy, Debug)]
pub struct Capacity {
    /// Actions that run at a time.
    pub workers: usize,
    /// Batches that it has.
    pub batches: usize,
    /// An action is running that must have the machine to itself.
    measuring: bool,
    /// Such actions have another machine.
    elsewhere: bool,
    /// Bytes that may be held, and that are.
    memory: u64,
    in_flight: u64,
    /// Bytes of transient outputs, which are held beside.
    pooled: u64,
}

impl Capacity {
    /// Whether an action may begin now, where those that measure run `alone`: they wait for the others, and the others
    /// for them.
    pub fn admits(&self, alone: bool) -> bool {
        self.elsewhere || !(self.measuring || alone && self.batches > 0)
    }

    /// Takes memory for an action; false if there is none left. One action runs whatever it takes.
    pub fn reserve(&mut self, bytes: u64) -> bool {
        let all = self.in_flight.saturating_add(bytes).saturating_add(self.pooled);
        if self.in_flight > 0 && all > self.memory {
            return false;
        }
        self.in_flight = self.in_flight.saturating_add(bytes.max(1));
        true
    }
}

impl Budget {
    /// The budget of this many workers and this much memory, with nothing in flight.
    pub fn new(workers: usize, memory: u64) -> Self {
        let weights = HashMap::new();
        Self { workers, memory, in_flight: 0, weights, batches: 0, measuring: false, elsewhere: false }
    }

    /// The same, where actions that must be alone have another machine to themselves.
    pub fn measuring_elsewhere(self) -> Self {
        Self { elsewhere: true, ..self }
    }

    /// The work that is accepted in addition to `pooled` bytes of transient outputs.
    pub fn capacity(&self, pooled: u64) -> Capacity {
        let Self { workers, memory, in_flight, batches, measuring, elsewhere, .. } = *self;
        Capacity { workers, batches, measuring, elsewhere, memory, in_flight, pooled }
    }

    /// A batch is taken on.
    pub fn begin(&mut self, batch: &Batch) {
        self.batches += 1;
        self.measuring |= batch.alone && !self.elsewhere;
        for order in &batch.orders {
            self.weigh(order.slot, order.bytes);
        }
    }

    fn weigh(&mut self, slot: (LaneId, SlotId), bytes: u64) {
        self.in_flight = self.in_flight.saturating_add(bytes.max(1));
        self.weights.insert(slot, bytes.max(1));
    }

    /// An action has ended; `last` says whether it was the last of its batch.
    pub fn end(&mut self, slot: (LaneId, SlotId), last: bool) {
        self.batches -= usize::from(last);
        self.measuring &= !last;
        self.in_flight = self.in_flight.saturating_sub(self.weights.remove(&slot).unwrap_or(0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::{event::Name, ids::Id, request::LaneName};
    use std::sync::Arc;

    fn slot(n: usize) -> (LaneId, SlotId) {
        (LaneId::at(0), SlotId::at(n))
    }

    fn batch(alone: bool) -> Batch {
        let label = LaneName { node: Name::default(), cell: Name::default() };
        Batch { label, alone, wanted: Arc::default(), orders: Vec::new() }
    }

    #[test]
    fn memory_is_given_back_and_one_action_always_runs() {
        let mut budget = Budget::new(1, 10);
        assert!(budget.capacity(0).reserve(100), "nothing else is in flight");
        budget.weigh(slot(0), 100);
        assert!(!budget.capacity(0).reserve(1));
        budget.begin(&batch(false));
        budget.end(slot(0), true);
        let mut capacity = budget.capacity(0);
        assert!(capacity.reserve(4) && capacity.reserve(6) && !capacity.reserve(1));
        budget.weigh(slot(1), 4);
        budget.weigh(slot(2), 6);
        assert!(!budget.capacity(1).reserve(0), "what is pooled counts");
        assert!(!budget.capacity(1).reserve(u64::MAX), "records may say any size");
        assert_eq!(budget.in_flight, 10);
    }

    #[test]
    fn what_measures_runs_alone() {
        let mut budget = Budget::new(2, 10);
        budget.begin(&batch(false));
        assert!(budget.capacity(0).admits(false) && !budget.capacity(0).admits(true));
        budget.end(slot(0), true);
        assert!(budget.capacity(0).admits(true));
        budget.begin(&batch(true));
        assert!(!budget.capacity(0).admits(false) && !budget.capacity(0).admits(true));
        budget.end(slot(0), true);
        assert!(budget.capacity(0).admits(false) && budget.capacity(0).batches == 0);
        let mut budget = Budget::new(2, 10).measuring_elsewhere();
        budget.begin(&batch(true));
        assert!(budget.capacity(0).admits(false) && budget.capacity(0).admits(true), "it has a machine of its own");
    }
}
