//! A pipeline's graph as a picture that can be read: layers from left to right, ports named, each with what is known of
//! its node.
//!
//! The layout has the steps of K. Sugiyama, S. Tagawa and M. Toda, "Methods for Visual Understanding of Hierarchical
//! System Structures" (1981): layers by the longest path, long edges led through all layers between, orders by
//! barycentres, and heights by least squares. Knows no run.

use super::Pipeline;
use crate::ids::Id;
use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
};

/// Width of a box, and of the gap between layers.
const BOX: f64 = 190.0;
const GAP: f64 = 70.0;
/// Height of a box's head, of its note and of a row of ports.
const HEAD: f64 = 40.0;
const NOTE: f64 = 16.0;
const PORT: f64 = 15.0;
/// Free height between boxes, and of a line that passes a layer.
const SPACE: f64 = 16.0;
const LINE: f64 = 4.0;
const MARGIN: f64 = 16.0;
/// Sweeps over the layers.
const SWEEPS: usize = 16;
/// Characters of a text of a box, and of a port.
const MOST_TEXT: usize = 26;
const MOST_PORT: usize = 14;

/// What is known of a node, as a line and a look.
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

#[derive(Clone, Debug)]
struct Node {
    name: String,
    kind: String,
    /// The ports that are connected.
    inputs: Vec<&'static str>,
    outputs: Vec<&'static str>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Edge {
    from: usize,
    output: usize,
    to: usize,
    input: usize,
}

/// Where everything stands.
#[derive(Clone, Debug, Default)]
struct Layout {
    /// Places of the boxes' upper left corners.
    boxes: Vec<(f64, f64)>,
    /// By source, output and layer: the height at which the lines of an output pass a layer.
    passes: BTreeMap<(usize, usize, usize), f64>,
    layers: Vec<usize>,
    size: (f64, f64),
}

/// What takes room in a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Member {
    Box(usize),
    /// Lines of this node's output pass by.
    Pass(usize, usize),
}

impl Node {
    fn height(&self) -> f64 {
        HEAD + NOTE + PORT * self.inputs.len().max(self.outputs.len()) as f64 + 6.0
    }

    /// The height of a port below the upper side of the box.
    fn port(row: usize) -> f64 {
        HEAD + NOTE + PORT * (row as f64 + 0.5)
    }
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

/// The layer of each node: the longest path from a source. Sources stand just before what reads them.
fn layers(nodes: &[Node], edges: &[Edge]) -> Vec<usize> {
    let mut layer = vec![0usize; nodes.len()];
    // Nodes stand after all that they read, and edges are sorted by where they come from.
    for node in 0..nodes.len() {
        let reads = edges.iter().filter(|edge| edge.to == node);
        layer[node] = reads.map(|edge| layer[edge.from] + 1).max().unwrap_or(0);
    }
    for (node, of) in nodes.iter().enumerate() {
        if of.inputs.is_empty()
            && let Some(first) = edges.iter().filter(|e| e.from == node).map(|e| layer[e.to]).min()
        {
            layer[node] = first.saturating_sub(1);
        }
    }
    layer
}

fn lay_out(nodes: &[Node], edges: &[Edge]) -> Layout {
    let layer = layers(nodes, edges);
    let count = layer.iter().max().map_or(0, |last| last + 1);
    let mut rows: Vec<Vec<Member>> = vec![Vec::new(); count];
    (0..nodes.len()).for_each(|node| rows[layer[node]].push(Member::Box(node)));
    let mut passing = BTreeSet::new();
    for edge in edges {
        for (between, row) in rows.iter_mut().enumerate().take(layer[edge.to]).skip(layer[edge.from] + 1) {
            if passing.insert((edge.from, edge.output, between)) {
                row.push(Member::Pass(edge.from, edge.output));
            }
        }
    }
    // Links between members of neighbouring layers, each with the heights of its ends below their upper sides.
    let mut links: Vec<Vec<Link>> = vec![Vec::new(); count.saturating_sub(1)];
    for edge in edges {
        let mut from = (Member::Box(edge.from), Node::port(edge.output));
        for (between, links) in links.iter_mut().enumerate().take(layer[edge.to]).skip(layer[edge.from]) {
            let last = between + 1 == layer[edge.to];
            let to = if last {
                (Member::Box(edge.to), Node::port(edge.input))
            } else {
                (Member::Pass(edge.from, edge.output), LINE / 2.0)
            };
            let link = Link { from, to };
            if !links.contains(&link) {
                links.push(link);
            }
            from = to;
        }
    }
    order(&mut rows, &links);
    let height = |member: &Member| match member {
        Member::Box(node) => nodes[*node].height(),
        Member::Pass(..) => LINE,
    };
    let tops = heights(&rows, &links, &height);
    let mut layout = Layout { boxes: vec![(0.0, 0.0); nodes.len()], layers: layer, ..Layout::default() };
    let mut bottom = 0.0f64;
    let first = tops.iter().flatten().copied().fold(f64::INFINITY, f64::min);
    for (number, (row, tops)) in rows.iter().zip(&tops).enumerate() {
        for (member, top) in row.iter().zip(tops) {
            let top = (top - first + MARGIN).round();
            bottom = bottom.max(top + height(member));
            match member {
                Member::Box(node) => layout.boxes[*node] = (MARGIN + number as f64 * (BOX + GAP), top),
                Member::Pass(from, output) => {
                    layout.passes.insert((*from, *output, number), top + LINE / 2.0);
                }
            }
        }
    }
    let width = (2.0 * MARGIN + count as f64 * (BOX + GAP) - GAP).max(2.0 * MARGIN);
    layout.size = (width, bottom + MARGIN);
    layout
}

/// A part of an edge between neighbouring layers.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Link {
    from: (Member, f64),
    to: (Member, f64),
}

fn place(row: &[Member], member: Member) -> usize {
    row.iter().position(|other| *other == member).unwrap_or(0)
}

fn crossings(rows: &[Vec<Member>], links: &[Vec<Link>]) -> usize {
    let between = |(number, links): (usize, &Vec<Link>)| {
        let end = |row: &[Member], (member, port): (Member, f64)| (place(row, member), port);
        let ends: Vec<_> =
            links.iter().map(|link| (end(&rows[number], link.from), end(&rows[number + 1], link.to))).collect();
        let crosses = |a: &((usize, f64), (usize, f64)), b: &((usize, f64), (usize, f64))| {
            (a.0 < b.0 && a.1 > b.1) || (a.0 > b.0 && a.1 < b.1)
        };
        (0..ends.len()).map(|i| ends[i + 1..].iter().filter(|other| crosses(&ends[i], other)).count()).sum::<usize>()
    };
    links.iter().enumerate().map(between).sum()
}

/// Orders each layer by the mean places of its neighbours, and keeps the order with the fewest crossings.
fn order(rows: &mut Vec<Vec<Member>>, links: &[Vec<Link>]) {
    let mut best = (crossings(rows, links), rows.clone());
    for sweep in 0..SWEEPS {
        let down = sweep % 2 == 0;
        for step in 1..rows.len() {
            let (number, neighbour) = if down { (step, step - 1) } else { (rows.len() - 1 - step, rows.len() - step) };
            let side = &links[number.min(neighbour)];
            let mean = |(at, member): (usize, &Member)| {
                let (mut sum, mut count) = (0.0, 0.0);
                for link in side {
                    let (own, other) = if down { (link.to, link.from) } else { (link.from, link.to) };
                    if own.0 == *member {
                        sum += place(&rows[neighbour], other.0) as f64 + other.1 / 1e4;
                        count += 1.0;
                    }
                }
                (if count > 0.0 { sum / count } else { at as f64 }, *member)
            };
            let mut means: Vec<(f64, Member)> = rows[number].iter().enumerate().map(mean).collect();
            means.sort_by(|a, b| a.0.total_cmp(&b.0));
            rows[number] = means.into_iter().map(|(_, member)| member).collect();
        }
        let found = crossings(rows, links);
        if found < best.0 {
            best = (found, rows.clone());
        }
    }
    *rows = best.1;
}

/// The upper sides of all members: as near to what they are linked with as their order and the space allow.
fn heights(rows: &[Vec<Member>], links: &[Vec<Link>], height: &dyn Fn(&Member) -> f64) -> Vec<Vec<f64>> {
    let mut tops: Vec<Vec<f64>> = rows
        .iter()
        .map(|row| {
            let total: f64 = row.iter().map(|member| height(member) + SPACE).sum();
            row.iter()
                .scan(-total / 2.0, |at, member| {
                    let top = *at;
                    *at += height(member) + SPACE;
                    Some(top)
                })
                .collect()
        })
        .collect();
    for sweep in 0..SWEEPS {
        for step in 0..rows.len() {
            let number = if sweep % 2 == 0 { step } else { rows.len() - 1 - step };
            let wanted: Vec<f64> = rows[number]
                .iter()
                .zip(&tops[number])
                .map(|(member, now)| {
                    let (mut sum, mut count) = (0.0, 0.0);
                    let mut near = |own: (Member, f64), other: (Member, f64), row: usize| {
                        if own.0 == *member {
                            sum += tops[row][place(&rows[row], other.0)] + other.1 - own.1;
                            count += 1.0;
                        }
                    };
                    if number > 0 {
                        links[number - 1].iter().for_each(|link| near(link.to, link.from, number - 1));
                    }
                    if number < links.len() {
                        links[number].iter().for_each(|link| near(link.from, link.to, number + 1));
                    }
                    if count > 0.0 { sum / count } else { *now }
                })
                .collect();
            let room: Vec<f64> = rows[number].iter().map(|member| height(member) + SPACE).collect();
            tops[number] = apart(&wanted, &room);
        }
    }
    tops
}

/// The places nearest to those that are wanted, by least squares, that keep their order and leave each its room: an
/// isotonic regression by pooling neighbours.
fn apart(wanted: &[f64], room: &[f64]) -> Vec<f64> {
    let mut before = 0.0;
    let mut offsets = Vec::with_capacity(wanted.len());
    // Sums and counts of pooled neighbours.
    let mut pools: Vec<(f64, usize)> = Vec::new();
    for (want, room) in wanted.iter().zip(room) {
        offsets.push(before);
        pools.push((want - before, 1));
        before += room;
        while let [.., (a, n), (b, m)] = pools[..]
            && a / n as f64 > b / m as f64
        {
            pools.truncate(pools.len() - 2);
            pools.push((a + b, n + m));
        }
    }
    let means = pools.iter().flat_map(|(sum, count)| std::iter::repeat_n(sum / *count as f64, *count));
    means.zip(offsets).map(|(mean, offset)| mean + offset).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_keep_their_order_and_their_room() {
        assert_eq!(apart(&[0.0, 100.0], &[10.0, 10.0]), [0.0, 100.0]);
        assert_eq!(apart(&[50.0, 50.0, 0.0], &[10.0, 20.0, 10.0]), [20.0, 30.0, 50.0]);
        assert_eq!(apart(&[], &[]), [0.0; 0]);
    }

    #[test]
    fn boxes_share_no_room_and_long_edges_pass_between_them() {
        let node = |inputs: &[&'static str], outputs: &[&'static str]| Node {
            name: "n".into(),
            kind: "k".into(),
            inputs: inputs.to_vec(),
            outputs: outputs.to_vec(),
        };
        // A chain, beside which an edge goes from the first to the last.
        let nodes = [
            node(&[], &["a", "b"]),
            node(&["a"], &["a"]),
            node(&["a"], &["a"]),
            node(&["a", "b"], &[]),
            node(&["a"], &[]),
        ];
        let edge = |from, output, to, input| Edge { from, output, to, input };
        let edges = [edge(0, 0, 1, 0), edge(0, 1, 3, 1), edge(0, 0, 4, 0), edge(1, 0, 2, 0), edge(2, 0, 3, 0)];
        let layout = lay_out(&nodes, &edges);
        assert_eq!(layout.layers, [0, 1, 2, 3, 1]);
        for (a, (x, top)) in layout.boxes.iter().enumerate() {
            let bottom = top + nodes[a].height();
            let other = |b: usize| layout.boxes[b].0 == *x && layout.boxes[b].1 < bottom && layout.boxes[b].1 > *top;
            assert!(!(0..nodes.len()).any(|b| b != a && other(b)), "{:?}", layout.boxes);
            let passes = layout.passes.iter().filter(|((.., layer), _)| *layer == layout.layers[a]);
            assert!(passes.clone().all(|(_, y)| y < top || *y > bottom), "{layout:?}");
        }
        assert_eq!(layout.passes.len(), 2);
    }

    #[test]
    fn texts_are_shortened_and_escaped() {
        assert_eq!(short("abcdef", 4), "abc…");
        assert_eq!(escaped("<a & 'b'>\u{1b}"), "&lt;a &amp; &#39;b&#39;&gt;");
    }
}
