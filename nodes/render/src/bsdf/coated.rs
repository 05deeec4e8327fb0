//! A diffuse base under a dielectric coat: `plastic`, `roughplastic` with `nonlinear: false`.

use super::{
    DELTA_ALPHA, Drawn, fresnel,
    ggx::{self, Facets, Ggx, Interface, Microfacets as _},
    local::reflect,
};
use crate::{
    dispatch::kernels,
    lanes::{Integer, Pair, Real, Triple},
};
use glam::Vec2;
use tauflow_instructions::Instructions;

const PI: f32 = std::f32::consts::PI;

/// Values that depend only on the coat, computed once per material.
#[derive(Clone, Debug)]
pub(crate) struct Coat {
    pub(crate) eta: f32,
    pub(crate) alpha: f32,
    beckmann: bool,
    /// Whether light that goes back and forth below takes on the base's colour.
    nonlinear: bool,
    /// Diffuse light that the coat throws back inside.
    inner: f32,
    /// Share that a rough coat lets in, by cosine over [0, 1].
    enters: Vec<f32>,
}

impl Coat {
    pub(crate) fn new(eta: f32, alpha: f32) -> Self {
        Self::finished(eta, alpha, false, false)
    }

    /// The same in another finish.
    pub(crate) fn in_finish(&self, beckmann: bool, nonlinear: bool) -> Self {
        Self::finished(self.eta, self.alpha, beckmann, nonlinear)
    }

    fn finished(eta: f32, alpha: f32, beckmann: bool, nonlinear: bool) -> Self {
        const STEPS: usize = 64;
        if alpha < DELTA_ALPHA {
            return Self {
                eta,
                alpha,
                beckmann,
                nonlinear,
                inner: fresnel::diffuse_reflectance(1.0 / eta),
                enters: Vec::new(),
            };
        }
        let cosines: [f32; STEPS] = std::array::from_fn(|i| (i as f32 / (STEPS - 1) as f32).max(1e-4));
        let kernels = kernels(Instructions::best());
        let shares = |eta: f32, disk: &[Vec2], through: bool| {
            let mut shares = vec![0.0; STEPS];
            kernels.shares(&Interface { alpha, beckmann, eta, disk, through }, &cosines, &mut shares);
            shares
        };
        let enters = shares(eta, &ggx::half_disk(), true);
        // Over the same cosines as the table, both ends counted whole, as Mitsuba has it.
        let inside = shares(1.0 / eta, &ggx::staggered_half_disk(), false);
        let sum: f64 = inside.iter().zip(cosines).map(|(share, cos)| f64::from(*share) * f64::from(cos)).sum();
        Self { eta, alpha, beckmann, nonlinear, inner: (2.0 * sum / STEPS as f64) as f32, enters }
    }

    #[inline(always)]
    fn enters<R: Real>(&self, cos: R) -> R {
        if self.enters.is_empty() {
            return R::one() - fresnel::dielectric(cos, self.eta).r;
        }
        let last = self.enters.len() as i32 - 2;
        let x = cos.clamp(0.0, 1.0) * (last + 1) as f32;
        let i = x.to_integer().min(R::Integer::splat(last));
        let f = x - R::of_integer(i);
        R::gather(&self.enters, i) * (R::one() - f) + R::gather(&self.enters, i + R::Integer::splat(1)) * f
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Plastic<'a, R> {
    pub(crate) base: Triple<R>,
    pub(crate) coat: &'a Coat,
}

impl<R: Real> Plastic<'_, R> {
    pub(crate) fn is_delta(&self) -> bool {
        self.coat.alpha < DELTA_ALPHA
    }

    #[inline(always)]
    fn ggx(&self) -> Ggx<R> {
        Ggx { alpha: R::splat(self.coat.alpha) }
    }

    /// The base, brighter for what the coat throws back, and 1 over what of that is left.
    #[inline(always)]
    fn below(&self) -> (Triple<R>, f32) {
        let (eta2, inner) = (self.coat.eta * self.coat.eta, self.coat.inner);
        if !self.coat.nonlinear {
            return (self.base, 1.0 / (eta2 * (1.0 - inner)));
        }
        let lit = |v: R| v / (R::one() - v * inner);
        (Triple::new(lit(self.base.x), lit(self.base.y), lit(self.base.z)), 1.0 / eta2)
    }

    /// Probability of drawing the coat.
    #[inline(always)]
    fn share(&self, enters: R) -> R {
        let (coat, base) = (R::one() - enters, enters * self.base.largest());
        R::select((coat + base).positive(), coat / (coat + base), R::one())
    }

    /// Value and density.
    #[inline(always)]
    pub(crate) fn eval(&self, wo: Triple<R>, wi: Triple<R>) -> (Triple<R>, R) {
        let above = wo.z.positive() & wi.z.positive();
        let enters = self.coat.enters(wo.z);
        let share = self.share(enters);
        let (base, inside) = self.below();
        let mut value = base * (enters * self.coat.enters(wi.z) * inside * wi.z / PI);
        let mut pdf = (R::one() - share) * wi.z / PI;
        if !self.is_delta() {
            let ggx = self.ggx();
            let m = (wo + wi).normalize();
            let cos = wo.dot(m);
            let f = fresnel::dielectric(cos, self.coat.eta).r;
            let shape = if self.coat.beckmann {
                let facets = Facets { alpha: [ggx.alpha; 2], beckmann: true };
                f * facets.d(m) * facets.g(wo, wi, m)
            } else {
                f * ggx.d(m) * ggx.g(wo, wi, m)
            };
            value += Triple::all(shape / (wo.z * 4.0));
            pdf += share * ggx.pdf(wo, m) / (cos * 4.0);
        }
        (value.only(above), pdf.only(above))
    }

    #[inline(always)]
    pub(crate) fn sample(&self, wo: Triple<R>, lobe: R, u: Pair<R>) -> Drawn<R> {
        let above = wo.z.positive();
        let share = self.share(self.coat.enters(wo.z));
        let coat = lobe.lt(share);
        let base = ggx::diffuse(u).0;
        let mirrored =
            if self.is_delta() { Triple::new(-wo.x, -wo.y, wo.z) } else { reflect(wo, self.ggx().sample(wo, u)) };
        let wi = Triple::select(coat, mirrored, base);
        let (value, pdf) = self.eval(wo, wi);
        let mut drawn =
            Drawn { wi, weight: value * (R::one() / pdf), pdf, valid: above & pdf.positive(), ..Drawn::nothing() };
        if self.is_delta() {
            let f = fresnel::dielectric(wo.z, self.coat.eta).r;
            drawn.weight = Triple::select(coat, Triple::all(f / share), drawn.weight);
            drawn.delta = coat & above;
            drawn.pdf = R::select(coat, R::zero(), drawn.pdf);
            drawn.valid = above & (coat | pdf.positive());
        }
        drawn
    }

    pub(crate) fn albedo(&self) -> Triple<R> {
        let enters: R = self.coat.enters(R::one());
        self.base * enters + Triple::all(R::one() - enters)
    }
}

#[cfg(test)]
#[path = "coated_tests.rs"]
mod tests;
