//! `tauflow export`: writes results as files. Each media type defines its files; [`formats`] writes them for other
//! programs.

mod formats;
mod noisebase;
mod parquet;

use super::{
    CacheAt, CliError, Exit, PipelineArgs, counted,
    results::{collection, restore, unread},
};
use crate::{
    diagnostics::nearest,
    ids::Id,
    kinds::Registry,
    query::{Exposures, Reading, Selection},
};
use clap::Args;
use formats::{Format, Writer};
use std::{collections::BTreeMap, path::PathBuf, sync::atomic::AtomicBool};
use tauflow_cache::Store;
use tauflow_contract::{
    Artifact, Collection, Context, ItemKey, KindError, Media as _, Radiance, Silent, WriteFiles as _,
};
use tauflow_data::{
    folder::{self, DiskFolder, ExportedItem, Manifest},
    records::Refined,
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
    /// Write only this item: its key, or its scene in all cells. Can be repeated.
    #[arg(long = "item", value_name = "KEY")]
    items: Vec<String>,
    /// Format of the files.
    #[arg(long, value_enum, default_value_t, value_name = "FORMAT")]
    format: Format,
    /// Samples per pixel, with `--format noisebase`.
    #[arg(long, default_value_t = 8, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=4096))]
    samples: u64,
}

pub(crate) fn export(args: &ExportArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    let pipeline = args.pipeline.resolve(registry)?;
    let asked = Selection::parse(&args.node, &pipeline)?;
    let store = cache.look()?;
    let mut found = picked(args, collection(&asked, &store)?)?;
    let reading = Reading(&store);
    let stop = AtomicBool::new(false);
    let ctx = Context::new(&reading, &Silent, &stop);
    // An exposure that cannot be read is unknown.
    let exposures = Exposures::of(&asked, &ctx, &|of| collection(of, &store).ok());
    // Images that nothing has exposed, such as those of an external renderer: raw radiance, times 1.
    let made = pipeline.nodes[asked.node].spec.outputs[asked.port.place()].media;
    let unexposed = made == Refined::NAME && exposures.is_unexposed();
    let radiance = |key: &ItemKey| match unexposed {
        true => Radiance { exposure: Some(1.0), raw: true },
        false => Radiance { exposure: exposures.of_item(key), raw: args.raw },
    };
    let mut out = DiskFolder::new(&args.out);
    if args.format == Format::Folder {
        folder::begin(&out);
    }
    let node = &pipeline.nodes[asked.node];
    if args.format == Format::Noisebase {
        write_samples(args, &ctx, (&asked, &found), &store, &mut out)?;
        errln!("{}", counted(found.iter().count() as u64, "item"));
        outln!("{}", args.out.display());
        return Ok(Exit::Done);
    }
    let mut restored = false;
    let items = loop {
        let written = match args.format {
            Format::Folder => write(&ctx, &found, &out, &radiance),
            format => write_as(format, &ctx, (&node.name, &found), &out, &radiance).map(|()| Vec::new()),
        };
        match written {
            // Damage shows as it is read; all of it is mended at once.
            Err((_, KindError::MissingBlob(_))) if !restored => {
                restored = true;
                restore(&asked, &store)?;
                found = picked(args, collection(&asked, &store)?)?;
            }
            Err((key, error)) => return Err(unread(key.as_str(), error)),
            Ok(items) => break items,
        }
    };
    let count = found.iter().count() as u64;
    if args.format != Format::Folder {
        errln!("{}", counted(count, "item"));
        outln!("{}", args.out.display());
        return Ok(Exit::Done);
    }
    let manifest = Manifest {
        pipeline: pipeline.name.clone(),
        node: node.name.clone(),
        port: node.spec.outputs[asked.port.place()].name.to_owned(),
        items,
    };
    folder::finish(&mut out, &manifest).map_err(unwritten)?;
    errln!("{}", counted(count, "item"));
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

/// Renders and writes the samples of every item.
fn write_samples(
    args: &ExportArgs,
    ctx: &Context<'_>,
    (asked, found): (&Selection<'_>, &Collection),
    store: &Store,
    out: &mut DiskFolder,
) -> Result<(), CliError> {
    let pipeline = asked.pipeline();
    let origins = noisebase::origins(pipeline, asked).map_err(CliError::Bad)?;
    let mut outputs: BTreeMap<&str, Collection> = BTreeMap::new();
    for (name, _) in origins.iter().flat_map(|origin| &origin.scenes) {
        if !outputs.contains_key(name.as_str()) {
            outputs.insert(name, collection(&Selection::parse(name, pipeline)?, store)?);
        }
    }
    let mut scenes = noisebase::Scenes::new(args.samples);
    let mut put = |name: &str, bytes: &[u8]| out.put(name, bytes);
    for (key, ladder) in found.iter() {
        let own = key.split_cell().map_or_else(|| key.as_str(), |(_, own)| own);
        let scene = origins.iter().filter(|origin| origin.has(key)).find_map(|origin| {
            let keys =
                origin.scenes.iter().flat_map(|(name, cell)| [(name, own.to_owned()), (name, format!("{cell}/{own}"))]);
            keys.filter_map(|(name, key)| outputs[name.as_str()].get(&key)).next().map(|scene| (origin, scene))
        });
        let scene =
            scene.ok_or_else(|| CliError::Bad(format!("`{key}`: its scene is not among those of the pipeline")))?;
        scenes.add(ctx, (key, ladder), scene, &mut put).map_err(|error| unread(key.as_str(), error))?;
    }
    scenes.finish(&format!("{}, {}", pipeline.name, args.node), &mut put).map_err(unwritten)
}

/// Writes every item in a format of other programs; of the first that cannot be written, its key and why.
fn write_as(
    format: Format,
    ctx: &Context<'_>,
    (node, collection): (&str, &Collection),
    out: &DiskFolder,
    radiance: &dyn Fn(&ItemKey) -> Radiance,
) -> Result<(), (ItemKey, KindError)> {
    let (mut writer, mut out, mut last) = (Writer::new(format, node), out.clone(), None);
    let mut put = |name: &str, bytes: &[u8]| out.put(name, bytes);
    for (key, artifact) in collection.iter() {
        writer.add(ctx, (key, artifact), radiance(key), &mut put).map_err(|error| (key.clone(), error))?;
        last = Some(key);
    }
    // Without items, nothing is left to write.
    last.map_or(Ok(()), |key| writer.finish(&mut put).map_err(|error| (key.clone(), error)))
}

/// The items that are asked for.
fn picked(args: &ExportArgs, mut found: Collection) -> Result<Collection, CliError> {
    if args.items.is_empty() {
        return Ok(found);
    }
    let own = |key: &ItemKey| key.split_cell().map_or_else(|| key.as_str().to_owned(), |(_, own)| own.to_owned());
    for item in &args.items {
        if !found.iter().any(|(key, _)| key.as_str() == item || own(key) == *item) {
            let hint = nearest(item, found.iter().map(|(key, _)| key.as_str())).map_or_else(
                || format!("it has {}", counted(found.iter().count() as u64, "item")),
                |near| format!("did you mean `{near}`?"),
            );
            return Err(CliError::Bad(format!("`{}` has no item `{item}`; {hint}", args.node)));
        }
    }
    found.items.retain(|key, _| args.items.iter().any(|item| key.as_str() == item || own(key) == *item));
    Ok(found)
}

fn unwritten(error: KindError) -> CliError {
    CliError::Environment(error.to_string())
}
