//! Draws a pipeline's nodes as Graphviz dot, Mermaid or SVG.

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
    /// A picture.
    Svg,
}

/// The drawing, as text.
pub fn draw(pipeline: &Pipeline, format: Format) -> String {
    match format {
        Format::Dot => dot(pipeline),
        Format::Mermaid => mermaid(pipeline),
        Format::Svg => svg(pipeline),
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

const BOX: (f64, f64) = (170.0, 44.0);
const GAP: (f64, f64) = (60.0, 18.0);

/// Columns by the longest path from a source; within a column, by the mean height of what is read.
fn svg(pipeline: &Pipeline) -> String {
    let count = pipeline.nodes.len();
    let mut column = vec![0usize; count];
    for node in 0..count {
        column[node] = pipeline.reads(node).iter().map(|r| column[*r] + 1).max().unwrap_or(0);
    }
    let columns = column.iter().max().map_or(0, |c| c + 1);
    let mut row = vec![0.0f64; count];
    let mut tallest = 0;
    for c in 0..columns {
        let mut members: Vec<usize> = (0..count).filter(|n| column[*n] == c).collect();
        let height = |n: &usize| {
            let reads = pipeline.reads(*n);
            reads.iter().map(|r| row[*r]).sum::<f64>() / reads.len().max(1) as f64
        };
        let heights: Vec<f64> = members.iter().map(height).collect();
        let rank = |n: &usize| members.iter().position(|m| m == n).map_or(0.0, |i| heights[i]);
        let mut sorted = members.clone();
        sorted.sort_by(|a, b| rank(a).total_cmp(&rank(b)).then(a.cmp(b)));
        members = sorted;
        tallest = tallest.max(members.len());
        for (i, node) in members.iter().enumerate() {
            row[*node] = i as f64;
        }
    }
    let place = |n: usize| (20.0 + column[n] as f64 * (BOX.0 + GAP.0), 20.0 + row[n] * (BOX.1 + GAP.1));
    let width = 40.0 + columns as f64 * (BOX.0 + GAP.0) - GAP.0;
    let height = 40.0 + tallest as f64 * (BOX.1 + GAP.1) - GAP.1;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
         viewBox=\"0 0 {width} {height}\" font-family=\"system-ui, sans-serif\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n"
    );
    for node in 0..count {
        for from in pipeline.reads(node) {
            let ((x0, y0), (x1, y1)) = (place(from), place(node));
            let (x0, y0, y1) = (x0 + BOX.0, y0 + BOX.1 / 2.0, y1 + BOX.1 / 2.0);
            let bend = ((x1 - x0) / 2.0).max(30.0);
            let _ = writeln!(
                out,
                "<path d=\"M{x0} {y0} C{} {y0} {} {y1} {x1} {y1}\" fill=\"none\" stroke=\"#9aa5b1\" \
                 stroke-width=\"1.5\"/>",
                x0 + bend,
                x1 - bend
            );
        }
    }
    for node in 0..count {
        let ((x, y), (name, kind)) = (place(node), label(pipeline, node));
        let _ = writeln!(
            out,
            "<g><rect x=\"{x}\" y=\"{y}\" width=\"{}\" height=\"{}\" rx=\"8\" fill=\"#f2f6fb\" stroke=\"#3d6ea5\"/>\
             <text x=\"{}\" y=\"{}\" font-size=\"14\" font-weight=\"600\" fill=\"#14263b\">{name}</text>\
             <text x=\"{}\" y=\"{}\" font-size=\"11\" fill=\"#51647a\">{kind}</text></g>",
            BOX.0,
            BOX.1,
            x + 10.0,
            y + 19.0,
            x + 10.0,
            y + 35.0
        );
    }
    out.push_str("</svg>\n");
    out
}
