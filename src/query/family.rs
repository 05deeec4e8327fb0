//! The outputs that belong together for a viewer: images of the same scenes, and what is said of them.

use super::Selection;
use crate::ids::{Id, PortId};
use std::collections::BTreeSet;
use tauflow_contract::Media as _;
use tauflow_data::records::{BridgeSteps, GBuffer, Generated, Ladder, PackedScene, Refined, Rollout, Verdict};

/// An output: a node and its port.
type Output = (usize, PortId);

/// Outputs with images of the scenes of one output, by the part that they have in a viewer.
///
/// - Packed scenes: the output itself, the packed scenes that it is made of, or those that are made of it.
/// - Ladders: those that these are packed from, or that the output itself or its node reads.
/// - G-buffers: those that are packed with the scenes, or that the nodes of the ladders make, too.
/// - Refined: images that are made of the packed scenes by any node, such as solvers and baselines.
/// - Generated: the samples that the node itself makes.
/// - Verdicts: those of gates that judge the ladders, or that give the exposures of the packed scenes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Family {
    /// Packed scenes.
    pub packed: BTreeSet<Output>,
    /// Ladders.
    pub ladders: BTreeSet<Output>,
    /// G-buffers.
    pub gbuffers: BTreeSet<Output>,
    /// Refined images, the states of solvers, and the stops of bridges.
    pub refined: BTreeSet<Output>,
    /// Verdicts of gates.
    pub verdicts: BTreeSet<Output>,
    /// Samples of generative backbones.
    pub generated: BTreeSet<Output>,
}

/// The graph of a pipeline by outputs.
struct Graph<'a>(&'a Selection<'a>);

impl Graph<'_> {
    fn media(&self, (node, port): Output) -> &'static str {
        self.0.pipeline().nodes[node].spec.outputs[port.place()].media
    }

    /// The outputs that a node reads.
    fn reads(&self, node: usize) -> BTreeSet<Output> {
        let pipeline = self.0.pipeline();
        let cells = &pipeline.cells[pipeline.nodes[node].cells.clone()];
        let inputs = cells.iter().flat_map(|cell| cell.inputs.iter().flatten());
        inputs.map(|from| (pipeline.cells[from.cell].node, from.port)).collect()
    }

    /// The outputs of a node of some media types.
    fn makes<'b>(&'b self, node: usize, media: &'b [&str]) -> impl Iterator<Item = Output> + 'b {
        let ports = 0..self.0.pipeline().nodes[node].spec.outputs.len();
        ports.map(move |port| (node, PortId::at(port))).filter(|output| media.contains(&self.media(*output)))
    }

    /// The outputs of some media types of all nodes that read one of `outputs`.
    fn made_of(&self, outputs: &BTreeSet<Output>, media: &[&str]) -> BTreeSet<Output> {
        let readers = (0..self.0.pipeline().nodes.len()).filter(|node| !self.reads(*node).is_disjoint(outputs));
        readers.flat_map(|node| self.makes(node, media).collect::<Vec<_>>()).collect()
    }

    /// The nearest packed scenes that a node is made of.
    fn packed_above(&self, node: usize) -> BTreeSet<Output> {
        let (mut found, mut seen, mut open) = (BTreeSet::new(), BTreeSet::from([node]), vec![node]);
        while let Some(node) = open.pop() {
            for output in self.reads(node) {
                if self.media(output) == PackedScene::NAME {
                    found.insert(output);
                } else if seen.insert(output.0) {
                    open.push(output.0);
                }
            }
        }
        found
    }
}

impl Family {
    /// The family of an output.
    pub fn of(selection: &Selection<'_>) -> Self {
        let (graph, own) = (Graph(selection), (selection.node, selection.port));
        let of_media = |outputs: BTreeSet<Output>, media: &str| -> BTreeSet<Output> {
            outputs.into_iter().filter(|output| graph.media(*output) == media).collect()
        };
        let mut family = Self::default();
        let media = graph.media(own);
        family.packed = match media {
            PackedScene::NAME => BTreeSet::from([own]),
            Ladder::NAME | GBuffer::NAME => graph.made_of(&BTreeSet::from([own]), &[PackedScene::NAME]),
            _ => graph.packed_above(own.0),
        };
        let read_by_packed: BTreeSet<Output> = family.packed.iter().flat_map(|(node, _)| graph.reads(*node)).collect();
        family.ladders = of_media(read_by_packed.clone(), Ladder::NAME);
        family.ladders.extend(of_media(graph.reads(own.0), Ladder::NAME));
        family.ladders.extend(graph.makes(own.0, &[Ladder::NAME]));
        family.gbuffers = of_media(read_by_packed.clone(), GBuffer::NAME);
        let of_ladders = family.ladders.iter().flat_map(|(node, _)| graph.makes(*node, &[GBuffer::NAME]));
        family.gbuffers.extend(of_ladders.collect::<Vec<_>>());
        let images = [Refined::NAME, Rollout::NAME, BridgeSteps::NAME];
        family.refined = graph.made_of(&family.packed, &images);
        family.refined.extend(graph.makes(own.0, &images));
        family.verdicts = graph.made_of(&family.ladders, &[Verdict::NAME]);
        family.verdicts.extend(graph.makes(own.0, &[Verdict::NAME]));
        let gates = read_by_packed.iter().flat_map(|(node, _)| graph.makes(*node, &[Verdict::NAME]));
        family.verdicts.extend(gates.collect::<Vec<_>>());
        family.generated = graph.makes(own.0, &[Generated::NAME]).collect();
        family
    }

    /// All outputs.
    pub fn outputs(&self) -> impl Iterator<Item = Output> + '_ {
        let all = [&self.packed, &self.ladders, &self.gbuffers, &self.refined, &self.verdicts, &self.generated];
        all.into_iter().flatten().copied()
    }
}
