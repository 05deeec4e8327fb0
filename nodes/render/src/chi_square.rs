//! Pearson's test for draws in bins, for tests.

/// Deviation of Pearson's statistic from what chance makes it, as that of a normal distribution (Wilson and Hilferty
/// 1931). Bins where fewer than 20 are expected are taken together. `slack` is the relative error of what is expected.
pub(crate) fn deviation(found: &[f64], expected: &[f64], slack: f64) -> f64 {
    let (mut statistic, mut freedom, mut rest) = (0.0, 0.0, (0.0, 0.0));
    let term = |f: f64, e: f64| (f - e) * (f - e) / (e + slack * slack * e * e);
    for (f, e) in found.iter().zip(expected) {
        if *e < 20.0 {
            rest = (rest.0 + f, rest.1 + e);
            continue;
        }
        statistic += term(*f, *e);
        freedom += 1.0;
    }
    if rest.1 > 20.0 {
        statistic += term(rest.0, rest.1);
        freedom += 1.0;
    } else if rest.0 > 20.0 + 10.0 * rest.1 {
        // Draws where there should be hardly any.
        return f64::INFINITY;
    }
    if freedom < 2.0 {
        // Too few draws, or bins, to say anything.
        return f64::INFINITY;
    }
    let spread: f64 = 2.0 / (9.0 * freedom);
    (libm::cbrt(statistic / freedom) - (1.0 - spread)) / spread.sqrt()
}

/// The significance level: one false alarm in a million over all of the hundreds of tests.
pub(crate) const ALLOWED: f64 = 5.6;

#[test]
fn it_tells_a_fair_die_from_a_loaded_one() {
    let fair = [1010.0, 985.0, 1022.0, 968.0, 1003.0, 1012.0];
    assert!(deviation(&fair, &[1000.0; 6], 0.0).abs() < 2.0);
    let loaded = [1010.0, 985.0, 1022.0, 768.0, 1003.0, 1212.0];
    assert!(deviation(&loaded, &[1000.0; 6], 0.0) > ALLOWED);
    assert_eq!(deviation(&[1000.0, 50.0], &[1000.0, 0.0], 0.0), f64::INFINITY);
}
