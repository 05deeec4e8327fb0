//! Disney's BSDF as Mitsuba 3's `principled` has it, isotropic, without sheen, flatness and tints.
//!
//! Source: Burley 2012 and 2015. Its value is Mitsuba's; how directions are drawn is our own.

use super::{
    Sample, fresnel,
    ggx::{self, Ggx, Gtr1},
    local::{reflect, refract},
};
use glam::{Vec2, Vec3};

const PI: f32 = std::f32::consts::PI;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Principled {
    pub(crate) base: Vec3,
    pub(crate) metallic: f32,
    pub(crate) roughness: f32,
    pub(crate) transmission: f32,
    pub(crate) clearcoat: f32,
    pub(crate) clearcoat_gloss: f32,
    /// Index of refraction inside.
    pub(crate) eta: f32,
}

/// The facet between two directions.
struct Facet {
    m: Vec3,
    o: f32,
    i: f32,
    eta: f32,
    reflected: bool,
    fits: bool,
}

/// Probabilities of the lobes.
struct Shares {
    reflect: f32,
    transmit: f32,
    coat: f32,
    diffuse: f32,
}

impl Principled {
    /// Index of refraction of a specular level; a level of 0 counts as 0.001, as in Mitsuba, for an index of 1 would leave
    /// transmission without half vectors.
    pub(crate) fn index(specular: f32) -> f32 {
        2.0 / (1.0 - (0.08 * specular.clamp(1e-3, 1.0)).sqrt()) - 1.0
    }

    #[inline]
    fn ggx(&self) -> Ggx {
        Ggx { alpha: (self.roughness * self.roughness).max(0.001) }
    }

    #[inline]
    fn coat(&self) -> Gtr1 {
        Gtr1 { alpha: 0.1 + (0.001 - 0.1) * self.clearcoat_gloss }
    }

    /// Weights of the opaque and the transmitting base.
    #[inline]
    fn bases(&self) -> (f32, f32) {
        let dielectric = 1.0 - self.metallic;
        (dielectric * (1.0 - self.transmission), dielectric * self.transmission)
    }

    #[inline]
    fn facet(&self, wo: Vec3, wi: Vec3) -> Facet {
        let reflected = wo.z * wi.z > 0.0;
        let eta = if wo.z > 0.0 { self.eta } else { 1.0 / self.eta };
        let m = (wo + wi * if reflected { 1.0 } else { eta }).normalize_or_zero();
        let m = if m.z < 0.0 { -m } else { m };
        let (o, i) = (wo.dot(m), wi.dot(m));
        let fits = wo.z * wi.z != 0.0 && o * wo.z > 0.0 && i * wi.z > 0.0;
        Facet { m, o, i, eta, reflected, fits }
    }

    #[inline]
    fn shares(&self, front: bool, f: f32) -> Shares {
        let (opaque, clear) = self.bases();
        let mut shares = if front {
            Shares {
                reflect: 1.0 - clear * (1.0 - f),
                transmit: clear * (1.0 - f),
                coat: 0.25 * self.clearcoat,
                diffuse: opaque * self.base.max_element().clamp(0.1, 1.0),
            }
        } else {
            Shares { reflect: clear * f, transmit: clear * (1.0 - f), coat: 0.0, diffuse: 0.0 }
        };
        let sum = shares.reflect + shares.transmit + shares.coat + shares.diffuse;
        let scale = if sum > 0.0 { 1.0 / sum } else { 0.0 };
        for share in [&mut shares.reflect, &mut shares.transmit, &mut shares.coat, &mut shares.diffuse] {
            *share *= scale;
        }
        shares
    }

    #[inline]
    pub(crate) fn eval(&self, wo: Vec3, wi: Vec3) -> Vec3 {
        let facet = self.facet(wo, wi);
        let front = wo.z > 0.0;
        let (opaque, clear) = self.bases();
        let ggx = self.ggx();
        let mut value = Vec3::ZERO;
        if facet.fits {
            let f = fresnel::dielectric(facet.o, self.eta).r;
            let shape = ggx.d(facet.m) * ggx.g(wo, wi, facet.m);
            if facet.reflected {
                let reflected = if front {
                    let metal = fresnel::schlick(self.base, facet.o, self.eta);
                    Vec3::splat((1.0 - self.metallic) * f) + self.metallic * metal
                } else {
                    Vec3::splat(clear * f)
                };
                value += reflected * (shape / (4.0 * wo.z.abs()));
                if front && self.clearcoat > 0.0 {
                    let coat = fresnel::schlick(Vec3::splat(0.04), facet.o, self.eta).x;
                    let smith = Ggx { alpha: 0.25 }.g(wo, wi, facet.m);
                    value += 0.25 * self.clearcoat * coat * self.coat().d(facet.m) * smith * wi.z.abs();
                }
            } else if clear > 0.0 {
                let sum = facet.o + facet.eta * facet.i;
                let amount = clear * (1.0 - f) * shape * (facet.o * facet.i / (wo.z * sum * sum)).abs();
                value += self.base.max(Vec3::ZERO).map(f32::sqrt) * amount;
            }
        }
        if front && wi.z > 0.0 && opaque > 0.0 {
            let (fo, fi) = (fresnel::schlick_weight(wi.z), fresnel::schlick_weight(wo.z));
            let retro = 2.0 * self.roughness * facet.i * facet.i;
            let back = retro * (fo + fi + fo * fi * (retro - 1.0));
            let shape = (1.0 - 0.5 * fi) * (1.0 - 0.5 * fo) + back;
            value += self.base * (opaque * wi.z / PI * shape);
        }
        value
    }

    #[inline]
    pub(crate) fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        let facet = self.facet(wo, wi);
        let front = wo.z > 0.0;
        let upper = if front { wo } else { -wo };
        let mut pdf = 0.0;
        // The lobe is chosen after the facet, so that its Fresnel term weighs the choice; the diffuse lobe and the coat
        // are chosen by the term at the normal.
        let fixed = self.shares(front, fresnel::dielectric(wo.z, self.eta).r);
        let specular = fixed.reflect + fixed.transmit;
        if facet.fits && specular > 0.0 {
            let f = fresnel::dielectric(facet.o, self.eta).r;
            let at = self.shares(front, f);
            let reflected = at.reflect / (at.reflect + at.transmit).max(f32::MIN_POSITIVE);
            let density = self.ggx().pdf(upper, facet.m) * specular;
            if facet.reflected {
                let spread = 1.0 / (4.0 * facet.i.abs());
                pdf += density * reflected * spread + fixed.coat * self.coat().pdf(facet.m) * spread;
            } else {
                let sum = facet.o + facet.eta * facet.i;
                pdf += density * (1.0 - reflected) * (facet.eta * facet.eta * facet.i / (sum * sum)).abs();
            }
        }
        if front && wi.z > 0.0 {
            pdf += fixed.diffuse * wi.z / PI;
        }
        pdf
    }

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        if wo.z == 0.0 {
            return None;
        }
        let front = wo.z > 0.0;
        let fixed = self.shares(front, fresnel::dielectric(wo.z, self.eta).r);
        let specular = fixed.reflect + fixed.transmit;
        let (mut transmitted, mut eta) = (false, 1.0);
        let wi = if lobe < fixed.diffuse {
            ggx::diffuse(u).0
        } else if lobe < fixed.diffuse + fixed.coat {
            reflect(wo, self.coat().sample(u))
        } else {
            if specular <= 0.0 {
                return None;
            }
            let lobe = ((lobe - fixed.diffuse - fixed.coat) / specular).clamp(0.0, 1.0 - f32::EPSILON);
            let m = self.ggx().sample(if front { wo } else { -wo }, u);
            let cos = wo.dot(m);
            let f = fresnel::dielectric(cos, self.eta);
            let at = self.shares(front, f.r);
            transmitted = lobe >= at.reflect / (at.reflect + at.transmit).max(f32::MIN_POSITIVE);
            if transmitted {
                eta = f.eta_it;
                refract(wo, m, f.cos_t, f.eta_ti)
            } else {
                reflect(wo, m)
            }
        };
        if wi.z == 0.0 || (wi.z * wo.z < 0.0) != transmitted {
            return None;
        }
        let pdf = self.pdf(wo, wi);
        if pdf <= 0.0 {
            return None;
        }
        Some(Sample { wi, weight: self.eval(wo, wi) / pdf, pdf, delta: false, transmitted, eta })
    }

    pub(crate) fn albedo(&self) -> Vec3 {
        self.base
    }
}
