//! Out of doors: fences, rails, columns, stairs, benches, street lamps.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, Made, form,
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
    form("column_fluted", Family::Column, 8, fluted),
    form("column_plain", Family::Column, 8, plain),
    form("column_twisted", Family::Column, 6, twisted),
    form("obelisk", Family::Column, 6, obelisk),
    form("arch_stone", Family::Column, 6, arch),
    form("stairs_solid", Family::Stair, 8, stairs),
    form("stairs_open", Family::Stair, 6, stairs_open),
    form("stairs_spiral", Family::Stair, 6, spiral),
    form("stepladder", Family::Stair, 6, stepladder),
    form("bench_park", Family::Bench, 8, park),
    form("bench_stone", Family::Bench, 6, bench_stone),
    form("street_lamp_arm", Family::StreetLamp, 6, lamp_arm),
    form("street_lamp_globe", Family::StreetLamp, 6, lamp_globe),
    form("street_lamp_lantern", Family::StreetLamp, 6, lamp_lantern),
];

fn picket(d: &mut Stream) -> Made {
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

fn iron(d: &mut Stream) -> Made {
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

fn mesh(d: &mut Stream) -> Made {
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

fn post_rail(d: &mut Stream) -> Made {
    let (half, h) = (d.range(1.0, 1.5), d.range(0.9, 1.2));
    let mut m = Maker::default();
    let seed = d.bits();
    let rough = |b: Body| {
        b.bent(|p| {
            let n = |k: u64| super::super::noise::noise(seed ^ k, p.map(|v| 6.0 * v), [0; 3]);
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

fn balustrade(d: &mut Stream) -> Made {
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

fn railing_glass(d: &mut Stream) -> Made {
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

fn railing_bars(d: &mut Stream) -> Made {
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

fn bollard(d: &mut Stream) -> Made {
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

fn capital(m: &mut Maker, stuff: Stuff, r: f64, y: f64) {
    m.add(
        stuff,
        lathe(
            &[
                [0.0, y],
                [r, y],
                [1.08 * r, y + 0.08 * r],
                [r, y + 0.16 * r],
                [1.35 * r, y + 0.45 * r],
                [0.0, y + 0.45 * r],
            ],
            36,
        ),
    );
    m.add(stuff, board([0.0, y + 0.6 * r, 0.0], [1.42 * r, 0.15 * r, 1.42 * r]));
    m.top([0.0, y + 0.75 * r, 0.0], [1.3 * r, 1.3 * r], f64::INFINITY);
}

fn base(m: &mut Maker, stuff: Stuff, r: f64) -> f64 {
    m.add(stuff, board([0.0, 0.15 * r, 0.0], [1.4 * r, 0.15 * r, 1.4 * r]));
    let torus = arc([1.12 * r, 0.5 * r], 0.2 * r, -0.5 * PI, 0.5 * PI, 6);
    let profile: Vec<_> =
        [[0.0, 0.3 * r]].into_iter().chain(torus).chain([[1.02 * r, 0.78 * r], [0.0, 0.78 * r]]).collect();
    m.add(stuff, lathe(&profile, 36));
    0.78 * r
}

fn fluted(d: &mut Stream) -> Made {
    let (r, h) = (d.range(0.12, 0.25), d.range(2.0, 3.2));
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Stone, Stuff::Plaster]);
    let flutes = 16 + 2 * d.below(5);
    let mut m = Maker::default();
    let y = base(&mut m, stuff, r);
    let top = h - 0.75 * r;
    let n = flutes * 6;
    let rings: Vec<Vec<_>> = (0..=10)
        .map(|j| {
            let t = f64::from(j) / 10.0;
            // A column swells a little below its middle.
            let k = r * (1.0 - 0.14 * t + 0.03 * maths::sin(PI * t));
            (0..n)
                .map(|i| {
                    let a = TAU * i as f64 / n as f64;
                    let q = k * (1.0 - 0.07 * maths::sin(0.5 * flutes as f64 * a).abs());
                    [q * maths::sin(a), y - 0.002 + (top - y + 0.004) * t, q * maths::cos(a)]
                })
                .collect()
        })
        .collect();
    m.add(stuff, skin(&rings, [true, false], [true, true]));
    capital(&mut m, stuff, 0.88 * r, top);
    m.made()
}

fn plain(d: &mut Stream) -> Made {
    let (r, h) = (d.range(0.1, 0.25), d.range(1.0, 3.2));
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Concrete, Stuff::Wood]);
    let mut m = Maker::default();
    let y = base(&mut m, stuff, r);
    let top = h - 0.7 * r;
    let sides = *d.pick(&[36usize, 36, 8, 6]);
    let body = tube(&line([0.0, y - 0.002, 0.0], [0.0, top + 0.002, 0.0], 8), sides, |t| {
        r * (1.0 - 0.12 * t + 0.02 * maths::sin(PI * t))
    });
    m.add(stuff, if sides < 10 { body.flat() } else { body });
    capital(&mut m, stuff, 0.89 * r, top);
    m.made()
}

/// A barley-sugar column.
fn twisted(d: &mut Stream) -> Made {
    let (r, h, lobes) = (d.range(0.08, 0.16), d.range(1.0, 2.4), 2 + d.below(4));
    let (turns, depth) = (d.range(0.6, 2.0), d.range(0.12, 0.24));
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Wood, Stuff::Plaster]);
    let mut m = Maker::default();
    let y = base(&mut m, stuff, r);
    let top = h - 0.8 * r;
    let n = 40;
    let rows = 48;
    let rings: Vec<Vec<_>> = (0..=rows)
        .map(|j| {
            let t = j as f64 / rows as f64;
            (0..n)
                .map(|i| {
                    let a = TAU * i as f64 / n as f64;
                    let q = r * (0.85 + depth * maths::cos(lobes as f64 * a - TAU * turns * t));
                    [q * maths::sin(a), y - 0.002 + (top - y + 0.004) * t, q * maths::cos(a)]
                })
                .collect()
        })
        .collect();
    m.add(stuff, skin(&rings, [true, false], [true, true]).smooth());
    capital(&mut m, stuff, r, top);
    m.made()
}

fn obelisk(d: &mut Stream) -> Made {
    let (w, h) = (d.range(0.12, 0.3), d.range(1.2, 3.0));
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Concrete]);
    let mut m = Maker::default();
    m.add(stuff, board([0.0, 0.12 * w, 0.0], [1.9 * w, 0.12 * w, 1.9 * w]));
    m.add(stuff, board([0.0, 0.7 * w, 0.0], [1.35 * w, 0.46 * w, 1.35 * w]));
    let ring = |k: f64, y: f64| vec![[-k, y, k], [k, y, k], [k, y, -k], [-k, y, -k]];
    let top = h - 0.8 * w;
    m.add(stuff, skin(&[ring(w, 1.16 * w), ring(0.62 * w, top), ring(0.0, h)], [true, false], [true, false]));
    m.made()
}

fn arch(d: &mut Stream) -> Made {
    let (half, spring, wide, deep) = (d.range(0.45, 0.8), d.range(0.9, 1.6), d.range(0.18, 0.3), d.range(0.12, 0.25));
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Brick, Stuff::Concrete]);
    let mut m = Maker::default();
    for s in [-1.0, 1.0] {
        let x = s * (half + 0.5 * wide);
        let blocks = 3 + d.below(3);
        let h = spring / blocks as f64;
        for k in 0..blocks {
            m.add(stuff, board([x, h * (k as f64 + 0.5), 0.0], [0.5 * wide, 0.5 * h - 0.002, deep]));
        }
    }
    let stones = 9 + 2 * d.below(3);
    let pointed = if d.chance(0.3) { 1.25 } else { 1.0 };
    for k in 0..stones {
        let (a, b) = (PI * k as f64 / stones as f64 + 0.004, PI * (k + 1) as f64 / stones as f64 - 0.004);
        let far = wide * if k == stones / 2 { 1.25 } else { 1.0 };
        let p = |a: f64, r: f64| [r * maths::cos(a), spring + 0.002 + r * maths::sin(a) * pointed];
        let mid = 0.5 * (a + b);
        let outline = [p(a, half), p(a, half + far), p(mid, half + far), p(b, half + far), p(b, half), p(mid, half)];
        m.add(stuff, extrude(&outline, 2.0 * deep + if k == stones / 2 { 0.03 } else { 0.0 }));
    }
    m.made()
}

fn stairs(d: &mut Stream) -> Made {
    let (count, rise, going, half) = (3 + d.below(8), d.range(0.15, 0.19), d.range(0.25, 0.32), d.range(0.4, 0.8));
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Concrete, Stuff::Wood, Stuff::Brick]);
    let mut m = Maker::default();
    let nose = d.range(0.0, 0.025);
    for k in 0..count {
        let (y, z) = (rise * k as f64, -going * k as f64);
        m.add(stuff, board([0.0, 0.5 * (y + rise - 0.03), z], [half, 0.5 * (y + rise - 0.03), 0.5 * going]));
        m.add(stuff, board([0.0, y + rise - 0.015, z + 0.5 * nose], [half + 0.4 * nose, 0.015, 0.5 * (going + nose)]));
        m.top([0.0, y + rise, z + 0.02], [half - 0.02, 0.5 * going - 0.04], f64::INFINITY);
    }
    m.made()
}

fn stairs_open(d: &mut Stream) -> Made {
    let (count, rise, going, half) = (6 + d.below(8), d.range(0.17, 0.2), d.range(0.22, 0.27), d.range(0.35, 0.5));
    let stuff = *d.pick(&[Stuff::Wood, Stuff::PaintedMetal]);
    let mut m = Maker::default();
    let end = [rise * count as f64, -going * count as f64];
    for s in [-1.0, 1.0] {
        m.add(
            stuff,
            beam(
                [s * (half + 0.02), 0.05, 0.3 * going],
                [s * (half + 0.02), end[0], end[1] + going * 0.55],
                [0.22, 0.04],
                [0.0, 1.0, 0.0],
            ),
        );
        // A handrail on posts.
        m.add(
            Stuff::Metal,
            rod(
                [s * (half + 0.02), 0.95, 0.3 * going],
                [s * (half + 0.02), end[0] + 0.9, end[1] + 0.55 * going],
                0.02,
                10,
            ),
        );
        for k in 0..count {
            if k % 3 == 0 || k + 1 == count {
                let (y, z) = (rise * k as f64 + 0.08, -going * (k as f64 - 0.1));
                m.add(Stuff::Metal, rod([s * (half + 0.02), y, z], [s * (half + 0.02), y + 0.96, z], 0.01, 8));
            }
        }
    }
    for k in 0..count {
        let (y, z) = (rise * (k as f64 + 1.0), -going * k as f64);
        m.add(Stuff::Wood, board([0.0, y - 0.018, z], [half, 0.018, 0.5 * going + 0.015]));
        m.top([0.0, y, z + 0.04], [half - 0.02, 0.5 * going - 0.05], 1.0);
    }
    m.made()
}

fn spiral(d: &mut Stream) -> Made {
    let (count, r, rise) = (10 + d.below(8), d.range(0.6, 0.9), d.range(0.17, 0.2));
    let step = d.range(0.38, 0.5);
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Wood, Stuff::Metal]);
    let mut m = Maker::default();
    let h = rise * count as f64;
    m.add(Stuff::PaintedMetal, rod([0.0, 0.0, 0.0], [0.0, h + 0.95, 0.0], 0.05, 20));
    let mut rail = Vec::new();
    for k in 0..count {
        let a = step * k as f64;
        let outline: Vec<[f64; 2]> = [[0.045, -0.03], [0.045, 0.03]].into_iter().map(|[x, y]| [x, y]).collect();
        let far = arc([0.0, 0.0], r, -0.55 * step, 0.55 * step, 6);
        let tread: Vec<[f64; 2]> = [outline[0]].into_iter().chain(far).chain([outline[1]]).collect();
        let y = rise * (k as f64 + 1.0);
        m.add(stuff, extrude(&tread, 0.035).turned_x(-0.5 * PI).turned_y(-a).at([0.0, y - 0.0175, 0.0]));
        let edge = [(r - 0.03) * maths::cos(a), y, (r - 0.03) * maths::sin(a)];
        m.add(Stuff::Metal, rod([edge[0], y - 0.01, edge[2]], [edge[0], y + 0.9, edge[2]], 0.008, 8));
        rail.push([edge[0], y + 0.9, edge[2]]);
    }
    m.add(Stuff::Metal, tube(&spline(&rail, 3), 10, |_| 0.018));
    m.made()
}

fn stepladder(d: &mut Stream) -> Made {
    let (count, w) = (3 + d.below(5), d.range(0.18, 0.24));
    let h = 0.25 * count as f64;
    let (front, back) = (0.25 * h, 0.35 * h);
    let stuff = *d.pick(&[Stuff::Metal, Stuff::Wood, Stuff::PaintedMetal]);
    let mut m = Maker::default();
    for s in [-1.0, 1.0] {
        m.add(stuff, beam([s * (w + 0.05), 0.0, front], [s * w, h, 0.0], [0.05, 0.02], [0.0, 0.0, 1.0]));
        m.add(stuff, beam([s * (w + 0.04), 0.0, -back], [s * (w - 0.02), h, -0.03], [0.03, 0.02], [0.0, 0.0, 1.0]));
        m.add(
            Stuff::Metal,
            beam([s * w, 0.55 * h, 0.45 * front], [s * w, 0.55 * h, -0.45 * back], [0.014, 0.004], [0.0, 1.0, 0.0]),
        );
    }
    for k in 1..=count {
        let t = k as f64 / count as f64;
        let y = h * t;
        let z = front * (1.0 - t);
        let wide = w + 0.05 * (1.0 - t) - 0.011;
        m.add(stuff, board([0.0, y - 0.02, z + 0.01], [wide, 0.012, 0.04]));
    }
    m.add(stuff, board([0.0, h + 0.01, -0.02], [w + 0.03, 0.012, 0.09]));
    m.top([0.0, h + 0.022, -0.02], [w, 0.07], f64::INFINITY);
    for y in [0.25, 0.6] {
        let z = -back + (back - 0.03) * y;
        m.add(stuff, rod([-w - 0.02, y * h, z], [w + 0.02, y * h, z], 0.009, 8));
    }
    m.made()
}

fn park(d: &mut Stream) -> Made {
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

fn bench_stone(d: &mut Stream) -> Made {
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

fn lamp_arm(d: &mut Stream) -> Made {
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

fn lamp_globe(d: &mut Stream) -> Made {
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

fn lamp_lantern(d: &mut Stream) -> Made {
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
