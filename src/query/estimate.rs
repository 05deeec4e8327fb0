//! Estimates of a plan: times and sizes of actions from earlier ones of the same kind and size, and how many actions
//! may follow if no output stays unchanged. Knows no kind.

use super::Cost;
use crate::{
    engine::{self, event::NodeStat, target_ports},
    ids::Id,
    pipeline::Pipeline,
};
use serde_json::Value;
use std::{
    collections::{BTreeMap, BTreeSet},
    panic::{AssertUnwindSafe, catch_unwind},
};
use tauflow_cache::Store;
use tauflow_contract::{Known, MOST_ITEMS, Mode, NodeKind, Takes};

/// Earlier actions of a kind that are looked at, the latest first.
const MOST_READ: usize = 2_000;
/// Actions whose work differs at most by this factor are of one size.
const SAME_SIZE: f64 = 1.5;

/// An earlier action.
struct Sample {
    work: f64,
    cost: Cost,
}

/// Earlier actions of a kind, by output group and by what they do.
#[derive(Default)]
struct Samples(BTreeMap<(String, String), Vec<Sample>>);

/// The cost of earlier actions.
pub(super) struct Costs<'a> {
    store: &'a Store,
    kinds: BTreeMap<&'static str, Samples>,
    /// Actions of a kind that are read at most.
    most: usize,
}

impl<'a> Costs<'a> {
    pub fn new(store: &'a Store) -> Self {
        Self { store, kinds: BTreeMap::new(), most: MOST_READ }
    }

    /// The same, reading so many earlier actions of a kind at most.
    pub fn reading(self, most: usize) -> Self {
        Self { most, ..self }
    }

    /// The expected cost of an action of these params: the mean of earlier ones of its size, or else the mean of those
    /// that are nearest in size, scaled. None if there were none.
    pub fn of(&mut self, kind: &dyn NodeKind, params: &Value, group: &str) -> Option<Cost> {
        let name = kind.spec().name;
        let (store, most) = (self.store, self.most);
        let samples = self.kinds.entry(name).or_insert_with(|| Samples::read(store, kind, most));
        let samples = samples.0.get(&(group.to_owned(), sort(kind, params)))?;
        let wanted = work(kind, params, group);
        let distance = |sample: &Sample| (sample.work / wanted).ln().abs();
        let least = samples.iter().map(distance).min_by(f64::total_cmp)?;
        let reach = least.max(SAME_SIZE.ln()) + 1e-9;
        let near: Vec<&Sample> = samples.iter().filter(|sample| distance(sample) <= reach).collect();
        // Those of one size count as they are; others are scaled.
        let scaled = least > SAME_SIZE.ln();
        let factor = |sample: &Sample| if scaled { wanted / sample.work } else { 1.0 };
        let count = near.len() as f64;
        let seconds = near.iter().map(|sample| sample.cost.seconds * factor(sample)).sum::<f64>() / count;
        let bytes = near.iter().map(|sample| sample.cost.bytes).sum::<f64>() / count;
        Some(Cost { seconds, bytes })
    }
}

/// The work of an action; 1 where the kind panics, which its actions will tell.
fn work(kind: &dyn NodeKind, params: &Value, group: &str) -> f64 {
    catch_unwind(AssertUnwindSafe(|| kind.work(params, group))).unwrap_or(1.0)
}

/// What an action does; nothing where the kind panics, which its actions will tell.
fn sort(kind: &dyn NodeKind, params: &Value) -> String {
    catch_unwind(AssertUnwindSafe(|| kind.sort(params))).unwrap_or_default()
}

impl Samples {
    fn read(store: &Store, kind: &dyn NodeKind, most: usize) -> Self {
        let mut found = Self::default();
        for key in store.keys_by_label(engine::ACTION, kind.spec().name).into_iter().rev().take(most) {
            let Some(record) = store.read(engine::ACTION, &key) else { continue };
            let Ok(read) = serde_json::from_str::<Value>(&record.preimage) else { continue };
            let Some(group) = read["group"].as_str() else { continue };
            let cost = Cost { seconds: record.wall_us as f64 / 1e6, bytes: record.bytes as f64 };
            let sample = Sample { work: work(kind, &read["params"], group), cost };
            found.0.entry((group.to_owned(), sort(kind, &read["params"]))).or_default().push(sample);
        }
        found
    }
}

/// How many actions there may be at a node, and what all of them cost.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Most {
    /// Actions.
    pub actions: f64,
    /// Their cost; none if an action of this kind has never run.
    pub cost: Option<Cost>,
}

/// How many actions there may be at each node. `stats` are those of a plan, which knows some of the numbers.
pub(super) fn most(pipeline: &Pipeline, stats: &[NodeStat], costs: &mut Costs<'_>) -> Vec<Most> {
    let wanted = groups(pipeline);
    let mut most = vec![Most::default(); pipeline.nodes.len()];
    // Items on the ports of each cell.
    let mut items: Vec<Vec<f64>> = Vec::with_capacity(pipeline.cells.len());
    for (cell, of) in pipeline.cells.iter().enumerate() {
        let node = &pipeline.nodes[of.node];
        let stat = &stats[of.node];
        let known = (stat.hit + stat.ran + stat.blocked + stat.failed) as f64 / stat.lanes.max(1) as f64;
        let fed = |input: usize| -> f64 {
            of.inputs[input].iter().map(|feed| items[feed.cell].get(feed.port.place()).copied().unwrap_or(0.0)).sum()
        };
        let inputs = 0..of.inputs.len();
        let (actions, made) = match node.mode() {
            _ if wanted[cell].is_empty() => (0.0, vec![0.0; node.spec.outputs.len()]),
            Mode::Gather => {
                let largest = inputs.map(fed).fold(1.0, f64::max);
                let known = [Known::default()];
                let outlook = catch_unwind(AssertUnwindSafe(|| node.kind.foresee(&of.params, &known)));
                let outlook = outlook.ok().and_then(|mut outlooks| outlooks.pop()).unwrap_or_default();
                let of_port = |port: &tauflow_contract::OutputPort| match outlook.facts(port.name).get(MOST_ITEMS) {
                    _ if port.single => 1.0,
                    Some(items) => items as f64,
                    None => largest,
                };
                (1.0, node.spec.outputs.iter().map(of_port).collect())
            }
            _ if !stat.unknown => (known, vec![known; node.spec.outputs.len()]),
            Mode::Map => {
                let by_item =
                    |input: &usize| node.spec.inputs[*input].takes == Takes::Item && !of.inputs[*input].is_empty();
                let count = inputs.into_iter().find(by_item).map_or(0.0, fed);
                (count, vec![count; node.spec.outputs.len()])
            }
            Mode::Source => {
                let listed = catch_unwind(AssertUnwindSafe(|| node.kind.items(&of.params)));
                let count = listed.ok().and_then(Result::ok).map_or(0.0, |items| items.len() as f64);
                (count, vec![count; node.spec.outputs.len()])
            }
        };
        items.push(made);
        for group in &wanted[cell] {
            let first = most[of.node].actions == 0.0;
            let cost = costs.of(node.kind.as_ref(), &of.params, group);
            let sum = &mut most[of.node];
            sum.actions += actions;
            let all = cost.map(|cost| Cost { seconds: cost.seconds * actions, bytes: cost.bytes * actions });
            sum.cost = match (sum.cost, all) {
                (None, all) if first => all,
                (Some(sum), Some(all)) => Some(sum.and(all)),
                // A group of which nothing is known makes the sum unknown.
                _ => None,
            };
        }
    }
    most
}

/// The output groups of each cell that the targets need.
fn groups(pipeline: &Pipeline) -> Vec<BTreeSet<&'static str>> {
    let mut wanted = vec![BTreeSet::new(); pipeline.cells.len()];
    let group = |cell: usize, port: usize| pipeline.nodes[pipeline.cells[cell].node].spec.outputs[port].group.name;
    for target in &pipeline.targets {
        for cell in pipeline.nodes[target.node].cells.clone() {
            wanted[cell].extend(target_ports(pipeline, *target).iter().map(|port| group(cell, port.place())));
        }
    }
    // Cells stand after what they read.
    for cell in (0..pipeline.cells.len()).rev() {
        if !wanted[cell].is_empty() {
            for feed in pipeline.cells[cell].inputs.iter().flatten() {
                wanted[feed.cell].insert(group(feed.cell, feed.port.place()));
            }
        }
    }
    wanted
}
