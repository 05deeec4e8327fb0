//! Disney's BSDF as Mitsuba 3's `principled` has it, isotropic, without sheen, flatness and tints.
//!
//! Source: Burley 2012 and 2015. Its value is Mitsuba's; how directions are drawn is our own.

use super::{
    Drawn, fresnel,
    ggx::{self, Ggx, Gtr1},
    glass::facet,
    local::{reflect, refract},
};
use crate::{
    choices::Choices,
    lanes::{Mask, Pair, Real, Triple},
};

const PI: f32 = std::f32::consts::PI;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Principled<R> {
    pub(crate) base: Triple<R>,
    pub(crate) metallic: R,
    pub(crate) roughness: R,
    pub(crate) transmission: R,
    pub(crate) clearcoat: f32,
    pub(crate) clearcoat_gloss: f32,
    /// Index of refraction inside.
    pub(crate) eta: f32,
    /// Whether light may cross anywhere: what cannot, is not worked out.
    pub(crate) clear: bool,
    pub(crate) choices: Choices,
}

/// Share of the highlight at least, before the shares are scaled to a sum of 1.
const LEAST_HIGHLIGHT: f32 = 0.05;

/// Reflectance of the coat where light falls on it straight.
const COAT: f32 = 0.04;

/// Probabilities of the lobes.
struct Shares<R> {
    reflect: R,
    transmit: R,
    coat: R,
    diffuse: R,
}

/// Index of refraction of a specular level; a level of 0 counts as 0.001, as in Mitsuba, for an index of 1 would leave
/// transmission without half vectors. Levels above 1 are refused before.
pub(crate) fn index(specular: f32) -> f32 {
    2.0 / (1.0 - (0.08 * specular.max(1e-3)).sqrt()) - 1.0
}

#[inline(always)]
fn root<R: Real>(v: R) -> R {
    v.max(R::zero()).sqrt()
}

impl<R: Real> Principled<R> {
    #[inline(always)]
    fn ggx(&self) -> Ggx<R> {
        Ggx { alpha: (self.roughness * self.roughness).max(R::splat(0.001)) }
    }

    #[inline(always)]
    fn coat(&self) -> Gtr1 {
        Gtr1 { alpha: 0.1 + (0.001 - 0.1) * self.clearcoat_gloss }
    }

    /// Weights of the opaque and the transmitting base.
    #[inline(always)]
    fn bases(&self) -> (R, R) {
        let dielectric = R::one() - self.metallic;
        (dielectric * (R::one() - self.transmission), dielectric * self.transmission)
    }

    #[inline(always)]
    fn shares(&self, front: R::Mask, f: R) -> Shares<R> {
        let (opaque, clear) = self.bases();
        let one = R::one();
        let transmit = clear * (one - f);
        let (outside, coat) = match self.choices {
            Choices::Fixed => (one - transmit, R::splat(0.25 * self.clearcoat)),
            Choices::Adapted => {
                // A metal reflects about its colour.
                let metal = self.metallic * self.base.largest();
                let highlight = (one - self.metallic) * f + metal;
                (highlight.max(R::splat(LEAST_HIGHLIGHT)), f.max(R::splat(COAT)) * (0.25 * self.clearcoat))
            }
        };
        let reflect = R::select(front, outside, clear * f);
        let coat = coat.only(front);
        let diffuse = (opaque * self.base.largest().clamp(0.1, 1.0)).only(front);
        let sum = reflect + transmit + coat + diffuse;
        let scale = (one / sum).only(sum.positive());
        Shares { reflect: reflect * scale, transmit: transmit * scale, coat: coat * scale, diffuse: diffuse * scale }
    }

    /// Value and density.
    #[inline(always)]
    pub(crate) fn eval(&self, wo: Triple<R>, wi: Triple<R>) -> (Triple<R>, R) {
        let one = R::one();
        let front = wo.z.positive();
        let (opaque, clear) = self.bases();
        let ggx = self.ggx();
        let facet = facet(self.eta, wo, wi);
        let f = fresnel::dielectric(facet.o, self.eta).r;
        let (d, seen) = (ggx.d(facet.m), ggx.g1(wo, facet.m));
        let shape = d * seen * ggx.g1(wi, facet.m);
        let reflected = facet.fits & facet.reflected;
        let crossed = facet.fits & !facet.reflected;
        let metal = fresnel::schlick(self.base, facet.o, self.eta);
        let outer = Triple::all((one - self.metallic) * f) + metal * self.metallic;
        let specular = Triple::select(front, outer, Triple::all(clear * f));
        let mut value = (specular * (shape / (wo.z.abs() * 4.0))).only(reflected);
        // The lobe is chosen after the facet, so that its Fresnel term weighs the choice; the diffuse lobe and the coat
        // are chosen by the term at the normal.
        let fixed = self.shares(front, fresnel::dielectric(wo.z, self.eta).r);
        let at = self.shares(front, f);
        let kept = at.reflect / (at.reflect + at.transmit).max(R::splat(f32::MIN_POSITIVE));
        let chosen = fixed.reflect + fixed.transmit;
        let density = (d * seen * facet.o.abs() / wo.z.abs() * chosen).only(facet.fits & chosen.positive());
        let spread = R::splat(0.25) / facet.i.abs();
        let mut pdf = (density * kept * spread).only(reflected);
        if self.clearcoat > 0.0 {
            let coat = fresnel::schlick(Triple::all(R::splat(COAT)), facet.o, self.eta).x;
            let smith = Ggx { alpha: R::splat(0.25) }.g(wo, wi, facet.m);
            let gtr = self.coat().d(facet.m);
            let amount = coat * (0.25 * self.clearcoat) * gtr * smith * wi.z.abs();
            let shown = reflected & front;
            value += Triple::all(amount.only(shown));
            pdf += (fixed.coat * self.coat().pdf(facet.m) * spread).only(reflected & chosen.positive());
        }
        if self.clear {
            let sum = facet.o + facet.eta * facet.i;
            let amount = clear * (one - f) * shape * (facet.o * facet.i / (wo.z * sum * sum)).abs();
            value += (Triple::new(root(self.base.x), root(self.base.y), root(self.base.z)) * amount)
                .only(crossed & clear.positive());
            let across = density * (one - kept) * (facet.eta * facet.eta * facet.i / (sum * sum)).abs();
            pdf += across.only(crossed);
        }
        let above = front & wi.z.positive();
        let (fo, fi) = (fresnel::schlick_weight(wi.z), fresnel::schlick_weight(wo.z));
        let retro = self.roughness * 2.0 * facet.i * facet.i;
        let back = retro * (fo + fi + fo * fi * (retro - 1.0));
        let lambert = (one - fi * 0.5) * (one - fo * 0.5) + back;
        value += (self.base * (opaque * wi.z / PI * lambert)).only(above & opaque.positive());
        pdf += (fixed.diffuse * wi.z / PI).only(above);
        (value, pdf)
    }

    #[inline(always)]
    pub(crate) fn sample(&self, wo: Triple<R>, lobe: R, u: Pair<R>) -> Drawn<R> {
        let (zero, one) = (R::zero(), R::one());
        let front = wo.z.positive();
        let fixed = self.shares(front, fresnel::dielectric(wo.z, self.eta).r);
        let specular = fixed.reflect + fixed.transmit;
        let diffuse = lobe.lt(fixed.diffuse);
        let coat = !diffuse & lobe.lt(fixed.diffuse + fixed.coat);
        let mut wi = ggx::diffuse(u).0;
        if self.clearcoat > 0.0 {
            wi = Triple::select(coat, reflect(wo, self.coat().sample(u)), wi);
        }
        let chosen = !(diffuse | coat);
        let rest = ((lobe - fixed.diffuse - fixed.coat) / specular).clamp(0.0, 1.0 - f32::EPSILON);
        let m = self.ggx().sample(Triple::select(front, wo, -wo), u);
        let f = fresnel::dielectric(wo.dot(m), self.eta);
        let mut transmitted = R::Mask::from_bits(0);
        let mut faceted = reflect(wo, m);
        if self.clear {
            let at = self.shares(front, f.r);
            let kept = at.reflect / (at.reflect + at.transmit).max(R::splat(f32::MIN_POSITIVE));
            transmitted = chosen & rest.ge(kept);
            faceted = Triple::select(transmitted, refract(wo, m, f.cos_t, f.eta_ti), faceted);
        }
        let wi = Triple::select(chosen, faceted, wi);
        let (value, pdf) = self.eval(wo, wi);
        let across = (wi.z * wo.z).lt(zero);
        let fits = (across & transmitted) | !(across | transmitted);
        let valid = fits & pdf.positive() & !(wo.z.equals(zero) | wi.z.equals(zero)) & (!chosen | specular.positive());
        Drawn {
            wi,
            weight: value * (one / pdf),
            pdf,
            eta: R::select(transmitted, f.eta_it, one),
            transmitted,
            valid,
            ..Drawn::nothing()
        }
    }

    pub(crate) fn albedo(&self) -> Triple<R> {
        self.base
    }
}
