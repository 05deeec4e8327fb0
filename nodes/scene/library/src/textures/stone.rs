//! Stone, marble, terrazzo, concrete and plaster.

use super::{
    field::{Cells, Field, Size, fract, hash, step},
    skin::{Skin, Texel, blend, eye, shade},
};
use tauflow_data::{maths, rng::Stream};

/// Natural stone with a broken face.
pub fn rock(draw: &mut Stream, size: Size) -> Skin {
    let (a, b) = *draw.pick(&[
        ([150.0, 142.0, 130.0], [104.0, 98.0, 92.0]),  // limestone
        ([178.0, 154.0, 118.0], [134.0, 108.0, 78.0]), // sandstone
        ([118.0, 118.0, 120.0], [74.0, 74.0, 78.0]),   // basalt
        ([166.0, 150.0, 144.0], [112.0, 100.0, 98.0]), // granite
        ([126.0, 128.0, 118.0], [88.0, 94.0, 80.0]),   // slate
    ]);
    let [light, dark] = [a, b].map(|c: [f64; 3]| eye(c[0], c[1], c[2]));
    let large = Field::fractal(size, draw.bits(), [3, 3], 6, 0.55);
    let fold = Field::fractal(size, draw.bits(), [4, 4], 4, 0.5);
    let crack = Field::fractal(size, draw.bits(), [3, 3], 5, 0.6);
    let speck = Field::noise(size, draw.bits(), size.map(|s| s / 2));
    let lichen = eye(172.0, 166.0, 118.0);
    let grown = Field::fractal(size, draw.bits(), [5, 5], 4, 0.6);
    let bare = draw.range(0.6, 1.6);
    Skin::new(size, |i, _, _| {
        let ridge = 1.0 - (fold.values[i].abs() * 1.4).min(1.0);
        let split = 1.0 - step(0.0, 0.035, crack.values[i].abs());
        let t = (0.5 + 0.45 * large.values[i]).clamp(0.0, 1.0);
        let color = shade(blend(dark, light, t), (1.0 + 0.22 * speck.values[i]) * (1.0 - 0.45 * split));
        let cover = 0.6 * step(bare, bare + 0.25, grown.values[i] + 0.3 * ridge);
        let height = 5.0 * large.values[i] + 3.0 * ridge - 2.5 * split + 0.3 * speck.values[i];
        Texel { color: blend(color, lichen, cover), rough: 0.85 + 0.1 * t, height }
    })
}

/// Polished marble: veins along the zeros of warped noise.
pub fn marble(draw: &mut Stream, size: Size) -> Skin {
    let (body, vein) = *draw.pick(&[
        ([226.0, 222.0, 216.0], [120.0, 118.0, 120.0]), // white
        ([226.0, 206.0, 176.0], [160.0, 112.0, 72.0]),  // cream
        ([70.0, 100.0, 84.0], [196.0, 208.0, 194.0]),   // green
        ([58.0, 56.0, 58.0], [190.0, 182.0, 170.0]),    // black
        ([196.0, 158.0, 146.0], [128.0, 76.0, 68.0]),   // red
    ]);
    let [body, vein] = [body, vein].map(|c: [f64; 3]| eye(c[0], c[1], c[2]));
    let warp = [draw.bits(), draw.bits()].map(|s| Field::fractal(size, s, [2, 2], 4, 0.5));
    let main = Field::fractal(size, draw.bits(), [2, 2], 3, 0.5);
    let fine = Field::fractal(size, draw.bits(), [5, 5], 4, 0.55);
    let cloud = Field::fractal(size, draw.bits(), [3, 3], 5, 0.55);
    let reach = draw.range(0.06, 0.16);
    let density = draw.range(0.4, 1.0);
    Skin::new(size, |i, u, v| {
        let (a, b) = (u + reach * warp[0].values[i], v + reach * warp[1].values[i]);
        let thick = (0.5 + 0.5 * cloud.values[i]).clamp(0.1, 1.0);
        let line = |field: &Field, width: f64| 1.0 - step(0.0, width * thick, field.sample(a, b).abs());
        let veins = (line(&main, 0.16) + 0.45 * density * line(&fine, 0.08)).min(1.0);
        let tone = 1.0 + 0.1 * cloud.values[i];
        let color = blend(shade(body, tone), vein, 0.75 * density.max(0.6) * veins);
        Texel { color, rough: 0.35 + 0.06 * veins, height: 0.0 }
    })
}

/// Terrazzo: chips of stone in a smooth ground.
pub fn terrazzo(draw: &mut Stream, size: Size) -> Skin {
    let ground = *draw.pick(&[[206.0, 200.0, 190.0], [150.0, 148.0, 146.0], [96.0, 94.0, 96.0], [214.0, 190.0, 170.0]]);
    let ground = eye(ground[0], ground[1], ground[2]);
    let chips: Vec<_> = (0..4)
        .map(|_| {
            let c = draw.pick(&[
                [232.0, 228.0, 220.0],
                [70.0, 68.0, 66.0],
                [168.0, 96.0, 70.0],
                [126.0, 128.0, 112.0],
                [190.0, 160.0, 116.0],
                [110.0, 118.0, 128.0],
            ]);
            eye(c[0], c[1], c[2])
        })
        .collect();
    let seed = draw.bits();
    let sets = [(draw.bits(), 18), (draw.bits(), 44)].map(|(s, n)| {
        let cells = Cells::new(size, s, [n, n], 0.9, |_, _| [0.0; 2]);
        (cells.edge(), cells)
    });
    let cloud = Field::fractal(size, draw.bits(), [6, 6], 4, 0.5);
    Skin::new(size, |i, _, _| {
        let mut color = shade(ground, 1.0 + 0.05 * cloud.values[i]);
        let mut chip = 0.0f64;
        for (number, (edge, cells)) in sets.iter().enumerate().rev() {
            let id = cells.id.values[i];
            let own = hash(seed, [(id * 1e6) as i64, number as i64]);
            let wide = 0.08 + 0.5 * own;
            let inside = step(wide, wide + 0.09, edge.values[i]) * f64::from(u8::from(fract(own * 7.3) < 0.75));
            let stone = shade(chips[(fract(own * 31.0) * chips.len() as f64) as usize % chips.len()], 0.85 + 0.3 * id);
            color = blend(color, stone, inside);
            chip = chip.max(inside);
        }
        Texel { color, rough: 0.42 - 0.06 * chip, height: 0.0 }
    })
}

/// Cast concrete: stains, pores, and the joints and tie holes of its formwork.
pub fn concrete(draw: &mut Stream, size: Size) -> Skin {
    let tone = draw.range(120.0, 178.0);
    let base = eye(tone * 1.005, tone * 0.995, tone * draw.range(0.94, 0.995));
    let formwork = draw.below(3);
    let stain = Field::fractal(size, draw.bits(), [2, 3], 6, 0.6);
    let run = Field::fractal(size, draw.bits(), [14, 1], 3, 0.6);
    let fine = Field::fractal(size, draw.bits(), [32, 32], 3, 0.8);
    let pores = Cells::new(size, draw.bits(), [52, 52], 0.9, |_, _| [0.0; 2]);
    let boards = draw.bits();
    Skin::new(size, |i, u, v| {
        let id = pores.id.values[i];
        let radius = if id > 0.6 { 0.06 + 0.3 * (id - 0.6) } else { 0.0 };
        let pore = 1.0 - step(0.5 * radius, radius + 1e-6, pores.near.values[i]);
        let (mut dark, mut height) = (0.0f64, 0.0);
        match formwork {
            0 => {
                // Panels of 1.2 m with tie holes.
                let (x, y) = (fract(2.0 * u), fract(2.0 * v));
                let edge = 1.2 * x.min(1.0 - x).min(y).min(1.0 - y);
                let joint = 1.0 - step(0.002, 0.012, edge);
                let hole = [0.25, 0.75].iter().flat_map(|a| [0.25, 0.75].map(|b| (a - x, b - y)));
                let nearest = hole.fold(1.0f64, |near, (a, b)| near.min((a * a + b * b).sqrt()));
                let hole = 1.0 - step(0.012, 0.02, nearest);
                dark = (0.35 * joint).max(0.6 * hole);
                height = -3.0 * joint - 8.0 * hole;
            }
            1 => {
                // Boards of 15 cm along u.
                let board = v * 16.0;
                let y = fract(board);
                let joint = 1.0 - step(0.01, 0.09, y.min(1.0 - y));
                dark = 0.25 * joint + 0.12 * (hash(boards, [board.floor() as i64, 0]) - 0.5);
                height = 2.0 * joint + 1.5 * hash(boards, [board.floor() as i64, 1]);
            }
            _ => {}
        }
        let tone =
            1.0 + 0.16 * stain.values[i] - 0.1 * run.values[i].max(0.0) + 0.06 * fine.values[i] - dark - 0.4 * pore;
        Texel {
            color: shade(base, tone.max(0.2)),
            rough: (0.8 + 0.12 * stain.values[i]).clamp(0.5, 1.0),
            height: height + 0.25 * fine.values[i] - 2.5 * pore,
        }
    })
}

/// Painted plaster; gray, as the material gives the colour.
pub fn plaster(draw: &mut Stream, size: Size) -> Skin {
    let sort = draw.below(4);
    let depth = draw.range(0.5, 1.0);
    let coarse = Field::fractal(size, draw.bits(), [5, 5], 5, 0.55);
    let fine = Field::fractal(size, draw.bits(), [48, 48], 2, 0.8);
    let cloud = Field::fractal(size, draw.bits(), [2, 2], 4, 0.5);
    let strokes = Cells::new(size, draw.bits(), [7, 7], 1.0, |_, _| [0.0; 2]);
    let seed = draw.bits();
    Skin::new(size, |i, u, v| {
        let (texture, height) = match sort {
            // Smooth, from a roller.
            0 => (0.4 * fine.values[i], 0.25 * fine.values[i]),
            // Trowelled: each stroke a fan of ridges of its own direction.
            1 => {
                let id = strokes.id.values[i];
                let angle = core::f64::consts::TAU * hash(seed, [(id * 1e6) as i64, 0]);
                let (c, s) = (maths::cos(angle), maths::sin(angle));
                let ridge = coarse.sample(u * 2.0 + 0.1 * c * fine.values[i], v * 2.0) * 0.5
                    + maths::sin(90.0 * strokes.near.values[i] * (c * 0.3 + 0.7) + 6.0 * s) * 0.3;
                (0.5 * ridge, 0.6 * ridge + 0.2 * fine.values[i])
            }
            // Rough-cast.
            2 => {
                let grain = fine.values[i] + 0.5 * coarse.values[i];
                (0.7 * grain, 1.1 * grain)
            }
            // Uneven, by hand.
            _ => (0.5 * coarse.values[i] + 0.2 * fine.values[i], 2.2 * coarse.values[i] + 0.15 * fine.values[i]),
        };
        let tone = 0.78 * (1.0 + 0.07 * depth * texture + 0.06 * cloud.values[i]);
        Texel { color: [tone; 3], rough: 0.85 + 0.05 * texture, height: depth * height }
    })
}
