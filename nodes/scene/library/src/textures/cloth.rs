//! Woven fabrics, carpets, rugs and leather.

use super::{
    field::{Cells, Field, Size, fract, hash, step},
    skin::{Color, Skin, Texel, blend, eye, shade},
};
use tauflow_data::{maths, rng::Stream};

const PI: f64 = core::f64::consts::PI;

/// Colours of dyed stuffs.
pub fn dye(draw: &mut Stream) -> Color {
    let c = draw.pick(&[
        [206.0, 196.0, 176.0],
        [150.0, 140.0, 126.0],
        [88.0, 94.0, 104.0],
        [58.0, 78.0, 112.0],
        [124.0, 150.0, 164.0],
        [104.0, 124.0, 92.0],
        [70.0, 98.0, 86.0],
        [172.0, 84.0, 66.0],
        [140.0, 52.0, 56.0],
        [206.0, 160.0, 84.0],
        [160.0, 116.0, 130.0],
        [92.0, 72.0, 96.0],
        [222.0, 216.0, 206.0],
        [66.0, 60.0, 58.0],
    ]);
    eye(c[0], c[1], c[2])
}

/// How threads cross.
#[derive(Clone, Copy, PartialEq)]
pub enum Weave {
    /// Over one, under one.
    Plain,
    /// Over two, under two, moved by one a row.
    Twill,
    /// Twill that turns every eight threads.
    Herringbone,
    /// Plain, with bands of other colours both ways.
    Check,
    /// Plain, with bands of other colours along v.
    Stripes,
}

/// Woven cloth of 64 threads a period both ways. Check and stripes have colours of their own, the others are gray.
pub fn woven(draw: &mut Stream, size: Size, weave: Weave) -> Skin {
    const THREADS: f64 = 64.0;
    let seed = draw.bits();
    let slub = Field::fractal(size, draw.bits(), [8, 64], 2, 0.7);
    let slub_across = Field::fractal(size, draw.bits(), [64, 8], 2, 0.7);
    let wear = Field::fractal(size, draw.bits(), [2, 2], 4, 0.5);
    let melange = draw.range(0.0, 0.16);
    let bands: Vec<Color> = {
        let colors: Vec<Color> = (0..4).map(|_| dye(draw)).collect();
        let mut list = Vec::new();
        while list.len() < 32 {
            let color = colors[draw.below(colors.len())];
            let wide = *draw.pick(&[1, 2, 4, 6, 8]);
            list.extend(std::iter::repeat_n(color, wide));
        }
        list.truncate(32);
        // A mirrored half makes a sett.
        let back: Vec<Color> = list.iter().rev().copied().collect();
        list.extend(back);
        list
    };
    Skin::new(size, |i, u, v| {
        let (x, y) = (u * THREADS, v * THREADS);
        let (warp, weft) = (x.floor() as i64, y.floor() as i64);
        let (fx, fy) = (fract(x) - 0.5, fract(y) - 0.5);
        let over = match weave {
            Weave::Plain | Weave::Check | Weave::Stripes => (warp + weft) % 2 == 0,
            Weave::Twill => (warp + weft).rem_euclid(4) < 2,
            Weave::Herringbone => {
                let turned = (warp / 8) % 2 == 0;
                (if turned { warp + weft } else { 64 - warp + weft }).rem_euclid(4) < 2
            }
        };
        // A thread is a cylinder that dips where it goes under.
        let (across, along) = if over { (fx, fy) } else { (fy, fx) };
        let round = maths::cos(PI * across).max(0.0);
        let rise = 0.55 + 0.45 * maths::cos(PI * along).max(0.0);
        let thread = if over { hash(seed, [warp, 0]) } else { hash(seed, [weft, 1]) };
        let lump = if over { slub_across.values[i] } else { slub.values[i] };
        let shadow = 0.62 + 0.38 * round * rise;
        let tone = shadow * (1.0 - melange + 2.0 * melange * thread) * (1.0 + 0.06 * lump + 0.03 * wear.values[i]);
        let color = match weave {
            Weave::Check => shade(bands[(if over { warp } else { weft }) as usize % 64], tone),
            Weave::Stripes => shade(bands[warp as usize % 64], tone),
            // Warp and weft of twills differ.
            Weave::Twill | Weave::Herringbone => [0.78 * tone * if over { 1.0 } else { 0.72 }; 3],
            Weave::Plain => [0.8 * tone; 3],
        };
        Texel { color, rough: 0.9 + 0.08 * lump, height: 0.5 * round * rise + 0.08 * lump }
    })
}

/// Carpet: tufts in rows, flecked; gray.
pub fn pile(draw: &mut Stream, size: Size) -> Skin {
    let count = *draw.pick(&[40usize, 56, 72]);
    let rows = draw.chance(0.5);
    let tufts = Cells::new(size, draw.bits(), [count, count], if rows { 0.35 } else { 0.95 }, |_, _| [0.0; 2]);
    let brushed = Field::fractal(size, draw.bits(), [3, 3], 4, 0.55);
    let hair = Field::noise(size, draw.bits(), size.map(|s| s / 2));
    let fleck = draw.range(0.05, 0.35);
    Skin::new(size, |i, _, _| {
        let round = 1.0 - tufts.near.values[i].min(1.0);
        let tone = (0.45 + 0.6 * round) * (1.0 - fleck * tufts.id.values[i]) * (1.0 + 0.14 * brushed.values[i]);
        let color = [0.8 * tone * (1.0 + 0.15 * hair.values[i]); 3];
        Texel { color, rough: 0.97, height: 4.0 * round + 0.8 * hair.values[i] }
    })
}

/// A rug: knotted motifs in rows within bands; one repeat of the field to a period.
pub fn rug(draw: &mut Stream, size: Size) -> Skin {
    let colors: Vec<Color> = (0..5).map(|_| dye(draw)).collect();
    let sort = draw.below(4);
    let knots = 96.0;
    let seed = draw.bits();
    let repeats = *draw.pick(&[2.0, 3.0, 4.0]);
    let abrash = Field::fractal(size, draw.bits(), [1, 8], 3, 0.5);
    let hair = Field::noise(size, draw.bits(), size.map(|s| s / 2));
    let rings = [draw.range(0.1, 0.2), draw.range(0.24, 0.32), draw.range(0.36, 0.44)];
    Skin::new(size, |i, u, v| {
        // Patterns are steps of whole knots.
        let (kx, ky) = ((u * knots).floor(), (v * knots).floor());
        let (x, y) = (fract((kx + 0.5) / knots * repeats), fract((ky + 0.5) / knots * repeats));
        let (a, b) = ((x - 0.5).abs(), (y - 0.5).abs());
        let cell = ((kx / knots * repeats).floor() + (ky / knots * repeats).floor()) as i64;
        let index = match sort {
            // Lozenges with hooks.
            0 => {
                let d = a + b + 0.05 * ((ky as i64 % 4) as f64 - 1.5).abs();
                rings.iter().position(|r| d < *r).map_or(4, |p| (p + cell.rem_euclid(2) as usize) % 4)
            }
            // Octagons.
            1 => {
                let d = a.max(b).max(0.72 * (a + b));
                let place = rings.iter().position(|r| d < *r).unwrap_or(4);
                if place == 4 && (a > 0.46 || b > 0.46) { 1 } else { place }
            }
            // Bands of zigzags.
            2 => {
                let zig = (fract((kx + 0.5) / knots * repeats * 2.0) - 0.5).abs() * 0.5;
                (fract(y + zig) * 5.0) as usize
            }
            // Modern: large blocks.
            _ => {
                let (bx, by) = ((u * repeats * 1.0).floor() as i64, (v * repeats * 2.0).floor() as i64);
                (hash(seed, [bx, by]) * 5.0) as usize
            }
        };
        let (fx, fy) = (fract(u * knots) - 0.5, fract(v * knots) - 0.5);
        let round = (1.0 - 1.6 * (fx * fx + fy * fy)).max(0.0);
        let own = hash(seed, [kx as i64, ky as i64 + 1000]);
        let tone = (0.7 + 0.3 * round) * (0.88 + 0.2 * own) * (1.0 + 0.08 * abrash.values[i] + 0.1 * hair.values[i]);
        Texel { color: shade(colors[index.min(4)], tone), rough: 0.96, height: 2.0 * round + 0.5 * hair.values[i] }
    })
}

/// Leather: a net of creases at two scales; gray.
pub fn leather(draw: &mut Stream, size: Size) -> Skin {
    let bend = Field::fractal(size, draw.bits(), [4, 4], 4, 0.5);
    let shift = |k: f64| {
        let bend = &bend;
        move |u: f64, v: f64| [k * bend.sample(u, v), k * bend.sample(v + 0.37, u)]
    };
    let count = 24 + 8 * draw.below(4);
    let grain = Cells::new(size, draw.bits(), [count, count], 0.95, shift(0.8));
    let folds = Cells::new(size, draw.bits(), [5, 5], 1.0, shift(1.2));
    let (edge, fold) = (grain.edge(), folds.edge());
    let wear = Field::fractal(size, draw.bits(), [3, 3], 4, 0.55);
    Skin::new(size, |i, _, _| {
        let crease = 1.0 - step(0.0, 0.3, edge.values[i]);
        let deep = (1.0 - step(0.0, 0.06, fold.values[i])) * step(0.0, 0.8, wear.values[i] + 0.4);
        let worn = step(0.4, 1.4, wear.values[i]);
        let tone = 0.7 * (1.0 - 0.22 * crease - 0.3 * deep) * (1.0 + 0.2 * worn + 0.06 * bend.values[i]);
        Texel {
            color: [tone; 3],
            rough: 0.62 + 0.2 * crease - 0.1 * worn,
            height: -0.35 * crease - 0.8 * deep + 0.3 * wear.values[i],
        }
    })
}

/// Paper and card: fibres, faintly; gray.
pub fn paper(draw: &mut Stream, size: Size) -> Skin {
    let cloud = Field::fractal(size, draw.bits(), [6, 6], 5, 0.65);
    let fibre = Field::fractal(size, draw.bits(), [24, 48], 3, 0.8);
    let crumple = Cells::new(size, draw.bits(), [4, 4], 1.0, |_, _| [0.0; 2]);
    let crumpled = draw.chance(0.3);
    let ruled = draw.below(5);
    Skin::new(size, |i, u, v| {
        let fold = if crumpled { crumple.near.values[i] * 3.0 } else { 0.0 };
        let line = |t: f64, width: f64| 1.0 - step(0.0, width, t.min(1.0 - t));
        // Ruled or squared now and then.
        let ink = match ruled {
            0 => 0.45 * line(fract(v * 24.0), 0.08),
            1 => 0.35 * line(fract(v * 40.0), 0.1).max(line(fract(u * 40.0), 0.1)),
            _ => 0.0,
        };
        let tone = 0.84 * (1.0 + 0.025 * cloud.values[i] + 0.02 * fibre.values[i]) * (1.0 - ink);
        Texel { color: [tone; 3], rough: 0.88, height: fold + 0.06 * fibre.values[i] }
    })
}

/// Wallpaper, in strips of 53 cm: stripes, damask, dots, trellis, flowers or chevrons. Tones about that of the ground.
pub fn wallpaper(draw: &mut Stream, size: Size) -> Skin {
    let sort = draw.below(6);
    let pale = [0.8, 0.78, 0.74];
    let k = draw.range(0.45, 0.9);
    let hue = [draw.range(0.75, 1.1), draw.range(0.75, 1.05), draw.range(0.75, 1.1)];
    let figure = [0, 1, 2].map(|c| pale[c] * k * hue[c]);
    let accent = [0, 1, 2].map(|c| pale[c] * hue[(c + 1) % 3] * (0.4 + 0.4 * k));
    let fine = Field::fractal(size, draw.bits(), [64, 64], 2, 0.8);
    let age = Field::fractal(size, draw.bits(), [2, 2], 4, 0.5);
    let shape = Field::fractal([128, 128], draw.bits(), [3, 4], 4, 0.55);
    let petals = 5.0 + draw.below(3) as f64;
    let stripes: Vec<f64> = (0..8).map(|_| draw.uniform()).collect();
    let across = *draw.pick(&[4.0, 6.0, 8.0]);
    Skin::new(size, |i, u, v| {
        let (x, y) = (fract(across * u), fract(across * v));
        // Weights of the figure and of its accent.
        let (t, second) = match sort {
            0 => (if stripes[(fract(u * 2.0) * 8.0) as usize % 8] > 0.5 { 1.0 } else { 0.0 }, 0.0),
            1 => {
                // Damask: a mirrored figure, moved by half in every other column.
                let column = (u * 4.0).floor();
                let (a, b) = (fract(u * 4.0), fract(v * 2.0 + 0.5 * (column % 2.0)));
                let d = (2.0 * (a - 0.5).abs(), 2.0 * (b - 0.5).abs());
                let n = shape.sample(0.5 * d.0, 0.5 * b) + 0.9 * (0.62 - (0.8 * d.0 * d.0 + d.1 * d.1).sqrt());
                (step(0.0, 0.06, n) * (1.0 - step(0.35, 0.4, n) * (1.0 - step(0.5, 0.55, n))), 0.0)
            }
            2 => {
                let moved = fract(x + 0.5 * ((across * v).floor() % 2.0));
                let from = ((moved - 0.5) * (moved - 0.5) + (y - 0.5) * (y - 0.5)).sqrt();
                (1.0 - step(0.16, 0.2, from), 0.0)
            }
            3 => {
                let (a, b) = (fract(across * (u + v)), fract(across * (u - v)));
                let line = |t: f64| 1.0 - step(0.04, 0.07, t.min(1.0 - t));
                (line(a).max(line(b)), 1.0 - step(0.08, 0.11, ((a - 0.5).abs() + (b - 0.5).abs()) * 0.7))
            }
            4 => {
                let row = (across * v).floor();
                let a = fract(x + 0.5 * (row % 2.0)) - 0.5;
                let b = y - 0.5;
                let (from, angle) = ((a * a + b * b).sqrt(), maths::atan2(b, a));
                let petal = 0.22 + 0.1 * maths::cos(petals * angle);
                let flower = 1.0 - step(petal - 0.03, petal, from);
                let stem = (a - 0.06 * maths::sin(12.0 * b)).abs();
                let stem = 0.8 * (1.0 - step(0.01, 0.03, stem)) * step(0.1, 0.2, b);
                (flower.max(stem), 1.0 - step(0.07, 0.09, from))
            }
            _ => {
                let zig = (fract(across * u) - 0.5).abs();
                (if fract(across * v + zig) < 0.4 { 1.0 } else { 0.0 }, 0.0)
            }
        };
        let color = blend(blend(pale, figure, t), accent, second);
        let tone = 1.0 + 0.03 * fine.values[i] + 0.03 * age.values[i];
        let seam = 1.0 - step(0.0006, 0.0022, 0.53 * fract(2.0 * u).min(1.0 - fract(2.0 * u)));
        Texel {
            color: shade(color, tone * (1.0 - 0.25 * seam)),
            rough: 0.8 - 0.12 * t,
            height: 0.18 * t + 0.12 * fine.values[i] - 0.3 * seam,
        }
    })
}

/// Cloth that has been used: soft folds without a weave that shows; gray.
pub fn wrinkles(draw: &mut Stream, size: Size) -> Skin {
    let bend = Field::fractal(size, draw.bits(), [2, 2], 3, 0.5);
    let cells =
        Cells::new(size, draw.bits(), [5, 4], 1.0, |u, v| [1.2 * bend.sample(u, v), 1.2 * bend.sample(v + 0.4, u)]);
    let fold = cells.edge().blurred(3);
    let fine = Field::fractal(size, draw.bits(), [10, 8], 4, 0.55);
    let weave = Field::noise(size, draw.bits(), size.map(|s| s / 2));
    Skin::new(size, |i, _, _| {
        let crest = 1.0 - step(0.0, 0.5, fold.values[i]);
        let tone = 0.78 * (1.0 + 0.04 * fine.values[i] + 0.05 * weave.values[i] + 0.03 * crest);
        Texel { color: [tone; 3], rough: 0.92, height: 9.0 * crest + 2.5 * fine.values[i] + 0.15 * weave.values[i] }
    })
}
