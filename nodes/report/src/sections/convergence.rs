//! Convergence of the ladders: error against samples, with the law that variance time rests on.

use crate::{
    page::Section,
    svg::{Plot, Scale},
    text::{compact, count, escape, fixed, interval},
};
use std::fmt::Write as _;
use tauflow_data::{
    Stratum,
    convergence::{Convergence, ConvergenceRow},
};

/// The section; none without rungs.
pub fn section(convergence: &Convergence) -> Option<Section> {
    if convergence.counts.is_empty() {
        return None;
    }
    let mut out = format!(
        "<p>Variance time rests on the error of I<sub>n</sub> falling as 1/√n. Dots: RMSE against references of {} samples a pixel that share \
         none with the ladders, their own noise taken off; geometric mean over scenes. Dashed: the law from the samples' own variance, \
         √(σ²/n). Slopes are means over scenes; the law says −0.5. Both axes are logarithmic.</p>",
        count(convergence.reference_spp)
    );
    let rows = ordered(convergence);
    let all = rows.iter().flat_map(|r| r.rmse.iter().chain(&r.law)).copied();
    let y = Scale::log(all, 0.05);
    out.push_str("<div class=\"grid4\">");
    for row in &rows {
        let _ = write!(out, "<figure>{}</figure>", panel(convergence, row, y));
    }
    let _ = write!(out, "</div>{}", table(convergence, &rows));
    Some(Section::new("convergence", "Ladder convergence", out))
}

/// Strata context by context, so that a row of panels goes from L0 to L3.
fn ordered(convergence: &Convergence) -> Vec<&ConvergenceRow> {
    let mut rows: Vec<&ConvergenceRow> = convergence.strata.iter().collect();
    rows.sort_by_cached_key(|r| match r.stratum.parse::<Stratum>() {
        Ok(stratum) => (Some(stratum.context), Some(stratum.regime), r.stratum.clone()),
        Err(_) => (None, None, r.stratum.clone()),
    });
    rows
}

fn name(row: &ConvergenceRow) -> String {
    row.stratum.replacen('-', " ", 1)
}

fn panel(convergence: &Convergence, row: &ConvergenceRow, y: Scale) -> String {
    let x = Scale::log(convergence.counts.iter().map(|n| *n as f64), 0.03);
    let mut plot = Plot::new([290.0, 222.0], [46.0, 10.0, 50.0, 42.0], x, y);
    let points = |values: &[f64]| -> Vec<(f64, f64)> {
        convergence.counts.iter().map(|n| *n as f64).zip(values.iter().copied()).collect()
    };
    let class = if row.heavy_tail { "m3" } else { "m2" };
    plot.title(&name(row)).subtitle(&format!(
        "slope {}{}",
        fixed(row.slope.mean, 2),
        if row.heavy_tail { ", heavy tail" } else { "" }
    ));
    plot.y_axis(4).x_axis_round(5, "n, samples a pixel");
    plot.line(points(&row.law), "hold dashed").dots(points(&row.rmse), 3.6, class);
    let (first, last) = (row.rmse.first().copied().unwrap_or(0.0), row.rmse.last().copied().unwrap_or(0.0));
    plot.finish(&format!("RMSE by samples in {}, from {} to {}", name(row), compact(first), compact(last)))
}

fn table(convergence: &Convergence, rows: &[&ConvergenceRow]) -> String {
    let mut out = String::from(
        "<details open><summary>Slopes and tails</summary><p class=\"note\">Kurtosis and tail index are of single samples in units of their pixels' \
         deviations, medians over scenes; that of a mean of n samples is 1/n of it. From the rung in the column “near normal from” on it is at most 1: \
         below, the law holds for the expectation, but one pixel of one ladder may be far off it.</p><div class=\"scroll\"><table \
         class=\"wide\"><thead><tr><th>Stratum</th><th>Scenes</th><th>Slope</th><th>RMSE, first rung</th><th>Law, first rung</th><th>Excess \
         kurtosis</th><th>Tail index</th><th>Near normal from</th><th>Variance in the top 1% of pixels</th><th>Mean path length</th><th>Rejected \
         samples</th></tr></thead><tbody>",
    );
    let last = [&convergence.overall];
    for (row, total) in rows.iter().map(|r| (*r, false)).chain(last.map(|r| (r, true))) {
        let (class, title) = if total { (" class=\"total\"", "All".to_owned()) } else { ("", name(row)) };
        let at = |values: &[f64]| values.first().map_or_else(|| "–".into(), |v| compact(*v));
        let optional = |v: Option<f64>| v.map_or_else(|| "–".into(), compact);
        let _ = write!(
            out,
            "<tr{class}><td>{}</td><td>{}</td><td>{} <small>{}</small></td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}%{}</td><td>{}</td><td>{}</td></tr>",
            escape(&title),
            count(row.scenes),
            fixed(row.slope.mean, 3),
            interval(&row.slope, 3),
            at(&row.rmse),
            at(&row.law),
            optional(row.excess_kurtosis),
            optional(row.tail_index),
            row.trusted_from.map_or_else(|| "–".into(), count),
            fixed(row.tail_share * 100.0, 0),
            if row.heavy_tail { ", heavy" } else { "" },
            fixed(row.mean_path_length, 2),
            count(row.rejected)
        );
    }
    out + "</tbody></table></div></details>" + &covariances(convergence) + &sde(convergence)
}

/// Covariances of all rungs over what the law says.
fn covariances(convergence: &Convergence) -> String {
    let mut out = String::from(
        "<details><summary>Covariances of rungs</summary><p class=\"note\">Cov(I<sub>n</sub>, I<sub>m</sub>) over σ²/max(n, m), mean over all \
         scenes; 1 by the law. On the diagonal stand variances.</p><div class=\"scroll\"><table class=\"wide\"><thead><tr><th>m \\ n</th>",
    );
    for n in &convergence.counts {
        let _ = write!(out, "<th>{}</th>", count(*n));
    }
    out.push_str("</tr></thead><tbody>");
    for (m, row) in convergence.counts.iter().zip(&convergence.overall.covariance) {
        let cells: String = row.iter().map(|v| format!("<td>{}</td>", fixed(*v, 3))).collect();
        let _ = write!(out, "<tr><td>{}</td>{cells}</tr>", count(*m));
    }
    out + "</tbody></table></div></details>"
}

/// The SDE beside the ladders.
fn sde(convergence: &Convergence) -> String {
    let mut out = String::from(
        "<details><summary>The Monte Carlo SDE beside the ladders</summary><p class=\"note\">Simulated pixel by pixel on its clock s = 1 − 1/√n; pixels \
         are pooled over their variances. By the law means are 0, variances times n are 1, and so are covariances with the first rung \
         times n.</p><div class=\"scroll\"><table class=\"wide\"><thead><tr><th>n</th><th>Mean √n, SDE</th><th>ladders</th><th>Variance n, \
         SDE</th><th>ladders</th><th>Covariance n, SDE</th><th>ladders</th></tr></thead><tbody>",
    );
    for row in &convergence.sde {
        let values =
            [row.sde_mean, row.real_mean, row.sde_variance, row.real_variance, row.sde_covariance, row.real_covariance];
        let cells: String = values.iter().map(|v| format!("<td>{}</td>", fixed(*v, 3))).collect();
        let _ = write!(out, "<tr><td>{}</td>{cells}</tr>", count(row.n));
    }
    out + "</tbody></table></div></details>"
}
