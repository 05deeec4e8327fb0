//! One run: passes over the lanes, and the worker threads that execute actions.

use super::{
    EngineError, RunOptions, Sink, Summary,
    action::panicked,
    conclude::ResultOf,
    event::{Event, Failure, Name, NodeStat, OutputOf, Slow},
    explain,
    ids::{LaneId, SlotId},
    job::{Bundle, Job, Outcome, Reply},
    lanes::{self, Lanes},
    probe::Asking,
    records, rollup,
    scheduler::{Ran, SLOWEST, Scheduler},
    transient::{self, Pool},
    work::Bench,
};
use crate::pipeline::{Pipeline, Target};
use std::{
    collections::HashSet,
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread,
};
use tauflow_cache::{Digest, Store};
use tauflow_contract::Progress;

/// See the module.
pub(super) struct Run<'a> {
    pub(super) pipeline: &'a Pipeline,
    pub(super) store: &'a Store,
    pub(super) options: &'a RunOptions,
    stop: &'a AtomicBool,
    sink: Sink<'a>,
    lanes: Lanes,
    memory: u64,
    pool: Arc<Pool>,
    /// Keep the keys of all actions that are looked at.
    pub keep_keys: bool,
    /// Keep the collections that are asked for.
    pub keep_results: bool,
    pub planned: Vec<explain::Planned>,
    pub results: Vec<ResultOf>,
    /// In a dry run: an action that never was done would run.
    pub never_run: bool,
}

impl<'a> Run<'a> {
    pub fn new(
        pipeline: &'a Pipeline,
        store: &'a Store,
        options: &'a RunOptions,
        stop: &'a AtomicBool,
        sink: Sink<'a>,
    ) -> Result<Self, EngineError> {
        let mut targets = pipeline.targets.clone();
        if let Some(only) = &options.only {
            targets = vec![Target { node: only.node, port: None }];
        }
        let lanes = lanes::demand(pipeline, &targets, options.only.as_ref(), &Asking::new(store, !options.dry))?;
        let memory = options.memory.unwrap_or_else(transient::default_memory);
        Ok(Self {
            pipeline,
            store,
            options,
            stop,
            sink,
            lanes,
            memory,
            pool: Arc::new(Pool::new(memory / 2)),
            keep_keys: false,
            keep_results: false,
            planned: Vec::new(),
            results: Vec::new(),
            never_run: false,
        })
    }

    pub fn finish(&mut self) -> Result<Summary, EngineError> {
        if !self.options.dry {
            self.store.set_time(records::now())?;
        }
        let mut needed: Vec<usize> = self.lanes.iter().map(|l| l.node).collect();
        needed.sort_unstable();
        needed.dedup();
        let nodes = needed.iter().map(|n| self.pipeline.nodes[*n].name.as_str().into()).collect();
        (self.sink)(&Event::Started { pipeline: self.pipeline.name.as_str().into(), nodes });
        let (mut wanted, mut ran) = (HashSet::new(), Ran::new());
        let mut summary = Summary::default();
        let mut spent = vec![(0.0, 0); self.pipeline.nodes.len()];
        // Ends: each pass but the last finds blobs missing that no pass before it did, and what it makes stays.
        loop {
            let pass = self.pass(&wanted, &ran)?;
            summary.failures = pass.failures;
            summary.nodes = pass.stats;
            for ((seconds, bytes), node) in spent.iter_mut().zip(&mut summary.nodes) {
                *seconds += node.spent_s;
                *bytes += node.written;
                (node.spent_s, node.written) = (*seconds, *bytes);
            }
            summary.slowest.extend(pass.slowest);
            summary.slowest.sort_by(|a, b| b.spent_s.total_cmp(&a.spent_s));
            summary.slowest.truncate(SLOWEST);
            summary.published = pass.published;
            summary.outputs = pass.outputs;
            let complete = summary.failures.is_empty() && self.options.only.is_none() && !self.options.dry;
            if complete && pass.missing.is_empty() && !self.stop.load(Ordering::Relaxed) {
                rollup::keep_pipeline(self.pipeline, self.store, pass.trees)?;
            }
            ran.extend(pass.ran);
            let before = wanted.len();
            wanted.extend(pass.missing);
            let stopped = self.stop.load(Ordering::Relaxed);
            summary.interrupted = stopped;
            if wanted.len() == before || stopped || self.options.dry {
                let halted = stopped || self.options.dry || (self.options.fail_fast && !summary.failures.is_empty());
                if !halted {
                    summary.failures.extend(pass.stuck);
                    summary.failures.extend(pass.lost);
                }
                break;
            }
            let nodes = summary.nodes.iter().filter(|n| n.lanes > 0).map(|n| n.node.as_str().into()).collect();
            (self.sink)(&Event::Healing { nodes });
        }
        self.store.flush()?;
        Ok(summary)
    }

    fn pass(&mut self, wanted: &HashSet<Digest>, ran_before: &Ran) -> Result<Pass, EngineError> {
        let options = self.options;
        let lanes = std::mem::take(&mut self.lanes);
        let pool = self.pool.clone();
        let bench = Bench {
            store: self.store,
            pool: &pool,
            stop: self.stop,
            dry: options.dry,
            keep_keys: self.keep_keys,
            recheck: options.recheck,
            wanted,
        };
        // Roll-ups would hide the items that a recheck or `--only` looks at. Where something is missing they hide what
        // else may be: item by item, a pass finds at once all that can be found.
        let roll = wanted.is_empty() && options.recheck == 0.0 && options.only.is_none() && !options.no_rollup;
        let known = if roll { rollup::find(self.pipeline, &lanes, &bench)? } else { rollup::Known::none(&lanes) };
        let mut scheduler = Scheduler::new(self.pipeline, &lanes, &bench, ran_before, roll, options, self.memory);
        scheduler.start(known);
        let worked = self.work(&lanes, &bench, &mut scheduler);
        let finished = worked.and_then(|()| self.conclude(&lanes, &scheduler)).map(|(published, missing)| {
            let (outputs, trees) = rollup::outputs(self.pipeline, &lanes, &scheduler);
            let (stuck, lost) = (scheduler.stuck(), scheduler.lost(&missing));
            self.never_run = scheduler.never_run();
            let mut finished = scheduler.finish();
            finished.missing.extend(missing.into_iter().map(|(_, digest)| digest));
            (published, finished, outputs, trees, (stuck, lost))
        });
        self.lanes = lanes;
        let (published, finished, outputs, trees, (stuck, lost)) = finished?;
        self.planned = explain::planned(self.pipeline, &self.lanes, finished.keys);
        Ok(Pass {
            stats: finished.stats,
            failures: finished.failures,
            missing: finished.missing,
            ran: finished.ran,
            slowest: finished.slowest,
            outputs,
            trees,
            stuck,
            lost,
            published,
        })
    }

    /// Does actions until none is left.
    fn work(&self, lanes: &Lanes, bench: &Bench<'_>, scheduler: &mut Scheduler<'_>) -> Result<(), EngineError> {
        let cores = thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let count = if self.options.jobs == 0 { cores } else { self.options.jobs };
        let (seek, sought) = mpsc::channel::<Bundle>();
        let (run, to_run) = mpsc::channel::<Bundle>();
        let (sought, to_run) = (Mutex::new(sought), Mutex::new(to_run));
        let halt = AtomicBool::new(false);
        let (reply, replies) = mpsc::channel::<Done>();
        let next = |queue: &Mutex<mpsc::Receiver<Bundle>>| queue.lock().unwrap_or_else(PoisonError::into_inner).recv();
        thread::scope(|scope| {
            // Threads of their own for look-ups, so that none waits for an action that takes hours.
            for _ in 0..count {
                let (reply, sought) = (reply.clone(), &sought);
                scope.spawn(move || {
                    while let Ok(bundle) = next(sought) {
                        if reply.send(Done::LookedUp(look_up(bench, bundle))).is_err() {
                            return;
                        }
                    }
                });
            }
            for _ in 0..count {
                let (reply, to_run, halt) = (reply.clone(), &to_run, &halt);
                scope.spawn(move || {
                    while let Ok(mut bundle) = next(to_run) {
                        let jobs = std::mem::take(&mut bundle.jobs);
                        let mut left = jobs.len();
                        for job in jobs {
                            left -= 1;
                            let done = self.perform(lanes, bench, &bundle, job, halt);
                            if reply.send(Done::Performed(Box::new(done), left == 0)).is_err() {
                                return;
                            }
                        }
                    }
                });
            }
            // If all threads are gone, waiting for them ends.
            drop(reply);
            let workers = Workers { count, seek: &seek, run: &run, replies: &replies };
            let result = self.steer(lanes, scheduler, &workers);
            if result.is_err() {
                // Nobody will look at what is still being done.
                self.stop.store(true, Ordering::Relaxed);
            }
            drop((seek, run));
            result
        })
    }

    /// Does an action, unless the run is being stopped, or nothing is to begin any more because one failed (`halt`).
    fn perform(&self, lanes: &Lanes, bench: &Bench<'_>, bundle: &Bundle, job: Job, halt: &AtomicBool) -> Reply {
        if halt.load(Ordering::Relaxed) || self.stop.load(Ordering::Relaxed) {
            return Reply::of((bundle.task.lane, job.slot), Outcome::Cancelled);
        }
        let lane = &lanes[bundle.task.lane];
        let reporter = Reporter {
            node: self.pipeline.nodes[lane.node].name.as_str().into(),
            cell: self.pipeline.cells[lane.cell].text.as_str().into(),
            item: job.item.as_ref().map_or_else(Name::default, Name::from),
            sink: self.sink,
        };
        let Reporter { node, cell, item, .. } = &reporter;
        (self.sink)(&Event::Begin { node: node.clone(), cell: cell.clone(), item: item.clone() });
        let reply = bench.perform(bundle, job, &reporter);
        if self.options.fail_fast && matches!(reply.outcome, Outcome::Failed(_)) {
            halt.store(true, Ordering::Relaxed);
        }
        reply
    }

    fn steer(&self, lanes: &Lanes, scheduler: &mut Scheduler<'_>, workers: &Workers<'_>) -> Result<(), EngineError> {
        let take = |scheduler: &mut Scheduler<'_>, done: Done| match done {
            Done::LookedUp(replies) => scheduler.looked_up(replies),
            Done::Performed(reply, last) => scheduler.performed(*reply, last),
        };
        loop {
            if let Some(error) = scheduler.take_fatal() {
                return Err(error.into());
            }
            if !self.options.dry {
                for complete in scheduler.take_complete_shards() {
                    rollup::keep_shard(self.pipeline, lanes, self.store, &complete)?;
                }
                for complete in scheduler.take_complete() {
                    rollup::keep(self.pipeline, lanes, self.store, scheduler, &complete)?;
                }
            }
            scheduler.take_events().iter().for_each(self.sink);
            let failed = self.options.fail_fast && !scheduler.failures().is_empty();
            if !failed && !self.stop.load(Ordering::Relaxed) {
                // Two bundles for each thread, so that none waits for the next.
                while scheduler.seeking() < 2 * workers.count
                    && let Some(bundle) = scheduler.next_look_up()
                {
                    // The workers live as long as this loop does.
                    let _ = workers.seek.send(bundle);
                }
                while let Some(bundle) = scheduler.next_run(workers.count) {
                    let _ = workers.run.send(bundle);
                }
            }
            if scheduler.running() + scheduler.seeking() == 0 {
                return Ok(());
            }
            let Ok(done) = workers.replies.recv() else { return Ok(()) };
            take(scheduler, done)?;
            workers.replies.try_iter().take(AT_ONCE).try_for_each(|done| take(scheduler, done))?;
        }
    }
}

/// Looks a bundle up; a panic is an answer, too.
fn look_up(bench: &Bench<'_>, bundle: Bundle) -> Vec<Reply> {
    let slots: Vec<(LaneId, SlotId)> = bundle.jobs.iter().map(|job| (bundle.task.lane, job.slot)).collect();
    catch_unwind(AssertUnwindSafe(|| bench.look_up(bundle))).unwrap_or_else(|panic| {
        let message = panicked(&panic);
        slots.into_iter().map(|slot| Reply::of(slot, Outcome::Failed(message.clone()))).collect()
    })
}

/// Replies that are taken before work is handed out again.
const AT_ONCE: usize = 256;

/// The threads that do actions, and the ways to them.
struct Workers<'a> {
    count: usize,
    seek: &'a mpsc::Sender<Bundle>,
    run: &'a mpsc::Sender<Bundle>,
    replies: &'a mpsc::Receiver<Done>,
}

/// The reply of a thread.
enum Done {
    LookedUp(Vec<Reply>),
    /// And whether that was the last of its bundle.
    Performed(Box<Reply>, bool),
}

struct Pass {
    stats: Vec<NodeStat>,
    failures: Vec<Failure>,
    missing: HashSet<Digest>,
    ran: Ran,
    slowest: Vec<Slow>,
    outputs: Vec<OutputOf>,
    trees: Vec<Digest>,
    /// Lanes that came to no end, which none may.
    stuck: Vec<Failure>,
    /// Lanes that are asked for, and miss blobs that were made again in vain.
    lost: Vec<Failure>,
    published: Vec<PathBuf>,
}

/// Passes progress of an action on, with its name.
struct Reporter<'a> {
    node: Name,
    cell: Name,
    item: Name,
    sink: Sink<'a>,
}

impl Progress for Reporter<'_> {
    fn report(&self, done: u64, total: u64, message: &str) {
        (self.sink)(&Event::Progress {
            node: self.node.clone(),
            cell: self.cell.clone(),
            item: self.item.clone(),
            done,
            total,
            message: message.to_owned(),
        });
    }
}
