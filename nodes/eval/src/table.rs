#![doc = include_str!("table.md")]

mod foreseen;
mod tabulate;
#[cfg(test)]
mod tests;

pub use tabulate::tabulate;

use crate::groups::{Groups, SPLIT};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use tauflow_contract::{
    Action, All, Context, Group, Kind, KindError, KindSpec, Known, Media, Mode, Out, Outlook, Outputs, ParamProblem,
};
use tauflow_data::records::{AxisValue, METRICS, SceneScores, ScoreTable};

/// The kind `table`.
pub struct TableKind;

/// Params of `table`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TableParams {
    /// Title of the table; may be empty.
    pub title: String,
    /// Metrics to tabulate, by name.
    #[schemars(length(min = 1))]
    pub metrics: Vec<String>,
    /// Axes that become rows; empty for all axes with several values that are not in `columns`.
    pub rows: Vec<String>,
    /// Axes that become columns.
    pub columns: Vec<String>,
    /// Baseline for differences: a value on an axis; none for no differences.
    pub against: Option<AgainstParams>,
    /// Write `table.tex`.
    pub latex: bool,
    /// Write `table.parquet` and `items.parquet`.
    pub parquet: bool,
    /// Number of bootstrap resamples.
    #[schemars(range(min = 100, max = 100_000))]
    pub resamples: u64,
}

/// A value on an axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AgainstParams {
    /// Name of the axis.
    pub axis: String,
    /// The value there, as the matrix has it.
    pub value: Coordinate,
}

/// A coordinate as a pipeline file has it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Coordinate {
    /// A whole number.
    Integer(i64),
    /// A number.
    Number(f64),
    /// A text.
    Text(String),
}

impl Coordinate {
    fn value(&self) -> AxisValue {
        match self {
            Self::Integer(value) => AxisValue::Integer(*value),
            Self::Number(value) => AxisValue::Number(*value),
            Self::Text(value) => AxisValue::parse(value),
        }
    }
}

impl Default for TableParams {
    fn default() -> Self {
        Self {
            title: String::new(),
            metrics: vec!["hdr_psnr".into()],
            rows: Vec::new(),
            columns: Vec::new(),
            against: None,
            latex: false,
            parquet: false,
            resamples: 2000,
        }
    }
}

const SCORES: All<SceneScores> = All::new("scores", "Scores of images, by cell and item.");
const TABLE: Out<ScoreTable> =
    Out::new(Group::main(3), "table", "Means with intervals by axes, and all scores.").single().published();

impl Kind for TableKind {
    type Params = TableParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "table",
            summary: "Tabulates metrics by any axes, with intervals and paired differences.",
            manual: include_str!("table.md"),
            mode: Mode::Gather,
            inputs: vec![SCORES.port(), SPLIT.port()],
            outputs: vec![TABLE.port()],
            seeded: true,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut problems = Vec::new();
        for (place, metric) in params.metrics.iter().enumerate() {
            if !METRICS.contains(&metric.as_str()) {
                problems.push(ParamProblem::new(
                    format!("/metrics/{place}"),
                    format!("there is no metric `{metric}`"),
                    format!("use one of {}", METRICS.join(", ")),
                ));
            }
        }
        let mut seen = BTreeSet::new();
        for (list, names) in [("metrics", &params.metrics), ("rows", &params.rows), ("columns", &params.columns)] {
            for (place, name) in names.iter().enumerate() {
                if !seen.insert((list == "metrics", name)) {
                    problems.push(ParamProblem::new(
                        format!("/{list}/{place}"),
                        format!("`{name}` is named twice"),
                        "name each metric and each axis once, in `rows` or in `columns`",
                    ));
                }
            }
        }
        problems
    }

    fn foresee(params: &Self::Params, known: &Known) -> Outlook {
        let scores = known.all(SCORES);
        let metrics = foreseen::absent_metrics(scores, &params.metrics);
        Outlook::default().but(foreseen::foreseen(scores, params).into_iter().chain(metrics))
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let items = action.all(SCORES)?;
        let scores = items.iter().map(|(key, scores)| Ok((key.clone(), scores.load(ctx)?)));
        let scores = scores.collect::<Result<Vec<_>, KindError>>()?;
        ctx.check_cancelled()?;
        let groups = Groups::load(ctx, action)?;
        let table = tabulate(&scores, &groups, &action.params, action.seed)?;
        Outputs::default().put_one(TABLE, "table", table.store(ctx)?)
    }
}
