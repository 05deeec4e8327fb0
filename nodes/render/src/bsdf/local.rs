//! Directions in the shading frame, z along the normal.

use crate::lanes::{Pair, Real, Triple, sin_cos_turn};

/// `v` mirrored about `m`.
#[inline(always)]
pub(crate) fn reflect<R: Real>(v: Triple<R>, m: Triple<R>) -> Triple<R> {
    m * (v.dot(m) * 2.0) - v
}

/// `v` refracted at a facet of normal `m`; cosine and index as [`super::fresnel::dielectric`] gives them.
#[inline(always)]
pub(crate) fn refract<R: Real>(v: Triple<R>, m: Triple<R>, cos_t: R, eta_ti: R) -> Triple<R> {
    m * (v.dot(m) * eta_ti + cos_t) - v * eta_ti
}

/// A cosine-weighted direction above the surface.
#[inline(always)]
pub(crate) fn cosine_hemisphere<R: Real>(u: Pair<R>) -> Triple<R> {
    let r = u.x.sqrt();
    let (sin, cos) = sin_cos_turn(u.y);
    // At u.x = 1 - 2^-24 this is still above 0.
    Triple::new(r * cos, r * sin, (R::one() - u.x).max(R::zero()).sqrt())
}

/// The same direction on the other side of the surface, in the lanes of a mask.
#[inline(always)]
pub(crate) fn flip<R: Real>(v: Triple<R>, mask: R::Mask) -> Triple<R> {
    Triple::new(v.x, v.y, R::select(mask, -v.z, v.z))
}
