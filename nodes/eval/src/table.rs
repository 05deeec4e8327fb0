#![doc = include_str!("table.md")]

use crate::{
    bootstrap::{Resampled, Table},
    evaluation::{bounded, coordinates, stratum},
    groups::{Groups, SPLIT},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{
    Action, All, Context, Foreseen, Group, ItemKey, Kind, KindError, KindSpec, Known, Media, Mode, Out, Outlook,
    Outputs, ParamProblem, Source,
};
use tauflow_data::{
    facts,
    records::{
        AxisValue, METRICS, Metrics, SceneScores, ScoreTable, TableAgainst, TableAxis, TableCell, TableFormats,
        TableItem, order,
    },
};

/// The axes that every score has, beside those of matrices.
const METHOD: &str = "method";
const SPP: &str = "spp";
const NFE: &str = "nfe";
const STRATUM: &str = "stratum";

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
            resamples: 2000,
        }
    }
}

const SCORES: All<SceneScores> = All::new("scores", "Scores of images, by cell and item.");
const TABLE: Out<ScoreTable> =
    Out::new(Group::main(1), "table", "Means with intervals by axes, and all scores.").single().published();

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
        Outlook::default().but(foreseen(known.all(SCORES), params))
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

/// Axes that the scores are sure not to have, and axes that are sure to be left over.
fn foreseen(sources: &[Source], params: &TableParams) -> Vec<Foreseen> {
    let mut problems = Vec::new();
    let of: Vec<BTreeMap<String, String>> = sources.iter().map(|source| coordinates(&source.prefix)).collect();
    let own = [METHOD, SPP, NFE, STRATUM];
    let names: BTreeSet<&str> = of.iter().flat_map(|axes| axes.keys().map(String::as_str)).chain(own).collect();
    for (list, chosen) in [("rows", &params.rows), ("columns", &params.columns)] {
        for (place, name) in chosen.iter().enumerate().filter(|(_, name)| !names.contains(name.as_str())) {
            let message = format!("`{list}` names the axis `{name}`, which the scores do not have");
            let hint = format!("they have {}", quoted(&names));
            problems.push(Foreseen::param(&format!("/{list}/{place}"), message, hint));
        }
    }
    let placed = |name: &str| params.rows.iter().chain(&params.columns).any(|own| own == name);
    if !params.rows.is_empty() && problems.is_empty() {
        // Where no image is sure to be there, there may be no score with this value.
        let sure: Vec<_> =
            sources.iter().zip(&of).filter(|(source, _)| source.facts.get(facts::SPP).is_some()).collect();
        for name in names.iter().filter(|name| !own.contains(*name) && !placed(name)) {
            let values: BTreeSet<&str> =
                sure.iter().map(|(_, axes)| axes.get(*name).map_or("", String::as_str)).collect();
            if values.len() > 1 {
                let message = format!(
                    "the axis `{name}` has the values {} and is neither in `rows` nor in `columns`",
                    quoted(&values)
                );
                let hint = format!("add it, or select one value as in `scores: \"node[{name}=value]\"`");
                problems.push(Foreseen::param("/rows", message, hint));
            }
        }
    }
    if let Some(AgainstParams { axis, value }) = &params.against {
        if !names.contains(axis.as_str()) {
            let message = format!("`against` names the axis `{axis}`, which the scores do not have");
            problems.push(Foreseen::param("/against/axis", message, format!("they have {}", quoted(&names))));
        } else if !own.contains(&axis.as_str()) {
            let values: BTreeSet<&str> = of.iter().filter_map(|axes| axes.get(axis).map(String::as_str)).collect();
            if !values.iter().any(|text| AxisValue::parse(text) == value.value()) {
                let message = format!("the axis `{axis}` has no value `{}`", value.value());
                problems.push(Foreseen::param("/against/value", message, format!("it has {}", quoted(&values))));
            }
        }
    }
    problems
}

/// One score with its coordinates on all axes.
struct Scored<'a> {
    item: &'a str,
    axes: BTreeMap<String, String>,
    metrics: &'a Metrics,
}

/// The scores, each with its coordinates; those of the matrix by the names there.
fn scored(scores: &[(ItemKey, SceneScores)]) -> Result<Vec<Scored<'_>>, KindError> {
    let mut out = Vec::new();
    for (key, of) in scores {
        let (cell, item) = key.split_cell().unwrap_or(("", key.as_str()));
        let own = coordinates(cell);
        if let Some(axis) = [SPP, NFE, STRATUM].into_iter().find(|axis| own.contains_key(*axis)) {
            return Err(KindError::Input(format!(
                "the matrix of `scores` has an axis `{axis}`, which every table has; give the axis another name"
            )));
        }
        for score in &of.scores {
            let mut axes = own.clone();
            // A matrix axis `method` names what the images say, too, or tells apart more than they do.
            axes.entry(METHOD.to_owned()).or_insert_with(|| score.method.clone());
            axes.insert(SPP.to_owned(), score.from_spp.to_string());
            axes.insert(NFE.to_owned(), score.nfe.to_string());
            axes.insert(STRATUM.to_owned(), stratum(item));
            out.push(Scored { item, axes, metrics: &score.metrics });
        }
    }
    Ok(out)
}

fn quoted(names: impl IntoIterator<Item = impl AsRef<str>>) -> String {
    names.into_iter().map(|name| format!("`{}`", name.as_ref())).collect::<Vec<_>>().join(", ")
}

/// The values of every axis, by its name. A score without a coordinate has the empty text there.
fn values(scored: &[Scored<'_>]) -> BTreeMap<String, BTreeSet<String>> {
    let names: BTreeSet<&String> = scored.iter().flat_map(|score| score.axes.keys()).collect();
    let of = |name: &String| scored.iter().map(|score| score.axes.get(name).cloned().unwrap_or_default()).collect();
    names.into_iter().map(|name| (name.clone(), of(name))).collect()
}

/// Names of the axes of rows, and of those of columns.
fn chosen(values: &BTreeMap<String, BTreeSet<String>>, params: &TableParams) -> Result<[Vec<String>; 2], KindError> {
    for (list, names) in [("rows", &params.rows), ("columns", &params.columns)] {
        if let Some(name) = names.iter().find(|name| !values.contains_key(*name)) {
            return Err(KindError::Input(format!(
                "`{list}` names the axis `{name}`, which the scores do not have; they have {}",
                quoted(values.keys())
            )));
        }
    }
    let varies = |name: &&String| values[*name].len() > 1 && name.as_str() != STRATUM;
    let rows = if params.rows.is_empty() {
        values.keys().filter(varies).filter(|name| !params.columns.contains(name)).cloned().collect()
    } else {
        params.rows.clone()
    };
    let placed = |name: &&String| rows.contains(name) || params.columns.contains(name);
    if let Some(name) = values.keys().filter(varies).find(|name| !placed(name)) {
        return Err(KindError::Input(format!(
            "the axis `{name}` has the values {} and is neither in `rows` nor in `columns`; add it, or select one \
             value as in `scores: \"node[{name}=value]\"`",
            quoted(&values[name])
        )));
    }
    Ok([rows, params.columns.clone()])
}

/// The scores of a cell by item.
type Cell<'a> = BTreeMap<&'a str, &'a Metrics>;

/// Sums scores up by axes.
///
/// # Errors
/// If there are none, an axis is unknown or left over, two scores meet in one place, or cells differ in their items.
pub fn tabulate(
    scores: &[(ItemKey, SceneScores)],
    groups: &Groups,
    params: &TableParams,
    seed: u64,
) -> Result<ScoreTable, KindError> {
    let mut notes: Vec<String> = scores.iter().filter_map(|(_, of)| of.note.clone()).collect();
    notes.sort_unstable();
    notes.dedup();
    let scored = scored(scores)?;
    if scored.is_empty() {
        let why = if notes.is_empty() { String::new() } else { format!(": {}", notes.join("; ")) };
        return Err(KindError::Input(format!("there are no scores to tabulate{why}")));
    }
    let values = values(&scored);
    let [rows, columns] = chosen(&values, params)?;
    let names: Vec<&String> = rows.iter().chain(&columns).collect();
    let axes: Vec<TableAxis> = names
        .iter()
        .map(|name| TableAxis::new(name.as_str(), values[*name].iter().map(|value| AxisValue::parse(value))))
        .collect();

    let mut cells: Vec<(Vec<AxisValue>, Cell<'_>)> = Vec::new();
    let mut places: BTreeMap<Vec<&str>, usize> = BTreeMap::new();
    let mut per_item = Vec::with_capacity(scored.len());
    for score in &scored {
        let texts: Vec<&str> = names.iter().map(|name| score.axes.get(*name).map_or("", String::as_str)).collect();
        let at: Vec<AxisValue> = texts.iter().map(|text| AxisValue::parse(text)).collect();
        let place = *places.entry(texts).or_insert_with(|| {
            cells.push((at.clone(), Cell::new()));
            cells.len() - 1
        });
        if cells[place].1.insert(score.item, score.metrics).is_some() {
            return Err(KindError::Input(format!(
                "two scores of `{}` meet in the cell {}; give the nodes of `scores` a matrix axis that differs",
                score.item,
                described(&axes, &at)
            )));
        }
        per_item.push(TableItem {
            item: score.item.to_owned(),
            stratum: score.axes[STRATUM].clone(),
            at,
            metrics: *score.metrics,
        });
    }
    cells.sort_by(|a, b| order(&a.0, &b.0));
    per_item.sort_by(|a, b| order(&a.at, &b.at).then_with(|| a.item.cmp(&b.item)));
    let stratum_axis = names.iter().position(|name| name.as_str() == STRATUM);
    same_items(&cells, stratum_axis, &axes)?;
    let against = params.against.as_ref().map(|against| reference(against, &axes)).transpose()?;

    let items: BTreeSet<&str> = scored.iter().map(|score| score.item).collect();
    let references: BTreeSet<u64> = scores.iter().map(|(_, of)| of.reference_spp).collect();
    Ok(ScoreTable {
        title: params.title.clone(),
        row_axes: rows.len(),
        metrics: params.metrics.clone(),
        reference_spp: references.first().copied().filter(|_| references.len() == 1),
        items: items.len() as u64,
        groups: groups.count(items.iter().copied())?,
        resamples: params.resamples,
        cells: estimates(&cells, stratum_axis, against.as_ref(), groups, params, seed)?,
        against: against.map(|(axis, value)| TableAgainst { axis: axes[axis].name.clone(), value }),
        axes,
        per_item,
        notes,
        formats: TableFormats { latex: params.latex },
    })
}

/// A cell's place, for people.
fn described(axes: &[TableAxis], at: &[AxisValue]) -> String {
    let pairs: Vec<String> = axes.iter().zip(at).map(|(axis, value)| format!("{}={value}", axis.name)).collect();
    if pairs.is_empty() { "of all scores".into() } else { format!("`{}`", pairs.join(", ")) }
}

/// Holds that cells have the same items; where the stratum is an axis, cells of one stratum.
fn same_items(
    cells: &[(Vec<AxisValue>, Cell<'_>)],
    stratum_axis: Option<usize>,
    axes: &[TableAxis],
) -> Result<(), KindError> {
    let mut first: BTreeMap<String, &(Vec<AxisValue>, Cell<'_>)> = BTreeMap::new();
    for cell in cells {
        let stratum = stratum_axis.map(|axis| cell.0[axis].to_string()).unwrap_or_default();
        let other = *first.entry(stratum).or_insert(cell);
        for (has, lacks) in [(other, cell), (cell, other)] {
            if let Some(item) = has.1.keys().find(|item| !lacks.1.contains_key(*item)) {
                return Err(KindError::Input(format!(
                    "the cell {} has a score of `{item}` and the cell {} has none; score the same items in all cells",
                    described(axes, &has.0),
                    described(axes, &lacks.0)
                )));
            }
        }
    }
    Ok(())
}

/// The axis and the value that `against` names.
fn reference(against: &AgainstParams, axes: &[TableAxis]) -> Result<(usize, AxisValue), KindError> {
    let place = axes.iter().position(|axis| axis.name == against.axis).ok_or_else(|| {
        KindError::Input(format!(
            "`against` names the axis `{}`, which the table does not have; it has {}",
            against.axis,
            quoted(axes.iter().map(|axis| &axis.name))
        ))
    })?;
    let value = against.value.value();
    if !axes[place].values.contains(&value) {
        return Err(KindError::Input(format!(
            "`against` names {} `{value}`, which no score has; there are {}",
            against.axis,
            quoted(axes[place].values.iter().map(ToString::to_string))
        )));
    }
    Ok((place, value))
}

/// Means, intervals and differences of all cells. Cells of the same items share their resamples.
fn estimates(
    cells: &[(Vec<AxisValue>, Cell<'_>)],
    stratum_axis: Option<usize>,
    against: Option<&(usize, AxisValue)>,
    groups: &Groups,
    params: &TableParams,
    seed: u64,
) -> Result<Vec<TableCell>, KindError> {
    let count = params.metrics.len();
    let stratum = |at: &[AxisValue]| stratum_axis.map(|axis| at[axis].to_string()).unwrap_or_default();
    let strata: BTreeSet<String> = cells.iter().map(|(at, _)| stratum(at)).collect();
    let mut out: Vec<Option<TableCell>> = vec![None; cells.len()];
    for of in strata {
        let own: Vec<usize> = (0..cells.len()).filter(|cell| stratum(&cells[*cell].0) == of).collect();
        let mut table = Table::new(own.len() * count);
        for item in cells[own[0]].1.keys() {
            let row: Vec<f64> = own
                .iter()
                .flat_map(|cell| {
                    let metrics = cells[*cell].1[item];
                    params.metrics.iter().map(|name| bounded(name, metrics.get(name).expect("`check` knows the names")))
                })
                .collect();
            table.push(groups.of(item)?, &row);
        }
        let resampled = Resampled::new(&table, params.resamples as usize, seed).expect("a cell has an item");
        for (place, cell) in own.iter().enumerate() {
            let at = &cells[*cell].0;
            let by_metric = |of: &dyn Fn(&[f64], usize) -> f64| {
                let one = |(i, name): (usize, &String)| (name.clone(), resampled.estimate(|means| of(means, i)));
                params.metrics.iter().enumerate().map(one).collect()
            };
            let base = against.filter(|(axis, value)| at[*axis] != *value).and_then(|(axis, value)| {
                own.iter().position(|other| {
                    let mut like = at.clone();
                    like[*axis] = value.clone();
                    cells[*other].0 == like
                })
            });
            out[*cell] = Some(TableCell {
                at: at.clone(),
                items: cells[*cell].1.len() as u64,
                metrics: by_metric(&|means, i| means[place * count + i]),
                difference: base.map_or_else(BTreeMap::new, |base| {
                    by_metric(&|means, i| means[place * count + i] - means[base * count + i])
                }),
            });
        }
    }
    Ok(out.into_iter().map(|cell| cell.expect("every cell is of a stratum")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::records::Score;

    fn metrics(psnr: f64) -> Metrics {
        Metrics {
            hdr_psnr: psnr,
            hdr_psnr_max: psnr,
            hdr_mae: 1.0 / psnr,
            preview_psnr: psnr,
            preview_mae: 0.1,
            ssim: 0.5,
        }
    }

    fn scores(key: &str, of: &[(u64, f64)]) -> (ItemKey, SceneScores) {
        let score = |(spp, psnr): &(u64, f64)| Score {
            method: "hold".into(),
            from_spp: *spp,
            to_spp: *spp,
            nfe: 0,
            metrics: metrics(*psnr),
        };
        let scores = of.iter().map(score).collect();
        (ItemKey::new(key).expect("plain"), SceneScores { reference_spp: 1024, scores, note: None })
    }

    /// Two samplers, two scenes of one stratum and one of another, two sample counts.
    fn samplers() -> Vec<(ItemKey, SceneScores)> {
        let mut out = Vec::new();
        for (sampler, more) in [("independent", 0.0), ("sobol", 3.0)] {
            for (scene, base) in [("L0-open-000000", 20.0), ("L0-open-000001", 24.0), ("L3-enclosed-000000", 10.0)] {
                let of = [(4, base + more), (16, base + more + 6.0)];
                out.push(scores(&format!("sampler={sampler}/{scene}"), &of));
            }
        }
        out
    }

    fn made(scores: &[(ItemKey, SceneScores)], params: &TableParams) -> ScoreTable {
        tabulate(scores, &Groups::none(), params, 7).expect("a table")
    }

    fn at(table: &ScoreTable, values: &[&str]) -> TableCell {
        let at: Vec<AxisValue> = values.iter().map(|value| AxisValue::parse(value)).collect();
        table.cell(&at).unwrap_or_else(|| panic!("no cell {values:?} in {table:?}")).clone()
    }

    #[test]
    fn two_samplers_by_sample_count_with_paired_differences() {
        let params = TableParams {
            columns: vec!["spp".into()],
            against: Some(AgainstParams { axis: "sampler".into(), value: Coordinate::Text("independent".into()) }),
            ..TableParams::default()
        };
        let table = made(&samplers(), &params);
        assert_eq!(table.axes.iter().map(|axis| axis.name.as_str()).collect::<Vec<_>>(), ["sampler", "spp"]);
        assert_eq!((table.row_axes, table.items, table.reference_spp), (1, 3, Some(1024)));
        let independent = at(&table, &["independent", "4"]);
        assert!((independent.metrics["hdr_psnr"].mean - 18.0).abs() < 1e-12 && independent.difference.is_empty());
        // Pairs differ by 3 in every scene, so the interval is a point, though scenes differ by 14 dB.
        let gain = at(&table, &["sobol", "16"]).difference["hdr_psnr"];
        assert!([gain.mean, gain.low, gain.high].iter().all(|value| (value - 3.0).abs() < 1e-9), "{gain:?}");
        assert!(independent.metrics["hdr_psnr"].high > independent.metrics["hdr_psnr"].low + 1.0);
        assert_eq!(table.per_item.len(), 12);
    }

    #[test]
    fn a_stratum_is_an_axis_where_it_is_asked_for() {
        let params = TableParams {
            rows: vec!["stratum".into(), "sampler".into()],
            columns: vec!["spp".into()],
            ..TableParams::default()
        };
        let table = made(&samplers(), &params);
        assert_eq!(at(&table, &["L0-open", "sobol", "4"]).metrics["hdr_psnr"].mean, 25.0);
        assert_eq!(at(&table, &["L3-enclosed", "sobol", "4"]).items, 1);
    }

    fn refused(scores: &[(ItemKey, SceneScores)], params: &TableParams) -> String {
        tabulate(scores, &Groups::none(), params, 7).expect_err("refused").to_string()
    }

    #[test]
    fn axes_that_are_unknown_or_left_over_are_refused_by_name() {
        let unknown = TableParams { columns: vec!["rung".into()], ..TableParams::default() };
        let told = refused(&samplers(), &unknown);
        assert!(told.contains("`rung`") && told.contains("`spp`") && told.contains("`sampler`"), "{told}");
        let left = TableParams { rows: vec!["sampler".into()], ..TableParams::default() };
        let told = refused(&samplers(), &left);
        assert!(told.contains("`spp` has the values `16`, `4`"), "{told}");
        let against = |axis: &str, value: Coordinate| TableParams {
            against: Some(AgainstParams { axis: axis.into(), value }),
            ..TableParams::default()
        };
        let told = refused(&samplers(), &against("nfe", Coordinate::Integer(0)));
        assert!(told.contains("`nfe`, which the table does not have"), "{told}");
        let told = refused(&samplers(), &against("spp", Coordinate::Integer(5)));
        assert!(told.contains("spp `5`") && told.contains("`4`, `16`"), "{told}");
    }

    #[test]
    fn cells_of_other_items_and_scores_that_meet_are_refused() {
        let mut fewer = samplers();
        fewer.pop();
        let told = refused(&fewer, &TableParams::default());
        assert!(told.contains("has a score of `L3-enclosed-000000`") && told.contains("sampler=sobol"), "{told}");
        let twice = [scores("L0-open-000000", &[(4, 1.0), (4, 2.0)])];
        assert!(refused(&twice, &TableParams::default()).contains("two scores of `L0-open-000000`"));
        let none = [scores("L0-open-000000", &[])];
        assert!(refused(&none, &TableParams::default()).contains("no scores"));
    }

    #[test]
    fn metrics_and_axes_are_checked_before_a_run() {
        assert!(TableKind::check(&TableParams::default()).is_empty());
        let params = TableParams {
            metrics: vec!["psnr".into()],
            rows: vec!["spp".into()],
            columns: vec!["spp".into()],
            ..TableParams::default()
        };
        let found: Vec<String> = TableKind::check(&params).into_iter().map(|problem| problem.pointer).collect();
        assert_eq!(found, ["/metrics/0", "/columns/0"]);
    }

    #[test]
    fn a_node_without_an_axis_stands_beside_those_that_have_it() {
        let mut all = samplers();
        for scene in ["L0-open-000000", "L0-open-000001", "L3-enclosed-000000"] {
            all.push(scores(&format!("method=oidn/{scene}"), &[(4, 30.0), (16, 33.0)]));
        }
        let table = made(&all, &TableParams { columns: vec!["spp".into()], ..TableParams::default() });
        assert_eq!(table.row_heads().len(), 3);
        assert_eq!(at(&table, &["oidn", "", "4"]).metrics["hdr_psnr"].mean, 30.0);
    }
}
