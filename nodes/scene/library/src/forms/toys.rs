//! Toys and games.

use super::{
    super::{noise::fractal, shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::geom::{Vec3, mul};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("toy_car", Family::Toy, 8, car),
    form("chess_pieces", Family::Toy, 8, chess),
    form("chess_board", Family::Toy, 4, chess_board),
    form("building_blocks", Family::Toy, 8, blocks),
    form("ring_stacker", Family::Toy, 6, stacker),
    form("toy_bear", Family::Toy, 6, bear),
    form("ball_toy", Family::Toy, 4, toy_ball),
];

fn car(d: &mut Stream) -> FormVariant {
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

fn chess(d: &mut Stream) -> FormVariant {
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

fn chess_board(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let q = d.range(0.043, 0.057);
    m.add(Stuff::Wood, board([0.0, 0.008, 0.0], [4.5 * q, 0.008, 4.5 * q]));
    for dark in [0, 1] {
        let squares = Body::all((0..64).filter(|k| (k / 8 + k % 8) % 2 == dark).map(|k| {
            let (i, j) = (f64::from(k / 8), f64::from(k % 8));
            panel([q * (i - 3.5), 0.0164, q * (j - 3.5)], [0.5 * q, 0.0005, 0.5 * q])
        }));
        m.another(Stuff::Wood, squares);
    }
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
            m.another_of(Stuff::Wood, first, Body::all(piece(kind, 22.0 * q)).turned_y(-turn).at(at));
            first = false;
        }
    }
    m.made()
}

fn blocks(d: &mut Stream) -> FormVariant {
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

fn stacker(d: &mut Stream) -> FormVariant {
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

fn bear(d: &mut Stream) -> FormVariant {
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
            .body(0.024 * s)
            .smooth(),
    );
    for x in [-1.0, 1.0] {
        m.add(Stuff::Plastic, ball(0.024 * s, 10).at([x * 0.085 * s, 0.745 * s, 0.195 * s]));
    }
    m.add(Stuff::Plastic, ball(0.032 * s, 10).scaled([1.2, 0.8, 1.0]).at([0.0, 0.685 * s, (0.21 + snout + 0.02) * s]));
    m.made()
}

fn toy_ball(d: &mut Stream) -> FormVariant {
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
