//! The path tracer of a scene as a function of its samples.
//!
//! It gives errors and times between the rungs that were measured, and beyond them.

use crate::time_samples::Sample;
use tauflow_data::maths::{exp, log};

/// How a scene's path tracer goes on, between and beyond the rungs that were measured.
pub(crate) struct Course<'a>(pub(crate) &'a [Sample]);

impl Course<'_> {
    pub(crate) fn spp(&self, i: usize) -> f64 {
        self.0[i].from_spp as f64
    }

    pub(crate) fn last(&self) -> usize {
        self.0.len() - 1
    }

    /// Samples after which the squared error is this: along straight lines of logarithms, beyond the ends by the law.
    pub(crate) fn spp_of(&self, mse: f64) -> f64 {
        let by_law = |i: usize| self.spp(i) * self.0[i].mse / mse;
        let Some(i) = self.0.iter().position(|s| s.mse <= mse) else { return by_law(self.last()) };
        if i == 0 {
            return by_law(0);
        }
        let (a, b) = (log(self.0[i - 1].mse), log(self.0[i].mse));
        let share = if a > b { (a - log(mse)) / (a - b) } else { 1.0 };
        exp(log(self.spp(i - 1)) + share * (log(self.spp(i)) - log(self.spp(i - 1))))
    }

    /// Wall time to so many samples: along straight lines; what is less than the first rung takes as long as that.
    pub(crate) fn wall_of(&self, spp: f64) -> f64 {
        let i = (1..self.last()).find(|i| self.spp(*i) >= spp).unwrap_or(self.last());
        let slope = (self.0[i].wall_s[1] - self.0[i - 1].wall_s[1]) / (self.spp(i) - self.spp(i - 1));
        self.0[i - 1].wall_s[1] + slope.max(0.0) * (spp.max(self.spp(0)) - self.spp(i - 1))
    }

    /// Wall time until an error is at most this; infinite if the last rung is not there yet.
    pub(crate) fn wall_to(&self, error: impl Fn(&Sample) -> f64, most: f64) -> f64 {
        let Some(i) = self.0.iter().position(|s| error(s) <= most) else { return f64::INFINITY };
        if i == 0 {
            return self.0[0].wall_s[1];
        }
        let (a, b) = (log(error(&self.0[i - 1])), log(error(&self.0[i])));
        let share = if a > b { (a - log(most)) / (a - b) } else { 1.0 };
        self.wall_of(exp(log(self.spp(i - 1)) + share * (log(self.spp(i)) - log(self.spp(i - 1)))))
    }

    /// After how many samples it is as good as an image, and how many times as long it takes to get there.
    pub(crate) fn against(&self, image: &Sample) -> (f64, f64) {
        let spp = self.spp_of(image.mse);
        (spp, self.wall_of(spp) / image.wall_s[1])
    }

    /// Samples after so much wall time: no less than the first rung.
    pub(crate) fn spp_after(&self, wall_s: f64) -> f64 {
        let i = (1..self.last()).find(|i| self.0[*i].wall_s[1] >= wall_s).unwrap_or(self.last());
        let (from, to) = (&self.0[i - 1], &self.0[i]);
        let step = to.wall_s[1] - from.wall_s[1];
        let share = if step > 0.0 { (wall_s - from.wall_s[1]) / step } else { 1.0 };
        (self.spp(i - 1) + share * (self.spp(i) - self.spp(i - 1))).max(self.spp(0))
    }

    /// A figure at so many samples, along straight lines over log samples. Beyond the last rung it grows by `beyond`
    /// for each factor of e.
    pub(crate) fn at(&self, spp: f64, of: impl Fn(&Sample) -> f64, beyond: f64) -> f64 {
        let last = self.last();
        if spp >= self.spp(last) {
            return of(&self.0[last]) + beyond * log(spp / self.spp(last));
        }
        let i = (1..last).find(|i| self.spp(*i) >= spp).unwrap_or(last);
        let share = log(spp / self.spp(i - 1)) / log(self.spp(i) / self.spp(i - 1));
        of(&self.0[i - 1]) + share.clamp(0.0, 1.0) * (of(&self.0[i]) - of(&self.0[i - 1]))
    }
}

/// dB for each factor of e by which a squared error falls.
pub(crate) fn decibels() -> f64 {
    10.0 / log(10.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time_samples::tests::{near, scene};
    use tauflow_data::maths::log10;

    #[test]
    fn a_path_tracer_that_keeps_to_the_law_is_followed_exactly() {
        let scene = scene(3);
        let course = Course(&scene.own);
        let variance = scene.own[0].mse;
        for n in [0.5, 1.0, 3.0, 100.0, 128.0, 5000.0] {
            near(course.spp_of(variance / n), n);
            near(course.at(n, |s| s.hdr_psnr, decibels()), -10.0 * log10(variance / f64::max(n, 1.0)));
        }
        for n in [1.0, 3.0, 100.0, 128.0, 5000.0] {
            near(course.wall_of(n), 0.1 + 0.01 * n);
            near(course.spp_after(0.1 + 0.01 * n), n);
        }
        near(course.wall_of(0.25), 0.11);
        near(course.wall_to(|s| s.mse, variance / 3.0), 0.13);
        near(course.wall_to(|s| s.mse, variance * 2.0), 0.11);
        assert!(course.wall_to(|s| s.mse, variance / 129.0).is_infinite());
        near(course.spp_after(0.01), 1.0);
    }
}
