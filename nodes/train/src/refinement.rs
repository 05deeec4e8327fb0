#![doc = include_str!("refinement.md")]

use crate::{
    device::{self, CORES, NetworkDevice, Place},
    mirrors::Mirrored,
    model::Model,
    network_calls::NetworkCalls,
    rollout::{Course, Denoiser, clean_estimate, rollout, rollout_states},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tauflow_contract::{
    Action, All, Any, Before, Context, Each, Foreseen, Group, ItemKey, Kind, KindError, KindSpec, Known, Later, Media,
    Mode, Out, Outlook, Outputs, ParamProblem, Probe, Resources, Source,
};
use tauflow_data::{
    Image,
    facts::{self, CONDITIONING, HAS_GBUFFER, NFE, RUNGS, SPP},
    methods::{Conditioning, MethodName, Parameterization},
    records::{BridgeClock, ModelFile, PackedScene, Refined, RefinedImage, Rollout, RolloutState, TimedImage, Timing},
    time::TimeGrid,
    timing::{Repeated, measuring},
    views::Views,
};

/// The behaviour before these params existed.
const LATER: &[Later] = &[
    Later { pointer: "/method", before: Before::Null },
    Later { pointer: "/mirrors", before: Before::Integer(1) },
    Later { pointer: "/blank", before: Before::Text("none") },
    Later { pointer: "/unknown_count", before: Before::Flag(false) },
    device::ON_THE_CPU,
];

/// The kind `refinement`.
pub struct Refinement;

/// Channels of a G-buffer to be set to 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Blank {
    /// Nothing is.
    None,
    /// The albedo.
    Albedo,
    /// The normals.
    Normals,
}

impl Blank {
    /// A G-buffer [H, W, 6] without these channels.
    fn of(self, gbuffer: Option<&Image>) -> Result<Option<Image>, KindError> {
        let channels = match self {
            Self::None => return Ok(gbuffer.cloned()),
            Self::Albedo => 0..3,
            Self::Normals => 3..6,
        };
        let mut blank = gbuffer.cloned().ok_or_else(|| {
            KindError::Input(
                "`blank` requires a model with G-buffers, but this one was trained without; connect a different \
                model, or remove `blank`"
                    .into(),
            )
        })?;
        for pixel in blank.data_mut().chunks_exact_mut(6) {
            pixel[channels.clone()].fill(0.0);
        }
        Ok(Some(blank))
    }
}

/// Params of `refinement`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RefinementParams {
    /// Name of the method in tables; that of the model's parameterization by default.
    pub method: Option<MethodName>,
    /// Numbers of network calls, increasing.
    pub nfe: NetworkCalls,
    /// Sample count of the endpoint to start from.
    #[schemars(range(min = 1))]
    pub from: u64,
    /// Time grid of the rollouts.
    pub grid: TimeGrid,
    /// Number of mirrored and rotated copies over which each call is averaged: 1, 2 (mirrored), 4 (also upside down) or
    /// 8 (also transposed).
    pub mirrors: Views,
    /// Channels of the G-buffer that are set to 0, to measure how much the solver uses them.
    pub blank: Blank,
    /// Do not tell the model the sample count of the endpoint. Requires `nfe: [1]` and a model that was trained with
    /// `unknown_counts`.
    pub unknown_count: bool,
    /// Device of the network; the outputs of a GPU depend on the machine.
    pub device: NetworkDevice,
    /// Number of measurements by `timing` per number of calls.
    #[schemars(range(min = 1, max = 1000))]
    pub repeats: u64,
}

impl Default for RefinementParams {
    fn default() -> Self {
        Self {
            method: None,
            nfe: NetworkCalls::default(),
            from: 1,
            grid: TimeGrid::Ladder,
            mirrors: Views::ONE,
            blank: Blank::None,
            unknown_count: false,
            device: NetworkDevice::Cpu,
            repeats: 3,
        }
    }
}

impl RefinementParams {
    /// What the method is called in tables.
    fn method(&self, parameterization: Parameterization) -> String {
        self.method.as_ref().map_or(parameterization.name(), MethodName::as_str).to_owned()
    }

    /// The endpoint refined by `nfe` calls.
    fn refined(
        &self,
        model: &dyn Denoiser,
        endpoint: &Image,
        gbuffer: Option<&Image>,
        nfe: u64,
    ) -> Result<Image, KindError> {
        if self.unknown_count {
            return clean_estimate(model, endpoint, gbuffer, None);
        }
        rollout(model, endpoint, gbuffer, Course { from: self.from, steps: nfe as usize, grid: self.grid })
    }
}

const ENDPOINTS: Each<PackedScene> = Each::new("endpoints", "The scenes whose endpoints are refined.");
const MODEL: All<ModelFile> = All::new("model", "The trained solver: exactly one.").single();
const AFTER: Each<Any> =
    Each::any("after", "Completed before `timing` measures, so that methods take turns.").or_none();

const MAIN: Group = Group::main(4);
const MEASURED: Group = Group::new("timing", 5);
const BETWEEN: Group = Group::new("states", 2);
const REFINED: Out<Refined> = Out::new(MAIN, "refined", "One image per number of network calls.");
const TIMING: Out<Timing> = Out::new(MEASURED, "timing", "Wall time of each number of calls, on all cores.").measured();
const STATES: Out<Rollout> = Out::new(BETWEEN, "states", "The state after each network call of each rollout.");

impl Kind for Refinement {
    type Params = RefinementParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "refinement",
            summary: "Denoises endpoints with a trained solver in any number of steps.",
            manual: include_str!("refinement.md"),
            mode: Mode::Map,
            inputs: vec![ENDPOINTS.port(), MODEL.port(), AFTER.port()],
            outputs: vec![REFINED.port(), TIMING.port(), STATES.port()],
            seeded: false,
        }
    }

    fn foresee(params: &Self::Params, known: &Known) -> Outlook {
        let endpoints = known.each(ENDPOINTS);
        let mut problems: Vec<Foreseen> = facts::rung(&endpoints, params.from, "/from").into_iter().collect();
        if let [model] = known.all(MODEL) {
            let conditioning = model.facts.get(CONDITIONING);
            problems.extend(conditioning.and_then(|of| model_needs_gbuffer(&endpoints, model, of)));
            if params.blank != Blank::None && conditioning == Some(Conditioning::Rgb) {
                let message = format!("`blank` needs a model with G-buffers, but `{}` has none", model.name);
                problems.push(Foreseen::param("/blank", message, "connect another model, or remove `blank`"));
            }
            problems.extend(outside_ladder(model, params.from, "/from"));
        }
        let facts =
            facts::image_of(&endpoints.facts).with(SPP, vec![params.from]).with(NFE, params.nfe.counts().to_vec());
        Outlook::default().with(REFINED, facts).but(problems)
    }

    fn work(params: &Self::Params, group: &str) -> f64 {
        let calls = params.nfe.counts().iter().sum::<u64>() as f64;
        let rounds = if group == MEASURED.name { params.repeats + 1 } else { 1 };
        calls * u64::from(params.mirrors) as f64 * rounds as f64
    }

    fn resources(params: &Self::Params, _group: &str) -> Resources {
        params.device.resources(CORES).memory(2 << 30)
    }

    fn project(params: &Self::Params, _item: Option<&ItemKey>, group: &str) -> Value {
        let mut value = serde_json::to_value(params).expect("plain data");
        if group != MEASURED.name
            && let Value::Object(fields) = &mut value
        {
            fields.remove("repeats");
        }
        value
    }

    fn later() -> &'static [Later] {
        LATER
    }

    fn spec_for(params: &Self::Params) -> KindSpec {
        params.device.stated(Self::spec())
    }

    fn port_params() -> &'static [&'static str] {
        device::PORT_PARAMS
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut problems = params.device.problems();
        if params.unknown_count && params.nfe.counts() != [1] {
            let message = "more than one network call needs the sample count of the endpoint";
            problems.push(ParamProblem::new("/unknown_count", message, "set `nfe: [1]`"));
        }
        problems
    }

    fn environment(params: &Self::Params, group: &str, probe: &dyn Probe) -> Option<Value> {
        Some(params.device.environment(if group == MEASURED.name { measuring(probe) } else { Value::Null }))
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let model = Model::read(ctx, action.only(MODEL)?, &Place::of(action.params.device)?)?;
        let scene = action.read(ctx, ENDPOINTS)?;
        let endpoint = endpoint(&scene, action.params.from)?;
        let gbuffer = action.params.blank.of(features(&model, &scene)?)?;
        let gbuffer = gbuffer.as_ref();
        let model = Mirrored::new(&model, action.params.mirrors);
        if action.group == MEASURED.name {
            let timing = timed(ctx, &model, endpoint, gbuffer, &action.params)?;
            return Ok(Outputs::default().put(TIMING, timing.store(ctx)?));
        }
        if action.group == BETWEEN.name {
            let states = states(ctx, &model, endpoint, gbuffer, &action.params)?;
            return Ok(Outputs::default().put(STATES, states.store(ctx)?));
        }
        let mut images = Vec::new();
        let counts = action.params.nfe.counts();
        for (done, nfe) in counts.iter().enumerate() {
            ctx.check_cancelled()?;
            let image = action.params.refined(&model, endpoint, gbuffer, *nfe)?;
            let said = RefinedImage {
                method: action.params.method(model.parameterization()),
                from_spp: action.params.from,
                to_spp: model.clock().n_max() as u64,
                nfe: *nfe,
            };
            images.push((said, image));
            ctx.progress(done as u64 + 1, counts.len() as u64, &format!("NFE {nfe}"));
        }
        Ok(Outputs::default().put(REFINED, Refined { images, note: None, sampler: scene.sampler }.store(ctx)?))
    }
}

/// The states of the rollouts of each number of calls.
fn states(
    ctx: &Context<'_>,
    model: &Mirrored<'_>,
    endpoint: &Image,
    gbuffer: Option<&Image>,
    params: &RefinementParams,
) -> Result<Rollout, KindError> {
    let (clock, method) = (model.clock(), params.method(model.parameterization()));
    let mut states = Vec::new();
    for (done, nfe) in params.nfe.counts().iter().copied().enumerate() {
        ctx.check_cancelled()?;
        let course = Course { from: params.from, steps: nfe as usize, grid: params.grid };
        let own = if params.unknown_count {
            vec![(1.0, params.refined(model, endpoint, gbuffer, nfe)?)]
        } else {
            rollout_states(model, endpoint, gbuffer, course)?
        };
        for (calls, (tau, image)) in (1..).zip(own) {
            let said = RolloutState { method: method.clone(), from_spp: params.from, nfe, calls, tau };
            states.push((said, image));
        }
        ctx.progress(done as u64 + 1, params.nfe.counts().len() as u64, &format!("NFE {nfe}"));
    }
    let clock = BridgeClock::of(&clock);
    Ok(Rollout { clock, states })
}

/// The time of each number of calls: one warm-up, then in turns.
fn timed(
    ctx: &Context<'_>,
    model: &Mirrored<'_>,
    endpoint: &Image,
    gbuffer: Option<&Image>,
    params: &RefinementParams,
) -> Result<Timing, KindError> {
    params.refined(model, endpoint, gbuffer, 1)?;
    let entry = |nfe: &u64| TimedImage {
        method: params.method(model.parameterization()),
        from_spp: params.from,
        nfe: *nfe,
        took: Repeated::default(),
    };
    let mut entries: Vec<TimedImage> = params.nfe.counts().iter().map(entry).collect();
    for done in 0..params.repeats {
        for entry in &mut entries {
            ctx.check_cancelled()?;
            let nfe = entry.nfe;
            entry.took.add(|| params.refined(model, endpoint, gbuffer, nfe))?;
        }
        ctx.progress(done + 1, params.repeats, "rounds");
    }
    Ok(Timing::here(entries))
}

/// Whether a rollout of a model can start at a sample count: below the last rung of its training ladder.
fn outside_ladder(model: &Source, from: u64, pointer: &str) -> Option<Foreseen> {
    let rungs = model.facts.get(RUNGS)?;
    let (first, last) = (*rungs.first()?, *rungs.last()?);
    (from < first || from >= last).then(|| {
        let name = &model.name;
        let message = format!("`{name}` was trained from {first} to {last} samples, and cannot start at {from}");
        Foreseen::param(pointer, message, format!("use a rung from {first} to below {last}"))
    })
}

/// Whether endpoints lack the G-buffers that a model needs.
pub(crate) fn model_needs_gbuffer(endpoints: &Source, model: &Source, conditioning: Conditioning) -> Option<Foreseen> {
    let lacks = conditioning == Conditioning::Gbuffer && endpoints.facts.get(HAS_GBUFFER) == Some(false);
    lacks.then(|| {
        let message = format!("`{}` has no G-buffers, but the model of `{}` needs them", endpoints.name, model.name);
        let hint = format!("connect `gbuffers` of `{}`, or another model", endpoints.name);
        Foreseen::input(ENDPOINTS, message, hint)
    })
}

/// The rung of `spp` samples.
pub(crate) fn endpoint(scene: &PackedScene, spp: u64) -> Result<&Image, KindError> {
    scene.counts.iter().position(|n| *n == spp).map(|i| &scene.states[i]).ok_or_else(|| {
        KindError::Input(format!("the scene has no rung of {spp} samples, only {:?}; change the rungs", scene.counts))
    })
}

/// The additional input of the model.
pub(crate) fn features<'a>(model: &Model, scene: &'a PackedScene) -> Result<Option<&'a Image>, KindError> {
    match model.info().conditioning {
        Conditioning::Rgb => Ok(None),
        Conditioning::Gbuffer => scene.gbuffer.as_ref().map(Some).ok_or_else(|| {
            KindError::Input(
                "the model needs G-buffers, but the scene has none; connect `gbuffers` of its `dataset_packing`".into(),
            )
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use tauflow_contract::{KindRow, NodeKind as _};

    #[test]
    fn mirrors_are_in_keys_only_where_there_are_any() {
        let row = KindRow::<Refinement>::new();
        let key = |mirrors: u64, group| {
            let params = row.resolve(&json!({ "mirrors": mirrors })).expect("a number of views");
            row.projection(&params)(None, group)
        };
        for group in [MAIN.name, MEASURED.name, BETWEEN.name] {
            assert!(key(1, group).get("mirrors").is_none() && key(2, group) != key(4, group));
        }
    }

    #[test]
    fn blank_channels_are_zero_and_the_others_stay() {
        let seen = Image::from_data(1, 2, 6, (1..=12).map(|value| value as f32).collect()).expect("two pixels");
        let of = |blank: Blank| blank.of(Some(&seen)).expect("there is one").expect("an image").data().to_vec();
        assert_eq!(of(Blank::None), seen.data());
        assert_eq!(of(Blank::Albedo), [0.0, 0.0, 0.0, 4.0, 5.0, 6.0, 0.0, 0.0, 0.0, 10.0, 11.0, 12.0]);
        assert_eq!(of(Blank::Normals), [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 7.0, 8.0, 9.0, 0.0, 0.0, 0.0]);
        assert!(Blank::None.of(None).expect("nothing to set").is_none());
        assert!(Blank::Normals.of(None).expect_err("nothing to set").to_string().contains("a model with G-buffers"));
    }

    #[test]
    fn params_that_cannot_be_are_problems_at_their_place() {
        let row = KindRow::<Refinement>::new();
        assert!(row.resolve(&json!({ "nfe": [1, 10_000], "mirrors": 8 })).is_ok());
        for (params, pointer) in [
            (json!({ "nfe": [2, 2] }), "/nfe"),
            (json!({ "mirrors": 3 }), "/mirrors"),
            (json!({ "nfe": [1, 2], "unknown_count": true }), "/unknown_count"),
        ] {
            assert_eq!(row.resolve(&params).expect_err("wrong")[0].pointer, pointer, "{params}");
        }
    }
}
