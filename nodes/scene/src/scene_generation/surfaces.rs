//! Ways to make meshes: parametric grids, prisms, boxes, subdivided icosahedra.
//!
//! Knows no object in particular; [`super::forms`] names them. Every mesh here is closed and has outward normals.

use crate::geom::{Vec3, add, cross, dot, length, mul, sub, unit};
use std::collections::BTreeMap;
use tauflow_data::{maths, mesh::Mesh};

/// Two pi.
pub const TAU: f64 = core::f64::consts::TAU;

fn f32s(p: Vec3) -> [f32; 3] {
    p.map(|v| v as f32)
}

/// What happens at the two ends of a grid's v.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Ends {
    /// v wraps round, as on a torus.
    Wrap,
    /// Both ends shrink to a point, as on a sphere.
    Poles,
}

/// A closed grid over `f(u, v)`, u and v in [0, 1], u periodic, with normals by differences.
///
/// `f` is asked on the circle u in [0, 1) only, so the seam is closed to the bit. Outward is (df/du x df/dv), or its
/// opposite if `flip`.
pub fn grid(nu: usize, nv: usize, ends: Ends, flip: bool, f: impl Fn(f64, f64) -> Vec3) -> Mesh {
    let at_v = |j: usize| if ends == Ends::Wrap { (j % nv) as f64 / nv as f64 } else { j as f64 / nv as f64 };
    let position = |i: usize, j: usize| {
        let pole = ends == Ends::Poles && (j == 0 || j == nv);
        f(if pole { 0.0 } else { (i % nu) as f64 / nu as f64 }, at_v(j))
    };
    let wrapped = |v: f64| v - v.floor();
    let normal = |i: usize, j: usize| {
        let h = 1e-4;
        let u = (i % nu) as f64 / nu as f64;
        let mut v = at_v(j);
        let (mut v0, mut v1) = (v - h, v + h);
        if ends == Ends::Wrap {
            (v0, v1) = (wrapped(v0), wrapped(v1));
        } else {
            // Near a pole df/du vanishes: look a little inside, and average round the pole by taking its axis.
            v = v.clamp(4.0 * h, 1.0 - 4.0 * h);
            (v0, v1) = (v - h, v + h);
        }
        let du = sub(f(wrapped(u + h), v), f(wrapped(u - h), v));
        let dv = sub(f(u, v1), f(u, v0));
        let n = unit(cross(du, dv));
        if flip { mul(n, -1.0) } else { n }
    };
    let mut mesh = Mesh { normals: Some(Vec::new()), uvs: Some(Vec::new()), ..Mesh::default() };
    for j in 0..=nv {
        for i in 0..=nu {
            mesh.positions.push(f32s(position(i, j)));
            let n = if ends == Ends::Poles && (j == 0 || j == nv) {
                let sum = (0..nu).fold([0.0; 3], |sum, k| add(sum, normal(k, j)));
                unit(sum)
            } else {
                normal(i, j)
            };
            mesh.normals.as_mut().expect("just made").push(f32s(n));
            mesh.uvs.as_mut().expect("just made").push([i as f32 / nu as f32, 1.0 - j as f32 / nv as f32]);
        }
    }
    let index = |i: usize, j: usize| (j * (nu + 1) + i) as u32;
    for j in 0..nv {
        for i in 0..nu {
            let (a, b, c, d) = (index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1));
            let mut push = |t: [u32; 3]| mesh.triangles.push(if flip { [t[0], t[2], t[1]] } else { t });
            if !(ends == Ends::Poles && j == 0) {
                push([a, b, c]);
            }
            if !(ends == Ends::Poles && j + 1 == nv) {
                push([a, c, d]);
            }
        }
    }
    mesh
}

/// A smooth curve through `points` (uniform Catmull-Rom), at t in [0, 1]; closed or with repeated ends.
pub fn spline(points: &[[f64; 2]], closed: bool, t: f64) -> [f64; 2] {
    let n = points.len();
    let spans = if closed { n } else { n - 1 };
    let x = (t * spans as f64).clamp(0.0, spans as f64);
    let span = (x.floor() as usize).min(spans - 1);
    let s = x - span as f64;
    let at = |k: i64| {
        let k = span as i64 + k;
        points[if closed { k.rem_euclid(n as i64) as usize } else { k.clamp(0, n as i64 - 1) as usize }]
    };
    let (p0, p1, p2, p3) = (at(-1), at(0), at(1), at(2));
    [0, 1].map(|i| {
        0.5 * (2.0 * p1[i]
            + (p2[i] - p0[i]) * s
            + (2.0 * p0[i] - 5.0 * p1[i] + 4.0 * p2[i] - p3[i]) * s * s
            + (3.0 * p1[i] - p0[i] - 3.0 * p2[i] + p3[i]) * s * s * s)
    })
}

/// A body of revolution of the open profile `(radius, height)`, from the axis below, round the outside, to the axis.
pub fn lathe(profile: &[[f64; 2]], nu: usize, nv: usize) -> Mesh {
    let last = profile.len() - 1;
    grid(nu, nv, Ends::Poles, false, |u, v| {
        let [r, y] = match v {
            v if v <= 0.0 => profile[0],
            v if v >= 1.0 => profile[last],
            v => spline(profile, false, v),
        };
        let r = r.max(0.0);
        [r * maths::sin(TAU * u), y, r * maths::cos(TAU * u)]
    })
}

/// A prism over a star-shaped outline (counter-clockwise seen from above, about the origin), twisted and tapered with
/// height; flat-shaded.
pub fn prism(outline: &[[f64; 2]], height: f64, rows: usize, twist: f64, taper: f64) -> Mesh {
    let n = outline.len();
    let mut mesh = Mesh::default();
    for row in 0..=rows {
        let t = row as f64 / rows as f64;
        let (s, c) = (maths::sin(twist * t), maths::cos(twist * t));
        let k = 1.0 + (taper - 1.0) * t;
        for [x, z] in outline {
            mesh.positions.push(f32s([k * (c * x + s * z), height * t, k * (c * z - s * x)]));
        }
    }
    let index = |row: usize, i: usize| (row * n + i % n) as u32;
    for row in 0..rows {
        for i in 0..n {
            mesh.triangles.push([index(row, i), index(row, i + 1), index(row + 1, i + 1)]);
            mesh.triangles.push([index(row, i), index(row + 1, i + 1), index(row + 1, i)]);
        }
    }
    let (bottom, top) = (mesh.positions.len() as u32, mesh.positions.len() as u32 + 1);
    mesh.positions.push([0.0; 3]);
    mesh.positions.push([0.0, height as f32, 0.0]);
    for i in 0..n {
        mesh.triangles.push([bottom, index(0, i + 1), index(0, i)]);
        mesh.triangles.push([top, index(rows, i), index(rows, i + 1)]);
    }
    outward(mesh)
}

/// Turns every triangle if the mesh's signed volume is negative.
fn outward(mut mesh: Mesh) -> Mesh {
    let p = |i: u32| mesh.positions[i as usize].map(f64::from);
    let volume: f64 = mesh.triangles.iter().map(|t| dot(p(t[0]), cross(p(t[1]), p(t[2])))).sum();
    if volume < 0.0 {
        mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    mesh
}

/// Boxes along the axes, `(center, half size)`, as one flat-shaded mesh with uv on every side.
pub fn boxes(parts: &[(Vec3, Vec3)]) -> Mesh {
    let mut mesh = Mesh { uvs: Some(Vec::new()), ..Mesh::default() };
    for (center, half) in parts {
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
                let base = mesh.positions.len() as u32;
                for (s, t) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                    let mut p = *center;
                    p[axis] += side * half[axis];
                    p[a] += s * half[a];
                    p[b] += t * half[b];
                    mesh.positions.push(f32s(p));
                    let uv = [((s + 1.0) * half[a]) as f32, ((t + 1.0) * half[b]) as f32];
                    mesh.uvs.as_mut().expect("just made").push(uv);
                }
                let quad = [[0, 1, 2], [0, 2, 3]];
                for t in quad {
                    let t = if side > 0.0 { t } else { [t[0], t[2], t[1]] };
                    mesh.triangles.push(t.map(|i| base + i));
                }
            }
        }
    }
    mesh
}

/// A box of half size `half` about the origin with edges rounded by `radius`; `n` squares along each face's side.
pub fn rounded_box(half: Vec3, radius: f64, n: usize) -> Mesh {
    let mut mesh = Mesh { normals: Some(Vec::new()), uvs: Some(Vec::new()), ..Mesh::default() };
    let inner = half.map(|h| h - radius);
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
            let base = mesh.positions.len() as u32;
            // More rows near the edges, where the surface bends.
            let warp = |k: usize| {
                let x = 2.0 * k as f64 / n as f64 - 1.0;
                x * (1.5 - 0.5 * x * x)
            };
            for j in 0..=n {
                for i in 0..=n {
                    let mut p = [0.0; 3];
                    p[axis] = side * half[axis];
                    p[a] = warp(i) * half[a];
                    p[b] = warp(j) * half[b];
                    let core = [0, 1, 2].map(|k| p[k].clamp(-inner[k], inner[k]));
                    let normal = unit(sub(p, core));
                    mesh.positions.push(f32s(add(core, mul(normal, radius))));
                    mesh.normals.as_mut().expect("just made").push(f32s(normal));
                    mesh.uvs.as_mut().expect("just made").push([i as f32 / n as f32, j as f32 / n as f32]);
                }
            }
            let index = |i: usize, j: usize| base + (j * (n + 1) + i) as u32;
            for j in 0..n {
                for i in 0..n {
                    for t in [[(i, j), (i + 1, j), (i + 1, j + 1)], [(i, j), (i + 1, j + 1), (i, j + 1)]] {
                        let t = t.map(|(x, y)| index(x, y));
                        mesh.triangles.push(if side > 0.0 { t } else { [t[0], t[2], t[1]] });
                    }
                }
            }
        }
    }
    mesh
}

/// An icosahedron subdivided `levels` times, each vertex pushed out to `radius(direction)`, with smooth normals.
pub fn icosphere(levels: u32, radius: impl Fn(Vec3) -> f64) -> Mesh {
    let g = 0.5 * (1.0 + 5f64.sqrt());
    let mut points: Vec<Vec3> = Vec::new();
    for i in 0..3 {
        for (s, t) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            let mut p = [0.0; 3];
            p[i] = s;
            p[(i + 1) % 3] = t * g;
            points.push(unit(p));
        }
    }
    // Faces: all triples of vertices at the edge's distance.
    let edge = 2.0 / (1.0 + g * g).sqrt();
    let near = |a: usize, b: usize, points: &[Vec3]| (length(sub(points[a], points[b])) - edge).abs() < 1e-9;
    let mut faces: Vec<[u32; 3]> = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if near(a, b, &points) && near(b, c, &points) && near(a, c, &points) {
                    let out = dot(points[a], cross(points[b], points[c])) > 0.0;
                    faces.push(if out { [a as u32, b as u32, c as u32] } else { [a as u32, c as u32, b as u32] });
                }
            }
        }
    }
    for _ in 0..levels {
        let mut middles: BTreeMap<(u32, u32), u32> = BTreeMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                points.push(unit(add(points[a as usize], points[b as usize])));
                points.len() as u32 - 1
            })
        };
        faces = faces
            .iter()
            .flat_map(|&[a, b, c]| {
                let (x, y, z) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, x, z], [x, b, y], [z, y, c], [x, y, z]]
            })
            .collect();
    }
    let placed: Vec<Vec3> = points.iter().map(|p| mul(*p, radius(*p))).collect();
    let mut normals = vec![[0.0; 3]; placed.len()];
    for t in &faces {
        let [a, b, c] = t.map(|i| placed[i as usize]);
        let n = cross(sub(b, a), sub(c, a));
        for i in t {
            normals[*i as usize] = add(normals[*i as usize], n);
        }
    }
    Mesh {
        positions: placed.into_iter().map(f32s).collect(),
        triangles: faces,
        normals: Some(normals.into_iter().map(|n| f32s(unit(n))).collect()),
        ..Mesh::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn icosahedron_is_whole_and_round() {
        let mesh = icosphere(2, |_| 1.0);
        assert_eq!(mesh.triangles.len(), 20 * 16);
        assert_eq!(mesh.positions.len(), 10 * 16 + 2);
        assert!(mesh.positions.iter().all(|p| (length(p.map(f64::from)) - 1.0).abs() < 1e-6));
    }

    #[test]
    fn splines_pass_through_their_points() {
        let points = [[0.0, 0.0], [1.0, 0.5], [0.5, 2.0]];
        assert_eq!(spline(&points, false, 0.5), [1.0, 0.5]);
        assert_eq!(spline(&points, true, 1.0), spline(&points, true, 0.0));
    }
}
