//! Plates, cutlery, pans, food.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, Made, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("plate", Family::Plate, 8, plate),
    form("plate_soup", Family::Plate, 6, soup),
    form("tray", Family::Plate, 6, tray),
    form("fork", Family::Utensil, 6, fork),
    form("knife", Family::Utensil, 6, knife),
    form("spoon", Family::Utensil, 6, spoon),
    form("pan_frying", Family::Utensil, 6, pan),
    form("pot_cooking", Family::Utensil, 6, pot),
    form("chopping_board", Family::Utensil, 6, chopping),
    form("whisk", Family::Utensil, 4, whisk),
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

fn one(stuff: Stuff, body: Body) -> Made {
    let mut m = Maker::default();
    m.add(stuff, body);
    m.made()
}

fn plate(d: &mut Stream) -> Made {
    let (r, rim) = (d.range(0.08, 0.14), d.range(0.012, 0.025));
    let foot = r * d.range(0.55, 0.7);
    let mut m = Maker::default();
    let profile = [
        [0.0, 0.002],
        [foot - 0.004, 0.002],
        [foot - 0.003, 0.0],
        [foot, 0.0],
        [0.8 * r, 0.45 * rim],
        [r, rim],
        [r, rim + 0.002],
        [0.78 * r, 0.45 * rim + 0.003],
        [0.68 * r, 0.006],
        [0.0, 0.0055],
    ];
    m.add(*d.pick(&[Stuff::Ceramic, Stuff::Ceramic, Stuff::Metal]), lathe(&profile, 48).soft());
    m.top([0.0, 0.0057, 0.0], [0.45 * r, 0.45 * r], f64::INFINITY);
    m.made()
}

fn soup(d: &mut Stream) -> Made {
    let (r, deep) = (d.range(0.1, 0.125), d.range(0.03, 0.045));
    let well = r * d.range(0.66, 0.75);
    let outer = flat_spline(
        &[[0.5 * well, 0.0], [0.55 * well, 0.002], [0.95 * well, 0.6 * deep], [1.05 * well, 0.85 * deep], [r, deep]],
        4,
    );
    let inner = flat_spline(
        &[
            [r, deep + 0.002],
            [1.03 * well, 0.85 * deep + 0.003],
            [0.91 * well, 0.6 * deep],
            [0.5 * well, 0.006],
            [0.0, 0.005],
        ],
        4,
    );
    let profile: Vec<_> = [[0.0, 0.0]].into_iter().chain(outer).chain(inner).collect();
    one(Stuff::Ceramic, lathe(&profile, 48).smooth())
}

fn tray(d: &mut Stream) -> Made {
    let half = [d.range(0.17, 0.25), d.range(0.12, 0.18)];
    let rim = d.range(0.02, 0.045);
    let r = d.range(0.02, 0.09);
    let ring = |k: f64, y: f64| {
        rounded_rect([half[0] + k, half[1] + k], r + k * 0.5, 6)
            .into_iter()
            .rev()
            .map(|[x, z]| [x, y, z])
            .collect::<Vec<_>>()
    };
    let t = 0.005;
    let lean = d.range(0.0, 0.02);
    let rings = [ring(0.0, 0.0), ring(lean, rim), ring(lean - t, rim), ring(-t, t)];
    let mut m = Maker::default();
    m.add(*d.pick(&[Stuff::Wood, Stuff::Metal, Stuff::Plastic]), skin(&rings, [true, false], [true, true]));
    m.top([0.0, t, 0.0], [half[0] - 0.5 * r - t, half[1] - 0.5 * r - t], f64::INFINITY);
    m.made()
}

/// A flat handle that lies along x from 0 to `l`.
fn grip(l: f64, w: f64, arch: f64) -> Body {
    slab(14, 3, 0.0025, |s, t| {
        let k = w * (0.45 + 0.55 * maths::pow(s, 1.5)) * if s > 0.95 { 0.8 } else { 1.0 };
        [l * s, 0.004 + arch * maths::sin(PI * s), -k * (2.0 * t - 1.0)]
    })
}

fn fork(d: &mut Stream) -> Made {
    let (l, w, tines) = (d.range(0.11, 0.13), d.range(0.007, 0.01), 3 + d.below(2));
    let mut m = Maker::default();
    m.add(Stuff::Metal, grip(l, w, 0.006));
    let head = d.range(0.011, 0.014);
    m.add(
        Stuff::Metal,
        slab(5, 4, 0.002, |s, t| {
            let k = head * (0.35 + 0.65 * maths::sin(0.5 * PI * s));
            [-0.022 * s + 0.001, 0.004 - 0.003 * s, k * (2.0 * t - 1.0)]
        }),
    );
    for k in 0..tines {
        let z = head * 0.86 * (2.0 * k as f64 / (tines - 1) as f64 - 1.0);
        let path = spline(&[[-0.019, 0.0003, z], [-0.035, 0.0002, z], [-0.05, 0.004, z], [-0.06, 0.009, z]], 3);
        m.add(
            Stuff::Metal,
            sweep(
                &path,
                &[[0.0008, -0.0014], [0.0008, 0.0014], [-0.0008, 0.0014], [-0.0008, -0.0014]],
                [0.0, 1.0, 0.0],
                |t| 1.0 - 0.5 * t,
            ),
        );
    }
    m.made()
}

fn knife(d: &mut Stream) -> Made {
    let (l, blade_l, h) = (d.range(0.09, 0.12), d.range(0.1, 0.2), d.range(0.009, 0.02));
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Metal, Stuff::Plastic]);
    m.add(stuff, soft_block([0.5 * l, 0.007, 0.0], [0.5 * l, 0.007, 0.009], 0.006, 2));
    // Lying on its side: the blade is a wedge in the plane y = const, its edge towards +z.
    let outline: Vec<[f64; 2]> = (0..=12)
        .map(|k| {
            let t = f64::from(k) / 12.0;
            [-blade_l * t, h * maths::pow(1.0 - t, 0.35)]
        })
        .chain([[0.0, -0.4 * h]])
        .collect();
    let outline: Vec<[f64; 2]> = outline.into_iter().chain([[0.003, -0.4 * h], [0.003, 0.5 * h]]).collect();
    m.add(Stuff::Metal, extrude(&outline, 0.0016).turned_x(0.5 * PI).at([0.0, 0.007, 0.0]));
    m.made()
}

fn spoon(d: &mut Stream) -> Made {
    let (l, w, bowl) = (d.range(0.09, 0.14), d.range(0.006, 0.009), d.range(0.012, 0.021));
    let long = 1.5 * bowl;
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Metal, Stuff::Metal, Stuff::Wood]);
    m.add(stuff, grip(l, w, 0.006));
    let deep = 0.45 * bowl;
    m.add(
        stuff,
        skin(
            &(0..=8)
                .map(|j| {
                    // Over the inside of the bowl and back under it.
                    let t = f64::from(j) / 8.0;
                    let (k, low) = if t < 0.5 { (2.0 * t, 0.0012) } else { (2.0 - 2.0 * t, 0.0) };
                    circle(24, k.max(0.0))
                        .into_iter()
                        .map(|[c, s]| [-long + long * c * 1.02, 0.0015 + deep * k * k + low, bowl * s])
                        .collect()
                })
                .collect::<Vec<_>>(),
            [true, false],
            [false; 2],
        )
        .smooth(),
    );
    m.made()
}

fn pan(d: &mut Stream) -> Made {
    let (r, h) = (d.range(0.1, 0.15), d.range(0.035, 0.06));
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Metal, Stuff::PaintedMetal]);
    m.add(
        stuff,
        lathe(
            &[
                [0.0, 0.0],
                [0.82 * r, 0.0],
                [0.88 * r, 0.004],
                [r, h],
                [r - 0.003, h + 0.001],
                [0.86 * r, 0.007],
                [0.8 * r, 0.004],
                [0.0, 0.004],
            ],
            48,
        ),
    );
    m.top([0.0, 0.004, 0.0], [0.5 * r, 0.5 * r], f64::INFINITY);
    let l = d.range(0.15, 0.2);
    let path = spline(
        &[[0.95 * r, 0.75 * h, 0.0], [r + 0.03, h, 0.0], [r + 0.5 * l, h + 0.02, 0.0], [r + l, h + 0.025, 0.0]],
        4,
    );
    m.add(
        *d.pick(&[Stuff::Wood, Stuff::Plastic, Stuff::Metal]),
        sweep(&path, &rounded_rect([0.006, 0.011], 0.005, 2), [0.0, 1.0, 0.0], |t| 0.75 + 0.25 * t),
    );
    m.made()
}

fn pot(d: &mut Stream) -> Made {
    let (r, h) = (d.range(0.08, 0.13), d.range(0.08, 0.18));
    let stuff = *d.pick(&[Stuff::Metal, Stuff::PaintedMetal]);
    let mut m = Maker::default();
    m.add(
        stuff,
        lathe(
            &[
                [0.0, 0.0],
                [r - 0.006, 0.0],
                [r, 0.006],
                [r, h],
                [r + 0.003, h + 0.002],
                [r - 0.003, h + 0.002],
                [r - 0.003, 0.005],
                [0.0, 0.005],
            ],
            48,
        ),
    );
    for s in [-1.0, 1.0] {
        let y = 0.8 * h;
        let path = spline(
            &[
                [s * (r - 0.001), y, -0.035],
                [s * (r + 0.025), y, -0.025],
                [s * (r + 0.025), y, 0.025],
                [s * (r - 0.001), y, 0.035],
            ],
            4,
        );
        m.add(stuff, tube(&path, 8, |_| 0.005));
    }
    if d.chance(0.6) {
        let y = h + 0.0025;
        m.add(
            stuff,
            lathe(
                &[
                    [0.0, y],
                    [r + 0.001, y],
                    [r + 0.001, y + 0.003],
                    [0.6 * r, y + 0.016],
                    [0.02, y + 0.022],
                    [0.008, y + 0.026],
                    [0.016, y + 0.04],
                    [0.0, y + 0.043],
                ],
                40,
            )
            .soft(),
        );
    }
    m.made()
}

fn chopping(d: &mut Stream) -> Made {
    let half = [d.range(0.12, 0.2), d.range(0.09, 0.13)];
    let t = d.range(0.012, 0.03);
    let mut m = Maker::default();
    let hole: Vec<_> = circle(16, 0.012).into_iter().map(|[x, y]| [x + half[0] - 0.03, y]).collect();
    m.add(
        Stuff::Wood,
        extrude_with_holes(&rounded_rect(half, 0.02, 4), &[hole], t).turned_x(-0.5 * PI).at([0.0, 0.5 * t, 0.0]),
    );
    m.top([-0.025, t, 0.0], [half[0] - 0.05, half[1] - 0.02], f64::INFINITY);
    m.made()
}

fn whisk(d: &mut Stream) -> Made {
    let (l, head, w) = (d.range(0.1, 0.13), d.range(0.12, 0.16), d.range(0.025, 0.035));
    let mut m = Maker::default();
    m.add(
        *d.pick(&[Stuff::Metal, Stuff::Wood]),
        tube(&[[0.0, w, 0.0], [0.5 * l, w, 0.0], [l, w, 0.0]], 12, |t| 0.007 + 0.002 * maths::sin(PI * t)),
    );
    for k in 0..5 {
        let a = PI * f64::from(k) / 5.0;
        let (s, c) = (maths::sin(a), maths::cos(a));
        let path: Vec<_> = (0..=20)
            .map(|j| {
                let b = TAU * f64::from(j) / 20.0;
                let (x, y) =
                    (0.5 * (1.0 - maths::cos(b)), maths::sin(b) * maths::pow(0.5 * (1.0 - maths::cos(b)), 0.7));
                [0.004 - head * x, w + w * y * c, w * y * s]
            })
            .collect();
        m.add(Stuff::Metal, tube(&path, 5, |_| 0.0009));
    }
    m.made()
}

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

fn apple(d: &mut Stream) -> Made {
    let mut m = Maker::default();
    let (body, y) = apple_body(d);
    m.add(Stuff::Food, body);
    stalk(&mut m, y, 0.02);
    m.made()
}

fn pear(d: &mut Stream) -> Made {
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
    let made = m;
    made.made()
}

fn banana(d: &mut Stream) -> Made {
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
        let body = sweep(&path, &circle(5, 1.0).iter().flat_map(|p| [*p]).collect::<Vec<_>>(), [0.0, 1.0, 0.0], |t| {
            let end = maths::pow((4.0 * t * (1.0 - t)).max(0.0), 0.35);
            r * if t > 0.9 { (0.22f64).max(end * 0.7) } else { (0.12f64).max(end) }
        });
        let fan = 0.16 * (k as f64 - 0.5 * (count - 1) as f64);
        m.add(Stuff::Food, body.smooth().turned_y(fan).at([0.0, r * 0.8, 2.2 * r * k as f64]));
    }
    m.made()
}

fn lemon(d: &mut Stream) -> Made {
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

fn loaf(d: &mut Stream) -> Made {
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
                    let wild =
                        0.003 * super::super::noise::fractal(seed, [30.0 * l * x, 2.0 * c, 2.0 * s], [0; 3], 3) * k;
                    let y = 0.25 * h + (up * maths::pow(s.abs(), 0.8) * if s > 0.0 { 1.0 } else { -1.0 }) * k - slash
                        + wild * s.max(0.0);
                    [l * x, y, -(w * k) * c * (1.0 + 0.02 * s)]
                })
                .collect()
        })
        .collect();
    one(Stuff::Food, skin(&rings, [true, false], [false; 2]).smooth())
}

fn cheese(d: &mut Stream) -> Made {
    let (r, h, part) = (d.range(0.08, 0.14), d.range(0.04, 0.08), d.range(0.5, 1.2));
    let outline: Vec<_> = [[0.0, 0.0]].into_iter().chain(arc([0.0, 0.0], r, -0.5 * part, 0.5 * part, 12)).collect();
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
    let _ = outline;
    one(Stuff::Wax, body)
}

fn egg(d: &mut Stream) -> Made {
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

fn cake(d: &mut Stream) -> Made {
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

fn pumpkin(d: &mut Stream) -> Made {
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

fn fruit_bowl(d: &mut Stream) -> Made {
    let mut m = Maker::default();
    let (r, h) = (0.14, 0.075);
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
