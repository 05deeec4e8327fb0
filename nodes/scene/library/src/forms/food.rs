//! Fruit, bread, cake.

use super::{
    super::{noise::fractal, shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::{Maker, one},
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("apple", Family::Food, 8, apple),
    form("pear", Family::Food, 8, pear),
    form("banana", Family::Food, 6, banana),
    form("lemon", Family::Food, 6, lemon),
    form("bread_loaf", Family::Food, 6, loaf),
    form("cheese", Family::Food, 6, cheese),
    form("egg", Family::Food, 4, egg),
    form("cake", Family::Food, 6, cake),
    form("pumpkin", Family::Food, 6, pumpkin),
    form("fruit_bowl", Family::Food, 8, fruit_bowl),
];

fn stalk(m: &mut Maker, y: f64, l: f64) {
    m.add(
        Stuff::Bark,
        tube(&spline(&[[0.0, y - 0.006, 0.0], [0.001, y + 0.4 * l, 0.0], [0.3 * l, y + l, 0.0]], 3), 6, |t| {
            0.0016 + 0.0008 * t
        }),
    );
}

fn apple_body(d: &mut Stream) -> (Body, f64) {
    let r = d.range(0.032, 0.042);
    let (low, lobes, phase) = (d.range(0.82, 0.95), 5.0, d.range(0.0, TAU));
    let profile = flat_spline(
        &[
            [0.0, 0.12],
            [0.25, 0.03],
            [0.55 * low, 0.1],
            [0.88 * low, 0.5],
            [1.0, 1.0],
            [0.9, 1.5],
            [0.55, 1.78],
            [0.25, 1.74],
            [0.0, 1.5],
        ],
        3,
    );
    let body = lathe(&profile, 28).smooth().bent(|p| {
        let a = maths::atan2(p[0], p[2]);
        let k = 1.0 + 0.03 * maths::cos(lobes * a + phase);
        [p[0] * k * r, p[1] * r, p[2] * k * r]
    });
    (body, 1.5 * r)
}

fn apple(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let (body, y) = apple_body(d);
    m.add(Stuff::Food, body);
    stalk(&mut m, y, 0.02);
    m.made()
}

fn pear(d: &mut Stream) -> FormVariant {
    let (r, h, neck) = (d.range(0.03, 0.038), d.range(0.08, 0.1), d.range(0.35, 0.55));
    let lean = d.range(-0.1, 0.1);
    let profile = flat_spline(
        &[
            [0.0, 0.004],
            [0.5 * r, 0.0],
            [0.9 * r, 0.15 * h],
            [r, 0.33 * h],
            [0.8 * r, 0.55 * h],
            [neck * r, 0.78 * h],
            [0.3 * r, 0.96 * h],
            [0.0, h],
        ],
        4,
    );
    let mut m = Maker::default();
    m.add(Stuff::Food, lathe(&profile, 28).smooth().bent(|p| [p[0] + lean * p[1] * p[1] / h, p[1], p[2]]));
    stalk(&mut m, h, 0.022);
    m.made()
}

fn banana(d: &mut Stream) -> FormVariant {
    let count = 1 + d.below(4);
    let (l, r, bend) = (d.range(0.15, 0.19), d.range(0.015, 0.019), d.range(1.2, 1.7));
    let mut m = Maker::default();
    for k in 0..count {
        let path: Vec<_> = (0..=18)
            .map(|j| {
                let a = bend * (f64::from(j) / 18.0 - 0.5);
                let big = l / bend;
                [big * maths::sin(a), 0.0, big * (maths::cos(a) - 1.0)]
            })
            .collect();
        let body = sweep(&path, &circle(5, 1.0), [0.0, 1.0, 0.0], |t| {
            let end = maths::pow((4.0 * t * (1.0 - t)).max(0.0), 0.35);
            r * if t > 0.9 { (0.22f64).max(end * 0.7) } else { (0.12f64).max(end) }
        });
        let fan = 0.16 * (k as f64 - 0.5 * (count - 1) as f64);
        m.add(Stuff::Food, body.smooth().turned_y(fan).at([0.0, r * 0.8, 2.2 * r * k as f64]));
    }
    m.made()
}

fn lemon(d: &mut Stream) -> FormVariant {
    let (r, l) = (d.range(0.025, 0.032), d.range(0.036, 0.045));
    let profile = flat_spline(
        &[
            [0.0, -l],
            [0.16 * r, -0.95 * l],
            [0.35 * r, -0.82 * l],
            [0.8 * r, -0.5 * l],
            [r, 0.0],
            [0.8 * r, 0.5 * l],
            [0.35 * r, 0.84 * l],
            [0.12 * r, 0.96 * l],
            [0.0, l],
        ],
        3,
    );
    let turn = d.range(0.0, TAU);
    one(Stuff::Food, lathe(&profile, 26).smooth().turned_z(0.5 * PI).turned_y(turn))
}

fn loaf(d: &mut Stream) -> FormVariant {
    let (l, w, h) = (d.range(0.1, 0.17), d.range(0.045, 0.065), d.range(0.06, 0.1));
    let (seed, cuts) = (d.bits(), 3 + d.below(4));
    let deep = d.range(0.004, 0.009);
    let rows = 48;
    let rings: Vec<Vec<_>> = (0..=rows)
        .map(|j| {
            let x = 2.0 * j as f64 / rows as f64 - 1.0;
            let k = maths::pow((1.0 - maths::pow(x.abs(), 3.5)).max(0.0), 0.5);
            (0..32)
                .map(|i| {
                    let a = TAU * f64::from(i) / 32.0;
                    let (c, s) = (maths::cos(a), maths::sin(a));
                    let up = if s > 0.0 { h } else { 0.25 * h };
                    let slash = deep
                        * maths::pow(maths::sin(0.5 * PI * (cuts as f64 * x + 0.6 * c)).abs(), 12.0)
                        * s.max(0.0)
                        * k;
                    let wild = 0.003 * fractal(seed, [30.0 * l * x, 2.0 * c, 2.0 * s], [0; 3], 3) * k;
                    let y = 0.25 * h + (up * maths::pow(s.abs(), 0.8) * if s > 0.0 { 1.0 } else { -1.0 }) * k - slash
                        + wild * s.max(0.0);
                    [l * x, y, -(w * k) * c * (1.0 + 0.02 * s)]
                })
                .collect()
        })
        .collect();
    one(Stuff::Food, skin(&rings, [true, false], [false; 2]).smooth())
}

fn cheese(d: &mut Stream) -> FormVariant {
    let (r, h, part) = (d.range(0.08, 0.14), d.range(0.04, 0.08), d.range(0.5, 1.2));
    // Holes are balls taken out.
    let holes: Vec<([f64; 3], f64)> = (0..7)
        .map(|_| {
            let (a, k, y) = (0.5 * part * d.range(-1.0, 1.0), r * d.range(0.2, 0.95), h * d.range(0.1, 1.0));
            ([k * maths::cos(a), y, -k * maths::sin(a)], d.range(0.004, 0.011))
        })
        .collect();
    let (s, c) = (maths::sin(0.5 * part), maths::cos(0.5 * part));
    let distance = |p: [f64; 3]| {
        let flat = (p[0] * p[0] + p[2] * p[2]).sqrt() - r;
        let sides = (p[2].abs() * c - p[0] * s).max(flat).max(-p[1]).max(p[1] - h);
        holes.iter().fold(sides, |v, (q, k)| {
            let e = [p[0] - q[0], p[1] - q[1], p[2] - q[2]];
            v.max(k - (e[0] * e[0] + e[1] * e[1] + e[2] * e[2]).sqrt())
        })
    };
    let wide = r * s;
    let body = Field { distance, low: [-0.002, -0.002, -wide - 0.002], high: [r + 0.002, h + 0.002, wide + 0.002] }
        .body(0.0042);
    one(Stuff::Wax, body)
}

fn egg(d: &mut Stream) -> FormVariant {
    let (r, l) = (d.range(0.02, 0.023), d.range(0.027, 0.031));
    let profile: Vec<_> = (0..=16)
        .map(|k| {
            let a = PI * (f64::from(k) / 16.0 - 0.5);
            [if k == 0 || k == 16 { 0.0 } else { r * maths::cos(a) * (1.0 - 0.14 * maths::sin(a)) }, l * maths::sin(a)]
        })
        .collect();
    let (tilt, turn) = (d.range(1.2, 1.5), d.range(0.0, TAU));
    one(Stuff::Food, lathe(&profile, 26).smooth().turned_x(tilt).turned_y(turn))
}

fn cake(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.08, 0.13), d.range(0.05, 0.09));
    let mut m = Maker::default();
    m.add(
        Stuff::Ceramic,
        lathe(
            &[
                [0.0, 0.0],
                [0.05, 0.0],
                [0.03, 0.02],
                [0.02, 0.05],
                [r, 0.06],
                [r + 0.025, 0.066],
                [r + 0.025, 0.07],
                [0.0, 0.067],
            ],
            48,
        ),
    );
    let base = 0.068;
    let drips = 9 + d.below(6);
    m.add(Stuff::Food, lathe(&[[0.0, base], [r, base], [r, base + h - 0.003], [0.0, base + h - 0.003]], 48));
    let deep = d.range(0.3, 0.7);
    // Icing that runs down the side.
    let n = 96;
    let rings: Vec<Vec<_>> = (0..7)
        .map(|j| {
            (0..n)
                .map(|i| {
                    let a = TAU * i as f64 / n as f64;
                    let run = h
                        * deep
                        * (0.35
                            + 0.65 * maths::pow(0.5 + 0.5 * maths::cos(drips as f64 * a + maths::sin(3.0 * a)), 2.0));
                    let (k, y) = [
                        (r + 0.0004, -run),
                        (r + 0.003, -run + 0.002),
                        (r + 0.004, -0.5 * run),
                        (r + 0.003, 0.0),
                        (r - 0.006, 0.004),
                        (0.5 * r, 0.0045),
                        (0.0, 0.0045),
                    ][j];
                    [k * maths::sin(a), base + h + y, k * maths::cos(a)]
                })
                .collect()
        })
        .collect();
    m.another(Stuff::Wax, skin(&rings, [true, false], [false; 2]).smooth());
    let berries = 5 + d.below(6);
    for k in 0..berries {
        let a = TAU * k as f64 / berries as f64;
        m.add(Stuff::Food, ball(0.009, 12).at([0.75 * r * maths::sin(a), base + h + 0.012, 0.75 * r * maths::cos(a)]));
    }
    m.made()
}

fn pumpkin(d: &mut Stream) -> FormVariant {
    let (r, squash, ribs) = (d.range(0.07, 0.15), d.range(0.6, 0.95), 8 + d.below(6));
    let n = ribs * 6;
    let rings: Vec<Vec<_>> = (0..=18)
        .map(|j| {
            let a = PI * (f64::from(j) / 18.0 - 0.5);
            (0..n)
                .map(|i| {
                    let b = TAU * i as f64 / n as f64;
                    let rib = 0.86 + 0.14 * maths::sin(0.5 * ribs as f64 * b).abs();
                    let pole = j == 0 || j == 18;
                    let k = if pole { 0.0 } else { r * maths::cos(a) * rib };
                    let dent = 0.22 * maths::pow(maths::sin(a).abs(), 8.0);
                    [k * maths::sin(b), r * squash * (1.0 + maths::sin(a) * (1.0 - dent)), k * maths::cos(b)]
                })
                .collect()
        })
        .collect();
    let mut m = Maker::default();
    m.add(Stuff::Food, skin(&rings, [true, false], [false; 2]).smooth());
    let y = r * squash * 1.76;
    m.add(
        Stuff::Bark,
        tube(&spline(&[[0.0, y, 0.0], [0.0, y + 0.2 * r, 0.0], [0.15 * r, y + 0.38 * r, 0.0]], 3), 7, |t| {
            r * (0.14 - 0.05 * t)
        }),
    );
    m.made()
}

fn fruit_bowl(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let (r, h) = (d.range(0.13, 0.17), d.range(0.062, 0.085));
    let outer = flat_spline(&[[0.05, 0.0], [0.05, 0.006], [0.1, 0.4 * h], [r, h]], 5);
    let inner = flat_spline(&[[r - 0.003, h + 0.002], [0.096, 0.43 * h], [0.045, 0.012], [0.0, 0.01]], 5);
    m.add(
        *d.pick(&[Stuff::Ceramic, Stuff::Wood, Stuff::Metal]),
        lathe(&[[0.0, 0.0]].into_iter().chain(outer).chain(inner).collect::<Vec<_>>(), 44).smooth(),
    );
    // One layer round the middle, one on top.
    let ring = 5;
    let size = |d: &mut Stream| d.range(0.033, 0.037);
    for k in 0..=ring {
        let a = TAU * k as f64 / ring as f64;
        let at = if k == ring { [0.0, 0.09, 0.0] } else { [0.066 * maths::sin(a), 0.047, 0.066 * maths::cos(a)] };
        let body = if d.chance(0.5) {
            let (body, y) = apple_body(d);
            let k = 0.036 / (y / 1.5);
            body.scaled([k, k, k]).at([0.0, -0.033, 0.0])
        } else {
            ball(size(d), 22)
        };
        m.another(Stuff::Food, body.turned_x(d.range(-0.5, 0.5)).turned_y(d.range(0.0, TAU)).at(at));
    }
    m.made()
}
