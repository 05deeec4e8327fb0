//! The variance law in the network's head: the expectation of a target, as a fraction of the way from the state to the
//! converged image. Knows no network.
//!
//! Given I_n, the expectation of I_m with m > n is the fraction 1 - n/m of the way to the converged image, because I_m
//! contains the samples of I_n. In general the fraction is -Cov(target, state)/Var(state), with Var I_n = s^2/n and
//! Cov(I_n, I_m) = s^2/max(n, m). Where the error falls with another power of n, n stands for as many independent
//! samples as have that error ([`VarianceTime::independent`]).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_data::{
    DataError, maths,
    methods::Parameterization,
    time::{INDEPENDENT_EXPONENT, VarianceTime},
};

/// Known factor of targets in the network's head.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Law {
    /// The covariances of the states, exact on every rung of the training ladder.
    #[default]
    Covariances,
    /// Approximations of earlier versions: the limit of small steps for `local_velocity`, and 1/(1 - t), at most 16,
    /// for `vanilla_rf`.
    Limits,
}

impl Law {
    /// The value of older files, which lack this field, independent of the current default.
    pub(crate) fn unsaid() -> Self {
        Self::Limits
    }

    /// True of files that do not mention it.
    pub(crate) fn is_unsaid(&self) -> bool {
        *self == Self::unsaid()
    }

    /// Its name in pipelines.
    pub fn name(self) -> &'static str {
        match self {
            Self::Covariances => "covariances",
            Self::Limits => "limits",
        }
    }

    /// Whether both give different factors for a parameterization.
    pub(crate) fn matters(parameterization: Parameterization) -> bool {
        matches!(parameterization, Parameterization::LocalVelocity | Parameterization::VanillaRf)
    }
}

/// Largest factor of `vanilla_rf` in [`Law::Limits`].
const STEEPEST: f64 = 16.0;

/// The factors of a parameterization on a ladder.
#[derive(Clone, Debug, PartialEq)]
pub struct Factors {
    parameterization: Parameterization,
    law: Law,
    clock: VarianceTime,
    /// For each rung but the last: log n, and the ratio of the error at the next rung to its own, sqrt(n/next).
    steps: Vec<(f64, f64)>,
}

impl Factors {
    /// The factors on a ladder with these sample counts.
    ///
    /// # Errors
    /// If the counts are no ladder.
    pub fn new(parameterization: Parameterization, counts: &[u64], law: Law) -> Result<Self, DataError> {
        let (first, last) = (counts.first().copied().unwrap_or(0), counts.last().copied().unwrap_or(0));
        let step = |pair: &[u64]| {
            let (n, next) = (pair[0] as f64, pair[1] as f64);
            (maths::log(n), (n / next).sqrt())
        };
        let clock = VarianceTime::new(first, last)?;
        Ok(Self { parameterization, law, clock, steps: counts.windows(2).map(step).collect() })
    }

    /// The factors on the same ladder if its error falls with n^-exponent.
    ///
    /// # Errors
    /// As [`VarianceTime::with_exponent`].
    pub fn with_exponent(mut self, exponent: f64) -> Result<Self, DataError> {
        let clock = self.clock.with_exponent(exponent)?;
        if exponent != self.clock.exponent() {
            // Ratios of errors are those of other independent samples.
            let power = exponent / self.clock.exponent();
            self.steps.iter_mut().for_each(|(_, ratio)| *ratio = libm::pow(*ratio, power));
        }
        Ok(Self { clock, ..self })
    }

    /// The parameterization.
    pub fn parameterization(&self) -> Parameterization {
        self.parameterization
    }

    /// The clock of the ladder.
    pub fn clock(&self) -> VarianceTime {
        self.clock
    }

    /// The sample count that a local velocity at `count` samples points to: the next rung, and between rungs a ratio
    /// between those of its neighbours.
    pub fn next(&self, count: f64) -> f64 {
        let ratio = self.ratio(count);
        let exponent = self.clock.exponent();
        let steps = if exponent == INDEPENDENT_EXPONENT { ratio * ratio } else { libm::pow(ratio, 1.0 / exponent) };
        count / steps
    }

    /// The factor at a time: variance time, or t of an interpolant. If the sample count is unknown, all of the way is
    /// left.
    ///
    /// With u = 1/sqrt(first) - 1/sqrt(last), 1 - tau = (1/sqrt n - 1/sqrt(last))/u. A velocity to m samples is
    /// therefore the fraction (1 - n/m)/(tau_m - tau_n) = u sqrt n (1 + sqrt(n/m)), also where both vanish.
    ///
    /// An interpolant (1 - t) I_first + t I_last has the variance s^2 ((1 - t)^2/first + (1 - (1 - t)^2)/last), and the
    /// covariance -s^2 (1 - t)(1/first - 1/last) with I_last - I_first.
    pub fn at(&self, tau: Option<f64>) -> f64 {
        let Some(tau) = tau else { return -1.0 };
        let clock = &self.clock;
        let samples = clock.count(tau);
        let [count, first, last] = [samples, clock.n_min(), clock.n_max()].map(|n| clock.independent(n));
        let unit = 1.0 / first.sqrt() - 1.0 / last.sqrt();
        match (self.parameterization, self.law) {
            (Parameterization::McNoise, _) => -(1.0 - (count / last).min(1.0)),
            (Parameterization::McVelocity, _) => unit * count.sqrt() * (1.0 + (count / last).sqrt()),
            (Parameterization::LocalVelocity, Law::Covariances) => unit * count.sqrt() * (1.0 + self.ratio(samples)),
            (Parameterization::LocalVelocity, Law::Limits) => unit * count.sqrt() * 2.0,
            (Parameterization::VanillaRf, Law::Covariances) => {
                let (rest, share) = ((1.0 - tau).clamp(0.0, 1.0), first / last);
                rest * (1.0 - share) / (rest * rest + (1.0 - rest * rest) * share)
            }
            (Parameterization::VanillaRf, Law::Limits) => (1.0 / (1.0 - tau).max(1e-9)).min(STEEPEST),
        }
    }

    /// The error of the next rung divided by that at a sample count: linear in log n between rungs, and beyond the last
    /// step that of the last step.
    fn ratio(&self, count: f64) -> f64 {
        let log = maths::log(count);
        let after = self.steps.partition_point(|(at, _)| *at <= log);
        match (after.checked_sub(1).map(|before| self.steps[before]), self.steps.get(after).copied()) {
            (Some((a, low)), Some((b, high))) => low + (high - low) * (log - a) / (b - a),
            (Some((_, ratio)), None) | (None, Some((_, ratio))) => ratio,
            (None, None) => 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-6 * b.abs().max(1.0), "{a} {b}");
    }

    #[test]
    fn factors_are_those_of_the_law() {
        let dyadic: Vec<u64> = (0..=8).map(|i| 1 << i).collect();
        let at = |parameterization, tau| {
            Factors::new(parameterization, &dyadic, Law::Covariances).expect("a ladder").at(Some(tau))
        };
        let clock = VarianceTime::new(1, 256).expect("a ladder");
        for n in [1.0f64, 4.0, 100.0, 255.0] {
            let tau = clock.tau(n);
            near(at(Parameterization::McNoise, tau), n / 256.0 - 1.0);
            // The same way by the time that is left.
            near(at(Parameterization::McVelocity, tau), (1.0 - n / 256.0) / (1.0 - tau));
        }
        for n in [1.0f64, 4.0, 128.0] {
            let tau = clock.tau(n);
            near(at(Parameterization::LocalVelocity, tau), 0.5 / (clock.tau(2.0 * n) - tau));
        }
        near(at(Parameterization::McVelocity, 1.0), 2.0 * (1.0 - 1.0 / 16.0) * 16.0);
        near(at(Parameterization::VanillaRf, 0.0), 255.0 / 256.0);
        near(at(Parameterization::VanillaRf, 1.0), 0.0);
    }

    #[test]
    fn a_local_velocity_points_to_the_next_rung_of_any_ladder() {
        let counts = [2u64, 3, 12, 100, 128];
        let factors = Factors::new(Parameterization::LocalVelocity, &counts, Law::Covariances).expect("a ladder");
        let clock = factors.clock();
        for pair in counts.windows(2) {
            let (n, next) = (pair[0] as f64, pair[1] as f64);
            near(factors.next(n), next);
            near(factors.at(Some(clock.tau(n))), (1.0 - n / next) / (clock.tau(next) - clock.tau(n)));
        }
        let between = factors.next(6.0) / 6.0;
        assert!(between > 4.0 && between < 100.0 / 12.0, "{between}");
        near(factors.next(120.0) / 120.0, 1.28);
    }

    #[test]
    fn errors_of_another_power_have_the_factors_of_their_variances() {
        let (counts, alpha) = ([1u64, 2, 4, 32, 256], 0.8);
        let of = |parameterization| {
            let factors = Factors::new(parameterization, &counts, Law::Covariances).expect("a ladder");
            factors.with_exponent(alpha).expect("an exponent")
        };
        // Var I_n = n^(-2 alpha), and Cov(I_n, I_m) = Var I_m for n < m.
        let variance = |n: f64| n.powf(-2.0 * alpha);
        let clock = of(Parameterization::McNoise).clock();
        for pair in counts.windows(2) {
            let (n, next) = (pair[0] as f64, pair[1] as f64);
            let tau = clock.tau(n);
            let way = |m: f64| 1.0 - variance(m) / variance(n);
            near(of(Parameterization::McNoise).at(Some(tau)), -way(256.0));
            near(of(Parameterization::McVelocity).at(Some(tau)), way(256.0) / (1.0 - tau));
            let local = of(Parameterization::LocalVelocity);
            near(local.next(n), next);
            near(local.at(Some(tau)), way(next) / (clock.tau(next) - tau));
        }
        // An interpolant: (1 - t) I_1 + t I_256, towards I_256 - I_1.
        let (t, last) = (0.3, variance(256.0));
        let state = 0.49 + (1.0 - 0.49) * last;
        near(of(Parameterization::VanillaRf).at(Some(t)), 0.7 * (1.0 - last) / state);
        // The exponent of independent samples changes no bit.
        for p in Parameterization::ALL {
            let plain = Factors::new(p, &counts, Law::Covariances).expect("a ladder");
            assert_eq!(plain.clone().with_exponent(0.5).expect("an exponent"), plain);
        }
    }

    #[test]
    fn limits_are_those_of_earlier_versions() {
        let at = |parameterization, tau| {
            Factors::new(parameterization, &[1, 2, 256], Law::Limits).expect("a ladder").at(Some(tau))
        };
        let clock = VarianceTime::new(1, 256).expect("a ladder");
        for n in [1.0f64, 4.0, 100.0, 255.0] {
            let m = n * (1.0 + 1e-7);
            let limit = (1.0 - n / m) / (clock.tau(m) - clock.tau(n));
            assert!((at(Parameterization::LocalVelocity, clock.tau(n)) / limit - 1.0).abs() < 1e-4);
        }
        near(at(Parameterization::VanillaRf, 0.5), 2.0);
        near(at(Parameterization::VanillaRf, 1.0), STEEPEST);
        for p in Parameterization::ALL {
            assert_eq!(Factors::new(p, &[1, 4], Law::Limits).expect("a ladder").at(None), -1.0);
        }
        assert!(Factors::new(Parameterization::McNoise, &[4], Law::Limits).is_err());
    }
}
