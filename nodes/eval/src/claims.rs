//! Claims about Monte Carlo Transport Scheduling, each tested against the results.
//!
//! A claim is differences that must be above 0, each with its paired interval over scenes. Cells that differ only in
//! the coordinate `draw` are trainings of the same solver: a difference is the mean over draws, and has an interval
//! over draws, too. Its deviation is pooled over all differences of a claim in the same metric, because single cells
//! have few draws.
//!
//! Knows means by cell, NFE and metric; a claim without the cells that it is about is left out.

use crate::{bootstrap::Resampled, curve::summarise, draws::t_quantile};
use std::collections::BTreeMap;
use tauflow_data::{
    maths::log,
    methods::{
        Conditioning, Parameterization,
        axes::{CONDITIONING, DRAW, METHOD, PARAMETERIZATION},
    },
    records::{Claim, ClaimVerdict, Estimate, Evidence},
};

/// The metrics for claims: PSNR of linear radiance and of previews.
const JUDGED_BY: [&str; 2] = ["hdr_psnr", "preview_psnr"];
/// Network calls at which the local velocity is said to be best.
const BEST_NFE: u64 = 9;
/// A method that is at most so many dB below another one matches it.
const MATCH: f64 = 0.1;
/// Baselines that are networks of this project, and no traditional ones.
const OWN_NETWORKS: [&str; 2] = ["bundled", "untrained"];
/// The metric of shares of settings or numbers of calls.
const SHARE: &str = "share";

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

/// Trainings of a solver that differ only in their draw.
struct Solver<'a> {
    cell: BTreeMap<String, String>,
    nfe: &'a [u64],
    /// Where the columns of each draw start.
    draws: Vec<usize>,
    metrics: &'a [&'static str],
}

/// A figure of a table of means, for one draw.
type Figure<'a> = Box<dyn Fn(&[f64], usize) -> f64 + 'a>;

fn column(metrics: &[&str], metric: &str) -> usize {
    metrics.iter().position(|name| *name == metric).expect("claims are of basic metrics")
}

impl Solver<'_> {
    fn values(&self, means: &[f64], draw: usize, metric: &str) -> Vec<f64> {
        let (at, width, column) = (self.draws[draw], self.metrics.len(), column(self.metrics, metric));
        (0..self.nfe.len()).map(|step| means[at + step * width + column]).collect()
    }

    fn auc<'a>(&'a self, metric: &'static str) -> Figure<'a> {
        Box::new(move |means, draw| summarise(self.nfe, &self.values(means, draw, metric)).map_or(f64::NAN, |c| c.auc))
    }

    fn tv<'a>(&'a self, metric: &'static str) -> Figure<'a> {
        Box::new(move |means, draw| summarise(self.nfe, &self.values(means, draw, metric)).map_or(f64::NAN, |c| c.tv))
    }

    fn value<'a>(&'a self, metric: &'static str, step: usize) -> Figure<'a> {
        Box::new(move |means, draw| self.values(means, draw, metric)[step])
    }

    fn is(&self, own: Parameterization) -> bool {
        self.coordinate(PARAMETERIZATION) == own.name()
    }

    fn coordinate(&self, axis: &str) -> &str {
        self.cell.get(axis).map_or("", String::as_str)
    }
}

fn less<'a>(a: Figure<'a>, b: Figure<'a>) -> Figure<'a> {
    Box::new(move |means, draw| a(means, draw) - b(means, draw))
}

/// A claim before its verdict.
struct Found<'r> {
    resampled: &'r Resampled,
    statement: &'static str,
    group: BTreeMap<String, String>,
    /// Differences, with those of each draw.
    evidence: Vec<(Evidence, Vec<f64>)>,
}

impl Found<'_> {
    /// Adds a figure of some draws that must be above 0.
    fn add(&mut self, what: String, metric: &str, draws: usize, figure: &Figure<'_>) {
        let mean = |means: &[f64]| (0..draws).map(|draw| figure(means, draw)).sum::<f64>() / draws as f64;
        let each = (0..draws).map(|draw| figure(self.resampled.means(), draw)).collect();
        let difference = self.resampled.estimate(mean);
        self.evidence.push((Evidence { what, metric: metric.to_owned(), difference, draws: None }, each));
    }
}

/// Holds all claims against the curves of cells, and of baselines at one NFE.
pub(crate) fn claims(curves: &[Curve<'_>], baselines: &[Curve<'_>], resampled: &Resampled) -> Vec<Claim> {
    let solvers = solvers(curves);
    let mut found: Vec<Found<'_>> = Vec::new();
    for (group, of) in groups(&solvers, &[PARAMETERIZATION]) {
        let start = |statement| Found { resampled, statement, group: group.clone(), evidence: Vec::new() };
        let named = |own: Parameterization| of.iter().copied().find(|solver| solver.is(own));
        let others = |own: Parameterization| of.iter().copied().filter(move |solver| !solver.is(own));
        if let Some(own) = named(Parameterization::McNoise) {
            let (mut best, mut light) =
                (start("MC noise has the best AUC"), start("MC noise has the lowest HDR MAE at most numbers of calls"));
            for metric in JUDGED_BY {
                for other in others(Parameterization::McNoise) {
                    let what = format!("AUC over {}", other.coordinate(PARAMETERIZATION));
                    best.add(what, metric, both(own, other), &less(own.auc(metric), other.auc(metric)));
                }
            }
            let rest: Vec<&Solver<'_>> =
                others(Parameterization::McNoise).filter(|other| other.nfe == own.nfe).collect();
            if !rest.is_empty() {
                let draws = rest.iter().fold(own.draws.len(), |least, other| least.min(other.draws.len()));
                let lowest: Figure<'_> = Box::new(move |means, draw| {
                    let of = |solver: &Solver<'_>| solver.values(means, draw, "hdr_mae");
                    let (ours, theirs) = (of(own), rest.iter().map(|other| of(other)).collect::<Vec<_>>());
                    let ahead = (0..ours.len()).filter(|step| theirs.iter().all(|other| ours[*step] <= other[*step]));
                    ahead.count() as f64 / ours.len() as f64 - 0.5
                });
                light.add("share of NFE with the lowest MAE, less 1/2".into(), SHARE, draws, &lowest);
            }
            let mut even = start("MC noise matches or exceeds traditional baselines");
            for baseline in baselines.iter().filter(|baseline| comparable(own, baseline)) {
                let name = baseline.cell.get(METHOD).or_else(|| baseline.cell.get(PARAMETERIZATION));
                let name = name.map_or("the baseline", String::as_str);
                for metric in JUDGED_BY {
                    for step in ends(own.nfe) {
                        let value = own.value(metric, step);
                        let at = baseline.at + column(baseline.metrics, metric);
                        let above: Figure<'_> = Box::new(move |means, draw| value(means, draw) - means[at] + MATCH);
                        let what = format!("NFE {} over {name}, plus {MATCH} dB", own.nfe[step]);
                        even.add(what, metric, own.draws.len(), &above);
                    }
                }
            }
            found.extend([best, light, even]);
        }
        if let Some(own) = named(Parameterization::McVelocity) {
            let mut calm = start("MC velocity has the lowest TV");
            for metric in JUDGED_BY {
                for other in others(Parameterization::McVelocity) {
                    let what = format!("TV of {} over its own", other.coordinate(PARAMETERIZATION));
                    calm.add(what, metric, both(own, other), &less(other.tv(metric), own.tv(metric)));
                }
            }
            found.push(calm);
        }
        if let Some(own) = named(Parameterization::LocalVelocity) {
            let mut peak = start("Local velocity is best near NFE 9, and poor at few and many");
            let step = nearest(own.nfe, BEST_NFE);
            // Something near 9, with fewer and with more calls: otherwise nothing is known of the claim.
            let near = (2.0 * BEST_NFE as f64 / 3.0..=1.5 * BEST_NFE as f64).contains(&(own.nfe[step] as f64));
            let ends = if near && !ends(own.nfe).contains(&step) { ends(own.nfe) } else { Vec::new() };
            for end in ends {
                for metric in JUDGED_BY {
                    let what = format!("NFE {} over NFE {}", own.nfe[step], own.nfe[end]);
                    peak.add(what, metric, own.draws.len(), &less(own.value(metric, step), own.value(metric, end)));
                }
            }
            found.push(peak);
        }
        if let Some(own) = named(Parameterization::VanillaRf) {
            let mut worse = start("Vanilla rectified flow's HDR MAE grows with NFE");
            let last = own.nfe.len() - 1;
            let what = format!("NFE {} over NFE {}", own.nfe[last], own.nfe[0]);
            let growth = less(own.value("hdr_mae", last), own.value("hdr_mae", 0));
            worse.add(what, "hdr_mae", own.draws.len(), &growth);
            found.push(worse);
        }
    }
    for (group, of) in groups(&solvers, &[PARAMETERIZATION, CONDITIONING]) {
        let mut most = Found {
            resampled,
            statement: "MC velocity has the lowest TV in most settings",
            group,
            evidence: Vec::new(),
        };
        let own: Vec<&Solver<'_>> =
            of.iter().copied().filter(|solver| solver.is(Parameterization::McVelocity)).collect();
        let rivals = |own: &Solver<'_>| -> Vec<&Solver<'_>> {
            let beside = |other: &&&Solver<'_>| {
                other.coordinate(CONDITIONING) == own.coordinate(CONDITIONING)
                    && !other.is(Parameterization::McVelocity)
            };
            of.iter().filter(beside).copied().collect()
        };
        let pairs: Vec<(&Solver<'_>, Vec<&Solver<'_>>)> =
            own.iter().map(|own| (*own, rivals(own))).filter(|(_, rivals)| !rivals.is_empty()).collect();
        if pairs.is_empty() {
            continue;
        }
        let all = pairs.iter().flat_map(|(own, rivals)| rivals.iter().map(move |other| both(own, other)));
        let (draws, settings) = (all.min().unwrap_or(1), pairs.len() * JUDGED_BY.len());
        let lowest: Figure<'_> = Box::new(move |means, draw| {
            let is_lowest = |own: &Solver<'_>, rivals: &[&Solver<'_>], metric: &'static str| {
                let ours = own.tv(metric)(means, draw);
                rivals.iter().all(|other| ours <= other.tv(metric)(means, draw))
            };
            let settings_of = |(own, rivals): &(&Solver<'_>, Vec<&Solver<'_>>)| {
                JUDGED_BY.into_iter().filter(|metric| is_lowest(own, rivals, metric)).count()
            };
            pairs.iter().map(settings_of).sum::<usize>() as f64 / settings as f64 - 0.5
        });
        most.add(format!("share of {settings} settings with the lowest TV, less 1/2"), SHARE, draws, &lowest);
        found.push(most);
    }
    for (group, of) in groups(&solvers, &[CONDITIONING]) {
        let named = |own: Conditioning| of.iter().copied().find(|c| c.coordinate(CONDITIONING) == own.name());
        let Some((with, without)) = named(Conditioning::Gbuffer).zip(named(Conditioning::Rgb)) else { continue };
        let mut richer =
            Found { resampled, statement: "G-buffers are better than RGB alone", group, evidence: Vec::new() };
        for metric in JUDGED_BY {
            let gain = less(with.auc(metric), without.auc(metric));
            richer.add("AUC with over without".into(), metric, both(with, without), &gain);
        }
        found.push(richer);
    }
    // One claim after the other, each in the order of its groups.
    let mut order: Vec<&str> = Vec::new();
    for claim in &found {
        if !order.contains(&claim.statement) {
            order.push(claim.statement);
        }
    }
    found.sort_by_key(|claim| order.iter().position(|statement| *statement == claim.statement));
    over_draws(&mut found);
    let judged = |found: Found<'_>| {
        let evidence = found.evidence.into_iter().map(|(of, _)| of).collect();
        claim(found.statement, &found.group, Some(evidence), found.resampled)
    };
    found.into_iter().filter_map(judged).collect()
}

/// Cells with at least two NFE, of which those that differ only in their draw are one solver.
fn solvers<'a>(curves: &[Curve<'a>]) -> Vec<Solver<'a>> {
    let mut solvers: Vec<Solver<'a>> = Vec::new();
    for curve in curves.iter().filter(|c| c.nfe.len() >= 2 && c.nfe[0] >= 1) {
        let mut cell = curve.cell.clone();
        cell.remove(DRAW);
        match solvers.iter_mut().find(|solver| solver.cell == cell && solver.nfe == curve.nfe) {
            Some(solver) => solver.draws.push(curve.at),
            None => solvers.push(Solver { cell, nfe: curve.nfe, draws: vec![curve.at], metrics: curve.metrics }),
        }
    }
    solvers
}

/// The draws that two solvers have in common.
fn both(a: &Solver<'_>, b: &Solver<'_>) -> usize {
    a.draws.len().min(b.draws.len())
}

/// The first and the last step; one of them where there is one.
fn ends(nfe: &[u64]) -> Vec<usize> {
    let mut ends = vec![0, nfe.len() - 1];
    ends.dedup();
    ends
}

/// Whether a baseline is a traditional one with the same input as a solver.
fn comparable(own: &Solver<'_>, baseline: &Curve<'_>) -> bool {
    let input = |cell: &BTreeMap<String, String>| {
        cell.get(CONDITIONING).cloned().unwrap_or_else(|| Conditioning::Rgb.name().to_owned())
    };
    let is_own = baseline.cell.values().any(|value| OWN_NETWORKS.contains(&value.as_str()));
    input(&own.cell) == input(&baseline.cell) && !is_own
}

/// Adds intervals over draws. The variance of a difference between draws is pooled over those of the same claim and
/// metric.
fn over_draws(found: &mut [Found<'_>]) {
    let mut pooled: BTreeMap<(&str, String), (f64, f64)> = BTreeMap::new();
    for claim in found.iter() {
        for (evidence, each) in &claim.evidence {
            let mean = each.iter().sum::<f64>() / each.len() as f64;
            let squares = each.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>();
            let (sum, freedom) = pooled.entry((claim.statement, evidence.metric.clone())).or_default();
            *sum += squares;
            *freedom += each.len() as f64 - 1.0;
        }
    }
    for claim in found {
        for (evidence, each) in &mut claim.evidence {
            let (squares, freedom) = pooled[&(claim.statement, evidence.metric.clone())];
            if each.len() > 1 {
                let mean = each.iter().sum::<f64>() / each.len() as f64;
                let half = t_quantile(freedom) * (squares / freedom / each.len() as f64).sqrt();
                evidence.draws = Some(Estimate { mean, low: mean - half, high: mean + half });
            }
        }
    }
}

/// A claim with its verdict; none without evidence. Where the figures have no intervals, it is undecided.
pub(crate) fn claim(
    statement: &str,
    group: &BTreeMap<String, String>,
    evidence: Option<Vec<Evidence>>,
    resampled: &Resampled,
) -> Option<Claim> {
    let evidence = evidence.filter(|of| !of.is_empty() && of.iter().all(|e| e.difference.mean.is_finite()))?;
    let verdict = if !resampled.has_intervals() {
        ClaimVerdict::Undecided
    } else if evidence.iter().all(Evidence::is_above) {
        ClaimVerdict::Held
    } else if evidence.iter().any(Evidence::is_below) {
        ClaimVerdict::NotHeld
    } else {
        ClaimVerdict::Undecided
    };
    Some(Claim { statement: statement.to_owned(), group: group.clone(), evidence, verdict })
}

/// Solvers that have some coordinates and differ in these alone.
fn groups<'a, 'c>(solvers: &'a [Solver<'c>], axes: &[&str]) -> BTreeMap<BTreeMap<String, String>, Vec<&'a Solver<'c>>> {
    let mut groups: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for solver in solvers.iter().filter(|solver| axes.iter().all(|axis| solver.cell.contains_key(*axis))) {
        let mut rest = solver.cell.clone();
        rest.retain(|axis, _| !axes.contains(&axis.as_str()));
        groups.entry(rest).or_default().push(solver);
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
        found_at(&NFE, psnr, mae)
    }

    fn found_at(
        nfe: &[u64; 3],
        psnr: impl Fn(Parameterization, Conditioning, usize) -> f64,
        mae: impl Fn(usize) -> f64,
    ) -> Vec<Claim> {
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
            nfe,
            at: i * NFE.len() * BASIC.len(),
            metrics: &BASIC,
        };
        let curves: Vec<Curve<'_>> = cells.iter().enumerate().map(curve).collect();
        claims(&curves, &[], &resampled)
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
        // Five claims for each conditioning, one for both, one for each method.
        assert_eq!(found.len(), 15);
        assert!(found.iter().all(|claim| claim.verdict == ClaimVerdict::Held), "{found:#?}");
        assert_eq!(found[0].statement, "MC noise has the best AUC");
        assert_eq!(found[0].evidence.len(), 6);
        assert!(found.windows(2).filter(|pair| pair[0].statement != pair[1].statement).count() == 6);
    }

    #[test]
    fn a_peak_near_nine_calls_is_claimed_only_where_it_can_be_seen() {
        let claimed = |nfe| {
            let found = found_at(nfe, as_claimed, |step| 0.1 + 0.01 * step as f64);
            found.iter().any(|claim| claim.statement.starts_with("Local velocity"))
        };
        assert!(claimed(&[1, 9, 50]) && claimed(&[1, 6, 20]) && claimed(&[4, 12, 13]));
        // Nothing near nine, or nothing on both sides of it.
        assert!(!claimed(&[1, 2, 4]) && !claimed(&[1, 4, 9]) && !claimed(&[8, 20, 50]) && !claimed(&[1, 4, 20]));
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

    /// Two solvers of some draws, and a baseline: figures of each scene and draw.
    fn drawn(psnr: impl Fn(Parameterization, usize) -> f64, baseline: f64) -> Vec<Claim> {
        let methods = [Parameterization::McNoise, Parameterization::VanillaRf];
        let width = NFE.len() * BASIC.len();
        let mut table = Table::new(6 * width + BASIC.len());
        for scene in 0..20 {
            let wobble = 0.01 * f64::from(scene % 5);
            let mut row = Vec::new();
            for method in methods {
                (0..3).for_each(|draw| row.extend(vec![psnr(method, draw) + wobble; width]));
            }
            row.extend(vec![baseline + wobble; BASIC.len()]);
            table.push(None, &row);
        }
        let resampled = Resampled::new(&table, 200, 1).expect("scenes");
        let cell = |of: &[(&str, &str)]| of.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned())).collect();
        let draws = ["0", "1", "2"];
        let curves: Vec<Curve<'_>> = methods
            .iter()
            .flat_map(|method| draws.map(|draw| cell(&[(PARAMETERIZATION, method.name()), (DRAW, draw)])))
            .enumerate()
            .map(|(i, cell)| Curve { cell, nfe: &NFE, at: i * width, metrics: &BASIC })
            .collect();
        let baseline = |name| Curve { cell: cell(&[("method", name)]), nfe: &NFE[..1], at: 6 * width, metrics: &BASIC };
        claims(&curves, &[baseline("oidn"), baseline("bundled")], &resampled)
    }

    #[test]
    fn a_difference_that_draws_turn_round_is_undecided() {
        let verdict = |found: &[Claim], statement: &str| {
            found.iter().find(|claim| claim.statement.contains(statement)).map(|claim| claim.verdict)
        };
        // Each draw has the same lead.
        let steady = drawn(|method, _| if method == Parameterization::McNoise { 30.0 } else { 29.0 }, 29.95);
        let best = steady.iter().find(|claim| claim.statement.contains("best AUC")).expect("judged");
        assert_eq!((best.verdict, best.group.len()), (ClaimVerdict::Held, 0));
        let draws = best.evidence[0].draws.expect("three draws");
        assert!((draws.mean - 1.0).abs() < 1e-9 && draws.high - draws.low < 1e-9);
        assert_eq!(verdict(&steady, "traditional baselines"), Some(ClaimVerdict::Held));
        // The mean lead is 0.5, but single draws are 3 dB apart: scenes alone would say that it held.
        let lead = [3.5, 0.5, -2.5];
        let shaky = |method, draw: usize| if method == Parameterization::McNoise { 30.0 + lead[draw] } else { 30.0 };
        let found = drawn(shaky, 31.0);
        let best = found.iter().find(|claim| claim.statement.contains("best AUC")).expect("judged");
        assert!(best.evidence.iter().all(|of| of.difference.low > 0.0));
        assert_eq!(best.verdict, ClaimVerdict::Undecided);
        // Deviation 3 of three draws; both metrics are pooled apart: t(2) 3/sqrt 3.
        let draws = best.evidence[0].draws.expect("three draws");
        assert!((draws.high - draws.mean - 4.3027 * 3.0 / 3f64.sqrt()).abs() < 1e-2, "{draws:?}");
        // 0.1 dB below is a match, more is not, and our own networks are no traditional baselines.
        let close = drawn(|_, _| 30.0, 30.05);
        let even = close.iter().find(|claim| claim.statement.contains("traditional")).expect("judged");
        assert_eq!((even.verdict, even.evidence.len()), (ClaimVerdict::Held, 4));
        assert_eq!(verdict(&drawn(|_, _| 30.0, 30.5), "traditional"), Some(ClaimVerdict::NotHeld));
    }
}
