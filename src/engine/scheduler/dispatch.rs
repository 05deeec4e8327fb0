//! What is handed out next: batches to look up, and batches to run, latest stage first, within the memory that there is.

use super::{
    Scheduler, Turn,
    state::{Given, Status},
};
use crate::engine::work::{Batch, Job};
use std::{cmp::Reverse, collections::BinaryHeap};

/// Actions that are looked up together.
const LOOK_UPS: usize = 64;
/// Time that a batch of actions should take, in microseconds.
const BATCH_US: f64 = 2000.0;
/// Actions below this mean time, in microseconds, are short.
const SHORT_US: f64 = 1000.0;
/// Actions waiting to run from which no more of the same stage are looked up: their keys take memory.
const WAITING: usize = 1024;
impl Scheduler<'_> {
    /// The next actions to look up, latest stage first; none while enough is waiting to be run.
    pub fn next_look_up(&mut self) -> Option<Batch> {
        let (node, Reverse(lane), _) = *self.ready.peek()?;
        if self.todo.len() >= WAITING && self.todo.peek().is_some_and(|top| top.0 >= node) {
            return None;
        }
        let slots = take(&mut self.ready, lane, LOOK_UPS);
        slots.iter().for_each(|slot| self.set(lane, *slot, Status::Sought));
        self.sought[node] += 1;
        self.seeking += 1;
        Some(self.batch(lane, &slots))
    }

    /// The next actions to run, latest stage first, for so many workers: several together when they are short. None when all
    /// have work, or when a later stage is being looked up, unless the next are short. An action that measures runs alone: it
    /// waits for the others, and they for it.
    pub fn next_run(&mut self, workers: usize) -> Option<Batch> {
        let (node, Reverse(lane), _) = *self.todo.peek()?;
        let alone = self.tasks[lane].alone;
        if self.measuring || (alone && self.running > 0) {
            return None;
        }
        let mean = self.states[lane].mean_us;
        let short = mean.is_some_and(|mean| mean < SHORT_US);
        let later = self.sought[node + 1..].iter().any(|batches| *batches > 0);
        if self.running >= workers * if short { 2 } else { 1 } || (later && !short) {
            return None;
        }
        let fits = mean.map_or(1.0, |mean| BATCH_US / mean.max(1.0));
        // The last ones are shared out.
        let share = self.todo.len() / (2 * workers.max(1));
        let limit = if alone { 1 } else { (fits as usize).clamp(1, LOOK_UPS).min(share.max(1)) };
        let mut slots = Vec::with_capacity(limit);
        while slots.len() < limit && self.todo.peek().is_some_and(|(_, Reverse(of), _)| *of == lane) {
            let Some((_, _, Reverse(slot))) = self.todo.peek().copied() else { break };
            // One action runs whatever it takes.
            let bytes = self.weight(lane, slot);
            if self.in_flight > 0 && self.in_flight + bytes + self.bench.pool.bytes() > self.memory {
                break;
            }
            self.todo.pop();
            self.in_flight += bytes.max(1);
            self.weights.insert((lane, slot), bytes.max(1));
            slots.push(slot);
        }
        if slots.is_empty() {
            return None;
        }
        slots.iter().for_each(|slot| self.set(lane, *slot, Status::Running));
        self.running += 1;
        self.measuring = alone;
        Some(self.batch(lane, &slots))
    }

    /// Bytes that an action is expected to hold: what it reads item by item, and what its like have made.
    fn weight(&self, lane: usize, slot: usize) -> u64 {
        let state = &self.states[lane];
        let Some(key) = &state.slots[slot].key else { return state.mean_bytes };
        let given = state.inputs.iter().filter_map(|input| match input.given.get(key) {
            Some(Given::Item(output)) => Some(output.artifact.size()),
            _ => None,
        });
        given.sum::<u64>() + state.mean_bytes
    }

    fn batch(&mut self, lane: usize, slots: &[usize]) -> Batch {
        let lanes = self.lanes;
        let inputs = &lanes[lane].inputs;
        let state = &mut self.states[lane];
        let whole = state.inputs.iter().enumerate();
        let whole = whole.filter_map(|(port, input)| Some((port, input.whole.clone()?))).collect();
        let job = |slot: &usize| {
            let mut each = Vec::with_capacity(inputs.len());
            let at = &mut state.slots[*slot];
            if let Some(key) = &at.key {
                for (port, input) in state.inputs.iter().enumerate() {
                    if let Some(Given::Item(output)) = input.given.get(key) {
                        each.push((port, output.clone()));
                    }
                }
            }
            let files = at.extra.as_ref().map(|extra| extra.files.clone()).unwrap_or_default();
            let todo = at.extra.as_mut().and_then(|extra| extra.todo.take());
            Job { slot: *slot, item: at.key.clone(), each, files, todo }
        };
        Batch { task: self.tasks[lane].clone(), whole, jobs: slots.iter().map(job).collect() }
    }
}

/// Takes slots of one lane off the top.
fn take(heap: &mut BinaryHeap<Turn>, lane: usize, limit: usize) -> Vec<usize> {
    let mut slots = Vec::with_capacity(limit);
    while slots.len() < limit && heap.peek().is_some_and(|(_, Reverse(of), _)| *of == lane) {
        let Some((_, _, Reverse(slot))) = heap.pop() else { break };
        slots.push(slot);
    }
    slots
}
