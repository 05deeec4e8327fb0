//! Moving 2x2 blocks of pixels into channels and back.

use super::op::{Operator, apply};
use burn::tensor::Tensor;

/// [N, H, W, C] to [N, H/2, W/2, 4 C].
pub(crate) fn fold(x: Tensor<4>) -> Tensor<4> {
    let [images, height, width, channels] = x.dims();
    let shape = [images, height / 2, width / 2, 4 * channels];
    apply(Fold { width, channels, back: false }, [x.into()], shape)
}

/// [N, H, W, 4 C] to [N, 2 H, 2 W, C]: the inverse of [`fold`].
pub(crate) fn unfold(x: Tensor<4>) -> Tensor<4> {
    let [images, height, width, channels] = x.dims();
    let shape = [images, 2 * height, 2 * width, channels / 4];
    apply(Fold { width: 2 * width, channels: channels / 4, back: true }, [x.into()], shape)
}

#[derive(Clone, Debug)]
struct Fold {
    /// Width and channels of the large image.
    width: usize,
    channels: usize,
    back: bool,
}

impl Fold {
    fn moved(&self, from: &[f32], back: bool) -> Vec<f32> {
        let mut to = vec![0.0; from.len()];
        let (row, pair) = (self.width * self.channels, 2 * self.channels);
        // Two rows of the large image are one row of the small one; a small pixel is its two upper, then lower pixels.
        for (from, to) in from.chunks_exact(2 * row).zip(to.chunks_exact_mut(2 * row)) {
            for x in 0..self.width / 2 {
                for y in 0..2 {
                    let (large, small) = (y * row + x * pair, x * 2 * pair + y * pair);
                    let (source, target) = if back { (small, large) } else { (large, small) };
                    to[target..target + pair].copy_from_slice(&from[source..source + pair]);
                }
            }
        }
        to
    }
}

impl Operator<1> for Fold {
    type Saved = ();

    fn forward(&self, [x]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        (self.moved(x, self.back), ())
    }

    fn backward(&self, _: [&[f32]; 1], _: &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        [self.moved(gradient, !self.back)]
    }
}
