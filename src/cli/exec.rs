//! `tauflow exec`.

use super::{CacheAt, CliError, Exit, cache::seconds};
use crate::{
    engine::exec::{self, ActionFile, ExecError},
    kinds::Registry,
};
use clap::Args;
use std::{
    io::Read,
    path::PathBuf,
    process::{Command, Stdio},
    sync::{Arc, atomic::AtomicBool},
    thread,
    time::{Duration, Instant},
};
use tauflow_contract::Silent;

/// What `exec` takes.
#[derive(Args)]
pub(crate) struct ExecArgs {
    /// The action: its key or the beginning of it, or a file that `--print` wrote.
    action: String,
    /// Stop it after this time, such as 90s, 10m or 2h.
    #[arg(long, value_name = "TIME", value_parser = seconds)]
    limit: Option<f64>,
    /// Print the action, to be run elsewhere, and run nothing.
    #[arg(long)]
    print: bool,
    /// Already in a process of its own.
    #[arg(long, hide = true)]
    inside: bool,
}

impl From<ExecError> for CliError {
    fn from(error: ExecError) -> Self {
        match error {
            ExecError::Cache(error) => error.into(),
            other => Self::Bad(other.to_string()),
        }
    }
}

pub(crate) fn exec(args: &ExecArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    if !args.inside && !args.print {
        return alone(args, cache);
    }
    let store = cache.open()?;
    let action = match std::fs::read_to_string(&args.action) {
        Ok(text) => serde_json::from_str(&text).map_err(|e| {
            CliError::Bad(format!("{} is no action: {e}; `tauflow exec KEY --print` writes one", args.action))
        })?,
        Err(_) => ActionFile::recorded(&store, &exec::find(&store, &args.action)?)?,
    };
    if args.print {
        outln!("{}", serde_json::to_string_pretty(&action).expect("an action is plain data"));
        return Ok(Exit::Done);
    }
    let stop = Arc::new(AtomicBool::new(false));
    let done = action.run(&store, registry, &stop, &Silent);
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

/// Runs the action in a process of its own, which has an empty folder, no environment and no input.
fn alone(args: &ExecArgs, cache: &CacheAt) -> Result<Exit, CliError> {
    let failed = |what: &str, e: std::io::Error| CliError::Environment(format!("cannot {what}: {e}"));
    let program = std::env::current_exe().map_err(|e| failed("find this program", e))?;
    let folder = tempfile::tempdir().map_err(|e| failed("make a folder to run in", e))?;
    let absolute = |path: PathBuf| std::path::absolute(path).map_err(|e| failed("find the current folder", e));
    let file = PathBuf::from(&args.action);
    let action = if file.is_file() { absolute(file)?.into_os_string() } else { args.action.clone().into() };
    let mut child = Command::new(program)
        .arg("exec")
        .arg(action)
        .arg("--inside")
        .arg("--cache")
        .arg(absolute(cache.folder())?)
        .env_clear()
        .current_dir(folder.path())
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .map_err(|e| failed("start the action", e))?;
    let mut stdout = child.stdout.take();
    let reader = thread::spawn(move || {
        let mut text = String::new();
        stdout.as_mut().map(|out| out.read_to_string(&mut text)).transpose().map(|_| text)
    });
    let start = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().map_err(|e| failed("wait for the action", e))? {
            break status;
        }
        if args.limit.is_some_and(|limit| start.elapsed().as_secs_f64() > limit) {
            // It may have ended just now.
            let _ = child.kill();
            let _ = child.wait();
            eprintln!("error: the action was stopped after its limit; nothing of it is recorded");
            return Ok(Exit::Failed);
        }
        thread::sleep(Duration::from_millis(5));
    };
    let text = reader.join().ok().and_then(Result::ok).unwrap_or_default();
    out!("{text}");
    Ok(match status.code() {
        Some(0) => Exit::Done,
        Some(1) => Exit::Failed,
        Some(2) => Exit::Bad,
        Some(130) => Exit::Interrupted,
        Some(_) => Exit::Environment,
        None => {
            eprintln!("error: the action's process was killed ({status})");
            Exit::Failed
        }
    })
}
