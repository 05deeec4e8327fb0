//! Weighted means over the windows of a pyramid.

#![expect(unsafe_code, reason = "results are written once, row by row")]

use super::{
    Level, Pyramid, STRIDE,
    guides::{GUIDES, Guides, LANES, Place, SHARPNESS, distances, eight},
};
use crate::{elementary::exp, fresh::filled, instructions::wide, operator::Operator};
use rayon::prelude::*;
use std::{mem::MaybeUninit, sync::Arc};

/// Pixels that a thread does at least.
const PIXELS: usize = 256;

/// The pixels of a small pixel of `Fold`: two upper, then two lower ones.
const FOUR: usize = 4;

/// The weighted means [N, H, W, 3] of a pyramid. The numbers of four pixels are one after the other, as `Fold` puts
/// them: [N, H/2, W/2, 4 x [`Pyramid::weights`]]. They become weights by a softmax over each pixel's numbers.
#[derive(Clone, Debug)]
pub struct WeightedMean {
    /// The images that are averaged; height and width are even.
    pub pyramid: Arc<Pyramid>,
    /// Added to the number of the pixel itself.
    pub own: f32,
    /// The first row of the image that numbers are given for, an even number. Numbers of some rows are allowed for one
    /// image, and without gradients; otherwise this is 0.
    pub first: usize,
}

/// The same where G-buffers guide the weights. From the number of each place is subtracted the squared distance between
/// a guide's three values there and those of the pixel, at most `FARTHEST`, times [`SHARPNESS`] and a strength. Each
/// pixel has a strength for each level and guide, [N, H/2, W/2, 4 x levels x [`GUIDES`]].
#[derive(Clone, Debug)]
pub struct GuidedMean {
    /// The images that are averaged; height and width are even.
    pub pyramid: Arc<Pyramid>,
    /// G-buffers of the same size, with the same windows.
    pub guides: Arc<Guides>,
    /// As in [`WeightedMean`].
    pub first: usize,
}

/// The sums of weighted colours and of weights.
type Sums = [f32; STRIDE];

/// Buffers of one thread, for four pixels at a time.
struct Scratch {
    /// The numbers that become weights: those of each pixel filled up to whole lanes, and room for more.
    numbers: Vec<f32>,
    /// Weights that do not add up to one yet, those of each pixel filled up to whole lanes.
    weights: Vec<f32>,
    /// The last numbers of all, and room for the lanes behind them.
    last: Vec<f32>,
    /// Squared distances of a pixel for each guide, and room for the lanes behind the last.
    distances: [Vec<f32>; GUIDES],
}

impl Scratch {
    fn new(count: usize) -> Self {
        let filled = count.next_multiple_of(LANES);
        Self {
            numbers: vec![0.0; FOUR * (filled + LANES)],
            weights: vec![0.0; FOUR * filled],
            last: vec![0.0; FOUR * count + LANES],
            distances: [(); GUIDES].map(|()| vec![0.0; count + LANES]),
        }
    }
}

/// The place of one of four pixels, by that of the first.
#[inline(always)]
fn moved((image, y, x): Place, one: usize) -> Place {
    (image, y + one / 2, x + one % 2)
}

/// The numbers of four pixels among those of all, and lanes behind the last.
#[inline(always)]
fn given<'a>(all: &'a [f32], at: usize, count: usize, last: &'a mut [f32]) -> &'a [f32] {
    let first = FOUR * count * at;
    if first + FOUR * count + LANES <= all.len() {
        return &all[first..first + FOUR * count + LANES];
    }
    last[..FOUR * count].copy_from_slice(&all[first..first + FOUR * count]);
    last
}

impl Pyramid {
    /// The sums of four pixels; the scratch has their numbers, and gets their weights.
    #[inline(always)]
    fn sums(&self, place: Place, scratch: &mut Scratch) -> [Sums; FOUR] {
        let count = self.weights();
        let filled = count.next_multiple_of(LANES);
        let mut out = [[0.0; STRIDE]; FOUR];
        let pixels = scratch.numbers.chunks_exact_mut(filled + LANES).zip(scratch.weights.chunks_exact_mut(filled));
        for (one, (numbers, weights)) in pixels.enumerate() {
            // The last lanes are beyond the numbers: they must not be the largest, whatever was written there.
            let numbers = &mut numbers[..filled];
            numbers[count..].fill(f32::MIN);
            let mut largest = [f32::MIN; LANES];
            for part in numbers.as_chunks::<LANES>().0 {
                for (lane, number) in largest.iter_mut().zip(part) {
                    *lane = if *number > *lane { *number } else { *lane };
                }
            }
            let mut most = largest[0];
            for lane in largest {
                most = if lane > most { lane } else { most };
            }
            for (weight, number) in weights.iter_mut().zip(&*numbers) {
                *weight = exp(*number - most);
            }
            let place = moved(place, one);
            let (mut even, mut odd) = ([0.0; STRIDE], [0.0; STRIDE]);
            let mut first = 0;
            for level in &self.levels {
                let places = first..first + level.side * level.side;
                (even, odd) = match level.side {
                    1 => add::<1>(level, place, &weights[places.clone()], even, odd),
                    3 => add::<3>(level, place, &weights[places.clone()], even, odd),
                    _ => add::<5>(level, place, &weights[places.clone()], even, odd),
                };
                first = places.end;
            }
            for c in 0..STRIDE {
                out[one][c] = even[c] + odd[c];
            }
        }
        out
    }

    /// The gradients of the numbers of a pixel at one level: its weights, times what makes all weights add up
    /// to one, times how far each place lies along `g`.
    #[inline(always)]
    fn slopes<const SIDE: usize>(
        &self,
        level: usize,
        place: Place,
        (weights, share): (&[f32], f32),
        g: [f32; STRIDE],
        out: &mut [f32],
    ) {
        let level = &self.levels[level];
        let rows = weights.chunks_exact(SIDE).zip(out.chunks_exact_mut(SIDE)).enumerate();
        for (row, (weights, out)) in rows {
            let pixels = level.window::<SIDE>(place, row);
            for ((weight, out), pixel) in weights.iter().zip(out).zip(pixels) {
                let along = (g[0] * pixel[0] + g[1] * pixel[1]) + (g[2] * pixel[2] + g[3] * pixel[3]);
                *out = weight * share * along;
            }
        }
    }

    /// The gradients of the numbers of four pixels, by their sums and the weights of the scratch.
    #[inline(always)]
    fn gradients(&self, place: Place, scratch: &Scratch, sums: &[Sums; FOUR], gradient: &[f32], out: &mut [f32]) {
        let count = self.weights();
        let filled = count.next_multiple_of(LANES);
        let pixels = scratch.weights.chunks_exact(filled).zip(out.chunks_exact_mut(count));
        for (one, (weights, out)) in pixels.enumerate() {
            let (image, y, x) = moved(place, one);
            let g = &gradient[3 * ((image * self.height + y) * self.width + x)..][..3];
            let sums = sums[one];
            let share = 1.0 / sums[3];
            let mean = (g[0] * sums[0] + g[1] * sums[1] + g[2] * sums[2]) * share;
            // The one of each pixel takes the mean off.
            let g = [g[0], g[1], g[2], -mean];
            let mut first = 0;
            for level in 0..self.levels.len() {
                let side = self.levels[level].side;
                let places = first..first + side * side;
                let (weights, out) = ((&weights[places.clone()], share), &mut out[places.clone()]);
                match side {
                    1 => self.slopes::<1>(level, (image, y, x), weights, g, out),
                    3 => self.slopes::<3>(level, (image, y, x), weights, g, out),
                    _ => self.slopes::<5>(level, (image, y, x), weights, g, out),
                }
                first = places.end;
            }
        }
    }

    /// Writes the means of so many rows from the first. `numbers` makes the numbers of four pixels in the scratch, by
    /// their place and where they are among the small pixels of these rows.
    fn means(&self, (first, rows): (usize, usize), numbers: impl Fn(Place, usize, &mut Scratch) + Sync) -> Vec<f32> {
        let (row, count) = (3 * self.width, self.weights());
        // SAFETY: pairs of rows are all of the output, and each writes its own.
        unsafe {
            filled(rows * row, |out| {
                let pairs = out.par_chunks_exact_mut(2 * row).enumerate().with_min_len(self.least_pairs());
                pairs.for_each_init(
                    || Scratch::new(count),
                    |scratch, (pair, out)| {
                        wide(
                            #[inline(always)]
                            || {
                                for column in 0..self.width / 2 {
                                    let place = self.place(first / 2 + pair, column);
                                    numbers(place, pair * (self.width / 2) + column, scratch);
                                    let sums = self.sums(place, scratch);
                                    for (one, sums) in sums.iter().enumerate() {
                                        let at = one / 2 * row + 3 * (2 * column + one % 2);
                                        (0..3).for_each(|c| {
                                            out[at + c] = MaybeUninit::new(sums[c] / sums[3]);
                                        });
                                    }
                                }
                            },
                        );
                    },
                );
            })
        }
    }

    /// Calls `f` for each small pixel with its place, where it is among the small pixels, and its parts of the outputs,
    /// which have so many channels.
    fn each<const N: usize>(
        &self,
        channels: [usize; N],
        f: impl Fn(Place, usize, [&mut [f32]; N], &mut Scratch) + Sync,
    ) -> [Vec<f32>; N] {
        let (small, count, pairs) = (self.width / 2, self.weights(), self.images * self.height / 2);
        let mut outs = channels.map(|channels| (small * channels, vec![0.0; pairs * small * channels]));
        let mut rows = outs.each_mut().map(|(row, out)| out.chunks_exact_mut(*row));
        let rows: Vec<_> =
            (0..pairs).map(|_| rows.each_mut().map(|rows| rows.next().expect("a row for each"))).collect();
        rows.into_par_iter().enumerate().with_min_len(self.least_pairs()).for_each_init(
            || Scratch::new(count),
            |scratch, (pair, mut rows)| {
                wide(
                    #[inline(always)]
                    || {
                        for column in 0..small {
                            let parts = rows.each_mut().map(|row| {
                                let each = row.len() / small;
                                &mut row[column * each..][..each]
                            });
                            f(self.place(pair, column), pair * small + column, parts, scratch);
                        }
                    },
                );
            },
        );
        outs.map(|(_, out)| out)
    }

    fn least_pairs(&self) -> usize {
        PIXELS.div_ceil(2 * self.width)
    }

    /// The place of the first of four pixels.
    #[inline(always)]
    fn place(&self, pair: usize, column: usize) -> Place {
        let pairs = self.height / 2;
        (pair / pairs, 2 * (pair % pairs), 2 * column)
    }

    /// Panics unless there are so many numbers for each small pixel.
    fn check(&self, numbers: &[f32], each: usize, what: &str) {
        assert!(self.width.is_multiple_of(2) && self.height.is_multiple_of(2), "even sides");
        assert_eq!(numbers.len(), self.images * self.height * self.width * each, "{what}");
    }

    /// How many rows from the first these numbers are of. Panics unless they are of whole images, or of some rows of
    /// one.
    fn rows(&self, numbers: &[f32], each: usize, first: usize, what: &str) -> usize {
        let rows = numbers.len() / (self.width * each).max(1);
        if first == 0 && rows == self.images * self.height {
            self.check(numbers, each, what);
            return rows;
        }
        assert!(self.images == 1 && first + rows <= self.height, "{what}: rows of one image");
        assert!([self.width, first, rows].iter().all(|number| number.is_multiple_of(2)), "{what}: even sides");
        assert_eq!(numbers.len(), rows * self.width * each, "{what}");
        rows
    }
}

/// Adds the places of a level to the sums of a pixel. Those in even and in odd columns are apart, so that neither waits
/// for the other.
#[inline(always)]
fn add<const SIDE: usize>(level: &Level, place: Place, weights: &[f32], mut even: Sums, mut odd: Sums) -> (Sums, Sums) {
    for (row, weights) in weights.chunks_exact(SIDE).enumerate() {
        let pixels = level.window::<SIDE>(place, row);
        for column in 0..SIDE {
            let sums = if column % 2 == 0 { &mut even } else { &mut odd };
            for c in 0..STRIDE {
                sums[c] += weights[column] * pixels[column][c];
            }
        }
    }
    (even, odd)
}

impl WeightedMean {
    #[inline(always)]
    fn numbers(&self, logits: &[f32], at: usize, scratch: &mut Scratch) {
        let count = self.pyramid.weights();
        let filled = count.next_multiple_of(LANES);
        let given = given(logits, at, count, &mut scratch.last);
        for (one, numbers) in scratch.numbers.chunks_exact_mut(filled + LANES).enumerate() {
            for first in (0..count).step_by(LANES) {
                numbers[first..first + LANES].copy_from_slice(&eight(given, one * count + first));
            }
            if self.own != 0.0 {
                numbers[self.pyramid.levels[0].side.pow(2) / 2] += self.own;
            }
        }
    }
}

impl Operator<1> for WeightedMean {
    type Saved = ();

    fn forward(&self, [logits]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        let told = "a number for each place of the windows";
        let rows = self.pyramid.rows(logits, self.pyramid.weights(), self.first, told);
        let means = self.pyramid.means(
            (self.first, rows),
            #[inline(always)]
            |_, at, scratch| self.numbers(logits, at, scratch),
        );
        (means, ())
    }

    fn backward(&self, [logits]: [&[f32]; 1], (): &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        let count = self.pyramid.weights();
        self.pyramid.check(logits, count, "a number for each place of the windows");
        self.pyramid.check(gradient, 3, "a gradient for each mean");
        self.pyramid.each(
            [FOUR * count],
            #[inline(always)]
            |place, at, [out], scratch| {
                self.numbers(logits, at, scratch);
                let sums = self.pyramid.sums(place, scratch);
                self.pyramid.gradients(place, scratch, &sums, gradient, out);
            },
        )
    }
}

impl GuidedMean {
    /// Strengths of a pixel.
    pub fn strengths(&self) -> usize {
        GUIDES * self.guides.levels.len()
    }

    fn rows(&self, numbers: &[f32], strengths: &[f32]) -> usize {
        let sides = |of: &mut dyn Iterator<Item = usize>| of.collect::<Vec<_>>();
        assert_eq!(self.guides.size(), self.pyramid.size(), "guides of the size of what is averaged");
        let own = sides(&mut self.pyramid.levels.iter().map(|level| level.side));
        assert_eq!(sides(&mut self.guides.levels.iter().map(|level| level.side)), own, "the same windows");
        let told = "a number for each place of the windows";
        let rows = self.pyramid.rows(numbers, self.pyramid.weights(), self.first, told);
        assert_eq!(strengths.len(), rows * self.pyramid.width * self.strengths(), "strengths for each pixel");
        rows
    }

    /// The numbers of four pixels, lowered.
    #[inline(always)]
    fn numbers(&self, place: Place, (numbers, strengths): (&[f32], &[f32]), at: usize, scratch: &mut Scratch) {
        let (count, each) = (self.pyramid.weights(), self.strengths());
        let strengths = &strengths[FOUR * each * at..][..FOUR * each];
        let given = given(numbers, at, count, &mut scratch.last);
        let room = count.next_multiple_of(LANES) + LANES;
        let pixels = scratch.numbers.chunks_exact_mut(room).zip(strengths.chunks_exact(each));
        for (one, (lowered, strengths)) in pixels.enumerate() {
            let (place, given) = (moved(place, one), &given[one * count..]);
            let own = self.guides.pixel(place);
            let mut first = 0;
            for (level, strengths) in self.guides.levels.iter().zip(strengths.chunks_exact(GUIDES)) {
                let strengths = [SHARPNESS * strengths[0], SHARPNESS * strengths[1]];
                for row in 0..level.side {
                    let window = level.window(place, row);
                    let near = [distances(&window, &own, 0), distances(&window, &own, 1)];
                    let mut lanes = eight(given, first);
                    for (i, lane) in lanes.iter_mut().enumerate() {
                        *lane = *lane - strengths[0] * near[0][i] - strengths[1] * near[1][i];
                    }
                    // Lanes beyond the row are overwritten by the next one.
                    lowered[first..first + LANES].copy_from_slice(&lanes);
                    first += level.side;
                }
            }
        }
    }

    /// The gradients of the strengths of one of four pixels.
    #[inline(always)]
    fn strength_slopes(&self, place: Place, gradient: &[f32], found: &mut [Vec<f32>; GUIDES], out: &mut [f32]) {
        let own = self.guides.pixel(place);
        let mut first = 0;
        for (level, of) in self.guides.levels.iter().enumerate() {
            let count = of.side * of.side;
            for row in 0..of.side {
                let window = of.window(place, row);
                for (guide, found) in found.iter_mut().enumerate() {
                    found[row * of.side..][..LANES].copy_from_slice(&distances(&window, &own, guide));
                }
            }
            for (guide, found) in found.iter().enumerate() {
                let sum: f32 = gradient[first..first + count].iter().zip(found).map(|(g, d)| g * d).sum();
                out[level * GUIDES + guide] = -SHARPNESS * sum;
            }
            first += count;
        }
    }
}

impl Operator<2> for GuidedMean {
    type Saved = ();

    fn forward(&self, [numbers, strengths]: [&[f32]; 2]) -> (Vec<f32>, ()) {
        let rows = self.rows(numbers, strengths);
        let means = self.pyramid.means(
            (self.first, rows),
            #[inline(always)]
            |place, at, scratch| self.numbers(place, (numbers, strengths), at, scratch),
        );
        (means, ())
    }

    fn backward(&self, inputs: [&[f32]; 2], (): &(), gradient: &[f32], _: [bool; 2]) -> [Vec<f32>; 2] {
        let [numbers, strengths] = inputs;
        self.rows(numbers, strengths);
        self.pyramid.check(gradient, 3, "a gradient for each mean");
        let (count, each) = (self.pyramid.weights(), self.strengths());
        self.pyramid.each(
            [FOUR * count, FOUR * each],
            #[inline(always)]
            |place, at, [of_numbers, of_strengths], scratch| {
                self.numbers(place, (numbers, strengths), at, scratch);
                let sums = self.pyramid.sums(place, scratch);
                self.pyramid.gradients(place, scratch, &sums, gradient, of_numbers);
                let pixels = of_numbers.chunks_exact(count).zip(of_strengths.chunks_exact_mut(each));
                for (one, (gradient, out)) in pixels.enumerate() {
                    self.strength_slopes(moved(place, one), gradient, &mut scratch.distances, out);
                }
            },
        )
    }
}

#[cfg(test)]
mod tests;
