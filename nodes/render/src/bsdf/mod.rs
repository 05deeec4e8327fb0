//! What surfaces do to light: Mitsuba 3's BSDFs of the same names, isotropic.
//!
//! Directions are unit vectors in the shading frame, z along the shading normal, both pointing away from the surface:
//! `wo` towards where the path comes from, `wi` towards where it goes on. Values are for radiance, so that what crosses
//! an interface is scaled by the squared relative index. A lobe of roughness alpha below [`DELTA_ALPHA`] is specular: it
//! has no density, and only [`Bsdf::sample`] finds it.

mod coated;
mod fresnel;
mod ggx;
mod glass;
mod local;
mod material;
mod metal;
mod principled;
#[cfg(test)]
mod tests;

use coated::Plastic;
use glam::{Vec2, Vec3, Vec4};
use glass::{Glass, Thin};
use local::flip;
pub use material::Material;
use metal::Metal;
use principled::Principled;
pub use tauflow_data::scene::DELTA_ALPHA;

/// What textures are read by.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Texture coordinates, v downwards.
    pub uv: Vec2,
    /// Vertex colour; one without any.
    pub color: Vec4,
}

/// A scattered direction.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Where it goes.
    pub wi: Vec3,
    /// f |cos| / density.
    pub weight: Vec3,
    /// Density over solid angle; 0 for specular lobes.
    pub pdf: f32,
    /// Whether it is of a specular lobe.
    pub delta: bool,
    /// Whether it crosses the surface.
    pub transmitted: bool,
    /// Relative index of refraction that it crosses, 1 for reflection.
    pub eta: f32,
}

/// A material's scattering at one point.
#[derive(Clone, Copy, Debug)]
pub struct Bsdf<'a> {
    two_sided: bool,
    lobes: Lobes<'a>,
}

#[derive(Clone, Copy, Debug)]
enum Lobes<'a> {
    Diffuse(Vec3),
    Metal(Metal),
    Glass(Glass),
    Thin(Thin),
    Plastic(Plastic<'a>),
    Principled(Principled),
    Blend { weight: f32, materials: &'a (Material, Material), at: Surface },
}

impl Bsdf<'_> {
    /// f |cos wi|, specular lobes left out.
    #[inline]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Vec3 {
        let (wo, wi) = if self.two_sided && wo.z < 0.0 { (flip(wo), flip(wi)) } else { (wo, wi) };
        match &self.lobes {
            Lobes::Diffuse(albedo) => {
                if wo.z > 0.0 && wi.z > 0.0 {
                    *albedo * (wi.z / std::f32::consts::PI)
                } else {
                    Vec3::ZERO
                }
            }
            Lobes::Metal(metal) => metal.eval(wo, wi),
            Lobes::Glass(glass) => glass.eval(wo, wi),
            Lobes::Thin(_) => Vec3::ZERO,
            Lobes::Plastic(plastic) => plastic.eval(wo, wi),
            Lobes::Principled(principled) => principled.eval(wo, wi),
            Lobes::Blend { weight, materials, at } => {
                let (a, b) = (materials.0.at(at).eval(wo, wi), materials.1.at(at).eval(wo, wi));
                a * (1.0 - weight) + b * *weight
            }
        }
    }

    /// Density of [`Bsdf::sample`] over solid angle, specular lobes left out.
    #[inline]
    pub fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        let (wo, wi) = if self.two_sided && wo.z < 0.0 { (flip(wo), flip(wi)) } else { (wo, wi) };
        match &self.lobes {
            Lobes::Diffuse(_) => {
                if wo.z > 0.0 && wi.z > 0.0 {
                    wi.z / std::f32::consts::PI
                } else {
                    0.0
                }
            }
            Lobes::Metal(metal) => metal.pdf(wo, wi),
            Lobes::Glass(glass) => glass.pdf(wo, wi),
            Lobes::Thin(_) => 0.0,
            Lobes::Plastic(plastic) => plastic.pdf(wo, wi),
            Lobes::Principled(principled) => principled.pdf(wo, wi),
            Lobes::Blend { weight, materials, at } => {
                let (a, b) = (materials.0.at(at).pdf(wo, wi), materials.1.at(at).pdf(wo, wi));
                a * (1.0 - weight) + b * *weight
            }
        }
    }

    /// Draws a direction; `lobe` picks the lobe and `u` the direction. None absorbs the path.
    #[inline]
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        let turned = self.two_sided && wo.z < 0.0;
        let wo = if turned { flip(wo) } else { wo };
        let mut sample = match &self.lobes {
            Lobes::Diffuse(albedo) => {
                if wo.z <= 0.0 {
                    return None;
                }
                let (wi, pdf) = ggx::diffuse(u);
                Sample { wi, weight: *albedo, pdf, delta: false, transmitted: false, eta: 1.0 }
            }
            Lobes::Metal(metal) => metal.sample(wo, u)?,
            Lobes::Glass(glass) => glass.sample(wo, lobe, u)?,
            Lobes::Thin(thin) => thin.sample(wo, lobe)?,
            Lobes::Plastic(plastic) => plastic.sample(wo, lobe, u)?,
            Lobes::Principled(principled) => principled.sample(wo, lobe, u)?,
            Lobes::Blend { weight, materials, at } => {
                let second = lobe < *weight;
                let share = if second { *weight } else { 1.0 - weight };
                // What is left of the number, spread over [0, 1) again.
                let lobe = if second { lobe / share } else { (lobe - weight) / share };
                let chosen = if second { &materials.1 } else { &materials.0 };
                let mut sample = chosen.at(at).sample(wo, lobe.min(1.0 - f32::EPSILON), u)?;
                if !sample.delta {
                    let both = Bsdf { two_sided: false, lobes: self.lobes };
                    sample.pdf = both.pdf(wo, sample.wi);
                    sample.weight = both.eval(wo, sample.wi) / sample.pdf;
                }
                sample
            }
        };
        if turned {
            sample.wi = flip(sample.wi);
        }
        (sample.delta || (sample.pdf > 0.0 && sample.pdf.is_finite())).then_some(sample)
    }

    /// Share of white light that comes back, roughly: a feature for denoisers.
    pub fn albedo(&self) -> Vec3 {
        match &self.lobes {
            Lobes::Diffuse(albedo) => *albedo,
            Lobes::Metal(metal) => metal.albedo(),
            Lobes::Glass(glass) => glass.albedo(),
            Lobes::Thin(thin) => thin.albedo(),
            Lobes::Plastic(plastic) => plastic.albedo(),
            Lobes::Principled(principled) => principled.albedo(),
            Lobes::Blend { weight, materials, at } => {
                materials.0.at(at).albedo() * (1.0 - weight) + materials.1.at(at).albedo() * *weight
            }
        }
        .clamp(Vec3::ZERO, Vec3::ONE)
    }

    /// Whether lights can be sampled for it.
    #[inline]
    pub fn has_smooth(&self) -> bool {
        match &self.lobes {
            Lobes::Diffuse(_) | Lobes::Plastic(_) | Lobes::Principled(_) => true,
            Lobes::Metal(metal) => !metal.is_delta(),
            Lobes::Glass(glass) => !glass.is_delta(),
            Lobes::Thin(_) => false,
            Lobes::Blend { materials, at, .. } => materials.0.at(at).has_smooth() || materials.1.at(at).has_smooth(),
        }
    }
}
