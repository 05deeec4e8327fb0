//! Surfaces with an opacity below 1: they let rays of paths pass at random, and shadow rays by weight. A passage does
//! not count as a segment.

use super::dimension;
use crate::{
    accel::Hit,
    geometry::{Ray, offset_origin},
    rng::Sampler,
    surface::{Form, Interaction},
    world::World,
};
use glam::Vec3;

/// Passages through transparent surfaces in one ray; only geometry that repeats without end has more.
pub(crate) const PASSAGES: u64 = 4096;

/// The first hit that does not let the ray pass, at its distance from the ray's origin; for rays on their own, as the
/// paths of a render are not.
pub(crate) fn first_solid(world: &World, sampler: &Sampler, depth: u32, ray: Ray) -> Option<(Hit, Interaction)> {
    let dimension = Sampler::vertex(depth) + dimension::PASSAGE;
    let mut rest = ray;
    for passage in 0..PASSAGES {
        let (hit, at) = world.meet(&rest)?;
        let opacity = if world.hides(at.shape, depth) { 0.0 } else { world.opacity_of(at.shape, &at.surface) };
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
        if !world.materials[world.shapes[shape as usize].material as usize].material.has_opacity() {
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
pub(crate) enum Passage {
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
) -> Passage {
    let (shape, primitive) = world.place(hit.primitive);
    let own = &world.shapes[shape as usize];
    if world.hides(shape, depth) {
        let at = world.interaction_at(rest, &hit, (shape, primitive));
        return Passage::Through(offset_origin(at.p, at.error, at.geometric, whole.direction));
    }
    // Only spheres use the distance.
    if !world.materials[own.material as usize].material.has_opacity() && !matches!(own.form, Form::Sphere(_)) {
        return Passage::Solid(hit);
    }
    let at = world.interaction_at(rest, &hit, (shape, primitive));
    let opacity = world.opacity_of(shape, &at.surface);
    let dimension = Sampler::vertex(depth) + dimension::PASSAGE;
    if opacity >= 1.0 || sampler.one(dimension + (passage << 32)) < opacity {
        let t = (at.p - whole.origin).dot(whole.direction);
        return Passage::Solid(Hit { t, ..hit });
    }
    Passage::Through(offset_origin(at.p, at.error, at.geometric, whole.direction))
}
