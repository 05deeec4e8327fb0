//! Progress of a run: bars on a terminal, lines elsewhere, JSON for programs. Bars of finished nodes fold into the last
//! line, which is of the whole run, so that all of them fit a terminal of 24 rows and 80 columns.

use super::{seconds_text, terminal};
use crate::{
    engine::event::{Event, Name},
    pipeline::Pipeline,
    query::{Expected, LongAction, NodeState, Overall, RunState},
};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::{
    collections::BTreeMap,
    io::Write,
    sync::{
        Mutex, PoisonError,
        mpsc::{Receiver, Sender, channel},
    },
    time::{Duration, Instant},
};

/// A line at most this often, for each node.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// A line of the whole run at most this often.
const OVERALL_EVERY: Duration = Duration::from_secs(30);
/// After this time, the line of the whole run appears without an estimate.
const ESTIMATED: Duration = Duration::from_secs(1);
/// Bars at most, so that a terminal of 24 rows holds them and the line of the whole run.
const MOST_BARS: usize = 21;

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
fn node_text(node: &NodeState, known: bool, queued: u64) -> String {
    let more = if known { "" } else { "+" };
    let counts = node.counts();
    let mut parts = vec![format!("{}/{}{more}", counts.done(), counts.expected)];
    let told = [
        (counts.hit, "as before"),
        (queued, "queued"),
        (counts.running, "running"),
        (counts.failed, "failed"),
        (counts.blocked, "blocked"),
    ];
    parts.extend(told.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")));
    parts.extend(node.eta().map(|eta| format!("{} to go", seconds_text(eta))));
    parts.join(", ")
}

/// The whole run: nodes, time, time to go.
fn overall_text(overall: Overall, elapsed: Duration) -> String {
    let Overall { done, nodes, left, known } = overall;
    let mut parts = vec![format!("{done}/{nodes} nodes done"), seconds_text(elapsed.as_secs_f64())];
    // More may follow, or not, from what is not known yet.
    parts.extend(left.map(|left| format!("{} {} to go", if known { "about" } else { "up to" }, seconds_text(left))));
    parts.join(", ")
}

/// See the module.
pub(crate) struct Display {
    json: bool,
    start: Instant,
    /// Who wants to hear that an action begins.
    asked: Mutex<Option<Sender<()>>>,
    bars: Option<MultiProgress>,
    state: Mutex<State>,
}

struct State {
    order: Vec<String>,
    run: RunState,
    shown: BTreeMap<String, Shown>,
    expected: Vec<Expected>,
    overall: Option<ProgressBar>,
    overall_told: Instant,
    /// Jobs of a scheduler that wait and run.
    jobs: Option<(u64, u64)>,
    /// Actions of each node in jobs that wait.
    queued: BTreeMap<Name, u64>,
    /// Nodes of which the last message told that they are rebuilt.
    rebuilding: Option<String>,
}

impl State {
    /// Bars of nodes and actions.
    fn bars(&self) -> usize {
        self.shown.values().map(|shown| usize::from(shown.bar.is_some()) + shown.parts.len()).sum()
    }
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
            None => errln!("{text}"),
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
        let (start, shown) = (Instant::now(), BTreeMap::new());
        let run = RunState::new(graph);
        let state = State {
            order,
            run,
            shown,
            expected: Vec::new(),
            overall: None,
            overall_told: start,
            jobs: None,
            queued: BTreeMap::new(),
            rebuilding: None,
        };
        Self { json, start, bars, state: Mutex::new(state), asked: Mutex::new(None) }
    }

    /// Hears once that an action begins; nothing comes if none does before the end. A run that has nothing to do needs
    /// no estimate.
    pub(crate) fn begun(&self) -> Receiver<()> {
        let (sender, receiver) = channel();
        if !self.json {
            *self.asked.lock().unwrap_or_else(PoisonError::into_inner) = Some(sender);
        }
        receiver
    }

    /// Takes what each node may do, by which the time to go is told.
    pub(crate) fn expect(&self, expected: Vec<Expected>) {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).expected = expected;
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
            Event::Begin { .. } => {
                let asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner).take();
                // Nobody listens any more if the estimate is there.
                if let Some(sender) = asked {
                    let _ = sender.send(());
                }
            }
            Event::Jobs { queued, running, waiting } => {
                let begun = state.jobs.is_none();
                state.jobs = Some((*queued, *running));
                // The first ones are told at once.
                if begun && self.bars.is_none() {
                    self.voice().say(&format!("jobs: {queued} queued, {running} running"));
                }
                let before = std::mem::replace(&mut state.queued, waiting.clone());
                let changed = |name: &&Name| before.get(*name) != waiting.get(*name);
                for name in before.keys().chain(waiting.keys()).filter(changed) {
                    self.update(&mut state, name);
                }
                self.update_overall(&mut state);
            }
            Event::Warning { message } => self.voice().say(&format!("warning: {message}")),
            Event::Healing { nodes } => {
                let nodes = nodes.join(", ");
                // Each pass may find more that is missing, of the same nodes.
                if state.rebuilding.as_ref() != Some(&nodes) {
                    self.voice().say(&format!("rebuilding results that are missing from the cache ({nodes})"));
                }
                state.rebuilding = Some(nodes);
                state.shown.values_mut().for_each(|shown| shown.told_end = false);
            }
            _ => {}
        }
        if let Some(node) = state.run.count(event) {
            self.update(&mut state, &node);
            self.update_overall(&mut state);
        }
    }

    /// The line of the whole run.
    fn update_overall(&self, state: &mut State) {
        let elapsed = self.start.elapsed();
        let due = state.overall_told.elapsed();
        let text = |state: &State| {
            let overall = state.run.overall(&state.expected, elapsed);
            let jobs = state.jobs.map(|(queued, running)| format!(", jobs: {queued} queued, {running} running"));
            (overall, overall_text(overall, elapsed) + &jobs.unwrap_or_default())
        };
        match &self.bars {
            Some(_) if due < Duration::from_millis(200) && state.overall.is_some() => return,
            // Before the estimate is there, nobody knows which nodes take part.
            Some(_) if state.expected.is_empty() && elapsed < ESTIMATED => return,
            Some(bars) => {
                let (overall, text) = text(state);
                let bar = state.overall.get_or_insert_with(|| {
                    bars.add(ProgressBar::new(0).with_style(style("{prefix} {bar:20.green/dim} {wide_msg}")))
                });
                bar.set_prefix("all");
                bar.set_length(overall.nodes as u64);
                bar.set_position(overall.done as u64);
                bar.set_message(text);
            }
            None if due < OVERALL_EVERY => return,
            None => errln!("all: {}", text(state).1),
        }
        state.overall_told = Instant::now();
    }

    /// Says things beside the bars, from any thread.
    pub(crate) fn voice(&self) -> Voice {
        Voice(self.bars.clone())
    }

    /// Leaves the bars of nodes that did not come to their end. The account of the run replaces the last line.
    pub(crate) fn end(&self) {
        drop(self.asked.lock().unwrap_or_else(PoisonError::into_inner).take());
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.shown.values().filter_map(|shown| shown.bar.as_ref()).for_each(ProgressBar::abandon);
        state.overall.iter().for_each(ProgressBar::finish_and_clear);
    }

    fn update(&self, state: &mut State, name: &str) {
        let queued = state.queued.get(name).copied().unwrap_or(0);
        let Some(node) = state.run.node(name).filter(|n| n.has_begun() || queued > 0) else { return };
        let (known, ended) = state.run.standing(name);
        match &self.bars {
            Some(bars) => {
                if ended {
                    // Folded into the line of the whole run.
                    if let Some(shown) = state.shown.get_mut(name) {
                        for bar in shown.bar.take().into_iter().chain(std::mem::take(&mut shown.parts).into_values()) {
                            bar.finish_and_clear();
                            bars.remove(&bar);
                        }
                    }
                    return;
                }
                if state.shown.get(name).is_none_or(|shown| shown.bar.is_none()) {
                    if state.bars() >= MOST_BARS {
                        return;
                    }
                    // Bars stand in the pipeline's order, whichever node begins first, each followed by its actions'.
                    let shown = |node: &String| state.shown.get(node);
                    let last = |shown: &Shown| shown.parts.values().last().or(shown.bar.as_ref()).cloned();
                    let place = state.order.iter().position(|node| node == name).unwrap_or(0);
                    let before = state.order[..place].iter().rev().find_map(|node| shown(node).and_then(last));
                    let bar = ProgressBar::new(0).with_style(style("{prefix:18!} {bar:12.cyan/dim} {wide_msg}"));
                    let bar = match before {
                        Some(before) => bars.insert_after(&before, bar),
                        None => bars.insert(0, bar),
                    };
                    bar.set_prefix(name.to_owned());
                    state.shown.entry(name.to_owned()).or_default().bar = Some(bar);
                }
                let room = MOST_BARS.saturating_sub(state.bars());
                let shown = state.shown.entry(name.to_owned()).or_default();
                let room = (room + shown.parts.len()).min(MOST_PARTS);
                let Some(bar) = &shown.bar else { return };
                // A thousand steps for each action, so that a long one moves its bar. As long as more may follow, the
                // estimate keeps the bar from being full.
                let place = state.order.iter().position(|node| node == name);
                let more = place.and_then(|place| state.expected.get(place)).filter(|_| !known);
                let expected = (node.counts().expected as f64).max(more.map_or(0.0, |more| more.actions));
                bar.set_length((expected * 1000.0) as u64);
                bar.set_position((node.position() * 1000.0) as u64);
                bar.set_message(node_text(node, known, queued));
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
                for (at, long) in node.long(LONG).take(room) {
                    let part = parts.entry(at.clone()).or_insert_with(|| {
                        let part = ProgressBar::new(long.total)
                            .with_style(style("  {prefix:28!.dim} {bar:12.cyan/dim} {wide_msg:.dim}"));
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
                    errln!("{name}: {}", node_text(node, known, queued));
                    for (at, long) in node.long(LONG).take(MOST_PARTS) {
                        errln!("  {}: {}", title(at), long_text(long));
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
    fn the_whole_run_is_one_line() {
        let overall = Overall { done: 3, nodes: 12, left: Some(90.0), known: false };
        let seconds = Duration::from_secs(65);
        assert_eq!(overall_text(overall, seconds), "3/12 nodes done, 65.0 s, up to 90.0 s to go");
        let known = Overall { known: true, ..overall };
        assert_eq!(overall_text(known, seconds), "3/12 nodes done, 65.0 s, about 90.0 s to go");
        // Its name and its bar take 25 of 80 columns.
        let long = Overall { done: 100, nodes: 100, left: Some(4e5), known: true };
        assert_eq!(
            overall_text(long, Duration::from_secs(360_000)),
            "100/100 nodes done, 100 h 00 min, about 111 h 06 min to go"
        );
    }

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
        let line = |run: &RunState, known| node_text(run.node("n").expect("it was counted"), known, 0);
        assert_eq!(line(&run, false), "0/4+, 1 running");
        assert_eq!(node_text(run.node("n").expect("it was counted"), true, 3), "0/4, 3 queued, 1 running");
        run.count(&end("a", Ended::Ran));
        run.count(&end("b", Ended::Failed));
        run.count(&end("c", Ended::Blocked));
        run.count(&end("d", Ended::Hit));
        assert_eq!(line(&run, true), "4/4, 1 as before, 1 failed, 1 blocked");
    }
}
