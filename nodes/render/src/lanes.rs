//! The same arithmetic on one number or on many side by side: `f32`, four lanes of SSE2, eight of AVX2, sixteen of
//! AVX-512.
//!
//! Only operations that IEEE 754 defines to the bit, and no fused multiply-add: what a lane computes does not depend on
//! how many there are. `f32` is the portable implementation, and what tests compare the others with. Code generic over
//! [`Real`] has no branch on a value: it computes both sides and selects.

mod maths;
mod vector;
#[cfg(target_arch = "x86_64")]
mod x86;

pub use maths::{acos, atan2, exp, sin_cos_turn};
use std::ops::{Add, AddAssign, BitAnd, BitOr, Div, Mul, MulAssign, Neg, Not, Sub};
pub use vector::{Pair, Triple};
#[cfg(target_arch = "x86_64")]
pub use x86::{F4, F8, F16};

/// Asks the memory for an element that is about to be read.
#[inline(always)]
pub fn ask_for<T>(of: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    x86::ask_for(of, at);
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (of, at);
}

/// Which lanes.
pub trait Mask: Copy + BitAnd<Output = Self> + BitOr<Output = Self> + Not<Output = Self> {
    /// The lanes whose bits are set.
    fn from_bits(bits: u32) -> Self;
    /// A bit for each lane.
    fn bits(self) -> u32;
    /// Whether any lane is in it.
    #[inline(always)]
    fn any(self) -> bool {
        self.bits() != 0
    }
}

/// Whole numbers of 32 bits, by lane.
pub trait Integer: Copy + Add<Output = Self> + Mul<Output = Self> {
    /// The same in every lane.
    fn splat(value: i32) -> Self;
    /// The smaller of each lane.
    fn min(self, other: Self) -> Self;
    /// The larger of each lane.
    fn max(self, other: Self) -> Self;
    /// Reads the first lanes of a slice that has as many.
    fn load(from: &[u32]) -> Self;
    /// Writes all lanes to a slice that has room for them.
    fn store(self, to: &mut [u32]);
}

/// Sixteen numbers of one thing, in one line of the cache: what many lanes read of as many things at once.
#[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(64))]
pub struct Record(pub [f32; 16]);

/// Real numbers of 32 bits, by lane.
pub trait Real:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Add<f32, Output = Self>
    + Sub<f32, Output = Self>
    + Mul<f32, Output = Self>
    + Div<f32, Output = Self>
    + AddAssign
    + MulAssign
{
    /// Lanes.
    const N: usize;
    /// Which lanes.
    type Mask: Mask;
    /// Whole numbers.
    type Integer: Integer;
    /// The same in every lane.
    fn splat(value: f32) -> Self;
    /// Reads the first lanes of a slice that has as many.
    fn load(from: &[f32]) -> Self;
    /// Writes all lanes to a slice that has room for them.
    fn store(self, to: &mut [f32]);
    /// Writes the lanes of a mask one after another to a slice that has room for all lanes.
    fn compress(self, mask: Self::Mask, to: &mut [f32]);
    /// [`Real::compress`] of whole numbers.
    fn compress_integer(value: Self::Integer, mask: Self::Mask, to: &mut [u32]);
    /// Square root.
    fn sqrt(self) -> Self;
    /// Without its sign.
    fn abs(self) -> Self;
    /// `self` if it is the smaller, else `other`, also if one is no number.
    fn min(self, other: Self) -> Self;
    /// `self` if it is the larger, else `other`, also if one is no number.
    fn max(self, other: Self) -> Self;
    /// Largest whole number that is not above.
    fn floor(self) -> Self;
    /// Copies the sign of the argument.
    fn copysign(self, sign: Self) -> Self;
    /// Less.
    fn lt(self, other: Self) -> Self::Mask;
    /// Less or equal.
    fn le(self, other: Self) -> Self::Mask;
    /// Equal.
    fn equals(self, other: Self) -> Self::Mask;
    /// `yes` in the lanes of the mask, `no` in the others.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// The whole number towards zero; the least one if that has more than 31 bits.
    fn to_integer(self) -> Self::Integer;
    /// The real number of a whole one.
    fn of_integer(value: Self::Integer) -> Self;
    /// The whole numbers of the same bits, as records hold them.
    fn bits(self) -> Self::Integer;
    /// Reads `from` at an index by lane; indices beyond it read its last number. An empty slice reads as 0.
    fn gather(from: &[f32], index: Self::Integer) -> Self;
    /// Reads whole numbers at an index by lane, as [`Real::gather`].
    fn gather_integer(from: &[u32], index: Self::Integer) -> Self::Integer;
    /// The eight numbers of the half records at an index by lane, number by number: those of a record `k` are at `2 k`
    /// and `2 k + 1`. Indices beyond them read the last half. No records read as 0.
    fn columns(from: &[Record], index: Self::Integer) -> [Self; 8];
    /// Writes half of the first records of a slice that has as many as there are lanes, number by number.
    fn put_columns(columns: [Self; 8], to: &mut [Record], half: usize);
    /// Equal whole numbers.
    fn same(a: Self::Integer, b: Self::Integer) -> Self::Mask;
    /// [`Real::select`] of whole numbers.
    fn select_integer(mask: Self::Mask, yes: Self::Integer, no: Self::Integer) -> Self::Integer;
    /// The 64-bit hashes of states and a dimension, as two numbers in [0, 1) of 24 bits each.
    fn draw(states: &[u64], dimension: u64) -> (Self, Self);

    /// Zero.
    #[inline(always)]
    fn zero() -> Self {
        Self::splat(0.0)
    }
    /// One.
    #[inline(always)]
    fn one() -> Self {
        Self::splat(1.0)
    }
    /// Greater.
    #[inline(always)]
    fn gt(self, other: Self) -> Self::Mask {
        other.lt(self)
    }
    /// Greater or equal.
    #[inline(always)]
    fn ge(self, other: Self) -> Self::Mask {
        other.le(self)
    }
    /// Greater than 0.
    #[inline(always)]
    fn positive(self) -> Self::Mask {
        Self::zero().lt(self)
    }
    /// Neither infinite nor no number.
    #[inline(always)]
    fn finite(self) -> Self::Mask {
        self.abs().lt(Self::splat(f32::INFINITY))
    }
    /// Itself in the lanes of a mask, 0 in the others.
    #[inline(always)]
    fn only(self, mask: Self::Mask) -> Self {
        Self::select(mask, self, Self::zero())
    }
    /// Within two numbers.
    #[inline(always)]
    fn clamp(self, low: f32, high: f32) -> Self {
        self.max(Self::splat(low)).min(Self::splat(high))
    }
}

impl Mask for bool {
    #[inline(always)]
    fn from_bits(bits: u32) -> Self {
        bits & 1 == 1
    }
    #[inline(always)]
    fn bits(self) -> u32 {
        u32::from(self)
    }
}

impl Integer for i32 {
    #[inline(always)]
    fn splat(value: i32) -> Self {
        value
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Ord::min(self, other)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Ord::max(self, other)
    }
    #[inline(always)]
    fn load(from: &[u32]) -> Self {
        from[0] as i32
    }
    #[inline(always)]
    fn store(self, to: &mut [u32]) {
        to[0] = self as u32;
    }
}

/// Two numbers in [0, 1) out of 64 bits.
#[inline(always)]
pub(crate) fn units(bits: u64) -> (f32, f32) {
    let unit = 1.0 / (1u32 << 24) as f32;
    ((bits >> 40) as i32 as f32 * unit, ((bits >> 16) & 0xFF_FFFF) as i32 as f32 * unit)
}

impl Real for f32 {
    const N: usize = 1;
    type Mask = bool;
    type Integer = i32;
    #[inline(always)]
    fn splat(value: f32) -> Self {
        value
    }
    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        from[0]
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        to[0] = self;
    }
    #[inline(always)]
    fn compress(self, mask: bool, to: &mut [f32]) {
        if mask {
            to[0] = self;
        }
    }
    #[inline(always)]
    fn compress_integer(value: i32, mask: bool, to: &mut [u32]) {
        if mask {
            to[0] = value as u32;
        }
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f32::sqrt(self)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        f32::abs(self)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
    #[inline(always)]
    fn floor(self) -> Self {
        f32::floor(self)
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        f32::copysign(self, sign)
    }
    #[inline(always)]
    fn lt(self, other: Self) -> bool {
        self < other
    }
    #[inline(always)]
    fn le(self, other: Self) -> bool {
        self <= other
    }
    #[inline(always)]
    fn equals(self, other: Self) -> bool {
        self == other
    }
    #[inline(always)]
    fn select(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }
    #[inline(always)]
    fn to_integer(self) -> i32 {
        // As the processor's own conversion has it for what does not fit.
        if f32::abs(self) < 2_147_483_648.0 { self as i32 } else { i32::MIN }
    }
    #[inline(always)]
    fn of_integer(value: i32) -> Self {
        value as f32
    }
    #[inline(always)]
    fn bits(self) -> i32 {
        self.to_bits() as i32
    }
    #[inline(always)]
    fn gather(from: &[f32], index: i32) -> Self {
        from.get(index as usize).or(from.last()).copied().unwrap_or(0.0)
    }
    #[inline(always)]
    fn gather_integer(from: &[u32], index: i32) -> i32 {
        from.get(index as usize).or(from.last()).copied().unwrap_or(0) as i32
    }
    #[inline(always)]
    fn columns(from: &[Record], index: i32) -> [Self; 8] {
        let index = (index as u32 as usize).min((2 * from.len()).saturating_sub(1));
        let record = from.get(index / 2).copied().unwrap_or_default();
        std::array::from_fn(|k| record.0[8 * (index % 2) + k])
    }
    #[inline(always)]
    fn put_columns(columns: [Self; 8], to: &mut [Record], half: usize) {
        to[0].0[8 * (half & 1)..][..8].copy_from_slice(&columns);
    }
    #[inline(always)]
    fn same(a: i32, b: i32) -> bool {
        a == b
    }
    #[inline(always)]
    fn select_integer(mask: bool, yes: i32, no: i32) -> i32 {
        if mask { yes } else { no }
    }
    #[inline(always)]
    fn draw(states: &[u64], dimension: u64) -> (Self, Self) {
        units(tauflow_data::rng::mix(states[0], dimension))
    }
}

#[cfg(test)]
mod tests;
