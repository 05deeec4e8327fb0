//! Statues and abstract sculptures.

use super::{
    super::{noise::fractal, shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::geom::{Vec3, dot, length, mul, sub, unit};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("statue_figure", Family::Sculpture, 8, figure),
    form("bust", Family::Sculpture, 8, bust),
    form("sculpture_pierced", Family::Sculpture, 8, pierced),
    form("sculpture_loop", Family::Sculpture, 8, looped),
    form("sculpture_stack", Family::Sculpture, 6, stack),
];

fn plinth(m: &mut Maker, stuff: Stuff, half: f64, h: f64) {
    m.add(stuff, board([0.0, 0.5 * h, 0.0], [half, 0.5 * h, half]));
}

/// A standing figure of smooth capsules on a plinth.
fn figure(d: &mut Stream) -> FormVariant {
    let h = d.range(0.35, 1.2);
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Metal, Stuff::Plaster, Stuff::Clay]);
    let sway = d.range(-0.04, 0.04);
    let (left, right) = (d.range(0.2, 2.6), d.range(0.1, 1.2));
    let (twist, stride) = (d.range(-0.1, 0.1), d.range(-0.09, 0.09));
    let hand = |side: f64, a: f64| {
        let shoulder = [side * 0.115 + sway, 0.8, 0.0];
        let elbow = [shoulder[0] + side * 0.155 * maths::sin(a), 0.8 - 0.155 * maths::cos(a), 0.02];
        let b = a + 0.5;
        ([shoulder, elbow], [elbow[0] + side * 0.14 * maths::sin(b), elbow[1] - 0.14 * maths::cos(b), 0.08 + twist])
    };
    let (arm_l, hand_l) = hand(-1.0, left);
    let (arm_r, hand_r) = hand(1.0, right);
    let robe = d.chance(0.4);
    let distance = move |p: Vec3| {
        let p = mul(p, 1.0 / h);
        let k = 0.03;
        let mut v = ellipsoid(p, [sway, 0.93, 0.015], [0.052, 0.068, 0.06]);
        v = smooth_min(v, capsule(p, [sway, 0.82, 0.0], [sway, 0.9, 0.008], 0.03, 0.026), 0.015);
        v = smooth_min(v, ellipsoid(p, [sway, 0.72, 0.0], [0.105, 0.13, 0.065]), k);
        v = smooth_min(v, ellipsoid(p, [0.5 * sway, 0.55, 0.0], [0.085, 0.1, 0.06]), k);
        for (arm, hand) in [(arm_l, hand_l), (arm_r, hand_r)] {
            v = smooth_min(v, capsule(p, arm[0], arm[1], 0.034, 0.026), 0.02);
            v = smooth_min(v, capsule(p, arm[1], hand, 0.026, 0.018), 0.012);
        }
        for (s, z) in [(-1.0, stride), (1.0, -stride)] {
            let knee = [s * 0.05 + 0.3 * sway, 0.27, 0.4 * z + 0.02];
            let ankle = [s * 0.055, 0.04, z];
            v = smooth_min(v, capsule(p, [s * 0.045 + 0.5 * sway, 0.5, 0.0], knee, 0.056, 0.04), k);
            v = smooth_min(v, capsule(p, knee, ankle, 0.04, 0.024), 0.015);
            v = smooth_min(v, ellipsoid(p, [s * 0.058, 0.018, z + 0.03], [0.026, 0.02, 0.055]), 0.015);
        }
        if robe {
            let a = maths::atan2(p[0], p[2]);
            let flare = 0.075 + 0.07 * (0.55 - p[1]).max(0.0) / 0.55 + 0.008 * maths::sin(11.0 * a + 6.0 * p[1]);
            let skirt = ((p[0] * p[0] + 1.3 * p[2] * p[2]).sqrt() - flare).max(p[1] - 0.58).max(0.01 - p[1]);
            v = smooth_min(v, skirt * 0.8, 0.02);
        }
        v * h
    };
    let w = 0.42 * h;
    let body =
        Field { distance, low: [-w, -0.01 * h, -0.2 * h], high: [w, 1.2 * h, 0.26 * h] }.body(0.015 * h).smooth();
    let mut m = Maker::default();
    let foot = h * d.range(0.05, 0.3);
    plinth(&mut m, if d.chance(0.5) { Stuff::Stone } else { stuff }, 0.17 * h, foot);
    m.add(stuff, body.at([0.0, foot - 0.001 * h, 0.0]));
    m.made()
}

fn bust(d: &mut Stream) -> FormVariant {
    let h = d.range(0.3, 0.55);
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Plaster, Stuff::Metal, Stuff::Clay]);
    let (nose, brow, jaw, hair) = (d.range(0.018, 0.034), d.range(0.0, 0.02), d.range(0.9, 1.15), d.range(0.0, 0.05));
    let (turn, seed) = (d.range(-0.35, 0.35), d.bits());
    let distance = move |q: Vec3| {
        let p = mul(q, 1.0 / h);
        let (s, c) = (maths::sin(turn), maths::cos(turn));
        // The head turns about the neck.
        let e = [p[0] * c - p[2] * s, p[1], p[0] * s + p[2] * c];
        let mut v = ellipsoid(e, [0.0, 0.78, -0.02], [0.145, 0.19, 0.18]);
        v = smooth_min(v, ellipsoid(e, [0.0, 0.655, 0.06], [0.095 * jaw, 0.1, 0.1]), 0.06);
        v = smooth_min(v, capsule(e, [0.0, 0.785, 0.155], [0.0, 0.705, 0.165 + nose], 0.012, 0.024), 0.025);
        for x in [-1.0, 1.0] {
            v = smooth_min(v, ellipsoid(e, [x * 0.055, 0.815, 0.135 + brow], [0.05, 0.016, 0.025]), 0.03);
            v = v.max(
                0.02 - ((e[0] - x * 0.055).powi(2) + (e[1] - 0.772).powi(2) + (e[2] - 0.185).powi(2)).sqrt() + 0.008,
            );
            v = smooth_min(v, ellipsoid(e, [x * 0.055, 0.77, 0.142], [0.026, 0.017, 0.022]), 0.008);
            v = smooth_min(v, ellipsoid(e, [x * 0.148, 0.75, -0.01], [0.018, 0.045, 0.03]), 0.012);
        }
        v = smooth_min(v, ellipsoid(e, [0.0, 0.645, 0.148], [0.042, 0.012, 0.022]), 0.012);
        v = smooth_min(v, ellipsoid(e, [0.0, 0.622, 0.145], [0.036, 0.013, 0.022]), 0.01);
        if hair > 0.01 {
            let curl = 0.6 * hair * fractal(seed, mul(e, 14.0), [0; 3], 2).abs();
            let cap = ellipsoid(e, [0.0, 0.83, -0.05], [0.155, 0.17 + hair, 0.17])
                .max(0.75 - e[1] + 0.9 * (e[2] - 0.02))
                - curl;
            v = smooth_min(v, cap, 0.015);
        }
        v = smooth_min(v, capsule(p, [0.0, 0.42, -0.03], [0.0, 0.6, -0.01], 0.1, 0.085), 0.05);
        let chest = ellipsoid(p, [0.0, 0.28, -0.03], [0.33, 0.2, 0.17]).max(0.16 - p[1]);
        v = smooth_min(v, chest, 0.07);
        v * h
    };
    let body = Field { distance, low: [-0.4 * h, 0.14 * h, -0.28 * h], high: [0.4 * h, 1.08 * h, 0.3 * h] }
        .body(0.019 * h)
        .smooth();
    let mut m = Maker::default();
    m.add(stuff, body);
    m.add(
        stuff,
        lathe(
            &[
                [0.0, 0.0],
                [0.2 * h, 0.0],
                [0.2 * h, 0.03 * h],
                [0.1 * h, 0.07 * h],
                [0.09 * h, 0.12 * h],
                [0.16 * h, 0.17 * h],
                [0.0, 0.19 * h],
            ],
            28,
        ),
    );
    m.made()
}

/// A rounded mass with holes through it.
fn pierced(d: &mut Stream) -> FormVariant {
    let r = d.range(0.1, 0.35);
    let shape = [d.range(0.7, 1.0), d.range(0.8, 1.2), d.range(0.5, 0.8)];
    let seed = d.bits();
    let holes: Vec<(Vec3, Vec3, f64)> = (0..1 + d.below(3))
        .map(|_| {
            (
                [d.range(-0.3, 0.3), d.range(-0.3, 0.4), 0.0],
                unit([d.range(-0.5, 0.5), d.range(-0.5, 0.5), 1.0]),
                d.range(0.16, 0.32),
            )
        })
        .collect();
    let distance = |q: Vec3| {
        let p = mul(q, 1.0 / r);
        let body = ellipsoid(p, [0.0; 3], shape) + 0.16 * fractal(seed, mul(p, 1.1), [0; 3], 2);
        let v = holes.iter().fold(body, |v, (c, way, k)| {
            let e = sub(p, *c);
            let along = dot(e, *way);
            let hole = k + 0.12 * along * along - length(sub(e, mul(*way, along)));
            -smooth_min(-v, -hole, 0.12)
        });
        v * r * 0.8
    };
    let e = 1.35 * r;
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Metal, Stuff::Wood, Stuff::Plaster]);
    let body = Field { distance, low: [-e, -1.45 * r, -e], high: [e, 1.45 * r, e] }.body(0.07 * r).smooth();
    let low = body.points.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
    let mut m = Maker::default();
    plinth(&mut m, Stuff::Stone, 0.45 * r, 0.3 * r);
    m.add(stuff, body.at([0.0, 0.3 * r - low - 0.03 * r, 0.0]));
    m.made()
}

/// A ribbon that closes on itself, standing.
fn looped(d: &mut Stream) -> FormVariant {
    let r = d.range(0.1, 0.3);
    let (a, b, phase) = (1.0 + d.below(2) as f64, 2.0 + d.below(2) as f64, d.range(0.0, TAU));
    let path: Vec<Vec3> = (0..160)
        .map(|k| {
            let t = TAU * f64::from(k) / 160.0;
            let q = r * (1.0 + 0.35 * maths::cos(b * t + phase));
            [q * maths::cos(a * t), 0.8 * r * maths::sin(b * t + 0.3 * phase) + 1.4 * r, q * maths::sin(a * t) * 0.8]
        })
        .collect();
    let (w, t) = (r * d.range(0.1, 0.2), r * d.range(0.05, 0.1));
    let section: Vec<_> = rounded_rect([t, w], 0.9 * t, 3);
    let body = sweep_loop(&path, &section, [0.0, 1.0, 0.0]).smooth();
    let low = body.points.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
    let at = body.points.iter().copied().min_by(|a, b| a[1].total_cmp(&b[1])).unwrap_or([0.0; 3]);
    let mut m = Maker::default();
    let foot = 0.2 * r;
    m.add(Stuff::Stone, board([0.0, 0.5 * foot, 0.0], [0.7 * r, 0.5 * foot, 0.5 * r]));
    m.add(*d.pick(&[Stuff::Metal, Stuff::PaintedMetal, Stuff::Wood]), body.at([-at[0], foot - low - 0.01 * r, -at[2]]));
    m.made()
}

/// Balanced stones or solids.
fn stack(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let mut y = 0.0;
    let mut r = d.range(0.08, 0.15);
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Stone, Stuff::Ceramic]);
    for _ in 0..3 + d.below(4) {
        let seed = d.bits();
        let flat = d.range(0.4, 0.7);
        let body = icosphere(3, |p| r * (1.0 + 0.1 * fractal(seed, mul(p, 1.2), [0; 3], 2))).scaled([1.0, flat, 0.85]);
        // Its lowest and highest parts are planed, so that one rests on another.
        let (low, high) = (-0.93 * flat * r, 0.93 * flat * r);
        let body = body.bent(|p| {
            [
                p[0],
                if p[1] < low {
                    low + 0.03 * (p[1] - low)
                } else if p[1] > high {
                    high + 0.03 * (p[1] - high)
                } else {
                    p[1]
                },
                p[2],
            ]
        });
        let foot = body.points.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
        let top = body.points.iter().map(|p| p[1]).fold(f64::NEG_INFINITY, f64::max);
        let (dx, dz) = (0.08 * r * d.range(-1.0, 1.0), 0.08 * r * d.range(-1.0, 1.0));
        let turn = d.range(0.0, TAU);
        m.add(stuff, body.turned_y(turn).at([dx, y - foot, dz]));
        y += top - foot;
        r *= d.range(0.65, 0.95);
    }
    m.made()
}
