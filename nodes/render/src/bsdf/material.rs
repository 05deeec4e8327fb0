//! Materials: BSDFs with their textures, before a point on the surface is known.

mod layer;
mod relief;

pub(super) use layer::Layer;
use layer::{Finish, PrincipledTextures, Textured};
pub(crate) use relief::{Relief, ReliefOptions};

use super::{
    Bsdf, Diffuse, Surface,
    coated::{Coat, Plastic},
    glass::{Glass, Thin},
    metal::Metal,
    principled::{self, Principled},
};
use crate::{
    bounds,
    choices::Choices,
    lanes::{Real, Triple},
    texture::{LoadBitmap, Texture},
};
use tauflow_contract::KindError;
use tauflow_data::scene;

/// Textures of a layer at most.
pub(crate) const SLOTS: usize = 4;

/// Kernels by what they shade.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sort {
    Diffuse,
    Metal,
    Glass,
    Thin,
    Plastic,
    Principled,
    /// Several layers.
    Blend,
}

/// A material ready to render.
#[derive(Clone, Debug)]
pub struct Material {
    opacity: Option<Texture>,
    relief: Option<Relief>,
    two_sided: bool,
    /// One, or those of a blend.
    pub(super) layers: Vec<Layer>,
    /// Whether lights can be sampled for it.
    smooth: bool,
    /// Shaded by the kernel of blends whatever it is.
    general: bool,
}

fn bad(what: &str, value: f32, remedy: &str) -> KindError {
    KindError::Input(format!("a material's {what} is {value}; {remedy}"))
}

fn index(inside: f32, outside: f32) -> Result<f32, KindError> {
    let eta = inside / outside;
    if inside > 0.0 && outside > 0.0 && eta.is_finite() && (0.05..=20.0).contains(&eta) {
        Ok(eta)
    } else {
        Err(bad("relative index of refraction", eta, "use indices such as 1.5 inside and 1 outside"))
    }
}

fn roughness(alpha: f32) -> Result<f32, KindError> {
    if (0.0..=1.0).contains(&alpha) { Ok(alpha) } else { Err(bad("roughness alpha", alpha, "use 0 to 1")) }
}

impl Material {
    /// Compiles a BSDF and the textures it reads.
    ///
    /// # Errors
    /// If a number or a texture is out of range, an image is missing, or opacity or a normal map stands inside a blend.
    pub fn compile(bsdf: &scene::Bsdf, load: LoadBitmap<'_>) -> Result<Self, KindError> {
        let sort = match bsdf {
            scene::Bsdf::Diffuse { reflectance } => {
                Textured::Diffuse(bounds::colors(reflectance, "reflectance", load)?)
            }
            scene::Bsdf::Conductor { eta, k, alpha, specular_reflectance } => Textured::Conductor {
                eta: bounds::indices(*eta, "eta")?,
                k: bounds::indices(*k, "k")?,
                alpha: roughness(*alpha)?,
                tint: bounds::colors(specular_reflectance, "specular_reflectance", load)?,
            },
            scene::Bsdf::Dielectric { int_ior, ext_ior, alpha, specular_reflectance, specular_transmittance } => {
                Textured::Dielectric {
                    eta: index(*int_ior, *ext_ior)?,
                    alpha: roughness(*alpha)?,
                    reflectance: bounds::colors(specular_reflectance, "specular_reflectance", load)?,
                    transmittance: bounds::colors(specular_transmittance, "specular_transmittance", load)?,
                }
            }
            scene::Bsdf::ThinDielectric { int_ior, ext_ior, specular_reflectance, specular_transmittance } => {
                Textured::Thin {
                    eta: index(*int_ior, *ext_ior)?,
                    reflectance: bounds::colors(specular_reflectance, "specular_reflectance", load)?,
                    transmittance: bounds::colors(specular_transmittance, "specular_transmittance", load)?,
                }
            }
            scene::Bsdf::Plastic { diffuse_reflectance, int_ior, ext_ior, alpha } => Textured::Plastic {
                base: bounds::colors(diffuse_reflectance, "diffuse_reflectance", load)?,
                coat: Coat::new(index(*int_ior, *ext_ior)?, roughness(*alpha)?),
            },
            scene::Bsdf::Principled {
                base_color,
                metallic,
                roughness,
                specular,
                spec_trans,
                clearcoat,
                clearcoat_gloss,
            } => Textured::Principled(Box::new(PrincipledTextures {
                base: bounds::colors(base_color, "base_color", load)?,
                metallic: bounds::share(metallic, "metallic", load)?,
                roughness: bounds::share(roughness, "roughness", load)?,
                transmission: bounds::share(spec_trans, "spec_trans", load)?,
                eta: principled::index(bounds::level(*specular, "specular")?),
                clearcoat: bounds::level(*clearcoat, "clearcoat")?,
                clearcoat_gloss: bounds::level(*clearcoat_gloss, "clearcoat_gloss")?,
                choices: Choices::Fixed,
            })),
            scene::Bsdf::Mask { opacity, inner } => {
                let mut material = Self::compile(inner, load)?;
                let opacity = bounds::share(opacity, "opacity", load)?;
                material.opacity = Some(match material.opacity.take() {
                    Some(inner) => opacity.times(inner),
                    None => opacity,
                });
                return Ok(material);
            }
            scene::Bsdf::NormalMap { map, scale, inner } => {
                let material = Self::compile(inner, load)?;
                let map = bounds::normals(map, *scale, load)?;
                let relief = Some(Relief { map, scale: *scale, heights: false, options: None });
                return Ok(Self { relief, ..material });
            }
            scene::Bsdf::Relief { form, map, scale, flip, shadowing, inner } => {
                let material = Self::compile(inner, load)?;
                if material.relief.is_some() {
                    return Err(KindError::Input("a normal or bump map inside another one; keep one of them".into()));
                }
                let heights = *form == scene::ReliefForm::Heights;
                let map =
                    if heights { bounds::heights(map, *scale, load)? } else { bounds::normals(map, *scale, load)? };
                let options = Some(ReliefOptions { flip: *flip, shadowing: *shadowing, mirrored: false });
                return Ok(Self { relief: Some(Relief { map, scale: *scale, heights, options }), ..material });
            }
            scene::Bsdf::Finish { distribution, alpha, alpha_v, nonlinear, inner } => {
                let mut material = Self::compile(inner, load)?;
                let mut share = |alpha: &Option<scene::Texture>, name| {
                    alpha.as_ref().map(|alpha| bounds::share(alpha, name, load)).transpose()
                };
                let (alpha, across) = (share(alpha, "alpha")?, share(alpha_v, "alpha_v")?);
                let beckmann = *distribution == scene::Distribution::Beckmann;
                material.finish(Finish { beckmann, alpha, across }, *nonlinear)?;
                return Ok(Self::of(material.layers));
            }
            scene::Bsdf::TwoSided { inner } => {
                let mut material = Self::compile(inner, load)?;
                match &mut material.relief {
                    // Both sides of what is two-sided below the map are one already.
                    Some(Relief { options: Some(options), .. }) if !material.two_sided => options.mirrored = true,
                    _ => material.two_sided = true,
                }
                return Ok(material);
            }
            scene::Bsdf::Blend { weight, a, b } => {
                let (a, b) = (Self::compile(a, load)?, Self::compile(b, load)?);
                if [&a, &b].iter().any(|m| m.opacity.is_some() || m.relief.is_some()) {
                    return Err(KindError::Input(
                        "a blend of materials with opacity or a normal map of their own; put these around the blend"
                            .into(),
                    ));
                }
                let weight = bounds::share(weight, "weight", load)?;
                let mut layers = Vec::new();
                for (material, second) in [(b, true), (a, false)] {
                    layers.extend(material.layers.into_iter().map(|mut layer| {
                        layer.weights.push((weight.clone(), second));
                        layer.two_sided |= material.two_sided;
                        layer
                    }));
                }
                return Ok(Self::of(layers));
            }
        };
        Ok(Self::of(vec![Layer { weights: Vec::new(), two_sided: false, sort, finish: None }]))
    }

    /// Gives its only layer other microfacets.
    fn finish(&mut self, own: Finish, nonlinear: bool) -> Result<(), KindError> {
        let plain = !self.two_sided && self.opacity.is_none() && self.relief.is_none();
        let plain = plain && (own.alpha.is_some() || own.across.is_none());
        match self.layers.as_mut_slice() {
            [Layer { sort: Textured::Plastic { coat, .. }, .. }] if plain && own.alpha.is_none() => {
                *coat = coat.in_finish(own.beckmann, nonlinear);
            }
            [Layer { sort: Textured::Conductor { alpha, .. } | Textured::Dielectric { alpha, .. }, finish, .. }]
                if plain && !nonlinear =>
            {
                // What a texture says is never smooth.
                *alpha = if own.alpha.is_some() { 1.0 } else { *alpha };
                *finish = (own.beckmann || own.alpha.is_some()).then_some(own);
            }
            _ => {
                let what = "a finish around something other than a conductor, dielectric or plastic, or parameters \
                            that these lack; `alpha` fits conductors and dielectrics, `alpha_v` goes with `alpha`, \
                            and `nonlinear` fits plastic";
                return Err(KindError::Input(what.into()));
            }
        }
        Ok(())
    }

    fn of(layers: Vec<Layer>) -> Self {
        let smooth = layers.iter().any(Layer::smooth);
        Self { opacity: None, relief: None, two_sided: false, layers, smooth, general: false }
    }

    /// Whether lights can be sampled for it.
    #[inline]
    pub fn has_smooth(&self) -> bool {
        self.smooth
    }

    /// Whether it has a specular lobe.
    pub(crate) fn has_specular(&self) -> bool {
        self.layers.iter().any(Layer::specular)
    }

    /// Whether light may cross it by a lobe that lights can be sampled for.
    pub(crate) fn transmits(&self) -> bool {
        self.layers.iter().any(Layer::transmits)
    }

    /// Its scattering at a point.
    pub fn at(&self, s: &Surface) -> Bsdf<'_> {
        Bsdf { material: self, at: s.into() }
    }

    /// Whether it is the same from both sides.
    #[inline(always)]
    pub(crate) fn is_two_sided(&self) -> bool {
        self.two_sided || (self.layers.len() == 1 && self.layers[0].two_sided)
    }

    /// Chooses the lobes of its `principled` layers in this way.
    pub(crate) fn set_choices(&mut self, choices: Choices) {
        self.layers.iter_mut().for_each(|layer| layer.set_choices(choices));
    }

    /// Leaves it to the kernel that shades everything.
    pub(crate) fn make_general(&mut self) {
        self.general = true;
    }

    /// Which kernel shades it.
    pub(crate) fn kernel(&self) -> Sort {
        if self.general { Sort::Blend } else { self.sort() }
    }

    /// Its type.
    pub(crate) fn sort(&self) -> Sort {
        match self.layers.as_slice() {
            [one] => match &one.sort {
                Textured::Diffuse(_) => Sort::Diffuse,
                Textured::Conductor { .. } => Sort::Metal,
                Textured::Dielectric { .. } => Sort::Glass,
                Textured::Thin { .. } => Sort::Thin,
                Textured::Plastic { .. } => Sort::Plastic,
                Textured::Principled(_) => Sort::Principled,
            },
            _ => Sort::Blend,
        }
    }

    /// The textures of a single layer, by slot.
    pub(crate) fn slots(&self) -> [Option<&Texture>; SLOTS] {
        self.layers[0].slots()
    }

    #[inline(always)]
    pub(super) fn diffuse<R: Real>(&self, values: &[Triple<R>; SLOTS]) -> Option<Diffuse<R>> {
        self.layers[0].diffuse(values)
    }

    #[inline(always)]
    pub(super) fn metal<R: Real>(&self, values: &[Triple<R>; SLOTS]) -> Option<Metal<R>> {
        self.layers[0].metal(values)
    }

    #[inline(always)]
    pub(super) fn glass<R: Real>(&self, values: &[Triple<R>; SLOTS]) -> Option<Glass<R>> {
        self.layers[0].glass(values)
    }

    #[inline(always)]
    pub(super) fn thin<R: Real>(&self, values: &[Triple<R>; SLOTS]) -> Option<Thin<R>> {
        self.layers[0].thin(values)
    }

    #[inline(always)]
    pub(super) fn plastic<R: Real>(&self, values: &[Triple<R>; SLOTS]) -> Option<Plastic<'_, R>> {
        self.layers[0].plastic(values)
    }

    #[inline(always)]
    pub(super) fn principled<R: Real>(&self, values: &[Triple<R>; SLOTS]) -> Option<Principled<R>> {
        self.layers[0].principled(values)
    }

    /// Whether it reads texture coordinates.
    pub(crate) fn reads_uv(&self) -> bool {
        self.opacity.iter().any(Texture::reads_uv)
            || self.relief.is_some()
            || self.layers.iter().any(|layer| layer.textures().any(Texture::reads_uv))
    }

    /// Whether it reads vertex colours.
    pub(crate) fn reads_colors(&self) -> bool {
        self.opacity.iter().any(Texture::reads_colors)
            || self.layers.iter().any(|layer| layer.textures().any(Texture::reads_colors))
    }

    /// Opacity at a point, 1 where it is opaque.
    #[inline]
    pub fn opacity(&self, s: &Surface) -> f32 {
        self.opacity.as_ref().map_or(1.0, |texture| texture.scalar(s).clamp(0.0, 1.0))
    }

    /// The source of its opacity, if it is not opaque.
    pub(crate) fn opacity_texture(&self) -> Option<&Texture> {
        self.opacity.as_ref()
    }

    /// Whether rays may pass somewhere.
    pub fn has_opacity(&self) -> bool {
        self.opacity.is_some()
    }

    /// Whether it has a normal map or a bump map.
    pub fn has_normal_map(&self) -> bool {
        self.relief.is_some()
    }

    /// Its normal map or bump map.
    #[inline]
    pub(crate) fn relief(&self) -> Option<&Relief> {
        self.relief.as_ref()
    }

    /// The options of its normal map or bump map, if that has some.
    #[inline]
    pub(crate) fn relief_options(&self) -> Option<ReliefOptions> {
        self.relief.as_ref()?.options
    }

    /// Whether it is two-sided around a map with options: its back is the mirror image of its front.
    #[inline]
    pub(crate) fn is_mirrored(&self) -> bool {
        self.relief_options().is_some_and(|options| options.mirrored)
    }

    /// Whether its shading frame takes more than the surface's shading normal.
    #[inline]
    pub(crate) fn has_own_frame(&self) -> bool {
        self.has_normal_map() || self.is_anisotropic()
    }

    /// Whether its roughness depends on the direction.
    #[inline]
    pub(crate) fn is_anisotropic(&self) -> bool {
        self.layers.iter().any(|layer| layer.finish.as_ref().is_some_and(|finish| finish.across.is_some()))
    }
}
