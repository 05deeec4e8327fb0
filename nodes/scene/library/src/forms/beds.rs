//! Beds.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
    sofas::stuffed,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("bed_frame", Family::Bed, 8, bed),
    form("bed_iron", Family::Bed, 6, iron),
    form("bed_bunk", Family::Bed, 4, bunk),
];

fn mattress(m: &mut Maker, d: &mut Stream, half: [f64; 2], low: f64) {
    m.add(Stuff::Fabric, soft_block([0.0, low + 0.09, 0.0], [half[0], 0.09, half[1]], 0.04, 3));
    // A blanket over its lower part, a little larger than it.
    let (end, high) = (half[1] * d.range(0.1, 0.45), low + 0.195);
    let wave = d.range(0.004, 0.012);
    let drop = d.range(0.1, 0.16);
    let blanket = slab(24, 18, 0.012, |s, t| {
        let x = (2.0 * s - 1.0) * (half[0] + drop + 0.02);
        let z = half[1] + 0.012 - (half[1] + 0.012 + end) * t;
        let over = (x.abs() - half[0]).max(0.0);
        let side = if x < 0.0 { -1.0 } else { 1.0 };
        let ripple = wave * maths::sin(17.0 * z + 3.0 * x) * maths::cos(5.0 * x - 4.0 * z);
        if over > 0.0 { [side * (half[0] + 0.016 + ripple * 0.5), high - over, z] } else { [x, high + ripple.abs(), z] }
    });
    m.another(Stuff::Fabric, blanket);
    let count = if half[0] > 0.6 { 2 } else { 1 };
    for k in 0..count {
        let x = if count == 2 { half[0] * (k as f64 - 0.5) } else { 0.0 };
        let w = (0.9 * half[0] / count as f64).min(0.36);
        let turn = d.range(-0.15, 0.15);
        m.another(
            Stuff::Fabric,
            stuffed(d, [w, 0.21], 0.15).turned_y(turn).at([x, low + 0.18 + 0.07, -half[1] + 0.26]),
        );
    }
}

fn bed(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.45, 0.9), 1.0];
    let (frame, head) = (d.range(0.22, 0.32), d.range(0.7, 1.1));
    let mut m = Maker::default();
    let t = 0.014;
    for s in [-1.0, 1.0] {
        m.add(Stuff::Wood, board([s * (half[0] + t), frame - 0.07, 0.0], [t, 0.09, half[1]]));
    }
    m.add(Stuff::Wood, board([0.0, frame - 0.07, half[1] + t], [half[0] + 2.0 * t, 0.09, t]));
    m.add(Stuff::Wood, board([0.0, frame - 0.045, 0.0], [half[0], 0.01, half[1]]));
    for (sx, sz) in [(-1.0, 1.0), (1.0, 1.0)] {
        m.add(
            Stuff::Wood,
            board(
                [sx * (half[0] - 0.02), 0.5 * (frame - 0.055), sz * (half[1] - 0.03)],
                [0.03, 0.5 * (frame - 0.055), 0.03],
            ),
        );
    }
    if d.chance(0.5) {
        m.add(
            Stuff::Fabric,
            soft_block([0.0, 0.5 * head, -half[1] - 0.04], [half[0] + 0.03, 0.5 * head, 0.04], 0.03, 3),
        );
    } else {
        m.add(Stuff::Wood, board([0.0, head - 0.03, -half[1] - 0.02], [half[0] + 0.03, 0.03, 0.02]));
        for s in [-1.0, 1.0] {
            m.add(
                Stuff::Wood,
                board([s * half[0], 0.5 * (head - 0.06), -half[1] - 0.02], [0.03, 0.5 * (head - 0.06), 0.02]),
            );
        }
        let slats = 5 + d.below(6);
        for k in 0..slats {
            let x = (half[0] - 0.1) * (2.0 * (k as f64 + 0.5) / slats as f64 - 1.0);
            m.add(
                Stuff::Wood,
                board([x, 0.5 * (head - 0.06 + frame), -half[1] - 0.02], [0.02, 0.5 * (head - 0.06 - frame), 0.008]),
            );
        }
        m.add(Stuff::Wood, board([0.0, frame, -half[1] - 0.02], [half[0] - 0.03, 0.03, 0.012]));
    }
    mattress(&mut m, d, half, frame - 0.035);
    m.made()
}

fn iron(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.45, 0.75), 0.98];
    let frame = d.range(0.3, 0.38);
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Metal]);
    for (z, height) in [(-half[1] - 0.03, d.range(0.95, 1.2)), (half[1] + 0.03, d.range(0.6, 0.75))] {
        let w = half[0] + 0.01;
        let arch = d.range(0.03, 0.15);
        let bow = |x: f64| height - 0.1 + arch * (1.0 - x * x);
        let path: Vec<_> = (0..=16).map(|k| f64::from(k) / 8.0 - 1.0).map(|x| [x * w, bow(x), z]).collect();
        m.add(stuff, tube(&path, 8, |_| 0.013));
        for s in [-1.0, 1.0] {
            m.add(stuff, rod([s * w, 0.0, z], [s * w, height - 0.07, z], 0.018, 10));
            m.add(stuff, ball(0.03, 12).at([s * w, height - 0.05, z]));
        }
        m.add(stuff, rod([-w, frame, z], [w, frame, z], 0.012, 8));
        let bars = 6 + d.below(4);
        for k in 1..bars {
            let x = 2.0 * k as f64 / bars as f64 - 1.0;
            m.add(stuff, rod([x * w, frame, z], [x * w, bow(x), z], 0.006, 6));
        }
    }
    for s in [-1.0, 1.0] {
        m.add(stuff, board([s * half[0], frame, 0.0], [0.012, 0.02, half[1] + 0.02]));
    }
    m.add(stuff, board([0.0, frame, 0.0], [half[0] - 0.012, 0.006, half[1]]));
    mattress(&mut m, d, half, frame + 0.008);
    m.made()
}

fn bunk(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.42, 0.48), 0.98];
    let (low, high, height) = (d.range(0.28, 0.36), d.range(1.25, 1.4), d.range(1.7, 1.85));
    let mut m = Maker::default();
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        m.add(
            Stuff::Wood,
            board([sx * (half[0] + 0.035), 0.5 * height, sz * (half[1] + 0.03)], [0.035, 0.5 * height, 0.03]),
        );
    }
    for y in [low, high] {
        for s in [-1.0, 1.0] {
            m.add(Stuff::Wood, board([s * (half[0] + 0.035), y, 0.0], [0.014, 0.07, half[1]]));
            m.add(Stuff::Wood, board([0.0, y + 0.1, s * (half[1] + 0.03)], [half[0], 0.17, 0.012]));
        }
        m.add(Stuff::Wood, board([0.0, y - 0.03, 0.0], [half[0] + 0.02, 0.01, half[1]]));
        mattress(&mut m, d, half, y - 0.02);
    }
    for s in [-1.0, 1.0] {
        m.add(Stuff::Wood, board([s * (half[0] + 0.035), height - 0.1, 0.0], [0.012, 0.05, half[1]]));
    }
    let x = half[0] + 0.085;
    for z in [0.35, 0.7] {
        m.add(Stuff::Wood, board([x, 0.5 * height, z], [0.012, 0.5 * height, 0.025]));
    }
    for k in 0..5 {
        m.add(Stuff::Wood, rod([x, 0.25 + 0.27 * f64::from(k), 0.35], [x, 0.25 + 0.27 * f64::from(k), 0.7], 0.013, 8));
    }
    m.made()
}
