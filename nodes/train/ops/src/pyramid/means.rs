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
    /// What is averaged; height and width are even.
    pub pyramid: Arc<Pyramid>,
    /// Added to the number of the pixel itself.
    pub own: f32,
}

/// The same where G-buffers guide the weights. From the number of each place is subtracted the squared distance between
/// a guide's three values there and those of the pixel, at most `FARTHEST`, times [`SHARPNESS`] and a strength. Each
/// pixel has a strength for each level and guide, [N, H/2, W/2, 4 x levels x [`GUIDES`]].
#[derive(Clone, Debug)]
pub struct GuidedMean {
    /// What is averaged; height and width are even.
    pub pyramid: Arc<Pyramid>,
    /// G-buffers of the same size, with the same windows.
    pub guides: Arc<Guides>,
}

/// The sums of weighted colours and of weights.
type Sums = [f32; STRIDE];

/// What one thread writes to, for four pixels at a time.
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
            // What fills up the lanes has no weight, whatever was written there.
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

    /// Writes the means of all pixels. `numbers` makes the numbers of four pixels in the scratch, by their place and
    /// where they are among the small pixels.
    fn means(&self, numbers: impl Fn(Place, usize, &mut Scratch) + Sync) -> Vec<f32> {
        let (row, count) = (3 * self.width, self.weights());
        // SAFETY: pairs of rows are all of the output, and each writes its own.
        unsafe {
            filled(self.images * self.height * row, |out| {
                let pairs = out.par_chunks_exact_mut(2 * row).enumerate().with_min_len(self.least_pairs());
                pairs.for_each_init(
                    || Scratch::new(count),
                    |scratch, (pair, out)| {
                        wide(
                            #[inline(always)]
                            || {
                                for column in 0..self.width / 2 {
                                    let place = self.place(pair, column);
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

    /// Calls `f` for each small pixel with its place, where it is among the small pixels, and its parts of two outputs,
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
        self.pyramid.check(logits, self.pyramid.weights(), "a number for each place of the windows");
        let means = self.pyramid.means(
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

    fn check(&self, numbers: &[f32], strengths: &[f32]) {
        let sides = |of: &mut dyn Iterator<Item = usize>| of.collect::<Vec<_>>();
        assert_eq!(self.guides.size(), self.pyramid.size(), "guides of the size of what is averaged");
        let own = sides(&mut self.pyramid.levels.iter().map(|level| level.side));
        assert_eq!(sides(&mut self.guides.levels.iter().map(|level| level.side)), own, "the same windows");
        self.pyramid.check(numbers, self.pyramid.weights(), "a number for each place of the windows");
        self.pyramid.check(strengths, self.strengths(), "strengths for each pixel");
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
                    // What lies beyond the row is written again with the next.
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
        self.check(numbers, strengths);
        let means = self.pyramid.means(
            #[inline(always)]
            |place, at, scratch| self.numbers(place, (numbers, strengths), at, scratch),
        );
        (means, ())
    }

    fn backward(&self, inputs: [&[f32]; 2], (): &(), gradient: &[f32], _: [bool; 2]) -> [Vec<f32>; 2] {
        let [numbers, strengths] = inputs;
        self.check(numbers, strengths);
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
mod tests {
    use super::{super::FARTHEST, *};
    use crate::{Fold, made_up::numbers};

    const SIDES: [usize; 3] = [5, 3, 1];
    const SIZE: (usize, usize) = (8, 12);
    const ALL: usize = 2 * SIZE.0 * SIZE.1;
    const COUNT: usize = 35;

    fn pyramid() -> (Vec<f32>, Arc<Pyramid>) {
        let pixels = numbers(3, 3 * ALL);
        let pyramid = Pyramid::new(&pixels, SIZE.0, SIZE.1, &SIDES);
        assert_eq!(pyramid.weights(), COUNT);
        (pixels, Arc::new(pyramid))
    }

    /// Numbers of pixels as those of folded pixels, or back.
    fn folded(values: &[f32], channels: usize, back: bool) -> Vec<f32> {
        Fold { height: SIZE.0, width: SIZE.1, channels, back }.forward([values]).0
    }

    /// Where a pixel is: image, y, x.
    fn place(at: usize) -> Place {
        (at / (SIZE.0 * SIZE.1), at / SIZE.1 % SIZE.0, at % SIZE.1)
    }

    /// The means over the blocks in the windows around a pixel, of one of the channels of an image.
    fn around(pixels: &[f32], channels: usize, channel: usize, (image, y, x): Place) -> Vec<f64> {
        let ((height, width), mut out) = (SIZE, Vec::new());
        for (scale, side) in SIDES.iter().enumerate() {
            let (block, reach) = (1usize << scale, (side / 2) as i64);
            for (dy, dx) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dy, dx))) {
                let edge = |v: usize, d: i64, size: usize| {
                    ((v / block) as i64 + d).clamp(0, (size / block) as i64 - 1) as usize * block
                };
                let (v, u) = (edge(y, dy, height), edge(x, dx, width));
                let of = |j: usize, i: usize| {
                    f64::from(pixels[channels * ((image * height + v + j) * width + u + i) + channel])
                };
                let sum: f64 = (0..block * block).map(|i| of(i / block, i % block)).sum();
                out.push(sum / (block * block) as f64);
            }
        }
        out
    }

    /// The weighted mean from the definition.
    fn defined(around: &[f64], logits: &[f64]) -> f64 {
        let (sum, total) = around.iter().zip(logits).fold((0.0, 0.0), |(sum, total), (value, logit)| {
            let weight = logit.exp();
            (sum + weight * value, total + weight)
        });
        sum / total
    }

    /// Asserts that a gradient is what central differences of the definition say.
    fn assert_slope(found: f32, value: impl Fn(f64) -> f64, what: &str) {
        let expected = (value(1e-4) - value(-1e-4)) / 2e-4;
        assert!((f64::from(found) - expected).abs() < 1e-4 * expected.abs().max(0.1), "{what}: {found} {expected}");
    }

    #[test]
    fn means_and_gradients_are_those_of_the_definition() {
        let (pixels, pyramid) = pyramid();
        let operator = WeightedMean { pyramid, own: 0.5 };
        let logits: Vec<f32> = numbers(5, ALL * COUNT).iter().map(|v| 4.0 * v).collect();
        let given = folded(&logits, COUNT, false);
        let (out, ()) = operator.forward([&given]);
        let gradient = numbers(7, out.len());
        let [found] = operator.backward([&given], &(), &gradient, [true]);
        let found = folded(&found, COUNT, true);
        for at in (0..ALL).step_by(5) {
            let around = [0, 1, 2].map(|c| around(&pixels, 3, c, place(at)));
            let mut own: Vec<f64> = logits[at * COUNT..][..COUNT].iter().map(|v| f64::from(*v)).collect();
            own[12] += 0.5;
            for c in 0..3 {
                let expected = defined(&around[c], &own);
                assert!((f64::from(out[3 * at + c]) - expected).abs() < 1e-5, "{at}: {} {expected}", out[3 * at + c]);
            }
            for b in (0..COUNT).step_by(3) {
                let value = |by: f64| {
                    let mut logits = own.clone();
                    logits[b] += by;
                    (0..3).map(|c| defined(&around[c], &logits) * f64::from(gradient[3 * at + c])).sum()
                };
                assert_slope(found[at * COUNT + b], value, &format!("{at} {b}"));
            }
        }
    }

    #[test]
    fn guides_lower_what_looks_different_as_defined() {
        let (pixels, pyramid) = pyramid();
        let mut gbuffer = numbers(4, 6 * ALL);
        // Some pixels are farther than counts, one beyond all numbers.
        gbuffer.iter_mut().step_by(50).for_each(|value| *value *= 4.0);
        gbuffer[103] = 1e30;
        let guides = Arc::new(Guides::new(&gbuffer, SIZE.0, SIZE.1, &SIDES));
        let operator = GuidedMean { pyramid, guides };
        let each = operator.strengths();
        assert_eq!(each, 6);
        let logits: Vec<f32> = numbers(5, ALL * COUNT).iter().map(|v| 4.0 * v).collect();
        // Both signs, so that no place takes all of the weight everywhere.
        let strengths: Vec<f32> = numbers(6, ALL * each).iter().map(|v| 0.1 * v).collect();
        let given = [folded(&logits, COUNT, false), folded(&strengths, each, false)];
        let inputs = [&given[0][..], &given[1]];
        let (out, ()) = operator.forward(inputs);
        let gradient = numbers(7, out.len());
        let [of_numbers, of_strengths] = operator.backward(inputs, &(), &gradient, [true; 2]);
        let (of_numbers, of_strengths) = (folded(&of_numbers, COUNT, true), folded(&of_strengths, each, true));
        for at in (0..ALL).step_by(3) {
            let lights = [0, 1, 2].map(|c| around(&pixels, 3, c, place(at)));
            let guides: [Vec<f64>; 6] = std::array::from_fn(|c| around(&gbuffer, 6, c, place(at)));
            let distance = |guide: usize, b: usize| -> f64 {
                let own = |c: usize| f64::from(gbuffer[6 * at + c]);
                let square = (3 * guide..3 * guide + 3).map(|c| (guides[c][b] - own(c)).powi(2)).sum::<f64>();
                square.min(f64::from(FARTHEST))
            };
            let levels = [0..25, 25..34, 34..35];
            let value = |moved: Option<(bool, usize, f64)>| -> [f64; 3] {
                let mut numbers: Vec<f64> = logits[at * COUNT..][..COUNT].iter().map(|v| f64::from(*v)).collect();
                let mut strengths: Vec<f64> = strengths[at * each..][..each].iter().map(|v| f64::from(*v)).collect();
                if let Some((of_strengths, which, by)) = moved {
                    *if of_strengths { &mut strengths[which] } else { &mut numbers[which] } += by;
                }
                for (level, places) in levels.iter().enumerate() {
                    for b in places.clone() {
                        for guide in 0..GUIDES {
                            numbers[b] -= f64::from(SHARPNESS) * strengths[level * GUIDES + guide] * distance(guide, b);
                        }
                    }
                }
                [0, 1, 2].map(|c| defined(&lights[c], &numbers))
            };
            let probed = |values: [f64; 3]| (0..3).map(|c| values[c] * f64::from(gradient[3 * at + c])).sum::<f64>();
            for (found, expected) in out[3 * at..].iter().zip(value(None)) {
                assert!((f64::from(*found) - expected).abs() < 2e-5, "{at}: {found} {expected}");
            }
            for b in (0..COUNT).step_by(4) {
                let found = of_numbers[at * COUNT + b];
                assert_slope(found, |by| probed(value(Some((false, b, by)))), &format!("{at}, number {b}"));
            }
            for which in 0..each {
                let found = of_strengths[at * each + which];
                assert_slope(found, |by| probed(value(Some((true, which, by)))), &format!("{at}, strength {which}"));
            }
        }
        let levels: Vec<_> = operator.guides.levels().map(|level| (level.scale, level.side, level.pixels)).collect();
        assert_eq!(levels[0].2.len(), 2 * (SIZE.0 + 4) * (SIZE.1 + 4) * 6);
        // The third pixel of the third row is the first of the image.
        assert_eq!(levels[0].2[6 * (2 * (SIZE.1 + 4) + 2)..][..6], gbuffer[..6]);
        assert_eq!((levels[2].0, levels[2].1, levels[2].2.len()), (2, 1, 2 * 2 * 3 * 6));
    }

    #[test]
    fn means_stay_within_the_window_whatever_the_weights() {
        let (pixels, pyramid) = pyramid();
        let operator = WeightedMean { pyramid, own: 0.0 };
        // A weight far above the others takes it all, here the window's middle.
        let mut logits = vec![-300.0f32; ALL * COUNT];
        logits.chunks_exact_mut(COUNT).for_each(|of| of[12] = 300.0);
        let (out, ()) = operator.forward([&logits]);
        assert!(out.iter().zip(&pixels).all(|(a, b)| (a - b).abs() < 1e-6));
        let [gradient] = operator.backward([&logits], &(), &vec![1.0; out.len()], [true]);
        assert!(gradient.iter().all(|g| g.abs() < 1e-6));
    }

    /// Small images, of which the last window ends with the data, and three of them.
    #[test]
    fn tiny_images_are_averaged_as_well() {
        for (height, width, sides) in [(4, 4, &[5, 3, 1][..]), (2, 2, &[5, 1]), (2, 2, &[1]), (2, 6, &[3])] {
            let pixels = 3 * height * width;
            let pyramid = Arc::new(Pyramid::new(&numbers(1, 3 * pixels), height, width, sides));
            let guides = Arc::new(Guides::new(&numbers(2, 6 * pixels), height, width, sides));
            let count = pyramid.weights();
            let logits = numbers(3, count * pixels);
            let plain = WeightedMean { pyramid: pyramid.clone(), own: 0.0 };
            let guided = GuidedMean { pyramid, guides };
            // Strengths of zero guide nothing.
            let none = vec![0.0; guided.strengths() * pixels];
            let (expected, ()) = plain.forward([&logits]);
            let (found, ()) = guided.forward([&logits, &none]);
            assert_eq!((found.len(), &found), (3 * pixels, &expected), "{height} x {width}, {sides:?}");
            let [expected] = plain.backward([&logits], &(), &found, [true]);
            let [found, strengths] = guided.backward([&logits, &none], &(), &found, [true; 2]);
            assert!(found == expected && strengths.iter().all(|slope| slope.is_finite()));
            let levels: Vec<_> = guided.guides.levels().map(|level| (level.side, level.pixels.len())).collect();
            let padded = |(scale, side): (usize, &usize)| {
                (*side, 3 * ((height >> scale) + side - 1) * ((width >> scale) + side - 1) * 6)
            };
            assert_eq!(levels, sides.iter().enumerate().map(padded).collect::<Vec<_>>());
        }
    }

    #[test]
    fn what_is_no_number_is_far() {
        let (_, pyramid) = pyramid();
        let far = |value: f32| {
            let mut gbuffer = vec![0.25; 6 * ALL];
            gbuffer[6 * (3 * SIZE.1 + 3)] = value;
            let guides = Arc::new(Guides::new(&gbuffer, SIZE.0, SIZE.1, &SIDES));
            let guided = GuidedMean { pyramid: pyramid.clone(), guides };
            guided.forward([&folded(&numbers(5, ALL * COUNT), COUNT, false), &vec![0.1; ALL * guided.strengths()]]).0
        };
        let (nan, infinite) = (far(f32::NAN), far(1e30));
        assert!(nan.iter().all(|value| value.is_finite()));
        // The pixel itself is no number from everything, itself included.
        let own = 3 * (3 * SIZE.1 + 3);
        let others = |values: &[f32]| [&values[..own], &values[own + 3..]].concat();
        assert_eq!(others(&nan), others(&infinite));
    }
}
