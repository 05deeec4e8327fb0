//! Chooses the next work: bundles to look up, and bundles to run, downstream nodes first, within the memory budget.

use super::{
    Scheduler, Turn,
    state::{Arrival, SlotStage},
};
use crate::engine::{
    ids::{LaneId, SlotId},
    job::{Bundle, Job},
};
use std::{cmp::Reverse, collections::BinaryHeap};

/// Actions that are looked up together.
const LOOK_UPS: usize = 64;
/// Time that a bundle of actions should take, in microseconds.
const BATCH_US: f64 = 2000.0;
/// Actions below this mean time, in microseconds, are short.
const SHORT_US: f64 = 1000.0;
/// Actions waiting to run from which no more of the same node are looked up: their keys take memory.
const WAITING: usize = 1024;

impl Scheduler<'_> {
    /// The next actions to look up, latest node first; none while enough is waiting to be run.
    pub fn next_look_up(&mut self) -> Option<Bundle> {
        let (node, Reverse(lane), _) = *self.ready.peek()?;
        if self.todo.len() >= WAITING && self.todo.peek().is_some_and(|top| top.0 >= node) {
            return None;
        }
        let slots = take(&mut self.ready, lane, LOOK_UPS);
        slots.iter().for_each(|slot| self.set_slot(lane, *slot, SlotStage::Sought));
        self.budget.begin_look_up(node);
        Some(self.bundle(lane, &slots))
    }

    /// The next actions to run, latest node first, for so many workers: several together when they are short. None
    /// when all have work, or when a later node is being looked up, unless the next are short. An action that measures
    /// runs alone: it waits for the others, and they for it.
    pub fn next_run(&mut self, workers: usize) -> Option<Bundle> {
        let (node, Reverse(lane), _) = *self.todo.peek()?;
        let alone = self.tasks[lane].alone;
        if !self.budget.admits(alone) {
            return None;
        }
        let mean = self.states[lane].pace.mean_us;
        let short = mean.is_some_and(|mean| mean < SHORT_US);
        let later = self.budget.seeks_after(node);
        if self.budget.running() >= workers * if short { 2 } else { 1 } || (later && !short) {
            return None;
        }
        let fits = mean.map_or(1.0, |mean| BATCH_US / mean.max(1.0));
        // The last ones are shared out.
        let share = self.todo.len() / (2 * workers.max(1));
        let limit = if alone { 1 } else { (fits as usize).clamp(1, LOOK_UPS).min(share.max(1)) };
        let mut slots = Vec::with_capacity(limit);
        while slots.len() < limit && self.todo.peek().is_some_and(|(_, Reverse(of), _)| *of == lane) {
            let Some((_, _, Reverse(slot))) = self.todo.peek().copied() else { break };
            if !self.budget.reserve((lane, slot), self.weight(lane, slot), self.bench.pool.bytes()) {
                break;
            }
            self.todo.pop();
            slots.push(slot);
        }
        if slots.is_empty() {
            return None;
        }
        slots.iter().for_each(|slot| self.set_slot(lane, *slot, SlotStage::Running));
        self.budget.begin_run(alone);
        Some(self.bundle(lane, &slots))
    }

    /// Bytes that an action is expected to hold: what it reads item by item, and what its like have made.
    fn weight(&self, lane: LaneId, slot: SlotId) -> u64 {
        let state = &self.states[lane];
        let Some(key) = &state.slots[slot].key else { return state.pace.mean_bytes };
        let arrived = state.inputs.iter().filter_map(|input| match input.arrived.get(key) {
            Some(Arrival::Item(output)) => Some(output.artifact.size()),
            _ => None,
        });
        arrived.fold(state.pace.mean_bytes, u64::saturating_add)
    }

    fn bundle(&mut self, lane: LaneId, slots: &[SlotId]) -> Bundle {
        let state = &mut self.states[lane];
        let whole = state.inputs.pairs().filter_map(|(id, input)| Some((id, input.whole.clone()?))).collect();
        let job = |slot: &SlotId| {
            let mut each = Vec::with_capacity(state.inputs.len());
            let at = &mut state.slots[*slot];
            if let Some(key) = &at.key {
                for (id, input) in state.inputs.pairs() {
                    if let Some(Arrival::Item(output)) = input.arrived.get(key) {
                        each.push((id, output.clone()));
                    }
                }
            }
            let files = at.extra.as_ref().map(|extra| extra.files.clone()).unwrap_or_default();
            let todo = at.extra.as_mut().and_then(|extra| extra.todo.take());
            Job { slot: *slot, item: at.key.clone(), each, files, todo }
        };
        Bundle { task: self.tasks[lane].clone(), whole, jobs: slots.iter().map(job).collect() }
    }
}

/// Takes slots of one lane off the top.
fn take(heap: &mut BinaryHeap<Turn>, lane: LaneId, limit: usize) -> Vec<SlotId> {
    let mut slots = Vec::with_capacity(limit);
    while slots.len() < limit && heap.peek().is_some_and(|(_, Reverse(of), _)| *of == lane) {
        let Some((_, _, Reverse(slot))) = heap.pop() else { break };
        slots.push(slot);
    }
    slots
}
