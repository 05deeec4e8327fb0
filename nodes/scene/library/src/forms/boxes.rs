//! Boxes, crates, baskets, barrels, suitcases.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("crate_slats", Family::Box, 8, crate_slats),
    form("carton", Family::Box, 8, carton),
    form("basket", Family::Box, 8, basket),
    form("barrel", Family::Box, 6, barrel),
    form("suitcase", Family::Box, 6, suitcase),
    form("gift_box", Family::Box, 6, gift),
];

fn crate_slats(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.18, 0.32), d.range(0.1, 0.2), d.range(0.13, 0.24)];
    let (slats, t) = (2 + d.below(3), 0.005);
    let mut m = Maker::default();
    let h = 2.0 * half[1] / slats as f64;
    for k in 0..slats {
        let y = h * (k as f64 + 0.5);
        for s in [-1.0, 1.0] {
            m.add(Stuff::Wood, board([0.0, y, s * (half[2] - t)], [half[0], 0.42 * h, t]));
            m.add(Stuff::Wood, board([s * (half[0] - t - 0.02), y, 0.0], [t, 0.42 * h, half[2] - 2.0 * t]));
        }
    }
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        m.add(
            Stuff::Wood,
            board([sx * (half[0] - 0.045), half[1], sz * (half[2] - 2.0 * t - 0.012)], [0.012, half[1] - 0.002, 0.012]),
        );
    }
    let floor = 4 + d.below(3);
    for k in 0..floor {
        let z = (half[2] - 2.0 * t) * (2.0 * (k as f64 + 0.5) / floor as f64 - 1.0);
        m.add(Stuff::Wood, board([0.0, 0.006, z], [half[0] - 0.03, 0.004, 0.85 * (half[2] - 2.0 * t) / floor as f64]));
    }
    m.made()
}

fn carton(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.12, 0.32), d.range(0.08, 0.25), d.range(0.1, 0.25)];
    let mut m = Maker::default();
    if d.chance(0.5) {
        m.add(Stuff::Paper, panel([0.0, half[1], 0.0], half));
        m.add(Stuff::Plastic, panel([0.0, 2.0 * half[1], 0.0], [half[0] + 0.0004, 0.0004, 0.025]));
        m.add(Stuff::Print, panel([0.4 * half[0], half[1], half[2]], [0.3 * half[0], 0.4 * half[1], 0.0005]));
        m.top([0.0, 2.0 * half[1] + 0.0004, 0.0], [half[0] - 0.01, half[2] - 0.01], f64::INFINITY);
        return m.made();
    }
    let t = 0.002;
    m.add(Stuff::Paper, panel([0.0, t, 0.0], [half[0], t, half[2]]));
    for s in [-1.0, 1.0] {
        m.add(Stuff::Paper, panel([s * (half[0] - t), half[1] + t, 0.0], [t, half[1] - t, half[2]]));
        m.add(Stuff::Paper, panel([0.0, half[1] + t, s * (half[2] - t)], [half[0] - 2.0 * t, half[1] - t, t]));
        // Flaps that stand open.
        let (a, b) = (d.range(0.3, 2.0), d.range(0.3, 2.0));
        let l = half[2].min(half[0]);
        let flap = panel([0.0, 0.5 * l, 0.0], [t, 0.5 * l, half[2]]).turned_z(-s * a).at([
            s * (half[0] - t),
            2.0 * half[1],
            0.0,
        ]);
        m.add(Stuff::Paper, flap);
        let flap = panel([0.0, 0.5 * half[2], 0.0], [half[0] - 2.0 * t, 0.5 * half[2], t]).turned_x(s * b).at([
            0.0,
            2.0 * half[1],
            s * (half[2] - t),
        ]);
        m.add(Stuff::Paper, flap);
    }
    m.made()
}

/// Woven from stakes and weavers.
fn basket(d: &mut Stream) -> FormVariant {
    let (r, h, flare) = (d.range(0.12, 0.22), d.range(0.12, 0.3), d.range(0.9, 1.35));
    let oval = d.range(0.7, 1.0);
    let stakes = 22 + 2 * d.below(4);
    let mut m = Maker::default();
    let at = |t: f64| r * (1.0 + (flare - 1.0) * t);
    let mut weave = Vec::new();
    let rows = (h / 0.016) as usize;
    for j in 0..rows {
        let t = (j as f64 + 0.5) / rows as f64;
        let phase = if j % 2 == 0 { 0.0 } else { PI };
        let n = stakes * 4;
        let path: Vec<_> = (0..n)
            .map(|i| {
                let a = TAU * i as f64 / n as f64;
                let k = at(t) + 0.005 * maths::cos(0.5 * stakes as f64 * a + phase);
                [k * maths::sin(a), 0.008 + h * t, k * maths::cos(a) * oval]
            })
            .collect();
        weave.push(tube_loop(&path, 4, 0.0075).smooth());
    }
    m.add(Stuff::Wood, Body::all(weave));
    let mut uprights = Vec::new();
    for k in 0..stakes {
        let a = TAU * k as f64 / stakes as f64;
        let p = |t: f64| [at(t) * maths::sin(a), 0.004 + h * t, at(t) * maths::cos(a) * oval];
        uprights.push(rod(p(0.0), p(1.03), 0.004, 4).smooth());
    }
    m.add(Stuff::Wood, Body::all(uprights));
    let disc: Vec<_> = circle(40, at(0.0)).into_iter().map(|[c, s]| [s, c * oval]).collect();
    m.add(Stuff::Wood, extrude(&disc, 0.008).turned_x(-0.5 * PI).at([0.0, 0.004, 0.0]));
    let rim: Vec<_> = ring_path(at(1.0), 0.01 + h, 44).into_iter().map(|p| [p[0], p[1], p[2] * oval]).collect();
    m.add(Stuff::Wood, tube_loop(&rim, 7, 0.01));
    if d.chance(0.6) {
        let path: Vec<_> = (0..=18)
            .map(|k| PI * f64::from(k) / 18.0)
            .map(|a| [at(1.0) * maths::cos(a), h + 0.95 * at(1.0) * maths::sin(a), 0.0])
            .collect();
        m.add(Stuff::Wood, tube(&path, 7, |_| 0.008));
    }
    m.made()
}

fn barrel(d: &mut Stream) -> FormVariant {
    let (r, h, belly) = (d.range(0.2, 0.3), d.range(0.6, 0.9), d.range(1.1, 1.25));
    let mut m = Maker::default();
    let staves = 18 + d.below(8);
    let at = |t: f64| r * (1.0 + (belly - 1.0) * maths::sin(PI * t));
    for k in 0..staves {
        let (a, b) = (TAU * k as f64 / staves as f64 + 0.006, TAU * (k + 1) as f64 / staves as f64 - 0.006);
        let rings: Vec<Vec<_>> = (0..=8)
            .map(|j| {
                let t = f64::from(j) / 8.0;
                let p = |a: f64, k: f64| [(at(t) - k) * maths::sin(a), h * t, (at(t) - k) * maths::cos(a)];
                vec![p(a, 0.0), p(0.5 * (a + b), -0.002), p(b, 0.0), p(b, 0.018), p(a, 0.018)]
            })
            .collect();
        m.add(Stuff::Wood, skin(&rings, [true, false], [true, true]).across());
    }
    for t in [0.06, 0.27, 0.73, 0.94] {
        let (y, w) = (h * t, 0.016);
        let (lo, hi) = (at(t - w / h) + 0.0035, at(t + w / h) + 0.0035);
        m.add(Stuff::Metal, lathe_loop(&[[lo - 0.006, y - w], [lo, y - w], [hi, y + w], [hi - 0.006, y + w]], 48));
    }
    for (y, flip) in [(0.035, true), (h - 0.035, false)] {
        let disc = extrude(&circle(40, at(y / h) - 0.012), 0.015).turned_x(-0.5 * PI).at([0.0, y, 0.0]);
        m.add(Stuff::Wood, disc);
        if !flip {
            m.top([0.0, y + 0.0075, 0.0], [0.6 * r, 0.6 * r], f64::INFINITY);
        }
    }
    m.made()
}

fn suitcase(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.22, 0.36), d.range(0.16, 0.26), d.range(0.07, 0.12)];
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Leather, Stuff::Leather, Stuff::Plastic, Stuff::Metal]);
    let y = half[1];
    for s in [-1.0, 1.0] {
        m.add(stuff, soft_block([0.0, y, s * (0.5 * half[2] + 0.001)], [half[0], half[1], 0.5 * half[2]], 0.02, 3));
    }
    for (sx, sy) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        m.add(
            Stuff::Metal,
            soft_block([sx * (half[0] - 0.02), y + sy * (half[1] - 0.02), half[2]], [0.02, 0.02, 0.003], 0.002, 1),
        );
    }
    let path = fillet(
        &[
            [-0.06, 2.0 * y - 0.002, 0.0],
            [-0.055, 2.0 * y + 0.035, 0.0],
            [0.055, 2.0 * y + 0.035, 0.0],
            [0.06, 2.0 * y - 0.002, 0.0],
        ],
        0.02,
        4,
    );
    m.add(Stuff::Leather, tube(&path, 8, |_| 0.009));
    for s in [-1.0, 1.0] {
        m.add(Stuff::Metal, board([s * 0.6 * half[0], 2.0 * y - 0.003, 0.0], [0.02, 0.006, 0.02]));
        m.add(Stuff::Leather, board([s * 0.6 * half[0], y, half[2] + 0.001], [0.014, half[1] - 0.012, 0.002]));
    }
    m.made()
}

fn gift(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.06, 0.18), d.range(0.04, 0.14), d.range(0.06, 0.16)];
    let mut m = Maker::default();
    let y = 2.0 * half[1];
    m.add(Stuff::Print, panel([0.0, half[1], 0.0], half));
    let lid = 0.25 * half[1];
    m.another(Stuff::Print, panel([0.0, y - lid + 0.002, 0.0], [half[0] + 0.003, lid, half[2] + 0.003]));
    let (w, t) = (0.014, 0.0035);
    m.add(Stuff::Fabric, panel([0.0, half[1] + 0.0015, 0.0], [w, half[1] + 0.0015, half[2] + t]));
    m.add(Stuff::Fabric, panel([0.0, half[1] + 0.0013, 0.0], [half[0] + t, half[1] + 0.0013, w]));
    let loops = 2 + d.below(3);
    for k in 0..2 * loops {
        let a = PI * k as f64 / loops as f64 + 0.3;
        let size = 0.045;
        let path: Vec<_> = (0..=12)
            .map(|j| {
                let b = PI * f64::from(j) / 12.0 * 2.0;
                let x = 0.5 * size * (1.0 - maths::cos(b));
                [
                    x * maths::sin(a),
                    y + 0.003 + 0.4 * size * maths::sin(b).abs() * if j <= 6 { 1.3 } else { 0.5 } + 0.002,
                    x * maths::cos(a),
                ]
            })
            .collect();
        m.add(
            Stuff::Fabric,
            sweep(
                &path,
                &[[0.0006, -0.009], [0.0006, 0.009], [-0.0006, 0.009], [-0.0006, -0.009]],
                [0.0, 1.0, 0.0],
                |_| 1.0,
            ),
        );
    }
    m.made()
}
