//! A lobe of a material with its textures, and its share in a blend.

use super::SLOTS;
use crate::{
    bsdf::{
        DELTA_ALPHA, Diffuse, Points,
        blend::Lobe,
        coated::{Coat, Plastic},
        ggx::Facets,
        glass::{Glass, Thin},
        metal::Metal,
        principled::Principled,
    },
    choices::Choices,
    lanes::{Real, Triple},
    texture::Texture,
};
use glam::Vec3;

/// A lobe and its share in a blend.
#[derive(Clone, Debug)]
pub(in crate::bsdf) struct Layer {
    /// Its share is the product of these weights, or of one minus them where it is the first of two.
    pub(super) weights: Vec<(Texture, bool)>,
    pub(in crate::bsdf) two_sided: bool,
    pub(super) sort: Textured,
    pub(super) finish: Option<Finish>,
}

/// The microfacets of metal or glass, if they are not GGX of one roughness.
#[derive(Clone, Debug)]
pub(super) struct Finish {
    pub(super) beckmann: bool,
    pub(super) alpha: Option<Texture>,
    /// Roughness across; `alpha` is then that along the direction of growing u.
    pub(super) across: Option<Texture>,
}

#[derive(Clone, Debug)]
pub(super) enum Textured {
    Diffuse(Texture),
    Conductor { eta: Vec3, k: Vec3, alpha: f32, tint: Texture },
    Dielectric { eta: f32, alpha: f32, reflectance: Texture, transmittance: Texture },
    Thin { eta: f32, reflectance: Texture, transmittance: Texture },
    Plastic { base: Texture, coat: Coat },
    Principled(Box<PrincipledTextures>),
}

#[derive(Clone, Debug)]
pub(super) struct PrincipledTextures {
    pub(super) base: Texture,
    pub(super) metallic: Texture,
    pub(super) roughness: Texture,
    pub(super) transmission: Texture,
    pub(super) eta: f32,
    pub(super) clearcoat: f32,
    pub(super) clearcoat_gloss: f32,
    pub(super) choices: Choices,
}

impl PrincipledTextures {
    /// Whether light may cross anywhere.
    fn clear(&self) -> bool {
        !matches!(&self.transmission, Texture::Constant(v) if v.x <= 0.0)
    }
}

/// Cuts what rounding, of a product or between texels, has put beyond 1: compiling refuses what is beyond by more.
#[inline(always)]
fn unit<R: Real>(v: Triple<R>) -> Triple<R> {
    Triple::new(v.x.clamp(0.0, 1.0), v.y.clamp(0.0, 1.0), v.z.clamp(0.0, 1.0))
}

impl Layer {
    pub(super) fn smooth(&self) -> bool {
        let delta = |alpha: f32| alpha < DELTA_ALPHA;
        let white = [Triple::all(1.0f32); SLOTS];
        match &self.sort {
            Textured::Diffuse(_) | Textured::Plastic { .. } | Textured::Principled(_) => true,
            Textured::Conductor { alpha, .. } => !delta(*alpha),
            Textured::Dielectric { .. } => self.glass(&white).is_some_and(|glass| !glass.is_delta()),
            Textured::Thin { .. } => false,
        }
    }

    /// Whether it has a specular lobe.
    pub(super) fn specular(&self) -> bool {
        match &self.sort {
            Textured::Plastic { coat, .. } => coat.alpha < DELTA_ALPHA,
            Textured::Diffuse(_) | Textured::Principled(_) => false,
            Textured::Conductor { .. } | Textured::Dielectric { .. } | Textured::Thin { .. } => !self.smooth(),
        }
    }

    /// Whether light may cross it by a lobe that has a density.
    pub(super) fn transmits(&self) -> bool {
        match &self.sort {
            Textured::Dielectric { .. } => self.smooth(),
            Textured::Principled(of) => of.clear(),
            Textured::Diffuse(_) | Textured::Conductor { .. } | Textured::Thin { .. } | Textured::Plastic { .. } => {
                false
            }
        }
    }

    /// Textures by slot: what the lobes below find their values by.
    pub(super) fn slots(&self) -> [Option<&Texture>; SLOTS] {
        let alpha = self.finish.as_ref().and_then(|finish| finish.alpha.as_ref());
        let across = self.finish.as_ref().and_then(|finish| finish.across.as_ref());
        match &self.sort {
            Textured::Diffuse(t) | Textured::Plastic { base: t, .. } => [Some(t), None, None, None],
            Textured::Conductor { tint, .. } => [Some(tint), None, alpha, across],
            Textured::Dielectric { reflectance, transmittance, .. } => {
                [Some(reflectance), Some(transmittance), alpha, across]
            }
            Textured::Thin { reflectance, transmittance, .. } => [Some(reflectance), Some(transmittance), None, None],
            Textured::Principled(of) => {
                [Some(&of.base), Some(&of.metallic), Some(&of.roughness), Some(&of.transmission)]
            }
        }
    }

    pub(super) fn textures(&self) -> impl Iterator<Item = &Texture> {
        self.weights.iter().map(|w| &w.0).chain(self.slots().into_iter().flatten())
    }

    pub(super) fn set_choices(&mut self, choices: Choices) {
        if let Textured::Principled(of) = &mut self.sort {
            of.choices = choices;
        }
    }

    /// Its share of the blend.
    pub(in crate::bsdf) fn weight(&self, at: &Points<f32>) -> f32 {
        self.weights.iter().fold(1.0, |share, (texture, second)| {
            let weight = texture.at(at).x.clamp(0.0, 1.0);
            share * if *second { weight } else { 1.0 - weight }
        })
    }

    /// The microfacets of a finish, whose roughness is in the last two of these values or, without textures, `alpha`.
    #[inline(always)]
    fn facets<R: Real>(&self, alpha: f32, values: &[Triple<R>; SLOTS]) -> Option<Facets<R>> {
        let Finish { beckmann, alpha: along, across } = self.finish.as_ref()?;
        let read = |slot: usize| values[slot].x.clamp(DELTA_ALPHA, 1.0);
        let along = if along.is_some() { read(SLOTS - 2) } else { R::splat(alpha) };
        let across = if across.is_some() { read(SLOTS - 1) } else { along };
        Some(Facets { alpha: [along, across], beckmann: *beckmann })
    }

    #[inline(always)]
    pub(super) fn diffuse<R: Real>(&self, values: &[Triple<R>; SLOTS]) -> Option<Diffuse<R>> {
        let Textured::Diffuse(_) = &self.sort else { return None };
        Some(Diffuse(unit(values[0])))
    }

    #[inline(always)]
    pub(super) fn metal<R: Real>(&self, values: &[Triple<R>; SLOTS]) -> Option<Metal<R>> {
        let Textured::Conductor { eta, k, alpha, .. } = &self.sort else { return None };
        let finish = self.facets(*alpha, values);
        Some(Metal { eta: *eta, k: *k, alpha: *alpha, tint: unit(values[0]), finish })
    }

    #[inline(always)]
    pub(super) fn glass<R: Real>(&self, values: &[Triple<R>; SLOTS]) -> Option<Glass<R>> {
        let Textured::Dielectric { eta, alpha, .. } = &self.sort else { return None };
        let (reflectance, transmittance) = (unit(values[0]), unit(values[1]));
        Some(Glass { eta: *eta, alpha: *alpha, reflectance, transmittance, finish: self.facets(*alpha, values) })
    }

    #[inline(always)]
    pub(super) fn thin<R: Real>(&self, values: &[Triple<R>; SLOTS]) -> Option<Thin<R>> {
        let Textured::Thin { eta, .. } = &self.sort else { return None };
        Some(Thin { eta: *eta, reflectance: unit(values[0]), transmittance: unit(values[1]) })
    }

    #[inline(always)]
    pub(super) fn plastic<R: Real>(&self, values: &[Triple<R>; SLOTS]) -> Option<Plastic<'_, R>> {
        let Textured::Plastic { coat, .. } = &self.sort else { return None };
        Some(Plastic { base: unit(values[0]), coat })
    }

    #[inline(always)]
    pub(super) fn principled<R: Real>(&self, values: &[Triple<R>; SLOTS]) -> Option<Principled<R>> {
        let Textured::Principled(of) = &self.sort else { return None };
        Some(Principled {
            base: unit(values[0]),
            metallic: values[1].x.clamp(0.0, 1.0),
            roughness: values[2].x.clamp(0.0, 1.0),
            transmission: values[3].x.clamp(0.0, 1.0),
            clearcoat: of.clearcoat,
            clearcoat_gloss: of.clearcoat_gloss,
            eta: of.eta,
            clear: of.clear(),
            choices: of.choices,
        })
    }

    /// Its scattering at a point.
    pub(in crate::bsdf) fn lobe(&self, at: &Points<f32>) -> Lobe<'_> {
        let values = self.slots().map(|slot| slot.map_or(Triple::zero(), |texture| texture.at(at)));
        None.or_else(|| self.diffuse(&values).map(Lobe::Diffuse))
            .or_else(|| self.metal(&values).map(Lobe::Metal))
            .or_else(|| self.glass(&values).map(Lobe::Glass))
            .or_else(|| self.thin(&values).map(Lobe::Thin))
            .or_else(|| self.plastic(&values).map(Lobe::Plastic))
            .or_else(|| self.principled(&values).map(Lobe::Principled))
            .unwrap_or(Lobe::Diffuse(Diffuse(Triple::zero())))
    }
}
