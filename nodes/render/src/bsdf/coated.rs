//! A diffuse base under a dielectric coat: `plastic`, `roughplastic` with `nonlinear: false`.

use super::{DELTA_ALPHA, Sample, fresnel, ggx, ggx::Ggx, local::reflect};
use glam::{Vec2, Vec3};

const PI: f32 = std::f32::consts::PI;

/// What depends on the coat alone, worked out once for each material.
#[derive(Clone, Debug)]
pub(crate) struct Coat {
    pub(crate) eta: f32,
    pub(crate) alpha: f32,
    /// Diffuse light that the coat throws back inside.
    inner: f32,
    /// Share that a rough coat lets in, by cosine over [0, 1].
    enters: Vec<f32>,
}

impl Coat {
    pub(crate) fn new(eta: f32, alpha: f32) -> Self {
        const STEPS: usize = 64;
        if alpha < DELTA_ALPHA {
            return Self { eta, alpha, inner: fresnel::diffuse_reflectance(1.0 / eta), enters: Vec::new() };
        }
        let cosine = |i: usize| (i as f32 / (STEPS - 1) as f32).max(1e-4);
        let disk = ggx::half_disk();
        let enters = (0..STEPS).map(|i| ggx::transmittance(alpha, eta, cosine(i), &disk)).collect();
        // Over the same cosines as the table, both ends counted whole, as Mitsuba has it.
        let sum: f64 = (0..STEPS)
            .map(|i| f64::from(ggx::reflectance(alpha, 1.0 / eta, cosine(i), &disk)) * f64::from(cosine(i)))
            .sum();
        Self { eta, alpha, inner: (2.0 * sum / STEPS as f64) as f32, enters }
    }

    #[inline]
    fn enters(&self, cos: f32) -> f32 {
        if self.enters.is_empty() {
            return 1.0 - fresnel::dielectric(cos, self.eta).r;
        }
        let x = cos.clamp(0.0, 1.0) * (self.enters.len() - 1) as f32;
        let i = (x as usize).min(self.enters.len() - 2);
        let f = x - i as f32;
        self.enters[i] * (1.0 - f) + self.enters[i + 1] * f
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Plastic<'a> {
    pub(crate) base: Vec3,
    pub(crate) coat: &'a Coat,
}

impl Plastic<'_> {
    fn is_delta(&self) -> bool {
        self.coat.alpha < DELTA_ALPHA
    }

    /// Probability of drawing the coat.
    #[inline]
    fn share(&self, cos: f32) -> f32 {
        let enters = self.coat.enters(cos);
        let (coat, base) = (1.0 - enters, enters * self.base.max_element());
        if coat + base > 0.0 { coat / (coat + base) } else { 1.0 }
    }

    #[inline]
    fn diffuse(&self, wo: Vec3, wi: Vec3) -> Vec3 {
        let inside = 1.0 / (self.coat.eta * self.coat.eta * (1.0 - self.coat.inner));
        self.base * (self.coat.enters(wo.z) * self.coat.enters(wi.z) * inside * wi.z / PI)
    }

    #[inline]
    pub(crate) fn eval(&self, wo: Vec3, wi: Vec3) -> Vec3 {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return Vec3::ZERO;
        }
        let mut value = self.diffuse(wo, wi);
        if !self.is_delta() {
            let ggx = Ggx { alpha: self.coat.alpha };
            let m = (wo + wi).normalize();
            let f = fresnel::dielectric(wo.dot(m), self.coat.eta).r;
            value += f * ggx.d(m) * ggx.g(wo, wi, m) / (4.0 * wo.z);
        }
        value
    }

    #[inline]
    pub(crate) fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return 0.0;
        }
        let share = self.share(wo.z);
        let mut pdf = (1.0 - share) * wi.z / PI;
        if !self.is_delta() {
            let m = (wo + wi).normalize();
            pdf += share * Ggx { alpha: self.coat.alpha }.pdf(wo, m) / (4.0 * wo.dot(m));
        }
        pdf
    }

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        if wo.z <= 0.0 {
            return None;
        }
        let share = self.share(wo.z);
        let mut sample = Sample {
            wi: Vec3::new(-wo.x, -wo.y, wo.z),
            weight: Vec3::ZERO,
            pdf: 0.0,
            delta: false,
            transmitted: false,
            eta: 1.0,
        };
        if lobe < share {
            if self.is_delta() {
                let f = fresnel::dielectric(wo.z, self.coat.eta).r;
                return Some(Sample { weight: Vec3::splat(f / share), delta: true, ..sample });
            }
            sample.wi = reflect(wo, Ggx { alpha: self.coat.alpha }.sample(wo, u));
        } else {
            sample.wi = ggx::diffuse(u).0;
        }
        sample.pdf = self.pdf(wo, sample.wi);
        if sample.pdf <= 0.0 {
            return None;
        }
        sample.weight = self.eval(wo, sample.wi) / sample.pdf;
        Some(sample)
    }

    pub(crate) fn albedo(&self) -> Vec3 {
        let enters = self.coat.enters(1.0);
        self.base * enters + Vec3::splat(1.0 - enters)
    }
}
