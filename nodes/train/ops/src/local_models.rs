//! Local linear models of the light: the guided filter (He, Sun and Tang 2010) with normals and albedo as its guide.
//!
//! In a window around each pixel, the noisy light is fitted by least squares as a linear function of normal and mean
//! albedo. Its value at the pixel's own normal and albedo has the light and shadow of joints, bumps and patterns, which
//! averaging blurs, and the little noise of a large window. Moments and models are those of blocks of pixels,
//! and models are interpolated between blocks, as in the fast guided filter (He and Sun 2015).

use crate::instructions::wide;
use rayon::prelude::*;

/// Pixels of a block's side.
const BLOCK: usize = 4;

/// Blocks on each side of a block in the windows: 20, 36 and 68 pixels.
const RADII: [usize; LOCAL_MODELS] = [2, 4, 8];

/// Local models of a pixel: one for each window.
pub const LOCAL_MODELS: usize = 3;

/// Added to the variances of the guide: smaller ones are noise.
const RIDGE: f64 = 1e-3;

/// Light counts at most as this, so that no product is too large.
const BRIGHTEST_LIGHT: f32 = 1e4;

/// A model gives at most so many times the mean light of its window, and nothing below 0.
const MOST: f32 = 4.0;

/// Values of the guide: the normal, and the mean of the albedo's colours.
const GUIDE: usize = 4;

/// Products of two values of the guide.
const PAIRS: usize = GUIDE * (GUIDE + 1) / 2;

/// Means of a block: of the guide, the light, products of the guide, and products of guide and light; then zeros, which
/// make whole vectors.
const MOMENTS: usize = (GUIDE + 3 + PAIRS + 3 * GUIDE).next_multiple_of(8);

type Moments = [f64; MOMENTS];

/// Values of a pixel: three colours for each window.
const VALUES: usize = 3 * LOCAL_MODELS;

/// Whole vectors that hold the [`VALUES`]; the rest is 0.
const STRIDE: usize = VALUES.next_multiple_of(16);

/// Slopes for each value of the guide, constants, and the mean light, of all windows: each [`STRIDE`] numbers.
type Models = [f32; STRIDE * (GUIDE + 2)];

/// Models that give 0 everywhere.
const NO_MODELS: Models = [0.0; STRIDE * (GUIDE + 2)];

/// How far, in pixels, a fit looks at most: at the blocks of a window, and at the models of two blocks on each axis.
pub const FARTHEST_FITTED: usize = (RADII[RADII.len() - 1] + 1) * BLOCK + BLOCK / 2 - 1;

/// The light at each pixel by the models of each window, [H, W, [`LOCAL_MODELS`], 3].
///
/// `light` is [H, W, 3], and `gbuffer` [H, W, 6]: albedo, and normals. H and W are multiples of 4.
pub fn local_models(light: &[f32], gbuffer: &[f32], height: usize, width: usize) -> Vec<f32> {
    assert!(height.is_multiple_of(BLOCK) && width.is_multiple_of(BLOCK), "whole blocks");
    assert_eq!((light.len(), gbuffer.len()), (3 * height * width, 6 * height * width), "pixels");
    let blocks = width / BLOCK;
    let moments = moments(light, gbuffer, blocks);
    let mut models = vec![NO_MODELS; moments.len()];
    RADII.into_iter().enumerate().for_each(|window| fit(window, &moments, blocks, &mut models));
    let mut out = vec![0.0; VALUES * height * width];
    let rows = out.par_chunks_exact_mut(VALUES * width).zip(gbuffer.par_chunks_exact(6 * width)).enumerate();
    rows.for_each_init(Vec::new, |row, (y, (out, gbuffer))| {
        wide(
            #[inline(always)]
            || {
                between_rows(&models, blocks, y, row);
                values(row, gbuffer, out);
            },
        );
    });
    out
}

#[inline(always)]
fn guide(pixel: &[f32; 6]) -> [f32; GUIDE] {
    [pixel[3], pixel[4], pixel[5], (pixel[0] + pixel[1] + pixel[2]) / 3.0]
}

/// Means of each block; a row has so many.
fn moments(light: &[f32], gbuffer: &[f32], blocks: usize) -> Vec<Moments> {
    let mut out = vec![[0.0; MOMENTS]; light.len() / (3 * BLOCK * BLOCK)];
    let rows = light.par_chunks_exact(3 * BLOCK * BLOCK * blocks);
    let rows = out.par_chunks_exact_mut(blocks).zip(rows).zip(gbuffer.par_chunks_exact(6 * BLOCK * BLOCK * blocks));
    rows.for_each(|((out, light), gbuffer)| {
        wide(
            #[inline(always)]
            || {
                let (light, gbuffer) = (light.as_chunks::<3>().0, gbuffer.as_chunks::<6>().0);
                for (block, out) in out.iter_mut().enumerate() {
                    *out = block_moments(light, gbuffer, BLOCK * block, BLOCK * blocks);
                }
            },
        );
    });
    out
}

/// Means of the block at a column of rows that are so wide.
#[inline(always)]
fn block_moments(light: &[[f32; 3]], gbuffer: &[[f32; 6]], column: usize, width: usize) -> Moments {
    let (mut of_guide, mut of_light) = ([0.0; GUIDE], [0.0; 4]);
    let (mut of_pairs, mut of_mixed) = ([[0.0; GUIDE]; GUIDE], [[0.0; 4]; GUIDE]);
    for y in 0..BLOCK {
        let pixels = light[y * width + column..][..BLOCK].iter().zip(&gbuffer[y * width + column..][..BLOCK]);
        for (light, pixel) in pixels {
            let (narrow, mut guided, mut lit) = (guide(pixel), [0.0; GUIDE], [0.0; 4]);
            for i in 0..GUIDE {
                guided[i] = f64::from(narrow[i]);
            }
            for c in 0..3 {
                lit[c] = f64::from(light[c].clamp(-BRIGHTEST_LIGHT, BRIGHTEST_LIGHT));
            }
            for i in 0..GUIDE {
                of_guide[i] += guided[i];
                of_light[i] += lit[i];
            }
            for i in 0..GUIDE {
                for j in 0..GUIDE {
                    of_pairs[i][j] += guided[i] * guided[j];
                    of_mixed[i][j] += guided[i] * lit[j];
                }
            }
        }
    }
    let mut out = [0.0; MOMENTS];
    out[..GUIDE].copy_from_slice(&of_guide);
    out[GUIDE..GUIDE + 3].copy_from_slice(&of_light[..3]);
    for i in 0..GUIDE {
        for j in 0..=i {
            out[GUIDE + 3 + i * (i + 1) / 2 + j] = of_pairs[i][j];
        }
        out[GUIDE + 3 + PAIRS + 3 * i..][..3].copy_from_slice(&of_mixed[i][..3]);
    }
    for out in &mut out {
        *out /= (BLOCK * BLOCK) as f64;
    }
    out
}

/// Writes the models of a window: of the blocks within this radius of each block, of those that there are. A row has so
/// many.
fn fit((window, radius): (usize, usize), moments: &[Moments], blocks: usize, models: &mut [Models]) {
    let around = |at: usize, length: usize| at.saturating_sub(radius)..(at + radius + 1).min(length);
    let mut rows = vec![[0.0; MOMENTS]; moments.len()];
    rows.par_chunks_exact_mut(blocks).zip(moments.par_chunks_exact(blocks)).for_each(|(out, row)| {
        wide(
            #[inline(always)]
            || {
                for (x, out) in out.iter_mut().enumerate() {
                    *out = mean(&row[around(x, blocks)], 1);
                }
            },
        );
    });
    models.par_chunks_mut(BAND * blocks).enumerate().for_each(|(band, out)| {
        wide(
            #[inline(always)]
            || {
                // A few columns at a time, so that rows are read from a near cache for all rows of the band.
                for x in (0..blocks).step_by(LANES) {
                    for (y, out) in (BAND * band..).zip(out.chunks_exact_mut(blocks)) {
                        let near = around(y, moments.len() / blocks);
                        let part = &rows[blocks * near.start..blocks * near.end];
                        let count = LANES.min(blocks - x);
                        let mut means = [[0.0; MOMENTS]; LANES];
                        for i in 0..count {
                            means[i] = mean(&part[x + i..], blocks);
                        }
                        solve(&means, window, &mut out[x..x + count]);
                    }
                }
            },
        );
    });
}

/// The mean of every so many blocks.
#[inline(always)]
fn mean(blocks: &[Moments], every: usize) -> Moments {
    let (mut sums, mut count) = ([0.0; MOMENTS], 0u32);
    for block in blocks.iter().step_by(every) {
        for i in 0..MOMENTS {
            sums[i] += block[i];
        }
        count += 1;
    }
    let share = 1.0 / f64::from(count);
    for sum in &mut sums {
        *sum *= share;
    }
    sums
}

/// Blocks whose models are found side by side.
const LANES: usize = 8;

/// Rows of blocks that a thread does in one piece.
const BAND: usize = 16;

/// A number of each block.
type Lanes = [f64; LANES];

/// Writes a window's models of light with these means, of the first blocks if there are fewer models.
#[inline(always)]
fn solve(means: &[Moments; LANES], window: usize, models: &mut [Models]) {
    let mut each = [[0.0; LANES]; MOMENTS];
    for lane in 0..LANES {
        for i in 0..MOMENTS {
            each[i][lane] = means[lane][i];
        }
    }
    let (guide, rest) = each.split_at(GUIDE);
    let (light, rest) = rest.split_at(3);
    let (pairs, mixed) = rest.split_at(PAIRS);
    // The factor of the covariances of the guide (Cholesky), row by row.
    let mut factor = [[[0.0; LANES]; GUIDE]; GUIDE];
    for i in 0..GUIDE {
        for j in 0..=i {
            let mut known = [0.0; LANES];
            for (own, other) in factor[i].iter().zip(&factor[j]).take(j) {
                add(&mut known, own, other);
            }
            let diagonal = factor[j][j];
            for lane in 0..LANES {
                let covariance = pairs[i * (i + 1) / 2 + j][lane] - guide[i][lane] * guide[j][lane];
                factor[i][j][lane] = if i == j {
                    (covariance + RIDGE - known[lane]).max(0.5 * RIDGE).sqrt()
                } else {
                    (covariance - known[lane]) / diagonal[lane]
                };
            }
        }
    }
    for c in 0..3 {
        let mut slopes = [[0.0; LANES]; GUIDE];
        for i in 0..GUIDE {
            let mut known = [0.0; LANES];
            for k in 0..i {
                add(&mut known, &factor[i][k], &slopes[k]);
            }
            for lane in 0..LANES {
                let covariance = mixed[3 * i + c][lane] - guide[i][lane] * light[c][lane];
                slopes[i][lane] = (covariance - known[lane]) / factor[i][i][lane];
            }
        }
        for i in (0..GUIDE).rev() {
            let mut known = [0.0; LANES];
            for k in i + 1..GUIDE {
                add(&mut known, &factor[k][i], &slopes[k]);
            }
            for lane in 0..LANES {
                slopes[i][lane] = (slopes[i][lane] - known[lane]) / factor[i][i][lane];
            }
        }
        let mut at_mean = [0.0; LANES];
        for k in 0..GUIDE {
            add(&mut at_mean, &slopes[k], &guide[k]);
        }
        let value = 3 * window + c;
        for (lane, models) in models.iter_mut().enumerate() {
            for k in 0..GUIDE {
                models[STRIDE * k + value] = slopes[k][lane] as f32;
            }
            models[STRIDE * GUIDE + value] = (light[c][lane] - at_mean[lane]) as f32;
            models[STRIDE * (GUIDE + 1) + value] = light[c][lane] as f32;
        }
    }
}

/// Adds products to sums.
#[inline(always)]
fn add(sums: &mut Lanes, a: &Lanes, b: &Lanes) {
    for lane in 0..LANES {
        sums[lane] += a[lane] * b[lane];
    }
}

/// The two blocks whose middles are around a pixel on an axis, and the share of the second.
#[inline(always)]
fn neighbours(at: usize, blocks: usize) -> (usize, usize, f32) {
    let place = ((at as f32 + 0.5) / BLOCK as f32 - 0.5).max(0.0);
    let first = (place as usize).min(blocks - 1);
    (first, (first + 1).min(blocks - 1), place - first as f32)
}

/// Models of a row of blocks, interpolated at a row of pixels.
#[inline(always)]
fn between_rows(models: &[Models], blocks: usize, y: usize, out: &mut Vec<Models>) {
    let (first, second, share) = neighbours(y, models.len() / blocks);
    let rows = models[first * blocks..][..blocks].iter().zip(&models[second * blocks..][..blocks]);
    out.resize(blocks, NO_MODELS);
    for (out, (first, second)) in out.iter_mut().zip(rows) {
        *out = mixed(first, second, share);
    }
}

/// The models at a share of the way from one to another.
#[inline(always)]
fn mixed(first: &Models, second: &Models, share: f32) -> Models {
    let mut out = NO_MODELS;
    // One loop: two are compiled to slow gathers.
    for i in 0..out.len() {
        out[i] = first[i] + share * (second[i] - first[i]);
    }
    out
}

/// Values of a row of pixels by the models of a row of blocks.
#[inline(always)]
fn values(row: &[Models], gbuffer: &[f32], out: &mut [f32]) {
    let pixels = out.as_chunks_mut::<VALUES>().0.iter_mut().zip(gbuffer.as_chunks::<6>().0);
    for (x, (out, pixel)) in pixels.enumerate() {
        let (guide, (first, second, share)) = (guide(pixel), neighbours(x, row.len()));
        let models = mixed(&row[first], &row[second], share);
        let mut found = [0.0; STRIDE];
        for i in 0..STRIDE {
            let mut value = models[STRIDE * GUIDE + i];
            for k in 0..GUIDE {
                value += models[STRIDE * k + i] * guide[k];
            }
            let most = MOST * models[STRIDE * (GUIDE + 1) + i];
            found[i] = value.max(most.min(0.0)).min(most.max(0.0));
        }
        out.copy_from_slice(&found[..VALUES]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made_up::numbers;
    /// Light that is linear in normal and albedo, and a G-buffer that varies from pixel to pixel.
    fn made(height: usize, width: usize, noise: f32) -> (Vec<f32>, Vec<f32>, Vec<f32>) {
        let drawn = numbers(7, 6 * height * width);
        let (mut light, mut clean, mut gbuffer) = (Vec::new(), Vec::new(), Vec::new());
        for drawn in drawn.as_chunks::<6>().0 {
            let tilt = [0.5 * drawn[0], 0.5 * drawn[1]];
            let up = (1.0 - tilt[0] * tilt[0] - tilt[1] * tilt[1]).sqrt();
            let grey = 0.5 + 0.5 * drawn[2];
            gbuffer.extend([grey, grey, grey, tilt[0], tilt[1], up]);
            for (colour, drawn) in [1.0, 0.5, 2.0].into_iter().zip(&drawn[3..]) {
                let value = colour * (1.0 + 0.6 * tilt[0] - 0.3 * tilt[1] + 0.4 * grey);
                clean.push(value);
                // Exponential noise of this share.
                light.push(value * (1.0 - noise - noise * (0.5 - 0.5 * drawn).ln()));
            }
        }
        (light, clean, gbuffer)
    }

    #[test]
    fn linear_light_is_found_again() {
        let (height, width) = (48, 64);
        let (light, clean, gbuffer) = made(height, width, 0.0);
        let found = local_models(&light, &gbuffer, height, width);
        for (found, clean) in found.chunks_exact(VALUES).zip(clean.chunks_exact(3)) {
            for (i, value) in found.iter().enumerate() {
                // The ridge is a hundredth of the variances.
                assert!((value - clean[i % 3]).abs() < 0.03 * clean[i % 3], "{i}: {value} {}", clean[i % 3]);
            }
        }
    }

    #[test]
    fn larger_windows_have_less_noise() {
        let (height, width) = (96, 96);
        let (light, clean, gbuffer) = made(height, width, 1.0);
        let found = local_models(&light, &gbuffer, height, width);
        let errors = [0, 1, 2].map(|window| {
            let each = found.chunks_exact(VALUES).zip(clean.chunks_exact(3));
            let squares = each.flat_map(|(found, clean)| {
                (0..3).map(move |c| f64::from(found[3 * window + c] / clean[c] - 1.0).powi(2))
            });
            (squares.sum::<f64>() / (3 * height * width) as f64).sqrt()
        });
        // Five numbers from 400 pixels of relative noise 1: sqrt(5/400) = 0.11. Interpolation lowers it.
        assert!(errors[0] < 0.13 && errors[1] < 0.7 * errors[0] && errors[2] < 0.7 * errors[1], "{errors:?}");
    }

    #[test]
    fn a_fit_looks_as_far_as_it_says_and_places_in_whole_blocks_change_nothing() {
        let (height, width) = (16, 160);
        let (light, _, gbuffer) = made(height, width, 1.0);
        let whole = local_models(&light, &gbuffer, height, width);
        let at = |found: &[f32], x: usize, width: usize| found[(7 * width + x) * VALUES..][..VALUES].to_vec();
        let changed = |from: usize| {
            let (mut light, mut gbuffer) = (light.clone(), gbuffer.clone());
            for y in 0..height {
                light[3 * (y * width + from)..3 * (y + 1) * width].fill(9.0);
                gbuffer[6 * (y * width + from)..6 * (y + 1) * width].fill(0.5);
            }
            local_models(&light, &gbuffer, height, width)
        };
        let mut farthest = 0;
        for x in 60..64 {
            let differs = |distance: &usize| at(&changed(x + distance), x, width) != at(&whole, x, width);
            farthest = (20..60).filter(differs).max().unwrap_or(0).max(farthest);
        }
        assert_eq!(farthest, FARTHEST_FITTED);
        // A part that begins at a whole block, seen from farther than that off its edges.
        let part = |data: &[f32], channels: usize| -> Vec<f32> {
            data.chunks_exact(channels * width).flat_map(|row| row[channels * 16..channels * 144].to_vec()).collect()
        };
        let parts = local_models(&part(&light, 3), &part(&gbuffer, 6), height, 128);
        for x in 60..100 {
            assert_eq!(at(&parts, x - 16, 128), at(&whole, x, width), "{x}");
        }
    }

    #[test]
    fn a_fit_stays_near_the_light_and_finite() {
        let (mut light, _, gbuffer) = made(16, 32, 1.0);
        light[100] = 3e38;
        light[200] = -3e38;
        let found = local_models(&light, &gbuffer, 16, 32);
        assert!(found.iter().all(|value| value.is_finite() && value.abs() <= 4.0 * BRIGHTEST_LIGHT));
        // Nothing in, nothing out; and a flat guide gives means.
        assert!(local_models(&vec![0.0; 16 * 32 * 3], &gbuffer, 16, 32).iter().all(|value| *value == 0.0));
        let flat = local_models(&vec![2.5; 16 * 32 * 3], &vec![0.5; 16 * 32 * 6], 16, 32);
        assert!(flat.iter().all(|value| (value - 2.5).abs() < 1e-5));
    }
}
