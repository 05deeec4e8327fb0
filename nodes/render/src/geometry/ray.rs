//! Rays, and origins that are safely off the surface they leave.

use super::gamma;
use glam::{DVec3, Vec3};

/// A ray; `direction` need not be of unit length, and distances are in units of it.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Where it begins.
    pub origin: Vec3,
    /// Where it goes.
    pub direction: Vec3,
    /// How far it goes.
    pub t_max: f32,
}

impl Ray {
    /// A ray without end.
    #[inline]
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction, t_max: f32::MAX }
    }

    /// The point at distance `t`.
    #[inline]
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + self.direction * t
    }
}

/// Rays by component.
pub(crate) struct Rays<const N: usize> {
    pub(crate) origin: [[f32; N]; 3],
    pub(crate) direction: [[f32; N]; 3],
}

impl<const N: usize> Rays<N> {
    #[inline(always)]
    pub(super) fn origin(&self, k: usize) -> DVec3 {
        let [x, y, z] = &self.origin;
        DVec3::new(f64::from(x[k]), f64::from(y[k]), f64::from(z[k]))
    }

    #[inline(always)]
    pub(super) fn direction(&self, k: usize) -> DVec3 {
        let [x, y, z] = &self.direction;
        DVec3::new(f64::from(x[k]), f64::from(y[k]), f64::from(z[k]))
    }
}

/// Values that traversal computes once per ray: reciprocal direction, and the permutation and shear that align it with
/// +z (Woop, Benthin, Wald 2013, *Watertight Ray/Triangle Intersection*).
#[derive(Clone, Copy, Debug)]
pub struct Walk {
    /// Origin.
    pub origin: Vec3,
    /// Direction.
    pub direction: Vec3,
    /// Finite reciprocal of the direction: a component of (almost) zero becomes a large finite number.
    pub inverse: Vec3,
    pub(crate) axes: [usize; 3],
    pub(crate) start: [f32; 3],
    pub(crate) shear: [f32; 3],
}

impl Walk {
    /// Prepares a ray. A direction of zero length meets nothing.
    #[inline]
    pub fn new(ray: &Ray) -> Self {
        let d = ray.direction.to_array();
        let size = ray.direction.abs();
        let kz = if size.x > size.y {
            if size.x > size.z { 0 } else { 2 }
        } else if size.y > size.z {
            1
        } else {
            2
        };
        let mut kx = (kz + 1) % 3;
        let mut ky = (kx + 1) % 3;
        // Keeps the winding of triangles.
        if d[kz] < 0.0 {
            std::mem::swap(&mut kx, &mut ky);
        }
        let o = ray.origin.to_array();
        let safe = |v: f32| if v.abs() > 1e-18 { 1.0 / v } else { 1e18f32.copysign(v) };
        Self {
            origin: ray.origin,
            direction: ray.direction,
            inverse: Vec3::new(safe(d[0]), safe(d[1]), safe(d[2])),
            axes: [kx, ky, kz],
            start: [o[kx], o[ky], o[kz]],
            shear: [d[kx] / d[kz], d[ky] / d[kz], 1.0 / d[kz]],
        }
    }
}

/// The origin of a ray that leaves a surface point `p`, known to within `error`, towards `towards`: moved along the
/// geometric normal just out of the error box, then rounded away from the surface.
#[inline]
pub fn offset_origin(p: Vec3, error: Vec3, normal: Vec3, towards: Vec3) -> Vec3 {
    let distance = normal.abs().dot(error) * (1.0 + gamma(4));
    let side = if towards.dot(normal) < 0.0 { -1.0 } else { 1.0 };
    let offset = normal * (distance * side);
    let moved = p + offset;
    // By more than half a unit in the last place, which is what the addition may have lost.
    let away = |at: f32, by: f32| if by == 0.0 { at } else { at + (at.abs() * f32::EPSILON).copysign(by) };
    Vec3::new(away(moved.x, offset.x), away(moved.y, offset.y), away(moved.z, offset.z))
}
