//! Two runs compared: params, outputs, metrics, times.

use super::{
    RunOutput, RunRecord,
    metrics::{self, Scores},
};
use crate::{
    engine::EngineError,
    registry::{Paired, Resampled},
};
use serde::Serialize;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use tauflow_cache::Store;
use tauflow_contract::Digest;
use tauflow_data::records::{Estimate, METRICS};

/// Number of bootstrap resamples.
const RESAMPLES: usize = 2000;
/// Seed of the bootstrap: the same runs give the same intervals.
const SEED: u64 = 0;

/// How two runs differ.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Comparison {
    /// Params that differ.
    pub params: Vec<ParamChange>,
    /// Outputs that differ.
    pub outputs: Vec<OutputChange>,
    /// Outputs that are equal.
    pub equal_outputs: u64,
    /// Outputs that only the first run made or needed.
    pub only_before: Vec<String>,
    /// Outputs that only the second run made or needed.
    pub only_after: Vec<String>,
    /// Outputs that cannot be compared, because something failed in one of the runs.
    pub unknown_outputs: Vec<String>,
    /// Rows of the scores, by output.
    pub rows: Vec<RowCounts>,
    /// Metrics over the items that both runs scored.
    pub metrics: Vec<MetricChange>,
    /// Outputs whose scores are all among those of another output, which `metrics` has: the table that reads them.
    pub repeated_metrics: Vec<(String, String)>,
    /// Outputs with scores that were not compared, each with the reason.
    pub without_metrics: Vec<(String, String)>,
    /// Times of the nodes that are in both runs.
    pub times: Vec<TimeChange>,
}

/// A param that differs; none where a run does not have it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParamChange {
    /// `node.param`, or `node[cell].param`.
    pub name: String,
    /// In the first run.
    pub before: Option<Value>,
    /// In the second run.
    pub after: Option<Value>,
}

/// An output of both runs that differs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OutputChange {
    /// `node.port`, or `node[cell].port`.
    pub name: String,
    /// In the first run.
    pub before: Digest,
    /// In the second run.
    pub after: Digest,
    /// Whether its bits are the same on every machine.
    pub bitwise: bool,
}

/// A metric of a figure in both runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MetricChange {
    /// The output that holds it.
    pub output: String,
    /// The row, by its coordinates.
    pub figure: String,
    /// The metric.
    pub metric: String,
    /// Number of items that both runs scored.
    pub items: u64,
    /// Mean over them in the first run.
    pub before: f64,
    /// Mean over them in the second run.
    pub after: f64,
    /// Second less first, paired by item, with its 95% interval.
    pub difference: Estimate,
}

/// How many rows of an output's scores both runs have.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RowCounts {
    /// The output.
    pub output: String,
    /// Rows of both runs with equal scores of equal items.
    pub equal: u64,
    /// Rows of both runs with other scores or other items.
    pub different: u64,
    /// Rows that only the first run has, by their coordinates.
    pub only_before: Vec<String>,
    /// Rows that only the second run has, by their coordinates.
    pub only_after: Vec<String>,
}

impl RowCounts {
    fn of(output: &str, before: &Scores, after: &Scores) -> Self {
        let only = |of: &Scores, other: &Scores| {
            of.keys().filter(|row| !other.contains_key(*row)).map(ToString::to_string).collect::<Vec<_>>()
        };
        let both = before.iter().filter_map(|(row, was)| Some((was, after.get(row)?)));
        let (equal, different): (Vec<_>, Vec<_>) = both.partition(|(was, is)| was == is);
        Self {
            output: output.to_owned(),
            equal: equal.len() as u64,
            different: different.len() as u64,
            only_before: only(before, after),
            only_after: only(after, before),
        }
    }
}

/// The times of a node in both runs, in seconds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TimeChange {
    /// The node.
    pub node: String,
    /// Time that its actions took in the first run itself.
    pub before: f64,
    /// Time that its actions took in the second run itself.
    pub after: f64,
    /// Number of actions that ran, in the first and in the second run.
    pub ran: (u64, u64),
}

/// Compares two runs; the metrics are read from the cache.
///
/// # Errors
/// If the cache cannot be read.
pub fn compare(before: &RunRecord, after: &RunRecord, store: &Store) -> Result<Comparison, EngineError> {
    let mut found = Comparison { params: params(before, after), times: times(before, after), ..Default::default() };
    let names: BTreeSet<&String> = before.outputs.keys().chain(after.outputs.keys()).collect();
    for name in names {
        let (was, is) = (before.outputs.get(name), after.outputs.get(name));
        if [was, is].iter().flatten().all(|output| output.digest.is_none()) {
            found.unknown_outputs.push(name.clone());
            continue;
        }
        let (was, is) = match (was, is) {
            (Some(was), Some(is)) => (was, is),
            (Some(_), None) => {
                found.only_before.push(name.clone());
                continue;
            }
            _ => {
                found.only_after.push(name.clone());
                continue;
            }
        };
        let (Some(a), Some(b)) = (was.digest, is.digest) else {
            found.unknown_outputs.push(name.clone());
            continue;
        };
        if a == b {
            found.equal_outputs += 1;
            continue;
        }
        if metrics::has_scores(was) && was.media == is.media {
            let pair = (scores(store, was, before)?, scores(store, is, after)?);
            match pair {
                (Ok(was), Ok(is)) => {
                    found.rows.push(RowCounts::of(name, &was, &is));
                    found.metrics.extend(paired(name, &was, &is));
                }
                (Err(why), _) | (_, Err(why)) => found.without_metrics.push((name.clone(), why)),
            }
        }
        found.outputs.push(OutputChange { name: name.clone(), before: a, after: b, bitwise: is.bitwise });
    }
    (found.metrics, found.repeated_metrics) = once(found.metrics);
    Ok(found)
}

/// The changes without those outputs whose scores are all in another output, and these with the names of both.
fn once(all: Vec<MetricChange>) -> (Vec<MetricChange>, Vec<(String, String)>) {
    // Equal scores have equal sums; the figures of a table have other names.
    type Facts<'a> = (&'a str, u64, u64, u64, u64);
    let mut facts: BTreeMap<&str, BTreeMap<Facts<'_>, usize>> = BTreeMap::new();
    for change in &all {
        let sums = [change.before, change.after, change.difference.mean].map(f64::to_bits);
        let of = (change.metric.as_str(), change.items, sums[0], sums[1], sums[2]);
        *facts.entry(&change.output).or_default().entry(of).or_default() += 1;
    }
    let size = |name: &str| facts[name].values().sum::<usize>();
    let mut names: Vec<&str> = facts.keys().copied().collect();
    names.sort_by_key(|name| (std::cmp::Reverse(size(name)), *name));
    let (mut kept, mut repeated): (Vec<&str>, Vec<(String, String)>) = Default::default();
    for name in names {
        let within = |other: &&&str| {
            facts[name].iter().all(|(of, count)| facts[**other].get(of).is_some_and(|there| there >= count))
        };
        match kept.iter().find(within) {
            Some(other) => repeated.push((name.to_owned(), (*other).to_owned())),
            None => kept.push(name),
        }
    }
    repeated.sort();
    let kept: BTreeSet<String> = kept.into_iter().map(str::to_owned).collect();
    (all.into_iter().filter(|change| kept.contains(&change.output)).collect(), repeated)
}

/// The scores of a run's output, or why there are none.
fn scores(store: &Store, output: &RunOutput, run: &RunRecord) -> Result<Result<Scores, String>, EngineError> {
    let Some(listed) = &output.listed else {
        return Ok(Err(format!("run {} did not store the scores", run.id)));
    };
    let found = metrics::scores(store, &output.media, listed)?;
    Ok(found.ok_or_else(|| format!("the cache no longer holds the scores of run {}", run.id)))
}

/// The paired differences of every figure and metric that both have.
fn paired(output: &str, before: &Scores, after: &Scores) -> Vec<MetricChange> {
    let mut found = Vec::new();
    for (figure, was) in before {
        let Some(is) = after.get(figure) else { continue };
        for (place, metric) in METRICS.iter().enumerate() {
            let mut table = Paired::new(2);
            for (item, values) in was {
                let pair = is.get(item).and_then(|other| Some([values[place]?, other[place]?]));
                if let Some(pair) = pair.filter(|pair| pair.iter().all(|value| value.is_finite())) {
                    table.push(None, &pair);
                }
            }
            let Some(resampled) = Resampled::new(&table, RESAMPLES, SEED) else { continue };
            found.push(MetricChange {
                output: output.to_owned(),
                figure: figure.to_string(),
                metric: (*metric).to_owned(),
                items: table.scenes() as u64,
                before: resampled.means()[0],
                after: resampled.means()[1],
                difference: resampled.estimate(|means| means[1] - means[0]),
            });
        }
    }
    found
}

/// The params by their paths: `node.group.param`. Lists are values as wholes.
fn flat(record: &RunRecord) -> BTreeMap<String, &Value> {
    fn walk<'v>(name: String, value: &'v Value, out: &mut BTreeMap<String, &'v Value>) {
        match value {
            Value::Object(fields) if !fields.is_empty() => {
                fields.iter().for_each(|(field, value)| walk(format!("{name}.{field}"), value, out));
            }
            _ => drop(out.insert(name, value)),
        }
    }
    let mut out = BTreeMap::new();
    record.params.iter().for_each(|(cell, params)| walk(cell.clone(), params, &mut out));
    out
}

fn params(before: &RunRecord, after: &RunRecord) -> Vec<ParamChange> {
    let (was, is) = (flat(before), flat(after));
    let names: BTreeSet<&String> = was.keys().chain(is.keys()).collect();
    let changed = names.into_iter().filter(|name| was.get(*name) != is.get(*name));
    let value = |of: &BTreeMap<String, &Value>, name: &str| of.get(name).map(|value| (*value).clone());
    changed.map(|name| ParamChange { name: name.clone(), before: value(&was, name), after: value(&is, name) }).collect()
}

fn times(before: &RunRecord, after: &RunRecord) -> Vec<TimeChange> {
    let other = |name: &str| after.nodes.iter().find(|node| node.node == name);
    let both = before.nodes.iter().filter_map(|was| Some((was, other(&was.node)?)));
    both.map(|(was, is)| TimeChange {
        node: was.node.clone(),
        before: was.spent_s,
        after: is.spent_s,
        ran: (was.ran, is.ran),
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runs::metrics::Figure;
    use tauflow_data::records::AxisValue;

    /// A figure of one coordinate.
    fn figure(text: &str) -> Figure {
        let (name, value) = text.split_once('=').expect("name=value");
        Figure::new([(name, AxisValue::parse(value))])
    }

    /// Scores of one figure, the first metric of each item given and the others 0.
    fn scores(of: &str, items: &[(&str, f64)]) -> Scores {
        let row = |value: f64| (0..METRICS.len()).map(|n| Some(if n == 0 { value } else { 0.0 })).collect();
        let items = items.iter().map(|(item, value)| ((*item).to_owned(), row(*value))).collect();
        Scores::from([(figure(of), items)])
    }

    #[test]
    fn differences_are_paired_over_the_items_that_both_runs_scored() {
        // The items differ much from each other, and each gains 0.5: only pairing gives so narrow an interval.
        let before = scores("spp=4", &[("a", 10.0), ("b", 20.0), ("c", 60.0), ("gone", 1000.0), ("x", f64::NAN)]);
        let after = scores("spp=4", &[("a", 10.5), ("b", 20.5), ("c", 60.5), ("new", 0.0), ("x", 1.0)]);
        let found = paired("scores.scores", &before, &after);
        assert_eq!(found.len(), METRICS.len());
        let first = &found[0];
        assert_eq!((first.metric.as_str(), first.items, first.before, first.after), (METRICS[0], 3, 30.0, 30.5));
        let Estimate { mean, low, high } = first.difference;
        assert!([mean, low, high].iter().all(|value| (value - 0.5).abs() < 1e-9), "{:?}", first.difference);
        assert_eq!(paired("scores.scores", &before, &after), found, "the same draws every time");
        assert_eq!(paired("scores.scores", &before, &scores("spp=8", &[("a", 1.0)])), [], "no figure is shared");
    }

    #[test]
    fn rows_that_only_one_run_has_are_told() {
        let both = |other: &str, value: f64| {
            let mut all = scores("spp=1", &[("a", 1.0)]);
            all.extend(scores("spp=4", &[("a", value)]));
            all.extend(scores(other, &[("a", 1.0)]));
            all
        };
        let found = RowCounts::of("table.table", &both("spp=16", 2.0), &both("spp=32", 3.0));
        assert_eq!((found.equal, found.different), (1, 1));
        assert_eq!((found.only_before.len(), found.only_after.len()), (1, 1));
        assert!(found.only_before[0].contains("16") && found.only_after[0].contains("32"), "{found:?}");
    }

    #[test]
    fn scores_that_a_table_repeats_are_compared_once() {
        let change = |output: &str, figure: &str, before: f64| MetricChange {
            output: output.into(),
            figure: figure.into(),
            metric: "ssim".into(),
            items: 3,
            before,
            after: before + 1.0,
            difference: Estimate { mean: 1.0, low: 0.5, high: 1.5 },
        };
        let of_table = [change("table.table", "sampler=a", 1.0), change("table.table", "sampler=b", 2.0)];
        let of_scores =
            [change("scores[sampler=a].scores", "spp=4", 1.0), change("scores[sampler=b].scores", "spp=4", 2.0)];
        let other = change("more.scores", "spp=4", 3.0);
        let (kept, repeated) = once([&of_scores[..], &of_table[..], std::slice::from_ref(&other)].concat());
        assert_eq!(kept, [&of_table[..], &[other]].concat());
        let table = |name: &str| (name.to_owned(), "table.table".to_owned());
        assert_eq!(repeated, [table("scores[sampler=a].scores"), table("scores[sampler=b].scores")]);
    }
}
