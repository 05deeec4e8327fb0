//! `tauflow explain`.

use super::{CacheAt, CliError, Exit, PipelineArgs, seconds_text};
use crate::{
    engine::{
        Only,
        explain::{Nearest, Reason},
    },
    kinds::Registry,
    query::{self, Explained, Explanation, Why},
};
use clap::Args;
use serde_json::Value;
use tauflow_contract::Resources;

/// Arguments of `explain`.
#[derive(Args)]
pub(crate) struct ExplainArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// The node to explain.
    node: String,
    /// The item, `cell`, or `cell/item`.
    item: Option<String>,
}

pub(crate) fn explain(args: &ExplainArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    let pipeline = args.pipeline.resolve(registry)?;
    let text = args.item.as_ref().map_or_else(|| args.node.clone(), |item| format!("{}/{item}", args.node));
    let only = Only::parse(&text, &pipeline).map_err(CliError::Bad)?;
    match query::explain(&pipeline, &cache.look()?, &only)? {
        Explanation::Waits(nodes) => outln!(
            "`{text}` cannot be explained before {} has run; see `tauflow plan {}`",
            if nodes.is_empty() { "what it reads".to_owned() } else { nodes.join(", ") },
            args.pipeline.again()
        ),
        Explanation::One(action) => in_full(&action),
        Explanation::Several(groups) => {
            for group in &groups {
                outln!("{} x {}", group.names.len(), group.why);
                let shown: Vec<&str> = group.names.iter().take(4).map(String::as_str).collect();
                outln!("    {}{}", shown.join("  "), if group.names.len() > 4 { "  ..." } else { "" });
            }
            outln!("\nfor details of an item: tauflow explain {} {} ITEM", args.pipeline.again(), args.node);
        }
    }
    Ok(Exit::Done)
}

fn in_full(action: &Explained) {
    let key = &action.key;
    let basis = &key.basis;
    outln!("{} {}", action.cell, action.name);
    match action.why {
        Why::Runs(Reason::Undecided) => outln!("key        unknown"),
        _ => outln!("key        {}", key.hash().hex()),
    }
    outln!("kind       {}", basis.kind);
    outln!("group      {} version {}", basis.group, basis.version);
    outln!("format     {}", basis.format);
    if let Some(seed) = basis.seed {
        outln!("seed       {seed}");
    }
    for (port, digest) in &key.inputs {
        outln!("input      {port} = {digest}");
    }
    if let Value::Object(params) = &basis.params {
        for (param, value) in params {
            outln!("param      {param} = {value}");
        }
    }
    match &basis.environment {
        Value::Null => {}
        Value::Object(fields) => fields.iter().for_each(|(field, value)| outln!("machine    {field} = {value}")),
        other => outln!("machine    {other}"),
    }
    if action.resources != Resources::default() {
        outln!("resources  {}, as a job", action.resources);
    }
    match (&action.why, &action.nearest) {
        (Why::Done, _) => outln!("\nup to date: no input has changed"),
        (Why::Runs(Reason::Undecided), _) => outln!("\n{}", Reason::Undecided),
        (Why::Runs(_), None) => outln!("\nruns: this kind has never run"),
        (Why::Runs(reason), Some(nearest)) => {
            outln!("\nruns: {reason}");
            differences(nearest);
        }
    }
}

fn differences(nearest: &Nearest) {
    let took = seconds_text(nearest.record.wall_us as f64 / 1e6);
    outln!("most similar earlier key {} (took {took})", nearest.record.key.short());
    let show = |value: &Option<Value>| value.as_ref().map_or("(absent)".into(), ToString::to_string);
    for difference in &nearest.differences {
        let (before, now) = (show(&difference.before), show(&difference.now));
        outln!("  {}\n    before {before}\n    now    {now}", difference.field);
    }
}
