//! Scores summed up by axes: cells, their means and intervals, and paired differences.

use super::{AgainstParams, TableParams};
use crate::{
    bootstrap::{Resampled, Table},
    evaluation::{common_metrics, coordinates, stratum},
    groups::Groups,
};
use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{ItemKey, KindError};
use tauflow_data::records::{
    AxisValue, Metrics, SceneScores, ScoreTable, TableAgainst, TableAxis, TableCell, TableFormats, TableItem, bounded,
    order,
};

/// The axes that every score has, beside those of matrices.
pub(super) const METHOD: &str = "method";
pub(super) const SPP: &str = "spp";
pub(super) const NFE: &str = "nfe";
pub(super) const STRATUM: &str = "stratum";

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
        if let Some(axis) = [SPP, STRATUM].into_iter().find(|axis| own.contains_key(*axis)) {
            return Err(KindError::Input(format!(
                "the matrix of `scores` has an axis `{axis}`, which every table has; give the axis another name"
            )));
        }
        for score in &of.scores {
            let mut axes = own.clone();
            // A matrix axis `nfe` lists the calls of a solver; each score has its own.
            axes.remove(NFE);
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

pub(super) fn quoted(names: impl IntoIterator<Item = impl AsRef<str>>) -> String {
    names.into_iter().map(|name| format!("`{}`", name.as_ref())).collect::<Vec<_>>().join(", ")
}

/// The values of every axis, by its name. A score without a coordinate has the empty text there.
fn values(scored: &[Scored<'_>]) -> BTreeMap<String, BTreeSet<String>> {
    let names: BTreeSet<&String> = scored.iter().flat_map(|score| score.axes.keys()).collect();
    let of = |name: &String| scored.iter().map(|score| score.axes.get(name).cloned().unwrap_or_default()).collect();
    names.into_iter().map(|name| (name.clone(), of(name))).collect()
}

/// Whether all scores of a cell have one value on the axis: the axes of the table determine it, as `from` does `spp`.
fn determined(scored: &[Scored<'_>], placed: &[&String], name: &str) -> bool {
    let value = |score: &Scored<'_>, name: &str| score.axes.get(name).cloned().unwrap_or_default();
    let mut of_cell: BTreeMap<Vec<String>, String> = BTreeMap::new();
    scored.iter().all(|score| {
        let cell = placed.iter().map(|name| value(score, name)).collect();
        let own = value(score, name);
        *of_cell.entry(cell).or_insert_with(|| own.clone()) == own
    })
}

/// Names of the axes of rows, and of those of columns.
fn chosen(
    scored: &[Scored<'_>],
    values: &BTreeMap<String, BTreeSet<String>>,
    params: &TableParams,
) -> Result<[Vec<String>; 2], KindError> {
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
    let placed: Vec<&String> = rows.iter().chain(&params.columns).collect();
    let left = |name: &&String| !placed.contains(name) && !determined(scored, &placed, name);
    if let Some(name) = values.keys().filter(varies).find(left) {
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
    let metrics = tabulated(scores, params, &mut notes)?;
    let values = values(&scored);
    let [rows, columns] = chosen(&scored, &values, params)?;
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
        cells: estimates(&cells, stratum_axis, against.as_ref(), groups, (metrics.as_slice(), params.resamples), seed)?,
        metrics,
        reference_spp: references.first().copied().filter(|_| references.len() == 1),
        items: items.len() as u64,
        groups: groups.count(items.iter().copied())?,
        resamples: params.resamples,
        against: against.map(|(axis, value)| TableAgainst { axis: axes[axis].name.clone(), value }),
        axes,
        per_item,
        notes,
        formats: TableFormats { latex: params.latex, parquet: params.parquet },
    })
}

/// The metrics of the table that all scores have. The others are left out, with a note.
fn tabulated(
    scores: &[(ItemKey, SceneScores)],
    params: &TableParams,
    notes: &mut Vec<String>,
) -> Result<Vec<String>, KindError> {
    let (common, partial) = common_metrics(scores.iter());
    let (there, absent): (Vec<String>, Vec<String>) =
        params.metrics.iter().cloned().partition(|name| common.contains(&name.as_str()));
    for name in &absent {
        let quoted = format!("`{name}`");
        match partial.iter().find(|note| note.starts_with(&quoted)) {
            Some(why) => notes.push(why.clone()),
            // A node that left the metric out says why.
            None if notes.iter().any(|note| note.contains(&quoted)) => {}
            None => notes.push(format!("{quoted}, because no score has it")),
        }
    }
    if there.is_empty() {
        return Err(KindError::Input(format!("no metric of the table can be tabulated: {}", notes.join("; "))));
    }
    Ok(there)
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
    (metrics, resamples): (&[String], u64),
    seed: u64,
) -> Result<Vec<TableCell>, KindError> {
    let count = metrics.len();
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
                    let of = cells[*cell].1[item];
                    metrics.iter().map(|name| bounded(name, of.get(name).expect("every score has the metrics")))
                })
                .collect();
            table.push(groups.of(item)?, &row);
        }
        let resampled = Resampled::new(&table, resamples as usize, seed).expect("a cell has an item");
        let one_group = groups.count(cells[own[0]].1.keys().copied())? == Some(1);
        for (place, cell) in own.iter().enumerate() {
            let at = &cells[*cell].0;
            let by_metric = |of: &dyn Fn(&[f64], usize) -> f64| {
                let one = |(i, name): (usize, &String)| (name.clone(), resampled.estimate(|means| of(means, i)));
                metrics.iter().enumerate().map(one).collect()
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
                one_group,
                metrics: by_metric(&|means, i| means[place * count + i]),
                difference: base.map_or_else(BTreeMap::new, |base| {
                    by_metric(&|means, i| means[place * count + i] - means[base * count + i])
                }),
            });
        }
    }
    Ok(out.into_iter().map(|cell| cell.expect("every cell is of a stratum")).collect())
}
