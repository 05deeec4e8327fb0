//! Solvers against methods that are not ours, scene by scene.

use crate::{
    page::Section,
    ranking::{conditioning_name, digits, extra, method_name, metric_name},
    sections::method_html,
    text::{escape, fixed, interval, signed},
};
use std::fmt::Write as _;
use tauflow_data::{
    methods::axes::{CONDITIONING, PARAMETERIZATION},
    records::{Evaluation, METRICS, Versus, higher_is_better},
};

/// The section; none without baselines, and without a note on one that is missing.
pub fn section(evaluation: &Evaluation) -> Option<Section> {
    if evaluation.versus.is_empty() && evaluation.notes.is_empty() {
        return None;
    }
    let mut out = String::new();
    for note in &evaluation.notes {
        let _ = write!(out, "<p class=\"note\">Omitted: {}.</p>", escape(note));
    }
    if evaluation.versus.is_empty() {
        return Some(Section::new("baselines", "Compared with baselines", out));
    }
    let metrics = METRICS.iter().filter(|m| ["hdr_psnr", "preview_psnr", "ssim", "hdr_mae"].contains(*m));
    let metrics: Vec<&str> = metrics.copied().collect();
    let _ = write!(
        out,
        "<p>The solver's score minus the baseline's, paired by scene, with 95% intervals over {} scenes and the share \
         of scenes where the solver is better. <b>Bold</b> if the whole interval favours the solver. Both start from \
         {} spp and read the same radiance, albedo and normals.</p><div class=\"scroll\"><table \
         class=\"wide\"><thead><tr><th>Baseline</th><th class=\"left\">Solver</th><th>NFE</th>",
        evaluation.scenes, evaluation.from_spp
    );
    for metric in &metrics {
        let _ = write!(out, "<th>{}</th>", metric_name(metric));
    }
    out.push_str("</tr></thead><tbody>");
    for versus in &evaluation.versus {
        out.push_str(&row(versus, &metrics));
    }
    out.push_str("</tbody></table></div>");
    Some(Section::new("baselines", "Compared with baselines", out))
}

fn row(versus: &Versus, metrics: &[&str]) -> String {
    let get = |axis: &str| versus.cell.get(axis).cloned().unwrap_or_default();
    let theirs = versus.baseline.get(CONDITIONING).map_or_else(String::new, |c| format!(", {}", conditioning_name(c)));
    let more = extra(&versus.cell);
    let solver = [method_name(&get(PARAMETERIZATION)), conditioning_name(&get(CONDITIONING)), more];
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
        let sure = if higher_is_better(metric) { gain.low > 0.0 } else { gain.high < 0.0 };
        let value = signed(gain.mean, digits(metric));
        let value = if sure { format!("<b>{value}</b>") } else { value };
        let share = versus.better.get(*metric).copied().unwrap_or(0.0);
        let _ = write!(
            out,
            "<td>{value} <small>{}; {}%</small></td>",
            interval(gain, digits(metric)),
            fixed(100.0 * share, 0)
        );
    }
    out + "</tr>"
}
