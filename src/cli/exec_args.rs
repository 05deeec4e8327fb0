//! Arguments of `tauflow exec`.

use crate::units::seconds;
use clap::Args;
use std::path::PathBuf;

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
    pub(super) print: bool,
    /// Run the actions of a batch file one after the other, and print a line of JSON for each. `run --executor`
    /// starts these processes, and jobs of a scheduler.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["action", "limit", "sandbox", "print"])]
    pub(super) batch: Option<PathBuf>,
    /// Append these lines to a file instead. The batch then goes on when the process that started it is gone.
    #[arg(long, value_name = "FILE", requires = "batch")]
    pub(super) lines: Option<PathBuf>,
    /// The batch is a note in the upstream, and so are its lines. Results are pushed to the upstream. `run` with
    /// `--worker-cache` starts these processes.
    #[arg(long, requires = "batch", conflicts_with = "lines")]
    pub(super) push: bool,
    /// Internal: already in a separate process, with this working directory.
    #[arg(long, hide = true, value_name = "DIR")]
    pub(super) inside: Option<PathBuf>,
}

impl ExecArgs {
    /// The action; the command line must name one where it names no batch.
    pub(super) fn action(&self) -> &str {
        self.action.as_deref().unwrap_or_default()
    }
}
