//! A small canvas for what is printed or shown: rectangles, discs, lines of glyphs, and pictures made of them.

use super::{
    field::{Field, Size, fract, hash, step},
    skin::{Color, Skin, Texel, blend, eye, shade},
};
use tauflow_data::{maths, rng::Stream};

/// A rectangle in texels: left, top, right, bottom.
pub type Area = [f64; 4];

/// Pixels that are drawn on.
pub struct Canvas {
    /// Columns and rows.
    pub size: Size,
    /// Colours by row.
    pub pixels: Vec<Color>,
}

/// How much of a texel at `at` lies within `low..high`.
fn cover(low: f64, high: f64, at: f64) -> f64 {
    ((at + 1.0).min(high) - at.max(low)).clamp(0.0, 1.0)
}

/// A colour of print.
pub fn ink(draw: &mut Stream) -> Color {
    let c = draw.pick(&[
        [196.0, 58.0, 48.0],
        [34.0, 72.0, 122.0],
        [232.0, 186.0, 70.0],
        [46.0, 108.0, 92.0],
        [232.0, 222.0, 202.0],
        [36.0, 36.0, 42.0],
        [208.0, 116.0, 62.0],
        [120.0, 156.0, 176.0],
        [142.0, 72.0, 102.0],
        [168.0, 178.0, 132.0],
        [244.0, 240.0, 232.0],
        [92.0, 60.0, 48.0],
    ]);
    eye(c[0], c[1], c[2])
}

impl Canvas {
    /// A plain one.
    pub fn new(size: Size, color: Color) -> Self {
        Self { size, pixels: vec![color; size[0] * size[1]] }
    }

    /// Paints where `f` gives a weight, over the texels of `area`; `f` gets the place in texels.
    pub fn paint(&mut self, area: Area, mut f: impl FnMut(f64, f64) -> (f64, Color)) {
        let [left, top, right, bottom] = area;
        let columns = left.max(0.0).floor() as usize..(right.max(0.0).ceil() as usize).min(self.size[0]);
        for y in top.max(0.0).floor() as usize..(bottom.max(0.0).ceil() as usize).min(self.size[1]) {
            let inside = cover(top, bottom, y as f64);
            for x in columns.clone() {
                let (weight, color) = f(x as f64 + 0.5, y as f64 + 0.5);
                let weight = weight * inside * cover(left, right, x as f64);
                let pixel = &mut self.pixels[y * self.size[0] + x];
                *pixel = blend(*pixel, color, weight.clamp(0.0, 1.0));
            }
        }
    }

    /// A filled rectangle.
    pub fn rectangle(&mut self, area: Area, color: Color) {
        self.paint(area, |_, _| (1.0, color));
    }

    /// A filled ellipse within a rectangle.
    pub fn ellipse(&mut self, area: Area, color: Color) {
        let [cx, cy] = [0.5 * (area[0] + area[2]), 0.5 * (area[1] + area[3])];
        let [rx, ry] = [(0.5 * (area[2] - area[0])).max(0.5), (0.5 * (area[3] - area[1])).max(0.5)];
        let soft = 1.0 / rx.min(ry);
        self.paint(area, |x, y| {
            let (a, b) = ((x - cx) / rx, (y - cy) / ry);
            (1.0 - step(1.0 - soft, 1.0 + soft, (a * a + b * b).sqrt()), color)
        });
    }

    /// A line of glyphs on marks of 3 x 5: words of 2 to 9 letters, each letter a hash of its place. Not to be read.
    pub fn words(&mut self, area: Area, letter: f64, color: Color, seed: u64) {
        let (mut x, mut number, mut word) = (area[0], 0i64, 0i64);
        let wide = 0.7 * letter;
        while x + wide <= area[2] {
            let long = 2 + (hash(seed, [word, 1]) * 8.0) as i64;
            for _ in 0..long {
                if x + wide > area[2] {
                    return;
                }
                let shape = hash(seed, [number % 23, 2]);
                for cell in 0..15i64 {
                    let (i, j) = (cell % 3, cell / 3);
                    // A stem on the left, and bars by the letter.
                    let stem = i == 0 && hash(seed, [number % 23, 3]) > 0.2;
                    if stem || fract(shape * 7.0 + hash(seed, [number % 23, 10 + cell])) > 0.52 {
                        let left = x + i as f64 * wide * 0.28;
                        let top = area[1] + j as f64 * letter * 0.2;
                        self.rectangle([left, top, left + wide * 0.28, top + letter * 0.2], color);
                    }
                }
                x += wide + 0.18 * letter;
                number += 1;
            }
            x += 0.5 * letter;
            word += 1;
        }
    }

    /// A block of lines; `ragged` ends lines early.
    pub fn text(&mut self, area: Area, letter: f64, color: Color, draw: &mut Stream, ragged: bool) {
        let mut y = area[1];
        while y + letter <= area[3] {
            let last = draw.chance(0.12);
            let share = if last {
                draw.range(0.2, 0.7)
            } else if ragged {
                draw.range(0.75, 1.0)
            } else {
                1.0
            };
            let right = area[0] + (area[2] - area[0]) * share;
            self.words([area[0], y, right, y + letter], letter, color, draw.bits());
            y += letter * if last { 2.4 } else { 1.6 };
        }
    }

    /// A picture: a landscape, a figure, still life, blocks, discs, or a town.
    pub fn picture(&mut self, area: Area, draw: &mut Stream) {
        let [left, top, right, bottom] = area;
        let (w, h) = (right - left, bottom - top);
        match draw.below(6) {
            0 => self.landscape(area, draw),
            1 => {
                // A figure before a ground.
                let (a, b) = (ink(draw), ink(draw));
                self.paint(area, |_, y| (1.0, blend(a, b, (y - top) / h)));
                let cloth = ink(draw);
                let skin = *draw.pick(&[[214.0, 172.0, 142.0], [164.0, 116.0, 86.0], [104.0, 72.0, 54.0]]);
                let skin = eye(skin[0], skin[1], skin[2]);
                let x = left + w * draw.range(0.4, 0.6);
                let r = h * draw.range(0.13, 0.18);
                let y = top + h * draw.range(0.34, 0.42);
                let hair = shade(ink(draw), 0.35);
                self.ellipse([x - 2.6 * r, y + 1.3 * r, x + 2.6 * r, y + 8.0 * r], cloth);
                self.rectangle([x - 0.4 * r, y + 0.6 * r, x + 0.4 * r, y + 1.9 * r], shade(skin, 0.8));
                self.ellipse([x - 1.08 * r, y - 1.5 * r, x + 1.08 * r, y + 0.9 * r], hair);
                self.ellipse([x - 0.8 * r, y - 1.0 * r, x + 0.8 * r, y + 1.2 * r], skin);
                for side in [-1.0, 1.0] {
                    let e = x + side * 0.34 * r;
                    self.ellipse([e - 0.12 * r, y - 0.12 * r, e + 0.12 * r, y + 0.08 * r], shade(hair, 0.6));
                }
                self.rectangle([x - 0.25 * r, y + 0.6 * r, x + 0.25 * r, y + 0.68 * r], eye(150.0, 60.0, 60.0));
                self.rectangle([left, bottom - 0.02 * h, right, bottom], cloth);
            }
            2 => {
                // Vessels and fruit on a table.
                let (wall, table) = (ink(draw), shade(ink(draw), 0.6));
                self.paint(area, |x, _| (1.0, shade(wall, 0.6 + 0.5 * (x - left) / w)));
                self.rectangle([left, top + 0.68 * h, right, bottom], table);
                for _ in 0..3 + draw.below(4) {
                    let x = left + w * draw.range(0.12, 0.88);
                    let foot = top + h * draw.range(0.7, 0.9);
                    let (r, c) = (w * draw.range(0.05, 0.13), ink(draw));
                    if draw.chance(0.5) {
                        let neck = h * draw.range(0.25, 0.5);
                        self.ellipse([x - r, foot - 2.4 * r, x + r, foot], c);
                        self.rectangle([x - 0.35 * r, foot - neck, x + 0.35 * r, foot - 1.2 * r], c);
                    } else {
                        self.ellipse([x - r, foot - 2.0 * r, x + r, foot], c);
                        self.ellipse([x - 0.6 * r, foot - 1.8 * r, x + 0.1 * r, foot - r], shade(c, 1.35));
                    }
                }
            }
            3 => {
                // Blocks between bars.
                self.rectangle(area, ink(draw));
                let bar = shade(ink(draw), 0.3);
                let (mut x, mut columns) = (left, vec![left]);
                while x < right {
                    x += w * draw.range(0.12, 0.4);
                    columns.push(x.min(right));
                }
                for pair in columns.windows(2) {
                    let mut y = top;
                    while y < bottom {
                        let next = (y + h * draw.range(0.1, 0.45)).min(bottom);
                        if draw.chance(0.6) {
                            self.rectangle([pair[0], y, pair[1], next], ink(draw));
                        }
                        self.rectangle([pair[0], next - 0.012 * h, pair[1], next], bar);
                        y = next;
                    }
                    self.rectangle([pair[1] - 0.012 * w, top, pair[1], bottom], bar);
                }
            }
            4 => {
                // Discs over one another.
                self.rectangle(area, ink(draw));
                for _ in 0..5 + draw.below(9) {
                    let (x, y) = (left + w * draw.uniform(), top + h * draw.uniform());
                    let r = w.min(h) * draw.range(0.05, 0.35);
                    let c = ink(draw);
                    let whole: Area = [x - r, y - r, x + r, y + r];
                    let kept = [whole[0].max(left), whole[1].max(top), whole[2].min(right), whole[3].min(bottom)];
                    self.paint(kept, |a, b| {
                        let d = ((a - x) * (a - x) + (b - y) * (b - y)).sqrt();
                        (0.85 * (1.0 - step(r - 1.0, r + 1.0, d)), c)
                    });
                }
            }
            _ => {
                // A town at night or day: towers with windows.
                let (sky, low) = (ink(draw), ink(draw));
                self.paint(area, |_, y| (1.0, blend(sky, low, (y - top) / h)));
                for layer in 0..3 {
                    let tone = shade(ink(draw), 0.25 + 0.25 * f64::from(layer));
                    let lit = eye(246.0, 222.0, 150.0);
                    let mut x = left;
                    while x < right {
                        let wide = w * draw.range(0.06, 0.16);
                        let high = h * draw.range(0.15, 0.7) * (1.0 - 0.22 * f64::from(layer));
                        self.rectangle([x, bottom - high, (x + wide).min(right), bottom], tone);
                        let (mut a, seed) = (x + 0.012 * w, draw.bits());
                        while a + 0.02 * w < (x + wide).min(right) {
                            let mut b = bottom - high + 0.02 * h;
                            while b + 0.02 * h < bottom {
                                if hash(seed, [(a * 8.0) as i64, (b * 8.0) as i64]) < 0.4 {
                                    self.rectangle([a, b, a + 0.014 * w, b + 0.018 * h], lit);
                                }
                                b += 0.035 * h;
                            }
                            a += 0.028 * w;
                        }
                        x += wide * draw.range(0.9, 1.3);
                    }
                }
            }
        }
    }

    /// Sky, sun, ridges one before another, and a near ground.
    fn landscape(&mut self, area: Area, draw: &mut Stream) {
        let [left, top, right, bottom] = area;
        let (w, h) = (right - left, bottom - top);
        let (zenith, horizon) = *draw.pick(&[
            ([88.0, 138.0, 190.0], [206.0, 220.0, 226.0]),
            ([62.0, 70.0, 120.0], [236.0, 158.0, 98.0]),
            ([150.0, 160.0, 168.0], [220.0, 218.0, 210.0]),
            ([22.0, 30.0, 58.0], [92.0, 92.0, 128.0]),
        ]);
        let [zenith, horizon] = [zenith, horizon].map(|c: [f64; 3]| eye(c[0], c[1], c[2]));
        let middle = draw.range(0.4, 0.65);
        let cloud = Field::fractal([128, 128], draw.bits(), [2, 6], 5, 0.55);
        self.paint(area, |x, y| {
            let t = ((y - top) / h / middle).min(1.0);
            let white = step(0.2, 0.9, cloud.sample((x - left) / w, (y - top) / h)) * 0.7;
            (1.0, blend(blend(zenith, horizon, t), shade(horizon, 1.05), white))
        });
        let (sx, sy, r) = (left + w * draw.uniform(), top + h * draw.range(0.1, middle), 0.05 * h);
        self.ellipse(
            [(sx - r).max(left), sy - r, (sx + r).min(right), sy + r],
            blend(horizon, eye(255.0, 246.0, 220.0), 0.8),
        );
        let near = *draw.pick(&[[74.0, 98.0, 54.0], [122.0, 104.0, 66.0], [58.0, 84.0, 92.0], [92.0, 74.0, 62.0]]);
        let near = eye(near[0], near[1], near[2]);
        for layer in 0..4 {
            let t = f64::from(layer) / 3.0;
            let color = blend(blend(horizon, zenith, 0.4), near, 0.25 + 0.75 * t);
            let ridge = Field::fractal([256, 4], draw.bits(), [3 + layer as usize, 1], 5, 0.55);
            let level = top + h * (middle + 0.42 * t * (1.0 - middle));
            let high = h * (0.14 - 0.08 * t);
            self.paint(area, |x, y| {
                let line = level + high * ridge.sample((x - left) / w, 0.5);
                (step(line - 1.0, line + 1.0, y), shade(color, 1.0 - 0.25 * ((y - line) / h).clamp(0.0, 1.0)))
            });
        }
    }

    /// A chart of bars or lines over a grid.
    pub fn chart(&mut self, area: Area, draw: &mut Stream, paper: Color, line: Color) {
        self.rectangle(area, paper);
        let [left, top, right, bottom] = area;
        let (w, h) = (right - left, bottom - top);
        for k in 1..6 {
            let y = top + h * f64::from(k) / 6.0;
            self.rectangle([left, y, right, y + 1.0], blend(paper, line, 0.25));
        }
        let count = 6 + draw.below(10);
        let mut level = draw.range(0.2, 0.7);
        if draw.chance(0.5) {
            let color = ink(draw);
            for k in 0..count {
                level = (level + draw.range(-0.2, 0.22)).clamp(0.08, 0.92);
                let x = left + w * (k as f64 + 0.15) / count as f64;
                self.rectangle([x, bottom - h * level, x + 0.7 * w / count as f64, bottom], color);
            }
        } else {
            for _ in 0..2 {
                let (color, mut before) = (ink(draw), None);
                for k in 0..=count {
                    level = (level + draw.range(-0.2, 0.22)).clamp(0.08, 0.92);
                    let at = (left + w * k as f64 / count as f64, bottom - h * level);
                    if let Some((x, y)) = before {
                        let steps = (w / count as f64 * 2.0) as usize + 2;
                        for s in 0..steps {
                            let t = s as f64 / steps as f64;
                            let (a, b): (f64, f64) = (x + (at.0 - x) * t, y + (at.1 - y) * t);
                            self.rectangle([a - 0.8, b - 0.8, a + 0.8, b + 0.8], color);
                        }
                    }
                    before = Some(at);
                }
            }
        }
        self.rectangle([left, bottom - 1.0, right, bottom], line);
        self.rectangle([left, top, left + 1.0, bottom], line);
    }

    /// As a stuff: flat, with the sheen of ink.
    pub fn skin(&self, rough: f64) -> Skin {
        Skin::new(self.size, |i, _, _| {
            let color = self.pixels[i].map(|c| c.clamp(0.0, 0.92));
            let dark = 1.0 - (color[0] + color[1] + color[2]) / 3.0;
            Texel { color, rough: rough - 0.08 * dark, height: 0.0 }
        })
    }

    /// Values of each channel as they are shown by a screen, at most 1.
    pub fn lit(&self) -> Skin {
        Skin::new(self.size, |i, _, _| Texel {
            color: self.pixels[i].map(|c| c.clamp(0.0, 1.0)),
            rough: 0.5,
            height: 0.0,
        })
    }
}

/// The angle of a colour wheel as a hue that is full.
pub fn hue(t: f64) -> Color {
    [0.0, 1.0 / 3.0, 2.0 / 3.0].map(|shift| 0.5 + 0.5 * maths::cos(core::f64::consts::TAU * (t - shift)))
}
