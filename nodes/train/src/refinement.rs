#![doc = include_str!("refinement.md")]

use crate::{
    model::Model,
    parameterization::Conditioning,
    rollout::{Course, Denoiser, rollout},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::{
    Action, Artifact, Collection, Context, InputPort, Kind, KindError, KindSpec, Mode, OutputPort, Outputs,
    ParamProblem,
};
use tauflow_data::{
    Image,
    formats::{MODEL, PACKED, PackedScene, REFINED, Refined, RefinedImage, refined_part},
    time::TimeGrid,
};

/// The kind `refinement`.
pub struct Refinement;

/// Params of `refinement`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RefinementParams {
    /// Numbers of model calls, increasing.
    #[schemars(length(min = 1))]
    pub nfe: Vec<u64>,
    /// Sample count of the endpoint to start from.
    #[schemars(range(min = 1))]
    pub from: u64,
    /// How the times of a rollout are spread.
    pub grid: TimeGrid,
}

impl Default for RefinementParams {
    fn default() -> Self {
        Self { nfe: vec![1, 2, 9, 20, 50], from: 1, grid: TimeGrid::Ladder }
    }
}

const INPUTS: &[InputPort] = &[
    InputPort::each("endpoints", PACKED, "The scenes whose endpoints are refined."),
    InputPort::whole("model", MODEL, "The trained solver: one."),
];
const OUTPUTS: &[OutputPort] = &[OutputPort::new("refined", REFINED, "One image for each number of model calls.")];

impl Kind for Refinement {
    type Params = RefinementParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "refinement",
            version: 3,
            summary: "Refines endpoints with a trained solver in any number of steps.",
            manual: include_str!("refinement.md"),
            mode: Mode::Map,
            inputs: INPUTS,
            outputs: OUTPUTS,
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        if params.nfe.is_empty() || params.nfe[0] == 0 || params.nfe.windows(2).any(|w| w[1] <= w[0]) {
            return vec![ParamProblem::new(
                "/nfe",
                "the numbers of model calls must increase from at least 1",
                "write for example `nfe: [1, 2, 9, 20, 50]`",
            )];
        }
        Vec::new()
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let model = load_model(ctx, action.whole("model")?, "model")?;
        let scene = PackedScene::from_bytes(&ctx.part(action.each("endpoints")?, "")?)?;
        let endpoint = endpoint(&scene, action.params.from)?;
        let gbuffer = features(&model, &scene)?;
        let mut images = Vec::new();
        let total = action.params.nfe.len() as u64;
        for (done, nfe) in action.params.nfe.iter().enumerate() {
            ctx.check_cancelled()?;
            let course = Course { from: action.params.from, steps: *nfe as usize, grid: action.params.grid };
            let image = rollout(&model, endpoint, gbuffer, course)?;
            let said = RefinedImage {
                method: model.parameterization().name().into(),
                from_spp: action.params.from,
                to_spp: model.clock().n_max() as u64,
                nfe: *nfe,
            };
            images.push((said, image));
            ctx.progress(done as u64 + 1, total, &format!("NFE {nfe}"));
        }
        Ok(Outputs::default().item("refined", store(ctx, images, Vec::new())?))
    }
}

/// The one model of a collection.
pub(crate) fn load_model(ctx: &Context<'_>, models: &Collection, port: &str) -> Result<Model, KindError> {
    let mut artifacts = models.iter();
    let (Some((_, artifact)), None) = (artifacts.next(), artifacts.next()) else {
        return Err(KindError::Input(format!(
            "input `{port}` takes one model and got {}; name one cell, as in \
             `solvers[parameterization=mc_noise, conditioning=rgb].model`, or give this node the same matrix",
            models.len()
        )));
    };
    Model::load(&ctx.part(artifact, "")?)
}

/// The rung of `spp` samples.
pub(crate) fn endpoint(scene: &PackedScene, spp: u64) -> Result<&Image, KindError> {
    scene.counts.iter().position(|n| *n == spp).map(|i| &scene.states[i]).ok_or_else(|| {
        KindError::Input(format!("the scene has no rung of {spp} samples, only {:?}; change the rungs", scene.counts))
    })
}

/// What the model sees beside the state.
pub(crate) fn features<'a>(model: &Model, scene: &'a PackedScene) -> Result<Option<&'a Image>, KindError> {
    match model.info().conditioning {
        Conditioning::Rgb => Ok(None),
        Conditioning::Gbuffer => scene.gbuffer.as_ref().map(Some).ok_or_else(|| {
            KindError::Input(
                "the model was trained with G-buffers and the scene has none; connect `gbuffers` of its \
                 `dataset_packing`"
                    .into(),
            )
        }),
    }
}

/// Stores refined images, and more parts beside them.
pub(crate) fn store(
    ctx: &Context<'_>,
    images: Vec<(RefinedImage, Image)>,
    mut parts: Vec<(String, tauflow_contract::Digest)>,
) -> Result<Artifact, KindError> {
    let mut said = Vec::with_capacity(images.len());
    for (index, (meta, image)) in images.into_iter().enumerate() {
        parts.push((refined_part(index), ctx.put(&image.to_bytes())?));
        said.push(meta);
    }
    parts.push(("meta.json".into(), ctx.put_json(&Refined { images: said })?));
    Ok(Artifact::tree(REFINED, parts))
}
