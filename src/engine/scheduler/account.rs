//! The account of a pass: events, counts per node, failures, and the slowest actions. Decides nothing.

use crate::engine::{
    event::{Compared, Ended, Event, Failure, Name, NodeStat, Slow},
    ids::{LaneId, Row, SlotId},
    lanes::Lanes,
    records::Made,
};
use crate::pipeline::Pipeline;
use std::collections::{BTreeMap, HashMap, HashSet};
use tauflow_cache::Digest;
use tauflow_contract::{ActionKey, ItemKey};

/// Actions that are named as the slowest.
pub const SLOWEST: usize = 5;

/// Slots that ran: items of lanes, or the one slot of a gather.
pub type Ran = HashSet<(LaneId, Option<ItemKey>)>;
/// Keys of slots, and what became of these.
pub type Keys = Vec<(LaneId, Option<ItemKey>, Ended, Box<ActionKey>)>;

/// The result of a pass.
pub struct Finished {
    /// Numbers by node.
    pub stats: Vec<NodeStat>,
    /// Failures.
    pub failures: Vec<Failure>,
    /// Results that were compared.
    pub compared: Compared,
    /// Actions that other shards have not done, by shard.
    pub elsewhere: BTreeMap<u32, u64>,
    /// Blobs that readers missed.
    pub missing: HashSet<Digest>,
    /// Slots that ran.
    pub ran: Ran,
    /// Keys of slots, if they were asked for.
    pub keys: Keys,
    /// The actions that took longest.
    pub slowest: Vec<Slow>,
}

/// A lane as events name it.
struct Named {
    number: usize,
    node: Name,
    cell: Name,
    group: Name,
}

/// See the module.
pub(super) struct Account<'a> {
    lanes: Row<LaneId, Named>,
    none: Name,
    stats: Vec<NodeStat>,
    /// Actions that are new since [`Account::take_events`], by node.
    expected: Vec<u64>,
    events: Vec<Event>,
    failures: Vec<Failure>,
    elsewhere: BTreeMap<u32, u64>,
    /// Slots that run to be compared.
    comparing: HashSet<(LaneId, SlotId)>,
    compared: Compared,
    slowest: Vec<Slow>,
    /// Slots that ran in earlier passes: hits of this one.
    ran_before: &'a Ran,
    /// How many of them there are in each lane and shard.
    ran_counts: HashMap<(LaneId, Option<u8>), u64>,
    ran: Ran,
    /// Items of transient lanes that a dry run would make again.
    again: HashSet<(LaneId, ItemKey)>,
    keys: Keys,
}

impl<'a> Account<'a> {
    /// Counts of lanes without any event so far.
    pub fn new(pipeline: &Pipeline, lanes: &Lanes, ran_before: &'a Ran) -> Self {
        let mut stats: Vec<NodeStat> = Vec::with_capacity(pipeline.nodes.len());
        for node in &pipeline.nodes {
            stats.push(NodeStat { node: node.name.clone(), kind: node.spec.name.into(), ..NodeStat::default() });
        }
        let mut named = Row::new();
        for lane in lanes {
            stats[lane.node].lanes += 1;
            named.push(Named {
                number: lane.node,
                node: pipeline.nodes[lane.node].name.as_str().into(),
                cell: pipeline.cells[lane.cell].text.as_str().into(),
                group: lane.group.name.into(),
            });
        }
        let mut ran_counts = HashMap::new();
        #[expect(clippy::iter_over_hash_type, reason = "these are counts, whose order does not matter")]
        for (lane, item) in ran_before {
            *ran_counts.entry((*lane, None)).or_insert(0) += 1;
            if let Some(item) = item {
                *ran_counts.entry((*lane, Some(item.shard()))).or_insert(0) += 1;
            }
        }
        Self {
            lanes: named,
            none: Name::default(),
            expected: vec![0; stats.len()],
            stats,
            events: Vec::new(),
            failures: Vec::new(),
            elsewhere: BTreeMap::new(),
            comparing: HashSet::new(),
            compared: Compared::default(),
            slowest: Vec::new(),
            ran_before,
            ran_counts,
            ran: Ran::new(),
            again: HashSet::new(),
            keys: Keys::new(),
        }
    }

    fn stat(&mut self, lane: LaneId) -> &mut NodeStat {
        &mut self.stats[self.lanes[lane].number]
    }

    fn item(&self, item: Option<&ItemKey>) -> Name {
        item.map_or_else(|| self.none.clone(), Name::from)
    }

    /// One more action of a lane is known.
    pub fn expect(&mut self, lane: LaneId) {
        self.expected[self.lanes[lane].number] += 1;
    }

    /// A lane is as an earlier run left it.
    pub fn unchanged(&mut self, lane: LaneId, totals: (u64, u64, u64)) {
        self.stat(lane).unchanged += 1;
        self.rolled(lane, None, totals);
    }

    /// Number, wall time and bytes of actions that were looked up as one: those of a lane, or of a shard.
    pub fn rolled(&mut self, lane: LaneId, shard: Option<u8>, (actions, wall_us, bytes): (u64, u64, u64)) {
        let ran = self.ran_counts.get(&(lane, shard)).copied().unwrap_or(0).min(actions);
        let stat = self.stat(lane);
        stat.hit = stat.hit.saturating_add(actions - ran);
        stat.ran += ran;
        stat.wall_s += wall_us as f64 / 1e6;
        stat.bytes = stat.bytes.saturating_add(bytes);
        let Named { node, cell, group, .. } = &self.lanes[lane];
        let (node, cell, group) = (node.clone(), cell.clone(), group.clone());
        self.events.push(Event::Unchanged { node, cell, group, actions });
    }

    /// All slots of a lane have ended, and whether its items are not all known.
    pub fn counted(&mut self, lane: LaneId, unknown: bool) {
        self.stat(lane).unknown |= unknown;
        self.events.push(Event::Counted { node: self.lanes[lane].node.clone() });
    }

    /// A slot has ended.
    pub fn ended(&mut self, lane: LaneId, item: Option<&ItemKey>, outcome: Ended, made: &Made) {
        let item = self.item(item);
        let Named { node, cell, group, .. } = &self.lanes[lane];
        let (node, cell, group) = (node.clone(), cell.clone(), group.clone());
        let (wall_us, bytes) = (made.wall_us, made.bytes);
        self.events.push(Event::End { node, cell, item, group, outcome, wall_us, bytes });
        let stat = self.stat(lane);
        match outcome {
            Ended::Hit => stat.hit += 1,
            Ended::Ran | Ended::WouldRun => stat.ran += 1,
            Ended::Failed => stat.failed += 1,
            Ended::Blocked => stat.blocked += 1,
        }
        stat.wall_s += wall_us as f64 / 1e6;
        stat.bytes = stat.bytes.saturating_add(bytes);
    }

    /// The result of a look-up: hits on actions of an earlier pass count as run.
    pub fn hit(&self, lane: LaneId, item: Option<&ItemKey>) -> Ended {
        let before = !self.ran_before.is_empty() && self.ran_before.contains(&(lane, item.cloned()));
        if before { Ended::Ran } else { Ended::Hit }
    }

    /// An action ran, and took so long.
    pub fn ran(&mut self, lane: LaneId, item: Option<&ItemKey>, spent_us: u64, made: &Made) {
        let spent_s = spent_us as f64 / 1e6;
        let stat = self.stat(lane);
        stat.spent_s += spent_s;
        stat.written += made.put;
        self.ran.insert((lane, item.cloned()));
        if self.slowest.len() < SLOWEST || self.slowest.last().is_some_and(|last| last.spent_s < spent_s) {
            let item = self.item(item);
            let Named { node, cell, .. } = &self.lanes[lane];
            let at = self.slowest.partition_point(|other| other.spent_s >= spent_s);
            self.slowest.insert(at, Slow { node: node.clone(), cell: cell.clone(), item, spent_s });
            self.slowest.truncate(SLOWEST);
        }
    }

    /// In a dry run: an item that was a hit would be made again.
    pub fn would_run_again(&mut self, lane: LaneId, item: &ItemKey) {
        if self.again.insert((lane, item.clone())) {
            let stat = self.stat(lane);
            stat.hit -= 1;
            stat.ran += 1;
        }
    }

    /// The key of a slot that ended.
    pub fn key(&mut self, lane: LaneId, item: Option<ItemKey>, ended: Ended, key: Box<ActionKey>) {
        self.keys.push((lane, item, ended, key));
    }

    /// A remark.
    pub fn warn(&mut self, message: String) {
        self.events.push(Event::Warning { message });
    }

    /// A failure of an item.
    pub fn fail(&mut self, lane: LaneId, item: Option<&ItemKey>, message: String) {
        let failure = self.failure(lane, item, message);
        self.events.push(Event::Failed { of: failure.clone() });
        self.failures.push(failure);
    }

    /// A slot that ended before runs again, to be compared.
    pub fn compare(&mut self, slot: (LaneId, SlotId)) {
        self.comparing.insert(slot);
    }

    /// A slot has run; whether it came out as recorded matters if it was compared.
    pub fn compared(&mut self, slot: (LaneId, SlotId), equal: bool) {
        if self.comparing.remove(&slot) {
            let of = if equal { &mut self.compared.equal } else { &mut self.compared.differing };
            *of += 1;
        }
    }

    /// An action that another shard has not done.
    pub fn elsewhere(&mut self, shard: u32) {
        *self.elsewhere.entry(shard).or_insert(0) += 1;
    }

    /// A failure of a lane as a whole.
    pub fn fail_lane(&mut self, lane: LaneId, message: String) {
        self.fail(lane, None, message);
        self.stat(lane).failed += 1;
    }

    /// A failure, by the names of its lane.
    pub fn failure(&self, lane: LaneId, item: Option<&ItemKey>, message: String) -> Failure {
        let Named { node, cell, .. } = &self.lanes[lane];
        let item = item.map_or(String::new(), ToString::to_string);
        Failure { node: node.to_string(), cell: cell.to_string(), item, message }
    }

    /// Failures so far.
    pub fn failures(&self) -> &[Failure] {
        &self.failures
    }

    /// Events since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        let mut events = Vec::new();
        for (stat, actions) in self.stats.iter().zip(&mut self.expected).filter(|(_, actions)| **actions > 0) {
            events.push(Event::Expect { node: stat.node.as_str().into(), actions: std::mem::take(actions) });
        }
        events.append(&mut self.events);
        events
    }

    /// Ends the pass, in which these blobs were missed.
    pub fn finish(self, missing: HashSet<Digest>) -> Finished {
        Finished {
            stats: self.stats,
            failures: self.failures,
            elsewhere: self.elsewhere,
            compared: self.compared,
            missing,
            ran: self.ran,
            keys: self.keys,
            slowest: self.slowest,
        }
    }
}
