//! Tables of scores by any axes: one tab for each metric, and a chart over a numeric axis of columns.

use crate::{
    montage::Montage,
    page::{Section, tabs},
    ranking::{Rank, colour, digits, metric_name, rank},
    sections::{montage::grid, no_intervals, resampled, signed_print, tables::figure_html},
    shelf::Viewer,
    svg::{Plot, Scale},
    text::{count, escape, fixed, interval, plural, signed},
};
use std::fmt::Write as _;
use tauflow_contract::KindError;
use tauflow_data::records::{AxisType, AxisValue, Estimate, ScoreTable, TableCell, higher_is_better};

/// One section for all tables; none without a table.
pub fn section(tables: &[(String, ScoreTable)]) -> Option<Section> {
    if tables.is_empty() {
        return None;
    }
    let mut body = String::new();
    for (place, (_, table)) in tables.iter().enumerate() {
        if !table.title.is_empty() {
            let _ = write!(body, "<h3>{}</h3>", escape(&table.title));
        }
        let _ = write!(body, "<p>{}</p>", about(table));
        let mut panels = Vec::new();
        for metric in &table.metrics {
            panels.push((metric_name(metric).to_owned(), figures(table, metric) + &chart(table, metric)));
            if let Some(differences) = differences(table, metric) {
                panels.push((format!("{}, difference", metric_name(metric)), differences));
            }
        }
        body += &tabs(&format!("score-table-{place}"), &panels);
        for note in &table.notes {
            let _ = write!(body, "<p class=\"note\">Omitted: {}.</p>", escape(note));
        }
    }
    Some(Section::new("score-tables", "Scores", body))
}

/// The pictures of methods, and of ladders. Without them, a link to the viewer if there is one, unless other pictures
/// of the page lead to it (`linked`).
///
/// # Errors
/// If a picture cannot be encoded.
pub fn pictures(
    methods: Option<&Montage>,
    ladders: Option<&Montage>,
    viewer: Option<&Viewer>,
    linked: bool,
) -> Result<Option<Section>, KindError> {
    let mut body = String::new();
    if let Some(methods) = methods {
        let _ = write!(
            body,
            "<p>The first scenes by number. Captions: HDR PSNR in dB against the reference, with the best of each row \
             in bold.</p>{}",
            grid(methods, viewer)?
        );
    }
    if let Some(ladders) = ladders {
        let _ = write!(
            body,
            "<p>The first scenes by number, at the lowest sample count of each cell. The last column shows the largest \
             sample count, and sets the exposure of its row.</p>{}",
            grid(ladders, viewer)?
        );
    }
    let shown = methods.is_some() || ladders.is_some();
    if viewer.is_some() {
        let scenes = if shown { "these scenes" } else { "the scenes" };
        let _ = write!(body, "<p><a href=\"{}\">Open the viewer</a> of {scenes}.</p>", Viewer::FILE);
    }
    Ok(Some(Section::new("pictures", "Pictures", body)).filter(|_| shown || viewer.is_some() && !linked))
}

/// The abstract: what the table compares, the best cell by the first metric, and the difference to the reference cell.
pub fn opening(table: &ScoreTable) -> String {
    let Some(metric) = table.metrics.first() else { return String::new() };
    let digits = digits(metric);
    let means = table.cells.iter().filter_map(|cell| Some((cell, cell.metrics.get(metric)?)));
    let better = |a: f64, b: f64| if higher_is_better(metric) { b > a } else { b < a };
    let best = means.reduce(|a, b| if better(a.1.mean, b.1.mean) { b } else { a });
    let Some((cell, mean)) = best else { return String::new() };
    let range = |of: &Estimate| match cell.has_intervals() {
        true => format!(" {}", interval(of, digits)),
        false => String::new(),
    };
    let mut out = format!(
        "<p class=\"lead\">{} Best {}: <b>{}</b>{} at {}, mean over {}.",
        compared(table),
        escape(metric_name(metric)),
        fixed(mean.mean, digits),
        range(mean),
        place(table, &cell.at),
        plural(cell.items, "item")
    );
    if let (Some(against), Some(gain)) = (&table.against, cell.difference.get(metric)) {
        let _ = write!(
            out,
            " The paired difference to {} {} is <b>{}</b>{}.",
            escape(&against.axis),
            escape(&against.value.to_string()),
            signed(gain.mean, digits),
            range(gain)
        );
    }
    out + "</p>"
}

/// One sentence on what the table compares.
fn compared(table: &ScoreTable) -> String {
    let title = if table.title.is_empty() { String::new() } else { format!("{}: ", escape(&table.title)) };
    let names: Vec<String> = table.axes.iter().map(|axis| escape(&axis.name)).collect();
    let by = match names.split_last() {
        None => String::new(),
        Some((only, [])) => format!(" by {only}"),
        Some((last, others)) => format!(" by {} and {last}", others.join(", ")),
    };
    let scored = format!("<b>{}</b> scored{by}", plural(table.items, "item"));
    match table.reference_spp {
        Some(spp) => format!("{title}{scored}, against references of {} samples per pixel.", count(spp)),
        None => format!("{title}{scored}."),
    }
}

fn place(table: &ScoreTable, at: &[AxisValue]) -> String {
    let pairs = table.axes.iter().zip(at).filter(|(_, value)| !value.to_string().is_empty());
    let pairs: Vec<String> = pairs.map(|(axis, value)| escape(&format!("{} {value}", axis.name))).collect();
    if pairs.is_empty() { "all scores".into() } else { pairs.join(", ") }
}

/// One sentence on what the figures are.
fn about(table: &ScoreTable) -> String {
    let reference =
        table.reference_spp.map_or_else(String::new, |spp| format!(" against references of {spp} samples per pixel"));
    let single = table.cells.iter().filter(|cell| !cell.has_intervals()).count();
    let intervals = if single > 0 && single == table.cells.len() {
        no_intervals("item", table.groups)
    } else {
        format!(
            "Small print: 95% bootstrap interval over {} ({} resamples){}.",
            table.groups.map_or_else(|| "items".to_owned(), |groups| resampled(Some(groups))),
            table.resamples,
            if single > 0 { "; omitted for means over one of them" } else { "" }
        )
    };
    format!(
        "Mean over {}{reference}. Best of a column in <b>bold</b>, second <u>underlined</u>, after rounding. \
         {intervals}",
        plural(table.items, "item")
    )
}

/// The head: names of the row axes, and the values of each column.
fn head(table: &ScoreTable, columns: &[Vec<AxisValue>], metric: &str) -> String {
    let (rows, of_columns) = table.split_axes();
    let mut out = String::from("<tr>");
    for axis in rows {
        let _ = write!(out, r#"<th class="left">{}</th>"#, escape(&axis.name));
    }
    for column in columns {
        let names: Vec<String> =
            of_columns.iter().zip(column).map(|(axis, value)| format!("{} {value}", axis.name)).collect();
        let name = if names.is_empty() { metric_name(metric).to_owned() } else { names.join(", ") };
        let _ = write!(out, "<th>{}</th>", escape(&name));
    }
    out + "</tr>"
}

fn row_head(row: &[AxisValue], before: Option<&Vec<AxisValue>>) -> String {
    let mut same = true;
    let mut out = String::new();
    for (place, value) in row.iter().enumerate() {
        same &= before.is_some_and(|before| before[place] == *value) && place + 1 < row.len();
        let text = if same { String::new() } else { escape(&value.to_string()) };
        let _ = write!(out, r#"<td class="left">{}</td>"#, if text.is_empty() && !same { "–" } else { &text });
    }
    out
}

fn at(row: &[AxisValue], column: &[AxisValue]) -> Vec<AxisValue> {
    row.iter().chain(column).cloned().collect()
}

/// The means of one metric.
fn figures(table: &ScoreTable, metric: &str) -> String {
    let (rows, columns) = (table.row_heads(), table.column_heads());
    let digits = digits(metric);
    let estimate = |row: &[AxisValue], column: &[AxisValue]| -> Option<(Estimate, bool)> {
        table.cell(&at(row, column)).and_then(|cell| Some((*cell.metrics.get(metric)?, cell.has_intervals())))
    };
    let ranks: Vec<Vec<Rank>> = columns
        .iter()
        .map(|column| {
            let means: Vec<Option<f64>> = rows.iter().map(|row| estimate(row, column).map(|(e, _)| e.mean)).collect();
            rank(&means, higher_is_better(metric), digits)
        })
        .collect();
    let mut out = format!(
        r#"<div class="scroll"><table class="wide main" data-metric="{metric}"><thead>{}</thead><tbody>"#,
        head(table, &columns, metric)
    );
    for (r, row) in rows.iter().enumerate() {
        let _ = write!(out, "<tr>{}", row_head(row, r.checked_sub(1).map(|before| &rows[before])));
        for (c, column) in columns.iter().enumerate() {
            let _ = match estimate(row, column) {
                Some((estimate, has_interval)) => {
                    write!(out, "<td>{}</td>", figure_html(&estimate, ranks[c][r], digits, has_interval))
                }
                None => write!(out, r#"<td><span class="zero">–</span></td>"#),
            };
        }
        out.push_str("</tr>");
    }
    out + "</tbody></table></div>"
}

/// Paired differences of one metric; none if the table has none.
fn differences(table: &ScoreTable, metric: &str) -> Option<String> {
    let against = table.against.as_ref()?;
    let (rows, columns) = (table.row_heads(), table.column_heads());
    let digits = digits(metric);
    let mut out = format!(
        "<p class=\"note\">Difference to {} {}, paired by item.</p><div class=\"scroll\"><table \
         class=\"wide\"><thead>{}</thead><tbody>",
        escape(&against.axis),
        escape(&against.value.to_string()),
        head(table, &columns, metric)
    );
    for (r, row) in rows.iter().enumerate() {
        let _ = write!(out, "<tr>{}", row_head(row, r.checked_sub(1).map(|before| &rows[before])));
        for column in &columns {
            let cell = table.cell(&at(row, column));
            let _ = match cell.and_then(|cell| Some((cell, cell.difference.get(metric)?))) {
                Some((cell, e)) => {
                    let range = signed_print(e, digits, cell.has_intervals());
                    write!(out, "<td>{}{range}</td>", signed(e.mean, digits))
                }
                None => write!(out, r#"<td class="zero">–</td>"#),
            };
        }
        out.push_str("</tr>");
    }
    Some(out + "</tbody></table></div>" + &difference_chart(table, metric, &against.value.to_string()))
}

/// A metric over the last axis of columns, a line for each row; nothing where that axis has no two positive numbers.
fn chart(table: &ScoreTable, metric: &str) -> String {
    let log = metric.ends_with("_mae");
    let scale = |values: Vec<f64>| if log { Scale::log(values, 0.05) } else { Scale::linear(values) };
    let drawn = plot(table, metric_name(metric), |cell| cell.metrics.get(metric).copied(), scale);
    drawn.map_or_else(String::new, |plot| figure(&plot, &format!("{}, {}", metric_name(metric), over(table))))
}

/// The paired differences, as [`chart`]; the line at 0 is what they are differences to.
fn difference_chart(table: &ScoreTable, metric: &str, against: &str) -> String {
    let scale = |values: Vec<f64>| Scale::linear(values.into_iter().chain([0.0]));
    let title = format!("{}, paired difference", metric_name(metric));
    let drawn = plot(table, &title, |cell| cell.difference.get(metric).copied(), scale);
    drawn.map_or_else(String::new, |mut plot| {
        let class = colour(against);
        plot.level(0.0, &format!("{class} dashed")).end_label(0.0, &class, against);
        figure(&plot, &format!("{title}, {}", over(table)))
    })
}

fn over(table: &ScoreTable) -> String {
    let axis = table.split_axes().1.last().map_or("", |axis| axis.name.as_str());
    format!("over {axis}; the values are in the table above")
}

fn figure(plot: &Plot, description: &str) -> String {
    format!("<figure style=\"max-width:640px\">{}</figure>", plot.finish(description))
}

/// Estimates over the only axis of columns, a line for each row that has some; none where that axis has no two numbers.
fn plot(
    table: &ScoreTable,
    title: &str,
    of: impl Fn(&TableCell) -> Option<Estimate>,
    scale: impl FnOnce(Vec<f64>) -> Scale,
) -> Option<Plot> {
    let (_, [axis]) = table.split_axes() else { return None };
    let numbers: Vec<f64> = axis.values.iter().filter_map(AxisValue::number).collect();
    let rows = table.row_heads();
    if axis.value_type == AxisType::Text || numbers.len() < 2 || rows.len() > 8 {
        return None;
    }
    let log = numbers.iter().all(|value| *value > 0.0);
    let x = if log { Scale::log(numbers.iter().copied(), 0.03) } else { Scale::linear(numbers.iter().copied()) };
    let estimates = table.cells.iter().filter_map(&of);
    let y = scale(estimates.flat_map(|e| [e.mean, e.low, e.high]).collect());
    let mut plot = Plot::new([560.0, 310.0], [52.0, 128.0, 34.0, 40.0], x, y);
    let log = if log { " (log)" } else { "" };
    plot.title(title).y_axis(6);
    plot.x_axis(
        axis.values.iter().filter_map(|value| Some((value.number()?, value.to_string()))),
        &format!("{}{log}", axis.name),
    );
    for row in &rows {
        let names: Vec<String> = row.iter().map(ToString::to_string).filter(|text| !text.is_empty()).collect();
        let cell = |value: &AxisValue| table.cell(&at(row, std::slice::from_ref(value)));
        let points: Vec<(f64, Estimate)> =
            axis.values.iter().filter_map(|value| Some((value.number()?, of(cell(value)?)?))).collect();
        let has_intervals = axis.values.iter().filter_map(cell).all(TableCell::has_intervals);
        plot.estimates(&points, has_intervals, &colour(&names.join("_")), &names.join(", "));
    }
    Some(plot)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn table() -> ScoreTable {
        let cell = |sampler: &str, spp: u64, mean: f64, difference: bool| {
            let estimate = |mean: f64| json!({ "hdr_psnr": { "mean": mean, "low": mean - 1.0, "high": mean + 1.0 } });
            let difference = if difference { estimate(2.5) } else { json!({}) };
            json!({ "at": [sampler, spp], "items": 3, "metrics": estimate(mean), "difference": difference })
        };
        serde_json::from_value(json!({
            "title": "Samplers <b>", "row_axes": 1, "metrics": ["hdr_psnr"], "reference_spp": 1024, "items": 3,
            "axes": [
                { "name": "sampler", "type": "text", "values": ["independent", "sobol"] },
                { "name": "spp", "type": "integer", "values": [4, 16] }
            ],
            "resamples": 100, "against": { "axis": "sampler", "value": "independent" }, "per_item": [],
            "cells": [
                cell("independent", 4, 20.0, false), cell("independent", 16, 26.0, false),
                cell("sobol", 4, 22.5, true), cell("sobol", 16, 28.5, true)
            ],
            "formats": { "latex": false }
        }))
        .expect("a table")
    }

    #[test]
    fn a_table_has_its_figures_a_chart_and_differences() {
        let section = section(&[("table".into(), table())]).expect("a table");
        let body = &section.body;
        assert!(body.contains("Samplers &lt;b&gt;") && !body.contains("Samplers <b>"), "titles are escaped");
        for text in ["28.50", "20.00", "spp 16", "+2.50", "<svg", "1024 samples per pixel"] {
            assert!(body.contains(text), "{text} is missing: {body}");
        }
        assert!(super::section(&[]).is_none());
        let opening = opening(&table());
        assert!(opening.contains("<b>28.50</b> [27.50, 29.50] at sampler sobol, spp 16"), "{opening}");
        assert!(opening.contains("to sampler independent is <b>+2.50</b> [1.50, 3.50]"), "{opening}");
    }

    #[test]
    fn a_table_over_one_item_has_means_without_intervals() {
        let mut table = table();
        table.items = 1;
        table.cells.iter_mut().for_each(|cell| cell.items = 1);
        let tables = [("table".into(), table)];
        let body = section(&tables).expect("a table").body;
        assert!(body.contains("28.50") && body.contains("+2.50") && body.contains("class=\"best\""), "{body}");
        assert!(body.contains("Intervals are omitted, because there is only one item."), "{body}");
        assert!(!body.contains("class=\"ci\"") && !body.contains("class=\"band") && !body.contains("95%"), "{body}");
        let opening = opening(&tables[0].1);
        assert!(opening.contains("<b>28.50</b> at sampler sobol, spp 16, mean over 1 item."), "{opening}");
        assert!(opening.contains("to sampler independent is <b>+2.50</b>."), "{opening}");
        // One row of one item, such as a stratum, leaves those of others as they are.
        let [(_, mut table)] = tables;
        table.cells[..2].iter_mut().for_each(|cell| cell.items = 3);
        let body = section(&[("table".into(), table)]).expect("a table").body;
        assert!(body.contains("(100 resamples); omitted for means over one of them."), "{body}");
        assert_eq!(body.matches("class=\"ci\"").count(), 2, "{body}");
    }

    #[test]
    fn an_axis_of_texts_has_no_chart() {
        let mut table = table();
        table.axes[1].value_type = AxisType::Text;
        assert_eq!(chart(&table, "hdr_psnr"), "");
    }
}
