#![doc = include_str!("no_reference_scores.md")]

use crate::{
    manifest::Files,
    onnx::{self, Onnx},
    program::Program,
    scorer::{Scorer, Search},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::{collections::BTreeMap, path::Path};
use tauflow_contract::{
    Action, All, Context, Group, Kind, KindError, KindSpec, Media, Mode, Out, Outputs, ParamProblem, Probe,
};
use tauflow_data::{
    Image,
    outside::{contents, identity, program},
    records::{Generated, SampleRow, SampleScores},
    timing::machine,
};

/// The kind `no_reference_scores`.
pub struct NoReferenceScores;

/// Params of `no_reference_scores`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NoReferenceScoresParams {
    /// Manifests of ONNX models.
    pub models: Vec<String>,
    /// Path of the ONNX Runtime library. Default: TAUFLOW_ONNXRUNTIME.
    pub runtime: Option<String>,
    /// Command line of a program that scores images, as a list of words; empty for no program.
    pub command: Vec<String>,
    /// Fail if a file is missing, instead of omitting its columns with a note.
    pub required: bool,
}

const GENERATED: All<Generated> = All::new("generated", "The samples to score, in all their variants.");
const SCORES: Out<SampleScores> =
    Out::new(Group::main(1), "scores", "The scores of each image, and a note on missing files.").local().single();

impl Kind for NoReferenceScores {
    type Params = NoReferenceScoresParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "no_reference_scores",
            summary: "Scores generated images with your own models and programs, such as CLIPIQA.",
            manual: include_str!("no_reference_scores.md"),
            mode: Mode::Gather,
            inputs: vec![GENERATED.port()],
            outputs: vec![SCORES.port()],
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        if !params.models.is_empty() || !params.command.is_empty() {
            return Vec::new();
        }
        let hint = "write for example `models: [models/clipiqa.json]`";
        vec![ParamProblem::new("/models", "there are neither `models` nor a `command`", hint)]
    }

    fn missing(params: &Self::Params) -> Vec<ParamProblem> {
        let mut found = Vec::new();
        // Without `required`, what is missing is left out with a note.
        if !params.required {
            return found;
        }
        let hint = "mend the path, or omit `required`; paths start at the working directory of tauflow";
        for (place, manifest) in params.models.iter().enumerate().filter(|(_, path)| !Path::new(path).is_file()) {
            let message = format!("there is no manifest `{manifest}` here");
            found.push(ParamProblem::new(format!("/models/{place}"), message, hint));
        }
        if let Some(name) = params.command.first().filter(|name| program(name).is_none()) {
            found.push(ParamProblem::new("/command/0", format!("there is no program `{name}` here"), hint));
        }
        found
    }

    fn environment(params: &Self::Params, _group: &str, _probe: &dyn Probe) -> Option<Value> {
        let models: Vec<Value> = params.models.iter().map(|manifest| Files::identity(manifest)).collect();
        let runtime = match onnx::library(params.runtime.as_deref()).filter(|_| !params.models.is_empty()) {
            Some(file) if file.is_file() => contents(&file),
            Some(_) => "missing".to_owned(),
            None => "none".to_owned(),
        };
        Some(json!({
            "models": models, "runtime": runtime, "program": identity(&params.command), "machine": machine(),
        }))
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        let mut found = SampleScores::default();
        let mut scorers: Vec<Box<dyn Scorer>> = Vec::new();
        for manifest in &params.models {
            take(Onnx::find(manifest, params.runtime.as_deref())?, params.required, &mut scorers, &mut found.notes)?;
        }
        if !params.command.is_empty() {
            take(Program::find(&params.command)?, params.required, &mut scorers, &mut found.notes)?;
        }
        for column in scorers.iter().flat_map(|scorer| scorer.columns()) {
            if found.columns.iter().any(|known| known.name == column.name) {
                return Err(KindError::Input(format!(
                    "two scorers give `{}`; take one of the models, or the program, out",
                    column.name
                )));
            }
            found.columns.push(column.clone());
        }
        let generated = action.all(GENERATED)?;
        for (done, (_, item)) in generated.iter().enumerate() {
            if scorers.is_empty() {
                break;
            }
            ctx.progress(done as u64, generated.len() as u64, "samples");
            found.rows.extend(rows(ctx, &item.load(ctx)?, &mut scorers)?);
        }
        Outputs::default().put_one(SCORES, "scores", found.store(ctx)?)
    }
}

/// Takes a scorer that is there; notes what is missing of one that is not.
fn take<S: Scorer + 'static>(
    found: Search<S>,
    required: bool,
    scorers: &mut Vec<Box<dyn Scorer>>,
    notes: &mut Vec<String>,
) -> Result<(), KindError> {
    match found {
        Search::Here(scorer) => scorers.push(Box::new(scorer)),
        Search::Missing(what) if required => {
            return Err(KindError::Environment(format!("{what}; or say `required: false`")));
        }
        Search::Missing(what) => notes.push(format!("scores are left out: {what}")),
    }
    Ok(())
}

/// The scores of a sample's variants.
fn rows(
    ctx: &Context<'_>,
    generated: &Generated,
    scorers: &mut [Box<dyn Scorer>],
) -> Result<Vec<SampleRow>, KindError> {
    let mut rows: Vec<SampleRow> = Vec::with_capacity(generated.variants.len());
    let mut frozen: Option<&Image> = None;
    for its in &generated.variants {
        ctx.check_cancelled()?;
        let scores = match (rows.first(), frozen) {
            (Some(first), Some(image)) if *image == its.image => first.scores.clone(),
            _ => scores(&its.image, scorers)?,
        };
        frozen.get_or_insert(&its.image);
        let (backbone, sample) = (generated.backbone.as_str().to_owned(), generated.sample);
        rows.push(SampleRow { backbone, sample, variant: its.variant, scores });
    }
    Ok(rows)
}

fn scores(image: &Image, scorers: &mut [Box<dyn Scorer>]) -> Result<BTreeMap<String, f64>, KindError> {
    let mut scores = BTreeMap::new();
    for scorer in scorers {
        let values = scorer.score(image)?;
        scores.extend(scorer.columns().iter().map(|column| column.name.clone()).zip(values));
    }
    Ok(scores)
}
