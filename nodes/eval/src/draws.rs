//! Intervals over few independent draws: the quantile of Student's t distribution.

use core::f64::consts::FRAC_PI_2;
use tauflow_data::maths::{cos, exp, log, sin};

/// Share of the distribution within the interval.
const WITHIN: f64 = 0.95;

/// The number of standard errors that a 95% interval extends to both sides, for so many degrees of freedom.
///
/// The substitution t = sqrt(freedom) tan a makes the density of a proportional to cos(a)^(freedom - 1).
pub(crate) fn t_quantile(freedom: f64) -> f64 {
    let density = |angle: f64| {
        let base = cos(angle);
        if base <= 0.0 { f64::from(u8::from(freedom <= 1.0)) } else { exp((freedom - 1.0) * log(base)) }
    };
    // Simpson's rule.
    let integral = |to: f64| {
        let count = 2000;
        let step = to / f64::from(count);
        let weight = |i: i32| if i == 0 || i == count { 1.0 } else { 2.0 + 2.0 * f64::from(i % 2) };
        (0..=count).map(|i| weight(i) * density(f64::from(i) * step)).sum::<f64>() * step / 3.0
    };
    let wanted = WITHIN * integral(FRAC_PI_2);
    let (mut low, mut high) = (0.0, FRAC_PI_2);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if integral(middle) < wanted { low = middle } else { high = middle }
    }
    let angle = 0.5 * (low + high);
    freedom.sqrt() * sin(angle) / cos(angle)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_tables() {
        for (freedom, expected) in
            [(1.0, 12.7062), (2.0, 4.3027), (4.0, 2.7764), (10.0, 2.2281), (16.0, 2.1199), (120.0, 1.9799)]
        {
            let found = t_quantile(freedom);
            assert!((found / expected - 1.0).abs() < 1e-4, "{freedom}: {found} {expected}");
        }
    }
}
