//! Bridge cases summed up: by stop, method and k, and over all cases of a kind of stop.
//!
//! Knows no image. The fraction of the way is (tau_m - tau_k)/(1 - tau_k) on the training ladder's clock.

use crate::{
    bootstrap::{Resampled, Table},
    groups::Groups,
};
use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
};
use tauflow_contract::KindError;
use tauflow_data::{
    VarianceTime,
    methods::{BridgeMethod, GAUSSIAN, GAUSSIAN_TAU, HOLD, LOCAL_DELTA, LOCAL_STEP, Parameterization},
    records::{Bridge, BridgeCase, BridgeRow, BridgeSummary, Claim, Evidence, Moments, MomentsRow, bounded},
};

/// A scene's cases, each with its fraction, by kind of stop, sample count before, and method.
pub type SceneCases = BTreeMap<(&'static str, u64, String), (f64, BridgeCase)>;

/// The fraction (tau_m - tau_k)/(1 - tau_k) of the way from k to the end of the training ladder.
///
/// # Errors
/// If m is the ladder's last count or beyond, where the fraction is 1 or more.
pub fn fraction(time: VarianceTime, k: u64, m: u64) -> Result<f64, KindError> {
    if m as f64 >= time.n_max() {
        return Err(KindError::Input(format!(
            "the stop {k} -> {m} goes to the end of the training ladder, {} samples, or beyond: its fraction \
             (tau_m - tau_k)/(1 - tau_k) would be 1 or more; train on a longer ladder, or end the bridge's rungs \
             earlier",
            time.n_max()
        )));
    }
    let tau = time.tau(k as f64);
    Ok((time.tau(m as f64) - tau) / (1.0 - tau))
}

/// Columns of a case: its PSNR, and four moments, which are 0 without a reference.
const FIGURES: usize = 5;

fn figures(case: &BridgeCase) -> [f64; FIGURES] {
    let none = Moments { variance: 0.0, real_variance: 0.0, covariance: 0.0, real_covariance: 0.0 };
    let Moments { variance, real_variance, covariance, real_covariance } = case.moments.unwrap_or(none);
    [value(case), variance, real_variance, covariance, real_covariance]
}

/// The first columns of hold and of a method at one stop.
struct Column<'a> {
    stop: &'static str,
    from: u64,
    method: &'a str,
    at: usize,
    hold: usize,
}

/// Finds each case's column and that of hold beside it, and checks that all scenes have the same cases.
fn columns(scenes: &[SceneCases]) -> Result<Vec<Column<'_>>, KindError> {
    let first = scenes.first().filter(|s| !s.is_empty());
    let first = first.ok_or_else(|| KindError::Input("`steps` holds no images to validate".into()))?;
    for scene in scenes {
        let odd = |a: &SceneCases, b: &SceneCases| a.keys().find(|k| !b.contains_key(*k)).cloned();
        if let Some((stop, from, method)) = odd(first, scene).or_else(|| odd(scene, first)) {
            return Err(KindError::Input(format!(
                "not every scene has the {stop} stop from {from} samples by `{method}`; pack all with the same rungs"
            )));
        }
    }
    let keys: Vec<_> = first.keys().collect();
    let mut columns = Vec::with_capacity(keys.len());
    for (at, (stop, from, method)) in keys.iter().enumerate() {
        let hold = keys.iter().position(|k| (k.0, k.1, k.2.as_str()) == (*stop, *from, HOLD)).ok_or_else(|| {
            KindError::Input(format!("`steps` has no image of `{HOLD}` at the {stop} stop from {from} samples"))
        })?;
        columns.push(Column { stop, from: *from, method, at: at * FIGURES, hold: hold * FIGURES });
    }
    Ok(columns)
}

/// Rules that move images in linear radiance only.
const ONE_SPACE: [&str; 3] = [HOLD, GAUSSIAN, GAUSSIAN_TAU];

/// The paper's claims about MC noise at each kind of stop, and comparisons with Euler steps
/// and with a filter that learns nothing; in each space.
///
/// The paper's local step adds the predicted difference to the next rung at each stop: [`LOCAL_DELTA`].
fn claims(columns: &[Column<'_>], setting: &BTreeMap<String, String>, resampled: &Resampled) -> Vec<Claim> {
    let stops: BTreeSet<&str> = columns.iter().map(|c| c.stop).collect();
    let claim = |statement: &str, over: &[&str], (stop, log): (&str, bool)| {
        let of = |rule: &str| -> Vec<usize> {
            let method = BridgeMethod { reference: false, log: log && !ONE_SPACE.contains(&rule), rule }.name();
            columns.iter().filter(|c| (c.stop, c.method) == (stop, method.as_str())).map(|c| c.at).collect()
        };
        let own = of(Parameterization::McNoise.name());
        let above = |rule: &&str| {
            let other = of(rule);
            let mean = |means: &[f64], of: &[usize]| of.iter().map(|at| means[*at]).sum::<f64>() / of.len() as f64;
            (!own.is_empty() && other.len() == own.len()).then(|| Evidence {
                what: format!("over {rule}"),
                metric: "hdr_psnr".into(),
                difference: resampled.estimate(|means| mean(means, &own) - mean(means, &other)),
                draws: None,
            })
        };
        // A claim over several methods says nothing without one of them.
        let evidence = over.iter().map(above).collect::<Option<Vec<Evidence>>>();
        let mut group = setting.clone();
        group.insert("stop".to_owned(), stop.to_owned());
        group.insert("moved_in".to_owned(), BridgeMethod { reference: false, log, rule: HOLD }.space().to_owned());
        crate::claims::claim(statement, &group, evidence, resampled)
    };
    let cases = || stops.iter().flat_map(|stop| [(*stop, false), (*stop, true)]);
    let best = cases()
        .filter_map(|of| claim("Between rungs MC noise is above hold and the local delta", &[HOLD, LOCAL_DELTA], of));
    let euler = cases().filter_map(|of| claim("Between rungs MC noise is above local Euler steps", &[LOCAL_STEP], of));
    let filter = cases()
        .filter_map(|of| claim("Between rungs MC noise is above a Gaussian filter", &[GAUSSIAN, GAUSSIAN_TAU], of));
    best.chain(euler).chain(filter).collect()
}

/// A case's PSNR as it enters means.
fn value(case: &BridgeCase) -> f64 {
    bounded("hdr_psnr", case.psnr)
}

/// Moments of the case whose columns start at `at`; none where real rungs do not vary, or without references.
fn moments(at: usize, resampled: &Resampled) -> Option<MomentsRow> {
    let [variance, real_variance, covariance, real_covariance] = [1, 2, 3, 4].map(|figure| at + figure);
    let column = |column: usize| resampled.estimate(|means| means[column]);
    let excess = |own: usize, real: usize| resampled.estimate(|means| means[own] / means[real] - 1.0);
    (column(real_variance).low > 0.0 && column(real_covariance).low > 0.0).then(|| MomentsRow {
        variance: column(variance),
        real_variance: column(real_variance),
        excess: excess(variance, real_variance),
        covariance: column(covariance),
        real_covariance: column(real_covariance),
        covariance_excess: excess(covariance, real_covariance),
    })
}

/// Sums up the cases of all scenes, which go by these names and are of these groups.
///
/// # Errors
/// If there are none, scenes differ in their stops, or one lacks hold or is of no group.
pub fn summarise(
    scenes: &[SceneCases],
    (names, groups): (&[&str], &Groups),
    (n_max, setting): (u64, &BTreeMap<String, String>),
    resamples: u64,
    seed: u64,
) -> Result<Bridge, KindError> {
    let columns = columns(scenes)?;
    let mut table = Table::new(columns.len() * FIGURES);
    for (scene, name) in scenes.iter().zip(names) {
        let row: Vec<f64> = scene.values().flat_map(|(_, case)| figures(case)).collect();
        table.push(groups.of(name)?, &row);
    }
    let resampled = Resampled::new(&table, resamples as usize, seed)
        .ok_or_else(|| KindError::Input("there are no scenes to validate the bridge on".into()))?;

    let row = |(column, (fraction, case)): (&Column<'_>, &(f64, BridgeCase))| BridgeRow {
        stop: column.stop.to_owned(),
        method: column.method.to_owned(),
        from_spp: column.from,
        to_spp: case.to_spp,
        fraction: *fraction,
        psnr: resampled.estimate(|m| m[column.at]),
        gain: resampled.estimate(|m| m[column.at] - m[column.hold]),
        moments: moments(column.at, &resampled),
    };
    let rows = columns.iter().zip(scenes[0].values()).map(row).collect();

    let mut by_method: BTreeMap<(&str, &str), Vec<&Column<'_>>> = BTreeMap::new();
    for column in &columns {
        by_method.entry((column.stop, column.method)).or_default().push(column);
    }
    let summary = by_method
        .into_iter()
        .map(|((stop, method), of)| {
            let count = of.len() as f64;
            let better = |cases: &[f64]| of.iter().filter(|c| cases[c.at] > cases[c.hold]).count();
            let wins: usize = (0..table.scenes()).map(|scene| better(table.row(scene))).sum();
            BridgeSummary {
                stop: stop.to_owned(),
                method: method.to_owned(),
                cases: (of.len() * table.scenes()) as u64,
                psnr: resampled.estimate(|m| of.iter().map(|c| m[c.at]).sum::<f64>() / count),
                gain: resampled.estimate(|m| of.iter().map(|c| m[c.at] - m[c.hold]).sum::<f64>() / count),
                better: wins as f64 / (count * table.scenes() as f64),
            }
        })
        .collect();
    Ok(Bridge {
        n_max,
        scenes: table.scenes() as u64,
        groups: groups.count(names.iter().copied())?,
        setting: setting.clone(),
        claims: claims(&columns, setting, &resampled),
        rows,
        summary,
        cases: scenes.iter().flat_map(|scene| scene.values().map(|(_, case)| case.clone())).collect(),
    })
}

/// Every case as CSV.
pub fn csv(bridge: &Bridge) -> String {
    let fractions: BTreeMap<(&str, u64), f64> =
        bridge.rows.iter().map(|r| ((r.stop.as_str(), r.from_spp), r.fraction)).collect();
    let mut out = String::from(
        "scene,stop,method,from_spp,to_spp,fraction,psnr,direction,variance,real_variance,covariance,real_covariance\n",
    );
    for case in &bridge.cases {
        let BridgeCase { scene, stop, method, from_spp, to_spp, psnr, direction, moments } = case;
        let fraction = fractions[&(stop.as_str(), *from_spp)];
        let direction = direction.map_or_else(String::new, |d| d.to_string());
        let moments = moments.map_or_else(
            || ",,,".to_owned(),
            |m| format!("{},{},{},{}", m.variance, m.real_variance, m.covariance, m.real_covariance),
        );
        writeln!(out, "{scene},{stop},{method},{from_spp},{to_spp},{fraction},{psnr},{direction},{moments}")
            .expect("a string takes any text");
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fractions_are_those_of_the_training_ladder() {
        let time = VarianceTime::new(1, 512).expect("a ladder");
        // The fraction in counts: (k^-1/2 - m^-1/2)/(k^-1/2 - 512^-1/2).
        let by_hand = |k: f64, m: f64| (k.powf(-0.5) - m.powf(-0.5)) / (k.powf(-0.5) - 512f64.powf(-0.5));
        for (k, m) in [(1, 2), (9, 10), (1, 10), (8, 10)] {
            let found = fraction(time, k, m).expect("inside");
            assert!((found - by_hand(k as f64, m as f64)).abs() < 1e-12 && found > 0.0 && found < 1.0);
        }
        for n_max in [10, 8] {
            let time = VarianceTime::new(1, n_max).expect("a ladder");
            let error = fraction(time, 1, 10).expect_err("fraction 1").to_string();
            assert!(error.contains("1 -> 10") && error.contains("would be 1"), "{error}");
        }
    }
}
