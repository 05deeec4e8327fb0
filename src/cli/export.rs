//! `tauflow export`: results as files that other programs read.

use super::{
    CacheAt, CliError, Exit, PipelineArgs, counted,
    results::{Asked, Reading, unread},
};
use crate::kinds::Registry;
use clap::Args;
use serde_json::{Value, json};
use std::{
    fs,
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};
use tauflow_contract::{Artifact, Context, KindError, Silent};
use tauflow_data::{
    Image,
    formats::{MODEL, PACKED, PackedScene, REFINED, Refined, refined_part},
    image_io::{preview_png, write_exr},
    ladder::{GBUFFER, GBuffer, LADDER, Ladder},
};

/// What `export` takes.
#[derive(Args)]
pub(crate) struct ExportArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// The node, `node.port`, or `node[axis=value].port`.
    node: String,
    /// The folder to write.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
}

pub(crate) fn export(args: &ExportArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    let pipeline = args.pipeline.resolve(registry)?;
    let asked = Asked::parse(&args.node, &pipeline)?;
    let store = cache.open()?;
    let collection = asked.collection(&store)?;
    let reading = Reading(&store);
    let stop = AtomicBool::new(false);
    let ctx = Context::new(&reading, &Silent, &stop);
    let mut items = Vec::new();
    for (key, artifact) in collection.iter() {
        let folder = args.out.join(key.as_str());
        let files = write(&ctx, artifact, &folder).map_err(|error| unread(key.as_str(), error))?;
        items.push(json!({
            "item": key.as_str(),
            "media": artifact.media,
            "digest": artifact.digest(),
            "parts": artifact.parts,
            "files": files,
        }));
    }
    let count = items.len() as u64;
    let manifest = json!({
        "pipeline": pipeline.name,
        "node": pipeline.nodes[asked.node].name,
        "port": pipeline.nodes[asked.node].spec.outputs[asked.port].name,
        "items": items,
    });
    put(&args.out.join("manifest.json"), &pretty(&manifest)).map_err(|e| CliError::Environment(e.to_string()))?;
    eprintln!("{}", counted(count, "item"));
    outln!("{}", args.out.display());
    Ok(Exit::Done)
}

fn pretty(value: &Value) -> Vec<u8> {
    let mut text = serde_json::to_vec_pretty(value).expect("plain data");
    text.push(b'\n');
    text
}

fn make_room(path: &Path) -> Result<(), KindError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let failed = |e| KindError::Environment(format!("cannot make {}: {e}", folder.display()));
    fs::create_dir_all(folder).map_err(failed)
}

fn put(path: &Path, bytes: &[u8]) -> Result<(), KindError> {
    make_room(path)?;
    fs::write(path, bytes).map_err(|e| KindError::Environment(format!("cannot write {}: {e}", path.display())))
}

/// An image as EXR and, if it has three channels, as a preview beside it.
fn picture(folder: &Path, name: &str, image: &Image, preview: bool, files: &mut Vec<String>) -> Result<(), KindError> {
    let path = folder.join(format!("{name}.exr"));
    make_room(&path)?;
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
            let path = folder.join("gbuffer.exr");
            make_room(&path)?;
            write_exr(&path, &[("albedo", &gbuffer.albedo), ("normal", &gbuffer.normal)])?;
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
            for (part, digest) in artifact.parts.iter() {
                let bytes = ctx.get(digest)?;
                let json: Option<Value> = serde_json::from_slice(&bytes).ok();
                let name = match (&json, part.as_str()) {
                    (Some(_), "") => "value.json",
                    (None, "") if artifact.media == MODEL => "model.safetensors",
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
