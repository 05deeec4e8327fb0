//! The states that a solver passes through between its network calls.

use super::{
    BridgeClock,
    files::{Described, Values, put_image, read_image},
};
use crate::{DataError, Image, methods::MethodName};
use serde::{Deserialize, Serialize};
use tauflow_contract::{Artifact, Context, KindError, Media, ReadFiles, Stored, WriteFiles, parse_json, pretty_json};

const META: &str = "meta.json";

/// The metadata of a state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RolloutState {
    /// Which method made it, e.g. `mc_noise`.
    pub method: String,
    /// Sample count of the endpoint that the rollout starts from.
    pub from_spp: u64,
    /// Network calls of the whole rollout.
    pub nfe: u64,
    /// Network calls up to this state, from 1 to `nfe`.
    pub calls: u64,
    /// Its variance time, by the clock of the solver.
    pub tau: f64,
}

impl RolloutState {
    /// Name, without its ending, of its file when it is exported.
    ///
    /// # Errors
    /// If the method's name cannot be part of a file name.
    fn file(&self) -> Result<String, DataError> {
        MethodName::new(self.method.as_str()).map_err(|error| DataError::Format(error.to_string()))?;
        Ok(format!("{}-{}-nfe-{}-call-{:04}", self.method, self.from_spp, self.nfe, self.calls))
    }
}

/// The metadata of the artifact.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct RolloutMeta {
    /// The clock of the solver.
    clock: BridgeClock,
    /// One for each image, in order.
    states: Vec<RolloutState>,
}

/// The states of rollouts, exposed linear radiance, in order. The start is a rung, and is not among them; the last
/// state of a rollout is its result.
#[derive(Clone, Debug, PartialEq)]
pub struct Rollout {
    /// The clock of the solver.
    pub clock: BridgeClock,
    /// The states.
    pub states: Vec<(RolloutState, Image)>,
}

fn part(index: usize) -> String {
    format!("image/{index:04}")
}

impl Rollout {
    fn meta(&self) -> RolloutMeta {
        RolloutMeta { clock: self.clock, states: self.states.iter().map(|(said, _)| said.clone()).collect() }
    }
}

impl Media for Rollout {
    const NAME: &'static str = "tauflow/rollout";
    const DOC: &'static str = "States of a solver after each call as EXR and PNG; `meta.json` lists them.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        let RolloutMeta { clock, states } = ctx.json(artifact, META)?;
        let load = |(index, said)| Ok((said, Image::from_bytes(&ctx.part(artifact, &part(index))?)?));
        let states = states.into_iter().enumerate().map(load).collect::<Result<_, KindError>>()?;
        Ok(Self { clock, states })
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        let mut parts = Vec::with_capacity(self.states.len() + 1);
        for (index, (said, image)) in self.states.iter().enumerate() {
            said.file()?;
            parts.push((part(index), ctx.put(&image.to_bytes())?));
        }
        parts.push((META.into(), ctx.put_json(&self.meta())?));
        Ok(Stored::tree(parts))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        let rollout = Self::load(ctx, artifact)?;
        let values = Values::of_exposed(to)?;
        to.put(META, &pretty_json(&Described { meta: rollout.meta(), values: Some(values) })?)?;
        rollout.states.iter().try_for_each(|(said, image)| put_image(to, &said.file()?, &values.written(image)))
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        let Described::<RolloutMeta> { meta, values } = parse_json(META, &from.need(META)?)?;
        let read = |said: RolloutState| {
            let image = read_image(from, &format!("{}.exr", said.file()?))?;
            Ok((said, values.map_or_else(|| Ok(image.clone()), |values| values.exposed(image.clone()))?))
        };
        let states = meta.states.into_iter().map(read).collect::<Result<_, KindError>>()?;
        Self { clock: meta.clock, states }.store(ctx)
    }
}
