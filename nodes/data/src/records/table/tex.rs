//! A score table in LaTeX, for booktabs: one `table` environment for each metric. The best figure of a column is bold.

use super::{AxisValue, ScoreTable};
use crate::{records::higher_is_better, tabular::tex_escape};
use std::fmt::Write as _;

/// Decimals of a metric.
fn digits(metric: &str) -> usize {
    if metric.contains("psnr") { 2 } else { 4 }
}

fn number(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    text.strip_prefix('-').map_or_else(|| text.clone(), |rest| format!("$-${rest}"))
}

/// The values as heads; what has no value is a dash.
fn heads(values: &[AxisValue]) -> impl Iterator<Item = String> {
    values.iter().map(|value| {
        let text = value.to_string();
        if text.is_empty() { "--".to_owned() } else { tex_escape(&text) }
    })
}

/// The tables of all metrics.
pub fn tables(table: &ScoreTable) -> String {
    table.metrics.iter().map(|metric| of(table, metric)).collect::<Vec<_>>().join("\n")
}

fn of(table: &ScoreTable, metric: &str) -> String {
    let (rows, columns) = (table.row_heads(), table.column_heads());
    let (row_axes, column_axes) = table.split_axes();
    let digits = digits(metric);
    let higher = higher_is_better(metric);
    let mean = |row: &[AxisValue], column: &[AxisValue]| {
        let at: Vec<AxisValue> = row.iter().chain(column).cloned().collect();
        table.cell(&at).and_then(|cell| cell.metrics.get(metric)).map(|estimate| number(estimate.mean, digits))
    };
    // Figures that print alike are best together, so the best of a column is found by value and compared as text.
    let best = |column: &[AxisValue]| {
        let found = rows.iter().filter_map(|row| {
            let at: Vec<AxisValue> = row.iter().chain(column).cloned().collect();
            table.cell(&at)?.metrics.get(metric).map(|estimate| estimate.mean)
        });
        found.reduce(|a, b| if (b > a) == higher { b } else { a }).map(|value| number(value, digits))
    };
    let best: Vec<Option<String>> = columns.iter().map(|column| best(column)).collect();
    let arrow = if higher { r"$\uparrow$" } else { r"$\downarrow$" };
    let mut out = String::from("% Needs \\usepackage{booktabs}.\n\\begin{table}\n  \\centering\n");
    let title = if table.title.is_empty() { String::new() } else { format!("{}: ", tex_escape(&table.title)) };
    let _ = writeln!(
        out,
        "  \\caption{{{title}{} {arrow}, mean over {} items. Best in bold.}}",
        tex_escape(metric),
        table.items
    );
    let _ = writeln!(out, "  \\begin{{tabular}}{{{}{}}}", "l".repeat(row_axes.len().max(1)), "r".repeat(columns.len()));
    out.push_str("    \\toprule\n");
    for (place, axis) in column_axes.iter().enumerate() {
        let blank = " & ".repeat(row_axes.len().saturating_sub(1));
        let values: String = columns
            .iter()
            .map(|column| format!(" & {}", heads(&column[place..=place]).next().unwrap_or_default()))
            .collect();
        let _ = writeln!(out, "    {blank}{}{values} \\\\", tex_escape(&axis.name));
    }
    let names: Vec<String> = row_axes.iter().map(|axis| tex_escape(&axis.name)).collect();
    let blank = " & ".repeat(columns.len());
    let single = if column_axes.is_empty() { format!(" & {}", tex_escape(metric)) } else { blank };
    let _ = writeln!(out, "    {}{single} \\\\\n    \\midrule", names.join(" & "));
    for row in &rows {
        let head: Vec<String> = heads(row).collect();
        let _ = write!(out, "    {}", head.join(" & "));
        for (column, best) in columns.iter().zip(&best) {
            let text = mean(row, column);
            let _ = match text {
                Some(text) if rows.len() > 1 && Some(&text) == best.as_ref() => write!(out, " & \\textbf{{{text}}}"),
                Some(text) => write!(out, " & {text}"),
                None => write!(out, " & --"),
            };
        }
        out.push_str(" \\\\\n");
    }
    out.push_str("    \\bottomrule\n  \\end{tabular}\n\\end{table}\n");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_of_a_column_is_bold_and_what_is_not_there_is_a_dash() {
        let text = tables(&super::super::tests::table());
        assert!(text.contains("sobol & \\textbf{22.50} & -- \\\\"), "{text}");
        assert!(text.contains("independent & 20.00 & \\textbf{26.00} \\\\"), "{text}");
        assert!(text.contains("\\caption{Two, samplers: hdr\\_psnr $\\uparrow$"), "{text}");
        // As many columns as the format declares, in every row; also without an axis of rows.
        let mut flat = super::super::tests::table();
        flat.row_axes = 0;
        let flat = tables(&flat);
        assert!(flat.contains("\\begin{tabular}{lrrr}"), "{flat}");
        assert!(flat.lines().filter(|l| l.ends_with("\\\\")).all(|l| l.matches('&').count() == 3), "{flat}");
        for line in text.lines().filter(|line| line.ends_with("\\\\")) {
            assert_eq!(line.matches('&').count(), 2, "{line}");
        }
    }
}
