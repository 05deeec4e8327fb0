//! A pipeline's graph as a picture that can be read: layers from left to right, ports named, each with what is known of
//! its node.
//!
//! The layout has the steps of K. Sugiyama, S. Tagawa and M. Toda, "Methods for Visual Understanding of Hierarchical
//! System Structures" (1981): layers by the longest path, long edges led through all layers between, orders by
//! barycentres, and heights by least squares. Knows no run.

mod layout;

use super::Pipeline;
use crate::ids::Id;
use layout::{BOX, Edge, GAP, Layout, MARGIN, Node, lay_out};
use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
};

/// Characters of a text of a box, and of a port.
const MOST_TEXT: usize = 26;
const MOST_PORT: usize = 14;

/// The state of a node, as a line of text and a look.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Note {
    /// A line of text, or nothing.
    pub text: String,
    /// The look of the box.
    pub look: Look,
}

/// The look of a box.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Look {
    /// Nothing is known.
    #[default]
    Plain,
    /// Nothing was done yet.
    Waiting,
    /// It is at work.
    Running,
    /// All is done.
    Done,
    /// Something failed.
    Failed,
}

/// A graph to be drawn. See the module.
#[derive(Clone, Debug)]
pub struct Chart {
    nodes: Vec<Node>,
    /// From a node's output to another's input, by the places in `outputs` and `inputs`.
    edges: Vec<Edge>,
    layout: Layout,
}

impl Chart {
    /// The graph of a pipeline.
    pub fn new(pipeline: &Pipeline) -> Self {
        let mut links = BTreeSet::new();
        for cell in &pipeline.cells {
            for (input, feeds) in cell.inputs.iter().enumerate() {
                for feed in feeds {
                    links.insert((pipeline.cells[feed.cell].node, feed.port.place(), cell.node, input));
                }
            }
        }
        let nodes: Vec<Node> = pipeline
            .nodes
            .iter()
            .enumerate()
            .map(|(number, node)| {
                let inputs = node.spec.inputs.iter().enumerate();
                let inputs = inputs.filter(|(input, _)| links.iter().any(|l| (l.2, l.3) == (number, *input)));
                let outputs = node.spec.outputs.iter().enumerate();
                let outputs = outputs.filter(|(output, _)| links.iter().any(|l| (l.0, l.1) == (number, *output)));
                let cells = node.cells.len();
                let kind = node.spec.name;
                Node {
                    name: node.name.clone(),
                    kind: if cells > 1 { format!("{kind} x {cells}") } else { kind.to_owned() },
                    inputs: inputs.map(|(_, port)| port.name).collect(),
                    outputs: outputs.map(|(_, port)| port.name).collect(),
                }
            })
            .collect();
        let edges: Vec<Edge> = links
            .iter()
            .filter_map(|(from, output, to, input)| {
                let output = pipeline.nodes[*from].spec.outputs[*output].name;
                let input = pipeline.nodes[*to].spec.inputs[*input].name;
                Some(Edge {
                    from: *from,
                    output: nodes[*from].outputs.iter().position(|name| *name == output)?,
                    to: *to,
                    input: nodes[*to].inputs.iter().position(|name| *name == input)?,
                })
            })
            .collect();
        let layout = lay_out(&nodes, &edges);
        Self { nodes, edges, layout }
    }

    /// The picture as SVG, with a note for each node of that name.
    pub fn svg(&self, notes: &BTreeMap<String, Note>) -> String {
        let Layout { boxes, passes, layers, size: (width, height) } = &self.layout;
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"system-ui, sans-serif\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n"
        );
        for edge in &self.edges {
            let ((x, y), (to_x, to_y)) = (boxes[edge.from], boxes[edge.to]);
            let mut at = (x + BOX, y + Node::port(edge.output));
            let mut path = format!("M{} {}", at.0, at.1);
            let curve = |from: (f64, f64), to: (f64, f64)| {
                let middle = f64::midpoint(from.0, to.0);
                format!(" C{middle} {} {middle} {} {} {}", from.1, to.1, to.0, to.1)
            };
            for layer in layers[edge.from] + 1..layers[edge.to] {
                let Some(pass) = passes.get(&(edge.from, edge.output, layer)) else { continue };
                let left = MARGIN + layer as f64 * (BOX + GAP);
                path += &curve(at, (left, *pass));
                at = (left + BOX, *pass);
                let _ = write!(path, " H{}", at.0);
            }
            path += &curve(at, (to_x, to_y + Node::port(edge.input)));
            let (from, to) = (&self.nodes[edge.from], &self.nodes[edge.to]);
            let _ = writeln!(
                out,
                "<path d=\"{path}\" fill=\"none\" stroke=\"#9aa5b1\" stroke-width=\"1.4\"><title>{}.{} to {}.{}</title>\
                 </path>",
                escaped(&from.name),
                from.outputs[edge.output],
                escaped(&to.name),
                to.inputs[edge.input]
            );
        }
        let nothing = Note::default();
        for (node, (x, y)) in self.nodes.iter().zip(boxes) {
            self::node(&mut out, node, (*x, *y), notes.get(&node.name).unwrap_or(&nothing));
        }
        out.push_str("</svg>\n");
        out
    }
}

/// A box with its texts.
fn node(out: &mut String, node: &Node, (x, y): (f64, f64), note: &Note) {
    let (fill, stroke) = match note.look {
        Look::Plain => ("#f2f6fb", "#3d6ea5"),
        Look::Waiting => ("#f6f6f6", "#9a9a9a"),
        Look::Running => ("#fff4d6", "#b7791f"),
        Look::Done => ("#e9f6ec", "#2f855a"),
        Look::Failed => ("#fdeaea", "#c53030"),
    };
    let Node { name, kind, inputs, outputs } = node;
    let full = escaped(&format!("{name}: {kind}{}{}", if note.text.is_empty() { "" } else { "\n" }, note.text));
    let _ = write!(
        out,
        "<g><title>{full}</title><rect x=\"{x}\" y=\"{y}\" width=\"{BOX}\" height=\"{}\" rx=\"8\" fill=\"{fill}\" \
         stroke=\"{stroke}\" stroke-width=\"1.4\"/>",
        node.height()
    );
    let mut text = |x: f64, y: f64, style: &str, text: &str| {
        let _ = write!(out, "<text x=\"{x}\" y=\"{y}\" {style}>{}</text>", escaped(text));
    };
    let left = x + 10.0;
    text(left, y + 18.0, "font-size=\"14\" font-weight=\"600\" fill=\"#14263b\"", &short(name, MOST_TEXT - 5));
    text(left, y + 33.0, "font-size=\"11\" fill=\"#51647a\"", &short(kind, MOST_TEXT + 4));
    text(left, y + 48.0, "font-size=\"11\" fill=\"#14263b\"", &short(&note.text, MOST_TEXT + 4));
    for (row, port) in inputs.iter().enumerate() {
        text(x + 7.0, y + Node::port(row) + 3.5, "font-size=\"10\" fill=\"#51647a\"", &short(port, MOST_PORT));
    }
    for (row, port) in outputs.iter().enumerate() {
        let style = "font-size=\"10\" fill=\"#51647a\" text-anchor=\"end\"";
        text(x + BOX - 7.0, y + Node::port(row) + 3.5, style, &short(port, MOST_PORT));
    }
    for (row, side) in (0..inputs.len()).map(|row| (row, x)).chain((0..outputs.len()).map(|row| (row, x + BOX))) {
        let _ = write!(out, "<circle cx=\"{side}\" cy=\"{}\" r=\"2.5\" fill=\"{stroke}\"/>", y + Node::port(row));
    }
    out.push_str("</g>\n");
}

/// A text of so many characters at most.
fn short(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    text.chars().take(most.saturating_sub(1)).chain(['…']).collect()
}

/// A text in XML.
pub fn escaped(text: &str) -> String {
    let legal = |c: &char| !c.is_control() || matches!(c, '\n' | '\t');
    text.chars().filter(legal).fold(String::with_capacity(text.len()), |mut out, c| {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c => out.push(c),
        }
        out
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_shortened_and_escaped() {
        assert_eq!(short("abcdef", 4), "abc…");
        assert_eq!(escaped("<a & 'b'>\u{1b}"), "&lt;a &amp; &#39;b&#39;&gt;");
    }
}
