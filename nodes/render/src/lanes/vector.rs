//! Vectors of two and three numbers by lane.

use super::{Mask, Real};
use glam::{Vec2, Vec3};
use std::ops::{Add, AddAssign, Mul, MulAssign, Neg, Sub};

/// Two numbers.
#[derive(Clone, Copy, Debug)]
pub struct Pair<R> {
    /// First.
    pub x: R,
    /// Second.
    pub y: R,
}

/// Three numbers: a vector, or RGB.
#[derive(Clone, Copy, Debug)]
pub struct Triple<R> {
    /// First.
    pub x: R,
    /// Second.
    pub y: R,
    /// Third.
    pub z: R,
}

impl<R: Real> Pair<R> {
    /// Of its parts.
    #[inline(always)]
    pub fn new(x: R, y: R) -> Self {
        Self { x, y }
    }
}

impl<R: Real> Triple<R> {
    /// Of its parts.
    #[inline(always)]
    pub fn new(x: R, y: R, z: R) -> Self {
        Self { x, y, z }
    }

    /// The same vector in every lane.
    #[inline(always)]
    pub fn splat(v: Vec3) -> Self {
        Self { x: R::splat(v.x), y: R::splat(v.y), z: R::splat(v.z) }
    }

    /// Three times the same number.
    #[inline(always)]
    pub fn all(v: R) -> Self {
        Self { x: v, y: v, z: v }
    }

    /// Zeros.
    #[inline(always)]
    pub fn zero() -> Self {
        Self::all(R::zero())
    }

    /// Scalar product.
    #[inline(always)]
    pub fn dot(self, o: Self) -> R {
        self.x * o.x + self.y * o.y + self.z * o.z
    }

    /// Vector product.
    #[inline(always)]
    pub fn cross(self, o: Self) -> Self {
        Self::new(self.y * o.z - self.z * o.y, self.z * o.x - self.x * o.z, self.x * o.y - self.y * o.x)
    }

    /// Length.
    #[inline(always)]
    pub fn length(self) -> R {
        self.dot(self).sqrt()
    }

    /// Normalised to length 1; zeros stay zeros.
    #[inline(always)]
    pub fn normalize(self) -> Self {
        let square = self.dot(self);
        let inverse = R::one() / square.sqrt();
        (self * inverse).only(square.positive() & square.finite())
    }

    /// Each part without its sign.
    #[inline(always)]
    pub fn abs(self) -> Self {
        Self::new(self.x.abs(), self.y.abs(), self.z.abs())
    }

    /// The largest part.
    #[inline(always)]
    pub fn largest(self) -> R {
        self.x.max(self.y).max(self.z)
    }

    /// `yes` in the lanes of the mask, `no` in the others.
    #[inline(always)]
    pub fn select(mask: R::Mask, yes: Self, no: Self) -> Self {
        Self::new(R::select(mask, yes.x, no.x), R::select(mask, yes.y, no.y), R::select(mask, yes.z, no.z))
    }

    /// Itself in the lanes of a mask, zeros in the others.
    #[inline(always)]
    pub fn only(self, mask: R::Mask) -> Self {
        Self::new(self.x.only(mask), self.y.only(mask), self.z.only(mask))
    }

    /// Whether all parts are finite.
    #[inline(always)]
    pub fn finite(self) -> R::Mask {
        self.x.finite() & self.y.finite() & self.z.finite()
    }

    /// Whether any part is not 0.
    #[inline(always)]
    pub fn some(self) -> R::Mask {
        let zero = R::zero();
        !(self.x.equals(zero) & self.y.equals(zero) & self.z.equals(zero))
    }

    /// Reads three rows from a place on.
    #[inline(always)]
    pub fn load(rows: [&[f32]; 3], at: usize) -> Self {
        Self::new(R::load(&rows[0][at..]), R::load(&rows[1][at..]), R::load(&rows[2][at..]))
    }

    /// The vector of one lane.
    pub fn lane(self, lane: usize) -> Vec3 {
        let mut row = [[0.0; 16]; 3];
        self.x.store(&mut row[0]);
        self.y.store(&mut row[1]);
        self.z.store(&mut row[2]);
        Vec3::new(row[0][lane], row[1][lane], row[2][lane])
    }

    /// True if no lane is not 0.
    #[inline(always)]
    pub fn none(self) -> bool {
        !self.some().any()
    }
}

impl From<Vec3> for Triple<f32> {
    #[inline(always)]
    fn from(v: Vec3) -> Self {
        Self { x: v.x, y: v.y, z: v.z }
    }
}

impl From<Triple<f32>> for Vec3 {
    #[inline(always)]
    fn from(v: Triple<f32>) -> Self {
        Self::new(v.x, v.y, v.z)
    }
}

impl From<Vec2> for Pair<f32> {
    #[inline(always)]
    fn from(v: Vec2) -> Self {
        Self { x: v.x, y: v.y }
    }
}

impl<R: Real> Add for Triple<R> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self::new(self.x + o.x, self.y + o.y, self.z + o.z)
    }
}

impl<R: Real> Sub for Triple<R> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self::new(self.x - o.x, self.y - o.y, self.z - o.z)
    }
}

impl<R: Real> Mul for Triple<R> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        Self::new(self.x * o.x, self.y * o.y, self.z * o.z)
    }
}

impl<R: Real> Mul<R> for Triple<R> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, o: R) -> Self {
        Self::new(self.x * o, self.y * o, self.z * o)
    }
}

impl<R: Real> Neg for Triple<R> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self::new(-self.x, -self.y, -self.z)
    }
}

impl<R: Real> AddAssign for Triple<R> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}

impl<R: Real> MulAssign for Triple<R> {
    #[inline(always)]
    fn mul_assign(&mut self, o: Self) {
        *self = *self * o;
    }
}
