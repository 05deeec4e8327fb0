//! One run: its executor, its passes over the lanes, and the end of each pass.

use super::{
    EngineError, ExecutorKind, RunOptions, Sink, Summary,
    conclude::{self, ResultOf},
    event::{Compared, Event, Failure, NodeStat, OutputOf, Slow},
    executor::{self, Executor, Jobs, Place, Processes, Replies, Shared, Site, Threads, Waiting},
    explain,
    holdings::Holdings,
    lanes::{self, Environment, Lanes},
    look_up::Catalog,
    measured::Measured,
    probe::Asking,
    records, request, rollup,
    scheduler::{Ran, SLOWEST, Scheduler},
    steering::{News, Steering},
    transient::{self, Pool},
};
use crate::pipeline::{Pipeline, Target};
use std::{
    collections::{BTreeMap, HashSet},
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread,
};
use tauflow_cache::{Digest, Key, Store};

/// See the module.
pub(super) struct Run<'a> {
    pub(super) pipeline: &'a Pipeline,
    pub(super) store: &'a Store,
    pub(super) options: &'a RunOptions,
    stop: &'a AtomicBool,
    sink: Sink<'a>,
    lanes: Lanes,
    /// Where measurements are made.
    measured: Measured,
    /// Blobs that are passed on in memory; a run that only looks has none.
    pub(super) pool: Option<Arc<Pool>>,
    /// The executor; none in a run that only looks.
    executor: Option<&'a dyn Executor>,
    /// Answers and replies of the executor arrive here.
    news: mpsc::Receiver<News>,
    tell: mpsc::Sender<News>,
    /// Keep the keys of all actions that are looked at.
    pub keep_keys: bool,
    /// Keep the collections that are asked for.
    pub keep_results: bool,
    pub planned: Vec<explain::Planned>,
    pub results: Vec<ResultOf>,
    /// In a dry run: an action that never was done would run.
    pub never_run: bool,
}

/// Actions at a time, and threads for look-ups.
fn workers(options: &RunOptions) -> usize {
    let cores = || thread::available_parallelism().map_or(1, std::num::NonZero::get);
    // Jobs run elsewhere.
    let jobs = matches!(options.executor, ExecutorKind::Jobs(_));
    if options.jobs == 0 || jobs { cores() } else { options.jobs }
}

fn targets(pipeline: &Pipeline, options: &RunOptions) -> Vec<Target> {
    match &options.only {
        Some(only) => vec![Target { node: only.node, port: None }],
        None => pipeline.targets.clone(),
    }
}

/// Whether a run needs measurements.
fn measures(pipeline: &Pipeline, options: &RunOptions) -> Result<bool, EngineError> {
    // No machine decides which lanes are needed.
    let lanes = lanes::demand(pipeline, &targets(pipeline, options), options.only.as_ref(), &|_, _, _| Ok(None))?;
    Ok(lanes.iter().any(|lane| pipeline.nodes[lane.node].spec.measures(lane.group.name)))
}

/// Runs a pipeline with the executor that the options name.
///
/// # Errors
/// As [`Run::finish`].
pub(super) fn with_executor(
    pipeline: &Pipeline,
    store: &Store,
    options: &RunOptions,
    stop: &AtomicBool,
    sink: Sink<'_>,
) -> Result<Summary, EngineError> {
    let memory = options.memory.unwrap_or_else(transient::default_memory);
    let pool = Arc::new(Pool::new(memory / 2));
    let (tell, news) = mpsc::channel();
    // Nobody listens any more if the run has failed.
    let replies = || -> Replies<'_> {
        let replies = tell.clone();
        Box::new(move |reply| drop(replies.send(News::Executed(Box::new(reply)))))
    };
    let measures = measures(pipeline, options)?;
    let mut node = None;
    let measured = match (&options.executor, &options.measured) {
        (ExecutorKind::Jobs(jobs), measured) if measures && measured.as_ref().is_none_or(|of| !of.accepted) => {
            let found = match executor::measuring_place(jobs, store, stop, sink)? {
                Place::Here => None,
                Place::There(found) => Some(found),
                Place::Stopped => return Ok(Summary { interrupted: true, ..Summary::default() }),
            };
            node = found.as_ref().and_then(|found| found.node.clone());
            found.map_or_else(Measured::default, |found| Measured::by_jobs(found.of))
        }
        (_, Some(measured)) => measured.clone(),
        (_, None) => Measured::last(store, pipeline),
    };
    let apart = matches!(&options.executor, ExecutorKind::Jobs(jobs) if jobs.apart.is_some());
    let measured = Measured { apart: apart || options.measured.is_none() && measured.apart, ..measured };
    measured.begin(store, pipeline, measures)?;
    let surroundings = Site {
        machine: measured.machine.clone(),
        store,
        pool: pool.clone(),
        stop,
        fail_fast: options.fail_fast,
        workers: workers(options),
        memory,
        sink,
        replies: replies(),
    };
    let waiting = Waiting { store, pool: pool.clone(), stop, fail_fast: options.fail_fast, sink, replies: replies() };
    thread::scope(|scope| {
        let executor: Box<dyn Executor + '_> = match &options.executor {
            ExecutorKind::Threads => Box::new(Threads::start(scope, surroundings)),
            ExecutorKind::Processes(command) => Box::new(Processes::start(scope, surroundings, command)),
            ExecutorKind::Jobs(options) => Box::new(Jobs::start(scope, surroundings, options, node)),
        };
        let executor: Box<dyn Executor + '_> = match options.share {
            Some(share) => Box::new(Shared::start(scope, share, executor, waiting)),
            None => executor,
        };
        let of = (pipeline, store, options, measured);
        let run = Run::new(of, stop, sink, Some(pool), (tell, news), Some(&*executor));
        let result = run.and_then(|mut run| run.finish());
        if result.is_err() {
            // Nobody will look at what is still being done.
            executor.cancel();
        }
        result
    })
}

impl<'a> Run<'a> {
    /// A run that only looks.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn looking(
        pipeline: &'a Pipeline,
        store: &'a Store,
        options: &'a RunOptions,
        stop: &'a AtomicBool,
        sink: Sink<'a>,
    ) -> Result<Self, EngineError> {
        let measured = Measured::last(store, pipeline);
        Self::new((pipeline, store, options, measured), stop, sink, None, mpsc::channel(), None)
    }

    fn new(
        (pipeline, store, options, measured): (&'a Pipeline, &'a Store, &'a RunOptions, Measured),
        stop: &'a AtomicBool,
        sink: Sink<'a>,
        pool: Option<Arc<Pool>>,
        (tell, news): (mpsc::Sender<News>, mpsc::Receiver<News>),
        executor: Option<&'a dyn Executor>,
    ) -> Result<Self, EngineError> {
        let targets = targets(pipeline, options);
        let environment: Environment<'_> = &|kind, params, group| match executor {
            Some(executor) => executor.environment(kind, params, group),
            None => Asking::new(store, false).measuring(measured.machine.as_ref()).environment(kind, params, group),
        };
        let lanes = lanes::demand(pipeline, &targets, options.only.as_ref(), environment)?;
        Ok(Self {
            pipeline,
            store,
            options,
            stop,
            sink,
            lanes,
            measured,
            pool,
            executor,
            news,
            tell,
            keep_keys: false,
            keep_results: false,
            planned: Vec::new(),
            results: Vec::new(),
            never_run: false,
        })
    }

    /// The keys of lanes whose outputs are known as a whole.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn rolled_lanes(&self) -> Result<Vec<Key>, EngineError> {
        Ok(rollup::rolled_keys(self.pipeline, &self.lanes, self.store, &self.measured)?)
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
        let (mut wanted, mut ran): (Arc<HashSet<Digest>>, _) = (Arc::default(), Ran::new());
        let mut summary = Summary::default();
        let mut spent = vec![(0.0, 0); self.pipeline.nodes.len()];
        // Ends: each pass but the last finds blobs missing that no pass before it did, and what it makes stays.
        loop {
            let pass = self.pass(&wanted, &ran)?;
            summary.failures = pass.failures;
            summary.elsewhere = pass.elsewhere;
            // What a pass before found different is not compared again.
            summary.compared.equal = summary.compared.equal.max(pass.compared.equal);
            summary.compared.differing = summary.compared.differing.max(pass.compared.differing);
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
            let all = summary.failures.is_empty() && summary.elsewhere.is_empty();
            let complete = all && self.options.only.is_none() && !self.options.dry;
            if complete && pass.missing.is_empty() && !self.stop.load(Ordering::Relaxed) {
                rollup::keep_pipeline(self.pipeline, self.store, pass.trees)?;
            }
            ran.extend(pass.ran);
            let before = wanted.len();
            Arc::make_mut(&mut wanted).extend(pass.missing);
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

    fn pass(&mut self, wanted: &Arc<HashSet<Digest>>, ran_before: &Ran) -> Result<Pass, EngineError> {
        let options = self.options;
        let lanes = std::mem::take(&mut self.lanes);
        let pool = self.pool.clone();
        let holdings = Holdings { store: self.store, pool: pool.as_deref(), wanted };
        let RunOptions { dry, recheck, audit, .. } = *options;
        let [a, b, c, d, ..] = Digest::of(records::maker().as_bytes()).hash;
        let salt = u32::from_le_bytes([a, b, c, d]);
        let catalog = Catalog { holdings, dry, keep_keys: self.keep_keys, recheck, audit, salt };
        // Roll-ups would hide the items that a recheck, an audit or `--only` looks at. Where something is missing they
        // hide what else may be: item by item, a pass finds at once all that can be found.
        let whole = options.recheck == 0.0 && options.audit == 0.0 && options.only.is_none() && !options.no_rollup;
        let roll = wanted.is_empty() && whole;
        let tasks = request::tasks(self.pipeline, &lanes, &self.measured);
        let mut scheduler = Scheduler::new(self.pipeline, &lanes, tasks, wanted.clone(), ran_before, roll, options);
        scheduler.start();
        let answer = |request| catalog.answer(request);
        let steering = Steering {
            stop: self.stop,
            fail_fast: options.fail_fast,
            sink: self.sink,
            executor: self.executor,
            answer: &answer,
            workers: workers(options),
            news: &self.news,
            tell: &self.tell,
        };
        let worked = steering.work(&mut scheduler);
        let finished = worked.and_then(|()| self.conclude(&lanes, &scheduler)).map(|(published, missing)| {
            let (outputs, trees) = conclude::outputs(self.pipeline, &lanes, &scheduler);
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
            elsewhere: finished.elsewhere,
            compared: finished.compared,
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
}

struct Pass {
    stats: Vec<NodeStat>,
    failures: Vec<Failure>,
    elsewhere: BTreeMap<u32, u64>,
    compared: Compared,
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
