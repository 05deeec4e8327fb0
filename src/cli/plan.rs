//! `tauflow plan`.

use super::{CacheAt, CliError, Exit, PipelineArgs, bytes_text, seconds_text, table};
use crate::{
    engine::{
        self,
        event::Ended,
        explain::{History, reason},
    },
    kinds::Registry,
};
use std::collections::BTreeMap;

pub(crate) fn plan(args: &PipelineArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    let pipeline = args.resolve(registry)?;
    let store = cache.open()?;
    let plan = engine::plan(&pipeline, &store, None)?;
    let mut histories: BTreeMap<String, History> = BTreeMap::new();
    let mut reasons: BTreeMap<usize, BTreeMap<String, u64>> = BTreeMap::new();
    for action in plan.would_run.iter().filter(|a| a.ended == Ended::WouldRun) {
        let kind = &action.key.kind;
        let history = histories.entry(kind.clone()).or_insert_with(|| History::of(&store, kind));
        let why = reason(history.nearest(&action.key).as_ref());
        *reasons.entry(action.node).or_default().entry(why).or_insert(0) += 1;
    }
    let costs = store.record_stats().remove(engine::ACTION).unwrap_or_default();
    let heads = ["node", "as before", "to run", "blocked", "expected", "size"];
    let mut rows = vec![heads.map(str::to_owned).to_vec()];
    let (mut total, mut size, mut partial) = (0.0, 0.0, false);
    let mut lines = Vec::new();
    for (index, node) in plan.summary.nodes.iter().enumerate().filter(|(_, n)| n.lanes > 0) {
        let waits = node.blocked > 0 || node.unknown;
        let (expected, makes) = match costs.get(&node.kind) {
            _ if node.ran == 0 => (String::new(), String::new()),
            Some(of) if of.count > 0 => {
                let (seconds, bytes) = (of.wall_us as f64 / 1e6, of.bytes as f64);
                let share = node.ran as f64 / of.count as f64;
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
        let blocked = if node.unknown {
            "not known yet".to_owned()
        } else if node.blocked > 0 {
            format!("{} waiting", node.blocked)
        } else {
            String::new()
        };
        rows.push(vec![node.node.clone(), node.hit.to_string(), node.ran.to_string(), blocked, expected, makes]);
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
