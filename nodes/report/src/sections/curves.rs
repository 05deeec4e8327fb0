//! PSNR and HDR MAE against NFE: one panel for each conditioning, methods as lines with their intervals as bands.

use crate::{
    page::{Section, tabs},
    ranking::{Group, colour, groups, method_name, metric_name},
    sections::no_intervals,
    svg::{Plot, Scale},
};
use tauflow_data::{
    methods::HOLD,
    records::{Estimate, Evaluation, METRICS, MethodTable},
};

/// The section; none where a curve would have one point.
pub fn section(evaluation: &Evaluation) -> Option<Section> {
    if evaluation.methods.is_empty() || evaluation.nfe.len() < 2 {
        return None;
    }
    let first = ["hdr_psnr", "hdr_mae"];
    let has = |m: &&str| evaluation.hold.contains_key(*m);
    let mut main: String = first.iter().filter(|m| has(m)).map(|m| row(evaluation, m)).collect();
    main += &close_row(evaluation, "hdr_mae");
    let others: String = METRICS.iter().filter(|m| !first.contains(m) && has(m)).map(|m| row(evaluation, m)).collect();
    let gains: String = first.iter().filter(|m| has(m)).map(|m| gain_row(evaluation, m)).collect();
    let mut panels = vec![("HDR PSNR and MAE".to_owned(), main), ("Paired gain over the input".to_owned(), gains)];
    if !others.is_empty() {
        panels.push(("Other metrics".to_owned(), others));
    }
    let (bands, narrower) = match evaluation.has_intervals() {
        true => (
            "Bands are 95% intervals of the mean over scenes. Scenes vary more than methods, so methods with \
             overlapping bands can still differ significantly when paired by scene."
                .to_owned(),
            ", so their bands are narrower, and a band above 0 is a significant gain (below 0 for an error)",
        ),
        false => (no_intervals("scene", evaluation.groups), ""),
    };
    let body = format!(
        "<p>One trained model is used for every number of network calls (NFE). {bands} Dashed: hold, the unchanged \
         input, and baselines. Close-ups show means up to {CLOSE} times the smallest. Paired gains are differences to \
         the input of the same scene{narrower}.</p>{}",
        tabs("curves", &panels)
    );
    Some(Section::new("curves", "Quality against network calls", body))
}

/// Paired gains over the input in one metric: a panel for each conditioning, on one y axis.
fn gain_row(evaluation: &Evaluation, metric: &str) -> String {
    let of = |table: &MethodTable| -> Vec<(f64, Estimate)> {
        table.at.iter().filter_map(|at| Some((at.nfe as f64, *at.gain.get(metric)?))).collect()
    };
    let all = evaluation.methods.iter().chain(&evaluation.baselines).flat_map(of);
    let y = Scale::linear(all.flat_map(|(_, e)| [e.mean, e.low, e.high]).chain([0.0]));
    let mut out = String::from(r#"<div class="grid2 charts">"#);
    for Group { title, tables, .. } in groups(evaluation) {
        let x = Scale::log(evaluation.nfe.iter().map(|n| *n as f64), 0.03);
        let mut plot = Plot::new([560.0, 310.0], [52.0, 108.0, 34.0, 40.0], x, y);
        plot.title(&format!("{}, paired gain, {title}", metric_name(metric))).y_axis(6);
        plot.x_axis(evaluation.nfe.iter().map(|n| (*n as f64, n.to_string())), "NFE (log)");
        plot.level(0.0, &format!("{} dashed", colour(HOLD))).end_label(0.0, &colour(HOLD), &method_name(HOLD));
        let conditioning = tables.first().map(|table| &table.conditioning);
        for other in evaluation.baselines.iter().filter(|other| Some(&other.conditioning) == conditioning) {
            if let Some((_, gain)) = of(other).first() {
                let class = colour(&other.method);
                plot.level(gain.mean, &format!("{class} dashed"));
                plot.end_label(gain.mean, &class, &method_name(&other.method));
            }
        }
        for table in &tables {
            plot.estimates(&of(table), evaluation.has_intervals(), &colour(&table.method), &method_name(&table.method));
        }
        let description = format!("{}, paired gain against NFE, {title}", metric_name(metric));
        out.push_str(&format!("<figure>{}</figure>", plot.finish(&description)));
    }
    out + "</div>"
}

/// Errors up to this multiple of the smallest one are shown in close-ups.
const CLOSE: f64 = 1.3;

/// Close-ups of an error near its smallest mean: means without intervals. Empty where the whole panels show the same.
fn close_row(evaluation: &Evaluation, metric: &str) -> String {
    let points = |table: &MethodTable| -> Vec<(f64, f64)> {
        table.at.iter().filter_map(|at| Some((at.nfe as f64, at.metrics.get(metric)?.mean))).collect()
    };
    let mut out = String::new();
    for Group { title, tables, .. } in groups(evaluation) {
        let conditioning = tables.first().map(|table| &table.conditioning);
        let others = evaluation.baselines.iter().filter(|other| Some(&other.conditioning) == conditioning);
        let levels: Vec<(&MethodTable, f64)> =
            others.filter_map(|other| Some((other, points(other).first()?.1))).collect();
        let means = tables.iter().flat_map(|table| points(table)).map(|(_, mean)| mean);
        let means: Vec<f64> = means.chain(levels.iter().map(|(_, mean)| *mean)).filter(|mean| *mean > 0.0).collect();
        let limit = CLOSE * means.iter().copied().fold(f64::INFINITY, f64::min);
        let near: Vec<f64> = means.iter().copied().filter(|mean| *mean <= limit).collect();
        if near.len() == means.len() || near.len() < 2 {
            continue;
        }
        let x = Scale::log(evaluation.nfe.iter().map(|n| *n as f64), 0.03);
        let mut plot = Plot::new([560.0, 310.0], [52.0, 108.0, 34.0, 40.0], x, Scale::log(near, 0.05));
        plot.title(&format!("{}, close-up, {title}", metric_name(metric))).y_axis(6);
        plot.x_axis(evaluation.nfe.iter().map(|n| (*n as f64, n.to_string())), "NFE (log)");
        for (other, mean) in levels.into_iter().filter(|(_, mean)| *mean <= limit) {
            let class = colour(&other.method);
            plot.level(mean, &format!("{class} dashed")).end_label(mean, &class, &method_name(&other.method));
        }
        for table in &tables {
            let class = colour(&table.method);
            let points = points(table);
            // A line ends where the method leaves the close-up.
            for run in points.split(|(_, mean)| *mean > limit).filter(|run| !run.is_empty()) {
                plot.line(run.iter().copied(), &class).dots(run.iter().copied(), 3.4, &class);
            }
            if let Some((_, last)) = points.iter().rfind(|(_, mean)| *mean <= limit) {
                plot.end_label(*last, &class, &method_name(&table.method));
            }
        }
        let description = format!("{} against NFE near the smallest, {title}", metric_name(metric));
        out += &format!("<figure>{}</figure>", plot.finish(&description));
    }
    if out.is_empty() { out } else { format!(r#"<div class="grid2 charts">{out}</div>"#) }
}

/// The panels of one metric, on one y axis.
fn row(evaluation: &Evaluation, metric: &str) -> String {
    let hold = evaluation.hold.get(metric);
    let log = metric.ends_with("_mae");
    let mut values: Vec<f64> = hold.iter().flat_map(|h| [h.mean, h.low, h.high]).collect();
    for at in evaluation.methods.iter().chain(&evaluation.baselines).flat_map(|t| &t.at) {
        values.extend(at.metrics.get(metric).iter().flat_map(|e| [e.mean, e.low, e.high]));
    }
    let y = if log { Scale::log(values, 0.05) } else { Scale::linear(values) };
    let mut out = String::from(r#"<div class="grid2 charts">"#);
    for Group { title, tables, .. } in groups(evaluation) {
        let x = Scale::log(evaluation.nfe.iter().map(|n| *n as f64), 0.03);
        let mut plot = Plot::new([560.0, 310.0], [52.0, 108.0, 34.0, 40.0], x, y);
        plot.title(&format!("{}, {title}", metric_name(metric))).y_axis(6);
        plot.x_axis(evaluation.nfe.iter().map(|n| (*n as f64, n.to_string())), "NFE (log)");
        if let Some(hold) = hold {
            plot.level(hold.mean, &format!("{} dashed", colour(HOLD))).end_label(
                hold.mean,
                &colour(HOLD),
                &method_name(HOLD),
            );
        }
        let conditioning = tables.first().map(|table| &table.conditioning);
        for other in evaluation.baselines.iter().filter(|other| Some(&other.conditioning) == conditioning) {
            // Made in one go: the same whatever the number of calls.
            if let Some(found) = other.at.first().and_then(|at| at.metrics.get(metric)) {
                let class = colour(&other.method);
                plot.level(found.mean, &format!("{class} dashed")).end_label(
                    found.mean,
                    &class,
                    &method_name(&other.method),
                );
            }
        }
        for table in &tables {
            let points: Vec<(f64, Estimate)> =
                table.at.iter().filter_map(|at| Some((at.nfe as f64, *at.metrics.get(metric)?))).collect();
            plot.estimates(&points, evaluation.has_intervals(), &colour(&table.method), &method_name(&table.method));
        }
        let description = format!("{} against NFE, {title}; the values are in the table above", metric_name(metric));
        out.push_str(&format!("<figure>{}</figure>", plot.finish(&description)));
    }
    out.push_str("</div>");
    out
}
