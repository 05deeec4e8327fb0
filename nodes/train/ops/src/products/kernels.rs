//! The innermost loops, for each set of instructions: tiles of results in registers.

#![expect(unsafe_code, reason = "the innermost loops go by pointers; callers promise that all rows are there")]
#![expect(clippy::needless_range_loop, reason = "tiles are arrays of arrays, each loop over the same rows and vectors")]

use super::{Run, UNIT};
use crate::{
    instructions::Instructions,
    lanes::{Lanes, Plain},
};
use std::mem::MaybeUninit;

/// Rows of results from rows of the left matrix and one panel.
pub(super) struct Product<'a> {
    /// Starts with the first row.
    pub(super) left: &'a [f32],
    pub(super) left_stride: usize,
    /// [depth, width of the panel].
    pub(super) right: &'a [f32],
    pub(super) depth: usize,
    /// The initial value of sums per column of the panel; by default, sums continue from the content of `out`.
    pub(super) start: Option<&'a [f32]>,
    /// Starts with the panel's first column in the first row.
    pub(super) out: &'a mut [MaybeUninit<f32>],
    pub(super) out_stride: usize,
    pub(super) rows: usize,
}

/// Sums over rows of runs, for one panel of columns.
pub(super) struct Outer<'a> {
    /// Starts with the first column that is wanted.
    pub(super) left: &'a [f32],
    pub(super) left_stride: usize,
    /// Starts with the panel's first column.
    pub(super) right: &'a [f32],
    /// Of `right` and `out`.
    pub(super) columns: usize,
    pub(super) runs: &'a [Run],
    /// [depth, columns] from the panel's first column on.
    pub(super) out: &'a mut [f32],
    pub(super) depth: usize,
}

/// Kernels of one set of instructions, by the units of a panel.
pub(super) struct Kernels {
    pub(super) product: [unsafe fn(&mut Product<'_>); 3],
    pub(super) outer: [unsafe fn(&mut Outer<'_>); 3],
}

/// The kernels of these instructions, or of fewer if the processor lacks them.
pub(super) fn kernels(instructions: Instructions) -> &'static Kernels {
    #[cfg(target_arch = "x86_64")]
    match instructions.min(Instructions::most()) {
        Instructions::Avx512 => return &avx512::KERNELS,
        Instructions::Avx2 => return &avx2::KERNELS,
        Instructions::Sse2 | Instructions::Portable => {}
    }
    let _ = instructions;
    &portable::KERNELS
}

/// `ROWS` rows of results, `VECTORS` wide, from the given row on.
///
/// # Safety
/// The rows are there, those of the result written before unless sums start anew, and the processor has the lanes'
/// instructions.
#[inline(always)]
unsafe fn product_tile<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    product: &mut Product<'_>,
    row: usize,
    (first, width): (usize, usize),
) {
    // SAFETY: the caller's promise.
    unsafe {
        let left = product.left.as_ptr().add(row * product.left_stride);
        let out = product.out.as_mut_ptr().cast::<f32>().add(row * product.out_stride + first);
        let (start, stride) = match product.start {
            Some(start) => (start.as_ptr().add(first), 0),
            None => (out.cast_const(), product.out_stride),
        };
        let mut right = product.right.as_ptr().add(first);
        let mut sums = [[L::splat(0.0); VECTORS]; ROWS];
        for r in 0..ROWS {
            for v in 0..VECTORS {
                sums[r][v] = L::load(start.add(r * stride + v * L::COUNT));
            }
        }
        for k in 0..product.depth {
            let mut factors = [L::splat(0.0); VECTORS];
            for v in 0..VECTORS {
                factors[v] = L::load(right.add(v * L::COUNT));
            }
            for r in 0..ROWS {
                let value = L::splat(*left.add(r * product.left_stride + k));
                for v in 0..VECTORS {
                    sums[r][v] = value.fused(factors[v], sums[r][v]);
                }
            }
            right = right.wrapping_add(width);
        }
        for r in 0..ROWS {
            for v in 0..VECTORS {
                sums[r][v].store(out.add(r * product.out_stride + v * L::COUNT));
            }
        }
    }
}

/// All rows, `ROWS` at a time, then the rest.
///
/// # Safety
/// As for [`product_tile`].
#[inline(always)]
unsafe fn product_rows<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    product: &mut Product<'_>,
    at: (usize, usize),
) {
    let mut row = 0;
    // SAFETY: the caller's promise.
    unsafe {
        while row + ROWS <= product.rows {
            product_tile::<L, ROWS, VECTORS>(product, row, at);
            row += ROWS;
        }
        while row + 4 <= product.rows {
            product_tile::<L, 4, VECTORS>(product, row, at);
            row += 4;
        }
        while row < product.rows {
            product_tile::<L, 1, VECTORS>(product, row, at);
            row += 1;
        }
    }
}

/// `DEPTH` rows of results, `VECTORS` wide, from the given row on.
///
/// # Safety
/// As for [`product_tile`].
#[inline(always)]
unsafe fn outer_tile<L: Lanes, const DEPTH: usize, const VECTORS: usize>(
    outer: &mut Outer<'_>,
    row: usize,
    first: usize,
) {
    // SAFETY: the caller's promise.
    unsafe {
        let out = outer.out.as_mut_ptr().add(row * outer.columns + first);
        let mut sums = [[L::splat(0.0); VECTORS]; DEPTH];
        for k in 0..DEPTH {
            for v in 0..VECTORS {
                sums[k][v] = L::load(out.add(k * outer.columns + v * L::COUNT));
            }
        }
        for run in outer.runs {
            let mut left = outer.left.as_ptr().add(run.left + row);
            let mut right = outer.right.as_ptr().add(run.other + first);
            for _ in 0..run.rows {
                let mut factors = [L::splat(0.0); VECTORS];
                for v in 0..VECTORS {
                    factors[v] = L::load(right.add(v * L::COUNT));
                }
                for k in 0..DEPTH {
                    let value = L::splat(*left.add(k));
                    for v in 0..VECTORS {
                        sums[k][v] = value.fused(factors[v], sums[k][v]);
                    }
                }
                left = left.wrapping_add(outer.left_stride);
                right = right.wrapping_add(outer.columns);
            }
        }
        for k in 0..DEPTH {
            for v in 0..VECTORS {
                sums[k][v].store(out.add(k * outer.columns + v * L::COUNT));
            }
        }
    }
}

/// All rows of results, `DEPTH` at a time, then the rest.
///
/// # Safety
/// As for [`product_tile`].
#[inline(always)]
unsafe fn outer_rows<L: Lanes, const DEPTH: usize, const VECTORS: usize>(outer: &mut Outer<'_>, first: usize) {
    let mut row = 0;
    // SAFETY: the caller's promise.
    unsafe {
        while row + DEPTH <= outer.depth {
            outer_tile::<L, DEPTH, VECTORS>(outer, row, first);
            row += DEPTH;
        }
        while row + 4 <= outer.depth {
            outer_tile::<L, 4, VECTORS>(outer, row, first);
            row += 4;
        }
        while row < outer.depth {
            outer_tile::<L, 1, VECTORS>(outer, row, first);
            row += 1;
        }
    }
}

/// Functions for panels of one to three units. Sixteen lanes work on a panel at once, eight on one unit after the
/// other.
macro_rules! kernels {
    ($name:ident, $lanes:ty, $tile:literal, whole, $features:meta) => {
        kernels!(@ $name, $features, {
            (product_1, outer_1): |p, o|
                product_rows::<$lanes, $tile, 1>(p, (0, UNIT)),
                outer_rows::<$lanes, $tile, 1>(o, 0);
            (product_2, outer_2): |p, o|
                product_rows::<$lanes, $tile, 2>(p, (0, 2 * UNIT)),
                outer_rows::<$lanes, $tile, 2>(o, 0);
            (product_3, outer_3): |p, o|
                product_rows::<$lanes, $tile, 3>(p, (0, 3 * UNIT)),
                outer_rows::<$lanes, $tile, 3>(o, 0);
        });
    };
    ($name:ident, $lanes:ty, $tile:literal, units, $features:meta) => {
        kernels!(@ $name, $features, {
            (product_1, outer_1): |p, o|
                product_rows::<$lanes, $tile, 2>(p, (0, UNIT)),
                outer_rows::<$lanes, $tile, 2>(o, 0);
            (product_2, outer_2): |p, o|
                for unit in 0..2 { product_rows::<$lanes, $tile, 2>(p, (unit * UNIT, 2 * UNIT)) },
                for unit in 0..2 { outer_rows::<$lanes, $tile, 2>(o, unit * UNIT) };
            (product_3, outer_3): |p, o|
                for unit in 0..3 { product_rows::<$lanes, $tile, 2>(p, (unit * UNIT, 3 * UNIT)) },
                for unit in 0..3 { outer_rows::<$lanes, $tile, 2>(o, unit * UNIT) };
        });
    };
    (@ $name:ident, $features:meta, {
        $(($product_name:ident, $outer_name:ident): |$p:ident, $o:ident| $product:expr, $outer:expr;)*
    }) => {
        mod $name {
            use super::*;

            // `kernels` gives these only where the processor has the features.
            $(
                #[$features]
                unsafe fn $product_name($p: &mut Product<'_>) {
                    // SAFETY: the features are there; the callers promise the rest.
                    unsafe { $product }
                }

                #[$features]
                unsafe fn $outer_name($o: &mut Outer<'_>) {
                    // SAFETY: the features are there; the callers promise the rest.
                    unsafe { $outer }
                }
            )*

            pub(super) static KERNELS: Kernels =
                Kernels { product: [$($product_name),*], outer: [$($outer_name),*] };
        }
    };
}

#[cfg(target_arch = "x86_64")]
kernels!(
    avx512,
    crate::lanes::x86::F16,
    8,
    whole,
    target_feature(enable = "avx2,fma,avx512f,avx512dq,avx512bw,avx512vl")
);
#[cfg(target_arch = "x86_64")]
kernels!(avx2, crate::lanes::x86::F8, 4, units, target_feature(enable = "avx2,fma"));
#[cfg(target_arch = "x86_64")]
kernels!(portable, Plain, 4, units, target_feature(enable = "sse2"));
#[cfg(target_arch = "aarch64")]
kernels!(portable, Plain, 4, units, target_feature(enable = "neon"));
#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
kernels!(portable, Plain, 4, units, inline(never));
