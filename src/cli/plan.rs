//! `tauflow plan`.

use super::{CacheAt, CliError, Exit, PipelineArgs, bytes_text, seconds_text, table};
use crate::{
    engine::{
        self,
        event::Ended,
        explain::{History, UNKNOWN, reason},
    },
    kinds::Registry,
};
use std::collections::BTreeMap;

pub(crate) fn plan(args: &PipelineArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    let pipeline = args.resolve(registry)?;
    let store = cache.look()?;
    let plan = engine::plan(&pipeline, &store, None)?;
    let mut histories: BTreeMap<String, History> = BTreeMap::new();
    let mut reasons: BTreeMap<usize, BTreeMap<String, u64>> = BTreeMap::new();
    let mut unknown: BTreeMap<usize, u64> = BTreeMap::new();
    for action in plan.would_run.iter().filter(|a| a.ended == Ended::WouldRun) {
        if action.unknown {
            *unknown.entry(action.node).or_default() += 1;
            *reasons.entry(action.node).or_default().entry(UNKNOWN.into()).or_insert(0) += 1;
            continue;
        }
        let kind = &action.key.basis.kind;
        let history = histories.entry(kind.to_string()).or_insert_with(|| History::of(&store, kind));
        let why = reason(history.nearest(&action.key).as_ref());
        *reasons.entry(action.node).or_default().entry(why).or_insert(0) += 1;
    }
    let costs = store.record_stats().remove(engine::ACTION).unwrap_or_default();
    let heads = ["node", "as before", "to run", "blocked", "expected", "size"];
    let mut rows = vec![heads.map(str::to_owned).to_vec()];
    let (mut total, mut size, mut partial) = (0.0, 0.0, false);
    let mut lines = Vec::new();
    for (index, node) in plan.summary.nodes.iter().enumerate().filter(|(_, n)| n.lanes > 0) {
        let unasked = unknown.get(&index).copied().unwrap_or(0);
        let to_run = node.ran.saturating_sub(unasked);
        let waits = node.blocked > 0 || node.unknown || unasked > 0;
        let (expected, makes) = match costs.get(&node.kind) {
            _ if to_run == 0 => (String::new(), String::new()),
            Some(of) if of.count > 0 => {
                let (seconds, bytes) = (of.wall_us as f64 / 1e6, of.bytes as f64);
                let share = to_run as f64 / of.count as f64;
                total += seconds * share;
                size += bytes * share;
                (seconds_text(seconds * share), bytes_text((bytes * share) as u64))
            }
            _ => {
                partial = true;
                ("not known".into(), "not known".into())
            }
        };
        partial |= waits;
        let blocked = if unasked > 0 {
            format!("{unasked} unknown")
        } else if node.unknown {
            "unknown".to_owned()
        } else if node.blocked > 0 {
            format!("{} waiting", node.blocked)
        } else {
            String::new()
        };
        rows.push(vec![node.node.clone(), node.hit.to_string(), to_run.to_string(), blocked, expected, makes]);
        for (why, count) in reasons.get(&index).into_iter().flatten() {
            lines.push(format!("  {}: {count} x {why}", node.node));
        }
    }
    out!("{}", table(&rows));
    if lines.is_empty() && !partial {
        outln!("nothing to do");
        return Ok(Exit::Done);
    }
    outln!("\nwhy:");
    lines.iter().for_each(|line| outln!("{line}"));
    let more = if partial { ", and what is not known before something else has run" } else { "" };
    outln!(
        "\nexpected: {} of work and {} of results, from earlier runs{more}",
        seconds_text(total),
        bytes_text(size as u64)
    );
    Ok(Exit::Done)
}
