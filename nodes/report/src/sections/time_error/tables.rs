//! Tables of error against time.

use super::{best_by_start, best_solver, name};
use crate::{
    ranking::conditioning_name,
    sections::{method_html, no_intervals, resampled},
    text::{compact, count, escape, fixed, interval, signed},
};
use std::fmt::Write as _;
use tauflow_data::{
    methods::PATH_TRACER,
    records::{Estimate, TimeError, TimeTo, TimedMethod, TimedPoint, TimedSummary},
};

fn table(heads: &[&str], rows: &str) -> String {
    let heads: String = heads.iter().map(|head| format!("<th>{head}</th>")).collect();
    format!(
        "<div class=\"scroll\"><table class=\"wide\"><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>"
    )
}

fn cells(texts: &[String]) -> String {
    format!("<tr>{}</tr>", texts.iter().map(|text| format!("<td>{text}</td>")).collect::<String>())
}

fn named(method: &TimedMethod) -> String {
    if method.method == PATH_TRACER {
        return "Rendering alone".into();
    }
    let sees = Some(conditioning_name(&method.conditioning)).filter(|sees| !sees.is_empty());
    let cell = method.cell.iter().map(|(axis, value)| format!("{axis} {value}"));
    let words = sees.into_iter().chain(cell).map(|word| format!(", {}", escape(&word)));
    method_html(&method.method) + &words.collect::<String>()
}

fn calls(point: &TimedPoint) -> String {
    if point.nfe == 0 { "–".into() } else { point.nfe.to_string() }
}

/// A ratio with its interval, if it has one.
fn ratio(found: Option<&Estimate>, has_interval: bool, text: impl Fn(f64) -> String) -> String {
    match found {
        None => "–".into(),
        Some(e) if !has_interval => text(e.mean),
        Some(e) => format!("{}<span class=\"ci\">[{}, {}]</span>", text(e.mean), text(e.low), text(e.high)),
    }
}

fn speed_up(of: &TimedSummary) -> String {
    ratio(of.speed_up.as_ref(), of.has_intervals(), |v| fixed(v, 2))
}

fn crossover(of: &TimedSummary) -> String {
    let beyond = match of.extrapolated > 0.0 {
        true => format!(" <small>† {}%</small>", fixed(100.0 * of.extrapolated, 0)),
        false => String::new(),
    };
    ratio(of.crossover_spp.as_ref(), of.has_intervals(), compact) + &beyond
}

fn beyond(groups: Option<u64>) -> String {
    let intervals = match groups {
        Some(1) => no_intervals("scene", groups),
        _ => {
            let single = if groups.is_some() { "group" } else { "scene" };
            format!("Intervals: 95%, by bootstrap over {}; omitted for a single {single}.", resampled(groups))
        }
    };
    format!(
        "<p class=\"note\">{intervals} †: share of scenes whose \
         crossover is beyond the last timed rung and is extrapolated with the 1/n law.</p>"
    )
}

/// Every point, over all scenes.
pub fn points(of: &TimeError) -> String {
    let mut rows = String::new();
    for method in &of.methods {
        for point in &method.points {
            let all = &point.all;
            rows.push_str(&cells(&[
                named(method),
                count(point.from_spp),
                calls(point),
                format!(
                    "{}<span class=\"ci\">{} to {}</span>",
                    compact(all.wall_s[1]),
                    compact(all.wall_s[0]),
                    compact(all.wall_s[2])
                ),
                compact(all.cpu_s[1]),
                compact(all.mse.sqrt()),
                compact(all.rel_mse),
                fixed(all.hdr_psnr, 2),
                fixed(all.preview_psnr, 2),
                fixed(all.ssim, 4),
                speed_up(all),
                crossover(all),
            ]));
        }
    }
    let heads = [
        "Method",
        "Samples",
        "NFE",
        "Wall time (s)",
        "Processor time (s)",
        "RMSE, geometric mean",
        "Relative MSE, geometric mean",
        "HDR PSNR",
        "Preview PSNR",
        "SSIM",
        "Speed-up over rendering",
        "Crossover (spp)",
    ];
    beyond(of.groups) + &table(&heads, &rows)
}

/// The result of path tracing at equal time.
pub fn equal_time(of: &TimeError) -> String {
    let mut rows = String::new();
    for method in &of.methods {
        for point in &method.points {
            let Some(versus) = &point.versus else { continue };
            let gain = |e: &Estimate, digits| match point.all.has_intervals() {
                false => signed(e.mean, digits),
                true => format!("{} <small>{}</small>", signed(e.mean, digits), interval(e, digits)),
            };
            rows.push_str(&cells(&[
                named(method),
                count(point.from_spp),
                calls(point),
                compact(versus.spp),
                gain(&versus.hdr_psnr, 2),
                gain(&versus.preview_psnr, 2),
                gain(&versus.ssim, 4),
                format!("{}%", fixed(100.0 * versus.better, 0)),
            ]));
        }
    }
    let heads = [
        "Method",
        "Samples",
        "NFE",
        "Samples of rendering alone in equal time",
        "Gain in HDR PSNR (dB)",
        "Gain in preview PSNR (dB)",
        "Gain in SSIM",
        "Scenes with a gain",
    ];
    table(&heads, &rows)
}

/// How long methods take to errors, over all scenes and by stratum.
pub fn targets(of: &TimeError) -> String {
    let all: Vec<(&TimedMethod, &[TimeTo])> = of.methods.iter().map(|m| (m, m.targets.as_slice())).collect();
    let note = "<p class=\"note\">Median over scenes of the shortest time to each error. A dash means that fewer than \
        half of the scenes reach the error at any measured point. Rendering alone may stop between two rungs, but not \
        after the last.</p>";
    let mut out = note.to_owned() + &times_to(&all);
    let strata = of.methods.first().map(|m| m.strata_targets.keys());
    for stratum in strata.into_iter().flatten() {
        let of: Vec<(&TimedMethod, &[TimeTo])> =
            of.methods.iter().filter_map(|m| Some((m, m.strata_targets.get(stratum)?.as_slice()))).collect();
        let _ = write!(
            out,
            "<details><summary>{}</summary>{}</details>",
            escape(&stratum.replacen('-', " ", 1)),
            times_to(&of)
        );
    }
    out
}

fn times_to(methods: &[(&TimedMethod, &[TimeTo])]) -> String {
    let Some((_, first)) = methods.first() else { return String::new() };
    let title = |metric: &str, target: f64| match metric {
        "hdr_psnr" => format!("{} dB", compact(target)),
        _ => format!("relative MSE {}", compact(target)),
    };
    let mut heads = vec!["Method".to_owned()];
    heads.extend(first.iter().map(|t| title(&t.metric, t.target)));
    let mut rows = String::new();
    for (method, targets) in methods {
        let mut texts = vec![named(method)];
        texts.extend(targets.iter().map(|t| {
            let time = t.wall_s.map_or_else(|| "–".into(), |s| format!("{} s", compact(s)));
            format!("{time} <small>{}% of scenes</small>", fixed(100.0 * t.reached, 0))
        }));
        rows.push_str(&cells(&texts));
    }
    let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
    table(&heads, &rows)
}

/// Every method by stratum, from each endpoint at its best number of calls.
pub fn strata(of: &TimeError) -> String {
    let heads = [
        "Stratum",
        "Samples",
        "NFE",
        "Scenes",
        "Wall time (s)",
        "RMSE, geometric mean",
        "Relative MSE, geometric mean",
        "Speed-up over rendering",
        "Crossover (spp)",
    ];
    let best = best_solver(of);
    let mut out = format!("<p>For each input sample count, with the best number of calls.</p>{}", beyond(of.groups));
    for method in of.methods.iter().filter(|m| m.method != PATH_TRACER) {
        let mut rows = String::new();
        for point in best_by_start(method) {
            for (stratum, at) in &point.strata {
                rows.push_str(&cells(&[
                    stratum.replacen('-', " ", 1),
                    count(point.from_spp),
                    calls(point),
                    count(at.scenes),
                    compact(at.wall_s[1]),
                    compact(at.mse.sqrt()),
                    compact(at.rel_mse),
                    speed_up(at),
                    crossover(at),
                ]));
            }
        }
        let open = if best.is_some_and(|best| std::ptr::eq(best, method)) { " open" } else { "" };
        let _ = write!(
            out,
            "<details{open}><summary>{}</summary>{}</details>",
            escape(&name(method)),
            table(&heads, &rows)
        );
    }
    out
}

/// The point of a method with the largest speed-up.
fn fastest(method: &TimedMethod) -> Option<&TimedPoint> {
    let speed = |p: &&TimedPoint| p.all.speed_up.map_or(f64::NEG_INFINITY, |e| e.mean);
    method.points.iter().max_by(|a, b| speed(a).total_cmp(&speed(b)))
}

/// Every scene: how much faster than rendering alone each method is, where it is fastest.
pub fn scenes(of: &TimeError) -> String {
    let points: Vec<(&TimedMethod, &TimedPoint)> =
        of.methods.iter().filter(|m| m.method != PATH_TRACER).filter_map(|m| Some((m, fastest(m)?))).collect();
    let last = of.methods.iter().find(|m| m.method == PATH_TRACER).and_then(|m| m.points.last());
    let timed = last.map_or(0, |p| p.from_spp);
    let mut heads = vec!["Scene".to_owned()];
    heads.extend(points.iter().map(|(method, point)| {
        let calls = if point.nfe == 0 { String::new() } else { format!(", NFE {}", point.nfe) };
        format!("{} <small>{} spp{calls}</small>", named(method), count(point.from_spp))
    }));
    let mut rows = String::new();
    for at in 0..of.scenes as usize {
        let Some(scene) = points.first().and_then(|(_, p)| p.scenes.get(at)) else { continue };
        let mut texts = vec![escape(&scene.scene)];
        texts.extend(points.iter().filter_map(|(_, point)| point.scenes.get(at)).map(|s| {
            let beyond = if s.crossover_spp.is_some_and(|spp| spp > timed as f64) { " †" } else { "" };
            let speed = s.speed_up.map_or_else(|| "–".into(), |v| fixed(v, 2));
            format!("{speed}{beyond} <small>RMSE {}</small>", compact(s.mse.sqrt()))
        }));
        rows.push_str(&cells(&texts));
    }
    let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
    format!(
        "<p>Speed-up over rendering alone, at the point with the largest speed-up of each method over all scenes. \
         <code>time_error_scenes.csv</code> contains all points of all scenes.</p><p class=\"note\">†: the crossover \
         is beyond the {} timed samples per pixel, and is extrapolated with the 1/n law.</p>{}",
        count(timed),
        table(&heads, &rows)
    )
}
