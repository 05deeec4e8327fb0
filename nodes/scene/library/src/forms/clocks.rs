//! Clocks.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("clock_wall", Family::Clock, 8, clock_wall),
    form("clock_alarm", Family::Clock, 8, clock_alarm),
    form("clock_long_case", Family::Clock, 6, clock_case),
];

/// A dial in the plane z = `z` with marks and two hands.
fn dial(m: &mut Maker, d: &mut Stream, center: [f64; 2], r: f64, z: f64) {
    let [x, y] = center;
    m.add(Stuff::Paper, extrude(&circle(40, r), 0.001).at([x, y, z + 0.0005]));
    let marks = Body::all((0..12).map(|k| {
        let a = TAU * f64::from(k) / 12.0;
        let big = if k % 3 == 0 { 1.7 } else { 1.0 };
        panel([0.0, 0.86 * r, 0.0], [0.011 * r * big, 0.06 * r * big, 0.0006]).turned_z(-a).at([x, y, z + 0.0016])
    }));
    m.add(Stuff::Plastic, marks);
    let time = d.range(0.0, 12.0);
    for (turns, long, wide, lift) in [(time / 12.0, 0.52, 0.03, 0.003), (time, 0.78, 0.02, 0.0045)] {
        let hand = panel([0.0, 0.5 * long * r - 0.06 * r, 0.0], [wide * r, 0.5 * long * r + 0.06 * r, 0.0005]);
        m.add(Stuff::Plastic, hand.turned_z(-TAU * turns).at([x, y, z + lift]));
    }
    m.add(Stuff::Metal, rod([x, y, z], [x, y, z + 0.0065], 0.04 * r, 10));
}

fn clock_wall(d: &mut Stream) -> FormVariant {
    let r = d.range(0.11, 0.2);
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Metal, Stuff::Plastic, Stuff::PaintedMetal]);
    let rim = d.range(0.08, 0.16) * r;
    let t = 0.025;
    let profile = [
        [0.0, 0.0],
        [r + rim, 0.0],
        [r + rim, 0.6 * t],
        [r + 0.6 * rim, t + 0.008],
        [r, t + 0.006],
        [r - 0.002, 0.3 * t],
        [0.0, 0.3 * t],
    ];
    m.add(stuff, lathe(&profile, 48).turned_x(0.5 * PI).at([0.0, r + rim, 0.0]));
    dial(&mut m, d, [0.0, r + rim], r - 0.003, 0.3 * t + 0.0002);
    m.made()
}

fn clock_alarm(d: &mut Stream) -> FormVariant {
    let r = d.range(0.035, 0.055);
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Metal, Stuff::Plastic]);
    let y = r + 0.018;
    let t = 0.8 * r;
    let profile = [
        [0.0, -t],
        [0.8 * r, -t],
        [r, -0.75 * t],
        [r, 0.0],
        [1.04 * r, 0.002],
        [1.04 * r, 0.006],
        [0.92 * r, 0.008],
        [0.91 * r, 0.0],
        [0.0, 0.0],
    ];
    m.add(stuff, lathe(&profile, 40).turned_x(0.5 * PI).at([0.0, y, 0.0]));
    dial(&mut m, d, [0.0, y], 0.9 * r, 0.0002);
    for s in [-1.0, 1.0] {
        let foot = [s * 0.55 * r, 0.0, -0.4 * t];
        m.add(Stuff::Metal, tube(&[foot, [s * 0.4 * r, 0.35 * y, -0.4 * t]], 8, |_| 0.004));
        let (sn, cs) = (maths::sin(s * 0.55), maths::cos(0.55));
        let bell =
            lathe(&[[0.0, -0.002], [0.42 * r, -0.002], [0.42 * r, 0.0], [0.3 * r, 0.2 * r], [0.0, 0.28 * r]], 24)
                .soft();
        m.add(Stuff::Metal, bell.turned_z(-s * 0.55).at([1.12 * r * sn, y + 1.12 * r * cs, -0.4 * t]));
        m.add(
            Stuff::Metal,
            rod([0.95 * r * sn, y + 0.95 * r * cs, -0.4 * t], [1.13 * r * sn, y + 1.13 * r * cs, -0.4 * t], 0.0025, 6),
        );
    }
    m.add(Stuff::Metal, rod([0.0, y + r - 0.002, -0.4 * t], [0.0, y + 1.35 * r, -0.4 * t], 0.0018, 6));
    m.made()
}

fn clock_case(d: &mut Stream) -> FormVariant {
    let h = d.range(1.8, 2.2);
    let (w, deep) = (d.range(0.18, 0.27), d.range(0.11, 0.15));
    let mut m = Maker::default();
    let foot = 0.24 * h;
    m.add(Stuff::Wood, board([0.0, 0.03, 0.0], [w + 0.03, 0.03, deep + 0.02]));
    m.add(Stuff::Wood, board([0.0, 0.5 * foot + 0.03, 0.0], [w, 0.5 * foot - 0.03, deep]));
    m.add(Stuff::Wood, board([0.0, foot + 0.015, 0.0], [w + 0.01, 0.015, deep + 0.01]));
    let (waist, top) = (0.78 * w, 0.75 * h);
    // The trunk is open in front, with the pendulum behind a pane.
    for s in [-1.0, 1.0] {
        m.add(
            Stuff::Wood,
            board(
                [s * (waist - 0.015), 0.5 * (foot + 0.03 + top), 0.0],
                [0.015, 0.5 * (top - foot - 0.03), deep - 0.02],
            ),
        );
    }
    m.add(
        Stuff::Wood,
        board([0.0, 0.5 * (foot + 0.03 + top), -deep + 0.03], [waist - 0.03, 0.5 * (top - foot - 0.03), 0.008]),
    );
    m.add(
        Stuff::Pane,
        sheet(1, 1, |s, t| [(waist - 0.03) * (2.0 * s - 1.0), foot + 0.03 + (top - foot - 0.03) * t, deep - 0.04]),
    );
    let swing = d.range(-0.06, 0.06);
    m.add(Stuff::Metal, rod([0.0, top, 0.0], [swing, foot + 0.25, 0.0], 0.003, 6));
    m.add(
        Stuff::Metal,
        lathe(&[[0.0, -0.008], [0.05, -0.006], [0.06, 0.0], [0.05, 0.006], [0.0, 0.008]], 28).turned_x(0.5 * PI).at([
            swing,
            foot + 0.25,
            0.0,
        ]),
    );
    for x in [-0.06, 0.06] {
        let y = foot + d.range(0.35, 0.6);
        m.add(Stuff::Metal, rod([x, y, -0.03], [x, y + 0.16, -0.03], 0.02, 14));
        m.add(Stuff::Metal, rod([x, y + 0.15, -0.03], [x, top, -0.03], 0.0015, 5));
    }
    m.add(Stuff::Wood, board([0.0, top + 0.015, 0.0], [w + 0.01, 0.015, deep + 0.01]));
    let head = h - top - 0.1;
    m.add(Stuff::Wood, board([0.0, top + 0.03 + 0.5 * head, -0.01], [w, 0.5 * head, deep - 0.02]));
    let r = (0.42 * head).min(0.85 * w);
    m.add(
        Stuff::Metal,
        lathe_loop(&[[r, 0.0], [r + 0.012, 0.0], [r + 0.012, 0.006], [r, 0.01]], 40).turned_x(0.5 * PI).at([
            0.0,
            top + 0.03 + 0.5 * head,
            deep - 0.03,
        ]),
    );
    dial(&mut m, d, [0.0, top + 0.03 + 0.5 * head], r, deep - 0.0298);
    let cap: Vec<[f64; 2]> = [[w + 0.03, 0.0]]
        .into_iter()
        .chain((0..=14).map(|k| f64::from(k) / 7.0 - 1.0).map(|a| [-(w + 0.03) * a, 0.02 + 0.06 * (1.0 - a * a)]))
        .chain([[-w - 0.03, 0.0]])
        .collect();
    m.add(Stuff::Wood, extrude(&cap, 2.0 * deep + 0.02).at([0.0, top + 0.03 + head, 0.0]));
    m.made()
}
