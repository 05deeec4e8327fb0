//! Printed and displayed content: covers, posters, pages, screens; and lit shades.

use super::{
    canvas::{Area, Canvas, hue, ink},
    field::{Cells, Field, Size, fract, step},
    skin::{Color, Skin, Texel, blend, eye, shade},
};
use tauflow_data::{maths, rng::Stream};

/// Covers on a sheet, a side.
pub const COVERS: usize = 4;

/// Ink that stands out from its ground.
fn apart(draw: &mut Stream, ground: Color) -> Color {
    let luminance = |c: Color| 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
    let own = luminance(ground);
    for _ in 0..8 {
        let color = ink(draw);
        let (low, high) = (luminance(color).min(own), luminance(color).max(own));
        if high > 3.0 * low + 0.05 {
            return color;
        }
    }
    if own > 0.3 { [0.03; 3] } else { [0.85; 3] }
}

fn cover(canvas: &mut Canvas, area: Area, draw: &mut Stream) {
    let [left, top, right, bottom] = area;
    let (w, h) = (right - left, bottom - top);
    let ground = ink(draw);
    canvas.rectangle(area, ground);
    let mark = apart(draw, ground);
    let margin = 0.09 * w;
    let line = |canvas: &mut Canvas, y: f64, size: f64, share: f64, color, draw: &mut Stream| {
        let wide = share * (w - 2.0 * margin);
        let x = left + 0.5 * (w - wide);
        canvas.words([x, top + y * h, x + wide, top + (y + size) * h], size * h, color, draw.bits());
    };
    match draw.below(5) {
        0 => {
            let picture = [left + margin, top + 0.32 * h, right - margin, bottom - 0.14 * h];
            canvas.picture(picture, draw);
            line(canvas, 0.08, 0.09, 0.95, mark, draw);
            line(canvas, 0.21, 0.045, 0.6, mark, draw);
            line(canvas, 0.91, 0.04, 0.5, mark, draw);
        }
        1 => {
            canvas.picture(area, draw);
            canvas.rectangle([left, top + 0.62 * h, right, top + 0.86 * h], ground);
            line(canvas, 0.66, 0.08, 0.9, mark, draw);
            line(canvas, 0.78, 0.04, 0.6, mark, draw);
        }
        2 => {
            for k in 0..3 {
                line(canvas, 0.16 + 0.16 * f64::from(k), 0.12, 0.9, mark, draw);
            }
            line(canvas, 0.86, 0.045, 0.6, mark, draw);
            let band = apart(draw, ground);
            canvas.rectangle([left, top + 0.7 * h, right, top + 0.74 * h], band);
        }
        3 => {
            // A label: bands, a badge, small print.
            let band = ink(draw);
            canvas.rectangle([left, top, right, top + 0.18 * h], band);
            canvas.rectangle([left, bottom - 0.22 * h, right, bottom], band);
            let r = 0.28 * w;
            let (x, y) = (left + 0.5 * w, top + 0.44 * h);
            canvas.ellipse([x - r, y - r, x + r, y + r], mark);
            canvas.words([x - 0.8 * r, y - 0.16 * r, x + 0.85 * r, y + 0.2 * r], 0.42 * r, ground, draw.bits());
            let small = apart(draw, band);
            line(canvas, 0.05, 0.08, 0.8, small, draw);
            canvas.text(
                [left + margin, top + 0.81 * h, right - margin, bottom - 0.03 * h],
                0.028 * h,
                small,
                draw,
                true,
            );
        }
        _ => {
            // A page.
            let paper = eye(238.0, 234.0, 224.0);
            canvas.rectangle(area, paper);
            line(canvas, 0.07, 0.05, 0.7, [0.04; 3], draw);
            let split = top + draw.range(0.3, 0.6) * h;
            let body = [left + margin, top + 0.17 * h, right - margin, split];
            canvas.text(body, 0.03 * h, [0.05; 3], draw, false);
            let foot = [left + margin, split + 0.03 * h, right - margin, bottom - 0.08 * h];
            if draw.chance(0.5) {
                canvas.picture(foot, draw);
            } else if draw.chance(0.4) {
                canvas.chart(foot, draw, paper, [0.1; 3]);
            } else {
                canvas.text(foot, 0.03 * h, [0.05; 3], draw, false);
            }
        }
    }
}

/// A sheet of sixteen covers, labels and pages.
pub fn covers(draw: &mut Stream, size: Size) -> Skin {
    let mut canvas = Canvas::new(size, [0.8; 3]);
    let [w, h] = size.map(|s| s as f64 / COVERS as f64);
    for k in 0..COVERS * COVERS {
        let (x, y) = ((k % COVERS) as f64 * w, (k / COVERS) as f64 * h);
        cover(&mut canvas, [x, y, x + w, y + h], &mut draw.part(&k.to_string()));
    }
    canvas.skin(0.62)
}

/// One poster or painting.
pub fn poster(draw: &mut Stream, size: Size) -> Skin {
    let [w, h] = size.map(|s| s as f64);
    let mut canvas = Canvas::new(size, eye(238.0, 234.0, 226.0));
    match draw.below(4) {
        0 => cover(&mut canvas, [0.0, 0.0, w, h], draw),
        1 => {
            // Within a mount.
            let m = draw.range(0.08, 0.16);
            canvas.picture([m * w, m * h, w * (1.0 - m), h * (1.0 - m)], draw);
        }
        _ => canvas.picture([0.0, 0.0, w, h], draw),
    }
    canvas.skin(0.66)
}

/// The content of a screen: windows of an interface, text, charts, or a still of a film.
pub fn screen(draw: &mut Stream, size: Size) -> Skin {
    let [w, h] = size.map(|s| s as f64);
    let whole = [0.0, 0.0, w, h];
    let mut canvas = Canvas::new(size, [0.01; 3]);
    match draw.below(5) {
        0 => {
            canvas.picture([0.0, 0.12 * h, w, 0.88 * h], draw);
        }
        1 => {
            // An editor: dark, with coloured lines.
            canvas.rectangle(whole, eye(34.0, 36.0, 44.0));
            canvas.rectangle([0.0, 0.0, 0.16 * w, h], eye(26.0, 28.0, 34.0));
            let mut y = 0.05 * h;
            while y < 0.96 * h {
                let indent = 0.2 + 0.04 * draw.below(4) as f64;
                let color = shade(blend(hue(draw.uniform()), [0.8; 3], 0.6), 0.7);
                let right = (indent + draw.range(0.05, 0.6)).min(0.97);
                canvas.words([indent * w, y, right * w, y + 0.03 * h], 0.028 * h, color, draw.bits());
                if draw.chance(0.6) {
                    let name = [0.02 * w, y, 0.13 * w, y + 0.02 * h];
                    canvas.words(name, 0.022 * h, [0.3; 3], draw.bits());
                }
                y += 0.045 * h;
            }
        }
        2 => {
            // A board of charts.
            canvas.rectangle(whole, eye(236.0, 238.0, 242.0));
            canvas.rectangle([0.0, 0.0, w, 0.08 * h], eye(44.0, 62.0, 96.0));
            canvas.words([0.03 * w, 0.02 * h, 0.4 * w, 0.06 * h], 0.035 * h, [0.9; 3], draw.bits());
            for k in 0..4 {
                let (x, y) = (f64::from(k % 2), f64::from(k / 2));
                let area = [(0.04 + 0.49 * x) * w, (0.13 + 0.44 * y) * h, (0.47 + 0.49 * x) * w, (0.52 + 0.44 * y) * h];
                canvas.chart(area, draw, [0.95; 3], [0.1; 3]);
            }
        }
        _ => {
            // A desktop with windows.
            canvas.picture(whole, draw);
            for _ in 0..1 + draw.below(3) {
                let (x, y) = (draw.range(0.03, 0.4) * w, draw.range(0.03, 0.4) * h);
                let (right, bottom) = (x + draw.range(0.4, 0.56) * w, y + draw.range(0.35, 0.55) * h);
                let dark = draw.chance(0.3);
                let (paper, mark) = if dark { ([0.03; 3], [0.6; 3]) } else { ([0.93; 3], [0.06; 3]) };
                canvas.rectangle([x - 1.0, y - 1.0, right + 1.0, bottom + 1.0], [0.2; 3]);
                canvas.rectangle([x, y, right, bottom], paper);
                canvas.rectangle([x, y, right, y + 0.05 * h], shade(ink(draw), 0.8));
                for k in 0..3 {
                    let a = right - (0.03 + 0.03 * f64::from(k)) * w;
                    canvas.ellipse([a, y + 0.015 * h, a + 0.02 * w, y + 0.035 * h], [0.8; 3]);
                }
                let inner = [x + 0.02 * w, y + 0.08 * h, right - 0.02 * w, bottom - 0.02 * h];
                match draw.below(3) {
                    0 => canvas.chart(inner, draw, paper, mark),
                    1 => canvas.picture(inner, draw),
                    _ => canvas.text(inner, 0.026 * h, mark, draw, true),
                }
            }
            canvas.rectangle([0.0, 0.95 * h, w, h], [0.05; 3]);
            for k in 0..7 {
                let a = (0.02 + 0.035 * f64::from(k)) * w;
                canvas.rectangle([a, 0.96 * h, a + 0.025 * w, 0.99 * h], ink(draw));
            }
        }
    }
    // No screen is black where it is dark.
    canvas.pixels.iter_mut().for_each(|p| *p = p.map(|c| 0.004 + 0.996 * c));
    canvas.lit()
}

/// A shade lit from within: brighter about the middle of v, with folds, a weave, or panes of colour.
pub fn lampshade(draw: &mut Stream, size: Size) -> Skin {
    let sort = draw.below(4);
    let folds = 8.0 + 4.0 * draw.below(5) as f64;
    let fine = Field::fractal(size, draw.bits(), [48, 48], 2, 0.8);
    let cloud = Field::fractal(size, draw.bits(), [3, 3], 5, 0.6);
    let panes = Cells::new(size, draw.bits(), [6, 6], 0.9, |_, _| [0.0; 2]);
    let edge = panes.edge();
    let middle = draw.range(0.3, 0.7);
    Skin::new(size, |i, u, v| {
        let off = (fract(v - middle + 0.5) - 0.5).abs();
        let bright = 0.25 + 0.6 * (1.0 - step(0.0, 0.5, off));
        let (tone, color) = match sort {
            0 => (0.85 + 0.15 * maths::cos(core::f64::consts::TAU * folds * u), [1.0, 0.94, 0.84]),
            1 => (1.0 + 0.12 * fine.values[i], [1.0, 0.96, 0.9]),
            2 => (1.0 + 0.3 * cloud.values[i], [1.0, 0.92, 0.8]),
            _ => {
                let lead = step(0.02, 0.1, edge.values[i]);
                let glass = blend([1.0, 0.92, 0.8], hue(panes.id.values[i]), 0.75);
                (0.08 + 0.92 * lead, glass)
            }
        };
        Texel { color: shade(color, (bright * tone).clamp(0.0, 1.0)), rough: 0.8, height: 0.0 }
    })
}
