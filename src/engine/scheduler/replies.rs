//! What became of actions: answers of the look-up threads, and replies of the executor.

use super::{
    Scheduler, lost,
    state::{Arrival, SlotStage},
};
use crate::engine::{
    EngineError,
    event::Ended,
    execute::Outcome,
    executor::Reply,
    ids::{InputId, LaneId, SlotId},
    job::{LookedUp, Standing},
};

impl Scheduler<'_> {
    /// Takes note of a bundle that was looked up.
    ///
    /// # Errors
    /// If the store failed meanwhile.
    pub fn looked_up(&mut self, found: Vec<LookedUp>) -> Result<(), EngineError> {
        // A bundle has one slot at least.
        if let Some(first) = found.first() {
            self.seeking.end(self.lanes[first.slot.0].node);
        }
        found.into_iter().try_for_each(|found| self.note_look_up(found))
    }

    fn note_look_up(&mut self, found: LookedUp) -> Result<(), EngineError> {
        let (lane, slot) = found.slot;
        let at = &mut self.states[lane].slots[slot];
        if found.file.is_some() {
            at.extra.get_or_insert_default().file = found.file;
        }
        let item = at.key.clone();
        let ended = match found.standing {
            Standing::Hit(made) => {
                at.made = made;
                self.account.hit(lane, item.as_ref())
            }
            Standing::Todo(todo) => {
                at.extra.get_or_insert_default().todo = Some(todo);
                self.set_slot(lane, slot, SlotStage::Todo);
                self.settle();
                return Ok(());
            }
            Standing::WouldRun { lost, gone } => {
                self.never_run |= !lost;
                self.needs_again(lane, slot, &gone);
                Ended::WouldRun
            }
            Standing::Failed(message) => {
                self.account.fail(lane, item.as_ref(), message);
                Ended::Failed
            }
            Standing::Fatal(error) => return Err(error.into()),
        };
        if let Some(key) = found.key {
            self.account.key(lane, item, ended, key);
        }
        self.set_slot(lane, slot, SlotStage::Ended(ended));
        self.settle();
        Ok(())
    }

    /// Takes note of an action that was executed, or was not.
    ///
    /// # Errors
    /// If the store failed meanwhile, or the executor.
    pub fn executed(&mut self, reply: Reply) -> Result<(), EngineError> {
        self.in_flight -= 1;
        let (lane, slot) = reply.slot;
        let execution = reply.execution;
        if let Some(message) = execution.warning {
            self.account.warn(message);
        }
        let item = self.states[lane].slots[slot].key.clone();
        let stage = match execution.outcome {
            Outcome::Hit(made) => {
                self.states[lane].slots[slot].made = made;
                SlotStage::Ended(self.account.hit(lane, item.as_ref()))
            }
            Outcome::Ran(made) => {
                self.account.ran(lane, item.as_ref(), execution.spent_us, &made);
                self.states[lane].pace.note(execution.spent_us, made.put);
                self.states[lane].slots[slot].made = made;
                SlotStage::Ended(Ended::Ran)
            }
            Outcome::Failed(message) => {
                self.account.fail(lane, item.as_ref(), message);
                SlotStage::Ended(Ended::Failed)
            }
            Outcome::Missing(blobs) => match blobs.first().filter(|first| self.wanted.contains(first)) {
                Some(first) => {
                    self.account.fail(lane, item.as_ref(), lost(first));
                    SlotStage::Ended(Ended::Failed)
                }
                None => {
                    self.missing.extend(blobs);
                    SlotStage::Stalled
                }
            },
            Outcome::Cancelled => SlotStage::Stalled,
            Outcome::Fatal(error) => return Err(error),
        };
        self.set_slot(lane, slot, stage);
        self.settle();
        Ok(())
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
