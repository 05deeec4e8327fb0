//! Glass: `dielectric`, `roughdielectric`, `thindielectric`.

use super::{
    DELTA_ALPHA, Sample, fresnel,
    ggx::Ggx,
    local::{flip, reflect, refract},
};
use glam::{Vec2, Vec3};

/// Relative indices nearer to 1 than this bend light by less than the precision of half vectors allows.
const INDEX_MATCHED: f32 = 1e-3;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Glass {
    /// Index inside over index outside.
    pub(crate) eta: f32,
    pub(crate) alpha: f32,
    pub(crate) reflectance: Vec3,
    pub(crate) transmittance: Vec3,
}

/// The facet that turns `wo` into `wi`, on the outer side, and whether light crosses it.
struct Facet {
    m: Vec3,
    reflected: bool,
    /// Relative index in the direction of travel.
    eta: f32,
    /// Factor from density of facets to density of directions.
    spread: f32,
}

impl Glass {
    /// Without a difference of indices nothing bends, however rough.
    pub(crate) fn is_delta(&self) -> bool {
        self.alpha < DELTA_ALPHA || (self.eta - 1.0).abs() < INDEX_MATCHED
    }

    #[inline]
    fn facet(&self, wo: Vec3, wi: Vec3) -> Option<Facet> {
        let crossing = wo.z * wi.z;
        if self.is_delta() || crossing == 0.0 {
            return None;
        }
        let reflected = crossing > 0.0;
        let eta = if wo.z > 0.0 { self.eta } else { 1.0 / self.eta };
        let m = (wo + wi * if reflected { 1.0 } else { eta }).normalize_or_zero();
        let m = if m.z < 0.0 { -m } else { m };
        let (o, i) = (wo.dot(m), wi.dot(m));
        // Facets face the side that each direction is on.
        if o * wo.z <= 0.0 || i * wi.z <= 0.0 {
            return None;
        }
        let spread = if reflected {
            1.0 / (4.0 * i)
        } else {
            let sum = o + eta * i;
            eta * eta * i / (sum * sum)
        };
        Some(Facet { m, reflected, eta, spread: spread.abs() })
    }

    #[inline]
    pub(crate) fn eval(&self, wo: Vec3, wi: Vec3) -> Vec3 {
        let Some(facet) = self.facet(wo, wi) else { return Vec3::ZERO };
        let ggx = Ggx { alpha: self.alpha };
        let f = fresnel::dielectric(wo.dot(facet.m), self.eta).r;
        let shape = ggx.d(facet.m) * ggx.g(wo, wi, facet.m);
        if facet.reflected {
            return self.reflectance * (f * shape / (4.0 * wo.z.abs()));
        }
        // The squared index of radiance cancels that of the facets' spread.
        let spread = facet.spread / (facet.eta * facet.eta);
        self.transmittance * ((1.0 - f) * shape * (wo.dot(facet.m) / wo.z).abs() * spread)
    }

    #[inline]
    pub(crate) fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        let Some(facet) = self.facet(wo, wi) else { return 0.0 };
        let f = fresnel::dielectric(wo.dot(facet.m), self.eta).r;
        let upper = if wo.z < 0.0 { -wo } else { wo };
        let density = Ggx { alpha: self.alpha }.pdf(upper, facet.m);
        density * facet.spread * if facet.reflected { f } else { 1.0 - f }
    }

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        if wo.z == 0.0 {
            return None;
        }
        let delta = self.is_delta();
        let ggx = Ggx { alpha: self.alpha };
        let m = if delta { Vec3::Z } else { ggx.sample(if wo.z < 0.0 { -wo } else { wo }, u) };
        let cos = wo.dot(m);
        let f = fresnel::dielectric(cos, self.eta);
        let transmitted = lobe >= f.r;
        let wi = if transmitted { refract(wo, m, f.cos_t, f.eta_ti) } else { reflect(wo, m) };
        if (wi.z * wo.z < 0.0) != transmitted || wi.z == 0.0 {
            return None;
        }
        let (mut weight, eta) =
            if transmitted { (self.transmittance * (f.eta_ti * f.eta_ti), f.eta_it) } else { (self.reflectance, 1.0) };
        let mut pdf = 0.0;
        if !delta {
            weight *= ggx.g1(wi, m);
            pdf = self.pdf(wo, wi);
        }
        Some(Sample { wi, weight, pdf, delta, transmitted, eta })
    }

    pub(crate) fn albedo(&self) -> Vec3 {
        let f = fresnel::dielectric(1.0, self.eta).r;
        self.reflectance * f + self.transmittance * (1.0 - f)
    }
}

/// A sheet so thin that what crosses it goes straight on, all inner reflections added up.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Thin {
    pub(crate) eta: f32,
    pub(crate) reflectance: Vec3,
    pub(crate) transmittance: Vec3,
}

impl Thin {
    fn reflected(&self, cos: f32) -> f32 {
        let r = fresnel::dielectric(cos.abs(), self.eta).r;
        // r + t^2 r + t^2 r^3 + ... with t = 1 - r.
        if r < 1.0 { r + (1.0 - r) * (1.0 - r) * r / (1.0 - r * r) } else { 1.0 }
    }

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3, lobe: f32) -> Option<Sample> {
        if wo.z == 0.0 {
            return None;
        }
        let transmitted = lobe >= self.reflected(wo.z);
        let wi = if transmitted { -wo } else { flip(-wo) };
        let weight = if transmitted { self.transmittance } else { self.reflectance };
        Some(Sample { wi, weight, pdf: 0.0, delta: true, transmitted, eta: 1.0 })
    }

    pub(crate) fn albedo(&self) -> Vec3 {
        let f = self.reflected(1.0);
        self.reflectance * f + self.transmittance * (1.0 - f)
    }
}
