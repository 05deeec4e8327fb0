//! PSNR and HDR MAE against NFE: one panel for each conditioning, methods as lines with their intervals as bands.

use crate::{
    page::{Section, tabs},
    ranking::{Group, colour, groups, method_name, metric_name},
    svg::{Plot, Scale},
};
use tauflow_data::{
    methods::HOLD,
    records::{Evaluation, METRICS},
};

/// The section.
pub fn section(evaluation: &Evaluation) -> Section {
    let first = ["hdr_psnr", "hdr_mae"];
    let has = |m: &&str| evaluation.hold.contains_key(*m);
    let main: String = first.iter().filter(|m| has(m)).map(|m| row(evaluation, m)).collect();
    let others: String = METRICS.iter().filter(|m| !first.contains(m) && has(m)).map(|m| row(evaluation, m)).collect();
    let mut panels = vec![("HDR PSNR and MAE".to_owned(), main)];
    if !others.is_empty() {
        panels.push(("Other metrics".to_owned(), others));
    }
    let body = format!(
        "<p>One trained model is used for every number of network calls (NFE). Bands are 95% intervals of the mean \
         over scenes. Scenes vary more than methods, so methods with overlapping bands can still differ significantly \
         when paired by scene. Dashed: hold, the unchanged input.</p>{}",
        tabs("curves", &panels)
    );
    Section::new("curves", "Quality against network calls", body)
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
    let mut out = String::from(r#"<div class="grid2" style="margin-bottom:26px">"#);
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
            let class = colour(&table.method);
            let points: Vec<(f64, f64, f64, f64)> = table
                .at
                .iter()
                .filter_map(|a| a.metrics.get(metric).map(|e| (a.nfe as f64, e.low, e.high, e.mean)))
                .collect();
            let band: Vec<(f64, f64, f64)> = points.iter().map(|p| (p.0, p.1, p.2)).collect();
            plot.band(&band, &class);
        }
        for table in &tables {
            let class = colour(&table.method);
            let points: Vec<(f64, f64)> =
                table.at.iter().filter_map(|a| a.metrics.get(metric).map(|e| (a.nfe as f64, e.mean))).collect();
            plot.line(points.clone(), &class).dots(points.clone(), 3.4, &class);
            if let Some((_, last)) = points.last() {
                plot.end_label(*last, &class, &method_name(&table.method));
            }
        }
        let description = format!("{} against NFE, {title}; the values are in the table above", metric_name(metric));
        out.push_str(&format!("<figure>{}</figure>", plot.finish(&description)));
    }
    out.push_str("</div>");
    out
}
