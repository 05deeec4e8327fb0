//! Bodies given by a signed distance, meshed by dual contouring (Ju, Losasso, Schaefer and Warren 2002).
//!
//! One vertex for each cell that the surface crosses, where the tangent planes at its crossed edges meet best, kept
//! within the cell; one quad for each crossed edge. The mesh is therefore closed for every field, edges of a union or
//! difference stay sharp, and triangles face the direction in which the field grows.

use super::Body;
use tauflow_data::geom::{Vec3, add, dot, length, mul, sub, unit};

/// Pulls a vertex towards the mean of its crossings: large on flat places, where the planes do not fix it.
const PULL: f64 = 0.03;

/// A signed distance (negative inside) over a box.
pub struct Field<F> {
    /// The distance, or anything of about its slope.
    pub distance: F,
    /// The box the body lies in.
    pub low: Vec3,
    /// Its other corner.
    pub high: Vec3,
}

impl<F: Fn(Vec3) -> f64> Field<F> {
    /// The body's surface in cells of about size `cell`.
    pub fn body(&self, cell: f64) -> Body {
        let size = sub(self.high, self.low);
        let counts = size.map(|v| ((v / cell).ceil() as usize).max(2) + 2);
        let node =
            |i: [usize; 3]| [0, 1, 2].map(|k| self.low[k] + size[k] * (i[k] as f64 - 1.0) / (counts[k] - 2) as f64);
        let nodes = counts.map(|c| c + 1);
        let flat = |i: [usize; 3]| (i[2] * nodes[1] + i[1]) * nodes[0] + i[0];
        let mut values = Vec::with_capacity(nodes[0] * nodes[1] * nodes[2]);
        for z in 0..nodes[2] {
            for y in 0..nodes[1] {
                for x in 0..nodes[0] {
                    let i = [x, y, z];
                    let border = (0..3).any(|k| i[k] == 0 || i[k] == counts[k]);
                    let value = (self.distance)(node(i));
                    values.push(if border { value.max(0.1 * cell) } else { value });
                }
            }
        }
        let mut vertices = vec![u32::MAX; values.len()];
        let mut body = Body::default();
        for z in 0..counts[2] {
            for y in 0..counts[1] {
                for x in 0..counts[0] {
                    let i = [x, y, z];
                    if let Some(p) = self.vertex(i, &values, &node, &flat) {
                        vertices[flat(i)] = body.point(p, [0.0; 2]);
                    }
                }
            }
        }
        for z in 0..counts[2] {
            for y in 0..counts[1] {
                for x in 0..counts[0] {
                    for axis in 0..3 {
                        let i = [x, y, z];
                        if i[(axis + 1) % 3] == 0 || i[(axis + 2) % 3] == 0 {
                            continue;
                        }
                        let mut j = i;
                        j[axis] += 1;
                        let (from, to) = (values[flat(i)] < 0.0, values[flat(j)] < 0.0);
                        if from != to {
                            let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
                            let cell_at = |db: usize, dc: usize| {
                                let mut k = i;
                                k[b] -= db;
                                k[c] -= dc;
                                vertices[flat(k)]
                            };
                            let around = [cell_at(1, 1), cell_at(0, 1), cell_at(0, 0), cell_at(1, 0)];
                            push(&mut body, if from { around } else { [around[3], around[2], around[1], around[0]] });
                        }
                    }
                }
            }
        }
        body.box_mapped()
    }

    /// The direction in which the field grows, from the corners of a small tetrahedron.
    fn slope(&self, p: Vec3, h: f64) -> Vec3 {
        let corners = [[1.0, -1.0, -1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, 1.0, 1.0]];
        unit(corners.into_iter().fold([0.0; 3], |sum, c| add(sum, mul(c, (self.distance)(add(p, mul(c, h)))))))
    }

    fn vertex(
        &self,
        i: [usize; 3],
        values: &[f64],
        node: &impl Fn([usize; 3]) -> Vec3,
        flat: &impl Fn([usize; 3]) -> usize,
    ) -> Option<Vec3> {
        let corner = |k: usize| [i[0] + (k & 1), i[1] + (k >> 1 & 1), i[2] + (k >> 2 & 1)];
        let inside: [bool; 8] = core::array::from_fn(|k| values[flat(corner(k))] < 0.0);
        if inside.iter().all(|v| *v == inside[0]) {
            return None;
        }
        let (low, high) = (node(corner(0)), node(corner(7)));
        let h = 0.02 * (high[0] - low[0]);
        let mut planes: Vec<(Vec3, Vec3)> = Vec::with_capacity(6);
        for k in 0..8 {
            for axis in 0..3 {
                let other = k | 1 << axis;
                if other == k || inside[k] == inside[other] {
                    continue;
                }
                let (a, b) = (node(corner(k)), node(corner(other)));
                let (mut ta, mut tb) = (0.0, 1.0);
                let (mut va, mut vb) = (values[flat(corner(k))], values[flat(corner(other))]);
                // Regula falsi with a bisection between: fields of differences bend.
                for step in 0..3 {
                    let t = if step % 2 == 0 { ta + (tb - ta) * va / (va - vb) } else { 0.5 * (ta + tb) };
                    let v = (self.distance)(add(a, mul(sub(b, a), t)));
                    if (v < 0.0) == (va < 0.0) { (ta, va) = (t, v) } else { (tb, vb) = (t, v) }
                }
                let t = if va == vb { ta } else { (ta + (tb - ta) * va / (va - vb)).clamp(0.0, 1.0) };
                let p = add(a, mul(sub(b, a), t));
                planes.push((p, self.slope(p, h)));
            }
        }
        let mean = mul(planes.iter().fold([0.0; 3], |s, (p, _)| add(s, *p)), 1.0 / planes.len() as f64);
        // Normal equations of the planes about the mean, with the pull.
        let mut m = [[0.0; 3]; 3];
        let mut right = [0.0; 3];
        for (p, n) in &planes {
            let d = dot(*n, sub(*p, mean));
            for r in 0..3 {
                right[r] += n[r] * d;
                for c in 0..3 {
                    m[r][c] += n[r] * n[c];
                }
            }
        }
        (0..3).for_each(|r| m[r][r] += PULL * planes.len() as f64);
        let x = add(mean, solved(m, right));
        // A little inside the cell, so that no two vertices meet.
        Some([0, 1, 2].map(|k| {
            let margin = 0.03 * (high[k] - low[k]);
            x[k].clamp(low[k] + margin, high[k] - margin)
        }))
    }
}

/// Cramer's rule; the matrix is positive definite.
fn solved(m: [[f64; 3]; 3], b: Vec3) -> Vec3 {
    let det = |c: [Vec3; 3]| dot(c[0], tauflow_data::geom::cross(c[1], c[2]));
    let column = |k: usize| [m[0][k], m[1][k], m[2][k]];
    let whole = det([column(0), column(1), column(2)]);
    [
        det([b, column(1), column(2)]) / whole,
        det([column(0), b, column(2)]) / whole,
        det([column(0), column(1), b]) / whole,
    ]
}

/// A quad as two triangles along its shorter diagonal.
fn push(body: &mut Body, [a, b, c, d]: [u32; 4]) {
    let p = |i: u32| body.points[i as usize];
    if length(sub(p(a), p(c))) <= length(sub(p(b), p(d))) {
        body.triangles.extend([[a, b, c], [a, c, d]]);
    } else {
        body.triangles.extend([[a, b, d], [b, c, d]]);
    }
}

/// Union with a blend of width about `k`.
pub fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    let h = (0.5 + 0.5 * (b - a) / k).clamp(0.0, 1.0);
    b + (a - b) * h - k * h * (1.0 - h)
}

/// Distance to a capsule from `a` to `b` whose radius goes from `ra` to `rb`.
pub fn capsule(p: Vec3, a: Vec3, b: Vec3, ra: f64, rb: f64) -> f64 {
    let (pa, ba) = (sub(p, a), sub(b, a));
    let t = (dot(pa, ba) / dot(ba, ba).max(1e-12)).clamp(0.0, 1.0);
    length(sub(pa, mul(ba, t))) - (ra + (rb - ra) * t)
}

/// About the distance to an ellipsoid of half axes `r`.
pub fn ellipsoid(p: Vec3, center: Vec3, r: Vec3) -> f64 {
    let q = sub(p, center);
    let k0 = length([q[0] / r[0], q[1] / r[1], q[2] / r[2]]);
    let k1 = length([q[0] / (r[0] * r[0]), q[1] / (r[1] * r[1]), q[2] / (r[2] * r[2])]);
    if k1 < 1e-12 { -r[0].min(r[1]).min(r[2]) } else { k0 * (k0 - 1.0) / k1 }
}

/// Distance to a cylinder along `axis` about `center`.
pub fn cylinder_field(p: Vec3, center: Vec3, axis: usize, radius: f64, half: f64) -> f64 {
    let q = sub(p, center);
    let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
    let d = [(q[b] * q[b] + q[c] * q[c]).sqrt() - radius, q[axis].abs() - half];
    let out = [d[0].max(0.0), d[1].max(0.0)];
    d[0].max(d[1]).min(0.0) + (out[0] * out[0] + out[1] * out[1]).sqrt()
}
