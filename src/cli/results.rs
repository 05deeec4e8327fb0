//! Results of earlier runs, read for a command; what was lost is made again.

use super::{CliError, progress::Display};
use crate::{
    engine::{self, EngineError, event::Event},
    query::{Selection, SelectionError},
};
use std::sync::atomic::AtomicBool;
use tauflow_cache::Store;
use tauflow_contract::{Collection, KindError};

/// The items of a selection, if its node is up to date. What was there and is lost is made again.
pub(crate) fn collection(of: &Selection<'_>, store: &Store) -> Result<Collection, CliError> {
    match of.collection(store) {
        Err(EngineError::Lost(_)) => {
            restore(of, store)?;
            Ok(of.collection(store)?)
        }
        found => Ok(found?),
    }
}

/// Makes what is lost or damaged again, and says so.
pub(crate) fn restore(of: &Selection<'_>, store: &Store) -> Result<(), CliError> {
    let pipeline = of.pipeline();
    let node = &pipeline.nodes[of.node].name;
    errln!("results of `{node}` are missing from the cache; rebuilding them");
    let display = Display::new(pipeline, false);
    // Stopped by Ctrl-C as every program is: what is done is kept.
    let stop = AtomicBool::new(false);
    let sink = |event: &Event| display.show(event);
    let summary = engine::restore(pipeline, store, (of.node, of.port), &stop, &sink);
    display.end();
    match summary?.failures.first() {
        None => Ok(()),
        Some(first) => {
            let message = format!("`{node}` cannot be made again: {} {}", first.only(), first.message);
            Err(CliError::Bad(message))
        }
    }
}

impl From<SelectionError> for CliError {
    fn from(error: SelectionError) -> Self {
        Self::Bad(error.to_string())
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
