//! What Monte Carlo Transport Scheduling is said to do, each claim held against the figures at hand: a difference that must be
//! above 0, with its paired interval over scenes.
//!
//! Knows means by cell, NFE and metric; a claim without the cells that it is about is left out.

use crate::{bootstrap::Resampled, curve::summarise};
use std::collections::BTreeMap;
use tauflow_data::{
    maths::log,
    results::{Claim, Estimate, Evidence, METRICS, Verdict},
};

/// What a claim is judged by: peaks of linear radiance, and of what is seen.
const JUDGED_BY: [&str; 2] = ["hdr_psnr", "preview_psnr"];
/// Model calls at which the local velocity is said to be best.
const BEST_NFE: u64 = 9;

/// A cell's curve: where its columns start in the table of means, with those of one NFE together.
pub(crate) struct Curve<'a> {
    /// Coordinates of the cell.
    pub(crate) cell: BTreeMap<String, String>,
    /// Its NFE, increasing.
    pub(crate) nfe: &'a [u64],
    /// Column of the first metric at the first NFE.
    pub(crate) at: usize,
}

/// A figure of a table of means.
type Figure<'a> = Box<dyn Fn(&[f64]) -> f64 + 'a>;

fn column(metric: &str) -> usize {
    METRICS.iter().position(|name| *name == metric).expect("a name of METRICS")
}

impl Curve<'_> {
    fn values(&self, means: &[f64], metric: &str) -> Vec<f64> {
        (0..self.nfe.len()).map(|step| means[self.at + step * METRICS.len() + column(metric)]).collect()
    }

    fn auc<'a>(&'a self, metric: &'static str) -> Figure<'a> {
        Box::new(move |means| summarise(self.nfe, &self.values(means, metric)).map_or(f64::NAN, |c| c.auc))
    }

    fn tv<'a>(&'a self, metric: &'static str) -> Figure<'a> {
        Box::new(move |means| summarise(self.nfe, &self.values(means, metric)).map_or(f64::NAN, |c| c.tv))
    }

    fn value<'a>(&'a self, metric: &'static str, step: usize) -> Figure<'a> {
        Box::new(move |means| self.values(means, metric)[step])
    }

    fn coordinate(&self, axis: &str) -> &str {
        self.cell.get(axis).map_or("", String::as_str)
    }

    /// All coordinates but one.
    fn without(&self, axis: &str) -> BTreeMap<String, String> {
        self.cell.iter().filter(|(name, _)| *name != axis).map(|(a, b)| (a.clone(), b.clone())).collect()
    }
}

/// Holds all claims against the curves of cells.
pub(crate) fn claims(curves: &[Curve<'_>], resampled: &Resampled) -> Vec<Claim> {
    let curves: Vec<&Curve<'_>> = curves.iter().filter(|c| c.nfe.len() >= 2 && c.nfe[0] >= 1).collect();
    let mut found = Vec::new();
    for (group, of) in groups(&curves, "parameterization") {
        let named = |name: &str| of.iter().copied().find(|c| c.coordinate("parameterization") == name);
        let others = |name: &str| -> Vec<&Curve<'_>> {
            of.iter().copied().filter(|c| c.coordinate("parameterization") != name).collect()
        };
        let ahead = |name: &str, what: &str, better: &dyn Fn(&Curve<'_>, &Curve<'_>, &'static str) -> Estimate| {
            let own = named(name)?;
            let evidence = |metric: &'static str| {
                others(name).into_iter().map(move |other| Evidence {
                    what: what.replace("{}", other.coordinate("parameterization")),
                    metric: metric.to_owned(),
                    difference: better(own, other, metric),
                })
            };
            Some(JUDGED_BY.into_iter().flat_map(evidence).collect::<Vec<_>>())
        };
        let difference = |a: Figure<'_>, b: Figure<'_>| resampled.estimate(|means| a(means) - b(means));
        let best =
            ahead("mc_noise", "AUC over {}", &|own, other, metric| difference(own.auc(metric), other.auc(metric)));
        found.extend(claim("MC noise has the best AUC", &group, best));
        let calm = ahead("mc_velocity", "TV of {} over its own", &|own, other, metric| {
            difference(other.tv(metric), own.tv(metric))
        });
        found.extend(claim("MC velocity has the lowest TV", &group, calm));
        let peak = named("local_velocity").map(|own| {
            let step = nearest(own.nfe, BEST_NFE);
            let ends = [0, own.nfe.len() - 1].into_iter().filter(|end| *end != step);
            let evidence = |end: usize| {
                JUDGED_BY.map(|metric| Evidence {
                    what: format!("NFE {} over NFE {}", own.nfe[step], own.nfe[end]),
                    metric: metric.to_owned(),
                    difference: difference(own.value(metric, step), own.value(metric, end)),
                })
            };
            ends.flat_map(evidence).collect()
        });
        found.extend(claim("Local velocity is best near NFE 9, and poor at few and many", &group, peak));
        let worse = named("vanilla_rf").map(|own| {
            let last = own.nfe.len() - 1;
            let difference = difference(own.value("hdr_mae", last), own.value("hdr_mae", 0));
            let what = format!("NFE {} over NFE {}", own.nfe[last], own.nfe[0]);
            vec![Evidence { what, metric: "hdr_mae".into(), difference }]
        });
        found.extend(claim("Vanilla rectified flow's HDR MAE grows with NFE", &group, worse));
    }
    for (group, of) in groups(&curves, "conditioning") {
        let named = |name: &str| of.iter().copied().find(|c| c.coordinate("conditioning") == name);
        let richer = named("gbuffer").zip(named("rgb")).map(|(with, without)| {
            let evidence = |metric: &'static str| {
                let (with, without) = (with.auc(metric), without.auc(metric));
                let difference = resampled.estimate(|means| with(means) - without(means));
                Evidence { what: "AUC with over without".into(), metric: metric.to_owned(), difference }
            };
            JUDGED_BY.map(evidence).to_vec()
        });
        found.extend(claim("G-buffers are better than RGB alone", &group, richer));
    }
    // One claim after the other, each in the order of its groups.
    let mut order: Vec<String> = Vec::new();
    for claim in &found {
        if !order.contains(&claim.statement) {
            order.push(claim.statement.clone());
        }
    }
    found.sort_by_key(|claim| order.iter().position(|statement| *statement == claim.statement));
    found
}

/// A claim with its verdict; none without evidence.
pub(crate) fn claim(
    statement: &str,
    group: &BTreeMap<String, String>,
    evidence: Option<Vec<Evidence>>,
) -> Option<Claim> {
    let evidence = evidence.filter(|of| !of.is_empty() && of.iter().all(|e| e.difference.mean.is_finite()))?;
    let verdict = if evidence.iter().all(|e| e.difference.low > 0.0) {
        Verdict::Held
    } else if evidence.iter().any(|e| e.difference.high < 0.0) {
        Verdict::NotHeld
    } else {
        Verdict::Undecided
    };
    Some(Claim { statement: statement.to_owned(), group: group.clone(), evidence, verdict })
}

/// Curves that differ in one coordinate alone.
fn groups<'a, 'c>(curves: &[&'a Curve<'c>], axis: &str) -> BTreeMap<BTreeMap<String, String>, Vec<&'a Curve<'c>>> {
    let mut groups: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for curve in curves.iter().filter(|c| c.cell.contains_key(axis)) {
        groups.entry(curve.without(axis)).or_default().push(*curve);
    }
    groups
}

/// Where the number nearest in its logarithm stands.
fn nearest(nfe: &[u64], to: u64) -> usize {
    let off = |n: u64| (log(n as f64) - log(to as f64)).abs();
    (0..nfe.len()).min_by(|a, b| off(nfe[*a]).total_cmp(&off(nfe[*b]))).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bootstrap::Table;

    const NFE: [u64; 3] = [1, 9, 50];

    /// Cells of both conditionings whose figures at each NFE are given by method, the same for PSNRs, with MAE the last number.
    fn found(psnr: impl Fn(&str, &str, usize) -> f64, mae: impl Fn(usize) -> f64) -> Vec<Claim> {
        let methods = ["local_velocity", "mc_noise", "mc_velocity", "vanilla_rf"];
        let cells: Vec<(&str, &str)> = ["rgb", "gbuffer"].into_iter().flat_map(|c| methods.map(|m| (m, c))).collect();
        let mut table = Table::new(cells.len() * NFE.len() * METRICS.len());
        for scene in 0..20 {
            let wobble = 0.01 * f64::from(scene % 5);
            let figures = cells.iter().flat_map(|(method, conditioning)| {
                let (psnr, mae) = (&psnr, &mae);
                (0..NFE.len()).flat_map(move |step| {
                    METRICS.map(|m| if m == "hdr_mae" { mae(step) } else { psnr(method, conditioning, step) } + wobble)
                })
            });
            table.push(&figures.collect::<Vec<f64>>());
        }
        let resampled = Resampled::new(&table, 200, 1).expect("scenes");
        let curve = |(i, (method, conditioning)): (usize, &(&str, &str))| Curve {
            cell: [("parameterization", *method), ("conditioning", *conditioning)]
                .map(|(a, b)| (a.to_owned(), b.to_owned()))
                .into(),
            nfe: &NFE,
            at: i * NFE.len() * METRICS.len(),
        };
        let curves: Vec<Curve<'_>> = cells.iter().enumerate().map(curve).collect();
        claims(&curves, &resampled)
    }

    fn as_claimed(method: &str, conditioning: &str, step: usize) -> f64 {
        let base = match (method, step) {
            ("mc_noise", 0 | 2) => 30.2,
            ("mc_noise", _) => 30.0,
            ("local_velocity", 1) => 29.0,
            ("mc_velocity", _) => 29.5,
            _ => 25.0 - step as f64,
        };
        base + if conditioning == "gbuffer" { 1.0 } else { 0.0 }
    }

    #[test]
    fn what_is_as_claimed_holds() {
        let found = found(as_claimed, |step| 0.1 + 0.01 * step as f64);
        // Four claims for each conditioning, one for each method.
        assert_eq!(found.len(), 12);
        assert!(found.iter().all(|claim| claim.verdict == Verdict::Held), "{found:#?}");
        assert_eq!(found[0].statement, "MC noise has the best AUC");
        assert_eq!(found[0].evidence.len(), 6);
        assert!(found.windows(2).filter(|pair| pair[0].statement != pair[1].statement).count() == 4);
    }

    #[test]
    fn what_is_not_is_told() {
        // RGB is better, the MAE falls, the local velocity rises to the end, and two methods have one curve.
        let turned = |method: &str, conditioning: &str, step: usize| match (method, conditioning) {
            ("local_velocity", _) => 20.0 + step as f64,
            ("mc_velocity", c) => as_claimed("mc_noise", c, step),
            (m, "rgb") => as_claimed(m, "gbuffer", step),
            (m, _) => as_claimed(m, "rgb", step),
        };
        let found = found(turned, |step| 0.1 - 0.01 * step as f64);
        let verdict = |statement: &str| {
            let of: Vec<&Claim> = found.iter().filter(|c| c.statement.contains(statement)).collect();
            assert!(!of.is_empty(), "{statement}");
            of.iter().map(|c| c.verdict).collect::<Vec<_>>()
        };
        assert!(verdict("MAE grows").iter().all(|v| *v == Verdict::NotHeld));
        assert!(verdict("Local velocity").iter().all(|v| *v == Verdict::NotHeld));
        assert!(verdict("lowest TV").contains(&Verdict::Undecided), "{found:#?}");
        assert!(verdict("G-buffers").contains(&Verdict::NotHeld));
    }

    #[test]
    fn the_nearest_number_of_calls_is_by_ratio() {
        assert_eq!((nearest(&[1, 2, 9, 20], 9), nearest(&[1, 6], 9), nearest(&[4, 20], 9)), (2, 1, 1));
    }
}
