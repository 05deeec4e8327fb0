//! The state of a run, node by node, counted from its events.

use crate::engine::event::{Ended, Event, Name};
use serde::{Deserialize, Serialize, Serializer};
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

/// The state of a run.
pub struct RunState {
    /// The nodes in an order in which each stands after those that it reads, and the numbers of these.
    graph: Vec<(String, Vec<usize>)>,
    nodes: BTreeMap<Name, NodeState>,
}

/// The state of a node.
#[derive(Default)]
pub struct NodeState {
    expected: u64,
    hit: u64,
    ran: u64,
    failed: u64,
    blocked: u64,
    /// Actions in flight, by cell and item; two output groups of an item may be.
    running: BTreeMap<(Name, Name), u64>,
    started: Option<Instant>,
    /// The long actions in flight, by cell and item.
    long: BTreeMap<(Name, Name), LongAction>,
}

/// The state of a long action.
pub struct LongAction {
    /// Units done.
    pub done: u64,
    /// The total number of units.
    pub total: u64,
    /// Its news.
    pub message: String,
    /// When it was first heard of, and how much was done by then: a resumed one begins in the middle.
    since: (Instant, u64),
}

impl LongAction {
    /// Seconds to go, once that can be told.
    pub fn eta(&self) -> Option<f64> {
        let (worked, elapsed) =
            ((self.done - self.since.1.min(self.done)) as f64, self.since.0.elapsed().as_secs_f64());
        let left = self.total.saturating_sub(self.done) as f64;
        (worked > 0.0 && left > 0.0 && elapsed > 1.0).then(|| elapsed / worked * left)
    }
}

impl Serialize for LongAction {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct View<'a> {
            done: u64,
            total: u64,
            message: &'a str,
            seconds_left: Option<f64>,
        }
        let Self { done, total, message, .. } = self;
        View { done: *done, total: *total, message, seconds_left: self.eta() }.serialize(serializer)
    }
}

impl Serialize for NodeState {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Running<'a> {
            cell: &'a str,
            item: &'a str,
            /// Its progress, if it reports any.
            progress: Option<&'a LongAction>,
        }
        #[derive(Serialize)]
        struct View<'a> {
            counts: Counts,
            /// Done actions, and the parts of those in flight.
            position: f64,
            seconds_left: Option<f64>,
            running: Vec<Running<'a>>,
        }
        let running = self.running.keys().map(|at| Running { cell: &at.0, item: &at.1, progress: self.long.get(at) });
        let (counts, position, seconds_left) = (self.counts(), self.position(), self.eta());
        View { counts, position, seconds_left, running: running.collect() }.serialize(serializer)
    }
}

/// The nodes in the order of the graph, each with what is known of it.
impl Serialize for RunState {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct View<'a> {
            node: &'a str,
            /// All actions are known.
            known: bool,
            /// All actions are done.
            done: bool,
            /// Missing if no event named the node yet.
            state: Option<&'a NodeState>,
        }
        serializer.collect_seq(self.graph.iter().map(|(node, _)| {
            let (known, done) = self.standing(node);
            View { node, known, done, state: self.node(node) }
        }))
    }
}

/// The state of a whole run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Overall {
    /// Nodes of which all actions are done.
    pub done: usize,
    /// Nodes that take part.
    pub nodes: usize,
    /// Seconds to go, if that can be told, from the times of earlier actions and the pace of this run.
    pub left: Option<f64>,
    /// Whether all actions are known, so that no more can follow.
    pub known: bool,
}

/// The expected actions of a node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Expected {
    /// Its actions, or more.
    pub actions: f64,
    /// Seconds of each; none if its kind never ran.
    pub seconds: Option<f64>,
}

/// Numbers of a node's actions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Known of.
    pub expected: u64,
    /// Done before.
    pub hit: u64,
    /// Done now.
    pub ran: u64,
    /// Failed.
    pub failed: u64,
    /// Could not begin, because others failed.
    pub blocked: u64,
    /// In flight.
    pub running: u64,
}

impl Counts {
    /// Those that came to an end.
    pub fn done(&self) -> u64 {
        [self.ran, self.failed, self.blocked].into_iter().fold(self.hit, u64::saturating_add)
    }
}

impl RunState {
    /// The state of nodes in topological order, each with the numbers of the nodes that it reads.
    pub fn new(graph: Vec<(String, Vec<usize>)>) -> Self {
        Self { graph, nodes: BTreeMap::new() }
    }

    /// Counts an event; the node whose standing it changed.
    pub fn count(&mut self, event: &Event) -> Option<Name> {
        let name = match event {
            Event::Started { .. }
            | Event::Finished { .. }
            | Event::Jobs { .. }
            | Event::Warning { .. }
            | Event::Failed { .. } => return None,
            Event::Healing { .. } => {
                self.nodes.clear();
                return None;
            }
            Event::Unchanged { node, .. }
            | Event::Expect { node, .. }
            | Event::Counted { node }
            | Event::Begin { node, .. }
            | Event::Progress { node, .. }
            | Event::End { node, .. } => node,
        };
        let node = self.nodes.entry(name.clone()).or_default();
        match event {
            Event::Unchanged { actions, .. } => {
                // A record may say any number.
                node.expected = node.expected.saturating_add(*actions);
                node.hit = node.hit.saturating_add(*actions);
            }
            Event::Expect { actions, .. } => node.expected = node.expected.saturating_add(*actions),
            Event::Begin { cell, item, .. } => {
                *node.running.entry((cell.clone(), item.clone())).or_insert(0) += 1;
                node.started.get_or_insert_with(Instant::now);
            }
            Event::Progress { cell, item, done, total, message, .. } => {
                let at = (cell.clone(), item.clone());
                let since = node.long.get(&at).map_or_else(|| (Instant::now(), *done), |long| long.since);
                node.long.insert(at, LongAction { done: *done, total: *total, message: message.clone(), since });
            }
            Event::End { cell, item, outcome, .. } => {
                let at = (cell.clone(), item.clone());
                node.long.remove(&at);
                // Cached and blocked actions are not running.
                if let Some(running) = node.running.get_mut(&at) {
                    *running -= 1;
                    if *running == 0 {
                        node.running.remove(&at);
                    }
                }
                match outcome {
                    Ended::Hit => node.hit += 1,
                    Ended::Ran | Ended::WouldRun => node.ran += 1,
                    Ended::Failed => node.failed += 1,
                    Ended::Blocked => node.blocked += 1,
                }
            }
            _ => {}
        }
        Some(name.clone())
    }

    /// Whether all actions of a node are known, and whether all are done. They are known once what it reads is done.
    pub fn standing(&self, name: &str) -> (bool, bool) {
        let mut ended = Vec::with_capacity(self.graph.len());
        for (node, reads) in &self.graph {
            let known = reads.iter().all(|read| ended[*read]);
            let done = known && self.nodes.get(node.as_str()).is_none_or(|n| n.done() == n.expected);
            if node == name {
                return (known, done);
            }
            ended.push(done);
        }
        (false, false)
    }

    /// Where the run stands after `elapsed`. `expected` says what each node of the graph may do.
    pub fn overall(&self, expected: &[Expected], elapsed: Duration) -> Overall {
        let mut overall = Overall { known: true, ..Overall::default() };
        let (mut worked, mut to_do, mut told) = (0.0, 0.0, true);
        let mut ended = Vec::with_capacity(self.graph.len());
        for (place, (name, reads)) in self.graph.iter().enumerate() {
            let node = self.nodes.get(name.as_str());
            let known = reads.iter().all(|read| ended[*read]);
            let counts = node.map(NodeState::counts).unwrap_or_default();
            let Expected { actions, seconds } = expected.get(place).copied().unwrap_or_default();
            if actions == 0.0 && node.is_none() {
                ended.push(true); // nobody needs it
                continue;
            }
            // A node of which nothing was heard yet is still to be listed.
            let done = known && node.is_some() && counts.done() == counts.expected;
            ended.push(done);
            overall.nodes += 1;
            overall.done += usize::from(done);
            overall.known &= known;
            if done && counts.ran == 0 {
                continue;
            }
            let counted = known && node.is_some();
            let total = if counted { counts.expected as f64 } else { actions.max(counts.expected as f64) };
            let position = node.map_or(0.0, NodeState::position);
            let still = (total - position).max(0.0);
            let Some(each) = seconds else {
                // Without times of earlier actions, only a node that has nothing left can be told of.
                told &= still == 0.0;
                continue;
            };
            worked += (position - counts.hit.saturating_add(counts.blocked) as f64).max(0.0) * each;
            to_do += still * each;
        }
        let paced = told && worked > 0.0 && to_do > 0.0 && elapsed.as_secs_f64() > 1.0;
        overall.left = paced.then(|| elapsed.as_secs_f64() / worked * to_do);
        overall
    }

    /// Where a node stands.
    pub fn node(&self, name: &str) -> Option<&NodeState> {
        self.nodes.get(name)
    }
}

impl NodeState {
    fn done(&self) -> u64 {
        self.counts().done()
    }

    /// Numbers of its actions.
    pub fn counts(&self) -> Counts {
        let Self { expected, hit, ran, failed, blocked, .. } = *self;
        Counts { expected, hit, ran, failed, blocked, running: self.running.values().sum() }
    }

    /// Done actions, and the parts of those in flight.
    pub fn position(&self) -> f64 {
        let parts = self.long.values().map(|long| long.done as f64 / long.total.max(1) as f64);
        self.done() as f64 + parts.sum::<f64>()
    }

    /// True once there is anything to show.
    pub fn has_begun(&self) -> bool {
        self.started.is_some() || self.failed > 0
    }

    /// Seconds to go, from what ran so far; none if that cannot be told yet.
    pub fn eta(&self) -> Option<f64> {
        let elapsed = self.started?.elapsed().as_secs_f64();
        let worked = self.position() - self.hit.saturating_add(self.blocked) as f64;
        let left = self.expected as f64 - self.position();
        (worked > 0.0 && left > 0.0 && elapsed > 1.0).then(|| elapsed / worked * left)
    }

    /// The actions in flight that have news and take long, with the names of their cells and items.
    pub fn long(&self, least: Duration) -> impl Iterator<Item = (&(Name, Name), &LongAction)> {
        self.long.iter().filter(move |(_, long)| !long.message.is_empty() && long.since.0.elapsed() >= least)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_to_go_follows_from_earlier_times_and_the_pace() {
        let mut state = fresh();
        let each = |actions, seconds| Expected { actions, seconds: Some(seconds) };
        let expected = [each(1.0, 2.0), each(4.0, 10.0)];
        let overall = |state: &RunState, expected: &[Expected]| state.overall(expected, Duration::from_secs(6));
        assert_eq!(overall(&state, &expected), Overall { nodes: 2, known: false, ..Overall::default() });
        state.count(&expect("source", 1));
        state.count(&end("source", "x", Ended::Ran));
        // Work of 2 s took 6 s: the other 40 s take three times as long, too.
        let first = overall(&state, &expected);
        assert_eq!((first.done, first.nodes, first.left, first.known), (1, 2, Some(120.0), true));
        state.count(&expect("n", 2));
        // Only two are left, as is known now.
        assert_eq!(overall(&state, &expected).left, Some(60.0));
        state.count(&end("n", "a", Ended::Hit));
        assert_eq!(overall(&state, &expected).left, Some(30.0), "what was done before takes no time");
        let never = [expected[0], Expected { actions: 4.0, seconds: None }];
        assert_eq!(overall(&state, &never).left, None);
        state.count(&end("n", "b", Ended::Ran));
        assert_eq!(overall(&state, &expected), Overall { done: 2, nodes: 2, left: None, known: true });
    }

    fn fresh() -> RunState {
        RunState::new(vec![("source".into(), vec![]), ("n".into(), vec![0])])
    }

    fn end(node: &str, item: &str, outcome: Ended) -> Event {
        let (cell, group) = (Name::default(), "main".into());
        Event::End { node: node.into(), cell, item: item.into(), group, outcome, wall_us: 1, bytes: 1 }
    }

    fn begin(item: &str) -> Event {
        Event::Begin { node: "n".into(), cell: Name::default(), item: item.into() }
    }

    fn expect(node: &str, actions: u64) -> Event {
        Event::Expect { node: node.into(), actions }
    }

    fn progress(message: &str) -> Event {
        let (node, cell, item) = ("n".into(), Name::default(), "a".into());
        Event::Progress { node, cell, item, done: 1, total: 4, message: message.into() }
    }

    #[test]
    fn a_node_counts_up_to_its_end() {
        let mut state = fresh();
        state.count(&expect("source", 1));
        let mut count = |event: Event| {
            state.count(&event);
            let (known, done) = state.standing("n");
            (known, state.node("n").expect("it was counted").counts(), done)
        };
        let one = Counts { expected: 4, ..Counts::default() };
        assert_eq!(count(expect("n", 4)), (false, one, false));
        assert_eq!(count(begin("a")).1, Counts { running: 1, ..one });
        assert_eq!(count(progress("samples")).1, Counts { running: 1, ..one });
        assert_eq!(count(end("n", "a", Ended::Ran)).1, Counts { ran: 1, ..one });
        assert_eq!(count(end("n", "b", Ended::Blocked)).1, Counts { ran: 1, blocked: 1, ..one });
        count(begin("c"));
        let failed = Counts { ran: 1, blocked: 1, failed: 1, ..one };
        assert_eq!(count(end("n", "c", Ended::Failed)).1, failed);
        count(begin("d"));
        assert!(!count(end("n", "d", Ended::Hit)).2, "more may come as long as the source goes on");
        assert_eq!(count(end("source", "x", Ended::Ran)), (true, Counts { hit: 1, ..failed }, true));
    }

    #[test]
    fn a_viewer_reads_the_state_as_json() {
        let mut state = fresh();
        state.count(&expect("n", 2));
        state.count(&begin("a"));
        state.count(&progress("loss 2"));
        let told = serde_json::to_value(&state).expect("plain data");
        assert_eq!(told[0], serde_json::json!({ "node": "source", "known": true, "done": true, "state": null }));
        assert_eq!((&told[1]["node"], &told[1]["done"]), (&"n".into(), &false.into()));
        let state = &told[1]["state"];
        assert_eq!((&state["counts"]["expected"], &state["counts"]["running"]), (&2.into(), &1.into()));
        assert_eq!(state["position"], 0.25);
        let progress = serde_json::json!({ "done": 1, "total": 4, "message": "loss 2", "seconds_left": null });
        assert_eq!(state["running"], serde_json::json!([{ "cell": "", "item": "a", "progress": progress }]));
    }

    #[test]
    fn actions_in_flight_move_the_bar() {
        let mut state = fresh();
        state.count(&expect("n", 2));
        state.count(&begin("a"));
        assert_eq!(state.count(&progress("")).as_deref(), Some("n"));
        let node = state.node("n").expect("it was counted");
        assert!(node.position() == 0.25 && node.long(Duration::ZERO).next().is_none());
        state.count(&progress("loss 2"));
        let node = state.node("n").expect("it was counted");
        let told: Vec<String> = node
            .long(Duration::ZERO)
            .map(|((_, item), long)| format!("{item}: {}/{}  {}", long.done, long.total, long.message))
            .collect();
        assert_eq!(told, ["a: 1/4  loss 2"]);
        state.count(&Event::Healing { nodes: vec!["n".into()] });
        assert!(state.node("n").is_none(), "another pass counts anew");
    }
}
