//! Lamps that hang.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    lamps::flame,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("pendant", Family::CeilingLamp, 10, pendant),
    form("tube_lamp", Family::CeilingLamp, 6, tube_lamp),
    form("bulb_string", Family::CeilingLamp, 8, string),
    form("chandelier", Family::CeilingLamp, 6, chandelier),
    form("spot_track", Family::CeilingLamp, 6, track),
    form("paper_globe", Family::CeilingLamp, 6, paper),
];

/// A bulb with its glowing glass, cap upwards, hanging from `at`.
fn bulb(m: &mut Maker, at: [f64; 3], size: f64) {
    let shape =
        [[0.0, -1.0], [0.22, -0.97], [0.42, -0.82], [0.5, -0.58], [0.42, -0.35], [0.25, -0.1], [0.22, 0.0], [0.0, 0.0]];
    let profile: Vec<_> = shape.iter().map(|[r, y]| [r * size, y * size]).collect();
    m.add(Stuff::Glow, lathe(&profile, 14).smooth().at(at));
    let cap = lathe(&[[0.0, 0.0], [0.24 * size, 0.0], [0.24 * size, 0.45 * size], [0.0, 0.5 * size]], 12);
    m.add(Stuff::Metal, cap.at(at));
}

fn pendant(d: &mut Stream) -> FormVariant {
    let cord = d.range(0.4, 1.0);
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Metal, Stuff::Fabric, Stuff::Ceramic]);
    let (r, h) = (d.range(0.1, 0.26), d.range(0.1, 0.26));
    let mut m = Maker::default();
    let power = d.range(0.4, 2.2);
    let neck = 0.03;
    let n = 12;
    let at = |k: i32, thick: f64| {
        let t = f64::from(k) / f64::from(n);
        [(neck + (r - neck) * maths::pow(1.0 - t, power) - thick).max(0.012), h * t]
    };
    let profile: Vec<_> = (0..=n).map(|k| at(k, 0.0)).chain((0..=n).rev().map(|k| at(k, 0.003))).collect();
    m.add(stuff, lathe_loop(&profile, 36));
    m.add(
        Stuff::Metal,
        lathe(&[[0.0, h - 0.02], [0.03, h - 0.02], [0.028, h + 0.03], [0.006, h + 0.04], [0.0, h + 0.04]], 16),
    );
    // The bulb hangs below the neck, where it is a finger's breadth from the shade.
    let size = (0.5 * h).clamp(0.06, 0.09);
    let room = |low: f64| {
        let radius = |y: f64| at(((y / h) * f64::from(n)).ceil().clamp(0.0, f64::from(n)) as i32, 0.003)[0];
        [0.1, 0.35, 0.58, 0.82].iter().all(|y| radius(low + (1.0 - y) * size) > 0.5 * size + 0.012)
    };
    let mut cap = h - 0.03;
    while cap > -0.2 && !(cap <= 0.0 || room(cap - size)) {
        cap -= 0.01;
    }
    bulb(&mut m, [0.0, cap, 0.0], size);
    m.add(Stuff::Rubber, rod([0.0, cap, 0.0], [0.0, h - 0.01, 0.0], 0.004, 6));
    m.add(Stuff::Rubber, rod([0.0, h + 0.03, 0.0], [0.0, h + cord, 0.0], 0.003, 6));
    m.add(stuff, lathe(&[[0.0, h + cord - 0.02], [0.05, h + cord - 0.015], [0.05, h + cord], [0.0, h + cord]], 24));
    m.made()
}

fn tube_lamp(d: &mut Stream) -> FormVariant {
    let (l, count) = (d.range(0.3, 0.75), 1 + d.below(2));
    let mut m = Maker::default();
    let w = 0.04 + 0.035 * count as f64;
    m.add(Stuff::PaintedMetal, board([0.0, 0.07, 0.0], [l, 0.022, w]));
    for k in 0..count {
        let z = if count == 1 { 0.0 } else { 0.07 * (k as f64 - 0.5) };
        m.add(Stuff::Glow, rod([-l + 0.035, 0.022, z], [l - 0.035, 0.022, z], 0.013, 14));
        for s in [-1.0, 1.0] {
            m.add(Stuff::Plastic, board([s * (l - 0.025), 0.028, z], [0.011, 0.02, 0.014]));
        }
    }
    let hang = d.range(0.0, 0.8);
    for s in [-1.0, 1.0] {
        m.add(Stuff::Metal, rod([s * 0.7 * l, 0.09, 0.0], [s * 0.7 * l, 0.12 + hang, 0.0], 0.003, 6));
    }
    m.made()
}

fn string(d: &mut Stream) -> FormVariant {
    let (l, sag, count) = (d.range(1.0, 2.5), d.range(0.15, 0.5), 8 + d.below(12));
    let mut m = Maker::default();
    let at = |t: f64| [l * (2.0 * t - 1.0), sag * (2.0 * t - 1.0) * (2.0 * t - 1.0), 0.0];
    let path: Vec<_> = (0..=40).map(|k| at(f64::from(k) / 40.0)).collect();
    m.add(Stuff::Rubber, tube(&path, 5, |_| 0.003));
    let size = d.range(0.04, 0.08);
    for k in 0..count {
        let p = at((k as f64 + 0.5) / count as f64);
        bulb(&mut m, [p[0], p[1] - 0.6 * size, 0.0], size);
    }
    m.made()
}

fn chandelier(d: &mut Stream) -> FormVariant {
    let (arms, r, drop) = (5 + d.below(4), d.range(0.25, 0.4), d.range(0.3, 0.7));
    let stuff = *d.pick(&[Stuff::Metal, Stuff::PaintedMetal]);
    let mut m = Maker::default();
    let body = flat_spline(
        &[[0.002, 0.0], [0.025, 0.03], [0.012, 0.06], [0.045, 0.12], [0.015, 0.19], [0.03, 0.25], [0.008, 0.32]],
        4,
    );
    let profile: Vec<_> = [[0.0, 0.0]].into_iter().chain(body).chain([[0.0, 0.32]]).collect();
    m.add(stuff, lathe(&profile, 20));
    m.add(stuff, rod([0.0, 0.31, 0.0], [0.0, 0.32 + drop, 0.0], 0.005, 6));
    m.add(stuff, lathe(&[[0.0, 0.3 + drop], [0.06, 0.31 + drop], [0.06, 0.33 + drop], [0.0, 0.33 + drop]], 24));
    for k in 0..arms {
        let a = TAU * k as f64 / arms as f64;
        let (s, c) = (maths::sin(a), maths::cos(a));
        let p = |x: f64, y: f64| [x * s, y, x * c];
        let path = spline(&[p(0.02, 0.13), p(0.35 * r, 0.05), p(0.75 * r, 0.06), p(r, 0.15)], 5);
        m.add(stuff, tube(&path, 7, |_| 0.006));
        m.add(
            stuff,
            lathe(&[[0.0, 0.0], [0.01, 0.0], [0.032, 0.012], [0.03, 0.014], [0.012, 0.01], [0.0, 0.01]], 16)
                .at(p(r, 0.148)),
        );
        m.add(Stuff::Wax, rod(p(r, 0.155), p(r, 0.235), 0.011, 10));
        m.add(Stuff::Glow, flame(0.0).scaled([1.6, 1.3, 1.6]).at(p(r, 0.232)));
    }
    m.made()
}

fn track(d: &mut Stream) -> FormVariant {
    let (l, count) = (d.range(0.4, 0.9), 2 + d.below(4));
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Metal, Stuff::Plastic]);
    let mut m = Maker::default();
    let y = 0.24;
    m.add(stuff, board([0.0, y, 0.0], [l, 0.012, 0.017]));
    for k in 0..count {
        let x = l * (2.0 * (k as f64 + 0.5) / count as f64 - 1.0);
        m.add(stuff, rod([x, y - 0.01, 0.0], [x, y - 0.09, 0.0], 0.006, 8));
        let (tilt, turn) = (d.range(0.2, 0.9), d.range(0.0, TAU));
        let place = |b: Body| b.turned_x(tilt).turned_y(turn).at([x, y - 0.09, 0.0]);
        let head =
            [[0.0, 0.03], [0.033, 0.03], [0.038, 0.02], [0.038, -0.08], [0.035, -0.08], [0.034, -0.06], [0.0, -0.06]];
        let mut profile = head.to_vec();
        profile.reverse();
        m.add(stuff, place(lathe(&profile, 20)));
        m.add(Stuff::Glow, place(rod([0.0, -0.066, 0.0], [0.0, -0.06, 0.0], 0.031, 16)));
    }
    m.made()
}

fn paper(d: &mut Stream) -> FormVariant {
    let (r, cord, ribs) = (d.range(0.15, 0.3), d.range(0.3, 0.8), 8 + d.below(8));
    let squash = d.range(0.7, 1.1);
    let mut m = Maker::default();
    let n = ribs * 3;
    let profile: Vec<_> = (0..=n)
        .map(|k| {
            let t = k as f64 / n as f64;
            let a = PI * (0.06 + 0.88 * t - 0.5);
            [
                r * maths::cos(a) * (1.0 - 0.025 * maths::sin(PI * ribs as f64 * t).abs()),
                r * squash * (1.0 + maths::sin(a)),
            ]
        })
        .collect();
    let inside = profile.iter().rev().map(|p| [p[0] - 0.0012, p[1]]).collect::<Vec<_>>();
    let top = profile[n][1];
    m.add(Stuff::Glow, lathe_loop(&profile.into_iter().chain(inside).collect::<Vec<_>>(), 36).soft());
    m.add(Stuff::Rubber, rod([0.0, top - 0.02, 0.0], [0.0, top + cord, 0.0], 0.003, 6));
    m.add(Stuff::Plastic, rod([0.0, top + cord - 0.015, 0.0], [0.0, top + cord, 0.0], 0.045, 20));
    m.made()
}
