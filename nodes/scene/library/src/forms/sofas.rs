//! Sofas, armchairs, ottomans; cushions.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("sofa_block", Family::Sofa, 8, sofa),
    form("armchair_block", Family::Sofa, 8, armchair),
    form("armchair_frame", Family::Sofa, 8, frame),
    form("ottoman", Family::Sofa, 6, ottoman),
    form("cushion_square", Family::Cushion, 8, square),
    form("cushion_bolster", Family::Cushion, 6, bolster),
    form("pillow_bed", Family::Cushion, 6, pillow),
    form("pouf_round", Family::Cushion, 6, pouf),
];

/// A stuffed cushion lying flat: fuller in the middle, pinched at the seam, creased a little.
pub(super) fn stuffed(d: &mut Stream, half: [f64; 2], thick: f64) -> Body {
    let (fold, phase) = (d.range(0.0, 0.12), d.range(0.0, TAU));
    let n = 14;
    let face = |s: f64, t: f64, side: f64| {
        let (x, z) = (2.0 * s - 1.0, 2.0 * t - 1.0);
        let full = maths::pow(((1.0 - x * x) * (1.0 - z * z)).max(0.0), 0.4);
        // The sides draw in between the corners.
        let (px, pz) = (x * (1.0 - 0.07 * (1.0 - z * z)), z * (1.0 - 0.07 * (1.0 - x * x)));
        let wrinkle = 1.0 + fold * maths::sin(5.0 * x + 3.0 * z + phase) * full;
        [half[0] * px, side * 0.5 * thick * full * wrinkle, half[1] * pz]
    };
    sheet(n, n, |s, t| face(s, 1.0 - t, 1.0)).with(sheet(n, n, |s, t| face(s, t, -1.0)))
}

fn upholstered(d: &mut Stream, width: f64, seats: usize) -> FormVariant {
    let cover = *d.pick(&[Stuff::Fabric, Stuff::Fabric, Stuff::Leather]);
    let (depth, seat, height) = (d.range(0.8, 0.95), d.range(0.38, 0.46), d.range(0.7, 0.95));
    let (arm, arm_height, back) = (d.range(0.1, 0.22), d.range(0.54, 0.66), d.range(0.14, 0.22));
    let foot = d.range(0.05, 0.14);
    let (hw, hd) = (0.5 * width, 0.5 * depth);
    let cushion = 0.15;
    let base = seat - cushion;
    let mut m = Maker::default();
    let body = |low: [f64; 3], high: [f64; 3], r: f64| {
        let center = [0, 1, 2].map(|i| 0.5 * (low[i] + high[i]));
        soft_block(center, [0, 1, 2].map(|i| 0.5 * (high[i] - low[i])), r, 3)
    };
    m.add(cover, body([-hw + arm, foot, -hd + back], [hw - arm, base, hd - 0.01], 0.02));
    m.add(cover, body([-hw, foot, -hd], [hw, height, -hd + back], d.range(0.03, 0.07)));
    let r = d.range(0.02, 0.08).min(0.45 * arm);
    m.add(cover, body([-hw, foot, -hd + back], [-hw + arm, arm_height, hd], r));
    m.add(cover, body([hw - arm, foot, -hd + back], [hw, arm_height, hd], r));
    let each = (width - 2.0 * arm) / seats as f64;
    for k in 0..seats {
        let low = -hw + arm + each * k as f64 + 0.004;
        m.add(cover, body([low, base, -hd + back], [low + each - 0.008, seat, hd], 0.045));
        let x = low + 0.5 * each;
        m.top([x, seat, 0.5 * back + 0.08], [0.5 * each - 0.08, hd - 0.5 * back - 0.16], 0.4);
        let pillow = body([low, seat + 0.005, 0.0], [low + each - 0.008, seat + 0.42, 0.16], 0.06);
        m.add(cover, pillow.at([0.0, 0.0, -seat]).turned_x(-0.2).at([0.0, 0.05, seat + 0.06 - hd + back - 0.02]));
    }
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let [x, z] = [sx * (hw - 0.07), sz * (hd - 0.07)];
        m.add(Stuff::Wood, tube(&[[x, 0.0, z], [x, foot, z]], 10, |t| 0.016 + 0.012 * t));
    }
    m.made()
}

/// A sofa for two or three.
fn sofa(d: &mut Stream) -> FormVariant {
    let seats = 2 + d.below(2);
    let width = d.range(0.62, 0.75) * seats as f64 + 0.35;
    upholstered(d, width, seats)
}

/// The same for one.
fn armchair(d: &mut Stream) -> FormVariant {
    let width = d.range(0.8, 0.98);
    upholstered(d, width, 1)
}

/// Cushions in an open wooden frame.
fn frame(d: &mut Stream) -> FormVariant {
    let (w, seat, height) = (d.range(0.3, 0.35), d.range(0.36, 0.42), d.range(0.75, 0.95));
    let cover = *d.pick(&[Stuff::Fabric, Stuff::Leather]);
    let mut m = Maker::default();
    let tilt = d.range(0.05, 0.12);
    for s in [-1.0, 1.0] {
        let x = s * (w + 0.02);
        m.add(Stuff::Wood, beam([x, 0.0, 0.33], [x, 0.56, 0.3], [0.03, 0.028], [0.0, 0.0, 1.0]));
        m.add(Stuff::Wood, beam([x, 0.0, -0.36], [x, 0.54, -0.28], [0.03, 0.028], [0.0, 0.0, 1.0]));
        m.add(Stuff::Wood, board([x, 0.565, 0.0], [0.028, 0.012, 0.36]));
        m.add(Stuff::Wood, beam([x, seat - 0.13, 0.32], [x, seat - 0.13 - tilt, -0.32], [0.05, 0.02], [0.0, 1.0, 0.0]));
        m.add(
            Stuff::Wood,
            beam([x - 0.03 * s, seat - 0.15, -0.24], [x - 0.03 * s, height, -0.42], [0.04, 0.02], [0.0, 0.0, 1.0]),
        );
    }
    m.add(Stuff::Wood, board([0.0, seat - 0.14, 0.31], [w + 0.005, 0.025, 0.012]));
    m.add(Stuff::Wood, board([0.0, height - 0.04, -0.41], [w - 0.025, 0.03, 0.01]));
    m.add(
        cover,
        soft_block([0.0, 0.0, 0.0], [w - 0.005, 0.065, 0.3], 0.04, 3).turned_x(0.5 * tilt).at([
            0.0,
            seat - 0.055,
            0.03,
        ]),
    );
    let back = 0.5 * (height - seat) + 0.05;
    m.add(
        cover,
        soft_block([0.0, back, 0.0], [w - 0.035, back, 0.055], 0.04, 3).turned_x(-0.3).at([0.0, seat - 0.02, -0.17]),
    );
    m.made()
}

/// A low box to put feet on.
fn ottoman(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.25, 0.55), d.range(0.16, 0.2), d.range(0.22, 0.3)];
    let cover = *d.pick(&[Stuff::Fabric, Stuff::Leather]);
    let foot = d.range(0.03, 0.12);
    let mut m = Maker::default();
    let y = foot + half[1];
    m.add(cover, soft_block([0.0, y, 0.0], half, d.range(0.02, 0.05), 3));
    m.top([0.0, foot + 2.0 * half[1], 0.0], [half[0] - 0.06, half[2] - 0.06], f64::INFINITY);
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let [x, z] = [sx * (half[0] - 0.06), sz * (half[2] - 0.06)];
        m.add(Stuff::Wood, tube(&[[x, 0.0, z], [x, foot, z]], 10, |t| 0.015 + 0.01 * t));
    }
    m.made()
}

fn square(d: &mut Stream) -> FormVariant {
    let (x, z, thick) = (d.range(0.18, 0.26), d.range(0.16, 0.24), d.range(0.1, 0.17));
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Fabric, Stuff::Fabric, Stuff::Leather]);
    m.add(stuff, stuffed(d, [x, z], thick));
    m.made()
}

fn bolster(d: &mut Stream) -> FormVariant {
    let (r, l, pinch) = (d.range(0.07, 0.12), d.range(0.2, 0.45), d.range(0.3, 0.8));
    let profile = [
        [0.0, -l],
        [0.3 * r, -l + 0.01],
        [r * 0.9, -l + 0.015 * pinch],
        [r, -l + 0.04],
        [r * 1.03, 0.0],
        [r, l - 0.04],
        [r * 0.9, l - 0.015 * pinch],
        [0.3 * r, l - 0.01],
        [0.0, l],
    ];
    let mut m = Maker::default();
    m.add(Stuff::Fabric, lathe(&profile, 28).smooth().turned_z(0.5 * PI));
    for s in [-1.0, 1.0] {
        m.add(Stuff::Fabric, ball(0.018, 10).at([s * (l + 0.004), 0.0, 0.0]));
    }
    m.made()
}

fn pillow(d: &mut Stream) -> FormVariant {
    let (x, z, thick) = (d.range(0.3, 0.4), d.range(0.2, 0.25), d.range(0.14, 0.2));
    let mut m = Maker::default();
    m.add(Stuff::Fabric, stuffed(d, [x, z], thick));
    m.made()
}

/// A round seat cushion, ribbed.
fn pouf(d: &mut Stream) -> FormVariant {
    let (r, h, ribs) = (d.range(0.22, 0.32), d.range(0.28, 0.4), 8 + d.below(8));
    let depth = d.range(0.02, 0.06);
    let n = ribs * 6;
    let rings: Vec<Vec<_>> = (0..=16)
        .map(|j| {
            let t = f64::from(j) / 16.0;
            let a = PI * (t - 0.5);
            let k = maths::pow(maths::cos(a).max(0.0), 0.45);
            let y = h * (0.5 + 0.5 * if a < 0.0 { -1.0 } else { 1.0 } * maths::pow(maths::sin(a).abs(), 0.7));
            (0..n)
                .map(|i| {
                    let b = TAU * i as f64 / n as f64;
                    let bulge = 1.0 - depth * (1.0 - maths::sin(0.5 * ribs as f64 * b).abs());
                    let rr = if j == 0 || j == 16 { 0.0 } else { r * k * bulge };
                    [rr * maths::sin(b), y, rr * maths::cos(b)]
                })
                .collect()
        })
        .collect();
    let mut m = Maker::default();
    m.add(*d.pick(&[Stuff::Leather, Stuff::Fabric]), skin(&rings, [true, false], [false; 2]).smooth());
    m.made()
}
