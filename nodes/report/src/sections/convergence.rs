//! Convergence of the ladders: error against samples, with the law that variance time rests on.

use crate::{
    page::Section,
    svg::{Plot, Scale},
    text::{compact, count, escape, fixed},
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
    let last = convergence.reference_spp;
    let mut out = format!(
        "<p>Variance time rests on the error of I<sub>n</sub> falling as 1/√n. Dots: RMSE against I<sub>{last}</sub>, geometric mean over \
         scenes. Dashed: the law from the samples' own variance, √(σ²(1/n − 1/{last})), which bends down at the end because \
         I<sub>{last}</sub> shares its samples with every rung. Slopes are corrected for that; the law says −0.5. Both axes are \
         logarithmic.</p>"
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
        fixed(row.slope, 2),
        if row.heavy_tail { ", heavy tail" } else { "" }
    ));
    plot.y_axis(4).x_axis_round(5, "n, samples a pixel");
    plot.line(points(&row.law), "hold dashed").dots(points(&row.rmse), 3.6, class);
    let (first, last) = (row.rmse.first().copied().unwrap_or(0.0), row.rmse.last().copied().unwrap_or(0.0));
    plot.finish(&format!("RMSE by samples in {}, from {} to {}", name(row), compact(first), compact(last)))
}

fn table(convergence: &Convergence, rows: &[&ConvergenceRow]) -> String {
    let mut out = String::from(
        "<details open><summary>Slopes and tails</summary><div class=\"scroll\"><table class=\"wide\"><thead><tr><th>Stratum</th><th>Scenes</th>\
         <th>Slope</th><th>RMSE, first rung</th><th>Law, first rung</th><th>Variance in the top 1% of pixels</th><th>Mean path length</th>\
         <th>Rejected samples</th></tr></thead><tbody>",
    );
    let last = [&convergence.overall];
    for (row, total) in rows.iter().map(|r| (*r, false)).chain(last.map(|r| (r, true))) {
        let (class, title) = if total { (" class=\"total\"", "All".to_owned()) } else { ("", name(row)) };
        let at = |values: &[f64]| values.first().map_or_else(|| "–".into(), |v| compact(*v));
        let _ = write!(
            out,
            "<tr{class}><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}%{}</td><td>{}</td><td>{}</td></tr>",
            escape(&title),
            count(row.scenes),
            fixed(row.slope, 3),
            at(&row.rmse),
            at(&row.law),
            fixed(row.tail_share * 100.0, 0),
            if row.heavy_tail { ", heavy" } else { "" },
            fixed(row.mean_path_length, 2),
            count(row.rejected)
        );
    }
    out + "</tbody></table></div></details>"
}
