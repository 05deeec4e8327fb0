#![doc = include_str!("model_rounding.md")]

use crate::model::Model;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::{
    Action, All, Context, Facts, Group, Kind, KindError, KindSpec, Known, Media, Mode, Out, Outlook, Outputs,
};
use tauflow_data::{
    facts::{CONDITIONING, PARAMETERIZATION, RUNGS},
    records::ModelFile,
};

/// The kind `model_rounding`.
pub struct ModelRounding;

/// Params of `model_rounding`: none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ModelRoundingParams {}

const MODEL: All<ModelFile> = All::new("model", "The model: exactly one.").single();
const MAIN: Group = Group::main(1);
const ROUNDED: Out<ModelFile> = Out::new(MAIN, "rounded", "The model with weights of half precision.").single();

/// The key of the one item on the output.
const ITEM: &str = "model";

impl Kind for ModelRounding {
    type Params = ModelRoundingParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "model_rounding",
            summary: "Rounds the weights of a model to half precision.",
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

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let model = action.only(MODEL)?.load(ctx)?;
        Outputs::default().put_one(ROUNDED, ITEM, ModelFile(Model::load(&model.0)?.to_half_bytes()?).store(ctx)?)
    }
}
