//! Which figure of a column is best and which second, and in what order methods stand. Knows no layout.

use crate::{material::Cell, text::fixed};
use std::collections::BTreeMap;
use tauflow_data::{
    methods::{
        BridgeMethod, Conditioning, EXPECTATION, GAUSSIAN_TAU, HOLD, LOCAL_DELTA, LOCAL_STEP, OIDN, PATH_TRACER,
        PATH_TRACER_SOBOL, Parameterization, STOCHASTIC,
        axes::{CONDITIONING, METHOD, PARAMETERIZATION, SPACE},
    },
    records::{Estimate, Evaluation, MethodTable, higher_is_better},
};

/// Place of a figure in its column.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Rank {
    /// The best; bold.
    Best,
    /// The second best; underlined.
    Second,
    /// Any other.
    #[default]
    Other,
}

/// Ranks a column as it is printed: figures that print alike share a rank. If two or more are best, none is second. A
/// missing figure has no rank, and a column of one has none either.
pub fn rank(column: &[Option<f64>], higher_is_better: bool, digits: usize) -> Vec<Rank> {
    let printed: Vec<Option<String>> =
        column.iter().map(|v| v.filter(|v| !v.is_nan()).map(|v| fixed(v, digits))).collect();
    let mut order: Vec<usize> = (0..column.len()).filter(|i| printed[*i].is_some()).collect();
    let value = |i: usize| column[i].unwrap_or(f64::NAN);
    order.sort_by(|a, b| {
        let by = value(*a).total_cmp(&value(*b));
        if higher_is_better { by.reverse() } else { by }
    });
    let mut ranks = vec![Rank::Other; column.len()];
    let (Some(first), true) = (order.first(), order.len() > 1) else { return ranks };
    let best: Vec<usize> = order.iter().copied().filter(|i| printed[*i] == printed[*first]).collect();
    for i in &best {
        ranks[*i] = Rank::Best;
    }
    if best.len() == 1 {
        let second = order[1];
        for i in order.iter().skip(1).filter(|i| printed[**i] == printed[second]) {
            ranks[*i] = Rank::Second;
        }
    }
    ranks
}

/// A row of the main table: a method or the input itself.
#[derive(Clone, Debug)]
pub struct Row<'a> {
    /// Its table; none for hold.
    pub table: Option<&'a MethodTable>,
    /// One figure for each column: the NFEs, then AUC and TV.
    pub figures: Vec<Option<Estimate>>,
}

/// The rows of a metric: hold, then the methods in order of space, method, conditioning, then baselines.
pub fn rows<'a>(evaluation: &'a Evaluation, metric: &str) -> Vec<Row<'a>> {
    let mut rows = vec![Row {
        table: None,
        // Hold makes no call: it is the same at each NFE, and its curve is flat.
        figures: evaluation
            .nfe
            .iter()
            .map(|_| evaluation.hold.get(metric).copied())
            .chain([evaluation.hold.get(metric).copied(), None])
            .collect(),
    }];
    for table in with_baselines(evaluation) {
        let at = |nfe: &u64| table.at.iter().find(|a| a.nfe == *nfe).and_then(|a| a.metrics.get(metric)).copied();
        let mut figures: Vec<Option<Estimate>> = evaluation.nfe.iter().map(at).collect();
        figures.push(table.auc.get(metric).copied());
        figures.push(table.tv.get(metric).copied());
        rows.push(Row { table: Some(table), figures });
    }
    rows
}

/// Ranks of [`rows`], by row and column. The last column, TV, is better when lower whatever the metric.
pub fn ranks(rows: &[Row<'_>], metric: &str, digits: usize) -> Vec<Vec<Rank>> {
    let columns = rows.first().map_or(0, |r| r.figures.len());
    let by_column: Vec<Vec<Rank>> = (0..columns)
        .map(|c| {
            let higher = higher_is_better(metric) && c + 1 < columns;
            let column: Vec<Option<f64>> = rows.iter().map(|r| r.figures[c].map(|e| e.mean)).collect();
            rank(&column, higher, digits)
        })
        .collect();
    (0..rows.len()).map(|r| by_column.iter().map(|column| column[r]).collect()).collect()
}

/// Methods that differ in the method alone.
#[derive(Clone, Debug)]
pub struct Group<'a> {
    /// Their common label: the conditioning, and other distinguishing params.
    pub title: String,
    /// The same as part of a file name.
    pub slug: String,
    /// The methods, in order.
    pub tables: Vec<&'a MethodTable>,
}

/// The methods by space, conditioning (RGB first) and further coordinates.
pub fn groups(evaluation: &Evaluation) -> Vec<Group<'_>> {
    let many_spaces = evaluation.methods.iter().any(|t| t.space != evaluation.methods[0].space);
    let mut out: BTreeMap<_, Group<'_>> = BTreeMap::new();
    for table in ordered(evaluation) {
        let more = extra(&table.cell);
        let group = out
            .entry((table.space.clone(), conditioning_order(&table.conditioning), more.clone()))
            .or_insert_with(|| {
                let mut names = vec![table.conditioning.clone()];
                names.extend(many_spaces.then(|| format!("{} space", table.space)));
                names.extend(Some(more).filter(|m| !m.is_empty()));
                let fine = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' };
                let slug = names.join("-").chars().map(fine).collect();
                names[0] = conditioning_name(&names[0]);
                Group { title: names.join(", "), slug, tables: Vec::new() }
            });
        group.tables.push(table);
    }
    out.into_values().collect()
}

/// The methods in the order of tables: by space, as in [`Parameterization::ALL`], by conditioning (RGB first).
pub fn ordered(evaluation: &Evaluation) -> Vec<&MethodTable> {
    let mut tables: Vec<&MethodTable> = evaluation.methods.iter().collect();
    tables.sort_by_cached_key(|t| {
        (t.space.clone(), method_order(&t.method), conditioning_order(&t.conditioning), extra(&t.cell))
    });
    tables
}

/// The methods in that order, then those that they are compared with.
pub fn with_baselines(evaluation: &Evaluation) -> Vec<&MethodTable> {
    ordered(evaluation).into_iter().chain(&evaluation.baselines).collect()
}

/// The method and the conditioning of a cell, by its table: a cell may lack the coordinates that say so.
pub fn names_of<'a>(evaluation: &'a Evaluation, cell: &'a Cell) -> [&'a str; 2] {
    let coordinate = |axis: &str| cell.get(axis).map_or("", String::as_str);
    evaluation
        .table_of(cell)
        .map_or_else(|| [PARAMETERIZATION, CONDITIONING].map(coordinate), |table| [&table.method, &table.conditioning])
}

/// The parameterization of this name: none for what is no solver of ours.
pub fn solver(method: &str) -> Option<Parameterization> {
    Parameterization::ALL.into_iter().find(|solver| solver.name() == method)
}

/// Place of a parameterization in the order of tables and colours.
fn place(method: &str) -> Option<usize> {
    Parameterization::ALL.iter().position(|solver| solver.name() == method)
}

/// Order of a method: that of [`Parameterization::ALL`], then by name.
pub fn method_order(method: &str) -> (usize, String) {
    (place(method).unwrap_or(Parameterization::ALL.len()), method.to_owned())
}

/// Order of a conditioning: RGB first.
pub fn conditioning_order(conditioning: &str) -> (bool, String) {
    (conditioning != Conditioning::Rgb.name(), conditioning.to_owned())
}

/// Prefix of the CSS class of a method's colour.
const CLASS: &str = "of-";
/// Colours of the page that methods may have, `m0` and on: those of solvers, then that of OIDN.
pub const COLOURS: usize = 12;

/// CSS class of a method's colour. [`palette`] gives each class on a page a colour of its own.
pub fn colour(method: &str) -> String {
    // Methods of the bridge have the colour of their rule, and its local step is taken by the local velocity.
    let method = BridgeMethod::of(method).rule;
    let method = if method == LOCAL_STEP { Parameterization::LocalVelocity.name() } else { method };
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' };
    CLASS.chars().chain(method.chars().map(plain)).collect()
}

/// The colours of the methods on a page, by class: the known ones have theirs, the others what is left, in order of
/// their names.
pub fn palette(html: &str) -> BTreeMap<String, String> {
    let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let classes: std::collections::BTreeSet<String> = html
        .split("class=\"")
        .skip(1)
        .filter_map(|rest| rest.split('"').next())
        .flat_map(|classes| classes.split(' '))
        .filter(|class| class.starts_with(CLASS) && class.chars().all(is_name))
        .map(str::to_owned)
        .collect();
    let known = |class: &String| {
        let place = Parameterization::ALL.iter().position(|solver| colour(solver.name()) == *class);
        let oidn = (colour(OIDN) == *class).then_some(Parameterization::ALL.len());
        let fixed = place.or(oidn).map(|place| format!("m{place}"));
        fixed
            .or_else(|| (colour(HOLD) == *class).then(|| HOLD.to_owned()))
            .or_else(|| (colour(PATH_TRACER) == *class).then(|| "ink".to_owned()))
    };
    let free = (Parameterization::ALL.len() + 1..COLOURS).map(|place| format!("m{place}"));
    let mut free: Vec<String> = free.collect();
    // With few methods that are not known, colours of solvers that are not on the page are free, too.
    let absent =
        Parameterization::ALL.iter().enumerate().filter(|(_, solver)| !classes.contains(&colour(solver.name())));
    free.extend(absent.map(|(place, _)| format!("m{place}")));
    let mut free = free.into_iter().cycle();
    classes
        .into_iter()
        .map(|class| {
            let own = known(&class).or_else(|| free.next()).unwrap_or_default();
            (class, own)
        })
        .collect()
}

/// A method's name for people.
pub fn method_name(method: &str) -> String {
    let BridgeMethod { rule, log, reference } = BridgeMethod::of(method);
    if log || reference {
        let words = [Some(method_name(rule)), log.then(|| "log1p".into()), reference.then(|| "reference".into())];
        return words.into_iter().flatten().collect::<Vec<String>>().join(", ");
    }
    if let Some(solver) = solver(method) {
        let name = match solver {
            Parameterization::VanillaRf => "Vanilla RF",
            Parameterization::LocalVelocity => "Local velocity",
            Parameterization::McVelocity => "MC velocity",
            Parameterization::McNoise => "MC noise",
        };
        return name.into();
    }
    match method {
        LOCAL_STEP => "Local step".into(),
        LOCAL_DELTA => "Local delta".into(),
        EXPECTATION => "Expectation".into(),
        STOCHASTIC => "Stochastic".into(),
        GAUSSIAN_TAU => "Gaussian, variance time".into(),
        HOLD => "Hold".into(),
        OIDN => "OIDN".into(),
        "mitsuba" => "Mitsuba".into(),
        PATH_TRACER => "Rendering alone".into(),
        PATH_TRACER_SOBOL => "Rendering alone, Sobol'".into(),
        other => other.replace('_', " "),
    }
}

/// A conditioning's name for people.
pub fn conditioning_name(conditioning: &str) -> String {
    match conditioning {
        rgb if rgb == Conditioning::Rgb.name() => "RGB".into(),
        gbuffer if gbuffer == Conditioning::Gbuffer.name() => "G-buffer".into(),
        other => other.replace('_', " "),
    }
}

/// Coordinates beyond the three that tables have columns for, as text; such as `seed 2`.
pub fn extra(cell: &Cell) -> String {
    let rest: Vec<String> = cell
        .iter()
        .filter(|(axis, _)| ![PARAMETERIZATION, CONDITIONING, SPACE, METHOD].contains(&axis.as_str()))
        .map(|(axis, value)| format!("{axis} {value}"))
        .collect();
    rest.join(", ")
}

/// A metric's name for people, with its unit.
pub fn metric_name(metric: &str) -> &str {
    match metric {
        "hdr_psnr" => "HDR PSNR (dB)",
        "hdr_psnr_max" => "HDR PSNR, peak = maximum (dB)",
        "hdr_mae" => "HDR MAE",
        "preview_psnr" => "Preview PSNR (dB)",
        "preview_mae" => "Preview MAE",
        "ssim" => "SSIM",
        "ms_ssim" => "MS-SSIM",
        "flip" => "FLIP",
        "hdr_flip" => "HDR-FLIP",
        "lpips" => "LPIPS",
        other => other,
    }
}

/// Decimals of a metric in tables.
pub fn digits(metric: &str) -> usize {
    if metric.contains("psnr") { 2 } else { 4 }
}

/// A method at one number of calls.
pub struct Standing<'a> {
    /// Its table; none for the input itself.
    pub table: Option<&'a MethodTable>,
    /// Number of calls.
    pub nfe: u64,
    /// Means by metric.
    pub metrics: &'a BTreeMap<String, Estimate>,
    /// Gains over the input by metric; none for the input.
    pub gain: Option<&'a BTreeMap<String, Estimate>>,
}

/// Solvers at this number of calls, baselines and the input, the best mean HDR PSNR first.
pub fn standings(evaluation: &Evaluation, nfe: u64) -> Vec<Standing<'_>> {
    let solvers = ordered(evaluation).into_iter().map(|table| (table, table.at.iter().find(|at| at.nfe == nfe)));
    let others = evaluation.baselines.iter().map(|table| (table, table.at.first()));
    let mut all: Vec<Standing<'_>> = solvers
        .chain(others)
        .filter_map(|(table, at)| {
            let at = at?;
            Some(Standing { table: Some(table), nfe: at.nfe, metrics: &at.metrics, gain: Some(&at.gain) })
        })
        .collect();
    all.push(Standing { table: None, nfe: 0, metrics: &evaluation.hold, gain: None });
    let value = |of: &Standing<'_>| of.metrics.get("hdr_psnr").map_or(f64::NEG_INFINITY, |estimate| estimate.mean);
    all.sort_by(|a, b| value(b).total_cmp(&value(a)));
    all
}

/// The best cell at an NFE by mean HDR PSNR.
pub fn best_at(evaluation: &Evaluation, nfe: u64) -> Option<&MethodTable> {
    let value = |t: &MethodTable| {
        t.at.iter()
            .find(|a| a.nfe == nfe)
            .and_then(|a| a.metrics.get("hdr_psnr"))
            .map(|e| e.mean)
            .filter(|v| !v.is_nan())
    };
    let mut best: Option<(&MethodTable, f64)> = None;
    for table in ordered(evaluation) {
        if let Some(v) = value(table)
            && best.is_none_or(|(_, b)| v > b)
        {
            best = Some((table, v));
        }
    }
    best.map(|(table, _)| table)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn best_and_second_with_ties() {
        let some = |v: &[f64]| v.iter().map(|v| Some(*v)).collect::<Vec<_>>();
        use Rank::{Best, Other, Second};
        assert_eq!(rank(&some(&[1.0, 3.0, 2.0]), true, 2), [Other, Best, Second]);
        assert_eq!(rank(&some(&[1.0, 3.0, 2.0]), false, 2), [Best, Other, Second]);
        // Printed alike: shared, and then nobody is second.
        assert_eq!(rank(&some(&[3.001, 3.002, 2.0]), true, 2), [Best, Best, Other]);
        assert_eq!(rank(&some(&[3.0, 2.001, 2.002]), true, 2), [Best, Second, Second]);
        assert_eq!(rank(&[None, Some(1.0), Some(f64::NAN)], true, 2), [Other; 3]);
        assert_eq!(rank(&some(&[f64::INFINITY, 40.0]), true, 2), [Best, Second]);
    }

    #[test]
    fn every_method_of_a_page_has_a_colour_of_its_own() {
        let names = ["mc_noise", OIDN, "own program", "nlm", "hold", "median", "bilateral", "a\"b"];
        let html: String = names.iter().map(|name| format!("<i class=\"key {}\"></i>", colour(name))).collect();
        let palette = palette(&html);
        assert_eq!(palette.len(), names.len());
        let distinct: std::collections::BTreeSet<&String> = palette.values().collect();
        assert_eq!(distinct.len(), names.len(), "{palette:?}");
        let of = |name: &str| palette[&colour(name)].as_str();
        assert_eq!([of("mc_noise"), of(OIDN), of("hold")], ["m3", "m4", "hold"]);
    }
}
