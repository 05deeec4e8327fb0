//! Pipelines: a file as written, with positions (`file`, `values`, `overrides`, `node`), and [`Pipeline`] as resolved:
//! valid, named values put in, defaults filled, matrices expanded. Later code does not validate again.

pub mod chart;
pub mod draw;
mod file;
mod foresee;
mod node;
mod outside;
mod overrides;
mod read;
pub mod reference;
mod resolve;
mod resources;
pub mod schema;
pub mod schema_check;
mod values;
mod wire;
pub mod yaml;

pub use resolve::{Options, check, resolve, resolve_text};
pub use resources::AskedResources;

use crate::ids::{Id, PortId};
use serde_json::Value;
use std::{
    fmt,
    ops::Range,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
};
use tauflow_contract::{KindSpec, Mode, NodeKind, Resources};

/// A resolved pipeline.
#[derive(Clone, Debug)]
pub struct Pipeline {
    /// Its name.
    pub name: String,
    /// Its seed.
    pub seed: u64,
    /// Its nodes, in an order in which each stands after all that it reads.
    pub nodes: Vec<Node>,
    /// The cells of all nodes, in the same order.
    pub cells: Vec<Cell>,
    /// The request.
    pub targets: Vec<Target>,
}

/// A node: a kind, its cells.
#[derive(Clone)]
pub struct Node {
    /// Its name.
    pub name: String,
    /// Its kind.
    pub kind: Arc<dyn NodeKind>,
    /// The spec of the kind.
    pub spec: KindSpec,
    /// Its axes, with the texts of their values.
    pub axes: Vec<(String, Vec<String>)>,
    /// Its cells, a range of [`Pipeline::cells`].
    pub cells: Range<usize>,
    /// Its outputs are handed on in memory and need not be stored, unless they are asked for.
    pub transient: bool,
    /// The resources that its actions ask a scheduler for, where they are not those of the kind.
    pub resources: AskedResources,
}

impl fmt::Debug for Node {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Node").field("name", &self.name).field("kind", &self.spec.name).finish_non_exhaustive()
    }
}

/// One cell of a node's matrix; a node without a matrix has one.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Its node.
    pub node: usize,
    /// `axis=value+axis2=value2`, or empty.
    pub text: String,
    /// Its value on each axis.
    pub coords: Vec<(String, String)>,
    /// The params, resolved: every default filled in.
    pub params: Value,
    /// For each input port of the kind, what feeds it; empty if it is not connected.
    pub inputs: Vec<Vec<Connection>>,
}

/// One collection that feeds an input port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Connection {
    /// The cell it comes from.
    pub cell: usize,
    /// The output port of that cell.
    pub port: PortId,
    /// The prefix of its item keys, if cells are gathered.
    pub prefix: Option<String>,
}

/// A node that is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Target {
    /// The node.
    pub node: usize,
    /// One of its ports, or the default port and all that it publishes.
    pub port: Option<PortId>,
}

impl Pipeline {
    /// A node by name.
    pub fn node(&self, name: &str) -> Option<usize> {
        self.nodes.iter().position(|node| node.name == name)
    }

    /// `node`, or `node[cell]`.
    pub fn cell_name(&self, cell: usize) -> String {
        let cell = &self.cells[cell];
        let name = &self.nodes[cell.node].name;
        if cell.text.is_empty() { name.clone() } else { format!("{name}[{}]", cell.text.replace('+', ", ")) }
    }

    /// The nodes that a node reads, without repetitions.
    pub fn reads(&self, node: usize) -> Vec<usize> {
        let mut found: Vec<usize> = self.cells[self.nodes[node].cells.clone()]
            .iter()
            .flat_map(|cell| cell.inputs.iter().flatten().map(|from| self.cells[from.cell].node))
            .collect();
        found.sort_unstable();
        found.dedup();
        found
    }
}

impl Node {
    /// The resources that an action of these params and this group asks a scheduler for.
    pub fn resources_of(&self, params: &Value, group: &str) -> Resources {
        // A kind that panics tells of it when its action runs.
        let kind = catch_unwind(AssertUnwindSafe(|| self.kind.resources(params, group))).unwrap_or_default();
        self.resources.over(kind)
    }

    /// How it works through items.
    pub fn mode(&self) -> Mode {
        self.spec.mode
    }

    /// The number of an output port.
    pub fn output(&self, name: &str) -> Option<PortId> {
        self.spec.outputs.iter().position(|port| port.name == name).map(PortId::at)
    }
}
