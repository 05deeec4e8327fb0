//! Unidirectional path tracing with next-event estimation and multiple importance sampling.
//!
//! The estimator of Mitsuba 3's `path`: power heuristic (Veach 1997), Russian roulette by the path's throughput times
//! the squared relative index of refraction. Nothing is clamped; contributions that are not finite are left out and
//! counted. Surfaces with an opacity below 1 let rays pass at random, shadow rays by weight, and a passage does not
//! count as a segment. [`crate::stream`] traces the paths.

use crate::{
    accel::Hit,
    geometry::{Ray, offset_origin},
    lanes::Real,
    rng::Sampler,
    surface::{Form, Interaction},
    world::World,
};
use glam::Vec3;

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

/// Passages through transparent surfaces in one ray; only geometry that repeats without end has more.
pub(crate) const PASSAGES: u64 = 4096;

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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strategy {
    /// Both, weighted against each other.
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

/// The first hit that does not let the ray pass, at its distance from the ray's origin; for rays on their own, as the
/// paths of a render are not.
pub(crate) fn first_solid(world: &World, sampler: &Sampler, depth: u32, ray: Ray) -> Option<(Hit, Interaction)> {
    let dimension = Sampler::vertex(depth) + dimension::PASSAGE;
    let mut rest = ray;
    for passage in 0..PASSAGES {
        let (hit, at) = world.meet(&rest)?;
        let opacity = world.opacity_of(at.shape, &at.surface);
        if opacity >= 1.0 || sampler.one(dimension + (passage << 32)) < opacity {
            let t = (at.p - ray.origin).dot(ray.direction);
            return Some((Hit { t, ..hit }, at));
        }
        rest.origin = offset_origin(at.p, at.error, at.geometric, ray.direction);
    }
    None
}

/// A shadow ray on its way through surfaces.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Dimmed {
    pub(crate) ray: Ray,
    /// Share of the light that is left.
    pub(crate) share: f32,
}

impl Dimmed {
    /// Goes through the surface of a hit; false if nothing is left to be met, or no light.
    pub(crate) fn pass(&mut self, world: &World, hit: &Hit) -> bool {
        let (shape, primitive) = world.place(hit.primitive);
        if !world.materials[world.shapes[shape as usize].material as usize].has_opacity() {
            self.share = 0.0;
            return false;
        }
        let at = world.interaction_at(&self.ray, hit, (shape, primitive));
        self.share *= 1.0 - world.opacity_of(shape, &at.surface);
        if self.share <= 0.0 {
            self.share = 0.0;
            return false;
        }
        let origin = offset_origin(at.p, at.error, at.geometric, self.ray.direction);
        if self.ray.t_max == f32::MAX {
            self.ray.origin = origin;
            return true;
        }
        // The same end, measured from the new origin.
        let end = self.ray.at(1.0);
        self.ray = Ray { origin, direction: end - origin, t_max: self.ray.t_max };
        hit.t < self.ray.t_max
    }
}

/// The action of a path's ray at a hit.
pub(crate) enum Met {
    /// It ends there.
    Solid(Hit),
    /// It goes on from there.
    Through(Vec3),
}

/// What `rest` does at a hit: the ray `whole` of a path, after so many passages.
pub(crate) fn met(
    world: &World,
    sampler: &Sampler,
    depth: u32,
    passage: u64,
    (whole, rest): (&Ray, &Ray),
    hit: Hit,
) -> Met {
    let (shape, primitive) = world.place(hit.primitive);
    let own = &world.shapes[shape as usize];
    // Only spheres use the distance.
    if !world.materials[own.material as usize].has_opacity() && !matches!(own.form, Form::Sphere(_)) {
        return Met::Solid(hit);
    }
    let at = world.interaction_at(rest, &hit, (shape, primitive));
    let opacity = world.opacity_of(shape, &at.surface);
    let dimension = Sampler::vertex(depth) + dimension::PASSAGE;
    if opacity >= 1.0 || sampler.one(dimension + (passage << 32)) < opacity {
        let t = (at.p - whole.origin).dot(whole.direction);
        return Met::Solid(Hit { t, ..hit });
    }
    Met::Through(offset_origin(at.p, at.error, at.geometric, whole.direction))
}

#[cfg(test)]
mod tests;
