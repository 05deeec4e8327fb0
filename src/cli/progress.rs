//! Progress of a run: bars on a terminal, lines elsewhere, JSON for programs.

use super::{seconds_text, terminal};
use crate::{
    engine::event::{Event, Name},
    pipeline::Pipeline,
    query::{LongAction, NodeState, RunState},
};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::{
    collections::BTreeMap,
    io::Write,
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

/// A line at most this often, for each node.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// Actions that take at least this long are shown one by one.
const LONG: Duration = Duration::from_secs(2);
/// Long actions of a node that are shown one by one, at most.
const MOST_PARTS: usize = 8;

fn style(template: &str) -> ProgressStyle {
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    style.progress_chars("━━─")
}

/// The name of an action within its node: the values of its cell, and its item.
fn title((cell, item): &(Name, Name)) -> String {
    let values = cell.split('+').filter_map(|pair| pair.split_once('=').map(|(_, value)| value));
    values.chain((!item.is_empty()).then_some(&**item)).collect::<Vec<_>>().join(" ")
}

/// Done of total, the news, and the time to go.
fn long_text(long: &LongAction) -> String {
    let eta = long.eta().map(|eta| format!("  {} to go", seconds_text(eta))).unwrap_or_default();
    format!("{}/{}  {}{eta}", long.done, long.total, long.message)
}

/// A line: done of expected (with a `+` unless all are known), what became of them, time to go.
fn node_text(node: &NodeState, known: bool) -> String {
    let more = if known { "" } else { "+" };
    let counts = node.counts();
    let mut parts = vec![format!("{}/{}{more}", counts.done(), counts.expected)];
    let told = [
        (counts.hit, "as before"),
        (counts.running, "running"),
        (counts.failed, "failed"),
        (counts.blocked, "blocked"),
    ];
    parts.extend(told.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")));
    parts.extend(node.eta().map(|eta| format!("{} to go", seconds_text(eta))));
    parts.join(", ")
}

/// See the module.
pub(crate) struct Display {
    json: bool,
    bars: Option<MultiProgress>,
    state: Mutex<State>,
}

struct State {
    order: Vec<String>,
    run: RunState,
    shown: BTreeMap<String, Shown>,
}

/// The displayed state of a node.
#[derive(Default)]
struct Shown {
    bar: Option<ProgressBar>,
    /// Its long running actions, by cell and item.
    parts: BTreeMap<(Name, Name), ProgressBar>,
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
        let terminal = terminal::redraws() && !json;
        let bars = terminal.then(|| MultiProgress::with_draw_target(ProgressDrawTarget::stderr_with_hz(10)));
        terminal::show_notes_above(bars.as_ref());
        let order: Vec<String> = pipeline.nodes.iter().map(|n| n.name.clone()).collect();
        let graph = order.iter().enumerate().map(|(n, name)| (name.clone(), pipeline.reads(n))).collect();
        let state = State { order, run: RunState::new(graph), shown: BTreeMap::new() };
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
                self.voice().say(&format!("rebuilding results that are missing from the cache ({nodes})"));
                state.shown.values_mut().for_each(|shown| shown.told_end = false);
            }
            _ => {}
        }
        if let Some(node) = state.run.count(event) {
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
        let Some(node) = state.run.node(name).filter(|n| n.has_begun()) else { return };
        let (known, ended) = state.run.standing(name);
        match &self.bars {
            Some(bars) => {
                if state.shown.get(name).is_none_or(|shown| shown.bar.is_none()) {
                    // Bars stand in the pipeline's order, whichever node begins first, each followed by its actions'.
                    let shown = |node: &String| state.shown.get(node);
                    let last = |shown: &Shown| shown.parts.values().last().or(shown.bar.as_ref()).cloned();
                    let place = state.order.iter().position(|node| node == name).unwrap_or(0);
                    let before = state.order[..place].iter().rev().find_map(|node| shown(node).and_then(last));
                    let bar = ProgressBar::new(0).with_style(style("{prefix:18} {bar:24.cyan/dim} {wide_msg}"));
                    let bar = match before {
                        Some(before) => bars.insert_after(&before, bar),
                        None => bars.insert(0, bar),
                    };
                    bar.set_prefix(name.to_owned());
                    state.shown.entry(name.to_owned()).or_default().bar = Some(bar);
                }
                let shown = state.shown.entry(name.to_owned()).or_default();
                let Some(bar) = &shown.bar else { return };
                // A thousand steps for each action, so that a long one moves its bar.
                bar.set_length(node.counts().expected * 1000);
                bar.set_position((node.position() * 1000.0) as u64);
                bar.set_message(node_text(node, known));
                let mut last = bar.clone();
                let parts = &mut shown.parts;
                parts.retain(|at, part| {
                    let goes_on = node.long(LONG).any(|(other, _)| other == at);
                    if !goes_on {
                        part.finish_and_clear();
                        bars.remove(part);
                    }
                    goes_on
                });
                for (at, long) in node.long(LONG).take(MOST_PARTS) {
                    let part = parts.entry(at.clone()).or_insert_with(|| {
                        let part = ProgressBar::new(long.total)
                            .with_style(style("  {prefix:28.dim} {bar:12.cyan/dim} {wide_msg:.dim}"));
                        let part = bars.insert_after(&last, part);
                        part.set_prefix(title(at));
                        part
                    });
                    part.set_position(long.done);
                    part.set_message(long_text(long));
                    last = part.clone();
                }
            }
            None => {
                let shown = state.shown.entry(name.to_owned()).or_default();
                let due = shown.told.is_none_or(|told| told.elapsed() >= LINE_EVERY);
                if (ended && !shown.told_end) || (!ended && due) {
                    shown.told = Some(Instant::now());
                    shown.told_end = ended;
                    eprintln!("{name}: {}", node_text(node, known));
                    for (at, long) in node.long(LONG).take(MOST_PARTS) {
                        eprintln!("  {}: {}", title(at), long_text(long));
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::event::Ended;

    #[test]
    fn a_line_says_what_became_of_a_node_s_actions() {
        let mut run = RunState::new(vec![("n".into(), vec![])]);
        let name = |text: &str| Name::from(text);
        run.count(&Event::Expect { node: name("n"), actions: 4 });
        run.count(&Event::Begin { node: name("n"), cell: name(""), item: name("a") });
        let end = |item: &str, outcome| {
            let (node, cell, group) = (name("n"), name(""), name("main"));
            Event::End { node, cell, item: name(item), group, outcome, wall_us: 1, bytes: 1 }
        };
        let line = |run: &RunState, known| node_text(run.node("n").expect("it was counted"), known);
        assert_eq!(line(&run, false), "0/4+, 1 running");
        run.count(&end("a", Ended::Ran));
        run.count(&end("b", Ended::Failed));
        run.count(&end("c", Ended::Blocked));
        run.count(&end("d", Ended::Hit));
        assert_eq!(line(&run, true), "4/4, 1 as before, 1 failed, 1 blocked");
    }
}
