//! The executor of one process: a pool of threads.

use super::{Batch, Capacity, Executor, Order, Replies, Reply, budget::Budget};
use crate::engine::{
    EngineError, Sink,
    event::{Event, Name},
    execute::{Execution, Outcome, execute},
    holdings::Holdings,
    probe::Asking,
    request::LaneName,
    transient::Pool,
};
use serde_json::Value;
use std::{
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread::Scope,
};
use tauflow_cache::Store;
use tauflow_contract::{Group, NodeKind, Progress};

/// The parts of a run that every executor on this machine needs.
pub struct Site<'a> {
    /// The machine on which times are measured, if it is not this one.
    pub machine: Option<Value>,
    /// The store.
    pub store: &'a Store,
    /// Blobs that are in memory only.
    pub pool: Arc<Pool>,
    /// Set when actions should stop.
    pub stop: &'a AtomicBool,
    /// Begin nothing more once an action has failed.
    pub fail_fast: bool,
    /// Actions at a time.
    pub workers: usize,
    /// Bytes that actions in flight, and the pool, are to hold.
    pub memory: u64,
    /// Told what begins and how far it is.
    pub sink: Sink<'a>,
    /// Told what ended.
    pub replies: Replies<'a>,
}

/// State that the threads of an executor share.
pub(super) struct Crew<'a> {
    pub of: Site<'a>,
    budget: Mutex<Budget>,
    /// Nothing is to begin any more, because something failed.
    halt: AtomicBool,
}

impl<'a> Crew<'a> {
    pub fn new(of: Site<'a>) -> Self {
        Self { budget: Mutex::new(Budget::new(of.workers, of.memory)), of, halt: AtomicBool::new(false) }
    }

    /// The same, where actions that measure have another machine to themselves.
    pub fn measuring_elsewhere(self) -> Self {
        let budget = Budget::new(self.of.workers, self.of.memory).measuring_elsewhere();
        Self { budget: Mutex::new(budget), ..self }
    }

    fn budget(&self) -> std::sync::MutexGuard<'_, Budget> {
        self.budget.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn capacity(&self) -> Capacity {
        self.budget().capacity(self.of.pool.bytes())
    }

    pub fn begin(&self, batch: &Batch) {
        self.budget().begin(batch);
    }

    pub fn settle(&self, reply: &Reply) {
        self.budget().end(reply.slot, reply.last);
    }

    /// Whether nothing is to begin any more.
    pub fn halts(&self) -> bool {
        self.halt.load(Ordering::Relaxed) || self.of.stop.load(Ordering::Relaxed)
    }

    /// Replies to an order; `last` says whether it was the last of its batch.
    pub fn reply(&self, order: &Order, execution: Execution, last: bool) {
        if self.of.fail_fast && matches!(execution.outcome, Outcome::Failed(_)) {
            self.halt.store(true, Ordering::Relaxed);
        }
        (self.of.replies)(Reply { slot: order.slot, execution, last });
    }

    /// Tells that an order begins; gives what tells how far it is.
    pub fn announce<'b>(&'b self, label: &'b LaneName, order: &Order) -> Reporter<'b> {
        let reporter = self.reporter(label, order);
        let (node, cell, item) = (label.node.clone(), label.cell.clone(), reporter.item.clone());
        (self.of.sink)(&Event::Begin { node, cell, item });
        reporter
    }

    /// Tells how far an order is that has begun.
    pub fn reporter<'b>(&'b self, label: &'b LaneName, order: &Order) -> Reporter<'b> {
        let item = order.action.item.as_ref().map_or_else(Name::default, Name::from);
        Reporter { label, item, sink: self.of.sink }
    }

    pub fn environment(&self, kind: &dyn NodeKind, params: &Value, group: Group) -> Result<Option<Value>, EngineError> {
        Asking::new(self.of.store, true).measuring(self.of.machine.as_ref()).environment(kind, params, group)
    }

    pub fn cancel(&self) {
        self.halt.store(true, Ordering::Relaxed);
        self.of.stop.store(true, Ordering::Relaxed);
    }
}

/// Passes progress of an action on, with its name.
pub(super) struct Reporter<'a> {
    label: &'a LaneName,
    item: Name,
    sink: Sink<'a>,
}

impl Progress for Reporter<'_> {
    fn report(&self, done: u64, total: u64, message: &str) {
        let (node, cell, item) = (self.label.node.clone(), self.label.cell.clone(), self.item.clone());
        (self.sink)(&Event::Progress { node, cell, item, done, total, message: message.to_owned() });
    }
}

/// Starts threads that take batches one by one until the queue's other end is gone.
pub(super) fn spawn<'scope, 'a: 'scope>(
    scope: &'scope Scope<'scope, '_>,
    crew: &Arc<Crew<'a>>,
    work: impl Fn(&Crew<'a>, Batch) + Copy + Send + 'scope,
) -> mpsc::Sender<Batch> {
    let (queue, queued) = mpsc::channel::<Batch>();
    let queued = Arc::new(Mutex::new(queued));
    for _ in 0..crew.of.workers {
        let (crew, queued) = (crew.clone(), queued.clone());
        scope.spawn(move || {
            let next = || queued.lock().unwrap_or_else(PoisonError::into_inner).recv();
            while let Ok(batch) = next() {
                work(&crew, batch);
            }
        });
    }
    queue
}

/// See the module.
pub struct Threads<'a> {
    crew: Arc<Crew<'a>>,
    queue: mpsc::Sender<Batch>,
}

impl<'a> Threads<'a> {
    /// Starts the threads, which end when this is dropped.
    pub fn start<'scope>(scope: &'scope Scope<'scope, '_>, of: Site<'a>) -> Self
    where
        'a: 'scope,
    {
        let crew = Arc::new(Crew::new(of));
        let queue = spawn(scope, &crew, run);
        Self { crew, queue }
    }
}

/// Runs the actions of a batch.
pub(super) fn run(crew: &Crew<'_>, batch: Batch) {
    let mut left = batch.orders.len();
    for order in batch.orders {
        left -= 1;
        if crew.halts() {
            crew.reply(&order, Execution::of(Outcome::Cancelled), left == 0);
            continue;
        }
        let Site { store, pool, stop, .. } = &crew.of;
        let reporter = crew.announce(&batch.label, &order);
        let holdings = Holdings { store, pool: Some(pool), wanted: &batch.wanted };
        let execution = execute(&order.action, holdings, stop, &reporter);
        crew.reply(&order, execution, left == 0);
    }
}

impl Executor for Threads<'_> {
    fn environment(&self, kind: &dyn NodeKind, params: &Value, group: Group) -> Result<Option<Value>, EngineError> {
        self.crew.environment(kind, params, group)
    }

    fn capacity(&self) -> Capacity {
        self.crew.capacity()
    }

    fn submit(&self, batch: Batch) {
        self.crew.begin(&batch);
        // The threads live as long as this does.
        let _ = self.queue.send(batch);
    }

    fn settle(&self, reply: &Reply) {
        self.crew.settle(reply);
    }

    fn cancel(&self) {
        self.crew.cancel();
    }
}
