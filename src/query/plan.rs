//! What a run would do, node by node, why, and what it is expected to cost.

use crate::{
    engine::{
        self, EngineError,
        event::{Ended, NodeStat},
        explain::{History, Planned, Reason},
    },
    pipeline::Pipeline,
};
use serde::Serialize;
use std::collections::BTreeMap;
use tauflow_cache::Store;

/// Time and size.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Cost {
    /// Wall time of all actions one after the other, in seconds.
    pub seconds: f64,
    /// Bytes of results.
    pub bytes: f64,
}

/// What a run would do at a node.
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
    /// What those that would run cost, by the mean of earlier ones of their kind; none if there were none.
    pub cost: Option<Cost>,
    /// Why actions would run, with how many for each reason.
    pub reasons: Vec<(Reason, u64)>,
}

impl NodePlan {
    /// Whether more may run here than is said.
    pub fn is_partial(&self) -> bool {
        self.waiting > 0 || self.open || self.undecided > 0 || (self.to_run > 0 && self.cost.is_none())
    }
}

/// What a run would do, and its expected cost.
#[derive(Clone, Debug, Serialize)]
pub struct PlanCosts {
    /// The nodes that are needed, in the pipeline's order.
    pub nodes: Vec<NodePlan>,
    /// What is known of the cost.
    pub total: Cost,
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

/// What a run would do, why, and what it would cost.
///
/// # Errors
/// If the store cannot be read.
pub fn plan(pipeline: &Pipeline, store: &Store) -> Result<PlanCosts, EngineError> {
    let plan = engine::plan(pipeline, store, None)?;
    let mut reasons = reasons(store, &plan.would_run);
    let costs = store.record_stats().remove(engine::ACTION).unwrap_or_default();
    let mut nodes = Vec::new();
    for (place, stat) in plan.summary.nodes.iter().enumerate().filter(|(_, node)| node.lanes > 0) {
        let reasons = reasons.remove(&place).unwrap_or_default();
        let undecided = reasons.get(&Reason::Undecided).copied().unwrap_or(0);
        let NodeStat { node, kind, hit, ran, blocked, unknown, .. } = stat;
        let to_run = ran.saturating_sub(undecided);
        let cost = costs.get(kind).filter(|of| of.count > 0).map(|of| {
            let share = to_run as f64 / of.count as f64;
            Cost { seconds: of.wall_us as f64 / 1e6 * share, bytes: of.bytes as f64 * share }
        });
        nodes.push(NodePlan {
            node: node.clone(),
            as_before: *hit,
            to_run,
            undecided,
            waiting: *blocked,
            open: *unknown,
            cost,
            reasons: reasons.into_iter().collect(),
        });
    }
    let sum = |of: fn(&Cost) -> f64| nodes.iter().filter_map(|node| node.cost.as_ref()).map(of).sum();
    let total = Cost { seconds: sum(|cost| cost.seconds), bytes: sum(|cost| cost.bytes) };
    Ok(PlanCosts { nodes, total })
}
