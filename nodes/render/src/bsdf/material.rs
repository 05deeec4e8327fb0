//! Materials: BSDFs with their textures, before a point on the surface is known.

use super::{
    Bsdf, Lobes, Surface,
    coated::{Coat, Plastic},
    glass::{Glass, Thin},
    metal::Metal,
    principled::Principled,
};
use crate::texture::{LoadBitmap, Texture};
use glam::Vec3;
use tauflow_contract::KindError;
use tauflow_data::scene;

/// A material ready to render.
#[derive(Clone, Debug)]
pub struct Material {
    opacity: Option<Texture>,
    normal_map: Option<(Texture, f32)>,
    two_sided: bool,
    sort: Sort,
}

#[derive(Clone, Debug)]
enum Sort {
    Diffuse(Texture),
    Conductor { eta: Vec3, k: Vec3, alpha: f32, tint: Texture },
    Dielectric { eta: f32, alpha: f32, reflectance: Texture, transmittance: Texture },
    Thin { eta: f32, reflectance: Texture, transmittance: Texture },
    Plastic { base: Texture, coat: Coat },
    Principled(Box<PrincipledTextures>),
    Blend { weight: Texture, materials: Box<(Material, Material)> },
}

#[derive(Clone, Debug)]
struct PrincipledTextures {
    base: Texture,
    metallic: Texture,
    roughness: Texture,
    transmission: Texture,
    eta: f32,
    clearcoat: f32,
    clearcoat_gloss: f32,
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
    /// If a number is out of range, an image is missing, or opacity or a normal map stands inside a blend.
    pub fn compile(bsdf: &scene::Bsdf, load: LoadBitmap<'_>) -> Result<Self, KindError> {
        let sort = match bsdf {
            scene::Bsdf::Diffuse { reflectance } => Sort::Diffuse(Texture::compile(reflectance, load)?),
            scene::Bsdf::Conductor { eta, k, alpha, specular_reflectance } => Sort::Conductor {
                eta: Vec3::from_array(*eta),
                k: Vec3::from_array(*k),
                alpha: roughness(*alpha)?,
                tint: Texture::compile(specular_reflectance, load)?,
            },
            scene::Bsdf::Dielectric { int_ior, ext_ior, alpha, specular_reflectance, specular_transmittance } => {
                Sort::Dielectric {
                    eta: index(*int_ior, *ext_ior)?,
                    alpha: roughness(*alpha)?,
                    reflectance: Texture::compile(specular_reflectance, load)?,
                    transmittance: Texture::compile(specular_transmittance, load)?,
                }
            }
            scene::Bsdf::ThinDielectric { int_ior, ext_ior, specular_reflectance, specular_transmittance } => {
                Sort::Thin {
                    eta: index(*int_ior, *ext_ior)?,
                    reflectance: Texture::compile(specular_reflectance, load)?,
                    transmittance: Texture::compile(specular_transmittance, load)?,
                }
            }
            scene::Bsdf::Plastic { diffuse_reflectance, int_ior, ext_ior, alpha } => Sort::Plastic {
                base: Texture::compile(diffuse_reflectance, load)?,
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
            } => Sort::Principled(Box::new(PrincipledTextures {
                base: Texture::compile(base_color, load)?,
                metallic: Texture::compile(metallic, load)?,
                roughness: Texture::compile(roughness, load)?,
                transmission: Texture::compile(spec_trans, load)?,
                eta: Principled::index(*specular),
                clearcoat: clearcoat.clamp(0.0, 1.0),
                clearcoat_gloss: clearcoat_gloss.clamp(0.0, 1.0),
            })),
            scene::Bsdf::Mask { opacity, inner } => {
                let mut material = Self::compile(inner, load)?;
                let opacity = Texture::compile(opacity, load)?;
                material.opacity = Some(match material.opacity.take() {
                    Some(inner) => Texture::Product(Box::new((opacity, inner))),
                    None => opacity,
                });
                return Ok(material);
            }
            scene::Bsdf::NormalMap { map, scale, inner } => {
                let material = Self::compile(inner, load)?;
                return Ok(Self { normal_map: Some((Texture::compile(map, load)?, *scale)), ..material });
            }
            scene::Bsdf::TwoSided { inner } => return Ok(Self { two_sided: true, ..Self::compile(inner, load)? }),
            scene::Bsdf::Blend { weight, a, b } => {
                let (a, b) = (Self::compile(a, load)?, Self::compile(b, load)?);
                if [&a, &b].iter().any(|m| m.opacity.is_some() || m.normal_map.is_some()) {
                    return Err(KindError::Input(
                        "a blend of materials with opacity or a normal map of their own; put these around the blend"
                            .into(),
                    ));
                }
                Sort::Blend { weight: Texture::compile(weight, load)?, materials: Box::new((a, b)) }
            }
        };
        Ok(Self { opacity: None, normal_map: None, two_sided: false, sort })
    }

    /// Its scattering at a point.
    #[inline]
    pub fn at(&self, s: &Surface) -> Bsdf<'_> {
        let unit = |texture: &Texture| texture.eval(s).clamp(Vec3::ZERO, Vec3::ONE);
        let share = |texture: &Texture| texture.scalar(s).clamp(0.0, 1.0);
        let lobes = match &self.sort {
            Sort::Diffuse(albedo) => Lobes::Diffuse(unit(albedo)),
            Sort::Conductor { eta, k, alpha, tint } => {
                Lobes::Metal(Metal { eta: *eta, k: *k, alpha: *alpha, tint: unit(tint) })
            }
            Sort::Dielectric { eta, alpha, reflectance, transmittance } => Lobes::Glass(Glass {
                eta: *eta,
                alpha: *alpha,
                reflectance: unit(reflectance),
                transmittance: unit(transmittance),
            }),
            Sort::Thin { eta, reflectance, transmittance } => {
                Lobes::Thin(Thin { eta: *eta, reflectance: unit(reflectance), transmittance: unit(transmittance) })
            }
            Sort::Plastic { base, coat } => Lobes::Plastic(Plastic { base: unit(base), coat }),
            Sort::Principled(of) => Lobes::Principled(Principled {
                base: unit(&of.base),
                metallic: share(&of.metallic),
                roughness: share(&of.roughness),
                transmission: share(&of.transmission),
                clearcoat: of.clearcoat,
                clearcoat_gloss: of.clearcoat_gloss,
                eta: of.eta,
            }),
            Sort::Blend { weight, materials } => Lobes::Blend { weight: share(weight), materials, at: *s },
        };
        Bsdf { two_sided: self.two_sided, lobes }
    }

    /// Opacity at a point, 1 where it is opaque.
    #[inline]
    pub fn opacity(&self, s: &Surface) -> f32 {
        self.opacity.as_ref().map_or(1.0, |texture| texture.scalar(s).clamp(0.0, 1.0))
    }

    /// Whether rays may pass somewhere.
    pub fn has_opacity(&self) -> bool {
        self.opacity.is_some()
    }

    /// Whether it has a normal map.
    pub fn has_normal_map(&self) -> bool {
        self.normal_map.is_some()
    }

    /// The normal of the normal map in its tangent frame, above the surface; none without a map.
    #[inline]
    pub fn shading_normal(&self, s: &Surface) -> Option<Vec3> {
        let (map, scale) = self.normal_map.as_ref()?;
        let n = map.eval(s) * 2.0 - Vec3::ONE;
        // A map may point below the surface where it was compressed badly.
        Some(Vec3::new(n.x * scale, n.y * scale, n.z.max(1e-3)).normalize_or(Vec3::Z))
    }
}
