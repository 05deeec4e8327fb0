//! `tauflow export`: writes results as files. Each media type defines its files.

use super::{
    CacheAt, CliError, Exit, PipelineArgs, counted,
    results::{Reading, collection, restore, unread},
};
use crate::{ids::Id, kinds::Registry, query::Selection};
use clap::Args;
use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
    sync::atomic::AtomicBool,
};
use tauflow_cache::Store;
use tauflow_contract::{Artifact, Collection, Context, ItemKey, KindError, Media as _, Radiance, Silent};
use tauflow_data::{
    folder::{self, DiskFolder, ExportedItem, Manifest},
    records::Exposure,
};

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
    let exposures = exposures(&asked, &store, &ctx);
    let radiance = |key: &ItemKey| Radiance { exposure: exposure_of(&exposures, key), raw: args.raw };
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

/// The exposures that an output was made with, by scene: those that its node reads, directly or through other nodes. A
/// scene that has several gets none.
fn exposures(of: &Selection<'_>, store: &Store, ctx: &Context<'_>) -> BTreeMap<String, Option<f64>> {
    let pipeline = of.pipeline();
    let (mut found, mut seen) = (BTreeMap::new(), BTreeSet::new());
    let mut open: Vec<usize> = pipeline.nodes[of.node].cells.clone().collect();
    let mut sources = BTreeSet::new();
    while let Some(cell) = open.pop() {
        for from in pipeline.cells[cell].inputs.iter().flatten() {
            let node = pipeline.cells[from.cell].node;
            if pipeline.nodes[node].spec.outputs[from.port.place()].media == Exposure::NAME {
                sources.insert((node, from.port.place()));
            }
            if seen.insert(from.cell) {
                open.push(from.cell);
            }
        }
    }
    for (node, port) in sources {
        let of = &pipeline.nodes[node];
        // What is not there is not known.
        let name = format!("{}.{}", of.name, of.spec.outputs[port].name);
        let Ok(selection) = Selection::parse(&name, pipeline) else { continue };
        let Ok(items) = collection(&selection, store) else { continue };
        for (key, artifact) in items.iter() {
            let factor = Exposure::load(ctx, artifact).ok().map(|exposure| exposure.factor);
            let known = found.entry(key.as_str().to_owned()).or_insert(factor);
            if *known != factor {
                *known = None;
            }
        }
    }
    found
}

/// The exposure of an item, whose key is that of its scene, or ends with it after the texts of cells.
fn exposure_of(exposures: &BTreeMap<String, Option<f64>>, key: &ItemKey) -> Option<f64> {
    let mut rest = key.as_str();
    loop {
        if let Some(factor) = exposures.get(rest) {
            return *factor;
        }
        rest = rest.split_once('/')?.1;
    }
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
