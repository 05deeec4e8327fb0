//! `tauflow export`: results as files that other programs read. What the files are is up to each media type.

use super::{
    CacheAt, CliError, Exit, PipelineArgs, counted,
    results::{Asked, Reading, unread},
};
use crate::{ids::Id, kinds::Registry};
use clap::Args;
use std::{path::PathBuf, sync::atomic::AtomicBool};
use tauflow_contract::{Artifact, Collection, Context, ItemKey, KindError, Silent};
use tauflow_data::folder::{self, DiskFolder, ExportedItem, Manifest};

/// Arguments of `export`.
#[derive(Args)]
pub(crate) struct ExportArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// The results to export: `node`, `node.port`, or `node[axis=value].port`.
    node: String,
    /// Directory to write to.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
}

pub(crate) fn export(args: &ExportArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    let pipeline = args.pipeline.resolve(registry)?;
    let asked = Asked::parse(&args.node, &pipeline)?;
    let store = cache.look()?;
    let mut collection = asked.collection(&store)?;
    let reading = Reading(&store);
    let stop = AtomicBool::new(false);
    let ctx = Context::new(&reading, &Silent, &stop);
    let mut out = DiskFolder::new(&args.out);
    folder::begin(&out).map_err(unwritten)?;
    let mut restored = false;
    let items = loop {
        match write(&ctx, &collection, &out) {
            // Damage shows as it is read; all of it is mended at once.
            Err((_, KindError::MissingBlob(_))) if !restored => {
                restored = true;
                asked.restore(&store)?;
                collection = asked.collection(&store)?;
            }
            Err((key, error)) => return Err(unread(key.as_str(), error)),
            Ok(items) => break items,
        }
    };
    let count = items.len() as u64;
    let node = &pipeline.nodes[asked.node];
    let manifest = Manifest {
        pipeline: pipeline.name.clone(),
        node: node.name.clone(),
        port: node.spec.outputs[asked.port.place()].name.to_owned(),
        items,
    };
    folder::finish(&mut out, &manifest).map_err(unwritten)?;
    eprintln!("{}", counted(count, "item"));
    outln!("{}", args.out.display());
    Ok(Exit::Done)
}

/// Writes every item; of the first that cannot be written, its key and why.
fn write(
    ctx: &Context<'_>,
    collection: &Collection,
    out: &DiskFolder,
) -> Result<Vec<ExportedItem>, (ItemKey, KindError)> {
    let item = |(key, artifact): (&ItemKey, &Artifact)| {
        folder::export_item(ctx, key, artifact, out).map_err(|error| (key.clone(), error))
    };
    collection.iter().map(item).collect()
}

fn unwritten(error: KindError) -> CliError {
    CliError::Environment(error.to_string())
}
