//! Means of what lies around each pixel of an image, weighted by a softmax, over windows at several scales.
//!
//! Kernel-predicting networks (Bako et al. 2017) end so: whatever their weights, what comes out lies within what went
//! in.

mod guides;
mod means;

pub use guides::{FARTHEST, GUIDES, GuideBlocks, Guides, SHARPNESS};
pub use means::{GuidedMean, WeightedMean};

use rayon::prelude::*;
use std::borrow::Cow;

/// Values of a stored pixel: three colours and a one, with which weights add up beside the colours.
const STRIDE: usize = 4;

/// Images [N, H, W, 3] at halving resolutions, each with a window.
#[derive(Clone, Debug)]
pub struct Pyramid {
    images: usize,
    height: usize,
    width: usize,
    levels: Vec<Level>,
}

/// One level of a [`Pyramid`].
#[derive(Clone, Copy, Debug)]
pub struct Blocks<'a> {
    /// Blocks have 2^scale x 2^scale pixels.
    pub scale: u32,
    /// Side of the window, in blocks.
    pub side: usize,
    /// Means over the blocks, [N, H/2^scale + side - 1, W/2^scale + side - 1, 4]: with the edge repeated around them,
    /// three colours and a one.
    pub pixels: &'a [f32],
}

/// Means over blocks of 2^scale x 2^scale pixels, with the edge repeated around them as far as the window reaches.
#[derive(Clone, Debug)]
struct Level {
    scale: u32,
    /// Odd.
    side: usize,
    /// Of a row, with what is around it.
    stride: usize,
    /// Of an image, with what is around it.
    size: usize,
    data: Vec<f32>,
}

impl Pyramid {
    /// Of images of `height` x `width` pixels: level i has means over blocks of 2^i pixels, and a window of `sides[i]`
    /// x `sides[i]` of them. Height and width must be multiples of the largest blocks, and sides 1, 3 or 5.
    pub fn new(pixels: &[f32], height: usize, width: usize, sides: &[usize]) -> Self {
        let images = pixels.len() / (3 * height * width).max(1);
        assert_eq!(pixels.len(), images * height * width * 3, "whole images of three colours");
        check_sides(height, width, sides);
        let mut levels = Vec::with_capacity(sides.len());
        let (mut current, mut h, mut w) = (Cow::Borrowed(pixels), height, width);
        for (scale, side) in (0..).zip(sides) {
            if scale > 0 {
                current = Cow::Owned(halved(&current, h, w));
                (h, w) = (h / 2, w / 2);
            }
            levels.push(Level::new(&current, images, (h, w), scale, *side));
        }
        Self { images, height, width, levels }
    }

    /// How many images, their height and their width.
    pub fn size(&self) -> (usize, usize, usize) {
        (self.images, self.height, self.width)
    }

    /// Its levels, from full resolution down.
    pub fn levels(&self) -> impl Iterator<Item = Blocks<'_>> {
        self.levels.iter().map(|level| Blocks { scale: level.scale, side: level.side, pixels: &level.data })
    }

    /// Weights of a pixel: those of all windows.
    pub fn weights(&self) -> usize {
        self.levels.iter().map(|level| level.side * level.side).sum()
    }
}

/// Panics unless height and width are multiples of the largest blocks, and windows of known sides.
fn check_sides(height: usize, width: usize, sides: &[usize]) {
    assert!(!sides.is_empty() && sides.iter().all(|side| matches!(side, 1 | 3 | 5)), "sides of 1, 3 or 5: {sides:?}");
    let block = 1 << (sides.len() - 1);
    assert!(height.is_multiple_of(block) && width.is_multiple_of(block), "blocks of {block} in {height} x {width}");
}

/// Image and line of a row, of `rows` of each image with the edge repeated around its lines.
fn edges(at: usize, rows: usize, reach: usize, height: usize) -> (usize, usize) {
    (at / rows, (at % rows).saturating_sub(reach).min(height - 1))
}

/// Means over blocks of two by two pixels.
fn halved(pixels: &[f32], height: usize, width: usize) -> Vec<f32> {
    let row = 3 * width;
    let mut out = Vec::with_capacity(pixels.len() / 4);
    for pair in pixels.chunks_exact(2 * row).take(pixels.len() / (3 * height * width) * height / 2) {
        let (upper, lower) = pair.split_at(row);
        for (a, b) in upper.chunks_exact(6).zip(lower.chunks_exact(6)) {
            out.extend((0..3).map(|c| 0.25 * ((a[c] + a[3 + c]) + (b[c] + b[3 + c]))));
        }
    }
    out
}

impl Level {
    fn new(pixels: &[f32], images: usize, (height, width): (usize, usize), scale: u32, side: usize) -> Self {
        let reach = side / 2;
        let (stride, rows) = ((width + 2 * reach) * STRIDE, height + 2 * reach);
        let mut data = vec![0.0; images * rows * stride];
        data.par_chunks_exact_mut(stride).enumerate().for_each(|(at, row)| {
            let (image, y) = edges(at, rows, reach, height);
            for (x, pixel) in row.chunks_exact_mut(STRIDE).enumerate() {
                let from = 3 * ((image * height + y) * width + x.saturating_sub(reach).min(width - 1));
                pixel[..3].copy_from_slice(&pixels[from..from + 3]);
                pixel[3] = 1.0;
            }
        });
        Self { scale, side, stride, size: rows * stride, data }
    }

    /// A row of the window around a pixel of an image.
    #[inline(always)]
    fn window<const SIDE: usize>(&self, (image, y, x): (usize, usize, usize), row: usize) -> &[[f32; STRIDE]; SIDE] {
        let first = image * self.size + ((y >> self.scale) + row) * self.stride + (x >> self.scale) * STRIDE;
        let (pixels, _) = self.data[first..first + SIDE * STRIDE].as_chunks();
        pixels.try_into().expect("as many as the side")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_that_do_not_divide_and_large_windows_are_refused() {
        let refused = std::panic::catch_unwind(|| Pyramid::new(&[0.0; 6 * 4 * 3], 6, 4, &[3, 3, 3]));
        assert!(refused.is_err());
        let refused = std::panic::catch_unwind(|| Guides::new(&[0.0; 8 * 4 * 6], 8, 4, &[7, 3]));
        assert!(refused.is_err());
    }
}
