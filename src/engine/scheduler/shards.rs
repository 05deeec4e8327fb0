//! Shards of lanes: when one is looked up as a whole, when it is opened to go item by item, and when it is done.

use super::{
    Scheduler,
    flow::prefixed,
    state::{CompleteShard, Given, Op, Shard, Stage},
};
use crate::engine::{
    lanes::{LaneFeed, Reader},
    records::{Payload, SHARD},
    rollup,
    whole::{Part, SHARDS},
};
use std::{path::PathBuf, sync::Arc};
use tauflow_cache::{Key, Record};
use tauflow_contract::{ItemKey, Mode, SourceItem, canonical_bytes};

impl Scheduler<'_> {
    /// Decides before anything has come in whether a map lane goes by shards: if what names its items has many.
    pub(super) fn choose_by_shard(&mut self, lane: usize) {
        let lanes = self.lanes;
        let Some(driving) = lanes[lane].driving else { return };
        let big = lanes[lane].inputs[driving].iter().any(|feed| {
            let from = &self.states[feed.lane];
            let name = self.pipeline.nodes[lanes[feed.lane].node].spec.outputs[feed.port].name;
            let rolled = from.rolled.as_ref().and_then(|payload| payload.collections.get(name));
            from.by_shard || rolled.is_some_and(|listed| listed.len >= self.many)
        });
        if big {
            self.go_by_shard(lane);
        }
    }

    /// As [`Scheduler::choose_by_shard`], when a gather that names a lane's items is done.
    pub(super) fn choose_by_shard_of(&mut self, lane: usize, len: u64) {
        if len < self.many || self.states[lane].by_shard {
            return;
        }
        self.go_by_shard(lane);
        let lanes = self.lanes;
        for reader in lanes[lane].readers.iter().filter(|reader| lanes[reader.lane].driving == Some(reader.input)) {
            self.choose_by_shard_of(reader.lane, len);
        }
    }

    fn go_by_shard(&mut self, lane: usize) {
        let state = &mut self.states[lane];
        // What has come in item by item is not taken back.
        let untouched = state.slots.is_empty() && state.inputs.iter().all(|input| input.given.is_empty());
        if self.roll && self.lanes[lane].only.is_none() && untouched && !state.done {
            state.by_shard = true;
            state.shards.iter_mut().filter(|shard| !shard.closed).for_each(|shard| shard.stage = Stage::Pending);
        }
    }

    /// Decides whether a source goes by shards. Files outside are read item by item in any case.
    pub(super) fn choose_source_by_shard(&mut self, lane: usize, items: &[SourceItem]) {
        let plain = items.iter().all(|item| item.files.is_empty());
        if self.roll && plain && self.lanes[lane].only.is_none() && items.len() as u64 >= self.many {
            self.states[lane].by_shard = true;
            self.states[lane].listing = Some(rollup::listing_digest(items.iter().map(|item| (&item.key, None))));
        }
    }

    /// Looks the shards of a source up, and gives back the items of those that are not as they were.
    pub(super) fn roll_source(
        &mut self,
        lane: usize,
        items: Vec<SourceItem>,
    ) -> Vec<(ItemKey, Vec<(String, PathBuf)>)> {
        if !self.states[lane].by_shard {
            return items.into_iter().map(|item| (item.key, item.files)).collect();
        }
        let mut shards: Vec<Vec<ItemKey>> = vec![Vec::new(); SHARDS];
        for item in items {
            shards[usize::from(item.key.shard())].push(item.key);
        }
        let mut left = Vec::new();
        for (shard, keys) in shards.into_iter().enumerate() {
            if keys.is_empty() {
                continue;
            }
            let mut bytes = self.prefix(lane);
            for key in &keys {
                field(&mut bytes, key.as_str().as_bytes());
                field(&mut bytes, &canonical_bytes(&(self.tasks[lane].projection)(Some(key), self.tasks[lane].group)));
            }
            let hash = Key::of(&bytes);
            if !self.roll_shard(lane, shard as u8, hash) {
                left.extend(keys.into_iter().map(|key| (key, Vec::new())));
            }
        }
        left
    }

    /// What decides a shard beside its items: the start of the bytes of its key.
    fn prefix(&mut self, lane: usize) -> Vec<u8> {
        let of = &self.lanes[lane];
        let state = &mut self.states[lane];
        let digest = *state.prefix.get_or_insert_with(|| {
            let spec = &self.pipeline.nodes[of.node].spec;
            let whole = state.inputs.iter().zip(spec.inputs);
            let whole = whole.filter_map(|(input, port)| Some((port.name, input.whole.as_ref()?.digest))).collect();
            rollup::shard_prefix(self.pipeline, of, whole)
        });
        let mut bytes = b"tauflow-shard-roll-up-1".to_vec();
        field(&mut bytes, &digest.hash);
        bytes
    }

    /// The key of a map's shard; none if something that it reads is not known.
    fn shard_key(&mut self, lane: usize, shard: u8) -> Option<Key> {
        let lanes = self.lanes;
        let number = usize::from(shard);
        for (input, of) in self.states[lane].inputs.iter().enumerate() {
            let whole = lanes[lane].is_whole(self.pipeline, input);
            let open = if whole { of.open > 0 } else { of.open_shards[number] > 0 };
            if !lanes[lane].inputs[input].is_empty() && (open || of.broken || of.error.is_some()) {
                return None;
            }
        }
        let mut bytes = self.prefix(lane);
        let spec = &self.pipeline.nodes[lanes[lane].node].spec;
        for (input, feeds) in lanes[lane].inputs.iter().enumerate() {
            if lanes[lane].is_whole(self.pipeline, input) {
                continue;
            }
            field(&mut bytes, spec.inputs[input].name.as_bytes());
            for feed in feeds {
                if self.states[feed.lane].shards[number].failed {
                    return None;
                }
                field(&mut bytes, feed.prefix.as_deref().unwrap_or("").as_bytes());
                match self.part_at(feed, shard) {
                    Some(part) => field(&mut bytes, &part.digest.hash),
                    None => field(&mut bytes, b""),
                }
            }
        }
        Some(Key::of(&bytes))
    }

    /// The items of a shard that a feed gives, if it is known and holds any.
    fn part_at(&self, feed: &LaneFeed, shard: u8) -> Option<Arc<Part>> {
        let from = &self.states[feed.lane];
        let of_whole = |whole: &crate::engine::whole::Whole| whole.parts.get(&shard).cloned();
        if let Some(whole) = from.results.get(&feed.port) {
            return of_whole(whole);
        }
        if let Some(whole) = from.slots.first().and_then(|slot| slot.made.collection(feed.port)) {
            return of_whole(whole);
        }
        let parts = &from.shards[usize::from(shard)].parts;
        parts.iter().find(|(port, part)| *port == feed.port && part.len > 0).map(|(_, part)| part.clone())
    }

    /// Looks a shard up as a whole, once all that it reads is known; opens it if that fails.
    pub(super) fn decide(&mut self, lane: usize, shard: u8) {
        let lanes = self.lanes;
        let state = &self.states[lane];
        if state.done || state.shards[usize::from(shard)].stage != Stage::Pending {
            return;
        }
        let mut open = false;
        for (input, of) in state.inputs.iter().enumerate().filter(|(input, _)| !lanes[lane].inputs[*input].is_empty()) {
            let whole = lanes[lane].is_whole(self.pipeline, input);
            if of.broken || (of.open == 0 && of.error.is_some()) {
                return self.open_shard(lane, shard);
            }
            open |= if whole { of.open > 0 } else { of.open_shards[usize::from(shard)] > 0 };
        }
        if open {
            return;
        }
        let driven = lanes[lane]
            .driving
            .is_some_and(|driving| lanes[lane].inputs[driving].iter().any(|feed| self.part_at(feed, shard).is_some()));
        let rolled = driven && self.shard_key(lane, shard).is_some_and(|key| self.roll_shard(lane, shard, key));
        if !rolled {
            self.open_shard(lane, shard);
        }
    }

    /// Takes a shard as an earlier run left it, if one did.
    fn roll_shard(&mut self, lane: usize, shard: u8, key: Key) -> bool {
        self.states[lane].shards[usize::from(shard)].key = Some(key);
        let Some(record) = self.bench.store.lookup(SHARD, &key) else { return false };
        match self.bench.whole(&record) {
            Ok(true) => {}
            Ok(false) => return false,
            Err(error) => {
                self.fatal.get_or_insert(error);
                return false;
            }
        }
        let Some(parts) = self.rolled_parts(lane, &record) else { return false };
        let Some(payload) = Payload::of(&record) else { return false };
        let totals = (payload.actions, record.wall_us, record.bytes);
        self.count_rolled(lane, Some(shard), totals);
        let of = &mut self.states[lane].shards[usize::from(shard)];
        (of.stage, of.closed, of.parts, of.totals) = (Stage::Rolled, true, parts, totals);
        self.states[lane].open_shards -= 1;
        let lanes = self.lanes;
        for reader in &lanes[lane].readers {
            if self.reads_items(reader) && self.stage(reader.lane, shard) == Stage::Open {
                let feed = &lanes[reader.lane].inputs[reader.input][reader.feed];
                if let Some(part) = self.part_at(feed, shard) {
                    self.give_part(reader.lane, reader.input, feed, shard, &part);
                }
            }
        }
        self.tell_fed(lane, shard);
        true
    }

    fn rolled_parts(&self, lane: usize, record: &Record) -> Option<Vec<(usize, Arc<Part>)>> {
        let payload = Payload::of(record)?;
        let outputs = &self.pipeline.nodes[self.lanes[lane].node].spec.outputs;
        let part = |port: &usize| Some((*port, Arc::new(Part::listed(payload.collections.get(outputs[*port].name)?))));
        self.lanes[lane].ports.iter().map(part).collect()
    }

    fn stage(&self, lane: usize, shard: u8) -> Stage {
        self.states[lane].shards[usize::from(shard)].stage
    }

    fn reads_items(&self, reader: &Reader) -> bool {
        let reading = &self.states[reader.lane];
        !reading.done && reading.rolled.is_none() && !self.lanes[reader.lane].is_whole(self.pipeline, reader.input)
    }

    fn tell_fed(&mut self, lane: usize, shard: u8) {
        let lanes = self.lanes;
        for reader in &lanes[lane].readers {
            if self.reads_items(reader) {
                self.ops.push_back(Op::ShardFed { lane: reader.lane, input: reader.input, shard });
            }
        }
        self.ops.push_back(Op::Check { lane });
    }

    /// Opens a shard of all who read a lane item by item, because one of the lane's items is not as it was.
    pub(super) fn open_readers(&mut self, lane: usize, shard: u8) {
        let lanes = self.lanes;
        for reader in &lanes[lane].readers {
            if self.reads_items(reader) && self.stage(reader.lane, shard) == Stage::Pending {
                self.open_shard(reader.lane, shard);
            }
        }
    }

    /// Goes on item by item, with what has come so far.
    fn open_shard(&mut self, lane: usize, shard: u8) {
        let lanes = self.lanes;
        self.states[lane].shards[usize::from(shard)].stage = Stage::Open;
        for (input, feeds) in lanes[lane].inputs.iter().enumerate() {
            if lanes[lane].is_whole(self.pipeline, input) {
                continue;
            }
            for feed in feeds {
                let from = &self.states[feed.lane];
                // Of a lane that goes item by item, items that failed are told, too.
                let by_item = from.rolled.is_none()
                    && from.shards[usize::from(shard)].stage == Stage::Open
                    && self.pipeline.nodes[lanes[feed.lane].node].mode() != Mode::Gather;
                if by_item {
                    for slot in from.shards[usize::from(shard)].slots.clone() {
                        self.give_slot(lane, input, feed, slot as usize);
                    }
                } else if let Some(part) = self.part_at(feed, shard) {
                    self.give_part(lane, input, feed, shard, &part);
                }
            }
        }
        self.ops.push_back(Op::CheckShard { lane, shard });
    }

    /// Gives the items of a shard to one reader.
    pub(super) fn give_part(&mut self, lane: usize, input: usize, feed: &LaneFeed, shard: u8, part: &Part) {
        match part.items(self.bench.store) {
            Ok(Ok(items)) => {
                for (key, output) in items {
                    match prefixed(feed, key) {
                        Ok(key) => self.give(lane, input, key, Given::Item(output.clone())),
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
                input.open_shards[usize::from(shard)] += 1;
            }
            Err(error) => {
                self.fatal.get_or_insert(error);
            }
        }
    }

    pub(super) fn shard_fed(&mut self, lane: usize, input: usize, shard: u8) {
        let state = &mut self.states[lane];
        if state.done {
            return;
        }
        let open = &mut state.inputs[input].open_shards[usize::from(shard)];
        *open -= 1;
        if *open > 0 {
            return;
        }
        let of = &state.shards[usize::from(shard)];
        self.ops.extend(of.slots.iter().map(|slot| Op::Try { lane, slot: *slot as usize }));
        if of.stage == Stage::Pending {
            self.ops.push_back(Op::Decide { lane, shard });
        } else {
            self.ops.push_back(Op::CheckShard { lane, shard });
        }
    }

    /// Looks whether any shard is done.
    pub(super) fn check_shards(&mut self, lane: usize) {
        self.ops.extend((0..=u8::MAX).map(|shard| Op::CheckShard { lane, shard }));
    }

    pub(super) fn check_shard(&mut self, lane: usize, shard: u8) {
        let number = usize::from(shard);
        let state = &self.states[lane];
        let of = &state.shards[number];
        if of.closed || of.stage != Stage::Open || of.open > 0 || state.done {
            return;
        }
        let fed = match self.lanes[lane].driving {
            Some(driving) => state.inputs[driving].open_shards[number] == 0,
            // Of a source; a gather has no shards.
            None => state.known && self.pipeline.nodes[self.lanes[lane].node].mode() == Mode::Source,
        };
        if !fed {
            return;
        }
        let failed = of.failed;
        let parts = if failed { Vec::new() } else { self.parts_of(lane, of) };
        let by_shard = state.by_shard && !failed && !of.slots.is_empty() && !self.bench.dry;
        if by_shard {
            let known = of.key;
            let source = self.lanes[lane].driving.is_none();
            if let Some(key) = if source { known } else { self.shard_key(lane, shard) } {
                let state = &self.states[lane];
                let mut complete = CompleteShard { lane, key, parts: parts.clone(), actions: 0, wall_us: 0, bytes: 0 };
                for slot in &state.shards[number].slots {
                    let made = &state.slots[*slot as usize].made;
                    complete.actions += 1;
                    complete.wall_us += made.wall_us;
                    complete.bytes += made.bytes;
                }
                self.complete_shards.push(complete);
            }
        }
        let state = &mut self.states[lane];
        let of = &mut state.shards[number];
        (of.closed, of.parts) = (true, parts);
        state.open_shards -= 1;
        self.tell_fed(lane, shard);
    }

    fn parts_of(&self, lane: usize, shard: &Shard) -> Vec<(usize, Arc<Part>)> {
        let slots = &self.states[lane].slots;
        let part = |port: &usize| {
            let item = |slot: &u32| {
                let slot = &slots[*slot as usize];
                Some((slot.key.clone()?, slot.made.item(*port)?.clone()))
            };
            let mut items: Vec<_> = shard.slots.iter().filter_map(item).collect();
            items.sort_by(|a, b| a.0.cmp(&b.0));
            (*port, Arc::new(Part::new(items)))
        };
        self.lanes[lane].ports.iter().map(part).collect()
    }
}

fn field(bytes: &mut Vec<u8>, field: &[u8]) {
    bytes.extend((field.len() as u64).to_le_bytes());
    bytes.extend(field);
}
