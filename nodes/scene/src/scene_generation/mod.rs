#![doc = include_str!("../scene_generation.md")]

mod assemble;
mod camera;
mod cast;
mod forms;
mod layouts;
mod materials;
mod noise;
mod params;
mod skies;
mod stage;
mod surfaces;
mod textures;

pub use params::{
    CausticRanges, DiffuseRanges, GlossyRanges, HoldOut, MaxDepth, Range, RefractiveRanges, SceneGenerationParams,
};

use serde_json::Value;
use tauflow_contract::{
    Action, All, Context, Group, ItemKey, Kind, KindError, KindSpec, Later, Media, Mode, Out, Outputs, ParamProblem,
    SourceItem, derive_seed,
};
use tauflow_data::{
    Stratum,
    records::{Asset, SceneRecord},
};

const ASSETS: All<Asset> = All::new("assets", "HDRIs and objects to build with.").or_none();
const SCENES: Out<SceneRecord> = Out::new(Group::main(3), "scenes", "One scene for each item of the pool.");

/// The kind `scene_generation`.
pub struct SceneGeneration;

impl Kind for SceneGeneration {
    type Params = SceneGenerationParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "scene_generation",
            summary: "Draws scenes over regimes x contexts from layouts, objects, skies and materials.",
            manual: include_str!("../scene_generation.md"),
            mode: Mode::Source,
            inputs: const { &[ASSETS.port()] },
            outputs: const { &[SCENES.port()] },
            seeded: true,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        params.problems()
    }

    fn items(params: &Self::Params) -> Result<Vec<SourceItem>, KindError> {
        Ok(params
            .counts()
            .into_iter()
            .flat_map(|(stratum, count)| (0..count).map(move |index| stratum.item_key(index)))
            .map(|key| SourceItem { key, files: Vec::new() })
            .collect())
    }

    fn project(params: &Self::Params, item: Option<&ItemKey>, _group: &str) -> Value {
        match item.and_then(|key| Stratum::of_key(key.as_str())) {
            Some((stratum, _)) => params.read_by(stratum),
            None => serde_json::to_value(params).expect("params serialise"),
        }
    }

    fn later() -> &'static [Later] {
        params::LATER
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let key = action.item()?;
        let (stratum, index) = Stratum::of_key(key.as_str()).ok_or_else(|| {
            KindError::Input(format!("item `{key}` names no stratum and index, as L1-open-000123 does"))
        })?;
        let pool = match action.all_if(ASSETS)? {
            Some(assets) => cast::Pool::load(ctx, assets)?,
            None => cast::Pool::default(),
        };
        let seed = match action.params.library {
            0 => action.seed,
            library => derive_seed(action.seed, "library", &library.to_string()),
        };
        let (scene, recipe) = assemble::scene(ctx, &action.params, &pool, stratum, index, seed)?;
        Ok(Outputs::default().put(SCENES, SceneRecord { scene, recipe }.store(ctx)?))
    }
}

#[cfg(test)]
mod tests;
