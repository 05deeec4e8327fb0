//! Watches a run from within its process: writes its [`LiveState`] and its page while it goes on, and its page at its
//! end.
//!
//! A thread of its own writes, so that no disk delays the run. No result depends on it: where it cannot write, it says
//! so once, and the run goes on. A run that does nothing leaves the page of the one that did the work.

use super::{
    RunRecord,
    live::{LiveAction, LiveNode, LiveState, Process},
    timeline::{Bar, Timeline},
};
use crate::{
    engine::{
        event::{Ended, Event, Failure, Name},
        publish,
    },
    pipeline::Pipeline,
    query::{NodeState, RunState},
};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

/// How often the state is written, at most.
const STATE_EVERY: Duration = Duration::from_secs(1);
/// How often it is written if nothing happens.
const HEARTBEAT: Duration = Duration::from_secs(5);
/// How often the page is written, at most.
const PAGE_EVERY: Duration = Duration::from_secs(2);
/// Failures that are told with their messages.
const MOST_FAILURES: usize = 50;
/// Actions in flight that are told one by one.
const MOST_ACTIONS: usize = 64;

/// The content of a page.
pub struct Shown<'a> {
    /// How far the run is.
    pub state: &'a LiveState,
    /// When its actions took place.
    pub timeline: &'a Timeline,
    /// Its record, once it has ended.
    pub ended: Option<&'a RunRecord>,
    /// The files that it wrote.
    pub published: &'a [PathBuf],
}

/// The page of a run.
pub struct PageFile {
    /// Its file.
    pub path: PathBuf,
    /// Its text.
    pub html: Box<dyn Fn(&Shown<'_>) -> String + Send + Sync>,
}

impl PageFile {
    fn write(&self, shown: &Shown<'_>) -> Result<(), String> {
        publish::write(&self.path, (self.html)(shown).as_bytes()).map_err(|error| error.to_string())
    }
}

/// See the module.
pub struct Observer {
    shared: Arc<Shared>,
    page: Arc<PageFile>,
    writer: Option<JoinHandle<()>>,
}

struct Shared {
    seen: Mutex<Seen>,
    /// The run has ended.
    ended: Condvar,
}

/// The events so far.
struct Seen {
    began: Instant,
    base: LiveState,
    /// Names and kinds of the nodes that are needed, in the pipeline's order.
    nodes: Vec<(Name, String)>,
    counts: RunState,
    spent_s: BTreeMap<Name, f64>,
    flights: BTreeMap<(Name, Name, Name), Flight>,
    free: BTreeSet<usize>,
    tracks: usize,
    timeline: Timeline,
    failures: Vec<Failure>,
    failed: u64,
    changed: bool,
    /// Something ran or failed.
    worked: bool,
    /// Files that could not be written, for people.
    notes: Vec<String>,
    over: bool,
}

/// An action in flight; two output groups of an item may be.
struct Flight {
    began: Vec<(Instant, usize)>,
    done: u64,
    total: u64,
    message: String,
}

impl Seen {
    fn count(&mut self, event: &Event) {
        self.changed = true;
        self.worked |= matches!(event, Event::Begin { .. } | Event::Failed { .. });
        let now = Instant::now();
        match event {
            Event::Started { nodes, .. } => {
                let needed: BTreeSet<&Name> = nodes.iter().collect();
                self.nodes.retain(|(node, _)| needed.contains(node));
            }
            Event::Begin { node, cell, item } => {
                let track = self.free.pop_first().unwrap_or_else(|| {
                    self.tracks += 1;
                    self.tracks - 1
                });
                let flight = self.flights.entry((node.clone(), cell.clone(), item.clone()));
                let fresh = || Flight { began: Vec::new(), done: 0, total: 0, message: String::new() };
                flight.or_insert_with(fresh).began.push((now, track));
            }
            Event::Progress { node, cell, item, done, total, message } => {
                if let Some(flight) = self.flights.get_mut(&(node.clone(), cell.clone(), item.clone())) {
                    (flight.done, flight.total) = (*done, *total);
                    flight.message.clone_from(message);
                }
            }
            Event::End { node, cell, item, outcome, wall_us, .. } => {
                if *outcome == Ended::Ran {
                    *self.spent_s.entry(node.clone()).or_default() += *wall_us as f64 / 1e6;
                }
                let at = (node.clone(), cell.clone(), item.clone());
                if let Some(flight) = self.flights.get_mut(&at) {
                    let ended = flight.began.pop();
                    if flight.began.is_empty() {
                        self.flights.remove(&at);
                    }
                    if let Some((began, track)) = ended {
                        self.free.insert(track);
                        let since = |time: Instant| time.saturating_duration_since(self.began).as_secs_f64();
                        let (node, cell, item) = at;
                        let (from, to, failed) = (since(began), since(now), *outcome == Ended::Failed);
                        self.timeline.push(track, Bar { node, cell, item, from, to, actions: 1, failed });
                    }
                }
            }
            Event::Failed { of } => {
                self.failed += 1;
                if self.failures.len() < MOST_FAILURES {
                    self.failures.push(of.clone());
                }
            }
            // Another pass tries again.
            Event::Healing { .. } => {
                self.failures.clear();
                self.failed = 0;
            }
            _ => {}
        }
        self.counts.count(event);
    }

    fn state(&self) -> LiveState {
        let node = |(name, kind): &(Name, String)| LiveNode {
            node: name.to_string(),
            kind: kind.clone(),
            counts: self.counts.node(name).map(NodeState::counts).unwrap_or_default(),
            known: self.counts.standing(name).0,
            spent_s: self.spent_s.get(name).copied().unwrap_or(0.0),
        };
        let action = |((node, cell, item), flight): (&(Name, Name, Name), &Flight)| LiveAction {
            node: node.clone(),
            cell: cell.clone(),
            item: item.clone(),
            for_s: flight.began.first().map_or(0.0, |(began, _)| began.elapsed().as_secs_f64()),
            done: flight.done,
            total: flight.total,
            message: flight.message.clone(),
        };
        let mut running: Vec<LiveAction> = self.flights.iter().map(action).collect();
        running.sort_by(|a, b| b.for_s.total_cmp(&a.for_s));
        running.truncate(MOST_ACTIONS);
        LiveState {
            elapsed_s: self.began.elapsed().as_secs_f64(),
            nodes: self.nodes.iter().map(node).collect(),
            running,
            in_flight: self.flights.values().map(|flight| flight.began.len() as u64).sum(),
            failures: self.failures.clone(),
            failed: self.failed,
            ..self.base.clone()
        }
    }
}

impl Shared {
    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes until the run has ended.
    fn write(&self, cache: &Path, page: &PageFile) {
        let (mut stated, mut paged): (Option<Instant>, Option<Instant>) = (None, None);
        let (mut said_state, mut said_page) = (false, false);
        loop {
            let mut seen = self.seen();
            let due = |seen: &Seen| {
                let quiet = stated.map_or(HEARTBEAT, |time| time.elapsed());
                seen.over || quiet >= HEARTBEAT || (seen.changed && quiet >= STATE_EVERY)
            };
            while !due(&seen) {
                let (next, _) = self.ended.wait_timeout(seen, STATE_EVERY / 4).unwrap_or_else(PoisonError::into_inner);
                seen = next;
            }
            if seen.over {
                return;
            }
            seen.changed = false;
            let mut state = seen.state();
            let page_due = seen.worked && paged.is_none_or(|time| time.elapsed() >= PAGE_EVERY);
            let timeline = page_due.then(|| seen.timeline.clone());
            drop(seen);
            stated = Some(Instant::now());
            if let Err(error) = state.write(cache)
                && !said_state
            {
                said_state = true;
                self.seen().notes.push(format!("`tauflow status` cannot show this run: {error}"));
            }
            if let Some(timeline) = timeline {
                paged = Some(Instant::now());
                let shown = Shown { state: &state, timeline: &timeline, ended: None, published: &[] };
                if let Err(error) = page.write(&shown)
                    && !said_page
                {
                    said_page = true;
                    self.seen().notes.push(format!("the page of this run is not up to date: {error}"));
                }
            }
        }
    }
}

impl Observer {
    /// Watches a run with this record, which is in the cache already.
    pub fn start(pipeline: &Pipeline, record: &RunRecord, cache: PathBuf, page: PageFile) -> Self {
        let graph = pipeline.nodes.iter().enumerate().map(|(n, node)| (node.name.clone(), pipeline.reads(n))).collect();
        let base = LiveState {
            id: record.id.clone(),
            pipeline: record.pipeline.clone(),
            file: record.file.clone(),
            process: Process::here(),
            started: record.started,
            ..LiveState::default()
        };
        let nodes = pipeline.nodes.iter().map(|node| (node.name.as_str().into(), node.spec.name.to_owned()));
        let seen = Seen {
            began: Instant::now(),
            base,
            nodes: nodes.collect(),
            counts: RunState::new(graph),
            spent_s: BTreeMap::new(),
            flights: BTreeMap::new(),
            free: BTreeSet::new(),
            tracks: 0,
            timeline: Timeline::default(),
            failures: Vec::new(),
            failed: 0,
            changed: true,
            worked: false,
            notes: Vec::new(),
            over: false,
        };
        let shared = Arc::new(Shared { seen: Mutex::new(seen), ended: Condvar::new() });
        let page = Arc::new(page);
        let (writing, written) = (shared.clone(), page.clone());
        let writer = thread::Builder::new().spawn(move || writing.write(&cache, &written)).ok();
        Self { shared, page, writer }
    }

    /// Takes an event in.
    pub fn observe(&self, event: &Event) {
        self.shared.seen().count(event);
    }

    /// Writes the page once more, with how the run ended; what could not be written, for people.
    pub fn conclude(mut self, record: &RunRecord, published: &[PathBuf]) -> Vec<String> {
        self.stop();
        let mut seen = self.shared.seen();
        let mut notes = std::mem::take(&mut seen.notes);
        if seen.worked || !self.page.path.exists() {
            let state = seen.state();
            let shown = Shown { state: &state, timeline: &seen.timeline, ended: Some(record), published };
            if let Err(error) = self.page.write(&shown) {
                notes.push(format!("the page of this run is not written: {error}"));
            }
        }
        drop(seen);
        notes
    }

    /// Writes no more.
    fn stop(&mut self) {
        self.shared.seen().over = true;
        self.shared.ended.notify_all();
        if let Some(writer) = self.writer.take() {
            // A panic of the writer is no matter of the run.
            let _ = writer.join();
        }
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        self.stop();
    }
}
