//! Symmetric matrices of a fixed size, and the quadratic form of a pseudo-inverse. Knows nothing of what they are of.

/// Share of the largest pivot or eigenvalue below which one counts as 0.
const NOTHING: f64 = 1e-12;
/// Sweeps of Jacobi rotations at most; a dozen are enough for any matrix of this size.
const SWEEPS: usize = 60;

/// A symmetric matrix of N rows, all of which are kept.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Symmetric<const N: usize>(Box<[[f64; N]]>);

impl<const N: usize> Symmetric<N> {
    /// Zeros.
    pub(crate) fn zero() -> Self {
        Self(vec![[0.0; N]; N].into())
    }

    /// The product of a column with itself as a row.
    pub(crate) fn of_square(values: &[f64; N]) -> Self {
        let mut out = Self::zero();
        out.add_square(values);
        out
    }

    /// Adds the product of a column with itself as a row.
    pub(crate) fn add_square(&mut self, values: &[f64; N]) {
        for (row, a) in self.0.iter_mut().zip(values) {
            for (to, b) in row.iter_mut().zip(values) {
                *to += a * b;
            }
        }
    }

    /// Adds a multiple of another.
    pub(crate) fn add(&mut self, other: &Self, times: f64) {
        for (row, other) in self.0.iter_mut().zip(&other.0) {
            for (to, value) in row.iter_mut().zip(other) {
                *to += times * value;
            }
        }
    }

    /// Multiplies every element.
    pub(crate) fn scale(&mut self, by: f64) {
        self.0.iter_mut().flatten().for_each(|value| *value *= by);
    }

    /// The lower triangle of its Cholesky factor; none where it is not clearly positive definite.
    fn factor(&self) -> Option<Vec<[f64; N]>> {
        let largest = (0..N).map(|i| self.0[i][i]).fold(0.0, f64::max);
        let mut factor = vec![[0.0; N]; N];
        for i in 0..N {
            for j in 0..=i {
                let known: f64 = (0..j).map(|k| factor[i][k] * factor[j][k]).sum();
                let rest = self.0[i][j] - known;
                if i == j {
                    if rest <= NOTHING * largest {
                        return None;
                    }
                    factor[i][i] = rest.sqrt();
                } else {
                    factor[i][j] = rest / factor[j][j];
                }
            }
        }
        Some(factor)
    }

    /// Eigenvalues with their eigenvectors as columns, by Jacobi rotations.
    fn eigen(&self) -> (Vec<f64>, Vec<[f64; N]>) {
        let mut a = self.0.to_vec();
        let mut vectors: Vec<[f64; N]> = (0..N).map(|i| std::array::from_fn(|j| f64::from(u8::from(i == j)))).collect();
        for _ in 0..SWEEPS {
            let off: f64 = (0..N).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| a[i][j] * a[i][j]).sum();
            let all: f64 = a.iter().flatten().map(|v| v * v).sum();
            if off <= 1e-30 * all {
                break;
            }
            for p in 0..N {
                for q in p + 1..N {
                    rotate(&mut a, &mut vectors, p, q);
                }
            }
        }
        ((0..N).map(|i| a[i][i]).collect(), vectors)
    }
}

/// The rotation that makes the element at (p, q) 0.
fn rotate<const N: usize>(a: &mut [[f64; N]], vectors: &mut [[f64; N]], p: usize, q: usize) {
    if a[p][q] == 0.0 {
        return;
    }
    let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
    let c = 1.0 / (t * t + 1.0).sqrt();
    let s = t * c;
    for row in a.iter_mut().chain(vectors) {
        (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
    }
    // p comes before q.
    let (upper, lower) = a.split_at_mut(q);
    for (above, below) in upper[p].iter_mut().zip(lower[0].iter_mut()) {
        (*above, *below) = (c * *above - s * *below, s * *above + c * *below);
    }
}

/// x^T A^+ x, with the pseudo-inverse of A.
pub(crate) fn form<const N: usize>(of: &Symmetric<N>, x: &[f64; N]) -> f64 {
    if let Some(factor) = of.factor() {
        // A = L L^T: the form is |L^-1 x|^2.
        let mut solved = [0.0; N];
        for i in 0..N {
            let known: f64 = (0..i).map(|k| factor[i][k] * solved[k]).sum();
            solved[i] = (x[i] - known) / factor[i][i];
        }
        return solved.iter().map(|v| v * v).sum();
    }
    let (values, vectors) = of.eigen();
    let largest = values.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    let part = |(at, value): (usize, &f64)| {
        let along: f64 = (0..N).map(|k| vectors[k][at] * x[k]).sum();
        if *value > NOTHING * largest { along * along / value } else { 0.0 }
    };
    values.iter().enumerate().map(part).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::rng::Stream;

    fn random(seed: u64, rank: usize) -> Symmetric<6> {
        let mut stream = Stream::new(seed, &[]);
        let mut out = Symmetric::zero();
        (0..rank).for_each(|_| out.add_square(&std::array::from_fn(|_| stream.normal())));
        out
    }

    fn times(a: &Symmetric<6>, x: &[f64; 6]) -> [f64; 6] {
        std::array::from_fn(|i| (0..6).map(|k| a.0[i][k] * x[k]).sum())
    }

    #[test]
    fn the_form_of_an_inverse_is_that_of_the_image() {
        for rank in [6, 10] {
            let a = random(rank as u64, rank);
            let y = [1.0, -2.0, 0.5, 3.0, 0.25, -1.0];
            // With x = A y the form is y^T A y.
            let x = times(&a, &y);
            let expected: f64 = x.iter().zip(&y).map(|(a, b)| a * b).sum();
            assert!((form(&a, &x) / expected - 1.0).abs() < 1e-9);
            assert!(a.factor().is_some());
        }
    }

    #[test]
    fn directions_that_a_matrix_lacks_count_for_nothing() {
        let a = random(3, 4);
        assert!(a.factor().is_none());
        let y = [1.0, -2.0, 0.5, 3.0, 0.25, -1.0];
        let x = times(&a, &y);
        let expected: f64 = x.iter().zip(&y).map(|(a, b)| a * b).sum();
        assert!((form(&a, &x) / expected - 1.0).abs() < 1e-9);
        // What is added outside of its range changes nothing.
        let (values, vectors) = a.eigen();
        let least = (0..6).min_by(|i, j| values[*i].abs().total_cmp(&values[*j].abs())).expect("six");
        let moved: [f64; 6] = std::array::from_fn(|k| x[k] + 5.0 * vectors[k][least]);
        assert!((form(&a, &moved) / expected - 1.0).abs() < 1e-9);
        assert_eq!(form(&Symmetric::<6>::zero(), &y), 0.0);
    }
}
