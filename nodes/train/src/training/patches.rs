//! Patches without noise in front of training scenes: black frames and cut-outs, lamps, and plain backgrounds, which
//! renders of single objects and of rooms have, and the scenes hardly. Knows no data sets.

use tauflow_data::{maths, rng::Stream};

/// Patches that partly cover a window.
pub(super) struct Patches(Vec<Patch>);

/// A rectangle, or all around one.
struct Patch {
    /// Its radiance, at the exposure of the scenes.
    radiance: [f32; 3],
    /// Albedo and normal.
    gbuffer: [f32; 6],
    /// The share of each pixel that it covers.
    covered: Vec<f32>,
    /// For each rung, the share of each pixel's samples that hit it.
    hits: Vec<Vec<f32>>,
}

/// Patches of a window, at most.
const MOST: usize = 3;

/// Points on each side of a pixel that tell how much of it is covered.
const POINTS: usize = 4;

/// Hits of up to so many samples are drawn one by one, those of more by a normal distribution.
const SINGLE: u64 = 16;

impl Patches {
    /// For windows with sides of so many pixels, of scenes with these rungs.
    pub(super) fn draw(seed: u64, side: usize, counts: &[u64]) -> Self {
        let mut stream = Stream::new(seed, &[]);
        let patches = (0..=stream.below(MOST)).map(|_| Patch::draw(&mut stream, side, counts));
        Self(patches.collect())
    }

    /// The radiance of a pixel of a rung with the patches in front of it.
    pub(super) fn over(&self, rung: usize, at: usize, mut pixel: [f32; 3]) -> [f32; 3] {
        for patch in &self.0 {
            let hit = patch.hits[rung][at];
            for (value, radiance) in pixel.iter_mut().zip(patch.radiance) {
                *value += hit * (radiance - *value);
            }
        }
        pixel
    }

    /// Puts the patches into a G-buffer, [H, W, 6].
    pub(super) fn over_gbuffer(&self, gbuffer: &mut [f32]) {
        for patch in &self.0 {
            for (pixel, covered) in gbuffer.as_chunks_mut::<6>().0.iter_mut().zip(&patch.covered) {
                for (value, own) in pixel.iter_mut().zip(patch.gbuffer) {
                    *value += covered * (own - *value);
                }
            }
        }
    }
}

impl Patch {
    fn draw(stream: &mut Stream, side: usize, counts: &[u64]) -> Self {
        let around = stream.chance(0.2);
        let kind = stream.uniform();
        let mut power = |low: f64, high: f64| maths::exp2(stream.range(low, high)) as f32;
        // Colours of any saturation.
        let (colour, grey) = ([0; 3].map(|_| power(-2.0, 0.0)), power(-3.0, 0.0));
        let (dim, bright) = (power(-6.0, 1.5), power(1.5, 8.0));
        let facing = |albedo: f32| [albedo, albedo, albedo, 0.0, 0.0, 1.0];
        // What is around the scene does not shine. A black background mostly is a black surface, as the denoiser makes
        // it, and sometimes nothing, as beside a sky.
        let (level, gbuffer) = match kind {
            ..0.3 => (0.0, facing(0.0)),
            ..0.4 => (0.0, [0.0; 6]),
            ..0.5 => (dim, [0.0; 6]),
            ..0.6 => (dim, facing(grey)),
            _ if around => (0.0, facing(0.0)),
            _ => (bright, facing(grey)),
        };
        let covered = covered(stream, side, around);
        let hits = hits(stream, &covered, counts);
        Self { radiance: colour.map(|colour| level * colour), gbuffer, covered, hits }
    }
}

/// The share of each pixel that a rectangle covers, or what is around it.
fn covered(stream: &mut Stream, side: usize, around: bool) -> Vec<f32> {
    let length = side as f64;
    let middle = [0; 2].map(|_| stream.range(-0.1, 1.1) * length);
    let halves = [0; 2].map(|_| {
        let share = if around { stream.range(-2.0, 0.5) } else { stream.range(-6.0, -1.0) };
        maths::exp2(share) * length
    });
    // Most edges of rooms and frames are upright.
    let angle = if stream.chance(0.5) { 0.0 } else { stream.range(0.0, std::f64::consts::TAU) };
    let (sin, cos) = (maths::sin(angle), maths::cos(angle));
    let inside = |x: f64, y: f64| {
        let (x, y) = (x - middle[0], y - middle[1]);
        (x * cos + y * sin).abs() < halves[0] && (y * cos - x * sin).abs() < halves[1]
    };
    let share = |at: usize| {
        let points = (0..POINTS * POINTS).filter(|i| {
            let place = |pixel: usize, point: usize| pixel as f64 + (point as f64 + 0.5) / POINTS as f64;
            inside(place(at % side, i % POINTS), place(at / side, i / POINTS)) != around
        });
        points.count() as f32 / (POINTS * POINTS) as f32
    };
    (0..side * side).map(share).collect()
}

/// For each rung, the share of the samples of each pixel that hit what covers so much of it. Rungs are nested.
fn hits(stream: &mut Stream, covered: &[f32], counts: &[u64]) -> Vec<Vec<f32>> {
    let mut rungs = vec![Vec::with_capacity(covered.len()); counts.len()];
    for share in covered {
        let (mut hits, mut before) = (0.0, 0);
        for (rung, count) in rungs.iter_mut().zip(counts) {
            hits += match *share {
                share if share <= 0.0 => 0.0,
                share if share >= 1.0 => (count - before) as f64,
                share => hit(stream, f64::from(share), count - before),
            };
            before = *count;
            rung.push((hits / *count as f64) as f32);
        }
    }
    rungs
}

/// How many of these samples hit.
fn hit(stream: &mut Stream, share: f64, samples: u64) -> f64 {
    if samples <= SINGLE {
        return (0..samples).filter(|_| stream.uniform() < share).count() as f64;
    }
    let samples = samples as f64;
    let deviation = (samples * share * (1.0 - share)).sqrt();
    (samples * share + deviation * stream.normal()).round().clamp(0.0, samples)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 48;
    const COUNTS: [u64; 6] = [1, 2, 4, 16, 64, 256];

    #[test]
    fn hits_are_those_of_nested_samples_of_what_is_covered() {
        let (mut squares, mut variances, mut kinds) = ([0.0; COUNTS.len()], [0.0; COUNTS.len()], [0; 3]);
        for seed in 0..200 {
            let patches = Patches::draw(seed, SIDE, &COUNTS);
            assert!((1..=MOST).contains(&patches.0.len()));
            for patch in &patches.0 {
                kinds[if patch.radiance == [0.0; 3] { 0 } else { 1 + usize::from(patch.radiance[0] > 3.0) }] += 1;
                for (at, covered) in patch.covered.iter().enumerate() {
                    let mut before = 0.0;
                    for (rung, count) in COUNTS.iter().enumerate() {
                        let (hit, count) = (f64::from(patch.hits[rung][at]), *count as f64);
                        let hits = hit * count;
                        assert!((hits - hits.round()).abs() < 1e-3 && hits > before - 1e-3 && hit <= 1.0, "{hits}");
                        before = hits;
                        let covered = f64::from(*covered);
                        if covered == 0.0 || covered == 1.0 {
                            assert_eq!(hit, covered);
                        }
                        squares[rung] += (hit - covered).powi(2);
                        variances[rung] += covered * (1.0 - covered) / count;
                    }
                }
            }
        }
        for (square, variance) in squares.iter().zip(&variances) {
            assert!((square / variance - 1.0).abs() < 0.1, "{squares:?} {variances:?}");
        }
        assert!(kinds.iter().all(|count| *count > 20), "black, dim and bright: {kinds:?}");
    }

    #[test]
    fn what_is_covered_shows_the_patch_and_the_rest_is_as_it_was() {
        for seed in 0..40 {
            let mut patches = Patches::draw(seed, SIDE, &COUNTS);
            patches.0.truncate(1);
            let Patch { radiance, gbuffer, covered, .. } = &patches.0[0];
            let mut found = vec![0.25; SIDE * SIDE * 6];
            patches.over_gbuffer(&mut found);
            for (at, (covered, found)) in covered.iter().zip(found.as_chunks::<6>().0).enumerate() {
                let pixel = [1.0, 2.0, 3.0];
                let over = patches.over(2, at, pixel);
                for c in 0..3 {
                    let between = (over[c] - pixel[c]) / (radiance[c] - pixel[c]);
                    match *covered {
                        0.0 => assert!(over[c] == pixel[c] && found[c] == 0.25),
                        1.0 => assert!((over[c] - radiance[c]).abs() < 1e-5 * radiance[c].max(1.0)),
                        _ => assert!((-1e-3..1.001).contains(&between), "{between}"),
                    }
                    assert!((found[c] - 0.25 - covered * (gbuffer[c] - 0.25)).abs() < 1e-6);
                }
            }
        }
    }
}
