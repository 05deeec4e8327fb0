//! Rays, and what they meet: triangles, spheres, disks; each hit with a bound on its rounding error.
//!
//! Knows no material, light or acceleration structure. Error bounds follow Pharr, Jakob, Humphreys, *Physically Based
//! Rendering*, 4th edition, section 6.8.

mod affine;
mod disk;
mod forms;
mod ray;
mod sphere;
mod triangle;

pub use affine::Map;
pub use disk::Disk;
pub use forms::{cube, rectangle};
pub(crate) use ray::Rays;
pub use ray::{Ray, Walk, offset_origin};
pub use sphere::Sphere;
pub use triangle::{Candidate, area_normal, intersect_triangle};
pub(crate) use triangle::{EIGHT, FOUR, Triangles, intersect_lanes, seen_from};

use crate::lanes::{Real, Triple};
use glam::Vec3;

/// Bound on the relative error of `n` rounded f32 operations in a row.
pub const fn gamma(n: u32) -> f32 {
    let unit = f32::EPSILON * 0.5;
    let n = n as f32;
    (n * unit) / (1.0 - n * unit)
}

/// An orthonormal frame about a unit vector (Duff et al. 2017, *Building an Orthonormal Basis, Revisited*).
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// First tangent.
    pub s: Vec3,
    /// Second tangent.
    pub t: Vec3,
    /// The vector it stands on.
    pub n: Vec3,
}

impl Frame {
    /// The frame about `n`, of unit length.
    #[inline]
    pub fn new(n: Vec3) -> Self {
        let sign = if n.z >= 0.0 { 1.0 } else { -1.0 };
        let a = -1.0 / (sign + n.z);
        let b = n.x * n.y * a;
        Self {
            s: Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
            t: Vec3::new(b, sign + n.y * n.y * a, -n.y),
            n,
        }
    }

    /// World direction into the frame.
    #[inline]
    pub fn to_local(&self, v: Vec3) -> Vec3 {
        Vec3::new(v.dot(self.s), v.dot(self.t), v.dot(self.n))
    }

    /// Direction of the frame into the world.
    #[inline]
    pub fn to_world(&self, v: Vec3) -> Vec3 {
        self.s * v.x + self.t * v.y + self.n * v.z
    }
}

impl Frame {
    /// The frame about `n`, of unit length, whose first tangent is as near to `along` as can be.
    pub fn along(n: Vec3, along: Vec3) -> Self {
        let s = along - n * n.dot(along);
        if !(s.length_squared() > 1e-20 && s.is_finite()) {
            return Self::new(n);
        }
        let s = s.normalize();
        Self { s, t: n.cross(s), n }
    }
}

/// [`Frame`] by lane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frames<R> {
    s: Triple<R>,
    t: Triple<R>,
    n: Triple<R>,
}

impl<R: Real> Frames<R> {
    /// The frames about unit vectors.
    #[inline(always)]
    pub(crate) fn new(n: Triple<R>) -> Self {
        let sign = R::select(n.z.ge(R::zero()), R::one(), -R::one());
        let a = -R::one() / (sign + n.z);
        let b = n.x * n.y * a;
        Self {
            s: Triple::new(sign * n.x * n.x * a + 1.0, sign * b, -sign * n.x),
            t: Triple::new(b, sign + n.y * n.y * a, -n.y),
            n,
        }
    }

    /// The frames of these vectors.
    #[inline(always)]
    pub(crate) fn of(s: Triple<R>, t: Triple<R>, n: Triple<R>) -> Self {
        Self { s, t, n }
    }

    /// The frames about unit vectors with these first tangents.
    #[inline(always)]
    pub(crate) fn with(n: Triple<R>, s: Triple<R>) -> Self {
        Self { s, t: n.cross(s), n }
    }

    /// World directions into the frames.
    #[inline(always)]
    pub(crate) fn to_local(self, v: Triple<R>) -> Triple<R> {
        Triple::new(v.dot(self.s), v.dot(self.t), v.dot(self.n))
    }

    /// Directions of the frames into the world.
    #[inline(always)]
    pub(crate) fn to_world(self, v: Triple<R>) -> Triple<R> {
        self.s * v.x + self.t * v.y + self.n * v.z
    }
}

/// [`offset_origin`] by lane.
#[inline(always)]
pub(crate) fn offset_origins<R: Real>(
    p: Triple<R>,
    error: Triple<R>,
    normal: Triple<R>,
    towards: Triple<R>,
) -> Triple<R> {
    let distance = normal.abs().dot(error) * (1.0 + gamma(4));
    let behind = towards.dot(normal).lt(R::zero());
    let offset = normal * R::select(behind, -distance, distance);
    let moved = p + offset;
    Triple::new(away(moved.x, offset.x), away(moved.y, offset.y), away(moved.z, offset.z))
}

#[inline(always)]
fn away<R: Real>(at: R, by: R) -> R {
    R::select(by.equals(R::zero()), at, at + (at.abs() * f32::EPSILON).copysign(by))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::rng::Stream;

    #[test]
    fn frames_are_orthonormal() {
        let mut stream = Stream::new(1, &[]);
        let mut draw = || stream.range(-1.0, 1.0) as f32;
        let mut normals: Vec<Vec3> = (0..1000).map(|_| Vec3::new(draw(), draw(), draw()).normalize()).collect();
        normals.extend([Vec3::Z, -Vec3::Z, Vec3::X, -Vec3::Y, Vec3::new(1e-8, 0.0, -1.0)]);
        for n in normals {
            let frame = Frame::new(n);
            assert!(frame.s.dot(frame.t).abs() < 1e-6 && frame.s.dot(n).abs() < 1e-6 && frame.t.dot(n).abs() < 1e-6);
            assert!((frame.s.length() - 1.0).abs() < 1e-6 && (frame.t.length() - 1.0).abs() < 1e-6);
            assert!((frame.s.cross(frame.t) - n).length() < 1e-6);
            let v = Vec3::new(0.3, -0.7, 0.2);
            assert!((frame.to_world(frame.to_local(v)) - v).length() < 1e-6);
        }
    }
}
