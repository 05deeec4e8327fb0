//! `tauflow check`, `graph`, `kinds` and `schema`. Only `graph` looks at the cache, for the times that an SVG shows.

use super::{CacheAt, CliError, Exit, PipelineArgs, counted, seconds_text};
use crate::{
    engine::{self, event::NodeStat},
    kinds::Registry,
    pipeline::{
        Pipeline,
        chart::{Chart, Look, Note},
        draw, schema as pipeline_schema, schema_check,
    },
};
use clap::{Args, ValueEnum};
use std::{collections::BTreeMap, fmt::Write as _, fs, path::PathBuf};
use tauflow_contract::{Determinism, Mode, NodeKind, Takes};

/// Arguments of `graph`.
#[derive(Args)]
pub(crate) struct GraphArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// Output format. An SVG names the ports, and shows the times of the results in the cache.
    #[arg(long, value_enum, default_value_t = GraphFormat::Dot)]
    format: GraphFormat,
}

#[derive(Clone, Copy, ValueEnum)]
enum GraphFormat {
    Dot,
    Mermaid,
    Svg,
}

/// Arguments of `kinds`.
#[derive(Args)]
pub(crate) struct KindsArgs {
    /// Print the manual of this kind.
    kind: Option<String>,
    /// Write one page per kind to this directory.
    #[arg(long, value_name = "DIR")]
    markdown: Option<PathBuf>,
}

pub(crate) fn check(args: &PipelineArgs, registry: &Registry) -> Result<Exit, CliError> {
    let pipeline = args.check(registry)?;
    outln!("{}: no problems; {} nodes, {} cells", args.pipeline.display(), pipeline.nodes.len(), pipeline.cells.len());
    Ok(Exit::Done)
}

pub(crate) fn graph(args: &GraphArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    let pipeline = args.pipeline.resolve(registry)?;
    let text = match args.format {
        GraphFormat::Dot => draw::draw(&pipeline, draw::Format::Dot),
        GraphFormat::Mermaid => draw::draw(&pipeline, draw::Format::Mermaid),
        GraphFormat::Svg => Chart::new(&pipeline).svg(&notes(&pipeline, cache)?),
    };
    outln!("{}", text.trim_end());
    Ok(Exit::Done)
}

/// The cached results of each node, and the time that they took; nothing if there is no cache.
fn notes(pipeline: &Pipeline, cache: &CacheAt) -> Result<BTreeMap<String, Note>, CliError> {
    if !cache.folder().is_dir() {
        return Ok(BTreeMap::new());
    }
    let plan = engine::plan(pipeline, &cache.look()?, None)?;
    let note = |node: &NodeStat| {
        let stale = node.ran + node.blocked + node.failed;
        let look = if stale == 0 && !node.unknown && node.hit > 0 { Look::Done } else { Look::Waiting };
        let time = seconds_text(node.wall_s);
        let text = match (node.hit, stale) {
            (0, _) => "stale".to_owned(),
            (hit, 0) if !node.unknown => format!("{}, {time}", counted(hit, "result")),
            (hit, _) => format!("{} of more, {time}", counted(hit, "result")),
        };
        Note { text, look }
    };
    Ok(plan.summary.nodes.iter().filter(|n| n.lanes > 0).map(|n| (n.node.clone(), note(n))).collect())
}

pub(crate) fn schema(registry: &Registry) -> Result<Exit, CliError> {
    let schema = pipeline_schema::schema(registry);
    outln!("{}", serde_json::to_string_pretty(&schema).expect("a schema is plain data"));
    Ok(Exit::Done)
}

pub(crate) fn kinds(args: &KindsArgs, registry: &Registry) -> Result<Exit, CliError> {
    if let Some(folder) = &args.markdown {
        let failed = |e| CliError::Environment(format!("cannot write into {}: {e}", folder.display()));
        fs::create_dir_all(folder).map_err(failed)?;
        for kind in registry.iter() {
            fs::write(folder.join(format!("{}.md", kind.spec().name)), page(kind.as_ref())).map_err(failed)?;
        }
        return Ok(Exit::Done);
    }
    if let Some(name) = &args.kind {
        let kind = registry
            .get(name)
            .ok_or_else(|| CliError::Bad(format!("unknown kind `{name}`; {}", registry.hint(name))))?;
        out!("{}", page(kind.as_ref()));
        return Ok(Exit::Done);
    }
    let rows: Vec<String> =
        registry.iter().map(|kind| kind.spec()).map(|spec| format!("{:24} {}", spec.name, spec.summary)).collect();
    outln!("{}", rows.join("\n"));
    Ok(Exit::Done)
}

/// The page of a kind, in Markdown: manual, ports, params.
pub fn page(kind: &dyn NodeKind) -> String {
    let spec = kind.spec();
    let manual = spec.manual.trim();
    let heading = format!("# {}", spec.name);
    let mut out = String::new();
    if !manual.starts_with(&heading) {
        let _ = writeln!(out, "{heading}\n");
    }
    let mode = match spec.mode {
        Mode::Source => "source: lists its own items",
        Mode::Map => "map: one action per item",
        Mode::Gather => "gather: one action on whole collections",
    };
    let groups = spec.groups();
    let versions = match &groups[..] {
        [only] => only.version.to_string(),
        several => several.iter().map(|g| format!("{} of `{}`", g.version, g.name)).collect::<Vec<_>>().join(", "),
    };
    if groups.is_empty() {
        let deciding = kind.port_params().join("`, `");
        let _ = writeln!(out, "{manual}\n\n## Ports\n\nThe params `{deciding}` determine the ports.");
    } else {
        let _ = writeln!(out, "{manual}\n\n## Ports\n\nVersion {versions}; {mode}.\n");
    }
    let mut rows = vec![["port", "direction", "media type", "description"].map(str::to_owned).to_vec()];
    for port in &spec.inputs {
        let takes = if port.takes == Takes::Item { "by item" } else { "all" };
        let optional = if port.optional { ", optional" } else { "" };
        rows.push(vec![port.name.into(), format!("input, {takes}{optional}"), port.media.into(), port.doc.into()]);
    }
    for port in &spec.outputs {
        let mut notes = vec!["output"];
        if port.filter {
            notes.push("filter");
        }
        match port.determinism {
            Determinism::Bitwise => {}
            Determinism::Local => notes.push("machine-dependent"),
            Determinism::Measured => notes.push("measured"),
        }
        if port.publish {
            notes.push("published");
        }
        rows.push(vec![port.name.into(), notes.join(", "), port.media.into(), port.doc.into()]);
    }
    if rows.len() > 1 {
        out += &markdown(&rows);
    }
    let schema = kind.params_schema();
    let params = schema_check::params(&schema);
    if !params.is_empty() {
        out += "\n## Params\n\n";
        let defaults = kind.resolve(&serde_json::json!({})).ok();
        let mut rows = vec![["param", "default", "type", "description"].map(str::to_owned).to_vec()];
        for name in params {
            let Some(param) = schema["properties"].get(name) else { continue };
            // Where one param must be given, nothing resolves without it.
            let default = defaults.as_ref().and_then(|d| d.get(name)).or_else(|| param.get("default"));
            let default = default.map(|v| format!("`{v}`")).unwrap_or_default();
            let doc = param["description"].as_str().unwrap_or_default().replace('\n', " ");
            rows.push(vec![format!("`{name}`"), default, schema_check::describe(&schema, param), doc]);
        }
        out += &markdown(&rows);
    }
    out
}

fn markdown(rows: &[Vec<String>]) -> String {
    let line = |row: &Vec<String>| {
        format!("| {} |\n", row.iter().map(|c| c.replace('|', "\\|")).collect::<Vec<_>>().join(" | "))
    };
    let Some((head, body)) = rows.split_first() else { return String::new() };
    let mut out = line(head);
    out += &format!("|{}\n", "---|".repeat(head.len()));
    body.iter().for_each(|row| out += &line(row));
    out
}
