//! One scene: errors of rungs against a reference that shares no sample with them, their slope, and tails of samples.

use super::{
    RESAMPLES,
    moments::{Moments, deviation, moments},
};
use tauflow_contract::KindError;
use tauflow_data::{
    maths::log,
    records::{Estimate, Ladder},
    rng::Stream,
    statistics::quantile,
};

/// Blocks of pixels along each side, over which a scene's slope is resampled.
const BLOCKS: usize = 8;
/// Fewest samples that a tail is measured on.
const FEWEST: usize = 400;

/// Exposed measurements of one scene.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    pub(super) scene: String,
    /// Whether samples vary by more than rounding: nothing else has a law, or a slope.
    pub(super) noisy: bool,
    /// Whether samples are independent: nothing else has moments.
    pub(super) independent: bool,
    /// Mean square error of each rung; may be negative, as the reference's own noise is taken off.
    pub(super) mse: Vec<f64>,
    /// Rungs whose mean square error is not positive; 0 without noise.
    pub(super) unresolved: u64,
    /// Mean variance of a single sample.
    pub(super) variance: f64,
    /// None without noise, or without two rungs to lay a line through.
    pub(super) slope: Option<Estimate>,
    /// Slopes of resampled blocks of pixels, which the interval is of; at least one if there is a slope.
    pub(super) slopes: Vec<f64>,
    /// None if samples are correlated, or no pixel varies by more than rounding.
    pub(super) moments: Option<Moments>,
    pub(super) tail_index: Option<f64>,
    pub(super) tail_share: f64,
    pub(super) mean_path_length: f64,
    pub(super) rejected: u64,
}

pub(super) fn measure(
    scene: &str,
    ladder: &Ladder,
    reference: &Ladder,
    factor: f64,
    stream: &mut Stream,
) -> Result<Measured, KindError> {
    let counts = &ladder.meta.counts;
    let last = reference.rungs.last().filter(|last| last.image.same_shape(&ladder.variance) && last.spp > 1);
    let (Some(truth), true) = (last, counts.len() >= 3) else {
        return Err(KindError::Input(format!(
            "the ladder of `{scene}` has rungs {counts:?}, and its reference {:?}; a slope needs three rungs or more, \
             a reference two samples or more, and both the same `resolution`",
            reference.meta.counts
        )));
    };
    let (width, height) = (ladder.variance.width(), ladder.variance.height());
    let values = 3 * width * height;
    // The contribution of the reference's noise to every product of differences.
    let own: Vec<f64> =
        reference.variance.data().iter().map(|v| f64::from(*v) * factor * factor / truth.spp as f64).collect();
    let off = |rung: usize, at: usize| {
        (f64::from(ladder.rungs[rung].image.data()[at]) - f64::from(truth.image.data()[at])) * factor
    };
    let pixels: Vec<f64> = reference
        .variance
        .data()
        .chunks_exact(3)
        .map(|rgb| rgb.iter().map(|v| f64::from(*v)).sum::<f64>() * factor * factor / 3.0)
        .collect();
    let variance = pixels.iter().sum::<f64>() / pixels.len().max(1) as f64;
    // Sums of squares in blocks of pixels: what the slope is resampled over.
    let block = |at: usize| {
        let (x, y) = (at / 3 % width, at / 3 / width);
        (y * BLOCKS / height) * BLOCKS + x * BLOCKS / width
    };
    let mut blocks = vec![vec![0.0; counts.len()]; BLOCKS * BLOCKS];
    for at in 0..values {
        let of = &mut blocks[block(at)];
        (0..counts.len()).for_each(|k| of[k] += off(k, at).powi(2) - own[at]);
    }
    // After subtraction of the reference's noise, an error can be zero or negative: a missing point.
    let fit = |sums: &[f64]| {
        let point = |(n, sum): (&u64, &f64)| {
            let mse = *sum / values as f64;
            (mse > 0.0).then(|| (log(*n as f64), 0.5 * log(mse)))
        };
        let points: Vec<(f64, f64)> = counts.iter().zip(sums).filter_map(point).collect();
        (points.len() > 1).then(|| slope(&points))
    };
    let total = |chosen: &mut dyn Iterator<Item = usize>| {
        let mut sums = vec![0.0; counts.len()];
        chosen.for_each(|block| sums.iter_mut().zip(&blocks[block]).for_each(|(sum, v)| *sum += v));
        sums
    };
    let independent = ladder.meta.sampler.is_independent();
    let moments = if independent { moments(ladder, reference) } else { None };
    let varies = || (0..values).any(|at| deviation(ladder, reference, at).is_some());
    let noisy = variance > 0.0 && (moments.is_some() || !independent && varies());
    let resamples = if noisy { RESAMPLES } else { 0 };
    let mut slopes: Vec<f64> = (0..resamples)
        .filter_map(|_| fit(&total(&mut (0..blocks.len()).map(|_| stream.below(BLOCKS * BLOCKS)))))
        .collect();
    slopes.sort_by(f64::total_cmp);
    let sums = total(&mut (0..blocks.len()));
    let mse: Vec<f64> = sums.iter().map(|sum| sum / values as f64).collect();
    let unresolved = if noisy { mse.iter().filter(|mse| **mse <= 0.0).count() } else { 0 };
    let whole = if slopes.is_empty() { None } else { fit(&sums) };
    Ok(Measured {
        scene: scene.to_owned(),
        noisy,
        independent,
        mse,
        unresolved: unresolved as u64,
        variance,
        slope: whole.map(|mean| Estimate { mean, low: quantile(&slopes, 0.025), high: quantile(&slopes, 0.975) }),
        slopes,
        moments,
        tail_index: tail_index(ladder, reference),
        tail_share: top_share(pixels),
        mean_path_length: ladder.meta.mean_path_length,
        rejected: ladder.meta.rejected + reference.meta.rejected,
    })
}

/// Single samples in units of their pixels' deviations: sample n is what takes I_n to I_n+1, for each pair of such
/// rungs.
pub(super) fn samples(ladder: &Ladder, reference: &Ladder) -> Vec<f64> {
    let Some(truth) = reference.rungs.last() else { return Vec::new() };
    let mut found = Vec::new();
    let mut before: Option<(u64, &[f32])> = None;
    for rung in &ladder.rungs {
        let single = match before {
            None => rung.spp == 1,
            Some((n, _)) => rung.spp == n + 1,
        };
        if single {
            for (at, value) in rung.image.data().iter().enumerate() {
                let earlier = before.map_or(0.0, |(n, image)| n as f64 * f64::from(image[at]));
                let sample = rung.spp as f64 * f64::from(*value) - earlier;
                if let Some(deviation) = deviation(ladder, reference, at) {
                    found.push((sample - f64::from(truth.image.data()[at])) / deviation);
                }
            }
        }
        before = Some((rung.spp, rung.image.data()));
    }
    found
}

/// Hill's estimate (1975) over the largest hundredth of single samples; none if they are few, or the largest all alike.
fn tail_index(ladder: &Ladder, reference: &Ladder) -> Option<f64> {
    let mut sizes: Vec<f64> = samples(ladder, reference).iter().map(|z| z.abs()).collect();
    if sizes.len() < FEWEST {
        return None;
    }
    sizes.sort_unstable_by(|a, b| b.total_cmp(a));
    let top = sizes.len() / 100;
    let logs: f64 = sizes[..top].iter().map(|size| log(size / sizes[top])).sum();
    (sizes[top] > 0.0 && logs > 0.0).then(|| top as f64 / logs)
}

/// Share of the sum that is in the largest 1% of values.
pub(crate) fn top_share(mut values: Vec<f64>) -> f64 {
    values.sort_by(|a, b| b.total_cmp(a));
    let total: f64 = values.iter().sum();
    let top: f64 = values.iter().take(values.len().div_ceil(100)).sum();
    if total > 0.0 { top / total } else { 0.0 }
}

/// Slope by least squares.
pub(crate) fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let (x, y) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let sxy: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    let sxx: f64 = points.iter().map(|p| (p.0 - x) * (p.0 - x)).sum();
    sxy / sxx
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use tauflow_data::{
        Image, IntegratorKind, SamplerKind,
        records::{LadderMeta, Rung},
    };

    const SIDE: usize = 24;

    /// A ladder of the samples that `draw` gives.
    pub(in crate::convergence) fn ladder(counts: &[u64], mut draw: impl FnMut(usize) -> f64) -> Ladder {
        let mut rungs: Vec<Rung> =
            counts.iter().map(|spp| Rung { spp: *spp, image: Image::new(SIDE, SIDE, 3) }).collect();
        let mut variance = Image::new(SIDE, SIDE, 3);
        let last = counts[counts.len() - 1];
        for at in 0..SIDE * SIDE * 3 {
            let (mut sum, mut squares) = (0.0, 0.0);
            for n in 1..=last {
                let sample = draw(at);
                sum += sample;
                squares += sample * sample;
                if let Some(k) = counts.iter().position(|count| *count == n) {
                    rungs[k].image.data_mut()[at] = (sum / n as f64) as f32;
                }
            }
            let n = last as f64;
            variance.data_mut()[at] = ((squares - sum * sum / n) / (n - 1.0)) as f32;
        }
        let meta = LadderMeta {
            counts: counts.to_vec(),
            width: SIDE,
            height: SIDE,
            rejected: 0,
            mean_path_length: 2.0,
            sampler: SamplerKind::Independent,
            integrator: IntegratorKind::Path,
            estimated_error: None,
        };
        Ladder { meta, rungs, variance }
    }

    pub(in crate::convergence) const COUNTS: [u64; 7] = [1, 2, 4, 8, 16, 32, 64];

    #[test]
    fn normal_samples_keep_the_law_against_a_held_out_reference() {
        let (mut a, mut b) = (Stream::new(1, &[0]), Stream::new(1, &[1]));
        let sigma = |at: usize| 0.1 + 0.3 * (at % 7) as f64;
        let own = ladder(&COUNTS, |at| 1.0 + sigma(at) * a.normal());
        let reference = ladder(&[1024], |at| 1.0 + sigma(at) * b.normal());
        let found = measure("L0-open-000000", &own, &reference, 2.0, &mut Stream::new(1, &[2])).expect("enough rungs");
        let slope = found.slope.expect("noise");
        assert!(found.noisy && found.unresolved == 0 && (slope.mean + 0.5).abs() < 0.03, "{slope:?}");
        assert!(slope.low < slope.mean && slope.mean < slope.high);
        assert!(slope.low < -0.5 && -0.5 < slope.high, "{slope:?}");
        assert!((found.mse[0] / found.variance - 1.0).abs() < 0.1, "{found:?}");
        let moments = found.moments.expect("noise");
        assert!(moments.kurtosis.abs() < 0.4 && found.tail_index.is_some_and(|i| i > 4.0), "{moments:?}");
        assert!(found.tail_share < 0.1);
    }

    #[test]
    fn rare_bright_samples_have_the_kurtosis_of_their_odds() {
        // One in a hundred: a Bernoulli variable has the excess kurtosis (1 - 6 p (1 - p))/(p (1 - p)) = 95.
        let (mut a, mut b) = (Stream::new(3, &[0]), Stream::new(3, &[1]));
        let rare = |stream: &mut Stream| if stream.uniform() < 0.01 { 50.0 } else { 0.0 };
        // Eight single samples of 1,728 values, of which about 138 are bright: a deviation of 8.5%.
        let counts: Vec<u64> = (1..=8).collect();
        let (own, reference) = (ladder(&counts, |_| rare(&mut a)), ladder(&[4096], |_| rare(&mut b)));
        let found = measure("L3-open-000000", &own, &reference, 1.0, &mut Stream::new(1, &[2])).expect("enough rungs");
        let kurtosis = found.moments.expect("noise").kurtosis;
        assert!((kurtosis / 95.0 - 1.0).abs() < 0.25, "{kurtosis}");
    }

    #[test]
    fn single_samples_come_back_from_neighbouring_rungs() {
        let mut drawn = Vec::new();
        let mut stream = Stream::new(5, &[]);
        let own = ladder(&[1, 2, 3, 8], |at| {
            let sample = stream.uniform();
            drawn.push((at, sample));
            sample
        });
        let mut other = Stream::new(6, &[]);
        let reference = ladder(&[64], |_| other.uniform());
        let found = samples(&own, &reference);
        assert_eq!(found.len(), 3 * 3 * SIDE * SIDE);
        // The third sample of pixel value 5: eight are drawn for each.
        let (at, sample) = drawn[5 * 8 + 2];
        let deviation = deviation(&own, &reference, at).expect("noise");
        let expected = (sample - f64::from(reference.rungs[0].image.data()[at])) / deviation;
        assert!((found[2 * 3 * SIDE * SIDE + 5] - expected).abs() < 1e-4);
    }

    #[test]
    fn errors_below_the_noise_of_the_reference_are_left_out_of_the_line_and_counted() {
        let (mut a, mut b) = (Stream::new(7, &[0]), Stream::new(7, &[1]));
        let own = ladder(&COUNTS, |_| 1.0 + a.normal());
        let reference = ladder(&[1024], |_| 1.0 + b.normal());
        let found = |times: f32| {
            // A reference that is said to have more noise of its own than it has.
            let mut noisier = reference.clone();
            noisier.variance.data_mut().iter_mut().for_each(|v| *v *= times);
            measure("x", &own, &noisier, 1.0, &mut Stream::new(1, &[2])).expect("enough rungs")
        };
        // 48/1024 is more than 1/32, and less than 1/16.
        let some = found(48.0);
        assert_eq!((some.noisy, some.unresolved), (true, 2), "{:?}", some.mse);
        // No wild slopes among the resampled ones.
        let slope = some.slope.expect("five rungs");
        assert!(-1.2 < slope.low && slope.high < -0.5, "{slope:?}");
        // 4 is more than 1.
        let all = found(4096.0);
        assert_eq!((all.noisy, all.unresolved, all.slope), (true, 7, None), "{:?}", all.mse);
    }

    #[test]
    fn without_noise_there_is_no_slope() {
        let (own, reference) = (ladder(&COUNTS, |_| 0.7), ladder(&[1024], |_| 0.7));
        let found = measure("x", &own, &reference, 1.0, &mut Stream::new(1, &[])).expect("enough rungs");
        assert_eq!((found.noisy, found.unresolved, found.slope), (false, 0, None));
        assert!(found.slopes.is_empty() && found.moments.is_none(), "{found:?}");
    }

    #[test]
    fn correlated_samples_have_errors_and_a_slope_but_no_moments() {
        // Means of independent samples, drawn towards the truth by 1/sqrt n: errors fall as 1/n.
        let (mut a, mut b) = (Stream::new(9, &[0]), Stream::new(9, &[1]));
        let mut own = ladder(&COUNTS, |_| a.normal());
        own.meta.sampler = SamplerKind::Sobol;
        for rung in &mut own.rungs {
            let scale = 1.0 / (rung.spp as f32).sqrt();
            rung.image.data_mut().iter_mut().for_each(|v| *v = 1.0 + *v * scale);
        }
        let reference = ladder(&[4096], |_| 1.0 + b.normal());
        let found = measure("x", &own, &reference, 1.0, &mut Stream::new(1, &[2])).expect("enough rungs");
        let slope = found.slope.expect("noise");
        assert!(found.noisy && !found.independent && found.moments.is_none(), "{found:?}");
        assert!(slope.low < -1.0 && -1.0 < slope.high && slope.high - slope.low < 0.2, "{slope:?}");
        // The law is that of independent samples.
        assert!((found.variance - 1.0).abs() < 0.05, "{found:?}");
    }

    #[test]
    fn too_few_rungs_are_refused() {
        let mut stream = Stream::new(5, &[]);
        let own = ladder(&[1, 2], |_| stream.uniform());
        let error = measure("x", &own, &own, 1.0, &mut Stream::new(1, &[])).expect_err("two rungs").to_string();
        assert!(error.contains("three rungs"), "{error}");
    }
}
