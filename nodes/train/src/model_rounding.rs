#![doc = include_str!("model_rounding.md")]

use crate::model::Model;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::{
    Action, All, Before, Context, Facts, Group, Kind, KindError, KindSpec, Known, Later, Media, Mode, Out, Outlook,
    Outputs,
};
use tauflow_data::{
    facts::{CONDITIONING, PARAMETERIZATION, RUNGS},
    records::ModelFile,
};

/// The kind `model_rounding`.
pub struct ModelRounding;

/// Precision of the convolutions below the highest resolution.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// Half precision, like all other weights.
    #[default]
    Half,
    /// Integers of 8 bits, with a factor for each output channel.
    Integers,
}

/// Params of `model_rounding`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ModelRoundingParams {
    /// Precision of the convolutions below the highest resolution.
    pub coarse: Precision,
}

const MODEL: All<ModelFile> = All::new("model", "The model: exactly one.").single();
const MAIN: Group = Group::main(1);
const ROUNDED: Out<ModelFile> = Out::new(MAIN, "rounded", "The model with rounded weights.").single();

/// The key of the one item on the output.
const ITEM: &str = "model";

impl Kind for ModelRounding {
    type Params = ModelRoundingParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "model_rounding",
            summary: "Rounds the weights of a model, so that its file is smaller.",
            manual: include_str!("model_rounding.md"),
            mode: Mode::Gather,
            inputs: vec![MODEL.port()],
            outputs: vec![ROUNDED.port()],
            seeded: false,
        }
    }

    fn foresee(_params: &Self::Params, known: &Known) -> Outlook {
        let models = known.all(MODEL);
        let facts = match models {
            [model] => Facts::default()
                .with_some(RUNGS, model.facts.get(RUNGS))
                .with_some(CONDITIONING, model.facts.get(CONDITIONING))
                .with_some(PARAMETERIZATION, model.facts.get(PARAMETERIZATION)),
            _ => Facts::default(),
        };
        Outlook::default().with(ROUNDED, facts)
    }

    fn later() -> &'static [Later] {
        &[Later { pointer: "/coarse", before: Before::Text("half") }]
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let model = action.only(MODEL)?.load(ctx)?;
        let rounded = Model::load(&model.0)?.to_rounded_bytes(action.params.coarse)?;
        Outputs::default().put_one(ROUNDED, ITEM, ModelFile(rounded).store(ctx)?)
    }
}
