//! Connects inputs to outputs: references, media types, matrix cells, and the order of nodes.

use super::{
    Feed,
    file::{PipelineFile, RawNode},
    reference::Reference,
    resolve::Draft,
};
use crate::diagnostics::{Problem, Span, did_you_mean};
use petgraph::{algo::tarjan_scc, graph::DiGraph};
use std::collections::BTreeSet;

/// All connections of a pipeline.
pub(super) struct Wiring {
    pub names: Vec<String>,
    links: Vec<Link>,
    /// Source, reader, and where the reader names the source.
    edges: Vec<(usize, usize, Span)>,
    /// The axes of what each node reads.
    bound: Vec<BTreeSet<String>>,
}

/// One connection, between cells of drafts.
struct Link {
    reader: usize,
    reader_cell: usize,
    input: usize,
    source: usize,
    source_cell: usize,
    output: usize,
    prefix: Option<String>,
}

impl Wiring {
    /// What feeds each input of a cell. `first` is the first cell of each draft in the pipeline.
    pub fn feeds(&self, node: usize, cell: usize, inputs: usize, first: &[usize]) -> Vec<Vec<Feed>> {
        let mut feeds = vec![Vec::new(); inputs];
        for link in self.links.iter().filter(|l| l.reader == node && l.reader_cell == cell) {
            let cell = first[link.source] + link.source_cell;
            feeds[link.input].push(Feed { cell, port: link.output, prefix: link.prefix.clone() });
        }
        feeds
    }

    /// The axes of all nodes that a node reads. A node that is not wired reads none.
    pub fn axes_read(&self, node: &str) -> BTreeSet<String> {
        let Some(index) = self.names.iter().position(|n| n == node) else { return BTreeSet::new() };
        self.bound[index].clone()
    }
}

/// Follows every reference.
pub(super) fn wire(file: &PipelineFile, drafts: &[Draft], problems: &mut Vec<Problem>) -> Wiring {
    let names: Vec<String> = file.nodes.iter().map(|n| n.name.text.clone()).collect();
    let mut wiring = Wiring { bound: vec![BTreeSet::new(); names.len()], names, links: Vec::new(), edges: Vec::new() };
    for (reader, raw) in file.nodes.iter().enumerate() {
        Wirer { file, drafts, problems, wiring: &mut wiring }.node(reader, raw);
    }
    wiring
}

/// An order of nodes in which each stands after all that it reads; `None` if there is a cycle, which is a problem.
pub(super) fn order(file: &PipelineFile, wiring: &Wiring, problems: &mut Vec<Problem>) -> Option<Vec<usize>> {
    let mut graph: DiGraph<usize, Span> = DiGraph::new();
    let vertices: Vec<_> = (0..file.nodes.len()).map(|i| graph.add_node(i)).collect();
    for (source, reader, span) in &wiring.edges {
        graph.add_edge(vertices[*source], vertices[*reader], *span);
    }
    let mut fine = true;
    for component in tarjan_scc(&graph) {
        let members: BTreeSet<usize> = component.iter().map(|v| graph[*v]).collect();
        let edges: Vec<&(usize, usize, Span)> =
            wiring.edges.iter().filter(|(s, r, _)| members.contains(s) && members.contains(r)).collect();
        let Some((_, _, span)) = edges.first() else { continue };
        fine = false;
        let path = cycle(&edges).iter().map(|i| file.nodes[*i].name.text.clone()).collect::<Vec<_>>().join(" -> ");
        problems.push(
            Problem::at(*span, format!("nodes read each other in a circle: {path}"))
                .hint("take one of these inputs away; a pipeline goes one way"),
        );
    }
    if !fine {
        return None;
    }
    // Of the nodes that could come next, the one that stands first in the file.
    let mut waiting: Vec<usize> = (0..file.nodes.len()).collect();
    let mut order = Vec::new();
    while let Some(at) = waiting
        .iter()
        .position(|n| wiring.edges.iter().all(|(source, reader, _)| reader != n || order.contains(source)))
    {
        order.push(waiting.remove(at));
    }
    Some(order)
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
    file: &'a PipelineFile,
    drafts: &'a [Draft],
    problems: &'a mut Vec<Problem>,
    wiring: &'a mut Wiring,
}

impl Wirer<'_> {
    fn problem(&mut self, span: Span, message: impl Into<String>, hint: impl Into<String>) {
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
                let message = format!("the input `{}` of `{}` is missing", port.name, raw.name.text);
                let hint =
                    format!("add `inputs: {{ {}: NODE }}`, items of type `{}`: {}", port.name, port.media, port.doc);
                self.problem(raw.name.span, message, hint);
            }
        }
    }

    fn reference(&mut self, reader: usize, input: Option<usize>, reference: &Reference<'_>, span: Span) {
        let Some(source) = self.wiring.names.iter().position(|n| n == reference.node) else {
            let names: Vec<&str> = self.file.nodes.iter().map(|n| n.name.text.as_str()).collect();
            let message = format!("there is no node `{}`", reference.node);
            self.problem(span, message, did_you_mean(reference.node, "nodes", names));
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
        let Some((output, port)) = output.and_then(|o| spec.outputs.get(o).map(|p| (o, p))) else {
            let name = reference.port.unwrap_or_default();
            let message = format!("`{}` has no output `{name}`", reference.node);
            self.problem(span, message, did_you_mean(name, "outputs", spec.outputs.iter().map(|p| p.name)));
            return;
        };
        let (Some(input), Some((_, reading))) = (input, &self.drafts[reader].kind) else { return };
        let wanted = &reading.inputs[input];
        if wanted.media != "*" && port.media != "*" && wanted.media != port.media {
            let message = format!(
                "the input `{}` takes `{}`, and `{}.{}` gives `{}`",
                wanted.name, wanted.media, reference.node, port.name, port.media
            );
            let fits = spec.outputs.iter().find(|p| p.media == wanted.media);
            let hint = fits.map_or_else(
                || format!("connect an output of type `{}`", wanted.media),
                |p| format!("`{}.{}` would fit", reference.node, p.name),
            );
            self.problem(span, message, hint);
            return;
        }
        if fine {
            self.cells(reader, input, source, output, reference, span);
        }
    }

    /// Binds equal axes cell to cell, and gathers the axes that the reader has not.
    fn cells(
        &mut self,
        reader: usize,
        input: usize,
        source: usize,
        output: usize,
        reference: &Reference<'_>,
        span: Span,
    ) {
        let drafts = self.drafts;
        for (reader_cell, reading) in drafts[reader].cells.iter().enumerate() {
            let mut any = false;
            for (source_cell, giving) in drafts[source].cells.iter().enumerate() {
                let mut gathered = Vec::new();
                let fits = giving.coords.iter().all(|(axis, value)| {
                    if let Some((_, picked)) = reference.select.iter().find(|(a, _)| a == axis) {
                        return picked == value;
                    }
                    if let Some((_, own)) = reading.coords.iter().find(|(a, _)| a == axis) {
                        return own == value;
                    }
                    gathered.push(format!("{axis}={value}"));
                    true
                });
                if !fits {
                    continue;
                }
                any = true;
                let prefix = (!gathered.is_empty()).then(|| gathered.join("+"));
                let repeated = self.wiring.links.iter().any(|l| {
                    (l.reader, l.reader_cell, l.input) == (reader, reader_cell, input)
                        && (l.source, l.source_cell, l.output) == (source, source_cell, output)
                        && l.prefix == prefix
                });
                if repeated {
                    let message = format!("`{}` stands twice in this input", reference.node);
                    self.problem(span, message, "take one away: item keys must differ");
                    return;
                }
                self.wiring.links.push(Link { reader, reader_cell, input, source, source_cell, output, prefix });
            }
            if !any {
                let message = format!(
                    "the cell `{}` of `{}` finds no cell of `{}` with the same values",
                    reading.text(),
                    self.wiring.names[reader],
                    reference.node
                );
                let axes: Vec<String> =
                    drafts[source].axes.iter().map(|(a, v)| format!("{a}: [{}]", v.join(", "))).collect();
                self.problem(span, message, format!("its axes are {}", axes.join("; ")));
                return;
            }
        }
    }
}
