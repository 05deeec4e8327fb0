//! `tauflow runs` and `tauflow diff`: the recorded runs of a cache.

use super::{CacheAt, CliError, Exit, bytes_text, counted, seconds_text, table};
use crate::runs::{self, Comparison, MetricChange, Outcome, RowCounts, RunRecord, RunsError, date_text};
use clap::Args;
use serde_json::{Value, json};
use tauflow_data::records::has_intervals;

/// Arguments of `runs`.
#[derive(Args)]
#[command(after_help = "Example: tauflow runs pipelines/quickstart.yaml --last 5")]
pub(crate) struct RunsArgs {
    /// Show only the runs of this pipeline, by its name or its file; or one run in full, by its id.
    #[arg(value_name = "PIPELINE or ID")]
    pipeline: Option<String>,
    /// Number of runs to show, the latest ones.
    #[arg(long, value_name = "N", default_value_t = 20)]
    last: usize,
    /// Print one complete record per line, as JSON.
    #[arg(long)]
    json: bool,
    /// Delete old records. Of each pipeline, the latest ones stay, and the latest complete one that did some work.
    #[arg(long, conflicts_with = "json")]
    prune: bool,
    /// Number of records of each pipeline that --prune keeps.
    #[arg(long, value_name = "N", default_value_t = 50, requires = "prune")]
    keep: usize,
}

/// Arguments of `diff`.
#[derive(Args)]
#[command(after_help = "Example: tauflow diff 20261125-074105 20261125-081530\n\n`tauflow runs` lists the ids.")]
pub(crate) struct DiffArgs {
    /// Id of a run, or the beginning of it.
    run: String,
    /// Id of the run to compare with. Default: the latest run of the same pipeline.
    other: Option<String>,
    /// Print every cell, and the differences that cannot be told from 0, too.
    #[arg(long)]
    all: bool,
    /// Print the complete comparison as JSON.
    #[arg(long)]
    json: bool,
}

impl From<RunsError> for CliError {
    fn from(error: RunsError) -> Self {
        match error {
            RunsError::Io { .. } => Self::Environment(error.to_string()),
            RunsError::Unknown(message) => Self::Bad(message),
        }
    }
}

/// The records of the cache; damaged ones are named.
pub(super) fn records(cache: &CacheAt) -> Result<Vec<RunRecord>, CliError> {
    let (records, damaged) = runs::read_all(&cache.folder())?;
    damaged.iter().for_each(|damaged| errln!("warning: {damaged}"));
    Ok(records)
}

pub(crate) fn runs(args: &RunsArgs, cache: &CacheAt) -> Result<Exit, CliError> {
    cache.look()?; // a path that is no cache is an error
    let mut records = records(cache)?;
    if let Some(wanted) = &args.pipeline {
        let is_pipeline = records.iter().any(|record| record.pipeline == *wanted);
        if let Some(record) = runs::find(&records, wanted).ok().filter(|_| !is_pipeline && !args.prune) {
            if args.json {
                outln!("{}", json!(record));
            } else {
                show_run(record);
            }
            return Ok(Exit::Done);
        }
        records = runs::of_pipeline(records, wanted)?;
    }
    if args.prune {
        let gone = runs::superfluous(&records, args.keep);
        runs::prune(&cache.folder(), &gone)?;
        let (deleted, kept) = (counted(gone.len() as u64, "record"), records.len() - gone.len());
        outln!("deleted {deleted} of runs, kept {kept}");
        return Ok(Exit::Done);
    }
    let left_out = records.len().saturating_sub(args.last);
    let shown = &records[left_out..];
    if args.json {
        for record in shown {
            outln!("{}", json!(record));
        }
        return Ok(Exit::Done);
    }
    if shown.is_empty() {
        errln!("no runs are recorded in {}", cache.folder().display());
        return Ok(Exit::Done);
    }
    let heads = ["run", "date (UTC)", "pipeline", "outcome", "ran", "as before", "failed", "made", "elapsed"];
    let mut rows = vec![heads.map(str::to_owned).to_vec()];
    rows.extend(shown.iter().map(row));
    out!("{}", table(&rows));
    if left_out > 0 {
        errln!("{} not shown; show more with --last {}", counted(left_out as u64, "earlier run"), records.len());
    }
    Ok(Exit::Done)
}

/// Failures that are shown of a run.
const MOST_FAILURES: usize = 10;

/// One run in full, but for its params and digests, which `--json` prints.
fn show_run(record: &RunRecord) {
    let profile = if record.overrides.is_empty() { "none".to_owned() } else { record.overrides.join("  ") };
    let commit = record.commit.as_deref().unwrap_or("none");
    for (name, value) in [
        ("run", record.id.clone()),
        ("date", format!("{} UTC, took {}", date_text(record.started), seconds_text(record.elapsed_s))),
        ("outcome", record.outcome.text().to_owned()),
        ("pipeline", format!("{}, {}", record.pipeline, record.file.display())),
        ("command", record.command.join(" ")),
        ("overrides", profile),
        ("version", format!("tauflow {}, commit {commit}", record.version)),
        ("machine", format!("{}, {} threads", record.machine.host, record.machine.threads)),
    ] {
        outln!("{name:9}  {value}");
    }
    if let Some(error) = &record.error {
        outln!("{:9}  {error}", "error");
    }
    let heads = ["node", "ran", "as before", "failed", "time", "made"];
    let mut rows = vec![heads.map(str::to_owned).to_vec()];
    rows.extend(record.nodes.iter().map(|node| {
        let time = if node.ran == 0 { String::new() } else { seconds_text(node.spent_s) };
        let counts = [node.ran, node.hit, node.failed].map(|count| count.to_string());
        let [ran, hit, failed] = counts;
        vec![node.node.clone(), ran, hit, failed, time, bytes_text(node.written)]
    }));
    out!("\n{}", table(&rows));
    for failure in record.failures.iter().take(MOST_FAILURES) {
        outln!("failed: {}: {}", failure.only(), failure.message);
    }
    outln!("\nparams and digests of outputs: tauflow runs {} --json", record.id);
}

fn row(record: &RunRecord) -> Vec<String> {
    vec![
        record.id.clone(),
        date_text(record.started),
        record.pipeline.clone(),
        record.outcome.text().to_owned(),
        record.total(|node| node.ran).to_string(),
        record.total(|node| node.hit).to_string(),
        record.failed.to_string(),
        bytes_text(record.total(|node| node.written)),
        seconds_text(record.elapsed_s),
    ]
}

pub(crate) fn diff(args: &DiffArgs, cache: &CacheAt) -> Result<Exit, CliError> {
    let store = cache.look()?;
    let records = records(cache)?;
    if records.is_empty() {
        return Err(CliError::Bad("no run is recorded in this cache; run a pipeline first".into()));
    }
    let before = runs::find(&records, &args.run)?;
    let after = match &args.other {
        Some(other) => runs::find(&records, other)?,
        None => {
            let ended =
                |record: &RunRecord| !matches!(record.outcome, Outcome::Running | Outcome::Killed | Outcome::Error);
            let latest = records.iter().rfind(|record| record.pipeline == before.pipeline && ended(record));
            let latest = latest.unwrap_or(before);
            if latest.id == before.id {
                return Err(CliError::Bad(format!(
                    "run `{}` is the latest run of `{}`; name a second run, as in `tauflow diff OTHER {}`",
                    before.id, before.pipeline, before.id
                )));
            }
            latest
        }
    };
    let found = runs::compare(before, after, &store)?;
    if args.json {
        outln!("{}", json!({ "before": before.id, "after": after.id, "comparison": found }));
    } else {
        show(before, after, &found, args.all);
    }
    Ok(Exit::Done)
}

fn show(before: &RunRecord, after: &RunRecord, found: &Comparison, all: bool) {
    for (name, record) in [("before", before), ("after", after)] {
        let commit = record
            .commit
            .as_ref()
            .map_or_else(String::new, |hash| format!(", commit {}", hash.chars().take(10).collect::<String>()));
        let options: String = record.overrides.iter().map(|option| format!(" {option}")).collect();
        outln!(
            "{name:6}  {}  {}  {}{options}; tauflow {}{commit}; {} ({} threads)",
            record.id,
            record.pipeline,
            record.outcome.text(),
            record.version,
            record.machine.host,
            record.machine.threads
        );
    }
    let value = |value: &Option<Value>| value.as_ref().map_or_else(|| "not set".to_owned(), Value::to_string);
    match found.params.len() {
        0 => outln!("\nparams: equal"),
        count => outln!("\nparams: {count} different"),
    }
    let changes = found.params.iter().map(|change| {
        let text = format!("{} -> {}", value(&change.before), value(&change.after));
        (change.name.as_str(), text)
    });
    show_by_cell(changes, all);
    outln!("\noutputs: {} equal, {} different", found.equal_outputs, found.outputs.len());
    let changes = found.outputs.iter().map(|change| {
        let why = if change.bitwise { "" } else { "  (machine-dependent or measured)" };
        // Several cells share only how they changed.
        let text = match !all && cell_of(&change.name).is_some() {
            true => format!("different{why}"),
            false => format!("{} -> {}{why}", change.before.short(), change.after.short()),
        };
        (change.name.as_str(), text)
    });
    show_by_cell(changes, all);
    for (run, only) in [("before", &found.only_before), ("after", &found.only_after)] {
        let told = format!("only {run}; the other run did not make it or need it");
        show_by_cell(only.iter().map(|name| (name.as_str(), told.clone())), all);
    }
    for name in &found.unknown_outputs {
        outln!("  {name}: not compared, because it is incomplete in one of the runs");
    }
    show_metrics(found, all);
    let ran = |time: &&runs::TimeChange| time.ran.0 + time.ran.1 > 0;
    let mut rows = vec![["node", "ran before", "ran after", "before", "after"].map(str::to_owned).to_vec()];
    rows.extend(found.times.iter().filter(ran).map(|time| {
        let counts = [time.ran.0, time.ran.1].map(|count| count.to_string());
        let seconds = |count: u64, time: f64| if count == 0 { String::new() } else { seconds_text(time) };
        let [was, is] = counts;
        vec![time.node.clone(), was, is, seconds(time.ran.0, time.before), seconds(time.ran.1, time.after)]
    }));
    if rows.len() > 1 {
        outln!("\ntimes of the actions that ran:\n{}", table(&rows).trim_end());
    }
}

/// The cell in a name such as `node[axis=value].param`, and the name without it.
fn cell_of(name: &str) -> Option<(&str, String)> {
    let (node, rest) = name.split_once('[')?;
    let (cell, rest) = rest.split_once(']')?;
    Some((cell, format!("{node}{rest}")))
}

/// Changes by name. Cells of a node that changed alike are one line.
fn show_by_cell<'n>(changes: impl Iterator<Item = (&'n str, String)>, all: bool) {
    let mut lines: Vec<(String, String, Vec<&str>)> = Vec::new();
    for (name, change) in changes {
        match cell_of(name).filter(|_| !all) {
            Some((cell, short)) => match lines.iter_mut().find(|line| line.0 == short && line.1 == change) {
                Some(line) => line.2.push(cell),
                None => lines.push((short, change, vec![cell])),
            },
            None => lines.push((name.to_owned(), change, Vec::new())),
        }
    }
    for (name, change, cells) in lines {
        match cells[..] {
            [] => outln!("  {name}: {change}"),
            [cell] => outln!("  {name} [{cell}]: {change}"),
            [..] => outln!("  {name} ({} cells): {change}", cells.len()),
        }
    }
}

fn show_metrics(found: &Comparison, all: bool) {
    let mut repeated: Vec<(&str, Vec<&str>)> = Vec::new();
    for (output, other) in &found.repeated_metrics {
        match repeated.iter_mut().find(|(of, _)| of == other) {
            Some((_, outputs)) => outputs.push(output),
            None => repeated.push((other, vec![output])),
        }
    }
    for (output, why) in &found.without_metrics {
        outln!("\nmetrics of {output}: not compared, because {why}");
    }
    let mut outputs: Vec<&str> = found.metrics.iter().map(|change| change.output.as_str()).collect();
    outputs.dedup();
    for output in outputs {
        let changes: Vec<&MetricChange> = found.metrics.iter().filter(|change| change.output == output).collect();
        // A single item has no interval: any difference is shown.
        let clear = |change: &&&MetricChange| change.difference.low > 0.0 || change.difference.high < 0.0;
        let shown: Vec<&MetricChange> = changes.iter().filter(|change| all || clear(change)).copied().collect();
        outln!("\nmetrics of {output}, after less before, with 95% intervals over the shared items:");
        if let Some((_, outputs)) = repeated.iter().find(|(of, _)| *of == output) {
            let (name, more) = (outputs[0], outputs.len() - 1);
            let more = if more > 0 { format!(" and {}", counted(more as u64, "other output")) } else { String::new() };
            outln!("(the scores of {name}{more} are among them)");
        }
        if let Some(rows) = found.rows.iter().find(|rows| rows.output == output) {
            rows_told(rows, all);
        }
        if !shown.is_empty() {
            let heads = ["row", "metric", "items", "before", "after", "difference", "interval"];
            let mut rows = vec![heads.map(str::to_owned).to_vec()];
            rows.extend(shown.iter().map(|change| metric_row(change)));
            out!("{}", table(&rows));
        }
        let hidden = changes.len() - shown.len();
        if hidden > 0 {
            outln!("{hidden} of {} differences cannot be told from 0; --all prints them, too", changes.len());
        }
    }
}

/// Rows that only one of the runs has, which have no difference.
const MOST_ROWS: usize = 4;

fn rows_told(rows: &RowCounts, all: bool) {
    let both = rows.equal + rows.different;
    outln!("rows in both runs: {both}, of which {} have equal scores", rows.equal);
    for (run, only) in [("before", &rows.only_before), ("after", &rows.only_after)] {
        let shown = if all { only.len() } else { only.len().min(MOST_ROWS) };
        let more = if shown < only.len() { format!(" and {} more", only.len() - shown) } else { String::new() };
        if !only.is_empty() {
            outln!("only {run}: {}{more}", only[..shown].join("; "));
        }
    }
}

fn metric_row(change: &MetricChange) -> Vec<String> {
    vec![
        change.figure.clone(),
        change.metric.clone(),
        change.items.to_string(),
        format!("{:.4}", change.before),
        format!("{:.4}", change.after),
        format!("{:+.4}", change.difference.mean),
        match has_intervals(change.items, None) {
            true => format!("[{:+.4}, {:+.4}]", change.difference.low, change.difference.high),
            false => "none".to_owned(),
        },
    ]
}
