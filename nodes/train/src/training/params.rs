//! The params of a training. Bounds of single params are in the schema, which is held against them before all else.

use crate::{
    device::{NetworkDevice, ON_THE_CPU},
    law::Law,
    network::{Features, Loss, Output, Preset},
    space::Space,
};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use tauflow_contract::{Before, Later, ParamProblem};
use tauflow_data::methods::{Conditioning, Parameterization};
use tauflow_ops::Convolutions;
use tauflow_tensors::Decay;

/// How the error of the training ladders falls with the sample count n.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Clock {
    /// As n^(-1/2), like the error of independent samples.
    #[default]
    Independent,
    /// As n^-alpha. `convergence` measures a slope in each scene; alpha is minus their median.
    Fitted,
}

/// How the convolutions of a training are computed on a CPU. The two differ by rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Convolving {
    /// By minimal filtering (Winograd), with a quarter of the multiplications where that is faster.
    #[default]
    Minimal,
    /// As the sum of the definition, like in earlier versions.
    Direct,
}

impl Convolving {
    pub(super) fn convolutions(self) -> Convolutions {
        match self {
            Self::Minimal => Convolutions::Minimal,
            Self::Direct => Convolutions::Direct,
        }
    }
}

/// Params of `training`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TrainingParams {
    /// Quantity that the network predicts.
    pub parameterization: Parameterization,
    /// Additional input of the network: none (RGB), or G-buffers.
    pub conditioning: Conditioning,
    /// Size of the network.
    pub preset: Preset,
    /// Encoding of states and targets.
    pub space: Space,
    /// Loss function.
    pub loss: Loss,
    /// Seed of the initial weights and batches: trainings that differ only in it show the variance between trainings.
    pub draw: u64,
    /// The law of the error that variance time and the factors of targets follow.
    pub clock: Clock,
    /// Training steps; 0 keeps the initial weights, as a baseline.
    pub steps: u64,
    /// Number of training examples per step.
    #[schemars(range(min = 1, max = 4096))]
    pub batch: usize,
    /// Side of the training windows in pixels; limited to the image size and rounded down to a multiple of 8, or
    /// of 16 for `fast`, `best` and `wide`.
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
    /// Decay of the learning rate after the warm-up.
    pub decay: Decay,
    /// Maximum norm of the gradient.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub clip: f64,
    /// Share that the average of the weights keeps in each step; lower in short trainings.
    #[schemars(range(min = 0.0), extend("exclusiveMaximum" = 1.0))]
    pub ema: f64,
    /// Take targets from different scenes: a control experiment.
    pub shuffle_targets: bool,
    /// Maximum change of the exposure of an example in EV: a factor 2^U[-j, j] on all its rungs.
    #[schemars(range(min = 0.0, max = 8.0))]
    pub exposure_jitter: f64,
    /// Permute the colour channels of each example randomly, including albedo.
    pub permute_colours: bool,
    /// Rungs of n samples are drawn in proportion to n to the power of minus this value: 0 for uniform, 0.5 for
    /// proportional to their standard error.
    #[schemars(range(min = 0.0, max = 4.0))]
    pub rung_exponent: f64,
    /// Output of the network.
    pub output: Output,
    /// Input channels of the network.
    pub features: Features,
    /// Known factor of targets in the network's head; only for `local_velocity` and `vanilla_rf` with means.
    pub law: Law,
    /// Share of the examples for which the network is not told the sample count, so that it also denoises images of
    /// unknown or uneven counts.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub unknown_counts: f64,
    /// Where the network is not told the sample count, take the target from the samples of the last rung that the
    /// input does not contain. Otherwise the network keeps some noise of inputs with many samples.
    pub independent_targets: bool,
    /// Share of these examples that have tiles of two sample counts, as adaptive sampling gives.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub uneven_counts: f64,
    /// Share of the examples that are partly covered by patches without noise: black, lamps, or plain backgrounds.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub patches: f64,
    /// Computation of convolutions on a CPU; the two differ in time and in rounding.
    pub convolutions: Convolving,
    /// Steps between points of the loss curve.
    #[schemars(range(min = 1))]
    pub test_every: u64,
    /// Steps between checkpoints.
    #[schemars(range(min = 1))]
    pub checkpoint_every: u64,
    /// Device of the network; the outputs of a GPU depend on the machine.
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
            clock: Clock::default(),
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
            features: Features::default(),
            law: Law::default(),
            unknown_counts: 0.0,
            independent_targets: false,
            uneven_counts: 0.0,
            patches: 0.0,
            convolutions: Convolving::default(),
            test_every: 250,
            checkpoint_every: 500,
            device: NetworkDevice::Cpu,
        }
    }
}

/// The behaviour before these params existed.
pub(super) const LATER: &[Later] = &[
    Later { pointer: "/rung_exponent", before: Before::Number(0.0) },
    Later { pointer: "/output", before: Before::Text("means") },
    Later { pointer: "/features", before: Before::Text("contrast") },
    Later { pointer: "/law", before: Before::Text("limits") },
    Later { pointer: "/clock", before: Before::Text("independent") },
    Later { pointer: "/unknown_counts", before: Before::Number(0.0) },
    Later { pointer: "/independent_targets", before: Before::Flag(false) },
    Later { pointer: "/uneven_counts", before: Before::Number(0.0) },
    Later { pointer: "/patches", before: Before::Number(0.0) },
    Later { pointer: "/convolutions", before: Before::Text("direct") },
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
    /// The same training, with params that change nothing at the values of before they existed: keys and files of such
    /// trainings do not mention them.
    pub(super) fn acting(&self) -> Self {
        let matters = Law::matters(self.parameterization) && self.output != Output::Values;
        let convolutions = if self.device == NetworkDevice::Cpu { self.convolutions } else { Convolving::Direct };
        Self { law: if matters { self.law } else { Law::unsaid() }, convolutions, ..self.clone() }
    }

    /// Whether some ladders may end before others: only where examples without a count have targets of their own.
    pub(super) fn allows_shorter(&self) -> bool {
        self.unknown_counts != 0.0 && self.independent_targets
    }

    /// Checks beyond the schema: incompatible params.
    pub(super) fn problems(&self) -> Vec<ParamProblem> {
        let mut problems = Vec::new();
        let least = self.preset.multiple();
        if self.crop < least {
            let message =
                format!("a crop of {} pixels is below the minimum of `{}`, {least}", self.crop, self.preset.name());
            problems.push(ParamProblem::new("/crop", message, format!("use {least} or more")));
        }
        let window = self.loss.least_side().next_multiple_of(least);
        if (least..window).contains(&self.crop) {
            let message = format!(
                "a crop of {} pixels is too small for the window of `loss: structural` and the network `{}`, which \
                 need {window}",
                self.crop,
                self.preset.name()
            );
            problems.push(ParamProblem::new("/crop", message, format!("use {window} or more")));
        }
        if self.rung_exponent != 0.0 && self.parameterization == Parameterization::VanillaRf {
            problems.push(ParamProblem::new(
                "/rung_exponent",
                "`vanilla_rf` uses only the first and the last rung, so no rungs are sampled",
                "leave it at 0",
            ));
        }
        if self.unknown_counts != 0.0 && self.parameterization != Parameterization::McNoise {
            problems.push(ParamProblem::new(
                "/unknown_counts",
                "only the target of `mc_noise` does not depend on the sample count",
                "leave it at 0, or use `mc_noise`",
            ));
        }
        if self.output.is_guided() && self.conditioning != Conditioning::Gbuffer {
            problems.push(ParamProblem::new(
                "/output",
                "`guided_means`, `smoothed_means` and `fitted_means` need G-buffers",
                "use `conditioning: gbuffer`, or `output: shaded_means`",
            ));
        }
        if self.loss.of_images() && (self.parameterization, self.space) != (Parameterization::McNoise, Space::Log1p) {
            problems.push(ParamProblem::new(
                "/loss",
                "`tonal`, `preview`, `unbiased_preview` and `structural` compare clean images in logarithms, \
                which only `mc_noise` with `space: log1p` predicts",
                "use `absolute`, or `mc_noise` and `log1p`",
            ));
        }
        if self.independent_targets && self.unknown_counts == 0.0 {
            problems.push(ParamProblem::new(
                "/independent_targets",
                "it changes only examples without a sample count, and `unknown_counts` is 0",
                "raise `unknown_counts`, or leave it out",
            ));
        }
        if self.uneven_counts != 0.0 && self.unknown_counts == 0.0 {
            problems.push(ParamProblem::new(
                "/uneven_counts",
                "it changes only examples without a sample count, and `unknown_counts` is 0",
                "raise `unknown_counts`, or leave it out",
            ));
        }
        problems
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
            ("steps/minimum", 0.0),
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
            ("unknown_counts/minimum", 0.0),
            ("unknown_counts/maximum", 1.0),
            ("uneven_counts/minimum", 0.0),
            ("uneven_counts/maximum", 1.0),
            ("patches/minimum", 0.0),
            ("patches/maximum", 1.0),
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
        let untold = TrainingParams { unknown_counts: 0.5, ..TrainingParams::default() };
        assert!(untold.problems().is_empty());
        let velocity = TrainingParams { parameterization: Parameterization::McVelocity, ..untold };
        assert_eq!(velocity.problems()[0].pointer, "/unknown_counts");
        let tonal = TrainingParams { loss: Loss::Tonal, space: Space::Log1p, ..TrainingParams::default() };
        let of = |parameterization| TrainingParams { parameterization, ..tonal.clone() }.problems();
        assert!(of(Parameterization::McNoise).is_empty());
        assert_eq!(of(Parameterization::LocalVelocity)[0].pointer, "/loss");
        assert_eq!(TrainingParams { space: Space::Linear, ..tonal.clone() }.problems()[0].pointer, "/loss");
        for crop in [8, 12, 15] {
            let small = TrainingParams { loss: Loss::Structural, crop, ..tonal.clone() };
            assert!(
                small.problems()[0].pointer == "/crop" && small.problems()[0].message.contains("need 16"),
                "{crop}"
            );
        }
        assert!(TrainingParams { loss: Loss::Structural, crop: 16, ..tonal.clone() }.problems().is_empty());
        let shown = TrainingParams { loss: Loss::Preview, ..tonal };
        assert!(shown.problems().is_empty());
        assert_eq!(TrainingParams { space: Space::Linear, ..shown }.problems()[0].pointer, "/loss");
        for output in [Output::GuidedMeans, Output::SmoothedMeans, Output::FittedMeans] {
            let guided = TrainingParams { output, ..TrainingParams::default() };
            assert_eq!(guided.problems()[0].pointer, "/output");
            assert!(TrainingParams { conditioning: Conditioning::Gbuffer, ..guided }.problems().is_empty());
        }
    }
}
