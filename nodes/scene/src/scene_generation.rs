#![doc = include_str!("scene_generation.md")]

mod arrange;
mod assemble;
mod camera;
mod cast;
mod hour;
mod lamps;
mod layouts;
mod params;
mod place;
mod props;
mod shell;
mod stage;
mod views;

pub use params::{HoldOut, MaxDepth, SceneGenerationParams};

use assemble::Which;
use serde_json::Value;
use tauflow_contract::{
    Action, All, Context, Group, ItemKey, Kind, KindError, KindSpec, Media, Mode, Out, Outputs, ParamProblem,
    SourceItem, derive_seed,
};
use tauflow_data::{
    Scene, Stratum,
    records::{Asset, SceneRecord},
    scene::Recipe,
};

const ASSETS: All<Asset> = All::new("assets", "HDRIs and objects to use.").or_none();
const SCENES: Out<SceneRecord> = Out::new(Group::main(5), "scenes", "One scene per item of the pool.");

/// The kind `scene_generation`.
pub struct SceneGeneration;

impl Kind for SceneGeneration {
    type Params = SceneGenerationParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "scene_generation",
            summary: "Generates scenes for regimes x contexts from layouts, objects, skies and materials.",
            manual: include_str!("scene_generation.md"),
            mode: Mode::Source,
            inputs: vec![ASSETS.port()],
            outputs: vec![SCENES.port()],
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

    fn seed(pipeline_seed: u64, item: &str) -> u64 {
        views::item_seed(pipeline_seed, Self::spec().name, item)
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
        let shared = views::stratum_seed(action.seed, index)?;
        let seed = match action.params.library {
            0 => shared,
            library => derive_seed(shared, "library", &library.to_string()),
        };
        let which = Which::of(&action.params, seed, stratum, index);
        let Which { content, view } = which;
        // The draws of a content are the same in all its views; the renderer's random numbers differ per view.
        let content_seed = derive_seed(seed, "content", &content.to_string());
        let (scene, recipe) = assemble::scene(ctx, &action.params, &pool, stratum, which, content_seed)?;
        let scene = Scene { seed: derive_seed(content_seed, "view", &view.to_string()), ..scene };
        let recipe = Recipe { index, content: Some(content), view, ..recipe };
        Ok(Outputs::default().put(SCENES, SceneRecord { scene, recipe }.store(ctx)?))
    }
}

#[cfg(test)]
mod standing;
#[cfg(test)]
mod tests;
