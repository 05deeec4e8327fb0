//! Owen-scrambled Sobol' points, padded: each dimension of a path is a two-dimensional sequence of its own.
//!
//! After Burley 2020, *Practical Hash-based Owen Scrambling*: the first two dimensions of Sobol's sequence, whose order
//! and values are shuffled for each pixel and dimension by nested uniform scrambles, with the Laine-Karras hash as
//! improved by Vegdahl. The first 2^k samples of a pixel are a (0, 2)-net in every dimension of the path, for every k:
//! ladders are nested as those of independent numbers are.

use tauflow_data::rng::mix;

/// Two numbers of 32 bits: point `index` of the sequence that `seed` names.
#[inline]
pub(crate) fn point(index: u32, seed: u64) -> [u32; 2] {
    let orders = mix(seed, 0);
    let index = scrambled(index, orders as u32);
    // The radical inverse, and the second dimension of Sobol's sequence.
    let (first, second) = (index.reverse_bits(), pascal(index).reverse_bits());
    let values = mix(seed, 1);
    [scrambled(first, values as u32), scrambled(second, (values >> 32) as u32)]
}

/// The product with Pascal's triangle modulo 2, whose columns are the direction numbers of the second dimension.
#[inline]
fn pascal(index: u32) -> u32 {
    const STAGES: [(u32, u32); 5] =
        [(1, 0x5555_5555), (2, 0x3333_3333), (4, 0x0F0F_0F0F), (8, 0x00FF_00FF), (16, 0x0000_FFFF)];
    STAGES.iter().fold(index, |x, (shift, low)| x ^ ((x >> shift) & low))
}

/// Flips each bit as all that are above it say.
#[inline]
fn scrambled(value: u32, seed: u32) -> u32 {
    let mut x = value.reverse_bits();
    // Multiplications by even numbers and additions carry upwards only.
    x ^= x.wrapping_mul(0x3D20_ADEA);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6C56);
    x ^= x.wrapping_mul(0x53A2_2864);
    x.reverse_bits()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_prefix_is_a_net() {
        for seed in [1, 2, 0x5678_9ABC_DEF0] {
            for log in [0u32, 1, 3, 6, 10] {
                let points: Vec<[u32; 2]> = (0..1 << log).map(|index| point(index, seed)).collect();
                // One point in each box of every shape of the area of 2^-log.
                for wide in 0..=log {
                    let cell = |value: u32, bits: u32| if bits == 0 { 0 } else { value >> (32 - bits) };
                    let mut taken = vec![false; 1 << log];
                    for [x, y] in &points {
                        let at = cell(*x, wide) << (log - wide) | cell(*y, log - wide);
                        assert!(!std::mem::replace(&mut taken[at as usize], true), "2^{log}, {wide} bits wide");
                    }
                }
            }
        }
    }

    #[test]
    fn the_second_dimension_is_sobols() {
        // Unscrambled: 0, 1/2, 1/4, 3/4, ... and 0, 1/2, 3/4, 1/4, 5/8, 1/8, 3/8, 7/8.
        let second: Vec<u32> = (0..8u32).map(|i| pascal(i).reverse_bits() >> 29).collect();
        assert_eq!(second, [0, 4, 6, 2, 5, 1, 3, 7]);
    }

    #[test]
    fn means_of_prefixes_covary_as_those_of_independent_samples() {
        // Variance time on a faster clock rests on it: Cov(I_n, I_m) = Var(I_m), whatever Var(I_m) is.
        let value = |[x, y]: [u32; 2]| {
            let [x, y] = [x, y].map(|v| f64::from(v) / 4_294_967_296.0);
            f64::from(u8::from(x * x + y * y < 1.0)) - std::f64::consts::FRAC_PI_4
        };
        let (counts, sequences) = ([1u32, 4, 16, 64], 20_000u64);
        let means = |seed: u64| counts.map(|n| (0..n).map(|i| value(point(i, seed))).sum::<f64>() / f64::from(n));
        let all: Vec<[f64; 4]> = (0..sequences).map(|seed| means(mix(7, seed))).collect();
        let product = |a: usize, b: usize| {
            let products: Vec<f64> = all.iter().map(|means| means[a] * means[b]).collect();
            let mean = products.iter().sum::<f64>() / sequences as f64;
            let square = products.iter().map(|p| (p - mean).powi(2)).sum::<f64>() / sequences as f64;
            (mean, (square / sequences as f64).sqrt())
        };
        for (m, count) in counts.iter().enumerate().skip(1) {
            let (variance, _) = product(m, m);
            // Nets, and not independent points.
            assert!(variance < 0.7 * product(0, 0).0 / f64::from(*count));
            for n in 0..m {
                let (covariance, error) = product(n, m);
                assert!(
                    (covariance - variance).abs() < 4.0 * error + 0.02 * variance,
                    "{n} {m}: {covariance} {variance}"
                );
            }
        }
    }

    #[test]
    fn points_are_uniform_and_sequences_unrelated() {
        let unit = |value: u32| f64::from(value) / 2f64.powi(32) - 0.5;
        let (mut sum, mut square, mut cross, count) = ([0.0; 2], 0.0, 0.0, 100_000u64);
        for seed in 0..count {
            let [x, y] = point(5, seed).map(unit);
            let other = unit(point(5, seed + count)[0]);
            sum = [sum[0] + x, sum[1] + y];
            square += x * x;
            cross += x * other;
        }
        let count = count as f64;
        // Five standard errors each.
        assert!(sum.iter().all(|s| (s / count).abs() < 4.6e-3), "{sum:?}");
        assert!((square / count - 1.0 / 12.0).abs() < 1.2e-3 && (cross / count).abs() < 1.4e-3);
    }
}
