//! Vehicles.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::geom::{Vec3, add};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("car", Family::Vehicle, 8, car),
    form("hand_cart", Family::Vehicle, 6, cart),
    form("wheelbarrow", Family::Vehicle, 6, barrow),
    form("boat_rowing", Family::Vehicle, 6, boat),
];

fn tyre(r: f64, wide: f64) -> Vec<(Stuff, Body)> {
    let w = 0.5 * wide;
    let tread =
        lathe_loop(&[[0.68 * r, -w], [0.95 * r, -w], [r, -0.7 * w], [r, 0.7 * w], [0.95 * r, w], [0.68 * r, w]], 32);
    let rim = lathe(
        &[
            [0.0, -0.4 * w],
            [0.69 * r, -0.8 * w],
            [0.69 * r, 0.85 * w],
            [0.6 * r, 0.5 * w],
            [0.25 * r, 0.7 * w],
            [0.2 * r, 0.9 * w],
            [0.0, 0.9 * w],
        ],
        24,
    );
    vec![(Stuff::Rubber, tread), (Stuff::Metal, rim)]
}

/// A saloon, estate or van by its sections.
fn car(d: &mut Stream) -> FormVariant {
    let (l, w, h) = (d.range(1.8, 2.3), d.range(0.78, 0.9), d.range(1.35, 1.55));
    let (hood, tail) = (d.range(0.35, 0.55), d.range(0.1, 0.5));
    let (waist, clear) = (0.58 * h, 0.2);
    let mut m = Maker::default();
    // Rings of a rounded section along z, the nose to +z.
    let section = |half: f64, low: f64, high: f64, z: f64| -> Vec<Vec3> {
        let (y, k) = (0.5 * (low + high), 0.5 * (high - low));
        rounded_rect([half, k], (0.6 * k).min(0.22), 4).into_iter().map(|[x, v]| [x, y + v, z]).collect()
    };
    let lower: Vec<Vec<Vec3>> = [
        (-1.0, 0.7, 0.5, 0.9),
        (-0.97, 0.9, 0.3, 0.97),
        (-0.6, 1.0, 0.0, 1.0),
        (0.0, 1.0, 0.0, 1.0),
        (0.55, 1.0, 0.0, 0.97),
        (0.9, 0.93, 0.15, 0.86),
        (0.98, 0.85, 0.3, 0.78),
        (1.0, 0.65, 0.45, 0.68),
    ]
    .iter()
    .map(|(z, x, low, high)| section(w * x, clear + low * 0.25, waist * high, l * z))
    .collect();
    m.add(Stuff::PaintedMetal, skin(&lower, [true, false], [true, true]).smooth());
    let cab = |z0: f64, z1: f64, k: f64, y: f64| vec![[-k, y, z1], [k, y, z1], [k, y, z0], [-k, y, z0]];
    let (rear, front) = (-l * (1.0 - tail), l * hood);
    let top_rear = rear + 0.12 * l * (0.4 + tail);
    let rings = [
        cab(rear, front, 0.9 * w, waist - 0.06),
        cab(rear + 0.03, front - 0.05, 0.87 * w, waist + 0.03),
        cab(top_rear, front - 0.36 * l, 0.7 * w, h - 0.04),
        cab(top_rear + 0.06, front - 0.4 * l, 0.62 * w, h),
    ];
    m.add(Stuff::PaintedMetal, skin(&rings, [true, false], [false, true]));
    // Windows lie a little before the cabin's sides.
    let (a, b) = (&rings[1], &rings[2]);
    for i in 0..4 {
        let j = (i + 1) % 4;
        let at = |s: f64, t: f64| {
            [0, 1, 2].map(|q| {
                let (p, r) = (a[i][q] + (a[j][q] - a[i][q]) * s, b[i][q] + (b[j][q] - b[i][q]) * s);
                p + (r - p) * t
            })
        };
        let out = [[0.0, 0.0, 0.004], [0.004, 0.0, 0.0], [0.0, 0.0, -0.004], [-0.004, 0.0, 0.0]][i];
        let spans: &[(f64, f64)] = if i % 2 == 1 { &[(0.06, 0.48), (0.53, 0.93)] } else { &[(0.07, 0.93)] };
        for (from, to) in spans {
            m.add(Stuff::Plastic, sheet(1, 1, |s, t| add(at(from + (to - from) * s, 0.1 + 0.8 * t), out)));
        }
    }
    let r = d.range(0.3, 0.34);
    for (x, z) in [(-1.0, -0.6), (1.0, -0.6), (-1.0, 0.64), (1.0, 0.64)] {
        for (stuff, body) in tyre(r, 0.2) {
            m.add(stuff, body.turned_z(-x * 0.5 * PI).at([x * (w - 0.08), r, z * l]));
        }
    }
    for s in [-1.0, 1.0] {
        m.add(Stuff::Metal, ball(0.08, 14).scaled([1.2, 0.8, 0.5]).at([s * 0.6 * w, 0.72 * waist, 0.975 * l]));
        m.add(
            Stuff::PaintedMetal,
            soft_block([s * (0.98 * w), waist + 0.08, front - 0.2], [0.08, 0.05, 0.04], 0.03, 2),
        );
    }
    m.add(Stuff::Plastic, board([0.0, 0.42, l * 0.995], [0.3 * w, 0.06, 0.02]));
    m.made()
}

fn cart(d: &mut Stream) -> FormVariant {
    let (half, w, r) = (d.range(0.5, 0.8), d.range(0.3, 0.42), d.range(0.25, 0.42));
    let mut m = Maker::default();
    let y = r + 0.08;
    let planks = 5;
    for k in 0..planks {
        let z = w * (2.0 * (f64::from(k) + 0.5) / f64::from(planks) - 1.0);
        m.add(Stuff::Wood, board([0.0, y, z], [half, 0.012, w / f64::from(planks) - 0.002]));
    }
    m.top([0.0, y + 0.012, 0.0], [half - 0.05, w - 0.05], f64::INFINITY);
    for s in [-1.0, 1.0] {
        for k in 0..2 {
            m.add(Stuff::Wood, board([0.0, y + 0.07 + 0.11 * f64::from(k), s * (w - 0.01)], [half, 0.045, 0.01]));
        }
        m.add(Stuff::Wood, board([s * (half - 0.012), y + 0.125, 0.0], [0.012, 0.1, w - 0.02]));
        m.add(Stuff::Wood, rod([half - 0.2, y - 0.03, s * 0.7 * w], [half + 0.75, y + 0.05, s * 0.55 * w], 0.02, 10));
        // A wooden wheel with spokes.
        let z = s * (w + 0.06);
        let ring: Vec<Vec3> = circle(40, r - 0.02).into_iter().map(|[a, b]| [a, r + b, z]).collect();
        m.add(Stuff::Wood, sweep_loop(&ring, &rounded_rect([0.022, 0.016], 0.004, 1), [0.0, 1.0, 0.0]).soft());
        for k in 0..10 {
            let a = TAU * f64::from(k) / 10.0;
            m.add(
                Stuff::Wood,
                rod([0.0, r, z], [(r - 0.03) * maths::cos(a), r + (r - 0.03) * maths::sin(a), z], 0.011, 8),
            );
        }
        m.add(Stuff::Wood, rod([0.0, r, z - 0.05], [0.0, r, z + 0.05], 0.04, 14));
        m.add(Stuff::Wood, board([-half + 0.1, 0.5 * y, s * 0.7 * w], [0.02, 0.5 * y - 0.012, 0.02]));
    }
    m.add(Stuff::Metal, rod([0.0, r, -w - 0.09], [0.0, r, w + 0.09], 0.016, 10));
    m.made()
}

fn barrow(d: &mut Stream) -> FormVariant {
    let (l, w, deep) = (d.range(0.38, 0.48), d.range(0.26, 0.34), d.range(0.18, 0.26));
    let r = 0.18;
    let mut m = Maker::default();
    let y = 0.36;
    let ring = |k: f64, z: f64, h: f64| {
        rounded_rect([z, k], 0.06, 3).into_iter().rev().map(|[x, v]| [x, h, v]).collect::<Vec<_>>()
    };
    let t = 0.006;
    let rings = [
        ring(0.65 * w, 0.62 * l, y),
        ring(w, l, y + deep),
        ring(w + 0.012, l + 0.012, y + deep),
        ring(w + 0.012, l + 0.012, y + deep + 0.008),
        ring(w - t, l - t, y + deep + 0.008),
        ring(0.65 * w - t, 0.62 * l - t, y + t),
    ];
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Metal, Stuff::Plastic]);
    m.add(stuff, skin(&rings, [true, false], [true, true]));
    for (body_stuff, body) in tyre(r, 0.09) {
        m.add(body_stuff, body.turned_x(0.5 * PI).at([l + 0.2, r, 0.0]));
    }
    for s in [-1.0, 1.0] {
        let path = fillet(
            &[
                [l + 0.2, r, 0.07 * s],
                [0.5 * l, y - 0.02, 0.18 * s],
                [-0.6 * l, y - 0.01, 0.2 * s],
                [-l - 0.5, y + 0.2, 0.26 * s],
            ],
            0.08,
            4,
        );
        m.add(*d.pick(&[Stuff::Wood, Stuff::PaintedMetal]), tube(&path, 10, |_| 0.016));
        let leg = fillet(
            &[
                [-0.25 * l, y - 0.02, 0.2 * s],
                [-0.35 * l, 0.012, 0.22 * s],
                [-0.65 * l, 0.012, 0.22 * s],
                [-0.7 * l, y - 0.02, 0.205 * s],
            ],
            0.04,
            3,
        );
        m.add(Stuff::PaintedMetal, tube(&leg, 8, |_| 0.012));
        m.add(Stuff::Rubber, rod([-l - 0.38, y + 0.15, 0.2425 * s], [-l - 0.5, y + 0.2, 0.26 * s], 0.02, 10));
    }
    m.add(Stuff::Metal, rod([l + 0.2, r, -0.09], [l + 0.2, r, 0.09], 0.01, 8));
    m.made()
}

fn boat(d: &mut Stream) -> FormVariant {
    let (l, w, h) = (d.range(1.3, 1.8), d.range(0.5, 0.65), d.range(0.4, 0.5));
    let mut m = Maker::default();
    // A hull of a cross-section that narrows to the stem, with its inside.
    let wide = |s: f64| {
        w * if s < 0.35 {
            0.72 + 0.28 * maths::sin(0.5 * PI * s / 0.35)
        } else {
            maths::cos(0.5 * PI * maths::pow((s - 0.35) / 0.66, 1.6)).max(0.03)
        }
    };
    let hull = slab(24, 16, 0.018, |t, s| {
        let a = 2.0 * t - 1.0;
        let rim = h * (0.92 + 0.35 * s * s);
        let depth = 1.0 - maths::pow(a.abs(), 2.6);
        let keel = 0.25 * h * maths::pow(s, 5.0);
        [
            wide(s) * maths::pow(a.abs(), 0.75) * if a < 0.0 { -1.0 } else { 1.0 },
            rim - (rim - keel) * depth,
            -(l * (2.0 * s - 1.0)) - 0.1 * l * (1.0 - depth) * s,
        ]
    });
    m.add(*d.pick(&[Stuff::Wood, Stuff::PaintedMetal]), hull.turned_y(PI));
    let stern: Vec<[f64; 2]> = (0..=16)
        .map(|k| f64::from(k) / 8.0 - 1.0)
        .map(|a| {
            [
                0.72 * w * maths::pow(a.abs(), 0.75) * if a < 0.0 { -1.0 } else { 1.0 },
                0.92 * h * (1.0 - 0.99 * (1.0 - maths::pow(a.abs(), 2.6))),
            ]
        })
        .collect();
    m.add(Stuff::Wood, extrude(&stern, 0.02).at([0.0, 0.0, -l + 0.012]));
    for s in [0.12, 0.42, 0.68] {
        let z = l * (2.0 * s - 1.0);
        m.add(Stuff::Wood, board([0.0, 0.62 * h, z], [0.93 * wide(s) * 0.9, 0.012, 0.12]));
    }
    for x in [-1.0, 1.0] {
        let y = 0.62 * h + 0.04;
        m.add(Stuff::Wood, rod([x * 0.2, y, -0.8 * l], [x * 0.16, y, 0.35 * l], 0.018, 8));
        m.add(Stuff::Wood, board([x * 0.15, y, 0.45 * l], [0.06, 0.006, 0.2]));
    }
    m.made()
}
