//! The scheduler over simulated workers and a simulated clock: how long a run would take on a cluster, with the times
//! of actions that a store has recorded.
//!
//! The scheduler, the graph and the replies are those of a run. Workers are simulated: a batch takes the latency of its
//! cluster and the recorded times of its actions. The clock also goes on while the scheduler itself computes, by the
//! time that this takes here; so it shows where the scheduler is what a run waits for. Answers of look-up threads take
//! no time on the clock.

use super::{
    EngineError, RunOptions,
    execute::{Execution, Outcome},
    executor::{Batch, Budget, Order, Reply},
    holdings::Holdings,
    lanes,
    look_up::Catalog,
    measured::Measured,
    probe::Asking,
    request,
    scheduler::{Ran, Scheduler},
};
use crate::pipeline::Pipeline;
use std::{
    cmp::Reverse,
    collections::{BinaryHeap, HashSet},
    sync::Arc,
    time::{Duration, Instant},
};
use tauflow_cache::{Beyond, Digest, Key, Record, Store};

/// Look-ups that are open at a time.
const LOOK_UPS: usize = 4;

/// A simulated cluster.
#[derive(Clone, Copy, Debug)]
pub struct Cluster {
    /// Actions at a time.
    pub workers: usize,
    /// Time from the moment when a batch is handed out until its first action begins.
    pub latency: Duration,
    /// The share of attempts in which a worker dies at half of an action.
    pub failures: f64,
    /// Time until the death of a worker is noticed.
    pub notice: Duration,
}

/// The outcome of a simulated run.
#[derive(Clone, Copy, Debug, Default)]
pub struct Simulated {
    /// Actions that ran, and attempts that failed.
    pub actions: u64,
    /// See `actions`.
    pub failed: u64,
    /// Seconds of all actions together.
    pub work_s: f64,
    /// Seconds of the run on the simulated clock.
    pub clock_s: f64,
    /// The part of it in which the scheduler computed.
    pub steering_s: f64,
}

/// A store of which only the blobs are seen: no action was done before.
#[derive(Debug)]
struct OnlyBlobs(Arc<Store>);

impl Beyond for OnlyBlobs {
    fn records(&self, _: &str, keys: &[Key]) -> Vec<Option<Record>> {
        vec![None; keys.len()]
    }

    fn contains(&self, digest: &Digest) -> bool {
        self.0.contains(digest)
    }

    fn blob(&self, digest: &Digest) -> Option<Vec<u8>> {
        self.0.get(digest).ok().flatten()
    }
}

/// A reply and its time, in nanoseconds.
struct Due(u64, u64, Reply);

impl PartialEq for Due {
    fn eq(&self, other: &Self) -> bool {
        (self.0, self.1) == (other.0, other.1)
    }
}

impl Eq for Due {}

impl PartialOrd for Due {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Due {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.0, self.1).cmp(&(other.0, other.1))
    }
}

/// Workers and the clock.
struct Workers<'a> {
    recorded: &'a Store,
    of: Cluster,
    /// The times at which workers are free.
    free: BinaryHeap<Reverse<u64>>,
    due: BinaryHeap<Reverse<Due>>,
    clock: u64,
    replies: u64,
    told: Simulated,
}

impl Workers<'_> {
    /// Whether an attempt fails: a function of the action and the attempt.
    fn fails(&self, order: &Order, attempt: u32) -> bool {
        let digest = Digest::of(format!("{} {attempt}", order.action.hash).as_bytes()).hash;
        let draw = u32::from_le_bytes([digest[0], digest[1], digest[2], digest[3]]);
        f64::from(draw) < self.of.failures * f64::from(u32::MAX)
    }

    fn take(&mut self, batch: Batch) -> Result<(), EngineError> {
        let nanos = |duration: Duration| duration.as_nanos() as u64;
        let Reverse(free) = self.free.pop().unwrap_or(Reverse(0)); // there are as many as workers
        let mut at = free.max(self.clock) + nanos(self.of.latency);
        let count = batch.orders.len();
        for (n, order) in batch.orders.into_iter().enumerate() {
            let holdings = Holdings::stored(self.recorded, &batch.wanted);
            let record = order.action.recorded(self.recorded)?;
            let made = holdings.made(record.as_deref(), &order.action.producer)?;
            let Some(made) = made else {
                return Err(EngineError::Request(format!(
                    "the store has no record of action {} of `{}`; run the pipeline first",
                    order.action.hash.short(),
                    batch.label.node
                )));
            };
            let takes = nanos(Duration::from_micros(made.wall_us));
            let mut attempt = 0;
            while self.fails(&order, attempt) && attempt < 20 {
                at += takes / 2 + nanos(self.of.notice) + nanos(self.of.latency);
                attempt += 1;
            }
            at += takes;
            self.told.actions += 1;
            self.told.failed += u64::from(attempt);
            self.told.work_s += takes as f64 / 1e9;
            let execution =
                Execution { outcome: Outcome::Ran(made), recorded: None, warning: None, spent_us: takes / 1000 };
            let reply = Reply { slot: order.slot, execution, last: n + 1 == count };
            self.replies += 1;
            self.due.push(Reverse(Due(at, self.replies, reply)));
        }
        self.free.push(Reverse(at));
        Ok(())
    }
}

/// Runs a pipeline on a simulated cluster. `recorded` has the results of a run of it; `empty` is a new store.
///
/// # Errors
/// If a store fails, or an action is not recorded.
pub fn simulate(
    pipeline: &Pipeline,
    recorded: &Arc<Store>,
    mut empty: Store,
    of: Cluster,
) -> Result<Simulated, EngineError> {
    empty.look_beyond(Arc::new(OnlyBlobs(recorded.clone())));
    let (wanted, ran, options) = (Arc::new(HashSet::new()), Ran::new(), RunOptions::default());
    let measured = Measured::last(recorded, pipeline);
    let machine = measured.machine.as_ref();
    let environment: lanes::Environment<'_> =
        &|kind, params, group| Asking::new(recorded, false).measuring(machine).environment(kind, params, group);
    let lanes = lanes::demand(pipeline, &pipeline.targets, None, environment)?;
    let holdings = Holdings::stored(&empty, &wanted);
    let catalog = Catalog { holdings, dry: false, keep_keys: false, recheck: 0.0, audit: 0.0, salt: 0 };
    let tasks = request::tasks(pipeline, &lanes, &measured);
    let mut scheduler = Scheduler::new(pipeline, &lanes, tasks, wanted.clone(), &ran, true, &options);
    let mut budget = Budget::new(of.workers, u64::MAX);
    let mut workers = Workers {
        recorded,
        of,
        free: (0..of.workers).map(|_| Reverse(0)).collect(),
        due: BinaryHeap::new(),
        clock: 0,
        replies: 0,
        told: Simulated::default(),
    };
    let mut computed = Duration::ZERO;
    // What the scheduler does goes on the clock; what others do for it does not.
    macro_rules! steer {
        ($what:expr) => {{
            let begun = Instant::now();
            let done = $what;
            let took = begun.elapsed();
            computed += took;
            workers.clock += took.as_nanos() as u64;
            done
        }};
    }
    steer!(scheduler.start());
    loop {
        let mut answers = Vec::new();
        while let Some(request) = steer!(scheduler.next_keep()) {
            answers.push(catalog.answer(request));
        }
        while scheduler.seeking() < LOOK_UPS
            && let Some(request) = steer!(scheduler.next_request())
        {
            answers.push(catalog.answer(request));
        }
        while let Some(batch) = steer!(scheduler.next_run(budget.capacity(0))) {
            budget.begin(&batch);
            workers.take(batch)?;
        }
        drop(scheduler.take_events());
        let asked = !answers.is_empty();
        for answer in answers {
            steer!(scheduler.answered(answer))?;
        }
        if asked {
            continue;
        }
        let Some(Reverse(Due(at, _, reply))) = workers.due.pop() else { break };
        workers.clock = workers.clock.max(at);
        budget.end(reply.slot, reply.last);
        steer!(scheduler.executed(reply))?;
    }
    if let Some(failure) = scheduler.failures().first() {
        return Err(EngineError::Request(failure.message.clone()));
    }
    let told = workers.told;
    Ok(Simulated { clock_s: workers.clock as f64 / 1e9, steering_s: computed.as_secs_f64(), ..told })
}
