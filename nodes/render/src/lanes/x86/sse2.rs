//! Four lanes of SSE2.

use super::{Integer, Mask, Real, Record, draw, halves, squeeze};
use std::{
    arch::x86_64::*,
    ops::{Add, AddAssign, BitAnd, BitOr, Div, Mul, MulAssign, Neg, Not, Sub},
};

/// Four lanes.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct F4(__m128);

/// Four whole numbers.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct I4([i32; 4]);

/// Which of four lanes: all bits of a lane are set or none.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct M4(__m128);

arithmetic!(F4, _mm_set1_ps, _mm_add_ps, _mm_sub_ps, _mm_mul_ps, _mm_div_ps);
combine!(M4, BitAnd, bitand, _mm_and_ps);
combine!(M4, BitOr, bitor, _mm_or_ps);

impl Add for I4 {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i].wrapping_add(o.0[i])))
    }
}

impl Mul for I4 {
    type Output = Self;
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i].wrapping_mul(o.0[i])))
    }
}

impl Not for M4 {
    type Output = Self;
    #[inline(always)]
    fn not(self) -> Self {
        Self(unsafe { _mm_xor_ps(self.0, _mm_castsi128_ps(_mm_set1_epi32(-1))) })
    }
}

impl Mask for M4 {
    #[inline(always)]
    fn from_bits(bits: u32) -> Self {
        unsafe {
            let each = _mm_setr_epi32(1, 2, 4, 8);
            let own = _mm_and_si128(_mm_set1_epi32(bits as i32), each);
            Self(_mm_castsi128_ps(_mm_cmpeq_epi32(own, each)))
        }
    }
    #[inline(always)]
    fn bits(self) -> u32 {
        unsafe { _mm_movemask_ps(self.0) as u32 }
    }
}

impl Integer for I4 {
    #[inline(always)]
    fn splat(value: i32) -> Self {
        Self([value; 4])
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(std::array::from_fn(|i| Ord::min(self.0[i], o.0[i])))
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(std::array::from_fn(|i| Ord::max(self.0[i], o.0[i])))
    }
    #[inline(always)]
    fn load(from: &[u32]) -> Self {
        Self(std::array::from_fn(|i| from[i] as i32))
    }
    #[inline(always)]
    fn store(self, to: &mut [u32]) {
        for (to, value) in to.iter_mut().zip(self.0) {
            *to = value as u32;
        }
    }
}

/// Rows as columns.
#[inline(always)]
pub(super) fn turn([a, b, c, d]: [__m128; 4]) -> [__m128; 4] {
    unsafe {
        let (ab, cd) = (_mm_unpacklo_ps(a, b), _mm_unpacklo_ps(c, d));
        let (ba, dc) = (_mm_unpackhi_ps(a, b), _mm_unpackhi_ps(c, d));
        [_mm_movelh_ps(ab, cd), _mm_movehl_ps(cd, ab), _mm_movelh_ps(ba, dc), _mm_movehl_ps(dc, ba)]
    }
}

impl Real for F4 {
    const N: usize = 4;
    type Mask = M4;
    type Integer = I4;
    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self(unsafe { _mm_set1_ps(value) })
    }
    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        assert!(from.len() >= 4);
        Self(unsafe { _mm_loadu_ps(from.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        assert!(to.len() >= 4);
        unsafe { _mm_storeu_ps(to.as_mut_ptr(), self.0) }
    }
    #[inline(always)]
    fn compress(self, mask: M4, to: &mut [f32]) {
        let mut all = [0.0; 4];
        self.store(&mut all);
        squeeze(&all, mask.bits(), to);
    }
    #[inline(always)]
    fn compress_integer(value: I4, mask: M4, to: &mut [u32]) {
        squeeze(&value.0.map(|v| v as u32), mask.bits(), to);
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(unsafe { _mm_sqrt_ps(self.0) })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(unsafe { _mm_andnot_ps(_mm_set1_ps(-0.0), self.0) })
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(unsafe { _mm_min_ps(self.0, o.0) })
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(unsafe { _mm_max_ps(self.0, o.0) })
    }
    #[inline(always)]
    fn floor(self) -> Self {
        let mut all = [0.0; 4];
        self.store(&mut all);
        Self::load(&all.map(f32::floor))
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        unsafe {
            let bit = _mm_set1_ps(-0.0);
            Self(_mm_or_ps(_mm_andnot_ps(bit, self.0), _mm_and_ps(bit, sign.0)))
        }
    }
    #[inline(always)]
    fn lt(self, o: Self) -> M4 {
        M4(unsafe { _mm_cmplt_ps(self.0, o.0) })
    }
    #[inline(always)]
    fn le(self, o: Self) -> M4 {
        M4(unsafe { _mm_cmple_ps(self.0, o.0) })
    }
    #[inline(always)]
    fn equals(self, o: Self) -> M4 {
        M4(unsafe { _mm_cmpeq_ps(self.0, o.0) })
    }
    #[inline(always)]
    fn select(mask: M4, yes: Self, no: Self) -> Self {
        Self(unsafe { _mm_or_ps(_mm_and_ps(mask.0, yes.0), _mm_andnot_ps(mask.0, no.0)) })
    }
    #[inline(always)]
    fn to_integer(self) -> I4 {
        let mut all = [0; 4];
        unsafe { _mm_storeu_si128(all.as_mut_ptr().cast(), _mm_cvttps_epi32(self.0)) }
        I4(all)
    }
    #[inline(always)]
    fn of_integer(value: I4) -> Self {
        Self::load(&value.0.map(|v| v as f32))
    }
    #[inline(always)]
    fn bits(self) -> I4 {
        let mut row = [0.0; 4];
        self.store(&mut row);
        I4(row.map(|v| v.to_bits() as i32))
    }
    #[inline(always)]
    fn gather(from: &[f32], index: I4) -> Self {
        Self::load(&index.0.map(|i| f32::gather(from, i)))
    }
    #[inline(always)]
    fn gather_integer(from: &[u32], index: I4) -> I4 {
        I4(index.0.map(|i| f32::gather_integer(from, i)))
    }
    #[inline(always)]
    fn columns(from: &[Record], index: I4) -> [Self; 8] {
        let Some(at) = halves(from, index.0.map(|i| i as u32)) else { return [Self::zero(); 8] };
        let [a, b, c, d] = turn(at.map(|at| unsafe { _mm_load_ps(at) }));
        let [e, f, g, h] = turn(at.map(|at| unsafe { _mm_load_ps(at.add(4)) }));
        [Self(a), Self(b), Self(c), Self(d), Self(e), Self(f), Self(g), Self(h)]
    }
    #[inline(always)]
    fn put_columns([a, b, c, d, e, f, g, h]: [Self; 8], to: &mut [Record], half: usize) {
        let (low, high) = (turn([a.0, b.0, c.0, d.0]), turn([e.0, f.0, g.0, h.0]));
        for ((record, low), high) in to[..4].iter_mut().zip(low).zip(high) {
            let to = record.0[8 * (half & 1)..].as_mut_ptr();
            unsafe {
                _mm_store_ps(to, low);
                _mm_store_ps(to.add(4), high);
            }
        }
    }
    #[inline(always)]
    fn same(a: I4, b: I4) -> M4 {
        let bit = |i: usize| u32::from(a.0[i] == b.0[i]) << i;
        M4::from_bits(bit(0) | bit(1) | bit(2) | bit(3))
    }
    #[inline(always)]
    fn select_integer(mask: M4, yes: I4, no: I4) -> I4 {
        let bits = mask.bits();
        I4(std::array::from_fn(|i| if bits >> i & 1 == 1 { yes.0[i] } else { no.0[i] }))
    }
    #[inline(always)]
    fn draw(states: &[u64], dimension: u64) -> (Self, Self) {
        let (a, b) = draw::<4>(states, dimension);
        (Self::load(&a), Self::load(&b))
    }
}
