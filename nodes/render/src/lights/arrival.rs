//! Light that may arrive at points, and the shadow rays that find out.

use crate::{
    geometry::offset_origins,
    lanes::{Mask, Real, Triple},
};
use glam::Vec3;

/// Points that light may arrive at.
#[derive(Clone, Copy)]
pub(crate) struct Vantage<R> {
    pub(crate) p: Triple<R>,
    /// Bound on the error of `p`.
    pub(crate) error: Triple<R>,
    /// Geometric normal.
    pub(crate) normal: Triple<R>,
    /// Its [`super::Lights::cell`].
    pub(crate) cell: R,
}

/// Light that may arrive at points.
#[derive(Clone, Copy)]
pub(crate) struct Arrivals<R: Real> {
    /// Unit directions towards it.
    pub(crate) direction: Triple<R>,
    /// Shadow rays: where they begin, where they go in units of `t_max`.
    pub(crate) origin: Triple<R>,
    pub(crate) ray: Triple<R>,
    pub(crate) t_max: f32,
    /// Radiance over the density of the sample.
    pub(crate) weight: Triple<R>,
    /// Density over solid angle; 0 for lights that nothing else can find.
    pub(crate) pdf: R,
    /// Density with which light paths are emitted this way, if there are any.
    pub(crate) emits: R,
    /// Lanes where light may arrive.
    pub(crate) valid: R::Mask,
}

/// [`Arrivals`] of whatever lights the lanes have picked.
pub(crate) struct Arrived<R: Real> {
    pub(crate) direction: Triple<R>,
    pub(crate) origin: Triple<R>,
    pub(crate) ray: Triple<R>,
    pub(crate) t_max: R,
    pub(crate) weight: Triple<R>,
    pub(crate) pdf: R,
    pub(crate) emits: R,
    /// The part of the weight that is expected to arrive.
    pub(crate) expected: R,
    pub(crate) valid: R::Mask,
}

impl<R: Real> Vantage<R> {
    /// Light from infinity.
    #[inline(always)]
    pub(super) fn endless(&self, direction: Triple<R>, weight: Triple<R>, pdf: R, valid: R::Mask) -> Arrivals<R> {
        let origin = offset_origins(self.p, self.error, self.normal, direction);
        Arrivals { direction, origin, ray: direction, t_max: f32::MAX, weight, pdf, emits: R::zero(), valid }
    }

    /// Light from a point without extent.
    #[inline(always)]
    pub(super) fn lone(&self, position: Vec3, intensity: Triple<R>) -> Arrivals<R> {
        let end = Triple::splat(position);
        let d = end - self.p;
        let square = d.dot(d);
        let direction = d * (R::one() / square.sqrt());
        let origin = offset_origins(self.p, self.error, self.normal, direction);
        let weight = intensity * (R::one() / square);
        let valid = square.positive() & square.finite() & weight.some();
        Arrivals { direction, origin, ray: end - origin, t_max: 1.0, weight, pdf: R::zero(), emits: R::zero(), valid }
    }
}

impl<R: Real> Arrived<R> {
    #[inline(always)]
    pub(super) fn none() -> Self {
        Self {
            direction: Triple::zero(),
            origin: Triple::zero(),
            ray: Triple::zero(),
            t_max: R::zero(),
            weight: Triple::zero(),
            pdf: R::zero(),
            emits: R::zero(),
            expected: R::one(),
            valid: R::Mask::from_bits(0),
        }
    }

    /// Takes over the lanes of a mask, which picked this light with a probability.
    #[inline(always)]
    pub(super) fn take(&mut self, own: R::Mask, probability: R, from: Arrivals<R>) {
        self.direction = Triple::select(own, from.direction, self.direction);
        self.origin = Triple::select(own, from.origin, self.origin);
        self.ray = Triple::select(own, from.ray, self.ray);
        self.t_max = R::select(own, R::splat(from.t_max), self.t_max);
        self.weight = Triple::select(own, from.weight * (R::one() / probability), self.weight);
        self.pdf = R::select(own, from.pdf * probability, self.pdf);
        self.emits = R::select(own, from.emits, self.emits);
        self.valid = self.valid | (own & from.valid);
    }
}
