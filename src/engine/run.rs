//! One run: passes over the lanes, worker threads that do the actions, and what is left at the end.

use super::{
    EngineError, RunOptions, Sink, Summary,
    event::{Event, Failure, NodeStat},
    explain,
    lanes::{self, Lane},
    publish,
    records::{self, Whole},
    rollup,
    scheduler::Scheduler,
    work::{Bench, Job, Outcome, Reply},
};
use crate::pipeline::{Pipeline, Target};
use std::{
    collections::HashSet,
    path::PathBuf,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread,
    time::Instant,
};
use tauflow_cache::{Digest, Store};
use tauflow_contract::{ItemKey, Progress};

/// Passes after which a run gives up making missing blobs again: each pass goes at least one stage further.
const MAX_PASSES: usize = 64;

/// A port's collection at the end of a run.
pub(super) struct ResultOf {
    pub cell: usize,
    pub port: usize,
    pub whole: Arc<Whole>,
}

/// See the module.
pub(super) struct Run<'a> {
    pipeline: &'a Pipeline,
    store: &'a Store,
    options: &'a RunOptions,
    stop: &'a AtomicBool,
    sink: Sink<'a>,
    lanes: Vec<Lane>,
    /// Keep the keys of all actions that are looked at.
    pub keep_keys: bool,
    /// Keep the collections that are asked for.
    pub keep_results: bool,
    pub planned: Vec<explain::Planned>,
    pub results: Vec<ResultOf>,
}

impl<'a> Run<'a> {
    pub fn new(
        pipeline: &'a Pipeline,
        store: &'a Store,
        options: &'a RunOptions,
        stop: &'a AtomicBool,
        sink: Sink<'a>,
    ) -> Self {
        let mut targets = pipeline.targets.clone();
        if let Some(only) = &options.only {
            targets = vec![Target { node: only.node, port: None }];
        }
        let lanes = lanes::demand(pipeline, &targets, options.only.as_ref());
        let (planned, results) = (Vec::new(), Vec::new());
        Self { pipeline, store, options, stop, sink, lanes, keep_keys: false, keep_results: false, planned, results }
    }

    pub fn finish(&mut self) -> Result<Summary, EngineError> {
        if !self.options.dry {
            self.store.set_time(records::now())?;
        }
        let mut needed: Vec<usize> = self.lanes.iter().map(|l| l.node).collect();
        needed.sort_unstable();
        needed.dedup();
        let nodes = needed.iter().map(|n| self.pipeline.nodes[*n].name.clone()).collect();
        (self.sink)(&Event::Started { pipeline: self.pipeline.name.clone(), nodes });
        let (mut wanted, mut ran) = (HashSet::new(), HashSet::new());
        let mut summary = Summary::default();
        let mut spent = vec![0.0; self.pipeline.nodes.len()];
        for _ in 0..MAX_PASSES {
            let pass = self.pass(&wanted, &ran)?;
            summary.failures = pass.failures;
            summary.nodes = pass.stats;
            for (total, node) in spent.iter_mut().zip(&mut summary.nodes) {
                *total += node.spent_s;
                node.spent_s = *total;
            }
            summary.published = pass.published;
            ran.extend(pass.ran);
            let before = wanted.len();
            wanted.extend(pass.missing);
            let stopped = self.stop.load(Ordering::Relaxed);
            summary.interrupted = stopped;
            if wanted.len() == before || stopped || self.options.dry {
                break;
            }
            let nodes = summary.nodes.iter().filter(|n| n.lanes > 0).map(|n| n.node.clone()).collect();
            (self.sink)(&Event::Healing { nodes });
        }
        self.store.flush()?;
        Ok(summary)
    }

    fn pass(
        &mut self,
        wanted: &HashSet<Digest>,
        ran_before: &HashSet<(usize, Option<ItemKey>)>,
    ) -> Result<Pass, EngineError> {
        let options = self.options;
        let lanes = std::mem::take(&mut self.lanes);
        let bench = Bench { store: self.store, stop: self.stop, dry: options.dry, recheck: options.recheck, wanted };
        // Roll-ups would hide the items that a recheck or `--only` looks at, and the keys that a plan explains.
        let known = if options.recheck > 0.0 || options.only.is_some() || options.no_rollup {
            rollup::Known {
                rolled: lanes.iter().map(|_| None).collect(),
                totals: vec![(0, 0); lanes.len()],
                ..rollup::Known::default()
            }
        } else {
            rollup::find(self.pipeline, &lanes, self.store, |refs| bench.whole(refs))?
        };
        let mut scheduler = Scheduler::new(self.pipeline, &lanes, known.rolled, wanted, ran_before, self.keep_keys);
        scheduler.start(known.loaded, &known.totals);
        let worked = self.work(&lanes, &bench, &mut scheduler);
        let finished = worked.and_then(|()| self.conclude(&lanes, &scheduler)).map(|(published, missing)| {
            let mut finished = scheduler.finish();
            finished.missing.extend(missing);
            (published, finished)
        });
        self.lanes = lanes;
        let (published, finished) = finished?;
        self.planned = explain::planned(self.pipeline, &self.lanes, finished.keys);
        Ok(Pass {
            stats: finished.stats,
            failures: finished.failures,
            missing: finished.missing,
            ran: finished.ran,
            published,
        })
    }

    /// Does actions until none is left.
    fn work(&self, lanes: &[Lane], bench: &Bench<'_>, scheduler: &mut Scheduler<'_>) -> Result<(), EngineError> {
        let cores = thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let jobs = if self.options.jobs == 0 { cores } else { self.options.jobs };
        let (job_sender, job_receiver) = mpsc::channel::<Job>();
        let job_receiver = Mutex::new(job_receiver);
        let (reply_sender, reply_receiver) = mpsc::channel::<(Reply, u64)>();
        thread::scope(|scope| {
            for _ in 0..jobs {
                let reply_sender = reply_sender.clone();
                let job_receiver = &job_receiver;
                scope.spawn(move || {
                    loop {
                        let job = job_receiver.lock().unwrap_or_else(PoisonError::into_inner).recv();
                        let Ok(job) = job else { return };
                        let (start, reporter) = (Instant::now(), self.reporter(lanes, &job));
                        let reply = bench.perform(&job, &reporter);
                        if reply_sender.send((reply, start.elapsed().as_micros() as u64)).is_err() {
                            return;
                        }
                    }
                });
            }
            let workers = Workers { count: jobs, jobs: &job_sender, replies: &reply_receiver };
            let result = self.steer(lanes, bench, scheduler, &workers);
            if result.is_err() {
                // Nobody will look at what is still being done.
                self.stop.store(true, Ordering::Relaxed);
            }
            drop(job_sender);
            result
        })
    }

    fn steer(
        &self,
        lanes: &[Lane],
        bench: &Bench<'_>,
        scheduler: &mut Scheduler<'_>,
        workers: &Workers<'_>,
    ) -> Result<(), EngineError> {
        let take = |scheduler: &mut Scheduler<'_>, (reply, spent_us): (Reply, u64)| {
            let spent = if matches!(reply.outcome, Outcome::Ran(_)) { spent_us } else { 0 };
            scheduler.reply(reply, spent)
        };
        loop {
            for complete in scheduler.take_complete() {
                if !self.options.dry {
                    rollup::keep(self.pipeline, lanes, self.store, scheduler, &complete)?;
                }
            }
            scheduler.take_events().iter().for_each(self.sink);
            let failed = self.options.fail_fast && !scheduler.failures().is_empty();
            let mut glances = 0;
            while scheduler.running() < workers.count
                && glances < GLANCES
                && !failed
                && !self.stop.load(Ordering::Relaxed)
            {
                let Some(job) = scheduler.next_job() else { break };
                if let Some(reply) = bench.glance(&job) {
                    glances += 1;
                    take(scheduler, (reply, 0))?;
                } else if workers.jobs.send(job).is_err() {
                    // The workers live as long as this loop does.
                    return Ok(());
                }
            }
            scheduler.take_events().iter().for_each(self.sink);
            if glances > 0 {
                // There may be more to see at once; workers that are through must not wait for it.
                workers.replies.try_iter().try_for_each(|done| take(scheduler, done))?;
                continue;
            }
            if scheduler.running() == 0 {
                return Ok(());
            }
            let Ok(done) = workers.replies.recv() else { return Ok(()) };
            take(scheduler, done)?;
        }
    }

    fn reporter(&self, lanes: &[Lane], job: &Job) -> Reporter<'a> {
        let lane = &lanes[job.slot.0];
        Reporter {
            node: self.pipeline.nodes[lane.node].name.clone(),
            cell: self.pipeline.cells[lane.cell].text.clone(),
            item: job.item.as_ref().map_or_else(String::new, ToString::to_string),
            sink: self.sink,
        }
    }

    /// Publishes, and keeps results that were asked for; names blobs of them that are missing.
    fn conclude(
        &mut self,
        lanes: &[Lane],
        scheduler: &Scheduler<'_>,
    ) -> Result<(Vec<PathBuf>, Vec<Digest>), EngineError> {
        let (mut publications, mut missing) = (Vec::new(), Vec::new());
        let publishing: HashSet<usize> = lanes.iter().filter(|l| self.publishes(l)).map(|l| l.node).collect();
        for (at, lane) in lanes.iter().enumerate().filter(|(_, l)| l.target) {
            for port in &lane.ports {
                let whole = match self.result(scheduler, at, *port)? {
                    Found::Collection(whole) => whole,
                    Found::Missing(blob) => {
                        missing.push(blob);
                        continue;
                    }
                    Found::Unknown => continue,
                };
                // What is asked for must be there, whether or not somebody reads it in this run.
                let parts = whole.collection.items.values().flat_map(|a| a.parts.values());
                missing.extend(parts.filter(|d| !self.store.contains(d)));
                if self.keep_results {
                    self.results.push(ResultOf { cell: lane.cell, port: *port, whole: whole.clone() });
                }
                if self.pipeline.nodes[lane.node].spec.outputs[*port].publish {
                    publications.push(publish::Publication { folder: self.folder(lane, publishing.len()), whole });
                }
            }
        }
        match &self.options.out {
            Some(out) if !self.options.dry && self.options.only.is_none() => {
                let (written, gone) = publish::publish(self.store, &out.join(&self.pipeline.name), &publications)?;
                missing.extend(gone);
                Ok((written, missing))
            }
            _ => Ok((Vec::new(), missing)),
        }
    }

    /// The folder of a lane's files below the pipeline's: a lone publishing node needs none of its own.
    fn folder(&self, lane: &Lane, publishing: usize) -> String {
        let cell = &self.pipeline.cells[lane.cell].text;
        let node = if publishing > 1 { self.pipeline.nodes[lane.node].name.as_str() } else { "" };
        [node, cell].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("/")
    }

    fn publishes(&self, lane: &Lane) -> bool {
        let outputs = &self.pipeline.nodes[lane.node].spec.outputs;
        lane.target && lane.ports.iter().any(|p| outputs[*p].publish)
    }

    /// A lane's collection, worked out now or in an earlier run.
    fn result(&self, scheduler: &Scheduler<'_>, lane: usize, port: usize) -> Result<Found, EngineError> {
        if let Some(whole) = scheduler.result(lane, port) {
            return Ok(Found::Collection(whole.clone()));
        }
        let name = self.pipeline.nodes[scheduler.node_of(lane)].spec.outputs[port].name;
        let Some(listed) = scheduler.rolled(lane).and_then(|p| p.collections.get(name)) else {
            return Ok(Found::Unknown);
        };
        let found = records::get_collection(self.store, listed)?;
        Ok(found.map_or(Found::Missing(listed.blob), |whole| Found::Collection(Arc::new(whole))))
    }
}

/// Look-ups between two looks at what the workers have done.
const GLANCES: usize = 64;

/// The threads that do actions, and the ways to them.
struct Workers<'a> {
    count: usize,
    jobs: &'a mpsc::Sender<Job>,
    replies: &'a mpsc::Receiver<(Reply, u64)>,
}

/// What is known of a lane's collection.
enum Found {
    Collection(Arc<Whole>),
    /// The blob that lists it is not in the store.
    Missing(Digest),
    /// The lane did not come to an end.
    Unknown,
}

struct Pass {
    stats: Vec<NodeStat>,
    failures: Vec<Failure>,
    missing: HashSet<Digest>,
    ran: HashSet<(usize, Option<ItemKey>)>,
    published: Vec<PathBuf>,
}

/// Passes progress of an action on, with its name.
struct Reporter<'a> {
    node: String,
    cell: String,
    item: String,
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
