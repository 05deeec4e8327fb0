//! `tauflow show`: what an item is, the verdict of the gate, and its files.

use super::{
    CacheAt, CliError, Exit, PipelineArgs, bytes_text, counted, output, results::unread, thumbnail::thumbnail,
};
use crate::{
    diagnostics::nearest,
    engine::EngineError,
    kinds::Registry,
    pipeline::Pipeline,
    query::{Reading, Selection},
};
use clap::Args;
use std::{collections::BTreeSet, sync::atomic::AtomicBool};
use tauflow_cache::Store;
use tauflow_contract::{Artifact, Collection, Context, FileTree, ItemKey, KindError, Media, OutputPort, Silent};
use tauflow_data::records::{Verdict, media};

/// Arguments of `show`.
#[derive(Args)]
pub(crate) struct ShowArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// The node: `node`, `node.port`, or `node[axis=value].port`.
    node: String,
    /// The item, in all cells, or `cell/item`.
    item: String,
}

/// Text files up to this size are printed.
const MOST_TEXT: usize = 4 << 10;
/// Files of an item, and items of a node, that are named.
const MOST_NAMED: usize = 12;

pub(crate) fn show(args: &ShowArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    let pipeline = args.pipeline.resolve(registry)?;
    let asked = Selection::parse(&args.node, &pipeline)?;
    let store = cache.look()?;
    let (reading, stop) = (Reading(&store), AtomicBool::new(false));
    let ctx = Context::new(&reading, &Silent, &stop);
    let node = &pipeline.nodes[asked.node];
    let is_it = |key: &ItemKey| {
        let own = key.as_str().strip_suffix(&args.item);
        own.is_some_and(|cells| cells.is_empty() || cells.ends_with('/'))
    };
    let (mut names, mut found, mut stale) = (BTreeSet::new(), 0, None);
    // `node.port` shows this port alone, and `node[axis=value]` these cells.
    let named = |port: &OutputPort| args.node.strip_suffix(port.name).and_then(|rest| rest.strip_suffix('.'));
    let only = node.spec.outputs.iter().find_map(|port| Some((port.name, named(port)?)));
    let cells = only.map_or(args.node.as_str(), |(_, cells)| cells);
    for port in node.spec.outputs.iter().filter(|port| only.is_none_or(|(name, _)| name == port.name)) {
        // A port that nobody asked for has never been made.
        let collection = match made(&pipeline, cells, port.name, &store) {
            Ok(collection) => collection,
            Err(error) => {
                stale = stale.or(Some(error));
                continue;
            }
        };
        for (key, artifact) in collection.iter() {
            if !is_it(key) {
                // With a cell if one was asked for.
                let own = if args.item.contains('/') { Some(key.as_str()) } else { key.as_str().rsplit('/').next() };
                names.insert(own.unwrap_or_default().to_owned());
                continue;
            }
            if found > 0 {
                outln!("");
            }
            found += 1;
            outln!("{}.{} {key}", node.name, port.name);
            outln!("  {}", port.doc);
            artifact_in_full(&ctx, key, artifact)?;
        }
    }
    if found == 0 {
        return Err(match stale {
            Some(error) if names.is_empty() => error,
            _ => {
                let hint = nearest(&args.item, names.iter().map(String::as_str)).map_or_else(
                    || {
                        let some: Vec<String> = names.iter().take(MOST_NAMED).map(|name| format!("`{name}`")).collect();
                        format!("it has {}, such as {}", counted(names.len() as u64, "item"), some.join(", "))
                    },
                    |near| format!("did you mean `{near}`?"),
                );
                CliError::Bad(format!("`{}` has no item `{}`; {hint}", node.name, args.item))
            }
        });
    }
    verdicts(&pipeline, &store, &ctx, (asked.node, &args.item))?;
    outln!("\nto write the files: tauflow export {} {} -o DIR", args.pipeline.again(), args.node);
    Ok(Exit::Done)
}

/// The collection on a port, if it is up to date.
fn made(pipeline: &Pipeline, node: &str, port: &str, store: &Store) -> Result<Collection, CliError> {
    match Selection::parse(&format!("{node}.{port}"), pipeline)?.collection(store) {
        Ok(collection) => Ok(collection),
        Err(error @ (EngineError::Request(_) | EngineError::Lost(_))) => Err(CliError::Bad(error.to_string())),
        Err(error) => Err(error.into()),
    }
}

/// The type of an artifact, its files, and what short texts of them say.
fn artifact_in_full(ctx: &Context<'_>, key: &ItemKey, artifact: &Artifact) -> Result<(), CliError> {
    outln!("  type   {}, {}", artifact.media, bytes_text(artifact.size()));
    outln!("  digest {}", artifact.digest());
    let mut files = FileTree::new();
    let written = media(&artifact.media).map_or(Ok(()), |row| (row.export)(ctx, artifact, &mut files));
    written.map_err(|error: KindError| unread(key.as_str(), error))?;
    // A scene has hundreds of meshes and images; its own files come first.
    let depth = |(name, _): &(&String, &Vec<u8>)| name.matches('/').count();
    let mut sorted: Vec<(&String, &Vec<u8>)> = files.iter().collect();
    sorted.sort_by_key(depth);
    // Of a ladder, the last picture has the most samples.
    let mut previews = sorted.iter().filter(|(name, _)| name.ends_with(".png") && !name.contains('/'));
    let shown = previews.next_back().and_then(|(name, png)| Some((name, thumbnail(png, "  ")?)));
    if let Some((name, orders)) = shown {
        outln!("  {key}/{name}");
        output::picture(&orders);
    }
    for (name, bytes) in sorted.iter().take(MOST_NAMED) {
        outln!("  file   {key}/{name}  {}", bytes_text(bytes.len() as u64));
        let short = (bytes.len() <= MOST_TEXT && name.ends_with(".json")).then(|| std::str::from_utf8(bytes));
        if let Some(Ok(text)) = short {
            text.lines().for_each(|line| outln!("    {line}"));
        }
    }
    if let Some(rest) = sorted.get(MOST_NAMED..).filter(|rest| !rest.is_empty()) {
        let bytes = rest.iter().map(|(_, bytes)| bytes.len() as u64).sum();
        outln!("  and {}, {}", counted(rest.len() as u64, "more file"), bytes_text(bytes));
    }
    Ok(())
}

/// The verdicts of the pipeline's gates on an item of this name.
fn verdicts(
    pipeline: &Pipeline,
    store: &Store,
    ctx: &Context<'_>,
    (shown, item): (usize, &str),
) -> Result<(), CliError> {
    let own = item.rsplit('/').next().unwrap_or_default();
    for (_, node) in pipeline.nodes.iter().enumerate().filter(|(place, _)| *place != shown) {
        for port in node.spec.outputs.iter().filter(|port| port.media == Verdict::NAME) {
            let Ok(collection) = made(pipeline, &node.name, port.name, store) else { continue };
            let Some((key, artifact)) = collection.iter().find(|(key, _)| key.as_str() == own) else { continue };
            let verdict = Verdict::load(ctx, artifact).map_err(|error| unread(key.as_str(), error))?;
            if verdict.reasons.is_empty() {
                outln!("\n`{}` accepted {key}", node.name);
            } else {
                outln!("\n`{}` rejected {key}: {}", node.name, verdict.reasons.join(", "));
            }
            verdict.measures.iter().for_each(|(measure, value)| outln!("  {measure} {value:.4}"));
        }
    }
    Ok(())
}
