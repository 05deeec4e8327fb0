//! Eight lanes of AVX2.

use super::{Integer, Mask, Real, Record, draw, halves, squeeze};
use std::{
    arch::x86_64::*,
    ops::{Add, AddAssign, BitAnd, BitOr, Div, Mul, MulAssign, Neg, Not, Sub},
};

/// Eight lanes.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct F8(__m256);

/// Eight whole numbers.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct I8(__m256i);

/// Which of eight lanes: all bits of a lane are set or none.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct M8(__m256);

arithmetic!(F8, _mm256_set1_ps, _mm256_add_ps, _mm256_sub_ps, _mm256_mul_ps, _mm256_div_ps);
combine!(M8, BitAnd, bitand, _mm256_and_ps);
combine!(M8, BitOr, bitor, _mm256_or_ps);
combine!(I8, Add, add, _mm256_add_epi32);
combine!(I8, Mul, mul, _mm256_mullo_epi32);

impl Not for M8 {
    type Output = Self;
    #[inline(always)]
    fn not(self) -> Self {
        Self(unsafe { _mm256_xor_ps(self.0, _mm256_castsi256_ps(_mm256_set1_epi32(-1))) })
    }
}

impl Mask for M8 {
    #[inline(always)]
    fn from_bits(bits: u32) -> Self {
        unsafe {
            let each = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            let own = _mm256_and_si256(_mm256_set1_epi32(bits as i32), each);
            Self(_mm256_castsi256_ps(_mm256_cmpeq_epi32(own, each)))
        }
    }
    #[inline(always)]
    fn bits(self) -> u32 {
        unsafe { _mm256_movemask_ps(self.0) as u32 }
    }
}

impl Integer for I8 {
    #[inline(always)]
    fn splat(value: i32) -> Self {
        Self(unsafe { _mm256_set1_epi32(value) })
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(unsafe { _mm256_min_epi32(self.0, o.0) })
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(unsafe { _mm256_max_epi32(self.0, o.0) })
    }
    #[inline(always)]
    fn load(from: &[u32]) -> Self {
        assert!(from.len() >= 8);
        Self(unsafe { _mm256_loadu_si256(from.as_ptr().cast()) })
    }
    #[inline(always)]
    fn store(self, to: &mut [u32]) {
        assert!(to.len() >= 8);
        unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), self.0) }
    }
}

/// Rows as columns, in each half.
#[inline(always)]
fn turn([a, b, c, d]: [__m256; 4]) -> [__m256; 4] {
    unsafe {
        let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
        let (ba, dc) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
        [
            _mm256_shuffle_ps::<0x44>(ab, cd),
            _mm256_shuffle_ps::<0xEE>(ab, cd),
            _mm256_shuffle_ps::<0x44>(ba, dc),
            _mm256_shuffle_ps::<0xEE>(ba, dc),
        ]
    }
}

impl Real for F8 {
    const N: usize = 8;
    type Mask = M8;
    type Integer = I8;
    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self(unsafe { _mm256_set1_ps(value) })
    }
    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        assert!(from.len() >= 8);
        Self(unsafe { _mm256_loadu_ps(from.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        assert!(to.len() >= 8);
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), self.0) }
    }
    #[inline(always)]
    fn compress(self, mask: M8, to: &mut [f32]) {
        let mut all = [0.0; 8];
        self.store(&mut all);
        squeeze(&all, mask.bits(), to);
    }
    #[inline(always)]
    fn compress_integer(value: I8, mask: M8, to: &mut [u32]) {
        let mut all = [0; 8];
        value.store(&mut all);
        squeeze(&all, mask.bits(), to);
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(unsafe { _mm256_sqrt_ps(self.0) })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0) })
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(unsafe { _mm256_min_ps(self.0, o.0) })
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(unsafe { _mm256_max_ps(self.0, o.0) })
    }
    #[inline(always)]
    fn floor(self) -> Self {
        Self(unsafe { _mm256_floor_ps(self.0) })
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        unsafe {
            let bit = _mm256_set1_ps(-0.0);
            Self(_mm256_or_ps(_mm256_andnot_ps(bit, self.0), _mm256_and_ps(bit, sign.0)))
        }
    }
    #[inline(always)]
    fn lt(self, o: Self) -> M8 {
        M8(unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, o.0) })
    }
    #[inline(always)]
    fn le(self, o: Self) -> M8 {
        M8(unsafe { _mm256_cmp_ps::<_CMP_LE_OQ>(self.0, o.0) })
    }
    #[inline(always)]
    fn equals(self, o: Self) -> M8 {
        M8(unsafe { _mm256_cmp_ps::<_CMP_EQ_OQ>(self.0, o.0) })
    }
    #[inline(always)]
    fn select(mask: M8, yes: Self, no: Self) -> Self {
        Self(unsafe { _mm256_blendv_ps(no.0, yes.0, mask.0) })
    }
    #[inline(always)]
    fn to_integer(self) -> I8 {
        I8(unsafe { _mm256_cvttps_epi32(self.0) })
    }
    #[inline(always)]
    fn of_integer(value: I8) -> Self {
        Self(unsafe { _mm256_cvtepi32_ps(value.0) })
    }
    #[inline(always)]
    fn bits(self) -> I8 {
        I8(unsafe { _mm256_castps_si256(self.0) })
    }
    #[inline(always)]
    fn gather(from: &[f32], index: I8) -> Self {
        let Some(last) = from.len().checked_sub(1) else { return Self::zero() };
        unsafe {
            let index = _mm256_min_epu32(index.0, _mm256_set1_epi32(last.min(i32::MAX as usize) as i32));
            Self(_mm256_i32gather_ps::<4>(from.as_ptr(), index))
        }
    }
    #[inline(always)]
    fn gather_integer(from: &[u32], index: I8) -> I8 {
        let Some(last) = from.len().checked_sub(1) else { return I8::splat(0) };
        unsafe {
            let index = _mm256_min_epu32(index.0, _mm256_set1_epi32(last.min(i32::MAX as usize) as i32));
            I8(_mm256_i32gather_epi32::<4>(from.as_ptr().cast(), index))
        }
    }
    #[inline(always)]
    fn columns(from: &[Record], index: I8) -> [Self; 8] {
        let mut all = [0; 8];
        index.store(&mut all);
        let Some(at) = halves(from, all) else { return [Self::zero(); 8] };
        // Numbers 0 to 3 of things 0 to 3 and 4 to 7, then 4 to 7.
        macro_rules! four {
            ($from:expr) => {
                turn(std::array::from_fn(|k| unsafe {
                    _mm256_insertf128_ps::<1>(
                        _mm256_castps128_ps256(_mm_load_ps(at[k].add($from))),
                        _mm_load_ps(at[k + 4].add($from)),
                    )
                }))
            };
        }
        let ([a, b, c, d], [e, f, g, h]) = (four!(0), four!(4));
        [Self(a), Self(b), Self(c), Self(d), Self(e), Self(f), Self(g), Self(h)]
    }
    #[inline(always)]
    fn put_columns([a, b, c, d, e, f, g, h]: [Self; 8], to: &mut [Record], half: usize) {
        let (low, high) = (turn([a.0, b.0, c.0, d.0]), turn([e.0, f.0, g.0, h.0]));
        let (first, rest) = to[..8].split_at_mut(4);
        for (k, (one, other)) in first.iter_mut().zip(rest).enumerate() {
            let (one, other) = (one.0[8 * (half & 1)..].as_mut_ptr(), other.0[8 * (half & 1)..].as_mut_ptr());
            unsafe {
                _mm_store_ps(one, _mm256_castps256_ps128(low[k]));
                _mm_store_ps(one.add(4), _mm256_castps256_ps128(high[k]));
                _mm_store_ps(other, _mm256_extractf128_ps::<1>(low[k]));
                _mm_store_ps(other.add(4), _mm256_extractf128_ps::<1>(high[k]));
            }
        }
    }
    #[inline(always)]
    fn same(a: I8, b: I8) -> M8 {
        M8(unsafe { _mm256_castsi256_ps(_mm256_cmpeq_epi32(a.0, b.0)) })
    }
    #[inline(always)]
    fn select_integer(mask: M8, yes: I8, no: I8) -> I8 {
        I8(unsafe { _mm256_blendv_epi8(no.0, yes.0, _mm256_castps_si256(mask.0)) })
    }
    #[inline(always)]
    fn draw(states: &[u64], dimension: u64) -> (Self, Self) {
        let (a, b) = draw::<8>(states, dimension);
        (Self::load(&a), Self::load(&b))
    }
}
