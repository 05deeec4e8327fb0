//! Claims about the solvers and their verdicts.

use crate::{
    page::Section,
    ranking::{conditioning_name, digits, extra, method_name, metric_name},
    text::{escape, interval, signed},
};
use std::{collections::BTreeMap, fmt::Write as _};
use tauflow_data::{
    methods::{
        HOLD, LOCAL_STEP, Parameterization,
        axes::{CONDITIONING, PARAMETERIZATION},
    },
    records::{Bridge, Claim, ClaimVerdict, Evaluation, Evidence},
};

/// The section; none without a claim that could be judged.
pub fn section(evaluation: &Evaluation, bridge: Option<&Bridge>) -> Option<Section> {
    let claims: Vec<&Claim> =
        evaluation.claims.iter().chain(bridge.into_iter().flat_map(|bridge| &bridge.claims)).collect();
    if claims.is_empty() {
        return None;
    }
    let mut out = String::from(
        "<p>A claim consists of differences that must be above 0. A claim <b>held</b> if all 95% intervals, paired by \
         scene, are above 0. It <b>did not hold</b> if one interval is below 0, and is <b>undecided</b> \
         otherwise, even if all means agree with it.</p><div class=\"scroll\"><table class=\"wide\"><thead><tr><th \
         class=\"left\">Claim</th><th class=\"left\">Cells</th><th class=\"left\">Verdict</th><th \
         class=\"left\">Differences</th></tr></thead><tbody>",
    );
    let mut before = "";
    for claim in claims {
        let statement = if claim.statement == before { "" } else { &claim.statement };
        before = &claim.statement;
        let _ = write!(
            out,
            "<tr><td class=\"left\">{}</td><td class=\"left\">{}</td><td class=\"left\"><b>{}</b></td><td \
             class=\"left wrap\">{}</td></tr>",
            escape(statement),
            escape(&group(&claim.group)),
            verdict(claim.verdict),
            evidence(&claim.evidence)
        );
    }
    out.push_str("</tbody></table></div>");
    Some(Section::new("claims", "Claims", out))
}

/// The claims as a table of values, one row for each difference.
pub fn csv(claims: &[&Claim]) -> String {
    let mut out = String::from("claim,cells,verdict,what,metric,difference,low,high\n");
    for claim in claims {
        for Evidence { what, metric, difference } in &claim.evidence {
            let words = [&claim.statement, &group(&claim.group)].map(|text| crate::csv::field(text));
            let _ = writeln!(
                out,
                "{},{},{},{},{metric},{},{},{}",
                words[0],
                words[1],
                verdict(claim.verdict),
                crate::csv::field(what),
                difference.mean,
                difference.low,
                difference.high
            );
        }
    }
    out
}

fn verdict(verdict: ClaimVerdict) -> &'static str {
    match verdict {
        ClaimVerdict::Held => "held",
        ClaimVerdict::NotHeld => "did not hold",
        ClaimVerdict::Undecided => "undecided",
    }
}

/// Coordinates of a group in words.
fn group(cell: &BTreeMap<String, String>) -> String {
    let named = |axis: &str| cell.get(axis).cloned();
    let words = [
        named(PARAMETERIZATION).map(|m| method_name(&m)),
        named(CONDITIONING).map(|c| conditioning_name(&c)),
        Some(extra(cell)),
    ];
    words.into_iter().flatten().filter(|text| !text.is_empty()).collect::<Vec<_>>().join(", ")
}

/// A text with methods by their names.
fn named(text: &str) -> String {
    let known = Parameterization::ALL.map(Parameterization::name).into_iter().chain([LOCAL_STEP, HOLD]);
    known.fold(text.to_owned(), |text, method| text.replace(method, &method_name(method)))
}

/// Differences, those of one metric on a line.
fn evidence(of: &[Evidence]) -> String {
    let mut metrics: Vec<&str> = of.iter().map(|e| e.metric.as_str()).collect();
    metrics.sort_unstable();
    metrics.dedup();
    let line = |metric: &str| {
        let one = |e: &Evidence| {
            let places = digits(metric);
            let value = signed(e.difference.mean, places);
            format!("{} {value} <small>{}</small>", escape(&named(&e.what)), interval(&e.difference, places))
        };
        let all: Vec<String> = of.iter().filter(|e| e.metric == metric).map(one).collect();
        format!("{}: {}", escape(metric_name(metric)), all.join("; "))
    };
    metrics.into_iter().map(line).collect::<Vec<_>>().join("<br>")
}
