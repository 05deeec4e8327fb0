//! Watertight triangles: a ray at a shared edge or vertex meets one of its triangles, whatever the rounding.
//!
//! Woop, Benthin, Wald 2013, with the f64 fallback on edges and the distance error of pbrt-v4, section 6.8.7.

use super::{Walk, gamma};
use glam::{DVec3, Vec3, Vec4};

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

/// Four triangles side by side: `block[vertex][axis]`; the fourth axis is not read.
pub type Four = [[Vec4; 4]; 3];

/// One triangle of four.
#[inline]
pub fn lane_of(block: &Four, lane: usize) -> [[f32; 4]; 3] {
    block.map(|axes| axes.map(|values| values[lane]))
}

/// Hits of a ray with four triangles: distances and weights, and a bit for each that counts.
#[derive(Clone, Copy, Debug)]
pub struct FourHits {
    /// Bits of the triangles that are met.
    pub met: u32,
    /// Distances.
    pub t: [f32; 4],
    /// Weights of the second vertices.
    pub u: [f32; 4],
    /// Weights of the third vertices.
    pub v: [f32; 4],
}

/// [`intersect_triangle`] of four at once, with the same bits.
#[inline(always)]
pub fn intersect_four(walk: &Walk, block: &Four, t_max: f32) -> FourHits {
    let [kx, ky, kz] = walk.axes.map(|k| k & 3);
    let [sx, sy, sz] = walk.shear.map(Vec4::splat);
    let [ox, oy, oz] = walk.start.map(Vec4::splat);
    let [a, b, c] = block;
    let (az, bz, cz) = (a[kz] - oz, b[kz] - oz, c[kz] - oz);
    let (ax, ay) = ((a[kx] - ox) - sx * az, (a[ky] - oy) - sy * az);
    let (bx, by) = ((b[kx] - ox) - sx * bz, (b[ky] - oy) - sy * bz);
    let (cx, cy) = ((c[kx] - ox) - sx * cz, (c[ky] - oy) - sy * cz);
    let u = cx * by - cy * bx;
    let v = ax * cy - ay * cx;
    let w = bx * ay - by * ax;
    let zero = Vec4::ZERO;
    let edges = (u.cmpeq(zero) | v.cmpeq(zero) | w.cmpeq(zero)).bitmask();
    let mixed = u.min(v).min(w).cmplt(zero) & u.max(v).max(w).cmpgt(zero);
    let det = u + v + w;
    let (az, bz, cz) = (az * sz, bz * sz, cz * sz);
    let scaled = u * az + v * bz + w * cz;
    let inverse = Vec4::ONE / det;
    let t = scaled * inverse;
    let near = t.cmpgt(zero) & t.cmple(Vec4::splat(t_max)) & det.cmpne(zero) & !mixed;
    let mut hits = FourHits { met: near.bitmask() & !edges, t: [0.0; 4], u: [0.0; 4], v: [0.0; 4] };
    if hits.met != 0 {
        let max3 = |p: Vec4, q: Vec4, r: Vec4| p.abs().max(q.abs()).max(r.abs());
        let (x, y, z, e) = (max3(ax, bx, cx), max3(ay, by, cy), max3(az, bz, cz), max3(u, v, w));
        let (dx, dy, dz) = ((x + z) * gamma(5), (y + z) * gamma(5), z * gamma(3));
        let de = (x * gamma(2) * y + dy * x + dx * y) * 2.0;
        let dt = (e * gamma(3) * z + de * z + dz * e) * 3.0 * inverse.abs();
        hits.met &= t.cmpgt(dt).bitmask();
        (hits.t, hits.u, hits.v) = (t.to_array(), (v * inverse).to_array(), (w * inverse).to_array());
    }
    let mut unsure = edges;
    while unsure != 0 {
        let lane = unsure.trailing_zeros() as usize;
        unsure &= unsure - 1;
        if let Some(found) = intersect_triangle(walk, &lane_of(block, lane), t_max) {
            hits.met |= 1 << lane;
            (hits.t[lane], hits.u[lane], hits.v[lane]) = (found.t, found.u, found.v);
        }
    }
    hits
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
    fn four_at_once_have_the_bits_of_one_by_one() {
        let mut stream = Stream::new(5, &[]);
        let mut hits = 0;
        for round in 0..20_000 {
            // Coarse coordinates make for rays through edges and vertices.
            let coarse = round % 2 == 0;
            let mut draw = || {
                let value = stream.range(-2.0, 2.0) as f32;
                if coarse { value.round() } else { value }
            };
            let block: Four =
                std::array::from_fn(|_| std::array::from_fn(|_| Vec4::new(draw(), draw(), draw(), draw())));
            let ray = Ray::new(Vec3::new(draw(), draw(), draw() - 4.0), Vec3::new(draw() * 0.5, draw() * 0.5, 1.0));
            let walk = Walk::new(&ray);
            let four = intersect_four(&walk, &block, 6.0);
            for lane in 0..4 {
                let one = intersect_triangle(&walk, &lane_of(&block, lane), 6.0);
                let found = (four.met >> lane & 1 == 1).then(|| Candidate {
                    t: four.t[lane],
                    u: four.u[lane],
                    v: four.v[lane],
                });
                assert_eq!(found, one, "lane {lane} of {block:?}, {ray:?}");
                hits += u32::from(one.is_some());
            }
        }
        assert!(hits > 3000, "{hits}");
    }
}
