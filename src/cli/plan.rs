//! `tauflow plan`.

use super::{CacheAt, CliError, Exit, PipelineArgs, bytes_text, seconds_text, table};
use crate::{
    kinds::Registry,
    query::{self, NodePlan},
};

pub(crate) fn plan(args: &PipelineArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    let pipeline = args.resolve(registry)?;
    let plan = query::plan(&pipeline, &cache.look()?)?;
    let heads = ["node", "as before", "to run", "blocked", "expected", "size"];
    let mut rows = vec![heads.map(str::to_owned).to_vec()];
    rows.extend(plan.nodes.iter().map(row));
    out!("{}", table(&rows));
    if plan.is_empty() {
        outln!("nothing to do");
        return Ok(Exit::Done);
    }
    outln!("\nwhy:");
    for node in &plan.nodes {
        let mut lines: Vec<(String, u64)> = node.reasons.iter().map(|(why, count)| (why.to_string(), *count)).collect();
        lines.sort();
        lines.iter().for_each(|(why, count)| outln!("  {}: {count} x {why}", node.node));
    }
    let more = if plan.is_partial() { ", and what is not known before something else has run" } else { "" };
    outln!(
        "\nexpected: {} of work and {} of results, from earlier runs{more}",
        seconds_text(plan.total.seconds),
        bytes_text(plan.total.bytes as u64)
    );
    Ok(Exit::Done)
}

fn row(node: &NodePlan) -> Vec<String> {
    let blocked = if node.undecided > 0 {
        format!("{} unknown", node.undecided)
    } else if node.open {
        "not known yet".to_owned()
    } else if node.waiting > 0 {
        format!("{} waiting", node.waiting)
    } else {
        String::new()
    };
    let (expected, size) = match node.cost {
        _ if node.to_run == 0 => (String::new(), String::new()),
        Some(cost) => (seconds_text(cost.seconds), bytes_text(cost.bytes as u64)),
        None => ("not known".into(), "not known".into()),
    };
    vec![node.node.clone(), node.as_before.to_string(), node.to_run.to_string(), blocked, expected, size]
}
