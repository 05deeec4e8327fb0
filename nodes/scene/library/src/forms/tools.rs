//! Tools.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("hammer", Family::Tool, 6, hammer),
    form("spanner", Family::Tool, 6, spanner),
    form("screwdriver", Family::Tool, 6, screwdriver),
    form("saw", Family::Tool, 6, saw),
    form("toolbox", Family::Tool, 6, toolbox),
    form("broom", Family::Tool, 4, broom),
    form("watering_can", Family::Tool, 6, watering_can),
];

fn hammer(d: &mut Stream) -> FormVariant {
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

fn spanner(d: &mut Stream) -> FormVariant {
    let (l, w, t) = (d.range(0.12, 0.24), d.range(0.006, 0.009), d.range(0.004, 0.006));
    let mut m = Maker::default();
    let (jaw, r) = (2.2 * w, 3.0 * w);
    // An open end, as an outline: round about, with a slot of parallel sides, turned by 15 degrees.
    let turn = 0.26;
    let spin = |p: [f64; 2]| {
        [p[0] * maths::cos(turn) - p[1] * maths::sin(turn), p[0] * maths::sin(turn) + p[1] * maths::cos(turn)]
    };
    let open = maths::asin(0.5 * jaw / r);
    let slot = [[0.1 * r, 0.5 * jaw], [0.35 * r, 0.0], [0.1 * r, -0.5 * jaw]];
    let round = arc([0.0, 0.0], r, PI + open, 3.0 * PI - open, 28);
    let outline: Vec<[f64; 2]> = round.into_iter().chain(slot).map(spin).collect();
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

fn screwdriver(d: &mut Stream) -> FormVariant {
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

fn saw(d: &mut Stream) -> FormVariant {
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

fn toolbox(d: &mut Stream) -> FormVariant {
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

fn broom(d: &mut Stream) -> FormVariant {
    let (l, w) = (d.range(1.2, 1.5), d.range(0.14, 0.22));
    let mut m = Maker::default();
    m.add(Stuff::Wood, rod([0.0, 0.11, 0.0], [0.0, l, 0.0], 0.012, 12));
    m.add(*d.pick(&[Stuff::Wood, Stuff::Plastic]), soft_block([0.0, 0.1, 0.0], [w, 0.018, 0.025], 0.008, 2));
    let mut hair = Vec::new();
    for _ in 0..180 {
        let (x, z) = (w * d.range(-0.97, 0.97), 0.022 * d.range(-1.0, 1.0));
        hair.push(tube(&[[x, 0.085, z], [x * 1.05, d.range(0.0, 0.004), z * 1.6]], 3, |_| 0.0016));
    }
    m.add(Stuff::Grass, Body::all(hair));
    m.made()
}

fn watering_can(d: &mut Stream) -> FormVariant {
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
