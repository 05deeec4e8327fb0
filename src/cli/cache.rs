//! `tauflow cache`.

use super::{CacheAt, CliError, Exit, bytes_text, seconds_text, table};
use clap::Subcommand;
use std::{
    io::IsTerminal,
    time::{SystemTime, UNIX_EPOCH},
};
use tauflow_cache::{Digest, GcOptions};

/// What can be done with the cache.
#[derive(Subcommand)]
pub(crate) enum CacheCommand {
    /// Count what it holds.
    Stat,
    /// Read and rehash blobs; damaged ones are set aside, and made again when they are needed.
    Verify {
        /// Check only this share.
        #[arg(long, value_name = "SHARE")]
        sample: Option<f64>,
    },
    /// Remove what nothing recent or pinned reaches.
    Gc {
        /// Keep at most so many GiB.
        #[arg(long, value_name = "GIB")]
        max_gib: Option<f64>,
        /// Keep what was used in the last so many days.
        #[arg(long, value_name = "DAYS")]
        keep_days: Option<f64>,
        /// Only say what would be removed.
        #[arg(long)]
        dry_run: bool,
    },
    /// Keep a blob, whatever a gc removes.
    Pin {
        /// A name for the pin.
        name: String,
        /// The blob, `<hash>-<size>`.
        digest: String,
    },
    /// Take a pin away.
    Unpin {
        /// Its name.
        name: String,
    },
    /// List the pins.
    Pins,
}

pub(crate) fn cache(command: &CacheCommand, at: &CacheAt) -> Result<Exit, CliError> {
    let store = at.open()?;
    match command {
        CacheCommand::Stat => {
            let stat = store.stat()?;
            outln!("{}", store.dir().display());
            outln!("{} blobs, {}; log {}", stat.blobs, bytes_text(stat.bytes), bytes_text(stat.log_bytes));
            if stat.quarantined + stat.conflicts > 0 {
                outln!("{} damaged blobs set aside, {} conflicting records", stat.quarantined, stat.conflicts);
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
        }
        CacheCommand::Verify { sample } => {
            if sample.is_some_and(|s| !(0.0..=1.0).contains(&s)) {
                return Err(CliError::Bad("--sample takes a share from 0 to 1, for example 0.1".into()));
            }
            let bar = if std::io::stderr().is_terminal() {
                indicatif::ProgressBar::new(0)
            } else {
                indicatif::ProgressBar::hidden()
            };
            let report = store.verify(*sample, 0, &mut |done, total| {
                bar.set_length(total);
                bar.set_position(done);
            })?;
            bar.finish_and_clear();
            outln!(
                "{} of {} blobs checked ({}), {} damaged; {} records, {} damaged, {} incomplete",
                report.checked,
                report.blobs,
                bytes_text(report.checked_bytes),
                report.damaged.len(),
                report.records,
                report.damaged_records,
                report.incomplete_records
            );
            for digest in &report.damaged {
                outln!("set aside: {digest}");
            }
        }
        CacheCommand::Gc { max_gib, keep_days, dry_run } => {
            if max_gib.is_none() && keep_days.is_none() {
                return Err(CliError::Bad("say what to keep: --max-gib, --keep-days, or both".into()));
            }
            if max_gib.iter().chain(keep_days).any(|v| !(v.is_finite() && *v >= 0.0)) {
                return Err(CliError::Bad("--max-gib and --keep-days take numbers from 0".into()));
            }
            let report = store.gc(&GcOptions {
                max_bytes: max_gib.map(|gib| (gib * f64::from(1u32 << 30)) as u64),
                keep_within_secs: keep_days.map(|days| (days * 86_400.0) as u64),
                now: SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs()),
                dry_run: *dry_run,
                pins: Vec::new(),
            })?;
            let verb = if *dry_run { "would remove" } else { "removed" };
            outln!(
                "{verb} {} blobs, {}, and {} records; {} blobs stay, {}",
                report.removed_blobs,
                bytes_text(report.removed_bytes),
                report.removed_records,
                report.kept_blobs,
                bytes_text(report.kept_bytes)
            );
        }
        CacheCommand::Pin { name, digest } => {
            let digest: Digest = digest
                .parse()
                .map_err(|_| CliError::Bad(format!("`{digest}` is no digest; it reads `<hash>-<size>`")))?;
            if !store.contains(&digest) {
                return Err(CliError::Bad(format!("the cache has no blob {digest}")));
            }
            store.pin(name, &digest)?;
        }
        CacheCommand::Unpin { name } => {
            if !store.unpin(name)? {
                return Err(CliError::Bad(format!("there is no pin `{name}`; see `tauflow cache pins`")));
            }
        }
        CacheCommand::Pins => {
            for (name, digest) in store.pins()? {
                outln!("{name}  {digest}");
            }
        }
    }
    Ok(Exit::Done)
}
