//! `tauflow cache push`, `pull` and `stat --upstream`: a cache that several machines share.

use super::{CacheAt, CliError, Exit, bytes_text, counted, terminal};
use crate::engine::{self, PIPELINE, ROLLUP, SHARD};
use clap::Args;
use std::{
    env,
    path::{Path, PathBuf},
};
use tauflow_cache::Record;
use tauflow_contract::ActionKey;
use tauflow_upstream::{Upstream, UpstreamError, Wanted};

/// What is shared. Sub-steps (`memo`) stay: answers of programs about a machine are among them.
const SHARED: &[&str] = &[engine::ACTION, ROLLUP, SHARD, PIPELINE];

impl From<UpstreamError> for CliError {
    fn from(error: UpstreamError) -> Self {
        match error {
            UpstreamError::NotUpstream { .. } | UpstreamError::Format { .. } => Self::Bad(error.to_string()),
            other => Self::Environment(other.to_string()),
        }
    }
}

/// Which upstream is meant.
#[derive(Args)]
pub(crate) struct UpstreamArgs {
    /// Directory of the upstream. Default: $TAUFLOW_UPSTREAM.
    #[arg(long, value_name = "DIR")]
    upstream: Option<PathBuf>,
}

impl UpstreamArgs {
    pub(crate) fn of(folder: &Path) -> Self {
        Self { upstream: Some(folder.to_owned()) }
    }

    fn folder(&self) -> Result<PathBuf, CliError> {
        let variable = || env::var_os("TAUFLOW_UPSTREAM").filter(|dir| !dir.is_empty()).map(PathBuf::from);
        let Some(folder) = self.upstream.clone().or_else(variable) else {
            return Err(CliError::Bad("no upstream: give --upstream DIR, or set TAUFLOW_UPSTREAM".into()));
        };
        if folder.to_str().is_some_and(|text| text.contains("://")) {
            let folder = folder.display();
            return Err(CliError::Bad(format!(
                "the upstream `{folder}` is a URL, but must be a directory; mount it, and give its directory"
            )));
        }
        Ok(folder)
    }
}

/// Whether the key of a record is the hash of its text. Only actions can be checked like this.
fn is_sound(record: &Record) -> bool {
    record.namespace != engine::ACTION
        || serde_json::from_str::<ActionKey>(&record.preimage).is_ok_and(|key| key.hash() == record.key)
}

fn wanted() -> Wanted<'static> {
    Wanted { namespaces: SHARED, sound: &is_sound }
}

/// Prints notes; damage makes the command fail, so that scripts notice.
fn noted(notes: &[String]) -> Exit {
    notes.iter().for_each(|note| eprintln!("note: {note}"));
    if notes.is_empty() { Exit::Done } else { Exit::Failed }
}

pub(crate) fn push(args: &UpstreamArgs, dry_run: bool, at: &CacheAt) -> Result<Exit, CliError> {
    let folder = args.folder()?;
    let store = super::cache::made(at)?;
    let bar = terminal::bar(0);
    let mut progress = |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    };
    // Where there is no upstream yet, a dry run has nothing to compare with, and makes none.
    let upstream = if dry_run { Upstream::open(&folder)? } else { Upstream::create(&folder)? };
    let pushed = tauflow_upstream::push(&store, &upstream, wanted(), dry_run, &mut progress)?;
    bar.finish_and_clear();
    let verb = if dry_run { "would push" } else { "pushed" };
    outln!(
        "{verb} {} and {}, {}; {} there already",
        counted(pushed.records, "record"),
        counted(pushed.blobs, "blob"),
        bytes_text(pushed.bytes),
        pushed.same
    );
    if pushed.incomplete > 0 {
        outln!(
            "{} left out, because blobs are missing here; a run rebuilds them",
            counted(pushed.incomplete, "record")
        );
    }
    Ok(noted(&pushed.notes))
}

pub(crate) fn pull(args: &UpstreamArgs, at: &CacheAt) -> Result<Exit, CliError> {
    let upstream = Upstream::open(&args.folder()?)?;
    let store = at.open()?;
    let bar = terminal::bar(0);
    let mut progress = |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    };
    let pulled = tauflow_upstream::pull(&store, &upstream, wanted(), &mut progress)?;
    bar.finish_and_clear();
    outln!(
        "pulled {} and {}, {}; {} here already",
        counted(pulled.records, "record"),
        counted(pulled.blobs, "blob"),
        bytes_text(pulled.bytes),
        pulled.same
    );
    if pulled.conflicts > 0 {
        outln!("{} with different outputs left out: yours stay", counted(pulled.conflicts, "record"));
    }
    if pulled.incomplete > 0 {
        outln!(
            "{} left out, because blobs are missing or damaged in the upstream; a run rebuilds them",
            counted(pulled.incomplete, "record")
        );
    }
    Ok(noted(&pulled.notes))
}

/// Prints what an upstream holds.
pub(crate) fn stat(args: &UpstreamArgs) -> Result<Exit, CliError> {
    let upstream = Upstream::open(&args.folder()?)?;
    let contents = upstream.contents()?;
    let (indices, packs) = contents.files();
    outln!("{}", upstream.dir().display());
    outln!(
        "{} and {} in {} with {}, {}",
        counted(contents.records() as u64, "record"),
        counted(contents.blobs() as u64, "blob"),
        counted(packs as u64, "pack"),
        if indices == 1 { "1 index".to_owned() } else { format!("{indices} indices") },
        bytes_text(contents.bytes())
    );
    Ok(noted(&contents.notes))
}
