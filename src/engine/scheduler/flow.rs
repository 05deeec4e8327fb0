//! Where items come from and where they go: sources are listed, what ends is handed to its readers, and slots whose
//! inputs are all there become ready.

use super::{
    Scheduler,
    state::{Given, Op, Slot, Status, give_all, given},
};
use crate::engine::{
    event::{Ended, Event},
    lanes::LaneFeed,
    records::{Made, Whole},
};
use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    sync::Arc,
};
use tauflow_contract::{Collection, ItemKey, Mode};

impl Scheduler<'_> {
    pub(super) fn fill_source(&mut self, lane: usize) {
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
            Err(_) => {
                return self.fail_lane(lane, "internal error: listing the items panicked; please report it".into());
            }
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
        let state = &mut self.states[lane];
        let slot = state.slots.len();
        if let Some(key) = &key {
            state.index.insert(key.clone(), slot);
        }
        let gather = key.is_none();
        state.slots.push(Slot { key, files, status: Status::Waiting, made: Made::default(), file: None });
        state.open += 1;
        let (node, ..) = self.names(lane);
        self.events.push(Event::Expect { node, actions: 1 });
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
            self.states[lane].index.get(key.as_str()).copied()
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
        self.ops.push_back(Op::Check { lane });
    }

    /// The collection on a closed input: its feeds' collections, merged.
    pub(super) fn gathered(&self, lane: usize, input: usize) -> Result<Arc<Whole>, String> {
        let feeds = &self.lanes[lane].inputs[input];
        let result = |feed: &LaneFeed| self.states[feed.lane].results.get(&feed.port).cloned();
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

    pub(super) fn try_ready(&mut self, lane: usize, slot: usize) {
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
    pub(super) fn hand_on(&mut self, lane: usize, slot: usize) {
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
}
