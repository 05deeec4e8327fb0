//! Values of Mitsuba's files: numbers, colours, spectra, transforms. Knows nothing of elements.

use tauflow_data::geom::{Vec3, add, cross, dot, length, mul, sub, unit};
use tauflow_data::{
    maths,
    scene::{Affine, IDENTITY},
};

/// A parameter's value.
#[derive(Clone, Debug)]
pub enum Value {
    /// `float` and `integer`.
    Number(f64),
    /// `boolean`.
    Bool(bool),
    /// `string`.
    Text(String),
    /// `rgb`, linear.
    Color([f64; 3]),
    /// `spectrum` with a value for all wavelengths.
    Uniform(f64),
    /// `spectrum` with values at wavelengths.
    Spectrum(Vec<(f64, f64)>),
    /// `point` and `vector`.
    Vector(Vec3),
    /// `transform`.
    Transform(Transform),
    /// A plugin inside, by its number.
    Plugin(usize),
    /// A plugin elsewhere, by its `id`.
    Reference(String),
}

/// A transform, and what it looks at if it is a `lookat` alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform {
    /// The map.
    pub map: Affine,
    /// Origin, target and up.
    pub look: Option<[Vec3; 3]>,
}

/// Numbers between spaces and commas.
pub(super) fn numbers(text: &str) -> Option<Vec<f64>> {
    let words = text.split([' ', ',', '\t', '\n', '\r']).filter(|word| !word.is_empty());
    words.map(|word| word.parse::<f64>().ok().filter(|v| v.is_finite())).collect()
}

/// Linear RGB of `r, g, b`, of one number, or of `#rrggbb`, which is in sRGB.
pub(super) fn color(text: &str, encoded: bool) -> Option<[f64; 3]> {
    let linear = |v: f64| if v <= 0.04045 { v / 12.92 } else { maths::pow((v + 0.055) / 1.055, 2.4) };
    if let Some(hex) = text.trim().strip_prefix('#') {
        let number = u32::from_str_radix(hex, 16).ok().filter(|_| hex.len() == 6)?;
        return Some([16, 8, 0].map(|shift| linear(f64::from(number >> shift & 255) / 255.0)));
    }
    let values = match numbers(text)?.as_slice() {
        [all] => [*all; 3],
        [r, g, b] => [*r, *g, *b],
        _ => return None,
    };
    Some(if encoded { values.map(linear) } else { values })
}

/// A spectrum of one value, or of values at wavelengths.
pub(super) fn spectrum(text: &str) -> Option<Value> {
    if !text.contains(':') {
        return numbers(text).filter(|n| n.len() == 1).map(|n| Value::Uniform(n[0]));
    }
    let pair = |word: &str| {
        let (nm, value) = word.split_once(':')?;
        Some((numbers(nm)?.first().copied()?, numbers(value)?.first().copied()?))
    };
    let points: Vec<(f64, f64)> = text.split(',').map(pair).collect::<Option<_>>()?;
    points.windows(2).all(|w| w[0].0 < w[1].0).then_some(Value::Spectrum(points))
}

/// Sine and cosine of an angle in degrees; those of quarter turns are exact.
fn turns(degrees: f64) -> [f64; 2] {
    let turns = degrees / 90.0;
    if turns != turns.round() {
        return [maths::sin(degrees.to_radians()), maths::cos(degrees.to_radians())];
    }
    match turns.rem_euclid(4.0) as u8 {
        0 => [0.0, 1.0],
        1 => [1.0, 0.0],
        2 => [0.0, -1.0],
        _ => [-1.0, 0.0],
    }
}

/// The rotation by degrees about an axis; none for an axis without direction.
pub fn rotation(axis: Vec3, degrees: f64) -> Option<Affine> {
    if dot(axis, axis).is_nan() || dot(axis, axis) <= 0.0 {
        return None;
    }
    let a = unit(axis);
    let [s, c] = turns(degrees);
    let mut out = IDENTITY;
    for r in 0..3 {
        for k in 0..3 {
            let turned = match (k + 3 - r) % 3 {
                0 => c,
                1 => -s * a[(r + 2) % 3],
                _ => s * a[(r + 1) % 3],
            };
            out[r][k] = a[r] * a[k] * (1.0 - c) + turned;
        }
    }
    Some(out)
}

/// Mitsuba's `rotate`. It takes the axis as it is: one of another length than 1 scales and shears, too.
pub(super) fn rotate(axis: Vec3, degrees: f64) -> Option<Affine> {
    let even = rotation(axis, degrees)?;
    let size = length(axis);
    if (size - 1.0).abs() < 1e-6 {
        return Some(even);
    }
    // The parts of a rotation that go with the axis' products, with the axis itself, and with neither.
    let (a, c) = (unit(axis), turns(degrees)[1]);
    let mut out = IDENTITY;
    for r in 0..3 {
        for k in 0..3 {
            let same = if r == k { c } else { 0.0 };
            let product = a[r] * a[k] * (1.0 - c);
            out[r][k] = product * size * size + same + (even[r][k] - product - same) * size;
        }
    }
    Some(out)
}

/// Mitsuba's `lookat`: +z along the view, +y up, +x to the left of the picture.
pub(super) fn look(origin: Vec3, target: Vec3, up: Vec3) -> Option<Affine> {
    let forward = sub(target, origin);
    let left = cross(up, forward);
    if !(dot(forward, forward) > 0.0 && dot(left, left) > 0.0) {
        return None;
    }
    let (forward, left) = (unit(forward), unit(left));
    let up = cross(forward, left);
    Some([0, 1, 2].map(|r| [left[r], up[r], forward[r], origin[r]]))
}

/// The `up` that Mitsuba takes where none is given: the first tangent of Duff et al. 2017.
pub(super) fn any_up(n: Vec3) -> Vec3 {
    let sign = if n[2] >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (sign + n[2]);
    add([1.0, 0.0, 0.0], mul([n[0] * n[0] * a, n[0] * n[1] * a, -n[0]], sign))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transforms_are_mitsubas() {
        let near = |a: Affine, b: Affine| {
            assert!(a.iter().flatten().zip(b.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-9), "{a:?} {b:?}");
        };
        // Printed by Mitsuba 3.9.1.
        near(
            look([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0]).expect("a view"),
            [[-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 5.0]],
        );
        near(
            look([0.0, 0.0, 5.0], [0.0; 3], any_up([0.0, 0.0, -1.0])).expect("a view"),
            [[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 5.0]],
        );
        near(
            rotation([0.0, 2.0, 0.0], 90.0).expect("an axis"),
            [[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0]],
        );
        let odd = rotation([1.0, 2.0, 3.0], 40.0).expect("an axis");
        assert!((tauflow_data::geom::determinant(&odd) - 1.0).abs() < 1e-12);
        assert!((odd[0][0] + odd[1][1] + odd[2][2] - 1.0 - 2.0 * maths::cos(40f64.to_radians())).abs() < 1e-12);
        assert_eq!((look([0.0; 3], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]), rotation([0.0; 3], 1.0)), (None, None));
    }

    #[test]
    fn an_axis_of_another_length_than_1_scales_as_in_mitsuba() {
        // From Mitsuba 3.9.1.
        let expected = [[1.0, -1.46045, 1.98744], [2.39627, 1.70187, 0.760_946], [-0.583_709, 2.04652, 2.87164]];
        let found = rotate([1.0, 2.0, 3.0], 40.0).expect("an axis");
        let pairs = found.iter().zip(expected).flat_map(|(row, other)| row.iter().copied().zip(other));
        assert!(pairs.clone().all(|(a, b): (f64, f64)| (a - b).abs() < 1e-4), "{found:?}");
        let quarter = rotate([0.0, 2.0, 0.0], 90.0).expect("an axis");
        assert_eq!(quarter.map(|row| [row[0], row[1], row[2]]), [[0.0, 0.0, 2.0], [0.0, 4.0, 0.0], [-2.0, 0.0, 0.0]]);
        assert_eq!(rotate([0.0, 1.0, 0.0], 30.0), rotation([0.0, 1.0, 0.0], 30.0));
    }

    #[test]
    fn colours_and_spectra_are_read_in_all_their_ways() {
        assert_eq!(color("0.5", false), Some([0.5; 3]));
        assert_eq!(color("1 2,3", false), Some([1.0, 2.0, 3.0]));
        let hex = color("#ff8000", false).expect("a colour");
        assert!((hex[1] - 0.215_860_5).abs() < 1e-6 && hex[0] == 1.0 && hex[2] == 0.0);
        assert_eq!((color("#ff80", false), color("1 2", false), color("nan", false)), (None, None, None));
        assert!(matches!(spectrum("0.5"), Some(Value::Uniform(v)) if v == 0.5));
        assert!(matches!(spectrum("400:1, 500:2"), Some(Value::Spectrum(v)) if v == [(400.0, 1.0), (500.0, 2.0)]));
        assert!(spectrum("500:1, 400:2").is_none());
    }
}
