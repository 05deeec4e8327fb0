//! Error against time: the chart that a page opens with, and the section behind it.

use crate::{
    page::{Section, tabs},
    ranking::{colour, conditioning_name, method_name},
    sections::method_html,
    svg::{Plot, Scale},
    text::{compact, count, escape, fixed, interval, signed},
};
use std::fmt::Write as _;
use tauflow_data::{
    results::Estimate,
    time_error::{TimeError, TimedMethod, TimedPoint, TimedSummary},
};

/// How the path tracer is called among methods.
const RENDERING: &str = "path_tracer";
/// Parameterizations: what is a solver.
const SOLVERS: [&str; 4] = crate::ranking::METHODS;

/// Methods and their points, best first for each.
type Lines<'a> = Vec<(&'a TimedMethod, Vec<&'a TimedPoint>)>;

/// What a method is called, with what it sees.
fn name(method: &TimedMethod) -> String {
    if method.method == RENDERING {
        return "Rendering alone".into();
    }
    let cell: Vec<String> = method.cell.iter().map(|(axis, value)| format!("{axis} {value}")).collect();
    let mut parts = vec![method_name(&method.method), conditioning_name(&method.conditioning)];
    parts.extend(cell);
    parts.retain(|part| !part.is_empty());
    parts.join(", ")
}

fn class(method: &TimedMethod) -> String {
    if method.method == RENDERING { "ink".into() } else { colour(&method.method) }
}

/// From each endpoint the point of least error.
fn best_by_start(method: &TimedMethod) -> Vec<&TimedPoint> {
    let mut points: Vec<&TimedPoint> = method.points.iter().collect();
    points.sort_by(|a, b| {
        (a.from_spp, a.all.mse).partial_cmp(&(b.from_spp, b.all.mse)).unwrap_or(std::cmp::Ordering::Equal)
    });
    points.dedup_by_key(|point| point.from_spp);
    points
}

/// The solver that has the largest speed-up anywhere.
fn best_solver(of: &TimeError) -> Option<&TimedMethod> {
    let speed = |m: &TimedMethod| {
        m.points.iter().filter_map(|p| p.all.speed_up).map(|e| e.mean).fold(f64::NEG_INFINITY, f64::max)
    };
    let solvers = of.methods.iter().filter(|m| SOLVERS.contains(&m.method.as_str()));
    solvers.max_by(|a, b| speed(a).total_cmp(&speed(b)))
}

/// Error against time of these methods; `size` in pixels.
fn chart(
    lines: &Lines<'_>,
    front: &[(f64, f64)],
    size: [f64; 2],
    of: impl Fn(&TimedPoint) -> Option<(f64, f64)>,
) -> String {
    let places = |points: &[&TimedPoint]| -> Vec<(f64, f64)> { points.iter().filter_map(|p| of(p)).collect() };
    let all: Vec<(f64, f64)> = lines.iter().flat_map(|(_, points)| places(points)).collect();
    let x = Scale::log(all.iter().map(|p| p.0), 0.04);
    let y = Scale::log(all.iter().map(|p| p.1), 0.06);
    let mut plot = Plot::new(size, [64.0, 178.0, 34.0, 40.0], x, y);
    plot.title("RMSE against time").y_axis(6);
    plot.x_axis_round(6, "seconds a scene (log), from its files to the image");
    plot.line(front.iter().copied(), "soft dashed");
    for (method, points) in lines {
        let class = class(method);
        let places = places(points);
        plot.line(places.clone(), &class).dots(places.clone(), 3.4, &class);
        if let Some((_, last)) = places.last() {
            plot.end_label(*last, &class, &name(method));
        }
    }
    let texts: Vec<String> = lines.iter().map(|(method, _)| name(method)).collect();
    plot.finish(&format!("RMSE against seconds a scene: {}", texts.join("; ")))
}

fn place(summary: &TimedSummary) -> (f64, f64) {
    (summary.wall_s[1], summary.mse.sqrt())
}

/// The figure that the page opens with: rendering alone, the best solver, and a denoiser if there is one.
pub fn opening(of: &TimeError) -> String {
    let mut lines: Lines<'_> = Vec::new();
    let rendering = of.methods.iter().find(|m| m.method == RENDERING);
    let denoiser = of.methods.iter().filter(|m| m.method == "oidn").max_by_key(|m| m.conditioning == "gbuffer");
    let solver = best_solver(of);
    for method in rendering.into_iter().chain(denoiser).chain(solver) {
        lines.push((method, best_by_start(method)));
    }
    let told = solver.and_then(|solver| {
        let (point, speed) = best_by_start(solver).into_iter().filter_map(|p| Some((p, p.all.speed_up?))).reduce(|a, b| {
            if b.1.mean > a.1.mean { b } else { a }
        })?;
        Some(format!(
            " {} from {} spp gets where rendering alone would take <b>{}×</b> as long (95% interval {} to {}), and has the error of \
             {} samples a pixel.",
            escape(&name(solver)),
            point.from_spp,
            fixed(speed.mean, 1),
            fixed(speed.low, 1),
            fixed(speed.high, 1),
            point.all.crossover_spp.map_or_else(|| "–".into(), compact),
        ))
    });
    format!(
        "<figure class=\"opening\">{}<figcaption>Error against time over {} held-out test scenes: medians of time, geometric means of \
         error, measured on {}.{}{}</figcaption></figure>",
        chart(&lines, &[], [860.0, 330.0], |p| Some(place(&p.all))),
        count(of.scenes),
        escape(of.machine.get("processor").and_then(|p| p.as_str()).unwrap_or("an unknown processor")),
        told.unwrap_or_default(),
        of.notes.iter().map(|note| format!(" {}.", escape(note))).collect::<String>(),
    )
}

/// The section.
pub fn section(of: &TimeError) -> Section {
    let lines: Lines<'_> = of.methods.iter().map(|m| (m, m.points.iter().collect())).collect();
    let on_front = of.front.iter().filter_map(|at| of.methods.get(at.method)?.points.get(at.point));
    let front: Vec<(f64, f64)> = on_front.map(|p| place(&p.all)).collect();
    let mut out = format!(
        "<p>Times go from a scene's files to its image: rendering to the endpoint, the G-buffer where a method sees one, and the \
         method. They are medians over {} scenes on one machine; errors are against I<sub>{}</sub> of another stream of samples, its own \
         noise taken off. Dashed grey: the front, the points that nothing else is both faster and better than. Along a solver's line \
         stand its endpoints and numbers of calls.</p><figure>{}</figure>",
        count(of.scenes),
        count(of.reference_spp),
        chart(&lines, &front, [900.0, 420.0], |p| Some(place(&p.all)))
    );
    for note in &of.notes {
        let _ = write!(out, "<p class=\"note\">{}</p>", escape(note));
    }
    let panels = [
        ("Points".to_owned(), points(of)),
        ("At equal time".to_owned(), equal_time(of)),
        ("Time to an error".to_owned(), targets(of)),
        ("By stratum".to_owned(), strata(of)),
    ];
    out.push_str(&tabs("time", &panels));
    Section { class: "measured", ..Section::new("time", "Error against time (measured)", out) }
}

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
    match (method.method.as_str(), method.conditioning.as_str()) {
        (RENDERING, _) => "Rendering alone".into(),
        (name, "") => method_html(name),
        (name, sees) => format!("{}, {}", method_html(name), escape(&conditioning_name(sees))),
    }
}

fn calls(point: &TimedPoint) -> String {
    if point.nfe == 0 { "–".into() } else { point.nfe.to_string() }
}

fn estimate(found: Option<&Estimate>, digits: usize) -> String {
    found.map_or_else(|| "–".into(), |e| format!("{} <small>{}</small>", fixed(e.mean, digits), interval(e, digits)))
}

fn points(of: &TimeError) -> String {
    let mut rows = String::new();
    for method in &of.methods {
        for point in &method.points {
            let all = &point.all;
            rows.push_str(&cells(&[
                named(method),
                count(point.from_spp),
                calls(point),
                format!(
                    "{} <small>{} to {}</small>",
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
                estimate(all.speed_up.as_ref(), 2),
                all.crossover_spp.map_or_else(|| "–".into(), compact),
            ]));
        }
    }
    let heads = [
        "Method",
        "Samples",
        "NFE",
        "Wall time (s)",
        "Processor time (s)",
        "RMSE",
        "Relative MSE",
        "HDR PSNR",
        "Preview PSNR",
        "SSIM",
        "Speed-up over rendering",
        "Crossover (spp)",
    ];
    table(&heads, &rows)
}

fn equal_time(of: &TimeError) -> String {
    let mut rows = String::new();
    for method in &of.methods {
        for point in &method.points {
            let Some(versus) = &point.versus else { continue };
            let gain =
                |e: &Estimate, digits| format!("{} <small>{}</small>", signed(e.mean, digits), interval(e, digits));
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
        "Samples of rendering alone in that time",
        "Gain in HDR PSNR (dB)",
        "Gain in preview PSNR (dB)",
        "Gain in SSIM",
        "Scenes with a gain",
    ];
    table(&heads, &rows)
}

fn targets(of: &TimeError) -> String {
    let Some(first) = of.methods.first() else { return String::new() };
    let title = |metric: &str, target: f64| match metric {
        "hdr_psnr" => format!("{} dB", compact(target)),
        _ => format!("relative MSE {}", compact(target)),
    };
    let mut heads = vec!["Method".to_owned()];
    heads.extend(first.targets.iter().map(|t| title(&t.metric, t.target)));
    let mut rows = String::new();
    for method in &of.methods {
        let mut texts = vec![named(method)];
        texts.extend(method.targets.iter().map(|t| {
            let time = t.wall_s.map_or_else(|| "–".into(), |s| format!("{} s", compact(s)));
            format!("{time} <small>{}% of scenes</small>", fixed(100.0 * t.reached, 0))
        }));
        rows.push_str(&cells(&texts));
    }
    let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
    let note = "<p class=\"note\">Median over scenes of the least time to each error; none where fewer than half of the scenes get there at \
                any point that was measured.</p>";
    note.to_owned() + &table(&heads, &rows)
}

fn strata(of: &TimeError) -> String {
    let Some(solver) = best_solver(of) else { return "<p>No solver was timed.</p>".into() };
    let mut rows = String::new();
    for point in best_by_start(solver) {
        for (stratum, at) in &point.strata {
            rows.push_str(&cells(&[
                stratum.replacen('-', " ", 1),
                count(point.from_spp),
                calls(point),
                count(at.scenes),
                compact(at.wall_s[1]),
                compact(at.mse.sqrt()),
                estimate(at.speed_up.as_ref(), 2),
                at.crossover_spp.map_or_else(|| "–".into(), compact),
            ]));
        }
    }
    let heads =
        ["Stratum", "Samples", "NFE", "Scenes", "Wall time (s)", "RMSE", "Speed-up over rendering", "Crossover (spp)"];
    format!("<p>{}: from each endpoint at its best number of calls.</p>{}", escape(&name(solver)), table(&heads, &rows))
}

/// Every point as CSV.
pub fn csv(of: &TimeError) -> String {
    let mut out = String::from(
        "method,conditioning,cell,stratum,scenes,from_spp,nfe,wall_s_q1,wall_s,wall_s_q3,cpu_s,mse,rel_mse,hdr_psnr,preview_psnr,ssim,speed_up,crossover_spp\n",
    );
    for method in &of.methods {
        let cell: Vec<String> = method.cell.iter().map(|(axis, value)| format!("{axis}={value}")).collect();
        for point in &method.points {
            let all = std::iter::once(("all", &point.all));
            for (stratum, at) in all.chain(point.strata.iter().map(|(name, at)| (name.as_str(), at))) {
                let optional = |v: Option<f64>| v.map_or_else(String::new, |v| v.to_string());
                let _ = writeln!(
                    out,
                    "{},{},{},{stratum},{},{},{},{},{},{},{},{},{},{},{},{},{},{}",
                    crate::csv::field(&method.method),
                    crate::csv::field(&method.conditioning),
                    crate::csv::field(&cell.join("+")),
                    at.scenes,
                    point.from_spp,
                    point.nfe,
                    at.wall_s[0],
                    at.wall_s[1],
                    at.wall_s[2],
                    at.cpu_s[1],
                    at.mse,
                    at.rel_mse,
                    at.hdr_psnr,
                    at.preview_psnr,
                    at.ssim,
                    optional(at.speed_up.map(|e| e.mean)),
                    optional(at.crossover_spp)
                );
            }
        }
    }
    out
}
