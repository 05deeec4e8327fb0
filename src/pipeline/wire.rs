//! Connects inputs to outputs: references, media types, matrix cells, and the order of nodes.

use super::{Connection, node::RawNode, reference::Reference, resolve::Draft};
use crate::{
    diagnostics::{Hint, MOST_SHOWN, Problem, Span, did_you_mean, listed},
    ids::{Id, PortId},
};
use petgraph::{algo::tarjan_scc, graph::DiGraph};
use std::{
    cmp::Reverse,
    collections::{BTreeSet, BinaryHeap, HashMap, HashSet},
    sync::Arc,
};
use tauflow_contract::Any;

/// A pipeline has at most so many connections between cells.
const MOST_LINKS: usize = 1_000_000;

/// All connections of a pipeline.
pub(super) struct Wiring {
    pub names: Arc<[String]>,
    index: HashMap<String, usize>,
    links: Vec<Link>,
    /// The links of a reader's cell.
    of_cell: HashMap<(usize, usize), Vec<usize>>,
    /// Source, reader, and where the reader names the source.
    edges: Vec<(usize, usize, Span)>,
    /// The axes of what each node reads.
    bound: Vec<BTreeSet<String>>,
}

/// One connection, between cells of drafts.
#[derive(Clone, PartialEq, Eq, Hash)]
struct Link {
    reader: usize,
    reader_cell: usize,
    input: usize,
    source: usize,
    source_cell: usize,
    output: PortId,
    prefix: Option<String>,
}

/// An output that an input does not take.
struct Misfit {
    reader: usize,
    source: usize,
    wanted: &'static str,
    span: Span,
    message: String,
}

impl Wiring {
    /// The sources of each input of a cell. `first` is the first cell of each draft in the pipeline.
    pub fn connections(&self, node: usize, cell: usize, inputs: usize, first: &[usize]) -> Vec<Vec<Connection>> {
        let mut connections = vec![Vec::new(); inputs];
        for link in self.of_cell.get(&(node, cell)).into_iter().flatten().map(|at| &self.links[*at]) {
            let cell = first[link.source] + link.source_cell;
            connections[link.input].push(Connection { cell, port: link.output, prefix: link.prefix.clone() });
        }
        connections
    }

    /// The axes of all nodes that a node reads.
    pub fn axes_read(&self, node: usize) -> &BTreeSet<String> {
        &self.bound[node]
    }

    /// All nodes that read a node, directly or not, and itself.
    fn below(&self, node: usize) -> HashSet<usize> {
        let mut readers: HashMap<usize, Vec<usize>> = HashMap::new();
        for (source, reader, _) in &self.edges {
            readers.entry(*source).or_default().push(*reader);
        }
        let (mut found, mut open) = (HashSet::from([node]), vec![node]);
        while let Some(next) = open.pop() {
            open.extend(readers.get(&next).into_iter().flatten().copied().filter(|reader| found.insert(*reader)));
        }
        found
    }
}

/// Follows every reference.
pub(super) fn wire(nodes: &[RawNode], drafts: &[Draft], problems: &mut Vec<Problem>) -> Wiring {
    let wiring = Wiring {
        names: nodes.iter().map(|n| n.name.text.clone()).collect(),
        index: nodes.iter().enumerate().map(|(i, n)| (n.name.text.clone(), i)).collect(),
        links: Vec::new(),
        of_cell: HashMap::new(),
        edges: Vec::new(),
        bound: vec![BTreeSet::new(); nodes.len()],
    };
    let mut wirer = Wirer { drafts, problems, wiring, known: HashSet::new(), misfits: Vec::new() };
    for (reader, raw) in nodes.iter().enumerate() {
        wirer.node(reader, raw);
    }
    wirer.tell_misfits();
    let mut wiring = wirer.wiring;
    for (at, link) in wiring.links.iter().enumerate() {
        wiring.of_cell.entry((link.reader, link.reader_cell)).or_default().push(at);
    }
    wiring
}

/// An order of nodes in which each stands after all that it reads; `None` if there is a cycle, which is a problem.
pub(super) fn order(wiring: &Wiring, problems: &mut Vec<Problem>) -> Option<Vec<usize>> {
    let mut graph: DiGraph<usize, Span> = DiGraph::new();
    let vertices: Vec<_> = (0..wiring.names.len()).map(|i| graph.add_node(i)).collect();
    for (source, reader, span) in &wiring.edges {
        graph.add_edge(vertices[*source], vertices[*reader], *span);
    }
    let mut fine = true;
    for component in tarjan_scc(&graph) {
        // One node alone is a circle only if it reads itself.
        if let [only] = component[..]
            && graph.find_edge(only, only).is_none()
        {
            continue;
        }
        let members: BTreeSet<usize> = component.iter().map(|v| graph[*v]).collect();
        let edges: Vec<&(usize, usize, Span)> =
            wiring.edges.iter().filter(|(s, r, _)| members.contains(s) && members.contains(r)).collect();
        let Some((_, _, span)) = edges.first() else { continue };
        fine = false;
        let path = cycle(&edges).iter().map(|i| wiring.names[*i].clone()).collect::<Vec<_>>().join(" -> ");
        problems.push(Problem::at(*span, format!("cyclic inputs: {path}")).hint("remove one of these inputs"));
    }
    fine.then(|| in_order(wiring))
}

/// Among the nodes that could come next, the first one in the file.
fn in_order(wiring: &Wiring) -> Vec<usize> {
    let mut waits_for = vec![0usize; wiring.names.len()];
    let mut readers = vec![Vec::new(); wiring.names.len()];
    for (source, reader, _) in &wiring.edges {
        waits_for[*reader] += 1;
        readers[*source].push(*reader);
    }
    let mut ready: BinaryHeap<Reverse<usize>> =
        (0..wiring.names.len()).filter(|node| waits_for[*node] == 0).map(Reverse).collect();
    let mut order = Vec::new();
    while let Some(Reverse(node)) = ready.pop() {
        order.push(node);
        for reader in &readers[node] {
            waits_for[*reader] -= 1;
            if waits_for[*reader] == 0 {
                ready.push(Reverse(*reader));
            }
        }
    }
    order
}

/// A closed path along the edges of a strongly connected component, from its first node back to it.
fn cycle(edges: &[&(usize, usize, Span)]) -> Vec<usize> {
    let start = edges.iter().map(|(s, ..)| *s).min().unwrap_or_default();
    let mut paths = vec![vec![start]];
    // Breadth first, so that the shortest circle is named.
    for _ in 0..=edges.len() {
        let mut longer = Vec::new();
        for path in &paths {
            let last = path[path.len() - 1];
            for (_, reader, _) in edges.iter().filter(|(source, ..)| *source == last) {
                let mut next = path.clone();
                next.push(*reader);
                if *reader == start {
                    return next;
                }
                if !path.contains(reader) {
                    longer.push(next);
                }
            }
        }
        longer.truncate(1000);
        paths = longer;
    }
    vec![start, start]
}

struct Wirer<'a> {
    drafts: &'a [Draft],
    problems: &'a mut Vec<Problem>,
    wiring: Wiring,
    /// All links, to find those that stand twice.
    known: HashSet<Link>,
    misfits: Vec<Misfit>,
}

impl Wirer<'_> {
    fn problem(&mut self, span: Span, message: impl Into<String>, hint: impl Into<Hint>) {
        self.problems.push(Problem::at(span, message).hint(hint));
    }

    fn node(&mut self, reader: usize, raw: &RawNode) {
        let spec = self.drafts[reader].kind.as_ref().map(|(_, spec)| spec.clone());
        for input in &raw.inputs {
            let port = spec.as_ref().and_then(|s| s.inputs.iter().position(|p| p.name == input.port.text));
            if let (Some(spec), None) = (&spec, port) {
                let message = format!("`{}` has no input `{}`", spec.name, input.port.text);
                let hint = did_you_mean(&input.port.text, "inputs", spec.inputs.iter().map(|p| p.name));
                self.problem(input.port.span, message, hint);
            }
            for text in &input.refs {
                match Reference::parse(&text.text) {
                    Ok(reference) => self.reference(reader, port, &reference, text.span),
                    Err(message) => {
                        self.problem(text.span, message, "write `node`, `node.port` or `node[axis=value].port`");
                    }
                }
            }
        }
        let Some(spec) = spec else { return };
        for port in spec.inputs.iter().filter(|p| !p.optional) {
            if raw.inputs.iter().all(|i| i.port.text != port.name) {
                let message = format!("missing input `{}` of `{}`", port.name, raw.name.text);
                let hint =
                    format!("add `inputs: {{ {}: NODE }}`, items of type `{}`: {}", port.name, port.media, port.doc);
                self.problem(raw.name.span, message, hint);
            }
        }
    }

    fn reference(&mut self, reader: usize, input: Option<usize>, reference: &Reference<'_>, span: Span) {
        let Some(&source) = self.wiring.index.get(reference.node) else {
            let hint = Hint::near(reference.node, "nodes", &self.wiring.names);
            self.problem(span, format!("unknown node `{}`", reference.node), hint);
            return;
        };
        self.wiring.edges.push((source, reader, span));
        let draft = &self.drafts[source];
        self.wiring.bound[reader].extend(draft.axes.iter().map(|(axis, _)| axis.clone()));
        let mut fine = true;
        for (axis, value) in &reference.select {
            let Some((_, values)) = draft.axes.iter().find(|(a, _)| a == axis) else {
                let message = format!("`{}` has no axis `{axis}`", reference.node);
                let hint = did_you_mean(axis, "axes", draft.axes.iter().map(|(a, _)| a.as_str()));
                self.problem(span, message, hint);
                fine = false;
                continue;
            };
            if !values.iter().any(|v| v == value) {
                let message = format!("the axis `{axis}` of `{}` has no value `{value}`", reference.node);
                let hint = did_you_mean(value, "values", values.iter().map(String::as_str));
                self.problem(span, message, hint);
                fine = false;
            }
        }
        let Some((_, spec)) = &draft.kind else { return };
        let output = match reference.port {
            None => Some(0),
            Some(name) => spec.outputs.iter().position(|p| p.name == name),
        };
        let Some((output, port)) = output.and_then(|o| spec.outputs.get(o).map(|p| (PortId::at(o), p))) else {
            let name = reference.port.unwrap_or_default();
            let message = format!("`{}` has no output `{name}`", reference.node);
            self.problem(span, message, did_you_mean(name, "outputs", spec.outputs.iter().map(|p| p.name)));
            return;
        };
        let (Some(input), Some((_, reading))) = (input, &self.drafts[reader].kind) else { return };
        let wanted = &reading.inputs[input];
        if wanted.media != Any::NAME && port.media != Any::NAME && wanted.media != port.media {
            let message = format!(
                "the input `{}` takes `{}`, but `{}.{}` produces `{}`",
                wanted.name, wanted.media, reference.node, port.name, port.media
            );
            self.misfits.push(Misfit { reader, source, wanted: wanted.media, span, message });
            return;
        }
        if fine {
            self.cells(reader, input, source, output, reference, span);
        }
    }

    /// Tells of connections that do not fit, with all ports that would.
    fn tell_misfits(&mut self) {
        self.misfits.sort_by_key(|misfit| misfit.span);
        for (at, Misfit { reader, source, wanted, span, message }) in
            std::mem::take(&mut self.misfits).into_iter().enumerate()
        {
            if at >= MOST_SHOWN {
                self.problem(span, message, format!("connect an output of type `{wanted}`"));
                continue;
            }
            // A dependent of this node cannot be its input.
            let below = self.wiring.below(reader);
            let others = (0..self.drafts.len()).filter(|node| *node != source);
            let fits: Vec<String> = [source]
                .into_iter()
                .chain(others)
                .filter(|node| !below.contains(node))
                .flat_map(|node| {
                    let outputs = self.drafts[node].kind.iter().flat_map(|(_, spec)| spec.outputs.iter());
                    let name = &self.wiring.names[node];
                    outputs
                        .filter(|p| p.media == wanted || p.media == Any::NAME)
                        .map(move |p| format!("`{name}.{}`", p.name))
                })
                .collect();
            let hint = match fits.len() {
                0 => format!("no node produces `{wanted}`; `tauflow kinds` lists the kinds"),
                _ => format!("{} would fit", listed(&fits)),
            };
            self.problem(span, message, hint);
        }
    }

    /// Binds equal axes cell to cell, and gathers the axes that the reader has not.
    fn cells(
        &mut self,
        reader: usize,
        input: usize,
        source: usize,
        output: PortId,
        reference: &Reference<'_>,
        span: Span,
    ) {
        let drafts = self.drafts;
        let picked = |axis: &str| reference.select.iter().any(|(a, _)| *a == axis);
        let has = |node: usize, axis: &str| drafts[node].axes.iter().any(|(a, _)| a == axis);
        // By their values on the axes that both have: the cells of the source that are picked.
        let shared = |coords: &[(String, String)]| -> Vec<String> {
            let axes = drafts[source].axes.iter().filter(|(axis, _)| !picked(axis) && has(reader, axis));
            axes.filter_map(|(axis, _)| coords.iter().find(|(a, _)| a == axis).map(|(_, value)| value.clone()))
                .collect()
        };
        let mut giving: HashMap<Vec<String>, Vec<(usize, Option<String>)>> = HashMap::new();
        for (at, cell) in drafts[source].cells.iter().enumerate() {
            let is = |(axis, value): &(&str, &str)| cell.coords.iter().any(|(a, v)| a == axis && v == value);
            if reference.select.iter().all(is) {
                let gathered = cell.coords.iter().filter(|(axis, _)| !picked(axis) && !has(reader, axis));
                let parts: Vec<String> = gathered.map(|(axis, value)| format!("{axis}={value}")).collect();
                let prefix = (!parts.is_empty()).then(|| parts.join("+"));
                giving.entry(shared(&cell.coords)).or_default().push((at, prefix));
            }
        }
        for (reader_cell, reading) in drafts[reader].cells.iter().enumerate() {
            let Some(cells) = giving.get(&shared(&reading.coords)) else {
                let message = format!(
                    "the cell `{}` of `{}` has no matching cell of `{}`",
                    reading.text(),
                    self.wiring.names[reader],
                    reference.node
                );
                let axes: Vec<String> =
                    drafts[source].axes.iter().map(|(a, v)| format!("{a}: [{}]", v.join(", "))).collect();
                self.problem(span, message, format!("its axes are {}", axes.join("; ")));
                return;
            };
            if self.wiring.links.len() + cells.len() > MOST_LINKS {
                let message = format!("with `{}`, cells have more than {MOST_LINKS} connections", reference.node);
                self.problem(
                    span,
                    message,
                    "give axes of both nodes the same name, or select cells: `node[axis=value]`",
                );
                return;
            }
            for (source_cell, prefix) in cells {
                let (source_cell, prefix) = (*source_cell, prefix.clone());
                let link = Link { reader, reader_cell, input, source, source_cell, output, prefix };
                if !self.known.insert(link.clone()) {
                    let message = format!("`{}` occurs twice in this input", reference.node);
                    self.problem(span, message, "remove one: item keys must differ");
                    return;
                }
                self.wiring.links.push(link);
            }
        }
    }
}
