//! Sculptures, toys, ornaments, simple solids.

use super::{
    super::{noise::fractal, shapes::*, stuff::Stuff},
    Family, Form, Made, form,
    maker::Maker,
    solid,
};
use crate::geom::{Vec3, length, mul, sub, unit};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("statue_figure", Family::Sculpture, 8, figure),
    form("bust", Family::Sculpture, 8, bust),
    form("sculpture_pierced", Family::Sculpture, 8, pierced),
    form("sculpture_loop", Family::Sculpture, 8, looped),
    form("sculpture_stack", Family::Sculpture, 6, stack),
    form("toy_car", Family::Toy, 8, car),
    form("chess_pieces", Family::Toy, 8, chess),
    form("chess_board", Family::Toy, 4, chess_board),
    form("building_blocks", Family::Toy, 8, blocks),
    form("ring_stacker", Family::Toy, 6, stacker),
    form("toy_bear", Family::Toy, 6, bear),
    form("ball_toy", Family::Toy, 4, toy_ball),
    form("candlestick", Family::Ornament, 8, candlestick),
    form("trophy", Family::Ornament, 6, trophy),
    form("seashell", Family::Ornament, 6, shell),
    form("hourglass", Family::Ornament, 6, hourglass),
    form("globe_earth", Family::Ornament, 6, earth),
    solid("sphere", Family::Solid, 3, sphere),
    solid("block_rounded", Family::Solid, 12, rounded),
    solid("torus", Family::Solid, 10, torus),
    solid("knot", Family::Solid, 10, knot),
    solid("superellipsoid", Family::Solid, 12, superellipsoid),
    solid("gem", Family::Solid, 10, gem),
    solid("crystal", Family::Solid, 10, crystal),
    solid("star_prism", Family::Solid, 8, star),
    solid("capsule", Family::Solid, 6, pill),
    solid("cone", Family::Solid, 8, cone),
    solid("polyhedron", Family::Solid, 5, polyhedron),
    solid("prism_glass", Family::Solid, 5, glass_prism),
    solid("drop", Family::Solid, 6, drop),
];

fn one(stuff: Stuff, body: Body) -> Made {
    let mut m = Maker::default();
    m.add(stuff, body);
    m.made()
}

fn solid_stuff(d: &mut Stream) -> Stuff {
    *d.pick(&[Stuff::Glass, Stuff::Ceramic, Stuff::Metal, Stuff::Stone, Stuff::Plastic, Stuff::Wood])
}

fn plinth(m: &mut Maker, stuff: Stuff, half: f64, h: f64) {
    m.add(stuff, board([0.0, 0.5 * h, 0.0], [half, 0.5 * h, half]));
}

/// A standing figure of smooth capsules on a plinth.
fn figure(d: &mut Stream) -> Made {
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
        Field { distance, low: [-w, -0.01 * h, -0.2 * h], high: [w, 1.2 * h, 0.26 * h] }.body(0.0135 * h).smooth();
    let mut m = Maker::default();
    let foot = h * d.range(0.05, 0.3);
    plinth(&mut m, if d.chance(0.5) { Stuff::Stone } else { stuff }, 0.17 * h, foot);
    m.add(stuff, body.at([0.0, foot - 0.001 * h, 0.0]));
    m.made()
}

fn bust(d: &mut Stream) -> Made {
    let h = d.range(0.3, 0.55);
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Plaster, Stuff::Metal, Stuff::Clay]);
    let (nose, brow, jaw, hair) = (d.range(0.03, 0.05), d.range(0.0, 0.025), d.range(0.85, 1.1), d.range(0.0, 0.05));
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
        .body(0.0175 * h)
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
fn pierced(d: &mut Stream) -> Made {
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
            let along = crate::geom::dot(e, *way);
            let hole = k + 0.12 * along * along - length(sub(e, mul(*way, along)));
            -smooth_min(-v, -hole, 0.12)
        });
        v * r * 0.8
    };
    let e = 1.35 * r;
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Metal, Stuff::Wood, Stuff::Plaster]);
    let body = Field { distance, low: [-e, -1.45 * r, -e], high: [e, 1.45 * r, e] }.body(0.062 * r).smooth();
    let low = body.points.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
    let mut m = Maker::default();
    plinth(&mut m, Stuff::Stone, 0.45 * r, 0.3 * r);
    m.add(stuff, body.at([0.0, 0.3 * r - low - 0.03 * r, 0.0]));
    m.made()
}

/// A ribbon that closes on itself, standing.
fn looped(d: &mut Stream) -> Made {
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
fn stack(d: &mut Stream) -> Made {
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

fn car(d: &mut Stream) -> Made {
    let l = d.range(0.05, 0.12);
    let (w, h) = (0.42 * l, l * d.range(0.36, 0.5));
    let hood = d.range(0.2, 0.45);
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Wood, Stuff::Plastic]);
    let mut m = Maker::default();
    let base = 0.12 * l;
    let low = closed_spline(
        &[
            [-l, base],
            [l, base],
            [1.03 * l, base + 0.3 * h],
            [0.9 * l, base + 0.45 * h],
            [hood * l, base + 0.52 * h],
            [0.0, base + 0.53 * h],
            [-0.9 * l, base + 0.5 * h],
            [-1.03 * l, base + 0.3 * h],
        ],
        3,
    );
    m.add(stuff, extrude(&low, 2.0 * w).soft());
    let cab =
        [[hood * l, base + 0.5 * h], [(hood - 0.25) * l, base + h], [-0.5 * l, base + h], [-0.75 * l, base + 0.5 * h]];
    m.add(stuff, extrude(&cab, 1.72 * w));
    for s in [-1.0, 1.0] {
        let glass = [
            [(hood - 0.1) * l, base + 0.56 * h],
            [(hood - 0.29) * l, base + 0.93 * h],
            [-0.48 * l, base + 0.93 * h],
            [-0.65 * l, base + 0.56 * h],
        ];
        m.add(Stuff::Plastic, extrude(&glass, 0.004 * l).at([0.0, 0.0, s * 0.863 * w]));
    }
    let r = l * d.range(0.17, 0.24);
    for (x, s) in [(-0.62, -1.0), (0.62, -1.0), (-0.62, 1.0), (0.62, 1.0)] {
        let wheel = lathe(
            &[
                [0.0, -0.05 * l],
                [0.9 * r, -0.06 * l],
                [r, -0.03 * l],
                [r, 0.04 * l],
                [0.6 * r, 0.06 * l],
                [0.55 * r, 0.04 * l],
                [0.0, 0.05 * l],
            ],
            20,
        );
        m.add(Stuff::Rubber, wheel.turned_x(s * 0.5 * PI).at([x * l, r, s * w]));
    }
    m.made()
}

fn piece(kind: usize, s: f64) -> Vec<Body> {
    let r = 0.017 * s;
    let base = |top: f64, neck: f64| {
        vec![
            [0.0, 0.0],
            [r, 0.0],
            [r, 0.004 * s],
            [0.85 * r, 0.007 * s],
            [0.9 * r, 0.01 * s],
            [0.6 * r, 0.016 * s],
            [neck, 0.6 * top],
            [1.2 * neck, 0.85 * top],
        ]
    };
    let closed = |mut p: Vec<[f64; 2]>, more: &[[f64; 2]]| {
        p.extend_from_slice(more);
        lathe(&p, 20)
    };
    match kind {
        0 => {
            let h = 0.038 * s;
            vec![
                closed(base(h, 0.33 * r), &[[0.6 * r, 0.87 * h], [0.35 * r, 0.92 * h], [0.0, 0.92 * h]]),
                ball(0.5 * r, 16).at([0.0, 1.03 * h, 0.0]),
            ]
        }
        1 => {
            let h = 0.045 * s;
            let mut out = vec![closed(base(h, 0.5 * r), &[[0.8 * r, 0.9 * h], [0.8 * r, h], [0.0, h]])];
            for k in 0..5 {
                let a = TAU * f64::from(k) / 5.0;
                out.push(block([0.63 * r, 1.06 * h, 0.0], [0.14 * r, 0.065 * h, 0.27 * r]).turned_y(a));
            }
            out
        }
        2 => {
            let h = 0.055 * s;
            vec![
                closed(
                    base(h, 0.36 * r),
                    &[
                        [0.62 * r, 0.87 * h],
                        [0.3 * r, 0.9 * h],
                        [0.5 * r, 1.02 * h],
                        [0.42 * r, 1.12 * h],
                        [0.1 * r, 1.24 * h],
                        [0.0, 1.24 * h],
                    ],
                ),
                ball(0.12 * r, 10).at([0.0, 1.26 * h, 0.0]),
            ]
        }
        3 => {
            let h = 0.065 * s;
            let mut out = vec![closed(
                base(h, 0.42 * r),
                &[[0.68 * r, 0.87 * h], [0.4 * r, 0.9 * h], [0.7 * r, 1.1 * h], [0.4 * r, 1.13 * h], [0.0, 1.15 * h]],
            )];
            out.push(block([0.0, 1.21 * h, 0.0], [0.08 * r, 0.09 * h, 0.08 * r]));
            out.push(block([0.0, 1.23 * h, 0.0], [0.27 * r, 0.02 * h, 0.075 * r]));
            out
        }
        _ => {
            // The knight: a base and a horse's head.
            let h = 0.05 * s;
            let head = [
                [-0.75, 0.2],
                [0.6, 0.2],
                [0.45, 0.5],
                [0.55, 0.75],
                [0.95, 0.72],
                [1.05, 0.85],
                [0.75, 1.02],
                [0.35, 1.12],
                [0.15, 1.22],
                [0.05, 1.12],
                [-0.4, 1.05],
                [-0.75, 0.75],
                [-0.85, 0.45],
            ];
            let outline: Vec<_> = head.iter().map(|[x, y]| [x * 0.8 * r, y * h]).collect();
            vec![
                lathe(
                    &[
                        [0.0, 0.0],
                        [r, 0.0],
                        [r, 0.004 * s],
                        [0.85 * r, 0.007 * s],
                        [0.9 * r, 0.011 * s],
                        [0.7 * r, 0.013 * s],
                        [0.0, 0.013 * s],
                    ],
                    20,
                ),
                extrude(&closed_spline(&outline, 2), 0.8 * r).soft(),
            ]
        }
    }
}

fn chess(d: &mut Stream) -> Made {
    let mut m = Maker::default();
    let s = d.range(0.8, 1.4);
    let count = 2 + d.below(5);
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Stone, Stuff::Plastic]);
    for k in 0..count {
        let kind = d.below(5);
        let (x, z) = (0.05 * s * (k % 3) as f64, 0.05 * s * (k / 3) as f64);
        let (dx, dz, turn) = (0.006 * d.range(-1.0, 1.0), 0.006 * d.range(-1.0, 1.0), d.range(0.0, TAU));
        let body = Body::all(piece(kind, s)).turned_y(turn).at([x + dx, 0.0, z + dz]);
        if k < 2 { m.another(stuff, body) } else { m.add(stuff, body) }
    }
    m.made()
}

fn chess_board(d: &mut Stream) -> Made {
    let mut m = Maker::default();
    let q = 0.05;
    m.add(Stuff::Wood, board([0.0, 0.008, 0.0], [4.5 * q, 0.008, 4.5 * q]));
    for dark in [0, 1] {
        let squares = Body::all((0..64).filter(|k| (k / 8 + k % 8) % 2 == dark).map(|k| {
            let (i, j) = (f64::from(k / 8), f64::from(k % 8));
            panel([q * (i - 3.5), 0.0164, q * (j - 3.5)], [0.5 * q, 0.0005, 0.5 * q])
        }));
        m.another(Stuff::Wood, squares);
    }
    m.top([0.0, 0.0169, 0.0], [3.9 * q, 3.9 * q], f64::INFINITY);
    for side in [0, 1] {
        let mut first = true;
        for k in 0..16 {
            if !d.chance(0.55) {
                continue;
            }
            let kind = if k < 8 { 0 } else { [1, 4, 2, 3, 3, 2, 4, 1][k - 8] };
            let row = if k < 8 { 1 + d.below(3) } else { 0 };
            let row = if side == 0 { row as f64 } else { 7.0 - row as f64 };
            let at = [q * ((k % 8) as f64 - 3.5), 0.0168, q * (row - 3.5)];
            let turn = if side == 0 { 0.5 * PI } else { -0.5 * PI };
            m.another_of(Stuff::Wood, first, Body::all(piece(kind, 1.1)).turned_y(-turn).at(at));
            first = false;
        }
    }
    m.made()
}

fn blocks(d: &mut Stream) -> Made {
    let mut m = Maker::default();
    let q = d.range(0.02, 0.03);
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Wood, Stuff::Plastic]);
    let columns = 2 + d.below(3);
    for c in 0..columns {
        let x = 2.5 * q * c as f64;
        let high = 1 + d.below(4);
        let mut y = 0.0;
        for k in 0..high {
            let turn = d.range(-0.3, 0.3);
            let last = k + 1 == high;
            let (body, h) = match d.below(if last { 4 } else { 2 }) {
                0 => (soft_block([0.0, q, 0.0], [q, q, q], 0.08 * q, 1), 2.0 * q),
                1 => (rod([0.0, 0.0, 0.0], [0.0, 1.4 * q, 0.0], 0.95 * q, 24), 1.4 * q),
                2 => (extrude(&[[-q, 0.0], [q, 0.0], [0.0, 1.5 * q]], 2.0 * q), 1.5 * q),
                _ => (lathe(&[[0.0, 0.0], [0.95 * q, 0.0], [0.0, 2.0 * q]], 24), 2.0 * q),
            };
            m.another(stuff, body.turned_y(turn).at([x, y, 0.3 * q * d.range(-1.0, 1.0)]));
            y += h;
        }
    }
    m.made()
}

fn stacker(d: &mut Stream) -> Made {
    let mut m = Maker::default();
    let count = 4 + d.below(3);
    let r = d.range(0.045, 0.06);
    m.add(Stuff::Wood, lathe(&[[0.0, 0.0], [1.1 * r, 0.0], [1.1 * r, 0.01], [r, 0.014], [0.0, 0.014]], 32));
    let mut y = 0.014;
    for k in 0..count {
        let big = r * (1.0 - 0.5 * k as f64 / count as f64);
        let minor = 0.011;
        m.another(
            *d.pick(&[Stuff::Plastic, Stuff::Wood]),
            lathe_loop(&arc([big - minor, y + minor], minor, -PI, PI - TAU / 14.0, 13), 32).smooth(),
        );
        y += 1.98 * minor;
    }
    m.add(Stuff::Wood, rod([0.0, 0.012, 0.0], [0.0, y + 0.005, 0.0], 0.009, 14));
    m.add(Stuff::Wood, ball(0.018, 18).at([0.0, y + 0.018, 0.0]));
    m.made()
}

fn bear(d: &mut Stream) -> Made {
    let s = d.range(0.12, 0.3);
    let (ear, belly, snout) = (d.range(0.07, 0.12), d.range(0.2, 0.26), d.range(0.05, 0.1));
    let seed = d.bits();
    let distance = move |q: Vec3| {
        let p = mul(q, 1.0 / s);
        let mut v = ellipsoid(p, [0.0, 0.28, 0.0], [belly, 0.27, belly * 0.95]);
        v = smooth_min(v, ellipsoid(p, [0.0, 0.7, 0.02], [0.22, 0.2, 0.2]), 0.05);
        v = smooth_min(v, ellipsoid(p, [0.0, 0.65, 0.2], [0.09, 0.075, snout + 0.03]), 0.03);
        for x in [-1.0, 1.0] {
            v = smooth_min(v, ellipsoid(p, [x * 0.17, 0.87, 0.0], [ear, ear, 0.045]), 0.025);
            v = smooth_min(v, capsule(p, [x * 0.2, 0.46, 0.03], [x * 0.33, 0.26, 0.16], 0.075, 0.08), 0.04);
            v = smooth_min(v, capsule(p, [x * 0.14, 0.09, 0.08], [x * 0.22, 0.1, 0.36], 0.095, 0.1), 0.04);
        }
        (v + 0.006 * fractal(seed, mul(p, 18.0), [0; 3], 2)) * s
    };
    let mut m = Maker::default();
    m.add(
        Stuff::Fabric,
        Field { distance, low: [-0.5 * s, -0.02 * s, -0.32 * s], high: [0.5 * s, 1.03 * s, 0.52 * s] }
            .body(0.019 * s)
            .smooth(),
    );
    for x in [-1.0, 1.0] {
        m.add(Stuff::Plastic, ball(0.024 * s, 10).at([x * 0.085 * s, 0.745 * s, 0.195 * s]));
    }
    m.add(Stuff::Plastic, ball(0.032 * s, 10).scaled([1.2, 0.8, 1.0]).at([0.0, 0.685 * s, (0.21 + snout + 0.02) * s]));
    m.made()
}

fn toy_ball(d: &mut Stream) -> Made {
    let r = d.range(0.05, 0.13);
    // Six gores of two colours.
    let mut m = Maker::default();
    for part in 0..2 {
        let gores = Body::all((0..3).map(|k| {
            let from = PI / 3.0 * f64::from(2 * k + part);
            sheet(8, 24, |s, t| {
                let (a, b) = (from + PI / 3.0 * s, PI * (t - 0.5));
                let pole = if t == 0.0 || t == 1.0 { 0.0 } else { maths::cos(b) };
                [r * pole * maths::sin(a), r + r * maths::sin(b), r * pole * maths::cos(a)]
            })
        }));
        m.another(*d.pick(&[Stuff::Plastic, Stuff::Rubber, Stuff::Leather]), gores.smooth());
    }
    m.made()
}

fn candlestick(d: &mut Stream) -> Made {
    let (h, r) = (d.range(0.12, 0.32), d.range(0.04, 0.06));
    let stuff = *d.pick(&[Stuff::Metal, Stuff::Ceramic, Stuff::Wood]);
    let mut m = Maker::default();
    let w = [0; 5].map(|_: i32| d.range(0.008, 0.022));
    let curve = flat_spline(
        &[
            [0.6 * r, 0.014],
            [w[0], 0.15 * h],
            [w[1], 0.3 * h],
            [0.008, 0.4 * h],
            [w[2], 0.55 * h],
            [0.009, 0.7 * h],
            [w[3], 0.82 * h],
            [0.01, 0.9 * h],
            [0.025 + 0.3 * w[4], h],
        ],
        4,
    );
    let profile: Vec<_> = [[0.0, 0.0], [r, 0.0], [r, 0.008]]
        .into_iter()
        .chain(curve)
        .chain([[0.012, h - 0.002], [0.0, h - 0.002]])
        .collect();
    m.add(stuff, lathe(&profile, 28));
    if d.chance(0.7) {
        m.add(Stuff::Wax, rod([0.0, h - 0.004, 0.0], [0.0, h + d.range(0.05, 0.2), 0.0], 0.0105, 14));
    }
    m.made()
}

fn trophy(d: &mut Stream) -> Made {
    let h = d.range(0.16, 0.32);
    let mut m = Maker::default();
    let b = 0.2 * h;
    m.add(*d.pick(&[Stuff::Stone, Stuff::Wood]), board([0.0, 0.5 * b, 0.0], [0.24 * h, 0.5 * b, 0.24 * h]));
    let w = h * d.range(0.24, 0.34);
    let outer = flat_spline(
        &[
            [0.17 * h, b],
            [0.05 * h, b + 0.08 * h],
            [0.035 * h, b + 0.2 * h],
            [0.07 * h, b + 0.25 * h],
            [0.75 * w, b + 0.42 * h],
            [w, b + 0.62 * h],
            [0.95 * w, b + 0.8 * h],
        ],
        4,
    );
    let inner =
        outer.iter().rev().filter(|p| p[1] > b + 0.33 * h).map(|p| [p[0] - 0.004, p[1] + 0.001]).collect::<Vec<_>>();
    let profile: Vec<_> = [[0.0, b]].into_iter().chain(outer).chain(inner).chain([[0.0, b + 0.32 * h]]).collect();
    m.add(Stuff::Metal, lathe(&profile, 36));
    for s in [-1.0, 1.0] {
        let path = spline(
            &[
                [s * 0.93 * w, b + 0.72 * h, 0.0],
                [s * 1.5 * w, b + 0.75 * h, 0.0],
                [s * 1.5 * w, b + 0.5 * h, 0.0],
                [s * 0.72 * w, b + 0.42 * h, 0.0],
            ],
            6,
        );
        m.add(Stuff::Metal, tube(&path, 8, |_| 0.016 * h));
    }
    m.add(Stuff::Metal, panel([0.0, 0.5 * b, 0.241 * h], [0.14 * h, 0.25 * b, 0.002]));
    m.made()
}

/// A snail's or turret shell: a tube along a spiral that grows.
fn shell(d: &mut Stream) -> Made {
    let (size, turns, tall) = (d.range(0.03, 0.08), d.range(3.5, 6.0), d.range(0.3, 2.2));
    let grow = d.range(0.55, 0.8);
    let n = (turns * 26.0) as usize;
    let rings: Vec<Vec<Vec3>> = (0..=n)
        .map(|k| {
            let t = turns * k as f64 / n as f64;
            let g = size * maths::exp(grow * (t - turns));
            let a = TAU * t;
            let minor = 0.48 * g * (1.0 + 0.04 * maths::sin(8.0 * a));
            circle(14, 1.0)
                .into_iter()
                .map(|[c, s]| {
                    let (r, y) = (0.55 * g + minor * s, -tall * g + 1.1 * minor * c);
                    [r * maths::sin(a), y, r * maths::cos(a)]
                })
                .collect()
        })
        .collect();
    let body = skin(&rings, [true, false], [true, true]).smooth();
    let tilt = d.range(0.8, 1.5);
    one(*d.pick(&[Stuff::Ceramic, Stuff::Stone, Stuff::Wax]), body.flipped().turned_x(tilt))
}

fn hourglass(d: &mut Stream) -> Made {
    let (h, r) = (d.range(0.14, 0.25), d.range(0.035, 0.05));
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Metal]);
    for y in [0.006, h - 0.006] {
        m.add(stuff, rod([0.0, y - 0.006, 0.0], [0.0, y + 0.006, 0.0], 1.35 * r, 32));
    }
    for k in 0..3 {
        let a = TAU * f64::from(k) / 3.0;
        let p = |y: f64| [1.15 * r * maths::sin(a), y, 1.15 * r * maths::cos(a)];
        m.add(stuff, tube(&line(p(0.011), p(h - 0.011), 16), 8, |t| 0.004 + 0.0015 * maths::sin(3.0 * PI * t).abs()));
    }
    let (low, high) = (0.0125, h - 0.0125);
    let mid = 0.5 * (low + high);
    let half = mid - low;
    let at = |t: f64| 0.0035 + (0.93 * r - 0.0035) * maths::pow(maths::sin(0.5 * PI * maths::pow(t, 0.7)), 1.3);
    let profile: Vec<_> = [[0.0, low]]
        .into_iter()
        .chain((0..=32).map(|k| f64::from(k) / 16.0 - 1.0).map(|t| [at(t.abs()), mid + half * t]))
        .chain([[0.0, high]])
        .collect();
    m.add(Stuff::Glass, lathe(&profile, 32));
    let part = d.range(0.25, 0.6);
    let fill: Vec<_> = [[0.0, low + 0.002], [0.86 * r, low + 0.002]]
        .into_iter()
        .chain((0..6).map(|k| {
            let t = f64::from(k) / 6.0;
            [0.86 * r * (1.0 - t), low + 0.004 + half * part * t]
        }))
        .chain([[0.0, low + 0.004 + half * part]])
        .collect();
    m.add(Stuff::Sand, lathe(&fill, 24));
    m.made()
}

fn earth(d: &mut Stream) -> Made {
    let r = d.range(0.08, 0.16);
    let mut m = Maker::default();
    let y = 1.7 * r;
    let tilt = 0.41;
    m.add(Stuff::Print, ball(r, 36).turned_z(-tilt).at([0.0, y, 0.0]));
    let k = 1.1 * r;
    let path: Vec<Vec3> = (0..=28)
        .map(|j| PI * f64::from(j) / 28.0 - 0.5 * PI - tilt)
        .map(|a| [k * maths::cos(a), y + k * maths::sin(a), 0.0])
        .collect();
    let metal = *d.pick(&[Stuff::Metal, Stuff::Wood]);
    m.add(metal, sweep(&path, &rounded_rect([0.02 * r, 0.06 * r], 0.015 * r, 1), [1.0, 0.0, 0.0], |_| 1.0));
    for s in [-1.0, 1.0] {
        let (sn, cs) = (maths::sin(tilt), maths::cos(tilt));
        m.add(
            Stuff::Metal,
            rod(
                [s * 0.97 * r * sn, y + s * 0.97 * r * cs, 0.0],
                [s * 1.12 * r * sn, y + s * 1.12 * r * cs, 0.0],
                0.03 * r,
                10,
            ),
        );
    }
    let stem = flat_spline(
        &[[0.6 * r, 0.04 * r], [0.2 * r, 0.12 * r], [0.08 * r, 0.3 * r], [0.12 * r, 0.45 * r], [0.06 * r, 0.62 * r]],
        4,
    );
    m.add(
        metal,
        lathe(&[[0.0, 0.0], [0.62 * r, 0.0]].into_iter().chain(stem).chain([[0.0, 0.62 * r]]).collect::<Vec<_>>(), 28),
    );
    m.made()
}

fn sphere(d: &mut Stream) -> Made {
    let r = d.range(0.03, 0.12);
    let stuff = solid_stuff(d);
    one(stuff, ball(r, 48))
}

fn rounded(d: &mut Stream) -> Made {
    let a = d.range(0.03, 0.12);
    let half = [a, a * d.range(0.35, 1.0), a * d.range(0.5, 1.0)];
    let r = d.range(0.03, 0.4) * half[1];
    let stuff = solid_stuff(d);
    one(stuff, soft_block([0.0; 3], half, r, 5))
}

fn torus(d: &mut Stream) -> Made {
    let r = d.range(0.04, 0.12);
    let minor = r * d.range(0.2, 0.48);
    let body = tube_loop(&ring_path(r, minor, 64), 28, minor);
    let stuff = solid_stuff(d);
    one(stuff, if d.chance(0.4) { body.turned_x(0.5 * PI) } else { body })
}

fn knot(d: &mut Stream) -> Made {
    let (p, q) = *d.pick(&[(2.0, 3.0), (3.0, 2.0), (2.0, 5.0), (3.0, 4.0)]);
    let s = d.range(0.03, 0.08);
    let path: Vec<Vec3> = (0..220)
        .map(|k| {
            let t = f64::from(k) / 220.0;
            let (a, b) = (p * TAU * t, q * TAU * t);
            let r = 2.0 + 0.85 * maths::cos(b);
            mul([r * maths::cos(a), 0.85 * maths::sin(b), r * maths::sin(a)], s)
        })
        .collect();
    let stuff = solid_stuff(d);
    one(stuff, tube_loop(&path, 16, s * d.range(0.24, 0.36)))
}

fn superellipsoid(d: &mut Stream) -> Made {
    let (e1, e2) = (d.range(0.3, 1.9), d.range(0.3, 1.9));
    let s = d.range(0.04, 0.1);
    let (sy, sz) = (s * d.range(0.6, 1.3), s * d.range(0.7, 1.0));
    let power = |v: f64, e: f64| if v < 0.0 { -maths::pow(-v, e) } else { maths::pow(v, e) };
    let rows = 36;
    let rings: Vec<Vec<Vec3>> = (0..=rows)
        .map(|j| {
            let b = PI * (j as f64 / rows as f64 - 0.5);
            let c = if j == 0 || j == rows { 0.0 } else { power(maths::cos(b).max(0.0), e1) };
            circle(60, 1.0)
                .into_iter()
                .map(|[x, y]| [s * c * power(y, e2), sy * power(maths::sin(b), e1), sz * c * power(x, e2)])
                .collect()
        })
        .collect();
    let stuff = solid_stuff(d);
    one(stuff, skin(&rings, [true, false], [false; 2]))
}

/// A brilliant: a table, a crown, a girdle, a pavilion, lying on a facet's side of it.
fn gem(d: &mut Stream) -> Made {
    let (r, n) = (d.range(0.02, 0.05), 6 + 2 * d.below(3));
    let (crown, pavilion, table) = (d.range(0.55, 0.75), d.range(0.68, 0.8), d.range(0.28, 0.4));
    let mut planes: Vec<Vec3> = vec![[0.0, 1.0 / table, 0.0]];
    for k in 0..n {
        let a = TAU * k as f64 / n as f64;
        let b = a + PI / n as f64;
        planes.push([maths::sin(a) * maths::cos(crown), maths::sin(crown), maths::cos(a) * maths::cos(crown)]);
        planes.push(mul(
            [
                maths::sin(b) * maths::cos(crown * 1.25),
                maths::sin(crown * 1.25),
                maths::cos(b) * maths::cos(crown * 1.25),
            ],
            1.07,
        ));
        planes.push([
            maths::sin(a) * maths::cos(pavilion),
            -maths::sin(pavilion),
            maths::cos(a) * maths::cos(pavilion),
        ]);
        planes.push(mul(
            [maths::sin(b) * maths::cos(pavilion), -maths::sin(pavilion), maths::cos(b) * maths::cos(pavilion)],
            1.01,
        ));
        planes.push(mul([maths::sin(b), 0.0, maths::cos(b)], 0.98));
    }
    let body = faceted(&planes).scaled([r, r, r]);
    one(Stuff::Glass, if d.chance(0.5) { body.turned_x(PI - 0.5 * PI + pavilion) } else { body.turned_x(PI) })
}

fn crystal(d: &mut Stream) -> Made {
    let sides = 5 + d.below(3);
    let (w, h) = (d.range(0.02, 0.05), d.range(2.0, 4.0));
    let mut planes: Vec<Vec3> = vec![[0.0, -1.0 / (0.5 * h), 0.0]];
    let phase = d.range(0.0, TAU);
    for k in 0..sides {
        let a = TAU * k as f64 / sides as f64 + phase;
        let (s, c) = (maths::sin(a), maths::cos(a));
        planes.push(mul([s, 0.0, c], 1.0 / d.range(0.8, 1.1)));
        let lean = d.range(0.6, 0.8);
        planes.push(mul(
            [s * maths::cos(lean), maths::sin(lean), c * maths::cos(lean)],
            1.0 / (0.36 * h * d.range(0.9, 1.15)),
        ));
    }
    one(Stuff::Glass, faceted(&planes).scaled([w, w, w]))
}

fn star(d: &mut Stream) -> Made {
    let (points, inner, r) = (4 + d.below(5), d.range(0.4, 0.7), d.range(0.04, 0.1));
    let outline: Vec<[f64; 2]> = (0..2 * points)
        .map(|i| {
            let k = if i % 2 == 0 { r } else { inner * r };
            let a = TAU * i as f64 / (2 * points) as f64 + 0.5 * PI;
            [k * maths::cos(a), k * maths::sin(a)]
        })
        .collect();
    let stuff = solid_stuff(d);
    let thick = r * d.range(0.3, 1.2);
    one(stuff, extrude(&outline, thick).turned_x(if d.chance(0.5) { 0.5 * PI } else { 0.0 }))
}

fn pill(d: &mut Stream) -> Made {
    let (r, l) = (d.range(0.02, 0.05), d.range(0.03, 0.1));
    let profile: Vec<_> = arc([0.0, -l], r, -0.5 * PI, 0.0, 8)
        .into_iter()
        .chain(arc([0.0, l], r, 0.0, 0.5 * PI, 8))
        .map(|[x, y]| [if x < 1e-9 { 0.0 } else { x }, y])
        .collect();
    let stuff = solid_stuff(d);
    one(stuff, lathe(&profile, 36).smooth().turned_z(if d.chance(0.5) { 0.5 * PI } else { 0.0 }))
}

fn cone(d: &mut Stream) -> Made {
    let (r, h, tip) = (d.range(0.03, 0.08), d.range(1.2, 2.6), d.range(0.0, 0.6));
    let tip = if tip < 0.2 { 0.0 } else { tip };
    let e = 0.03 * r;
    let mut profile = vec![[0.0, 0.0], [r - e, 0.0], [r, e], [tip * r + e * 0.3, h * r - e]];
    if tip > 0.0 {
        profile.push([tip * r - e, h * r]);
    }
    profile.push([0.0, h * r]);
    let stuff = solid_stuff(d);
    one(stuff, lathe(&profile, 44))
}

fn polyhedron(d: &mut Stream) -> Made {
    let r = d.range(0.03, 0.08);
    let g = 0.5 * (1.0 + 5f64.sqrt());
    let mut planes: Vec<Vec3> = Vec::new();
    let signs = [-1.0, 1.0];
    match d.below(4) {
        0 => planes.extend([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]),
        1 => (0..8).for_each(|k| planes.push([signs[k & 1], signs[k >> 1 & 1], signs[k >> 2]])),
        2 => {
            for a in signs {
                for b in signs {
                    planes.extend([[0.0, a, b * g], [a, b * g, 0.0], [b * g, 0.0, a]]);
                }
            }
        }
        _ => {
            for a in signs {
                for b in signs {
                    planes.extend([[0.0, a / g, b * g], [a / g, b * g, 0.0], [b * g, 0.0, a / g]]);
                    signs.iter().for_each(|c| planes.push([a, b, *c]));
                }
            }
        }
    }
    // All faces at one distance; the first one is turned down.
    let planes: Vec<Vec3> = planes.into_iter().map(unit).collect();
    let first = planes[0];
    let tilt = maths::acos(-first[1]);
    let axis = maths::atan2(first[0], first[2]);
    let body = faceted(&planes).turned_y(-axis).turned_x(tilt - 0.0).scaled([r, r, r]);
    let stuff = solid_stuff(d);
    one(stuff, body)
}

fn glass_prism(d: &mut Stream) -> Made {
    let (r, l) = (d.range(0.02, 0.04), d.range(0.05, 0.12));
    let outline: Vec<[f64; 2]> =
        (0..3).map(|k| PI * (0.5 + 2.0 / 3.0 * f64::from(k))).map(|a| [r * maths::cos(a), r * maths::sin(a)]).collect();
    one(Stuff::Glass, extrude(&outline, l))
}

fn drop(d: &mut Stream) -> Made {
    let (r, h) = (d.range(0.02, 0.05), d.range(2.2, 3.4));
    let profile: Vec<_> = (0..=24)
        .map(|k| {
            let a = PI * f64::from(k) / 24.0;
            let s = maths::sin(a) * maths::pow(maths::sin(0.5 * a), 1.4);
            [if k == 0 || k == 24 { 0.0 } else { r * 1.3 * s.max(0.002) }, 0.5 * h * r * (1.0 + maths::cos(a))]
        })
        .rev()
        .collect();
    let stuff = solid_stuff(d);
    one(stuff, lathe(&profile, 36).smooth())
}
