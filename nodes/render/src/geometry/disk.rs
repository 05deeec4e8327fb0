//! Disks (and ellipses, by uneven maps), intersected in f64.

use super::{Map, Rays, gamma};
use crate::lanes::{Pair, Real, atan2};
use glam::{DVec3, Vec2, Vec3};
use tauflow_data::maths;

/// A disk in the world: the points `center + a x + b y` with a^2 + b^2 <= 1.
#[derive(Clone, Copy, Debug)]
pub struct Disk {
    /// Centre.
    pub center: Vec3,
    /// World image of local x.
    pub x: Vec3,
    /// World image of local y.
    pub y: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Area.
    pub area: f64,
    dual_x: DVec3,
    dual_y: DVec3,
    plane: DVec3,
}

impl Disk {
    /// Places the unit disk; `None` if the map flattens it or is not finite.
    pub fn new(map: &Map) -> Option<Self> {
        let center = map.point(DVec3::ZERO);
        let [x, y, _] = map.columns();
        let (x, y) = (x.as_vec3(), y.as_vec3());
        let (dx, dy) = (x.as_dvec3(), y.as_dvec3());
        let cross = dx.cross(dy);
        let size = cross.length();
        if !(center.is_finite() && size.is_finite() && size > 1e-30) {
            return None;
        }
        let plane = cross / size;
        let outside = map.normal(DVec3::Z)?;
        let side = if outside.dot(plane) < 0.0 { -1.0 } else { 1.0 };
        Some(Self {
            center,
            x,
            y,
            normal: (plane * side).as_vec3(),
            area: std::f64::consts::PI * size,
            dual_x: dy.cross(plane) / size,
            dual_y: plane.cross(dx) / size,
            plane,
        })
    }

    /// Distances of many rays in (0, `t_max`], a and b of the hits, and which of them meet the disk.
    #[inline(always)]
    pub(crate) fn intersect_all<const N: usize>(&self, rays: &Rays<N>, t_max: &[f32; N]) -> ([[f32; N]; 3], [bool; N]) {
        let (mut found, mut met) = ([[0.0; N]; 3], [false; N]);
        for k in 0..N {
            let (o, d) = (rays.origin(k) - self.center.as_dvec3(), rays.direction(k));
            let t = -o.dot(self.plane) / d.dot(self.plane);
            let p = o + d * t;
            let (a, b) = (p.dot(self.dual_x), p.dot(self.dual_y));
            let short = t as f32;
            (found[0][k], found[1][k], found[2][k]) = (short, a as f32, b as f32);
            met[k] = (short > 0.0) & (short <= t_max[k]) & (a * a + b * b <= 1.0);
        }
        (found, met)
    }

    /// The point at a and b, with a bound on its error.
    #[inline]
    pub fn point(&self, a: f32, b: f32) -> (Vec3, Vec3) {
        let (x, y) = (self.x * a, self.y * b);
        (self.center + x + y, (self.center.abs() + x.abs() + y.abs()) * gamma(4))
    }

    /// Changes of the point along u and v at a and b.
    pub fn derivatives(&self, a: f32, b: f32) -> [Vec3; 2] {
        let r = (a * a + b * b).sqrt();
        let (cos, sin) = if r > 0.0 { (a / r, b / r) } else { (1.0, 0.0) };
        [self.x * cos + self.y * sin, (self.y * a - self.x * b) * std::f32::consts::TAU]
    }

    /// [`Disk::uv`] by lane.
    #[inline(always)]
    pub(crate) fn uv_lanes<R: Real>(a: R, b: R) -> Pair<R> {
        let turn = atan2(b, a) * (0.5 * std::f32::consts::FRAC_1_PI);
        Pair::new((a * a + b * b).sqrt(), R::select(turn.lt(R::zero()), turn + 1.0, turn))
    }

    /// Texture coordinates: radius, and angle over a turn.
    pub fn uv(a: f32, b: f32) -> Vec2 {
        let turn = maths::atan2f(b, a) * (0.5 * std::f32::consts::FRAC_1_PI);
        Vec2::new((a * a + b * b).sqrt(), if turn < 0.0 { turn + 1.0 } else { turn })
    }
}
