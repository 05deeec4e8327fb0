//! Error against time: the chart that a page opens with, and the section behind it.

mod csv;
mod tables;

use crate::{
    page::{Section, tabs},
    ranking::{colour, conditioning_name, method_name, solver},
    svg::{Plot, Scale},
    text::{compact, count, escape, fixed, plural},
};
pub use csv::{points as points_csv, scenes as scenes_csv, targets as targets_csv};
use std::fmt::Write as _;
use tauflow_data::{
    methods::{Conditioning, OIDN, PATH_TRACER},
    records::{TimeError, TimedMethod, TimedPoint, TimedSummary, front},
    timing::named,
};

/// Methods and their points, best first for each.
type Lines<'a> = Vec<(&'a TimedMethod, Vec<&'a TimedPoint>)>;

/// The name of a method, with its input.
fn name(method: &TimedMethod) -> String {
    if method.method == PATH_TRACER {
        return "Rendering alone".into();
    }
    let cell: Vec<String> = method.cell.iter().map(|(axis, value)| format!("{axis} {value}")).collect();
    let mut parts = vec![method_name(&method.method), conditioning_name(&method.conditioning)];
    parts.extend(cell);
    parts.retain(|part| !part.is_empty());
    parts.join(", ")
}

fn class(method: &TimedMethod) -> String {
    colour(&method.method)
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

fn is_solver(method: &TimedMethod) -> bool {
    solver(&method.method).is_some()
}

/// The solver that has the largest speed-up anywhere.
fn best_solver(of: &TimeError) -> Option<&TimedMethod> {
    let speed = |m: &TimedMethod| {
        m.points.iter().filter_map(|p| p.all.speed_up).map(|e| e.mean).fold(f64::NEG_INFINITY, f64::max)
    };
    let solvers = of.methods.iter().filter(|m| is_solver(m));
    solvers.max_by(|a, b| speed(a).total_cmp(&speed(b)))
}

/// The coordinates of a point in a chart: a time and an error.
#[derive(Clone, Copy)]
struct View {
    title: &'static str,
    seconds: &'static str,
    of: fn(&TimedSummary) -> (f64, f64),
}

const WALL: View = View {
    title: "RMSE against time",
    seconds: "seconds per scene (log), from its files to the image",
    of: |s| (s.wall_s[1], s.mse.sqrt()),
};
const RELATIVE: View = View { title: "Relative MSE against time", of: |s| (s.wall_s[1], s.rel_mse), ..WALL };
const PROCESSOR: View = View {
    title: "RMSE against processor time",
    seconds: "core seconds per scene (log)",
    of: |s| (s.cpu_s[1], s.mse.sqrt()),
};

/// The points of a view that none of the others is both faster and better than.
fn on_front(places: &[(f64, f64)]) -> Vec<(f64, f64)> {
    front(places).into_iter().map(|at| places[at]).collect()
}

/// Error against time of all methods. Dots are what was measured, lines each method's own front; the dashed line is
/// the front of all.
fn pareto(of: &TimeError, view: View) -> String {
    let places = |m: &TimedMethod| -> Vec<(f64, f64)> { m.points.iter().map(|p| (view.of)(&p.all)).collect() };
    let all: Vec<(f64, f64)> = of.methods.iter().flat_map(places).collect();
    let x = Scale::log(all.iter().map(|p| p.0), 0.04);
    let y = Scale::log(all.iter().map(|p| p.1), 0.06);
    let mut plot = Plot::new([900.0, 460.0], [64.0, 214.0, 34.0, 40.0], x, y);
    plot.title(view.title).y_axis(6);
    plot.x_axis_round(6, view.seconds);
    for method in &of.methods {
        let class = class(method);
        let places = places(method);
        let best = on_front(&places);
        // Two cells of one method have one colour: what sees a G-buffer is broken.
        let line =
            if method.conditioning == Conditioning::Gbuffer.name() { format!("{class} broken") } else { class.clone() };
        plot.line(best.iter().copied(), &line).dots(places, 2.2, &class).dots(best.iter().copied(), 3.6, &class);
        if let Some((_, last)) = best.last() {
            plot.end_label(*last, &class, &name(method));
        }
    }
    plot.line(on_front(&all), "soft dashed");
    plot.finish(&format!("{}: {}", view.title, names(of.methods.iter())))
}

fn names<'a>(methods: impl Iterator<Item = &'a TimedMethod>) -> String {
    methods.map(name).collect::<Vec<_>>().join("; ")
}

/// Rendering alone, a denoiser if there is one, and the best solver: what is seen where there is room for few.
fn chosen(of: &TimeError) -> Vec<&TimedMethod> {
    let rendering = of.methods.iter().find(|m| m.method == PATH_TRACER);
    let denoiser =
        of.methods.iter().filter(|m| m.method == OIDN).max_by_key(|m| m.conditioning == Conditioning::Gbuffer.name());
    rendering.into_iter().chain(denoiser).chain(best_solver(of)).collect()
}

/// The figure that the page opens with: rendering alone, the best solver, and a denoiser if there is one.
pub fn opening(of: &TimeError) -> String {
    let methods = chosen(of);
    let lines: Lines<'_> = methods.iter().map(|m| (*m, best_by_start(m))).collect();
    let places = |points: &[&TimedPoint]| -> Vec<(f64, f64)> { points.iter().map(|p| (WALL.of)(&p.all)).collect() };
    let all: Vec<(f64, f64)> = lines.iter().flat_map(|(_, points)| places(points)).collect();
    let x = Scale::log(all.iter().map(|p| p.0), 0.04);
    let y = Scale::log(all.iter().map(|p| p.1), 0.06);
    let mut plot = Plot::new([860.0, 330.0], [64.0, 178.0, 34.0, 40.0], x, y);
    plot.title(WALL.title).y_axis(6);
    plot.x_axis_round(6, WALL.seconds);
    for (method, points) in &lines {
        let (class, places) = (class(method), places(points));
        plot.line(places.clone(), &class).dots(places.clone(), 3.4, &class);
        if let Some((_, last)) = places.last() {
            plot.end_label(*last, &class, &name(method));
        }
    }
    let timed = of.methods.iter().filter(|m| is_solver(m)).count() as u64;
    let choice = match timed {
        0 | 1 => String::new(),
        _ => format!(" The solver shown has the largest speed-up of {timed} on these scenes."),
    };
    let told = best_solver(of).and_then(|solver| {
        let (point, speed) = best_by_start(solver)
            .into_iter()
            .filter_map(|p| Some((p, p.all.speed_up?)))
            .reduce(|a, b| if b.1.mean > a.1.mean { b } else { a })?;
        let interval = match point.all.has_intervals() {
            false => String::new(),
            true => format!(" (95% interval {} to {})", fixed(speed.low, 1), fixed(speed.high, 1)),
        };
        Some(format!(
            " {} from {} spp is <b>{}×</b> faster than rendering alone at equal error{interval}. It has the error of \
             {} samples per pixel.",
            escape(&name(solver)),
            point.from_spp,
            fixed(speed.mean, 1),
            point.all.crossover_spp.map_or_else(|| "–".into(), |e| compact(e.mean)),
        ))
    });
    format!(
        "<figure class=\"opening\">{}<figcaption>Error against time over {}: median times and geometric mean errors, \
         measured on {}.{}{choice}{}</figcaption></figure>",
        plot.finish(&format!("RMSE against seconds per scene: {}", names(methods.iter().copied()))),
        plural(of.scenes, "held-out test scene"),
        escape(&named(&of.machine).unwrap_or_else(|| "an unknown machine".into())),
        told.unwrap_or_default(),
        of.notes.iter().map(|note| format!(" {}.", escape(note))).collect::<String>(),
    )
}

/// Small charts, one a stratum, on the same axes.
fn by_stratum(of: &TimeError) -> String {
    let methods = chosen(of);
    let Some(rendering) = methods.first().and_then(|m| m.points.first()) else { return String::new() };
    let at = |method: &TimedMethod, stratum: &str| -> Vec<(f64, f64)> {
        let points = method.points.iter().filter_map(|p| p.strata.get(stratum));
        on_front(&points.map(WALL.of).collect::<Vec<_>>())
    };
    let strata: Vec<&String> = rendering.strata.keys().collect();
    let all: Vec<(f64, f64)> = strata.iter().flat_map(|s| methods.iter().flat_map(|m| at(m, s))).collect();
    let x = Scale::log(all.iter().map(|p| p.0), 0.04);
    let y = Scale::log(all.iter().map(|p| p.1), 0.06);
    let keys: String = methods
        .iter()
        .map(|m| format!("<span class=\"key {}\"></span>{} &nbsp; ", class(m), escape(&name(m))))
        .collect();
    let mut out = format!(
        "<p class=\"note\">{keys}: each with its best number of calls. RMSE against seconds per scene, with equal \
         axes.</p><div class=\"grid4\">"
    );
    for stratum in strata {
        let title = stratum.replacen('-', " ", 1);
        let mut plot = Plot::new([270.0, 210.0], [48.0, 8.0, 24.0, 24.0], x, y);
        plot.title(&title).y_axis(4);
        plot.x_axis_round(3, "");
        for method in &methods {
            let (class, places) = (class(method), at(method, stratum));
            plot.line(places.clone(), &class).dots(places, 2.4, &class);
        }
        out.push_str(&plot.finish(&format!("{title}, RMSE against seconds: {}", names(methods.iter().copied()))));
    }
    out + "</div>"
}

/// The section.
pub fn section(of: &TimeError) -> Section {
    let mut out = format!(
        "<p>Times include everything from a scene's files to its image: rendering the input, the G-buffer if a method \
         reads it, and the method. They are medians over {} on one machine. Errors are measured against \
         I<sub>{}</sub> of an independent random stream, with the noise of the reference subtracted. Each dot is one \
         sample count and one number of calls. A line connects the Pareto-optimal points of a method (broken if it \
         reads a G-buffer). The dashed grey line connects the points of all methods that no other point beats in both \
         time and error.</p>",
        plural(of.scenes, "scene"),
        count(of.reference_spp),
    );
    let charts = [WALL, RELATIVE, PROCESSOR]
        .map(|view| (view.title.to_owned(), format!("<figure>{}</figure>", pareto(of, view))));
    out.push_str(&tabs("time-charts", &charts));
    for note in &of.notes {
        let _ = write!(out, "<p class=\"note\">{}</p>", escape(note));
    }
    let panels = [
        ("Points".to_owned(), tables::points(of)),
        ("At equal time".to_owned(), tables::equal_time(of)),
        ("Time to an error".to_owned(), tables::targets(of)),
        ("By stratum".to_owned(), by_stratum(of) + &tables::strata(of)),
        ("By scene".to_owned(), tables::scenes(of)),
    ];
    out.push_str(&tabs("time", &panels));
    Section { class: "measured", ..Section::new("time", "Error against time (measured)", out) }
}
