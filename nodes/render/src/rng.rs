//! The random numbers of a render: each a function of (scene seed, stream, pixel, sample index, dimension).
//!
//! Nothing here depends on the film's size, the thread or the tile, and a number that is not drawn changes no other:
//! features that a scene lacks can be skipped without changing a bit of it.

use crate::{
    lanes::{Pair, Real},
    sobol,
};
use glam::Vec2;
use tauflow_data::{SamplerKind, rng::mix};

/// The numbers of one sample of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct Sampler {
    state: u64,
    kind: SamplerKind,
}

/// Dimension of a sample's place in its pixel.
pub(crate) const FILM: u64 = 0;

/// Dimensions of one path vertex; see [`Sampler::vertex`].
pub const VERTEX_DIMENSIONS: u64 = 8;

/// State of a whole render, mixed once.
pub fn render_state(seed: u64, stream: u64) -> u64 {
    mix(mix(0x7265_6E64_6572_3031, seed), stream)
}

impl Sampler {
    /// The numbers of sample `index` at a pixel; of Sobol' points there are 2^32.
    #[inline]
    pub fn new(kind: SamplerKind, render_state: u64, pixel: (u32, u32), index: u64) -> Self {
        let pixel = u64::from(pixel.0) | u64::from(pixel.1) << 32;
        let own = mix(render_state, pixel);
        let state = match kind {
            SamplerKind::Independent => mix(own, index),
            SamplerKind::Sobol => own & !u64::from(u32::MAX) | index & u64::from(u32::MAX),
        };
        Self { state, kind }
    }

    /// The key of all its numbers.
    #[inline(always)]
    pub(crate) fn state(&self) -> u64 {
        self.state
    }

    /// 64 random bits of a dimension, of which the upper 48 are used.
    #[inline]
    pub fn bits(&self, dimension: u64) -> u64 {
        match self.kind {
            SamplerKind::Independent => mix(self.state, dimension),
            SamplerKind::Sobol => {
                let [x, y] = sobol::point(self.state as u32, mix(self.state >> 32, dimension));
                u64::from(x >> 8) << 40 | u64::from(y >> 8) << 16
            }
        }
    }

    /// A number in [0, 1), with 24 bits.
    #[inline]
    pub fn one(&self, dimension: u64) -> f32 {
        (self.bits(dimension) >> 40) as f32 * (1.0 / (1u32 << 24) as f32)
    }

    /// A point in [0, 1)^2.
    #[inline]
    pub fn two(&self, dimension: u64) -> Vec2 {
        let bits = self.bits(dimension);
        let unit = 1.0 / (1u32 << 24) as f32;
        Vec2::new((bits >> 40) as f32 * unit, ((bits >> 16) & 0xFF_FFFF) as f32 * unit)
    }

    /// First dimension of a path's vertex `depth`; the film has those below that of vertex 0.
    #[inline]
    pub fn vertex(depth: u32) -> u64 {
        VERTEX_DIMENSIONS * (1 + u64::from(depth))
    }
}

/// Points of many samples of one kind in a dimension, lane by lane; `states` are those of their samplers.
#[inline(always)]
pub(crate) fn draw<R: Real, const SPARE: usize>(kind: SamplerKind, states: &[u64; SPARE], dimension: u64) -> Pair<R> {
    if kind == SamplerKind::Independent {
        let (x, y) = R::draw(states, dimension);
        return Pair::new(x, y);
    }
    let (mut x, mut y) = ([0.0; SPARE], [0.0; SPARE]);
    for lane in 0..R::N {
        let point = Sampler { state: states[lane], kind }.two(dimension);
        (x[lane], y[lane]) = (point.x, point.y);
    }
    Pair::new(R::load(&x), R::load(&y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_uniform_and_uncorrelated() {
        let state = render_state(7, 0);
        let n = 64 * 64 * 16;
        for dimension in [0, 1, 8, 9, 17] {
            let (mut sum, mut square, mut cross, mut next) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
            let mut cells = [0u32; 256];
            for i in 0..n as u64 {
                let pixel = ((i % 64) as u32, (i / 64 % 64) as u32);
                let sampler = Sampler::new(SamplerKind::Independent, state, pixel, i / 4096);
                let p = sampler.two(dimension);
                assert!(p.x >= 0.0 && p.x < 1.0 && p.y >= 0.0 && p.y < 1.0);
                let (x, y) = (f64::from(p.x) - 0.5, f64::from(p.y) - 0.5);
                sum += x;
                square += x * x;
                cross += x * y;
                let following = Sampler::new(SamplerKind::Independent, state, pixel, i / 4096 + 1);
                next += x * (f64::from(following.one(dimension)) - 0.5);
                cells[(p.x * 16.0) as usize * 16 + (p.y * 16.0) as usize] += 1;
            }
            let n = n as f64;
            // Standard errors: 1.1e-3, 2.9e-4, 3.3e-4; five of each.
            assert!((sum / n).abs() < 5.7e-3, "mean {}", sum / n);
            assert!((square / n - 1.0 / 12.0).abs() < 1.5e-3);
            assert!((cross / n).abs() < 1.7e-3 && (next / n).abs() < 1.7e-3);
            // Chi square of 255 degrees: mean 255, deviation 22.6.
            let expected = n / 256.0;
            let chi: f64 = cells.iter().map(|c| (f64::from(*c) - expected).powi(2) / expected).sum();
            assert!(chi < 255.0 + 5.0 * 22.6, "chi square {chi}");
        }
    }

    #[test]
    fn every_coordinate_counts() {
        for kind in [SamplerKind::Independent, SamplerKind::Sobol] {
            let one = |seed, stream, pixel, index, dimension| {
                Sampler::new(kind, render_state(seed, stream), pixel, index).bits(dimension)
            };
            let base = one(1, 0, (3, 4), 5, 6);
            let others =
                [one(2, 0, (3, 4), 5, 6), one(1, 1, (3, 4), 5, 6), one(1, 0, (4, 3), 5, 6), one(1, 0, (3, 4), 6, 5)];
            assert!(others.iter().all(|o| *o != base), "{kind:?}");
        }
    }
}
