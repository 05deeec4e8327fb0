//! The transforms of input and output tiles, for each set of instructions.

#![expect(clippy::needless_range_loop, reason = "tiles are arrays of arrays, each loop over the same rows")]
#![expect(unsafe_code, reason = "the innermost loops go by pointers; sizes are checked before they are called")]

use super::{PLACES, SEEN, SIDE, UNIT};
use crate::{
    instructions::Instructions,
    lanes::{Lanes, Plain},
};
use std::mem::MaybeUninit;

/// A tile of pixels, 6 x 6 of an input or 4 x 4 of the gradient of an output, and where its transform goes.
pub(super) struct Seen<'a> {
    /// Starts with the first pixel of the tile, and goes on for [`UNIT`] numbers after its last pixel.
    pub(super) from: &'a [f32],
    /// From a row of pixels to the next.
    pub(super) row: usize,
    /// From a pixel to the next: the channels.
    pub(super) pixel: usize,
    /// The transformed tile: a place's channels, and numbers of no meaning up to a multiple of [`UNIT`].
    pub(super) to: &'a mut [MaybeUninit<f32>],
    /// From a place to the next.
    pub(super) place: usize,
}

/// A transformed output tile of [`UNIT`] channels, and where the tile goes.
pub(super) struct Output<'a> {
    pub(super) from: &'a [f32],
    /// From a place to the next.
    pub(super) place: usize,
    pub(super) bias: &'a [f32; UNIT],
    /// Starts with the first pixel of the tile.
    pub(super) to: &'a mut [MaybeUninit<f32>],
    /// From a row of pixels to the next.
    pub(super) row: usize,
    /// From a pixel to the next.
    pub(super) pixel: usize,
    /// The rows and columns that are wanted, from the first on.
    pub(super) size: (usize, usize),
}

impl Seen<'_> {
    /// Panics unless a tile of this side is there, and room for its transform.
    fn check(&self, side: usize) {
        let channels = self.pixel.next_multiple_of(UNIT);
        assert!((side - 1) * (self.row + self.pixel) + channels <= self.from.len(), "the tile is there");
        assert!((PLACES - 1) * self.place + channels <= self.to.len(), "room for the transformed tile");
    }
}

/// The transforms of one set of instructions.
pub(super) struct Transforms {
    input: unsafe fn(&mut Seen<'_>),
    gradient: unsafe fn(&mut Seen<'_>),
    output: unsafe fn(&mut Output<'_>),
}

impl Transforms {
    pub(super) fn input(&self, tile: &mut Seen<'_>) {
        tile.check(SEEN);
        // SAFETY: all numbers are there; `transforms` gives what the processor has.
        unsafe { (self.input)(tile) };
    }

    pub(super) fn gradient(&self, tile: &mut Seen<'_>) {
        tile.check(SIDE);
        // SAFETY: all numbers are there; `transforms` gives what the processor has.
        unsafe { (self.gradient)(tile) };
    }

    pub(super) fn output(&self, tile: &mut Output<'_>) {
        assert!((PLACES - 1) * tile.place + UNIT <= tile.from.len(), "the transformed tile is there");
        let (rows, columns) = tile.size;
        assert!((1..=SIDE).contains(&rows) && (1..=SIDE).contains(&columns), "a part of a tile");
        assert!((rows - 1) * tile.row + (columns - 1) * tile.pixel + UNIT <= tile.to.len(), "room for the tile");
        // SAFETY: all numbers are there; `transforms` gives what the processor has.
        unsafe { (self.output)(tile) };
    }
}

/// The transforms of these instructions, or of fewer if the processor lacks them.
pub(super) fn transforms(instructions: Instructions) -> &'static Transforms {
    #[cfg(target_arch = "x86_64")]
    match instructions.min(Instructions::most()) {
        Instructions::Avx512 => return &avx512::TRANSFORMS,
        Instructions::Avx2 => return &avx2::TRANSFORMS,
        Instructions::Sse2 | Instructions::Portable => {}
    }
    let _ = instructions;
    &portable::TRANSFORMS
}

/// Six numbers of a row or column of the input, transformed: the values of a polynomial's multiples at the points.
///
/// # Safety
/// The processor has the lanes' instructions.
#[inline(always)]
unsafe fn turn<L: Lanes>(x: [L; SEEN]) -> [L; SEEN] {
    // SAFETY: the caller's promise.
    unsafe {
        let times = |value: L, factor: f32, and: L| value.fused(L::splat(factor), and);
        // 4 x0 - 5 x2 + x4, and the same one further on.
        let first = times(x[0], 4.0, times(x[2], -5.0, x[4]));
        let last = times(x[1], 4.0, times(x[3], -5.0, x[5]));
        let (even, odd) = (times(x[2], -4.0, x[4]), times(x[1], -4.0, x[3]));
        let (sum, difference) = (times(odd, 1.0, even), times(odd, -1.0, even));
        let (even, odd) = (times(x[2], -1.0, x[4]), times(x[1], -1.0, x[3]));
        [first, sum, difference, times(odd, 2.0, even), times(odd, -2.0, even), last]
    }
}

/// Six numbers of a row or column of the transformed output, as four numbers of the output.
///
/// # Safety
/// The processor has the lanes' instructions.
#[inline(always)]
unsafe fn turn_back<L: Lanes>(x: [L; SEEN]) -> [L; SIDE] {
    // SAFETY: the caller's promise.
    unsafe {
        let times = |value: L, factor: f32, and: L| value.fused(L::splat(factor), and);
        let (near, apart) = (times(x[2], 1.0, x[1]), times(x[2], -1.0, x[1]));
        let (far, far_apart) = (times(x[4], 1.0, x[3]), times(x[4], -1.0, x[3]));
        [
            times(times(near, 1.0, x[0]), 1.0, far),
            times(far_apart, 2.0, apart),
            times(far, 4.0, near),
            times(times(far_apart, 8.0, apart), 1.0, x[5]),
        ]
    }
}

/// The gradient of four numbers of the output, transformed: what [`turn_back`] does to six, turned round.
///
/// # Safety
/// The processor has the lanes' instructions.
#[inline(always)]
unsafe fn turn_gradient<L: Lanes>(x: [L; SIDE]) -> [L; SEEN] {
    // SAFETY: the caller's promise.
    unsafe {
        let times = |value: L, factor: f32, and: L| value.fused(L::splat(factor), and);
        let (even, odd) = (times(x[2], 1.0, x[0]), times(x[3], 1.0, x[1]));
        let (far_even, far_odd) = (times(x[2], 4.0, x[0]), times(x[3], 4.0, x[1]));
        [
            x[0],
            times(odd, 1.0, even),
            times(odd, -1.0, even),
            times(far_odd, 2.0, far_even),
            times(far_odd, -2.0, far_even),
            x[3],
        ]
    }
}

/// # Safety
/// The sizes are right, and the processor has the lanes' instructions.
#[inline(always)]
unsafe fn input<L: Lanes>(tile: &mut Seen<'_>) {
    // SAFETY: the caller's promise.
    unsafe {
        for channel in (0..tile.pixel.next_multiple_of(UNIT)).step_by(L::COUNT) {
            let from = tile.from.as_ptr().add(channel);
            let to = tile.to.as_mut_ptr().cast::<f32>().add(channel);
            let mut rows = [[L::splat(0.0); SEEN]; SEEN];
            for x in 0..SEEN {
                let mut column = [L::splat(0.0); SEEN];
                for y in 0..SEEN {
                    column[y] = L::load(from.add(y * tile.row + x * tile.pixel));
                }
                let column = turn(column);
                for y in 0..SEEN {
                    rows[y][x] = column[y];
                }
            }
            for y in 0..SEEN {
                let row = turn(rows[y]);
                for x in 0..SEEN {
                    row[x].store(to.add((y * SEEN + x) * tile.place));
                }
            }
        }
    }
}

/// # Safety
/// The sizes are right, and the processor has the lanes' instructions.
#[inline(always)]
unsafe fn gradient<L: Lanes>(tile: &mut Seen<'_>) {
    // SAFETY: the caller's promise.
    unsafe {
        for channel in (0..tile.pixel.next_multiple_of(UNIT)).step_by(L::COUNT) {
            let from = tile.from.as_ptr().add(channel);
            let to = tile.to.as_mut_ptr().cast::<f32>().add(channel);
            let mut rows = [[L::splat(0.0); SIDE]; SEEN];
            for x in 0..SIDE {
                let mut column = [L::splat(0.0); SIDE];
                for y in 0..SIDE {
                    column[y] = L::load(from.add(y * tile.row + x * tile.pixel));
                }
                let column = turn_gradient(column);
                for y in 0..SEEN {
                    rows[y][x] = column[y];
                }
            }
            for y in 0..SEEN {
                let row = turn_gradient(rows[y]);
                for x in 0..SEEN {
                    row[x].store(to.add((y * SEEN + x) * tile.place));
                }
            }
        }
    }
}

/// # Safety
/// The sizes are right, and the processor has the lanes' instructions.
#[inline(always)]
unsafe fn output<L: Lanes>(tile: &mut Output<'_>) {
    // SAFETY: the caller's promise.
    unsafe {
        for channel in (0..UNIT).step_by(L::COUNT) {
            let from = tile.from.as_ptr().add(channel);
            let to = tile.to.as_mut_ptr().cast::<f32>().add(channel);
            let bias = L::load(tile.bias.as_ptr().add(channel));
            let mut rows = [[L::splat(0.0); SEEN]; SIDE];
            for x in 0..SEEN {
                let mut column = [L::splat(0.0); SEEN];
                for y in 0..SEEN {
                    column[y] = L::load(from.add((y * SEEN + x) * tile.place));
                }
                let column = turn_back(column);
                for y in 0..SIDE {
                    rows[y][x] = column[y];
                }
            }
            for y in 0..tile.size.0 {
                let row = turn_back(rows[y]);
                for x in 0..tile.size.1 {
                    row[x].fused(L::splat(1.0), bias).store(to.add(y * tile.row + x * tile.pixel));
                }
            }
        }
    }
}

macro_rules! transforms {
    ($name:ident, $lanes:ty, $features:meta) => {
        mod $name {
            use super::*;

            // `transforms` gives these only where the processor has the features.
            #[$features]
            unsafe fn input_tile(tile: &mut Seen<'_>) {
                // SAFETY: the features are there; the callers promise the rest.
                unsafe { input::<$lanes>(tile) }
            }

            #[$features]
            unsafe fn gradient_tile(tile: &mut Seen<'_>) {
                // SAFETY: the features are there; the callers promise the rest.
                unsafe { gradient::<$lanes>(tile) }
            }

            #[$features]
            unsafe fn output_tile(tile: &mut Output<'_>) {
                // SAFETY: the features are there; the callers promise the rest.
                unsafe { output::<$lanes>(tile) }
            }

            pub(super) static TRANSFORMS: Transforms =
                Transforms { input: input_tile, gradient: gradient_tile, output: output_tile };
        }
    };
}

#[cfg(target_arch = "x86_64")]
transforms!(avx512, crate::lanes::x86::F16, target_feature(enable = "avx2,fma,avx512f,avx512dq,avx512bw,avx512vl"));
#[cfg(target_arch = "x86_64")]
transforms!(avx2, crate::lanes::x86::F8, target_feature(enable = "avx2,fma"));
#[cfg(target_arch = "x86_64")]
transforms!(portable, Plain, target_feature(enable = "sse2"));
#[cfg(target_arch = "aarch64")]
transforms!(portable, Plain, target_feature(enable = "neon"));
#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
transforms!(portable, Plain, inline(never));
