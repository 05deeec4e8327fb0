//! Local linear models of the light: the guided filter (He, Sun and Tang 2010) with normals and albedo as its guide.
//!
//! In a window around each pixel, the noisy light is fitted by least squares as a linear function of normal and mean
//! albedo. Its value at the pixel's own normal and albedo has the light and shadow of joints, bumps and patterns, which
//! averaging blurs, and the little noise of a large window. Moments and models are those of blocks of pixels,
//! and models are interpolated between blocks, as in the fast guided filter (He and Sun 2015).

use rayon::prelude::*;

/// Pixels of a block's side.
pub(crate) const BLOCK: usize = 4;

/// Blocks on each side of a block in the windows: 20, 36 and 68 pixels.
pub(crate) const RADII: [usize; 3] = [2, 4, 8];

/// Values of a pixel: three colours for each window.
pub(crate) const FITTED: usize = 3 * RADII.len();

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

/// Means of a block: of the guide, the light, products of the guide, and products of guide and light.
const MOMENTS: usize = GUIDE + 3 + PAIRS + 3 * GUIDE;

/// Numbers of a model: three slopes for each value of the guide, three constants, and the mean light.
const MODEL: usize = 3 * GUIDE + 3 + 3;

/// How far, in pixels, a fit looks at most: at the blocks of a window, and at the models of two blocks on each axis.
pub(crate) const FIT_REACH: usize = (RADII[RADII.len() - 1] + 1) * BLOCK + BLOCK / 2 - 1;

/// The light at each pixel by the models of each window, [H, W, [`RADII`], 3].
///
/// `light` is [H, W, 3], and `gbuffer` [H, W, 6]. H and W are multiples of [`BLOCK`].
pub(crate) fn fits(light: &[f32], gbuffer: &[f32], height: usize, width: usize) -> Vec<f32> {
    let mut out = vec![0.0; height * width * FITTED];
    let moments = moments(light, gbuffer, width);
    for (window, radius) in RADII.into_iter().enumerate() {
        let models: Vec<[f32; MODEL]> = window_means(&moments, width / BLOCK, radius).par_iter().map(model).collect();
        let rows = out.par_chunks_exact_mut(width * FITTED).zip(gbuffer.par_chunks_exact(6 * width)).enumerate();
        rows.for_each(|(y, (out, gbuffer))| {
            let row = between_rows(&models, width / BLOCK, y);
            let pixels = out.as_chunks_mut::<FITTED>().0.iter_mut().zip(gbuffer.as_chunks::<6>().0).enumerate();
            for (x, (out, pixel)) in pixels {
                let (first, second, share) = neighbours(x, width / BLOCK);
                let model = mixed(&row[first], &row[second], share);
                let (slopes, rest) = model.split_at(3 * GUIDE);
                let (mut value, most) = ([rest[0], rest[1], rest[2]], [rest[3], rest[4], rest[5]]);
                for (guide, slopes) in guide(pixel).iter().zip(slopes.as_chunks::<3>().0) {
                    (0..3).for_each(|c| value[c] += slopes[c] * guide);
                }
                for c in 0..3 {
                    let most = MOST * most[c];
                    out[3 * window + c] = value[c].clamp(most.min(0.0), most.max(0.0));
                }
            }
        });
    }
    out
}

fn guide(pixel: &[f32; 6]) -> [f32; GUIDE] {
    [pixel[3], pixel[4], pixel[5], (pixel[0] + pixel[1] + pixel[2]) / 3.0]
}

/// Means of each block.
fn moments(light: &[f32], gbuffer: &[f32], width: usize) -> Vec<[f64; MOMENTS]> {
    let rows = light.par_chunks_exact(3 * width * BLOCK).zip(gbuffer.par_chunks_exact(6 * width * BLOCK));
    let blocks = rows.flat_map_iter(|(light, gbuffer)| {
        let mut found = vec![[0.0; MOMENTS]; width / BLOCK];
        let pixels = light.as_chunks::<3>().0.iter().zip(gbuffer.as_chunks::<6>().0).enumerate();
        for (at, (light, pixel)) in pixels {
            let (guide, sums) = (guide(pixel).map(f64::from), &mut found[at % width / BLOCK]);
            let light = light.map(|value| f64::from(value.clamp(-BRIGHTEST_LIGHT, BRIGHTEST_LIGHT)));
            let (of_guide, sums) = sums.split_at_mut(GUIDE);
            let (of_light, sums) = sums.split_at_mut(3);
            let (of_pairs, of_mixed) = sums.split_at_mut(PAIRS);
            (0..GUIDE).for_each(|i| of_guide[i] += guide[i]);
            (0..3).for_each(|c| of_light[c] += light[c]);
            for i in 0..GUIDE {
                (0..=i).for_each(|j| of_pairs[i * (i + 1) / 2 + j] += guide[i] * guide[j]);
                (0..3).for_each(|c| of_mixed[3 * i + c] += guide[i] * light[c]);
            }
        }
        found.iter_mut().flatten().for_each(|sum| *sum /= (BLOCK * BLOCK) as f64);
        found
    });
    blocks.collect()
}

/// Means over the blocks around each block, of those that there are.
fn window_means(blocks: &[[f64; MOMENTS]], width: usize, radius: usize) -> Vec<[f64; MOMENTS]> {
    let height = blocks.len() / width;
    let around = |at: usize, length: usize| at.saturating_sub(radius)..=(at + radius).min(length - 1);
    let of_rows = |i: usize| {
        let row = &blocks[i / width * width..][..width];
        mean(row[around(i % width, width)].iter())
    };
    let rows: Vec<[f64; MOMENTS]> = (0..blocks.len()).into_par_iter().with_min_len(64).map(of_rows).collect();
    let of_columns = |i: usize| mean(around(i / width, height).map(|y| &rows[y * width + i % width]));
    (0..blocks.len()).into_par_iter().with_min_len(64).map(of_columns).collect()
}

fn mean<'a>(blocks: impl Iterator<Item = &'a [f64; MOMENTS]>) -> [f64; MOMENTS] {
    let (mut sums, mut count) = ([0.0; MOMENTS], 0u32);
    for block in blocks {
        (0..MOMENTS).for_each(|i| sums[i] += block[i]);
        count += 1;
    }
    let share = 1.0 / f64::from(count);
    sums.map(|sum| sum * share)
}

/// The linear model of light with these means.
fn model(means: &[f64; MOMENTS]) -> [f32; MODEL] {
    let (guide, rest) = means.split_at(GUIDE);
    let (light, rest) = rest.split_at(3);
    let (pairs, mixed) = rest.split_at(PAIRS);
    // The factor of the covariances of the guide (Cholesky), row by row.
    let mut factor = [[0.0; GUIDE]; GUIDE];
    for i in 0..GUIDE {
        for j in 0..=i {
            let ridge = if i == j { RIDGE } else { 0.0 };
            let covariance = pairs[i * (i + 1) / 2 + j] - guide[i] * guide[j] + ridge;
            let rest = covariance - (0..j).map(|k| factor[i][k] * factor[j][k]).sum::<f64>();
            factor[i][j] = if i == j { rest.max(0.5 * RIDGE).sqrt() } else { rest / factor[j][j] };
        }
    }
    let mut out = [0.0; MODEL];
    for colour in 0..3 {
        let mut slopes = [0.0; GUIDE];
        for i in 0..GUIDE {
            let covariance = mixed[3 * i + colour] - guide[i] * light[colour];
            slopes[i] = (covariance - (0..i).map(|k| factor[i][k] * slopes[k]).sum::<f64>()) / factor[i][i];
        }
        for i in (0..GUIDE).rev() {
            slopes[i] = (slopes[i] - (i + 1..GUIDE).map(|k| factor[k][i] * slopes[k]).sum::<f64>()) / factor[i][i];
        }
        let at_mean: f64 = slopes.iter().zip(guide).map(|(slope, guide)| slope * guide).sum();
        (0..GUIDE).for_each(|k| out[3 * k + colour] = slopes[k] as f32);
        out[3 * GUIDE + colour] = (light[colour] - at_mean) as f32;
        out[3 * GUIDE + 3 + colour] = light[colour] as f32;
    }
    out
}

/// The two blocks whose middles are around a pixel on an axis, and the share of the second.
fn neighbours(at: usize, blocks: usize) -> (usize, usize, f32) {
    let place = ((at as f32 + 0.5) / BLOCK as f32 - 0.5).max(0.0);
    let first = (place as usize).min(blocks - 1);
    (first, (first + 1).min(blocks - 1), place - first as f32)
}

/// Models of a row of blocks, interpolated at a row of pixels.
fn between_rows(models: &[[f32; MODEL]], width: usize, y: usize) -> Vec<[f32; MODEL]> {
    let (first, second, share) = neighbours(y, models.len() / width);
    let [first, second] = [first, second].map(|row| &models[row * width..(row + 1) * width]);
    first.iter().zip(second).map(|(first, second)| mixed(first, second, share)).collect()
}

/// The model at a share of the way from one to another.
#[inline(always)]
fn mixed(first: &[f32; MODEL], second: &[f32; MODEL], share: f32) -> [f32; MODEL] {
    std::array::from_fn(|i| first[i] + share * (second[i] - first[i]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::rng::Stream;

    /// Light that is linear in normal and albedo, and a G-buffer that varies from pixel to pixel.
    fn made(height: usize, width: usize, noise: f64) -> (Vec<f32>, Vec<f32>, Vec<f32>) {
        let mut stream = Stream::new(7, &[]);
        let (mut light, mut clean, mut gbuffer) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..height * width {
            let tilt = [0.0; 2].map(|_| stream.range(-0.5, 0.5) as f32);
            let up = (1.0 - tilt[0] * tilt[0] - tilt[1] * tilt[1]).sqrt();
            let grey = stream.uniform() as f32;
            gbuffer.extend([grey, grey, grey, tilt[0], tilt[1], up]);
            for colour in [1.0, 0.5, 2.0] {
                let value = colour * (1.0 + 0.6 * tilt[0] - 0.3 * tilt[1] + 0.4 * grey);
                clean.push(value);
                // Exponential noise of this share.
                light.push(value * (1.0 - noise - noise * (1.0 - stream.uniform()).ln()) as f32);
            }
        }
        (light, clean, gbuffer)
    }

    #[test]
    fn linear_light_is_found_again() {
        let (height, width) = (48, 64);
        let (light, clean, gbuffer) = made(height, width, 0.0);
        let found = fits(&light, &gbuffer, height, width);
        for (found, clean) in found.chunks_exact(FITTED).zip(clean.chunks_exact(3)) {
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
        let found = fits(&light, &gbuffer, height, width);
        let errors = [0, 1, 2].map(|window| {
            let each = found.chunks_exact(FITTED).zip(clean.chunks_exact(3));
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
        let whole = fits(&light, &gbuffer, height, width);
        let at = |found: &[f32], x: usize, width: usize| found[(7 * width + x) * FITTED..][..FITTED].to_vec();
        let changed = |from: usize| {
            let (mut light, mut gbuffer) = (light.clone(), gbuffer.clone());
            for y in 0..height {
                light[3 * (y * width + from)..3 * (y + 1) * width].fill(9.0);
                gbuffer[6 * (y * width + from)..6 * (y + 1) * width].fill(0.5);
            }
            fits(&light, &gbuffer, height, width)
        };
        let mut farthest = 0;
        for x in 60..64 {
            let differs = |distance: &usize| at(&changed(x + distance), x, width) != at(&whole, x, width);
            farthest = (20..60).filter(differs).max().unwrap_or(0).max(farthest);
        }
        assert_eq!(farthest, FIT_REACH);
        // A part that begins at a whole block, seen from farther than that off its edges.
        let part = |data: &[f32], channels: usize| -> Vec<f32> {
            data.chunks_exact(channels * width).flat_map(|row| row[channels * 16..channels * 144].to_vec()).collect()
        };
        let parts = fits(&part(&light, 3), &part(&gbuffer, 6), height, 128);
        for x in 60..100 {
            assert_eq!(at(&parts, x - 16, 128), at(&whole, x, width), "{x}");
        }
    }

    #[test]
    fn a_fit_stays_near_the_light_and_finite() {
        let (mut light, _, gbuffer) = made(16, 32, 1.0);
        light[100] = 3e38;
        light[200] = -3e38;
        let found = fits(&light, &gbuffer, 16, 32);
        assert!(found.iter().all(|value| value.is_finite() && value.abs() <= 4.0 * BRIGHTEST_LIGHT));
        // Nothing in, nothing out; and a flat guide gives means.
        assert!(fits(&vec![0.0; 16 * 32 * 3], &gbuffer, 16, 32).iter().all(|value| *value == 0.0));
        let flat = fits(&vec![2.5; 16 * 32 * 3], &vec![0.5; 16 * 32 * 6], 16, 32);
        assert!(flat.iter().all(|value| (value - 2.5).abs() < 1e-5));
    }
}
