//! The exposures that an output was made with.

use super::Selection;
use crate::ids::Id;
use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{Collection, Context, ItemKey, Media as _};
use tauflow_data::records::Exposure;

/// Exposures by scene; none for a scene that has several.
pub struct Exposures {
    by_scene: BTreeMap<String, Option<f64>>,
    unexposed: bool,
}

/// The input whose content a kind does not read: it waits for it.
const AFTER: &str = "after";

impl Exposures {
    /// The exposures that the node of a selection reads, directly or through other nodes. `read` gives the items of
    /// another selection, if they are there.
    pub fn of(
        selection: &Selection<'_>,
        ctx: &Context<'_>,
        read: &dyn Fn(&Selection<'_>) -> Option<Collection>,
    ) -> Self {
        let pipeline = selection.pipeline();
        let (mut found, mut seen) = (BTreeMap::new(), BTreeSet::new());
        let mut open: Vec<usize> = pipeline.nodes[selection.node].cells.clone().collect();
        let mut sources = BTreeSet::new();
        while let Some(cell) = open.pop() {
            let of = &pipeline.nodes[pipeline.cells[cell].node];
            let read = pipeline.cells[cell].inputs.iter().zip(&of.spec.inputs);
            for from in read.filter(|(_, port)| port.name != AFTER).flat_map(|(from, _)| from) {
                let node = pipeline.cells[from.cell].node;
                if pipeline.nodes[node].spec.outputs[from.port.place()].media == Exposure::NAME {
                    sources.insert((node, from.port.place()));
                }
                if seen.insert(from.cell) {
                    open.push(from.cell);
                }
            }
        }
        let unexposed = sources.is_empty();
        for (node, port) in sources {
            let of = &pipeline.nodes[node];
            let name = format!("{}.{}", of.name, of.spec.outputs[port].name);
            let Ok(selection) = Selection::parse(&name, pipeline) else { continue };
            let Some(items) = read(&selection) else { continue };
            for (key, artifact) in items.iter() {
                let factor = Exposure::load(ctx, artifact).ok().map(|exposure| exposure.factor);
                let known = found.entry(key.as_str().to_owned()).or_insert(factor);
                if *known != factor {
                    *known = None;
                }
            }
        }
        Self { by_scene: found, unexposed }
    }

    /// True if the node reads no exposure, directly or through other nodes: all its images are raw radiance, such as
    /// those of an external renderer.
    pub fn is_unexposed(&self) -> bool {
        self.unexposed
    }

    /// The exposure of an item, whose key is that of its scene, or ends with it after the texts of cells.
    pub fn of_item(&self, key: &ItemKey) -> Option<f64> {
        let mut rest = key.as_str();
        loop {
            if let Some(factor) = self.by_scene.get(rest) {
                return *factor;
            }
            rest = rest.split_once('/')?.1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_of_cells_have_the_exposure_of_their_scene() {
        let by_scene = BTreeMap::from([("scene/1".to_owned(), Some(0.5)), ("other".to_owned(), None)]);
        let exposures = Exposures { by_scene, unexposed: false };
        let of = |key: &str| exposures.of_item(&ItemKey::new(key).expect("a key"));
        assert_eq!(
            (of("scene/1"), of("rgb/scene/1"), of("scene"), of("rgb/other")),
            (Some(0.5), Some(0.5), None, None)
        );
    }
}
