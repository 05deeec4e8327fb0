//! Boxes, bins, tools.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, Made, form,
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
    form("waste_basket", Family::Bin, 6, waste),
    form("wheelie_bin", Family::Bin, 6, wheelie),
    form("street_bin", Family::Bin, 6, street),
    form("bucket", Family::Bin, 6, bucket),
    form("hammer", Family::Tool, 6, hammer),
    form("spanner", Family::Tool, 6, spanner),
    form("screwdriver", Family::Tool, 6, screwdriver),
    form("saw", Family::Tool, 6, saw),
    form("toolbox", Family::Tool, 6, toolbox),
    form("broom", Family::Tool, 4, broom),
    form("watering_can", Family::Tool, 6, watering_can),
];

const SIDES: [(f64, f64); 4] = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];

fn crate_slats(d: &mut Stream) -> Made {
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

fn carton(d: &mut Stream) -> Made {
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
fn basket(d: &mut Stream) -> Made {
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

fn barrel(d: &mut Stream) -> Made {
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

fn suitcase(d: &mut Stream) -> Made {
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

fn gift(d: &mut Stream) -> Made {
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

fn waste(d: &mut Stream) -> Made {
    let (r, h, flare) = (d.range(0.1, 0.15), d.range(0.24, 0.35), d.range(1.05, 1.4));
    let mut m = Maker::default();
    if d.chance(0.5) {
        let mut wires = Vec::new();
        for k in 0..40 {
            let a = TAU * f64::from(k) / 40.0;
            let b = a + 0.35;
            for (from, to) in [(a, b), (b, a)] {
                wires.push(
                    rod(
                        [r * maths::sin(from), 0.004, r * maths::cos(from)],
                        [r * flare * maths::sin(to), h, r * flare * maths::cos(to)],
                        0.0012,
                        4,
                    )
                    .smooth(),
                );
            }
        }
        m.add(Stuff::Metal, Body::all(wires));
        m.add(Stuff::Metal, tube_loop(&ring_path(r * flare, h, 40), 6, 0.004));
        m.add(Stuff::Metal, lathe(&[[0.0, 0.0], [r + 0.002, 0.0], [r + 0.002, 0.008], [0.0, 0.008]], 40));
    } else {
        let t = 0.003;
        m.add(
            *d.pick(&[Stuff::Plastic, Stuff::PaintedMetal]),
            lathe(
                &[
                    [0.0, 0.0],
                    [r, 0.0],
                    [r * flare, h],
                    [r * flare + 0.006, h],
                    [r * flare + 0.006, h + 0.006],
                    [r * flare - t, h + 0.006],
                    [r - t, t],
                    [0.0, t],
                ],
                40,
            ),
        );
    }
    let balls = d.below(4);
    for k in 0..balls {
        let a = 2.0 * k as f64;
        let seed = d.bits();
        let body =
            icosphere(2, |p| 0.035 * (0.8 + 0.4 * super::super::noise::noise(seed, p.map(|v| 3.0 * v), [0; 3]).abs()))
                .flat();
        m.add(Stuff::Paper, body.at([0.05 * maths::sin(a), 0.06 + 0.03 * k as f64, 0.05 * maths::cos(a)]));
    }
    m.made()
}

fn wheelie(d: &mut Stream) -> Made {
    let (h, w) = (d.range(0.9, 1.05), d.range(0.24, 0.29));
    let mut m = Maker::default();
    let ring = |a: f64, z0: f64, z1: f64, y: f64| vec![[-a, y, z1], [a, y, z1], [a, y, z0], [-a, y, z0]];
    let rings = [
        ring(0.78 * w, -0.2, 0.2, 0.04),
        ring(w, -0.26, 0.3, 0.88 * h),
        ring(w + 0.015, -0.275, 0.315, 0.88 * h),
        ring(w + 0.015, -0.275, 0.315, 0.92 * h),
    ];
    m.add(Stuff::Plastic, skin(&rings, [true, false], [true, true]));
    let lid = slab(6, 6, 0.02, |s, t| {
        let (x, z) = ((w + 0.025) * (2.0 * s - 1.0), 0.33 - 0.61 * t);
        [x, 0.925 * h + 0.02 + 0.05 * maths::sin(0.5 * PI * t) + 0.02 * (1.0 - (2.0 * s - 1.0) * (2.0 * s - 1.0)), z]
    });
    m.another(Stuff::Plastic, lid);
    m.add(
        Stuff::Plastic,
        tube(
            &fillet(
                &[
                    [-0.8 * w, 0.88 * h, -0.26],
                    [-0.8 * w, 0.95 * h, -0.33],
                    [0.8 * w, 0.95 * h, -0.33],
                    [0.8 * w, 0.88 * h, -0.26],
                ],
                0.03,
                3,
            ),
            8,
            |_| 0.014,
        ),
    );
    for s in [-1.0, 1.0] {
        let wheel = lathe(&[[0.0, -0.02], [0.06, -0.025], [0.1, -0.025], [0.1, 0.025], [0.06, 0.025], [0.0, 0.02]], 24);
        m.add(Stuff::Rubber, wheel.turned_z(0.5 * PI).at([s * (0.8 * w + 0.035), 0.1, -0.2]));
    }
    m.made()
}

fn street(d: &mut Stream) -> Made {
    let (r, h) = (d.range(0.2, 0.26), d.range(0.75, 0.95));
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Wood, Stuff::Metal]);
    m.add(
        Stuff::PaintedMetal,
        lathe(&[[0.0, 0.0], [r, 0.0], [r, 0.05], [r - 0.02, 0.06], [r - 0.02, h - 0.1], [0.0, h - 0.1]], 32),
    );
    let slats = 20;
    for k in 0..slats {
        let a = TAU * f64::from(k) / f64::from(slats);
        let slat = board([0.0, 0.5 * h, r], [PI * r / f64::from(slats) * 0.8, 0.5 * h - 0.07, 0.008]);
        m.add(stuff, slat.turned_y(a));
    }
    let top = h + d.range(0.0, 0.12);
    m.add(
        Stuff::PaintedMetal,
        lathe(&[[0.0, top], [r + 0.02, top], [r + 0.02, top + 0.02], [0.5 * r, top + 0.07], [0.0, top + 0.08]], 32),
    );
    for (x, z) in SIDES {
        m.add(
            Stuff::PaintedMetal,
            rod([x * (r - 0.03), h - 0.12, z * (r - 0.03)], [x * (r - 0.03), top + 0.005, z * (r - 0.03)], 0.01, 8),
        );
    }
    m.made()
}

fn bucket(d: &mut Stream) -> Made {
    let (r, h) = (d.range(0.1, 0.14), d.range(0.22, 0.3));
    let stuff = *d.pick(&[Stuff::Metal, Stuff::Plastic, Stuff::PaintedMetal]);
    let mut m = Maker::default();
    let k = 1.3 * r;
    m.add(
        stuff,
        lathe(
            &[
                [0.0, 0.008],
                [r - 0.004, 0.008],
                [r - 0.004, 0.0],
                [r, 0.0],
                [k, h],
                [k + 0.006, h],
                [k + 0.006, h + 0.006],
                [k - 0.003, h + 0.006],
                [r - 0.003, 0.012],
                [0.0, 0.012],
            ],
            40,
        ),
    );
    let down = d.chance(0.5);
    let path: Vec<_> = (0..=20)
        .map(|j| PI * f64::from(j) / 20.0)
        .map(|a| {
            let (x, q) = ((k + 0.008) * maths::cos(a), 1.02 * k * maths::sin(a));
            if down { [x, h - 0.015 + 0.12 * q, 1.12 * q] } else { [x, h - 0.015 + q, 0.15 * q] }
        })
        .collect();
    m.add(Stuff::Metal, tube(&path, 6, |_| 0.0028));
    m.made()
}

fn hammer(d: &mut Stream) -> Made {
    let (l, k) = (d.range(0.26, 0.34), d.range(0.011, 0.015));
    let mut m = Maker::default();
    let path = line([0.0, k, 0.0], [l, k, 0.0], 12);
    m.add(
        *d.pick(&[Stuff::Wood, Stuff::Rubber]),
        sweep(
            &path,
            &circle(12, 1.0).into_iter().map(|[a, b]| [0.012 * a, 0.016 * b]).collect::<Vec<_>>(),
            [0.0, 1.0, 0.0],
            |t| 0.75 + 0.3 * maths::sin(PI * (0.2 + 0.75 * t)) * t,
        ),
    );
    let head = d.range(0.09, 0.12);
    m.add(Stuff::Metal, soft_block([0.004, k, 0.0], [k + 0.001, k, 0.3 * head], 0.003, 2));
    m.add(
        Stuff::Metal,
        lathe(
            &[
                [0.0, 0.0],
                [0.8 * k, 0.0],
                [0.7 * k, 0.2 * head],
                [1.15 * k, 0.24 * head],
                [1.15 * k, 0.35 * head],
                [k, 0.37 * head],
                [0.0, 0.37 * head],
            ],
            20,
        )
        .turned_x(0.5 * PI)
        .at([0.004, k * 1.0, 0.27 * head]),
    );
    if d.chance(0.5) {
        for s in [-1.0, 1.0] {
            let path = spline(
                &[
                    [0.004 + s * 0.005, k, -0.27 * head],
                    [0.004 + s * 0.008, k, -0.5 * head],
                    [0.018 + s * 0.01, k, -0.72 * head],
                ],
                4,
            );
            m.add(
                Stuff::Metal,
                sweep(&path, &rounded_rect([0.008, 0.0045], 0.002, 1), [0.0, 1.0, 0.0], |t| 1.0 - 0.6 * t),
            );
        }
    } else {
        let ring = |x: f64, y: f64, z: f64| {
            vec![[0.004 - x, k - y, z], [0.004 + x, k - y, z], [0.004 + x, k + y, z], [0.004 - x, k + y, z]]
        };
        m.add(
            Stuff::Metal,
            skin(
                &[ring(0.0025, 0.9 * k, -0.7 * head), ring(0.8 * k, 0.8 * k, -0.28 * head)],
                [true, false],
                [true, true],
            ),
        );
    }
    m.made()
}

fn spanner(d: &mut Stream) -> Made {
    let (l, w, t) = (d.range(0.12, 0.24), d.range(0.006, 0.009), d.range(0.004, 0.006));
    let mut m = Maker::default();
    let (jaw, r) = (2.2 * w, 3.0 * w);
    // An open end, as an outline: round about, with a slot of parallel sides, turned by 15 degrees.
    let turn = 0.26;
    let spin = |p: [f64; 2]| {
        [p[0] * maths::cos(turn) - p[1] * maths::sin(turn), p[0] * maths::sin(turn) + p[1] * maths::cos(turn)]
    };
    let open = maths::asin(0.5 * jaw / r);
    let outline: Vec<[f64; 2]> = arc([0.0, 0.0], r, PI + open, 3.0 * PI - open, 28)
        .into_iter()
        .chain([[0.1 * r, -0.5 * jaw], [0.35 * r, 0.0], [0.1 * r, 0.5 * jaw]].into_iter().rev().rev())
        .collect();
    let mut outline: Vec<[f64; 2]> = outline.into_iter().map(spin).collect();
    // The slot is walked from the arc's end, which lies above it.
    let n = outline.len();
    outline[n - 3..].reverse();
    m.add(Stuff::Metal, extrude(&outline, 1.4 * t).turned_x(-0.5 * PI).at([0.0, 0.7 * t, 0.0]));
    m.add(Stuff::Metal, soft_block([0.5 * l + 0.4 * r, 0.7 * t, 0.0], [0.5 * l - 0.3 * r, 0.5 * t, w], 0.4 * t, 2));
    let hole = circle(12, 0.62 * r);
    let ring: Vec<[f64; 2]> = circle(28, 0.95 * r);
    m.add(
        Stuff::Metal,
        extrude_with_holes(&ring, &[hole], 1.6 * t).turned_x(-0.5 * PI).at([l + 0.8 * r, 0.8 * t, 0.0]),
    );
    m.made()
}

fn screwdriver(d: &mut Stream) -> Made {
    let (grip, shaft, r) = (d.range(0.08, 0.11), d.range(0.07, 0.16), d.range(0.011, 0.016));
    let mut m = Maker::default();
    let ribs = 6;
    let n = ribs * 6;
    let shape = flat_spline(
        &[
            [0.0, 0.0],
            [0.7 * r, 0.001],
            [r, 0.15 * grip],
            [0.98 * r, 0.6 * grip],
            [0.62 * r, 0.82 * grip],
            [0.8 * r, 0.95 * grip],
            [0.5 * r, grip],
            [0.0, grip],
        ],
        3,
    );
    let rings: Vec<Vec<_>> = shape
        .iter()
        .map(|[q, y]| {
            (0..n)
                .map(|i| {
                    let a = TAU * i as f64 / n as f64;
                    let k = q
                        * (1.0
                            - 0.1
                                * maths::pow(maths::sin(0.5 * ribs as f64 * a).abs(), 4.0)
                                * if *y < 0.7 * grip { 1.0 } else { 0.0 });
                    [k * maths::sin(a), *y, k * maths::cos(a)]
                })
                .collect()
        })
        .collect();
    let lay = |b: Body| b.turned_z(-0.5 * PI);
    m.add(Stuff::Plastic, lay(skin(&rings, [true, false], [false; 2])));
    m.add(Stuff::Metal, lay(rod([0.0, grip - 0.01, 0.0], [0.0, grip + 0.85 * shaft, 0.0], 0.0033, 12)));
    let ring = |x: f64, z: f64, y: f64| vec![[x, y, z], [x, y, -z], [-x, y, -z], [-x, y, z]];
    m.add(
        Stuff::Metal,
        lay(skin(
            &[
                ring(0.0028, 0.0028, grip + 0.84 * shaft),
                ring(0.0018, 0.0045, grip + 0.93 * shaft),
                ring(0.0006, 0.004, grip + shaft),
            ],
            [true, false],
            [true, true],
        )),
    );
    m.made()
}

fn saw(d: &mut Stream) -> Made {
    let (l, h) = (d.range(0.35, 0.55), d.range(0.09, 0.12));
    let teeth = (l / 0.011) as usize;
    let tip = 0.45 * h;
    let mut outline = vec![[0.0, h], [l, h]];
    outline.push([l, h - tip]);
    for k in 0..teeth {
        let t = 1.0 - k as f64 / teeth as f64;
        let u = 1.0 - (k as f64 + 0.5) / teeth as f64;
        let edge = |t: f64| (h - tip) * t;
        outline.push([l * t - 0.0005, edge(t)]);
        outline.push([l * u, edge(u) + 0.005]);
    }
    outline.push([0.0, 0.0]);
    let mut m = Maker::default();
    let flat = |b: Body, y: f64| b.turned_x(-0.5 * PI).at([0.0, y, 0.0]);
    m.add(Stuff::Metal, flat(extrude(&outline, 0.0012), 0.009));
    let grip = closed_spline(
        &[
            [0.02, 0.0],
            [0.03, 0.5 * h],
            [0.02, h],
            [-0.06, 1.05 * h],
            [-0.11, 0.9 * h],
            [-0.1, 0.5 * h],
            [-0.12, 0.05 * h],
            [-0.05, -0.06 * h],
        ],
        4,
    );
    let hole = closed_spline(
        &[[-0.02, 0.25 * h], [-0.02, 0.75 * h], [-0.06, 0.8 * h], [-0.075, 0.5 * h], [-0.065, 0.2 * h]],
        4,
    );
    m.add(*d.pick(&[Stuff::Wood, Stuff::Plastic]), flat(extrude_with_holes(&grip, &[hole], 0.018), 0.009));
    m.made()
}

fn toolbox(d: &mut Stream) -> Made {
    let half = [d.range(0.18, 0.26), d.range(0.07, 0.1), d.range(0.08, 0.11)];
    let mut m = Maker::default();
    m.add(Stuff::PaintedMetal, board([0.0, half[1], 0.0], half));
    let y = 2.0 * half[1];
    let ring = |x: f64, z: f64, y: f64| vec![[-x, y, z], [x, y, z], [x, y, -z], [-x, y, -z]];
    m.another(
        Stuff::PaintedMetal,
        skin(
            &[
                ring(half[0] + 0.003, half[2] + 0.003, y - 0.02),
                ring(half[0] + 0.003, half[2] + 0.003, y + 0.01),
                ring(half[0] - 0.005, 0.35 * half[2], y + 0.05),
            ],
            [true, false],
            [true, true],
        ),
    );
    let path = fillet(
        &[[-0.07, y + 0.045, 0.0], [-0.07, y + 0.085, 0.0], [0.07, y + 0.085, 0.0], [0.07, y + 0.045, 0.0]],
        0.02,
        3,
    );
    m.add(Stuff::Metal, tube(&path, 8, |_| 0.007));
    for s in [-1.0, 1.0] {
        m.add(Stuff::Metal, board([s * 0.55 * half[0], y - 0.02, half[2] + 0.005], [0.014, 0.025, 0.004]));
    }
    m.made()
}

fn broom(d: &mut Stream) -> Made {
    let (l, w) = (d.range(1.2, 1.5), d.range(0.14, 0.22));
    let mut m = Maker::default();
    m.add(Stuff::Wood, rod([0.0, 0.11, 0.0], [0.0, l, 0.0], 0.012, 12));
    m.add(*d.pick(&[Stuff::Wood, Stuff::Plastic]), soft_block([0.0, 0.1, 0.0], [w, 0.018, 0.025], 0.008, 2));
    let mut hair = Vec::new();
    for k in 0..180 {
        let (x, z) = (w * d.range(-0.97, 0.97), 0.022 * d.range(-1.0, 1.0));
        let _ = k;
        hair.push(tube(&[[x, 0.085, z], [x * 1.05, 0.0 + d.range(0.0, 0.004), z * 1.6]], 3, |_| 0.0016));
    }
    m.add(Stuff::Grass, Body::all(hair));
    m.made()
}

fn watering_can(d: &mut Stream) -> Made {
    let (r, h) = (d.range(0.08, 0.12), d.range(0.15, 0.22));
    let stuff = *d.pick(&[Stuff::Metal, Stuff::PaintedMetal, Stuff::Plastic]);
    let mut m = Maker::default();
    m.add(
        stuff,
        lathe(
            &[
                [0.0, 0.0],
                [r, 0.0],
                [r, 0.01],
                [0.98 * r, 0.012],
                [0.9 * r, h - 0.02],
                [0.88 * r, h],
                [0.86 * r, h],
                [0.86 * r, h - 0.02],
                [0.9 * r, 0.02],
                [0.0, 0.016],
            ],
            36,
        ),
    );
    let tip = [r + 0.2, h + 0.03, 0.0];
    m.add(stuff, tube(&line([0.85 * r, 0.25 * h, 0.0], tip, 4), 12, |t| 0.02 - 0.01 * t));
    let rose = lathe(&[[0.0, -0.012], [0.01, -0.012], [0.036, 0.014], [0.036, 0.019], [0.0, 0.023]], 24);
    m.add(stuff, rose.turned_z(-0.75).at(tip));
    let path = spline(
        &[
            [-0.9 * r, 0.3 * h, 0.0],
            [-1.7 * r, 0.6 * h, 0.0],
            [-1.2 * r, 1.35 * h, 0.0],
            [0.0, 1.55 * h, 0.0],
            [0.8 * r, 0.97 * h, 0.0],
        ],
        6,
    );
    m.add(stuff, tube(&path, 8, |_| 0.0065));
    m.made()
}
