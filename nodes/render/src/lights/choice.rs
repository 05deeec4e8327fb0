//! One of several samples of lights, by what they would bring to a surface if nothing stood in between, times the part
//! that is expected to arrive.
//!
//! Resampled importance sampling (Talbot, Cline, Egbert 2005): candidates are kept in proportion to their brightness
//! times the cosine at the surface, and the one that is kept weighs as much as all did on average. Only it gets a
//! shadow ray.

use super::Arrived;
use crate::lanes::{Mask, Real, Triple};

/// The candidates so far.
pub(crate) struct Choice<R: Real> {
    kept: Arrived<R>,
    /// Brightness of the one that is kept.
    own: R,
    /// Brightness of all.
    sum: R,
    /// Candidates whose brightness is not finite.
    rejected: u64,
}

impl<R: Real> Choice<R> {
    #[inline(always)]
    pub(crate) fn new() -> Self {
        Self { kept: Arrived::none(), own: R::one(), sum: R::zero(), rejected: 0 }
    }

    /// Takes what is the only candidate.
    #[inline(always)]
    pub(crate) fn only(&mut self, arrived: Arrived<R>) {
        (self.kept, self.sum) = (arrived, R::one());
    }

    /// Considers a candidate at a surface that reflects on the side of a normal only, by a number in [0, 1).
    #[inline(always)]
    pub(crate) fn consider(&mut self, one: Arrived<R>, normal: Triple<R>, number: R) {
        let cos = normal.dot(one.direction).max(R::zero());
        let bright = (one.weight.x + one.weight.y + one.weight.z) * cos * one.expected;
        let finite = bright.finite();
        self.rejected += u64::from((one.valid & !finite).bits().count_ones());
        let bright = bright.only(one.valid & finite);
        self.sum += bright;
        let better = bright.positive() & (number * self.sum).lt(bright);
        let kept = &mut self.kept;
        kept.direction = Triple::select(better, one.direction, kept.direction);
        kept.origin = Triple::select(better, one.origin, kept.origin);
        kept.ray = Triple::select(better, one.ray, kept.ray);
        kept.t_max = R::select(better, one.t_max, kept.t_max);
        kept.weight = Triple::select(better, one.weight, kept.weight);
        kept.pdf = R::select(better, one.pdf, kept.pdf);
        kept.emits = R::select(better, one.emits, kept.emits);
        kept.valid = kept.valid | better;
        self.own = R::select(better, bright, self.own);
    }

    /// How many candidates were left out for not being finite.
    #[inline(always)]
    pub(crate) fn rejected(&self) -> u64 {
        self.rejected
    }

    /// The candidate that was kept, with the weight and density of all candidates.
    #[inline(always)]
    pub(crate) fn made(self, candidates: u64) -> Arrived<R> {
        if candidates == 1 {
            return self.kept;
        }
        let count = candidates as f32;
        let weight = self.kept.weight * (self.sum / (self.own * count));
        Arrived { weight, pdf: self.kept.pdf * count, ..self.kept }
    }
}
