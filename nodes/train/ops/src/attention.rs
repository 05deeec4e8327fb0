//! Attention among the pixels of an image (Vaswani et al. 2017): softmax(q k^T/sqrt(d)) v, head by head.

#![expect(unsafe_code, reason = "products write numbers to memory that holds numbers")]

use crate::{
    elementary::exp,
    fresh::maybe,
    instructions::{Instructions, wide},
    operator::Operator,
    products::{Left, Packed, Run, Start, add_products},
};
use rayon::prelude::*;

/// Attention of `q`, `k` and `v`, each [N, T, C] with the heads' channels side by side, to [N, T, C].
#[derive(Clone, Debug)]
pub struct Attention {
    /// T, the pixels of an image.
    pub tokens: usize,
    /// C, a multiple of `heads`.
    pub channels: usize,
    /// Heads.
    pub heads: usize,
    /// What to compute it with; the bits are the same.
    pub instructions: Instructions,
}

/// Rows of numbers: where they start, how far apart they are, and how many of each count.
#[derive(Clone, Copy)]
struct Rows<'a> {
    data: &'a [f32],
    stride: usize,
    width: usize,
}

impl Rows<'_> {
    /// The rows as columns.
    fn turned(self, rows: usize) -> Vec<f32> {
        let at = |(column, row): (usize, usize)| self.data[row * self.stride + column];
        (0..self.width).flat_map(|column| (0..rows).map(move |row| (column, row))).map(at).collect()
    }
}

impl Attention {
    fn check(&self, inputs: &[&[f32]]) {
        let size = self.tokens.checked_mul(self.channels).unwrap_or(0);
        assert!(size > 0 && self.heads > 0 && self.channels.is_multiple_of(self.heads), "whole heads of {self:?}");
        assert!(inputs[0].len().is_multiple_of(size), "whole images of {self:?}");
        assert!(inputs.iter().all(|input| input.len() == inputs[0].len()), "as many of each of {self:?}");
    }

    fn depth(&self) -> usize {
        self.channels / self.heads
    }

    fn scale(&self) -> f32 {
        (1.0 / (self.depth() as f64).sqrt()) as f32
    }

    /// The rows of a head, `job` being image by image and head by head.
    fn rows<'a>(&self, values: &'a [f32], job: usize) -> Rows<'a> {
        let (image, head) = (job / self.heads, job % self.heads);
        let data = &values[image * self.tokens * self.channels + head * self.depth()..];
        Rows { data, stride: self.channels, width: self.depth() }
    }

    /// Left rows times a packed matrix, [T, columns].
    fn product(&self, left: Rows<'_>, right: &Packed, columns: usize) -> Vec<f32> {
        let (mut out, zeros) = (vec![0.0; self.tokens * columns], vec![0.0; columns]);
        let run = Run { left: 0, other: 0, rows: self.tokens };
        let data = Left { data: left.data, stride: left.stride };

        // SAFETY: sums start with a row of zeros, and products write numbers.
        unsafe {
            let out = maybe(&mut out);
            add_products((out, Start::Row(&zeros)), data, right, (0, left.width), &[run], self.instructions);
        }
        out
    }

    /// Left rows times the columns of `right`: what each has in common with each row of it, [T, T].
    fn with_rows(&self, left: Rows<'_>, right: Rows<'_>) -> Vec<f32> {
        let packed = Packed::new((right.width, self.tokens), right.data, |row| row, right.stride);
        self.product(left, &packed, self.tokens)
    }

    /// A square matrix, [T, T], times the rows of `right`.
    fn times(&self, left: &[f32], right: Rows<'_>) -> Vec<f32> {
        let packed = Packed::new((self.tokens, right.width), right.data, |row| row * right.stride, 1);
        self.product(self.square(left), &packed, right.width)
    }

    fn square<'a>(&self, data: &'a [f32]) -> Rows<'a> {
        Rows { data, stride: self.tokens, width: self.tokens }
    }

    /// Puts what each head made, [T, depth], side by side.
    fn beside(&self, heads: &[Vec<f32>]) -> Vec<f32> {
        let mut out = vec![0.0; heads.len() * self.tokens * self.depth()];
        let size = self.tokens * self.channels;
        out.par_chunks_exact_mut(size).zip(heads.par_chunks_exact(self.heads)).for_each(|(out, heads)| {
            for (head, made) in heads.iter().enumerate() {
                let rows = out.chunks_exact_mut(self.channels).zip(made.chunks_exact(self.depth()));
                rows.for_each(|(out, made)| out[head * self.depth()..][..self.depth()].copy_from_slice(made));
            }
        });
        out
    }
}

/// The softmax of a row of scores, each times `scale`.
#[inline(always)]
fn softmax(row: &mut [f32], scale: f32) {
    let most = row.iter().fold(f32::NEG_INFINITY, |most, v| most.max(*v));
    for v in row.iter_mut() {
        *v = exp((*v - most) * scale);
    }
    let part = 1.0 / row.iter().sum::<f32>();
    for v in row.iter_mut() {
        *v *= part;
    }
}

impl Operator<3> for Attention {
    /// The weights of each head, [T, T].
    type Saved = Vec<Vec<f32>>;

    fn forward(&self, inputs: [&[f32]; 3]) -> (Vec<f32>, Self::Saved) {
        self.check(&inputs);
        let [q, k, v] = inputs;
        let jobs = q.len() / (self.tokens * self.channels) * self.heads;
        let made = (0..jobs).into_par_iter().map(|job| {
            let mut weights = self.with_rows(self.rows(q, job), self.rows(k, job));
            wide(
                #[inline(always)]
                || weights.chunks_exact_mut(self.tokens).for_each(|row| softmax(row, self.scale())),
            );
            (self.times(&weights, self.rows(v, job)), weights)
        });
        let (heads, weights): (Vec<_>, Vec<_>) = made.collect();
        (self.beside(&heads), weights)
    }

    fn backward(&self, inputs: [&[f32]; 3], saved: &Self::Saved, gradient: &[f32], _: [bool; 3]) -> [Vec<f32>; 3] {
        self.check(&[inputs[0], inputs[1], inputs[2], gradient]);
        let [q, k, v] = inputs;
        let made = saved.par_iter().enumerate().map(|(job, weights)| {
            let of_out = self.rows(gradient, job);
            let of_v = self.times(&self.square(weights).turned(self.tokens), of_out);
            let mut of_scores = self.with_rows(of_out, self.rows(v, job));
            for (row, weights) in of_scores.chunks_exact_mut(self.tokens).zip(weights.chunks_exact(self.tokens)) {
                let mean: f32 = row.iter().zip(weights).map(|(d, w)| d * w).sum();
                row.iter_mut().zip(weights).for_each(|(d, w)| *d = (*d - mean) * w * self.scale());
            }
            let of_q = self.times(&of_scores, self.rows(k, job));
            let of_k = self.times(&self.square(&of_scores).turned(self.tokens), self.rows(q, job));
            (of_q, (of_k, of_v))
        });
        let (of_q, (of_k, of_v)): (Vec<_>, (Vec<_>, Vec<_>)) = made.collect();
        [self.beside(&of_q), self.beside(&of_k), self.beside(&of_v)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made_up::numbers;

    fn defined(a: &Attention, [q, k, v]: [&[f64]; 3]) -> Vec<f64> {
        let (t, c, d) = (a.tokens, a.channels, a.depth());
        let mut out = vec![0.0; q.len()];
        for image in 0..q.len() / (t * c) {
            for head in 0..a.heads {
                let at = |token: usize, i: usize| image * t * c + token * c + head * d + i;
                for i in 0..t {
                    let score = |j: usize| (0..d).map(|x| q[at(i, x)] * k[at(j, x)]).sum::<f64>() / (d as f64).sqrt();
                    let parts: Vec<f64> = (0..t).map(|j| score(j).exp()).collect();
                    let whole: f64 = parts.iter().sum();
                    for x in 0..d {
                        out[at(i, x)] = (0..t).map(|j| parts[j] / whole * v[at(j, x)]).sum();
                    }
                }
            }
        }
        out
    }

    #[test]
    fn outputs_and_gradients_are_those_of_the_definition() {
        for (images, tokens, channels, heads) in [(2, 9, 8, 2), (1, 16, 24, 1), (1, 5, 6, 3)] {
            let attention = Attention { tokens, channels, heads, instructions: Instructions::best() };
            let inputs = [1, 2, 3].map(|seed| numbers(seed, images * tokens * channels));
            let gradient = numbers(4, inputs[0].len());
            let slices = inputs.each_ref().map(Vec::as_slice);
            let (out, saved) = attention.forward(slices);
            let exact = inputs.each_ref().map(|v| v.iter().map(|v| f64::from(*v)).collect::<Vec<_>>());
            let expected = defined(&attention, exact.each_ref().map(Vec::as_slice));
            assert!(out.iter().zip(&expected).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-5));
            let plain = Attention { instructions: Instructions::Portable, ..attention.clone() };
            assert!(plain.forward(slices).0 == out);
            for (which, found) in attention.backward(slices, &saved, &gradient, [true; 3]).iter().enumerate() {
                for at in [0, 3, found.len() / 2, found.len() - 1] {
                    let value = |by: f64| {
                        let mut moved = exact.clone();
                        moved[which][at] += by;
                        let out = defined(&attention, moved.each_ref().map(Vec::as_slice));
                        out.iter().zip(&gradient).map(|(v, g)| v * f64::from(*g)).sum::<f64>()
                    };
                    let expected = (value(1e-4) - value(-1e-4)) / 2e-4;
                    let error = (f64::from(found[at]) - expected).abs();
                    assert!(error < 1e-4 * expected.abs().max(1.0), "{which} {at}: {} {expected}", found[at]);
                }
            }
        }
    }
}
