//! Curtains, blinds, doors, windows, fixtures.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("curtain_pair", Family::Curtain, 8, pair),
    form("curtain_single", Family::Curtain, 8, single),
    form("blind_venetian", Family::Blind, 8, venetian),
    form("blind_roller", Family::Blind, 6, roller),
    form("blind_vertical", Family::Blind, 6, vertical),
    form("door_panels", Family::Opening, 8, door),
    form("window_frame", Family::Opening, 8, window),
    form("door_glazed", Family::Opening, 6, glazed),
    form("radiator", Family::Fixture, 8, radiator),
    form("radiator_panel", Family::Fixture, 6, panel_radiator),
    form("tap", Family::Fixture, 6, tap),
    form("basin", Family::Fixture, 6, basin),
];

/// A hanging panel in folds from x = `from` to `to`, gathered a little below where `tied`.
fn folds(d: &mut Stream, from: f64, to: f64, height: f64, folds: f64, tied: f64) -> Body {
    let (deep, phase) = (d.range(0.03, 0.06), d.range(0.0, TAU));
    let n = (folds * 12.0) as usize;
    sheet(n, 16, |s, t| {
        let y = height * t;
        let a = TAU * folds * s + phase;
        let loose = 1.0 - 0.25 * t;
        let gather = 1.0 - tied * maths::exp(-18.0 * (t - 0.42) * (t - 0.42));
        let x = from + (to - from) * s * gather;
        let drift = 0.35 * maths::sin(2.0 * a + 3.0 * t);
        [x + 0.012 * maths::cos(a) * loose, y, deep * loose * (maths::sin(a) + 0.2 * drift) * (1.0 - 0.3 * tied)]
    })
    .smooth()
}

fn pole(m: &mut Maker, half: f64, y: f64) {
    m.add(Stuff::Metal, rod([-half, y, 0.0], [half, y, 0.0], 0.012, 12));
    for s in [-1.0, 1.0] {
        m.add(Stuff::Metal, ball(0.025, 14).at([s * (half + 0.015), y, 0.0]));
        m.add(Stuff::Metal, board([s * (half - 0.08), y, -0.05], [0.006, 0.012, 0.055]));
    }
}

fn pair(d: &mut Stream) -> FormVariant {
    let (half, height) = (d.range(0.6, 1.1), d.range(1.4, 2.4));
    let mut m = Maker::default();
    pole(&mut m, half, height + 0.02);
    let wide = half * d.range(0.3, 0.5);
    let tied = if d.chance(0.4) { 0.55 } else { 0.0 };
    let count = (wide / 0.07).round().max(3.0);
    for s in [-1.0, 1.0] {
        let body = folds(d, 0.0, wide, height, count, tied);
        let body = if s < 0.0 {
            body.at([-half + 0.05, 0.0, 0.0])
        } else {
            body.scaled([-1.0, 1.0, 1.0]).at([half - 0.05, 0.0, 0.0])
        };
        m.add(Stuff::Fabric, body);
        for k in 0..count as usize {
            let x = s * (half - 0.05 - wide * (k as f64 + 0.5) / count);
            m.add(
                Stuff::Metal,
                tube_loop(
                    &circle(14, 0.019).into_iter().map(|[a, b]| [x, height + 0.014 + a, b]).collect::<Vec<_>>(),
                    5,
                    0.0025,
                ),
            );
        }
    }
    m.made()
}

fn single(d: &mut Stream) -> FormVariant {
    let (half, height) = (d.range(0.4, 0.9), d.range(1.2, 2.4));
    let mut m = Maker::default();
    pole(&mut m, half + 0.05, height + 0.02);
    let count = (half / 0.05).round();
    let body = folds(d, -half, half, height, count, 0.0);
    m.add(Stuff::Fabric, body);
    m.made()
}

fn venetian(d: &mut Stream) -> FormVariant {
    let (half, height, pitch) = (d.range(0.3, 0.8), d.range(0.6, 1.5), d.range(0.022, 0.042));
    let tilt = d.range(-1.1, 1.1);
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Wood, Stuff::Metal]);
    let mut m = Maker::default();
    m.add(stuff, board([0.0, height + 0.018, 0.0], [half, 0.016, 0.022]));
    let drawn = d.range(0.0, 0.4);
    let count = ((height * (1.0 - drawn)) / pitch) as usize;
    let wide = 0.58 * pitch;
    let (s, c) = (maths::sin(tilt), maths::cos(tilt));
    let slats = Body::all((0..count).map(|k| {
        let y = height - pitch * (k as f64 + 0.5);
        slab(1, 3, 0.0007, |u, v| {
            let w = wide * (1.0 - 2.0 * v);
            let arch = 0.12 * wide * (1.0 - (2.0 * v - 1.0) * (2.0 * v - 1.0));
            [half * (2.0 * u - 1.0), y + w * s + arch * c, w * c - arch * s]
        })
    }));
    m.add(stuff, slats);
    let low = height - pitch * count as f64;
    m.add(stuff, board([0.0, low - 0.008, 0.0], [half, 0.008, 0.014]));
    for x in [-0.7, 0.7] {
        for z in [-1.0, 1.0] {
            m.add(
                Stuff::Fabric,
                rod([x * half, low, z * 0.6 * wide], [x * half, height + 0.005, z * 0.6 * wide], 0.0008, 4),
            );
        }
    }
    m.add(Stuff::Plastic, rod([-half + 0.06, height, 0.026], [-half + 0.06, height - 0.45 * height, 0.03], 0.003, 6));
    m.made()
}

fn roller(d: &mut Stream) -> FormVariant {
    let (half, height) = (d.range(0.3, 0.8), d.range(0.4, 1.4));
    let mut m = Maker::default();
    m.add(Stuff::Fabric, rod([-half, height, 0.0], [half, height, 0.0], 0.024, 20));
    m.add(Stuff::Fabric, sheet(4, 4, |s, t| [(half - 0.004) * (2.0 * s - 1.0), 0.01 + (height - 0.01) * t, 0.0245]));
    m.add(Stuff::Metal, rod([-half + 0.003, 0.01, 0.0245], [half - 0.003, 0.01, 0.0245], 0.008, 10));
    for s in [-1.0, 1.0] {
        m.add(Stuff::Plastic, board([s * (half + 0.006), height, -0.004], [0.005, 0.032, 0.032]));
    }
    m.add(Stuff::Plastic, rod([half + 0.006, height, 0.034], [half + 0.006, 0.4 * height, 0.034], 0.0015, 5));
    m.made()
}

fn vertical(d: &mut Stream) -> FormVariant {
    let (half, height, wide) = (d.range(0.5, 1.1), d.range(1.2, 2.3), d.range(0.08, 0.12));
    let turn = d.range(-1.2, 1.2);
    let mut m = Maker::default();
    m.add(Stuff::Plastic, board([0.0, height + 0.02, 0.0], [half, 0.018, 0.02]));
    let count = (2.0 * half / (0.85 * wide)) as usize;
    let (s, c) = (maths::sin(turn), maths::cos(turn));
    let slats = Body::all((0..count).map(|k| {
        let x = half * (2.0 * (k as f64 + 0.5) / count as f64 - 1.0);
        sheet(3, 1, |u, v| {
            let w = 0.5 * wide * (2.0 * u - 1.0);
            let arch = 0.006 * (1.0 - (2.0 * u - 1.0) * (2.0 * u - 1.0));
            [x + w * c + arch * s, height * v, -w * s + arch * c]
        })
    }));
    m.add(Stuff::Fabric, slats);
    m.made()
}

fn casing(m: &mut Maker, stuff: Stuff, half: f64, height: f64, wide: f64) {
    for s in [-1.0, 1.0] {
        m.add(
            stuff,
            board([s * (half + 0.5 * wide), 0.5 * (height + wide), 0.0], [0.5 * wide, 0.5 * (height + wide), 0.045]),
        );
    }
    m.add(stuff, board([0.0, height + 0.5 * wide, 0.0], [half, 0.5 * wide, 0.045]));
}

fn lever(m: &mut Maker, x: f64, y: f64, z: f64, side: f64) {
    m.add(Stuff::Metal, board([x, y, z + 0.004], [0.02, 0.09, 0.004]));
    let path = fillet(&[[x, y + 0.03, z], [x, y + 0.03, z + 0.05], [x + side * 0.11, y + 0.03, z + 0.05]], 0.015, 4);
    m.add(Stuff::Metal, tube(&path, 8, |_| 0.009));
}

fn door(d: &mut Stream) -> FormVariant {
    let (half, height) = (d.range(0.36, 0.46), d.range(1.96, 2.1));
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Wood, Stuff::PaintedMetal]);
    let mut m = Maker::default();
    casing(&mut m, stuff, half + 0.004, height + 0.004, d.range(0.05, 0.09));
    let (rows, columns) = (1 + d.below(4), 1 + d.below(2));
    let rail = 0.055;
    // Stiles and rails stand before sunken panels.
    m.add(stuff, board([0.0, 0.5 * height + 0.004, -0.004], [half, 0.5 * height - 0.004, 0.012]));
    let (w, h) = ((2.0 * half - rail) / columns as f64, (height - 0.2 - rail) / rows as f64);
    for c in 0..=columns {
        let x = -half + 0.5 * rail + w * c as f64;
        for z in [-0.02, 0.012] {
            m.add(stuff, board([x, 0.5 * height + 0.004, z], [0.5 * rail, 0.5 * height - 0.004, 0.006]));
        }
    }
    for r in 0..=rows {
        let (y, k) = if r == 0 { (0.1, 0.1) } else { (0.2 + h * r as f64, 0.5 * rail) };
        for c in 0..columns {
            let x = -half + 0.5 * rail + w * (c as f64 + 0.5);
            for z in [-0.02, 0.012] {
                m.add(stuff, board([x, y + 0.005, z], [0.5 * (w - rail), k, 0.0059]));
            }
            if r < rows {
                let y = if r == 0 { 0.2 } else { 0.2 + h * r as f64 + 0.5 * rail };
                let top = 0.2 + h * (r as f64 + 1.0) - 0.5 * rail;
                m.add(
                    stuff,
                    board([x, 0.5 * (y + top), 0.01], [0.5 * (w - rail) - 0.04, 0.5 * (top - y) - 0.04, 0.005]),
                );
            }
        }
    }
    lever(&mut m, half - 0.03, 1.0, 0.018, -1.0);
    m.made()
}

fn glazing(m: &mut Maker, stuff: Stuff, low: [f64; 2], high: [f64; 2], grid: [usize; 2], bar: f64) {
    let (w, h) = ((high[0] - low[0]) / grid[0] as f64, (high[1] - low[1]) / grid[1] as f64);
    for i in 0..=grid[0] {
        let x = low[0] + w * i as f64;
        let k = if i == 0 || i == grid[0] { bar } else { 0.5 * bar };
        m.add(stuff, board([x, 0.5 * (low[1] + high[1]), 0.0], [k, 0.5 * (high[1] - low[1]) + bar, 0.02]));
    }
    for j in 0..=grid[1] {
        let y = low[1] + h * j as f64;
        let k = if j == 0 || j == grid[1] { bar } else { 0.5 * bar };
        for i in 0..grid[0] {
            let x = low[0] + w * (i as f64 + 0.5);
            m.add(stuff, board([x, y, 0.0], [0.5 * w - 0.5 * bar, k, 0.019]));
        }
    }
    m.add(Stuff::Pane, sheet(1, 1, |s, t| [low[0] + (high[0] - low[0]) * s, low[1] + (high[1] - low[1]) * t, 0.0]));
}

fn window(d: &mut Stream) -> FormVariant {
    let (half, height) = (d.range(0.35, 0.9), d.range(0.8, 1.6));
    let stuff = *d.pick(&[Stuff::Wood, Stuff::PaintedMetal, Stuff::Plastic]);
    let mut m = Maker::default();
    let grid = [1 + d.below(3), 1 + d.below(3)];
    glazing(&mut m, stuff, [-half, 0.08], [half, 0.08 + height], grid, d.range(0.02, 0.04));
    // A sill before it.
    m.add(stuff, board([0.0, 0.02, 0.05], [half + 0.08, 0.016, 0.1]));
    m.top([0.0, 0.036, 0.09], [half, 0.05], height);
    m.made()
}

fn glazed(d: &mut Stream) -> FormVariant {
    let (half, height) = (d.range(0.38, 0.45), d.range(1.98, 2.1));
    let stuff = *d.pick(&[Stuff::Wood, Stuff::PaintedMetal]);
    let mut m = Maker::default();
    let low = d.range(0.25, 0.9);
    casing(&mut m, stuff, half + 0.004, height + 0.004, 0.06);
    let b = 0.04;
    glazing(&mut m, stuff, [-half + b, low], [half - b, height - b], [1 + d.below(2), 1 + d.below(4)], b);
    m.add(stuff, board([0.0, 0.5 * (low - b), 0.0], [half, 0.5 * (low - b) - 0.004, 0.018]));
    lever(&mut m, half - 0.04, 1.0, 0.02, -1.0);
    m.made()
}

fn radiator(d: &mut Stream) -> FormVariant {
    let (count, height, deep) = (6 + d.below(12), d.range(0.45, 0.75), d.range(0.04, 0.07));
    let mut m = Maker::default();
    let pitch = 0.05;
    for k in 0..count {
        let x = pitch * k as f64;
        for z in [-deep, deep] {
            m.add(Stuff::PaintedMetal, tube(&line([x, 0.13, z], [x, height - 0.03, z], 1), 10, |_| 0.019));
        }
        for y in [0.13, height - 0.03] {
            m.add(Stuff::PaintedMetal, soft_block([x, y, 0.0], [0.0246, 0.028, deep + 0.022], 0.02, 3));
        }
    }
    for x in [0.0, pitch * (count - 1) as f64] {
        m.add(Stuff::PaintedMetal, tube(&[[x, 0.0, 0.0], [x, 0.12, 0.0]], 8, |t| 0.022 - 0.006 * t));
    }
    m.add(Stuff::Metal, rod([-0.02, 0.13, 0.0], [-0.1, 0.13, 0.0], 0.012, 10));
    m.add(Stuff::Metal, rod([-0.085, 0.0, 0.0], [-0.085, 0.145, 0.0], 0.008, 8));
    m.add(Stuff::Plastic, rod([-0.1, 0.13, 0.0], [-0.16, 0.13, 0.0], 0.022, 14));
    m.made()
}

fn panel_radiator(d: &mut Stream) -> FormVariant {
    let (half, height) = (d.range(0.3, 0.8), d.range(0.4, 0.6));
    let mut m = Maker::default();
    let n = (half / 0.02) as usize * 4;
    let y = 0.1;
    for (z, face) in [(0.03, 1.0), (-0.03, -1.0)] {
        let wave = |s: f64| 0.004 * maths::sin(TAU * s * n as f64 / 4.0).abs();
        let body =
            slab(n, 1, 0.008, |s, t| [face * half * (2.0 * s - 1.0), y + height * t, z + face * (0.008 + wave(s))]);
        m.add(Stuff::PaintedMetal, body);
    }
    let fins = (half / 0.012) as usize;
    let plates = Body::all((0..fins).map(|k| {
        let x = half * (2.0 * (k as f64 + 0.5) / fins as f64 - 1.0);
        block([x, y + 0.5 * height, 0.0], [0.0008, 0.46 * height, 0.027])
    }));
    m.add(Stuff::PaintedMetal, plates);
    m.add(Stuff::PaintedMetal, board([0.0, y + height + 0.004, 0.0], [half, 0.003, 0.042]));
    for s in [-1.0, 1.0] {
        m.add(Stuff::Metal, rod([s * (half - 0.04), 0.0, 0.0], [s * (half - 0.04), y + 0.03, 0.0], 0.008, 8));
    }
    m.made()
}

fn tap(d: &mut Stream) -> FormVariant {
    let (h, reach) = (d.range(0.12, 0.3), d.range(0.1, 0.18));
    let mut m = Maker::default();
    m.add(
        Stuff::Metal,
        lathe(&[[0.0, 0.0], [0.026, 0.0], [0.026, 0.006], [0.016, 0.012], [0.016, 0.06], [0.0, 0.06]], 24),
    );
    let path: Vec<[f64; 3]> = [[0.0, 0.05, 0.0], [0.0, h, 0.0]]
        .into_iter()
        .chain(arc([0.5 * reach, h], 0.5 * reach, PI, 0.0, 12).into_iter().skip(1).map(|[z, y]| [0.0, y, z]))
        .chain([[0.0, h - 0.04, reach]])
        .collect();
    m.add(Stuff::Metal, tube(&path, 14, |_| 0.011));
    if d.chance(0.5) {
        m.add(Stuff::Metal, rod([0.012, 0.045, 0.0], [0.05, 0.05, 0.0], 0.007, 10));
        m.add(Stuff::Metal, rod([0.045, 0.045, 0.0], [0.055, 0.11, 0.0], 0.005, 10));
    } else {
        for s in [-1.0, 1.0] {
            m.add(Stuff::Metal, rod([s * 0.01, 0.035, 0.0], [s * 0.06, 0.035, 0.0], 0.008, 10));
            for a in 0..2 {
                let (x, y) = if a == 0 { (0.03, 0.0) } else { (0.0, 0.03) };
                m.add(Stuff::Ceramic, rod([s * 0.06, 0.035 - x, -y], [s * 0.06, 0.035 + x, y], 0.006, 10));
            }
        }
    }
    m.made()
}

fn basin(d: &mut Stream) -> FormVariant {
    let (half, high) = ([d.range(0.22, 0.32), d.range(0.18, 0.22)], d.range(0.78, 0.86));
    let deep = 0.12;
    let round = d.range(0.3, 0.95) * half[1];
    let ring = |k: f64, y: f64| {
        rounded_rect([half[0] * k, half[1] * k], round * k, 8)
            .into_iter()
            .rev()
            .map(|[x, z]| [x, y, z])
            .collect::<Vec<_>>()
    };
    let rings = [
        ring(0.45, high - deep - 0.05),
        ring(0.8, high - 0.7 * deep),
        ring(1.0, high - 0.02),
        ring(1.0, high),
        ring(0.86, high),
        ring(0.82, high - 0.02),
        ring(0.7, high - 0.6 * deep),
        ring(0.45, high - 0.9 * deep),
        ring(0.08, high - deep),
    ];
    let mut m = Maker::default();
    m.add(Stuff::Ceramic, skin(&rings, [true, false], [true, true]).soft());
    m.add(
        Stuff::Ceramic,
        lathe(
            &[
                [0.0, 0.0],
                [0.11, 0.0],
                [0.1, 0.02],
                [0.07, 0.2],
                [0.075, 0.5],
                [0.1, high - deep - 0.052],
                [0.0, high - deep - 0.052],
            ],
            28,
        ),
    );
    m.add(
        Stuff::Metal,
        lathe(
            &[[0.0, high - deep], [0.022, high - deep], [0.022, high - deep + 0.003], [0.0, high - deep + 0.002]],
            20,
        ),
    );
    m.made()
}
