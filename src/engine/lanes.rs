//! The demanded lanes: one for each cell and output group that the targets need.
//!
//! A lane is a row of actions of the same kind. Lanes are few and known before the run; their items are many and
//! unknown.

use super::{
    EngineError,
    ids::{Id, InputId, LaneId, PortId, Row},
    probe,
};
use crate::pipeline::{Pipeline, Target};
use serde::Serialize;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{Basis, Group, ItemKey, Mode, NodeKind, Takes};

/// One cell's actions of one output group.
#[derive(Clone, Debug)]
pub struct Lane {
    /// The cell.
    pub cell: usize,
    /// Its node.
    pub node: usize,
    /// The group.
    pub group: Group,
    /// Everything that determines its outputs, except its inputs.
    pub basis: LaneBasis,
    /// What of the machine enters its keys is not known, because a program would have to run: no key of it is one.
    pub unknown: bool,
    /// Its actions run programs outside, whose files are known to each action alone: no roll-up stands for them.
    pub programs: bool,
    /// The output ports of the group.
    pub ports: Vec<PortId>,
    /// Source of each input port.
    pub inputs: Row<InputId, Vec<LaneFeed>>,
    /// The input port that decides which items there are.
    pub driving: Option<InputId>,
    /// Who reads it.
    pub readers: Vec<ReadingPort>,
    /// True if it is asked for itself.
    pub target: bool,
    /// The only items that are needed, if not all.
    pub only: Option<BTreeSet<ItemKey>>,
}

/// What decides the outputs of all actions of a lane beside what they read: a [`Basis`] with the whole params of its
/// cell and the pipeline's seed, where an action's has its projected params and a seed of its own.
#[derive(Clone, Debug, Serialize)]
#[serde(transparent)]
pub struct LaneBasis(Basis);

impl LaneBasis {
    /// Combines the part that all actions share with the cell's params and the pipeline's seed.
    pub fn new(shared: &Basis, params: Value, pipeline_seed: Option<u64>) -> Self {
        Self(shared.with(params, pipeline_seed))
    }

    /// The same without the params.
    pub fn without_params(&self) -> Self {
        Self::new(&self.0, Value::Null, self.0.seed)
    }

    /// Whether it names a machine, a library or a device.
    pub fn names_environment(&self) -> bool {
        !self.0.environment.is_null()
    }

    /// That of an action, by its params, and by its seed, which is derived from the pipeline's.
    pub fn of_action(&self, params: Value, derive: impl FnOnce(u64) -> u64) -> Basis {
        self.0.with(params, self.0.seed.map(derive))
    }
}

/// A lane's output that feeds an input.
#[derive(Clone, Debug)]
pub struct LaneFeed {
    /// The lane.
    pub lane: LaneId,
    /// Its output port.
    pub port: PortId,
    /// The prefix of its item keys.
    pub prefix: Option<String>,
}

/// An input port that reads a lane.
#[derive(Clone, Copy, Debug)]
pub struct ReadingPort {
    /// The reading lane.
    pub lane: LaneId,
    /// Its input port.
    pub input: InputId,
    /// Which of that port's feeds this is.
    pub feed: usize,
}

impl ReadingPort {
    /// The feed by which it reads.
    pub fn feed(self, lanes: &Lanes) -> &LaneFeed {
        &lanes[self.lane].inputs[self.input][self.feed]
    }
}

/// One item of one node, or one cell, or a whole node: `--only NODE[/CELL][/ITEM]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Only {
    /// The node.
    pub node: usize,
    /// The cell, if one is named.
    pub cell: Option<usize>,
    /// The item, if one is named.
    pub item: Option<ItemKey>,
}

impl Only {
    /// Parses `node`, `node/item`, `node/cell` or `node/cell/item`.
    ///
    /// # Errors
    /// The problem, in words.
    pub fn parse(text: &str, pipeline: &Pipeline) -> Result<Self, String> {
        let (name, rest) = text.split_once('/').map_or((text, None), |(name, rest)| (name, Some(rest)));
        let node = pipeline.node(name).ok_or_else(|| {
            let names = pipeline.nodes.iter().map(|n| n.name.as_str());
            format!("unknown node `{name}`; {}", crate::diagnostics::did_you_mean(name, "nodes", names))
        })?;
        let Some(rest) = rest else { return Ok(Self { node, cell: None, item: None }) };
        let item = |text: &str| ItemKey::new(text).map_err(|e| e.to_string());
        for cell in pipeline.nodes[node].cells.clone() {
            let cell_text = &pipeline.cells[cell].text;
            if cell_text.is_empty() {
                continue;
            }
            if rest == cell_text {
                return Ok(Self { node, cell: Some(cell), item: None });
            }
            if let Some(below) = rest.strip_prefix(cell_text.as_str()).and_then(|r| r.strip_prefix('/')) {
                return Ok(Self { node, cell: Some(cell), item: Some(item(below)?) });
            }
        }
        if pipeline.nodes[node].spec.mode == Mode::Gather {
            let cells: Vec<&str> = pipeline.cells[pipeline.nodes[node].cells.clone()]
                .iter()
                .map(|cell| cell.text.as_str())
                .filter(|text| !text.is_empty())
                .collect();
            let cells = if cells.is_empty() { String::new() } else { format!("; its cells: {}", cells.join(", ")) };
            return Err(format!("`{name}` works on whole collections and has no item `{rest}`{cells}"));
        }
        Ok(Self { node, cell: None, item: Some(item(rest)?) })
    }
}

impl Lane {
    /// Whether a roll-up can stand for it: not if only some of its items are needed, or if its actions run programs.
    pub fn is_rolled_up(&self) -> bool {
        self.only.is_none() && !self.programs
    }

    /// Whether its outputs are handed on in memory: what is asked for is stored.
    pub fn is_transient(&self, pipeline: &Pipeline) -> bool {
        pipeline.nodes[self.node].transient && !self.target
    }

    /// True if the input port waits for the whole collection.
    pub fn is_whole(&self, pipeline: &Pipeline, input: InputId) -> bool {
        let spec = &pipeline.nodes[self.node].spec;
        spec.mode != Mode::Map || spec.inputs[input.place()].takes == Takes::Collection
    }
}

/// The ports of a node that a target asks for.
pub fn target_ports(pipeline: &Pipeline, target: Target) -> Vec<PortId> {
    let outputs = &pipeline.nodes[target.node].spec.outputs;
    match target.port {
        Some(port) => vec![port],
        None => {
            let asked = |port: &PortId| *port == PortId::DEFAULT || outputs[port.place()].publish;
            (0..outputs.len()).map(PortId::at).filter(asked).collect()
        }
    }
}

/// The group of a cell's output port.
fn group_of(pipeline: &Pipeline, cell: usize, port: PortId) -> Group {
    pipeline.nodes[pipeline.cells[cell].node].spec.outputs[port.place()].group
}

/// The lanes of a run.
pub type Lanes = Row<LaneId, Lane>;

/// Where the lane of each cell's group stands.
type Places = BTreeMap<(usize, Group), LaneId>;

/// Tells what of the machine on which actions run enters the keys of a kind's group; none if that is not known.
pub type Environment<'a> = &'a dyn Fn(&dyn NodeKind, &Value, Group) -> Result<Option<Value>, EngineError>;

/// The lanes that the targets need, each after all that it reads.
///
/// # Errors
/// If what a program told of the machine cannot be kept.
pub fn demand(
    pipeline: &Pipeline,
    targets: &[Target],
    only: Option<&Only>,
    environment: Environment<'_>,
) -> Result<Lanes, EngineError> {
    let group_of = |cell, port| group_of(pipeline, cell, port);
    let mut wanted: Vec<BTreeSet<Group>> = vec![BTreeSet::new(); pipeline.cells.len()];
    let mut asked = wanted.clone();
    for target in targets {
        for cell in pipeline.nodes[target.node].cells.clone() {
            if only.is_some_and(|o| o.node == target.node && o.cell.is_some_and(|c| c != cell)) {
                continue;
            }
            asked[cell].extend(target_ports(pipeline, *target).iter().map(|p| group_of(cell, *p)));
        }
    }
    // Cells stand after what they read, so that one walk backwards sees every reader before its source.
    for cell in (0..pipeline.cells.len()).rev() {
        let groups = asked[cell].clone();
        wanted[cell].extend(groups);
        if !wanted[cell].is_empty() {
            for feed in pipeline.cells[cell].inputs.iter().flatten() {
                wanted[feed.cell].insert(group_of(feed.cell, feed.port));
            }
        }
    }
    let (mut lanes, mut places) = (Lanes::new(), Places::new());
    for (cell, groups) in wanted.iter().enumerate() {
        for group in groups {
            let lane = lane(pipeline, cell, *group, asked[cell].contains(group), &places, environment)?;
            let inputs = lane.inputs.clone();
            let id = lanes.push(lane);
            places.insert((cell, *group), id);
            for (input, feeds) in inputs.pairs() {
                for (feed, from) in feeds.iter().enumerate() {
                    lanes[from.lane].readers.push(ReadingPort { lane: id, input, feed });
                }
            }
        }
    }
    if let Some(only) = only
        && let Some(item) = &only.item
    {
        restrict(pipeline, &mut lanes, only, item);
    }
    Ok(lanes)
}

fn lane(
    pipeline: &Pipeline,
    cell: usize,
    group: Group,
    target: bool,
    places: &Places,
    environment: Environment<'_>,
) -> Result<Lane, EngineError> {
    let node = pipeline.cells[cell].node;
    let spec = &pipeline.nodes[node].spec;
    let find = |cell: usize, port: PortId| places.get(&(cell, group_of(pipeline, cell, port))).copied();
    let inputs: Row<InputId, Vec<LaneFeed>> = pipeline.cells[cell]
        .inputs
        .iter()
        .map(|feeds| {
            feeds
                .iter()
                .filter_map(|feed| {
                    // Always found: whatever a wanted cell reads is wanted, and stands before it.
                    find(feed.cell, feed.port).map(|lane| LaneFeed {
                        lane,
                        port: feed.port,
                        prefix: feed.prefix.clone(),
                    })
                })
                .collect()
        })
        .collect();
    let each = |input: &InputId| spec.inputs[input.place()].takes == Takes::Item && !inputs[*input].is_empty();
    let driving = if spec.mode == Mode::Map { inputs.ids().find(each) } else { None };
    let ports = (0..spec.outputs.len()).filter(|p| spec.outputs[*p].group == group).map(PortId::at).collect();
    let (kind, params) = (&pipeline.nodes[node].kind, &pipeline.cells[cell].params);
    let environment = environment(&**kind, params, group)?;
    let unknown = environment.is_none();
    let programs = kind.runs_programs(params);
    let environment = environment.unwrap_or_else(probe::unknown);
    let shared = Basis { environment, ..Basis::new(spec.name, group.version, group.name) };
    let basis = LaneBasis::new(&shared, kind.keyed(params), spec.seeded.then_some(pipeline.seed));
    let readers = Vec::new();
    Ok(Lane { cell, node, group, basis, unknown, programs, ports, inputs, driving, readers, target, only: None })
}

/// Leaves of each lane only the items that one item of the target needs.
fn restrict(pipeline: &Pipeline, lanes: &mut Lanes, only: &Only, item: &ItemKey) {
    for lane in lanes.ids().rev() {
        if lanes[lane].target && lanes[lane].node == only.node {
            lanes[lane].only = Some(BTreeSet::from([item.clone()]));
            continue;
        }
        let mut keys = BTreeSet::new();
        let mut all = false;
        for reader in &lanes[lane].readers {
            let reading = &lanes[reader.lane];
            let prefix = &reading.inputs[reader.input][reader.feed].prefix;
            match &reading.only {
                Some(some) if !reading.is_whole(pipeline, reader.input) => {
                    let below = |key: &ItemKey| match prefix {
                        None => Some(key.clone()),
                        Some(p) => key.as_str().strip_prefix(p.as_str())?.strip_prefix('/').map(ItemKey::new)?.ok(),
                    };
                    keys.extend(some.iter().filter_map(below));
                }
                _ => all = true,
            }
        }
        let gather = pipeline.nodes[lanes[lane].node].spec.mode == Mode::Gather;
        lanes[lane].only = (!all && !gather).then_some(keys);
    }
}
