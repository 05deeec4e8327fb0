//! Small vectors and affine maps in f64, for building scenes. Knows nothing of shapes or cameras.

use crate::{
    maths,
    scene::{Affine, IDENTITY},
};

/// A point or direction, y up.
pub type Vec3 = [f64; 3];

/// `a + b`.
pub fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `a - b`.
pub fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a` scaled by `s`.
pub fn mul(a: Vec3, s: f64) -> Vec3 {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// The dot product.
pub fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The cross product.
pub fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The Euclidean length.
pub fn length(a: Vec3) -> f64 {
    dot(a, a).sqrt()
}

/// The unit vector along `a`; +y for a vector without length.
pub fn unit(a: Vec3) -> Vec3 {
    let l = length(a);
    if l > 0.0 { mul(a, 1.0 / l) } else { [0.0, 1.0, 0.0] }
}

/// Direction of an azimuth (about +y, from +z towards +x) and an elevation, radians.
pub fn direction(azimuth: f64, elevation: f64) -> Vec3 {
    let c = maths::cos(elevation);
    [c * maths::sin(azimuth), maths::sin(elevation), c * maths::cos(azimuth)]
}

/// `a` after `b`.
pub fn compose(a: &Affine, b: &Affine) -> Affine {
    let mut out = IDENTITY;
    for (row, from) in out.iter_mut().zip(a) {
        for (c, cell) in row.iter_mut().enumerate() {
            *cell = from[0] * b[0][c] + from[1] * b[1][c] + from[2] * b[2][c] + if c == 3 { from[3] } else { 0.0 };
        }
    }
    out
}

/// The map that moves by `t`.
pub fn translation(t: Vec3) -> Affine {
    [[1.0, 0.0, 0.0, t[0]], [0.0, 1.0, 0.0, t[1]], [0.0, 0.0, 1.0, t[2]]]
}

/// The map that scales each axis.
pub fn scaling(s: Vec3) -> Affine {
    [[s[0], 0.0, 0.0, 0.0], [0.0, s[1], 0.0, 0.0], [0.0, 0.0, s[2], 0.0]]
}

/// Rotation about +y by `angle` radians, +z towards +x.
pub fn rotation_y(angle: f64) -> Affine {
    let (s, c) = (maths::sin(angle), maths::cos(angle));
    [[c, 0.0, s, 0.0], [0.0, 1.0, 0.0, 0.0], [-s, 0.0, c, 0.0]]
}

/// Rotation about +x by `angle` radians.
pub fn rotation_x(angle: f64) -> Affine {
    let (s, c) = (maths::sin(angle), maths::cos(angle));
    [[1.0, 0.0, 0.0, 0.0], [0.0, c, -s, 0.0], [0.0, s, c, 0.0]]
}

/// Rotation about +z by `angle` radians.
pub fn rotation_z(angle: f64) -> Affine {
    let (s, c) = (maths::sin(angle), maths::cos(angle));
    [[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
}

/// A map whose local +z looks along `forward`, at `origin`, local x and y scaled by `half`.
pub fn facing(origin: Vec3, forward: Vec3, half: [f64; 2]) -> Affine {
    let w = unit(forward);
    let reference = if w[1].abs() > 0.99 { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] };
    let u = unit(cross(reference, w));
    let v = cross(w, u);
    let mut out = IDENTITY;
    for (r, row) in out.iter_mut().enumerate() {
        *row = [u[r] * half[0], v[r] * half[1], w[r], origin[r]];
    }
    out
}

/// The point `p`, mapped.
pub fn apply(m: &Affine, p: Vec3) -> Vec3 {
    [0, 1, 2].map(|r| m[r][0] * p[0] + m[r][1] * p[1] + m[r][2] * p[2] + m[r][3])
}

/// Determinant of the linear part.
pub fn determinant(m: &Affine) -> f64 {
    let row = |r: usize| [m[r][0], m[r][1], m[r][2]];
    dot(row(0), cross(row(1), row(2)))
}

/// A box along the axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Least coordinates.
    pub low: Vec3,
    /// Largest coordinates.
    pub high: Vec3,
}

impl Aabb {
    /// Holds nothing; grows to what is added.
    pub const EMPTY: Self = Self { low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3] };

    /// A box by its middle and half sizes.
    pub fn around(center: Vec3, half: Vec3) -> Self {
        Self { low: sub(center, half), high: add(center, half) }
    }

    /// Takes in a point.
    pub fn grow(&mut self, p: Vec3) {
        for (i, v) in p.into_iter().enumerate() {
            self.low[i] = self.low[i].min(v);
            self.high[i] = self.high[i].max(v);
        }
    }

    /// The box of both.
    pub fn union(mut self, other: &Self) -> Self {
        self.grow(other.low);
        self.grow(other.high);
        self
    }

    /// Its middle.
    pub fn center(&self) -> Vec3 {
        mul(add(self.low, self.high), 0.5)
    }

    /// Its extent along each axis.
    pub fn size(&self) -> Vec3 {
        sub(self.high, self.low)
    }

    /// The box of this one's corners after a map.
    pub fn mapped(&self, m: &Affine) -> Self {
        let mut out = Self::EMPTY;
        for corner in 0..8 {
            let pick = |i: usize| if corner >> i & 1 == 0 { self.low[i] } else { self.high[i] };
            out.grow(apply(m, [pick(0), pick(1), pick(2)]));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_compose() {
        let m = compose(&translation([1.0, 2.0, 3.0]), &rotation_y(core::f64::consts::FRAC_PI_2));
        let p = apply(&m, [0.0, 0.0, 1.0]);
        assert!(length(sub(p, [2.0, 2.0, 3.0])) < 1e-12, "{p:?}");
        assert!((determinant(&m) - 1.0).abs() < 1e-12);
        let f = facing([0.0; 3], [0.0, -1.0, 0.0], [2.0, 3.0]);
        assert!((determinant(&f) - 6.0).abs() < 1e-12);
    }
}
