//! Blocks along the axes: plain, upright for prints, and with rounded edges.

use super::{Body, PI};
use tauflow_data::geom::{Vec3, add, mul, unit};
use tauflow_data::maths;

/// The two directions of a face, right and up as seen from outside.
fn directions(axis: usize, side: f64) -> (Vec3, Vec3) {
    match axis {
        0 => ([0.0, 0.0, -side], [0.0, 1.0, 0.0]),
        1 => ([1.0, 0.0, 0.0], [0.0, 0.0, -side]),
        _ => ([side, 0.0, 0.0], [0.0, 1.0, 0.0]),
    }
}

fn along(v: Vec3, half: Vec3) -> f64 {
    (0..3).map(|i| v[i].abs() * half[i]).sum()
}

fn cuboid(center: Vec3, half: Vec3, grain: bool) -> Body {
    let mut body = Body::default();
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let (s, t) = directions(axis, side);
            let (hs, ht) = (along(s, half), along(t, half));
            let turned = grain && ht > hs;
            let ids = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(a, b)| {
                let mut p = center;
                for i in 0..3 {
                    p[i] += a * s[i] * half[i] + b * t[i] * half[i];
                }
                p[axis] += side * half[axis];
                let (x, y) = (a * hs, b * ht);
                body.point(p, if turned { [y, x] } else { [x, -y] })
            });
            body.quad(ids);
        }
    }
    body
}

/// A box about `center`; u runs along the longer side of each face, as grain does.
pub fn block(center: Vec3, half: Vec3) -> Body {
    cuboid(center, half, true)
}

/// A box whose faces have u to the right and v down, as prints and screens need it.
pub fn panel(center: Vec3, half: Vec3) -> Body {
    cuboid(center, half, false)
}

/// A box with small chamfered edges: boards and bars catch light along them.
pub fn board(center: Vec3, half: Vec3) -> Body {
    let least = half[0].min(half[1]).min(half[2]);
    soft_block(center, half, (0.25 * least).min(0.003), 1)
}

/// A box whose edges are rounded by `radius` in `n` steps a quarter of each 90 degrees.
pub fn soft_block(center: Vec3, half: Vec3, radius: f64, n: usize) -> Body {
    let least = half[0].min(half[1]).min(half[2]);
    let radius = radius.min(0.98 * least);
    let inner = half.map(|h| h - radius);
    // Steps over one side of a face: the corner's bend, the flat part, the other bend. Of each: the place of the core
    // point (-1 or 1) and the offset from it as a share of the radius.
    let mut steps: Vec<(f64, f64)> = Vec::new();
    for k in (0..=n).rev() {
        let t = if k == n { 1.0 } else { maths::tan(0.25 * PI * k as f64 / n as f64) };
        steps.push((-1.0, -t));
    }
    let mirrored: Vec<(f64, f64)> = steps.iter().rev().map(|(c, t)| (-c, -t)).collect();
    steps.extend(mirrored);
    let m = steps.len();
    let mut body = Body::default().soft();
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let (s, t) = directions(axis, side);
            let (hs, ht) = (along(s, half), along(t, half));
            let (is, it) = (along(s, inner), along(t, inner));
            let turned = ht > hs;
            let base = body.points.len() as u32;
            for (cb, ob) in &steps {
                for (ca, oa) in &steps {
                    let mut core = [0.0; 3];
                    let mut out = [0.0; 3];
                    core[axis] = side * inner[axis];
                    out[axis] = side * radius;
                    for i in 0..3 {
                        if i != axis {
                            core[i] = (ca * s[i] + cb * t[i]) * inner[i];
                            out[i] = (oa * s[i] + ob * t[i]) * radius;
                        }
                    }
                    let p = add(core, mul(unit(out), radius));
                    let (x, y) = (ca * is + oa * radius, cb * it + ob * radius);
                    body.point(add(center, p), if turned { [y, x] } else { [x, -y] });
                }
            }
            let index = |i: usize, j: usize| base + (j * m + i) as u32;
            for j in 0..m - 1 {
                for i in 0..m - 1 {
                    body.quad([index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)]);
                }
            }
        }
    }
    body
}
