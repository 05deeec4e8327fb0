//! The scheduler: the one owner of every action's state. It decides what is looked up and run next; it does neither.
//!
//! Each lane is a row of slots, one for each item (one in all for a gather). A slot goes from waiting to ready, is looked up,
//! perhaps runs, and ends; only [`Scheduler::set`] moves it. What ends is handed to the readers at once, so that an item goes
//! on while its siblings are still worked on; whole collections are handed on when their lane is done.
//!
//! The slots of a lane are dealt to shards by their items' keys. Where items are many, a shard as a whole is looked up before
//! its items are: when all that it reads is known and none of it was made now, one look-up stands for all its items. The first
//! item of a shard that must run opens the same shard of all readers, so that nothing waits for a shard to be complete.
//!
//! In a dry run a slot that would run ends as such, and what reads it is blocked: its inputs are not known.

mod flow;
mod shards;
mod state;

pub use state::{Complete, CompleteShard, Finished};

use super::{
    event::{Ended, Event, Failure, Name, NodeStat, Slow},
    lanes::Lane,
    records::Payload,
    rollup::{self, Known},
    whole::Whole,
    work::{Batch, Bench, Job, Outcome, Reply, Task},
};
use crate::pipeline::Pipeline;
use state::{Extra, Given, LaneState, Names, Op, Ops, Status};
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap, HashMap, HashSet},
    sync::Arc,
};
use tauflow_cache::{CacheError, Digest};
use tauflow_contract::{ActionKey, ItemKey, Mode, SourceItem};

/// Actions that are looked up together.
const LOOK_UPS: usize = 64;
/// Time that a batch of actions should take, in microseconds.
const BATCH_US: f64 = 2000.0;
/// Actions below this mean time, in microseconds, are short.
const SHORT_US: f64 = 1000.0;
/// Actions waiting to run from which no more of the same stage are looked up: their keys take memory.
const WAITING: usize = 1024;
/// Actions that are named as the slowest.
pub const SLOWEST: usize = 5;

/// A place in the order of work: latest stage first.
type Turn = (usize, Reverse<usize>, Reverse<usize>);

/// See the module.
pub struct Scheduler<'a> {
    pipeline: &'a Pipeline,
    lanes: &'a [Lane],
    bench: &'a Bench<'a>,
    /// Shards may be looked up as wholes.
    roll: bool,
    tasks: Vec<Arc<Task>>,
    names: Vec<Names>,
    none: Name,
    states: Vec<LaneState>,
    ready: BinaryHeap<Turn>,
    todo: BinaryHeap<Turn>,
    ops: Ops,
    stats: Vec<NodeStat>,
    /// Actions that are new since [`Scheduler::take_events`], by node.
    expected: Vec<u64>,
    events: Vec<Event>,
    complete: Vec<Complete>,
    complete_shards: Vec<CompleteShard>,
    failures: Vec<Failure>,
    /// Blobs that readers missed in this pass.
    missing: HashSet<Digest>,
    /// Slots that ran in earlier passes: hits of this one.
    ran_before: &'a HashSet<(usize, Option<ItemKey>)>,
    /// How many of them there are in each lane and shard.
    ran_counts: HashMap<(usize, Option<u8>), u64>,
    ran: HashSet<(usize, Option<ItemKey>)>,
    keys: Vec<(usize, Option<ItemKey>, Ended, Box<ActionKey>)>,
    slowest: Vec<Slow>,
    fatal: Option<CacheError>,
    /// Batches that are being looked up, by node, and in all.
    sought: Vec<usize>,
    seeking: usize,
    running: usize,
    /// Bytes that may be held, that actions in flight are expected to hold, and by which of them.
    memory: u64,
    in_flight: u64,
    weights: HashMap<(usize, usize), u64>,
}

impl<'a> Scheduler<'a> {
    /// Lays out the lanes. `roll` says whether shards may be looked up as wholes; actions in flight are to hold no more than
    /// `memory` bytes.
    pub fn new(
        pipeline: &'a Pipeline,
        lanes: &'a [Lane],
        bench: &'a Bench<'a>,
        ran_before: &'a HashSet<(usize, Option<ItemKey>)>,
        roll: bool,
        memory: u64,
    ) -> Self {
        let task = |(number, lane): (usize, &Lane)| {
            let node = &pipeline.nodes[lane.node];
            Arc::new(Task {
                lane: number,
                kind: node.kind.clone(),
                spec: node.spec.clone(),
                group: lane.group,
                projection: node.kind.projection(&pipeline.cells[lane.cell].params),
                seed: pipeline.seed,
                // What is asked for is stored.
                transient: node.transient && !lane.target,
            })
        };
        let names = |lane: &Lane| Names {
            node: pipeline.nodes[lane.node].name.as_str().into(),
            cell: pipeline.cells[lane.cell].text.as_str().into(),
            group: lane.group.into(),
        };
        let stat = |n: &crate::pipeline::Node| NodeStat {
            node: n.name.clone(),
            kind: n.spec.name.into(),
            ..NodeStat::default()
        };
        let mut ran_counts = HashMap::new();
        for (lane, item) in ran_before {
            *ran_counts.entry((*lane, None)).or_insert(0) += 1;
            if let Some(item) = item {
                *ran_counts.entry((*lane, Some(item.shard()))).or_insert(0) += 1;
            }
        }
        Self {
            pipeline,
            lanes,
            bench,
            roll,
            tasks: lanes.iter().enumerate().map(task).collect(),
            names: lanes.iter().map(names).collect(),
            none: Name::default(),
            states: lanes.iter().map(|lane| LaneState::new(lane.inputs.iter().map(Vec::len), None)).collect(),
            ready: BinaryHeap::new(),
            todo: BinaryHeap::new(),
            ops: Ops::new(),
            stats: pipeline.nodes.iter().map(stat).collect(),
            expected: vec![0; pipeline.nodes.len()],
            events: Vec::new(),
            complete: Vec::new(),
            complete_shards: Vec::new(),
            failures: Vec::new(),
            missing: HashSet::new(),
            ran_before,
            ran_counts,
            ran: HashSet::new(),
            keys: Vec::new(),
            slowest: Vec::new(),
            fatal: None,
            sought: vec![0; pipeline.nodes.len()],
            seeking: 0,
            running: 0,
            memory,
            in_flight: 0,
            weights: HashMap::new(),
        }
    }

    /// Fills sources and gathers with their slots, and hands the outputs of rolled lanes on.
    pub fn start(&mut self, known: Known) {
        for (state, rolled) in self.states.iter_mut().zip(known.rolled) {
            state.rolled = rolled;
        }
        for ((lane, port), whole) in known.loaded {
            self.states[lane].results.insert(port, whole);
        }
        // Who goes by shards is settled before anything is handed on.
        let mut listed: Vec<Option<Vec<SourceItem>>> = Vec::new();
        for (lane, of) in self.lanes.iter().enumerate() {
            let source = self.pipeline.nodes[of.node].mode() == Mode::Source && self.states[lane].rolled.is_none();
            listed.push(source.then(|| self.list_source(lane)));
            match &listed[lane] {
                Some(items) => self.choose_source_by_shard(lane, items),
                None if self.states[lane].rolled.is_none() => self.choose_by_shard(lane),
                None => {}
            }
        }
        for ((lane, items), (wall_us, bytes)) in listed.into_iter().enumerate().zip(known.totals) {
            let node = self.lanes[lane].node;
            self.stats[node].lanes += 1;
            if let Some(payload) = &self.states[lane].rolled {
                let actions = payload.actions;
                self.stats[node].unchanged += 1;
                self.count_rolled(lane, None, (actions, wall_us, bytes));
                self.states[lane].known = true;
                self.states[lane].done = true;
                self.hand_on_whole(lane);
            } else if let Some(items) = items {
                self.fill_source(lane, items);
            } else if self.pipeline.nodes[node].mode() == Mode::Gather {
                self.add_slot(lane, None, Vec::new());
                self.states[lane].known = true;
            }
        }
        self.settle();
    }

    /// Counts actions that were looked up as one.
    fn count_rolled(&mut self, lane: usize, shard: Option<u8>, (actions, wall_us, bytes): (u64, u64, u64)) {
        let ran = self.ran_counts.get(&(lane, shard)).copied().unwrap_or(0).min(actions);
        let stat = &mut self.stats[self.lanes[lane].node];
        stat.hit += actions - ran;
        stat.ran += ran;
        stat.wall_s += wall_us as f64 / 1e6;
        stat.bytes += bytes;
        let Names { node, cell, group } = &self.names[lane];
        let (node, cell, group) = (node.clone(), cell.clone(), group.clone());
        self.events.push(Event::Unchanged { node, cell, group, actions });
    }

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
    /// have work, or when a later stage is being looked up, unless the next are short.
    pub fn next_run(&mut self, workers: usize) -> Option<Batch> {
        let (node, Reverse(lane), _) = *self.todo.peek()?;
        let mean = self.states[lane].mean_us;
        let short = mean.is_some_and(|mean| mean < SHORT_US);
        let later = self.sought[node + 1..].iter().any(|batches| *batches > 0);
        if self.running >= workers * if short { 2 } else { 1 } || (later && !short) {
            return None;
        }
        let fits = mean.map_or(1.0, |mean| BATCH_US / mean.max(1.0));
        // The last ones are shared out.
        let share = self.todo.len() / (2 * workers.max(1));
        let limit = (fits as usize).clamp(1, LOOK_UPS).min(share.max(1));
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

    /// Takes note of a batch that was looked up.
    pub fn looked_up(&mut self, replies: Vec<Reply>) -> Result<(), CacheError> {
        self.seeking -= 1;
        if let Some(reply) = replies.first() {
            self.sought[self.lanes[reply.slot.0].node] -= 1;
        }
        replies.into_iter().try_for_each(|reply| self.reply(reply))
    }

    /// Takes note of an action that was done; `last` says whether it was the last of its batch.
    pub fn performed(&mut self, reply: Reply, last: bool) -> Result<(), CacheError> {
        self.running -= usize::from(last);
        self.in_flight -= self.weights.remove(&reply.slot).unwrap_or(0);
        self.reply(reply)
    }

    /// Takes note of what became of an action.
    fn reply(&mut self, reply: Reply) -> Result<(), CacheError> {
        let (lane, slot) = reply.slot;
        if let Some(message) = reply.warning {
            self.events.push(Event::Warning { message });
        }
        if reply.file.is_some() {
            self.states[lane].slots[slot].extra.get_or_insert_default().file = reply.file;
        }
        let item = self.states[lane].slots[slot].key.clone();
        let ended = match reply.outcome {
            Outcome::Hit(made) => {
                self.states[lane].slots[slot].made = made;
                let before = !self.ran_before.is_empty() && self.ran_before.contains(&(lane, item.clone()));
                if before { Ended::Ran } else { Ended::Hit }
            }
            Outcome::Ran(made) => {
                self.note_run(lane, item.as_ref(), reply.spent_us, made.bytes);
                self.states[lane].slots[slot].made = made;
                self.ran.insert((lane, item.clone()));
                Ended::Ran
            }
            Outcome::Todo(todo) => {
                self.states[lane].slots[slot].extra.get_or_insert_default().todo = Some(todo);
                self.set(lane, slot, Status::Todo);
                self.settle();
                return Ok(());
            }
            Outcome::WouldRun => Ended::WouldRun,
            Outcome::Failed(message) => {
                self.fail(lane, item.as_ref(), message);
                Ended::Failed
            }
            Outcome::Missing(digest) if self.bench.wanted.contains(&digest) => {
                self.fail(lane, item.as_ref(), lost(&digest));
                Ended::Failed
            }
            Outcome::Missing(digest) => {
                self.missing.insert(digest);
                self.set(lane, slot, Status::Stalled);
                self.settle();
                return Ok(());
            }
            Outcome::Cancelled => {
                self.set(lane, slot, Status::Stalled);
                self.settle();
                return Ok(());
            }
            Outcome::Fatal(error) => return Err(error),
        };
        if let Some(key) = reply.key {
            self.keys.push((lane, item, ended, key));
        }
        self.set(lane, slot, Status::Ended(ended));
        self.settle();
        Ok(())
    }

    fn note_run(&mut self, lane: usize, item: Option<&ItemKey>, spent_us: u64, bytes: u64) {
        let stat = &mut self.stats[self.lanes[lane].node];
        stat.spent_s += spent_us as f64 / 1e6;
        stat.written += bytes;
        let mean = &mut self.states[lane].mean_us;
        *mean = Some(mean.map_or(spent_us as f64, |mean| mean + (spent_us as f64 - mean) / 8.0));
        let mean = &mut self.states[lane].mean_bytes;
        *mean = if *mean == 0 { bytes } else { (*mean * 7 + bytes) / 8 };
        let spent_s = spent_us as f64 / 1e6;
        if self.slowest.len() < SLOWEST || self.slowest.last().is_some_and(|last| last.spent_s < spent_s) {
            let Names { node, cell, .. } = &self.names[lane];
            let item = item.map_or_else(|| self.none.clone(), Name::from);
            let at = self.slowest.partition_point(|other| other.spent_s >= spent_s);
            self.slowest.insert(at, Slow { node: node.clone(), cell: cell.clone(), item, spent_s });
            self.slowest.truncate(SLOWEST);
        }
    }

    /// Moves a slot from one state to the next: the only place that does.
    fn set(&mut self, lane: usize, slot: usize, status: Status) {
        let at = &mut self.states[lane].slots[slot];
        at.status = status;
        let shard = at.shard;
        let turn = (self.lanes[lane].node, Reverse(lane), Reverse(slot));
        match status {
            Status::Waiting | Status::Sought | Status::Running | Status::Stalled => {}
            Status::Ready => self.ready.push(turn),
            Status::Todo => {
                self.todo.push(turn);
                self.open_readers(lane, shard);
            }
            Status::Ended(outcome) => {
                let (wall_us, bytes) = (at.made.wall_us, at.made.bytes);
                let item = at.key.as_ref().map_or_else(|| self.none.clone(), Name::from);
                let Names { node, cell, group } = &self.names[lane];
                let (node, cell, group) = (node.clone(), cell.clone(), group.clone());
                self.events.push(Event::End { node, cell, item, group, outcome, wall_us, bytes });
                let stat = &mut self.stats[self.lanes[lane].node];
                match outcome {
                    Ended::Hit => stat.hit += 1,
                    Ended::Ran | Ended::WouldRun => stat.ran += 1,
                    Ended::Failed => stat.failed += 1,
                    Ended::Blocked => stat.blocked += 1,
                }
                stat.wall_s += wall_us as f64 / 1e6;
                stat.bytes += bytes;
                let failed = !matches!(outcome, Ended::Hit | Ended::Ran);
                let state = &mut self.states[lane];
                state.open -= 1;
                state.failed |= failed;
                let of = &mut state.shards[usize::from(shard)];
                of.open -= 1;
                of.failed |= failed;
                let last = of.open == 0;
                self.hand_on(lane, slot);
                self.release(lane, slot);
                if last {
                    self.ops.push_back(Op::CheckShard { lane, shard });
                }
                if self.states[lane].open == 0 {
                    self.ops.push_back(Op::Check { lane });
                }
            }
        }
    }

    fn settle(&mut self) {
        while let Some(op) = self.ops.pop_front() {
            match op {
                Op::FeedDone { lane, input, broken } => self.feed_done(lane, input, broken),
                Op::ShardFed { lane, input, shard } => self.shard_fed(lane, input, shard),
                Op::Try { lane, slot } => self.try_ready(lane, slot),
                Op::Decide { lane, shard } => self.decide(lane, shard),
                Op::CheckShard { lane, shard } => self.check_shard(lane, shard),
                Op::Check { lane } => self.check_done(lane),
            }
        }
    }

    fn check_done(&mut self, lane: usize) {
        let gather = self.pipeline.nodes[self.lanes[lane].node].mode() == Mode::Gather;
        let state = &mut self.states[lane];
        if state.done || !state.known || state.open > 0 || (state.open_shards > 0 && !gather && !state.unknown) {
            return;
        }
        state.done = true;
        let node = self.lanes[lane].node;
        self.stats[node].unknown |= state.unknown;
        self.events.push(Event::Counted { node: self.names[lane].node.clone() });
        let state = &self.states[lane];
        if !state.unknown && !state.failed && self.lanes[lane].only.is_none() {
            let results = self.collect(lane);
            self.states[lane].results = results;
            let state = &self.states[lane];
            let mut complete = Complete { lane, actions: 0, wall_us: 0, bytes: 0 };
            let slots = state.slots.iter().map(|slot| (1, slot.made.wall_us, slot.made.bytes));
            for (actions, wall_us, bytes) in slots.chain(state.shards.iter().map(|shard| shard.totals)) {
                complete.actions += actions;
                complete.wall_us += wall_us;
                complete.bytes += bytes;
            }
            self.complete.push(complete);
        }
        self.hand_on_whole(lane);
    }

    /// The collections of a lane's ports.
    fn collect(&self, lane: usize) -> BTreeMap<usize, Arc<Whole>> {
        let state = &self.states[lane];
        let of_port = |port: &usize| {
            if let [slot] = &state.slots[..]
                && slot.key.is_none()
            {
                return slot.made.collection(*port).map(|whole| (*port, whole.clone()));
            }
            let part = |(number, shard): (usize, &state::Shard)| {
                let (_, part) = shard.parts.iter().find(|(at, _)| at == port)?;
                (part.len > 0).then(|| (number as u8, part.clone()))
            };
            let parts = state.shards.iter().enumerate().filter_map(part).collect();
            Some((*port, Arc::new(Whole::new(parts))))
        };
        self.lanes[lane].ports.iter().filter_map(of_port).collect()
    }

    fn fail(&mut self, lane: usize, item: Option<&ItemKey>, message: String) {
        let Names { node, cell, .. } = &self.names[lane];
        let item = item.map_or(String::new(), ToString::to_string);
        self.failures.push(Failure { node: node.to_string(), cell: cell.to_string(), item, message });
    }

    /// A failure of the lane as a whole: its items are not known.
    fn fail_lane(&mut self, lane: usize, message: String) {
        self.fail(lane, None, message);
        self.stats[self.lanes[lane].node].failed += 1;
        self.states[lane].unknown = true;
        self.ops.push_back(Op::Check { lane });
    }

    /// Batches that are being looked up.
    pub fn seeking(&self) -> usize {
        self.seeking
    }

    /// Batches that are being run.
    pub fn running(&self) -> usize {
        self.running
    }

    /// Failures so far.
    pub fn failures(&self) -> &[Failure] {
        &self.failures
    }

    /// What happened since this was last asked.
    pub fn take_events(&mut self) -> Vec<Event> {
        let mut events = Vec::new();
        for (node, actions) in self.expected.iter_mut().enumerate().filter(|(_, actions)| **actions > 0) {
            let node = self.pipeline.nodes[node].name.as_str().into();
            events.push(Event::Expect { node, actions: std::mem::take(actions) });
        }
        events.append(&mut self.events);
        events
    }

    /// The lanes that ended with all their outputs since this was last asked.
    pub fn take_complete(&mut self) -> Vec<Complete> {
        std::mem::take(&mut self.complete)
    }

    /// The shards that did.
    pub fn take_complete_shards(&mut self) -> Vec<CompleteShard> {
        std::mem::take(&mut self.complete_shards)
    }

    /// The error of the store that stops the run, if there was one.
    pub fn take_fatal(&mut self) -> Option<CacheError> {
        self.fatal.take()
    }

    /// The collection of a lane's port, once the lane is done.
    pub fn result(&self, lane: usize, port: usize) -> Option<&Arc<Whole>> {
        self.states[lane].results.get(&port)
    }

    /// Digest of the items of a source's lane, with those of the files that they read.
    pub fn listing(&self, lane: usize) -> Digest {
        let state = &self.states[lane];
        state.listing.unwrap_or_else(|| {
            let file = |slot: &state::Slot| slot.extra.as_ref().and_then(|extra| extra.file);
            rollup::listing_digest(state.slots.iter().filter_map(|slot| Some((slot.key.as_ref()?, file(slot)))))
        })
    }

    /// The node of a lane.
    pub fn node_of(&self, lane: usize) -> usize {
        self.lanes[lane].node
    }

    /// What a rolled lane's roll-up says.
    pub fn rolled(&self, lane: usize) -> Option<&Payload> {
        self.states[lane].rolled.as_ref()
    }

    /// Ends the pass.
    pub fn finish(self) -> Finished {
        Finished {
            stats: self.stats,
            failures: self.failures,
            missing: self.missing,
            ran: self.ran,
            keys: self.keys,
            slowest: self.slowest,
        }
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

/// A blob that does not come back.
fn lost(digest: &Digest) -> String {
    format!(
        "blob {} is missing, and running again what made it did not give it back; run `tauflow cache verify`, and report \
         it if that finds nothing",
        digest.short()
    )
}

fn with_files(files: Vec<(String, std::path::PathBuf)>) -> Option<Box<Extra>> {
    (!files.is_empty()).then(|| Box::new(Extra { files, ..Extra::default() }))
}
