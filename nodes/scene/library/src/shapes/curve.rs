//! Curves as lists of points: circles, arcs, splines, rounded corners. Knows no surface.

use super::TAU;
use tauflow_data::geom::{Vec3, add, length, mul, sub};
use tauflow_data::maths;

/// `n` points of a circle of radius `r`, counter-clockwise from (r, 0).
pub fn circle(n: usize, r: f64) -> Vec<[f64; 2]> {
    (0..n)
        .map(|i| {
            let a = TAU * i as f64 / n as f64;
            [r * maths::cos(a), r * maths::sin(a)]
        })
        .collect()
}

/// `n + 1` points of an arc about `center` from angle `from` to `to`, radians.
pub fn arc(center: [f64; 2], r: f64, from: f64, to: f64, n: usize) -> Vec<[f64; 2]> {
    (0..=n)
        .map(|i| {
            let a = from + (to - from) * i as f64 / n as f64;
            [center[0] + r * maths::cos(a), center[1] + r * maths::sin(a)]
        })
        .collect()
}

/// `n + 1` points from `a` to `b`.
pub fn line(a: Vec3, b: Vec3, n: usize) -> Vec<Vec3> {
    (0..=n).map(|i| add(a, mul(sub(b, a), i as f64 / n as f64))).collect()
}

fn weights(s: f64) -> [f64; 4] {
    let (s2, s3) = (s * s, s * s * s);
    [0.5 * (2.0 * s2 - s - s3), 0.5 * (2.0 - 5.0 * s2 + 3.0 * s3), 0.5 * (s + 4.0 * s2 - 3.0 * s3), 0.5 * (s3 - s2)]
}

fn catmull_rom<const N: usize>(points: &[[f64; N]], each: usize, closed: bool) -> Vec<[f64; N]> {
    let n = points.len();
    let spans = if closed { n } else { n - 1 };
    let mut out = Vec::with_capacity(spans * each + 1);
    for span in 0..spans {
        let at = |k: i64| {
            let k = span as i64 + k;
            points[if closed { k.rem_euclid(n as i64) as usize } else { k.clamp(0, n as i64 - 1) as usize }]
        };
        let near = [at(-1), at(0), at(1), at(2)];
        for step in 0..each {
            let w = weights(step as f64 / each as f64);
            out.push(core::array::from_fn(|i| (0..4).map(|k| w[k] * near[k][i]).sum()));
        }
    }
    if !closed {
        out.push(points[n - 1]);
    }
    out
}

/// A smooth curve through points (uniform Catmull-Rom), `each` steps between two.
pub fn spline(points: &[Vec3], each: usize) -> Vec<Vec3> {
    catmull_rom(points, each, false)
}

/// [`spline`] in the plane, as for profiles.
pub fn flat_spline(points: &[[f64; 2]], each: usize) -> Vec<[f64; 2]> {
    catmull_rom(points, each, false)
}

/// [`flat_spline`] that closes on itself; the first point is not repeated.
pub fn closed_spline(points: &[[f64; 2]], each: usize) -> Vec<[f64; 2]> {
    catmull_rom(points, each, true)
}

/// A polyline whose inner corners are rounded over at most `r` to both sides, in `n` steps.
pub fn fillet(points: &[Vec3], r: f64, n: usize) -> Vec<Vec3> {
    let last = points.len() - 1;
    let mut out = vec![points[0]];
    for k in 1..last {
        let corner = points[k];
        let toward = |to: Vec3| {
            let d = sub(to, corner);
            let l = length(d).max(1e-12);
            add(corner, mul(d, r.min(0.45 * l) / l))
        };
        let (a, b) = (toward(points[k - 1]), toward(points[k + 1]));
        for i in 0..=n {
            let t = i as f64 / n as f64;
            let (wa, wc, wb) = ((1.0 - t) * (1.0 - t), 2.0 * t * (1.0 - t), t * t);
            out.push(add(add(mul(a, wa), mul(corner, wc)), mul(b, wb)));
        }
    }
    out.push(points[last]);
    out
}

/// `n` points of a level circle of radius `r` at height `y`, from +z towards +x.
pub fn ring_path(r: f64, y: f64, n: usize) -> Vec<Vec3> {
    circle(n, r).into_iter().map(|[c, s]| [s, y, c]).collect()
}
