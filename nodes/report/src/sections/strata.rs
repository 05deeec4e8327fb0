//! Heat maps: strata x methods at one NFE; the gain over hold in HDR PSNR, HDR PSNR itself, and each metric that was
//! computed on request.

use crate::{
    page::{Section, tabs},
    ranking::{colour, conditioning_name, digits, extra, method_name, metric_name, with_baselines},
    text::{escape, fixed, signed},
};
use std::{collections::BTreeMap, fmt::Write as _};
use tauflow_data::{
    StratumName,
    methods::HOLD,
    records::{BASIC, Evaluation, METRICS, MethodTable, bounded, higher_is_better},
};

/// The metric of gains, and the first of the values.
const METRIC: &str = "hdr_psnr";

/// A method and its means by stratum and metric.
type Column<'a> = (&'a MethodTable, &'a BTreeMap<String, BTreeMap<String, f64>>);

/// The section; none if no method was measured at `nfe`.
pub fn section(evaluation: &Evaluation, nfe: u64) -> Option<Section> {
    let at = |table: &'_ MethodTable| table.at.iter().position(|at| at.nfe == nfe);
    let tables = with_baselines(evaluation).into_iter();
    let columns: Vec<Column<'_>> = tables.filter_map(|table| Some((table, &table.at[at(table)?].strata))).collect();
    if columns.is_empty() {
        return None;
    }
    let requested = METRICS.iter().filter(|m| !BASIC.contains(m) && evaluation.hold.contains_key(**m));
    let mut panels = vec![("Gain in HDR PSNR (dB)".to_owned(), gains(evaluation, &columns, nfe))];
    for metric in [METRIC].iter().chain(requested) {
        panels.push((metric_name(metric).to_owned(), values(evaluation, &columns, nfe, metric)));
    }
    let out = format!(
        "<p>A stratum is a regime of light transport (L0 diffuse, L1 glossy, L2 refractive, L3 caustics) in a context \
         (environment, open, enclosed).</p>{}",
        tabs("heat", &panels)
    );
    Some(Section::new("strata", format!("Results by stratum at NFE {nfe}"), out))
}

/// Opens a table: the methods as heads.
fn head(columns: &[Column<'_>], hold: &str) -> String {
    let mut out = format!(
        "<div class=\"scroll\"><table class=\"wide heat\"><thead><tr><th rowspan=\"2\">Stratum</th><th \
         rowspan=\"2\">{hold}</th>"
    );
    let mut run = 0;
    while run < columns.len() {
        let method = &columns[run].0.method;
        let span = columns[run..].iter().take_while(|c| c.0.method == *method).count();
        let _ = write!(
            out,
            r#"<th class="of" colspan="{span}"><span class="key {}"></span>{}</th>"#,
            colour(method),
            escape(&method_name(method))
        );
        run += span;
    }
    out.push_str("</tr><tr>");
    for (table, _) in columns {
        let more = [conditioning_name(&table.conditioning), extra(&table.cell)];
        let more: Vec<String> = more.into_iter().filter(|m| !m.is_empty()).map(|m| escape(&m)).collect();
        let _ = write!(out, "<th>{}</th>", more.join("<br>"));
    }
    out + "</tr></thead><tbody>"
}

/// Gains over hold in HDR PSNR.
fn gains(evaluation: &Evaluation, columns: &[Column<'_>], nfe: u64) -> String {
    let hold = hold_by_stratum(evaluation, METRIC);
    let names: Vec<String> = StratumName::in_order(hold.keys());
    let gain = |(_, of): &Column<'_>, stratum: &str| Some(of.get(stratum)?.get(METRIC)? - hold.get(stratum)?);
    let peak = columns
        .iter()
        .flat_map(|c| names.iter().filter_map(|s| gain(c, s)))
        .filter(|g| g.is_finite())
        .fold(1e-9, |m: f64, g| m.max(g.abs()));
    let mut out = format!(
        "<p>HDR PSNR at NFE {nfe} minus HDR PSNR of the input (hold), in dB. Blue is a gain, orange a loss.</p>{}",
        head(columns, "Hold (dB)")
    );
    for stratum in &names {
        let _ =
            write!(out, "<tr><td>{}</td><td>{}</td>", escape(&StratumName::label(stratum)), fixed(hold[stratum], 2));
        for column in columns {
            out.push_str(&gain_cell(gain(column, stratum), peak));
        }
        out.push_str("</tr>");
    }
    let mean = evaluation.hold.get(METRIC).map_or(f64::NAN, |e| e.mean);
    let _ = write!(out, r#"<tr class="total"><td>All scenes</td><td>{}</td>"#, fixed(mean, 2));
    for (table, _) in columns {
        let all = table.at.iter().find(|a| a.nfe == nfe).and_then(|a| a.gain.get(METRIC)).map(|e| e.mean);
        out.push_str(&gain_cell(all, peak));
    }
    out + "</tr></tbody></table></div>"
}

fn gain_cell(gain: Option<f64>, peak: f64) -> String {
    let Some(gain) = gain.filter(|g| !g.is_nan()) else { return r#"<td class="cell zero">–</td>"#.into() };
    let share = (gain.abs() / peak).min(1.0) * 58.0;
    let side = if gain >= 0.0 { "pos" } else { "neg" };
    coloured(side, share, &signed(gain, 2))
}

fn coloured(side: &str, share: f64, text: &str) -> String {
    format!(
        r#"<td class="cell" style="background:color-mix(in srgb,var(--{side}) {share:.0}%,var(--paper))">{text}</td>"#
    )
}

/// A metric itself: the input and all methods on one scale of colours, from the worst to the best.
fn values(evaluation: &Evaluation, columns: &[Column<'_>], nfe: u64, metric: &str) -> String {
    let (hold, digits) = (hold_by_stratum(evaluation, metric), digits(metric));
    let names: Vec<String> = StratumName::in_order(hold.keys());
    let value = |(_, of): &Column<'_>, stratum: &str| of.get(stratum)?.get(metric).copied();
    let all = columns.iter().flat_map(|c| names.iter().filter_map(|s| value(c, s))).chain(hold.values().copied());
    let ends = all
        .filter(|v| v.is_finite())
        .fold(None, |ends: Option<(f64, f64)>, v| Some(ends.map_or((v, v), |(low, high)| (low.min(v), high.max(v)))));
    let (low, high) = ends.unwrap_or((0.0, 0.0));
    let cell = |value: Option<f64>| {
        let Some(value) = value.filter(|v| !v.is_nan()) else { return r#"<td class="cell zero">–</td>"#.to_owned() };
        let share = if high > low { ((value - low) / (high - low)).clamp(0.0, 1.0) } else { 0.0 };
        let share = if higher_is_better(metric) { share } else { 1.0 - share };
        coloured("pos", 58.0 * share, &fixed(value, digits))
    };
    let mut out = format!(
        "<p>{} at NFE {nfe}. The strongest colour is the best of all methods and strata.</p>{}",
        metric_name(metric),
        head(columns, "Hold")
    );
    for stratum in &names {
        let _ = write!(out, "<tr><td>{}</td>{}", escape(&StratumName::label(stratum)), cell(Some(hold[stratum])));
        out.extend(columns.iter().map(|column| cell(value(column, stratum))));
        out.push_str("</tr>");
    }
    let mean = evaluation.hold.get(metric).map(|e| e.mean);
    let _ = write!(out, r#"<tr class="total"><td>All scenes</td>{}"#, cell(mean));
    for (table, _) in columns {
        let all = table.at.iter().find(|a| a.nfe == nfe).and_then(|a| a.metrics.get(metric)).map(|e| e.mean);
        out.push_str(&cell(all));
    }
    out + "</tr></tbody></table></div>"
}

/// Mean of a metric of the input by stratum, from the scores of each scene as they enter all means.
pub fn hold_by_stratum(evaluation: &Evaluation, metric: &str) -> BTreeMap<String, f64> {
    let mut sums: BTreeMap<String, (f64, f64)> = BTreeMap::new();
    for row in evaluation.per_scene.iter().filter(|r| r.score.method == HOLD) {
        let Some(value) = row.score.metrics.get(metric) else { continue };
        let sum = sums.entry(row.stratum.clone()).or_default();
        *sum = (sum.0 + bounded(metric, value), sum.1 + 1.0);
    }
    sums.into_iter().map(|(s, (sum, n))| (s, sum / n)).collect()
}
