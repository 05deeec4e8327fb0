//! Directions in the shading frame, z along the normal.

use glam::{Vec2, Vec3};
use tauflow_data::maths::{cosf, sinf};

const PI: f32 = std::f32::consts::PI;

/// Sine and cosine of a share of a turn.
#[inline]
pub(crate) fn cosines(turn: f32) -> (f32, f32) {
    let angle = 2.0 * PI * turn;
    (sinf(angle), cosf(angle))
}

/// `v` mirrored about `m`.
#[inline]
pub(crate) fn reflect(v: Vec3, m: Vec3) -> Vec3 {
    m * (2.0 * v.dot(m)) - v
}

/// `v` refracted at a facet of normal `m`; cosine and index as [`super::fresnel::dielectric`] gives them.
#[inline]
pub(crate) fn refract(v: Vec3, m: Vec3, cos_t: f32, eta_ti: f32) -> Vec3 {
    m * (v.dot(m) * eta_ti + cos_t) - v * eta_ti
}

/// A cosine-weighted direction above the surface.
#[inline]
pub(crate) fn cosine_hemisphere(u: Vec2) -> Vec3 {
    let r = u.x.sqrt();
    let (sin, cos) = cosines(u.y);
    // At u.x = 1 - 2^-24 this is still above 0.
    Vec3::new(r * cos, r * sin, (1.0 - u.x).max(0.0).sqrt())
}

/// The same direction on the other side of the surface.
#[inline]
pub(crate) fn flip(v: Vec3) -> Vec3 {
    Vec3::new(v.x, v.y, -v.z)
}
