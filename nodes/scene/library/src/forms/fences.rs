//! Fences, rails, bollards.

use super::{
    super::{noise::noise, shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("fence_picket", Family::Fence, 8, picket),
    form("fence_iron", Family::Fence, 8, iron),
    form("fence_mesh", Family::Fence, 6, mesh),
    form("fence_post_rail", Family::Fence, 6, post_rail),
    form("balustrade", Family::Rail, 8, balustrade),
    form("railing_glass", Family::Rail, 6, railing_glass),
    form("railing_bars", Family::Rail, 6, railing_bars),
    form("bollard", Family::Rail, 8, bollard),
];

fn picket(d: &mut Stream) -> FormVariant {
    let (half, h, w) = (d.range(0.8, 1.3), d.range(0.8, 1.2), d.range(0.03, 0.045));
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Wood, Stuff::PaintedMetal]);
    let count = (half / (w * d.range(1.4, 1.9))) as usize;
    let style = d.below(3);
    let mut m = Maker::default();
    for k in 0..count {
        let x = half * (2.0 * (k as f64 + 0.5) / count as f64 - 1.0);
        let y = h * if style == 2 { 0.9 + 0.1 * maths::cos(TAU * x / half) } else { 1.0 };
        let outline = if style == 0 {
            [[-w, 0.05], [w, 0.05], [w, y - w], [0.0, y], [-w, y - w]].to_vec()
        } else {
            [[-w, 0.05], [w, 0.05]].into_iter().chain(arc([0.0, y - w], w, 0.0, PI, 8)).collect()
        };
        m.add(stuff, extrude(&outline, 0.018).across().at([x, 0.0, 0.0]));
    }
    for y in [0.22 * h, 0.75 * h] {
        m.add(stuff, board([0.0, y, -0.025], [half, 0.035, 0.0155]));
    }
    for s in [-1.0, 1.0] {
        m.add(stuff, board([s * (half - 0.1), 0.5 * h, -0.081], [0.04, 0.5 * h, 0.04]));
    }
    m.made()
}

fn iron(d: &mut Stream) -> FormVariant {
    let (half, h) = (d.range(0.8, 1.3), d.range(0.9, 1.7));
    let pitch = d.range(0.1, 0.14);
    let count = (2.0 * half / pitch) as usize;
    let mut m = Maker::default();
    let k = d.range(0.007, 0.011);
    let rings = d.chance(0.5);
    for i in 0..count {
        let x = half * (2.0 * (i as f64 + 0.5) / count as f64 - 1.0);
        let top = h - if i % 2 == 0 { 0.0 } else { 0.12 * h };
        m.add(Stuff::PaintedMetal, rod([x, 0.03, 0.0], [x, top - 0.1, 0.0], k, 8));
        let spear = [[0.0, 0.0], [1.6 * k, 0.0], [1.6 * k, 0.012], [k, 0.016], [2.3 * k, 0.045], [0.0, 0.11]];
        m.add(Stuff::PaintedMetal, lathe(&spear, 8).at([x, top - 0.11, 0.0]));
        if rings && i + 1 < count {
            let mid = x + half / count as f64;
            let ring: Vec<_> = circle(16, 0.42 * 2.0 * half / count as f64)
                .into_iter()
                .map(|[a, b]| [mid + a, 0.25 * h + 0.05 + b, 0.0])
                .collect();
            m.add(Stuff::PaintedMetal, tube_loop(&ring, 5, 0.6 * k));
        }
    }
    for y in [0.08, 0.25 * h - 0.01, 0.8 * h] {
        m.add(Stuff::PaintedMetal, board([0.0, y, 0.0], [half, 0.012, 0.016]));
    }
    for s in [-1.0, 1.0] {
        m.add(Stuff::PaintedMetal, board([s * half, 0.5 * h, 0.0], [0.025, 0.5 * h, 0.025]));
        m.add(Stuff::PaintedMetal, ball(0.038, 12).at([s * half, h + 0.03, 0.0]));
    }
    m.made()
}

fn mesh(d: &mut Stream) -> FormVariant {
    let (half, h, pitch) = (d.range(0.7, 1.1), d.range(0.9, 1.4), d.range(0.06, 0.1));
    let mut m = Maker::default();
    for s in [-1.0, 1.0] {
        m.add(Stuff::Metal, rod([s * half, 0.0, 0.0], [s * half, h + 0.05, 0.0], 0.022, 12));
    }
    let mut wires = Vec::new();
    // Each wire zigzags upwards and hooks into its neighbours.
    let columns = (2.0 * half / pitch) as usize;
    let rows = (h / pitch) as usize;
    let (w, q) = (2.0 * half / columns as f64, h / rows as f64);
    for i in 0..columns {
        let path: Vec<_> = (0..=rows)
            .map(|j| {
                let side = if j % 2 == 0 { 0.0 } else { 1.04 };
                [
                    -half + w * (i as f64 + side).min(columns as f64),
                    0.03 + q * j as f64,
                    if j % 2 == 0 { 0.002 } else { -0.002 },
                ]
            })
            .collect();
        wires.push(tube(&path, 4, |_| 0.0018).smooth());
    }
    m.add(Stuff::Metal, Body::all(wires));
    for y in [0.035, h + 0.03] {
        m.add(Stuff::Metal, rod([-half, y, 0.0], [half, y, 0.0], 0.01, 8));
    }
    m.made()
}

fn post_rail(d: &mut Stream) -> FormVariant {
    let (half, h) = (d.range(1.0, 1.5), d.range(0.9, 1.2));
    let mut m = Maker::default();
    let seed = d.bits();
    let rough = |b: Body| {
        b.bent(|p| {
            let n = |k: u64| noise(seed ^ k, p.map(|v| 6.0 * v), [0; 3]);
            [p[0] + 0.004 * n(1), p[1] + 0.004 * n(2), p[2] + 0.004 * n(3)]
        })
    };
    for s in [-1.0, 0.0, 1.0] {
        m.add(
            Stuff::Wood,
            rough(tube(&line([s * half, 0.0, 0.0], [s * half, h + d.range(0.0, 0.08), 0.0], 10), 12, |t| {
                0.06 - 0.008 * t
            })),
        );
    }
    let rails = 2 + d.below(2);
    for k in 0..rails {
        let y = h * (0.3 + 0.62 * k as f64 / (rails - 1) as f64);
        for s in [-1.0, 0.0] {
            let (a, b) = (d.range(-0.03, 0.03), d.range(-0.03, 0.03));
            m.add(
                Stuff::Wood,
                rough(tube(
                    &line([s * half - 0.08, y + a, 0.07], [(s + 1.0) * half + 0.08, y + b, 0.07], 12),
                    10,
                    |_| 0.035,
                )),
            );
        }
    }
    m.made()
}

fn baluster(d: &mut Stream, h: f64) -> Vec<[f64; 2]> {
    let (w, at) = (d.range(0.045, 0.065), d.range(0.25, 0.45));
    let curve = flat_spline(
        &[
            [0.6 * w, 0.08 * h],
            [0.75 * w, 0.13 * h],
            [w, at * h],
            [0.4 * w, 0.75 * h],
            [0.65 * w, 0.85 * h],
            [0.5 * w, 0.92 * h],
        ],
        3,
    );
    [[0.0, 0.0], [w, 0.0], [w, 0.07 * h]]
        .into_iter()
        .chain(curve)
        .chain([[0.9 * w, 0.93 * h], [0.9 * w, h], [0.0, h]])
        .collect()
}

fn balustrade(d: &mut Stream) -> FormVariant {
    let (half, h) = (d.range(0.7, 1.2), d.range(0.8, 1.0));
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Stone, Stuff::Wood, Stuff::Plaster]);
    let mut m = Maker::default();
    m.add(stuff, board([0.0, 0.05, 0.0], [half, 0.05, 0.1]));
    m.add(stuff, board([0.0, h - 0.04, 0.0], [half, 0.04, 0.11]));
    m.top([0.0, h, 0.0], [half - 0.02, 0.1], f64::INFINITY);
    let profile = baluster(d, h - 0.18);
    let count = (half / d.range(0.08, 0.12)) as usize;
    for k in 0..count {
        let x = (half - 0.12) * (2.0 * (k as f64 + 0.5) / count as f64 - 1.0);
        m.add(stuff, lathe(&profile, 14).at([x, 0.1, 0.0]));
    }
    for s in [-1.0, 1.0] {
        m.add(stuff, board([s * (half + 0.11), 0.5 * h + 0.03, 0.0], [0.11, 0.5 * h + 0.03, 0.13]));
    }
    m.made()
}

fn railing_glass(d: &mut Stream) -> FormVariant {
    let (panes, wide, h) = (1 + d.below(3), d.range(0.5, 0.9), d.range(0.9, 1.1));
    let half = 0.5 * wide * panes as f64;
    let mut m = Maker::default();
    for k in 0..=panes {
        let x = wide * k as f64 - half;
        m.add(Stuff::Metal, rod([x, 0.0, 0.0], [x, h, 0.0], 0.02, 14));
        m.add(
            Stuff::Metal,
            lathe(&[[0.0, 0.0], [0.05, 0.0], [0.05, 0.008], [0.022, 0.014], [0.0, 0.014]], 20).at([x, 0.0, 0.0]),
        );
        if k < panes {
            let a = x + 0.05;
            m.add(Stuff::Pane, sheet(1, 1, |s, t| [a + (wide - 0.1) * s, 0.08 + (h - 0.16) * t, 0.0]));
            for (e, y) in [(a - 0.015, 0.2), (a + wide - 0.085, 0.2), (a - 0.015, h - 0.2), (a + wide - 0.085, h - 0.2)]
            {
                m.add(Stuff::Metal, board([e, y, 0.0], [0.025, 0.02, 0.01]));
            }
        }
    }
    m.add(
        *d.pick(&[Stuff::Metal, Stuff::Wood]),
        rod([-half - 0.05, h + 0.015, 0.0], [half + 0.05, h + 0.015, 0.0], 0.022, 14),
    );
    m.made()
}

fn railing_bars(d: &mut Stream) -> FormVariant {
    let (half, h, bars) = (d.range(0.7, 1.3), d.range(0.85, 1.1), 3 + d.below(4));
    let stuff = *d.pick(&[Stuff::Metal, Stuff::PaintedMetal]);
    let mut m = Maker::default();
    let posts = 2 + d.below(2);
    for k in 0..posts {
        let x = (half - 0.05) * (2.0 * k as f64 / (posts - 1) as f64 - 1.0);
        m.add(stuff, board([x, 0.5 * h, 0.0], [0.008, 0.5 * h, 0.025]));
        m.add(stuff, board([x, 0.004, 0.0], [0.05, 0.0038, 0.05]));
    }
    for k in 0..bars {
        let y = h * (0.15 + 0.7 * k as f64 / bars as f64);
        m.add(Stuff::Metal, rod([-half, y, 0.0], [half, y, 0.0], 0.006, 8));
    }
    m.add(stuff, rod([-half, h + 0.015, 0.0], [half, h + 0.015, 0.0], 0.021, 16));
    m.made()
}

fn bollard(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.05, 0.13), d.range(0.6, 1.0));
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Stone, Stuff::Concrete, Stuff::Metal]);
    let profile = [
        [0.0, 0.0],
        [1.3 * r, 0.0],
        [1.3 * r, 0.05],
        [r, 0.08],
        [0.9 * r, 0.75 * h],
        [1.05 * r, 0.77 * h],
        [1.05 * r, 0.81 * h],
        [0.85 * r, 0.82 * h],
        [0.85 * r, 0.9 * h],
        [0.6 * r, 0.97 * h],
        [0.0, h],
    ];
    m.add(stuff, lathe(&profile, 28));
    if d.chance(0.5) {
        m.add(
            Stuff::Plastic,
            lathe_loop(&[[0.88 * r, 0.6 * h], [0.94 * r, 0.6 * h], [0.93 * r, 0.68 * h], [0.88 * r, 0.68 * h]], 28),
        );
    }
    m.made()
}
