//! Lanes of SSE2, which every x86-64 processor has, AVX2 and AVX-512.
//!
//! These types may only be used where the processor has the instructions: inside a function with the target features of
//! [`crate::dispatch`], into which everything here is inlined. Outside, calling them is undefined; hence nothing but
//! generic kernels names them.
#![allow(unsafe_code, reason = "intrinsics; each is sound on a processor that has it, which dispatch makes sure of")]

use super::{Mask, Real, Whole, units};
use std::{
    arch::x86_64::*,
    ops::{Add, AddAssign, BitAnd, BitOr, Div, Mul, MulAssign, Neg, Not, Sub},
};
use tauflow_data::rng::mix;

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

/// Eight lanes.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct F8(__m256);

/// Sixteen lanes.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct F16(__m512);

/// Eight whole numbers.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct I8(__m256i);

/// Sixteen whole numbers.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct I16(__m512i);

/// Which of eight lanes: all bits of a lane are set or none.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct M8(__m256);

/// Which of sixteen lanes.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct M16(__mmask16);

macro_rules! arithmetic {
    ($real:ident, $set:ident, $add:ident, $sub:ident, $mul:ident, $div:ident) => {
        arithmetic!(@binary $real, Add, add, $add, $set);
        arithmetic!(@binary $real, Sub, sub, $sub, $set);
        arithmetic!(@binary $real, Mul, mul, $mul, $set);
        arithmetic!(@binary $real, Div, div, $div, $set);
        impl Neg for $real {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                // 0 - x would lose the sign of 0.
                self * -1.0
            }
        }
        impl AddAssign for $real {
            #[inline(always)]
            fn add_assign(&mut self, o: Self) {
                *self = *self + o;
            }
        }
        impl MulAssign for $real {
            #[inline(always)]
            fn mul_assign(&mut self, o: Self) {
                *self = *self * o;
            }
        }
    };
    (@binary $real:ident, $trait:ident, $name:ident, $op:ident, $set:ident) => {
        impl $trait for $real {
            type Output = Self;
            #[inline(always)]
            fn $name(self, o: Self) -> Self {
                Self(unsafe { $op(self.0, o.0) })
            }
        }
        impl $trait<f32> for $real {
            type Output = Self;
            #[inline(always)]
            fn $name(self, o: f32) -> Self {
                Self(unsafe { $op(self.0, $set(o)) })
            }
        }
    };
}

arithmetic!(F4, _mm_set1_ps, _mm_add_ps, _mm_sub_ps, _mm_mul_ps, _mm_div_ps);
arithmetic!(F8, _mm256_set1_ps, _mm256_add_ps, _mm256_sub_ps, _mm256_mul_ps, _mm256_div_ps);
arithmetic!(F16, _mm512_set1_ps, _mm512_add_ps, _mm512_sub_ps, _mm512_mul_ps, _mm512_div_ps);

macro_rules! combine {
    ($mask:ident, $trait:ident, $name:ident, $op:ident) => {
        impl $trait for $mask {
            type Output = Self;
            #[inline(always)]
            fn $name(self, o: Self) -> Self {
                Self(unsafe { $op(self.0, o.0) })
            }
        }
    };
}

combine!(M4, BitAnd, bitand, _mm_and_ps);
combine!(M4, BitOr, bitor, _mm_or_ps);
combine!(M8, BitAnd, bitand, _mm256_and_ps);
combine!(M8, BitOr, bitor, _mm256_or_ps);
combine!(I8, Add, add, _mm256_add_epi32);
combine!(I8, Mul, mul, _mm256_mullo_epi32);
combine!(I16, Add, add, _mm512_add_epi32);
combine!(I16, Mul, mul, _mm512_mullo_epi32);

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

impl Whole for I4 {
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

impl Whole for I8 {
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

impl Whole for I16 {
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

#[inline(always)]
fn squeeze<const N: usize>(all: &[f32; N], mut bits: u32, to: &mut [f32]) {
    let mut at = 0;
    while bits != 0 {
        to[at] = all[bits.trailing_zeros() as usize % N];
        bits &= bits - 1;
        at += 1;
    }
}

#[inline(always)]
fn draw<const N: usize>(states: &[u64], dimension: u64) -> ([f32; N], [f32; N]) {
    let (mut a, mut b) = ([0.0; N], [0.0; N]);
    let states = &states[..N];
    for lane in 0..N {
        (a[lane], b[lane]) = units(mix(states[lane], dimension));
    }
    (a, b)
}

impl Real for F4 {
    const N: usize = 4;
    type Mask = M4;
    type Whole = I4;
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
    fn whole(self) -> I4 {
        let mut all = [0; 4];
        unsafe { _mm_storeu_si128(all.as_mut_ptr().cast(), _mm_cvttps_epi32(self.0)) }
        I4(all)
    }
    #[inline(always)]
    fn of_whole(value: I4) -> Self {
        Self::load(&value.0.map(|v| v as f32))
    }
    #[inline(always)]
    fn gather(from: &[f32], index: I4) -> Self {
        Self::load(&index.0.map(|i| f32::gather(from, i)))
    }
    #[inline(always)]
    fn gather_whole(from: &[u32], index: I4) -> I4 {
        I4(index.0.map(|i| f32::gather_whole(from, i)))
    }
    #[inline(always)]
    fn same(a: I4, b: I4) -> M4 {
        let bit = |i: usize| u32::from(a.0[i] == b.0[i]) << i;
        M4::from_bits(bit(0) | bit(1) | bit(2) | bit(3))
    }
    #[inline(always)]
    fn select_whole(mask: M4, yes: I4, no: I4) -> I4 {
        let bits = mask.bits();
        I4(std::array::from_fn(|i| if bits >> i & 1 == 1 { yes.0[i] } else { no.0[i] }))
    }
    #[inline(always)]
    fn draw(states: &[u64], dimension: u64) -> (Self, Self) {
        let (a, b) = draw::<4>(states, dimension);
        (Self::load(&a), Self::load(&b))
    }
}

impl Real for F8 {
    const N: usize = 8;
    type Mask = M8;
    type Whole = I8;
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
    fn whole(self) -> I8 {
        I8(unsafe { _mm256_cvttps_epi32(self.0) })
    }
    #[inline(always)]
    fn of_whole(value: I8) -> Self {
        Self(unsafe { _mm256_cvtepi32_ps(value.0) })
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
    fn gather_whole(from: &[u32], index: I8) -> I8 {
        let Some(last) = from.len().checked_sub(1) else { return I8::splat(0) };
        unsafe {
            let index = _mm256_min_epu32(index.0, _mm256_set1_epi32(last.min(i32::MAX as usize) as i32));
            I8(_mm256_i32gather_epi32::<4>(from.as_ptr().cast(), index))
        }
    }
    #[inline(always)]
    fn same(a: I8, b: I8) -> M8 {
        M8(unsafe { _mm256_castsi256_ps(_mm256_cmpeq_epi32(a.0, b.0)) })
    }
    #[inline(always)]
    fn select_whole(mask: M8, yes: I8, no: I8) -> I8 {
        I8(unsafe { _mm256_blendv_epi8(no.0, yes.0, _mm256_castps_si256(mask.0)) })
    }
    #[inline(always)]
    fn draw(states: &[u64], dimension: u64) -> (Self, Self) {
        let (a, b) = draw::<8>(states, dimension);
        (Self::load(&a), Self::load(&b))
    }
}

impl Real for F16 {
    const N: usize = 16;
    type Mask = M16;
    type Whole = I16;
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
    fn whole(self) -> I16 {
        I16(unsafe { _mm512_cvttps_epi32(self.0) })
    }
    #[inline(always)]
    fn of_whole(value: I16) -> Self {
        Self(unsafe { _mm512_cvtepi32_ps(value.0) })
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
    fn gather_whole(from: &[u32], index: I16) -> I16 {
        let Some(last) = from.len().checked_sub(1) else { return I16::splat(0) };
        unsafe {
            let index = _mm512_min_epu32(index.0, _mm512_set1_epi32(last.min(i32::MAX as usize) as i32));
            I16(_mm512_i32gather_epi32::<4>(index, from.as_ptr().cast()))
        }
    }
    #[inline(always)]
    fn same(a: I16, b: I16) -> M16 {
        M16(unsafe { _mm512_cmpeq_epi32_mask(a.0, b.0) })
    }
    #[inline(always)]
    fn select_whole(mask: M16, yes: I16, no: I16) -> I16 {
        I16(unsafe { _mm512_mask_blend_epi32(mask.0, no.0, yes.0) })
    }
    #[inline(always)]
    fn draw(states: &[u64], dimension: u64) -> (Self, Self) {
        let (a, b) = draw::<16>(states, dimension);
        (Self::load(&a), Self::load(&b))
    }
}
