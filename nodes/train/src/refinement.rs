#![doc = include_str!("refinement.md")]

use crate::{
    device,
    mirrors::Mirrored,
    model::Model,
    parameterization::Conditioning,
    rollout::{Course, Denoiser, rollout},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tauflow_contract::{
    Action, Artifact, Collection, Context, InputPort, ItemKey, Kind, KindError, KindSpec, Mode, OutputPort, Outputs,
    ParamProblem,
};
use tauflow_data::{
    Image,
    formats::{JSON, MODEL, PACKED, PackedScene, REFINED, RefinedImage, store_refined},
    time::TimeGrid,
    timing::{Repeated, TimedImage, Timing, machine},
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
    /// Views of the image whose mean a model call is: 1, 2 for its mirror image too, 4 for both upside down as well, or 8 for all
    /// four with rows for columns.
    #[schemars(extend("enum" = [1, 2, 4, 8]))]
    pub mirrors: u64,
    /// Times that `timing` measures each number of calls.
    #[schemars(range(min = 1, max = 1000))]
    pub repeats: u64,
}

impl Default for RefinementParams {
    fn default() -> Self {
        Self { nfe: vec![1, 2, 9, 20, 50], from: 1, grid: TimeGrid::Ladder, mirrors: 1, repeats: 3 }
    }
}

const INPUTS: &[InputPort] = &[
    InputPort::each("endpoints", PACKED, "The scenes whose endpoints are refined."),
    InputPort::whole("model", MODEL, "The trained solver: one."),
    InputPort::each("after", "*", "What must be there before `timing` measures, so that methods take turns.").or_none(),
];
/// Most model calls of a rollout.
const MOST_CALLS: u64 = 10_000;
/// Group of the output port that is measured.
const TIMING: &str = "timing";
const OUTPUTS: &[OutputPort] = &[
    OutputPort::new("refined", REFINED, "One image for each number of model calls."),
    OutputPort::new("timing", JSON, "How long each takes, on all cores.").in_group(TIMING).measured(),
];

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
            outputs: device::ports!(OUTPUTS),
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut problems = Vec::new();
        if params.nfe.is_empty() || params.nfe[0] == 0 || params.nfe.windows(2).any(|w| w[1] <= w[0]) {
            problems.push(ParamProblem::new(
                "/nfe",
                "the numbers of model calls must increase from at least 1",
                "write for example `nfe: [1, 2, 9, 20, 50]`",
            ));
        }
        if params.nfe.last().is_some_and(|most| *most > MOST_CALLS) {
            let problem = format!("more than {MOST_CALLS} model calls");
            problems.push(ParamProblem::new("/nfe", problem, "take fewer: many calls change nothing any more"));
        }
        if !Mirrored::VIEWS.contains(&(params.mirrors as usize)) {
            let problem = format!("{} views of an image", params.mirrors);
            problems.push(ParamProblem::new("/mirrors", problem, "write 1, 2, 4 or 8"));
        }
        problems
    }

    fn project(params: &Self::Params, _item: Option<&ItemKey>, group: &str) -> Value {
        let mut value = serde_json::to_value(params).expect("plain data");
        if let Value::Object(fields) = &mut value {
            if group != TIMING {
                fields.remove("repeats");
            }
            // It came later: refinements of before stay what they are.
            if params.mirrors == 1 {
                fields.remove("mirrors");
            }
        }
        value
    }

    fn environment(_params: &Self::Params, group: &str) -> Value {
        device::environment(if group == TIMING { machine() } else { Value::Null })
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let model = load_model(ctx, action.whole("model")?, "model")?;
        let scene = PackedScene::from_bytes(&ctx.part(action.each("endpoints")?, "")?)?;
        let endpoint = endpoint(&scene, action.params.from)?;
        let gbuffer = features(&model, &scene)?;
        let model = Mirrored::new(&model, action.params.mirrors as usize)?;
        if action.group == TIMING {
            let timing = timed(ctx, &model, endpoint, gbuffer, &action.params)?;
            return Ok(Outputs::default().item("timing", Artifact::blob(JSON, ctx.put_json(&timing)?)));
        }
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
        Ok(Outputs::default().item("refined", store_refined(ctx, images, None, Vec::new())?))
    }
}

/// What each number of calls takes, once unmeasured and then in turns.
fn timed(
    ctx: &Context<'_>,
    model: &Mirrored<'_>,
    endpoint: &Image,
    gbuffer: Option<&Image>,
    params: &RefinementParams,
) -> Result<Timing, KindError> {
    let course = |nfe: u64| Course { from: params.from, steps: nfe as usize, grid: params.grid };
    rollout(model, endpoint, gbuffer, course(1))?;
    let entry = |nfe: &u64| TimedImage {
        method: model.parameterization().name().into(),
        from_spp: params.from,
        nfe: *nfe,
        took: Repeated::default(),
    };
    let mut entries: Vec<TimedImage> = params.nfe.iter().map(entry).collect();
    for done in 0..params.repeats {
        for entry in &mut entries {
            ctx.check_cancelled()?;
            let course = course(entry.nfe);
            entry.took.add(|| rollout(model, endpoint, gbuffer, course))?;
        }
        ctx.progress(done + 1, params.repeats, "rounds");
    }
    Ok(Timing { entries })
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirrors_are_in_keys_only_where_there_are_any_and_calls_have_bounds() {
        let of = |mirrors| RefinementParams { mirrors, ..RefinementParams::default() };
        let key = |mirrors, group| Refinement::project(&of(mirrors), None, group);
        for group in ["main", TIMING] {
            assert!(key(1, group).get("mirrors").is_none() && key(2, group) != key(4, group));
        }
        assert!([1, 2, 4, 8].iter().all(|mirrors| Refinement::check(&of(*mirrors)).is_empty()));
        let calls = |nfe: &[u64]| RefinementParams { nfe: nfe.to_vec(), ..RefinementParams::default() };
        assert!(Refinement::check(&calls(&[1, 10_000])).is_empty());
        assert!(
            [&[][..], &[0, 1], &[2, 2], &[1, u64::MAX]]
                .iter()
                .all(|nfe| Refinement::check(&calls(nfe))[0].pointer == "/nfe")
        );
        assert!([0, 3, 16].iter().all(|mirrors| Refinement::check(&of(*mirrors))[0].pointer == "/mirrors"));
    }
}
