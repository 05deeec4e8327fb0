//! Sixteen lanes of AVX-512.

use super::{Integer, Mask, Real, Record, draw, halves};
use std::{
    arch::x86_64::*,
    ops::{Add, AddAssign, BitAnd, BitOr, Div, Mul, MulAssign, Neg, Not, Sub},
};

/// Sixteen lanes.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct F16(__m512);

/// Sixteen whole numbers.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct I16(__m512i);

/// Which of sixteen lanes.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct M16(__mmask16);

arithmetic!(F16, _mm512_set1_ps, _mm512_add_ps, _mm512_sub_ps, _mm512_mul_ps, _mm512_div_ps);
combine!(I16, Add, add, _mm512_add_epi32);
combine!(I16, Mul, mul, _mm512_mullo_epi32);

impl BitAnd for M16 {
    type Output = Self;
    #[inline(always)]
    fn bitand(self, o: Self) -> Self {
        Self(self.0 & o.0)
    }
}

impl BitOr for M16 {
    type Output = Self;
    #[inline(always)]
    fn bitor(self, o: Self) -> Self {
        Self(self.0 | o.0)
    }
}

impl Not for M16 {
    type Output = Self;
    #[inline(always)]
    fn not(self) -> Self {
        Self(!self.0)
    }
}

impl Mask for M16 {
    #[inline(always)]
    fn from_bits(bits: u32) -> Self {
        Self(bits as u16)
    }
    #[inline(always)]
    fn bits(self) -> u32 {
        u32::from(self.0)
    }
}

impl Integer for I16 {
    #[inline(always)]
    fn splat(value: i32) -> Self {
        Self(unsafe { _mm512_set1_epi32(value) })
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(unsafe { _mm512_min_epi32(self.0, o.0) })
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(unsafe { _mm512_max_epi32(self.0, o.0) })
    }
    #[inline(always)]
    fn load(from: &[u32]) -> Self {
        assert!(from.len() >= 16);
        Self(unsafe { _mm512_loadu_si512(from.as_ptr().cast()) })
    }
    #[inline(always)]
    fn store(self, to: &mut [u32]) {
        assert!(to.len() >= 16);
        unsafe { _mm512_storeu_si512(to.as_mut_ptr().cast(), self.0) }
    }
}

/// Rows as columns, in each quarter.
#[inline(always)]
fn turn([a, b, c, d]: [__m512; 4]) -> [__m512; 4] {
    unsafe {
        let (ab, cd) = (_mm512_unpacklo_ps(a, b), _mm512_unpacklo_ps(c, d));
        let (ba, dc) = (_mm512_unpackhi_ps(a, b), _mm512_unpackhi_ps(c, d));
        [
            _mm512_shuffle_ps::<0x44>(ab, cd),
            _mm512_shuffle_ps::<0xEE>(ab, cd),
            _mm512_shuffle_ps::<0x44>(ba, dc),
            _mm512_shuffle_ps::<0xEE>(ba, dc),
        ]
    }
}

impl Real for F16 {
    const N: usize = 16;
    type Mask = M16;
    type Integer = I16;
    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self(unsafe { _mm512_set1_ps(value) })
    }
    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        assert!(from.len() >= 16);
        Self(unsafe { _mm512_loadu_ps(from.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        assert!(to.len() >= 16);
        unsafe { _mm512_storeu_ps(to.as_mut_ptr(), self.0) }
    }
    #[inline(always)]
    fn compress(self, mask: M16, to: &mut [f32]) {
        // To a register, then to memory: the direct form is slow on some processors.
        Self(unsafe { _mm512_maskz_compress_ps(mask.0, self.0) }).store(to);
    }
    #[inline(always)]
    fn compress_integer(value: I16, mask: M16, to: &mut [u32]) {
        I16(unsafe { _mm512_maskz_compress_epi32(mask.0, value.0) }).store(to);
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(unsafe { _mm512_sqrt_ps(self.0) })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(unsafe { _mm512_abs_ps(self.0) })
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(unsafe { _mm512_min_ps(self.0, o.0) })
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(unsafe { _mm512_max_ps(self.0, o.0) })
    }
    #[inline(always)]
    fn floor(self) -> Self {
        Self(unsafe { _mm512_roundscale_ps::<0x09>(self.0) })
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        unsafe {
            let (bit, a, b) = (_mm512_set1_epi32(i32::MIN), _mm512_castps_si512(self.0), _mm512_castps_si512(sign.0));
            Self(_mm512_castsi512_ps(_mm512_or_si512(_mm512_andnot_si512(bit, a), _mm512_and_si512(bit, b))))
        }
    }
    #[inline(always)]
    fn lt(self, o: Self) -> M16 {
        M16(unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, o.0) })
    }
    #[inline(always)]
    fn le(self, o: Self) -> M16 {
        M16(unsafe { _mm512_cmp_ps_mask::<_CMP_LE_OQ>(self.0, o.0) })
    }
    #[inline(always)]
    fn equals(self, o: Self) -> M16 {
        M16(unsafe { _mm512_cmp_ps_mask::<_CMP_EQ_OQ>(self.0, o.0) })
    }
    #[inline(always)]
    fn select(mask: M16, yes: Self, no: Self) -> Self {
        Self(unsafe { _mm512_mask_blend_ps(mask.0, no.0, yes.0) })
    }
    #[inline(always)]
    fn to_integer(self) -> I16 {
        I16(unsafe { _mm512_cvttps_epi32(self.0) })
    }
    #[inline(always)]
    fn of_integer(value: I16) -> Self {
        Self(unsafe { _mm512_cvtepi32_ps(value.0) })
    }
    #[inline(always)]
    fn bits(self) -> I16 {
        I16(unsafe { _mm512_castps_si512(self.0) })
    }
    #[inline(always)]
    fn gather(from: &[f32], index: I16) -> Self {
        let Some(last) = from.len().checked_sub(1) else { return Self::zero() };
        unsafe {
            let index = _mm512_min_epu32(index.0, _mm512_set1_epi32(last.min(i32::MAX as usize) as i32));
            Self(_mm512_i32gather_ps::<4>(index, from.as_ptr()))
        }
    }
    #[inline(always)]
    fn gather_integer(from: &[u32], index: I16) -> I16 {
        let Some(last) = from.len().checked_sub(1) else { return I16::splat(0) };
        unsafe {
            let index = _mm512_min_epu32(index.0, _mm512_set1_epi32(last.min(i32::MAX as usize) as i32));
            I16(_mm512_i32gather_epi32::<4>(index, from.as_ptr().cast()))
        }
    }
    #[inline(always)]
    fn columns(from: &[Record], index: I16) -> [Self; 8] {
        let mut all = [0; 16];
        index.store(&mut all);
        let Some(at) = halves(from, all) else { return [Self::zero(); 8] };
        // Things k and k + 4: quarters are numbers 0 to 3 and 4 to 7 of the one, then of the other.
        macro_rules! pair {
            ($k:expr) => {
                unsafe {
                    _mm512_insertf32x8::<1>(_mm512_castps256_ps512(_mm256_load_ps(at[$k])), _mm256_load_ps(at[$k + 4]))
                }
            };
        }
        let low = turn([pair!(0), pair!(1), pair!(2), pair!(3)]);
        let high = turn([pair!(8), pair!(9), pair!(10), pair!(11)]);
        macro_rules! column {
            ($k:expr, $quarters:literal) => {
                Self(unsafe { _mm512_shuffle_f32x4::<$quarters>(low[$k], high[$k]) })
            };
        }
        [
            column!(0, 0x88),
            column!(1, 0x88),
            column!(2, 0x88),
            column!(3, 0x88),
            column!(0, 0xDD),
            column!(1, 0xDD),
            column!(2, 0xDD),
            column!(3, 0xDD),
        ]
    }
    #[inline(always)]
    fn put_columns([a, b, c, d, e, f, g, h]: [Self; 8], to: &mut [Record], half: usize) {
        let (low, high) = (turn([a.0, b.0, c.0, d.0]), turn([e.0, f.0, g.0, h.0]));
        let to = &mut to[..16];
        macro_rules! quarter {
            ($quarter:literal) => {
                for (k, (low, high)) in low.iter().zip(&high).enumerate() {
                    let to = to[4 * $quarter + k].0[8 * (half & 1)..].as_mut_ptr();
                    unsafe {
                        _mm_store_ps(to, _mm512_extractf32x4_ps::<$quarter>(*low));
                        _mm_store_ps(to.add(4), _mm512_extractf32x4_ps::<$quarter>(*high));
                    }
                }
            };
        }
        quarter!(0);
        quarter!(1);
        quarter!(2);
        quarter!(3);
    }
    #[inline(always)]
    fn same(a: I16, b: I16) -> M16 {
        M16(unsafe { _mm512_cmpeq_epi32_mask(a.0, b.0) })
    }
    #[inline(always)]
    fn select_integer(mask: M16, yes: I16, no: I16) -> I16 {
        I16(unsafe { _mm512_mask_blend_epi32(mask.0, no.0, yes.0) })
    }
    #[inline(always)]
    fn draw(states: &[u64], dimension: u64) -> (Self, Self) {
        let (a, b) = draw::<16>(states, dimension);
        (Self::load(&a), Self::load(&b))
    }
}
