//! Albedo and normals at halving resolutions, and how similar the places of a window are to its pixel.

#![expect(unsafe_code, reason = "channels of a row are read after one check")]

use super::{check_sides, edges};
use rayon::prelude::*;

/// Guides: albedo and normals.
pub const GUIDES: usize = 2;
/// Values of a pixel of all guides.
pub(super) const CHANNELS: usize = 3 * GUIDES;

/// Factor of strengths: as a weight of 1 of the last layer is large, and squared distances are small.
pub const SHARPNESS: f32 = 16.0;

/// Squared distances count as at most this, so that no guide makes infinite numbers. Unit vectors are 4 apart at most.
pub const FARTHEST: f32 = 8.0;

/// Numbers that are worked on at once: a row of a window, and what lies behind it.
pub(super) const LANES: usize = 8;

/// Where a pixel is: image, y, x.
pub(super) type Place = (usize, usize, usize);

/// [`LANES`] numbers of a slice, from the given one on.
#[inline(always)]
pub(super) fn eight(numbers: &[f32], first: usize) -> [f32; LANES] {
    numbers[first..first + LANES].try_into().expect("as many as lanes")
}

/// G-buffers [N, H, W, 6] at halving resolutions, each with a window.
#[derive(Clone, Debug)]
pub struct Guides {
    images: usize,
    height: usize,
    width: usize,
    pub(super) levels: Vec<Level>,
}

/// Means over blocks of 2^scale x 2^scale pixels, with the edge repeated around them as far as the window reaches.
#[derive(Clone, Debug)]
pub(super) struct Level {
    pub(super) side: usize,
    scale: u32,
    height: usize,
    width: usize,
    /// Numbers from one channel of a row to the next.
    stride: usize,
    /// [N, H/2^scale + side - 1, 6, stride], and what is read beyond the last window.
    data: Vec<f32>,
}

/// One level of [`Guides`].
#[derive(Clone, Debug)]
pub struct GuideBlocks {
    /// Blocks have 2^scale x 2^scale pixels.
    pub scale: u32,
    /// Side of the window, in blocks.
    pub side: usize,
    /// Means over the blocks, [N, H/2^scale + side - 1, W/2^scale + side - 1, 6], with the edge repeated around them.
    pub pixels: Vec<f32>,
}

impl Guides {
    /// Of G-buffers of `height` x `width` pixels of three values of albedo and three of the normal; levels as those of
    /// [`super::Pyramid::new`].
    pub fn new(gbuffers: &[f32], height: usize, width: usize, sides: &[usize]) -> Self {
        let images = gbuffers.len() / (CHANNELS * height * width).max(1);
        assert_eq!(gbuffers.len(), images * height * width * CHANNELS, "whole G-buffers");
        check_sides(height, width, sides);
        let mut levels: Vec<Level> = Vec::with_capacity(sides.len());
        for (scale, side) in (0..).zip(sides) {
            levels.push(match levels.last() {
                None => Level::full(gbuffers, images, (height, width), *side),
                Some(finer) => finer.halved(images, scale, *side),
            });
        }
        Self { images, height, width, levels }
    }

    /// How many images, their height and their width.
    pub fn size(&self) -> (usize, usize, usize) {
        (self.images, self.height, self.width)
    }

    /// Their levels, from full resolution down.
    pub fn levels(&self) -> impl Iterator<Item = GuideBlocks> {
        self.levels.iter().map(|level| {
            let columns = level.width + 2 * level.reach();
            let rows = level.data[..level.data.len() - LANES].chunks_exact(CHANNELS * level.stride);
            let of = |row: &[f32], x: usize| -> [f32; CHANNELS] { std::array::from_fn(|c| row[c * level.stride + x]) };
            let pixels = rows.flat_map(|row| (0..columns).flat_map(move |x| of(row, x))).collect();
            GuideBlocks { scale: level.scale, side: level.side, pixels }
        })
    }

    /// The values of a pixel.
    #[inline(always)]
    pub(super) fn pixel(&self, (image, y, x): Place) -> [f32; CHANNELS] {
        let full = &self.levels[0];
        let middle = full.reach();
        let row = full.row(image, y, middle);
        let mut out = [0.0; CHANNELS];
        for (c, out) in out.iter_mut().enumerate() {
            *out = row[c * full.stride + x + middle];
        }
        out
    }
}

impl Level {
    fn empty(images: usize, (height, width): (usize, usize), scale: u32, side: usize) -> Self {
        let stride = width + side - 1;
        let data = vec![0.0; images * (height + side - 1) * CHANNELS * stride + LANES];
        Self { side, scale, height, width, stride, data }
    }

    fn reach(&self) -> usize {
        self.side / 2
    }

    fn full(gbuffers: &[f32], images: usize, (height, width): (usize, usize), side: usize) -> Self {
        let mut level = Self::empty(images, (height, width), 0, side);
        level.fill(|image, y, row, stride| {
            let pixels = &gbuffers[CHANNELS * (image * height + y) * width..][..CHANNELS * width];
            for (x, pixel) in pixels.chunks_exact(CHANNELS).enumerate() {
                for (c, value) in pixel.iter().enumerate() {
                    row[c * stride + side / 2 + x] = *value;
                }
            }
        });
        level
    }

    fn halved(&self, images: usize, scale: u32, side: usize) -> Self {
        let mut level = Self::empty(images, (self.height / 2, self.width / 2), scale, side);
        let width = level.width;
        level.fill(|image, y, row, stride| {
            let reach = self.reach();
            let [upper, lower] = [0, 1].map(|second| self.row(image, 2 * y + second, reach));
            for c in 0..CHANNELS {
                let from = |row: &'_ [f32]| c * self.stride + reach..row.len();
                let (upper, lower) = (&upper[from(upper)], &lower[from(lower)]);
                let row = &mut row[c * stride + side / 2..][..width];
                for ((out, a), b) in row.iter_mut().zip(upper.chunks_exact(2)).zip(lower.chunks_exact(2)) {
                    *out = 0.25 * ((a[0] + a[1]) + (b[0] + b[1]));
                }
            }
        });
        level
    }

    /// Lets `f` write the inner part of each row, of image and line, whose channels are `stride` apart; repeats it at
    /// the edges.
    fn fill(&mut self, f: impl Fn(usize, usize, &mut [f32], usize) + Sync) {
        let (stride, reach, rows, height, width) =
            (self.stride, self.reach(), self.height + self.side - 1, self.height, self.width);
        let rows_end = self.data.len() - LANES;
        self.data[..rows_end].par_chunks_exact_mut(CHANNELS * stride).enumerate().for_each(|(at, row)| {
            let (image, y) = edges(at, rows, reach, height);
            f(image, y, row, stride);
            for channel in row.chunks_exact_mut(stride) {
                let (first, last) = (channel[reach], channel[reach + width - 1]);
                channel[..reach].fill(first);
                channel[reach + width..].fill(last);
            }
        });
    }

    /// A row of all channels: `down` rows below the first of the windows of a row of blocks.
    #[inline(always)]
    fn row(&self, image: usize, y: usize, down: usize) -> &[f32] {
        let at = image * (self.height + self.side - 1) + y + down;
        &self.data[at * CHANNELS * self.stride..][..CHANNELS * self.stride]
    }

    /// A row of the window around a pixel, for each channel, and numbers beyond it.
    #[inline(always)]
    pub(super) fn window(&self, (image, y, x): Place, down: usize) -> [[f32; LANES]; CHANNELS] {
        let row = image * (self.height + self.side - 1) + (y >> self.scale) + down;
        let first = row * CHANNELS * self.stride + (x >> self.scale);
        assert!(first + (CHANNELS - 1) * self.stride + LANES <= self.data.len(), "a row of an image");
        let mut out = [[0.0; LANES]; CHANNELS];
        for (c, out) in out.iter_mut().enumerate() {
            // SAFETY: the last channel is the farthest, and its numbers are there.
            *out = unsafe { self.data.as_ptr().add(first + c * self.stride).cast::<[f32; LANES]>().read_unaligned() };
        }
        out
    }
}

/// The squared distances between the values of a guide in a row of a window and those of the pixel.
#[inline(always)]
pub(super) fn distances(window: &[[f32; LANES]; CHANNELS], own: &[f32; CHANNELS], guide: usize) -> [f32; LANES] {
    let mut out = [0.0; LANES];
    for (i, out) in out.iter_mut().enumerate() {
        let first = 3 * guide;
        let [a, b, c] = [
            window[first][i] - own[first],
            window[first + 1][i] - own[first + 1],
            window[first + 2][i] - own[first + 2],
        ];
        let square = a * a + b * b + c * c;
        // NaN counts as far.
        *out = if square < FARTHEST { square } else { FARTHEST };
    }
    out
}
