//! The figures as CSV (RFC 4180): one row for each cell, NFE and metric, and one for each scene. Knows no layout.

use crate::{
    material::Cell,
    ranking::{extra, names_of, ordered, with_baselines},
};
use std::fmt::Write as _;
pub use tauflow_data::tabular::csv_field as field;
use tauflow_data::{
    methods::{
        Conditioning, HOLD,
        axes::{CONDITIONING, SPACE},
    },
    records::{Estimate, Evaluation, METRICS, computed},
    tabular::csv_estimate,
};

/// Mean, low and high.
fn three(evaluation: &Evaluation, estimate: Option<&Estimate>) -> String {
    csv_estimate(estimate, evaluation.has_intervals())
}

fn names(space: &str, method: &str, conditioning: &str, cell: &Cell) -> String {
    [space, method, conditioning, &extra(cell)].map(field).join(",")
}

/// Head of [`results`].
pub const RESULTS: &str =
    "space,method,conditioning,cell,from_spp,reference_spp,nfe,metric,mean,low,high,gain,gain_low,gain_high";

/// Means and intervals: a row for each cell, NFE and metric; hold at NFE 0, methods to compare with last.
pub fn results(evaluation: &Evaluation) -> String {
    let mut out = format!("{RESULTS}\n");
    let spp = format!("{},{}", evaluation.from_spp, evaluation.reference_spp);
    for metric in METRICS.iter().filter(|m| evaluation.hold.contains_key(**m)) {
        let _ = writeln!(out, ",{HOLD},,,{spp},0,{metric},{},,,", three(evaluation, evaluation.hold.get(*metric)));
    }
    for table in with_baselines(evaluation) {
        let names = names(&table.space, &table.method, &table.conditioning, &table.cell);
        for at in &table.at {
            for metric in METRICS.iter().filter(|m| at.metrics.contains_key(**m)) {
                let [mean, gain] = [&at.metrics, &at.gain].map(|of| three(evaluation, of.get(*metric)));
                let _ = writeln!(out, "{names},{spp},{},{metric},{mean},{gain}", at.nfe);
            }
        }
    }
    out
}

/// Head of [`versus`].
pub const VERSUS: &str =
    "method,conditioning,cell,nfe,against,against_conditioning,metric,difference,difference_low,difference_high,better";

/// Solvers less methods that are not ours, paired by scene: a row for each pair, NFE and metric.
pub fn versus(evaluation: &Evaluation) -> String {
    let mut out = format!("{VERSUS}\n");
    for of in &evaluation.versus {
        let [method, conditioning] = names_of(evaluation, &of.cell).map(field);
        let own = format!("{method},{conditioning},{},{}", field(&extra(&of.cell)), of.nfe);
        let theirs = of.baseline.get(CONDITIONING).map_or("", String::as_str);
        let theirs = [of.method.as_str(), theirs].map(field).join(",");
        for metric in METRICS.iter().filter(|m| of.gain.contains_key(**m)) {
            let better = of.better.get(*metric).map_or_else(String::new, f64::to_string);
            let _ = writeln!(out, "{own},{theirs},{metric},{},{better}", three(evaluation, of.gain.get(*metric)));
        }
    }
    out
}

/// Head of [`curves`].
pub const CURVES: &str = "space,method,conditioning,cell,metric,auc,auc_low,auc_high,tv,tv_low,tv_high";

/// Summaries of the curves over log NFE.
pub fn curves(evaluation: &Evaluation) -> String {
    let mut out = format!("{CURVES}\n");
    for table in ordered(evaluation) {
        let names = names(&table.space, &table.method, &table.conditioning, &table.cell);
        for metric in METRICS.iter().filter(|m| table.auc.contains_key(**m)) {
            let [auc, tv] = [&table.auc, &table.tv].map(|of| three(evaluation, of.get(*metric)));
            let _ = writeln!(out, "{names},{metric},{auc},{tv}");
        }
    }
    out
}

/// Head of [`per_scene`].
pub const PER_SCENE: &str = "scene,stratum,space,method,conditioning,cell,from_spp,to_spp,nfe,";

/// Every score.
pub fn per_scene(evaluation: &Evaluation) -> String {
    let metrics = computed(evaluation.per_scene.iter().map(|row| &row.score.metrics));
    let mut out = format!("{PER_SCENE}{}\n", metrics.join(","));
    for row in &evaluation.per_scene {
        let get = |axis: &str, default: &'static str| match row.cell.get(axis) {
            Some(value) => value.clone(),
            None if row.cell.is_empty() => String::new(),
            None => default.to_owned(),
        };
        let names = names(&get(SPACE, ""), &row.score.method, &get(CONDITIONING, Conditioning::Rgb.name()), &row.cell);
        let _ = write!(
            out,
            "{},{},{names},{},{},{}",
            field(&row.scene),
            field(&row.stratum),
            row.score.from_spp,
            row.score.to_spp,
            row.score.nfe
        );
        for metric in &metrics {
            let _ = match row.score.metrics.get(metric) {
                Some(value) => write!(out, ",{value}"),
                None => write!(out, ","),
            };
        }
        out.push('\n');
    }
    out
}
