//! Draws a pipeline's nodes as Graphviz dot or Mermaid. [`Chart`](super::chart::Chart) draws them as SVG.

use super::Pipeline;
use petgraph::{
    dot::{Config, Dot},
    graph::DiGraph,
};
use std::fmt::Write as _;

/// How a pipeline is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Graphviz.
    Dot,
    /// Mermaid, as Markdown viewers show it.
    Mermaid,
}

/// The drawing, as text.
pub fn draw(pipeline: &Pipeline, format: Format) -> String {
    match format {
        Format::Dot => dot(pipeline),
        Format::Mermaid => mermaid(pipeline),
    }
}

/// Name, kind and, for a matrix, the number of cells.
fn label(pipeline: &Pipeline, node: usize) -> (String, String) {
    let node = &pipeline.nodes[node];
    let cells = node.cells.len();
    let kind = if cells > 1 { format!("{} x {cells}", node.spec.name) } else { node.spec.name.to_owned() };
    (node.name.clone(), kind)
}

fn dot(pipeline: &Pipeline) -> String {
    let mut graph = DiGraph::<String, &str>::new();
    let at: Vec<_> = (0..pipeline.nodes.len())
        .map(|node| {
            let (name, kind) = label(pipeline, node);
            graph.add_node(format!("{name}\n{kind}"))
        })
        .collect();
    for (node, to) in at.iter().enumerate() {
        for from in pipeline.reads(node) {
            graph.add_edge(at[from], *to, "");
        }
    }
    format!(
        "{}",
        Dot::with_attr_getters(&graph, &[Config::EdgeNoLabel], &|_, _| String::new(), &|_, _| "shape=box".into())
    )
}

fn mermaid(pipeline: &Pipeline) -> String {
    let mut out = String::from("flowchart LR\n");
    for node in 0..pipeline.nodes.len() {
        let (name, kind) = label(pipeline, node);
        let _ = writeln!(out, "  n{node}[\"{name}<br/><small>{kind}</small>\"]");
    }
    for node in 0..pipeline.nodes.len() {
        for from in pipeline.reads(node) {
            let _ = writeln!(out, "  n{from} --> n{node}");
        }
    }
    out
}
