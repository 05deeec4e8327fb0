//! Pipes, valves, brackets and housings.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    machine::metal,
    maker::Maker,
};
use tauflow_data::geom::{Vec3, sub, unit};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("pipe_elbow", Family::MachinePart, 8, elbow),
    form("pipe_run", Family::MachinePart, 8, run),
    form("bracket", Family::MachinePart, 8, bracket),
    form("valve", Family::MachinePart, 6, valve),
    form("housing", Family::MachinePart, 6, housing),
];

fn pipe(path: &[Vec3], r: f64, bore: f64) -> Body {
    // A skin out along the outside and back along the inside.
    let outer = tube_rings(path, r);
    let inner = tube_rings(path, bore);
    let rings: Vec<_> = outer.into_iter().chain(inner.into_iter().rev()).collect();
    skin(&rings, [true, true], [false; 2]).across()
}

fn elbow(d: &mut Stream) -> FormVariant {
    let (r, bend) = (d.range(0.015, 0.05), d.range(1.6, 2.6));
    let stuff = *d.pick(&[Stuff::Metal, Stuff::Plastic, Stuff::PaintedMetal]);
    let angle = *d.pick(&[0.5 * PI, 0.5 * PI, 0.25 * PI]);
    let big = bend * r;
    let mut path: Vec<Vec3> = vec![[0.0, -1.2 * r, 0.0]];
    path.extend(
        (0..=12).map(|k| angle * f64::from(k) / 12.0).map(|a| [big * (1.0 - maths::cos(a)), big * maths::sin(a), 0.0]),
    );
    let end = path[path.len() - 1];
    let way = [maths::sin(angle), maths::cos(angle), 0.0];
    path.push([end[0] + 1.2 * r * way[0], end[1] + 1.2 * r * way[1], 0.0]);
    let mut m = Maker::default();
    m.add(stuff, pipe(&path, r, 0.82 * r));
    let collar = |k: f64| [path[path.len() - 1][0] - k * way[0], path[path.len() - 1][1] - k * way[1], 0.0];
    m.add(stuff, pipe(&[[0.0, -1.25 * r, 0.0], [0.0, -0.5 * r, 0.0]], 1.2 * r, 0.95 * r));
    m.add(stuff, pipe(&[collar(0.7 * r), collar(-0.05 * r)], 1.2 * r, 0.95 * r));
    m.made()
}

/// A pipe along a wall with bends, clamps and a flange.
fn run(d: &mut Stream) -> FormVariant {
    let r = d.range(0.012, 0.04);
    let mut corners: Vec<Vec3> = vec![[0.0, 0.0, 0.0]];
    let mut p: Vec3 = [0.0, 0.0, 0.0];
    let mut axis = 1;
    for _ in 0..3 + d.below(3) {
        p[axis] += d.range(0.2, 0.6);
        corners.push(p);
        axis = if axis == 1 { 2 * d.below(2) } else { 1 };
    }
    let path = fillet(&corners, 3.0 * r, 6);
    let stuff = *d.pick(&[Stuff::Metal, Stuff::PaintedMetal, Stuff::Plastic]);
    let mut m = Maker::default();
    m.add(stuff, tube(&path, 16, |_| r));
    for pair in corners.windows(2) {
        let mid = [0, 1, 2].map(|i| 0.5 * (pair[0][i] + pair[1][i]));
        let way = unit(sub(pair[1], pair[0]));
        let e = |k: f64| [mid[0] + k * way[0], mid[1] + k * way[1], mid[2] + k * way[2]];
        m.add(Stuff::Metal, rod(e(-0.008), e(0.008), 1.25 * r, 16));
    }
    m.add(stuff, rod([0.0, 0.0, 0.0], [0.0, 0.012, 0.0], 2.0 * r, 24));
    m.made()
}

/// An angle with ribs and holes, cut from solids.
fn bracket(d: &mut Stream) -> FormVariant {
    let (a, b, w, t) = (d.range(0.04, 0.08), d.range(0.04, 0.08), d.range(0.02, 0.035), d.range(0.004, 0.007));
    let hole = w * d.range(0.18, 0.28);
    let round = 0.5 * t;
    let distance = move |p: Vec3| {
        let plate = |c: Vec3, h: Vec3| {
            let q = [0, 1, 2].map(|i| (p[i] - c[i]).abs() - h[i]);
            let out = q.map(|v| v.max(0.0));
            (out[0] * out[0] + out[1] * out[1] + out[2] * out[2]).sqrt() + q[0].max(q[1]).max(q[2]).min(0.0)
        };
        let foot = plate([0.5 * a, 0.5 * t, 0.0], [0.5 * a, 0.5 * t, w]);
        let back = plate([0.5 * t, 0.5 * b, 0.0], [0.5 * t, 0.5 * b, w]);
        let rib = plate([0.3 * a, 0.3 * b, 0.0], [0.3 * a, 0.3 * b, 0.5 * t])
            .max((p[0] / (0.62 * a) + p[1] / (0.62 * b) - 1.0) * 0.5 * a.min(b));
        let all = smooth_min(smooth_min(foot, back, round), rib, round);
        let holes = [0.35, 0.78].iter().fold(f64::INFINITY, |v, s| {
            let x = v.min(cylinder_field(p, [s * a, 0.0, 0.55 * w], 1, hole, 1.0));
            let x = x.min(cylinder_field(p, [s * a, 0.0, -0.55 * w], 1, hole, 1.0));
            x.min(cylinder_field(p, [0.0, s * b, 0.55 * w], 0, hole, 1.0)).min(cylinder_field(
                p,
                [0.0, s * b, -0.55 * w],
                0,
                hole,
                1.0,
            ))
        });
        all.max(-holes)
    };
    let e = 0.002;
    let stuff = metal(d);
    let mut m = Maker::default();
    m.add(stuff, Field { distance, low: [-e, -e, -w - e], high: [a + e, b + e, w + e] }.body(0.0019));
    m.made()
}

fn valve(d: &mut Stream) -> FormVariant {
    let r = d.range(0.015, 0.035);
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Metal, Stuff::PaintedMetal]);
    let l = 3.0 * r;
    let body = lathe(
        &[
            [0.0, -l],
            [1.5 * r, -l],
            [1.5 * r, -l + 0.5 * r],
            [r, -l + 0.6 * r],
            [r, -1.3 * r],
            [1.5 * r, -0.5 * r],
            [1.5 * r, 0.5 * r],
            [r, 1.3 * r],
            [r, l - 0.6 * r],
            [1.5 * r, l - 0.5 * r],
            [1.5 * r, l],
            [0.0, l],
        ],
        32,
    );
    m.add(stuff, body.turned_z(0.5 * PI));
    m.add(
        stuff,
        lathe(
            &[
                [0.0, 0.0],
                [r, 0.0],
                [r, 2.0 * r],
                [1.4 * r, 2.1 * r],
                [1.4 * r, 2.5 * r],
                [0.5 * r, 2.8 * r],
                [0.4 * r, 3.2 * r],
                [0.0, 3.2 * r],
            ],
            28,
        ),
    );
    m.add(Stuff::Metal, rod([0.0, 3.0 * r, 0.0], [0.0, 5.0 * r, 0.0], 0.25 * r, 12));
    let (wheel, y) = (2.2 * r, 4.6 * r);
    let spokes = 4 + d.below(3);
    m.another(Stuff::PaintedMetal, tube_loop(&ring_path(wheel, y, 40), 10, 0.22 * r));
    for k in 0..spokes {
        let a = TAU * k as f64 / spokes as f64;
        m.add(Stuff::PaintedMetal, rod([0.0, y, 0.0], [wheel * maths::sin(a), y, wheel * maths::cos(a)], 0.15 * r, 8));
    }
    m.made()
}

/// A cast housing: a drum blended with a foot, bored through, with fins.
fn housing(d: &mut Stream) -> FormVariant {
    let (r, l) = (d.range(0.04, 0.06), d.range(0.05, 0.08));
    let (fins, bore) = (3 + d.below(5), r * d.range(0.45, 0.65));
    let y = 1.25 * r;
    let distance = move |p: Vec3| {
        let drum = cylinder_field(p, [0.0, y, 0.0], 0, r, l);
        let q = [p[0].abs() - l * 1.05, (p[1] - 0.006).abs() - 0.006, p[2].abs() - 1.5 * r];
        let foot = q[0].max(q[1]).max(q[2]);
        let web = [p[0].abs() - 0.5 * l, (p[1] - 0.5 * y).abs() - 0.5 * y, p[2].abs() - 0.5 * r];
        let body = smooth_min(smooth_min(drum, foot, 0.012), web[0].max(web[1]).max(web[2]), 0.012);
        let fin = (0..fins).fold(f64::INFINITY, |v, k| {
            let x = l * (2.0 * (k as f64 + 0.5) / fins as f64 - 1.0);
            v.min(cylinder_field(p, [x, y, 0.0], 0, 1.22 * r, 0.0022).max(0.4 * r - p[1] + 0.3 * y))
        });
        let hole = cylinder_field(p, [0.0, y, 0.0], 0, bore, 2.0 * l);
        let bolts = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)].iter().fold(f64::INFINITY, |v, (x, z)| {
            v.min(cylinder_field(p, [x * 0.75 * l, 0.0, z * 1.28 * r], 1, 0.0045, 1.0))
        });
        body.min(fin).max(-hole).max(-bolts)
    };
    let e = 0.003;
    let stuff = metal(d);
    let mut m = Maker::default();
    m.add(
        stuff,
        Field { distance, low: [-1.05 * l - e, -e, -1.5 * r - e], high: [1.05 * l + e, y + 1.22 * r + e, 1.5 * r + e] }
            .body(0.0048),
    );
    m.made()
}
