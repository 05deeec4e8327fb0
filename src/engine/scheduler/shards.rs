//! Shards of lanes: when one is looked up as a whole, when it is opened to go item by item, and when it is done.

use super::{
    Scheduler,
    flow::prefixed,
    state::{Arrival, ByShard, CompleteShard, LaneStage, Op, ShardStage, ShardState},
};
use crate::engine::{
    ids::{Id, InputId, LaneId, PortId, Row, SlotId},
    lanes::{LaneFeed, Reader},
    records::{Payload, SHARD},
    rollup,
    sharded::{SHARDS, Shard, Sharded},
};
use serde::Serialize;
use std::{path::PathBuf, sync::Arc};
use tauflow_cache::{Digest, Key};
use tauflow_contract::{ItemKey, Mode, SourceItem, canonical_bytes};

/// What decides a shard's outputs.
#[derive(Serialize)]
struct ShardKey<T> {
    /// Digest of what decides all shards of its lane.
    shards: Digest,
    /// Of a source its items and the params that each reads. Of a map, for each input port, what is put before the keys
    /// of each of its feeds, and the content digest of the feed's shard.
    holds: T,
}

impl Scheduler<'_> {
    /// Decides before anything has come in whether a map lane goes by shards: if what names its items has many.
    pub(super) fn choose_by_shard(&mut self, lane: LaneId) {
        let lanes = self.lanes;
        let Some(driving) = lanes[lane].driving else { return };
        let big = lanes[lane].inputs[driving].iter().any(|feed| {
            let from = &self.states[feed.lane];
            let name = self.spec(feed.lane).outputs[feed.port.place()].name;
            let rolled = from.rolled().and_then(|payload| payload.collections.get(name));
            from.by_shard.is_some() || rolled.is_some_and(|listed| self.is_many(listed.len))
        });
        if big {
            self.go_by_shard(lane);
        }
    }

    /// As [`Scheduler::choose_by_shard`], when a gather that names a lane's items is done.
    pub(super) fn choose_by_shard_of(&mut self, lane: LaneId, len: u64) {
        if !self.is_many(len) || self.states[lane].by_shard.is_some() {
            return;
        }
        self.go_by_shard(lane);
        let lanes = self.lanes;
        for reader in lanes[lane].readers.iter().filter(|reader| lanes[reader.lane].driving == Some(reader.input)) {
            self.choose_by_shard_of(reader.lane, len);
        }
    }

    /// Whether a lane of so many items goes by shards.
    fn is_many(&self, len: u64) -> bool {
        self.many.is_some_and(|many| len >= many)
    }

    fn go_by_shard(&mut self, lane: LaneId) {
        let state = &mut self.states[lane];
        // What has come in item by item is not taken back.
        let untouched = state.slots.is_empty() && state.inputs.iter().all(|input| input.arrived.is_empty());
        if self.lanes[lane].only.is_none() && untouched && !state.is_done() {
            state.by_shard = Some(ByShard::default());
            for shard in state.shards.ids() {
                if !self.shard_stage(lane, shard).is_closed() {
                    self.set_shard(lane, shard, ShardStage::Pending);
                }
            }
        }
    }

    /// Decides whether a source goes by shards. Files outside are read item by item in any case.
    pub(super) fn choose_source_by_shard(&mut self, lane: LaneId, items: &[SourceItem]) {
        let plain = items.iter().all(|item| item.files.is_empty());
        if plain && self.lanes[lane].only.is_none() && self.is_many(items.len() as u64) {
            let listing = rollup::listing_digest(items.iter().map(|item| (&item.key, None)));
            self.states[lane].by_shard = Some(ByShard { listing: Some(listing), ..ByShard::default() });
        }
    }

    /// Looks the shards of a source up, and gives back the items of those that are not as they were.
    pub(super) fn roll_source(
        &mut self,
        lane: LaneId,
        items: Vec<SourceItem>,
    ) -> Vec<(ItemKey, Vec<(String, PathBuf)>)> {
        if self.states[lane].by_shard.is_none() {
            return items.into_iter().map(|item| (item.key, item.files)).collect();
        }
        let mut shards: Row<u8, Vec<ItemKey>> = (0..SHARDS).map(|_| Vec::new()).collect();
        for item in items {
            shards[item.key.shard()].push(item.key);
        }
        let mut left = Vec::new();
        for (shard, keys) in shards.ids().zip(shards).filter(|(_, keys)| !keys.is_empty()) {
            let shards = self.prefix(lane);
            let task = &self.tasks[lane];
            let items = keys.iter().map(|key| (key, (task.projection)(Some(key), task.group))).collect::<Vec<_>>();
            let hash = Key::of(&canonical_bytes(&ShardKey { shards, holds: items }));
            if !self.roll_shard(lane, shard, hash) {
                left.extend(keys.into_iter().map(|key| (key, Vec::new())));
            }
        }
        left
    }

    /// What decides a lane's shards beside their items.
    fn prefix(&mut self, lane: LaneId) -> Digest {
        let (of, spec) = (&self.lanes[lane], self.spec(lane));
        let state = &mut self.states[lane];
        *state.by_shard.get_or_insert_default().prefix.get_or_insert_with(|| {
            let whole = state.inputs.iter().zip(&spec.inputs);
            let whole = whole.filter_map(|(input, port)| Some((port.name, input.whole.as_ref()?.digest))).collect();
            rollup::shard_prefix(self.pipeline, of, whole)
        })
    }

    /// The key of a map's shard; none if something that it reads is not known.
    fn shard_key(&mut self, lane: LaneId, shard: u8) -> Option<Key> {
        let lanes = self.lanes;
        for (input, of) in self.states[lane].inputs.pairs() {
            let whole = lanes[lane].is_whole(self.pipeline, input);
            let open = if whole { of.open > 0 } else { of.open_shards[shard] > 0 };
            if !lanes[lane].inputs[input].is_empty() && (open || of.broken || of.error.is_some()) {
                return None;
            }
        }
        let shards = self.prefix(lane);
        let spec = self.spec(lane);
        let mut holds = Vec::new();
        for (input, feeds) in lanes[lane].inputs.pairs() {
            if lanes[lane].is_whole(self.pipeline, input) {
                continue;
            }
            let mut given = Vec::with_capacity(feeds.len());
            for feed in feeds {
                if self.states[feed.lane].shards[shard].failed {
                    return None;
                }
                given.push((feed.prefix.as_deref(), self.shard_at(feed, shard).map(|shard| shard.digest)));
            }
            holds.push((spec.inputs[input.place()].name, given));
        }
        Some(Key::of(&canonical_bytes(&ShardKey { shards, holds })))
    }

    /// The items of a shard that a feed gives, if it is known and holds any.
    fn shard_at(&self, feed: &LaneFeed, shard: u8) -> Option<Arc<Shard>> {
        let from = &self.states[feed.lane];
        let of_collection = |collection: &Sharded| collection.shards.get(&shard).cloned();
        if let Some(result) = from.results.get(&feed.port) {
            return of_collection(result);
        }
        if let Some(made) = from.slots.first().and_then(|slot| slot.made.collection(feed.port)) {
            return of_collection(made);
        }
        let outputs = &from.shards[shard].outputs;
        outputs.iter().find(|(port, shard)| *port == feed.port && shard.len > 0).map(|(_, shard)| shard.clone())
    }

    /// Looks a shard up as a whole, once all that it reads is known; opens it if that fails.
    pub(super) fn decide(&mut self, lane: LaneId, shard: u8) {
        let lanes = self.lanes;
        let state = &self.states[lane];
        if state.is_done() || state.shards[shard].stage != ShardStage::Pending {
            return;
        }
        let (mut open, mut lost) = (false, false);
        for (input, of) in state.inputs.pairs().filter(|(input, _)| !lanes[lane].inputs[*input].is_empty()) {
            let whole = lanes[lane].is_whole(self.pipeline, input);
            lost |= of.broken || (of.open == 0 && of.error.is_some());
            open |= if whole { of.open > 0 } else { of.open_shards[shard] > 0 };
        }
        if lost {
            return self.set_shard(lane, shard, ShardStage::Open);
        }
        if open {
            return;
        }
        let driven = lanes[lane]
            .driving
            .is_some_and(|driving| lanes[lane].inputs[driving].iter().any(|feed| self.shard_at(feed, shard).is_some()));
        let rolled = driven && self.shard_key(lane, shard).is_some_and(|key| self.roll_shard(lane, shard, key));
        if !rolled {
            self.set_shard(lane, shard, ShardStage::Open);
        }
    }

    /// Takes a shard as an earlier run left it, if one did.
    fn roll_shard(&mut self, lane: LaneId, shard: u8, key: Key) -> bool {
        self.states[lane].shards[shard].key = Some(key);
        let Some(record) = self.bench.store.lookup(SHARD, &key) else { return false };
        match self.bench.intact(&record) {
            Ok(true) => {}
            Ok(false) => return false,
            Err(error) => {
                self.fatal.get_or_insert(error);
                return false;
            }
        }
        let Some(payload) = Payload::of(&record) else { return false };
        let Some(outputs) = self.listed_outputs(lane, shard, &payload) else { return false };
        let totals = (payload.actions, record.wall_us, record.bytes);
        self.account.rolled(lane, Some(shard), totals);
        let of = &mut self.states[lane].shards[shard];
        (of.outputs, of.totals) = (outputs, totals);
        self.set_shard(lane, shard, ShardStage::Rolled);
        true
    }

    /// What a shard's roll-up says of each port of its lane.
    fn listed_outputs(&self, lane: LaneId, shard: u8, payload: &Payload) -> Option<Vec<(PortId, Arc<Shard>)>> {
        let outputs = &self.spec(lane).outputs;
        let listed = |port: &PortId| {
            let of = &outputs[port.place()];
            let listed = payload.collections.get(of.name)?;
            Some((*port, Arc::new(Shard::listed(listed, shard, of.media))))
        };
        self.lanes[lane].ports.iter().map(listed).collect()
    }

    /// Gives the items of a rolled shard to those who go item by item.
    pub(super) fn hand_on_shard(&mut self, lane: LaneId, shard: u8) {
        let lanes = self.lanes;
        for reader in &lanes[lane].readers {
            if self.reads_items(reader)
                && self.shard_stage(reader.lane, shard).by_item()
                && let Some(items) = self.shard_at(self.feed(reader), shard)
            {
                self.give_shard(reader.lane, reader.input, self.feed(reader), shard, &items);
            }
        }
    }

    pub(super) fn shard_stage(&self, lane: LaneId, shard: u8) -> ShardStage {
        self.states[lane].shards[shard].stage
    }

    /// Whether a reader takes items one by one, and is not done.
    pub(super) fn reads_items(&self, reader: &Reader) -> bool {
        !self.states[reader.lane].is_done() && !self.takes_whole(reader)
    }

    /// Tells those who read item by item that a shard is done.
    pub(super) fn tell_fed(&mut self, lane: LaneId, shard: u8) {
        let lanes = self.lanes;
        for reader in &lanes[lane].readers {
            if self.reads_items(reader) {
                self.ops.push_back(Op::ShardFed { lane: reader.lane, input: reader.input, shard });
            }
        }
        self.ops.push_back(Op::Check { lane });
    }

    /// Opens a shard of all who read a lane item by item, because one of the lane's items is not as it was.
    pub(super) fn open_readers(&mut self, lane: LaneId, shard: u8) {
        let lanes = self.lanes;
        for reader in &lanes[lane].readers {
            if self.reads_items(reader) && self.shard_stage(reader.lane, shard) == ShardStage::Pending {
                self.set_shard(reader.lane, shard, ShardStage::Open);
            }
        }
    }

    /// Gives a shard that was opened what had come for it before.
    pub(super) fn take_what_came(&mut self, lane: LaneId, shard: u8) {
        let lanes = self.lanes;
        for (input, feeds) in lanes[lane].inputs.pairs() {
            if lanes[lane].is_whole(self.pipeline, input) {
                continue;
            }
            for feed in feeds {
                let from = &self.states[feed.lane];
                // Of a lane that goes item by item, items that failed are told, too.
                let by_item =
                    from.rolled().is_none() && from.shards[shard].stage.by_item() && !self.is_gather(feed.lane);
                if by_item {
                    for slot in from.shards[shard].slots.clone() {
                        self.give_slot(lane, input, feed, slot);
                    }
                } else if let Some(items) = self.shard_at(feed, shard) {
                    self.give_shard(lane, input, feed, shard, &items);
                }
            }
        }
    }

    /// Gives the items of a shard to one reader.
    pub(super) fn give_shard(&mut self, lane: LaneId, input: InputId, feed: &LaneFeed, shard: u8, of: &Shard) {
        match of.items(self.bench.store) {
            Ok(Ok(items)) => {
                for (key, output) in items {
                    match prefixed(feed, key) {
                        Ok(key) => self.give(lane, input, key, Arrival::Item(output.clone())),
                        Err(message) => return self.fail_lane(lane, message),
                    }
                }
            }
            Ok(Err(blob)) if self.bench.wanted.contains(&blob) => self.fail_lane(lane, super::lost(&blob)),
            Ok(Err(blob)) => {
                // The next pass makes it. Until then the input stays open, and so what reads it does not end.
                self.missing.insert(blob);
                let input = &mut self.states[lane].inputs[input];
                input.open += 1;
                input.open_shards[shard] += 1;
            }
            Err(error) => {
                self.fatal.get_or_insert(error);
            }
        }
    }

    pub(super) fn shard_fed(&mut self, lane: LaneId, input: InputId, shard: u8) {
        let state = &mut self.states[lane];
        if state.is_done() {
            return;
        }
        let open = &mut state.inputs[input].open_shards[shard];
        *open -= 1;
        if *open > 0 {
            return;
        }
        let of = &state.shards[shard];
        self.ops.extend(of.slots.iter().map(|slot| Op::Try { lane, slot: *slot }));
        if of.stage == ShardStage::Pending {
            self.ops.push_back(Op::Decide { lane, shard });
        } else {
            self.ops.push_back(Op::CheckShard { lane, shard });
        }
    }

    /// Looks whether any shard is done.
    pub(super) fn check_shards(&mut self, lane: LaneId) {
        self.ops.extend((0..=u8::MAX).map(|shard| Op::CheckShard { lane, shard }));
    }

    pub(super) fn check_shard(&mut self, lane: LaneId, shard: u8) {
        let state = &self.states[lane];
        let of = &state.shards[shard];
        if of.stage != ShardStage::Open || of.open > 0 || state.is_done() {
            return;
        }
        let fed = match self.lanes[lane].driving {
            Some(driving) => state.inputs[driving].open_shards[shard] == 0,
            // Of a source; a gather has no shards.
            None => matches!(state.stage, LaneStage::Full) && self.mode(lane) == Mode::Source,
        };
        if !fed {
            return;
        }
        let failed = of.failed;
        let outputs = if failed { Vec::new() } else { self.outputs_of(lane, of) };
        let by_shard = state.by_shard.is_some() && !failed && !of.slots.is_empty() && !self.bench.dry;
        if by_shard {
            let known = of.key;
            let source = self.lanes[lane].driving.is_none();
            if let Some(key) = if source { known } else { self.shard_key(lane, shard) } {
                let state = &self.states[lane];
                let mut complete =
                    CompleteShard { lane, key, outputs: outputs.clone(), actions: 0, wall_us: 0, bytes: 0 };
                for slot in &state.shards[shard].slots {
                    let made = &state.slots[*slot].made;
                    complete.actions += 1;
                    complete.wall_us = complete.wall_us.saturating_add(made.wall_us);
                    complete.bytes = complete.bytes.saturating_add(made.bytes);
                }
                self.outbox.shards.push(complete);
            }
        }
        self.states[lane].shards[shard].outputs = outputs;
        self.set_shard(lane, shard, ShardStage::Closed);
    }

    fn outputs_of(&self, lane: LaneId, shard: &ShardState) -> Vec<(PortId, Arc<Shard>)> {
        let slots = &self.states[lane].slots;
        let of_port = |port: &PortId| {
            let item = |slot: &SlotId| {
                let slot = &slots[*slot];
                Some((slot.key.clone()?, slot.made.item(*port)?.clone()))
            };
            let mut items: Vec<_> = shard.slots.iter().filter_map(item).collect();
            items.sort_by(|a, b| a.0.cmp(&b.0));
            (*port, Arc::new(Shard::new(items)))
        };
        self.lanes[lane].ports.iter().map(of_port).collect()
    }
}
