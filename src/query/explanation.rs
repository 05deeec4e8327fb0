//! Why actions run: the key of one in full, or the reasons of many.

use crate::{
    diagnostics::nearest,
    engine::{
        self, EngineError, Only,
        event::Ended,
        explain::{History, Nearest, Planned, Reason},
    },
    pipeline::Pipeline,
};
use serde::Serialize;
use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
};
use tauflow_cache::Store;
use tauflow_contract::{ActionKey, ItemKey, Resources};

/// The explanation of a node, cell or item.
#[derive(Clone, Debug)]
pub enum Explanation {
    /// Nothing before these nodes have run; none if it is not known which.
    Waits(Vec<String>),
    /// It is one action.
    One(Box<Explained>),
    /// They are several, grouped by why they run, or do not.
    Several(Vec<ExplainedGroup>),
}

/// One action.
#[derive(Clone, Debug)]
pub struct Explained {
    /// The node and its cell.
    pub cell: String,
    /// The item, with its cell and group.
    pub name: String,
    /// Its key; none that a run has if `why` says that it is undecided.
    pub key: ActionKey,
    /// What it asks a scheduler for, where it runs as a job.
    pub resources: Resources,
    /// Why it runs, or does not.
    pub why: Why,
    /// The earlier key that differs least, if it runs.
    pub nearest: Option<Nearest>,
}

/// Actions for which the same is so.
#[derive(Clone, Debug, Serialize)]
pub struct ExplainedGroup {
    /// What.
    pub why: Why,
    /// The items, each with its cell and group.
    pub names: Vec<String>,
}

/// Why an action runs, or does not.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Why {
    /// It was done before.
    Done,
    /// It runs, or may.
    Runs(Reason),
}

impl Why {
    fn of(action: &Planned, nearest: Option<&Nearest>) -> Self {
        match action.ended {
            Ended::WouldRun if action.unknown => Self::Runs(Reason::Undecided),
            Ended::WouldRun => Self::Runs(Reason::of(nearest)),
            Ended::Hit | Ended::Ran | Ended::Failed | Ended::Blocked => Self::Done,
        }
    }
}

impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Done => f.write_str("up to date: no input has changed"),
            Self::Runs(Reason::Undecided) => write!(f, "{}", Reason::Undecided),
            Self::Runs(reason) => write!(f, "runs; {reason}"),
        }
    }
}

/// The planned actions of what was asked about.
fn asked<'p>(planned: &'p [Planned], only: &Only) -> Vec<&'p Planned> {
    let of_cell = |action: &&Planned| action.node == only.node && only.cell.is_none_or(|cell| cell == action.cell);
    let of_item = |action: &&Planned| only.item.is_none() || action.item == only.item;
    planned.iter().filter(of_cell).filter(of_item).collect()
}

/// Why a node's, a cell's or an item's actions run.
///
/// # Errors
/// If the store cannot be read, or the items are known and the one that is asked about is not among them.
pub fn explain(pipeline: &Pipeline, store: &Store, only: &Only) -> Result<Explanation, EngineError> {
    let plan = engine::plan(pipeline, store, Some(only.clone()))?;
    let mine = asked(&plan.would_run, only);
    let Some(first) = mine.first() else {
        if let Some(item) = &only.item {
            there_is(item, &Only { item: None, ..only.clone() }, pipeline, store)?;
        }
        let waits = plan.summary.nodes.iter().filter(|node| node.ran > 0);
        return Ok(Explanation::Waits(waits.map(|node| node.node.clone()).collect()));
    };
    let history = History::of(store, &first.key.basis.kind);
    let runs = |action: &Planned| action.ended == Ended::WouldRun && !action.unknown;
    let nearest = |action: &Planned| if runs(action) { history.nearest(&action.key) } else { None };
    if let [one] = &mine[..] {
        let nearest = nearest(one);
        let (cell, name) = (pipeline.cell_name(one.cell), name(pipeline, one));
        let why = Why::of(one, nearest.as_ref());
        let key = (*one.key).clone();
        let resources = pipeline.nodes[one.node].resources_of(&key.basis.params, &key.basis.group);
        return Ok(Explanation::One(Box::new(Explained { cell, name, key, resources, why, nearest })));
    }
    let mut groups: BTreeMap<String, ExplainedGroup> = BTreeMap::new();
    for action in mine {
        let why = Why::of(action, nearest(action).as_ref());
        let group = groups.entry(why.to_string()).or_insert_with(|| ExplainedGroup { why, names: Vec::new() });
        group.names.push(name(pipeline, action));
    }
    Ok(Explanation::Several(groups.into_values().collect()))
}

/// Finds out whether the node's items are known and `item` is not among them.
///
/// # Errors
/// If so, with the nearest item; or if the store cannot be read.
pub fn there_is(item: &ItemKey, only: &Only, pipeline: &Pipeline, store: &Store) -> Result<(), EngineError> {
    let plan = engine::plan(pipeline, store, Some(only.clone()))?;
    let mine = asked(&plan.would_run, only);
    let items: BTreeSet<&str> = mine.iter().filter_map(|action| action.item.as_ref()).map(ItemKey::as_str).collect();
    if items.is_empty() || items.contains(item.as_str()) {
        return Ok(());
    }
    let first = items.iter().next().map(|first| format!("items read like `{first}`"));
    let near = nearest(item.as_str(), items.iter().copied()).map(|near| format!("did you mean `{near}`?"));
    let node = &pipeline.nodes[only.node].name;
    Err(EngineError::Request(format!("`{node}` has no item `{item}`; {}", near.or(first).unwrap_or_default())))
}

fn name(pipeline: &Pipeline, action: &Planned) -> String {
    let cell = &pipeline.cells[action.cell].text;
    let item = action.item.as_ref().map(ToString::to_string).unwrap_or_default();
    let parts = [cell.as_str(), item.as_str()];
    let text = parts.iter().filter(|p| !p.is_empty()).copied().collect::<Vec<_>>().join("/");
    let group = &action.key.basis.group;
    if group == "main" { text } else { format!("{text} ({group})") }
}
