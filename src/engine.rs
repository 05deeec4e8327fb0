//! The engine: computes the results of a resolved [`Pipeline`] with a store. Knows no kind by name.
//!
//! A run consists of one or more passes: a pass that finds missing blobs is followed by a pass that rebuilds them.

mod action;
pub mod batch;
mod conclude;
pub mod courier;
pub mod event;
pub mod exec;
mod execute;
mod executor;
pub mod explain;
mod holdings;
mod keys;
mod lanes;
mod listing;
mod look_up;
mod measured;
mod output;
mod probe;
pub(crate) mod publish;
mod reached;
mod records;
mod request;
mod rolled;
mod rollup;
mod run;
mod scheduler;
mod sharded;
mod sighted;
pub mod simulation;
mod steering;
mod transient;

pub use event::{Compared, Summary};
pub use executor::{Apart, ChildCommand, JobOption, JobOptions, Scheduling, Share};
pub use lanes::Only;
pub(crate) use lanes::target_ports;
pub use measured::Measured;
pub use reached::{Reached, holds_anywhere, reached, seen_by};
pub use records::{ACTION, MACHINE, PIPELINE, ROLLUP, SEEN, SHARD, now};
pub use sharded::Listed;

use crate::{
    ids::{self, Id as _, PortId},
    pipeline::{Node, Pipeline, Target},
};
use event::{Event, NodeStat};
use run::Run;
use sharded::Sharded;
use std::{path::PathBuf, sync::atomic::AtomicBool, time::Instant};
use tauflow_cache::{CacheError, Store};
use tauflow_contract::{Any, Artifact, Collection, ItemKey};

/// How a run is done.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Actions at a time; 0 takes one for each core.
    pub jobs: usize,
    /// Look up only; run nothing.
    pub dry: bool,
    /// Share of hits that run again and are compared.
    pub recheck: f64,
    /// Share of hits from an upstream that run again and are compared, if their outputs have the same bits anywhere.
    pub audit: f64,
    /// Look every item's key up, even where a whole node is known to be as it was.
    pub no_rollup: bool,
    /// Stop at the first failure.
    pub fail_fast: bool,
    /// Only this.
    pub only: Option<Only>,
    /// Bytes that actions in flight, and transient outputs, are to hold in memory; half of the machine's unless told.
    pub memory: Option<u64>,
    /// Items from which a node's shards are looked up as wholes before its items are.
    pub many: u64,
    /// Read every blob of what is asked for: damaged ones are made again.
    pub verify: bool,
    /// Folder below which published outputs are written; none writes nothing.
    pub out: Option<PathBuf>,
    /// The line on this run that published pages are given where they ask for it, as HTML.
    pub account: Option<String>,
    /// The name of the run in its account.
    pub run: Option<String>,
    /// Where actions run.
    pub executor: ExecutorKind,
    /// The share of the actions that this run does; all of them unless told.
    pub share: Option<Share>,
    /// Where measurements are made or taken from; as in the last run of the pipeline unless told. Jobs of a class of
    /// nodes override it, unless measurements are accepted.
    pub measured: Option<Measured>,
}

/// Where actions run.
#[derive(Clone, Debug, Default)]
pub enum ExecutorKind {
    /// On threads of this process.
    #[default]
    Threads,
    /// In child processes, which are started like this.
    Processes(ChildCommand),
    /// In jobs of a scheduler.
    Jobs(Box<JobOptions>),
}

impl Default for RunOptions {
    fn default() -> Self {
        Self {
            jobs: 0,
            dry: false,
            recheck: 0.0,
            audit: 0.0,
            no_rollup: false,
            fail_fast: false,
            only: None,
            memory: None,
            many: sharded::MANY,
            verify: false,
            out: None,
            account: None,
            run: None,
            executor: ExecutorKind::Threads,
            share: None,
            measured: None,
        }
    }
}

/// Why a run could not go on. Failures of items are in the [`Summary`] instead.
#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    /// The store.
    #[error(transparent)]
    Cache(#[from] CacheError),
    /// A result could not be written.
    #[error("cannot write {path}: {source}; free some space, or choose a different directory with \
        --out", path = path.display())]
    Write {
        /// Where.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The request makes no sense for this pipeline.
    #[error("{0}")]
    Request(String),
    /// The executor failed.
    #[error("{0}")]
    Executor(String),
    /// What is asked for was there, and is lost or damaged: [`restore`] makes it again.
    #[error("{0}")]
    Lost(String),
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
    let mut summary = if options.dry {
        Run::looking(pipeline, store, options, stop, sink)?.finish()?
    } else {
        run::with_executor(pipeline, store, options, stop, sink)?
    };
    summary.elapsed = start.elapsed();
    if let (Some(out), false) = (&options.out, options.dry) {
        publish::write_summary(&out.join(&pipeline.name), &pipeline.name, options.run.as_deref(), &summary)?;
    }
    let total = |of: fn(&NodeStat) -> u64| summary.total(of);
    sink(&Event::Finished {
        ran: total(|n| n.ran),
        hit: total(|n| n.hit),
        failed: total(|n| n.failed),
        blocked: total(|n| n.blocked),
        written: total(|n| n.written),
        elapsed_s: summary.elapsed.as_secs_f64(),
        nodes: summary.nodes.iter().filter(|n| n.lanes > 0).cloned().collect(),
        slowest: summary.slowest.clone(),
    });
    Ok(summary)
}

/// The result of a dry run.
#[derive(Debug)]
pub struct Plan {
    /// Numbers by node: `ran` is what would run.
    pub summary: Summary,
    /// The actions that were looked at one by one, with their keys.
    pub would_run: Vec<explain::Planned>,
}

/// The plan of a run: hits, actions to run, and nodes whose items are unknown until other actions have run.
///
/// It starts no program and loads no library of the pipeline: see [`explain::Planned::unknown`].
///
/// # Errors
/// If the store cannot be read.
pub fn plan(pipeline: &Pipeline, store: &Store, only: Option<Only>) -> Result<Plan, EngineError> {
    let start = Instant::now();
    let options = RunOptions { dry: true, only, ..RunOptions::default() };
    let stop = AtomicBool::new(false);
    let mut run = Run::looking(pipeline, store, &options, &stop, &|_| {})?;
    run.keep_keys = true;
    let mut summary = run.finish()?;
    summary.elapsed = start.elapsed();
    Ok(Plan { summary, would_run: run.planned })
}

/// The collection on an output port, if everything it needs has been run.
///
/// The cells of a matrix are gathered.
///
/// # Errors
/// If the store cannot be read, or something must be run first: [`EngineError::Lost`] if all of that was run before, as
/// far as can be told. Where the log is damaged, nobody knows what it said; then a whole run of the pipeline must be on
/// record.
pub fn outputs(pipeline: &Pipeline, store: &Store, node: usize, port: PortId) -> Result<Collection, EngineError> {
    let (all, mut stale) = outputs_there(pipeline, store, node, port)?;
    if stale.is_empty() { Ok(all) } else { Err(stale.swap_remove(0).1) }
}

/// An output as targets name it: the first one by its node alone.
fn output_name(node: &Node, port: PortId) -> String {
    let name = node.spec.outputs[port.place()].name;
    if port.place() == 0 { node.name.clone() } else { format!("{}.{name}", node.name) }
}

/// The collection on an output port of the cells that are up to date, and the other cells, each with its error as
/// [`outputs`] has it.
///
/// # Errors
/// If the store cannot be read.
pub fn outputs_there(
    pipeline: &Pipeline,
    store: &Store,
    node: usize,
    port: PortId,
) -> Result<(Collection, Vec<(usize, EngineError)>), EngineError> {
    let asked = asking(pipeline, node, port);
    let options = RunOptions { dry: true, ..RunOptions::default() };
    let stop = AtomicBool::new(false);
    let mut run = Run::looking(&asked, store, &options, &stop, &|_| {})?;
    run.keep_results = true;
    let summary = run.finish()?;
    let (mut all, mut stale) = (Collection::default(), Vec::new());
    for cell in pipeline.nodes[node].cells.clone() {
        let found = run.results.iter().find(|r| r.cell == cell && r.port == port);
        let Some(result) = found else {
            let behind = summary.nodes.iter().filter(|n| n.ran + n.failed + n.blocked > 0 || n.unknown);
            let names: Vec<String> = behind.map(|n| format!("`{}`", n.node)).collect();
            let unread = store.damaged_log_places() > 0 && !store.keys_by_label(PIPELINE, &pipeline.name).is_empty();
            let error = if run.never_run && !unread { EngineError::Request } else { EngineError::Lost };
            let message = format!(
                "`{}` is stale: {} must run first; run the pipeline with `--target {}`, then repeat this command",
                pipeline.cell_name(cell),
                if names.is_empty() { "it".to_owned() } else { names.join(", ") },
                output_name(&pipeline.nodes[node], port)
            );
            stale.push((cell, error(message)));
            continue;
        };
        let items = match result.collection.items(store)? {
            Ok(items) => items,
            Err(blob) => {
                let message = format!(
                    "blob {} of `{}` is missing; run the pipeline to rebuild it, then repeat this command",
                    blob.short(),
                    pipeline.cell_name(cell)
                );
                stale.push((cell, EngineError::Lost(message)));
                continue;
            }
        };
        let prefix = &pipeline.cells[cell].text;
        for (key, output) in items {
            let key = if prefix.is_empty() {
                key
            } else {
                key.in_cell(prefix).map_err(|e| EngineError::Request(e.to_string()))?
            };
            all.items.insert(key, output.artifact.clone());
        }
    }
    Ok((all, stale))
}

/// The items that a listing of an earlier run names; none if the store no longer holds the listing.
///
/// # Errors
/// If the store cannot be read.
pub fn listed_items(store: &Store, listed: &Listed) -> Result<Option<Vec<(ItemKey, Artifact)>>, EngineError> {
    let Some(found) = Sharded::get(store, listed, Any::NAME)? else { return Ok(None) };
    let items = found.items(store)?;
    Ok(items.ok().map(|items| items.into_iter().map(|(key, output)| (key, output.artifact.clone())).collect()))
}

/// Makes what a port holds whole again: all of its blobs that are lost or damaged, and what they are made of.
///
/// # Errors
/// As [`run`].
pub fn restore(
    pipeline: &Pipeline,
    store: &Store,
    (node, port): (usize, PortId),
    stop: &AtomicBool,
    sink: Sink<'_>,
) -> Result<Summary, EngineError> {
    let options = RunOptions { verify: true, ..RunOptions::default() };
    run(&asking(pipeline, node, port), store, &options, stop, sink)
}

/// The pipeline, with one port for its target.
fn asking(pipeline: &Pipeline, node: usize, port: PortId) -> Pipeline {
    Pipeline { targets: vec![Target { node, port: Some(port) }], ..pipeline.clone() }
}
