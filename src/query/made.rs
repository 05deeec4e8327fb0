//! What a node made, by what people call it: `node`, `node.port`, `node[axis=value].port`.

use crate::{
    diagnostics::did_you_mean,
    engine::{self, EngineError},
    ids::PortId,
    pipeline::{Cell, Pipeline, reference::Reference},
};
use tauflow_cache::Store;
use tauflow_contract::Collection;

/// An output port of some or all cells of a node.
pub struct Selection<'a> {
    pipeline: &'a Pipeline,
    /// The node.
    pub node: usize,
    /// Its port.
    pub port: PortId,
    /// Texts of the cells that are picked; none for all.
    cells: Option<Vec<&'a str>>,
}

/// A text that names no output: what is wrong, and what to write.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct SelectionError(String);

impl<'a> Selection<'a> {
    /// Finds what a text names.
    ///
    /// # Errors
    /// If it names no node, port or cell.
    pub fn parse(text: &str, pipeline: &'a Pipeline) -> Result<Self, SelectionError> {
        let reference = Reference::parse(text).map_err(SelectionError)?;
        let name = reference.node;
        let node = pipeline.node(name).ok_or_else(|| {
            let names = pipeline.nodes.iter().map(|n| n.name.as_str());
            SelectionError(format!("there is no node `{name}`; {}", did_you_mean(name, "nodes", names)))
        })?;
        let of = &pipeline.nodes[node];
        let port = match reference.port {
            None => PortId::DEFAULT,
            Some(port) => of.output(port).ok_or_else(|| {
                let names = of.spec.outputs.iter().map(|p| p.name);
                SelectionError(format!("`{name}` has no output `{port}`; {}", did_you_mean(port, "outputs", names)))
            })?,
        };
        let picked = |cell: &&Cell| {
            let has = |(axis, value): &(&str, &str)| cell.coords.iter().any(|(a, v)| a == axis && v == value);
            reference.select.iter().all(has)
        };
        let cells = pipeline.cells[of.cells.clone()].iter().filter(picked).map(|c| c.text.as_str()).collect::<Vec<_>>();
        if cells.is_empty() {
            let axes: Vec<String> = of.axes.iter().map(|(a, values)| format!("{a}: {}", values.join(", "))).collect();
            let axes =
                if axes.is_empty() { "it has no axes".to_owned() } else { format!("its axes are {}", axes.join("; ")) };
            return Err(SelectionError(format!("`{text}` picks no cell of `{name}`; {axes}")));
        }
        let cells = (!reference.select.is_empty()).then_some(cells);
        Ok(Self { pipeline, node, port, cells })
    }

    /// The pipeline.
    pub fn pipeline(&self) -> &'a Pipeline {
        self.pipeline
    }

    /// The items, if the node is up to date.
    ///
    /// # Errors
    /// As [`engine::outputs`]: [`EngineError::Lost`] if [`engine::restore`] can make them again.
    pub fn collection(&self, store: &Store) -> Result<Collection, EngineError> {
        let mut all = engine::outputs(self.pipeline, store, self.node, self.port)?;
        if let Some(cells) = &self.cells {
            let of_cell =
                |key: &str| cells.iter().any(|c| key.strip_prefix(c).is_some_and(|rest| rest.starts_with('/')));
            all.items.retain(|key, _| of_cell(key.as_str()));
        }
        Ok(all)
    }
}
