//! `tauflow plan`.

use super::{CacheAt, CliError, Exit, PipelineArgs, bytes_text, seconds_text, table};
use crate::{
    kinds::Registry,
    query::{self, NodePlan},
};

pub(crate) fn plan(args: &PipelineArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    let pipeline = args.resolve(registry)?;
    let plan = query::plan(&pipeline, &cache.look()?)?;
    let heads = ["node", "as before", "to run", "may run", "time", "size"];
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
    let asking: Vec<&NodePlan> = plan.nodes.iter().filter(|node| asks(node)).collect();
    if !asking.is_empty() {
        outln!("\nresources of an action, where it runs as a job:");
        asking.iter().for_each(|node| outln!("  {}: {}", node.node, node.resources.join("; or ")));
    }
    let time = range(plan.total.seconds, plan.most.seconds, seconds_text);
    let size = range(plan.total.bytes, plan.most.bytes, |bytes| bytes_text(bytes as u64));
    let known = plan.most.seconds > 0.0 || plan.never.is_empty();
    if known {
        outln!("\nexpected: {time} of work and {size} of results, from earlier runs");
    } else {
        outln!("\nexpected: not known");
    }
    if known && plan.is_partial() {
        outln!("  the least counts the actions that are sure to run (less where ladders reuse samples);");
        outln!("  the most assumes that no output stays unchanged");
    }
    if !plan.never.is_empty() {
        outln!("  not counted, because the kind has never run: {}", plan.never.join(", "));
    }
    Ok(Exit::Done)
}

/// Whether a node's actions run, or may, and ask a scheduler for anything.
fn asks(node: &NodePlan) -> bool {
    node.to_run + node.may_run > 0 && !node.resources.is_empty()
}

/// One value, or the least and the most.
fn range(least: f64, most: f64, text: impl Fn(f64) -> String) -> String {
    let (from, to) = (text(least), text(most));
    if least == 0.0 && most > 0.0 {
        format!("up to {to}")
    } else if from == to {
        from
    } else {
        format!("{from} to {to}")
    }
}

fn row(node: &NodePlan) -> Vec<String> {
    let may_run = if node.undecided > 0 {
        format!("{} unknown", node.undecided)
    } else if node.may_run > 0 {
        format!("up to {}", node.may_run)
    } else {
        String::new()
    };
    let least = node.cost.unwrap_or_default();
    let (time, size) = match node.most {
        _ if node.to_run + node.may_run == 0 => (String::new(), String::new()),
        Some(most) => (
            range(least.seconds, most.seconds, seconds_text),
            range(least.bytes, most.bytes, |bytes| bytes_text(bytes as u64)),
        ),
        None => ("not known".into(), "not known".into()),
    };
    vec![node.node.clone(), node.as_before.to_string(), node.to_run.to_string(), may_run, time, size]
}
