//! Where items come from and where they go: sources get their slots, what ends is handed to its readers, and slots
//! whose inputs are all there become ready.

use super::{
    Scheduler,
    state::{Arrival, Extra, Health, LaneStage, Op, ShardStage, Slot, SlotStage},
};
use crate::engine::{
    event::Ended,
    ids::{Id, InputId, LaneId, SlotId},
    lanes::{LaneFeed, ReadingPort},
    records::Made,
    request::{Merge, prefixed},
    sharded::{SHARDS, Sharded},
};
use std::path::PathBuf;
use tauflow_contract::{ItemKey, SourceItem};

impl Scheduler<'_> {
    /// Gives a source its slots; where it goes by shards, those of shards that are not as they were.
    pub(super) fn fill_source(&mut self, lane: LaneId, items: Vec<SourceItem>) {
        if self.states[lane].by_shard.is_some() {
            return self.seek_source(lane, items);
        }
        for item in items {
            self.fill(lane, item.key, item.files);
        }
        self.filled(lane);
    }

    /// Gives a source a slot.
    pub(super) fn fill(&mut self, lane: LaneId, key: ItemKey, files: Vec<(String, PathBuf)>) {
        if let Some(slot) = self.add_slot(lane, Some(key), files) {
            self.ops.push_back(Op::Try { lane, slot });
        }
    }

    /// A source has all its slots.
    pub(super) fn filled(&mut self, lane: LaneId) {
        self.set_lane(lane, LaneStage::Full);
        self.check_shards(lane);
        self.ops.push_back(Op::Check { lane });
    }

    pub(super) fn add_slot(
        &mut self,
        lane: LaneId,
        key: Option<ItemKey>,
        files: Vec<(String, PathBuf)>,
    ) -> Option<SlotId> {
        if let (Some(only), Some(key)) = (&self.lanes[lane].only, &key)
            && !only.contains(key)
        {
            return None;
        }
        let indexed = self.lanes[lane].inputs.iter().filter(|feeds| !feeds.is_empty()).count() > 1;
        let state = &mut self.states[lane];
        let gather = key.is_none();
        let shard = key.as_ref().map_or(0, ItemKey::shard);
        let extra = (!files.is_empty()).then(|| Box::new(Extra { files, ..Extra::default() }));
        let indexed = key.clone().filter(|_| indexed);
        let slot = state.slots.push(Slot { key, shard, stage: SlotStage::Waiting, made: Made::default(), extra });
        state.index.extend(indexed.map(|key| (key, slot)));
        let of = &mut state.shards[shard];
        of.slots.push(slot);
        of.open += 1;
        state.open += 1;
        self.account.expect(lane);
        if gather {
            self.ops.push_back(Op::Try { lane, slot });
        }
        Some(slot)
    }

    pub(super) fn give(&mut self, lane: LaneId, input: InputId, key: ItemKey, arrival: Arrival) {
        if self.states[lane].inputs[input].arrived.insert(key.clone(), arrival).is_some() {
            let port = self.spec(lane).inputs[input.place()].name;
            return self.fail_lane(
                lane,
                format!("two nodes on input `{port}` produce an item `{key}`; give each a matrix axis of its own"),
            );
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

    pub(super) fn feed_done(&mut self, lane: LaneId, input: InputId, broken: bool) {
        let state = &mut self.states[lane];
        if state.is_done() {
            return; // rolled lanes read nothing
        }
        state.inputs[input].open -= 1;
        state.inputs[input].broken |= broken;
        if state.inputs[input].open > 0 {
            return;
        }
        let broken = state.inputs[input].broken;
        if self.lanes[lane].is_whole(self.pipeline, input) && !broken && !self.gather(lane, input) {
            // It stays open until the collections are merged.
            self.states[lane].inputs[input].open += 1;
            return;
        }
        if self.lanes[lane].driving == Some(input) {
            self.set_lane(lane, LaneStage::Full);
            if broken {
                self.worsen(lane, Health::Unknown);
            }
        }
        let state = &self.states[lane];
        let waiting = state.slots.pairs().filter(|(_, slot)| slot.stage == SlotStage::Waiting);
        self.ops.extend(waiting.map(|(slot, _)| Op::Try { lane, slot }));
        if state.by_shard.is_some() {
            let pending = state.shards.pairs().filter(|(_, shard)| shard.stage == ShardStage::Pending);
            self.ops.extend(pending.map(|(shard, _)| Op::Decide { lane, shard }));
        }
        if matches!(state.stage, LaneStage::Full) {
            self.check_shards(lane);
        }
        self.ops.push_back(Op::Check { lane });
    }

    /// Gathers the collection on a closed input: its feeds' collections, merged. False if that is still to be done.
    fn gather(&mut self, lane: LaneId, input: InputId) -> bool {
        let at = &self.states[lane].inputs[input];
        if at.whole.is_some() || at.error.is_some() {
            return true; // merged meanwhile
        }
        let lanes = self.lanes;
        let feeds = &lanes[lane].inputs[input];
        let result = |feed: &LaneFeed| self.states[feed.lane].results.get(&feed.port).cloned();
        let found: Option<Vec<_>> = feeds.iter().map(|feed| Some((feed.prefix.clone(), result(feed)?))).collect();
        let Some(found) = found else {
            self.states[lane].inputs[input].error = Some("internal error: a collection is missing".into());
            return true;
        };
        if let [(None, only)] = &found[..] {
            self.states[lane].inputs[input].whole = Some(only.clone());
            return true;
        }
        let port = self.spec(lane).inputs[input.place()].name.to_owned();
        self.asked.merges.push_back(Merge { lane, input, port, feeds: found });
        false
    }

    pub(super) fn try_ready(&mut self, lane: LaneId, slot: SlotId) {
        let state = &self.states[lane];
        if state.slots[slot].stage != SlotStage::Waiting {
            return;
        }
        let spec = self.spec(lane);
        let shard = state.slots[slot].shard;
        let (mut wait, mut blocked, mut error) = (false, false, None);
        for (id, input) in state.inputs.pairs() {
            if self.lanes[lane].inputs[id].is_empty() {
                continue;
            }
            if self.lanes[lane].is_whole(self.pipeline, id) {
                wait |= input.open > 0;
                blocked |= input.broken;
                if input.open == 0 {
                    error = error.or_else(|| input.error.clone());
                }
                continue;
            }
            let Some(key) = &state.slots[slot].key else { continue }; // gathers have whole inputs only
            match input.arrived.get(key) {
                Some(Arrival::Item(_)) => {}
                Some(Arrival::Broken) => blocked = true,
                None if input.reading.contains_key(&shard) => wait = true,
                None if input.open > 0 && input.open_shards[shard] > 0 => wait = true,
                None if input.broken => blocked = true,
                None if spec.inputs[id.place()].optional => {}
                None => {
                    let message = format!(
                        "the input `{}` has no item `{key}`; connect a node that has all items of input `{}`",
                        spec.inputs[id.place()].name,
                        self.lanes[lane].driving.map_or("", |d| spec.inputs[d.place()].name)
                    );
                    error = error.or(Some(message));
                }
            }
        }
        if blocked {
            self.set_slot(lane, slot, SlotStage::Ended(Ended::Blocked));
        } else if let Some(message) = error {
            let key = state.slots[slot].key.clone();
            self.account.fail(lane, key.as_ref(), message);
            self.set_slot(lane, slot, SlotStage::Ended(Ended::Failed));
        } else if !wait {
            self.set_slot(lane, slot, SlotStage::Ready);
        }
    }

    /// Gives an ended slot's outputs to those who read item by item.
    pub(super) fn hand_on(&mut self, lane: LaneId, slot: SlotId) {
        let lanes = self.lanes;
        if self.states[lane].slots[slot].key.is_none() {
            return self.hand_on_gathered(lane, slot);
        }
        let (shard, stage) = (self.states[lane].slots[slot].shard, self.states[lane].slots[slot].stage);
        let open = |reader: &ReadingPort| self.reads_items(*reader) && self.shard_stage(reader.lane, shard).by_item();
        // Those that are opened below take what is there, this item included.
        let open: Vec<ReadingPort> = lanes[lane].readers.iter().copied().filter(open).collect();
        if stage != SlotStage::Ended(Ended::Hit) {
            self.open_readers(lane, shard);
        }
        for reader in open {
            self.give_slot(reader, slot);
        }
    }

    /// Gives one slot's output on.
    pub(super) fn give_slot(&mut self, reader: ReadingPort, slot: SlotId) {
        let feed = self.feed(reader);
        let from = &self.states[feed.lane].slots[slot];
        let Some(key) = &from.key else { return };
        let arrival = match from.stage {
            SlotStage::Ended(Ended::Hit | Ended::Ran) => match from.made.item(feed.port) {
                Some(output) => Arrival::Item(output.clone()),
                None => return, // filtered out
            },
            SlotStage::Ended(_) => Arrival::Broken,
            _ => return,
        };
        match prefixed(feed.prefix.as_deref(), key) {
            Ok(key) => self.give(reader.lane, reader.input, key, arrival),
            Err(message) => self.fail_lane(reader.lane, message),
        }
    }

    /// Gives what a gather made to those who read item by item.
    fn hand_on_gathered(&mut self, lane: LaneId, slot: SlotId) {
        let lanes = self.lanes;
        for reader in lanes[lane].readers.iter().copied() {
            if !self.reads_items(reader) {
                continue;
            }
            let made = &self.states[lane].slots[slot].made;
            if let Some(collection) = made.collection(self.feed(reader).port).cloned() {
                self.hand_on_collection(reader, &collection);
            }
        }
    }

    /// Gives a collection that is there as a whole to one who reads item by item.
    fn hand_on_collection(&mut self, reader: ReadingPort, collection: &Sharded) {
        if self.lanes[reader.lane].driving == Some(reader.input) {
            self.choose_by_shard_of(reader.lane, collection.len());
        }
        for (number, shard) in &collection.shards {
            if self.shard_stage(reader.lane, *number).by_item() {
                self.give_shard(reader, *number, shard);
            }
        }
    }

    /// Tells the readers that a lane is done; those of a rolled lane get its items now.
    pub(super) fn hand_on_whole(&mut self, lane: LaneId) {
        let lanes = self.lanes;
        let (rolled, health) = (self.states[lane].rolled().is_some(), self.states[lane].health);
        let gather = self.is_gather(lane);
        for reader in lanes[lane].readers.iter().copied() {
            if self.states[reader.lane].rolled().is_some() {
                continue;
            }
            let whole = self.takes_whole(reader);
            if rolled
                && !whole
                && let Some(result) = self.states[lane].results.get(&self.feed(reader).port).cloned()
            {
                self.hand_on_collection(reader, &result);
            }
            // If a lane failed as a whole, its items are unknown: its shards stay open until that is reported below.
            if !whole && (rolled || (gather && health == Health::Sound)) {
                let (lane, input) = (reader.lane, reader.input);
                self.ops.extend((0..SHARDS).map(|shard| Op::ShardFed { lane, input, shard: u8::at(shard) }));
            }
            // Items that failed were told one by one to those who read item by item.
            let broken = health == Health::Unknown || (health == Health::Failed && (whole || gather));
            self.ops.push_back(Op::FeedDone { lane: reader.lane, input: reader.input, broken });
        }
    }
}
