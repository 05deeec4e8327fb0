#![doc = include_str!("../assets.md")]

pub mod asset;
mod blobs;
mod environment;
mod exr_file;
mod files;
mod gltf;
mod hdr;
mod refusal;

use asset::{Asset, Body, Report};
use blobs::BlobSet;
use refusal::Refusal;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tauflow_contract::{
    Action, Artifact, Context, ItemKey, Kind, KindError, KindSpec, Mode, OutputPort, Outputs, ParamProblem, SourceItem,
};
use tauflow_data::formats::{ASSET, JSON};

/// The kind `assets`.
pub struct Assets;

/// Params of `assets`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AssetsParams {
    /// Folders that are searched, with those below, for .hdr, .exr, .glb and .gltf files.
    pub folders: Vec<String>,
    /// Single files, or patterns with `*` and `?`.
    pub files: Vec<String>,
    /// Most texels along a side of an object's textures; larger ones are reduced.
    #[schemars(range(min = 1, max = 16384))]
    pub max_texture: u32,
    /// The item's name: handed to its action, not to be set.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(skip)]
    pub name: Option<String>,
}

impl Default for AssetsParams {
    fn default() -> Self {
        Self { folders: Vec::new(), files: Vec::new(), max_texture: 1024, name: None }
    }
}

/// True for the name of an environment map.
fn is_map(name: &str) -> bool {
    matches!(files::ending(name).as_str(), "hdr" | "exr")
}

/// Decodes a file: what it is, with its blobs in `blobs`.
fn decode(
    name: &str,
    bytes: &[u8],
    externals: &gltf::Externals,
    max_texture: u32,
    blobs: &mut BlobSet,
    report: &mut Report,
) -> Result<Body, Refusal> {
    let picture = match files::ending(name).as_str() {
        "hdr" => hdr::read(bytes)?,
        "exr" => exr_file::read(bytes)?,
        "glb" | "gltf" => return gltf::read(bytes, externals, max_texture as usize, blobs, report),
        other => {
            return Err(Refusal::new(
                "name",
                format!("files of the ending `.{other}` are not read"),
                "convert it to .exr or .glb",
            ));
        }
    };
    let (image, light) = environment::finish(picture, report)?;
    let size = [image.width(), image.height()];
    let image = blobs.add(image.to_bytes());
    Ok(Body::Hdri { image, size, mean: light.mean, top_share: light.top_share })
}

impl Kind for Assets {
    type Params = AssetsParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "assets",
            version: 3,
            summary: "Decodes HDRIs and glTF objects, each with a report of what was repaired or why it is refused",
            manual: include_str!("../assets.md"),
            mode: Mode::Source,
            inputs: &[],
            outputs: const {
                &[
                    OutputPort::new("assets", ASSET, "decoded files; refused ones are left out").filtering(),
                    OutputPort::new("reports", JSON, "what became of each file"),
                ]
            },
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut out = Vec::new();
        if params.folders.is_empty() && params.files.is_empty() {
            out.push(ParamProblem::new("", "neither `folders` nor `files` is given", "name where the assets are"));
        }
        if params.max_texture == 0 {
            out.push(ParamProblem::new("/max_texture", "textures of 0 texels", "1 to 16384"));
        }
        if params.name.is_some() {
            out.push(ParamProblem::new("/name", "`name` is not to be set", "leave it out"));
        }
        out
    }

    fn items(params: &Self::Params) -> Result<Vec<SourceItem>, KindError> {
        files::items(&params.folders, &params.files)
    }

    /// The name, and what decoding reads: where the file lies does not matter, only what it holds.
    fn project(params: &Self::Params, item: Option<&ItemKey>, _group: &str) -> Value {
        let Some(key) = item else { return serde_json::to_value(params).expect("params serialise") };
        if is_map(key.as_str()) {
            json!({ "name": key.as_str() })
        } else {
            json!({ "name": key.as_str(), "max_texture": params.max_texture })
        }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let name = match &action.params.name {
            Some(name) => name.clone(),
            None => action.item()?.to_string(),
        };
        let file = action.each("file")?;
        let bytes = ctx.part(file, files::MAIN)?;
        let mut externals = gltf::Externals::new();
        if !is_map(&name) {
            for (number, uri) in gltf::uris(&bytes).into_iter().enumerate() {
                if let Some(digest) = file.part(&files::external(number)) {
                    externals.insert(uri, ctx.get(&digest)?);
                }
            }
        }
        let mut report = Report { name: name.clone(), ..Report::default() };
        let mut blobs = BlobSet::default();
        let made = decode(&name, &bytes, &externals, action.params.max_texture, &mut blobs, &mut report);
        let mut outputs = Outputs::default();
        match made {
            Ok(body) => {
                report.accepted = true;
                report.sort = Some(if matches!(body, Body::Hdri { .. }) { "environment" } else { "object" }.to_owned());
                let asset = Asset { name, body };
                blobs.store(ctx, &asset.blobs())?;
                outputs = outputs.item("assets", asset.store(ctx)?);
            }
            Err(refusal) => report.reason = Some(refusal.line(&name)),
        }
        Ok(outputs.item("reports", Artifact::blob(JSON, ctx.put_json(&report)?)))
    }
}
