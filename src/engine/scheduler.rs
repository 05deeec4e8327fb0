//! The scheduler: the one owner of every action's state. It decides what is looked up and run next; it does neither.
//! It reads and writes nothing: what it needs of the store, of files and of kinds it asks of the look-up threads.
//!
//! Each lane is a row of slots, one for each item (one in all for a gather). A slot goes from waiting to ready, is
//! looked up, perhaps runs, and ends. Finished items are passed to readers at once, while their siblings are still
//! running; whole collections are passed on when their lane is done. Stages are written in `moves.rs` alone.
//!
//! The slots of a lane are dealt to shards by their items' keys. Where items are many, a shard as a whole is looked up
//! before its items are: when all that it reads is known and none of it was made now, one look-up stands for all its
//! items. The first item of a shard that must run opens the same shard of all readers, so that nothing waits for a
//! shard to be complete.
//!
//! In a dry run a slot that would run ends as such, and what reads it is blocked: its inputs are not known.

mod account;
mod answers;
mod dispatch;
mod flow;
mod moves;
mod replies;
mod seeking;
mod shards;
mod state;

use super::{
    RunOptions,
    event::{Event, Failure},
    ids::{LaneId, PortId, Row, SlotId},
    keys,
    lanes::{LaneFeed, Lanes, ReadingPort},
    records::Payload,
    request::Task,
    rolled::RolledLanes,
    sharded::Sharded,
};
use crate::pipeline::Pipeline;
use account::Account;
pub use account::{Finished, Ran, SLOWEST};
use seeking::Seeking;
use state::{Asked, Health, LaneStage, LaneState, Op, Ops, Slot, SlotStage, Starting};
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap, HashSet},
    sync::Arc,
};
use tauflow_cache::Digest;
use tauflow_contract::{KindSpec, Mode};

/// A place in the order of work: latest node first.
type Turn = (usize, Reverse<LaneId>, Reverse<SlotId>);

/// See the module.
pub struct Scheduler<'a> {
    pipeline: &'a Pipeline,
    lanes: &'a Lanes,
    /// Looks up only, and runs nothing.
    dry: bool,
    /// Blobs that passes before this one missed.
    wanted: Arc<HashSet<Digest>>,
    /// Items from which a lane goes by shards; none if shards are not looked up as wholes.
    many: Option<u64>,
    tasks: Row<LaneId, Arc<Task>>,
    states: Row<LaneId, LaneState>,
    /// Slots to be looked up, and to be run.
    ready: BinaryHeap<Turn>,
    todo: BinaryHeap<Turn>,
    ops: Ops,
    seeking: Seeking,
    /// Actions that were handed out to run.
    in_flight: usize,
    account: Account<'a>,
    rolled: RolledLanes,
    asked: Asked,
    starting: Starting,
    /// Blobs that readers missed in this pass.
    missing: HashSet<Digest>,
    /// In a dry run: an action that never was done would run.
    never_run: bool,
}

impl<'a> Scheduler<'a> {
    /// Lays out the lanes, with what the actions of each share. `roll` says whether lanes and shards may be looked up
    /// as wholes. Blobs that are `wanted` were missing in passes before.
    pub fn new(
        pipeline: &'a Pipeline,
        lanes: &'a Lanes,
        tasks: Row<LaneId, Arc<Task>>,
        wanted: Arc<HashSet<Digest>>,
        ran_before: &'a Ran,
        roll: bool,
        options: &RunOptions,
    ) -> Self {
        Self {
            pipeline,
            lanes,
            dry: options.dry,
            wanted,
            many: roll.then_some(options.many),
            tasks,
            states: lanes.iter().map(|lane| LaneState::new(lane.inputs.iter().map(Vec::len))).collect(),
            ready: BinaryHeap::new(),
            todo: BinaryHeap::new(),
            ops: Ops::new(),
            seeking: Seeking::new(pipeline.nodes.len()),
            in_flight: 0,
            account: Account::new(pipeline, lanes, ran_before),
            rolled: if roll { RolledLanes::unknown(lanes) } else { RolledLanes::none(lanes) },
            asked: Asked::default(),
            starting: Starting::default(),
            missing: HashSet::new(),
            never_run: false,
        }
    }

    /// Asks what earlier runs left of the lanes; once that is known, for the items of sources.
    pub fn start(&mut self) {
        self.asked.rolled = self.rolled.next(self.pipeline, self.lanes, &self.tasks);
        if self.asked.rolled.is_none() {
            self.place();
        }
    }

    /// Takes note of the lanes that are known, and asks for the items of sources.
    fn place(&mut self) {
        let known = std::mem::replace(&mut self.rolled, RolledLanes::none(self.lanes));
        for (lane, payload) in self.lanes.ids().zip(known.payloads) {
            match payload {
                Some(payload) => self.set_lane(lane, LaneStage::Rolled(payload)),
                None if self.mode(lane) == Mode::Source => self.asked.lists.push_back(lane),
                None => {}
            }
        }
        for ((lane, port), collection) in known.loaded {
            self.states[lane].results.insert(port, collection);
        }
        self.starting.totals = known.totals;
        self.starting.open = self.asked.lists.len();
        if self.starting.open == 0 {
            self.begin();
        }
    }

    /// Fills sources and gathers with their slots, and hands the outputs of rolled lanes on.
    fn begin(&mut self) {
        let Starting { mut listed, totals, .. } = std::mem::take(&mut self.starting);
        // Who goes by shards is settled before anything is handed on.
        for lane in self.lanes.ids() {
            match listed.get(&lane) {
                Some(Ok(items)) => self.choose_source_by_shard(lane, items),
                Some(Err(message)) => {
                    self.set_lane(lane, LaneStage::Full);
                    self.fail_lane(lane, message.clone());
                }
                None if self.states[lane].rolled().is_none() => self.choose_by_shard(lane),
                None => {}
            }
        }
        for (lane, (wall_us, bytes)) in self.lanes.ids().zip(totals) {
            if let Some(payload) = self.states[lane].rolled() {
                let actions = payload.actions;
                self.account.unchanged(lane, (actions, wall_us, bytes));
                self.hand_on_whole(lane);
            } else if let Some(Ok(items)) = listed.remove(&lane) {
                self.fill_source(lane, items);
            } else if self.is_gather(lane) {
                self.add_slot(lane, None, Vec::new());
                self.set_lane(lane, LaneStage::Full);
            }
        }
        self.settle();
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

    /// A failure of the lane as a whole: its items are not known.
    fn fail_lane(&mut self, lane: LaneId, message: String) {
        self.account.fail_lane(lane, message);
        self.worsen(lane, Health::Unknown);
        self.ops.push_back(Op::Check { lane });
    }

    /// The spec of a lane's kind.
    fn spec(&self, lane: LaneId) -> &'a KindSpec {
        &self.pipeline.nodes[self.lanes[lane].node].spec
    }

    fn mode(&self, lane: LaneId) -> Mode {
        self.spec(lane).mode
    }

    fn is_gather(&self, lane: LaneId) -> bool {
        self.mode(lane) == Mode::Gather
    }

    /// The feed by which a reader reads.
    fn feed(&self, reader: ReadingPort) -> &'a LaneFeed {
        reader.feed(self.lanes)
    }

    /// Whether a reader takes the whole collection.
    fn takes_whole(&self, reader: ReadingPort) -> bool {
        self.lanes[reader.lane].is_whole(self.pipeline, reader.input)
    }

    /// Requests that have no answer yet.
    pub fn seeking(&self) -> usize {
        self.seeking.requests()
    }

    /// Actions that are being run.
    pub fn running(&self) -> usize {
        self.in_flight
    }

    /// Failures so far.
    pub fn failures(&self) -> &[Failure] {
        self.account.failures()
    }

    /// Events since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        self.account.take_events()
    }

    /// The collection of a lane's port, once the lane is done.
    pub fn result(&self, lane: LaneId, port: PortId) -> Option<&Arc<Sharded>> {
        self.states[lane].results.get(&port)
    }

    /// Digest of the items of a source's lane, with those of the files that they read.
    pub fn listing(&self, lane: LaneId) -> Digest {
        let state = &self.states[lane];
        state.by_shard.as_ref().and_then(|by_shard| by_shard.listing).unwrap_or_else(|| {
            let file = |slot: &Slot| slot.extra.as_ref().and_then(|extra| extra.file);
            keys::listing(state.slots.iter().filter_map(|slot| Some((slot.key.as_ref()?, file(slot)))))
        })
    }

    /// The roll-up of a rolled lane.
    pub fn rolled(&self, lane: LaneId) -> Option<&Payload> {
        self.states[lane].rolled()
    }

    /// Lanes that came to no end though nothing is left to do: a mistake of this scheduler, which must not pass for
    /// success.
    pub fn stuck(&self) -> Vec<Failure> {
        let open = self.states.pairs().filter(|(_, state)| !state.is_done());
        open.map(|(lane, state)| {
            let waiting = state.slots.iter().filter(|slot| !matches!(slot.stage, SlotStage::Ended(_))).count();
            let message = format!(
                "internal error: group `{}` came to no end ({waiting} of {} actions and {} shards are open); please \
                 report it, and run with `--no-rollup`",
                self.lanes[lane].group.name,
                state.slots.len(),
                state.open_shards
            );
            self.account.failure(lane, None, message)
        })
        .collect()
    }

    /// In a dry run: whether an action that never was done would run.
    pub fn never_run(&self) -> bool {
        self.never_run
    }

    /// Failures of lanes that are asked for, of blobs that did not come back.
    pub fn lost(&self, blobs: &[(LaneId, Digest)]) -> Vec<Failure> {
        let gone = blobs.iter().rev().filter(|(_, digest)| self.wanted.contains(digest));
        // One for each lane: of several blobs the first.
        let first: BTreeMap<LaneId, &Digest> = gone.map(|(lane, digest)| (*lane, digest)).collect();
        first.into_iter().map(|(lane, digest)| self.account.failure(lane, None, lost(digest))).collect()
    }

    /// Ends the pass.
    pub fn finish(self) -> Finished {
        self.account.finish(self.missing)
    }
}

/// A blob that does not come back.
fn lost(digest: &Digest) -> String {
    format!(
        "blob {} is missing, and rebuilding did not restore it; run `tauflow cache verify`, and report it if that \
        finds no damage",
        digest.short()
    )
}
