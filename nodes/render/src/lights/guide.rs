//! Estimates of what lights bring to a point, by which lights are chosen.

use crate::{
    accel,
    lanes::{Real, Triple},
};
use glam::Vec3;

/// How much light a light would bring to a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Guide {
    pub(super) center: Vec3,
    /// Squared radius: nearer than that, distance does not count.
    pub(super) square: f32,
    /// Intensity, or irradiance of what is infinitely far.
    pub(super) strength: f32,
    /// Normal of what shines to one side only; 0 of what shines to all.
    pub(super) normal: Vec3,
    pub(super) far: bool,
}

impl Guide {
    #[inline(always)]
    pub(super) fn importance<R: Real>(&self, p: Triple<R>) -> R {
        if self.far {
            return R::splat(self.strength);
        }
        let d = p - Triple::splat(self.center);
        let square = d.dot(d);
        let near = R::splat(self.strength) / square.max(R::splat(self.square));
        if self.normal == Vec3::ZERO {
            return near;
        }
        // A little whatever the angle: a light of some extent is seen from beside it.
        let cos = d.dot(Triple::splat(self.normal)) / square.max(R::splat(self.square)).sqrt();
        near * (cos.max(R::zero()) + 0.1)
    }

    pub(super) fn point(center: Vec3, strength: f32) -> Self {
        Self { center, square: f32::MIN_POSITIVE, strength, normal: Vec3::ZERO, far: false }
    }
}

/// The guide of a shape of an intensity, by its extent and, if it is flat, its normal.
pub(super) fn shape_guide(
    forms: impl Iterator<Item = accel::Primitive>,
    normal: Option<Vec3>,
    intensity: f32,
) -> Guide {
    let (low, high) =
        forms.map(|form| form.bounds()).fold((Vec3::MAX, Vec3::MIN), |all, own| (all.0.min(own.0), all.1.max(own.1)));
    let square = ((high - low) * 0.5).length_squared().max(f32::MIN_POSITIVE);
    // A quarter for a surface that faces anywhere, and another for a body that is seen from all sides.
    let seen = if normal.is_some() { 0.25 } else { 0.0625 };
    let point = Guide::point((low + high) * 0.5, seen * intensity);
    Guide { square: 0.25 * square, normal: normal.unwrap_or(Vec3::ZERO), ..point }
}
