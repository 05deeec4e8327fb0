//! Parameterizations: targets at real endpoints, and the step that a prediction defines. Knows no network.
//!
//! Here clean = I_nmax, and tau is the variance time of the ladder:
//!
//! | parameterization | input | target |
//! |---|---|---|
//! | `mc_noise` | I_k | I_k - clean |
//! | `mc_velocity` | I_k | (clean - I_k)/(1 - tau_k) |
//! | `local_velocity` | I_k | (I_next - I_k)/(tau_next - tau_k) |
//! | `vanilla_rf` | (1 - t) I_nmin + t clean | clean - I_nmin |

use tauflow_data::{Image, methods::Parameterization, time::VarianceTime};

/// The maths of a [`Parameterization`]: what a network learns, and how its prediction moves a state.
pub(crate) trait ParameterizationMaths: Sized {
    /// The target at endpoint `k` of a ladder with these sample counts; only `vanilla_rf` uses `t` in [0, 1]. The time
    /// that belongs to it is [`Self::time`].
    ///
    /// # Panics
    /// If `k` is the last rung, which has nothing to learn.
    fn lesson(self, clock: &VarianceTime, counts: &[u64], k: usize, t: f64) -> Lesson;

    /// The time that the network is told at endpoint `k`.
    fn time(self, clock: &VarianceTime, counts: &[u64], k: usize, t: f64) -> f64;

    /// The estimate of the clean image from a state at `tau` and the prediction there; none if it has no such estimate.
    fn clean(self, state: &Image, prediction: &Image, tau: f64) -> Option<Image>;

    /// The state at `next` from a state at `tau` and the prediction there.
    ///
    /// At `next` = 1 this is exactly the clean estimate, where there is one; nothing is divided by a vanishing 1 - tau.
    fn step(self, state: &Image, prediction: &Image, tau: f64, next: f64) -> Image;
}

impl ParameterizationMaths for Parameterization {
    fn lesson(self, clock: &VarianceTime, counts: &[u64], k: usize, t: f64) -> Lesson {
        let last = counts.len() - 1;
        assert!(k < last, "the last rung is no endpoint to learn at");
        let tau = |i: usize| clock.tau(counts[i] as f64);
        let from_endpoint = |to, scale: f64| Lesson { from: k, to, share: 0.0, scale: scale as f32 };
        match self {
            Self::McNoise => from_endpoint(last, -1.0),
            Self::McVelocity => from_endpoint(last, 1.0 / (1.0 - tau(k))),
            Self::LocalVelocity => from_endpoint(k + 1, 1.0 / (tau(k + 1) - tau(k))),
            Self::VanillaRf => Lesson { from: 0, to: last, share: t as f32, scale: 1.0 },
        }
    }

    fn time(self, clock: &VarianceTime, counts: &[u64], k: usize, t: f64) -> f64 {
        if self == Self::VanillaRf { t } else { clock.tau(counts[k] as f64) }
    }

    fn clean(self, state: &Image, prediction: &Image, tau: f64) -> Option<Image> {
        let scale = match self {
            Self::McNoise => -1.0,
            Self::McVelocity => (1.0 - tau) as f32,
            Self::LocalVelocity | Self::VanillaRf => return None,
        };
        Some(combine(state, prediction, |s, p| s + scale * p))
    }

    fn step(self, state: &Image, prediction: &Image, tau: f64, next: f64) -> Image {
        match self.clean(state, prediction, tau) {
            Some(clean) if next >= 1.0 => clean,
            Some(clean) if self == Self::McNoise => {
                let share = ((next - tau) / (1.0 - tau)) as f32;
                combine(state, &clean, |s, c| s + share * (c - s))
            }
            _ => {
                let step = (next - tau) as f32;
                combine(state, prediction, |s, p| s + step * p)
            }
        }
    }
}

/// The target of a solver, from two rungs of a ladder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lesson {
    /// The rung that the input starts from.
    pub(crate) from: usize,
    /// The rung that the target points at.
    pub(crate) to: usize,
    /// How far the input is moved towards that rung; 0 but for interpolants.
    pub(crate) share: f32,
    /// The factor that turns the difference of the rungs into the target.
    pub(crate) scale: f32,
}

impl Lesson {
    /// Input and target for a value of rung `from` and one of rung `to`.
    #[inline(always)]
    pub(crate) fn example(self, from: f32, to: f32) -> (f32, f32) {
        let whole = to - from;
        (from + self.share * whole, self.scale * whole)
    }
}

fn combine(a: &Image, b: &Image, f: impl Fn(f32, f32) -> f32) -> Image {
    let mut out = a.clone();
    for (o, b) in out.data_mut().iter_mut().zip(b.data()) {
        *o = f(*o, *b);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const COUNTS: [u64; 4] = [1, 2, 4, 8];
    const RUNGS: [f32; 4] = [5.0, 3.0, 2.5, 2.0];

    fn clock() -> VarianceTime {
        VarianceTime::new(1, 8).expect("a ladder")
    }

    #[test]
    fn a_perfect_prediction_of_the_whole_way_lands_on_clean() {
        for p in [Parameterization::McNoise, Parameterization::McVelocity] {
            for (k, rung) in RUNGS.iter().enumerate().take(3) {
                let lesson = p.lesson(&clock(), &COUNTS, k, 0.0);
                let (input, target) = lesson.example(RUNGS[lesson.from], RUNGS[lesson.to]);
                assert_eq!(input, *rung);
                let tau = p.time(&clock(), &COUNTS, k, 0.0);
                let state = Image::from_data(1, 1, 1, vec![input]).expect("fits");
                let prediction = Image::from_data(1, 1, 1, vec![target]).expect("fits");
                let end = p.step(&state, &prediction, tau, 1.0);
                assert!((end.data()[0] - 2.0).abs() < 1e-5, "{p:?} {k}: {}", end.data()[0]);
            }
        }
    }

    #[test]
    fn the_local_target_steps_to_the_next_rung_exactly() {
        let p = Parameterization::LocalVelocity;
        for k in 0..3 {
            let lesson = p.lesson(&clock(), &COUNTS, k, 0.0);
            let (input, target) = lesson.example(RUNGS[lesson.from], RUNGS[lesson.to]);
            let (tau, next) = (clock().tau(COUNTS[k] as f64), clock().tau(COUNTS[k + 1] as f64));
            let state = Image::from_data(1, 1, 1, vec![input]).expect("fits");
            let prediction = Image::from_data(1, 1, 1, vec![target]).expect("fits");
            assert!((p.step(&state, &prediction, tau, next).data()[0] - RUNGS[k + 1]).abs() < 1e-5);
            assert!(p.clean(&state, &prediction, tau).is_none());
        }
    }

    #[test]
    fn rectified_flow_alone_sees_interpolants() {
        let p = Parameterization::VanillaRf;
        let lesson = p.lesson(&clock(), &COUNTS, 1, 0.25);
        let (input, target) = lesson.example(RUNGS[lesson.from], RUNGS[lesson.to]);
        assert_eq!((input, target), (5.0 - 0.75, -3.0));
        assert_eq!(p.time(&clock(), &COUNTS, 1, 0.25), 0.25);
    }
}
