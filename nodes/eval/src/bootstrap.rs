//! Paired bootstrap over groups of scenes: 95% percentile intervals of any function of column means.
//!
//! Source: Efron and Tibshirani, "An Introduction to the Bootstrap", 1993, chapter 13; for groups Davison and Hinkley,
//! "Bootstrap Methods and their Application", 1997, section 3.8. Every resample draws groups with replacement and takes
//! all scenes and columns of a drawn group together. Differences between methods are therefore paired, similar scenes
//! do not count as independent, and all figures use the same draws. A mean is over scenes, in resamples as in the
//! table. Knows no metric.

use std::collections::BTreeMap;
use tauflow_data::{records::Estimate, rng::Stream, statistics::quantile};

/// Share of the draws below the interval, and above it.
const TAIL: f64 = 0.025;

/// Figures by scene: one row for each scene, one column for each figure.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    columns: usize,
    data: Vec<f64>,
    /// The scenes of each group, in the order in which groups came.
    groups: Vec<Vec<usize>>,
    /// Places of the groups that have a name.
    named: BTreeMap<String, usize>,
}

impl Table {
    /// A table without rows.
    pub fn new(columns: usize) -> Self {
        Self { columns, data: Vec::new(), groups: Vec::new(), named: BTreeMap::new() }
    }

    /// Adds a scene to the group of this name, or to one of its own.
    ///
    /// # Panics
    /// If the row has another number of columns than the table.
    pub fn push(&mut self, group: Option<&str>, row: &[f64]) {
        assert_eq!(row.len(), self.columns, "a row has as many values as the table has columns");
        let next = self.groups.len();
        let place = group.map_or(next, |name| *self.named.entry(name.to_owned()).or_insert(next));
        if place == next {
            self.groups.push(Vec::new());
        }
        let scene = self.scenes();
        self.groups[place].push(scene);
        self.data.extend_from_slice(row);
    }

    /// Number of scenes.
    pub fn scenes(&self) -> usize {
        self.data.len().checked_div(self.columns).unwrap_or(0)
    }

    /// The row of a scene.
    pub fn row(&self, scene: usize) -> &[f64] {
        &self.data[scene * self.columns..(scene + 1) * self.columns]
    }

    /// Sums of the rows of scenes.
    fn sum(&self, scenes: impl Iterator<Item = usize>) -> Vec<f64> {
        let mut out = vec![0.0; self.columns];
        for scene in scenes {
            add(&mut out, self.row(scene));
        }
        out
    }
}

fn add(sums: &mut [f64], values: &[f64]) {
    for (sum, value) in sums.iter_mut().zip(values) {
        *sum += value;
    }
}

/// The column means of a table, and those of every resample of its groups.
#[derive(Clone, Debug, PartialEq)]
pub struct Resampled {
    means: Vec<f64>,
    draws: Vec<f64>,
    has_intervals: bool,
}

impl Resampled {
    /// Resamples the groups of a table; none if it has no scene.
    pub fn new(table: &Table, resamples: usize, seed: u64) -> Option<Self> {
        let scenes = table.scenes();
        if scenes == 0 {
            return None;
        }
        let mut means = table.sum(0..scenes);
        means.iter_mut().for_each(|sum| *sum /= scenes as f64);
        let groups: Vec<(usize, Vec<f64>)> =
            table.groups.iter().map(|own| (own.len(), table.sum(own.iter().copied()))).collect();
        let mut draws = vec![0.0; table.columns * resamples];
        let mut stream = Stream::new(seed, &[]).part("bootstrap");
        for out in draws.chunks_exact_mut(table.columns) {
            let mut drawn = 0;
            for _ in 0..groups.len() {
                let (scenes, sums) = &groups[stream.below(groups.len())];
                drawn += scenes;
                add(out, sums);
            }
            out.iter_mut().for_each(|sum| *sum /= drawn as f64);
        }
        Some(Self { means, draws, has_intervals: groups.len() > 1 })
    }

    /// Figures that are no means, such as distances between sets, with those of every draw, one draw after the other.
    ///
    /// # Panics
    /// If the draws are of another number of figures.
    pub fn of_draws(figures: Vec<f64>, draws: Vec<f64>) -> Self {
        assert!(draws.len().is_multiple_of(figures.len().max(1)), "each draw has as many figures");
        Self { means: figures, draws, has_intervals: true }
    }

    /// The mean of each column.
    pub fn means(&self) -> &[f64] {
        &self.means
    }

    /// Whether draws can differ: those of a single group are all alike.
    pub fn has_intervals(&self) -> bool {
        self.has_intervals
    }

    /// A function of the column means, with its interval; that of a single group begins and ends at the mean.
    pub fn estimate(&self, of: impl Fn(&[f64]) -> f64) -> Estimate {
        let mean = of(&self.means);
        let mut values: Vec<f64> = self.draws.chunks_exact(self.means.len()).map(&of).collect();
        values.sort_by(f64::total_cmp);
        if values.is_empty() {
            return Estimate { mean, low: mean, high: mean };
        }
        Estimate { mean, low: quantile(&values, TAIL), high: quantile(&values, 1.0 - TAIL) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_cover_the_truth_as_often_as_they_say() {
        // 40 scenes whose figures share a normal part, as scenes do: the mean of column 0 is 1, the paired gain 0.2.
        let trials = 400;
        let (mut mean_covered, mut gain_covered) = (0, 0);
        let (mut mean_width, mut gain_width) = (0.0, 0.0);
        for trial in 0..trials {
            let mut stream = Stream::new(11, &[trial]);
            let mut table = Table::new(2);
            for _ in 0..40 {
                let base = 1.0 + stream.normal();
                table.push(None, &[base, base + 0.2 + 0.1 * stream.normal()]);
            }
            let resampled = Resampled::new(&table, 500, trial).expect("scenes");
            let mean = resampled.estimate(|m| m[0]);
            let gain = resampled.estimate(|m| m[1] - m[0]);
            mean_covered += u32::from(mean.low <= 1.0 && 1.0 <= mean.high);
            gain_covered += u32::from(gain.low <= 0.2 && 0.2 <= gain.high);
            mean_width += (mean.high - mean.low) / trials as f64;
            gain_width += (gain.high - gain.low) / trials as f64;
        }
        // The percentile interval of 40 scenes covers about 93.5%; the standard error over 400 trials is 1.2%.
        for covered in [mean_covered, gain_covered] {
            let share = f64::from(covered) / trials as f64;
            assert!((0.89..=0.98).contains(&share), "{share}");
        }
        // Widths of 2 x 1.96 sigma / sqrt(40), sigma 1 and .1: pairing takes the scenes' own spread out.
        assert!((mean_width / 0.62 - 1.0).abs() < 0.05, "{mean_width}");
        assert!((gain_width / 0.062 - 1.0).abs() < 0.05, "{gain_width}");
    }

    #[test]
    fn the_same_seed_gives_the_same_interval() {
        let mut table = Table::new(1);
        for value in [1.0, 5.0, 2.0, 8.0] {
            table.push(None, &[value]);
        }
        let estimate = |seed| Resampled::new(&table, 200, seed).expect("scenes").estimate(|m| m[0]);
        assert_eq!(estimate(3), estimate(3));
        assert_ne!(estimate(3), estimate(4));
        let e = estimate(3);
        assert!(e.mean == 4.0 && e.low < 4.0 && e.high > 4.0 && e.low >= 1.0 && e.high <= 8.0);
    }

    #[test]
    fn one_scene_or_none() {
        let mut table = Table::new(1);
        assert!(Resampled::new(&table, 10, 0).is_none());
        table.push(None, &[3.0]);
        let e = Resampled::new(&table, 10, 0).expect("a scene").estimate(|m| m[0]);
        assert_eq!((e.mean, e.low, e.high), (3.0, 3.0, 3.0));
        // A group of several scenes has no interval either.
        let mut views = Table::new(1);
        for value in [3.0, 5.0] {
            views.push(Some("content"), &[value]);
            table.push(None, &[value]);
        }
        let resampled = |table: &Table| Resampled::new(table, 10, 0).expect("scenes");
        assert!(!resampled(&views).has_intervals() && resampled(&table).has_intervals());
    }

    /// Mean and width of the interval of the first column.
    fn first(table: &Table) -> (f64, f64) {
        let e = Resampled::new(table, 4000, 5).expect("scenes").estimate(|m| m[0]);
        (e.mean, e.high - e.low)
    }

    #[test]
    fn a_group_of_equal_scenes_counts_as_one_of_them() {
        // 30 contents of 4 views each, all of which have the figures of their content.
        let (mut groups, mut contents, mut plain) = (Table::new(2), Table::new(2), Table::new(2));
        let mut stream = Stream::new(3, &[]);
        for content in 0..30 {
            let row = [stream.normal(), stream.normal()];
            contents.push(None, &row);
            for _ in 0..4 {
                groups.push(Some(&content.to_string()), &row);
                plain.push(None, &row);
            }
        }
        let resampled = |table| Resampled::new(table, 500, 9).expect("scenes");
        for of in [|m: &[f64]| m[0], |m: &[f64]| m[1] - m[0]] {
            let (grouped, single) = (resampled(&groups).estimate(of), resampled(&contents).estimate(of));
            for (a, b) in [(grouped.mean, single.mean), (grouped.low, single.low), (grouped.high, single.high)] {
                assert!((a - b).abs() < 1e-12, "{grouped:?} {single:?}");
            }
        }
        // Four times as many scenes that are no news: an interval over scenes is too narrow by sqrt(4).
        let ((mean, wide), (same, narrow)) = (first(&groups), first(&plain));
        assert!((mean - same).abs() < 1e-12);
        assert!((wide / narrow / 2.0 - 1.0).abs() < 0.1, "{wide} {narrow}");
    }

    #[test]
    fn groups_of_independent_scenes_change_nothing_but_chance() {
        let (mut groups, mut plain) = (Table::new(1), Table::new(1));
        let mut stream = Stream::new(4, &[]);
        for scene in 0..400 {
            let row = [stream.normal()];
            groups.push(Some(&(scene / 2).to_string()), &row);
            plain.push(None, &row);
        }
        let ((_, grouped), (_, alone)) = (first(&groups), first(&plain));
        assert!((grouped / alone - 1.0).abs() < 0.15, "{grouped} {alone}");
    }

    #[test]
    fn means_are_over_scenes_where_groups_differ_in_size() {
        let mut table = Table::new(1);
        for (group, values) in [("a", &[1.0, 1.0, 1.0][..]), ("b", &[5.0])] {
            values.iter().for_each(|value| table.push(Some(group), &[*value]));
        }
        let resampled = Resampled::new(&table, 1000, 1).expect("scenes");
        assert_eq!(resampled.means(), [2.0]);
        // Of two groups a draw has one of them twice, or both: 1, 5 or 2, in a quarter, a quarter and half of them.
        let share = |value: f64| resampled.draws.iter().filter(|d| **d == value).count() as f64 / 1000.0;
        let found = [1.0, 2.0, 5.0].map(share);
        assert!(found.iter().zip([0.25, 0.5, 0.25]).all(|(a, b)| (a - b).abs() < 0.06), "{found:?}");
        assert_eq!(found.iter().sum::<f64>(), 1.0);
    }

    #[test]
    fn intervals_over_groups_cover_the_truth_as_often_as_they_say() {
        // 40 contents of 1 to 5 views that share most of what they are, as views do; the truth is 0.
        let trials = 300;
        let (mut grouped, mut plain) = (0, 0);
        for trial in 0..trials {
            let mut stream = Stream::new(12, &[trial]);
            let (mut groups, mut scenes) = (Table::new(1), Table::new(1));
            for content in 0..40 {
                let shared = stream.normal();
                for _ in 0..1 + stream.below(5) {
                    let row = [shared + 0.3 * stream.normal()];
                    groups.push(Some(&content.to_string()), &row);
                    scenes.push(None, &row);
                }
            }
            let covers = |table: &Table| {
                let e = Resampled::new(table, 300, trial).expect("scenes").estimate(|m| m[0]);
                u32::from(e.low <= 0.0 && 0.0 <= e.high)
            };
            grouped += covers(&groups);
            plain += covers(&scenes);
        }
        let [grouped, plain] = [grouped, plain].map(|covered| f64::from(covered) / trials as f64);
        assert!((0.88..=0.98).contains(&grouped), "{grouped}");
        assert!(plain < 0.8, "{plain}: intervals over scenes promise too much");
    }
}
