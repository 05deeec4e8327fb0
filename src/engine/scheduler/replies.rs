//! Outcomes of actions: replies of the threads that look up and run.

use super::{
    Scheduler, lost,
    state::{Arrival, SlotStage},
};
use crate::engine::{
    event::Ended,
    ids::{LaneId, SlotId},
    job::{Outcome, Reply},
};
use tauflow_cache::CacheError;

impl Scheduler<'_> {
    /// Takes note of a bundle that was looked up.
    pub fn looked_up(&mut self, replies: Vec<Reply>) -> Result<(), CacheError> {
        // A bundle has one slot at least.
        if let Some(reply) = replies.first() {
            self.budget.end_look_up(self.lanes[reply.slot.0].node);
        }
        replies.into_iter().try_for_each(|reply| self.reply(reply))
    }

    /// Takes note of an action that was done; `last` says whether it was the last of its bundle.
    pub fn performed(&mut self, reply: Reply, last: bool) -> Result<(), CacheError> {
        self.budget.end_run(reply.slot, last);
        self.reply(reply)
    }

    /// Takes note of what became of an action.
    fn reply(&mut self, reply: Reply) -> Result<(), CacheError> {
        let (lane, slot) = reply.slot;
        if let Some(message) = reply.warning {
            self.account.warn(message);
        }
        if reply.file.is_some() {
            self.states[lane].slots[slot].extra.get_or_insert_default().file = reply.file;
        }
        let item = self.states[lane].slots[slot].key.clone();
        let ended = match reply.outcome {
            Outcome::Hit(made) => {
                self.states[lane].slots[slot].made = made;
                self.account.hit(lane, item.as_ref())
            }
            Outcome::Ran(made) => {
                self.account.ran(lane, item.as_ref(), reply.spent_us, &made);
                self.states[lane].pace.note(reply.spent_us, made.put);
                self.states[lane].slots[slot].made = made;
                Ended::Ran
            }
            Outcome::Todo(todo) => {
                self.states[lane].slots[slot].extra.get_or_insert_default().todo = Some(todo);
                self.set_slot(lane, slot, SlotStage::Todo);
                self.settle();
                return Ok(());
            }
            Outcome::WouldRun => {
                self.never_run |= !reply.lost;
                self.needs_again(lane, slot);
                Ended::WouldRun
            }
            Outcome::Failed(message) => {
                self.account.fail(lane, item.as_ref(), message);
                Ended::Failed
            }
            Outcome::Missing(digest) if self.bench.wanted.contains(&digest) => {
                self.account.fail(lane, item.as_ref(), lost(&digest));
                Ended::Failed
            }
            Outcome::Missing(digest) => {
                self.missing.insert(digest);
                self.missing.extend(reply.missing);
                self.set_slot(lane, slot, SlotStage::Stalled);
                self.settle();
                return Ok(());
            }
            Outcome::Cancelled => {
                self.set_slot(lane, slot, SlotStage::Stalled);
                self.settle();
                return Ok(());
            }
            Outcome::Fatal(error) => return Err(error),
        };
        if let Some(key) = reply.key {
            self.account.key(lane, item, ended, key);
        }
        self.set_slot(lane, slot, SlotStage::Ended(ended));
        self.settle();
        Ok(())
    }

    /// In a dry run: what an action that would run reads of transient lanes, and is not there, would run again.
    fn needs_again(&mut self, lane: LaneId, slot: SlotId) {
        let state = &self.states[lane];
        let Some(key) = &state.slots[slot].key else { return };
        for (input, feeds) in self.lanes[lane].inputs.pairs() {
            let [feed] = &feeds[..] else { continue };
            let Some(Arrival::Item(output)) = state.inputs[input].arrived.get(key) else { continue };
            let gone = output.artifact.parts.values().any(|digest| !self.bench.is_here(digest));
            if self.tasks[feed.lane].transient && gone {
                self.account.would_run_again(feed.lane, key);
            }
        }
    }
}
