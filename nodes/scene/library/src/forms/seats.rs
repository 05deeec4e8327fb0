//! Chairs and stools.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("chair_slats", Family::Chair, 10, slats),
    form("chair_shell", Family::Chair, 10, shell),
    form("chair_office", Family::Chair, 8, office),
    form("chair_folding", Family::Chair, 6, folding),
    form("chair_windsor", Family::Chair, 8, windsor),
    form("stool_round", Family::Chair, 8, stool),
    form("stool_bar", Family::Chair, 6, bar),
];

/// A wooden chair with slats in its back.
fn slats(d: &mut Stream) -> FormVariant {
    let (w, depth, seat) = (d.range(0.2, 0.24), d.range(0.19, 0.22), d.range(0.43, 0.47));
    let (height, leg) = (d.range(0.78, 1.02), d.range(0.016, 0.024));
    let lean = d.range(0.04, 0.1);
    let mut m = Maker::default();
    m.add(Stuff::Wood, board([0.0, seat - 0.012, 0.0], [w, 0.012, depth]));
    m.top([0.0, seat, 0.03], [w - 0.03, depth - 0.06], 0.9);
    for s in [-1.0, 1.0] {
        let x = s * (w - leg);
        m.add(Stuff::Wood, board([x, 0.5 * (seat - 0.024), depth - leg], [leg, 0.5 * (seat - 0.024), leg]));
        // The hind leg is one piece with the back's post, which leans.
        let z = leg - depth;
        let path =
            [[x, 0.0, z - 0.02], [x, seat, z], [x, 0.5 * (seat + height), z - 0.3 * lean], [x, height, z - lean]];
        m.add(Stuff::Wood, sweep(&path, &rounded_rect([leg, leg], 0.3 * leg, 1), [0.0, 0.0, 1.0], |_| 1.0).soft());
        m.add(Stuff::Wood, beam([x, 0.2, z], [x, 0.2, depth - leg], [0.02, 0.016], [0.0, 1.0, 0.0]));
    }
    let upright = d.chance(0.4);
    let z_at = |y: f64| {
        let t = (y - seat) / (height - seat);
        leg - depth - lean * (if t < 0.5 { 0.6 * t } else { 0.3 + 1.4 * (t - 0.5) })
    };
    let count = 2 + d.below(4);
    let top = height - 0.04;
    m.add(Stuff::Wood, board([0.0, top, z_at(top)], [w - leg, 0.035, 0.009]));
    if upright {
        let low = seat + 0.08;
        m.add(Stuff::Wood, board([0.0, low, z_at(low)], [w - leg, 0.02, 0.009]));
        for k in 0..=count {
            let x = (w - 0.06) * (2.0 * k as f64 / count as f64 - 1.0) * 0.85;
            let line: Vec<_> = [low, 0.5 * (low + top), top].iter().map(|y| [x, *y, z_at(*y)]).collect();
            m.add(Stuff::Wood, tube(&line, 6, |_| 0.008));
        }
    } else {
        for k in 0..count {
            let y = seat + 0.12 + (top - seat - 0.2) * k as f64 / count as f64;
            m.add(Stuff::Wood, board([0.0, y, z_at(y)], [w - leg, 0.022, 0.008]));
        }
    }
    m.add(Stuff::Wood, board([0.0, seat - 0.05, depth - leg], [w - 2.0 * leg, 0.025, 0.009]));
    m.made()
}

/// A moulded shell on thin metal or wooden legs.
fn shell(d: &mut Stream) -> FormVariant {
    let (w, seat, height) = (d.range(0.21, 0.25), d.range(0.42, 0.46), d.range(0.76, 0.88));
    let curl = d.range(0.05, 0.12);
    let wide = d.range(0.75, 0.95);
    let spine = spline(
        &[
            [0.0, seat - 0.03, 0.24],
            [0.0, seat, 0.2],
            [0.0, seat - 0.015, 0.02],
            [0.0, seat + 0.04, -0.17],
            [0.0, seat + 0.2, -0.22],
            [0.0, height, -0.27],
        ],
        4,
    );
    let n = spine.len() - 1;
    let mut m = Maker::default();
    let face = slab(12, n, 0.006, |s, t| {
        let p = spine[(t * n as f64).round() as usize];
        let x = 2.0 * s - 1.0;
        let taper = 1.0 - (1.0 - wide) * t - 0.25 * maths::pow((2.0 * t - 1.0).abs(), 6.0);
        // The rim rises beside the seat and comes forward beside the back.
        let rim = curl * x * x * x * x * if t < 0.5 { 2.0 * t } else { 1.0 };
        let forward = ((t - 0.45) / 0.3).clamp(0.0, 1.0);
        [x * w * taper, p[1] + rim * (1.0 - forward), p[2] + rim * forward * 1.3]
    });
    m.add(Stuff::Plastic, face);
    let stuff = *d.pick(&[Stuff::Metal, Stuff::Wood, Stuff::PaintedMetal]);
    let r = if stuff == Stuff::Wood { 0.014 } else { 0.009 };
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let foot = [sx * w * 0.98, 0.0, 0.22 * sz - 0.02];
        let top = [sx * 0.12, seat - 0.03, 0.11 * sz - 0.02];
        m.add(stuff, tube(&[foot, top], 8, |t| r * (0.75 + 0.25 * t)));
    }
    for sz in [-1.0, 1.0] {
        m.add(
            stuff,
            beam(
                [-0.13, seat - 0.03, 0.11 * sz - 0.02],
                [0.13, seat - 0.03, 0.11 * sz - 0.02],
                [0.014, 0.014],
                [0.0, 1.0, 0.0],
            ),
        );
    }
    m.made()
}

/// A round stool on three or four legs.
fn stool(d: &mut Stream) -> FormVariant {
    let (r, height) = (d.range(0.14, 0.19), d.range(0.42, 0.7));
    let legs = 3 + d.below(2);
    let thick = d.range(0.025, 0.045);
    let mut m = Maker::default();
    let soft = d.chance(0.3);
    let edge = 0.3 * thick;
    m.add(
        if soft { Stuff::Leather } else { Stuff::Wood },
        lathe(
            &[
                [0.0, height - thick],
                [r - edge, height - thick],
                [r, height - thick + edge],
                [r, height - edge],
                [r - edge, height],
                [0.0, height],
            ],
            32,
        ),
    );
    m.top([0.0, height, 0.0], [0.68 * r, 0.68 * r], 1.0);
    let splay = d.range(1.0, 1.35);
    for k in 0..legs {
        let a = TAU * (k as f64 + 0.5) / legs as f64;
        let (s, c) = (maths::sin(a), maths::cos(a));
        let (top, foot) = (0.72 * r, 0.85 * r * splay);
        m.add(
            Stuff::Wood,
            tube(&[[foot * s, 0.0, foot * c], [top * s, height - thick, top * c]], 8, |t| 0.013 + 0.006 * t),
        );
        let b = TAU * (k as f64 + 1.5) / legs as f64;
        let y = height * 0.3;
        let at = 0.7 * foot + 0.3 * top;
        m.add(Stuff::Wood, rod([at * s, y, at * c], [at * maths::sin(b), y, at * maths::cos(b)], 0.008, 6));
    }
    m.made()
}

/// A swivel chair on a star of five castors.
fn office(d: &mut Stream) -> FormVariant {
    let (seat, w, height) = (d.range(0.43, 0.5), d.range(0.22, 0.26), d.range(0.85, 1.15));
    let cover = *d.pick(&[Stuff::Fabric, Stuff::Leather]);
    let star = *d.pick(&[Stuff::Plastic, Stuff::Metal]);
    let mut m = Maker::default();
    for k in 0..5 {
        let a = TAU * k as f64 / 5.0;
        let (s, c) = (maths::sin(a), maths::cos(a));
        let end = [0.29 * s, 0.07, 0.29 * c];
        m.add(star, tube(&[[0.0, 0.1, 0.0], end], 6, |t| 0.02 - 0.008 * t));
        let wheel = lathe(&[[0.0, -0.012], [0.026, -0.012], [0.026, 0.012], [0.0, 0.012]], 14);
        for side in [-1.0, 1.0] {
            let wheel = wheel.clone().turned_z(0.5 * PI).turned_y(a).at([
                0.3 * s + 0.018 * side * c,
                0.026,
                0.3 * c - 0.018 * side * s,
            ]);
            m.add(Stuff::Rubber, wheel);
        }
        m.add(star, rod([0.29 * s, 0.026, 0.29 * c], [0.29 * s, 0.075, 0.29 * c], 0.008, 6));
    }
    m.add(star, rod([0.0, 0.07, 0.0], [0.0, 0.24, 0.0], 0.03, 12));
    m.add(Stuff::Metal, rod([0.0, 0.2, 0.0], [0.0, seat - 0.08, 0.0], 0.015, 12));
    m.add(Stuff::Plastic, soft_block([0.0, seat - 0.075, 0.0], [0.12, 0.02, 0.14], 0.015, 2));
    m.add(cover, soft_block([0.0, seat - 0.03, 0.0], [w, 0.03, w], 0.028, 4));
    m.top([0.0, seat, 0.06], [w - 0.06, w - 0.14], 0.6);
    let low = seat + d.range(0.08, 0.16);
    let (curve, wide) = (d.range(0.02, 0.06), d.range(0.8, 1.0));
    let back = slab(10, 10, 0.05, |s, t| {
        let x = 2.0 * s - 1.0;
        let y = low + (height - low) * t;
        let round = 1.0 - 0.12 * maths::pow((2.0 * t - 1.0).abs(), 4.0);
        [-x * w * wide * round, y, -w - 0.05 * t + curve * x * x + 0.03 * maths::sin(PI * t)]
    });
    m.add(cover, back);
    m.add(
        Stuff::Plastic,
        tube(
            &fillet(&[[0.0, seat - 0.08, -0.1], [0.0, seat - 0.08, -w - 0.09], [0.0, low + 0.2, -w - 0.075]], 0.06, 4),
            8,
            |_| 0.018,
        ),
    );
    if d.chance(0.6) {
        let y = seat + d.range(0.18, 0.23);
        for s in [-1.0, 1.0] {
            let x = s * (w + 0.03);
            let line = [[s * 0.1, seat - 0.075, 0.0], [x, seat - 0.07, 0.0], [x, y, 0.02]];
            m.add(Stuff::Plastic, tube(&fillet(&line, 0.04, 4), 8, |_| 0.012));
            m.add(Stuff::Plastic, soft_block([x, y + 0.01, 0.03], [0.035, 0.014, 0.12], 0.013, 2));
        }
    }
    m.made()
}

/// A folding chair of crossed frames.
fn folding(d: &mut Stream) -> FormVariant {
    let (w, seat, height) = (d.range(0.19, 0.22), 0.45, d.range(0.76, 0.84));
    let frame = *d.pick(&[Stuff::Wood, Stuff::PaintedMetal, Stuff::Metal]);
    let size = if frame == Stuff::Wood { [0.034, 0.018] } else { [0.022, 0.012] };
    let reach = d.range(0.2, 0.26);
    let mut m = Maker::default();
    for s in [-1.0, 1.0] {
        m.add(frame, beam([s * w, 0.0, reach], [s * w, height, -reach], size, [0.0, 0.0, 1.0]));
        let x = s * (w - size[1] - 0.002);
        m.add(frame, beam([x, 0.0, -reach], [x, seat - 0.01, reach * 0.85], size, [0.0, 0.0, 1.0]));
    }
    m.add(frame, rod([-w, 0.12, reach * 0.7], [w, 0.12, reach * 0.7], 0.008, 8));
    m.add(frame, rod([-w + 0.02, 0.12, -reach * 0.55], [w - 0.02, 0.12, -reach * 0.55], 0.008, 8));
    let slats = 5 + d.below(5);
    let half = 0.5 * 0.36 / slats as f64;
    for k in 0..slats {
        let z = -0.16 + 0.36 * (k as f64 + 0.5) / slats as f64;
        m.add(Stuff::Wood, board([0.0, seat, z], [w - 0.014, 0.008, half * 0.86]));
    }
    m.top([0.0, seat + 0.008, 0.02], [w - 0.06, 0.13], 0.6);
    let at = |y: f64| reach - 2.0 * reach * y / height;
    for k in 0..2 {
        let y = height - 0.05 - 0.11 * f64::from(k);
        m.add(Stuff::Wood, board([0.0, y, at(y) + 0.012], [w - 0.006, 0.035, 0.006]));
    }
    m.made()
}

/// A Windsor chair: spindles under a bent hoop.
fn windsor(d: &mut Stream) -> FormVariant {
    let (w, seat, height) = (d.range(0.2, 0.23), d.range(0.43, 0.46), d.range(0.85, 1.05));
    let mut m = Maker::default();
    let outline: Vec<[f64; 2]> = circle(28, 1.0)
        .into_iter()
        .map(|[c, s]| [w * c * (1.0 - 0.1 * s), 0.2 * s * if s > 0.0 { 0.95 } else { 1.0 }])
        .collect();
    m.add(Stuff::Wood, extrude(&outline, 0.035).turned_x(0.5 * PI).at([0.0, seat - 0.0175, 0.0]));
    m.top([0.0, seat, 0.0], [0.62 * w, 0.11], 0.5);
    let turned = |y: f64| 0.011 + 0.006 * maths::sin(PI * y) + 0.002 * maths::sin(5.0 * TAU * y);
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let line = line([sx * (w + 0.02), 0.0, sz * 0.21], [sx * 0.13, seat - 0.03, sz * 0.11], 14);
        m.add(Stuff::Wood, tube(&line, 8, turned));
    }
    m.add(Stuff::Wood, rod([-w * 0.9, 0.17, 0.0], [w * 0.9, 0.17, 0.0], 0.008, 6));
    for s in [-1.0, 1.0] {
        m.add(Stuff::Wood, rod([s * w * 0.9, 0.17, -0.175], [s * w * 0.9, 0.17, 0.175], 0.009, 6));
    }
    let lean = d.range(0.08, 0.14);
    let hoop = |t: f64| {
        let a = PI * t;
        let rise = maths::pow(maths::sin(a), 0.55);
        [
            -0.86 * w * maths::cos(a) * (1.0 + 0.06 * rise),
            seat + (height - seat) * rise,
            -0.14 - 0.03 * maths::sin(a) - lean * rise,
        ]
    };
    let path: Vec<_> = (0..=32).map(|k| hoop(f64::from(k) / 32.0)).collect();
    m.add(Stuff::Wood, tube(&path, 8, |_| 0.011));
    let spindles = 6 + d.below(4);
    for k in 0..spindles {
        let x = 2.0 * (k as f64 + 1.0) / (spindles as f64 + 1.0) - 1.0;
        let t = maths::acos(-x) / PI;
        let foot = [0.75 * w * x, seat - 0.01, -0.16 + 0.03 * x * x];
        m.add(Stuff::Wood, tube(&line(foot, hoop(t), 4), 6, |t| 0.005 + 0.003 * maths::sin(PI * t)));
    }
    m.made()
}

/// A high stool with a foot ring.
fn bar(d: &mut Stream) -> FormVariant {
    let (r, height) = (d.range(0.15, 0.19), d.range(0.64, 0.8));
    let mut m = Maker::default();
    let cover = *d.pick(&[Stuff::Leather, Stuff::Wood, Stuff::Plastic]);
    let t = 0.04;
    m.add(
        cover,
        lathe(
            &[
                [0.0, height - t],
                [r - 0.01, height - t],
                [r, height - t + 0.01],
                [r, height - 0.012],
                [r - 0.015, height],
                [0.0, height],
            ],
            32,
        )
        .soft(),
    );
    m.top([0.0, height, 0.0], [0.65 * r, 0.65 * r], 0.8);
    if d.chance(0.5) {
        m.add(
            Stuff::Metal,
            lathe(
                &[
                    [0.0, 0.0],
                    [0.21, 0.0],
                    [0.21, 0.006],
                    [0.05, 0.022],
                    [0.025, 0.04],
                    [0.025, height - t],
                    [0.0, height - t],
                ],
                32,
            ),
        );
        m.add(Stuff::Metal, tube_loop(&ring_path(0.14, 0.3, 32), 8, 0.009));
        m.add(Stuff::Metal, rod([-0.14, 0.3, 0.0], [0.14, 0.3, 0.0], 0.007, 6));
    } else {
        for k in 0..4 {
            let a = TAU * (f64::from(k) + 0.5) / 4.0;
            let (s, c) = (maths::sin(a), maths::cos(a));
            m.add(Stuff::PaintedMetal, rod([0.23 * s, 0.0, 0.23 * c], [0.11 * s, height - t, 0.11 * c], 0.011, 8));
        }
        m.add(Stuff::PaintedMetal, tube_loop(&ring_path(0.23 - 0.12 * 0.3 / height, 0.3, 32), 8, 0.008));
        let back = height + d.range(0.12, 0.3);
        let path: Vec<_> = (0..=16)
            .map(|k| {
                let a = PI * (1.0 + f64::from(k) / 16.0);
                let rise = maths::sin(a - PI);
                [
                    r * maths::cos(a) * 0.95,
                    height - t * 0.5 + (back - height) * maths::pow(rise, 0.4),
                    r * 0.95 * maths::sin(a),
                ]
            })
            .collect();
        m.add(Stuff::PaintedMetal, tube(&path, 8, |_| 0.009));
    }
    m.made()
}
