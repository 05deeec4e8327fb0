//! A toy kind whose params decide its ports, and whether it is a map or a gather.

use super::super::media::Number;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::{
    Action, Artifact, Context, Determinism, Group, Handle, InputPort, ItemKey, Kind, KindError, KindSpec, Media, Mode,
    OutputPort, Outputs, ParamProblem, Takes, interned,
};

/// Params of `fan`.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FanParams {
    /// Name of its input.
    input: String,
    /// Its outputs, with what each multiplies by.
    outputs: BTreeMap<String, i64>,
    /// True to add all items up first.
    gather: bool,
    /// Added to all.
    add: i64,
}

impl Default for FanParams {
    fn default() -> Self {
        Self { input: "in".into(), outputs: BTreeMap::from([("out".into(), 1)]), gather: false, add: 0 }
    }
}

/// Multiplies its input by several numbers, with a port for each.
pub struct Fan;

impl Kind for Fan {
    type Params = FanParams;

    fn spec() -> KindSpec {
        Self::spec_for(&FanParams::default())
    }

    fn spec_for(params: &Self::Params) -> KindSpec {
        let takes = if params.gather { Takes::Collection } else { Takes::Item };
        let input = InputPort {
            name: interned(&params.input),
            media: Number::NAME,
            takes,
            optional: false,
            single: false,
            doc: "Numbers.",
        };
        let output = |name: &String| OutputPort {
            name: interned(name),
            media: Number::NAME,
            group: Group::main(1),
            filter: false,
            single: false,
            determinism: Determinism::Bitwise,
            publish: false,
            doc: "A product.",
        };
        KindSpec {
            name: "fan",
            summary: "A toy.",
            manual: "",
            mode: if params.gather { Mode::Gather } else { Mode::Map },
            inputs: vec![input],
            outputs: params.outputs.keys().map(output).collect(),
            seeded: false,
        }
    }

    fn port_params() -> &'static [&'static str] {
        &["input", "outputs", "gather"]
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let none = params.outputs.is_empty();
        none.then(|| ParamProblem::new("/outputs", "there are no outputs", "name one")).into_iter().collect()
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let FanParams { input, outputs, gather, add } = &action.params;
        let value = |artifact: &Artifact| Ok::<i64, KindError>(Handle::<Number>::new(artifact)?.load(ctx)?.value);
        let given = match gather {
            false => value(action.each[input.as_str()])?,
            true => action.all[input.as_str()].iter().map(|(_, artifact)| value(artifact)).sum::<Result<i64, _>>()?,
        };
        let mut made = Outputs::default();
        for (name, factor) in outputs {
            let stored = Number { value: given * factor + add, pad: 0 }.store(ctx)?.into_artifact();
            if *gather {
                let key = ItemKey::new(name.as_str()).map_err(|e| KindError::Internal(e.to_string()))?;
                made.collections.insert(name.clone(), [(key, stored)].into_iter().collect());
            } else {
                made.items.insert(name.clone(), stored);
            }
        }
        Ok(made)
    }
}
