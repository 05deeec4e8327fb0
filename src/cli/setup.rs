//! `tauflow init`, `completions` and `man`: one-time setup.

use super::{CliError, Exit};
use crate::{kinds::Registry, pipeline::schema};
use clap::{Args, Command};
use std::{fs, path::PathBuf};

/// Arguments of `init`.
#[derive(Args)]
pub(crate) struct InitArgs {
    /// Directory to write to.
    #[arg(default_value = ".")]
    dir: PathBuf,
}

/// A small first pipeline.
pub const STARTER: &str = include_str!("starter.yaml");

pub(crate) fn init(args: &InitArgs, registry: &Registry) -> Result<Exit, CliError> {
    let schema = serde_json::to_string_pretty(&schema::schema(registry)).expect("a schema is plain data");
    let files = [("pipeline.yaml", STARTER.to_owned()), ("tauflow.schema.json", schema + "\n")];
    for (name, _) in &files {
        let path = args.dir.join(name);
        if path.exists() {
            return Err(CliError::Bad(format!("{} already exists; choose a different directory", path.display())));
        }
    }
    let failed = |e| CliError::Environment(format!("cannot write into {}: {e}", args.dir.display()));
    fs::create_dir_all(&args.dir).map_err(failed)?;
    for (name, text) in &files {
        let path = args.dir.join(name);
        fs::write(&path, text).map_err(failed)?;
        outln!("{}", path.display());
    }
    errln!("next: tauflow run {}", args.dir.join("pipeline.yaml").display());
    Ok(Exit::Done)
}

/// Arguments of `completions`.
#[derive(Args)]
pub(crate) struct CompletionsArgs {
    /// Shell to complete for.
    shell: clap_complete::Shell,
}

pub(crate) fn completions(args: &CompletionsArgs, command: &mut Command) -> Result<Exit, CliError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, command, "tauflow", &mut script);
    out!("{}", String::from_utf8_lossy(&script));
    Ok(Exit::Done)
}

/// Arguments of `man`.
#[derive(Args)]
pub(crate) struct ManArgs {
    /// Directory to write to; created if missing. Existing pages are overwritten.
    dir: PathBuf,
}

pub(crate) fn man(args: &ManArgs, command: Command) -> Result<Exit, CliError> {
    let failed = |e| CliError::Environment(format!("cannot write into {}: {e}", args.dir.display()));
    fs::create_dir_all(&args.dir).map_err(failed)?;
    clap_mangen::generate_to(command, &args.dir).map_err(failed)?;
    outln!("{}", args.dir.display());
    Ok(Exit::Done)
}
