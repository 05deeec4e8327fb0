//! Outlines drawn out along z, with holes; polygons cut into triangles by clipping ears (Meisters 1975).

use super::{Body, arc, skin};
use tauflow_data::geom::Vec3;

type Point = [f64; 2];

fn turn(a: Point, b: Point, c: Point) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn area(outline: &[Point]) -> f64 {
    (0..outline.len()).map(|i| turn([0.0; 2], outline[i], outline[(i + 1) % outline.len()])).sum::<f64>() * 0.5
}

fn inside(p: Point, a: Point, b: Point, c: Point) -> bool {
    turn(a, b, p) >= -1e-15 && turn(b, c, p) >= -1e-15 && turn(c, a, p) >= -1e-15
}

/// Triangles over a simple polygon, counter-clockwise, by its points' numbers.
fn triangulated(points: &[Point], polygon: &[u32]) -> Vec<[u32; 3]> {
    let mut left: Vec<u32> = polygon.to_vec();
    let at = |i: u32| points[i as usize];
    let mut out = Vec::with_capacity(left.len());
    while left.len() > 3 {
        let n = left.len();
        let ear = |k: usize| {
            let (a, b, c) = (left[(k + n - 1) % n], left[k], left[(k + 1) % n]);
            let [pa, pb, pc] = [a, b, c].map(at);
            turn(pa, pb, pc) > 1e-14
                && left.iter().all(|i| {
                    let p = at(*i);
                    p == pa || p == pb || p == pc || !inside(p, pa, pb, pc)
                })
        };
        // The ear of the shortest diagonal keeps triangles round; without an ear the shortest diagonal goes anyway.
        let diagonal = |k: usize| {
            let (a, c) = (at(left[(k + n - 1) % n]), at(left[(k + 1) % n]));
            (a[0] - c[0]).powi(2) + (a[1] - c[1]).powi(2)
        };
        let k = (0..n)
            .filter(|k| ear(*k))
            .min_by(|a, b| diagonal(*a).total_cmp(&diagonal(*b)))
            .unwrap_or_else(|| (0..n).min_by(|a, b| diagonal(*a).total_cmp(&diagonal(*b))).unwrap_or(0));
        out.push([left[(k + n - 1) % n], left[k], left[(k + 1) % n]]);
        left.remove(k);
    }
    out.push([left[0], left[1], left[2]]);
    out
}

/// An outline, counter-clockwise in (x, y) or turned so, drawn from z = -depth / 2 to depth / 2; closed.
pub fn extrude(outline: &[Point], depth: f64) -> Body {
    extrude_with_holes(outline, &[], depth)
}

/// [`extrude`] with holes, each inside the outline and apart from the others.
pub fn extrude_with_holes(outline: &[Point], holes: &[Vec<Point>], depth: f64) -> Body {
    let oriented = |path: &[Point], sign: f64| {
        let mut path = path.to_vec();
        if area(&path) * sign < 0.0 {
            path.reverse();
        }
        path
    };
    let outline = oriented(outline, 1.0);
    let mut holes: Vec<Vec<Point>> = holes.iter().map(|h| oriented(h, -1.0)).collect();
    let wall = |path: &[Point]| {
        let ring = |z: f64| path.iter().map(|[x, y]| [*x, *y, z]).collect::<Vec<Vec3>>();
        skin(&[ring(-0.5 * depth), ring(0.5 * depth)], [true, false], [false; 2])
    };
    let mut body = holes.iter().fold(wall(&outline), |body, hole| body.with(wall(hole)));
    // Holes join the outline by a bridge each, the rightmost first, so that one polygon is left.
    let right = |hole: &[Point]| hole.iter().map(|p| p[0]).fold(f64::NEG_INFINITY, f64::max);
    holes.sort_by(|a, b| right(b).total_cmp(&right(a)));
    let mut points = outline.clone();
    let mut polygon: Vec<u32> = (0..outline.len() as u32).collect();
    for hole in &holes {
        let base = points.len() as u32;
        points.extend(hole);
        let start = (0..hole.len()).max_by(|a, b| hole[*a][0].total_cmp(&hole[*b][0])).unwrap_or(0);
        let from = hole[start];
        // The nearest corner to the right of the hole that is seen from it.
        let crosses = |to: Point| {
            (0..polygon.len()).any(|k| {
                let a = points[polygon[k] as usize];
                let b = points[polygon[(k + 1) % polygon.len()] as usize];
                a != to
                    && b != to
                    && turn(from, to, a) * turn(from, to, b) < 0.0
                    && turn(a, b, from) * turn(a, b, to) < 0.0
            })
        };
        let distance = |to: Point| (to[0] - from[0]).powi(2) + (to[1] - from[1]).powi(2);
        let seen = (0..polygon.len())
            .filter(|k| points[polygon[*k] as usize][0] >= from[0] && !crosses(points[polygon[*k] as usize]))
            .min_by(|a, b| distance(points[polygon[*a] as usize]).total_cmp(&distance(points[polygon[*b] as usize])))
            .unwrap_or(0);
        let around = (0..=hole.len()).map(|k| base + ((start + k) % hole.len()) as u32);
        let bridge: Vec<u32> = around.chain([polygon[seen]]).collect();
        polygon.splice(seen + 1..seen + 1, bridge);
    }
    let triangles = triangulated(&points, &polygon);
    for (z, front) in [(-0.5 * depth, false), (0.5 * depth, true)] {
        let base = body.points.len() as u32;
        for [x, y] in &points {
            body.point([*x, *y, z], [if front { *x } else { -x }, -y]);
        }
        body.triangles.extend(triangles.iter().map(|[a, b, c]| {
            let t = if front { [*a, *b, *c] } else { [*a, *c, *b] };
            t.map(|i| i + base)
        }));
    }
    body
}

/// A rectangle about the origin with round corners, counter-clockwise; half size, radius, steps a corner.
pub fn rounded_rect(half: [f64; 2], r: f64, n: usize) -> Vec<Point> {
    let quarter = 0.5 * super::PI;
    (0..4)
        .flat_map(|k| {
            let (sx, sy) = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)][k];
            let center = [sx * (half[0] - r), sy * (half[1] - r)];
            arc(center, r, quarter * k as f64, quarter * (k + 1) as f64, n)
        })
        .collect()
}
