//! Solvers against methods that are not ours, scene by scene.

use crate::{
    material::Cell,
    page::Section,
    ranking::{colour, conditioning_name, digits, extra, method_name, metric_name, names_of},
    sections::{method_html, no_intervals, resampled},
    svg::{Plot, Scale},
    text::{compact, escape, fixed, interval, signed},
};
use std::{collections::BTreeMap, fmt::Write as _};
use tauflow_data::{
    methods::axes::CONDITIONING,
    records::{Estimate, Evaluation, METRICS, Versus, higher_is_better},
};

/// The section; none without baselines.
pub fn section(evaluation: &Evaluation) -> Option<Section> {
    if evaluation.versus.is_empty() {
        return None;
    }
    let mut out = String::new();
    let shown = |m: &&str| !["hdr_psnr_max", "preview_mae"].contains(m) && evaluation.hold.contains_key(*m);
    let metrics: Vec<&str> = METRICS.into_iter().filter(shown).collect();
    let share = "the share of scenes where the solver is better.";
    let over = evaluation.groups.map_or_else(|| format!("{} scenes", evaluation.scenes), |of| resampled(Some(of)));
    let intervals = match evaluation.has_intervals() {
        true => {
            format!("95% intervals over {over} and {share} <b>Bold</b> if the whole interval favours the solver.")
        }
        false => format!("{share} {}", no_intervals("scene", evaluation.groups)),
    };
    let _ = write!(
        out,
        "<p>The solver's score minus the baseline's, paired by scene, with {intervals} Both start from {} spp. Methods \
         with RGB see radiance alone, those with G-buffers see albedo and normals, too.</p>{}<div \
         class=\"scroll\"><table class=\"wide\"><thead><tr><th>Baseline</th><th class=\"left\">Solver</th><th>NFE</th>",
        evaluation.from_spp,
        charts(evaluation)
    );
    for metric in &metrics {
        let _ = write!(out, "<th>{}</th>", metric_name(metric));
    }
    out.push_str("</tr></thead><tbody>");
    for versus in &evaluation.versus {
        out.push_str(&row(evaluation, versus, &metrics));
    }
    out.push_str("</tbody></table></div>");
    Some(Section::new("baselines", "Compared with baselines", out))
}

/// Differences by number of calls: of each solver, by its method and cell.
type Lines<'a> = BTreeMap<(&'a str, &'a Cell), Vec<(f64, Estimate)>>;

/// The paired difference to each baseline over the number of calls, a line for each solver; nothing for one number of
/// calls.
fn charts(evaluation: &Evaluation) -> String {
    const METRIC: &str = "hdr_psnr";
    let mut lines: BTreeMap<(&str, String, String), Lines<'_>> = BTreeMap::new();
    for versus in &evaluation.versus {
        let Some(gain) = versus.gain.get(METRIC) else { continue };
        let [method, conditioning] = names_of(evaluation, &versus.cell);
        let panel = [conditioning_name(conditioning), extra(&versus.cell)];
        let panel = panel.into_iter().filter(|text| !text.is_empty()).collect::<Vec<_>>().join(", ");
        let theirs = versus.baseline.get(CONDITIONING).map_or_else(String::new, |c| conditioning_name(c));
        let panels = lines.entry((versus.method.as_str(), theirs, panel)).or_default();
        panels.entry((method, &versus.cell)).or_default().push((versus.nfe as f64, *gain));
    }
    let calls = |of: &Lines<'_>| of.values().map(Vec::len).max().unwrap_or(0);
    lines.retain(|_, of| calls(of) > 1);
    if lines.is_empty() {
        return String::new();
    }
    let all = lines.values().flat_map(BTreeMap::values).flatten();
    let y = Scale::linear(all.flat_map(|(_, gain)| [gain.mean, gain.low, gain.high]).chain([0.0]));
    let mut out = String::from(r#"<div class="grid2 charts">"#);
    for ((method, theirs, panel), of) in &lines {
        let mut calls: Vec<f64> = of.values().flatten().map(|(nfe, _)| *nfe).collect();
        calls.sort_by(f64::total_cmp);
        calls.dedup();
        let (class, baseline) = (colour(method), method_name(method));
        let theirs = if theirs.is_empty() { theirs.clone() } else { format!(" ({theirs})") };
        let mut plot = Plot::new([560.0, 310.0], [52.0, 108.0, 34.0, 40.0], Scale::log(calls.iter().copied(), 0.03), y);
        plot.title(&format!("{}, {panel} minus {baseline}{theirs}", metric_name(METRIC))).y_axis(6);
        plot.x_axis(calls.iter().map(|nfe| (*nfe, compact(*nfe))), "NFE (log)");
        plot.level(0.0, &format!("{class} dashed")).end_label(0.0, &class, &baseline);
        for ((method, _), points) in of {
            plot.estimates(points, evaluation.has_intervals(), &colour(method), &method_name(method));
        }
        let description = format!("Paired difference to {baseline}{theirs} against NFE, {panel}");
        let _ = write!(out, "<figure>{}</figure>", plot.finish(&description));
    }
    out + "</div>"
}

fn row(evaluation: &Evaluation, versus: &Versus, metrics: &[&str]) -> String {
    let [method, conditioning] = names_of(evaluation, &versus.cell);
    let theirs = versus.baseline.get(CONDITIONING).map_or_else(String::new, |c| format!(", {}", conditioning_name(c)));
    let more = extra(&versus.cell);
    let solver = [method_name(method), conditioning_name(conditioning), more];
    let solver: Vec<String> = solver.into_iter().filter(|t| !t.is_empty()).collect();
    let mut out = format!(
        "<tr><td>{}{}</td><td class=\"left\">{}</td><td>{}</td>",
        method_html(&versus.method),
        escape(&theirs),
        escape(&solver.join(", ")),
        versus.nfe
    );
    for metric in metrics {
        let Some(gain) = versus.gain.get(*metric) else {
            out.push_str("<td>–</td>");
            continue;
        };
        let favours = if higher_is_better(metric) { gain.low > 0.0 } else { gain.high < 0.0 };
        let value = signed(gain.mean, digits(metric));
        let share = fixed(100.0 * versus.better.get(*metric).copied().unwrap_or(0.0), 0);
        let (value, small) = match evaluation.has_intervals() {
            true if favours => (format!("<b>{value}</b>"), format!("{}; {share}%", interval(gain, digits(metric)))),
            true => (value, format!("{}; {share}%", interval(gain, digits(metric)))),
            false => (value, format!("{share}%")),
        };
        let _ = write!(out, "<td>{value}<span class=\"ci\">{small}</span></td>");
    }
    out + "</tr>"
}
