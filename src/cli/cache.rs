//! `tauflow cache`.

use super::{
    CacheAt, CliError, Exit, bytes_text, seconds_text, table, terminal,
    upstream::{self, PushArgs},
};
use crate::{
    engine::PIPELINE,
    kinds::Registry,
    query,
    units::{bytes, seconds},
};
use clap::Subcommand;
use std::{
    path::PathBuf,
    time::{SystemTime, UNIX_EPOCH},
};
use tauflow_cache::{Digest, GcOptions, GcReport, Store};

/// Commands for the cache.
#[derive(Subcommand)]
pub(crate) enum CacheCommand {
    /// Print the number and size of blobs and records; with --upstream those of the upstream.
    Stat,
    /// Verify all blobs. Damaged blobs are moved aside and rebuilt on demand. Exits with 1 if blobs are damaged or
    /// lost; blobs of `transient` nodes do not count as lost.
    Verify {
        /// Verify only this share.
        #[arg(long, value_name = "SHARE")]
        sample: Option<f64>,
    },
    /// Delete results that are neither recent nor pinned, the fastest to rebuild first.
    Gc {
        /// Target size, such as 20GiB or 500MB.
        #[arg(long, value_name = "SIZE", value_parser = bytes)]
        max_size: Option<u64>,
        /// Keep results used within this time, such as 12h or 30d.
        #[arg(long, value_name = "TIME", value_parser = seconds)]
        keep_within: Option<f64>,
        /// Delete records whose blobs are lost, even recent ones; their actions rerun on demand. By default they are
        /// kept, and lost blobs are rebuilt when needed.
        #[arg(long)]
        lost: bool,
        /// Print what would be deleted, without deleting.
        #[arg(long)]
        dry_run: bool,
    },
    /// Protect a blob from gc.
    Pin {
        /// Name of the pin.
        name: String,
        /// Blob to pin: `<hash>-<size>`.
        digest: String,
    },
    /// Remove a pin.
    Unpin {
        /// Name of the pin.
        name: String,
    },
    /// List the pins.
    Pins,
    /// Copy results that the upstream lacks to it. An upstream is a directory or object store that several machines
    /// share.
    Push(PushArgs),
    /// Make a pair of keys, with which `cache push --sign` signs. FILE gets the secret key, FILE.pub the public one.
    Keygen {
        /// File of the secret key. It must not exist.
        file: PathBuf,
    },
    /// Copy all results of the upstream to this cache. Everything is verified; what the cache has stays.
    Pull,
}

/// The blobs that the last complete run of each pipeline refers to.
fn by_pipeline<'a>(store: &Store, names: impl Iterator<Item = &'a String>) -> Result<(), CliError> {
    let mut rows = vec![["pipeline", "blobs", "size", "its own"].map(str::to_owned).to_vec()];
    for of in query::reached(store, names)? {
        rows.push(vec![of.pipeline, of.blobs.to_string(), bytes_text(of.bytes), bytes_text(of.own_bytes)]);
    }
    if rows.len() > 1 {
        out!("\n{}", table(&rows));
    }
    Ok(())
}

/// The cache, which has to be there.
pub(crate) fn made(at: &CacheAt) -> Result<Store, CliError> {
    let store = at.look_alone()?;
    if !store.is_made() {
        let folder = store.dir().display();
        return Err(CliError::Bad(format!(
            "no cache in `{folder}`; `tauflow run` creates one, and --cache selects a directory"
        )));
    }
    Ok(store)
}

pub(crate) fn cache(command: &CacheCommand, registry: &Registry, at: &CacheAt) -> Result<Exit, CliError> {
    match command {
        CacheCommand::Stat if at.upstream.as_ref().is_some_and(|to| !to.is_empty()) => return upstream::stat(at),
        CacheCommand::Stat => stat(&made(at)?)?,
        CacheCommand::Push(args) => return upstream::push(args, registry, at),
        CacheCommand::Pull => return upstream::pull(at),
        CacheCommand::Keygen { file } => return upstream::keygen(file),
        CacheCommand::Verify { sample } => {
            if sample.is_some_and(|s| !(0.0..=1.0).contains(&s)) {
                return Err(CliError::Bad("--sample must be between 0 and 1, for example 0.1".into()));
            }
            return verify(&made(at)?, *sample);
        }
        CacheCommand::Gc { max_size, keep_within, lost, dry_run } => {
            if max_size.is_none() && keep_within.is_none() && !lost {
                let message = "specify --max-size, --keep-within, or both; or --lost";
                return Err(CliError::Bad(message.into()));
            }
            let report = made(at)?.gc(&GcOptions {
                max_bytes: *max_size,
                keep_within_secs: keep_within.map(|seconds| seconds as u64),
                now: SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs()),
                dry_run: *dry_run,
                pins: Vec::new(),
                lost: *lost,
            })?;
            collected(&report);
        }
        CacheCommand::Pin { name, digest } => {
            let digest: Digest = digest
                .parse()
                .map_err(|_| CliError::Bad(format!("`{digest}` is not a digest; the format is `<hash>-<size>`")))?;
            let store = at.look_alone()?;
            if !store.contains(&digest) {
                return Err(CliError::Bad(format!("the cache has no blob {digest}")));
            }
            store.pin(name, &digest)?;
        }
        CacheCommand::Unpin { name } => {
            if !at.look_alone()?.unpin(name)? {
                return Err(CliError::Bad(format!("unknown pin `{name}`; see `tauflow cache pins`")));
            }
        }
        CacheCommand::Pins => {
            for (name, digest) in at.look_alone()?.pins()? {
                outln!("{name}  {digest}");
            }
        }
    }
    Ok(Exit::Done)
}

fn stat(store: &Store) -> Result<(), CliError> {
    let stat = store.stat()?;
    outln!("{}", store.dir().display());
    if let Some(network) = store.file_system().network {
        let locks = if store.file_system().lockless { "without locks" } else { "with locks" };
        outln!("on {network}, {locks}; see docs/many_machines.md");
    }
    outln!("{} blobs, {}; log {}", stat.blobs, bytes_text(stat.bytes), bytes_text(stat.log_bytes));
    if stat.quarantined + stat.conflicts > 0 {
        outln!("{} damaged blobs moved aside, {} conflicting records", stat.quarantined, stat.conflicts);
    }
    let mut rows = vec![["records of", "count", "time", "size"].map(str::to_owned).to_vec()];
    for (namespace, labels) in &stat.records {
        for (label, of) in labels {
            rows.push(vec![
                format!("{namespace} {label}"),
                of.count.to_string(),
                seconds_text(of.wall_us as f64 / 1e6),
                bytes_text(of.bytes),
            ]);
        }
    }
    out!("{}", table(&rows));
    by_pipeline(store, stat.records.get(PIPELINE).into_iter().flat_map(|labels| labels.keys()))
}

fn verify(store: &Store, sample: Option<f64>) -> Result<Exit, CliError> {
    let bar = terminal::bar(0);
    let report = store.verify(sample, 0, &mut |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    })?;
    bar.finish_and_clear();
    outln!(
        "{} of {} blobs verified ({}), {} damaged; {} records, {} damaged, {} incomplete, {} of these lost",
        report.checked,
        report.blobs,
        bytes_text(report.checked_bytes),
        report.damaged.len(),
        report.records,
        report.damaged_records,
        report.incomplete_records,
        report.lost_records
    );
    for digest in &report.damaged {
        outln!("moved aside: {digest}");
    }
    if report.damaged_places > 0 {
        outln!("{} damaged regions in packs; their blobs are missing", report.damaged_places);
    }
    if report.torn_bytes > 0 {
        outln!(
            "{} bytes after the last complete entry of a file: a process was killed during a write, or the file was \
            truncated",
            report.torn_bytes
        );
    }
    if !report.is_damaged() {
        return Ok(Exit::Done);
    }
    errln!(
        "damaged or lost results are rebuilt by the next run that needs them; `tauflow cache gc --lost` deletes the \
        others"
    );
    Ok(Exit::Failed)
}

fn collected(report: &GcReport) {
    let verb = if report.dry_run { "would remove" } else { "removed" };
    outln!(
        "{verb} {} blobs, {}, and {} records; {} blobs stay, {}",
        report.removed_blobs,
        bytes_text(report.removed_bytes),
        report.removed_records,
        report.kept_blobs,
        bytes_text(report.kept_bytes)
    );
    if report.lost_records > 0 {
        outln!(
            "{} of the remaining records have lost blobs, which are rebuilt on demand; --lost deletes these records",
            report.lost_records
        );
    }
    if report.over_budget > 0 {
        outln!(
            "{} more than requested: protected by running processes, pins or recent use",
            bytes_text(report.over_budget)
        );
    }
    if report.no_room_bytes > 0 {
        outln!(
            "{} remain, because the disk has no space to copy live blobs out of their files; free some space and \
            repeat",
            bytes_text(report.no_room_bytes)
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every option that an error names is there.
    #[test]
    fn advice_names_options_that_exist() {
        use clap::CommandFactory;
        use std::io;
        use tauflow_cache::CacheError;
        let mut program = crate::cli::Cli::command();
        program.build();
        let words = ["cache", "gc"];
        let command = words.iter().try_fold(&program, |at, word| at.find_subcommand(word)).expect("it is there");
        let options: Vec<String> =
            command.get_arguments().filter_map(|a| a.get_long()).map(|l| format!("--{l}")).collect();
        let kinds = [
            io::ErrorKind::StorageFull,
            io::ErrorKind::PermissionDenied,
            io::ErrorKind::ReadOnlyFilesystem,
            io::ErrorKind::NotADirectory,
            io::ErrorKind::Other,
        ];
        let mut named = 0;
        for kind in kinds {
            let error = CacheError::Io { action: "write", path: PathBuf::from("x"), source: kind.into() };
            let message = error.to_string();
            for word in
                message.split(|c: char| !(c.is_ascii_alphanumeric() || c == '-')).filter(|w| w.starts_with("--"))
            {
                assert!(options.iter().any(|option| option == word), "`{word}` of: {message}");
                named += 1;
            }
        }
        assert!(named >= 6, "{named}");
    }
}
