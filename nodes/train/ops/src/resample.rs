//! Images at half and at twice their size, and channels side by side. Each is linear, so that its gradient is its
//! transpose. Images are [N, H, W, C].

use crate::operator::Operator;
use rayon::prelude::*;

/// The 3x3 patches of every second pixel, [N, H/2, W/2, 9 C], from a pixel to the right and downwards. Beyond the image
/// there are a column and a row of zeros. With a linear map after it, this is the strided convolution of diffusers'
/// `Downsample2D` with padding 0. H and W are even.
#[derive(Clone, Debug)]
pub struct Patches {
    /// H.
    pub height: usize,
    /// W.
    pub width: usize,
    /// C.
    pub channels: usize,
}

/// Every pixel twice in each direction: [N, 2 H, 2 W, C].
#[derive(Clone, Debug)]
pub struct Nearest {
    /// H.
    pub height: usize,
    /// W.
    pub width: usize,
    /// C.
    pub channels: usize,
}

/// Resampling by the filter 1 3 3 1 (Karras et al. 2020, `upfirdn2d`): to [N, 2 H, 2 W, C], or to [N, H/2, W/2, C], for
/// which H and W are even. Beyond the image there is nothing.
#[derive(Clone, Debug)]
pub struct Fir {
    /// H.
    pub height: usize,
    /// W.
    pub width: usize,
    /// C.
    pub channels: usize,
    /// Whether the image becomes larger.
    pub up: bool,
}

/// The channels of one image, then those of another, pixel by pixel.
#[derive(Clone, Debug)]
pub struct Beside {
    /// Channels of both.
    pub channels: [usize; 2],
}

/// Whole images, each made from one: `size` numbers to `made` numbers by `f`.
fn by_image(x: &[f32], size: usize, made: usize, f: impl Fn(&mut [f32], &[f32]) + Sync) -> Vec<f32> {
    assert!(size > 0 && x.len().is_multiple_of(size), "whole images of {size} numbers");
    let mut out = vec![0.0; x.len() / size * made];
    out.par_chunks_exact_mut(made.max(1)).zip(x.par_chunks_exact(size)).for_each(|(out, x)| f(out, x));
    out
}

impl Patches {
    fn size(&self) -> usize {
        assert!(self.height.is_multiple_of(2) && self.width.is_multiple_of(2), "an even size of {self:?}");
        self.height * self.width * self.channels
    }

    /// The numbers of a row of taps that lie within the image.
    fn inside(&self, column: usize) -> usize {
        (self.width - 2 * column).min(3) * self.channels
    }
}

impl Operator<1> for Patches {
    type Saved = ();

    fn forward(&self, [x]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        let (c, columns) = (self.channels, self.width / 2);
        let size = self.size();
        let out = by_image(x, size, size / 4 * 9, |out, x| {
            out.par_chunks_exact_mut(columns * 9 * c).enumerate().for_each(|(row, out)| {
                for (column, out) in out.chunks_exact_mut(9 * c).enumerate() {
                    let inside = self.inside(column);
                    for (ky, out) in out.chunks_exact_mut(3 * c).enumerate().take(self.height - 2 * row) {
                        let from = ((2 * row + ky) * self.width + 2 * column) * c;
                        out[..inside].copy_from_slice(&x[from..from + inside]);
                    }
                }
            });
        });
        (out, ())
    }

    fn backward(&self, _: [&[f32]; 1], (): &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        let (c, columns) = (self.channels, self.width / 2);
        let size = self.size();
        [by_image(gradient, size / 4 * 9, size, |of_x, gradient| {
            for (at, gradient) in gradient.chunks_exact(9 * c).enumerate() {
                let (row, column) = (at / columns, at % columns);
                let inside = self.inside(column);
                for (ky, gradient) in gradient.chunks_exact(3 * c).enumerate().take(self.height - 2 * row) {
                    let to = ((2 * row + ky) * self.width + 2 * column) * c;
                    of_x[to..to + inside].iter_mut().zip(gradient).for_each(|(sum, g)| *sum += g);
                }
            }
        })]
    }
}

impl Operator<1> for Nearest {
    type Saved = ();

    fn forward(&self, [x]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        let (row, c) = (self.width * self.channels, self.channels);
        let size = self.height * row;
        let out = by_image(x, size, 4 * size, |out, x| {
            out.par_chunks_exact_mut(2 * row).enumerate().for_each(|(y, out)| {
                let from = x[y / 2 * row..][..row].chunks_exact(c);
                for (out, pixel) in out.chunks_exact_mut(2 * c).zip(from) {
                    out[..c].copy_from_slice(pixel);
                    out[c..].copy_from_slice(pixel);
                }
            });
        });
        (out, ())
    }

    fn backward(&self, _: [&[f32]; 1], (): &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        let (row, c) = (self.width * self.channels, self.channels);
        let size = self.height * row;
        [by_image(gradient, 4 * size, size, |of_x, gradient| {
            of_x.par_chunks_exact_mut(row).enumerate().for_each(|(y, of_x)| {
                let (first, second) = gradient[4 * y * row..][..4 * row].split_at(2 * row);
                let pairs = first.chunks_exact(2 * c).zip(second.chunks_exact(2 * c));
                for (of_x, (first, second)) in of_x.chunks_exact_mut(c).zip(pairs) {
                    for i in 0..c {
                        of_x[i] = first[i] + first[c + i] + (second[i] + second[c + i]);
                    }
                }
            });
        })]
    }
}

/// `near` and `far` parts of two rows of numbers, which may be beyond the image.
fn blend(out: &mut [f32], [first, second]: [Option<&[f32]>; 2], [a, b]: [f32; 2]) {
    match (first, second) {
        (Some(first), Some(second)) => {
            out.iter_mut().zip(first).zip(second).for_each(|((out, x), y)| *out = a * x + b * y);
        }
        (Some(first), None) => out.iter_mut().zip(first).for_each(|(out, x)| *out = a * x),
        (None, Some(second)) => out.iter_mut().zip(second).for_each(|(out, y)| *out = b * y),
        (None, None) => out.fill(0.0),
    }
}

/// One of so many runs of numbers, each as long; none beyond them.
fn run(values: &[f32], length: usize, at: isize) -> Option<&[f32]> {
    let at = usize::try_from(at).ok()?;
    values.get(at * length..(at + 1) * length)
}

/// Twice as many runs: each 3/4 of the nearer and 1/4 of the farther neighbour, times `gain`.
fn twice(out: &mut [f32], x: &[f32], length: usize, gain: f32) {
    for (i, out) in out.chunks_exact_mut(length).enumerate() {
        let at = (i / 2) as isize;
        let other = if i % 2 == 0 { at - 1 } else { at + 1 };
        blend(out, [run(x, length, at), run(x, length, other)], [0.75 * gain, 0.25 * gain]);
    }
}

/// Half as many runs: 1/8, 3/8, 3/8, 1/8 of four neighbours, times `gain`.
fn half(out: &mut [f32], x: &[f32], length: usize, gain: f32) {
    for (i, out) in out.chunks_exact_mut(length).enumerate() {
        let at = 2 * i as isize;
        blend(out, [run(x, length, at), run(x, length, at + 1)], [0.375 * gain; 2]);
        for other in [at - 1, at + 2] {
            if let Some(x) = run(x, length, other) {
                out.iter_mut().zip(x).for_each(|(out, x)| *out += 0.125 * gain * x);
            }
        }
    }
}

impl Fir {
    /// Images of `height` x `width` at twice their size, times `gain` in each direction.
    fn larger(x: &[f32], (height, width, c): (usize, usize, usize), gain: f32) -> Vec<f32> {
        let row = width * c;
        by_image(x, height * row, 4 * height * row, |out, x| {
            out.par_chunks_exact_mut(2 * row).enumerate().for_each(|(y, out)| {
                let at = (y / 2) as isize;
                let other = if y % 2 == 0 { at - 1 } else { at + 1 };
                let mut line = vec![0.0; row];
                blend(&mut line, [run(x, row, at), run(x, row, other)], [0.75 * gain, 0.25 * gain]);
                twice(out, &line, c, gain);
            });
        })
    }

    /// Images of `height` x `width` at half their size, times `gain` in each direction.
    fn smaller(x: &[f32], (height, width, c): (usize, usize, usize), gain: f32) -> Vec<f32> {
        assert!(height.is_multiple_of(2) && width.is_multiple_of(2), "an even size, not {height} x {width}");
        let row = width * c;
        by_image(x, height * row, height * row / 4, |out, x| {
            out.par_chunks_exact_mut(row / 2).enumerate().for_each(|(y, out)| {
                let (mut line, at) = (vec![0.0; row], 2 * y as isize);
                blend(&mut line, [run(x, row, at), run(x, row, at + 1)], [0.375 * gain; 2]);
                for other in [at - 1, at + 2] {
                    if let Some(x) = run(x, row, other) {
                        line.iter_mut().zip(x).for_each(|(line, x)| *line += 0.125 * gain * x);
                    }
                }
                half(out, &line, c, gain);
            });
        })
    }
}

impl Operator<1> for Fir {
    type Saved = ();

    fn forward(&self, [x]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        let size = (self.height, self.width, self.channels);
        (if self.up { Self::larger(x, size, 1.0) } else { Self::smaller(x, size, 1.0) }, ())
    }

    fn backward(&self, _: [&[f32]; 1], (): &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        let (h, w, c) = (self.height, self.width, self.channels);
        // Each is half the other's transpose in each direction.
        [if self.up {
            Self::smaller(gradient, (2 * h, 2 * w, c), 2.0)
        } else {
            Self::larger(gradient, (h / 2, w / 2, c), 0.5)
        }]
    }
}

impl Operator<2> for Beside {
    type Saved = ();

    fn forward(&self, [a, b]: [&[f32]; 2]) -> (Vec<f32>, ()) {
        let [of_a, of_b] = self.channels;
        assert!(of_a > 0 && of_b > 0 && a.len() / of_a == b.len() / of_b, "as many pixels of both of {self:?}");
        let mut out = vec![0.0; a.len() + b.len()];
        let pixels = a.par_chunks_exact(of_a).zip(b.par_chunks_exact(of_b));
        out.par_chunks_exact_mut(of_a + of_b).zip(pixels).with_min_len(256).for_each(|(out, (a, b))| {
            out[..of_a].copy_from_slice(a);
            out[of_a..].copy_from_slice(b);
        });
        (out, ())
    }

    fn backward(&self, [a, b]: [&[f32]; 2], (): &(), gradient: &[f32], _: [bool; 2]) -> [Vec<f32>; 2] {
        let [of_a, of_b] = self.channels;
        let (mut left, mut right) = (Vec::with_capacity(a.len()), Vec::with_capacity(b.len()));
        for pixel in gradient.chunks_exact(of_a + of_b) {
            left.extend_from_slice(&pixel[..of_a]);
            right.extend_from_slice(&pixel[of_a..]);
        }
        [left, right]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made_up::numbers;

    /// <A x, y> = <x, A^T y> for random x and y, whatever A is.
    fn transposed<O: Operator<1>>(operator: &O, size: usize) {
        let x = numbers(1, size);
        let (out, saved) = operator.forward([&x]);
        let y = numbers(2, out.len());
        let [back] = operator.backward([&x], &saved, &y, [true]);
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        let (found, expected) = (dot(&back, &x), dot(&out, &y));
        assert!((found - expected).abs() < 1e-5 * expected.abs().max(1.0), "{operator:?}: {found} {expected}");
    }

    #[test]
    fn gradients_are_transposes() {
        let (height, width, channels) = (6, 4, 3);
        let size = 2 * height * width * channels;
        transposed(&Patches { height, width, channels }, size);
        transposed(&Nearest { height, width, channels }, size);
        transposed(&Fir { height, width, channels, up: true }, size);
        transposed(&Fir { height, width, channels, up: false }, size);
    }

    #[test]
    fn small_cases_by_hand() {
        let up = |values: &[f32]| Fir { height: 1, width: values.len(), channels: 1, up: true }.forward([values]).0;
        // Beyond the image there is nothing: the only row counts 3/4.
        assert_eq!(up(&[4.0, 8.0])[..4], [2.25, 3.75, 5.25, 4.5]);
        let down = Fir { height: 2, width: 2, channels: 1, up: false };
        assert_eq!(down.forward([&[64.0, 0.0, 0.0, 0.0]]).0, [9.0]);
        let patches = Patches { height: 2, width: 2, channels: 1 };
        assert_eq!(patches.forward([&[1.0, 2.0, 3.0, 4.0]]).0, [1.0, 2.0, 0.0, 3.0, 4.0, 0.0, 0.0, 0.0, 0.0]);
        let nearest = Nearest { height: 1, width: 2, channels: 1 };
        assert_eq!(nearest.forward([&[1.0, 2.0]]).0, [1.0, 1.0, 2.0, 2.0, 1.0, 1.0, 2.0, 2.0]);
        let beside = Beside { channels: [1, 2] };
        let (a, b) = ([1.0, 2.0], [3.0, 4.0, 5.0, 6.0]);
        let out = beside.forward([&a, &b]).0;
        assert_eq!(out, [1.0, 3.0, 4.0, 2.0, 5.0, 6.0]);
        assert_eq!(beside.backward([&a, &b], &(), &out, [true; 2]), [a.to_vec(), b.to_vec()]);
    }
}
