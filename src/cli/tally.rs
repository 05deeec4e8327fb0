//! The state of a run per node, counted from its events. Displays nothing.

use super::seconds_text;
use crate::engine::event::{Ended, Event, Name};
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

/// Where the nodes of a run stand.
pub(crate) struct Tally {
    /// The nodes in an order in which each stands after those that it reads, and the numbers of these.
    graph: Vec<(String, Vec<usize>)>,
    nodes: BTreeMap<Name, NodeTally>,
}

/// Where a node stands.
#[derive(Default)]
pub(crate) struct NodeTally {
    expected: u64,
    hit: u64,
    ran: u64,
    failed: u64,
    blocked: u64,
    /// Actions in flight, by cell and item; two output groups of an item may be.
    running: BTreeMap<(Name, Name), u64>,
    started: Option<Instant>,
    /// The long actions in flight, by cell and item.
    long: BTreeMap<(Name, Name), Long>,
}

/// Where a long action stands.
pub(crate) struct Long {
    pub(crate) done: u64,
    pub(crate) total: u64,
    /// Its news.
    pub(crate) message: String,
    /// When it was first heard of, and how much was done by then: a resumed one begins in the middle.
    since: (Instant, u64),
}

impl Long {
    /// Done of total, the news, and the time to go.
    pub(crate) fn text(&self) -> String {
        let (worked, elapsed) =
            ((self.done - self.since.1.min(self.done)) as f64, self.since.0.elapsed().as_secs_f64());
        let left = self.total.saturating_sub(self.done) as f64;
        let eta = (worked > 0.0 && left > 0.0 && elapsed > 1.0).then(|| elapsed / worked * left);
        let eta = eta.map(|eta| format!("  {} to go", seconds_text(eta))).unwrap_or_default();
        format!("{}/{}  {}{eta}", self.done, self.total, self.message)
    }
}

impl Tally {
    /// Statistics of nodes in dependency order, with the indices of their inputs.
    pub(crate) fn new(graph: Vec<(String, Vec<usize>)>) -> Self {
        Self { graph, nodes: BTreeMap::new() }
    }

    /// Counts an event; the node whose standing it changed.
    pub(crate) fn count(&mut self, event: &Event) -> Option<Name> {
        let name = match event {
            Event::Started { .. } | Event::Finished { .. } | Event::Warning { .. } => return None,
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
                node.long.insert(at, Long { done: *done, total: *total, message: message.clone(), since });
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
    pub(crate) fn standing(&self, name: &str) -> (bool, bool) {
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

    /// Where a node stands.
    pub(crate) fn node(&self, name: &str) -> Option<&NodeTally> {
        self.nodes.get(name)
    }
}

impl NodeTally {
    fn done(&self) -> u64 {
        [self.ran, self.failed, self.blocked].into_iter().fold(self.hit, u64::saturating_add)
    }

    /// How many actions are known of.
    pub(crate) fn expected(&self) -> u64 {
        self.expected
    }

    /// Done actions, and the parts of those in flight.
    pub(crate) fn position(&self) -> f64 {
        let parts = self.long.values().map(|long| long.done as f64 / long.total.max(1) as f64);
        self.done() as f64 + parts.sum::<f64>()
    }

    /// True once there is anything to show.
    pub(crate) fn has_begun(&self) -> bool {
        self.started.is_some() || self.failed > 0
    }

    /// Seconds to go, from what ran so far.
    fn eta(&self) -> Option<f64> {
        let elapsed = self.started?.elapsed().as_secs_f64();
        let worked = self.position() - self.hit.saturating_add(self.blocked) as f64;
        let left = self.expected as f64 - self.position();
        (worked > 0.0 && left > 0.0 && elapsed > 1.0).then(|| elapsed / worked * left)
    }

    /// The actions in flight that have news and take long, with the names of their cells and items.
    pub(crate) fn long(&self, least: Duration) -> impl Iterator<Item = (&(Name, Name), &Long)> {
        self.long.iter().filter(move |(_, long)| !long.message.is_empty() && long.since.0.elapsed() >= least)
    }

    /// A line: done of expected (with a `+` unless all are known), what became of them, time to go.
    pub(crate) fn text(&self, known: bool) -> String {
        let more = if known { "" } else { "+" };
        let mut parts = vec![format!("{}/{}{more}", self.done(), self.expected)];
        let counts = [
            (self.hit, "as before"),
            (self.running.values().sum(), "running"),
            (self.failed, "failed"),
            (self.blocked, "blocked"),
        ];
        parts.extend(counts.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")));
        if let Some(eta) = self.eta() {
            parts.push(format!("{} to go", seconds_text(eta)));
        }
        parts.join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tally() -> Tally {
        Tally::new(vec![("source".into(), vec![]), ("n".into(), vec![0])])
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
        let mut tally = tally();
        tally.count(&expect("source", 1));
        let mut count = |event: Event| {
            tally.count(&event);
            let (known, done) = tally.standing("n");
            (tally.node("n").expect("it was counted").text(known), done)
        };
        assert_eq!(count(expect("n", 4)).0, "0/4+");
        assert_eq!(count(begin("a")).0, "0/4+, 1 running");
        assert_eq!(count(progress("samples")).0, "0/4+, 1 running");
        assert_eq!(count(end("n", "a", Ended::Ran)).0, "1/4+");
        assert_eq!(count(end("n", "b", Ended::Blocked)).0, "2/4+, 1 blocked");
        count(begin("c"));
        assert_eq!(count(end("n", "c", Ended::Failed)).0, "3/4+, 1 failed, 1 blocked");
        count(begin("d"));
        assert!(!count(end("n", "d", Ended::Hit)).1, "more may come as long as the source goes on");
        let (text, done) = count(end("source", "x", Ended::Ran));
        assert_eq!((text.as_str(), done), ("4/4, 1 as before, 1 failed, 1 blocked", true));
    }

    #[test]
    fn actions_in_flight_move_the_bar() {
        let mut tally = tally();
        tally.count(&expect("n", 2));
        tally.count(&begin("a"));
        assert_eq!(tally.count(&progress("")).as_deref(), Some("n"));
        let node = tally.node("n").expect("it was counted");
        assert!(node.position() == 0.25 && node.long(Duration::ZERO).next().is_none());
        tally.count(&progress("loss 2"));
        let node = tally.node("n").expect("it was counted");
        let told: Vec<String> =
            node.long(Duration::ZERO).map(|((_, item), long)| format!("{item}: {}", long.text())).collect();
        assert_eq!(told, ["a: 1/4  loss 2"]);
        tally.count(&Event::Healing { nodes: vec!["n".into()] });
        assert!(tally.node("n").is_none(), "another pass counts anew");
    }
}
