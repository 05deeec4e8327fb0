//! Ornaments.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::{Maker, one},
};
use tauflow_data::geom::Vec3;
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("candlestick", Family::Ornament, 8, candlestick),
    form("trophy", Family::Ornament, 6, trophy),
    form("seashell", Family::Ornament, 6, shell),
    form("hourglass", Family::Ornament, 6, hourglass),
    form("globe_earth", Family::Ornament, 6, earth),
];

fn candlestick(d: &mut Stream) -> FormVariant {
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

fn trophy(d: &mut Stream) -> FormVariant {
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
fn shell(d: &mut Stream) -> FormVariant {
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
    one(*d.pick(&[Stuff::Ceramic, Stuff::Stone, Stuff::Wax]), body.turned_x(tilt))
}

fn hourglass(d: &mut Stream) -> FormVariant {
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

fn earth(d: &mut Stream) -> FormVariant {
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
