//! `tauflow status`: which runs are going, from another terminal. Reads only what the running processes write.

use super::{CacheAt, CliError, Exit, counted, output::Redrawn, seconds_text, table, terminal};
use crate::runs::{self, LiveAction, LiveNode, LiveState, Outcome, RunRecord, Standing};
use clap::Args;
use serde_json::json;
use std::{fmt::Write as _, io::IsTerminal, thread, time::Duration};

/// How often `--watch` looks.
const EVERY: Duration = Duration::from_secs(1);
/// Actions and failures that are shown of each run.
const MOST_SHOWN: usize = 8;
/// Nodes that are shown even if they are done.
const MOST_NODES: usize = 12;
/// Killed runs that are shown.
const MOST_KILLED: usize = 3;

/// Arguments of `status`.
#[derive(Args)]
#[command(after_help = "Example: tauflow status --watch pipelines/quickstart.yaml")]
pub(crate) struct StatusArgs {
    /// Show only the runs of this pipeline: its name or its file.
    pipeline: Option<String>,
    /// Show the status again every second, until no run is going.
    #[arg(long)]
    watch: bool,
    /// Print one run per line, as JSON.
    #[arg(long)]
    json: bool,
}

/// A run that has not ended by itself.
struct Open {
    record: RunRecord,
    state: Option<LiveState>,
}

/// The information to show.
struct Found {
    open: Vec<Open>,
    /// The latest run that ended by itself.
    last: Option<RunRecord>,
}

impl Found {
    fn going(&self) -> impl Iterator<Item = &Open> {
        self.open.iter().filter(|open| open.record.outcome == Outcome::Running)
    }
}

pub(crate) fn status(args: &StatusArgs, cache: &CacheAt) -> Result<Exit, CliError> {
    if !cache.folder().is_dir() {
        return Err(CliError::Bad(format!(
            "there is no cache at {}; name that of the run with --cache",
            cache.folder().display()
        )));
    }
    let redraw = args.watch && !args.json && terminal::redraws() && std::io::stdout().is_terminal();
    let mut redrawn = Redrawn::default();
    loop {
        let found = find(args, cache)?;
        let text = if args.json { as_json(&found) } else { as_text(&found, cache) };
        if redraw {
            redrawn.show(&text);
        } else if args.watch && !args.json {
            outln!("{text}");
        } else {
            out!("{text}");
        }
        if !args.watch || found.going().next().is_none() {
            return Ok(Exit::Done);
        }
        thread::sleep(EVERY);
    }
}

fn find(args: &StatusArgs, cache: &CacheAt) -> Result<Found, CliError> {
    let mut records = super::runs::records(cache)?;
    if let Some(wanted) = &args.pipeline {
        records = runs::of_pipeline(records, wanted)?;
    }
    let is_open = |record: &RunRecord| matches!(record.outcome, Outcome::Running | Outcome::Killed);
    let last = records.iter().rfind(|record| !is_open(record)).cloned();
    // A killed run is not shown if a later run has done the same.
    let done_since = |record: &RunRecord| {
        let later = records.iter().rev().take_while(|other| other.id != record.id);
        let only = |other: &RunRecord| other.command.iter().any(|word| word.starts_with("--only"));
        let same = |other: &RunRecord| other.file == record.file && other.overrides == record.overrides;
        let mut later = later.filter(|other| other.pipeline == record.pipeline && same(other) && !only(other));
        record.outcome == Outcome::Killed && later.any(|other| other.outcome == Outcome::Done)
    };
    let open: Vec<RunRecord> = records.iter().filter(|of| is_open(of) && !done_since(of)).cloned().collect();
    let open = open.into_iter().map(|record| {
        let state = runs::state(&cache.folder(), &record);
        Open { record, state }
    });
    Ok(Found { open: open.collect(), last })
}

fn as_json(found: &Found) -> String {
    let line = |open: &Open| {
        let standing = open.state.as_ref().map(LiveState::standing);
        json!({ "run": open.record.id, "pipeline": open.record.pipeline, "outcome": open.record.outcome,
            "standing": standing, "state": open.state })
    };
    found.open.iter().fold(String::new(), |all, open| all + &line(open).to_string() + "\n")
}

fn as_text(found: &Found, cache: &CacheAt) -> String {
    let mut out = String::new();
    let blocks: Vec<String> = found.going().map(going).collect();
    if blocks.is_empty() {
        let _ = writeln!(out, "no run is going in {}", cache.folder().display());
    }
    out += &blocks.join("\n");
    let killed: Vec<&Open> = found.open.iter().filter(|open| open.record.outcome == Outcome::Killed).collect();
    for open in &killed[killed.len().saturating_sub(MOST_KILLED)..] {
        let record = &open.record;
        let told = open.state.as_ref().map_or_else(String::new, |state| {
            let ran = counted(record.total(|node| node.ran), "action");
            format!(" after {}, with {ran} run (process {})", seconds_text(state.elapsed_s), state.process.pid)
        });
        let _ = writeln!(out, "run {} of {} was killed{told}; its results so far are kept", record.id, record.pipeline);
    }
    if blocks.is_empty()
        && let Some(last) = &found.last
    {
        let (id, pipeline, outcome) = (&last.id, &last.pipeline, last.outcome.text());
        let _ = writeln!(out, "last run: {id} of {pipeline}: {outcome} after {}", seconds_text(last.elapsed_s));
    }
    out
}

fn going(open: &Open) -> String {
    let Open { record, state } = open;
    let Some(state) = state else {
        return format!("run {} of {}: begins\n", record.id, record.pipeline);
    };
    let mut out = format!("run {} of {}: ", record.id, record.pipeline);
    let place = format!("process {} on {}", state.process.pid, state.process.host);
    let _ = match state.standing() {
        Standing::Silent => writeln!(
            out,
            "{place} has not written for {}; it may have ended",
            seconds_text(crate::engine::now().saturating_sub(state.written) as f64)
        ),
        Standing::Going | Standing::Gone => {
            writeln!(out, "going for {}, {place}", seconds_text(state.going_s()))
        }
    };
    let heads = ["node", "done", "running", "to do", "failed", "time"];
    let mut rows = vec![heads.map(str::to_owned).to_vec()];
    // What is done folds into one line if all of it would not fit a terminal of 24 rows.
    let is_done = |node: &&LiveNode| node.known && node.counts.expected == node.counts.done();
    let folds = state.nodes.len() > MOST_NODES;
    rows.extend(state.nodes.iter().filter(|node| !folds || !is_done(node)).map(row));
    out += &table(&rows);
    let folded = state.nodes.iter().filter(is_done).count();
    if folds && folded > 0 {
        let _ = writeln!(out, "{} done", counted(folded as u64, "node"));
    }
    if !state.running.is_empty() {
        out += "running:\n";
        let mut rows: Vec<Vec<String>> = state.running.iter().take(MOST_SHOWN).map(action).collect();
        let more = state.in_flight.saturating_sub(rows.len() as u64);
        if more > 0 {
            rows.push(vec![format!("  and {more} more")]);
        }
        out += &table(&rows);
    }
    if state.failed > 0 {
        let _ = writeln!(out, "failed: {}", counted(state.failed, "action"));
        for failure in state.failures.iter().take(MOST_SHOWN) {
            let first = failure.message.lines().next().unwrap_or_default();
            let _ = writeln!(out, "  {}: {first}", failure.only());
        }
    }
    out
}

fn row(node: &LiveNode) -> Vec<String> {
    let counts = &node.counts;
    let some = |n: u64| if n == 0 { String::new() } else { n.to_string() };
    let left = counts.expected.saturating_sub(counts.done()).saturating_sub(counts.running);
    let to_do = match (node.known, left) {
        (true, 0) => String::new(),
        (true, _) => left.to_string(),
        // More may follow.
        (false, 0) => "?".to_owned(),
        (false, _) => format!("{left}+"),
    };
    let time = if node.spent_s > 0.0 { seconds_text(node.spent_s) } else { String::new() };
    let failed = some(counts.failed + counts.blocked);
    vec![node.node.clone(), (counts.hit + counts.ran).to_string(), some(counts.running), to_do, failed, time]
}

fn action(action: &LiveAction) -> Vec<String> {
    let steps = if action.total > 0 { format!("{}/{}", action.done, action.total) } else { String::new() };
    vec![format!("  {}", action.name()), seconds_text(action.for_s), steps, action.message.clone()]
}
