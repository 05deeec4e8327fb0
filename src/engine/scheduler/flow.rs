//! Where items come from and where they go: sources are listed, what ends is handed to its readers, and slots whose
//! inputs are all there become ready.

use super::{
    Scheduler,
    state::{Given, Op, Slot, Stage, Status},
    with_files,
};
use crate::engine::{
    event::Ended,
    lanes::{LaneFeed, Reader},
    records::Made,
    whole::{Items, SHARDS, Whole},
};
use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    sync::Arc,
};
use tauflow_contract::{ItemKey, Mode, SourceItem};

impl Scheduler<'_> {
    /// The items of a source, in order; none if they cannot be listed, which is told.
    pub(super) fn list_source(&mut self, lane: usize) -> Vec<SourceItem> {
        let of = &self.lanes[lane];
        let node = &self.pipeline.nodes[of.node];
        let params = &self.pipeline.cells[of.cell].params;
        let listed = catch_unwind(AssertUnwindSafe(|| node.kind.items(params)));
        self.states[lane].known = true;
        let message = match listed {
            Ok(Ok(mut items)) => {
                items.sort_by(|a, b| a.key.cmp(&b.key));
                match items.windows(2).find(|w| w[0].key == w[1].key) {
                    Some(pair) => format!("two items have the key `{}`; please report it", pair[0].key),
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
    pub(super) fn fill_source(&mut self, lane: usize, items: Vec<SourceItem>) {
        if self.states[lane].unknown {
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
        lane: usize,
        key: Option<ItemKey>,
        files: Vec<(String, PathBuf)>,
    ) -> Option<usize> {
        if let (Some(only), Some(key)) = (&self.lanes[lane].only, &key)
            && !only.contains(key)
        {
            return None;
        }
        let indexed = self.lanes[lane].inputs.iter().filter(|feeds| !feeds.is_empty()).count() > 1;
        let state = &mut self.states[lane];
        let slot = state.slots.len();
        if indexed && let Some(key) = &key {
            state.index.insert(key.clone(), slot as u32);
        }
        let gather = key.is_none();
        let shard = key.as_ref().map_or(0, ItemKey::shard);
        let of = &mut state.shards[usize::from(shard)];
        of.slots.push(slot as u32);
        of.open += 1;
        state.slots.push(Slot { key, shard, status: Status::Waiting, made: Made::default(), extra: with_files(files) });
        state.open += 1;
        self.expected[self.lanes[lane].node] += 1;
        if gather {
            self.ops.push_back(Op::Try { lane, slot });
        }
        Some(slot)
    }

    pub(super) fn give(&mut self, lane: usize, input: usize, key: ItemKey, given: Given) {
        if self.states[lane].inputs[input].given.insert(key.clone(), given).is_some() {
            let port = self.pipeline.nodes[self.lanes[lane].node].spec.inputs[input].name;
            return self.fail_lane(lane, format!("two of the nodes on input `{port}` give an item `{key}`"));
        }
        let slot = if self.lanes[lane].driving == Some(input) {
            self.add_slot(lane, Some(key), Vec::new())
        } else {
            self.states[lane].index.get(key.as_str()).map(|slot| *slot as usize)
        };
        if let Some(slot) = slot {
            self.ops.push_back(Op::Try { lane, slot });
        }
    }

    pub(super) fn feed_done(&mut self, lane: usize, input: usize, broken: bool) {
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
        if state.by_shard {
            let pending = (0..=u8::MAX).filter(|shard| state.shards[usize::from(*shard)].stage == Stage::Pending);
            self.ops.extend(pending.map(|shard| Op::Decide { lane, shard }));
        }
        if self.states[lane].known {
            self.check_shards(lane);
        }
        self.ops.push_back(Op::Check { lane });
    }

    /// The collection on a closed input: its feeds' collections, merged.
    pub(super) fn gathered(&mut self, lane: usize, input: usize) -> Result<Arc<Whole>, String> {
        let feeds = &self.lanes[lane].inputs[input];
        let result = |feed: &LaneFeed| self.states[feed.lane].results.get(&feed.port).cloned();
        if let [feed] = &feeds[..]
            && feed.prefix.is_none()
            && let Some(whole) = result(feed)
        {
            return Ok(whole);
        }
        let mut merged = Items::new();
        for feed in feeds {
            let Some(whole) = result(feed) else { return Err("internal error: a collection is missing".into()) };
            let items = match whole.items(self.bench.store) {
                Ok(Ok(items)) => items,
                Ok(Err(blob)) if self.bench.wanted.contains(&blob) => return Err(super::lost(&blob)),
                Ok(Err(blob)) => {
                    // The next pass makes it; until then the input stays open.
                    self.missing.insert(blob);
                    self.states[lane].inputs[input].open += 1;
                    return Err(super::lost(&blob));
                }
                Err(error) => return Err(error.to_string()),
            };
            for (key, output) in items {
                merged.push((prefixed(feed, &key)?, output));
            }
        }
        merged.sort_by(|a, b| a.0.cmp(&b.0));
        if let Some(pair) = merged.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            let port = self.pipeline.nodes[self.lanes[lane].node].spec.inputs[input].name;
            return Err(format!("two of the nodes on input `{port}` give an item `{}`", pair[0].0));
        }
        Ok(Arc::new(Whole::of(merged)))
    }

    pub(super) fn try_ready(&mut self, lane: usize, slot: usize) {
        let state = &self.states[lane];
        if state.slots[slot].status != Status::Waiting {
            return;
        }
        let spec = &self.pipeline.nodes[self.lanes[lane].node].spec;
        let shard = usize::from(state.slots[slot].shard);
        let (mut wait, mut blocked, mut error) = (false, false, None);
        for (number, input) in state.inputs.iter().enumerate() {
            if self.lanes[lane].inputs[number].is_empty() {
                continue;
            }
            if self.lanes[lane].is_whole(self.pipeline, number) {
                wait |= input.open > 0;
                blocked |= input.broken;
                if input.open == 0 {
                    error = error.or_else(|| input.error.clone());
                }
                continue;
            }
            let Some(key) = &state.slots[slot].key else { continue }; // gathers have whole inputs only
            match input.given.get(key) {
                Some(Given::Item(_)) => {}
                Some(Given::Broken) => blocked = true,
                None if input.open > 0 && input.open_shards[shard] > 0 => wait = true,
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
    pub(super) fn hand_on(&mut self, lane: usize, slot: usize) {
        let lanes = self.lanes;
        if self.states[lane].slots[slot].key.is_none() {
            return self.hand_on_gathered(lane, slot);
        }
        let (shard, status) = (self.states[lane].slots[slot].shard, self.states[lane].slots[slot].status);
        let open = |reader: &&Reader| {
            let reading = &self.states[reader.lane];
            let whole = lanes[reader.lane].is_whole(self.pipeline, reader.input);
            !reading.done && !whole && reading.shards[usize::from(shard)].stage == Stage::Open
        };
        // Those that are opened below take what is there, this item included.
        let open: Vec<&Reader> = lanes[lane].readers.iter().filter(open).collect();
        if status != Status::Ended(Ended::Hit) {
            self.open_readers(lane, shard);
        }
        for reader in open {
            let feed = &lanes[reader.lane].inputs[reader.input][reader.feed];
            self.give_slot(reader.lane, reader.input, feed, slot);
        }
    }

    /// Gives one slot's output on.
    pub(super) fn give_slot(&mut self, lane: usize, input: usize, feed: &LaneFeed, slot: usize) {
        let from = &self.states[feed.lane].slots[slot];
        let Some(key) = &from.key else { return };
        let given = match from.status {
            Status::Ended(Ended::Hit | Ended::Ran) => match from.made.item(feed.port) {
                Some(output) => Given::Item(output.clone()),
                None => return, // filtered out
            },
            Status::Ended(_) => Given::Broken,
            _ => return,
        };
        match prefixed(feed, key) {
            Ok(key) => self.give(lane, input, key, given),
            Err(message) => self.fail_lane(lane, message),
        }
    }

    /// Gives what a gather made to those who read item by item.
    fn hand_on_gathered(&mut self, lane: usize, slot: usize) {
        let lanes = self.lanes;
        for reader in &lanes[lane].readers {
            if self.states[reader.lane].done || lanes[reader.lane].is_whole(self.pipeline, reader.input) {
                continue;
            }
            let feed = &lanes[reader.lane].inputs[reader.input][reader.feed];
            let Some(whole) = self.states[lane].slots[slot].made.collection(feed.port).cloned() else { continue };
            if lanes[reader.lane].driving == Some(reader.input) {
                self.choose_by_shard_of(reader.lane, whole.len());
            }
            for (shard, part) in &whole.parts {
                if self.states[reader.lane].shards[usize::from(*shard)].stage == Stage::Open {
                    self.give_part(reader.lane, reader.input, feed, *shard, part);
                }
            }
        }
    }

    /// Tells the readers that a lane is done; those of a rolled lane get its items now.
    pub(super) fn hand_on_whole(&mut self, lane: usize) {
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
                && let Some(result) = self.states[lane].results.get(&feed.port).cloned()
            {
                if lanes[reader.lane].driving == Some(reader.input) {
                    self.choose_by_shard_of(reader.lane, result.len());
                }
                for (shard, part) in &result.parts {
                    if self.states[reader.lane].shards[usize::from(*shard)].stage == Stage::Open {
                        self.give_part(reader.lane, reader.input, feed, *shard, part);
                    }
                }
            }
            // Of what failed as a whole, nobody knows which items there would be: its shards stay open until that is told below.
            if !whole && (rolled || (gather && !unknown && !failed)) {
                let (lane, input) = (reader.lane, reader.input);
                self.ops.extend((0..SHARDS).map(|shard| Op::ShardFed { lane, input, shard: shard as u8 }));
            }
            // Items that failed were told one by one to those who read item by item.
            let broken = unknown || (failed && (whole || gather));
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
