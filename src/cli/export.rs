//! `tauflow export`: results as files that other programs read.

use super::{CliError, Exit, Open, PipelineArgs};
use crate::{engine, kinds::Registry, pipeline::reference::Reference};
use clap::Args;
use serde_json::{Value, json};
use std::{
    fs,
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};
use tauflow_cache::{Digest, Store};
use tauflow_contract::{Artifact, Blobs, Context, KindError, MemoKey, Silent};
use tauflow_data::{
    Image,
    formats::{PACKED, PackedScene, REFINED, Refined, refined_part},
    image_io::{preview_png, write_exr},
    ladder::{GBUFFER, GBuffer, LADDER, Ladder},
};

/// What `export` takes.
#[derive(Args)]
pub(crate) struct ExportArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// The node, or `node.port`.
    node: String,
    /// The folder to write.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
}

/// The store, for reading only.
struct Reading<'a>(&'a Store);

impl Blobs for Reading<'_> {
    fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, KindError> {
        self.0.get(digest).map_err(|e| KindError::Environment(e.to_string()))
    }

    fn put(&self, _: &[u8]) -> Result<Digest, KindError> {
        Err(KindError::Internal("an export writes nothing into the store".into()))
    }

    fn memo_get(&self, _: &MemoKey) -> Option<Artifact> {
        None
    }

    fn memo_put(&self, _: &MemoKey, _: &Artifact) -> Result<(), KindError> {
        Err(KindError::Internal("an export writes nothing into the store".into()))
    }
}

pub(crate) fn export(args: &ExportArgs, registry: &Registry, open: Open<'_>) -> Result<Exit, CliError> {
    let pipeline = args.pipeline.resolve(registry)?;
    let reference = Reference::parse(&args.node).map_err(CliError::Bad)?;
    let node = pipeline.node(reference.node).ok_or_else(|| {
        let names = pipeline.nodes.iter().map(|n| n.name.as_str());
        let hint = crate::diagnostics::did_you_mean(reference.node, "nodes", names);
        CliError::Bad(format!("there is no node `{}`; {hint}", reference.node))
    })?;
    let port = match reference.port {
        None => 0,
        Some(name) => pipeline.nodes[node].output(name).ok_or_else(|| {
            let names = pipeline.nodes[node].spec.outputs.iter().map(|p| p.name);
            let hint = crate::diagnostics::did_you_mean(name, "outputs", names);
            CliError::Bad(format!("`{}` has no output `{name}`; {hint}", reference.node))
        })?,
    };
    let store = open()?;
    let collection = engine::outputs(&pipeline, &store, node, port)?;
    let reading = Reading(&store);
    let stop = AtomicBool::new(false);
    let ctx = Context::new(&reading, &Silent, &stop);
    let mut items = Vec::new();
    for (key, artifact) in collection.iter() {
        let folder = args.out.join(key.as_str());
        let files = write(&ctx, artifact, &folder).map_err(|error| match error {
            KindError::MissingBlob(_) => {
                CliError::Bad(format!("`{key}` is no longer whole in the cache; run the pipeline again first"))
            }
            other => CliError::Environment(format!("{key}: {other}")),
        })?;
        items.push(json!({
            "item": key.as_str(),
            "media": artifact.media,
            "digest": artifact.digest(),
            "parts": artifact.parts,
            "files": files,
        }));
    }
    let count = items.len();
    let manifest = json!({
        "pipeline": pipeline.name,
        "node": pipeline.nodes[node].name,
        "port": pipeline.nodes[node].spec.outputs[port].name,
        "items": items,
    });
    put(&args.out.join("manifest.json"), &pretty(&manifest)).map_err(|e| CliError::Environment(e.to_string()))?;
    eprintln!("{count} items");
    outln!("{}", args.out.display());
    Ok(Exit::Done)
}

fn pretty(value: &Value) -> Vec<u8> {
    let mut text = serde_json::to_vec_pretty(value).expect("plain data");
    text.push(b'\n');
    text
}

fn put(path: &Path, bytes: &[u8]) -> Result<(), KindError> {
    let failed = |e| KindError::Environment(format!("cannot write {}: {e}", path.display()));
    fs::create_dir_all(path.parent().unwrap_or(Path::new("."))).map_err(failed)?;
    fs::write(path, bytes).map_err(failed)
}

/// An image as EXR and, if it has three channels, as a preview beside it.
fn picture(folder: &Path, name: &str, image: &Image, preview: bool, files: &mut Vec<String>) -> Result<(), KindError> {
    let path = folder.join(format!("{name}.exr"));
    put(&path, &[])?;
    write_exr(&path, &[("", image)])?;
    files.push(format!("{name}.exr"));
    if preview && image.channels() == 3 {
        put(&folder.join(format!("{name}.png")), &preview_png(image)?)?;
        files.push(format!("{name}.png"));
    }
    Ok(())
}

fn write(ctx: &Context<'_>, artifact: &Artifact, folder: &Path) -> Result<Vec<String>, KindError> {
    let mut files = Vec::new();
    match artifact.media.as_str() {
        LADDER => {
            let ladder = Ladder::load(ctx, artifact)?;
            for rung in &ladder.rungs {
                picture(folder, &format!("spp-{:06}", rung.spp), &rung.image, true, &mut files)?;
            }
            picture(folder, "variance", &ladder.variance, false, &mut files)?;
            let meta = serde_json::to_value(&ladder.meta).expect("plain data");
            put(&folder.join("meta.json"), &pretty(&meta))?;
            files.push("meta.json".into());
        }
        GBUFFER => {
            let gbuffer = GBuffer::load(ctx, artifact)?;
            put(&folder.join("gbuffer.exr"), &[])?;
            write_exr(&folder.join("gbuffer.exr"), &[("albedo", &gbuffer.albedo), ("normal", &gbuffer.normal)])?;
            files.push("gbuffer.exr".into());
        }
        PACKED => {
            let packed = PackedScene::from_bytes(&ctx.part(artifact, "")?)?;
            for (count, state) in packed.counts.iter().zip(&packed.states) {
                picture(folder, &format!("spp-{count:06}"), state, true, &mut files)?;
            }
        }
        REFINED => {
            let refined: Refined = ctx.json(artifact, "meta.json")?;
            for (index, image) in refined.images.iter().enumerate() {
                let picture_of = Image::from_bytes(&ctx.part(artifact, &refined_part(index))?)?;
                let name = format!("{}-{}-to-{}-nfe-{}", image.method, image.from_spp, image.to_spp, image.nfe);
                picture(folder, &name, &picture_of, true, &mut files)?;
            }
        }
        _ => {
            for (part, digest) in &artifact.parts {
                let bytes = ctx.get(digest)?;
                let json: Option<Value> = serde_json::from_slice(&bytes).ok();
                let name = match (&json, part.as_str()) {
                    (Some(_), "") => "value.json",
                    (None, "") => "value.bin",
                    (_, part) => part,
                };
                put(&folder.join(name), &json.as_ref().filter(|_| name.ends_with(".json")).map_or(bytes, pretty))?;
                files.push(name.to_owned());
            }
        }
    }
    Ok(files)
}
