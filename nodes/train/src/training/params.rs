//! What a training is asked for. Bounds of single params are in the schema, which is held against them before all else.

use super::optimiser::Decay;
use crate::{
    device::{NetworkDevice, ON_THE_CPU},
    network::{Loss, Output, Preset},
    space::Space,
};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use tauflow_contract::{Before, Later, ParamProblem};
use tauflow_data::methods::{Conditioning, Parameterization};

/// Params of `training`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TrainingParams {
    /// What the network predicts.
    pub parameterization: Parameterization,
    /// What it sees beside the state.
    pub conditioning: Conditioning,
    /// Size of the network.
    pub preset: Preset,
    /// The space that states and targets are in.
    pub space: Space,
    /// How predictions are judged.
    pub loss: Loss,
    /// Which draw of first weights and batches: trainings that differ in it alone show how far chance goes.
    pub draw: u64,
    /// Training steps.
    #[schemars(range(min = 1))]
    pub steps: u64,
    /// Examples in a step.
    #[schemars(range(min = 1, max = 4096))]
    pub batch: usize,
    /// Side of the windows that are trained on, in pixels; cut to the images' size and a multiple of 8.
    #[schemars(range(min = 8))]
    pub crop: usize,
    /// Learning rate of Adam.
    #[schemars(range(max = 1000.0), extend("exclusiveMinimum" = 0.0))]
    pub learning_rate: f64,
    /// Decay rates of Adam's moments.
    #[schemars(schema_with = "shares")]
    pub betas: [f64; 2],
    /// Steps over which the learning rate rises from 0.
    pub warmup: u64,
    /// How the learning rate falls afterwards.
    pub decay: Decay,
    /// Largest norm of the gradient.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub clip: f64,
    /// Share that the average of the weights keeps in each step; in short runs, less.
    #[schemars(range(min = 0.0), extend("exclusiveMaximum" = 1.0))]
    pub ema: f64,
    /// Takes targets from other scenes: a check that what is learned comes from the data.
    pub shuffle_targets: bool,
    /// Largest change of the exposure of an example, in EV: factors 2^U[-j, j] on all its rungs.
    #[schemars(range(min = 0.0, max = 8.0))]
    pub exposure_jitter: f64,
    /// Puts the colours of each example, albedo included, into an order drawn for it.
    pub permute_colours: bool,
    /// Rungs of n samples are drawn in proportion to n to minus this: 0 for all as often, 0.5 as their standard errors
    /// are.
    #[schemars(range(min = 0.0, max = 4.0))]
    pub rung_exponent: f64,
    /// What the network's numbers are.
    pub output: Output,
    /// Steps between points of the loss curve.
    #[schemars(range(min = 1))]
    pub test_every: u64,
    /// Steps between checkpoints.
    #[schemars(range(min = 1))]
    pub checkpoint_every: u64,
    /// What the network runs on; anything but the CPU makes outputs of this machine.
    pub device: NetworkDevice,
}

impl Default for TrainingParams {
    fn default() -> Self {
        Self {
            parameterization: Parameterization::default(),
            conditioning: Conditioning::Rgb,
            preset: Preset::default(),
            space: Space::default(),
            loss: Loss::default(),
            draw: 0,
            steps: 60_000,
            batch: 16,
            crop: 128,
            learning_rate: 2e-4,
            betas: [0.9, 0.999],
            warmup: 100,
            decay: Decay::None,
            clip: 1.0,
            ema: 0.999,
            shuffle_targets: false,
            exposure_jitter: 0.0,
            permute_colours: false,
            rung_exponent: 0.0,
            output: Output::default(),
            test_every: 250,
            checkpoint_every: 500,
            device: NetworkDevice::Cpu,
        }
    }
}

/// What trainings did before these params existed.
pub(super) const LATER: &[Later] = &[
    Later { pointer: "/rung_exponent", before: Before::Number(0.0) },
    Later { pointer: "/output", before: Before::Text("means") },
    ON_THE_CPU,
];

/// Two numbers from 0 to below 1.
fn shares(_: &mut SchemaGenerator) -> Schema {
    json_schema!({
        "type": "array",
        "items": { "type": "number", "minimum": 0.0, "exclusiveMaximum": 1.0 },
        "minItems": 2,
        "maxItems": 2,
    })
}

impl TrainingParams {
    /// What no schema says: params that do not go together.
    pub(super) fn problems(&self) -> Vec<ParamProblem> {
        if self.rung_exponent == 0.0 || self.parameterization != Parameterization::VanillaRf {
            return Vec::new();
        }
        vec![ParamProblem::new(
            "/rung_exponent",
            "`vanilla_rf` learns between the first rung and the last: there are no others to draw",
            "leave it at 0",
        )]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_schema_bounds_every_number() {
        let schema = schemars::schema_for!(TrainingParams).to_value();
        for (pointer, bound) in [
            ("steps/minimum", 1.0),
            ("batch/minimum", 1.0),
            ("batch/maximum", 4096.0),
            ("crop/minimum", 8.0),
            ("learning_rate/exclusiveMinimum", 0.0),
            ("learning_rate/maximum", 1000.0),
            ("betas/items/minimum", 0.0),
            ("betas/items/exclusiveMaximum", 1.0),
            ("clip/exclusiveMinimum", 0.0),
            ("ema/minimum", 0.0),
            ("ema/exclusiveMaximum", 1.0),
            ("exposure_jitter/minimum", 0.0),
            ("exposure_jitter/maximum", 8.0),
            ("rung_exponent/minimum", 0.0),
            ("rung_exponent/maximum", 4.0),
            ("test_every/minimum", 1.0),
            ("checkpoint_every/minimum", 1.0),
        ] {
            let found = schema.pointer(&format!("/properties/{pointer}")).and_then(serde_json::Value::as_f64);
            assert_eq!(found, Some(bound), "{pointer}");
        }
        assert_eq!(schema["properties"]["betas"]["default"], json!([0.9, 0.999]));
    }

    #[test]
    fn rungs_are_not_drawn_where_there_are_none_between() {
        let changed = TrainingParams { rung_exponent: 0.5, ..TrainingParams::default() };
        assert!(TrainingParams::default().problems().is_empty() && changed.problems().is_empty());
        let vanilla = TrainingParams { parameterization: Parameterization::VanillaRf, ..changed };
        assert_eq!(vanilla.problems()[0].pointer, "/rung_exponent");
    }
}
