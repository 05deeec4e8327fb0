//! The power spectrum of a picture, and how fast it falls.
//!
//! Photographs of natural scenes have a power that falls about as the frequency to the power -2 (Field 1987). Borders
//! would add lines to the spectrum, so that a Hann window takes them out; it spreads power by one wave, so that the
//! lowest frequencies are left out. Frequencies above a quarter of the pixels, which filters and noise change, are
//! excluded, too.

use std::f64::consts::PI;
use tauflow_data::maths::{cos, log, sin};

/// Real and imaginary part.
type Complex = [f64; 2];

/// Fewest pixels a side: they have six frequencies.
const LEAST: usize = 32;
/// Waves a side that are counted from.
const FIRST: usize = 3;
/// Power that is rounding, over the largest.
const ROUNDING: f64 = 1e-12;

/// Slope of log power on log frequency of rows of `width` values. It is taken from the largest square in the middle
/// whose side is a power of two; none if that has fewer than 32 pixels a side, or lacks some frequency.
pub(super) fn slope(values: &[f64], width: usize) -> Option<f64> {
    let height = values.len() / width;
    let side = 1 << width.min(height).ilog2();
    if side < LEAST {
        return None;
    }
    let (left, top) = ((width - side) / 2, (height - side) / 2);
    let power = powers(side, |x, y| values[(top + y) * width + left + x]);
    // Rings of frequencies, a wave wide.
    let last = side / 4;
    let mut rings = vec![(0.0, 0.0, 0.0); last + 1];
    let waves = |k: usize| k.min(side - k) as f64;
    for (at, power) in power.iter().enumerate() {
        let (u, v) = (waves(at % side), waves(at / side));
        let frequency = (u * u + v * v).sqrt();
        if let Some((sum, of, count)) = rings.get_mut((frequency + 0.5) as usize) {
            *sum += power;
            *of += frequency;
            *count += 1.0;
        }
    }
    let least = ROUNDING * power.iter().copied().fold(0.0, f64::max);
    let rings = &rings[FIRST..];
    let point = |(sum, of, count): &(f64, f64, f64)| (log(of / count), log(sum / count), *count);
    rings.iter().all(|(sum, _, count)| sum / count > least).then(|| fit(&rings.iter().map(point).collect::<Vec<_>>()))
}

/// Slope of y on x by least squares, each point with its weight. The log of a mean of few waves is uncertain and low on
/// average, so that rings weigh as many waves as they have.
fn fit(points: &[(f64, f64, f64)]) -> f64 {
    let weighted = |value: &dyn Fn(f64, f64) -> f64| points.iter().map(|(x, y, w)| w * value(*x, *y)).sum::<f64>();
    let whole = weighted(&|_, _| 1.0);
    let (middle, level) = (weighted(&|x, _| x) / whole, weighted(&|_, y| y) / whole);
    weighted(&|x, y| (x - middle) * (y - level)) / weighted(&|x, _| (x - middle) * (x - middle))
}

/// Power of each frequency of a windowed square, rows by vertical frequency.
fn powers(side: usize, value: impl Fn(usize, usize) -> f64) -> Vec<f64> {
    let hann: Vec<f64> = (0..side).map(|i| 0.5 - 0.5 * cos(2.0 * PI * (i as f64 + 0.5) / side as f64)).collect();
    let cells = || (0..side * side).map(|at| (at % side, at / side));
    let whole: f64 = cells().map(|(x, y)| hann[x] * hann[y]).sum();
    let middle = cells().map(|(x, y)| hann[x] * hann[y] * value(x, y)).sum::<f64>() / whole;
    let mut lines: Vec<Complex> = cells().map(|(x, y)| [hann[x] * hann[y] * (value(x, y) - middle), 0.0]).collect();
    lines.chunks_exact_mut(side).for_each(transform);
    let mut turned: Vec<Complex> = cells().map(|(y, x)| lines[y * side + x]).collect();
    turned.chunks_exact_mut(side).for_each(transform);
    cells().map(|(y, x)| turned[y * side + x]).map(|[re, im]| re * re + im * im).collect()
}

/// The Fourier transform of a line whose length is a power of two, in place (Cooley and Tukey 1965).
fn transform(line: &mut [Complex]) {
    let length = line.len();
    let bits = length.ilog2();
    if bits == 0 {
        return;
    }
    for at in 0..length {
        let other = at.reverse_bits() >> (usize::BITS - bits);
        if at < other {
            line.swap(at, other);
        }
    }
    let mut half = 1;
    while half < length {
        for k in 0..half {
            let angle = -PI * k as f64 / half as f64;
            let (c, s) = (cos(angle), sin(angle));
            for at in (k..length).step_by(2 * half) {
                let ([a, b], [re, im]) = (line[at], line[at + half]);
                let (re, im) = (re * c - im * s, re * s + im * c);
                line[at] = [a + re, b + im];
                line[at + half] = [a - re, b - im];
            }
        }
        half *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::rng::Stream;

    #[test]
    fn the_transform_is_the_sum_that_defines_it() {
        let mut stream = Stream::new(3, &[]);
        for length in [1usize, 2, 4, 16] {
            let line: Vec<Complex> = (0..length).map(|_| [stream.normal(), stream.normal()]).collect();
            let mut fast = line.clone();
            transform(&mut fast);
            for (k, [re, im]) in fast.into_iter().enumerate() {
                let turn = |i: usize| -2.0 * PI * (k * i) as f64 / length as f64;
                let sum = |of: &dyn Fn(&Complex, f64) -> f64| -> f64 {
                    line.iter().enumerate().map(|(i, value)| of(value, turn(i))).sum()
                };
                let real = sum(&|v, t| v[0] * cos(t) - v[1] * sin(t));
                let imaginary = sum(&|v, t| v[0] * sin(t) + v[1] * cos(t));
                assert!((re - real).abs() < 1e-12 && (im - imaginary).abs() < 1e-12, "{length}, {k}");
            }
        }
    }

    /// Noise whose amplitude is the frequency to the power `exponent`: waves of random phase.
    fn noise(side: usize, exponent: f64, stream: &mut Stream) -> Vec<f64> {
        let mut waves = vec![[0.0; 2]; side * side];
        let folded = |k: usize| k.min(side - k) as f64;
        for (at, wave) in waves.iter_mut().enumerate().skip(1) {
            let (u, v) = (folded(at % side), folded(at / side));
            let amplitude = tauflow_data::maths::pow((u * u + v * v).sqrt(), exponent);
            let phase = stream.range(0.0, 2.0 * PI);
            *wave = [amplitude * cos(phase), amplitude * sin(phase)];
        }
        // The real part of a transform has half of the power at a frequency and half at its opposite.
        waves.chunks_exact_mut(side).for_each(transform);
        let mut turned: Vec<Complex> = (0..side * side).map(|at| waves[at % side * side + at / side]).collect();
        turned.chunks_exact_mut(side).for_each(transform);
        turned.into_iter().map(|[re, _]| re).collect()
    }

    #[test]
    fn noise_of_a_known_power_has_its_slope() {
        let mut stream = Stream::new(5, &[]);
        for (exponent, expected) in [(0.0, 0.0), (-0.5, -1.0), (-1.0, -2.0)] {
            let slopes: Vec<f64> =
                (0..32).map(|_| slope(&noise(64, exponent, &mut stream), 64).expect("large enough")).collect();
            let mean = slopes.iter().sum::<f64>() / slopes.len() as f64;
            println!("amplitude {exponent}: {mean}");
            assert!((mean - expected).abs() < 0.1, "{exponent}: {mean}");
        }
        // White noise of independent pixels, of another shape: the square in the middle counts.
        let slopes: Vec<f64> = (0..32)
            .map(|_| {
                let values: Vec<f64> = (0..100 * 70).map(|_| stream.normal()).collect();
                slope(&values, 100).expect("large enough")
            })
            .collect();
        let mean = slopes.iter().sum::<f64>() / slopes.len() as f64;
        assert!(mean.abs() < 0.1, "{mean}");
    }

    #[test]
    fn pictures_without_detail_have_no_slope() {
        assert_eq!(slope(&[0.3; 64 * 64], 64), None);
        assert_eq!(slope(&[0.0; 64 * 64], 64), None);
        let mut stream = Stream::new(6, &[]);
        let small: Vec<f64> = (0..64 * 31).map(|_| stream.normal()).collect();
        assert_eq!((slope(&small, 64), slope(&small, 31)), (None, None));
    }
}
