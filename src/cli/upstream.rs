//! Upstreams: caches that several machines share. Commands that read results look there for what the cache lacks, and
//! `cache push`, `cache pull` and `cache stat --upstream` copy and count.

use super::{CacheAt, CliError, Exit, PipelineArgs, bytes_text, config::Config, counted, terminal};
use crate::{
    engine::{self, ROLLUP, SHARD},
    kinds::Registry,
    pipeline::Pipeline,
};
use clap::Args;
use std::{
    env,
    path::{Path, PathBuf},
    sync::Arc,
};
use tauflow_cache::{Key, Record, Store};
use tauflow_contract::ActionKey;
use tauflow_upstream::{Pushed, Reader, Upstream, UpstreamError, Wanted};

/// What is shared. Sub-steps (`memo`) stay: answers of programs about a machine are among them. What a whole run
/// reaches stays, too, because it names all outputs, measured ones included.
const SHARED: &[&str] = &[engine::ACTION, ROLLUP, SHARD];

impl From<UpstreamError> for CliError {
    fn from(error: UpstreamError) -> Self {
        match error {
            UpstreamError::NotUpstream { .. } | UpstreamError::Format { .. } => Self::Bad(error.to_string()),
            other => Self::Environment(other.to_string()),
        }
    }
}

/// Which upstream the user chose: by the option, the environment or the configuration. An empty choice is none.
pub(crate) fn chosen(option: Option<&str>) -> Result<Option<PathBuf>, CliError> {
    let variable = || match env::var_os("TAUFLOW_UPSTREAM") {
        None => Ok(None),
        Some(value) => value.into_string().map(Some).map_err(|value| {
            CliError::Bad(format!("TAUFLOW_UPSTREAM is not valid UTF-8: {}", Path::new(&value).display()))
        }),
    };
    let named = match option {
        Some(named) => Some(named.to_owned()),
        None => match variable()? {
            Some(named) => Some(named),
            None => Config::read()?.upstream,
        },
    };
    match named.filter(|named| !named.is_empty()) {
        Some(url) if url.contains("://") => Err(CliError::Bad(format!(
            "the upstream `{url}` is a URL, but must be a directory; mount it, and give its directory"
        ))),
        named => Ok(named.map(PathBuf::from)),
    }
}

/// The upstream, which must be chosen.
fn required(at: &CacheAt) -> Result<PathBuf, CliError> {
    at.upstream()?.ok_or_else(|| {
        CliError::Bad(
            "no upstream: give --upstream DIR, or set TAUFLOW_UPSTREAM, or `upstream` in the configuration".into(),
        )
    })
}

/// Reads an upstream for a store that lacks something. A failure is a note.
pub(crate) fn reader(folder: PathBuf) -> Arc<Reader> {
    let opening = move || Upstream::open(&folder);
    let tell = |note: &str| terminal::note(&format!("note: {note}"));
    Arc::new(Reader::new(Box::new(opening), SHARED, is_sound, Box::new(tell)))
}

/// Whether the key of a record is the hash of its text. Only actions can be checked like this.
fn is_sound(record: &Record) -> bool {
    record.namespace != engine::ACTION
        || serde_json::from_str::<ActionKey>(&record.preimage).is_ok_and(|key| key.hash() == record.key)
}

/// Prints notes; damage makes the command fail, so that scripts notice.
fn noted(notes: &[String]) -> Exit {
    notes.iter().for_each(|note| eprintln!("note: {note}"));
    if notes.is_empty() { Exit::Done } else { Exit::Failed }
}

/// Arguments of `cache push`.
#[derive(Args)]
pub(crate) struct PushArgs {
    /// Push only the results of this pipeline file.
    pipeline: Option<PathBuf>,
    /// Apply this profile of the file.
    #[arg(long, value_name = "NAME", requires = "pipeline")]
    profile: Option<String>,
    /// Override a param or named value, as for `run`. Can be repeated.
    #[arg(long = "set", value_name = "NODE.PARAM=VALUE", requires = "pipeline")]
    sets: Vec<String>,
    /// Push also measured and machine-dependent outputs, and what was made together with them, such as a trained model
    /// with its training time. Other machines then show these measurements as their own.
    #[arg(long)]
    all: bool,
    /// Print what would be copied, without copying.
    #[arg(long)]
    dry_run: bool,
}

/// Copies records that the upstream lacks.
fn send(
    store: &Store,
    upstream: &Upstream,
    keys: &[(&str, Key)],
    free: &dyn Fn(&Record) -> bool,
    dry_run: bool,
) -> Result<Pushed, CliError> {
    let bar = terminal::bar(0);
    let mut progress = |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    };
    let pushed = tauflow_upstream::push(store, upstream, keys, free, dry_run, &mut progress)?;
    bar.finish_and_clear();
    Ok(pushed)
}

/// Tells in lines what a push did.
fn lines(pushed: &Pushed, verb: &str) -> Vec<String> {
    let mut lines = vec![format!(
        "{verb} {} and {}, {}; {} there already",
        counted(pushed.records, "record"),
        counted(pushed.blobs, "blob"),
        bytes_text(pushed.bytes),
        pushed.same
    )];
    if pushed.bound > 0 {
        lines.push(format!(
            "{} with measured or machine-dependent outputs left out; `cache push --all` includes them",
            counted(pushed.bound, "record")
        ));
    }
    if pushed.incomplete > 0 {
        lines.push(format!(
            "{} left out, because blobs are missing here; a run rebuilds them",
            counted(pushed.incomplete, "record")
        ));
    }
    lines
}

pub(crate) fn push(args: &PushArgs, registry: &Registry, at: &CacheAt) -> Result<Exit, CliError> {
    let folder = required(at)?;
    let store = super::cache::made(at)?;
    let keys = match &args.pipeline {
        None => tauflow_upstream::all(&store, SHARED),
        Some(file) => {
            let (profile, sets) = (args.profile.clone(), args.sets.clone());
            let pipeline = PipelineArgs { pipeline: file.clone(), profile, sets, targets: Vec::new() };
            engine::reached(&pipeline.resolve(registry)?, &store)?
        }
    };
    // Where there is no upstream yet, a dry run has nothing to compare with, and makes none.
    let upstream = if args.dry_run { Upstream::open(&folder)? } else { Upstream::create(&folder)? };
    let free = |record: &Record| args.all || engine::holds_anywhere(record, registry);
    let pushed = send(&store, &upstream, &keys, &free, args.dry_run)?;
    lines(&pushed, if args.dry_run { "would push" } else { "pushed" }).iter().for_each(|line| outln!("{line}"));
    Ok(noted(&pushed.notes))
}

/// Publishes the results of a pipeline at the end of its run. The error says that they were not published.
pub(crate) fn publish(pipeline: &Pipeline, registry: &Registry, at: &CacheAt) -> Result<(), CliError> {
    let store = at.alone()?;
    let send = || -> Result<Pushed, CliError> {
        let upstream = Upstream::create(&required(at)?)?;
        let keys = engine::reached(pipeline, &store)?;
        send(&store, &upstream, &keys, &|record| engine::holds_anywhere(record, registry), false)
    };
    let pushed = send().map_err(|error| {
        CliError::Environment(format!("the results are in the cache, but were not pushed: {error}; try `cache push`"))
    })?;
    lines(&pushed, "pushed").iter().for_each(|line| eprintln!("{line}"));
    pushed.notes.iter().for_each(|note| eprintln!("note: {note}"));
    Ok(())
}

/// Makes the upstream to which results are to be published, unless it is there. A run is not to fail at its end.
pub(crate) fn prepare(at: &CacheAt) -> Result<(), CliError> {
    Upstream::create(&required(at)?)?;
    Ok(())
}

pub(crate) fn pull(at: &CacheAt) -> Result<Exit, CliError> {
    let upstream = Upstream::open(&required(at)?)?;
    let store = at.alone()?;
    let bar = terminal::bar(0);
    let mut progress = |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    };
    let wanted = Wanted { namespaces: SHARED, sound: &is_sound };
    let pulled = tauflow_upstream::pull(&store, &upstream, wanted, &mut progress)?;
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
pub(crate) fn stat(at: &CacheAt) -> Result<Exit, CliError> {
    let upstream = Upstream::open(&required(at)?)?;
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
