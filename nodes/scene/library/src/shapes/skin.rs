//! Skins over rings of points, and what is a special case of them: lathes, sweeps, tubes, sheets, slabs.

use super::{Body, circle};
use tauflow_data::geom::{Vec3, add, cross, dot, length, mul, sub, unit};
use tauflow_data::maths;

/// A surface through rings of equally many points. Outward is (around x along).
///
/// `wrap`: rings are closed, and the last ring joins the first. `caps`: fans over the first and the last ring, which
/// must be seen whole from their middle.
pub fn skin(rings: &[Vec<Vec3>], wrap: [bool; 2], caps: [bool; 2]) -> Body {
    let n = rings[0].len();
    let columns = if wrap[0] { n + 1 } else { n };
    let rows = if wrap[1] { rings.len() + 1 } else { rings.len() };
    // Around: lengths on the longest ring. Along: mean lengths from ring to ring.
    let around_of = |ring: &[Vec3]| {
        let mut sums = vec![0.0];
        (1..columns).for_each(|i| sums.push(sums[i - 1] + length(sub(ring[i % n], ring[i - 1]))));
        sums
    };
    let us = rings
        .iter()
        .map(|ring| around_of(ring))
        .max_by(|a, b| a[columns - 1].total_cmp(&b[columns - 1]))
        .unwrap_or_default();
    let mut vs = vec![0.0];
    for j in 1..rows {
        let (a, b) = (&rings[j - 1], &rings[j % rings.len()]);
        let mean = (0..n).map(|i| length(sub(b[i], a[i]))).sum::<f64>() / n as f64;
        vs.push(vs[j - 1] + mean);
    }
    let mut body = Body::default();
    for (j, v) in vs.iter().enumerate() {
        for (i, u) in us.iter().enumerate() {
            body.point(rings[j % rings.len()][i % n], [*u, -v]);
        }
    }
    let index = |i: usize, j: usize| (j * columns + i) as u32;
    for j in 0..rows - 1 {
        for i in 0..columns - 1 {
            body.quad([index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)]);
        }
    }
    for (end, wanted) in caps.into_iter().enumerate() {
        if wanted {
            cap(&mut body, &rings[if end == 0 { 0 } else { rings.len() - 1 }], end == 0);
        }
    }
    body
}

fn cap(body: &mut Body, ring: &[Vec3], first: bool) {
    let n = ring.len();
    let center = mul(ring.iter().fold([0.0; 3], |s, p| add(s, *p)), 1.0 / n as f64);
    let normal = (0..n).fold([0.0; 3], |s, i| add(s, cross(sub(ring[i], center), sub(ring[(i + 1) % n], center))));
    let normal = unit(if first { mul(normal, -1.0) } else { normal });
    let reference = if normal[1].abs() > 0.9 { [0.0, 0.0, -1.0] } else { [0.0, 1.0, 0.0] };
    let s = unit(cross(reference, normal));
    let t = cross(normal, s);
    let uv = |p: Vec3| [dot(p, s), -dot(p, t)];
    let middle = body.point(center, uv(center));
    let base = body.points.len() as u32;
    ring.iter().for_each(|p| {
        body.point(*p, uv(*p));
    });
    for i in 0..n as u32 {
        let (a, b) = (base + i, base + (i + 1) % n as u32);
        body.triangles.push(if first { [middle, b, a] } else { [middle, a, b] });
    }
}

fn ring_at(n: usize, r: f64, y: f64) -> Vec<Vec3> {
    // From +z towards +x, so that the way round and up make an outward normal.
    circle(n, r).into_iter().map(|[c, s]| [s, y, c]).collect()
}

/// A body of revolution of the profile `(radius, height)` in `n` sides; closed if it begins and ends on the axis.
pub fn lathe(profile: &[[f64; 2]], n: usize) -> Body {
    let rings: Vec<_> = profile.iter().map(|[r, y]| ring_at(n, r.max(0.0), *y)).collect();
    skin(&rings, [true, false], [false; 2])
}

/// A body of revolution of a closed profile, counter-clockwise in (radius, height).
pub fn lathe_loop(profile: &[[f64; 2]], n: usize) -> Body {
    let rings: Vec<_> = profile.iter().map(|[r, y]| ring_at(n, *r, *y)).collect();
    skin(&rings, [true, true], [false; 2])
}

/// Frames along a path: tangent and a normal carried along without twist.
fn frames(path: &[Vec3], closed: bool, up: Vec3) -> Vec<(Vec3, Vec3)> {
    let n = path.len();
    let tangent = |i: usize| {
        let (a, b) = if closed {
            (path[(i + n - 1) % n], path[(i + 1) % n])
        } else {
            (path[i.saturating_sub(1)], path[(i + 1).min(n - 1)])
        };
        unit(sub(b, a))
    };
    let carried = |normal: Vec3, t: Vec3| sub(normal, mul(t, dot(normal, t)));
    let first = tangent(0);
    let mut normal = carried(up, first);
    if length(normal) < 0.05 {
        normal = carried(if first[0].abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] }, first);
    }
    let mut out = Vec::with_capacity(n);
    for i in 0..n {
        let t = tangent(i);
        normal = unit(carried(normal, t));
        out.push((t, normal));
    }
    if closed {
        // The gap to the first frame is distributed over the path.
        let end = unit(carried(normal, first));
        let start = out[0].1;
        let missing = maths::atan2(dot(cross(end, start), first), dot(end, start));
        for (i, (t, normal)) in out.iter_mut().enumerate() {
            let a = missing * i as f64 / n as f64;
            let side = cross(*t, *normal);
            *normal = unit(add(mul(*normal, maths::cos(a)), mul(side, maths::sin(a))));
        }
    }
    out
}

fn swept(
    path: &[Vec3],
    closed: bool,
    up: Vec3,
    mut section: impl FnMut(usize, f64) -> Vec<[f64; 2]>,
) -> Vec<Vec<Vec3>> {
    let last = (path.len() - 1).max(1) as f64;
    frames(path, closed, up)
        .into_iter()
        .enumerate()
        .map(|(i, (t, normal))| {
            let side = cross(t, normal);
            let ring = section(i, i as f64 / last);
            ring.into_iter().map(|[a, b]| add(path[i], add(mul(normal, a), mul(side, b)))).collect()
        })
        .collect()
}

/// A closed section, counter-clockwise, carried along an open path and scaled by `scale(t)`; capped. The section's
/// first axis starts along `up`. u runs along the path.
pub fn sweep(path: &[Vec3], section: &[[f64; 2]], up: Vec3, scale: impl Fn(f64) -> f64) -> Body {
    let rings = swept(path, false, up, |_, t| {
        let k = scale(t);
        section.iter().map(|p| [p[0] * k, p[1] * k]).collect()
    });
    skin(&rings, [true, false], [true, true]).across()
}

/// A closed section along a closed path.
pub fn sweep_loop(path: &[Vec3], section: &[[f64; 2]], up: Vec3) -> Body {
    let rings = swept(path, true, up, |_, _| section.to_vec());
    skin(&rings, [true, true], [false; 2]).across()
}

/// A round tube along a path, of radius `radius(t)`, capped.
pub fn tube(path: &[Vec3], sides: usize, radius: impl Fn(f64) -> f64) -> Body {
    let body = sweep(path, &circle(sides, 1.0), [0.0, 1.0, 0.0], radius);
    if sides < 10 { body.soft() } else { body }
}

/// The rings of a round tube of radius `r` along a path.
pub fn tube_rings(path: &[Vec3], r: f64) -> Vec<Vec<Vec3>> {
    let section = circle(28, r);
    swept(path, false, [0.0, 1.0, 0.0], |_, _| section.clone())
}

/// A round tube along a closed path.
pub fn tube_loop(path: &[Vec3], sides: usize, radius: f64) -> Body {
    let body = sweep_loop(path, &circle(sides, radius), [0.0, 1.0, 0.0]);
    if sides < 10 { body.soft() } else { body }
}

/// A straight round rod.
pub fn rod(a: Vec3, b: Vec3, radius: f64, sides: usize) -> Body {
    tube(&[a, b], sides, |_| radius)
}

/// A straight bar of rectangular section: `size` along `up` and across.
pub fn beam(a: Vec3, b: Vec3, size: [f64; 2], up: Vec3) -> Body {
    let [h, w] = size.map(|v| 0.5 * v);
    sweep(&[a, b], &[[h, -w], [h, w], [-h, w], [-h, -w]], up, |_| 1.0)
}

/// An open sheet over `f(s, t)`, s and t in [0, 1]; its face is on the side of (ds x dt).
pub fn sheet(columns: usize, rows: usize, f: impl Fn(f64, f64) -> Vec3) -> Body {
    let rings: Vec<Vec<Vec3>> = (0..=rows)
        .map(|j| (0..=columns).map(|i| f(i as f64 / columns as f64, j as f64 / rows as f64)).collect())
        .collect();
    skin(&rings, [false, false], [false; 2]).soft()
}

/// A sheet over `f(s, t)` of thickness `thick` below its face, closed.
pub fn slab(columns: usize, rows: usize, thick: f64, f: impl Fn(f64, f64) -> Vec3) -> Body {
    let face: Vec<Vec<Vec3>> = (0..=rows)
        .map(|j| (0..=columns).map(|i| f(i as f64 / columns as f64, j as f64 / rows as f64)).collect())
        .collect();
    let normal = |i: usize, j: usize| {
        let du = sub(face[j][(i + 1).min(columns)], face[j][i.saturating_sub(1)]);
        let dv = sub(face[(j + 1).min(rows)][i], face[j.saturating_sub(1)][i]);
        unit(cross(du, dv))
    };
    // Each row goes over the face and back under it, so that the skin closes round it.
    let rings: Vec<Vec<Vec3>> = (0..=rows)
        .map(|j| {
            let over = (0..=columns).map(|i| face[j][i]);
            let under = (0..=columns).rev().map(|i| sub(face[j][i], mul(normal(i, j), thick)));
            over.chain(under).collect()
        })
        .collect();
    let mut body = skin(&rings, [true, false], [false; 2]).soft();
    // The two open ends are strips between face and back.
    let n = 2 * columns + 2;
    for (j, first) in [(0, true), (rows, false)] {
        for i in 0..columns {
            let ring = &rings[j];
            let corners = [i, i + 1, n - 2 - i, n - 1 - i];
            let u = |k: usize| if k <= columns { k } else { n - 1 - k } as f64 / columns as f64;
            let ids = corners.map(|k| body.point(ring[k], [u(k), if k <= columns { 0.0 } else { thick }]));
            body.quad(if first { [ids[0], ids[3], ids[2], ids[1]] } else { ids });
        }
    }
    body
}
