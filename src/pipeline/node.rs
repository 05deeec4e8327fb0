//! Raw nodes: kind, inputs, params and matrix, with positions; and matrices copied from other nodes.

use super::{
    AskedResources, read,
    values::Values,
    yaml::{Data, Key, Yaml},
};
use crate::diagnostics::{Hint, Problem, Span};
use std::{collections::HashMap, sync::Arc};

/// A node as written.
#[derive(Debug)]
pub(super) struct RawNode {
    /// Its name.
    pub name: Key,
    /// Its kind's name.
    pub kind: Option<Key>,
    /// Its inputs.
    pub inputs: Vec<RawInput>,
    /// Its params: a map.
    pub params: Yaml,
    /// Its axes.
    pub matrix: Vec<Axis>,
    /// The node whose axes stand before its own.
    pub like: Option<Key>,
    /// Where its matrix stands, or else its name.
    pub matrix_span: Span,
    /// Its outputs need not be stored.
    pub transient: bool,
    /// The resources that it asks a scheduler for.
    pub resources: AskedResources,
}

/// An input as written.
#[derive(Debug)]
pub(super) struct RawInput {
    /// The port.
    pub port: Key,
    /// The node that it refers to.
    pub refs: Vec<Key>,
}

/// An axis as written.
#[derive(Clone, Debug)]
pub(super) struct Axis {
    /// Its name.
    pub name: Key,
    /// Its values.
    pub values: Vec<Yaml>,
    /// It is another node's, where its values are checked.
    pub taken: bool,
}

const NODE: [&str; 6] = ["kind", "inputs", "params", "matrix", "transient", "resources"];
/// The key of a matrix that is no axis.
const LIKE: &str = "like";

/// A node has at most so many cells, and all nodes together have.
const MOST_CELLS: u128 = 10_000;
const MOST_IN_ALL: u128 = 100_000;
/// A node has at most so many axes.
const MOST_AXES: usize = 32;
/// A value of an axis that holds more values than this cannot name a cell.
const LONGEST_VALUE: usize = 1_000;

/// Reads all nodes, with named values put in, and gives each its axes.
pub(super) fn read(nodes: Vec<(Key, Yaml)>, values: &mut Values, problems: &mut Vec<Problem>) -> Vec<RawNode> {
    let keys: Arc<[String]> = NODE.iter().map(|key| (*key).to_owned()).collect();
    let mut reader = NodeReader { values, problems, keys };
    let mut nodes: Vec<RawNode> = nodes.into_iter().map(|(name, body)| reader.node(name, body)).collect();
    let count = nodes.len();
    let (done, failed) = (vec![false; count], vec![false; count]);
    Matrices { nodes: &mut nodes, problems, of: vec![None; count], done, failed, cells: 0 }.settle();
    nodes
}

struct NodeReader<'a> {
    values: &'a mut Values,
    problems: &'a mut Vec<Problem>,
    keys: Arc<[String]>,
}

impl NodeReader<'_> {
    fn problem(&mut self, span: Span, message: impl Into<String>, hint: impl Into<Hint>) {
        self.problems.push(Problem::at(span, message).hint(hint));
    }

    fn node(&mut self, name: Key, body: Yaml) -> RawNode {
        let mut node = RawNode {
            kind: None,
            inputs: Vec::new(),
            params: Yaml { data: Data::Map(Vec::new()), span: name.span },
            matrix: Vec::new(),
            like: None,
            matrix_span: name.span,
            transient: false,
            resources: AskedResources::default(),
            name,
        };
        let mut has_kind = false;
        for (key, value) in read::map(body, "a node", self.problems) {
            // A kind says what may stand beside it, to people and editors, so it is written out.
            let value = if key.text == "kind" { value } else { self.values.fill(value) };
            match key.text.as_str() {
                "kind" => {
                    has_kind = true;
                    node.kind = read::name(&value, "a kind", self.problems);
                }
                "inputs" => node.inputs = self.inputs(value),
                "params" => {
                    let span = value.span;
                    node.params = Yaml { data: Data::Map(read::map(value, "params", self.problems)), span };
                }
                "matrix" => {
                    node.matrix_span = value.span;
                    (node.like, node.matrix) = self.matrix(value);
                }
                "resources" => node.resources = AskedResources::read(value, self.problems),
                "transient" => match value.data {
                    Data::Bool(transient) => node.transient = transient,
                    _ => {
                        let message = format!("`transient` must be true or false, found {}", value.sort());
                        self.problem(value.span, message, "write `transient: true`, or omit it");
                    }
                },
                other => {
                    let hint = Hint::near(other, "keys of a node", &self.keys);
                    self.problem(key.span, format!("unknown key `{other}` of a node"), hint);
                }
            }
        }
        if !has_kind {
            let message = format!("the node `{}` has no kind", node.name.text);
            self.problem(node.name.span, message, "add `kind: ...`; `tauflow kinds` lists them");
        }
        node
    }

    fn inputs(&mut self, value: Yaml) -> Vec<RawInput> {
        let mut inputs = Vec::new();
        for (port, value) in read::map(value, "inputs", self.problems) {
            let refs = read::texts(&value, "an input", self.problems);
            if refs.is_empty() && matches!(&value.data, Data::List(list) if list.is_empty()) {
                let message = format!("the input `{}` is empty", port.text);
                self.problem(value.span, message, "name a node, or omit the input");
            }
            inputs.push(RawInput { port, refs });
        }
        inputs
    }

    fn matrix(&mut self, value: Yaml) -> (Option<Key>, Vec<Axis>) {
        let (mut like, mut axes) = (None, Vec::new());
        for (name, values) in read::map(value, "matrix", self.problems) {
            if name.text == LIKE {
                like = read::name(&values, "the node that a matrix is like", self.problems);
                continue;
            }
            read::check_name(&name, "an axis", self.problems);
            match values.data {
                Data::List(list) if !list.is_empty() => axes.push(Axis { name, values: list, taken: false }),
                Data::List(_) => {
                    let message = format!("the axis `{}` has no values", name.text);
                    self.problem(values.span, message, "give at least one value");
                }
                _ => {
                    let message = format!("the axis `{}` is {}, expected a list of values", name.text, values.sort());
                    self.problem(values.span, message, "write `[a, b]`");
                }
            }
        }
        (like, axes)
    }
}

/// Puts before each node's axes those of the node that its matrix is like, and holds all to the bounds.
struct Matrices<'a> {
    nodes: &'a mut [RawNode],
    problems: &'a mut Vec<Problem>,
    /// The node that each is like.
    of: Vec<Option<usize>>,
    done: Vec<bool>,
    /// Something is wrong with its matrix, and was said.
    failed: Vec<bool>,
    cells: u128,
}

impl Matrices<'_> {
    fn problem(&mut self, span: Span, message: impl Into<String>, hint: impl Into<Hint>) {
        self.problems.push(Problem::at(span, message).hint(hint));
    }

    fn settle(mut self) {
        let index: HashMap<String, usize> =
            self.nodes.iter().enumerate().map(|(i, n)| (n.name.text.clone(), i)).collect();
        let names: Arc<[String]> = self.nodes.iter().map(|n| n.name.text.clone()).collect();
        for at in 0..self.nodes.len() {
            let Some(like) = self.nodes[at].like.clone() else { continue };
            self.of[at] = index.get(&like.text).copied();
            if self.of[at].is_none() {
                self.failed[at] = true;
                let hint = Hint::near(&like.text, "nodes", &names);
                self.problem(like.span, format!("unknown node `{}`", like.text), hint);
            }
        }
        for start in 0..self.nodes.len() {
            // Down to a node whose axes are known, then back up.
            for node in self.path(start).into_iter().rev() {
                self.done[node] = true;
                self.take(node);
                self.hold(node);
            }
        }
    }

    /// From a node to the one that it is like, and on, as far as they are not done.
    fn path(&mut self, start: usize) -> Vec<usize> {
        let mut path: Vec<usize> = Vec::new();
        let mut place: HashMap<usize, usize> = HashMap::new();
        let mut at = Some(start);
        while let Some(node) = at.filter(|node| !self.done[*node]) {
            if let Some(&from) = place.get(&node) {
                let mut circle: Vec<&str> = path[from..].iter().map(|i| self.nodes[*i].name.text.as_str()).collect();
                circle.push(&self.nodes[node].name.text);
                let message = format!("cyclic `like` of matrices: {}", circle.join(" -> "));
                let span = self.nodes[node].like.as_ref().map_or(self.nodes[node].name.span, |like| like.span);
                self.problem(span, message, "write out the axes of one of them");
                // Opened here, the circle is told of once.
                let last = path[path.len() - 1];
                self.of[last] = None;
                self.failed[last] = true;
                break;
            }
            place.insert(node, path.len());
            path.push(node);
            at = self.of[node];
        }
        path
    }

    fn take(&mut self, node: usize) {
        let (Some(from), Some(like)) = (self.of[node], self.nodes[node].like.clone()) else { return };
        if self.failed[from] {
            self.failed[node] = true;
            return;
        }
        let taken = self.nodes[from].matrix.clone();
        if taken.is_empty() {
            let message = format!("`{}` has no matrix to copy", like.text);
            self.problem(like.span, message, "name a node that has one, or write out the axes");
            self.failed[node] = true;
        }
        let is_taken = |axis: &Axis| taken.iter().any(|other| other.name.text == axis.name.text);
        let (double, own): (Vec<Axis>, Vec<Axis>) =
            std::mem::take(&mut self.nodes[node].matrix).into_iter().partition(is_taken);
        for axis in double {
            let message = format!("the axis `{}` is already an axis of `{}`", axis.name.text, like.text);
            self.problem(axis.name.span, message, "remove it, or write out all axes");
        }
        let here = |axis: Axis| Axis {
            name: Key { text: axis.name.text, span: like.span },
            values: axis.values.iter().map(|value| value.standing_at(like.span)).collect(),
            taken: true,
        };
        self.nodes[node].matrix = taken.into_iter().map(here).chain(own).collect();
    }

    /// Cells are made one by one, so there may not be too many of them.
    fn hold(&mut self, node: usize) {
        let RawNode { name, matrix, matrix_span, .. } = &self.nodes[node];
        let (name, span, axes) = (name.text.clone(), *matrix_span, matrix.len());
        let cells = matrix.iter().fold(1u128, |cells, axis| cells.saturating_mul(axis.values.len() as u128));
        // A value that names a cell is short; a long one is told of later, and not copied now.
        let long = matrix.iter().flat_map(|axis| &axis.values).any(|value| value.size().0 > LONGEST_VALUE);
        let total = self.cells.saturating_add(cells);
        let hint = "remove values or axes, or use several nodes";
        if axes > MOST_AXES {
            self.problem(
                span,
                format!("the matrix of `{name}` has {axes} axes, at most {MOST_AXES} are allowed"),
                hint,
            );
        } else if cells > MOST_CELLS {
            let count = if cells == u128::MAX { "more than 10^38".into() } else { cells.to_string() };
            let message = format!("the matrix of `{name}` has {count} cells, at most {MOST_CELLS} are allowed");
            self.problem(span, message, hint);
        } else if total > MOST_IN_ALL {
            // Told of once: the next ones are not to blame more than this one.
            if self.cells <= MOST_IN_ALL {
                let message =
                    format!("up to `{name}`, the nodes have {total} cells, at most {MOST_IN_ALL} are allowed");
                self.problem(span, message, hint);
            }
            self.cells = total;
        } else {
            self.cells = total;
            self.failed[node] |= long;
            return;
        }
        self.failed[node] = true;
        self.nodes[node].matrix.truncate(MOST_AXES);
        self.nodes[node].matrix.iter_mut().for_each(|axis| axis.values.truncate(1));
    }
}
