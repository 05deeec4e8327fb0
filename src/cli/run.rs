//! `tauflow run`.

use super::{
    CacheAt, CliError, Exit, PipelineArgs, bytes_text, counted,
    executor::ExecutorArgs,
    notify,
    page::{self, Page},
    progress::{Display, Voice},
    quoted, seconds_text, table, upstream,
};
use crate::{
    engine::{
        self, Measured, Only, RunOptions, Share, Summary,
        event::{self, Failure},
    },
    kinds::Registry,
    lock::{self, Differences, Lock, LockError},
    pipeline::{Pipeline, chart::Chart},
    query,
    runs::{Observer, PageFile, RunRecord, RunsError},
    units::bytes,
};
use clap::{Args, ValueEnum};
use serde_json::json;
use std::{
    collections::{BTreeMap, BTreeSet},
    io::ErrorKind,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};
use tauflow_cache::Store;

impl From<LockError> for CliError {
    fn from(error: LockError) -> Self {
        match error {
            LockError::Io { what: "write", .. } => Self::Environment(error.to_string()),
            other => Self::Bad(other.to_string()),
        }
    }
}

/// Actions that the account of a run names.
const SLOWEST: usize = 3;
/// Maximum number of concurrent actions; each has two threads.
const MOST_JOBS: i64 = 1024;

/// Arguments of `run`.
#[derive(Args)]
pub(crate) struct RunArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// Directory for results; the report is written to DIR/<pipeline>/report.html.
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Run only this node, cell or item, and its dependencies.
    #[arg(long, value_name = "NODE[/CELL][/ITEM]")]
    only: Option<String>,
    /// Number of concurrent actions. Default: the number of cores. With a scheduler: jobs that are
    /// queued or running; default: 100.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u16).range(..=MOST_JOBS))]
    jobs: u16,
    /// Memory budget for running actions and transient outputs, such as 8GiB. Default: half of the memory.
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    memory: Option<u64>,
    /// Do only share I of N of the actions, for runs on one cache that you start by hand on N machines.
    #[arg(long, value_name = "I/N", conflicts_with_all = ["recheck", "audit", "only"])]
    shard: Option<Share>,
    /// With --shard: wait for the actions of other shards, and do the whole run together with them.
    #[arg(long, requires = "shard")]
    wait: bool,
    /// Stop at the first failure.
    #[arg(long)]
    fail_fast: bool,
    /// Rerun this share of the cached actions and compare the outputs.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    recheck: f64,
    /// Rerun this share of the cached actions that came from an upstream and have the same outputs on every machine. A
    /// result that differs is quarantined, and this machine's result is used.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    audit: f64,
    /// Take measurements of another machine from the cache or its upstream, and measure nothing here. HOST is needed
    /// if several machines measured. What HOST did not measure fails. Without this option, a run measures again.
    #[arg(long, value_name = "HOST", num_args = 0..=1, require_equals = true, default_missing_value = "",
          conflicts_with_all = ["recheck", "timing"])]
    accept_measured: Option<String>,
    /// Look up every item, even if a whole node is known to be up to date.
    #[arg(long)]
    no_rollup: bool,
    /// Compare all reproducible outputs with the lock file; with --target, those of the nodes that it needs.
    #[arg(long, conflicts_with_all = ["only", "update_lock"])]
    locked: bool,
    /// Write the lock file, next to the pipeline file; with --target, only its entries of the nodes that it needs.
    #[arg(long, conflicts_with = "only")]
    update_lock: bool,
    /// Copy the results of the pipeline to the upstream at the end, as `cache push PIPELINE` does.
    #[arg(long)]
    push: bool,
    /// Sign what --push writes with the secret key in this file, which `cache keygen FILE` makes.
    #[arg(long, value_name = "FILE", requires = "push")]
    sign: Option<PathBuf>,
    /// Print machine-readable events on stdout, one per line.
    #[arg(long, value_enum, value_name = "FORMAT")]
    events: Option<EventFormat>,
    /// At the end of the run, POST a JSON object to this URL: pipeline, id, state, seconds, failures. HTTPS needs the
    /// program `curl`.
    #[arg(long, value_name = "URL", value_parser = notify::address)]
    notify: Option<notify::Address>,
    #[command(flatten)]
    executor: ExecutorArgs,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum EventFormat {
    Json,
}

pub(crate) fn run(args: &RunArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    for (name, share) in [("--recheck", args.recheck), ("--audit", args.audit)] {
        if !(0.0..=1.0).contains(&share) {
            return Err(CliError::Bad(format!("{name} {share} must be between 0 and 1, for example 0.05")));
        }
    }
    if (args.locked || args.update_lock) && args.pipeline.has_sets() {
        let message = "--locked and --update-lock do not accept --set; define a profile instead";
        return Err(CliError::Bad(message.into()));
    }
    if args.executor.has_worker_cache() && args.recheck.max(args.audit) > 0.0 {
        let message = "--recheck and --audit do not work with --worker-cache, whose jobs compare with what they fetch: \
                       compare in a run without it";
        return Err(CliError::Bad(message.into()));
    }
    if args.push {
        upstream::prepare(cache, args.sign.as_deref())?;
    }
    let pipeline = args.pipeline.resolve(registry)?;
    let before = args.lock(&pipeline.name)?;
    let only = args.only.as_deref().map(|text| Only::parse(text, &pipeline)).transpose().map_err(CliError::Bad)?;
    let store = cache.open()?;
    let measured = match args.accept_measured.as_deref() {
        None => Measured::default(),
        Some(host) => Measured::accept(&store, Some(host).filter(|host| !host.is_empty()))?,
    };
    let stop = Arc::new(AtomicBool::new(false));
    let display = Display::new(&pipeline, args.events.is_some());
    listen(stop.clone(), display.voice())?;
    let mut record = RunRecord::begin(&pipeline, args.pipeline.file().0, args.pipeline.overrides());
    if let Some(to) = &args.notify {
        record.command = notify::without_secret(record.command, to);
    }
    let mut options = RunOptions {
        account: Some(page::account(&record)),
        jobs: args.jobs.into(),
        dry: false,
        recheck: args.recheck,
        audit: args.audit,
        no_rollup: args.no_rollup,
        fail_fast: args.fail_fast,
        only,
        memory: args.memory,
        out: Some(args.out.clone()),
        executor: args.executor.executor(cache, &pipeline, args.jobs.into())?,
        share: args.shard.map(|share| share.waiting(args.wait)),
        measured: Some(measured),
        ..RunOptions::default()
    };
    // The results are there, whatever becomes of the record.
    let unrecorded = |error: RunsError| errln!("warning: this run is not recorded: {error}");
    let recorded = record.write(&cache.folder()).map_err(unrecorded).is_ok();
    // It has a name from now on.
    options.run = recorded.then(|| record.id.clone());
    let page = page(args, &pipeline, &record);
    let observer = recorded.then(|| Observer::start(&pipeline, &record, cache.folder(), page));
    let begun = display.begun();
    let summary = std::thread::scope(|scope| {
        // In parallel with the run, because listing sources may take a while.
        let (display, pipeline, store, observer) = (&display, &pipeline, &store, &observer);
        scope.spawn(move || {
            if begun.recv().is_ok() {
                display.expect(query::expected(pipeline, store));
            }
        });
        let summary = engine::run(pipeline, store, &options, &stop, &|event| {
            display.show(event);
            observer.iter().for_each(|observer| observer.observe(event));
        });
        display.end();
        summary
    });
    // A run of an item that is not there is no run that is done.
    let there = match (&summary, &options.only) {
        (Ok(summary), Some(only)) => there_was(only, summary, &pipeline, &store),
        _ => Ok(()),
    };
    let now = summary.as_ref().ok().filter(|summary| summary.is_whole());
    let now = now.map(|summary| Lock::of(&pipeline.name, &summary.outputs));
    let all = outputs(&pipeline);
    let differences = match (&before, &now) {
        (Some(before), Some(now)) if args.locked => Some(before.compare(now, &all, args.pipeline.has_targets())),
        _ => None,
    };
    let refuted = differences.as_ref().filter(|found| !found.is_empty());
    match (&summary, &there) {
        (Ok(summary), Ok(())) => {
            record.end(summary);
            if let Some(found) = refuted {
                record.refute(format!("{} from {}", differ(found.len()), args.lock_path().display()));
            }
        }
        (Ok(_), Err(error)) => record.fail(error.to_string()),
        (Err(error), _) => record.fail(error.to_string()),
    }
    let published = summary.as_ref().map_or(&[][..], |summary| &summary.published);
    let notes = observer.map(|observer| observer.conclude(&record, published));
    notes.iter().flatten().for_each(|note| errln!("warning: {note}"));
    if recorded && let Err(error) = record.conclude(&cache.folder()) {
        unrecorded(error);
    }
    if let Some(note) = args.notify.as_ref().and_then(|to| notify::send(to, &record)) {
        errln!("note: {note}");
    }
    let summary = summary?;
    there?;
    let measured = Measured::last(&store, &pipeline);
    drop(store);
    tell(&summary, &pipeline, args, &record);
    if let Some(machine) = measured.words() {
        let how = if measured.accepted { "accepted from" } else { "made on" };
        errln!("measurements: {how} {machine}");
    }
    if let Some(traffic) = cache.reader()?.and_then(|reader| reader.traffic()) {
        errln!("upstream: {}", upstream::traffic_text(traffic));
    }
    if summary.interrupted {
        return Ok(Exit::Interrupted);
    }
    if args.push {
        match refuted {
            None => upstream::publish(&pipeline, registry, cache, args.sign.as_deref())?,
            Some(_) => errln!("nothing was pushed, because outputs differ from the lock file"),
        }
    }
    let Some(now) = now else {
        if args.locked || args.update_lock {
            let what = if args.locked { "compared" } else { "updated" };
            errln!("the lock file was not {what}, because not all actions succeeded");
        }
        return Ok(Exit::Failed);
    };
    if args.update_lock {
        let whole = match before {
            Some(before) if args.pipeline.has_targets() => before.with_part(&now, &all),
            _ => now,
        };
        whole.write(&args.lock_path())?;
        errln!("wrote {}", args.lock_path().display());
    }
    if let Some(found) = &differences {
        tell_differences(found, args);
    }
    Ok(if refuted.is_none() { Exit::Done } else { Exit::Failed })
}

/// The names of all outputs that a pipeline can have.
fn outputs(pipeline: &Pipeline) -> BTreeSet<String> {
    let of_cell = |(cell, node): (usize, usize)| {
        let name = pipeline.cell_name(cell);
        pipeline.nodes[node].spec.outputs.iter().map(move |output| format!("{name}.{}", output.name))
    };
    pipeline.cells.iter().map(|cell| cell.node).enumerate().flat_map(of_cell).collect()
}

/// `3 outputs differ`.
fn differ(count: usize) -> String {
    counted(count as u64, "output") + if count == 1 { " differs" } else { " differ" }
}

/// Options of `run` that a run of one item does without, and whether a value follows.
const OF_WHOLE_RUNS: [(&str, bool); 9] = [
    ("--shard", true),
    ("--wait", false),
    ("--only", true),
    ("--locked", false),
    ("--update-lock", false),
    ("--push", false),
    ("--sign", true),
    ("--notify", true),
    ("--events", true),
];

/// The command line of a run, for people who run it again; without some options.
fn command(record: &RunRecord, without: &[(&str, bool)]) -> String {
    let mut words = vec!["tauflow".to_owned()];
    let mut left = record.command.iter().skip(1);
    while let Some(word) = left.next() {
        let name = word.split('=').next().unwrap_or(word);
        match without.iter().find(|(option, _)| *option == name) {
            Some((_, true)) if name == word => _ = left.next(),
            Some(_) => {}
            None => words.push(quoted(word)),
        }
    }
    words.join(" ")
}

/// The page of the run.
fn page(args: &RunArgs, pipeline: &Pipeline, record: &RunRecord) -> PageFile {
    let folder = args.out.join(&pipeline.name);
    let order: Vec<String> = pipeline.nodes.iter().map(|node| node.name.clone()).collect();
    let again = command(record, &OF_WHOLE_RUNS);
    let page = Page::new(record, Chart::new(pipeline), &order, again, folder.clone());
    PageFile { path: folder.join(engine::publish::PAGE), html: Box::new(move |shown| page.html(shown)) }
}

/// Finds out whether the item of `--only` took part in the run.
fn there_was(only: &Only, summary: &Summary, pipeline: &Pipeline, store: &Store) -> Result<(), CliError> {
    let Some(item) = &only.item else { return Ok(()) };
    let stat = &summary.nodes[only.node];
    if stat.hit + stat.ran + stat.failed + stat.blocked > 0 || summary.interrupted || !summary.failures.is_empty() {
        return Ok(());
    }
    query::there_is(item, &Only { item: None, ..only.clone() }, pipeline, store)?;
    Err(CliError::Bad(format!("`{}` has no item `{item}`", pipeline.nodes[only.node].name)))
}

impl RunArgs {
    /// The lock file that this run needs, or writes a part of. One of another pipeline is never overwritten.
    fn lock(&self, pipeline: &str) -> Result<Option<Lock>, CliError> {
        let path = self.lock_path();
        match Lock::read(&path, pipeline) {
            _ if !(self.locked || self.update_lock) => Ok(None),
            Ok(lock) => Ok(Some(lock)),
            Err(LockError::Io { source, .. }) if self.update_lock && source.kind() == ErrorKind::NotFound => Ok(None),
            // A damaged one is written anew.
            Err(LockError::Parse { .. }) if self.update_lock && !self.pipeline.has_targets() => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    fn lock_path(&self) -> PathBuf {
        let (file, profile) = self.pipeline.file();
        lock::path_of(file, profile)
    }
}

/// Says how the outputs differ from the lock.
fn tell_differences(found: &Differences, args: &RunArgs) {
    if args.events.is_some() {
        outln!("{}", json!({ "event": "locked", "of": found }));
    }
    let path = args.lock_path();
    for (output, was, is) in &found.outputs {
        match (was, is) {
            (Some(was), Some(is)) => errln!("`{output}` is {is}; the lock file has {was}"),
            (None, Some(is)) => errln!("`{output}` is {is}; the lock file does not contain it"),
            (was, None) => {
                let was = was.map(|digest| digest.to_string()).unwrap_or_default();
                errln!("`{output}` is {was} in the lock file; the pipeline has no such output");
            }
        }
    }
    for output in &found.unreproducible {
        errln!("`{output}` is in the lock file, but is measured or of this machine alone now");
    }
    if found.skipped > 0 {
        errln!("{} of the lock file not compared: no target needs them", counted(found.skipped as u64, "output"));
    }
    if found.is_empty() {
        errln!("{} agrees: {}", path.display(), counted(found.equal as u64, "output"));
    } else {
        errln!("error: {} from {}; find the reason, or accept with --update-lock", differ(found.len()), path.display());
    }
}

/// The first Ctrl-C ends the run cleanly, the second at once.
fn listen(stop: Arc<AtomicBool>, voice: Voice) -> Result<(), CliError> {
    ctrlc::set_handler(move || {
        if stop.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        voice.say("stopping after the running actions (press again to stop now; finished results are kept)");
    })
    .map_err(|e| CliError::Environment(format!("cannot listen for Ctrl-C: {e}")))
}

fn tell(summary: &Summary, pipeline: &Pipeline, args: &RunArgs, record: &RunRecord) {
    let ran = summary.total(|n| n.ran);
    let hit = summary.total(|n| n.hit);
    let elapsed = seconds_text(summary.elapsed.as_secs_f64());
    if ran == 0 && summary.is_whole() {
        errln!("nothing to do: {} up to date ({elapsed})", counted(hit, "result"));
    } else {
        err!("{}", table(&rows(summary)));
        let written = bytes_text(summary.total(|n| n.written));
        let failed = summary.total(|n| n.failed);
        let failed = if failed > 0 { format!(", {failed} failed") } else { String::new() };
        errln!("{} ran, {hit} as before{failed}; {written} made ({elapsed})", counted(ran, "action"));
        // Where the time went, if anybody would ask.
        let long = summary.slowest.iter().filter(|slow| slow.spent_s >= 1.0);
        let named = |slow: &event::Slow| format!("{} {}", slow.name(), seconds_text(slow.spent_s));
        let long: Vec<String> = long.take(SLOWEST).map(named).collect();
        if !long.is_empty() {
            errln!("slowest: {}", long.join(", "));
        }
    }
    if args.recheck > 0.0 || args.audit > 0.0 {
        let engine::Compared { equal, differing } = summary.compared;
        let which = if args.recheck > 0.0 { "recheck" } else { "audit" };
        errln!("{which}: {} made again, {differing} of them different", counted(equal + differing, "result"));
    }
    show_failures(&summary.failures, &command(record, &OF_WHOLE_RUNS));
    if args.events.is_some() {
        summary.failures.iter().for_each(|failure| outln!("{}", json!({ "event": "failure", "of": failure })));
    }
    if let Some(share) = args.shard
        && let Some(missing) = missing(&summary.elsewhere, share.count())
    {
        errln!("{missing}");
    }
    if summary.interrupted {
        errln!("stopped; to resume, run: {}", command(record, &[("--notify", true)]));
    }
    let page = summary.published.iter().find(|p| p.extension().is_some_and(|e| e == "html"));
    let folder = (!summary.published.is_empty()).then(|| args.out.join(&pipeline.name));
    match page.or(folder.as_ref()) {
        Some(path) if args.events.is_some() => outln!("{}", json!({ "event": "published", "path": path })),
        Some(path) => outln!("{}", path.display()),
        None => {}
    }
}

/// The actions that other shards have not done, and how to get them done. There are `count` shards.
fn missing(elsewhere: &BTreeMap<u32, u64>, count: u32) -> Option<String> {
    let of: Vec<String> = elsewhere
        .iter()
        .map(|(shard, actions)| format!("{} of shard {shard}/{count}", counted(*actions, "action")))
        .collect();
    (!of.is_empty()).then(|| {
        format!("not done yet: {}\n  run these shards on this cache, or wait for them with --wait", of.join(", "))
    })
}

fn rows(summary: &Summary) -> Vec<Vec<String>> {
    let heads = ["node", "as before", "ran", "failed", "blocked", "time", "made"];
    let mut rows = vec![heads.map(str::to_owned).to_vec()];
    for node in summary.nodes.iter().filter(|n| n.lanes > 0) {
        let some = |n: u64| if n == 0 { String::new() } else { n.to_string() };
        rows.push(vec![
            node.node.clone(),
            some(node.hit),
            some(node.ran),
            some(node.failed),
            some(node.blocked),
            seconds_text(node.spent_s),
            // What is new in the cache: results of several nodes share their blobs, and count once.
            if node.written == 0 { String::new() } else { bytes_text(node.written) },
        ]);
    }
    rows
}

/// Failures by cause, one message in full each, with the command that runs just that item again.
fn show_failures(failures: &[Failure], again: &str) {
    let mut causes: BTreeMap<(String, String), Vec<&Failure>> = BTreeMap::new();
    for failure in failures {
        causes.entry((failure.node.clone(), failure.cause())).or_default().push(failure);
    }
    for ((node, _), group) in &causes {
        let first = group[0];
        let item = [&first.cell, &first.item].iter().filter(|p| !p.is_empty()).map(|p| p.as_str()).collect::<Vec<_>>();
        let more =
            if group.len() > 1 { format!(" and {} more with the same cause", group.len() - 1) } else { String::new() };
        errln!("\nfailed: {node} {}{more}\n  {}", item.join("/"), first.message);
        errln!("  retry: {again} --only {}", first.only());
    }
}
