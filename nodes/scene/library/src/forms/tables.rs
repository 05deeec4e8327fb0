//! Tables and desks.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
    storage::fronts,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("table_dining", Family::Table, 10, dining),
    form("table_round", Family::Table, 8, round),
    form("table_coffee", Family::Table, 8, coffee),
    form("table_side_tripod", Family::Table, 6, tripod),
    form("table_trestle", Family::Table, 6, trestle),
    form("table_glass", Family::Table, 6, glass),
    form("table_nest_console", Family::Table, 6, console),
    form("desk_drawers", Family::Desk, 8, drawers),
    form("desk_frame", Family::Desk, 8, frame),
    form("desk_secretary", Family::Desk, 6, secretary),
    form("workbench", Family::Desk, 6, workbench),
];

const CORNERS: [(f64, f64); 4] = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)];

fn plank_top(m: &mut Maker, stuff: Stuff, half: [f64; 2], height: f64, thick: f64) {
    m.add(stuff, board([0.0, height - 0.5 * thick, 0.0], [half[0], 0.5 * thick, half[1]]));
    m.top([0.0, height, 0.0], [half[0] - 0.01, half[1] - 0.01], f64::INFINITY);
}

fn dining(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.6, 1.1), d.range(0.38, 0.5)];
    let (height, thick, leg) = (d.range(0.72, 0.77), d.range(0.02, 0.045), d.range(0.025, 0.045));
    let mut m = Maker::default();
    plank_top(&mut m, Stuff::Wood, half, height, thick);
    let under = height - thick;
    let turned = d.chance(0.4);
    let inset = d.range(0.05, 0.12);
    for (sx, sz) in CORNERS {
        let [x, z] = [sx * (half[0] - inset), sz * (half[1] - inset)];
        if turned {
            m.add(Stuff::Wood, board([x, under - 0.07, z], [leg, 0.07, leg]));
            let l = under - 0.14;
            let shape = [
                [0.0, 0.0],
                [0.55, 0.0],
                [0.7, 0.02],
                [0.5, 0.06],
                [0.8, 0.1],
                [0.6, 0.16],
                [0.95, 0.6],
                [0.7, 0.85],
                [1.0, 0.9],
                [0.7, 0.95],
                [0.9, 1.0],
                [0.0, 1.0],
            ];
            let profile: Vec<_> = shape.iter().map(|[r, y]| [r * leg, y * l]).collect();
            m.add(Stuff::Wood, lathe(&profile, 14).across().at([x, 0.0, z]));
        } else {
            m.add(
                Stuff::Wood,
                sweep(&[[x, 0.0, z], [x, under, z]], &rounded_rect([leg, leg], 0.2 * leg, 1), [1.0, 0.0, 0.0], |t| {
                    0.65 + 0.35 * t
                }),
            );
        }
    }
    let (ax, az) = (half[0] - inset - leg, half[1] - inset - leg);
    for s in [-1.0, 1.0] {
        m.add(Stuff::Wood, board([0.0, under - 0.045, s * (half[1] - inset)], [ax, 0.045, 0.011]));
        m.add(Stuff::Wood, board([s * (half[0] - inset), under - 0.045, 0.0], [0.011, 0.045, az]));
    }
    m.made()
}

fn round(d: &mut Stream) -> FormVariant {
    let (r, height, thick) = (d.range(0.35, 0.65), d.range(0.7, 0.76), d.range(0.018, 0.04));
    let top = *d.pick(&[Stuff::Wood, Stuff::Wood, Stuff::Stone]);
    let base = if top == Stuff::Wood && d.chance(0.6) { Stuff::Wood } else { Stuff::PaintedMetal };
    let mut m = Maker::default();
    let e = 0.3 * thick;
    let y = height - thick;
    let disc = extrude(&circle(56, r - e), thick).turned_x(-0.5 * PI).at([0.0, height - 0.5 * thick, 0.0]);
    m.add(top, disc);
    m.top([0.0, height, 0.0], [0.68 * r, 0.68 * r], f64::INFINITY);
    if d.chance(0.5) {
        let k = d.range(0.03, 0.05);
        let shape = flat_spline(
            &[[0.55 * r, 0.02], [0.2 * r, 0.05], [k, 0.15], [1.4 * k, 0.3], [k, 0.45], [1.6 * k, 0.6], [0.25 * r, y]],
            4,
        );
        let profile: Vec<_> = [[0.0, 0.0], [0.55 * r, 0.0]].into_iter().chain(shape).chain([[0.0, y]]).collect();
        m.add(base, lathe(&profile, 28));
    } else {
        m.add(base, rod([0.0, 0.06, 0.0], [0.0, y, 0.0], 0.04, 16));
        let legs = 3 + d.below(2);
        for k in 0..legs {
            let a = TAU * k as f64 / legs as f64;
            let (s, c) = (maths::sin(a), maths::cos(a));
            let path = spline(
                &[
                    [0.02 * s, 0.2, 0.02 * c],
                    [0.15 * s, 0.16, 0.15 * c],
                    [0.62 * r * s, 0.03, 0.62 * r * c],
                    [0.68 * r * s, 0.016, 0.68 * r * c],
                ],
                4,
            );
            m.add(base, tube(&path, 8, |t| 0.026 - 0.01 * t));
        }
    }
    m.made()
}

fn coffee(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.4, 0.65), d.range(0.25, 0.4)];
    let (height, thick) = (d.range(0.32, 0.46), d.range(0.018, 0.04));
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Stone, Stuff::Plastic]);
    let mut m = Maker::default();
    plank_top(&mut m, stuff, half, height, thick);
    let leg = *d.pick(&[Stuff::Wood, Stuff::Metal]);
    let splay = d.range(0.0, 0.06);
    for (sx, sz) in CORNERS {
        let [x, z] = [sx * (half[0] - 0.07), sz * (half[1] - 0.07)];
        m.add(leg, tube(&[[x + sx * splay, 0.0, z + sz * splay], [x, height - thick, z]], 10, |t| 0.012 + 0.009 * t));
    }
    if d.chance(0.6) {
        let y = 0.14;
        m.add(Stuff::Wood, board([0.0, y, 0.0], [half[0] - 0.07, 0.008, half[1] - 0.07]));
        m.top([0.0, y + 0.008, 0.0], [half[0] - 0.12, half[1] - 0.12], height - thick - y - 0.008);
    }
    m.made()
}

fn tripod(d: &mut Stream) -> FormVariant {
    let (r, height) = (d.range(0.18, 0.26), d.range(0.48, 0.65));
    let mut m = Maker::default();
    let rim = d.range(0.0, 0.015);
    m.add(
        Stuff::Wood,
        lathe(
            &[
                [0.0, height - 0.016],
                [r, height - 0.016],
                [r, height + rim],
                [r - 0.012, height + rim],
                [r - 0.014, height],
                [0.0, height],
            ],
            40,
        ),
    );
    m.top([0.0, height, 0.0], [0.62 * r, 0.62 * r], f64::INFINITY);
    for k in 0..3 {
        let a = TAU * f64::from(k) / 3.0;
        let (s, c) = (maths::sin(a), maths::cos(a));
        let t = 0.5 * r;
        m.add(
            Stuff::Wood,
            tube(&[[0.95 * r * s, 0.0, 0.95 * r * c], [-0.6 * t * s, height - 0.016, -0.6 * t * c]], 8, |t| {
                0.01 + 0.005 * t
            }),
        );
    }
    m.made()
}

fn trestle(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.7, 1.1), d.range(0.35, 0.45)];
    let (height, thick) = (d.range(0.72, 0.76), d.range(0.02, 0.035));
    let mut m = Maker::default();
    plank_top(&mut m, Stuff::Wood, half, height, thick);
    let under = height - thick;
    let stuff = *d.pick(&[Stuff::Wood, Stuff::PaintedMetal]);
    for s in [-1.0, 1.0] {
        let x = s * (half[0] - 0.22);
        m.add(stuff, board([x, under - 0.025, 0.0], [0.03, 0.025, half[1] - 0.05]));
        for (e, z) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
            let z = z * (half[1] - 0.09);
            m.add(stuff, beam([x + e * 0.16, 0.0, z], [x + e * 0.02, under - 0.03, z], [0.035, 0.02], [1.0, 0.0, 0.0]));
        }
        for e in [-1.0, 1.0] {
            m.add(stuff, board([x + e * 0.112, 0.25, 0.0], [0.01, 0.02, half[1] - 0.1]));
        }
    }
    m.made()
}

fn glass(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.4, 0.8), d.range(0.3, 0.45)];
    let height = d.range(0.38, 0.74);
    let mut m = Maker::default();
    let r = 0.04;
    let sheet = extrude(&rounded_rect(half, r, 5), 0.012).turned_x(-0.5 * PI).at([0.0, height - 0.006, 0.0]);
    m.add(Stuff::Glass, sheet);
    m.top([0.0, height, 0.0], [half[0] - 0.03, half[1] - 0.03], f64::INFINITY);
    let stuff = *d.pick(&[Stuff::Metal, Stuff::PaintedMetal]);
    let k = d.range(0.01, 0.016);
    let y = height - 0.012 - 2.0 * k;
    for s in [-1.0, 1.0] {
        let x = s * (half[0] - 0.1);
        let z = half[1] - 0.06;
        let path = [[x, 0.012, -z], [x, y + k, -z], [x, y + k, z], [x, 0.012, z]];
        let path = fillet(&path, 0.03, 3);
        m.add(stuff, tube(&path, 8, |_| k));
        for z in [-z, z] {
            m.add(Stuff::Rubber, rod([x, 0.0, z], [x, 0.013, z], 1.3 * k, 10));
        }
    }
    for z in [-0.5, 0.5] {
        m.add(
            stuff,
            rod([-half[0] + 0.1, y + k - 0.001, z * half[1]], [half[0] - 0.1, y + k - 0.001, z * half[1]], 0.8 * k, 8),
        );
    }
    m.made()
}

fn console(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.45, 0.65), d.range(0.14, 0.19)];
    let height = d.range(0.74, 0.86);
    let mut m = Maker::default();
    plank_top(&mut m, Stuff::Wood, half, height, 0.025);
    let body = d.range(0.1, 0.16);
    m.add(
        Stuff::Wood,
        board([0.0, height - 0.025 - 0.5 * body, -0.005], [half[0] - 0.03, 0.5 * body, half[1] - 0.025]),
    );
    let count = 1 + d.below(3);
    fronts(
        &mut m,
        d,
        Stuff::Wood,
        [half[0] - 0.035, 0.5 * body - 0.006],
        [0.0, height - 0.025 - 0.5 * body, half[1] - 0.03],
        count,
        1,
    );
    for (sx, sz) in CORNERS {
        let [x, z] = [sx * (half[0] - 0.055), sz * (half[1] - 0.05)];
        m.add(
            Stuff::Wood,
            sweep(
                &[[x, 0.0, z], [x, height - 0.025 - body, z]],
                &rounded_rect([0.02, 0.02], 0.005, 1),
                [1.0, 0.0, 0.0],
                |t| 0.6 + 0.4 * t,
            ),
        );
    }
    m.made()
}

fn drawers(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.6, 0.85), d.range(0.3, 0.4)];
    let height = d.range(0.72, 0.76);
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Wood, Stuff::Plastic]);
    let mut m = Maker::default();
    plank_top(&mut m, stuff, half, height, 0.028);
    let wide = d.range(0.17, 0.22);
    let both = d.chance(0.4);
    let under = height - 0.028;
    for s in [-1.0, 1.0] {
        let x = s * (half[0] - wide - 0.02);
        if s > 0.0 || both {
            m.add(stuff, board([x, 0.5 * (under + 0.04), -0.01], [wide, 0.5 * (under - 0.04), half[1] - 0.04]));
            let rows = 2 + d.below(3);
            fronts(
                &mut m,
                d,
                stuff,
                [wide - 0.006, 0.5 * (under - 0.05)],
                [x, 0.5 * (under + 0.04), half[1] - 0.05],
                1,
                rows,
            );
            m.add(Stuff::Plastic, block([x, 0.02, -0.02], [wide - 0.02, 0.02, half[1] - 0.07]));
        } else {
            m.add(stuff, board([-half[0] + 0.03, 0.5 * under, 0.0], [0.014, 0.5 * under, half[1] - 0.04]));
        }
    }
    let inner = if both { half[0] - 2.0 * wide - 0.02 } else { half[0] - 0.045 };
    let (low, high) = if both { (-inner, inner) } else { (-half[0] + 0.044, half[0] - 2.0 * wide - 0.02) };
    m.add(stuff, board([0.5 * (low + high), under - 0.15, -half[1] + 0.08], [0.5 * (high - low), 0.15, 0.009]));
    m.made()
}

fn frame(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.55, 0.9), d.range(0.3, 0.4)];
    let height = d.range(0.7, 0.78);
    let mut m = Maker::default();
    plank_top(&mut m, Stuff::Wood, half, height, 0.025);
    let under = height - 0.025;
    let k = d.range(0.018, 0.03);
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Metal]);
    let slope = d.range(0.0, 0.12);
    for s in [-1.0, 1.0] {
        let x = s * (half[0] - 0.08);
        let z = half[1] - 0.05;
        for e in [-1.0, 1.0] {
            m.add(stuff, beam([x + s * 0.03, 0.0, e * z], [x, under - k, e * (z - slope)], [k, k], [1.0, 0.0, 0.0]));
        }
        m.add(stuff, board([x, under - 0.5 * k, 0.0], [0.5 * k, 0.5 * k, z - slope + 0.5 * k]));
        m.add(stuff, board([x + s * 0.03, 0.5 * k, 0.0], [0.5 * k, 0.5 * k, z - 0.5 * k]));
    }
    m.add(stuff, board([0.0, under - 0.5 * k, 0.0], [half[0] - 0.08 - 0.5 * k, 0.5 * k, 0.5 * k]));
    m.made()
}

/// A desk with pigeonholes on top.
fn secretary(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.42, 0.6), d.range(0.26, 0.32)];
    let (height, upper) = (d.range(0.72, 0.76), d.range(0.25, 0.4));
    let mut m = Maker::default();
    m.add(Stuff::Wood, board([0.0, height - 0.012, 0.0], [half[0], 0.012, half[1]]));
    let deep = 0.1;
    m.top([0.0, height, deep + 0.01], [half[0] - 0.02, half[1] - deep - 0.03], f64::INFINITY);
    let z = -half[1] + deep;
    let count = 3 + d.below(3);
    for k in 0..=count {
        let x = (half[0] - 0.01) * (2.0 * k as f64 / count as f64 - 1.0);
        m.add(Stuff::Wood, board([x, height + 0.5 * upper, z], [0.008, 0.5 * upper, deep]));
        if k < count {
            let w = (half[0] - 0.01) / count as f64;
            let y = height + upper * d.range(0.4, 0.6);
            m.add(Stuff::Wood, board([x + w, y, z], [w - 0.008, 0.006, deep]));
            m.top([x + w, y + 0.006, z], [w - 0.02, deep - 0.02], height + upper - y - 0.006);
        }
    }
    m.add(Stuff::Wood, board([0.0, height + upper + 0.01, z], [half[0], 0.01, deep]));
    m.top([0.0, height + upper + 0.02, z], [half[0] - 0.02, deep - 0.02], f64::INFINITY);
    m.add(Stuff::Wood, board([0.0, height + 0.5 * upper, -half[1] + 0.004], [half[0] - 0.02, 0.5 * upper, 0.004]));
    m.add(Stuff::Wood, board([0.0, height - 0.075, -0.01], [half[0] - 0.02, 0.05, half[1] - 0.025]));
    fronts(&mut m, d, Stuff::Wood, [half[0] - 0.03, 0.045], [0.0, height - 0.075, half[1] - 0.035], 2, 1);
    for (sx, sz) in CORNERS {
        let [x, z] = [sx * (half[0] - 0.045), sz * (half[1] - 0.05)];
        m.add(Stuff::Wood, tube(&[[x, 0.0, z], [x, height - 0.125, z]], 10, |t| 0.012 + 0.01 * t));
    }
    m.made()
}

fn workbench(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.7, 1.0), d.range(0.3, 0.36)];
    let height = d.range(0.84, 0.92);
    let mut m = Maker::default();
    let planks = 3 + d.below(3);
    let each = half[1] / planks as f64;
    for k in 0..planks {
        let z = -half[1] + each * (2.0 * k as f64 + 1.0);
        m.add(Stuff::Wood, board([0.0, height - 0.03, z], [half[0], 0.03, each - 0.0015]));
    }
    m.top([0.0, height, 0.0], [half[0] - 0.02, half[1] - 0.02], f64::INFINITY);
    let leg = 0.045;
    for (sx, sz) in CORNERS {
        m.add(
            Stuff::Wood,
            board(
                [sx * (half[0] - 0.1), 0.5 * (height - 0.06), sz * (half[1] - 0.06)],
                [leg, 0.5 * (height - 0.06), leg],
            ),
        );
    }
    let y = d.range(0.15, 0.25);
    for s in [-1.0, 1.0] {
        m.add(Stuff::Wood, board([0.0, y, s * (half[1] - 0.06)], [half[0] - 0.1 - leg, 0.04, 0.018]));
        m.add(Stuff::Wood, board([0.0, height - 0.12, s * (half[1] - 0.06)], [half[0] - 0.1 - leg, 0.05, 0.018]));
    }
    m.add(Stuff::Wood, board([0.0, y + 0.049, 0.0], [half[0] - 0.1 - leg, 0.009, half[1] - 0.06]));
    m.top([0.0, y + 0.058, 0.0], [half[0] - 0.2, half[1] - 0.1], height - 0.06 - y - 0.058);
    // A vice at the end.
    let (x, vy) = (half[0] - 0.3, height - 0.09);
    m.add(Stuff::PaintedMetal, board([x, vy, half[1] + 0.07], [0.09, 0.06, 0.02]));
    m.add(Stuff::Metal, rod([x, vy, half[1] - 0.05], [x, vy, half[1] + 0.13], 0.014, 12));
    m.add(Stuff::Metal, rod([x - 0.1, vy, half[1] + 0.12], [x + 0.1, vy, half[1] + 0.12], 0.006, 8));
    m.made()
}
