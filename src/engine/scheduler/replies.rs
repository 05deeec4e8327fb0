//! Replies of the executor: what became of actions that ran.

use super::{Scheduler, lost, state::SlotStage};
use crate::engine::{EngineError, event::Ended, execute::Outcome, executor::Reply};

impl Scheduler<'_> {
    /// Takes note of an action that was executed, or was not.
    ///
    /// # Errors
    /// If the store failed meanwhile, or the executor.
    pub fn executed(&mut self, reply: Reply) -> Result<(), EngineError> {
        self.in_flight -= 1;
        let (lane, slot) = reply.slot;
        let execution = reply.execution;
        match &execution.outcome {
            // A remark on what was compared says that it differs.
            Outcome::Ran(_) => self.account.compared(reply.slot, execution.warning.is_none()),
            Outcome::Failed(_) => self.account.compared(reply.slot, false),
            _ => {}
        }
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
            Outcome::Elsewhere(shard) => {
                self.account.elsewhere(shard);
                SlotStage::Ended(Ended::Blocked)
            }
            Outcome::Cancelled => SlotStage::Stalled,
            Outcome::Fatal(error) => return Err(error),
        };
        self.set_slot(lane, slot, stage);
        self.settle();
        Ok(())
    }
}
