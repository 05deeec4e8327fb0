//! What a run would do, node by node, why, and what it is expected to cost: what is certain, and the most that may
//! follow from it.

use super::{
    Expected,
    estimate::{self, Costs, Most},
};
use crate::{
    engine::{
        self, EngineError,
        event::{Ended, NodeStat},
        explain::{History, Planned, Reason},
    },
    pipeline::Pipeline,
};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use tauflow_cache::Store;

/// Earlier actions of a kind by which a run estimates the time to go.
const FEW: usize = 200;

/// Time and size.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Cost {
    /// Wall time of all actions one after the other, in seconds.
    pub seconds: f64,
    /// Bytes of results.
    pub bytes: f64,
}

impl Cost {
    /// Both.
    pub fn and(self, other: Self) -> Self {
        Self { seconds: self.seconds + other.seconds, bytes: self.bytes + other.bytes }
    }

    fn times(self, factor: f64) -> Self {
        Self { seconds: self.seconds * factor, bytes: self.bytes * factor }
    }
}

/// The actions that a run would perform at a node.
#[derive(Clone, Debug, Serialize)]
pub struct NodePlan {
    /// The node.
    pub node: String,
    /// Actions that were done before.
    pub as_before: u64,
    /// Actions that would run.
    pub to_run: u64,
    /// Actions that may run or not: a program has to tell its version first.
    pub undecided: u64,
    /// Actions that wait for others, so that it is not known whether they would run.
    pub waiting: u64,
    /// It is not known how many actions there are.
    pub open: bool,
    /// What those that would run cost, by the mean of earlier ones of their kind and size; none if there were none.
    pub cost: Option<Cost>,
    /// Actions that may run besides: all that are not known to be done, if no output stays unchanged.
    pub may_run: u64,
    /// The total cost of both; none if the kind never ran.
    pub most: Option<Cost>,
    /// Why actions would run, with how many for each reason.
    pub reasons: Vec<(Reason, u64)>,
    /// What an action asks a scheduler for, in words; several where cells or groups differ.
    pub resources: Vec<String>,
}

impl NodePlan {
    /// Whether more may run here than is said.
    pub fn is_partial(&self) -> bool {
        self.waiting > 0 || self.open || self.undecided > 0 || (self.to_run > 0 && self.cost.is_none())
    }
}

/// The actions that a run would perform, and their expected cost.
#[derive(Clone, Debug, Serialize)]
pub struct PlanCosts {
    /// The nodes that are needed, in the pipeline's order.
    pub nodes: Vec<NodePlan>,
    /// The cost of the actions that would run, as far as it is known.
    pub total: Cost,
    /// The cost if all that may run does, as far as it is known.
    pub most: Cost,
    /// Nodes at which something may run whose kind never ran, so that the cost is not known.
    pub never: Vec<String>,
}

impl PlanCosts {
    /// Whether more may run than is said.
    pub fn is_partial(&self) -> bool {
        self.nodes.iter().any(NodePlan::is_partial)
    }

    /// Whether nothing is to be done.
    pub fn is_empty(&self) -> bool {
        !self.is_partial() && self.nodes.iter().all(|node| node.reasons.is_empty())
    }
}

/// Why the actions of each node would run.
fn reasons(store: &Store, planned: &[Planned]) -> BTreeMap<usize, BTreeMap<Reason, u64>> {
    let mut histories: BTreeMap<String, History> = BTreeMap::new();
    let mut reasons: BTreeMap<usize, BTreeMap<Reason, u64>> = BTreeMap::new();
    for action in planned.iter().filter(|action| action.ended == Ended::WouldRun) {
        let why = if action.unknown {
            Reason::Undecided
        } else {
            let kind = &action.key.basis.kind;
            let history = histories.entry(kind.to_string()).or_insert_with(|| History::of(store, kind));
            Reason::of(history.nearest(&action.key).as_ref())
        };
        *reasons.entry(action.node).or_default().entry(why).or_insert(0) += 1;
    }
    reasons
}

/// The actions that a run would perform, the reasons, and the expected cost.
///
/// # Errors
/// If the store cannot be read.
pub fn plan(pipeline: &Pipeline, store: &Store) -> Result<PlanCosts, EngineError> {
    let plan = engine::plan(pipeline, store, None)?;
    let mut reasons = reasons(store, &plan.would_run);
    let mut costs = Costs::new(store);
    let certain = certain(pipeline, &plan.would_run, &mut costs);
    let stats = &plan.summary.nodes;
    // Where nothing runs or waits, nothing can follow.
    let idle = stats.iter().all(|node| node.ran + node.blocked == 0 && !node.unknown);
    let most = if idle { Vec::new() } else { estimate::most(pipeline, stats, &mut costs) };
    let (mut nodes, mut never) = (Vec::new(), Vec::new());
    for (place, stat) in stats.iter().enumerate().filter(|(_, node)| node.lanes > 0) {
        let reasons = reasons.remove(&place).unwrap_or_default();
        let undecided = reasons.get(&Reason::Undecided).copied().unwrap_or(0);
        let NodeStat { node, hit, ran, blocked, unknown, .. } = stat;
        let to_run = ran.saturating_sub(undecided);
        let cost = certain.get(&place).copied().unwrap_or(Some(Cost::default()));
        let all = most.get(place).copied().unwrap_or_default();
        let may_run = if blocked + undecided > 0 || *unknown {
            (all.actions.ceil() as u64).saturating_sub(hit + to_run).max(blocked + undecided)
        } else {
            0
        };
        // Those that may run cost as much as all do on average.
        let rest = match all.cost {
            _ if may_run == 0 => Some(Cost::default()),
            Some(cost) if all.actions > 0.0 => Some(cost.times(may_run as f64 / all.actions)),
            _ => None,
        };
        let both = cost.zip(rest).map(|(cost, rest)| cost.and(rest));
        if both.is_none() {
            never.push(node.clone());
        }
        nodes.push(NodePlan {
            node: node.clone(),
            as_before: *hit,
            to_run,
            undecided,
            waiting: *blocked,
            open: *unknown,
            cost: cost.filter(|_| to_run > 0),
            may_run,
            most: both,
            reasons: reasons.into_iter().collect(),
            resources: resources(pipeline, place),
        });
    }
    let sum = |of: fn(&NodePlan) -> Option<Cost>| nodes.iter().filter_map(of).fold(Cost::default(), Cost::and);
    let (total, at_most) = (sum(|node| node.cost), sum(|node| node.most.or(node.cost)));
    Ok(PlanCosts { nodes, total, most: at_most, never })
}

/// What the actions of a node ask a scheduler for.
fn resources(pipeline: &Pipeline, node: usize) -> Vec<String> {
    let of = &pipeline.nodes[node];
    let mut found = BTreeSet::new();
    for cell in &pipeline.cells[of.cells.clone()] {
        found.extend(of.spec.groups().iter().map(|group| of.resources_of(&cell.params, group.name)));
    }
    found.iter().map(ToString::to_string).filter(|text| !text.is_empty()).collect()
}

/// The actions of each node if everything runs, with the times of earlier actions. Looks no action up.
pub fn expected(pipeline: &Pipeline, store: &Store) -> Vec<Expected> {
    let unknown = vec![NodeStat { unknown: true, ..NodeStat::default() }; pipeline.nodes.len()];
    let most = estimate::most(pipeline, &unknown, &mut Costs::new(store).reading(FEW));
    let of = |most: Most| Expected {
        actions: most.actions,
        seconds: most.cost.map(|cost| cost.seconds / most.actions.max(1.0)),
    };
    most.into_iter().map(of).collect()
}

/// The cost of the actions that would run, by node; none where an action of the kind never ran.
fn certain(pipeline: &Pipeline, planned: &[Planned], costs: &mut Costs<'_>) -> BTreeMap<usize, Option<Cost>> {
    let mut found: BTreeMap<usize, Option<Cost>> = BTreeMap::new();
    for action in planned.iter().filter(|action| action.ended == Ended::WouldRun && !action.unknown) {
        let basis = &action.key.basis;
        let cost = costs.of(pipeline.nodes[action.node].kind.as_ref(), &basis.params, &basis.group);
        let sum = found.entry(action.node).or_insert(Some(Cost::default()));
        *sum = sum.zip(cost).map(|(sum, cost)| sum.and(cost));
    }
    found
}
