//! How a run looks while it goes on: bars on a terminal, lines elsewhere, JSON for programs.

use super::seconds_text;
use crate::{
    engine::event::{Ended, Event},
    pipeline::Pipeline,
};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::{
    collections::BTreeMap,
    io::{IsTerminal, Write},
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

/// A line at most this often, for each node.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// See the module.
pub(crate) struct Display {
    json: bool,
    bars: Option<MultiProgress>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    order: Vec<String>,
    nodes: BTreeMap<String, NodeState>,
}

#[derive(Default)]
struct NodeState {
    expected: u64,
    /// All its actions are known.
    counted: bool,
    hit: u64,
    ran: u64,
    failed: u64,
    blocked: u64,
    running: u64,
    started: Option<Instant>,
    told: Option<Instant>,
    told_done: bool,
    /// Units of the long actions in flight, by cell and item.
    long: BTreeMap<(String, String), (u64, u64, String)>,
    bar: Option<ProgressBar>,
}

impl NodeState {
    fn done(&self) -> u64 {
        self.hit + self.ran + self.failed + self.blocked
    }

    /// Done actions, and the parts of those in flight.
    fn position(&self) -> f64 {
        let parts = self.long.values().map(|(done, total, _)| *done as f64 / (*total).max(1) as f64);
        self.done() as f64 + parts.sum::<f64>()
    }

    /// Seconds to go, from what ran so far.
    fn eta(&self) -> Option<f64> {
        let elapsed = self.started?.elapsed().as_secs_f64();
        let worked = self.position() - (self.hit + self.blocked) as f64;
        let left = self.expected as f64 - self.position();
        (worked > 0.0 && left > 0.0 && elapsed > 1.0).then(|| elapsed / worked * left)
    }

    fn text(&self) -> String {
        let mut parts = Vec::new();
        let unknown = if self.counted { "" } else { "+" };
        parts.push(format!("{}/{}{unknown}", self.done(), self.expected));
        let mut count = |n: u64, what: &str| {
            if n > 0 {
                parts.push(format!("{n} {what}"));
            }
        };
        count(self.hit, "as before");
        count(self.running, "running");
        count(self.failed, "failed");
        count(self.blocked, "blocked");
        if let Some(eta) = self.eta() {
            parts.push(format!("{} to go", seconds_text(eta)));
        }
        if let Some((done, total, message)) = self.long.values().find(|(_, _, m)| !m.is_empty()) {
            parts.push(format!("{done}/{total} {message}"));
        }
        parts.join(", ")
    }
}

/// Lines for people on stderr, above the bars if there are any.
pub(crate) struct Voice(Option<MultiProgress>);

impl Voice {
    pub(crate) fn say(&self, text: &str) {
        match &self.0 {
            Some(bars) => {
                // The terminal going away must not stop the run.
                let _ = bars.println(text);
            }
            None => eprintln!("{text}"),
        }
    }
}

impl Display {
    pub(crate) fn new(pipeline: &Pipeline, json: bool) -> Self {
        let terminal = std::io::stderr().is_terminal() && !json;
        let bars = terminal.then(|| MultiProgress::with_draw_target(ProgressDrawTarget::stderr_with_hz(10)));
        let state = State { order: pipeline.nodes.iter().map(|n| n.name.clone()).collect(), ..State::default() };
        Self { json, bars, state: Mutex::new(state) }
    }

    pub(crate) fn show(&self, event: &Event) {
        if self.json {
            let line = serde_json::to_string(event).expect("events are plain data");
            // A reader that has gone away must not stop the run.
            let _ = writeln!(std::io::stdout(), "{line}");
            return;
        }
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        match event {
            Event::Warning { message } => self.voice().say(&format!("warning: {message}")),
            Event::Healing { nodes } => {
                self.voice().say(&format!("some results are gone from the cache; making them again ({})", nodes.join(", ")));
                for node in state.nodes.values_mut() {
                    let bar = node.bar.take();
                    *node = NodeState { bar, ..NodeState::default() };
                }
            }
            Event::Started { .. } | Event::Finished { .. } => {}
            Event::Unchanged { node, actions, .. } => {
                let node = state.nodes.entry(node.clone()).or_default();
                node.expected += actions;
                node.hit += actions;
            }
            Event::Expect { node, actions } => {
                let entry = state.nodes.entry(node.clone()).or_default();
                entry.expected += actions;
                self.update(&mut state, node, false);
            }
            Event::Counted { node } => {
                let entry = state.nodes.entry(node.clone()).or_default();
                entry.counted = true;
                let ended = entry.done() == entry.expected;
                self.update(&mut state, node, ended);
            }
            Event::Begin { node, .. } => {
                let entry = state.nodes.entry(node.clone()).or_default();
                entry.running += 1;
                entry.started.get_or_insert_with(Instant::now);
                self.update(&mut state, node, false);
            }
            Event::Progress { node, cell, item, done, total, message } => {
                let entry = state.nodes.entry(node.clone()).or_default();
                entry.long.insert((cell.clone(), item.clone()), (*done, *total, message.clone()));
                self.update(&mut state, node, false);
            }
            Event::End { node, cell, item, outcome, .. } => {
                let entry = state.nodes.entry(node.clone()).or_default();
                entry.long.remove(&(cell.clone(), item.clone()));
                match outcome {
                    Ended::Hit => entry.hit += 1,
                    Ended::Ran | Ended::WouldRun => entry.ran += 1,
                    Ended::Failed => entry.failed += 1,
                    Ended::Blocked => entry.blocked += 1,
                }
                if !matches!(outcome, Ended::Blocked) {
                    entry.running = entry.running.saturating_sub(1);
                }
                let ended = entry.counted && entry.done() == entry.expected;
                self.update(&mut state, node, ended);
            }
        }
    }

    /// Says things beside the bars, from any thread.
    pub(crate) fn voice(&self) -> Voice {
        Voice(self.bars.clone())
    }

    /// Leaves the bars as they are.
    pub(crate) fn end(&self) {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        for node in state.nodes.values() {
            if let Some(bar) = &node.bar {
                bar.abandon();
            }
        }
    }


    fn update(&self, state: &mut State, name: &str, ended: bool) {
        let place = |n: &str| state.order.iter().position(|o| o == n);
        let mine = place(name);
        // Bars stand in the pipeline's order, whichever node begins first.
        let before = state.nodes.iter().filter(|(n, s)| s.bar.is_some() && place(n) < mine).count();
        let Some(node) = state.nodes.get_mut(name) else { return };
        if node.started.is_none() && node.failed == 0 {
            return;
        }
        let (position, text) = (node.position(), node.text());
        match &self.bars {
            Some(bars) => {
                let bar = node.bar.get_or_insert_with(|| {
                    let style = ProgressStyle::with_template("{prefix:18} {bar:24.cyan/dim} {msg}")
                        .unwrap_or_else(|_| ProgressStyle::default_bar())
                        .progress_chars("━━─");
                    let bar = bars.insert(before, ProgressBar::new(0).with_style(style));
                    bar.set_prefix(name.to_owned());
                    bar
                });
                // A thousand steps for each action, so that a long one moves its bar.
                bar.set_length(node.expected * 1000);
                bar.set_position((position * 1000.0) as u64);
                bar.set_message(text);
            }
            None => {
                let due = node.told.is_none_or(|told| told.elapsed() >= LINE_EVERY);
                if (ended && !node.told_done) || (!ended && due) {
                    node.told = Some(Instant::now());
                    node.told_done = ended;
                    eprintln!("{name}: {text}");
                }
            }
        }
    }
}
