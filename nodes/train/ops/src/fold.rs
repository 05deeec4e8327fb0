//! Moving 2x2 blocks of pixels into channels and back.

#![expect(unsafe_code, reason = "results are written once; each pixel has its place")]

use crate::{fresh::filled, operator::Operator};
use rayon::prelude::*;
use std::mem::MaybeUninit;

/// [N, H, W, C] to [N, H/2, W/2, 4 C], or back: a small pixel is its two upper, then its two lower pixels.
#[derive(Clone, Debug)]
pub struct Fold {
    /// Height of the large image, even.
    pub height: usize,
    /// Width of the large image, even.
    pub width: usize,
    /// Channels of the large image.
    pub channels: usize,
    /// From the small image to the large one.
    pub back: bool,
}

impl Fold {
    fn moved(&self, from: &[f32], back: bool) -> Vec<f32> {
        let size = self.height.checked_mul(self.width).and_then(|pixels| pixels.checked_mul(self.channels));
        assert!(self.width.is_multiple_of(2) && self.height.is_multiple_of(2), "even sides of {self:?}");
        assert!(size.is_some_and(|size| size > 0 && from.len().is_multiple_of(size)), "whole images of {self:?}");
        // SAFETY: every pixel of the one image has its place in the other.
        unsafe { filled(from.len(), |to| self.move_to(to, from, back)) }
    }

    fn move_to(&self, to: &mut [MaybeUninit<f32>], from: &[f32], back: bool) {
        let (row, pair) = (self.width * self.channels, 2 * self.channels);
        // Two rows of the large image are one row of the small one; a small pixel is its two upper, then lower pixels.
        from.par_chunks_exact(2 * row).zip(to.par_chunks_exact_mut(2 * row)).with_min_len(4).for_each(|(from, to)| {
            for x in 0..self.width / 2 {
                for y in 0..2 {
                    let (large, small) = (y * row + x * pair, x * 2 * pair + y * pair);
                    let (source, target) = if back { (small, large) } else { (large, small) };
                    to[target..target + pair].write_copy_of_slice(&from[source..source + pair]);
                }
            }
        });
    }
}

impl Operator<1> for Fold {
    type Saved = ();

    fn forward(&self, [x]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        (self.moved(x, self.back), ())
    }

    fn backward(&self, _: [&[f32]; 1], (): &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        [self.moved(gradient, !self.back)]
    }
}
