//! Bricks, tiles and paving: units in joints.

use super::{
    field::{Cells, Field, Size, fract, hash, step},
    skin::{Color, Skin, Texel, blend, eye, shade},
};
use tauflow_data::rng::Stream;

/// Brickwork of 25 x 8 cm with its joint: 2.0 x 1.92 m a period, courses along u.
pub fn brick(draw: &mut Stream, size: Size) -> Skin {
    let (a, b) = *draw.pick(&[
        ([164.0, 82.0, 62.0], [126.0, 58.0, 46.0]),     // red
        ([176.0, 104.0, 72.0], [142.0, 78.0, 54.0]),    // orange
        ([198.0, 170.0, 124.0], [168.0, 136.0, 94.0]),  // yellow
        ([128.0, 84.0, 70.0], [84.0, 60.0, 54.0]),      // brown
        ([216.0, 210.0, 200.0], [190.0, 184.0, 176.0]), // painted white
        ([120.0, 116.0, 114.0], [88.0, 86.0, 86.0]),    // gray
    ]);
    let [light, dark] = [a, b].map(|c: [f64; 3]| eye(c[0], c[1], c[2]));
    let lime = draw.range(128.0, 196.0);
    let mortar = eye(lime, lime * 0.97, lime * 0.9);
    let bond = draw.below(4);
    let seed = draw.bits();
    let bend = Field::fractal(size, draw.bits(), [12, 12], 3, 0.5);
    let fine = Field::fractal(size, draw.bits(), [32, 32], 4, 0.7);
    let stain = Field::fractal(size, draw.bits(), [2, 2], 5, 0.55);
    Skin::new(size, |i, u, v| {
        let course = (v * 24.0).floor();
        let row = course as i64;
        let y = fract(v * 24.0);
        // Where it lies in its course: the number of its unit, where in it, and how long the unit is in metres.
        let (unit, x, long) = match bond {
            0 | 1 => {
                // Stretchers, moved by a half or a third a course.
                let moved = if bond == 0 { 0.5 * (row % 2) as f64 } else { (row % 3) as f64 / 3.0 };
                let at = u * 8.0 + moved;
                ((at.floor() as i64).rem_euclid(8), fract(at), 0.25)
            }
            2 => {
                // Flemish: stretchers and headers in turns.
                let at = u * 5.0 + 0.5 * (row % 2) as f64;
                let (pair, x) = ((at.floor() as i64).rem_euclid(5), fract(at));
                if x < 2.0 / 3.0 { (2 * pair, x * 1.5, 0.267) } else { (2 * pair + 1, (x - 2.0 / 3.0) * 3.0, 0.133) }
            }
            _ => {
                // English: courses of stretchers and of headers.
                let count = if row % 2 == 0 { 8.0 } else { 16.0 };
                let at = u * count + if row % 2 == 0 { 0.0 } else { 0.5 };
                ((at.floor() as i64).rem_euclid(count as i64), fract(at), 2.0 / count)
            }
        };
        let own = |k| hash(seed, [row * 32 + unit, k]);
        let edge = (long * x.min(1.0 - x)).min(0.08 * y.min(1.0 - y)) + 0.0012 * bend.values[i];
        let inside = step(0.0035, 0.0075, edge);
        let t = (own(1) + 0.25 * bend.values[i]).clamp(0.0, 1.0);
        let burnt = 1.0 - 0.5 * step(0.9, 1.0, own(2));
        let tone = (0.9 + 0.2 * own(3)) * burnt * (1.0 + 0.14 * fine.values[i]);
        let weather = 1.0 + 0.13 * stain.values[i];
        let color = blend(shade(mortar, 1.0 + 0.1 * fine.values[i]), shade(blend(dark, light, t), tone), inside);
        let height = inside * (6.0 + 1.5 * own(4)) + 0.5 * fine.values[i] + 0.5 * bend.values[i];
        Texel { color: shade(color, weather), rough: 0.88 + 0.06 * fine.values[i], height }
    })
}

/// Glazed tiles in grout: 1.2 m a period.
pub fn tiles(draw: &mut Stream, size: Size) -> Skin {
    let counts = *draw.pick(&[[4, 4], [6, 6], [8, 8], [12, 12], [4, 8], [6, 12], [24, 24]]);
    let tone = |draw: &mut Stream| {
        let c = draw.pick(&[
            [236.0, 234.0, 228.0],
            [214.0, 206.0, 192.0],
            [168.0, 190.0, 196.0],
            [86.0, 118.0, 130.0],
            [176.0, 196.0, 170.0],
            [70.0, 96.0, 84.0],
            [186.0, 120.0, 84.0],
            [92.0, 90.0, 92.0],
            [216.0, 184.0, 120.0],
        ]);
        eye(c[0], c[1], c[2])
    };
    let main = tone(draw);
    let other = tone(draw);
    let pattern = draw.below(5);
    let offset = counts[0] != counts[1] && draw.chance(0.7);
    let gray = draw.range(90.0, 200.0);
    let grout = eye(gray, gray * 0.98, gray * 0.94);
    let seed = draw.bits();
    let glaze = Field::fractal(size, draw.bits(), [10, 10], 3, 0.5);
    let soil = Field::fractal(size, draw.bits(), [3, 3], 4, 0.55);
    let joint = if counts[0] >= 24 { 0.0016 } else { 0.0024 };
    let spread = draw.range(0.02, 0.1);
    Skin::new(size, |i, u, v| {
        let row = (v * counts[1] as f64).floor() as i64;
        let moved = if offset && row % 2 == 1 { 0.5 } else { 0.0 };
        let at = u * counts[0] as f64 + moved;
        let column = (at.floor() as i64).rem_euclid(counts[0] as i64);
        let (x, y) = (fract(at), fract(v * counts[1] as f64));
        let [w, h] = counts.map(|c: usize| 1.2 / c as f64);
        let edge = (w * x.min(1.0 - x)).min(h * y.min(1.0 - y));
        let inside = step(0.6 * joint, joint + 0.0014, edge);
        let own = |k| hash(seed, [row * 64 + column, k]);
        let second = match pattern {
            0 => (row + column) % 2 == 0,
            1 => own(1) < 0.12,
            2 => row % 6 == 0,
            _ => false,
        };
        let mut color: Color = if second { other } else { main };
        if pattern == 4 {
            // A printed motif: quarter rings about the corners.
            let (a, b) = (x.min(1.0 - x), y.min(1.0 - y));
            let from = (a * a + b * b).sqrt();
            color = blend(color, other, step(0.28, 0.31, from) * (1.0 - step(0.4, 0.43, from)));
            color = blend(color, other, 1.0 - step(0.1, 0.12, (x - 0.5).abs() + (y - 0.5).abs()));
        }
        let color = shade(color, 1.0 - spread + 2.0 * spread * own(2) + 0.03 * glaze.values[i]);
        let dirty = shade(grout, 1.0 + 0.2 * soil.values[i]);
        Texel {
            color: blend(dirty, color, inside),
            rough: 0.95 - 0.55 * inside + 0.05 * glaze.values[i],
            // Each lies a little askew.
            height: 1.4 * step(joint, joint + 0.005, edge)
                + 0.15 * glaze.values[i]
                + 0.8 * ((own(3) - 0.5) * (x - 0.5) + (own(4) - 0.5) * (y - 0.5)),
        }
    })
}

/// Paving: slabs, setts, cobbles or a herringbone of clinker; 2 m a period.
pub fn paving(draw: &mut Stream, size: Size) -> Skin {
    let (a, b) = *draw.pick(&[
        ([150.0, 146.0, 140.0], [112.0, 110.0, 108.0]),
        ([168.0, 154.0, 134.0], [130.0, 118.0, 102.0]),
        ([122.0, 120.0, 122.0], [84.0, 84.0, 88.0]),
        ([156.0, 100.0, 80.0], [116.0, 74.0, 62.0]),
    ]);
    let [light, dark] = [a, b].map(|c: [f64; 3]| eye(c[0], c[1], c[2]));
    let joint = eye(92.0, 84.0, 70.0);
    let sort = draw.below(4);
    let seed = draw.bits();
    let bend = Field::fractal(size, draw.bits(), [10, 10], 3, 0.5);
    let fine = Field::fractal(size, draw.bits(), [40, 40], 3, 0.8);
    let stain = Field::fractal(size, draw.bits(), [2, 2], 5, 0.55);
    let cobbles =
        Cells::new(size, draw.bits(), [18, 18], 0.55, |u, v| [0.3 * bend.sample(u, v), 0.3 * bend.sample(v, u + 0.5)]);
    let between = cobbles.edge();
    let weeds = eye(84.0, 96.0, 52.0);
    let green = draw.range(0.2, 1.5);
    Skin::new(size, |i, u, v| {
        let (id, inside, round) = match sort {
            0 => {
                // Slabs of 40 x 50 cm, courses moved by half.
                let row = (v * 4.0).floor() as i64;
                let at = u * 5.0 + 0.5 * (row % 2) as f64;
                let (x, y) = (fract(at), fract(v * 4.0));
                let edge = (0.4 * x.min(1.0 - x)).min(0.5 * y.min(1.0 - y)) + 0.001 * bend.values[i];
                (row * 8 + (at.floor() as i64).rem_euclid(5), step(0.003, 0.008, edge), step(0.0, 0.03, edge))
            }
            1 => {
                // Setts of 10 cm.
                let row = (v * 20.0).floor() as i64;
                let at = u * 20.0 + hash(seed, [row, 9]);
                let (x, y) = (fract(at), fract(v * 20.0));
                let edge = 0.1 * x.min(1.0 - x).min(y).min(1.0 - y) + 0.004 * bend.values[i];
                (row * 32 + (at.floor() as i64).rem_euclid(20), step(0.004, 0.012, edge), step(0.0, 0.04, edge))
            }
            2 => {
                let edge = between.values[i];
                ((cobbles.id.values[i] * 1e6) as i64, step(0.06, 0.2, edge), step(0.0, 0.7, edge))
            }
            _ => {
                // Herringbone of 10 x 20 cm: in a staircase of four cells two lie along u and two along v.
                let (x, y) = (u * 20.0, v * 20.0);
                let (cx, cy) = (x.floor() as i64, y.floor() as i64);
                let place = (cx - cy).rem_euclid(4);
                let (fx, fy) = (fract(x), fract(y));
                let (start, a, b) = match place {
                    0 => ([cx, cy], 0.5 * fx, fy),
                    1 => ([cx - 1, cy], 0.5 + 0.5 * fx, fy),
                    2 => ([cx, cy - 1], 0.5 + 0.5 * fy, fx),
                    _ => ([cx, cy], 0.5 * fy, fx),
                };
                let edge = (0.2 * a.min(1.0 - a)).min(0.1 * b.min(1.0 - b)) + 0.001 * bend.values[i];
                let start = start.map(|s| s.rem_euclid(20));
                (start[0] * 32 + start[1], step(0.002, 0.006, edge), step(0.0, 0.012, edge))
            }
        };
        let own = |k| hash(seed, [id, k]);
        let t = (own(1) + 0.3 * stain.values[i]).clamp(0.0, 1.0);
        let stone = shade(blend(dark, light, t), (0.85 + 0.3 * own(2)) * (1.0 + 0.16 * fine.values[i]));
        let grown = blend(joint, weeds, step(green, green + 0.4, stain.values[i] + 0.4));
        let color = blend(shade(grown, 1.0 + 0.25 * fine.values[i]), stone, inside);
        let height = 4.0 * inside + 5.0 * round + 0.5 * fine.values[i] + 2.0 * own(3);
        Texel { color: shade(color, 1.0 + 0.1 * stain.values[i]), rough: 0.85 + 0.1 * (1.0 - inside), height }
    })
}
