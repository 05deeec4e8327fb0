//! Answers of the look-up threads.

use super::{
    Scheduler,
    state::{Arrival, Op, SlotStage},
};
use crate::engine::{
    EngineError,
    event::Ended,
    ids::{InputId, LaneId, SlotId},
    request::{Finding, LookedUp, Merged, Response},
};

impl Scheduler<'_> {
    /// Takes note of an answer.
    ///
    /// # Errors
    /// If the store failed meanwhile.
    pub fn answered(&mut self, answer: Response) -> Result<(), EngineError> {
        match answer {
            Response::Listed { lane, items } => {
                self.end_seeking(lane);
                self.starting.listed.insert(lane, items);
                self.starting.open -= 1;
                if self.starting.open == 0 {
                    self.begin();
                }
            }
            Response::Actions(found) => {
                // A bundle has one slot at least.
                if let Some(first) = found.first() {
                    self.end_seeking(first.slot.0);
                }
                found.into_iter().for_each(|found| self.note_look_up(found));
            }
            Response::Shards { lane, found } => {
                self.end_seeking(lane);
                self.note_shards(lane, found);
            }
            Response::Read(shards) => {
                if let Some((first, _)) = shards.first() {
                    self.end_seeking(first.reader.lane);
                }
                shards.into_iter().for_each(|(shard, read)| self.note_read(shard, read));
            }
            Response::Merged { lane, input, merged } => {
                self.end_seeking(lane);
                self.note_merged(lane, input, merged);
            }
            Response::Lanes(found) => {
                self.seeking.end(0);
                self.rolled.note_lanes(found);
                self.start();
            }
            Response::Listings(read) => {
                self.seeking.end(0);
                self.rolled.note_listings(read);
                self.start();
            }
            Response::Kept => self.seeking.end(0),
            Response::Fatal(error) => return Err(error),
        }
        self.settle();
        Ok(())
    }

    fn end_seeking(&mut self, lane: LaneId) {
        self.seeking.end(self.lanes[lane].node);
    }

    fn note_merged(&mut self, lane: LaneId, input: InputId, merged: Merged) {
        if self.states[lane].is_done() {
            return;
        }
        let at = &mut self.states[lane].inputs[input];
        match merged {
            Merged::Whole(whole) => at.whole = Some(whole),
            Merged::Failed(message) => at.error = Some(message),
            Merged::Missing(blobs) => match blobs.iter().find(|blob| self.wanted.contains(blob)) {
                Some(blob) => at.error = Some(super::lost(blob)),
                None => {
                    // The next pass makes them; until then the input stays open.
                    self.missing.extend(blobs);
                    return;
                }
            },
        }
        self.ops.push_back(Op::FeedDone { lane, input, broken: false });
    }

    fn note_look_up(&mut self, found: LookedUp) {
        let (lane, slot) = found.slot;
        let at = &mut self.states[lane].slots[slot];
        if found.file.is_some() {
            at.extra.get_or_insert_default().file = found.file;
        }
        let item = at.key.clone();
        let ended = match found.standing {
            Finding::Hit(made) => {
                at.made = made;
                self.account.hit(lane, item.as_ref())
            }
            Finding::Todo(todo) => {
                at.extra.get_or_insert_default().todo = Some(todo);
                self.set_slot(lane, slot, SlotStage::Todo);
                self.settle();
                return;
            }
            Finding::WouldRun { lost, gone } => {
                self.never_run |= !lost;
                self.needs_again(lane, slot, &gone);
                Ended::WouldRun
            }
            Finding::Failed(message) => {
                self.account.fail(lane, item.as_ref(), message);
                Ended::Failed
            }
        };
        if let Some(key) = found.key {
            self.account.key(lane, item, ended, key);
        }
        self.set_slot(lane, slot, SlotStage::Ended(ended));
        self.settle();
    }

    /// In a dry run: what an action that would run reads of transient lanes, and is not there, would run again.
    fn needs_again(&mut self, lane: LaneId, slot: SlotId, gone: &[InputId]) {
        let state = &self.states[lane];
        let Some(key) = &state.slots[slot].key else { return };
        for input in gone {
            let [feed] = &self.lanes[lane].inputs[*input][..] else { continue };
            let arrived = matches!(state.inputs[*input].arrived.get(key), Some(Arrival::Item(_)));
            if arrived && self.tasks[feed.lane].producer.transient {
                self.account.would_run_again(feed.lane, key);
            }
        }
    }
}
