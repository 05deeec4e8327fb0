//! The engine: from a resolved [`Pipeline`] and a store to results. Knows no kind by name.
//!
//! A run is a pass, or several: a pass that meets missing blobs is followed by one that makes them again.

pub mod event;
pub mod explain;
mod lanes;
mod publish;
mod records;
mod rollup;
mod scheduler;
mod work;

pub use event::Summary;
pub use lanes::Only;

use crate::pipeline::{Pipeline, Target};
use event::{Event, Failure, NodeStat};
use lanes::Lane;
use records::Whole;
use scheduler::Scheduler;
use std::{
    collections::HashSet,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread,
    time::Instant,
};
use tauflow_cache::{CacheError, Digest, Store};
use tauflow_contract::{Collection, ItemKey, Progress};
use work::{Bench, Job, Outcome, Reply};

/// Passes after which a run gives up making missing blobs again: each pass goes at least one stage further.
const MAX_PASSES: usize = 64;

/// How a run is done.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Actions at a time; 0 takes one for each core.
    pub jobs: usize,
    /// Look up only; run nothing.
    pub dry: bool,
    /// Share of hits that run again and are compared.
    pub recheck: f64,
    /// Stop at the first failure.
    pub fail_fast: bool,
    /// Only this.
    pub only: Option<Only>,
    /// Folder below which published outputs are written; none writes nothing.
    pub out: Option<PathBuf>,
}

impl Default for RunOptions {
    fn default() -> Self {
        Self { jobs: 0, dry: false, recheck: 0.0, fail_fast: false, only: None, out: None }
    }
}

/// Why a run could not go on. Failures of items are in the [`Summary`] instead.
#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    /// The store.
    #[error(transparent)]
    Cache(#[from] CacheError),
    /// A result could not be written.
    #[error("cannot write {path}: {source}; make room or choose another folder by --out", path = path.display())]
    Write {
        /// Where.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The request makes no sense for this pipeline.
    #[error("{0}")]
    Request(String),
}

/// Whoever looks on.
pub type Sink<'a> = &'a (dyn Fn(&Event) + Sync);

/// Brings the pipeline's targets up to date.
///
/// `stop` ends the run as soon as the actions in flight allow; what is done stays done.
///
/// # Errors
/// If the store or the output folder fails. An item that fails is no error here: see [`Summary::failures`].
pub fn run(
    pipeline: &Pipeline,
    store: &Store,
    options: &RunOptions,
    stop: &AtomicBool,
    sink: Sink<'_>,
) -> Result<Summary, EngineError> {
    let start = Instant::now();
    let mut run = Run::new(pipeline, store, options, stop, sink);
    let mut summary = run.to_the_end()?;
    summary.elapsed = start.elapsed();
    if let (Some(out), false) = (&options.out, options.dry) {
        publish::write_summary(&out.join(&pipeline.name), &pipeline.name, &summary)?;
    }
    let total = |of: fn(&NodeStat) -> u64| summary.total(of);
    sink(&Event::Finished {
        ran: total(|n| n.ran),
        hit: total(|n| n.hit),
        failed: total(|n| n.failed),
        blocked: total(|n| n.blocked),
    });
    Ok(summary)
}

/// What a dry run found.
#[derive(Debug)]
pub struct Plan {
    /// Numbers by node: `ran` is what would run.
    pub summary: Summary,
    /// The keys of the actions that would run, by node and item.
    pub would_run: Vec<explain::Planned>,
}

/// What a run would do: hits, runs, and nodes whose items are not known before something else has run.
///
/// # Errors
/// If the store cannot be read.
pub fn plan(pipeline: &Pipeline, store: &Store, only: Option<Only>) -> Result<Plan, EngineError> {
    let start = Instant::now();
    let options = RunOptions { dry: true, only, ..RunOptions::default() };
    let stop = AtomicBool::new(false);
    let mut run = Run::new(pipeline, store, &options, &stop, &|_| {});
    run.keep_keys = true;
    let mut summary = run.to_the_end()?;
    summary.elapsed = start.elapsed();
    Ok(Plan { summary, would_run: run.planned })
}

/// The collection on an output port, if everything it needs has been run.
///
/// `port` is a number of [`tauflow_contract::KindSpec::outputs`]; the cells of a matrix are gathered.
///
/// # Errors
/// If the store cannot be read, or something must be run first.
pub fn outputs(pipeline: &Pipeline, store: &Store, node: usize, port: usize) -> Result<Collection, EngineError> {
    let mut asked = pipeline.clone();
    asked.targets = vec![Target { node, port: Some(port) }];
    let options = RunOptions { dry: true, ..RunOptions::default() };
    let stop = AtomicBool::new(false);
    let mut run = Run::new(&asked, store, &options, &stop, &|_| {});
    run.keep_results = true;
    run.to_the_end()?;
    let mut all = Collection::default();
    for cell in pipeline.nodes[node].cells.clone() {
        let found = run.results.iter().find(|r| r.cell == cell && r.port == port);
        let Some(result) = found else {
            return Err(EngineError::Request(format!(
                "`{}` is not up to date; run the pipeline first",
                pipeline.cell_name(cell)
            )));
        };
        let prefix = &pipeline.cells[cell].text;
        for (key, artifact) in result.whole.collection.iter() {
            let key = if prefix.is_empty() {
                key.clone()
            } else {
                key.in_cell(prefix).map_err(|e| EngineError::Request(e.to_string()))?
            };
            all.items.insert(key, artifact.clone());
        }
    }
    Ok(all)
}

/// A port's collection at the end of a run.
struct ResultOf {
    cell: usize,
    port: usize,
    whole: Arc<Whole>,
}

struct Run<'a> {
    pipeline: &'a Pipeline,
    store: &'a Store,
    options: &'a RunOptions,
    stop: &'a AtomicBool,
    sink: Sink<'a>,
    lanes: Vec<Lane>,
    keep_keys: bool,
    keep_results: bool,
    planned: Vec<explain::Planned>,
    results: Vec<ResultOf>,
}

impl<'a> Run<'a> {
    fn new(
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

    fn to_the_end(&mut self) -> Result<Summary, EngineError> {
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

    fn pass(&mut self, wanted: &HashSet<Digest>, ran_before: &HashSet<(usize, Option<ItemKey>)>) -> Result<Pass, EngineError> {
        let options = self.options;
        let lanes = std::mem::take(&mut self.lanes);
        let bench =
            Bench { store: self.store, stop: self.stop, dry: options.dry, recheck: options.recheck, wanted };
        // Roll-ups would hide the items that a recheck or `--only` looks at, and the keys that a plan explains.
        let known = if options.recheck > 0.0 || options.only.is_some() {
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
            let result = self.steer(lanes, jobs, scheduler, &job_sender, &reply_receiver);
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
        jobs: usize,
        scheduler: &mut Scheduler<'_>,
        job_sender: &mpsc::Sender<Job>,
        replies: &mpsc::Receiver<(Reply, u64)>,
    ) -> Result<(), EngineError> {
        loop {
            for complete in scheduler.take_complete() {
                if !self.options.dry {
                    rollup::keep(self.pipeline, lanes, self.store, scheduler, &complete)?;
                }
            }
            scheduler.take_events().iter().for_each(self.sink);
            let failed = self.options.fail_fast && !scheduler.failures().is_empty();
            while scheduler.running() < jobs && !failed && !self.stop.load(Ordering::Relaxed) {
                let Some(job) = scheduler.next_job() else { break };
                // The workers live as long as this loop does.
                if job_sender.send(job).is_err() {
                    return Ok(());
                }
            }
            scheduler.take_events().iter().for_each(self.sink);
            if scheduler.running() == 0 {
                return Ok(());
            }
            let Ok((reply, spent_us)) = replies.recv() else { return Ok(()) };
            let spent = if matches!(reply.outcome, Outcome::Ran(_)) { spent_us } else { 0 };
            scheduler.reply(reply, spent)?;
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
        let mut publications = Vec::new();
        let publishing: HashSet<usize> = lanes.iter().filter(|l| self.publishes(l)).map(|l| l.node).collect();
        for (at, lane) in lanes.iter().enumerate() {
            if !lane.target || !(self.keep_results || self.publishes(lane)) {
                continue;
            }
            for port in &lane.ports {
                let Some(whole) = self.result(scheduler, at, *port)? else { continue };
                if self.keep_results {
                    self.results.push(ResultOf { cell: lane.cell, port: *port, whole: whole.clone() });
                }
                if self.pipeline.nodes[lane.node].spec.outputs[*port].publish {
                    let mut folder = String::new();
                    if publishing.len() > 1 {
                        folder.clone_from(&self.pipeline.nodes[lane.node].name);
                    }
                    if !self.pipeline.cells[lane.cell].text.is_empty() {
                        folder = Path::new(&folder).join(&self.pipeline.cells[lane.cell].text).display().to_string();
                    }
                    publications.push(publish::Publication { folder, whole });
                }
            }
        }
        match &self.options.out {
            Some(out) if !self.options.dry && self.options.only.is_none() => {
                publish::publish(self.store, &out.join(&self.pipeline.name), &publications)
            }
            _ => Ok((Vec::new(), Vec::new())),
        }
    }

    fn publishes(&self, lane: &Lane) -> bool {
        let outputs = &self.pipeline.nodes[lane.node].spec.outputs;
        lane.target && lane.ports.iter().any(|p| outputs[*p].publish)
    }

    /// A lane's collection, worked out now or in an earlier run.
    fn result(&self, scheduler: &Scheduler<'_>, lane: usize, port: usize) -> Result<Option<Arc<Whole>>, EngineError> {
        if let Some(whole) = scheduler.result(lane, port) {
            return Ok(Some(whole.clone()));
        }
        let name = {
            let node = scheduler.node_of(lane);
            self.pipeline.nodes[node].spec.outputs[port].name
        };
        let Some(listed) = scheduler.rolled(lane).and_then(|p| p.collections.get(name)) else { return Ok(None) };
        Ok(records::get_collection(self.store, listed)?.map(Arc::new))
    }
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
