//! Logits of a [`Pyramid`]'s places that depend on how similar the places are to the pixel.

use super::{PIXELS, Pyramid, STRIDE};
use crate::{instructions::wide, operator::Operator};
use rayon::prelude::*;
use std::sync::Arc;

/// Places of the largest window of a guide.
const LARGEST: usize = 25;

/// Subtracts from the number of each place the squared distance between the guide's three values there and those of the
/// pixel, at most [`FARTHEST`], times [`SHARPNESS`] and a strength. Each pixel has a strength for each level and guide.
///
/// The inputs are the numbers [N, H, W, [`Pyramid::weights`]] and the strengths [N, H, W, levels, guides]. All guides
/// have the size and the windows of the image that is averaged.
#[derive(Clone, Debug)]
pub struct Guided(pub Vec<Arc<Pyramid>>);

/// Factor of strengths: as a weight of 1 of the last layer is large, and squared distances are small.
pub const SHARPNESS: f32 = 16.0;

/// Squared distances count as at most this, so that no guide makes infinite numbers. Unit vectors are 4 apart at most.
pub const FARTHEST: f32 = 8.0;

impl Guided {
    /// Calls `f` with level and guide, the first place of the level, and the squared distances of its places.
    #[inline(always)]
    fn distances(&self, (image, y, x): (usize, usize, usize), mut f: impl FnMut(usize, usize, &[f32])) {
        let mut found = [0.0f32; LARGEST];
        for (guide, pyramid) in self.0.iter().enumerate() {
            let full = &pyramid.levels[0];
            let middle = full.side / 2;
            let start = image * full.size + (y + middle) * full.stride + (x + middle) * STRIDE;
            let own: [f32; 3] = [0, 1, 2].map(|c| full.data[start + c]);
            let mut first = 0;
            for (level, blocks) in pyramid.levels.iter().enumerate() {
                let count = blocks.side * blocks.side;
                for (row, out) in blocks.window(image, y, x).zip(found.chunks_exact_mut(blocks.side)) {
                    for (pixel, out) in row.chunks_exact(STRIDE).zip(out) {
                        let d = [0, 1, 2].map(|c| pixel[c] - own[c]);
                        *out = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).min(FARTHEST);
                    }
                }
                f(level * self.0.len() + guide, first, &found[..count]);
                first += count;
            }
        }
    }

    /// Calls `f` for each pixel with its place, its part of the output, its numbers and its strengths.
    fn pixels(
        &self,
        out: &mut [f32],
        channels: usize,
        (numbers, strengths): (&[f32], &[f32]),
        f: impl Fn((usize, usize, usize), &mut [f32], &[f32], &[f32]) + Sync,
    ) {
        let Pyramid { images, height, width, .. } = *self.0[0];
        let (pixels, count, each) = (images * height * width, self.0[0].weights(), self.strengths());
        let sides = |pyramid: &Pyramid| pyramid.levels.iter().map(|level| level.side).collect::<Vec<_>>();
        let windows = sides(&self.0[0]);
        assert!(windows.iter().all(|side| side * side <= LARGEST), "windows of up to {LARGEST}: {windows:?}");
        let same = |guide: &Arc<Pyramid>| guide.size() == (images, height, width) && sides(guide) == windows;
        assert!(self.0.iter().all(same), "guides of one size, with the same windows");
        assert_eq!(numbers.len(), pixels * count, "a number for each place of the windows");
        assert_eq!(strengths.len(), pixels * each, "strengths for each pixel");
        assert_eq!(out.len(), pixels * channels, "an output for each pixel");
        let rows = out.par_chunks_exact_mut(width * channels);
        let rows = rows.zip(numbers.par_chunks_exact(width * count)).zip(strengths.par_chunks_exact(width * each));
        rows.enumerate().with_min_len(PIXELS.div_ceil(width)).for_each(|(row, ((out, numbers), strengths))| {
            wide(
                #[inline(always)]
                || {
                    let pixels = out.chunks_exact_mut(channels).zip(numbers.chunks_exact(count));
                    for (x, ((out, numbers), strengths)) in pixels.zip(strengths.chunks_exact(each)).enumerate() {
                        f((row / height, row % height, x), out, numbers, strengths);
                    }
                },
            );
        });
    }

    /// Strengths of a pixel.
    pub fn strengths(&self) -> usize {
        self.0.len() * self.0[0].levels.len()
    }
}

impl Operator<2> for Guided {
    type Saved = ();

    fn forward(&self, [numbers, strengths]: [&[f32]; 2]) -> (Vec<f32>, ()) {
        let mut out = vec![0.0; numbers.len()];
        self.pixels(
            &mut out,
            self.0[0].weights(),
            (numbers, strengths),
            #[inline(always)]
            |place, out, numbers, strengths| {
                out.copy_from_slice(numbers);
                self.distances(
                    place,
                    #[inline(always)]
                    |at, first, distances| {
                        let strength = SHARPNESS * strengths[at];
                        for (out, distance) in out[first..].iter_mut().zip(distances) {
                            *out -= strength * distance;
                        }
                    },
                );
            },
        );
        (out, ())
    }

    fn backward(&self, inputs: [&[f32]; 2], (): &(), gradient: &[f32], _: [bool; 2]) -> [Vec<f32>; 2] {
        let mut out = vec![0.0; inputs[1].len()];
        self.pixels(
            &mut out,
            self.strengths(),
            (gradient, inputs[1]),
            #[inline(always)]
            |place, out, gradient, _| {
                self.distances(
                    place,
                    #[inline(always)]
                    |at, first, distances| {
                        let sum: f32 = gradient[first..].iter().zip(distances).map(|(g, d)| g * d).sum();
                        out[at] = -SHARPNESS * sum;
                    },
                );
            },
        );
        [gradient.to_vec(), out]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made_up::numbers;

    const SIDES: [usize; 3] = [5, 3, 1];
    const SIZE: (usize, usize) = (8, 12);

    #[test]
    fn guides_lower_what_looks_different_as_defined() {
        let (height, width) = SIZE;
        let pixels = numbers(3, 2 * height * width * 3);
        let first = Pyramid::new(&pixels, height, width, &SIDES);
        let mut other = numbers(4, 2 * height * width * 3);
        // Some pixels are farther than counts, one beyond all numbers.
        other.iter_mut().step_by(50).for_each(|value| *value *= 4.0);
        other[100] = 1e30;
        let second = Pyramid::new(&other, height, width, &SIDES);
        let guides = [&pixels, &other];
        let guided = Guided(vec![Arc::new(first), Arc::new(second)]);
        let (count, each) = (guided.0[0].weights(), guided.strengths());
        assert_eq!(each, 6);
        let logits = numbers(5, 2 * height * width * count);
        let strengths = numbers(6, 2 * height * width * each);
        let (out, ()) = guided.forward([&logits, &strengths]);
        let gradient = numbers(7, out.len());
        let [of_logits, of_strengths] = guided.backward([&logits, &strengths], &(), &gradient, [true; 2]);
        assert_eq!(of_logits, gradient);
        for at in 0..2 * height * width {
            let (image, y, x) = (at / (height * width), at / width % height, at % width);
            let (mut place, mut slopes) = (0, vec![0.0; each]);
            for (level, side) in SIDES.iter().enumerate() {
                let (block, reach) = (1usize << level, (side / 2) as i64);
                for (dy, dx) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dy, dx))) {
                    let edge = |v: usize, d: i64, size: usize| {
                        ((v / block) as i64 + d).clamp(0, (size / block) as i64 - 1) as usize * block
                    };
                    let (v, u) = (edge(y, dy, height), edge(x, dx, width));
                    let mut expected = f64::from(logits[at * count + place]);
                    for (guide, values) in guides.iter().enumerate() {
                        let mut distance = 0.0;
                        for c in 0..3 {
                            let of = |y: usize, x: usize| f64::from(values[3 * ((image * height + y) * width + x) + c]);
                            let inside = (0..block * block).map(|i| of(v + i / block, u + i % block)).sum::<f64>();
                            distance += (inside / (block * block) as f64 - of(y, x)).powi(2);
                        }
                        let distance = distance.min(f64::from(FARTHEST));
                        let strength = level * 2 + guide;
                        expected -= f64::from(SHARPNESS * strengths[at * each + strength]) * distance;
                        slopes[strength] -= f64::from(SHARPNESS * gradient[at * count + place]) * distance;
                    }
                    let found = f64::from(out[at * count + place]);
                    assert!((found - expected).abs() < 1e-4, "{at} {place}: {found} {expected}");
                    place += 1;
                }
            }
            for (found, expected) in of_strengths[at * each..].iter().zip(slopes) {
                assert!((f64::from(*found) - expected).abs() < 1e-3, "{at}: {found} {expected}");
            }
        }
    }
}
