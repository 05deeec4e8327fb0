//! Machine parts.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::geom::Vec3;
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("gear_spur", Family::MachinePart, 12, gear),
    form("gear_train", Family::MachinePart, 6, train),
    form("flange", Family::MachinePart, 8, flange),
    form("bearing", Family::MachinePart, 8, bearing),
    form("bolt", Family::MachinePart, 8, bolt),
    form("spring_coil", Family::MachinePart, 8, spring),
    form("crankshaft", Family::MachinePart, 6, crank),
    form("pulley", Family::MachinePart, 6, pulley),
    form("chain", Family::MachinePart, 6, chain),
];

/// The outline of a gear of `teeth` and module `m` (pitch diameter over teeth); flanks are straight.
fn toothed(teeth: usize, m: f64) -> Vec<[f64; 2]> {
    let r = 0.5 * m * teeth as f64;
    let (tip, root) = (r + m, r - 1.2 * m);
    let step = TAU / teeth as f64;
    (0..teeth)
        .flat_map(|k| {
            let a = step * k as f64;
            [(root, -0.36), (tip - 0.15 * m, -0.16), (tip, -0.12), (tip, 0.12), (tip - 0.15 * m, 0.16), (root, 0.36)]
                .map(|(q, s)| {
                    let b = a + s * step;
                    [q * maths::cos(b), q * maths::sin(b)]
                })
        })
        .collect()
}

fn wheel(teeth: usize, m: f64, thick: f64, bore: f64, holes: usize) -> Body {
    let r = 0.5 * m * teeth as f64;
    let mut cut = vec![circle(20, bore)];
    for k in 0..holes {
        let a = TAU * (k as f64 + 0.17) / holes as f64;
        let mid = 0.5 * (bore + r - 1.2 * m);
        let size = (0.32 * (r - 1.2 * m - bore)).min(0.75 * mid * maths::sin(PI / holes as f64));
        cut.push(
            circle(16, size).into_iter().map(|[x, y]| [x + mid * maths::cos(a), y + mid * maths::sin(a)]).collect(),
        );
    }
    extrude_with_holes(&toothed(teeth, m), &cut, thick)
}

/// Metal, sometimes painted.
pub(super) fn metal(d: &mut Stream) -> Stuff {
    *d.pick(&[Stuff::Metal, Stuff::Metal, Stuff::Metal, Stuff::PaintedMetal, Stuff::Plastic])
}

fn gear(d: &mut Stream) -> FormVariant {
    let (teeth, m) = (10 + d.below(22), d.range(0.002, 0.006));
    let r = 0.5 * m * teeth as f64;
    let (thick, bore) = (r * d.range(0.2, 0.6), r * d.range(0.15, 0.3));
    let holes = if teeth > 17 { 3 + d.below(4) } else { 0 };
    let stuff = metal(d);
    let mut made = Maker::default();
    made.add(stuff, wheel(teeth, m, thick, bore, holes).turned_x(-0.5 * PI));
    made.add(
        stuff,
        lathe_loop(
            &[[bore, -0.7 * thick], [1.5 * bore, -0.7 * thick], [1.5 * bore, 0.7 * thick], [bore, 0.7 * thick]],
            24,
        ),
    );
    made.made()
}

/// Two or three gears in mesh on a plate.
fn train(d: &mut Stream) -> FormVariant {
    let m = d.range(0.003, 0.005);
    let thick = 0.012;
    let mut made = Maker::default();
    let mut x = 0.0;
    let mut before = 0usize;
    let mut low = 0.0;
    let mut widest = 0.0f64;
    let count = 2 + d.below(2);
    for k in 0..count {
        let teeth = 12 + 2 * d.below(9);
        let r = 0.5 * m * teeth as f64;
        if k > 0 {
            x += 0.5 * m * (before + teeth) as f64;
        } else {
            low = -r;
        }
        widest = widest.max(r);
        // A tooth of one meets a gap of the other; all have even numbers of teeth.
        let turn = if k % 2 == 1 { PI / teeth as f64 } else { 0.0 };
        let body = wheel(teeth, m, thick, 0.006, if teeth > 20 { 4 } else { 0 }).turned_z(turn);
        made.another(Stuff::Metal, body.turned_x(-0.5 * PI).at([x, 0.022, 0.0]));
        made.add(Stuff::Metal, rod([x, 0.006, 0.0], [x, 0.04, 0.0], 0.0058, 16));
        made.add(
            Stuff::Metal,
            lathe(&[[0.0, 0.006], [0.013, 0.006], [0.013, 0.0155], [0.0, 0.0155]], 20).at([x, 0.0, 0.0]),
        );
        before = teeth;
        if k + 1 == count {
            let plate = [0.5 * (x + r - low) + 0.01, widest + 0.01];
            let at = 0.5 * (x + r + low);
            made.add(
                Stuff::PaintedMetal,
                extrude(&rounded_rect(plate, 0.012, 4), 0.006).turned_x(-0.5 * PI).at([at, 0.003, 0.0]),
            );
        }
    }
    made.made()
}

fn flange(d: &mut Stream) -> FormVariant {
    let (r, bore, thick) = (d.range(0.05, 0.1), d.range(0.4, 0.55), d.range(0.012, 0.02));
    let bolts = 4 + 2 * d.below(3);
    let bore = bore * r;
    let stuff = metal(d);
    let mut m = Maker::default();
    let mut cut = vec![circle(36, bore)];
    let ring = 0.5 * (r + bore * 1.25);
    for k in 0..bolts {
        let a = TAU * k as f64 / bolts as f64;
        cut.push(
            circle(14, 0.075 * r)
                .into_iter()
                .map(|[x, y]| [x + ring * maths::cos(a), y + ring * maths::sin(a)])
                .collect(),
        );
    }
    m.add(stuff, extrude_with_holes(&circle(56, r), &cut, thick).turned_x(-0.5 * PI).at([0.0, 0.5 * thick, 0.0]));
    let h = r * d.range(0.4, 1.0);
    m.add(
        stuff,
        lathe_loop(
            &[
                [bore, thick * 0.2],
                [1.28 * bore, thick * 0.2],
                [1.28 * bore, thick + 0.01],
                [1.15 * bore, thick + 0.02],
                [1.15 * bore, thick + h],
                [bore, thick + h],
            ],
            40,
        ),
    );
    for k in 0..bolts {
        if d.chance(0.6) {
            let a = TAU * k as f64 / bolts as f64;
            let at = [ring * maths::cos(a), thick, -ring * maths::sin(a)];
            m.add(
                Stuff::Metal,
                extrude(&circle(6, 0.12 * r), 0.08 * r).turned_x(-0.5 * PI).at([at[0], thick + 0.04 * r, at[2]]),
            );
        }
    }
    m.made()
}

fn bearing(d: &mut Stream) -> FormVariant {
    let (r, wide) = (d.range(0.02, 0.06), d.range(0.25, 0.4));
    let (bore, w) = (r * d.range(0.4, 0.55), wide * r);
    let mid = 0.5 * (r + bore);
    let ball_r = 0.3 * (r - bore);
    let mut m = Maker::default();
    let h = 0.5 * w;
    // Rings with a groove that the balls run in.
    let groove = |from: f64, to: f64, x: f64, n: usize| arc([mid, 0.0], x, from, to, n);
    let g = ball_r * 1.04;
    let a = 0.55;
    let outer: Vec<[f64; 2]> = [[r, -h], [r, h], [mid + 0.62 * ball_r, h]]
        .into_iter()
        .chain(groove(a, -a, g, 8))
        .chain([[mid + 0.62 * ball_r, -h]])
        .collect();
    let inner: Vec<[f64; 2]> = [[bore, h], [bore, -h], [mid - 0.62 * ball_r, -h]]
        .into_iter()
        .chain(groove(PI + a, PI - a, g, 8))
        .chain([[mid - 0.62 * ball_r, h]])
        .collect();
    m.add(Stuff::Metal, lathe_loop(&outer, 48).at([0.0, h, 0.0]));
    m.add(Stuff::Metal, lathe_loop(&inner, 48).at([0.0, h, 0.0]));
    let count = (TAU * mid / (2.35 * ball_r)) as usize;
    for k in 0..count {
        let a = TAU * k as f64 / count as f64;
        m.another_of(Stuff::Metal, k == 0, ball(ball_r, 14).at([mid * maths::sin(a), h, mid * maths::cos(a)]));
    }
    m.made()
}

fn bolt(d: &mut Stream) -> FormVariant {
    let r = d.range(0.003, 0.01);
    let l = r * d.range(5.0, 12.0);
    let (pitch, head) = (0.45 * r, 1.3 * r);
    let mut m = Maker::default();
    let rows = ((0.75 * l) / pitch) as usize;
    // A thread: the ring's radius follows the turn.
    let n = 16;
    let steps = rows * 8;
    let rings: Vec<Vec<Vec3>> = (0..=steps)
        .map(|j| {
            let y = pitch * j as f64 / 8.0;
            (0..n)
                .map(|i| {
                    let t = i as f64 / n as f64;
                    let phase = y / pitch - t;
                    let saw = 2.0 * (phase - phase.floor() - 0.5).abs();
                    let k = r * (0.86 + 0.14 * (2.0 * saw - 0.5).clamp(0.0, 1.0));
                    [k * maths::sin(TAU * t), y, k * maths::cos(TAU * t)]
                })
                .collect()
        })
        .collect();
    let lie = d.chance(0.5);
    let place = |b: Body| {
        if lie {
            b.turned_z(0.5 * PI)
        } else {
            b.mapped(&[[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0]])
        }
    };
    m.add(Stuff::Metal, place(skin(&rings, [true, false], [true, true])));
    let top = pitch * rows as f64;
    m.add(Stuff::Metal, place(rod([0.0, top - 0.2 * r, 0.0], [0.0, l, 0.0], r, 20)));
    m.add(
        Stuff::Metal,
        place(extrude(&circle(6, 1.9 * r), head).turned_x(-0.5 * PI).at([0.0, l + 0.5 * head - 0.001, 0.0])),
    );
    if d.chance(0.5) {
        let at = top * d.range(0.3, 0.7);
        m.add(
            Stuff::Metal,
            place(
                extrude_with_holes(&circle(6, 1.9 * r), &[circle(16, 0.95 * r)], 1.5 * r)
                    .turned_x(-0.5 * PI)
                    .at([0.0, at, 0.0]),
            ),
        );
    }
    m.made()
}

fn spring(d: &mut Stream) -> FormVariant {
    let (r, wire, turns) = (d.range(0.01, 0.04), d.range(0.08, 0.16), d.range(5.0, 10.0));
    let wire = wire * r;
    let pitch = wire * d.range(2.6, 4.5);
    let n = (turns * 20.0) as usize;
    let path: Vec<Vec3> = (0..=n)
        .map(|k| {
            let t = turns * k as f64 / n as f64;
            // The last turn at each end lies flat.
            let rise = (t - 1.0).clamp(0.0, turns - 2.0) + 0.55 * t.min(1.0) + 0.55 * (t - turns + 1.0).max(0.0);
            [r * maths::sin(TAU * t), pitch * rise, r * maths::cos(TAU * t)]
        })
        .collect();
    let mut m = Maker::default();
    m.add(Stuff::Metal, tube(&path, 10, |_| wire));
    m.made()
}

fn crank(d: &mut Stream) -> FormVariant {
    let (throws, r, s) = (2 + d.below(3), d.range(0.02, 0.03), d.range(0.03, 0.045));
    let (web, journal) = (0.016, 0.04);
    let mut m = Maker::default();
    let mut x = 0.0;
    let turn_of = |k: usize| if throws == 3 { TAU * k as f64 / 3.0 } else { PI * k as f64 };
    m.add(Stuff::Metal, rod([x - journal, 0.0, 0.0], [x, 0.0, 0.0], r, 28));
    for k in 0..throws {
        let turn = turn_of(k);
        let pin = [s * maths::cos(turn), s * maths::sin(turn)];
        for side in 0..2 {
            let shape: Vec<[f64; 2]> = arc([0.0, s], 1.2 * r, -0.1, PI + 0.1, 12)
                .into_iter()
                .chain(arc([0.0, 0.0], 2.1 * r, PI + 0.35, TAU - 0.35, 14))
                .collect();
            let plate = extrude(&shape, web).turned_y(0.5 * PI);
            m.add(Stuff::Metal, plate.turned_x(0.5 * PI - turn).at([x + 0.5 * web, 0.0, 0.0]));
            x += web;
            if side == 0 {
                m.add(
                    Stuff::Metal,
                    rod([x - 0.002, pin[1], pin[0]], [x + journal + 0.002, pin[1], pin[0]], 0.85 * r, 24),
                );
                x += journal;
            }
        }
        m.add(Stuff::Metal, rod([x - 0.001, 0.0, 0.0], [x + journal, 0.0, 0.0], r, 28));
        x += journal;
    }
    m.made()
}

fn pulley(d: &mut Stream) -> FormVariant {
    let (r, w) = (d.range(0.04, 0.09), d.range(0.02, 0.04));
    let bore = 0.16 * r;
    let depth = 0.35 * w;
    let grooves = 1 + d.below(3);
    let mut m = Maker::default();
    let step = w / grooves as f64;
    let mut profile = vec![[bore, -0.5 * w], [r, -0.5 * w]];
    for k in 0..grooves {
        let y = -0.5 * w + step * k as f64;
        profile.extend([
            [r, y + 0.15 * step],
            [r - depth, y + 0.4 * step],
            [r - depth, y + 0.6 * step],
            [r, y + 0.85 * step],
        ]);
    }
    profile.extend([
        [r, 0.5 * w],
        [0.75 * r, 0.5 * w],
        [0.72 * r, 0.25 * w],
        [0.4 * r, 0.25 * w],
        [0.38 * r, 0.6 * w],
        [bore, 0.6 * w],
    ]);
    m.add(*d.pick(&[Stuff::Metal, Stuff::PaintedMetal]), lathe_loop(&profile, 48));
    m.made()
}

fn chain(d: &mut Stream) -> FormVariant {
    let (count, r) = (6 + d.below(8), d.range(0.003, 0.007));
    let (l, w) = (3.4 * r, 1.7 * r);
    let bend = d.range(-0.15, 0.15);
    let mut m = Maker::default();
    let link: Vec<Vec3> = arc([l - w, 0.0], w, -0.5 * PI, 0.5 * PI, 8)
        .into_iter()
        .chain(arc([w - l, 0.0], w, 0.5 * PI, 1.5 * PI, 8))
        .map(|[x, y]| [x, y, 0.0])
        .collect();
    let (mut p, mut a) = ([0.0, 0.0], 0.0);
    let pitch = 2.0 * (l - r);
    for k in 0..count {
        a += bend * (1.0 + 0.4 * d.normal());
        p = [p[0] + pitch * maths::cos(a), p[1] + pitch * maths::sin(a)];
        let tilt = if k % 2 == 0 { 0.25 * PI } else { -0.25 * PI };
        m.add(Stuff::Metal, tube_loop(&link, 8, r).turned_x(tilt).turned_y(-a).at([p[0], 0.0, p[1]]));
    }
    m.made()
}
