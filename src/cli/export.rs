//! `tauflow export`: writes results as files. Each media type defines its files.

use super::{
    CacheAt, CliError, Exit, PipelineArgs, counted,
    results::{collection, restore, unread},
};
use crate::{
    ids::Id,
    kinds::Registry,
    query::{Exposures, Reading, Selection},
};
use clap::Args;
use std::{path::PathBuf, sync::atomic::AtomicBool};
use tauflow_contract::{Artifact, Collection, Context, ItemKey, KindError, Radiance, Silent};
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
    /// Write all images as raw radiance; packed scenes and refined images are divided by the exposure of their scene.
    #[arg(long)]
    raw: bool,
}

pub(crate) fn export(args: &ExportArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    let pipeline = args.pipeline.resolve(registry)?;
    let asked = Selection::parse(&args.node, &pipeline)?;
    let store = cache.look()?;
    let mut found = collection(&asked, &store)?;
    let reading = Reading(&store);
    let stop = AtomicBool::new(false);
    let ctx = Context::new(&reading, &Silent, &stop);
    // An exposure that cannot be read is unknown.
    let exposures = Exposures::of(&asked, &ctx, &|of| collection(of, &store).ok());
    let radiance =
        |key: &ItemKey| Radiance { exposure: exposures.of_item(key), raw: args.raw || exposures.is_unexposed() };
    let mut out = DiskFolder::new(&args.out);
    folder::begin(&out).map_err(unwritten)?;
    let mut restored = false;
    let items = loop {
        match write(&ctx, &found, &out, &radiance) {
            // Damage shows as it is read; all of it is mended at once.
            Err((_, KindError::MissingBlob(_))) if !restored => {
                restored = true;
                restore(&asked, &store)?;
                found = collection(&asked, &store)?;
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
    radiance: &dyn Fn(&ItemKey) -> Radiance,
) -> Result<Vec<ExportedItem>, (ItemKey, KindError)> {
    let item = |(key, artifact): (&ItemKey, &Artifact)| {
        let out = out.with_radiance(radiance(key));
        folder::export_item(ctx, key, artifact, &out).map_err(|error| (key.clone(), error))
    };
    collection.iter().map(item).collect()
}

fn unwritten(error: KindError) -> CliError {
    CliError::Environment(error.to_string())
}
