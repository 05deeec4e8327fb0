//! Lanes of SSE2, which every x86-64 processor has, AVX2 and AVX-512.
//!
//! These types may only be used where the processor has the instructions: inside a function with the target features of
//! [`crate::dispatch`], into which everything here is inlined. Outside, calling them is undefined; hence nothing but
//! generic kernels names them.
#![expect(
    unsafe_code,
    clippy::undocumented_unsafe_blocks,
    reason = "intrinsics, of one invariant: each is sound on a processor that has it, which dispatch makes sure of"
)]

use super::{Integer, Mask, Real, Record, units};
use tauflow_data::rng::mix;

/// Asks for the lines of the cache that an element is in. Every x86-64 processor has the instruction, and it reads
/// nothing itself.
#[inline(always)]
pub fn ask_for<T>(of: &[T], at: usize) {
    let Some(element) = of.get(at) else { return };
    let from = std::ptr::from_ref(element).cast::<i8>();
    for line in (0..size_of::<T>()).step_by(64) {
        unsafe { std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T0 }>(from.wrapping_add(line)) };
    }
}

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

mod avx2;
mod avx512;
mod sse2;

pub use avx2::F8;
pub use avx512::F16;
pub use sse2::F4;

#[inline(always)]
fn squeeze<T: Copy, const N: usize>(all: &[T; N], mut bits: u32, to: &mut [T]) {
    let mut at = 0;
    while bits != 0 {
        to[at] = all[bits.trailing_zeros() as usize % N];
        bits &= bits - 1;
        at += 1;
    }
}

/// Where half records begin; indices beyond them are those of the last.
#[inline(always)]
fn halves<const N: usize>(from: &[Record], index: [u32; N]) -> Option<[*const f32; N]> {
    let last = (2 * from.len()).checked_sub(1)?;
    // Within the slice, whose records are eight and eight numbers.
    Some(index.map(|at| unsafe { from.as_ptr().cast::<f32>().add(8 * (at as usize).min(last)) }))
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
