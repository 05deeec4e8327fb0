//! Metal: `conductor`, `roughconductor`.

use super::{
    DELTA_ALPHA, Drawn, fresnel,
    ggx::{Facets, Ggx, Microfacets},
    local::reflect,
};
use crate::lanes::{Pair, Real, Triple};
use glam::Vec3;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Metal<R> {
    pub(crate) eta: Vec3,
    pub(crate) k: Vec3,
    pub(crate) alpha: f32,
    pub(crate) tint: Triple<R>,
    /// Microfacets other than GGX of that roughness.
    pub(crate) finish: Option<Facets<R>>,
}

impl<R: Real> Metal<R> {
    pub(crate) fn is_delta(&self) -> bool {
        self.alpha < DELTA_ALPHA
    }

    #[inline(always)]
    fn ggx(&self) -> Ggx<R> {
        Ggx { alpha: R::splat(self.alpha) }
    }

    /// Value and density.
    #[inline(always)]
    pub(crate) fn eval(&self, wo: Triple<R>, wi: Triple<R>) -> (Triple<R>, R) {
        if self.is_delta() {
            return (Triple::zero(), R::zero());
        }
        match self.finish {
            None => self.eval_of(self.ggx(), wo, wi),
            Some(facets) => self.eval_of(facets, wo, wi),
        }
    }

    #[inline(always)]
    fn eval_of(&self, facets: impl Microfacets<R>, wo: Triple<R>, wi: Triple<R>) -> (Triple<R>, R) {
        let above = wo.z.positive() & wi.z.positive();
        let m = (wo + wi).normalize();
        let cos = wo.dot(m);
        let f = fresnel::conductor(cos, self.eta, self.k);
        let value = f * self.tint * (facets.d(m) * facets.g(wo, wi, m) / (wo.z * 4.0));
        let pdf = facets.pdf(wo, m) / (cos * 4.0);
        (value.only(above), pdf.only(above))
    }

    #[inline(always)]
    pub(crate) fn sample(&self, wo: Triple<R>, _: R, u: Pair<R>) -> Drawn<R> {
        let above = wo.z.positive();
        if self.is_delta() {
            let wi = Triple::new(-wo.x, -wo.y, wo.z);
            let weight = fresnel::conductor(wo.z, self.eta, self.k) * self.tint;
            return Drawn { wi, weight, delta: above, valid: above, ..Drawn::nothing() };
        }
        match self.finish {
            None => self.sample_of(self.ggx(), wo, u),
            Some(facets) => self.sample_of(facets, wo, u),
        }
    }

    #[inline(always)]
    fn sample_of(&self, facets: impl Microfacets<R>, wo: Triple<R>, u: Pair<R>) -> Drawn<R> {
        let m = facets.sample(wo, u);
        let wi = reflect(wo, m);
        let cos = wo.dot(m);
        let f = fresnel::conductor(cos, self.eta, self.k);
        Drawn {
            wi,
            weight: f * self.tint * (facets.excess(wo, m) * facets.g1(wi, m)),
            pdf: facets.pdf(wo, m) / (cos * 4.0),
            valid: wo.z.positive() & wi.z.positive() & cos.positive(),
            ..Drawn::nothing()
        }
    }

    pub(crate) fn albedo(&self) -> Triple<R> {
        fresnel::conductor(R::one(), self.eta, self.k) * self.tint
    }
}
