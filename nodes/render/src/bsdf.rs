//! BSDFs of surfaces: Mitsuba 3's BSDFs of the same names, isotropic.
//!
//! Directions are unit vectors in the shading frame, z along the shading normal, both pointing away from the surface:
//! `wo` towards where the path comes from, `wi` towards where it goes on. Values are for radiance, so that what crosses
//! an interface is scaled by the squared relative index. A lobe of roughness alpha below [`DELTA_ALPHA`] is specular:
//! it has no density, and only [`Bsdf::sample`] finds it.

mod blend;
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

use crate::lanes::{Mask, Pair, Real, Triple};
pub(crate) use blend::Blend;
pub(crate) use coated::Plastic;
pub(crate) use ggx::Interface;
use glam::{Vec2, Vec3, Vec4};
pub(crate) use glass::{Glass, Thin};
pub(crate) use local::flip;
pub use material::Material;
pub(crate) use material::{Relief, ReliefOptions, SLOTS, Sort};
pub(crate) use metal::Metal;
pub(crate) use principled::Principled;
pub use tauflow_data::scene::DELTA_ALPHA;

/// The coordinates for texture look-ups.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Texture coordinates, v downwards.
    pub uv: Vec2,
    /// Vertex colour; one without any.
    pub color: Vec4,
}

/// The coordinates for texture look-ups, by lane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Points<R> {
    /// Texture coordinates, v downwards.
    pub uv: Pair<R>,
    /// Vertex colour.
    pub color: Triple<R>,
    /// Its alpha.
    pub alpha: R,
}

impl From<&Surface> for Points<f32> {
    #[inline(always)]
    fn from(s: &Surface) -> Self {
        Self { uv: s.uv.into(), color: s.color.truncate().into(), alpha: s.color.w }
    }
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

/// Scattered directions by lane; see [`Sample`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Drawn<R: Real> {
    pub(crate) wi: Triple<R>,
    pub(crate) weight: Triple<R>,
    pub(crate) pdf: R,
    pub(crate) eta: R,
    pub(crate) delta: R::Mask,
    pub(crate) transmitted: R::Mask,
    /// Lanes where there is one; the others absorb the path.
    pub(crate) valid: R::Mask,
}

impl<R: Real> Drawn<R> {
    #[inline(always)]
    fn nothing() -> Self {
        let none = R::Mask::from_bits(0);
        Self {
            wi: Triple::zero(),
            weight: Triple::zero(),
            pdf: R::zero(),
            eta: R::one(),
            delta: none,
            transmitted: none,
            valid: none,
        }
    }
}

/// The scattering of a lobe, by lane.
pub(crate) trait Scatter<'a, R: Real>: Sized {
    /// The lobe of a material at points, given the values of its first layer's textures there.
    fn of(material: &'a Material, values: &[Triple<R>; SLOTS], at: &Points<R>) -> Option<Self>;
    /// f |cos wi|, and the density of a draw over solid angle; specular lobes left out.
    fn eval(&self, wo: Triple<R>, wi: Triple<R>) -> (Triple<R>, R);
    /// Draws directions; `lobe` picks the lobe and `u` the direction.
    fn sample(&self, wo: Triple<R>, lobe: R, u: Pair<R>) -> Drawn<R>;
}

/// Lambert's law.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Diffuse<R>(pub(super) Triple<R>);

impl<R: Real> Diffuse<R> {
    #[inline(always)]
    fn eval(&self, wo: Triple<R>, wi: Triple<R>) -> (Triple<R>, R) {
        let cos = (wi.z / std::f32::consts::PI).only(wo.z.positive() & wi.z.positive());
        (self.0 * cos, cos)
    }

    #[inline(always)]
    fn sample(&self, wo: Triple<R>, _: R, u: Pair<R>) -> Drawn<R> {
        let (wi, pdf) = ggx::diffuse(u);
        Drawn { wi, weight: self.0, pdf, valid: wo.z.positive(), ..Drawn::nothing() }
    }
}

macro_rules! scatter {
    ($name:ident, $type:ty) => {
        impl<'a, R: Real> Scatter<'a, R> for $type {
            #[inline(always)]
            fn of(material: &'a Material, values: &[Triple<R>; SLOTS], _: &Points<R>) -> Option<Self> {
                material.$name(values)
            }
            #[inline(always)]
            fn eval(&self, wo: Triple<R>, wi: Triple<R>) -> (Triple<R>, R) {
                self.eval(wo, wi)
            }
            #[inline(always)]
            fn sample(&self, wo: Triple<R>, lobe: R, u: Pair<R>) -> Drawn<R> {
                self.sample(wo, lobe, u)
            }
        }
    };
}

scatter!(diffuse, Diffuse<R>);
scatter!(metal, Metal<R>);
scatter!(glass, Glass<R>);
scatter!(thin, Thin<R>);
scatter!(plastic, Plastic<'a, R>);
scatter!(principled, Principled<R>);

/// A material's scattering at one point: any lobe, or a blend of several.
#[derive(Clone, Copy, Debug)]
pub struct Bsdf<'a> {
    material: &'a Material,
    at: Points<f32>,
}

/// Both directions turned to the front in the lanes where `wo` is behind.
#[inline(always)]
pub(crate) fn to_front<R: Real>(wo: Triple<R>, wi: Triple<R>) -> (Triple<R>, Triple<R>) {
    let behind = wo.z.lt(R::zero());
    (flip(wo, behind), flip(wi, behind))
}

/// Drops draws of no density.
#[inline(always)]
pub(crate) fn sound<R: Real>(mut drawn: Drawn<R>) -> Drawn<R> {
    drawn.valid = drawn.valid & (drawn.delta | (drawn.pdf.positive() & drawn.pdf.finite()));
    drawn
}

impl Bsdf<'_> {
    fn blend(&self) -> Blend<'_> {
        Blend::at(self.material, &self.at)
    }

    /// Both directions, turned to the front if the material is the same from both sides.
    fn turned(&self, wo: Vec3, wi: Vec3) -> (Triple<f32>, Triple<f32>) {
        if self.material.is_two_sided() { to_front(wo.into(), wi.into()) } else { (wo.into(), wi.into()) }
    }

    /// f |cos wi|, specular lobes left out.
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Vec3 {
        let (wo, wi) = self.turned(wo, wi);
        self.blend().eval(wo, wi).0.into()
    }

    /// Density of [`Bsdf::sample`] over solid angle, specular lobes left out.
    pub fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        let (wo, wi) = self.turned(wo, wi);
        self.blend().eval(wo, wi).1
    }

    /// Draws a direction; `lobe` picks the lobe and `u` the direction. None absorbs the path.
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        let behind = self.material.is_two_sided() && wo.z < 0.0;
        let drawn = sound(self.blend().sample(flip(wo.into(), behind), lobe, u.into()));
        let Drawn { wi, weight, pdf, eta, delta, transmitted, valid } = drawn;
        valid.then(|| Sample { wi: flip(wi, behind).into(), weight: weight.into(), pdf, delta, transmitted, eta })
    }

    /// Share of white light that comes back, roughly: a feature for denoisers. Values that approximations put outside
    /// of 0 to 1 are clamped; NaN is kept, so that readers can refuse it.
    pub fn albedo(&self) -> Vec3 {
        Vec3::from_array(Vec3::from(self.blend().albedo()).to_array().map(|v| v.clamp(0.0, 1.0)))
    }
}
