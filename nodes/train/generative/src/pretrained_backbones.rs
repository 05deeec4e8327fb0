#![doc = include_str!("pretrained_backbones.md")]

use crate::{backbone::Config, checkpoint::read_weights};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::{
    fs,
    path::{Path, PathBuf},
};
use tauflow_contract::{
    Action, Context, Group, ItemKey, Kind, KindError, KindSpec, Media, Mode, Out, Outputs, ParamProblem, SourceItem,
};
use tauflow_data::{methods::MethodName, records::BackboneFiles};

/// The kind `pretrained_backbones`.
pub struct PretrainedBackbones;

/// Params of `pretrained_backbones`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PretrainedBackbonesParams {
    /// Directories of checkpoints, each with `config.json` and a file of weights.
    pub folders: Vec<String>,
    /// Accept an empty list of folders: there are no backbones then. For pipelines with optional backbones.
    pub allow_none: bool,
}

const BACKBONE: Out<BackboneFiles> =
    Out::new(Group::main(1), "backbone", "The checkpoint as safetensors, with the current layer names of diffusers.");

/// Part name of the file of weights; its own name follows.
const WEIGHTS: &str = "weights/";

impl Kind for PretrainedBackbones {
    type Params = PretrainedBackbonesParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "pretrained_backbones",
            summary: "Reads checkpoints of generative backbones: DDPM and Rectified Flow.",
            manual: include_str!("pretrained_backbones.md"),
            mode: Mode::Source,
            inputs: vec![],
            outputs: vec![BACKBONE.port()],
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        if params.allow_none || !params.folders.is_empty() {
            return Vec::new();
        }
        vec![ParamProblem::new("/folders", "no folder is named", "name folders of checkpoints, or set `allow_none`")]
    }

    fn items(params: &Self::Params) -> Result<Vec<SourceItem>, KindError> {
        params.folders.iter().map(|folder| item(Path::new(folder))).collect()
    }

    /// Nothing: its files decide an item's backbone.
    fn project(params: &Self::Params, item: Option<&ItemKey>, _group: &str) -> Value {
        if item.is_none() { serde_json::to_value(params).expect("params serialise") } else { json!({}) }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let files = action.files()?.load(ctx)?.0;
        let text = |name: &str| -> Result<Option<String>, KindError> {
            let Some(bytes) = files.get(name) else { return Ok(None) };
            let text = String::from_utf8(bytes.clone());
            text.map(Some).map_err(|_| KindError::Input(format!("`{name}` of the backbone is no text")))
        };
        let config = text(BackboneFiles::CONFIG)?;
        let config = config.ok_or_else(|| KindError::Internal("the item names no configuration".into()))?;
        let config = Config::read(&config, text(BackboneFiles::SCHEDULER)?.as_deref())?;
        let weights = files.iter().find_map(|(name, bytes)| Some((name.strip_prefix(WEIGHTS)?, bytes)));
        let (file, bytes) = weights.ok_or_else(|| KindError::Internal("the item names no weights".into()))?;
        let weights = read_weights(file, bytes, config.network().parameters())?;
        Ok(Outputs::default().put(BACKBONE, config.files(&weights)?.store(ctx)?))
    }
}

/// The files of a folder that make a backbone.
fn item(folder: &Path) -> Result<SourceItem, KindError> {
    let told = |what: String| KindError::Input(format!("the backbone's folder `{}` {what}", folder.display()));
    let name = folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let unfit = |e: String| told(format!("gives the backbone its name, and {e}"));
    MethodName::new(name.clone()).map_err(|e| unfit(e.to_string()))?;
    let key = ItemKey::new(name).map_err(|e| unfit(e.to_string()))?;
    let entries = fs::read_dir(folder).map_err(|e| {
        KindError::Environment(format!("cannot list the backbone's folder `{}`: {e}; mend the path", folder.display()))
    })?;
    let mut there: Vec<PathBuf> =
        entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|p| p.is_file()).collect();
    there.sort();
    let called = |name: &str| there.iter().find(|path| path.file_name().is_some_and(|its| its == name)).cloned();
    let config = called(BackboneFiles::CONFIG)
        .ok_or_else(|| told("has no `config.json`; `tauflow kinds pretrained_backbones` says what it holds".into()))?;
    let ends = |ending: &str| there.iter().find(|path| path.extension().is_some_and(|its| its == ending)).cloned();
    let weights = called(BackboneFiles::WEIGHTS)
        .or_else(|| called("diffusion_pytorch_model.bin"))
        .or_else(|| ["safetensors", "bin", "pth"].into_iter().find_map(ends))
        .ok_or_else(|| told("has no weights: no file that ends in .safetensors, .bin or .pth".into()))?;
    let own = weights.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let mut files = vec![(BackboneFiles::CONFIG.to_owned(), config), (format!("{WEIGHTS}{own}"), weights)];
    files.extend(called(BackboneFiles::SCHEDULER).map(|path| (BackboneFiles::SCHEDULER.to_owned(), path)));
    Ok(SourceItem { key, files })
}
