//! Results of earlier runs, by name: `node`, `node.port`, `node[axis=value].port`.

use super::{CliError, progress::Display};
use crate::{
    diagnostics::did_you_mean,
    engine::{self, EngineError, event::Event},
    ids::PortId,
    pipeline::{Pipeline, reference::Reference},
};
use std::sync::atomic::AtomicBool;
use tauflow_cache::{Digest, Store};
use tauflow_contract::{Artifact, Blobs, Collection, KindError, MemoKey};

/// The store, for reading only.
pub(crate) struct Reading<'a>(pub(crate) &'a Store);

impl Blobs for Reading<'_> {
    fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, KindError> {
        self.0.get(digest).map_err(|e| KindError::Environment(e.to_string()))
    }

    fn put(&self, _: &[u8]) -> Result<Digest, KindError> {
        Err(KindError::Internal("results are read only, but a blob was to be stored".into()))
    }

    fn memo_get(&self, _: &MemoKey) -> Option<Artifact> {
        None
    }

    fn memo_put(&self, _: &MemoKey, _: &Artifact) -> Result<(), KindError> {
        Err(KindError::Internal("results are read only, but a sub-action was to be kept".into()))
    }
}

/// An output port of some or all cells of a node.
pub(crate) struct Asked<'a> {
    pipeline: &'a Pipeline,
    pub(crate) node: usize,
    pub(crate) port: PortId,
    /// Texts of the cells that are picked; none for all.
    cells: Option<Vec<&'a str>>,
}

impl<'a> Asked<'a> {
    /// Finds what a text names.
    pub(crate) fn parse(text: &str, pipeline: &'a Pipeline) -> Result<Self, CliError> {
        let reference = Reference::parse(text).map_err(CliError::Bad)?;
        let name = reference.node;
        let node = pipeline.node(name).ok_or_else(|| {
            let names = pipeline.nodes.iter().map(|n| n.name.as_str());
            CliError::Bad(format!("unknown node `{name}`; {}", did_you_mean(name, "nodes", names)))
        })?;
        let of = &pipeline.nodes[node];
        let port = match reference.port {
            None => PortId::DEFAULT,
            Some(port) => of.output(port).ok_or_else(|| {
                let names = of.spec.outputs.iter().map(|p| p.name);
                CliError::Bad(format!("`{name}` has no output `{port}`; {}", did_you_mean(port, "outputs", names)))
            })?,
        };
        let picked = |cell: &&crate::pipeline::Cell| {
            let has = |(axis, value): &(&str, &str)| cell.coords.iter().any(|(a, v)| a == axis && v == value);
            reference.select.iter().all(has)
        };
        let cells = pipeline.cells[of.cells.clone()].iter().filter(picked).map(|c| c.text.as_str()).collect::<Vec<_>>();
        if cells.is_empty() {
            let axes: Vec<String> = of.axes.iter().map(|(a, values)| format!("{a}: {}", values.join(", "))).collect();
            let axes =
                if axes.is_empty() { "it has no axes".to_owned() } else { format!("its axes are {}", axes.join("; ")) };
            return Err(CliError::Bad(format!("`{text}` matches no cell of `{name}`; {axes}")));
        }
        let cells = (!reference.select.is_empty()).then_some(cells);
        Ok(Self { pipeline, node, port, cells })
    }

    /// The items, if the node is up to date. Lost results are rebuilt.
    pub(crate) fn collection(&self, store: &Store) -> Result<Collection, CliError> {
        let mut all = match engine::outputs(self.pipeline, store, self.node, self.port) {
            Err(EngineError::Lost(_)) => {
                self.restore(store)?;
                engine::outputs(self.pipeline, store, self.node, self.port)?
            }
            found => found?,
        };
        if let Some(cells) = &self.cells {
            let of_cell =
                |key: &str| cells.iter().any(|c| key.strip_prefix(c).is_some_and(|rest| rest.starts_with('/')));
            all.items.retain(|key, _| of_cell(key.as_str()));
        }
        Ok(all)
    }

    /// Makes what is lost or damaged again, and says so.
    pub(crate) fn restore(&self, store: &Store) -> Result<(), CliError> {
        let node = &self.pipeline.nodes[self.node].name;
        eprintln!("results of `{node}` are missing from the cache; rebuilding them");
        let display = Display::new(self.pipeline, false);
        // Stopped by Ctrl-C as every program is: what is done is kept.
        let stop = AtomicBool::new(false);
        let sink = |event: &Event| display.show(event);
        let summary = engine::restore(self.pipeline, store, (self.node, self.port), &stop, &sink);
        display.end();
        match summary?.failures.first() {
            None => Ok(()),
            Some(first) => {
                let message = format!("`{node}` cannot be rebuilt: {} {}", first.only(), first.message);
                Err(CliError::Bad(message))
            }
        }
    }
}

/// A failure in reading a result.
pub(crate) fn unread(item: &str, error: KindError) -> CliError {
    match error {
        KindError::MissingBlob(_) => {
            CliError::Bad(format!("`{item}` is missing from the cache; run `tauflow cache verify`, then the pipeline"))
        }
        KindError::Environment(message) => CliError::Environment(format!("{item}: {message}")),
        other => CliError::Bad(format!("{item}: {other}")),
    }
}
