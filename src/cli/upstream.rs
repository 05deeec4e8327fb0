//! Upstreams: caches that several machines share. Commands that read results look there for what the cache lacks, and
//! `cache push`, `cache pull` and `cache stat --upstream` copy and count.

use super::{CacheAt, CliError, Exit, PipelineArgs, bytes_text, config::Config, counted, terminal};
use crate::{
    engine::{self, ROLLUP, SHARD, courier::Courier},
    kinds::Registry,
    pipeline::Pipeline,
};
use clap::Args;
use std::{
    env,
    path::{Path, PathBuf},
    sync::Arc,
};
use tauflow_cache::{Digest, Key, Record, Store};
use tauflow_contract::ActionKey;
use tauflow_upstream::{
    Address, PublicKey, Pushed, Reader, SecretKey, Sender, Traffic, Upstream, UpstreamError, Wanted,
};

/// Records that are pushed by their own. Sub-steps (`memo`) stay: answers of programs about a machine are among them.
/// What a whole run reaches stays, too, because it names all outputs, measured ones included.
const PUSHED: &[&str] = &[engine::ACTION, ROLLUP, SHARD];
/// Records that come down. The lists of files that programs looked at are pushed with their actions.
const SHARED: &[&str] = &[engine::ACTION, ROLLUP, SHARD, engine::SEEN, engine::MACHINE];

impl From<UpstreamError> for CliError {
    fn from(error: UpstreamError) -> Self {
        match error {
            UpstreamError::NotUpstream { .. }
            | UpstreamError::Format { .. }
            | UpstreamError::Address { .. }
            | UpstreamError::Key { .. } => Self::Bad(error.to_string()),
            other => Self::Environment(other.to_string()),
        }
    }
}

/// What the user chose: by the option, the environment or the configuration. An empty choice is none.
fn choice(
    option: Option<&str>,
    variable: &str,
    configured: impl Fn(Config) -> Option<String>,
) -> Result<Option<String>, CliError> {
    let named = match (option, env::var_os(variable)) {
        (Some(named), _) => Some(named.to_owned()),
        (None, Some(value)) => Some(value.into_string().map_err(|value| {
            CliError::Bad(format!("{variable} is not valid UTF-8: {}", Path::new(&value).display()))
        })?),
        (None, None) => configured(Config::read()?),
    };
    Ok(named.filter(|named| !named.is_empty()))
}

/// Which upstream the user chose.
pub(crate) fn chosen(option: Option<&str>) -> Result<Option<Address>, CliError> {
    let named = choice(option, "TAUFLOW_UPSTREAM", |config| config.upstream)?;
    Ok(named.map(|named| named.parse()).transpose()?)
}

/// The public key that signs the upstream, if the user chose one.
pub(crate) fn chosen_key(option: Option<&str>) -> Result<Option<PublicKey>, CliError> {
    let named = choice(option, "TAUFLOW_UPSTREAM_KEY", |config| config.upstream_key)?;
    Ok(named.map(|named| PublicKey::given(&named)).transpose()?)
}

/// The upstream, which must be chosen.
fn required(at: &CacheAt) -> Result<Address, CliError> {
    at.upstream()?.ok_or_else(|| {
        CliError::Bad(
            "no upstream: give --upstream DIR|URL, or set TAUFLOW_UPSTREAM, or `upstream` in the configuration".into(),
        )
    })
}

/// Opens the upstream for reading. Indices of an object store are kept in the cache.
fn opened(at: &CacheAt) -> Result<Upstream, CliError> {
    Ok(Upstream::open(&required(at)?)?.keeping(&kept(at)).pinned(at.upstream_key()?))
}

/// Opens the upstream for writing, and makes it if necessary.
fn created(at: &CacheAt) -> Result<Upstream, CliError> {
    Ok(Upstream::create(&required(at)?)?.keeping(&kept(at)).pinned(at.upstream_key()?))
}

/// The key that signs what is written. Nobody who pins the upstream uses packs without its signature.
fn signer(at: &CacheAt, file: Option<&Path>) -> Result<Option<SecretKey>, CliError> {
    if file.is_none() && at.upstream_key()?.is_some() {
        return Err(CliError::Bad(
            "the upstream is pinned to a key, and results that are pushed without its signature are not used: add \
             --sign FILE, or do not push"
                .into(),
        ));
    }
    let Some(file) = file else { return Ok(None) };
    let (key, pinned) = (SecretKey::read(file)?, at.upstream_key()?);
    match pinned {
        Some(pinned) if key.public()?.to_string() != pinned.to_string() => Err(CliError::Bad(format!(
            "the upstream is pinned to the key {pinned}, and `{}` signs with another one; sign with the key of the \
             upstream, or pin it to {}",
            file.display(),
            key.public()?
        ))),
        _ => Ok(Some(key)),
    }
}

/// The upstream that signs with this key.
fn signing(upstream: Upstream, key: Option<SecretKey>) -> Result<Upstream, CliError> {
    Ok(match key {
        Some(key) => upstream.signing(key)?,
        None => upstream,
    })
}

/// Where indices of object stores are kept.
fn kept(at: &CacheAt) -> PathBuf {
    at.folder().join("upstream")
}

/// The requests to an object store, in words.
pub(crate) fn traffic_text(of: Traffic) -> String {
    format!("{}, {} received, {} sent", counted(of.requests, "request"), bytes_text(of.received), bytes_text(of.sent))
}

/// Tells on the standard error what an object store was asked.
fn tell_traffic(upstream: &Upstream) {
    if let Some(traffic) = upstream.traffic() {
        errln!("upstream: {}", traffic_text(traffic));
    }
}

/// Reads an upstream for a store that lacks something. A failure is a note.
pub(crate) fn reader(address: Address, key: Option<PublicKey>, cache: PathBuf) -> Arc<Reader> {
    let opening = move || Ok(Upstream::open(&address)?.keeping(&cache.join("upstream")).pinned(key.clone()));
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
    notes.iter().for_each(|note| errln!("note: {note}"));
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
    /// Push also measurements and machine-dependent outputs. Another machine takes measurements only with `run
    /// --accept-measured`.
    #[arg(long)]
    all: bool,
    /// Sign what is written with the secret key in this file, which `cache keygen FILE` makes. Packs without a
    /// signature of this key do not count as present.
    #[arg(long, value_name = "FILE")]
    sign: Option<PathBuf>,
    /// Print what would be copied, without copying.
    #[arg(long)]
    dry_run: bool,
}

/// Makes a pair of keys, and prints the public one.
pub(crate) fn keygen(file: &Path) -> Result<Exit, CliError> {
    let (public, beside) = SecretKey::generate(file)?;
    errln!("wrote the secret key {} and the public key {}", file.display(), beside.display());
    outln!("{public}");
    Ok(Exit::Done)
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
    let seen = engine::seen_by(store, keys, free);
    let keys = [keys, seen.as_slice()].concat();
    let free = |record: &Record| record.namespace == engine::SEEN || free(record);
    let pushed = tauflow_upstream::push(store, upstream, &keys, &free, dry_run, &mut progress)?;
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
    if pushed.left > 0 {
        lines.push(format!(
            "{} left out, because they came from another upstream and not all of their blobs are here; `cache pull` \
             from that upstream copies them",
            counted(pushed.left, "record")
        ));
    }
    lines
}

pub(crate) fn push(args: &PushArgs, registry: &Registry, at: &CacheAt) -> Result<Exit, CliError> {
    required(at)?;
    let key = signer(at, args.sign.as_deref())?;
    let store = super::cache::made(at)?;
    // Where there is no upstream yet, a dry run has nothing to compare with, and makes none.
    let upstream = signing(if args.dry_run { opened(at)? } else { created(at)? }, key)?;
    let mut missing = 0;
    let keys = match &args.pipeline {
        None => tauflow_upstream::all(&store, PUSHED),
        Some(file) => {
            let (profile, sets) = (args.profile.clone(), args.sets.clone());
            let pipeline = PipelineArgs { pipeline: file.clone(), profile, sets, targets: Vec::new() };
            let reached = published(&pipeline.resolve(registry)?, at)?;
            missing = reached.missing;
            reached.keys
        }
    };
    // Whoever accepts measurements looks for the machines first.
    let machines = if args.all { tauflow_upstream::all(&store, &[engine::MACHINE]) } else { Vec::new() };
    let keys = [keys, machines].concat();
    let free = |record: &Record| args.all || engine::holds_anywhere(record, registry);
    let pushed = send(&store, &upstream, &keys, &free, args.dry_run)?;
    lines(&pushed, if args.dry_run { "would push" } else { "pushed" }).iter().for_each(|line| outln!("{line}"));
    if missing > 0 {
        outln!(
            "{} of the pipeline are not there and were not pushed; `tauflow run` makes them",
            counted(missing, "result")
        );
    }
    tell_traffic(&upstream);
    Ok(noted(&pushed.notes))
}

/// The results of a pipeline in the cache and in the upstream. Both are needed: a run that finds a whole node in the
/// upstream copies none of its actions to the cache.
fn published(pipeline: &Pipeline, at: &CacheAt) -> Result<engine::Reached, CliError> {
    Ok(engine::reached(pipeline, &at.look()?)?)
}

/// Publishes the results of a pipeline at the end of its run, signed with the key in a file. The error says that they
/// were not published.
pub(crate) fn publish(
    pipeline: &Pipeline,
    registry: &Registry,
    at: &CacheAt,
    sign: Option<&Path>,
) -> Result<(), CliError> {
    let store = at.alone()?;
    let send = || -> Result<Pushed, CliError> {
        let upstream = signing(created(at)?, signer(at, sign)?)?;
        let keys = published(pipeline, at)?.keys;
        let pushed = send(&store, &upstream, &keys, &|record| engine::holds_anywhere(record, registry), false);
        tell_traffic(&upstream);
        pushed
    };
    let pushed = send().map_err(|error| {
        CliError::Environment(format!("the results are in the cache, but were not pushed: {error}; try `cache push`"))
    })?;
    lines(&pushed, "pushed").iter().for_each(|line| errln!("{line}"));
    pushed.notes.iter().for_each(|note| errln!("note: {note}"));
    Ok(())
}

/// Carries batches and results between a run and jobs that have a store of their own.
#[derive(Debug)]
struct Notes {
    sender: Sender,
    reader: Arc<Reader>,
}

/// What carries batches and results through the upstream.
pub(crate) fn courier(at: &CacheAt) -> Result<Arc<dyn Courier>, CliError> {
    required(at)?;
    if at.upstream_key()?.is_some() {
        return Err(CliError::Bad(
            "--worker-cache: jobs do not sign their results, and an upstream with a key serves signed ones \
             only; use another upstream without a key, or a cache that all machines share"
                .into(),
        ));
    }
    let lost = || CliError::Environment("the upstream cannot be read".into());
    let (sender, reader) = (Sender::new(created(at)?), at.reader()?.ok_or_else(lost)?);
    Ok(Arc::new(Notes { sender, reader }))
}

impl Courier for Notes {
    fn put(&self, name: &str, content: Vec<u8>) -> Result<(), String> {
        self.sender.upstream().put_note(name, content).map_err(|error| error.to_string())
    }

    fn get(&self, name: &str) -> Result<Option<Vec<u8>>, String> {
        self.sender.upstream().note(name).map_err(|error| error.to_string())
    }

    fn delete(&self, names: &[String]) {
        self.sender.upstream().delete_notes(names);
    }

    fn publish(&self, store: &Store, blobs: &[Digest], records: &[(&str, Key)]) -> Result<(), String> {
        self.sender.send(store, blobs, records).map_err(|error| error.to_string())
    }

    fn refresh(&self) -> Result<(), String> {
        self.reader.refresh().map_err(|error| error.to_string())
    }
}

/// Makes the upstream to which results are to be published, unless it is there. A run is not to fail at its end.
pub(crate) fn prepare(at: &CacheAt, sign: Option<&Path>) -> Result<(), CliError> {
    let key = signer(at, sign)?;
    signing(created(at)?, key).map(drop)
}

pub(crate) fn pull(at: &CacheAt) -> Result<Exit, CliError> {
    let upstream = opened(at)?;
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
    tell_traffic(&upstream);
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
    let upstream = opened(at)?;
    let contents = upstream.contents()?;
    let (indices, packs) = contents.files();
    outln!("{}", upstream.name());
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
