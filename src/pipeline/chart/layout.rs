//! Places of boxes and lines: layers by the longest path, long edges led through all layers between, orders by
//! barycentres, and heights by least squares. The source is in the module above.

use std::collections::{BTreeMap, BTreeSet};

/// Width of a box, and of the gap between layers.
pub const BOX: f64 = 190.0;
pub const GAP: f64 = 70.0;
/// Height of a box's head, of its note and of a row of ports.
pub const HEAD: f64 = 40.0;
pub const NOTE: f64 = 16.0;
pub const PORT: f64 = 15.0;
/// Free height between boxes, and of a line that passes a layer.
const SPACE: f64 = 16.0;
pub const LINE: f64 = 4.0;
pub const MARGIN: f64 = 16.0;
/// Sweeps over the layers.
const SWEEPS: usize = 16;
/// A node with the ports that are connected.
#[derive(Clone, Debug)]
pub struct Node {
    pub name: String,
    pub kind: String,
    /// The ports that are connected.
    pub inputs: Vec<&'static str>,
    pub outputs: Vec<&'static str>,
}

/// From a node's output to another's input, by the places in `outputs` and `inputs`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Edge {
    pub from: usize,
    pub output: usize,
    pub to: usize,
    pub input: usize,
}

/// Where everything stands.
#[derive(Clone, Debug, Default)]
pub struct Layout {
    /// Places of the boxes' upper left corners.
    pub boxes: Vec<(f64, f64)>,
    /// By source, output and layer: the height at which the lines of an output pass a layer.
    pub passes: BTreeMap<(usize, usize, usize), f64>,
    pub layers: Vec<usize>,
    pub size: (f64, f64),
}

/// A member of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Member {
    Box(usize),
    /// Lines of this node's output pass by.
    Pass(usize, usize),
}

impl Node {
    pub fn height(&self) -> f64 {
        HEAD + NOTE + PORT * self.inputs.len().max(self.outputs.len()) as f64 + 6.0
    }

    /// The height of a port below the upper side of the box.
    pub fn port(row: usize) -> f64 {
        HEAD + NOTE + PORT * (row as f64 + 0.5)
    }
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

/// Places the boxes of the nodes, and the lines of the edges.
pub fn lay_out(nodes: &[Node], edges: &[Edge]) -> Layout {
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
}
