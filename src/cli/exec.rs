//! `tauflow exec`.

use super::{CacheAt, CliError, Exit, alone, cache::seconds};
use crate::{
    engine::{
        batch::{self, BatchFile},
        exec::{self, ActionFile, ExecError},
    },
    kinds::Registry,
};
use clap::Args;
use std::{
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
};
use tauflow_contract::{Silent, read_regular};

/// Most bytes of an action's file: far more than any has.
const MOST_BYTES: u64 = 1 << 28;

/// Arguments of `exec`.
#[derive(Args)]
pub(crate) struct ExecArgs {
    /// Key of the action or a prefix of it, or a file written by `--print`.
    #[arg(required_unless_present = "batch")]
    action: Option<String>,
    /// Stop the action and all its child processes after this time, such as 90s, 10m or 2h.
    #[arg(long, value_name = "TIME", value_parser = seconds)]
    pub(super) limit: Option<f64>,
    /// Run the action in a bubblewrap (`bwrap`) sandbox: without network, and with write access only to its working
    /// directory and the cache. Without this option, `exec` is not a sandbox.
    #[arg(long)]
    pub(super) sandbox: bool,
    /// Print the action instead of running it, for use on another machine.
    #[arg(long)]
    print: bool,
    /// Run the actions of a batch file one after the other, and print a line of JSON for each. `run --executor`
    /// starts these processes, and jobs of a scheduler.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["action", "limit", "sandbox", "print"])]
    batch: Option<PathBuf>,
    /// Append these lines to a file instead. The batch then goes on when the process that started it is gone.
    #[arg(long, value_name = "FILE", requires = "batch")]
    lines: Option<PathBuf>,
    /// Internal: already in a separate process, with this working directory.
    #[arg(long, hide = true, value_name = "DIR")]
    inside: Option<PathBuf>,
}

impl ExecArgs {
    /// The action; the command line must name one where it names no batch.
    pub(super) fn action(&self) -> &str {
        self.action.as_deref().unwrap_or_default()
    }
}

impl From<ExecError> for CliError {
    fn from(error: ExecError) -> Self {
        match error {
            ExecError::Cache(error) => error.into(),
            ExecError::Foreign(message) => Self::Environment(message),
            other => Self::Bad(other.to_string()),
        }
    }
}

pub(crate) fn exec(args: &ExecArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    if let Some(path) = &args.batch {
        let batch = BatchFile::read(path).map_err(CliError::Bad)?;
        batch::serve(batch, &cache.open()?, registry, args.lines.as_deref())?;
        return Ok(Exit::Done);
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
            eprintln!("error: {message}");
            Ok(Exit::Failed)
        }
        Err(other) => Err(other.into()),
    }
}
