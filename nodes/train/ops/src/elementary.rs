//! Elementary functions in plain arithmetic: the same bits everywhere, and the compiler can do several at once.

#![expect(unsafe_code, reason = "results are written once; parts cover them")]

use crate::{fresh::filled, instructions::wide};
use rayon::prelude::*;
use std::mem::MaybeUninit;

/// Numbers that one thread maps at once.
const PART: usize = 8192;

/// A number that, added and taken off again, leaves the nearest whole number, and has it in its last bits meanwhile.
const ROUND: f32 = 12_582_912.0;

/// x = n ln 2 + r with |r| at most ln 2/2 (Cephes' constants); n also as 2^n.
#[inline(always)]
fn reduced(x: f32) -> (f32, f32) {
    let rounded = x * core::f32::consts::LOG2_E + ROUND;
    let n = rounded - ROUND;
    let power = f32::from_bits(rounded.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127) << 23);
    (x - n * 0.693_359_4 + n * 2.121_944_4e-4, power)
}

/// exp(r) - 1 for |r| up to ln 2/2 (Cephes' coefficients).
#[inline(always)]
fn small(r: f32) -> f32 {
    let mut p = 1.987_569_1e-4;
    p = p * r + 1.398_199_9e-3;
    p = p * r + 8.333_452e-3;
    p = p * r + 4.166_579_6e-2;
    p = p * r + 1.666_666_5e-1;
    p = p * r + 0.5;
    p * r * r + r
}

/// exp; the relative error is below 3e-7, and arguments are clamped to [-87, 87].
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    let (r, power) = reduced(x.clamp(-87.0, 87.0));
    (small(r) + 1.0) * power
}

/// exp(x) - 1 for x from 0 to 87, beyond which it stays; the relative error is below 5e-7.
#[inline(always)]
pub fn expm1(x: f32) -> f32 {
    let (r, power) = reduced(x.clamp(0.0, 87.0));
    small(r) * power + (power - 1.0)
}

/// log(1 + x) for finite x from 0 on; the relative error is below 3e-7.
#[inline(always)]
pub fn log1p(x: f32) -> f32 {
    let u = 1.0 + x;
    // The rounding error of the sum; log(u + lost) = log(u) + lost/u.
    let lost = if u < 1e7 { x - (u - 1.0) } else { 0.0 };
    // u = 2^n m with m from sqrt(1/2) to sqrt 2.
    let bits = u.to_bits().wrapping_sub(0x3f35_04f3);
    let n = ((bits as i32) >> 23) as f32;
    let f = f32::from_bits((bits & 0x007f_ffff).wrapping_add(0x3f35_04f3)) - 1.0;
    let mut p = 7.037_683_6e-2;
    p = p * f - 1.151_461e-1;
    p = p * f + 1.167_699_87e-1;
    p = p * f - 1.242_014_1e-1;
    p = p * f + 1.424_932_3e-1;
    p = p * f - 1.666_805_7e-1;
    p = p * f + 2.000_071_4e-1;
    p = p * f - 2.499_999_4e-1;
    p = p * f + 3.333_333e-1;
    let log = f * f * f * p - 0.5 * f * f + f;
    log + lost / u - n * 2.121_944_4e-4 + n * 0.693_359_4
}

/// A function of every number, many at once. Closures should be `#[inline(always)]`.
pub fn map(values: &[f32], f: impl Fn(f32) -> f32 + Sync) -> Vec<f32> {
    map2(values, values, |value, _| f(value))
}

/// A function of the numbers of two slices, as long as the shorter one, many at once.
pub fn map2(a: &[f32], b: &[f32], f: impl Fn(f32, f32) -> f32 + Sync) -> Vec<f32> {
    let len = a.len().min(b.len());
    let part = |out: &mut [MaybeUninit<f32>], a: &[f32], b: &[f32]| {
        wide(
            #[inline(always)]
            || {
                for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
                    out.write(f(*a, *b));
                }
            },
        );
    };
    // SAFETY: parts cover the result, and each is written from slices at least as long.
    unsafe {
        filled(len, |out| {
            let parts = out.par_chunks_mut(PART).zip(a.par_chunks(PART).zip(b.par_chunks(PART)));
            parts.for_each(|(out, (a, b))| part(out, a, b));
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(found: f32, expected: f64, what: &str) {
        assert!((f64::from(found) - expected).abs() <= 5e-7 * expected.abs(), "{what}: {found} {expected}");
    }

    #[test]
    fn exp_is_exp() {
        for i in -8600..8600 {
            let x = i as f32 * 0.01;
            near(exp(x), f64::from(x).exp(), &format!("exp {x}"));
        }
        assert!(exp(-1e9) < 1e-37 && exp(1e9).is_finite());
    }

    #[test]
    fn expm1_and_log1p_are_right_at_any_scale_and_invert() {
        for i in 0..20_000 {
            let x = (f64::from(i) * 0.006 - 100.0).exp2() as f32;
            near(log1p(x), f64::from(x).ln_1p(), &format!("log1p {x}"));
            if x < 87.0 {
                near(expm1(x), f64::from(x).exp_m1(), &format!("expm1 {x}"));
            }
            let back = expm1(log1p(x));
            assert!((back - x).abs() <= 1e-6 * x * log1p(x).max(1.0), "{x} {back}");
        }
        assert_eq!((log1p(0.0), expm1(0.0)), (0.0, 0.0));
        assert!(log1p(f32::MAX).is_finite() && expm1(1e9).is_finite());
    }

    #[test]
    fn maps_reach_every_number() {
        let values: Vec<f32> = (0..3 * PART + 17).map(|i| i as f32).collect();
        assert!(map(&values, |v| v + 1.0).iter().zip(&values).all(|(a, b)| *a == b + 1.0));
        assert_eq!(map2(&values, &[1.0, 2.0], |a, b| a * 10.0 + b), [1.0, 12.0]);
    }
}
