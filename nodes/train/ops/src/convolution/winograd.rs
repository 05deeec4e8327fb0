//! The 3x3 convolution and its gradients by Winograd's minimal filtering.
//!
//! An output tile of 4 x 4 pixels depends on 6 x 6 pixels of the input. Both are transformed so that the convolution
//! becomes 36 products of matrices, one for each number of the transformed tile: 36 multiplications instead of 144.
//! The method is F(4 x 4, 3 x 3) of Lavin and Gray (2016) after Winograd (1980), at the points 0, 1, -1, 2, -2 and
//! infinity. Errors are relative to the largest values of a tile, and a number that is not finite spoils whole tiles.
//! Rounding is coarser than in the sum of the definition, about four times with 80 channels.
//!
//! Tiles lie on a grid that begins at the corner of the image. Each is computed by itself, so that bits depend on the
//! position in the grid, but neither on threads nor on lanes.

#![expect(unsafe_code, reason = "results are written once, tile by tile; each block says why all of it is written")]

mod transforms;

use super::{Conv3, Convolutions, surround, with_scratch};
use crate::{
    fresh::{filled, maybe},
    instructions::{Instructions, wide},
    products::{Left, Packed, Run, Start, add_outer_products, add_products},
};
use rayon::prelude::*;
use std::{mem::MaybeUninit, ops::Range};
use transforms::{Output, Seen, transforms};

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
/// Tiles whose products with gradients are summed at once, a multiple of [`TILES`]: with their gradients they stay in
/// the caches.
const SUMMED: usize = 128;
/// Pixels of the smallest images for this method: for fewer, the transform of the kernel costs too much.
const PIXELS: usize = 256;
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

/// Whether this method is asked for, and faster.
pub(super) fn pays(conv: &Conv3) -> bool {
    conv.convolutions == Convolutions::Minimal
        && conv.height * conv.width >= PIXELS
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
    wide(|| transform(&mut rows, kernel, (inputs, outputs), panel, width));
    Packed::of_panel((PLACES * inputs, width), rows)
}

#[inline(always)]
fn transform(rows: &mut [f32], kernel: &[f32], (inputs, outputs): (usize, usize), panel: Range<usize>, width: usize) {
    for channel in 0..inputs {
        for first in (0..panel.len()).step_by(UNIT) {
            let there = UNIT.min(panel.len() - first);
            let mut taps = [[0.0f64; UNIT]; 9];
            for tap in 0..9 {
                let from = &kernel[(tap * inputs + channel) * outputs + panel.start + first..][..there];
                for lane in 0..there {
                    taps[tap][lane] = f64::from(from[lane]);
                }
            }
            for i in 0..SEEN {
                let down = KERNEL[i];
                let mut columns = [[0.0f64; UNIT]; 3];
                for x in 0..3 {
                    for lane in 0..UNIT {
                        columns[x][lane] =
                            down[0] * taps[x][lane] + down[1] * taps[3 + x][lane] + down[2] * taps[6 + x][lane];
                    }
                }
                for j in 0..SEEN {
                    let across = KERNEL[j];
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
}

/// Row `y` of the gradient of a kernel, [3 C, O], from sums of products of transformed tiles, [36 C, columns].
#[inline(always)]
fn transform_back(kernel: &mut [f32], y: usize, sums: &[f32], (inputs, outputs, columns): (usize, usize, usize)) {
    for channel in 0..inputs {
        for first in (0..outputs).step_by(UNIT) {
            let there = UNIT.min(outputs - first);
            let mut row = [[0.0f64; UNIT]; SEEN];
            for i in 0..SEEN {
                for j in 0..SEEN {
                    let from = &sums[((i * SEEN + j) * inputs + channel) * columns + first..][..UNIT];
                    for lane in 0..UNIT {
                        row[j][lane] += KERNEL[i][y] * f64::from(from[lane]);
                    }
                }
            }
            for x in 0..3 {
                let mut sum = [0.0f64; UNIT];
                for j in 0..SEEN {
                    for lane in 0..UNIT {
                        sum[lane] += KERNEL[j][x] * row[j][lane];
                    }
                }
                let to = &mut kernel[(x * inputs + channel) * outputs + first..][..there];
                for lane in 0..there {
                    to[lane] = sum[lane] as f32;
                }
            }
        }
    }
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

/// The gradient of the input: the convolution with the kernel turned round, inputs and outputs swapped.
pub(super) fn of_input(conv: &Conv3, kernel: &[f32], gradient: &[f32]) -> Vec<f32> {
    let (inputs, outputs) = (conv.inputs, conv.outputs);
    let mut turned = vec![0.0; kernel.len()];
    for (tap, to) in turned.chunks_exact_mut(outputs * inputs).enumerate() {
        let from = &kernel[(8 - tap) * inputs * outputs..][..inputs * outputs];
        for (output, to) in to.chunks_exact_mut(inputs).enumerate() {
            to.iter_mut().zip(from[output..].iter().step_by(outputs)).for_each(|(to, from)| *to = *from);
        }
    }
    let back = Conv3 { inputs: outputs, outputs: inputs, ..conv.clone() };
    convolve(&back, gradient, &turned, &vec![0.0; inputs])
}

/// The gradient of the kernel, [9 C, O]: sums of products of transformed tiles of input and gradient, transformed
/// back.
pub(super) fn of_kernel(conv: &Conv3, x: &[f32], gradient: &[f32]) -> Vec<f32> {
    let (inputs, outputs) = (conv.inputs, conv.outputs);
    let columns = outputs.next_multiple_of(UNIT);
    let (x, gradient) = (Tiles::new(conv, x, inputs), Tiles::new(conv, gradient, outputs));
    let mut sums = vec![0.0f32; PLACES * inputs * columns];
    for from in (0..x.count).step_by(SUMMED) {
        let tiles = from..(from + SUMMED).min(x.count);
        let (left, right) = (x.transformed(tiles.clone(), false), gradient.transformed(tiles.clone(), true));
        let depth = inputs.next_multiple_of(UNIT);
        sums.par_chunks_exact_mut(inputs * columns).enumerate().for_each(|(place, sums)| {
            sums.par_chunks_mut(super::ROWS * columns).enumerate().for_each(|(part, sums)| {
                let run = |first: usize| {
                    let block = TILES.min(tiles.len() - first);
                    let at = PLACES * first + place * block;
                    Run { left: at * depth, other: at * columns, rows: block }
                };
                let runs: Vec<Run> = (0..tiles.len()).step_by(TILES).map(run).collect();
                let left = Left { data: &left, stride: depth };
                add_outer_products(sums, left, part * super::ROWS, (&right, columns), &runs, conv.instructions);
            });
        });
    }
    let mut kernel = vec![0.0; 9 * inputs * outputs];
    let rows = kernel.par_chunks_exact_mut(3 * inputs * outputs).enumerate();
    rows.for_each(|(y, row)| wide(|| transform_back(row, y, &sums, (inputs, outputs, columns))));
    kernel
}

/// Tiles of images with zeros around them.
struct Tiles {
    near: Vec<f32>,
    /// Numbers of a row of pixels.
    row: usize,
    /// Rows of an image.
    lines: usize,
    channels: usize,
    across: usize,
    /// Tiles of an image.
    each: usize,
    /// Tiles of all images.
    count: usize,
    instructions: Instructions,
}

impl Tiles {
    fn new(conv: &Conv3, images: &[f32], channels: usize) -> Self {
        let (height, width) = (conv.height, conv.width);
        let (across, down) = (width.div_ceil(SIDE), height.div_ceil(SIDE));
        let (columns, lines) = (across * SIDE, down * SIDE + 2);
        let row = (columns + 2) * channels;
        let count = images.len() / (height * width * channels);
        // SAFETY: `surround` writes all rows of an image; what follows is written here.
        let near = unsafe {
            filled(count * lines * row + UNIT, |near| {
                let (near, rest) = near.split_at_mut(count * lines * row);
                rest.fill(MaybeUninit::new(0.0));
                near.par_chunks_exact_mut(lines * row)
                    .zip(images.par_chunks_exact(height * width * channels))
                    .for_each(|(near, image)| surround(near, image, (width, columns + 1 - width), channels, 0));
            })
        };
        let each = across * down;
        Self { near, row, lines, channels, across, each, count: count * each, instructions: conv.instructions }
    }

    /// The transforms of some tiles in blocks of [`TILES`]: each block [36, tiles, C], C a multiple of [`UNIT`].
    fn transformed(&self, tiles: Range<usize>, gradient: bool) -> Vec<f32> {
        let depth = self.channels.next_multiple_of(UNIT);
        let transforms = transforms(self.instructions);
        let fill = |out: &mut [MaybeUninit<f32>]| {
            out.par_chunks_mut(TILES * PLACES * depth).enumerate().for_each(|(i, block)| {
                let count = block.len() / (PLACES * depth);
                for (at, tile) in (tiles.start + i * TILES..).take(count).enumerate() {
                    let (image, tile) = (tile / self.each, tile % self.each);
                    let (down, right) = (tile / self.across * SIDE, tile % self.across * SIDE);
                    // The output of a tile begins a pixel further on than what it sees.
                    let margin = usize::from(gradient);
                    let line = image * self.lines + down + margin;
                    let mut seen = Seen {
                        from: &self.near[line * self.row + (right + margin) * self.channels..],
                        row: self.row,
                        pixel: self.channels,
                        to: &mut block[at * depth..],
                        place: count * depth,
                    };
                    if gradient { transforms.gradient(&mut seen) } else { transforms.input(&mut seen) }
                }
            });
        };
        // SAFETY: blocks cover the result, and transforms write all of a tile's places.
        unsafe { filled(tiles.len() * PLACES * depth, fill) }
    }
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
                    let mut input = Seen {
                        from: &near[(down * (columns + 2) + right) * inputs..],
                        row: (columns + 2) * inputs,
                        pixel: inputs,
                        // SAFETY: transforms write numbers.
                        to: unsafe { maybe(&mut turned[i * depth..]) },
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
                    to[y * row + x * pixel..][..there].copy_from_slice(&from[..there]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
