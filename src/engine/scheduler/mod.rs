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

mod dispatch;
mod flow;
mod replies;
mod shards;
mod state;

pub use state::{Complete, CompleteShard, Finished};

use super::{
    RunOptions,
    event::{Ended, Event, Failure, Name, NodeStat, Slow},
    lanes::{Lane, Reader},
    records::Payload,
    rollup::{self, Known},
    whole::Whole,
    work::{Bench, Task},
};
use crate::pipeline::Pipeline;
use state::{Extra, LaneState, Names, Op, Ops, Status};
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap, HashMap, HashSet},
    sync::Arc,
};
use tauflow_cache::{CacheError, Digest};
use tauflow_contract::{ActionKey, ItemKey, Mode, SourceItem};

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
    /// An action is running that must be alone.
    measuring: bool,
    /// Items from which a lane goes by shards.
    many: u64,
    /// Bytes that may be held, that actions in flight are expected to hold, and by which of them.
    memory: u64,
    in_flight: u64,
    weights: HashMap<(usize, usize), u64>,
    /// Items of transient lanes that a dry run would make again.
    again: HashSet<(usize, ItemKey)>,
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
        options: &RunOptions,
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
                environment: lane.environment.clone(),
                alone: node.spec.measures(lane.group),
                seed: pipeline.seed,
                // What is asked for is stored.
                transient: node.transient && !lane.target,
                read: lane
                    .ports
                    .iter()
                    .copied()
                    .filter(|p| lane.readers.iter().any(|r| port_read(lanes, r) == *p))
                    .collect(),
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
            measuring: false,
            many: options.many,
            memory,
            in_flight: 0,
            weights: HashMap::new(),
            again: HashSet::new(),
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
                let gather = at.key.is_none();
                self.todo.push(turn);
                // What a gather makes is not known to be in any shard.
                if !gather {
                    self.open_readers(lane, shard);
                }
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

    /// Lanes that came to no end though nothing is left to do: a mistake of this scheduler, which must not pass for success.
    pub fn stuck(&self) -> Vec<Failure> {
        let open = self.states.iter().enumerate().filter(|(_, state)| !state.done);
        open.map(|(lane, state)| {
            let waiting = state.slots.iter().filter(|slot| !matches!(slot.status, Status::Ended(_))).count();
            let Names { node, cell, group } = &self.names[lane];
            let message = format!(
                "internal error: group `{group}` came to no end ({waiting} of {} actions and {} shards are open); please report \
                 it, and run with `--no-rollup`",
                state.slots.len(),
                state.open_shards
            );
            Failure { node: node.to_string(), cell: cell.to_string(), item: String::new(), message }
        })
        .collect()
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

/// The port of the lane before it that a reader reads.
fn port_read(lanes: &[Lane], reader: &Reader) -> usize {
    lanes[reader.lane].inputs[reader.input][reader.feed].port
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
