//! Moments of a ladder's errors against a held-out reference, each pixel in units of its own deviation, beside the
//! law's.
//!
//! Let a pixel have n_max samples in the ladder and N in the reference R, and let S^2 be the variance of all of them as
//! one set. If samples are independent and alike, it is chance alone which of the set went into I_n. Given the set,
//! E (I_n - R)(I_m - R) = S^2 (1/max(n, m) + 1/N), as for any sampling without replacement (Cochran 1977, theorem 2.2).
//! So
//!
//!   ((I_n - R)(I_m - R)/S^2 - 1/N) max(n, m)
//!
//! has the mean 1 for every distribution of samples, heavy tails included. Estimating sigma^2, even from some of the
//! same samples, adds no bias. No pixel counts for more because it is bright.

use tauflow_data::{
    maths::erfc,
    records::{Ladder, deviation_of_both},
};

/// Pixels that a distribution is compared with the normal one over, at most.
const COMPARED: usize = 16_384;

/// A mean over pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Figure {
    pub(super) value: f64,
    /// Standard error. Rare events that no pixel has drawn do not show in the spread of pixels, but do in kurtosis: the
    /// larger of what both say.
    pub(super) error: f64,
    /// Variance as kurtosis has it: what scenes are weighed by, as it does not depend on the value.
    expected: f64,
}

/// The moments of one scene.
#[derive(Clone, Debug)]
pub(super) struct Moments {
    /// Mean over pixels of the excess kurtosis of their samples.
    pub(super) kurtosis: f64,
    /// For each rung: the error in units of sigma/sqrt(n).
    pub(super) mean: Vec<Figure>,
    /// For each rung m and those up to it, n: the product of errors in units of sigma^2/m.
    pub(super) covariance: Vec<Vec<Figure>>,
    /// For each rung: Kolmogorov's distance of the errors, in units of sigma/sqrt(n), from a normal distribution.
    pub(super) off_normal: Vec<f64>,
}

/// The standard deviation S of all samples of a pixel value, the ladder's and the reference's; none where it is no more
/// than rounding.
pub(super) fn deviation(ladder: &Ladder, reference: &Ladder, at: usize) -> Option<f64> {
    let (last, truth) = (ladder.rungs.last()?, reference.rungs.last()?);
    let mean = f64::from(truth.image.data()[at]);
    let apart = f64::from(last.image.data()[at]) - mean;
    let of = |ladder: &Ladder, spp: u64| (spp, f64::from(ladder.variance.data()[at]));
    deviation_of_both([of(ladder, last.spp), of(reference, truth.spp)], apart, mean)
}

/// The moments; none if no pixel has noise. Ladder and reference are of the same shape, and of two samples or more.
pub(super) fn moments(ladder: &Ladder, reference: &Ladder) -> Option<Moments> {
    let truth = reference.rungs.last()?;
    let counts: Vec<f64> = ladder.rungs.iter().map(|rung| rung.spp as f64).collect();
    let (spp, last) = (truth.spp as f64, *counts.last()?);
    let pairs: Vec<(usize, usize)> = (0..counts.len()).flat_map(|m| (0..=m).map(move |n| (m, n))).collect();
    let (mut means, mut products) = (vec![PixelSums::default(); counts.len()], vec![PixelSums::default(); pairs.len()]);
    let mut kurtosis = PixelSums::default();
    let mut errors: Vec<Vec<f64>> = vec![Vec::new(); counts.len()];
    let pixels = ladder.variance.data().len() / 3;
    let every = pixels.div_ceil(COMPARED).max(1);
    let (mut mean, mut product) = (vec![0.0; counts.len()], vec![0.0; pairs.len()]);
    let mut off = vec![0.0; counts.len()];
    for pixel in 0..pixels {
        // The colours of a pixel share their paths: one draw, not three.
        mean.iter_mut().chain(&mut product).for_each(|v| *v = 0.0);
        let (mut colours, mut of_kurtosis) = (0.0, 0.0);
        for at in 3 * pixel..3 * pixel + 3 {
            let Some(deviation) = deviation(ladder, reference, at) else { continue };
            colours += 1.0;
            let value = f64::from(truth.image.data()[at]);
            for (off, rung) in off.iter_mut().zip(&ladder.rungs) {
                *off = (f64::from(rung.image.data()[at]) - value) / deviation;
            }
            for (k, n) in counts.iter().enumerate() {
                mean[k] += off[k] * n.sqrt();
                if pixel % every == 0 {
                    errors[k].push(off[k] / (1.0 / n + 1.0 / spp).sqrt());
                }
            }
            for (sum, (m, n)) in product.iter_mut().zip(&pairs) {
                *sum += (off[*m] * off[*n] - 1.0 / spp) * counts[*m];
            }
            of_kurtosis += excess_kurtosis(
                [ladder, reference].map(|of| f64::from(of.variance.data()[at]) / (deviation * deviation)),
                [last, spp],
            );
        }
        if colours > 0.0 {
            means.iter_mut().zip(&mean).for_each(|(sums, v)| sums.add(v / colours));
            products.iter_mut().zip(&product).for_each(|(sums, v)| sums.add(v / colours));
            kurtosis.add(of_kurtosis / colours);
        }
    }
    if kurtosis.count == 0.0 {
        return None;
    }
    // No distribution has less than -2.
    let kurtosis = (kurtosis.sum / kurtosis.count).max(-2.0);
    let heavy = kurtosis.max(0.0);
    let mut figures = pairs.iter().zip(&products);
    let covariance = (0..counts.len())
        .map(|m| {
            // Isserlis's theorem and the fourth cumulant.
            let of = |((m, n), sums): (&(usize, usize), &PixelSums)| {
                let (m, n) = (counts[*m], counts[*n]);
                sums.figure(m / n + 1.0 + heavy / n)
            };
            figures.by_ref().take(m + 1).map(of).collect()
        })
        .collect();
    Some(Moments {
        kurtosis,
        mean: means.iter().zip(&counts).map(|(sums, n)| sums.figure(1.0 + n / spp)).collect(),
        covariance,
        off_normal: errors.into_iter().map(from_normal).collect(),
    })
}

/// Excess kurtosis of a pixel's samples from how far two variances of them, over S^2, are apart: that of a variance of
/// n samples is (kurtosis/n + 2/(n - 1)) sigma^4.
fn excess_kurtosis(variances: [f64; 2], counts: [f64; 2]) -> f64 {
    let apart = variances[0] - variances[1];
    let of_normal: f64 = counts.iter().map(|n| 2.0 / (n - 1.0)).sum();
    (apart * apart - of_normal) / counts.iter().map(|n| 1.0 / n).sum::<f64>()
}

/// Kolmogorov's distance of values from the standard normal distribution.
fn from_normal(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let count = values.len().max(1) as f64;
    values.iter().enumerate().fold(0.0, |largest: f64, (i, value)| {
        let normal = 0.5 * erfc(-value * core::f64::consts::FRAC_1_SQRT_2);
        largest.max((normal - i as f64 / count).abs()).max((normal - (i as f64 + 1.0) / count).abs())
    })
}

/// Sums over pixels.
#[derive(Clone, Copy, Debug, Default)]
struct PixelSums {
    count: f64,
    sum: f64,
    squares: f64,
}

impl PixelSums {
    fn add(&mut self, value: f64) {
        self.count += 1.0;
        self.sum += value;
        self.squares += value * value;
    }

    /// The mean of values of this variance, as far as is known.
    fn figure(&self, variance: f64) -> Figure {
        let value = self.sum / self.count;
        let seen = (self.squares / self.count - value * value).max(0.0) / self.count;
        let expected = variance / self.count;
        Figure { value, error: seen.max(expected).sqrt(), expected }
    }
}

/// The mean over scenes, weighed by what their kurtoses say of how well each is known, and its standard error: the
/// larger of what the scenes' own say and of what their spread does. There is at least one.
pub(super) fn pooled(figures: &[Figure]) -> [f64; 2] {
    let total: f64 = figures.iter().map(|f| 1.0 / f.expected).sum();
    let mean = |of: &dyn Fn(&Figure) -> f64| figures.iter().map(|f| of(f) / f.expected).sum::<f64>() / total;
    let value = mean(&|f| f.value);
    let squared =
        |of: &dyn Fn(&Figure) -> f64| figures.iter().map(|f| (of(f) / (f.expected * total)).powi(2)).sum::<f64>();
    let scenes = figures.len() as f64;
    let spread = if figures.len() > 1 { squared(&|f| f.value - value) * scenes / (scenes - 1.0) } else { 0.0 };
    [value, squared(&|f| f.error).max(spread).sqrt()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convergence::measure::tests::{COUNTS, ladder};
    use tauflow_data::{
        maths::pow,
        records::{AgainstLaw, Agreement},
        rng::Stream,
    };

    const SCENES: u64 = 12;
    const REFERENCE: u64 = 1024;

    /// Pixels of deviations from 0.01 to 100, of which every fourth is anything but normal: rare and very rare bright
    /// samples, and Pareto's distribution of the index 1.5, which has no variance.
    fn sample(at: usize, stream: &mut Stream) -> f64 {
        let size = pow(10.0, (at / 3 % 5) as f64 - 2.0);
        let pixel = at / 3;
        size * match pixel % 12 {
            3 => f64::from(u8::from(stream.uniform() < 0.01)),
            7 => f64::from(u8::from(stream.uniform() < 0.0005)),
            11 => pow(1.0 - stream.uniform(), -1.0 / 1.5),
            _ => 1.0 + stream.normal(),
        }
    }

    fn both(scene: u64) -> (Ladder, Ladder) {
        let (mut a, mut b) = (Stream::new(scene, &[0]), Stream::new(scene, &[1]));
        (ladder(&COUNTS, |at| sample(at, &mut a)), ladder(&[REFERENCE], |at| sample(at, &mut b)))
    }

    fn covariance(scenes: &[Moments], m: usize, n: usize) -> AgainstLaw {
        let [value, error] = pooled(&scenes.iter().map(|s| s.covariance[m][n]).collect::<Vec<_>>());
        AgainstLaw::new(value, error, 1.0)
    }

    #[test]
    fn the_law_holds_within_standard_errors_whatever_the_tails() {
        let scenes: Vec<Moments> =
            (0..SCENES).map(both).map(|(own, held)| moments(&own, &held).expect("noise")).collect();
        let mut squares = 0.0;
        for m in 0..COUNTS.len() {
            for n in 0..=m {
                let found = covariance(&scenes, m, n);
                assert!(found.z.abs() < 4.0 && found.verdict != Agreement::Differs, "{m} {n}: {found:?}");
                squares += found.z * found.z;
            }
            let [mean, error] = pooled(&scenes.iter().map(|s| s.mean[m]).collect::<Vec<_>>());
            assert!(mean.abs() < 4.0 * error && error < 0.05, "{m}: {mean} +- {error}");
        }
        // 28 values of z, which hang together: of variance 1, or less where errors are on the safe side.
        assert!(squares < 2.0 * 28.0, "{squares}");
        // Variances are known well from a few samples on.
        assert!((4..COUNTS.len()).all(|k| covariance(&scenes, k, k).verdict == Agreement::Agrees));
    }

    #[test]
    fn heavy_pixels_show_as_kurtosis_and_distance_from_normal() {
        let (mut a, mut b) = (Stream::new(1, &[0]), Stream::new(1, &[1]));
        let own = ladder(&COUNTS, |_| a.normal());
        let normal = moments(&own, &ladder(&[REFERENCE], |_| b.normal())).expect("noise");
        assert!(normal.kurtosis.abs() < 0.5 && normal.off_normal.iter().all(|d| *d < 0.05), "{normal:?}");
        let (own, held) = both(1);
        let heavy = moments(&own, &held).expect("noise");
        // 95 for one in a hundred, 1,000 or so for the others, of 1 in 12 pixels each.
        assert!((60.0..400.0).contains(&heavy.kurtosis), "{heavy:?}");
        assert!(heavy.off_normal[0] > 0.08 && heavy.off_normal[6] < heavy.off_normal[0], "{heavy:?}");
        let flat = ladder(&COUNTS, |_| 0.7);
        assert!(moments(&flat, &ladder(&[REFERENCE], |_| 0.7)).is_none(), "no noise, no moments");
    }

    #[test]
    fn broken_ladders_differ() {
        // Rungs that share no samples: variances are right, covariances are 0.
        let mut draws: Vec<Stream> = (0..8).map(|k| Stream::new(5, &[k])).collect();
        let mut apart = ladder(&COUNTS, |at| sample(at, &mut draws[7]));
        for (k, rung) in apart.rungs.iter_mut().enumerate().take(6) {
            *rung = ladder(&COUNTS[..=k], |at| sample(at, &mut draws[k])).rungs.remove(k);
        }
        let held = both(9).1;
        let found = [moments(&apart, &held).expect("noise")];
        for m in 3..COUNTS.len() {
            assert_eq!(covariance(&found, m, m - 1).verdict, Agreement::Differs, "{:?}", covariance(&found, m, m - 1));
            assert_ne!(covariance(&found, m, m).verdict, Agreement::Differs, "{:?}", covariance(&found, m, m));
        }
        // Each sample twice: twice the variance but at the first rung.
        let (mut a, mut b) = (Stream::new(6, &[0]), Stream::new(6, &[1]));
        let mut last = None;
        let twice = ladder(&COUNTS, |_| match last.take() {
            Some(sample) => sample,
            None => *last.insert(a.normal()),
        });
        let found = [moments(&twice, &ladder(&[REFERENCE], |_| b.normal())).expect("noise")];
        let at = |k: usize| covariance(&found, k, k);
        assert_ne!(at(0).verdict, Agreement::Differs, "{:?}", at(0));
        assert!((1..COUNTS.len()).all(|k| at(k).verdict == Agreement::Differs && (at(k).value - 2.0).abs() < 0.3));
        // A reference of something else.
        let (mut a, mut b) = (Stream::new(7, &[0]), Stream::new(7, &[1]));
        let own = ladder(&COUNTS, |_| a.normal());
        let off = moments(&own, &ladder(&[REFERENCE], |_| 0.1 + b.normal())).expect("noise").mean[6];
        assert_eq!(AgainstLaw::new(off.value, off.error, 0.0).verdict, Agreement::Differs, "{off:?}");
    }
}
