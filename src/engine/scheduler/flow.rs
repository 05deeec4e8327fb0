//! The flow of items: sources are listed, finished items are passed to readers, and slots with complete inputs become
//! ready.

use super::{
    Scheduler,
    state::{Arrival, Extra, Health, LaneStage, Op, ShardStage, Slot, SlotStage},
};
use crate::engine::{
    event::Ended,
    ids::{Id, InputId, LaneId, SlotId},
    lanes::{LaneFeed, Reader},
    records::Made,
    sharded::{Items, SHARDS, Sharded},
};
use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    sync::Arc,
};
use tauflow_contract::{ItemKey, SourceItem};

impl Scheduler<'_> {
    /// The items of a source, in order; none if they cannot be listed, which is told.
    pub(super) fn list_source(&mut self, lane: LaneId) -> Vec<SourceItem> {
        let of = &self.lanes[lane];
        let node = &self.pipeline.nodes[of.node];
        let params = &self.pipeline.cells[of.cell].params;
        let listed = catch_unwind(AssertUnwindSafe(|| node.kind.items(params)));
        self.set_lane(lane, LaneStage::Full);
        let message = match listed {
            Ok(Ok(mut items)) => {
                items.sort_by(|a, b| a.key.cmp(&b.key));
                match items.windows(2).find(|w| w[0].key == w[1].key) {
                    Some(pair) => format!("internal error: two items have the key `{}`; please report it", pair[0].key),
                    None => return items,
                }
            }
            Ok(Err(error)) => error.to_string(),
            Err(_) => "internal error: listing the items panicked; please report it".into(),
        };
        self.fail_lane(lane, message);
        Vec::new()
    }

    /// Gives a source its slots.
    pub(super) fn fill_source(&mut self, lane: LaneId, items: Vec<SourceItem>) {
        if self.states[lane].health == Health::Unknown {
            return;
        }
        for (key, files) in self.roll_source(lane, items) {
            if let Some(slot) = self.add_slot(lane, Some(key), files) {
                self.ops.push_back(Op::Try { lane, slot });
            }
        }
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
            return self.fail_lane(lane, format!("two nodes on input `{port}` produce an item `{key}`"));
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
        if self.lanes[lane].is_whole(self.pipeline, input) && !broken {
            match self.gathered(lane, input) {
                Ok(gathered) => self.states[lane].inputs[input].whole = Some(gathered),
                Err(message) => self.states[lane].inputs[input].error = Some(message),
            }
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

    /// The collection on a closed input: its feeds' collections, merged.
    pub(super) fn gathered(&mut self, lane: LaneId, input: InputId) -> Result<Arc<Sharded>, String> {
        let feeds = &self.lanes[lane].inputs[input];
        let result = |feed: &LaneFeed| self.states[feed.lane].results.get(&feed.port).cloned();
        if let [feed] = &feeds[..]
            && feed.prefix.is_none()
            && let Some(result) = result(feed)
        {
            return Ok(result);
        }
        let (mut merged, mut gone) = (Items::new(), Vec::new());
        for feed in feeds {
            let Some(result) = result(feed) else { return Err("internal error: a collection is missing".into()) };
            match result.items(self.bench.store).map_err(|e| e.to_string())? {
                Ok(items) => {
                    for (key, output) in items {
                        merged.push((prefixed(feed, &key)?, output));
                    }
                }
                Err(blob) if self.bench.wanted.contains(&blob) => return Err(super::lost(&blob)),
                Err(blob) => {
                    gone.push(blob);
                    gone.extend(result.blobs(self.bench.store).map_err(|e| e.to_string())?.1);
                }
            }
        }
        if let Some(blob) = gone.first() {
            let told = super::lost(blob);
            // The next pass makes them; until then the input stays open.
            self.missing.extend(gone);
            self.states[lane].inputs[input].open += 1;
            return Err(told);
        }
        merged.sort_by(|a, b| a.0.cmp(&b.0));
        if let Some(pair) = merged.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            let port = self.spec(lane).inputs[input.place()].name;
            return Err(format!("two nodes on input `{port}` produce an item `{}`", pair[0].0));
        }
        Ok(Arc::new(Sharded::of(merged)))
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
        let open = |reader: &&Reader| self.reads_items(reader) && self.shard_stage(reader.lane, shard).by_item();
        // Those that are opened below take what is there, this item included.
        let open: Vec<&Reader> = lanes[lane].readers.iter().filter(open).collect();
        if stage != SlotStage::Ended(Ended::Hit) {
            self.open_readers(lane, shard);
        }
        for reader in open {
            self.give_slot(reader.lane, reader.input, self.feed(reader), slot);
        }
    }

    /// Gives one slot's output on.
    pub(super) fn give_slot(&mut self, lane: LaneId, input: InputId, feed: &LaneFeed, slot: SlotId) {
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
        match prefixed(feed, key) {
            Ok(key) => self.give(lane, input, key, arrival),
            Err(message) => self.fail_lane(lane, message),
        }
    }

    /// Gives what a gather made to those who read item by item.
    fn hand_on_gathered(&mut self, lane: LaneId, slot: SlotId) {
        let lanes = self.lanes;
        for reader in &lanes[lane].readers {
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
    fn hand_on_collection(&mut self, reader: &Reader, collection: &Sharded) {
        if self.lanes[reader.lane].driving == Some(reader.input) {
            self.choose_by_shard_of(reader.lane, collection.len());
        }
        for (number, shard) in &collection.shards {
            if self.shard_stage(reader.lane, *number).by_item() {
                self.give_shard(reader.lane, reader.input, self.feed(reader), *number, shard);
            }
        }
    }

    /// Tells the readers that a lane is done; those of a rolled lane get its items now.
    pub(super) fn hand_on_whole(&mut self, lane: LaneId) {
        let lanes = self.lanes;
        let (rolled, health) = (self.states[lane].rolled().is_some(), self.states[lane].health);
        let gather = self.is_gather(lane);
        for reader in &lanes[lane].readers {
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

/// An item's key below the prefix of a feed.
///
/// # Errors
/// In words, if it is too long with it.
pub(super) fn prefixed(feed: &LaneFeed, key: &ItemKey) -> Result<ItemKey, String> {
    match feed.prefix.as_deref() {
        Some(prefix) => key.in_cell(prefix).map_err(|e| e.to_string()),
        None => Ok(key.clone()),
    }
}
