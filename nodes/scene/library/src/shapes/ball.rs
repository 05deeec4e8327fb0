//! Round things: subdivided icosahedra and balls of rings.

use super::{Body, PI, lathe};
use std::collections::BTreeMap;
use tauflow_data::geom::{Vec3, add, cross, dot, length, mul, sub, unit};
use tauflow_data::maths;

/// A ball of radius `r` about the origin, `n` sides round.
pub fn ball(r: f64, n: usize) -> Body {
    let rows = n / 2;
    let profile: Vec<[f64; 2]> = (0..=rows)
        .map(|j| {
            let a = PI * (j as f64 / rows as f64 - 0.5);
            [if j == 0 || j == rows { 0.0 } else { r * maths::cos(a) }, r * maths::sin(a)]
        })
        .collect();
    lathe(&profile, n).smooth()
}

/// An icosahedron subdivided `levels` times, each vertex pushed to `radius(direction)`; uv by its sides.
pub fn icosphere(levels: u32, radius: impl Fn(Vec3) -> f64) -> Body {
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
    let uvs = vec![[0.0; 2]; placed.len()];
    Body { points: placed, uvs, triangles: faces, ..Body::default() }.box_mapped().smooth()
}

/// A convex body of flat faces: the planes `n . x = 1`, met by cutting a cube of half size 3; for gems and crystals.
pub fn faceted(planes: &[Vec3]) -> Body {
    let mut body = Body::default().flat();
    for (k, plane) in planes.iter().enumerate() {
        let n = unit(*plane);
        let foot = mul(n, 1.0 / length(*plane));
        let reference = if n[1].abs() > 0.9 { [0.0, 0.0, -1.0] } else { [0.0, 1.0, 0.0] };
        let s = unit(cross(reference, n));
        let t = cross(n, s);
        let mut polygon: Vec<Vec3> = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .iter()
            .map(|(a, b)| add(foot, add(mul(s, 9.0 * a), mul(t, 9.0 * b))))
            .collect();
        for (other, cut) in planes.iter().enumerate() {
            if other != k {
                polygon = below(&polygon, *cut);
            }
        }
        if polygon.len() > 2 {
            let ids: Vec<u32> = polygon.iter().map(|p| body.point(snapped(*p), [dot(*p, s), -dot(*p, t)])).collect();
            (1..ids.len() - 1).for_each(|i| body.triangles.push([ids[0], ids[i], ids[i + 1]]));
        }
    }
    body
}

/// The same corner comes from three planes in any order; to a millionth of a unit it is one.
fn snapped(p: Vec3) -> Vec3 {
    p.map(|v| (v * 1e6).round() / 1e6)
}

fn below(polygon: &[Vec3], plane: Vec3) -> Vec<Vec3> {
    let n = polygon.len();
    let mut out = Vec::with_capacity(n + 1);
    for i in 0..n {
        let (a, b) = (polygon[i], polygon[(i + 1) % n]);
        let (da, db) = (dot(a, plane) - 1.0, dot(b, plane) - 1.0);
        if da <= 0.0 {
            out.push(a);
        }
        if (da < 0.0 && db > 0.0) || (da > 0.0 && db < 0.0) {
            out.push(add(a, mul(sub(b, a), da / (da - db))));
        }
    }
    out
}
