//! `tauflow checkpoints`: the trained weights of a pipeline, listed and written as files.

use super::{CacheAt, CliError, Exit, PipelineArgs, bytes_text, counted, results::unread, table};
use crate::{
    engine::{EngineError, publish},
    ids::{Id, PortId},
    kinds::Registry,
    pipeline::Pipeline,
    query::{Reading, Selection},
};
use clap::Args;
use serde_json::Value;
use std::{
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};
use tauflow_cache::Store;
use tauflow_contract::{Context, Media as _, Silent};
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
    are models for `tauflow refine`."
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
    let mut rows = vec![["checkpoint", "steps", "weights", "size", "about"].map(str::to_owned).to_vec()];
    let (mut missing, mut written) = (Vec::new(), Vec::new());
    for (node, port) in ports {
        let of = &pipeline.nodes[node];
        let name = format!("{}.{}", of.name, of.spec.outputs[port.place()].name);
        match read(&name, &pipeline, &store) {
            Ok(found) => {
                for checkpoint in found {
                    rows.push(row(&checkpoint)?);
                    if let Some(out) = &args.out {
                        let path = out.join(&checkpoint.path);
                        publish::write(&path, &checkpoint.bytes)?;
                        written.push(path);
                    }
                }
            }
            Err(Unread::Stale(why)) => missing.push(why),
            Err(Unread::Failed(error)) => return Err(error),
        }
    }
    if rows.len() > 1 {
        out!("{}", table(&rows));
    }
    missing.iter().for_each(|why| eprintln!("note: {why}"));
    if args.out.is_some() {
        eprintln!("wrote {}", counted(written.len() as u64, "checkpoint"));
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

/// Why weights cannot be read.
enum Unread {
    /// A run must make them first.
    Stale(String),
    Failed(CliError),
}

fn read(name: &str, pipeline: &Pipeline, store: &Store) -> Result<Vec<Checkpoint>, Unread> {
    let failed = |error: CliError| Unread::Failed(error);
    let selection = Selection::parse(name, pipeline).map_err(|error| failed(error.into()))?;
    let found = selection.collection(store).map_err(|error| match error {
        EngineError::Request(why) | EngineError::Lost(why) => Unread::Stale(why),
        other => failed(other.into()),
    })?;
    let (reading, stop) = (Reading(store), AtomicBool::new(false));
    let ctx = Context::new(&reading, &Silent, &stop);
    let node = &pipeline.nodes[selection.node].name;
    let checkpoint = |(key, artifact)| {
        let key: &tauflow_contract::ItemKey = key;
        let bytes = ctx.part(artifact, "").map_err(|error| failed(unread(key.as_str(), error)))?;
        // The last part of the key names the output, and each holds one file.
        let cell = key.as_str().rsplit_once('/').map_or("", |(cell, _)| cell);
        let path = Path::new(node).join(cell).join(FILE);
        let name = if cell.is_empty() { node.clone() } else { format!("{node}[{}]", cell.replace('+', ", ")) };
        Ok(Checkpoint { name, path, bytes })
    };
    found.iter().map(checkpoint).collect()
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
        about.collect::<Vec<_>>().join(", "),
    ])
}
