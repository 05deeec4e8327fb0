//! State transitions: the only place where stages of slots, shards and lanes are written, with all consequences.
//!
//! Each level has one setter. It keeps the counters of what is still open, tells the account, and hands on what is
//! done; what may be done next is put on the list of [`Op`]s. All other code requests a move and writes no stage.

use super::{
    Scheduler,
    state::{Health, LaneStage, Op, ShardStage, SlotStage},
};
use crate::engine::{
    event::Ended,
    ids::{Id, LaneId, PortId, SlotId},
    keys,
    records::ROLLUP,
    request::{Keep, Rolling},
    sharded::Sharded,
};
use std::{cmp::Reverse, collections::BTreeMap, sync::Arc};

impl Scheduler<'_> {
    /// Moves a slot.
    pub(super) fn set_slot(&mut self, lane: LaneId, slot: SlotId, stage: SlotStage) {
        let at = &mut self.states[lane].slots[slot];
        at.stage = stage;
        let shard = at.shard;
        let turn = (self.lanes[lane].node, Reverse(lane), Reverse(slot));
        match stage {
            SlotStage::Waiting | SlotStage::Sought | SlotStage::Running | SlotStage::Stalled => {}
            SlotStage::Ready => self.ready.push(turn),
            SlotStage::Todo => {
                let gather = at.key.is_none();
                self.todo.push(turn);
                // The outputs of a gather belong to no known shard.
                if !gather {
                    self.open_readers(lane, shard);
                }
            }
            SlotStage::Ended(outcome) => {
                self.account.ended(lane, at.key.as_ref(), outcome, &at.made);
                let failed = !matches!(outcome, Ended::Hit | Ended::Ran);
                let state = &mut self.states[lane];
                state.open -= 1;
                let of = &mut state.shards[shard];
                of.open -= 1;
                of.failed |= failed;
                let last = of.open == 0;
                if failed {
                    self.worsen(lane, Health::Failed);
                }
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

    /// Moves a shard.
    pub(super) fn set_shard(&mut self, lane: LaneId, shard: u8, stage: ShardStage) {
        let state = &mut self.states[lane];
        state.shards[shard].stage = stage;
        state.open_shards -= usize::from(stage.is_closed());
        match stage {
            ShardStage::Pending | ShardStage::Sought => {}
            ShardStage::Open => {
                self.take_what_came(lane, shard);
                self.ops.push_back(Op::CheckShard { lane, shard });
            }
            ShardStage::Closed => self.tell_fed(lane, shard),
            ShardStage::Rolled => {
                self.hand_on_shard(lane, shard);
                self.tell_fed(lane, shard);
            }
        }
    }

    /// Moves a lane. One that is rolled is handed on by `Scheduler::begin`, when all of them are known.
    pub(super) fn set_lane(&mut self, lane: LaneId, stage: LaneStage) {
        let done = matches!(stage, LaneStage::Done);
        self.states[lane].stage = stage;
        if !done {
            return;
        }
        let health = self.states[lane].health;
        self.account.counted(lane, health == Health::Unknown);
        if health == Health::Sound && self.lanes[lane].only.is_none() {
            self.states[lane].results = self.collect(lane);
            if !self.dry {
                self.asked.ended.push(lane);
            }
        }
        self.hand_on_whole(lane);
    }

    /// Takes note that a lane's outputs are no better than this.
    pub(super) fn worsen(&mut self, lane: LaneId, health: Health) {
        let of = &mut self.states[lane].health;
        *of = health.max(*of);
    }

    /// A lane is done when all its slots have ended, and all its shards, unless nobody knows what would be in them.
    pub(super) fn check_done(&mut self, lane: LaneId) {
        let state = &self.states[lane];
        let shards = state.open_shards == 0 || self.is_gather(lane) || state.health == Health::Unknown;
        if matches!(state.stage, LaneStage::Full) && state.open == 0 && shards {
            self.set_lane(lane, LaneStage::Done);
        }
    }

    /// The roll-up of a lane that ended with all its outputs; none as long as what it reads has no digest.
    pub(super) fn lane_to_keep(&self, lane: LaneId) -> Option<Keep> {
        let of = &self.lanes[lane];
        let outputs = |lane: LaneId| &self.pipeline.nodes[self.lanes[lane].node].spec.outputs;
        let content = |from: LaneId, port: PortId| {
            let name = outputs(from)[port.place()].name;
            let rolled = || Some(self.rolled(from)?.collections.get(name)?.digest);
            self.result(from, port).map(|result| result.digest).or_else(rolled)
        };
        let (key, preimage) = keys::lane(self.pipeline, of, content, || Some(self.listing(lane)))?;
        let output = |port: &PortId| {
            let result = self.result(lane, *port)?.clone();
            Some((outputs(lane)[port.place()].name.to_owned(), Rolling::Lane(result)))
        };
        Some(Keep {
            namespace: ROLLUP,
            key,
            preimage,
            kind: self.spec(lane).name.to_owned(),
            outputs: of.ports.iter().map(output).collect::<Option<_>>()?,
            totals: self.totals(lane),
            transient: of.is_transient(self.pipeline),
            fetched: self.fetched(lane),
        })
    }

    /// Who made what a lane holds, if measurements of another machine are among it.
    fn fetched(&self, lane: LaneId) -> Option<String> {
        let state = &self.states[lane];
        let slots = state.slots.iter().filter_map(|slot| slot.made.fetched.as_deref().map(str::to_owned));
        slots.chain(state.shards.iter().filter_map(|shard| shard.fetched.clone())).next()
    }

    /// Number, wall time and bytes of a lane's actions, those of earlier runs included.
    fn totals(&self, lane: LaneId) -> (u64, u64, u64) {
        let state = &self.states[lane];
        let slots = state.slots.iter().map(|slot| (1, slot.made.wall_us, slot.made.bytes));
        // Records may say any numbers.
        let add = |sum: (u64, u64, u64), of: (u64, u64, u64)| {
            (sum.0.saturating_add(of.0), sum.1.saturating_add(of.1), sum.2.saturating_add(of.2))
        };
        slots.chain(state.shards.iter().map(|shard| shard.totals)).fold((0, 0, 0), add)
    }

    /// The collections of a lane's ports.
    fn collect(&self, lane: LaneId) -> BTreeMap<PortId, Arc<Sharded>> {
        let state = &self.states[lane];
        let of_port = |port: &PortId| {
            if let [slot] = state.slots.as_slice()
                && slot.key.is_none()
            {
                return slot.made.collection(*port).map(|made| (*port, made.clone()));
            }
            let mut shards = BTreeMap::new();
            for (number, of) in state.shards.pairs() {
                if let Some((_, shard)) = of.outputs.iter().find(|(at, shard)| at == port && shard.len > 0) {
                    shards.insert(number, shard.clone());
                }
            }
            Some((*port, Arc::new(Sharded::new(shards))))
        };
        self.lanes[lane].ports.iter().filter_map(of_port).collect()
    }
}
