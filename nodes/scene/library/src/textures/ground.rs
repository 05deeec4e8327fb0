//! Grounds: asphalt, soil, gravel, sand, grass and snow; ripples of water; dirt.

use super::{
    field::{Cells, Field, Size, fract, hash, step},
    skin::{Skin, Texel, blend, eye, shade},
};
use tauflow_data::{maths, rng::Stream};

/// Asphalt: aggregate in bitumen, patches and cracks.
pub fn asphalt(draw: &mut Stream, size: Size) -> Skin {
    let tone = draw.range(62.0, 104.0);
    let tar = eye(tone, tone, tone * 1.02);
    let stones = Cells::new(size, draw.bits(), [110, 110], 0.95, |_, _| [0.0; 2]);
    let cloud = Field::fractal(size, draw.bits(), [2, 2], 6, 0.6);
    let crack = Field::fractal(size, draw.bits(), [2, 3], 6, 0.6);
    let few = draw.range(0.3, 1.6);
    Skin::new(size, |i, _, _| {
        let id = stones.id.values[i];
        let stone = 1.0 - step(0.2, 0.5, stones.near.values[i]);
        let gap = (1.0 - step(0.0, 0.016, crack.values[i].abs())) * step(few - 0.2, few, cloud.values[i] + 0.6);
        let grit = shade([0.24, 0.235, 0.225], 0.4 + 1.2 * id * id);
        let color = blend(tar, grit, 0.6 * stone * id);
        Texel {
            color: shade(color, (1.0 + 0.16 * cloud.values[i]) * (1.0 - 0.7 * gap)),
            rough: 0.9 - 0.12 * stone,
            height: 1.6 * stone * id + 0.4 * cloud.values[i] - 4.0 * gap,
        }
    })
}

/// Soil: clods, crumbs, and bits of straw and stone.
pub fn soil(draw: &mut Stream, size: Size) -> Skin {
    let c = draw.pick(&[[104.0, 78.0, 56.0], [128.0, 98.0, 70.0], [84.0, 68.0, 56.0], [138.0, 92.0, 66.0]]);
    let base = eye(c[0], c[1], c[2]);
    let large = Field::fractal(size, draw.bits(), [4, 4], 6, 0.62);
    let clods =
        Cells::new(size, draw.bits(), [22, 22], 1.0, |u, v| [0.8 * large.sample(u, v), 0.8 * large.sample(v, u + 0.4)]);
    let crumbs = Cells::new(size, draw.bits(), [70, 70], 1.0, |_, _| [0.0; 2]);
    let straw = eye(176.0, 152.0, 104.0);
    Skin::new(size, |i, _, _| {
        let clod = 1.0 - step(0.0, 0.8, clods.near.values[i]);
        let crumb = 1.0 - step(0.0, 0.7, crumbs.near.values[i]);
        let id = crumbs.id.values[i];
        let color = shade(base, (0.72 + 0.35 * clod + 0.22 * crumb) * (1.0 + 0.22 * large.values[i]));
        let bit = if id > 0.965 { step(0.4, 0.6, crumb) } else { 0.0 };
        Texel {
            color: blend(color, straw, 0.8 * bit),
            rough: 0.96,
            height: 9.0 * clod + 3.5 * crumb * id + 4.0 * large.values[i],
        }
    })
}

/// Gravel: pebbles of three sizes.
pub fn gravel(draw: &mut Stream, size: Size) -> Skin {
    let (a, b) = *draw.pick(&[
        ([184.0, 176.0, 164.0], [118.0, 114.0, 110.0]),
        ([196.0, 170.0, 136.0], [134.0, 106.0, 82.0]),
        ([130.0, 128.0, 130.0], [84.0, 84.0, 90.0]),
    ]);
    let [light, dark] = [a, b].map(|c: [f64; 3]| eye(c[0], c[1], c[2]));
    let fine = Field::fractal(size, draw.bits(), [40, 40], 3, 0.7);
    let sets: Vec<_> = [(14, 0.55), (30, 0.8), (58, 1.0)]
        .map(|(count, share)| (Cells::new(size, draw.bits(), [count, count], 0.9, |_, _| [0.0; 2]), count, share))
        .into();
    let edges: Vec<Field> = sets.iter().map(|(cells, ..)| cells.edge()).collect();
    let seed = draw.bits();
    let ground = shade(dark, 0.4);
    Skin::new(size, |i, _, _| {
        let (mut color, mut height) = (ground, 0.0);
        for (number, (cells, count, share)) in sets.iter().enumerate().rev() {
            let id = cells.id.values[i];
            let own = |k| hash(seed, [(id * 1e6) as i64, k + 10 * number as i64]);
            if own(0) > *share {
                continue;
            }
            let wide = 0.1 + 0.25 * own(1);
            let inside = step(wide, wide + 0.12, edges[number].values[i]);
            let dome = (1.0 - 1.3 * cells.near.values[i] * cells.near.values[i]).max(0.0).sqrt();
            if inside > 0.5 {
                let tone = (0.75 + 0.5 * own(2)) * (1.0 + 0.12 * fine.values[i]) * (0.6 + 0.4 * dome);
                color = shade(blend(dark, light, own(3)), tone);
                height = 260.0 / *count as f64 * dome;
            }
        }
        Texel { color, rough: 0.85, height }
    })
}

/// Sand: ripples and grains.
pub fn sand(draw: &mut Stream, size: Size) -> Skin {
    let c = draw.pick(&[[206.0, 180.0, 140.0], [222.0, 204.0, 172.0], [182.0, 148.0, 110.0]]);
    let base = eye(c[0], c[1], c[2]);
    let bend = Field::fractal(size, draw.bits(), [2, 3], 4, 0.5);
    let grains = Field::noise(size, draw.bits(), size.map(|s| s / 2));
    let waves = 8.0 + draw.below(6) as f64;
    let deep = draw.range(0.0, 5.0);
    Skin::new(size, |i, _, v| {
        let phase = fract(waves * v + 0.9 * bend.values[i]);
        // Lee sides are shorter.
        let wave = if phase < 0.65 { phase / 0.65 } else { (1.0 - phase) / 0.35 };
        let wave = step(0.0, 1.0, wave);
        let color = shade(base, (0.94 + 0.08 * wave) * (1.0 + 0.14 * grains.values[i] + 0.04 * bend.values[i]));
        Texel { color, rough: 0.95, height: deep * wave + 1.2 * bend.values[i] + 0.4 * grains.values[i] }
    })
}

/// A lawn seen from above: blades over blades.
pub fn lawn(draw: &mut Stream, size: Size) -> Skin {
    let lush = draw.uniform();
    let (light, dark) = (
        blend(eye(176.0, 168.0, 104.0), eye(136.0, 172.0, 84.0), lush),
        blend(eye(92.0, 94.0, 50.0), eye(56.0, 92.0, 40.0), lush),
    );
    let earth = eye(84.0, 66.0, 48.0);
    let patch = Field::fractal(size, draw.bits(), [3, 3], 5, 0.55);
    let mut skin = Skin::new(size, |i, _, _| Texel {
        color: shade(blend(earth, dark, 0.7), 0.75 + 0.1 * patch.values[i]),
        rough: 0.95,
        height: 0.0,
    });
    // Strokes from dark to light, later ones on top.
    let mut tops = vec![(0.0f64, 0.0f64); size[0] * size[1]];
    let [w, h] = size.map(|s| s as f64);
    let count = size[0] * size[1] / 16;
    for number in 0..count {
        let level = number as f64 / count as f64;
        let (mut x, mut y) = (draw.range(0.0, w), draw.range(0.0, h));
        let mut angle = draw.range(0.0, core::f64::consts::TAU);
        let bend = draw.range(-0.12, 0.12);
        let length = draw.range(0.03, 0.09) * w;
        let tone = 0.35 + 0.5 * level + draw.range(-0.12, 0.2);
        for at in 0..length as usize {
            let (i, j) = ((x.floor() as i64).rem_euclid(w as i64), (y.floor() as i64).rem_euclid(h as i64));
            let along = at as f64 / length;
            tops[(j * w as i64 + i) as usize] = (tone * (0.7 + 0.4 * along), level * (0.3 + 0.7 * along));
            x += maths::cos(angle);
            y += maths::sin(angle);
            angle += bend;
        }
    }
    skin.over(|i, _, _| {
        let (tone, level) = tops[i];
        let color = shade(blend(dark, light, tone.clamp(0.0, 1.0)), 1.0 + 0.18 * patch.values[i]);
        (if level > 0.0 { 1.0 } else { 0.0 }, Texel { color, rough: 0.75, height: 2.5 * level })
    });
    skin
}

/// Snow: drifts, and a crust with a few prints of wind.
pub fn snow(draw: &mut Stream, size: Size) -> Skin {
    let drift = Field::fractal(size, draw.bits(), [2, 3], 5, 0.5);
    let crust = Field::fractal(size, draw.bits(), [12, 24], 4, 0.6);
    let grain = Field::noise(size, draw.bits(), size.map(|s| s / 2));
    Skin::new(size, |i, _, _| {
        let tone = 1.0 + 0.02 * crust.values[i] + 0.02 * grain.values[i] + 0.015 * drift.values[i];
        Texel {
            color: shade([0.82, 0.84, 0.87], tone),
            rough: 0.8,
            height: 14.0 * drift.values[i] + 3.0 * crust.values[i] + 0.5 * grain.values[i],
        }
    })
}

/// Ripples of water: sums of waves whose crests close over the period. The colour is plain.
pub fn ripples(draw: &mut Stream, size: Size) -> Skin {
    let calm = draw.range(0.4, 1.6);
    let wind = draw.range(0.0, core::f64::consts::TAU);
    let waves: Vec<[f64; 4]> = (0..28)
        .map(|_| {
            let angle = wind + 0.7 * draw.normal();
            let count = 2.0 + 14.0 * draw.uniform() * draw.uniform();
            let (a, b) = ((count * maths::cos(angle)).round(), (count * maths::sin(angle)).round());
            let k = (a * a + b * b).sqrt().max(1.0);
            [a, b, draw.range(0.0, core::f64::consts::TAU), calm * 16.0 / (k * k.sqrt())]
        })
        .collect();
    let small = Field::fractal(size, draw.bits(), [20, 20], 3, 0.5);
    Skin::new(size, |i, u, v| {
        let sum: f64 = waves
            .iter()
            .map(|[a, b, phase, height]| {
                let s = maths::sin(core::f64::consts::TAU * (a * u + b * v) + phase);
                // Crests are sharper than troughs.
                height * (s + 0.25 * s * s)
            })
            .sum();
        Texel { color: [0.8; 3], rough: 0.5, height: sum + calm * small.values[i] }
    })
}

/// Dirt: how much of it lies at each texel of a whole surface, in one half of the variants densest along v = 0, in the
/// other along all edges and in the corners.
pub fn dirt(draw: &mut Stream, size: Size) -> Skin {
    let cloud = Field::fractal(size, draw.bits(), [4, 3], 6, 0.6);
    let run = Field::fractal(size, draw.bits(), [24, 2], 3, 0.6);
    let low = draw.range(0.05, 0.16);
    let all_round = draw.chance(0.5);
    Skin::new(size, |i, u, v| {
        let near = |from: f64, reach: f64| {
            let t = 1.0 - step(0.0, reach + 0.06, from + 0.16 * reach + 0.05 * cloud.values[i]);
            t * t
        };
        let edges = if all_round {
            // Corners gather from both sides.
            let (a, b) = (near(u.min(1.0 - u), 0.8 * low), near(v.min(1.0 - v), 0.8 * low));
            a + b - 0.5 * a * b
        } else {
            near(v, 1.4 * low) + 0.4 * near(1.0 - v + 0.02 * run.values[i], 0.4 * low)
        };
        let spots = 0.3 * step(0.35, 0.9, cloud.values[i]);
        Texel { color: [(edges + spots).clamp(0.0, 1.0); 3], rough: 0.95, height: 0.0 }
    })
}
