//! What is handed out next: bundles to look up, and batches to run, latest node first, as far as the executor has
//! capacity.

use super::{
    Scheduler, Turn,
    state::{Arrival, LaneState, SlotStage},
};
use crate::engine::{
    execute::{PreparedAction, Whole},
    executor::{Batch, Capacity, Order},
    ids::{InputId, LaneId, SlotId},
    output::Output,
    request::{LookUp, LookUps, Request, ShardLookUps, Todo},
};
use std::{cmp::Reverse, collections::BinaryHeap, sync::Arc};

/// Actions that are looked up together.
const LOOK_UPS: usize = 64;
/// Shards that are read together.
const READS: usize = 16;
/// Roll-ups that are kept together.
const KEEPS: usize = 32;
/// Time that a bundle of actions should take, in microseconds.
const BATCH_US: f64 = 2000.0;
/// Actions below this mean time, in microseconds, are short.
const SHORT_US: f64 = 1000.0;
/// Actions waiting to run from which no more of the same node are looked up: their keys take memory.
const WAITING: usize = 1024;

impl Scheduler<'_> {
    /// Roll-ups to be kept.
    pub fn next_keep(&mut self) -> Option<Request> {
        for lane in std::mem::take(&mut self.asked.ended) {
            match self.lane_to_keep(lane) {
                Some(keep) => self.asked.keeps.push(keep),
                None => self.asked.ended.push(lane),
            }
        }
        if self.asked.keeps.is_empty() {
            return None;
        }
        self.seeking.begin(0); // of no node in particular
        let most = self.asked.keeps.len().min(KEEPS);
        Some(Request::Keep(self.asked.keeps.drain(..most).collect()))
    }

    /// The next request: first the requests that others wait for, then actions.
    pub fn next_request(&mut self) -> Option<Request> {
        if let Some(request) = self.asked.rolled.take() {
            self.seeking.begin(0); // of no node in particular
            return Some(request);
        }
        let (lane, request) = self.next_question()?;
        self.seeking.begin(self.lanes[lane].node);
        Some(request)
    }

    fn next_question(&mut self) -> Option<(LaneId, Request)> {
        if let Some(lane) = self.asked.lists.pop_front() {
            let kind = self.tasks[lane].producer.kind.clone();
            let params = self.pipeline.cells[self.lanes[lane].cell].params.clone();
            return Some((lane, Request::List { lane, kind, params }));
        }
        if let Some(merge) = self.asked.merges.pop_front() {
            return Some((merge.lane, Request::Merge(merge)));
        }
        if let Some(first) = self.asked.reads.front() {
            let lane = first.reader.lane;
            let like = self.asked.reads.iter().take(READS).take_while(|read| read.reader.lane == lane).count();
            return Some((lane, Request::Read(self.asked.reads.drain(..like).collect())));
        }
        if let Some((lane, shards)) = self.asked.shards.pop_last() {
            return Some((lane, Request::Shards(ShardLookUps { task: self.tasks[lane].clone(), shards })));
        }
        let bundle = self.next_look_up()?;
        Some((bundle.task.lane, Request::Actions(bundle)))
    }

    /// The next actions to look up, latest node first; none while enough is waiting to be run.
    fn next_look_up(&mut self) -> Option<LookUps> {
        let (node, Reverse(lane), _) = *self.ready.peek()?;
        if self.todo.len() >= WAITING && self.todo.peek().is_some_and(|top| top.0 >= node) {
            return None;
        }
        let slots = take(&mut self.ready, lane, LOOK_UPS);
        slots.iter().for_each(|slot| self.set_slot(lane, *slot, SlotStage::Sought));
        let state = &self.states[lane];
        let asked = |slot: &SlotId| {
            let at = &state.slots[*slot];
            let files = at.extra.as_ref().map(|extra| extra.files.clone()).unwrap_or_default();
            LookUp { slot: *slot, item: at.key.clone(), each: state.each(*slot), files }
        };
        let actions = slots.iter().map(asked).collect();
        Some(LookUps { task: self.tasks[lane].clone(), whole: Arc::new(state.whole()), actions })
    }

    /// The next actions to run, latest node first, as many as there is capacity for: several together when they are
    /// short. None when all workers are busy, or when a later node is being looked up, unless the next are short. An
    /// action that measures runs alone: it waits for the others, and they for it.
    pub fn next_run(&mut self, mut capacity: Capacity) -> Option<Batch> {
        let (node, Reverse(lane), _) = *self.todo.peek()?;
        let alone = self.tasks[lane].alone;
        if !capacity.admits(alone) {
            return None;
        }
        let mean = self.states[lane].pace.mean_us;
        let short = mean.is_some_and(|mean| mean < SHORT_US);
        let later = self.seeking.after(node);
        if capacity.batches >= capacity.workers * if short { 2 } else { 1 } || (later && !short) {
            return None;
        }
        let fits = mean.map_or(1.0, |mean| BATCH_US / mean.max(1.0));
        // The last ones are shared out.
        let share = self.todo.len() / (2 * capacity.workers.max(1));
        let limit = if alone { 1 } else { (fits as usize).clamp(1, LOOK_UPS).min(share.max(1)) };
        let whole = Arc::new(self.states[lane].whole());
        let mut orders = Vec::with_capacity(limit);
        while orders.len() < limit && self.todo.peek().is_some_and(|(_, Reverse(of), _)| *of == lane) {
            let Some((_, _, Reverse(slot))) = self.todo.peek().copied() else { break };
            let bytes = self.weight(lane, slot);
            if !capacity.reserve(bytes) {
                break;
            }
            self.todo.pop();
            match self.prepare(lane, slot, &whole) {
                Some(action) => {
                    if action.before.is_some() {
                        self.account.compare((lane, slot));
                    }
                    orders.push(Order { slot: (lane, slot), bytes, action });
                }
                None => {
                    self.fail_lane(lane, "internal error: an action was to run without a key; please report it".into());
                }
            }
        }
        if orders.is_empty() {
            return None;
        }
        orders.iter().for_each(|order| self.set_slot(lane, order.slot.1, SlotStage::Running));
        self.in_flight += orders.len();
        let label = self.tasks[lane].label.clone();
        Some(Batch { label, alone, wanted: self.wanted.clone(), orders })
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

    /// An action that was looked up, with everything that it needs to run.
    fn prepare(&mut self, lane: LaneId, slot: SlotId, whole: &Arc<Whole>) -> Option<PreparedAction> {
        let state = &mut self.states[lane];
        let Todo { key, hash, file, before } = *state.slots[slot].extra.as_mut()?.todo.take()?;
        let (item, each) = (state.slots[slot].key.clone(), state.each(slot));
        let producer = self.tasks[lane].producer.clone();
        Some(PreparedAction { producer, key, hash, item, each, whole: whole.clone(), file, before })
    }
}

impl LaneState {
    /// The collections that its actions read.
    fn whole(&self) -> Whole {
        self.inputs.pairs().filter_map(|(id, input)| Some((id, input.whole.clone()?))).collect()
    }

    /// The items that have arrived for a slot.
    fn each(&self, slot: SlotId) -> Vec<(InputId, Arc<Output>)> {
        let mut each = Vec::with_capacity(self.inputs.len());
        if let Some(key) = &self.slots[slot].key {
            for (id, input) in self.inputs.pairs() {
                if let Some(Arrival::Item(output)) = input.arrived.get(key) {
                    each.push((id, output.clone()));
                }
            }
        }
        each
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
