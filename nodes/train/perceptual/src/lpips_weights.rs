#![doc = include_str!("lpips_weights.md")]

use crate::weights::{File, read};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::Path;
use tauflow_contract::{
    Action, Context, Facts, Group, ItemKey, Kind, KindError, KindSpec, Known, Media, Mode, Out, Outlook, Outputs,
    ParamProblem, SourceItem,
};
use tauflow_data::{facts::HAS_WEIGHTS, records::PerceptualFile};

/// The kind `lpips_weights`.
pub struct LpipsWeights;

/// Params of `lpips_weights`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LpipsWeightsParams {
    /// Safetensors file of torchvision's AlexNet; none for no weights.
    pub trunk: Option<String>,
    /// Safetensors file of the weights of its features, of LPIPS 0.1; none for no weights.
    pub lin: Option<String>,
}

const WEIGHTS: Out<PerceptualFile> = Out::new(Group::main(1), "weights", "The tensors that LPIPS needs.");

/// Key of the item.
const ALEX: &str = "alex";
/// Parts of the item: a prefix, then the file's own name.
const TRUNK: &str = "trunk/";
const LIN: &str = "lin/";

impl Kind for LpipsWeights {
    type Params = LpipsWeightsParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "lpips_weights",
            summary: "Reads the weights of LPIPS from files that you name.",
            manual: include_str!("lpips_weights.md"),
            mode: Mode::Source,
            inputs: vec![],
            outputs: vec![WEIGHTS.port()],
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let (has, lacks) = match (&params.trunk, &params.lin) {
            (Some(_), None) => ("trunk", "lin"),
            (None, Some(_)) => ("lin", "trunk"),
            _ => return Vec::new(),
        };
        vec![ParamProblem::new(
            format!("/{lacks}"),
            format!("`{has}` is named, but `{lacks}` is not"),
            "name both files, or neither",
        )]
    }

    fn foresee(params: &Self::Params, _known: &Known) -> Outlook {
        let has = params.trunk.is_some() && params.lin.is_some();
        Outlook::default().with(WEIGHTS, Facts::default().with(HAS_WEIGHTS, has))
    }

    fn items(params: &Self::Params) -> Result<Vec<SourceItem>, KindError> {
        let (Some(trunk), Some(lin)) = (&params.trunk, &params.lin) else { return Ok(Vec::new()) };
        let files = [(TRUNK, "trunk", trunk), (LIN, "lin", lin)].map(|(prefix, param, file)| {
            let path = Path::new(file);
            if !path.is_file() {
                return Err(KindError::Environment(format!(
                    "there is no file `{file}` of weights; mend `{param}`, or omit `trunk` and `lin`"
                )));
            }
            let own = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            Ok((format!("{prefix}{own}"), path.to_owned()))
        });
        let key = ItemKey::new(ALEX).map_err(|e| KindError::Internal(e.to_string()))?;
        Ok(vec![SourceItem { key, files: files.into_iter().collect::<Result<_, _>>()? }])
    }

    /// Nothing: the files decide what an item is.
    fn project(params: &Self::Params, item: Option<&ItemKey>, _group: &str) -> Value {
        if item.is_none() { serde_json::to_value(params).expect("params serialise") } else { json!({}) }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let files = action.files()?.load(ctx)?.0;
        let file = |prefix: &str| {
            let found = files.iter().find_map(|(name, bytes)| Some(File { name: name.strip_prefix(prefix)?, bytes }));
            found.ok_or_else(|| KindError::Internal(format!("the item names no file of `{prefix}`")))
        };
        let weights = read(file(TRUNK)?, file(LIN)?)?;
        Ok(Outputs::default().put(WEIGHTS, PerceptualFile(weights.to_bytes()?).store(ctx)?))
    }
}
