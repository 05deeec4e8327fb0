//! `tauflow explain`.

use super::{CacheAt, CliError, Exit, PipelineArgs, seconds_text};
use crate::{
    diagnostics::nearest,
    engine::{
        self, Only,
        event::Ended,
        explain::{History, Planned, UNKNOWN, reason},
    },
    kinds::Registry,
    pipeline::Pipeline,
};
use clap::Args;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use tauflow_cache::Store;
use tauflow_contract::ItemKey;

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
    let store = cache.look()?;
    let plan = engine::plan(&pipeline, &store, Some(only.clone()))?;
    let mine: Vec<&Planned> = plan
        .would_run
        .iter()
        .filter(|p| p.node == only.node && only.cell.is_none_or(|c| c == p.cell))
        .filter(|p| only.item.is_none() || p.item == only.item)
        .collect();
    if mine.is_empty() {
        if let Some(item) = &only.item {
            there_is(item.as_str(), &Only { item: None, ..only.clone() }, &pipeline, &store)?;
        }
        let waits = plan.summary.nodes.iter().filter(|n| n.ran > 0).map(|n| n.node.as_str()).collect::<Vec<_>>();
        outln!(
            "`{text}` cannot be looked at before {} has run; see `tauflow plan {}`",
            if waits.is_empty() { "what it reads".to_owned() } else { waits.join(", ") },
            args.pipeline.again()
        );
        return Ok(Exit::Done);
    }
    let history = History::of(&store, &mine[0].key.basis.kind);
    if let [one] = &mine[..] {
        in_full(&pipeline, one, &history);
        return Ok(Exit::Done);
    }
    let mut groups: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for action in &mine {
        let why = match action.ended {
            Ended::WouldRun if action.unknown => UNKNOWN.to_owned(),
            Ended::WouldRun => format!("runs; {}", reason(history.nearest(&action.key).as_ref())),
            _ => "done before; nothing it reads has changed".into(),
        };
        groups.entry(why).or_default().push(name(&pipeline, action));
    }
    for (why, items) in &groups {
        outln!("{} x {why}", items.len());
        let shown: Vec<&str> = items.iter().take(4).map(String::as_str).collect();
        outln!("    {}{}", shown.join("  "), if items.len() > 4 { "  ..." } else { "" });
    }
    outln!("\nfor one in full: tauflow explain {} {} ITEM", args.pipeline.again(), args.node);
    Ok(Exit::Done)
}

/// Finds out whether the node's items are known and `item` is not among them.
fn there_is(item: &str, only: &Only, pipeline: &Pipeline, store: &Store) -> Result<(), CliError> {
    let plan = engine::plan(pipeline, store, Some(only.clone()))?;
    let mine = plan.would_run.iter().filter(|p| p.node == only.node && only.cell.is_none_or(|c| c == p.cell));
    let items: BTreeSet<&str> = mine.filter_map(|p| p.item.as_ref()).map(ItemKey::as_str).collect();
    if items.is_empty() || items.contains(item) {
        return Ok(());
    }
    let first = items.iter().next().map(|first| format!("items read like `{first}`"));
    let hint = nearest(item, items.iter().copied()).map(|near| format!("did you mean `{near}`?")).or(first);
    let node = &pipeline.nodes[only.node].name;
    Err(CliError::Bad(format!("`{node}` has no item `{item}`; {}", hint.unwrap_or_default())))
}

fn name(pipeline: &Pipeline, action: &Planned) -> String {
    let cell = &pipeline.cells[action.cell].text;
    let item = action.item.as_ref().map(ToString::to_string).unwrap_or_default();
    let parts = [cell.as_str(), item.as_str()];
    let text = parts.iter().filter(|p| !p.is_empty()).copied().collect::<Vec<_>>().join("/");
    let group = &action.key.basis.group;
    if group == "main" { text } else { format!("{text} ({group})") }
}

fn in_full(pipeline: &Pipeline, action: &Planned, history: &History) {
    let key = &action.key;
    let basis = &key.basis;
    outln!("{} {}", pipeline.cell_name(action.cell), name(pipeline, action));
    match action.unknown {
        true => outln!("key        unknown"),
        false => outln!("key        {}", key.hash().hex()),
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
    match action.ended {
        Ended::WouldRun if action.unknown => outln!("\n{UNKNOWN}"),
        Ended::WouldRun => match history.nearest(key) {
            None => outln!("\nruns: this kind was never run before"),
            Some(nearest) => {
                outln!("\nruns: {}", reason(Some(&nearest)));
                outln!(
                    "nearest earlier key {} (took {})",
                    nearest.record.key.short(),
                    seconds_text(nearest.record.wall_us as f64 / 1e6)
                );
                let show = |value: &Option<Value>| value.as_ref().map_or("(absent)".into(), ToString::to_string);
                for difference in &nearest.differences {
                    outln!(
                        "  {}\n    before {}\n    now    {}",
                        difference.field,
                        show(&difference.before),
                        show(&difference.now)
                    );
                }
            }
        },
        _ => outln!("\ndone before: nothing it reads has changed"),
    }
}
