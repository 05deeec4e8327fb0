//! Heat map: strata x methods at one NFE, gain over hold in HDR PSNR.

use crate::{
    page::Section,
    ranking::{colour, conditioning_name, extra, method_name, with_baselines},
    text::{escape, fixed, signed},
};
use std::{collections::BTreeMap, fmt::Write as _};
use tauflow_data::{
    StratumName,
    methods::HOLD,
    records::{Evaluation, MethodTable},
};

const METRIC: &str = "hdr_psnr";

/// The section; none if no method was measured at `nfe`.
pub fn section(evaluation: &Evaluation, nfe: u64) -> Option<Section> {
    let tables = with_baselines(evaluation);
    let columns: Vec<(&MethodTable, BTreeMap<String, f64>)> =
        tables.into_iter().filter_map(|t| Some((t, at(t, nfe)?))).collect();
    if columns.is_empty() {
        return None;
    }
    let hold = hold_by_stratum(evaluation);
    let names: Vec<String> = StratumName::in_order(hold.keys());
    let gain = |column: &BTreeMap<String, f64>, stratum: &str| Some(column.get(stratum)? - hold.get(stratum)?);
    let peak = columns
        .iter()
        .flat_map(|(_, c)| names.iter().filter_map(|s| gain(c, s)))
        .filter(|g| g.is_finite())
        .fold(1e-9, |m: f64, g| m.max(g.abs()));
    let mut out = format!(
        "<p>HDR PSNR at NFE {nfe} minus HDR PSNR of the input (hold), in dB. A stratum is a regime of light transport \
         (L0 diffuse, L1 glossy, L2 refractive, L3 caustics) in a context (environment, open, enclosed). Blue is a \
         gain, orange a loss.</p><div class=\"scroll\"><table class=\"wide heat\"><thead><tr><th \
         rowspan=\"2\">Stratum</th><th rowspan=\"2\">Hold (dB)</th>"
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
    for (table, _) in &columns {
        let more = [conditioning_name(&table.conditioning), extra(&table.cell)];
        let more: Vec<String> = more.into_iter().filter(|m| !m.is_empty()).map(|m| escape(&m)).collect();
        let _ = write!(out, "<th>{}</th>", more.join("<br>"));
    }
    out.push_str("</tr></thead><tbody>");
    for stratum in &names {
        let _ =
            write!(out, "<tr><td>{}</td><td>{}</td>", escape(&StratumName::label(stratum)), fixed(hold[stratum], 2));
        for (_, column) in &columns {
            out.push_str(&cell(gain(column, stratum), peak));
        }
        out.push_str("</tr>");
    }
    let mean = evaluation.hold.get(METRIC).map_or(f64::NAN, |e| e.mean);
    let _ = write!(out, r#"<tr class="total"><td>All scenes</td><td>{}</td>"#, fixed(mean, 2));
    for (table, _) in &columns {
        let all = table.at.iter().find(|a| a.nfe == nfe).and_then(|a| a.gain.get(METRIC)).map(|e| e.mean);
        out.push_str(&cell(all, peak));
    }
    out.push_str("</tr></tbody></table></div>");
    Some(Section::new("strata", format!("Gain by stratum at NFE {nfe}"), out))
}

fn cell(gain: Option<f64>, peak: f64) -> String {
    let Some(gain) = gain.filter(|g| !g.is_nan()) else { return r#"<td class="cell zero">–</td>"#.into() };
    let share = (gain.abs() / peak).min(1.0) * 58.0;
    let side = if gain >= 0.0 { "pos" } else { "neg" };
    format!(
        r#"<td class="cell" style="background:color-mix(in srgb,var(--{side}) {share:.0}%,var(--paper))">{}</td>"#,
        signed(gain, 2)
    )
}

fn at(table: &MethodTable, nfe: u64) -> Option<BTreeMap<String, f64>> {
    let at = table.at.iter().find(|a| a.nfe == nfe)?;
    Some(at.strata.iter().filter_map(|(s, metrics)| Some((s.clone(), *metrics.get(METRIC)?))).collect())
}

/// Mean HDR PSNR of the input by stratum, from the scores of each scene.
pub fn hold_by_stratum(evaluation: &Evaluation) -> BTreeMap<String, f64> {
    let mut sums: BTreeMap<String, (f64, f64)> = BTreeMap::new();
    for row in evaluation.per_scene.iter().filter(|r| r.score.method == HOLD) {
        let sum = sums.entry(row.stratum.clone()).or_default();
        *sum = (sum.0 + row.score.metrics.hdr_psnr, sum.1 + 1.0);
    }
    sums.into_iter().map(|(s, (sum, n))| (s, sum / n)).collect()
}
