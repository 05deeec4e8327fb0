#![doc = include_str!("bridge_refinement.md")]

use crate::{
    device::{self, CORES, NetworkDevice, Place},
    model::Model,
    refinement::{endpoint, features, model_needs_gbuffer},
    rollout::{Denoiser, bridge_stop, local_steps},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tauflow_contract::{
    Action, All, Context, Each, Foreseen, Group, Kind, KindError, KindSpec, Known, Later, Media, Mode, Out, Outlook,
    Outputs, ParamProblem, Probe, Resources,
};
use tauflow_data::{
    facts::{self, CONDITIONING, PARAMETERIZATION, RUNGS},
    methods::{HOLD, LOCAL_STEP, Parameterization},
    records::{BridgeClock, BridgeSteps, ModelFile, PackedScene, RefinedImage},
};

/// The kind `bridge_refinement`.
pub struct BridgeRefinement;

/// Params of `bridge_refinement`: none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BridgeRefinementParams {
    /// Device of the networks; the outputs of a GPU depend on the machine.
    pub device: NetworkDevice,
}

const ENDPOINTS: Each<PackedScene> = Each::new("endpoints", "Scenes at consecutive sample counts, such as 1..10.");
const MC_NOISE: All<ModelFile> =
    All::new(Parameterization::McNoise.name(), "A solver with parameterization mc_noise: exactly one.").single();
const LOCAL_VELOCITY: All<ModelFile> =
    All::new(Parameterization::LocalVelocity.name(), "A solver with parameterization local_velocity: exactly one.")
        .single();

const MAIN: Group = Group::main(3);
const STEPS: Out<BridgeSteps> =
    Out::new(MAIN, "steps", "The images at every stop, and the clock of the training ladder.");

impl Kind for BridgeRefinement {
    type Params = BridgeRefinementParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "bridge_refinement",
            summary: "Moves endpoints to stops between the training rungs.",
            manual: include_str!("bridge_refinement.md"),
            mode: Mode::Map,
            inputs: vec![ENDPOINTS.port(), MC_NOISE.port(), LOCAL_VELOCITY.port()],
            outputs: vec![STEPS.port()],
            seeded: false,
        }
    }

    fn spec_for(params: &Self::Params) -> KindSpec {
        params.device.stated(Self::spec())
    }

    fn port_params() -> &'static [&'static str] {
        device::PORT_PARAMS
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        params.device.problems()
    }

    fn later() -> &'static [Later] {
        &[device::ON_THE_CPU]
    }

    fn resources(params: &Self::Params, _group: &str) -> Resources {
        params.device.resources(CORES).memory(2 << 30)
    }

    fn environment(params: &Self::Params, _group: &str, _probe: &dyn Probe) -> Option<Value> {
        Some(params.device.environment(Value::Null))
    }

    fn foresee(_params: &Self::Params, known: &Known) -> Outlook {
        let endpoints = known.each(ENDPOINTS);
        let mut problems: Vec<Foreseen> = Vec::new();
        if let Some(Err(error)) = endpoints.facts.get(RUNGS).map(|rungs| stops(&rungs)) {
            let told = error.to_string();
            let (what, hint) = told.split_once("; ").unwrap_or((&told, ""));
            problems.push(Foreseen::input(ENDPOINTS, what, hint));
        }
        let models = [(MC_NOISE, Parameterization::McNoise), (LOCAL_VELOCITY, Parameterization::LocalVelocity)];
        for (port, wanted) in models {
            let [model] = known.all(port) else { continue };
            if let Some(found) = model.facts.get(PARAMETERIZATION).filter(|found| *found != wanted) {
                let message = format!("`{}` has the parameterization `{}`", model.name, found.name());
                let hint = format!("connect a cell with `{}`", wanted.name());
                problems.push(Foreseen::input(port, message, hint));
            }
            if let Some(conditioning) = model.facts.get(CONDITIONING) {
                problems.extend(model_needs_gbuffer(&endpoints, model, conditioning));
            }
        }
        if let ([noise], [local]) = (known.all(MC_NOISE), known.all(LOCAL_VELOCITY)) {
            problems.extend(facts::same_rungs(LOCAL_VELOCITY, local, noise));
        }
        Outlook::default().but(problems)
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let place = Place::of(action.params.device)?;
        let model = |port, parameterization| expect(Model::read(ctx, action.only(port)?, &place)?, parameterization);
        let noise = model(MC_NOISE, Parameterization::McNoise)?;
        let local = model(LOCAL_VELOCITY, Parameterization::LocalVelocity)?;
        if noise.clock() != local.clock() {
            return Err(KindError::Input(
                "the two solvers were trained on different ladders; train both on the same rungs".into(),
            ));
        }
        let scene = action.read(ctx, ENDPOINTS)?;
        let stops = stops(&scene.counts)?;
        let mut images = Vec::new();
        for (done, (from, to)) in stops.iter().copied().enumerate() {
            ctx.check_cancelled()?;
            let start = endpoint(&scene, from)?;
            let said = |method: &str, nfe| RefinedImage { method: method.into(), from_spp: from, to_spp: to, nfe };
            images.push((said(HOLD, 0), start.clone()));
            let stepped = local_steps(&local, start, features(&local, &scene)?, from, to)?;
            images.push((said(LOCAL_STEP, to - from), stepped));
            let moved = bridge_stop(&noise, start, features(&noise, &scene)?, from, to)?;
            images.push((said(Parameterization::McNoise.name(), 1), moved));
            ctx.progress(done as u64 + 1, stops.len() as u64, &format!("{from} -> {to}"));
        }
        let clock = BridgeClock { n_min: noise.clock().n_min() as u64, n_max: noise.clock().n_max() as u64 };
        Ok(Outputs::default().put(STEPS, BridgeSteps { clock, images }.store(ctx)?))
    }
}

/// Adjacent stops k -> k+1, then direct ones k -> last that are not adjacent.
fn stops(counts: &[u64]) -> Result<Vec<(u64, u64)>, KindError> {
    if counts.len() < 3 || counts.windows(2).any(|w| w[1] != w[0] + 1) {
        return Err(KindError::Input(format!(
            "the bridge needs at least three consecutive rungs, but has {counts:?}; write for example `rungs: [1, 2, \
            3, 4, 5, 6, 7, 8, 9, 10]`"
        )));
    }
    let last = counts[counts.len() - 1];
    let adjacent = counts.windows(2).map(|w| (w[0], w[1]));
    let direct = counts[..counts.len() - 2].iter().map(|k| (*k, last));
    Ok(adjacent.chain(direct).collect())
}

fn expect(model: Model, parameterization: Parameterization) -> Result<Model, KindError> {
    let found = model.parameterization();
    if found == parameterization {
        return Ok(model);
    }
    Err(KindError::Input(format!(
        "input `{}` has a solver with parameterization `{}`; connect a different cell",
        parameterization.name(),
        found.name()
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nine_adjacent_and_eight_direct_stops() {
        let counts: Vec<u64> = (1..=10).collect();
        let stops = stops(&counts).expect("consecutive");
        assert_eq!(stops.len(), 17);
        assert_eq!((stops[0], stops[8], stops[9], stops[16]), ((1, 2), (9, 10), (1, 10), (8, 10)));
        assert!(super::stops(&[1, 2, 4]).is_err());
    }
}
