//! Metals: `conductor`, `roughconductor`.

use super::{DELTA_ALPHA, Sample, fresnel, ggx::Ggx, local::reflect};
use glam::{Vec2, Vec3};

#[derive(Clone, Copy, Debug)]
pub(crate) struct Metal {
    pub(crate) eta: Vec3,
    pub(crate) k: Vec3,
    pub(crate) alpha: f32,
    pub(crate) tint: Vec3,
}

impl Metal {
    pub(crate) fn is_delta(&self) -> bool {
        self.alpha < DELTA_ALPHA
    }

    #[inline]
    pub(crate) fn eval(&self, wo: Vec3, wi: Vec3) -> Vec3 {
        if self.is_delta() || wo.z <= 0.0 || wi.z <= 0.0 {
            return Vec3::ZERO;
        }
        let ggx = Ggx { alpha: self.alpha };
        let m = (wo + wi).normalize();
        let f = fresnel::conductor(wo.dot(m), self.eta, self.k);
        f * self.tint * (ggx.d(m) * ggx.g(wo, wi, m) / (4.0 * wo.z))
    }

    #[inline]
    pub(crate) fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        if self.is_delta() || wo.z <= 0.0 || wi.z <= 0.0 {
            return 0.0;
        }
        let m = (wo + wi).normalize();
        Ggx { alpha: self.alpha }.pdf(wo, m) / (4.0 * wo.dot(m))
    }

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3, u: Vec2) -> Option<Sample> {
        if wo.z <= 0.0 {
            return None;
        }
        let whole = |wi: Vec3, weight: Vec3, pdf: f32, delta: bool| {
            Some(Sample { wi, weight, pdf, delta, transmitted: false, eta: 1.0 })
        };
        if self.is_delta() {
            let wi = Vec3::new(-wo.x, -wo.y, wo.z);
            return whole(wi, fresnel::conductor(wo.z, self.eta, self.k) * self.tint, 0.0, true);
        }
        let ggx = Ggx { alpha: self.alpha };
        let m = ggx.sample(wo, u);
        let wi = reflect(wo, m);
        let cos = wo.dot(m);
        if wi.z <= 0.0 || cos <= 0.0 {
            return None;
        }
        let f = fresnel::conductor(cos, self.eta, self.k);
        whole(wi, f * self.tint * ggx.g1(wi, m), ggx.pdf(wo, m) / (4.0 * cos), false)
    }

    pub(crate) fn albedo(&self) -> Vec3 {
        fresnel::conductor(1.0, self.eta, self.k) * self.tint
    }
}
