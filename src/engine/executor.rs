//! Executors: what runs the actions that a scheduler hands out.
//!
//! An executor decides where actions run and how many at a time. So it says what of a machine enters their keys, it has
//! the memory budget, and it keeps what measures alone. Whoever executes an action holds its claim. An executor knows
//! nothing of what is ready, or of what comes next.

mod budget;
mod jobs;
mod processes;
mod shard;
mod threads;

pub use budget::{Budget, Capacity};
pub use jobs::{Apart, JobOption, JobOptions, Jobs, Place, Scheduling, measuring_place};
pub use processes::{ChildCommand, Processes};
pub use shard::{Share, Shared, Waiting};
pub use threads::{Site, Threads};

use super::{
    EngineError,
    execute::{Execution, PreparedAction},
    ids::{LaneId, SlotId},
    request::LaneName,
};
use serde_json::Value;
use std::{collections::HashSet, sync::Arc};
use tauflow_contract::{Digest, Group, NodeKind};

/// Runs actions. [`Reply`]s come one by one, as actions end, on the channel that an executor was made with: exactly one
/// for each action that was submitted.
pub trait Executor {
    /// What of the machine on which actions run enters the keys of a kind's group; see
    /// [`Kind::environment`](tauflow_contract::Kind::environment).
    ///
    /// # Errors
    /// If an answer cannot be kept.
    fn environment(&self, kind: &dyn NodeKind, params: &Value, group: Group) -> Result<Option<Value>, EngineError>;

    /// The work that it accepts now.
    fn capacity(&self) -> Capacity;

    /// Takes actions on, which run in this order.
    fn submit(&self, batch: Batch);

    /// Takes note that a reply was read. Until then its action counts in [`Executor::capacity`], so that nothing is
    /// handed out before it is known what the action made possible.
    fn settle(&self, reply: &Reply);

    /// Begins nothing more, and asks what is running to stop. Whatever does not run to its end is replied to as
    /// cancelled.
    fn cancel(&self);
}

/// Actions of one lane that are executed one after the other.
pub struct Batch {
    /// The lane's name, for events.
    pub label: LaneName,
    /// They have the machine to themselves.
    pub alone: bool,
    /// Blobs that were found missing in this run.
    pub wanted: Arc<HashSet<Digest>>,
    /// The actions.
    pub orders: Vec<Order>,
}

/// An action that an executor is to run.
pub struct Order {
    /// Its lane and slot.
    pub slot: (LaneId, SlotId),
    /// Bytes of memory that it is expected to hold.
    pub bytes: u64,
    /// The action.
    pub action: PreparedAction,
}

/// The reply to an [`Order`].
pub struct Reply {
    /// Its lane and slot.
    pub slot: (LaneId, SlotId),
    /// The outcome.
    pub execution: Execution,
    /// It was the last of its batch.
    pub last: bool,
}

/// Where replies go.
pub type Replies<'a> = Box<dyn Fn(Reply) + Send + Sync + 'a>;
