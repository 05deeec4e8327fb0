#![doc = include_str!("assets.md")]

mod blobs;
mod bounds;
mod environment;
mod exr_file;
mod files;
mod gltf;
mod hdr;
mod refusal;

pub(crate) use blobs::BlobSet;
pub(crate) use bounds::Allowance;
pub(crate) use files::{ascii, ending, expand, refusal, search};
pub(crate) use gltf::{Document, Externals, Surfaces, alpha, picture, read_in_place, relative_path, uris};
pub(crate) use refusal::{Refusal, damaged};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tauflow_contract::{
    Action, Before, Context, FILE_PORT, Files, Group, ItemKey, Kind, KindError, KindSpec, Later, Media, Mode, Out,
    Outputs, ParamProblem, SourceItem,
};
use tauflow_data::records::{Asset, AssetBody, AssetReport};

const MAIN: Group = Group::main(5);
const ASSETS: Out<Asset> = Out::new(MAIN, "assets", "The imported files, without refused ones.").filtering();
const REPORTS: Out<AssetReport> = Out::new(MAIN, "reports", "The import result of each file.");

/// The behaviour before these params existed.
const LATER: &[Later] = &[Later { pointer: "/allow_none", before: Before::Flag(false) }];

/// The kind `assets`.
pub struct Assets;

/// Params of `assets`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AssetsParams {
    /// Directories that are searched recursively for .hdr, .exr, .glb and .gltf files.
    pub folders: Vec<String>,
    /// Single files, or patterns with `*` and `?`.
    pub files: Vec<String>,
    /// Accept params without folders and files: there are no assets then. For pipelines with optional assets.
    pub allow_none: bool,
    /// Maximum side of an object's textures in texels; larger textures are reduced.
    #[schemars(range(min = 1, max = 16384))]
    pub max_texture: u32,
    /// The item's name: handed to its action. The schema does not have it, so that nobody sets it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(skip)]
    pub name: Option<String>,
}

impl Default for AssetsParams {
    fn default() -> Self {
        Self { folders: Vec::new(), files: Vec::new(), allow_none: false, max_texture: 1024, name: None }
    }
}

/// True for the name of an environment map.
fn is_map(name: &str) -> bool {
    matches!(files::ending(name).as_str(), "hdr" | "exr")
}

/// Reads a picture of radiance, Radiance or OpenEXR by its first bytes; linear RGB.
///
/// # Errors
/// If the bytes are no such picture.
pub(crate) fn radiance(name: &str, bytes: &[u8]) -> Result<tauflow_data::Image, Refusal> {
    if is_hdr(name, bytes) { hdr::read(bytes) } else { exr_file::read(bytes) }
}

/// The alpha of a picture of radiance beside red, green and blue; none if there is no such channel, or it is 1
/// everywhere.
///
/// # Errors
/// If the bytes are no such picture.
pub(crate) fn radiance_alpha(name: &str, bytes: &[u8]) -> Result<Option<tauflow_data::Image>, Refusal> {
    let found = if is_hdr(name, bytes) { None } else { exr_file::alpha(bytes)? };
    Ok(found.filter(|image| image.data().iter().any(|v| *v != 1.0)))
}

/// True for a Radiance picture: by its first bytes, or by its name if these are those of no format.
fn is_hdr(name: &str, bytes: &[u8]) -> bool {
    let named = matches!(files::ending(name).as_str(), "hdr" | "rgbe" | "pic");
    bytes.starts_with(b"#?") || (named && !bytes.starts_with(b"\x76\x2f\x31\x01"))
}

/// Decodes a file: what it is, with its blobs in `blobs`.
fn decode(
    name: &str,
    bytes: &[u8],
    externals: &gltf::Externals,
    max_texture: u32,
    blobs: &mut BlobSet,
    report: &mut AssetReport,
) -> Result<AssetBody, Refusal> {
    let picture = match files::ending(name).as_str() {
        "hdr" | "exr" => radiance(name, bytes)?,
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
    Ok(AssetBody::Hdri { image, size, mean: light.mean, top_share: light.top_share })
}

impl Kind for Assets {
    type Params = AssetsParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "assets",
            summary: "Imports HDRIs and glTF objects, with a report of repairs and refusals.",
            manual: include_str!("assets.md"),
            mode: Mode::Source,
            inputs: vec![],
            outputs: vec![ASSETS.port(), REPORTS.port()],
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        if params.allow_none || !(params.folders.is_empty() && params.files.is_empty()) {
            return Vec::new();
        }
        let remedy = "name where the assets are, or set `allow_none`";
        vec![ParamProblem::new("", "neither `folders` nor `files` is given", remedy)]
    }

    fn later() -> &'static [Later] {
        LATER
    }

    fn items(params: &Self::Params) -> Result<Vec<SourceItem>, KindError> {
        if params.folders.is_empty() && params.files.is_empty() {
            return Ok(Vec::new());
        }
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
        let mut report = AssetReport { name: name.clone(), ..AssetReport::default() };
        if !action.each.contains_key(FILE_PORT) {
            report.reason = Some(files::refusal().line(&name));
            return Ok(Outputs::default().put(REPORTS, report.store(ctx)?));
        }
        let Files(mut files) = action.files()?.load(ctx)?;
        let missing = || KindError::Internal(format!("the item names no part `{}`", files::MAIN));
        let bytes = files.remove(files::MAIN).ok_or_else(missing)?;
        let mut externals = gltf::Externals::new();
        if !is_map(&name) {
            for (number, uri) in gltf::uris(&bytes).into_iter().enumerate() {
                if let (Some(bytes), Some(path)) = (files.remove(&files::external(number)), gltf::relative_path(&uri)) {
                    externals.insert(path, bytes);
                }
            }
        }
        let mut blobs = BlobSet::default();
        let made = decode(&name, &bytes, &externals, action.params.max_texture, &mut blobs, &mut report);
        let mut outputs = Outputs::default();
        match made {
            Ok(body) => {
                report.accepted = true;
                report.sort =
                    Some(if matches!(body, AssetBody::Hdri { .. }) { "environment" } else { "object" }.to_owned());
                let asset = Asset { name, body };
                blobs.store(ctx, &asset.blobs())?;
                outputs = outputs.put(ASSETS, asset.store(ctx)?);
            }
            Err(refusal) => report.reason = Some(refusal.line(&name)),
        }
        Ok(outputs.put(REPORTS, report.store(ctx)?))
    }
}
