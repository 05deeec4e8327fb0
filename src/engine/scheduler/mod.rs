//! The scheduler: the one owner of every action's state. It decides what runs next; it does not run it.
//!
//! Each lane is a row of slots, one for each item (one in all for a gather). A slot goes from waiting to ready to
//! running to an end, and only [`Scheduler::set`] moves it. What ends is handed to the readers at once, so that an item
//! goes on while its siblings are still worked on; whole collections are handed on when their lane is done.
//!
//! In a dry run a slot that would run ends as such, and what reads it is blocked: its inputs are not known.

mod flow;
mod state;

pub use state::{Complete, Finished};

use super::{
    event::{Ended, Event, Failure, NodeStat},
    lanes::Lane,
    records::{Payload, Whole},
    work::{FILE_PORT, Job, Outcome, Reply},
};
use crate::pipeline::Pipeline;
use state::{Given, Input, LaneState, Op, Slot, Status};
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap, HashMap, HashSet, VecDeque},
    sync::Arc,
};
use tauflow_cache::Digest;
use tauflow_contract::{ActionKey, ItemKey, Mode};

/// See the module.
pub struct Scheduler<'a> {
    pipeline: &'a Pipeline,
    lanes: &'a [Lane],
    states: Vec<LaneState>,
    ready: BinaryHeap<(usize, Reverse<usize>, Reverse<usize>)>,
    ops: VecDeque<Op>,
    stats: Vec<NodeStat>,
    /// Events for whoever looks on; taken by [`Scheduler::take_events`].
    events: Vec<Event>,
    /// Lanes that ended since they were last taken.
    complete: Vec<Complete>,
    failures: Vec<Failure>,
    /// Blobs that readers missed in this pass.
    missing: HashSet<Digest>,
    /// Blobs that were missed in earlier passes.
    wanted: &'a HashSet<Digest>,
    /// Slots that ran in earlier passes: hits of this one.
    ran_before: &'a HashSet<(usize, Option<ItemKey>)>,
    ran: HashSet<(usize, Option<ItemKey>)>,
    keys: Vec<(usize, Option<ItemKey>, Ended, Box<ActionKey>)>,
    keep_keys: bool,
    running: usize,
}

impl<'a> Scheduler<'a> {
    /// Lays out the lanes. `rolled` are those whose outputs are known from a roll-up; `loaded` are the collections of
    /// their ports that other lanes need.
    pub fn new(
        pipeline: &'a Pipeline,
        lanes: &'a [Lane],
        rolled: Vec<Option<Payload>>,
        wanted: &'a HashSet<Digest>,
        ran_before: &'a HashSet<(usize, Option<ItemKey>)>,
        keep_keys: bool,
    ) -> Self {
        let states = lanes
            .iter()
            .zip(rolled)
            .map(|(lane, rolled)| LaneState {
                slots: Vec::new(),
                index: HashMap::new(),
                inputs: lane.inputs.iter().map(|f| Input { open: f.len(), ..Input::default() }).collect(),
                known: false,
                open: 0,
                done: false,
                unknown: false,
                failed: false,
                results: BTreeMap::new(),
                rolled,
            })
            .collect();
        let stats = pipeline
            .nodes
            .iter()
            .map(|n| NodeStat { node: n.name.clone(), kind: n.spec.name.into(), ..NodeStat::default() })
            .collect();
        Self {
            pipeline,
            lanes,
            states,
            ready: BinaryHeap::new(),
            ops: VecDeque::new(),
            stats,
            events: Vec::new(),
            complete: Vec::new(),
            failures: Vec::new(),
            missing: HashSet::new(),
            wanted,
            ran_before,
            ran: HashSet::new(),
            keys: Vec::new(),
            keep_keys,
            running: 0,
        }
    }

    /// Fills sources and gathers with their slots, and hands the outputs of rolled lanes on.
    pub fn start(&mut self, loaded: BTreeMap<(usize, usize), Arc<Whole>>, totals: &[(u64, u64)]) {
        for ((lane, port), whole) in loaded {
            self.states[lane].results.insert(port, whole);
        }
        for (lane, &(wall_us, bytes)) in totals.iter().enumerate() {
            let node = self.lanes[lane].node;
            self.stats[node].lanes += 1;
            if let Some(payload) = self.states[lane].rolled.clone() {
                let stat = &mut self.stats[node];
                stat.hit += payload.actions;
                stat.unchanged += 1;
                stat.wall_s += wall_us as f64 / 1e6;
                stat.bytes += bytes;
                self.states[lane].known = true;
                self.states[lane].done = true;
                let (name, cell, group) = self.names(lane);
                self.events.push(Event::Unchanged { node: name, cell, group, actions: payload.actions });
                self.hand_on_whole(lane);
                continue;
            }
            match self.pipeline.nodes[node].mode() {
                Mode::Source => self.fill_source(lane),
                Mode::Gather => {
                    self.add_slot(lane, None, Vec::new());
                    self.states[lane].known = true;
                }
                Mode::Map => {}
            }
        }
        self.settle();
    }

    /// The next action to do, latest stage first.
    pub fn next_job(&mut self) -> Option<Job> {
        let (_, Reverse(lane), Reverse(slot)) = self.ready.pop()?;
        let of = &self.lanes[lane];
        let node = &self.pipeline.nodes[of.node];
        let state = &self.states[lane];
        let key = state.slots[slot].key.clone();
        let (mut each, mut whole) = (Vec::new(), Vec::new());
        for (input, port) in node.spec.inputs.iter().enumerate() {
            if let Some(collection) = &state.inputs[input].whole {
                whole.push((port.name, collection.clone()));
            } else if let Some(key) = &key
                && let Some(Given::Item(artifact)) = state.inputs[input].given.get(key)
            {
                each.push((port.name, artifact.clone()));
            }
        }
        let job = Job {
            slot: (lane, slot),
            kind: node.kind.clone(),
            spec: node.spec.clone(),
            group: of.group,
            item: key,
            params: self.pipeline.cells[of.cell].params.clone(),
            seed: self.pipeline.seed,
            each,
            whole,
            files: state.slots[slot].files.clone(),
        };
        self.running += 1;
        self.set(lane, slot, Status::Running);
        Some(job)
    }

    /// Takes note of what became of an action.
    pub fn reply(&mut self, reply: Reply, spent_us: u64) -> Result<(), tauflow_cache::CacheError> {
        let (lane, slot) = reply.slot;
        self.running -= 1;
        if let Some(message) = reply.warning {
            self.events.push(Event::Warning { message });
        }
        let id = (lane, self.states[lane].slots[slot].key.clone());
        self.states[lane].slots[slot].file = reply.key.as_ref().and_then(|k| k.inputs.get(FILE_PORT).copied());
        let ended = match reply.outcome {
            Outcome::Hit(made) => {
                self.states[lane].slots[slot].made = made;
                if self.ran_before.contains(&id) { Ended::Ran } else { Ended::Hit }
            }
            Outcome::Ran(made) => {
                self.stats[self.lanes[lane].node].spent_s += spent_us as f64 / 1e6;
                self.states[lane].slots[slot].made = made;
                self.ran.insert(id.clone());
                Ended::Ran
            }
            Outcome::WouldRun => Ended::WouldRun,
            Outcome::Failed(message) => {
                self.fail(lane, id.1.as_ref(), message);
                Ended::Failed
            }
            Outcome::Missing(digest) if self.wanted.contains(&digest) => {
                let message = format!(
                    "blob {} is missing, and running again what made it did not give it back; run `tauflow cache \
                     verify`, and report it if that finds nothing",
                    digest.short()
                );
                self.fail(lane, id.1.as_ref(), message);
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
        if self.keep_keys
            && let Some(key) = reply.key
        {
            self.keys.push((lane, id.1, ended, key));
        }
        self.set(lane, slot, Status::Ended(ended));
        self.settle();
        Ok(())
    }

    /// Moves a slot from one state to the next: the only place that does.
    fn set(&mut self, lane: usize, slot: usize, status: Status) {
        self.states[lane].slots[slot].status = status;
        let (node, cell, group) = self.names(lane);
        let item = self.states[lane].slots[slot].key.as_ref().map_or(String::new(), ToString::to_string);
        match status {
            Status::Waiting | Status::Stalled => {}
            Status::Ready => self.ready.push((self.lanes[lane].node, Reverse(lane), Reverse(slot))),
            Status::Running => self.events.push(Event::Begin { node, cell, item }),
            Status::Ended(outcome) => {
                let (wall_us, bytes) = {
                    let made = &self.states[lane].slots[slot].made;
                    (made.wall_us, made.bytes)
                };
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
                let state = &mut self.states[lane];
                state.open -= 1;
                state.failed |= !matches!(outcome, Ended::Hit | Ended::Ran);
                self.hand_on(lane, slot);
                self.ops.push_back(Op::Check { lane });
            }
        }
    }

    fn settle(&mut self) {
        while let Some(op) = self.ops.pop_front() {
            match op {
                Op::Give { lane, input, key, given } => self.give(lane, input, key, given),
                Op::FeedDone { lane, input, broken } => self.feed_done(lane, input, broken),
                Op::Try { lane, slot } => self.try_ready(lane, slot),
                Op::Check { lane } => self.check_done(lane),
            }
        }
    }

    fn check_done(&mut self, lane: usize) {
        let state = &mut self.states[lane];
        if state.done || !state.known || state.open > 0 {
            return;
        }
        state.done = true;
        let node = self.lanes[lane].node;
        self.stats[node].unknown |= state.unknown;
        let (name, ..) = self.names(lane);
        self.events.push(Event::Counted { node: name });
        let state = &self.states[lane];
        if !state.unknown && !state.failed && self.lanes[lane].only.is_none() {
            let results = self.collect(lane);
            self.states[lane].results = results;
            let slots = &self.states[lane].slots;
            self.complete.push(Complete {
                lane,
                actions: slots.len() as u64,
                wall_us: slots.iter().map(|s| s.made.wall_us).sum(),
                bytes: slots.iter().map(|s| s.made.bytes).sum(),
            });
        }
        self.hand_on_whole(lane);
    }

    /// The collections of a lane's ports.
    fn collect(&self, lane: usize) -> BTreeMap<usize, Arc<Whole>> {
        let outputs = &self.pipeline.nodes[self.lanes[lane].node].spec.outputs;
        let slots = &self.states[lane].slots;
        let of_port = |port: &usize| {
            let name = outputs[*port].name;
            if let [Slot { key: None, made, .. }] = &slots[..] {
                return made.collections.get(name).map(|whole| (*port, whole.clone()));
            }
            let items = slots.iter().filter_map(|s| Some((s.key.clone()?, s.made.items.get(name)?.as_ref().clone())));
            Some((*port, Arc::new(Whole::new(items.collect()))))
        };
        self.lanes[lane].ports.iter().filter_map(of_port).collect()
    }

    fn names(&self, lane: usize) -> (String, String, String) {
        let lane = &self.lanes[lane];
        (
            self.pipeline.nodes[lane.node].name.clone(),
            self.pipeline.cells[lane.cell].text.clone(),
            lane.group.to_owned(),
        )
    }

    fn fail(&mut self, lane: usize, item: Option<&ItemKey>, message: String) {
        let (node, cell, _) = self.names(lane);
        let item = item.map_or(String::new(), ToString::to_string);
        self.failures.push(Failure { node, cell, item, message });
    }

    /// A failure of the lane as a whole: its items are not known.
    fn fail_lane(&mut self, lane: usize, message: String) {
        self.fail(lane, None, message);
        self.stats[self.lanes[lane].node].failed += 1;
        self.states[lane].unknown = true;
        self.ops.push_back(Op::Check { lane });
    }

    /// Actions that are being done.
    pub fn running(&self) -> usize {
        self.running
    }

    /// Failures so far.
    pub fn failures(&self) -> &[Failure] {
        &self.failures
    }

    /// What happened since this was last asked.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// The lanes that ended with all their outputs since this was last asked.
    pub fn take_complete(&mut self) -> Vec<Complete> {
        std::mem::take(&mut self.complete)
    }

    /// The collection of a lane's port, once the lane is done.
    pub fn result(&self, lane: usize, port: usize) -> Option<&Arc<Whole>> {
        self.states[lane].results.get(&port)
    }

    /// The items of a source's lane, with the content digests of the files that they read.
    pub fn listing(&self, lane: usize) -> Vec<(ItemKey, Option<Digest>)> {
        self.states[lane].slots.iter().filter_map(|s| Some((s.key.clone()?, s.file))).collect()
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
        Finished { stats: self.stats, failures: self.failures, missing: self.missing, ran: self.ran, keys: self.keys }
    }
}
