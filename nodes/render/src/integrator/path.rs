//! Unidirectional path tracing with next-event estimation and multiple importance sampling.
//!
//! The estimator of Mitsuba 3's `path`: power heuristic (Veach 1997), Russian roulette by the path's throughput times
//! the squared relative index of refraction. Nothing is clamped. Contributions that are not finite are left out and
//! counted. [`crate::stream`] has the steps of a bounce, each for a whole batch of paths; the loop over bounces is
//! here.

use crate::{dispatch::Kernels, lanes::Real, stream::Stream};

/// Traces paths from the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Path {
    /// How light is found.
    pub strategy: Strategy,
    /// When paths are ended at random.
    pub roulette: Roulette,
}

impl Path {
    /// Traces a batch bounce by bounce: all rays are met, hits are sorted by material, each material shades its own,
    /// and shadow rays come last.
    pub(crate) fn run(&self, stream: &mut Stream<'_>, kernels: &Kernels) {
        kernels.begin(stream);
        for depth in 0..stream.batch.depth {
            let live = stream.live();
            if live == 0 {
                break;
            }
            stream.found.segments += live as u64;
            stream.meet_solid(kernels, depth);
            stream.sort();
            stream.leave(kernels, depth);
            stream.shade(kernels, depth);
            stream.shadow(kernels);
            stream.go_on();
        }
    }
}

/// When paths are ended at random.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Roulette {
    /// Vertices before it begins.
    pub from: u32,
    /// A path goes on with the probability of its throughput times this, and of 0.95 at most.
    pub gain: f32,
}

impl Roulette {
    /// The setting of Mitsuba's `path`.
    pub const LATE: Self = Self { from: 5, gain: 1.0 };
}

impl Default for Roulette {
    /// From the second vertex on, but only of paths that carry less than a third: measured to cost the least time to a
    /// given error over all strata.
    fn default() -> Self {
        Self { from: 2, gain: 3.0 }
    }
}

/// Dimensions of a vertex.
pub(crate) mod dimension {
    /// Which light; which row of the sky or primitive of the shape.
    pub(crate) const LIGHT: u64 = 0;
    /// Whether that row or primitive stays; which column.
    pub(crate) const LIGHT_PART: u64 = 1;
    /// Whether that column stays; whether the light does.
    pub(crate) const LIGHT_SPARE: u64 = 2;
    /// Which point.
    pub(crate) const LIGHT_POINT: u64 = 3;
    /// Which lobe; whether the path goes on.
    pub(crate) const LOBE_AND_ROULETTE: u64 = 4;
    /// Which direction.
    pub(crate) const SCATTER: u64 = 5;
    /// Whether a transparent surface lets the ray pass.
    pub(crate) const PASSAGE: u64 = 6;
    /// Whether a light takes the place of the candidates before it.
    pub(crate) const CANDIDATE: u64 = 7;

    /// The weight of the candidates after the first.
    #[inline(always)]
    pub(crate) fn candidate(number: u64) -> u64 {
        number << 24
    }
}

/// Which ways of finding light count: all in a render; one of two in tests of the estimator; one where its share is
/// asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// Both, weighted against each other.
    #[default]
    Mis,
    /// Light sampling alone, wherever it can find the light.
    LightsOnly,
    /// Scattering alone, but for lights that it cannot find.
    ScatteringOnly,
    /// Only light that a specular surface sends onto one that scatters it, and that is seen there: caustics, and what
    /// they light in turn. Straight passages through thin glass do not count.
    Caustics,
}

impl Strategy {
    /// Weight of samples of density `own` that another technique finds with density `other`.
    #[inline(always)]
    pub(crate) fn weight<R: Real>(self, by_light: bool, own: R, other: R) -> R {
        match self {
            Self::Mis => {
                let ratio = other / own;
                R::one() / (ratio * ratio + 1.0)
            }
            Self::LightsOnly if by_light => R::one(),
            Self::ScatteringOnly if !by_light => R::one(),
            // Where scattering is specular, and only there, light is not weighed.
            Self::Caustics => R::zero(),
            _ => R::select(other.positive(), R::zero(), R::one()),
        }
    }
}
