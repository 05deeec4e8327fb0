//! A share of a run: actions of other shares are done by other runs on the same store, and waited for here, or not.
//!
//! An item belongs to the same share in all nodes, and an action without an item to the share of its key. Actions whose
//! keys name a machine, a library or a device belong to every share, and so does what reads outputs that may
//! differ there: other machines may have other keys. An action whose record is there, but whose blobs are not, belongs
//! to who needs them.

mod failures;

use super::{Batch, Capacity, Executor, Order, Reply};
use crate::engine::{
    EngineError,
    event::Event,
    execute::{Execution, Outcome},
    holdings::Holdings,
    ids::{LaneId, SlotId},
    transient::Pool,
};
use failures::{Failed, Failures};
use serde_json::Value;
use std::{
    collections::{BTreeMap, HashMap, HashSet},
    str::FromStr,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::{self, RecvTimeoutError},
    },
    thread::Scope,
    time::{Duration, Instant},
};
use tauflow_cache::{Digest, Key, Store};
use tauflow_contract::{Group, NodeKind};

/// Time between two looks for what other runs have recorded.
const LOOK: Duration = Duration::from_millis(500);
/// Time between two looks for what failed in other runs.
const LOOK_FOR_FAILURES: Duration = Duration::from_secs(5);
/// Time between two notes that the run waits.
const NOTE: Duration = Duration::from_secs(60);

/// Share number `index` of `count`, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Share {
    index: u32,
    count: u32,
    /// Wait for other shares.
    wait: bool,
}

impl FromStr for Share {
    type Err = String;

    /// Reads `I/N`, where I counts from 1.
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is no share; give I/N with I from 1 to N, such as 2/4");
        let (index, count) = text.split_once('/').ok_or_else(wrong)?;
        let (index, count): (u32, u32) = (index.parse().map_err(|_| wrong())?, count.parse().map_err(|_| wrong())?);
        if index < 1 || index > count {
            return Err(wrong());
        }
        Ok(Self { index: index - 1, count, wait: false })
    }
}

impl Share {
    /// The same, waiting for other shares or not.
    pub fn waiting(self, wait: bool) -> Self {
        Self { wait, ..self }
    }

    /// Its number, from 1, and how many there are, such as `2/4`.
    fn label(self) -> String {
        format!("{}/{}", self.index + 1, self.count)
    }

    /// How many shares there are.
    pub fn count(self) -> u32 {
        self.count
    }

    /// The number, from 0, of the share that an action belongs to; none if it belongs to all.
    fn of(self, order: &Order) -> Option<u32> {
        let action = &order.action;
        if action.producer.bound {
            return None;
        }
        let bytes = match &action.item {
            Some(item) => Digest::of(item.as_str().as_bytes()).hash,
            None => Digest::of(action.hash.hex().as_bytes()).hash,
        };
        let start = [bytes[0], bytes[1], bytes[2], bytes[3]];
        Some(u32::from_le_bytes(start) % self.count)
    }
}

/// An action that another run is to do.
struct Awaited {
    order: Order,
    wanted: Arc<HashSet<Digest>>,
}

/// See the module.
pub struct Shared<'a> {
    inner: Box<dyn Executor + 'a>,
    share: Share,
    elsewhere: mpsc::Sender<Awaited>,
    /// The actions that the inner executor does not know.
    foreign: Mutex<HashSet<(LaneId, SlotId)>>,
    /// The keys of those that it does.
    own: Mutex<HashMap<(LaneId, SlotId), Key>>,
    failures: Arc<Failures>,
    store: &'a Store,
    /// Nothing begins any more once an action fails.
    fail_fast: bool,
    /// Whether one has.
    halted: Arc<AtomicBool>,
    sink: crate::engine::Sink<'a>,
}

/// What the thread that waits needs.
pub struct Waiting<'a> {
    /// The store.
    pub store: &'a Store,
    /// Blobs that are in memory only.
    pub pool: Arc<Pool>,
    /// Set when the run should stop.
    pub stop: &'a AtomicBool,
    /// Nothing begins any more once an action fails.
    pub fail_fast: bool,
    /// Told how many actions are waited for.
    pub sink: crate::engine::Sink<'a>,
    /// Told what was done.
    pub replies: super::Replies<'a>,
}

impl<'a> Shared<'a> {
    /// Has `inner` run what belongs to this share.
    pub fn start<'scope>(
        scope: &'scope Scope<'scope, '_>,
        share: Share,
        inner: Box<dyn Executor + 'a>,
        of: Waiting<'a>,
    ) -> Self
    where
        'a: 'scope,
    {
        let (elsewhere, awaited) = mpsc::channel();
        let failures = Arc::new(Failures::from_now(of.store, &share.label()));
        let (seen, store, fail_fast, sink) = (failures.clone(), of.store, of.fail_fast, of.sink);
        let halted = Arc::<AtomicBool>::default();
        let halts = halted.clone();
        scope.spawn(move || wait(share, &of, (&seen, &halts), &awaited));
        Self {
            inner,
            share,
            elsewhere,
            foreign: Mutex::default(),
            own: Mutex::default(),
            failures,
            store,
            fail_fast,
            halted,
            sink,
        }
    }

    fn own(&self) -> std::sync::MutexGuard<'_, HashMap<(LaneId, SlotId), Key>> {
        self.own.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn foreign(&self) -> std::sync::MutexGuard<'_, HashSet<(LaneId, SlotId)>> {
        self.foreign.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Replies to actions of other shares, as soon as they are recorded.
fn wait(
    share: Share,
    of: &Waiting<'_>,
    (failures, halted): (&Failures, &AtomicBool),
    orders: &mpsc::Receiver<Awaited>,
) {
    let mut open: Vec<Awaited> = Vec::new();
    let (mut noted, mut looked) = (Instant::now(), Instant::now());
    loop {
        let pause = if open.is_empty() { NOTE } else { LOOK };
        match orders.recv_timeout(pause) {
            Ok(order) => {
                open.push(order);
                open.extend(orders.try_iter());
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        let refreshed = of.store.refresh();
        // The shard that is waited for may wait for this one.
        let stopped = of.stop.load(Ordering::Relaxed) || halted.load(Ordering::Relaxed);
        let failed = if share.wait && !open.is_empty() && looked.elapsed() >= LOOK_FOR_FAILURES {
            looked = Instant::now();
            failures.now()
        } else {
            HashMap::new()
        };
        let mut left = Vec::new();
        for awaited in open {
            let Awaited { order, wanted } = &awaited;
            let holdings = Holdings { store: of.store, pool: Some(&of.pool), wanted };
            let done = order.action.recorded(of.store);
            let done = done.and_then(|record| holdings.made(record.as_deref(), &order.action.producer));
            let outcome = match (&refreshed, done) {
                (Ok(()), Ok(Some(made))) => Outcome::Hit(made),
                (Ok(()), Ok(None)) if stopped => Outcome::Cancelled,
                (Ok(()), Ok(None)) if failed.contains_key(&order.action.hash.hex()) => {
                    // A note that is gone again is of an action that is tried again.
                    let Some(Failed { shard, message }) = failures.read(&order.action.hash) else {
                        left.push(awaited);
                        continue;
                    };
                    Outcome::Failed(format!("shard {shard} failed on it: {message}"))
                }
                (Ok(()), Ok(None)) if share.wait => {
                    left.push(awaited);
                    continue;
                }
                (Ok(()), Ok(None)) => Outcome::Elsewhere(share.of(order).map_or(0, |index| index + 1)),
                (Ok(()), Err(error)) => Outcome::Fatal(error.into()),
                (Err(error), _) => Outcome::Fatal(EngineError::Executor(error.to_string())),
            };
            let (slot, execution) = (order.slot, Execution::of(outcome));
            (of.replies)(Reply { slot, execution, last: true });
        }
        open = left;
        if !open.is_empty() && noted.elapsed() >= NOTE {
            noted = Instant::now();
            let message = waiting(share, &open);
            (of.sink)(&Event::Warning { message });
        }
    }
}

/// The message that this run waits, with the number of actions of each other shard.
fn waiting(share: Share, open: &[Awaited]) -> String {
    let mut shards: BTreeMap<u32, usize> = BTreeMap::new();
    for Awaited { order, .. } in open {
        *shards.entry(share.of(order).map_or(0, |index| index + 1)).or_default() += 1;
    }
    let of: Vec<String> =
        shards.iter().map(|(shard, actions)| format!("{actions} of shard {shard}/{}", share.count)).collect();
    let first = open.first().map(|Awaited { order, .. }| {
        let item = order.action.item.as_ref().map_or_else(String::new, |item| format!(" {}", item.as_str()));
        format!(", such as `{}`{item}", order.action.producer.spec.name)
    });
    format!("waiting for actions of other shards: {}{}", of.join(", "), first.unwrap_or_default())
}

impl Executor for Shared<'_> {
    fn environment(&self, kind: &dyn NodeKind, params: &Value, group: Group) -> Result<Option<Value>, EngineError> {
        self.inner.environment(kind, params, group)
    }

    fn capacity(&self) -> Capacity {
        self.inner.capacity()
    }

    fn submit(&self, batch: Batch) {
        let Batch { label, alone, wanted, orders } = batch;
        // An action runs here again if its record is there, but a blob of it is missing that this run needs. Its share
        // has done it, and may have had the blob in memory alone, or have ended.
        let lost = |order: &Order| !wanted.is_empty() && order.action.recorded(self.store).is_ok_and(|of| of.is_some());
        let here = |order: &Order| self.share.of(order).is_none_or(|index| index == self.share.index) || lost(order);
        let (own, others): (Vec<Order>, Vec<Order>) = orders.into_iter().partition(here);
        self.foreign().extend(others.iter().map(|order| order.slot));
        for order in others {
            // The thread lives as long as this does.
            let _ = self.elsewhere.send(Awaited { order, wanted: wanted.clone() });
        }
        for order in &own {
            self.failures.forget(&order.action.hash);
            self.own().insert(order.slot, order.action.hash);
        }
        if !own.is_empty() {
            self.inner.submit(Batch { label, alone, wanted, orders: own });
        }
    }

    fn settle(&self, reply: &Reply) {
        if self.fail_fast && matches!(reply.execution.outcome, Outcome::Failed(_)) {
            self.halted.store(true, Ordering::Relaxed);
        }
        if self.foreign().remove(&reply.slot) {
            return;
        }
        if let (Some(key), Outcome::Failed(message)) = (self.own().remove(&reply.slot), &reply.execution.outcome) {
            let failed = Failed { shard: self.share.label(), message: message.clone() };
            if let Err(error) = self.failures.note(&key, &failed) {
                let message =
                    format!("other shards wait for an action that failed here, as they cannot be told: {error}");
                (self.sink)(&Event::Warning { message });
            }
        }
        self.inner.settle(reply);
    }

    fn cancel(&self) {
        self.inner.cancel();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_is_one_of_so_many() {
        assert_eq!("2/4".parse(), Ok(Share { index: 1, count: 4, wait: false }));
        for wrong in ["", "2", "0/4", "5/4", "1/0", "a/b", "-1/2"] {
            assert!(wrong.parse::<Share>().is_err(), "{wrong}");
        }
    }
}
