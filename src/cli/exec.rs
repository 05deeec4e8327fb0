//! `tauflow exec`.

use super::{CacheAt, CliError, Exit, alone, exec_args::ExecArgs, upstream};
use crate::{
    engine::{
        batch::{self, BatchFile, Telling},
        exec::{self, ActionFile, ExecError},
    },
    kinds::Registry,
};
use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
};
use tauflow_contract::{Silent, read_regular};

/// Most bytes of an action's file: far more than any has.
const MOST_BYTES: u64 = 1 << 28;

impl From<ExecError> for CliError {
    fn from(error: ExecError) -> Self {
        match error {
            ExecError::Cache(error) => error.into(),
            ExecError::Foreign(message) => Self::Environment(message),
            other => Self::Bad(other.to_string()),
        }
    }
}

/// Executes a batch.
fn serve(path: &Path, args: &ExecArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    if !args.push {
        let batch = BatchFile::read(path).map_err(CliError::Bad)?;
        let to = args.lines.as_deref().map_or(Telling::Parent, Telling::File);
        batch::serve(batch, &cache.open()?, registry, to)?;
        return Ok(Exit::Done);
    }
    let (courier, name) = (upstream::courier(cache)?, path.display().to_string());
    let note = format!("{name}.batch");
    let text = courier.get(&note).map_err(CliError::Environment)?;
    let text = text.ok_or_else(|| CliError::Bad(format!("the upstream has no batch `{note}`; `run` writes them")))?;
    let batch = BatchFile::parse(&text);
    let batch = batch.map_err(|why| CliError::Bad(format!("`{note}` is no batch of actions: {why}")))?;
    batch::serve(batch, &cache.open()?, registry, Telling::Note(&*courier, &format!("{name}.lines")))?;
    Ok(Exit::Done)
}

pub(crate) fn exec(args: &ExecArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    if let Some(path) = &args.batch {
        return serve(path, args, registry, cache);
    }
    let stop = Arc::new(AtomicBool::new(false));
    match &args.inside {
        Some(folder) => alone::end_with_parent(folder, stop.clone())?,
        None if args.print => {}
        None => return alone::alone(args, cache),
    }
    // Printing changes nothing, and makes no cache.
    let store = if args.print { cache.look()? } else { cache.open()? };
    let path = Path::new(args.action());
    let action = if path.exists() {
        let refused = |what: String| {
            CliError::Bad(format!("{} is not an action: {what}; `tauflow exec KEY --print` writes one", args.action()))
        };
        let bytes = read_regular(path, MOST_BYTES).map_err(|e| refused(e.to_string()))?;
        serde_json::from_slice(&bytes).map_err(|e| refused(e.to_string()))?
    } else {
        ActionFile::recorded(&store, &exec::find(&store, args.action())?)?
    };
    if args.print {
        outln!("{}", serde_json::to_string_pretty(&action).expect("an action is plain data"));
        return Ok(Exit::Done);
    }
    let done = action.run(&store, registry, &stop, &Silent);
    while stop.load(Ordering::Relaxed) {
        thread::park(); // what ends the action ends this process, when it is through
    }
    match done {
        Ok(done) => {
            outln!("{}", serde_json::to_string_pretty(&done).expect("digests are plain data"));
            Ok(Exit::Done)
        }
        Err(ExecError::Failed(message)) => {
            errln!("error: {message}");
            Ok(Exit::Failed)
        }
        Err(other) => Err(other.into()),
    }
}
