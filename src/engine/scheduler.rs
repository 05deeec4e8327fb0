//! The scheduler: the one owner of every action's state. It decides what runs next; it does not run it.
//!
//! Each lane is a row of slots, one for each item (one in all for a gather). A slot goes from waiting to ready to
//! running to an end, and only [`Scheduler::set`] moves it. What ends is handed to the readers at once, so that an item
//! goes on while its siblings are still worked on; whole collections are handed on when their lane is done.
//!
//! In a dry run a slot that would run ends as such, and what reads it is blocked: its inputs are not known.

use super::{
    event::{Ended, Event, Failure, NodeStat},
    lanes::Lane,
    records::{Made, Payload, Whole},
    work::{Job, Outcome, Reply},
};
use crate::pipeline::Pipeline;
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap, HashMap, HashSet, VecDeque},
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    sync::Arc,
};
use tauflow_cache::Digest;
use tauflow_contract::{ActionKey, Artifact, Collection, ItemKey, Mode};

/// What a slot is doing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Status {
    Waiting,
    Ready,
    Running,
    /// Blobs of its inputs are missing; the next pass makes them.
    Stalled,
    Ended(Ended),
}

struct Slot {
    key: Option<ItemKey>,
    files: Vec<(String, PathBuf)>,
    status: Status,
    made: Made,
}

/// An item on its way into an input.
#[derive(Clone)]
enum Given {
    Item(Arc<Artifact>),
    /// It failed, or is not known.
    Broken,
}

#[derive(Default)]
struct Input {
    open: usize,
    broken: bool,
    given: HashMap<ItemKey, Given>,
    whole: Option<Arc<Whole>>,
    error: Option<String>,
}

struct LaneState {
    slots: Vec<Slot>,
    index: HashMap<ItemKey, usize>,
    inputs: Vec<Input>,
    /// No more slots will come.
    known: bool,
    open: usize,
    done: bool,
    /// The items are not all known, because what names them failed.
    unknown: bool,
    /// Some slot did not come to outputs.
    failed: bool,
    results: BTreeMap<usize, Arc<Whole>>,
    rolled: Option<Payload>,
}

enum Op {
    Give { lane: usize, input: usize, key: ItemKey, given: Given },
    FeedDone { lane: usize, input: usize, broken: bool },
    Try { lane: usize, slot: usize },
    Check { lane: usize },
}

/// A lane that ended with all its outputs.
pub struct Complete {
    /// The lane.
    pub lane: usize,
    /// Its number of actions.
    pub actions: u64,
    /// Wall time of its actions.
    pub wall_us: u64,
    /// Bytes of its outputs.
    pub bytes: u64,
}

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
        for lane in 0..self.lanes.len() {
            let node = self.lanes[lane].node;
            self.stats[node].lanes += 1;
            if let Some(payload) = self.states[lane].rolled.clone() {
                let (wall_us, bytes) = totals[lane];
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
    pub fn next_job(&mut self, files_of: impl Fn(&[(String, PathBuf)]) -> Vec<(String, PathBuf)>) -> Option<Job> {
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
            files: files_of(&state.slots[slot].files),
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

    fn fill_source(&mut self, lane: usize) {
        let of = &self.lanes[lane];
        let node = &self.pipeline.nodes[of.node];
        let params = &self.pipeline.cells[of.cell].params;
        let listed = catch_unwind(AssertUnwindSafe(|| node.kind.items(params)));
        self.states[lane].known = true;
        let items = match listed {
            Ok(Ok(mut items)) => {
                items.sort_by(|a, b| a.key.cmp(&b.key));
                items
            }
            Ok(Err(error)) => return self.fail_lane(lane, error.to_string()),
            Err(_) => return self.fail_lane(lane, "internal error: listing the items panicked; please report it".into()),
        };
        if let Some(pair) = items.windows(2).find(|w| w[0].key == w[1].key) {
            return self.fail_lane(lane, format!("two items have the key `{}`; please report it", pair[0].key));
        }
        for item in items {
            if let Some(slot) = self.add_slot(lane, Some(item.key), item.files) {
                self.ops.push_back(Op::Try { lane, slot });
            }
        }
        self.ops.push_back(Op::Check { lane });
    }

    fn add_slot(&mut self, lane: usize, key: Option<ItemKey>, files: Vec<(String, PathBuf)>) -> Option<usize> {
        if let (Some(only), Some(key)) = (&self.lanes[lane].only, &key)
            && !only.contains(key)
        {
            return None;
        }
        let state = &mut self.states[lane];
        let slot = state.slots.len();
        if let Some(key) = &key {
            state.index.insert(key.clone(), slot);
        }
        let gather = key.is_none();
        state.slots.push(Slot { key, files, status: Status::Waiting, made: Made::default() });
        state.open += 1;
        let (node, ..) = self.names(lane);
        self.events.push(Event::Expect { node, actions: 1 });
        if gather {
            self.ops.push_back(Op::Try { lane, slot });
        }
        Some(slot)
    }

    fn give(&mut self, lane: usize, input: usize, key: ItemKey, given: Given) {
        if self.states[lane].inputs[input].given.insert(key.clone(), given).is_some() {
            let port = self.pipeline.nodes[self.lanes[lane].node].spec.inputs[input].name;
            return self.fail_lane(lane, format!("two of the nodes on input `{port}` give an item `{key}`"));
        }
        let slot = if self.lanes[lane].driving == Some(input) {
            self.add_slot(lane, Some(key), Vec::new())
        } else {
            self.states[lane].index.get(key.as_str()).copied()
        };
        if let Some(slot) = slot {
            self.ops.push_back(Op::Try { lane, slot });
        }
    }

    fn feed_done(&mut self, lane: usize, input: usize, broken: bool) {
        let pipeline = self.pipeline;
        let state = &mut self.states[lane];
        if state.done {
            return; // rolled lanes read nothing
        }
        state.inputs[input].open -= 1;
        state.inputs[input].broken |= broken;
        if state.inputs[input].open > 0 {
            return;
        }
        if self.lanes[lane].is_whole(pipeline, input) && !state.inputs[input].broken {
            match self.gathered(lane, input) {
                Ok(whole) => self.states[lane].inputs[input].whole = Some(whole),
                Err(message) => self.states[lane].inputs[input].error = Some(message),
            }
        }
        let state = &mut self.states[lane];
        if self.lanes[lane].driving == Some(input) {
            state.known = true;
            state.unknown |= state.inputs[input].broken;
        }
        let waiting = state.slots.iter().enumerate().filter(|(_, s)| s.status == Status::Waiting);
        self.ops.extend(waiting.map(|(slot, _)| Op::Try { lane, slot }));
        self.ops.push_back(Op::Check { lane });
    }

    /// The collection on a closed input: its feeds' collections, merged.
    fn gathered(&self, lane: usize, input: usize) -> Result<Arc<Whole>, String> {
        let feeds = &self.lanes[lane].inputs[input];
        let result = |feed: &super::lanes::LaneFeed| self.states[feed.lane].results.get(&feed.port).cloned();
        if let [feed] = &feeds[..]
            && feed.prefix.is_none()
            && let Some(whole) = result(feed)
        {
            return Ok(whole);
        }
        let mut merged = Collection::default();
        for feed in feeds {
            let Some(whole) = result(feed) else { return Err("internal error: a collection is missing".into()) };
            for (key, artifact) in whole.collection.iter() {
                let key = match &feed.prefix {
                    Some(prefix) => key.in_cell(prefix).map_err(|e| e.to_string())?,
                    None => key.clone(),
                };
                if merged.items.insert(key.clone(), artifact.clone()).is_some() {
                    let port = self.pipeline.nodes[self.lanes[lane].node].spec.inputs[input].name;
                    return Err(format!("two of the nodes on input `{port}` give an item `{key}`"));
                }
            }
        }
        Ok(Arc::new(Whole::new(merged)))
    }

    fn try_ready(&mut self, lane: usize, slot: usize) {
        let state = &self.states[lane];
        if state.slots[slot].status != Status::Waiting {
            return;
        }
        let spec = &self.pipeline.nodes[self.lanes[lane].node].spec;
        let (mut wait, mut blocked, mut error) = (false, false, None);
        for (number, input) in state.inputs.iter().enumerate() {
            if self.lanes[lane].inputs[number].is_empty() {
                continue;
            }
            error = error.or_else(|| input.error.clone());
            if self.lanes[lane].is_whole(self.pipeline, number) {
                wait |= input.open > 0;
                blocked |= input.broken;
                continue;
            }
            let Some(key) = &state.slots[slot].key else { continue }; // gathers have whole inputs only
            match input.given.get(key) {
                Some(Given::Item(_)) => {}
                Some(Given::Broken) => blocked = true,
                None if input.open > 0 => wait = true,
                None if input.broken => blocked = true,
                None if spec.inputs[number].optional => {}
                None => {
                    let message = format!(
                        "the input `{}` has no item `{key}`; connect a node that has every item of input `{}`",
                        spec.inputs[number].name,
                        self.lanes[lane].driving.map_or("", |d| spec.inputs[d].name)
                    );
                    error = error.or(Some(message));
                }
            }
        }
        if blocked {
            self.set(lane, slot, Status::Ended(Ended::Blocked));
        } else if let Some(message) = error {
            let key = state.slots[slot].key.clone();
            self.fail(lane, key.as_ref(), message);
            self.set(lane, slot, Status::Ended(Ended::Failed));
        } else if !wait {
            self.set(lane, slot, Status::Ready);
        }
    }

    /// Gives an ended slot's outputs to those who read item by item.
    fn hand_on(&mut self, lane: usize, slot: usize) {
        let lanes = self.lanes;
        let state = &self.states[lane];
        let slot = &state.slots[slot];
        let good = matches!(slot.status, Status::Ended(Ended::Hit | Ended::Ran));
        let outputs = &self.pipeline.nodes[lanes[lane].node].spec.outputs;
        for reader in &lanes[lane].readers {
            if self.states[reader.lane].done || lanes[reader.lane].is_whole(self.pipeline, reader.input) {
                continue;
            }
            let feed = &lanes[reader.lane].inputs[reader.input][reader.feed];
            let port = outputs[feed.port].name;
            let mut items: Vec<(ItemKey, Given)> = Vec::new();
            match &slot.key {
                Some(key) if !good => items.push((key.clone(), Given::Broken)),
                Some(key) => items.extend(slot.made.items.get(port).map(|a| (key.clone(), Given::Item(a.clone())))),
                None => {
                    if let Some(whole) = slot.made.collections.get(port) {
                        items = given(&whole.collection);
                    }
                }
            }
            give_all(&mut self.ops, reader.lane, reader.input, feed.prefix.as_deref(), items);
        }
    }

    /// Tells the readers that a lane is done; those of a rolled lane get its items now.
    fn hand_on_whole(&mut self, lane: usize) {
        let lanes = self.lanes;
        let (rolled, unknown, failed) = {
            let state = &self.states[lane];
            (state.rolled.is_some(), state.unknown, state.failed)
        };
        let gather = self.pipeline.nodes[lanes[lane].node].mode() == Mode::Gather;
        for reader in &lanes[lane].readers {
            if self.states[reader.lane].rolled.is_some() {
                continue;
            }
            let feed = &lanes[reader.lane].inputs[reader.input][reader.feed];
            let whole = lanes[reader.lane].is_whole(self.pipeline, reader.input);
            if rolled
                && !whole
                && let Some(result) = self.states[lane].results.get(&feed.port)
            {
                let items = given(&result.collection);
                give_all(&mut self.ops, reader.lane, reader.input, feed.prefix.as_deref(), items);
            }
            // Items that failed were told one by one to those who read item by item.
            let broken = unknown || (failed && (whole || gather));
            self.ops.push_back(Op::FeedDone { lane: reader.lane, input: reader.input, broken });
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
        (self.pipeline.nodes[lane.node].name.clone(), self.pipeline.cells[lane.cell].text.clone(), lane.group.to_owned())
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
        }
    }
}

/// What a pass leaves.
pub struct Finished {
    /// Numbers by node.
    pub stats: Vec<NodeStat>,
    /// Failures.
    pub failures: Vec<Failure>,
    /// Blobs that readers missed.
    pub missing: HashSet<Digest>,
    /// Slots that ran.
    pub ran: HashSet<(usize, Option<ItemKey>)>,
    /// Keys of slots, if they were asked for.
    pub keys: Vec<(usize, Option<ItemKey>, Ended, Box<ActionKey>)>,
}

fn given(collection: &Collection) -> Vec<(ItemKey, Given)> {
    collection.iter().map(|(k, a)| (k.clone(), Given::Item(Arc::new(a.clone())))).collect()
}

fn give_all(ops: &mut VecDeque<Op>, lane: usize, input: usize, prefix: Option<&str>, items: Vec<(ItemKey, Given)>) {
    for (key, given) in items {
        // A key that is too long with its prefix stays as it is; it then stands out as not found.
        let key = prefix.and_then(|p| key.in_cell(p).ok()).unwrap_or(key);
        ops.push_back(Op::Give { lane, input, key, given });
    }
}
