//! The same arithmetic on eight or sixteen numbers side by side.
//!
//! Products are fused with their sums: IEEE 754 says what a fused product is, so that every set of instructions gives
//! the same bits, the portable one included, which is slow where the processor cannot fuse.

#![expect(unsafe_code, reason = "vector instructions and pointers, which callers promise to be there")]

/// Numbers side by side.
pub(crate) trait Lanes: Copy {
    /// How many.
    const COUNT: usize;

    /// The same number everywhere.
    ///
    /// # Safety
    /// The processor has the instructions.
    unsafe fn splat(value: f32) -> Self;

    /// `self * b + c`, rounded once.
    ///
    /// # Safety
    /// The processor has the instructions.
    unsafe fn fused(self, b: Self, c: Self) -> Self;

    /// Reads `COUNT` numbers.
    ///
    /// # Safety
    /// They are there, and the processor has the instructions.
    unsafe fn load(from: *const f32) -> Self;

    /// Writes `COUNT` numbers.
    ///
    /// # Safety
    /// The slice is long enough, and the processor has the instructions.
    unsafe fn store(self, to: *mut f32);
}

/// Eight lanes of plain Rust.
#[derive(Clone, Copy)]
pub(crate) struct Plain([f32; 8]);

impl Lanes for Plain {
    const COUNT: usize = 8;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Self([value; 8])
    }

    #[inline(always)]
    unsafe fn fused(self, b: Self, c: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i].mul_add(b.0[i], c.0[i])))
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: the caller's promise.
        Self(unsafe { from.cast::<[f32; 8]>().read_unaligned() })
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: the caller's promise.
        unsafe { to.cast::<[f32; 8]>().write_unaligned(self.0) }
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) mod x86 {
    use super::Lanes;
    use std::arch::x86_64::*;

    /// Eight lanes of AVX2, with fused products.
    #[derive(Clone, Copy)]
    pub(crate) struct F8(__m256);

    /// Sixteen lanes of AVX-512.
    #[derive(Clone, Copy)]
    pub(crate) struct F16(__m512);

    // SAFETY of all blocks: kernels of these lanes run only where the processor has their instructions
    // (`Instructions`).
    impl Lanes for F8 {
        const COUNT: usize = 8;

        #[inline(always)]
        unsafe fn splat(value: f32) -> Self {
            // SAFETY: the caller promises that the processor has the instructions.
            Self(unsafe { _mm256_set1_ps(value) })
        }

        #[inline(always)]
        unsafe fn fused(self, b: Self, c: Self) -> Self {
            // SAFETY: the caller promises that the processor has the instructions.
            Self(unsafe { _mm256_fmadd_ps(self.0, b.0, c.0) })
        }

        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self {
            // SAFETY: the caller promises the numbers and the instructions.
            Self(unsafe { _mm256_loadu_ps(from) })
        }

        #[inline(always)]
        unsafe fn store(self, to: *mut f32) {
            // SAFETY: the caller promises the room and the instructions.
            unsafe { _mm256_storeu_ps(to, self.0) }
        }
    }

    impl Lanes for F16 {
        const COUNT: usize = 16;

        #[inline(always)]
        unsafe fn splat(value: f32) -> Self {
            // SAFETY: the caller promises that the processor has the instructions.
            Self(unsafe { _mm512_set1_ps(value) })
        }

        #[inline(always)]
        unsafe fn fused(self, b: Self, c: Self) -> Self {
            // SAFETY: the caller promises that the processor has the instructions.
            Self(unsafe { _mm512_fmadd_ps(self.0, b.0, c.0) })
        }

        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self {
            // SAFETY: the caller promises the numbers and the instructions.
            Self(unsafe { _mm512_loadu_ps(from) })
        }

        #[inline(always)]
        unsafe fn store(self, to: *mut f32) {
            // SAFETY: the caller promises the room and the instructions.
            unsafe { _mm512_storeu_ps(to, self.0) }
        }
    }
}
