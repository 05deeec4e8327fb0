//! Convergence of the ladders: error against samples, with the law that variance time rests on.

mod moments;
mod scenes;

pub use scenes::csv;

use crate::{
    page::Section,
    svg::{Plot, Scale},
    text::{compact, count, escape, fixed, interval, plural},
};
use std::fmt::Write as _;
use tauflow_data::{
    Stratum, StratumName,
    records::{Convergence, ConvergenceRow, Estimate, HEAVY_INDEX, HEAVY_KURTOSIS, HEAVY_SHARE, OFF_NORMAL},
};

/// The section; none without rungs.
pub fn section(convergence: &Convergence) -> Option<Section> {
    if convergence.counts.is_empty() {
        return None;
    }
    let begin = if convergence.sampler.is_independent() {
        "Variance time assumes that the error of I<sub>n</sub> falls as 1/√n."
    } else {
        "The samples of these ladders are correlated, so variance time at 1/√n does not hold, and moments and trust \
         are omitted. The law is the error of as many independent samples. <code>clock: fitted</code> of \
         <code>training</code> uses minus the median slope of the scenes."
    };
    let mut out = format!(
        "<p>{begin} Dots: RMSE against independent references of {} samples per pixel, with the noise of the reference \
         subtracted; geometric mean over scenes. Dashed: the law √(σ²/n), with the measured variance σ² of single \
         samples. Slopes are means over scenes; the law predicts −0.5. Scenes without noise are omitted. Both axes are \
         logarithmic.</p>",
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
        Ok(stratum) => (false, Some((stratum.context, stratum.regime)), String::new()),
        Err(_) => (true, None, r.stratum.clone()),
    });
    rows
}

fn name(row: &ConvergenceRow) -> String {
    StratumName::label(&row.stratum)
}

fn panel(convergence: &Convergence, row: &ConvergenceRow, y: Scale) -> String {
    let x = Scale::log(convergence.counts.iter().map(|n| *n as f64), 0.03);
    let mut plot = Plot::new([290.0, 222.0], [46.0, 10.0, 50.0, 42.0], x, y);
    let points = |values: &[f64]| -> Vec<(f64, f64)> {
        convergence.counts.iter().map(|n| *n as f64).zip(values.iter().copied()).collect()
    };
    let class = if row.heavy_tail { "neg" } else { "ink" };
    plot.title(&name(row)).subtitle(&format!(
        "slope {}{}",
        row.slope.map_or_else(|| "–".into(), |slope| fixed(slope.mean, 2)),
        if row.heavy_tail { ", heavy tail" } else { "" }
    ));
    plot.y_axis(4).x_axis_round(5, "n, samples per pixel");
    plot.line(points(&row.law), "hold dashed").dots(points(&row.rmse), 3.6, class);
    let range = match (row.rmse.first(), row.rmse.last()) {
        (Some(first), Some(last)) => format!("from {} to {}", error(*first), error(*last)),
        _ => "no noise".into(),
    };
    plot.finish(&format!("RMSE by samples in {}, {range}", name(row)))
}

/// An error; a dash for 0, where none was left of what the reference's own noise is taken off.
fn error(value: f64) -> String {
    if value > 0.0 { compact(value) } else { "–".into() }
}

/// A slope with its interval, and how many rungs it is without.
fn slope(of: Option<&Estimate>, unresolved: u64) -> String {
    let slope = of
        .map_or_else(|| "–".into(), |of| format!("{}<span class=\"ci\">{}</span>", fixed(of.mean, 3), interval(of, 3)));
    if unresolved == 0 {
        return slope;
    }
    format!(
        "{slope}<span class=\"ci words\">excludes {} below the reference's noise</span>",
        plural(unresolved, "rung")
    )
}

/// Whether the law's slope is in the interval.
fn holds(slope: Option<&Estimate>) -> &'static str {
    match slope {
        Some(slope) if slope.low <= -0.5 && -0.5 <= slope.high => "yes",
        Some(_) => "no",
        None => "–",
    }
}

fn optional(value: Option<f64>) -> String {
    value.map_or_else(|| "–".into(), compact)
}

fn table(convergence: &Convergence, rows: &[&ConvergenceRow]) -> String {
    let mut out = format!(
        "<details open><summary>Slopes and tails</summary><p class=\"note\">Intervals are over scenes and, within \
         each scene, over blocks of pixels. Errors and slopes exclude scenes without noise, and rungs whose error is \
         below the noise of the reference; their number is given. Kurtosis and tail index are medians over scenes for \
         single samples, in units of each pixel's standard deviation. “Near normal from” is the first rung from which \
         the pixel errors divided by σ/√n are normally distributed to within {}% (Kolmogorov distance, mean over \
         scenes). At earlier rungs the law holds on average, but not for most pixels. A scene is flagged as \
         heavy-tailed if its tail index is below {HEAVY_INDEX}, its excess kurtosis above {HEAVY_KURTOSIS}, or more \
         than {}% of its variance is in 1% of its pixels.</p><div class=\"scroll\"><table \
         class=\"wide\"><thead><tr><th>Stratum</th><th>Scenes</th><th>Slope</th><th>−½ inside</th><th>RMSE, first \
         rung</th><th>Law, first rung</th><th>Excess kurtosis</th><th>Tail index</th><th>Near normal \
         from</th><th>Variance in the top 1% of pixels</th><th>Flagged scenes</th><th>Mean path \
         length</th><th>Rejected samples</th></tr></thead><tbody>",
        fixed(100.0 * OFF_NORMAL, 0),
        fixed(100.0 * HEAVY_SHARE, 0)
    );
    let last = [&convergence.overall];
    for (row, total) in rows.iter().map(|r| (*r, false)).chain(last.map(|r| (r, true))) {
        let (class, title) = if total { (" class=\"total\"", "All".to_owned()) } else { ("", name(row)) };
        let at = |values: &[f64]| values.first().map_or_else(|| "–".into(), |v| error(*v));
        let noiseless = if row.noiseless == 0 {
            String::new()
        } else {
            format!("<span class=\"ci\">{} without noise</span>", count(row.noiseless))
        };
        let _ = write!(
            out,
            "<tr{class}><td>{}</td><td>{}{noiseless}</td><td>{}</td><td>{}</td><td>{}</td>\
             <td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}%</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escape(&title),
            count(row.scenes),
            slope(row.slope.as_ref(), row.unresolved),
            holds(row.slope.as_ref()),
            at(&row.rmse),
            at(&row.law),
            optional(row.excess_kurtosis),
            optional(row.tail_index),
            row.trusted_from.map_or_else(|| "–".into(), count),
            fixed(row.tail_share * 100.0, 0),
            count(row.heavy_scenes),
            fixed(row.mean_path_length, 2),
            count(row.rejected)
        );
    }
    out + "</tbody></table></div></details>"
        + &scenes::table(convergence)
        + &moments::covariances(convergence, rows)
        + &moments::sde(convergence)
}
