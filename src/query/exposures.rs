//! The exposures that an output was made with.

use super::Selection;
use crate::ids::Id;
use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{Collection, Context, ItemKey, Media as _};
use tauflow_data::records::Exposure;

/// Exposures by scene; none for a scene that has several.
pub struct Exposures(BTreeMap<String, Option<f64>>);

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
            for from in pipeline.cells[cell].inputs.iter().flatten() {
                let node = pipeline.cells[from.cell].node;
                if pipeline.nodes[node].spec.outputs[from.port.place()].media == Exposure::NAME {
                    sources.insert((node, from.port.place()));
                }
                if seen.insert(from.cell) {
                    open.push(from.cell);
                }
            }
        }
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
        Self(found)
    }

    /// The exposure of an item, whose key is that of its scene, or ends with it after the texts of cells.
    pub fn of_item(&self, key: &ItemKey) -> Option<f64> {
        let mut rest = key.as_str();
        loop {
            if let Some(factor) = self.0.get(rest) {
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
        let exposures = Exposures(BTreeMap::from([("scene/1".to_owned(), Some(0.5)), ("other".to_owned(), None)]));
        let of = |key: &str| exposures.of_item(&ItemKey::new(key).expect("a key"));
        assert_eq!(
            (of("scene/1"), of("rgb/scene/1"), of("scene"), of("rgb/other")),
            (Some(0.5), Some(0.5), None, None)
        );
    }
}
