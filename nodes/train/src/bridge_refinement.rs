#![doc = include_str!("bridge_refinement.md")]

use crate::{
    bridge::{
        LocalRule, ReferenceSolver, blurred, bridge_stop, expected_stop, local_path, stochastic_stop, timed_stop,
    },
    device::{self, CORES, NetworkDevice, Place},
    model::Model,
    refinement::{endpoint, features, model_needs_gbuffer},
    rollout::{Denoiser, clean_estimate},
    space::Space,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use tauflow_contract::{
    Action, All, Context, Each, Foreseen, Group, Kind, KindError, KindSpec, Known, Later, Media, Mode, Out, Outlook,
    Outputs, ParamProblem, Probe, Resources, Source,
};
use tauflow_data::{
    Image,
    facts::{self, CONDITIONING, PARAMETERIZATION, RUNGS},
    methods::{
        BridgeMethod, EXPECTATION, GAUSSIAN, GAUSSIAN_TAU, HOLD, LOCAL_DELTA, LOCAL_STEP, Parameterization, STOCHASTIC,
    },
    records::{BridgeClock, BridgeSteps, Exposure, Ladder, ModelFile, PackedScene, RefinedImage, RefinedImages},
    rng::Stream,
};

/// The kind `bridge_refinement`.
pub struct BridgeRefinement;

/// Params of `bridge_refinement`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BridgeRefinementParams {
    /// Device of the networks; the outputs of a GPU depend on the machine.
    pub device: NetworkDevice,
    /// Standard deviation in pixels of a Gaussian filter in the network's place; none for no such rows.
    #[schemars(extend("exclusiveMinimum" = 0.0, "maximum" = 16.0))]
    pub gaussian: Option<f64>,
}

const ENDPOINTS: Each<PackedScene> = Each::new("endpoints", "Scenes at consecutive sample counts, such as 1..10.");
const MC_NOISE: All<ModelFile> =
    All::new(Parameterization::McNoise.name(), "A solver with parameterization mc_noise: exactly one.").single();
const LOCAL_VELOCITY: All<ModelFile> =
    All::new(Parameterization::LocalVelocity.name(), "A solver with parameterization local_velocity: exactly one.")
        .single();
const REFERENCES: Each<Ladder> =
    Each::new("references", "Held-out references of the same scenes: another random stream, many samples.").or_none();
const EXPOSURE: Each<Exposure> = Each::new("exposure", "The exposure of the same scenes, for references.").or_none();

const MAIN: Group = Group::main(5);
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
            inputs: vec![ENDPOINTS.port(), MC_NOISE.port(), LOCAL_VELOCITY.port(), REFERENCES.port(), EXPOSURE.port()],
            outputs: vec![STEPS.port()],
            seeded: true,
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
        let mut problems: Vec<Foreseen> = facts::independent(ENDPOINTS, &endpoints).into_iter().collect();
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
            problems.extend(facts::independent(port, model));
            problems.extend(outside(&endpoints, port, model));
            if let Some(conditioning) = model.facts.get(CONDITIONING) {
                problems.extend(model_needs_gbuffer(&endpoints, model, conditioning));
            }
        }
        if let ([noise], [local]) = (known.all(MC_NOISE), known.all(LOCAL_VELOCITY)) {
            problems.extend(facts::same_rungs(LOCAL_VELOCITY, local, noise));
        }
        let has = |name: &str| known.has(name);
        if has(REFERENCES.name()) != has(EXPOSURE.name()) {
            let message = "`references` and `exposure` are used together, but only one of them is connected";
            problems.push(Foreseen::input(REFERENCES, message, "connect both, or none"));
        }
        Outlook::default().but(problems)
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let place = Place::of(action.params.device)?;
        let model = |port, parameterization| expect(Model::read(ctx, action.only(port)?, &place)?, parameterization);
        let noise = model(MC_NOISE, Parameterization::McNoise)?;
        let local = model(LOCAL_VELOCITY, Parameterization::LocalVelocity)?;
        if [&noise, &local].iter().any(|model| !model.info().sampler.is_independent()) {
            return Err(KindError::Input(
                "what is expected at a stop is known for independent samples alone, but the solvers were trained on \
                others; train them on ladders with `sampler: independent`"
                    .into(),
            ));
        }
        if noise.clock() != local.clock() {
            return Err(KindError::Input(
                "the two solvers were trained on different ladders; train both on the same rungs".into(),
            ));
        }
        let setting = setting(&noise);
        if setting != self::setting(&local) {
            return Err(KindError::Input(format!(
                "the two solvers were trained in different settings, {setting:?} and {:?}; train both alike",
                self::setting(&local)
            )));
        }
        let scene = action.read(ctx, ENDPOINTS)?;
        if !scene.sampler.is_independent() {
            return Err(KindError::Input(
                "what is expected at a stop is known for independent samples alone, but those of the endpoints are \
                correlated; render them with `sampler: independent`"
                    .into(),
            ));
        }
        let held = match (action.read_if(ctx, REFERENCES)?, action.read_if(ctx, EXPOSURE)?) {
            (Some(ladder), Some(exposure)) => Some(HeldOut::new(&ladder, &exposure, &scene)?),
            (None, None) => None,
            _ => return Err(KindError::Input("`references` need `exposure`; connect both, or none".into())),
        };
        let stops = stops(&scene.counts)?;
        let mut images = RefinedImages::new();
        let (seen_by_noise, seen_by_local) = (features(&noise, &scene)?, features(&local, &scene)?);
        let starts = &scene.counts[..scene.counts.len() - 1];
        for (done, from) in starts.iter().copied().enumerate() {
            ctx.check_cancelled()?;
            let start = endpoint(&scene, from)?;
            let ends: Vec<u64> = stops.iter().filter(|stop| stop.0 == from).map(|stop| stop.1).collect();
            let mut put = |method: String, to_spp, nfe, image| {
                images.push((RefinedImage { method, from_spp: from, to_spp, nfe }, image));
            };
            ends.iter().for_each(|to| put(HOLD.into(), *to, 0, start.clone()));
            if let Some(sigma) = action.params.gaussian {
                let blurred = blurred(start, sigma);
                for to in &ends {
                    put(GAUSSIAN.into(), *to, 0, expected_stop(start, &blurred, (from, *to)));
                    put(GAUSSIAN_TAU.into(), *to, 0, timed_stop(&noise, start, &blurred, (from, *to))?);
                }
            }
            for space in [Space::Linear, Space::Log1p] {
                let known = held.as_ref().map(|held| held.solvers(&noise, &local, space)).transpose()?;
                let mut sources: Vec<(bool, &dyn Denoiser, &dyn Denoiser)> = vec![(false, &noise, &local)];
                sources.extend(known.as_ref().map(|(noise, local)| (true, noise as &dyn Denoiser, local as _)));
                for (reference, noise, local) in sources {
                    let calls = |count: u64| if reference { 0 } else { count };
                    let name = |rule| BridgeMethod { reference, log: space == Space::Log1p, rule }.name();
                    for (rule, label) in [(LocalRule::Step, LOCAL_STEP), (LocalRule::Delta, LOCAL_DELTA)] {
                        let last = ends.iter().copied().max().unwrap_or(from);
                        let path = local_path(local, start, seen_by_local, (from, last), (space, rule))?;
                        for to in &ends {
                            put(name(label), *to, calls(to - from), path[(to - from - 1) as usize].clone());
                        }
                    }
                    for to in &ends {
                        let moved = bridge_stop(noise, start, seen_by_noise, (from, *to), space)?;
                        put(name(Parameterization::McNoise.name()), *to, calls(1), moved);
                    }
                }
            }
            // The law is of linear radiance.
            let clean = clean_estimate(&noise, start, seen_by_noise, Some(from))?;
            let estimates = [(false, Some(&clean)), (true, held.as_ref().map(|held| &held.image))];
            for (reference, clean) in estimates {
                let Some(clean) = clean else { continue };
                let name = |rule| BridgeMethod { reference, log: false, rule }.name();
                for to in &ends {
                    let expected = expected_stop(start, clean, (from, *to));
                    if let Some(held) = &held {
                        // The same noise for both estimates.
                        let stream = Stream::new(action.seed, &[from, *to]);
                        let drawn = stochastic_stop(&expected, &held.variance, (from, *to), stream);
                        put(name(STOCHASTIC), *to, u64::from(!reference), drawn);
                    }
                    put(name(EXPECTATION), *to, u64::from(!reference), expected);
                }
            }
            ctx.progress(done as u64 + 1, starts.len() as u64, &format!("from {from} spp"));
        }
        let clock = BridgeClock::of(&noise.clock());
        Ok(Outputs::default().put(STEPS, BridgeSteps { clock, setting, images }.store(ctx)?))
    }
}

/// A held-out reference, exposed, with the variance of its single samples.
struct HeldOut {
    image: Image,
    variance: Image,
}

impl HeldOut {
    fn new(ladder: &Ladder, exposure: &Exposure, scene: &PackedScene) -> Result<Self, KindError> {
        let last = ladder.rungs.last().ok_or_else(|| KindError::Input("the held-out reference has no rung".into()))?;
        let needed = scene.counts.last().copied().unwrap_or(0);
        if last.spp <= needed {
            return Err(KindError::Input(format!(
                "the held-out reference has {} samples, but the endpoints have up to {needed}; render references of \
                many more",
                last.spp
            )));
        }
        if !ladder.meta.sampler.is_independent() {
            return Err(KindError::Input(
                "the samples of the held-out reference are correlated, so their variance is unknown; render it with \
                `sampler: independent`"
                    .into(),
            ));
        }
        let factor = exposure.factor;
        let exposed = |image: &Image, factor: f64| image.map(|v| (f64::from(v) * factor) as f32);
        let (image, variance) = (exposed(&last.image, factor), exposed(&ladder.variance, factor * factor));
        if let Some(state) = scene.states.first().filter(|state| !state.same_shape(&image)) {
            return Err(KindError::Input(format!(
                "the held-out reference has {} x {} pixels, but the endpoints have {} x {}; render both with the same \
                `resolution`",
                image.width(),
                image.height(),
                state.width(),
                state.height()
            )));
        }
        image.finite("held-out reference", "render it again")?;
        variance.finite("variance of the held-out reference", "render it again")?;
        Ok(Self { image, variance })
    }

    /// Solvers in a space that know the reference, in place of these.
    fn solvers(
        &self,
        noise: &Model,
        local: &Model,
        space: Space,
    ) -> Result<(ReferenceSolver, ReferenceSolver), KindError> {
        let known =
            |model: &Model| Ok::<_, KindError>(ReferenceSolver::new(model.info().exact_factors()?, space, &self.image));
        Ok((known(noise)?, known(local)?))
    }
}

/// How a solver was trained, as tables say it.
fn setting(model: &Model) -> BTreeMap<String, String> {
    let info = model.info();
    let fields = [("space", info.space.name()), ("output", info.output.name()), ("features", info.features.name())];
    fields.map(|(name, value)| (name.to_owned(), value.to_owned())).into()
}

/// Whether stops lie in the ladder of a model, without its end.
fn outside(endpoints: &Source, port: All<ModelFile>, model: &Source) -> Option<Foreseen> {
    let (stops, rungs) = (endpoints.facts.get(RUNGS)?, model.facts.get(RUNGS)?);
    let [from, to] = [stops.first()?, stops.last()?];
    let [first, end] = [rungs.first()?, rungs.last()?];
    (from < first || to >= end).then(|| {
        let message = format!(
            "the stops {from} to {to} of `{}` are outside the ladder of `{}`, {first} to {end} samples (its end \
             excluded)",
            endpoints.name, model.name
        );
        Foreseen::input(port, message, "train on a longer ladder, or bridge other rungs")
    })
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
