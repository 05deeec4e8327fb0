//! Moments of the ladders beside the law's, and beside those of the Monte Carlo SDE.

use super::name;
use crate::text::{count, escape, fixed};
use std::fmt::Write as _;
use tauflow_data::records::{AgainstLaw, Agreement, Beside, Convergence, ConvergenceRow, DIFFERS, SdeRow, TOLERANCE};

fn verdicts() -> String {
    format!(
        "A value <i>agrees</i> if it deviates by at most {}%, including two standard errors. It <i>differs</i> if it \
         deviates by more than {} standard errors, and is <i>undecided</i> otherwise.",
        fixed(100.0 * TOLERANCE, 0),
        fixed(DIFFERS, 0)
    )
}

fn plus_minus(value: f64, error: f64) -> String {
    format!("{} ± {}", fixed(value, 2), fixed(error, 2))
}

/// Standard errors and verdict; what differs stands out.
fn finding(z: f64, verdict: Agreement) -> String {
    let word = if verdict == Agreement::Differs { format!("<b>{}</b>", verdict.name()) } else { verdict.name().into() };
    format!("<span class=\"ci\">z {}, {word}</span>", fixed(z, 1))
}

/// Covariances of all rungs over what the law says: of all scenes in full, of strata as counts of verdicts.
pub fn covariances(convergence: &Convergence, strata: &[&ConvergenceRow]) -> String {
    if convergence.overall.covariance.is_empty() {
        return String::new();
    }
    let mut out = format!(
        "<details><summary>Variances and covariances of rungs</summary><p class=\"note\">Cov(I<sub>n</sub>, \
         I<sub>m</sub>) over σ²/max(n, m), with its standard error, and its deviation from 1, the value of the law, \
         in standard errors (z). The diagonal contains variances. Each pixel is normalised by its own standard \
         deviation, and scenes are weighted by the precision that their kurtosis permits. {}</p><div \
         class=\"scroll\"><table class=\"wide\"><thead><tr><th>m \\ n</th>",
        verdicts()
    );
    for n in &convergence.counts {
        let _ = write!(out, "<th>{}</th>", count(*n));
    }
    out.push_str("</tr></thead><tbody>");
    for (m, row) in convergence.counts.iter().zip(&convergence.overall.covariance) {
        let cell =
            |of: &AgainstLaw| format!("<td>{}{}</td>", plus_minus(of.value, of.error), finding(of.z, of.verdict));
        let cells: String = row.iter().map(cell).collect();
        let _ = write!(out, "<tr><td>{}</td>{cells}</tr>", count(*m));
    }
    out.push_str(
        "</tbody></table></div><div class=\"scroll\"><table><thead><tr><th>Stratum</th><th>Means, variances and \
         covariances that agree</th><th>Undecided</th><th>Differ</th><th>Largest |z|</th></tr></thead><tbody>",
    );
    for row in strata.iter().filter(|row| !row.covariance.is_empty()).copied().chain([&convergence.overall]) {
        let all = || row.mean.iter().chain(row.covariance.iter().flatten());
        let of = |verdict: Agreement| count(all().filter(|of| of.verdict == verdict).count() as u64);
        let (class, title) =
            if row.stratum == "all" { (" class=\"total\"", "All".to_owned()) } else { ("", name(row)) };
        let _ = write!(
            out,
            "<tr{class}><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escape(&title),
            of(Agreement::Agrees),
            of(Agreement::Undecided),
            of(Agreement::Differs),
            fixed(all().map(|of| of.z.abs()).fold(0.0, f64::max), 1)
        );
    }
    out + "</tbody></table></div></details>"
}

/// The SDE beside the ladders.
pub fn sde(convergence: &Convergence) -> String {
    if convergence.sde.is_empty() {
        return String::new();
    }
    let mut out = format!(
        "<details><summary>The Monte Carlo SDE compared with the ladders</summary><p class=\"note\">Simulated with \
         time s = 1 − 1/√n, in units of each pixel's σ. The law predicts means of 0, variances of σ²/n, and \
         covariances of two rungs of σ² divided by the larger sample count. Small print (z): difference between \
         ladders and SDE in standard errors. {}</p><div class=\"scroll\"><table \
         class=\"wide\"><thead><tr><th>n</th><th>Mean √n/σ, SDE</th><th>ladders</th><th>Variance n/σ², \
         SDE</th><th>ladders</th><th>Covariance with the previous rung, SDE</th><th>ladders</th><th>Covariance with \
         the first rung, SDE</th><th>ladders</th><th>All previous rungs</th></tr></thead><tbody>",
        verdicts()
    );
    for row in &convergence.sde {
        let cell = |of: Option<&Beside>| {
            of.map_or_else(
                || "<td>–</td><td>–</td>".into(),
                |of| {
                    let (sde, ladders) = (plus_minus(of.sde, of.sde_error), plus_minus(of.ladders, of.ladders_error));
                    format!("<td>{sde}</td><td>{ladders}{}</td>", finding(of.z, of.verdict))
                },
            )
        };
        let cells: String =
            [Some(&row.mean), Some(&row.variance), row.covariance.last(), row.covariance.first()].map(cell).concat();
        let _ = write!(out, "<tr><td>{}</td>{cells}<td>{}</td></tr>", count(row.n), earlier(row));
    }
    out + "</tbody></table></div></details>"
}

/// How many of the covariances with rungs before agree.
fn earlier(row: &SdeRow) -> String {
    let of = |verdict: Agreement| row.covariance.iter().filter(|of| of.verdict == verdict).count();
    let words =
        [Agreement::Agrees, Agreement::Undecided, Agreement::Differs].map(|verdict| (of(verdict), verdict.name()));
    let found: Vec<String> = words.into_iter().filter(|(n, _)| *n > 0).map(|(n, word)| format!("{n} {word}")).collect();
    if found.is_empty() { "–".into() } else { found.join(", ") }
}
