//! A score table as CSV (RFC 4180): a column for each axis, then one row for each cell and metric.

use super::{AxisValue, Estimate, ScoreTable};
use crate::{
    records::computed,
    tabular::{csv_estimate, csv_field},
};
use std::fmt::Write as _;

fn axes(table: &ScoreTable) -> String {
    table.axes.iter().map(|axis| format!("{},", csv_field(&axis.name))).collect()
}

fn values(at: &[AxisValue]) -> String {
    at.iter().map(|value| format!("{},", csv_field(&value.to_string()))).collect()
}

/// Means and intervals: one row for each cell and metric. Where there is no interval, its ends are empty.
pub fn cells(table: &ScoreTable) -> String {
    let mut out = format!("{}metric,items,mean,low,high,difference,difference_low,difference_high\n", axes(table));
    for cell in &table.cells {
        for metric in &table.metrics {
            let three = |estimate: Option<&Estimate>| csv_estimate(estimate, cell.has_intervals());
            let (mean, difference) = (three(cell.metrics.get(metric)), three(cell.difference.get(metric)));
            let _ = writeln!(out, "{}{},{},{mean},{difference}", values(&cell.at), csv_field(metric), cell.items);
        }
    }
    out
}

/// Every score: one row for each item and cell, one column for each metric that a score has. An infinite PSNR is `inf`.
/// A stratum that is an axis has one column.
pub fn items(table: &ScoreTable) -> String {
    let own = table.own_stratum();
    let metrics = computed(table.per_item.iter().map(|row| &row.metrics));
    let mut out = format!("item,{}{}{}\n", if own { "stratum," } else { "" }, axes(table), metrics.join(","));
    for row in &table.per_item {
        let scores: Vec<String> =
            metrics.iter().map(|name| row.metrics.get(name).map_or_else(String::new, |v| v.to_string())).collect();
        let _ = writeln!(
            out,
            "{},{}{}{}",
            csv_field(&row.item),
            if own { format!("{},", csv_field(&row.stratum)) } else { String::new() },
            values(&row.at),
            scores.join(",")
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_columns_and_absent_figures_are_empty() {
        let table = super::super::tests::table();
        let text = cells(&table);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "sampler,spp,metric,items,mean,low,high,difference,difference_low,difference_high");
        assert_eq!(lines[1], "independent,4,hdr_psnr,2,20,19,21,,,");
        assert_eq!(lines[3], "sobol,4,hdr_psnr,2,22.5,21.5,23.5,2.5,1.5,3.5");
        let text = items(&table);
        assert_eq!(text.lines().nth(1), Some("L0-open-000001,L0-open,sobol,4,20,21,0.5,22,0.25,0.75"));
    }

    #[test]
    fn one_item_has_no_interval() {
        let mut table = super::super::tests::table();
        table.cells[2].items = 1;
        let text = cells(&table);
        assert_eq!(text.lines().nth(3), Some("sobol,4,hdr_psnr,1,22.5,,,2.5,,"));
    }

    #[test]
    fn a_metric_that_some_scores_have_is_a_column() {
        let mut table = super::super::tests::table();
        let mut other = table.per_item[0].clone();
        other.item = "L0-open-000002".into();
        other.metrics.hdr_flip = Some(0.125);
        table.per_item.push(other);
        let text = items(&table);
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].ends_with(",ssim,hdr_flip"), "{text}");
        assert!(lines[1].ends_with(",0.75,") && lines[2].ends_with(",0.75,0.125"), "{text}");
    }

    #[test]
    fn a_stratum_that_is_an_axis_is_one_column() {
        let mut table = super::super::tests::table();
        table.axes[0].name = "stratum".into();
        let text = items(&table);
        assert!(text.starts_with("item,stratum,spp,hdr_psnr,"), "{text}");
        assert_eq!(text.lines().nth(1), Some("L0-open-000001,sobol,4,20,21,0.5,22,0.25,0.75"));
    }
}
