//! `tauflow checkpoints`: the trained weights of a pipeline, listed and written as files.

use super::{CacheAt, CliError, Exit, PipelineArgs, bytes_text, counted, results::unread, runs::records, table};
use crate::{
    engine::{self, publish},
    ids::{Id, PortId},
    kinds::Registry,
    pipeline::Pipeline,
    query::{Reading, Selection},
    runs::RunRecord,
};
use clap::Args;
use serde_json::Value;
use std::{
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};
use tauflow_cache::Store;
use tauflow_contract::{Collection, Context, ItemKey, Media as _, Silent};
use tauflow_data::{
    records::{AdapterFile, ModelFile},
    tensors::TensorFile,
};

/// The name of each file.
const FILE: &str = "model.safetensors";

/// Arguments of `checkpoints`.
#[derive(Args)]
#[command(
    after_help = "Example: tauflow checkpoints pipelines/quickstart.yaml -o models\n\nFiles of the kind `training` \
    are models for `tauflow refine`. If a node is stale, the checkpoints of the latest run that has them are listed, \
    with the id of this run."
)]
pub(crate) struct CheckpointsArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// List only the checkpoints of this node.
    #[arg(long, value_name = "NODE")]
    node: Option<String>,
    /// Write them to this directory, as `NODE/CELL/model.safetensors`.
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// The weights that a cell trained.
struct Checkpoint {
    name: String,
    /// Below the directory of checkpoints.
    path: PathBuf,
    bytes: Vec<u8>,
    /// The run that made them, if the pipeline has changed since.
    of_run: Option<String>,
}

pub(crate) fn checkpoints(args: &CheckpointsArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    let pipeline = args.pipeline.resolve(registry)?;
    let wanted = match &args.node {
        Some(name) => Some(Selection::parse(name, &pipeline)?.node),
        None => None,
    };
    let ports: Vec<(usize, PortId)> = ports(&pipeline).filter(|(node, _)| wanted.is_none_or(|w| w == *node)).collect();
    if ports.is_empty() {
        let whose = args.node.as_ref().map_or_else(|| args.pipeline.again(), Clone::clone);
        return Err(CliError::Bad(format!("`{whose}` trains no model; kinds such as `training` do")));
    }
    let store = cache.look()?;
    let runs: Vec<RunRecord> = records(cache)?.into_iter().filter(|run| run.pipeline == pipeline.name).collect();
    let heads = ["checkpoint", "steps", "weights", "size", "state", "about"];
    let mut rows = vec![heads.map(str::to_owned).to_vec()];
    let (mut missing, mut written) = (Vec::new(), Vec::new());
    for (node, port) in ports {
        let (found, stale) = engine::outputs_there(&pipeline, &store, node, port)?;
        let mut shown = read(&pipeline.nodes[node].name, &found, &store)?;
        for (cell, error) in stale {
            match earlier(&pipeline, (cell, port), &runs, &store)? {
                Some(checkpoints) => shown.extend(checkpoints),
                None => missing.push(error.to_string()),
            }
        }
        for checkpoint in shown {
            rows.push(row(&checkpoint)?);
            if let Some(out) = &args.out {
                let path = out.join(&checkpoint.path);
                publish::write(&path, &checkpoint.bytes)?;
                written.push(path);
            }
        }
    }
    if rows.len() > 1 {
        out!("{}", table(&rows));
    }
    missing.iter().for_each(|why| errln!("note: {why}"));
    if args.out.is_some() {
        errln!("wrote {}", counted(written.len() as u64, "checkpoint"));
        written.iter().for_each(|path| outln!("{}", path.display()));
    }
    Ok(if rows.len() > 1 { Exit::Done } else { Exit::Failed })
}

/// The outputs that hold trained weights.
fn ports(pipeline: &Pipeline) -> impl Iterator<Item = (usize, PortId)> + '_ {
    let nodes = pipeline.nodes.iter().enumerate();
    nodes.flat_map(|(number, node)| {
        let outputs = node.spec.outputs.iter().enumerate();
        let trained = outputs.filter(|(_, port)| [ModelFile::NAME, AdapterFile::NAME].contains(&port.media));
        trained.map(move |(place, _)| (number, PortId::at(place))).collect::<Vec<_>>()
    })
}

/// The checkpoints among the items of a node, by the names of their cells.
fn read(node: &str, items: &Collection, store: &Store) -> Result<Vec<Checkpoint>, CliError> {
    let (reading, stop) = (Reading(store), AtomicBool::new(false));
    let ctx = Context::new(&reading, &Silent, &stop);
    let checkpoint = |(key, artifact)| {
        let key: &ItemKey = key;
        let bytes = ctx.part(artifact, "").map_err(|error| unread(key.as_str(), error))?;
        // The last part of the key names the output, and each holds one file.
        let cell = key.as_str().rsplit_once('/').map_or("", |(cell, _)| cell);
        let path = Path::new(node).join(cell).join(FILE);
        let name = if cell.is_empty() { node.to_owned() } else { format!("{node}[{}]", cell.replace('+', ", ")) };
        Ok(Checkpoint { name, path, bytes, of_run: None })
    };
    items.iter().map(checkpoint).collect()
}

/// The checkpoints of a stale cell by the latest run that has them; none if the cache holds none.
fn earlier(
    pipeline: &Pipeline,
    (cell, port): (usize, PortId),
    runs: &[RunRecord],
    store: &Store,
) -> Result<Option<Vec<Checkpoint>>, CliError> {
    let of = &pipeline.nodes[pipeline.cells[cell].node];
    let name = format!("{}.{}", pipeline.cell_name(cell), of.spec.outputs[port.place()].name);
    for run in runs.iter().rev() {
        let Some(listed) = run.outputs.get(&name).and_then(|output| output.listed.as_ref()) else { continue };
        let Some(items) = engine::listed_items(store, listed)? else { continue };
        let text = &pipeline.cells[cell].text;
        let mut found = Collection::default();
        for (key, artifact) in items {
            let key = if text.is_empty() { Ok(key) } else { key.in_cell(text) };
            found.items.insert(key.map_err(|error| CliError::Bad(error.to_string()))?, artifact);
        }
        // Garbage collection may have deleted some of the weights.
        let Ok(mut checkpoints) = read(&of.name, &found, store) else { continue };
        checkpoints.iter_mut().for_each(|checkpoint| checkpoint.of_run = Some(run.id.clone()));
        return Ok(Some(checkpoints));
    }
    Ok(None)
}

fn row(checkpoint: &Checkpoint) -> Result<Vec<String>, CliError> {
    let file = TensorFile::from_bytes(&checkpoint.bytes)
        .map_err(|error| CliError::Bad(format!("`{}` is no file of tensors: {error}", checkpoint.name)))?;
    let weights: usize = file.tensors.values().map(|tensor| tensor.data.len()).sum();
    // One note says what the weights are of.
    let note = file.metadata.values().find_map(|note| serde_json::from_str::<Value>(note).ok()).unwrap_or_default();
    let fields = note.as_object().into_iter().flatten();
    let about = fields.filter_map(|(name, value)| match value {
        Value::String(text) => Some(text.clone()),
        Value::Bool(_) | Value::Number(_) if name != "steps" => Some(format!("{name} {value}")),
        _ => None,
    });
    Ok(vec![
        checkpoint.name.clone(),
        note["steps"].as_u64().map(|steps| steps.to_string()).unwrap_or_default(),
        weights.to_string(),
        bytes_text(checkpoint.bytes.len() as u64),
        checkpoint.of_run.as_ref().map_or_else(|| "up to date".to_owned(), |run| format!("stale, of run {run}")),
        about.collect::<Vec<_>>().join(", "),
    ])
}
