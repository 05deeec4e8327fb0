//! Signs, vehicles, bicycles, instruments, clocks, frames.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, Made, form,
    maker::Maker,
};
use crate::geom::Vec3;
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("sign_board", Family::Sign, 10, sign_board),
    form("sign_letters", Family::Sign, 10, letters),
    form("sign_post", Family::Sign, 8, sign_post),
    form("sign_easel", Family::Sign, 6, easel),
    form("car", Family::Vehicle, 8, car),
    form("hand_cart", Family::Vehicle, 6, cart),
    form("wheelbarrow", Family::Vehicle, 6, barrow),
    form("boat_rowing", Family::Vehicle, 6, boat),
    form("bicycle", Family::Bicycle, 8, bicycle),
    form("scooter", Family::Bicycle, 6, scooter),
    form("guitar", Family::Instrument, 8, guitar),
    form("drum", Family::Instrument, 6, drum),
    form("piano", Family::Instrument, 6, piano),
    form("xylophone", Family::Instrument, 6, xylophone),
    form("trumpet", Family::Instrument, 6, trumpet),
    form("clock_wall", Family::Clock, 8, clock_wall),
    form("clock_alarm", Family::Clock, 8, clock_alarm),
    form("clock_long_case", Family::Clock, 6, clock_case),
    form("picture_frame", Family::Frame, 12, picture),
    form("mirror_frame", Family::Frame, 8, mirror),
    form("photo_standing", Family::Frame, 8, photo),
];

const WORDS: &[&str] = &[
    "OPEN",
    "CAFE",
    "HOTEL",
    "EXIT",
    "BOOKS",
    "BAKERY",
    "TAXI",
    "STOP",
    "ROOM 24",
    "PLATFORM 9",
    "MUSEUM",
    "GARAGE",
    "FLOWERS",
    "TEA",
    "BAR",
];

fn sign_board(d: &mut Stream) -> Made {
    let text = *d.pick(WORDS);
    let height = d.range(0.08, 0.2);
    let half = [0.5 * text_width(text, height) + 0.4 * height, 0.5 * height + 0.35 * height];
    let mut m = Maker::default();
    m.add(
        *d.pick(&[Stuff::Wood, Stuff::PaintedMetal, Stuff::Plastic]),
        board([0.0, half[1], 0.0], [half[0], half[1], 0.012]),
    );
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Metal, Stuff::Plastic]);
    m.another(stuff, lettering(text, height, 0.15, 0.012).at([0.0, half[1], 0.0172]));
    if d.chance(0.5) {
        for s in [-1.0, 1.0] {
            m.add(
                Stuff::Metal,
                rod(
                    [s * 0.8 * half[0], 2.0 * half[1] - 0.005, 0.0],
                    [s * 0.8 * half[0], 2.0 * half[1] + 0.15, 0.0],
                    0.003,
                    6,
                ),
            );
        }
    }
    m.made()
}

fn letters(d: &mut Stream) -> Made {
    let text = *d.pick(WORDS);
    let height = d.range(0.08, 0.4);
    let depth = height * d.range(0.15, 0.35);
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Metal, Stuff::Wood, Stuff::Plastic, Stuff::Glow]);
    m.add(stuff, lettering(text, height, d.range(0.12, 0.2), depth).at([0.0, 0.5 * height, 0.0]));
    m.made()
}

fn sign_post(d: &mut Stream) -> Made {
    let h = d.range(1.9, 2.6);
    let mut m = Maker::default();
    m.add(Stuff::Metal, rod([0.0, 0.0, 0.0], [0.0, h, 0.0], 0.03, 14));
    let r = d.range(0.2, 0.32);
    let sides = *d.pick(&[3usize, 4, 8, 40]);
    let spin = if sides == 3 {
        0.5 * PI
    } else if sides == 4 {
        0.25 * PI
    } else {
        PI / sides as f64
    };
    let plate = extrude(&circle(sides, r), 0.006).turned_z(spin).at([0.0, h - 0.8 * r, 0.037]);
    m.add(Stuff::PaintedMetal, plate);
    m.another(
        Stuff::PaintedMetal,
        extrude(&circle(sides, 0.86 * r), 0.002).turned_z(spin).at([0.0, h - 0.8 * r, 0.0412]),
    );
    let text = *d.pick(&["STOP", "30", "50", "TAXI", "BUS", "P"]);
    let height = (0.55 * r).min(0.55 * r * 1.1 * r / text_width(text, 0.55 * r));
    m.another(Stuff::PaintedMetal, lettering(text, height, 0.17, 0.002).at([0.0, h - 0.85 * r, 0.0432]));
    m.made()
}

/// A board that stands on the pavement.
fn easel(d: &mut Stream) -> Made {
    let (w, h) = (d.range(0.25, 0.35), d.range(0.8, 1.1));
    let lean = 0.2;
    let mut m = Maker::default();
    for s in [-1.0, 1.0] {
        let tilt = |b: Body| b.turned_x(-s * lean).at([0.0, 0.0, s * (h * maths::sin(lean) + 0.012)]);
        for x in [-1.0, 1.0] {
            m.add(Stuff::Wood, tilt(board([x * w, 0.5 * h, 0.0], [0.02, 0.5 * h, 0.012])));
        }
        for y in [0.12, h - 0.03] {
            m.add(Stuff::Wood, tilt(board([0.0, y, 0.0], [w - 0.02, 0.02, 0.011])));
        }
        m.another(
            Stuff::Plastic,
            tilt(board([0.0, 0.5 * (h + 0.09), 0.0], [w - 0.02, 0.5 * (h - 0.15) - 0.02, 0.006])),
        );
        if s > 0.0 {
            for k in 0..3 {
                let text = *d.pick(WORDS);
                let size = (0.09f64).min(0.09 * 1.5 * w / text_width(text, 0.09));
                m.add(
                    Stuff::Paper,
                    tilt(lettering(text, size, 0.14, 0.0012).at([0.0, h * (0.75 - 0.2 * f64::from(k)), 0.0068])),
                );
            }
        }
    }
    m.made()
}

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
fn car(d: &mut Stream) -> Made {
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
            m.add(Stuff::Plastic, sheet(1, 1, |s, t| crate::geom::add(at(from + (to - from) * s, 0.1 + 0.8 * t), out)));
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

fn spoked(r: f64, spokes: usize, tube_r: f64) -> (Body, Body) {
    let ring: Vec<Vec3> = circle(44, r).into_iter().map(|[x, y]| [x, y, 0.0]).collect();
    let tyre = tube_loop(&ring, 8, tube_r);
    let mut wires = vec![rod([0.0, 0.0, -0.03], [0.0, 0.0, 0.03], 0.018, 10)];
    for k in 0..spokes {
        let a = TAU * k as f64 / spokes as f64;
        let side = if k % 2 == 0 { 0.02 } else { -0.02 };
        wires.push(rod(
            [0.0, 0.0, side],
            [(r - 0.7 * tube_r) * maths::cos(a), (r - 0.7 * tube_r) * maths::sin(a), 0.0],
            0.0012,
            4,
        ));
    }
    let rim: Vec<Vec3> = circle(44, r - 0.9 * tube_r).into_iter().map(|[x, y]| [x, y, 0.0]).collect();
    wires.push(tube_loop(&rim, 6, 0.45 * tube_r));
    (tyre, Body::all(wires))
}

/// It stands along x, on its wheels.
fn bicycle(d: &mut Stream) -> Made {
    let r = d.range(0.31, 0.34);
    let base = d.range(0.98, 1.06);
    let low = d.chance(0.3);
    let paint = *d.pick(&[Stuff::PaintedMetal, Stuff::PaintedMetal, Stuff::Metal]);
    let mut m = Maker::default();
    let rear: Vec3 = [-0.43 * base, r, 0.0];
    let front: Vec3 = [0.57 * base, r, 0.0];
    for hub in [rear, front] {
        let (tyre, wires) = spoked(r - 0.018, 28, 0.018);
        m.add(Stuff::Rubber, tyre.at(hub));
        m.add(Stuff::Metal, wires.at(hub));
    }
    let crank: Vec3 = [0.0, 0.28, 0.0];
    let seat: Vec3 = [-0.17, 0.28 + d.range(0.5, 0.58), 0.0];
    let head: Vec3 = [0.57 * base - 0.16, r + 0.52, 0.0];
    let head_low: Vec3 = [head[0] + 0.04, head[1] - 0.13, 0.0];
    let along = |a: Vec3, b: Vec3, t: f64| [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * t);
    let tubes = [
        (crank, seat, 0.016),
        (crank, head_low, 0.02),
        (along(crank, seat, if low { 0.5 } else { 0.93 }), if low { along(head, head_low, 0.7) } else { head }, 0.016),
        (head, head_low, 0.02),
    ];
    for (a, b, k) in tubes {
        m.add(paint, rod(a, b, k, 12));
    }
    for s in [-1.0, 1.0] {
        let z = 0.05 * s;
        m.add(paint, tube(&[crank, [rear[0], rear[1], z]], 8, |t| 0.011 - 0.003 * t));
        m.add(paint, tube(&[along(crank, seat, 0.9), [rear[0], rear[1], z]], 8, |t| 0.01 - 0.003 * t));
        m.add(
            paint,
            tube(&[[head_low[0] + 0.005, head_low[1] - 0.02, 0.6 * z], [front[0], front[1], z]], 8, |t| {
                0.013 - 0.004 * t
            }),
        );
        // Crank and pedal.
        let turn = 0.6 + if s > 0.0 { 0.0 } else { PI };
        let end = [crank[0] + 0.17 * maths::cos(turn), crank[1] + 0.17 * maths::sin(turn) * 0.9, 0.075 * s];
        m.add(Stuff::Metal, rod([crank[0], crank[1], 0.06 * s], end, 0.008, 8));
        m.add(Stuff::Plastic, board([end[0], end[1], end[2] + 0.055 * s], [0.045, 0.012, 0.045]));
    }
    m.add(Stuff::Metal, rod([0.0, 0.28, -0.07], [0.0, 0.28, 0.07], 0.02, 12));
    m.add(Stuff::Metal, extrude_with_holes(&circle(36, 0.095), &[circle(24, 0.07)], 0.004).at([0.0, 0.28, 0.045]));
    m.add(Stuff::Metal, extrude(&circle(20, 0.04), 0.01).at([rear[0], rear[1], 0.045]));
    for (a, b) in [(0.095, 0.04), (-0.095, -0.04)] {
        m.add(
            Stuff::Metal,
            beam([0.0, 0.28 + a, 0.045], [rear[0], rear[1] + b, 0.045], [0.006, 0.006], [0.0, 1.0, 0.0]),
        );
    }
    let top = along(crank, seat, 1.18);
    m.add(Stuff::Metal, rod(along(crank, seat, 0.95), top, 0.012, 10));
    let saddle = slab(8, 8, 0.03, |s, t| {
        let (x, z) = (2.0 * s - 1.0, 1.0 - 2.0 * t);
        let w = 0.075 * (0.3 + 0.7 * maths::pow(0.5 - 0.5 * x, 1.3));
        [top[0] + 0.13 * x, top[1] + 0.035 - 0.012 * x * x - 0.02 * z * z, w * z]
    });
    m.add(Stuff::Leather, saddle);
    let bar = [head[0] - 0.035, head[1] + 0.1, 0.0];
    m.add(Stuff::Metal, rod(head, bar, 0.012, 10));
    let drop = d.chance(0.4);
    for s in [-1.0, 1.0] {
        let path = if drop {
            spline(
                &[
                    [bar[0], bar[1], 0.0],
                    [bar[0] + 0.01, bar[1], 0.19 * s],
                    [bar[0] + 0.1, bar[1] - 0.02, 0.21 * s],
                    [bar[0] + 0.09, bar[1] - 0.12, 0.21 * s],
                    [bar[0] + 0.0, bar[1] - 0.13, 0.21 * s],
                ],
                5,
            )
        } else {
            spline(
                &[
                    [bar[0], bar[1], 0.0],
                    [bar[0] + 0.02, bar[1] + 0.02, 0.15 * s],
                    [bar[0] - 0.05, bar[1] + 0.05, 0.28 * s],
                    [bar[0] - 0.14, bar[1] + 0.05, 0.3 * s],
                ],
                5,
            )
        };
        m.add(Stuff::Metal, tube(&path, 10, |_| 0.012));
        let end = path[path.len() - 1];
        let before = path[path.len() - 6];
        m.add(Stuff::Rubber, rod(before, end, 0.016, 10));
    }
    m.made()
}

fn scooter(d: &mut Stream) -> Made {
    let (l, h, r) = (d.range(0.32, 0.4), d.range(0.7, 1.0), d.range(0.06, 0.11));
    let mut m = Maker::default();
    for x in [-l - 0.08, l + 0.12] {
        let wheel =
            lathe(&[[0.0, -0.012], [0.8 * r, -0.014], [r, -0.008], [r, 0.008], [0.8 * r, 0.014], [0.0, 0.012]], 28);
        m.add(Stuff::Rubber, wheel.turned_x(0.5 * PI).at([x, r, 0.0]));
        m.add(Stuff::Metal, rod([x, r, -0.03], [x, r, 0.03], 0.008, 8));
        for s in [-1.0, 1.0] {
            m.add(
                Stuff::Metal,
                board([x + if x < 0.0 { 0.05 } else { -0.02 }, r + 0.01, 0.024 * s], [0.07, 0.012, 0.003]),
            );
        }
    }
    m.add(*d.pick(&[Stuff::PaintedMetal, Stuff::Wood]), soft_block([0.0, 0.9 * r, 0.0], [l, 0.012, 0.06], 0.008, 2));
    let neck = [l + 0.07, r + 0.05, 0.0];
    let top = [l - 0.02, h, 0.0];
    m.add(Stuff::PaintedMetal, rod([l - 0.03, 0.9 * r, 0.0], neck, 0.016, 10));
    m.add(Stuff::Metal, rod([l + 0.1, r + 0.02, 0.0], top, 0.014, 12));
    m.add(Stuff::Metal, rod([top[0], h, -0.2], [top[0], h, 0.2], 0.011, 10));
    for s in [-1.0, 1.0] {
        m.add(Stuff::Rubber, rod([top[0], h, 0.1 * s], [top[0], h, 0.21 * s], 0.016, 10));
    }
    m.made()
}

fn cart(d: &mut Stream) -> Made {
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

fn barrow(d: &mut Stream) -> Made {
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

fn boat(d: &mut Stream) -> Made {
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

fn guitar(d: &mut Stream) -> Made {
    let (l, w) = (d.range(0.42, 0.5), d.range(0.17, 0.2));
    let deep = d.range(0.04, 0.11);
    let waist = d.range(0.55, 0.75);
    let shape = closed_spline(
        &[
            [0.0, 0.0],
            [0.7 * w, 0.02 * l],
            [w, 0.25 * l],
            [0.85 * w, 0.42 * l],
            [waist * w, 0.58 * l],
            [0.72 * w, 0.82 * l],
            [0.45 * w, 0.98 * l],
            [0.0, l],
            [-0.45 * w, 0.98 * l],
            [-0.72 * w, 0.82 * l],
            [-waist * w, 0.58 * l],
            [-0.85 * w, 0.42 * l],
            [-w, 0.25 * l],
            [-0.7 * w, 0.02 * l],
        ],
        4,
    );
    let acoustic = deep > 0.06;
    let mut m = Maker::default();
    let hole: Vec<[f64; 2]> = circle(28, 0.05).into_iter().map(|[x, y]| [x, y + 0.66 * l]).collect();
    if acoustic {
        m.add(Stuff::Wood, extrude(&shape, deep - 0.004).at([0.0, 0.0, -0.002]));
        m.another(Stuff::Wood, extrude_with_holes(&shape, &[hole], 0.004).at([0.0, 0.0, 0.5 * deep - 0.002]));
    } else {
        m.add(*d.pick(&[Stuff::PaintedMetal, Stuff::Wood]), extrude(&shape, deep).soft());
        for y in [0.5, 0.68] {
            m.add(Stuff::Plastic, board([0.0, y * l, 0.5 * deep + 0.004], [0.04, 0.012, 0.004]));
        }
    }
    let neck = 0.36;
    let z = 0.5 * deep + 0.004;
    m.add(Stuff::Wood, beam([0.0, 0.8 * l, z + 0.002], [0.0, l + neck, z + 0.002], [0.012, 0.05], [0.0, 0.0, 1.0]));
    m.add(Stuff::Wood, beam([0.0, l - 0.02, z - 0.015], [0.0, l + neck, z - 0.01], [0.022, 0.04], [0.0, 0.0, 1.0]));
    m.add(Stuff::Wood, board([0.0, l + neck + 0.075, z - 0.006], [0.035, 0.08, 0.008]));
    m.add(Stuff::Wood, board([0.0, 0.28 * l, z + 0.001], [0.07, 0.012, 0.005]));
    for k in 0..6 {
        let x = 0.018 * (f64::from(k) / 2.5 - 1.0);
        m.add(Stuff::Metal, rod([1.4 * x, 0.28 * l, z + 0.011], [x, l + neck + 0.01, z + 0.011], 0.0006, 4));
        let (side, y) = (if k < 3 { -1.0 } else { 1.0 }, l + neck + 0.03 + 0.045 * f64::from(k % 3));
        m.add(Stuff::Metal, rod([side * 0.03, y, z - 0.006], [side * 0.055, y, z - 0.006], 0.004, 8));
    }
    for k in 1..16 {
        let y = 0.28 * l + (l + neck - 0.28 * l) * maths::exp2(-f64::from(k) / 12.0);
        if y > 0.82 * l {
            m.add(Stuff::Metal, block([0.0, y, z + 0.0085], [0.0245, 0.001, 0.001]));
        }
    }
    m.made()
}

fn drum(d: &mut Stream) -> Made {
    let (r, h) = (d.range(0.13, 0.25), d.range(0.12, 0.4));
    let mut m = Maker::default();
    m.add(
        *d.pick(&[Stuff::Wood, Stuff::PaintedMetal, Stuff::Metal]),
        lathe_loop(&[[r - 0.006, 0.01], [r, 0.01], [r, h - 0.01], [r - 0.006, h - 0.01]], 48),
    );
    for y in [0.004, h - 0.012] {
        m.add(
            Stuff::Metal,
            lathe_loop(&[[r - 0.002, y], [r + 0.012, y], [r + 0.012, y + 0.016], [r - 0.002, y + 0.016]], 48),
        );
    }
    m.add(Stuff::Paper, extrude(&circle(44, r - 0.003), 0.002).turned_x(-0.5 * PI).at([0.0, h - 0.003, 0.0]));
    m.top([0.0, h - 0.002, 0.0], [0.6 * r, 0.6 * r], f64::INFINITY);
    let lugs = 6 + 2 * d.below(3);
    for k in 0..lugs {
        let a = TAU * k as f64 / lugs as f64;
        let (s, c) = (maths::sin(a), maths::cos(a));
        let q = r + 0.016;
        m.add(Stuff::Metal, rod([q * s, 0.0, q * c], [q * s, h + 0.006, q * c], 0.003, 6));
        m.add(Stuff::Metal, soft_block([0.0, 0.5 * h, r + 0.008], [0.008, 0.035, 0.009], 0.004, 2).turned_y(a));
    }
    m.made()
}

fn piano(d: &mut Stream) -> Made {
    let (half, h, deep) = (0.74, d.range(1.1, 1.25), d.range(0.15, 0.18));
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Plastic]);
    let mut m = Maker::default();
    m.add(stuff, board([0.0, 0.5 * h, -0.12], [half - 0.03, 0.5 * h - 0.03, deep]));
    m.add(stuff, board([0.0, h - 0.012, -0.115], [half + 0.01, 0.014, deep + 0.02]));
    m.top([0.0, h + 0.002, -0.115], [half - 0.02, deep], f64::INFINITY);
    for s in [-1.0, 1.0] {
        m.add(stuff, board([s * (half - 0.015), 0.5 * (h - 0.03), -0.12], [0.015, 0.5 * (h - 0.03), deep + 0.01]));
        m.add(stuff, board([s * (half - 0.03), 0.66, 0.18], [0.03, 0.06, 0.14]));
        m.add(stuff, tube(&[[s * (half - 0.05), 0.0, 0.26], [s * (half - 0.05), 0.6, 0.26]], 12, |t| 0.022 + 0.01 * t));
    }
    m.add(stuff, board([0.0, 0.6, 0.17], [half - 0.06, 0.03, 0.15]));
    let keys = 52;
    let w = (half - 0.065) / f64::from(keys);
    let white = Body::all(
        (0..keys)
            .map(|k| block([(2.0 * f64::from(k) + 1.0 - f64::from(keys)) * w, 0.642, 0.23], [w * 0.94, 0.011, 0.075])),
    );
    m.add(Stuff::Wax, white);
    let black = Body::all(
        (0..keys - 1)
            .filter(|k| ![2, 6].contains(&(k % 7)))
            .map(|k| block([(2.0 * f64::from(k) + 2.0 - f64::from(keys)) * w, 0.659, 0.205], [w * 0.5, 0.007, 0.05])),
    );
    m.another(Stuff::Plastic, black);
    m.add(stuff, board([0.0, 0.78, 0.055], [half - 0.1, 0.1, 0.008]));
    for x in [-0.05, 0.0, 0.05] {
        m.add(Stuff::Metal, board([x, 0.05, 0.1], [0.012, 0.005, 0.06]));
    }
    m.made()
}

fn xylophone(d: &mut Stream) -> Made {
    let bars = 8 + d.below(8);
    let w = 0.013;
    let mut m = Maker::default();
    let half = 0.016 * bars as f64;
    for s in [-1.0, 1.0] {
        m.add(
            Stuff::Wood,
            beam([-half - 0.02, 0.012, s * 0.065], [half + 0.02, 0.012, s * 0.035], [0.024, 0.02], [0.0, 1.0, 0.0]),
        );
    }
    let stuff = *d.pick(&[Stuff::Metal, Stuff::Wood, Stuff::PaintedMetal]);
    for k in 0..bars {
        let x = 0.032 * (k as f64 + 0.5) - half;
        let l = 0.13 - 0.07 * k as f64 / bars as f64;
        m.another(stuff, board([x, 0.0275, 0.0], [w, 0.003, l]));
    }
    let turn = d.range(-0.5, 0.5);
    let stick = |b: Body| b.turned_y(turn).at([0.0, 0.0, 0.19]);
    m.add(Stuff::Wood, stick(rod([-0.12, 0.012, 0.0], [0.1, 0.012, 0.0], 0.0035, 8)));
    m.add(Stuff::Rubber, stick(ball(0.012, 14).at([0.1, 0.012, 0.0])));
    m.made()
}

fn trumpet(d: &mut Stream) -> Made {
    let l = d.range(0.44, 0.5);
    let mut m = Maker::default();
    let y = 0.065;
    let bell = flat_spline(&[[0.006, 0.0], [0.0065, 0.4 * l], [0.011, 0.75 * l], [0.022, 0.92 * l], [0.06, l]], 5);
    let back = bell.iter().rev().map(|p| [p[0] - 0.0015, p[1] + 0.0004]).collect::<Vec<_>>();
    let profile: Vec<_> = bell.into_iter().chain(back).collect();
    m.add(Stuff::Metal, lathe_loop(&profile, 32).smooth().turned_z(-0.5 * PI).at([-0.4 * l, y, 0.0]));
    let q = 0.045;
    let path: Vec<Vec3> = [[-0.4 * l, y, 0.0]]
        .into_iter()
        .chain(arc([-0.4 * l, y - q], q, 0.5 * PI, 1.5 * PI, 10).into_iter().skip(1).map(|[a, b]| [a, b, 0.0]))
        .chain([[0.2 * l, y - 2.0 * q, 0.0]])
        .collect();
    m.add(Stuff::Metal, tube(&path, 10, |_| 0.006));
    let lead: Vec<Vec3> = [[-0.75 * l, y, 0.025], [0.25 * l, y, 0.025]]
        .into_iter()
        .chain(arc([0.25 * l, y - q], q, 0.5 * PI, -0.5 * PI, 10).into_iter().skip(1).map(|[a, b]| [a, b, 0.025]))
        .chain([[0.0, y - 2.0 * q, 0.025]])
        .collect();
    m.add(Stuff::Metal, tube(&lead, 10, |_| 0.006));
    m.add(
        Stuff::Metal,
        lathe(&[[0.0, 0.0], [0.013, 0.0], [0.011, 0.012], [0.005, 0.03], [0.004, 0.08], [0.0, 0.08]], 16)
            .turned_z(-0.5 * PI)
            .at([-0.75 * l - 0.05, y, 0.025]),
    );
    for k in 0..3 {
        let x = -0.12 + 0.035 * f64::from(k);
        m.add(Stuff::Metal, rod([x, y - 2.0 * q - 0.02, 0.012], [x, y + 0.02, 0.012], 0.0115, 14));
        m.add(Stuff::Metal, rod([x, y + 0.02, 0.012], [x, y + 0.045 - 0.012 * f64::from(k % 2), 0.012], 0.003, 6));
        m.add(
            Stuff::Metal,
            rod(
                [x, y + 0.044 - 0.012 * f64::from(k % 2), 0.012],
                [x, y + 0.048 - 0.012 * f64::from(k % 2), 0.012],
                0.008,
                12,
            ),
        );
    }
    m.made()
}

/// A dial in the plane z = `z` with marks and two hands.
fn dial(m: &mut Maker, d: &mut Stream, center: [f64; 2], r: f64, z: f64) {
    let [x, y] = center;
    m.add(Stuff::Paper, extrude(&circle(40, r), 0.001).at([x, y, z + 0.0005]));
    let marks = Body::all((0..12).map(|k| {
        let a = TAU * f64::from(k) / 12.0;
        let big = if k % 3 == 0 { 1.7 } else { 1.0 };
        panel([0.0, 0.86 * r, 0.0], [0.011 * r * big, 0.06 * r * big, 0.0006]).turned_z(-a).at([x, y, z + 0.0016])
    }));
    m.add(Stuff::Plastic, marks);
    let time = d.range(0.0, 12.0);
    for (turns, long, wide, lift) in [(time / 12.0, 0.52, 0.03, 0.003), (time, 0.78, 0.02, 0.0045)] {
        let hand = panel([0.0, 0.5 * long * r - 0.06 * r, 0.0], [wide * r, 0.5 * long * r + 0.06 * r, 0.0005]);
        m.add(Stuff::Plastic, hand.turned_z(-TAU * turns).at([x, y, z + lift]));
    }
    m.add(Stuff::Metal, rod([x, y, z], [x, y, z + 0.0065], 0.04 * r, 10));
}

fn clock_wall(d: &mut Stream) -> Made {
    let r = d.range(0.11, 0.2);
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Metal, Stuff::Plastic, Stuff::PaintedMetal]);
    let rim = d.range(0.08, 0.16) * r;
    let t = 0.025;
    let profile = [
        [0.0, 0.0],
        [r + rim, 0.0],
        [r + rim, 0.6 * t],
        [r + 0.6 * rim, t + 0.008],
        [r, t + 0.006],
        [r - 0.002, 0.3 * t],
        [0.0, 0.3 * t],
    ];
    m.add(stuff, lathe(&profile, 48).turned_x(0.5 * PI).at([0.0, r + rim, 0.0]));
    dial(&mut m, d, [0.0, r + rim], r - 0.003, 0.3 * t + 0.0002);
    m.made()
}

fn clock_alarm(d: &mut Stream) -> Made {
    let r = d.range(0.035, 0.055);
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Metal, Stuff::Plastic]);
    let y = r + 0.018;
    let t = 0.8 * r;
    let profile = [
        [0.0, -t],
        [0.8 * r, -t],
        [r, -0.75 * t],
        [r, 0.0],
        [1.04 * r, 0.002],
        [1.04 * r, 0.006],
        [0.92 * r, 0.008],
        [0.91 * r, 0.0],
        [0.0, 0.0],
    ];
    m.add(stuff, lathe(&profile, 40).turned_x(0.5 * PI).at([0.0, y, 0.0]));
    dial(&mut m, d, [0.0, y], 0.9 * r, 0.0002);
    for s in [-1.0, 1.0] {
        let foot = [s * 0.55 * r, 0.0, -0.4 * t];
        m.add(Stuff::Metal, tube(&[foot, [s * 0.4 * r, 0.35 * y, -0.4 * t]], 8, |_| 0.004));
        let (sn, cs) = (maths::sin(s * 0.55), maths::cos(0.55));
        let bell =
            lathe(&[[0.0, -0.002], [0.42 * r, -0.002], [0.42 * r, 0.0], [0.3 * r, 0.2 * r], [0.0, 0.28 * r]], 24)
                .soft();
        m.add(Stuff::Metal, bell.turned_z(-s * 0.55).at([1.12 * r * sn, y + 1.12 * r * cs, -0.4 * t]));
        m.add(
            Stuff::Metal,
            rod([0.95 * r * sn, y + 0.95 * r * cs, -0.4 * t], [1.13 * r * sn, y + 1.13 * r * cs, -0.4 * t], 0.0025, 6),
        );
    }
    m.add(Stuff::Metal, rod([0.0, y + r - 0.002, -0.4 * t], [0.0, y + 1.35 * r, -0.4 * t], 0.0018, 6));
    m.made()
}

fn clock_case(d: &mut Stream) -> Made {
    let h = d.range(1.8, 2.2);
    let (w, deep) = (d.range(0.2, 0.25), 0.13);
    let mut m = Maker::default();
    let foot = 0.24 * h;
    m.add(Stuff::Wood, board([0.0, 0.03, 0.0], [w + 0.03, 0.03, deep + 0.02]));
    m.add(Stuff::Wood, board([0.0, 0.5 * foot + 0.03, 0.0], [w, 0.5 * foot - 0.03, deep]));
    m.add(Stuff::Wood, board([0.0, foot + 0.015, 0.0], [w + 0.01, 0.015, deep + 0.01]));
    let (waist, top) = (0.78 * w, 0.75 * h);
    // The trunk is open in front, with the pendulum behind a pane.
    for s in [-1.0, 1.0] {
        m.add(
            Stuff::Wood,
            board(
                [s * (waist - 0.015), 0.5 * (foot + 0.03 + top), 0.0],
                [0.015, 0.5 * (top - foot - 0.03), deep - 0.02],
            ),
        );
    }
    m.add(
        Stuff::Wood,
        board([0.0, 0.5 * (foot + 0.03 + top), -deep + 0.03], [waist - 0.03, 0.5 * (top - foot - 0.03), 0.008]),
    );
    m.add(
        Stuff::Pane,
        sheet(1, 1, |s, t| [(waist - 0.03) * (2.0 * s - 1.0), foot + 0.03 + (top - foot - 0.03) * t, deep - 0.04]),
    );
    let swing = d.range(-0.06, 0.06);
    m.add(Stuff::Metal, rod([0.0, top, 0.0], [swing, foot + 0.25, 0.0], 0.003, 6));
    m.add(
        Stuff::Metal,
        lathe(&[[0.0, -0.008], [0.05, -0.006], [0.06, 0.0], [0.05, 0.006], [0.0, 0.008]], 28).turned_x(0.5 * PI).at([
            swing,
            foot + 0.25,
            0.0,
        ]),
    );
    for x in [-0.06, 0.06] {
        let y = foot + d.range(0.35, 0.6);
        m.add(Stuff::Metal, rod([x, y, -0.03], [x, y + 0.16, -0.03], 0.02, 14));
        m.add(Stuff::Metal, rod([x, y + 0.15, -0.03], [x, top, -0.03], 0.0015, 5));
    }
    m.add(Stuff::Wood, board([0.0, top + 0.015, 0.0], [w + 0.01, 0.015, deep + 0.01]));
    let head = h - top - 0.1;
    m.add(Stuff::Wood, board([0.0, top + 0.03 + 0.5 * head, -0.01], [w, 0.5 * head, deep - 0.02]));
    let r = (0.42 * head).min(0.85 * w);
    m.add(
        Stuff::Metal,
        lathe_loop(&[[r, 0.0], [r + 0.012, 0.0], [r + 0.012, 0.006], [r, 0.01]], 40).turned_x(0.5 * PI).at([
            0.0,
            top + 0.03 + 0.5 * head,
            deep - 0.03,
        ]),
    );
    dial(&mut m, d, [0.0, top + 0.03 + 0.5 * head], r, deep - 0.0298);
    let cap: Vec<[f64; 2]> = [[w + 0.03, 0.0]]
        .into_iter()
        .chain((0..=14).map(|k| f64::from(k) / 7.0 - 1.0).map(|a| [-(w + 0.03) * a, 0.02 + 0.06 * (1.0 - a * a)]))
        .chain([[-w - 0.03, 0.0]])
        .collect();
    m.add(Stuff::Wood, extrude(&cap, 2.0 * deep + 0.02).at([0.0, top + 0.03 + head, 0.0]));
    m.made()
}

/// Four mitred sides of a moulded section round an opening of `half` size, upright about (0, `y`).
fn moulding(half: [f64; 2], wide: f64, deep: f64, y: f64) -> Body {
    let section = [[0.0, 0.0], [0.0, 0.6], [0.25, 0.75], [0.4, 1.0], [0.75, 0.9], [1.0, 0.55], [1.0, 0.0]];
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    Body::all((0..4).map(|k| {
        let (a, b) = (corners[k], corners[(k + 1) % 4]);
        let ring = |c: (f64, f64)| {
            section
                .iter()
                .map(|[o, z]| [c.0 * (half[0] + o * wide), y + c.1 * (half[1] + o * wide), z * deep])
                .collect::<Vec<Vec3>>()
        };
        skin(&[ring(a), ring(b)], [true, false], [true, true]).across()
    }))
}

fn framed(m: &mut Maker, d: &mut Stream, half: [f64; 2], face: Stuff) -> f64 {
    let (wide, deep) = (d.range(0.015, 0.06), d.range(0.012, 0.03));
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Wood, Stuff::Metal, Stuff::Plastic]);
    let y = half[1] + wide;
    m.add(stuff, moulding(half, wide, deep, y));
    m.add(Stuff::Paper, panel([0.0, y, 0.0015], [half[0] + 0.3 * wide, half[1] + 0.3 * wide, 0.0015]));
    let mount = if face == Stuff::Print && d.chance(0.5) { 0.15 * half[0].min(half[1]) } else { 0.0 };
    let z = 0.0032;
    m.add(face, sheet(1, 1, |s, t| [(half[0] - mount) * (2.0 * s - 1.0), y + (half[1] - mount) * (2.0 * t - 1.0), z]));
    y
}

fn picture(d: &mut Stream) -> Made {
    let a = d.range(0.1, 0.5);
    let ratio = d.range(0.6, 1.0);
    let half = if d.chance(0.5) { [a, a * ratio] } else { [a * ratio, a] };
    let mut m = Maker::default();
    let y = framed(&mut m, d, half, Stuff::Print);
    if d.chance(0.3) {
        m.add(Stuff::Pane, sheet(1, 1, |s, t| [half[0] * (2.0 * s - 1.0), y + half[1] * (2.0 * t - 1.0), 0.006]));
    }
    m.made()
}

fn mirror(d: &mut Stream) -> Made {
    let mut m = Maker::default();
    if d.chance(0.5) {
        let half = [d.range(0.15, 0.4), d.range(0.2, 0.7)];
        framed(&mut m, d, half, Stuff::Mirror);
    } else {
        let (r, rim) = (d.range(0.15, 0.4), d.range(0.02, 0.05));
        let oval = d.range(1.0, 1.5);
        let y = (r + rim) * oval;
        let ring = lathe_loop(&[[r, 0.0], [r + rim, 0.0], [r + rim, 0.012], [r + 0.5 * rim, 0.024], [r, 0.01]], 56)
            .turned_x(0.5 * PI)
            .scaled([1.0, oval, 1.0]);
        m.add(*d.pick(&[Stuff::Wood, Stuff::Metal]), ring.at([0.0, y, 0.0]));
        let disc: Vec<[f64; 2]> = circle(56, r + 0.002).into_iter().map(|[a, b]| [a, b * oval]).collect();
        m.add(Stuff::Mirror, extrude(&disc, 0.004).at([0.0, y, 0.004]));
    }
    m.made()
}

fn photo(d: &mut Stream) -> Made {
    let half = [d.range(0.05, 0.1), d.range(0.06, 0.12)];
    let mut inner = Maker::default();
    framed(&mut inner, d, half, Stuff::Print);
    let lean = d.range(0.15, 0.3);
    let mut m = Maker::default();
    inner.bodies().into_iter().for_each(|(stuff, body)| m.add(stuff, body.turned_x(-lean)));
    let high = 1.3 * half[1];
    m.add(
        Stuff::Plastic,
        beam(
            [0.0, high * maths::cos(lean), -high * maths::sin(lean) - 0.001],
            [0.0, 0.002, -1.05 * half[1]],
            [0.003, 0.03],
            [0.0, 0.0, 1.0],
        ),
    );
    m.made()
}
