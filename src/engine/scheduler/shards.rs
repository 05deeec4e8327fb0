//! Shards of lanes: when a shard is looked up as a whole, opened to go item by item, or done.

use super::{
    Scheduler,
    state::{Arrival, ByShard, LaneStage, Op, ShardStage, ShardState},
};
use crate::engine::{
    ids::{Id, InputId, LaneId, PortId, Row, SlotId},
    keys,
    lanes::{LaneFeed, ReadingPort},
    output::Items,
    records::SHARD,
    request::{Keep, RolledShard, Rolling, ShardFound, ShardOf, ShardRead, prefixed},
    sharded::{Here, SHARDS, Shard, Sharded},
};
use std::sync::Arc;
use tauflow_cache::{Digest, Key};
use tauflow_contract::{ItemKey, Mode, SourceItem};

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
        // Items that have arrived are not withdrawn.
        let untouched = state.slots.is_empty() && state.inputs.iter().all(|input| input.arrived.is_empty());
        if self.lanes[lane].is_rolled_up() && untouched && !state.is_done() {
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
        if plain && self.lanes[lane].is_rolled_up() && self.is_many(items.len() as u64) {
            let listing = keys::listing(items.iter().map(|item| (&item.key, None)));
            self.states[lane].by_shard = Some(ByShard { listing: Some(listing), ..ByShard::default() });
        }
    }

    /// Asks for the shards of a source as wholes.
    pub(super) fn seek_source(&mut self, lane: LaneId, items: Vec<SourceItem>) {
        let shards = self.prefix(lane);
        let mut dealt: Row<u8, Vec<ItemKey>> = (0..SHARDS).map(|_| Vec::new()).collect();
        for item in items {
            dealt[item.key.shard()].push(item.key);
        }
        for (shard, keys) in dealt.ids().zip(dealt).filter(|(_, keys)| !keys.is_empty()) {
            self.seek(lane, shard, ShardOf::Items(shards, keys));
        }
    }

    /// Asks for a shard as a whole.
    fn seek(&mut self, lane: LaneId, shard: u8, of: ShardOf) {
        self.set_shard(lane, shard, ShardStage::Sought);
        self.asked.shards.entry(lane).or_default().push((shard, of));
    }

    /// Takes note of what is known of shards: those that an earlier run left are taken as they were, the others are
    /// opened.
    pub(super) fn note_shards(&mut self, lane: LaneId, found: Vec<ShardFound>) {
        for ShardFound { shard, key, items, rolled } in found {
            if self.states[lane].is_done() || self.shard_stage(lane, shard) != ShardStage::Sought {
                continue;
            }
            self.states[lane].shards[shard].key = Some(key);
            let Some(RolledShard { outputs, totals, fetched }) = rolled else {
                items.into_iter().for_each(|key| self.fill(lane, key, Vec::new()));
                self.set_shard(lane, shard, ShardStage::Open);
                continue;
            };
            self.account.rolled(lane, Some(shard), totals);
            let of = &mut self.states[lane].shards[shard];
            (of.outputs, of.totals, of.fetched) = (outputs, totals, fetched);
            self.set_shard(lane, shard, ShardStage::Rolled);
        }
        if self.mode(lane) == Mode::Source {
            self.filled(lane);
        }
    }

    /// The key of a lane's shards, without their items.
    fn prefix(&mut self, lane: LaneId) -> Digest {
        let (of, spec) = (&self.lanes[lane], self.spec(lane));
        let state = &mut self.states[lane];
        *state.by_shard.get_or_insert_default().prefix.get_or_insert_with(|| {
            let whole = state.inputs.iter().zip(&spec.inputs);
            let whole = whole.filter_map(|(input, port)| Some((port.name, input.whole.as_ref()?.digest))).collect();
            keys::shards(self.pipeline, of, whole)
        })
    }

    /// The key of a map's shard; none if something that it reads is not known.
    fn shard_key(&mut self, lane: LaneId, shard: u8) -> Option<Key> {
        let lanes = self.lanes;
        for (input, of) in self.states[lane].inputs.pairs() {
            let whole = lanes[lane].is_whole(self.pipeline, input);
            let open = if whole { of.open > 0 } else { of.is_open(shard) };
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
        Some(keys::shard(shards, holds))
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

    /// Asks for a shard as a whole, once all that it reads is known; opens it if that has no key.
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
        match if driven { self.shard_key(lane, shard) } else { None } {
            Some(key) => self.seek(lane, shard, ShardOf::Key(key)),
            None => self.set_shard(lane, shard, ShardStage::Open),
        }
    }

    /// Gives the items of a rolled shard to those who go item by item.
    pub(super) fn hand_on_shard(&mut self, lane: LaneId, shard: u8) {
        let lanes = self.lanes;
        for reader in lanes[lane].readers.iter().copied() {
            if self.reads_items(reader)
                && self.shard_stage(reader.lane, shard).by_item()
                && let Some(items) = self.shard_at(self.feed(reader), shard)
            {
                self.give_shard(reader, shard, &items);
            }
        }
    }

    pub(super) fn shard_stage(&self, lane: LaneId, shard: u8) -> ShardStage {
        self.states[lane].shards[shard].stage
    }

    /// Whether a reader takes items one by one, and is not done.
    pub(super) fn reads_items(&self, reader: ReadingPort) -> bool {
        !self.states[reader.lane].is_done() && !self.takes_whole(reader)
    }

    /// Tells those who read item by item that a shard is done.
    pub(super) fn tell_fed(&mut self, lane: LaneId, shard: u8) {
        let lanes = self.lanes;
        for reader in lanes[lane].readers.iter().copied() {
            if self.reads_items(reader) {
                self.ops.push_back(Op::ShardFed { lane: reader.lane, input: reader.input, shard });
            }
        }
        self.ops.push_back(Op::Check { lane });
    }

    /// Opens a shard of all who read a lane item by item, because one of the lane's items is not as it was.
    pub(super) fn open_readers(&mut self, lane: LaneId, shard: u8) {
        let lanes = self.lanes;
        for reader in lanes[lane].readers.iter().copied() {
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
            for (place, feed) in feeds.iter().enumerate() {
                let reader = ReadingPort { lane, input, feed: place };
                let from = &self.states[feed.lane];
                // Failed items are also reported for a lane that goes item by item.
                let by_item =
                    from.rolled().is_none() && from.shards[shard].stage.by_item() && !self.is_gather(feed.lane);
                if by_item {
                    for slot in from.shards[shard].slots.clone() {
                        self.give_slot(reader, slot);
                    }
                } else if let Some(items) = self.shard_at(feed, shard) {
                    self.give_shard(reader, shard, &items);
                }
            }
        }
    }

    /// Gives the items of a shard to one reader; asks for them if they are not at hand.
    pub(super) fn give_shard(&mut self, reader: ReadingPort, number: u8, shard: &Arc<Shard>) {
        match shard.at_hand() {
            Some(items) => self.give_items(reader, items),
            None => {
                *self.states[reader.lane].inputs[reader.input].reading.entry(number).or_insert(0) += 1;
                self.asked.reads.push_back(ShardRead { reader, number, shard: shard.clone() });
            }
        }
    }

    fn give_items(&mut self, reader: ReadingPort, items: &Items) {
        let prefix = self.feed(reader).prefix.as_deref();
        for (key, output) in items {
            match prefixed(prefix, key) {
                Ok(key) => self.give(reader.lane, reader.input, key, Arrival::Item(output.clone())),
                Err(message) => return self.fail_lane(reader.lane, message),
            }
        }
    }

    /// Takes note of a shard that was read.
    pub(super) fn note_read(&mut self, ShardRead { reader, number, shard }: ShardRead, read: Here<()>) {
        let ReadingPort { lane, input, .. } = reader;
        if self.states[lane].is_done() {
            return;
        }
        match (read, shard.at_hand()) {
            (Ok(()), Some(items)) => self.give_items(reader, items),
            (Ok(()), None) => self.fail_lane(lane, "internal error: a shard was not read; please report it".into()),
            (Err(blob), _) if self.wanted.contains(&blob) => self.fail_lane(lane, super::lost(&blob)),
            (Err(blob), _) => {
                // The next pass makes it. Until then the shard stays open, and what reads it does not end.
                self.missing.insert(blob);
                return;
            }
        }
        let reading = &mut self.states[lane].inputs[input].reading;
        if let Some(open) = reading.get_mut(&number) {
            *open -= 1;
            if *open == 0 {
                reading.remove(&number);
            }
        }
        self.look_again(lane, number);
    }

    /// Looks what may be done in a shard, now that more of what it reads is known.
    fn look_again(&mut self, lane: LaneId, shard: u8) {
        let of = &self.states[lane].shards[shard];
        self.ops.extend(of.slots.iter().map(|slot| Op::Try { lane, slot: *slot }));
        if of.stage == ShardStage::Pending {
            self.ops.push_back(Op::Decide { lane, shard });
        } else {
            self.ops.push_back(Op::CheckShard { lane, shard });
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
        self.look_again(lane, shard);
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
            Some(driving) => !state.inputs[driving].is_open(shard),
            // A source; a gather has no shards.
            None => matches!(state.stage, LaneStage::Full) && self.mode(lane) == Mode::Source,
        };
        if !fed {
            return;
        }
        let failed = of.failed;
        let outputs = if failed { Vec::new() } else { self.outputs_of(lane, of) };
        if state.by_shard.is_some() && !failed && !of.slots.is_empty() && !self.dry {
            let known = of.key;
            let source = self.lanes[lane].driving.is_none();
            if let Some(key) = if source { known } else { self.shard_key(lane, shard) } {
                let keep = self.shard_to_keep(lane, shard, key, &outputs);
                self.asked.keeps.push(keep);
            }
        }
        self.states[lane].shards[shard].outputs = outputs;
        self.set_shard(lane, shard, ShardStage::Closed);
    }

    /// The roll-up of a shard whose slots have all come to outputs.
    fn shard_to_keep(&self, lane: LaneId, shard: u8, key: Key, outputs: &[(PortId, Arc<Shard>)]) -> Keep {
        let (state, spec) = (&self.states[lane], self.spec(lane));
        let mut totals = (0_u64, 0_u64, 0_u64);
        for slot in &state.shards[shard].slots {
            let made = &state.slots[*slot].made;
            totals = (totals.0 + 1, totals.1.saturating_add(made.wall_us), totals.2.saturating_add(made.bytes));
        }
        let mut made = state.shards[shard].slots.iter().map(|slot| &state.slots[*slot].made);
        let fetched = made.find_map(|made| made.fetched.as_deref()).map(str::to_owned);
        let name = |port: &PortId| spec.outputs[port.place()].name.to_owned();
        Keep {
            namespace: SHARD,
            key,
            preimage: String::new(),
            kind: spec.name.to_owned(),
            outputs: outputs.iter().map(|(port, shard)| (name(port), Rolling::Shard(shard.clone()))).collect(),
            totals,
            transient: self.lanes[lane].is_transient(self.pipeline),
            fetched,
        }
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
