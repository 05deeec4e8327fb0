//! What is demanded: lanes, one for each cell and output group that the targets need.
//!
//! A lane is a queue of like actions. Lanes are few and known before the run; their items are many and are not.

use crate::pipeline::{Pipeline, Target};
use serde_json::Value;
use std::collections::BTreeSet;
use tauflow_contract::{Feed, ItemKey, Mode};

/// One cell's actions of one output group.
#[derive(Clone, Debug)]
pub struct Lane {
    /// The cell.
    pub cell: usize,
    /// Its node.
    pub node: usize,
    /// The group.
    pub group: &'static str,
    /// What of the machine decides its outputs; null for most kinds.
    pub environment: Value,
    /// The output ports of the group.
    pub ports: Vec<usize>,
    /// What feeds each input port.
    pub inputs: Vec<Vec<LaneFeed>>,
    /// The input port that decides which items there are.
    pub driving: Option<usize>,
    /// Who reads it.
    pub readers: Vec<Reader>,
    /// True if it is asked for itself.
    pub target: bool,
    /// The only items that are needed, if not all.
    pub only: Option<BTreeSet<ItemKey>>,
}

/// A lane's output that feeds an input.
#[derive(Clone, Debug)]
pub struct LaneFeed {
    /// The lane.
    pub lane: usize,
    /// Its output port.
    pub port: usize,
    /// What is put before its item keys.
    pub prefix: Option<String>,
}

/// Who reads a lane.
#[derive(Clone, Debug)]
pub struct Reader {
    /// The reading lane.
    pub lane: usize,
    /// Its input port.
    pub input: usize,
    /// Which of that port's feeds this is.
    pub feed: usize,
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
    /// What is wrong, in words.
    pub fn parse(text: &str, pipeline: &Pipeline) -> Result<Self, String> {
        let (name, rest) = text.split_once('/').map_or((text, None), |(name, rest)| (name, Some(rest)));
        let node = pipeline.node(name).ok_or_else(|| {
            let names = pipeline.nodes.iter().map(|n| n.name.as_str());
            format!("there is no node `{name}`; {}", crate::diagnostics::did_you_mean(name, "nodes", names))
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
        Ok(Self { node, cell: None, item: Some(item(rest)?) })
    }
}

impl Lane {
    /// True if the input port waits for the whole collection.
    pub fn is_whole(&self, pipeline: &Pipeline, input: usize) -> bool {
        let spec = &pipeline.nodes[self.node].spec;
        spec.mode != Mode::Map || spec.inputs[input].feed == Feed::Whole
    }
}

/// The ports of a node that a target asks for.
pub fn target_ports(pipeline: &Pipeline, target: Target) -> Vec<usize> {
    let outputs = &pipeline.nodes[target.node].spec.outputs;
    match target.port {
        Some(port) => vec![port],
        None => (0..outputs.len()).filter(|p| *p == 0 || outputs[*p].publish).collect(),
    }
}

/// The lanes that the targets need, each after all that it reads.
pub fn demand(pipeline: &Pipeline, targets: &[Target], only: Option<&Only>) -> Vec<Lane> {
    let group_of = |cell: usize, port: usize| pipeline.nodes[pipeline.cells[cell].node].spec.outputs[port].group;
    let mut wanted: Vec<BTreeSet<&'static str>> = vec![BTreeSet::new(); pipeline.cells.len()];
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
    let mut lanes: Vec<Lane> = Vec::new();
    for (cell, groups) in wanted.iter().enumerate() {
        for group in groups {
            let lane = lane(pipeline, cell, group, asked[cell].contains(group), &lanes);
            let index = lanes.len();
            for (input, feeds) in lane.inputs.iter().enumerate() {
                for (feed, from) in feeds.iter().enumerate() {
                    lanes[from.lane].readers.push(Reader { lane: index, input, feed });
                }
            }
            lanes.push(lane);
        }
    }
    if let Some(only) = only
        && let Some(item) = &only.item
    {
        restrict(pipeline, &mut lanes, only, item);
    }
    lanes
}

fn lane(pipeline: &Pipeline, cell: usize, group: &'static str, target: bool, lanes: &[Lane]) -> Lane {
    let node = pipeline.cells[cell].node;
    let spec = &pipeline.nodes[node].spec;
    let find = |cell: usize, port: usize| {
        let group = pipeline.nodes[pipeline.cells[cell].node].spec.outputs[port].group;
        lanes.iter().position(|l| l.cell == cell && l.group == group)
    };
    let inputs: Vec<Vec<LaneFeed>> = pipeline.cells[cell]
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
    let each = |input: &usize| spec.inputs[*input].feed == Feed::Each && !inputs[*input].is_empty();
    let driving = if spec.mode == Mode::Map { (0..inputs.len()).find(each) } else { None };
    let ports = (0..spec.outputs.len()).filter(|p| spec.outputs[*p].group == group).collect();
    let environment = pipeline.nodes[node].kind.environment(&pipeline.cells[cell].params, group);
    Lane { cell, node, group, environment, ports, inputs, driving, readers: Vec::new(), target, only: None }
}

/// Leaves of each lane only the items that one item of the target needs.
fn restrict(pipeline: &Pipeline, lanes: &mut [Lane], only: &Only, item: &ItemKey) {
    for index in (0..lanes.len()).rev() {
        if lanes[index].target && lanes[index].node == only.node {
            lanes[index].only = Some(BTreeSet::from([item.clone()]));
            continue;
        }
        let mut keys = BTreeSet::new();
        let mut all = false;
        for reader in &lanes[index].readers {
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
        let gather = pipeline.nodes[lanes[index].node].spec.mode == Mode::Gather;
        lanes[index].only = (!all && !gather).then_some(keys);
    }
}
