//! Benches and street lamps.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("bench_park", Family::Bench, 8, park),
    form("bench_stone", Family::Bench, 6, bench_stone),
    form("street_lamp_arm", Family::StreetLamp, 6, lamp_arm),
    form("street_lamp_globe", Family::StreetLamp, 6, lamp_globe),
    form("street_lamp_lantern", Family::StreetLamp, 6, lamp_lantern),
];

fn park(d: &mut Stream) -> FormVariant {
    let (half, seat, h) = (d.range(0.6, 0.95), d.range(0.42, 0.46), d.range(0.78, 0.9));
    let mut m = Maker::default();
    let slats = 4 + d.below(3);
    for k in 0..slats {
        let z = -0.18 + 0.4 * (k as f64 + 0.5) / slats as f64;
        m.add(Stuff::Wood, board([0.0, seat - 0.014, z], [half, 0.014, 0.42 * 0.4 / slats as f64]));
    }
    m.top([0.0, seat, 0.02], [half - 0.05, 0.15], 0.4);
    let back = 2 + d.below(3);
    for k in 0..back {
        let t = (k as f64 + 0.6) / back as f64;
        let y = seat + 0.06 + (h - seat - 0.06) * t;
        let tilt = -0.25;
        m.add(
            Stuff::Wood,
            board([0.0, 0.0, 0.0], [half, 0.42 * (h - seat) / back as f64 * 0.8, 0.012]).turned_x(tilt).at([
                0.0,
                y - 0.02,
                -0.2 - 0.25 * (y - seat),
            ]),
        );
    }
    for s in [-1.0, 1.0] {
        let x = s * (half - 0.14);
        let leg = [[x, 0.0, 0.24], [x, seat - 0.05, 0.2], [x, seat - 0.04, -0.18], [x, h, -0.232 - 0.25 * (h - seat)]];
        m.add(
            Stuff::PaintedMetal,
            sweep(&fillet(&leg, 0.06, 4), &rounded_rect([0.012, 0.022], 0.004, 1), [0.0, 0.0, 1.0], |_| 1.0),
        );
        m.add(
            Stuff::PaintedMetal,
            sweep(
                &fillet(&[[x, 0.0, -0.3], [x, 0.25, -0.18], [x, seat - 0.04, -0.12]], 0.08, 4),
                &rounded_rect([0.012, 0.02], 0.004, 1),
                [0.0, 0.0, 1.0],
                |_| 1.0,
            ),
        );
        let arm = [[x, seat - 0.05, 0.19], [x, seat + 0.2, 0.2], [x, seat + 0.2, -0.2 - 0.25 * 0.2]];
        m.add(Stuff::PaintedMetal, tube(&fillet(&arm, 0.06, 4), 8, |_| 0.013));
    }
    m.made()
}

fn bench_stone(d: &mut Stream) -> FormVariant {
    let (half, h, deep, t) = (d.range(0.6, 1.0), d.range(0.4, 0.47), d.range(0.18, 0.24), d.range(0.05, 0.09));
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Concrete, Stuff::Wood]);
    let mut m = Maker::default();
    m.add(stuff, soft_block([0.0, h - 0.5 * t, 0.0], [half, 0.5 * t, deep], 0.012, 2));
    m.top([0.0, h, 0.0], [half - 0.03, deep - 0.03], f64::INFINITY);
    let leg = if stuff == Stuff::Wood { Stuff::Concrete } else { stuff };
    for s in [-1.0, 1.0] {
        let x = s * half * 0.62;
        let k = deep * 0.8;
        let y = h - t;
        let outline = closed_spline(
            &[
                [-k, 0.0],
                [k, 0.0],
                [0.65 * k, 0.3 * y],
                [0.6 * k, 0.6 * y],
                [k, y],
                [-k, y],
                [-0.6 * k, 0.6 * y],
                [-0.65 * k, 0.3 * y],
            ],
            1,
        );
        m.add(leg, extrude(&outline, 0.1).turned_y(0.5 * PI).at([x, 0.0, 0.0]));
    }
    m.made()
}

fn mast(m: &mut Maker, h: f64, r: f64) {
    let profile = [
        [0.0, 0.0],
        [2.2 * r, 0.0],
        [2.2 * r, 0.06],
        [1.7 * r, 0.12],
        [1.6 * r, 0.5],
        [1.1 * r, 0.58],
        [r, 0.65],
        [0.65 * r, h],
        [0.0, h],
    ];
    m.add(Stuff::PaintedMetal, lathe(&profile, 20));
}

fn lamp_arm(d: &mut Stream) -> FormVariant {
    let (h, reach, r) = (d.range(3.5, 5.5), d.range(0.7, 1.4), d.range(0.045, 0.065));
    let mut m = Maker::default();
    mast(&mut m, h, r);
    let rise = d.range(0.0, 0.5);
    let path = spline(
        &[
            [0.0, h - 0.02, 0.0],
            [0.1 * reach, h + 0.7 * rise + 0.1, 0.0],
            [0.6 * reach, h + rise + 0.15, 0.0],
            [reach, h + rise + 0.12, 0.0],
        ],
        6,
    );
    m.add(Stuff::PaintedMetal, tube(&path, 10, |t| 0.65 * r * (1.0 - 0.3 * t)));
    let y = h + rise + 0.12;
    let head = slab(8, 6, 0.06, |s, t| {
        let (x, z) = (2.0 * s - 1.0, 2.0 * t - 1.0);
        [reach + 0.12 + 0.28 * x, y + 0.03 + 0.035 * (1.0 - x * x), -0.12 * z * (1.0 - 0.3 * x * x)]
    });
    m.add(Stuff::PaintedMetal, head);
    m.add(Stuff::Glow, soft_block([reach + 0.14, y - 0.035, 0.0], [0.18, 0.012, 0.07], 0.008, 2));
    m.made()
}

fn lamp_globe(d: &mut Stream) -> FormVariant {
    let (h, r) = (d.range(2.4, 3.6), d.range(0.035, 0.05));
    let globes = *d.pick(&[1usize, 2, 3]);
    let size = d.range(0.14, 0.22);
    let mut m = Maker::default();
    mast(&mut m, h, r);
    let bulb = |m: &mut Maker, x: f64, y: f64, z: f64| {
        m.add(
            Stuff::PaintedMetal,
            lathe(&[[0.0, -0.02], [0.03, -0.02], [0.5 * size, 0.03], [0.45 * size, 0.05], [0.0, 0.05]], 20)
                .at([x, y, z]),
        );
        m.add(Stuff::Glow, ball(size, 24).at([x, y + 0.03 + 0.9 * size, z]));
    };
    if globes == 1 {
        bulb(&mut m, 0.0, h, 0.0);
    } else {
        for k in 0..globes {
            let a = TAU * k as f64 / globes as f64;
            let (s, c) = (maths::sin(a), maths::cos(a));
            let far = 2.0 * size;
            let path = spline(
                &[
                    [0.0, h - 0.1, 0.0],
                    [0.5 * far * s, h - 0.22, 0.5 * far * c],
                    [far * s, h - 0.1, far * c],
                    [far * s, h, far * c],
                ],
                5,
            );
            m.add(Stuff::PaintedMetal, tube(&path, 8, |_| 0.016));
            bulb(&mut m, far * s, h, far * c);
        }
    }
    m.made()
}

fn lamp_lantern(d: &mut Stream) -> FormVariant {
    let (h, r, w) = (d.range(2.4, 3.4), d.range(0.04, 0.055), d.range(0.12, 0.17));
    let sides = 4 + 2 * d.below(2);
    let mut m = Maker::default();
    mast(&mut m, h, r);
    let tall = d.range(0.35, 0.5);
    let ring = |k: f64, y: f64| {
        (0..sides)
            .map(|i| TAU * (i as f64 + 0.5) / sides as f64)
            .map(|a| [k * maths::sin(a), y, k * maths::cos(a)])
            .collect::<Vec<_>>()
    };
    m.add(
        Stuff::PaintedMetal,
        skin(
            &[ring(0.3 * w, h - 0.03), ring(0.75 * w, h + 0.03), ring(0.75 * w, h + 0.05)],
            [true, false],
            [true, true],
        )
        .flat(),
    );
    let (low, high) = (ring(0.72 * w, h + 0.05), ring(1.15 * w, h + tall));
    for i in 0..sides {
        m.add(Stuff::PaintedMetal, rod(low[i], high[i], 0.01, 6));
        let j = (i + 1) % sides;
        m.add(
            Stuff::Pane,
            sheet(1, 1, |s, t| {
                let p = |k: usize| if k == 0 { (low[i], low[j]) } else { (high[i], high[j]) };
                let at = |(a, b): ([f64; 3], [f64; 3])| [0, 1, 2].map(|q| a[q] + (b[q] - a[q]) * s);
                let (a, b) = (at(p(0)), at(p(1)));
                [0, 1, 2].map(|q| a[q] + (b[q] - a[q]) * t)
            }),
        );
    }
    m.add(Stuff::Glow, ball(0.06, 16).scaled([1.0, 1.6, 1.0]).at([0.0, h + 0.45 * tall + 0.03, 0.0]));
    m.add(Stuff::PaintedMetal, rod([0.0, h + 0.04, 0.0], [0.0, h + 0.45 * tall - 0.05, 0.0], 0.02, 10));
    m.add(
        Stuff::PaintedMetal,
        skin(
            &[
                ring(1.25 * w, h + tall),
                ring(1.25 * w, h + tall + 0.02),
                ring(0.4 * w, h + tall + 0.13),
                ring(0.4 * w, h + tall + 0.17),
                ring(0.12 * w, h + tall + 0.24),
            ],
            [true, false],
            [true, true],
        )
        .flat(),
    );
    m.made()
}
