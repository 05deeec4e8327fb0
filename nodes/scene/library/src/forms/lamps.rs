//! Lamps that stand, candles, lanterns.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("lamp_desk", Family::Lamp, 8, desk),
    form("lamp_floor", Family::Lamp, 8, floor),
    form("lamp_table", Family::Lamp, 10, table),
    form("lamp_arc", Family::Lamp, 6, arc_lamp),
    form("lamp_globe", Family::Lamp, 6, globe),
    form("lantern", Family::Lamp, 6, lantern),
    form("candle", Family::Lamp, 8, candle),
];

/// A thin shade between two circles, open above and below, with an inside of its own.
fn shade(low: f64, high: f64, r_low: f64, r_high: f64, curve: f64, thick: f64) -> Body {
    let n = 8;
    let at = |t: f64| r_low + (r_high - r_low) * t + curve * maths::sin(PI * t);
    let outer = (0..=n).map(|k| f64::from(k) / f64::from(n)).map(|t| [at(t), low + (high - low) * t]);
    let inner = (0..=n).rev().map(|k| f64::from(k) / f64::from(n)).map(|t| [at(t) - thick, low + (high - low) * t]);
    lathe_loop(&outer.chain(inner).collect::<Vec<_>>(), 36)
}

fn desk(d: &mut Stream) -> FormVariant {
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Metal]);
    let mut m = Maker::default();
    let r = d.range(0.08, 0.1);
    m.add(stuff, lathe(&[[0.0, 0.0], [r, 0.0], [r, 0.012], [r - 0.008, 0.02], [0.015, 0.025], [0.0, 0.025]], 32));
    let (a, b) = (d.range(0.3, 0.38), d.range(0.28, 0.36));
    let (lean, reach) = (d.range(0.1, 0.5), d.range(0.2, 0.7));
    let elbow = [0.0, 0.025 + a * maths::cos(lean), -a * maths::sin(lean)];
    let head = [0.0, elbow[1] + b * maths::sin(reach), elbow[2] + b * maths::cos(reach)];
    for (from, to) in [([0.0, 0.02, 0.0], elbow), (elbow, head)] {
        for s in [-0.012, 0.012] {
            m.add(stuff, rod([s, from[1], from[2]], [s, to[1], to[2]], 0.005, 6));
        }
    }
    for p in [elbow, head, [0.0, 0.03, 0.0]] {
        m.add(Stuff::Metal, rod([-0.02, p[1], p[2]], [0.02, p[1], p[2]], 0.011, 10));
    }
    let k = d.range(0.06, 0.08);
    let hood = [
        [0.018, 0.0],
        [0.03, -0.02],
        [0.6 * k, -0.05],
        [0.9 * k, -0.09],
        [k, -0.12],
        [k - 0.002, -0.12],
        [0.9 * k - 0.002, -0.09],
        [0.6 * k - 0.002, -0.05],
        [0.028, -0.022],
        [0.016, -0.002],
    ];
    let mut profile = hood.to_vec();
    profile.reverse();
    let tilt = d.range(-0.6, 0.1);
    let place = |body: Body| body.turned_x(tilt).at([0.0, head[1] - 0.01, head[2] + 0.02]);
    m.add(stuff, place(lathe_loop(&profile, 28)));
    m.add(stuff, place(rod([0.0, -0.02, 0.0], [0.0, 0.03, 0.0], 0.018, 12)));
    m.add(Stuff::Glow, place(ball(0.028, 14).scaled([1.0, 1.3, 1.0]).at([0.0, -0.07, 0.0])));
    m.made()
}

fn floor(d: &mut Stream) -> FormVariant {
    let (height, r) = (d.range(1.4, 1.7), d.range(0.16, 0.24));
    let tall = d.range(0.2, 0.32);
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Metal, Stuff::PaintedMetal, Stuff::Wood]);
    let low = height - tall;
    if d.chance(0.4) {
        for k in 0..3 {
            let a = TAU * f64::from(k) / 3.0;
            let (s, c) = (maths::sin(a), maths::cos(a));
            m.add(
                Stuff::Wood,
                tube(&[[0.26 * s, 0.0, 0.26 * c], [0.02 * s, low + 0.02, 0.02 * c]], 8, |t| 0.014 + 0.004 * t),
            );
        }
    } else {
        m.add(
            stuff,
            lathe(
                &[
                    [0.0, 0.0],
                    [0.14, 0.0],
                    [0.14, 0.012],
                    [0.03, 0.025],
                    [0.012, 0.04],
                    [0.01, low + 0.05],
                    [0.0, low + 0.05],
                ],
                32,
            ),
        );
    }
    let cone = d.range(0.6, 1.0);
    m.add(Stuff::Fabric, shade(low, height, r, r * cone, d.range(-0.02, 0.02), 0.002));
    for k in 0..3 {
        let a = TAU * f64::from(k) / 3.0;
        m.add(
            Stuff::Metal,
            rod(
                [0.0, low + 0.05, 0.0],
                [(r - 0.003) * maths::sin(a), low + 0.02, (r - 0.003) * maths::cos(a)],
                0.002,
                4,
            ),
        );
    }
    m.add(Stuff::Glow, ball(0.045, 16).at([0.0, low + 0.1, 0.0]));
    m.made()
}

fn table(d: &mut Stream) -> FormVariant {
    let (foot, height) = (d.range(0.18, 0.32), d.range(0.38, 0.58));
    let stuff = *d.pick(&[Stuff::Ceramic, Stuff::Wood, Stuff::Metal, Stuff::Clay]);
    let mut m = Maker::default();
    let (b, n) = (d.range(0.05, 0.1), d.range(0.015, 0.03));
    let at = d.range(0.25, 0.6);
    let curve =
        flat_spline(&[[0.06, 0.005], [0.7 * b, 0.1 * foot], [b, at * foot], [1.4 * n, 0.85 * foot], [n, foot]], 5);
    let profile: Vec<_> = [[0.0, 0.0], [0.06, 0.0]].into_iter().chain(curve).chain([[0.0, foot]]).collect();
    m.add(stuff, lathe(&profile, 28));
    m.add(Stuff::Metal, rod([0.0, foot - 0.005, 0.0], [0.0, foot + 0.05, 0.0], 0.008, 8));
    let low = foot + d.range(0.0, 0.03);
    let r = d.range(0.11, 0.18);
    let lit = d.chance(0.5);
    m.add(
        if lit { Stuff::Glow } else { Stuff::Fabric },
        shade(low, height, r, r * d.range(0.5, 0.95), d.range(-0.015, 0.015), 0.002),
    );
    if !lit {
        m.add(Stuff::Glow, ball(0.03, 14).at([0.0, low + 0.08, 0.0]));
    }
    for k in 0..3 {
        let a = TAU * f64::from(k) / 3.0;
        m.add(
            Stuff::Metal,
            rod(
                [0.0, foot + 0.045, 0.0],
                [(r - 0.002) * maths::sin(a), low + 0.006, (r - 0.002) * maths::cos(a)],
                0.0015,
                4,
            ),
        );
    }
    m.made()
}

fn arc_lamp(d: &mut Stream) -> FormVariant {
    let (height, reach) = (d.range(1.6, 2.0), d.range(0.9, 1.3));
    let mut m = Maker::default();
    m.add(
        *d.pick(&[Stuff::Stone, Stuff::Metal]),
        lathe(&[[0.0, 0.0], [0.16, 0.0], [0.16, 0.045], [0.15, 0.055], [0.0, 0.055]], 36),
    );
    let path: Vec<_> = (0..=24)
        .map(|k| {
            let t = f64::from(k) / 24.0;
            let a = 0.8 * PI * t;
            [
                reach * 0.55 * (1.0 - maths::cos(a)),
                0.05 + (height - 0.05) * maths::sin(0.5 * PI * (1.55 * t).min(1.0)) - 0.3 * (t - 0.645).max(0.0),
                0.0,
            ]
        })
        .collect();
    let end = path[24];
    m.add(Stuff::Metal, tube(&path, 10, |t| 0.012 - 0.004 * t));
    let k = d.range(0.13, 0.18);
    let dome: Vec<[f64; 2]> = arc([0.0, 0.0], k, 0.0, 0.46 * PI, 8)
        .into_iter()
        .chain(arc([0.0, 0.0], k - 0.003, 0.46 * PI, 0.0, 8))
        .collect();
    m.add(Stuff::Metal, lathe_loop(&dome, 32).at([end[0], end[1] - k, end[2]]));
    m.add(Stuff::Metal, rod([end[0], end[1] - 0.02, 0.0], [end[0], end[1] + 0.01, 0.0], 0.03, 12));
    m.add(Stuff::Glow, ball(0.045, 16).at([end[0], end[1] - 0.7 * k, 0.0]));
    m.made()
}

fn globe(d: &mut Stream) -> FormVariant {
    let r = d.range(0.07, 0.14);
    let mut m = Maker::default();
    let foot = d.range(0.02, 0.15);
    m.add(
        *d.pick(&[Stuff::Metal, Stuff::Wood]),
        lathe(
            &[
                [0.0, 0.0],
                [0.7 * r, 0.0],
                [0.7 * r, 0.012],
                [0.25 * r, 0.02],
                [0.25 * r, foot],
                [0.45 * r, foot + 0.01],
                [0.45 * r, foot + 0.03],
                [0.0, foot + 0.03],
            ],
            28,
        ),
    );
    m.add(Stuff::Glow, ball(r, 28).at([0.0, foot + 0.02 + 0.9 * r, 0.0]));
    m.made()
}

fn lantern(d: &mut Stream) -> FormVariant {
    let (w, h) = (d.range(0.06, 0.1), d.range(0.16, 0.28));
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Metal, Stuff::Wood]);
    let mut m = Maker::default();
    m.add(stuff, board([0.0, 0.012, 0.0], [w + 0.012, 0.012, w + 0.012]));
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        m.add(stuff, board([sx * w, 0.024 + 0.5 * h, sz * w], [0.006, 0.5 * h, 0.006]));
    }
    for (x, z) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)] {
        let side = [z, 0.0, -x];
        let pane = sheet(1, 1, |s, t| {
            [
                x * w + side[0] * (2.0 * s - 1.0) * (w - 0.006),
                0.024 + h * t,
                z * w + side[2] * (2.0 * s - 1.0) * (w - 0.006),
            ]
        });
        m.add(Stuff::Pane, pane);
    }
    let roof = 0.024 + h;
    let ring = |k: f64, y: f64| [[k, y, k], [k, y, -k], [-k, y, -k], [-k, y, k]].to_vec();
    let rings = [
        ring(w + 0.012, roof),
        ring(w + 0.012, roof + 0.01),
        ring(0.3 * w, roof + 0.5 * w),
        ring(0.3 * w, roof + 0.75 * w),
    ];
    m.add(stuff, skin(&rings, [true, false], [true, true]));
    let y = roof + 0.75 * w;
    let loop_: Vec<_> = circle(20, 0.5 * w).into_iter().map(|[x, v]| [x, y + 0.45 * w + v, 0.0]).collect();
    m.add(stuff, tube_loop(&loop_, 6, 0.003));
    m.add(Stuff::Wax, rod([0.0, 0.024, 0.0], [0.0, 0.024 + 0.4 * h, 0.0], 0.45 * w, 20));
    m.add(Stuff::Glow, flame(0.024 + 0.4 * h));
    m.made()
}

pub(super) fn flame(y: f64) -> Body {
    lathe(&[[0.0, 0.0], [0.004, 0.003], [0.006, 0.01], [0.0045, 0.02], [0.002, 0.03], [0.0, 0.036]], 10).smooth().at([
        0.0,
        y + 0.004,
        0.0,
    ])
}

fn candle(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let r = d.range(0.011, 0.035);
    let h = if r < 0.018 { d.range(0.15, 0.28) } else { d.range(0.06, 0.18) };
    let mut y = 0.0;
    if r < 0.018 {
        let k = d.range(0.035, 0.065);
        let dish =
            [[0.0, 0.0], [k, 0.0], [k + 0.002, 0.012], [0.9 * k, 0.006], [0.02, 0.008], [0.018, 0.03], [0.0, 0.03]];
        m.add(Stuff::Metal, lathe(&dish, 24));
        y = 0.028;
    }
    let profile = [[0.0, 0.0], [r, 0.0], [r, h - 0.006], [r - 0.003, h], [0.7 * r, h - 0.003], [0.0, h - 0.006]];
    m.add(Stuff::Wax, lathe(&profile, 24).at([0.0, y, 0.0]));
    m.add(Stuff::Rubber, rod([0.0, y + h - 0.007, 0.0], [0.0, y + h + 0.004, 0.0], 0.001, 5));
    m.add(Stuff::Glow, flame(y + h));
    m.made()
}
