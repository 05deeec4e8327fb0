//! Watertight triangles: a ray at a shared edge or vertex meets one of its triangles, whatever the rounding.
//!
//! Woop, Benthin, Wald 2013, with the f64 fallback on edges and the distance error of pbrt-v4, section 6.8.7.

use super::{Walk, gamma};
use crate::lanes::{Mask, Real, Triple};
use glam::{DVec3, Vec3};

/// A possible hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Distance along the ray.
    pub t: f32,
    /// Barycentric weight of the second vertex, or a form's own first coordinate.
    pub u: f32,
    /// Barycentric weight of the third vertex, or a form's own second coordinate.
    pub v: f32,
}

/// Meets a triangle at a distance in (0, `t_max`], from either side. The fourth component of a vertex is not read.
#[inline]
pub fn intersect_triangle(walk: &Walk, vertices: &[[f32; 4]; 3], t_max: f32) -> Option<Candidate> {
    // The mask tells the compiler that an axis is within the four components.
    let [kx, ky, kz] = walk.axes.map(|k| k & 3);
    let [sx, sy, sz] = walk.shear;
    let [ox, oy, oz] = walk.start;
    let [a, b, c] = vertices;
    let (az, bz, cz) = (a[kz] - oz, b[kz] - oz, c[kz] - oz);
    let (ax, ay) = ((a[kx] - ox) - sx * az, (a[ky] - oy) - sy * az);
    let (bx, by) = ((b[kx] - ox) - sx * bz, (b[ky] - oy) - sy * bz);
    let (cx, cy) = ((c[kx] - ox) - sx * cz, (c[ky] - oy) - sy * cz);
    let mut u = cx * by - cy * bx;
    let mut v = ax * cy - ay * cx;
    let mut w = bx * ay - by * ax;
    if u == 0.0 || v == 0.0 || w == 0.0 {
        let cross =
            |px: f32, qy: f32, py: f32, qx: f32| (f64::from(px) * f64::from(qy) - f64::from(py) * f64::from(qx)) as f32;
        u = cross(cx, by, cy, bx);
        v = cross(ax, cy, ay, cx);
        w = cross(bx, ay, by, ax);
    }
    if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
        return None;
    }
    let det = u + v + w;
    if det == 0.0 {
        return None;
    }
    let (az, bz, cz) = (az * sz, bz * sz, cz * sz);
    let scaled = u * az + v * bz + w * cz;
    let inverse = 1.0 / det;
    let t = scaled * inverse;
    // Written so that a NaN, as from a direction of zero length, is a miss.
    if !(t > 0.0 && t <= t_max) {
        return None;
    }
    // A distance within its own rounding error is behind the origin for all that is known.
    let max3 = |p: f32, q: f32, r: f32| p.abs().max(q.abs()).max(r.abs());
    let (x, y, z, e) = (max3(ax, bx, cx), max3(ay, by, cy), max3(az, bz, cz), max3(u, v, w));
    let (dx, dy, dz) = (gamma(5) * (x + z), gamma(5) * (y + z), gamma(3) * z);
    let de = 2.0 * (gamma(2) * x * y + dy * x + dx * y);
    let dt = 3.0 * (gamma(3) * e * z + de * z + dz * e) * inverse.abs();
    if t <= dt {
        return None;
    }
    Some(Candidate { t, u: v * inverse, v: w * inverse })
}

/// Four or eight triangles side by side: a row of each vertex and axis, and a row of something else. Four leave as much
/// room at the end as eight lanes may read of the last rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Triangles<'a, const LEN: usize>(pub(crate) &'a [f32; LEN]);

/// Numbers of [`Triangles`], for four triangles.
pub(crate) const FOUR: usize = 48;
/// Numbers of [`Triangles`], for eight triangles.
pub(crate) const EIGHT: usize = 80;

impl<'a, const LEN: usize> Triangles<'a, LEN> {
    /// How many there are.
    pub(crate) const COUNT: usize = if LEN == FOUR { 4 } else { 8 };

    /// A coordinate of all, from triangle `at` on.
    #[inline(always)]
    pub(crate) fn row(&self, vertex: usize, axis: usize, at: usize) -> &'a [f32] {
        // The mask tells the compiler that an axis is within the rows.
        &self.0[(3 * vertex + (axis & 3)) * Self::COUNT + at..]
    }

    /// One triangle.
    #[inline]
    pub(crate) fn lane(&self, lane: usize) -> [[f32; 4]; 3] {
        let vertex = |v| [self.row(v, 0, lane)[0], self.row(v, 1, lane)[0], self.row(v, 2, lane)[0], 0.0];
        [vertex(0), vertex(1), vertex(2)]
    }
}

/// Distances, weights, and lanes that meet; and the lanes on an edge, which [`intersect_triangle`] has to decide.
pub(crate) struct Met<R: Real> {
    pub(crate) t: R,
    pub(crate) u: R,
    pub(crate) v: R,
    pub(crate) met: R::Mask,
    pub(crate) edges: R::Mask,
}

#[inline(always)]
fn largest<R: Real>(p: R, q: R, r: R) -> R {
    p.abs().max(q.abs()).max(r.abs())
}

/// [`intersect_triangle`] by lane, with the same bits; vertices relative to the origin, their axes in the ray's order.
#[inline(always)]
pub(crate) fn intersect_lanes<R: Real>([a, b, c]: [Triple<R>; 3], [sx, sy, sz]: [R; 3], t_max: R) -> Met<R> {
    let zero = R::zero();
    let (ax, ay) = (a.x - sx * a.z, a.y - sy * a.z);
    let (bx, by) = (b.x - sx * b.z, b.y - sy * b.z);
    let (cx, cy) = (c.x - sx * c.z, c.y - sy * c.z);
    let u = cx * by - cy * bx;
    let v = ax * cy - ay * cx;
    let w = bx * ay - by * ax;
    let (low, high) = (u.min(v).min(w), u.max(v).max(w));
    // Also where the product underflows: there the fallback decides as well as this would.
    let edges = (u * v * w).equals(zero);
    let mut met = (low.positive() | high.lt(zero)) & !edges;
    if !met.any() {
        return Met { t: zero, u: zero, v: zero, met, edges };
    }
    let det = u + v + w;
    let (az, bz, cz) = (a.z * sz, b.z * sz, c.z * sz);
    let scaled = u * az + v * bz + w * cz;
    let inverse = R::one() / det;
    let t = scaled * inverse;
    met = met & t.positive() & t.le(t_max) & !det.equals(zero);
    if met.any() {
        let (x, y) = (largest(ax, bx, cx), largest(ay, by, cy));
        let (z, e) = (largest(az, bz, cz), largest(u, v, w));
        let (dx, dy, dz) = ((x + z) * gamma(5), (y + z) * gamma(5), z * gamma(3));
        let de = (x * gamma(2) * y + dy * x + dx * y) * 2.0;
        let dt = (e * gamma(3) * z + de * z + dz * e) * 3.0 * inverse.abs();
        met = met & t.gt(dt);
    }
    Met { t, u: v * inverse, v: w * inverse, met, edges }
}

/// Triangles from `at` on, relative to a ray's origin, their axes in its order.
#[inline(always)]
pub(crate) fn seen_from<R: Real, const LEN: usize>(walk: &Walk, of: Triangles<'_, LEN>, at: usize) -> [Triple<R>; 3] {
    let [kx, ky, kz] = walk.axes;
    let [ox, oy, oz] = walk.start;
    macro_rules! vertex {
        ($v:expr) => {{
            let (x, y, z) = (of.row($v, kx, at), of.row($v, ky, at), of.row($v, kz, at));
            Triple::new(R::load(x) - ox, R::load(y) - oy, R::load(z) - oz)
        }};
    }
    [vertex!(0), vertex!(1), vertex!(2)]
}

/// Unit normal (counter-clockwise outside) and area of a triangle; `None` if it has no area or is not finite.
pub fn area_normal(a: Vec3, b: Vec3, c: Vec3) -> Option<(f64, Vec3)> {
    let [a, b, c]: [DVec3; 3] = [a, b, c].map(Vec3::as_dvec3);
    let cross = (b - a).cross(c - a);
    let length = cross.length();
    // The area must also survive in f32.
    if !(length.is_finite() && length > 1e-30) {
        return None;
    }
    Some((0.5 * length, (cross / length).as_vec3()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Ray;
    use tauflow_data::rng::Stream;

    #[test]
    fn eight_at_once_have_the_bits_of_one_by_one() {
        let mut stream = Stream::new(5, &[]);
        let mut hits = 0;
        for round in 0..20_000 {
            // Coarse coordinates make for rays through edges and vertices.
            let coarse = round % 2 == 0;
            let mut draw = || {
                let value = stream.range(-2.0, 2.0) as f32;
                if coarse { value.round() } else { value }
            };
            let rows: [f32; EIGHT] = std::array::from_fn(|_| draw());
            let block = Triangles(&rows);
            let ray = Ray::new(Vec3::new(draw(), draw(), draw() - 4.0), Vec3::new(draw() * 0.5, draw() * 0.5, 1.0));
            let walk = Walk::new(&ray);
            let check = |lane: usize, met: bool, edge: bool, hit: [f32; 3]| {
                let one = intersect_triangle(&walk, &block.lane(lane), 6.0);
                if !edge {
                    let found = met.then_some(Candidate { t: hit[0], u: hit[1], v: hit[2] });
                    assert_eq!(found, one, "lane {lane} of {block:?}, {ray:?}");
                }
                u32::from(one.is_some())
            };
            let shear = walk.shear;
            for lane in 0..8 {
                let found = intersect_lanes::<f32>(seen_from(&walk, block, lane), shear, 6.0);
                hits += check(lane, found.met, found.edges, [found.t, found.u, found.v]);
            }
            #[cfg(target_arch = "x86_64")]
            for at in [0, 4] {
                use crate::lanes::F4;
                let found = intersect_lanes::<F4>(seen_from(&walk, block, at), shear.map(F4::splat), F4::splat(6.0));
                let [mut t, mut u, mut v] = [[0.0; 4]; 3];
                found.t.store(&mut t);
                found.u.store(&mut u);
                found.v.store(&mut v);
                for lane in 0..4 {
                    let (met, edge) = (found.met.bits() >> lane & 1 == 1, found.edges.bits() >> lane & 1 == 1);
                    check(at + lane, met, edge, [t[lane], u[lane], v[lane]]);
                }
            }
        }
        assert!(hits > 6000, "{hits}");
    }
}
