//! Shelves and cabinets.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::rng::Stream;

pub(super) const FORMS: &[Form] = &[
    form("bookcase", Family::Shelf, 10, bookcase),
    form("shelf_ladder", Family::Shelf, 6, ladder),
    form("shelf_wall", Family::Shelf, 8, wall),
    form("shelf_cubes", Family::Shelf, 8, cubes),
    form("shelf_wire", Family::Shelf, 6, wire),
    form("cabinet_doors", Family::Cabinet, 8, cabinet),
    form("chest_drawers", Family::Cabinet, 8, chest),
    form("locker_metal", Family::Cabinet, 6, locker),
    form("wardrobe", Family::Cabinet, 6, wardrobe),
    form("cabinet_glass", Family::Cabinet, 6, vitrine),
];

/// Fronts of drawers in a grid over a face about `center` that looks along +z, each with a handle.
pub(super) fn fronts(
    m: &mut Maker,
    d: &mut Stream,
    stuff: Stuff,
    half: [f64; 2],
    center: [f64; 3],
    columns: usize,
    rows: usize,
) {
    let (w, h) = (half[0] / columns as f64, half[1] / rows as f64);
    let bar = d.chance(0.5);
    for r in 0..rows {
        for c in 0..columns {
            let x = center[0] - half[0] + w * (2.0 * c as f64 + 1.0);
            let y = center[1] - half[1] + h * (2.0 * r as f64 + 1.0);
            let z = center[2];
            m.add(stuff, board([x, y, z], [w - 0.002, h - 0.002, 0.009]));
            let front = z + 0.009;
            if bar {
                let l = (0.4 * w).min(0.08);
                let path = [
                    [x - l, y, front - 0.001],
                    [x - l, y, front + 0.025],
                    [x + l, y, front + 0.025],
                    [x + l, y, front - 0.001],
                ];
                m.add(Stuff::Metal, tube(&fillet(&path, 0.008, 2), 6, |_| 0.004));
            } else {
                let knob =
                    lathe(&[[0.0, 0.0], [0.006, 0.0], [0.006, 0.01], [0.014, 0.015], [0.014, 0.022], [0.0, 0.025]], 12);
                m.add(Stuff::Metal, knob.turned_x(0.5 * PI).at([x, y, front - 0.001]));
            }
        }
    }
}

fn bookcase(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.3, 0.6), d.range(0.13, 0.18)];
    let (height, thick) = (d.range(0.8, 2.1), d.range(0.008, 0.014));
    let rows = ((height / d.range(0.28, 0.38)) as usize).max(2);
    let mut m = Maker::default();
    for s in [-1.0, 1.0] {
        m.add(Stuff::Wood, board([s * (half[0] - thick), 0.5 * height, 0.0], [thick, 0.5 * height, half[1]]));
    }
    let foot = 0.06;
    let step = (height - foot - 2.0 * thick) / rows as f64;
    for k in 0..=rows {
        let y = foot + thick + step * k as f64;
        m.add(Stuff::Wood, board([0.0, y, 0.0], [half[0] - 2.0 * thick, thick, half[1] - 0.004]));
        let free = if k < rows { step - 2.0 * thick } else { f64::INFINITY };
        m.top([0.0, y + thick, 0.008], [half[0] - 2.0 * thick - 0.005, half[1] - 0.016], free);
    }
    if d.chance(0.8) {
        m.add(
            Stuff::Wood,
            block(
                [0.0, 0.5 * (height + foot), -half[1] + 0.002],
                [half[0] - 2.0 * thick, 0.5 * (height - foot), 0.002],
            ),
        );
    }
    m.add(Stuff::Wood, board([0.0, 0.5 * foot, half[1] - 0.03], [half[0] - 2.0 * thick, 0.5 * foot, 0.008]));
    m.made()
}

fn ladder(d: &mut Stream) -> FormVariant {
    let (w, height, deep) = (d.range(0.25, 0.4), d.range(1.5, 2.0), d.range(0.35, 0.5));
    let mut m = Maker::default();
    for s in [-1.0, 1.0] {
        m.add(Stuff::Wood, beam([s * w, 0.0, deep], [s * w, height, 0.0], [0.04, 0.022], [0.0, 0.0, 1.0]));
    }
    let rows = 4 + d.below(2);
    for k in 0..rows {
        let y = 0.2 + (height - 0.45) * k as f64 / (rows - 1) as f64;
        let front = deep * (1.0 - y / height) + 0.02;
        m.add(Stuff::Wood, board([0.0, y, 0.5 * front], [w - 0.011, 0.009, 0.5 * front]));
        let free = (height - 0.45) / (rows - 1) as f64 - 0.02;
        m.top(
            [0.0, y + 0.009, 0.5 * front + 0.006],
            [w - 0.03, 0.45 * front - 0.006],
            if k + 1 < rows { free } else { f64::INFINITY },
        );
        m.add(Stuff::Wood, board([0.0, y + 0.025, 0.004], [w - 0.011, 0.016, 0.004]));
    }
    m.made()
}

fn wall(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.3, 0.7), d.range(0.08, 0.14)];
    let mut m = Maker::default();
    let thick = d.range(0.009, 0.02);
    let y = d.range(0.12, 0.2);
    m.add(Stuff::Wood, board([0.0, y, 0.0], [half[0], thick, half[1]]));
    m.top([0.0, y + thick, 0.0], [half[0] - 0.01, half[1] - 0.01], f64::INFINITY);
    let metal = d.chance(0.5);
    for s in [-1.0, 1.0] {
        let x = s * half[0] * 0.7;
        let (b, f) = (-half[1] + 0.006, half[1] - 0.03);
        if metal {
            let path = [[x, 0.0, b], [x, y - thick - 0.006, b], [x, y - thick - 0.006, f], [x, 0.02, b]];
            m.add(Stuff::PaintedMetal, tube(&fillet(&path, 0.012, 2), 6, |_| 0.005));
        } else {
            let outline = [
                [b, 0.0],
                [b + 0.02, 0.0],
                [b + 0.03, 0.5 * y],
                [f, y - thick - 0.012],
                [f, y - thick],
                [b, y - thick],
            ];
            let plate = extrude(&outline, 0.02).turned_y(-0.5 * PI).at([x, 0.0, 0.0]);
            m.add(Stuff::Wood, plate);
        }
    }
    m.made()
}

fn cubes(d: &mut Stream) -> FormVariant {
    let (columns, rows, cell) = (2 + d.below(3), 2 + d.below(3), d.range(0.3, 0.38));
    let (thick, deep) = (0.009, d.range(0.15, 0.19));
    let mut m = Maker::default();
    let (w, h) = (cell * columns as f64, cell * rows as f64);
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Plastic, Stuff::Wood]);
    for c in 0..=columns {
        let x = cell * c as f64 - 0.5 * w;
        m.add(stuff, board([x, 0.5 * h, 0.0], [thick, 0.5 * h - thick, deep]));
    }
    for r in 0..=rows {
        let y = cell * r as f64;
        m.add(stuff, board([0.0, y, 0.0], [0.5 * w + thick, thick, deep]));
        for c in 0..columns {
            let x = cell * (c as f64 + 0.5) - 0.5 * w;
            let free = if r < rows { cell - 2.0 * thick } else { f64::INFINITY };
            if r < rows && d.chance(0.2) {
                let y = y + 0.5 * cell;
                m.another(
                    Stuff::PaintedMetal,
                    board([x, y, deep - 0.012], [0.5 * cell - thick - 0.002, 0.5 * cell - thick - 0.002, 0.01]),
                );
            } else {
                m.top([x, y + thick, 0.0], [0.5 * cell - thick - 0.01, deep - 0.015], free);
            }
        }
    }
    m.made()
}

fn wire(d: &mut Stream) -> FormVariant {
    let (w, deep, height) = (d.range(0.35, 0.55), d.range(0.17, 0.25), d.range(1.2, 1.9));
    let rows = 3 + d.below(3);
    let mut m = Maker::default();
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        m.add(Stuff::Metal, rod([sx * w, 0.0, sz * deep], [sx * w, height, sz * deep], 0.012, 10));
    }
    for k in 0..rows {
        let y = 0.12 + (height - 0.15) * k as f64 / (rows - 1) as f64;
        let mut grid = Body::default();
        for s in [-1.0, 1.0] {
            grid = grid.with(rod([-w, y - 0.006, s * deep], [w, y - 0.006, s * deep], 0.004, 6));
            grid = grid.with(rod([s * w, y - 0.006, -deep], [s * w, y - 0.006, deep], 0.004, 6));
        }
        let count = (w / 0.02) as usize;
        for i in 1..count {
            let x = w * (2.0 * i as f64 / count as f64 - 1.0);
            grid = grid.with(rod([x, y - 0.0015, -deep], [x, y - 0.0015, deep], 0.0015, 4));
        }
        m.add(Stuff::Metal, grid.soft());
        let free = if k + 1 < rows { (height - 0.15) / (rows - 1) as f64 - 0.02 } else { f64::INFINITY };
        m.top([0.0, y, 0.0], [w - 0.04, deep - 0.03], free);
    }
    m.made()
}

fn carcass(m: &mut Maker, stuff: Stuff, half: [f64; 3], foot: f64) {
    m.add(stuff, board([0.0, foot + half[1], 0.0], half));
    m.top([0.0, foot + 2.0 * half[1], 0.0], [half[0] - 0.01, half[2] - 0.01], f64::INFINITY);
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let [x, z] = [sx * (half[0] - 0.05), sz * (half[2] - 0.05)];
        m.add(stuff, tube(&[[x, 0.0, z], [x, foot, z]], 8, |t| 0.014 + 0.01 * t));
    }
}

fn cabinet(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.4, 0.8), d.range(0.25, 0.42), d.range(0.19, 0.24)];
    let foot = d.range(0.06, 0.2);
    let mut m = Maker::default();
    carcass(&mut m, Stuff::Wood, half, foot);
    let doors = 2 + d.below(2);
    fronts(
        &mut m,
        d,
        Stuff::Wood,
        [half[0] - 0.012, half[1] - 0.012],
        [0.0, foot + half[1], half[2] + 0.006],
        doors,
        1,
    );
    m.made()
}

fn chest(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.25, 0.6), d.range(0.3, 0.55), d.range(0.2, 0.25)];
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Wood, Stuff::PaintedMetal]);
    carcass(&mut m, stuff, half, d.range(0.03, 0.15));
    let foot = m.tops_height() - 2.0 * half[1];
    let (columns, rows) = (1 + d.below(2), 3 + d.below(3));
    fronts(&mut m, d, stuff, [half[0] - 0.01, half[1] - 0.01], [0.0, foot + half[1], half[2] + 0.006], columns, rows);
    m.made()
}

fn locker(d: &mut Stream) -> FormVariant {
    let (count, height, deep, cell) = (1 + d.below(4), d.range(1.6, 1.9), d.range(0.22, 0.26), d.range(0.15, 0.2));
    let mut m = Maker::default();
    let w = cell * count as f64;
    m.add(Stuff::PaintedMetal, board([0.0, 0.5 * height + 0.05, 0.0], [w, 0.5 * height - 0.05, deep]));
    m.add(Stuff::Plastic, block([0.0, 0.05, 0.0], [w - 0.01, 0.05, deep - 0.02]));
    m.top([0.0, height, 0.0], [w - 0.01, deep - 0.01], f64::INFINITY);
    let split = 1 + d.below(2);
    for k in 0..count {
        let x = -w + cell * (2.0 * k as f64 + 1.0);
        for j in 0..split {
            let h = (height - 0.12) / split as f64;
            let y = 0.11 + h * (j as f64 + 0.5);
            let mut front = board([x, y, deep + 0.006], [cell - 0.004, 0.5 * h - 0.004, 0.008]);
            for i in 0..4 {
                let y = y + 0.5 * h - 0.08 - 0.025 * f64::from(i);
                front = front.with(block([x, y, deep + 0.016], [0.5 * cell, 0.004, 0.003]));
            }
            m.another(Stuff::PaintedMetal, front);
            m.add(Stuff::Metal, board([x + cell - 0.035, y, deep + 0.022], [0.008, 0.035, 0.009]));
        }
    }
    m.made()
}

fn wardrobe(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.45, 0.9), d.range(0.9, 1.05), d.range(0.27, 0.32)];
    let mut m = Maker::default();
    let foot = 0.06;
    carcass(&mut m, Stuff::Wood, half, foot);
    let doors = if half[0] > 0.7 { 3 } else { 2 };
    let low = if d.chance(0.5) { 0.3 } else { 0.0 };
    let y = foot + half[1] + 0.5 * low;
    fronts(&mut m, d, Stuff::Wood, [half[0] - 0.012, half[1] - 0.012 - 0.5 * low], [0.0, y, half[2] + 0.006], doors, 1);
    if low > 0.0 {
        fronts(
            &mut m,
            d,
            Stuff::Wood,
            [half[0] - 0.012, 0.5 * low - 0.008],
            [0.0, foot + 0.5 * low + 0.008, half[2] + 0.006],
            2,
            1,
        );
    }
    m.add(Stuff::Wood, board([0.0, foot + 2.0 * half[1] + 0.02, 0.01], [half[0] + 0.02, 0.02, half[2] + 0.025]));
    m.tops_clear();
    m.top([0.0, foot + 2.0 * half[1] + 0.04, 0.01], [half[0], half[2]], f64::INFINITY);
    m.made()
}

/// A display case: glass doors before shelves.
fn vitrine(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.3, 0.5), d.range(0.7, 0.9), d.range(0.17, 0.22)];
    let mut m = Maker::default();
    let t = 0.012;
    let high = 2.0 * half[1];
    for s in [-1.0, 1.0] {
        m.add(Stuff::Wood, board([s * (half[0] - t), half[1], 0.0], [t, half[1], half[2]]));
    }
    let rows = 3 + d.below(2);
    for k in 0..=rows {
        let y = 0.08 + (high - 0.08 - t) * k as f64 / rows as f64;
        m.add(Stuff::Wood, board([0.0, y, -0.01], [half[0] - 2.0 * t, t, half[2] - 0.02]));
        let free = if k < rows { (high - 0.08 - t) / rows as f64 - 2.0 * t } else { f64::INFINITY };
        m.top([0.0, y + t, -0.01], [half[0] - 2.0 * t - 0.01, half[2] - 0.045], free);
    }
    m.add(Stuff::Wood, block([0.0, half[1], -half[2] + 0.004], [half[0] - 2.0 * t, half[1], 0.003]));
    m.add(Stuff::Wood, board([0.0, 0.035, half[2] - 0.02], [half[0] - 2.0 * t, 0.035, 0.01]));
    let z = half[2] - 0.008;
    for s in [-1.0, 1.0] {
        let (x, w) = (s * 0.5 * (half[0] - t), 0.5 * (half[0] - 2.0 * t) - 0.002);
        let (low, top) = (0.1, high - 0.03);
        for e in [-1.0, 1.0] {
            m.add(Stuff::Wood, board([x + e * (w - 0.02), 0.5 * (low + top), z], [0.02, 0.5 * (top - low), 0.008]));
        }
        for y in [low + 0.02, top - 0.02] {
            m.add(Stuff::Wood, board([x, y, z], [w - 0.04, 0.02, 0.008]));
        }
        let pane = sheet(1, 1, |a, b| [x + (2.0 * a - 1.0) * (w - 0.04), low + 0.04 + (top - low - 0.08) * b, z]);
        m.add(Stuff::Pane, pane);
        m.add(Stuff::Metal, ball(0.01, 10).at([x - s * (w - 0.018), half[1], z + 0.014]));
    }
    m.made()
}
