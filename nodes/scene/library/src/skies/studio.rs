//! Environments under a roof: soft boxes, spots, a tent of cloth, a hall with windows.

use super::{Color, mix3, scaled, step};
use crate::textures::field::Field;
use tauflow_data::{
    geom::{Vec3, cross, direction, dot, unit},
    maths,
    rng::Stream,
};

/// A lamp far away: a rectangle or a disc about a direction.
struct Lamp {
    toward: Vec3,
    right: Vec3,
    up: Vec3,
    /// Half sizes, as tangents.
    half: [f64; 2],
    round: bool,
    radiance: Color,
    /// Share of the half size over which it fades.
    soft: f64,
}

impl Lamp {
    fn new(draw: &mut Stream, elevation: [f64; 2], half: [f64; 2], round: bool, radiance: Color) -> Self {
        let toward = direction(draw.range(0.0, core::f64::consts::TAU), draw.range(elevation[0], elevation[1]));
        let right = unit(cross([0.0, 1.0, 0.0], toward));
        let up = cross(toward, right);
        // Turned about its axis.
        let angle = draw.range(-0.5, 0.5);
        let (c, s) = (maths::cos(angle), maths::sin(angle));
        Self {
            toward,
            right: [0, 1, 2].map(|i| c * right[i] + s * up[i]),
            up: [0, 1, 2].map(|i| c * up[i] - s * right[i]),
            half,
            round,
            radiance,
            soft: draw.range(0.05, 0.25),
        }
    }

    fn at(&self, w: Vec3) -> f64 {
        let along = dot(w, self.toward);
        if along <= 0.05 {
            return 0.0;
        }
        let (a, b) = (dot(w, self.right) / along / self.half[0], dot(w, self.up) / along / self.half[1]);
        let from = if self.round { (a * a + b * b).sqrt() } else { a.abs().max(b.abs()) };
        // Brighter in the middle, as boxes with one bulb are.
        step(1.0 + self.soft, 1.0 - self.soft, from) * (1.0 - 0.35 * (from * from).min(1.0))
    }
}

/// Radiance by direction.
pub fn radiance(name: &str, draw: &Stream) -> Box<dyn Fn(Vec3) -> Color> {
    let mut d = draw.part("hall");
    let warm = mix3([1.0, 0.95, 0.88], [1.0, 0.8, 0.58], d.uniform());
    let cool = mix3([0.95, 0.98, 1.0], [0.78, 0.88, 1.0], d.uniform());
    let gray = d.range(0.02, 0.09);
    let wall = [gray, gray * d.range(0.9, 1.05), gray * d.range(0.85, 1.1)];
    let floor = scaled([1.0, 0.9, 0.8], gray * d.range(0.6, 2.0));
    let mut s = draw.part("lamps");
    let degrees = |v: f64| maths::tan(v.to_radians());
    let lamps: Vec<Lamp> = match name {
        "softboxes" => (0..2 + s.below(3))
            .map(|i| {
                let half = [degrees(s.range(9.0, 24.0)), degrees(s.range(9.0, 30.0))];
                let color = if i % 2 == 0 { warm } else { cool };
                let power = s.range(3.0, 7.0);
                Lamp::new(&mut s, [-0.05, 1.25], half, false, scaled(color, power))
            })
            .collect(),
        "spotlit" => (0..1 + s.below(3))
            .map(|_| {
                let half = degrees(s.range(1.6, 3.0));
                let flux = s.range(2.2, 3.6);
                let color = scaled(warm, flux / (core::f64::consts::PI * half * half));
                Lamp::new(&mut s, [0.4, 1.2], [half, half], true, color)
            })
            .collect(),
        _ => Vec::new(),
    };
    let sides = 4.0 + s.below(5) as f64;
    let (sill, head) = (s.range(-0.12, 0.1), s.range(0.45, 0.9));
    let wide = s.range(0.35, 0.7);
    let bars = 1.0 + s.below(3) as f64;
    let lit_from = s.range(0.0, 1.0);
    let seams = 6.0 + s.below(6) as f64;
    let stain = Field::fractal([512, 64], d.bits(), [9, 3], 5, 0.6);
    let name = name.to_owned();
    Box::new(move |w| {
        let up = w[1];
        let turn = maths::atan2(w[0], w[2]) / core::f64::consts::TAU + 0.5;
        if name == "tent" {
            // Cloth lit from outside: seams, and a darker floor.
            let seam = (turn * seams - (turn * seams).floor() - 0.5).abs();
            let fold = 1.0 - 0.18 * step(0.44, 0.5, seam) - 0.08 * maths::cos(core::f64::consts::TAU * turn * 2.0);
            let fold = fold + 0.04 * stain.sample(turn, up);
            let cloth = scaled(mix3(warm, [1.0, 0.99, 0.97], 0.7), fold * (0.75 + 0.35 * up.max(0.0)));
            return mix3(cloth, scaled(warm, 0.35), step(0.0, -0.15, up));
        }
        // Walls fade upwards, beams cross the ceiling.
        let mut c = scaled(wall, 1.0 + 0.6 * step(-0.2, 0.6, up));
        c = scaled(c, 1.0 + 0.16 * stain.sample(turn, 0.5 * up));
        if up > 0.75 {
            let beam = (w[0] / up * 4.0 - (w[0] / up * 4.0).floor() - 0.5).abs();
            c = scaled(c, if beam < 0.08 { 0.4 } else { 1.0 });
        }
        let shine = 1.0 + 0.2 * stain.sample(2.0 * turn, up);
        c = mix3(c, scaled(floor, shine), step(-0.1, -0.16, up));
        if name == "windows" {
            let at = turn * sides;
            let (pane, x) = (at.floor(), (at - at.floor() - 0.5).abs());
            // Every second side has a window; sunlit ones are brighter.
            let open = step(0.5 * wide + 0.012, 0.5 * wide - 0.012, x)
                * step(sill - 0.01, sill + 0.01, up)
                * step(head + 0.012, head - 0.012, up);
            let bar = (x * 2.0 / wide * bars - (x * 2.0 / wide * bars).floor() - 0.5).abs();
            let level = (up - sill) / (head - sill);
            let cross = (level * 3.0 - (level * 3.0).floor() - 0.5).abs();
            let frame = step(0.44, 0.475, bar).max(step(0.43, 0.47, cross));
            let which = (pane / sides + lit_from) * 7.3;
            let bright = 2.0 + 5.0 * (which - which.floor());
            let outside = mix3(scaled([0.5, 0.56, 0.45], 0.6), cool, step(0.1, 0.35, level));
            c = mix3(c, scaled(outside, bright * (1.0 - 0.9 * frame)), open);
            // Light on the floor below each.
            let pool = step(0.5 * wide + 0.1, 0.2 * wide, x) * step(-0.25, -0.4, up) * step(-0.9, -0.5, up);
            c = [0, 1, 2].map(|k| c[k] + 0.25 * pool * cool[k] * floor[k] * bright);
        }
        for lamp in &lamps {
            let k = lamp.at(w);
            c = [0, 1, 2].map(|i| c[i] + k * lamp.radiance[i]);
        }
        c
    })
}
