//! A metric's curve over the number of network calls, summed up in two numbers.
//!
//! With s = log N: AUC = trapezoid(q, s)/(s_K - s_1), a mean over the logarithm of cost, and TV = sum |q_{i+1} - q_i| /
//! (s_K - s_1), how much the curve wavers.

use tauflow_data::maths::log;

/// The two numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurveSummary {
    /// Area under the curve over log N, divided by the range of log N.
    pub auc: f64,
    /// Total variation, divided by the range of log N.
    pub tv: f64,
}

/// Sums up values `q` at network calls `nfe`.
///
/// None unless there are two points or more, at increasing `nfe` from at least 1.
pub fn summarise(nfe: &[u64], q: &[f64]) -> Option<CurveSummary> {
    let fine = nfe.len() >= 2 && nfe.len() == q.len() && nfe[0] >= 1 && nfe.windows(2).all(|w| w[0] < w[1]);
    if !fine {
        return None;
    }
    let s: Vec<f64> = nfe.iter().map(|n| log(*n as f64)).collect();
    let range = s[s.len() - 1] - s[0];
    let (mut area, mut variation) = (0.0, 0.0);
    for i in 1..q.len() {
        area += 0.5 * (q[i] + q[i - 1]) * (s[i] - s[i - 1]);
        variation += (q[i] - q[i - 1]).abs();
    }
    Some(CurveSummary { auc: area / range, tv: variation / range })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hand_example() {
        // s = 0, ln 2, 3 ln 2: areas 15 ln 2 and 2 x 15 ln 2 over 3 ln 2.
        let found = summarise(&[1, 2, 8], &[10.0, 20.0, 10.0]).expect("a curve");
        assert!((found.auc - 15.0).abs() < 1e-12);
        assert!((found.tv - 20.0 / 8f64.ln()).abs() < 1e-12);
        let flat = summarise(&[1, 2, 9, 20, 50], &[3.0; 5]).expect("a curve");
        assert!((flat.auc - 3.0).abs() < 1e-12 && flat.tv == 0.0);
    }

    #[test]
    fn the_papers_counts() {
        // Areas and variation by hand with ln 4.5 = 1.504077, ln 20/9 = .798508, ln 2.5 = .916291.
        let found = summarise(&[1, 2, 9, 20, 50], &[20.0, 22.0, 24.0, 23.0, 21.0]).expect("a curve");
        let area = 21.0 * core::f64::consts::LN_2 + 23.0 * 1.504_077_40 + 23.5 * 0.798_507_70 + 22.0 * 0.916_290_73;
        assert!((found.auc - area / 3.912_023_01).abs() < 1e-7);
        assert!((found.tv - 7.0 / 3.912_023_01).abs() < 1e-7);
    }

    #[test]
    fn what_is_no_curve_has_no_summary() {
        assert!(summarise(&[1], &[3.0]).is_none());
        assert!(summarise(&[2, 1], &[3.0, 4.0]).is_none());
        assert!(summarise(&[0, 1], &[3.0, 4.0]).is_none());
        assert!(summarise(&[1, 2], &[3.0]).is_none());
    }
}
