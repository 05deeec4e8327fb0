//! Claims about the solvers and their verdicts.

use crate::{
    page::Section,
    ranking::{conditioning_name, digits, extra, method_name, metric_name},
    svg::Scale,
    text::{compact, escape, interval, signed},
};
use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
};
use tauflow_data::{
    methods::{
        GAUSSIAN_TAU, HOLD, LOCAL_DELTA, LOCAL_STEP, Parameterization,
        axes::{CONDITIONING, PARAMETERIZATION, SPACE},
    },
    records::{Bridge, Claim, ClaimVerdict, Evaluation, Evidence},
    tabular::csv_estimate,
};

/// A claim, and whether its differences have intervals over scenes.
#[derive(Clone, Copy)]
pub struct Judged<'a> {
    pub claim: &'a Claim,
    pub has_intervals: bool,
}

/// The claims about solvers, and those between rungs.
pub fn judged<'a>(evaluation: Option<&'a Evaluation>, bridge: Option<&'a Bridge>) -> Vec<Judged<'a>> {
    let own = evaluation.map(|of| (&of.claims, of.has_intervals()));
    let between = bridge.map(|of| (&of.claims, of.has_intervals()));
    let all = own.into_iter().chain(between);
    all.flat_map(|(claims, has_intervals)| claims.iter().map(move |claim| Judged { claim, has_intervals })).collect()
}

/// The section; none without a claim that could be judged.
pub fn section(evaluation: &Evaluation, bridge: Option<&Bridge>) -> Option<Section> {
    let claims = judged(Some(evaluation), bridge);
    if claims.is_empty() {
        return None;
    }
    let mut out = String::from(
        "<p>A claim consists of differences that must be above 0. A claim <b>held</b> if all 95% intervals, paired by \
         scene and, with several draws of the trainings, over draws, are above 0. It <b>did not hold</b> if all \
         intervals of one difference are below 0, and is <b>undecided</b> otherwise, even if all means agree with it. \
         Dots are means, bars are intervals over scenes, and the dashed line is 0; each metric has one scale.</p>",
    );
    if claims.iter().any(|of| !of.has_intervals) {
        out.push_str(
            "<p class=\"note\">Differences of a single scene, or of a single group of scenes of one content, have no \
             intervals over scenes. Their claims are undecided.</p>",
        );
    }
    let mut statements: Vec<&str> = Vec::new();
    for Judged { claim, .. } in &claims {
        if !statements.contains(&claim.statement.as_str()) {
            statements.push(&claim.statement);
        }
    }
    for statement in statements {
        let own: Vec<Judged<'_>> = claims.iter().copied().filter(|of| of.claim.statement == statement).collect();
        let _ = write!(out, "<h3>{}</h3><div class=\"chips\">{}</div>", escape(statement), chips(&own));
        for metric in metrics(&own) {
            out += &forest(&own, metric, axis(&claims, metric));
        }
    }
    Some(Section { class: "claims", ..Section::new("claims", "Claims", out) })
}

/// The verdict of each group of cells.
fn chips(claims: &[Judged<'_>]) -> String {
    let chip = |Judged { claim, .. }: &Judged<'_>| {
        let class = match claim.verdict {
            ClaimVerdict::Held => "held",
            ClaimVerdict::NotHeld => "failed",
            ClaimVerdict::Undecided => "open",
        };
        let group = group(&claim.group);
        let group = if group.is_empty() { group } else { format!("{}: ", escape(&group)) };
        format!("<span class=\"chip {class}\">{group}<b>{}</b></span>", verdict(claim.verdict))
    };
    claims.iter().map(chip).collect()
}

/// The metrics of some claims, in order of names.
fn metrics<'a>(claims: &[Judged<'a>]) -> BTreeSet<&'a str> {
    claims.iter().flat_map(|of| &of.claim.evidence).map(|evidence| evidence.metric.as_str()).collect()
}

/// The scale of a metric's differences, which all claims share. It holds 0.
fn axis(claims: &[Judged<'_>], metric: &str) -> Scale {
    let own = claims.iter().flat_map(|of| &of.claim.evidence).filter(|evidence| evidence.metric == metric);
    Scale::linear(own.flat_map(|of| [of.difference.low, of.difference.high, of.difference.mean]).chain([0.0]))
}

/// The intervals of one metric, one below the other.
fn forest(claims: &[Judged<'_>], metric: &str, scale: Scale) -> String {
    let places = digits(metric);
    let percent = |value: f64| 100.0 * scale.place(value).unwrap_or(0.0);
    let zero = format!("<i class=\"zero\" style=\"left:{:.1}%\"></i>", percent(0.0));
    let mut out = format!(
        "<div class=\"forest\"><div class=\"name head\">{}</div><div class=\"value head\">Difference</div>\
         <div class=\"span head\"></div>",
        escape(metric_name(metric))
    );
    for Judged { claim, has_intervals } in claims {
        for evidence in claim.evidence.iter().filter(|evidence| evidence.metric == metric) {
            let Evidence { what, difference, draws, .. } = evidence;
            let group = group(&claim.group);
            let name = if group.is_empty() { named(what) } else { format!("{group}: {}", named(what)) };
            let over = draws.map_or_else(String::new, |of| format!(" draws {}", interval(&of, places)));
            let side = match has_intervals {
                true if evidence.is_above() => "above",
                true if evidence.is_below() => "below",
                _ => "around",
            };
            let [low, mean, high] = [difference.low, difference.mean, difference.high].map(percent);
            let (small, range) = match has_intervals {
                true => (
                    interval(difference, places),
                    format!("<i class=\"range {side}\" style=\"left:{low:.1}%;width:{:.1}%\"></i>", high - low),
                ),
                false => (String::new(), String::new()),
            };
            let _ = write!(
                out,
                "<div class=\"name\">{}</div><div class=\"value\">{} <small>{small}{over}</small></div><div \
                 class=\"span\">{zero}{range}<i class=\"mean {side}\" style=\"left:{mean:.1}%\"></i></div>",
                escape(&name),
                signed(difference.mean, places)
            );
        }
    }
    let tick = |value: f64| format!("<b style=\"left:{:.1}%\">{}</b>", percent(value), compact(value));
    let ticks: String = scale.ticks(4).into_iter().map(tick).collect();
    let _ = write!(out, "<div class=\"span scale\">{ticks}</div></div>");
    out
}

/// The claims as a table of values, one row for each difference. Where there is no interval, its ends are empty.
pub fn csv(claims: &[Judged<'_>]) -> String {
    let mut out = String::from("claim,cells,verdict,what,metric,difference,low,high,draws_low,draws_high\n");
    for Judged { claim, has_intervals } in claims {
        for Evidence { what, metric, difference, draws } in &claim.evidence {
            let words = [&claim.statement, &group(&claim.group)].map(|text| crate::csv::field(text));
            let _ = writeln!(
                out,
                "{},{},{},{},{metric},{},{}",
                words[0],
                words[1],
                verdict(claim.verdict),
                crate::csv::field(what),
                csv_estimate(Some(difference), *has_intervals),
                draws.map_or_else(|| ",".to_owned(), |of| format!("{},{}", of.low, of.high))
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
        named(SPACE).map(|space| format!("space {space}")),
        Some(extra(cell).replace("moved_in", "moved in")),
    ];
    words.into_iter().flatten().filter(|text| !text.is_empty()).collect::<Vec<_>>().join(", ")
}

/// A text with methods by their names.
fn named(text: &str) -> String {
    let known = Parameterization::ALL.map(Parameterization::name).into_iter().chain([
        LOCAL_STEP,
        LOCAL_DELTA,
        GAUSSIAN_TAU,
        HOLD,
    ]);
    known.fold(text.to_owned(), |text, method| text.replace(method, &method_name(method)))
}
