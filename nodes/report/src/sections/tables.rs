//! The main table: space x method x conditioning against NFE, AUC and TV; one tab for each metric.

use crate::{
    page::{Section, tabs},
    ranking::{Rank, Row, conditioning_name, digits, extra, metric_name, ranks, rows},
    sections::{method_html, no_intervals, resampled, signed_print, small_print},
    text::{escape, fixed, signed},
};
use std::fmt::Write as _;
use tauflow_data::{
    methods::HOLD,
    records::{Estimate, Evaluation, METRICS},
};

/// The section; none where it would hold the input alone.
pub fn section(evaluation: &Evaluation) -> Option<Section> {
    if evaluation.methods.is_empty() && evaluation.baselines.is_empty() {
        return None;
    }
    let mut panels = Vec::new();
    for metric in METRICS.iter().filter(|m| evaluation.hold.contains_key(**m)) {
        panels.push((metric_name(metric).to_owned(), table(evaluation, metric)));
        if *metric == "hdr_psnr" {
            panels.push(("Gain over hold (dB)".to_owned(), gains(evaluation, metric)));
        }
    }
    let intervals = match evaluation.has_intervals() {
        true => format!(
            "Small print: 95% bootstrap interval over {} ({} resamples).",
            resampled(evaluation.groups),
            evaluation.resamples
        ),
        false => no_intervals("scene", evaluation.groups),
    };
    let body = format!(
        "<p>Mean over {} test scenes, from {} spp, compared with I<sub>{}</sub>. Best in <b>bold</b>, second \
         <u>underlined</u>, after rounding. {intervals} AUC is the mean of the curve over log NFE. TV is its total \
         variation per unit of log NFE; lower is steadier.</p>{}",
        evaluation.scenes,
        evaluation.from_spp,
        evaluation.reference_spp,
        tabs("tables", &panels)
    );
    Some(Section::new("results", "Results", body))
}

/// Columns that tell the rows apart: heads, and texts of a row.
struct Names {
    space: bool,
    extra: bool,
}

impl Names {
    fn of(rows: &[Row<'_>]) -> Self {
        let mut spaces: Vec<&str> = rows.iter().filter_map(|r| r.table).map(|t| t.space.as_str()).collect();
        spaces.sort_unstable();
        spaces.dedup();
        Self { space: spaces.len() > 1, extra: rows.iter().filter_map(|r| r.table).any(|t| !extra(&t.cell).is_empty()) }
    }

    fn head(&self) -> String {
        let mut out = String::from("<tr>");
        if self.space {
            out.push_str(r#"<th class="left">Space</th>"#);
        }
        out.push_str(r#"<th class="left">Method</th><th class="left">Conditioning</th>"#);
        if self.extra {
            out.push_str(r#"<th class="left">Cell</th>"#);
        }
        out
    }

    /// The cells that name a row; the method only where it changes.
    fn row(&self, row: &Row<'_>, before: Option<&Row<'_>>) -> String {
        let mut out = String::new();
        let Some(table) = row.table else {
            let _ = write!(
                out,
                r#"{}<td class="left">{}</td><td class="left zero">the input itself</td>{}"#,
                if self.space { "<td></td>" } else { "" },
                method_html(HOLD),
                if self.extra { "<td></td>" } else { "" }
            );
            return out;
        };
        let same = before.and_then(|b| b.table).is_some_and(|b| b.method == table.method && b.space == table.space);
        if self.space {
            let _ = write!(out, r#"<td class="left">{}</td>"#, if same { String::new() } else { escape(&table.space) });
        }
        let name = if same { String::new() } else { method_html(&table.method) };
        let _ = write!(
            out,
            r#"<td class="left">{name}</td><td class="left">{}</td>"#,
            escape(&conditioning_name(&table.conditioning))
        );
        if self.extra {
            let _ = write!(out, r#"<td class="left">{}</td>"#, escape(&extra(&table.cell)));
        }
        out
    }
}

fn starts_group(row: &Row<'_>, before: Option<&Row<'_>>) -> bool {
    let key = |r: &Row<'_>| r.table.map(|t| (t.space.clone(), t.method.clone()));
    before.is_some_and(|b| key(b) != key(row))
}

/// The table of one metric.
pub fn table(evaluation: &Evaluation, metric: &str) -> String {
    let rows = rows(evaluation, metric);
    let digits = digits(metric);
    let ranks = ranks(&rows, metric, digits);
    let names = Names::of(&rows);
    let mut out =
        format!(r#"<div class="scroll"><table class="wide main" data-metric="{metric}"><thead>{}"#, names.head());
    for nfe in &evaluation.nfe {
        let _ = write!(out, "<th>NFE {nfe}</th>");
    }
    out.push_str(r#"<th class="apart">AUC</th><th>TV</th></tr></thead><tbody>"#);
    let columns = evaluation.nfe.len() + 2;
    for (r, row) in rows.iter().enumerate() {
        let before = r.checked_sub(1).map(|b| &rows[b]);
        let class = if starts_group(row, before) { r#" class="group""# } else { "" };
        let _ = write!(out, "<tr{class}>{}", names.row(row, before));
        for (c, figure) in row.figures.iter().enumerate() {
            let class = if c + 2 == columns { r#" class="apart""# } else { "" };
            let _ = match figure {
                Some(estimate) => {
                    let figure = figure_html(estimate, ranks[r][c], digits, evaluation.has_intervals());
                    write!(out, "<td{class}>{figure}</td>")
                }
                None => write!(out, r#"<td{class}><span class="zero">–</span></td>"#),
            };
        }
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table></div>");
    out
}

/// A mean with its rank, above its interval if it has one.
pub fn figure_html(estimate: &Estimate, rank: Rank, digits: usize, has_interval: bool) -> String {
    let mean = fixed(estimate.mean, digits);
    let mean = match rank {
        Rank::Best => format!(r#"<b class="best">{mean}</b>"#),
        Rank::Second => format!(r#"<span class="second">{mean}</span>"#),
        Rank::Other => format!("<span>{mean}</span>"),
    };
    mean + &small_print(estimate, digits, has_interval)
}

/// Paired differences to hold.
fn gains(evaluation: &Evaluation, metric: &str) -> String {
    let rows = rows(evaluation, metric);
    let names = Names::of(&rows);
    let mut out = format!(
        "<p class=\"note\">Difference to the input, paired by scene.{}</p><div class=\"scroll\"><table \
         class=\"wide\"><thead>{}",
        if evaluation.has_intervals() { " An interval above 0 is a significant gain." } else { "" },
        names.head()
    );
    for nfe in &evaluation.nfe {
        let _ = write!(out, "<th>NFE {nfe}</th>");
    }
    out.push_str("</tr></thead><tbody>");
    for (r, row) in rows.iter().enumerate().skip(1) {
        let before = (r > 1).then(|| &rows[r - 1]);
        let class = if starts_group(row, before) { r#" class="group""# } else { "" };
        let _ = write!(out, "<tr{class}>{}", names.row(row, before));
        for nfe in &evaluation.nfe {
            let gain = row.table.and_then(|t| t.at.iter().find(|a| a.nfe == *nfe)).and_then(|a| a.gain.get(metric));
            let _ = match gain {
                Some(g) => {
                    let range = signed_print(g, 2, evaluation.has_intervals());
                    write!(out, "<td>{}{range}</td>", signed(g.mean, 2))
                }
                None => write!(out, r#"<td class="zero">–</td>"#),
            };
        }
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table></div>");
    out
}
