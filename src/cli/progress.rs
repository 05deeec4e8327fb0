//! How a run looks while it goes on: bars on a terminal, lines elsewhere, JSON for programs.

use super::tally::Tally;
use crate::{engine::event::Event, pipeline::Pipeline};
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

struct State {
    order: Vec<String>,
    tally: Tally,
    shown: BTreeMap<String, Shown>,
}

/// What was shown of a node.
#[derive(Default)]
struct Shown {
    bar: Option<ProgressBar>,
    told: Option<Instant>,
    told_end: bool,
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
        let order: Vec<String> = pipeline.nodes.iter().map(|n| n.name.clone()).collect();
        let graph = order.iter().enumerate().map(|(n, name)| (name.clone(), pipeline.reads(n))).collect();
        let state = State { order, tally: Tally::new(graph), shown: BTreeMap::new() };
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
                let nodes = nodes.join(", ");
                self.voice().say(&format!("making again what is needed and is not in the cache ({nodes})"));
                state.shown.values_mut().for_each(|shown| shown.told_end = false);
            }
            _ => {}
        }
        if let Some(node) = state.tally.count(event) {
            self.update(&mut state, &node);
        }
    }

    /// Says things beside the bars, from any thread.
    pub(crate) fn voice(&self) -> Voice {
        Voice(self.bars.clone())
    }

    /// Leaves the bars as they are.
    pub(crate) fn end(&self) {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.shown.values().filter_map(|shown| shown.bar.as_ref()).for_each(ProgressBar::abandon);
    }

    fn update(&self, state: &mut State, name: &str) {
        let Some(node) = state.tally.node(name).filter(|n| n.has_begun()) else { return };
        let (known, ended) = state.tally.standing(name);
        match &self.bars {
            Some(bars) => {
                let place = |n: &str| state.order.iter().position(|o| o == n);
                // Bars stand in the pipeline's order, whichever node begins first.
                let before = state.shown.keys().filter(|n| place(n) < place(name)).count();
                let bar = state.shown.entry(name.to_owned()).or_default().bar.get_or_insert_with(|| {
                    let style = ProgressStyle::with_template("{prefix:18} {bar:24.cyan/dim} {wide_msg}")
                        .unwrap_or_else(|_| ProgressStyle::default_bar())
                        .progress_chars("━━─");
                    let bar = bars.insert(before, ProgressBar::new(0).with_style(style));
                    bar.set_prefix(name.to_owned());
                    bar
                });
                // A thousand steps for each action, so that a long one moves its bar.
                bar.set_length(node.expected() * 1000);
                bar.set_position((node.position() * 1000.0) as u64);
                bar.set_message(node.text(known));
            }
            None => {
                let shown = state.shown.entry(name.to_owned()).or_default();
                let due = shown.told.is_none_or(|told| told.elapsed() >= LINE_EVERY);
                if (ended && !shown.told_end) || (!ended && due) {
                    shown.told = Some(Instant::now());
                    shown.told_end = ended;
                    eprintln!("{name}: {}", node.text(known));
                }
            }
        }
    }
}
