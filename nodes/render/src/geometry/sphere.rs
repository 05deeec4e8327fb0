//! Spheres, intersected in f64.

use super::{Map, Rays, gamma};
use crate::lanes::{Pair, Real, Triple, acos, atan2};
use glam::{DVec3, Vec2, Vec3};
use tauflow_data::maths;

/// A sphere in the world.
#[derive(Clone, Copy, Debug)]
pub struct Sphere {
    /// Centre.
    pub center: Vec3,
    /// Radius, above 0.
    pub radius: f32,
    /// Unit world directions of the local axes, for uv.
    pub axes: [Vec3; 3],
}

impl Sphere {
    /// Places a local sphere.
    ///
    /// # Errors
    /// What is wrong, if the map scales unevenly or shears, or the radius is not positive and finite.
    pub fn new(center: [f64; 3], radius: f64, map: &Map) -> Result<Self, String> {
        let columns = map.columns();
        let scale = columns[0].length();
        let even = columns.iter().all(|c| (c.length() - scale).abs() <= 1e-5 * scale)
            && columns[0].dot(columns[1]).abs() <= 1e-5 * scale * scale
            && columns[1].dot(columns[2]).abs() <= 1e-5 * scale * scale
            && columns[2].dot(columns[0]).abs() <= 1e-5 * scale * scale;
        if !even {
            return Err("a sphere's `to_world` may only move, rotate and scale evenly; use a mesh instead".into());
        }
        let radius = (radius * scale) as f32;
        let center = map.point(DVec3::from_array(center));
        if !(radius.is_finite() && radius > 0.0 && center.is_finite()) {
            return Err(format!("a sphere of radius {radius} at {center}; both must be finite, the radius above 0"));
        }
        Ok(Self { center, radius, axes: columns.map(|c| (c / scale).as_vec3()) })
    }

    /// Distances of many rays in (0, `t_max`], and which of them meet the sphere.
    #[inline(always)]
    pub(crate) fn intersect_all<const N: usize>(
        center: Vec3,
        radius: f32,
        rays: &Rays<N>,
        t_max: &[f32; N],
    ) -> ([f32; N], [bool; N]) {
        let (mut t, mut met) = ([0.0; N], [false; N]);
        // No branch, for the compiler to do several at once.
        for k in 0..N {
            let (o, d) = (rays.origin(k) - center.as_dvec3(), rays.direction(k));
            let a = d.dot(d);
            let b = o.dot(d);
            // The discriminant from the point of closest approach, which does not cancel (Haines et al. 2019).
            let nearest = o - d * (b / a);
            let r = f64::from(radius);
            let discriminant = r * r - nearest.dot(nearest);
            let root = (discriminant * a).sqrt();
            let q = if b > 0.0 { -b - root } else { -b + root };
            let c = o.dot(o) - r * r;
            let t0 = if q == 0.0 { 0.0 } else { q / a };
            let t1 = if q == 0.0 { 0.0 } else { c / q };
            let (near, far) = if t0 < t1 { (t0 as f32, t1 as f32) } else { (t1 as f32, t0 as f32) };
            t[k] = if near > 0.0 { near } else { far };
            met[k] = (discriminant >= 0.0) & (a > 0.0) & (t[k] > 0.0) & (t[k] <= t_max[k]);
        }
        (t, met)
    }

    /// A point near the sphere moved onto it, its outward normal, and a bound on the point's error.
    #[inline]
    pub fn project(&self, p: Vec3) -> (Vec3, Vec3, Vec3) {
        let n = (p - self.center).normalize_or(Vec3::Z);
        let arm = n * self.radius;
        let error = arm.abs() * gamma(6) + (self.center.abs() + arm.abs()) * gamma(2);
        (self.center + arm, n, error)
    }

    /// Texture coordinates of an outward normal: azimuth and polar angle about local z, both over their range.
    pub fn uv(&self, n: Vec3) -> Vec2 {
        let [x, y, z] = self.axes.map(|axis| axis.dot(n));
        let turn = maths::atan2f(y, x) * (0.5 * std::f32::consts::FRAC_1_PI);
        let u = if turn < 0.0 { turn + 1.0 } else { turn };
        Vec2::new(u, maths::acosf(z.clamp(-1.0, 1.0)) * std::f32::consts::FRAC_1_PI)
    }

    /// [`Sphere::uv`] by lane.
    #[inline(always)]
    pub(crate) fn uv_lanes<R: Real>(&self, n: Triple<R>) -> Pair<R> {
        let [x, y, z] = self.axes;
        let (x, y, z) = (n.dot(Triple::splat(x)), n.dot(Triple::splat(y)), n.dot(Triple::splat(z)));
        let turn = atan2(y, x) * (0.5 * std::f32::consts::FRAC_1_PI);
        Pair::new(R::select(turn.lt(R::zero()), turn + 1.0, turn), acos(z) * std::f32::consts::FRAC_1_PI)
    }

    /// Direction of growing u at an outward normal, not of unit length.
    pub fn dp_du(&self, n: Vec3) -> Vec3 {
        let [x, y] = [self.axes[0].dot(n), self.axes[1].dot(n)];
        self.axes[1] * x - self.axes[0] * y
    }

    /// Changes of the point along u and v at an outward normal.
    pub fn derivatives(&self, n: Vec3) -> [Vec3; 2] {
        let [x, y, z] = self.axes.map(|axis| axis.dot(n));
        let ring = (x * x + y * y).sqrt();
        let out = if ring > 0.0 { (self.axes[0] * x + self.axes[1] * y) / ring } else { self.axes[0] };
        let turn = self.dp_du(n) * (std::f32::consts::TAU * self.radius);
        [turn, (out * z - self.axes[2] * ring) * (std::f32::consts::PI * self.radius)]
    }
}
