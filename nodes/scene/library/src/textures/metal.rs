//! Metals, paint on them, rust; and the fine grain of plastics, glazes and skins.

use super::{
    field::{Cells, Field, Size, hash, step},
    skin::{Skin, Texel, blend, eye, shade},
};
use tauflow_data::{maths, rng::Stream};

/// How deep scratches are at each texel, 0 to 1: arcs and lines drawn over one another.
fn scratches(draw: &mut Stream, size: Size, count: usize, long: [f64; 2]) -> Field {
    let mut field = Field { size, values: vec![0.0; size[0] * size[1]] };
    let (w, h) = (size[0] as f64, size[1] as f64);
    for _ in 0..count {
        let (mut x, mut y) = (draw.range(0.0, w), draw.range(0.0, h));
        let mut angle = draw.range(0.0, core::f64::consts::TAU);
        let bend = draw.range(-1.0, 1.0) * draw.uniform() * 0.02;
        let length = (draw.range(long[0], long[1]) * w) as usize;
        let depth = draw.range(0.2, 1.0);
        for step in 0..length {
            let fade = 4.0 * (step as f64 / length as f64) * (1.0 - step as f64 / length as f64);
            let (left, top) = (x.floor(), y.floor());
            for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let wx = 1.0 - (x - left - f64::from(i)).abs();
                let wy = 1.0 - (y - top - f64::from(j)).abs();
                let (cx, cy) = ((left as i64 + i64::from(i)).rem_euclid(size[0] as i64), top as i64 + i64::from(j));
                let at = (cy.rem_euclid(size[1] as i64) * size[0] as i64 + cx) as usize;
                field.values[at] = field.values[at].max(depth * fade.min(1.0) * wx * wy);
            }
            x += maths::cos(angle);
            y += maths::sin(angle);
            angle += bend;
        }
    }
    field
}

/// Brushed along u; gray.
pub fn brushed(draw: &mut Stream, size: Size) -> Skin {
    let fine = Field::noise(size, draw.bits(), [3, size[1] / 2]);
    let wide = Field::fractal(size, draw.bits(), [2, 24], 3, 0.7);
    let smear = Field::fractal(size, draw.bits(), [3, 3], 4, 0.55);
    let marks = scratches(draw, size, 12, [0.1, 0.5]);
    Skin::new(size, |i, _, _| {
        let streak = 0.6 * fine.values[i] + 0.5 * wide.values[i];
        let tone = 0.8 * (1.0 + 0.18 * streak - 0.12 * marks.values[i]);
        Texel {
            color: [tone; 3],
            rough: (0.62 + 0.14 * streak + 0.1 * smear.values[i] + 0.2 * marks.values[i]).clamp(0.2, 1.0),
            height: 0.05 * streak - 0.1 * marks.values[i],
        }
    })
}

/// Scratched and fingered; gray.
pub fn scratched(draw: &mut Stream, size: Size) -> Skin {
    let marks = scratches(draw, size, 140, [0.05, 0.9]);
    let dents = Field::fractal(size, draw.bits(), [5, 5], 3, 0.5);
    let smear = Field::fractal(size, draw.bits(), [4, 4], 5, 0.6);
    let grime = draw.range(0.05, 0.2);
    Skin::new(size, |i, _, _| {
        let film = step(-0.2, 0.9, smear.values[i]);
        let tone = 0.8 * (1.0 - grime * film + 0.08 * marks.values[i]);
        Texel {
            color: [tone; 3],
            rough: (0.4 + 0.3 * film + 0.45 * marks.values[i]).min(1.0),
            height: 0.35 * dents.values[i] - 0.12 * marks.values[i],
        }
    })
}

/// Paint that has chipped: where it is gone, bare metal and rust. Paint is white, as the material gives the colour.
pub fn chipped(draw: &mut Stream, size: Size) -> Skin {
    let coarse = Field::fractal(size, draw.bits(), [4, 4], 6, 0.65);
    let where_ = Field::fractal(size, draw.bits(), [2, 2], 3, 0.5);
    let marks = scratches(draw, size, 40, [0.03, 0.4]);
    let peel = Field::fractal(size, draw.bits(), [32, 32], 3, 0.7);
    let worn = draw.range(0.12, 0.75);
    let (bare, rust) = (eye(120.0, 118.0, 116.0), eye(124.0, 66.0, 38.0));
    Skin::new(size, |i, _, _| {
        let depth = coarse.values[i] + 0.6 * where_.values[i] + 0.7 * marks.values[i];
        let gone = step(worn + 0.1, worn + 0.16, depth);
        let rim = step(worn - 0.02, worn + 0.1, depth) * (1.0 - gone);
        let rusty = step(worn + 0.22, worn + 0.5, depth);
        let paint = shade([0.72; 3], 1.0 + 0.03 * peel.values[i] - 0.25 * rim - 0.1 * marks.values[i]);
        Texel {
            color: blend(paint, blend(bare, rust, rusty), gone),
            rough: 0.5 + 0.06 * peel.values[i] + 0.3 * gone.max(0.4 * marks.values[i]),
            height: 0.06 * peel.values[i] - 0.5 * gone + 0.3 * rusty * peel.values[i],
        }
    })
}

/// Rust, in flakes and runs.
pub fn rust(draw: &mut Stream, size: Size) -> Skin {
    let large = Field::fractal(size, draw.bits(), [3, 3], 6, 0.6);
    let fine = Field::fractal(size, draw.bits(), [24, 24], 4, 0.7);
    let run = Field::fractal(size, draw.bits(), [18, 2], 3, 0.6);
    let (light, mid, dark) = (eye(178.0, 102.0, 50.0), eye(128.0, 66.0, 36.0), eye(66.0, 42.0, 34.0));
    Skin::new(size, |i, _, _| {
        let t = 0.5 + 0.5 * large.values[i] + 0.25 * fine.values[i];
        let color = blend(blend(dark, mid, step(0.0, 0.5, t)), light, step(0.5, 1.1, t + 0.3 * run.values[i]));
        Texel { color, rough: 0.9, height: 0.9 * large.values[i] + 0.5 * fine.values[i] }
    })
}

/// The grain of moulded plastic and rubber; gray.
pub fn grain(draw: &mut Stream, size: Size) -> Skin {
    let count = *draw.pick(&[48usize, 64, 96]);
    let cells = Cells::new(size, draw.bits(), [count, count], 0.95, |_, _| [0.0; 2]);
    let edge = cells.edge();
    let smear = Field::fractal(size, draw.bits(), [3, 3], 5, 0.6);
    let marks = scratches(draw, size, 25, [0.03, 0.3]);
    let deep = draw.range(0.02, 0.12);
    Skin::new(size, |i, _, _| {
        let bump = step(0.0, 0.4, edge.values[i]);
        let film = step(-0.2, 0.9, smear.values[i]);
        let tone = 0.8 * (0.95 + 0.05 * bump + 0.05 * marks.values[i] - 0.04 * film);
        Texel {
            color: [tone; 3],
            rough: 0.6 + 0.15 * film + 0.2 * marks.values[i],
            height: deep * bump - 0.06 * marks.values[i],
        }
    })
}

/// Glazed ware: specks and a pooled glaze; gray.
pub fn glaze(draw: &mut Stream, size: Size) -> Skin {
    let cells = Cells::new(size, draw.bits(), [40, 40], 0.95, |_, _| [0.0; 2]);
    let pool = Field::fractal(size, draw.bits(), [3, 3], 4, 0.5);
    let rings = Field::noise(size, draw.bits(), [2, 24]);
    let rare = draw.range(0.75, 1.1);
    Skin::new(size, |i, _, _| {
        let id = cells.id.values[i];
        let speck = step(rare, rare + 0.05, id) * (1.0 - step(0.12, 0.3, cells.near.values[i]));
        let tone = 0.82 * (1.0 + 0.06 * pool.values[i] + 0.03 * rings.values[i]) * (1.0 - 0.65 * speck);
        Texel { color: [tone; 3], rough: 0.42 + 0.1 * speck, height: 0.25 * pool.values[i] + 0.12 * rings.values[i] }
    })
}

/// Fired clay.
pub fn clay(draw: &mut Stream, size: Size) -> Skin {
    let c = draw.pick(&[[190.0, 108.0, 74.0], [170.0, 92.0, 66.0], [200.0, 150.0, 112.0], [120.0, 92.0, 78.0]]);
    let base = eye(c[0], c[1], c[2]);
    let lime = eye(214.0, 200.0, 184.0);
    let cloud = Field::fractal(size, draw.bits(), [2, 3], 5, 0.6);
    let rings = Field::noise(size, draw.bits(), [1, 40]);
    let fine = Field::fractal(size, draw.bits(), [48, 48], 2, 0.8);
    let bloom = draw.range(0.3, 1.4);
    Skin::new(size, |i, _, _| {
        let white = 0.6 * step(bloom, bloom + 0.6, cloud.values[i]);
        let tone = 1.0 + 0.08 * fine.values[i] + 0.06 * rings.values[i] + 0.08 * cloud.values[i];
        Texel {
            color: blend(shade(base, tone), lime, white),
            rough: 0.9,
            height: 0.3 * rings.values[i] + 0.2 * fine.values[i],
        }
    })
}

/// Skins of fruit, crusts and the like.
pub fn food(draw: &mut Stream, size: Size) -> Skin {
    let (sort, seed) = (draw.below(5), draw.bits());
    let dots = Cells::new(size, draw.bits(), [26, 26], 0.8, |_, _| [0.0; 2]);
    let cloud = Field::fractal(size, draw.bits(), [2, 2], 5, 0.55);
    let streak = Field::fractal(size, draw.bits(), [40, 2], 3, 0.6);
    let pair = |a: [f64; 3], b: [f64; 3]| (eye(a[0], a[1], a[2]), eye(b[0], b[1], b[2]));
    let (a, b) = match sort {
        0 => pair([162.0, 48.0, 42.0], [204.0, 158.0, 72.0]),  // apple
        1 => pair([226.0, 130.0, 34.0], [206.0, 106.0, 24.0]), // orange
        2 => pair([212.0, 164.0, 98.0], [150.0, 92.0, 46.0]),  // bread
        3 => pair([96.0, 134.0, 58.0], [144.0, 168.0, 84.0]),  // green fruit
        _ => pair([224.0, 190.0, 66.0], [196.0, 156.0, 50.0]), // lemon, cheese
    };
    Skin::new(size, |i, _, _| {
        let pore = 1.0 - step(0.05, 0.28, dots.near.values[i]);
        let some = hash(seed, [(dots.id.values[i] * 1e6) as i64, 0]);
        let (t, height, dark) = match sort {
            0 => (0.75 * step(0.0, 1.1, 0.7 * streak.values[i] + 0.7 * cloud.values[i]), 0.0, -0.25 * pore * some),
            1 | 4 => (0.5 + 0.4 * cloud.values[i], -0.4 * pore, 0.12 * pore),
            2 => (step(-0.3, 0.8, cloud.values[i]), 1.2 * cloud.values[i] - 0.4 * pore * some, 0.1 * pore),
            _ => (0.5 + 0.5 * streak.values[i], 0.1 * cloud.values[i], -0.15 * pore * some),
        };
        Texel {
            color: shade(blend(a, b, t.clamp(0.0, 1.0)), 1.0 - dark),
            rough: if sort == 2 { 0.9 } else { 0.55 + 0.1 * pore },
            height,
        }
    })
}
