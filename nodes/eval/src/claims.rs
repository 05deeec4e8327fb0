//! Claims about Monte Carlo Transport Scheduling, each tested against the results.
//!
//! A claim is differences that must be above 0, each with its paired interval over scenes.
//!
//! Knows means by cell, NFE and metric; a claim without the cells that it is about is left out.

use crate::{bootstrap::Resampled, curve::summarise};
use std::collections::BTreeMap;
use tauflow_data::{
    maths::log,
    methods::{
        Conditioning, Parameterization,
        axes::{CONDITIONING, PARAMETERIZATION},
    },
    records::{Claim, ClaimVerdict, Estimate, Evidence},
};

/// The metrics for claims: PSNR of linear radiance and of previews.
const JUDGED_BY: [&str; 2] = ["hdr_psnr", "preview_psnr"];
/// Network calls at which the local velocity is said to be best.
const BEST_NFE: u64 = 9;

/// A cell's curve: where its columns start in the table of means, with those of one NFE together.
pub(crate) struct Curve<'a> {
    /// Coordinates of the cell.
    pub(crate) cell: BTreeMap<String, String>,
    /// Its NFE, increasing.
    pub(crate) nfe: &'a [u64],
    /// Column of the first metric at the first NFE.
    pub(crate) at: usize,
    /// The metrics of each NFE, in the order of their columns.
    pub(crate) metrics: &'a [&'static str],
}

/// A figure of a table of means.
type Figure<'a> = Box<dyn Fn(&[f64]) -> f64 + 'a>;

impl Curve<'_> {
    fn values(&self, means: &[f64], metric: &str) -> Vec<f64> {
        let column = self.metrics.iter().position(|name| *name == metric).expect("claims are of basic metrics");
        (0..self.nfe.len()).map(|step| means[self.at + step * self.metrics.len() + column]).collect()
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
    for (group, of) in groups(&curves, PARAMETERIZATION) {
        let is = |curve: &Curve<'_>, own: Parameterization| curve.coordinate(PARAMETERIZATION) == own.name();
        let named = |own: Parameterization| of.iter().copied().find(|c| is(c, own));
        let others =
            |own: Parameterization| -> Vec<&Curve<'_>> { of.iter().copied().filter(|c| !is(c, own)).collect() };
        type Better<'a> = &'a dyn Fn(&Curve<'_>, &Curve<'_>, &'static str) -> Estimate;
        let ahead = |name: Parameterization, what: &str, better: Better<'_>| {
            let own = named(name)?;
            let evidence = |metric: &'static str| {
                others(name).into_iter().map(move |other| Evidence {
                    what: what.replace("{}", other.coordinate(PARAMETERIZATION)),
                    metric: metric.to_owned(),
                    difference: better(own, other, metric),
                })
            };
            Some(JUDGED_BY.into_iter().flat_map(evidence).collect::<Vec<_>>())
        };
        let difference = |a: Figure<'_>, b: Figure<'_>| resampled.estimate(|means| a(means) - b(means));
        let best = ahead(Parameterization::McNoise, "AUC over {}", &|own, other, metric| {
            difference(own.auc(metric), other.auc(metric))
        });
        found.extend(claim("MC noise has the best AUC", &group, best));
        let calm = ahead(Parameterization::McVelocity, "TV of {} over its own", &|own, other, metric| {
            difference(other.tv(metric), own.tv(metric))
        });
        found.extend(claim("MC velocity has the lowest TV", &group, calm));
        let peak = named(Parameterization::LocalVelocity).map(|own| {
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
        let worse = named(Parameterization::VanillaRf).map(|own| {
            let last = own.nfe.len() - 1;
            let difference = difference(own.value("hdr_mae", last), own.value("hdr_mae", 0));
            let what = format!("NFE {} over NFE {}", own.nfe[last], own.nfe[0]);
            vec![Evidence { what, metric: "hdr_mae".into(), difference }]
        });
        found.extend(claim("Vanilla rectified flow's HDR MAE grows with NFE", &group, worse));
    }
    for (group, of) in groups(&curves, CONDITIONING) {
        let named = |own: Conditioning| of.iter().copied().find(|c| c.coordinate(CONDITIONING) == own.name());
        let richer = named(Conditioning::Gbuffer).zip(named(Conditioning::Rgb)).map(|(with, without)| {
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
        ClaimVerdict::Held
    } else if evidence.iter().any(|e| e.difference.high < 0.0) {
        ClaimVerdict::NotHeld
    } else {
        ClaimVerdict::Undecided
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
    use tauflow_data::records::BASIC;

    const NFE: [u64; 3] = [1, 9, 50];

    /// Cells of both conditionings, whose PSNR is a function of the method and the step, and whose MAE is one of the
    /// step.
    fn found(psnr: impl Fn(Parameterization, Conditioning, usize) -> f64, mae: impl Fn(usize) -> f64) -> Vec<Claim> {
        let cells: Vec<(Parameterization, Conditioning)> = [Conditioning::Rgb, Conditioning::Gbuffer]
            .into_iter()
            .flat_map(|conditioning| Parameterization::ALL.map(|method| (method, conditioning)))
            .collect();
        let mut table = Table::new(cells.len() * NFE.len() * BASIC.len());
        for scene in 0..20 {
            let wobble = 0.01 * f64::from(scene % 5);
            let figures = cells.iter().flat_map(|(method, conditioning)| {
                let (psnr, mae) = (&psnr, &mae);
                (0..NFE.len()).flat_map(move |step| {
                    BASIC.map(|m| if m == "hdr_mae" { mae(step) } else { psnr(*method, *conditioning, step) } + wobble)
                })
            });
            table.push(None, &figures.collect::<Vec<f64>>());
        }
        let resampled = Resampled::new(&table, 200, 1).expect("scenes");
        let curve = |(i, (method, conditioning)): (usize, &(Parameterization, Conditioning))| Curve {
            cell: [(PARAMETERIZATION, method.name()), (CONDITIONING, conditioning.name())]
                .map(|(a, b)| (a.to_owned(), b.to_owned()))
                .into(),
            nfe: &NFE,
            at: i * NFE.len() * BASIC.len(),
            metrics: &BASIC,
        };
        let curves: Vec<Curve<'_>> = cells.iter().enumerate().map(curve).collect();
        claims(&curves, &resampled)
    }

    fn as_claimed(method: Parameterization, conditioning: Conditioning, step: usize) -> f64 {
        let base = match (method, step) {
            (Parameterization::McNoise, 0 | 2) => 30.2,
            (Parameterization::McNoise, _) => 30.0,
            (Parameterization::LocalVelocity, 1) => 29.0,
            (Parameterization::McVelocity, _) => 29.5,
            _ => 25.0 - step as f64,
        };
        base + if conditioning == Conditioning::Gbuffer { 1.0 } else { 0.0 }
    }

    #[test]
    fn what_is_as_claimed_holds() {
        let found = found(as_claimed, |step| 0.1 + 0.01 * step as f64);
        // Four claims for each conditioning, one for each method.
        assert_eq!(found.len(), 12);
        assert!(found.iter().all(|claim| claim.verdict == ClaimVerdict::Held), "{found:#?}");
        assert_eq!(found[0].statement, "MC noise has the best AUC");
        assert_eq!(found[0].evidence.len(), 6);
        assert!(found.windows(2).filter(|pair| pair[0].statement != pair[1].statement).count() == 4);
    }

    #[test]
    fn what_is_not_is_told() {
        // RGB is better, the MAE falls, the local velocity rises to the end, and two methods have one curve.
        let turned = |method, conditioning, step| match (method, conditioning) {
            (Parameterization::LocalVelocity, _) => 20.0 + step as f64,
            (Parameterization::McVelocity, c) => as_claimed(Parameterization::McNoise, c, step),
            (m, Conditioning::Rgb) => as_claimed(m, Conditioning::Gbuffer, step),
            (m, Conditioning::Gbuffer) => as_claimed(m, Conditioning::Rgb, step),
        };
        let found = found(turned, |step| 0.1 - 0.01 * step as f64);
        let verdict = |statement: &str| {
            let of: Vec<&Claim> = found.iter().filter(|c| c.statement.contains(statement)).collect();
            assert!(!of.is_empty(), "{statement}");
            of.iter().map(|c| c.verdict).collect::<Vec<_>>()
        };
        assert!(verdict("MAE grows").iter().all(|v| *v == ClaimVerdict::NotHeld));
        assert!(verdict("Local velocity").iter().all(|v| *v == ClaimVerdict::NotHeld));
        assert!(verdict("lowest TV").contains(&ClaimVerdict::Undecided), "{found:#?}");
        assert!(verdict("G-buffers").contains(&ClaimVerdict::NotHeld));
    }

    #[test]
    fn the_nearest_number_of_calls_is_by_ratio() {
        assert_eq!((nearest(&[1, 2, 9, 20], 9), nearest(&[1, 6], 9), nearest(&[4, 20], 9)), (2, 1, 1));
    }
}
