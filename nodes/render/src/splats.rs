//! Light that lands on any pixel of the film, whichever task has found it.
//!
//! Tasks run on as many threads as there are. What they find is added in the order of their numbers, and within a task
//! in the order in which it was found. So the sum of each pixel has the same bits for any number of threads.

use glam::Vec3;
use rayon::prelude::*;

/// Tasks whose splats are in memory at once.
const TOGETHER: u64 = 64;

/// Light that a sample brings to a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splat {
    /// The pixel, rows from the top.
    pub pixel: u32,
    /// The sample, counted from the first of the [`Splats`].
    pub sample: u32,
    /// What it adds to that sample of that pixel.
    pub light: Vec3,
}

/// What a task has found.
#[derive(Clone, Debug, Default)]
pub struct Finds {
    /// Light, in the order in which it was found.
    pub splats: Vec<Splat>,
    /// Path segments traced.
    pub segments: u64,
    /// Contributions that were not finite.
    pub rejected: u64,
}

/// Sums of splats, for some samples of every pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Splats {
    samples: usize,
    sums: Vec<Vec3>,
    /// Path segments traced.
    pub segments: u64,
    /// Contributions that were not finite, and therefore left out.
    pub rejected: u64,
}

impl Splats {
    /// No light yet.
    pub fn new(pixels: usize, samples: usize) -> Self {
        Self { samples, sums: vec![Vec3::ZERO; pixels * samples], segments: 0, rejected: 0 }
    }

    /// Runs tasks 0..count, and adds what they find in the order of their numbers.
    pub fn gather(&mut self, count: u64, task: impl Fn(u64) -> Finds + Sync) {
        for first in (0..count).step_by(TOGETHER as usize) {
            let last = (first + TOGETHER).min(count);
            let found: Vec<Finds> = (first..last).into_par_iter().map(&task).collect();
            found.iter().for_each(|finds| self.add(finds));
        }
    }

    fn add(&mut self, finds: &Finds) {
        self.segments += finds.segments;
        self.rejected += finds.rejected;
        for splat in &finds.splats {
            self.sums[splat.pixel as usize * self.samples + splat.sample as usize] += splat.light;
        }
    }

    /// What samples bring to a pixel, by sample.
    pub fn of(&self, pixel: usize) -> &[Vec3] {
        &self.sums[pixel * self.samples..][..self.samples]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::rng::Stream;

    /// Splats of very different sizes on few pixels: the order of addition shows.
    fn task(number: u64) -> Finds {
        let mut draw = Stream::new(7, &[number]);
        let splats = (0..50)
            .map(|_| Splat {
                pixel: draw.below(6) as u32,
                sample: draw.below(2) as u32,
                light: Vec3::splat((draw.uniform() * 10f64.powi(draw.below(8) as i32)) as f32),
            })
            .collect();
        // The more, the later it ends: tasks do not end in their order.
        let mut spent = 0u64;
        for _ in 0..(number % 7) * 2000 {
            spent = spent.wrapping_add(draw.bits());
        }
        Finds { splats, segments: 1 + spent % 2, rejected: number % 3 }
    }

    fn on_threads(threads: usize) -> Splats {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let mut splats = Splats::new(6, 2);
        pool.install(|| splats.gather(300, task));
        splats
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let one = on_threads(1);
        for threads in [2, 3, 8] {
            assert_eq!(on_threads(threads), one, "{threads} threads");
        }
        // In another order the bits are others, so that the above says something.
        let mut reversed = Splats::new(6, 2);
        (0..300).rev().for_each(|number| reversed.add(&task(number)));
        assert_ne!(reversed.sums, one.sums);
        let near = |(a, b): (&Vec3, &Vec3)| (*a - *b).abs().max_element() <= 1e-3 * a.max_element();
        assert!(reversed.sums.iter().zip(&one.sums).all(near));
        assert_eq!((reversed.segments, reversed.rejected), (one.segments, one.rejected));
    }

    #[test]
    fn splats_land_on_their_pixel_and_sample() {
        let mut splats = Splats::new(3, 2);
        let light = Vec3::new(1.0, 2.0, 3.0);
        let lands = |pixel, sample| Splat { pixel, sample, light };
        splats.gather(1, |_| Finds { splats: vec![lands(2, 1), lands(0, 0), lands(2, 1)], segments: 4, rejected: 0 });
        assert_eq!(splats.of(0), [light, Vec3::ZERO]);
        assert_eq!(splats.of(1), [Vec3::ZERO; 2]);
        assert_eq!(splats.of(2), [Vec3::ZERO, light * 2.0]);
        assert_eq!(splats.segments, 4);
    }
}
