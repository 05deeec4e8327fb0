//! The 3x3 convolution by Winograd's minimal filtering, for results whose gradient nobody asks for.
//!
//! An output tile of 4 x 4 pixels depends on 6 x 6 pixels of the input. Both are transformed so that the convolution
//! becomes 36 products of matrices, one for each number of the transformed tile: 36 multiplications instead of 144
//! (Winograd 1980; Lavin and Gray 2016, F(4 x 4, 3 x 3) at the points 0, 1, -1, 2, -2 and infinity). Rounding is
//! coarser than in the sum of the definition, by about ten times the rounding of one product.
//!
//! Tiles lie on a grid that begins at the corner of the image. Each is computed by itself, so that bits depend on the
//! position in the grid, but neither on threads nor on lanes.

#![expect(unsafe_code, reason = "transforms go by pointers; sizes are checked before they are called")]

mod transforms;

use super::{Conv3, surround, with_scratch};
use crate::{
    fresh::{filled, maybe},
    products::{Left, Packed, Run, Start, add_products},
};
use rayon::prelude::*;
use std::{mem::MaybeUninit, ops::Range};
use transforms::{Input, Output, transforms};

/// Side of an output tile.
const SIDE: usize = 4;
/// Side of the input tile, and of the transformed tiles.
const SEEN: usize = SIDE + 2;
/// Numbers of a transformed tile.
const PLACES: usize = SEEN * SEEN;
/// Channels come in multiples of this where they are worked on side by side.
const UNIT: usize = 16;
/// Outputs that are worked on together.
const PANEL: usize = 3 * UNIT;
/// Tiles that are worked on together: their transformed inputs and outputs of one panel stay in the second cache.
const TILES: usize = 32;
/// Pixels of the smallest images that are convolved so: for fewer, the transform of the kernel costs too much.
const PIXELS: usize = 512;
/// Channels of the narrowest inputs and outputs: for fewer, the transforms of tiles cost too much.
const CHANNELS: usize = 16;

/// The transform of a kernel of 3 numbers, in rows.
const KERNEL: [[f64; 3]; SEEN] = [
    [1.0 / 4.0, 0.0, 0.0],
    [-1.0 / 6.0, -1.0 / 6.0, -1.0 / 6.0],
    [-1.0 / 6.0, 1.0 / 6.0, -1.0 / 6.0],
    [1.0 / 24.0, 1.0 / 12.0, 1.0 / 6.0],
    [1.0 / 24.0, -1.0 / 12.0, 1.0 / 6.0],
    [0.0, 0.0, 1.0],
];

/// Whether a convolution is faster this way.
pub(super) fn pays(conv: &Conv3) -> bool {
    conv.height * conv.width >= PIXELS
        && conv.height.min(conv.width) >= SIDE
        && conv.inputs.min(conv.outputs) >= CHANNELS
}

/// The outputs in panels, as even as they can be.
fn panels(outputs: usize) -> impl Iterator<Item = Range<usize>> {
    let units = outputs.div_ceil(UNIT);
    let count = outputs.div_ceil(PANEL);
    (0..count).map(move |i| i * units / count * UNIT..((i + 1) * units / count * UNIT).min(outputs))
}

/// The transformed kernel, [9 C, O], for one panel: row `place * C + channel`.
fn transformed(kernel: &[f32], (inputs, outputs): (usize, usize), panel: Range<usize>) -> Packed {
    let width = panel.len().next_multiple_of(UNIT);
    let mut rows = vec![0.0f32; PLACES * inputs * width];
    for channel in 0..inputs {
        let tap = |y: usize, x: usize| &kernel[((3 * y + x) * inputs + channel) * outputs..][panel.clone()];
        let taps: [[&[f32]; 3]; 3] = std::array::from_fn(|y| std::array::from_fn(|x| tap(y, x)));
        for first in (0..panel.len()).step_by(UNIT) {
            let there = UNIT.min(panel.len() - first);
            let mut values = [[[0.0f64; UNIT]; 3]; 3];
            for (values, taps) in values.iter_mut().flatten().zip(taps.iter().flatten()) {
                for (value, tap) in values[..there].iter_mut().zip(&taps[first..]) {
                    *value = f64::from(*tap);
                }
            }
            for (i, down) in KERNEL.iter().enumerate() {
                let mut columns = [[0.0f64; UNIT]; 3];
                for (x, column) in columns.iter_mut().enumerate() {
                    for lane in 0..UNIT {
                        column[lane] =
                            down[0] * values[0][x][lane] + down[1] * values[1][x][lane] + down[2] * values[2][x][lane];
                    }
                }
                for (j, across) in KERNEL.iter().enumerate() {
                    let to = &mut rows[((i * SEEN + j) * inputs + channel) * width + first..][..UNIT];
                    for lane in 0..UNIT {
                        let sum =
                            across[0] * columns[0][lane] + across[1] * columns[1][lane] + across[2] * columns[2][lane];
                        to[lane] = sum as f32;
                    }
                }
            }
        }
    }
    Packed::new((PLACES * inputs, width), &rows, |row| row * width, 1)
}

/// The convolution of whole images `x` with a kernel and a bias, whose sizes were checked.
pub(super) fn convolve(conv: &Conv3, x: &[f32], kernel: &[f32], bias: &[f32]) -> Vec<f32> {
    let (height, width, inputs, outputs) = (conv.height, conv.width, conv.inputs, conv.outputs);
    let panels: Vec<_> = panels(outputs).collect();
    let panels: Vec<_> = panels
        .into_par_iter()
        .map(|panel| Panel { kernel: transformed(kernel, (inputs, outputs), panel.clone()), outputs: panel })
        .collect();
    let across = width.div_ceil(SIDE);
    // Whole rows of tiles; of narrow images several, so that there are tiles to work on together.
    let rows = SIDE * (TILES / across).clamp(1, height.div_ceil(SIDE));
    let size = (x.len() / inputs).checked_mul(outputs).expect("a result that fits into memory");
    let fill = |out: &mut [MaybeUninit<f32>]| {
        let images =
            out.par_chunks_exact_mut(height * width * outputs).zip(x.par_chunks_exact(height * width * inputs));
        let bands = images.flat_map(|(out, x)| {
            out.par_chunks_mut(rows * width * outputs).enumerate().map(move |(i, band)| (x, i * rows, band))
        });
        bands.for_each(|(x, first, out)| {
            let lines = out.len() / (width * outputs);
            Band { conv, x, first, lines, across, bias, out }.fill(&panels);
        });
    };
    // SAFETY: there are whole images; bands cover the result, and `Band::fill` writes all of a band.
    unsafe { filled(size, fill) }
}

struct Panel {
    outputs: Range<usize>,
    kernel: Packed,
}

/// Rows of an output image.
struct Band<'a> {
    conv: &'a Conv3,
    /// The input image.
    x: &'a [f32],
    first: usize,
    lines: usize,
    /// Tiles across.
    across: usize,
    bias: &'a [f32],
    out: &'a mut [MaybeUninit<f32>],
}

impl Band<'_> {
    fn fill(&mut self, panels: &[Panel]) {
        let (width, inputs, instructions) = (self.conv.width, self.conv.inputs, self.conv.instructions);
        let (lines, columns) = (self.lines.next_multiple_of(SIDE), self.across * SIDE);
        let depth = inputs.next_multiple_of(UNIT);
        let count = self.across * (lines / SIDE);
        let sizes = [
            (lines + 2) * (columns + 2) * inputs + UNIT,
            PLACES * TILES.min(count) * depth,
            PLACES * TILES.min(count) * PANEL,
        ];
        with_scratch(sizes.iter().sum(), |scratch| {
            let (near, scratch) = scratch.split_at_mut(sizes[0]);
            let (turned, products) = scratch.split_at_mut(sizes[1]);
            // SAFETY: `surround` writes numbers.
            surround(unsafe { maybe(near) }, self.x, (width, columns + 1 - width), inputs, self.first);
            for from in (0..count).step_by(TILES) {
                let tiles = from..(from + TILES).min(count);
                let block = tiles.len();
                for (i, tile) in tiles.clone().enumerate() {
                    let (down, right) = (tile / self.across * SIDE, tile % self.across * SIDE);
                    let mut input = Input {
                        from: &near[(down * (columns + 2) + right) * inputs..],
                        row: (columns + 2) * inputs,
                        pixel: inputs,
                        to: &mut turned[i * depth..],
                        place: block * depth,
                    };
                    transforms(instructions).input(&mut input);
                }
                for panel in panels {
                    let wide = panel.outputs.len().next_multiple_of(UNIT);
                    let zeros = [0.0; PANEL];
                    for place in 0..PLACES {
                        let left = Left { data: &turned[place * block * depth..], stride: depth };
                        let out = &mut products[place * block * wide..][..block * wide];
                        let run = Run { left: 0, other: 0, rows: block };
                        let (rows, start) = ((place * inputs, inputs), Start::Row(&zeros[..wide]));
                        // SAFETY: sums start with zeros; products are numbers.
                        unsafe { add_products((maybe(out), start), left, &panel.kernel, rows, &[run], instructions) };
                    }
                    for (i, tile) in tiles.clone().enumerate() {
                        self.put(tile, panel, &products[i * wide..], block * wide);
                    }
                }
            }
        });
    }

    /// Writes a tile of one panel's outputs, of which `products` has the transformed ones, `place` apart.
    fn put(&mut self, tile: usize, panel: &Panel, products: &[f32], place: usize) {
        let (down, right) = (tile / self.across * SIDE, tile % self.across * SIDE);
        let (lines, columns) = (SIDE.min(self.lines - down), SIDE.min(self.conv.width - right));
        let (width, outputs) = (self.conv.width, self.conv.outputs);
        let transforms = transforms(self.conv.instructions);
        for first in panel.outputs.clone().step_by(UNIT) {
            let there = UNIT.min(panel.outputs.end - first);
            let mut bias = [0.0; UNIT];
            bias[..there].copy_from_slice(&self.bias[first..first + there]);
            let from = &products[first - panel.outputs.start..];
            let to = &mut self.out[(down * width + right) * outputs + first..];
            let (row, pixel, size) = (width * outputs, outputs, (lines, columns));
            if there == UNIT {
                transforms.output(&mut Output { from, place, bias: &bias, to, row, pixel, size });
                continue;
            }
            // Fewer channels than are worked on side by side.
            let mut beside = [MaybeUninit::new(0.0); SIDE * SIDE * UNIT];
            let (beside_row, beside_pixel) = (SIDE * UNIT, UNIT);
            transforms.output(&mut Output {
                from,
                place,
                bias: &bias,
                to: &mut beside,
                row: beside_row,
                pixel: beside_pixel,
                size,
            });
            for y in 0..lines {
                for x in 0..columns {
                    let from = &beside[y * beside_row + x * beside_pixel..][..UNIT];
                    let to = &mut to[y * row + x * pixel..][..there];
                    // A copy of a known size is a few instructions.
                    if there == UNIT / 2 {
                        to[..UNIT / 2].copy_from_slice(&from[..UNIT / 2]);
                    } else {
                        to.copy_from_slice(&from[..there]);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
