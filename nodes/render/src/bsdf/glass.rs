//! Glass: `dielectric`, `roughdielectric`, `thindielectric`.

use super::{
    DELTA_ALPHA, Drawn, fresnel,
    ggx::{Facets, Ggx, Microfacets},
    local::{reflect, refract},
};
use crate::lanes::{Pair, Real, Triple};

/// Relative indices nearer to 1 than this bend light by less than the precision of half vectors allows.
const INDEX_MATCHED: f32 = 1e-3;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Glass<R> {
    /// Index inside over index outside.
    pub(crate) eta: f32,
    pub(crate) alpha: f32,
    pub(crate) reflectance: Triple<R>,
    pub(crate) transmittance: Triple<R>,
    /// Microfacets other than GGX of that roughness.
    pub(crate) finish: Option<Facets<R>>,
}

impl<R: Real> Glass<R> {
    /// Without a difference of indices nothing bends, however rough.
    pub(crate) fn is_delta(&self) -> bool {
        self.alpha < DELTA_ALPHA || (self.eta - 1.0).abs() < INDEX_MATCHED
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
        let facet = facet(self.eta, wo, wi);
        let f = fresnel::dielectric(facet.o, self.eta).r;
        let shape = facets.d(facet.m) * facets.g1(wo, facet.m) * facets.g1(wi, facet.m);
        let reflected = f * shape / (wo.z.abs() * 4.0);
        // The squared index of radiance cancels that of the facets' spread.
        let spread = facet.spread / (facet.eta * facet.eta);
        let crossed = (R::one() - f) * shape * (facet.o / wo.z).abs() * spread;
        let value = Triple::select(facet.reflected, self.reflectance * reflected, self.transmittance * crossed);
        let density = facets.drawn(wo, facet.m) * facet.o.abs() / wo.z.abs();
        let pdf = density * facet.spread * R::select(facet.reflected, f, R::one() - f);
        (value.only(facet.fits), pdf.only(facet.fits))
    }

    #[inline(always)]
    pub(crate) fn sample(&self, wo: Triple<R>, lobe: R, u: Pair<R>) -> Drawn<R> {
        match self.finish {
            None => self.sample_of(self.ggx(), wo, lobe, u),
            Some(facets) => self.sample_of(facets, wo, lobe, u),
        }
    }

    #[inline(always)]
    fn sample_of(&self, facets: impl Microfacets<R>, wo: Triple<R>, lobe: R, u: Pair<R>) -> Drawn<R> {
        let zero = R::zero();
        let delta = self.is_delta();
        let upper = Triple::select(wo.z.lt(zero), -wo, wo);
        let m = if delta { Triple::new(zero, zero, R::one()) } else { facets.sample(upper, u) };
        let f = fresnel::dielectric(wo.dot(m), self.eta);
        let transmitted = lobe.ge(f.r);
        let wi = Triple::select(transmitted, refract(wo, m, f.cos_t, f.eta_ti), reflect(wo, m));
        let across = (wi.z * wo.z).lt(zero);
        let valid = !(wo.z.equals(zero) | wi.z.equals(zero)) & ((across & transmitted) | !(across | transmitted));
        let weight = Triple::select(transmitted, self.transmittance * (f.eta_ti * f.eta_ti), self.reflectance);
        let eta = R::select(transmitted, f.eta_it, R::one());
        let mut drawn = Drawn { wi, weight, eta, transmitted, valid, ..Drawn::nothing() };
        if delta {
            drawn.delta = valid;
        } else {
            drawn.weight = weight * (facets.excess(wo, m) * facets.g1(wi, m));
            drawn.pdf = self.eval(wo, wi).1;
        }
        drawn
    }

    pub(crate) fn albedo(&self) -> Triple<R> {
        let f = fresnel::dielectric(R::one(), self.eta).r;
        self.reflectance * f + self.transmittance * (R::one() - f)
    }
}

/// The facet that turns one direction into another, on the outer side.
pub(crate) struct Facet<R: Real> {
    pub(crate) m: Triple<R>,
    /// Cosines of both directions to it.
    pub(crate) o: R,
    pub(crate) i: R,
    /// Relative index in the direction of travel.
    pub(crate) eta: R,
    /// Factor from density of facets to density of directions.
    pub(crate) spread: R,
    /// Whether light stays on its side.
    pub(crate) reflected: R::Mask,
    /// Whether the facet faces the side that each direction is on.
    pub(crate) fits: R::Mask,
}

#[inline(always)]
pub(crate) fn facet<R: Real>(inside: f32, wo: Triple<R>, wi: Triple<R>) -> Facet<R> {
    let zero = R::zero();
    let crossing = wo.z * wi.z;
    let reflected = crossing.positive();
    let eta = R::select(wo.z.positive(), R::splat(inside), R::splat(1.0 / inside));
    let m = (wo + wi * R::select(reflected, R::one(), eta)).normalize();
    let m = Triple::select(m.z.lt(zero), -m, m);
    let (o, i) = (wo.dot(m), wi.dot(m));
    let sum = o + eta * i;
    let spread = R::select(reflected, R::splat(0.25) / i, eta * eta * i / (sum * sum)).abs();
    let fits = !crossing.equals(zero) & (o * wo.z).positive() & (i * wi.z).positive();
    Facet { m, o, i, eta, spread, reflected, fits }
}

/// A sheet so thin that what crosses it goes straight on, all inner reflections added up.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Thin<R> {
    pub(crate) eta: f32,
    pub(crate) reflectance: Triple<R>,
    pub(crate) transmittance: Triple<R>,
}

impl<R: Real> Thin<R> {
    #[inline(always)]
    fn reflected(&self, cos: R) -> R {
        let one = R::one();
        let r = fresnel::dielectric(cos.abs(), self.eta).r;
        // r + t^2 r + t^2 r^3 + ... with t = 1 - r.
        R::select(r.lt(one), r + (one - r) * (one - r) * r / (one - r * r), one)
    }

    /// No density anywhere.
    #[inline(always)]
    pub(crate) fn eval(&self, _: Triple<R>, _: Triple<R>) -> (Triple<R>, R) {
        (Triple::zero(), R::zero())
    }

    #[inline(always)]
    pub(crate) fn sample(&self, wo: Triple<R>, lobe: R, _: Pair<R>) -> Drawn<R> {
        let transmitted = lobe.ge(self.reflected(wo.z));
        let wi = Triple::select(transmitted, -wo, Triple::new(-wo.x, -wo.y, wo.z));
        let weight = Triple::select(transmitted, self.transmittance, self.reflectance);
        let valid = !wo.z.equals(R::zero());
        Drawn { wi, weight, delta: valid, transmitted, valid, ..Drawn::nothing() }
    }

    pub(crate) fn albedo(&self) -> Triple<R> {
        let f = self.reflected(R::one());
        self.reflectance * f + self.transmittance * (R::one() - f)
    }
}
