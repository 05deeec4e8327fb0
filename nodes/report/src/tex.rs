//! The main table in LaTeX: space x method x conditioning against NFE, AUC and TV, for booktabs.

use crate::ranking::{Rank, Row, conditioning_name, digits, extra, method_name, metric_name, ranks, rows};
use std::fmt::Write as _;
use tauflow_data::records::{Evaluation, METRICS, higher_is_better};
pub use tauflow_data::tabular::tex_escape as escape;

fn number(value: f64, digits: usize) -> String {
    if value.is_nan() {
        "--".into()
    } else if value.is_infinite() {
        if value > 0.0 { r"$\infty$".into() } else { r"$-\infty$".into() }
    } else {
        let text = crate::text::fixed(value, digits);
        text.strip_prefix('−').map_or_else(|| text.clone(), |rest| format!("$-${rest}"))
    }
}

/// The table of one metric as a `table` environment. Needs the package `booktabs`.
pub fn table(evaluation: &Evaluation, metric: &str) -> String {
    let rows = rows(evaluation, metric);
    let digits = digits(metric);
    let ranks = ranks(&rows, metric, digits);
    let arrow = if higher_is_better(metric) { r"$\uparrow$" } else { r"$\downarrow$" };
    let mut out = String::from("% Needs \\usepackage{booktabs}.\n\\begin{table}\n  \\centering\n");
    let _ = writeln!(
        out,
        "  \\caption{{{} {arrow} at each number of network calls (NFE), mean over {} test scenes from $I_{{{}}}$ \
         against $I_{{{}}}$. AUC and TV $\\downarrow$ over log NFE. Best in bold, second underlined.}}",
        escape(metric_name(metric)),
        evaluation.scenes,
        evaluation.from_spp,
        evaluation.reference_spp
    );
    let _ = writeln!(out, "  \\label{{tab:{}}}", metric.replace('_', "-"));
    let _ = writeln!(out, "  \\begin{{tabular}}{{lll{}}}", "r".repeat(evaluation.nfe.len() + 2));
    let calls: String = evaluation.nfe.iter().map(|n| format!(" & {n}")).collect();
    let _ = writeln!(
        out,
        "    \\toprule\n    & & & \\multicolumn{{{}}}{{c}}{{NFE}} & & \\\\\n    \\cmidrule(lr){{4-{}}}\n    \
         Space & Method & Conditioning{calls} & AUC & TV \\\\\n    \\midrule",
        evaluation.nfe.len(),
        evaluation.nfe.len() + 3
    );
    let mut before: Option<&Row<'_>> = None;
    for (r, row) in rows.iter().enumerate() {
        let space_changes = before.is_some_and(|b| b.table.map(|t| &t.space) != row.table.map(|t| &t.space));
        if space_changes {
            out.push_str("    \\midrule\n");
        }
        let (space, method, conditioning) = head(row, before);
        let _ = write!(out, "    {space} & {method} & {conditioning}");
        for (c, figure) in row.figures.iter().enumerate() {
            let text = figure.map_or_else(|| "--".into(), |e| number(e.mean, digits));
            let _ = match ranks[r][c] {
                Rank::Best => write!(out, " & \\textbf{{{text}}}"),
                Rank::Second => write!(out, " & \\underline{{{text}}}"),
                Rank::Other => write!(out, " & {text}"),
            };
        }
        out.push_str(" \\\\\n");
        before = Some(row);
    }
    out.push_str("    \\bottomrule\n  \\end{tabular}\n\\end{table}\n");
    out
}

/// The three cells that name a row; space and method only where they change.
fn head(row: &Row<'_>, before: Option<&Row<'_>>) -> (String, String, String) {
    let Some(table) = row.table else { return ("--".into(), "Hold".into(), "--".into()) };
    let above = before.and_then(|b| b.table);
    let same_space = above.is_some_and(|a| a.space == table.space);
    let same_method = same_space && above.is_some_and(|a| a.method == table.method);
    let more = extra(&table.cell);
    let conditioning = conditioning_name(&table.conditioning);
    (
        if same_space { String::new() } else { escape(&table.space) },
        if same_method { String::new() } else { escape(&method_name(&table.method)) },
        escape(&if more.is_empty() { conditioning } else { format!("{conditioning}, {more}") }),
    )
}

/// Tables of every metric but the main one.
pub fn others(evaluation: &Evaluation) -> String {
    let tables = METRICS.iter().filter(|m| **m != "hdr_psnr" && evaluation.hold.contains_key(**m));
    tables.map(|m| table(evaluation, m)).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn special_characters_are_escaped() {
        assert_eq!(escape(r"a_b & 5% \x"), r"a\_b \& 5\% \textbackslash{}x");
        assert_eq!(number(-1.25, 1), "$-$1.2");
        assert_eq!(number(f64::INFINITY, 1), r"$\infty$");
    }
}
