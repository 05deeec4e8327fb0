//! Columns, obelisks, arches.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("column_fluted", Family::Column, 8, fluted),
    form("column_plain", Family::Column, 8, plain),
    form("column_twisted", Family::Column, 6, twisted),
    form("obelisk", Family::Column, 6, obelisk),
    form("arch_stone", Family::Column, 6, arch),
];

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

fn fluted(d: &mut Stream) -> FormVariant {
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

fn plain(d: &mut Stream) -> FormVariant {
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
fn twisted(d: &mut Stream) -> FormVariant {
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

fn obelisk(d: &mut Stream) -> FormVariant {
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

fn arch(d: &mut Stream) -> FormVariant {
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
