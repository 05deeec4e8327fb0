//! Distances between two sets of feature vectors, whose members may have whole weights: the counts of a bootstrap's
//! draw.
//!
//! Source: unbiased squared MMD with the kernel (x . y/d + 1)^3 (Gretton et al., JMLR 2012; Binkowski et al.,
//! "Demystifying MMD GANs", ICLR 2018, whose KID it is on Inception features); sliced Wasserstein distance (Rabin et
//! al., 2011). Knows no image.

use super::features::{DIMENSIONS, FeatureSet};
use tauflow_data::rng::Stream;

/// Number of directions of the sliced Wasserstein distance.
const DIRECTIONS: usize = 128;
/// Seed of the directions.
const SEED: u64 = 0x736c_6963_6564_5f77;

/// How often each member of a set was drawn.
pub(crate) type Counts = [u32];

/// Kernel values of all pairs of two sets.
pub(crate) struct Gram {
    columns: usize,
    data: Vec<f64>,
}

impl Gram {
    /// The kernel between the members of `a` (rows) and of `b` (columns).
    pub(crate) fn new(FeatureSet(a): &FeatureSet, FeatureSet(b): &FeatureSet) -> Self {
        let kernel = |x: &[f64], y: &[f64]| {
            let product: f64 = x.iter().zip(y).map(|(x, y)| x * y).sum();
            (product / DIMENSIONS as f64 + 1.0).powi(3)
        };
        Self { columns: b.len(), data: a.iter().flat_map(|x| b.iter().map(|y| kernel(x, y))).collect() }
    }

    /// The mean over pairs of members.
    fn mean(&self, rows: &Counts, columns: &Counts) -> f64 {
        let (mut sum, mut pairs) = (0.0, 0.0);
        for (values, row) in self.data.chunks_exact(self.columns).zip(rows).filter(|(_, row)| **row > 0) {
            let (value, weight) = values
                .iter()
                .zip(columns)
                .fold((0.0, 0.0), |(v, w), (value, n)| (v + value * f64::from(*n), w + f64::from(*n)));
            sum += f64::from(*row) * value;
            pairs += f64::from(*row) * weight;
        }
        sum / pairs
    }

    /// The mean over pairs of different members of one set. At least two different ones must be drawn.
    fn mean_of_pairs(&self, counts: &Counts) -> f64 {
        let (mut sum, mut pairs) = (0.0, 0.0);
        for (i, (values, row)) in self.data.chunks_exact(self.columns).zip(counts).enumerate() {
            for (j, (value, column)) in values.iter().zip(counts).enumerate() {
                if i != j {
                    let weight = f64::from(*row) * f64::from(*column);
                    sum += weight * value;
                    pairs += weight;
                }
            }
        }
        sum / pairs
    }
}

/// Squared MMD between a set and the held-out renders.
pub(crate) struct Mmd<'a> {
    own: Gram,
    cross: Gram,
    references: &'a Gram,
}

impl<'a> Mmd<'a> {
    /// Of a set of samples; `among` is the kernel among the references.
    pub(crate) fn new(samples: &FeatureSet, references: &FeatureSet, among: &'a Gram) -> Self {
        Self { own: Gram::new(samples, samples), cross: Gram::new(samples, references), references: among }
    }

    /// The unbiased estimate. Pairs of one member with itself are left out, those of a draw's copies too, so that it
    /// stays unbiased under the bootstrap.
    pub(crate) fn squared(&self, samples: &Counts, references: &Counts) -> f64 {
        self.own.mean_of_pairs(samples) + self.references.mean_of_pairs(references)
            - 2.0 * self.cross.mean(samples, references)
    }
}

/// Sets projected onto fixed random directions, each projection sorted.
pub(crate) struct Slices(Vec<Vec<(f64, usize)>>);

/// Fixed random unit vectors.
pub(crate) fn directions() -> Vec<Vec<f64>> {
    let one = |at: usize| {
        let mut stream = Stream::new(SEED, &[at as u64]);
        let vector: Vec<f64> = (0..DIMENSIONS).map(|_| stream.normal()).collect();
        let length = vector.iter().map(|v| v * v).sum::<f64>().sqrt();
        vector.into_iter().map(|v| v / length).collect()
    };
    (0..DIRECTIONS).map(one).collect()
}

impl Slices {
    /// The projections of a set.
    pub(crate) fn new(FeatureSet(rows): &FeatureSet, directions: &[Vec<f64>]) -> Self {
        let slice = |direction: &Vec<f64>| {
            let project = |(at, row): (usize, &Vec<f64>)| (row.iter().zip(direction).map(|(a, b)| a * b).sum(), at);
            let mut places: Vec<(f64, usize)> = rows.iter().enumerate().map(project).collect();
            places.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            places
        };
        Self(directions.iter().map(slice).collect())
    }

    /// Sliced Wasserstein distance of order 2.
    pub(crate) fn distance(&self, own: &Counts, other: &Self, others: &Counts) -> f64 {
        let total = |counts: &Counts| counts.iter().map(|n| u64::from(*n)).sum::<u64>();
        let (all, all_others) = (total(own), total(others));
        let slices = self.0.iter().zip(&other.0);
        let sum: f64 = slices.map(|(a, b)| transport(a, own, all_others, b, others, all)).sum();
        (sum / (self.0.len() as f64 * all as f64 * all_others as f64)).sqrt()
    }
}

/// Sum over the quantiles of two weighted, sorted rows of the squared difference, each step weighed by its length. The
/// unit of length is one over the product of both totals, so that lengths are whole numbers.
fn transport(
    a: &[(f64, usize)],
    counts_a: &Counts,
    unit_a: u64,
    b: &[(f64, usize)],
    counts_b: &Counts,
    unit_b: u64,
) -> f64 {
    let lengths = |row: &'_ [(f64, usize)], counts: &Counts, unit: u64| -> Vec<(f64, u64)> {
        row.iter().map(|(value, at)| (*value, u64::from(counts[*at]) * unit)).filter(|(_, n)| *n > 0).collect()
    };
    let (a, b) = (lengths(a, counts_a, unit_a), lengths(b, counts_b, unit_b));
    let (mut sum, mut i, mut j) = (0.0, 0, 0);
    let (mut left_a, mut left_b) = (a[0].1, b[0].1);
    loop {
        let step = left_a.min(left_b);
        sum += (a[i].0 - b[j].0).powi(2) * step as f64;
        (left_a, left_b) = (left_a - step, left_b - step);
        if left_a == 0 {
            i += 1;
            let Some(next) = a.get(i) else { return sum };
            left_a = next.1;
        }
        if left_b == 0 {
            j += 1;
            let Some(next) = b.get(j) else { return sum };
            left_b = next.1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows whose every number is drawn from a normal law of this mean.
    fn rows(seed: u64, number: usize, mean: f64) -> FeatureSet {
        let row = |at: usize| {
            let mut stream = Stream::new(seed, &[at as u64]);
            (0..DIMENSIONS).map(|_| mean + stream.normal()).collect()
        };
        FeatureSet((0..number).map(row).collect())
    }

    /// The estimate by its definition, over a list of members with copies.
    fn by_definition(x: &FeatureSet, y: &FeatureSet, drawn_x: &[usize], drawn_y: &[usize]) -> f64 {
        let k =
            |a: &[f64], b: &[f64]| (a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / DIMENSIONS as f64 + 1.0).powi(3);
        let among = |set: &FeatureSet, drawn: &[usize]| {
            let pairs: Vec<f64> = drawn
                .iter()
                .flat_map(|i| drawn.iter().filter(move |j| *j != i).map(move |j| (*i, *j)))
                .map(|(i, j)| k(&set.0[i], &set.0[j]))
                .collect();
            pairs.iter().sum::<f64>() / pairs.len() as f64
        };
        let across: Vec<f64> =
            drawn_x.iter().flat_map(|i| drawn_y.iter().map(move |j| k(&x.0[*i], &y.0[*j]))).collect();
        among(x, drawn_x) + among(y, drawn_y) - 2.0 * across.iter().sum::<f64>() / across.len() as f64
    }

    #[test]
    fn weights_are_copies() {
        let (x, y) = (rows(1, 4, 0.3), rows(2, 3, 0.0));
        let among = Gram::new(&y, &y);
        let mmd = Mmd::new(&x, &y, &among);
        let (slices, others) = (Slices::new(&x, &directions()), Slices::new(&y, &directions()));
        for (counts_x, counts_y) in [([1, 1, 1, 1], [1, 1, 1]), ([2, 0, 1, 1], [0, 1, 2])] {
            let copies = |counts: &[u32]| -> Vec<usize> {
                counts.iter().enumerate().flat_map(|(i, n)| vec![i; *n as usize]).collect()
            };
            let (drawn_x, drawn_y) = (copies(&counts_x), copies(&counts_y));
            let expected = by_definition(&x, &y, &drawn_x, &drawn_y);
            let found = mmd.squared(&counts_x, &counts_y);
            assert!((found / expected - 1.0).abs() < 1e-10, "{found} {expected}");
            let listed = |set: &FeatureSet, drawn: &[usize]| {
                Slices::new(&FeatureSet(drawn.iter().map(|i| set.0[*i].clone()).collect()), &directions())
            };
            let (list_x, list_y) = (listed(&x, &drawn_x), listed(&y, &drawn_y));
            let expected = list_x.distance(&vec![1; drawn_x.len()], &list_y, &vec![1; drawn_y.len()]);
            let found = slices.distance(&counts_x, &others, &counts_y);
            assert!((found / expected - 1.0).abs() < 1e-12, "{found} {expected}");
        }
    }

    #[test]
    fn the_mmd_of_one_law_is_0_on_average() {
        // 60 pairs of sets of one law: the mean of an unbiased estimate is within 4 standard errors of 0.
        let squared = |seed: u64, mean: f64| {
            let (x, y) = (rows(3 * seed, 8, mean), rows(3 * seed + 1, 8, 0.0));
            Mmd::new(&x, &y, &Gram::new(&y, &y)).squared(&[1; 8], &[1; 8])
        };
        let found: Vec<f64> = (0..60).map(|seed| squared(seed, 0.0)).collect();
        let mean = found.iter().sum::<f64>() / 60.0;
        let error = (found.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 59.0 / 60.0).sqrt();
        assert!(mean.abs() < 4.0 * error, "{mean} {error}");
        assert!(squared(0, 0.5) > 10.0 * error && squared(0, 1.0) > squared(0, 0.5));
    }

    #[test]
    fn a_shift_is_as_far_as_it_is_long() {
        // Moved by `by` in each number, projections move by `by` times the sum of the direction's numbers.
        let x = rows(5, 7, 0.0);
        let moved = FeatureSet(x.0.iter().map(|row| row.iter().map(|v| v + 0.25).collect()).collect());
        let along = directions();
        let distance = Slices::new(&x, &along).distance(&[1; 7], &Slices::new(&moved, &along), &[1; 7]);
        let squares = along.iter().map(|d| (0.25 * d.iter().sum::<f64>()).powi(2)).sum::<f64>() / along.len() as f64;
        assert!((distance / squares.sqrt() - 1.0).abs() < 1e-9, "{distance} {squares}");
        assert_eq!(Slices::new(&x, &along).distance(&[1; 7], &Slices::new(&x, &along), &[1; 7]), 0.0);
        // Sets of different sizes: quantiles of 2 against 3 members, by hand.
        let line = |values: &[f64]| -> Vec<(f64, usize)> { values.iter().copied().zip(0..).collect() };
        let sum = transport(&line(&[0.0, 1.0]), &[1, 1], 3, &line(&[0.0, 0.0, 2.0]), &[1, 1, 1], 2);
        // Sixths: 0-0 for 3, 1-0 for 1, 1-2 for 2.
        assert_eq!(sum, 3.0);
    }
}
