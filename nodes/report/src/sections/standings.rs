//! All methods in one table, ours or not, the best first.

use crate::{
    page::Section,
    ranking::{conditioning_name, digits, extra, metric_name, standings},
    sections::{method_html, no_intervals, resampled},
    text::{escape, fixed, interval, signed},
};
use std::fmt::Write as _;
use tauflow_data::{
    methods::HOLD,
    records::{BASIC, Estimate, Evaluation, METRICS},
};

/// Metrics that follow the one that ranks: these two, and those that were computed on request.
fn more(evaluation: &Evaluation) -> Vec<&'static str> {
    let requested = METRICS.into_iter().filter(|m| !BASIC.contains(m) && evaluation.hold.contains_key(*m));
    ["preview_psnr", "ssim"].into_iter().chain(requested).collect()
}

/// The section: solvers at this number of calls, baselines, and the input itself. None without scores.
pub fn section(evaluation: &Evaluation, nfe: u64) -> Option<Section> {
    let all = standings(evaluation, nfe);
    if all.len() < 2 {
        return None;
    }
    let compared = match (evaluation.methods.is_empty(), evaluation.baselines.is_empty()) {
        (true, _) => "Methods".to_owned(),
        (_, true) => format!("Solvers at NFE {nfe}"),
        _ => format!("Solvers at NFE {nfe}, baselines"),
    };
    let intervals = match evaluation.has_intervals() {
        true => format!("Small print: 95% bootstrap intervals over {}.", resampled(evaluation.groups)),
        false => no_intervals("scene", evaluation.groups),
    };
    let mut out = format!(
        "<p>{compared} and the input itself, by mean HDR PSNR over {} test scenes, from {} spp. {intervals}</p><div \
         class=\"scroll\"><table class=\"wide\"><thead><tr><th></th><th class=\"left\">Method</th><th \
         class=\"left\">Reads</th><th>{}</th><th>Gain</th>",
        evaluation.scenes,
        evaluation.from_spp,
        metric_name("hdr_psnr")
    );
    let more = more(evaluation);
    for metric in &more {
        let _ = write!(out, "<th>{}</th>", metric_name(metric));
    }
    out.push_str("</tr></thead><tbody>");
    for (place, of) in all.iter().enumerate() {
        let (name, reads) = match of.table {
            Some(table) => {
                let more = extra(&table.cell);
                let more = if more.is_empty() { more } else { format!(", {}", escape(&more)) };
                (method_html(&table.method), escape(&conditioning_name(&table.conditioning)) + &more)
            }
            None => (method_html(HOLD), "the input itself".to_owned()),
        };
        // On a narrow page, what a method reads is shown below its name.
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=\"left\" data-reads=\"{reads}\">{name}</td><td class=\"left\">{reads}</td>",
            place + 1
        );
        let cell = |value: Option<String>, range: Option<String>| match value {
            Some(value) => format!("<td>{value}<span class=\"ci\">{}</span></td>", range.unwrap_or_default()),
            None => "<td><span class=\"zero\">–</span></td>".to_owned(),
        };
        let range = |of: &Estimate| evaluation.has_intervals().then(|| interval(of, 2));
        let psnr = of.metrics.get("hdr_psnr");
        out += &cell(psnr.map(|psnr| fixed(psnr.mean, 2)), psnr.and_then(range));
        let gain = of.gain.and_then(|gain| gain.get("hdr_psnr"));
        out += &cell(gain.map(|gain| signed(gain.mean, 2)), gain.and_then(range));
        for metric in &more {
            out += &cell(of.metrics.get(*metric).map(|value| fixed(value.mean, digits(metric))), None);
        }
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table></div>");
    for note in &evaluation.notes {
        let _ = write!(out, "<p class=\"note\">Omitted: {}.</p>", escape(note));
    }
    Some(Section::new("ranking", "All methods", out))
}
