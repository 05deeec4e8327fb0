#![doc = include_str!("image_gamma.md")]

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::{
    Action, Context, Each, Group, Kind, KindError, KindSpec, Media, Mode, Out, Outputs, ParamProblem,
};
use tauflow_data::{
    maths::powf,
    records::{PackedScene, Refined, RefinedImage},
};

/// The kind `image_gamma`.
pub struct ImageGamma;

/// Params of `image_gamma`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ImageGammaParams {
    /// Sample count of the endpoint.
    #[schemars(range(min = 1))]
    pub from: u64,
    /// The exponent.
    #[schemars(range(min = 0.1, max = 10.0))]
    pub gamma: f64,
    /// Add a second output, `original`: the endpoint before the change.
    pub original: bool,
}

impl Default for ImageGammaParams {
    fn default() -> Self {
        Self { from: 1, gamma: 0.5, original: false }
    }
}

const ENDPOINTS: Each<PackedScene> = Each::new("endpoints", "The scenes whose endpoints are changed.");
const REFINED: Out<Refined> = Out::new(Group::main(1), "refined", "The changed image.");
const ORIGINAL: Out<Refined> = Out::new(Group::main(1), "original", "The image before the change.");

impl Kind for ImageGamma {
    type Params = ImageGammaParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "image_gamma",
            summary: "Raises every value of an endpoint to a power.",
            manual: include_str!("image_gamma.md"),
            mode: Mode::Map,
            inputs: vec![ENDPOINTS.port()],
            outputs: vec![REFINED.port()],
            seeded: false,
        }
    }

    fn spec_for(params: &Self::Params) -> KindSpec {
        let mut spec = Self::spec();
        if params.original {
            spec.outputs.push(ORIGINAL.port());
        }
        spec
    }

    fn port_params() -> &'static [&'static str] {
        &["original"]
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        if params.gamma != 1.0 {
            return Vec::new();
        }
        vec![ParamProblem::new("/gamma", "an exponent of 1 changes nothing", "use for example 0.5")]
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let ImageGammaParams { from, gamma, original } = action.params;
        let scene = action.read(ctx, ENDPOINTS)?;
        let rung = scene.counts.iter().position(|count| *count == from).ok_or_else(|| {
            let counts = &scene.counts;
            KindError::Input(format!("the scene has no rung of {from} samples, only {counts:?}; change `from`"))
        })?;
        let state = &scene.states[rung];
        let image = state.map(|value| powf(value.max(0.0), gamma as f32));
        let said = |nfe| RefinedImage { method: "image_gamma".into(), from_spp: from, to_spp: from, nfe };
        let refined = Refined { images: vec![(said(1), image)], note: None, sampler: scene.sampler };
        let outputs = Outputs::default().put(REFINED, refined.store(ctx)?);
        if !original {
            return Ok(outputs);
        }
        let kept = Refined { images: vec![(said(0), state.clone())], note: None, sampler: scene.sampler };
        Ok(outputs.put(ORIGINAL, kept.store(ctx)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{collections::BTreeMap, sync::atomic::AtomicBool};
    use tauflow_contract::{Handle, MemoryBlobs, Silent};
    use tauflow_data::Image;

    const PINNED: &str = "8fc0d64d830cbca18accd61c7c812af73edf941c3114af4745c65c8d57e2e749-259";

    #[test]
    fn values_are_raised_to_the_power() {
        let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
        let ctx = Context::new(&blobs, &Silent, &stop);
        let state = Image::from_data(1, 1, 3, vec![4.0, 0.25, -1.0]).expect("one pixel");
        let scene = PackedScene { counts: vec![1], states: vec![state], gbuffer: None, sampler: Default::default() };
        let stored = scene.store(&ctx).expect("in memory");
        let run = |from, original| {
            let params = ImageGammaParams { from, gamma: 0.5, original };
            let each = BTreeMap::from([(ENDPOINTS.name(), stored.artifact())]);
            let action = Action { params, item: None, group: "main", seed: 0, each, all: BTreeMap::new() };
            ImageGamma::run(&ctx, &action)
        };
        let outputs = run(1, false).expect("there is such a rung");
        let refined = Handle::<Refined>::new(&outputs.items[REFINED.name()]).expect("its own type");
        assert_eq!(refined.load(&ctx).expect("whole").images[0].1.data(), [2.0, 0.5, 0.0]);
        // If these bits change, increase the version of the group.
        assert_eq!(refined.artifact().digest().to_string(), PINNED);
        assert!(run(2, false).expect_err("no such rung").to_string().contains("[1]"));
        let both = run(1, true).expect("there is such a rung").items;
        assert_eq!(both[REFINED.name()], *refined.artifact());
        let original = Handle::<Refined>::new(&both[ORIGINAL.name()]).expect("its own type");
        assert_eq!(original.load(&ctx).expect("whole").images[0].1.data(), [4.0, 0.25, -1.0]);
    }
}
