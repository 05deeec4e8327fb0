//! The clocks: variance time over a ladder, and the clock of the Monte Carlo SDE.
//!
//! Source: the central limit theorem's 1/sqrt(n) law; definitions in docs/ARCHITECTURE.md.

use crate::DataError;

/// Variance time over a ladder with first and last sample counts n_min < n_max.
///
/// tau(n) = (1/sqrt(n_min) - 1/sqrt(n)) / (1/sqrt(n_min) - 1/sqrt(n_max)), so tau(n_min) = 0 and tau(n_max) = 1. For
/// samples whose error falls with another power, n^-alpha stands for 1/sqrt(n): [`VarianceTime::with_exponent`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VarianceTime {
    n_min: f64,
    n_max: f64,
    exponent: f64,
}

/// The exponent of independent samples: their error falls with n^(-1/2).
pub const INDEPENDENT_EXPONENT: f64 = 0.5;

/// What records that name no exponent have.
pub fn unsaid_exponent() -> f64 {
    INDEPENDENT_EXPONENT
}

/// Whether records leave the exponent away.
pub fn is_unsaid_exponent(exponent: &f64) -> bool {
    *exponent == INDEPENDENT_EXPONENT
}

/// Exponents that a clock may have.
pub const EXPONENTS: std::ops::RangeInclusive<f64> = 0.05..=2.0;

impl VarianceTime {
    /// The clock of a ladder.
    ///
    /// # Errors
    /// Unless 1 <= n_min < n_max.
    pub fn new(n_min: u64, n_max: u64) -> Result<Self, DataError> {
        if n_min < 1 || n_max <= n_min {
            return Err(DataError::Format(format!(
                "variance time needs 1 <= n_min < n_max, but n_min is {n_min} and n_max is {n_max}"
            )));
        }
        Ok(Self { n_min: n_min as f64, n_max: n_max as f64, exponent: INDEPENDENT_EXPONENT })
    }

    /// The clock of the same ladder if its error falls with n^-exponent.
    ///
    /// # Errors
    /// Unless the exponent is from 0.05 to 2. No sampler of this project is beyond; near 0 all samples have one time.
    pub fn with_exponent(self, exponent: f64) -> Result<Self, DataError> {
        if !EXPONENTS.contains(&exponent) {
            return Err(DataError::Format(format!(
                "variance time needs an exponent of the error from {} to {}, but it is {exponent}",
                EXPONENTS.start(),
                EXPONENTS.end()
            )));
        }
        Ok(Self { exponent, ..self })
    }

    /// The exponent alpha of the error, n^-alpha.
    pub fn exponent(&self) -> f64 {
        self.exponent
    }

    /// How many independent samples have the error of `n` samples, in units of the error of one: n^(2 alpha).
    ///
    /// Halves of an Owen-scrambled net are exchangeable, so that Cov(I_n, I_m) = Var(I_m) for powers of two n < m, as
    /// with independent samples. Expectations given a rung therefore have the same form in these numbers. The numbers
    /// are right as far as the error follows the power.
    pub fn independent(&self, n: f64) -> f64 {
        if self.is_of_independent() { n } else { libm::pow(n, 2.0 * self.exponent) }
    }

    /// 1/sqrt(n) of independent samples, and n^-alpha in general.
    fn error(&self, n: f64) -> f64 {
        1.0 / self.independent(n).sqrt()
    }

    fn is_of_independent(&self) -> bool {
        self.exponent == INDEPENDENT_EXPONENT
    }

    fn ends(&self) -> (f64, f64) {
        (self.error(self.n_min), self.error(self.n_max))
    }

    /// tau of a sample count, which may be a fraction.
    pub fn tau(&self, n: f64) -> f64 {
        let (first, last) = self.ends();
        (first - self.error(n)) / (first - last)
    }

    /// The sample count at tau.
    pub fn count(&self, tau: f64) -> f64 {
        let (first, last) = self.ends();
        let root = first - tau * (first - last);
        let independent = 1.0 / (root * root);
        if self.is_of_independent() { independent } else { libm::pow(independent, 0.5 / self.exponent) }
    }

    /// The SDE's clock at tau.
    pub fn sde(&self, tau: f64) -> SdeTime {
        SdeTime::of_count(self.independent(self.count(tau)))
    }

    /// The last sample count, where tau is 1.
    pub fn n_max(&self) -> f64 {
        self.n_max
    }

    /// The first sample count, where tau is 0.
    pub fn n_min(&self) -> f64 {
        self.n_min
    }

    /// The times of a rollout from sample count `n_start` to the end in `steps` steps; `steps + 1` values, the last
    /// exactly 1.
    pub fn grid(&self, n_start: f64, steps: usize, grid: TimeGrid) -> Vec<f64> {
        self.grid_to(n_start, self.n_max, steps, grid)
    }

    /// The times of a rollout from sample count `n_start` to `n_end`; `steps + 1` values, the last exactly the end's.
    pub fn grid_to(&self, n_start: f64, n_end: f64, steps: usize, grid: TimeGrid) -> Vec<f64> {
        let (start, end) = (self.tau(n_start), if n_end == self.n_max { 1.0 } else { self.tau(n_end) });
        (0..=steps)
            .map(|i| {
                let share = i as f64 / steps as f64;
                if i == steps {
                    end
                } else if i == 0 {
                    start
                } else {
                    match grid {
                        TimeGrid::Ladder => self.tau(n_start * libm::pow(n_end / n_start, share)),
                        TimeGrid::Uniform => start + (end - start) * share,
                    }
                }
            })
            .collect()
    }
}

/// How a rollout's times are spread.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TimeGrid {
    /// tau of n_i = n_k (n_max/n_k)^(i/N): at N = log2(n_max/n_k) the real rungs of a dyadic ladder.
    #[default]
    Ladder,
    /// Equal steps of tau.
    Uniform,
}

/// The clock s = 1 - 1/sqrt(n) of the Monte Carlo SDE dY = 2 (mu - Y)/(1-s) ds + sigma sqrt(2 (1-s)) dW;
/// s runs from 0 at one sample towards 1 at infinitely many.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct SdeTime(pub f64);

impl SdeTime {
    /// s of a sample count.
    pub fn of_count(n: f64) -> Self {
        Self(1.0 - 1.0 / n.sqrt())
    }

    /// The sample count at s: (1-s)^-2.
    pub fn count(&self) -> f64 {
        1.0 / ((1.0 - self.0) * (1.0 - self.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_and_the_design_figure() {
        let time = VarianceTime::new(1, 512).expect("a ladder");
        assert_eq!(time.tau(1.0), 0.0);
        assert_eq!(time.tau(512.0), 1.0);
        assert!((time.tau(10.0) - 0.7153).abs() < 1e-3);
        for n in [1.0, 3.0, 10.0, 77.7, 512.0] {
            assert!((time.count(time.tau(n)) - n).abs() < 1e-9 * n);
            assert!((time.sde(time.tau(n)).count() - n).abs() < 1e-9 * n);
        }
        assert!(VarianceTime::new(4, 4).is_err());
    }

    #[test]
    fn a_faster_error_has_the_clock_of_more_independent_samples() {
        let time = VarianceTime::new(1, 512).expect("a ladder").with_exponent(0.75).expect("an exponent");
        assert_eq!((time.tau(1.0), time.tau(512.0)), (0.0, 1.0));
        for n in [1.0f64, 2.0, 10.0, 77.7, 512.0] {
            // Written out: (1 - n^-0.75)/(1 - 512^-0.75).
            let expected = (1.0 - n.powf(-0.75)) / (1.0 - 512f64.powf(-0.75));
            assert!((time.tau(n) - expected).abs() < 1e-12);
            assert!((time.count(time.tau(n)) - n).abs() < 1e-9 * n);
            assert!((time.sde(time.tau(n)).count() - n.powf(1.5)).abs() < 1e-9 * n.powf(1.5));
        }
        let grid = time.grid(1.0, 9, TimeGrid::Ladder);
        assert!((0..10).all(|i| (time.count(grid[i]) - f64::from(1u32 << i)).abs() < 1e-6));
        for refused in [0.0, 1e-17, -0.5, 2.1, f64::NAN, f64::INFINITY] {
            assert!(VarianceTime::new(1, 512).expect("a ladder").with_exponent(refused).is_err());
        }
    }

    #[test]
    fn the_ladder_grid_visits_the_rungs() {
        let time = VarianceTime::new(1, 512).expect("a ladder");
        let grid = time.grid(1.0, 9, TimeGrid::Ladder);
        for (i, tau) in grid.iter().enumerate() {
            assert!((time.count(*tau) - f64::from(1u32 << i)).abs() < 1e-9 * f64::from(1u32 << i));
        }
        assert_eq!(grid.last(), Some(&1.0));
        let uniform = time.grid(4.0, 3, TimeGrid::Uniform);
        assert_eq!(uniform[0], time.tau(4.0));
        assert!((uniform[2] - uniform[1] - (uniform[1] - uniform[0])).abs() < 1e-12);
    }
}
